"""Rows that repeat a configuration, or another row; and an order of rows that is not that of their file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from aridcal.robot.chain import JointKind

SAME_ANGLE, SAME_LENGTH = 1e-3, 1e-4  # readings this close repeat one configuration, [rad] and [m]

BOX = 32.0
"""Cells along a box in which rows are looked for that repeat one another: few share one by chance, and few stand at its edge."""


CENTRES, COMPARED = 200, 20_000
"""Rows whose distances to others tell whether rows lie in places, and rows that they are compared with."""

GAP = 2.0
"""Factor on either side of a distance within which next to no pair of rows is apart, where rows lie in places."""

IN_GAP = 0.02
"""Pairs in that gap, as a share of those that are closer: a stray row or two may lie between places."""

SMALL = 1 / 3
"""Of the median difference of two rows in any joint that moves, what the upper end of the gap may be: among few rows some are
nearest by chance, and the stops of a rail are no places where the arm on it stands otherwise at each row."""

MOVES = 30.0
"""Of what repeats a configuration: a joint moves if half of all rows differ by more, 30 mrad or 3 mm; less is scatter."""

ACCOMPANIED = 0.3
"""Share of rows that have others at their place, from which rows are said to lie in places."""

FEWEST_PLACES = 8
"""Places below which rows are not taken together by them: too few to hold any back."""


def blocks(readings: np.ndarray, kinds: Sequence[JointKind], scale: float = 1.0) -> np.ndarray:
    """Number the configurations: rows that repeat one have the same label.

    Rows within 1 mrad and 0.1 mm of each other, or joined by a chain of such rows, always share a label; rows more
    than 1.5 times as far apart do only through a chain. On `continuous` joints whole turns do not count.

    Args:
        readings: Shape (N, columns), [rad] or [m].
        kinds: Kind of each column.
        scale: How many times these distances.

    Returns:
        Labels 0, 1, ... in order of appearance, shape (N,).
    """
    label = np.arange(len(readings))
    near = _near_others(readings, kinds, scale)
    if len(near):
        label[near] = len(readings) + _chained(np.column_stack([*_cells(readings[near], kinds, scale)]))
    return by_appearance(label)


def places(readings: np.ndarray, kinds: Sequence[JointKind]) -> np.ndarray:
    """Number the places in which rows were measured: configurations, or groups of near ones with nothing between them.

    Whoever measures a place several times does not come back to the same millidegree. Rows lie in places if there is a distance
    wide of all others: next to no pair of rows is apart by half to twice of it, and many rows have others that are closer.

    Args:
        readings: Shape (N, columns), [rad] or [m].
        kinds: Kind of each column.

    Returns:
        Labels 0, 1, ... in order of appearance, shape (N,); those of :func:`blocks` where rows do not lie in places.
    """
    label = blocks(readings, kinds)
    distance = _gap(readings, kinds)
    if distance is None:
        return label
    wider = blocks(readings, kinds, distance)
    return wider if wider.max() + 1 >= FEWEST_PLACES else label


def _gap(readings: np.ndarray, kinds: Sequence[JointKind]) -> float | None:
    """The distance, in what repeats a configuration, that parts places; None where there is none."""
    if len(readings) < 2 * FEWEST_PLACES:
        return None
    rng = np.random.default_rng(0)
    some = rng.permutation(len(readings))[:COMPARED]
    points = np.column_stack([cell / 2.0 for cell in _cells(readings[some], kinds, 1.0)])
    differences = np.abs(points[None, :] - points[:CENTRES, None])
    apart, usual = differences.max(axis=2), np.median(differences, axis=(0, 1))
    nearest = np.sort(apart, axis=1)[:, 1]  # the first is the row itself
    pairs = np.sort(apart, axis=None)
    typical = float(np.min(usual, where=usual > MOVES, initial=np.inf))
    if not np.isfinite(typical):
        return None
    best = None
    for edge in np.geomspace(1.0, max(typical, 1.0), 200)[1:]:
        low, high = edge / GAP, edge * GAP
        if high > SMALL * typical:
            break
        closer = int(np.searchsorted(pairs, low)) - len(apart)
        between = int(np.searchsorted(pairs, high)) - len(apart) - closer
        if between <= IN_GAP * closer and np.mean(nearest < low) >= ACCOMPANIED:
            best = float(edge)
    return best


def _cells(readings: np.ndarray, kinds: Sequence[JointKind], scale: float) -> Iterator[np.ndarray]:
    """Numbers of cells along each coordinate, shape (N,) each: half as large as what repeats one, however often that is."""
    for reading, kind, same in zip(readings.T, kinds, tolerances(kinds).tolist(), strict=True):
        for value in (np.cos(reading), np.sin(reading)) if kind == "continuous" else (reading,):
            yield np.floor(2.0 * value / (scale * same))


def _near_others(readings: np.ndarray, kinds: Sequence[JointKind], scale: float) -> np.ndarray:
    """Rows that may be less than three cells from another along every coordinate, in order: all that are, and few others.

    Those share a box of :data:`BOX` cells, where a row also counts to the box below along each coordinate in which it is one of
    its box's first two cells. Boxes are told apart by sums of their numbers times large odd ones: two of one sum cost time alone.
    """
    odd = np.random.default_rng(0)
    key, row = np.zeros(len(readings), dtype=np.int64), np.arange(len(readings))
    for cell in _cells(readings, kinds, scale):
        box, place = np.divmod(cell, BOX)
        factor = 2 * odd.integers(2**62) + 1
        key += (box.astype(np.int64) * factor)[row]
        low = np.flatnonzero((place < 2.0)[row])
        key, row = np.concatenate([key, key[low] - factor]), np.concatenate([row, row[low]])
    order = np.argsort(key)
    alike = key[order[1:]] == key[order[:-1]]
    shared = np.zeros(len(readings), dtype=bool)
    shared[row[order[1:][alike]]] = shared[row[order[:-1][alike]]] = True
    return np.flatnonzero(shared)


def _chained(cells: np.ndarray) -> np.ndarray:
    """Labels of rows in these cells, shape (N, coordinates), of which chains of neighbours share one, shape (N,)."""
    # slow to load, and most tables repeat nothing
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    cells, cell = np.unique(cells, axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(2.5, p=np.inf, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    _, label = connected_components(graph, directed=False)
    return np.asarray(label[cell.reshape(-1)])


def by_appearance(labels: np.ndarray) -> np.ndarray:
    """The same labels, whole numbers from 0 on, as 0, 1, ... in order of appearance, shape (N,)."""
    labels = np.asarray(labels, dtype=int)
    first = np.zeros(labels.max(initial=-1) + 1, dtype=int)
    first[labels[::-1]] = np.arange(len(labels))[::-1]  # of several the last that is written stays
    number = np.cumsum(first[labels] == np.arange(len(labels))) - 1
    return np.asarray(number[first[labels]])


def first_alike(columns: Iterable[np.ndarray]) -> np.ndarray:
    """For each row the number of the first that equals it in all columns, holes included, shape (N,).

    Args:
        columns: Numbers or words of N rows, one at least, shape (N,) each.
    """
    first, group = np.empty(0, dtype=int), np.array(0)
    for k, column in enumerate(columns):
        # Numbers with noise differ in the first column already: most tables end here.
        if not k and _all_different(column):
            return np.arange(len(column))
        _, number = np.unique(column, return_inverse=True)
        _, first, group = np.unique(
            group * (number.max(initial=0) + 1) + number, return_index=True, return_inverse=True
        )
        if len(first) == len(number):
            return first[group]
    return first[group]


def _all_different(column: np.ndarray) -> bool:
    """True if no value is there twice, and no two are missing."""
    in_order = np.sort(column)
    return not np.any((in_order[1:] == in_order[:-1]) | (in_order[1:] != in_order[1:]))


def by_content(columns: Sequence[np.ndarray | None]) -> np.ndarray:
    """Numbers of the rows in the order of their values, shape (N,): the same rows, however they were permuted before.

    Args:
        columns: What the rows hold, shape (N,) or (N, k) each; the first decides first, missing values come last.
    """
    keys = [key for column in columns if column is not None for key in np.atleast_2d(column.T)]
    order = np.argsort(keys[0], kind="stable")
    after = keys[0][order]
    alike = (after[1:] == after[:-1]) | (after[1:] != after[1:])  # missing ones stand together at the end
    if not alike.any():
        return order
    tied = np.zeros(len(order), dtype=bool)
    tied[1:] = alike
    tied[:-1] |= alike
    some = order[tied]
    order[tied] = some[np.lexsort([key[some] for key in reversed(keys)])]
    return order


def tolerances(kinds: Sequence[JointKind]) -> np.ndarray:
    """How far readings of each kind may be apart and still repeat a configuration, [rad] or [m], shape (columns,)."""
    return np.where([kind == "prismatic" for kind in kinds], SAME_LENGTH, SAME_ANGLE)
