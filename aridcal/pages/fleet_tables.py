"""A fleet and a study as DataFrames: the figures of their pages, for Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

import pandas as pd

from aridcal.jobs.fleet.drifts import drifting
from aridcal.jobs.fleet.outliers import OutlyingFigure, outlying_robots
from aridcal.jobs.fleet.row_figures import STAGES, are_done, channels_of, error_of
from aridcal.jobs.fleet.run_record import RUN_SCHEMA, Row, typed
from aridcal.jobs.fleet.runs import FleetResults
from aridcal.jobs.fleet.study_figures import CaseFigures, ConstantScatter, Estimate, points, recurrent_effects, scatters
from aridcal.jobs.fleet.study_records import STUDY_SCHEMA as OF_RUNS
from aridcal.jobs.fleet.study_records import StudyResult

ROBOT_COLUMNS = ("robot", "status", "measured", "rows", "verdict", "error")
"""Behind them stand the errors, RMS on held-out rows: ``final_position_mm`` for instance."""


def robot_table(ran: FleetResults) -> pd.DataFrame:
    """A row for each robot asked for, the worst first; what failed has no figures, what remains is not there."""
    rows = list(ran.now.values())
    names = [(stage, channel) for channel in channels_of(rows) for stage in STAGES[::-1]]
    table_rows = [
        {key: typed(row)[key] for key in ROBOT_COLUMNS}
        | {f"{stage}_{channel}": error_of(row, stage, channel) for stage, channel in names}
        for row in rows
    ]
    errors = [f"{stage}_{channel}" for stage, channel in names]
    table = pd.DataFrame(table_rows, columns=[*ROBOT_COLUMNS, *errors])
    return table.sort_values(errors[0], ascending=False, ignore_index=True) if errors else table


def nested_table(ran: FleetResults, column: str) -> pd.DataFrame:
    """What the last run of every robot has in one of its lists, an entry a row.

    Args:
        ran: The fleet.
        column: ``effects`` or ``constants``, as in ``fleet.parquet``.
    """
    rows = [{"robot": row["robot"]} | entry for row in are_done(list(ran.now.values())) for entry in row[column]]
    return pd.DataFrame(rows, columns=["robot", *(field.name for field in RUN_SCHEMA.field(column).type.value_type)])


def outstanding_table(ran: FleetResults) -> pd.DataFrame:
    """Numbers of robots that stand out of their make, the farthest first, [m] and [rad]."""
    outliers, _ = outlying_robots(list(ran.now.values()))
    return pd.DataFrame([asdict(out) for out in outliers], columns=_names(OutlyingFigure))


def drift_table(ran: FleetResults) -> pd.DataFrame:
    """Constants of the first run and the last one of each robot, [m] and [rad], worst first; ``beyond`` what chance gives."""
    drifts, _ = drifting([row for row in ran.rows if row["robot"] in ran.now])
    columns = ["robot", "name", "unit", "first", "first_std", "last", "last_std", "days", "times", "beyond"]
    rows = [(d.robot, d.name, d.unit, *d.first, *d.last, d.days, d.times, d.significant) for d in drifts]
    return pd.DataFrame(rows, columns=columns)


def run_table(done: StudyResult) -> pd.DataFrame:
    """Every run of a study, as ``study.parquet`` has it, without its lists."""
    return pd.DataFrame(list(done.rows), columns=[n for n in OF_RUNS.names if n not in ("effects", "constants")])


def case_table(done: StudyResult) -> pd.DataFrame:
    """A row for each case of a study: shares and medians, each with the ends of its interval behind it."""
    return pd.DataFrame([_case(point) for point in points(done.rows)])


def _case(point: CaseFigures) -> Row:
    estimates = {"found": point.finding_share} | {
        name: getattr(point, name) for name in ("named", "others", "final", "true")
    }
    row: Row = {name: getattr(point, name) for name in ("rows", "size", "runs", "failed")}
    for name, estimate in estimates.items():
        row |= _estimate(name, estimate)
    return row


def recurrent_table(halves: Sequence[Row]) -> pd.DataFrame:
    """Effects that runs on halves of a campaign's rows found, and the share of runs, most first."""
    rows = [{"effect": label} | _estimate("share", share) for label, share in recurrent_effects(halves)]
    return pd.DataFrame(rows, columns=["effect", *_estimate("share", None)])


def scatter_table(halves: Sequence[Row]) -> pd.DataFrame:
    """How far constants scatter over halves of a campaign's rows, [m] and [rad], beside what each run states."""
    return pd.DataFrame([asdict(s) for s in scatters(halves)], columns=_names(ConstantScatter))


def _estimate(name: str, estimate: Estimate | None) -> Row:
    """A figure and its interval; nothing of what is not known."""
    value, low, high = (None, None, None) if estimate is None else (estimate.value, estimate.low, estimate.high)
    return {name: value, f"{name}_low": low, f"{name}_high": high}


def _names(kind: Any) -> list[str]:
    return [field.name for field in fields(kind)]
