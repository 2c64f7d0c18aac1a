r"""Fleets over time: which constants of which robots drift or jump, false alarms of a whole season being stated.

Every constant of every robot is a series (:mod:`aridcal.jobs.history.trend`), compared in one gauge: a robot's runs count as
one series where they have the same nominal URDF and told the same constants, for then the same ones stayed at their nominal
value and what is not told went to the same places. Runs in another gauge are named, and left out. Base and target are no
constants of the arm.

The smallest p-value of all series is judged as one of many (Bonferroni 1936):

.. math:: p_{fleet} = S \max(n, 12)\, p

with S series and n runs of the robot: who looks once a month looks so often in a year, and an alarm at any of these times
counts. Of seasons in which nothing changes at most :data:`FALSE_ALARMS` have an alarm anywhere in the fleet.

Calibrations may scatter more than their sigma says: the target was put on anew, the hall was warm. How much more is taken from
the whole fleet, for each constant: the median over robots of the squares that a constant and a cycle leave, over the median of
chi squared. Of few robots all constants are taken together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtri

from aridcal.jobs.history.store import Runs
from aridcal.jobs.history.trend import (
    FEWEST_RUNS,
    ChangeEvidence,
    Cycle,
    Series,
    SeriesChange,
    dated,
    evidence,
    with_cycle,
)
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.system.errors import AridcalError, nearest
from aridcal.system.wording import number

LOOKS_PER_SEASON = 12
"""Fewest looks at a season that its chances allow for: once a month."""

FEWEST_ROBOTS_OF_A_CYCLE = 8
"""Fewest robots for a scatter or a cycle of one constant by itself: a median of eight is good to 40 %."""

MAD = 1.4826
"""Times the median of absolute deviations: the sigma of a normal distribution."""

LEAST_CYCLE = 0.3
"""Share of the usual sigma of a fitted cycle by which cycles of robots differ at the least: a fleet's median is no better
known."""

DAY_ZERO = pd.Timestamp("1970-01-01")
"""Of all days that are counted."""


@dataclass(frozen=True)
class ConstantHistory:
    """One constant of one robot.

    Attributes:
        robot: Its name.
        name: Of the constant.
        unit: m or rad.
        series: Its values; ``std`` with the fleet's scatter.
        shows: Evidence of a change.
        p_value: Of a change, for all series of the fleet and all looks of a season.
        p_any: Likewise, with a yearly cycle counted as a change.
        change: The change; None without an alarm.
    """

    robot: str
    name: str
    unit: str
    series: Series
    shows: ChangeEvidence
    p_value: float
    p_any: float
    change: SeriesChange | None

    @property
    def alarm(self) -> bool:
        """Whether the constant changed, and no yearly cycle explains that."""
        return self.change is not None

    @property
    def cycles(self) -> bool:
        """Whether the constant moved in a way that a yearly cycle explains as well: nobody can tell yet."""
        return not self.alarm and self.p_any < FALSE_ALARMS


@dataclass(frozen=True)
class RobotHistory:
    """One robot.

    Attributes:
        name: Of the robot.
        runs: Its rows of :attr:`Runs.runs`.
        errors: Its rows of :attr:`Runs.errors`, with ``measured``.
        watched: Its constants, the likeliest change first.
        notices: What a reader should know of it.
    """

    name: str
    runs: pd.DataFrame
    errors: pd.DataFrame
    watched: tuple[ConstantHistory, ...]
    notices: tuple[str, ...]

    @property
    def alarms(self) -> tuple[ConstantHistory, ...]:
        """Constants that changed."""
        return tuple(w for w in self.watched if w.alarm)

    @property
    def cycles(self) -> tuple[ConstantHistory, ...]:
        """Constants that may go with the season."""
        return tuple(w for w in self.watched if w.cycles)

    def error(self, stage: str) -> tuple[str, np.ndarray]:
        """RMS of the first channel on held-out rows, run by run, and the channel's name; NaN where a run has none."""
        of_stage = self.errors[self.errors["stage"] == stage]
        if not len(of_stage):
            return "", np.zeros(0)
        channel = str(of_stage["channel"].iloc[0])
        return channel, of_stage.loc[of_stage["channel"] == channel, "rms"].to_numpy(dtype=float)

    def last_error(self, stage: str) -> str:
        """The last run's error, with its unit; a dash where there is none."""
        channel, errors = self.error(stage)
        return f"{number(float(errors[-1]))} {channel.rsplit('_', 1)[-1]}" if len(errors) else "–"

    @property
    def last_day(self) -> str:
        """Date of the last run."""
        return str(self.runs["measured"].max().strftime("%Y-%m-%d"))


