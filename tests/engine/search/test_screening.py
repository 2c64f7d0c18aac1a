"""Sums that a search keeps, and scores without each effect, by a second road: columns multiplied, models solved anew."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from weakref import ref

import numpy as np
import pytest
from linear_models import SLOTS, linear, made_up, with_effect
from scipy.stats import rankdata, wilcoxon

from aridcal.engine.corrections.basis import Basis, evaluate
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import turns
from aridcal.engine.fit.normal_equations import conditional
from aridcal.engine.search import products, state
from aridcal.engine.search.evidence import Score, solve
from aridcal.engine.search.grids import Grid, grid_of, local, moving_slots
from aridcal.engine.search.linear_model import ActiveEffect
from aridcal.engine.search.scoring import refine, signed_ranks
from aridcal.engine.search.screening import score_all, score_without
from aridcal.engine.search.state import State, activate, by_fold, solve_state, without_effect

KNOTS = tuple(Coefficient("j1", "axis", Basis("bump", ("j1",), (c, 0.5))) for c in np.arange(-3.0, 3.1, 0.5))
CURVE = Effect("joint_map", "j1", KNOTS, smooth=True)
WAVE = Effect("joint_harmonic", "j1", turns("j1", "axis", "j1", 2.0), (2.0,))
WARM = linear("j2", "axis", "humidity")


def solved(prepared: bool = True) -> State:
    """A curve, a wave and a warmth, some rows not in use."""
    rng = np.random.default_rng(3)
    b = made_up(rng)
    b = b.prepare([CURVE, WAVE, WARM]) if prepared else b
    b = with_effect(b, 0, 2.0 * np.sin(2.0 * b.table["j1"]) + b.table["j1"] ** 2)
    used = np.ones(len(b.r), dtype=bool)
    used[rng.choice(len(used), 9, replace=False)] = False
    start = solve_state(b, (), np.ones(2), used, fixed=True)
    active = [activate(start, CURVE, Score(1.0, 0.0, 3, tau=0.5)), activate(start, WAVE, Score(1.0, 0.0, 2))]
    return solve_state(b, active, np.ones(2), used, fixed=True)


def columns_of(made: State, *more: ActiveEffect) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns and residual in sigmas of the rows in use, and the fold of each number."""
    b, used = made.model, made.used
    X = np.concatenate([b.A, *(a.columns(b) for a in (*made.active, *more))], axis=2)[used]
    X, r = X / made.sigma[:, None], b.r[used] / made.sigma
    return X.reshape(-1, X.shape[2]), r.ravel(), np.repeat(b.fold[used], X.shape[1])


