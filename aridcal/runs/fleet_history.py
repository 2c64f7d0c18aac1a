"""A fleet over time, as Python users have it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from aridcal.jobs.history.store import read_runs
from aridcal.jobs.history.wear import history
from aridcal.pages.history_page import alarm_table, constant_table, error_table, lines, robot_table
from aridcal.system.progress import PrintedAnswer


@dataclass(frozen=True, repr=False, eq=False)
class FleetHistory(PrintedAnswer):
    """A fleet over time, for Python.

    Attributes:
        robots: A row for each robot, the worst first.
        alarms: A row for each constant that changed: when, by how much, [m] and [rad], of a drift for a month.
        constants: Every constant in every run, [m] and [rad].
        errors: Errors on held-out rows, run by run.
        lines: The whole answer in words.
    """

    robots: pd.DataFrame
    alarms: pd.DataFrame
    constants: pd.DataFrame
    errors: pd.DataFrame
    lines: tuple[str, ...]


def over_time(folder: str | Path, robot: str | None = None) -> FleetHistory:
    """Read a fleet's calibrations over time.

    Args:
        folder: What `aridcal fleet` wrote, or a folder above several of them.
        robot: The one to be shown; None: all.

    Raises:
        AridcalError: there are no runs, or none of this robot.
    """
    found = history(read_runs(Path(folder)), robot)
    tables = robot_table(found), alarm_table(found), constant_table(found), error_table(found)
    return FleetHistory(*tables, tuple(lines(found)))
