"""The solver: exact data, wild rows, honest covariance, against repeated fits and another least-squares code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import robots
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit import least_squares as least_squares_module
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.flags import OUTLIER, SUSPECT_LIMIT, outlier_rows, robust_sigma
from aridcal.engine.fit.least_squares import fit, fit_identifiable, minimise, thin
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import ROWS_PER_BLOCK, Problem, problem
from aridcal.engine.fit.residual import linearise, triangle
from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.instruments.pose import residuals
from aridcal.engine.model.model import Model, ModelRows
from aridcal.engine.numerics import FLOOR
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.errors import NotIdentifiable

POSE = (TARGET_POSITION, TARGET_ROTATION)
FEW = tuple(Coefficient(*name.split(".")) for name in ("joint_2.pitch", "joint_3.x", "joint_3.yaw", "joint_4.roll"))


TWINS = (*FEW, Coefficient("flange_fixed", "yaw"), Coefficient("tip_target", "yaw"))
"""The last two are the same rotation where the target's frame is the flange's."""


def small(
    rows: int, rng: np.random.Generator, noise: float, coefficients: tuple[Coefficient, ...] = FEW
) -> tuple[Model, np.ndarray, Dataset]:
    """A few well-determined constants of the ARID, their truth, and rows measured of it."""
    tip = pin.SE3.Identity() if coefficients == TWINS else robots.random_placement(rng, 0.3)
    model = Model(robots.arid(), coefficients, ((None, robots.random_placement(rng)),), ((None, tip),))
    theta = rng.normal(0, 1e-3, len(coefficients))
    q = robots.readings(model.robot, rows, rng)
    return model, theta, measure(model, theta, q, noise, rng)


def measure(model: Model, theta: np.ndarray, q: np.ndarray, noise: float, rng: np.random.Generator) -> Dataset:
    R, p = model.poses(theta, model.rows(q))
    p = p + noise * rng.normal(size=p.shape)
    R = Rotation.from_rotvec(noise * rng.normal(size=p.shape)).as_matrix() @ R
    return robots.measured(model.robot, q, p, R)


def asked(model: Model, data: Dataset, *sigma: float | None) -> Problem:
    """A model asked about rows, with the noise that is declared of them."""
    return problem(model, robots.declared(data, *sigma))


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
    first = fit_identifiable(bare.data(model), range(len(candidates)))
    kept = first.model
    theta = rng.normal(0, 3e-3, len(kept.coefficients))
    R, p = kept.poses(theta, kept.rows(bare.readings))
    data = robots.measured(model.robot, bare.readings, p, R if kind == "pose" else None)
    found = fit_identifiable(problem(model, data), range(len(candidates)))
    assert found.model.names == kept.names
    np.testing.assert_allclose(found.theta, theta, atol=1e-9, rtol=0)
    assert not found.outliers.any()
    assert found.estimated[0] < 1e-11
    assert found.convergence.converged


def test_no_noise_is_estimated_as_the_floor() -> None:
    model, theta, data = small(40, np.random.default_rng(0), 0.0)
    found = fit(problem(model, data))
    assert FLOOR <= found.sigma[0] < 1e-13 + FLOOR
    np.testing.assert_allclose(found.theta, theta, atol=1e-12)


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_the_minimum_is_scipys(kind: str) -> None:
    """Residuals written out here, declared sigmas, another solver with numerical derivatives."""
    rng = np.random.default_rng(1)
    model, _, data = small(40, rng, 1e-3)
    if kind == "position":
        data = robots.positions_alone(data)
    sigma = np.repeat([1e-3, 3e-3], 3)
    found = fit(asked(model, data, 1e-3, 3e-3), weight=np.ones(40))

    def whitened(theta: np.ndarray) -> np.ndarray:
        R, p = model.poses(theta, model.rows(data.readings))
        r = data.position - p
        if data.rotation is not None:
            turn = np.array([pin.log3(M @ P.T) for M, P in zip(data.rotation, R, strict=True)])
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
    clean = fit(problem(model, data))
    spoilt = rng.choice(400, 20, replace=False)
    push = rng.normal(size=(20, 3))
    push *= 1e-4 * rng.uniform(20, 100, (20, 1)) / np.linalg.norm(push, axis=1, keepdims=True)
    p, R = data.position.copy(), data.rotation.copy()  # type: ignore[union-attr]
    p[spoilt[:10]] += push[:10]
    R[spoilt[10:]] = Rotation.from_rotvec(push[10:]).as_matrix() @ R[spoilt[10:]]
    found = fit(problem(model, robots.placed(data, position=p, rotation=R)))
    assert set(np.flatnonzero(found.outliers)) == set(spoilt)
    assert (np.abs(found.theta - clean.theta) < 1.5 * clean.std).all()
    assert (np.abs(found.theta - theta) < 4 * found.std).all()
    assert found.sigma[0] == pytest.approx(1e-4, rel=0.1)


def test_rows_off_by_half_a_metre_do_no_harm() -> None:
    rng = np.random.default_rng(3)
    model, theta, data = small(300, rng, 1e-4)
    p = data.position.copy()
    p[:24] += rng.uniform(-0.5, 0.5, (24, 3))
    found = fit(problem(model, robots.placed(data, position=p)))
    assert found.outliers[:24].all()
    assert not found.outliers[24:].any()
    assert (np.abs(found.theta - theta) < 4 * found.std).all()


def test_a_stale_row_is_flagged_sooner() -> None:
    """A reading repeated bit for bit though the joints moved: 4 sigma is enough for it, not for others."""
    r = np.zeros((400, 6))
    rng = np.random.default_rng(0)
    r[:] = rng.normal(0, 1e-4, r.shape)
    sigma = robust_sigma(r, POSE)
    r[0], r[1] = 0.0, 0.0
    r[0, 0] = r[1, 0] = 4.5 * sigma[0]
    limit = np.full(400, OUTLIER)
    limit[0] = SUSPECT_LIMIT
    assert outlier_rows(r, POSE, limit)[:2].tolist() == [True, False]


def test_predicted_covariance_matches_repeated_fits() -> None:
    """100 repetitions: normalised squared errors average to the number of coefficients, and 2 sigma covers 95 %."""
    rng = np.random.default_rng(4)
    model, theta, data = small(25, rng, 0.0)
    q = data.readings
    errors, squares = [], []
    for _ in range(100):
        found = fit(asked(model, measure(model, theta, q, 2e-4, rng), 2e-4, 2e-4))
        off = found.theta - theta
        errors.append(off / found.std)
        squares.append(off @ np.linalg.solve(found.covariance, off))
    K = len(theta)
    assert np.mean(squares) == pytest.approx(K, abs=4 * np.sqrt(2 * K / 100))
    assert np.mean(np.abs(errors) < 2) == pytest.approx(0.9545, abs=0.03)
    np.testing.assert_allclose(np.std(errors, axis=0), 1.0, atol=0.28)


def test_estimated_noise_is_unbiased_even_with_few_rows() -> None:
    """Degrees of freedom count: 4 rows and 4 coefficients leave 20 of 24."""
    rng = np.random.default_rng(5)
    model, theta, data = small(4, rng, 0.0)
    squares = []
    for _ in range(80):
        again = measure(model, theta, data.readings, 1e-3, rng)
        found = fit(problem(model, again), weight=np.ones(4))
        squares.append(found.sigma**2)
    np.testing.assert_allclose(np.mean(squares, axis=0), 1e-6, rtol=0.2)


def test_declared_noise_is_used_and_estimated_noise_reported() -> None:
    rng = np.random.default_rng(6)
    model, _, data = small(200, rng, 1e-4)
    declared, free = fit(asked(model, data, 5e-4, 5e-4)), fit(problem(model, data))
    assert declared.sigma.tolist() == [5e-4, 5e-4]
    assert declared.estimated[0] == pytest.approx(1e-4, rel=0.1)
    assert free.sigma[0] == pytest.approx(free.estimated[0], rel=1e-6)
    # Both halves scaled alike: the same minimum, and sigmas in proportion.
    np.testing.assert_allclose(declared.std / free.std, 5e-4 / free.sigma[0], rtol=0.1)
    half = fit(asked(model, data, 5e-4, None))
    assert half.sigma[0] == 5e-4
    assert half.sigma[1] == pytest.approx(1e-4, rel=0.1)


def test_rows_weigh_by_their_relative_sigmas() -> None:
    """A tenth of the rows is ten times as good. The common scale is found, and the answer as good as theory allows."""
    rng = np.random.default_rng(7)
    model, theta, data = small(200, rng, 0.0)
    scale = np.where(np.arange(200) % 10 == 0, 0.1, 1.0)
    relative = np.repeat(scale[:, None], 6, axis=1)
    relative /= np.sqrt(np.mean(relative**2))
    off, blind = [], []
    for _ in range(30):
        p = data.position + 1e-3 * scale[:, None] * rng.normal(size=(200, 3))
        turn = 1e-3 * scale[:, None] * rng.normal(size=(200, 3))
        R = Rotation.from_rotvec(turn).as_matrix() @ data.rotation
        found = fit(problem(model, robots.placed(data, position=p, rotation=R, relative=relative)))
        assert not found.outliers.any()
        off.append((found.theta - theta) / found.std)
        blind.append((fit(problem(model, robots.placed(data, position=p, rotation=R))).theta - theta) / found.std)
    assert found.sigma[0] == pytest.approx(1e-3 * np.sqrt(np.mean(scale**2)), rel=0.1)
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.25)
    assert np.sqrt(np.mean(np.square(blind))) > 1.5


def test_axes_of_a_row_may_weigh_unequally() -> None:
    """Rotation noise a hundred times as large about one world axis: the minimum is still scipy's."""
    rng = np.random.default_rng(8)
    model, _, data = small(30, rng, 2e-3)
    relative = np.tile([1.0, 3.0, 0.3, 5.0, 0.05, 0.5], (30, 1))
    question = asked(model, replace(data, relative=relative), 1e-3, 1e-3)
    found = fit(question, weight=np.ones(30))

    def whitened(theta: np.ndarray) -> np.ndarray:
        return (question.residual(theta) / relative / 1e-3).ravel()

    other = least_squares(whitened, found.theta, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=found.std)
    assert np.abs((found.theta - other.x) / found.std).max() < 5e-3


