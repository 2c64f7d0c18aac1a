"""A few steps of least squares over a target and the things around the arm, the arm being nominal: makes starts comparable."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.instruments.kind import MeasurementKind

FIRST_DAMPING = 1e-3
LEAST_DAMPING = 1e-12
MOST_DAMPING = 1e8
"""Marquardt's, as shares of the equations' own diagonal."""

LEAST_GAIN = 1e-9
"""Relative gain of a step after which no further is tried."""


@dataclass(frozen=True)
class StartView:
    """Rows of one kind as starts see them: the tip nominal, in the robot's base frame.

    Attributes:
        kind: Of the rows.
        R: Rotations of the tip, shape (n, 3, 3).
        p: Its positions, shape (n, 3), [m].
        observed: What was read, shape (n, W).
        refers: Things of each role, numbers, shape (n, roles).
        free: Which components of each thing may move, (L, u) by role.
        moves: True if the target's translation may.
    """

    kind: MeasurementKind
    R: np.ndarray
    p: np.ndarray
    observed: np.ndarray
    refers: np.ndarray
    free: dict[str, np.ndarray]
    moves: bool

    def __len__(self) -> int:
        return len(self.p)

    def select(self, some: np.ndarray) -> StartView:
        """Some of the rows."""
        return replace(self, R=self.R[some], p=self.p[some], observed=self.observed[some], refers=self.refers[some])

    def target(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations and positions of the target in the base frame, from T_tip_target."""
        return self.R @ target[:3, :3], self.p + self.R @ target[:3, 3]

    def of_rows(self, states: dict[str, np.ndarray]) -> list[np.ndarray]:
        """States of what each row refers to, one array (n, P) for each role."""
        return [states[role.name][self.refers[:, j]] for j, role in enumerate(self.kind.roles)]

    def complete(self, states: dict[str, np.ndarray]) -> np.ndarray:
        """Rows of which everything has a state, shape (n,) bool."""
        complete = np.ones(len(self), dtype=bool)
        for state in self.of_rows(states):
            complete &= np.isfinite(state).all(axis=1)
        return complete


@dataclass(frozen=True)
class DescentPoint:
    """Where a descent stands, and a fit may begin.

    Attributes:
        target: T_tip_target, shape (4, 4).
        states: Of all things, (L, P) by role.
        cost: Mean square of the residual's numbers over the rows that have everything; infinite without any, or if nobody asks.
    """

    target: np.ndarray
    states: dict[str, np.ndarray]
    cost: float = np.inf


@dataclass(frozen=True)
class _Equations:
    """Normal equations: dense unknowns, and blocks of the things of the last role that only meet those.

    Attributes:
        A: Of the dense unknowns, shape (D, D).
        g: Their right side, shape (D,).
        B: Of each block, shape (L, u, u).
        C: Between a block and the dense unknowns, shape (L, u, D).
        h: The blocks' right sides, shape (L, u).
    """

    A: np.ndarray
    g: np.ndarray
    B: np.ndarray
    C: np.ndarray
    h: np.ndarray


def descent_point(view: StartView, target: np.ndarray, states: dict[str, np.ndarray]) -> DescentPoint:
    """A place with its cost."""
    complete = view.complete(states)
    if not complete.any():
        return DescentPoint(target, states, np.inf)
    some = view.select(complete)
    residual = view.kind.residual(*some.target(target), some.observed, some.of_rows(states))
    return DescentPoint(target, states, float(np.mean(residual**2)))


def descend(view: StartView, start: DescentPoint, steps: int) -> DescentPoint:
    """Levenberg and Marquardt's steps from a start; rows without all their states are left out, and their things stay."""
    complete = view.complete(start.states)
    if not complete.any() or not np.isfinite(start.cost):
        return start
    view = view if complete.all() else view.select(complete)
    place, damping = descent_point(view, start.target, start.states), FIRST_DAMPING
    equations = _equations(view, place)
    for _ in range(steps):
        trial = _step(view, place, equations, damping)
        if trial.cost < place.cost:
            converged = trial.cost > (1.0 - LEAST_GAIN) * place.cost
            place, damping = trial, max(0.1 * damping, LEAST_DAMPING)
            if converged:
                break
            equations = _equations(view, place)
        else:
            damping *= 10.0
            if damping > MOST_DAMPING:
                break
    return place


def _layout(view: StartView) -> tuple[list[int], int]:
    """First dense column of each role's things, and the number of columns; the target's translation takes the first three."""
    first, count = [], 3
    for role in view.kind.roles:
        first.append(count)
        count += 0 if role.many else len(role.components) * len(view.free[role.name])
    return first, count


