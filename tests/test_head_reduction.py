"""Shots reduced to poses, to what they say of the head, and to how much they are believed."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from heads import MODEL, SETTINGS, START, THETA, look, moved, poses, views

from aridcal.head.pose import NO_SONARS
from aridcal.head.reduction import Head, reduce_shots, start_anywhere

BENT = moved(camera_k1=-0.03, camera_p1=0.001, camera_fx=3.0, sonar_2_bias=2e-3, sonar_4_scale=0.01)
STEPS = np.array([1e-2, 1e-2, 1e-2, 1e-2, 1e-5, 1e-4, 1e-6, 1e-6, 1e-4] + [1e-5] * 4 + [1e-4] * 4)


@pytest.fixture(scope="module")
def taken():
    q, square = views(6)
    T = poses(MODEL, THETA, q)
    rng = np.random.default_rng(5)
    return T, [look(T[k], int(square[k]), BENT, rng) for k in range(len(q))]


def twists(T: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Motion from T to another pose, linear and angular, in world axes, shape (N, 6)."""
    turn = [pin.log3(b[:3, :3] @ a[:3, :3].T) for a, b in zip(T, to, strict=True)]
    return np.hstack([to[:, :3, 3] - T[:, :3, 3], turn])


def test_without_noise_the_true_head_gives_the_true_poses_and_no_misfit():
    q, square = views(5, seed=3)
    T = poses(MODEL, THETA, q)
    seen = [look(T[k], int(square[k]), BENT, np.random.default_rng(k), noise=0.0) for k in range(len(q))]
    reduced = reduce_shots(seen, BENT)
    assert np.abs(twists(T, reduced.T_world_camera)).max() < 1e-9
    assert reduced.misfit.max() < 1e-9 and np.all(reduced.freedom == [2 * len(s.points) - 2 for s in seen])
    wrong = reduce_shots(seen, START)
    assert np.abs(twists(T, wrong.T_world_camera)).max() > 1e-4 and wrong.misfit.min() > 10


@pytest.mark.parametrize("k", range(len(STEPS)), ids=START.names)
def test_sensitivity_and_pull_match_finite_differences_of_the_whole_reduction(taken, k):
    _, seen = taken
    step = STEPS[k] * np.eye(len(STEPS))[k]
    here = reduce_shots(seen, BENT)
    up, down = (reduce_shots(seen, replace(BENT, phi=BENT.phi + s * step)) for s in (1, -1))
    found = twists(down.T_world_camera, up.T_world_camera) / (2 * STEPS[k])
    largest = np.abs(here.sensitivity[:, :, k]).max()
    assert np.abs(found - here.sensitivity[:, :, k]).max() < 2e-2 * largest + 1e-6
    slope = (up.misfit - down.misfit) / (2 * STEPS[k])
    curve = (up.misfit - 2 * here.misfit + down.misfit) / STEPS[k] ** 2
    size = 2 * np.sqrt(here.information[:, k, k] * here.misfit) + 1e-9
    assert np.all(np.abs(slope + 2 * here.pull[:, k]) < 0.05 * size)
    assert np.all(np.abs(curve - 2 * here.information[:, k, k]) < 0.05 * here.information[:, k, k].max())


def test_stated_covariance_of_the_camera_is_that_of_repeated_shots():
    q, square = views(1, seed=2)
    T = poses(MODEL, THETA, q)
    rng = np.random.default_rng(0)
    first = look(T[0], int(square[0]), START, rng)
    chi2, misfit, freedom = [], 0.0, 0.0
    for _ in range(300):
        again = look(T[0], int(square[0]), START, rng)
        reduced = reduce_shots([again], START)
        off = twists(T, reduced.T_world_camera)[0]
        chi2.append(off @ np.linalg.solve(reduced.covariance[0], off))
        misfit, freedom = misfit + reduced.misfit[0], freedom + reduced.freedom[0]
    assert np.mean(chi2) / 6 == pytest.approx(1.0, abs=4 * np.sqrt(2 / (6 * 300)))
    assert misfit / freedom == pytest.approx(1.0, abs=4 * np.sqrt(2 / freedom))
    assert len(first.points) >= 4


def test_a_wild_range_costs_its_shot_the_trust_and_no_other():
    q, square = views(8, seed=4)
    T = poses(MODEL, THETA, q)
    rng = np.random.default_rng(1)
    seen = [look(T[k], int(square[k]), START, rng) for k in range(len(q))]
    seen[3] = replace(seen[3], ranges=seen[3].ranges + [0, 0.2, 0, 0])
    reduced = reduce_shots(seen, START)
    assert reduced.trust[3] < 1e-3 and np.all(np.delete(reduced.trust, 3) == 1.0)
    assert reduced.scatter < 2.0


def test_a_start_needs_no_sonars():
    q, square = views(3, seed=6)
    T = poses(MODEL, THETA, q)
    for k in range(3):
        s = look(T[k], int(square[k]), START, np.random.default_rng(k))
        start = start_anywhere(s.points, s.pixels, NO_SONARS, START.intrinsics)
        true = np.linalg.inv(T[k]) @ s.T_world_square
        assert np.abs(start - true).max() < 0.02


def test_a_head_without_sonars_has_the_numbers_of_its_camera_alone():
    head = Head.of(SETTINGS.model_copy(update={"sonars": None}))
    assert len(head.phi) == 9 and head.names[0] == "camera.fx" and len(head.bias) == len(head.scale) == 0
    assert START.names[9:11] == ("sonar_1.bias", "sonar_2.bias") and START.names[-1] == "sonar_4.scale"
