r"""Columns that are each a slot's times a function on knots, and their products, without the columns.

Of slots :math:`g_e` (so many numbers a row and channel) and functions :math:`\varphi_i` the column (e, i) is
:math:`g_e(n) \varphi_i(n)`, and with another such column (t, j)

.. math:: \sum_n \varphi_i(n) \psi_j(n) \; g_e(n) \cdot g_t(n)

At each row all but k of the functions are zero (4 of cubic B-splines), so that of d functions and d' others not
:math:`d d'`, but :math:`k k'` products a row are to be made, for all slots at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

SPARSE = 3
"""Work: Functions for each one that is not zero at a row from which they count as local: the sums over all cost as much below
it."""


FULL = 0.9
"""Work: Share of the rows that a limb's slots move from which leaving out the others costs as much as it saves."""


@dataclass(frozen=True)
class LocalValues:
    """Values of d functions at N rows, of which at most k are not zero at a row.

    Attributes:
        values: Shape (N, k).
        numbers: Which function each is of, shape (N, k).
        count: d.
    """

    values: np.ndarray
    numbers: np.ndarray
    count: int

    def times(self, other: LocalValues) -> LocalValues:
        """All products of two functions: i of the first and j of the second is number i d' + j."""
        shape = len(self.values), self.values.shape[1] * other.values.shape[1]  # there may be no row that both have
        values = (self.values[:, :, None] * other.values[:, None, :]).reshape(shape)
        numbers = (self.numbers[:, :, None] * other.count + other.numbers[:, None, :]).reshape(shape)
        return LocalValues(values, numbers, self.count * other.count)

    def at(self, rows: np.ndarray) -> LocalValues:
        """The functions at some rows."""
        return LocalValues(self.values[rows], self.numbers[rows], self.count)

    def part(self, low: int, high: int) -> LocalValues:
        """The functions at rows ``low`` to ``high``; they are kept."""
        if (low, high) not in self._parts:
            self._parts[low, high] = LocalValues(self.values[low:high], self.numbers[low:high], self.count)
        return self._parts[low, high]

    def sums(self, weights: np.ndarray) -> np.ndarray:
        """Sums over the rows of each function times weights of shape (N, w), shape (d, w)."""
        return np.asarray(self._over_rows @ weights)

    @cached_property
    def _parts(self) -> dict[tuple[int, int], LocalValues]:
        return {}

    @cached_property
    def _over_rows(self) -> csc_array:
        """Functions by rows, shape (d, N)."""
        rows, k = self.values.shape
        ends = np.arange(0, rows * k + 1, k)
        return csc_array((self.values.ravel(), self.numbers.ravel(), ends), shape=(self.count, rows))


def local(values: np.ndarray) -> LocalValues | None:
    """Functions of shape (N, d) as local ones; None if they are not."""
    k = int(np.count_nonzero(values, axis=1).max(initial=1))
    if k * SPARSE > values.shape[1]:
        return None
    numbers = np.argsort(values == 0.0, axis=1, kind="stable")[:, :k]
    return LocalValues(np.take_along_axis(values, numbers, axis=1), numbers, values.shape[1])


