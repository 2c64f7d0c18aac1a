"""A linearised model with everything that could be added to it, and what is added solved at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from aridcal.effects import Basis, Effect, evaluate
from aridcal.evidence import Score, Solution, Sums, extended, kernel_root, smooth_precision, solve, sums
from aridcal.residual import Sigma
from aridcal.solver import flag

FAINT = 0.02  # a mode that the data could move by less than this share of its prior is left out


@dataclass(frozen=True)
class Bench:
    """A linearised model and everything that could be added to it.

    Attributes:
        A: Columns of the constants, shape (N, m, K), in units of the rows' relative sigmas.
        gauge: Prior precision of the constants about the geometric stage, shape (K, K).
        G: Columns of the places where effects may act, shape (N, m, S).
        slots: (where, component) of each, S of them.
        phi: Values of the bases, shape (N, B).
        bases: The bases, B of them.
        r: Residual of the geometric stage, linearised, shape (N, m).
        suspect: Rows that repeat another's measurement although the joints moved.
        run: Number of the row's stretch of time, shape (N,).
        fold: Number of the row's fold for cross-validation, shape (N,).
        own: Names of the joints: covariates that are under the user's control.
        table: Covariates of the rows, shape (N,) each.
    """

    A: np.ndarray
    gauge: np.ndarray
    G: np.ndarray
    slots: tuple[tuple[str, str], ...]
    phi: np.ndarray
    bases: tuple[Basis, ...]
    r: np.ndarray
    suspect: np.ndarray
    run: np.ndarray
    fold: np.ndarray
    own: tuple[str, ...]
    table: Mapping[str, np.ndarray]

    @cached_property
    def _slot(self) -> dict[tuple[str, str], int]:
        return {slot: k for k, slot in enumerate(self.slots)}

    @cached_property
    def _basis(self) -> dict[Basis, int]:
        return {basis: k for k, basis in enumerate(self.bases)}

    def indices(self, effect: Effect) -> tuple[list[int], list[int]]:
        """Place and basis of each of an effect's coefficients."""
        slots = [self._slot[c.where, c.component] for c in effect.coefficients]
        return slots, [self._basis[c.basis] for c in effect.coefficients]

    def prepared(self, effect: Effect) -> bool:
        """True if all its bases are among ``bases``."""
        return all(c.basis in self._basis for c in effect.coefficients)

    def prepare(self, effects: Sequence[Effect]) -> Bench:
        """The same with the bases of further effects evaluated beforehand."""
        new = [b for b in dict.fromkeys(c.basis for e in effects for c in e.coefficients) if b not in self._basis]
        phi = [self.phi, *(evaluate(b, self.table)[:, None] for b in new)]
        return replace(self, bases=(*self.bases, *new), phi=np.hstack(phi))

    def moves(self, effect: Effect) -> bool:
        """True if each of its motions is seen at all: a turn of the target is not, where only positions are measured."""
        return all(bool(np.any(self.G[:, :, self._slot[c.where, c.component]])) for c in effect.coefficients)

    def columns(self, effect: Effect) -> np.ndarray:
        """Columns of an effect, shape (N, m, d)."""
        slots = [self._slot[c.where, c.component] for c in effect.coefficients]
        if self.prepared(effect):
            phi = self.phi[:, self.indices(effect)[1]]
        else:
            phi = np.column_stack([evaluate(c.basis, self.table) for c in effect.coefficients])
        return np.asarray(self.G[:, :, slots] * phi[:, None, :])


