"""A fleet calibrated: a result folder for each robot, a table and a page on all of them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aridcal.jobs.fleet.cluster import dask_engine
from aridcal.jobs.fleet.local_engine import run_tasks
from aridcal.jobs.fleet.members import RESERVED_NAMES_OF_FLEET, Member
from aridcal.jobs.fleet.runs import FleetResults, computed, plan_runs
from aridcal.pages.fleet_page import fleet_page
from aridcal.runs.result_folder import write_folder
from aridcal.system.errors import shortened
from aridcal.system.progress import PrintedAnswer, Progress
from aridcal.system.wording import plural
from aridcal.system.writing.staging import clear_up
from aridcal.system.writing.whole_files import atomic_file, claimed

if TYPE_CHECKING:
    import pandas as pd


FLEET_PAGE = "fleet.html"

MOST_NAMED_ROBOTS = 20
"""Robots that failed, or remain, named on the screen; the page has all of the former."""


@dataclass(frozen=True, repr=False, eq=False)
class FleetRun(PrintedAnswer):
    """What became of a fleet, for Python.

    Attributes:
        folder: Of all results: ``fleet.parquet``, ``fleet.html``, and one folder for each robot.
        robots: A row for each robot, the worst first: status, errors on held-out rows, and why one failed.
        constants: Those of every robot, [m] and [rad].
        effects: Those of every robot, a coefficient a row.
        standing_out: Numbers of robots that are far from the others'.
        drifts: Constants between each robot's first run and its last one.
        failed: Robots that failed, with why.
        remaining: Robots that were not computed, for the engine went away.
        lines: The whole answer in words.
    """

    folder: Path
    robots: pd.DataFrame
    constants: pd.DataFrame
    effects: pd.DataFrame
    standing_out: pd.DataFrame
    drifts: pd.DataFrame
    failed: dict[str, str]
    remaining: tuple[str, ...]
    lines: tuple[str, ...]


def fleet_run(ran: FleetResults, out: Path) -> FleetRun:
    """What became of a fleet, for Python."""
    from aridcal.pages.fleet_tables import drift_table, nested_table, outstanding_table, robot_table

    return FleetRun(
        folder=out,
        robots=robot_table(ran),
        constants=nested_table(ran, "constants"),
        effects=nested_table(ran, "effects"),
        standing_out=outstanding_table(ran),
        drifts=drift_table(ran),
        failed=ran.failed,
        remaining=ran.remaining,
        lines=tuple(summary(ran)),
    )


def calibrated_fleet(fleet: Sequence[Member], out: Path, scheduler: str | None, progress: Progress) -> FleetResults:
    """Calibrate what is not there yet, and write table and page.

    Args:
        fleet: Its robots.
        out: Its folder.
        scheduler: Address of a Dask cluster; None: processes of this computer.
        progress: Told how far it is.

    Raises:
        AridcalError: the folder cannot be used, or the engine not be had.
    """
    with claimed(out, "folder", RESERVED_NAMES_OF_FLEET):
        out.mkdir(exist_ok=True)
        try:
            plan = plan_runs(fleet, out, write_folder, progress)
            with dask_engine(scheduler, progress) if plan.tasks else nullcontext(run_tasks) as engine:
                ran = computed(plan, engine, progress)
        finally:
            clear_up(out, out)  # what workers have left that were stopped in the middle of a folder
        progress("drawing the page")
        with atomic_file(out / FLEET_PAGE) as path:
            path.write_bytes(
                fleet_page(ran, f"{out.absolute().parent.name}/{out.absolute().name}").encode("utf-8", "replace")
            )
    return ran


def summary(ran: FleetResults) -> list[str]:
    """What became of the fleet, in lines."""
    done = len(ran.now) - len(ran.failed) - sum(name in ran.now for name in ran.remaining)
    requested = done + len(ran.failed) + len(ran.remaining)
    known_part = f", {len(ran.kept):,} of them known already" if ran.kept else ""
    lines = [f"{done:,} of {plural(requested, 'robot')} done{known_part}"]
    if ran.failed:
        lines.append(f"{plural(len(ran.failed), 'robot')} failed:")
        failures = list(ran.failed.items())
        lines += [f"  {name}: {shortened(why, 400)}" for name, why in failures[:MOST_NAMED_ROBOTS]]
        lines += _more(len(failures))
    if ran.remaining:
        lines.append(f"{plural(len(ran.remaining), 'robot')} remain, for {ran.gone}:")
        lines += [f"  {name}" for name in ran.remaining[:MOST_NAMED_ROBOTS]]
        lines += _more(len(ran.remaining))
        lines.append("start the same command again: what is done stays")
    return lines


def _more(count: int) -> list[str]:
    return [f"  and {count - MOST_NAMED_ROBOTS:,} more"] if count > MOST_NAMED_ROBOTS else []
