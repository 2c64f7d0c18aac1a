"""Where a log stands still: speeds that are no larger than its own noise makes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.jobs.merge.log import Log
from aridcal.system.errors import MeasurementError

SHORTEST_SPAN = 0.1
"""Speeds are between means over so many seconds before and after, [s]: short beside a move, long enough to quiet an encoder."""

SPAN_SAMPLES = 2
"""Fewest samples of such a mean, however slow the log is."""

LEAST_STANDSTILL = 0.5
"""A standstill lasts at least as long, [s]: arms that turn back on their way stand for less."""

MOTION_RATIO = 4.0
"""Times the usual speed of noise that is motion. Speeds of noise in three axes are Maxwell's, whose median is 1.54 sigma:
this is 6 sigma, which noise passes in one of 10^7 samples."""

SLOWEST_SHARE = 1e-3
"""Share of the usual speed of motion below which nothing moves, where rounding leaves no noise at all."""

CLASS_RATIO = 10.0
"""Motion is so many times as fast as noise, or there is none."""

SPIKE_SPANS = 3.0
"""A wild sample spoils the speeds of so many spans at most: one before, one after, and itself."""

GAP_PERIODS = 5.0
"""A hole of so many periods ends a standstill: nothing is known of what was in it."""


@dataclass(frozen=True)
class Standstills:
    """K standstills of a log.

    Attributes:
        begin: Time of the first sample of each, shape (K,), [s].
        end: Time of the last sample of each, shape (K,), [s].
        speed: Of each sample of the log, shape (N,); NaN beside holes.
        limit: Speed below which the log stands.
    """

    begin: np.ndarray
    end: np.ndarray
    speed: np.ndarray
    limit: float

    def __len__(self) -> int:
        return len(self.begin)


def span_of(log: Log) -> float:
    """Length of the means that speeds of a log are made of, [s]."""
    return max(SHORTEST_SPAN, (SPAN_SAMPLES + 0.5) * log.period)


def speeds(log: Log, values: np.ndarray) -> np.ndarray:
    """Speeds: distance between the means of the samples before and after, over the time between.

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
    step = after - before
    lone = (n == first) | (last == n + 1)
    time = np.where(lone, 1.0, step[:, 0])
    return np.where(lone, np.nan, np.linalg.norm(step[:, 1:], axis=1) / time)


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
    finite = speed[np.isfinite(speed)]
    top = float(np.quantile(finite, 0.99, method="higher")) if len(finite) else 0.0
    if top <= 0.0:
        raise MeasurementError(f"{title}: nothing moves in it; is it of another day, or of another robot?")
    logarithm = np.log(np.maximum(finite, SLOWEST_SHARE * top))
    counts, edges = np.histogram(logarithm, bins=100)
    centre = 0.5 * (edges[1:] + edges[:-1])
    count_below, total = np.cumsum(counts)[:-1], counts.sum()
    weighted = np.cumsum(counts * centre)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (weighted[-1] * count_below - total * weighted[:-1]) ** 2 / (count_below * (total - count_below))
    threshold = np.exp(edges[1 + int(np.nanargmax(np.where(np.isfinite(between), between, -1.0)))])
    slow, fast = finite[finite <= threshold], finite[finite > threshold]
    quiet, motion = (
        float(np.median(speeds_of_class)) if len(speeds_of_class) else 0.0 for speeds_of_class in (slow, fast)
    )
    if motion < CLASS_RATIO * max(quiet, SLOWEST_SHARE * top):
        raise MeasurementError(
            f"{title}: nothing that moves can be told from standstills: the faster part of its speeds is only "
            f"{motion / max(quiet, SLOWEST_SHARE * top):.2g} times the slower one. The robot has to stand for a second "
            "or more between moves"
        )
    return max(MOTION_RATIO * quiet, SLOWEST_SHARE * motion)


def standstills(log: Log, values: np.ndarray, least: float = LEAST_STANDSTILL) -> Standstills:
    """The standstills of a log.

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
    holes = np.r_[False, np.diff(log.time) > GAP_PERIODS * log.period]
    label = np.cumsum(np.r_[True, np.diff(still)] | holes)
    first = np.flatnonzero(np.r_[True, np.diff(label) > 0])
    last = np.r_[first[1:] - 1, len(still) - 1]
    runs = [
        (a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True) if still[a] and b - a >= 2 * SPAN_SAMPLES
    ]
    runs = _joined(runs, log, values, limit * span_of(log))
    long = [(a, b) for a, b in runs if log.time[b] - log.time[a] >= least]
    if not long:
        raise MeasurementError(f"{log.title}: never stands still for {least:g} s; let the program wait at each pose")
    begin, end = np.array(long).T
    return Standstills(log.time[begin], log.time[end], speed, limit)


def _joined(runs: list[tuple[int, int]], log: Log, values: np.ndarray, near: float) -> list[tuple[int, int]]:
    """Runs joined again that a spike of noise parted: the place after it is the place before it."""
    joined: list[tuple[int, int]] = []
    for a, b in runs:
        if joined:
            c, d = joined[-1]
            gap = log.time[a] - log.time[d]
            hole = np.diff(log.time[d : a + 1]).max() > GAP_PERIODS * log.period
            distance = float(np.linalg.norm(values[a : b + 1].mean(axis=0) - values[c : d + 1].mean(axis=0)))
            if gap < SPIKE_SPANS * span_of(log) and not hole and distance < near:
                joined[-1] = (c, b)
                continue
        joined.append((a, b))
    return joined
