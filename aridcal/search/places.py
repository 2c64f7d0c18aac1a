"""Rows of one place that err alike are a rival of all effects: what is found must show beside that."""

from __future__ import annotations

from dataclasses import replace

from aridcal.effects.effect import Effect
from aridcal.effects.place_scatter import is_scatter, place_scatter
from aridcal.inputs.dataset import Dataset
from aridcal.inputs.split import held_together
from aridcal.search.linear_model import LinearModel
from aridcal.search.scoring import refine
from aridcal.search.screening import score_all
from aridcal.search.state import State, activate, noise_with, solve_state, without_effect

MOST_PLACES = 100
"""Places at the most that have a deviation of their own: each costs three or six columns, and of more the mean over rows of one
place is what counts anyhow."""

SEVERAL = 1.5
"""Rows a place, on the average, from which what they have in common is told from what each has."""

CLEARLY = 20.0
"""[nat] from which places scatter: what effects still to come explain may look like it, and what is small decides nothing."""


def scatter_of(train: Dataset) -> tuple[Effect, ...]:
    """What rows of one place may err by alike; nothing where rows do not lie in places, or see things."""
    if not train.direct:
        return ()
    place = held_together(train)
    count = int(place.max(initial=-1)) + 1
    if count > MOST_PLACES or len(train) < SEVERAL * count:
        return ()
    measured = {channel.name for channel in train.channels}
    return place_scatter(place, "position" in measured, "rotation" in measured)


def has_scatter(state: State) -> bool:
    """True if places scatter in a model."""
    return any(is_scatter(a.effect) for a in state.active)


def without_scatter(model: LinearModel, state: State) -> State:
    """The model whose places do not scatter."""
    rest = [a for a in state.active if not is_scatter(a.effect)]
    return state if len(rest) == len(state.active) else solve_state(model, rest, state.solution.sigma, state.used)


def with_scatter(model: LinearModel, state: State, scatter: tuple[Effect, ...]) -> State:
    """The model with the scatter of places, its size found anew beside all effects; without what is not clear.

    Args:
        model: The linearised model.
        state: The model as it is.
        scatter: What may be in it; see :func:`scatter_of`.
    """
    for effect in scatter:
        if any(a.effect == effect for a in state.active):
            state = without_effect(model, state, effect)
        found = refine(model, state, effect, score_all(model, [effect], state)[0])
        if found.gain >= CLEARLY:
            kept = replace(activate(model, state, effect, found), stated=True)  # a nuisance: no gate judges it
            state = solve_state(model, (*state.active, kept), noise_with(state, found), state.used)
    return state
