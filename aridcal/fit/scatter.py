"""Residuals and what may make them scatter; see :mod:`aridcal.fit.variance_components`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array

from aridcal.fit.normal_equations import TINY

RANK = 1e-10
"""Share of a clump's largest eigenvalue, columns scaled to 1, below which a combination of its things is rounding."""

UNTOLD = 1e-3
"""Information on a mode of unit prior, from all rows together, below which it is left out: it takes up less than a thousandth
of one number, and every mode costs as much as one that takes up one."""


@dataclass(frozen=True)
class Scatter:
    """Residuals and what may make them scatter: N rows of m numbers, K columns, C components.

    Attributes:
        y: Residuals, shape (N, m).
        A: Columns that are fitted, shape (N, m, K).
        precision: Of their coefficients' prior, shape (K, K).
        blocks: Covariance of each row per unit of each component's variance, shape (C, N, m, m). A number that no
            component scatters has the variance 1: it is not measured (and has zeros elsewhere), or states what is known
            beforehand, in sigmas.
        things: Columns of what is unknown of the row's clump, shape (N, m, U), of full rank in the clump or 0; None where
            nothing is.
        clump: Of each row, shape (N,), -1 for none.
    """

    y: np.ndarray
    A: np.ndarray
    precision: np.ndarray
    blocks: np.ndarray
    things: np.ndarray | None = None
    clump: np.ndarray | None = None

    @cached_property
    def stated(self) -> np.ndarray:
        """Covariance of what no component scatters, shape (N, m, m)."""
        apart = np.einsum("cnii->ni", self.blocks) == 0.0
        return np.asarray(apart[:, :, None] * np.eye(apart.shape[1]))

    @cached_property
    def gather(self) -> csr_array:
        """Sums over the rows of each clump, shape (clumps, N)."""
        assert self.clump is not None
        own = np.flatnonzero(self.clump >= 0)
        shape = (int(self.clump.max(initial=-1)) + 1, len(self.clump))
        return coo_array((np.ones(len(own)), (self.clump[own], own)), shape=shape).tocsr()

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Sums of values, shape (N, ...), over the rows of each clump, shape (clumps, ...)."""
        return np.asarray(self.gather @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def full_rank(scatter: Scatter) -> Scatter:
    """The same with columns of things that span what they spanned in each clump, and are orthonormal there or 0."""
    B = scatter.things
    if B is None or scatter.clump is None:
        return scatter
    H = scatter.summed(B.transpose(0, 2, 1) @ B)
    size = np.sqrt(np.einsum("guu->gu", H))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    values, vectors = np.linalg.eigh(H * scale[:, :, None] * scale[:, None, :])
    told = values > RANK * np.maximum(values[:, -1:], TINY)
    turned = scale[:, :, None] * vectors * np.where(told, 1.0 / np.sqrt(np.where(told, values, 1.0)), 0.0)[:, None, :]
    return replace(scatter, things=B @ turned[scatter.clump])


def told_modes(column: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Combinations of modes of unit prior of which the rows tell anything, orthonormal, shape (modes, told).

    Args:
        column: Of the modes, shape (N, m, modes).
        sigma: Noise of each number of a row, shape (m,).
    """
    white = (column / sigma[:, None]).reshape(-1, column.shape[2])
    information, vectors = np.linalg.eigh(white.T @ white)
    return np.asarray(vectors[:, information > UNTOLD])
