"""Rows of one standstill: what belongs together, how it is stacked, and the likelihood of all of it written out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gauges
import numpy as np
import pytest
from scipy.linalg import block_diag

from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.scatter import Scatter, place
from aridcal.engine.fit.shared_readings import (
    MOST_CLUMP_UNKNOWNS,
    MOST_STANDSTILL_ROWS,
    clumps,
    representative,
    stack,
    standstills,
    with_things,
)
from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.fit.variance_components import add_component, estimate
from aridcal.engine.rows.dataset import Dataset, with_places

RNG = np.random.default_rng(0)


def unknown_markers(data: Dataset) -> Dataset:
    """The same rows with the board's markers unknown."""
    things = data.instruments.things
    marker = replace(things["marker"], free=np.ones_like(things["marker"].free))
    return replace(data, instruments=replace(data.instruments, things=things | {"marker": marker}))


def asked(folder: Path, name: str, images: int = 12) -> tuple[Problem, np.ndarray]:
    """A fitted campaign asked about its training rows."""
    arm = gauges.arm(3)
    block = {
        "pixels": lambda: gauges.pixels(arm, images),
        "markers": lambda: gauges.pixels(arm, images),
        "point": lambda: gauges.points(arm, 2, 12),
        "distance": lambda: gauges.distances(arm, 2, 30),
    }[name]()
    data = gauges.rows(arm, block)
    if name == "markers":
        data = unknown_markers(data)
    data = data.select(data.train)
    fit = fit_geometry(gauges.campaign(folder, arm, data).question, arm.robot, data, ()).geometric
    return problem(fit.model, data), fit.theta


def test_marks_of_one_image_stand_still_together_and_those_of_the_next_do_not() -> None:
    data = gauges.rows(arm := gauges.arm(3), gauges.pixels(arm, 12))
    number = standstills(data)
    _, image = np.unique(data.readings, axis=0, return_inverse=True)
    assert len(np.unique(number)) == 12
    assert len(np.unique(np.column_stack([number, image]), axis=0)) == 12
    again = data.select(np.concatenate([np.arange(len(data)), np.arange(5)]))  # five marks seen once more, there
    visits = standstills(again)
    assert np.array_equal(visits[:-5], number)
    assert len(set(visits[-5:])) == len(set(number[:5])) and not set(visits[-5:]) & set(number)


def test_wires_that_are_read_at_once_stand_still_together() -> None:
    data = gauges.rows(arm := gauges.arm(3), gauges.distances(arm, 3, 20))
    assert np.array_equal(standstills(data), np.arange(60))
    at_once = replace(data, readings=np.tile(data.readings[:20], (3, 1)))
    assert np.array_equal(standstills(at_once), np.tile(np.arange(20), 3))


def test_clumps_are_groups_that_a_standstill_joins() -> None:
    group = np.array([0, 0, 1, 1, 2, -1, 3, -1])
    assert clumps(np.arange(8), group).tolist() == [0, 0, 1, 1, 2, -1, 3, -1]
    joined = clumps(np.array([0, 1, 1, 2, 3, 3, 4, 5]), group)
    assert joined[0] == joined[1] == joined[2] == joined[3] >= 0 and joined[4] == joined[5] != joined[0]
    assert joined[6] not in joined[:6] and joined[7] == -1


def test_what_is_stacked_comes_back() -> None:
    there = RNG.random((9, 4)) < 0.6
    still = stack(np.array([4, 1, 1, 4, 0, 7, 7, 7, 4]), there)
    assert still.count == 4 and still.width == np.bincount([2, 1, 1, 2, 0, 3, 3, 3, 2], there.sum(axis=1)).max()
    values, matrices = np.where(there, RNG.normal(size=(9, 4)), 0.0), RNG.normal(size=(9, 4, 4))
    matrices = np.where(there[:, :, None] & there[:, None, :], matrices, 0.0)
    np.testing.assert_array_equal(still.of_rows(still.vectors(values)), values)
    np.testing.assert_array_equal(still.blocks_of_rows(still.matrices(matrices)), matrices)
    # Squared lengths and traces are the same: nothing is lost, and nothing is there twice.
    assert np.sum(still.vectors(values) ** 2) == pytest.approx(np.sum(values**2))
    assert np.sum(still.matrices(matrices) ** 2) == pytest.approx(np.sum(matrices**2))