@dataclass(frozen=True)
class History:
    """A fleet over time.

    Attributes:
        robots: The worst first.
        series: Number of series that were looked at.
        scatter: Scatter of each constant, in units of its sigma.
        files: Tables that were read.
    """

    robots: tuple[RobotHistory, ...]
    series: int
    scatter: Mapping[str, float]
    files: tuple[str, ...]


def history(of: Runs, only: str | None = None) -> History:
    """Look at every robot's constants over time.

    Args:
        of: All runs.
        only: The one robot to be shown; the others count as much for its alarms.

    Raises:
        AridcalError: there is no such robot.
    """
    names = sorted(set(of.runs["robot"]))
    if only is not None and only not in names:
        raise AridcalError(f"{only}: no robot of this name was calibrated{nearest(only, names)}")
    constants: dict[Any, pd.DataFrame] = dict(iter(of.constants.groupby("run", sort=False)))
    robots = {}
    for name, runs in of.runs.groupby("robot", sort=True):
        comparable, notices = _one_gauge(runs, constants)
        robots[str(name)] = (runs, _series(comparable, constants), notices)
    all_series = [
        (name, constant, unit, series)
        for name, (_, by_chance, _) in robots.items()
        for constant, unit, series in by_chance
    ]
    scatter = _scatter(all_series)
    all_series = [(r, c, unit, replace(s, std=scatter[c] * s.std)) for r, c, unit, s in all_series]
    cycles = _cycles(all_series)
    watched: dict[str, list[ConstantHistory]] = {name: [] for name in robots}
    for robot, constant, unit, series in all_series:
        watched[robot].append(_judged(robot, constant, unit, series, len(all_series), cycles.get(constant)))
    histories = []
    for name, (runs, _, notices) in robots.items():
        errors = of.errors.merge(runs[["run", "measured"]], on="run")
        by_chance = sorted(watched[name], key=lambda w: (w.p_value, w.shows.p_value, w.p_any))
        histories.append(RobotHistory(name, runs, errors, tuple(by_chance), tuple(notices)))
    histories.sort(key=_badness)
    shown = [robot for robot in histories if only in (None, robot.name)]
    return History(tuple(shown), len(all_series), scatter, tuple(map(str, of.files)))


def _badness(robot: RobotHistory) -> tuple[int, float, int, float, str]:
    """Sort key of robots: alarms, the surest first, then what may be the season, then the last error."""
    _, errors = robot.error("final")
    last = float(errors[-1]) if len(errors) and np.isfinite(errors[-1]) else 0.0
    least = min((w.shows.p_value for w in robot.alarms), default=1.0)
    return -bool(robot.alarms), least, -bool(robot.cycles), -last, robot.name


def _one_gauge(runs: pd.DataFrame, constants: Mapping[Any, pd.DataFrame]) -> tuple[pd.DataFrame, list[str]]:
    """Runs of one robot that can be compared, and notices of the others."""
    failures = runs[runs["status"] != "done"]
    notices = [f"{len(failures)} of {len(runs)} runs failed: {failures['error'].iloc[-1]}"] if len(failures) else []
    done = runs[runs["status"] == "done"]
    gauges: dict[tuple[str, frozenset[str]], list[int]] = {}
    for place, (run, urdf) in enumerate(zip(done["run"], done["urdf"], strict=True)):
        of_run = constants.get(run)
        names = frozenset(of_run["name"]) if of_run is not None else frozenset()
        gauges.setdefault((str(urdf), names), []).append(place)
    if not gauges:
        return done, notices
    best = max(gauges.values(), key=lambda places: (len(places), places[-1]))
    if len(best) < len(done):
        notices.append(
            f"{len(done) - len(best)} of {len(done)} runs told other constants, or were of another nominal URDF: their constants "
            "stand for other motions and are not compared; measure the same configurations every time"
        )
    return done.iloc[best], notices


