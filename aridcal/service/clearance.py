"""Configurations in which the arm keeps out of boxes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aridcal.inputs.campaign import Box
from aridcal.robot.chain import Robot
from aridcal.robot.kinematics import joint_frames


def clear(robot: Robot, boxes: Sequence[Box], readings: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """True of configurations in which the arm, as lines from joint to joint and on to its target, keeps out of boxes.

    Args:
        robot: The chain.
        boxes: In the base's frame.
        readings: Shape (n, columns), [rad] or [m].
        targets: Where the target is in the base's frame, shape (n, 3), [m].
    """
    points = np.concatenate([joint_frames(robot, readings)[1], targets[:, None]], axis=1)
    good = np.ones(len(readings), dtype=bool)
    for box in boxes:
        good &= ~crosses(points[:, :-1], points[:, 1:], box).any(axis=1)
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
