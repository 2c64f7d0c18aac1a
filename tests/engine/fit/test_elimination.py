"""Things solved for beside the model: the same answer as with all their unknowns carried along, at a fraction of the cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robots import ur10
from scipy.linalg import subspace_angles

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.elimination import prior_rows
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.residual import linearise, reduced_stretches, thing_projector
from aridcal.engine.instruments.channels import LENGTH, TARGET_POSITION
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.instruments.setup import Block, Instruments, Things, Tie
from aridcal.engine.model.model import Model
from aridcal.engine.rows.dataset import Dataset, dataset

POINT = MEASUREMENT_KINDS["point"].roles[0]
ANCHOR = MEASUREMENT_KINDS["distance"].roles[0]
SIGMA = np.array([2e-3, 1e-3])


def mixed(ties: bool, seed: int = 0) -> tuple[Model, Dataset, np.random.Generator]:
    """Points and wires at random, far from any solution: what is claimed is algebra."""
    rng = np.random.default_rng(seed)
    robot = ur10()
    n, points, anchors = 60, ("a", "b", "c"), ("left", "right")
    data = dataset(robot.readings, robot.kinds, rng.uniform(-2, 2, (n, 6)), np.full((n, 3), np.nan))
    block = (np.arange(n) % 3 == 0).astype(int)
    refers = np.full((n, 3), "", dtype="U8")
    refers[:, 0] = np.where(block == 0, rng.choice(points, n), rng.choice(anchors, n))
    things = {
        "point": Things(POINT, points, rng.normal(size=(3, 3)), np.ones((3, 3), bool), np.full((3, 3), np.inf)),
        "anchor": Things(
            ANCHOR,
            anchors,
            np.column_stack([rng.normal(size=(2, 3)) + 3.0, np.zeros(2), np.ones(2)]),
            np.array([[True, True, True, True, False]] * 2),
            np.full((2, 5), np.inf),
        ),
    }
    tied = (Tie("point", "a", "b", "distance", 0.5, 1e-3),) if ties else ()
    data = replace(
        data,
        blocks=(Block("points", "point", (TARGET_POSITION,), (None,)), Block("wires", "distance", (LENGTH,), (None,))),
        observed=rng.uniform(2.0, 4.0, (n, 1)),
        labels=replace(data.labels, block=block, refers=refers),
        instruments=Instruments(things, tied),
    )
    names = ("elbow_joint", "wrist_1_joint", "wrist_2_joint")
    own = tuple(Coefficient(name, c) for name in names for c in ("x", "roll", "yaw"))
    model = Model(robot, own, instruments=data.instruments)
    return model, data, rng


def dense(asked: Problem, theta: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Whitened columns of coefficients and of all unknowns of things, and the residual, rows of ties among them."""
    assert asked.groups is not None
    pieces = asked.pieces(theta)
    r, J, B = pieces.r, pieces.J, pieces.B
    groups, width = asked.groups.unknown.shape
    wide = np.zeros((*r.shape, groups, width))
    wide[np.arange(len(r)), :, asked.groups.row] = B
    scale = np.sqrt(weight)[:, None] / np.array([SIGMA[0]] * 3 + [SIGMA[1]])
    columns = np.concatenate([J, wide.reshape(*r.shape, -1)], axis=2) * scale[:, :, None]
    A, b = columns.reshape(r.size, -1), (r * scale).ravel()
    facts = prior_rows(asked.groups, asked.instruments, asked.states)
    more = np.zeros((len(facts.group), A.shape[1]))
    for k, g in enumerate(facts.group):
        more[k, len(theta) + g * width : len(theta) + (g + 1) * width] = facts.by[k]
    return np.vstack([A, more]), np.concatenate([b, facts.misfit]), len(theta)


@pytest.mark.parametrize("ties", [False, True])
def test_a_step_is_that_of_all_unknowns_together(ties: bool) -> None:
    model, data, rng = mixed(ties)
    theta = 1e-2 * rng.normal(size=9)
    asked = problem(model, data).agreeing(theta)
    weight = rng.choice([0.0, 1.0], len(data), p=[0.1, 0.9])
    A, b, K = dense(asked, theta, weight)
    whole = np.linalg.lstsq(A, b, rcond=None)[0]
    here = linearise(asked, theta, weight, SIGMA)
    step = np.linalg.solve(here.equations.information(SIGMA), here.equations.pull(SIGMA))
    np.testing.assert_allclose(step, whole[:K], rtol=1e-7, atol=1e-10)
    assert asked.groups is not None
    follow = here.step_of_groups(step)
    np.testing.assert_allclose(
        follow[asked.groups.unknown], whole[K:].reshape(follow.shape)[asked.groups.unknown], rtol=1e-7, atol=1e-9
    )


@pytest.mark.parametrize("ties", [False, True])
def test_the_information_left_is_the_schur_complement(ties: bool) -> None:
    model, data, rng = mixed(ties)
    theta, weight = 1e-2 * rng.normal(size=9), np.ones(len(data))
    asked = problem(model, data).agreeing(theta)
    A, b, K = dense(asked, theta, weight)
    H = A.T @ A
    own, other = H[:K, :K], H[K:, K:]
    used = np.diag(other) > 0
    left = own - H[:K, K:][:, used] @ np.linalg.solve(other[np.ix_(used, used)], H[K:, :K][used])
    here = linearise(asked, theta, weight, SIGMA)
    np.testing.assert_allclose(here.equations.information(SIGMA), left, rtol=1e-6, atol=1e-6 * np.abs(left).max())
    best = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    step = np.linalg.solve(here.equations.information(SIGMA), here.equations.pull(SIGMA))
    squares = here.equations.squares_left(step) / SIGMA**2
    np.testing.assert_allclose(squares.sum(), best @ best, rtol=1e-8)


