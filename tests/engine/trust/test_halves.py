"""Halves of the rows by blocks: each figure by a second road, and attacks on what they say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import gauges
import numpy as np
import pytest
import robots
from scipy.spatial.transform import Rotation
from scipy.stats import kstest
from searched import searched

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.sights import TARGET, Sights, target_places
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.levels import RARE
from aridcal.engine.model.model import Model
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.halves import PATTERNS, Division, Halves, _sides, divisions, halves
from aridcal.engine.trust.second_look import second_look

NOISE = 1e-4


def whole(truth: robots.Truth) -> Model:
    return truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))


def calibrated(truth: robots.Truth, rows: Dataset | None = None) -> Fit:
    model = whole(truth)
    rows = truth.measured if rows is None else rows
    return fit_identifiable(problem(model, rows), range(len(model.coefficients)))


def off_by(truth: robots.Truth, twist: np.ndarray) -> robots.Truth:
    """The same rows with the target elsewhere by small motions, shape (N, 6), that the model does not have."""
    rows = truth.measured
    assert rows.rotation is not None
    turn = Rotation.from_rotvec(twist[:, 3:]).as_matrix()
    return replace(
        truth, measured=robots.placed(rows, position=rows.position + twist[:, :3], rotation=turn @ rows.rotation)
    )


def compared(found: Fit, rows: Dataset) -> Halves:
    result = halves(found, rows)
    assert result is not None
    return result


def side_of(found: Halves, rows: Dataset) -> np.ndarray:
    return next(d.side for d in divisions(rows, {}) if (d.of, d.how) == (found.of, found.how))


def test_what_differs_is_what_two_fits_to_the_halves_say() -> None:
    """Second road: both halves fitted by themselves, and squares and predictions compared."""
    rng = np.random.default_rng(1)
    truth = robots.simulate(robots.arid(), 80, rng, 1e-3, NOISE)
    bend = np.zeros((80, 6))
    bend[:, 2] = 2e-4 * np.sin(2.0 * truth.readings[:, 1])
    truth = off_by(truth, bend)
    found = calibrated(truth)
    result = compared(found, truth.measured)
    side = side_of(result, truth.measured)
    asked = problem(found.model, truth.measured)
    sigma = np.repeat(found.estimated, 3)
    # The halves weigh the channels as the whole does, so that their squares add up.
    asked = replace(asked, data=robots.declared(truth.measured, *found.estimated))
    pooled = fit(asked, found.theta, np.ones(80))
    apart = [fit(asked.select(half), found.theta, np.ones(half.sum())) for half in (~side, side)]
    squares = [float(np.sum((each.residual / sigma) ** 2)) for each in (pooled, *apart)]
    d, left = result.freedom
    assert d == len(found.theta)
    assert left == 480 - 2 * d
    assert result.squares == pytest.approx(
        (squares[0] - squares[1] - squares[2]) / d / ((squares[1] + squares[2]) / left), rel=1e-2
    )
    off = np.subtract(*[found.model.poses(each.theta, asked.rows)[1] for each in apart]).ravel()
    _, _, J = found.model.jacobian(found.theta, asked.rows)
    frames = [k for k, c in enumerate(found.model.coefficients) if c.where in ("world_base", "tip_target")]
    rigid = J[:, :3, frames].reshape(240, -1)
    off -= rigid @ np.linalg.lstsq(rigid, off, rcond=None)[0]
    assert result.measured == pytest.approx(np.sqrt(np.sum(off**2) / 80), rel=2e-2)


def test_sums_over_limbs_are_those_over_all_their_rows() -> None:
    """Second road: rows under one another, those of the other half zero. The last two coefficients are of both limbs."""
    rng, N, m, K = np.random.default_rng(0), 40, 3, 12
    route = rng.integers(0, 2, N)
    J = rng.normal(size=(N, m, K)) * np.where(np.arange(K) < 5, route[:, None] == 0, True)[:, None]
    J *= np.where((np.arange(K) >= 5) & (np.arange(K) < 10), route[:, None] == 1, True)[:, None]
    own, left = np.arange(K) % 4 != 0, rng.normal(size=(N * m, 7))
    rows = SimpleNamespace(J=J, groups=None)
    ways = [Division("j", str(k), rng.random(N) < 0.5) for k in range(3)]
    for way, side in zip(ways, _sides(rows, ways, own, None, left, route), strict=True):  # type: ignore[arg-type]
        A = np.where(way.side[:, None, None], J, 0.0).reshape(N * m, K)
        np.testing.assert_allclose(side.cross, A.T @ A[:, own], atol=1e-12)
        np.testing.assert_allclose(side.squares, A[:, own].T @ A[:, own], atol=1e-12)
        np.testing.assert_allclose(side.pull, A[:, own].T @ left, atol=1e-12)


def test_p_is_uniform_where_nothing_is_missing_though_the_noise_is_estimated() -> None:
    first = robots.simulate(robots.arid(), 40, np.random.default_rng(0), 1e-3, NOISE)
    model = calibrated(first).model
    found = []
    for seed in range(1, 41):
        truth = robots.simulate(robots.arid(), 40, np.random.default_rng(seed), 1e-3, NOISE)
        result = halves(fit(truth.data(model), weight=np.ones(40)), truth.measured)
        assert result is not None
        found.append(result.p_value)
    assert kstest(found, "uniform").pvalue > 0.01
    assert np.mean(np.array(found) < 0.01) <= 0.05


def test_expected_difference_is_the_scatter_of_halves_without_anything_missing() -> None:
    seen, expected = [], []
    for seed in range(20):
        truth = robots.simulate(robots.arid(), 60, np.random.default_rng(seed), 1e-3, NOISE)
        result = compared(calibrated(truth), truth.measured)
        seen.append(result.measured**2)
        expected.append(result.expected**2)
    # The division that differs most of many is shown, and so it is in what is expected.
    assert np.sqrt(np.mean(seen) / np.mean(expected)) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize(
    "missing",
    [
        Coefficient("shoulder_lift_joint", "axis", Basis("linear", ("shoulder_lift_joint",), (0.0,))),
        Coefficient("elbow_joint", "axis", Basis("cos", ("elbow_joint",), (2.0,))),
        Coefficient("elbow_joint", "axis", Basis("linear", ("elbow_joint.gravity_torque",), (0.0,))),
        Coefficient("wrist_1_joint", "axis", Basis("sign", ("side",))),
        Coefficient("world_base", "x", Basis("linear", ("file row",), (150.0,))),
    ],
    ids=["gain", "harmonic", "compliance", "backlash", "drift"],
)
def test_one_sigma_that_the_model_lacks_is_betrayed_by_300_poses(missing: Coefficient) -> None:
    rng = np.random.default_rng(5)
    truth = robots.simulate(robots.ur10(), 300, rng, 1e-3, NOISE)
    truth = replace(truth, measured=replace(truth.measured, covariates={"side": rng.choice([-1.0, 1.0], 300)}))
    bent = Model(truth.model.robot, (missing,))
    _, _, J = bent.jacobian(np.zeros(1), bent.rows(truth.readings, truth.measured.conditions))
    twist = J[:, :, 0] * NOISE / np.sqrt(np.mean(J**2))
    truth = off_by(truth, twist)
    result = compared(calibrated(truth), truth.measured)
    assert result.p_value < 1e-6
    assert not result.agree
    assert result.measured > 1.2 * result.expected or missing.where == "world_base"


def test_a_tripod_that_moved_half_way_is_seen_but_is_no_difference_of_the_arms() -> None:
    truth = robots.simulate(robots.arid(), 120, np.random.default_rng(3), 1e-3, NOISE)
    moved = np.zeros((120, 6))
    moved[60:, :3] = [1e-3, -2e-3, 5e-4]
    result = compared(calibrated(off_by(truth, moved)), off_by(truth, moved).measured)
    assert (result.of, result.how) == ("row", "low and high")
    assert result.p_value < 1e-50
    still = compared(calibrated(truth), truth.measured)
    assert result.measured < 3.0 * still.expected  # and not the 2.3 mm by which it moved


@pytest.mark.parametrize(
    "make",
    [gauges.points, gauges.distances, gauges.levels, gauges.positions],
    ids=["point", "distance", "level", "position"],
)
def test_halves_of_every_kind_agree_where_nothing_is_missing_and_differ_where_a_joint_jumps(make, tmp_path) -> None:
    arm = gauges.arm(seed=2)
    measured = make(arm)
    rows = gauges.rows(arm, measured)
    first = fit_geometry(gauges.campaign(tmp_path, arm, rows).question, arm.robot, rows, ()).geometric
    assert compared(first, rows).p_value > 0.01
    jump = np.where(np.arange(len(rows)) < len(rows) // 2, 0.0, 2e-3)
    spoilt = gauges.rows(arm, replace(measured, q=measured.q + jump[:, None] * np.eye(6)[2]))
    found = compared(fit(problem(first.model, spoilt), first.theta, np.ones(len(rows))), spoilt)
    assert found.p_value < RARE


def test_wrong_declared_noise_changes_nothing() -> None:
    truth = robots.simulate(robots.arid(), 60, np.random.default_rng(4), 1e-3, NOISE)
    model = calibrated(truth).model
    plain, small = truth.data(model), truth.data(model, 1e-5, 1e-5)
    found = [compared(fit(asked, weight=np.ones(60)), asked.data) for asked in (plain, small)]
    assert found[0].p_value == pytest.approx(found[1].p_value, abs=0.02)


def test_targets_of_one_body_count_once() -> None:
    """Every row three times with the same errors: as many rows, and no more is known."""
    once = robots.simulate(robots.arid(), 50, np.random.default_rng(6), 1e-3, NOISE)
    found = calibrated(once)
    three = once.measured.select(np.repeat(np.arange(50), 3))
    shared = three.with_repeats(share=1.0 / 3.0)
    again = fit(problem(found.model, shared), found.theta, np.ones(150))
    before, after = compared(found, once.measured), compared(again, shared)
    assert after.freedom == before.freedom
    assert after.squares == pytest.approx(before.squares, rel=1e-6)
    naive = compared(fit(problem(found.model, three), found.theta, np.ones(150)), three)
    assert naive.p_value < after.p_value


def test_scatter_of_readings_that_is_weighed_is_no_error_of_the_model(tmp_path: Path) -> None:
    """Its size changes from row to row, and it moves all numbers of a row together."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = robots.simulate(robots.ur10(), 60, rng, 1e-3, 5e-5)
        read = truth.readings + 3e-4 * rng.standard_normal((60, 6))
        truth = replace(truth, measured=replace(truth.measured, readings=read))
        arm = searched(robots.write_campaign(tmp_path, truth)).arm
        assert arm.rows.relative is not None
        found = second_look(arm.geometry.geometric, arm.diagnosed.fit, arm.rows.fitted).halves["final"]
        assert found is not None and found.p_value > 0.01


