"""Rows held back: what does not help goes, and few rows never make a robot worse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from scipy.spatial.transform import Rotation
from searched import searched

from aridcal.engine.fit.least_squares import Fit, minimise
from aridcal.engine.fit.problem import problem
from aridcal.engine.levels import JUDGING_FOLDS
from aridcal.engine.model.rigid_bodies import targets_of_one_body
from aridcal.engine.search import loop
from aridcal.engine.search.loop import fit_constants
from aridcal.jobs.calibrate.pipeline import identify

ARMS = np.array([[0.0, 0.0, 0.0], [0.08, 0.0, 0.02], [-0.02, 0.07, 0.0]])
"""Three markers in the target's frame, [m]."""


def fits(n: int, size: float) -> tuple[Fit, Fit, robots.Truth]:
    """The nominal and the geometric fit of n poses of a robot that is off by so much."""
    truth = robots.simulate(robots.ur10(), n, np.random.default_rng(1), size=size, noise=1e-4)
    geometry = fit_constants(robots.campaign("pose").question, truth.model.robot, truth.measured, ())
    return geometry.nominal, geometry.geometric, truth


def test_squares_of_held_back_rows_are_those_of_fits_without_them() -> None:
    """By the second road: each block really left out, and the rest fitted again."""
    _, geometric, truth = fits(40, 1e-3)
    data = truth.measured
    squares = loop._held_back_squares(geometric, data)
    number = np.random.default_rng(2).permutation(int(data.repeats.configuration.max()) + 1)
    block = number[data.repeats.configuration] % JUDGING_FOLDS
    asked = problem(geometric.model, data)
    for k in (0, 3):
        rest = asked.select(block != k)
        again = minimise(rest, geometric.theta, np.ones(len(rest)))
        left = asked.select(block == k).residual(again.theta)
        expected = np.stack([np.sum(left[:, :3] ** 2, axis=1), np.sum(left[:, 3:] ** 2, axis=1)], axis=1)
        # One Gauss-Newton step beside the full fit: second order in milliradians, here below 2 % of the smallest square.
        np.testing.assert_allclose(squares[block == k], expected, rtol=0.02)


@pytest.mark.parametrize(("size", "better"), [(0.0, False), (2e-3, True)])
def test_constants_that_say_nothing_do_not_beat_the_nominal_robot(size: float, better: bool) -> None:
    nominal, geometric, truth = fits(30, size)
    assert loop.is_better(geometric, nominal, truth.measured) == better


def test_constants_of_which_only_a_sum_is_told_are_judged_like_others() -> None:
    nominal, geometric, truth = fits(30, 2e-3)
    covariance = geometric.covariance.copy()
    covariance[:2] = covariance[:, :2] = 0.0
    covariance[:2, :2] = 2.0**-40  # a power of two: the two are tied to the last digit
    assert loop.is_better(replace(geometric, covariance=covariance), nominal, truth.measured)


def markers(folder: Path, apart: bool) -> Path:
    """Three markers at each of 26 poses of a good robot, from one poor pose each, or each measured by itself."""
    rng = np.random.default_rng(4)
    truth = robots.simulate(robots.ur10(), 26, rng, size=1e-4)
    poses = truth.measured
    assert poses.rotation is not None
    noise = 1e-3 * rng.standard_normal((26, 6))
    turned = (Rotation.from_rotvec(2.0 * noise[:, 3:]) * Rotation.from_matrix(poses.rotation)).as_matrix()
    tables = []
    for label, lever in zip("ABC", ARMS, strict=True):
        error = 1e-3 * rng.standard_normal((26, 3)) if apart else noise[:, :3]
        place = poses.position + error + (poses.rotation if apart else turned) @ lever
        table = robots.table(truth).drop(columns=["qx", "qy", "qz", "qw"])
        tables.append(table.assign(x=place[:, 0], y=place[:, 1], z=place[:, 2], station=label))
    path = robots.write_campaign(
        folder, truth, pd.concat(tables, ignore_index=True),
        measurements={"file": "measurements.csv", "kind": "position"},
        frames={"tip_target": {"per": "station"}}, diagnosis={"enabled": True},
    )  # fmt: skip
    return path


def test_markers_made_from_one_pose_are_one_measurement_and_make_no_robot_worse(tmp_path: Path) -> None:
    outcome = identify(markers(tmp_path, apart=False))
    assert outcome.measurements.repeats.share == pytest.approx(1 / 3)
    assert any("count as one measurement" in notice for notice in outcome.notices)
    assert outcome.effects == ()
    assert any("nominal robot is kept" in notice for notice in outcome.notices)
    assert outcome.verdict.word == "not_enough_data"
    nominal, final = (outcome.stage(name).fit for name in ("nominal", "final"))
    assert len(final.theta) == len(nominal.theta)


def test_markers_that_were_measured_by_themselves_count_in_full(tmp_path: Path) -> None:
    assert searched(markers(tmp_path, apart=True)).rows.repeats.share == 1.0


def test_targets_of_one_body_keep_their_distances_whatever_the_robot_does() -> None:
    rng = np.random.default_rng(5)
    n = 12
    R, p = Rotation.random(n, rng=rng).as_matrix(), rng.normal(size=(n, 3))
    place = np.concatenate([p + R @ arm for arm in ARMS])
    q = np.tile(robots.readings(robots.ur10(), n, rng), (3, 1))
    rows = robots.measured(robots.ur10(), q, place).with_labels(station=np.repeat(["A", "B", "C"], n))
    assert targets_of_one_body(rows, 1e-3) == 3
    assert targets_of_one_body(robots.placed(rows, position=place + rng.normal(0, 1e-4, place.shape)), 1e-3) == 1
    two = rows.position.copy()
    two[2 * n :] += rng.normal(0, 1e-4, (n, 3))
    assert targets_of_one_body(robots.placed(rows, position=two), 1e-3) == 2
    assert targets_of_one_body(rows.with_labels(station=None), 1e-3) == 1
