"""Is what remains noise? Repeats, neighbours, order of time and the stated noise, each asked on its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import chi2, norm

from aridcal.outcome import Repeats
from aridcal.residual import Sigma
from aridcal.solver import Noise

SURE = 1e-3  # chance of a false alarm of each question
LEAST = 0.1  # share of the variance below which repeatable structure is not worth a word
NEIGHBOURS = 4
SHUFFLES = 400


@dataclass(frozen=True)
class Clue:
    """One question to the residual.

    Attributes:
        what: In words.
        share: Of the remaining variance that it shows to be repeatable, 0 to 1.
        p_value: If the residual were white.
    """

    what: str
    share: float
    p_value: float

    @property
    def tells(self) -> bool:
        """True if it shows structure worth a word."""
        return self.p_value < SURE and self.share > LEAST


def clues(
    residual: np.ndarray,
    readings: np.ndarray,
    time: np.ndarray | None,
    repeats: Repeats | None,
    noise: Noise,
    freedom: float,
) -> list[Clue]:
    """Ask whether residuals are white.

    Args:
        residual: Of the rows in use, scaled by their relative sigmas, shape (N, m).
        readings: Their joint readings, shape (N, columns).
        time: When they were measured, shape (N,), if that is known; else their order counts.
        repeats: Scatter of repeated configurations, if there are any.
        noise: Declared noise.
        freedom: Share of the numbers that is left after fitting, 0 to 1.
    """
    m = residual.shape[1]
    sigma = np.array([np.sqrt(np.mean(part**2)) for part in (residual[:, :3], residual[:, 3:]) if part.size])
    white = residual / np.repeat(sigma, 3)[:m]
    found = []
    if repeats is not None:
        numbers = (repeats.rows - repeats.groups) * m
        own = np.array([repeats.sigma.position, repeats.sigma.rotation])[: len(sigma)]
        share = float(np.clip(1.0 - np.mean(own**2 / sigma**2), 0.0, 1.0))
        found.append(Clue("repeats of a configuration scatter less than the residual", share,
                          float(chi2.cdf(numbers * (1.0 - share), numbers))))  # fmt: skip
    if len(white) > 4 * NEIGHBOURS:
        found.append(_neighbours(white, readings))
        found.append(_order(white, time))
    found += _stated(Sigma(*sigma, *([1.0] * (2 - len(sigma)))), noise, len(residual) * freedom, m)
    return found


def noise_notice(estimated: Sigma, noise: Noise, numbers: float, pose: bool) -> list[str]:
    """Sentences on declared noise that the residuals contradict."""
    said = []
    pairs = [("position", noise.declared_position, estimated.position)]
    pairs += [("rotation", noise.declared_rotation, estimated.rotation)] if pose else []
    for what, stated, seen in pairs:
        if stated:
            ratio = seen / stated
            spread = 4.0 / np.sqrt(2.0 * max(numbers, 1.0))
            if abs(np.log(ratio)) > max(0.2, spread):
                size = f"{ratio:.1f} times" if ratio > 1 else f"1/{1 / ratio:.1f} of"
                meaning = "something remains, or it is stated too small" if ratio > 1 else "it is stated too large"
                said.append(f"the residual shows {size} the declared {what} noise: {meaning}")
    return said


def _neighbours(white: np.ndarray, readings: np.ndarray) -> Clue:
    spread = readings.std(axis=0)
    points = readings[:, spread > 1e-9] / spread[spread > 1e-9]
    near = np.asarray(cKDTree(points).query(points, k=NEIGHBOURS + 1)[1])
    return _alike(white, np.repeat(np.arange(len(white)), NEIGHBOURS), near[:, 1:].ravel(),
                  "rows at neighbouring configurations err alike")  # fmt: skip


def _order(white: np.ndarray, time: np.ndarray | None) -> Clue:
    order = np.argsort(time, kind="stable") if time is not None else np.arange(len(white))
    what = "rows measured one after the other err alike" if time is not None else "rows next to each other err alike"
    return _alike(white, order[:-1], order[1:], what)


def _alike(white: np.ndarray, first: np.ndarray, second: np.ndarray, what: str) -> Clue:
    """Correlation of pairs of rows; its spread from shuffled rows."""
    rng = np.random.default_rng(0)

    def correlation(r: np.ndarray) -> float:
        return float(np.mean(np.einsum("nm,nm->n", r[first], r[second]))) / white.shape[1]

    seen = correlation(white)
    shuffled = np.array([correlation(white[rng.permutation(len(white))]) for _ in range(SHUFFLES)])
    z = (seen - shuffled.mean()) / max(float(shuffled.std()), 1e-12)
    return Clue(what, float(np.clip(seen, 0.0, 1.0)), float(norm.sf(z)))


def _stated(sigma: Sigma, noise: Noise, rows: float, m: int) -> list[Clue]:
    pairs = [("position", noise.declared_position, sigma.position)]
    pairs += [("rotation", noise.declared_rotation, sigma.rotation)] if m == 6 else []
    found = []
    for what, stated, seen in pairs:
        if stated:
            share = float(np.clip(1.0 - (stated / seen) ** 2, 0.0, 1.0))
            p_value = float(chi2.sf(3.0 * rows * (seen / stated) ** 2, 3.0 * rows))
            found.append(Clue(f"the residual exceeds the declared {what} noise", share, p_value))
    return found
