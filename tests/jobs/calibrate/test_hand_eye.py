"""Where cameras are, from a table of corners on: the truth within its sigmas, the same in every file that people paste."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots
import yaml
from repository import ROOT

import aridcal.init
from aridcal.engine.robot.expand import read_urdf
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.controllers import ControllerExports, controller_exports, write_controllers
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.prepare.campaign_text import Draft, draft
from aridcal.jobs.prepare.guesses import leave_open
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.system.reading.regular_files import URDF

WEBCAM = ROOT / "identification" / "webcam"
LENS = {
    "fx": 900.0,
    "fy": 900.0,
    "cx": 640.0,
    "cy": 360.0,
    "width": 1280,
    "height": 720,
    "distortion": [-0.12, 0.05, 0, 0, 0],
}
IN_HAND = {"xyz": [0.05, -0.03, 0.07], "rpy": [0.1, -0.2, 1.5]}
WRONG = ("shoulder_lift_joint.yaw", "elbow_joint.x", "elbow_joint.roll", "wrist_1_joint.yaw", "wrist_2_joint.roll")


def drafted(folder: Path, cameras: dict[str, dict], images: int, wrong: tuple[str, ...] = ()) -> Draft:
    """What `init` makes of a table of corners with the board and the lens beside it, as `detect` leaves them."""
    keys = {
        "format": 1,
        "robot": {"urdf": str(robots.URDF / "ur10.urdf"), "base": "base_link", "tip": "tool0"},
        "measurements": {"kind": "pixels"},
        "instruments": {
            "cameras": {name: LENS | camera for name, camera in cameras.items()},
            "markers": {"file": str(WEBCAM / "markers.csv")},
        },
        "truth": {
            "n": images, "seed": 3, "noise": {"pixel": 0.2},
            "parameters": {name: {"std": 1e-3} for name in wrong},
        },
    }  # fmt: skip
    (folder / "scenario.yaml").write_text(json.dumps(keys))
    write_campaign(simulate(load_settings(folder / "scenario.yaml", Scenario)), folder, folder)
    (folder / "markers.csv").write_bytes((WEBCAM / "markers.csv").read_bytes())
    lenses = {name: LENS | {"on": "tip", "identify": ["place"]} for name in cameras}
    (folder / "camera.yaml").write_text(json.dumps({"format": 1, "cameras": lenses}))
    out = folder / "proposed.yaml"
    proposed = draft(robots.URDF / "ur10.urdf", [folder / "measurements.csv"], out, leave_open)
    out.write_text(proposed.campaign.text, "utf-8")
    return proposed


def written(folder: Path, proposed: Draft) -> tuple[Outcome, ControllerExports, Path]:
    outcome = identify(proposed.campaign.path)
    handover = controller_exports(outcome)
    out = folder / "out"
    out.mkdir()
    write_controllers(outcome, handover, out)
    return outcome, handover, out


def true_place(folder: Path, camera: str) -> pin.SE3:
    truth = json.loads((folder / "truth.json").read_text())["instruments"]["camera"][camera]
    return pin.SE3(pin.rpy.rpyToMatrix(*truth["rpy"]), np.array(truth["xyz"]))


def sigmas(place: pin.SE3, truth: pin.SE3, std: np.ndarray) -> np.ndarray:
    off = truth.actInv(place)
    return np.concatenate([off.translation, pin.log3(off.rotation)]) / std


@pytest.fixture(scope="module")
def in_hand(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Draft, Outcome, ControllerExports, Path]:
    """Eight images by a camera on the flange of an arm that is as its URDF says."""
    folder = tmp_path_factory.mktemp("in_hand")
    proposed = drafted(folder, {"eye": {"on": "tip", **IN_HAND}}, 8)
    return (folder, proposed, *written(folder, proposed))


def test_eight_images_of_a_good_arm_give_the_place_within_its_sigmas(
    in_hand: tuple[Path, Draft, Outcome, ControllerExports, Path],
) -> None:
    folder, _, _, handover, _ = in_hand
    assert handover.hand_eye is not None and handover.hand_eye.arm == "nominal"
    (place,) = handover.hand_eye.places
    assert (place.name, place.parent, place.in_hand) == ("eye", "tool0", True)
    assert np.abs(sigmas(place.placement, true_place(folder, "eye"), place.std)).max() < 4.0
    position, rotation = (np.linalg.norm(part) for part in place.std.reshape(2, 3))
    assert position < 5e-4 and rotation < 2e-3
    assert re.match(r"place known to [\d.]+ mm, [\d.]+ mrad \(1 sigma\); \d+ more views", place.in_words)


def test_every_file_says_the_same_place(in_hand: tuple[Path, Draft, Outcome, ControllerExports, Path]) -> None:
    """Second road: each file read by what it is for: argparse's words, Pinocchio, xacro, YAML."""
    _, _, _, handover, out = in_hand
    assert handover.hand_eye is not None
    place = handover.hand_eye.places[0].placement
    home = out / "hand_eye"
    found = {}
    pasted = (home / "eye.txt").read_text()
    ros2 = shlex.split(next(line for line in pasted.splitlines() if "ros2 run" in line))[4:]
    found["ROS 2"] = by_words(dict(zip(ros2[::2], ros2[1::2], strict=True)))
    ros1 = shlex.split(next(line for line in pasted.splitlines() if "rosrun" in line))[3:]
    assert ros1[7:] == ["tool0", "eye_optical_frame"]
    found["ROS 1"] = placed(ros1[:3], ros1[3:7])
    launch = re.findall(r"'(--[a-z-]+)', '([^']*)'", (home / "eye.launch.py").read_text())
    compile((home / "eye.launch.py").read_text(), "eye.launch.py", "exec")
    found["MoveIt"] = by_words(dict(launch))
    for name in ("eye.easy_handeye.yaml", "eye.easy_handeye2.calib"):
        stored = yaml.safe_load((home / name).read_text())
        assert stored["parameters"]["eye_on_hand"] and stored["parameters"]["robot_effector_frame"] == "tool0"
        found[name] = placed(
            *np.split(np.array([stored["transformation"][k] for k in ["x", "y", "z", "qx", "qy", "qz", "qw"]]), [3])
        )
    document = yaml.safe_load((home / "eye.yaml").read_text())
    found["matrix"] = pin.SE3(np.array(document["matrix"]))
    found["quaternion"] = placed(document["xyz"], document["quaternion"])
    snippet = "<link" + pasted.partition("<link")[2].partition("</joint>")[0] + "</joint>"
    found["URDF"] = in_urdf(f'<robot name="r"><link name="tool0"/>{snippet}</robot>')
    macro = (home / "eye.xacro").read_text().replace("</robot>", '<link name="tool0"/><xacro:eye/></robot>')
    (home.parent / "robot.urdf.xacro").write_text(macro.replace("<robot ", '<robot name="r" ', 1))
    found["xacro"] = in_urdf(read_urdf(home.parent / "robot.urdf.xacro", URDF).decode())
    frames = yaml.safe_load((out / "frames.yaml").read_text())
    assert {"nominal", "URDF alone", "hand eye"} <= set(frames)
    for name in ("hand eye", "nominal"):
        camera = frames[name]["cameras"]["eye"]
        assert camera["on"] == "tool0"
        at = pin.SE3(pin.rpy.rpyToMatrix(*camera["rpy"]), np.array(camera["xyz"]))
        if name == "hand eye":
            found["frames.yaml"] = at
        else:  # fitted to four fifths of the images
            assert 0.0 < np.linalg.norm(place.actInv(at).translation) < 2e-3
    for name, at in found.items():
        assert np.allclose(at.homogeneous, place.homogeneous, atol=1e-8), name


