"""Rows left out in turn, and single rows: set beside fits that really leave them out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gauges
import numpy as np
import pytest
import robots

from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable
from aridcal.engine.fit.noise import covariance_of_rows
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.levels import JUDGING_FOLDS
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups
from aridcal.engine.trust.cross_validation import _shares, folds, influence, rows_of

NOISE = 1e-4


def calibrated(n: int = 60, seed: int = 1, **bend: float) -> tuple[Fit, Dataset]:
    """An ARID, fitted with its noise declared so that no refit weighs otherwise; single rows bent by metres along z."""
    truth = robots.simulate(robots.arid(), n, np.random.default_rng(seed), 1e-3, NOISE)
    model = truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))
    rows = robots.declared(truth.measured, NOISE, NOISE)
    place = rows.position.copy()
    for row, by in bend.items():
        place[int(row.removeprefix("row_")), 2] += by
    rows = robots.placed(rows, position=place)
    chosen = fit_identifiable(problem(model, rows), range(len(model.coefficients))).model
    return fit(problem(chosen, rows), weight=np.ones(n)), rows


def of_kind(make: Callable[[gauges.Arm], gauges.Measured], folder: Path) -> tuple[Fit, Dataset]:
    """A UR10 of which another kind of instrument says where it is."""
    arm = gauges.arm(seed=2)
    rows = gauges.rows(arm, make(arm), declared=True)
    first = fit_geometry(gauges.campaign(folder, arm, rows).question, arm.robot, rows, ()).geometric
    return fit(problem(first.model, rows), first.theta, np.ones(len(rows))), rows


def really_left_out(found: Fit, rows: Dataset, prior: Prior | None = None) -> np.ndarray:
    """Error of each fold's rows, by channel, with all others fitted anew: those of things included, shape (folds, C)."""
    together = held_back_groups(rows)
    fold = (np.random.default_rng(3).permutation(int(together.max()) + 1) % JUDGING_FOLDS)[together]
    asked, errors = problem(found.model, rows), []
    for k in range(JUDGING_FOLDS):
        rest = fit(asked.select(fold != k), found.theta, np.ones(int((fold != k).sum())), prior)
        left = problem(rest.model, rows).select(fold == k).residual(rest.theta)
        parts = np.split(left, np.cumsum([c.size for c in rows.channels])[:-1], axis=1)
        errors.append([np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in parts])
    return np.array(errors)


def test_errors_of_folds_are_those_of_fits_to_the_others() -> None:
    found, rows = calibrated()
    told = folds(found, rows, rows_of(found, rows))
    assert told is not None
    np.testing.assert_allclose(told.error, really_left_out(found, rows), rtol=2e-3)
    assert np.all(told.mean > told.fitted)


@pytest.mark.parametrize("make", [gauges.points, gauges.distances], ids=["point", "distance"])
def test_errors_of_folds_are_those_of_fits_that_find_the_instruments_things_anew(
    make: Callable[[gauges.Arm], gauges.Measured], tmp_path: Path
) -> None:
    found, rows = of_kind(make, tmp_path)
    told = folds(found, rows, rows_of(found, rows))
    assert told is not None
    np.testing.assert_allclose(told.error, really_left_out(found, rows), rtol=2e-2)


def test_rows_of_an_anchor_that_only_one_fold_knows_are_not_counted(tmp_path: Path) -> None:
    """Attack: eight rows of one wire, left out together: they would be predicted from a place that they alone told."""
    arm = gauges.arm(seed=2)
    rows = gauges.rows(arm, gauges.distances(arm), declared=True)
    lone = rows.labels.refers[:, 0] == "w2"
    rows = rows.select(~lone | (np.cumsum(lone) <= 8))
    lone = rows.labels.refers[:, 0] == "w2"
    first = fit_geometry(gauges.campaign(tmp_path, arm, rows).question, arm.robot, rows, ()).geometric
    found = fit(problem(first.model, rows), first.theta, np.ones(len(rows)))
    told = folds(found, rows, rows_of(found, rows))
    assert told is not None
    together = held_back_groups(rows)
    fold = (np.random.default_rng(3).permutation(int(together.max()) + 1) % JUDGING_FOLDS)[together]
    (k,) = np.unique(fold[lone])
    rest, asked = fold != k, problem(found.model, rows)
    again = fit(asked.select(rest), found.theta, np.ones(int(rest.sum())))
    left = problem(again.model, rows).select(~rest & ~lone).residual(again.theta)
    assert told.error[k, 0] == pytest.approx(np.sqrt(np.mean(left**2)), rel=2e-2)


