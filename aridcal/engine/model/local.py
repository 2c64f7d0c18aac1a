r"""Many coefficients of which few act in a row: sums over rows and covariances of rows without a column for each of them.

A map of how every joint errs along its travel has hundreds of coefficients, hat functions :math:`\varphi_k` of which four a joint
are not zero in a row. With :math:`t_c`, what the joint does that carries a coefficient, its column is :math:`\varphi_k t_{c(k)}`;
sums such as :math:`\sum_n J_k \cdot J_l` and :math:`J \Sigma J^T` have, row by row, only the terms of those.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from aridcal.engine.corrections.effect import Coefficient

LEAST_HATS = 200
"""Hat functions from which this is quicker than a column for each: 470 take a fifth of the time."""


@dataclass(frozen=True)
class LocalColumns:
    """K coefficients of which few act in a row.

    Attributes:
        plain: Coefficients that act in all rows alike, shape (p,).
        based: All others, shape (b,).
        carrier: The joint of each of the K, shape (K,).
    """

    plain: np.ndarray
    based: np.ndarray
    carrier: np.ndarray

    def information(self, twists: np.ndarray, phi: np.ndarray, parts: Sequence[slice]) -> np.ndarray:
        """Sums :math:`J^T J` of some of the numbers of all rows each, shape (parts, K, K).

        Args:
            twists: What joints do, shape (n, m, joints), whitened.
            phi: Basis values of the rows, shape (n, b).
            parts: Numbers that are summed together.
        """
        constant, acting, which = self._acting(twists, phi)
        b, p, n = len(self.based), len(self.plain), len(phi)
        keys = (which[:, :, None] * b + which[:, None, :]).ravel()
        sums = np.empty((len(parts), len(self.carrier), len(self.carrier)))
        for k, part in enumerate(parts):
            constant_part, acting_part = constant[:, part], acting[:, part]
            flat, turned = constant_part.reshape(-1, p), acting_part.transpose(0, 2, 1)
            sums[k][np.ix_(self.plain, self.plain)] = flat.T @ flat
            squares = np.bincount(keys, (turned @ acting_part).ravel(), b * b).reshape(b, b)
            sums[k][np.ix_(self.based, self.based)] = squares
            cross = _summed(which, (turned @ constant_part).reshape(n, -1, p), b)
            sums[k][np.ix_(self.based, self.plain)] = cross
            sums[k][np.ix_(self.plain, self.based)] = cross.T
        return sums

    def pull(self, twists: np.ndarray, phi: np.ndarray, r: np.ndarray, parts: Sequence[slice]) -> np.ndarray:
        """Sums :math:`J^T r` likewise, shape (parts, K), of numbers r, shape (n, m)."""
        sums = np.empty((len(parts), len(self.carrier)))
        for k, part in enumerate(parts):
            y = np.einsum("smn,mn->sn", twists.T[:, part], r.T[part])
            sums[k, self.plain] = y.sum(axis=1)[self.carrier[self.plain]]
            sums[k, self.based] = (y @ phi)[self.carrier[self.based], np.arange(len(self.based))]
        return sums

    def carried(self, twists: np.ndarray, phi: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        r""":math:`J \Sigma J^T` of each row, shape (n, m, m).

        Args:
            twists: What joints do, shape (n, m, joints).
            phi: Basis values of the rows, shape (n, b).
            covariance: Of the coefficients, shape (K, K).
        """
        constant, acting, which = self._acting(twists, phi)
        which = self.based[which]
        back, constant_back = acting.transpose(0, 2, 1), constant.transpose(0, 2, 1)
        of_acting = acting @ covariance[which[:, :, None], which[:, None, :]] @ back
        cross = acting @ covariance[:, self.plain][which] @ constant_back
        of_constants = constant @ covariance[np.ix_(self.plain, self.plain)] @ constant_back
        return np.asarray(of_acting + cross + cross.transpose(0, 2, 1) + of_constants)

    def _acting(self, twists: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns of the constants (n, m, p); those of the others that act in each row (n, m, a), and which these are, (n, a)."""
        n, nonzero = len(phi), np.flatnonzero(np.ascontiguousarray(phi != 0.0))  # row by row, in one pass
        row, column = np.divmod(nonzero, phi.shape[1])
        count = np.bincount(row, minlength=n)
        place = np.arange(len(row)) - (np.cumsum(count) - count)[row]
        # Rows with fewer than others are filled up with zeros.
        which = np.zeros((n, int(count.max(initial=1))), dtype=int)
        value = np.zeros(which.shape)
        which[row, place], value[row, place] = column, phi[row, column]
        slowest = np.ascontiguousarray(twists.transpose(0, 2, 1))
        acting = slowest[np.arange(n)[:, None], self.carrier[self.based][which]] * value[:, :, None]
        constant = slowest[:, self.carrier[self.plain]]
        return constant.transpose(0, 2, 1), acting.transpose(0, 2, 1), which


def _summed(which: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums of values (n, a, p) over rows for each number in ``which``, shape (n, a): (count, p)."""
    size = which.size
    to = csr_array((np.ones(size), which.ravel(), np.arange(size + 1)), shape=(size, count))
    return np.asarray(to.T @ values.reshape(size, -1))


def local(coefficients: Sequence[Coefficient], carrier: np.ndarray) -> LocalColumns | None:
    """Which coefficients act in few rows; None where a column for each of them is quicker.

    Args:
        coefficients: K of them.
        carrier: The joint of each, shape (K,).
    """
    hats = sum(c.basis.form == "bump" for c in coefficients)
    if hats < LEAST_HATS or any(c.station is not None for c in coefficients):
        return None
    constant = np.array([c.basis.constant for c in coefficients], dtype=bool)
    return LocalColumns(np.flatnonzero(constant), np.flatnonzero(~constant), carrier)
