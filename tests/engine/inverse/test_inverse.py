"""Readings for a wanted pose: found through the effects, inside the limits, near the seed, or said to be out of reach."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import robots

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.fit.constants import constants
from aridcal.engine.inverse.one_pose import FINEST_NOISE, InverseKinematics
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot

NOISE = (1e-4, 1e-4)


def real(robot: Robot, seed: int, size: float = 1e-3) -> tuple[Model, np.ndarray]:
    """A machine with every constant wrong, a joint that sags and one with a wavy gear."""
    joint, wavy = robot.joints[1].name, robot.joints[2].name
    effects = (
        Coefficient(joint, "axis", Basis("linear", (f"{joint}.gravity_torque",), (0.0,))),
        Coefficient(wavy, "axis", Basis("sin", (wavy,), (11.0,))),
    )
    rng = np.random.default_rng(seed)
    wrong = constants(robot, "full")
    world, tip = ((None, robots.random_placement(rng)),), ((None, robots.random_placement(rng, 0.2)),)
    theta = np.concatenate([rng.normal(0.0, size, len(wrong)), [5e-6, 3e-4]])
    return Model(robot, (*wrong, *effects), world, tip), theta


def inverse_kinematics(
    model: Model, theta: np.ndarray, pose: bool = True, noise: tuple[float, float] = NOISE
) -> InverseKinematics:
    low, high = model.robot.limits.T
    turning = np.array([kind != "prismatic" for kind in model.robot.kinds])
    return InverseKinematics(OneRowModel(model, theta), low, high, turning, pose, noise)


def panda() -> Robot:
    return load_robot(robots.SHARED_ROBOTS / "panda_description/urdf/panda.urdf", "panda_link8")


@pytest.mark.parametrize(
    ("robot", "share"),
    [(robots.ur10(), 1.0), (panda(), 0.9), (robots.random_robot(1, "RPRCRRR"), 0.9)],
    ids=["6", "7", "any"],
)
def test_the_whole_model_puts_the_target_where_it_was_wanted(robot: Robot, share: float) -> None:
    """Second road: the model's own poses of many rows, at the readings that were found."""
    model, theta = real(robot, 4)
    rng = np.random.default_rng(5)
    q = robots.readings(robot, 60, rng, share)
    R, p = model.poses(theta, model.rows(q))
    seeds = q + rng.uniform(-0.05, 0.05, q.shape)
    found = [inverse_kinematics(model, theta).command(*wanted, {}) for wanted in zip(R, p, seeds, strict=True)]
    readings = np.array([c.readings for c in found])
    R_found, p_found = model.poses(theta, model.rows(readings))
    off = np.linalg.norm(p_found - p, axis=1)
    turned = np.linalg.norm([pin.log3(a @ b.T) for a, b in zip(R_found, R, strict=True)], axis=1)
    assert all(c.reached for c in found)
    assert max(off.max(), turned.max()) < FINEST_NOISE
    np.testing.assert_allclose([c.position_error for c in found], off, rtol=0, atol=1e-12)
    np.testing.assert_allclose([c.rotation_error for c in found], turned, rtol=0, atol=1e-10)
    low, high = robot.limits.T
    assert (readings >= low).all() and (readings <= high).all()


def test_a_redundant_arm_stays_near_its_seed() -> None:
    """Its self-motion leads nowhere that is much nearer to the seed than what was found."""
    model, theta = real(panda(), 6)
    inverse = inverse_kinematics(model, theta)
    rng = np.random.default_rng(7)
    nominal = Model(model.robot, (), model.world_base, model.tip_target)
    q = robots.readings(model.robot, 40, rng, 0.7)
    R, p = nominal.poses(np.zeros(0), nominal.rows(q))
    for k in range(len(q)):
        found = inverse.command(R[k], p[k], q[k], {})
        assert found.reached
        _, _, J = inverse.model.jacobian(found.readings, inverse.model.effects(found.readings, {}))
        null = np.linalg.svd(J)[2][-1]
        for share in (-0.1, -0.02, 0.02, 0.1):
            other = inverse.command(R[k], p[k], found.readings + share * null, {})
            assert other.reached
            assert np.linalg.norm(other.readings - q[k]) > 0.97 * np.linalg.norm(found.readings - q[k])