def scattered(question: Problem, theta: np.ndarray) -> Scatter:
    """Standstills with two components: the channel, and what a random motion of all rows of a standstill does."""
    here = question.agreeing(theta)
    pieces = here.pieces(theta, slice(None))
    rows, m = question.data, pieces.r.shape[1]
    still = stack(standstills(rows), np.ones((len(rows), m), dtype=bool))
    root = still.vectors(np.random.default_rng(1).normal(size=(len(rows), m, 1)))
    channel = still.matrices(np.broadcast_to(np.eye(m), (len(rows), m, m)))
    J = pieces.J
    blocks = np.array([channel, root @ root.transpose(0, 2, 1)])
    made = Scatter(still.vectors(pieces.r), still.vectors(J), np.eye(J.shape[2]) * 1e4, blocks)
    return with_things(made, here, pieces.B, still)


@pytest.mark.parametrize("name", ["point", "distance", "markers", "pixels"])
def test_the_likelihood_with_unknown_things_is_that_of_dense_columns(tmp_path: Path, name: str) -> None:
    """All unknowns of all things as columns of one large matrix, what is known of them as rows of unit noise."""
    question, theta = asked(tmp_path, name)
    scatter, here = scattered(question, theta), question.agreeing(theta)
    pieces = here.pieces(theta, slice(None))
    n, m = pieces.r.shape
    still = stack(standstills(question.data), np.ones((n, m), dtype=bool))
    columns, facts = np.zeros((n, m, 0)), np.zeros((0, 0))
    left = np.zeros(0)
    if question.groups is not None and (question.groups.row >= 0).any():
        known, (G, U) = here.beforehand(), question.groups.unknown.shape
        assert known is not None
        columns, facts = np.zeros((n, m, G * U)), np.zeros((len(known.group), G * U))
        for i, g in enumerate(question.groups.row):
            columns[i, :, g * U : (g + 1) * U] = pieces.B[i]
        for i, g in enumerate(known.group):
            facts[i, g * U : (g + 1) * U] = known.by[i]
        left = known.misfit
        assert (name == "point") == (len(left) > 0)
    there = np.concatenate([columns.reshape(n * m, -1), facts])
    there = there[:, there.any(axis=0)]
    u, s, _ = np.linalg.svd(there / np.linalg.norm(there, axis=0) if there.size else there, full_matrices=False)
    there = u[:, s > 1e-8 * s.max(initial=1e-300)]
    J = np.concatenate([pieces.J.reshape(n * m, -1), np.zeros((len(left), pieces.J.shape[2]))])
    y = np.concatenate([pieces.r.ravel(), left])
    # Rows of one standstill one after the other, as they were stacked.
    where = (still.number[:, None] * still.width + still.place).ravel()
    dense, stacked = [], []
    for variance in ([1e-8, 0.0], [2e-8, 1e-8], [0.3e-8, 1e-9]):
        V = np.tensordot(variance, scatter.blocks[:, : still.count], axes=1)
        V = block_diag(block_diag(*V)[np.ix_(where, where)], np.eye(len(left)))
        A = np.hstack([J, there])
        W = np.linalg.inv(V)
        H = A.T @ W @ A
        H[: J.shape[1], : J.shape[1]] += scatter.precision
        r = y - A @ np.linalg.solve(H, A.T @ W @ y)
        dense.append(-0.5 * (np.linalg.slogdet(V)[1] + np.linalg.slogdet(H)[1] + y @ W @ r))
        stacked.append(place(scatter, np.array(variance)).log_likelihood)
    np.testing.assert_allclose(np.diff(stacked), np.diff(dense), rtol=1e-6)


