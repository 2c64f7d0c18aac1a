"""A set of effects solved in the linearised model, from sums of products that are kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from aridcal.effects.effect import Effect
from aridcal.effects.smooth import kernel_modes
from aridcal.fit.flags import flagged
from aridcal.fit.normal_equations import NormalEquations, accumulate, total
from aridcal.instruments.channels import Channels, columns, spread
from aridcal.search.evidence import Score, Solution, solve
from aridcal.search.linear_model import Active, LinearModel
from aridcal.search.products import Member

FAINT = 0.02
"""A mode that the data could move by less than this share of its prior is left out: nothing would be learnt of it."""

FLAGGING = 6
"""Times that flags and coefficients are found in turn; two are usual."""


@dataclass(frozen=True)
class State:
    """A solved set of effects: the constants and P - K modes of effects, n rows in use.

    Attributes:
        model: The linearised model.
        active: The effects.
        precision: Of the prior of all that is solved for, shape (P, P).
        folds: Sums over the rows in use of each fold.
        equations: Over all of them.
        solution: Their solution.
        residual: What is left of every row, shape (N, m).
        used: Rows in use: those that are no outliers, shape (N,) bool.
        unused: The other rows' places in the order of the folds, shape (N - n,).
        extra: Columns of these, one array for each channel, shape ((N - n) size, P).
    """

    model: LinearModel
    active: tuple[Active, ...]
    precision: np.ndarray
    folds: tuple[NormalEquations, ...]
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
        """Their residuals likewise, shape (n size,)."""
        return self.flat(self.model.r)

    @property
    def members(self) -> tuple[Member, ...]:
        """What stands in the design: the constants, then the effects."""
        return members(self.model, self.active)

    def in_modes(self, blocks: Sequence[np.ndarray]) -> np.ndarray:
        """Products with the coefficients of all members, (..., w, d) each, as products with what is solved for, (..., w, P)."""
        first, *others = blocks
        return np.concatenate([first, *(b @ a.modes for b, a in zip(others, self.active, strict=True))], axis=-1)

    def fitted_by_place(self, beta: np.ndarray, low: int, high: int) -> list[np.ndarray]:
        """What L solutions, shape (P, L), make of rows at some places of the folds' order, ((high - low) size, L) a channel."""
        made = self.model.products
        first, *others = _places([self.model.A.shape[2], *(a.modes.shape[1] for a in self.active)])
        numbers = [slice(low * channel.size, high * channel.size) for channel in self.channels]
        fitted = [x[own] @ beta[first] for x, own in zip(made.columns(None), numbers, strict=True)]
        for a, place in zip(self.active, others, strict=True):
            taken = a.modes @ beta[place]
            for values, x, own in zip(fitted, made.columns(a.effect), numbers, strict=True):
                values += x[own] @ taken
        return fitted

    @property
    def sigma(self) -> np.ndarray:
        """Noise of each number of a row, shape (m,)."""
        return spread(self.solution.sigma, self.channels)

    def flat(self, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Columns (N, m, d) or residuals (N, m) brought to the design's shape: rows in use, channel by channel."""
        return flat(values[self.used], self.channels, self.present)

    def whitened(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Arrays of the design's shape in sigmas, all channels under one another."""
        scaled = [part / sigma for part, sigma in zip(values, self.solution.sigma, strict=True)]
        return np.concatenate(scaled)

    def less_unused(
        self, lost: Sequence[np.ndarray], cross: np.ndarray, own: np.ndarray, pull: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums of some columns over all rows without the rows that are not in use.

        Args:
            lost: The columns in these, shape (rows size, w) for each channel.
            cross: Products with the design's columns, shape (C, w, P).
            own: With one another, shape (C, w, w).
            pull: With the residual, shape (C, w).

        Returns:
            The same for the rows in use; the first as (C, P, w).
        """
        if len(self.unused):
            made = self.model.products
            right = [r[rows] for r, rows in zip(made.r, made.layout.numbers(self.unused), strict=True)]
            cross = cross - np.array([x.T @ a for x, a in zip(lost, self.extra, strict=True)])
            own = own - np.array([x.T @ x for x in lost])
            pull = pull - np.array([x.T @ r for x, r in zip(lost, right, strict=True)])
        return np.swapaxes(cross, 1, 2), own, pull


def members(model: LinearModel, active: Sequence[Active]) -> tuple[Member, ...]:
    """What stands in the design of some effects: the constants, then these."""
    return (model.products.constants, *((a.effect, a.modes) for a in active))


def flat(values: np.ndarray, channels: Channels, present: np.ndarray) -> tuple[np.ndarray, ...]:
    """Columns (n, m, d) or residuals (n, m) by channel, one number under the other: (n size, d) or (n size,) each.

    Args:
        values: Of n rows.
        channels: C of them.
        present: Which rows have numbers of each, shape (n, C) bool: the others are left out.
    """
    _, _, *tail = values.shape
    made = []
    for channel, part, own in zip(channels, columns(channels), present.T, strict=True):
        rows = values[:, part] if own.all() else values[own][:, part]
        made.append(rows.reshape(len(rows) * channel.size, *tail))
    return tuple(made)


def by_row(parts: Sequence[np.ndarray], channels: Channels, present: np.ndarray) -> np.ndarray:
    """What :func:`flat` made, row by row again, shape (n, m, d) or (n, m); 0 where a row has no number."""
    _, *tail = parts[0].shape
    rows = np.zeros((len(present), sum(channel.size for channel in channels), *tail))
    for values, channel, part, own in zip(parts, channels, columns(channels), present.T, strict=True):
        rows[own, part] = values.reshape(-1, channel.size, *tail)
    return rows


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
    for _ in range(FLAGGING):
        used = sound
        unused, extra, folds = _in_use(model, active, every, used)
        equations = total(folds)
        equations = replace(equations, count=np.maximum(model.share * equations.count - model.taken, 1.0))
        solution = solve(equations, precision, sigma)
        residual = _left(model, active, solution.beta)
        sigma = solution.sigma
        sound = ~flagged(model.holed(residual), model.channels, model.limit)
        if fixed or np.array_equal(sound, used):
            break
    return State(model, tuple(active), precision, folds, equations, solution, residual, used, unused, extra)


def _places(sizes: Sequence[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(low, high) for low, high in pairwise(ends)]


def _of_all_rows(model: LinearModel, active: Sequence[Active]) -> list[NormalEquations]:
    """Sums of a set of effects over the rows of each fold, whether in use or not."""
    made = model.products
    every = members(model, active)
    own = _places([modes.shape[1] for _, modes in every])
    layout, channels = made.layout, len(model.channels)
    folds = len(layout.starts) - 1
    AA = np.empty((folds, channels, own[-1].stop, own[-1].stop))
    Ar = np.empty((folds, channels, own[-1].stop))
    for i, (a, left) in enumerate(every):
        Ar[:, :, own[i]] = made.pull(a) @ left
        for j, (b, right) in enumerate(every[: i + 1]):
            block = np.ascontiguousarray(left.T) @ made.between(a, b) @ right
            AA[:, :, own[i], own[j]] = block
            AA[:, :, own[j], own[i]] = block.transpose(0, 1, 3, 2)
    there = [model.present[layout.order[low:high]] for low, high in pairwise(layout.starts)]
    sizes = np.array([channel.size for channel in model.channels])
    return [
        NormalEquations(aa, ar, rr, own.sum(axis=0) * sizes)
        for aa, ar, rr, own in zip(AA, Ar, made.squares, there, strict=True)
    ]


def _in_use(
    model: LinearModel, active: Sequence[Active], every: Sequence[NormalEquations], used: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...], tuple[NormalEquations, ...]]:
    """Places and columns of the rows that are not used, and the sums of each fold without them."""
    made, layout = model.products, model.products.layout
    unused = np.flatnonzero(~used[layout.order])
    numbers = layout.numbers(unused)
    columns_of = [[x[own] for x, own in zip(made.columns(None), numbers, strict=True)]]
    columns_of += [[x[own] @ a.modes for x, own in zip(made.columns(a.effect), numbers, strict=True)] for a in active]
    extra = tuple(np.hstack(parts) for parts in zip(*columns_of, strict=True))
    right = [r[own] for r, own in zip(made.r, numbers, strict=True)]
    sizes = [channel.size for channel in model.channels]
    there = model.present[layout.order[unused]]
    fold = np.searchsorted(layout.starts, unused, side="right") - 1
    folds = list(every)
    for f in np.unique(fold).tolist():
        own = [np.repeat(fold == f, size) for size in sizes]
        lost = accumulate(
            [x[k] for x, k in zip(extra, own, strict=True)], [r[k] for r, k in zip(right, own, strict=True)]
        )
        folds[f] = every[f].minus(replace(lost, count=there[fold == f].sum(axis=0) * np.array(sizes)))
    return unused, extra, tuple(folds)


def _left(model: LinearModel, active: Sequence[Active], beta: np.ndarray) -> np.ndarray:
    """What a solution leaves of every row, shape (N, m)."""
    K = model.A.shape[2]
    left = model.r - model.A @ beta[:K]
    for a, own in zip(active, _places([K, *(a.modes.shape[1] for a in active)])[1:], strict=True):
        left -= model.seen(model.made_of(a.effect, a.modes @ beta[own])[:, :, None])[:, :, 0]
    return np.asarray(left)


def activate(model: LinearModel, state: State, effect: Effect, found: Score) -> Active:
    """Make a candidate ready to be solved for: of a smooth one, the modes of which the data say something."""
    if not effect.smooth:
        return Active(effect, found, np.eye(len(effect.coefficients)), prior=model.prior_of(effect))
    noise = found.sigma if found.sigma is not None else state.solution.sigma
    squares = model.products.lengths(effect) @ noise**-2.0
    mean_square = float(squares) / len(effect.coefficients)
    modes, sizes = kernel_modes(effect.shape, found.kernel)
    sizes = sizes * found.tau
    seen = sizes**2 * mean_square > FAINT
    return Active(effect, found, (modes * sizes)[:, seen])


def with_candidate(state: State, candidate: Active) -> tuple[NormalEquations, np.ndarray]:
    """Equations of the model with a candidate added, and the prior precision of all its coefficients."""
    return with_columns(state, candidate.effect).combined(candidate.modes), block_diag(
        state.precision, candidate.precision
    )


def with_columns(state: State, effect: Effect) -> NormalEquations:
    """Equations of the model with the columns of an effect's coefficients added."""
    made = state.model.products
    made.now_in_the_model(state.members)
    known = made.known(effect)
    if known is None:
        X = made.flat([effect])
        own, pull = (sums.sum(axis=0) for sums in made.own_by_fold(X))
        cross = made.across_any(X, state.members)
        lost = [x[rows] for x, rows in zip(X, made.layout.numbers(state.unused), strict=True)]
    else:
        chunk, where = known
        own, pull, cross = chunk.own[:, where, where], chunk.pull[:, where], made.across(chunk, state.members)[:, where]
        lost = [x[:, where] for x in made.rows_of(chunk, state.unused)]
    return state.equations.bordered(*state.less_unused(lost, cross, own, pull))
