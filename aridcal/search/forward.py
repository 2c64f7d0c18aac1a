"""The best candidate added, one after the other, until no one passes the gates."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from aridcal.effects.effect import Effect
from aridcal.effects.regional_kind import is_field
from aridcal.search.evidence import Score
from aridcal.search.hints import hinted
from aridcal.search.linear_model import LinearModel
from aridcal.search.ranking import rank, with_effect
from aridcal.search.scoring import ALPHA, Judgement, judge, refine
from aridcal.search.sets import Choices
from aridcal.search.state import State, solve_state
from aridcal.search.tidying import tidied
from aridcal.showing import Progress

JUDGED = 4
"""Candidates that are tried on rows held back, the best first, before a step gives up."""


def grown(
    model: LinearModel,
    library: Sequence[Effect],
    state: State,
    most: int,
    small: bool,
    choices: Choices,
    progress: Progress,
) -> tuple[State, tuple[Judgement, ...]]:
    """A model with the candidates that pass, up to so many effects; and those that were judged last and did not.

    Args:
        model: The linearised model.
        library: Candidates.
        state: The model as it is.
        most: Effects of the model at the most.
        small: Whether all is tried again after each step.
        choices: What is chosen among.
        progress: Told how many candidates are scored.
    """
    rejected: tuple[Judgement, ...] = ()
    seen = {frozenset(a.effect for a in state.active)}
    kinds = {e.kind for e in library}
    while len(state.active) < most:
        before = state
        state, hints = _with_rows_of_hints(model, state, kinds)
        ranked = rank(model, library, state, also=hints, progress=progress)
        judgements, chosen = [], None
        for effect, found in _worth_judging(model, state, ranked, choices):
            judgement = judge(model, state, effect, found, choices)
            if not judgement.why:
                chosen = with_effect(model, state, effect, found)
                break
            judgements.append(judgement)
        rejected = tuple(judgements)
        if chosen is None:
            state = before
            break
        state = chosen
        if small and len(state.active) > 1:
            state = tidied(model, library, state, 1, choices, progress)
        if frozenset(a.effect for a in state.active) in seen:
            break  # what is added is taken out again: this goes round in circles
        seen.add(frozenset(a.effect for a in state.active))
    return state, rejected


def _worth_judging(
    model: LinearModel, state: State, ranked: Sequence[tuple[Effect, Score]], choices: Choices
) -> Iterator[tuple[Effect, Score]]:
    """The best candidates, as long as chance does not explain them, and the best of families of which several are found."""
    for effect, found in ranked[:JUDGED]:
        yield effect, found
        if found.p_value * choices.count > ALPHA:
            break
    expected = [(e, s) for e, s in ranked if s.gain > 0.0 and choices.siblings(state.active, e)]
    for effect, found in expected[:JUDGED]:
        if found.p_value * choices.siblings(state.active, effect) < 1.0:
            yield effect, refine(model, state, effect, found)


def _with_rows_of_hints(model: LinearModel, state: State, kinds: Collection[str]) -> tuple[State, list[Effect]]:
    """The same effects solved with the flagged rows that a hint would explain: they are what it was seen by. And the hints."""
    used, hints = state.used.copy(), hinted(model, state, kinds)
    for effect in hints:
        if effect.smooth or is_field(effect):
            used |= np.any(model.columns(effect), axis=(1, 2))
    if np.array_equal(used, state.used):
        return state, hints
    state = solve_state(model, state.active, state.solution.sigma, used, True)
    return state, hinted(model, state, kinds)
