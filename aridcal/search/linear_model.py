"""A linearised model with everything that could be added to it, and what is added solved at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from aridcal.effects.basis import Basis, evaluate
from aridcal.effects.effect import Effect
from aridcal.effects.smooth import samples_root, smooth_precision
from aridcal.fit.elimination import Projector
from aridcal.fit.flags import flagged
from aridcal.fit.normal_equations import NormalEquations, accumulate
from aridcal.instruments.channels import Channels, columns, spread
from aridcal.search.evidence import Score, Solution, solve

FAINT = 0.02
"""A mode that the data could move by less than this share of its prior is left out: nothing would be learnt of it."""

PLAUSIBLE = 5e-3
"""[m] and [rad] per unit of a basis: what joints, links and frames are wrong by in a way that changes is less."""

FLAGGING = 6
"""Times that flags and coefficients are found in turn; two are usual."""


@dataclass(frozen=True)
class LinearModel:
    """A linearised model and everything that could be added to it: N rows of m numbers, K constants, S slots, B bases.

    A candidate's column is that of its slot times its basis: A and G are differentiated once, and thousands of
    candidates cost a product each.

    Attributes:
        channels: What each row measures.
        A: Columns of the constants, shape (N, m, K), in units of the rows' relative sigmas.
        gauge: Prior precision of the constants about the geometric stage, shape (K, K).
        G: Columns of the slots, the motions that effects may have, shape (N, m, S).
        slots: (where, component) of each.
        phi: Values of the bases, shape (N, B).
        bases: The bases.
        r: Residual of the geometric stage, linearised, shape (N, m).
        limit: Sigmas beyond which each row is flagged, shape (N,).
        run: Number of the row's stretch of time, shape (N,).
        fold: Number of the row's fold for cross-validation, shape (N,).
        configuration: Number of the row's configuration, shape (N,).
        thing: Number of what each row measures, shape (N,): of a place that was measured again and again; None where rows
            measure the target itself, or too few things to leave any out.
        off: Takes off columns what unknown things take up; None where there are none. It is done with r and A; columns of
            G are multiplied with their bases first.
        present: Which channels each row measures, shape (N, C) bool; residual and columns are 0 in the others.
        taken: Numbers of each channel that unknown things take up, shape (C,): residual and columns are what those leave.
        share: Of a measurement that each row counts for; its residual and columns are scaled by the square root of that.
        own: Names of the joints: covariates that are under the user's control.
        table: Covariates of the rows, shape (N,) each.
    """

    channels: Channels
    A: np.ndarray
    gauge: np.ndarray
    G: np.ndarray
    slots: tuple[tuple[str, str], ...]
    phi: np.ndarray
    bases: tuple[Basis, ...]
    r: np.ndarray
    limit: np.ndarray
    run: np.ndarray
    fold: np.ndarray
    configuration: np.ndarray
    thing: np.ndarray | None
    off: Projector | None
    present: np.ndarray
    taken: np.ndarray
    share: float
    own: tuple[str, ...]
    table: Mapping[str, np.ndarray]

    @cached_property
    def slot_index(self) -> dict[tuple[str, str], int]:
        """Number of each slot."""
        return {slot: k for k, slot in enumerate(self.slots)}

    @cached_property
    def basis_index(self) -> dict[Basis, int]:
        """Number of each basis."""
        return {basis: k for k, basis in enumerate(self.bases)}

    def holed(self, residual: np.ndarray) -> np.ndarray:
        """Residuals, shape (N, m), NaN in channels that a row does not measure."""
        if self.present.all():
            return residual
        sizes = [channel.size for channel in self.channels]
        return np.where(np.repeat(self.present, sizes, axis=1), residual, np.nan)

    def prior_of(self, effect: Effect) -> float:
        """Precision beforehand of an effect's coefficients: where unknown things take up much, huge ones may cancel out."""
        of_arm = effect.where in (*self.own, "world_base", "tip_target")
        return PLAUSIBLE**-2.0 if self.off is not None and of_arm else 0.0

    def slot_columns(self, where: str, component: str) -> np.ndarray:
        """Columns of one slot, shape (N, m)."""
        return self.G[:, :, self.slot_index[where, component]]

    def indices(self, effect: Effect) -> tuple[list[int], list[int]]:
        """Slot and basis of each of an effect's coefficients."""
        return self._slots_of(effect), [self.basis_index[c.basis] for c in effect.coefficients]

    def _slots_of(self, effect: Effect) -> list[int]:
        return [self.slot_index[c.where, c.component] for c in effect.coefficients]

    def prepared(self, effect: Effect) -> bool:
        """True if all its bases are among ``bases``."""
        return all(c.basis in self.basis_index for c in effect.coefficients)

    def prepare(self, effects: Sequence[Effect]) -> LinearModel:
        """The same with the bases of further effects evaluated beforehand."""
        asked = dict.fromkeys(c.basis for e in effects for c in e.coefficients)
        new = [basis for basis in asked if basis not in self.basis_index]
        phi = [self.phi, *(evaluate(basis, self.table)[:, None] for basis in new)]
        return replace(self, bases=(*self.bases, *new), phi=np.hstack(phi))

    def moves(self, effect: Effect) -> bool:
        """True if each of its motions is seen at all: a turn of the target is not, where only positions are measured."""
        return all(bool(np.any(self.slot_columns(c.where, c.component))) for c in effect.coefficients)

    def columns(self, effect: Effect) -> np.ndarray:
        """Columns of an effect, shape (N, m, d)."""
        if self.prepared(effect):
            phi = self.phi[:, self.indices(effect)[1]]
        else:
            phi = np.column_stack([evaluate(c.basis, self.table) for c in effect.coefficients])
        return self.seen(self.G[:, :, self._slots_of(effect)] * phi[:, None, :])

    def seen(self, values: np.ndarray) -> np.ndarray:
        """Columns (N, m, d) less what unknown things take up."""
        return values if self.off is None else self.off(values)


