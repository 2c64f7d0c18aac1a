"""How well the target is known now, and how many rows more a tolerance takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.trust.tolerance import CONFIDENCE, SHARE

DRAWS = 200
"""Work: Of the error: the 95th percentile of what they give is then that of 92 to 98 % of all."""

AXES = 3
"""Work: Of a place."""


@dataclass(frozen=True)
class Beside:
    """Errors of rows as those before predicted them, beyond noise and what was open: what the model lacks.

    Attributes:
        squares: Sum of squares along the axes, [m²].
        allowed: Sum of the variances of noise and prediction.
        numbers: Their number.
    """

    squares: float = 0.0
    allowed: float = 0.0
    numbers: float = 0.0

    def with_row(self, error: np.ndarray, variance: np.ndarray, kept: float) -> Beside:
        """With one more row, older ones counting less: these were predicted by a poorer model.

        Args:
            error: [m] along each axis.
            variance: Of each, noise included.
            kept: Share of what was before that still counts.
        """
        return Beside(
            kept * self.squares + float(error @ error),
            kept * self.allowed + float(variance.sum()),
            kept * self.numbers + len(error),
        )

    def drawn(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Standard deviation along an axis that these allow, drawn at random, shape (count,), [m]."""
        if self.numbers < AXES:
            return np.zeros(count)
        squares = self.squares / rng.chisquare(self.numbers, count)
        return np.sqrt(np.maximum(squares - self.allowed / self.numbers, 0.0))


def bound(columns: np.ndarray, covariance: np.ndarray, beyond: np.ndarray, off: np.ndarray | None = None) -> float:
    """What 95 % of a region keep within with 95 % confidence, [m] or [rad].

    Args:
        columns: How the target moves with the unknowns at R places, shape (R, 3, D).
        covariance: Of the unknowns, shape (D, D).
        beyond: Standard deviation along an axis of what goes beyond it, drawn, shape (draws,).
        off: What the model that will be used differs by in the unknowns, shape (D,); None: by nothing.
    """
    rng = np.random.default_rng(0)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    unknowns = root @ rng.standard_normal((len(root), len(beyond)))
    unknowns += 0.0 if off is None else off[:, None]
    errors = (columns.reshape(-1, len(root)) @ unknowns).reshape(len(columns), AXES, -1)
    direction = rng.standard_normal(errors.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    errors += direction * np.sqrt(AXES) * beyond * rng.standard_normal((len(columns), 1, len(beyond)))
    lengths = np.quantile(np.linalg.norm(errors, axis=1), SHARE, axis=0)
    return float(np.quantile(lengths, CONFIDENCE))
