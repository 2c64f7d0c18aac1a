"""Noise with tails: densities and weights by other roads, and what is found of noise of which the truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import gamma, multivariate_t, norm

from aridcal.engine.fit.tails import log_density, tails_of, weights


@pytest.mark.parametrize("freedom", [1.0, 2.0, 6.0])
def test_the_density_is_that_of_students_t_in_several_dimensions(freedom: float) -> None:
    r = np.random.default_rng(0).standard_t(freedom, (20, 3))
    other = multivariate_t(np.zeros(3), np.eye(3), df=freedom).logpdf(r)
    np.testing.assert_allclose(log_density(np.sum(r**2, axis=1), 3, freedom), other, rtol=1e-12)


def test_without_tails_the_density_is_normal_and_every_weight_is_1() -> None:
    r = np.random.default_rng(0).normal(size=(20, 3))
    squares = np.sum(r**2, axis=1)
    np.testing.assert_allclose(log_density(squares, 3, np.inf), norm.logpdf(r).sum(axis=1), rtol=1e-12)
    assert np.all(weights(squares, 3, np.inf) == 1.0)


@pytest.mark.parametrize(("squares", "size", "freedom"), [(0.1, 3, 2.0), (50.0, 3, 2.0), (4.0, 1, 5.0)])
def test_a_weight_is_the_mean_of_the_inverse_variances_that_a_row_may_have(squares, size, freedom) -> None:
    def likely(w: float) -> float:
        """Density of a row, given the inverse variance w, and of w beforehand."""
        return w ** (size / 2) * np.exp(-0.5 * w * squares) * gamma.pdf(w, freedom / 2, scale=2 / freedom)

    mean = quad(lambda w: w * likely(w), 0, np.inf)[0] / quad(likely, 0, np.inf)[0]
    assert weights(squares, size, freedom) == pytest.approx(mean, rel=1e-6)


@pytest.mark.parametrize("freedom", [2.0, 4.0])
def test_tails_are_found_as_they_were_simulated(freedom: float) -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(20):
        scale = np.sqrt(freedom / rng.chisquare(freedom, 400))[:, None]
        tails = tails_of(np.sum((1e-4 * scale * rng.normal(size=(400, 3))) ** 2, axis=1), 3)
        assert tails is not None
        found.append((np.log(tails.freedom), np.log(tails.sigma)))
    # One draw knows the logarithm of the freedom to about 0.15, that of the scale to 0.05.
    assert np.mean(found, axis=0) == pytest.approx([np.log(freedom), np.log(1e-4)], abs=0.15)


def test_normal_noise_hardly_ever_has_tails() -> None:
    rng = np.random.default_rng(2)
    told = sum(tails_of(np.sum(rng.normal(size=(150, 3)) ** 2, axis=1), 3) is not None for _ in range(100))
    assert told <= 4  # 0.7 % were expected of half a chi-square: 0.7, and four standard deviations


def test_exact_residuals_and_few_rows_have_no_tails() -> None:
    assert tails_of(np.zeros(100), 3) is None
    assert tails_of(np.random.default_rng(0).standard_t(1, 19) ** 2, 1) is None
