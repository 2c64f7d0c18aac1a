"""The extended model: poses multiplied out by hand, columns by finite differences, the same robot as its URDF."""

from __future__ import annotations

import io
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import robots
import yourdfpy
from robots import TIME, varying, wave

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, LINK_COMPONENTS, Coefficient
from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.fit.constants import constants, stage_urdf
from aridcal.engine.model.many_rows import LEAST_TOGETHER, ROWS_PER_BLOCK
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.engine.robot.doty import doty_links, link_transform
from aridcal.engine.robot.kinematics import gravity_loads, rotations, tip_frames, transverse, tree_frames
from aridcal.system.errors import CovariateNotFound, MeasurementError

ROBOTS = {
    "any axes": lambda: robots.random_robot(1, "RPRC"),
    "frame axes": lambda: robots.random_robot(2, "PRRP", aligned=True),
    "mimic": lambda: parse_robot(mimicking(robots.random_chain(np.random.default_rng(3), "RPR")), "tip"),
    "arid": robots.arid,
}
CLIMBING = {
    "upwards": lambda: parse_robot(robots.random_chain(np.random.default_rng(6), "RPRC"), "base", "tip"),
    "down from a branch": lambda: parse_robot(robots.random_chain(np.random.default_rng(7), "RPR"), "tip", "branch"),
    "up to a branch": lambda: parse_robot(robots.random_chain(np.random.default_rng(8), "RPR"), "branch", "tip"),
}
"""Robots whose base moves: their paths have no link parameters of the report."""
EVERY = ROBOTS | CLIMBING


def mimicking(urdf: bytes) -> bytes:
    """Joint 1 follows joint 3, which is parsed after it."""
    start = urdf.index(b'<joint name="joint_1"')
    end = urdf.index(b"</joint>", start)
    return urdf[:end] + b'<mimic joint="joint_3" multiplier="-0.7" offset="0.2"/>' + urdf[end:]


SETS = {
    "full": lambda robot: constants(robot, "full"),
    "doty": lambda robot: constants(robot, "doty"),
    "frames": lambda robot: robots.FRAMES,
    "varying": varying,
    "all": lambda robot: (
        *robots.FRAMES, *constants(robot, "full"), *[c for c in constants(robot, "doty")
        if c.component in LINK_COMPONENTS], *varying(robot),
    ),
}  # fmt: skip
PAIRS = [*((r, s) for r in ROBOTS for s in SETS), *((r, s) for r in CLIMBING for s in ("full", "frames", "varying"))]


def build(robot: Robot, coefficients: tuple[Coefficient, ...], seed: int = 0) -> Model:
    rng = np.random.default_rng(seed)
    frames = [((None, robots.random_placement(rng)),) for _ in range(2)]
    return Model(robot, coefficients, frames[0], frames[1], Surroundings(np.array([1.0, 5.0, -8.0])))


def rows_of(model: Model, n: int = 6, seed: int = 1):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)
    q = robots.readings(model.robot, n, rng)
    return q, model.rows(q, {"time": rng.uniform(0, 1, n)})


