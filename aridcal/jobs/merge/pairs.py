"""Standstills of both logs that are one: when both stand, as far as their clocks are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.jobs.merge.clocks import Clocks
from aridcal.jobs.merge.log import Log
from aridcal.jobs.merge.standstills import Standstills, span_of

SURE = 3.0
"""Sigmas of the clocks that are dropped at both ends of a standstill."""

FEWEST = 3
"""Samples of the tracker that a row rests on at least."""

STAYS = 3.5
"""Times its sigma by which the mean of a standstill's first third may be off the rest. More is an arm, or an instrument,
that still settles: that third is dropped."""


@dataclass(frozen=True)
class Pairs:
    """Windows in which both logs stand, K of them.

    Attributes:
        joints: Number of the joints' standstill, shape (K,).
        tracker: Number of the tracker's.
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
        """Only some of them."""
        return Pairs(self.joints[rows], self.tracker[rows], self.begin[rows], self.end[rows])


def pairs(
    clocks: Clocks, joints: Log, still: Standstills, tracker: Log, tracked: Standstills, sure: float = SURE
) -> Pairs:
    """Cut what both stand through; of several standstills of the tracker in one of the joints the longest counts.

    Args:
        clocks: How one clock becomes the other.
        joints: The joints' log.
        still: Its standstills.
        tracker: The tracker's log.
        tracked: Its standstills.
        sure: Sigmas of the clocks that are dropped at both ends.
    """
    begin, end = clocks.tracker(still.begin), clocks.tracker(still.end)
    margin = max(span_of(joints), span_of(tracker))
    first = np.searchsorted(tracked.end, begin)
    found: list[tuple[int, int, float, float]] = []
    for k in range(len(still)):
        best: tuple[int, int, float, float] | None = None
        for other in range(int(first[k]), len(tracked)):
            if tracked.begin[other] > end[k]:
                break
            a, b = max(begin[k], tracked.begin[other]), min(end[k], tracked.end[other])
            unsure = sure * float(clocks.std(np.array([0.5 * (a + b)]))[0])
            a, b = a + margin + unsure, b - margin - unsure
            if np.searchsorted(tracker.time, b, "right") - np.searchsorted(tracker.time, a) >= FEWEST and (
                best is None or b - a > best[3] - best[2]
            ):
                best = k, other, float(a), float(b)
        if best is not None:
            found.append(best)
    # one standstill of the tracker through two of the joints': it did not see the move, or turned about its target alone
    columns = list(zip(*found, strict=True)) if found else [(), (), (), ()]
    return Pairs(*(np.array(c, dtype=kind) for c, kind in zip(columns, (int, int, float, float), strict=True)))


def within(time: np.ndarray, begin: float, end: float) -> slice:
    """Samples of a window."""
    return slice(int(np.searchsorted(time, begin)), int(np.searchsorted(time, end, "right")))


def settled(found: Pairs, tracker: Log, places: np.ndarray) -> tuple[Pairs, np.ndarray]:
    """Drop the beginnings in which the target still creeps.

    Args:
        found: K windows.
        tracker: N samples.
        places: Shape (N, 3), [m].

    Returns:
        The windows, later where needed, and which are settled at their end, shape (K,) bool.
    """
    begin, good = found.begin.copy(), np.ones(len(found), dtype=bool)
    windows = [within(tracker.time, a, b) for a, b in zip(found.begin, found.end, strict=True)]
    # a window of ten samples knows its own scatter badly: the usual one counts where it is larger
    usual = np.median([_scatter(places[rows]) for rows in windows], axis=0)
    usual = np.maximum(usual, resolution(places))
    for k, rows in enumerate(windows):
        first = rows.start
        while (third := (rows.stop - first) // 3) >= 2:
            x, rest = places[first : first + third], places[first + third : rows.stop]
            sigma = np.maximum(_scatter(rest), usual) * np.sqrt(1 / len(x) + 1 / len(rest))
            if np.all(np.abs(x.mean(axis=0) - rest.mean(axis=0)) <= STAYS * sigma):
                break
            first += third
            good[k] = len(rest) >= 6  # else what is left cannot show that it stands
        good[k] &= rows.stop - first >= FEWEST
        begin[k] = tracker.time[first]
    return Pairs(found.joints, found.tracker, begin, found.end), good


def _scatter(x: np.ndarray) -> np.ndarray:
    """Sigma of samples (n, 3) about a straight line through them: creep must not hide itself in it; shape (3,)."""
    if len(x) < 3:
        return np.zeros(x.shape[1])
    line = np.arange(len(x)) - 0.5 * (len(x) - 1)
    left = x - x.mean(axis=0)
    left = left - line[:, None] * ((line @ left) / (line @ line))
    return np.asarray(np.sqrt((left**2).sum(axis=0) / (len(x) - 2)))


def resolution(values: np.ndarray) -> np.ndarray:
    """The smallest step between samples (N, C), shape (C,): that to which an instrument rounds; 0 where nothing changes."""
    steps = np.abs(np.diff(values, axis=0))
    least = np.where(steps > 0, steps, np.inf).min(axis=0)
    return np.where(np.isfinite(least), least, 0.0)
