"""The page on the claims of 1992: it is what its command makes, and its figures come out by other roads as well."""

from __future__ import annotations

import numpy as np
import pytest
from doty1992_claims import FOLDER, LENGTHS, NOISE, POSES, SQUARES, Claims, claims, page, pictures, strip_readings
from doty_arm import angles, arid, random_q
from repository import ROOT

from aridcal.jobs.head1992.doty1992 import ORBITER_TO_BASE, error_vector, pose, solve_psi

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def found() -> Claims:
    return claims()


def slopes(q: np.ndarray, rows: list[int]) -> np.ndarray:
    """Second road to E: central differences of the exact kinematics, all poses one above the other, shape (rows n, 8)."""
    step, columns = 1e-6, []
    for psi in np.eye(8):
        ends = [error_vector(pose(arid(sign * step * psi, LENGTHS), q), q[:, 0])[:, rows] for sign in (1, -1)]
        columns.append((ends[0] - ends[1]).ravel() / (2 * step))
    return np.stack(columns, axis=1)


def condition(matrix: np.ndarray) -> float:
    values = np.linalg.svd(matrix, compute_uv=False)
    return float(values[0] / values[-1])


def test_the_page_is_what_the_command_makes(found: Claims) -> None:
    assert (DOCS / "claims-of-1992.md").read_text("utf-8") == page(found)
    for name in pictures(found):
        assert (DOCS / FOLDER / f"{name}.svg").stat().st_size > 10_000


def test_ranks_are_those_of_the_exact_kinematics(found: Claims) -> None:
    rng = np.random.default_rng(1)
    for n, (four, five) in found.ranks.items():
        q = random_q(rng, n)
        for rows, expected in (([0, 1, 2, 3], four), ([0, 1, 2, 3, 4], five)):
            values = np.linalg.svd(slopes(q, rows), compute_uv=False)
            assert np.sum(values > 1e-7 * values[0]) == expected
    assert found.ranks[2][0] == 4
    assert next(n for n in found.ranks if found.ranks[n][1] == 8) == 3


def test_two_poses_are_singular_and_the_printed_matrix_hides_it(found: Claims) -> None:
    correct, printed = found.values
    assert np.all(correct[:, 4:] < 1e-12 * correct[:, :1])
    assert np.all(correct[:, 3] > 1e-3)
    assert np.all(printed[:, 7] > 1e-6 * printed[:, 0])
    assert np.median(found.printed_error) > 2.0


def test_condition_numbers_are_those_of_the_exact_kinematics(found: Claims) -> None:
    rng = np.random.default_rng(2)
    seen = [condition(slopes(random_q(rng, SQUARES), [0, 1, 2, 3, 4])) for _ in range(40)]
    assert np.median(seen) == pytest.approx(found.condition[POSES.index(SQUARES), 1], rel=0.06)
    of_strips = [condition(slopes(q, [0, 1, 2, 3, 4])) for q in strip_readings()]
    np.testing.assert_allclose(found.strips, of_strips, rtol=1e-5)


def test_strips_are_28_squares_each_at_one_place_of_the_rail() -> None:
    strips = strip_readings()
    assert [len(q) for q in strips] == [SQUARES] * 3
    assert all(np.ptp(q[:, 0]) < 0.3 for q in strips)
    assert np.linalg.det(ORBITER_TO_BASE) == pytest.approx(1.0)


def test_sigmas_of_psi_are_the_scatter_of_measured_strips(found: Claims) -> None:
    """Second road: noise on the poses' own numbers, psi solved for again and again by weighted least squares."""
    rng = np.random.default_rng(3)
    q = strip_readings()[1]
    matrix = (slopes(q, [0, 1, 4]).reshape(-1, 3, 8) / NOISE[:, None]).reshape(-1, 8)
    noise = rng.normal(size=(4000, len(matrix)))
    scatter = 1e3 * np.std(noise @ np.linalg.pinv(matrix).T, axis=0)
    worst, best = found.sigma["28 of a strip"]
    assert scatter.max() == pytest.approx(worst, rel=0.1)
    assert scatter.min() == pytest.approx(best, rel=0.1)
    psi = 1e-3 * rng.normal(size=8)
    back, _ = solve_psi(pose(arid(psi, LENGTHS), q), angles(q), q[:, 0], LENGTHS)
    np.testing.assert_allclose(back, psi, atol=1e-6)
