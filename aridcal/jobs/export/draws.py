"""Calibrations as they might have come out: coefficients drawn from their posterior."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from aridcal.engine.model.model import Model
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


def frames_of(model: Model, drawn: np.ndarray) -> dict[str, np.ndarray]:
    """Where each drawn arm stands in the world, and its target on the tip: constants and frames stand in for each other.

    Args:
        model: Of the draws.
        drawn: Shape (count, K).

    Returns:
        Columns, shape (count,) each: ``world_base.x y z`` [m], ``qx qy qz qw``, likewise ``tip_target``; with the label of each
        where there are several.
    """
    columns: dict[str, list[float]] = {}
    for theta in drawn:
        for where, frames in zip(("world_base", "tip_target"), model.frames(theta), strict=True):
            for label, T in frames:
                name = where if label is None else f"{where}[{label}]"
                for key, value in zip(("x", "y", "z", "qx", "qy", "qz", "qw"), pin.SE3ToXYZQUAT(T), strict=True):
                    columns.setdefault(f"{name}.{key}", []).append(float(value))
    return {name: np.array(values) for name, values in columns.items()}