def test_redundant_parameters_stay_nominal_and_are_named() -> None:
    """flange_fixed.yaw and tip_target.yaw turn the target alike: the first is kept and takes it all."""
    rng = np.random.default_rng(9)
    model, _, _ = small(60, rng, 0.0, TWINS)
    q = robots.readings(model.robot, 60, rng)
    truth = np.array([1e-3, -2e-3, 1e-3, 3e-3, 4e-3, 5e-3])
    found = fit_identifiable(asked(model, measure(model, truth, q, 1e-5, rng), 1e-5, 1e-5), range(6))
    assert found.model.coefficients == TWINS[:5]
    assert found.redundant["tip_target.yaw"] == ("flange_fixed.yaw",)
    assert found.theta[4] == pytest.approx(9e-3, abs=1e-4)
    assert found.candidates == TWINS
    swapped = fit_identifiable(asked(model, measure(model, truth, q, 1e-5, rng), 1e-5, 1e-5), [0, 1, 2, 3, 5, 4])
    assert swapped.redundant == {"flange_fixed.yaw": ("tip_target.yaw",)}


def test_nothing_to_tell_apart_is_an_error_that_names_all() -> None:
    rng = np.random.default_rng(0)
    wrist = tuple(Coefficient("tip_target", c) for c in ("roll", "pitch"))
    model, _, data = small(20, rng, 1e-4, wrist)
    data = robots.positions_alone(data)
    with pytest.raises(NotIdentifiable, match=r"tip_target\.roll with tip_target\.pitch"):
        fit_identifiable(problem(model, data), range(2))


