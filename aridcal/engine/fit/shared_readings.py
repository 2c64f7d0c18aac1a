"""Rows that were measured while the arm stood still: all marks in one image, several wires read at once.

An error of a reading is the same in all of them, so that their numbers are one vector with one covariance: one row of a
:class:`Scatter`. Unknown things that they refer to belong together as well, in one of its clumps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from aridcal.engine.fit.least_squares import thin
from aridcal.engine.fit.problem import Problem
from aridcal.engine.fit.scatter import Scatter, full_rank
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.repeats import by_appearance, earlier_occurrences, first_alike

MOST_STANDSTILL_ROWS = 24
"""Work: Rows of one standstill that are asked about at the most: an error that is common to them shows in these, and a
covariance costs the cube of its numbers."""

MOST_CLUMP_UNKNOWNS = 120
"""Work: Unknowns of things in one clump at the most, if it has several groups: forty markers seen together. More would be
columns of all their images, and tell no more of a reading that these images share."""

ROWS_LEFT_OF_A_THING = 10
"""Work: Rows of each group that a random choice of rows must leave on the average: else whole groups are chosen, for one row of
a thing tells of nothing else."""


def standstills(rows: Dataset) -> np.ndarray:
    """Number of each row's standstill, shape (N,), in order of appearance.

    Rows of one standstill have the same readings, bit for bit, and measure different things or with different instruments.
    Where the same is measured again, the arm was there again. Plain poses are each their own.
    """
    if rows.direct:
        return np.arange(len(rows))
    target = np.zeros(len(rows), dtype=str) if rows.labels.target is None else rows.labels.target
    same = first_alike([*rows.readings.T, rows.labels.block, target, *rows.labels.refers.T])
    return by_appearance(first_alike([*rows.readings.T, earlier_occurrences(same)]))


def clumps(standstill: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Number of the clump of each row, shape (N,): groups of unknown things that standstills join; -1 for rows of no group.

    Args:
        standstill: Of each row, shape (N,).
        group: Of each row, shape (N,); -1 for none.
    """
    grouped = group >= 0
    clump = np.full(len(group), -1)
    if not grouped.any():
        return clump
    groups, number = np.unique(group[grouped], return_inverse=True)
    count = int(standstill.max()) + 1
    pairs = coo_array((np.ones(len(number)), (standstill[grouped], count + number)), shape=(count + len(groups),) * 2)
    _, label = connected_components(pairs, directed=False)
    label_of_row = label[standstill]
    with_things = np.isin(label_of_row, label_of_row[grouped])
    clump[with_things] = np.unique(label_of_row[with_things], return_inverse=True)[1]
    return clump


def representative(every: Problem, among: np.ndarray, most: int) -> np.ndarray:
    """Row numbers: all, or of many rows a reproducible choice of whole standstills, or of whole groups.

    Where more things are joined than can be carried as columns, those that most rows refer to are chosen.

    Args:
        every: A problem of N rows.
        among: Numbers of the rows that may be chosen.
        most: Rows at the most.
    """
    if every.data.direct:
        return among[thin(every.rows[among], most)]
    return among[_of_things(every.select(among), most)]


def _of_things(question: Problem, most: int) -> np.ndarray:
    """Row numbers as of :func:`representative`, for rows that refer to things; all rows may be chosen."""
    data, rng, group = question.data, np.random.default_rng(0), question.group_of(slice(None))
    number = standstills(data)
    candidates = np.arange(len(data))
    if question.groups is not None:
        candidates = np.flatnonzero(_few_enough(clumps(number, group), group, question.groups.unknown.sum(axis=1)))
    mixed = np.random.RandomState(0).permutation(candidates)
    candidates = np.sort(mixed[earlier_occurrences(number[mixed]) < MOST_STANDSTILL_ROWS])
    if len(candidates) <= most:
        return candidates
    stills = np.unique(number[candidates])
    pairs_of_groups = np.unique(np.column_stack([number, group])[candidates], axis=0)
    by_group = len(pairs_of_groups) == len(stills) and most < ROWS_LEFT_OF_A_THING * len(np.unique(group[candidates]))
    _, piece = np.unique((group if by_group else number)[candidates], return_inverse=True)
    turn = rng.permutation(int(piece.max()) + 1)[piece]
    return np.asarray(candidates[turn <= np.partition(turn, most)[most]])


