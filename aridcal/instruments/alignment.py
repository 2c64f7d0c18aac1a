"""Where the robot's base is in a world in which some things are known: their places in the base frame carried to those."""

from __future__ import annotations

import numpy as np

from aridcal.instruments.distance import PLAIN
from aridcal.instruments.kind import Role
from aridcal.instruments.pixels import ON_TIP, R9, T
from aridcal.instruments.pose import nearest_rotation


def aligned(role: Role, located: np.ndarray, known: np.ndarray) -> np.ndarray | None:
    """T_world_base, shape (4, 4), that carries things from where they are in the base frame to where they are in the world.

    Points, anchors and markers need three that are not on a line, planes three whose normals are not across one line; planes
    are taken with the sides that their normals show. A board, or a camera that stands in the world, is enough alone.

    Args:
        role: Of the things.
        located: Their states in the base frame, shape (L, P); things with a NaN are left out.
        known: In the world, shape (L, P); likewise.

    Returns:
        None where these things do not determine it.
    """
    size = {"plane": 4, "board": 12, "camera": 12}.get(role.name, 3)
    both = np.isfinite(located[:, :size]).all(axis=1) & np.isfinite(known[:, :size]).all(axis=1)
    here, there = located[both], known[both]
    if role.name == "camera":
        standing = here[:, ON_TIP] < 0.5
        here, there = here[standing], there[standing]
    if role.name in ("board", "camera"):
        return _by_frames(here, there)
    return _by_planes(here, there) if role.name == "plane" else _by_points(here[:, :3], there[:, :3])


def _transform(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Homogeneous matrix of a rotation and a translation."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = R, p
    return made


def _by_frames(here: np.ndarray, there: np.ndarray) -> np.ndarray | None:
    """From frames: the mean of their rotations, and of what is left of their origins."""
    if not len(here):
        return None
    turned = there[:, R9].reshape(-1, 3, 3) @ np.swapaxes(here[:, R9].reshape(-1, 3, 3), 1, 2)
    R = nearest_rotation(turned.sum(axis=0))
    return _transform(R, (there[:, T] - here[:, T] @ R.T).mean(axis=0))


def _by_points(here: np.ndarray, there: np.ndarray) -> np.ndarray | None:
    """From points (Kabsch)."""
    if len(here) < 3:
        return None
    middle, shown = here.mean(axis=0), there.mean(axis=0)
    H = (there - shown).T @ (here - middle)
    sizes = np.linalg.svd(there - shown, compute_uv=False)
    if sizes[1] <= PLAIN * sizes[0] or not H.any():
        return None
    R = nearest_rotation(H)
    return _transform(R, shown - R @ middle)


def _by_planes(here: np.ndarray, there: np.ndarray) -> np.ndarray | None:
    """From planes: normals turn by R, and offsets grow by what the base's place is along the normal."""
    if len(here) < 3 or np.linalg.svd(there[:, :3], compute_uv=False)[2] <= PLAIN:
        return None
    R = nearest_rotation(there[:, :3].T @ here[:, :3])
    p = np.linalg.lstsq(there[:, :3], there[:, 3] - here[:, 3], rcond=None)[0]
    return _transform(R, p)
