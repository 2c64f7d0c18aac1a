"""Rows held back from a solved model: does a larger model predict them better than a smaller one?"""

from __future__ import annotations

import numpy as np

from aridcal.fit.least_squares import Fit
from aridcal.fit.normal_equations import RIDGE, accumulate, solve
from aridcal.fit.problem import problem
from aridcal.fit.residual import eliminated
from aridcal.inputs.dataset import Dataset
from aridcal.inputs.split import held_together
from aridcal.instruments.channels import columns

BLOCKS = 10
"""Blocks of configurations that are held back in turn. Convention: nine tenths of the rows stay to fit with."""

PLENTY = 8.0
"""Numbers measured for each coefficient from which a model is not asked: its freedom costs an eighth of the squares at most."""

SURE = 1.0
"""Standard errors by which the larger model must be better (the one-standard-error rule: Breiman and others 1984)."""


def is_better(larger: Fit, smaller: Fit, data: Dataset) -> bool:
    """True if the larger of two models predicts blocks of held-back configurations better.

    Both are linear about their own optimum, so that each block costs one solution. Squares of each channel are counted in
    units of what the smaller model leaves, and compared configuration by configuration.

    Args:
        larger: K coefficients, fitted to the data.
        smaller: Fitted to the same.
        data: N rows.
    """
    used = ~larger.outliers
    if larger.numbers > PLENTY * len(larger.theta) or len(larger.theta) == len(smaller.theta):
        return True
    part = data.select(used)
    squares = [_squares(fit, part) for fit in (smaller, larger)]
    unit = np.maximum(squares[0].mean(axis=0), np.finfo(float).tiny)
    gain = np.bincount(part.configuration, ((squares[0] - squares[1]) / unit).sum(axis=1))
    return float(gain.sum()) > SURE * float(np.sqrt(np.sum((gain - gain.mean()) ** 2)))


def _squares(fit: Fit, data: Dataset) -> np.ndarray:
    r"""Squared residual of each row in each channel, its block held back, shape (N, C).

    With :math:`\Lambda` the information of the whole fit, priors included, and :math:`H_b, g_b` the sums of one block, the
    solution without it differs by :math:`-(\Lambda - H_b)^{-1} g_b`: at the optimum all pulls together are zero.
    """
    asked = problem(fit.model, data)
    pieces = [(r, J) for _, r, J in eliminated(asked, fit.theta, np.ones(len(data)), fit.sigma)]
    r, J = (np.concatenate(stacked) for stacked in zip(*pieces, strict=True))
    together = held_together(data)
    number = np.random.default_rng(2).permutation(int(together.max()) + 1)
    block = number[together] % BLOCKS
    parts, K = columns(data.channels), J.shape[2]
    scale = fit.std
    whole = np.linalg.inv(fit.covariance / np.outer(scale, scale)) / np.outer(scale, scale)
    left = r.copy()
    for k in np.unique(block):
        own = block == k
        sums = accumulate([J[own][:, c].reshape(-1, K) for c in parts], [r[own][:, c].ravel() for c in parts])
        H, g = data.share * sums.information(fit.sigma), data.share * sums.pull(fit.sigma)
        left[own] = r[own] + J[own] @ solve(whole - H, g, ridge=RIDGE)
    return np.stack([np.sum(left[:, c] ** 2, axis=1) for c in parts], axis=1)
