"""The distance of the target from an anchor: a draw-wire, a ballbar, a distance sensor."""

from __future__ import annotations

import numpy as np

from aridcal.engine.instruments.channels import LENGTH
from aridcal.engine.instruments.kind import MeasurementKind, ResidualDerivatives, Role, States, added, points_twist

LEAST_SINGULAR = 1e-4
"""Least singular value, as a share of the largest, of equations that are solved: below it noise of a ten-thousandth of the
workspace says more than they do."""

ANCHOR = Role(
    name="anchor",
    components=("x", "y", "z", "offset", "scale"),
    units=("m", "m", "m", "m", "1"),
    size=5,
    moved=added,
    slope=None,
    identified=("x", "y", "z", "offset"),
    many=True,
)


def _residual(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """Reading minus scale |p - a| - offset, [m]."""
    (anchor,) = states
    length = np.linalg.norm(p - anchor[:, :3], axis=1)
    predicted = anchor[:, 4] * length + anchor[:, 3]
    return np.asarray(observed - predicted[:, None])


def _derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    """The residual with its derivatives: along the wire for the target, against it for the anchor."""
    (anchor,) = states
    scale = anchor[:, 4:]
    wire = p - anchor[:, :3]
    length = np.linalg.norm(wire, axis=1, keepdims=True)
    # a wire of no length has no direction: nothing moves it to first order
    along = scale * wire / np.where(length > 0.0, length, 1.0)
    by_anchor = np.concatenate([-along, np.ones_like(length), length], axis=1)
    residual = observed - (scale * length + anchor[:, 3:4])
    return ResidualDerivatives(residual, points_twist(along[:, None]), (by_anchor[:, None],))


def _located(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    r"""Multilateration: squared ranges differ from a linear function of the unknowns by nothing.

    .. math:: |p|^2 - \rho^2 = 2 p \cdot a - 2 \rho o + (o^2 - |a|^2)

    with readings divided by the scale, rho, and the offset o likewise. Where that has no single solution (four rows, or one
    distance from the anchor), the offset is held, at the state's or else at nothing. The scale is held at the state's, or else
    at one.
    """
    state = states[0][0] if len(p) else np.full(5, np.nan)
    scale = state[4] if np.isfinite(state[4]) and state[4] != 0.0 else 1.0
    offset = state[3] if np.isfinite(state[3]) else 0.0
    if not len(p):
        return np.full(5, np.nan)
    middle = p.mean(axis=0)
    centred, ranges = p - middle, observed[:, 0] / scale
    size = max(float(np.abs(centred).max()), 1e-12)
    ones = np.full(len(p), size)
    every = np.column_stack([2.0 * centred, -2.0 * ranges, ones])
    solved = plain_solution(every, np.sum(centred**2, axis=1) - ranges**2)
    if solved is not None:
        return np.array([*(solved[:3] + middle), solved[3] * scale, scale])
    shorter = ranges - offset / scale
    solved = plain_solution(every[:, [0, 1, 2, 4]], np.sum(centred**2, axis=1) - shorter**2)
    if solved is None:
        return np.full(5, np.nan)
    return np.array([*(solved[:3] + middle), offset, scale])


def plain_solution(A: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Least squares, or None where the equations have no single solution: fewer than the unknowns, or nearly dependent."""
    if len(A) < A.shape[1] or not (np.isfinite(A).all() and np.isfinite(b).all()):
        return None
    length = np.linalg.norm(A, axis=0)
    if not (length > 0.0).all():
        return None
    U, singular, Vt = np.linalg.svd(A / length, full_matrices=False)
    if singular[-1] < LEAST_SINGULAR * singular[0]:
        return None
    return np.asarray((Vt.T @ ((U.T @ b) / singular)) / length)


DISTANCE = MeasurementKind(
    "distance",
    "the target's distance from an anchor",
    (LENGTH,),
    ("distance",),
    (ANCHOR,),
    _residual,
    _derivatives,
    _located,
)
