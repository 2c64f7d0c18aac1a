"""The solver: exact data, wild rows, honest covariance, against repeated fits and another least-squares code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import robots
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from aridcal.effects import Coefficient
from aridcal.errors import NotIdentifiable
from aridcal.geometry import constants
from aridcal.model import Model, Rows
from aridcal.residual import (
    FLOOR,
    Observations,
    Sigma,
    linearise,
    normal,
    predict_residuals,
    residuals,
    robust_sigma,
    triangle,
)
from aridcal.solver import Data, Noise, Prior, fit, fit_identifiable, flag, minimise, thin

FEW = tuple(Coefficient(*name.split(".")) for name in ("joint_2.pitch", "joint_3.x", "joint_3.yaw", "joint_4.roll"))


TWINS = (*FEW, Coefficient("flange_fixed", "yaw"), Coefficient("tip_target", "yaw"))
"""The last two are the same rotation where the target's frame is the flange's."""


def small(
    rows: int, rng: np.random.Generator, noise: float, coefficients: tuple[Coefficient, ...] = FEW
) -> tuple[Model, np.ndarray, Data]:
    """A few well-determined constants of the ARID, their truth, and rows measured of it."""
    tip = pin.SE3.Identity() if coefficients == TWINS else robots.random_placement(rng, 0.3)
    model = Model(robots.arid(), coefficients, ((None, robots.random_placement(rng)),), ((None, tip),))
    theta = rng.normal(0, 1e-3, len(coefficients))
    q = robots.readings(model.robot, rows, rng)
    return model, theta, measure(model, theta, q, noise, rng)


def measure(model: Model, theta: np.ndarray, q: np.ndarray, noise: float, rng: np.random.Generator) -> Data:
    rows = model.rows(q)
    R, p = model.poses(theta, rows)
    p = p + noise * rng.normal(size=p.shape)
    R = Rotation.from_rotvec(noise * rng.normal(size=p.shape)).as_matrix() @ R
    return Data(rows, Observations(p, R), np.zeros(len(q), dtype=bool))


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize("robot", [robots.arid, robots.ur10, lambda: robots.random_robot(1, "RPRCR")])
def test_exact_data_gives_back_the_true_coefficients(robot, kind: str) -> None:  # type: ignore[no-untyped-def]
    """Truth within the identifiable set, frames nearly known: back to 1e-9, and nobody is an outlier."""
    rng = np.random.default_rng(0)
    bare = robots.simulate(
        robot(), 120, rng, 0.0, world=robots.random_placement(rng), tip=robots.random_placement(rng, 0.3), kind=kind
    )
    candidates = (*robots.FRAMES, *constants(bare.model.robot, "full"))
    model = bare.model.with_coefficients(candidates)
    first = fit_identifiable(model, bare.data(model), Noise(), range(len(candidates)))
    kept = first.model
    theta = rng.normal(0, 3e-3, len(kept.coefficients))
    R, p = kept.poses(theta, kept.rows(bare.readings))
    data = Data(model.rows(bare.readings), Observations(p, R if kind == "pose" else None), np.zeros(120, dtype=bool))
    found = fit_identifiable(model, data, Noise(), range(len(candidates)))
    assert found.model.names == kept.names
    np.testing.assert_allclose(found.theta, theta, atol=1e-9, rtol=0)
    assert not found.outliers.any()
    assert found.estimated.position < 1e-11
    assert found.convergence.converged


def test_no_noise_is_estimated_as_the_floor() -> None:
    model, theta, data = small(40, np.random.default_rng(0), 0.0)
    found = fit(model, data, Noise())
    assert FLOOR <= found.sigma.position < 1e-13 + FLOOR
    np.testing.assert_allclose(found.theta, theta, atol=1e-12)


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_the_minimum_is_scipys(kind: str) -> None:
    """Residuals written out here, declared sigmas, another solver with numerical derivatives."""
    rng = np.random.default_rng(1)
    model, _, data = small(40, rng, 1e-3)
    if kind == "position":
        data = replace(data, measured=Observations(data.measured.position, None))
    sigma = np.repeat([1e-3, 3e-3], 3)
    found = fit(model, data, Noise(1e-3, 3e-3), weight=np.ones(40))

    def whitened(theta: np.ndarray) -> np.ndarray:
        R, p = model.poses(theta, data.rows)
        r = data.measured.position - p
        if data.measured.rotation is not None:
            turn = np.array([pin.log3(M @ P.T) for M, P in zip(data.measured.rotation, R, strict=True)])
            r = np.hstack([r, turn])
        return (r / sigma[: r.shape[1]]).ravel()

    other = least_squares(whitened, np.zeros(4), xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=1e-3)
    step = np.abs(found.theta - other.x) / found.std
    assert step.max() < 1e-3
    np.testing.assert_allclose(found.covariance, np.linalg.inv(other.jac.T @ other.jac), rtol=1e-2, atol=1e-12)


def test_outliers_are_flagged_and_do_no_harm() -> None:
    """5 % of the rows off by 20 to 100 sigma, in position or rotation: every one found, none but those."""
    rng = np.random.default_rng(2)
    model, theta, data = small(400, rng, 1e-4)
    clean = fit(model, data, Noise())
    wild = rng.choice(400, 20, replace=False)
    push = rng.normal(size=(20, 3))
    push *= 1e-4 * rng.uniform(20, 100, (20, 1)) / np.linalg.norm(push, axis=1, keepdims=True)
    p, R = data.measured.position.copy(), data.measured.rotation.copy()  # type: ignore[union-attr]
    p[wild[:10]] += push[:10]
    R[wild[10:]] = Rotation.from_rotvec(push[10:]).as_matrix() @ R[wild[10:]]
    found = fit(model, replace(data, measured=Observations(p, R)), Noise())
    assert set(np.flatnonzero(found.outliers)) == set(wild)
    assert (np.abs(found.theta - clean.theta) < 1.5 * clean.std).all()
    assert (np.abs(found.theta - theta) < 4 * found.std).all()
    assert found.sigma.position == pytest.approx(1e-4, rel=0.1)


def test_rows_off_by_half_a_metre_do_no_harm() -> None:
    rng = np.random.default_rng(3)
    model, theta, data = small(300, rng, 1e-4)
    p = data.measured.position.copy()
    p[:24] += rng.uniform(-0.5, 0.5, (24, 3))
    found = fit(model, replace(data, measured=Observations(p, data.measured.rotation)), Noise())
    assert found.outliers[:24].all()
    assert not found.outliers[24:].any()
    assert (np.abs(found.theta - theta) < 4 * found.std).all()


def test_a_suspect_row_is_flagged_sooner() -> None:
    """A reading repeated bit for bit though the joints moved: 4 sigma is enough for it, not for others."""
    r = np.zeros((400, 6))
    rng = np.random.default_rng(0)
    r[:] = rng.normal(0, 1e-4, r.shape)
    sigma = robust_sigma(r)
    r[0], r[1] = 0.0, 0.0
    r[0, 0] = r[1, 0] = 4.5 * sigma.position
    suspect = np.zeros(400, dtype=bool)
    suspect[0] = True
    assert flag(r, suspect)[:2].tolist() == [0.0, 1.0]


def test_predicted_covariance_matches_repeated_fits() -> None:
    """200 repetitions: normalised squared errors average to the number of coefficients, and 2 sigma covers 95 %."""
    rng = np.random.default_rng(4)
    model, theta, data = small(25, rng, 0.0)
    q = data.rows.positions
    errors, squares = [], []
    for _ in range(200):
        found = fit(model, measure(model, theta, q, 2e-4, rng), Noise(2e-4, 2e-4))
        off = found.theta - theta
        errors.append(off / found.std)
        squares.append(off @ np.linalg.solve(found.covariance, off))
    K = len(theta)
    assert np.mean(squares) == pytest.approx(K, abs=4 * np.sqrt(2 * K / 200))
    assert np.mean(np.abs(errors) < 2) == pytest.approx(0.9545, abs=0.03)
    np.testing.assert_allclose(np.std(errors, axis=0), 1.0, atol=0.2)


def test_estimated_noise_is_unbiased_even_with_few_rows() -> None:
    """Degrees of freedom count: 4 rows and 4 coefficients leave 20 of 24."""
    rng = np.random.default_rng(5)
    model, theta, data = small(4, rng, 0.0)
    squares = []
    for _ in range(150):
        again = measure(model, theta, data.rows.positions, 1e-3, rng)
        found = fit(model, again, Noise(), weight=np.ones(4))
        squares.append([found.sigma.position**2, found.sigma.rotation**2])
    np.testing.assert_allclose(np.mean(squares, axis=0), 1e-6, rtol=0.15)


def test_declared_noise_is_used_and_estimated_noise_reported() -> None:
    rng = np.random.default_rng(6)
    model, _, data = small(200, rng, 1e-4)
    declared, free = fit(model, data, Noise(5e-4, 5e-4)), fit(model, data, Noise())
    assert declared.sigma == Sigma(5e-4, 5e-4)
    assert declared.estimated.position == pytest.approx(1e-4, rel=0.1)
    assert free.sigma.position == pytest.approx(free.estimated.position, rel=1e-6)
    # Both halves scaled alike: the same minimum, and sigmas in proportion.
    np.testing.assert_allclose(declared.std / free.std, 5e-4 / free.sigma.position, rtol=0.1)
    half = fit(model, data, Noise(declared_position=5e-4))
    assert half.sigma.position == 5e-4
    assert half.sigma.rotation == pytest.approx(1e-4, rel=0.1)


def test_rows_weigh_by_their_relative_sigmas() -> None:
    """A tenth of the rows is ten times as good. The common scale is found, and the answer as good as theory allows."""
    rng = np.random.default_rng(7)
    model, theta, data = small(200, rng, 0.0)
    scale = np.where(np.arange(200) % 10 == 0, 0.1, 1.0)
    relative = np.repeat(scale[:, None], 6, axis=1)
    relative /= np.sqrt(np.mean(relative**2))
    off, blind = [], []
    for _ in range(30):
        p = data.measured.position + 1e-3 * scale[:, None] * rng.normal(size=(200, 3))
        turn = 1e-3 * scale[:, None] * rng.normal(size=(200, 3))
        R = Rotation.from_rotvec(turn).as_matrix() @ data.measured.rotation
        found = fit(model, replace(data, measured=Observations(p, R, relative)), Noise())
        assert not found.outliers.any()
        off.append((found.theta - theta) / found.std)
        blind.append((fit(model, replace(data, measured=Observations(p, R)), Noise()).theta - theta) / found.std)
    assert found.sigma.position == pytest.approx(1e-3 * np.sqrt(np.mean(scale**2)), rel=0.1)
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.25)
    assert np.sqrt(np.mean(np.square(blind))) > 1.5


def test_axes_of_a_row_may_weigh_unequally() -> None:
    """Rotation noise a hundred times as large about one world axis: the minimum is still scipy's."""
    rng = np.random.default_rng(8)
    model, _, data = small(30, rng, 2e-3)
    relative = np.tile([1.0, 3.0, 0.3, 5.0, 0.05, 0.5], (30, 1))
    data = replace(data, measured=replace(data.measured, relative=relative))
    found = fit(model, data, Noise(1e-3, 1e-3), weight=np.ones(30))

    def whitened(theta: np.ndarray) -> np.ndarray:
        return (predict_residuals(model, theta, data.rows, data.measured) / relative / 1e-3).ravel()

    other = least_squares(whitened, found.theta, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=found.std)
    assert np.abs((found.theta - other.x) / found.std).max() < 5e-3


