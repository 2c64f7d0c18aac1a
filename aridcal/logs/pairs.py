"""Standstills of both logs that are one: when both stand, as far as their clocks are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.logs.clocks import Clocks
from aridcal.logs.log import Log
from aridcal.logs.standstills import Standstills, span_of

SURE = 3.0
"""Sigmas of the clocks that are dropped at both ends of a standstill."""

FEWEST = 3
"""Samples of the tracker that a row rests on at least."""

STAYS = 5.0
"""Times its own sigma by which the mean of a standstill's first third may be off the rest. More is an arm, or an instrument,
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
    for k in range(len(found)):
        while True:
            rows = within(tracker.time, begin[k], found.end[k])
            x = places[rows]
            third = len(x) // 3
            if third < 2:
                good[k] = rows.stop - rows.start >= FEWEST and good[k]
                break
            rest = x[third:]
            # the scatter about a line of the rest, lest creep hides itself in it
            line = np.arange(len(rest)) - 0.5 * (len(rest) - 1)
            slope = line @ (rest - rest.mean(axis=0)) / (line @ line)
            left = rest - rest.mean(axis=0) - line[:, None] * slope
            sigma = np.sqrt((left**2).sum(axis=0) / max(len(rest) - 2, 1) * (1 / third + 1 / len(rest)))
            off = np.abs(x[:third].mean(axis=0) - rest.mean(axis=0))
            if np.all(off <= STAYS * sigma + 1e-12):
                break
            begin[k] = tracker.time[rows][third]
            good[k] = len(rest) // 3 >= 2  # else what is left cannot show that it stands
    return Pairs(found.joints, found.tracker, begin, found.end), good
