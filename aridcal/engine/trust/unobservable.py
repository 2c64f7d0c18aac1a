"""Constants that no reading tells, in use: beside the model's own coefficients, and row by row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aridcal.engine.model.model import Model, ModelRows
from aridcal.engine.trust.coverage import POSE_PARTS
from aridcal.engine.trust.workspace import KNOWN_TARGET_SIGMA, OpenCombination, target_covariance, worst_direction


def with_unobservable(
    model: Model, theta: np.ndarray, open_combinations: Sequence[OpenCombination]
) -> tuple[Model, np.ndarray, np.ndarray]:
    """A model with the constants that no reading tells beside its own, its coefficients, and their covariance.

    Args:
        model: K coefficients.
        theta: Their values, shape (K,).
        open_combinations: Combinations, with the sigmas that they state; the model's own coefficients are held.
    """
    extra = {c for part in open_combinations for c, _ in part} - set(model.coefficients)
    coefficients = (*model.coefficients, *sorted(extra, key=lambda c: c.name))
    place = {c: k for k, c in enumerate(coefficients)}
    factors = np.zeros((len(coefficients), len(open_combinations)))
    for j, part in enumerate(open_combinations):
        for c, value in part:
            factors[place[c], j] = value
    return model.with_coefficients(coefficients), np.append(theta, np.zeros(len(extra))), factors @ factors.T


def observable_rows(
    model: Model, theta: np.ndarray, open_combinations: Sequence[OpenCombination], rows: ModelRows, turns: bool
) -> np.ndarray:
    """Rows at which the readings tell the target wholly, shape (N,) bool.

    Args:
        model: The model of a calibration.
        theta: Its coefficients, shape (K,).
        open_combinations: Combinations of constants that no reading tells.
        rows: N rows.
        turns: Whether the target's rotation counts, too.
    """
    covariance = target_covariance(*with_unobservable(model, theta, open_combinations), rows)
    parts = POSE_PARTS if turns else POSE_PARTS[:1]
    return np.all([worst_direction(covariance[:, part, part])[0] < KNOWN_TARGET_SIGMA for part in parts], axis=0)
