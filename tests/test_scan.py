"""Looking through thousands of possibilities: what is planted stands out, and where nothing is nothing is taken."""

from __future__ import annotations

import numpy as np
import pytest

from aridcal.bench import Bench, activate, solve_state
from aridcal.catalogue import turns
from aridcal.effects import Basis, Coefficient, Effect
from aridcal.evidence import Score
from aridcal.residual import Sigma
from aridcal.scan import harmonics, pairs
from aridcal.scoring import ALPHA, judge, refine, score_all

SLOTS = (("j1", "axis"), ("j1", "x"), ("j2", "axis"), ("tip_target", "z"))
UNIT = Sigma(1.0, 1.0)


def bench(rng: np.random.Generator, n: int = 300, noise: np.ndarray | None = None) -> Bench:
    """A made-up linear model of two joints and two columns."""
    table = {name: rng.uniform(-2.0, 2.0, n) for name in ("j1", "j2", "time", "humidity")}
    table["time"] = np.sort(table["time"])
    r = rng.standard_normal((n, 6)) if noise is None else noise
    run = np.arange(n) * 24 // n
    return Bench(rng.standard_normal((n, 6, 4)), 1e-6 * np.eye(4), rng.standard_normal((n, 6, len(SLOTS))), SLOTS,
                 np.zeros((n, 0)), (), r, np.zeros(n, dtype=bool), run, rng.integers(0, 5, n), ("j1", "j2"), table)  # fmt: skip


def with_effect(b: Bench, slot: int, values: np.ndarray) -> Bench:
    r = b.r + b.G[:, :, slot] * values[:, None]
    return Bench(b.A, b.gauge, b.G, b.slots, b.phi, b.bases, r, b.suspect, b.run, b.fold, b.own, b.table)


def state(b: Bench):  # type: ignore[no-untyped-def]
    return solve_state(b, (), UNIT, np.ones(len(b.r)))


def linear(where: str, component: str, of: str) -> Effect:
    return Effect("thermal", where, (Coefficient(where, component, Basis("linear", (of,), (0.0,))),))


@pytest.mark.parametrize("order", [3.0, 17.3, 53.68])
def test_a_harmonic_of_any_order_is_found_at_its_joint(order):
    b = bench(np.random.default_rng(1))
    b = with_effect(b, 2, 0.6 * np.sin(order * b.table["j2"] + 0.3))
    found = harmonics(b, state(b))
    assert found[0].where == "j2"
    assert found[0].order[0] == pytest.approx(order, abs=0.1)


def test_a_function_of_two_covariates_is_found_where_it_acts():
    b = bench(np.random.default_rng(2))
    b = with_effect(b, 1, 1.0 * b.table["j2"] * b.table["humidity"])
    places, looked = pairs(b, state(b), ["j1", "j2", "time", "humidity"])
    assert places[0] == ("j1", "x", ("j2", "humidity"))
    assert looked == 6 * 2  # pairs times motions that are not a joint's own


def test_a_column_that_means_nothing_is_rejected_and_one_that_does_is_accepted():
    rng = np.random.default_rng(3)
    b = with_effect(bench(rng), 1, 0.5 * rng.standard_normal(300))  # real, but of nothing that was measured
    b = with_effect(b, 3, 0.3 * b.table["humidity"])
    s = state(b)
    for effect, good in ((linear("tip_target", "z", "humidity"), True), (linear("j1", "x", "time"), False)):
        found = refine(b, s, effect, score_all(b, [effect], s)[0])
        assert (judge(b, s, effect, found, 300).why == "") is good


def test_drifts_that_come_in_stretches_do_not_make_a_smooth_column_credible():
    rng = np.random.default_rng(4)
    b = bench(rng)
    b = with_effect(b, 3, np.repeat(rng.standard_normal(12), 25))  # every other stretch of its own
    s = state(b)
    effect = linear("tip_target", "z", "time")
    verdict = judge(b, s, effect, refine(b, s, effect, score_all(b, [effect], s)[0]), 1)
    assert verdict.why


def test_clean_rows_accept_one_candidate_in_thousands_at_the_most():
    accepted = tried = 0
    for seed in range(60):
        b = bench(np.random.default_rng(100 + seed), n=120)
        s = state(b)
        library = [linear("tip_target", "z", c) for c in ("time", "humidity", "j1")] + [linear("j1", "x", "j2")]
        for effect, found in zip(library, score_all(b, library, s), strict=True):
            tried += 1
            accepted += judge(b, s, effect, found, 1).why == ""
    assert accepted <= max(1, 4 * ALPHA * tried)


def test_what_is_active_and_smooth_has_modes_of_unit_prior():
    b = bench(np.random.default_rng(5))
    knots = tuple(Coefficient("j1", "axis", Basis("bump", ("j1",), (c, 0.5))) for c in np.arange(-3.0, 3.1, 0.5))
    curve = Effect("joint_map", "j1", knots, smooth=True)
    active = activate(b, state(b), curve, Score(1.0, 0.0, 3, tau=0.2))
    np.testing.assert_array_equal(active.precision, np.eye(active.modes.shape[1]))
    np.testing.assert_allclose(active.modes @ active.modes.T, np.linalg.inv(active.coefficient_precision), atol=1e-3)
    plain = activate(
        b, state(b), Effect("joint_harmonic", "j1", turns("j1", "axis", "j1", 2.0), (2.0,)), Score(1.0, 0.0, 2)
    )
    assert not plain.precision.any()
