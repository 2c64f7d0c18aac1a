r"""Readings that bring the target to many wanted poses at once, each row by itself: Levenberg's and Marquardt's method in arrays.

The error e of a row is a position and a rotation vector in world axes, turned into lengths by a lever; J is what its readings
take from it. Each step is the shortest that does it, or the least-squares one where fewer than six readings are free:

.. math:: s = J^T (J J^T + \lambda)^{-1} e \quad \text{or} \quad s = (J^T J + \lambda)^{-1} J^T e

:mod:`aridcal.engine.inverse.one_pose` does the same for one row, in less time than arrays of one row take, and more patiently.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from aridcal.engine.instruments.pose import rotation_vector
from aridcal.engine.inverse.one_pose import FIRST_DAMPING, LAST_DAMPING, SINGULAR_DAMPING
from aridcal.engine.model.model import Model

POSE_TOLERANCE = 1e-10
"""[m]: a target that is nearer is there: a hundredth of the finest digit that programs write, and far above rounding."""

LARGEST_TURN_OF_A_STEP = 1.0
"""The most that a joint turns in one step, [rad]: of random starts more come to a pose than with half of it, or twice."""

STEPS_TO_HALVE = 12
"""Steps in which an error must be halved, or the search has come to nothing: four of five random starts come to a pose, and
hardly more with twice the patience."""

MOST_STEPS = 18
"""The most there are in one search: with a third more hardly another start comes to its pose."""

ROWS_AT_ONCE = 4_000
"""Rows that are worked on together, so that all of them stay in the cache and memory stays flat."""


@dataclass(frozen=True)
class ArmRows:
    """A solved model in many configurations.

    Attributes:
        model: Robot, frames and coefficients.
        theta: Of the coefficients, shape (K,).
        station: Label of the frames to use, where they are per station.
        target: That of the target, where it is not the same.
    """

    model: Model
    theta: np.ndarray
    station: str | None = None
    target: str | None = None

    def looks(
        self, readings: np.ndarray, covariates: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rotations (n, 3, 3) and positions (n, 3) of the target, and its twists by the readings, (n, 6, columns)."""
        n = len(readings)
        labels = (None if label is None else np.full(n, label) for label in (self.station, self.target))
        return self.model.by_readings(self.theta, self.model.rows(readings, covariates, *labels))


class SearchEnd(NamedTuple):
    """Where a search for each row has ended.

    Attributes:
        readings: Shape (n, columns).
        error: What is left: position, and rotation vector times the lever, shape (n, 6), [m].
        J: What the readings take from it, shape (n, 6, columns).
    """

    readings: np.ndarray
    error: np.ndarray
    J: np.ndarray