def test_too_few_rows_and_data_without_noise_say_nothing() -> None:
    few = robots.simulate(robots.arid(), 8, np.random.default_rng(0), 1e-3, NOISE)
    assert halves(calibrated(few), few.measured) is None
    exact = robots.simulate(robots.arid(), 60, np.random.default_rng(0), 1e-3)
    assert halves(calibrated(exact), exact.measured) is None


def test_divisions_are_halves_by_blocks_and_none_stands_twice() -> None:
    rng = np.random.default_rng(9)
    rows = robots.simulate(robots.ur10(), 200, rng).measured
    rows = replace(rows, covariates={"constant": np.ones(200), "rare": np.eye(200)[3], "gap": np.full(200, np.nan)})
    found = divisions(rows, {"load": rows.readings[:, 1]})
    assert {d.of for d in found} == {*rows.names, "row"}
    assert all(0.2 <= d.side.mean() <= 0.8 for d in found)
    sides = [tuple(d.side ^ d.side[0]) for d in found]
    assert len(sides) == len(set(sides))
    assert {d.how for d in found if d.of == "row"} == set(PATTERNS)


def test_a_field_in_space_is_common_to_both_halves() -> None:
    """It is a smooth function like a map: halves that had a field of their own each would be compared in more numbers."""
    truth = robots.simulate(robots.arid(), 80, np.random.default_rng(8), 1e-3, NOISE)
    plain = calibrated(truth)
    sights = Sights(truth.model.tip_target[0][1].translation[None])
    places = target_places(truth.model.robot, truth.readings, np.repeat(sights.targets, len(truth.readings), axis=0))
    ball = Coefficient("world_base", "x", Basis("ball", TARGET, (*places.mean(axis=0).tolist(), 1.0)))
    around = replace(plain.model.around, sights=sights)
    model = replace(plain.model, around=around).with_coefficients((*plain.model.coefficients, ball))
    field = fit(problem(model, truth.measured), np.append(plain.theta, 0.0))
    assert np.linalg.norm(field.covariance[-1]) > 0.0  # the rows tell it
    assert compared(field, truth.measured).freedom[0] == compared(plain, truth.measured).freedom[0]
