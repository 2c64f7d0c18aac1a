"""Variance components against the same likelihood written with dense matrices, and against simulated scatter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space
from scipy.optimize import minimize
from scipy.stats import kstest, multivariate_normal

from aridcal.engine.fit import minorant
from aridcal.engine.fit.scatter import Scatter, derivatives, determined_modes, place, scatter_near
from aridcal.engine.fit.variance_components import (
    Components,
    add_component,
    boundary_chance,
    estimate,
    score_tests,
    settled,
)

HELD = np.array([True, True, False, False])
"""Two channels, then two joints."""


def scatter(n: int = 60, m: int = 4, columns: int = 5, seed: int = 0, prior: float = 0.0) -> Scatter:
    """Rows of two channels, each of half the numbers, that two joints move by random levers; no residuals yet."""
    rng = np.random.default_rng(seed)
    first = np.diag(np.repeat([1.0, 0.0], m // 2))
    levers = rng.standard_normal((2, n, m))
    joints = levers[..., :, None] * levers[..., None, :]
    channels = [np.broadcast_to(block, (n, m, m)) for block in (first, np.eye(m) - first)]
    precision = prior * np.diag(np.arange(columns, dtype=float))
    return Scatter(np.zeros((n, m)), rng.standard_normal((n, m, columns)), precision, np.array([*channels, *joints]))


def scattered(rows: Scatter, sigma: np.ndarray, seed: int) -> Scatter:
    """Residuals of those standard deviations: columns of random coefficients, and noise of every component."""
    rng = np.random.default_rng(seed)
    count, n, m, _ = rows.blocks.shape
    y = rows.A @ rng.standard_normal(rows.A.shape[2])
    for k in range(count):
        values, vectors = np.linalg.eigh(rows.blocks[k])
        roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        y = y + sigma[k] * np.einsum("nij,nj->ni", roots, rng.standard_normal((n, m)))
    return replace(rows, y=y)


def dense(rows: Scatter, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """V, A and y of all numbers under one another."""
    n, m, columns = rows.A.shape
    V = block_diag(*np.tensordot(variance, rows.blocks, axes=1))
    return V, rows.A.reshape(n * m, columns), rows.y.ravel()


def dense_likelihood(rows: Scatter, variance: np.ndarray) -> float:
    """The textbook's restricted log-likelihood, its matrices written out."""
    V, A, y = dense(rows, variance)
    W = np.linalg.inv(V)
    H = A.T @ W @ A + rows.precision
    P = W - W @ A @ np.linalg.inv(H) @ A.T @ W
    return -0.5 * float(np.linalg.slogdet(V)[1] + np.linalg.slogdet(H)[1] + y @ P @ y)


@pytest.mark.parametrize("prior", [0.0, 0.7])
def test_the_likelihood_is_that_of_dense_matrices(prior: float) -> None:
    rows = scattered(scatter(12, prior=prior), np.array([1.0, 0.3, 0.8, 0.0]), 3)
    for variance in np.random.default_rng(0).uniform(0.1, 2.0, (5, 4)):
        assert place(rows, variance).log_likelihood == pytest.approx(dense_likelihood(rows, variance), rel=1e-9)


def test_without_a_prior_it_is_the_density_of_what_the_columns_cannot_reach() -> None:
    rows = scattered(scatter(12), np.array([1.0, 0.3, 0.8, 0.0]), 3)
    likelihoods, densities = [], []
    for variance in np.random.default_rng(0).uniform(0.1, 2.0, (5, 4)):
        V, A, y = dense(rows, variance)
        contrasts = null_space(A.T)
        covariance = contrasts.T @ V @ contrasts
        densities.append(multivariate_normal.logpdf(contrasts.T @ y, cov=covariance))
        likelihoods.append(place(rows, variance).log_likelihood)
    np.testing.assert_allclose(np.diff(likelihoods), np.diff(densities), rtol=1e-8)


def whole(rows: Scatter) -> Components:
    """Every component that is asked for."""
    found = estimate(rows, np.ones(2), HELD)
    while (more := add_component(rows, found, HELD)) is not None:
        found = more[1]
    return settled(rows, found)


