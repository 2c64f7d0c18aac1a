"""What a calibration has not seen is marked, and what it has seen is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.effect_kind import bumps
from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.corrections.smooth import Kernel, smooth_precision
from aridcal.engine.fit.least_squares import fit
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import ROWS_PER_BLOCK, problem
from aridcal.engine.model.model import Model
from aridcal.engine.trust.coverage import (
    EDGE,
    FEWEST_STEPS_AROUND_HOLE,
    HOLE_FACTOR,
    NEIGHBOURING_STEPS,
    SAME_VALUE_SHARE,
    holes,
    in_ranges,
    largest,
)
from aridcal.jobs.apply.target_poses import predict, read_query
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.calibrate.saving import calibration

LIMIT = 1.5


def draws(rng: np.random.Generator, how: str, n: int) -> np.ndarray:
    if how == "evenly":
        return rng.uniform(-LIMIT, LIMIT, n)
    if how == "thinning out":
        return rng.normal(0.0, 0.5, n)
    if how == "at the ends":
        return LIMIT * np.sin(rng.uniform(0.0, 2 * np.pi, n))
    return rng.choice(np.linspace(-LIMIT, LIMIT, 7), n) + 1e-4 * rng.normal(size=n)


@pytest.mark.parametrize("how", ["evenly", "thinning out", "at the ends", "at levels"])
@pytest.mark.parametrize("n", [50, 400])
def test_rows_like_those_seen_are_in_no_hole(how: str, n: int) -> None:
    """Six joints together: at most one held-out row in twenty where 50 rows are drawn evenly, a twelfth where they thin out."""
    rng = np.random.default_rng(n)
    flagged = []
    for _ in range(60):
        q, unseen = (np.array([draws(rng, how, k) for _ in range(6)]) for k in (n, 100))
        flagged.append(np.any([in_ranges(u, holes(v)) for u, v in zip(unseen, q, strict=True)], axis=0).mean())
    assert np.mean(flagged) < (0.12 if (how, n) == ("thinning out", 50) else 0.05)


@pytest.mark.parametrize("n", [50, 100, 400, 2000])
def test_a_hole_is_found_whole(n: int) -> None:
    rng = np.random.default_rng(n)
    found = []
    for _ in range(40):
        q = rng.uniform(-LIMIT, LIMIT, 2 * n)
        q = q[np.abs(q) > 0.3][:n]
        found.append(in_ranges(rng.uniform(-0.3, 0.3, 100), holes(q)).mean())
    assert np.mean(found) > 0.95


def test_every_hole_is_found_and_nothing_beside_it() -> None:
    values = np.concatenate([np.linspace(0, 1, 50), np.linspace(3, 4, 50), np.linspace(4.5, 5, 50), [4.0, 3.0]])
    (a, b), (c, d) = holes(values)
    assert 1.0 < a < 1.05 and 2.95 < b < 3.0
    assert 4.0 < c < 4.05 and 4.45 < d < 4.5
    assert in_ranges(np.array([0.5, 1.0, 2.0, 3.0, 4.2, 4.5, 6.0]), ((a, b), (c, d))).tolist() == [
        False, False, True, False, True, False, False
    ]  # fmt: skip
    assert not in_ranges(np.array([1.0, np.nan]), ()).any()


@pytest.mark.parametrize(
    "values",
    [np.zeros(9), np.array([0.0, 5.0, 10.0]), np.array([1.0]), np.repeat([0.0, 1.0, 2.5, 20.0], 30),
     np.array([-1.0, 1.0]), np.linspace(0, 1, 4000)],
    ids=["constant", "three levels", "one row", "levels of a payload", "two sides", "dense"],
)  # fmt: skip
def test_what_has_few_levels_has_no_hole(values: np.ndarray) -> None:
    assert holes(values) == ()


def test_a_step_counts_as_wide_in_any_unit() -> None:
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.uniform(18, 19, 60), rng.uniform(28, 29, 60)])
    ((low, high),) = holes(values)
    ((other_low, other_high),) = holes(1e4 * values)
    np.testing.assert_allclose([other_low, other_high], [1e4 * low, 1e4 * high], rtol=1e-12)
    assert high - low > HOLE_FACTOR * 1 / 60


def solved(n: int = 30) -> tuple[SolvedModel, np.ndarray]:
    """A UR10 with a curve over its elbow, and a covariance in which everything errs together."""
    rng = np.random.default_rng(1)
    curve = bumps("elbow_joint", "axis", "elbow_joint", np.linspace(-1, 1, 99), 9)
    places = ((None, robots.random_placement(rng)),)
    model = Model(robots.ur10(), (Coefficient("shoulder_pan_joint", "z"), *curve), places, places, Surroundings())
    count = len(model.coefficients)
    A = 1e-4 * rng.normal(size=(count, count))
    return SolvedModel(model, 1e-3 * rng.normal(size=count), A @ A.T), robots.readings(model.robot, n, rng, 0.3)


def test_standard_deviations_are_the_scatter_of_drawn_coefficients() -> None:
    """Second road: poses of 4,000 coefficients drawn from the covariance."""
    found, q = solved(3)
    rows = found.model.rows(q)
    draws = np.random.default_rng(3).multivariate_normal(found.theta, found.covariance, 4_000)
    R0, p0 = found.model.poses(found.theta, rows)
    off = np.empty((len(draws), len(q), 6))
    for k, theta in enumerate(draws):
        R, p = found.model.poses(theta, rows)
        off[k] = np.hstack([p - p0, Rotation.from_matrix(R @ R0.transpose(0, 2, 1)).as_rotvec()])
    np.testing.assert_allclose(found.std(q), off.std(axis=0), rtol=0.06)


def test_many_rows_have_the_deviations_of_each() -> None:
    found, q = solved(2 * ROWS_PER_BLOCK + 7)
    some = np.array([0, ROWS_PER_BLOCK - 1, ROWS_PER_BLOCK, 2 * ROWS_PER_BLOCK + 6])
    np.testing.assert_allclose(found.std(q)[some], found.std(q[some]), rtol=1e-12)
    assert found.std(q[:0]).shape == (0, 6)


def with_hole() -> SavedModel:
    """A curve over the elbow, fitted to rows of which none has the elbow within 0.3 rad of zero."""
    rng = np.random.default_rng(5)
    robot = robots.ur10()
    q = robots.readings(robot, 400, rng, 0.3)
    elbow = robot.readings.index("elbow_joint")
    q = q[np.abs(q[:, elbow]) > 0.3]
    curve = bumps("elbow_joint", "axis", "elbow_joint", q[:, elbow], 30)
    places = ((None, robots.random_placement(rng)),)
    model = Model(robot, curve, places, places, Surroundings())
    theta = 1e-3 * np.sin(np.arange(len(curve)))
    R, p = model.poses(theta, model.rows(q))
    rows = robots.declared(robots.measured(robot, q, p + 1e-4 * rng.normal(size=p.shape), R), 1e-4, 1e-4)
    precision = smooth_precision(((len(curve),),), 1e-3, Kernel(2.0))
    found = fit(problem(model, rows), prior=Prior(np.zeros(len(curve)), precision))
    one = SolvedModel(model, found.theta, found.covariance)
    ranges = {
        name: (float(low), float(high)) for name, low, high in zip(robot.readings, q.min(0), q.max(0), strict=True)
    }
    gaps = {name: gap for name, values in zip(robot.readings, q.T, strict=True) if (gap := holes(values))}
    return SavedModel(one, one, "pose", (0.0, 0.0, -9.81), (1e-4, 1e-4), ranges, {}, gaps, largest(one.std(q)))


def asked(saved: SavedModel, seed: int, n: int = 300) -> tuple[pd.DataFrame, np.ndarray]:
    """Configurations inside the ranges, and which of them are in the hole."""
    low, high = np.array(list(saved.ranges.values())).T
    q = np.random.default_rng(seed).uniform(low, high, (n, 6))
    elbow = list(saved.ranges).index("elbow_joint")
    return pd.DataFrame(q, columns=list(saved.ranges)), np.abs(q[:, elbow]) < 0.3


def test_a_prediction_in_a_hole_extrapolates_by_the_hole_and_by_its_uncertainty_alone() -> None:
    saved = with_hole()
    assert list(saved.holes) == ["elbow_joint"]
    query, hole = asked(saved, 8)
    for model in (saved, replace(saved, holes={}), replace(saved, largest_std=(np.inf, np.inf))):
        flagged = predict(model, read_query(model, query))["extrapolates"].to_numpy()
        assert flagged[~hole].mean() < 0.03
        least = 0.5 if model.holes == {} else 0.95
        assert flagged[hole].mean() > least
    blind = replace(saved, holes={}, largest_std=(np.inf, np.inf))
    assert not predict(blind, read_query(blind, query))["extrapolates"].any()


def test_the_prior_counts_where_nothing_was_seen() -> None:
    saved = with_hole()
    query, _ = asked(saved, 8)
    middle = query.assign(elbow_joint=0.0).to_numpy()
    edge = query.assign(elbow_joint=0.5).to_numpy()
    assert np.median(saved.final.std(middle)[:, 3:].max(axis=1) / saved.final.std(edge)[:, 3:].max(axis=1)) > 5.0


def test_what_was_seen_comes_back_from_the_file_and_older_files_have_none(tmp_path: Path) -> None:
    saved = with_hole()
    text = saved.dump()
    (tmp_path / "calibration.yaml").write_text(text, encoding="utf-8")
    again = SavedModel.load(tmp_path)
    assert (again.holes, again.largest_std) == (saved.holes, saved.largest_std)
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("holes:"))
    end = next(k for k, line in enumerate(lines) if line.startswith("geometric:"))
    (tmp_path / "calibration.yaml").write_text("\n".join([*lines[:start], *lines[end:]]) + "\n", encoding="utf-8")
    old = SavedModel.load(tmp_path)
    query, hole = asked(old, 8)
    found = predict(old, read_query(old, query))
    assert not found["extrapolates"].any() and hole.any()
    np.testing.assert_allclose(found["std_x"], predict(saved, read_query(saved, query))["std_x"], rtol=1e-9)


def test_a_campaign_marks_its_hole_and_hardly_any_of_its_held_out_rows(tmp_path: Path) -> None:
    """Through the whole loop: an elbow with an error curve, never measured within 0.3 rad of its middle."""
    rows = 50
    rng = np.random.default_rng(rows)
    rigid = robots.simulate(robots.ur10(), 3 * rows, rng, tip=robots.random_placement(rng, 0.2))
    elbow = rigid.model.robot.readings.index("elbow_joint")
    q = rigid.readings / 2.0
    q = q[np.abs(q[:, elbow]) > 0.3][:rows]
    waves = tuple(Coefficient("elbow_joint", "axis", Basis("sin", ("elbow_joint",), (k,))) for k in (1.0, 2.5, 4.0))
    true = rigid.model.with_coefficients((*rigid.model.coefficients, *waves))
    R, p = true.poses(np.append(rigid.theta, [1e-3, 8e-4, 5e-4]), true.rows(q))
    truth = replace(rigid, measured=robots.measured(true.robot, q, p + 5e-5 * rng.normal(size=p.shape), R))
    noise = {"position": 5e-5, "rotation": 5e-5}
    sections = {"measurements": {"file": "measurements.csv", "noise": noise}}
    sections["effects"] = [{"kind": "joint_map", "where": "elbow_joint"}]  # type: ignore[assignment]
    saved = calibration(identify(robots.write_campaign(tmp_path, truth, **sections)))

    assert list(saved.holes) == ["elbow_joint"]
    query, hole = asked(saved, 4, 1000)
    flagged = predict(saved, read_query(saved, query))["extrapolates"].to_numpy()
    assert flagged[hole].mean() > 0.95
    assert flagged[~hole].mean() < 0.05


@pytest.mark.parametrize("how", ["evenly", "thinning out", "at the ends", "at a few places"])
def test_holes_are_those_of_the_definition_step_by_step(how: str) -> None:
    for seed, n in ((0, 1), (1, 2), (2, 5), (3, 9), (4, 60), (5, 300)):
        rng = np.random.default_rng(seed)
        values = np.sort(draws(rng, how, n))
        values[n // 2 :] += 1.0
        apart = np.flatnonzero(np.diff(values) > SAME_VALUE_SHARE * (values[-1] - values[0]))
        low, high = values[apart], values[apart + 1]
        expected = []
        for k, step in enumerate(high - low):
            around = np.delete(
                (high - low)[max(k - NEIGHBOURING_STEPS, 0) : k + 1 + NEIGHBOURING_STEPS], min(k, NEIGHBOURING_STEPS)
            )
            if len(around) >= FEWEST_STEPS_AROUND_HOLE and step > HOLE_FACTOR * around.mean():
                expected.append((low[k] + EDGE * around.mean(), high[k] - EDGE * around.mean()))
        np.testing.assert_allclose(
            np.array(holes(values)).reshape(-1, 2), np.array(expected).reshape(-1, 2), rtol=1e-12
        )
