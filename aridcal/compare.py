"""Tell what changed between two calibrations of one robot, beyond the uncertainty of both.

The predicted poses are compared in configurations that both calibrations saw, with the covariance of all coefficients of both.
What nobody can tell is taken off first: a base, a tool or a tracker that was set up anew, constants that the rows of one could
not tell. Then the fewest zeros, constants and effects that explain the rest are named, with size, sigma and p-value. Of robots
that did not change 1 % are said to have.

With -o DIR, DIR/compare.html and DIR/compare.json are written.

Exit status: 0 nothing changed beyond the uncertainty, 3 changed.

Example:
    aridcal compare results/march results/april
    aridcal compare results/march results/april -o changes
"""

from __future__ import annotations

import argparse
import json
import sys

from aridcal.command_line import DONE, NOT_GOOD, CommandParser, command, command_parser, for_scripts, screens
from aridcal.jobs.calibrate.folder import finite
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.history.comparison import Comparison, compare, document, lines
from aridcal.pages.compare_page import compare_page
from aridcal.system.progress import Screen
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.whole_files import atomic_folder, claimed

COMPARISON_FILES = frozenset({"compare.html", "compare.json"})
"""All that is written."""


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("compare", __doc__)
    arguments.add_argument("first", type=path_argument, help="result folder, or its calibration.yaml")
    arguments.add_argument("second", type=path_argument, help="the same of the later calibration")
    arguments.add_argument(
        "-o", "--out", type=path_argument, metavar="DIR", help="where to write compare.html and compare.json"
    )
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> int:
    if arguments.out is None:
        return _exit_status(
            compare(SavedModel.load(arguments.first), SavedModel.load(arguments.second)), screens(arguments)[0]
        )
    check_apart((arguments.out / name for name in COMPARISON_FILES), [arguments.first, arguments.second])
    with claimed(arguments.out, "folder", COMPARISON_FILES):
        comparison = compare(SavedModel.load(arguments.first), SavedModel.load(arguments.second))
        with atomic_folder(arguments.out, COMPARISON_FILES) as stage:
            text = json.dumps(finite(document(comparison)), indent=2, allow_nan=False)
            (stage / "compare.json").write_text(text + "\n", encoding="utf-8")
            page = compare_page(comparison, (str(arguments.first), str(arguments.second)))
            (stage / "compare.html").write_text(page, encoding="utf-8", errors="replace")
        return _exit_status(comparison, screens(arguments)[0])


def _exit_status(comparison: Comparison, console: Screen) -> int:
    console.say(*lines(comparison), *(f"note: {notice}" for notice in comparison.notices))
    return NOT_GOOD if comparison.changed else DONE


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
