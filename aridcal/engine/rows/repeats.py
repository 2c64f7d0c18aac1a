"""Rows that repeat a configuration, or another row; and an order of rows that is not that of their file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from aridcal.engine.robot.chain import JointKind

SAME_ANGLE, SAME_LENGTH = 1e-3, 1e-4
"""[rad], [m]: readings this close repeat one configuration: robots return closer, chosen poses differ by more."""

CELLS_OF_A_BOX = 32.0
"""Work: Cells along a box in which repeated rows are looked for: few share one by chance, and few stand at its edge."""


MOST_COMPARED = 1000
"""Work: Rows whose distances tell whether rows lie in places; of more rows those that one joint has closest together."""

LEAST_GAP = 4.0
"""Factor between two distances within which next to no chains of rows join, where rows lie in places."""

MOST_JOINED_IN_GAP = 0.02
"""Chains that join in that gap, as a share of those that join below: a stray row or two may lie between places."""

WIDEST_PLACE = 1 / 3
"""Widest place, as a share of the usual difference of two rows: the gap's lower end may be no further up."""

LEAST_JOINT_MOTION = 30.0
"""Of what repeats a configuration: a joint moves if half of all rows differ by more, 30 mrad or 3 mm; less is scatter."""

LEAST_ACCOMPANIED = 0.3
"""Share of rows that have others at their place, from which rows are said to lie in places."""

FEWEST_PLACES = 8
"""Places below which rows are not taken together by them: too few to hold any back."""


def blocks(readings: np.ndarray, kinds: Sequence[JointKind]) -> np.ndarray:
    """Number the configurations: rows that repeat one have the same label.

    Rows within 1 mrad and 0.1 mm of each other, or joined by a chain of such rows, always share a label; rows more
    than 1.5 times as far apart do only through a chain. On `continuous` joints whole turns do not count.

    Args:
        readings: Shape (N, columns), [rad] or [m].
        kinds: Kind of each column.

    Returns:
        Labels 0, 1, ... in order of appearance, shape (N,).
    """
    return _joined(readings, kinds, _tolerances_of_coordinates(kinds))


def places(readings: np.ndarray, kinds: Sequence[JointKind]) -> np.ndarray:
    """Number the places in which rows were measured: configurations, or groups of near ones with nothing between them.

    Whoever measures a place several times does not come back to the same millidegree. Let rows be joined that are closer than a
    distance, and that distance grow: rows lie in places if there is a stretch of distances in which next to nothing joins, many
    rows have others at their place, and places are narrower than what parts them. Distances are in units of the usual
    difference of two rows in each joint, the largest of all joints.

    Args:
        readings: Shape (N, columns), [rad] or [m].
        kinds: Kind of each column.

    Returns:
        Labels 0, 1, ... in order of appearance, shape (N,); those of :func:`blocks` where rows do not lie in places.
    """
    label = blocks(readings, kinds)
    units = _usual(readings, kinds)
    distance = _gap(readings, kinds, units)
    if distance is None:
        return label
    wider = _joined(readings, kinds, np.maximum(distance * units, _tolerances_of_coordinates(kinds)))
    return wider if wider.max() + 1 >= FEWEST_PLACES else label


def _usual(readings: np.ndarray, kinds: Sequence[JointKind]) -> np.ndarray:
    """The median difference of two rows along each coordinate, shape (coordinates,); never as little as scatter."""
    rng = np.random.default_rng(0)
    some = [values[rng.permutation(len(values))[:MOST_COMPARED]] for values in _coordinates(readings, kinds)]
    usual = [np.median(np.abs(values - np.roll(values, 1))) for values in some]
    return np.maximum(usual, LEAST_JOINT_MOTION * _tolerances_of_coordinates(kinds))


def _gap(readings: np.ndarray, kinds: Sequence[JointKind], units: np.ndarray) -> float | None:
    """The distance that parts places, in the units of the coordinates; None where rows do not lie in places."""
    from scipy.cluster.hierarchy import fcluster, linkage  # slow to load

    if len(readings) < 2 * FEWEST_PLACES:
        return None
    points = np.column_stack(list(_coordinates(_close_in_one_joint(readings), kinds))) / units
    tree = linkage(points, "single", "chebyshev")
    joins = tree[:, 2]
    tolerance = float(np.max(_tolerances_of_coordinates(kinds) / units))
    for below in range(len(joins) - FEWEST_PLACES, -1, -1):  # the widest places first
        low = max(float(joins[below]), tolerance)
        high = float(joins[min(below + 1 + int(MOST_JOINED_IN_GAP * (below + 1)), len(joins) - 1)])
        if low > WIDEST_PLACE or high < LEAST_GAP * low:
            continue
        if _accompanied(points, fcluster(tree, low, "distance") - 1, high) >= LEAST_ACCOMPANIED:
            return float(np.sqrt(low * min(high, 1.0)))
    return None


def _close_in_one_joint(readings: np.ndarray) -> np.ndarray:
    """All rows; of very many those around the middle of the joint that moves the most, among which most places are whole."""
    if len(readings) <= MOST_COMPARED:
        return readings
    widest = np.argmax(np.std(readings, axis=0))
    first = (len(readings) - MOST_COMPARED) // 2
    return readings[np.argpartition(readings[:, widest], (first, first + MOST_COMPARED))[first : first + MOST_COMPARED]]