@dataclass(frozen=True)
class Active:
    """An effect that is in the model; a smooth one by the modes that its data can tell, each with unit prior.

    Attributes:
        effect: The effect.
        score: Its evidence, and its shape if it is smooth.
        modes: Coefficients of each mode, shape (d, modes); the coefficients themselves if it is not smooth.
        stated: True if the campaign declares it: it stays, whatever the evidence.
        prior: Precision of each coefficient beforehand, if it is not smooth.
    """

    effect: Effect
    score: Score
    modes: np.ndarray
    stated: bool = False
    prior: float = 0.0

    @property
    def precision(self) -> np.ndarray:
        """Prior precision of what is solved for."""
        return (1.0 if self.effect.smooth else self.prior) * np.eye(self.modes.shape[1])

    @property
    def coefficient_precision(self) -> np.ndarray:
        """Prior precision of its coefficients, shape (d, d)."""
        if not self.effect.smooth:
            return self.prior * np.eye(len(self.effect.coefficients))
        return smooth_precision(self.effect.shape, self.score.tau, self.score.kernel)

    @property
    def root(self) -> np.ndarray:
        """Combinations of its coefficients that are independent beforehand, shape (d, d)."""
        if not self.effect.smooth:
            return np.eye(len(self.effect.coefficients))
        return self.score.tau * samples_root(self.effect.shape, self.score.kernel)

    def columns(self, model: LinearModel) -> np.ndarray:
        """Its columns, shape (N, m, d or modes)."""
        return model.columns(self.effect) @ self.modes


@dataclass(frozen=True)
class State:
    """A solved set of effects: the constants and P - K modes of effects, n rows in use.

    Attributes:
        channels: What each row measures.
        active: The effects.
        design: Columns of the rows in use, one array for each channel, shape (n size, P).
        right: Their residuals likewise, shape (n size,).
        precision: Of the prior of all that is solved for, shape (P, P).
        equations: Of the same.
        solution: Their solution.
        residual: What is left of every row, shape (N, m).
        used: Rows in use: those that are no outliers, shape (N,) bool.
        fold: Fold of each row in use, shape (n,).
        present: Which channels each row in use measures, shape (n, C) bool.
    """

    channels: Channels
    active: tuple[Active, ...]
    design: tuple[np.ndarray, ...]
    right: tuple[np.ndarray, ...]
    precision: np.ndarray
    equations: NormalEquations
    solution: Solution
    residual: np.ndarray
    used: np.ndarray
    fold: np.ndarray
    present: np.ndarray

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
    design = np.concatenate([model.A, *(a.columns(model) for a in active)], axis=2)
    precision = block_diag(model.gauge, *(a.precision for a in active))
    sound = used
    for _ in range(FLAGGING):
        used = sound
        present = model.present[used]
        A, b = flat(design[used], model.channels, present), flat(model.r[used], model.channels, present)
        equations = accumulate(A, b)
        equations = replace(equations, count=np.maximum(model.share * equations.count - model.taken, 1.0))
        solution = solve(equations, precision, sigma)
        residual = model.r - design @ solution.beta
        sigma = solution.sigma
        sound = ~flagged(model.holed(residual), model.channels, model.limit)
        if fixed or np.array_equal(sound, used):
            break
    return State(
        channels=model.channels,
        active=tuple(active),
        design=A,
        right=b,
        precision=precision,
        equations=equations,
        solution=solution,
        residual=residual,
        used=used,
        fold=model.fold[used],
        present=present,
    )


def activate(model: LinearModel, state: State, effect: Effect, found: Score) -> Active:
    """Make a candidate ready to be solved for: of a smooth one, the modes of which the data say something."""
    if not effect.smooth:
        return Active(effect, found, np.eye(len(effect.coefficients)), prior=model.prior_of(effect))
    root = samples_root(effect.shape, found.kernel)
    noise = found.sigma if found.sigma is not None else state.solution.sigma
    whitened = model.columns(effect) / spread(noise, model.channels)[:, None]
    mean_square = float(np.einsum("nmd,nmd->", whitened, whitened)) / whitened.shape[2]
    modes, sizes, _ = np.linalg.svd(root * found.tau, full_matrices=False)
    seen = sizes**2 * mean_square > FAINT
    return Active(effect, found, (modes * sizes)[:, seen])


def with_candidate(model: LinearModel, state: State, candidate: Active) -> tuple[NormalEquations, np.ndarray]:
    """Equations of the model with a candidate added, and the prior precision of all its coefficients."""
    added = state.flat(candidate.columns(model))
    return state.equations.extended(state.design, added, state.right), block_diag(state.precision, candidate.precision)
