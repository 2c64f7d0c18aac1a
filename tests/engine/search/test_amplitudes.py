"""The likeliest amplitude of smooth functions, against determinants and solutions amplitude by amplitude."""

from __future__ import annotations

import numpy as np
import pytest

from aridcal.engine.search.evidence import TAUS, likeliest, profiled


def made(seed: int, n: int, d: int, fall: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Information and pulls of n candidates whose modes fall off over so many decades, and that explain about so much."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((n, 3 * d + 2, d)) * np.logspace(0, -fall, d)
    seen = rng.standard_normal((n, 3 * d + 2)) + size * (columns @ rng.standard_normal((d, 1)))[:, :, 0]
    return np.swapaxes(columns, 1, 2) @ columns, (seen[:, None] @ columns)[:, 0]


@pytest.mark.parametrize("roughly", [False, True])
@pytest.mark.parametrize("left", [np.inf, 900.0])
@pytest.mark.parametrize(
    ("d", "fall", "size"), [(1, 0, 1), (2, 0, 0), (15, 0, 0), (15, 2, 3), (49, 2, 1), (78, 1, 0.3)]
)
def test_the_likeliest_amplitude_is_that_of_determinants_and_solutions(d, fall, size, left, roughly):
    A, b = made(d, 5, d, fall, size)
    found = likeliest(A, b, np.full(5, 1e-9), left, 800.0, roughly)
    for k in range(5):
        values = np.linalg.eigvalsh(A[k])
        variances = TAUS / (np.sum(values) if roughly else values[-1])
        spread = [np.eye(d) + v * A[k] for v in variances]
        explained = np.array([v * b[k] @ np.linalg.solve(S, b[k]) for v, S in zip(variances, spread, strict=True)])
        twice = profiled(explained, left, 800.0) - [np.linalg.slogdet(S)[1] for S in spread]
        assert found.variance[k] == pytest.approx(variances[np.argmax(twice)], rel=1e-9)
        assert found.twice[k] == pytest.approx(np.max(twice), rel=1e-7, abs=1e-7)
        assert found.freedom[k] == pytest.approx(d - np.trace(np.linalg.inv(spread[np.argmax(twice)])), rel=1e-6)
    assert found.informed.all()


@pytest.mark.filterwarnings("error")
def test_information_that_rounding_made_negative_is_none():
    A, b = made(5, 30, 12, 6.0, 0.5)
    ill = A - 1e-9 * np.linalg.norm(A, axis=(1, 2))[:, None, None] * np.eye(12)
    assert np.any(np.linalg.eigvalsh(ill) < 0.0)
    well, found = (likeliest(each, b, np.full(30, 1e-9), np.inf, 0.0) for each in (A, ill))
    np.testing.assert_allclose(found.twice, well.twice, rtol=1e-5, atol=1e-3)


def test_what_rounding_left_of_columns_explains_nothing():
    """Columns that the model has already: modes and pulls of rounding would explain everything with a large amplitude."""
    A, b = made(3, 4, 10, 1.0, 1.0)
    hidden = A.copy()
    hidden[1:3] *= 1e-13
    found = likeliest(hidden, b, np.full(4, 1e-6), np.inf, 0.0)
    assert np.all(found.twice[1:3] < 0.0)
    alone = likeliest(A[[0, 3]], b[[0, 3]], np.full(2, 1e-6), np.inf, 0.0)
    np.testing.assert_allclose(found.twice[[0, 3]], alone.twice)
    assert np.all(alone.twice > 0.0)


def test_a_mode_that_is_rounding_beside_others_is_left_out():
    """Its pull would be worth 1e4 nats; without it the others decide."""
    A, b = np.diag([1e4, 1e3, 1e-3])[None], np.array([[2e3, 3e2, 5.0]])
    found = likeliest(A, b, np.array([1e-2]), np.inf, 0.0)
    variances = TAUS / 1e4
    known = variances * sum(b[0, k] ** 2 / (1.0 + variances * A[0, k, k]) for k in (0, 1))
    twice = known - sum(np.log(1.0 + variances * A[0, k, k]) for k in (0, 1, 2))
    assert found.twice[0] == pytest.approx(np.max(twice), rel=1e-6)
    assert found.variance[0] == pytest.approx(variances[np.argmax(twice)])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [0.0, 1e-320, 1e-200])
def test_columns_that_are_nil_are_not_seen(size):
    found = likeliest(np.full((2, 3, 3), size), np.full((2, 3), size), np.zeros(2), 100.0, 50.0)
    assert not found.informed.any()
    assert np.isfinite(found.twice).all()


@pytest.mark.filterwarnings("error")
def test_dozens_of_modes_that_are_rounding_have_no_more_freedom_than_there_are_samples():
    """Large pulls: the likeliest amplitude is so large that information which rounding made negative counts a millionfold."""
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((6, 200, 2)) @ rng.standard_normal((6, 2, 70))
    noise = rng.standard_normal((6, 70, 70))
    A = np.swapaxes(columns, 1, 2) @ columns
    A = A + 1e-6 * np.linalg.norm(A, axis=(1, 2))[:, None, None] * (noise + np.swapaxes(noise, 1, 2)) / 24.0
    for roughly in (False, True):
        found = likeliest(A, 1e9 * columns[:, :7].sum(axis=1), np.zeros(6), np.inf, 0.0, roughly)
        assert np.isfinite(found.twice).all()
        assert np.all((found.freedom >= 0.0) & (found.freedom <= 70.0))
