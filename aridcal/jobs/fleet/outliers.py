r"""Robots that stand out of their fleet, with a stated rate of false alarms.

Each number of a robot (the logarithm of its error at each stage, each of its constants) is set beside the same number of all
robots of its make; constants beside those of robots that told the same ones, for else they stand for other motions:
:math:`z_i = |x_i - m| / s`, with the median :math:`m` and the median of absolute deviations from it,
:math:`s = 1.4826 \operatorname{MAD}` (Hampel 1974; Leys et al. 2013, doi:10.1016/j.jesp.2013.03.013), which half of the robots
may spoil without moving it. Where a number is known to a standard deviation of its own, :math:`s_i^2 = s^2 + \sigma_i^2`: more
than that is not asked of one that is known badly.

The threshold is the quantile of the largest :math:`z` of :math:`n` normal numbers, drawn and not approximated: with 8 robots the
median of deviations is itself known to a quarter. All numbers of a fleet share one chance of a false alarm (Bonferroni).
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.jobs.fleet.row_figures import STAGES, are_done, channels_of, error_of, identified
from aridcal.jobs.fleet.run_record import Row
from aridcal.jobs.maintain.bounds import FALSE_ALARMS

FEWEST_ROBOTS = 8
"""Robots of one make below which none is set beside the others: of 7 the threshold for one number is beyond 15 s."""

TO_SIGMA = 1.4826
"""Of the median of absolute deviations: 1 / 0.6745, for normal numbers."""

FEWEST_DRAWS = 200_000
"""Fewest numbers behind the tail of a quantile: 100 of the largest are beyond it, which fixes it to some percent."""

DRAWS_BEYOND = 20
"""Draws that should be beyond a quantile; quantiles that would need more draws are extrapolated."""


@dataclass(frozen=True)
class OutlyingFigure:
    """A number of a robot that is far from the others'.

    Attributes:
        robot: Its name.
        what: ``final position_mm`` for instance, or the name of a constant.
        value: Of the robot.
        usual: Median of the others and itself.
        scatter: Robust standard deviation; of an error that of its logarithm.
        unit: Of the three; empty for an error, whose channel says it.
        times: Distance from the median, in standard deviations.
        threshold: Distance beyond which a robot stands out, likewise.
    """

    robot: str
    what: str
    value: float
    usual: float
    scatter: float
    unit: str
    times: float
    threshold: float


@dataclass(frozen=True)
class _Number:
    """One number of several robots: names, values shape (n,), and standard deviations shape (n,)."""

    what: str
    unit: str
    robots: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    logarithmic: bool


def outlying_robots(rows: Sequence[Row]) -> tuple[list[OutlyingFigure], int]:
    """Robots that stand out, the farthest first.

    Args:
        rows: The last run of each robot.

    Returns:
        What stands out; and how many numbers were compared.
    """
    numbers = [number for make in makes(rows) for number in _numbers(make)]
    outstanding = [out for number in numbers for out in _beyond(number, FALSE_ALARMS / len(numbers))]
    return sorted(outstanding, key=lambda out: -out.times / out.threshold), len(numbers)


def makes(rows: Sequence[Row]) -> list[list[Row]]:
    """Robots of one URDF together, those that came to a result; no make of fewer than :data:`FEWEST_ROBOTS`."""
    by_urdf: dict[str, list[Row]] = {}
    for row in are_done(rows):
        by_urdf.setdefault(row["urdf"], []).append(row)
    return [make for make in by_urdf.values() if len(make) >= FEWEST_ROBOTS]


def _numbers(make: Sequence[Row]) -> Iterator[_Number]:
    """All numbers that enough robots of a make have."""
    for channel in channels_of(make):
        for stage in STAGES:
            values = np.array([error_of(row, stage, channel) for row in make])
            positive = values > 0.0
            yield from _number(f"{stage} {channel}", "", make, positive, np.log(np.where(positive, values, 1.0)), None)
    gauges: dict[tuple[str, ...], list[Row]] = {}
    for row in make:
        gauges.setdefault(tuple(identified(row)), []).append(row)
    for names, alike in gauges.items():
        constants = [identified(row) for row in alike]
        for name in names:
            values, std = (
                np.array([float(of_robot[name][key]) for of_robot in constants])  # type: ignore[arg-type]
                for key in ("value", "std")
            )
            unit = str(constants[0][name]["unit"])
            yield from _number(name, unit, alike, np.full(len(alike), True), values, std)


def _number(
    what: str, unit: str, make: Sequence[Row], present: np.ndarray, values: np.ndarray, std: np.ndarray | None
) -> Iterator[_Number]:
    """One number of those robots that have it, if they are enough."""
    if present.sum() >= FEWEST_ROBOTS:
        robots = tuple(row["robot"] for row, has in zip(make, present, strict=True) if has)
        own_std = np.zeros(int(present.sum())) if std is None else std[present]
        yield _Number(what, unit, robots, values[present], own_std, std is None)


def _beyond(number: _Number, chance: float) -> Iterator[OutlyingFigure]:
    """Robots that stand out by one number."""
    usual = float(np.median(number.values))
    scatter = TO_SIGMA * float(np.median(np.abs(number.values - usual)))
    sigma = np.hypot(scatter, number.std)
    threshold = quantile_of_largest(len(number.values), chance)
    distance = np.abs(number.values - usual)
    times = np.divide(distance, sigma, out=np.where(distance > 0, np.inf, 0.0), where=sigma > 0)
    for k in np.flatnonzero(times > threshold).tolist():
        value, middle = float(number.values[k]), usual
        if number.logarithmic:
            value, middle = float(np.exp(value)), float(np.exp(middle))
        yield OutlyingFigure(
            number.robots[k], number.what, value, middle, scatter, number.unit, float(times[k]), threshold
        )


@functools.lru_cache(maxsize=256)
def quantile_of_largest(n: int, chance: float) -> float:
    """Threshold that the largest of n normal numbers' z exceeds with a chance, by seeded draws.

    What lies beyond the draws is extrapolated by the tail's own decay: its logarithm falls about linearly in the logarithm of z
    (few robots: the median of deviations in the denominator comes near zero) or faster, so that the threshold is rather too high.

    Args:
        n: Robots.
        chance: Of exceeding it.
    """
    largest = _largest(n)
    if chance * len(largest) >= DRAWS_BEYOND:
        return float(np.quantile(largest, 1.0 - chance))
    chances = [10.0 * DRAWS_BEYOND / len(largest), DRAWS_BEYOND / len(largest)]
    low, high = (float(np.log(np.quantile(largest, 1.0 - p))) for p in chances)
    slope = (high - low) / np.log(chances[0] / chances[1])
    return float(np.exp(high + slope * np.log(chances[1] / chance)))


@functools.lru_cache(maxsize=64)
def _largest(n: int) -> np.ndarray:
    """Largest z of n normal numbers, of many draws, shape (D,)."""
    draws = max(FEWEST_DRAWS // n, 2000)
    x = np.random.default_rng(n).standard_normal((draws, n))
    distance = np.abs(x - np.median(x, axis=1, keepdims=True))
    return np.asarray(distance.max(axis=1) / (TO_SIGMA * np.median(distance, axis=1)))