@dataclass(frozen=True)
class InverseRows:
    """Inverse kinematics of many rows at once.

    Attributes:
        arm: What stands at readings.
        low: Lower limits of the readings, shape (columns,), [rad] or [m]; -inf where there is none.
        high: Upper limits, likewise.
        turning: Readings that turn a joint, shape (columns,) bool.
        lever: [m/rad]: an error of 1 rad counts as much as one of so many metres.
    """

    arm: ArmRows
    low: np.ndarray
    high: np.ndarray
    turning: np.ndarray
    lever: float

    def error(
        self, poses: np.ndarray, readings: np.ndarray, covariates: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """How far rows are from wanted poses (n, 4, 4), shape (n, 6), and what the readings take from it, (n, 6, columns)."""
        R, p, J = self.arm.looks(readings, covariates)
        e = np.empty((len(readings), 6))
        e[:, :3] = poses[:, :3, 3] - p
        e[:, 3:] = self.lever * rotation_vector(poses[:, :3, :3] @ R.transpose(0, 2, 1))
        J[:, 3:] *= self.lever
        return e, J

    def approach(
        self,
        poses: np.ndarray,
        seeds: np.ndarray,
        fixed: np.ndarray,
        covariates: Mapping[str, np.ndarray],
        steps: int = MOST_STEPS,
    ) -> SearchEnd:
        """Search for each row, from a seed.

        Args:
            poses: Poses of the target, shape (n, 4, 4).
            seeds: Readings to start from, shape (n, columns).
            fixed: Readings that stay, shape (n, columns), NaN where they do not.
            covariates: What effects depend on, shape (n,) each.
            steps: The most there are; none to look at the seeds alone.
        """
        parts = []
        for start in range(0, max(len(seeds), 1), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            conditions = {name: values[part] for name, values in covariates.items()}
            parts.append(self._approach(poses[part], seeds[part], fixed[part], conditions, steps))
        return SearchEnd(*map(np.concatenate, zip(*parts, strict=True)))

    def _approach(
        self,
        poses: np.ndarray,
        seeds: np.ndarray,
        fixed: np.ndarray,
        covariates: Mapping[str, np.ndarray],
        steps: int,
    ) -> SearchEnd:
        low, high = (np.where(np.isnan(fixed), limit, fixed) for limit in (self.low, self.high))
        q = np.clip(seeds, low, high)
        e, J = self.error(poses, q, covariates)
        result = SearchEnd(q.copy(), e.copy(), J.copy())
        size = np.einsum("ni,ni->n", e, e)
        rows = np.flatnonzero(size >= POSE_TOLERANCE**2)  # those that are still under way
        q, e, J, size, damping = q[rows], e[rows], J[rows], size[rows], np.zeros(len(rows))
        earlier = size.copy()
        for step_number in range(1, steps + 1 if len(rows) else 1):
            step = self._steps(J, e, q, damping, low[rows], high[rows])
            e_trial, J_trial = self.error(poses[rows], q + step, {k: v[rows] for k, v in covariates.items()})
            trial = np.einsum("ni,ni->n", e_trial, e_trial)
            better = trial < size
            promised = np.einsum("nij,nj->ni", J, step)
            idle = (damping == 0.0) & (np.einsum("ni,ni->n", promised, promised) < POSE_TOLERANCE**2)
            q, e = np.where(better[:, None], q + step, q), np.where(better[:, None], e_trial, e)
            J[better], size = J_trial[better], np.where(better, trial, size)
            damping = np.where(
                better, np.where(damping < FIRST_DAMPING, 0.0, damping / 10), np.maximum(10 * damping, FIRST_DAMPING)
            )
            ended = idle | (size < POSE_TOLERANCE**2) | (damping > LAST_DAMPING)
            if step_number % STEPS_TO_HALVE == 0:
                ended |= size > earlier / 4
                earlier = size.copy()
            if ended.any() or step_number == steps:
                for of_all, some in zip(result, (q, e, J), strict=True):
                    of_all[rows] = some
                on = ~ended
                rows, q, e, J, damping, size, earlier = (a[on] for a in (rows, q, e, J, damping, size, earlier))
                if not len(rows):
                    break
        return result

    def _steps(
        self, J: np.ndarray, e: np.ndarray, q: np.ndarray, damping: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> np.ndarray:
        """A step of each row inside the limits, no joint turned further than the linear model holds."""
        free = low < high
        step = shortest(J * free[:, None], e, damping)
        stopped = free & (((q <= low) & (step < 0.0)) | ((q >= high) & (step > 0.0)))
        met = stopped.any(axis=1)
        if met.any():  # what stands at a limit stays there while the others go on
            step[met] = shortest(J[met] * (free & ~stopped)[met][:, None], e[met], damping[met])
        fastest = np.abs(step[:, self.turning]).max(axis=1, initial=LARGEST_TURN_OF_A_STEP)
        return np.asarray(np.clip(q + step * (LARGEST_TURN_OF_A_STEP / fastest)[:, None], low, high) - q)


def shortest(J: np.ndarray, e: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Steps that take errors (n, m) away, shape (n, columns): the shortest, or least squares where columns are too few.

    Args:
        J: Shape (n, m, columns); a column of zeros does not move.
        e: Shape (n, m).
        damping: Shape (n,).
    """
    m = e.shape[1]
    step = np.zeros((len(e), J.shape[2]))
    enough = (np.einsum("nij,nij->nj", J, J) > 0.0).sum(axis=1) >= m
    for few, some in ((False, enough), (True, ~enough)):
        if some.any():
            A, b = J[some], e[some]
            back = A.transpose(0, 2, 1)
            H = back @ A if few else A @ back
            H[:, range(H.shape[1]), range(H.shape[1])] += (damping[some] + SINGULAR_DAMPING)[:, None]
            right = (back @ b[:, :, None]) if few else b[:, :, None]
            solved = np.linalg.solve(H, right)
            step[some] = (solved if few else back @ solved)[:, :, 0]
    return step
