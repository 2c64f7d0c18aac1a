"""Scores and evidence by a second road: likelihood ratios solved in full, Gaussian processes integrated in full, sampling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.optimize import minimize_scalar
from scipy.stats import chi2, kstest, multivariate_normal, norm
from scipy.stats import t as t_distribution

from aridcal.engine.corrections.smooth import Kernel, kernel_root, smooth_precision
from aridcal.engine.fit.normal_equations import accumulate
from aridcal.engine.search.evidence import KERNELS, coefficients, scores, shaped, solve

UNIT = np.ones(1)


def problem(seed: int, n: int = 80, K: int = 5, d: int = 3) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, K)), rng.standard_normal((n, d)), rng.standard_normal(n)


def scored(A: np.ndarray, C: np.ndarray, r: np.ndarray, shape: tuple[int, ...] | None = None):  # type: ignore[no-untyped-def]
    P = np.eye(len(r)) - A @ np.linalg.pinv(A)
    left = P @ r
    return scores(
        (C.T @ P @ C)[None], (C.T @ left)[None], np.sum(C**2, axis=0)[None], float(left @ left), len(r), shape
    )[0]


@pytest.mark.parametrize("d", [1, 3])
def test_plain_gain_is_the_profiled_likelihood_ratio_less_its_price(d):
    A, C, r = problem(1, d=d)
    r = r + C @ np.full(d, 0.4)
    squares = [np.sum((r - X @ np.linalg.lstsq(X, r, rcond=None)[0]) ** 2) for X in (A, np.hstack([A, C]))]
    twice = len(r) * np.log(squares[0] / squares[1])
    found = scored(A, C, r)
    assert found.freedom == d
    # d numbers with that sum of squares and unit noise: the evidence that they have a variance of their own beside it.
    numbers = np.sqrt(twice / d) * np.ones(d)

    def against(variance: float) -> float:
        return -float(multivariate_normal(cov=(1.0 + variance) * np.eye(d)).logpdf(numbers))

    best = -minimize_scalar(against, bounds=(0.0, 1e3), method="bounded").fun
    assert found.gain == pytest.approx(best - multivariate_normal(cov=np.eye(d)).logpdf(numbers), abs=1e-6)
    assert found.p_value == pytest.approx(chi2.sf(twice, d))


def test_p_values_of_columns_that_mean_nothing_are_uniform():
    values = [scored(*problem(seed, n=300)).p_value for seed in range(400)]
    assert kstest(values, "uniform").pvalue > 1e-3


def test_columns_that_explain_less_than_chance_would_are_worth_less_than_nothing():
    scores = [scored(*problem(seed, n=300)) for seed in range(200)]
    usual = chi2.median(3)
    assert all(s.gain < 0 for s in scores if s.p_value > chi2.sf(usual, 3))
    assert max(s.gain for s in scores) < 6.0  # a chance of 1 in 200


def test_columns_that_the_model_has_already_add_nothing():
    A, _, r = problem(2)
    found = scored(A, A[:, :2] @ np.array([[1.0, 2.0], [-1.0, 0.5]]), r)
    assert (found.freedom, found.gain, found.p_value) == (0, 0.0, 1.0)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernels_root_and_precision_are_those_of_its_covariance(kernel):
    """Integrated over their spectra: Student's t with 7 degrees of freedom (Matern 7/2), and the normal distribution."""
    root = kernel_root((9,), kernel)
    spectrum = t_distribution(7) if kernel.kinks else norm()
    frequency = np.linspace(-100.0, 100.0, 20_001)
    weight = spectrum.pdf(frequency) * (frequency[1] - frequency[0])
    along = np.array([weight @ np.cos(k / kernel.length * frequency) for k in range(9)])
    np.testing.assert_allclose(root @ root.T, toeplitz(along), atol=1e-7)
    np.testing.assert_allclose(smooth_precision(((9,),), 0.5, kernel) @ (0.25 * root @ root.T), np.eye(9), atol=1e-4)


def test_two_covariates_have_the_product_of_their_kernels():
    kernel = Kernel(2.0)
    one = kernel_root((4,), kernel)
    both = kernel_root((4, 4), kernel)
    np.testing.assert_allclose(both @ both.T, np.kron(one @ one.T, one @ one.T), atol=1e-5)


def test_smooth_evidence_is_that_of_a_gaussian_process_integrated_in_full():
    rng = np.random.default_rng(3)
    A, C, _ = problem(4, n=60, d=8)
    truth = kernel_root((8,), Kernel(3.0)) @ rng.standard_normal(8)
    r = C @ truth + rng.standard_normal(60)
    gram = accumulate([np.hstack([A, C])], [r])
    found = shaped(gram, np.zeros((5, 5)), ((8,),), UNIT)
    basis = np.linalg.svd(A)[0][:, 5:]  # what the model cannot take up
    seen, columns = basis.T @ r, basis.T @ C

    def likelihood(tau: float, kernel: Kernel) -> float:
        root = tau * columns @ kernel_root((8,), kernel)
        return float(multivariate_normal(cov=root @ root.T + np.eye(len(seen))).logpdf(seen))

    nothing = float(multivariate_normal(cov=np.eye(len(seen))).logpdf(seen))
    assert found.gain + 2.0 == pytest.approx(likelihood(found.tau, found.kernel) - nothing, rel=1e-6)
    around = [likelihood(found.tau * f, kernel) for f in (0.5, 1.0, 2.0) for kernel in KERNELS]
    assert likelihood(found.tau, found.kernel) > max(around) - 0.1


def test_solve_gives_each_part_its_own_noise():
    rng = np.random.default_rng(5)
    A = [rng.standard_normal((600, 4)) for _ in range(2)]
    beta = np.array([1.0, -2.0, 0.5, 3.0])
    r = [a @ beta + s * rng.standard_normal(600) for a, s in zip(A, (0.1, 2.0), strict=True)]
    found = solve(accumulate(A, r), np.zeros((4, 4)), np.ones(2))
    assert found.sigma[0] == pytest.approx(0.1, rel=0.1)
    assert found.sigma[1] == pytest.approx(2.0, rel=0.1)
    W = np.concatenate([np.full(600, 1 / found.sigma[0]), np.full(600, 1 / found.sigma[1])])
    full = np.linalg.lstsq(np.vstack(A) * W[:, None], np.concatenate(r) * W, rcond=None)[0]
    np.testing.assert_allclose(found.beta, full, rtol=1e-6)
    np.testing.assert_allclose(coefficients(accumulate(A, r), np.zeros((4, 4)), found.sigma), full, rtol=1e-6)
    np.testing.assert_allclose(found.inverse, np.linalg.inv((np.vstack(A) * W[:, None]).T @ (np.vstack(A) * W[:, None])),
                               rtol=1e-6)  # fmt: skip


def test_sums_of_combined_columns_are_those_of_the_columns_themselves():
    A, C, r = problem(6)
    T = np.random.default_rng(7).standard_normal((3, 2))
    short = accumulate([np.hstack([A, C])], [r]).combined(T)
    long = accumulate([np.hstack([A, C @ T])], [r])
    np.testing.assert_allclose(short.AA, long.AA, atol=1e-12)
    np.testing.assert_allclose(short.Ar, long.Ar, atol=1e-12)