@pytest.mark.parametrize("prior", [0.0, 0.7])
def test_the_bound_touches_the_likelihood_where_it_is_made_and_lies_below_it_elsewhere(prior: float) -> None:
    rows, at = scattered(scatter(12, prior=prior), np.array([1.0, 0.3, 0.8, 0.2]), 3), np.array([0.7, 0.2, 0.9, 0.3])
    V, A, y = dense(rows, at)
    W, (n, m) = np.linalg.inv(V), rows.y.shape
    P = W - W @ A @ np.linalg.inv(A.T @ W @ A + rows.precision) @ A.T @ W
    own = P.reshape(n, m, n, m)[np.arange(n), :, np.arange(n), :]
    M = minorant.moments(np.tensordot(at, rows.blocks, axes=1), (P @ y).reshape(n, m), own)

    def below(variance: np.ndarray) -> float:
        each = np.tensordot(variance, rows.blocks, axes=1)
        return -0.5 * float(np.linalg.slogdet(each)[1].sum() + np.einsum("nij,nji->", M, np.linalg.inv(each)))

    gap = dense_likelihood(rows, at) - below(at)
    others = at * np.exp(np.random.default_rng(1).uniform(-2.0, 2.0, (50, 4)))
    assert all(below(other) + gap < dense_likelihood(rows, other) for other in others)
    top = minorant.Bound(rows.blocks, rows.fixed, M).best(at, np.ones(4, dtype=bool), np.zeros(4))
    assert dense_likelihood(rows, top) > dense_likelihood(rows, at)
    assert all(below(top) >= below(top * np.exp(step)) for step in np.vstack([np.eye(4), -np.eye(4)]) * 0.05)


def hard(seed: int = 0, weights: np.ndarray | None = None) -> Scatter:
    """Rows of columns that nearly coincide, one of nothing, one a million times the others; a large signal in the rest.

    Args:
        seed: Makes the same again.
        weights: What the noise of each row is multiplied by, shape (150,).
    """
    rows = scatter(150, columns=30, seed=seed, prior=0.7)
    rng, A = np.random.default_rng(seed), rows.A.copy()
    A[:, :, 1] = A[:, :, 0] + 1e-4 * A[:, :, 1]
    A[:, :, 2] = 0.0
    if weights is not None:
        rows = replace(rows, blocks=rows.blocks * (weights**2)[:, None, None])
    noisy = scattered(rows, np.array([1.0, 0.3, 0.8, 0.2]), seed)
    A[:, :, 3] *= 1e6
    return replace(noisy, A=A, y=noisy.y + A[:, :, 4:] @ rng.normal(scale=10.0, size=26))


def in_clumps(rows: Scatter) -> Scatter:
    """The same with two unknowns of every ten rows, columns of which they nearly take off; the last ten rows have none."""
    rng, clump = np.random.default_rng(1), np.arange(len(rows.y)) // 10
    things, A = rng.standard_normal((*rows.y.shape, 2)), rows.A.copy()
    things[-10:], clump[-10:] = 0.0, -1
    A[:, :, 5] = 1e-4 * A[:, :, 5] + 1e2 * things[:, :, 0]
    return replace(rows, A=A, things=things, clump=clump)


@pytest.mark.parametrize("with_things", [False, True])
@pytest.mark.parametrize("far", [3.0, 1e6])
def test_in_single_precision_a_likelihood_is_what_it_is_in_double(far: float, with_things: bool) -> None:
    """Far away, where single precision has no digits left, it is not asked for."""
    rng, start = np.random.default_rng(2), np.array([1.0, 0.1, 0.0, 0.0])
    rows = in_clumps(hard()) if with_things else hard()
    near = scatter_near(rows, start)
    assert near.near is not None and near.near.A.dtype == np.float32
    free = np.ones(4, dtype=bool)
    for _ in range(8):
        variance = np.array([1.0, 0.1, 0.6, 0.05]) * np.exp(rng.uniform(-np.log(far), np.log(far), 4))
        one, two = place(near, variance), place(rows, variance)
        assert one.log_likelihood == pytest.approx(two.log_likelihood, abs=1e-4, rel=1e-7 if far > 3.0 else 0.0)
        np.testing.assert_allclose(one.pull, two.pull, atol=1e-5 * np.abs(two.pull).max())
        np.testing.assert_allclose(one.kernel, two.kernel, atol=1e-5 * np.abs(two.kernel).max())
        (score, information), (other, twice) = (derivatives(s, p, free) for s, p in ((near, one), (rows, two)))
        std = np.sqrt(np.diag(twice))
        np.testing.assert_allclose(score / std, other / std, atol=1e-3 + 1e-4 * np.abs(other / std).max())
        np.testing.assert_allclose(information / np.outer(std, std), twice / np.outer(std, std), atol=1e-4)


