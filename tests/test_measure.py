"""Shots to measured poses: the table, its uncertainty, what is refused, which square is seen, the contact sheet."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from aridcal.engine.instruments.camera import DOTY_OPENCV
from aridcal.engine.instruments.camera_sonar import predict_ranges
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import load_robot
from aridcal.jobs.head1992.charuco import Board
from aridcal.jobs.head1992.render import ImageAppearance, render
from aridcal.jobs.head1992.square import INCH, strip_placements
from aridcal.measure import main

cv2.setNumThreads(1)
ARID = Path(__file__).parent.parent / "urdf" / "arid.urdf"
INTRINSICS = np.array([700.0, 700.0, 255.5, 255.5, 0, 0, 0, 0, 0])
CORNERS = 2 * INCH * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
T_TIP_CAMERA = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.01, 0.02, 0.1])).homogeneous
T_WORLD_STRIP = pin.SE3(pin.rpy.rpyToMatrix(1.0, 0.3, -0.4), np.array([1.0, 2.0, 3.0])).homogeneous
HEAD = """\
format: 1
camera: {fx: 700.0, fy: 700.0, cx: 255.5, cy: 255.5, width: 512, height: 512}
sonars:
  positions: [[-0.0508, -0.0508, 0], [0.0508, -0.0508, 0], [0.0508, 0.0508, 0], [-0.0508, 0.0508, 0]]
  std: 2.5e-4
