"""`aridcal init` on tables that measure something else than poses: kind, units, instruments, and a campaign that can be read."""

import re
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from photographs import looking, photograph
from repository import ROOT

from aridcal.detect import main as detect_main
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.read import load_measurements
from aridcal.init import main
from aridcal.print import main as print_main

UR10 = ROOT / "urdf" / "ur10.urdf"
ARM = load_robot(UR10, "tool0")
N = 30


def joints(scale: float = 1.0, suffix: str = "") -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {f"{name}{suffix}": scale * rng.uniform(-3, 3, N) for name in ARM.readings}


def proposed(folder: Path, columns: dict[str, object]) -> tuple[Campaign, Dataset, str]:
    """What `aridcal init` writes for a table, read again as `identify` does."""
    pd.DataFrame(columns).to_csv(folder / "table.csv", index=False)
    out = folder / "campaign.yaml"
    assert main(["--urdf", str(UR10), "--measurements", str(folder / "table.csv"), "-o", str(out)]) == 0
    campaign = load_campaign(out)
    return campaign, load_measurements(campaign, ARM.readings, ARM.limits, ARM.kinds), out.read_text()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path


def test_sockets_are_points_and_the_missing_length_is_said(folder):
    campaign, rows, text = proposed(folder, {"point": ["a/0", "a/1", "b/0"] * (N // 3), **joints()})
    assert campaign.measurements.kind == "point" and len(rows) == N
    assert rows.instruments.things["point"].names == ("a/0", "a/1", "b/0")
    assert "the arm's scale is not" in text and "lengths: [{between: [A, B]" in text.replace("\n  #  ", "")


def test_a_wires_millimetres_and_degrees_are_seen_by_their_size(folder):
    table = {"distance": np.linspace(300, 1500, N), "anchor": ["rail"] * N, **joints(180 / np.pi)}
    campaign, rows, text = proposed(folder, table)
    assert campaign.measurements.kind == "distance"
    assert campaign.measurements.units.length == "mm" and campaign.measurements.units.angle == "deg"
    assert np.isclose(np.max(rows.observed[:, 0]), 1.5) and np.abs(rows.readings).max() < 3.2
    assert "GUESSED: joints up to" in text


def test_a_gauge_is_of_planes_and_its_header_says_the_unit(folder):
    table = {"plane": ["table", "left"] * (N // 2), "reading": np.linspace(-0.002, 0.002, N), **joints()}
    campaign, rows, _ = proposed(folder, table)
    assert campaign.measurements.kind == "plane" and campaign.measurements.units.length == "m"
    assert rows.instruments.things["plane"].names == ("left", "table") or set(
        rows.instruments.things["plane"].names
    ) == {"left", "table"}
    assert np.isclose(np.max(rows.observed[:, 0]), 0.002)


def test_an_inclinometer_is_recognised(folder):
    g = np.random.default_rng(1).normal(size=(N, 3))
    campaign, rows, _ = proposed(folder, {"gx": g[:, 0], "gy": g[:, 1], "gz": g[:, 2], **joints()})
    assert campaign.measurements.kind == "inclination" and rows.observed.shape[0] == N


def pixels() -> dict[str, object]:
    rng = np.random.default_rng(2)
    table = {
        "image": [f"shot_{k // 3}.png" for k in range(N)],
        "camera": ["eye"] * N,
        "marker": ["c0", "c1", "c2"] * (N // 3),
    }
    table |= {"u": np.linspace(0, 639, N), "v": rng.permutation(np.linspace(0, 479, N)), "shot": np.arange(N) // 3}
    return table | joints()


def test_pixels_take_camera_and_board_from_the_files_beside_them(folder):
    (folder / "camera.yaml").write_text(
        "format: 1\ncameras:\n  eye: {fx: 700, fy: 701, cx: 320, cy: 240, width: 640, height: 480, on: tip, identify: [place]}\n"
    )
    pd.DataFrame({"marker": ["c0", "c1", "c2"], "x": [0, 0.1, 0], "y": [0, 0, 0.1], "z": 0.0}).to_csv(
        folder / "markers.csv", index=False
    )
    campaign, rows, text = proposed(folder, pixels())
    assert campaign.measurements.kind == "pixels"
    assert campaign.instruments.cameras["eye"].fy == 701 and campaign.instruments.cameras["eye"].identify == ("place",)
    assert [board.file for board in campaign.instruments.markers] == [folder / "markers.csv"]
    assert "ignore: [image]" in text and len(rows) == N
    assert np.allclose(rows.instruments.things["marker"].start, [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])


def test_without_those_files_the_camera_is_guessed_and_said_to_be(folder):
    campaign, rows, text = proposed(folder, {name: cells for name, cells in pixels().items() if name != "camera"})
    (label,) = campaign.instruments.cameras
    assert label == "camera_1"
    assert (campaign.instruments.cameras[label].width, campaign.instruments.cameras[label].height) == (640, 480)
    assert "GUESSED: no camera.yaml" in text and "GUESSED: markers: no markers.csv" in text
    assert len(rows) == N


def test_from_print_over_photographs_and_detect_to_a_campaign_that_reads_them(folder):
    """As a user goes: each row's labels have their camera and their places, and the joints are the image's own."""
    images = folder / "images"
    images.mkdir()
    assert print_main(["charuco", "-o", str(folder / "board.svg")]) == 0
    rng = np.random.default_rng(3)
    rows = []
    for k in range(5):
        T = looking(
            *rng.uniform(-0.02, 0.02, 2), rng.uniform(0.45, 0.55), *rng.uniform(-0.6, 0.6, 2), rng.uniform(-3, 3)
        )
        cv2.imwrite(str(images / f"s{k}.png"), photograph((folder / "board.svg").read_text(), T, seed=k))
        rows.append(
            {"image": f"s{k}.png"} | dict(zip(ARM.readings, rng.uniform(-3, 3, len(ARM.readings)), strict=True))
        )
    pd.DataFrame(rows).to_csv(folder / "joints.csv", index=False)
    assert detect_main([str(images), "--joints", str(folder / "joints.csv"), "-o", str(folder / "corners.csv")]) == 0
    out = folder / "campaign.yaml"
    assert main(["--urdf", str(UR10), "--measurements", str(folder / "corners.csv"), "-o", str(out)]) == 0
    campaign = load_campaign(out)
    data = load_measurements(campaign, ARM.readings, ARM.limits, ARM.kinds)
    assert len(data) == 5 * 24 and data.instruments.things["camera"].names == ("eye",)
    assert np.isfinite(data.instruments.things["marker"].start).all()
    assert {tuple(q) for q in np.round(data.readings, 12)} == {
        tuple(np.round(list(row.values())[1:], 12)) for row in rows
    }


@pytest.mark.parametrize("page", ["ball", "webcam", "dial-gauge"])
def test_the_campaigns_of_the_pages_can_be_read(page, tmp_path):
    text = (ROOT / "docs" / f"calibrate-with-a-{page}.md").read_text("utf-8")
    (block,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    (tmp_path / "campaign.yaml").write_text(block)
    campaign = load_campaign(tmp_path / "campaign.yaml")
    assert campaign.measurements.kind == {"ball": "point", "webcam": "pixels", "dial-gauge": "plane"}[page]


@pytest.mark.parametrize("page", ["ball", "webcam", "dial-gauge"])
def test_the_print_commands_of_the_pages_work(page, tmp_path, monkeypatch):
    text = (ROOT / "docs" / f"calibrate-with-a-{page}.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    for command in re.findall(r"aridcal print ([^`]*-o [^`]*)`", text):
        assert print_main(command.split()) == 0, command


def test_a_table_of_positions_stays_one_whatever_else_it_has(tmp_path):
    """A column `distance` or `point` beside x y z is a covariate or a note."""
    table = pd.read_csv(ROOT / "identification" / "arid" / "measurements.csv")
    table["distance"] = 1.0
    table.to_csv(tmp_path / "table.csv", index=False)
    urdf = ROOT / "urdf" / "arid.urdf"
    assert (
        main(["--urdf", str(urdf), "--measurements", str(tmp_path / "table.csv"), "-o", str(tmp_path / "c.yaml")]) == 0
    )
    assert load_campaign(tmp_path / "c.yaml").measurements.kind == "pose"


def test_lengths_in_two_units_are_refused(tmp_path, capsys):
    table = {"distance [mm]": np.linspace(300, 1500, N), "joint_1 [m]": np.linspace(0, 1, N)}
    urdf = ROOT / "urdf" / "arid.urdf"
    arid = load_robot(urdf, "flange")
    rng = np.random.default_rng(0)
    table |= {name: rng.uniform(-1, 1, N) for name in arid.readings if name != "joint_1"}
    pd.DataFrame(table).to_csv(tmp_path / "table.csv", index=False)
    assert (
        main(["--urdf", str(urdf), "--measurements", str(tmp_path / "table.csv"), "-o", str(tmp_path / "c.yaml")]) == 2
    )
    assert "different units" in capsys.readouterr().err
