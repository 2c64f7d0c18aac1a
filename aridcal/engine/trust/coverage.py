"""Coverage of the fitted rows, and whether other rows lie inside: ranges, holes in these, and how sure predictions were."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

Range = tuple[float, float]
"""Lowest and highest value."""

SAME_VALUE_SHARE = 2e-3
"""Share of its range by which values of a quantity may differ and still be one: noise of a reading that is set to levels."""

NEIGHBOURING_STEPS = 10
"""Steps on either side with which a step from one value to the next is compared: enough for their mean to within a quarter,
and few enough that rows may thin out towards the ends of a range."""

FEWEST_STEPS_AROUND_HOLE = 8
"""Steps on both sides together without which nothing is called a hole: a few levels of a payload have none."""

HOLE_FACTOR = 8.0
"""Mean neighbouring steps that make a hole: of 50 rows drawn evenly one held-out row in 400 falls into such a step, so that six
joints together flag 2 % of them without a reason."""

EDGE = 0.5
"""Mean neighbouring steps beside the last value before a hole that still count as seen."""

EXTRAPOLATION_FACTOR = 3.0
"""Times the largest standard deviation of a prediction at the fitted rows, beyond which a prediction extrapolates. Between rows
that surround it no function that they fix is that uncertain."""

RECORDED_MARGIN = 0.25
"""Of its range seen, by which a recorded column on which nothing depends may leave it: of 100 rows of normal values another lies
that far out once in some thousands, so that ten such columns mark nothing by chance."""

CLOCK_COLUMN = "time"
"""A column that always leaves its range: what is predicted is later."""

HEAT = "temperature"
"""Beginning of the names of columns of temperatures, [°C] or [K]."""

EXPANSION = 1e-5
"""[1/K], one sigma: steel, cast iron and aluminium grow by 10 to 23 millionths, gears and bearings shift zeros by as much again
or against it; what the rows told of it ends with the temperatures that they saw."""

POSE_PARTS = (slice(0, 3), slice(3, 6))
"""Position and rotation in the six numbers of a pose."""


@dataclass(frozen=True)
class Coverage:
    """Coverage of the fitted rows of a calibration.

    Attributes:
        ranges: Lowest and highest value of every joint column and covariate that the model depends on.
        holes: Holes inside those ranges.
        largest: Largest standard deviation of the predicted position [m], and of the rotation [rad], at the fitted rows, all
            three axes together.
    """

    ranges: Mapping[str, Range]
    holes: Mapping[str, Sequence[Range]]
    largest: tuple[float, float]

    def beyond(self, columns: Mapping[str, np.ndarray], std: np.ndarray) -> np.ndarray:
        """Rows that are unlike the fitted ones, shape (N,) bool.

        They lie outside the range of a joint or of a covariate, in a hole of that range, or where the prediction is several
        times as uncertain as it was at any fitted row.

        Args:
            columns: Values of every quantity of ``ranges``, shape (N,) each.
            std: Of the predicted position [m] and of the rotation [rad], shape (N, 6).
        """
        unlike = np.zeros(len(std), dtype=bool)
        for name, (low, high) in self.ranges.items():
            values = columns[name]
            unlike |= (values < low) | (values > high) | in_ranges(values, self.holes.get(name, ()))
        for axes, largest in zip(POSE_PARTS, self.largest, strict=True):
            unlike |= np.linalg.norm(std[:, axes], axis=1) > EXTRAPOLATION_FACTOR * largest
        return unlike


def holes(values: np.ndarray) -> tuple[Range, ...]:
    """Holes inside a range: steps between neighbouring values far wider than the steps around them.

    The steps around are the measure, not a width in radians: it then fits any quantity, dense or sparse rows, and rows that
    thin out towards the ends.

    Args:
        values: Of one quantity, shape (N,).

    Returns:
        Lowest and highest value of each hole, its edges left out, in rising order.
    """
    values = np.sort(values)
    apart = np.flatnonzero(np.diff(values) > SAME_VALUE_SHARE * (values[-1] - values[0]))
    low, high = values[apart], values[apart + 1]
    steps = high - low
    around, count = np.zeros(len(steps)), np.zeros(len(steps))
    for away in range(1, min(NEIGHBOURING_STEPS, len(steps) - 1) + 1):
        for here, there in ((slice(away, None), slice(None, -away)), (slice(None, -away), slice(away, None))):
            around[here] += steps[there]
            count[here] += 1
    usual = around / np.maximum(count, 1.0)
    wide = (count >= FEWEST_STEPS_AROUND_HOLE) & (steps > HOLE_FACTOR * usual)
    edges = np.column_stack([low + EDGE * usual, high - EDGE * usual])[wide]
    return tuple((first, last) for first, last in edges.tolist())


def recorded_elsewhere(columns: Mapping[str, np.ndarray], recorded: Mapping[str, Range]) -> np.ndarray:
    """Rows in which a recorded column, on which nothing depends, has left its range, shape (N,) bool.

    Args:
        columns: Values of the rows, shape (N,) each; a column that they lack marks no row.
        recorded: Lowest and highest value seen.
    """
    outside = np.zeros(len(next(iter(columns.values()))), dtype=bool)
    for name in (recorded.keys() & columns.keys()) - {CLOCK_COLUMN}:
        low, high = recorded[name]
        aside = RECORDED_MARGIN * (high - low)
        outside |= (columns[name] < low - aside) | (columns[name] > high + aside)
    return outside


def beyond_heat(columns: Mapping[str, np.ndarray], ranges: Mapping[str, Range]) -> np.ndarray:
    """How far temperatures are outside their recorded ranges, shape (N,), [K]: the farthest of several, 0 without any."""
    away = np.zeros(len(next(iter(columns.values()))))
    for name in ranges.keys() & columns.keys():
        if name.startswith(HEAT):
            low, high = ranges[name]
            away = np.fmax(away, np.fmax(low - columns[name], columns[name] - high))
    return away


def largest(std: np.ndarray) -> tuple[float, float]:
    """Largest standard deviation of position and rotation, all three axes together, of poses known to (N, 6)."""
    position, rotation = (float(np.linalg.norm(std[:, axes], axis=1).max()) for axes in POSE_PARTS)
    return position, rotation


def in_ranges(values: np.ndarray, ranges: Sequence[Range]) -> np.ndarray:
    """True where a value, shape (N,), lies strictly inside one of some ranges."""
    within = [(values > low) & (values < high) for low, high in ranges]
    return np.any(within, axis=0) if within else np.zeros(len(values), dtype=bool)
