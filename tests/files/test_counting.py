"""Tables that count joints or hold poses otherwise than the URDF: one key says so, and everything is as without it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import robots
import yaml
from misread import XYZ, Q, Spoil, counted, inverted, machine

import aridcal
import aridcal.identify
import aridcal.init
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.files.counting import counting
from aridcal.files.read import load_measurements
from aridcal.jobs.calibrate.tolerance_region import corners
from aridcal.jobs.plan.pose_design import joint_table
from aridcal.system.errors import CampaignError

ROWS = 50
"""To calibrate with; the rest are new rows."""

ELBOW, LIFT = "elbow_joint", "shoulder_lift_joint"

SPOILT: dict[str, tuple[Spoil, dict[str, Any]]] = {
    "a sign and a zero": (counted(-1.0, -0.5 * np.pi, ELBOW), {"joints": {ELBOW: {"zero": "-90deg", "sign": -1}}}),
    "poses": (inverted(True), {"inverted": "pose"}),
    "orientations": (inverted(False), {"inverted": "orientation"}),
}


@pytest.fixture(scope="module")
def truth() -> robots.Truth:
    return machine(robots.ur10(), 0.4, n=70)


def written(folder: Path, truth: robots.Truth, table: pd.DataFrame, keys: dict[str, Any], **sections: Any) -> Path:
    folder.mkdir(exist_ok=True)
    measurements = {"file": "measurements.csv", "kind": "pose"} | keys
    return robots.write_campaign(folder, truth, table, measurements=measurements, **sections)


@pytest.fixture(scope="module")
def plain(truth: robots.Truth, tmp_path_factory: pytest.TempPathFactory) -> aridcal.Calibration:
    folder = tmp_path_factory.mktemp("plain")
    return aridcal.calibrate(written(folder, truth, robots.table(truth)[:ROWS], {}))


def same_pose(found: pd.DataFrame, expected: pd.DataFrame) -> None:
    """Of poses, or of joints; quaternions but for their sign."""
    found, expected = (
        t.assign(**{n: t[n] * np.sign(t["qw"]) for n in Q}) if "qw" in t else t for t in (found, expected)
    )
    np.testing.assert_allclose(found[list(expected)], expected, atol=1e-8)


@pytest.mark.parametrize("name", SPOILT)
def test_the_key_is_named_first_and_with_it_nothing_differs(
    name: str, truth: robots.Truth, plain: aridcal.Calibration, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, keys = SPOILT[name]
    table = robots.table(truth)
    spoilt = spoil(table)
    assert aridcal.identify.main([str(written(tmp_path / "without", truth, spoilt[:ROWS], {}))]) == 2
    remedy = " ".join(capsys.readouterr().err.split()).partition("Write under measurements `")[2].partition("`")[0]
    assert yaml.safe_load(remedy) == keys

    path = written(tmp_path / "with", truth, spoilt[:ROWS], yaml.safe_load(remedy))
    found = aridcal.calibrate(path)
    joints = list(truth.model.robot.readings)
    poses, new = plain.predict(table[joints]), plain.check(table[ROWS:])
    commands = plain.compensate(table[XYZ + Q][ROWS:], seed=table[joints][ROWS:])
    # the same constants, and the same after a way over the file
    for made in (found, kept(found, tmp_path / "calibration.yaml")):
        assert made.model.final.model.names == plain.model.final.model.names
        np.testing.assert_allclose(made.model.final.theta, plain.model.final.theta, atol=1e-8)
        # both roads: predictions spoilt by hand are those that come of spoilt rows
        same_pose(made.predict(spoilt[joints]), spoil(pd.concat([table[joints], poses[XYZ + Q]], axis=1)))
        also = made.check(spoilt[ROWS:])
        assert (also.good, also.lines) == (new.good, new.lines)
        back = made.compensate(spoilt[XYZ + Q][ROWS:], seed=spoilt[joints][ROWS:])
        same_pose(back[joints], spoil(commands[joints + XYZ + Q])[joints])


@pytest.mark.parametrize("name", ["poses", "a sign and a zero"])
def test_init_finds_the_units_all_the_same_and_writes_the_key_once_it_is_chosen(
    name: str, truth: robots.Truth, tmp_path: Path
) -> None:
    spoil, keys = SPOILT[name]
    table = spoil(robots.table(truth))
    joints = list(truth.model.robot.readings)
    table[joints] = np.degrees(table[joints])
    table[XYZ] = 1e3 * table[XYZ]
    (tmp_path / "robot.urdf").write_bytes(truth.model.robot.urdf)
    table.to_csv(tmp_path / "m.csv", index=False)
    path = tmp_path / "campaign.yaml"
    asked = ["--urdf", str(tmp_path / "robot.urdf"), "--measurements", str(tmp_path / "m.csv"), "-o", str(path)]
    assert aridcal.init.main([*asked, "--set", "reading=1"]) == 0
    said = yaml.safe_load(path.read_text())["measurements"]
    assert said["units"] == {"angle": "deg", "length": "mm"}
    assert "orientation" not in said and "columns" not in said
    assert {key: said[key] for key in keys} == keys


def kept(calibration: aridcal.Calibration, path: Path) -> aridcal.Calibration:
    path.write_text(calibration.model.dump(), encoding="utf-8")
    return aridcal.load(path)


def test_cells_come_back_from_readings_in_every_unit(truth: robots.Truth, tmp_path: Path) -> None:
    robot, q = truth.model.robot, truth.readings
    keys = {"units": {"angle": "deg"}, "joints": {ELBOW: {"sign": -1, "zero": "0.5 rad"}, LIFT: {"zero": "-90deg"}}}
    table = robots.table(truth)
    cells = np.degrees(q)
    cells[:, robot.readings.index(ELBOW)] = np.degrees(0.5 - q[:, robot.readings.index(ELBOW)])
    cells[:, robot.readings.index(LIFT)] -= 90.0
    table = table.assign(**dict(zip(robot.readings, cells.T, strict=True)), elbow_joint_direction=np.sign(q[:, 0]))
    region = {"joints": {ELBOW: [-20.0, 30.0]}}
    campaign = load_campaign(written(tmp_path, truth, table, keys, region=region))
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds)
    order = rows.origin.line - 2
    np.testing.assert_allclose(rows.readings, q[order], atol=1e-14)
    # the side from which a joint came is told as its column counts
    assert np.array_equal(rows.covariates["elbow_joint_direction"], -np.sign(q[order, 0]))
    np.testing.assert_allclose(joint_table(q, robot, campaign.measurements), cells, atol=1e-12)
    own = counting(campaign.measurements, robot.readings, robot.kinds)
    steps = own.cells(q + 1e-3) - own.cells(q)
    np.testing.assert_allclose(own.steps(np.full_like(q, 1e-3)), steps, atol=1e-10)
    low, high = corners(campaign, robot, *robot.limits.T)
    k = robot.readings.index(ELBOW)
    np.testing.assert_allclose([low[k], high[k]], 0.5 - np.radians([30.0, -20.0]))


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"joints": {ELBOW: {"sign": 2}}}, f"measurements.joints.{ELBOW}.sign"),
    ({"joints": {ELBOW: {"sign": True}}}, f"measurements.joints.{ELBOW}.sign"),
    ({"joints": {ELBOW: {"zero": 90}}}, f"measurements.joints.{ELBOW}.zero: should be a number with its unit"),
    ({"joints": {ELBOW: {"zero": "a quarter"}}}, f"measurements.joints.{ELBOW}.zero: should be a number with its unit"),
    ({"joints": {ELBOW: {"zero": "1e12deg"}}}, f"measurements.joints.{ELBOW}.zero: should be a number with its unit"),
    ({"joints": {ELBOW: {"zero": "90mm"}}}, f"measurements.joints.{ELBOW}.zero: 90mm, but this joint turns"),
    ({"joints": {ELBOW: {"zeros": "90deg"}}}, f"measurements.joints.{ELBOW}.zeros"),
    ({"joints": {"elbow": {"sign": -1}}}, "measurements.joints: no joint 'elbow' on the chain (did you mean 'elbow_joint'?)"),
    ({"inverted": True}, "measurements.inverted"),
    ({"inverted": "pose", "kind": "position"}, "inverted: belongs to `kind: pose`"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "why"), WRONG)
def test_wrong_values_are_refused_by_name(keys: dict[str, Any], why: str, truth: robots.Truth, tmp_path: Path) -> None:
    path = written(tmp_path, truth, robots.table(truth), keys)
    with pytest.raises(CampaignError) as caught:
        nominal_robot(load_campaign(path))
    assert why in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("keys", "columns"), [("pose", "std_x")])
def test_sigmas_of_inverted_poses_are_refused_until_they_are_ignored(
    keys: str, columns: str, truth: robots.Truth, tmp_path: Path
) -> None:
    sigmas = dict.fromkeys(["std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz"], 1e-4)
    table = inverted(keys == "pose")(robots.table(truth)).assign(**sigmas)
    path = written(tmp_path, truth, table, {"inverted": keys})
    with pytest.raises(CampaignError, match=rf"measurements.inverted: .*{columns} .*`noise: {{rows: ignore}}`"):
        aridcal.calibrate(path)
    path = written(tmp_path, truth, table, {})
    with pytest.raises(aridcal.AridcalError, match=re.escape(f"`inverted: {keys}` and `noise: {{rows: ignore}}`")):
        aridcal.calibrate(path)


SWAPPED = {"urdf": "robot.urdf", "base": "tool0", "tip": "base_link"}


def test_rows_of_the_tip_in_the_base_are_told_from_those_of_the_base_in_the_tip(
    truth: robots.Truth, tmp_path: Path
) -> None:
    path = written(tmp_path, truth, robots.table(truth), {}, robot=SWAPPED)
    with pytest.raises(aridcal.AridcalError, match=r"`inverted: pose`, or exchange `robot.base` and `robot.tip`"):
        aridcal.calibrate(path)


def test_with_base_and_tip_exchanged_the_same_rows_predict_the_same(truth: robots.Truth, tmp_path: Path) -> None:
    """Rows without noise: each pose of the tip in the base read as one of the base in the tip, another path."""
    robot = truth.model.robot
    R, p = truth.model.poses(truth.theta, truth.model.rows(truth.readings))
    exact = replace(truth, measured=robots.measured(robot, truth.readings, p, R))
    table, joints = robots.table(exact), list(robot.readings)
    noise = {"noise": {"position": 1e-4, "rotation": 1e-4}}
    for keys, more in (({}, {}), ({"inverted": "pose"}, {"robot": SWAPPED})):
        path = written(tmp_path / str(len(keys)), exact, table[:ROWS], noise | keys, **more)
        found = aridcal.calibrate(path)
        for made in (found, kept(found, tmp_path / "calibration.yaml")):
            same_pose(made.predict(table[joints]), table[XYZ + Q])
