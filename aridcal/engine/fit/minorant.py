r"""A lower bound of the restricted likelihood over the variances, the fit of the columns held.

In :mod:`aridcal.engine.fit.variance_components` two parts of the likelihood cost much, as all rows share the columns. About
variances :math:`\theta_0`, at which the columns leave :math:`e_i` of row i and their fit has the covariance :math:`C_i`
there, both are bounded: :math:`\log |H|` is concave in the rows' :math:`V_i^{-1}` and lies below its tangent, and no
coefficients leave less than the best,

.. math:: \ell(\theta) \ge \text{const} - \tfrac12 \sum_i \big[\log |V_i(\theta)| + tr(M_i V_i(\theta)^{-1})\big], \qquad
          M_i = C_i + e_i e_i^T

with equality, and the same slope, at :math:`\theta_0` (minorisation and maximisation: Hunter and Lange 2004). The right side is a
sum over rows that know nothing of one another: its maximum costs next to nothing, and a step there never lowers the likelihood.
What it misses is the share of the numbers that the columns take up, so that far from the maximum a step closes nearly all of the
gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.fit.normal_equations import shortest
from aridcal.engine.numerics import MOST_ITERATIONS, STEP_HALVINGS

LAST_BOUND_GAIN = 0.03
"""Work: [nat]: a step that promises less is the last. What is left is found with the true likelihood."""


def moments(V: np.ndarray, pull: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """M of each row, shape (N, m, m), from V, P y and P_ii of each: C = V - V P V, and e = V P y."""
    residual = np.einsum("nij,nj->ni", V, pull)
    return np.asarray(V - V @ kernel @ V + residual[:, :, None] * residual[:, None, :])


@dataclass(frozen=True)
class Bound:
    """The bound about some variances, of N rows of m numbers and C components.

    Attributes:
        blocks: Covariance of each row per unit of each variance, shape (C, N, m, m).
        fixed: Covariance of the numbers that no component scatters, shape (N, m, m).
        M: See :func:`moments`, shape (N, m, m).
    """

    blocks: np.ndarray
    fixed: np.ndarray
    M: np.ndarray

    def best(self, theta: np.ndarray, free: np.ndarray, low: np.ndarray) -> np.ndarray:
        """Variances at which the bound is highest, shape (C,).

        Args:
            theta: Variances to begin with, shape (C,).
            free: Variances that may move, shape (C,) bool.
            low: Below which variances do not fall, shape (C,).
        """
        active = np.flatnonzero(free)
        B, low, at = self.blocks[active], low[active], theta[active]
        value, inverse = self._of(B, at)
        for _ in range(MOST_ITERATIONS if np.isfinite(value) else 0):
            # tr(V^-1 (M - V) V^-1 B_k) / 2 and tr(V^-1 B_k V^-1 B_l) / 2.
            flat = B.reshape(len(active), -1)
            score = 0.5 * (flat @ (inverse @ self.M @ inverse - inverse).ravel())
            half = (inverse @ B).reshape(len(active), *inverse.shape)
            turned = half.transpose(0, 1, 3, 2).reshape(len(active), -1)
            information = 0.5 * half.reshape(len(active), -1) @ turned.T
            moving = ~((at <= low) & (score <= 0.0))
            step = np.zeros(len(active))
            step[moving] = shortest(information[np.ix_(moving, moving)], score[moving])
            if float(score @ step) < LAST_BOUND_GAIN:
                at = np.maximum(at + step, low)
                break
            for _ in range(STEP_HALVINGS):
                stepped = np.maximum(at + step, low)
                there, inner = self._of(B, stepped)
                if there >= value:
                    break
                step = 0.5 * step
            else:
                break
            at, value, inverse = stepped, there, inner
        after = theta.copy()
        after[active] = at
        return after

    def height(self, theta: np.ndarray) -> float:
        """The bound at some variances, shape (C,), but for a constant."""
        positive = theta > 0.0
        return self._of(self.blocks[positive], theta[positive])[0]

    def _of(self, B: np.ndarray, theta: np.ndarray) -> tuple[float, np.ndarray]:
        """The bound for some of the blocks, and the rows' V^-1, shape (N, m, m); -inf where a V is not positive."""
        V = np.tensordot(theta, B, axes=1) + self.fixed
        try:
            L = np.linalg.cholesky(V)
        except np.linalg.LinAlgError:
            return -np.inf, V
        inverse = np.linalg.inv(V)
        logdet = 2.0 * float(np.sum(np.log(np.diagonal(L, axis1=1, axis2=2))))
        return -0.5 * (logdet + float(np.vdot(self.M, inverse))), inverse
