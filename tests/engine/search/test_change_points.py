"""Steps between two rows: found where they are, by a second road too, and told from whatever takes many rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aridcal.engine.corrections.basis import Basis, evaluate
from aridcal.engine.corrections.effect import ROW_ORDER, Coefficient, Effect
from aridcal.engine.fit.flags import OUTLIER
from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.levels import DOUBT
from aridcal.engine.search.change_points import (
    COARSE_STEPS,
    FEWEST_ROWS_OF_A_SIDE,
    WANDER_LENGTHS,
    WANDER_VARIANCES,
    _likelihoods,
    best_steps,
    step_points,
    walk_instead,
)
from aridcal.engine.search.evidence import NO_SCORE
from aridcal.engine.search.linear_model import LinearModel
from aridcal.engine.search.scoring import judge, score_of
from aridcal.engine.search.screening import score_all
from aridcal.engine.search.sets import Choices
from aridcal.engine.search.state import State, activate, solve_state

SLOTS = (("world_base", "x"), ("world_base", "y"), ("world_base", "roll"), ("j1", "axis"), ("tip_target", "z"))


def made_up(seed: int, n: int = 300) -> LinearModel:
    """A made-up linear model with white noise; the rows are in no order of anything but their own."""
    rng = np.random.default_rng(seed)
    return LinearModel(
        channels=(TARGET_POSITION, TARGET_ROTATION),
        A=rng.standard_normal((n, 6, 5)),
        gauge=1e-6 * np.eye(5),
        G=rng.standard_normal((n, 6, len(SLOTS))) / np.sqrt(6.0),
        slots=SLOTS,
        phi=np.zeros((n, 0)),
        bases=(),
        r=rng.standard_normal((n, 6)),
        limit=np.full(n, OUTLIER),
        configuration=np.arange(n),
        thing=None,
        off=None,
        present=np.ones((n, 2), dtype=bool),
        taken_up=np.zeros(2),
        share=1.0,
        run=np.arange(n) * 24 // n,
        fold=rng.integers(0, 5, n),
        joints=("j1",),
        table={"j1": rng.uniform(-2, 2, n), ROW_ORDER: np.arange(n) + 2.0, "time": 7.0 * rng.permutation(n)},
    )


def with_motion(model: LinearModel, slot: int, values: np.ndarray) -> LinearModel:
    return replace(model, r=model.r + model.G[:, :, slot] * values[:, None])


def solved(model: LinearModel) -> State:
    return solve_state(model, (), np.ones(2), np.ones(len(model.r), dtype=bool))


def template(where: str, of: str = ROW_ORDER) -> Effect:
    step = Basis("step", (of,), (10.5,))
    return Effect("shift", where, tuple(Coefficient(w, c, step) for w, c in SLOTS if w == where))


def chance_of_a_walk(model: LinearModel, where: str) -> float:
    state = solved(model)
    (effect,) = best_steps(model, state, [template(where)])
    return walk_instead(model, state, activate(state, effect, NO_SCORE))


@pytest.mark.parametrize("of", [ROW_ORDER, "time"])
@pytest.mark.parametrize("n", [90, 2 * COARSE_STEPS + 150])
def test_the_scan_finds_what_scoring_every_step_one_by_one_finds(of: str, n: int) -> None:
    model = made_up(1, n)
    late = np.argsort(np.argsort(model.table[of])) >= n // 3
    model = with_motion(model, 1, 2.0 * (late - 1.0))
    state = solved(model)
    (found,) = best_steps(model, state, [template("world_base", of)])
    _, points = step_points(model.table[of][state.used])
    every = [template("world_base", of).placed(float(point)) for point in points]
    gains = [score.gain for score in score_all(model, every, state)]
    assert found == every[int(np.argmax(gains))]
    assert np.mean((model.table[of] >= found.coefficients[0].basis.numbers[0]) == late) > 0.98


def test_steps_leave_rows_on_either_side_and_never_part_rows_of_one_value() -> None:
    before, points = step_points(np.array([3.0, 1.0, 2.0] * 10))
    np.testing.assert_array_equal(before, [10, 20])
    np.testing.assert_array_equal(points, [1.5, 2.5])
    before, _ = step_points(np.arange(20.0))
    assert (before.min(), before.max()) == (FEWEST_ROWS_OF_A_SIDE, 20 - FEWEST_ROWS_OF_A_SIDE)
    assert len(step_points(np.arange(2.0 * FEWEST_ROWS_OF_A_SIDE - 1))[0]) == 0
    assert (
        best_steps(
            made_up(0, 2 * FEWEST_ROWS_OF_A_SIDE - 1),
            solved(made_up(0, 2 * FEWEST_ROWS_OF_A_SIDE - 1)),
            [template("j1")],
        )
        == []
    )


def test_a_step_passes_every_gate_at_its_row_and_noise_none() -> None:
    late = np.arange(300) >= 40
    model = with_motion(made_up(2), 3, 2.0 * (late - 1.0))
    state = solved(model)
    (effect,) = best_steps(model, state, [template("j1")])
    judgement = judge(state, effect, score_of(state, effect), Choices.of([], 100))
    assert judgement.why == ""
    assert effect.coefficients[0].basis.numbers[0] == pytest.approx(41.5, abs=2.0)
    for seed in range(20):
        model = made_up(100 + seed)
        state = solved(model)
        for effect in best_steps(model, state, [template("j1"), template("world_base")]):
            found = score_of(state, effect)
            assert "not significant" in judge(state, effect, found, Choices.of([], 100)).why


def test_the_best_of_all_rows_pays_for_all_of_them() -> None:
    """A step that one given row would let pass is not let pass when all rows at all places were looked through."""
    model = made_up(3)
    state = solved(model)
    (effect,) = best_steps(model, state, [template("j1")])
    found = score_of(state, effect)
    assert judge(state, effect, found, Choices.of([], 1)).p_value == pytest.approx(
        min(1.0, found.p_value * (1 + 300 * 3))
    )


def test_the_filter_s_likelihood_is_that_of_the_whole_covariance() -> None:
    """The same Gaussian written out as one matrix for each wander and length, and the best taken."""
    rng = np.random.default_rng(5)
    n = 40
    variance = rng.uniform(0.5, 2.0, n)
    step = np.where(np.arange(n) < 17, -1.0, 0.0)
    y = 0.3 * np.cumsum(rng.standard_normal(n)) + np.sqrt(variance) * rng.standard_normal(n) + 2.0 * step
    white = float(np.median(variance))
    best = [-np.inf, -np.inf]
    t = np.arange(n)
    for length in WANDER_LENGTHS:
        for wander in WANDER_VARIANCES:
            walk = np.minimum(t[:, None], t)
            K = walk if np.isinf(length) else np.exp(-np.abs(t[:, None] - t) / length)
            C = np.diag(variance) + white * wander * K
            for k, X in enumerate((np.ones((n, 1)), np.stack([np.ones(n), step], axis=1))):
                W = np.linalg.inv(C)
                e = y - X @ np.linalg.solve(X.T @ W @ X, X.T @ W @ y)
                scale = float(e @ W @ e) / n
                full = multivariate_normal(np.zeros(n), scale * C).logpdf(e)
                best[k] = max(best[k], float(full) + 0.5 * n * (1.0 + np.log(2.0 * np.pi / n)))
    found = _likelihoods(np.stack([y, np.ones(n), step], axis=1), variance)
    np.testing.assert_allclose(found, best, atol=1e-8)


@pytest.mark.parametrize("at", [20, 150, 280])
def test_a_step_is_told_from_a_walk(at: int) -> None:
    for seed in range(5):
        model = with_motion(made_up(seed), 0, -3.0 * (np.arange(300) < at))
        assert chance_of_a_walk(model, "world_base") < 1e-4


@pytest.mark.parametrize("shape", ["walk", "ramp", "wave", "alike"])
def test_whatever_takes_many_rows_is_no_step(shape: str) -> None:
    """Each large enough that the best step explains a lot of it: the gate of chance alone would let it pass."""
    for seed in range(8):
        rng = np.random.default_rng([seed, 9])
        t = np.arange(300)
        alike = np.zeros(300)
        for k in range(1, 300):
            alike[k] = 0.95 * alike[k - 1] + 0.4 * rng.standard_normal()
        values = {
            "walk": np.cumsum(rng.standard_normal(300)) * 0.3,
            "ramp": 4.0 * t / 300,
            "wave": 1.5 * np.sin(t / 40),
            "alike": alike,
        }[shape]
        model = with_motion(made_up(seed), 3, values)
        assert chance_of_a_walk(model, "j1") > DOUBT


def test_two_steps_at_one_place_do_not_hide_each_other() -> None:
    t = np.arange(300)
    model = with_motion(made_up(6), 3, -3.0 * (t < 90) - 3.0 * (t < 200))
    assert chance_of_a_walk(model, "j1") < DOUBT


def test_a_step_is_minus_one_before_and_nothing_from_there_on_or_where_nobody_says_when() -> None:
    step = Basis("step", ("time",), (5.0,))
    time = np.array([4.9, 5.0, 6.0, np.nan, np.inf])
    np.testing.assert_array_equal(evaluate(step, {"time": time}), [-1, 0, 0, 0, 0])
    np.testing.assert_array_equal(evaluate(step, {"j1": time}), np.zeros(5))
