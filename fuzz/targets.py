"""The readers under attack, one row each: a file of any bytes goes in, and only an `AridcalError` may come out."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal
from unittest.mock import patch

import numpy as np
import pinocchio as pin

from aridcal.engine.robot import expand
from aridcal.engine.robot.chain import Robot, chain, load_robot, parse_robot
from aridcal.engine.robot.doty import doty_links
from aridcal.engine.robot.splice import splice_origins
from aridcal.engine.robot.splice_mjcf import check_written_back, splice_mjcf
from aridcal.engine.robot.tree import read_tree
from aridcal.files.campaign import ArmSettings, Campaign, load_campaign
from aridcal.files.formats.sniffing import look
from aridcal.files.query import load_query
from aridcal.files.read import load_measurements
from aridcal.files.tables import read_tables
from aridcal.files.things import load_places
from aridcal.files.yaml_file import load_settings, parse_settings
from aridcal.jobs.boards.camera_file import CameraFile
from aridcal.jobs.boards.grey_images import grey_image
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.head1992.head_settings import HeadSettings, load_shots, load_squares
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.head1992.shots import board, read_image, read_ranges, shots_of
from aridcal.jobs.merge.bags import joint_log
from aridcal.jobs.simulate.scenario import Scenario, check_scenario
from aridcal.system.errors import AridcalError, MeasurementError, RobotError
from aridcal.system.reading.regular_files import TABLE_LIMIT, URDF, read_file

CORPUS = Path(__file__).parent / "corpus"
"""A folder of small files for each reader."""


@dataclass(frozen=True)
class Target:
    """A reader.

    Attributes:
        read: Takes the path of a file, and does with it all that a command would before the mathematics begins.
        suffix: Of that file.
        longest: Bytes that a mutant may have: what is wrong with a long file is wrong with a short one, and sooner found.
        kind: Text is mutated by lines and words too, binary files by bytes alone. What is read by a process of its own is text
            that takes long: no test reads hundreds of mutants.
    """

    read: Callable[[Path], object]
    suffix: str
    longest: int = 3000
    kind: Literal["text", "binary", "process"] = "text"


def _urdf(path: Path) -> None:
    tree = read_tree(read_file(path, RobotError, URDF), path)
    robot = chain(tree, ("tip", *tree.links)[-1])
    _ = robot.limits, robot.kinds
    doty_links(robot)
    if np.isfinite(robot.mass_beyond).all():
        splice_origins(robot.urdf, {name: (np.ones(3), np.zeros(3)) for name in robot.names})


def _mjcf(path: Path) -> None:
    content = read_file(path, RobotError, URDF)
    robot = parse_robot(content, "tip", "base", path)
    check_written_back(robot)
    if robot.mjcf is not None:
        splice_mjcf(robot, {name: pin.SE3(pin.exp3(np.ones(3)), np.ones(3)) for name in robot.names})


def _xacro(path: Path) -> None:
    """A xacro file, expanded, and read as what it expands to; cut off sooner than for users, that none counts as slow."""
    with patch.object(expand, "SECONDS", 3):
        read_tree(expand.read_urdf(path), path)


def _scenario(path: Path) -> None:
    check_scenario(load_settings(path, Scenario))


def _head(path: Path) -> None:
    head = load_settings(path, HeadSettings)
    _ = head.tip_camera.homogeneous, head.world_base.homogeneous, head.camera.intrinsics
    if head.target == "charuco":
        board(head).opencv()
    if head.sonars is not None:
        with suppress(NotMeasured):
            read_ranges(np.full(len(head.sonars.positions), 0.3), head)


def _calibration(path: Path) -> None:
    saved = SavedModel.load(path)
    _ = saved.measurements
    q = np.zeros((1, len(saved.final.model.robot.readings)))
    for solved in (saved.geometric, saved.final):
        conditions = {name: np.ones(1) for name in solved.model.needs}
        label = next((label for label, _ in solved.model.world_base + solved.model.tip_target if label), None)
        solved.std(q, conditions, None if label is None else np.array([label]))


def _shots(path: Path) -> None:
    head = _head_of(path.parent)
    for shot in shots_of(load_shots(path, head), head, path):
        with suppress(NotMeasured):
            read_ranges(shot.ranges, head)


def _image(path: Path) -> None:
    try:
        read_image(path.name, _head_of(path.parent))
    except NotMeasured as refusal:  # which a measurement notes of its row
        raise AridcalError(str(refusal)) from None


@cache
def _head_of(folder: Path) -> HeadSettings:
    """A head whose shots and images are in a folder."""
    head = load_settings(CORPUS / "head" / "square.yaml", HeadSettings)
    arm = ArmSettings(urdf=CORPUS / "urdf" / "small.urdf", tip="tip")
    return head.model_copy(update={"shots": folder / "shots.csv", "robot": arm})


@cache
def _arm() -> Robot:
    return load_robot(CORPUS / "urdf" / "small.urdf", "tip")


@cache
def _campaign(measurements: str, frames: str = "") -> Campaign:
    text = f"format: 1\nrobot: {{urdf: r.urdf, tip: tip}}\nmeasurements: {{file: m.csv, {measurements}}}\n{frames}"
    return parse_settings(text, Path("campaign.yaml"), Campaign)


def _table(path: Path) -> None:
    """Rows as measurements, in the campaign's dialect that the columns hint at; without positions as a query."""
    content, robot = path.read_bytes(), _arm()
    about = robot.readings, robot.limits, robot.kinds
    if not re.search(rb"\bx\b", content):
        load_query(path, *about)
    elif re.search(rb"\bseed\b", content):
        load_query(path, *about, poses=True)
    elif re.search(rb"\brx\b", content):
        load_measurements(_campaign("orientation: {euler: XYZ, columns: [rx, ry, rz]}"), *about, files=[path])
    elif re.search(rb"\bstation\b", content):
        campaign = _campaign("kind: position, units: {length: mm, angle: deg}", "frames: {world_base: {per: station}}")
        load_measurements(campaign, *about, files=[path])
    else:
        load_measurements(_campaign("kind: pose, ignore: [note]"), *about, files=[path])


