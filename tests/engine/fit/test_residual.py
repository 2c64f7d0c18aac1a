"""Rows whose components err together: whitened, differentiated, weighed."""

from dataclasses import replace

import numpy as np
import pytest
from heads import MODEL, START, THETA, poses, shots
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.fit.least_squares import fit
from aridcal.engine.fit.problem import problem, scaled, unscaled
from aridcal.engine.instruments.camera_sonar import reduced, unpacked
from aridcal.engine.rows.dataset import RowNoise, weighed, with_places


@pytest.fixture(scope="module")
def given():
    shot, q = shots(20, START)
    found = reduced(unpacked(shot.rows.observed, 4), START)
    bare = with_places(replace(shot.rows, relative=None), shot.rows.position, shot.rows.rotation)
    ways = {way: RowNoise(covariance=found.covariance, absolute=way == "absolute") for way in ("relative", "absolute")}
    rows = {way: weighed(bare, noise) for way, noise in (ways | {"ignore": RowNoise()}).items()}
    return rows, found.covariance, q


def test_factors_times_the_common_sigmas_are_the_rows_covariances(given):
    rows, covariance, _ = given
    L = rows["absolute"].relative
    sigma = np.repeat(rows["absolute"].sigma, 3)
    np.testing.assert_allclose((L * sigma) @ (L * sigma).transpose(0, 2, 1), covariance, rtol=1e-9, atol=1e-18)
    np.testing.assert_array_equal(rows["relative"].relative, L)
    assert rows["relative"].sigma == (None, None)
    assert rows["ignore"].relative is None


def test_scaling_and_back_is_nothing(given):
    rows, _, _ = given
    r = np.random.default_rng(0).standard_normal((20, 6))
    for relative in (rows["relative"].relative, np.exp(r)):
        np.testing.assert_allclose(unscaled(scaled(r, relative), relative), r, rtol=1e-9)
        columns = np.repeat(r[:, :, None], 2, axis=2)
        np.testing.assert_allclose(scaled(columns, relative)[:, :, 1], scaled(r, relative))


def test_columns_of_whitened_residuals_match_finite_differences(given):
    rows, _, _ = given
    question = problem(MODEL, rows["relative"])
    _, J = question.linearised(THETA)
    for k in range(len(THETA)):
        step = 1e-6 * np.eye(len(THETA))[k]
        up, down = (question.scaled_residual(THETA + s * step) for s in (1, -1))
        np.testing.assert_allclose((down - up) / 2e-6, J[:, :, k], atol=1e-4 * np.abs(J[:, :, k]).max())


def test_weighing_by_whole_covariances_is_worth_it_and_its_covariance_is_honest(given):
    rows, covariance, q = given
    frame = tuple(Coefficient("tip_target", c) for c in FRAME_COMPONENTS)
    model = MODEL.with_coefficients(frame)
    T = poses(model, np.zeros(6), q)
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(covariance)
    chi2, squares = [], {"whole": 0.0, "alike": 0.0}
    for _ in range(30):
        error = np.einsum("nij,nj->ni", root, rng.standard_normal((20, 6)))
        turn = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_matrix(T[:, :3, :3])
        noisy = with_places(rows["ignore"], T[:, :3, 3] + error[:, :3], turn.as_matrix())
        for name, way in (("whole", RowNoise(covariance=covariance)), ("alike", RowNoise())):
            found = fit(problem(model, weighed(noisy, way)))
            squares[name] += float(np.sum(found.theta[:3] ** 2))
            if name == "whole":
                chi2.append(found.theta @ np.linalg.solve(found.covariance, found.theta) / 6)
    assert squares["whole"] < 0.5 * squares["alike"]
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.35)  # of 180 numbers: sigma 0.11
