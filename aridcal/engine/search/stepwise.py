"""Which effects the residual asks for: the best added, all tried again, whole sets exchanged, until nothing more is worth it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.search.ranking import is_small, with_effect, with_flags
from aridcal.engine.search.scoring import Judgement, judge, score_of
from aridcal.engine.search.set_exchange import regrown
from aridcal.engine.search.sets import Choices
from aridcal.engine.search.state import State, without_effect
from aridcal.engine.search.steps import grown, tidied
from aridcal.system.progress import SILENT, Progress

MOST = 14
"""Work: Effects that are added at the most: two for each joint of a seven-joint arm."""

PASSES = 4
"""Work: Times that effects are added and tidied in turn, where that is cheap."""


@dataclass(frozen=True)
class Found:
    """The effects found.

    Attributes:
        state: The final set.
        rejected: The best of those that were not taken, and why.
        tested: Number of candidates.
    """

    state: State
    rejected: tuple[Judgement, ...]
    tested: int


def search(
    start: State,
    library: Sequence[Effect],
    most: int = MOST,
    tested: int = 0,
    exchange: bool = True,
    progress: Progress = SILENT,
) -> Found:
    """Add effects one at a time, test again what was taken and what was not, until nothing more is worth it.

    Where that is cheap, causes of a single motion come first: one that moves a frame in several ways explains a part of each of
    several simple ones, and none of these is missed alone then.

    Args:
        start: Effects to begin with; see :func:`~aridcal.engine.search.state.solve_state`.
        library: All candidates.
        most: Effects to add at the most.
        tested: Candidates of which the library holds the most promising ones, if it does.
        exchange: Whether effects may be exchanged for others; else they are only added.
        progress: Told how many candidates are scored.
    """
    choices = Choices.of(library, tested)
    most += len(start.active)
    small = is_small(start.model, library)
    if not (small and exchange):
        state, rejected = grown(start, choices, most, small, progress)
        state = tidied(state, choices, 1, progress) if exchange else state
        return Found(state, rejected, choices.count)
    simple = [e for e in library if len(e.slots) == 1]
    state = _passes(start, choices.only(simple), most, progress)[0] if simple else start
    state, rejected = _passes(state, choices, most, progress)
    return Found(state, rejected, choices.count)


def exchanged(found: Found, library: Sequence[Effect], progress: Progress = SILENT) -> Found:
    """What was found among all candidates, or a better set that single steps do not lead to; sought where that is cheap."""
    state = found.state
    if not is_small(state.model, library):
        return found
    return replace(found, state=regrown(state, Choices.of(library, found.tested), progress))


def _passes(state: State, choices: Choices, most: int, progress: Progress) -> tuple[State, tuple[Judgement, ...]]:
    """Effects added and tidied in turn, until both change nothing."""
    rejected: tuple[Judgement, ...] = ()
    for _ in range(PASSES):
        state, rejected = grown(state, choices, most, True, progress)
        before = state.effects
        state = tidied(state, choices, 2, progress)
        if state.effects == before:
            break
    return state, rejected


def confirmed(state: State, tested: int, progress: Progress = SILENT) -> State:
    """The model without those of its effects that would not pass the gates now, tried one after the other.

    Args:
        state: Solved with effects that were found on other rows or with other weights.
        tested: Candidates among which they stood out.
        progress: Told how many are tried.
    """
    choices = Choices.of(state.effects, tested)
    for effect in progress.over([a.effect for a in state.active if not a.stated], "effects"):
        without = without_effect(state, effect)
        found = score_of(without, effect)
        keep = not judge(without, effect, found, choices).why
        state = with_effect(without, effect, found) if keep else with_flags(without)
    return state
