r"""Which one of few rows spoils the rest: each is left out in turn, and all is estimated anew without it.

While rows are hardly more than the unknowns, a bad one hides: constants bend to it, their sizes are taken for larger than they
are, and the good rows after it look bad. So every supposition about which rows B are bad is weighed by all that the rows say,

.. math:: p(y_S) \prod_{k \in B} \pi\, p_{bad}(y_k \mid y_S), \qquad S = \text{all rows but } B

where the sizes of the coefficients are those that the rows S suggest (the fixed point of MacKay 1992, with the usual size of
each group for some coefficients), and their scatter is integrated out: :math:`p(y_S)` is a multivariate t density.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from aridcal.jobs.guide.judgement import CLEARLY, PREDICTED_WEIGHT, exceeded
from aridcal.jobs.guide.movement import BAD_SIZES, IS_BAD, SURE, log_density, log_mean
from aridcal.jobs.guide.posterior import PRIOR_WEIGHT, Posterior, groups

YOUNG = 3.0
"""Times as many numbers as unknowns up to which a bad row may hide: with more, what is left of a row beside all others is two
thirds of its error at the least."""

TRIED = 12
"""Work: Rows that are left out in turn, those that fit worst: one that spoils the rest is among them."""

ROUNDS = 5
"""Work: Of the sizes; the last ones change them by some per cent."""


@dataclass(frozen=True)
class Weighed:
    """What is said for and against rows being bad.

    Attributes:
        rows: Numbers of the rows that were left out in turn, shape (H,).
        gain: Logarithm of how much likelier all is if that row is bad than if none is, shape (H,).
        probability: Of a good row to be off as much as it is beside the others, shape (H,); 1 of rows not clearly off.
    """

    rows: np.ndarray
    gain: np.ndarray
    probability: np.ndarray

    def spoiling(self, level: float) -> int | None:
        """The row that is bad: likelier than that none is, or any other, by :data:`SURE`; None if there is no such row.

        Args:
            level: Its probability must be below.
        """
        if not len(self.rows):
            return None
        order = np.argsort(-self.gain)
        best = int(order[0])
        rival = max(0.0, float(self.gain[order[1]])) if len(order) > 1 else 0.0
        sure = self.gain[best] - rival > SURE and self.probability[best] < level
        return int(self.rows[best]) if sure else None


def is_young(posterior: Posterior, numbers: int) -> bool:
    """Whether so many numbers measured are too few for a bad row to show by itself."""
    return numbers < YOUNG * len(posterior.information)


def weighed(posterior: Posterior, used: np.ndarray, F: np.ndarray, r: np.ndarray) -> Weighed:
    """Leave rows out in turn.

    Args:
        posterior: D unknowns, about its last fit.
        used: Which of the rows it holds already, shape (N,) bool.
        F: Columns of all rows, shape (N, m, D).
        r: Their residuals at the last fit, shape (N, m).
    """
    setup, things = posterior.setup, posterior.things
    model = setup.model
    # all unknowns in units of what is expected of them, from nothing on
    unit = np.r_[np.ones(things), posterior.base]
    G = F * unit
    y = r + F[:, :, things:] @ setup.theta
    of_rows = np.einsum("nid,nie->nde", G, G, optimize=True)
    rest = posterior.information * np.outer(unit, unit) - of_rows[used].sum(axis=0)
    prior = np.r_[np.zeros(things), (posterior.base / setup.prior) ** 2]
    rest = rest - np.diag(prior)
    pull = np.einsum("nid,ni->nd", G, y)
    squares, numbers = np.sum(y**2, axis=1), np.any(F != 0.0, axis=2).sum(axis=1)
    out = _worst(posterior, F, r)
    left = np.r_[-1, out]
    A = of_rows.sum(axis=0) - np.where(left[:, None, None] < 0, 0.0, of_rows[left])
    g = pull.sum(axis=0) - np.where(left[:, None] < 0, 0.0, pull[left])
    yy = squares.sum() - np.where(left < 0, 0.0, squares[left])
    n = numbers.sum() - np.where(left < 0, 0, numbers[left])
    keys = groups(model)
    members = [things + np.array([k for k, other in enumerate(keys) if other == key]) for key in dict.fromkeys(keys) if key]
    size = np.tile(prior, (len(left), 1))  # inverse squares, in units of what is expected
    for some in members:
        size[:, some] = 1.0
    free = np.r_[np.zeros(things, dtype=bool), np.array([not key for key in keys], dtype=bool)]
    size[:, free] = prior[free]
    for round_ in range(ROUNDS + 1):
        M = A + rest + _diagonals(size)
        V = np.linalg.inv(M)
        estimate = np.einsum("hde,he->hd", V, g)
        if round_ == ROUNDS:
            break
        for some in members:
            known = 1.0 - V[:, some, some] * size[:, some]
            squared = PRIOR_WEIGHT + np.sum(estimate[:, some] ** 2, axis=1)
            size[:, some] = ((PRIOR_WEIGHT + np.sum(np.maximum(known, 0.0), axis=1)) / squared)[:, None]
    q = np.maximum(yy - np.einsum("hd,hd->h", g, estimate), 0.0)
    nu = PREDICTED_WEIGHT
    log_p = 0.5 * (np.linalg.slogdet(rest + _diagonals(size))[1] - np.linalg.slogdet(M)[1])
    log_p += gammaln((nu + n) / 2.0) - n / 2.0 * np.log(nu / 2.0) - (nu + n) / 2.0 * np.log1p(q / nu)
    for some in members:
        inverse_square = size[:, some[0]]
        log_p += PRIOR_WEIGHT / 2.0 * (np.log(inverse_square) - inverse_square)
    gain, probability = [], []
    for h, k in enumerate(out.tolist(), start=1):
        part = np.any(F[k] != 0.0, axis=1)
        error = (y[k] - G[k] @ estimate[h])[part]
        spread = np.eye(len(error)) + G[k][part] @ V[h] @ G[k][part].T
        spread *= max(1.0, (nu + q[h]) / (nu + n[h]))
        bad = log_mean([log_density(error, spread + size_**2 * np.eye(len(error))) for size_ in BAD_SIZES])
        gain.append(log_p[h] + bad + np.log(IS_BAD) - log_p[0])
        square = float(error @ np.linalg.solve(spread, error))
        clear = np.sqrt(square / len(error)) > CLEARLY
        probability.append(float(exceeded(square, len(error), nu + float(n[h]))) if clear else 1.0)
    return Weighed(out, np.array(gain), np.array(probability))


def _diagonals(values: np.ndarray) -> np.ndarray:
    """Diagonal matrices of values, shape (H, D), as (H, D, D)."""
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _worst(posterior: Posterior, F: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Numbers of the rows that fit worst, each beside all others, at most :data:`TRIED` of them."""
    own = np.einsum("nid,de,nje->nij", F, posterior.covariance, F, optimize=True)
    error = r - F @ posterior.step
    values, vectors = np.linalg.eigh(np.eye(F.shape[1]) - own)
    along = np.einsum("nij,ni->nj", vectors, error)
    square = np.sum(along**2 / np.maximum(values, 1e-9), axis=1)
    return np.argsort(-square)[:TRIED]
