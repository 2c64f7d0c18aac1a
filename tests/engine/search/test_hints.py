"""Looking through thousands of possibilities: what is planted stands out, and where nothing is nothing is taken."""

from __future__ import annotations

import numpy as np
import pytest
from heads import ARID
from linear_models import linear, made_up, with_effect
from scipy.stats import kstest

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import turns
from aridcal.engine.search.candidates import harmonics, pairs
from aridcal.engine.search.evidence import Score
from aridcal.engine.search.linear_model import LinearModel
from aridcal.engine.search.scoring import Judgement, judge, score_of
from aridcal.engine.search.sets import Choices
from aridcal.engine.search.state import FAINT_MODE_SHARE, activate, solve_state

UNIT = np.ones(2)


def state(b: LinearModel):  # type: ignore[no-untyped-def]
    return solve_state(b, (), UNIT, np.ones(len(b.r), dtype=bool))


def judged(b: LinearModel, effect: Effect, tested: int) -> Judgement:
    s = state(b)
    return judge(s, effect, score_of(s, effect), Choices.of([], tested))


@pytest.mark.parametrize("order", [3.0, 17.3, 53.68])
def test_a_harmonic_of_any_order_is_found_at_its_joint(order):
    b = made_up(np.random.default_rng(1))
    b = with_effect(b, 2, 0.6 * np.sin(order * b.table["j2"] + 0.3))
    found = harmonics(state(b))
    assert found[0].where == "j2"
    assert found[0].order[0] == pytest.approx(order, abs=0.1)


def test_a_function_of_two_covariates_is_found_where_it_acts():
    b = made_up(np.random.default_rng(2))
    b = with_effect(b, 1, 1.0 * b.table["j2"] * b.table["humidity"])
    places, looked = pairs(state(b), ["j1", "j2", "time", "humidity"], ARID)
    assert places[0] == ("j1", "x", ("j2", "humidity"))
    assert looked == 6 * 2  # pairs times motions that are not a joint's own


def test_a_column_that_means_nothing_is_rejected_and_one_that_does_is_accepted():
    rng = np.random.default_rng(3)
    b = with_effect(made_up(rng), 1, 0.5 * rng.standard_normal(300))  # real, but of nothing that was measured
    b = with_effect(b, 3, 0.3 * b.table["humidity"])
    assert not judged(b, linear("tip_target", "z", "humidity"), 300).why
    assert judged(b, linear("j1", "x", "time"), 300).why


def test_drifts_that_come_in_stretches_do_not_make_a_smooth_column_credible():
    rng = np.random.default_rng(4)
    b = made_up(rng)
    b = with_effect(b, 3, np.repeat(rng.standard_normal(12), 25))  # every other stretch of its own
    verdict = judged(b, linear("tip_target", "z", "time"), 1)
    assert verdict.p_value < 1e-6  # chance is not the reason
    assert verdict.why
    ramp = np.repeat(np.linspace(-1.5, 1.5, 12), 25)  # as large, and the column does tell it
    assert not judged(with_effect(made_up(np.random.default_rng(4)), 3, ramp), linear("tip_target", "z", "time"), 1).why


@pytest.mark.parametrize("effect", [linear("tip_target", "z", "time"), linear("j1", "x", "j2")])
def test_the_chance_of_a_candidate_that_means_nothing_is_uniform(effect):
    """So that of clean campaigns the share that shows one is the share of p-values that a verdict lets pass."""
    chances = [judged(made_up(np.random.default_rng(100 + seed), n=60), effect, 1).p_value for seed in range(300)]
    assert kstest(chances, "uniform").pvalue > 1e-3


def test_a_verdict_lets_pass_one_clean_campaign_in_a_thousand_at_the_most():
    """Effects of every size, alone or as one of 3000 candidates: what is accepted, chance does more seldom than that."""
    accepted, refused = [], []
    for k, size in enumerate(np.repeat(np.linspace(0.1, 0.8, 30), 4)):
        b = made_up(np.random.default_rng(500 + k), n=60)
        b = with_effect(b, 3, size * b.table["humidity"])
        effect = linear("tip_target", "z", "humidity")
        one, many = (judged(b, effect, tested) for tested in (1, 3000))
        assert many.p_value == pytest.approx(min(1.0, 3000 * one.p_value))
        for v in (one, many):
            (refused if v.why else accepted).append(v)
    assert max(v.p_value for v in accepted) < 1e-3
    assert min(v.p_value for v in refused) > 1e-8  # and what is clear is not refused
    assert len(accepted) > 20 and len(refused) > 20


def test_what_is_active_and_smooth_has_modes_of_unit_prior_and_the_rows_tell_nothing_of_what_they_lack():
    b = made_up(np.random.default_rng(5))
    knots = tuple(Coefficient("j1", "axis", Basis("bump", ("j1",), (c, 0.5))) for c in np.arange(-3.0, 3.1, 0.5))
    curve = Effect("joint_map", "j1", knots, smooth=True)
    made = state(b)
    active = activate(made, curve, Score(1.0, 0.0, 3, tau=0.2))
    np.testing.assert_array_equal(active.precision, np.eye(active.modes.shape[1]))
    lacking = np.linalg.inv(active.coefficient_precision) - active.modes @ active.modes.T
    moved = (b.columns(curve) / made.sigma[:, None]).reshape(-1, len(knots))
    squares = np.linalg.eigvalsh(moved @ lacking @ moved.T)
    assert squares.min() > -1e-6 and squares.max() < 1.01 * FAINT_MODE_SHARE
    plain = activate(made, Effect("joint_harmonic", "j1", turns("j1", "axis", "j1", 2.0), (2.0,)), Score(1.0, 0.0, 2))
    assert not plain.precision.any()
