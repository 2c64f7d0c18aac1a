"""Each effect of a model taken out in turn: dropped if it is not missed, exchanged if another one does better in its place."""

from __future__ import annotations

from aridcal.search.ranking import in_place_of, rank, with_effect, with_flags
from aridcal.search.scoring import judge
from aridcal.search.screening import score_without
from aridcal.search.sets import Choices
from aridcal.search.shapes import reshaped
from aridcal.search.state import State, activate, without_effect
from aridcal.showing import Progress

BETTER = 1.0
"""[nat] by which another candidate must do better to take an effect's place: without it, near twins change for ever."""
RIVALS = 6
"""Candidates that are compared with an effect, the best first: those whose noise is found apart."""


def tidied(state: State, choices: Choices, rounds: int, progress: Progress) -> State:
    """Take each effect out in turn: drop it if it is not missed, exchange it if another does better in its place.

    Curves that stay are shaped anew beside all else.
    """
    library = choices.library
    kinds = {e.kind for e in library}
    # Harmonics of an order of their own, and steps, are no part of the library, but are tried again like all else.
    also = [e for e in state.effects if e.kind in kinds]
    known = {*library, *also} - {a.effect for a in state.active if a.stated}
    lasting = list(dict.fromkeys(e for e in (*library, *also) if e.at is None or e in also))
    for _ in range(rounds):
        before = state.effects
        rough = score_without(state.model, lasting, state, known, progress)
        for k, effect in enumerate(before):
            if effect not in known or effect not in state.effects:
                continue
            without = without_effect(state, effect)
            rivals = in_place_of(state, library, effect)
            ranked = rank(without, rivals, {effect.kind}, also, progress, rough[effect])
            mine = next((s for e, s in ranked if e == effect), None)
            if mine is None:  # a map of the same joint, taken since, holds it
                state = without
                continue
            worth = {e: s.gain - choices.price(without.active, activate(without, e, s)) for e, s in ranked[:RIVALS]}
            best, its = max(ranked[:RIVALS], key=lambda pair: worth[pair[0]])
            own = mine.gain - choices.price(without.active, activate(without, effect, mine))
            if best == effect or worth[best] < own + BETTER:
                best, its = effect, mine
            keep = not judge(without, best, its, choices).why
            state = with_effect(without, best, its) if keep else with_flags(without)
            if not keep or best != effect:
                rough = score_without(state.model, lasting, state, known.intersection(before[k + 1 :]), progress)
        if state.effects == before:
            break
    return reshaped(state, lambda a: a.effect in known)
