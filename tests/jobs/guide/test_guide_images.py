"""Being led while a camera on the tool sees a board: an image is one measurement; what is said holds against the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

import aridcal
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.model.model import Model
from aridcal.engine.model.predictions import rows_of_data
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.guide import main
from aridcal.jobs.guide.events import Alarm, Event, Known, Next, RowRead
from aridcal.jobs.guide.next_pose import KEPT_IMAGES, MORE_IMAGES, more_of
from aridcal.jobs.guide.session import Session, session
from aridcal.jobs.plan.configurations import draw_candidates
from aridcal.jobs.plan.information import stack_by_candidate, whitened
from aridcal.runs.guided_campaign import Incoming, followed
from aridcal.system.errors import MeasurementError

ARM = """<robot name="arm"><link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="tool"/>
<joint name="one" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
<limit lower="-1.2" upper="1.2" effort="1" velocity="1"/></joint>
<joint name="two" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.3 0 0" rpy="1.5708 0 0"/><axis xyz="0 0 1"/>
<limit lower="-0.6" upper="0.6" effort="1" velocity="1"/></joint>
<joint name="three" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.25 0 0"/><axis xyz="0 0 1"/>
<limit lower="-0.6" upper="0.6" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="c"/><child link="tool"/><origin rpy="1.5708 0 0"/></joint></robot>"""

CAMERA = "width: 1280, height: 960, fx: 700, fy: 700, cx: 640, cy: 480"
CAMPAIGN = """format: 1
robot: {{urdf: arm.urdf, tip: tool}}
measurements: {{file: rows.csv, kind: pixels, noise: {{pixel: 0.2}}}}
instruments:
  cameras: {{eye: {{{camera}, "on": tip, xyz: [0.05, 0.0, 0.04], rpy: [0.0, 0.0, 0.5]}}}}
  markers: {{file: markers.csv, xyz: [0.45, 0.0, 0.0], rpy: [0.0, 0.0, 0.2]}}
