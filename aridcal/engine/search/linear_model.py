"""A linearised model with everything that could be added to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aridcal.engine.corrections.basis import Basis, evaluate
from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.smooth import samples_root, smooth_precision
from aridcal.engine.fit.elimination import Projector
from aridcal.engine.instruments.channels import Channels, columns
from aridcal.engine.search.evidence import Score
from aridcal.engine.search.products import ColumnSource, Flat, FoldOrder, Products
from aridcal.engine.search.state_cache import Answers

PLAUSIBLE_SIZE = 5e-3
"""[m] and [rad] per unit of a basis: what joints, links and frames are wrong by in a way that changes is less."""


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
        phi: Values of the bases, shape (N, B), each in one piece in memory.
        bases: The bases.
        r: Residual of the geometric stage, linearised, shape (N, m).
        limit: Sigmas beyond which each row is flagged, shape (N,).
        run: Number of the row's stretch of time, shape (N,).
        fold: Number of the row's fold for cross-validation, shape (N,).
        configuration: Number of the row's configuration, shape (N,).
        thing: Number of the thing or place that each row measures, shape (N,); None where rows measure the target itself, or
            too few things to leave any out.
        off: Takes the part of unknown things off columns; None where there are none. r and A are without that part already;
            columns of G are multiplied with their bases first.
        present: Which channels each row measures, shape (N, C) bool; residual and columns are 0 in the others.
        taken_up: Numbers of each channel that unknown things take up, shape (C,).
        share: Share of an independent measurement that each row counts for; residual and columns are scaled by its root.
        joints: Names of the joints: covariates that are under the user's control.
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
    taken_up: np.ndarray
    share: float
    joints: tuple[str, ...]
    table: Mapping[str, np.ndarray]

    @cached_property
    def slot_index(self) -> dict[tuple[str, str], int]:
        """Number of each slot."""
        return {slot: k for k, slot in enumerate(self.slots)}

    @cached_property
    def basis_index(self) -> dict[Basis, int]:
        """Number of each basis."""
        return {basis: k for k, basis in enumerate(self.bases)}

    @cached_property
    def products(self) -> Products:
        """Sums of products of its columns, each computed at its first use."""
        return Products(self.A, self.r, self._layout, self._source)

    @cached_property
    def answers(self) -> Answers:
        """What was worked out of states of this model."""
        return Answers()

    @cached_property
    def _layout(self) -> FoldOrder:
        return FoldOrder.of(self.fold, self.channels)

    @cached_property
    def _in_folds(self) -> tuple[np.ndarray, ...]:
        """Columns of the slots in the order of the folds, (S, N, size) for each channel."""
        ordered = self.G[self._layout.order].transpose(2, 0, 1)
        return tuple(np.ascontiguousarray(ordered[:, :, part]) for part in columns(self.channels))

    @property
    def _source(self) -> ColumnSource:
        return ColumnSource(self.flat_columns, self._apart, self._of_slots, lambda bases: self._values(bases).T)

    def _values(self, bases: Sequence[int], places: np.ndarray | None = None) -> np.ndarray:
        """Values of some bases, (bases, N), in the order of the folds, or at some places of it."""
        order = self._layout.order
        return self.phi.T[np.array(bases, dtype=int)[:, None], order if places is None else order[places]]

    def _apart(self, effect: Effect) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
        """Slots, each once, and bases of an effect; None where its columns are not the plain products of these."""
        slots, bases = self._index(effect)
        return None if bases is None or self.off is not None else (tuple(dict.fromkeys(slots)), tuple(bases))

    def _of_slots(self, slots: Sequence[int]) -> Flat:
        return tuple(np.ascontiguousarray(g[list(slots)].transpose(1, 2, 0)) for g in self._in_folds)

    def flat_columns(self, effects: Sequence[Effect], places: np.ndarray | None = None) -> Flat:
        """Columns of effects side by side, channel by channel, in the order of the folds, or at some places of it."""
        if self.off is not None or not all(self.prepared(e) for e in effects):
            X = self._layout.flat(self.columns(*effects))
            return X if places is None else tuple(x[n] for x, n in zip(X, self._layout.numbers(places), strict=True))
        slots, bases = ([k for e in effects for k in self._index(e)[part] or ()] for part in (0, 1))
        values = self._values(bases, places)
        per_channel = []
        for g in self._in_folds:
            x = g[slots] if places is None else g[np.array(slots)[:, None], places]
            for k in range(x.shape[2]):  # numbers of a row have the same value: rows are multiplied on end
                x[:, :, k] *= values
            per_channel.append(x.reshape(len(slots), -1).T)
        return tuple(per_channel)

    def holed(self, residual: np.ndarray) -> np.ndarray:
        """Residuals, shape (N, m), NaN in channels that a row does not measure."""
        if self.present.all():
            return residual
        sizes = [channel.size for channel in self.channels]
        return np.where(np.repeat(self.present, sizes, axis=1), residual, np.nan)

    def prior_of(self, effect: Effect) -> float:
        """Prior precision of an effect's coefficients: where unknown things take up much, huge ones might cancel out."""
        of_arm = effect.where in (*self.joints, "world_base", "tip_target")
        return PLAUSIBLE_SIZE**-2.0 if self.off is not None and of_arm else 0.0

    def slot_columns(self, where: str, component: str) -> np.ndarray:
        """Columns of one slot, shape (N, m)."""
        return self.G[:, :, self.slot_index[where, component]]

    @cached_property
    def _indices(self) -> dict[Effect, tuple[list[int], list[int] | None]]:
        """Cache of the slots and bases of effects; None for bases where some are not among :attr:`bases`."""
        return {}

    def slots_of(self, effect: Effect) -> list[int]:
        """Number of the slot of each coefficient."""
        return self._index(effect)[0]

    def _index(self, effect: Effect) -> tuple[list[int], list[int] | None]:
        indices = self._indices.get(effect)
        if indices is None:
            if len(effect.slots) == 1:
                slots = [self.slot_index[effect.slots[0]]] * len(effect.coefficients)
            else:
                slots = [self.slot_index[c.where, c.component] for c in effect.coefficients]
            bases = [k for c in effect.coefficients if (k := self.basis_index.get(c.basis)) is not None]
            indices = self._indices[effect] = slots, bases if len(bases) == len(slots) else None
        return indices

    def prepared(self, effect: Effect) -> bool:
        """True if all its bases are among ``bases``."""
        return self._index(effect)[1] is not None

    def prepare(self, effects: Sequence[Effect]) -> LinearModel:
        """The model with the bases of further effects evaluated."""
        bases = dict.fromkeys(c.basis for e in effects for c in e.coefficients)
        new = [basis for basis in bases if basis not in self.basis_index]
        phi = np.vstack([self.phi.T, *(evaluate(basis, self.table) for basis in new)]).T
        model = replace(self, bases=(*self.bases, *new), phi=phi)
        # The columns stay, and so do their products.
        vars(model).update(_in_folds=self._in_folds, products=self.products.made_by(model._source))
        return model

    def moves(self, effect: Effect) -> bool:
        """True if each motion of an effect moves some row: a turn of the target moves none where only positions are measured."""
        return all(self._moves[self.slot_index[slot]] for slot in effect.slots)

    @cached_property
    def _moves(self) -> np.ndarray:
        """Whether each slot moves any row, shape (S,) bool."""
        return np.asarray(self.G.any(axis=(0, 1)))

    def columns(self, *effects: Effect) -> np.ndarray:
        """Columns of effects, shape (N, m, d) for the d coefficients of all of them."""
        slots = [k for e in effects for k in self.slots_of(e)]
        return self.seen(self.G[:, :, slots] * self._bases_of(effects)[:, None, :])

    def made_of(self, effect: Effect, beta: np.ndarray) -> np.ndarray:
        """Values of an effect with coefficients of shape (d,), shape (N, m), the part of unknown things included."""
        slots, phi = self.slots_of(effect), self._bases_of([effect])
        values = np.zeros(self.r.shape)
        for slot in dict.fromkeys(slots):
            of_slot = [k for k, other in enumerate(slots) if other == slot]
            values += self.G[:, :, slot] * (phi[:, of_slot] @ beta[of_slot])[:, None]
        return values

    def _bases_of(self, effects: Sequence[Effect]) -> np.ndarray:
        """Bases of each coefficient of some effects, shape (N, d)."""
        numbers = [self._index(e)[1] for e in effects]
        if all(bases is not None for bases in numbers):
            return self.phi[:, [k for bases in numbers for k in bases or ()]]
        return np.column_stack([evaluate(c.basis, self.table) for e in effects for c in e.coefficients])

    def seen(self, values: np.ndarray) -> np.ndarray:
        """Columns (N, m, d) less the part that unknown things take up."""
        return values if self.off is None else self.off(values)


