"""Which time of one clock is which of the other, roughly: where the speeds in both logs are most alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.jobs.merge.log import Log
from aridcal.system.errors import MeasurementError

CELL_PERIODS = 2.0
"""Speeds are compared on a grid of so many periods of the slower log: one sample at least in each cell."""

SHORTEST_CELL = 0.05
"""And of cells that are no shorter, [s]."""

MOST_CELLS = 4_000_000
"""A log of two days at the finest grid; more is a clock that jumped."""

MOST_DRIFT = 1e-3
"""Clocks are told apart by up to so much, [s/s]: quartz is within 100 ppm, a badly set sampling rate within 1,000."""

MOST_BLUR = 0.5
"""Drifts are tried so close that the ends of a log are never further from their place, [s]: moves last longer."""

LEAST_OVERLAP = 20.0
"""Logs that share less are not compared, [s]: by chance any two moves are alike."""

LEAST_CORRELATION = 0.3
"""Correlation from which an offset is looked at more closely."""

MOST_CANDIDATES = 12
"""Offsets that are looked at more closely."""

CANDIDATE_SPACING = 1.0
"""Of offsets that are nearer one is kept, [s]."""


@dataclass(frozen=True)
class Clocks:
    """How the tracker's clock becomes the joints': t' = t + offset + drift (t - middle).

    Attributes:
        offset: At the middle, [s].
        drift: [s/s].
        middle: Time of the tracker's clock, [s].
        covariance: Of offset and drift, shape (2, 2).
    """

    offset: float
    drift: float
    middle: float
    covariance: np.ndarray

    def joints(self, time: np.ndarray) -> np.ndarray:
        """Times of the joints' clock for times of the tracker's."""
        return np.asarray(time + self.offset + self.drift * (time - self.middle))

    def tracker(self, time: np.ndarray) -> np.ndarray:
        """Times of the tracker's clock for times of the joints'."""
        return np.asarray((time - self.offset - self.middle) / (1.0 + self.drift) + self.middle)

    def std(self, time: np.ndarray) -> np.ndarray:
        """Sigma of the joints' times, for times of the tracker's clock, shape (N,), [s]."""
        terms = np.column_stack([np.ones(len(time)), time - self.middle])
        return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", terms, self.covariance, terms)))


@dataclass(frozen=True)
class Candidate:
    """Clocks that make the speeds alike.

    Attributes:
        clocks: The offset is known to a cell of the grid.
        correlation: Of the speeds.
        evidence: Gain in log likelihood, -n/2 log(1 - r²), of n cells.
    """

    clocks: Clocks
    correlation: float
    evidence: float


def cells(time: np.ndarray, values: np.ndarray, step: float, title: str) -> np.ndarray:
    """Speeds between the cells of a time grid that begins with a log; shape (cells - 1,), NaN where a cell has no sample."""
    index = np.floor((time - time[0]) / step).astype(np.int64)
    if index[-1] > MOST_CELLS:
        k = int(np.argmax(np.diff(time)))
        raise MeasurementError(
            f"{title}: lasts {time[-1] - time[0]:.4g} s, {np.diff(time)[k]:.4g} s of them between two samples, "
            f"after {time[k]:.10g} s. "
            "If its clock jumped there, cut the log and merge each part by itself"
        )
    count = np.bincount(index)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = [
            np.bincount(index, column) / count for column in np.column_stack([time - time[0], values - values[0]]).T
        ]
    steps = np.diff(np.array(means), axis=1)
    return np.asarray(np.linalg.norm(steps[1:], axis=0) / steps[0])


def correlations(a: np.ndarray, b: np.ndarray, least: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pearson's correlation of a[k + lag] and b[k] over all k that both have, for every lag.

    Returns:
        Lags, correlations (0 where fewer than ``least`` cells are shared, or one does not vary), and shared cells.
    """
    size = 1 << (len(a) + len(b)).bit_length()
    masks = [np.isfinite(x).astype(float) for x in (a, b)]
    filled = [np.where(m > 0, x - np.nanmean(x), 0.0) for x, m in zip((a, b), masks, strict=True)]
    A, MA, AA = (np.fft.rfft(x, size) for x in (filled[0], masks[0], filled[0] ** 2))
    B, MB, BB = (np.conj(np.fft.rfft(x, size)) for x in (filled[1], masks[1], filled[1] ** 2))
    n, sa, sb, saa, sbb, sab = (
        np.fft.irfft(product, size) for product in (MA * MB, A * MB, MA * B, AA * MB, MA * BB, A * B)
    )
    n = np.round(n)
    shared = np.maximum(n, 1.0)
    va, vb = saa - sa * sa / shared, sbb - sb * sb / shared
    comparable = (n >= least) & (va > 1e-6 * saa.max()) & (vb > 1e-6 * sbb.max())
    r = np.where(comparable, (sab - sa * sb / shared) / np.sqrt(np.where(comparable, va * vb, 1.0)), 0.0)
    lags = np.arange(size)
    lags = np.where(lags >= len(a), lags - size, lags)
    order = np.argsort(lags)
    return lags[order], np.clip(r, -1.0, 1.0)[order], n[order]


def candidates(joints: Log, tips: np.ndarray, tracker: Log, places: np.ndarray) -> list[Candidate]:
    """Clocks that make both speeds alike, the likeliest first.

    Args:
        joints: N samples.
        tips: Where the nominal tip is at each, shape (N, 3).
        tracker: M samples.
        places: Of its target, shape (M, 3), in any unit.
    """
    step = max(SHORTEST_CELL, CELL_PERIODS * max(joints.period, tracker.period))
    a = cells(joints.time, tips, step, joints.title)
    middle = 0.5 * (tracker.time[0] + tracker.time[-1])
    duration = tracker.time[-1] - tracker.time[0]
    steps = int(np.floor(MOST_DRIFT * duration / (2 * MOST_BLUR)))
    peaks_found: list[Candidate] = []
    for drift in np.arange(-steps, steps + 1) * (MOST_DRIFT / max(steps, 1)):
        time = tracker.time + drift * (tracker.time - middle)
        lags, r, n = correlations(a, cells(time, places, step, tracker.title), max(int(LEAST_OVERLAP / step), 8))
        evidence = np.where(r > LEAST_CORRELATION, -0.5 * n * np.log1p(-np.minimum(r * r, 1.0 - 1e-9)), 0.0)
        peaks = 1 + np.flatnonzero((evidence[1:-1] >= evidence[:-2]) & (evidence[1:-1] > evidence[2:]))
        for k in peaks[np.argsort(evidence[peaks])[::-1]][: 4 * MOST_CANDIDATES].tolist():
            offset = joints.time[0] - time[0] + step * lags[k]
            clocks = Clocks(
                float(offset), float(drift), float(middle), np.diag([step**2 / 12, (MOST_BLUR / duration) ** 2])
            )
            peaks_found.append(Candidate(clocks, float(r[k]), float(evidence[k])))
    peaks_found.sort(key=lambda candidate: -candidate.evidence)
    distinct: list[Candidate] = []
    for candidate in peaks_found:
        if all(abs(candidate.clocks.offset - other.clocks.offset) > CANDIDATE_SPACING for other in distinct):
            distinct.append(candidate)
        if len(distinct) == MOST_CANDIDATES:
            break
    return distinct
