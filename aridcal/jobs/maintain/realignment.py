"""Where a frame is now, in closed form: a tracker is set up anew for every check, anywhere, and no small step leads there."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import FRAME_COMPONENTS
from aridcal.engine.fit.problem import Problem

FEWEST_POSITIONS = 3
"""Positions that tell where a frame is; one pose does."""


def frame_start(problem: Problem, theta: np.ndarray, where: str, label: str | None) -> np.ndarray:
    """Coefficients (K,) with a frame put where rows have it: the mean of where each pose does, or the best for all positions.

    Where too few of its rows measure the target's own place, it stays.

    Args:
        problem: The rows.
        theta: Coefficients to start from, shape (K,).
        where: ``world_base`` or ``tip_target``.
        label: Of the frame there.
    """
    model, rows, data = problem.model, problem.rows, problem.data
    at_base = where == "world_base"
    frames, index = (model.world_base, rows.world) if at_base else (model.tip_target, rows.tip)
    of_frame = (index == [name for name, _ in frames].index(label)) & np.isfinite(data.position).all(axis=1)
    rotations = None if data.rotation is None or np.isnan(data.rotation[of_frame]).any() else data.rotation[of_frame]
    if of_frame.sum() < (FEWEST_POSITIONS if rotations is None else 1):
        return theta
    R, p = (values[of_frame] for values in model.poses(theta, rows))
    positions = data.position[of_frame]
    place = {
        c.component: k
        for k, c in enumerate(model.coefficients)
        if c.basis.constant and (c.where, c.station) == (where, label)
    }
    value = np.array([theta[place[c]] for c in FRAME_COMPONENTS])
    offset = pin.SE3(pin.rpy.rpyToMatrix(value[3:]), value[:3])
    start = frames[int(index[of_frame][0])][1] * offset
    if at_base:
        turn = _nearest(positions, p) if rotations is None else _mean(rotations @ R.transpose(0, 2, 1))
        step = pin.SE3(turn, (positions - p @ turn.T).mean(axis=0))
        offset = offset * start.inverse() * step * start
    else:
        turn = np.eye(3) if rotations is None else _mean(R.transpose(0, 2, 1) @ rotations)
        step = pin.SE3(turn, np.einsum("nji,nj->ni", R, positions - p).mean(axis=0))
        offset = offset * step
    theta_new = theta.copy()
    theta_new[[place[c] for c in FRAME_COMPONENTS]] = [*offset.translation, *pin.rpy.matrixToRpy(offset.rotation)]
    return theta_new


def _mean(rotations: np.ndarray) -> np.ndarray:
    """The rotation nearest to many, shape (n, 3, 3): of their mean (Moakher 2002)."""
    return _rotation(rotations.mean(axis=0))


def _nearest(to: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The rotation that brings points (n, 3) nearest to others about their means (Kabsch 1976)."""
    return _rotation((to - to.mean(axis=0)).T @ (points - points.mean(axis=0)))


def _rotation(M: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix (3, 3)."""
    U, _, V = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V)
