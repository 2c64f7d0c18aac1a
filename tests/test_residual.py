"""Rows whose components err together: whitened, differentiated, weighed."""

from dataclasses import replace

import numpy as np
import pytest
from heads import MODEL, START, THETA, poses, shots
from scipy.spatial.transform import Rotation

from aridcal.campaign import Noise as NoiseSettings
from aridcal.effects import FRAME_COMPONENTS, Coefficient
from aridcal.geometry import declared_noise, observations
from aridcal.head.reduction import reduce_shots
from aridcal.residual import linearise, scaled, unscaled
from aridcal.sighted import posed
from aridcal.solver import Data, Noise, fit


@pytest.fixture(scope="module")
def given():
    shot, q = shots(20, START)
    return posed(shot.rows, reduce_shots(shot.seen, START)), shot, q


def test_factors_times_the_common_sigmas_are_the_rows_covariances(given):
    rows, shot, _ = given
    measurements = shot.campaign.measurements.model_copy(update={"noise": NoiseSettings(rows="absolute")})
    campaign = shot.campaign.model_copy(update={"measurements": measurements})
    noise = declared_noise(campaign, rows)
    L = observations(rows, "absolute").relative
    sigma = np.repeat([noise.declared_position, noise.declared_rotation], 3)
    np.testing.assert_allclose((L * sigma) @ (L * sigma).transpose(0, 2, 1), rows.covariance, rtol=1e-9, atol=1e-18)
    assert observations(rows, "ignore").relative is None


def test_scaling_and_back_is_nothing(given):
    rows, _, _ = given
    r = np.random.default_rng(0).standard_normal((len(rows), 6))
    for measured in (observations(rows, "relative"), replace(observations(rows, "relative"), relative=np.exp(r))):
        np.testing.assert_allclose(unscaled(scaled(r, measured), measured), r, rtol=1e-9)
        columns = np.repeat(r[:, :, None], 2, axis=2)
        np.testing.assert_allclose(scaled(columns, measured)[:, :, 1], scaled(r, measured))


def test_columns_of_whitened_residuals_match_finite_differences(given):
    rows, _, q = given
    measured = observations(rows, "relative")
    prepared = MODEL.rows(q)
    _, J = linearise(MODEL, THETA, prepared, measured)
    for k in range(len(THETA)):
        step = 1e-6 * np.eye(len(THETA))[k]
        up, down = (linearise(MODEL, THETA + s * step, prepared, measured)[0] for s in (1, -1))
        np.testing.assert_allclose((down - up) / 2e-6, J[:, :, k], atol=1e-4 * np.abs(J[:, :, k]).max())


def test_weighing_by_whole_covariances_is_worth_it_and_its_covariance_is_honest(given):
    rows, _, q = given
    frame = tuple(Coefficient("tip_target", c) for c in FRAME_COMPONENTS)
    model = MODEL.with_coefficients(frame)
    T = poses(model, np.zeros(6), q)
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(rows.covariance)
    chi2, squares = [], {"whole": 0.0, "alike": 0.0}
    for _ in range(60):
        error = np.einsum("nij,nj->ni", root, rng.standard_normal((len(rows), 6)))
        turn = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_matrix(T[:, :3, :3])
        noisy = replace(rows, position=T[:, :3, 3] + error[:, :3], quaternion=turn.as_quat())
        for name, way in (("whole", "relative"), ("alike", "ignore")):
            data = Data(model.rows(q), observations(noisy, way), np.zeros(len(rows), dtype=bool))
            found = fit(model, data, Noise())
            squares[name] += float(np.sum(found.theta[:3] ** 2))
            if name == "whole":
                chi2.append(found.theta @ np.linalg.solve(found.covariance, found.theta) / 6)
    assert squares["whole"] < 0.5 * squares["alike"]
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.25)
