"""A few steps of least squares over a target and the things around the arm, the arm being nominal: makes starts comparable."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.instruments.kind import Kind

FIRST_DAMPING = 1e-3
LEAST_DAMPING = 1e-12
MOST_DAMPING = 1e8
"""Marquardt's, as shares of the equations' own diagonal."""

ENOUGH = 1e-9
"""Relative gain of a step after which no further is tried."""


@dataclass(frozen=True)
class View:
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

    kind: Kind
    R: np.ndarray
    p: np.ndarray
    observed: np.ndarray
    refers: np.ndarray
    free: dict[str, np.ndarray]
    moves: bool

    def __len__(self) -> int:
        return len(self.p)

    def select(self, some: np.ndarray) -> View:
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
        whole = np.ones(len(self), dtype=bool)
        for state in self.of_rows(states):
            whole &= np.isfinite(state).all(axis=1)
        return whole


@dataclass(frozen=True)
class Place:
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


def placed(view: View, target: np.ndarray, states: dict[str, np.ndarray]) -> Place:
    """A place with its cost."""
    whole = view.complete(states)
    if not whole.any():
        return Place(target, states, np.inf)
    some = view.select(whole)
    residual = view.kind.residual(*some.target(target), some.observed, some.of_rows(states))
    return Place(target, states, float(np.mean(residual**2)))


def descend(view: View, start: Place, steps: int) -> Place:
    """Levenberg and Marquardt's steps from a start; rows without all their states are left out, and their things stay."""
    whole = view.complete(start.states)
    if not whole.any() or not np.isfinite(start.cost):
        return start
    view = view if whole.all() else view.select(whole)
    here, damping = placed(view, start.target, start.states), FIRST_DAMPING
    equations = _equations(view, here)
    for _ in range(steps):
        there = _stepped(view, here, equations, damping)
        if there.cost < here.cost:
            enough = there.cost > (1.0 - ENOUGH) * here.cost
            here, damping = there, max(0.1 * damping, LEAST_DAMPING)
            if enough:
                break
            equations = _equations(view, here)
        else:
            damping *= 10.0
            if damping > MOST_DAMPING:
                break
    return here


def _layout(view: View) -> tuple[list[int], int]:
    """First dense column of each role's things, and the number of columns; the target's translation takes the first three."""
    first, count = [], 3
    for role in view.kind.roles:
        first.append(count)
        count += 0 if role.many else len(role.components) * len(view.free[role.name])
    return first, count


def _equations(view: View, place: Place) -> _Equations:
    """Accumulate the normal equations at a place."""
    kind, n = view.kind, len(view)
    seen = kind.derivatives(*view.target(place.target), view.observed, view.of_rows(place.states))
    first, count = _layout(view)
    J = np.zeros((n, count, seen.residual.shape[1]))
    if view.moves:
        J[:, :3] = np.swapaxes(seen.by_twist[:, :, :3] @ view.R, 1, 2)
    B, C, h = np.zeros((0, 0, 0)), np.zeros((0, 0, count)), np.zeros((0, 0))
    for j, role in enumerate(kind.roles):
        own, free = view.refers[:, j], view.free[role.name]
        L, u = free.shape
        across = np.swapaxes(seen.by_state[j] * free[own][:, None], 1, 2)
        if not role.many:
            J[np.arange(n)[:, None], first[j] + u * own[:, None] + np.arange(u)] = across
        else:  # the last one: J is complete
            B, C, h = np.zeros((L, u, u)), np.zeros((L, u, count)), np.zeros((L, u))
            np.add.at(B, own, across @ np.swapaxes(across, 1, 2))
            np.add.at(C, own, across @ np.swapaxes(J, 1, 2))
            np.add.at(h, own, (across @ seen.residual[:, :, None])[:, :, 0])
    flat = np.swapaxes(J, 1, 2).reshape(-1, count)
    return _Equations(flat.T @ flat, flat.T @ seen.residual.ravel(), B, C, h)


def _stepped(view: View, here: Place, e: _Equations, damping: float) -> Place:
    """One damped step: the blocks eliminated, the dense unknowns solved, the blocks filled in."""
    B, A = _damped(e.B, damping), _damped(e.A[None], damping)[0]
    solved = np.linalg.solve(B, np.concatenate([e.C, e.h[:, :, None]], axis=2))
    per_dense, alone = solved[:, :, :-1], solved[:, :, -1]
    reduced = A - np.einsum("lud,lue->de", e.C, per_dense)
    right = e.g - np.einsum("lud,lu->d", e.C, alone)
    dense = np.linalg.lstsq(reduced, right, rcond=None)[0]
    blocks = alone - per_dense @ dense
    target = here.target.copy()
    target[:3, 3] += dense[:3]
    states, (first, _) = dict(here.states), _layout(view)
    for j, role in enumerate(view.kind.roles):
        u, state = len(role.components), here.states[role.name]
        change = blocks if role.many else dense[first[j] : first[j] + u * len(state)].reshape(len(state), u)
        known = np.isfinite(state).all(axis=1) & view.free[role.name].any(axis=1)
        states[role.name] = state.copy()
        states[role.name][known] = role.moved(state[known], change[known])
    return placed(view, target, states)


def _damped(matrices: np.ndarray, damping: float) -> np.ndarray:
    """Matrices with their diagonals raised; what nothing moves is held."""
    diagonal = np.einsum("lii->li", matrices)
    raised = np.where(diagonal > 0.0, (1.0 + damping) * diagonal, 1.0)
    made = matrices.copy()
    np.einsum("lii->li", made)[...] = raised
    return made


def spread(count: int, most: int) -> np.ndarray:
    """Numbers of at most so many rows, drawn evenly, in order; always the same. A stride would meet one marker of every image."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def located(
    view: View, target: np.ndarray, states: dict[str, np.ndarray], labels: np.ndarray, known: np.ndarray
) -> dict[str, np.ndarray]:
    """States with some things of the last role where their own rows have them; components that are not free stay."""
    kind = view.kind
    role, own = kind.roles[-1], view.refers[:, -1]
    assert kind.located is not None
    made = states[role.name].copy()
    order = np.argsort(own, kind="stable")
    bounds = np.searchsorted(own[order], np.arange(len(made) + 1))
    R, p = view.target(target)
    of_rows = view.of_rows({**states, role.name: known})
    for label in labels:
        rows = order[bounds[label] : bounds[label + 1]]
        if len(rows):
            found = kind.located(R[rows], p[rows], view.observed[rows], [state[rows] for state in of_rows])
            made[label] = _kept(found, known[label], view.free[role.name][label])
    return {**states, role.name: made}


def _kept(found: np.ndarray, known: np.ndarray, free: np.ndarray) -> np.ndarray:
    """What was found, with the numbers that are known and not free; of a plane or a pose all are free, or none."""
    own = free if len(free) == len(found) else np.full(len(found), free.any())
    return np.where(~own & np.isfinite(known), known, found)