def test_far_starts_lead_to_the_same_minimum() -> None:
    rng = np.random.default_rng(10)
    model, theta, data = small(60, rng, 1e-4)
    best = fit(problem(model, data))
    for _ in range(10):
        other = minimise(problem(model, data), theta + rng.uniform(-0.5, 0.5, 4), np.ones(60))
        assert (np.abs(other.theta - best.theta) < 1e-2 * best.std).all()
        assert other.gradient < 1e-2


def test_a_narrow_and_bent_way_to_the_minimum_is_walked_in_cut_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turning the last joint and shifting the target across are one to first order, not to second; a belief settles it."""
    rng = np.random.default_rng(0)
    bent = tuple(Coefficient(*name.split(".")) for name in ("joint_4.yaw", "tip_target.y"))
    tip = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
    model = Model(robots.arid(), bent, ((None, robots.random_placement(rng)),), ((None, tip),))
    data = robots.positions_alone(measure(model, np.zeros(2), robots.readings(model.robot, 40, rng), 1e-4, rng))
    start, belief = np.array([0.05, -0.015]), 2e-2
    prior = Prior(np.zeros(2), np.diag([belief**-2, 0.0]))
    cut = minimise(asked(model, data, 1e-4), start, np.ones(40), prior)
    monkeypatch.setattr(least_squares_module, "NEAR", 0.0)
    damped = minimise(asked(model, data, 1e-4), start, np.ones(40), prior)

    def whitened(theta: np.ndarray) -> np.ndarray:
        off = data.position - model.poses(theta, model.rows(data.readings))[1]
        return np.append((off / 1e-4).ravel(), theta[0] / belief)

    other = least_squares(whitened, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=[1e-2, 3e-3])
    # A fit ends where a step would gain no more than a small part of one sigma, squared here: 0.13^2.
    assert np.sum(whitened(cut.theta) ** 2) == pytest.approx(2 * other.cost, abs=0.02)
    assert 2 * cut.steps < damped.steps


def test_a_prior_holds_what_nothing_measures() -> None:
    """Normal equations with a prior: what the data do not see stays at its mean, the rest at the data's."""
    rng = np.random.default_rng(11)
    model, _, data = small(60, rng, 1e-4, TWINS)
    mean = np.array([0, 0, 0, 0, 2e-3, 2e-3])
    prior = Prior(mean, np.diag([0, 0, 0, 0, 1.0, 1.0]) * 1e4)
    found = fit(asked(model, data, 1e-4, 1e-4), prior=prior)
    free = fit(asked(model.with_coefficients(model.coefficients[:5]), data, 1e-4, 1e-4))
    assert found.theta[4] == pytest.approx(found.theta[5], abs=1e-9)  # what is left is shared alike
    assert found.theta[4] + found.theta[5] == pytest.approx(free.theta[4], abs=3 * free.std[4])
    assert found.std[5] == pytest.approx(np.sqrt(1e-4 / 2), rel=0.01)


