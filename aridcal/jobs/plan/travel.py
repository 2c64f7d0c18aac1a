"""An order of configurations that shortens the way through them: nearest neighbours, then the way's pieces turned round."""

from __future__ import annotations

import numpy as np

MOST_SWEEPS = 50
"""Times at the most that all pieces are tried; ten are usual."""


def times(readings: np.ndarray) -> np.ndarray:
    """Time of the way between any two configurations, shape (n, n): the travel of the joint that moves most, [rad] or [m].

    Joints of an arm move together, and the slowest decides.

    Args:
        readings: Shape (n, columns), [rad] or [m].
    """
    return np.asarray(np.abs(readings[:, None] - readings[None, :]).max(axis=2))


def length(way: np.ndarray, order: np.ndarray) -> float:
    """Length of the way through an order, from its first configuration to its last."""
    return float(way[order[:-1], order[1:]].sum())


def short_order(readings: np.ndarray) -> np.ndarray:
    """An order in which all are visited once on a short way, shape (n,); the first is the nearest to the joints' zeros.

    Pieces are turned round as long as that shortens the way (2-opt: Croes 1958, doi:10.1287/opre.6.6.791).

    Args:
        readings: Shape (n, columns), [rad] or [m].
    """
    n, way = len(readings), times(readings)
    order = [int(np.argmin(np.abs(readings).max(axis=1)))]
    unvisited = np.ones(n, dtype=bool)
    while len(order) < n:
        unvisited[order[-1]] = False
        order.append(int(np.argmin(np.where(unvisited, way[order[-1]], np.inf))))
    best = np.array(order)
    for _ in range(MOST_SWEEPS):
        before = length(way, best)
        for i in range(1, n - 1):
            best = _with_best_reversal(way, best, i)
        if length(way, best) >= before * (1.0 - 1e-12):
            break
    return best


def _with_best_reversal(way: np.ndarray, order: np.ndarray, i: int) -> np.ndarray:
    """The order with the piece from place i on turned round that shortens the way most, if any does."""
    ends = np.arange(i + 1, len(order))
    after = np.minimum(ends + 1, len(order) - 1)
    last = ends == len(order) - 1  # nothing follows it
    old = way[order[i - 1], order[i]] + np.where(last, 0.0, way[order[ends], order[after]])
    new = way[order[i - 1], order[ends]] + np.where(last, 0.0, way[order[i], order[after]])
    gain = old - new
    k = int(np.argmax(gain))
    if gain[k] <= 1e-12:
        return order
    return np.concatenate([order[:i], order[i : ends[k] + 1][::-1], order[ends[k] + 1 :]])