def test_beliefs_hold_in_every_fold() -> None:
    """A prior that nearly fixes half of the coefficients: without it rows left out would be predicted worse."""
    found, rows = calibrated(20)
    K = len(found.theta)
    prior = Prior(found.theta.copy(), np.diag(np.where(np.arange(K) % 2, 1e12, 0.0)))
    held = fit(problem(found.model, rows), found.theta, np.ones(20), prior)
    told, free = (folds(each, rows, rows_of(each, rows)) for each in (held, found))
    assert told is not None and free is not None
    np.testing.assert_allclose(told.error, really_left_out(held, rows, prior), rtol=5e-3)
    assert np.all(told.mean < free.mean)


def test_a_fold_knows_what_rows_that_nobody_fitted_do() -> None:
    """Attack: the mean over folds against fresh rows, of many campaigns; that of fitted rows is far below."""
    told, fresh, fitted = [], [], []
    for seed in range(8):
        truth = robots.simulate(robots.arid(), 90, np.random.default_rng(seed), 1e-3, NOISE)
        model = truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))
        rows, others = (truth.measured.select(part) for part in (slice(0, 30), slice(30, 90)))
        found = fit_identifiable(problem(model, rows), range(len(model.coefficients)))
        said = folds(found, rows, rows_of(found, rows))
        assert said is not None
        told.append(said.mean[0])
        fitted.append(said.fitted[0])
        left = problem(found.model, others).residual(found.theta)[:, :3]
        fresh.append(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    assert np.mean(told) == pytest.approx(np.mean(fresh), rel=0.06)
    assert np.mean(fitted) < 0.9 * np.mean(fresh)


def shift_without(found: Fit, rows: Dataset, k: int) -> float:
    """RMS by which the predicted target really moves when a row is left out."""
    asked = problem(found.model, rows)
    rest = fit(asked.select(np.arange(len(rows)) != k), found.theta, np.ones(len(rows) - 1))
    before, after = (found.model.poses(theta, asked.rows)[1] for theta in (found.theta, rest.theta))
    return float(np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1))))


def test_influence_is_what_leaving_out_a_row_does() -> None:
    found, rows = calibrated()
    told = influence(found, rows_of(found, rows))
    assert told is not None
    for i in (0, 10, 59):
        assert told.shift[i] == pytest.approx(shift_without(found, rows, int(told.rows[i])), rel=2e-2)
    assert told.leverage.sum() * 6 == pytest.approx(len(found.theta), rel=1e-6)  # the trace of a projection
    assert told.sigma == pytest.approx(np.sqrt(np.mean(np.sum(told_variance(found, rows), axis=1))), rel=1e-6)


def told_variance(found: Fit, rows: Dataset) -> np.ndarray:
    """Variance of the predicted target in each axis, shape (N, 3)."""
    _, _, J = found.model.jacobian(found.theta, problem(found.model, rows).rows)
    return np.einsum("nik,kl,nil->ni", J[:, :3], found.covariance, J[:, :3])


@pytest.mark.parametrize("make", [gauges.points, gauges.distances], ids=["point", "distance"])
def test_influence_counts_what_things_take_up(make: Callable[[gauges.Arm], gauges.Measured], tmp_path: Path) -> None:
    found, rows = of_kind(make, tmp_path)
    told = influence(found, rows_of(found, rows))
    assert told is not None
    for i in (0, 20):
        assert told.shift[i] == pytest.approx(shift_without(found, rows, int(told.rows[i])), rel=5e-2)


def test_a_row_that_is_off_is_the_one_that_decides_and_clean_rows_do_not() -> None:
    clean = influence(calibrated()[0], rows_of(*calibrated()))
    assert clean is not None
    assert len(clean.deciding) == 0
    spoilt = calibrated(row_17=3e-3)
    told = influence(spoilt[0], rows_of(*spoilt))
    assert told is not None
    assert told.rows[0] == 17
    assert told.deciding.tolist() == [17]
    assert told.cook[0] == told.cook.max()


def test_fewer_configurations_than_folds_are_not_left_out_in_turn() -> None:
    found, rows = calibrated(9)
    assert folds(found, rows, rows_of(found, rows)) is None


@pytest.mark.parametrize("share", [0.0, 0.08, 0.6])
def test_the_share_of_a_row_is_the_same_from_the_few_columns_that_act_in_it(share: float) -> None:
    rng = np.random.default_rng(0)
    J = rng.normal(size=(2_100, 3, 60)) * (
        rng.random((2_100, 1, 60)) < share
    )  # two stretches; rows with none among them
    J[:, :, 7] = 0.0
    root = rng.normal(size=(60, 60))
    known = covariance_of_rows(J, root @ root.T)
    np.testing.assert_allclose(_shares(J, root @ root.T), known, rtol=1e-10, atol=1e-9)
    assert known.any() == (share > 0.0)
