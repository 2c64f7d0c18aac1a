"""How languages write a pose: UR's rotation vector, KUKA's A B C, ABB's quaternion, W P R of FANUC, Rx Ry Rz of Yaskawa.

One pose, or many at once.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.jobs.apply.programs.targets import Notation

MILLI = 1e-3


def pose(position: np.ndarray, rotation: Rotation) -> np.ndarray:
    """Transforms of shape (..., 4, 4) from positions (..., 3), [m], and rotations."""
    T = np.zeros((*position.shape[:-1], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = rotation.as_matrix(), position, 1.0
    return T


def inverse(T: np.ndarray) -> np.ndarray:
    """The inverses of transforms, shape (..., 4, 4)."""
    T_inverse, back = np.zeros_like(T), np.swapaxes(T[..., :3, :3], -1, -2)
    T_inverse[..., :3, :3], T_inverse[..., :3, 3] = back, -(back @ T[..., :3, 3:])[..., 0]
    T_inverse[..., 3, 3] = 1.0
    return T_inverse


def _euler(
    order: Literal["ZYX"], reverse: bool
) -> tuple[Callable[[np.ndarray], np.ndarray], Callable[..., np.ndarray]]:
    """Millimetres and three angles in degrees.

    Args:
        order: Of scipy: capital letters turn about moved axes.
        reverse: The angles stand in the reverse of that order.
    """
    step = -1 if reverse else 1

    def to_pose(values: np.ndarray) -> np.ndarray:
        return pose(MILLI * values[..., :3], Rotation.from_euler(order, values[..., 3:][..., ::step], degrees=True))

    def to_numbers(T: np.ndarray, before: np.ndarray) -> np.ndarray:
        with warnings.catch_warnings():  # scipy's remark on angles that are not unique: the last is zero then
            warnings.simplefilter("ignore", UserWarning)
            angles = Rotation.from_matrix(T[..., :3, :3]).as_euler(order, degrees=True)
        # Three angles say what other three say, too: the middle one beyond a right angle, the outer two half a turn on.
        other = angles * [1.0, -1.0, 1.0] + 180.0
        first, second = (_nearest_turn(a[..., ::step], before[..., 3:]) for a in (angles, other))
        off, off_other = (np.sum((a - before[..., 3:]) ** 2, axis=-1, keepdims=True) for a in (first, second))
        return np.concatenate([T[..., :3, 3] / MILLI, np.where(off <= off_other, first, second)], axis=-1)

    return to_pose, to_numbers


def _nearest_turn(angles: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Angles in degrees, turned by whole turns to be nearest to others."""
    return np.asarray(angles + 360.0 * np.round((before - angles) / 360.0))


def _from_rotation_vector(values: np.ndarray) -> np.ndarray:
    return pose(values[..., :3], Rotation.from_rotvec(values[..., 3:]))


def _to_rotation_vector(T: np.ndarray, before: np.ndarray) -> np.ndarray:
    vector = Rotation.from_matrix(T[..., :3, :3]).as_rotvec()
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    length = np.where(angle > 0.0, angle, 1.0)
    # A whole turn more or less about the same axis turns alike.
    along = np.sum(before[..., 3:] * vector, axis=-1, keepdims=True) / length
    vector = vector * (1.0 + math.tau * np.round((along - angle) / math.tau) / length)
    return np.concatenate([T[..., :3, 3], vector], axis=-1)


def _from_quaternion(values: np.ndarray) -> np.ndarray:
    return pose(MILLI * values[..., :3], Rotation.from_quat(values[..., 3:], scalar_first=True))


def _to_quaternion(T: np.ndarray, before: np.ndarray) -> np.ndarray:
    quaternion = Rotation.from_matrix(T[..., :3, :3]).as_quat(scalar_first=True)
    sign = np.where(np.sum(quaternion * before[..., 3:], axis=-1, keepdims=True) >= 0.0, 1.0, -1.0)
    return np.concatenate([T[..., :3, 3] / MILLI, sign * quaternion], axis=-1)


UR = Notation(_from_rotation_vector, _to_rotation_vector, (7,) * 3 + (6,) * 3)
"""p[x, y, z, rx, ry, rz]: metres and a rotation vector in radians."""

KUKA = Notation(*_euler("ZYX", reverse=False), (4,) * 3 + (5,) * 3)
"""X Y Z A B C: millimetres; A about z, B about the new y, C about the newest x, degrees."""

ABB = Notation(_from_quaternion, _to_quaternion, (4,) * 3 + (8,) * 4)
"""[x, y, z], [q1, q2, q3, q4]: millimetres and a quaternion, its scalar first."""

FANUC = Notation(*_euler("ZYX", reverse=True), (3,) * 6)
"""X Y Z W P R: millimetres; R about z, P about the new y, W about the newest x, degrees. The controller writes three digits."""

YASKAWA = Notation(*_euler("ZYX", reverse=True), (3,) * 3 + (4,) * 3)
"""X Y Z Rx Ry Rz: millimetres; Rz about z, Ry about the new y, Rx about the newest x, degrees; three and four digits."""
