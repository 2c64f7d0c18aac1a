"""The target on a plane, or so far from it as a gauge along its normal reads: a touched plate, a dial gauge."""

from __future__ import annotations

import numpy as np

from aridcal.engine.instruments.channels import LENGTH
from aridcal.engine.instruments.distance import LEAST_SINGULAR
from aridcal.engine.instruments.kind import MeasurementKind, ResidualDerivatives, Role, States, points_twist
from aridcal.engine.robot.kinematics import along_plane

MULTIPLIER_HALVINGS = 100
"""Halvings of the interval in which a plane's multiplier lies: more than doubles resolve."""


def _moved(state: np.ndarray, change: np.ndarray) -> np.ndarray:
    r"""Turn the normal by the tilts t about two axes along the plane, and shift the plane.

    .. math:: n' = \cos|t| \, n + \frac{\sin|t|}{|t|} (t_1 e_1 + t_2 e_2) \times n
    """
    normal = state[:, :3]
    e1, e2 = along_plane(normal)
    axis = change[:, :1] * e1 + change[:, 1:2] * e2
    angle = np.linalg.norm(axis, axis=1, keepdims=True)
    turned = np.cos(angle) * normal + np.sinc(angle / np.pi) * np.cross(axis, normal)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return np.hstack([turned, state[:, 3:] + change[:, 2:]])


def _slope(state: np.ndarray, change: np.ndarray) -> np.ndarray:
    r"""Derivative of n' by the tilts, in those axes at n'.

    .. math:: dn' = -\sin|t| \frac{t \cdot dt}{|t|} n + \frac{\sin|t|}{|t|} dt \times n
        + \left( \cos|t| - \frac{\sin|t|}{|t|} \right) \frac{t \cdot dt}{|t|^2} t \times n
    """
    normal = state[:, :3]
    after = _moved(state, change)[:, :3]
    e1, e2 = along_plane(normal)
    axis = change[:, :1] * e1 + change[:, 1:2] * e2
    angle = np.linalg.norm(axis, axis=1, keepdims=True)
    sinc = np.sinc(angle / np.pi)
    safe = np.where(angle > 0.0, angle, 1.0)
    along = np.cross(axis, normal) / safe
    slope = np.zeros((len(state), 3, 3))
    slope[:, 2, 2] = 1.0
    for k, tilt_axis in enumerate((e1, e2)):
        part = change[:, k : k + 1] / safe  # t . dt / |t| for a unit step of this tilt
        by_tilt = (
            -np.sin(angle) * part * normal + sinc * np.cross(tilt_axis, normal) + (np.cos(angle) - sinc) * part * along
        )
        for row, e in enumerate(along_plane(after)):
            slope[:, row, k] = np.sum(np.cross(e, after) * by_tilt, axis=1)
    return slope


PLANE = Role(
    name="plane",
    components=("tilt_1", "tilt_2", "offset"),
    units=("rad", "rad", "m"),
    size=4,
    moved=_moved,
    slope=_slope,
    identified=("tilt_1", "tilt_2", "offset"),
    many=True,
)


def _residual(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """Reading minus height over the plane, n.p - d, [m]."""
    (plane,) = states
    height = np.sum(plane[:, :3] * p, axis=1) - plane[:, 3]
    return np.asarray(observed - height[:, None])


def _derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    """The residual with its derivatives: a tilt about e turns n by e x n."""
    normal = states[0][:, :3]
    turned = [np.sum(np.cross(e, normal) * p, axis=1) for e in along_plane(normal)]
    by_plane = np.stack([*turned, np.full(len(p), -1.0)], axis=1)
    return ResidualDerivatives(_residual(R, p, observed, states), points_twist(normal[:, None]), (by_plane[:, None],))


def _located(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    r"""The nearest plane: min :math:`|A n - b|^2` over unit vectors n, with centred places A and readings b.

    Its solution is :math:`(A^T A + \lambda) n = A^T b` with the one :math:`\lambda \ge -\sigma_3^2` for which |n| = 1 (Golub and
    Van Loan 2013, Matrix Computations, 6.2.1). Without readings that is the direction in which the places spread least, and
    its largest component is taken as positive. NaN for places on a line; and for readings at places that lie in a plane
    themselves, which two planes explain.
    """
    unknown = np.full(4, np.nan)
    if len(p) < 3 or not (np.isfinite(p).all() and np.isfinite(observed).all()):
        return unknown
    middle, level = p.mean(axis=0), float(observed.mean())
    _, spread, Vt = np.linalg.svd(np.vstack([p - middle, np.zeros((1, 3))]), full_matrices=False)
    if spread[1] <= LEAST_SINGULAR * max(spread[0], 1e-12):
        return unknown
    pull = Vt @ ((p - middle).T @ (observed[:, 0] - level))
    stiff = spread**2 - spread[2] ** 2
    low, high = abs(pull[2]), float(np.linalg.norm(pull))
    for _ in range(MULTIPLIER_HALVINGS):  # of lambda + sigma_3 squared
        half = 0.5 * (low + high)
        long = np.sum((pull / np.maximum(stiff + half, 1e-300)) ** 2) > 1.0
        low, high = (half, high) if long else (low, half)
    n = pull / np.maximum(stiff + high, 1e-300)
    flat = spread[2] <= LEAST_SINGULAR * spread[0]
    if flat and np.linalg.norm(n[:2]) > LEAST_SINGULAR:
        return unknown
    third = np.sqrt(max(1.0 - n[0] ** 2 - n[1] ** 2, 0.0))
    normal = Vt.T @ np.array([n[0], n[1], np.copysign(third, n[2])])
    if not np.any(observed) and normal[np.abs(normal).argmax()] < 0.0:
        normal = -normal
    normal /= np.linalg.norm(normal)
    return np.array([*normal, normal @ middle - level])


PLANAR = MeasurementKind(
    "plane",
    "the target's height over a plane",
    (LENGTH,),
    ("reading",),
    (PLANE,),
    _residual,
    _derivatives,
    _located,
    condition=True,
)