EYE = "{fx: 600, fy: 600, cx: 320, cy: 240, width: 640, height: 480}"

# A column that tells the kind of a table, and what such a campaign has besides.
KINDS = {
    rb"\bgx\b": ("inclination", ""),
    rb"\bmarker\b": ("pixels", f"instruments: {{cameras: {{eye: {EYE}}}}}"),
    rb"\bdistance\b": (
        "distance, units: {length: mm}",
        "instruments: {anchors: {wall: {identify: [scale], xyz: [0, 0, 1]}}}",
    ),
    rb"\bpoint\b": ("point", f"instruments: {{points: {CORPUS / 'places' / 'points.csv'}}}"),
    rb"": ("plane", "instruments: {perpendicular: [[a, b]]}"),
}


def _readings(path: Path) -> None:
    """Rows of a table of another kind than poses, which its columns tell."""
    content, robot = path.read_bytes(), _arm()
    kind, rest = next(of for column, of in KINDS.items() if re.search(column, content))
    load_measurements(_campaign(f"kind: {kind}", rest), robot.readings, robot.limits, robot.kinds, files=[path])


def _dialect(path: Path) -> None:
    """A table that is looked at as `init` does, and read by what was found."""
    content = read_file(path, MeasurementError, TABLE_LIMIT)
    for dialect in look(content, path, TABLE_LIMIT, lambda *asked: len(asked[2]) - 1).dialects:
        with suppress(MeasurementError):
            read = read_tables([path], None, dialect=dialect)
            _ = [read.numbers(name) for name in read.names], read.frame()


TARGETS = {
    "urdf": Target(_urdf, ".urdf"),
    "mjcf": Target(_mjcf, ".xml"),
    "xacro": Target(_xacro, ".xacro", 2000, "process"),
    "campaign": Target(load_campaign, ".yaml"),
    "scenario": Target(_scenario, ".yaml"),
    "head": Target(_head, ".yaml"),
    "calibration": Target(_calibration, ".yaml", 6000),
    "table": Target(_table, ".csv"),
    "dialect": Target(_dialect, ".csv"),
    "workbook": Target(_dialect, ".xlsx", 12_000, "binary"),
    "samples": Target(_dialect, ".yaml"),
    "readings": Target(_readings, ".csv"),
    "places": Target(lambda path: load_places(path, "point"), ".csv"),
    "squares": Target(load_squares, ".csv"),
    "shots": Target(_shots, ".csv"),
    "parquet": Target(_table, ".parquet", kind="binary"),
    "camera": Target(lambda path: load_settings(path, CameraFile), ".yaml"),
    "picture": Target(grey_image, ".png", 5000, "binary"),
    "bag": Target(lambda path: joint_log(path, _arm()), ".bag", 17_000, "binary"),
    "mcap": Target(lambda path: joint_log(path, _arm()), ".mcap", 16_000, "binary"),
    "image": Target(_image, ".png", 5000, "binary"),
}
