r"""How much columns explain beyond what chance would: the evidence for a candidate against a linearised model.

For d plain columns, with the noise profiled out, twice the gain in log-likelihood is

.. math:: x = -n \log(1 - e / l)

with e the sum of squares that they explain, l what is left of the residual, both in sigmas, and n the numbers measured.
The evidence charges each column half of :math:`1 + \log x/d`: a normal prior as wide as the data ask for (an
empirical-Bayes g-prior; George and Foster 2000, doi:10.1093/biomet/87.4.731). A smooth function is a Gaussian process
sampled at knots: its evidence is the marginal likelihood, maximised over amplitude and correlation length (Rasmussen and
Williams 2006, section 5.4), less a price for those two. See docs/how-the-search-works.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincc

from aridcal.effects.smooth import Kernel, Shape, kernels_that_matter, samples_root
from aridcal.fit.flags import FLOOR
from aridcal.fit.normal_equations import RIDGE, TINY, NormalEquations, inverse
from aridcal.fit.normal_equations import solve as solve_equations

DEPENDENT = 1e-6
"""Share of a column's square that must be left when the model's own columns are taken off: below it is rounding."""

SMOOTH_PRICE = 2.0
"""[nat] for the two numbers that shape a smooth function: one each, as for a column."""

TAUS = np.logspace(-1.5, 9, 43)[:, None]
"""Prior variances that are tried, in units of the best seen mode: four a decade, from nothing to all that it asks for."""

NOISE_ROUNDS = 6
"""Times that noise and coefficients are found in turn; three are usual."""

NOISE_SETTLED = 1e-2
"""Change of the logarithm of the noise that ends this: a hundredth of a sigma moves no decision."""

NOISE_KNOWN = 2e-3
"""The same where coefficients are solved for: of 10,000 numbers the likelihood is then known to 0.04 nat."""

LEAST_FREEDOM = 0.05
"""Share of a channel's numbers that is left to estimate its noise from, whatever the freedom of the model."""

WHOLE = 1.0 - 1e-12
"""A share of the residual that is explained is at most this: beyond it is rounding."""

ROUGH = tuple(Kernel(length) for length in (0.7, 1.5, 3.0, 6.0, 12.0, 24.0))
"""Shapes of smooth functions for a first look: an octave apart, from one knot to a third of a joint map."""

KERNELS = (*ROUGH, *(Kernel(length, kinks=False) for length in (1.5, 3.0, 6.0, 9.0, 12.0, 18.0)))
"""All shapes: those, and functions without any kink."""


@dataclass(frozen=True)
class Solution:
    """Coefficients of a linearised model and the noise that goes with them.

    Attributes:
        beta: Shape (K,).
        sigma: Noise of each channel per axis, shape (C,).
        likelihood: Logarithm, up to a constant.
        inverse: (A'WA + prior)^-1, shape (K, K).
        spent: Degrees of freedom that the coefficients spend of each channel, shape (C,).
    """

    beta: np.ndarray
    sigma: np.ndarray
    likelihood: float
    inverse: np.ndarray
    spent: np.ndarray


@dataclass(frozen=True)
class Score:
    """What one candidate would add.

    Attributes:
        gain: Logarithm of the evidence in its favour: what it explains less what its freedom costs, [nat].
        p_value: Of its columns' contribution if nothing were there, before correction for the number of candidates.
        freedom: Columns that say something new.
        tau: For smooth functions: prior standard deviation [m] or [rad]; else 0.
        kernel: For smooth functions: what they are like.
        sigma: The noise that is left with it in the model, shape (C,); unknown at first.
    """

    gain: float
    p_value: float
    freedom: int
    tau: float = 0.0
    kernel: Kernel = ROUGH[0]
    sigma: np.ndarray | None = None


NOTHING = Score(0.0, 1.0, 0)
"""Of columns that say nothing new."""


