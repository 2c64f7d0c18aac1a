r"""Normal equations of weighted linear least squares, channel by channel: the one type that all fits and tests share.

For columns A and right-hand side r, split into channels c of noise :math:`\sigma_c`,

.. math:: H = \sum_c A_c^T A_c / \sigma_c^2, \qquad g = \sum_c A_c^T r_c / \sigma_c^2, \qquad \theta = (H + P)^{-1} g

with P the precision of a prior. The sums are kept for unit noise, so that the noise can be estimated with theta and
rows can be taken out (:meth:`NormalEquations.minus`) without a second look at the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpocon, dpotrf, dpotri, dpotrs, dtrtri

from aridcal.engine.numerics import RANK, RIDGE, TINY

UNDETERMINED_SHARE = 1e-10
"""Work: Share of the largest eigenvalue of a group's equations, each unknown scaled to 1, below which a direction is
rounding."""

CONDITION_MARGIN = 10.0
"""Work: Times the share that eigenvalues must reach above which LAPACK's estimate of the reciprocal condition says that all of
them do: it is rarely off by more than 3 (Higham 2002, Accuracy and Stability of Numerical Algorithms, section 15.3)."""

BORDERED_PULL_SHARE = 1e-7
"""Work: Share of the pull, unknowns scaled alike, that a solution from a known inverse may leave: else all are solved for
anew."""


@dataclass(frozen=True)
class NormalEquations:
    """Sums over rows for unit noise, K unknowns, C channels.

    Attributes:
        AA: A'A, shape (C, K, K).
        Ar: A'r, shape (C, K).
        rr: r'r, shape (C,).
        count: Numbers measured, shape (C,).
    """

    AA: np.ndarray
    Ar: np.ndarray
    rr: np.ndarray
    count: np.ndarray

    def information(self, sigma: np.ndarray) -> np.ndarray:
        """H, shape (K, K), for noise of shape (C,)."""
        return np.asarray(np.tensordot(sigma**-2.0, self.AA, 1))

    def pull(self, sigma: np.ndarray) -> np.ndarray:
        """g, shape (K,)."""
        return np.asarray((self.Ar / (sigma**2)[:, None]).sum(axis=0))

    def squares_left(self, theta: np.ndarray) -> np.ndarray:
        """Sum of squared residuals of each channel at theta, shape (C,)."""
        return np.maximum(self.rr - 2 * self.Ar @ theta + self.AA @ theta @ theta, 0.0)

    def spent(self, inverse: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Degrees of freedom that each channel gives up: tr(H^-1 A_c'A_c) / sigma_c^2, shape (C,)."""
        return np.asarray(np.einsum("ij,cij->c", inverse, self.AA) / sigma**2)

    def minus(self, other: NormalEquations) -> NormalEquations:
        """The equations without the rows of the other sums."""
        return NormalEquations(self.AA - other.AA, self.Ar - other.Ar, self.rr - other.rr, self.count - other.count)

    def part(self, keep: np.ndarray) -> NormalEquations:
        """The equations of some of the unknowns, all others held at zero."""
        return NormalEquations(self.AA[:, keep][:, :, keep], self.Ar[:, keep], self.rr, self.count)

    def bordered(self, cross: np.ndarray, among: np.ndarray, pull: np.ndarray) -> NormalEquations:
        """The equations with d columns added behind the K, from their products.

        Args:
            cross: Products of the K columns with the new ones, shape (C, K, d).
            among: Products of the new columns with one another, shape (C, d, d).
            pull: Products of the new columns with the right-hand side, shape (C, d).
        """
        return NormalEquations(_bordered(self.AA, cross, among), np.hstack([self.Ar, pull]), self.rr, self.count)

    def combined(self, T: np.ndarray) -> NormalEquations:
        """The equations with the last d unknowns replaced by their combinations T, shape (d, new)."""
        first = self.AA.shape[1] - len(T)
        kept, replaced = slice(first), slice(first, None)
        cross = self.AA[:, kept, replaced] @ T
        among = T.T @ self.AA[:, replaced, replaced] @ T
        AA = _bordered(self.AA[:, kept, kept], cross, among)
        pull = self.Ar[:, replaced] @ T
        return NormalEquations(AA, np.hstack([self.Ar[:, kept], pull]), self.rr, self.count)


def accumulate(A: Sequence[np.ndarray], r: Sequence[np.ndarray]) -> NormalEquations:
    """Normal equations from columns (n, K) and right-hand sides (n,), one of each for every channel."""
    information = np.array([a.T @ a for a in A])
    pull = np.array([a.T @ b for a, b in zip(A, r, strict=True)])
    squares = np.array([b @ b for b in r])
    count = np.array([float(len(b)) for b in r])
    return NormalEquations(information, pull, squares, count)


