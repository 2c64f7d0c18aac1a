"""Standstills of both logs that are one: when both stand, as far as their clocks are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.jobs.merge.clocks import Clocks
from aridcal.jobs.merge.log import Log
from aridcal.jobs.merge.standstills import Standstills, span_of

MARGIN_SIGMAS = 3.0
"""Sigmas of the clocks that are dropped at both ends of a standstill."""

FEWEST_SAMPLES = 3
"""Samples of the tracker that a row rests on at least."""

MOST_CREEP_SIGMAS = 3.5
"""Times its sigma by which the mean of a standstill's first third may be off the rest. More is an arm, or an instrument,
that still settles: that third is dropped."""


@dataclass(frozen=True)
class Pairs:
    """Windows in which both logs stand, K of them.

    Attributes:
        joints: Index of the joints' standstill, shape (K,).
        tracker: Index of the tracker's, shape (K,).
        begin: By the tracker's clock, margins dropped, shape (K,), [s].
        end: Likewise.
    """

    joints: np.ndarray
    tracker: np.ndarray
    begin: np.ndarray
    end: np.ndarray

    def __len__(self) -> int:
        return len(self.begin)

    def some(self, rows: np.ndarray) -> Pairs:
        """The windows of these indices."""
        return Pairs(self.joints[rows], self.tracker[rows], self.begin[rows], self.end[rows])


def pairs(
    clocks: Clocks,
    joints: Log,
    joints_still: Standstills,
    tracker: Log,
    tracker_still: Standstills,
    clock_sigmas: float = MARGIN_SIGMAS,
) -> Pairs:
    """Windows in which both logs stand; of several standstills of the tracker in one of the joints the longest counts.

    Args:
        clocks: How one clock becomes the other.
        joints: The joints' log.
        joints_still: Its standstills.
        tracker: The tracker's log.
        tracker_still: Its standstills.
        clock_sigmas: Sigmas of the clocks that are dropped at both ends.
    """
    begin, end = clocks.tracker(joints_still.begin), clocks.tracker(joints_still.end)
    margin = max(span_of(joints), span_of(tracker))
    first = np.searchsorted(tracker_still.end, begin)
    windows: list[tuple[int, int, float, float]] = []
    for k in range(len(joints_still)):
        best: tuple[int, int, float, float] | None = None
        for other in range(int(first[k]), len(tracker_still)):
            if tracker_still.begin[other] > end[k]:
                break
            a, b = max(begin[k], tracker_still.begin[other]), min(end[k], tracker_still.end[other])
            clock_margin = clock_sigmas * float(clocks.std(np.array([0.5 * (a + b)]))[0])
            a, b = a + margin + clock_margin, b - margin - clock_margin
            if np.searchsorted(tracker.time, b, "right") - np.searchsorted(tracker.time, a) >= FEWEST_SAMPLES and (
                best is None or b - a > best[3] - best[2]
            ):
                best = k, other, float(a), float(b)
        if best is not None:
            windows.append(best)
    # one standstill of the tracker through two of the joints': it did not see the move, or turned about its target alone
    columns = list(zip(*windows, strict=True)) if windows else [(), (), (), ()]
    return Pairs(*(np.array(c, dtype=kind) for c, kind in zip(columns, (int, int, float, float), strict=True)))


def window_samples(time: np.ndarray, begin: float, end: float) -> slice:
    """Samples of a window."""
    return slice(int(np.searchsorted(time, begin)), int(np.searchsorted(time, end, "right")))


def settled(windows_of_both: Pairs, tracker: Log, places: np.ndarray) -> tuple[Pairs, np.ndarray]:
    """Windows without the beginnings in which the target still creeps.

    Args:
        windows_of_both: K windows.
        tracker: N samples.
        places: Shape (N, 3), [m].

    Returns:
        The windows, later where needed, and which are settled at their end, shape (K,) bool.
    """
    begin, at_rest = windows_of_both.begin.copy(), np.ones(len(windows_of_both), dtype=bool)
    windows = [
        window_samples(tracker.time, a, b) for a, b in zip(windows_of_both.begin, windows_of_both.end, strict=True)
    ]
    # a window of ten samples knows its own scatter badly: the usual one counts where it is larger
    usual_scatter = np.median([_scatter(places[rows]) for rows in windows], axis=0)
    usual_scatter = np.maximum(usual_scatter, resolution(places))
    for k, rows in enumerate(windows):
        first = rows.start
        while (third := (rows.stop - first) // 3) >= 2:
            x, later = places[first : first + third], places[first + third : rows.stop]
            sigma = np.maximum(_scatter(later), usual_scatter) * np.sqrt(1 / len(x) + 1 / len(later))
            if np.all(np.abs(x.mean(axis=0) - later.mean(axis=0)) <= MOST_CREEP_SIGMAS * sigma):
                break
            first += third
            at_rest[k] = len(later) >= 6  # else what is left cannot show that it stands
        at_rest[k] &= rows.stop - first >= FEWEST_SAMPLES
        begin[k] = tracker.time[first]
    return Pairs(windows_of_both.joints, windows_of_both.tracker, begin, windows_of_both.end), at_rest


def _scatter(x: np.ndarray) -> np.ndarray:
    """Sigma of samples (n, 3) about a straight line through them: creep must not hide itself in it; shape (3,)."""
    if len(x) < 3:
        return np.zeros(x.shape[1])
    line = np.arange(len(x)) - 0.5 * (len(x) - 1)
    residual = x - x.mean(axis=0)
    residual = residual - line[:, None] * ((line @ residual) / (line @ line))
    return np.asarray(np.sqrt((residual**2).sum(axis=0) / (len(x) - 2)))


def resolution(values: np.ndarray) -> np.ndarray:
    """The smallest step between samples (N, C), shape (C,): that to which an instrument rounds; 0 where nothing changes."""
    steps = np.abs(np.diff(values, axis=0))
    least = np.where(steps > 0, steps, np.inf).min(axis=0)
    return np.where(np.isfinite(least), least, 0.0)
