"""Shots reduced to poses, to what they say of the head, and to how much they are believed."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from heads import MODEL, SETTINGS, START, THETA, calibrated, look, moved, poses, shots, views

from aridcal.engine.instruments.camera_sonar import CAMERA_SONAR, Head, HeadShot, ShotPoses, packed, reduced, unpacked
from aridcal.jobs.head1992.detections import shot_rows
from aridcal.jobs.head1992.shot_rows import head_of, start_anywhere
from aridcal.jobs.head1992.square_pose import NO_SONARS

BENT = moved(camera_k1=-0.03, camera_p1=0.001, camera_fx=3.0, sonar_2_bias=2e-3, sonar_4_scale=0.01)
STEPS = np.array([1e-2, 1e-2, 1e-2, 1e-2, 1e-5, 1e-4, 1e-6, 1e-6, 1e-4] + [1e-5] * 4 + [1e-4] * 4)


@pytest.fixture(scope="module")
def taken():
    q, square = views(6)
    T = poses(MODEL, THETA, q)
    rng = np.random.default_rng(5)
    return T, [look(T[k], int(square[k]), BENT, rng) for k in range(len(q))]


def reduce_shots(seen: list[HeadShot], head: Head, declared: Head = START) -> ShotPoses:
    return reduced(unpacked(packed(seen, declared), len(head.positions)), head)


def camera(found: ShotPoses) -> np.ndarray:
    """T_world_camera, shape (N, 4, 4)."""
    T = np.tile(np.eye(4), (len(found.position), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = found.rotation, found.position
    return T


def twists(T: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Motion from T to another pose, linear and angular, in world axes, shape (N, 6)."""
    turn = [pin.log3(b[:3, :3] @ a[:3, :3].T) for a, b in zip(T, to, strict=True)]
    return np.hstack([to[:, :3, 3] - T[:, :3, 3], turn])


def test_without_noise_the_true_head_gives_the_true_poses_and_no_misfit():
    q, square = views(5, seed=3)
    T = poses(MODEL, THETA, q)
    seen = [look(T[k], int(square[k]), BENT, np.random.default_rng(k), noise=0.0) for k in range(len(q))]
    found = reduce_shots(seen, BENT)
    assert np.abs(twists(T, camera(found))).max() < 1e-9
    assert found.misfit.max() < 1e-9 and np.all(found.freedom == [2 * len(s.points) - 2 for s in seen])
    wrong = reduce_shots(seen, START)
    assert np.abs(twists(T, camera(wrong))).max() > 1e-4 and wrong.misfit.min() > 10


@pytest.mark.parametrize("k", range(len(STEPS)), ids=START.names)
def test_sensitivity_and_pull_match_finite_differences_of_the_whole_reduction(taken, k):
    _, seen = taken
    step = STEPS[k] * np.eye(len(STEPS))[k]
    here = reduce_shots(seen, BENT)
    up, down = (reduce_shots(seen, replace(BENT, phi=BENT.phi + s * step)) for s in (1, -1))
    found = twists(camera(down), camera(up)) / (2 * STEPS[k])
    largest = np.abs(here.sensitivity[:, :, k]).max()
    assert np.abs(found - here.sensitivity[:, :, k]).max() < 2e-2 * largest + 1e-6
    slope = np.nan_to_num(down.trace - up.trace) / (2 * STEPS[k])
    size = np.abs(here.slope[:, :, k]).max(axis=1, initial=0.0)
    assert np.all(np.abs(slope - here.slope[:, :, k]).max(axis=1) < 2e-2 * size + 1e-6)


