"""Tell which robots of a fleet drift or jump, from all its calibrations over time: the worst first.

DIR is a folder that `aridcal fleet` wrote, or one above several: every fleet.parquet below it counts. Each constant of each
robot is followed from run to run. A drift or a jump raises an alarm, with the date on which it began and an interval; a yearly
cycle raises none. Of seasons in which nothing changes at most 1 % have an alarm anywhere in the fleet, however often one looks.
Base and tool are set up anew for every measurement and are not counted, nor is what looks like them.

With -o DIR, DIR/history.html and DIR/history.csv are written; the table has every constant in every run.

Exit status: 0 no alarm, 3 an alarm among the robots that were asked about.

Needs DuckDB: pip install "aridcal[fleet]".

Example:
    aridcal history fleet
    aridcal history fleet r017
    aridcal history fleet -o season
"""

from __future__ import annotations

import argparse
import sys

from rich.table import Table
from rich.text import Text

from aridcal.command_line import DONE, NOT_GOOD, CommandParser, command, command_parser, for_scripts, screens
from aridcal.jobs.history.store import read_runs, tables_below
from aridcal.jobs.history.wear import History, history
from aridcal.pages.history_page import (
    about,
    constant_table,
    history_page,
    remarks,
)
from aridcal.system.progress import Screen
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import write_table
from aridcal.system.writing.whole_files import atomic_folder, claimed

HISTORY_FILES = frozenset({"history.html", "history.csv"})
"""All that is written."""

SHOWN_ROBOTS = 12
"""Robots that are printed, and lines about them; the page has all."""


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("history", __doc__)
    arguments.add_argument("folder", type=path_argument, metavar="DIR", help="folder of one fleet or of several")
    arguments.add_argument("robot", nargs="?", help="show this one alone (default: all)")
    arguments.add_argument(
        "-o", "--out", type=path_argument, metavar="DIR", help="where to write history.html and history.csv"
    )
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> int:
    if arguments.out is None:
        return _print_remarks(history(read_runs(arguments.folder), arguments.robot), screens(arguments)[0])
    check_apart((arguments.out / name for name in HISTORY_FILES), tables_below(arguments.folder))
    with claimed(arguments.out, "folder", HISTORY_FILES):
        fleet_history = history(read_runs(arguments.folder), arguments.robot)
        with atomic_folder(arguments.out, HISTORY_FILES) as stage:
            page = history_page(fleet_history, str(arguments.folder))
            (stage / "history.html").write_text(page, encoding="utf-8", errors="replace")
            write_table(constant_table(fleet_history), stage / "history.csv")
        return _print_remarks(fleet_history, screens(arguments)[0])


def _print_remarks(fleet_history: History, console: Screen) -> int:
    console.print(_table(fleet_history))
    sentences = remarks(fleet_history)
    further = [f"and {len(sentences) - SHOWN_ROBOTS} more remarks"] if len(sentences) > SHOWN_ROBOTS else []
    console.say(*sentences[:SHOWN_ROBOTS], *further, *about(fleet_history))
    return NOT_GOOD if any(robot.alarms for robot in fleet_history.robots) else DONE


def _table(fleet_history: History) -> Table:
    """The worst robots."""
    of_all = f" ({SHOWN_ROBOTS} of {len(fleet_history.robots)})" if len(fleet_history.robots) > SHOWN_ROBOTS else ""
    table = Table(title=f"robots, the worst first{of_all}", title_justify="left")
    table.add_column("robot")
    for column in ("runs", "last run", "RMS before", "RMS after", "alarms"):
        table.add_column(column, justify="right")
    for robot in fleet_history.robots[:SHOWN_ROBOTS]:
        errors = [robot.last_error(stage) for stage in ("nominal", "final")]
        table.add_row(Text(robot.name), str(len(robot.runs)), robot.last_day, *errors, str(len(robot.alarms)))
    return table


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