def test_redundant_parameters_stay_nominal_and_are_named() -> None:
    """flange_fixed.yaw and tip_target.yaw turn the target alike: the first is kept and takes it all."""
    rng = np.random.default_rng(9)
    model, _, _ = small(60, rng, 0.0, TWINS)
    q = robots.readings(model.robot, 60, rng)
    truth = np.array([1e-3, -2e-3, 1e-3, 3e-3, 4e-3, 5e-3])
    found = fit_identifiable(model, measure(model, truth, q, 1e-5, rng), Noise(1e-5, 1e-5), range(6))
    assert found.model.coefficients == TWINS[:5]
    assert found.redundant["tip_target.yaw"] == ("flange_fixed.yaw",)
    assert found.theta[4] == pytest.approx(9e-3, abs=1e-4)
    assert found.candidates == TWINS
    swapped = fit_identifiable(model, measure(model, truth, q, 1e-5, rng), Noise(1e-5, 1e-5), [0, 1, 2, 3, 5, 4])
    assert swapped.redundant == {"flange_fixed.yaw": ("tip_target.yaw",)}


def test_nothing_to_tell_apart_is_an_error_that_names_all() -> None:
    rng = np.random.default_rng(0)
    wrist = tuple(Coefficient("tip_target", c) for c in ("roll", "pitch"))
    model, _, data = small(20, rng, 1e-4, wrist)
    data = replace(data, measured=Observations(data.measured.position, None))
    with pytest.raises(NotIdentifiable, match=r"tip_target\.roll with tip_target\.pitch"):
        fit_identifiable(model, data, Noise(), range(2))


