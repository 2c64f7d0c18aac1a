r"""How much columns explain beyond chance: the evidence for a candidate against a linearised model.

For d plain columns, with the noise profiled out, twice the gain in log-likelihood is

.. math:: x = -n \log(1 - e / l)

with e the sum of squares that they explain, l that of the residual without them, both in sigmas, and n the numbers measured.
The evidence charges each column half of :math:`1 + \log x/d`: a normal prior as wide as the data ask for (an
empirical-Bayes g-prior; George and Foster 2000, doi:10.1093/biomet/87.4.731). A smooth function is a Gaussian process
sampled at knots: its evidence is the marginal likelihood, maximised over amplitude and correlation length (Rasmussen and
Williams 2006, section 5.4), less a price for those two. See docs/how-the-search-works.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dsterf, dsytrd
from scipy.special import gammaincc

from aridcal.engine.corrections.smooth import Kernel, Shape, kernels_that_matter, samples_root
from aridcal.engine.fit.normal_equations import NormalEquations, inverse
from aridcal.engine.fit.normal_equations import solve as solve_equations
from aridcal.engine.levels import PRICE
from aridcal.engine.numerics import FLOOR, RIDGE, ROUNDS, TINY

DEPENDENT_SHARE = 1e-6
"""Share of a column's square that must be left when the model's own columns are taken off: below it is rounding."""

NOISE_SETTLED = 1e-2
"""Work: Change of the logarithm of the noise that ends this: a hundredth of a sigma moves no decision."""

NOISE_KNOWN = 2e-3
"""Work: The same where coefficients are solved for: of 10,000 numbers the likelihood is then known to 0.04 nat."""

LEAST_FREEDOM_SHARE = 0.05
"""Work: Share of a channel's numbers that is left to estimate its noise from, whatever the freedom of the model."""

TAUS = np.logspace(-1.5, 9, 43)
"""Work: Prior variances that are tried, in units of the best seen mode, at a first look of all: four a decade, from nothing to
all."""

MOST_EXPLAINED_SHARE = 1.0 - 1e-12
"""Work: A share of the residual that is explained is at most this: beyond it is rounding."""

HIDDEN_PRIOR = 1e-3
"""Work: Prior variance of a mode that is rounding, in units of its noise, from which it is left out by name: a mode below it
adds no more than such a share of a nat."""

FACTORS = 24
"""Work: Factors from 1e-9 to 33 that are multiplied before a logarithm is taken: their product is far from what overflows."""

EVIDENCE_AT_ONCE = 400
"""Work: Candidates times kernels whose evidence is found at once: their numbers stay in the cache."""

ROUGH_KERNELS = tuple(Kernel(length) for length in (0.7, 1.5, 3.0, 6.0, 12.0, 24.0))
"""Work: Shapes of smooth functions for a first look: an octave apart, from one knot to a third of a joint map."""

KERNELS = (*ROUGH_KERNELS, *(Kernel(length, kinks=False) for length in (1.5, 3.0, 6.0, 9.0, 12.0, 18.0)))
"""Work: All shapes: those, and functions without any kink."""


@dataclass(frozen=True)
class Solution:
    """Coefficients of a linearised model and the noise that goes with them.

    Attributes:
        beta: Shape (K,).
        sigma: Noise of each channel per axis, shape (C,).
        likelihood: Logarithm, up to a constant.
        inverse: (A'WA + prior)^-1, shape (K, K).
        spent: Degrees of freedom that the coefficients use up in each channel, shape (C,).
    """

    beta: np.ndarray
    sigma: np.ndarray
    likelihood: float
    inverse: np.ndarray
    spent: np.ndarray


@dataclass(frozen=True)
class Score:
    """Evidence for one candidate.

    Attributes:
        gain: Logarithm of the evidence in its favour, the price of its freedom taken off, [nat].
        p_value: Chance that noise alone gains as much, before correction for the number of candidates.
        freedom: Columns that are not sums of the model's.
        tau: Prior standard deviation of a smooth function, [m] or [rad]; else 0.
        kernel: Kernel of a smooth function.
        sigma: Noise of each channel with the candidate in the model, shape (C,); None in a rough score.
    """

    gain: float
    p_value: float
    freedom: int
    tau: float = 0.0
    kernel: Kernel = ROUGH_KERNELS[0]
    sigma: np.ndarray | None = None


