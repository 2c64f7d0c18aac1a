"""Configurations in which the arm keeps out of boxes and of itself, and lines that go past it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.collisions import Bodies, lines_touch, touches
from aridcal.engine.robot.kinematics import joint_frames, tip_frames
from aridcal.files.purposes import Box

ARM_HALF_THICKNESS = 0.05
"""[m]: half of what the thinnest arms of industrial robots measure across."""


def clear(
    robot: Robot,
    boxes: Sequence[Box],
    bodies: Bodies,
    readings: np.ndarray,
    targets: np.ndarray,
    carrier: str | None = None,
) -> np.ndarray:
    """True of configurations in which the arm touches neither boxes nor itself, shape (n,).

    The arm is at least a line from joint to joint and on to its target, which must cross no box; where the URDF has collision
    shapes, these must touch no box and not each other. Each of several limbs is such a line, to its own end.

    Args:
        robot: The chain.
        boxes: In the base's frame.
        bodies: What the URDF says of its shapes, with the boxes.
        readings: Shape (n, columns), [rad] or [m].
        targets: Where the target is in the base's frame, shape (n, 3), [m].
        carrier: The link that carries the target; None: the tip.
    """
    free = np.ones(len(readings), dtype=bool)
    for limb, columns in columns_of_limbs(robot):
        limb_readings = readings[:, columns]
        end = targets if limb.tip == (carrier or robot.tip) else tip_frames(limb, limb_readings)[1]
        points = np.concatenate([joint_frames(limb, limb_readings)[1], end[:, None]], axis=1)
        for box in boxes:
            free &= ~crosses(points[:, :-1], points[:, 1:], box).any(axis=1)
    if bodies.any:
        free[free] = ~touches(robot, bodies.geometry, readings[free]).any(axis=1)
    return free


def clear_lines(
    robot: Robot, boxes: Sequence[Box], bodies: Bodies, readings: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """True where a straight line goes past the boxes and the arm, shape (n,).

    The arm has the URDF's collision shapes; without any it is lines from joint to joint, :data:`ARM_HALF_THICKNESS` all around.

    Args:
        robot: The chain.
        boxes: In the base's frame.
        bodies: What the URDF says of its shapes.
        readings: Shape (n, columns), [rad] or [m].
        starts: In the base's frame, shape (n, 3), [m].
        ends: Likewise.
    """
    free = np.ones(len(readings), dtype=bool)
    for box in boxes:
        free &= ~crosses(starts, ends, box)
    if bodies.shaped:
        free[free] = ~lines_touch(robot, bodies.geometry, readings[free], starts[free], ends[free])
        return free
    for limb, columns in columns_of_limbs(robot):
        points = joint_frames(limb, readings[:, columns])[1]
        for k in range(points.shape[1] - 1):
            free &= apart(starts, ends, points[:, k], points[:, k + 1]) > ARM_HALF_THICKNESS
    return free


def columns_of_limbs(robot: Robot) -> Iterator[tuple[Robot, list[int]]]:
    """Each limb that moves, with the indices of the robot's columns that drive it."""
    for limb in robot.limbs:
        if limb.joints:
            yield limb, robot.columns_of(limb)


def apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Distance of two straight lines from a to b and from c to d, shape (n,), [m] (Ericson 2004, section 5.1.9).

    Args:
        a: Shape (n, 3), [m], as are the others.
        b: Likewise.
        c: Likewise.
        d: Likewise.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv = (np.maximum(np.sum(x * x, axis=1), 1e-300) for x in (u, v))
    uv, uw, vw = np.sum(u * v, axis=1), np.sum(u * w, axis=1), np.sum(v * w, axis=1)
    across = uu * vv - uv * uv
    s = np.clip(np.where(across > 1e-12 * uu * vv, (uv * vw - uw * vv) / np.maximum(across, 1e-300), 0.0), 0.0, 1.0)
    t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
    s = np.clip((uv * t - uw) / uu, 0.0, 1.0)
    return np.asarray(np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1))


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
