"""Rows of one place that err alike are a rival of all effects: what is found must show beside that."""

from __future__ import annotations

from dataclasses import replace

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.labels import MOST_LABELS
from aridcal.engine.corrections.place_scatter import is_scatter, place_scatter
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_together
from aridcal.engine.search.scoring import score_of
from aridcal.engine.search.state import State, activate, noise_with, without_effect

ROWS_A_PLACE = 1.5
"""On the average, from which what rows of a place have in common is told from what each has."""

CLEARLY = 20.0
"""[nat] from which places scatter: what effects still to come explain may look like it, and what is small decides nothing."""


def scatter_of(train: Dataset) -> tuple[Effect, ...]:
    """What rows of one place may err by alike; nothing where rows do not lie in places, or see things."""
    if not train.direct:
        return ()
    place = held_together(train)
    count = int(place.max(initial=-1)) + 1
    if count > MOST_LABELS or len(train) < ROWS_A_PLACE * count:
        return ()
    measured = {channel.name for channel in train.channels}
    return place_scatter(place, "position" in measured, "rotation" in measured)


def has_scatter(state: State) -> bool:
    """True if places scatter in a model."""
    return any(is_scatter(a.effect) for a in state.active)


def without_scatter(state: State) -> State:
    """The model whose places do not scatter."""
    rest = [a for a in state.active if not is_scatter(a.effect)]
    return state if len(rest) == len(state.active) else state.with_active(rest)


def with_scatter(state: State, scatter: tuple[Effect, ...]) -> State:
    """The model with the scatter of places, its size found anew beside all effects; without what is not clear.

    Args:
        state: The model as it is.
        scatter: What may be in it; see :func:`scatter_of`.
    """
    for effect in scatter:
        if any(a.effect == effect for a in state.active):
            state = without_effect(state, effect)
        found = score_of(state, effect)
        if found.gain >= CLEARLY:
            kept = replace(activate(state, effect, found), stated=True)  # a nuisance: no gate judges it
            state = state.with_active((*state.active, kept), noise_with(state, found))
    return state
