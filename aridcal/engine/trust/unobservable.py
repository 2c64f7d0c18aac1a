"""What no reading told of a calibration, in use: beside the model's own coefficients, and row by row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aridcal.engine.model.model import Model, Rows
from aridcal.engine.trust.coverage import CHANNELS
from aridcal.engine.trust.workspace import TOLD, Untold, target_covariance, worst_direction


def with_untold(model: Model, theta: np.ndarray, untold: Sequence[Untold]) -> tuple[Model, np.ndarray, np.ndarray]:
    """A model with the constants that no reading tells beside its own, its coefficients, and their covariance.

    Args:
        model: K coefficients.
        theta: Their values, shape (K,).
        untold: Combinations that are as uncertain as they say; all else is held.
    """
    others = {c for part in untold for c, _ in part} - set(model.coefficients)
    every = (*model.coefficients, *sorted(others, key=lambda c: c.name))
    place = {c: k for k, c in enumerate(every)}
    ways = np.zeros((len(every), len(untold)))
    for j, part in enumerate(untold):
        for c, value in part:
            ways[place[c], j] = value
    return model.with_coefficients(every), np.append(theta, np.zeros(len(others))), ways @ ways.T


def told_of(model: Model, theta: np.ndarray, untold: Sequence[Untold], rows: Rows, turns: bool) -> np.ndarray:
    """Rows of whose target all is told, shape (N,) bool.

    Args:
        model: Of the calibration.
        theta: Its coefficients.
        untold: What no reading told.
        rows: N of them.
        turns: Whether the target's rotation is asked about.
    """
    covariance = target_covariance(*with_untold(model, theta, untold), rows)
    parts = CHANNELS if turns else CHANNELS[:1]
    return np.all([worst_direction(covariance[:, part, part])[0] < TOLD for part in parts], axis=0)
