"""How well the target is known over the workspace: each figure against simulations or draws that know the answer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gauges
import numpy as np
import pytest
import robots
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

import aridcal
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.workspace import (
    KNOWN_TARGET_SIGMA,
    Knowledge,
    Workspace,
    ends,
    knowledge,
    spread_out,
    worst_direction,
)
from aridcal.system.errors import AridcalError

NOISE = 1e-4
TOOL = (0.05, -0.02, 0.3)


def calibrated(
    kind: str = "pose", n: int = 60, seed: int = 0, robot: robots.Robot | None = None
) -> tuple[robots.Truth, Fit, Dataset]:
    """An arm whose constants are off, its frames anywhere, and its calibration."""
    rng = np.random.default_rng(seed)
    placements = robots.random_placement(rng), robots.random_placement(rng, 0.2)
    truth = robots.simulate(
        robot or robots.ur10(), n, rng, 1e-3, NOISE, world=placements[0], tip=placements[1], kind=kind
    )
    model = truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))
    rows = robots.declared(truth.measured, NOISE, NOISE)
    return truth, fit_identifiable(problem(model, rows), range(len(model.coefficients))), rows


def candidates(found: Fit) -> tuple[Coefficient, ...]:
    return (*robots.FRAMES, *constants(found.model.robot, "full"))


def looked(
    found: Fit, rows: Dataset, q: np.ndarray, tool: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> tuple[Knowledge, Workspace]:
    known = knowledge(found, rows, candidates(found))
    return known, known.over(rows, q, np.zeros(len(q), dtype=int), tool)


def test_a_point_on_the_target_scatters_as_is_said_of_it() -> None:
    """Machines, noise and all drawn anew 30 times, constants that no row tells apart among them; positions of a tool's point."""
    squares, variance, turned, turns = np.zeros((4, 30))
    q = robots.readings(robots.arid(), 30, np.random.default_rng(9))
    for seed in range(30):
        truth, found, rows = calibrated(n=40, seed=seed, robot=robots.arid())
        _, seen = looked(found, rows, q, TOOL)
        R, p = found.model.poses(found.theta, seen.rows)
        true_R, true_p = truth.model.poses(truth.theta, truth.model.rows(q))
        off = p + R @ np.array(TOOL) - true_p - true_R @ np.array(TOOL)
        squares += np.sum(off**2, axis=1)
        turned += np.sum(Rotation.from_matrix(R @ true_R.transpose(0, 2, 1)).as_rotvec() ** 2, axis=1)
        variance += np.einsum("nii->n", seen.covariance)
        turns += np.einsum("nii->n", seen.turns)
    for said, true in ((variance, squares), (turns, turned)):
        assert np.sqrt(said.sum() / true.sum()) == pytest.approx(1.0, rel=0.11)
        np.testing.assert_allclose(np.sqrt(said / true), 1.0, rtol=0.4)  # of 30 runs each is known to 10 %


def test_places_are_where_the_arm_is_in_its_base_frame() -> None:
    _, found, rows = calibrated()
    q = robots.readings(found.model.robot, 200, np.random.default_rng(1))
    known, seen = looked(found, rows, q)
    np.testing.assert_allclose(known.places(rows, q, np.zeros(len(q), dtype=int)), seen.places, atol=1e-12)
    R, tips = tip_frames(found.model.robot, q)
    target = found.model.frames(found.theta)[1][0][1]
    assert np.abs(seen.places - tips - R @ target.translation).max() < 0.02  # the constants' own corrections
    lever = looked(found, rows, q, TOOL)[1]
    np.testing.assert_allclose(np.linalg.norm(lever.places - seen.places, axis=1), np.linalg.norm(TOOL))


def test_the_worst_direction_is_the_worst_and_turns_with_the_base() -> None:
    _, found, rows = calibrated(n=20)
    _, seen = looked(found, rows, robots.readings(found.model.robot, 40, np.random.default_rng(1)))
    world = np.einsum("nij,nj->ni", seen.axes, seen.way)
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", world, seen.covariance, world), seen.sigma**2)
    any_way = np.random.default_rng(0).normal(size=(40, 3))
    any_way /= np.linalg.norm(any_way, axis=1, keepdims=True)
    assert np.all(np.einsum("ni,nij,nj->n", any_way, seen.covariance, any_way) <= seen.sigma**2 * (1 + 1e-9))
    sigma, way = worst_direction(np.array([np.diag([1.0, 9.0, 4.0])]))
    assert sigma[0] == pytest.approx(3.0) and np.allclose(way, [[0.0, 1.0, 0.0]])


@pytest.mark.parametrize(("kind", "told"), [("pose", True), ("position", False)])
def test_a_point_beside_a_target_whose_turns_nobody_saw_is_not_known(kind: str, told: bool) -> None:
    _, found, rows = calibrated(kind)
    q = robots.readings(found.model.robot, 20, np.random.default_rng(1))
    assert looked(found, rows, q)[1].observable.all()
    beside = looked(found, rows, q, TOOL)[1]
    assert beside.observable.all() == told and beside.observable.any() == told
    assert (beside.sigma < KNOWN_TARGET_SIGMA).all() == told


def test_what_nobody_can_tell_of_a_target_does_not_make_it_unsure() -> None:
    """With the redundant constants beside it the target's variance is what it is without, but for directions nearly unseen."""
    _, found, rows = calibrated()
    q = rows.readings
    bare = knowledge(found, rows, ()).over(rows, q, np.arange(len(q)))
    _, seen = looked(found, rows, q)
    more = np.einsum("nii->n", seen.covariance) / np.einsum("nii->n", bare.covariance)
    assert np.all(more > 1.0 - 1e-6) and np.all(more < 1.05)


