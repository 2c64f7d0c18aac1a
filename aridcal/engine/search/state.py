"""A set of effects solved in the linearised model, from stored sums of products."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.smooth import samples_root
from aridcal.engine.fit.flags import outlier_rows
from aridcal.engine.fit.normal_equations import NormalEquations, accumulate, conditional
from aridcal.engine.fit.normal_equations import solve as solve_equations
from aridcal.engine.instruments.channels import Channels, flat, spread
from aridcal.engine.numerics import RIDGE, ROUNDS
from aridcal.engine.search.evidence import Score, Solution, noise_left, solve
from aridcal.engine.search.linear_model import ActiveEffect, LinearModel
from aridcal.engine.search.products import Chunk, Member, places_of

FAINT_MODE_SHARE = 0.02
"""Work: A mode that the data could move by less than this share of its prior is left out: nothing would be learnt of it."""


@dataclass(frozen=True, eq=False)
class State:
    """A solved set of effects: the constants and P - K modes of effects, n rows in use.

    What is worked out of it is kept by its model: :attr:`~aridcal.engine.search.linear_model.LinearModel.answers`.

    Attributes:
        model: The linearised model.
        active: The effects.
        precision: Of the prior of all unknowns, shape (P, P).
        equations: Sums over the rows in use.
        solution: Their solution.
        residual: Residual of every row, shape (N, m).
        used: Rows in use, those that are no outliers, shape (N,) bool.
        unused: The other rows' places in the order of the folds, shape (N - n,).
        extra: Columns of the other rows, one array for each channel, shape ((N - n) size, P).
    """

    model: LinearModel
    active: tuple[ActiveEffect, ...]
    precision: np.ndarray
    equations: NormalEquations
    solution: Solution
    residual: np.ndarray
    used: np.ndarray
    unused: np.ndarray
    extra: tuple[np.ndarray, ...]

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
        """Residuals of the rows in use, one array for each channel, shape (n size,)."""
        return self.flat(self.model.r)

    @cached_property
    def right_of_unused(self) -> list[np.ndarray]:
        """Residuals of the rows not in use, shape ((N - n) size,) for each channel."""
        products = self.model.products
        return [r[rows] for r, rows in zip(products.r, products.layout.numbers(self.unused), strict=True)]

    @cached_property
    def of_folds(self) -> tuple[np.ndarray, np.ndarray]:
        """A'A and A'r over the rows in use of each of F folds, shape (F, C, P, P) and (F, C, P)."""
        AA, Ar = self.model.products.sums(self.members, together=False)
        AA -= self.unused_products(self.extra, self.extra)
        Ar -= self.unused_products(self.extra, self.right_of_unused)
        return AA, Ar

    def unused_products(self, X: Sequence[np.ndarray], Y: Sequence[np.ndarray]) -> np.ndarray:
        """X'Y over the rows not in use of each of F folds, shape (F, C, ...), from arrays of these rows for each channel."""
        per_fold = []
        for low, high in pairwise(np.searchsorted(self.unused, self.model.products.layout.starts).tolist()):
            parts = [slice(low * channel.size, high * channel.size) for channel in self.channels]
            per_fold.append([x[rows].T @ y[rows] for x, y, rows in zip(X, Y, parts, strict=True)])
        return np.array(per_fold)

    @property
    def members(self) -> tuple[Member, ...]:
        """Members of the design: the constants, then the effects."""
        return members(self.model, self.active)

    @property
    def places(self) -> list[slice]:
        """Places of each member's unknowns among the P."""
        return places_of([modes.shape[1] for _, modes in self.members])

    def in_modes(self, blocks: Sequence[np.ndarray]) -> np.ndarray:
        """Products with the columns of each member's coefficients, (..., w, d), as products with all unknowns', (..., w, P)."""
        first, *others = blocks
        return np.concatenate([first, *(b @ a.modes for b, a in zip(others, self.active, strict=True))], axis=-1)

    def fitted_by_place(
        self, beta: np.ndarray, low: int, high: int, candidate: ActiveEffect | None = None
    ) -> list[np.ndarray]:
        """Values that L solutions give rows at some places of the folds' order, ((high - low) size, L) for each channel.

        Args:
            beta: Shape (P, L), or (P + d, L) with a candidate.
            low: The first place.
            high: One beyond the last.
            candidate: An effect added to the design.
        """
        products = self.model.products
        every = members(self.model, self.active if candidate is None else (*self.active, candidate))
        numbers = [slice(low * channel.size, high * channel.size) for channel in self.channels]
        fitted = [np.zeros((part.stop - part.start, beta.shape[1])) for part in numbers]
        for (effect, modes), place in zip(every, places_of([modes.shape[1] for _, modes in every]), strict=True):
            coefficients = modes @ beta[place]
            for values, x, part in zip(fitted, products.columns(effect), numbers, strict=True):
                values += x[part] @ coefficients
        return fitted

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects in the model."""
        return tuple(a.effect for a in self.active)

    def with_active(
        self, active: Sequence[ActiveEffect], sigma: np.ndarray | None = None, fixed: bool = False
    ) -> State:
        """Another set of effects in the same model, from the rows and the noise of this one; see :func:`solve_state`."""
        return solve_state(self.model, active, self.solution.sigma if sigma is None else sigma, self.used, fixed)

    def coefficients(self, constants: Sequence[Coefficient]) -> dict[Coefficient, float]:
        """The solution by its coefficients, the K constants first."""
        first, *others = self.places
        values = dict(zip(constants, self.solution.beta[first].tolist(), strict=True))
        for a, place in zip(self.active, others, strict=True):
            values |= dict(zip(a.effect.coefficients, (a.modes @ self.solution.beta[place]).tolist(), strict=True))
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
            Products with the unknowns' columns, shape (C, P, w), with one another, (C, w, w), and with the residual, (C, w).
            Of a grid's candidates each has its products with itself alone, (C, candidates, d, d).
        """
        products = self.model.products
        some = slice(None) if where is None else where
        cross = self.in_modes([values[:, some] for values in products.across(chunk, self.members)])
        gram, pull = chunk.gram if where is None else chunk.of_one(where), chunk.pull[:, some]
        if len(self.unused):
            unused_columns = [x[:, some] for x in products.rows_of(chunk, self.unused)]
            cross = cross - np.array([x.T @ a for x, a in zip(unused_columns, self.extra, strict=True)])
            each = [x.reshape(len(x), -1, gram.shape[-1]).transpose(1, 2, 0) for x in unused_columns]
            gram = gram - np.array([x @ x.transpose(0, 2, 1) for x in each]).reshape(gram.shape)
            pull = pull - np.array([x.T @ r for x, r in zip(unused_columns, self.right_of_unused, strict=True)])
        return np.swapaxes(cross, 1, 2), gram, pull


