"""The answer of 1992 beside the full one."""

from dataclasses import replace

import numpy as np
import pytest
import robots
from heads import ARID, MODEL, START, T_TIP_CAMERA, T_WORLD_BASE, THETA, poses, shots

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.least_squares import Convergence, Fit
from aridcal.engine.model.model import Model
from aridcal.jobs.calibrate.doty_answer import closed_form

LINKS = ("joint_1.beta", "joint_1.alpha", "joint_2.beta", "joint_2.a", "joint_2.alpha", "joint_3.beta", "joint_3.a")


def solved(model: Model, theta: np.ndarray) -> Fit:
    count = len(theta)
    return Fit(
        model, theta, np.eye(count), np.ones(2), np.ones(2), np.zeros(0), np.zeros((0, 6)), (), {},
        Convergence(1, 0.0, 1.0), count, 6.0, np.zeros((count, count)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def rows():
    given, q = shots(20, replace(START, std=1e-9))
    return given.rows, q


def measured(rows, model: Model, theta: np.ndarray, q: np.ndarray):
    T = poses(model, theta, q)
    return robots.placed(rows, position=T[:, :3, 3], rotation=T[:, :3, :3])


def test_on_exact_poses_it_is_the_full_solution_up_to_the_square_of_the_angles(rows):
    rows, q = rows
    coefficients = tuple(Coefficient(*name.split(".")) for name in LINKS)
    model = Model(ARID, coefficients, ((None, T_WORLD_BASE),), ((None, T_TIP_CAMERA),))
    for size in (1e-3, 1e-4):
        theta = size * np.array([1.0, -0.7, 0.6, 0.8, -0.5, 0.9, -1.0])
        used = np.ones(len(rows), dtype=bool)
        found = closed_form(solved(model, theta), measured(rows, model, theta, q), used)
        assert found is not None
        np.testing.assert_allclose(found.links, found.full, atol=20 * size**2)
        assert np.abs(found.residual).max() < 20 * size**2
    assert found.full[1, 3] == pytest.approx(1.98 + 0.8e-4) and found.nominal[1, 3] == pytest.approx(1.98)


def test_another_arm_has_no_such_answer(rows):
    rows, _ = rows
    other = Model(robots.ur10(), ())
    poses = robots.placed(rows, rotation=np.tile(np.eye(3), (20, 1, 1)))
    assert closed_form(solved(other, np.zeros(0)), poses, rows.test) is None


def test_poses_too_few_for_it_give_none(rows):
    rows, q = rows
    used = np.arange(len(rows)) < 2
    assert closed_form(solved(MODEL, THETA), measured(rows, MODEL, THETA, q), used) is None
