"""Conditions outside of what was seen: a recorded column marks rows, and heat that nobody saw has a sigma."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots

import aridcal
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.jobs.calibrate.saved_model import SavedModel

HEAT = 12e-6
"""[1/K] by which steel grows."""


def grown(robot: Robot, warmer: np.ndarray, q: np.ndarray, model: Model, theta: np.ndarray) -> np.ndarray:
    """Positions (N, 3) of an arm of which every length is longer by some degrees, (N,): links, and the tool on the last."""
    _, cold = model.poses(theta, model.rows(q))
    base, _ = model.frames(theta)
    return cold + HEAT * warmer[:, None] * (cold - base[0][1].translation)


def campaign(
    folder: Path, seed: int = 0, at: float = 20.0, spread: float = 0.3
) -> tuple[robots.Truth, aridcal.Calibration]:
    rng = np.random.default_rng(seed)
    truth = robots.simulate(robots.ur10(), 120, rng, noise=5e-5, kind="position", world=pin.SE3.Identity())
    rows = robots.table(truth).assign(
        temperature=at + spread * rng.uniform(-1, 1, 120), humidity=rng.normal(40.0, 2.0, 120)
    )
    block = {"file": "measurements.csv", "kind": "position"}
    return truth, aridcal.calibrate(
        robots.write_campaign(folder, truth, rows, measurements=block, diagnosis={"enabled": True})
    )


@pytest.fixture(scope="module")
def cool(tmp_path_factory: pytest.TempPathFactory) -> tuple[robots.Truth, aridcal.Calibration]:
    """Calibrated between 19.7 and 20.3 degrees."""
    return campaign(tmp_path_factory.mktemp("cool"))


def asked(truth: robots.Truth, n: int, seed: int, **columns: object) -> tuple[np.ndarray, pd.DataFrame]:
    q = robots.readings(truth.model.robot, n, np.random.default_rng(seed), 0.8)
    return q, pd.DataFrame(dict(zip(truth.model.robot.readings, q.T, strict=True))).assign(**columns)


def test_a_recorded_column_that_no_effect_uses_marks_rows_outside_of_its_range(
    cool: tuple[robots.Truth, aridcal.Calibration], tmp_path: Path
) -> None:
    truth, cal = cool
    assert not cal.result["effects"]
    _, same = asked(truth, 200, 1, temperature=20.1, humidity=41.0)
    _, warm = asked(truth, 200, 1, temperature=33.0, humidity=41.0)
    _, wet = asked(truth, 200, 1, temperature=20.1, humidity=90.0)
    _, silent = asked(truth, 200, 1)
    shares = [cal.predict(table)["extrapolates"].mean() for table in (same, warm, wet, silent)]
    assert shares[0] == shares[3] < 0.1 and shares[1] == shares[2] == 1.0
    cal.save(tmp_path / "results")
    again = SavedModel.load(tmp_path / "results")
    assert set(again.recorded) == {"temperature", "humidity"}


def test_rows_of_the_same_conditions_are_hardly_ever_marked(cool: tuple[robots.Truth, aridcal.Calibration]) -> None:
    """Of other draws of the same temperature and humidity one in some hundreds is farther out than all that were seen."""
    truth, cal = cool
    rng = np.random.default_rng(5)
    temperature, humidity = 20.0 + 0.3 * rng.uniform(-1, 1, 2000), rng.normal(40.0, 2.0, 2000)
    _, plain = asked(truth, 2000, 6)
    more = cal.predict(plain.assign(temperature=temperature, humidity=humidity))["extrapolates"]
    assert (more & ~cal.predict(plain)["extrapolates"]).mean() < 0.005


def test_time_that_goes_on_marks_nothing(tmp_path: Path) -> None:
    truth = robots.simulate(robots.ur10(), 60, np.random.default_rng(0), noise=5e-5)
    cal = aridcal.calibrate(robots.write_campaign(tmp_path, truth, robots.table(truth).assign(time=np.arange(60.0))))
    _, later = asked(truth, 50, 1, time=1e6)
    assert not cal.predict(later)["extrapolates"].all()


@pytest.mark.parametrize("warmer", [6.0, 14.0])
def test_sigmas_hold_the_growth_of_an_arm_that_no_row_saw(
    warmer: float, cool: tuple[robots.Truth, aridcal.Calibration]
) -> None:
    """Second road: the arm's own lengths made longer by 12 ppm/K. Without the temperature in the query nothing can be said."""
    truth, cal = cool
    q, table = asked(truth, 200, 2, temperature=20.0 + warmer)
    real = grown(truth.model.robot, np.full(200, warmer), q, truth.model, truth.theta)
    predicted = cal.predict(table)
    sigma = predicted[["std_x", "std_y", "std_z"]].to_numpy()
    z = np.sqrt(np.mean(((predicted[["x", "y", "z"]].to_numpy() - real) / sigma) ** 2))
    assert 0.3 < z < 2.0
    silent = cal.predict(table.drop(columns="temperature"))[["std_x", "std_y", "std_z"]].to_numpy()
    z_before = np.sqrt(np.mean(((predicted[["x", "y", "z"]].to_numpy() - real) / silent) ** 2))
    assert z_before > 3.0
    assert np.all(sigma > silent)


def test_sigmas_within_the_temperatures_seen_are_as_before(tmp_path: Path) -> None:
    truth, cal = campaign(tmp_path, spread=8.0)
    _, table = asked(truth, 50, 2, temperature=25.0)
    with_it, without = (
        cal.predict(t)[["std_x", "std_y", "std_z"]].to_numpy() for t in (table, table.drop(columns="temperature"))
    )
    np.testing.assert_array_equal(with_it, without)
    sigma = cal.uncertainty(table.assign(temperature=60.0))["sigma_mm"]
    assert (sigma > cal.uncertainty(table)["sigma_mm"]).all()


def test_a_check_at_another_temperature_names_that_first(cool: tuple[robots.Truth, aridcal.Calibration]) -> None:
    truth, cal = cool
    q, table = asked(truth, 15, 7)
    hot = grown(truth.model.robot, np.full(15, 14.0), q, truth.model, truth.theta)
    noise = 5e-5 * np.random.default_rng(3).standard_normal((2, 15, 3))
    at_34 = cal.check(table.assign(temperature=34.0, **dict(zip("xyz", (hot + noise[0]).T, strict=True))))
    assert "temperature" in at_34.lines[0] and "34" in at_34.lines[0] and "20.29" in at_34.lines[0]
    cold = truth.model.poses(truth.theta, truth.model.rows(q))[1]
    at_20 = cal.check(table.assign(temperature=20.0, **dict(zip("xyz", (cold + noise[1]).T, strict=True))))
    assert not any("temperature" in line for line in at_20.lines)
