"""The plane that an arm is mounted on: whoever states no `design.keep_out` does not want plans that go through it."""

from __future__ import annotations

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import joint_frames
from aridcal.jobs.plan.clearance import ARM_HALF_THICKNESS

UPRIGHT_COSINE = 0.999
"""Cosine of the angle between the first turning axis and the base's z, from which on that z counts as the mount's normal."""


def mounting_side(robot: Robot) -> float:
    """On which side of the plane z = 0 of its base an arm stands: 1 above, -1 below; 0 where no such plane is known.

    The plane is known where the first turning joint stands upright on it, as of arms on a pedestal, a rail, a ceiling, and the
    joint after that is away from it by more than an arm is thick: some descriptions have the base's origin in the shoulder.

    Args:
        robot: The nominal chain.
    """
    turning = _turning(robot)
    if not turning or turning[0] + 1 >= len(robot.joints):
        return 0.0
    frames, origins = joint_frames(robot, np.zeros((1, len(robot.readings))))
    first = turning[0]
    axis = frames[0, first] @ robot.joints[first].axis
    height = float(origins[0, first + 1, 2])
    return float(np.sign(height)) if abs(axis[2]) > UPRIGHT_COSINE and abs(height) > ARM_HALF_THICKNESS else 0.0


def keeps_above(robot: Robot, side: float, readings: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """True of configurations in which arm and target keep on their side of the mounting plane, shape (n,).

    Joints from the second on keep off it by half an arm's thickness; the target may touch it.

    Args:
        robot: The chain.
        side: See :func:`mounting_side`.
        readings: Shape (n, columns), [rad] or [m].
        targets: Where the target is in the base's frame, shape (n, 3), [m].
    """
    first = _turning(robot)[0]
    heights = side * joint_frames(robot, readings)[1][:, first + 1 :, 2]
    return np.asarray((heights > ARM_HALF_THICKNESS).all(axis=1) & (side * targets[:, 2] >= 0.0))


def _turning(robot: Robot) -> list[int]:
    """Joints that turn, base to tip."""
    return [k for k, joint in enumerate(robot.joints) if joint.kind != "prismatic" and joint.drive.factors]