tip_camera: {xyz: [0.01, 0.02, 0.1], rpy: [0.1, -0.2, 0.3]}
squares: squares.csv
shots: shots.csv
"""


def sight(k: int) -> np.ndarray:
    """T_camera_square of the k-th shot."""
    rng = np.random.default_rng(k)
    T = np.eye(4)
    T[:3, :3] = (
        DOTY_OPENCV @ pin.exp3(np.r_[rng.uniform(-0.12, 0.12, 2), 0]) @ pin.exp3(np.r_[0, 0, rng.uniform(-0.5, 0.5)])
    )
    T[:3, 3] = [0, 0, rng.uniform(0.22, 0.4)] - T[:3, :3] @ np.r_[rng.uniform(-1, 1, 2) * INCH, 0]
    return T


class Campaign:
    """A folder with a head, three squares and some shots, and their truth."""

    def __init__(self, folder: Path, shots: int = 4) -> None:
        self.folder = folder
        strip = T_WORLD_STRIP @ strip_placements(3)
        self.squares = dict(enumerate(strip))
        quaternions = Rotation.from_matrix(strip[:, :3, :3]).as_quat()
        poses = np.column_stack([np.arange(3), strip[:, :3, 3], quaternions])
        pd.DataFrame(poses, columns=["index", *"xyz", "qx", "qy", "qz", "qw"]).astype({"index": int}).to_csv(
            folder / "squares.csv", index=False
        )
        (folder / "head.yaml").write_text(HEAD)
        (folder / "images").mkdir()
        self.truth, rows = [], []
        for k in range(shots):
            square, T = k % 3, sight(k)
            rows.append({"joint_a": 0.1 * k, "image": f"images/{k}.png", "square": square, "temperature": 20.0 + k})
            rows[-1] |= self.look(k, square, T)
            self.truth.append(self.squares[square] @ np.linalg.inv(T) @ np.linalg.inv(T_TIP_CAMERA))
        self.shots = pd.DataFrame(rows)

    def look(self, k: int, square: int, T: np.ndarray) -> dict[str, float]:
        seen = {i: T @ np.linalg.inv(self.squares[square]) @ S for i, S in self.squares.items()}
        rng = np.random.default_rng(100 + k)
        cv2.imwrite(str(self.folder / f"images/{k}.png"), render(seen, INTRINSICS, 512, 512, ImageAppearance(), rng))
        h = predict_ranges(T, CORNERS, "perpendicular")[0] + 2.5e-4 * rng.normal(size=4)
        return {f"h{i + 1}": value for i, value in enumerate(h)}

    def run(self) -> int:
        self.shots.to_csv(self.folder / "shots.csv", index=False)
        return main([str(self.folder / "head.yaml"), "-o", str(self.folder / "out" / "measurements.csv")])

    def measured(self) -> pd.DataFrame:
        return pd.read_csv(self.folder / "out" / "measurements.csv")

    def refused(self) -> dict[int, str]:
        table = pd.read_csv(self.folder / "out" / "refused.csv")
        assert list(table.columns) == ["shot", "image", "why"]
        return dict(zip(table["shot"], table["why"], strict=True))


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Campaign:
    return Campaign(tmp_path_factory.mktemp("head"))


@pytest.fixture
def campaign(made, tmp_path) -> Campaign:
    """A copy that a test may spoil."""
    copy = object.__new__(Campaign)
    copy.__dict__ = dict(made.__dict__, folder=tmp_path, shots=made.shots.copy())
    for name in ("squares.csv", "head.yaml"):
        (tmp_path / name).write_bytes((made.folder / name).read_bytes())
    (tmp_path / "images").mkdir()
    for path in (made.folder / "images").iterdir():
        (tmp_path / "images" / path.name).write_bytes(path.read_bytes())
    return copy


def errors(row: pd.Series, truth: np.ndarray) -> np.ndarray:
    R = Rotation.from_quat(row[["qx", "qy", "qz", "qw"]].to_numpy(float))
    turn = (Rotation.from_matrix(truth[:3, :3]) * R.inv()).as_rotvec()
    return np.concatenate([truth[:3, 3] - row[["x", "y", "z"]].to_numpy(float), turn])


def test_measured_poses_are_those_of_the_tip_in_the_world_within_their_stated_sigma(campaign, capsys):
    assert campaign.run() == 0
    table = campaign.measured()
    assert list(table.columns[:5]) == ["shot", "joint_a", "square", "temperature", "x"]
    assert not {"image", "h1"} & set(table.columns) and table["shot"].tolist() == [2, 3, 4, 5]
    for (_, row), truth in zip(table.iterrows(), campaign.truth, strict=True):
        std = row[["std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz"]].to_numpy(float)
        error = errors(row, truth)
        assert np.all(np.abs(error) < 4.5 * std) and np.linalg.norm(error[:3]) < 2e-4
        assert np.all(std[:3] < 1e-4) and np.all(std[3:] < 1e-3)
    assert campaign.refused() == {} and "4 shots measured, 0 refused" in capsys.readouterr().err


def test_contact_sheet_shows_every_shot_and_needs_nothing_else(campaign):
    campaign.shots.loc[1, "h2"] = np.nan
    assert campaign.run() == 0
    page = (campaign.folder / "out" / "shots.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 4 and "http" not in page
    assert "h2: the range is missing" in page and "3 of 4 shots measured" in page


def spoil_empty(c: Campaign) -> None:
    (c.folder / "images/0.png").write_bytes(b"")


def spoil_text(c: Campaign) -> None:
    (c.folder / "images/0.png").write_text("no image")


def spoil_size(c: Campaign) -> None:
    cv2.imwrite(str(c.folder / "images/0.png"), np.zeros((480, 640), np.uint8))


def spoil_huge(c: Campaign) -> None:
    """A picture of 45 bytes that says to be of 60,000 x 60,000 pixels."""
    path = c.folder / "images/0.png"
    content = bytearray(path.read_bytes()[:33])
    content[16:24] = struct.pack(">II", 60_000, 60_000)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    path.write_bytes(content + struct.pack(">I4sI", 0, b"IEND", zlib.crc32(b"IEND")))


def spoil_link(c: Campaign) -> None:
    (c.folder / "images/0.png").unlink()
    (c.folder / "images/0.png").symlink_to("/etc/hostname")


def spoil_cut(c: Campaign) -> None:
    path = c.folder / "images/0.png"
    path.write_bytes(path.read_bytes()[:20_000])


def spoil_blank(c: Campaign) -> None:
    cv2.imwrite(str(c.folder / "images/0.png"), np.full((512, 512), 200, np.uint8))


def put(column, value):
    def spoil(c: Campaign) -> None:
        c.shots[column] = c.shots[column].astype(object)
        c.shots.loc[0, column] = value

    return spoil


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (spoil_empty, "cannot be read: is empty"),
        (spoil_text, "no image of a known kind"),
        (spoil_cut, "or damaged"),
        (spoil_huge, "is 60000 x 60000 pixels, the camera 512 x 512"),
        (spoil_link, "outside the folder"),
        (spoil_size, "640 x 480 pixels, the camera 512 x 512"),
        (spoil_blank, "no square found"),
        (put("image", "images/9.png"), "no such image"),
        (put("image", ""), "no image is named"),
        (put("image", "images"), "is a folder, not a file"),
        (put("image", 300 * "a" + ".png"), "cannot be the name of a file: File name too long"),
        (put("image", "images/0\0.png"), "holds a control character"),
        (put("image", "../../etc/passwd.png"), "outside the folder"),
        (put("image", "/etc/passwd"), "outside the folder"),
        (put("h1", ""), "h1: the range is missing"),
        (put("h3", "far"), "h3: the range is missing or no number"),
        (put("h2", -0.2), "h2: a range of -0.2 m cannot be right"),
        (put("h1", 0.0), "h1: a range of 0 m cannot be right"),
        (put("h1", "inf"), "h1: the range is missing or no number"),
        (put("h4", 250), "h4: a range of 250 m cannot be right; give metres"),
        (put("h4", 1.5), "sonars: "),
        (put("square", 17), "no square 17"),
        (put("square", -1), "no square -1"),
        (put("square", 1.5), "'1.5' should be the index of a square"),
        (put("square", "left"), "'left' should be the index of a square"),
    ],
)
def test_a_shot_that_can_not_be_measured_is_named_and_refused(campaign, spoil, why):
    spoil(campaign)
    campaign.shots = campaign.shots.iloc[:2]
    assert campaign.run() == 0
    refused = campaign.refused()
    assert list(refused) == [2] and why in refused[2]
    assert campaign.measured()["shot"].tolist() == [3]


def test_nothing_measured_is_exit_2_and_leaves_nothing(campaign, capsys):
    campaign.shots["h1"] = -1.0
    assert campaign.run() == 2
    assert "nothing could be measured" in capsys.readouterr().err and not (campaign.folder / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("sonars:", "sonar:", "did you mean 'sonars'?"),
        ("fx: 700.0", "fx: -700.0", "fx"),
        ("squares: squares.csv", "squares: none.csv", "no such file"),
        ("[0.0508, -0.0508, 0], [0.0508, 0.0508, 0], [-0.0508, 0.0508, 0]]", "[0, 0, 0], [0.1, 0.1, 0]]", "one line"),
        ("std: 2.5e-4", "std: 2.5e-4\n  measures: across", "measures"),
        ("shots: shots.csv", "shots: shots.csv\ntarget: charuco", "also needs"),
    ],
)
def test_a_wrong_head_file_is_exit_2_and_named(campaign, capsys, old, new, said):
    path = campaign.folder / "head.yaml"
    assert old in HEAD
    path.write_text(HEAD.replace(old, new))
    assert campaign.run() == 2
    assert said in capsys.readouterr().err.replace("\n", " ")


def test_wrong_squares_are_exit_2_and_named(campaign, capsys):
    table = pd.read_csv(campaign.folder / "squares.csv")
    table.loc[1, "qw"] += 0.5
    table.to_csv(campaign.folder / "squares.csv", index=False)
    assert campaign.run() == 2 and "squares.csv, line 3" in capsys.readouterr().err


def test_a_sonar_that_contradicts_the_camera_throughout_is_named(campaign, capsys):
    campaign.shots["h3"] += 0.004
    assert campaign.run() == 0
    assert "sonar 3 differs from the camera by" in capsys.readouterr().err.replace("\n", " ")
    assert campaign.measured()["std_x"].min() > 1e-4  # and the poses own up to it


@pytest.fixture
def arm(tmp_path) -> tuple[Campaign, np.ndarray]:
    """Shots without `square`, the ARID in front of the strip; tells T_world_tip too."""
    robot = load_robot(ARID, "flange", "base_link")
    q = np.tile(np.mean(robot.limits, axis=1), (2, 1))
    model = Model(robot, ())
    R, p = model.poses(np.zeros(0), model.rows(q))
    tips = np.tile(np.eye(4), (2, 1, 1))
    tips[:, :3, :3], tips[:, :3, 3] = R, p
    campaign = Campaign(tmp_path, shots=2)
    # Move the world so that the first shot's tip is where the nominal arm has it.
    world_base = campaign.truth[0] @ np.linalg.inv(tips[0])
    xyz, rpy = world_base[:3, 3], pin.rpy.matrixToRpy(world_base[:3, :3])
    robot_lines = f"robot: {{urdf: {ARID}, base: base_link, tip: flange}}\n"
    robot_lines += f"world_base: {{xyz: {xyz.tolist()}, rpy: {rpy.tolist()}}}\n"
    (tmp_path / "head.yaml").write_text(HEAD + robot_lines)
    campaign.shots = campaign.shots.drop(columns=["square"]).iloc[:1]
    for name, value in zip(robot.readings, q[0], strict=True):
        campaign.shots[name] = value
    return campaign, tips[0]


def test_the_square_is_worked_out_from_the_nominal_arm(arm):
    campaign, _ = arm
    campaign.shots["joint_1"] += 0.012  # the real arm is not quite the nominal one
    assert campaign.run() == 0
    assert np.linalg.norm(errors(campaign.measured().iloc[0], campaign.truth[0])[:3]) < 2e-4


def test_the_arm_may_be_a_xacro_file_with_arguments_and_packages(arm, tmp_path):
    campaign, _ = arm
    description = tmp_path / "parts" / "arid_description"
    description.mkdir(parents=True)
    body = ARID.read_text(encoding="utf-8").partition("?>")[2]
    parts = body.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1)
    (description / "arid.xacro").write_text(parts)
    (tmp_path / "arm.xacro").write_text(
        '<robot name="arid" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="which" default="nothing"/>'
        '<xacro:include filename="$(find arid_description)/$(arg which).xacro"/></robot>'
    )
    head = tmp_path / "head.yaml"
    about = "packages: {arid_description: parts/arid_description}, arguments: {which: arid}"
    head.write_text(head.read_text().replace(f"urdf: {ARID},", f"urdf: arm.xacro, {about},"))
    assert campaign.run() == 0
    assert np.linalg.norm(errors(campaign.measured().iloc[0], campaign.truth[0])[:3]) < 2e-4


def test_an_ambiguous_square_is_refused_not_guessed(arm, capsys):
    campaign, _ = arm
    joint = next(name for name in campaign.shots.columns if name.startswith("joint_2") or name == "joint_2")
    campaign.shots[joint] += 0.5
    assert campaign.run() == 2
    assert "give `square`" in capsys.readouterr().err


def test_a_charuco_board_is_measured_the_same_way(campaign):
    board = Board(7, 7, 0.02, 0.015, "DICT_4X4_50")
    pixels_per_m = 10_000
    sheet = cv2.cvtColor(board.opencv().generateImage((1400, 1400)), cv2.COLOR_GRAY2BGR)[..., 0]
    to_square = np.array([[1 / pixels_per_m, 0, -0.07], [0, -1 / pixels_per_m, 0.07], [0, 0, 1]])
    K = np.array([[700, 0, 255.5], [0, 700, 255.5], [0, 0, 1]])
    for k in range(4):
        T = sight(k)
        H = K @ T[:3, [0, 1, 3]] @ to_square
        fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ H
        image = cv2.warpPerspective(sheet, fine, (2048, 2048), borderValue=255)
        image = cv2.resize(image, (512, 512), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(campaign.folder / f"images/{k}.png"), image)
    keys = "target: charuco\nsquares_x: 7\nsquares_y: 7\nsquare: 0.02\nmarker: 0.015\ndictionary: DICT_4X4_50\n"
    (campaign.folder / "head.yaml").write_text(HEAD + keys)
    assert campaign.run() == 0 and campaign.refused() == {}
    for (_, row), truth in zip(campaign.measured().iterrows(), campaign.truth, strict=True):
        assert np.linalg.norm(errors(row, truth)[:3]) < 1e-3
        assert 1e-6 < row["std_x"] < 5e-4
