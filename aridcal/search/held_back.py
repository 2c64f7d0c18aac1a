"""Which effects are missed on blocks of rows held back, at the end of a search, and which error whole stretches of time have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aridcal.search.linear_model import Active, LinearModel, State, solve_state
from aridcal.search.scoring import held_back

BLOCKS = 10
"""Blocks of configurations, other ones than those by which the effects were chosen."""

SURE_GAIN = 3.0
"""Standard errors of a gain on held-back rows from which an effect stays although one channel gets a little worse."""


def missed(model: LinearModel, state: State) -> State:
    """The model without the effects that held-back rows do not miss; what the campaign states stays.

    The effects are taken out one at a time, the least missed first, and all others are solved anew. The model is linear
    about its own optimum, where effects that are nearly not missed change nothing to the second order.

    Args:
        model: Linearised at the exact fit.
        state: Solved with all effects.
    """
    while True:
        trials = [(gain, k) for k, a in enumerate(state.active) if not a.stated for gain in [_gain(model, state, k)]]
        worst = min(trials, default=None)
        if worst is None or worst[0] > 0.0:
            return state
        rest = _without(state.active, worst[1])
        state = solve_state(model, rest, state.solution.sigma, state.used)


def _gain(model: LinearModel, state: State, k: int) -> float:
    """By how many standard errors an effect lowers the squared error of held-back rows; negative if it is not missed."""
    rest = solve_state(model, _without(state.active, k), state.solution.sigma, state.used, fixed=True)
    block = _blocks(model)[rest.used]
    squares = held_back(model, rest, state.active[k], block)
    gain = squares[0] - squares[1]
    each = np.bincount(model.configuration[rest.used], gain.sum(axis=0))
    error = float(np.sqrt(np.sum(each**2)))
    total = float(each.sum()) / error if error > 0.0 else 0.0
    worse = float(gain.sum(axis=1).min())
    return total if worse >= 0.0 or total > SURE_GAIN else min(total, worse)


def _blocks(model: LinearModel) -> np.ndarray:
    """Number of each row's block, shape (N,): rows of one configuration share it."""
    number = np.random.default_rng(1).permutation(int(model.configuration.max()) + 1)
    return np.asarray(number[model.configuration] % BLOCKS)


def _without(active: Sequence[Active], k: int) -> tuple[Active, ...]:
    return (*active[:k], *active[k + 1 :])