def _few_enough(clump: np.ndarray, group: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Rows of no group, and of each clump's groups, the largest up to :data:`MOST_CLUMP_UNKNOWNS` unknowns, (N,) bool.

    Args:
        clump: Of each row, shape (N,).
        group: Of each row, shape (N,); -1 for none.
        size: Unknowns of each group, shape (G,).
    """
    keep = group < 0
    groups, first, count = np.unique(group[~keep], return_index=True, return_counts=True)
    of_clump = clump[~keep][first]
    order = np.lexsort((groups, -count, of_clump))
    groups, of_clump = groups[order], of_clump[order]
    before = _sum_before(of_clump, size[groups])
    return np.asarray(keep | np.isin(group, groups[(before == 0) | (before + size[groups] <= MOST_CLUMP_UNKNOWNS)]))


def _sum_before(label: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Sum of the sizes (n,) before each entry among the entries of its label (n,); labels count from -1 or 0."""
    order = np.argsort(label, kind="stable")
    total = np.cumsum(size[order]) - size[order]
    starts = np.diff(label[order], prepend=-2) > 0
    before = np.empty(len(label), dtype=int)
    before[order] = total - np.maximum.accumulate(np.where(starts, total, 0))
    return before


@dataclass(frozen=True)
class Stack:
    """Where the m numbers of each of n rows are in the vectors of S standstills.

    Attributes:
        number: Number of each row's standstill, shape (n,).
        place: Place of each number in its standstill's vector, shape (n, m); -1 where a row does not measure it.
        count: Number of standstills, S.
        width: Length of the longest vector, M.
    """

    number: np.ndarray
    place: np.ndarray
    count: int
    width: int

    @property
    def apart(self) -> bool:
        """True where each row is a standstill of its own, in their order, and measures all numbers."""
        in_order = self.place.shape == (self.count, self.width) and np.array_equal(self.number, np.arange(self.count))
        return in_order and bool(np.all(self.place == np.arange(self.width)))

    def vectors(self, values: np.ndarray) -> np.ndarray:
        """Numbers or columns of rows, shape (n, m, ...), as vectors of standstills, shape (S, M, ...), filled up with 0."""
        if self.apart:
            return values
        stacked = np.zeros((self.count, self.width, *values.shape[2:]))
        row, column = np.nonzero(self.place >= 0)
        stacked[self.number[row], self.place[row, column]] = values[row, column]
        return stacked

    def matrices(self, values: np.ndarray) -> np.ndarray:
        """Covariances of rows that err independently, shape (n, m, m), as those of standstills, shape (S, M, M)."""
        if self.apart:
            return values
        stacked = np.zeros((self.count, self.width, self.width))
        row, a, b = np.nonzero((self.place[:, :, None] >= 0) & (self.place[:, None, :] >= 0))
        stacked[self.number[row], self.place[row, a], self.place[row, b]] = values[row, a, b]
        return stacked

    def of_rows(self, values: np.ndarray) -> np.ndarray:
        """Vectors of standstills, shape (S, M), as numbers of rows, shape (n, m); 0 where a row does not measure one."""
        return np.where(self.place >= 0, values[self.number[:, None], self.place], 0.0)

    def blocks_of_rows(self, values: np.ndarray) -> np.ndarray:
        """The rows' own blocks of matrices of standstills, shape (S, M, M) to (n, m, m)."""
        there = (self.place[:, :, None] >= 0) & (self.place[:, None, :] >= 0)
        blocks = values[self.number[:, None, None], self.place[:, :, None], self.place[:, None, :]]
        return np.where(there, blocks, 0.0)


def stack(standstill: np.ndarray, there: np.ndarray) -> Stack:
    """Put the numbers of rows of one standstill under one another.

    Args:
        standstill: Of each row, shape (n,).
        there: Which numbers each row measures, shape (n, m) bool.
    """
    names, number = np.unique(standstill, return_inverse=True)
    before = _sum_before(number, there.sum(axis=1))
    place = np.where(there, before[:, None] + np.cumsum(there, axis=1) - 1, -1)
    return Stack(number, place, len(names), int(place.max(initial=0)) + 1)


def with_things(scatter: Scatter, part: Problem, B: np.ndarray, still: Stack) -> Scatter:
    """The scatter with columns of the unknowns of the rows' groups, and prior knowledge of these as rows behind.

    Args:
        scatter: Of the standstills of a problem's rows.
        part: The problem.
        B: Columns of the unknowns of the rows' groups, shape (n, m, U).
        still: How the rows are stacked.
    """
    group, beforehand = part.group_of(slice(None)), part.beforehand()
    if part.groups is None or beforehand is None or not (group >= 0).any():
        return scatter
    unknown, clump = part.groups.unknown, clumps(still.number, group)
    groups, first = np.unique(group[group >= 0], return_index=True)
    clump_of = np.full(len(unknown), -1)
    clump_of[groups] = clump[group >= 0][first]
    size = unknown.sum(axis=1)
    offset = _sum_before(clump_of, size)
    width = int((offset + size)[clump_of >= 0].max())

    def wide(values: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Columns of groups' unknowns, shape (n, m, U), as columns of their clumps' unknowns."""
        columns = np.zeros((*values.shape[:2], width))
        row, slot = np.nonzero(unknown[of] & (of >= 0)[:, None])
        columns[row, :, offset[of[row]] + slot] = values[row, :, slot]
        return columns

    of_standstill = np.full(still.count, -1)
    of_standstill[still.number] = clump
    of_groups = np.isin(beforehand.group, groups)
    of_known, count = beforehand.group[of_groups], int(of_groups.sum())
    facts = np.zeros((count, still.width, unknown.shape[1]))
    facts[:, 0] = beforehand.by[of_groups]
    y = np.zeros((count, still.width))
    y[:, 0] = beforehand.misfit[of_groups]
    behind = replace(
        scatter,
        y=np.concatenate([scatter.y, y]),
        A=np.concatenate([scatter.A, np.zeros((count, *scatter.A.shape[1:]))]),
        blocks=np.concatenate([scatter.blocks, np.zeros((len(scatter.blocks), count, *(still.width,) * 2))], axis=1),
        things=np.concatenate([still.vectors(wide(B, group)), wide(facts, of_known)]),
        clump=np.concatenate([of_standstill, clump_of[of_known]]),
    )
    return full_rank(behind)
