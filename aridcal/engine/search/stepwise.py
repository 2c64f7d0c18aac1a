"""Effects added one at a time, tried again and exchanged, alone and as sets, until no change is worth it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.search.ranking import is_small, with_effect, with_flags
from aridcal.engine.search.scoring import Judgement, judge, score_of
from aridcal.engine.search.set_exchange import regrow_sets
from aridcal.engine.search.sets import Choices
from aridcal.engine.search.state import State, without_effect
from aridcal.engine.search.steps import grow, tidy
from aridcal.system.progress import SILENT, Progress

MOST_EFFECTS = 14
"""Work: Effects that are added at the most: two for each joint of a seven-joint arm."""

MOST_ADDING_PASSES = 4
"""Work: Times that effects are added and tidied in turn, where that is cheap."""


@dataclass(frozen=True)
class StepwiseResult:
    """The result of a search.

    Attributes:
        state: The final set.
        rejected: The best candidates that were refused, and why.
        tested: Number of candidates.
    """

    state: State
    rejected: tuple[Judgement, ...]
    tested: int


def search(
    start: State,
    library: Sequence[Effect],
    most: int = MOST_EFFECTS,
    tested: int = 0,
    exchange: bool = True,
    progress: Progress = SILENT,
) -> StepwiseResult:
    """Add effects one at a time, and try again those in the model and those out of it, until no change is worth it.

    Where that is cheap, causes of a single motion come first: a cause that moves a frame in several ways explains a part of
    several simple ones, and none of these is missing by itself then.

    Args:
        start: Effects to begin with; see :func:`~aridcal.engine.search.state.solve_state`.
        library: All candidates.
        most: Effects to add at the most.
        tested: Number of all candidates, where the library holds the most promising ones alone.
        exchange: Whether effects may be exchanged for others; else they are only added.
        progress: Called with the number of candidates scored.
    """
    choices = Choices.of(library, tested)
    most += len(start.active)
    small = is_small(start.model, library)
    if not (small and exchange):
        state, rejected = grow(start, choices, most, small, progress)
        state = tidy(state, choices, 1, progress) if exchange else state
        return StepwiseResult(state, rejected, choices.count)
    simple = [e for e in library if len(e.slots) == 1]
    state = _passes(start, choices.only(simple), most, progress)[0] if simple else start
    state, rejected = _passes(state, choices, most, progress)
    return StepwiseResult(state, rejected, choices.count)


def exchange_sets(result: StepwiseResult, library: Sequence[Effect], progress: Progress = SILENT) -> StepwiseResult:
    """The result, or one with a better set that single steps do not lead to; such sets are tried where that is cheap."""
    state = result.state
    if not is_small(state.model, library):
        return result
    return replace(result, state=regrow_sets(state, Choices.of(library, result.tested), progress))


def _passes(state: State, choices: Choices, most: int, progress: Progress) -> tuple[State, tuple[Judgement, ...]]:
    """The model with effects added and tidied in turn, until both change nothing."""
    rejected: tuple[Judgement, ...] = ()
    for _ in range(MOST_ADDING_PASSES):
        state, rejected = grow(state, choices, most, True, progress)
        before = state.effects
        state = tidy(state, choices, 2, progress)
        if state.effects == before:
            break
    return state, rejected


def confirm(state: State, tested: int, progress: Progress = SILENT) -> State:
    """The model without the effects that would fail the tests now, tried one after the other.

    Args:
        state: Solved with effects from a search with other rows or weights.
        tested: Number of candidates of that search.
        progress: Called with the number of effects tried.
    """
    choices = Choices.of(state.effects, tested)
    for effect in progress.over([a.effect for a in state.active if not a.declared], "effects"):
        without = without_effect(state, effect)
        score = score_of(without, effect)
        keep = not judge(without, effect, score, choices).why
        state = with_effect(without, effect, score) if keep else with_flags(without)
    return state
