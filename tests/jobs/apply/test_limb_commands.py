"""Commands for one limb of several: its joints move, those of the others stay."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import two_arms
from two_arms import readings

import aridcal
import aridcal.compensate
from aridcal.engine.fit.constants import urdf_of

POSE = ["x", "y", "z", "qx", "qy", "qz", "qw"]
ENDS = {"left_hand": "left", "right_hand": "right", "right_6": "right"}


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> tuple[two_arms.Machine, aridcal.Calibration, Path]:
    """Both hands calibrated with a tracker, the left shoulder yielding; read back from its file."""
    folder, robot = tmp_path_factory.mktemp("tracked"), two_arms.machine(2, yields=2e-4)
    effects = [{"kind": "joint_compliance", "where": "left_j2"}]
    keys: dict[str, Any] = {"effects": effects, "diagnosis": {"enabled": False}}
    found = aridcal.calibrate(two_arms.write(folder, robot, ("tracker",), readings(robot, 160), **keys))
    assert list(found.effects["kind"]) == ["joint_compliance"]
    (folder / "calibration.yaml").write_text(found.model.dump(), encoding="utf-8")
    return robot, aridcal.load(folder / "calibration.yaml"), folder


def bent(robot: two_arms.Machine, seed: int) -> np.ndarray:
    """Rows with elbows and wrists away from their singularities, where the nominal robot may reach further than the real one."""
    q = readings(robot, 10, seed) * 0.7
    hinges = [name.endswith(("j3", "j5")) for name in robot.joints]
    q[:, hinges] = 0.4 + np.abs(q[:, hinges]) / 2
    return q


def wanted(found: aridcal.Calibration, q: np.ndarray, link: str) -> pd.DataFrame:
    """Where the nominal robot has a link, in the world: by Pinocchio, and the base as calibrated."""
    world = found.model.expected.model.frames(found.model.expected.theta)[0][0][1]
    nominal = two_arms.Machine(pin.buildModelFromXML(two_arms.urdf().decode()))
    places = [world * T for T in nominal.seen(q, "torso", link)]
    rows = [[*T.translation, *pin.Quaternion(T.rotation).coeffs()] for T in places]
    return pd.DataFrame(rows, columns=POSE)


@pytest.mark.parametrize("link", ENDS)
def test_the_written_urdf_has_the_link_where_the_nominal_robot_would_and_the_others_stay(
    link: str, tracked: tuple[two_arms.Machine, aridcal.Calibration, Path]
) -> None:
    robot, found, _ = tracked
    geometric = found.model.geometric
    asked = replace(found, model=replace(found.model, final=geometric, rivals=()))  # what the URDF holds
    joints = list(geometric.model.robot.readings)
    q = bent(robot, 3)[:, [robot.joints.index(name) for name in joints]]
    every = np.zeros((len(q), len(robot.joints)))
    every[:, [robot.joints.index(name) for name in joints]] = q
    poses = wanted(asked, every, link)
    told = asked.compensate(poses, seed=pd.DataFrame(q, columns=joints), of=link)
    assert told["reached"].all()
    own = np.array([name.startswith(ENDS[link]) for name in joints])
    got = told[joints].to_numpy(float)
    np.testing.assert_array_equal(got[:, ~own], q[:, ~own])
    assert np.abs(got - q)[:, own].max() > 1e-4
    written = two_arms.Machine(pin.buildModelFromXML(urdf_of(geometric.model, geometric.theta).decode()))
    every[:, [robot.joints.index(name) for name in joints]] = got
    world = geometric.model.frames(geometric.theta)[0][0][1]
    there = np.array([(world * T).translation for T in written.seen(every, "torso", link)])
    off = np.linalg.norm(there - poses[["x", "y", "z"]].to_numpy(), axis=1)
    assert off.max() < 1e-7  # where the search ends
    np.testing.assert_allclose(told["position_error"].to_numpy(float), off, rtol=0, atol=1e-9)


def test_effects_are_counted_and_joints_without_a_column_get_none(
    tracked: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path
) -> None:
    robot, found, folder = tracked
    q = bent(robot, 5)
    poses, table = wanted(found, q, "left_hand"), robot.table(q)
    left = [name for name in robot.joints if name.startswith("left")]
    pd.concat([poses, table[left]], axis=1).to_csv(tmp_path / "poses.csv", index=False)
    out = tmp_path / "joints.csv"
    asked = [str(folder / "calibration.yaml"), str(tmp_path / "poses.csv"), "--of", "left_hand", "-o", str(out)]
    assert aridcal.compensate.main(asked) == 0
    told = pd.read_csv(out)
    assert told["reached"].all() and not any(name.startswith("right") for name in told)
    right = [name for name in robot.joints if name.startswith("right")]
    again = found.predict(pd.concat([told[left], table[right]], axis=1), of="left_hand")
    np.testing.assert_allclose(again[POSE[:3]].to_numpy(float), poses[POSE[:3]], rtol=0, atol=1e-6)
    plain = replace(found, model=replace(found.model, final=found.model.geometric, rivals=()))
    off = plain.predict(pd.concat([told[left], table[right]], axis=1), of="left_hand")[POSE[:3]].to_numpy(float)
    assert np.linalg.norm(off - poses[POSE[:3]].to_numpy(), axis=1).max() > 1e-4  # the shoulder gives way


def test_rows_without_starting_values_leave_the_other_limb_alone(
    tracked: tuple[two_arms.Machine, aridcal.Calibration, Path],
) -> None:
    """The search over the calibrated ranges moves the joints on the way to the link, and no others."""
    robot, found, _ = tracked
    q = bent(robot, 6)
    right = [name for name in robot.joints if name.startswith("right")]
    poses = wanted(found, q, "left_hand").assign(**{name: robot.table(q)[name] for name in right})
    told = found.compensate(poses, of="left_hand")
    assert told["reached"].mean() > 0.8
    np.testing.assert_allclose(told[right].to_numpy(float), poses[right].to_numpy(float), rtol=0, atol=1e-12)


def test_a_grid_of_one_limb_has_its_joints_alone(
    tracked: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path
) -> None:
    _, _, folder = tracked
    asked = [str(folder / "calibration.yaml"), "--of", "right_2", "--grid", "3", "-o", str(tmp_path / "grid.csv")]
    assert aridcal.compensate.main(asked) == 0
    table = pd.read_csv(tmp_path / "grid.csv")
    assert list(table) == ["right_j1", "right_j2", "delta_right_j1", "delta_right_j2"] and len(table) == 9


@pytest.mark.parametrize("link", ["left_hand", "right_hand"])
def test_a_program_of_one_limb_is_corrected_by_that_limb(
    link: str, tracked: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path
) -> None:
    """The left shoulder yields: where the corrected joints lead is asked of the whole calibration, effects included."""
    robot, found, folder = tracked
    q = bent(robot, 4)
    own = [name.startswith(ENDS[link]) for name in robot.joints]
    lines = [f"movej([{', '.join(f'{value:.9f}' for value in row)}])" for row in q[:, own]]
    (tmp_path / "arm.script").write_text("def arm():\n  " + "\n  ".join(lines) + "\nend\n")
    out = tmp_path / "out.script"
    start = ",".join(f"{value:.9f}" for value in q[0, own])
    command = [str(folder / "calibration.yaml"), str(tmp_path / "arm.script"), "-o", str(out), "--start", start]
    assert aridcal.compensate.main([*command, "--of", link, "--quiet"]) == 0
    read = re.findall(r"movej\(\[([^]]*)\]", out.read_text())
    new = q.copy()
    new[:, own] = [[float(cell) for cell in row.split(",")] for row in read]
    assert np.abs(new - q).max() > 1e-4
    columns = [name for name in robot.joints if name.startswith(("left", "right"))]
    table = robot.table(new)[columns]
    reached = found.predict(table, of=link)[POSE[:3]].to_numpy(float)
    np.testing.assert_allclose(reached, wanted(found, q, link)[POSE[:3]].to_numpy(float), rtol=0, atol=2e-6)


def test_a_program_of_a_limb_that_is_none_is_refused(
    tracked: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "p.script").write_text("movej([0,0,0,0,0,0])\n")
    command = [str(tracked[2] / "calibration.yaml"), str(tmp_path / "p.script"), "-o", str(tmp_path / "out.script")]
    for more, why in (
        ([], "name its end with --of LINK"),
        (["--of", "left_3"], "no limb of the calibration ends at 'left_3'"),
    ):
        assert aridcal.compensate.main([*command, *more]) == 2
        assert why in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out.script").exists()
