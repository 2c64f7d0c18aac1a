"""Is what remains noise? Repeats, neighbours, order of time and the stated noise, each asked on its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import chi2, norm

from aridcal.fit.noise import Repeats
from aridcal.inputs.channels import columns, spread
from aridcal.inputs.dataset import Dataset

SURE = 1e-3
"""Chance of a false alarm of each question. There are five at the most: one of 200 clean campaigns is called structured."""

LEAST = 0.1
"""Share of the variance below which repeatable structure is not worth a word: 5 % of the error."""

NEIGHBOURS = 4
"""Nearest configurations that a row is compared with."""

FEWEST = 16
"""Rows at the least that neighbours are sought among: with fewer, each neighbourhood is a quarter of the table."""

SHUFFLES = 400
"""Orders drawn at random that tell how much chance varies: its spread is then known to 4 %."""

Question = Literal["repeats", "neighbours", "order", "declared", "held_out", "offset", "flags"]


@dataclass(frozen=True)
class Clue:
    """One question to the residual.

    Attributes:
        question: Which.
        what: In words.
        share: Of the remaining variance that it shows to be repeatable, 0 to 1.
        p_value: If the residual were white.
    """

    question: Question
    what: str
    share: float
    p_value: float

    @property
    def tells(self) -> bool:
        """True if it shows structure worth a word."""
        return self.p_value < SURE and self.share > LEAST


def clues(rows: Dataset, residual: np.ndarray, repeats: Repeats | None, freedom: float) -> list[Clue]:
    """Ask whether residuals are white.

    Args:
        rows: The rows in use; their declared noise is asked about too.
        residual: Theirs, scaled by their relative sigmas, shape (N, m).
        repeats: Scatter of repeated configurations, if there are any.
        freedom: Share of the numbers that is left after fitting, 0 to 1.
    """
    sigma = np.array([np.sqrt(np.mean(residual[:, part] ** 2)) for part in columns(rows.channels)])
    white = residual / spread(sigma, rows.channels)
    found = []
    if repeats is not None:
        found.append(_repeated(repeats, sigma, residual.shape[1]))
    if len(white) > FEWEST:
        found.append(_neighbours(white, rows.readings))
        found.append(_order(white, rows.covariates.get("time")))
    return found + _stated(rows, sigma, len(residual) * freedom)


def _repeated(repeats: Repeats, sigma: np.ndarray, m: int) -> Clue:
    """Repeats know the noise and nothing of the model: what the residual has beyond their scatter repeats."""
    numbers = (repeats.rows - repeats.groups) * m
    share = float(np.clip(1.0 - np.mean(repeats.sigma**2 / sigma**2), 0.0, 1.0))
    p_value = float(chi2.cdf(numbers * (1.0 - share), numbers))
    return Clue("repeats", "repeats scatter less than the residual", share, p_value)


def _neighbours(white: np.ndarray, readings: np.ndarray) -> Clue:
    """Do rows at near configurations err alike? Distances in standard deviations of each joint's readings."""
    deviation = readings.std(axis=0)
    moves = deviation > 1e-9
    points = readings[:, moves] / deviation[moves]
    near = np.asarray(cKDTree(points).query(points, k=NEIGHBOURS + 1)[1])
    rows, others = np.repeat(np.arange(len(white)), NEIGHBOURS), near[:, 1:].ravel()
    return _alike("neighbours", "neighbouring configurations have similar residuals", white, rows, others)


def _order(white: np.ndarray, time: np.ndarray | None) -> Clue:
    """Do rows that follow one another err alike?"""
    order = np.argsort(time, kind="stable") if time is not None else np.arange(len(white))
    what = (
        "consecutive measurements have similar residuals"
        if time is not None
        else "consecutive rows have similar residuals"
    )
    return _alike("order", what, white, order[:-1], order[1:])


def _alike(question: Question, what: str, white: np.ndarray, first: np.ndarray, second: np.ndarray) -> Clue:
    """Correlation of pairs of rows; how much chance varies comes from shuffled rows.

    Args:
        question: Which question this answers.
        what: In words.
        white: Residuals in sigmas, shape (N, m).
        first: One row of each pair, shape (pairs,).
        second: The other.
    """
    rng = np.random.default_rng(0)

    def correlation(r: np.ndarray) -> float:
        return float(np.mean(np.einsum("nm,nm->n", r[first], r[second]))) / white.shape[1]

    seen = correlation(white)
    shuffled = np.array([correlation(white[rng.permutation(len(white))]) for _ in range(SHUFFLES)])
    z = (seen - shuffled.mean()) / max(float(shuffled.std()), 1e-12)
    return Clue(question, what, float(np.clip(seen, 0.0, 1.0)), float(norm.sf(z)))


def _stated(rows: Dataset, sigma: np.ndarray, used: float) -> list[Clue]:
    """Is the residual larger than the declared noise? ``used`` rows' worth of freedom are left."""
    found = []
    for channel, stated, seen in zip(rows.channels, rows.sigma, sigma, strict=True):
        if stated:
            numbers, ratio = channel.size * used, seen / stated
            share = float(np.clip(1.0 - ratio**-2, 0.0, 1.0))
            p_value = float(chi2.sf(numbers * ratio**2, numbers))
            found.append(Clue("declared", f"the residual exceeds the declared {channel.name} noise", share, p_value))
    return found
