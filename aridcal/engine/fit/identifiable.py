"""Which coefficients are identifiable: a rank-revealing QR in a fixed order, every redundancy named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse.linalg import LinearOperator, eigsh

REDUNDANT_SHARE = 1e-7
"""Share of a column's length that is left off the others when it is called their sum: redundant columns of real robots keep
1e-14 of it, identifiable ones 1e-2."""

CLEARLY_IDENTIFIABLE = 0.02
"""The same for a column that is identifiable beyond doubt: where axes are parallel but for a milliradian, less is left."""

CARRIES = 0.3
"""Share of the largest part in a weak combination that makes a column one of those that may go: the last of them goes, so
that the order of preference holds."""

MANY_COLUMNS = 100
"""Work: Columns from which the weakest combination is looked for without all others."""

REDUNDANT_SIGMA = 0.02
"""[m] and [rad]: a direction that the noise moves further than 20 mm or 20 mrad is redundant."""


@dataclass(frozen=True)
class Subset:
    """The coefficients that are kept, and why the others are not.

    Attributes:
        independent: Indices of the coefficients that are fitted, in the order of preference.
        redundant: For each dropped index, the kept indices that it is confounded with; empty if it moves nothing.
        condition: Of the kept columns, each scaled to length 1.
    """

    independent: tuple[int, ...]
    redundant: dict[int, tuple[int, ...]]
    condition: float


def identifiable(R: np.ndarray, order: Sequence[int], ahead: Sequence[int] = ()) -> Subset:
    """Keep columns in the order of preference as long as each adds something that can be measured.

    A column clearly apart from those before it is kept first, and only then one that barely is: where two axes are parallel
    but for a milliradian, the shift of one along itself hardly differs from that of the other, and must not push out
    a column that is well known.

    Args:
        R: Triangle of the Jacobian's QR in units of sigma, shape (<= K, K): column k per [m] or [rad] of coefficient k.
        order: All indices, those to be kept before others first.
        ahead: Indices to keep before all others, if they can be measured at all.
    """
    length = np.linalg.norm(R, axis=0)
    kept = _extended(R, length, [], ahead, REDUNDANT_SHARE)
    for share in (CLEARLY_IDENTIFIABLE, REDUNDANT_SHARE):
        kept = _extended(R, length, kept, order, share)
    kept = _without_weak(R, length, kept, order)
    scaled = R[:, kept] / length[kept]
    singular = np.linalg.svd(scaled, compute_uv=False) if kept else np.ones(1)
    dropped = [k for k in order if k not in kept]
    kept = [k for k in order if k in kept]
    return Subset(tuple(kept), _partners(R, dropped, kept, length), float(singular[0] / singular[-1]))


def apart(R: np.ndarray, first: int) -> np.ndarray:
    """Which columns behind the first ones are no sums of the first, as far as that can be measured, shape (K - first,) bool.

    Only these can be identifiable when further columns are in the model.

    Args:
        R: As for :func:`identifiable`, shape (<= K, K).
        first: Number of the first columns.
    """
    Q = np.linalg.qr(R[:, :first])[0]
    rest = R[:, first:] - Q @ (Q.T @ R[:, first:])
    rest -= Q @ (Q.T @ rest)
    length = np.linalg.norm(rest, axis=0)
    return np.asarray((length > REDUNDANT_SHARE * np.linalg.norm(R[:, first:], axis=0)) & _is_measurable(length))


def _is_measurable(length: float | np.ndarray) -> bool | np.ndarray:
    """Whether the noise moves a direction of so many sigmas per [m] or [rad] by less than :data:`REDUNDANT_SIGMA`."""
    return length * REDUNDANT_SIGMA >= 1.0


def _extended(
    R: np.ndarray, length: np.ndarray, columns: list[int], candidates: Sequence[int], share: float
) -> list[int]:
    """Kept columns and the candidates of which more than a share of their length is new and can be measured.

    Gram-Schmidt, twice for each column, so that the new part is right to rounding.
    """
    basis, columns = np.empty((len(R), R.shape[1])), list(columns)
    first = np.linalg.qr(R[:, columns])[0]
    basis[:, : first.shape[1]], count = first, first.shape[1]
    for k in candidates:
        if k in columns:
            continue
        Q = basis[:, :count]
        rest = R[:, k] - Q @ (Q.T @ R[:, k])
        rest -= Q @ (Q.T @ rest)
        new_length = float(np.sqrt(rest @ rest))
        if new_length > share * length[k] and _is_measurable(new_length):
            columns.append(k)
            basis[:, count], count = rest / new_length, count + 1
    return columns


def _without_weak(R: np.ndarray, length: np.ndarray, kept: list[int], order: Sequence[int]) -> list[int]:
    r"""Kept columns without one of each combination that moves almost nothing, though each column by itself does.

    The triangle :math:`Q^T R` of all columns, the kept ones first, is kept up to date by reflections as a column goes and others
    take its place.
    """
    columns = [*kept, *(k for k in order if k not in kept)]
    count = len(kept)
    T = np.linalg.qr(R[:, kept], mode="complete")[0].T @ R[:, columns]
    while count:
        moved, direction = _weakest(T[:count, :count])
        if _is_measurable(moved):
            break
        part = np.abs(direction)
        gone = int(np.flatnonzero(part > CARRIES * part.max())[-1])
        T, count = np.delete(T, gone, axis=1), count - 1
        del columns[gone]
        rows = slice(gone, count + 1)
        T[rows, gone:] = np.linalg.qr(T[rows, gone:count], mode="complete")[0].T @ T[rows, gone:]
        for k in range(count, len(columns)):
            new_length = float(np.linalg.norm(T[count:, k]))
            if new_length > REDUNDANT_SHARE * length[columns[k]] and _is_measurable(new_length):
                columns.insert(count, columns.pop(k))
                T[:, count : k + 1] = np.roll(T[:, count : k + 1], 1, axis=1)
                T[count:, count:] = np.linalg.qr(T[count:, count : count + 1], mode="complete")[0].T @ T[count:, count:]
                count += 1
    return columns[:count]


def _weakest(T: np.ndarray) -> tuple[float, np.ndarray]:
    r"""Smallest singular value of a triangle (k, k) that is not singular, and its direction, shape (k,).

    Of many columns it is the largest eigenvalue of :math:`(T^T T)^{-1}`, by Lanczos's method, in a tenth of the time of them all.
    """
    k = len(T)
    if k < MANY_COLUMNS:
        _, singular, Vt = np.linalg.svd(T)
        return float(singular[-1]), Vt[-1]

    def solved(x: np.ndarray) -> np.ndarray:
        return np.asarray(solve_triangular(T, solve_triangular(T, x, trans=1, check_finite=False), check_finite=False))

    value, vector = eigsh(LinearOperator((k, k), matvec=solved, dtype=float), k=1, v0=np.ones(k))
    return float(value[0] ** -0.5), vector[:, 0]


def _partners(R: np.ndarray, dropped: list[int], columns: list[int], length: np.ndarray) -> dict[int, tuple[int, ...]]:
    """For each dropped column, the kept columns whose sum imitates it; none if it moves nothing."""
    moving = [k for k in dropped if columns and _is_measurable(length[k])]
    partners: dict[int, tuple[int, ...]] = dict.fromkeys(dropped, ())
    if moving:
        shares = np.linalg.lstsq(R[:, columns] / length[columns], R[:, moving] / length[moving], rcond=None)[0]
        for k, share in zip(moving, shares.T, strict=True):
            largest_first = np.argsort(-np.abs(share))
            partners[k] = tuple(columns[i] for i in largest_first if abs(share[i]) > CLEARLY_IDENTIFIABLE)
    return partners