@dataclass(frozen=True)
class Active:
    """An effect that is in the model; a smooth one by the modes that its data can tell, each with unit prior.

    Attributes:
        effect: The effect.
        score: Its evidence, and its shape if it is smooth.
        modes: Coefficients of each mode, shape (d, modes); the coefficients themselves if it is not smooth.
    """

    effect: Effect
    score: Score
    modes: np.ndarray

    @property
    def precision(self) -> np.ndarray:
        """Prior precision of what is solved for."""
        return (1.0 if self.effect.smooth else 0.0) * np.eye(self.modes.shape[1])

    @property
    def coefficient_precision(self) -> np.ndarray:
        """Prior precision of its coefficients, shape (d, d)."""
        d = len(self.effect.coefficients)
        return (
            smooth_precision(self.effect.shape, self.score.tau, self.score.kernel)
            if self.effect.smooth
            else np.zeros((d, d))
        )

    @property
    def root(self) -> np.ndarray:
        """Combinations of its coefficients that are independent beforehand, shape (d, d)."""
        if not self.effect.smooth:
            return np.eye(len(self.effect.coefficients))
        return self.score.tau * kernel_root(self.effect.shape, self.score.kernel)

    def columns(self, bench: Bench) -> np.ndarray:
        """Its columns, shape (N, m, d or modes)."""
        return bench.columns(self.effect) @ self.modes


@dataclass(frozen=True)
class State:
    """A solved set of effects."""

    active: tuple[Active, ...]
    design: tuple[np.ndarray, ...]  # rows in use times root weight, positions and rotations apart, (3n, P) each
    right: tuple[np.ndarray, ...]
    precision: np.ndarray
    sums: Sums
    solution: Solution
    residual: np.ndarray
    weight: np.ndarray
    fold: np.ndarray

    def flat(self, columns: np.ndarray) -> list[np.ndarray]:
        """Columns (N, m, d) brought to the design's shape."""
        used = self.weight > 0.5
        return [
            columns[used, 3 * k : 3 * k + 3].reshape(3 * used.sum(), columns.shape[2])
            for k in range(self.residual.shape[1] // 3)
        ]


def solve_state(bench: Bench, active: Sequence[Active], sigma: Sigma, weight: np.ndarray) -> State:
    """Solve a set of effects, noise and outlier flags with it."""
    design = np.concatenate([bench.A, *(a.columns(bench) for a in active)], axis=2)
    precision = block_diag(bench.gauge, *(a.precision for a in active))
    flags = weight
    for _ in range(6):
        weight = flags
        used = weight > 0.5
        parts = range(bench.r.shape[1] // 3)
        A = tuple(design[used, 3 * k : 3 * k + 3].reshape(3 * used.sum(), design.shape[2]) for k in parts)
        b = tuple(bench.r[used, 3 * k : 3 * k + 3].ravel() for k in parts)
        gram = sums(A, b)
        solution = solve(gram, precision, sigma)
        residual = bench.r - design @ solution.beta
        sigma = solution.sigma
        flags = flag(residual, bench.suspect)
        if np.array_equal(flags, weight):
            break
    return State(tuple(active), A, b, precision, gram, solution, residual, weight, bench.fold[used])


def activate(bench: Bench, state: State, effect: Effect, found: Score) -> Active:
    """Make a candidate ready to be solved for."""
    if not effect.smooth:
        return Active(effect, found, np.eye(len(effect.coefficients)))
    root, noise = kernel_root(effect.shape, found.kernel), found.sigma or state.solution.sigma
    sigma = np.repeat([noise.position, noise.rotation], 3)[: bench.r.shape[1]]
    C = bench.columns(effect) / sigma[:, None]
    U, s, _ = np.linalg.svd(root * found.tau, full_matrices=False)
    seen = s**2 * float(np.einsum("nmd,nmd->", C, C)) / C.shape[2]
    return Active(effect, found, (U * s)[:, seen > FAINT])


def with_candidate(bench: Bench, state: State, candidate: Active) -> tuple[Sums, np.ndarray]:
    """Sums of the model with a candidate added, and the prior precision of all its coefficients."""
    C = state.flat(candidate.columns(bench))
    return extended(state.sums, state.design, C, state.right), block_diag(state.precision, candidate.precision)


def apart(values: np.ndarray) -> list[np.ndarray]:
    """Positions and rotations of an array (N, m, ...)."""
    return [values[:, 3 * k : 3 * k + 3] for k in range(values.shape[1] // 3)]
