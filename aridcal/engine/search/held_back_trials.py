"""Effects without which held-back rows are predicted as well leave the model."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.regional_kind import is_local
from aridcal.engine.instruments.channels import columns
from aridcal.engine.levels import JUDGING_FOLDS, SURELY
from aridcal.engine.search.linear_model import LinearModel
from aridcal.engine.search.scoring import held_back_squares
from aridcal.engine.search.state import State, solve_state


def needed_effects(model: LinearModel, state: State) -> State:
    """The model without effects that do not improve held-back rows; declared effects stay.

    Effects are taken out one at a time, that of the least gain first, and all others are solved anew. The model is linear
    about its own optimum, where effects of little gain change nothing to the second order.

    Args:
        model: Linearised at the exact fit.
        state: Solved with all effects.
    """
    candidates = {a.effect for a in state.active if not a.declared}
    while candidates:
        gains = _held_back_gains(model, state, candidates)
        worst = min(gains, key=lambda effect: gains[effect])
        if gains[worst] > 0.0:
            break
        rest = [a for a in state.active if a.effect != worst]
        state = solve_state(model, rest, state.solution.sigma, state.used)
        # Effects of a sure gain are not tried again: it grows, if anything, when another effect leaves.
        candidates = {effect for effect, gain in gains.items() if gain < SURELY} - {worst}
    return state


def _judging_channels(model: LinearModel, effect: Effect) -> list[int]:
    """Numbers of the channels that judge an effect: all; of a local one, which moves few rows, those that it moves."""
    every = list(range(len(model.channels)))
    if not is_local(effect):
        return every
    moved = np.any(model.columns(effect), axis=(0, 2))
    return [k for k, part in enumerate(columns(model.channels)) if moved[part].any()]


def _held_back_gains(model: LinearModel, state: State, effects: Collection[Effect]) -> dict[Effect, float]:
    """Gain of effects: how much they lower the squared error of held-back rows, in standard errors."""
    number = np.random.default_rng(1).permutation(int(model.configuration.max()) + 1)
    configuration = model.configuration[state.used]
    block = number[configuration] % JUDGING_FOLDS
    ends = len(model.gauge) + np.cumsum([0, *(a.modes.shape[1] for a in state.active)])
    everything = np.ones(len(state.precision), dtype=bool)
    without = {}
    for a, low, high in zip(state.active, ends[:-1], ends[1:], strict=True):
        if a.effect in effects:
            without[a.effect] = everything.copy()
            without[a.effect][low:high] = False
    masks = [everything, *without.values()]
    solved = state.equations, state.precision, state.solution.sigma
    whole, *squares = held_back_squares(state, state.design, *solved, block, masks)
    gains = {}
    for effect, squares_without in zip(without, squares, strict=True):
        gain = squares_without - whole
        each = np.bincount(configuration, gain.sum(axis=0))
        error = float(np.sqrt(np.sum(each**2)))
        total = float(each.sum()) / error if error > 0.0 else 0.0
        worse = float(gain.sum(axis=1)[_judging_channels(model, effect)].min())
        gains[effect] = total if worse >= 0.0 or total > SURELY else min(total, worse)
    return gains
