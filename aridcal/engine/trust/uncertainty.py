"""How far a calibration can be trusted: uncertainty of the target, gross outliers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.fit.flags import distance, robust_sigma
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.noise import covariance_of_rows, noise_ratio
from aridcal.engine.fit.problem import ROWS_PER_BLOCK, Problem, problem
from aridcal.engine.fit.residual import linearise
from aridcal.engine.instruments.channels import Channels
from aridcal.engine.model.model import ModelRows
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.numerics import RANK
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.progress import SILENT, Progress

REALIGN_STEPS = 12
"""Work: Gauss-Newton steps at the most to fit two frames anew; five are usual."""

GROSS_OUTLIER_SCALES = 10.0
"""Robust scales beyond which a held-out row is a gross outlier: so far that no model is to blame."""


@dataclass(frozen=True)
class Precision:
    """How well the calibrated target is known, by propagating the noise.

    Attributes:
        position: 1-sigma of the target in its worst direction at each row, shape (N,), [m].
        rotation: Likewise for its orientation, [rad].
    """

    position: np.ndarray
    rotation: np.ndarray


def precision(fit: Fit, train: Dataset) -> Precision:
    """Propagate the noise to the target."""
    position, rotation = target_sigma(fit, rows_of_data(fit.model, train))
    return Precision(position, rotation)


def with_contradicted_noise(fit: Fit, train: Dataset, progress: Progress = SILENT) -> Fit:
    r"""The same fit, its covariance enlarged where the residuals contradict a smaller declared noise.

    .. math:: \Sigma + \Sigma \Big( \sum_c (s_c^2 - 1) A_c^T A_c / \sigma_c^2 \Big) \Sigma

    with the columns A_c of channel c, its declared noise sigma_c, and s_c the factor by which the residuals
    exceed it: the scatter of coefficients that were fitted with other weights than those of the noise itself.

    Args:
        fit: A stage.
        train: The rows that it was fitted to.
        progress: Told how far the pass over them is.
    """
    excess = np.maximum(noise_ratio(train, fit.estimated, fit.freedom), 1.0)
    if np.all(excess == 1.0):
        return fit
    equations = linearise(problem(fit.model, train, progress), fit.theta, fit.weight, fit.sigma).equations
    added = equations.information(fit.sigma / excess) - equations.information(fit.sigma)
    return replace(fit, covariance=fit.covariance + fit.covariance @ added @ fit.covariance)


def target_sigma(fit: Fit, rows: ModelRows) -> tuple[np.ndarray, np.ndarray]:
    r"""1-sigma of the predicted target in its worst direction, [m] and [rad], shape (N,) each.

    The square root of the largest eigenvalue of :math:`J \Sigma J^T`, J the target's Jacobian and Sigma the covariance of
    the coefficients.
    """
    worst, model = np.empty((2, len(rows))), fit.model
    local = model.local
    for start in range(0, len(rows), ROWS_PER_BLOCK):
        block = slice(start, start + ROWS_PER_BLOCK)
        _, _, J = (model.jacobian if local is None else model.motions)(fit.theta, rows[block])
        covariance = (
            covariance_of_rows(J, fit.covariance)
            if local is None
            else local.carried(J, rows.phi[block], fit.covariance)
        )
        for k, part in enumerate((slice(0, 3), slice(3, 6))):
            variance = np.linalg.eigvalsh(covariance[:, part, part])[:, -1]
            worst[k, block] = np.sqrt(np.maximum(variance, 0.0))
    return worst[0], worst[1]


def realigned(fit: Fit, other: Problem) -> np.ndarray:
    """Scaled residuals of other rows after fitting the two frames anew to them, all else as before, shape (N, m).

    The error that this removes comes from remounting the target or moving the tracker, not from the robot.
    """
    theta = fit.theta.copy()
    of_frames = [c.where in ("world_base", "tip_target") and c.basis.constant for c in fit.model.coefficients]
    frames = np.flatnonzero(of_frames)
    r = fit.residual
    other = other.settled(theta)
    for _ in range(REALIGN_STEPS):
        linear = linearise(other, theta, None, fit.sigma)
        r = linear.residual
        H = linear.equations.information(fit.sigma)[np.ix_(frames, frames)]
        step = np.linalg.lstsq(H, linear.equations.pull(fit.sigma)[frames], rcond=1e-12)[0]
        theta[frames] += step
        moved = np.zeros(len(theta))
        moved[frames] = step
        other = other.stepped(linear.step_of_groups(moved))
        if np.all(np.abs(step) < RANK):
            break
    return r


def outliers(train: np.ndarray, flags: np.ndarray, stages: list[np.ndarray], channels: Channels) -> np.ndarray:
    """One set of flags for all stages: the final model's on train; on test only what is far off at every stage.

    "Far" is ten times the robust scale of the final model's training residuals: a held-out row that any stage predicts
    better than that is never left out.

    Args:
        train: Mask of the training rows, shape (N,).
        flags: Flags of the training rows, shape (train rows,).
        stages: Residuals of every stage, the final one last, all rows, scaled by the rows' relative sigmas.
        channels: Of the residuals.
    """
    sigma = robust_sigma(stages[-1][train], channels)
    far = np.all([distance(r, sigma, channels) > GROSS_OUTLIER_SCALES for r in stages], axis=0)
    far[train] = flags
    return far
