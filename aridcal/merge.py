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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from aridcal.boards.camera_file import CAMERA_FILE
from aridcal.boards.frames import png_file
from aridcal.command_line import CommandParser, command_parser, for_scripts, run, screens
from aridcal.errors import AridcalError, RobotError
from aridcal.head.matching import NotMeasured
from aridcal.init import answer, ask
from aridcal.inputs.tables import AnyTable
from aridcal.logs import bags, log_files
from aridcal.logs.bag_camera import BagCamera, Take, camera_file, intrinsics
from aridcal.logs.log_files import JointLog, TrackerLog
from aridcal.logs.merging import Merged, merged
from aridcal.logs.page import lines, merge_page
from aridcal.logs.pictures import pictured
from aridcal.prepare.guesses import Asker, Choose, nobody
from aridcal.reading.names import path_argument
from aridcal.robot.chain import Robot, load_robot
from aridcal.robot.named import described
from aridcal.robot.tree import read_tree
from aridcal.writing.apart import check_apart
from aridcal.writing.files import atomic_folder, atomic_table, claimed, claimed_table
from aridcal.writing.tables import table_file

QUESTIONS = (
    "joints.time", "tracker.time", "joints.decimal", "tracker.decimal", "target",
    "table.sheet", "table.dates", "columns", "units", "orientation",
)  # fmt: skip
"""Keys of what may be asked; answers may be given beforehand."""

OURS = re.compile(r"stop_\d+\.png")
"""Images of an earlier run, which go with it."""

SHOWN = 5
"""Standstills without a row that are printed; the page has them all."""


@dataclass(frozen=True)
class Read:
    """Two logs that were read, or a log of joints and the images of the same bag.

    Attributes:
        robot: The nominal robot.
        joints: Its log.
        measured: The tracker's, or the camera's.
        bag: Where the images are.
        asker: Asked where the logs leave a choice that changes numbers.
    """

    robot: Robot
    joints: JointLog
    measured: TrackerLog | BagCamera
    bag: Path
    asker: Asker

    def frames(self, numbers: frozenset[int], take: Take) -> None:
        """Go through the camera's images; see :func:`aridcal.logs.bags.frames`."""
        assert isinstance(self.measured, BagCamera)
        bags.frames(self.bag, self.measured.topic, numbers, take)


def joined(
    joints: AnyTable, tracker: AnyTable | None, urdf: Path, tip: str, choose: Choose, settled: Mapping[str, int]
) -> Merged:
    """Join two logs, or what one bag holds of both; see :func:`read`.

    Raises:
        AridcalError: the logs cannot be read or joined, or images are what was measured.
    """
    logs = read(joints, tracker, urdf, tip, choose, settled)
    if isinstance(logs.measured, BagCamera):
        raise AridcalError(
            f"{logs.measured.title}: holds images: the command `aridcal merge` writes them beside its table"
        )
    return merged(logs.robot, logs.joints, logs.measured, logs.asker)


def read(
    joints: AnyTable, tracker: AnyTable | None, urdf: Path, tip: str, choose: Choose, settled: Mapping[str, int]
) -> Read:
    """Read two logs, or what one bag holds of both.

    Args:
        joints: A table or a bag with the joints' readings over time.
        tracker: The same of the target's pose or position; None: the bag has it.
        urdf: The nominal robot.
        tip: The link that carries the target.
        choose: Asked where the logs leave a choice that changes numbers.
        settled: Numbers of answers that were given beforehand.

    Raises:
        AridcalError: the logs cannot be read.
    """
    asker = Asker(choose, settled, drafts=False)
    asker.check(QUESTIONS)
    source = described(urdf, {}, {})
    try:
        robot = load_robot(source.path, tip, None, packages=source.packages, arguments=source.arguments)
    except RobotError as problem:  # which speaks of a campaign's keys
        raise RobotError(str(problem).replace("`robot.tip`", "--tip").replace("`robot.urdf`", "--urdf")) from None
    if tracker is None:
        if not bags.is_bag(joints):
            raise AridcalError(f"{joints}: is one table; name the tracker's log after it, or a bag that has both")
        tracker = joints
    is_bag = bags.is_bag(joints)
    log = bags.joint_log(Path(str(joints)), robot) if is_bag else log_files.joint_log(joints, robot, asker)
    if bags.is_bag(tracker):
        links = frozenset(read_tree(robot.urdf, robot.path).links)
        measured: TrackerLog | BagCamera = bags.tracker_log(Path(str(tracker)), links, asker)
        if isinstance(measured, BagCamera) and not (is_bag and Path(str(tracker)) == Path(str(joints))):
            raise AridcalError(
                f"{measured.title}: holds images, for which joints of the same bag are needed: nothing else tells its clock from "
                f"that of {joints}. Record both together, or name each joint row's image and use `aridcal detect --joints`"
            )
    else:
        measured = log_files.tracker_log(tracker, robot, asker)
    return Read(robot, log, measured, Path(str(tracker)), asker)