@pytest.mark.parametrize(("robot", "which"), PAIRS)
def test_many_rows_walked_together_are_where_pinocchio_has_each(robot: str, which: str) -> None:
    model = build(EVERY[robot](), SETS[which](EVERY[robot]()))
    theta = np.random.default_rng(5).uniform(-0.1, 0.1, len(model.coefficients))
    _, rows = rows_of(model, LEAST_TOGETHER + 20)
    theta[[not c.basis.constant for c in model.coefficients]] /= np.maximum(
        np.abs(rows.phi).max(axis=0), 1e-9
    )  # loads are large
    together = (*model.jacobian(theta, rows), *model.poses(theta, rows))
    few = [rows[slice(start, start + LEAST_TOGETHER // 2)] for start in range(0, len(rows), LEAST_TOGETHER // 2)]
    one_by_one = [(*model.jacobian(theta, some), *model.poses(theta, some)) for some in few]
    for found, each in zip(together, zip(*one_by_one, strict=True), strict=True):
        np.testing.assert_allclose(found, np.concatenate(each), rtol=0, atol=2e-14 * np.abs(found).max())


@pytest.mark.parametrize("count", [LEAST_TOGETHER // 2, LEAST_TOGETHER + 20])
def test_what_turns_about_the_target_does_not_move_it_by_a_rounding(count: int) -> None:
    """A column of roundings looks like any other, once it is brought to length 1."""
    arm, rng = robots.arid(), np.random.default_rng(2)
    place = ((None, robots.random_placement(rng)),)
    model = Model(arm, (*robots.FRAMES, *constants(arm, "full")), place, place)
    _, _, J = model.jacobian(
        rng.uniform(-0.01, 0.01, len(model.coefficients)), model.rows(robots.readings(arm, count, rng))
    )
    about = [c.where == "tip_target" and c.component in ("roll", "pitch", "yaw") for c in model.coefficients]
    assert np.all(J[:, :3, about] == 0.0) and np.all(np.abs(J[:, :3, ~np.array(about)]).max(axis=(0, 1)) > 1e-3)


def test_poses_of_many_rows_at_stations_are_those_of_each_station() -> None:
    arm, rng = robots.arid(), np.random.default_rng(0)
    frames = tuple((name, robots.random_placement(rng)) for name in "ab")
    at_each = tuple(Coefficient("world_base", c, station=name) for name in "ab" for c in ("x", "yaw"))
    model = Model(arm, (*at_each, *constants(arm, "full")), frames, ((None, robots.random_placement(rng)),))
    theta = rng.uniform(-0.1, 0.1, len(model.coefficients))
    station = rng.choice(["a", "b"], 2 * ROWS_PER_BLOCK + 300)
    rows = model.rows(robots.readings(arm, len(station), rng), station=station)
    R, p = model.poses(theta, rows)
    for name in "ab":
        own = np.flatnonzero(station == name)[::37]
        few = [model.jacobian(theta, rows[own[k : k + 1]]) for k in range(len(own))]
        np.testing.assert_allclose(R[own], np.concatenate([f[0] for f in few]), rtol=0, atol=1e-13)
        np.testing.assert_allclose(p[own], np.concatenate([f[1] for f in few]), rtol=0, atol=1e-13)


@pytest.mark.parametrize(("name", "which"), PAIRS)
def test_jacobian_matches_finite_differences(name: str, which: str) -> None:
    """Five-point differences, of every column in units of its own size."""
    robot = EVERY[name]()
    model = build(robot, SETS[which](robot))
    _, rows = rows_of(model)
    theta = np.random.default_rng(2).normal(0, 0.02, len(model.coefficients))
    R, p, J = model.jacobian(theta, rows)
    for a, b in zip((R, p), model.poses(theta, rows), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-14)
    for k, coefficient in enumerate(model.coefficients):
        size = max(np.abs(J[:, :, k]).max(), 1e-3)
        h = 1e-3 / max(1.0, size)
        turn, slide = np.zeros((len(p), 3, 3)), np.zeros((len(p), 3))
        for weight, step in ((1 / 12, -2), (-8 / 12, -1), (8 / 12, 1), (-1 / 12, 2)):
            moved = theta.copy()
            moved[k] += step * h
            R_moved, p_moved = model.poses(moved, rows)
            turn += weight / h * R_moved @ R.transpose(0, 2, 1)
            slide += weight / h * p_moved
        found = np.hstack([slide, np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)])
        np.testing.assert_allclose(J[:, :, k], found, rtol=0, atol=1e-8 * size, err_msg=coefficient.name)


@pytest.mark.parametrize("name", EVERY)
def test_at_zero_the_model_is_the_urdf(name: str) -> None:
    robot = EVERY[name]()
    model = build(robot, SETS["all" if name in ROBOTS else "varying"](robot))
    q, rows = rows_of(model)
    R, p = model.poses(np.zeros(len(model.coefficients)), rows)
    world, tip = model.world_base[0][1], model.tip_target[0][1]
    other = yourdfpy.URDF.load(io.BytesIO(robot.urdf), build_scene_graph=True, load_meshes=False)
    for k, positions in enumerate(robot.positions(q)):
        other.update_cfg({n: v for n, v in zip(robot.names, positions, strict=True) if n in other.actuated_joint_names})
        expected = world * pin.SE3(other.get_transform(robot.tip, robot.base)) * tip
        np.testing.assert_allclose(p[k], expected.translation, atol=1e-9)
        np.testing.assert_allclose(R[k], expected.rotation, atol=1e-9)


def urdf_transform(value: dict[str, float]) -> pin.SE3:
    """C(x, y, z, roll, pitch, yaw), as URDF's xyz and rpy mean it."""
    v = [value.get(c, 0.0) for c in FRAME_COMPONENTS]
    return pin.SE3(pin.rpy.rpyToMatrix(*v[3:]), np.array(v[:3]))


def motion(joint, q: float) -> pin.SE3:  # type: ignore[no-untyped-def]
    if joint.kind == "prismatic":
        return pin.SE3(np.eye(3), q * joint.axis)
    return pin.SE3(rotations(joint.axis, np.array([q]))[0], np.zeros(3))


def bearing(joint, value: dict[str, float]) -> pin.SE3:  # type: ignore[no-untyped-def]
    """C in the frame (e1, e2, axis), or in the joint's own frame where the axis is one of its axes."""
    e1, e2 = transverse(joint.axis)
    k = int(np.argmax(np.abs(joint.axis)))
    if abs(joint.axis[k]) > 1 - 1e-9:
        sign = float(np.sign(joint.axis[k]))
        others = [i for i in range(3) if i != k]
        names = {others[0]: ("t1", "r1"), others[1]: ("t2", "r2")}
        drive = value.get("axis", 0.0) * sign
        full = {c: value.get(c, 0.0) for c in FRAME_COMPONENTS}
        for i in range(3):
            slide, turn = names.get(i, ("", ""))
            full["xyz"[i]] += value.get(slide, 0.0) if slide else drive * (joint.kind == "prismatic")
            full[FRAME_COMPONENTS[3 + i]] += value.get(turn, 0.0) if turn else drive * (joint.kind == "revolute")
        return urdf_transform(full)
    F = pin.SE3(np.stack([e1, e2, joint.axis], axis=1), np.zeros(3))
    drive = "z" if joint.kind == "prismatic" else "yaw"
    names = {"t1": "x", "t2": "y", "r1": "roll", "r2": "pitch", "axis": drive}
    inner = {names[c]: v for c, v in value.items() if c in names}
    return F * urdf_transform(inner) * F.inverse()


@pytest.mark.parametrize("name", ["any axes", "frame axes"])
def test_pose_is_the_product_that_the_conventions_state(name: str) -> None:
    """P C(c) C(v) M(q) D(d) for a revolute joint, P C(c) M(q) C(v) D(d) for a prismatic one, at corrections of 0.1."""
    robot = ROBOTS[name]()
    links = doty_links(robot)
    coefficients = [*robots.FRAMES, *constants(robot, "full")]
    coefficients += [c for c in constants(robot, "doty") if c.component in LINK_COMPONENTS]
    for joint in robot.joints:
        coefficients += [Coefficient(joint.name, c, wave(joint.name)) for c in ("axis", "t1", "t2", "r1", "r2")]
    model = build(robot, tuple(coefficients))
    q, rows = rows_of(model, 4)
    theta = np.random.default_rng(3).normal(0, 0.1, len(coefficients))
    R, p = model.poses(theta, rows)
    for n, positions in enumerate(robot.positions(q)):

        def values(where: str, constant: bool, n: int = n) -> dict[str, float]:
            own = [k for k, c in enumerate(coefficients) if c.where == where and c.basis.constant == constant]
            own = [k for k in own if coefficients[k].component not in LINK_COMPONENTS]
            phi = 1.0 if constant else np.sin(1.5 * q[n, robot.readings.index(where)])
            return {coefficients[k].component: theta[k] * phi for k in own}

        T = model.world_base[0][1] * urdf_transform(values("world_base", True))
        placement = robot.onward[0]
        for joint, position, link in zip(robot.joints, positions, links, strict=True):
            T = T * placement * urdf_transform(values(joint.name, True))
            C, M = bearing(joint, values(joint.name, False)), motion(joint, position)
            T = T * C * M if joint.kind == "revolute" else T * M * C
            change = {c.component: theta[k] for k, c in enumerate(coefficients) if c.where == joint.name}
            corrected = [getattr(link, c) + change.get(c, 0.0) for c in ("theta", "beta", "a", "alpha")]
            placement = link.before * pin.SE3(link_transform(*corrected, change.get("d", 0.0))) * link.after
        T = T * placement * urdf_transform(values(str(robot.tip_joint), True))
        T = T * model.tip_target[0][1] * urdf_transform(values("tip_target", True))
        np.testing.assert_allclose(p[n], T.translation, atol=1e-12)
        np.testing.assert_allclose(R[n], T.rotation, atol=1e-12)


def as_urdf(model: Model, theta: np.ndarray) -> Robot:
    """What the geometric stage writes, read again."""
    return parse_robot(stage_urdf(SimpleNamespace(model=model, theta=theta)), model.robot.tip, model.robot.base)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "which"),
    [*((r, s) for r in (*ROBOTS, "ur10") for s in ("full", "doty", "angles")), *((r, "full") for r in CLIMBING)],
)
def test_constants_folded_into_the_urdf_predict_what_the_model_predicts(name: str, which: str) -> None:
    robot = EVERY.get(name, robots.ur10)()
    model = build(robot, (*constants(robot, which), *robots.FRAMES))
    q, rows = rows_of(model, 20)
    theta = np.random.default_rng(4).normal(0, 0.02, len(model.coefficients))
    R, p = model.poses(theta, rows)
    world, tip = (f[0][1] for f in model.frames(theta))
    axes, origins = tip_frames(as_urdf(model, theta), q)
    for n in range(len(q)):
        T = world * pin.SE3(axes[n], origins[n]) * tip
        np.testing.assert_allclose(p[n], T.translation, atol=1e-12)
        np.testing.assert_allclose(R[n], T.rotation, atol=1e-12)


@pytest.mark.parametrize("name", CLIMBING)
def test_the_columns_of_readings_are_the_frame_jacobians_between_two_links(name: str) -> None:
    """Pinocchio's Jacobian of the tip less that of the base, both in the tree's root: what the base sees of the tip."""
    robot = CLIMBING[name]()
    model = Model(robot, ())
    q, rows = rows_of(model)
    _, p, J = model.by_readings(np.zeros(0), rows)
    tree, data = robot.tree, robot.tree.createData()
    base, tip = (tree.getFrameId(link, pin.FrameType.BODY) for link in (robot.base, robot.tip))
    at = [tree.joints[tree.getJointId(joint)].idx_v for joint in robot.readings]
    for n in range(len(q)):
        configuration = pin.neutral(tree)
        for joint, value in zip(robot.readings, q[n], strict=True):
            own = tree.joints[tree.getJointId(joint)]
            configuration[own.idx_q : own.idx_q + own.nq] = [np.cos(value), np.sin(value)] if own.nq == 2 else value
        pin.computeJointJacobians(tree, data, configuration)
        pin.updateFramePlacements(tree, data)
        of_base, of_tip = (pin.getFrameJacobian(tree, data, k, pin.LOCAL_WORLD_ALIGNED) for k in (base, tip))
        lever = data.oMf[tip].translation - data.oMf[base].translation
        seen = of_tip - of_base
        seen[:3] -= np.cross(of_base[3:].T, lever).T
        back = data.oMf[base].rotation.T
        np.testing.assert_allclose(J[n], np.vstack([back @ seen[:3], back @ seen[3:]])[:, at], atol=1e-12)
        np.testing.assert_allclose(p[n], data.oMf[base].actInv(data.oMf[tip].translation), atol=1e-12)


PATHS = [
    ("tip", "branch", "link_2"),
    ("link_2", "tip", "branch"),
    ("branch", "link_3", "base"),
    ("base", "tip", "base"),
]


@pytest.mark.parametrize(("a", "b", "c"), PATHS)
def test_what_one_link_sees_of_another_hangs_on_no_link_that_is_called_the_base(a: str, b: str, c: str) -> None:
    """Constants and effects stay those of their joints: from a to b is from a to c, then from c to b, any of them the base."""
    urdf = robots.random_chain(np.random.default_rng(6), "RPRC")
    whole = parse_robot(urdf, "tip", "base"), parse_robot(urdf, "branch", "base")
    every = {k.name: k for robot in whole for k in (*constants(robot, "full"), *varying(robot))}
    value = dict(zip(every, np.random.default_rng(1).normal(0, 0.02, len(every)), strict=True))
    q = dict(zip({*whole[0].names, *whole[1].names}, np.random.default_rng(2).uniform(-1, 1, (5, 8)), strict=True))

    def seen(tip: str, base: str) -> list[pin.SE3]:
        if tip == base:
            return [pin.SE3.Identity()] * 8
        robot = parse_robot(urdf, tip, base)
        own = [k for k in every.values() if k.where in robot.names and "gravity" not in k.name]  # the base bears all
        model = Model(robot, tuple(own))
        rows = model.rows(np.array([q[name] for name in robot.readings]).T)
        poses = model.poses(np.array([value[k.name] for k in own]), rows)
        return [pin.SE3(R, p) for R, p in zip(*poses, strict=True)]

    for whole_way, first, then, back in zip(seen(b, a), seen(c, a), seen(b, c), seen(a, b), strict=True):
        assert (whole_way.inverse() * first * then).isIdentity(1e-9)
        assert (whole_way * back).isIdentity(1e-9)


def test_only_joints_that_are_corrected_get_a_new_origin() -> None:
    robot = robots.arid()
    model = build(robot, (Coefficient("joint_2", "pitch"), Coefficient("joint_3", "alpha")))
    assert set(model.origins(np.full(2, 1e-3))) == {"joint_2", "joint_4"}
    own = model.origins(np.zeros(2))
    for name, placement in own.items():
        assert (placement.inverse() * robot.joint(name).origin).isIdentity(1e-14)


@pytest.mark.parametrize("which", ["full", "doty"])
@pytest.mark.parametrize("name", ["any axes", "frame axes", "arid", "ur10"])
def test_with_its_constants_locked_the_model_is_the_calibrated_urdf(name: str, which: str) -> None:
    """Same joints, same poses, same masses as Pinocchio loads from the new file."""
    robot = ROBOTS.get(name, robots.ur10)()
    tip = robot.tip_joint
    model = Model(robot, constants(robot, which))
    theta = np.random.default_rng(5).normal(0, 0.02, len(model.coefficients))
    locked = model.locked(theta)
    reduced = locked.model
    assert np.array_equal(locked.own, np.arange(len(robot.names))) and (locked.carrier == -1).all()
    tree = pin.buildModelFromXML(as_urdf(model, theta).urdf.decode())
    other = pin.buildReducedModel(
        tree, [k for k in range(1, tree.njoints) if tree.names[k] not in robot.names], pin.neutral(tree)
    )
    assert list(reduced.names)[1:] == list(robot.names)
    assert tip is not None
    a, b = reduced.createData(), other.createData()
    q = robots.readings(robot, 10, np.random.default_rng(6))
    for positions in robot.positions(q):
        whole = pin.neutral(other)
        for k, value in enumerate(positions, start=1):
            joint = other.joints[k]
            whole[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
        pin.forwardKinematics(reduced, a, positions)
        pin.forwardKinematics(other, b, whole)
        for k in range(1, reduced.njoints):
            np.testing.assert_allclose(a.oMi[k].homogeneous, b.oMi[k].homogeneous, atol=1e-12)
    for k in range(1, reduced.njoints):
        assert reduced.inertias[k].mass == pytest.approx(other.inertias[k].mass, rel=1e-14)
    for k in range(1, reduced.njoints - 1):  # the last one carries the tip, which its own constants move
        np.testing.assert_allclose(reduced.inertias[k].matrix(), other.inertias[k].matrix(), atol=1e-12)


def test_the_extended_models_gravity_is_the_nominal_load() -> None:
    """Inertias ride with their joints: minus the generalised gravity on the extra joints is the load in their axes."""
    robot = robots.random_robot(8, "RRP")
    components = ("t1", "t2", "axis", "r1", "r2")
    coefficients = tuple(Coefficient(j.name, c, wave(j.name)) for j in robot.joints for c in components)
    model = Model(robot, coefficients)
    q = robots.readings(robot, 5, np.random.default_rng(0))
    gravity = np.array([3.0, -4.0, 8.0])
    loads = gravity_loads(robot, tuple(tree_frames(robot, q)), gravity)
    locked = model.locked(np.zeros(len(coefficients)))
    extended, own, carrier = locked.model, locked.own, locked.carrier
    extended.gravity.linear = gravity
    for n in range(len(q)):
        wide = np.zeros(extended.nq)
        wide[own] = q[n]
        pull = -pin.computeGeneralizedGravity(extended, extended.createData(), wide)
        for k, c in enumerate(coefficients):
            j = robot.names.index(c.where)
            axis = robot.joints[j].axis
            e1, e2 = transverse(axis)
            direction = {"1": e1, "2": e2, "s": axis}[c.component[-1]]
            turns = c.component[0] == "r" or (c.component == "axis" and robot.joints[j].kind == "revolute")
            expected = loads[n, j, 3 * turns : 3 * turns + 3] @ direction
            assert pull[carrier[k]] == pytest.approx(expected, abs=1e-9), c.name


def test_frames_of_a_station_move_its_rows_only() -> None:
    rng = np.random.default_rng(0)
    robot = robots.arid()
    world = tuple((label, robots.random_placement(rng)) for label in ("a", "b"))
    coefficients = tuple(Coefficient("world_base", c, station=s) for s in ("a", "b") for c in FRAME_COMPONENTS)
    model = Model(robot, coefficients, world)
    q = robots.readings(robot, 8, rng)
    station = np.array(list("abbababa"))
    rows = model.rows(q, None, station)
    theta = rng.normal(0, 0.05, 12)
    R, p, J = model.jacobian(theta, rows)
    assert not J[station == "a", :, 6:].any()
    assert not J[station == "b", :, :6].any()
    axes, origins = tip_frames(robot, q)
    for n, label in enumerate(station):
        C = urdf_transform(dict(zip(FRAME_COMPONENTS, theta[:6] if label == "a" else theta[6:], strict=True)))
        T = dict(world)[label] * C * pin.SE3(axes[n], origins[n])
        np.testing.assert_allclose(p[n], T.translation, atol=1e-12)
        np.testing.assert_allclose(R[n], T.rotation, atol=1e-12)
    alone = model.rows(q[:1], None, station[:1])
    np.testing.assert_allclose(model.poses(theta, alone)[1][0], p[0], atol=1e-15)


def test_an_unknown_station_and_a_missing_one_are_named() -> None:
    world = tuple((label, pin.SE3.Identity()) for label in ("a", "b"))
    model = Model(robots.arid(), (), world)
    q = np.zeros((2, 4))
    with pytest.raises(MeasurementError, match=r"'c'.*a, b"):
        model.rows(q, None, np.array(["a", "c"]))
    with pytest.raises(MeasurementError, match="`station` column"):
        model.rows(q)


def test_a_missing_covariate_is_named() -> None:
    model = Model(robots.arid(), (Coefficient("joint_3", "axis", Basis("linear", ("temperature_arm",), (20.0,))),))
    with pytest.raises(CovariateNotFound, match=r"'temperature_arm'.*did you mean 'temperature'"):
        model.rows(np.zeros((2, 4)), {"temperature": np.zeros(2)})


def test_recentring_moves_the_frames_and_no_pose() -> None:
    robot = robots.arid()
    rng = np.random.default_rng(0)
    coefficients = (*robots.FRAMES, *constants(robot, "full"), Coefficient("world_base", "x", TIME))
    model = build(robot, coefficients)
    _, rows = rows_of(model)
    theta = rng.normal(0, 0.3, len(coefficients))
    centred, rest = model.recentred(theta)
    assert not rest[:12].any()
    assert np.array_equal(rest[12:-1], theta[12:-1])
    # The drift is along the frame's own x, which the constants have turned: without it the poses are the same.
    still = np.append(theta[:-1], 0.0)
    centred, rest = model.recentred(still)
    for a, b in zip(model.poses(still, rows), centred.poses(rest, rows), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-13)


def test_a_coefficients_name_says_where_what_and_on_what_it_depends() -> None:
    names = Model(robots.arid(), (
        Coefficient("joint_2", "pitch"),
        Coefficient("world_base", "x", station="b"),
        Coefficient("joint_3", "axis", Basis("linear", ("joint_3.gravity_torque",), (0.0,))),
        Coefficient("joint_1", "yaw", Basis("power", ("joint_1",), (0.0, 1.0, 2.0))),
    )).names  # fmt: skip
    assert names == ("joint_2.pitch", "world_base[b].x", "joint_3.axis:gravity_torque", "joint_1.yaw:joint_1^2")


def test_a_link_may_have_the_name_of_a_joint():
    robot = robots.random_robot(11)
    urdf = robot.urdf.replace(b'"plate_fixed"', b'"plate"').replace(b'"branch_joint"', b'"branch"')
    q = robots.readings(robot, 5, np.random.default_rng(0))
    for got, expected in zip(*(nominal(r, q) for r in (parse_robot(urdf, "tip"), robot)), strict=True):
        np.testing.assert_array_equal(got, expected)


def nominal(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, ...]:
    model = Model(robot, ())
    return *model.poses(np.zeros(0), model.rows(q)), gravity_loads(
        robot, tuple(tree_frames(robot, q)), np.array([1.0, 2.0, -9.81])
    )


def test_the_order_of_the_coefficients_moves_no_pose() -> None:
    """Components of one rank (r1 and roll of an axis askew) do not commute: their order must not hang on who came first."""
    robot = robots.random_robot(0, "PRCR")
    coefficients = tuple(Coefficient("joint_1", c, wave("joint_1")) for c in ("roll", "r1", "z", "axis", "pitch", "r2"))
    theta = np.random.default_rng(0).normal(0, 0.02, len(coefficients))
    one, other = build(robot, coefficients), build(robot, coefficients[::-1])
    (_, rows), (_, same) = rows_of(one), rows_of(other)
    for a, b in zip(one.poses(theta, rows), other.poses(theta[::-1], same), strict=True):
        np.testing.assert_array_equal(a, b)


def test_motions_added_have_the_columns_of_finite_differences_and_leave_the_others() -> None:
    robot = robots.random_robot(4, "RPRC")
    model = Model(robot, varying(robot))
    slots = [*model.own_motions, (robot.names[0], "r1"), ("tip_target", "x")]
    wide = model.with_motions(slots)
    rng = np.random.default_rng(5)
    q, covariates = rng.uniform(-1.0, 1.0, (7, len(robot.readings))), {"time": rng.uniform(0.0, 1.0, 7)}
    theta = np.concatenate([rng.normal(0.0, 1e-2, len(model.coefficients)), np.zeros(len(slots))])
    R, _, J = wide.jacobian(theta, wide.rows(q, covariates))
    count = len(model.coefficients)
    np.testing.assert_array_equal(J[:, :, :count], model.jacobian(theta[:count], model.rows(q, covariates))[2])
    step = 1e-6
    for k in range(count, len(theta)):
        moved = theta.copy()
        moved[k] = step
        R_up, p_up = wide.poses(moved, wide.rows(q, covariates))
        moved[k] = -step
        R_down, p_down = wide.poses(moved, wide.rows(q, covariates))
        np.testing.assert_allclose(J[:, :3, k], (p_up - p_down) / (2 * step), atol=1e-8)
        turn = 0.5 * (R_up - R_down) @ R.transpose(0, 2, 1) / step
        np.testing.assert_allclose(J[:, 3:, k], turn[:, [2, 0, 1], [1, 2, 0]], atol=1e-8)
