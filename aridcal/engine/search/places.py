"""Scatter of places, by which rows of one place err alike: a rival of all effects, which must show beside it."""

from __future__ import annotations

from dataclasses import replace

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.labels import MOST_LABELS
from aridcal.engine.corrections.place_scatter import is_scatter, place_scatter
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups
from aridcal.engine.search.scoring import score_of
from aridcal.engine.search.state import State, activate, noise_with, without_effect

ROWS_A_PLACE = 1.5
"""On the average, from which what rows of a place have in common is told from what each has."""

PLACE_SCATTER_EVIDENCE = 20.0
"""[nat] from which places scatter: what effects still to come explain may look like it, and what is small decides nothing."""


def scatter_of(train: Dataset) -> tuple[Effect, ...]:
    """Effects by which rows of one place may err alike; none where rows do not lie in places, or refer to things."""
    if not train.direct:
        return ()
    place = held_back_groups(train)
    count = int(place.max(initial=-1)) + 1
    if count > MOST_LABELS or len(train) < ROWS_A_PLACE * count:
        return ()
    measured = {channel.name for channel in train.channels}
    return place_scatter(place, "position" in measured, "rotation" in measured)


def has_scatter(state: State) -> bool:
    """True if the scatter of places is in a model."""
    return any(is_scatter(a.effect) for a in state.active)


def without_scatter(state: State) -> State:
    """The model without the scatter of places."""
    rest = [a for a in state.active if not is_scatter(a.effect)]
    return state if len(rest) == len(state.active) else state.with_active(rest)


def with_scatter(state: State, scatter: tuple[Effect, ...]) -> State:
    """The model with the scatter of places, its size estimated anew beside all effects; without it where it is not clear.

    Args:
        state: The model as it is.
        scatter: Effects that may be in it; see :func:`scatter_of`.
    """
    for effect in scatter:
        if any(a.effect == effect for a in state.active):
            state = without_effect(state, effect)
        score = score_of(state, effect)
        if score.gain >= PLACE_SCATTER_EVIDENCE:
            scattering = replace(activate(state, effect, score), declared=True)  # a nuisance: no gate judges it
            state = state.with_active((*state.active, scattering), noise_with(state, score))
    return state
