"""What FANUC's letters say of the arm's position: N or F of the wrist, U or D of the elbow, T or B of the whole arm.

N is a wrist that bends the flange down where axis 4 is at its zero (J5 below zero), F one that bends it up; T has the wrist in
front of axis 1, B behind it; U has the elbow above the line from axis 2 to the wrist, D below. The letters are told by the
nominal arm's own geometry, and only of arms that are built and zeroed as these: axis 1 upright, axes 2 and 3 parallel across it,
axes 4, 5 and 6 through one point, at zero the forearm level with axis 6 in line with it. Of an arm that leans over backwards (B)
the elbow's letter is not used: no public source says whether "above" turns round with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.programs.axes import Axes
from aridcal.robot.chain import Robot
from aridcal.robot.kinematics import joint_frames, rotations

STRAIGHT = 1e-3
"""Sines and cosines of axes that count as parallel or across: descriptions round them to five digits."""

MEETING = 1e-3
"""[m] within which three axes of a wrist meet: nominal ones do exactly."""

LEAST = 0.05
"""[m] by which the wrist is in front of axis 1 at zero, so that front is known."""

EITHER = 1e-3
"""[rad], or shares of a length: so close to where a letter changes either is right, for numbers are rounded."""

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Posture:
    """How an arm stands, in FANUC's letters.

    Attributes:
        robot: The nominal arm.
        arm: Reading of each of its six axes.
        joints: The joint of each.
        front: Where the wrist is seen from axis 1 at zero, level, in the base frame, shape (3,).
        wrist: The wrist's centre in the frame of joint 5 before it turns, shape (3,).
        lifts: 1 where joint 5 lifts the flange as it grows, -1 where it lowers it.
    """

    robot: Robot
    arm: tuple[int, ...]
    joints: tuple[int, ...]
    front: np.ndarray
    wrist: np.ndarray
    lifts: float

    def decides(self, letters: str) -> bool:
        """Whether each letter is used."""
        return letters[2] == "T"

    def fits(self, letters: str, readings: np.ndarray) -> bool:
        """Whether readings, shape (columns,), agree with letters, ``NUT`` for instance."""
        wrist, elbow, side = letters[0], letters[1], letters[2]
        bend = self.lifts * np.sin(
            readings[self.arm[4]]
        )  # beyond half a turn the flange comes round from the other side
        if abs(bend) > EITHER and (bend > 0) != (wrist == "F"):
            return False
        axes, origins = joint_frames(self.robot, readings[None])
        axes, origins = axes[0, self.joints], origins[0, self.joints]
        centre = origins[4] + axes[4] @ self.wrist
        turn = self.robot.joints[self.joints[0]].axis
        front = rotations(axes[0] @ turn, readings[self.arm[0] : self.arm[0] + 1])[0] @ self.front
        ahead = float((centre - origins[0]) @ front)
        if abs(ahead) > EITHER and (ahead > 0) != (side == "T"):
            return False
        if side != "T":
            return True
        line = np.array([(centre - origins[1]) @ front, (centre - origins[1]) @ UP])
        arm = np.array([(origins[2] - origins[1]) @ front, (origins[2] - origins[1]) @ UP])
        above = float(line[0] * arm[1] - line[1] * arm[0]) / float(np.linalg.norm(line) * np.linalg.norm(arm))
        return bool(abs(above) < EITHER or (above > 0) == (elbow == "U"))


def posture_of(robot: Robot, axes: Axes) -> Posture | None:
    """The letters' meaning for an arm; None where they have none, or its zero is another one."""
    if len(axes.arm) != 6 or any(axes.kinds[k] == "prismatic" for k in axes.arm):
        return None
    columns = [robot.readings.index(joint.reading) for joint in robot.joints]
    joints = tuple(columns.index(k) for k in axes.arm)
    if len(columns) != len(set(columns)):
        return None
    frames, origins = joint_frames(robot, np.zeros((1, len(robot.readings))))
    bearing, o = frames[0, joints], origins[0, joints]
    a = np.array([R @ robot.joints[k].axis for R, k in zip(bearing, joints, strict=True)])
    along = [abs(a[0] @ UP), abs(a[1] @ a[2]), abs(a[2] @ a[4]), abs(a[3] @ a[5])]
    across = [a[0] @ a[1], a[3] @ UP, a[3] @ a[4], a[3] @ a[2]]
    if min(along) < 1.0 - STRAIGHT or np.abs(across).max() > STRAIGHT:
        return None
    centre = o[4] + a[4] * float((o[3] - o[4]) @ a[4])  # of axis 5, nearest to axis 4
    if any(np.linalg.norm(np.cross(centre - o[k], a[k])) > MEETING for k in (3, 5)):
        return None
    ahead = (centre - o[0]) * [1.0, 1.0, 0.0]
    out = a[3] * np.sign((centre - o[2]) @ a[3])  # from the elbow to the wrist, and on to the flange
    lifts = float(np.sign(np.cross(a[4], out) @ UP))
    if np.linalg.norm(ahead) < LEAST or lifts == 0 or ahead @ out <= 0:
        return None
    return Posture(robot, axes.arm, joints, ahead / np.linalg.norm(ahead), bearing[4].T @ (centre - o[4]), lifts)
