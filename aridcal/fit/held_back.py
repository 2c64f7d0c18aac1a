"""Rows held back from a solved model: does a larger model predict them better than a smaller one?"""

from __future__ import annotations

import numpy as np

from aridcal.fit.least_squares import Fit
from aridcal.fit.normal_equations import RIDGE, accumulate, solve
from aridcal.fit.residual import BLOCK, problem
from aridcal.inputs.channels import columns
from aridcal.inputs.dataset import Dataset

BLOCKS = 10
"""Blocks of configurations that are held back in turn. Convention: nine tenths of the rows stay to fit with."""

PLENTY = 50.0
"""Numbers measured for each coefficient from which a model cannot lose by its freedom: that costs 2 % of the squares."""

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
    if used.sum() * larger.residual.shape[1] * data.share > PLENTY * len(larger.theta):
        return True
    part = data.select(used)
    squares = [_squares(fit, part) for fit in (smaller, larger)]
    unit = np.maximum(squares[0].mean(axis=0), np.finfo(float).tiny)
    gain = np.bincount(part.configuration, ((squares[0] - squares[1]) / unit).sum(axis=1))
    return float(gain.sum()) > SURE * float(np.sqrt(np.sum((gain - gain.mean()) ** 2)))


def _squares(fit: Fit, data: Dataset) -> np.ndarray:
    """Squared residual of each row in each channel, its block held back, shape (N, C)."""
    asked = problem(fit.model, data)
    pieces = [asked.linearised(fit.theta, slice(k, k + BLOCK)) for k in range(0, len(data), BLOCK)]
    r, J = (np.concatenate(stacked) for stacked in zip(*pieces, strict=True))
    number = np.random.default_rng(2).permutation(int(data.configuration.max()) + 1)
    block = number[data.configuration] % BLOCKS
    parts, K = columns(data.channels), J.shape[2]
    left = r.copy()
    for k in np.unique(block):
        own = block == k
        rest = accumulate([J[~own][:, c].reshape(-1, K) for c in parts], [r[~own][:, c].ravel() for c in parts])
        left[own] = r[own] - J[own] @ solve(rest.information(fit.sigma), rest.pull(fit.sigma), ridge=RIDGE)
    return np.stack([np.sum(left[:, c] ** 2, axis=1) for c in parts], axis=1)
