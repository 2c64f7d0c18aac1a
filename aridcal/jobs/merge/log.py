"""A log: what one program wrote down of the motion, with its own clock, at its own rate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.system.errors import MeasurementError

JITTER_PERIODS = 5.0
"""Samples that arrive out of order by less than so many periods are put in order: networks do that. Clocks that are set back
jump by more."""

FEWEST_LOG_SAMPLES = 50
"""Samples without which there is no log: four standstills and the moves between them have more."""

FEWEST_FROZEN = 5
"""So many samples in a row that are equal to the last digit hold no measurement, where those at standstill otherwise differ:
instruments repeat the last place when they lose their target."""

MOST_REPEATED_SHARE = 0.3
"""Share of equal neighbours above which equal samples are a matter of rounding, or of a log that is faster than its
instrument, and no sign of a lost target."""


@dataclass(frozen=True)
class Log:
    """Samples in the order of time.

    Attributes:
        title: Where they come from, for messages.
        time: Of its own clock, shape (N,), [s], rising.
        columns: Names, C.
        values: Shape (N, C), in the log's own units.
        notes: On samples that were left out, in words.
    """

    title: str
    time: np.ndarray
    columns: tuple[str, ...]
    values: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def period(self) -> float:
        """Usual time from one sample to the next, [s]."""
        return float(np.median(np.diff(self.time)))

    def of(self, columns: tuple[str, ...]) -> np.ndarray:
        """Some columns, shape (N, columns)."""
        return self.values[:, [self.columns.index(name) for name in columns]]

    def keep(self, rows: np.ndarray, why: str = "") -> Log:
        """The log with some samples alone, ``rows`` of shape (N,) bool; a note says how many were dropped, and why."""
        dropped = int(np.count_nonzero(~rows))
        notes = (*self.notes, f"{self.title}: {dropped} samples {why}") if dropped and why else self.notes
        return replace(self, time=self.time[rows], values=self.values[rows], notes=notes)

    def at(self, time: np.ndarray) -> np.ndarray:
        """Values between samples, on straight lines, shape (M, C)."""
        return np.column_stack([np.interp(time, self.time, column) for column in self.values.T])


def in_order(log: Log, line: np.ndarray) -> Log:
    """A log in the order of time, its clock checked.

    Args:
        log: Samples as they were written, those without a number left out.
        line: Of the file, shape (N,).

    Returns:
        The log in the order of time, of samples of one time the first.

    Raises:
        MeasurementError: it is too short, or its clock was set back.
    """
    _check_length(log)
    steps = np.diff(log.time)
    rising = steps[steps > 0]
    if not len(rising):
        raise MeasurementError(f"{log.title}: its time never changes; name the clock's column `time`")
    setback = np.maximum.accumulate(log.time) - log.time
    worst = int(np.argmax(setback))
    if setback[worst] > JITTER_PERIODS * float(np.median(rising)):
        first = int(np.argmax(setback > JITTER_PERIODS * float(np.median(rising))))
        raise MeasurementError(
            f"{log.title}, line {line[first]}: the clock is set back by {setback[first]:.3g} s. Cut the log there, "
            "and merge each part "
            "by itself"
        )
    order = np.argsort(log.time, kind="stable")
    log = replace(log, time=log.time[order], values=log.values[order])
    log = log.keep(np.r_[True, np.diff(log.time) > 0], "have the time of the one before: left out")
    _check_length(log)
    return log


def _check_length(log: Log) -> None:
    if len(log.time) < FEWEST_LOG_SAMPLES:
        raise MeasurementError(
            f"{log.title}: {len(log.time)} samples with time and numbers; {FEWEST_LOG_SAMPLES} are the least. A log holds the "
            "whole motion, some "
            "samples a second; a table of poses that are measured already needs `aridcal init`"
        )


def without_blind_samples(log: Log, place: tuple[str, ...]) -> Log:
    """A tracker's log without samples in which it did not see its target: exact zeros, and repeated places.

    Args:
        log: Its samples.
        place: Columns of the position.
    """
    log = log.keep(np.any(log.of(place) != 0.0, axis=1), "are exactly 0 0 0, which is no place: left out")
    _check_length(log)
    repeated = np.all(np.diff(log.of(place), axis=0) == 0.0, axis=1)
    if repeated.mean() > MOST_REPEATED_SHARE:
        return log
    edges = np.flatnonzero(np.diff(np.r_[0, repeated.astype(int), 0]))
    frozen = np.zeros(len(log.time), dtype=bool)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin + 1 >= FEWEST_FROZEN:
            frozen[begin + 1 : end + 1] = True
    log = log.keep(~frozen, "repeat the one before to the last digit, as when a target is lost: left out")
    _check_length(log)
    return log
