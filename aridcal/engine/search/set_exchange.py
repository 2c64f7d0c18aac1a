"""Sets of effects exchanged for sets: what single steps cannot reach, as each of them would have to be better by itself.

A search that adds the best effect first may explain the work of several simple causes by one that is none of them; then none of
the simple ones is missed alone. So the set is grown again from others that lie further away: with a cause at all places at
which it may act, in place of what moves the same with the same, and from sets that are made of whole families. The set with the
most evidence stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.levels import STRONG
from aridcal.engine.search.linear_model import Active
from aridcal.engine.search.ranking import rank, with_flags
from aridcal.engine.search.sets import Choices, evidence_of_set, family
from aridcal.engine.search.state import State, activate
from aridcal.engine.search.steps import grown, tidied
from aridcal.system.progress import Progress

FEWEST = 4
"""Work: Effects of a model from which sets are exchanged: of fewer the best is found by exchanging single ones."""

MOST_GROWN = 28
"""Work: Effects of such a set at the most: four for each joint of a seven-joint arm, as gears err once and twice a turn at
each."""

LOWEST = 3
"""Lowest orders of which all up to each are tried together at all joints: gears and rings err once or twice a turn first."""

TRIED = 3
"""Work: Sets from which one is grown, those with the most evidence as they are: from others one comes back to the set
before."""

FAMILIES = 4
"""Work: Of which a set is made at the most: what bends, what yields, what turns unevenly, and one more."""


def regrown(state: State, choices: Choices, progress: Progress) -> State:
    """The best of the sets that are grown from others further away, or the set as it is.

    Args:
        state: A set to which nothing can be added, and of which no single effect can be exchanged.
        choices: What is chosen among.
        progress: Told how many sets are tried.
    """
    if sum(not a.stated for a in state.active) < FEWEST:
        return state

    def evidence(of: State) -> float:
        return evidence_of_set(of, choices, state.used)

    own, curves = evidence(state), _curves(state)
    best, value = state, own
    begun = sorted(_further_away(state, choices.library), key=evidence, reverse=True)
    begun = [*begun[:TRIED], _of_families(state, choices.library, evidence)]
    for trial in progress.over(begun, "sets of effects"):
        trial = grown(trial, choices, MOST_GROWN, False, progress)[0]
        trial = tidied(trial, choices, 1, progress)
        least = own if _curves(trial) < curves else own + STRONG
        if (its := evidence(trial)) > max(value, least):
            best, value = trial, its
    return best


def _curves(state: State) -> int:
    """How many effects of a set may bend as the rows have it."""
    return sum(a.effect.smooth for a in state.active)


def _further_away(state: State, library: Sequence[Effect]) -> Iterator[State]:
    """Sets that differ from one by more than an effect."""
    mine = [a.effect for a in state.active if not a.stated]
    acting = {_acts(e) for e in mine}
    alike = dict.fromkeys([*map(family, mine), *(family(e) for e in library if _acts(e) in acting)])
    for own in alike:
        members = [e for e in library if family(e) == own and e.at is None]
        places = {_acts(e) for e in members}
        without = _without(state, [e for e in mine if family(e) == own or _acts(e) in places])
        for some in _of_orders(members):
            everywhere = _everywhere(without, some)
            if len(everywhere.active) - len(without.active) > 1 and len(everywhere.active) <= MOST_GROWN:
                yield everywhere


def _of_families(state: State, library: Sequence[Effect], evidence: Callable[[State], float]) -> State:
    """The set made of whole families, the one that adds most evidence first: what no member shows by itself they may together."""
    simple = [e for e in library if len(e.slots) == 1 and e.at is None and not e.smooth]
    families = dict.fromkeys(map(family, simple))
    parts = [part for own in families for part in _of_orders([e for e in simple if family(e) == own])]
    made = _without(state, [a.effect for a in state.active if not a.stated])
    for _ in range(FAMILIES):
        more = [_everywhere(made, part) for part in parts]
        allowed = [own for own in more if len(made.active) < len(own.active) <= MOST_GROWN]
        best = max(allowed, key=evidence, default=made)
        if evidence(best) <= evidence(made):
            break
        made = best
    return made


def _of_orders(members: Sequence[Effect]) -> Iterator[list[Effect]]:
    """Members of a family: those of the lowest orders together, and those of each order."""
    orders = sorted({e.order for e in members})
    lowest = [frozenset(orders[: k + 1]) for k in range(len(orders))]
    for some in dict.fromkeys([*lowest[:LOWEST], *(frozenset([order]) for order in orders)]):
        yield [e for e in members if e.order in some]


def _acts(effect: Effect) -> tuple[object, ...]:
    """What moves, and with what: causes that share this stand for one another."""
    return effect.where, effect.motion, effect.covariates


def _everywhere(state: State, members: Sequence[Effect]) -> State:
    """The set with all of some effects of which the rows say anything, one of each order a place."""
    best: dict[tuple[object, ...], Active] = {}
    for effect, found in rank(state, members):
        if found.gain > 0.0:
            best.setdefault((effect.where, effect.order), activate(state, effect, found))
    return state.with_active((*state.active, *best.values()))


def _without(state: State, effects: Sequence[Effect]) -> State:
    """The set without some effects, rows flagged anew."""
    rest = [a for a in state.active if a.effect not in effects]
    return with_flags(state.with_active(rest, fixed=True))
