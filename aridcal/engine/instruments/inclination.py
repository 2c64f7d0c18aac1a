"""The direction of gravity in the target's frame: an inclinometer, or an accelerometer at rest."""

from __future__ import annotations

import numpy as np

from aridcal.engine.instruments.channels import INCLINATION
from aridcal.engine.instruments.kind import MeasurementKind, ResidualDerivatives, States
from aridcal.engine.instruments.pose import skew
from aridcal.engine.robot.kinematics import transverse

DOWN = np.array([0.0, 0.0, -1.0])
"""Gravity's direction in the world."""

SINE_SERIES_BELOW = 1e-3
"""Sine below which a quotient that tends to 0/0 is taken from its series, whose next term is 1e-12."""


def _frame(R: np.ndarray, observed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The measured direction (n, 3), axes across it (n, 2, 3); predicted gravity along those (n, 2) and along it (n,)."""
    direction = observed / np.linalg.norm(observed, axis=1, keepdims=True)
    across = np.stack(transverse(direction), axis=1)
    predicted = np.swapaxes(R, 1, 2) @ DOWN
    return direction, across, np.einsum("nij,nj->ni", across, predicted), np.sum(direction * predicted, axis=1)


def _angles(across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle between two directions split into two by their axes, (n, 2), from sines and cosine; and angle over sine (n,)."""
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, along)
    per_sine = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)
    split = per_sine[:, None] * across
    # exactly opposite, every direction across is as good
    split[:, 0] = np.where((sine == 0.0) & (along < 0.0), np.pi, split[:, 0])
    return split, per_sine


def _residual(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """Measured minus predicted direction, [rad]: the angle between them, along two axes across the measured one."""
    _, _, across, along = _frame(R, observed)
    return -_angles(across, along)[0]


def _derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    r"""The residual with its derivatives.

    With sines s along the axes E, cosine c and f = angle / \|s\|, the split angle is f s, and

    .. math:: d(f s) = f ds + s \left( \frac{c |s| - \theta}{|s|^3} s \cdot ds - dc \right)

    A twist w of the target turns gravity as it sees it by R' (g x w).
    """
    direction, axes, across, along = _frame(R, observed)
    split, per_sine = _angles(across, along)
    turned = np.swapaxes(R, 1, 2) @ skew(DOWN[None])  # R' [g]
    ds = axes @ turned
    dc = np.einsum("ni,nij->nj", direction, turned)
    sine = np.linalg.norm(across, axis=1)
    near = (sine < SINE_SERIES_BELOW) & (along > 0.0)
    safe = np.where(sine < SINE_SERIES_BELOW, 1.0, sine)
    exact = (along * safe - np.arctan2(safe, along)) / safe**3
    factor = np.where(near, -2.0 / 3.0 - 0.2 * sine**2, exact)
    inner = factor[:, None] * np.einsum("ni,nij->nj", across, ds) - dc
    by_twist = np.zeros((len(R), 2, 6))
    by_twist[:, :, 3:] = per_sine[:, None, None] * ds + across[:, :, None] * inner[:, None]
    return ResidualDerivatives(-split, by_twist, ())


INCLINED = MeasurementKind(
    name="inclination",
    words="the direction of gravity in the target's frame",
    channels=(INCLINATION,),
    read=("gx", "gy", "gz"),
    roles=(),
    residual=_residual,
    derivatives=_derivatives,
    located=None,
    turns=True,
    level=True,
)