@dataclass(frozen=True)
class Grid:
    """Columns of E slots times d functions each, those of one slot side by side: w = E d columns, C channels.

    Attributes:
        slots: Columns of the slots, (n, size, E) for each channel, in the rows in which one of them is not zero.
        functions: The functions in those rows.
        rows: Numbers of these n rows among all N; None if they are all.
    """

    slots: tuple[np.ndarray, ...]
    functions: LocalValues
    rows: np.ndarray | None = None

    def gram(self) -> np.ndarray:
        """Products of the columns of each slot with one another, shape (C, E, d, d)."""
        products = self._summed(self.functions.times(self.functions), [np.sum(g**2, axis=1) for g in self.slots])
        d = self.functions.count
        return np.ascontiguousarray(products.reshape(*products.shape[:2], d, d))

    def pull(self, right: Sequence[np.ndarray]) -> np.ndarray:
        """Products with right-hand sides of shape (N size,), one for each channel, shape (C, w)."""
        weights = [
            np.einsum("nse,ns->ne", g, self._here(r, g)[:, :, 0]) for g, r in zip(self.slots, right, strict=True)
        ]
        return self._summed(self.functions, weights).reshape(len(self.slots), -1)

    def across(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """Products with any columns, (N size, d') for each channel, shape (C, w, d')."""
        per_channel = []
        for g, y in zip(self.slots, columns, strict=True):
            rows, _, count = g.shape
            products = g.transpose(0, 2, 1) @ self._here(y, g)
            summed = self.functions.sums(products.reshape(rows, count * products.shape[2]))
            summed = summed.reshape(self.functions.count, count, -1)
            per_channel.append(summed.transpose(1, 0, 2).reshape(count * self.functions.count, -1))
        return np.array(per_channel)

    def across_grid(self, other: Grid) -> np.ndarray:
        """Products with the columns of one slot times d' other functions, shape (C, w, d')."""
        one, two = (self, other) if self.rows is other.rows is None else _common(self, other)
        weights = [np.einsum("nse,ns->ne", g, t[:, :, 0]) for g, t in zip(one.slots, two.slots, strict=True)]
        together = self._summed(one.functions.times(two.functions), weights)
        return together.reshape(len(self.slots), -1, two.functions.count)

    def among(self, rows: np.ndarray) -> Grid:
        """The grid of some rows, as if there were no others."""
        return replace(self, rows=None) if rows is self.rows else _rows_of_grid(self, rows, None)

    def part(self, low: int, high: int) -> Grid:
        """The grid of rows ``low`` to ``high``."""
        if self.rows is None:
            return Grid(tuple(g[low:high] for g in self.slots), self.functions.part(low, high))
        first, last = np.searchsorted(self.rows, (low, high)).tolist()
        slots = tuple(g[first:last] for g in self.slots)
        return Grid(slots, self.functions.part(first, last), self.rows[first:last] - low)

    def _here(self, values: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """Numbers of all N rows, shape (N size, ...), cut to the grid's rows, shape (n, size, k)."""
        by_row = values.reshape(len(values) // slots.shape[1], slots.shape[1], -1)
        return by_row if self.rows is None else by_row[self.rows]

    def _summed(self, functions: LocalValues, weights: Sequence[np.ndarray]) -> np.ndarray:
        """Sums of functions times weights of shape (n, E) for each channel, shape (C, E, functions)."""
        together = functions.sums(np.hstack(weights))
        return together.reshape(functions.count, len(weights), -1).transpose(1, 2, 0)


def moved_rows(slots: tuple[np.ndarray, ...]) -> np.ndarray | None:
    """Rows in which one of some slots, (N, size, E) for each channel, is not zero; None if they are nearly all."""
    moved = np.any([np.any(g != 0.0, axis=(1, 2)) for g in slots], axis=0)
    return None if np.mean(moved) > FULL else np.flatnonzero(moved)


def moving_slots(slots: tuple[np.ndarray, ...]) -> tuple[tuple[np.ndarray, ...], np.ndarray | None]:
    """Slots cut to the rows that they move, and the numbers of these rows: on other paths their columns are zero."""
    rows = moved_rows(slots)
    return (slots if rows is None else tuple(g[rows] for g in slots)), rows


def grid_of(slots: tuple[np.ndarray, ...], rows: np.ndarray | None, functions: LocalValues) -> Grid:
    """The grid of slots cut by :func:`moving_slots` and of functions in all N rows."""
    return Grid(slots, functions if rows is None else functions.at(rows), rows)


def _rows_of_grid(whole: Grid, some: np.ndarray, rows: np.ndarray | None) -> Grid:
    """The grid of some rows, given by their places in it and by their numbers among all."""
    return Grid(tuple(g[some] for g in whole.slots), whole.functions.at(some), rows)


def _common(one: Grid, other: Grid) -> tuple[Grid, Grid]:
    """Two grids cut to the rows that both have."""
    rows = [np.arange(len(g.functions.values)) if g.rows is None else g.rows for g in (one, other)]
    both, first, second = np.intersect1d(rows[0], rows[1], assume_unique=True, return_indices=True)
    return _rows_of_grid(one, first, both), _rows_of_grid(other, second, both)
