"""What a calibration may leave that neighbouring places share: by dense matrices, by sampling, and as it was simulated."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import robots
import two_arms
import yaml
from calibrated import NOISE, machine, measured
from scipy.linalg import null_space
from searched import searched
from two_arms import readings

import aridcal
from aridcal.engine.fit.least_squares import Fit, fit_identifiable
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust import wander
from aridcal.engine.trust.wander import PROCESSES, SHARES, Wander, wandering, wanders, zero_of
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import AridcalError

SPAN = 1.5
"""[m] of the arm's length: only joints that slide ask for it."""


def fitted(seed: int, n: int, sigma: float = 0.0, length: float = 1.0) -> tuple[Fit, Dataset]:
    """A UR10 of which each zero wanders with its own reading, by a sigma [rad], and its constants fitted."""
    m = machine(seed, n=12)
    q = m.configurations(n)
    wander = np.zeros_like(q)
    for j in range(q.shape[1]):
        alike = np.exp(-0.5 * ((q[:, [j]] - q[:, j]) / length) ** 2) + 1e-9 * np.eye(n)
        wander[:, j] = sigma * np.linalg.cholesky(alike) @ m.rng.normal(size=n)
    rows = measured(m.model, m.theta, q, q + wander, NOISE, m.rng, "pose")
    rows = robots.declared(rows)
    return fit_identifiable(robots.problem(m.model, rows), range(len(m.theta))), rows


def total(found: list[Wander]) -> float:
    """Root of the mean variance of what wanders, [rad]."""
    return float(np.sqrt(sum(p.probability * p.turning**2 for p in found)))


def test_the_probabilities_are_those_of_dense_matrices() -> None:
    """Over all joints, in as many centres as rows: then nothing is approximated."""
    fit, rows = fitted(3, 30, 3e-5)
    model = fit.model.with_coefficients(
        (
            *fit.model.coefficients,
            *(zero_of(j) for j in fit.model.robot.joints if zero_of(j) not in fit.model.coefficients),
        )
    )
    theta = np.append(fit.theta, np.zeros(len(model.coefficients) - len(fit.theta)))
    problem = robots.problem(model, rows)
    r, J = problem.residual(theta), problem.pieces(theta).J
    scale = np.repeat(fit.estimated, 3)
    r, J = (r / scale).ravel(), (J / scale[:, None]).reshape(r.size, -1)
    Z = J[:, [model.coefficients.index(zero_of(j)) for j in model.robot.joints]]
    own = J[:, : len(fit.theta)]
    N = null_space((own / np.linalg.norm(own, axis=0)).T)
    y, mean, row = N.T @ r, np.sum(Z**2) / len(r), np.repeat(np.arange(30), 6)
    logs = {("none", 0.0, 0.0): -0.5 * len(y) * np.log(y @ y)}
    for over, length in PROCESSES:
        for share in SHARES:
            C = np.zeros((len(r), len(r)))
            for j, column in enumerate(Z.T):
                q = rows.readings[:, [j]] if over == "own" else rows.readings
                apart = np.sum((q[:, None] - q) ** 2, axis=2)
                C += np.outer(column, column) * np.exp(-0.5 * apart / length**2)[np.ix_(row, row)]
            V = np.eye(len(y)) + share / mean * N.T @ C @ N
            squares = y @ np.linalg.solve(V, y)
            logs[over, length, share] = -0.5 * np.linalg.slogdet(V)[1] - 0.5 * len(y) * np.log(squares)
    most = max(logs.values())
    chance = {key: np.exp(value - most) for key, value in logs.items()}
    # None counts as often as any share, with each process.
    chance["none", 0.0, 0.0] *= len(PROCESSES)
    whole = sum(chance.values())
    found = wanders(fit, rows, fit.estimated, (None, None), SPAN)
    sizes = {key: np.sqrt(key[2] / (1.0 + key[2]) / mean) for key in chance}
    seen = {(p.over, p.length, p.turning): p.probability for p in found}
    for key, value in chance.items():
        close = [
            p for (over, length, size), p in seen.items() if (over, length) == key[:2] and np.isclose(size, sizes[key])
        ]
        if key[0] == "none":
            close = [1.0 - sum(seen.values())]
        assert sum(close) == pytest.approx(value / whole, abs=0.03)  # what is rare goes; nodes are a length apart


