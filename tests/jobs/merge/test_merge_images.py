"""`aridcal merge` of a bag with a camera: one settled image for each standstill, its joints, and the camera's own numbers."""

from __future__ import annotations

from pathlib import Path

import cv2
import made_bags
import made_logs
import numpy as np
import pandas as pd
import photographs
import pytest
import robots

import aridcal
from aridcal.detect import main as detect
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.boards.camera_file import camera_by_name
from aridcal.jobs.boards.camera_frames import packed_frame, raw_frame
from aridcal.jobs.boards.options import ALL_BOARDS, board_of
from aridcal.jobs.boards.patterns import drawing, marks
from aridcal.jobs.boards.sheet import svg
from aridcal.jobs.head1992.head_settings import CameraSettings, HeadSettings, load_shots
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.head1992.shots import read_image, shots_of
from aridcal.jobs.merge.bag_camera import BagCamera, CameraInfo, intrinsics
from aridcal.merge import main

UR10 = robots.URDF / "ur10.urdf"
ROBOT = robots.ur10()
MADE = made_logs.made(ROBOT, n=6, seed=4, encoder=1e-7)
JOINTS = MADE.joints[::5]
SIZE = (120, 90)
ARGUMENTS = ["--urdf", str(UR10), "--tip", "tool0", "-o"]

SCENES = [cv2.resize(np.random.default_rng(k).integers(0, 255, (6, 8, 3), np.uint8), SIZE) for k in range(6)]
"""What the camera sees from each stop."""


def info(
    size: tuple[int, int] = SIZE, numbers: np.ndarray = photographs.INTRINSICS, **other: object
) -> dict[str, object]:
    fx, fy, cx, cy, *d = (float(value) for value in numbers)
    k = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    p = [0.9 * fx, 0, cx + 3, 0, 0, 0.9 * fy, cy - 2, 0, 0, 0, 1, 0]
    return {
        "width": size[0],
        "height": size[1],
        "model": "plumb_bob",
        "d": d,
        "k": k,
        "r": np.eye(3).ravel(),
        "p": p,
    } | other


def filmed(scenes: list[np.ndarray], late: float = 0.0, rate: float = 4.0) -> list[tuple[float, np.ndarray]]:
    """A film: at a stop its scene, in between mixtures, everywhere noise of two grey levels."""
    rng, frames = np.random.default_rng(0), []
    for t in np.arange(0.2, float(JOINTS["time"].max()), 1 / rate):
        k = int(np.clip(np.searchsorted(MADE.arrived, t, "right") - 1, 0, len(scenes) - 1))
        share = 0.0
        if k + 1 < len(scenes) and t > MADE.left[k]:
            share = (t - MADE.left[k]) / (MADE.arrived[k + 1] - MADE.left[k])
        mixed = scenes[k] * (1.0 - share) + scenes[min(k + 1, len(scenes) - 1)] * share
        frames.append((t + late, np.clip(mixed + rng.normal(0, 2, mixed.shape), 0, 255).astype(np.uint8)))
    return frames


FILM = filmed(SCENES)


@pytest.mark.parametrize(
    ("how", "encoding"),
    [("mcap", "bgr8"), ("sqlite3", "rgb8"), ("ros1", "mono8"), ("mcap", "jpeg"), ("sqlite3", "png")],
)
def test_each_stop_has_its_own_image_and_joints(tmp_path: Path, how: str, encoding: str) -> None:
    bag = tmp_path / ("run.bag" if how == "ros1" else "run")
    made_bags.write_camera_bag(bag, JOINTS, FILM, encoding, info(), how)
    assert main([str(bag), *ARGUMENTS, str(tmp_path / "out" / "shots.csv"), "--quiet"]) == 0
    table = pd.read_csv(tmp_path / "out" / "shots.csv")
    np.testing.assert_allclose(table[list(ROBOT.readings)], MADE.q, atol=1e-6)
    for k, (name, time) in enumerate(zip(table["image"], table["time"], strict=True)):
        assert MADE.arrived[k] - 3.0 <= time <= MADE.left[k] + 4.0
        image = cv2.imread(str(tmp_path / "out" / name), cv2.IMREAD_UNCHANGED)
        # by another road: the frame of the film that was taken nearest to the stop's middle
        _, nearest = min(FILM, key=lambda one: abs(one[0] - time))
        if encoding == "mono8":
            nearest = cv2.cvtColor(nearest, cv2.COLOR_BGR2GRAY)
        off = np.abs(image.astype(float) - nearest)
        assert off.max() == 0 if encoding != "jpeg" else off.mean() < 4
    camera = camera_by_name(tmp_path / "out" / "shots_images" / "camera.yaml", "eye")
    own = {name: getattr(camera, name) for name in CameraSettings.model_fields}
    np.testing.assert_array_equal(CameraSettings(**own).intrinsics, photographs.INTRINSICS)  # as head.yaml takes it
    assert (own["width"], own["height"]) == SIZE


