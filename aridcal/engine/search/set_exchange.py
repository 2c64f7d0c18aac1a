"""Sets of effects exchanged for sets that single steps do not reach, as each step would have to be better by itself.

A search that adds the best effect first may explain several simple causes by one that is none of them; then no simple cause is
missing by itself. So the set is grown again from distant sets: with a cause at all places at which it may act, in place of
effects of the same motion and covariates, and from sets of whole families. The set with the most evidence stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.levels import STRONG
from aridcal.engine.search.linear_model import ActiveEffect
from aridcal.engine.search.ranking import rank, with_flags
from aridcal.engine.search.sets import Choices, evidence_of_set, family
from aridcal.engine.search.state import State, activate
from aridcal.engine.search.steps import grow, tidy
from aridcal.system.progress import Progress

FEWEST_EXCHANGED_EFFECTS = 4
"""Work: Effects of a model from which sets are exchanged: of fewer the best is found by exchanging single ones."""

MOST_GROWN_EFFECTS = 28
"""Work: Effects of such a set at the most: four for each joint of a seven-joint arm, as gears err once and twice a turn at
each."""

LOWEST_ORDERS = 3
"""Lowest orders of which all up to each are tried together at all joints: gears and rings err once or twice a turn first."""

GROWN_SETS = 3
"""Work: Sets from which one is grown, those with the most evidence as they are: from others one comes back to the set
before."""

FAMILIES = 4
"""Work: Of which a set is made at the most: what bends, what yields, what turns unevenly, and one more."""


def regrow_sets(state: State, choices: Choices, progress: Progress) -> State:
    """The best of the sets that are grown from others further away, or the set as it is.

    Args:
        state: A set that no single addition or exchange makes better.
        choices: The candidates.
        progress: Called with the number of sets tried.
    """
    if sum(not a.declared for a in state.active) < FEWEST_EXCHANGED_EFFECTS:
        return state

    def evidence(of: State) -> float:
        return evidence_of_set(of, choices, state.used)

    before, curves = evidence(state), _curves(state)
    best, value = state, before
    sets = sorted(_distant_sets(state, choices.library), key=evidence, reverse=True)
    sets = [*sets[:GROWN_SETS], _set_of_families(state, choices.library, evidence)]
    for trial in progress.over(sets, "sets of effects"):
        trial = grow(trial, choices, MOST_GROWN_EFFECTS, False, progress)[0]
        trial = tidy(trial, choices, 1, progress)
        least = before if _curves(trial) < curves else before + STRONG
        if (after := evidence(trial)) > max(value, least):
            best, value = trial, after
    return best


def _curves(state: State) -> int:
    """Number of smooth effects in a set."""
    return sum(a.effect.smooth for a in state.active)


def _distant_sets(state: State, library: Sequence[Effect]) -> Iterator[State]:
    """Sets that differ from a set by more than one effect."""
    effects = [a.effect for a in state.active if not a.declared]
    acting = {_motion_and_covariates(e) for e in effects}
    alike = dict.fromkeys([*map(family, effects), *(family(e) for e in library if _motion_and_covariates(e) in acting)])
    for this_family in alike:
        members = [e for e in library if family(e) == this_family and e.at is None]
        places = {_motion_and_covariates(e) for e in members}
        without = _without(
            state, [e for e in effects if family(e) == this_family or _motion_and_covariates(e) in places]
        )
        for some in _of_orders(members):
            everywhere = _with_all(without, some)
            if len(everywhere.active) - len(without.active) > 1 and len(everywhere.active) <= MOST_GROWN_EFFECTS:
                yield everywhere


def _set_of_families(state: State, library: Sequence[Effect], evidence: Callable[[State], float]) -> State:
    """A set of whole families, the one that adds most evidence first: members may show together what none shows by itself."""
    simple = [e for e in library if len(e.slots) == 1 and e.at is None and not e.smooth]
    families = dict.fromkeys(map(family, simple))
    parts = [part for this_family in families for part in _of_orders([e for e in simple if family(e) == this_family])]
    best_set = _without(state, [a.effect for a in state.active if not a.declared])
    for _ in range(FAMILIES):
        trials = [_with_all(best_set, part) for part in parts]
        allowed = [trial for trial in trials if len(best_set.active) < len(trial.active) <= MOST_GROWN_EFFECTS]
        best = max(allowed, key=evidence, default=best_set)
        if evidence(best) <= evidence(best_set):
            break
        best_set = best
    return best_set


def _of_orders(members: Sequence[Effect]) -> Iterator[list[Effect]]:
    """Choices of a family's members: the lowest orders together, and each order by itself."""
    orders = sorted({e.order for e in members})
    lowest = [frozenset(orders[: k + 1]) for k in range(len(orders))]
    for some in dict.fromkeys([*lowest[:LOWEST_ORDERS], *(frozenset([order]) for order in orders)]):
        yield [e for e in members if e.order in some]


def _motion_and_covariates(effect: Effect) -> tuple[object, ...]:
    """Place, motion and covariates: causes that share all three imitate one another."""
    return effect.where, effect.motion, effect.covariates


def _with_all(state: State, members: Sequence[Effect]) -> State:
    """The set with all of some effects that have evidence, one of each place and order."""
    best: dict[tuple[object, ...], ActiveEffect] = {}
    for effect, score in rank(state, members):
        if score.gain > 0.0:
            best.setdefault((effect.where, effect.order), activate(state, effect, score))
    return state.with_active((*state.active, *best.values()))


def _without(state: State, effects: Sequence[Effect]) -> State:
    """The set without some effects, rows flagged anew."""
    rest = [a for a in state.active if a.effect not in effects]
    return with_flags(state.with_active(rest, fixed=True))
