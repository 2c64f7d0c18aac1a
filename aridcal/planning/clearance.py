"""Configurations in which the arm keeps out of boxes and of itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aridcal.inputs.purposes import Box
from aridcal.robot.chain import Robot
from aridcal.robot.collisions import Bodies, touches
from aridcal.robot.kinematics import joint_frames


def clear(robot: Robot, boxes: Sequence[Box], bodies: Bodies, readings: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """True of configurations in which nothing of the arm touches what it must not, shape (n,).

    The arm is at least a line from joint to joint and on to its target, and keeps out of boxes; where the URDF has collision
    shapes, so do these, and out of each other.

    Args:
        robot: The chain.
        boxes: In the base's frame.
        bodies: What the URDF says of its shapes, with the boxes.
        readings: Shape (n, columns), [rad] or [m].
        targets: Where the target is in the base's frame, shape (n, 3), [m].
    """
    points = np.concatenate([joint_frames(robot, readings)[1], targets[:, None]], axis=1)
    good = np.ones(len(readings), dtype=bool)
    for box in boxes:
        good &= ~crosses(points[:, :-1], points[:, 1:], box).any(axis=1)
    if bodies.any:
        good[good] = ~touches(robot, bodies.geometry, readings[good]).any(axis=1)
    return good


def crosses(start: np.ndarray, end: np.ndarray, box: Box) -> np.ndarray:
    """Whether straight lines have a point inside a box, shape (...): the slab test (Kay and Kajiya 1986).

    Args:
        start: Shape (..., 3), [m].
        end: Shape (..., 3), [m].
        box: In the same frame.
    """
    way = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (np.array(box.min) - start) / way, (np.array(box.max) - start) / way
    inside = (start >= box.min) & (start <= box.max)
    still = way == 0.0
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(a, b))
    leave = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(a, b))
    return np.asarray(np.maximum(enter.max(axis=-1), 0.0) <= np.minimum(leave.min(axis=-1), 1.0))
