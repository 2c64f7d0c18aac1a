"""Two links that hold one body: while they do, the pose of the one in the frame of the other stays what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.instruments.kind import MeasurementKind, ResidualDerivatives, States
from aridcal.engine.instruments.pixels import BOARD, T, rotation_of
from aridcal.engine.instruments.pose import nearest_rotation, residuals, turned_back

GRASP = replace(BOARD, name="grasp", many=True)
"""The pose of the second link in the frame of the first: another one each time that the body is taken."""


def _residual(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """The grasp minus the second link's predicted pose, [m] and [rad], in the first link's axes: (n, 6)."""
    (grasp,) = states
    return residuals(R, p, grasp[:, T], rotation_of(grasp))


def _derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    """The residual with its derivatives; a grasp's change is in its own axes, so that it turns behind the residual's rotation."""
    residual = _residual(R, p, observed, states)
    rotation = rotation_of(states[0])
    by_twist, by_grasp = np.zeros((2, len(p), 6, 6))
    by_twist[:, :3, :3] = np.eye(3)
    by_twist[:, 3:, 3:] = turned_back(residual[:, 3:])
    by_grasp[:, :3, :3] = -rotation
    by_grasp[:, 3:, 3:] = -turned_back(-residual[:, 3:]) @ rotation
    return ResidualDerivatives(residual, by_twist, (by_grasp,))


def _located(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """The mean pose of the second link."""
    if not len(p):
        return np.full(GRASP.size, np.nan)
    return np.concatenate([p.mean(axis=0), nearest_rotation(R.sum(axis=0)).ravel()])


JOINED = MeasurementKind(
    name="joined",
    words="two links that hold one body",
    channels=(TARGET_POSITION, TARGET_ROTATION),
    read=(),
    roles=(GRASP,),
    residual=_residual,
    derivatives=_derivatives,
    located=_located,
    turns=True,
    condition=True,
    bare=True,
)