def test_from_a_bag_to_a_campaign_of_pixels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """merge, detect, init: the corners are where the board was photographed, and the campaign has the camera's numbers."""
    half, size = photographs.INTRINSICS * np.r_[np.full(4, 0.5), np.ones(5)], (480, 360)
    board = board_of("charuco", ALL_BOARDS["charuco"])
    poses = [photographs.looking(0.01 * k, 0.005 * k, 0.42 + 0.02 * k, 0.3, 0.2 - 0.1 * k, 0.2 * k) for k in range(6)]
    sheet = svg(drawing(board))
    taken = [photographs.photograph(sheet, T, half, size, noise=0.5) for T in poses]
    scenes = [cv2.cvtColor(image, cv2.COLOR_GRAY2BGR).astype(float) for image in taken]
    made_bags.write_camera_bag(tmp_path / "run", JOINTS, filmed(scenes, rate=2.0), "mono8", info(size, half))
    shots, images = tmp_path / "shots.csv", tmp_path / "shots_images"
    assert main([str(tmp_path / "run"), *ARGUMENTS, str(shots)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-1].startswith("next: aridcal detect ")
    assert detect(said[-1].removeprefix("next: aridcal detect ").split()) == 0
    corners = pd.read_csv(tmp_path / "corners.csv")
    known = marks(board)
    for name, seen in corners.groupby("image"):
        k = int(str(name)[5:8]) - 1
        rows = [known.names.index(marker) for marker in seen["marker"]]
        expected = photographs.pixels_of(known.places[rows], poses[k], half)
        assert np.abs(seen[["u", "v"]] - expected).to_numpy().max() < 0.3
        np.testing.assert_allclose(seen[list(ROBOT.readings)].iloc[0], MADE.q[k], atol=1e-6)
    campaign = aridcal.propose(UR10, tmp_path / "corners.csv")
    np.testing.assert_array_equal(campaign.instruments.cameras["eye"].intrinsics, half)
    assert images.is_dir()


def test_a_measuring_head_takes_the_table_the_images_and_the_camera(tmp_path: Path) -> None:
    made_bags.write_camera_bag(tmp_path / "run", JOINTS, FILM, "mono8", info())
    (tmp_path / "shots.html").write_text("an earlier page")
    assert main([str(tmp_path / "run"), *ARGUMENTS, str(tmp_path / "shots.csv"), "--quiet"]) == 0
    assert not (tmp_path / "shots.html").exists()
    camera = camera_by_name(tmp_path / "shots_images" / "camera.yaml", "eye")
    own = {name: getattr(camera, name) for name in CameraSettings.model_fields} | {
        "distortion": list(camera.distortion)
    }
    (tmp_path / "squares.csv").write_text("index,x,y,z,qx,qy,qz,qw\n1,1,0,0.5,0,0,0,1\n")
    (tmp_path / "head.yaml").write_text(
        f"format: 1\ncamera: {own}\ntip_camera: {{xyz: [0, 0, 0.1], rpy: [0, 0, 0]}}\ntarget: charuco\nsquares_x: 7\n"
        "squares_y: 5\nsquare: 0.035\nmarker: 0.026\ndictionary: DICT_5X5_50\nsquares: squares.csv\nshots: shots.csv\n"
        f"robot: {{urdf: {UR10}, tip: tool0}}\n"
    )
    head = load_settings(tmp_path / "head.yaml", HeadSettings)
    shots = shots_of(load_shots(head.shots, head), head, tmp_path / "head.yaml")
    assert len(shots) == len(SCENES)
    for shot, scene in zip(shots, SCENES, strict=True):
        grey = cv2.cvtColor(scene, cv2.COLOR_BGR2GRAY).astype(float)
        assert np.abs(read_image(shot.image, head) - grey).mean() < 3


def test_a_moving_picture_and_clocks_that_differ_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    jumpy = [
        (t, np.roll(image, 20 * (i % 2), axis=1) if MADE.arrived[2] < t < MADE.left[2] else image)
        for i, (t, image) in enumerate(FILM)
    ]
    made_bags.write_camera_bag(tmp_path / "jumpy", JOINTS, jumpy, "bgr8", None)
    assert main([str(tmp_path / "jumpy"), *ARGUMENTS, str(tmp_path / "a.csv")]) == 0
    out = capsys.readouterr().out
    assert "the picture still moves while the joints stand" in out
    assert "no CameraInfo belongs to it" in out
    assert len(pd.read_csv(tmp_path / "a.csv")) == 5
    assert len(list((tmp_path / "a_images").iterdir())) == 5
    for late, what in ((3.0, "the picture moves at"), (1e6, "no image is of the time")):
        bag = tmp_path / f"late{late:g}"
        made_bags.write_camera_bag(bag, JOINTS, filmed(SCENES, late), "bgr8", None)
        assert main([str(bag), *ARGUMENTS, str(tmp_path / "b.csv")]) == 2
        assert what in capsys.readouterr().err
    assert not (tmp_path / "b.csv").exists()
    assert not (tmp_path / "b_images").exists()


def test_a_delay_of_the_camera_does_no_harm(tmp_path: Path) -> None:
    made_bags.write_camera_bag(tmp_path / "run", JOINTS, filmed(SCENES, 0.3), "bgr8", None)
    assert main([str(tmp_path / "run"), *ARGUMENTS, str(tmp_path / "a.csv"), "--quiet"]) == 0
    for k, name in enumerate(pd.read_csv(tmp_path / "a.csv")["image"]):
        assert np.abs(cv2.imread(str(tmp_path / name)) - SCENES[k].astype(float)).mean() < 3  # its noise


def test_a_second_run_leaves_no_image_of_the_first_and_keeps_what_is_not_its_own(tmp_path: Path) -> None:
    made_bags.write_camera_bag(tmp_path / "run", JOINTS, FILM, "bgr8", info())
    images = tmp_path / "a_images"
    images.mkdir()
    for name in ("stop_099.png", "mine.png"):
        (images / name).write_bytes(b"earlier")
    assert main([str(tmp_path / "run"), *ARGUMENTS, str(tmp_path / "a.csv"), "--quiet"]) == 0
    assert not (images / "stop_099.png").exists()
    assert (images / "mine.png").read_bytes() == b"earlier"


def test_a_bag_with_a_target_and_a_camera_asks_which_is_meant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made_bags.write_camera_bag(tmp_path / "run", JOINTS, FILM, "bgr8", info(), also="/other/image_raw")
    assert main([str(tmp_path / "run"), *ARGUMENTS, str(tmp_path / "a.csv")]) == 2
    assert "1 = /eye/image_raw; 2 = /other/image_raw" in capsys.readouterr().err
    with pytest.raises(aridcal.AridcalError, match="the command `aridcal merge` writes them"):
        aridcal.merge(tmp_path / "run", None, UR10, "tool0", {"target": 1})
    JOINTS.to_csv(tmp_path / "joints.csv", index=False)
    assert (
        main(
            [
                str(tmp_path / "joints.csv"),
                str(tmp_path / "run"),
                *ARGUMENTS,
                str(tmp_path / "a.csv"),
                "--set",
                "target=1",
            ]
        )
        == 2
    )
    assert "joints of the same bag are needed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "topic", "said"),
    [
        ({"model": "equidistant"}, "/c/image_raw", "lens model 'equidistant'"),
        ({"D": (0.1, 0, 0, 0, 0, 0.2, 0, 0), "model": "rational_polynomial"}, "/c/image_raw", "'rational_polynomial'"),
        ({"K": (0.0,) * 9}, "/c/image_raw", "never calibrated"),
        ({"width": 60}, "/c/image_raw", "of 60 x 90 pixels, the images have 120 x 90"),
        ({"D": ()}, "/c/image_raw", ""),
        ({"D": (0.1, 0.2, 0, 0)}, "/c/image_raw", ""),
        ({}, "/c/image_rect_color", "straightened"),
    ],
)
def test_camera_infos_that_no_campaign_can_hold_are_not_taken(change: dict, topic: str, said: str) -> None:
    made = {"width": 120, "height": 90, "model": "plumb_bob", "D": (0.1, 0.2, 0.0, 0.0, 0.3)}
    made |= {"K": (200.0, 0.0, 120.0, 0.0, 201.0, 90.0, 0.0, 0.0, 1.0)}
    made |= {"P": (190.0, 0.0, 121.0, 0.0, 0.0, 191.0, 91.0, 0.0, 0.0, 0.0, 1.0, 0.0)}
    camera = BagCamera("bag", topic, np.zeros(1), False, (CameraInfo(**(made | change)),))
    found, words = intrinsics(camera, SIZE)
    assert said in words
    if "rect" in topic:
        assert found == {
            "fx": 190.0,
            "fy": 191.0,
            "cx": 121.0,
            "cy": 91.0,
            "width": 120,
            "height": 90,
            "distortion": [0.0] * 5,
        }
    elif said:
        assert found is None
        assert "aridcal detect" in words
    else:
        assert found is not None
        assert found["distortion"] == [*change["D"], *[0.0] * 5][:5]


