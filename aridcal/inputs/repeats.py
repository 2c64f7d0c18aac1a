"""Rows that repeat a configuration, or another row; and an order of rows that is not that of their file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from aridcal.robot.chain import JointKind

SAME_ANGLE, SAME_LENGTH = 1e-3, 1e-4  # readings this close repeat one configuration, [rad] and [m]


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
    # slow to load, and a slip in a table is found before
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    turning = np.array([kind == "continuous" for kind in kinds], dtype=bool)
    same = tolerances(kinds)
    circle = [f(readings[:, turning]) / SAME_ANGLE for f in (np.cos, np.sin)]
    points = np.hstack([readings[:, ~turning] / same[~turning], *circle])
    # Cells of half the distance keep the pairs few however often a configuration is repeated.
    cells, cell = np.unique(np.floor(2 * points), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(2.5, p=np.inf, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    _, label = connected_components(graph, directed=False)
    return by_appearance(label[cell.reshape(-1)])


def by_appearance(labels: np.ndarray) -> np.ndarray:
    """The same labels as 0, 1, ... in order of appearance, shape (N,)."""
    _, first, number = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=int)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[number]


def first_alike(columns: Iterable[np.ndarray]) -> np.ndarray:
    """For each row the number of the first that equals it in all columns, holes included, shape (N,).

    Args:
        columns: Numbers or words of N rows, one at least, shape (N,) each.
    """
    first, group = np.empty(0, dtype=int), np.array(0)
    for column in columns:
        _, number = np.unique(column, return_inverse=True)
        _, first, group = np.unique(
            group * (number.max(initial=0) + 1) + number, return_index=True, return_inverse=True
        )
        if len(first) == len(number):  # numbers with noise differ in the first column already: most tables end here
            return first[group]
    return first[group]


def by_content(columns: Sequence[np.ndarray | None]) -> np.ndarray:
    """Numbers of the rows in the order of their values, shape (N,): the same rows, however they were permuted before.

    Args:
        columns: What the rows hold, shape (N,) or (N, k) each; the first decides first, missing values come last.
    """
    keys = np.column_stack([column for column in columns if column is not None])
    return np.lexsort(keys.T[::-1])


def tolerances(kinds: Sequence[JointKind]) -> np.ndarray:
    """How far readings of each kind may be apart and still repeat a configuration, [rad] or [m], shape (columns,)."""
    return np.where([kind == "prismatic" for kind in kinds], SAME_LENGTH, SAME_ANGLE)
