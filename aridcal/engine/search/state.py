"""A set of effects solved in the linearised model, from sums of products that are kept."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import block_diag

from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.smooth import samples_root
from aridcal.engine.fit.flags import flagged
from aridcal.engine.fit.normal_equations import NormalEquations, accumulate, conditional
from aridcal.engine.fit.normal_equations import solve as solve_equations
from aridcal.engine.instruments.channels import Channels, flat, spread
from aridcal.engine.numerics import RIDGE, ROUNDS
from aridcal.engine.search.evidence import Score, Solution, noise_left, solve
from aridcal.engine.search.linear_model import Active, LinearModel
from aridcal.engine.search.products import Chunk, Member, Products

FAINT = 0.02
"""Work: A mode that the data could move by less than this share of its prior is left out: nothing would be learnt of it."""

T = TypeVar("T")


@dataclass(frozen=True)
class State:
    """A solved set of effects: the constants and P - K modes of effects, n rows in use.

    Attributes:
        model: The linearised model.
        active: The effects.
        precision: Of the prior of all that is solved for, shape (P, P).
        equations: Sums over the rows in use.
        solution: Their solution.
        residual: What is left of every row, shape (N, m).
        used: Rows in use: those that are no outliers, shape (N,) bool.
        unused: The other rows' places in the order of the folds, shape (N - n,).
        extra: Columns of these, one array for each channel, shape ((N - n) size, P).
        scored: Rough scores of candidates that were asked for so far.
        answers: What else was asked for so far.
    """

    model: LinearModel
    active: tuple[Active, ...]
    precision: np.ndarray
    equations: NormalEquations
    solution: Solution
    residual: np.ndarray
    used: np.ndarray
    unused: np.ndarray
    extra: tuple[np.ndarray, ...]
    scored: dict[Effect, Score] = field(default_factory=dict, init=False, repr=False, compare=False)
    answers: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def once(self, question: Hashable, answer: Callable[[], T]) -> T:
        """What was found of it: who asks again gets the same."""
        if question not in self.answers:
            self.answers[question] = answer()
        found: T = self.answers[question]
        return found

    @property
    def channels(self) -> Channels:
        """What each row measures."""
        return self.model.channels

    @property
    def fold(self) -> np.ndarray:
        """Fold of each row in use, shape (n,)."""
        return self.model.fold[self.used]

    @property
    def present(self) -> np.ndarray:
        """Which channels each row in use measures, shape (n, C) bool."""
        return self.model.present[self.used]

    @cached_property
    def design(self) -> tuple[np.ndarray, ...]:
        """Columns of the rows in use, one array for each channel, shape (n size, P)."""
        return self.flat(np.concatenate([self.model.A, *(a.columns(self.model) for a in self.active)], axis=2))

    @cached_property
    def right(self) -> tuple[np.ndarray, ...]:
        """Their residuals likewise, shape (n size,)."""
        return self.flat(self.model.r)

    @cached_property
    def right_of_unused(self) -> list[np.ndarray]:
        """Residuals of the rows not in use, shape ((N - n) size,) for each channel."""
        made = self.model.products
        return [r[rows] for r, rows in zip(made.r, made.layout.numbers(self.unused), strict=True)]

    @cached_property
    def of_folds(self) -> tuple[np.ndarray, np.ndarray]:
        """A'A and A'r over the rows in use of each of F folds, shape (F, C, P, P) and (F, C, P)."""
        AA, Ar = _assembled(self.model.products, self.members, together=False)
        AA -= self.unused_products(self.extra, self.extra)
        Ar -= self.unused_products(self.extra, self.right_of_unused)
        return AA, Ar

    def unused_products(self, X: Sequence[np.ndarray], Y: Sequence[np.ndarray]) -> np.ndarray:
        """X'Y over the rows not in use of each of F folds, shape (F, C, ...), from arrays of these rows for each channel."""
        made = []
        for low, high in pairwise(np.searchsorted(self.unused, self.model.products.layout.starts).tolist()):
            own = [slice(low * channel.size, high * channel.size) for channel in self.channels]
            made.append([x[rows].T @ y[rows] for x, y, rows in zip(X, Y, own, strict=True)])
        return np.array(made)

    @property
    def members(self) -> tuple[Member, ...]:
        """What stands in the design: the constants, then the effects."""
        return members(self.model, self.active)

    @property
    def places(self) -> list[slice]:
        """Where each of them is in what is solved for."""
        return _places([modes.shape[1] for _, modes in self.members])

    def in_modes(self, blocks: Sequence[np.ndarray]) -> np.ndarray:
        """Products with the coefficients of all members, (..., w, d) each, as products with what is solved for, (..., w, P)."""
        first, *others = blocks
        return np.concatenate([first, *(b @ a.modes for b, a in zip(others, self.active, strict=True))], axis=-1)

    def fitted_by_place(
        self, beta: np.ndarray, low: int, high: int, candidate: Active | None = None
    ) -> list[np.ndarray]:
        """What L solutions make of rows at some places of the folds' order, ((high - low) size, L) for each channel.

        Args:
            beta: Shape (P, L), or (P + d, L) with a candidate.
            low: The first place.
            high: One beyond the last.
            candidate: What is added.
        """
        made = self.model.products
        every = members(self.model, self.active if candidate is None else (*self.active, candidate))
        numbers = [slice(low * channel.size, high * channel.size) for channel in self.channels]
        fitted = [np.zeros((own.stop - own.start, beta.shape[1])) for own in numbers]
        for (effect, modes), place in zip(every, _places([modes.shape[1] for _, modes in every]), strict=True):
            taken = modes @ beta[place]
            for values, x, own in zip(fitted, made.columns(effect), numbers, strict=True):
                values += x[own] @ taken
        return fitted

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects alone."""
        return tuple(a.effect for a in self.active)

    def with_active(self, active: Sequence[Active], sigma: np.ndarray | None = None, fixed: bool = False) -> State:
        """Another set of effects in the same model, from the rows and the noise of this one; see :func:`solve_state`."""
        return solve_state(self.model, active, self.solution.sigma if sigma is None else sigma, self.used, fixed)

    def coefficients(self, constants: Sequence[Coefficient]) -> dict[Coefficient, float]:
        """The solution by its coefficients, the K constants first."""
        first, *others = self.places
        values = dict(zip(constants, self.solution.beta[first].tolist(), strict=True))
        for a, own in zip(self.active, others, strict=True):
            values |= dict(zip(a.effect.coefficients, (a.modes @ self.solution.beta[own]).tolist(), strict=True))
        return values

    @property
    def sigma(self) -> np.ndarray:
        """Noise of each number of a row, shape (m,)."""
        return spread(self.solution.sigma, self.channels)

    def flat(self, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Columns (N, m, d) or residuals (N, m) brought to the design's shape: rows in use, channel by channel."""
        return flat(values[self.used], self.channels, self.present)

    def whitened(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Arrays of the design's shape in sigmas, all channels under one another."""
        return np.concatenate([part / sigma for part, sigma in zip(values, self.solution.sigma, strict=True)])

    def in_use(self, chunk: Chunk, where: slice | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums of candidates' columns over the rows in use.

        Args:
            chunk: The candidates.
            where: Columns of one of them; all of the chunk's otherwise.

        Returns:
            Products with what is solved for, shape (C, P, w), with one another, (C, w, w), and with the residual, (C, w).
            All candidates of a grid have products with themselves alone, (C, candidates, d, d).
        """
        made = self.model.products
        some = slice(None) if where is None else where
        cross = self.in_modes([values[:, some] for values in made.across(chunk, self.members)])
        own, pull = chunk.own if where is None else chunk.of_one(where), chunk.pull[:, some]
        if len(self.unused):
            lost = [x[:, some] for x in made.rows_of(chunk, self.unused)]
            cross = cross - np.array([x.T @ a for x, a in zip(lost, self.extra, strict=True)])
            each = [x.reshape(len(x), -1, own.shape[-1]).transpose(1, 2, 0) for x in lost]
            own = own - np.array([x @ x.transpose(0, 2, 1) for x in each]).reshape(own.shape)
            pull = pull - np.array([x.T @ r for x, r in zip(lost, self.right_of_unused, strict=True)])
        return np.swapaxes(cross, 1, 2), own, pull


def members(model: LinearModel, active: Sequence[Active]) -> tuple[Member, ...]:
    """What stands in the design of some effects: the constants, then these."""
    return (model.products.constants, *((a.effect, a.modes) for a in active))


def solve_state(
    model: LinearModel, active: Sequence[Active], sigma: np.ndarray, used: np.ndarray, fixed: bool = False
) -> State:
    """Solve a set of effects, noise and outlier flags with it.

    Args:
        model: The linearised model.
        active: Effects.
        sigma: Noise to begin with, shape (C,).
        used: Rows to begin with, shape (N,) bool.
        fixed: Keep to these rows: what is compared with another model must be solved on the same ones.
    """
    model.products.now_in_the_model(members(model, active))
    every = _of_all_rows(model, active)
    precision = block_diag(model.gauge, *(a.precision for a in active))
    sound = used
    for _ in range(ROUNDS):
        used = sound
        unused, extra, equations = _in_use(model, active, every, used)
        solution = solve(equations, precision, sigma)
        residual = _left(model, active, solution.beta)
        sigma = solution.sigma
        sound = ~flagged(model.holed(residual), model.channels, model.limit)
        if fixed or np.array_equal(sound, used):
            break
    return State(model, tuple(active), precision, equations, solution, residual, used, unused, extra)


def _of_all_rows(model: LinearModel, active: Sequence[Active]) -> NormalEquations:
    """Sums of a set of effects over all rows, whether in use or not."""
    made = model.products
    AA, Ar = _assembled(made, members(model, active), together=True)
    sizes = np.array([channel.size for channel in model.channels])
    return NormalEquations(AA, Ar, made.squares.sum(axis=0), model.present.sum(axis=0) * sizes)


def _in_use(
    model: LinearModel, active: Sequence[Active], every: NormalEquations, used: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...], NormalEquations]:
    """Places and columns of the rows that are not used, and the sums without them."""
    made, layout = model.products, model.products.layout
    unused = np.flatnonzero(~used[layout.order])
    extra = columns_at(model, members(model, active), unused)
    right = [r[own] for r, own in zip(made.r, layout.numbers(unused), strict=True)]
    sizes = np.array([channel.size for channel in model.channels])
    there = model.present[layout.order[unused]].sum(axis=0) * sizes
    equations = every.minus(replace(accumulate(extra, right), count=there)) if len(unused) else every
    count = np.maximum(model.share * equations.count - model.taken, 1.0)
    return unused, extra, replace(equations, count=count)


def columns_at(model: LinearModel, every: Sequence[Member], places: np.ndarray) -> tuple[np.ndarray, ...]:
    """What is solved for, in rows at some places of the folds' order: shape (rows size, P) for each channel."""
    made, numbers = model.products, model.products.layout.numbers(places)
    parts = [[x[own] @ modes for x, own in zip(made.columns(effect), numbers, strict=True)] for effect, modes in every]
    return tuple(np.hstack(part) for part in zip(*parts, strict=True))


def _places(sizes: Sequence[int]) -> list[slice]:
    """Where members of so many unknowns each are, one after the other."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(low, high) for low, high in pairwise(ends)]


def _assembled(made: Products, every: Sequence[Member], together: bool) -> tuple[np.ndarray, np.ndarray]:
    """A'A and A'r of all rows: of the folds together, (C, P, P) and (C, P), or of each of F, (F, C, P, P) and (F, C, P)."""

    def summed(of_folds: np.ndarray) -> np.ndarray:
        return np.asarray(of_folds.sum(axis=0)) if together else of_folds

    Ar = np.concatenate([summed(made.pull(effect)) @ modes for effect, modes in every], axis=-1)
    AA = np.empty((*Ar.shape, Ar.shape[-1]))
    for k, own in enumerate(_places([modes.shape[1] for _, modes in every])):
        row = summed(np.concatenate([made.in_modes(every[k], other) for other in every[: k + 1]], axis=-1))
        AA[..., own, : own.stop] = row
        AA[..., : own.stop, own] = np.swapaxes(row, -1, -2)
    return AA, Ar


def by_fold(state: State, candidate: Active, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H of shape (F, P + d, P + d) and g of (F, P + d): sums over the rows in use of each fold, with a candidate added."""
    model, made = state.model, state.model.products
    AA, Ar = state.of_folds
    mine = candidate.effect, candidate.modes
    extra = columns_at(model, [mine], state.unused)
    cross = np.concatenate([made.in_modes(member, mine) for member in state.members], axis=2)
    cross -= state.unused_products(state.extra, extra)
    own = made.in_modes(mine, mine) - state.unused_products(extra, extra)
    pull = made.pull(mine[0]) @ mine[1] - state.unused_products(extra, state.right_of_unused)
    P, weight = AA.shape[-1], sigma**-2.0
    H = np.empty((len(AA), P + cross.shape[-1], P + cross.shape[-1]))
    H[:, :P, :P] = np.einsum("c,fcij->fij", weight, AA)
    H[:, :P, P:] = np.einsum("c,fcij->fij", weight, cross)
    H[:, P:, :P] = H[:, :P, P:].transpose(0, 2, 1)
    H[:, P:, P:] = np.einsum("c,fcij->fij", weight, own)
    return H, np.einsum("c,fci->fi", weight, np.concatenate([Ar, pull], axis=2))


def without_effect(state: State, effect: Effect) -> State:
    r"""The model without one of its effects, solved on the same rows.

    The noise to begin with is the one that the coefficients leave without it at the noise that they had with it, which needs no
    equations solved: with G its unknowns, V the inverse of all, and A_c the sums of a channel,

    .. math:: V_{-G} = V - V_{:G} V_{GG}^{-1} V_{G:}, \qquad
              \operatorname{tr} V_{-G} A_c = \operatorname{tr} V A_c - \operatorname{tr} V_{GG}^{-1} V_{G:} A_c V_{:G}
    """
    V, before, equations = state.solution.inverse, state.solution, state.equations
    gone = np.zeros(len(V), dtype=bool)
    for a, own in zip(state.active, state.places[1:], strict=True):
        gone[own] = a.effect == effect
    out = V[:, gone]
    fewer = np.einsum("ij,cij->c", solve_equations(out[gone], out.T, ridge=RIDGE).T, equations.AA @ out)
    left = equations.squares_left(conditional(V, before.beta, gone))
    sigma = noise_left(equations, left, before.spent - fewer / before.sigma**2)
    return state.with_active([a for a in state.active if a.effect != effect], sigma, fixed=True)


def _left(model: LinearModel, active: Sequence[Active], beta: np.ndarray) -> np.ndarray:
    """What a solution leaves of every row, shape (N, m)."""
    K = model.A.shape[2]
    left = model.r - model.A @ beta[:K]
    for a, own in zip(active, _places([K, *(a.modes.shape[1] for a in active)])[1:], strict=True):
        left -= model.seen(model.made_of(a.effect, a.modes @ beta[own])[:, :, None])[:, :, 0]
    return np.asarray(left)


def activate(state: State, effect: Effect, found: Score) -> Active:
    """Make a candidate ready to be solved for: of a smooth one, the modes of which the data say something."""
    if not effect.smooth:
        return Active(effect, found, np.eye(len(effect.coefficients)), prior=state.model.prior_of(effect))
    chunk, own = state.model.products.chunk_of(effect)
    gram = np.tensordot(noise_with(state, found) ** -2.0, chunk.of_one(own), 1)
    root = found.tau * samples_root(effect.shape, found.kernel)
    told, modes = np.linalg.eigh(root.T @ gram @ root)
    return Active(effect, found, root @ modes[:, told > FAINT])


def noise_with(state: State, found: Score) -> np.ndarray:
    """What is known of the noise with a candidate in the model, shape (C,)."""
    return state.solution.sigma if found.sigma is None else found.sigma


def with_candidate(state: State, candidate: Active) -> tuple[NormalEquations, np.ndarray]:
    """Equations of the model with a candidate added, and the prior precision of all its coefficients."""
    return with_columns(state, candidate.effect).combined(candidate.modes), block_diag(
        state.precision, candidate.precision
    )


def with_columns(state: State, effect: Effect) -> NormalEquations:
    """Equations of the model with the columns of an effect's coefficients added."""
    made = state.model.products
    made.now_in_the_model(state.members)
    return state.equations.bordered(*state.in_use(*made.chunk_of(effect)))
