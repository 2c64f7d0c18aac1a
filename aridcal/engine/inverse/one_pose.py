"""Joint readings that bring the target to a wanted pose: Newton's method on the model with its effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dposv

from aridcal.engine.inverse.row_kinematics import OneRowModel

# A search ends when its last step moves the target by less, [m] and [rad]: a tenth of what counts as reached.
STEP_TOLERANCE = 1e-7

# A pose is reached if the model misses it by less than the noise, or than that, [m] and [rad]: no arm repeats
# better.
FINEST_NOISE = 1e-6

# What an arm of fewer joints than the pose has numbers may miss of a pose meant for it, [m] and [rad].
MOST_UNAVOIDABLE = 2e-2

# Effects are taken into account once the target is as near as that, [m] and [rad]: they move it by less.
EFFECTS_WITHIN = 1e-2

# The most that a joint turns in one step, [rad]: so far the Jacobian still says where the target goes.
LARGEST_NEWTON_TURN = 0.5

# How far from the seed further starts are, [rad] or [m], and how many there are.
KICK, KICKS = 0.05, 4

# The most there are in one search; Newton's method takes five or so where it works at all.
MOST_NEWTON_STEPS = 40

# A step that shortens the way (squared) by no larger share is the last of a search that is stuck.
LEAST_PROGRESS = 5e-2

# Damping of Levenberg and Marquardt: what it starts with, and beyond which the search goes on otherwise.
FIRST_DAMPING, LAST_DAMPING = 1e-6, 1e3

# Damping that only keeps a singular arm's step finite.
SINGULAR_DAMPING = 1e-13

# For differences, [rad] or [m].
MARGIN_DIFFERENCE = 1e-6


class Phase(Enum):
    """How a search sees the effects."""

    FAR = "no effect acts, as in a controller's own inverse kinematics"
    NEAR = "effects act, and stay as they are during a step"
    STUCK = "effects act, and change during a step"


@dataclass(frozen=True)
class Command:
    """Readings for one wanted pose.

    Attributes:
        readings: Shape (columns,), in the order of ``robot.readings``, [rad] or [m].
        position_error: How far from the wanted position the model says that the target will be, [m].
        rotation_error: How far from the wanted rotation, [rad]; NaN where only a position is wanted.
        reached: True if they bring the target there: within the noise (per axis) of the measurements behind the model,
            or, of a robot with fewer joints than the pose has numbers, as near as it can get, within 20 mm and 20 mrad.
    """

    readings: np.ndarray
    position_error: float
    rotation_error: float
    reached: bool

    @property
    def miss(self) -> float:
        """The larger error, [m] or [rad]."""
        return max(self.position_error, 0.0 if np.isnan(self.rotation_error) else self.rotation_error)


@dataclass(frozen=True)
class InverseKinematics:
    """Inverse kinematics of a calibrated robot within the limits of its joints.

    Attributes:
        model: What the robot does, effects and all.
        low: Lower limits of the readings, shape (columns,), [rad] or [m]; -inf where there is none, or where a joint
            holds still.
        high: Upper limits, likewise.
        turning: Readings that turn a joint, shape (columns,) bool.
        pose: True where poses are wanted, False where positions alone are.
        noise: Of the measurements behind the model, per axis, [m] and [rad]: a pose missed by less counts as reached,
            and where position and rotation cannot both be had, errors weigh in proportion to it.
    """

    model: OneRowModel
    low: np.ndarray
    high: np.ndarray
    turning: np.ndarray
    pose: bool
    noise: tuple[float, float]

    @cached_property
    def lever(self) -> float:
        """[m/rad]: an error of 1 rad counts as much as one of so many metres."""
        return self.noise[0] / self.noise[1] if self.pose else 1.0

    @cached_property
    def _moving(self) -> np.ndarray | slice:
        """Columns that bring the target nearer: of a robot of one limb all, which costs no copy."""
        return slice(None) if self.model.moves.all() else np.flatnonzero(self.model.moves)

    def command(self, R: np.ndarray, p: np.ndarray, seed: np.ndarray, covariates: Mapping[str, float]) -> Command:
        """Find readings near a seed.

        The arm comes within a centimetre without its effects, as a controller's own inverse kinematics would bring it,
        then settles with them. Levenberg-Marquardt, each step the shortest that does it, so that a redundant arm stays
        near the seed; joints that meet a limit stay there while the others go on. Close to a singularity the search
        may stick: it is then tried again from close by.

        Args:
            R: Wanted rotation, T_world_target's, shape (3, 3); unused where positions alone are wanted.
            p: Wanted position, shape (3,), [m].
            seed: Where to start, shape (columns,), [rad] or [m].
            covariates: Value of each of ``model.needs``.

        Raises:
            CovariateNotFound: one of them is missing.
        """
        best = self._approach(R, p, seed, covariates)
        moving = int(self.model.moves.sum())
        if moving >= (6 if self.pose else 3) and FINEST_NOISE < best.miss < EFFECTS_WITHIN:
            rng = np.random.default_rng(0)
            for kick in np.zeros((KICKS, len(seed))):
                kick[self.model.moves] = KICK * rng.standard_normal(moving)
                best = min(best, self._approach(R, p, seed + kick, covariates), key=lambda c: c.miss)
                if best.miss < FINEST_NOISE:
                    break
        return best

    def _approach(self, R: np.ndarray, p: np.ndarray, seed: np.ndarray, covariates: Mapping[str, float]) -> Command:
        q = np.minimum(np.maximum(seed, self.low), self.high)
        phase, damping = Phase.FAR, 0.0
        e, J = self._look(R, p, q, covariates, phase)
        lean = self.model.moves.sum() < len(e)
        for _ in range(MOST_NEWTON_STEPS):
            size = float(e @ e)
            if phase is Phase.FAR and size < EFFECTS_WITHIN**2:
                phase = Phase.NEAR
                e, J = self._look(R, p, q, covariates, phase)
                size = float(e @ e)
            step = self._step(J, e, q, damping)
            promised = J @ step
            settled = damping == 0.0 and float(promised @ promised) < STEP_TOLERANCE**2
            shorter = 1.0
            if not settled:
                e_trial, J_trial = self._look(R, p, q + step, covariates, phase)
                shorter = float(e_trial @ e_trial) / size
            if shorter < 1.0:
                q, e, J = q + step, e_trial, J_trial
                damping = 0.0 if damping < FIRST_DAMPING else damping / 10
                if phase is not Phase.FAR and shorter * size < STEP_TOLERANCE**2:
                    break
                if phase is not Phase.STUCK or shorter < 1.0 - LEAST_PROGRESS:
                    continue
            exhausted = settled or damping > LAST_DAMPING
            if phase is Phase.STUCK and (exhausted or shorter < 1.0):
                break
            if phase is Phase.NEAR and settled and lean:
                break
            if phase is Phase.NEAR or exhausted:  # FAR: out of reach; NEAR: close to a singularity
                phase, damping = Phase.NEAR if phase is Phase.FAR else Phase.STUCK, 0.0
                e, J = self._look(R, p, q, covariates, phase)
            else:
                damping = max(10 * damping, FIRST_DAMPING)
        position = float(np.linalg.norm(e[:3]))
        rotation = float(np.linalg.norm(e[3:])) / self.lever
        allowed = [MOST_UNAVOIDABLE if lean else max(sigma, FINEST_NOISE) for sigma in self.noise]
        reached = phase is not Phase.FAR and position < allowed[0] and (rotation < allowed[1] or not self.pose)
        return Command(q, position, rotation if self.pose else float("nan"), reached)

    def _look(
        self, R: np.ndarray, p: np.ndarray, q: np.ndarray, covariates: Mapping[str, float], phase: Phase
    ) -> tuple[np.ndarray, np.ndarray]:
        """The error and its Jacobian, with the effects as a phase of the search sees them; see :meth:`error`."""
        e, J = self.error(R, p, q, None if phase is Phase.FAR else covariates)
        if phase is Phase.STUCK:
            errors = [self.error(R, p, q + column, covariates)[0] for column in MARGIN_DIFFERENCE * np.eye(len(q))]
            J = np.asarray((e - np.array(errors)).T / MARGIN_DIFFERENCE)
        return e, J

    def error(
        self, R: np.ndarray, p: np.ndarray, q: np.ndarray, covariates: Mapping[str, float] | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """How far a pose is, and how the readings bring it nearer while the effects stay as they are.

        Args:
            R: Wanted rotation, shape (3, 3).
            p: Wanted position, shape (3,), [m].
            q: Readings, shape (columns,), [rad] or [m].
            covariates: Value of each of ``model.needs``; None: no effect acts.

        Returns:
            Position, then rotation vector times ``lever``, in world axes, shape (6,) or (3,), [m]; and the Jacobian of
            what the readings take from it, shape (6, columns) or (3, columns).
        """
        model = self.model
        rotation, at, J = model.jacobian(q, model.still if covariates is None else model.effects(q, covariates))
        if not self.pose:
            return p - at, J[:3]
        e = np.empty(6)
        e[:3] = p - at
        e[3:] = self.lever * pin.log3(R @ rotation.T)
        J[3:] *= self.lever
        return e, J

    def _step(self, J: np.ndarray, e: np.ndarray, q: np.ndarray, damping: float) -> np.ndarray:
        """Newton's step, or the least-squares one, inside the limits."""
        step = np.zeros(len(q))
        step[self._moving] = _solve(J[:, self._moving], e, damping)
        fastest = max(np.abs(step[self.turning]), default=0.0)
        shorter = LARGEST_NEWTON_TURN / fastest if fastest > LARGEST_NEWTON_TURN else 1.0
        trial = q + shorter * step
        inside = np.minimum(np.maximum(trial, self.low), self.high)
        stopped = inside != trial
        while stopped.any():
            step = (inside - q) / shorter
            free = ~stopped & self.model.moves
            if not free.any():
                break
            step[free] = _solve(J[:, free], e - J[:, stopped] @ step[stopped], damping)
            trial = q + shorter * step
            inside = np.minimum(np.maximum(trial, self.low), self.high)
            if not (inside != trial)[free].any():
                break
            stopped |= inside != trial
        return inside - q


def _solve(J: np.ndarray, e: np.ndarray, damping: float) -> np.ndarray:
    r"""Solve J step = e: the shortest step where there are many, least squares where there is none.

    .. math:: s = J^T (J J^T + \lambda)^{-1} e \quad \text{or} \quad s = (J^T J + \lambda)^{-1} J^T e
    """
    rows, columns = J.shape
    if columns < rows:
        H = J.T @ J
        H.flat[:: columns + 1] += damping + SINGULAR_DAMPING
        return np.asarray(dposv(H, J.T @ e)[1])
    H = J @ J.T
    H.flat[:: rows + 1] += damping + SINGULAR_DAMPING
    return np.asarray(J.T @ dposv(H, e)[1])
