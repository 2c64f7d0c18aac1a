"""Curves of a model shaped anew beside all other effects: shaped before these were there, each took over a part of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aridcal.engine.numerics import ROUNDS
from aridcal.engine.search.linear_model import ActiveEffect
from aridcal.engine.search.scoring import score_of
from aridcal.engine.search.state import State, activate, without_effect

CURVE_CHANGE_SHARE = 0.1
"""Work: Share of its size by which the shape of a curve may still change: rows tell the size of a curve no better."""


def reshaped(state: State, some: Callable[[ActiveEffect], bool]) -> State:
    """The model with the shapes of its curves estimated anew, one after the other, until they stay.

    A curve that is shaped before others are in the model follows their effects too, and would stay as rough.

    Args:
        state: A set of effects.
        some: Says which of them are shaped anew.
    """
    for _ in range(ROUNDS):
        before = state
        for one in [a for a in state.active if a.effect.smooth and some(a)]:
            without = without_effect(state, one.effect)
            score = score_of(without, one.effect)
            if score.freedom == 0 or _same_shape(one, score.tau, score.kernel):
                continue
            shaped = replace(activate(without, one.effect, score), declared=one.declared)
            state = state.with_active([shaped if a is one else a for a in state.active])
        if state is before:
            break
    return state


def _same_shape(one: ActiveEffect, tau: float, kernel: object) -> bool:
    """True if another size and kernel are those of a curve, but for :data:`CURVE_CHANGE_SHARE`."""
    return one.score.kernel == kernel and bool(np.isclose(one.score.tau, tau, rtol=CURVE_CHANGE_SHARE))
