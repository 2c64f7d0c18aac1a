"""What remains is traced to the joint, column or time that it depends on, and to nothing where it is noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import robots
from scipy.stats import kstest

from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.residual_trends import Traces, _order_of_time, trace

SIGMA = 1e-4


def white(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, SIGMA, (n, 6))


@pytest.fixture(scope="module")
def machine() -> tuple[Fit, Dataset]:
    truth = robots.simulate(robots.ur10(), 300, np.random.default_rng(1), noise=SIGMA)
    model = truth.model.with_coefficients(robots.FRAMES)
    found = fit(truth.data(model))
    rows = replace(robots.measurements(truth), covariates={"time": np.arange(300.0), "side": np.arange(300.0) % 3})
    return found, rows


def joint_columns(machine: tuple[Fit, Dataset], joint: int) -> np.ndarray:
    """How the target moves when a joint turns, by central differences, shape (N, 6)."""
    found, used = machine
    model, step = found.model, 1e-6
    poses = []
    for sign in (1, -1):
        q = used.readings.copy()
        q[:, joint] += sign * step
        poses.append(model.poses(found.theta, model.rows(q)))
    (R1, p1), (R0, p0) = poses
    S = R1 @ R0.transpose(0, 2, 1)
    turn = 0.5 * np.stack([S[:, 2, 1] - S[:, 1, 2], S[:, 0, 2] - S[:, 2, 0], S[:, 1, 0] - S[:, 0, 1]], axis=1)
    return np.hstack([p1 - p0, turn]) / (2 * step)


def traced(machine: tuple[Fit, Dataset], after: np.ndarray, before: np.ndarray | None = None) -> Traces:
    return trace(*machine, after if before is None else before, after)


def test_a_joints_own_error_comes_back_as_that_joints_with_its_size_and_shape(machine: tuple[Fit, Dataset]) -> None:
    q = machine[1].readings[:, 2]
    curve = 3e-4 * np.sin(2 * q)
    noise = white(300, 0)
    found = traced(machine, noise, noise + joint_columns(machine, 2) * curve[:, None])
    own = found.joints[2]
    assert own.motion == own.covariate == "elbow_joint"
    assert own.before.p_value < 1e-50
    assert own.before.size == pytest.approx(np.sqrt(np.mean(curve**2)), rel=0.1)
    assert own.after.p_value > 1e-3
    assert own.after.size < 3e-5
    np.testing.assert_allclose(own.before.smooth, 3e-4 * np.sin(2 * own.at), atol=8e-5)
    asked = own.before.rows - own.after.rows  # the noise is the same in both
    np.testing.assert_allclose(asked, 3e-4 * np.sin(2 * own.covariate_values), rtol=1e-4, atol=1e-8)
    others = [t for t in found.joints if t is not own]
    assert all(t.before.size < 0.3 * own.before.size for t in others)


def test_noise_is_traced_to_nothing(machine: tuple[Fit, Dataset]) -> None:
    smallest, outside, few = [], [], []
    for seed in range(20):
        found = traced(machine, white(300, seed))
        smallest.append(min(t.after.p_value for t in found.strongest) * found.pairs_tested)
        outside.append(np.mean(np.abs(found.order.correlation) > found.order.bound))
        few.append(found.order.p_value)
    assert min(smallest) > 1e-3
    assert np.mean(smallest) > 0.3  # p-values after correction are not small either
    assert np.mean(outside) == pytest.approx(0.05, abs=0.03)
    assert kstest(few, "uniform").pvalue > 1e-3


def test_what_follows_a_column_is_traced_to_it(machine: tuple[Fit, Dataset]) -> None:
    residual = white(300, 3)
    residual[:, 1] += 1e-4 * (machine[1].covariates["side"] - 1)
    found = {t.covariate: t for t in traced(machine, residual).strongest}
    assert found["side"].motion == "y"
    assert len(found["side"].centre) == 3  # few values: one slice each
    np.testing.assert_allclose(found["side"].after.mean, [-1e-4, 0.0, 1e-4], atol=4 * SIGMA / 10)
    assert found["side"].after.size == pytest.approx(1e-4 * np.sqrt(2 / 3), rel=0.2)
    assert {t.covariate for t in found.values() if t.after.p_value < 1e-6} == {"side"}


def test_what_changes_slowly_shows_in_the_order_of_time_only(machine: tuple[Fit, Dataset]) -> None:
    fit_, used = machine
    shuffled = np.random.default_rng(5).permutation(300).astype(float)
    slow = white(300, 6)
    slow[:, 0] += 2e-4 * np.sin(shuffled / 20)
    timed = replace(used, covariates={"time": shuffled})
    bare = replace(used, covariates={})
    seen, unseen = (trace(fit_, rows, slow, slow).order for rows in (timed, bare))
    assert seen.timed
    assert not unseen.timed
    np.testing.assert_array_equal(shuffled[timed.sequence], np.arange(300))
    # Two thirds of the variance of one axis of six.
    assert seen.correlation[0] == pytest.approx(2 / 3 / 6, abs=0.03)
    assert seen.p_value < 1e-4
    assert abs(unseen.correlation[0]) < 2 * unseen.bound
    assert unseen.p_value > 1e-3
    assert unseen.changes > seen.changes


def test_changes_of_sign_are_counted_axis_by_axis(machine: tuple[Fit, Dataset]) -> None:
    """One axis turns its sign at each of the 299 steps, the others three times together: far fewer than noise would."""
    sizes = np.abs(white(300, 7))
    sizes[::2, 0] *= -1
    sizes[100:, 1] *= -1
    sizes[100:200, 2] *= -1
    found = trace(*machine, sizes, sizes).order
    assert found.changes == 299 + 1 + 2
    many = np.array([np.sum(np.diff(np.sign(white(300, seed)), axis=0) != 0) for seed in range(200)])
    assert found.expected == pytest.approx(np.mean(many), abs=6)
    assert found.spread == pytest.approx(np.std(many), rel=0.15)
    assert found.p_value < 1e-10


def test_positions_alone_are_traced_as_well(machine: tuple[Fit, Dataset]) -> None:
    found, used = machine
    alone = robots.positions_alone(used)
    after = white(300, 8)[:, :3]
    q = used.readings[:, 1]
    before = after + joint_columns(machine, 1)[:, :3] * (5e-4 * np.cos(q))[:, None]
    traces = trace(found, alone, before, after)
    assert {t.motion for t in traces.strongest} <= {"x", "y", "z", *found.model.robot.names}
    own = next(t for t in traces.joints if t.motion == found.model.robot.names[1])
    np.testing.assert_allclose(own.before.rows - own.after.rows, 5e-4 * np.cos(own.covariate_values), rtol=1e-4)


def test_what_a_row_does_not_measure_does_not_change_its_sign(machine: tuple[Fit, Dataset]) -> None:
    """Noise in two instruments by turns: in each it changes its sign every other time."""
    _, rows = machine
    chances = []
    for seed in range(60):
        r = np.random.default_rng(seed).normal(size=(len(rows), 6))
        r[::2, :3], r[1::2, 3:] = np.nan, np.nan
        chances.append(_order_of_time(r, rows).p_value)
    assert kstest(chances, "uniform").pvalue > 1e-3
