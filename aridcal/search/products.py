r"""Products of a linearised model's columns, each made once: what every trial of a search is put together from.

A search solves and scores the same columns hundreds of times, in other company and with other noise. With :math:`X_e` the
columns of an effect (or of the constants), all sums that this needs are

.. math:: \sum_{n \in f, c} X_e^T X_{e'}, \qquad \sum_{n \in f, c} X_e^T r

fold by fold f and channel by channel c for effects that were in the model once, over all folds for the rest of the library.
Rows that a state does not use are few: theirs are taken off. So the cost of a trial does not grow with the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from aridcal.effects.effect import Effect
from aridcal.instruments.channels import Channels, columns

CHUNK = 128
"""Columns that are multiplied at once: their Gram matrix stays in the cache."""

KEPT = 2**23
"""Numbers of the library's columns that are kept, 64 MB; the columns of further candidates are made again when needed."""

MEMBERS = 24
"""Effects of which all products are kept, those in the model last: with 2,000 rows and 72 knots 20 MB each."""

# Columns of effects side by side, shape (N, m, d), or of some of the rows.
Make = Callable[[Sequence[Effect]], np.ndarray]

# Numbers of each channel under one another: (N size, d) or (N size,) each.
Flat = tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Layout:
    """Rows in the order of their folds, so that each fold is a stretch.

    Attributes:
        channels: What each row measures.
        order: Row at each place, shape (N,).
        starts: First place of each fold, and the end, shape (F + 1,).
    """

    channels: Channels
    order: np.ndarray
    starts: np.ndarray

    @classmethod
    def of(cls, fold: np.ndarray, channels: Channels) -> Layout:
        """Of rows with folds of shape (N,)."""
        order = np.argsort(fold, kind="stable")
        different = np.unique(fold)
        return cls(channels, order, np.append(np.searchsorted(fold[order], different), len(fold)))

    def flat(self, values: np.ndarray) -> Flat:
        """Columns (N, m, d) or residuals (N, m), channel by channel, in the order of the folds."""
        _, _, *tail = values.shape
        ordered = values[self.order]
        return tuple(ordered[:, part].reshape(len(ordered) * (part.stop - part.start), *tail) for part in self.parts)

    @property
    def parts(self) -> tuple[slice, ...]:
        """Columns of each channel."""
        return columns(self.channels)

    def stretches(self, size: int) -> list[slice]:
        """Numbers of each fold in a channel of so many numbers a row."""
        return [slice(low * size, high * size) for low, high in zip(self.starts[:-1], self.starts[1:], strict=True)]

    def numbers(self, places: np.ndarray) -> list[np.ndarray]:
        """Numbers of some rows in each channel, from the rows' places."""
        sizes = [channel.size for channel in self.channels]
        return [(places[:, None] * size + np.arange(size)).ravel() for size in sizes]


@dataclass
class _Chunk:
    """Candidates that are multiplied together, w columns.

    Attributes:
        effects: The candidates.
        own: X'X, shape (C, w, w).
        pull: X'r, shape (C, w).
        across: X'Y for the columns Y of each effect that was asked for (None: the constants), shape (C, w, d).
        kept: The columns themselves, if there is room.
    """

    effects: tuple[Effect, ...]
    own: np.ndarray
    pull: np.ndarray
    across: dict[Effect | None, np.ndarray] = field(default_factory=dict)
    kept: Flat | None = None


