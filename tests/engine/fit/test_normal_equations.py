"""Sums of weighted least squares: each against the columns themselves, stacked and solved by another code."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy.linalg import block_diag, pinvh

from aridcal.engine.fit.normal_equations import (
    CombinedEquations,
    NormalEquations,
    Prior,
    accumulate,
    added,
    condition,
    conditional,
    inverse,
    root_of_inverse,
    solve,
)

SIZES = (90, 60, 30)
"""Numbers measured in each of three channels."""

SIGMA = np.array([0.1, 2.0, 30.0])

Columns = list[np.ndarray]


def columns(seed: int, K: int, sizes: tuple[int, ...] = SIZES) -> Columns:
    rng = np.random.default_rng(seed)
    return [rng.standard_normal((n, K)) * np.logspace(0, 3, K) for n in sizes]


def right(seed: int, sizes: tuple[int, ...] = SIZES) -> Columns:
    rng = np.random.default_rng(seed)
    return [s * rng.standard_normal(n) for s, n in zip(SIGMA, sizes, strict=True)]


def beside(A: Columns, C: Columns) -> Columns:
    return [np.hstack(pair) for pair in zip(A, C, strict=True)]


def stacked(parts: Columns, sigma: np.ndarray = SIGMA) -> np.ndarray:
    """All channels under one another, in sigmas."""
    return np.concatenate([part / s for part, s in zip(parts, sigma, strict=True)])


def least_squares(A: Columns, r: Columns) -> np.ndarray:
    return np.linalg.lstsq(stacked(A), stacked(r), rcond=None)[0]


def assert_same(one: NormalEquations, other: NormalEquations) -> None:
    for field in fields(NormalEquations):
        a, b = getattr(one, field.name), getattr(other, field.name)
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-10 * np.abs(b).max())


def test_information_and_pull_are_those_of_the_whitened_columns() -> None:
    A, r = columns(0, 4), right(1)
    found = accumulate(A, r)
    W, b = stacked(A), stacked(r)
    np.testing.assert_allclose(found.information(SIGMA), W.T @ W, rtol=1e-10)
    np.testing.assert_allclose(found.pull(SIGMA), W.T @ b, rtol=1e-10)
    assert found.count.tolist() == list(SIZES)
    theta = solve(found.information(SIGMA), found.pull(SIGMA))
    np.testing.assert_allclose(theta, least_squares(A, r), rtol=1e-9)
    left = [np.sum((b - a @ theta) ** 2) for a, b in zip(A, r, strict=True)]
    np.testing.assert_allclose(found.squares_left(theta), left, rtol=1e-9)
    H = inverse(found.information(SIGMA))
    np.testing.assert_allclose(H, np.linalg.inv(W.T @ W), rtol=1e-9, atol=1e-12 * np.abs(H).max())


def test_a_channel_gives_up_the_trace_of_its_part_of_the_hat_matrix() -> None:
    A, r = columns(2, 4), right(3)
    found = accumulate(A, r)
    W = stacked(A)
    hat = np.diag(W @ np.linalg.pinv(W))
    each = [part.sum() for part in np.split(hat, np.cumsum(SIZES)[:-1])]
    spent = found.spent(inverse(found.information(SIGMA)), SIGMA)
    np.testing.assert_allclose(spent, each, rtol=1e-9)
    assert spent.sum() == pytest.approx(4)


def test_rows_taken_out_were_never_there() -> None:
    A, r = columns(4, 4), right(5)
    few = tuple(n // 3 for n in SIZES)
    gone, kept = (
        accumulate(
            [a[part] for a, part in zip(A, parts, strict=True)], [b[part] for b, part in zip(r, parts, strict=True)]
        )
        for parts in ([slice(0, n) for n in few], [slice(n, None) for n in few])
    )
    assert_same(accumulate(A, r).minus(gone), kept)


def test_added_and_combined_and_chosen_unknowns_are_those_of_the_columns_themselves() -> None:
    A, C, r = columns(6, 4), columns(7, 3), right(8)
    cross, own, pull = ([p.T @ q for p, q in zip(*pair, strict=True)] for pair in ((A, C), (C, C), (C, r)))
    both = accumulate(A, r).bordered(np.array(cross), np.array(own), np.array(pull))
    assert_same(both, accumulate(beside(A, C), r))
    T = np.random.default_rng(9).standard_normal((3, 2))
    assert_same(both.combined(T), accumulate(beside(A, [c @ T for c in C]), r))
    keep = np.array([True, False, True, True, False, False, True])
    assert_same(both.part(keep), accumulate([a[:, keep] for a in beside(A, C)], r))


@pytest.mark.parametrize("alike", [0.0, 1.0 - 1e-9, 1.0])
def test_unknowns_added_to_a_known_inverse_have_the_joint_solution(alike: float) -> None:
    """Whether or not what is added nearly coincides with what is there."""
    rng = np.random.default_rng(5)
    A, C = rng.standard_normal((2, 60, 4)), rng.standard_normal((2, 60, 3))
    C[:, :, 0] = alike * A[:, :, 1] + (1.0 - alike) * C[:, :, 0]
    r, sigma = rng.standard_normal((2, 60)), np.array([0.5, 3.0])
    alone, P = accumulate(list(A), list(r)), np.diag([0.3] * 4 + [1e-3] * 3)
    every = accumulate(beside(list(A), list(C)), list(r))
    known = np.linalg.inv(alone.information(sigma) + P[:4, :4])
    theta, spent = added(every, P, known, alone.spent(known, sigma), sigma)
    H = every.information(sigma) + P
    np.testing.assert_allclose(theta, np.linalg.solve(H, every.pull(sigma)), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(spent, every.spent(np.linalg.inv(H), sigma), rtol=1e-6)


def test_unknowns_taken_out_leave_the_solution_of_the_rest() -> None:
    A, r = columns(12, 6), right(13)
    theta = least_squares(A, r)
    W = stacked(A)
    gone = np.array([False, True, False, False, True, False])
    V = np.linalg.inv(W.T @ W)
    found = conditional(V, theta, gone)
    assert not found[gone].any()
    np.testing.assert_allclose(found[~gone], least_squares([a[:, ~gone] for a in A], r), rtol=1e-8)
    held = np.array([True, False, False, False, False, True])  # neither gone nor free: these stay where they were
    found = conditional(V, theta, gone, held)
    np.testing.assert_array_equal(found[held], theta[held])
    rest = [b - a[:, held] @ theta[held] for a, b in zip(A, r, strict=True)]
    np.testing.assert_allclose(found[~gone & ~held], least_squares([a[:, ~gone & ~held] for a in A], rest), rtol=1e-8)


def test_columns_that_are_the_same_share_the_solution_and_one_that_moves_nothing_stays_at_zero() -> None:
    """Each column scaled to length 1: the shortest solution then, numpy's pseudo-inverse of the columns."""
    a, r = columns(14, 3), right(15)
    A = [np.column_stack([c, c[:, 0], np.zeros(len(c))]) for c in a]
    found = accumulate(A, r)
    theta = solve(found.information(SIGMA), found.pull(SIGMA))
    assert theta[4] == 0.0
    np.testing.assert_allclose(theta[:4], least_squares([part[:, :4] for part in A], r), rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(stacked(A) @ theta, stacked(a) @ least_squares(a, r), atol=1e-6)


def test_damping_shortens_each_unknown_by_its_own_measure() -> None:
    """Levenberg's: as if each were measured to be zero, so often as a share of what the rows say of it."""
    A, r = columns(16, 4), right(17)
    W = stacked(A)
    H = W.T @ W
    rows = np.diag(np.sqrt(0.3 * np.diag(H)))
    shorter = np.linalg.lstsq(np.vstack([W, rows]), np.append(stacked(r), np.zeros(4)), rcond=None)[0]
    np.testing.assert_allclose(solve(H, W.T @ stacked(r), damping=0.3), shorter, rtol=1e-9)


def test_channels_of_one_are_the_sum_of_their_rows() -> None:
    """Rows whitened beforehand and put into one channel say what several channels say."""
    A, r = columns(18, 4), right(19)
    one = accumulate([stacked(A)], [stacked(r)])
    np.testing.assert_allclose(one.information(np.ones(1)), accumulate(A, r).information(SIGMA), rtol=1e-10)
    apart = block_diag(*(np.eye(n) / s**2 for n, s in zip(SIZES, SIGMA, strict=True)))
    whole = np.concatenate(A)
    np.testing.assert_allclose(one.information(np.ones(1)), whole.T @ apart @ whole, rtol=1e-10)


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_a_step_in_the_priors_combinations_is_that_of_the_stacked_columns_with_the_prior_as_rows(
    damping: float,
) -> None:
    rng = np.random.default_rng(5)
    A, r = columns(11, 7), right(12)
    basis = (np.eye(2), rng.standard_normal((3, 3)), rng.standard_normal((2, 2)))
    B, root = block_diag(*basis), rng.standard_normal((7, 7))
    prior = Prior(rng.standard_normal(7), root.T @ root, basis)
    theta = rng.standard_normal(7)
    told = CombinedEquations(accumulate(A, r), prior)
    step = told.of_coefficients(solve(told.information(SIGMA), told.pull(SIGMA, theta), damping)[:, None])[:, 0]

    rows = np.vstack([stacked(A), root]) @ B
    values = np.concatenate([stacked(right(12)), root @ (prior.mean - theta)])
    length = np.linalg.norm(rows, axis=0)
    damped = np.vstack([rows, np.sqrt(damping) * np.diag(length)])
    expected = B @ np.linalg.lstsq(damped, np.concatenate([values, np.zeros(7)]), rcond=None)[0]
    assert step == pytest.approx(expected, rel=1e-8)

    whole = np.vstack([stacked(A), root])
    assert told.covariance(inverse(told.information(SIGMA), ridge=0.0)) == pytest.approx(
        np.linalg.inv(whole.T @ whole), rel=1e-6
    )


def test_the_condition_number_is_that_of_the_columns_scaled_to_length_one() -> None:
    A = np.vstack(columns(3, 6))
    assert condition(A.T @ A) == pytest.approx(np.linalg.cond(A / np.linalg.norm(A, axis=0)), rel=1e-9)


@pytest.mark.parametrize("weak", [1.0, 1e-3, 1e-6])
def test_the_root_of_an_inverse_has_the_directions_that_are_told(weak: float) -> None:
    """Second road: the pseudo-inverse of SciPy. The weakest direction is told, told barely, and not: below the share."""
    rng = np.random.default_rng(5)
    turned = np.linalg.qr(rng.standard_normal((5, 5)))[0]
    M = (turned * np.array([1.0, 0.8, 0.5, 0.3, weak])) @ turned.T
    size = np.sqrt(np.diag(M))
    root, share = root_of_inverse(M, 1e-4), np.linalg.eigvalsh(M / size / size[:, None])
    told = np.count_nonzero(share > 1e-4 * share[-1])
    assert root.shape == (told, 5) and told == (4 if weak == 1e-6 else 5)
    expected = pinvh(M / size / size[:, None], rtol=1e-4) / size / size[:, None]
    assert root.T @ root == pytest.approx(expected, rel=1e-9)
