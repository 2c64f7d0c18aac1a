"""Join a log of joints and a log of a tracker into one table of measurements: a row for each standstill that both have.

The clocks need not agree, nor the rates. Standstills are found in both logs. Offset and drift of the clocks come from the moves
between them: the nominal robot says when its target moved. Samples in which both stand are averaged, with margins dropped at both
ends; `std_*` is the standard deviation of the mean, which allows for samples that are not independent, and `n` how many they are.
Standstills that one log has and the other has not are named.

A bag with images of a camera, its CameraInfo and the joints gives what `aridcal detect` and `aridcal measure` take: a row for
each standstill with its joints and its image, the images as PNG in a folder beside the table, and there the camera's numbers.

A log is a table in any dialect (a column for each joint, or x y z and an orientation, and the time), or a bag of ROS 1 or 2
(`.bag`, `.mcap`, `.db3`, a folder; `pip install "aridcal[ros]"`), which may hold both. Beside the table of two logs a page of the
same name (.html) shows what was paired.

Example:
    aridcal merge joints.csv tracker.csv --urdf robot.urdf --tip tool0 -o measurements.csv
    aridcal merge run.bag --urdf robot.urdf --tip tool0 -o measurements.csv
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np

from aridcal.command_line import CommandParser, answer, ask, command, command_parser, for_scripts, screens
from aridcal.jobs.boards.camera_file import CAMERA_FILE
from aridcal.jobs.boards.camera_frames import png_file
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.merge.bag_camera import BagCamera, camera_file, intrinsics
from aridcal.jobs.merge.camera_images import choose_images
from aridcal.jobs.merge.log_rows import merged
from aridcal.jobs.prepare.guesses import leave_open
from aridcal.pages.merge_page import merge_page
from aridcal.runs.log_merge import Logs, print_merge, read_logs
from aridcal.system.progress import SHOWN_REMARKS
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import table_file
from aridcal.system.writing.whole_files import atomic_folder, atomic_table, claimed, claimed_table

OURS = re.compile(r"stop_\d+\.png")
"""Images of an earlier run, which go with it."""


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("merge", __doc__)
    arguments.add_argument("joints", type=path_argument, help="log of the joints: a table, or a bag of ROS 1 or 2")
    arguments.add_argument(
        "tracker", type=path_argument, nargs="?", help="log of the tracker; not needed for a bag that has both"
    )
    arguments.add_argument("--urdf", type=path_argument, required=True, help="the nominal robot")
    arguments.add_argument("--tip", required=True, help="the link that carries the target, tool0 for instance")
    arguments.add_argument(
        "--set",
        type=answer,
        action="append",
        default=[],
        metavar="KEY=NUMBER",
        help="answer a question that was asked before, by its number",
    )
    arguments.add_argument(
        "-o",
        "--out",
        type=path_argument,
        default=Path("measurements.csv"),
        help="where to write the table, .csv (default: measurements.csv, here); a page of the same name (.html) is "
        "written beside it",
    )
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    out, page = arguments.out, arguments.out.with_suffix(".html").name
    check_apart([out, out.with_name(page)], [arguments.joints, arguments.tracker, arguments.urdf])
    with claimed_table(out, [page]):
        choose = ask if sys.stdin.isatty() and not arguments.quiet else leave_open
        logs = read_logs(
            arguments.joints, arguments.tracker, arguments.urdf, arguments.tip, choose, dict(arguments.set)
        )
        if isinstance(logs.measured, BagCamera):
            _write_images(logs, logs.measured, arguments)
            return
        found = merged(logs.robot, logs.joints, logs.measured, logs.asker)
        names = (arguments.joints.name, (arguments.tracker or arguments.joints).name)
        with atomic_table(out, [page]) as stage:
            with table_file(stage / out.name) as write:
                write(found.table)
            (stage / page).write_text(merge_page(found, names, out), encoding="utf-8", errors="replace")
    console, _ = screens(arguments)
    print_merge(found, console)
    console.say(
        f"{out}: {len(found.table)} rows; {out.with_suffix('.html')} shows what was paired",
        f"next: aridcal init --urdf {arguments.urdf} --measurements {out}",
    )


def _write_images(logs: Logs, camera: BagCamera, arguments: argparse.Namespace) -> None:
    """Write the table of joints with the image of each standstill, the images and, where it is known, their camera."""
    out: Path = arguments.out
    found = choose_images(logs.robot, logs.joints, camera, logs.frames)
    folder = out.with_name(f"{out.stem}_images")
    names = {int(number): f"stop_{k + 1:03d}.png" for k, number in enumerate(found.frames)}
    numbers, remark = intrinsics(camera, found.size)
    old = [entry.name for entry in folder.iterdir() if OURS.fullmatch(entry.name)] if folder.is_dir() else []
    with claimed(folder, "folder"), atomic_folder(folder, [*old, CAMERA_FILE]) as stage:

        def take(number: int, image: np.ndarray | NotMeasured) -> None:
            assert isinstance(image, np.ndarray)  # it was read before
            (stage / names[number]).write_bytes(png_file(image))

        logs.frames(frozenset(names), take)
        if numbers is not None:
            (stage / CAMERA_FILE).write_text(camera_file(numbers, camera.title), encoding="utf-8")
    table = found.table.assign(image=[f"{folder.name}/{names[int(number)]}" for number in found.frames])
    page = out.with_suffix(".html").name  # an earlier table's goes
    with atomic_table(out, [page]) as stage, table_file(stage / out.name) as write:
        write(table)
    console, _ = screens(arguments)
    said = [*found.notices, remark, *(f"no row: {one}" for one in found.unpaired[:SHOWN_REMARKS])]
    said += (
        [f"no row: {len(found.unpaired) - SHOWN_REMARKS} more standstills"]
        if len(found.unpaired) > SHOWN_REMARKS
        else []
    )
    said.append(f"{out}: {len(table)} rows, each with its image in {folder}")
    lens = f" --intrinsics {folder / CAMERA_FILE}" if numbers is not None else ""
    said.append(f"next: aridcal detect {folder} --joints {out}{lens} -o {out.with_name('corners.csv')}")
    console.say(*said)


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
