r"""Did the tripod or the target move between two rows: hypotheses on the last few rows, weighed against each other.

Beside "nothing happened" stand: since one of these rows a frame is elsewhere by an unknown twist; some of the rows are bad,
each by itself. With e the errors of the rows as the rows before them predict these, and S their covariance, each hypothesis
adds to S what it allows: :math:`d^2 G G^T` for a frame that moves the rows by G, a large variance for bad rows. What it allows
in vain it pays for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

SIZES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
"""[m] and [rad] by which things slip: from what a good tracker barely sees to a kick against the tripod."""

BAD_SIZES = (5.0, 30.0, 300.0, 1e4)
"""Sigmas by which bad rows are off."""

MOVES, IS_BAD = 1e-3, 1e-2
"""How often it happens, a row: one campaign in ten has a slip, one row in a hundred is bad."""

SURE = float(np.log(20.0))
"""Logarithm of the odds from which a slip is told: 20 to 1 against the best of all others."""


@dataclass(frozen=True)
class FrameMovement:
    """A frame that moved.

    Attributes:
        first: Number of the first row after it, among those looked at.
        frames: Those that may have: one, or several that the rows do not tell apart.
        odds: Logarithm of the odds against all other explanations.
        size: By how much, of :data:`SIZES`, [m] and [rad].
    """

    first: int
    frames: tuple[str, ...]
    odds: float
    size: float


def movement(
    errors: Sequence[np.ndarray], spread: np.ndarray, by_frame: dict[str, np.ndarray], first: int
) -> FrameMovement | None:
    """Weigh the hypotheses for rows since a given one.

    Args:
        errors: Of the w rows, in sigmas, each of its own length.
        spread: Their joint covariance if nothing happened, shape (n, n).
        by_frame: How the numbers of all rows move with each frame, shape (n, 6), per [m] and [rad].
        first: What to call the first of the rows.
    """
    e = np.concatenate(errors)
    ends = np.cumsum([0, *map(len, errors)])
    nothing = log_density(e, spread)
    every = range(len(errors))
    bad = []
    for rows in dict.fromkeys([*combinations(every, 1), *combinations(every, 2), tuple(every)]):
        which = np.zeros(len(e))
        for k in rows:
            which[ends[k] : ends[k + 1]] = 1.0
        densities = [log_density(e, spread + np.diag(size**2 * which)) for size in BAD_SIZES]
        bad.append(log_mean(densities) + len(rows) * float(np.log(IS_BAD)))
    of_sizes = {
        name: [log_density(e, spread + size**2 * G @ G.T) for size in SIZES]
        for name, G in by_frame.items()
        if np.any(G)
    }
    if not of_sizes:
        return None
    of_frame = {name: log_mean(densities) + float(np.log(MOVES)) for name, densities in of_sizes.items()}
    best = max(of_frame.values())
    odds = best - max(nothing, *bad)
    if odds < SURE:
        return None
    frames = sorted((name for name, value in of_frame.items() if value > best - SURE), key=lambda n: -of_frame[n])
    return FrameMovement(first, tuple(frames), odds, max(SIZES[int(np.argmax(of_sizes[name]))] for name in frames))


def log_density(e: np.ndarray, S: np.ndarray) -> float:
    """Logarithm of the normal density of e with covariance S, but for a constant."""
    root = np.linalg.cholesky(S)
    scaled = np.linalg.solve(root, e)
    return float(-0.5 * scaled @ scaled - np.log(np.diag(root)).sum())


def log_mean(values: Sequence[float]) -> float:
    """Logarithm of the mean of what these are the logarithms of."""
    array = np.array(values)
    top = array.max()
    return float(top + np.log(np.mean(np.exp(array - top))))