def members(model: LinearModel, active: Sequence[ActiveEffect]) -> tuple[Member, ...]:
    """Members of the design with some effects: the constants, then these."""
    return (model.products.constants, *((a.effect, a.modes) for a in active))


def solve_state(
    model: LinearModel, active: Sequence[ActiveEffect], sigma: np.ndarray, in_use: np.ndarray, fixed: bool = False
) -> State:
    """Solve a set of effects, noise and outlier flags with it.

    Args:
        model: The linearised model.
        active: Effects.
        sigma: Noise to begin with, shape (C,).
        in_use: Rows to begin with, shape (N,) bool.
        fixed: Keep to these rows: models that are compared must be solved on the same rows.
    """
    every = _of_all_rows(model, active)
    precision = block_diag(model.gauge, *(a.precision for a in active))
    sound = in_use
    for _ in range(ROUNDS):
        in_use = sound
        unused, extra, equations = _in_use(model, active, every, in_use)
        solution = solve(equations, precision, sigma)
        residual = _residual(model, active, solution.beta)
        sigma = solution.sigma
        sound = ~outlier_rows(model.holed(residual), model.channels, model.limit)
        if fixed or np.array_equal(sound, in_use):
            break
    return State(model, tuple(active), precision, equations, solution, residual, in_use, unused, extra)


def _of_all_rows(model: LinearModel, active: Sequence[ActiveEffect]) -> NormalEquations:
    """Sums of a set of effects over all rows, whether in use or not."""
    products = model.products
    AA, Ar = products.sums(members(model, active), together=True)
    sizes = np.array([channel.size for channel in model.channels])
    return NormalEquations(AA, Ar, products.squares.sum(axis=0), model.present.sum(axis=0) * sizes)


def _in_use(
    model: LinearModel, active: Sequence[ActiveEffect], every: NormalEquations, in_use: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...], NormalEquations]:
    """Places and columns of the rows not in use, and the sums without them."""
    products, layout = model.products, model.products.layout
    unused = np.flatnonzero(~in_use[layout.order])
    extra = columns_at(model, members(model, active), unused)
    right = [r[numbers] for r, numbers in zip(products.r, layout.numbers(unused), strict=True)]
    sizes = np.array([channel.size for channel in model.channels])
    there = model.present[layout.order[unused]].sum(axis=0) * sizes
    equations = every.minus(replace(accumulate(extra, right), count=there)) if len(unused) else every
    count = np.maximum(model.share * equations.count - model.taken_up, 1.0)
    return unused, extra, replace(equations, count=count)


