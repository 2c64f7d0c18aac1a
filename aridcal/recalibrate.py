"""Mend a calibration with 5 to 20 new rows after something changed: a motor, the tool, the place of the base.

What moved is found as `aridcal check` does, with rows of any instrument. Only that is fitted, and frames that the campaign of
the rows calls new (`frames: {tip_target: {identify: true}}`); everything else, effects included, is kept as well as it was
known. The folder has all files of a calibration, result.json with what moved, its errors before, after and with each row left
out, and the lineage: the file of the calibration before, its hash, and the rows that were used.

Nothing is written where nothing moved, where the rows alone are odd, cannot tell which part moved, or where a few moved parts
do not explain them: then exit status 2, and what to do.

Example:
    aridcal recalibrate results new.csv -o repaired
    aridcal recalibrate results new_tool.yaml -o repaired
"""

from __future__ import annotations

import argparse
import sys

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.runs.repair_folder import recalibrate
from aridcal.system.progress import console_progress
from aridcal.system.reading.user_names import path_argument


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("recalibrate", __doc__)
    arguments.add_argument("results", type=path_argument, help="result folder, or its calibration.yaml")
    arguments.add_argument(
        "rows", type=path_argument, help="measurements after the change, .csv or .parquet, or a campaign, .yaml"
    )
    arguments.add_argument("-o", "--out", type=path_argument, required=True, help="folder for the repaired calibration")
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    console, aside = screens(arguments)
    with console_progress(aside) as progress:
        sentences = recalibrate(arguments.results, arguments.rows, arguments.out, progress)
    console.say(*sentences)
    console.say(f"repaired: {arguments.out / 'report.html'}")


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