def test_unknowns_cost_the_freedom_that_they_take() -> None:
    """3 points and 2 anchors of 4 unknowns each: numbers measured, less those."""
    model, data, _ = mixed(False)
    here = linearise(problem(model, data), np.zeros(9), np.ones(len(data)), SIGMA)
    points, wires = (data.labels.block == 0).sum(), (data.labels.block == 1).sum()
    np.testing.assert_allclose(here.equations.count, [3 * points - 9, wires - 8])
    np.testing.assert_allclose(problem(model, data).taken(np.ones(len(data))), [9, 8])


def test_columns_are_taken_off_after_their_bases() -> None:
    """A motion that grows with a covariate: taken off before the product, it would be another column."""
    model, data, rng = mixed(False)
    theta, weight = np.zeros(9), np.ones(len(data))
    asked = problem(model, data).agreeing(theta)
    off = thing_projector(asked, theta, weight, SIGMA)
    assert off is not None
    J = asked.pieces(theta).J
    phi = rng.normal(size=len(data))
    column = J[:, :, 3] * phi[:, None]
    A, _, K = dense(asked, theta, weight)
    B = A[:, K:]
    scale = np.array([SIGMA[0]] * 3 + [SIGMA[1]])
    flat = (column / scale).ravel()
    expected = flat - B @ np.linalg.lstsq(B, flat, rcond=None)[0]
    np.testing.assert_allclose(
        (off(column[:, :, None])[:, :, 0] / scale).ravel(), expected, atol=1e-7 * np.abs(flat).max()
    )
    wrong = (off(J[:, :, 3:4])[:, :, 0] * phi[:, None] / scale).ravel()
    assert np.abs(wrong - expected).max() > 0.1 * np.abs(flat).max()


def test_rows_less_their_things_are_orthogonal_to_them() -> None:
    model, data, _ = mixed(False)
    theta, weight = np.zeros(9), np.ones(len(data))
    asked = problem(model, data).agreeing(theta)
    A, _, K = dense(asked, theta, weight)
    scale = np.array([SIGMA[0]] * 3 + [SIGMA[1]])
    for block, r, J in reduced_stretches(asked, theta, weight, SIGMA):
        rows = np.column_stack([(r / scale).ravel(), (J / scale[:, None]).reshape(r.size, -1)])
        part = A[: r.size, K:]
        assert np.abs(part.T @ rows).max() < 1e-6 * np.abs(part.T @ part).max()
        assert block.start == 0


def touching(coefficients: tuple[Coefficient, ...]) -> Problem:
    """Forty noisy rows of one unknown point, in a wide range of postures near one."""
    rng = np.random.default_rng(1)
    robot = ur10()
    n = 40
    q = np.array([0.3, -1.2, 1.5, -0.5, 0.8, 0.0]) + 0.02 * rng.uniform(-1, 1, (n, 6))
    data = dataset(robot.readings, robot.kinds, q, np.full((n, 3), np.nan))
    refers = np.full((n, 3), "", dtype="U8")
    refers[:, 0] = "a"
    base = Model(robot, coefficients)
    zero = np.zeros(len(coefficients))
    middle = base.poses(zero, base.rows(q))[1].mean(axis=0)
    things = Things(POINT, ("a",), middle[None], np.ones((1, 3), bool), np.full((1, 3), np.inf))
    data = replace(
        data,
        blocks=(Block("points", "point", (TARGET_POSITION,), (None,)),),
        observed=np.zeros((n, 0)),
        labels=replace(data.labels, refers=refers),
        instruments=Instruments({"point": things}),
    )
    return problem(replace(base, instruments=data.instruments), data)


def test_what_no_point_tells_is_redundant_only_where_rows_agree() -> None:
    """A turn of the base about the vertical moves all points: no row tells it, however far off the rows are."""
    asked = touching((Coefficient("shoulder_pan_joint", "yaw"),))
    one = np.ones(len(asked))

    def seen(question: Problem) -> float:
        (_, _, J) = next(reduced_stretches(question, np.zeros(1), one, np.array([1e-4])))
        return float(np.linalg.norm(J))

    assert seen(replace(asked, measured=replace(asked.measured, agreed=asked.rows))) > 1e-3
    there = asked.agreeing(np.zeros(1))
    assert there.measured.agreed is not None
    moved = replace(there.measured, rows=there.measured.agreed)
    assert np.abs(moved.residual(np.zeros(1))).max() < 1e-9
    assert seen(there) < 1e-8


def test_a_motion_that_turns_back_with_a_joint_is_a_fixed_one_where_rows_agree() -> None:
    """Runout of order 1 that turns with a joint shifts the next one: two directions of both are the same, noise or not."""
    wave = [(c, form) for c in ("t1", "t2") for form in ("sin", "cos")]
    runout = tuple(Coefficient("elbow_joint", c, Basis(form, ("elbow_joint",), (1.0,))) for c, form in wave)
    shift = tuple(Coefficient("wrist_1_joint", c) for c in "xyz")
    asked = touching((*shift, *runout))

    def shared(question: Problem) -> float:
        _, J = question.linearised(np.zeros(7))
        return float(np.sort(subspace_angles(J[:, :, :3].reshape(-1, 3), J[:, :, 3:].reshape(-1, 4)))[1])

    there = asked.agreeing(np.zeros(7))
    assert shared(there) < 1e-7
    at = there.measured.agreed
    assert at is not None
    as_read = replace(at, phi=asked.rows.phi)  # bases at the readings, motions elsewhere
    assert shared(replace(there, measured=replace(there.measured, agreed=as_read))) > 1e-4
