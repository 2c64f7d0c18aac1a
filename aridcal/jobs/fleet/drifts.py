r"""Constants that drift: the last run of a robot beside its first, against what both are known to.

For each constant :math:`t = (x_2 - x_1) / \sqrt{\sigma_1^2 + \sigma_2^2}`, judged by Student's distribution: a noise that nobody
declared is known as well as the rows are many. All constants of all robots share one chance of a false alarm (Bonferroni). The
standard deviations know of the noise alone: what a model lacks may move constants further where other configurations were
measured.

Runs are compared that have the same URDF and told the same constants: else those stand for other motions, as what is not told
went elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from scipy.special import stdtr

from aridcal.jobs.fleet.row_figures import are_done, channels_of, identified
from aridcal.jobs.fleet.run_record import Row, typed
from aridcal.jobs.maintain.bounds import FALSE_ALARMS

THREE_NUMBERS = ("position_", "rotation_")
"""Beginnings of the names of channels whose rows have three numbers."""


@dataclass(frozen=True)
class Drift:
    """A change of a constant between the first and the last run of a robot.

    Attributes:
        robot: Its name.
        name: Of the constant.
        unit: ``m`` or ``rad``.
        first: Value and standard deviation of the first run.
        last: Value and standard deviation of the last run.
        days: Between the two measurements.
        times: The change, in standard deviations of the difference.
        significant: Whether the change is more than chance gives among so many constants.
    """

    robot: str
    name: str
    unit: str
    first: tuple[float, float]
    last: tuple[float, float]
    days: float
    times: float
    significant: bool


def drifting(rows: Sequence[Row]) -> tuple[list[Drift], int]:
    """Constants of robots that were measured more than once, worst first.

    Args:
        rows: All runs of all robots.

    Returns:
        Every constant that was compared; and how many robots.
    """
    pairs = [pair for own in _by_robot(rows).values() if (pair := _first_and_last(own)) is not None]
    by_chance: list[tuple[float, Drift]] = []
    for first, last in pairs:
        days = (typed(last)["measured"] - typed(first)["measured"]).total_seconds() / 86400.0
        before, after = identified(first), identified(last)
        for name in before:
            (x1, s1), (x2, s2) = (
                (float(of[name]["value"]), float(of[name]["std"]))  # type: ignore[arg-type]
                for of in (before, after)
            )
            both = math.hypot(s1, s2)
            if both > 0.0:
                times = abs(x2 - x1) / both
                unit = str(before[name]["unit"])
                chance = chance_of(times, freedom_of(first) + freedom_of(last))
                by_chance.append((chance, Drift(last["robot"], name, unit, (x1, s1), (x2, s2), days, times, False)))
    limit = FALSE_ALARMS / max(len(by_chance), 1)
    ordered = sorted(by_chance, key=lambda pair: (pair[0], -pair[1].times))
    return [replace(drift, significant=chance < limit) for chance, drift in ordered], len(pairs)


def chance_of(times: float, freedom: float) -> float:
    """Chance that a constant which does not move is so many standard deviations off, or more, either way.

    Args:
        times: Number of standard deviations.
        freedom: Degrees of freedom of the standard deviation.
    """
    return 2.0 * float(stdtr(freedom, -times))


def freedom_of(row: Row) -> float:
    """Fewest degrees of freedom of a run's noise: numbers of its fitted rows less the identified constants.

    A target's position has three numbers, its rotation three more, which are not counted; all else may have one a row.
    """
    fitted = row["rows"] - max((found["rows"] for found in row["stages"]), default=0)
    numbers_per_row = 3 if all(channel.startswith(THREE_NUMBERS) for channel in channels_of([row])) else 1
    constants_told = sum(constant["status"] == "identified" for constant in row["constants"])
    return float(max(numbers_per_row * fitted - constants_told, 1))


def _by_robot(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Runs with a result, by robot, in the order of their measurements; of one measurement the last run alone."""
    runs: dict[str, dict[str, Row]] = {}
    for row in are_done(rows):
        runs.setdefault(row["robot"], {})[row["inputs"]] = row
    return {name: sorted(of_robot.values(), key=lambda row: typed(row)["measured"]) for name, of_robot in runs.items()}


def _first_and_last(runs: Sequence[Row]) -> tuple[Row, Row] | None:
    """The two runs to compare, of the robot's present make and with the constants that its last run identified."""
    alike = [row for row in runs if (row["urdf"], *identified(row)) == (runs[-1]["urdf"], *identified(runs[-1]))]
    return (alike[0], alike[-1]) if len(alike) > 1 else None
