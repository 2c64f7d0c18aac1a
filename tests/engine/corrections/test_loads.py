"""The payload hangs at the target and counts in every gravity load, wherever loads are computed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
import two_arms
from lxml import etree
from scipy.spatial.transform import Rotation
from searched import searched

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, direction
from aridcal.engine.corrections.loads import Payload, Surroundings, bearing_components, covariate_table, needs
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, parse_robot, with_limbs
from aridcal.engine.rows.dataset import Dataset
from aridcal.jobs.apply.joint_commands import compensate
from aridcal.jobs.apply.target_poses import predict, read_query
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.system.errors import CovariateNotFound, MeasurementError

SAG = Coefficient("shoulder_lift_joint", "axis", Basis("linear", ("shoulder_lift_joint.gravity_torque",), (0.0,)))
COMPLIANCE, SIGMA = 2e-5, 5e-5


def loads_of(robot: Robot, q: np.ndarray, around: Surroundings, payload: np.ndarray | None) -> dict[str, np.ndarray]:
    measured = {} if payload is None else {"payload": payload}
    return covariate_table(robot, q, measured, around, np.zeros(len(q), dtype=int), {"joint_1.gravity_torque"})


def with_mass(urdf: bytes, mass: float, lever: np.ndarray) -> pin.Model:
    """Pinocchio's own reading of a URDF with a point mass on a link of its own, fixed to the tip at the target."""
    root = etree.fromstring(urdf)
    link = etree.SubElement(root, "link", name="payload")
    inertial = etree.SubElement(link, "inertial")
    etree.SubElement(inertial, "mass", value=f"{mass:.17g}")
    etree.SubElement(inertial, "inertia", **dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0"))
    joint = etree.SubElement(root, "joint", name="holds", type="fixed")
    etree.SubElement(joint, "parent", link="tip")
    etree.SubElement(joint, "child", link="payload")
    etree.SubElement(joint, "origin", xyz=robots.numbers(lever), rpy="0 0 0")
    return pin.buildModelFromXML(etree.tostring(root, encoding="unicode"))


@pytest.mark.parametrize("kinds", ["RRRRRR", "PRCRR", "PPR", "RPRCR"])
def test_loads_are_those_of_a_point_mass_at_the_target(kinds: str) -> None:
    """Second road: Pinocchio's inverse dynamics of a URDF that carries the payload, forces along rails included."""
    rng = np.random.default_rng(len(kinds))
    urdf = robots.random_chain(rng, kinds)
    robot = parse_robot(urdf, "tip")
    q, payload = robots.readings(robot, 12, rng), rng.uniform(0.0, 20.0, 12)
    around = Surroundings(rng.normal(size=3) * 9.81, (Payload(rng.normal(size=3) * 0.3),), loaded=True)
    found = loads_of(robot, q, around, payload)
    for k in range(len(q)):
        model = with_mass(urdf, payload[k], around.payloads[0].lever)
        model.gravity.linear = around.gravity
        data = model.createData()
        at = pin.neutral(model)
        for name, value in zip(robot.names, q[k], strict=True):
            joint = model.getJointId(name)
            place = model.idx_qs[joint]
            own = [np.cos(value), np.sin(value)] if model.nqs[joint] == 2 else [value]
            at[place : place + len(own)] = own
        torque = pin.rnea(model, data, at, np.zeros(model.nv), np.zeros(model.nv))
        for joint in robot.joints:
            i = model.getJointId(joint.name)
            pulled = found[f"{joint.name}.gravity_torque"][k]
            np.testing.assert_allclose(pulled, -torque[model.idx_vs[i]], rtol=1e-10, atol=1e-10)
            R = data.liMi[i].rotation  # what holds the joint, in the axes of the one before
            moment = -model.jointPlacements[i].rotation.T @ R @ data.f[i].angular
            for component in bearing_components(joint.kind):
                across = found[f"{joint.name}.gravity_moment_{component}"][k]
                np.testing.assert_allclose(across, direction(component, joint.axis) @ moment, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    "on", [("",), ("left_hand",), ("right_4",), ("left_hand", "right_hand"), ("left_6", "left_hand")]
)
def test_payloads_on_links_pull_the_joints_that_bear_them_alone(on: tuple[str, ...]) -> None:
    """Second road: Pinocchio's inverse dynamics of two arms with the masses added; for one row, too."""
    rng = np.random.default_rng(len(on[0]))
    robot = with_limbs(parse_robot(two_arms.urdf(), "left_hand", "torso"), ["right_hand", "head"])
    q = rng.uniform(-1.0, 1.0, (9, len(robot.readings)))
    hung = tuple(Payload(rng.normal(size=3) * 0.3, link, f"payload_{link}") for link in on)
    masses = {each.name: rng.uniform(1.0, 20.0, 9) for each in hung}
    around = Surroundings(rng.normal(size=3) * 9.81, hung, loaded=True)
    names = [f"{joint.name}.{kind}_torque" for joint in robot.joints for kind in ("gravity", "payload")]
    found = covariate_table(robot, q, masses, around, np.zeros(9, dtype=int), set(names))
    asked = tuple(Coefficient(name.partition(".")[0], "axis", Basis("linear", (name,), (0.0,))) for name in names)
    whole = Model(robot, asked, around=around)
    theta = np.full(len(asked), 1e-4)
    one, (_, p) = OneRowModel(whole, theta), whole.poses(theta, whole.rows(q, masses))
    assert set(whole.needs) == set(one.needs) == set(masses)
    for k in range(len(q)):
        carried = {name: float(values[k]) for name, values in masses.items()}
        np.testing.assert_allclose(one.pose(q[k], one.effects(q[k], carried))[1], p[k], rtol=0, atol=1e-12)
    model = pin.buildModelFromXML(two_arms.urdf().decode())
    model.gravity.linear = around.gravity
    links = [model.frames[model.getFrameId(link or "left_hand")] for link in on]
    order = [robot.readings.index(name) for name in model.names[1:]]
    for k in range(len(q)):
        torque, carrying = [], model.copy()
        for loaded in (False, True):
            for link, each in zip(links, hung if loaded else (), strict=False):
                mass = pin.Inertia(masses[each.name][k], link.placement.act(each.lever), np.zeros((3, 3)))
                carrying.inertias[link.parentJoint] += mass
            torque.append(pin.computeGeneralizedGravity(carrying, carrying.createData(), q[k][order]))
        for joint in robot.joints:
            i = model.joints[model.getJointId(joint.name)].idx_v
            both = found[f"{joint.name}.gravity_torque"][k], found[f"{joint.name}.payload_torque"][k]
            np.testing.assert_allclose(both, (-torque[1][i], torque[0][i] - torque[1][i]), rtol=1e-9, atol=1e-9)
            bearing = {k for link in links for k in model.supports[link.parentJoint]}
            assert (both[1] == 0.0) == (model.getJointId(joint.name) not in bearing)


@pytest.mark.parametrize("base", ["base", "branch", "link_3"])
@pytest.mark.parametrize("kinds", ["RRRR", "PRCP"])
def test_what_drives_a_joint_is_the_slope_of_the_potential_energy(kinds: str, base: str) -> None:
    """The base stands still, wherever in the tree it is: -dU/dq of all that moves, by differences of the centre of mass."""
    rng = np.random.default_rng(len(base))
    urdf = robots.random_chain(rng, kinds)
    robot = parse_robot(urdf, "tip" if base != "link_3" else "base", base)
    q = robots.readings(robot, 6, rng)
    around = Surroundings(rng.normal(size=3) * 9.81)
    found, (model, h) = loads_of(robot, q, around, None), (robot.tree, 1e-5)
    data, mass = model.createData(), sum(inertia.mass for inertia in model.inertias)

    def energy(readings: np.ndarray) -> float:
        at = pin.neutral(model)
        for name, value in zip(robot.names, readings, strict=True):
            place, joint = model.idx_qs[model.getJointId(name)], model.getJointId(name)
            own = [np.cos(value), np.sin(value)] if model.nqs[joint] == 2 else [value]
            at[place : place + len(own)] = own
        pin.framesForwardKinematics(model, data, at)
        centre = sum(
            (i.mass / mass * T.act(i.lever) for i, T in zip(model.inertias, data.oMi, strict=True)), np.zeros(3)
        )
        in_base = data.oMf[model.getFrameId(robot.base, pin.FrameType.BODY)].actInv(centre)
        return float(-mass * around.gravity @ in_base)

    for j, joint in enumerate(robot.joints):
        step = h * np.eye(len(robot.joints))[j]
        slope = [(energy(row + step) - energy(row - step)) / (2 * h) for row in q]
        np.testing.assert_allclose(found[f"{joint.name}.gravity_torque"], -np.array(slope), rtol=0, atol=1e-6)


def test_without_a_payload_column_or_with_one_of_zeros_nothing_changes() -> None:
    rng = np.random.default_rng(4)
    robot = robots.random_robot(4)
    q, around = robots.readings(robot, 9, rng), Surroundings(payloads=(Payload(np.array([0.1, 0.2, 0.3])),))
    bare = loads_of(robot, q, around, None)
    of_links = [name for name in bare if ".gravity_" in name]
    assert of_links
    empty = loads_of(robot, q, replace(around, loaded=True), np.zeros(9))
    unasked = loads_of(robot, q, around, np.full(9, 7.0))  # of calibrations from before it counted
    for name in of_links:
        assert np.array_equal(bare[name], empty[name])
        assert np.array_equal(bare[name], unasked[name])


@pytest.mark.parametrize("base", ["base", "link_1", "branch"])
def test_one_row_bears_the_payload_that_many_rows_bear(base: str) -> None:
    rng = np.random.default_rng(8)
    robot = parse_robot(robots.random_chain(rng, "RCPRR"), "tip", base)
    names = [f"{j.name}.gravity_torque" for j in robot.joints]
    names += [f"{j.name}.gravity_moment_{c}" for j in robot.joints for c in bearing_components(j.kind)]
    effects = tuple(Coefficient(n.partition(".")[0], "axis", Basis("linear", (n,), (0.0,))) for n in names)
    around = Surroundings(rng.normal(size=3) * 9.81, (Payload(rng.normal(size=3) * 0.2),), loaded=True)
    model, theta = Model(robot, effects, around=around), rng.normal(0.0, 1e-4, len(effects))
    q, payload = robots.readings(robot, 20, rng), rng.uniform(0.0, 9.0, 20)
    _, p = model.poses(theta, model.rows(q, {"payload": payload}))
    one_row = OneRowModel(model, theta)
    for k in rng.permutation(20):  # no row may feel the payload of the one before
        _, position = one_row.pose(q[k], one_row.effects(q[k], {"payload": payload[k]}))
        np.testing.assert_allclose(position, p[k], rtol=0, atol=1e-12)


def test_the_payload_is_needed_only_where_a_load_holds_it() -> None:
    robot = robots.ur10()
    own = Basis("linear", ("elbow_joint",), (0.0,))
    other = Basis("linear", ("shoulder_lift_joint.payload_torque",), (0.0,))
    bare, loaded = Surroundings(), Surroundings(loaded=True)
    assert needs(robot, [own, SAG.basis], bare) == ()
    assert needs(robot, [own], loaded) == ()
    assert needs(robot, [own, SAG.basis], loaded) == ("payload",)
    assert needs(robot, [other], bare) == ("payload",)
    model = Model(robot, (SAG,), around=loaded)
    assert model.needs == OneRowModel(model, np.zeros(1)).needs == ("payload",)
    with pytest.raises(CovariateNotFound, match="'payload'"):
        model.rows(np.zeros((2, 6)))


def write_under(folder: Path, loads: list[float], holes: int = 0) -> Path:
    """The campaign of a UR10 whose shoulder yields by 2e-5 rad/N m, measured under some payloads in turn."""
    rng = np.random.default_rng(12)
    tip = robots.random_placement(rng, 0.2)
    rigid = robots.simulate(robots.ur10(), 240, rng, world=robots.random_placement(rng), tip=tip)
    payload = rng.choice(loads, 240)
    model = replace(
        rigid.model,
        coefficients=(*rigid.model.coefficients, SAG),
        around=Surroundings(np.array([0.0, 0.0, -9.81]), (Payload(tip.translation),), loaded=True),
    )
    R, p = model.poses(np.append(rigid.theta, COMPLIANCE), model.rows(rigid.readings, {"payload": payload}))
    p = p + SIGMA * rng.normal(size=p.shape)
    R = Rotation.from_rotvec(SIGMA * rng.normal(size=p.shape)).as_matrix() @ R
    truth = robots.Truth(model, rigid.theta, robots.measured(model.robot, rigid.readings, p, R))
    payload[:holes] = np.nan
    rows, noise = robots.table(truth).assign(payload=payload), {"position": SIGMA, "rotation": SIGMA}
    sections = {"measurements": {"file": "measurements.csv", "noise": noise}}
    sections["diagnosis"] = {"candidates": ["joint_compliance", "joint_harmonic", "payload_compliance"]}
    return robots.write_campaign(folder, truth, rows, **sections)


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """What comes of three loads."""
    return identify(write_under(tmp_path_factory.mktemp("loaded"), [0.0, 5.0, 10.0]))


def test_a_compliance_under_loads_is_found_as_it_is(loaded: Outcome, tmp_path: Path) -> None:
    """Of three loads, and of one that is always the same."""
    assert [(e.effect.kind, e.effect.where) for e in loaded.effects] == [("joint_compliance", "shoulder_lift_joint")]
    found = searched(write_under(tmp_path, [10.0]))
    assert found.named == {("joint_compliance", "shoulder_lift_joint")}
    for fit, rows in ((loaded.stage("final").fit, loaded.measurements), (found.fit, found.rows)):
        as_simulated(fit, rows)


def as_simulated(fit: Fit, rows: Dataset) -> None:
    k = fit.model.names.index(SAG.name)
    assert abs(fit.theta[k] - COMPLIANCE) < 4 * fit.std[k]
    assert fit.std[k] < 0.05 * COMPLIANCE
    left = problem(fit.model, rows.select(rows.test)).residual(fit.theta)[:, :3]
    assert np.sqrt(np.mean(left**2)) < 1.2 * SIGMA


def test_what_a_calibration_saw_of_the_payload_is_needed_of_those_who_use_it(loaded: Outcome, tmp_path: Path) -> None:
    saved = calibration(loaded)
    assert saved.ranges["payload"] == (0.0, 10.0)
    (tmp_path / "calibration.yaml").write_text(saved.dump(), encoding="utf-8")
    again = SavedModel.load(tmp_path)
    q = robots.readings(robots.ur10(), 6, np.random.default_rng(1), 0.1)
    query = pd.DataFrame(q, columns=list(robots.ur10().readings))
    with pytest.raises(CovariateNotFound, match="'payload'"):
        predict(again, read_query(again, query))
    query["payload"] = [0.0, 5.0, 10.0, 10.0, np.nan, 5.0]
    with pytest.raises(MeasurementError, match="line 6: column 'payload': missing"):
        read_query(again, query)
    query["payload"] = [0.0, 5.0, 10.0, 10.0, 0.0, 5.0]
    poses = predict(again, read_query(again, query))
    sag = poses.loc[2, ["x", "y", "z"]].to_numpy(float)
    lighter = predict(again, read_query(again, query.assign(payload=0.0))).loc[2, ["x", "y", "z"]].to_numpy(float)
    assert np.linalg.norm(sag - lighter) > 1e-4
    commands = compensate(again, read_query(again, poses.dropna(), poses=True))
    np.testing.assert_allclose(commands[query.columns[:6]], q[poses["x"].notna()], rtol=0, atol=1e-6)


def test_an_older_calibration_goes_on_as_it_was_made(tmp_path: Path) -> None:
    """Its loads were those of the links alone, whatever columns it saw."""
    place = ((None, pin.SE3.Identity()),)
    model = Model(robots.ur10(), (SAG,), place, place, Surroundings(loaded=True))
    solved = SolvedModel(model, np.array([COMPLIANCE]), np.eye(1) * 1e-12)
    saved = SavedModel(solved, solved, "pose", (0.0, 0.0, -9.81), (1e-4, 1e-4), {}, {})
    text = saved.dump()
    assert text.count("    payload: true\n") == 2
    (tmp_path / "calibration.yaml").write_text(text.replace("    payload: true\n", ""), encoding="utf-8")
    old = SavedModel.load(tmp_path).final
    assert old.model.needs == ()
    q = robots.readings(robots.ur10(), 3, np.random.default_rng(2))
    assert np.array_equal(old.poses(q)[1], old.poses(q, {"payload": np.full(3, 9.0)})[1])


def test_a_payload_with_holes_bars_the_loads_and_says_so(tmp_path: Path) -> None:
    found = searched(write_under(tmp_path, [0.0, 10.0], holes=40))
    assert "joint_compliance" not in {effect.kind for effect in found.effects}
    why = {b.what: b.why for b in found.arm.diagnosed.barred}
    assert why["compliance and load-side backlash"] == "the column payload has empty cells"


def test_the_payload_hangs_where_the_final_model_has_the_target(loaded: Outcome) -> None:
    """A large compliance bends the geometric stage, and with it the target that its own load depends on."""
    final = loaded.stage("final").fit
    lever = final.model.frames(final.theta)[1][0][1].translation
    assert np.linalg.norm(final.model.around.payloads[0].lever - lever) < 2e-4
