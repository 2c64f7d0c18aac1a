"""Sets of effects: their evidence is the integral that it is said to be, and a set that single steps do not reach is found."""

from __future__ import annotations

from dataclasses import replace
from math import comb, factorial, log
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from linear_models import linear, made_up, with_effect
from robots import simulate, table, ur10, write_campaign
from scipy.stats import multivariate_normal
from searched import searched

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.levels import PRICE
from aridcal.engine.search import set_exchange
from aridcal.engine.search.evidence import NO_SCORE, Solution
from aridcal.engine.search.linear_model import ActiveEffect
from aridcal.engine.search.sets import Choices, evidence_of_set
from aridcal.engine.search.state import State, solve_state
from aridcal.system.progress import SILENT

JOINTS = tuple(f"joint_{k}" for k in range(1, 7))


def curve(joint: str, order: float) -> Effect:
    waves = tuple(Coefficient(joint, "axis", Basis(form, (joint,), (order,))) for form in ("sin", "cos"))
    return Effect("joint_harmonic", joint, waves, order=(order,))


def yielding(joint: str) -> Effect:
    return Effect(
        "joint_compliance", joint, (Coefficient(joint, "axis", Basis("linear", (f"{joint}.gravity_torque",))),)
    )


LIBRARY = [curve(joint, order) for joint in JOINTS for order in (1.0, 2.0, 3.0)] + [yielding(joint) for joint in JOINTS]


def taken(*effects: Effect) -> list[ActiveEffect]:
    return [ActiveEffect(effect, NO_SCORE, np.eye(len(effect.coefficients))) for effect in effects]


def test_the_cost_of_a_set_is_that_of_drawing_it_from_all_sets_of_its_kind():
    choices = Choices.of(LIBRARY)
    one = choices.cost(taken(yielding("joint_2")))
    assert one == pytest.approx(log(2) + log(comb(6, 1)) + log(7))
    mixed = choices.cost(taken(curve("joint_1", 1.0), curve("joint_2", 1.0), curve("joint_3", 2.0)))
    orders = factorial(3 + 3 - 1) / (
        factorial(2) * factorial(2) * factorial(1)
    )  # compositions of 3 in 3, and their orders
    assert mixed == pytest.approx(log(2) + log(comb(6, 3)) + log(7) + log(orders))
    every = [[yielding(j) for k, j in enumerate(JOINTS) if bits >> k & 1] for bits in range(1, 64)]
    total = sum(np.exp(-choices.cost(taken(*some))) for some in every)
    assert total == pytest.approx(
        0.5 * 6 / 7
    )  # of one family of two, as likely at each number of places, none of them apart


def test_alike_members_of_a_family_cost_less_than_different_ones():
    choices = Choices.of(LIBRARY)
    alike = choices.cost(taken(*(curve(joint, 1.0) for joint in JOINTS[:4])))
    apart = choices.cost(taken(*(curve(j, order) for j, order in zip(JOINTS, (1.0, 2.0, 3.0, 1.0), strict=False))))
    assert alike < apart


def test_siblings_are_expected_where_two_of_a_family_are_found_and_not_before():
    choices = Choices.of(LIBRARY)
    two = taken(curve("joint_1", 1.0), curve("joint_2", 2.0))
    assert choices.siblings(two[:1], curve("joint_3", 1.0)) == 0
    assert choices.siblings(two, curve("joint_3", 1.0)) == 4 * 3  # four joints, three orders
    assert choices.siblings(two, yielding("joint_3")) == 0
    assert choices.siblings(two, curve("joint_2", 1.0)) == 0  # one other joint alone


def at_noise(state: State, sigma: np.ndarray) -> State:
    """The set solved for a given noise."""
    equations, precision = state.equations, state.precision
    V = np.linalg.inv(equations.information(sigma) + precision)
    beta = V @ equations.pull(sigma)
    misfit = (
        equations.count @ np.log(sigma**2) + np.sum(equations.squares_left(beta) / sigma**2) + beta @ precision @ beta
    )
    return replace(state, solution=Solution(beta, sigma, float(-0.5 * misfit), V, state.solution.spent))