def _accompanied(points: np.ndarray, place: np.ndarray, narrow: float) -> float:
    """Share of the rows, points (N, coordinates), at places of several rows that are narrower than what parts places."""
    count = np.bincount(place)
    low, high = (np.full((len(count), points.shape[1]), fill) for fill in (np.inf, -np.inf))
    np.minimum.at(low, place, points)
    np.maximum.at(high, place, points)
    narrow_group = (count > 1) & np.all(high - low < narrow, axis=1)
    return float(count[narrow_group].sum() / len(points))


def _coordinates(readings: np.ndarray, kinds: Sequence[JointKind]) -> Iterator[np.ndarray]:
    """Coordinates by which rows are compared, shape (N,) each: readings; cosine and sine of joints that turn without end."""
    for reading, kind in zip(readings.T, kinds, strict=True):
        yield from (np.cos(reading), np.sin(reading)) if kind == "continuous" else (reading,)


def _tolerances_of_coordinates(kinds: Sequence[JointKind]) -> np.ndarray:
    """How far rows may be apart along each coordinate and still repeat a configuration, shape (coordinates,)."""
    return np.repeat(tolerances(kinds), [2 if kind == "continuous" else 1 for kind in kinds])


def _joined(readings: np.ndarray, kinds: Sequence[JointKind], near: np.ndarray) -> np.ndarray:
    """Labels in order of appearance, shape (N,): rows nearer than ``near`` along every coordinate share one, in chains."""
    label = np.arange(len(readings))
    some = _near_others(readings, kinds, near)
    if len(some):
        label[some] = len(readings) + _chained(np.column_stack([*_cells(readings[some], kinds, near)]))
    return by_appearance(label)


def _cells(readings: np.ndarray, kinds: Sequence[JointKind], near: np.ndarray) -> Iterator[np.ndarray]:
    """Numbers of cells along each coordinate, shape (N,) each: half as large as what is near."""
    for values, width in zip(_coordinates(readings, kinds), near.tolist(), strict=True):
        yield np.floor(2.0 * values / width)


def _near_others(readings: np.ndarray, kinds: Sequence[JointKind], near: np.ndarray) -> np.ndarray:
    """Rows that may be less than three cells from another along every coordinate, in order: all that are, and few others.

    Those share a box of :data:`CELLS_OF_A_BOX` cells, where a row also counts to the box below along each coordinate in which it
    is in one of its box's first two cells. Boxes are told apart by sums of their numbers times large odd ones: two boxes of one
    sum cost time alone.
    """
    odd = np.random.default_rng(0)
    key, row = np.zeros(len(readings), dtype=np.int64), np.arange(len(readings))
    for cell in _cells(readings, kinds, near):
        box, place = np.divmod(cell, CELLS_OF_A_BOX)
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
    """Labels, whole numbers from 0 on, numbered anew as 0, 1, ... in order of appearance, shape (N,)."""
    labels = np.asarray(labels, dtype=int)
    first = np.zeros(labels.max(initial=-1) + 1, dtype=int)
    first[labels[::-1]] = np.arange(len(labels))[::-1]  # of several the last that is written stays
    number = np.cumsum(first[labels] == np.arange(len(labels))) - 1
    return np.asarray(number[first[labels]])


def earlier_occurrences(labels: np.ndarray) -> np.ndarray:
    """How many rows before each have its label, shape (N,)."""
    order = np.argsort(labels, kind="stable")
    place = np.arange(len(order))
    begins = np.diff(labels[order], prepend=-1) != 0  # labels are whole numbers from 0 on
    count = np.empty_like(place)
    count[order] = place - np.maximum.accumulate(np.where(begins, place, 0))
    return count


def first_alike(columns: Iterable[np.ndarray]) -> np.ndarray:
    """For each row the number of the first that equals it in all columns, holes included, shape (N,).

    Args:
        columns: Numbers or words of N rows, one at least, shape (N,) each.
    """
    first, group = np.empty(0, dtype=int), np.array(0)
    for k, column in enumerate(columns):
        # Numbers with noise differ in the first column already: most tables end here.
        if not k and not _like_the_one_before(np.sort(column)).any():
            return np.arange(len(column))
        _, number = np.unique(column, return_inverse=True)
        _, first, group = np.unique(
            group * (number.max(initial=0) + 1) + number, return_index=True, return_inverse=True
        )
        if len(first) == len(number):
            return first[group]
    return first[group]


def _like_the_one_before(in_order: np.ndarray) -> np.ndarray:
    """Which sorted values but the first equal the one before, shape (N - 1,); missing ones, which stand at the end, do."""
    return np.asarray((in_order[1:] == in_order[:-1]) | (in_order[1:] != in_order[1:]))


def by_content(columns: Sequence[np.ndarray | None]) -> np.ndarray:
    """Numbers of the rows in the order of their values, shape (N,): the same rows, however they were permuted before.

    Args:
        columns: What the rows hold, shape (N,) or (N, k) each; the first decides first, missing values come last.
    """
    keys = [key for column in columns if column is not None for key in np.atleast_2d(column.T)]
    order = np.argsort(keys[0], kind="stable")
    alike = _like_the_one_before(keys[0][order])
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