def _equations(view: StartView, place: DescentPoint) -> _Equations:
    """Accumulate the normal equations at a place."""
    kind, n = view.kind, len(view)
    derivatives = kind.derivatives(*view.target(place.target), view.observed, view.of_rows(place.states))
    first, count = _layout(view)
    J = np.zeros((n, count, derivatives.residual.shape[1]))
    if view.moves:
        J[:, :3] = np.swapaxes(derivatives.by_twist[:, :, :3] @ view.R, 1, 2)
    B, C, h = np.zeros((0, 0, 0)), np.zeros((0, 0, count)), np.zeros((0, 0))
    for j, role in enumerate(kind.roles):
        thing, free = view.refers[:, j], view.free[role.name]
        L, u = free.shape
        across = np.swapaxes(derivatives.by_state[j] * free[thing][:, None], 1, 2)
        if not role.many:
            J[np.arange(n)[:, None], first[j] + u * thing[:, None] + np.arange(u)] = across
        else:  # the last one: J is complete
            B, C, h = np.zeros((L, u, u)), np.zeros((L, u, count)), np.zeros((L, u))
            np.add.at(B, thing, across @ np.swapaxes(across, 1, 2))
            np.add.at(C, thing, across @ np.swapaxes(J, 1, 2))
            np.add.at(h, thing, (across @ derivatives.residual[:, :, None])[:, :, 0])
    flat = np.swapaxes(J, 1, 2).reshape(-1, count)
    return _Equations(flat.T @ flat, flat.T @ derivatives.residual.ravel(), B, C, h)


def _step(view: StartView, place: DescentPoint, e: _Equations, damping: float) -> DescentPoint:
    """One damped step: the blocks eliminated, the dense unknowns solved, the blocks filled in."""
    B, A = _damped(e.B, damping), _damped(e.A[None], damping)[0]
    solved = np.linalg.solve(B, np.concatenate([e.C, e.h[:, :, None]], axis=2))
    per_dense, alone = solved[:, :, :-1], solved[:, :, -1]
    reduced = A - np.einsum("lud,lue->de", e.C, per_dense)
    right = e.g - np.einsum("lud,lu->d", e.C, alone)
    dense = np.linalg.lstsq(reduced, right, rcond=None)[0]
    blocks = alone - per_dense @ dense
    target = place.target.copy()
    target[:3, 3] += dense[:3]
    states, (first, _) = dict(place.states), _layout(view)
    for j, role in enumerate(view.kind.roles):
        u, state = len(role.components), place.states[role.name]
        change = blocks if role.many else dense[first[j] : first[j] + u * len(state)].reshape(len(state), u)
        movable = np.isfinite(state).all(axis=1) & view.free[role.name].any(axis=1)
        states[role.name] = state.copy()
        states[role.name][movable] = role.moved(state[movable], change[movable])
    return descent_point(view, target, states)


def _damped(matrices: np.ndarray, damping: float) -> np.ndarray:
    """Matrices with their diagonals raised; what nothing moves is held."""
    diagonal = np.einsum("lii->li", matrices)
    raised = np.where(diagonal > 0.0, (1.0 + damping) * diagonal, 1.0)
    raised_matrices = matrices.copy()
    np.einsum("lii->li", raised_matrices)[...] = raised
    return raised_matrices


def spread(count: int, most: int) -> np.ndarray:
    """Numbers of at most so many rows, drawn evenly, in order; always the same. A stride would meet one marker of every image."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def thing_states(
    view: StartView, target: np.ndarray, states: dict[str, np.ndarray], labels: np.ndarray, beforehand: np.ndarray
) -> dict[str, np.ndarray]:
    """States in which their own rows have located some things of the last role; components that are not free stay."""
    kind = view.kind
    role, thing = kind.roles[-1], view.refers[:, -1]
    assert kind.located is not None
    new = states[role.name].copy()
    order = np.argsort(thing, kind="stable")
    bounds = np.searchsorted(thing[order], np.arange(len(new) + 1))
    R, p = view.target(target)
    of_rows = view.of_rows({**states, role.name: beforehand})
    for label in labels:
        rows = order[bounds[label] : bounds[label + 1]]
        if len(rows):
            estimate = kind.located(R[rows], p[rows], view.observed[rows], [state[rows] for state in of_rows])
            new[label] = _with_exact(estimate, beforehand[label], view.free[role.name][label])
    return {**states, role.name: new}


def _with_exact(estimate: np.ndarray, beforehand: np.ndarray, free: np.ndarray) -> np.ndarray:
    """An estimate with the numbers that are known beforehand and not free; of a plane or a pose all are free, or none."""
    movable = free if len(free) == len(estimate) else np.full(len(estimate), free.any())
    return np.where(~movable & np.isfinite(beforehand), beforehand, estimate)