class Amplitudes(NamedTuple):
    """The likeliest amplitude of each of n candidates.

    Attributes:
        variance: Of the prior, tau^2, shape (n,).
        twice: Logarithm of the likelihood ratio to nothing, times two, shape (n,).
        freedom: Degrees of freedom that the samples use up then, shape (n,).
        informed: False where the data say nothing of the samples, shape (n,).
    """

    variance: np.ndarray
    twice: np.ndarray
    freedom: np.ndarray
    informed: np.ndarray


NO_SCORE = Score(0.0, 1.0, 0)
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
    for _ in range(ROUNDS):
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
    """Noise, shape (C,), and log-likelihood, for known degrees of freedom of the coefficients.

    Args:
        equations: Of K coefficients.
        precision: Of their priors, shape (K, K).
        sigma: Noise to begin with, shape (C,).
        beta: The coefficients for that noise, shape (K,).
        spent: Degrees of freedom that they use up in each channel, shape (C,).
    """
    for k in range(ROUNDS):
        beta = coefficients(equations, precision, sigma) if k else beta
        squares = equations.squares_left(beta)
        before, sigma = sigma, noise_left(equations, squares, spent)
        if np.all(np.abs(np.log(sigma / before)) < NOISE_SETTLED):
            break
    return sigma, _likelihood(equations, precision, sigma, beta, squares)


def noise_left(equations: NormalEquations, squares: np.ndarray, spent: np.ndarray) -> np.ndarray:
    """Noise of each channel, shape (C,), from the residual's squares and the degrees of freedom that were used up."""
    freedom = np.maximum(equations.count - spent, LEAST_FREEDOM_SHARE * equations.count + 1e-9)
    return np.maximum(np.sqrt(squares / freedom), FLOOR)


def _likelihood(
    equations: NormalEquations, precision: np.ndarray, sigma: np.ndarray, beta: np.ndarray, squares: np.ndarray
) -> float:
    """Log-likelihood of coefficients and noise, up to a constant."""
    misfit = float(equations.count @ np.log(sigma**2) + np.sum(squares / sigma**2))
    return -0.5 * (misfit + float(beta @ precision @ beta))


def scores(
    M: np.ndarray, s: np.ndarray, raw: np.ndarray, total: float, count: float, shape: Shape | None = None
) -> list[Score]:
    """Evidence for k candidates of d columns each, one by one.

    Args:
        M: Their Gram matrices after projection off the model, in units of sigma, shape (k, d, d).
        s: Their products with the residual, shape (k, d).
        raw: Their squared lengths before projection, shape (k, d).
        total: The residual's sum of squares, in units of sigma.
        count: Numbers measured.
        shape: What the columns sample, for smooth functions; else None.
    """
    return _smooth(M, s, raw, shape, ROUGH_KERNELS, total, count) if shape else _plain(M, s, raw, total, count)


def shaped(total: NormalEquations, precision: np.ndarray, shape: Shape, sigma: np.ndarray) -> Score:
    """The shape that suits a smooth function best, for a given noise.

    Args:
        total: Equations of the model's coefficients and, after them, of the samples of the function.
        precision: Prior precision of the model's own coefficients.
        shape: What the samples are of.
        sigma: Noise of each channel, shape (C,).
    """
    K = len(precision)
    H, g = total.information(sigma), total.pull(sigma)
    alone = solve_equations(H[:K, :K] + precision, np.column_stack([H[:K, K:], g[:K]]), ridge=RIDGE)
    M, s = H[K:, K:] - H[K:, :K] @ alone[:, :-1], g[K:] - H[K:, :K] @ alone[:, -1]
    return replace(_smooth(M[None], s[None], np.diag(H)[None, K:], shape, KERNELS)[0], sigma=sigma)


def price(twice: float, freedom: int) -> float:
    """Evidence [nat] of columns that raise twice the log-likelihood by ``twice``, the price of their freedom taken off."""
    return 0.5 * (twice - charge(twice, freedom))


def charge(twice: float, freedom: int) -> float:
    """Twice the price [nat] of the freedom of columns that raise twice the log-likelihood by ``twice``."""
    return freedom * (1.0 + float(np.log(max(twice / max(freedom, 1), 1.0))))


def _plain(M: np.ndarray, s: np.ndarray, raw: np.ndarray, total: float, count: float) -> list[Score]:
    """Scores of columns that are no samples of smooth functions; see :func:`scores`."""
    squares, freedoms = explained(M, s, raw)
    twice = profiled(squares, total, count)
    return [
        Score(price(gain, freedom), tail(gain, freedom), freedom) if freedom else NO_SCORE
        for gain, freedom in zip(twice.tolist(), freedoms.tolist(), strict=True)
    ]


