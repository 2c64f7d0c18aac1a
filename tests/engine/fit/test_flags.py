"""Flagged rows: which are outliers, and whether they lie together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import robots
from scipy.stats import kstest

from aridcal.engine.fit.flags import QUANTILES, _quantiles, cluster, coordinates, limits
from aridcal.engine.rows.dataset import Dataset

N = 250


def rows(seed: int = 0) -> Dataset:
    """Configurations all over the range, as any campaign has them."""
    rng = np.random.default_rng(seed)
    robot = robots.ur10()
    q = rng.uniform(-np.pi, np.pi, (N, 6))
    return robots.measured(robot, q, rng.normal(size=(N, 3)), np.tile(np.eye(3), (N, 1, 1)))


def flags(chosen: np.ndarray) -> np.ndarray:
    found = np.zeros(N, dtype=bool)
    found[chosen] = True
    return found


@pytest.mark.parametrize("count", [2, 5, 8, 25])
def test_outliers_that_fall_anywhere_are_hardly_ever_called_a_cluster(count: int) -> None:
    """By drawing them: the corrected p-value is below 5 % in at most 5 % of the cases."""
    rng = np.random.default_rng(1)
    data = rows()
    p = [cluster(flags(rng.choice(N, count, replace=False)), data) for _ in range(150)]
    chances = np.array([found.p_value for found in p if found is not None])
    assert len(chances) == 150
    assert kstest(chances, "uniform", alternative="greater").pvalue > 1e-3  # no smaller than uniform
    assert np.mean(chances < 1e-3) <= 2 / 150


@pytest.mark.parametrize("joint", [0, 3])
def test_flagged_rows_in_a_bump_of_one_joint_are_named_with_their_joint_and_place(joint: int) -> None:
    data = rows(2)
    q = data.readings[:, joint]
    inside = np.abs(q - 0.7) < 0.15
    found = cluster(inside | flags(np.array([3, 77, 150])), data)
    assert found is not None
    assert found.p_value < 1e-6
    assert found.coordinate == data.names[joint]
    assert 0.5 < found.low < found.high < 0.9
    np.testing.assert_array_equal(found.rows, inside)


def test_flagged_rows_that_follow_one_another_are_a_cluster_in_the_order_of_rows() -> None:
    found = cluster(flags(np.arange(100, 112)), rows(3))
    assert found is not None
    assert (found.coordinate, found.low, found.high) == ("row", 100.0, 111.0)
    assert found.p_value < 1e-9


def test_one_flagged_row_is_no_cluster_and_ties_are_counted_whole() -> None:
    data = rows(4)
    assert cluster(flags(np.array([5])), data) is None
    load = np.repeat([0.0, 5.0, 10.0, 5.0, 0.0], N // 5)
    loaded = replace(data, covariates={"payload": load})
    spread = flags(np.flatnonzero(load == 5.0)[::11])
    found = cluster(spread, loaded)
    assert found is not None
    assert found.p_value > 1e-4  # nine of a hundred rows with one payload, of 250: not much more than chance
    assert "payload" in coordinates(loaded)


def test_rows_that_are_kept_are_never_flagged() -> None:
    data = rows(5)
    kept = flags(np.array([7]))
    assert np.isinf(limits(data, kept)[7])
    assert np.isfinite(np.delete(limits(data, kept), 7)).all()


@pytest.mark.parametrize("count", [1, 2, 3, 10, 11, 100, 997])
def test_quantiles_are_those_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).standard_normal(count)
    np.testing.assert_allclose(_quantiles(values), np.quantile(values, QUANTILES), rtol=1e-15, atol=1e-15)
