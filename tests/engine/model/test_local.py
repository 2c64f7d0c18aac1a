"""Hat functions that act in few rows, against a column for each of them: the same sums, covariances and motions."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import robots

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.noise import covariance_of_rows
from aridcal.engine.fit.problem import Problem
from aridcal.engine.fit.problem import problem as ask
from aridcal.engine.fit.residual import linearise, scaled_columns
from aridcal.engine.instruments.channels import columns
from aridcal.engine.model.local import LEAST_HATS
from aridcal.engine.model.model import Model
from aridcal.engine.trust.coverage import Coverage
from aridcal.engine.trust.workspace import Knowledge, shifted, target_covariance

COUNT = 45


def mapped(count: int = COUNT) -> tuple[Model, np.ndarray]:
    """An arm with hat functions of all its joints, one of which depends on another's reading too, between other effects."""
    rng, robot = np.random.default_rng(0), robots.ur10()
    knots = np.linspace(-2.0, 2.0, count).tolist()
    hats = [Coefficient(j, "axis", Basis("bump", (j,), (at, 0.1))) for j in robot.names for at in knots]
    crossing = Coefficient(robot.names[2], "r1", Basis("sin", (robot.names[0],), (1.5,)))
    constant = Coefficient(robot.names[1], "axis")
    # Not in the usual order: constants first.
    every = (*robots.FRAMES, *hats[:50], constant, *hats[50:], crossing)
    frames = [((None, robots.random_placement(rng)),) for _ in range(2)]
    return Model(robot, every, *frames), rng.normal(0, 1e-3, len(every))


def questions(kind: str) -> tuple[Problem, Problem, np.ndarray]:
    """A question whose hat functions are summed where they act, the same with a column for each, and coefficients."""
    rng = np.random.default_rng(1)
    model, theta = mapped()
    q = rng.uniform(-1.5, 1.5, (2_100, 6))  # two stretches of rows
    q[7] = 4.0  # beyond all knots: no hat function acts
    q[8] = np.linspace(-1.5, 1.5, 6)
    R, p = model.poses(theta, model.rows(q))
    data = robots.measured(model.robot, q, p + rng.normal(0, 1e-3, p.shape), None if kind == "position" else R)
    if kind == "relative":
        relative = rng.uniform(0.3, 3.0, (len(q), 6))
        data = replace(data, relative=relative)
    question = ask(model, data)
    assert model.local is not None
    wide = replace(model)
    wide.__dict__["local"] = None
    return (
        question,
        replace(question, measured=replace(question.measured, model=wide)),
        theta + rng.normal(0, 1e-3, len(theta)),
    )


@pytest.mark.parametrize("kind", ["pose", "position", "relative"])
def test_sums_over_rows_are_those_of_all_columns(kind: str) -> None:
    question, wide, theta = questions(kind)
    sigma = np.array([1e-3, 2e-3])[: len(question.channels)]
    for weight in (None, np.random.default_rng(2).uniform(0, 1, len(question))):
        found, known = (linearise(q, theta, weight, sigma) for q in (question, wide))
        np.testing.assert_array_equal(found.residual, known.residual)
        np.testing.assert_array_equal(found.weight, known.weight)
        for name in ("AA", "Ar", "rr", "count"):
            a, b = getattr(found.equations, name), getattr(known.equations, name)
            np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-12 * np.abs(b).max(), err_msg=name)
    # And by hand, from the columns themselves.
    _, J = wide.linearised(theta)
    for k, part in enumerate(columns(question.channels)):
        own = J[:, part] * np.sqrt(found.weight * question.data.repeats.share)[:, None, None]
        flat = own.reshape(-1, len(theta))
        np.testing.assert_allclose(found.equations.AA[k], flat.T @ flat, rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize("kind", ["pose", "position", "relative"])
def test_covariances_of_rows_are_those_of_all_columns(kind: str) -> None:
    question, wide, theta = questions(kind)
    root = np.random.default_rng(3).normal(size=(len(theta), len(theta)))
    covariance, part = root @ root.T, slice(0, 100)
    found, known = (q.carried(theta, covariance, part) for q in (question, wide))
    np.testing.assert_allclose(found, known, rtol=1e-11, atol=1e-12 * np.abs(known).max())
    tool = np.array([0.1, -0.2, 0.3])
    rows = question.rows[part]
    R, _, J = wide.model.jacobian(theta, rows)
    known = covariance_of_rows(shifted(J, R @ tool), covariance)
    found = target_covariance(question.model, theta, covariance, rows, tool)
    np.testing.assert_allclose(found, known, rtol=1e-9, atol=1e-12 * np.abs(known).max())


def test_what_is_known_of_a_point_is_the_same_with_a_column_for_each() -> None:
    """With constants that no reading tells behind the coefficients, which those of all rows follow and hat functions do not."""
    question, _, theta = questions("pose")
    rng, model, count = np.random.default_rng(4), question.model, len(theta)
    root = rng.normal(0, 1e-5, (count, count))
    fit: Any = SimpleNamespace(model=model, theta=theta, covariance=root @ root.T)
    open_ = [Coefficient(model.robot.names[3], "r1"), Coefficient(model.robot.names[4], "axis")]
    constant = np.array([c.basis.constant for c in model.coefficients])
    follows = np.where(constant[:, None], rng.normal(0, 0.5, (count, 2)), 0.0)
    local = model.with_coefficients((*model.coefficients, *open_))
    wide = replace(local)
    wide.__dict__["local"] = None
    assert local.local is not None
    seen = Coverage({}, {}, (np.inf, np.inf))
    asked = question.data.readings[:120], np.arange(120), (0.1, -0.2, 0.3)
    found, known = (
        Knowledge(fit, own, follows, np.array([[4e-6, 1e-6], [1e-6, 9e-6]]), seen).over(question.data, *asked)
        for own in (local, wide)
    )
    for name in ("places", "covariance", "turns", "observable", "turns_told"):
        np.testing.assert_allclose(getattr(found, name), getattr(known, name), rtol=1e-9, atol=1e-16, err_msg=name)
    assert known.observable.any() or known.turns_told.any()


def test_columns_of_the_last_coefficients_are_those_among_all() -> None:
    question, wide, theta = questions("relative")
    _, _, J = wide.model.jacobian(theta, wide.rows)
    assert question.data.relative is not None
    for count in (1, 200, len(theta)):  # with no constant; with one between the hat functions; all
        known = J[:, :, len(theta) - count :] / question.data.relative[:, :, None]
        np.testing.assert_allclose(scaled_columns(question, theta, count), known, rtol=1e-12, atol=1e-14)


def test_few_hat_functions_and_those_of_stations_have_columns() -> None:
    model, _ = mapped()
    assert sum(c.basis.form == "bump" for c in model.coefficients) >= LEAST_HATS
    assert mapped(LEAST_HATS // 6)[0].local is None
    first, *others = model.coefficients
    assert model.with_coefficients([replace(first, station="A"), *others]).local is None
