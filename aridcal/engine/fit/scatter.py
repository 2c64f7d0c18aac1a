r"""Residuals, the components of their scatter, and the restricted likelihood of variances with its slope and curvature.

Formulas and references: :mod:`aridcal.engine.fit.variance_components`, which maximises it. Most of the work is one product
U'U of the whitened columns, and one triangular solve with as many numbers. With columns that are orthonormal somewhere near
(:func:`scatter_near`) both are well conditioned, and single precision, which is twice as fast, has digits enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dtrsm, strsm
from scipy.linalg.lapack import dpotrf
from scipy.sparse import coo_array, csr_array

from aridcal.engine.fit.normal_equations import balanced, directions
from aridcal.engine.numerics import RANK

LEAST_INFORMATION = 1e-3
"""Work: Information on a mode of unit prior, from all rows together, below which it is left out: it takes up less than a
thousandth of one number, and every mode costs as much as one that takes up one."""

SINGLE_PRECISION_SHARE = 1e-2
"""Work: Share of a column, the others before it taken off, that must be left for single precision to do: rounding, 1e-7 of the
columns, is then 1e-5 of what is left."""


@dataclass(frozen=True)
class ResidualColumns:
    """Residuals and the columns that are fitted to them, N rows of m numbers, K columns.

    Attributes:
        y: Residuals, shape (N, m).
        A: Columns, shape (N, m, K).
        precision: Of their coefficients' prior, shape (K, K).
        units: Factors that the columns of each row are still to be multiplied by, shape (N, m, m); None for none.
        slope: Of half the prior's square at coefficients of zero, shape (K,).
        offset: To be added to twice the negative log-likelihood.
    """

    y: np.ndarray
    A: np.ndarray
    precision: np.ndarray
    units: np.ndarray | None
    slope: np.ndarray
    offset: float


@dataclass(frozen=True)
class Scatter:
    """Residuals and the components of their scatter: N rows of m numbers, K columns, C components.

    Attributes:
        y: Residuals, shape (N, m).
        A: Columns that are fitted, shape (N, m, K).
        precision: Of their coefficients' prior, shape (K, K).
        blocks: Covariance of each row per unit of each component's variance, shape (C, N, m, m). A number that no
            component scatters has the variance 1: it is not measured (and has zeros elsewhere), or is prior knowledge, in
            sigmas.
        things: Columns of the unknowns of the row's clump, shape (N, m, U), of full rank in the clump or 0; None where
            there are none.
        clump: Of each row, shape (N,), -1 for none.
        near: The same residuals and columns combined and in single precision, for speed; see :func:`scatter_near`.
    """

    y: np.ndarray
    A: np.ndarray
    precision: np.ndarray
    blocks: np.ndarray
    things: np.ndarray | None = None
    clump: np.ndarray | None = None
    near: ResidualColumns | None = None

    @property
    def columns(self) -> ResidualColumns:
        """Residuals and columns as they are, not conditioned."""
        return ResidualColumns(self.y, self.A, self.precision, None, np.zeros(self.A.shape[2]), 0.0)

    @cached_property
    def fixed(self) -> np.ndarray:
        """Covariance of the numbers that no component scatters, shape (N, m, m)."""
        apart = np.einsum("cnii->ni", self.blocks) == 0.0
        return np.asarray(apart[:, :, None] * np.eye(apart.shape[1]))

    @cached_property
    def gather(self) -> csr_array:
        """Sums over the rows of each clump, shape (clumps, N)."""
        assert self.clump is not None
        in_clump = np.flatnonzero(self.clump >= 0)
        shape = (int(self.clump.max(initial=-1)) + 1, len(self.clump))
        return coo_array((np.ones(len(in_clump)), (self.clump[in_clump], in_clump)), shape=shape).tocsr()

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Sums of values, shape (N, ...), over the rows of each clump, shape (clumps, ...)."""
        return np.asarray(self.gather @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def full_rank(scatter: Scatter) -> Scatter:
    """The scatter with columns of things that span the same in each clump, and are orthonormal there or 0."""
    B = scatter.things
    if B is None or scatter.clump is None:
        return scatter
    values, vectors, scale = directions(scatter.summed(B.transpose(0, 2, 1) @ B))
    turned = scale[:, :, None] * vectors * (1.0 / np.sqrt(values))[:, None, :]
    return replace(scatter, things=B @ turned[scatter.clump])


def determined_modes(column: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Orthonormal combinations of modes of unit prior that the rows determine at all, shape (modes, combinations).

    Args:
        column: Columns of the modes, shape (N, m, modes).
        sigma: Noise of each number of a row, shape (m,).
    """
    white = (column / sigma[:, None]).reshape(-1, column.shape[2])
    information, vectors = np.linalg.eigh(white.T @ white)
    return np.asarray(vectors[:, information > LEAST_INFORMATION])


@dataclass(frozen=True)
class LikelihoodPoint:
    """The likelihood at some variances: N rows of m numbers, K columns.

    Attributes:
        log_likelihood: Restricted, but for a constant.
        pull: P y, shape (N, m).
        kernel: P_ii, shape (N, m, m).
        root: Inverse Cholesky factors of the rows' covariances, shape (N, m, m).
        T: Whitened columns, less the part that the things take up, orthonormal but for the prior, shape (N m, K).
        Q: Whitened columns of the things, orthonormal in each clump, shape (N, m, U); None where there are none.
    """

    log_likelihood: float
    pull: np.ndarray
    kernel: np.ndarray
    root: np.ndarray
    T: np.ndarray
    Q: np.ndarray | None


@dataclass(frozen=True)
class _White:
    """Rows in units of their scatter.

    Attributes:
        L: Cholesky factors of their covariances, shape (N, m, m).
        root: Inverses of these, shape (N, m, m).
        Q: See :class:`LikelihoodPoint`.
        logdet: Of the covariances and of the things' equations.
    """

    L: np.ndarray
    root: np.ndarray
    Q: np.ndarray | None
    logdet: float


def scatter_near(scatter: Scatter, variance: np.ndarray) -> Scatter:
    """The scatter with ``near`` set: columns that are orthonormal at some variances, shape (C,), and residuals small there."""
    white, plain = _whiten(scatter, variance), scatter.columns
    if white is None:
        return scatter
    _, U, z, factor, scale = _equations(replace(scatter, near=None), white)
    t = solve_triangular(factor, scale * (z @ U), lower=True, check_finite=False)
    prior = plain.precision * scale * scale[:, None] + np.diag(RANK + (scale == 0.0))
    half = solve_triangular(factor, prior, lower=True, check_finite=False)
    precision = solve_triangular(factor, half.T, lower=True, check_finite=False)
    T = _over_factor(U, factor, scale)
    remainder = (white.L @ (z - T @ t).reshape(*scatter.y.shape, 1))[:, :, 0]
    slope = precision @ t
    offset = _logdet(factor, scale) + float(slope @ t)
    A = T.astype(np.float32).reshape(scatter.A.shape)
    return replace(scatter, near=ResidualColumns(remainder, A, precision, white.L, slope, offset))


def place(scatter: Scatter, theta: np.ndarray) -> LikelihoodPoint:
    """The likelihood at some variances, shape (C,); minus infinity where the covariance of a row is not positive."""
    n, m, count = scatter.A.shape
    white = _whiten(scatter, theta)
    if white is None:
        nothing = np.zeros((n, m, m))
        return LikelihoodPoint(-np.inf, np.zeros((n, m)), nothing, nothing, np.zeros((n * m, count)), None)
    columns, U, z, factor, scale = _equations(scatter, white)
    t = solve_triangular(factor, scale * (z.astype(U.dtype) @ U - columns.slope), lower=True, check_finite=False)
    best = scale * solve_triangular(factor, t, trans=1, lower=True, check_finite=False)
    logdet = white.logdet + _logdet(factor, scale)
    T = U if np.may_share_memory(U, columns.A) else _over_factor(U, factor, scale)
    rows, projection = T.reshape(n, m, count), np.eye(m)
    if white.Q is not None:
        projection = projection - white.Q @ white.Q.transpose(0, 2, 1)
    projection = projection - rows @ rows.transpose(0, 2, 1)
    back = white.root.transpose(0, 2, 1)
    e = z - T @ t.astype(T.dtype)
    pull = back @ e.reshape(n, m, 1)
    # Not z'z less t't: rounding may exceed the difference.
    squares = float(e @ e) + float(best @ (columns.precision @ best + 2.0 * columns.slope))
    value = -0.5 * (logdet + squares + columns.offset)
    return LikelihoodPoint(value, pull[:, :, 0], back @ projection @ white.root, white.root, T, white.Q)


def _whiten(scatter: Scatter, theta: np.ndarray) -> _White | None:
    """Rows at some variances, shape (C,); None where the covariance of one is not positive."""
    V = covariances(scatter, theta)
    try:
        L = np.linalg.cholesky(V)
    except np.linalg.LinAlgError:
        return None
    root = np.linalg.solve(L, np.broadcast_to(np.eye(V.shape[1]), V.shape))
    logdet, Q = 2.0 * float(np.sum(np.log(np.diagonal(L, axis1=1, axis2=2)))), None
    if scatter.things is not None:
        Q, more = _orthonormal(scatter, root @ scatter.things)
        logdet += more
    return _White(L, root, Q, logdet)


def covariances(scatter: Scatter, theta: np.ndarray) -> np.ndarray:
    """V of each row, shape (N, m, m)."""
    positive = theta > 0.0
    return np.asarray(np.tensordot(theta[positive], scatter.blocks[positive], axes=1) + scatter.fixed)


def _orthonormal(scatter: Scatter, W: np.ndarray) -> tuple[np.ndarray, float]:
    """Whitened columns of things, shape (N, m, U), made orthonormal in each clump, and the logarithm of their determinants."""
    H = scatter.summed(W.transpose(0, 2, 1) @ W)
    size = np.einsum("guu->gu", H)
    H = H + np.where(size > 0.0, 0.0, 1.0)[:, :, None] * np.eye(H.shape[1])
    factor = np.linalg.cholesky(H)
    # Rows of no clump have zeros there, whatever they are multiplied with.
    Q = W @ np.linalg.inv(factor).transpose(0, 2, 1)[scatter.clump]
    return Q, 2.0 * float(np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2))))


def _of_clumps(scatter: Scatter, Q: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Q' of columns of all rows, shape (N, m, d), clump by clump, shape (clumps, U, d)."""
    return scatter.summed(Q.transpose(0, 2, 1) @ values)


def _equations(
    scatter: Scatter, white: _White
) -> tuple[ResidualColumns, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Columns that are precise enough; these whitened, (N m, K); residuals, (N m,); factor and scale of their equations."""
    if scatter.near is not None:
        U, z = _whitened(scatter, white, scatter.near)
        if np.may_share_memory(U, scatter.near.A):
            return scatter.near, U, z, np.eye(U.shape[1]), np.ones(U.shape[1])
        H, scale = balanced(U.T @ U + scatter.near.precision, RANK)
        factor, failed = dpotrf(H.T, lower=1)
        if not failed and np.diag(factor).min() ** 2 > SINGLE_PRECISION_SHARE:
            return scatter.near, U, z, factor, scale
    U, z = _whitened(scatter, white, scatter.columns)
    H, scale = balanced(U.T @ U + scatter.precision, RANK)
    return scatter.columns, U, z, np.linalg.cholesky(H), scale


def _whitened(scatter: Scatter, white: _White, columns: ResidualColumns) -> tuple[np.ndarray, np.ndarray]:
    """Columns (not copied if they are so already), (N m, K), and residuals, (N m,), in units of the scatter, less things."""
    U, z = columns.A, white.root @ columns.y[:, :, None]
    there = columns.units is not None and np.array_equal(white.L, columns.units)  # then they are so already
    if not there:
        turn = white.root if columns.units is None else white.root @ columns.units
        U = turn.astype(U.dtype) @ U
    if white.Q is not None:
        z -= white.Q @ _of_clumps(scatter, white.Q, z)[scatter.clump]
        if not there:
            Q = white.Q.astype(U.dtype)
            U -= Q @ _of_clumps(scatter, Q, U).astype(U.dtype)[scatter.clump]
    return U.reshape(-1, U.shape[2]), z.ravel()


def _over_factor(U: np.ndarray, factor: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """U times scale over the transposed factor, in place of U."""
    # The scale goes into the factor: U is long. A coefficient that moves nothing has a column of zeros.
    whole = (factor / np.where(scale > 0.0, scale, 1.0)[:, None]).astype(U.dtype, order="C")
    solved = dtrsm if U.dtype == np.float64 else strsm
    return np.asarray(solved(1.0, whole.T, U.T, trans_a=1, overwrite_b=1).T)


def _logdet(factor: np.ndarray, scale: np.ndarray) -> float:
    """Logarithm of the determinant of equations, from the factor of the balanced ones."""
    return 2.0 * float(np.sum(np.log(np.diag(factor))) - np.sum(np.log(scale[scale > 0.0])))


def derivatives(scatter: Scatter, here: LikelihoodPoint, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Score, shape (C,), and average information, shape (C, C), of some components, shape (C,) bool; 0 for the others."""
    blocks = scatter.blocks[of]
    moved = (blocks @ here.pull[:, :, None])[:, :, :, 0]
    score, information = np.zeros(len(of)), np.zeros((len(of),) * 2)
    score[of] = 0.5 * (np.tensordot(moved, here.pull, 2) - np.tensordot(blocks, here.kernel, 3))
    white = (here.root @ moved[:, :, :, None])[:, :, :, 0]
    products = np.zeros((len(moved),) * 2)
    if here.Q is not None:
        along_things = _of_clumps(scatter, here.Q, white.transpose(1, 2, 0)).reshape(-1, len(moved))
        products -= along_things.T @ along_things
    white = white.reshape(len(moved), -1)
    along = (white.astype(here.T.dtype) @ here.T).astype(float)
    information[np.ix_(of, of)] = 0.5 * (products + white @ white.T - along @ along.T)
    return score, information
