"""Which coefficients can be told apart: a rank-revealing QR in a fixed order, every redundancy named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

TOLERANCE = 1e-7  # what is left of a column, relative to its length, when it is called a sum of others
SHARE = 0.02  # a column takes part in a redundancy if it carries at least this share of it
WORST = 0.02  # [m] and [rad]: a direction that the noise moves further than 20 mm or 20 mrad is redundant


@dataclass(frozen=True)
class Subset:
    """The coefficients that are kept, and why the others are not.

    Attributes:
        kept: Indices, in the order given.
        redundant: For each dropped index, the kept indices that it cannot be told from; empty if it moves nothing.
        condition: Of the kept columns, each scaled to length 1.
    """

    kept: tuple[int, ...]
    redundant: dict[int, tuple[int, ...]]
    condition: float


def identifiable(R: np.ndarray, order: Sequence[int]) -> Subset:
    """Keep columns in the order given as long as each adds something that can be measured.

    Args:
        R: Triangle of the Jacobian's QR in units of sigma, shape (<= K, K): column k per [m] or [rad] of coefficient k.
        order: All indices, the ones to keep before others first.
    """
    length = np.linalg.norm(R, axis=0)
    kept: list[int] = []
    dropped: list[int] = []
    Q = np.empty((len(R), 0))
    for k in order:
        column = R[:, k]
        rest = column - Q @ (Q.T @ column)
        rest -= Q @ (Q.T @ rest)
        left = float(np.linalg.norm(rest))
        if left <= TOLERANCE * length[k] or left * WORST < 1.0:
            dropped.append(k)
        else:
            kept.append(k)
            Q = np.column_stack([Q, rest / left])
    # One at a time the columns may pass although a combination of them moves almost nothing.
    while kept:
        _, s, Vt = np.linalg.svd(R[:, kept])
        if s[-1] * WORST >= 1.0:
            break
        weak = np.abs(Vt[-1])
        worst = max(i for i in range(len(kept)) if weak[i] > 0.3 * weak.max())
        dropped.append(kept.pop(worst))
    scaled = R[:, kept] / length[kept]
    s = np.linalg.svd(scaled, compute_uv=False) if kept else np.ones(1)
    return Subset(tuple(kept), _partners(R, dropped, kept, length), float(s[0] / s[-1]))


def _partners(R: np.ndarray, dropped: list[int], kept: list[int], length: np.ndarray) -> dict[int, tuple[int, ...]]:
    """For each dropped column, the kept ones whose sum imitates it; none if it moves nothing."""
    moving = [k for k in dropped if kept and length[k] * WORST >= 1.0]
    found: dict[int, tuple[int, ...]] = dict.fromkeys(dropped, ())
    if moving:
        shares = np.linalg.lstsq(R[:, kept] / length[kept], R[:, moving] / length[moving], rcond=None)[0]
        for k, share in zip(moving, shares.T, strict=True):
            found[k] = tuple(kept[i] for i in np.argsort(-np.abs(share)) if abs(share[i]) > SHARE)
    return found
