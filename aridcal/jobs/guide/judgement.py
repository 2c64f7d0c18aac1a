r"""Is a row good, beside all before it: its residual in sigmas of the prediction, and what explains one that is not.

A row is predicted by all before it. With its columns F and residual r in sigmas of the noise, and what is left open of the
unknowns,

.. math:: e = r - F \delta, \qquad S = s^2 (1 + F \Sigma F^T), \qquad \chi^2 = e^T S^{-1} e

where s is by how much rows so far were off more than predicted: what the model lacks makes all rows worse, and none of them bad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betainc

from aridcal.jobs.guide.posterior import Posterior

FALSE_ALARM = 1e-4
"""Probability of a good row to be called off. Of several tests of a row together that is below one in 500, for noise with tails
somewhat heavier than normal, too."""

CLEARLY = 2.75
"""Sigmas per number that a row must be off besides: noise and what a model lacks have heavier tails than normal noise. Without
this the first 520 rows of a real UR10 (series B) gave nine alarms: rows off by 2.3 to 2.7, and four slips that nobody knows
of; with it one."""

PREDICTED_WEIGHT = 30.0
"""Numbers for which the prediction itself counts in s: what ten positions tell of it."""


@dataclass(frozen=True)
class Verdict:
    """What a row's residual says.

    Attributes:
        error: e in sigmas of the noise, shape (m,).
        spread: S, shape (m, m).
        square: chi².
        probability: Of a good row to be off by as much.
    """

    error: np.ndarray
    spread: np.ndarray
    square: float
    probability: float

    @property
    def off(self) -> bool:
        """True of a row that does not agree with those before it."""
        return self.probability < FALSE_ALARM and self.sigmas > CLEARLY

    @property
    def sigmas(self) -> float:
        """How far off it is, per number, in sigmas of the prediction."""
        return float(np.sqrt(self.square / len(self.error)))


@dataclass(frozen=True)
class Inflation:
    """By how much rows were off more than predicted.

    Attributes:
        squares: Sum of their chi² without it.
        numbers: Numbers measured.
    """

    squares: float = 0.0
    numbers: float = 0.0

    @property
    def variance(self) -> float:
        """s², at least 1: rows that agree too well prove nothing."""
        return max(1.0, (PREDICTED_WEIGHT + self.squares) / (PREDICTED_WEIGHT + self.numbers))

    def with_row(self, verdict: Verdict) -> Inflation:
        """With one more row that was good."""
        return Inflation(self.squares + verdict.square * self.variance, self.numbers + len(verdict.error))


def exceeded(square: float | np.ndarray, numbers: int | np.ndarray, freedom: float) -> np.ndarray:
    """Probability of the F distribution beyond a chi² over its numbers (DLMF 8.17.5 and 8.17.4)."""
    return np.asarray(betainc(freedom / 2.0, np.asarray(numbers) / 2.0, freedom / (freedom + square)))


def verdict(posterior: Posterior, F: np.ndarray, r: np.ndarray, inflation: Inflation) -> Verdict:
    """Judge a row by its columns (m, D) and residual (m,), numbers that it does not measure left out."""
    measured = np.any(F != 0.0, axis=1)
    F, r = F[measured], r[measured]
    error = r - F @ posterior.step
    spread = inflation.variance * (np.eye(len(r)) + F @ posterior.covariance @ F.T)
    square = float(error @ np.linalg.solve(spread, error))
    freedom = PREDICTED_WEIGHT + inflation.numbers
    return Verdict(error, spread, square, float(exceeded(square, len(r), freedom)))


def beside_others(posterior: Posterior, F: np.ndarray, r: np.ndarray, inflation: Inflation) -> np.ndarray:
    """Probability of each row in use to be off as much as it is beside all others, shape (N,); 1 of rows not clearly off.

    Args:
        posterior: Of all rows.
        F: Columns of all rows, shape (N, m, D).
        r: Their residuals, shape (N, m).
        inflation: See :class:`Inflation`.
    """
    square = left_out_squares(posterior, F, r) / inflation.variance
    count = np.any(F != 0.0, axis=2).sum(axis=1)
    count = np.maximum(count, 1)
    probability = exceeded(square, count, PREDICTED_WEIGHT + inflation.numbers)
    return np.where(np.sqrt(square / count) > CLEARLY, probability, 1.0)


def left_out_squares(posterior: Posterior, F: np.ndarray, r: np.ndarray) -> np.ndarray:
    """chi² of each row beside all others, shape (N,); see :func:`beside_others`."""
    own = np.einsum("nid,de,nje->nij", F, posterior.covariance, F, optimize=True)
    error = r - F @ posterior.step
    inner = np.eye(F.shape[1]) - own
    # chi² of a row that is left out: e' (1 - H)^-1 e, as e / (1 - H) has the covariance 1 / (1 - H)
    values, vectors = np.linalg.eigh(inner)
    along = np.einsum("nij,ni->nj", vectors, error)
    return np.asarray(np.sum(along**2 / np.maximum(values, 1e-9), axis=1))