def test_an_arm_of_four_joints_comes_as_near_as_the_weights_say() -> None:
    model, theta = real(robots.arid(), 8)
    nominal = Model(model.robot, (), model.world_base, model.tip_target)
    q = robots.readings(model.robot, 10, np.random.default_rng(9), 0.8)
    R, p = nominal.poses(np.zeros(0), nominal.rows(q))
    for noise in ((1e-4, 1e-3), (1e-3, 1e-4)):
        inverse = inverse_kinematics(model, theta, noise=noise)
        for k in range(len(q)):
            found = inverse.command(R[k], p[k], q[k], {})
            assert found.reached

            def cost(readings: np.ndarray, k: int = k, inverse: InverseKinematics = inverse) -> float:
                at, position = inverse.model.pose(readings, inverse.model.effects(readings, {}))
                off, turn = np.linalg.norm(p[k] - position), np.linalg.norm(pin.log3(R[k] @ at.T))
                return float((off / noise[0]) ** 2 + (turn / noise[1]) ** 2)  # noqa: B023

            best = cost(found.readings)
            around = [cost(found.readings + s * 1e-4 * np.eye(4)[j]) for j in range(4) for s in (-1, 1)]
            assert min(around) > best


def test_positions_alone_leave_the_orientation_free() -> None:
    model, theta = real(robots.ur10(), 10)
    inverse = inverse_kinematics(model, theta, pose=False, noise=(1e-4, 1.0))
    q = robots.readings(model.robot, 10, np.random.default_rng(11), 0.5)
    _, p = model.poses(theta, model.rows(q))
    for row, wanted in zip(q, p, strict=True):
        found = inverse.command(np.full((3, 3), np.nan), wanted, row + 0.1, {})
        assert found.reached and np.isnan(found.rotation_error)
        assert found.position_error < FINEST_NOISE
        assert np.abs(found.readings - row - 0.1).max() < 0.2


def test_limits_are_kept_and_what_lies_beyond_them_is_out_of_reach() -> None:
    model, theta = real(robots.arid(), 12)
    inverse = inverse_kinematics(model, theta)
    low, high = model.robot.limits.T
    q = (low + high) / 2
    q[2] = high[2] + 0.1
    R, p = model.poses(theta, model.rows(q[None]))
    found = inverse.command(R[0], p[0], q, {})
    assert not found.reached
    assert found.readings[2] == high[2]
    clipped = inverse.error(R[0], p[0], np.minimum(q, high), {})[0]
    assert np.hypot(found.position_error, found.rotation_error) < np.linalg.norm(clipped)  # the others did their best


def test_a_pose_out_of_reach_is_said_to_be() -> None:
    model, theta = real(robots.ur10(), 13)
    inverse = inverse_kinematics(model, theta)
    R, p = model.poses(theta, model.rows(np.zeros((1, 6))))
    base = model.world_base[0][1].translation
    away = p[0] + 0.5 * (p[0] - base) / np.linalg.norm(p[0] - base)
    found = inverse.command(R[0], away, np.full(6, 0.3), {})
    assert not found.reached
    assert found.position_error > 0.1


def test_backlash_by_load_is_commanded_on_its_own_side() -> None:
    robot = robots.arid()
    jump = Coefficient("joint_2", "axis", Basis("sign", ("joint_2.gravity_torque",)))
    model = Model(robot, (jump,), around=Surroundings(np.array([0.0, 9.81, 0.0])))
    theta = np.array([5e-4])
    inverse = inverse_kinematics(model, theta)
    nominal = Model(robot, ())
    q = robots.readings(robot, 30, np.random.default_rng(14), 0.9)
    R, p = nominal.poses(np.zeros(0), nominal.rows(q))
    for k in range(len(q)):
        found = inverse.command(R[k], p[k], q[k], {})
        assert found.reached
        assert abs(abs(found.readings[1] - q[k, 1]) - 5e-4) < 1e-6
