"""A fleet computed: what is there already, what is to be done, and its table, whatever stops it."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aridcal.jobs.fleet.keys import Inputs
from aridcal.jobs.fleet.local_engine import Engine, EngineGone, WorkFailure
from aridcal.jobs.fleet.members import Member
from aridcal.jobs.fleet.run_record import DONE, FAILED, Row, failed_row, row_of_folder
from aridcal.jobs.fleet.run_table import latest, merged, read_rows, write_rows
from aridcal.jobs.fleet.work import Task, Write, calibrated, inputs_at
from aridcal.system.errors import shortened
from aridcal.system.progress import Progress

SAVE_EVERY = 60.0
"""[s] between two writings of the table while robots are computed: what is lost of it with a kill is in their own folders."""


@dataclass(frozen=True)
class FleetResults:
    """Results of a fleet.

    Attributes:
        rows: All rows of its table, earlier runs too, the oldest first.
        now: The last row of each robot of the fleet; of robots that remain the row before, if there is one.
        kept: Robots whose result was there already.
        failed: Robots that failed, with the reason.
        remaining: Robots that were not computed.
        gone: Why some robots remain; empty if none does.
    """

    rows: tuple[Row, ...]
    now: dict[str, Row]
    kept: tuple[str, ...]
    failed: dict[str, str]
    remaining: tuple[str, ...]
    gone: str


@dataclass(frozen=True)
class FleetPlan:
    """The work that a fleet needs.

    Attributes:
        fleet: Its robots.
        out: Its folder.
        rows: Of its table, with those that killed runs left in their folders.
        known: Rows of robots that need not be computed, or cannot be.
        tasks: Of the other robots, by their names on a cluster.
        inputs: Of every robot.
    """

    fleet: tuple[Member, ...]
    out: Path
    rows: tuple[Row, ...]
    known: dict[str, Row]
    tasks: dict[str, Task]
    inputs: dict[str, Inputs]


def plan_runs(fleet: Sequence[Member], out: Path, write: Write, progress: Progress) -> FleetPlan:
    """Find the robots whose folder does not hold their result.

    Args:
        fleet: Its robots.
        out: Its folder, claimed by the caller.
        write: Writes a result folder.
        progress: Told how far it is.

    Raises:
        OutputError: the file in the table's place is no table.
    """
    progress("looking at what is there")
    rows = merged(read_rows(out), _rows_in_folders(out))
    rows_known: dict[str, Row] = {}
    tasks: dict[str, Task] = {}
    inputs_of_robot: dict[str, Inputs] = {}
    for member in progress.over(fleet, "robots"):
        folder = out.absolute() / member.name
        inputs, campaign, reason = inputs_at(member.campaign)
        inputs_of_robot[member.name] = inputs
        row = row_of_folder(folder)
        if campaign is None:
            rows_known[member.name] = failed_row(member.name, member.campaign, inputs, reason, 0.0, None)
        elif row is not None and row["key"] == inputs.key:
            rows_known[member.name] = row
        else:
            tasks[task_name(member.name, folder, inputs.key)] = Task(
                member.name, str(member.campaign), str(folder), inputs.key, write
            )
    return FleetPlan(tuple(fleet), out, tuple(merged(rows, rows_known.values())), rows_known, tasks, inputs_of_robot)


def computed(plan: FleetPlan, engine: Engine, progress: Progress) -> FleetResults:
    """Calibrate the robots that a plan has tasks for.

    The table is written before, every minute and after, also if the work is stopped.

    Args:
        plan: What is to be done.
        engine: Does it.
        progress: Told how far it is.

    Raises:
        OutputError: the table cannot be written.
    """
    rows, results = list(plan.rows), dict(plan.known)
    reason, saved_at = "", time.monotonic()
    report = _Report(len(plan.tasks), progress)
    write_rows(rows, plan.out)
    try:
        for name, answer in engine(calibrated, plan.tasks):
            robot, campaign = plan.tasks[name].robot, Path(plan.tasks[name].campaign)
            if isinstance(answer, WorkFailure):
                answer = failed_row(robot, campaign, plan.inputs[robot], answer.why, 0.0, None)
            results[robot] = answer
            rows = merged(rows, [answer])
            report(answer)
            if time.monotonic() - saved_at > SAVE_EVERY:
                write_rows(rows, plan.out)
                saved_at = time.monotonic()
    except EngineGone as problem:
        reason = str(problem)
    finally:
        write_rows(rows, plan.out)
    last = latest(rows)
    return FleetResults(
        rows=tuple(rows),
        now={m.name: last[m.name] for m in plan.fleet if m.name in last} | results,
        kept=tuple(name for name, row in plan.known.items() if row["status"] == DONE),
        failed={name: row["error"] for name, row in sorted(results.items()) if row["status"] == FAILED},
        remaining=tuple(m.name for m in plan.fleet if m.name not in results),
        gone=reason,
    )


def task_name(robot: str, folder: Path, key: str) -> str:
    """A task's name on a cluster: other fleets on it have other names for the same robot."""
    return f"aridcal-{hashlib.sha256(f'{robot} {folder} {key}'.encode()).hexdigest()}"


def _rows_in_folders(out: Path) -> list[Row]:
    """Rows of all result folders in a fleet's: a run that was killed has not brought them into the table."""
    folders = sorted(path for path in out.iterdir() if path.is_dir()) if out.is_dir() else []
    return [row for row in map(row_of_folder, folders) if row is not None]


class _Report:
    """Progress over the robots that are computed: done, failed, how much longer.

    Args:
        total: How many are to be computed.
        progress: Told of it.
    """

    def __init__(self, total: int, progress: Progress) -> None:
        self._total, self._progress = total, progress
        self._done = self._failed = 0
        if total:
            progress(f"calibrating {total:,} robots")

    def __call__(self, row: Row) -> None:
        self._done += 1
        if row["status"] == FAILED:
            self._failed += 1
            self._progress.note(f"{row['robot']} failed: {shortened(row['error'].splitlines()[0], 200)}")
        failed = f", {self._failed:,} failed" if self._failed else ""
        self._progress.part(self._done, self._total, f"robots{failed}")