@dataclass(frozen=True)
class ActiveEffect:
    """An effect in the model; a smooth one by the modes that the data determine, each with unit prior.

    Attributes:
        effect: The effect.
        score: Its evidence, and its shape if it is smooth.
        modes: Coefficients of each mode, shape (d, modes); the coefficients themselves if it is not smooth.
        declared: True if the campaign declares it: it stays, whatever the evidence.
        prior: Prior precision of each coefficient, if it is not smooth.
    """

    effect: Effect
    score: Score
    modes: np.ndarray
    declared: bool = False
    prior: float = 0.0

    @property
    def precision(self) -> np.ndarray:
        """Prior precision of its unknowns, shape (modes, modes)."""
        return (1.0 if self.effect.smooth else self.prior) * np.eye(self.modes.shape[1])

    @property
    def coefficient_precision(self) -> np.ndarray:
        """Prior precision of its coefficients, shape (d, d)."""
        if not self.effect.smooth:
            return self.prior * np.eye(len(self.effect.coefficients))
        return smooth_precision(self.effect.shape, self.score.tau, self.score.kernel)

    @property
    def root(self) -> np.ndarray:
        """Combinations of its coefficients that are independent in the prior, shape (d, d)."""
        if not self.effect.smooth:
            return np.eye(len(self.effect.coefficients))
        return self.score.tau * samples_root(self.effect.shape, self.score.kernel)

    def columns(self, model: LinearModel) -> np.ndarray:
        """Its columns, shape (N, m, d or modes)."""
        return model.columns(self.effect) @ self.modes