def test_frames_that_lie_about_themselves_are_refused() -> None:
    data = np.zeros(30, np.uint8)
    for encoding, height, width, step in (
        ("bgr8", 10, 10, 30),
        ("mono8", 0, 5, 5),
        ("yuv422", 2, 2, 4),
        ("mono8", 2, 10, 5),
    ):
        with pytest.raises(NotMeasured):
            raw_frame(encoding, height, width, step, False, data)
    with pytest.raises(NotMeasured, match="megapixels"):
        raw_frame("mono8", 100_000, 100_000, 100_000, False, data)
    for content in (b"", b"nonsense", cv2.imencode(".png", SCENES[0])[1].tobytes()[:200]):
        with pytest.raises(NotMeasured):
            packed_frame(content)
    assert raw_frame("mono8", 1, 2, 4_000_000_000, False, data).tolist() == [[0, 0]]  # and takes no 4 GB
    wide = np.array([[0, 256 * 200]], ">u2").view(np.uint8).ravel()
    assert raw_frame("mono16", 1, 2, 4, True, wide).tolist() == [[0, 200]]


@pytest.mark.parametrize(("pattern", "first"), [("rggb", "rg"), ("bggr", "bg"), ("gbrg", "gb"), ("grbg", "gr")])
def test_bayer_patterns_have_the_colour_that_their_name_says(pattern: str, first: str) -> None:
    """A red sheet: only the pixels that the name calls red are light."""
    sheet = np.zeros((8, 8), np.uint8)
    for k, letter in enumerate(pattern):
        sheet[k // 2 :: 2, k % 2 :: 2] = 255 if letter == "r" else 0
    blue, green, red = (
        raw_frame(f"bayer_{pattern}8", 8, 8, 8, False, sheet.ravel())[3:5, 3:5].reshape(-1, 3).mean(axis=0)
    )
    assert red > 200 > 20 > max(blue, green)
