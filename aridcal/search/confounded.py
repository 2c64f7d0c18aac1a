"""Candidates that would do about as well in the place of an effect that was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aridcal.effects.effect import Effect
from aridcal.effects.regional_kind import is_of_labels
from aridcal.search.evidence import Score
from aridcal.search.linear_model import Active
from aridcal.search.ranking import in_place_of, is_small, rank
from aridcal.search.screening import score_without
from aridcal.search.state import State, without_effect
from aridcal.search.tied import mirrored
from aridcal.showing import SILENT, Progress

CLOSE = 3.0
"""[nat] by which another candidate may be worse and still be confounded with the one named: odds of 20 to 1."""

RANKED = 12
"""Candidates among which those confounded with an effect are sought."""


def twins(
    state: State, library: Sequence[Effect], progress: Progress = SILENT
) -> tuple[tuple[tuple[Effect, Score], ...], ...]:
    """Each effect, and the candidates that would do about as well in its place; nothing where none are sought."""
    small = is_small(state.model, library)
    asked = [a.effect for a in state.active if small or not a.effect.smooth or is_of_labels(a.effect)]
    lasting = list(dict.fromkeys([*(e for e in library if e.at is None), *asked]))
    rough = score_without(state.model, lasting, state, asked, progress)
    return tuple(
        _twins(state, library, a, rough[a.effect], progress) if a.effect in rough else () for a in state.active
    )


def _twins(
    state: State,
    library: Sequence[Effect],
    mine: Active,
    rough: Mapping[Effect, Score],
    progress: Progress,
) -> tuple[tuple[Effect, Score], ...]:
    """One of the effects, and candidates that would do about as well in its place.

    Args:
        library: Candidates.
        state: The model with it.
        mine: The effect.
        rough: Scores of candidates without it.
        progress: Told how many are scored.
    """
    without = without_effect(state, mine.effect)
    rivals = in_place_of(state, library, mine.effect)
    also = [mine.effect, *mirrored(state.model.table, mine.effect)]
    ranked = rank(without, rivals, also=also, progress=progress, known=rough)
    own = next((s for e, s in ranked if e == mine.effect), None)
    if own is None:
        return ()
    name = (mine.effect.kind, mine.effect.where, mine.effect.with_, mine.effect.by)
    twins: dict[tuple[object, ...], tuple[Effect, Score]] = {}
    for effect, found in ranked[:RANKED]:
        other = (effect.kind, effect.where, effect.with_, effect.by)
        if found.gain > own.gain - CLOSE and other != name:
            twins.setdefault(other, (effect, found))
    return (mine.effect, own), *twins.values()