def _series(runs: pd.DataFrame, constants: Mapping[Any, pd.DataFrame]) -> list[tuple[str, str, Series]]:
    """The constants of some runs over time: name, unit, values."""
    tables = [constants[run] for run in runs["run"] if run in constants]
    if len(tables) < 2:
        return []
    day = ((runs["measured"] - DAY_ZERO) / pd.Timedelta(days=1)).to_numpy(dtype=float)
    first = tables[0]
    values, stds = (
        np.array([table.set_index("name")[column].reindex(first["name"]).to_numpy(dtype=float) for table in tables])
        for column in ("value", "std")
    )
    return [
        (str(name), str(unit), Series(day, values[:, k], stds[:, k]))
        for k, (name, unit) in enumerate(zip(first["name"], first["unit"], strict=True))
    ]


def _scatter(all_series: Sequence[tuple[str, str, str, Series]]) -> dict[str, float]:
    """Scatter of each constant in units of its sigma, never below 1."""
    ratios: dict[str, list[float]] = {}
    for _, constant, _, series in all_series:
        squares, freedom = evidence(series).squares
        if freedom > 0:
            ratios.setdefault(constant, []).append(squares / float(chdtri(freedom, 0.5)))
    pooled = [ratio for own in ratios.values() for ratio in own]
    overall = float(np.median(pooled)) if pooled else 1.0
    return {
        constant: float(
            np.sqrt(
                max(
                    1.0, np.median(own) if len(own := ratios.get(constant, [])) >= FEWEST_ROBOTS_OF_A_CYCLE else overall
                )
            )
        )
        for constant in {constant for _, constant, _, _ in all_series}
    }


def _cycles(all_series: Sequence[tuple[str, str, str, Series]]) -> dict[str, Cycle]:
    """The yearly cycle of each constant that the robots of the fleet have in common, where there are enough of them."""
    fitted: dict[str, list[np.ndarray]] = {}
    for _, constant, _, series in all_series:
        if len(series.day) >= FEWEST_RUNS:
            A = with_cycle(series.day) / series.std[:, None]
            inverse = np.linalg.pinv(A)
            theta, std = inverse @ (series.value / series.std), np.sqrt(np.sum(inverse**2, axis=1))
            fitted.setdefault(constant, []).append(np.concatenate([theta[1:], std[1:]]))
    fleet_cycles = {}
    for constant, of_constant in fitted.items():
        if len(of_constant) >= FEWEST_ROBOTS_OF_A_CYCLE:
            values = np.array(of_constant)
            mean, noise = np.median(values[:, :2], axis=0), np.median(values[:, 2:], axis=0)
            scatter = MAD * np.median(np.abs(values[:, :2] - mean), axis=0)
            spread = np.sqrt(np.maximum(scatter**2 - noise**2, (LEAST_CYCLE * noise) ** 2))
            fleet_cycles[constant] = Cycle((float(mean[0]), float(mean[1])), (float(spread[0]), float(spread[1])))
    return fleet_cycles


def _judged(robot: str, constant: str, unit: str, series: Series, count: int, cycle: Cycle | None) -> ConstantHistory:
    """One series, judged as one of ``count``."""
    shows = evidence(series)
    looks = count * max(len(series.day), LOOKS_PER_SEASON)
    p_value, p_any = min(1.0, looks * shows.p_value), min(1.0, looks * shows.p_any)
    change = dated(series, cycle) if p_value < FALSE_ALARMS else None
    return ConstantHistory(robot, constant, unit, series, shows, p_value, p_any, change)
