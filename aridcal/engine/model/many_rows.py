r"""Poses and twists of many rows at once: what stands still in all of them is walked once, and only what moves row by row.

The constants of an arm make some fifty joints of its extended model, of which a handful move. Between two of those everything is
one placement, and the twist of each joint is that of a fixed screw :math:`(v, w)` in the frame of the last one that moved. At the
target t, with R and p the axes and place of that frame in a row,

.. math:: \omega = R w, \qquad \nu = R v + (p - t) \times R w

(Lynch and Park 2017, Modern Robotics, section 5.1). Pinocchio walks every joint in every row, which a block of rows need not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from aridcal.engine.model.joint_motions import Motion
from aridcal.engine.robot.kinematics import transverse

LEAST_TOGETHER = 40
"""Rows from which they are walked together: 0.3 ms and 0.5 us a row. Pinocchio takes 2 us a row, and 2 ms or more for a model,
of which few questions are asked as a rule."""

ROWS_PER_BLOCK = 2048
"""Rows walked or differentiated at a time: all that is made on the way stays in the cache, and memory stays flat."""


def blocks(n: int) -> list[slice]:
    """Stretches of n rows that are worked on at a time; a last stretch too short to be walked together joins the one before."""
    begins = range(0, max(n - LEAST_TOGETHER + 1, min(n, 1)), ROWS_PER_BLOCK)
    return [slice(start, n if start == begins[-1] else start + ROWS_PER_BLOCK) for start in begins]


def short_stretches(n: int) -> list[slice]:
    """Stretches of n rows that are walked one by one: a row's numbers must not depend, by a digit, on the rows beside it."""
    return [slice(start, start + LEAST_TOGETHER - 1) for start in range(0, max(n, 1), LEAST_TOGETHER - 1)]


class JointArrays(NamedTuple):
    """Joints one after the other, nv of them.

    Attributes:
        placement: Of each on the one before, shape (nv, 4, 4).
        vector: Unit vectors of their motions, shape (nv, 3).
        turns: Which joints turn about their vector, shape (nv,) bool; the others slide along it.
        across: Axes whose z is that unit vector, shape (nv, 3, 3).
    """

    placement: np.ndarray
    vector: np.ndarray
    turns: np.ndarray
    across: np.ndarray


class MovingFrame(NamedTuple):
    """A frame that moves from row to row: the axes and the origin of a joint after its motion. Rows come last: so they lie.

    Attributes:
        axes: Its axes, each three numbers in the world, shape (3, 3, n).
        origin: Shape (3, n), [m].
        part: Coordinates of the joints that follow up to the next that moves, that one included.
        screws: Of these joints in this frame, (v, w) in columns, shape (6, k).
    """

    axes: np.ndarray
    origin: np.ndarray
    part: slice
    screws: np.ndarray


def stepped(joints: Sequence[tuple[pin.SE3, Motion]]) -> JointArrays:
    """Joints as arrays, from the placement of each on the one before and its motion."""
    vector = np.array([move[0] for _, move in joints])
    e1, _ = transverse(vector)
    return JointArrays(
        placement=np.array([placement.homogeneous for placement, _ in joints]),
        vector=vector,
        turns=np.array([move[1] for _, move in joints], dtype=bool),
        across=np.stack([e1, np.cross(vector, e1), vector], axis=2),
    )


def walk_joints(
    joints: JointArrays, q: np.ndarray, target: np.ndarray
) -> tuple[list[MovingFrame], np.ndarray, np.ndarray]:
    """Walk the joints.

    Args:
        joints: nv of them.
        q: Their coordinates in n rows, shape (n, nv).
        target: On the last joint, shape (4, 4).

    Returns:
        The frames that move, in the order of the chain, the world's own as the first; and axes (n, 3, 3) and place (n, 3) of
        the target. The last frame has its origin there: what turns about the target moves it by nothing, not by a rounding.
    """
    n, nv = q.shape
    moves = np.any(q != q[0], axis=0)
    placements, screws, end = _between(joints, np.where(moves, 0.0, q[0]), moves)
    axes, origin = np.repeat(np.eye(3)[:, :, None], n, axis=2), np.zeros((3, n))
    frames, first = [], 0
    for k in np.flatnonzero(moves).tolist():
        frames.append(MovingFrame(axes, origin, slice(first, k + 1), screws[:, first : k + 1]))
        first = k + 1
        origin = origin + _along(axes, placements[k, :3, 3])
        axes = _along(axes, placements[k, :3, :3] @ joints.across[k])
        if joints.turns[k]:
            c, s = np.cos(q[:, k]), np.sin(q[:, k])
            axes[0], axes[1] = c * axes[0] + s * axes[1], c * axes[1] - s * axes[0]
        else:
            origin += q[:, k] * axes[2]
    end = end @ target
    place, last = origin + _along(axes, end[:3, 3]), screws[:, first:].copy()
    last[:3] -= np.cross(end[:3, 3], last[3:].T).T
    frames.append(MovingFrame(axes, place, slice(first, nv), last))
    return frames, _along(axes, end[:3, :3]).transpose(2, 1, 0), place.T