def coefficients(equations: NormalEquations, precision: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Least squares with priors for a given noise, shape (K,)."""
    return solve_equations(equations.information(sigma) + precision, equations.pull(sigma), ridge=RIDGE)


def solve(equations: NormalEquations, precision: np.ndarray, sigma: np.ndarray) -> Solution:
    """Least squares with priors, the noise estimated with it.

    Args:
        equations: Of K coefficients.
        precision: Of their priors, which are centred at zero, shape (K, K).
        sigma: Noise to begin with, shape (C,).
    """
    for _ in range(NOISE_ROUNDS):
        covariance = inverse(equations.information(sigma) + precision)
        beta = covariance @ equations.pull(sigma)
        spent = equations.spent(covariance, sigma)
        squares = equations.squares_left(beta)
        better = noise_left(equations, squares, spent)
        if np.all(np.abs(np.log(better / sigma)) < NOISE_KNOWN):
            break
        sigma = better
    return Solution(beta, sigma, _likelihood(equations, precision, sigma, beta, squares), covariance, spent)


def with_noise(
    equations: NormalEquations, precision: np.ndarray, sigma: np.ndarray, beta: np.ndarray, spent: np.ndarray
) -> tuple[np.ndarray, float]:
    """Noise, shape (C,), and log-likelihood, where the degrees of freedom that the coefficients spend are known.

    Args:
        equations: Of K coefficients.
        precision: Of their priors, shape (K, K).
        sigma: Noise to begin with, shape (C,).
        beta: The coefficients for that noise, shape (K,).
        spent: Degrees of freedom that they spend of each channel, shape (C,).
    """
    for k in range(NOISE_ROUNDS):
        beta = coefficients(equations, precision, sigma) if k else beta
        squares = equations.squares_left(beta)
        before, sigma = sigma, noise_left(equations, squares, spent)
        if np.all(np.abs(np.log(sigma / before)) < NOISE_SETTLED):
            break
    return sigma, _likelihood(equations, precision, sigma, beta, squares)


def noise_left(equations: NormalEquations, squares: np.ndarray, spent: np.ndarray) -> np.ndarray:
    """Noise of each channel, shape (C,), from the squares that are left and the degrees of freedom that were spent."""
    freedom = np.maximum(equations.count - spent, LEAST_FREEDOM * equations.count + 1e-9)
    return np.maximum(np.sqrt(squares / freedom), FLOOR)


def _likelihood(
    equations: NormalEquations, precision: np.ndarray, sigma: np.ndarray, beta: np.ndarray, squares: np.ndarray
) -> float:
    """Log-likelihood of coefficients and noise, up to a constant."""
    misfit = float(equations.count @ np.log(sigma**2) + np.sum(squares / sigma**2))
    return -0.5 * (misfit + float(beta @ precision @ beta))


def scores(
    M: np.ndarray, s: np.ndarray, raw: np.ndarray, left: float, count: float, shape: Shape | None = None
) -> list[Score]:
    """Evidence for k candidates of d columns each, one by one.

    Args:
        M: Their Gram matrices after projection off the model, in units of sigma, shape (k, d, d).
        s: Their products with the residual, shape (k, d).
        raw: Their squared lengths before projection, shape (k, d).
        left: The residual's sum of squares, in units of sigma.
        count: Numbers measured.
        shape: For samples of smooth functions: of what; else None.
    """
    return _smooth(M, s, raw, shape, ROUGH, left, count) if shape else _plain(M, s, raw, left, count)


def shaped(total: NormalEquations, precision: np.ndarray, shape: Shape, sigma: np.ndarray) -> Score:
    """The shape that suits a smooth function best, for a given noise.

    Args:
        total: Equations of the model's coefficients and, after them, of the samples of the function.
        precision: Prior of the model's own coefficients.
        shape: What those are samples of.
        sigma: Noise of each channel, shape (C,).
    """
    K = len(precision)
    H, g = total.information(sigma), total.pull(sigma)
    alone = solve_equations(H[:K, :K] + precision, np.column_stack([H[:K, K:], g[:K]]), ridge=RIDGE)
    M, s = H[K:, K:] - H[K:, :K] @ alone[:, :-1], g[K:] - H[K:, :K] @ alone[:, -1]
    return replace(_smooth(M[None], s[None], np.diag(H)[None, K:], shape, KERNELS)[0], sigma=sigma)


def price(twice: float, freedom: int) -> float:
    """Evidence [nat] of columns that raise twice the log-likelihood by so much, less what their freedom costs."""
    each = twice / freedom
    return 0.5 * (twice - freedom * (1.0 + float(np.log(max(each, 1.0)))))


def _plain(M: np.ndarray, s: np.ndarray, raw: np.ndarray, left: float, count: float) -> list[Score]:
    """Evidence for columns that are no smooth functions; see :func:`scores`."""
    scale = 1.0 / np.sqrt(np.maximum(raw, TINY))
    values, vectors = np.linalg.eigh(M * scale[:, :, None] * scale[:, None, :])
    new = values > DEPENDENT
    along = np.einsum("kij,ki->kj", vectors, s * scale)
    explained = np.sum(np.where(new, along**2 / np.where(new, values, 1.0), 0.0), axis=1)
    twice = -count * np.log1p(-np.minimum(explained / max(left, TINY), WHOLE))
    return [
        Score(price(gain, freedom), tail(gain, freedom), freedom) if freedom else NOTHING
        for gain, freedom in zip(twice.tolist(), new.sum(axis=1).tolist(), strict=True)
    ]


def _smooth(
    M: np.ndarray,
    s: np.ndarray,
    raw: np.ndarray,
    shape: Shape,
    kernels: tuple[Kernel, ...],
    left: float = np.inf,
    count: float = 0.0,
) -> list[Score]:
    r"""Evidence of the best kernel and amplitude; the noise is profiled if what is left of the residual is given.

    In the eigenbasis of the samples' information under the prior, values :math:`v_i` and pulls :math:`a_i`,

    .. math:: 2 \log L(\tau) = \sum_i \frac{\tau^2 a_i^2}{1 + \tau^2 v_i} - \sum_i \log(1 + \tau^2 v_i)

    with the first sum, what is explained, profiled as for plain columns where the noise is not known.
    """
    best = [NOTHING] * len(s)
    gains = np.full(len(s), -np.inf)
    for kernel in kernels_that_matter(shape, kernels):
        root = samples_root(shape, kernel)
        spectrum, vectors = np.linalg.eigh(root.T @ M @ root)
        values = np.maximum(spectrum, 0.0)
        largest = np.where(values[:, -1] > 0.0, values[:, -1], 1.0)
        mean_square = raw @ np.sum(root**2, axis=1) / s.shape[1]
        pulls = np.einsum("kij,ki->kj", vectors, s @ root)
        squares = np.where(values > DEPENDENT * mean_square[:, None], pulls**2, 0.0)
        variances = TAUS.T / largest[:, None]
        shrunk = 1.0 + variances[:, :, None] * values[:, None]
        explained = variances * np.einsum("ktj,kj->kt", 1.0 / shrunk, squares)
        likelihood = explained if left == np.inf else -count * np.log1p(-np.minimum(explained / max(left, TINY), WHOLE))
        twice = likelihood - np.sum(np.log(shrunk), axis=2)
        top = np.argmax(twice, axis=1)
        gain = 0.5 * np.take_along_axis(twice, top[:, None], axis=1)[:, 0] - SMOOTH_PRICE
        for k in np.flatnonzero((gain > gains) & (values[:, -1] > 0.0)).tolist():
            t = top[k]
            freedom = float(np.sum(1.0 - 1.0 / shrunk[k, t]))
            tau = float(np.sqrt(variances[k, t]))
            best[k] = Score(float(gain[k]), smooth_tail(float(twice[k, t])), max(round(freedom), 1), tau, kernel)
            gains[k] = gain[k]
    return best


def smooth_tail(twice: float) -> float:
    """Chance that noise raises twice the log-likelihood of a smooth function by so much, at the most.

    A variance that may only be positive: half the cases give nothing, the rest at most chi-square with 2 degrees.
    """
    return float(np.exp(-max(0.5 * twice, 0.0)))


def tail(twice: float, freedom: int) -> float:
    """Chance that chi-square with so many degrees of freedom exceeds a value."""
    return float(gammaincc(0.5 * freedom, 0.5 * max(twice, 0.0)))