def merge(
    joints: AnyTable,
    tracker: AnyTable | None,
    urdf: str | Path,
    tip: str,
    answers: Mapping[str, int] | None = None,
) -> pd.DataFrame:
    """Join a log of joints and a log of a tracker, for Python; prints what was found. Nothing is written.

    Args:
        joints: Readings of the joints over time: a DataFrame, a table's file or a bag of ROS.
        tracker: The target's pose or position over time, by any other clock; None: the bag has it, too.
        urdf: The nominal robot.
        tip: The link that carries the target.
        answers: Numbers of answers to questions that were asked before: ``{"tracker.time": 2}``.

    Returns:
        A row for each standstill that both have, SI: joints, ``x y z`` and, where measured, ``qx qy qz qw``, ``std_*`` of these
        means, ``time`` by the joints' clock, and ``n``, the tracker's samples behind it.

    Raises:
        AridcalError: the logs cannot be read or joined; saying why.
    """
    found = joined(joints, tracker, Path(urdf), tip, nobody, answers or {})
    tell(found, Console(force_jupyter=False))
    return found.table


def tell(found: Merged, console: Console) -> None:
    """Print what was found, and which standstills make no row."""
    said = [*lines(found), *(f"no row: {one}" for one in found.unpaired[:SHOWN])]
    if len(found.unpaired) > SHOWN:
        said.append(f"no row: {len(found.unpaired) - SHOWN} more standstills")
    for each in said:
        console.print(each, markup=False, highlight=False, soft_wrap=True)


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


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> None:
    out, page = arguments.out, arguments.out.with_suffix(".html").name
    check_apart([out, out.with_name(page)], [arguments.joints, arguments.tracker, arguments.urdf])
    with claimed_table(out, [page]):
        choose = ask if sys.stdin.isatty() and not arguments.quiet else nobody
        logs = read(arguments.joints, arguments.tracker, arguments.urdf, arguments.tip, choose, dict(arguments.set))
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
    tell(found, console)
    said = f"{out}: {len(found.table)} rows; {out.with_suffix('.html')} shows what was paired"
    console.print(said, markup=False, highlight=False, soft_wrap=True)
    said = f"next: aridcal init --urdf {arguments.urdf} --measurements {out}"
    console.print(said, markup=False, highlight=False, soft_wrap=True)


def _write_images(logs: Read, camera: BagCamera, arguments: argparse.Namespace) -> None:
    """Write the table of joints with the image of each standstill, the images and, where it is known, their camera."""
    out: Path = arguments.out
    found = pictured(logs.robot, logs.joints, camera, logs.frames)
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
    said = [*found.notices, remark, *(f"no row: {one}" for one in found.unpaired[:SHOWN])]
    said += [f"no row: {len(found.unpaired) - SHOWN} more standstills"] if len(found.unpaired) > SHOWN else []
    said.append(f"{out}: {len(table)} rows, each with its image in {folder}")
    lens = f" --intrinsics {folder / CAMERA_FILE}" if numbers is not None else ""
    said.append(f"next: aridcal detect {folder} --joints {out}{lens} -o {out.with_name('corners.csv')}")
    for line in said:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
