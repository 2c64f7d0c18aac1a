"""What controllers are given, and the error that each says it leaves."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
import yaml

from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import parse_robot
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.controllers import ControllerExports, controller_exports, write_controllers
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.pages.report.limits_section import use

NAMES = ("nominal", "joint offsets alone", "URDF alone", "+ joint maps", "full model")


def calibrated(folder: Path, effects: list[dict], parameters: dict, n: int = 150, noise: float = 2e-5) -> Outcome:
    """Simulate a UR10 and identify it with its effects declared."""
    keys = {
        "format": 1,
        "robot": {"urdf": str(robots.URDF / "ur10.urdf"), "base": "base_link", "tip": "tool0"},
        "effects": [{k: v for k, v in e.items() if k != "coefficients"} for e in effects],
        "diagnosis": {"enabled": False},
        "truth": {
            "n": n, "seed": 5, "parameters": parameters, "effects": effects,
            "noise": {"position": noise, "rotation": noise},
        },
    }  # fmt: skip
    (folder / "scenario.yaml").write_text(json.dumps(keys))  # JSON is YAML, and has no aliases
    write_campaign(simulate(load_settings(folder / "scenario.yaml", Scenario)), folder, folder)
    return identify(folder / "campaign.yaml")


@pytest.fixture(scope="module")
def wavy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, ControllerExports, Path]:
    """Wrong constants, a wavy elbow and a shoulder that sags."""
    folder = tmp_path_factory.mktemp("wavy")
    effects = [
        {"kind": "joint_harmonic", "where": "elbow_joint", "order": [2, 101], "coefficients": [3e-4, 5e-4, 2e-4, 1e-4]},
        {"kind": "joint_compliance", "where": "shoulder_lift_joint", "coefficients": 6e-6},
    ]
    wrong = {
        f"{j}.{c}": {"std": 1e-3} for j in ("elbow_joint", "wrist_2_joint") for c in ("x", "y", "roll", "pitch", "yaw")
    }
    outcome = calibrated(folder, effects, wrong)
    handover = controller_exports(outcome)
    (folder / "out").mkdir()
    write_controllers(outcome, handover, folder / "out")
    return outcome, handover, folder / "out"


def scored(outcome: Outcome) -> np.ndarray:
    return outcome.parts()["test"]


def test_the_more_a_controller_takes_the_less_is_left(wavy: tuple[Outcome, ControllerExports, Path]) -> None:
    _, handover, _ = wavy
    assert tuple(e.name for e in handover.exports) == NAMES
    left = [e.error for e in handover.exports]
    assert left == sorted(left, reverse=True)
    assert handover.exports[-1].apart == 0.0
    text = f"nominal {1e3 * left[0]:.3f} mm, joint offsets alone {1e3 * left[1]:.3f}, URDF alone {1e3 * left[2]:.3f}, "
    assert handover.summary().startswith(text)


def test_every_export_has_the_error_that_it_states(wavy: tuple[Outcome, ControllerExports, Path]) -> None:
    """Second road: the files alone, read back and multiplied out, against the measured rows."""
    outcome, handover, folder = wavy
    m, test = outcome.measurements, scored(outcome)
    error = {e.name: e.error for e in handover.exports}
    frames = yaml.safe_load((folder / "frames.yaml").read_text())

    def rms(urdf: bytes, q: np.ndarray, name: str) -> float:
        robot = parse_robot(urdf, "tool0", "base_link")
        world, tip = (
            ((None, pin.SE3(pin.rpy.rpyToMatrix(*f["rpy"]), np.array(f["xyz"]))),)
            for f in (frames[name]["world_base"], frames[name]["tip_target"])
        )
        model = Model(robot, (), world, tip)
        _, p = model.poses(np.zeros(0), model.rows(q))
        return float(np.sqrt(np.mean(np.sum((m.position[test] - p) ** 2, axis=1))))

    assert rms(outcome.robot.urdf, m.readings[test], "nominal") == pytest.approx(error["nominal"], rel=1e-6)
    zeros = yaml.safe_load((folder / "joint_offsets.yaml").read_text())["joint_offsets"]
    q = m.readings[test] + [zeros.get(name, 0.0) for name in outcome.robot.readings]
    assert rms(outcome.robot.urdf, q, "joint offsets alone") == pytest.approx(error["joint offsets alone"], rel=1e-6)
    calibrated = handover.calibrated.urdf
    assert rms(calibrated, m.readings[test], "URDF alone") == pytest.approx(error["URDF alone"], rel=1e-6)

    maps = pd.read_csv(folder / "joint_maps.csv")
    assert set(maps["joint"]) == {"elbow_joint"}
    q = m.readings[test].copy()
    q[:, 2] += np.interp(q[:, 2], maps["reading"], maps["correction"])
    mapped = (folder / "joint_maps.urdf").read_bytes()
    assert rms(mapped, q, "+ joint maps") == pytest.approx(error["+ joint maps"], rel=1e-3)


def test_comments_state_the_error(wavy: tuple[Outcome, ControllerExports, Path]) -> None:
    _, handover, folder = wavy
    names = {"kinematics.yaml", "dh.yaml", "dh_modified.yaml", "doty.yaml", "joint_offsets.yaml"}
    assert {f.name for f in folder.iterdir()} == names | {"joint_maps.csv", "joint_maps.urdf", "frames.yaml"}
    for name in names:
        first = (folder / name).read_text().splitlines()[0]
        own = handover.exports[1 if name == "joint_offsets.yaml" else 2]
        found = re.match(r"# (.+): ([\d.]+) mm RMS position error on (\d+) held-out rows, ([\d.]+) mm from", first)
        assert found is not None, first
        assert found[1] == own.name
        assert float(found[2]) == pytest.approx(1e3 * own.error, abs=6e-4)
        assert float(found[4]) == pytest.approx(1e3 * own.apart, abs=6e-4)
        assert yaml.safe_load((folder / name).read_text())


def test_tables_warn_of_axes_that_are_nearly_parallel(wavy: tuple[Outcome, ControllerExports, Path]) -> None:
    _, _, folder = wavy
    for name in ("dh.yaml", "dh_modified.yaml"):
        text = (folder / name).read_text()
        warned = re.findall(r"# WARNING: the axes of (\w+) and (\w+) are nearly parallel", text)
        assert set(warned) == {("shoulder_lift_joint", "elbow_joint"), ("elbow_joint", "wrist_1_joint")}
    for name in ("kinematics.yaml", "doty.yaml", "joint_offsets.yaml"):
        assert "WARNING" not in (folder / name).read_text()
    for text in ((folder / name).read_text() for name in ("kinematics.yaml", "doty.yaml")):
        numbers = [abs(float(v)) for v in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", text)]
        assert max(numbers) < 10.0  # no kilometres


def test_joint_zeros_that_are_the_only_fault_are_found_by_the_offsets_alone(tmp_path: Path) -> None:
    offsets = {"shoulder_lift_joint": 1e-3, "elbow_joint": -2e-3, "wrist_1_joint": 5e-4, "wrist_2_joint": 1.5e-3}
    robot = robots.ur10()
    axes = {j.name: ("roll", "pitch", "yaw")[int(np.argmax(np.abs(j.axis)))] for j in robot.joints}
    outcome = calibrated(tmp_path, [], {f"{j}.{axes[j]}": v for j, v in offsets.items()})
    handover = controller_exports(outcome)
    assert handover.offsets == pytest.approx(offsets, abs=5e-5)
    left = {e.name: e.error for e in handover.exports}
    assert left["joint offsets alone"] < 1.2 * left["full model"] < left["nominal"] / 10
    assert handover.with_maps is None and not handover.maps


def test_the_report_states_the_error_of_each_export(wavy: tuple[Outcome, ControllerExports, Path]) -> None:
    outcome, handover, _ = wavy
    text = "".join(map(str, use(outcome, handover)))
    for export in handover.exports:
        row = re.search(rf"<th[^>]*>{re.escape(export.name)}</th>.*?</tr>", text, re.DOTALL)
        assert row is not None
        assert all(name in row[0] for name in export.files)
        assert float(re.findall(r">([\d.]+) mm<", row[0])[0]) == pytest.approx(1e3 * export.error, rel=0.01)
