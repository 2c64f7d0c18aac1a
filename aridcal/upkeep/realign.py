"""Where a frame is now, in closed form: a tracker is set up anew for every check, anywhere, and no small step leads there."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from aridcal.effects.effect import FRAME_COMPONENTS
from aridcal.fit.problem import Problem
from aridcal.upkeep.suspects import Suspect


def frame_start(problem: Problem, theta: np.ndarray, suspect: Suspect) -> np.ndarray:
    """Coefficients (K,) with a frame put where rows have it: the mean of where each pose does, or the best for all positions.

    Args:
        problem: The rows.
        theta: Coefficients to start from, shape (K,).
        suspect: A frame; anything else starts as it is.
    """
    if suspect.kind != "frame":
        return theta
    model, rows, data = problem.model, problem.rows, problem.data
    first = model.coefficients[suspect.touched[0]]
    at_base = first.where == "world_base"
    frames, index = (model.world_base, rows.world) if at_base else (model.tip_target, rows.tip)
    own = index == [label for label, _ in frames].index(first.station)
    R, p = (values[own] for values in model.poses(theta, rows))
    seen = data.position[own]
    place = {
        c.component: k
        for k, c in enumerate(model.coefficients)
        if c.basis.constant and (c.where, c.station) == (first.where, first.station)
    }
    value = np.array([theta[place[c]] for c in FRAME_COMPONENTS])
    moved = pin.SE3(pin.rpy.rpyToMatrix(value[3:]), value[:3])
    start = frames[int(index[own][0])][1] * moved
    if at_base:
        turn = _nearest(seen, p) if data.rotation is None else _mean(data.rotation[own] @ R.transpose(0, 2, 1))
        step = pin.SE3(turn, (seen - p @ turn.T).mean(axis=0))
        moved = moved * start.inverse() * step * start
    else:
        turn = np.eye(3) if data.rotation is None else _mean(R.transpose(0, 2, 1) @ data.rotation[own])
        step = pin.SE3(turn, np.einsum("nji,nj->ni", R, seen - p).mean(axis=0))
        moved = moved * step
    found = theta.copy()
    found[[place[c] for c in FRAME_COMPONENTS]] = [*moved.translation, *pin.rpy.matrixToRpy(moved.rotation)]
    return found


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
