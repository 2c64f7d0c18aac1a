"""What is said by limb: redundancies of a torso and of a head's camera, constants without a column, tables of link parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import two_arms
import yaml
from two_arms import readings

import aridcal
from aridcal.engine.robot.chain import parse_robot, with_limbs
from aridcal.jobs.calibrate.controllers import tables
from aridcal.jobs.history.comparison import compare, lines

WAIST = (
    b'<link name="pelvis"/><link name="torso"/><joint name="waist" type="revolute"><parent link="pelvis"/>'
    b'<child link="torso"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>'
    b'<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>'
)
ON_A_WAIST = two_arms.urdf().replace(b'<link name="torso"/>', WAIST)


def calibrated(folder: Path, way: str, rows: int, **robot: object) -> aridcal.Calibration:
    """Two arms and a head on a waist that never moves."""
    machine = two_arms.machine()
    path = two_arms.write(folder, machine, (way,), readings(machine, rows), diagnosis={"enabled": False})
    (folder / "two_arms.urdf").write_bytes(ON_A_WAIST)
    document = yaml.safe_load(path.read_text())
    document["robot"] |= {"base": "pelvis"} | robot
    path.write_text(yaml.safe_dump(document))
    if "joints" not in robot:
        pd.read_csv(folder / f"{way}.csv").assign(waist=0.0).to_csv(folder / f"{way}.csv", index=False)
    return aridcal.calibrate(path)


@pytest.fixture(scope="module")
def on_a_waist(tmp_path_factory: pytest.TempPathFactory) -> tuple[aridcal.Calibration, Path]:
    """Calibrated with a tracker that sees both hands."""
    folder = tmp_path_factory.mktemp("waist")
    found = calibrated(folder, "tracker", 120)
    found.save(folder / "results")
    return found, folder


def test_the_torso_against_both_shoulders_is_named_and_is_one_motion(
    on_a_waist: tuple[aridcal.Calibration, Path],
) -> None:
    found, _ = on_a_waist
    said = [notice for notice in found.result["notices"] if "cannot be told from" in notice]
    assert len(said) == 2
    (waist,) = [notice for notice in said if notice.startswith("waist (below left_hand and right_hand)")]
    assert "cannot be told from world_base" in waist and "6 constants" in waist
    (shoulder,) = [notice for notice in said if notice.startswith("right_j1 (limb to right_hand)")]
    assert "world_base and left_j1 (limb to left_hand)" in shoulder
    assert "waist (below left_hand and right_hand) never moves" in " ".join(found.result["notices"])
    # by Pinocchio: the base moves, both shoulders move back, and no target is elsewhere
    model, base = (
        pin.buildModelFromXML(ON_A_WAIST.decode()),
        pin.exp6(np.array([0.01, -0.02, 0.005, 0.02, 0.01, -0.03])),
    )
    moved, waist_at = model.copy(), model.jointPlacements[model.getJointId("waist")]
    back = waist_at.inverse() * base.inverse() * waist_at
    for joint in ("left_j1", "right_j1"):
        k = model.getJointId(joint)
        moved.jointPlacements[k] = back * model.jointPlacements[k]
    q = np.random.default_rng(0).uniform(-1, 1, model.nq) * (np.array(list(model.names)[1:]) != "waist")
    for hand in ("left_hand", "right_hand"):
        places = []
        for each, start in ((model, pin.SE3.Identity()), (moved, base)):
            data = each.createData()
            pin.framesForwardKinematics(each, data, q)
            places.append((start * data.oMf[each.getFrameId(hand)]).homogeneous)
        np.testing.assert_allclose(places[0], places[1], rtol=0, atol=1e-12)


@pytest.fixture(scope="module")
def by_its_camera(tmp_path_factory: pytest.TempPathFactory) -> aridcal.Calibration:
    """Calibrated with the camera on the head; the waist is said to stand still."""
    return calibrated(tmp_path_factory.mktemp("camera"), "camera", 250, joints={"waist": 0.0})


def test_a_cameras_place_against_the_neck_is_named(by_its_camera: aridcal.Calibration) -> None:
    found = by_its_camera
    said = [notice for notice in found.result["notices"] if "cannot be told from eye" in notice]
    assert len(said) == 1 and said[0].startswith("nod (limb to camera) and camera_mount (limb to camera)")


def test_compare_says_which_constants_of_joints_differ(by_its_camera: aridcal.Calibration, tmp_path: Path) -> None:
    """Of a joint that never moves, and was said to stand elsewhere."""
    first, document = by_its_camera.model, yaml.safe_load(by_its_camera.model.dump())
    document["robot"]["joints"] = {"waist": 0.1}
    (tmp_path / "calibration.yaml").write_text(yaml.safe_dump(document))
    second = aridcal.load(tmp_path / "calibration.yaml").model
    (said,) = [notice for notice in compare(first, second).notices if "waist" in notice]
    assert said.startswith("waist stands at 0 rad (`robot.joints`) in the first campaign and stands at 0.1 rad")
    assert not [notice for notice in compare(first, first).notices if "waist" in notice]


def test_one_limb_has_no_such_words(tmp_path: Path) -> None:
    machine = two_arms.machine()
    path = two_arms.write(tmp_path, machine, ("tracker",), readings(machine, 120), diagnosis={"enabled": False})
    document = yaml.safe_load(path.read_text())
    del document["instruments"]
    path.write_text(yaml.safe_dump(document))
    table = pd.read_csv(tmp_path / "tracker.csv")
    own = table[table["target"] == "left"].drop(columns="target")
    own.drop(columns=[name for name in own if name.startswith("right")]).to_csv(tmp_path / "tracker.csv", index=False)
    notices = " ".join(aridcal.calibrate(path).result["notices"])
    assert "limb to" not in notices and "cannot be told from" not in notices


def tracked(folder: Path, seed: int, slipped: str = "") -> aridcal.Calibration:
    """Two arms seen by a tracker, perhaps after a zero has moved by 2 mrad."""
    machine = replace(two_arms.machine(), slipped=(slipped, 2e-3) if slipped else None)
    q = readings(machine, 110, seed)
    return aridcal.calibrate(two_arms.write(folder, machine, ("tracker",), q, seed, diagnosis={"enabled": False}))


def test_compare_sees_a_zero_that_moved_on_the_limb_that_is_not_on_the_default_path(tmp_path: Path) -> None:
    first = tracked(tmp_path / "before", 1).model
    assert not compare(first, tracked(tmp_path / "same", 2).model).changed
    found = compare(first, tracked(tmp_path / "moved", 3, "right_j3").model)
    (cause,) = found.causes.changes
    assert any(line.startswith(f"changed: {cause.words} by +") for line in lines(found))
    assert cause.words == "the zero of right_j3 (limb to right_hand)"
    np.testing.assert_allclose(cause.value, 2e-3, rtol=0, atol=4 * float(cause.std[0]))


def along(name: str, value: float) -> pin.SE3:
    """Rz, Rx, Tx or Tz."""
    axis = np.eye(3)["xyz".index(name[1])]
    return pin.SE3(np.eye(3), value * axis) if name[0] == "T" else pin.SE3(pin.exp3(value * axis), np.zeros(3))


def test_tables_of_each_limb_have_its_link_where_the_calibrated_urdf_has_it(
    on_a_waist: tuple[aridcal.Calibration, Path],
) -> None:
    _, folder = on_a_waist
    document = yaml.safe_load((folder / "results" / "dh.yaml").read_text())["limbs"]
    doty = yaml.safe_load((folder / "results" / "doty.yaml").read_text())["limbs"]
    makers = yaml.safe_load((folder / "results" / "kinematics.yaml").read_text())["limbs"]
    assert list(document) == list(doty) == list(makers) == ["left_hand", "right_hand"]
    model = pin.buildModelFromXML((folder / "results" / "calibrated.urdf").read_text())
    data, q = model.createData(), np.random.default_rng(1).uniform(-1, 1, model.nq)
    pin.framesForwardKinematics(model, data, q)
    at = dict(zip(list(model.names)[1:], q.tolist(), strict=True))

    def frame(part: dict) -> pin.SE3:
        return pin.SE3(pin.rpy.rpyToMatrix(np.array(part["rpy"])), np.array(part["xyz"]))

    for hand, table in document.items():
        T = frame(table["base"])
        for row in table["rows"]:
            T = T * along("Rz", row["theta"] + at[row["joint"]]) * along("Tz", row["d"])
            T = T * along("Tx", row["a"]) * along("Rx", row["alpha"])
        expected = data.oMf[model.getFrameId(hand)].homogeneous
        np.testing.assert_allclose((T * frame(table["tool"])).homogeneous, expected, rtol=0, atol=1e-6)
        assert [row["joint"] for row in doty[hand]["rows"]] == [row["joint"] for row in table["rows"]]


def test_limbs_that_have_no_table_are_named() -> None:
    robot = with_limbs(parse_robot(two_arms.urdf(), "left_hand", "left_4"), ["right_hand"])
    table = tables(robot, robot)["doty.yaml"]
    assert list(yaml.safe_load(table.text)["limbs"]) == ["left_hand"]
    assert any("Of right_hand none: the way from left_4 climbs" in note for note in table.notes)
    assert robot.limbs_of("left_j6") == ("left_hand",) and robot.limbs_of("left_mount") == ("left_hand",)
    robot = with_limbs(parse_robot(two_arms.urdf(), "left_hand", "head"), ["camera"])
    table = tables(robot, robot)["dh.yaml"]
    assert yaml.safe_load(table.text) == {"limbs": {}}
    assert any("Of camera none: no joint moves between it and head" in note for note in table.notes)
