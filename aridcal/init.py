"""Write a campaign for a URDF and a table of measurements: which column is which, in which unit, in which frame.

Text with any separator, decimal sign, encoding and header, workbooks (.xlsx) and exports of measuring systems are read; how,
is written into the campaign, so that nothing is guessed afterwards. Every guess is printed and stands as a comment in the file.
Where the data leave a choice that changes the numbers, the command asks; if it is not run on a terminal, it stops, names the
choices, and `--set KEY=NUMBER` answers.

Example:
    aridcal init --urdf my_robot.urdf --measurements measurements.csv
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from aridcal.command_line import CommandParser, answer, ask, command, command_parser, for_scripts, screens
from aridcal.files.tables import TABLE_ENDINGS as TABLES
from aridcal.jobs.prepare.campaign_text import draft
from aridcal.jobs.prepare.guesses import leave_open
from aridcal.runs.proposal import print_proposal
from aridcal.system.errors import MeasurementError, OutputError, printable, shortened
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.whole_files import atomic_file, claimed


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("init", __doc__)
    arguments.add_argument(
        "--urdf",
        type=path_argument,
        required=True,
        help="the nominal robot: a URDF, a xacro file, or a robot's name in the cache of robot_descriptions (ur5e)",
    )
    arguments.add_argument(
        "--measurements",
        type=path_argument,
        required=True,
        nargs="+",
        metavar="TABLE",
        help="measured poses: .csv or other text in any dialect, .xlsx, .parquet, robot_calibration's .yaml",
    )
    arguments.add_argument(
        "--set",
        type=answer,
        action="append",
        default=[],
        metavar="KEY=NUMBER",
        help="answer a question that was asked before, by its number",
    )
    arguments.add_argument(
        "--package",
        type=_package,
        action="append",
        default=[],
        metavar="NAME=FOLDER",
        help="where a package of ROS is that the URDF names; may be repeated",
    )
    arguments.add_argument(
        "--argument",
        type=pair,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an argument of the xacro file; may be repeated",
    )
    arguments.add_argument(
        "-o",
        "--out",
        type=path_argument,
        default=Path("campaign.yaml"),
        help="where to write (default: campaign.yaml, here)",
    )
    for_scripts(arguments)
    return arguments


def pair(text: str) -> tuple[str, str]:
    """The ``type`` of an argument of argparse that gives something a name."""
    name, equals, value = text.partition("=")
    name = name.removesuffix(":")  # xacro itself writes NAME:=VALUE
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{printable(shortened(text))!r} should be NAME=VALUE")
    return name, value


def _package(text: str) -> tuple[str, Path]:
    name, place = pair(text)
    return name, path_argument(place)


def _main(arguments: argparse.Namespace) -> None:
    out, choose = arguments.out, ask if sys.stdin.isatty() and not arguments.quiet else leave_open
    if out.exists():
        raise OutputError(f"{out}: exists already; delete it, or choose another name with -o")
    check_apart(
        [out], [arguments.urdf, *arguments.measurements]
    )  # a link that leads to what is not there, for instance
    for path in arguments.measurements:
        _refuse_images(path)
    with claimed(out, "file"):
        settled, xacro = dict(arguments.set), dict(arguments.argument)
        proposed = draft(arguments.urdf, arguments.measurements, out, choose, settled, dict(arguments.package), xacro)
        with atomic_file(out) as path:
            path.write_text(proposed.campaign.text, encoding="utf-8")
    console, _ = screens(arguments)
    print_proposal(proposed, str(out), console)
    console.say(f"next: aridcal identify {out}")


def _refuse_images(path: Path) -> None:
    """Refuse images and folders of them, which people name for a hand-eye calibration, with the command to begin with."""
    if not path.is_dir() and path.suffix.lower() in TABLES:
        return
    from aridcal.jobs.boards.grey_images import IMAGE_ENDINGS  # loads OpenCV, which tables do without

    files = path.iterdir() if path.is_dir() else [path]
    if any(file.suffix.lower() in IMAGE_ENDINGS for file in files):
        raise MeasurementError(
            f"{path}: images are no table yet: `aridcal detect {path} --joints joints.csv -o corners.csv` makes one, "
            "which is named here then (docs/hand-eye.md)"
        )


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