def test_the_scale_of_points_is_known_if_a_length_is(tmp_path: Path) -> None:
    """And only then; where the base stands is a convention, and makes nothing unknown."""
    for tied in (True, False):
        arm = gauges.arm()
        outcome = gauges.outcome(tmp_path, arm, gauges.rows(arm, gauges.points(arm, 2, tied=tied), declared=True))
        assert outcome.certainty.anywhere.observable.all() == tied
        assert outcome.certainty.anywhere.observable.any() == tied
        assert np.isfinite(outcome.certainty.tolerances[0].bound) == tied


def test_a_camera_on_the_arm_tells_of_the_tip_by_convention(tmp_path: Path) -> None:
    """Its mounting takes up what the last link is off by: that must not make the whole arm unknown."""
    arm = gauges.arm()
    known = gauges.outcome(tmp_path, arm, gauges.rows(arm, gauges.pixels(arm), declared=True)).certainty
    assert known.anywhere.observable.all() and known.anywhere.turns_told.all()
    assert np.isfinite([part.bound for part in known.tolerances]).all()


def test_what_is_unlike_the_rows_is_marked_and_less_sure() -> None:
    _, found, rows = calibrated(n=80)
    half = rows.select(rows.readings[:, 1] > 1.0)
    again = fit(problem(found.model, half), found.theta, np.ones(len(half)))
    q = robots.readings(found.model.robot, 60, np.random.default_rng(2), 0.9)
    _, seen = looked(again, half, q)
    below = q[:, 1] < half.readings[:, 1].min()
    assert not seen.measured[below].any()
    assert seen.measured[~below].mean() > 0.5
    assert np.median(seen.sigma[below]) > 1.05 * np.median(seen.sigma[~below & seen.measured])


def test_configurations_fill_the_range_evenly() -> None:
    low, high = np.array([-1.0, 2.0, 0.0]), np.array([3.0, 2.5, 1e-3])
    q = spread_out(low, high, 256)
    assert q.shape == (256, 3) and np.array_equal(q, spread_out(low, high, 256))
    for k in range(3):
        assert kstest(q[:, k], "uniform", (low[k], high[k] - low[k])).statistic < 0.01


def test_the_whole_range_is_that_of_the_limits_and_one_turn_at_most() -> None:
    rows = robots.measured(robots.ur10(), np.random.default_rng(0).uniform(1.0, 2.0, (20, 6)), np.zeros((20, 3)))
    limits = np.array([[-1.0, 4.0], [-6.3, 6.3], [-np.inf, np.inf], [-6.3, 2.5], [-6.3, 6.3], [1.0, 2.0]])
    low, high = ends(rows, limits)
    middle = (rows.readings.min(axis=0) + rows.readings.max(axis=0)) / 2
    assert (low[0], high[0], low[5], high[5]) == (-1.0, 4.0, 1.0, 2.0)
    assert (low[1], high[1]) == pytest.approx((middle[1] - np.pi, middle[1] + np.pi))
    assert (low[2], high[2]) == pytest.approx((rows.readings[:, 2].min(), rows.readings[:, 2].max()))
    assert high[3] == 2.5


def test_the_python_face_says_the_same(tmp_path: Path) -> None:
    """In the campaign's units, of a fresh calibration and of the same loaded; rows in, rows out."""
    truth = robots.simulate(robots.ur10(), 60, np.random.default_rng(3), 1e-3, NOISE)
    table = robots.table(truth)
    names = list(truth.model.robot.readings)
    table[names] = np.degrees(table[names])
    path = robots.write_campaign(
        tmp_path,
        truth,
        table,
        measurements={
            "file": "measurements.csv",
            "units": {"angle": "deg"},
            "orientation": "quaternion",
            "noise": {"position": NOISE, "rotation": NOISE},
        },
    )
    cal = aridcal.calibrate(path)
    (tmp_path / "calibration.yaml").write_text(cal.model.dump())
    loaded = aridcal.load(tmp_path / "calibration.yaml")
    asked = table.head(10)
    said = cal.uncertainty(asked, TOOL)
    np.testing.assert_allclose(loaded.uncertainty(asked, TOOL)["sigma_mm"], said["sigma_mm"], rtol=1e-6)
    assert cal.outcome is not None
    final, rows = cal.outcome.stages[-1].fit, cal.outcome.measurements
    train = rows.select(rows.train)
    seen = knowledge(final, train, ()).over(train, np.radians(asked[names].to_numpy()), np.zeros(10, dtype=int), TOOL)
    np.testing.assert_allclose(said["sigma_mm"], 1e3 * seen.sigma, rtol=1e-6)
    np.testing.assert_allclose(said["rotation_mrad"], 1e3 * seen.turn, rtol=1e-6)
    np.testing.assert_allclose(said["rms_mm"] ** 2, 1e6 * np.einsum("nii->n", seen.covariance), rtol=1e-6)
    own = cal.predict(asked)[["std_x", "std_y", "std_z"]].to_numpy()
    np.testing.assert_allclose(1e3 * np.linalg.norm(own, axis=1), cal.uncertainty(asked)["rms_mm"], rtol=1e-9)
    every = loaded.uncertainty()
    assert len(every) == 512 and every["extrapolates"].mean() < 0.2
    assert np.ptp(every[names].to_numpy(), axis=0) == pytest.approx(np.ptp(table[names].to_numpy(), axis=0), rel=0.2)
    point = replace(cal, model=replace(cal.model, kind="position"))
    with pytest.raises(AridcalError, match="nothing is known of a point beside it"):
        point.uncertainty(asked, TOOL)
