"""Curves of a model shaped anew beside all else that is in it: found one after the other, each hides what the others do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aridcal.engine.numerics import ROUNDS
from aridcal.engine.search.linear_model import Active
from aridcal.engine.search.scoring import score_of
from aridcal.engine.search.state import State, activate, without_effect

SAME = 0.1
"""Work: Share of its size by which the shape of a curve may still change: rows tell the size of a curve no better."""


def reshaped(state: State, some: Callable[[Active], bool]) -> State:
    """The model with the shapes of its curves found anew, one after the other, until they stay.

    A curve that is shaped before others are in the model bends after what they do, and would stay as rough.

    Args:
        state: A set of effects.
        some: Which of them.
    """
    for _ in range(ROUNDS):
        before = state
        for one in [a for a in state.active if a.effect.smooth and some(a)]:
            without = without_effect(state, one.effect)
            found = score_of(without, one.effect)
            if found.freedom == 0 or _alike(one, found.tau, found.kernel):
                continue
            again = replace(activate(without, one.effect, found), stated=one.stated)
            state = state.with_active([again if a is one else a for a in state.active])
        if state is before:
            break
    return state


def _alike(one: Active, tau: float, kernel: object) -> bool:
    """True if another shape of a curve is as good as its own."""
    return one.score.kernel == kernel and bool(np.isclose(one.score.tau, tau, rtol=SAME))
