"""Tell whether a calibration is still good, from 5 to 20 new rows, and if it is not, what moved.

The rows have the columns and units of the campaign's own tables. Those of another instrument have a small campaign of their
own, which is named in place of the table: `measurements` with their noise, `instruments`, and `frames`, if the base or the
tool is another than that which was calibrated. What nobody knows of them is fitted with them. Rows should be measured in
attitudes that differ. The residual is set beside the noise and the calibration's own uncertainty: of calibrations that are
still right 1 % fail. If one fails, it is said what moved, with its probability: the zero of a joint, the tool, the base or the
instrument, one effect, or that rows are odd by themselves; and a configuration to measure, where two causes look alike (all
of them with --poses).

With --tolerance the question is another: a calibration fails only if its RMS position error is above the tolerance, which is
wrong in 1 % of cases, too.

Exit status: 0 still good, 3 no longer good.

Example:
    aridcal check results new.csv
    aridcal check results new.csv --tolerance 0.2mm
    aridcal check results touched_points.yaml --poses next.csv
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from aridcal.command_line import (
    DONE,
    NOT_GOOD,
    CommandParser,
    command,
    command_parser,
    for_scripts,
    print_headline,
    screens,
)
from aridcal.files.measurement_settings import length_argument
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.maintain.answers import check_lines
from aridcal.jobs.maintain.checking import CheckResult, check
from aridcal.jobs.maintain.new_rows import read_new_rows
from aridcal.jobs.maintain.repair import changes
from aridcal.jobs.plan.pose_design import joint_table
from aridcal.jobs.plan.travel import short_order
from aridcal.system.errors import OutputError
from aridcal.system.reading.user_names import path_argument
from aridcal.system.wording import enumeration
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import WRITTEN_ENDINGS, write_table
from aridcal.system.writing.whole_files import atomic_file, claimed


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("check", __doc__)
    arguments.add_argument("results", type=path_argument, help="result folder, or its calibration.yaml")
    arguments.add_argument(
        "rows", type=path_argument, help="new measurements, .csv or .parquet, or their campaign, .yaml"
    )
    arguments.add_argument(
        "--tolerance",
        type=length_argument,
        metavar="LENGTH",
        help="RMS position error that is still good, 0.2mm for instance",
    )
    arguments.add_argument(
        "--poses",
        type=path_argument,
        metavar="TABLE",
        help="where to write what to measure, where the rows cannot tell",
    )
    for_scripts(arguments, headline=True)
    return arguments


def _main(arguments: argparse.Namespace) -> int:
    if arguments.poses is None:
        return _check(arguments)
    if arguments.poses.suffix.lower() not in WRITTEN_ENDINGS:
        raise OutputError(f"{arguments.poses}: should be a .csv or .parquet file")
    check_apart([arguments.poses], [arguments.results, arguments.rows])
    with claimed(arguments.poses, "file"):
        return _check(arguments)


def _check(arguments: argparse.Namespace) -> int:
    saved = SavedModel.load(arguments.results)
    new = read_new_rows(saved, arguments.rows)
    checked = check(saved, new.rows, arguments.tolerance, new.frames)
    console, _ = screens(arguments)
    moved = changes(checked)
    lines = check_lines(checked, moved, saved.measurements)
    console.say(*lines)
    if arguments.poses is not None:
        console.say(_poses(arguments.poses, saved, checked))
    console.say(*(f"note: {remark}" for remark in (*new.rows.origin.refused, *new.rows.origin.notices)))
    headline = {
        "good": checked.good,
        "p_value": checked.first.p_value,
        "moved": [{"where": c.cause.where, "probability": c.cause.probability} for c in moved],
        "said": list(lines),
    }
    print_headline(arguments, headline)
    return DONE if checked.good else NOT_GOOD


def _poses(out: Path, saved: SavedModel, checked: CheckResult) -> str:
    """Write configurations that would tell what the rows cannot; returns what was written, in words."""
    configurations = [one for cause in checked.causes for one in cause.telling]
    if not configurations:
        return f"{out}: not written: there is nothing more to tell that another configuration would"
    readings = np.unique([one.readings for one in configurations], axis=0)
    readings = readings[short_order(readings)]
    with atomic_file(out) as path:
        write_table(joint_table(readings, saved.final.model.robot, saved.measurements), path)
    of = enumeration(list(dict.fromkeys(one.suspect for one in configurations)))
    return (
        f"{out}: {len(readings)} {'configuration' if len(readings) == 1 else 'configurations'} that would tell of {of}"
    )


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