def test_rows_of_wild_weights_are_looked_at_as_well_in_single_precision() -> None:
    """One row in ten has a million times the weight of the others, or a millionth."""
    rng = np.random.default_rng(3)
    rows = hard(weights=10.0 ** rng.choice([-3.0, 0.0, 3.0], 150, p=[0.05, 0.9, 0.05]))
    near = scatter_near(rows, np.array([1.0, 0.1, 0.0, 0.0]))
    variances = np.array([1.0, 0.1, 0.6, 0.05]) * np.exp(rng.uniform(-1.0, 1.0, (6, 4)))
    one, two = (np.array([place(s, v).log_likelihood for v in variances]) for s in (near, rows))
    # A combination of columns that is rounding beside such weights has a ridge: a constant.
    np.testing.assert_allclose(one - one[0], two - two[0], atol=1e-3)


def test_what_is_found_in_single_precision_is_what_is_found_in_double() -> None:
    for seed in range(5):
        rows = hard(seed)
        one, two = whole(scatter_near(rows, np.array([1.0, 1.0, 0.0, 0.0]))), whole(rows)
        assert np.array_equal(one.free, two.free)
        np.testing.assert_allclose(one.sigma, two.sigma, atol=1e-3 * two.sigma_std.max())
        np.testing.assert_allclose(one.sigma_std, two.sigma_std, rtol=1e-3)
        assert one.log_likelihood == pytest.approx(two.log_likelihood, abs=1e-3)


def test_the_last_step_that_is_not_looked_at_ends_where_it_says() -> None:
    """Likelihoods that are told for variances are those of them: to a tenth while components are added, then to a thousandth."""
    for seed in range(10):
        rows = scattered(scatter(60), np.array([1.0, 0.3, 0.8, 0.5]), seed)
        found = estimate(rows, np.array([0.3, 0.3]), HELD)
        told = [found]
        while (more := add_component(rows, found, HELD)) is not None:
            found = more[1]
            told.append(found)
        for one in told:
            best = settled(rows, one)
            best = settled(rows, replace(best, error=1.0))  # a step further
            assert one.log_likelihood == pytest.approx(best.log_likelihood, abs=0.1)
            assert place(rows, one.variance).log_likelihood == pytest.approx(best.log_likelihood, abs=0.1)
            last = settled(rows, one)
            assert last.log_likelihood == pytest.approx(best.log_likelihood, abs=1e-3)
            assert place(rows, last.variance).log_likelihood == pytest.approx(best.log_likelihood, abs=1e-3)


def test_modes_of_which_nothing_is_told_change_no_likelihood_and_go() -> None:
    rng, rows = np.random.default_rng(4), scattered(scatter(30), np.array([1.0, 0.3, 0.8, 0.0]), 3)
    modes = np.append(rng.standard_normal((30, 4, 3)), 1e-3 * rng.standard_normal((30, 4, 5)), axis=2)
    told = determined_modes(modes, np.ones(4))
    assert told.shape == (8, 3)

    def likelihood(columns: np.ndarray, variance: np.ndarray) -> float:
        precision = block_diag(rows.precision, np.eye(columns.shape[2]))
        return place(replace(rows, A=np.append(rows.A, columns, axis=2), precision=precision), variance).log_likelihood

    both = np.array([[likelihood(c, v) for c in (modes, modes @ told)] for v in rng.uniform(0.3, 2.0, (4, 4))])
    np.testing.assert_allclose(both[:, 0], both[:, 1], atol=1e-3)


def test_the_maximum_is_the_one_that_another_search_finds() -> None:
    rows = scattered(scatter(40), np.array([1.0, 0.3, 1.5, 1.5]), 2)
    found = whole(rows)
    assert found.free.all()
    again = minimize(lambda log: -dense_likelihood(rows, np.exp(log)), np.zeros(4), method="Nelder-Mead",
                     options={"xatol": 1e-5, "fatol": 1e-9, "maxiter": 4000})  # fmt: skip
    np.testing.assert_allclose(found.variance, np.exp(again.x), rtol=0.01)  # a step of 1e-3 nat is the last
    assert found.log_likelihood == pytest.approx(-again.fun, abs=1e-3)


