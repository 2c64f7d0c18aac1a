"""One configuration at a time gives what the model gives for many rows."""

from __future__ import annotations

import numpy as np
import pytest
import robots
from kinds_of_effects import every_effect

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.corrections.effect_kind import bumps
from aridcal.engine.corrections.loads import Payload, Surroundings, bearing_components
from aridcal.engine.corrections.sights import Sights
from aridcal.engine.fit.constants import constants
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.system.errors import CovariateNotFound, MeasurementError

ROWS = 20


def measured(robot: Robot, rng: np.random.Generator) -> dict[str, np.ndarray]:
    columns = {f"{name}_direction": rng.choice([-1.0, 0.0, 1.0], ROWS) for name in robot.names}
    return columns | {name: rng.uniform(0.0, 20.0, ROWS) for name in ("temperature", "time", "payload")}


@pytest.mark.parametrize("seed", range(4))
def test_pose_is_the_models_for_every_kind_of_effect(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = robots.random_robot(seed) if seed else robots.arid()
    q, columns = robots.readings(robot, ROWS, rng), measured(robot, rng)
    around = Surroundings(rng.normal(size=3) * 9.81, (Payload(rng.normal(size=3) * 0.2),))
    effects = every_effect(robot, q, columns, around)
    assert {c.basis.form for c in effects} >= {"linear", "sin", "bump", "power", "times_power"}
    some = tuple(effects[k] for k in rng.permutation(len(effects))[:300])
    frames = tuple(Coefficient(w, c) for w in ("world_base", "tip_target") for c in FRAME_COMPONENTS)
    coefficients = tuple(dict.fromkeys((*constants(robot, "full"), *some, *frames)))
    place = ((None, robots.random_placement(rng)),)
    model = Model(robot, coefficients, place, ((None, robots.random_placement(rng)),), around)
    theta = rng.normal(0.0, 1e-2, len(coefficients))
    R, p = model.poses(theta, model.rows(q, columns))
    one_row = OneRowModel(model, theta)
    assert set(one_row.needs) <= set(columns)
    for k in range(ROWS):
        effect = one_row.effects(q[k], {name: columns[name][k] for name in one_row.needs})
        at, position, J = one_row.jacobian(q[k], effect)
        np.testing.assert_allclose(position, p[k], rtol=0, atol=1e-12)
        np.testing.assert_allclose(at, R[k], rtol=0, atol=1e-12)
        same = one_row.pose(q[k], effect)
        assert np.array_equal(same[0], at) and np.array_equal(same[1], position)
        h = 1e-6
        for column in range(q.shape[1]):  # the Jacobian, by differences
            ahead, behind = (one_row.pose(q[k] + s * h * np.eye(q.shape[1])[column], effect) for s in (1, -1))
            np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * h), J[:3, column], rtol=0, atol=1e-7)
            turn = (ahead[0] - behind[0]) @ at.T / (2 * h)
            np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], J[3:, column], rtol=0, atol=1e-7)