def columns_at(model: LinearModel, every: Sequence[Member], places: np.ndarray) -> tuple[np.ndarray, ...]:
    """Columns of all unknowns in rows at some places of the folds' order, shape (rows size, P) for each channel."""
    products, numbers = model.products, model.products.layout.numbers(places)
    parts = [
        [x[rows] @ modes for x, rows in zip(products.columns(effect), numbers, strict=True)] for effect, modes in every
    ]
    return tuple(np.hstack(part) for part in zip(*parts, strict=True))


def by_fold(state: State, candidate: ActiveEffect, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H of shape (F, P + d, P + d) and g of (F, P + d): sums over the rows in use of each fold, with a candidate added."""
    model, products = state.model, state.model.products
    AA, Ar = state.of_folds
    extra_member = candidate.effect, candidate.modes
    extra = columns_at(model, [extra_member], state.unused)
    cross = np.concatenate([products.in_modes(member, extra_member) for member in state.members], axis=2)
    cross -= state.unused_products(state.extra, extra)
    gram = products.in_modes(extra_member, extra_member) - state.unused_products(extra, extra)
    pull = products.pull(extra_member[0]) @ extra_member[1] - state.unused_products(extra, state.right_of_unused)
    P, weight = AA.shape[-1], sigma**-2.0
    H = np.empty((len(AA), P + cross.shape[-1], P + cross.shape[-1]))
    H[:, :P, :P] = np.einsum("c,fcij->fij", weight, AA)
    H[:, :P, P:] = np.einsum("c,fcij->fij", weight, cross)
    H[:, P:, :P] = H[:, :P, P:].transpose(0, 2, 1)
    H[:, P:, P:] = np.einsum("c,fcij->fij", weight, gram)
    return H, np.einsum("c,fci->fi", weight, np.concatenate([Ar, pull], axis=2))


def without_effect(state: State, effect: Effect) -> State:
    r"""The model without one of its effects, solved on the same rows.

    The noise to begin with follows from the residuals without it, at the weights that the model had with it; no equations need
    be solved for it: with G its unknowns, V the inverse of all, and A_c the sums of a channel,

    .. math:: V_{-G} = V - V_{:G} V_{GG}^{-1} V_{G:}, \qquad
              \operatorname{tr} V_{-G} A_c = \operatorname{tr} V A_c - \operatorname{tr} V_{GG}^{-1} V_{G:} A_c V_{:G}
    """
    V, before, equations = state.solution.inverse, state.solution, state.equations
    gone = np.zeros(len(V), dtype=bool)
    for a, place in zip(state.active, state.places[1:], strict=True):
        gone[place] = a.effect == effect
    out = V[:, gone]
    fewer = np.einsum("ij,cij->c", solve_equations(out[gone], out.T, ridge=RIDGE).T, equations.AA @ out)
    squares = equations.squares_left(conditional(V, before.beta, gone))
    sigma = noise_left(equations, squares, before.spent - fewer / before.sigma**2)
    return state.with_active([a for a in state.active if a.effect != effect], sigma, fixed=True)


def _residual(model: LinearModel, active: Sequence[ActiveEffect], beta: np.ndarray) -> np.ndarray:
    """Residual of every row, shape (N, m), for coefficients beta."""
    K = model.A.shape[2]
    residual = model.r - model.A @ beta[:K]
    for a, place in zip(active, places_of([K, *(a.modes.shape[1] for a in active)])[1:], strict=True):
        residual -= model.seen(model.made_of(a.effect, a.modes @ beta[place])[:, :, None])[:, :, 0]
    return np.asarray(residual)


def activate(state: State, effect: Effect, score: Score) -> ActiveEffect:
    """A candidate with the unknowns to be solved for: those modes of a smooth one that the data determine."""
    if not effect.smooth:
        return ActiveEffect(effect, score, np.eye(len(effect.coefficients)), prior=state.model.prior_of(effect))
    chunk, columns = state.model.products.chunk_of(effect)
    gram = np.tensordot(noise_with(state, score) ** -2.0, chunk.of_one(columns), 1)
    root = score.tau * samples_root(effect.shape, score.kernel)
    information, modes = np.linalg.eigh(root.T @ gram @ root)
    return ActiveEffect(effect, score, root @ modes[:, information > FAINT_MODE_SHARE])


def noise_with(state: State, score: Score) -> np.ndarray:
    """Noise with a candidate in the model, as far as its score knows it, shape (C,)."""
    return state.solution.sigma if score.sigma is None else score.sigma


def with_candidate(state: State, candidate: ActiveEffect) -> tuple[NormalEquations, np.ndarray]:
    """Equations of the model with a candidate added, and the prior precision of all its coefficients."""
    return with_columns(state, candidate.effect).combined(candidate.modes), block_diag(
        state.precision, candidate.precision
    )


def with_columns(state: State, effect: Effect) -> NormalEquations:
    """Equations of the model with the columns of an effect's coefficients added."""
    return state.equations.bordered(*state.in_use(*state.model.products.chunk_of(effect)))