def test_residual_is_measured_minus_predicted_in_world_axes() -> None:
    R, M = Rotation.random(5, random_state=0).as_matrix(), Rotation.random(5, random_state=1).as_matrix()
    p, m = np.random.default_rng(0).normal(size=(2, 5, 3))
    r = residuals(R, p, m, M)
    assert np.array_equal(r[:, :3], m - p)
    np.testing.assert_allclose(Rotation.from_rotvec(r[:, 3:]).as_matrix() @ R, M, atol=1e-12)


@pytest.mark.parametrize("count", [ROWS_PER_BLOCK + 30, ROWS_PER_BLOCK + 40, 2 * ROWS_PER_BLOCK + 1])
def test_blocks_of_rows_add_up(count: int) -> None:
    """More rows than one block: sums, triangle and residuals are those of the whole Jacobian."""
    rng = np.random.default_rng(12)
    model, theta, data = small(count, rng, 1e-3)
    weight, sigma = rng.uniform(0, 1, count), np.array([1e-3, 2e-3])
    question = problem(model, data)
    blocks = list(question.blocks())
    assert [row for block in blocks for row in range(block.start, block.stop)] == list(range(count))
    r, J = question.linearised(theta)
    W = np.sqrt(weight)[:, None] / np.repeat([1e-3, 2e-3], 3)
    A, b = (J * W[:, :, None]).reshape(-1, 4), (r * W).ravel()
    here = linearise(question, theta, weight, sigma)
    np.testing.assert_array_equal(here.residual, r)
    equations = here.equations
    np.testing.assert_allclose(equations.information(sigma), A.T @ A, rtol=1e-10, atol=1e-3)
    np.testing.assert_allclose(equations.pull(sigma), A.T @ b, rtol=1e-9)
    R = triangle(question, theta, weight, sigma)
    np.testing.assert_allclose(R.T @ R, A.T @ A, rtol=1e-9, atol=1e-3)


def test_noise_found_robustly_is_that_of_the_bulk() -> None:
    r = np.random.default_rng(0).normal(0, [1e-4] * 3 + [3e-4] * 3, (20000, 6))
    clean = robust_sigma(r, POSE)
    assert clean[0] == pytest.approx(1e-4, rel=0.02)
    assert clean[1] == pytest.approx(3e-4, rel=0.02)
    r[:1000] *= 1000
    assert robust_sigma(r, POSE)[0] < 1.2e-4


def test_thinning_is_reproducible_keeps_the_order_and_leaves_no_frame_out() -> None:
    tip = np.zeros(1000, dtype=int)
    tip[[3, 500, 900]] = 1
    rows = ModelRows(np.zeros((1000, 1)), np.empty((1000, 0)), np.zeros(1000, dtype=int), tip)
    some = thin(rows, 100)
    assert len(set(some.tolist())) == len(some) == 102
    assert np.array_equal(some, np.sort(some))
    assert np.array_equal(some, thin(rows, 100))
    assert {3, 500, 900} <= set(some.tolist())
    assert np.array_equal(thin(rows[:50], 100), np.arange(50))


def test_many_rows_are_fitted_to_the_same_minimum_as_few(monkeypatch: pytest.MonkeyPatch) -> None:
    model, _, data = small(900, np.random.default_rng(8), 1e-4)
    data.position[7] += 0.02
    usual = fit(asked(model, data, None, None))
    monkeypatch.setattr(least_squares_module, "FIRST_FITTED_ROWS", 200)
    ahead = fit(asked(model, data, None, None))
    # A step of a thousandth of a sigma may be left out.
    np.testing.assert_allclose(ahead.theta, usual.theta, atol=1e-3 * usual.std.min())
    np.testing.assert_allclose(ahead.std, usual.std, rtol=1e-5)
    np.testing.assert_array_equal(ahead.outliers, usual.outliers)
    assert ahead.outliers.sum() == 1
    assert ahead.convergence.converged
