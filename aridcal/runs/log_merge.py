"""Two logs of one motion, with a clock each, read and joined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.engine.robot.described_robots import robot_description
from aridcal.engine.robot.tree import read_tree
from aridcal.files.tables import AnyTable
from aridcal.jobs.merge import bags, log_files
from aridcal.jobs.merge.bag_camera import BagCamera, Take
from aridcal.jobs.merge.log_files import JointLog, TrackerLog
from aridcal.jobs.merge.log_rows import MergeResult, merged
from aridcal.jobs.prepare.guesses import Choose, Chooser, leave_open
from aridcal.pages.merge_page import lines
from aridcal.system.errors import AridcalError, RobotError
from aridcal.system.progress import SHOWN_REMARKS, Screen

MERGE_QUESTIONS = (
    "joints.time", "tracker.time", "joints.decimal", "tracker.decimal", "target",
    "table.sheet", "table.dates", "columns", "units", "orientation",
)  # fmt: skip
"""Keys of what may be asked; answers may be given beforehand."""


@dataclass(frozen=True)
class Logs:
    """Two logs, or a log of joints and the images of the same bag.

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
    asker: Chooser

    def frames(self, numbers: frozenset[int], take: Take) -> None:
        """Go through the camera's images; see :func:`aridcal.jobs.merge.bags.frames`."""
        assert isinstance(self.measured, BagCamera)
        bags.frames(self.bag, self.measured.topic, numbers, take)


def join_logs(
    joints: AnyTable, tracker: AnyTable | None, urdf: Path, tip: str, choose: Choose, settled: Mapping[str, int]
) -> MergeResult:
    """Join two logs, or both logs of one bag; see :func:`read_logs`.

    Raises:
        AridcalError: the logs cannot be read or joined, or images are what was measured.
    """
    logs = read_logs(joints, tracker, urdf, tip, choose, settled)
    if isinstance(logs.measured, BagCamera):
        raise AridcalError(
            f"{logs.measured.title}: holds images: the command `aridcal merge` writes them beside its table"
        )
    return merged(logs.robot, logs.joints, logs.measured, logs.asker)


def read_logs(
    joints: AnyTable, tracker: AnyTable | None, urdf: Path, tip: str, choose: Choose, settled: Mapping[str, int]
) -> Logs:
    """Read two logs, or both logs of one bag.

    Args:
        joints: A table or a bag with the joints' readings over time.
        tracker: A table or a bag with the target's pose or position over time; None: the bag has it.
        urdf: The nominal robot.
        tip: The link that carries the target.
        choose: Asked where the logs leave a choice that changes numbers.
        settled: Numbers of answers that were given beforehand.

    Raises:
        AridcalError: the logs cannot be read.
    """
    asker = Chooser(choose, settled, drafts=False)
    asker.check(MERGE_QUESTIONS)
    source = robot_description(urdf, {}, {})
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
        second: TrackerLog | BagCamera = bags.tracker_log(Path(str(tracker)), links, asker)
        if isinstance(second, BagCamera) and not (is_bag and Path(str(tracker)) == Path(str(joints))):
            raise AridcalError(
                f"{second.title}: holds images, for which joints of the same bag are needed: nothing else tells its clock from "
                f"that of {joints}. Record both together, or name each joint row's image and use `aridcal detect --joints`"
            )
    else:
        second = log_files.tracker_log(tracker, robot, asker)
    return Logs(robot, log, second, Path(str(tracker)), asker)


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
    result = join_logs(joints, tracker, Path(urdf), tip, leave_open, answers or {})
    print_merge(result, Screen(force_jupyter=False))
    return result.table


def print_merge(result: MergeResult, console: Screen) -> None:
    """Print how the logs were joined, and the standstills that make no row."""
    sentences = [*lines(result), *(f"no row: {standstill}" for standstill in result.unpaired[:SHOWN_REMARKS])]
    if len(result.unpaired) > SHOWN_REMARKS:
        sentences.append(f"no row: {len(result.unpaired) - SHOWN_REMARKS} more standstills")
    console.say(*sentences)
