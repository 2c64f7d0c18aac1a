"""Joints without a column: those that stand still and those that follow several others (`robot.joints`, `robot.coupled`)."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots
import yaml

from aridcal import compensate, identify, predict
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.catalogue import EFFECT_KINDS, candidates
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.loads import Surroundings, covariate_table
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.engine.robot.drive import StatedJoints
from aridcal.engine.robot.kinematics import carried_bodies, tip_frames, tree_frames
from aridcal.jobs.calibrate import pipeline
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.maintain.new_rows import read_new_rows
from aridcal.system.errors import AridcalError

WAIST, KNUCKLE = "joint_2", "joint_5"
STANDS = 0.4
FACTORS = {"joint_4": 0.5, "branch_joint": -0.7}
STATED = StatedJoints({WAIST: STANDS}, {KNUCKLE: FACTORS})
"""Of a chain of seven joints: the second stands still, the fifth follows the fourth and a joint of a side branch."""

URDF = robots.random_chain(np.random.default_rng(4), "RRRRRRR")


def arm(stated: StatedJoints = STATED) -> Robot:
    return parse_robot(URDF, "tip", stated=stated)


def mimicking(master: str, how: str = "") -> bytes:
    """The same where the sixth joint has a ``<mimic>``."""
    joint = '<joint name="joint_6" type="revolute">'
    return URDF.replace(joint.encode(), f'{joint}<mimic joint="{master}" {how}/>'.encode())


def everywhere(robot: Robot, readings: np.ndarray) -> dict[str, np.ndarray]:
    """Positions of all joints of the tree, (N,) each, by hand."""
    at = dict(zip(robot.readings, readings.T, strict=True))
    at[WAIST] = np.full(len(readings), STANDS)
    at[KNUCKLE] = 0.5 * at["joint_4"] - 0.7 * at["branch_joint"]
    return at


def pinocchio(robot: Robot, at: Mapping[str, np.ndarray], k: int) -> list[pin.SE3]:
    """Every joint of the tree, and the tip, in its root, for one row."""
    model, q = robot.tree, pin.neutral(robot.tree)
    data = model.createData()
    for name, values in at.items():
        q[model.joints[model.getJointId(name)].idx_q] = values[k]
    pin.framesForwardKinematics(model, data, q)
    return [*(data.oMi[i] for i in range(1, model.njoints)), data.oMf[model.getFrameId("tip")]]


def test_the_whole_tree_is_where_pinocchio_has_it() -> None:
    robot = arm()
    assert robot.readings == ("joint_1", "joint_3", "joint_4", "branch_joint", "joint_6", "joint_7")
    q = robots.readings(robot, 5, np.random.default_rng(0))
    at = everywhere(robot, q)
    np.testing.assert_allclose(robot.positions(q), np.column_stack([at[name] for name in robot.names]), atol=1e-15)
    (_, *walked), (R, p) = tree_frames(robot, q), tip_frames(robot, q)
    for k in range(len(q)):
        *joints, tip = pinocchio(robot, at, k)
        for step, joint in zip(walked, joints, strict=True):
            np.testing.assert_allclose(step.axes[k], joint.rotation, atol=1e-12)
            np.testing.assert_allclose(step.origin[k], joint.translation, atol=1e-12)
        np.testing.assert_allclose(R[k], tip.rotation, atol=1e-12)
        np.testing.assert_allclose(p[k], tip.translation, atol=1e-12)


def test_a_base_above_a_joint_that_stands_still_sees_the_tree_as_pinocchio_does() -> None:
    robot = parse_robot(URDF, "tip", "link_3", stated=StatedJoints({WAIST: STANDS, "branch_joint": 0.3}))
    q = robots.readings(robot, 3, np.random.default_rng(1))
    at = dict(zip(robot.readings, q.T, strict=True)) | {WAIST: np.full(3, STANDS), "branch_joint": np.full(3, 0.3)}
    _, *walked = tree_frames(robot, q)
    for k in range(len(q)):
        joints = pinocchio(robot, at, k)
        base = joints[robot.tree.getJointId("joint_3") - 1]
        for step, joint in zip(walked, joints, strict=False):
            expected = base.actInv(joint)
            np.testing.assert_allclose(step.axes[k], expected.rotation, atol=1e-12)
            np.testing.assert_allclose(step.origin[k], expected.translation, atol=1e-12)


def test_jacobian_by_readings_is_that_of_differences_for_many_rows_and_for_one() -> None:
    robot = arm()
    model = Model(robot, (Coefficient(WAIST, "axis"), Coefficient(KNUCKLE, "r1")))
    theta, q = np.array([0.01, -0.02]), robots.readings(robot, 4, np.random.default_rng(2), 0.8)
    _, _, J = model.by_readings(theta, model.rows(q))
    one, step = OneRowModel(model, theta), 1e-6
    for j, shift in enumerate(step * np.eye(len(robot.readings))):
        (R1, p1), (R0, p0) = (model.poses(theta, model.rows(q + s)) for s in (shift, -shift))
        turns = [pin.log3(a @ b.T) for a, b in zip(R1, R0, strict=True)]
        expected = np.hstack([p1 - p0, turns]) / (2 * step)
        np.testing.assert_allclose(J[:, :, j], expected, atol=1e-8)
        for k, row in enumerate(q):
            np.testing.assert_allclose(one.jacobian(row, one.effects(row, {}))[2][:, j], expected[k], atol=1e-8)


def test_loads_are_those_of_a_table_that_has_the_columns() -> None:
    robot, plain = arm(StatedJoints({WAIST: STANDS}, {KNUCKLE: {"joint_4": 0.5, "joint_3": -0.7}})), arm(StatedJoints())
    q = robots.readings(robot, 6, np.random.default_rng(3))
    around, world, wanted = Surroundings(np.array([1.0, -2.0, -9.0])), np.zeros(6, dtype=int), f"{WAIST}.gravity_torque"
    found = covariate_table(robot, q, {}, around, world, {wanted})
    expected = covariate_table(plain, robot.positions(q), {}, around, world, {wanted})
    assert found.keys() == expected.keys() and wanted in found
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=1e-12)
    gives_way = Coefficient(WAIST, "axis", Basis("linear", (wanted,), (0.0,)))
    model, theta = Model(robot, (gives_way,), around=around), np.array([1e-3])
    one, (_, p) = OneRowModel(model, theta), model.poses(theta, model.rows(q))
    for k, row in enumerate(q):
        np.testing.assert_allclose(one.pose(row, one.effects(row, {}))[1], p[k], atol=1e-12)


def test_inertia_carried_by_a_joint_is_that_of_the_branch_where_it_stands() -> None:
    robot = arm(StatedJoints({"branch_joint": 1.0}))
    model, q = robot.tree, pin.neutral(robot.tree)
    q[model.joints[model.getJointId("branch_joint")].idx_q] = 1.0
    k = model.getJointId("joint_1")
    branch = model.getJointId("branch_joint")
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    expected = model.inertias[k] + data.liMi[branch].act(model.inertias[branch])
    np.testing.assert_allclose(carried_bodies(robot)["joint_1"].matrix(), expected.matrix(), atol=1e-12)


def test_nothing_is_offered_that_goes_with_the_reading_of_a_joint_that_stands_still() -> None:
    robot = arm()
    q = robots.readings(robot, 30, np.random.default_rng(5))
    table = covariate_table(robot, q, {}, Surroundings(), np.zeros(30, dtype=int), {f"{WAIST}.gravity_torque"})
    offered = candidates(
        ObservedRows(robot, table, ()), [name for name, kind in EFFECT_KINDS.items() if not kind.on_request]
    )
    depends = {name for effect in offered for c in effect.coefficients for name in c.basis.of}
    assert KNUCKLE in depends and WAIST not in depends
    assert any(effect.where == WAIST for effect in offered)  # it may give way, though


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[robots.Truth, Path]:
    """A campaign of 150 rows, identified once by the command itself."""
    folder = tmp_path_factory.mktemp("coupled")
    truth = robots.simulate(arm(), 150, np.random.default_rng(6), 2e-3, 1e-4)
    assert identify.main([str(written(folder, truth, STATED))]) == 0
    return truth, folder


def written(folder: Path, truth: robots.Truth, stated: StatedJoints, **measurements: object) -> Path:
    """The campaign of a machine, with what is stated of its joints."""
    section = {"urdf": "robot.urdf", "base": "base", "tip": "tip", "joints": stated.joints, "coupled": stated.coupled}
    search = {"enabled": True, "candidates": ["joint_harmonic", "joint_compliance", "joint_backlash"]}
    path = robots.write_campaign(folder, truth, robot=section, diagnosis=search)
    keys = yaml.safe_load(path.read_text())
    keys["measurements"] |= measurements
    path.write_text(yaml.safe_dump(keys))
    return path


def test_a_campaign_recovers_the_machine_and_names_what_is_redundant(done: tuple[robots.Truth, Path]) -> None:
    truth, folder = done
    result = json.loads((folder / "results" / "result.json").read_text())
    assert result["effects"] == []
    own = [p for p in result["parameters"] if p["name"].startswith(f"{WAIST}.")]
    assert own and all(p["redundant_with"] for p in own if p["status"] == "redundant")
    assert any(p["status"] == "redundant" for p in own)  # what stands still is one body with the link below
    saved = SavedModel.load(folder / "results")
    q = robots.readings(truth.model.robot, 200, np.random.default_rng(7))
    _, exact = truth.model.poses(truth.theta, truth.model.rows(q))
    _, p = saved.final.poses(q)
    assert np.sqrt(np.mean(np.sum((p - exact) ** 2, axis=1))) < 2e-4
    calibrated = (folder / "results" / "calibrated.urdf").read_bytes()
    _, by_urdf = saved.geometric.poses(q)
    world, tip = (saved.geometric.model.frames(saved.geometric.theta)[k][0][1] for k in (0, 1))
    R0, p0 = tip_frames(parse_robot(calibrated, "tip", stated=STATED), q)
    np.testing.assert_allclose(
        [world.act(a @ tip.translation + b) for a, b in zip(R0, p0, strict=True)], by_urdf, atol=1e-9
    )


def test_the_saved_calibration_predicts_what_the_model_in_memory_does(done: tuple[robots.Truth, Path]) -> None:
    truth, folder = done
    saved = SavedModel.load(folder / "results")
    assert saved.final.model.robot.stated == STATED
    final = pipeline.identify(folder / "campaign.yaml").stage("final").fit
    q = robots.readings(truth.model.robot, 20, np.random.default_rng(8))
    R, p = final.model.poses(final.theta, final.model.rows(q))
    found = saved.final.poses(q)
    np.testing.assert_allclose(found[0], R, atol=1e-12)
    np.testing.assert_allclose(found[1], p, atol=1e-12)
    pose = pin.SE3(R[0], p[0]).homogeneous
    command = saved.command(pose, q[0] + 0.01)
    assert command.reached
    np.testing.assert_allclose(saved.final.poses(command.readings[None])[1][0], p[0], atol=1e-6)


def test_only_a_campaign_that_states_joints_saves_any(done: tuple[robots.Truth, Path], tmp_path: Path) -> None:
    truth = robots.simulate(arm(StatedJoints()), 30, np.random.default_rng(10), noise=1e-4, which="none")
    assert identify.main([str(robots.write_campaign(tmp_path, truth, parameters={"set": "none"}))]) == 0
    there, plain = (
        yaml.safe_load((folder / "results" / "calibration.yaml").read_text())["robot"] for folder in (done[1], tmp_path)
    )
    assert (there["joints"], there["coupled"]) == (STATED.joints, STATED.coupled)
    assert there.keys() - plain.keys() == {"joints", "coupled"}


def test_a_column_of_a_joint_that_is_stated_is_refused_until_it_is_ignored(
    done: tuple[robots.Truth, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, folder = done
    rows = robots.table(truth).head(60).assign(**{WAIST: STANDS + 0.1})
    for stated, key in ((STATED, {}), (STATED, {"columns": {WAIST: WAIST}})):
        path = written(tmp_path, truth, stated, **key)
        rows.to_csv(tmp_path / "measurements.csv", index=False)
        with pytest.raises(AridcalError, match=rf"{WAIST}.*`robot.joints` or `robot.coupled` says where"):
            pipeline.identify(path)
    path = written(tmp_path, truth, STATED, ignore=[WAIST])
    rows.to_csv(tmp_path / "measurements.csv", index=False)
    assert len(pipeline.identify(path).measurements) == 60
    q = rows[[*truth.model.robot.readings, WAIST]]
    q.to_csv(tmp_path / "q.csv", index=False)
    assert predict.main([str(folder / "results"), str(tmp_path / "q.csv"), "-o", str(tmp_path / "p.csv")]) == 2
    assert "measurements.ignore" in capsys.readouterr().err


def test_new_rows_of_another_instrument_are_held_to_what_was_stated(
    done: tuple[robots.Truth, Path], tmp_path: Path
) -> None:
    truth, folder = done
    saved, rows = SavedModel.load(folder / "results"), robots.table(truth).head(12)
    keys: dict[str, object] = {"format": 1, "measurements": {"file": "new.csv", "kind": "pose"}}
    path = tmp_path / "new.yaml"
    path.write_text(yaml.safe_dump(keys))
    rows.to_csv(tmp_path / "new.csv", index=False)
    assert len(read_new_rows(saved, path).rows) == 12
    rows.assign(**{WAIST: STANDS + 0.1}).to_csv(tmp_path / "new.csv", index=False)
    with pytest.raises(AridcalError, match=rf"{WAIST}.*`robot.joints` or `robot.coupled` says where"):
        read_new_rows(saved, path)
    path.write_text(yaml.safe_dump(keys | {"robot": {"urdf": "robot.urdf", "tip": "tip", "joints": {WAIST: 0.5}}}))
    with pytest.raises(AridcalError, match=r"robot.joints and robot.coupled: are not those.*delete"):
        read_new_rows(saved, path)


def test_robot_programs_of_a_coupled_arm_are_refused(
    done: tuple[robots.Truth, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, folder = done
    (tmp_path / "a.script").write_text("def a():\n  movej([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])\nend\n")
    asked = [str(folder / "results" / "calibration.yaml"), str(tmp_path / "a.script"), "-o", str(tmp_path / "b.script")]
    assert compensate.main(asked) == 2
    assert f"joint '{KNUCKLE}' follows branch_joint and joint_4" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "b.script").exists()


def test_masters_that_follow_others_or_stand_still_are_resolved() -> None:
    """Composed by hand: joint_7 = 2 joint_5 + joint_2 with joint_5 = 0.5 joint_4 - 0.7 branch_joint, joint_2 = 0.4."""
    stated = StatedJoints({WAIST: STANDS}, {KNUCKLE: FACTORS, "joint_7": {KNUCKLE: 2.0, WAIST: 1.0}})
    drive = arm(stated).joint("joint_7").drive
    assert drive.factors == pytest.approx({"joint_4": 1.0, "branch_joint": -1.4})
    assert drive.offset == pytest.approx(STANDS)
    drive = parse_robot(mimicking(KNUCKLE, 'multiplier="-3" offset="0.1"'), "tip", stated=STATED).joint("joint_6").drive
    assert drive.factors == pytest.approx({"joint_4": -1.5, "branch_joint": 2.1})
    assert drive.offset == 0.1


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        (StatedJoints({"joint2": 0.0}), r"robot.joints: .*no joint 'joint2' \(did you mean 'joint_2'\?\). Write"),
        (StatedJoints({"tip_fixed": 0.0}), r"robot.joints: joint 'tip_fixed' of .* does not move.*Write one that does"),
        (StatedJoints({}, {"joint_9": FACTORS}), r"robot.coupled: .*no joint 'joint_9' \(did you mean 'joint_\d'\?\)"),
        (StatedJoints({}, {KNUCKLE: {"brunch_joint": 1.0}}), r"robot.coupled.joint_5: .*did you mean 'branch_joint'"),
        (StatedJoints({}, {KNUCKLE: {"tip_fixed": 1.0}}), r"robot.coupled.joint_5: joint 'tip_fixed' .*does not move"),
        (StatedJoints({}, {KNUCKLE: {}}), r"robot.coupled.joint_5: names no joint.*`robot.joints`"),
        (StatedJoints({}, {KNUCKLE: {"joint_4": 0.0}}), r"robot.coupled.joint_5.joint_4: a factor of 0.*Delete"),
        (StatedJoints({KNUCKLE: 0.0}, {KNUCKLE: FACTORS}), r"robot.coupled.joint_5: .*`robot.joints`, too. Delete one"),
        (StatedJoints({"joint_6": 0.0}), r"'joint_6' has a <mimic>, and stands under `robot.joints`, too. Delete one"),
        (StatedJoints({}, {"joint_6": FACTORS}), r"'joint_6' has a <mimic>, and stands under `robot.coupled`, too"),
        (StatedJoints({}, {KNUCKLE: {KNUCKLE: 1.0}}), r"'joint_5' mimics itself, by way of 'joint_5'.*`robot.coupled`"),
        (StatedJoints({}, {KNUCKLE: {"joint_4": 1.0}, "joint_4": {KNUCKLE: 1.0}}), r"mimics itself, by way of"),
        (StatedJoints({}, {"joint_1": {"joint_6": 1.0}}), r"mimics itself, by way of"),
        (StatedJoints({}, {KNUCKLE: {"joint_4": 1e9}, "joint_7": {KNUCKLE: 1e9}}), r"multiplies beyond 1e\+09.*check"),
        (StatedJoints(dict.fromkeys([f"joint_{k}" for k in (1, 2, 3, 4, 5, 7)], 0.0)), None),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_named_with_the_key(stated: StatedJoints, said: str | None) -> None:
    match = said or r"all joints between .* stand still by `robot.joints`.*Delete"
    with pytest.raises(AridcalError, match=match):
        parse_robot(mimicking("joint_1"), "tip", stated=stated)


def test_a_campaign_that_names_no_number_is_refused_by_its_line(tmp_path: Path) -> None:
    truth = robots.simulate(arm(), 12, np.random.default_rng(9))
    path = written(tmp_path, truth, STATED)
    text = path.read_text()
    path.write_text(re.sub(rf"{WAIST}: 0.4", f"{WAIST}: level", text))
    with pytest.raises(AridcalError, match=rf"line \d+: robot.joints.{WAIST}"):
        pipeline.identify(path)
    path.write_text(re.sub(rf"{WAIST}: 0.4", f"{WAIST}_: 0.4", text))
    with pytest.raises(AridcalError, match=rf"robot.joints: .*did you mean '{WAIST}'"):
        pipeline.identify(path)
