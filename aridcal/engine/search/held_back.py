"""Effects that held-back rows do not miss leave the model."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.regional_kind import is_local
from aridcal.engine.instruments.channels import columns
from aridcal.engine.levels import BLOCKS, SURELY
from aridcal.engine.search.linear_model import LinearModel
from aridcal.engine.search.scoring import held_back_squares
from aridcal.engine.search.state import State, solve_state


def missed(model: LinearModel, state: State) -> State:
    """The model without the effects that held-back rows do not miss; what the campaign states stays.

    The effects are taken out one at a time, the least missed first, and all others are solved anew. The model is linear
    about its own optimum, where effects that are nearly not missed change nothing to the second order.

    Args:
        model: Linearised at the exact fit.
        state: Solved with all effects.
    """
    asked = {a.effect for a in state.active if not a.stated}
    while asked:
        gains = _held_back_gains(model, state, asked)
        worst = min(gains, key=lambda effect: gains[effect])
        if gains[worst] > 0.0:
            break
        rest = [a for a in state.active if a.effect != worst]
        state = solve_state(model, rest, state.solution.sigma, state.used)
        # What is missed for sure is not asked again: the others stand in for what went, if anything.
        asked = {effect for effect, gain in gains.items() if gain < SURELY} - {worst}
    return state


def _judging(model: LinearModel, effect: Effect) -> list[int]:
    """Channels that judge an effect: all; of what is local, which has few rows to speak for it, those that it moves."""
    every = list(range(len(model.channels)))
    if not is_local(effect):
        return every
    moved = np.any(model.columns(effect), axis=(0, 2))
    return [k for k, part in enumerate(columns(model.channels)) if moved[part].any()]


def _held_back_gains(model: LinearModel, state: State, asked: Collection[Effect]) -> dict[Effect, float]:
    """By how many standard errors effects lower the squared error of held-back rows; negative where one is not missed."""
    number = np.random.default_rng(1).permutation(int(model.configuration.max()) + 1)
    configuration = model.configuration[state.used]
    block = number[configuration] % BLOCKS
    ends = len(model.gauge) + np.cumsum([0, *(a.modes.shape[1] for a in state.active)])
    everything = np.ones(len(state.precision), dtype=bool)
    without = {}
    for a, low, high in zip(state.active, ends[:-1], ends[1:], strict=True):
        if a.effect in asked:
            without[a.effect] = everything.copy()
            without[a.effect][low:high] = False
    kept = [everything, *without.values()]
    solved = state.equations, state.precision, state.solution.sigma
    whole, *squares = held_back_squares(state, state.design, *solved, block, kept)
    gains = {}
    for effect, left in zip(without, squares, strict=True):
        gain = left - whole
        each = np.bincount(configuration, gain.sum(axis=0))
        error = float(np.sqrt(np.sum(each**2)))
        total = float(each.sum()) / error if error > 0.0 else 0.0
        worse = float(gain.sum(axis=1)[_judging(model, effect)].min())
        gains[effect] = total if worse >= 0.0 or total > SURELY else min(total, worse)
    return gains