def test_far_starts_lead_to_the_same_minimum() -> None:
    rng = np.random.default_rng(10)
    model, theta, data = small(60, rng, 1e-4)
    best = fit(model, data, Noise())
    for _ in range(10):
        other = minimise(model, data, theta + rng.uniform(-0.5, 0.5, 4), Noise(), np.ones(60))
        assert (np.abs(other.theta - best.theta) < 1e-2 * best.std).all()
        assert other.gradient < 1e-2


def test_a_prior_holds_what_nothing_measures() -> None:
    """Normal equations with a prior: what the data do not see stays at its mean, the rest at the data's."""
    rng = np.random.default_rng(11)
    model, _, data = small(60, rng, 1e-4, TWINS)
    mean = np.array([0, 0, 0, 0, 2e-3, 2e-3])
    prior = Prior(mean, np.diag([0, 0, 0, 0, 1.0, 1.0]) * 1e4)
    found = fit(model, data, Noise(1e-4, 1e-4), prior=prior)
    free = fit(model.with_coefficients(model.coefficients[:5]), data, Noise(1e-4, 1e-4))
    assert found.theta[4] == pytest.approx(found.theta[5], abs=1e-9)  # what is left is shared alike
    assert found.theta[4] + found.theta[5] == pytest.approx(free.theta[4], abs=3 * free.std[4])
    assert found.std[5] == pytest.approx(np.sqrt(1e-4 / 2), rel=0.01)