"""
CORNERS = np.array([(0.05 * (x - 2), 0.05 * (1.5 - y), 0.0) for y in range(4) for x in range(5)])
LENS = np.array([[700.0, 0.0, 640.0], [0.0, 700.0, 480.0], [0.0, 0.0, 1.0]])
TRUTH = {"two.x": 8e-4, "two.pitch": -1e-3, "three.x": -7e-4, "three.yaw": 1.2e-3, "three.roll": 6e-4}


@dataclass
class Cell:
    """The machine as it is, seen by OpenCV.

    Attributes:
        now: What is said.
        model: The arm with its errors.
        theta: These.
        camera: T_tip_camera.
        board: T_base_board.
        noise: Of the pixels.
    """

    now: Session
    model: Model
    theta: np.ndarray
    camera: pin.SE3
    board: pin.SE3
    noise: np.random.Generator

    def image(self, readings: np.ndarray) -> list[dict[str, float | str]]:
        """Corners that are seen."""
        R, p = self.model.poses(self.theta, self.model.rows(readings[None]))
        seen = (pin.SE3(R[0], p[0]) * self.camera).inverse() * self.board
        pixels = cv2.projectPoints(CORNERS, cv2.Rodrigues(seen.rotation)[0], seen.translation, LENS, None)[0][:, 0]
        pixels = pixels + 0.2 * self.noise.standard_normal(pixels.shape)
        return [
            {"camera": "eye", "marker": f"c{k}", "u": u, "v": v}
            for k, (u, v) in enumerate(pixels.tolist())
            if 0 < u < 1280 and 0 < v < 960
        ]

    def lines(self, readings: np.ndarray, taken_at: np.ndarray) -> list[bytes]:
        """Header and rows of an image that was taken at other readings."""
        joints = dict(zip(self.now.robot.readings, readings.tolist(), strict=True))
        rows = [joints | row for row in self.image(taken_at)]
        return pd.DataFrame(rows).to_csv(index=False).encode().splitlines()

    def fed(self, readings: np.ndarray, taken_at: np.ndarray | None = None) -> list[Event]:
        """What is said to an image."""
        head, *lines = self.lines(readings, readings if taken_at is None else taken_at)
        if not self.now.table.head:
            self.now.table.add(head)
        return self.now.taken([k for line in lines for k in self.now.table.add(line)])

    def led(self, count: int) -> Iterator[list[Event]]:
        """What is said to each of some images at the poses that are proposed."""
        said = self.now.taken([])
        for _ in range(count):
            following = said[-1]
            if not isinstance(following, Next):
                return
            said = self.fed(np.array([*following.joints.values()]))
            yield said


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN.format(camera=CAMERA))
    markers = pd.DataFrame(CORNERS, columns=["x", "y", "z"])
    markers.insert(0, "marker", [f"c{k}" for k in range(len(CORNERS))])
    markers.to_csv(tmp_path / "markers.csv", index=False)
    campaign = load_campaign(tmp_path / "campaign.yaml")
    robot = nominal_robot(campaign)
    coefficients = tuple(
        Coefficient(where, component) for where, _, component in (name.partition(".") for name in TRUTH)
    )
    camera = pin.SE3(pin.rpy.rpyToMatrix(0.01, -0.008, 0.51), np.array([0.052, -0.003, 0.041]))
    board = pin.SE3(pin.rpy.rpyToMatrix(0.01, 0.0, 0.19), np.array([0.452, 0.003, -0.002]))
    now = session(campaign, robot, None)
    return Cell(now, Model(robot, coefficients), np.array([*TRUTH.values()]), camera, board, np.random.default_rng(0))


def error(cell: Cell) -> float:
    """95th percentile of what the tip is off by over the region, base and tip laid over the true ones, [m]."""
    posterior, places = cell.now.posterior, cell.now.region
    if posterior is None:
        return np.inf
    setup = posterior.setup
    pattern = setup.patterns.select(np.zeros(len(places), dtype=int))
    theta = setup.theta + posterior.step[posterior.things :]
    R, p = setup.model.poses(theta, rows_of_data(setup.model, pattern, places))
    off = cell.model.poses(cell.theta, cell.model.rows(places))[1] - p
    moves = np.array([np.hstack([np.eye(3), -pin.skew(at), turn]) for at, turn in zip(p, R, strict=True)]).reshape(
        -1, 9
    )
    left = off.ravel() - moves @ np.linalg.lstsq(moves, off.ravel(), rcond=None)[0]
    return float(np.quantile(np.linalg.norm(left.reshape(-1, 3), axis=1), 0.95))


def alarms(said: list[Event]) -> list[Alarm]:
    return [event for event in said if isinstance(event, Alarm)]


def test_what_is_said_to_be_known_from_images_holds_against_the_truth_and_an_image_is_one_event(cell: Cell) -> None:
    """Where base and tip are, no image tells: what is said is of the arm between them. It shrinks tenfold, the error fourfold."""
    claims: list[float] = []
    errors: list[float] = []
    for said in cell.led(25):
        assert alarms(said) == []
        (row,) = [event for event in said if isinstance(event, RowRead)]
        claims += [event.position for event in said if isinstance(event, Known)]
        if claims:
            errors.append(error(cell))
            assert errors[-1] < claims[-1]
        assert row.document()["count"] == row.count == len(cell.now.read.lines_of(len(cell.now.read.index) - 1))
    assert min(claims) < 0.1 * max(claims)
    assert errors[-1] < 0.25 * errors[0]


def test_poses_drawn_for_earlier_images_stay_to_be_chosen_from_and_tell_what_they_told(cell: Cell) -> None:
    """Each image adds some; up to a number, beyond which the earliest go. Joined, each has the rows that it had alone."""
    counts: list[int] = []
    for _ in cell.led(6):
        assert cell.now.candidates is not None
        counts.append(len(cell.now.candidates.readings))
    added = np.diff(counts[3:])  # once the model has begun
    assert np.all(added == MORE_IMAGES)
    known, few = cell.now.posterior, cell.now.candidates
    assert known is not None and few is not None
    more = draw_candidates(known.setup, 40, 1, np.random.default_rng(1))
    both = few.and_more(more)
    alone = [stack_by_candidate(whitened(known.setup, some), some) for some in (few, more)]
    together = stack_by_candidate(whitened(known.setup, both), both)
    expected = np.concatenate([np.einsum("cpd,cpe->cde", F, F) for F in alone])
    np.testing.assert_allclose(
        np.einsum("cpd,cpe->cde", together, together), expected, rtol=1e-7, atol=1e-7 * expected.max()
    )
    for _ in range(KEPT_IMAGES // MORE_IMAGES):
        few = more_of(few, known, np.random.default_rng(2))
    assert len(few.readings) == KEPT_IMAGES
    assert not np.isin(few.readings[:, 0], both.readings[:50, 0]).any()


@pytest.mark.parametrize("what", ["camera", "board"])
def test_a_camera_or_a_board_that_moved_is_told_by_its_name_within_two_images(cell: Cell, what: str) -> None:
    *_, said = cell.led(12)
    shift = pin.SE3(np.eye(3), np.array([2e-3, 1e-3, -1e-3]))
    if what == "camera":
        cell.camera = cell.camera * shift
    else:
        cell.board = cell.board * shift
    told: list[Alarm] = []
    for _ in range(2):
        following = said[-1]
        assert isinstance(following, Next)
        said = cell.fed(np.array([*following.joints.values()]))
        told += [alarm for alarm in alarms(said) if alarm.what == "slip"]
    assert len(told) == 1
    assert {"camera": "the camera eye", "board": "the board on world"}[what] in told[0].words


def test_an_image_of_the_pose_before_is_told_although_its_noise_is_new(cell: Cell) -> None:
    *_, said = cell.led(6)
    last, following = cell.now.here(), said[-1]
    assert last is not None and isinstance(following, Next)
    said = cell.fed(np.array([*following.joints.values()]), last)
    assert [alarm.what for alarm in alarms(said)] == ["stale"]


def test_where_camera_and_board_are_two_images_leave_open_and_three_tell(cell: Cell, tmp_path: Path) -> None:
    """Rows of one image are many, but of one pose. The pose that is proposed then shows the board."""
    text = (tmp_path / "campaign.yaml").read_text()
    text = text.replace(", xyz: [0.05, 0.0, 0.04], rpy: [0.0, 0.0, 0.5]", "")
    (tmp_path / "campaign.yaml").write_text(text.replace(", xyz: [0.45, 0.0, 0.0], rpy: [0.0, 0.0, 0.2]", ""))
    assert cell.now.prior is not None
    poses = draw_candidates(cell.now.prior.setup, 40, 1, np.random.default_rng(3)).readings
    cell.now = session(load_campaign(tmp_path / "campaign.yaml"), cell.now.robot, None)
    (first,) = cell.now.taken([])
    assert isinstance(first, Next) and not first.joints
    began = 0
    for number, readings in enumerate(poses[:8], start=1):
        said = cell.fed(readings)
        began = began or (number if cell.now.posterior is not None else 0)
        if began:
            break
    assert 3 <= began < 8
    assert isinstance(said[-1], Next) and said[-1].joints
    pixels = [[row["u"], row["v"]] for row in cell.image(np.array([*said[-1].joints.values()]))]
    assert len(pixels) >= 4


def test_half_an_image_waits_for_its_other_half(cell: Cell) -> None:
    """A driver writes line by line: the file is looked at twice, and taken where it has not grown in between."""
    campaign = cell.now.campaign
    (path,) = campaign.measurements.files
    first = cell.now.taken([])[-1]
    assert isinstance(first, Next)
    readings = np.array([*first.joints.values()])
    lines = [line + b"\n" for line in cell.lines(readings, readings)]
    parts = [b"".join(lines[:3]), *lines[3:]]
    written = len(parts)

    def pause(_: float) -> None:
        with path.open("ab") as file:
            file.write(parts.pop(0) if parts else b"")

    for events in followed(session(campaign, cell.now.robot, None), Incoming(), pause):
        rows = [event for event in events if isinstance(event, RowRead)]
        if rows:
            break
    assert not parts
    assert [row.count for row in rows] == [len(lines) - 1] == [written + 1]


def test_python_records_all_corners_of_an_image_and_an_empty_one_is_refused_in_words(cell: Cell) -> None:
    guided = aridcal.guide(cell.now.campaign)
    for pose in guided:
        readings = np.array([*pose.joints.values()])
        with pytest.raises(MeasurementError, match="reject"):
            pose.record([])
        pose.record(cell.image(readings))
        if len(guided.rows) == 3:
            break
    assert [row.ok for row in guided.rows] == [True] * 3
    (path,) = cell.now.campaign.measurements.files
    assert len(path.read_text().splitlines()) == 1 + sum(row.count for row in guided.rows)


@pytest.mark.parametrize(
    ("kind", "camera", "word"),
    [("pixels", "identify: [place, f]", "identify: [place]"), ("distance", "", "plan others with `aridcal design`")],
)
def test_what_is_not_guided_is_refused_with_what_to_do(
    cell: Cell, tmp_path: Path, kind: str, camera: str, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three images begin with any lens, and frames then seem to slip; other kinds are planned."""
    (tmp_path / "other.yaml").write_text(
        f"format: 1\nrobot: {{urdf: arm.urdf, tip: tool}}\nmeasurements: {{file: m.csv, kind: {kind}}}\n"
        f"instruments: {{cameras: {{eye: {{{CAMERA}, {camera}}}}}, markers: {{file: markers.csv}}}}\n"
    )
    before = sorted(path.name for path in tmp_path.iterdir())
    assert main([str(tmp_path / "other.yaml"), "--no-page"]) == 2
    assert word in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == before