def test_the_evidence_of_a_set_is_the_density_of_its_rows():
    """Second road: normal rows with the covariance of noise, of loose constants and of each effect's own prior."""
    rng = np.random.default_rng(4)
    first, second = linear("j1", "axis", "humidity"), linear("j2", "axis", "j1")
    model = made_up(rng, 40)
    model = with_effect(with_effect(model, 0, 0.3 * model.table["humidity"]), 2, 0.2 * model.table["j1"])
    every, sigma, choices = np.ones(40, dtype=bool), np.array([0.9, 1.1]), Choices.of([first, second])
    evidence, density = [], []
    for some in ((), (first,), (first, second)):
        state = at_noise(solve_state(model, taken(*some), sigma, every, fixed=True), sigma)
        evidence.append(evidence_of_set(state, choices, every) + choices.cost(state.active) + PRICE * len(some))
        K = model.A.shape[2]
        covariance = np.diag(np.tile(np.repeat(sigma**2, 3), 40))
        A = model.A.reshape(-1, K)
        covariance += A @ np.linalg.inv(model.gauge) @ A.T
        for k, effect in enumerate(some):
            x = model.columns(effect).reshape(-1)
            covariance += np.outer(x, x) * (state.solution.beta[K + k] ** 2 + state.solution.inverse[K + k, K + k])
        density.append(multivariate_normal(cov=covariance).logpdf(model.r.ravel()))
    np.testing.assert_allclose(np.diff(evidence), np.diff(density), rtol=1e-6)


@pytest.mark.parametrize(
    ("curves", "more", "taken"), [(0, 0.1, True), (0, -0.1, False), (3, 2.9, False), (3, 3.1, True), (4, 2.9, False)]
)
def test_another_set_takes_the_place_with_odds_of_20_to_1_or_with_fewer_curves_and_as_much_evidence(
    curves: int, more: float, taken: bool, monkeypatch: pytest.MonkeyPatch
):
    """Sets of three curves and five others, and one that is grown from whole families: which of them stays?"""

    def a_set(count: int) -> SimpleNamespace:
        effects = [SimpleNamespace(smooth=k < count) for k in range(8)]
        return SimpleNamespace(active=[SimpleNamespace(effect=e, declared=False) for e in effects], used=None)

    mine, other = a_set(3), a_set(curves)
    monkeypatch.setattr(set_exchange, "_distant_sets", lambda *_: iter(()))
    monkeypatch.setattr(set_exchange, "_set_of_families", lambda *_: other)
    monkeypatch.setattr(set_exchange, "grow", lambda state, *_: (state, ()))
    monkeypatch.setattr(set_exchange, "tidy", lambda state, *_: state)
    monkeypatch.setattr(set_exchange, "evidence_of_set", lambda state, *_: more if state is other else 0.0)
    found = set_exchange.regrow_sets(mine, Choices.of([]), SILENT)  # type: ignore[arg-type]
    assert found is (other if taken else mine)


def test_an_arm_whose_gears_all_err_is_told_as_that(tmp_path: Path):
    rng = np.random.default_rng(5)
    truth = simulate(ur10(), 90, rng, noise=5e-5, kind="position")
    robot = truth.model.robot
    waves = tuple(c for joint in robot.names for c in _waves(joint, robot.readings[robot.names.index(joint)]))
    model = truth.model.with_coefficients((*truth.model.coefficients, *waves))
    phases = rng.uniform(0.0, 2.0 * np.pi, len(robot.names))
    values = np.column_stack([np.cos(phases), np.sin(phases)]).ravel() * 4e-4
    rows = table(truth)
    _, p = model.poses(np.concatenate([truth.theta, values]), model.rows(truth.readings))
    rows[["x", "y", "z"]] = p + 5e-5 * rng.standard_normal(p.shape)
    named = searched(write_campaign(tmp_path, truth, rows, diagnosis={"enabled": True})).named
    assert {kind for kind, _ in named} == {"joint_harmonic"}
    assert len(named) >= 5


def _waves(joint: str, reading: str) -> tuple[Coefficient, ...]:
    return tuple(Coefficient(joint, "axis", Basis(form, (reading,), (1.0,))) for form in ("sin", "cos"))