def test_residual_is_measured_minus_predicted_in_world_axes() -> None:
    R, M = Rotation.random(5, random_state=0).as_matrix(), Rotation.random(5, random_state=1).as_matrix()
    p, m = np.random.default_rng(0).normal(size=(2, 5, 3))
    r = residuals(R, p, Observations(m, M))
    assert np.array_equal(r[:, :3], m - p)
    np.testing.assert_allclose(Rotation.from_rotvec(r[:, 3:]).as_matrix() @ R, M, atol=1e-12)


def test_blocks_of_rows_add_up() -> None:
    """More rows than one block: sums, triangle and residuals are those of the whole Jacobian."""
    rng = np.random.default_rng(12)
    model, theta, data = small(1100, rng, 1e-3)
    weight, sigma = rng.uniform(0, 1, 1100), Sigma(1e-3, 2e-3)
    r, J = linearise(model, theta, data.rows, data.measured)
    W = np.sqrt(weight)[:, None] / np.repeat([1e-3, 2e-3], 3)
    A, b = (J * W[:, :, None]).reshape(-1, 4), (r * W).ravel()
    sums = normal(model, theta, data.rows, data.measured, weight, sigma)
    np.testing.assert_allclose(sums.hessian(sigma), A.T @ A, rtol=1e-10, atol=1e-3)
    np.testing.assert_allclose(sums.gradient(sigma), A.T @ b, rtol=1e-9)
    R = triangle(model, theta, data.rows, data.measured, weight, sigma)
    np.testing.assert_allclose(R.T @ R, A.T @ A, rtol=1e-9, atol=1e-3)


def test_noise_found_robustly_is_that_of_the_bulk() -> None:
    r = np.random.default_rng(0).normal(0, [1e-4] * 3 + [3e-4] * 3, (20000, 6))
    clean = robust_sigma(r)
    assert clean.position == pytest.approx(1e-4, rel=0.02)
    assert clean.rotation == pytest.approx(3e-4, rel=0.02)
    r[:1000] *= 1000
    assert robust_sigma(r).position < 1.2e-4


def test_thinning_is_reproducible_keeps_the_order_and_leaves_no_frame_out() -> None:
    tip = np.zeros(1000, dtype=int)
    tip[[3, 500, 900]] = 1
    rows = Rows(np.zeros((1000, 1)), np.empty((1000, 0)), np.zeros(1000, dtype=int), tip)
    some = thin(rows, 100)
    assert len(set(some.tolist())) == len(some) == 102
    assert np.array_equal(some, np.sort(some))
    assert np.array_equal(some, thin(rows, 100))
    assert {3, 500, 900} <= set(some.tolist())
    assert np.array_equal(thin(rows[:50], 100), np.arange(50))
