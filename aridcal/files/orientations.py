"""How a campaign's tables hold orientations: in which columns, and as which rotations."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Literal

import numpy as np

from aridcal.engine.instruments import pose
from aridcal.files.measurement_settings import MeasurementSettings

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

POSITION_COLUMNS = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
IDENTITY = (0.0, 0.0, 0.0, 1.0)

# How far from 1 the norm of a measured quaternion may be: three decimals in the table are enough.
QUATERNION_SLACK = 1e-3

# How far from orthonormal a measured rotation matrix may be, in the product of any two of its rows: three decimals are enough.
MATRIX_SLACK = 2e-3


def column_of(quantity: str, settings: MeasurementSettings, joint_names: Collection[str]) -> str:
    """Column that holds a quantity; where a joint has its name, `columns` speaks of the joint."""
    return quantity if quantity in joint_names else settings.columns.get(quantity, quantity)


def orientation_columns(settings: MeasurementSettings, joint_names: Collection[str] = ()) -> tuple[str, ...]:
    """Columns of the campaign's orientations: three angles, nine of a matrix, or the four numbers of a quaternion."""
    return settings.orientation.own or tuple(column_of(name, settings, joint_names) for name in QUATERNION)


def turned(cells: np.ndarray, settings: MeasurementSettings) -> Rotation:
    """Rotations of Euler angles or rotation vectors, shape (N, 3), [rad], or of matrices row by row, shape (N, 9)."""
    from scipy.spatial.transform import Rotation  # slow to load, and a campaign is read without it

    if settings.orientation.matrix:
        return Rotation.from_matrix(cells.reshape(-1, 3, 3))
    return pose.turned(cells, settings.orientation.euler)


def swap_direction(
    R: np.ndarray, p: np.ndarray, inverted: Literal["pose", "orientation"] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the target in the world from those of a table that has them the other way round, and back.

    Args:
        R: Rotations, shape (N, 3, 3).
        p: Positions, shape (N, 3).
        inverted: See :class:`MeasurementSettings`.
    """
    if inverted is None:
        return R, p
    back = R.transpose(0, 2, 1)
    return back, -np.einsum("nij,nj->ni", back, p) if inverted == "pose" else p


def normalised(cells: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions of norm 1, shape (N, 4), and the norms that they had, shape (N,); no rotation where rows are not usable."""
    quaternion = np.where(usable[:, None], cells, IDENTITY)
    norm = np.linalg.norm(quaternion, axis=1)
    return quaternion / np.where(norm > 0, norm, 1)[:, None], norm


def quaternions_of_matrices(cells: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions of rotation matrices, and how far these are from rotations.

    Args:
        cells: Row by row, shape (N, 9).
        usable: Rows that have numbers, shape (N,) bool.

    Returns:
        Of the nearest rotations, shape (N, 4), and the largest difference of R R' from the identity, shape (N,); infinite where
        R mirrors. No rotation where rows are not usable.
    """
    from scipy.spatial.transform import Rotation  # as above

    R = np.where(usable[:, None], cells, np.eye(3).ravel()).reshape(-1, 3, 3)
    with np.errstate(over="ignore", invalid="ignore"):  # of cells that are refused
        off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        off = np.where(np.isfinite(off) & (np.linalg.det(R) > 0), off, np.inf)
    near = np.where((off <= MATRIX_SLACK)[:, None, None], R, np.eye(3))
    return np.asarray(Rotation.from_matrix(near).as_quat()), off