def test_equations_of_a_state_are_those_of_its_columns():
    made = solved()
    X, r, _ = columns_of(made)
    sigma = made.solution.sigma
    np.testing.assert_allclose(made.equations.information(sigma), X.T @ X, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(made.equations.pull(sigma), X.T @ r, rtol=1e-9, atol=1e-8)


def test_equations_put_together_from_those_of_the_set_before_are_those_of_the_columns():
    """Whatever came, went, changed places or was shaped anew."""
    made = solved()
    curve, wave = made.active
    other = activate(made, CURVE, Score(1.0, 0.0, 3, tau=0.01))
    warm = activate(made, WARM, Score(1.0, 0.0, 1))
    assert other.modes.shape != curve.modes.shape
    for active in (
        [wave, curve],
        [curve, wave, warm],
        [wave, warm],
        [warm, other, wave],
        [],
        [curve],
        [wave, curve, warm],
    ):
        again = solve_state(made.model, active, np.ones(2), made.used, fixed=True)
        X, r, _ = columns_of(again)
        sigma = again.solution.sigma
        np.testing.assert_allclose(again.equations.information(sigma), X.T @ X, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(again.equations.pull(sigma), X.T @ r, rtol=1e-9, atol=1e-8)


def test_sums_of_each_fold_are_those_of_its_columns():
    made = solved()
    candidate = activate(made, WARM, Score(1.0, 0.0, 1))
    H, g = by_fold(made, candidate, made.solution.sigma)
    X, r, fold = columns_of(made, candidate)
    for k, number in enumerate(np.unique(made.model.fold)):
        own = fold == number
        np.testing.assert_allclose(H[k], X[own].T @ X[own], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(g[k], X[own].T @ r[own], rtol=1e-9, atol=1e-8)


def test_what_was_found_of_a_state_is_not_found_again_and_is_no_other_states():
    made, other = solved(), solved()
    first = score_all(made.model, [WARM], made)
    again = score_all(made.model, [linear("j1", "axis", "humidity"), WARM], made)
    assert again[1] is first[0]
    assert score_all(other.model, [WARM], other)[0] is not first[0]
    assert again[0].gain == pytest.approx(score_all(other.model, [linear("j1", "axis", "humidity")], other)[0].gain)
    fine = refine(made, WARM, first[0])
    assert refine(made, WARM, first[0]) is fine
    assert refine(made, WARM, replace(first[0], gain=0.0)) is not fine  # of another rough score
    assert score_all(made.model, [WARM], replace(made, used=~made.used))[0] is not first[0]


def test_answers_about_a_state_go_with_it_and_leave_it_as_it_was():
    made = solved()
    again = replace(made)
    before = dict(vars(again))
    fine = refine(again, WARM, score_all(again.model, [WARM], again)[0])
    assert fine in made.model.answers.of(again).values() and not made.model.answers.of(made)
    assert {name: value for name, value in vars(again).items() if name in before} == before
    gone = ref(again)
    del again
    assert gone() is None


@pytest.mark.parametrize("prepared", [True, False])
@pytest.mark.parametrize("gone", [CURVE, WAVE])
def test_scores_without_an_effect_are_those_of_the_model_solved_without_it(gone, prepared):
    made = solved(prepared)
    rest = [a for a in made.active if a.effect != gone]
    other = solve_state(made.model, rest, np.ones(2), made.used, fixed=True)
    sigma = made.solution.sigma
    information = other.equations.information(sigma) + other.precision
    V = np.linalg.inv(information)
    solution = replace(other.solution, beta=V @ other.equations.pull(sigma), sigma=sigma, inverse=V)
    slowly = score_all(made.model, [WARM, gone], replace(other, solution=solution))
    fast = score_without(made.model, [WARM, gone, WAVE, CURVE], made, [gone])
    assert list(fast) == [gone]
    assert set(fast[gone]) == {WARM, gone}  # the other one is in the model, and no candidate
    for one, effect in zip(slowly, [WARM, gone], strict=True):
        assert fast[gone][effect].gain == pytest.approx(one.gain, rel=1e-5, abs=1e-4)
        assert fast[gone][effect].freedom == one.freedom
    assert not score_without(made.model, [WARM], made, [])


def test_unknowns_that_become_zero_leave_the_solution_of_the_others():
    made = solved()
    H, g = made.equations.information(np.ones(2)) + made.precision, made.equations.pull(np.ones(2))
    gone = np.zeros(len(g), dtype=bool)
    gone[made.places[1]] = True
    found = conditional(np.linalg.inv(H), np.linalg.solve(H, g), gone)
    np.testing.assert_allclose(found[~gone], np.linalg.solve(H[~gone][:, ~gone], g[~gone]), rtol=1e-6, atol=1e-9)
    assert not found[gone].any()


def test_noise_and_coefficients_agree_when_they_are_found():
    made = solved()
    found = solve(made.equations, made.precision, np.array([30.0, 0.01]))
    left = made.equations.squares_left(found.beta) / (made.equations.count - found.spent)
    np.testing.assert_allclose(np.sqrt(left), found.sigma, rtol=3e-3)
    H = made.equations.information(found.sigma) + made.precision
    np.testing.assert_allclose(found.inverse @ H, np.eye(len(H)), atol=1e-6)


def curves(of: str) -> list[Effect]:
    """Smooth functions of a column at every slot."""
    centres = np.arange(-3.0, 3.1, 0.4)
    return [
        Effect(
            "unknown",
            where,
            tuple(Coefficient(where, what, Basis("bump", (of,), (c, 0.4))) for c in centres),
            smooth=True,
        )
        for where, what in SLOTS
    ]


def in_two_places(of: str) -> Effect:
    """A smooth function that acts at two slots: a grid has no such columns, but its model may have."""
    bases = [Basis("bump", (of,), (c, 0.5)) for c in np.arange(-3.0, 3.1, 0.5)]
    return Effect("unknown", "j1", tuple(Coefficient(*slot, b) for slot in SLOTS[:2] for b in bases), smooth=True)


def test_a_grid_gives_what_its_columns_give(monkeypatch):
    """Against a curve, a wave, constants, curves of the grid itself and one of two slots, some rows not in use."""
    candidates = [*curves("j1"), *curves("humidity"), WARM]
    more = [candidates[1], candidates[6], in_two_places("j2")]
    states = []
    for least in (4, 10**9):  # as grids, and column by column
        monkeypatch.setattr(products, "LEAST_GRID_CANDIDATES", least)
        made = solved()
        b = made.model.prepare([*candidates, *more])
        taken = [activate(made, effect, Score(1.0, 0.0, 3, tau=0.3)) for effect in more]
        full = solve_state(b, [*made.active, *taken], np.ones(2), made.used, fixed=True)
        chunks = list(b.products.chunks(candidates))
        assert sum(chunk.grid is not None for chunk in chunks) == (2 if least == 4 else 0)
        sums = {}
        for effect in candidates:
            chunk, own = b.products.chunk_of(effect)
            sums[effect] = full.in_use(chunk, own)
        states.append((score_all(b, candidates, full), sums, score_without(b, candidates, full, more)))
    (grid, fast, without), (plain, slow, slowly) = states
    for effect, one, other in zip(candidates, grid, plain, strict=True):
        assert one.gain == pytest.approx(other.gain, rel=1e-7, abs=1e-7)
        for a, b in zip(fast[effect], slow[effect], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-9)
    for gone in more:
        assert set(without[gone]) == set(slowly[gone])
        for effect, score in without[gone].items():
            assert score.gain == pytest.approx(slowly[gone][effect].gain, rel=1e-6, abs=1e-6)


def first_of(whole: Grid) -> Grid:
    """The first slot of a grid."""
    return replace(whole, slots=tuple(g[:, :, :1] for g in whole.slots))


def test_a_grid_of_slots_that_move_in_some_rows_alone_gives_what_its_columns_give():
    """As limbs have them, which are on the paths of some rows: against columns made in full, and stretch by stretch."""
    rng = np.random.default_rng(0)
    n, sizes = 60, (3, 2)
    knots = [Basis("bump", ("j1",), (c, 0.25)) for c in np.arange(-3.0, 3.1, 0.25)]
    angle = rng.uniform(-2.5, 2.5, n)
    values = np.column_stack([evaluate(b, {"j1": angle}) for b in knots])
    functions = local(values)
    assert functions is not None

    def made(there: np.ndarray, count: int):
        slots = tuple(rng.normal(size=(n, size, count)) * there[:, None, None] for size in sizes)
        full = [np.einsum("nse,nd->nsed", g, values).reshape(n * g.shape[1], -1) for g in slots]
        return grid_of(*moving_slots(slots), functions), full

    first, one = made(np.arange(n) % 3 == 0, 4)
    second, two = made(np.arange(n) % 2 == 0, 1)
    assert len(first.rows) == 20 and len(second.rows) == 30
    others = [rng.normal(size=(n * size, 5)) for size in sizes]
    right = [y[:, 0] for y in others]
    np.testing.assert_allclose(first.across(others), [x.T @ y for x, y in zip(one, others, strict=True)], atol=1e-12)
    np.testing.assert_allclose(first.across_grid(second), [x.T @ y for x, y in zip(one, two, strict=True)], atol=1e-12)
    np.testing.assert_allclose(first.pull(right), [x.T @ r for x, r in zip(one, right, strict=True)], atol=1e-12)
    for x, own in zip(one, first.gram(), strict=True):
        d = values.shape[1]
        blocks = (x.T @ x).reshape(4, d, 4, d)
        np.testing.assert_allclose(own, blocks[np.arange(4), :, np.arange(4)], atol=1e-12)
    for k, apart in (made(np.arange(n) % 3 == 1, 2), made(np.zeros(n, dtype=bool), 1)):
        assert k.rows is not None and not np.intersect1d(k.rows, first.rows).size
        np.testing.assert_allclose(
            k.across_grid(first_of(first)),
            [x.T @ y[:, : values.shape[1]] for x, y in zip(apart, one, strict=True)],
            atol=1e-12,
        )
        np.testing.assert_allclose(k.across(others), [x.T @ y for x, y in zip(apart, others, strict=True)], atol=1e-12)
        assert k.gram().shape[1] == k.slots[0].shape[2] and k.pull(right).shape[1] == apart[0].shape[1]
    parts = [first.part(a, b).across_grid(second.part(a, b)) for a, b in ((0, 17), (17, 40), (40, n))]
    np.testing.assert_allclose(np.sum(parts, axis=0), first.across_grid(second), atol=1e-12)


def test_functions_of_one_preparation_are_not_taken_for_those_of_another():
    """A search prepares one list after the other from the same model: their functions get the same numbers."""
    made = solved()
    by_list = []
    for of in ("j2", "humidity"):
        b = made.model.prepare(curves(of))
        by_list.append(score_all(b, curves(of), replace(made, model=b)))
    alone = solved()
    b = alone.model.prepare(curves("humidity"))
    for one, other in zip(by_list[1], score_all(b, curves("humidity"), replace(alone, model=b)), strict=True):
        assert one.gain == pytest.approx(other.gain, rel=1e-9, abs=1e-9)


def test_functions_that_are_not_zero_anywhere_are_not_local():
    rng = np.random.default_rng(0)
    values = np.where(rng.uniform(size=(50, 12)) < 0.2, rng.standard_normal((50, 12)), 0.0)
    values[:, 3:] = np.where(np.cumsum(values[:, 3:] != 0.0, axis=1) > 1, 0.0, values[:, 3:])
    values[7] = 0.0  # a row beyond all of them
    sparse = local(values)
    assert sparse is not None
    weights = rng.standard_normal((50, 3))
    np.testing.assert_allclose(sparse.sums(weights), values.T @ weights, atol=1e-12)
    both = np.einsum("ni,nj->nij", values, values).reshape(50, -1)
    np.testing.assert_allclose(sparse.times(sparse).sums(weights), both.T @ weights, atol=1e-12)
    assert local(np.ones((50, 12))) is None


@pytest.mark.parametrize("n", [51, 400])
@pytest.mark.parametrize("ties", [False, True])
def test_signed_ranks_have_the_chance_that_scipy_gives_them(n, ties):
    rng = np.random.default_rng(n)
    for shift in (-0.2, 0.0, 0.1, 0.4):
        values = rng.standard_normal(n) + shift
        values = np.round(values, 1) if ties else values  # zeros among them
        expected = wilcoxon(values, alternative="greater").pvalue
        assert signed_ranks(values) == pytest.approx(expected, rel=1e-9)
    assert signed_ranks(np.zeros(n)) == 0.5  # nothing differs


@pytest.mark.parametrize("n", [1, 7, 12, 50])
def test_signed_ranks_of_few_values_are_counted(n):
    rng = np.random.default_rng(n)
    for shift in (-0.4, 0.0, 0.3, 9.0):
        values = rng.standard_normal(n) + shift
        assert signed_ranks(values) == pytest.approx(wilcoxon(values, alternative="greater").pvalue, rel=1e-12)
    assert signed_ranks(np.zeros(n)) == 1.0  # nothing speaks against it


def test_ties_and_zeros_of_few_values_are_counted_too():
    values = np.array([1.0, -1.0, 2.0, 2.0, 0.0, 3.0, -2.0, 0.0, 4.0])
    left = values[values != 0.0]
    ranks = rankdata(np.abs(left))
    every = np.array(list(product((0.0, 1.0), repeat=len(left)))) @ ranks
    assert signed_ranks(values) == pytest.approx(np.mean(every >= ranks[left > 0.0].sum()), rel=1e-12)


@pytest.mark.parametrize("gone", [CURVE, WAVE])
def test_noise_without_an_effect_is_begun_where_one_solution_would_bring_it(gone, monkeypatch):
    made, begun = solved(), []
    monkeypatch.setattr(state, "solve", lambda e, p, sigma: begun.append(sigma) or solve(e, p, sigma))
    other = without_effect(made, gone)
    rest = [a for a in made.active if a.effect != gone]
    monkeypatch.undo()
    slowly = solve_state(made.model, rest, made.solution.sigma, made.used, fixed=True)
    assert [a.effect for a in other.active] == [a.effect for a in rest]
    np.testing.assert_array_equal(other.used, made.used)
    np.testing.assert_allclose(other.solution.sigma, slowly.solution.sigma, rtol=4e-3)
    H = slowly.equations.information(made.solution.sigma) + slowly.precision
    V = np.linalg.inv(H)
    left = slowly.equations.squares_left(V @ slowly.equations.pull(made.solution.sigma))
    spent = slowly.equations.spent(V, made.solution.sigma)
    np.testing.assert_allclose(begun[0], np.sqrt(left / (slowly.equations.count - spent)), rtol=1e-6)


def test_a_model_with_a_candidate_is_the_one_solved_from_any_noise():
    made = solved()
    candidate = activate(made, WARM, Score(1.0, 0.0, 1))
    sigma = refine(made, WARM, Score(1.0, 0.0, 1)).sigma
    both = [
        solve_state(made.model, (*made.active, candidate), start, made.used, True) for start in (sigma, 9.0 * sigma)
    ]
    assert abs(both[0].solution.likelihood - both[1].solution.likelihood) < 0.04  # see NOISE_KNOWN
    np.testing.assert_allclose(both[0].solution.sigma, both[1].solution.sigma, rtol=4e-3)
