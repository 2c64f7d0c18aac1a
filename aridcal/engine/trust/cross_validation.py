r"""What a calibration does on rows that it does not know, and which single rows decide it: from one factorisation each.

About the solution of all rows, with the information :math:`\Lambda` (priors included) and sums :math:`H_f, g_f` of the rows
left out, the solution of the others differs by :math:`\delta = (\Lambda - H_f)^{-1} (g_{rest} - g_{all})`. For one row i, whose
share of the whole is

.. math:: L_i = \tilde J_i \Lambda^{-1} \tilde J_i^T + B_i H_B^{-1} B_i^T, \qquad
          \delta_i = -\Lambda^{-1} \tilde J_i^T (1 - L_i)^{-1} r_i, \qquad D_i = \delta_i^T \Lambda \delta_i / K

with :math:`\tilde J` less what the row's things take up: leverage, and Cook's distance (Cook 1977, doi:10.2307/1268249) of rows
of several numbers. What matters to users is how far the predicted target moves (DFFITS; Belsley, Kuh, Welsch 1980).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.noise import covariance_of_rows
from aridcal.engine.fit.normal_equations import solve
from aridcal.engine.fit.problem import unscaled
from aridcal.engine.instruments.channels import norms, spread
from aridcal.engine.levels import JUDGING_FOLDS
from aridcal.engine.model.many_rows import blocks
from aridcal.engine.numerics import RIDGE
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups
from aridcal.engine.trust.columns import Columns, columns_of
from aridcal.system.progress import SILENT, Progress

MOST_LEFT_OUT_ROWS = 5000
"""Work: Rows at the most that are left out in turn: one of so many moves nothing, and errors of so many are known to a per
cent."""

LONE_ROW_SHARE = 1e-9
"""Work: What is left of a row's own share, beside other rows', below which it is alone in telling of something."""

DECIDING_SHIFT = 1.0
"""Standard deviations of the predicted target by which leaving out one row may move it: beyond it one measurement weighs
as much as the noise of all."""


@dataclass(frozen=True)
class Folds:
    """Errors of rows that the calibration did not know.

    Attributes:
        error: RMS of the rows' errors in each fold, by channel, shape (folds, C), in the channels' units; NaN where no row of a
            fold measures the channel.
        fitted: RMS of the errors of all rows, fitted together, shape (C,).
    """

    error: np.ndarray
    fitted: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """RMS over the folds, shape (C,)."""
        return np.asarray(np.sqrt(np.nanmean(self.error**2, axis=0)))

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation from fold to fold, shape (C,)."""
        return np.asarray(np.nanstd(self.error, axis=0, ddof=1))


@dataclass(frozen=True)
class Influence:
    """Change of a calibration without each of its rows.

    Attributes:
        rows: Numbers among the fitted rows, shape (n,), the largest shift first.
        shift: Shift of the predicted target, RMS over all rows, [m], shape (n,).
        sigma: RMS 1-sigma of the predicted target over all rows, all three axes, [m].
        leverage: Share of each row in its own prediction: trace of L over the numbers that it measures, 0 to 1, shape (n,).
        cook: Cook's distance, shape (n,).
    """

    rows: np.ndarray
    shift: np.ndarray
    sigma: float
    leverage: np.ndarray
    cook: np.ndarray

    @property
    def deciding(self) -> np.ndarray:
        """Rows that move the target by more than its own uncertainty, the most influential first."""
        return np.asarray(self.rows[self.shift > DECIDING_SHIFT * self.sigma])


def rows_of(fit: Fit, train: Dataset, progress: Progress = SILENT) -> Columns:
    """The rows that are left out in turn, with the weights that they were fitted with.

    Args:
        fit: K coefficients, with the covariance of its own weights.
        train: The rows that it was fitted to.
        progress: Told how far the pass over them is.
    """
    return columns_of(fit, train, fit.sigma, MOST_LEFT_OUT_ROWS, progress)