def _bordered(first: np.ndarray, cross: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Symmetric matrices from their blocks: (C, K, K), (C, K, d) and (C, d, d) to (C, K + d, K + d)."""
    upper = np.concatenate([first, cross], axis=2)
    lower = np.concatenate([cross.transpose(0, 2, 1), last], axis=2)
    return np.concatenate([upper, lower], axis=1)


def balanced(H: np.ndarray, ridge: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """H scaled to unit diagonal (plus a ridge), and the scale of its unknowns: metres and radians must not upset the rank.

    An unknown that moves nothing gets a diagonal of 1 and a scale of 0: its solution is 0.
    """
    diagonal = np.diag(H)
    moves = diagonal > TINY
    scale = np.where(moves, 1.0 / np.sqrt(np.where(moves, diagonal, 1.0)), 0.0)
    S = H * scale
    S *= scale[:, None]
    S.flat[:: len(H) + 1] += np.where(moves, ridge, 1.0)
    return S, scale


def directions(H: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues of matrices (G, U, U) scaled to unit diagonal, infinite where rounding; eigenvectors; scales of unknowns."""
    size = np.sqrt(np.einsum("guu->gu", H))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    values, vectors = np.linalg.eigh(H * scale[:, :, None] * scale[:, None, :])
    informed = values > UNDETERMINED_SHARE * np.maximum(values[:, -1:], TINY)
    return np.where(informed, values, np.inf), vectors, scale


def inverse(H: np.ndarray, ridge: float = RIDGE) -> np.ndarray:
    """H^-1 by Cholesky with a ridge; the pseudo-inverse where H is singular. Twice as fast as :func:`solve`."""
    if not len(H):
        return H
    S, scale = balanced(H, ridge)
    factor, failed = dpotrf(S.T, lower=1)  # symmetric; transposed, LAPACK need not turn it first
    if failed:
        result = np.asarray(np.linalg.pinv(S, hermitian=True, rcond=RANK))
    else:
        lower = dpotri(factor, lower=1, overwrite_c=1)[0]
        result = np.asarray(lower + lower.T)  # nothing stands above the diagonal
        result.flat[:: len(H) + 1] *= 0.5
    result *= scale
    result *= scale[:, None]
    return result


def solve(H: np.ndarray, g: np.ndarray, damping: float = 0.0, ridge: float = 0.0) -> np.ndarray:
    """(H + damping)^-1 g by Cholesky, damping in units of H's diagonal; the shortest solution where H is singular.

    Args:
        H: Shape (K, K).
        g: Shape (K,) or (K, n).
        damping: Levenberg's, for steps that overshoot.
        ridge: See :data:`RIDGE`.
    """
    if not len(H):
        return g
    S, scale = balanced(H, ridge)
    S.flat[:: len(H) + 1] += damping
    pull = (g.T * scale).T
    factor, failed = dpotrf(S.T, lower=1, clean=0)
    solution = np.linalg.pinv(S, hermitian=True, rcond=RANK) @ pull if failed else dpotrs(factor, pull, lower=1)[0]
    return np.asarray((solution.T * scale).T)


def shortest(H: np.ndarray, b: np.ndarray) -> np.ndarray:
    """H^-1 b by the pseudo-inverse of balanced equations, b of shape (K,) or (K, n): the shortest solution if H is singular."""
    if not len(H):
        return b
    S, scale = balanced(H)
    wide = scale[:, None] * b.reshape(len(b), -1)
    return np.asarray((scale[:, None] * (np.linalg.pinv(S, hermitian=True) @ wide)).reshape(b.shape))


def condition(H: np.ndarray) -> float:
    """Condition number of the Jacobian with its columns scaled to length 1, from J'J."""
    if not len(H):
        return 1.0
    length = np.sqrt(np.maximum(np.diag(H), TINY))
    values = np.abs(np.linalg.eigvalsh(H / length / length[:, None]))
    return float(np.sqrt(values.max() / max(float(values.min()), TINY)))


def nested_solutions(H: np.ndarray, g: np.ndarray, first: int) -> np.ndarray:
    """Solutions for the first unknowns alone, the others zero, and for all, shape (K, 2), by one factorisation.

    Args:
        H: Shape (K, K).
        g: Shape (K,).
        first: Number of the first unknowns.
    """
    S, scale = balanced(H, RIDGE)
    factor, failed = dpotrf(S.T, lower=1)
    if failed:
        alone = np.pad(solve(H[:first, :first], g[:first], ridge=RIDGE), (0, len(g) - first))
        return np.stack([alone, solve(H, g, ridge=RIDGE)], axis=1)
    forward = solve_triangular(factor, g * scale, lower=True, check_finite=False)
    solutions = np.zeros((len(g), 2))
    # The factor of a leading block is the leading block of the factor.
    for k, count in enumerate((first, len(g))):
        leading = factor[:count, :count]
        solutions[:count, k] = solve_triangular(leading, forward[:count], trans=1, lower=True, check_finite=False)
    return solutions * scale[:, None]


def conditional(
    covariance: np.ndarray, theta: np.ndarray, gone: np.ndarray, stays: np.ndarray | None = None
) -> np.ndarray:
    r"""Solution when some unknowns become zero and others follow, from the covariance of all.

    .. math:: \theta - V_{:F} V_{FF}^{-1} d_F, \qquad d = \theta \text{ for } G, \; 0 \text{ for } S, \qquad F = G \cup S

    Args:
        covariance: V = H^-1, shape (K, K).
        theta: The solution of all, shape (K,).
        gone: Unknowns G that become zero, shape (K,) bool.
        stays: Unknowns S that do not follow, shape (K,) bool; None: all others do.
    """
    fixed = gone if stays is None else gone | stays
    V = covariance[:, fixed]
    moved = theta - V @ solve(V[fixed], np.where(gone, theta, 0.0)[fixed], ridge=RIDGE)
    moved[fixed] = np.where(gone, 0.0, theta)[fixed]
    return moved


def root_of_inverse(M: np.ndarray, share: float) -> np.ndarray:
    """W, shape (d, k), with W^T W the pseudo-inverse of information M, shape (k, k), over the d directions that M determines.

    Args:
        M: Information of k unknowns.
        share: Of the largest eigenvalue, unknowns scaled to unit diagonal, that a direction's must reach.
    """
    S, scale = balanced(M)
    S[:, scale == 0.0] = 0.0
    factor, failed = dpotrf(S.T, lower=1)
    if not failed and dpocon(factor, np.abs(S).sum(axis=0).max(), uplo="L")[0] > CONDITION_MARGIN * share:
        return np.asarray(dtrtri(factor, lower=1)[0] * scale)
    values, vectors = np.linalg.eigh(S)
    informed = values > share * max(float(values[-1]), np.finfo(float).tiny)
    return np.asarray((vectors[:, informed] / np.sqrt(values[informed])).T * scale)


def pseudo_inverse(H: np.ndarray, share: float) -> tuple[np.ndarray, int]:
    """H^+ and the rank of H; see :func:`root_of_inverse`."""
    root = root_of_inverse(H, share)
    return root.T @ root, len(root)


def across(free: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Columns (n, k) less their projection on the columns ``free`` (n, f), which can imitate that part."""
    if not free.shape[1]:
        return columns
    return np.asarray(columns - free @ np.linalg.lstsq(free, columns, rcond=None)[0])


def last_log_determinant(H: np.ndarray, first: int) -> float:
    """Logarithm of the determinant of the equations of the unknowns after the first ones, these being solved for."""
    S, scale = balanced(H, RIDGE)
    factor, failed = dpotrf(S.T, lower=1)
    if failed:
        return -float(np.linalg.slogdet(inverse(H)[first:, first:])[1])
    return 2.0 * float(np.sum(np.log(np.diag(factor)[first:] / np.maximum(scale[first:], TINY))))


def added(
    equations: NormalEquations, precision: np.ndarray, inverse_before: np.ndarray, spent: np.ndarray, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    r"""Solution with d unknowns added, and degrees of freedom used up in each channel, from the inverse without them.

    .. math:: W = H_{aa}^{-1} H_{ab}, \quad S = H_{bb} - H_{ba} W, \quad
              \theta_b = S^{-1} (g_b - W^T g_a), \quad \theta_a = H_{aa}^{-1} g_a - W \theta_b

              \operatorname{tr} H^{-1} A_c = \operatorname{tr} H_{aa}^{-1} A_{c,aa}
              + \operatorname{tr} S^{-1} (W^T A_{c,aa} W - W^T A_{c,ab} - A_{c,ba} W + A_{c,bb})

    Args:
        equations: Of K unknowns a and, after them, d unknowns b.
        precision: Of the prior of all, block by block, shape (K + d, K + d).
        inverse_before: H_aa^-1 with its prior, shape (K, K).
        spent: Degrees of freedom that each channel gives up without the unknowns b, shape (C,).
        sigma: Noise of each channel for both, shape (C,).

    Returns:
        theta, shape (K + d,), and the degrees of freedom with all, shape (C,).
    """
    K = len(inverse_before)
    H, g = equations.information(sigma) + precision, equations.pull(sigma)
    W = inverse_before @ H[:K, K:]
    S = inverse(H[K:, K:] - H[K:, :K] @ W)
    last = S @ (g[K:] - W.T @ g[:K])
    theta = np.concatenate([inverse_before @ g[:K] - W @ last, last])
    remainder, size = g - H @ theta, np.maximum(np.diag(H), TINY)
    if not np.sum(remainder**2 / size) <= BORDERED_PULL_SHARE**2 * np.sum(g**2 / size):  # columns that nearly coincide
        theta = solve(H, g, ridge=RIDGE)
    cross = np.swapaxes(W.T @ equations.AA[:, :K, K:], 1, 2)
    more = W.T @ equations.AA[:, :K, :K] @ W - cross - np.swapaxes(cross, 1, 2) + equations.AA[:, K:, K:]
    return theta, spent + np.einsum("ij,cji->c", S, more) / sigma**2


@dataclass(frozen=True)
class Prior:
    """A normal prior of the coefficients.

    Attributes:
        mean: Shape (K,).
        precision: Shape (K, K).
        basis: Combinations of coefficients, in columns, of similar prior precision: square blocks along the diagonal of a matrix
            of shape (K, K). Neighbouring samples of a smooth function are too alike to be solved for one by one. None: the
            coefficients themselves.
    """

    mean: np.ndarray
    precision: np.ndarray
    basis: tuple[np.ndarray, ...] | None = None

    @cached_property
    def combined(self) -> np.ndarray:
        """Precision of the combinations, shape (K, K)."""
        return _both_sides(self.basis, self.precision)


class CombinedEquations:
    """Equations of a step of K coefficients in the combinations that a prior holds independent.

    With B the prior's basis, :math:`B^T A_c^T A_c B` is computed once; each trial of a noise costs a sum over channels.
    """

    def __init__(self, equations: NormalEquations, prior: Prior | None) -> None:
        """Combine them.

        Args:
            equations: Of the coefficients.
            prior: Their prior; None for none.
        """
        self._prior, self._blocks = prior, None if prior is None else prior.basis
        AA, Ar = _both_sides(self._blocks, equations.AA), _transposed(self._blocks, equations.Ar[..., None])[..., 0]
        self.equations = NormalEquations(AA, Ar, equations.rr, equations.count)

    def information(self, sigma: np.ndarray) -> np.ndarray:
        """H of the combinations with the prior, shape (K, K), for noise of shape (C,)."""
        H = self.equations.information(sigma)
        return H if self._prior is None else H + self._prior.combined

    def pull(self, sigma: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Pull g of the combinations, the prior's pull on coefficients theta included, shape (K,)."""
        g = self.equations.pull(sigma)
        if self._prior is None:
            return g
        pull_of_prior = self._prior.precision @ (self._prior.mean - theta)
        return np.asarray(g + _transposed(self._blocks, pull_of_prior[:, None])[:, 0])

    def squares(self, theta: np.ndarray) -> float:
        """Squared distance of coefficients from the prior's mean, in sigmas."""
        if self._prior is None:
            return 0.0
        off = theta - self._prior.mean
        return float(off @ self._prior.precision @ off)

    def of_coefficients(self, values: np.ndarray) -> np.ndarray:
        """Combinations, shape (K, n), as coefficients: B times these."""
        return _transposed(None if self._blocks is None else tuple(b.T for b in self._blocks), values)

    def covariance(self, inverse: np.ndarray) -> np.ndarray:
        """Covariance of the coefficients, shape (K, K), from that of the combinations."""
        return _both_sides(None if self._blocks is None else tuple(b.T for b in self._blocks), inverse)


def _transposed(blocks: Sequence[np.ndarray] | None, values: np.ndarray) -> np.ndarray:
    """B^T times values of shape (..., K, n), B given by the blocks along its diagonal; None: the identity."""
    if blocks is None:
        return values
    ends = np.cumsum([len(b) for b in blocks])[:-1]
    parts = np.split(values, ends, axis=-2)
    return np.concatenate([b.T @ part for b, part in zip(blocks, parts, strict=True)], axis=-2)


def _both_sides(blocks: Sequence[np.ndarray] | None, M: np.ndarray) -> np.ndarray:
    """B^T M B of symmetric M, shape (..., K, K)."""
    return _transposed(blocks, np.swapaxes(_transposed(blocks, M), -1, -2))
