"""An arm of six axes as makers draw it: base axis, two parallel axes that lean, and a wrist whose three axes meet.

All that their words for a posture ask of such an arm is seen in its plane, which turns with axis 1: where the wrist's centre is,

.. math:: c = l + u e^{-i q_2} + f e^{-i (q_2 + q_3)}

in complex numbers, real in front of axis 1, imaginary up; l is how far axis 2 is in front of axis 1, u leads from axis 2 to axis
3, and f from there to the wrist's centre; angles are those that the controller shows, and grow where the arm leans forward.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import joint_frames
from aridcal.jobs.apply.programs.axes import DEGREE, MILLIMETRE, Axes

STRAIGHT = 1e-3
"""Sines and cosines of axes that count as parallel or across: descriptions round them to five digits."""

MEETING = 1e-3
"""[m] within which three axes of a wrist meet: nominal ones do exactly."""

LEAST_WRIST_OFFSET = 0.05
"""[m] by which the wrist is in front of axis 1 at zero, so that front is known."""


@dataclass(frozen=True)
class Anatomy:
    """An arm in its plane; see the module.

    Attributes:
        lead: How far axis 2 is in front of axis 1, [m].
        upper: From axis 2 to axis 3 where the controller shows zero, [m].
        fore: From axis 3 to the wrist's centre, likewise.
        forearm: Which way axis 4 points there, to the wrist: of length 1.
        senses: What each axis does as its angle grows where the controller shows zero, -1 for the opposite: axis 1 turns to the
            left, 2 and 3 lean forward, 4 and 6 turn clockwise for who looks out along them, 5 bends the flange down; 0 for 5 and
            6 where the zero of the wrist is another one.
        stretched: The angle that axis 3 shows where the wrist is in line with axes 2 and 3, [rad]: KUKA's phi.
        stretches: Whether axis 3 can go there, and so bend the arm to the other side.
    """

    lead: float
    upper: complex
    fore: complex
    forearm: complex
    senses: tuple[float, ...]
    stretched: float
    stretches: bool

    def ahead(self, shown: Sequence[float]) -> float:
        """How far the wrist's centre is in front of axis 1, as a share of the arm's length; below zero: behind, overhead."""
        lean = self.senses[1] * shown[1]
        reach = self.upper * cmath.exp(-1j * lean) + self.fore * cmath.exp(-1j * (lean + self.senses[2] * shown[2]))
        return (self.lead + reach.real) / (abs(self.upper) + abs(self.fore))

    def bent(self, shown: Sequence[float]) -> float:
        """Sine of the elbow: above zero where the wrist's centre is in front of the line from axis 2 to axis 3."""
        return math.sin(self.senses[2] * (shown[2] - self.stretched))


def anatomy_of(robot: Robot, axes: Axes) -> Anatomy | None:
    """The anatomy of an arm; None where it is built otherwise, or nobody can say where its front is.

    Args:
        robot: The nominal arm.
        axes: With what its controller shows where its readings are zero.
    """
    if len(axes.arm) != 6 or any(axes.kinds[k] == "prismatic" for k in axes.arm):
        return None
    if robot.readings != robot.names:  # one that follows others, as a rod makes it, or that stands still
        return None
    joints = list(axes.arm)
    zero = np.zeros(len(robot.readings))
    zero[list(axes.arm)] = [-axes.unit(k, DEGREE, MILLIMETRE) * axes.zero(k) for k in axes.arm]
    frames, origins = joint_frames(robot, zero[None])
    bearing, o = frames[0, joints], origins[0, joints]
    a = np.array([R @ robot.joints[k].axis for R, k in zip(bearing, joints, strict=True)])
    up = (bearing[0] @ robot.joints[joints[0]].origin.rotation.T)[:, 2]  # a base's z is up, however it is mounted
    if abs(a[0] @ up) < 1.0 - STRAIGHT or abs(a[1] @ a[2]) < 1.0 - STRAIGHT or abs(a[0] @ a[1]) > STRAIGHT:
        return None
    centre = o[4] + a[4] * float((o[3] - o[4]) @ a[4])  # of axis 5, nearest to axis 4
    if any(np.linalg.norm(np.cross(centre - o[k], a[k])) > MEETING for k in (3, 5)):
        return None
    front = np.cross(a[1], up) / np.linalg.norm(np.cross(a[1], up))
    front *= np.sign((centre - o[0]) @ front) or 1.0
    side = np.cross(up, front)  # about it what is upright leans forward

    def seen(v: np.ndarray) -> complex:
        return complex(v @ front, v @ up)

    lead, upper, fore = seen(o[1] - o[0]).real, seen(o[2] - o[1]), seen(centre - o[2])
    out = a[3] * (np.sign((centre - o[2]) @ a[3]) or 1.0)
    if (
        (centre - o[0]) @ front < LEAST_WRIST_OFFSET
        or lead < -LEAST_WRIST_OFFSET
        or min(abs(upper), abs(fore)) < LEAST_WRIST_OFFSET
        or abs(out @ side) > STRAIGHT
    ):
        return None
    in_line = abs(a[4] @ side) > 1.0 - STRAIGHT and abs(a[3] @ a[5]) > 1.0 - STRAIGHT
    along = [a[0] @ up, a[1] @ side, a[2] @ side, a[3] @ out, in_line * (a[4] @ side), in_line * (a[5] @ out)]
    senses = tuple(float(np.sign(cosine)) for cosine in along)
    stretched = senses[2] * cmath.phase(fore / upper)
    low, high = robot.limits[axes.arm[2]] - zero[axes.arm[2]]
    return Anatomy(lead, upper, fore, seen(out), senses, stretched, _within(stretched, float(low), float(high)))


def _within(angle: float, low: float, high: float) -> bool:
    """Whether an angle, or one whole turns away from it, is between two others."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return True
    return low + (angle - low) % math.tau < high
