"""A bump in one joint's error curve is found whole, not flagged away; what is declared stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import robots
from scipy.spatial.transform import Rotation
from searched import searched

SIGMA = 1e-4
N = 200
JOINT = 2
PLACE = 0.4


def campaign(folder: Path, width: float, height: float, kind: str, seed: int = 8, **sections: object) -> Path:
    """A UR10 within half a turn of each joint; the elbow is off by a Gaussian about one reading."""
    rng = np.random.default_rng(seed)
    robot = robots.ur10()
    q = rng.uniform(-2.6, 2.6, (N, 6))
    truth = robots.simulate(robot, N, rng, noise=SIGMA)
    model, theta = truth.model, truth.theta
    turned = q.copy()
    turned[:, JOINT] += height * np.exp(-0.5 * ((q[:, JOINT] - PLACE) / width) ** 2)
    R, p = model.poses(theta, model.rows(turned))
    R = Rotation.from_rotvec(rng.normal(0, SIGMA, p.shape)).as_matrix() @ R
    rows = robots.measured(robot, q, p + rng.normal(0, SIGMA, p.shape), R if kind == "pose" else None)
    made = robots.replace(truth, measured=rows)
    return robots.write_campaign(folder, made, **({"diagnosis": {"enabled": True}} | sections))


BUMP = ("joint_map", robots.ur10().names[JOINT])


@pytest.mark.parametrize(("width", "height", "kind"), [(0.05, 5e-3, "pose"), (0.1, 20e-3, "position")])
def test_a_bump_is_a_joint_map_and_no_row_of_it_is_an_outlier(
    width: float, height: float, kind: str, tmp_path: Path
) -> None:
    found = searched(campaign(tmp_path, width, height, kind))
    assert [(effect.kind, effect.where) for effect in found.effects] == [BUMP]
    rows, inside = found.rows, np.abs(found.rows.readings[:, JOINT] - PLACE) < 2.5 * width
    assert inside.sum() > 5
    assert not found.judged.outlier.any()
    left = found.judged.stages[-1].residual[inside & rows.train, :3]
    # Of n rows, three numbers each, the RMS of noise alone stays below 1 + 3 / sqrt(6 n): 1.4 for ten.
    assert np.sqrt(np.mean(left**2)) < 1.4 * SIGMA


def test_gross_errors_stay_outliers_beside_a_bump(tmp_path: Path) -> None:
    """Six rows off by centimetres anywhere are not explained away, and hide nothing."""
    path = campaign(tmp_path, 0.1, 8e-3, "pose", seed=9)
    rows = robots.pd.read_csv(tmp_path / "measurements.csv")
    wild = np.array([11, 60, 97, 140, 181, 193])
    rows.loc[wild, "x"] += 0.03
    rows.to_csv(tmp_path / "measurements.csv", index=False, float_format="%.17g")
    found = searched(path)
    assert [(effect.kind, effect.where) for effect in found.effects] == [BUMP]
    np.testing.assert_array_equal(np.sort(found.rows.origin.line[found.judged.outlier]) - 2, wild)


def test_a_declared_map_stays_whatever_else_would_fit(tmp_path: Path) -> None:
    """Of the last joint, in positions alone, where hardly anything is seen of it."""
    where = robots.ur10().names[5]
    stated = {"effects": [{"kind": "joint_map", "where": where}]}
    assert {("joint_map", where), BUMP} <= searched(campaign(tmp_path, 0.15, 8e-3, "position", **stated)).named


def test_a_channel_without_any_noise_is_no_reason_to_stop(tmp_path: Path) -> None:
    """Rotations that a program made, positions that an instrument measured: variances 20 decades apart."""
    rng = np.random.default_rng(11)
    robot = robots.ur10()
    truth = robots.simulate(robot, 80, rng)
    rows = robots.placed(truth.measured, position=truth.measured.position + rng.normal(0, SIGMA, (80, 3)))
    kinds = {"candidates": ["joint_map"]}
    path = robots.write_campaign(tmp_path, robots.replace(truth, measured=rows), diagnosis=kinds)
    table = robots.pd.read_csv(tmp_path / "measurements.csv")
    name = robot.names[JOINT]
    table[name] += 2e-3 * np.exp(-0.5 * ((table[name] - PLACE) / 0.3) ** 2)
    table.to_csv(tmp_path / "measurements.csv", index=False, float_format="%.17g")
    assert searched(path).verdict in ("noise_floor", "structure_remains")