def test_components_come_out_as_they_were_simulated_and_their_std_is_their_scatter() -> None:
    truth, rows = np.array([1.0, 0.3, 0.8, 0.0]), scatter(120)
    found = [f for f in (whole(scattered(rows, truth, seed)) for seed in range(80)) if f.free[2]]
    assert len(found) >= 75
    assert sum(f.free[3] for f in found) == 0
    sigma, std = (np.array([getattr(f, what)[:3] for f in found]) for what in ("sigma", "sigma_std"))
    # 80 draws: a mean is known to 1/9 of a standard deviation, a standard deviation to 8 %.
    np.testing.assert_allclose(sigma.mean(axis=0), truth[:3], atol=4 * std.mean(axis=0).max() / 9)
    np.testing.assert_allclose(sigma.std(axis=0), std.mean(axis=0), rtol=0.25)


@pytest.mark.parametrize("long_tails", [False, True])
def test_clean_rows_name_no_component(long_tails: bool) -> None:
    """Long tails (Student's, 5 degrees) make variances look unequal by chance: they do not deceive."""
    rows, named = scatter(50), 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        y = rng.standard_t(5, rows.y.shape) if long_tails else rng.standard_normal(rows.y.shape)
        clean = replace(rows, y=y)
        named += add_component(clean, estimate(clean, np.ones(2), HELD), HELD) is not None
    assert named <= 1


def test_a_wild_row_names_no_component() -> None:
    """Ten sigmas along a joint's motion, in one row of 50: enough for the normal model, not for the rows themselves."""
    rows = scattered(scatter(50), np.array([1.0, 1.0, 0.0, 0.0]), 1)
    y, k = rows.y.copy(), int(np.argmax(np.trace(rows.blocks[2], axis1=1, axis2=2)))
    y[k] += 10.0 * np.linalg.eigh(rows.blocks[2, k])[1][:, -1]
    wild = replace(rows, y=y)
    found = estimate(wild, np.ones(2), HELD)
    asked = score_tests(wild, found)
    assert asked.normal[2] > 4.0 > 2.0 > asked.plain[2]
    assert add_component(wild, found, HELD) is None


def test_scores_of_clean_rows_have_unit_spread() -> None:
    rows, scores = scatter(50), []
    for seed in range(100):
        clean = scattered(rows, np.array([1.0, 0.3, 0.0, 0.0]), seed)
        scores.append(score_tests(clean, estimate(clean, np.ones(2), HELD)).normal[2:])
    assert np.std(scores) == pytest.approx(1.0, abs=0.15)
    assert abs(np.mean(scores)) < 0.2


def test_a_component_that_others_imitate_asks_for_nothing() -> None:
    rows = scattered(scatter(60), np.array([1.0, 0.3, 0.9, 0.0]), 2)
    twin = replace(rows, blocks=np.array([*rows.blocks[:2], 0.5 * (rows.blocks[0] + rows.blocks[1]), rows.blocks[0]]))
    asked = score_tests(twin, estimate(twin, np.ones(2), HELD))
    assert asked.normal[2:].tolist() == [0.0, 0.0]


def test_the_chance_at_the_boundary_is_half_of_a_chi_square() -> None:
    """Twice the log-likelihood ratio of clean rows: nothing in half of them, and else as often as it is said."""
    rows, chances = scatter(50), []
    for seed in range(120):
        clean = scattered(rows, np.array([1.0, 1.0, 0.0, 0.0]), seed)
        clean = replace(clean, blocks=clean.blocks[:3])
        found = estimate(clean, np.ones(2), HELD[:3])
        grid = np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 15)])
        best = max(place(clean, np.array([*found.variance[:2], v])).log_likelihood for v in grid)
        chances.append(boundary_chance(2.0 * (best - found.log_likelihood)))
    chances = np.array(chances)
    assert np.mean(chances > 0.49) == pytest.approx(0.5, abs=0.14)  # three standard deviations
    assert kstest(chances[chances < 0.45] / 0.45, "uniform").pvalue > 1e-3
