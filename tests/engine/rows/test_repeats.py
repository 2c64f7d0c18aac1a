"""Rows that repeat a configuration or another row, found fast; and the side from which joints came: each beside its slow road."""

from __future__ import annotations

import math

import numpy as np
import pytest

from aridcal.engine.robot.chain import JointKind
from aridcal.engine.rows.approach import approach
from aridcal.engine.rows.repeats import blocks, by_appearance, by_content, first_alike, places, tolerances

KINDS: tuple[JointKind, ...] = ("revolute", "prismatic", "continuous")


def chained(readings: np.ndarray, kinds: tuple[JointKind, ...]) -> np.ndarray:
    """Labels by looking at every pair of rows."""
    same = tolerances(kinds)
    columns = []
    for k, kind in enumerate(kinds):
        turned = (np.cos, np.sin) if kind == "continuous" else (np.asarray,)
        columns += [np.floor(2 * (f(readings[:, k]) / same[k])) for f in turned]
    cells = np.column_stack(columns)
    near = (np.abs(cells[:, None] - cells[None]) <= 2).all(axis=2)
    label = np.arange(len(readings))
    while True:
        least = np.where(near, label, len(label)).min(axis=1, initial=len(label))
        if np.array_equal(least, label):
            break
        label = least
    order: dict[int, int] = {}
    return np.array([order.setdefault(int(k), len(order)) for k in label], dtype=int)


@pytest.mark.parametrize("seed", range(12))
def test_configurations_are_those_of_a_look_at_every_pair(seed: int) -> None:
    """Rows everywhere, rows that nearly repeat, and rows close enough together to make chains across boxes' edges."""
    rng = np.random.default_rng(seed)
    n, kinds = 150, tuple(rng.permutation(KINDS)[: 1 + seed % 3])
    span = (0.03, 0.02, 0.004)[seed % 3]
    q = rng.uniform(-span, span, (n, len(kinds)))
    if seed % 2:
        q = q[rng.integers(0, n // 3, n)] + rng.normal(0, 10 ** rng.uniform(-5, -3), q.shape)
    found = blocks(q, kinds)
    np.testing.assert_array_equal(found, chained(q, kinds))
    assert len(np.unique(found)) < n


def test_neighbours_on_both_sides_of_a_box_are_one_configuration() -> None:
    edge = 16e-3  # of a box of 32 cells of half a milliradian
    at = np.array([[edge - 1e-4, -edge - 1e-4, 5.0], [edge + 1e-4, -edge + 1e-4, 5.0], [edge - 1e-4, edge, 5.0]])
    assert blocks(at, ("revolute",) * 3).tolist() == [0, 0, 1]


def test_numbers_in_order_of_appearance() -> None:
    assert by_appearance(np.array([7, 2, 7, 9, 2])).tolist() == [0, 1, 0, 2, 1]


@pytest.mark.parametrize("digits", [0, 1, 12])
def test_rows_by_content_are_sorted_by_all_columns_and_missing_values_come_last(digits: int) -> None:
    rng = np.random.default_rng(digits)
    columns = np.round(rng.normal(size=(4, 90)), digits) + 0.0
    columns[rng.random(columns.shape) < 0.1] = np.nan
    given = [columns[0], None, columns[1:3].T, columns[3]]
    np.testing.assert_array_equal(by_content(given), np.lexsort(columns[::-1]))
    keys = [tuple(map(str, row)) for row in columns.T.tolist()]
    assert first_alike(iter(columns)).tolist() == [keys.index(key) for key in keys]


@pytest.mark.parametrize(("side", "last"), [(0.0, math.nan), (-1.0, 0.3), (1.0, -0.2)])
def test_sides_are_those_of_a_walk_from_row_to_row(side: float, last: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        reading = np.round(rng.normal(size=rng.integers(0, 20)), 1)
        reading[rng.random(len(reading)) < 0.3] = np.nan
        found, now, before = approach(reading, 0.15, side, last).tolist(), side, last
        for value, is_from in zip(reading.tolist(), found, strict=True):
            if abs(value - before) > 0.15:
                now = math.copysign(1.0, value - before)
            before = before if math.isnan(value) else value
            assert is_from == now


def test_places_are_rows_that_are_close_in_every_joint_with_nothing_between_them() -> None:
    """Readings around 45 places; the stops of a rail, where the arm on it stands otherwise at each row; readings all over."""
    rng = np.random.default_rng(3)
    kinds: list[JointKind] = ["prismatic", "revolute", "revolute", "revolute"]
    place = np.repeat(np.arange(45), 5)
    around = rng.uniform(-2.0, 2.0, (45, 4))[place] + rng.uniform(-4e-3, 4e-3, (225, 4))
    np.testing.assert_array_equal(places(around, kinds), place)
    shuffled = rng.permutation(225)
    np.testing.assert_array_equal(places(around[shuffled], kinds), by_appearance(place[shuffled]))
    stops = rng.uniform(-2.0, 2.0, (192, 4))
    stops[:, 0] = np.linspace(1.0, 17.0, 16).repeat(12)
    for apart in (stops, rng.uniform(-2.0, 2.0, (225, 4))):
        np.testing.assert_array_equal(places(apart, kinds), np.arange(len(apart)))
    still = around * [1.0, 1.0, 1.0, 0.0] + [0.0, 0.0, 0.0, 0.5]
    np.testing.assert_array_equal(places(still, kinds), place)


def test_a_path_with_stops_between_its_stretches_is_no_row_of_places():
    """Chains that are longer than what parts them are paths: their rows are configurations of their own."""
    rng = np.random.default_rng(8)
    starts, ways = rng.uniform(-1.5, 1.5, (2, 12, 6))
    path = (starts[:, None] + np.linspace(0.0, 1.0, 40)[:, None] * (ways - starts)[:, None]).reshape(-1, 6)
    np.testing.assert_array_equal(places(path, ("revolute",) * 6), np.arange(len(path)))