class Products:
    """What was multiplied so far of one linearised model."""

    def __init__(self, A: np.ndarray, r: np.ndarray, layout: Layout, make: Make) -> None:
        """Start with nothing.

        Args:
            A: Columns of the constants, shape (N, m, K).
            r: Residual, shape (N, m).
            layout: Of the rows.
            make: Columns of effects.
        """
        self.layout, self.r, self._make = layout, layout.flat(r), make
        self._columns: dict[Effect | None, Flat] = {None: layout.flat(A)}
        self._between: dict[tuple[Effect | None, Effect | None], np.ndarray] = {}
        self._pull: dict[Effect | None, np.ndarray] = {}
        self._ordered: dict[tuple[str, Effect | None], np.ndarray] = {}
        self._known: dict[Effect, None] = {}
        self._place: dict[Effect, tuple[_Chunk, slice]] = {}
        self._kept = 0
        stretches = [layout.stretches(channel.size) for channel in layout.channels]
        self.squares = np.array([
            [r[own[f]] @ r[own[f]] for r, own in zip(self.r, stretches, strict=True)]
            for f in range(len(layout.starts) - 1)
        ])  # fmt: skip

    def flat(self, effects: Sequence[Effect]) -> Flat:
        """Columns of effects side by side, in the order of the folds."""
        return self.layout.flat(self._make(effects))

    def now_in_the_model(self, effects: Sequence[Effect]) -> None:
        """Forget what was in the model longest ago, if more is kept than there is room for."""
        for effect in effects:
            self._known.pop(effect, None)
            self._known[effect] = None  # now the last
        for effect in list(self._known)[: max(len(self._known) - max(MEMBERS, len(effects)), 0)]:
            self._forget(effect)

    def forget(self) -> None:
        """Keep nothing: no more is asked."""
        for effect in list(self._known):
            self._forget(effect)
        self._place.clear()
        self._kept = 0

    def _forget(self, effect: Effect) -> None:
        del self._known[effect]
        self._columns.pop(effect, None)
        self._pull.pop(effect, None)
        for key in [key for key in self._between if effect in key]:
            del self._between[key]
        for name in [key for key in self._ordered if key[1] == effect]:
            del self._ordered[name]
        for chunk in self._chunks():
            chunk.across.pop(effect, None)

    def _chunks(self) -> list[_Chunk]:
        return list({id(chunk): chunk for chunk, _ in self._place.values()}.values())

    def in_order(self, of: str, order: np.ndarray, member: Effect | None) -> np.ndarray:
        """Columns of what is in the model, rows in another order, that of a covariate, shape (N, m, d); they are kept."""
        if (of, member) not in self._ordered:
            place = np.argsort(self.layout.order)[order]
            N = len(order)
            parts = [x.reshape(N, -1, x.shape[1])[place] for x in self.columns(member)]
            self._ordered[of, member] = np.concatenate(parts, axis=1)
        return self._ordered[of, member]

    def columns(self, of: Effect | None) -> Flat:
        """Columns of an effect that is, or was, in the model (None: of the constants); they are kept."""
        if of not in self._columns:
            assert of is not None
            self._known[of] = None
            self._columns[of] = self.flat([of])
        return self._columns[of]

    def between(self, a: Effect | None, b: Effect | None) -> np.ndarray:
        """Products of two such, shape (F, C, da, db)."""
        if (a, b) not in self._between:
            made = self.by_fold(self.columns(a), b)
            self._between[a, b] = made
            self._between[b, a] = made.transpose(0, 1, 3, 2)
        return self._between[a, b]

    def by_fold(self, X: Flat, b: Effect | None) -> np.ndarray:
        """Products of any columns with those of the model, shape (F, C, d, db)."""
        return self._folds(X, self.columns(b))

    def own_by_fold(self, X: Flat) -> tuple[np.ndarray, np.ndarray]:
        """Products of any columns with themselves and with the residual, shape (F, C, d, d) and (F, C, d)."""
        return self._folds(X, X), self._folds(X, self.r)

    def pull(self, of: Effect | None) -> np.ndarray:
        """Products with the residual, shape (F, C, d)."""
        if of not in self._pull:
            self._pull[of] = self._folds(self.columns(of), self.r)
        return self._pull[of]

    def _folds(self, X: Flat, Y: Flat) -> np.ndarray:
        stretches = [self.layout.stretches(channel.size) for channel in self.layout.channels]
        return np.array([
            [x[own[f]].T @ y[own[f]] for x, y, own in zip(X, Y, stretches, strict=True)]
            for f in range(len(self.layout.starts) - 1)
        ])  # fmt: skip

    def chunks(self, effects: Sequence[Effect]) -> list[_Chunk]:
        """Chunks in which some candidates are, made where they are not yet."""
        for group in grouped([e for e in effects if e not in self._place]):
            X = self.flat(group)
            kept = X if self._kept + sum(x.size for x in X) <= KEPT else None
            self._kept += sum(x.size for x in X) if kept else 0
            pull = np.array([x.T @ r for x, r in zip(X, self.r, strict=True)])
            chunk = _Chunk(tuple(group), np.array([x.T @ x for x in X]), pull, {}, kept)
            for effect, own in placed(group):
                self._place[effect] = chunk, own
        return list({id(self._place[e][0]): self._place[e][0] for e in effects}.values())

    def known(self, effect: Effect) -> tuple[_Chunk, slice] | None:
        """Where a candidate is, if it was scored with the library."""
        return self._place.get(effect)

    def lengths(self, effect: Effect) -> np.ndarray:
        """Sum of squares of an effect's columns in each channel, shape (C,)."""
        known = self.known(effect)
        if known is None:
            return np.array([float(np.sum(x**2)) for x in self.flat([effect])])
        chunk, own = known
        return np.asarray(np.einsum("ckk->c", chunk.own[:, own, own]))

    def of_candidate(self, effect: Effect) -> Flat:
        """Columns of a candidate, kept or made here."""
        known = self.known(effect)
        if known is None or known[0].kept is None:
            return self.flat([effect])
        return tuple(x[:, known[1]] for x in known[0].kept)

    def of_chunk(self, chunk: _Chunk) -> Flat:
        """Columns of a chunk."""
        return chunk.kept if chunk.kept is not None else self.flat(chunk.effects)

    def across(self, chunk: _Chunk, members: Sequence[Effect | None]) -> list[np.ndarray]:
        """Products of a chunk's columns with those of the constants and effects in the model, shape (C, w, d) each."""
        new = [member for member in members if member not in chunk.across]
        if new:
            X = self.of_chunk(chunk)
            for member in new:
                chunk.across[member] = np.array([x.T @ y for x, y in zip(X, self.columns(member), strict=True)])
        return [chunk.across[member] for member in members]


def grouped(effects: Sequence[Effect]) -> list[list[Effect]]:
    """Candidates in groups of about :data:`CHUNK` columns."""
    groups: list[list[Effect]] = []
    size = CHUNK
    for effect in effects:
        if size + len(effect.coefficients) > CHUNK:
            groups.append([])
            size = 0
        groups[-1].append(effect)
        size += len(effect.coefficients)
    return groups


def placed(effects: Sequence[Effect]) -> list[tuple[Effect, slice]]:
    """Effects, and where their columns are when they stand side by side."""
    ends = np.cumsum([0, *(len(e.coefficients) for e in effects)]).tolist()
    return [(e, slice(low, high)) for e, low, high in zip(effects, ends[:-1], ends[1:], strict=True)]