def test_a_motion_that_rows_share_is_found_with_its_size_beside_unknown_markers(tmp_path: Path) -> None:
    """16 draws: a mean is known to a quarter of the std, the std of the draws to 18 %."""
    scatter = scattered(*asked(tmp_path, "markers", 60))
    held, found = np.array([True, False]), []
    values, vectors = np.linalg.eigh(scatter.blocks[1])
    root = np.sqrt(values[:, -1:]) * vectors[:, :, -1]
    there = np.einsum("nii->ni", scatter.blocks[0]) > 0
    for seed in range(16):
        rng = np.random.default_rng(seed)
        y = 0.2 * rng.normal(size=there.shape) * there + 0.5 * root * rng.normal(size=(len(there), 1))
        drawn = replace(scatter, y=y)
        more = add_component(drawn, estimate(drawn, np.array([0.04]), held), held)
        assert more is not None
        found.append((more[1].sigma, more[1].sigma_std))
    sigma, std = np.array(found).transpose(1, 0, 2)
    assert np.all(np.abs(sigma.mean(axis=0) - [0.2, 0.5]) < 4 * std.mean(axis=0) / 4)
    np.testing.assert_allclose(sigma.std(axis=0), std.mean(axis=0), rtol=0.5)


def test_of_many_rows_whole_standstills_are_asked_and_few_markers(tmp_path: Path) -> None:
    question, _ = asked(tmp_path, "markers")
    rows, every = question.data, np.arange(len(question))
    some = representative(question, every, 60)
    number = standstills(rows)
    assert question.groups is not None
    assert 60 <= len(some) <= 60 + MOST_STANDSTILL_ROWS
    assert np.array_equal(np.sort(np.flatnonzero(np.isin(number, number[some]))), some)
    assert np.array_equal(some, representative(question, every, 60))
    # Twenty markers have 60 unknowns; of four times as many the most seen would stay.
    many = replace(question.groups, unknown=np.ones((len(question.groups.unknown), 12), dtype=bool))
    kept = representative(replace(question, groups=many), every, len(rows))
    groups = np.unique(question.groups.row[kept])
    assert 12 * len(groups) == MOST_CLUMP_UNKNOWNS
    seen = np.bincount(question.groups.row)
    assert seen[groups].min() >= np.delete(seen, groups).max()


def test_of_many_points_whole_points_are_asked(tmp_path: Path) -> None:
    question, _ = asked(tmp_path, "point")
    some = representative(question, np.arange(len(question)), 15)
    assert question.groups is not None
    group = question.groups.row
    assert 15 <= len(some) < len(group) and np.array_equal(np.flatnonzero(np.isin(group, group[some])), some)


def test_rows_of_plain_poses_stand_alone() -> None:
    data = gauges.rows(arm := gauges.arm(3), gauges.levels(arm, 10))
    twice = data.select(np.arange(20) % 10)
    assert np.array_equal(standstills(with_places(twice, np.zeros((20, 3)))), np.arange(20))


def test_rows_that_stand_alone_are_stacked_as_any_others() -> None:
    """The short way of rows that measure everything against the long way that others take."""
    alone = stack(np.arange(4), np.ones((4, 3), dtype=bool))
    assert alone.apart and not stack(np.array([2, 0, 3, 1]), np.ones((4, 3), dtype=bool)).apart
    values, covariance = RNG.normal(size=(4, 3, 2)), RNG.normal(size=(4, 3, 3))
    # A number that nobody measures, at one row more, and all goes the long way.
    holes = np.ones((5, 3), dtype=bool)
    holes[4, 1] = False
    others = stack(np.arange(5), holes)
    assert not others.apart
    np.testing.assert_array_equal(alone.vectors(values), others.vectors(np.pad(values, ((0, 1), (0, 0), (0, 0))))[:4])
    padded = np.pad(covariance, ((0, 1), (0, 0), (0, 0)))
    np.testing.assert_array_equal(alone.matrices(covariance), others.matrices(padded)[:4])
    assert not stack(np.array([0, 0, 1]), np.ones((3, 3), dtype=bool)).apart
    of_two_kinds = np.array([[True, True, True, False], [True, False, False, False]])  # as many rows, of other numbers
    assert not stack(np.array([1, 0]), of_two_kinds).apart
