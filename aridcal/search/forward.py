"""The best candidate added, one after the other, until no one passes the gates."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from aridcal.effects.effect import Effect
from aridcal.effects.regional_kind import is_field
from aridcal.search.evidence import Score
from aridcal.search.hints import hinted
from aridcal.search.ranking import rank, with_effect
from aridcal.search.scoring import ALPHA, Judgement, judge, refine
from aridcal.search.sets import Choices
from aridcal.search.state import State, solve_state
from aridcal.search.tidying import tidied
from aridcal.showing import Progress

JUDGED = 4
"""Candidates that are tried on rows held back, the best first, before a step gives up."""


def grown(
    state: State, choices: Choices, most: int, small: bool, progress: Progress
) -> tuple[State, tuple[Judgement, ...]]:
    """A model with the candidates that pass, up to so many effects; and those that were judged last and did not.

    Args:
        state: The model as it is.
        choices: The candidates.
        most: Effects of the model at the most.
        small: Whether all is tried again after each step.
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
            state = tidied(state, choices, 1, progress)
        if frozenset(state.effects) in sets:
            break  # what is added is taken out again: this goes round in circles
        sets.add(frozenset(state.effects))
    return state, tuple(rejected)


def _worth_judging(
    state: State, ranked: Sequence[tuple[Effect, Score]], choices: Choices
) -> Iterator[tuple[Effect, Score]]:
    """The best candidates, as long as chance does not explain them, and the best of families of which several are found."""
    for effect, found in ranked[:JUDGED]:
        yield effect, found
        if found.p_value * choices.count > ALPHA:
            break
    expected = [(e, s) for e, s in ranked if s.gain > 0.0 and choices.siblings(state.active, e)]
    for effect, found in expected[:JUDGED]:
        if found.p_value * choices.siblings(state.active, effect) < 1.0:
            yield effect, refine(state, effect, found)


def _with_rows_of_hints(state: State, kinds: Collection[str]) -> tuple[State, list[Effect]]:
    """The same effects solved with the flagged rows that a hint would explain: they are what it was seen by. And the hints."""
    used, hints = state.used.copy(), hinted(state, kinds)
    for effect in hints:
        if effect.smooth or is_field(effect):
            used |= np.any(state.model.columns(effect), axis=(1, 2))
    if np.array_equal(used, state.used):
        return state, hints
    state = solve_state(state.model, state.active, state.solution.sigma, used, fixed=True)
    return state, hinted(state, kinds)