def twists(frames: Sequence[MovingFrame], target: np.ndarray) -> np.ndarray:
    """Twists of the target in world axes by each joint, shape (n, 6, nv): linear, then angular. In memory rows run fastest.

    Args:
        frames: Those that move; see :func:`walk_joints`.
        target: Where the target is, shape (n, 3), [m].
    """
    n = len(target)
    columns = np.empty((frames[-1].part.stop, 6 * n))
    levers = np.empty((6, 3, n))  # the axes, and what the target does where a frame turns about each of them
    for axes, origin, part, screws in frames:
        x, y, z = origin - target.T
        levers[:3], by = axes, levers[3:]
        by[:, 0] = y * axes[:, 2] - z * axes[:, 1]
        by[:, 1] = z * axes[:, 0] - x * axes[:, 2]
        by[:, 2] = x * axes[:, 1] - y * axes[:, 0]
        np.matmul(screws.T, levers.reshape(6, -1), out=columns[part, : 3 * n])
        np.matmul(screws[3:].T, axes.reshape(3, -1), out=columns[part, 3 * n :])
    return columns.reshape(-1, 6, n).transpose(2, 1, 0)


def _between(joints: JointArrays, value: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where all joints are in the frame of the last one before them that moves.

    Args:
        joints: nv of them.
        value: Coordinates of the joints that stand still, shape (nv,).
        moves: Which joints move, shape (nv,) bool.

    Returns:
        The joints' placements, shape (nv, 4, 4); their screws (v, w), shape (6, nv); and the end of the last one, shape (4, 4).
    """
    onwards = joints.placement @ _still_transforms(joints, value)
    before, here = np.empty_like(onwards), np.eye(4)
    for k, moving in enumerate(moves.tolist()):
        before[k] = here
        if moving:
            here = np.eye(4)
            here[:3, :3] = joints.across[k].T
        else:
            here = here @ onwards[k]
    placements = before @ joints.placement
    axis, at = (placements[:, :3, :3] @ joints.vector[:, :, None])[:, :, 0], placements[:, :3, 3]
    turns = joints.turns[:, None]
    # As np.cross has it, which takes longer than all else here.
    across = at[:, [1, 2, 0]] * axis[:, [2, 0, 1]] - at[:, [2, 0, 1]] * axis[:, [1, 2, 0]]
    v = np.where(turns, across, axis)
    return placements, np.hstack([v, np.where(turns, axis, 0.0)]).T, here


def _still_transforms(joints: JointArrays, value: np.ndarray) -> np.ndarray:
    """The transform of each joint that stands still, shape (nv, 4, 4), from its coordinate, shape (nv,)."""
    transforms = np.zeros((len(value), 4, 4))
    transforms[:, 3, 3] = 1.0
    transforms[:, :3, 3] = np.where(joints.turns, 0.0, value)[:, None] * joints.vector
    angle = np.where(joints.turns, value, 0.0)[:, None]
    c, s, axes = np.cos(angle), np.sin(angle), joints.across.copy()
    x, y = joints.across[:, :, 0], joints.across[:, :, 1]
    axes[:, :, 0], axes[:, :, 1] = c * x + s * y, c * y - s * x
    transforms[:, :3, :3] = axes @ joints.across.transpose(0, 2, 1)
    return transforms


def _along(axes: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Vectors in the world from their numbers along axes (3, 3, n): (3, k) numbers to (k, 3, n), (3,) numbers to (3, n)."""
    return np.asarray((numbers.T @ axes.reshape(3, -1)).reshape(*numbers.shape[1:], *axes.shape[1:]))
