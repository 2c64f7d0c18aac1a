"""Single steps: the best candidate added; each effect tried again, dropped if not missed, exchanged if another does better."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.regional_kind import is_field
from aridcal.engine.search.candidates import hinted_candidates
from aridcal.engine.search.curves import reshaped
from aridcal.engine.search.evidence import Score
from aridcal.engine.search.ranking import REFINED_CANDIDATES, rank, substitutes, with_effect, with_flags
from aridcal.engine.search.scoring import ALPHA, Judgement, judge, refine
from aridcal.engine.search.screening import score_without
from aridcal.engine.search.sets import Choices
from aridcal.engine.search.state import State, activate, solve_state, without_effect
from aridcal.system.progress import Progress

JUDGED_CANDIDATES = 4
"""Work: Candidates that are tried on rows held back, the best first, before a step gives up."""

BETTER_EVIDENCE = 1.0
"""[nat] by which another candidate must do better to take an effect's place: without it, near twins change for ever."""


def grow(
    state: State, choices: Choices, most: int, small: bool, progress: Progress
) -> tuple[State, tuple[Judgement, ...]]:
    """A model grown by candidates that pass the tests, and the judgements of the last candidates that did not.

    Args:
        state: The model as it is.
        choices: The candidates.
        most: Effects of the model at the most.
        small: Whether all effects are tried again after each step.
        progress: Told how many candidates are scored.
    """
    rejected: list[Judgement] = []
    sets = {frozenset(state.effects)}
    kinds = {e.kind for e in choices.library}
    while len(state.active) < most:
        with_rows, hints = _with_rows_of_hints(state, kinds)
        ranked = rank(with_rows, choices.library, also=hints, progress=progress)
        rejected = []
        for effect, score in _worth_judging(with_rows, ranked, choices):
            judgement = judge(with_rows, effect, score, choices)
            if not judgement.why:
                break
            rejected.append(judgement)
        else:
            break
        state = with_effect(with_rows, effect, score)
        if small and len(state.active) > 1:
            state = tidy(state, choices, 1, progress)
        if frozenset(state.effects) in sets:
            break  # effects are added and taken out again in circles
        sets.add(frozenset(state.effects))
    return state, tuple(rejected)


def _worth_judging(
    state: State, ranked: Sequence[tuple[Effect, Score]], choices: Choices
) -> Iterator[tuple[Effect, Score]]:
    """The best candidates, as long as chance does not explain them, and the best of families with several members in it."""
    for effect, score in ranked[:JUDGED_CANDIDATES]:
        yield effect, score
        if score.p_value * choices.count > ALPHA:
            break
    expected = [(e, s) for e, s in ranked if s.gain > 0.0 and choices.siblings(state.active, e)]
    for effect, score in expected[:JUDGED_CANDIDATES]:
        if score.p_value * choices.siblings(state.active, effect) < 1.0:
            yield effect, refine(state, effect, score)


def _with_rows_of_hints(state: State, kinds: Collection[str]) -> tuple[State, list[Effect]]:
    """The model solved with the flagged rows that a hint would explain, which are its evidence; and the hints."""
    in_use, hints = state.used.copy(), hinted_candidates(state, kinds)
    for effect in hints:
        if effect.smooth or is_field(effect):
            in_use |= np.any(state.model.columns(effect), axis=(1, 2))
    if np.array_equal(in_use, state.used):
        return state, hints
    state = solve_state(state.model, state.active, state.solution.sigma, in_use, fixed=True)
    return state, hinted_candidates(state, kinds)


def tidy(state: State, choices: Choices, rounds: int, progress: Progress) -> State:
    """The model with each effect taken out in turn: dropped if it fails the tests, exchanged if another does better.

    Curves that stay are shaped anew beside all other effects.
    """
    library = choices.library
    kinds = {e.kind for e in library}
    # Harmonics of an order of their own, and steps, are no part of the library, but are tried again like the others.
    also = [e for e in state.effects if e.kind in kinds]
    removable = {*library, *also} - {a.effect for a in state.active if a.declared}
    lasting = list(dict.fromkeys(e for e in (*library, *also) if e.at is None or e in also))
    for _ in range(rounds):
        before = state.effects
        rough = score_without(state.model, lasting, state, removable, progress)
        for k, effect in enumerate(before):
            if effect not in removable or effect not in state.effects:
                continue
            without = without_effect(state, effect)
            rivals = substitutes(state, library, effect)
            ranked = rank(without, rivals, {effect.kind}, also, progress, rough[effect])
            score = next((s for e, s in ranked if e == effect), None)
            if score is None:  # a map of the same joint, added since, covers it
                state = without
                continue
            worth = {
                e: s.gain - choices.price(without.active, activate(without, e, s))
                for e, s in ranked[:REFINED_CANDIDATES]
            }
            best, best_score = max(ranked[:REFINED_CANDIDATES], key=lambda pair: worth[pair[0]])
            worth_of_effect = score.gain - choices.price(without.active, activate(without, effect, score))
            if best == effect or worth[best] < worth_of_effect + BETTER_EVIDENCE:
                best, best_score = effect, score
            keep = not judge(without, best, best_score, choices).why
            state = with_effect(without, best, best_score) if keep else with_flags(without)
            if not keep or best != effect:
                rough = score_without(state.model, lasting, state, removable.intersection(before[k + 1 :]), progress)
        if state.effects == before:
            break
    return reshaped(state, lambda a: a.effect in removable)
