"""How much a group of columns explains: score tests against a linearised model, with shrinkage where it is smooth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.special import gammaincc

from aridcal.residual import FLOOR, Sigma

DEPENDENT = 1e-6  # share of a column's square that must be left when the model's own columns are taken off
SMOOTH_PRICE = 2.0  # nats for the two numbers that shape a smooth function
TAUS = np.logspace(-1.5, 9, 43)[:, None]  # prior variances that are tried, in units of the best seen mode
SPREAD = 1e-11  # smallest variance of a smooth function's modes, as a share of the largest


@dataclass(frozen=True)
class Kernel:
    """What is believed of a smooth function beforehand: over how many knots it is alike, and if it has kinks.

    Attributes:
        length: Correlation length in knots.
        kinks: True: Matern 7/2, three derivatives; False: a squared exponential, all derivatives.
    """

    length: float
    kinks: bool = True


ROUGH = tuple(Kernel(length) for length in (0.7, 1.5, 3.0, 6.0, 12.0, 24.0))
KERNELS = (*ROUGH, *(Kernel(length, kinks=False) for length in (1.5, 3.0, 6.0, 9.0, 12.0, 18.0)))


@dataclass(frozen=True)
class Sums:
    """Gram matrices of columns and residual for unit sigma, positions and rotations apart.

    Attributes:
        AA: A'A, shape (2, K, K).
        Ar: A'r, shape (2, K).
        rr: r'r, shape (2,).
        count: Numbers measured, shape (2,).
    """

    AA: np.ndarray
    Ar: np.ndarray
    rr: np.ndarray
    count: np.ndarray

    def minus(self, other: Sums) -> Sums:
        """What is left when some of the rows are taken out."""
        return Sums(self.AA - other.AA, self.Ar - other.Ar, self.rr - other.rr, self.count - other.count)

    def combined(self, T: np.ndarray) -> Sums:
        """The sums with the last d columns replaced by combinations of them, shape (d, new)."""
        first = self.AA.shape[1] - len(T)
        cross = self.AA[:, :first, first:] @ T
        AA = np.concatenate([np.concatenate([self.AA[:, :first, :first], cross], axis=2),
                             np.concatenate([cross.transpose(0, 2, 1), T.T @ self.AA[:, first:, first:] @ T], axis=2)],
                            axis=1)  # fmt: skip
        return Sums(AA, np.hstack([self.Ar[:, :first], self.Ar[:, first:] @ T]), self.rr, self.count)

    def part(self, keep: np.ndarray) -> Sums:
        """The sums of some of the columns."""
        return Sums(self.AA[:, keep][:, :, keep], self.Ar[:, keep], self.rr, self.count)


@dataclass(frozen=True)
class Solution:
    """Coefficients of a linearised model and the noise that goes with them.

    Attributes:
        beta: Shape (K,).
        sigma: Noise per axis.
        likelihood: Logarithm, up to a constant.
        inverse: (A'WA + prior)^-1, shape (K, K).
    """

    beta: np.ndarray
    sigma: Sigma
    likelihood: float
    inverse: np.ndarray


@dataclass(frozen=True)
class Score:
    """What one candidate would add.

    Attributes:
        gain: Logarithm of the evidence in its favour: what it explains less what its freedom costs, [nat].
        p_value: Of its columns' contribution if nothing were there, before correction for the number of candidates.
        freedom: Columns that say something new.
        tau: For smooth functions: prior standard deviation [m] or [rad]; else 0.
        kernel: For smooth functions: what they are like.
        sigma: For smooth functions: the noise that is left with them in the model, per axis; unknown at first.
    """

    gain: float
    p_value: float
    freedom: int
    tau: float = 0.0
    kernel: Kernel = ROUGH[0]
    sigma: Sigma | None = None


def sums(A: Sequence[np.ndarray], r: Sequence[np.ndarray]) -> Sums:
    """Gram matrices of weighted columns, shape (3N, K), and residuals, shape (3N,), of positions and rotations."""
    K = A[0].shape[1]
    AA, Ar, rr, count = np.zeros((2, K, K)), np.zeros((2, K)), np.zeros(2), np.zeros(2)
    for k, (a, b) in enumerate(zip(A, r, strict=True)):
        AA[k], Ar[k], rr[k], count[k] = a.T @ a, a.T @ b, b @ b, len(b)
    return Sums(AA, Ar, rr, count)


def extended(s: Sums, A: Sequence[np.ndarray], C: Sequence[np.ndarray], r: Sequence[np.ndarray]) -> Sums:
    """The sums of columns A with columns C added, where those of A are known."""
    P, d = A[0].shape[1], C[0].shape[1]
    AA, Ar = np.zeros((2, P + d, P + d)), np.zeros((2, P + d))
    for k, (a, c, b) in enumerate(zip(A, C, r, strict=True)):
        cross = a.T @ c
        AA[k, :P, :P], AA[k, :P, P:], AA[k, P:, :P], AA[k, P:, P:] = s.AA[k], cross, cross.T, c.T @ c
        Ar[k, :P], Ar[k, P:] = s.Ar[k], c.T @ b
    return Sums(AA, Ar, s.rr, s.count)


def coefficients(s: Sums, precision: np.ndarray, sigma: Sigma) -> np.ndarray:
    """Least squares with priors for a given noise, shape (K,)."""
    variance = np.array([sigma.position, sigma.rotation]) ** 2
    H = s.AA[0] / variance[0] + s.AA[1] / variance[1] + precision
    S, scale = _scaled(H)
    g = scale * (s.Ar[0] / variance[0] + s.Ar[1] / variance[1])
    try:
        return np.asarray(scale * cho_solve(cho_factor(S), g))
    except np.linalg.LinAlgError:
        return np.asarray(scale * (np.linalg.pinv(S, hermitian=True, rcond=1e-12) @ g))


def solve(s: Sums, precision: np.ndarray, sigma: Sigma) -> Solution:
    """Least squares with priors, the noise estimated with it."""
    beta, inverse, square = _solved(s, precision, sigma)
    for _ in range(6):
        variance = np.array([sigma.position, sigma.rotation]) ** 2
        spent = np.einsum("ij,kij->k", inverse, s.AA) / variance
        freedom = np.maximum(s.count - spent, 0.05 * s.count + 1e-9)
        fresh = np.sqrt(square / freedom)
        before, sigma = sigma, Sigma(max(float(fresh[0]), FLOOR), max(float(fresh[1]), FLOOR) if s.count[1] else 1.0)
        beta, inverse, square = _solved(s, precision, sigma)
        if abs(np.log(before.position / sigma.position)) + abs(np.log(before.rotation / sigma.rotation)) < 1e-2:
            break
    variance = np.array([sigma.position, sigma.rotation]) ** 2
    likelihood = -0.5 * float(s.count @ np.log(variance) + np.sum(square / variance) + beta @ precision @ beta)
    return Solution(beta, sigma, likelihood, inverse)


def _solved(s: Sums, precision: np.ndarray, sigma: Sigma) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients, inverse and sums of squares left for a given noise: always of one piece."""
    variance = np.array([sigma.position, sigma.rotation]) ** 2
    inverse = _inverse(s.AA[0] / variance[0] + s.AA[1] / variance[1] + precision)
    beta = inverse @ (s.Ar[0] / variance[0] + s.Ar[1] / variance[1])
    square = s.rr - 2 * s.Ar @ beta + np.einsum("i,kij,j->k", beta, s.AA, beta)
    return beta, inverse, np.maximum(square, 0.0)


def score(
    M: np.ndarray, s: np.ndarray, raw: np.ndarray, left: float, count: float, shape: tuple[int, ...] | None = None
) -> Score:
    """Evidence for d columns.

    Args:
        M: Their Gram matrix after projection off the model, in units of sigma, shape (d, d).
        s: Their product with the residual, shape (d,).
        raw: Their squared lengths before projection, shape (d,).
        left: The residual's sum of squares, in units of sigma.
        count: Numbers measured.
        shape: Of the grid, for samples of a smooth function; else None.
    """
    return _smooth(M, s, raw, shape, ROUGH, left, count) if shape else _plain(M, s, raw, left, count)


def shaped(total: Sums, precision: np.ndarray, shape: tuple[int, ...], sigma: Sigma) -> Score:
    """The shape that suits a smooth function best, for a given noise.

    Args:
        total: Sums of the model's columns and, after them, the samples of the function.
        precision: Prior of the model's own coefficients.
        shape: Of the function's grid.
        sigma: Noise per axis.
    """
    K = len(precision)
    variance = np.array([sigma.position, sigma.rotation]) ** 2
    H, g = (total.AA / variance[:, None, None]).sum(0), (total.Ar / variance[:, None]).sum(0)
    inverse = _inverse(H[:K, :K] + precision)
    M = H[K:, K:] - H[K:, :K] @ inverse @ H[:K, K:]
    s = g[K:] - H[K:, :K] @ (inverse @ g[:K])
    return replace(_smooth(M, s, np.diag(H)[K:], shape, KERNELS), sigma=sigma)


def _plain(M: np.ndarray, s: np.ndarray, raw: np.ndarray, left: float, count: float) -> Score:
    if len(s) == 1:  # most candidates: no need of a decomposition
        if M[0, 0] <= DEPENDENT * raw[0]:
            return Score(0.0, 1.0, 0)
        twice = _profiled(float(s[0] ** 2 / M[0, 0]), left, count)
        return Score(0.5 * (twice - 1.0 - np.log(max(twice, 1.0))), tail(twice, 1), 1)
    scale = 1.0 / np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(M * np.outer(scale, scale))
    good = values > DEPENDENT
    d = int(good.sum())
    if d == 0:
        return Score(0.0, 1.0, 0)
    explained = float(np.sum((vectors[:, good].T @ (s * scale)) ** 2 / values[good]))
    twice = _profiled(explained, left, count)
    gain = 0.5 * (twice - d * (1.0 + np.log(max(twice / d, 1.0))))
    return Score(gain, tail(twice, d), d)


def _smooth(
    M: np.ndarray,
    s: np.ndarray,
    raw: np.ndarray,
    shape: tuple[int, ...],
    kernels: Sequence[Kernel],
    left: float = np.inf,
    count: float = 0.0,
) -> Score:
    """Evidence of the best kernel; the noise is profiled if what is left of the residual is given, else known."""
    best = Score(-np.inf, 1.0, 0)
    for kernel in kernels:
        root = kernel_root(shape, kernel)
        spectrum, vectors = np.linalg.eigh(root.T @ M @ root)
        values = np.maximum(spectrum, 0.0)
        if values[-1] <= 0.0:
            return Score(0.0, 1.0, 0)
        seen = values > DEPENDENT * float(np.sum(root**2 * raw[:, None])) / len(s)
        a = np.where(seen, (vectors.T @ (root.T @ s)) ** 2, 0.0)
        tau2 = TAUS / values[-1]
        explained = (tau2 / (1.0 + tau2 * values)) @ a
        twice = explained if left == np.inf else -count * np.log1p(-np.minimum(explained / left, 1 - 1e-12))
        twice = twice - np.sum(np.log1p(tau2 * values), axis=1)
        k = int(np.argmax(twice))
        gain = 0.5 * float(twice[k]) - SMOOTH_PRICE
        if gain > best.gain:
            freedom = float(np.sum(tau2[k] * values / (1.0 + tau2[k] * values)))
            # A variance that may only be positive: half the cases give nothing, the rest at most chi-square with 2.
            p_value = float(np.exp(-max(0.5 * float(twice[k]), 0.0)))
            best = Score(gain, p_value, max(round(freedom), 1), float(np.sqrt(tau2[k, 0])), kernel)
    return best


def tail(twice: float, d: int) -> float:
    """Chance that chi-square with d degrees of freedom exceeds a value."""
    return float(gammaincc(0.5 * d, 0.5 * max(twice, 0.0)))


@cache
def kernel_root(shape: tuple[int, ...], kernel: Kernel) -> np.ndarray:
    """Square root of the prior covariance of a smooth function's samples, a product over its covariates."""
    root: np.ndarray = np.ones((1, 1))
    for knots in shape:
        apart = np.abs(np.subtract.outer(np.arange(knots), np.arange(knots))) / kernel.length
        a = np.sqrt(7.0) * apart
        matern = (1.0 + a + 0.4 * a**2 + a**3 / 15.0) * np.exp(-a)
        values, vectors = np.linalg.eigh(matern if kernel.kinks else np.exp(-0.5 * apart**2))
        least = SPREAD ** (1 / len(shape)) * values[-1]
        root = np.kron(root, vectors * np.sqrt(np.maximum(values, least)))
    return root


def smooth_precision(shape: tuple[int, ...], tau: float, kernel: Kernel) -> np.ndarray:
    """Inverse of the prior covariance of a smooth function's coefficients."""
    root = np.linalg.inv(kernel_root(shape, kernel))
    return np.asarray(root.T @ root) / tau**2


def _profiled(explained: float, left: float, count: float) -> float:
    """Twice the gain in log-likelihood when the noise is estimated anew."""
    return float(-count * np.log1p(-min(explained / left, 1 - 1e-12)))


def _inverse(H: np.ndarray) -> np.ndarray:
    if not len(H):
        return H
    S, scale = _scaled(H)
    factor, failed = dpotrf(S, lower=1)
    if failed:
        inverse = np.asarray(np.linalg.pinv(S, hermitian=True, rcond=1e-12))
    else:
        lower = np.tril(dpotri(factor, lower=1)[0])
        inverse = lower + np.tril(lower, -1).T
    return inverse * scale * scale[:, None]


def _scaled(H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A matrix brought to unit diagonal, and the scale of its columns."""
    diagonal = np.diag(H)
    moves = diagonal > 1e-300  # a column that moves nothing is left where it is
    scale = np.where(moves, 1.0 / np.sqrt(np.where(moves, diagonal, 1.0)), 0.0)
    return H * scale * scale[:, None] + np.diag(np.where(moves, 1e-13, 1.0)), scale
