r"""Products of a linearised model's columns, each computed once: the sums from which every trial of a search is solved.

A search solves and scores the same columns hundreds of times, beside other effects and with other noise. With :math:`X_e` the
columns of an effect (or of the constants), all sums that it needs are

.. math:: \sum_{n \in f, c} X_e^T X_{e'}, \qquad \sum_{n \in f, c} X_e^T r

fold by fold f and channel by channel c for effects that were in the model once, over all folds for the rest of the library.
Rows that a state does not use are few: theirs are taken off. So the cost of a trial does not grow with the rows.

Functions of one covariate on knots, tried as motions of many slots, are a :class:`Grid`: their columns are never made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, pairwise
from typing import Any

import numpy as np

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.instruments.channels import Channels, columns
from aridcal.engine.search.grids import Grid, LocalValues, grid_of, local, moved_rows, moving_slots

COLUMNS_PER_CHUNK = 128
"""Work: Columns that are multiplied at once: their Gram matrix stays in the cache."""

COLUMNS_PER_PIECE = 24
"""Work: Columns whose Gram matrix is made: of candidates that are tried one by one all but the diagonal is made in vain, and of
fewer columns each call costs more than its sums."""

LEAST_GRID_CANDIDATES = 4
"""Work: Candidates of the same functions from which they are multiplied as a grid: for fewer it takes as long as their
columns."""

KEPT_NUMBERS = 2**25
"""Work: Numbers of the library's columns and products that are kept, 256 MB, columns up to half of that; the rest is made again
when needed."""

MOST_ROW_KINDS = 16
"""Work: Kinds of rows, by the constants that move them, up to which each is multiplied by its own: of more each has too few
rows."""

MEMBERS = 24
"""Work: Effects of which all products are kept, those in the model last: with 2,000 rows and 72 knots 20 MB each."""

# A member of the design: an effect (None: the constants) and the modes that are its unknowns, shape (d, modes).
Member = tuple[Effect | None, np.ndarray]

# Numbers of each channel under one another: (N size, d) or (N size,) each.
Flat = tuple[np.ndarray, ...]


@dataclass(frozen=True)
class ColumnSource:
    """Functions that make columns; rows in the order of the folds.

    Attributes:
        make: Columns of effects side by side, of all rows or of those at some places.
        apart: The slots and the functions of which an effect's columns are the products; None where they are not products.
        slots: Columns of some slots, (N, size, slots) for each channel.
        functions: Values of some functions, shape (N, functions).
    """

    make: Callable[[Sequence[Effect], np.ndarray | None], Flat]
    apart: Callable[[Effect], tuple[tuple[int, ...], tuple[int, ...]] | None]
    slots: Callable[[Sequence[int]], Flat]
    functions: Callable[[Sequence[int]], np.ndarray]


@dataclass(frozen=True)
class FoldOrder:
    """Rows in the order of their folds, so that each fold is a stretch.

    Attributes:
        channels: What each row measures.
        order: Number of the row at each place, shape (N,).
        starts: First place of each fold, and the end, shape (F + 1,).
    """

    channels: Channels
    order: np.ndarray
    starts: np.ndarray

    @classmethod
    def of(cls, fold: np.ndarray, channels: Channels) -> FoldOrder:
        """The layout of rows whose folds are numbered, shape (N,)."""
        order = np.argsort(fold, kind="stable")
        different = np.unique(fold)
        return cls(channels, order, np.append(np.searchsorted(fold[order], different), len(fold)))

    def flat(self, values: np.ndarray) -> Flat:
        """Columns (N, m, d) or residuals (N, m), channel by channel, in the order of the folds."""
        _, _, *tail = values.shape
        ordered = values[self.order]
        parts = zip(self.channels, columns(self.channels), strict=True)
        return tuple(ordered[:, part].reshape(len(ordered) * channel.size, *tail) for channel, part in parts)

    def by_row(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """The columns that :meth:`flat` took apart, rows in their own order, shape (N, m, d)."""
        rows = len(self.order)
        ordered = np.concatenate([x.reshape(rows, len(x) // rows, x.shape[1]) for x in parts], axis=1)
        values = np.empty_like(ordered)
        values[self.order] = ordered
        return values

    def stretches(self, size: int) -> list[slice]:
        """Stretch of each fold in a channel of ``size`` numbers a row."""
        return [slice(low, high) for low, high in pairwise((self.starts * size).tolist())]

    def numbers(self, places: np.ndarray) -> list[np.ndarray]:
        """Indices of some rows' numbers in each channel, from the rows' places."""
        sizes = [channel.size for channel in self.channels]
        return [(places[:, None] * size + np.arange(size)).ravel() for size in sizes]


@dataclass(frozen=True)
class Chunk:
    """Candidates that are multiplied together, w columns.

    Attributes:
        effects: The candidates.
        gram: X'X, shape (C, w, w), left 0 far off the diagonal, as no two candidates are scored together; of a grid each
            candidate's own, shape (C, candidates, d, d).
        pull: X'r, shape (C, w).
        across: X'Y for the columns Y of members of the design (None: the constants), shape (C, w, d) each.
        columns: X itself, where there is room for it.
        rows: Places in the order of the folds outside of which X is zero: those of a limb; None for all.
        grid: The grid of the candidates, if they are one.
    """

    effects: tuple[Effect, ...]
    gram: np.ndarray
    pull: np.ndarray
    across: dict[Effect | None, np.ndarray]
    columns: Flat | None
    rows: np.ndarray | None = None
    grid: Grid | None = None

    def of_one(self, where: slice) -> np.ndarray:
        """X'X of one candidate, shape (C, d, d)."""
        if self.grid is None:
            return self.gram[:, where, where]
        return np.asarray(self.gram[:, where.start // (where.stop - where.start)])


class Products:
    """Cache of products of one linearised model's columns: what it gives depends on the effects and their modes alone.

    Whatever takes a whole design keeps what is of its members. So no order of calls matters but for what is computed again.
    """

    def __init__(self, A: np.ndarray, r: np.ndarray, layout: FoldOrder, source: ColumnSource) -> None:
        """Start with the columns A of the constants, shape (N, m, K), and the residual r, shape (N, m)."""
        self.layout, self.r, self._source = layout, layout.flat(r), source
        self._columns: dict[Effect | None, Flat] = {None: layout.flat(A)}
        self._between: dict[tuple[Effect | None, Effect | None], np.ndarray] = {}
        self._solved: dict[tuple[int, int], tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._pull: dict[Effect | None, np.ndarray] = {}
        self._ordered: dict[tuple[str, Effect | None], np.ndarray] = {}
        self._of_limbs: dict[tuple[Effect | None, bytes], tuple[Flat, np.ndarray]] = {}
        self._local: dict[tuple[int, ...], LocalValues | None] = {}
        self._moved: dict[int, bytes] = {}
        self._moving: dict[tuple[int, ...], tuple[Flat, np.ndarray | None]] = {}
        self._known: dict[Effect, None] = {}
        self.constants: Member = None, np.eye(A.shape[2])
        self._place: dict[Effect, tuple[Chunk, slice]] = {}
        self._kept = 0
        self.squares = self._folds(self.r, self.r)

    def made_by(self, source: ColumnSource) -> Products:
        """These products, further columns made by a model that has further bases, after those of the model before."""
        more = copy(self)  # what is kept by effects and slots serves both
        more._source = source
        more._local = dict(self._local)  # a number beyond this model's functions is of another one in each that follows
        return more

    def flat(self, effects: Sequence[Effect]) -> Flat:
        """Columns of effects side by side, in the order of the folds."""
        return self._source.make(effects, None)

    def sums(self, members: Sequence[Member], together: bool) -> tuple[np.ndarray, np.ndarray]:
        """A'A and A'r of all rows for a design's P unknowns.

        Args:
            members: The design.
            together: Of the folds together, shape (C, P, P) and (C, P); otherwise of each of F, (F, C, P, P) and (F, C, P).
        """
        self._keep(members)

        def summed(of_folds: np.ndarray) -> np.ndarray:
            return np.asarray(of_folds.sum(axis=0)) if together else of_folds

        Ar = np.concatenate([summed(self.pull(effect)) @ modes for effect, modes in members], axis=-1)
        AA = np.empty((*Ar.shape, Ar.shape[-1]))
        for k, place in enumerate(places_of([modes.shape[1] for _, modes in members])):
            row = summed(np.concatenate([self.in_modes(members[k], other) for other in members[: k + 1]], axis=-1))
            AA[..., place, : place.stop] = row
            AA[..., : place.stop, place] = np.swapaxes(row, -1, -2)
        return AA, Ar

    def _keep(self, members: Sequence[Member]) -> None:
        """Keep what is of a design in use, and forget of the effects used longest ago if there is no room for all."""
        for effect, _ in members:
            if effect is not None:
                self._known[effect] = self._known.pop(effect, None)  # now the last
        if len(self._solved) > len(members) ** 2:
            now = {id(modes) for _, modes in members}
            self._solved = {key: products for key, products in self._solved.items() if now.issuperset(key)}
        most = max(MEMBERS, len(members))
        for old in list(self._known)[: max(len(self._known) - most, 0)]:
            self._forget(old)

    def forget(self) -> None:
        """Free all memory but the constants': no trial is to come."""
        for effect in list(self._known):
            self._forget(effect)
        self._solved.clear()
        self._place.clear()
        self._moving.clear()
        self._of_limbs.clear()
        self._kept = 0

    def _forget(self, effect: Effect) -> None:
        del self._known[effect]
        for of_one in (self._columns, self._pull):
            of_one.pop(effect, None)
        of_several: tuple[dict[Any, Any], ...] = (self._between, self._ordered, self._of_limbs)
        for products in of_several:
            for key in [key for key in products if effect in key]:
                del products[key]
        for chunk in {id(chunk): chunk for chunk, _ in self._place.values()}.values():
            if effect in chunk.across:
                self._kept -= chunk.across.pop(effect).size

    def in_order(self, of: str, order: np.ndarray, member: Effect | None) -> np.ndarray:
        """Columns of a member, rows in the order of the covariate ``of``, shape (N, m, d); they are kept."""
        if (of, member) not in self._ordered:
            place = np.argsort(self.layout.order)[order]
            parts = [x.reshape(len(place), -1, x.shape[1])[place] for x in self.columns(member)]
            self._ordered[of, member] = np.concatenate(parts, axis=1)
        return self._ordered[of, member]

    def columns(self, of: Effect | None) -> Flat:
        """Columns of an effect that is, or was, in the model (None: of the constants); they are kept."""
        if of not in self._columns:
            assert of is not None
            self._known.setdefault(of, None)
            self._columns[of] = self.flat([of])
        return self._columns[of]

    def between(self, a: Effect | None, b: Effect | None) -> np.ndarray:
        """Products of the columns of two members, shape (F, C, da, db)."""
        if (a, b) not in self._between:
            grid_a, grid_b = self._as_grid(a), self._as_grid(b)
            if grid_a is not None:
                products = self._folds_of_grid(grid_a, self.columns(b) if grid_b is None else grid_b)
            elif grid_b is not None:
                products = self._folds_of_grid(grid_b, self.columns(a)).transpose(0, 1, 3, 2)
            else:
                products = self._folds(self.columns(a), self.columns(b))
            self._between[a, b] = products
            self._between[b, a] = products.transpose(0, 1, 3, 2)
        return self._between[a, b]

    def in_modes(self, a: Member, b: Member) -> np.ndarray:
        """Products of two members' modes, shape (F, C, modes of a, modes of b): most stay from trial to trial."""
        key = id(a[1]), id(b[1])
        if key not in self._solved:  # kept with the modes themselves, so that no other array gets their identity
            self._solved[key] = a[1], b[1], np.ascontiguousarray(a[1].T) @ self.between(a[0], b[0]) @ b[1]
        return self._solved[key][2]

    def pull(self, of: Effect | None) -> np.ndarray:
        """Products of a member's columns with the residual, shape (F, C, d)."""
        if of not in self._pull:
            self._pull[of] = self._folds(self.columns(of), self.r)
        return self._pull[of]

    def _folds(self, X: Flat, Y: Flat) -> np.ndarray:
        """Products of columns fold by fold, shape (F, C, ...)."""
        stretches = zip(*(self.layout.stretches(channel.size) for channel in self.layout.channels), strict=True)
        return np.array([[x[part].T @ y[part] for x, y, part in zip(X, Y, fold, strict=True)] for fold in stretches])

    def _folds_of_grid(self, grid: Grid, Y: Flat | Grid) -> np.ndarray:
        """Products of a grid's columns with others, fold by fold, shape (F, C, w, d)."""
        per_fold = []
        for low, high in pairwise(self.layout.starts.tolist()):
            if isinstance(Y, Grid):
                per_fold.append(grid.part(low, high).across_grid(Y.part(low, high)))
            else:
                parts = [y[low * c.size : high * c.size] for y, c in zip(Y, self.layout.channels, strict=True)]
                per_fold.append(grid.part(low, high).across(parts))
        return np.array(per_fold)

    def _as_grid(self, member: Effect | None) -> Grid | None:
        """The one slot and the functions on knots that make an effect's columns; None if they are not so made."""
        factors = None if member is None else self._source.apart(member)
        functions = None if factors is None or len(factors[0]) > 1 else self._functions(factors[1])
        return None if factors is None or functions is None else grid_of(*self._slots(factors[0]), functions)

    def chunks(self, effects: Sequence[Effect]) -> Iterator[Chunk]:
        """Chunks that hold some candidates, computed where there is none yet, and kept as long as there is room."""
        places = [self._place.get(e) for e in effects]
        new = [e for e, place in zip(effects, places, strict=True) if place is None]
        yield from {id(place[0]): place[0] for place in places if place is not None}.values()
        grids, others = self._grids(new)
        of_grids = (self._grid(*grid) for grid in grids)
        for chunk in chain(
            of_grids, (self.chunk(group, rows) for rows, members in others for group in grouped(members))
        ):
            if self._room(chunk.gram.size):
                room = self._room(sum(x.size for x in chunk.columns or ()), KEPT_NUMBERS // 2)
                stored = chunk if room else replace(chunk, columns=None)
                for effect, part in column_places(chunk.effects):
                    self._place[effect] = stored, part
            yield chunk

    def _functions(self, bases: tuple[int, ...]) -> LocalValues | None:
        """Values of functions on knots; None if they are not local."""
        if bases not in self._local:
            self._local[bases] = local(self._source.functions(bases))
        return self._local[bases]

    def _slots(self, slots: tuple[int, ...]) -> tuple[Flat, np.ndarray | None]:
        """Columns of some slots in the rows that they move, (n, size, slots) for each channel, and those rows; they are kept."""
        if slots not in self._moving:
            self._moving[slots] = moving_slots(self._source.slots(slots))
        return self._moving[slots]

    def _grids(
        self, effects: Sequence[Effect]
    ) -> tuple[list[tuple[tuple[int, ...], dict[Effect, int]]], list[tuple[np.ndarray | None, list[Effect]]]]:
        """Candidates of the same functions that move the same rows, with their slots; the others by the rows that they move."""
        alike: dict[tuple[tuple[int, ...], bytes], dict[Effect, int]] = {}
        moved = {}
        for effect in effects:
            slots, bases = self._source.apart(effect) or ((), ())
            moved[effect] = self._rows_moved(slots)
            if effect.smooth and len(slots) == 1:
                alike.setdefault((bases, moved[effect]), {})[effect] = slots[0]
        grids = [
            (b, members)
            for (b, _), members in alike.items()
            if len(members) >= LEAST_GRID_CANDIDATES and self._functions(b) is not None
        ]
        others: dict[bytes, list[Effect]] = {}
        of_grids = {effect for _, members in grids for effect in members}
        for effect in effects:
            if effect not in of_grids:
                others.setdefault(moved[effect], []).append(effect)
        return grids, [(np.frombuffer(key, dtype=np.intp) if key else None, members) for key, members in others.items()]

    def _rows_moved(self, slots: Sequence[int]) -> bytes:
        """Places of the rows that slots move; none if those are nearly all, or not the same for each of them."""
        for slot in slots:
            if slot not in self._moved:
                rows = moved_rows(self._source.slots([slot]))
                self._moved[slot] = b"" if rows is None else rows.tobytes()
        keys = {self._moved[slot] for slot in slots}
        return keys.pop() if len(keys) == 1 else b""

    def _grid(self, bases: tuple[int, ...], effects: dict[Effect, int]) -> Chunk:
        """Candidates of the same functions multiplied together."""
        functions = self._functions(bases)
        assert functions is not None
        grid = grid_of(*self._slots(tuple(effects.values())), functions)
        return Chunk(tuple(effects), grid.gram(), grid.pull(self.r), {}, None, grid.rows, grid)

    def _room(self, numbers: int, most: int = KEPT_NUMBERS) -> bool:
        """True, and the numbers counted, if there is room for so many more."""
        room = self._kept + numbers <= most
        self._kept += numbers if room else 0
        return room

    def chunk(self, effects: Sequence[Effect], rows: np.ndarray | None = None) -> Chunk:
        """Candidates multiplied together, zero but in some rows if these are given; they are not kept."""
        X = self._source.make(effects, rows)
        gram = np.zeros((len(X), X[0].shape[1], X[0].shape[1]))
        for low, high in pieces(effects):
            for values, x in zip(gram, X, strict=True):
                values[low:high, low:high] = x[:, low:high].T @ x[:, low:high]
        right = self.r if rows is None else [r[n] for r, n in zip(self.r, self.layout.numbers(rows), strict=True)]
        pull = np.array([x.T @ r for x, r in zip(X, right, strict=True)])
        return Chunk(tuple(effects), gram, pull, {}, X, rows)

    def chunk_of(self, effect: Effect) -> tuple[Chunk, slice]:
        """The chunk of a candidate, and its columns there: a chunk of the library, or one of its own."""
        return self._place.get(effect) or (self.chunk([effect]), slice(None))

    def rows_of(self, chunk: Chunk, places: np.ndarray) -> list[np.ndarray]:
        """Columns of a chunk in some rows, given by their places in the order of the folds, shape (rows size, w) a channel."""
        if chunk.columns is None or chunk.rows is not None:
            return list(self._source.make(chunk.effects, places))
        return [x[rows] for x, rows in zip(chunk.columns, self.layout.numbers(places), strict=True)]

    def across(self, chunk: Chunk, members: Sequence[Member]) -> list[np.ndarray]:
        """Products of a chunk's columns with those of each member of the design, shape (C, w, d) each."""
        self._keep(members)
        products = {effect: chunk.across.get(effect) for effect, _ in members}
        new = [effect for effect, product in products.items() if product is None]
        X = (chunk.columns or self._source.make(chunk.effects, chunk.rows)) if new and chunk.grid is None else ()
        for effect in new:
            grid = self._as_grid(effect)
            if chunk.grid is not None and grid is not None:
                product = chunk.grid.across_grid(grid)
            elif grid is not None and chunk.rows is None:
                product = grid.across(X).transpose(0, 2, 1)
            else:
                product = self._with_columns(chunk, X, effect)
            products[effect] = product
            if chunk.effects[0] in self._place and self._room(product.size):
                chunk.across[effect] = product
        return [product for product in products.values() if product is not None]

    def _with_columns(self, chunk: Chunk, X: Flat, member: Effect | None) -> np.ndarray:
        """Products of a chunk's columns X (a grid has none) with those of a member, shape (C, w, d)."""
        Y = self.columns(member)
        limbs = [chunk.rows] if chunk.rows is not None else self._limbs if chunk.grid is not None else []
        if not limbs:
            return chunk.grid.across(Y) if chunk.grid else np.array([x.T @ y for x, y in zip(X, Y, strict=True)])
        products = np.zeros((len(Y), chunk.pull.shape[1], Y[0].shape[1]))
        for rows in limbs:
            columns, some = self._in_rows(member, rows)
            if chunk.grid is not None:
                products[:, :, some] += chunk.grid.among(rows).across(columns)
            else:
                products[:, :, some] = [x.T @ y for x, y in zip(X, columns, strict=True)]
        return products

    @cached_property
    def _limbs(self) -> list[np.ndarray]:
        """Places of the rows that the same constants move, limb by limb; none where these are all rows, or hardly any."""
        by_row = [y.reshape(len(self.layout.order), -1, y.shape[1]) for y in self.columns(None)]
        moved = np.packbits(np.any([y.any(axis=1) for y in by_row], axis=0), axis=1)
        kinds, number = np.unique(moved, axis=0, return_inverse=True)
        return [np.flatnonzero(number == k) for k in range(len(kinds))] if 1 < len(kinds) <= MOST_ROW_KINDS else []

    def _in_rows(self, member: Effect | None, rows: np.ndarray) -> tuple[Flat, np.ndarray]:
        """Columns of a member that are not zero in a limb's rows, in these rows, and their numbers; they are kept."""
        key = member, rows.tobytes()
        if key not in self._of_limbs:
            here = [y[n] for y, n in zip(self.columns(member), self.layout.numbers(rows), strict=True)]
            some = np.flatnonzero(np.any([y.any(axis=0) for y in here], axis=0))
            self._of_limbs[key] = tuple(y[:, some] for y in here), some
        return self._of_limbs[key]


def grouped(effects: Sequence[Effect]) -> list[list[Effect]]:
    """Candidates in groups of about :data:`COLUMNS_PER_CHUNK` columns."""
    groups: list[list[Effect]] = []
    size = COLUMNS_PER_CHUNK
    for effect in effects:
        if size + len(effect.coefficients) > COLUMNS_PER_CHUNK:
            groups.append([])
            size = 0
        groups[-1].append(effect)
        size += len(effect.coefficients)
    return groups


def pieces(effects: Sequence[Effect]) -> list[tuple[int, int]]:
    """First column, and one beyond the last, of pieces of whole candidates, about :data:`COLUMNS_PER_PIECE` columns each."""
    ends = [0]
    end = 0
    for k, effect in enumerate(effects):
        end += len(effect.coefficients)
        if end - ends[-1] >= COLUMNS_PER_PIECE or k == len(effects) - 1:
            ends.append(end)
    return list(pairwise(ends))


def column_places(effects: Sequence[Effect]) -> list[tuple[Effect, slice]]:
    """Effects with the places of their columns, side by side."""
    return list(zip(effects, places_of([len(e.coefficients) for e in effects]), strict=True))


def places_of(sizes: Sequence[int]) -> list[slice]:
    """Places of parts with these numbers of columns, one after the other."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(low, high) for low, high in pairwise(ends)]
