"""How far a calibration can be trusted: each figure against a simulation that knows the answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import robots
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable
from aridcal.engine.fit.noise import repeats
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.model.model import Model, ModelRows
from aridcal.engine.robot.chain import parse_robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.uncertainty import outliers, precision, target_sigma, with_contradicted_noise


def example(n: int = 200, noise: float = 1e-4, seed: int = 0) -> tuple[robots.Truth, Fit, Dataset]:
    """The ARID, its identifiable constants fitted to noisy poses, and those with the noise declared."""
    rng = np.random.default_rng(seed)
    truth = robots.simulate(robots.arid(), n, rng, 1e-3, noise, world=robots.random_placement(rng))
    model = truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))
    found = fit_identifiable(truth.data(model, noise, noise), range(len(model.coefficients)))
    return truth, found, robots.declared(truth.measured, noise, noise)


def test_kinds_and_limits_are_those_of_the_columns() -> None:
    robot = robots.arid()
    assert robot.kinds == ("prismatic", "revolute", "revolute", "revolute")
    np.testing.assert_allclose(robot.limits[0], [0.0, 718 * 0.0254])
    urdf = robots.random_chain(np.random.default_rng(0), "RCP")
    end = urdf.index(b"</joint>", urdf.index(b'<joint name="joint_1"'))
    urdf = urdf[:end] + b'<mimic joint="joint_2"/>' + urdf[end:]
    follower = parse_robot(urdf, "tip")
    assert follower.readings == ("joint_2", "joint_3")
    assert follower.kinds == ("continuous", "prismatic")
    assert np.isinf(follower.limits[0]).all()


def test_scatter_of_repeats_is_the_noise_whatever_the_model_lacks() -> None:
    """30 configurations, 6 times each; the residuals also hold an error of the model, a hundred times the noise."""
    rng = np.random.default_rng(1)
    robot = robots.arid()
    q = np.repeat(robots.readings(robot, 30, rng), 6, axis=0)
    rows = robots.measured(robot, q, rng.normal(size=(180, 3)), np.tile(np.eye(3), (180, 1, 1)))
    r = np.repeat(rng.normal(0, 1e-2, (30, 6)), 6, axis=0)
    r += np.hstack([rng.normal(0, 1e-4, (180, 3)), rng.normal(0, 3e-4, (180, 3))])
    found = repeats(rows, r)
    assert found is not None
    assert (found.groups, found.rows) == (30, 180)
    assert found.sigma[0] == pytest.approx(1e-4, rel=0.1)
    assert found.sigma[1] == pytest.approx(3e-4, rel=0.1)
    # ISO 9283's RP of isotropic noise: the mean and three standard deviations of a chi with three degrees.
    chi = np.linalg.norm(rng.normal(size=(200000, 3)), axis=1)
    assert found.repeatability == pytest.approx(1e-4 * (chi.mean() + 3 * chi.std()), rel=0.1)


def test_copies_of_a_pose_are_no_repeats_of_it() -> None:
    """Whatever else their rows say: a copied row would make the noise look like nothing."""
    rng = np.random.default_rng(2)
    robot = robots.arid()
    q = np.repeat(robots.readings(robot, 20, rng), 2, axis=0)
    position, r = rng.normal(size=(40, 3)), rng.normal(0, 1e-4, (40, 6))
    turn = np.tile(np.eye(3), (40, 1, 1))
    position[1], r[1] = position[0], r[0]
    found = repeats(robots.measured(robot, q, position, turn), r)
    assert found is not None
    assert (found.groups, found.rows) == (19, 38)
    assert found.sigma[0] == pytest.approx(1e-4, rel=0.25)  # 57 degrees of freedom: 9 % each
    position[1::2], r[1::2] = position[::2], r[::2]
    assert repeats(robots.measured(robot, q, position, turn), r) is None


def test_rows_that_never_repeat_have_no_scatter() -> None:
    truth, found, _ = example(40)
    assert repeats(truth.measured, found.residual) is None


def worst(scatter: np.ndarray) -> np.ndarray:
    """Standard deviation in the worst direction of many points or small turns at each of N places: (many, N, 3) to (N,)."""
    off = scatter - scatter.mean(axis=0)
    covariance = np.einsum("sni,snj->nij", off, off) / (len(scatter) - 1)
    return np.sqrt(np.linalg.eigvalsh(covariance)[:, -1])


def again(truth: robots.Truth, rng: np.random.Generator, q: np.ndarray | None = None) -> robots.Truth:
    """The same configurations, or others, measured anew."""
    q = truth.readings if q is None else q
    R, p = truth.model.poses(truth.theta, truth.model.rows(q))
    turn = Rotation.from_rotvec(1e-4 * rng.normal(size=p.shape)).as_matrix()
    p = p + 1e-4 * rng.normal(size=p.shape)
    return replace(truth, measured=robots.measured(truth.model.robot, q, p, turn @ R))


def fitted(truth: robots.Truth, model: Model, some: np.ndarray | None = None) -> Fit:
    whole = truth.data(model, 1e-4, 1e-4)
    asked = whole if some is None else whole.select(some)
    return fit(asked, weight=np.ones(len(asked)))


def test_sigma_of_the_target_is_the_scatter_of_repeated_calibrations() -> None:
    """60 campaigns of 40 rows each: RMS over poses of predicted sigma against the scatter seen."""
    rng = np.random.default_rng(2)
    truth, first, _ = example(40)
    model = first.model
    query = model.rows(robots.readings(model.robot, 60, rng))
    position, rotation = target_sigma(first, query)
    middle, _ = model.poses(first.theta, query)
    places, turns = [], []
    for _ in range(60):
        R, p = model.poses(fitted(again(truth, rng), model).theta, query)
        places.append(p)
        turns.append(Rotation.from_matrix(R @ middle.transpose(0, 2, 1)).as_rotvec())
    for predicted, seen in ((position, places), (rotation, turns)):
        scatter = worst(np.array(seen))
        assert np.sqrt(np.mean(predicted**2)) == pytest.approx(np.sqrt(np.mean(scatter**2)), rel=0.1)
        np.testing.assert_allclose(predicted, scatter, rtol=0.5)


@pytest.mark.parametrize("stated", [0.3e-4, 1e-4, 3e-4], ids=["too small", "as it is", "too large"])
def test_sigma_of_the_target_is_its_scatter_though_the_noise_of_positions_was_stated_too_small(stated: float) -> None:
    """40 campaigns whose positions scatter by 1e-4 m; what is stated weighs them, and must not make them look surer."""
    rng = np.random.default_rng(3)
    truth, first, _ = example(40)
    query = first.model.rows(robots.readings(first.model.robot, 40, rng))
    places, predicted = [], []
    for _ in range(40):
        rows = robots.declared(again(truth, rng).measured, stated, 1e-4)
        asked = problem(first.model, rows)
        plain = fit(asked, weight=np.ones(len(asked)))
        found = with_contradicted_noise(plain, rows)
        assert (found is plain) == (stated >= 1e-4)
        predicted.append(target_sigma(found, query)[0])
        places.append(found.model.poses(found.theta, query)[1])
    ratio = np.sqrt(np.mean(np.square(predicted)) / np.mean(worst(np.array(places)) ** 2))
    assert ratio > 1.0 if stated > 1e-4 else ratio == pytest.approx(1.0, rel=0.12)


def test_precision_is_that_of_the_rows() -> None:
    """Second road: coefficients drawn from their covariance."""
    rng = np.random.default_rng(7)
    _, found, data = example(100)
    model = found.model
    result = precision(found, data)
    draws = rng.multivariate_normal(found.theta, found.covariance, 300)

    def drawn(rows: ModelRows) -> np.ndarray:
        return worst(np.array([model.poses(theta, rows)[1] for theta in draws]))

    assert np.median(result.position / drawn(model.rows(data.readings))) == pytest.approx(1.0, abs=0.05)


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
    found = outliers(train, flags, [nominal, final], (TARGET_POSITION, TARGET_ROTATION))
    assert set(np.flatnonzero(found)) == {3, 90}
