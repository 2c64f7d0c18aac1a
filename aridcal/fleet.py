"""Calibrate many robots: each campaign a result folder below DIR, with a table and a page on all of them.

A robot is called as the folder of its campaign. The work is done by processes of this computer, one for each core, or by a Dask
cluster: `dask scheduler` and `dask worker ADDRESS --nthreads 1` started wherever the same files are to be seen under the same
paths. What DIR holds already, from the same files and this version, is not computed again: a fleet that was stopped goes on
where it was, and one of which a few robots were measured anew computes these.

A robot that fails is named with its reason and costs no other. DIR/fleet.parquet keeps earlier runs, too.

Exit status: 0 all robots are done, 2 bad use, 3 robots failed or remain.

Example:
    aridcal fleet 'robots/*/campaign.yaml' -o fleet
    aridcal fleet 'robots/*/campaign.yaml' -o fleet --scheduler tcp://10.0.0.1:8786
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aridcal.command_line import DONE, NOT_GOOD, CommandParser, command_parser, for_clusters, for_scripts, run, screens
from aridcal.drawing.html import counted, tag
from aridcal.errors import shortened
from aridcal.overview.fleet_page import fleet_page
from aridcal.plant.engine import dask_engine
from aridcal.plant.here import here
from aridcal.plant.members import TAKEN, Member, members
from aridcal.plant.runs import Ran, computed, planned
from aridcal.plant.table import NAME
from aridcal.reading.names import path_argument
from aridcal.result_folder import write_folder
from aridcal.showing import Progress, told_on
from aridcal.writing.apart import check_apart
from aridcal.writing.files import atomic_file, claimed
from aridcal.writing.staging import clear_up

if TYPE_CHECKING:
    import pandas as pd

PAGE = "fleet.html"

MOST_NAMED = 20
"""Robots that failed, or remain, named on the screen; the page has all of the former."""


@dataclass(frozen=True, repr=False, eq=False)
class FleetRun:
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

    def __repr__(self) -> str:
        return "\n".join(self.lines)

    def _repr_html_(self) -> str:
        return "".join(tag("div", line) for line in self.lines)


def fleet_run(ran: Ran, out: Path) -> FleetRun:
    """What became of a fleet, for Python."""
    from aridcal.overview.as_tables import drift_table, nested_table, outstanding_table, robot_table

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


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("fleet", __doc__)
    arguments.add_argument(
        "campaigns",
        nargs="+",
        metavar="CAMPAIGN",
        help="campaigns, or patterns of them in quotes: 'robots/*/campaign.yaml'",
    )
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, metavar="DIR", help="folder of all results"
    )
    for_clusters(arguments)
    for_scripts(arguments)
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> int:
    out: Path = arguments.out
    fleet = members(arguments.campaigns, out)
    check_apart((out / name for name in TAKEN), (member.campaign for member in fleet))
    console, aside = screens(arguments)
    with told_on(aside) as progress:
        ran = calibrated_fleet(fleet, out, arguments.scheduler, progress)
    for line in summary(ran):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    console.print(f"table: {out / NAME}\npage: {out / PAGE}", markup=False, highlight=False, soft_wrap=True)
    return NOT_GOOD if ran.failed or ran.remaining else DONE


def calibrated_fleet(fleet: Sequence[Member], out: Path, scheduler: str | None, progress: Progress) -> Ran:
    """Calibrate what is not there yet, and write table and page.

    Args:
        fleet: Its robots.
        out: Its folder.
        scheduler: Address of a Dask cluster; None: processes of this computer.
        progress: Told how far it is.

    Raises:
        AridcalError: the folder cannot be used, or the engine not be had.
    """
    with claimed(out, "folder", TAKEN):
        out.mkdir(exist_ok=True)
        try:
            plan = planned(fleet, out, write_folder, progress)
            with dask_engine(scheduler, progress) if plan.tasks else nullcontext(here) as engine:
                ran = computed(plan, engine, progress)
        finally:
            clear_up(out, out)  # what workers have left that were stopped in the middle of a folder
        progress("drawing the page")
        with atomic_file(out / PAGE) as path:
            path.write_bytes(
                fleet_page(ran, f"{out.absolute().parent.name}/{out.absolute().name}").encode("utf-8", "replace")
            )
    return ran


def summary(ran: Ran) -> list[str]:
    """What became of the fleet, in lines."""
    done = len(ran.now) - len(ran.failed) - sum(name in ran.now for name in ran.remaining)
    asked = done + len(ran.failed) + len(ran.remaining)
    known = f", {len(ran.kept):,} of them known already" if ran.kept else ""
    lines = [f"{done:,} of {counted(asked, 'robot')} done{known}"]
    if ran.failed:
        lines.append(f"{counted(len(ran.failed), 'robot')} failed:")
        named = list(ran.failed.items())
        lines += [f"  {name}: {shortened(why, 400)}" for name, why in named[:MOST_NAMED]]
        lines += _more(len(named))
    if ran.remaining:
        lines.append(f"{counted(len(ran.remaining), 'robot')} remain, for {ran.gone}:")
        lines += [f"  {name}" for name in ran.remaining[:MOST_NAMED]]
        lines += _more(len(ran.remaining))
        lines.append("start the same command again: what is done stays")
    return lines


def _more(count: int) -> list[str]:
    return [f"  and {count - MOST_NAMED:,} more"] if count > MOST_NAMED else []


if __name__ == "__main__":
    sys.exit(main())