@pytest.mark.parametrize("head", [START, BENT], ids=["declared", "bent"])
def test_columns_of_exact_shots_are_central_differences(head):
    """A shot without noise, the camera elsewhere than it says: residual by the target's twist and by the head's numbers."""
    q, square = views(4, seed=8)
    T = poses(MODEL, THETA, q)
    seen = [look(T[k], int(square[k]), head, np.random.default_rng(k), noise=0.0) for k in range(len(q))]
    rows, state = packed(seen, START), np.tile(head.state, (len(q), 1))
    off = [pin.exp6(np.array([1e-3, -2e-3, 1e-3, 0.01, -0.02, 0.015]) * (k + 1)) for k in range(len(q))]
    R = np.array([pin.SE3(t).rotation @ o.rotation for t, o in zip(T, off, strict=True)])
    p = T[:, :3, 3] + [o.translation for o in off]
    here = CAMERA_SONAR.derivatives(R, p, rows, (state,))

    def differences(up: np.ndarray, down: np.ndarray, step: float) -> np.ndarray:
        return np.nan_to_num(down - up) / (2 * step)

    for k in range(6):
        e = 1e-6 * np.eye(6)[k]
        both = [pin.exp3(s * e[3:]) for s in (1, -1)]
        up, down = (
            CAMERA_SONAR.residual(turn @ R, p + s * e[:3], rows, (state,))
            for s, turn in zip((1, -1), both, strict=True)
        )
        np.testing.assert_allclose(here.by_twist[:, :, k], differences(up, down, 1e-6), atol=1e-7)
    for k, size in enumerate(STEPS):
        step = np.zeros_like(state)
        step[:, k] = 1e-2 * size
        up, down = (CAMERA_SONAR.residual(R, p, rows, (state + s * step,)) for s in (1, -1))
        column = here.by_state[0][:, :, k]
        tolerance = 1e-6 * np.abs(column).max()
        np.testing.assert_allclose(column, differences(up, down, 1e-2 * size), atol=tolerance)


def test_pose_and_trace_hold_all_that_image_points_and_ranges_say_of_head_and_pose():
    """Information on the head's numbers beyond the pose, from the trace and from the whole shot."""
    q, square = views(5, seed=9)
    T = poses(MODEL, THETA, q)
    rng = np.random.default_rng(2)
    for k in range(len(q)):
        s = look(T[k], int(square[k]), START, rng)
        found = reduce_shots([s], START)
        step = STEPS
        whole = np.zeros(len(STEPS))
        for j in range(len(STEPS)):
            up, down = (
                reduce_shots([s], replace(START, phi=START.phi + w * step[j] * np.eye(len(STEPS))[j])) for w in (1, -1)
            )
            whole[j] = (up.misfit[0] - 2 * found.misfit[0] + down.misfit[0]) / (2 * step[j] ** 2)
        own = np.sum(found.slope[0] ** 2, axis=0)
        np.testing.assert_allclose(own, whole, rtol=5e-2, atol=1e-6 * whole.max())


def test_stated_covariance_of_the_camera_is_that_of_repeated_shots():
    q, square = views(1, seed=2)
    T = poses(MODEL, THETA, q)
    rng = np.random.default_rng(0)
    first = look(T[0], int(square[0]), START, rng)
    chi2, misfit, freedom = [], 0.0, 0.0
    for _ in range(120):
        again = look(T[0], int(square[0]), START, rng)
        found = reduce_shots([again], START)
        off = twists(T, camera(found))[0]
        chi2.append(off @ np.linalg.solve(found.covariance[0], off))
        misfit, freedom = misfit + found.misfit[0], freedom + found.freedom[0]
    assert np.mean(chi2) / 6 == pytest.approx(1.0, abs=4 * np.sqrt(2 / (6 * 120)))
    assert misfit / freedom == pytest.approx(1.0, abs=4 * np.sqrt(2 / freedom))
    assert len(first.points) >= 4


def test_a_wild_range_costs_its_shot_and_no_other():
    given, _ = shots(40, START, more="diagnosis: {enabled: false}")
    wild = replace(given.seen[3], ranges=given.seen[3].ranges + [0, 0.2, 0, 0])
    rows = shot_rows(given.rows, [*given.seen[:3], wild, *given.seen[4:]], START, given.campaign)
    arm, _ = calibrated(replace(given, rows=rows))
    assert np.flatnonzero(arm.diagnosed.fit.outliers).tolist() == [3]


def test_a_start_needs_no_sonars():
    q, square = views(3, seed=6)
    T = poses(MODEL, THETA, q)
    for k in range(3):
        s = look(T[k], int(square[k]), START, np.random.default_rng(k))
        start = start_anywhere(s.points, s.pixels, NO_SONARS, START.intrinsics)
        true = np.linalg.inv(T[k]) @ s.T_world_square
        assert np.abs(start - true).max() < 0.02


def test_a_head_without_sonars_has_the_numbers_of_its_camera_alone():
    head = head_of(SETTINGS.model_copy(update={"sonars": None}))
    assert len(head.phi) == 9 and head.names[0] == "camera.fx" and len(head.bias) == len(head.scale) == 0
    assert START.names[9:11] == ("sonar_1.bias", "sonar_2.bias") and START.names[-1] == "sonar_4.scale"
