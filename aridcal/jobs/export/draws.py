"""Calibrations as they might have come out: coefficients drawn from their posterior."""

from __future__ import annotations

import numpy as np

from aridcal.jobs.calibrate.saved_model import SolvedModel


def draws(solved: SolvedModel, count: int, seed: int) -> np.ndarray:
    r"""Draw coefficients that the rows allow: :math:`\theta + S \epsilon`, with S the root of the covariance.

    The root is the symmetric one, of the correlations, so that neither units nor the signs of eigenvectors matter and a
    covariance that is singular by rounding has one, too.

    Args:
        solved: A model with its coefficients and their covariance.
        count: How many.
        seed: The same one gives the same draws.

    Returns:
        Shape (count, K), each in its coefficient's unit.
    """
    std = np.sqrt(np.maximum(np.diag(solved.covariance), 0.0))
    scale = np.where(std > 0.0, std, 1.0)
    values, vectors = np.linalg.eigh(solved.covariance / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    normal = np.random.default_rng(seed).standard_normal((count, len(std)))
    return np.asarray(solved.theta + normal @ root * scale)