def test_limbs_asked_apart_tell_what_all_rows_together_tell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Second road: all rows as one part. Both arms share the tracker's frame."""
    robot = two_arms.machine(2)
    path = two_arms.write(tmp_path, robot, ("tracker",), readings(robot, 120), diagnosis={"enabled": False})
    found = searched(path)
    final, rows = found.fit, found.rows.select(~found.judged.outlier)
    asked = final, rows, final.estimated, (None,) * len(final.estimated), SPAN
    apart, divide, counted = wanders(*asked), wander._parts, []

    def undivided(moved: np.ndarray, group: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        counted.append(len(divide(moved, group)))
        return [(np.arange(len(moved)), np.flatnonzero(moved.any(axis=0)))]

    monkeypatch.setattr(wander, "_parts", undivided)
    whole = wanders(*asked)
    assert counted == [2]
    assert [(p.over, p.length, p.turning) for p in apart] == [(p.over, p.length, p.turning) for p in whole]
    np.testing.assert_allclose([p.probability for p in apart], [p.probability for p in whole], rtol=1e-7)


@pytest.mark.parametrize("over", ["own", "all"])
def test_the_covariance_is_that_of_processes_less_their_mean_over_what_was_seen(over: str) -> None:
    robot, rng = robots.ur10(), np.random.default_rng(4)
    low, high = -1.5, 1.0
    ranges = {name: (low, high) for name in robot.readings}
    rows = rng.uniform(low, high, (3, 6))
    process = Wander(over, 1.2, 2e-4, 0.0, 1.0)  # type: ignore[arg-type]
    # Waves of random frequency make such a process (Rahimi and Recht 2007).
    draws, waves = 2000, 60
    everywhere = rng.uniform(low, high, (200, 6))
    samples = np.empty((draws, 3))
    for d in range(draws):
        k, phase = rng.normal(size=(6, waves)) / 1.2, rng.uniform(0.0, 2.0 * np.pi, waves)
        k = k * np.eye(6)[:, [2]] if over == "own" else k
        there, whole = (np.cos(q @ k + phase).sum(axis=1) for q in (rows, everywhere))
        samples[d] = 2e-4 * np.sqrt(2.0 / waves) * (there - whole.mean())
    found = wandering([process], robot, rows, ranges).variance[2]
    np.testing.assert_allclose(found, samples.T @ samples / draws, atol=0.1 * 2e-4**2)


def test_an_arm_whose_zeros_wander_is_told_from_one_whose_zeros_do_not() -> None:
    """By 0.1 mrad beside noise of half as much: the sizes found are that of the process, and next to nothing."""
    wandering_arms = [
        total(wanders(fit, rows, fit.estimated, (None, None), SPAN)) for fit, rows in map(_uneven, range(4))
    ]
    still = [total(wanders(fit, rows, fit.estimated, (None, None), SPAN)) for fit, rows in map(_even, range(4))]
    assert 0.5e-4 < np.median(wandering_arms) < 1.5e-4
    assert max(still) < 0.25e-4


def _uneven(seed: int) -> tuple[Fit, Dataset]:
    return fitted(seed, 120, 1e-4)


def _even(seed: int) -> tuple[Fit, Dataset]:
    return fitted(seed, 120)


def test_exact_rows_leave_nothing_that_wanders() -> None:
    fit, rows = fitted(1, 40)
    R, p = fit.model.poses(fit.theta, fit.model.rows(rows.readings))
    exact = robots.placed(rows, position=p, rotation=R)
    assert total(wanders(fit, exact, np.array([1e-6, 1e-6]), (None, None), SPAN)) < 1e-6


def test_an_arm_that_slides_wanders_by_as_much_as_the_end_of_what_turns() -> None:
    truth = robots.simulate(robots.arid(), 80, np.random.default_rng(2), 1e-3, 1e-4)
    fit = fit_identifiable(truth.data(truth.model), range(len(truth.theta)))
    for process in wanders(fit, robots.declared(truth.measured), fit.estimated, (None, None), SPAN):
        assert process.sliding == pytest.approx(SPAN * process.turning)


def test_a_calibration_keeps_it_and_an_older_one_has_none(tmp_path) -> None:
    truth = robots.simulate(robots.ur10(), 60, np.random.default_rng(3), 1e-3, 1e-4)
    cal = aridcal.calibrate(robots.write_campaign(tmp_path, truth))
    path = tmp_path / "calibration.yaml"
    path.write_text(cal.model.dump())
    read = SavedModel.load(path)
    assert read.wanders == cal.model.wanders and read.wanders
    assert sum(process.probability for process in read.wanders) <= 1.0 + 1e-9
    keys = yaml.safe_load(path.read_text())
    del keys["wander"]
    path.write_text(yaml.safe_dump(keys))
    assert SavedModel.load(path).wanders == ()
    keys["wander"] = [asdict(Wander("own", 1.0, 1e-5, 1e-5, 0.7)) for _ in range(2)]
    path.write_text(yaml.safe_dump(keys))
    with pytest.raises(AridcalError, match="more than 1"):
        SavedModel.load(path)