def folds(fit: Fit, train: Dataset, rows: Columns) -> Folds | None:
    """Predict each fold of configurations from the others; None where there are fewer configurations than folds.

    The model keeps its effects, and their coefficients are fitted to the other folds alone. Of a thing that only the rows of one
    fold refer to nothing is known without them: those rows are not counted.

    Args:
        fit: K coefficients.
        train: The rows that it was fitted to.
        rows: See :func:`rows_of`.
    """
    data = train.select(rows.rows)
    together = held_back_groups(data)
    if len(fit.theta) == 0 or together.max(initial=0) + 1 < JUDGING_FOLDS:
        return None
    fold = (np.random.default_rng(3).permutation(int(together.max()) + 1) % JUDGING_FOLDS)[together]
    things = rows.solved()
    sums_of_all = rows.equations(things) if rows.groups is not None else None
    whole = len(rows) / max(int((~fit.outliers).sum()), 1) * fit.information
    residuals = rows.r.copy()
    for k in range(JUDGING_FOLDS):
        out = fold == k
        things_of_rest = rows.solved(~out)
        if sums_of_all is None:  # sums over rows: the others' are all less those of these
            H_out, g_out = rows.equations(things, out)
        else:
            H_out, g_out = (
                all_of - remaining
                for all_of, remaining in zip(sums_of_all, rows.equations(things_of_rest, ~out), strict=True)
            )
        step = solve(whole - H_out, -g_out, ridge=RIDGE)
        residuals[out] -= rows.J[out] @ step
        if rows.groups is not None:
            group = rows.group[out]
            of_things = group >= 0
            y = things_of_rest.y - things_of_rest.X @ step
            undetermined = of_things & (things_of_rest.rank < things.rank)[group]
            by_things = np.einsum("nmu,nu->nm", rows.B[out], y[group])
            residuals[out] -= np.where(of_things[:, None], by_things, 0.0)
            residuals[out] = np.where(undetermined[:, None], np.nan, residuals[out])
    errors = np.array([_rms(residuals[fold == k], rows, fit, data, fold == k) for k in range(JUDGING_FOLDS)])
    return Folds(errors, _rms(rows.r, rows, fit, data, np.ones(len(rows), dtype=bool)))


def _rms(r: np.ndarray, rows: Columns, fit: Fit, data: Dataset, some: np.ndarray) -> np.ndarray:
    """RMS error of rows by channel, shape (C,), from residuals in sigmas (n, m)."""
    back = r * spread(fit.sigma, rows.channels) / np.sqrt(rows.share)
    back = unscaled(np.where(rows.there[some], back, np.nan), None if data.relative is None else data.relative[some])
    sizes = norms(back, rows.channels)
    count = (~np.isnan(sizes)).sum(axis=1)
    total = np.nansum(sizes**2, axis=1)
    return np.asarray(np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan))


def influence(fit: Fit, rows: Columns) -> Influence | None:
    """Leave out each row in turn; None for a fit without coefficients.

    Args:
        fit: K coefficients.
        rows: See :func:`rows_of`.
    """
    if len(fit.theta) == 0:
        return None
    things, (n, m, K) = rows.solved(), rows.J.shape
    J, B = rows.J, rows.B
    L = np.zeros((n, m, m))
    if rows.groups is not None:
        grouped = rows.group >= 0
        group = rows.group[grouped]
        J = J.copy()
        J[grouped] -= B[grouped] @ things.X[group]
        L[grouped] = B[grouped] @ things.inverse[group] @ B[grouped].transpose(0, 2, 1)
    L += _shares(J, fit.covariance)
    # A row that alone tells of something predicts itself: without it there is nothing to compare.
    weighted = np.linalg.pinv(np.eye(m) - L, hermitian=True, rcond=LONE_ROW_SHARE) @ rows.r[:, :, None]
    pull = -(J.transpose(0, 2, 1) @ weighted)[:, :, 0]
    step = pull @ fit.covariance
    at_target = rows.target.reshape(-1, K)
    T = at_target.T @ at_target / n
    shift = np.sqrt(np.maximum(np.sum((step @ T) * step, axis=1), 0.0))
    order = np.argsort(-shift, kind="stable")
    leverage = np.einsum("nmm->n", L) / np.maximum(rows.there.sum(axis=1), 1)
    # The step is the covariance times the row's pull, so that its product with the information is that pull.
    distance = np.maximum(np.sum(step * pull, axis=1), 0.0) / K
    sigma = float(np.sqrt(np.sum(T * fit.covariance)))
    return Influence(rows.rows[order], shift[order], sigma, leverage[order], distance[order])


def _shares(J: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    r""":math:`J \Sigma J^T` of each row, shape (n, m, m), from columns J (n, m, K); of few that act in a row from these alone."""
    acts = J.any(axis=1)
    most = int(acts.sum(axis=1).max(initial=0))
    if 4 * most > len(covariance):  # to pick them out takes longer than the one product of all
        return covariance_of_rows(J, covariance)
    which = np.argsort(~acts, axis=1, kind="stable")[:, :most]
    columns = np.take_along_axis(J, which[:, None], axis=2)
    shares = np.empty((len(J), J.shape[1], J.shape[1]))
    for some in blocks(len(J)):
        between = covariance[which[some, :, None], which[some, None, :]]
        shares[some] = columns[some] @ between @ columns[some].transpose(0, 2, 1)
    return shares
