"""The target held in, or touching, a point that does not move: a ball in a socket, a pin, the centre of a touched sphere."""

from __future__ import annotations

import numpy as np

from aridcal.engine.instruments.channels import TARGET_POSITION
from aridcal.engine.instruments.kind import MeasurementKind, ResidualDerivatives, Role, States, added, points_twist

POINT = Role("point", ("x", "y", "z"), ("m", "m", "m"), 3, added, None, ("x", "y", "z"), many=True)


def _residual(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """The point minus the target, [m]: what is read is that their difference is nothing."""
    return np.asarray(states[0] - p)


def _derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    """The residual with its derivatives."""
    identity = np.broadcast_to(np.eye(3), (len(p), 3, 3))
    return ResidualDerivatives(states[0] - p, points_twist(identity), (-identity,))


def _located(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """The mean of the target's places."""
    return np.asarray(p.mean(axis=0)) if len(p) else np.full(3, np.nan)


TOUCHED = MeasurementKind(
    "point",
    "the target in a fixed point",
    (TARGET_POSITION,),
    (),
    (POINT,),
    _residual,
    _derivatives,
    _located,
    condition=True,
)