def by_words(words: dict[str, str]) -> pin.SE3:
    assert (words["--frame-id"], words["--child-frame-id"]) == ("tool0", "eye_optical_frame")
    return placed([words[f"--{k}"] for k in "xyz"], [words[f"--q{k}"] for k in "xyzw"])


def placed(xyz: list, quaternion: list) -> pin.SE3:
    return pin.SE3(pin.Quaternion(np.array(quaternion, dtype=float)).matrix(), np.array(xyz, dtype=float))


def in_urdf(text: str) -> pin.SE3:
    model = pin.buildModelFromXML(text)
    return model.frames[model.getFrameId("eye_optical_frame")].placement


def test_two_cameras_beside_a_real_arm_are_told_from_some_in_its_hand_and_each_has_its_own_place(
    tmp_path: Path,
) -> None:
    """Nobody says where they stand: `camera.yaml` has them on the tip, as `detect` writes it."""
    proposed = drafted(tmp_path, {name: {"on": "world"} for name in ("left", "right")}, 25, WRONG)
    assert [camera.on for camera in proposed.campaign.instruments.cameras.values()] == ["world", "world"]
    _, handover, out = written(tmp_path, proposed)
    assert handover.hand_eye is not None and handover.hand_eye.arm == "calibrated"
    assert {path.name.partition(".")[0] for path in (out / "hand_eye").iterdir()} == {"left", "right"}
    for place in handover.hand_eye.places:
        assert (place.parent, place.in_hand) == ("base_link", False)
        assert np.abs(sigmas(place.placement, true_place(tmp_path, place.name), place.std)).max() < 4.0
        stored = yaml.safe_load((out / "hand_eye" / f"{place.name}.easy_handeye.yaml").read_text())["parameters"]
        assert not stored["eye_on_hand"] and stored["robot_base_frame"] == "base_link"


def test_images_are_answered_with_the_command_that_makes_a_table_of_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.png").write_bytes(b"x")
    for name in (tmp_path, tmp_path / "a.png"):
        words = ["--urdf", str(robots.URDF / "ur10.urdf"), "--measurements", str(name), "-o", str(tmp_path / "c.yaml")]
        assert aridcal.init.main(words) == 2
        assert f"aridcal detect {name} --joints joints.csv" in capsys.readouterr().err
    assert not (tmp_path / "c.yaml").exists()
