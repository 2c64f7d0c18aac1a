"""Rows that are too few for a controller: that is said first, in red, and no tolerance is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from searched import searched

from aridcal import calibrate, identify
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.stages import LENGTH_COMPONENTS
from aridcal.engine.search import loop
from aridcal.engine.search.loop import fit_constants
from aridcal.jobs.calibrate.pipeline import identify as identified


def campaign(folder: Path, rows: int) -> Path:
    truth = robots.simulate(robots.ur10(), rows, np.random.default_rng(4), 1e-3, 5e-5, kind="position")
    return robots.write_campaign(folder, truth)


@pytest.mark.parametrize(("rows", "ready"), [(14, False), (120, True)])
def test_few_rows_are_not_for_a_controller(
    rows: int, ready: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "300")
    path = campaign(tmp_path, rows)
    status = identify.main([str(path), "--tolerance", "50mm"])
    said = capsys.readouterr().out
    red = "\x1b[1;31mNot for a controller" in said
    page = (tmp_path / "results" / "report.html").read_text("utf-8")
    assert (status, red, 'class="refused"' in page) == ((0, False, False) if ready else (3, True, True))
    assert (
        ("for your controller" in page)
        == ("In your controller" in page)
        == ("next: aridcal compensate" in said)
        == ready
    )
    assert ("nobody can say" in said) == (not ready)


def test_without_a_tolerance_few_rows_are_no_failure_and_still_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert identify.main([str(campaign(tmp_path, 14))]) == 0
    assert capsys.readouterr().out.lstrip().startswith("Not for a controller")


def test_what_is_left_to_judge_by_decides_and_not_the_number_of_rows(tmp_path: Path) -> None:
    """A pose is six numbers, a position three: as many rows of the one are enough where those of the other are not."""
    truth = robots.simulate(robots.ur10(), 25, np.random.default_rng(4), 1e-3, 5e-5)
    assert searched(robots.write_campaign(tmp_path, truth)).judged.verdict.for_controller
    assert not searched(campaign(tmp_path, 25)).judged.verdict.for_controller


def few(seed: int, rows: int, noise: float = 1e-4) -> robots.Truth:
    """Positions of a 7R arm whose constants are off by a millimetre and a milliradian."""
    robot = robots.random_robot(seed, "RRRRRRR")
    return robots.simulate(robot, rows, np.random.default_rng(seed), 1e-3, noise, kind="position")


def test_effects_are_not_sought_where_nothing_is_left_to_judge_them_by(tmp_path: Path) -> None:
    """Thirty numbers and thirty coefficients: among hundreds of effects some fit the rest, whatever that is."""
    path = robots.write_campaign(tmp_path, few(6, 12), diagnosis={"enabled": True})
    found = identified(path)
    assert found.effects == () and any("effects were not sought" in notice for notice in found.notices)
    quiet = robots.write_campaign(tmp_path, few(6, 12), diagnosis={"enabled": False})
    assert not any("effects were not sought" in notice for notice in identified(quiet).notices)


@pytest.mark.parametrize("seed", [2, 5])
def test_ten_positions_of_seven_joints_leave_the_truth_within_what_is_stated(seed: int, tmp_path: Path) -> None:
    """Nobody states the noise, and there are as many coefficients as numbers: a free fit leaves nothing."""
    truth = few(seed, 10)
    block = {"file": "measurements.csv", "kind": "position"}
    cal = calibrate(robots.write_campaign(tmp_path, truth, measurements=block))
    queries = robots.readings(truth.model.robot, 300, np.random.default_rng(1), 0.9)
    predicted = cal.predict(pd.DataFrame(dict(zip(truth.model.robot.readings, queries.T, strict=True))))
    off = predicted[["x", "y", "z"]].to_numpy() - truth.model.poses(truth.theta, truth.model.rows(queries))[1]
    z = off / predicted[["std_x", "std_y", "std_z"]].to_numpy()
    assert np.mean(np.abs(z) < 2.0) > 0.85
    assert np.sqrt(np.mean(off**2)) < 1.5e-3


def test_what_few_rows_do_not_tell_is_as_uncertain_as_what_is_believed_of_it() -> None:
    """Second road: all constants, the redundant ones too, with their prior, and the plain formula of linear models."""
    truth = few(3, 11)
    geometry = fit_constants(robots.campaign("position").question, truth.model.robot, truth.measured, ())
    found = geometry.geometric
    assert found.believed.any() and len(found.theta) > 3 * 11 - 3
    every = found.candidates
    model = found.model.with_coefficients(every)
    known = dict(zip(found.model.names, found.theta, strict=True))
    theta = np.array([known.get(c.name, 0.0) for c in every])
    rows = model.rows(truth.readings)
    queries = robots.readings(truth.model.robot, 40, np.random.default_rng(1), 0.5)
    J, Jq = (model.jacobian(theta, r)[2][:, :3].reshape(-1, len(every)) for r in (rows, model.rows(queries)))
    frames = np.array([c.where in ("world_base", "tip_target") for c in every])
    size = _sizes(found, every, frames)
    prior = np.where(frames, 1e3, size)
    covariance = np.linalg.inv(J.T @ J / found.sigma[0] ** 2 + np.diag(prior**-2.0))
    expected = np.sqrt(np.einsum("ij,jk,ik->i", Jq, covariance, Jq))
    J_own = found.model.jacobian(found.theta, found.model.rows(queries))[2][:, :3].reshape(-1, len(found.theta))
    stated = np.sqrt(np.einsum("ij,jk,ik->i", J_own, found.covariance, J_own))
    np.testing.assert_allclose(stated, expected, rtol=0.02)


def _sizes(found: Fit, every: tuple[Coefficient, ...], frames: np.ndarray) -> np.ndarray:
    """Sizes of lengths and angles that make what the fit believed of its coefficients, by least squares."""
    own = [k for k, c in enumerate(every) if c.name in found.model.names]
    model = found.model.with_coefficients(every)
    q = robots.readings(model.robot, 300, np.random.default_rng(2), 0.9)
    J = model.jacobian(np.zeros(len(every)), model.rows(q))[2][:, :3].reshape(-1, len(every))
    T = np.linalg.lstsq(J[:, own], J, rcond=None)[0]
    lengths = np.array([c.component in LENGTH_COMPONENTS for c in every])
    believed = found.believed.any(axis=1)
    parts = [T[:, some & ~frames][believed] for some in (lengths, ~lengths)]
    C = np.linalg.inv(found.believed[np.ix_(believed, believed)])
    A = np.column_stack([(part @ part.T).ravel() for part in parts])
    squares = np.linalg.lstsq(A, C.ravel(), rcond=None)[0]
    np.testing.assert_allclose(A @ squares, C.ravel(), atol=0.02 * np.abs(C).max())
    return np.where(lengths, *np.sqrt(squares))


def test_a_configuration_that_one_model_misses_by_far_does_not_decide_for_the_nominal_robot() -> None:
    truth = robots.simulate(robots.ur10(), 14, np.random.default_rng(3), 1e-3, 1e-4)
    geometry = fit_constants(robots.campaign("pose").question, truth.model.robot, truth.measured, ())
    assert loop.is_better(geometry.geometric, geometry.nominal, truth.measured)
    position = truth.measured.position.copy()
    position[4] += 0.05
    spoilt = robots.placed(truth.measured, position=position)
    assert loop.is_better(geometry.geometric, geometry.nominal, spoilt)
    assert not loop.is_better(geometry.nominal, geometry.geometric, spoilt)
