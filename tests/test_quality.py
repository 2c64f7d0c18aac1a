"""How far a calibration can be trusted: each figure against a simulation that knows the answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import robots
from scipy.spatial.transform import Rotation

from aridcal.effects import Basis, Coefficient
from aridcal.geometry import constants
from aridcal.model import Model
from aridcal.quality import (
    accuracy,
    halves,
    joint_kinds,
    joint_limits,
    outliers,
    precision,
    repeats,
    target_sigma,
)
from aridcal.residual import Observations
from aridcal.robot import parse_robot
from aridcal.solver import Data, Fit, Noise, fit, fit_identifiable


def example(n: int = 200, noise: float = 1e-4, seed: int = 0) -> tuple[robots.Truth, Fit, Data]:
    """The ARID, its identifiable constants fitted to noisy poses."""
    rng = np.random.default_rng(seed)
    truth = robots.simulate(robots.arid(), n, rng, 1e-3, noise, world=robots.random_placement(rng))
    model = truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))
    data = truth.data(model)
    found = fit_identifiable(model, data, Noise(noise, noise), range(len(model.coefficients)))
    return truth, found, truth.data(found.model)


def test_kinds_and_limits_are_those_of_the_columns() -> None:
    robot = robots.arid()
    assert joint_kinds(robot) == ("prismatic", "revolute", "revolute", "revolute")
    np.testing.assert_allclose(joint_limits(robot)[0], [0.0, 718 * 0.0254])
    urdf = robots.random_chain(np.random.default_rng(0), "RCP")
    end = urdf.index(b"</joint>", urdf.index(b'<joint name="joint_1"'))
    urdf = urdf[:end] + b'<mimic joint="joint_2"/>' + urdf[end:]
    follower = parse_robot(urdf, "tip")
    assert follower.readings == ("joint_2", "joint_3")
    assert joint_kinds(follower) == ("continuous", "prismatic")
    assert np.isinf(joint_limits(follower)[0]).all()


def test_scatter_of_repeats_is_the_noise_whatever_the_model_lacks() -> None:
    """30 configurations, 6 times each; the residuals also hold an error of the model, a hundred times the noise."""
    rng = np.random.default_rng(1)
    robot = robots.arid()
    q = np.repeat(robots.readings(robot, 30, rng), 6, axis=0)
    truth = robots.Truth(Model(robot, ()), np.zeros(0), q, Observations(np.zeros((180, 3)), None))
    rows = robots.measurements(truth)
    r = np.repeat(rng.normal(0, 1e-2, (30, 6)), 6, axis=0)
    r += np.hstack([rng.normal(0, 1e-4, (180, 3)), rng.normal(0, 3e-4, (180, 3))])
    found = repeats(robot, rows, r)
    assert found is not None
    assert (found.groups, found.rows) == (30, 180)
    assert found.sigma.position == pytest.approx(1e-4, rel=0.1)
    assert found.sigma.rotation == pytest.approx(3e-4, rel=0.1)
    # ISO 9283's RP of isotropic noise: the mean and three standard deviations of a chi with three degrees.
    chi = np.linalg.norm(rng.normal(size=(200000, 3)), axis=1)
    assert found.repeatability == pytest.approx(1e-4 * (chi.mean() + 3 * chi.std()), rel=0.1)


def test_rows_that_never_repeat_have_no_scatter() -> None:
    truth, found, _ = example(40)
    assert repeats(truth.model.robot, robots.measurements(truth), found.residual) is None


def test_sigma_of_the_target_is_the_scatter_of_repeated_calibrations() -> None:
    """60 campaigns of 40 rows each: RMS over poses of predicted sigma against the scatter seen."""
    rng = np.random.default_rng(2)
    truth, first, data = example(40)
    model = first.model
    query = model.rows(robots.readings(model.robot, 60, rng))
    R, p = truth.model.poses(truth.theta, model.rows(truth.readings))
    seen = []
    for _ in range(60):
        turn = Rotation.from_rotvec(1e-4 * rng.normal(size=p.shape)).as_matrix()
        measured = Observations(p + 1e-4 * rng.normal(size=p.shape), turn @ R)
        found = fit(model, replace(data, measured=measured), Noise(1e-4, 1e-4), weight=np.ones(40))
        seen.append(model.poses(found.theta, query)[1])
    position, rotation = target_sigma(found, Data(query, measured, np.zeros(60, dtype=bool)))
    worst = [np.sqrt(np.linalg.eigvalsh(np.cov(np.array(seen)[:, n].T))[-1]) for n in range(60)]
    assert np.sqrt(np.mean(position**2)) == pytest.approx(np.sqrt(np.mean(np.square(worst))), rel=0.1)
    assert (rotation > 0).all()


def test_precision_covers_rows_and_reach() -> None:
    truth, found, data = example(100)
    result = precision(found, robots.measurements(truth), data, (1.0, 2.0))
    assert result.position.shape == (100,)
    assert len(result.reach) > 100
    assert result.reach.max() >= 0.9 * result.position.max()
    assert (result.halves_measured, result.halves_expected) == (1.0, 2.0)


def test_two_halves_differ_as_the_noise_makes_them() -> None:
    ratios = []
    for seed in range(6):
        truth, found, data = example(160, seed=seed)
        measured, expected = halves(found, robots.measurements(truth), data, Noise(1e-4, 1e-4))
        ratios.append(measured / expected)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.25)


def test_two_halves_betray_a_model_that_does_not_fit() -> None:
    """A harmonic of 3 mrad that no constant can hold, and too few rows to average it out."""
    rng = np.random.default_rng(3)
    truth, _, _ = example(60)
    bent = truth.model.with_coefficients(
        (*truth.model.coefficients, Coefficient("joint_2", "axis", Basis("sin", ("joint_2",), (7.0,))))
    )
    R, p = bent.poses(np.append(truth.theta, 3e-3), bent.rows(truth.readings))
    measured = Observations(p + 1e-4 * rng.normal(size=p.shape), R)
    truth = replace(truth, measured=measured)
    model = truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))
    found = fit_identifiable(model, truth.data(model), Noise(1e-4, 1e-4), range(len(model.coefficients)))
    seen, expected = halves(found, robots.measurements(truth), truth.data(found.model), Noise(1e-4, 1e-4))
    assert seen > 5 * expected


def test_halves_that_are_too_small_say_nothing() -> None:
    truth, found, data = example(8)
    assert np.isnan(halves(found, robots.measurements(truth), data, Noise(1e-4, 1e-4))).all()


def test_a_test_row_is_flagged_only_if_it_is_far_off_at_every_stage() -> None:
    rng = np.random.default_rng(4)
    train = np.arange(100) < 80
    nominal, final = rng.normal(0, 1e-3, (100, 6)), rng.normal(0, 1e-4, (100, 6))
    flags = np.zeros(80, dtype=bool)
    flags[3] = True
    nominal[90], final[90] = 0.5, 0.5  # off everywhere
    nominal[91] = 0.0
    final[91, 0] = 0.5  # the final model alone is off: that is an error, not an outlier
    nominal[92] = 0.5  # what the final model explains is none either
    found = outliers(train, flags, [nominal, final])
    assert set(np.flatnonzero(found)) == {3, 90}


def test_accuracy_is_the_distance_of_each_configurations_centre() -> None:
    rng = np.random.default_rng(5)
    robot = robots.arid()
    q = np.repeat(robots.readings(robot, 20, rng), 5, axis=0)
    truth = robots.Truth(Model(robot, ()), np.zeros(0), q, Observations(np.zeros((100, 3)), None))
    centre = rng.normal(0, 1e-3, (20, 3))
    jitter = rng.normal(0, 1e-4, (20, 5, 3))
    jitter -= jitter.mean(axis=1, keepdims=True)
    r = (centre[:, None] + jitter).reshape(100, 3)
    found = accuracy(robot, robots.measurements(truth), r)
    np.testing.assert_allclose(np.sort(found), np.sort(np.linalg.norm(centre, axis=1)), rtol=1e-9)
    assert accuracy(robot, robots.measurements(truth).select(np.zeros(100, dtype=bool)), r[:0]).size == 0