def explained(M: np.ndarray, s: np.ndarray, raw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squares that columns explain, shape (k,), and how many columns are not sums of the model's, (k,); see :func:`scores`."""
    scale = 1.0 / np.sqrt(np.maximum(raw, TINY))
    values, vectors = np.linalg.eigh(M * scale[:, :, None] * scale[:, None, :])
    new = values > DEPENDENT_SHARE
    along = np.einsum("kij,ki->kj", vectors, s * scale)
    squares = np.sum(np.where(new, along**2 / np.where(new, values, 1.0), 0.0), axis=1)
    return squares, new.sum(axis=1)


def _smooth(
    M: np.ndarray,
    s: np.ndarray,
    raw: np.ndarray,
    shape: Shape,
    kernels: tuple[Kernel, ...],
    total: float = np.inf,
    count: float = 0.0,
) -> list[Score]:
    """Scores with the best of the kernels and of the amplitudes :data:`TAUS`; the noise is profiled if ``total`` is finite.

    See :func:`likeliest`.
    """
    kernels = kernels_that_matter(shape, kernels)
    parts = []
    step = max(1, EVIDENCE_AT_ONCE // len(s))
    for first in range(0, len(kernels), step):
        roots = np.stack([samples_root(shape, kernel) for kernel in kernels[first : first + step]])[:, None]
        A, b = np.swapaxes(roots, 2, 3) @ M @ roots, s @ roots[:, 0]
        mean_square = np.sum(roots[:, 0] ** 2, axis=2) @ raw.T / s.shape[1]
        parts.append(likeliest(A.reshape(-1, *M.shape[1:]), b.reshape(-1, s.shape[1]),
                               DEPENDENT_SHARE * mean_square.ravel(), total, count, total < np.inf))  # fmt: skip
    variance, twice, freedom, informed = (
        np.concatenate(each).reshape(len(kernels), -1) for each in zip(*parts, strict=True)
    )
    best = np.argmax(np.where(informed, twice, -np.inf), axis=0)
    return [
        Score(
            0.5 * float(twice[at, k]) - 2.0 * PRICE,
            smooth_tail(float(twice[at, k])),
            max(round(float(freedom[at, k])), 1),
            float(np.sqrt(variance[at, k])),
            kernels[at],
        )
        if informed[at, k]
        else NO_SCORE
        for k, at in enumerate(best.tolist())
    ]


def likeliest(
    A: np.ndarray, b: np.ndarray, least: np.ndarray, total: float, count: float, roughly: bool = False
) -> Amplitudes:
    r"""The likeliest of the amplitudes of :data:`TAUS`.

    .. math:: 2 \log L(\tau) = \tau^2 b^T (I + \tau^2 A)^{-1} b - \log |I + \tau^2 A|

    with the first term, the squares explained, profiled as for plain columns where the noise is not known.

    Args:
        A: Information of the samples, times the root of their prior on both sides, in units of sigma, shape (n, d, d).
        b: Their pulls likewise, shape (n, d).
        least: Information of a mode below which its pull is rounding, shape (n,).
        total: The residual's sum of squares, in units of sigma, of which the noise is profiled; infinite where it is known.
        count: Numbers measured.
        roughly: Take amplitudes in units of the trace of A, which needs no eigenvalues.
    """
    likely = _by_chain(A, b, total, count, roughly)
    doubted = likely.variance * least > HIDDEN_PRIOR
    if doubted.any():
        for values, sure in zip(likely, _by_modes(A[doubted], b[doubted], least[doubted], total, count), strict=True):
            values[doubted] = sure
    return likely


def profiled(squares: np.ndarray, total: float, count: float) -> np.ndarray:
    """Twice the gain in log-likelihood from squares explained; the noise is estimated with them where ``total`` is finite."""
    if total == np.inf:
        return squares
    return np.asarray(
        -count * np.log1p(-np.minimum(squares, MOST_EXPLAINED_SHARE * max(total, TINY)) / max(total, TINY))
    )


def _by_chain(A: np.ndarray, b: np.ndarray, total: float, count: float, roughly: bool) -> Amplitudes:
    r"""The likeliest amplitudes without eigenvectors, which would take most of the time of a search.

    Reflections make A tridiagonal and b one number (Golub and Van Loan, Matrix Computations, 4th ed., section 8.3.1). With
    :math:`v = \tau^{-2}`, diagonal :math:`\alpha_j`, :math:`\beta_j` beside it, :math:`\beta_0 = |b|`, from the last row up,

    .. math:: F_d = v + \alpha_d, \quad F_j = v + \alpha_j - \beta_j^2 / F_{j+1}, \quad
        2 \log L = \beta_0^2 / F_1 - \sum_j \log (F_j / v)
    """
    diagonal, square, scale = _chains(A, b, roughly)
    d = b.shape[1]
    largest = _largest(scale)
    diagonal, square = diagonal / largest, square / largest**2
    faint = 1.0 / TAUS
    F = np.maximum(faint + diagonal[:, -1:], faint)  # the bound holds but for rounding
    product = F.copy()
    volume = np.full(F.shape, d * np.log(TAUS))
    ratio_above = np.empty_like(F)
    for j in range(d - 2, -1, -1):
        np.divide(square[:, j + 1, None], F, out=ratio_above)
        np.add(faint, diagonal[:, j, None], out=F)
        F -= ratio_above
        np.maximum(F, faint, out=F)
        product *= F
        if (d - j) % FACTORS == 0:
            volume += np.log(product)
            product[:] = 1.0
    volume += np.log(product)
    # In units of the largest mode b's square is divided by its square, explained squares by the mode itself.
    twice = profiled(square[:, :1] * largest / F, total, count) - volume
    top = np.argmax(twice, axis=1)
    v = 1.0 / TAUS[top]
    F = np.maximum(v + diagonal[:, -1], v)
    slope = v / F  # d log F / d log v, 1 at the most: F - v is concave in v, and not negative at 0
    free = slope.copy()
    for j in range(d - 2, -1, -1):
        ratio = square[:, j + 1] / F
        F = np.maximum(v + diagonal[:, j] - ratio, v)
        slope = np.minimum((v + ratio * slope) / F, 1.0)
        free += slope
    return Amplitudes(TAUS[top] / largest[:, 0], twice[np.arange(len(top)), top], d - free, scale > TINY**0.5)


def _by_modes(A: np.ndarray, b: np.ndarray, least: np.ndarray, total: float, count: float) -> Amplitudes:
    """The likeliest amplitudes in the eigenbasis, without the pulls of modes that are rounding."""
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, 0.0)
    largest = _largest(values[:, -1])
    squares = np.where(values > least[:, None], np.einsum("kij,ki->kj", vectors, b) ** 2, 0.0)
    variances = TAUS / largest
    shrunk = 1.0 + variances[:, :, None] * values[:, None]
    fitted = variances * np.einsum("ktj,kj->kt", 1.0 / shrunk, squares)
    twice = profiled(fitted, total, count) - np.sum(np.log(shrunk), axis=2)
    top = np.argmax(twice, axis=1)
    at_top = np.arange(len(top)), top
    return Amplitudes(
        variances[at_top], twice[at_top], np.sum(1.0 - 1.0 / shrunk[at_top], axis=1), values[:, -1] > TINY**0.5
    )


def _largest(scale: np.ndarray) -> np.ndarray:
    """Units of the amplitudes, shape (n, 1); 1 where the data say nothing."""
    return np.where(scale > TINY**0.5, scale, 1.0)[:, None]


def _chains(A: np.ndarray, b: np.ndarray, roughly: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diagonals of the tridiagonal forms and squares of the off-diagonals, the pull's first, (n, d) each; the scale, (n,)."""
    n, d = b.shape
    bordered = np.zeros((n, d + 1, d + 1))
    bordered[:, 1:, 1:] = A
    bordered[:, 0, 1:] = b
    diagonal, beside, best = np.empty((n, d + 1)), np.empty((n, d)), np.einsum("kii->k", A)
    for k, matrix in enumerate(bordered):  # transposed it is as LAPACK wants it, without a copy
        _, diagonal[k], beside[k], _, _ = dsytrd(matrix.T, lower=1, overwrite_a=1)
        if not roughly and d > 1:
            best[k] = dsterf(diagonal[k, 1:], beside[k, 1:])[0][-1]
    # The largest eigenvalue is no smaller than any number on the diagonal, but for rounding.
    return diagonal[:, 1:], beside**2, np.maximum(best, diagonal[:, 1:].max(axis=1))


def smooth_tail(twice: float) -> float:
    """Upper bound of the chance that noise raises twice the log-likelihood of a smooth function by ``twice``.

    A variance that may only be positive: half the cases give nothing, the rest at most chi-square with 2 degrees.
    """
    return float(np.exp(-max(0.5 * twice, 0.0)))


def tail(twice: float, freedom: int) -> float:
    """Chance that chi-square with ``freedom`` degrees of freedom exceeds ``twice``."""
    return float(gammaincc(0.5 * freedom, 0.5 * max(twice, 0.0)))