def test_mimic_joints_follow_their_master() -> None:
    text = robots.random_chain(np.random.default_rng(9), "RRR").decode()
    i = text.index("</joint>", text.index('name="joint_3"'))
    robot = parse_robot(
        (text[:i] + '<mimic joint="joint_2" multiplier="-0.5" offset="0.3"/>' + text[i:]).encode(), "tip"
    )
    sag = Coefficient("joint_3", "axis", Basis("linear", ("joint_3.gravity_torque",), (0.0,)))
    model = Model(robot, (sag,))
    theta = np.array([1e-4])
    q = np.array([[0.4, -0.7]])
    one_row = OneRowModel(model, theta)
    R, p = model.poses(theta, model.rows(q))
    at, position = one_row.pose(q[0], one_row.effects(q[0], {}))
    np.testing.assert_allclose(position, p[0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(at, R[0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("base", ["base", "link_1", "link_2", "branch"])
def test_loads_are_those_of_the_arrays_wherever_the_chain_starts(base: str) -> None:
    rng = np.random.default_rng(21)
    robot = parse_robot(robots.random_chain(rng, "RCPRR"), "tip", base)
    loads = [f"{j.name}.gravity_torque" for j in robot.joints] + [f"{j.name}.payload_torque" for j in robot.joints]
    loads += [f"{j.name}.gravity_moment_{c}" for j in robot.joints for c in bearing_components(j.kind)]
    effects = tuple(Coefficient(load.partition(".")[0], "axis", Basis("linear", (load,), (0.0,))) for load in loads)
    around = Surroundings(rng.normal(size=3) * 9.81, (Payload(rng.normal(size=3) * 0.2),))
    model = Model(robot, effects, around=around)
    theta = rng.normal(0.0, 1e-4, len(effects))
    q, payload = robots.readings(robot, ROWS, rng), rng.uniform(0.0, 5.0, ROWS)
    R, p = model.poses(theta, model.rows(q, {"payload": payload}))
    one_row = OneRowModel(model, theta)
    for k in range(ROWS):
        at, position = one_row.pose(q[k], one_row.effects(q[k], {"payload": payload[k]}))
        np.testing.assert_allclose(position, p[k], rtol=0, atol=1e-12)
        np.testing.assert_allclose(at, R[k], rtol=0, atol=1e-12)


def test_stations_have_their_own_frames_gravity_and_drift() -> None:
    rng = np.random.default_rng(3)
    robot = robots.arid()
    world = tuple((label, robots.random_placement(rng)) for label in "AB")
    sag = Coefficient("joint_2", "axis", Basis("linear", ("joint_2.gravity_torque",), (0.0,)))
    own = tuple(Coefficient("world_base", "x", Basis("linear", ("time",), (0.0,)), label) for label in "AB")
    moved = tuple(Coefficient("world_base", "yaw", station=label) for label in "AB")
    around = Surroundings(np.array([[0.0, 9.81, 0.0], [9.81, 0.0, 0.0]]))
    model = Model(robot, (sag, *own, *moved), world, around=around)
    theta = np.array([1e-5, 1e-3, 2e-3, 0.01, 0.02])
    q = robots.readings(robot, 2, rng)
    columns = {"time": np.array([1.0, 2.0])}
    _, p = model.poses(theta, model.rows(q, columns, np.array(["A", "B"])))
    for k, label in enumerate("AB"):
        one_row = OneRowModel(model, theta, label)
        _, position = one_row.pose(q[k], one_row.effects(q[k], {"time": columns["time"][k]}))
        np.testing.assert_allclose(position, p[k], rtol=0, atol=1e-12)
    for wrong in ("C", None):
        with pytest.raises(MeasurementError, match="station"):
            OneRowModel(model, theta, wrong)


def test_targets_have_their_own_frames_and_places() -> None:
    rng = np.random.default_rng(4)
    robot = robots.arid()
    tip = tuple((label, robots.random_placement(rng)) for label in "AB")
    drawn = Coefficient("world_base", "x", Basis("linear", ("target.place_x",), (0.0,)))
    moved = tuple(Coefficient("tip_target", "y", station=label) for label in "AB")
    around = Surroundings(sights=Sights(np.array([frame.translation for _, frame in tip])))
    model, theta = Model(robot, (drawn, *moved), tip_target=tip, around=around), np.array([0.1, 0.01, 0.02])
    q = robots.readings(robot, 2, rng)
    _, p = model.poses(theta, model.rows(q, target=np.array(["A", "B"])))
    for k, label in enumerate("AB"):
        one_row = OneRowModel(model, theta, target=label)
        np.testing.assert_allclose(one_row.pose(q[k], one_row.effects(q[k], {}))[1], p[k], rtol=0, atol=1e-12)


def test_what_an_effect_needs_and_is_not_given_is_named() -> None:
    heat = Coefficient("joint_2", "axis", Basis("linear", ("temperature",), (20.0,)))
    load = Coefficient("joint_2", "axis", Basis("linear", ("joint_2.payload_torque",), (0.0,)))
    one_row = OneRowModel(Model(robots.arid(), (heat, load)), np.ones(2))
    assert one_row.needs == ("payload", "temperature")
    with pytest.raises(CovariateNotFound, match="'payload'"):
        one_row.effects(np.zeros(4), {"temperature": 20.0})
    with pytest.raises(CovariateNotFound, match=r"'temperature'.*did you mean 'temperatur'"):
        one_row.effects(np.zeros(4), {"temperatur": 20.0, "payload": 1.0})


def test_a_map_is_its_splines_inside_between_and_beyond_its_knots() -> None:
    """Evenly spaced splines are summed to polynomials; a gap among them, or two spacings, change nothing."""
    rng = np.random.default_rng(23)
    splines = bumps("joint_2", "axis", "temperature", np.linspace(10.0, 30.0, 99), 12)
    others = (Coefficient("joint_2", "axis", Basis("bump", ("temperature",), (17.3, 0.9))),
              Coefficient("joint_2", "axis", Basis("bump", ("temperature",), (18.6, 0.9))))  # fmt: skip
    coefficients = (*splines[:4], *splines[6:], *others)
    model = Model(robots.arid(), coefficients)
    theta = rng.normal(size=len(coefficients))
    one_row = OneRowModel(model, theta)
    at = np.concatenate([rng.uniform(0.0, 40.0, 200), [c.basis.numbers[0] for c in coefficients]])
    q = np.zeros((len(at), 4))
    _, p = model.poses(theta, model.rows(q, {"temperature": at}))
    for k, temperature in enumerate(at):
        position = one_row.pose(q[k], one_row.effects(q[k], {"temperature": temperature}))[1]
        np.testing.assert_allclose(position, p[k], rtol=0, atol=1e-12)
    assert np.isnan(one_row.effects(q[0], {"temperature": np.nan})).any()


def test_a_pose_is_not_changed_by_the_next_one() -> None:
    one_row = OneRowModel(Model(robots.ur10(), ()), np.zeros(0))
    first = one_row.pose(np.zeros(6), one_row.still)
    kept = [part.copy() for part in first]
    one_row.pose(np.ones(6), one_row.still)
    assert all(np.array_equal(a, b) for a, b in zip(first, kept, strict=True))
