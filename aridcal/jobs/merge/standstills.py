"""Where a log stands still: speeds that are no larger than its own noise makes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.jobs.merge.log import Log
from aridcal.system.errors import MeasurementError

SPAN = 0.1
"""Speeds are between means over so many seconds before and after, [s]: short beside a move, long enough to quiet an encoder."""

SAMPLES = 2
"""Of which there are at least so many, however slow the log is."""

LEAST = 0.5
"""A standstill lasts at least as long, [s]: arms that turn back on their way stand for less."""

ABOVE = 4.0
"""Times the usual speed of noise that is motion. Speeds of noise in three axes are Maxwell's, whose median is 1.54 sigma:
this is 6 sigma, which noise passes in one of 10^7 samples."""

SLOWEST = 1e-3
"""Share of the usual speed of motion below which nothing moves, where rounding leaves no noise at all."""

APART = 10.0
"""Motion is so many times as fast as noise, or there is none."""

SPIKE = 3.0
"""A wild sample spoils the speeds of so many spans at most: one before, one after, and itself."""

GAP = 5.0
"""A hole of so many periods ends a standstill: nothing is known of what was in it."""


@dataclass(frozen=True)
class Standstills:
    """When a log stands still, K times.

    Attributes:
        begin: Time of the first sample of each, shape (K,), [s].
        end: Time of the last.
        speed: Of each sample of the log, shape (N,); NaN beside holes.
        limit: The speed below which it stands.
    """

    begin: np.ndarray
    end: np.ndarray
    speed: np.ndarray
    limit: float

    def __len__(self) -> int:
        return len(self.begin)


def span_of(log: Log) -> float:
    """How long the means are that speeds of a log are made of, [s]."""
    return max(SPAN, (SAMPLES + 0.5) * log.period)


def speeds(log: Log, values: np.ndarray) -> np.ndarray:
    """Distance between the means of the samples before and after, over the time between.

    Args:
        log: N samples.
        values: What moves, shape (N, C).

    Returns:
        Shape (N,), NaN where a sample has no other on one side.
    """
    t, span, n = log.time, span_of(log), np.arange(len(log.time))
    first = np.searchsorted(t, t - span, "left")
    last = np.searchsorted(t, t + span, "right")
    sums = np.vstack(
        [np.zeros(values.shape[1] + 1), np.cumsum(np.column_stack([t - t[0], values - values[0]]), axis=0)]
    )
    before = (sums[n + 1] - sums[first]) / (n + 1 - first)[:, None]
    after = (sums[last] - sums[n]) / (last - n)[:, None]
    moved = after - before
    lone = (n == first) | (last == n + 1)
    time = np.where(lone, 1.0, moved[:, 0])
    return np.where(lone, np.nan, np.linalg.norm(moved[:, 1:], axis=1) / time)


def limit_of(speed: np.ndarray, title: str) -> float:
    """The speed that parts noise from motion.

    Two classes of the speeds' logarithms are found by Otsu's method (largest variance between classes); the limit is a multiple
    of the median of the slower one.

    Args:
        speed: Shape (N,); NaN do not count.
        title: Of the log.

    Raises:
        MeasurementError: there are no two classes.
    """
    there = speed[np.isfinite(speed)]
    top = float(np.quantile(there, 0.99, method="higher")) if len(there) else 0.0
    if top <= 0.0:
        raise MeasurementError(f"{title}: nothing moves in it; is it of another day, or of another robot?")
    logarithm = np.log(np.maximum(there, SLOWEST * top))
    counts, edges = np.histogram(logarithm, bins=100)
    centre = 0.5 * (edges[1:] + edges[:-1])
    below, total = np.cumsum(counts)[:-1], counts.sum()
    weighted = np.cumsum(counts * centre)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (weighted[-1] * below - total * weighted[:-1]) ** 2 / (below * (total - below))
    part = np.exp(edges[1 + int(np.nanargmax(np.where(np.isfinite(between), between, -1.0)))])
    slow, fast = there[there <= part], there[there > part]
    quiet, motion = (float(np.median(one)) if len(one) else 0.0 for one in (slow, fast))
    if motion < APART * max(quiet, SLOWEST * top):
        raise MeasurementError(
            f"{title}: nothing that moves can be told from standstills: the faster part of its speeds is only "
            f"{motion / max(quiet, SLOWEST * top):.2g} times the slower one. The robot has to stand for a second "
            "or more between moves"
        )
    return max(ABOVE * quiet, SLOWEST * motion)


def standstills(log: Log, values: np.ndarray, least: float = LEAST) -> Standstills:
    """Find where a log stands still.

    Args:
        log: N samples.
        values: What moves, shape (N, C): joints (1 rad counts as 1 m) or a position.
        least: How long it stands at least, [s].

    Raises:
        MeasurementError: it never moves, or never stands.
    """
    speed = speeds(log, values)
    limit = limit_of(speed, log.title)
    still = speed < limit
    holes = np.r_[False, np.diff(log.time) > GAP * log.period]
    label = np.cumsum(np.r_[True, np.diff(still)] | holes)
    first = np.flatnonzero(np.r_[True, np.diff(label) > 0])
    last = np.r_[first[1:] - 1, len(still) - 1]
    runs = [(a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True) if still[a] and b - a >= 2 * SAMPLES]
    runs = _joined(runs, log, values, limit * span_of(log))
    long = [(a, b) for a, b in runs if log.time[b] - log.time[a] >= least]
    if not long:
        raise MeasurementError(f"{log.title}: never stands still for {least:g} s; let the program wait at each pose")
    begin, end = np.array(long).T
    return Standstills(log.time[begin], log.time[end], speed, limit)


def _joined(runs: list[tuple[int, int]], log: Log, values: np.ndarray, near: float) -> list[tuple[int, int]]:
    """Runs that a spike of noise parted, made one again: the place after it is the place before it."""
    joined: list[tuple[int, int]] = []
    for a, b in runs:
        if joined:
            c, d = joined[-1]
            passed = log.time[a] - log.time[d]
            hole = np.diff(log.time[d : a + 1]).max() > GAP * log.period
            apart = float(np.linalg.norm(values[a : b + 1].mean(axis=0) - values[c : d + 1].mean(axis=0)))
            if passed < SPIKE * span_of(log) and not hole and apart < near:
                joined[-1] = (c, b)
                continue
        joined.append((a, b))
    return joined
