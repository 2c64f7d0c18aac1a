"""How well the target is known now, and how many rows more a tolerance takes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from aridcal.engine.trust.tolerance import CONFIDENCE, SHARE

DRAWS = 200
"""Work: Of the error: the 95th percentile of what they give is then that of 92 to 98 % of all."""

AXES = 3
"""Work: Of a place."""

FORGETS = 0.97
"""Share of what earlier errors of prediction count for, a row: some thirty rows say how far off predictions are now. What a model
lacks shows more and more, as it is known better."""

SIGMAS_BEYOND = np.geomspace(1e-6, 3e-2, 120)
"""Work: [m], standard deviations that are weighed: from what no instrument sees to what nobody would calibrate."""


@dataclass(frozen=True)
class Beside:
    r"""Errors of rows as those before predicted them, beyond noise and what was open: what the model lacks.

    With :math:`e_i` the error along an axis, :math:`v_i` its variance by noise and prediction and t the standard deviation of
    what is beyond, :math:`e_i \sim N(0, v_i + t^2)`: an early row, predicted poorly, says little of t, a late one much. No
    order of size is likelier beforehand than another.

    Attributes:
        log_density: Of the errors, for each of :data:`SIGMAS_BEYOND`, shape (sigmas,).
        numbers: Their number.
        variance: Of the last row's errors by noise and prediction, [m²].
    """

    log_density: np.ndarray = field(default_factory=lambda: np.zeros(len(SIGMAS_BEYOND)))
    numbers: float = 0.0
    variance: float = 0.0

    def with_row(self, error: np.ndarray, variance: np.ndarray) -> Beside:
        """With one more row.

        Args:
            error: [m] along each axis.
            variance: Of each, noise included.
        """
        density = np.sum(_log_density(error**2, variance), axis=1)
        numbers = FORGETS * self.numbers + len(error)
        return Beside(FORGETS * self.log_density + density, numbers, float(np.mean(variance)))

    def after(self, rows: int) -> Beside:
        """As it will be after so many rows more, if what is beyond the model is as large as seems likeliest now."""
        mass = np.cumsum(np.exp(self.log_density - self.log_density.max()))
        likely = SIGMAS_BEYOND[np.searchsorted(mass, 0.5 * mass[-1])]
        kept = FORGETS**rows
        more = AXES * (1.0 - kept) / (1.0 - FORGETS)
        density = more * _log_density(np.array([self.variance + likely**2]), np.array([self.variance]))[:, 0]
        return Beside(kept * self.log_density + density, kept * self.numbers + more, self.variance)

    def drawn(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Standard deviation along an axis that these allow, drawn at random, shape (count,), [m]."""
        if self.numbers < AXES:
            return np.zeros(count)
        density = np.exp(self.log_density - self.log_density.max())
        mass = np.cumsum(density)
        return SIGMAS_BEYOND[np.searchsorted(mass, rng.random(count) * mass[-1])]


def _log_density(squares: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Of errors with some squares, for each of :data:`SIGMAS_BEYOND`, less that for nothing beyond, shape (sigmas, errors)."""
    wide = variance + SIGMAS_BEYOND[:, None] ** 2
    return np.asarray(-0.5 * (np.log(wide / variance) + squares / wide - squares / variance))


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
