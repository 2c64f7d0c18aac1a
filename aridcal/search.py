"""Which effects the residual asks for: the best added, all tried again, until nothing more is worth it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from aridcal.bench import Bench, State, activate, solve_state
from aridcal.effects import Effect
from aridcal.evidence import Score
from aridcal.scan import harmonics
from aridcal.scoring import ALPHA, Verdict, judge, refine, score_all

CLOSE = 3.0  # nats by which another candidate may be worse and still not be told from the one named
RANKED = 12  # candidates that are looked at closely
REFINED = 6
JUDGED = 4
MOST = 14
MAPPED = 30.0  # highest order that a joint_map resolves


@dataclass(frozen=True)
class Found:
    """The effects found.

    Attributes:
        state: The final set.
        rejected: The best of those that were not taken, and why.
        tested: Number of candidates.
    """

    state: State
    rejected: tuple[Verdict, ...]
    tested: int


def search(bench: Bench, library: Sequence[Effect], start: State, most: int = MOST, tested: int = 0) -> Found:
    """Add effects one at a time, test again what was taken and what was not, until nothing more is worth it.

    Args:
        bench: The linearised model.
        library: All candidates.
        start: Effects to begin with; see :func:`solve_state`.
        most: Effects to add at the most.
        tested: Candidates of which the library holds the most promising ones, if it does.
    """
    tested = max(tested, len(library))
    state, most = start, most + len(start.active)
    rejected: tuple[Verdict, ...] = ()
    small = is_small(bench, library)
    for _ in range(4 if small else 1):
        state, rejected = _forward(bench, library, state, most, small, tested)
        tidied = _tidy(bench, library, state, 2 if small else 1, tested)
        same = [a.effect for a in tidied.active] == [a.effect for a in state.active]
        state = tidied
        if same:
            break
    return Found(state, rejected, tested)


def is_small(bench: Bench, library: Sequence[Effect]) -> bool:
    """True where every choice can be tried again after each step in little time."""
    return bench.r.size * len(library) < 1e6 and not any(e.kind == "unknown" for e in library)


def twins(bench: Bench, library: Sequence[Effect], state: State) -> tuple[tuple[Effect, ...], ...]:
    """For each effect, the candidates that would do about as well in its place."""
    small = is_small(bench, library)
    return tuple(
        _twins(bench, library, state, k) if small or not a.effect.smooth else () for k, a in enumerate(state.active)
    )


def rank(bench: Bench, library: Sequence[Effect], state: State, scan: bool = False) -> list[tuple[Effect, Score]]:
    """Score every candidate that is not in the model; the best first, the first few with their noise apart."""
    taken = {a.effect for a in state.active}
    kinds = {e.kind for e in library}
    mapped = {e.where for e in taken if e.kind == "joint_map"}
    scanned = harmonics(bench, state) if scan and "joint_harmonic" in kinds else []
    free = [e for e in (*library, *scanned) if e not in taken and not (e.where in mapped and _in_a_map(e))]
    found = score_all(bench, free, state)
    order = sorted(range(len(free)), key=lambda k: -found[k].gain)
    enough = 0.4 * found[order[0]].gain if order else 0.0
    head = [free[k] for k in order if found[k].gain > max(enough, 0.0)][:REFINED]
    rough = dict(zip(free, found, strict=True))
    close = sorted(((e, refine(bench, state, e, rough[e])) for e in head), key=lambda pair: -pair[1].gain)
    return close + [(free[k], found[k]) for k in order if free[k] not in head]


def _in_a_map(effect: Effect) -> bool:
    """True for functions of a joint's own reading that a joint_map of the same joint holds already."""
    return effect.kind == "joint_gain" or (effect.kind == "joint_harmonic" and max(effect.order) < MAPPED)


def _forward(
    bench: Bench, library: Sequence[Effect], state: State, most: int, small: bool, tested: int
) -> tuple[State, tuple[Verdict, ...]]:
    rejected: tuple[Verdict, ...] = ()
    seen = {frozenset(a.effect for a in state.active)}
    while len(state.active) < most:
        ranked = rank(bench, library, state, scan=True)
        verdicts = []
        chosen = None
        for effect, found in ranked[:JUDGED]:
            verdict = judge(bench, state, effect, found, tested)
            if not verdict.why:
                chosen = activate(bench, state, effect, found)
                break
            verdicts.append(verdict)
            if verdict.p_value > ALPHA:
                break
        rejected = tuple(verdicts)
        if chosen is None:
            break
        state = solve_state(bench, (*state.active, chosen), state.solution.sigma, state.weight)
        if small and len(state.active) > 1:
            state = _tidy(bench, library, state, 1, tested)
        if frozenset(a.effect for a in state.active) in seen:
            break  # what is added is taken out again: this goes round in circles
        seen.add(frozenset(a.effect for a in state.active))
    return state, rejected


def _tidy(bench: Bench, library: Sequence[Effect], state: State, rounds: int, tested: int) -> State:
    """Take each effect out in turn: drop it if it is not missed, exchange it if another does better in its place."""
    kinds = {e.kind for e in library}
    # Harmonics of an order of their own are no part of the library, but are tried again like all else.
    library = list(dict.fromkeys([*library, *(a.effect for a in state.active if a.effect.kind in kinds)]))
    known = set(library)
    for _ in range(rounds):
        before = [a.effect for a in state.active]
        for effect in before:
            active = [a for a in state.active if a.effect != effect]
            if len(active) == len(state.active) or effect not in known:
                continue
            without = solve_state(bench, active, state.solution.sigma, state.weight)
            ranked = rank(bench, library, without)
            mine = next((s for e, s in ranked if e == effect), None)
            if mine is None:  # a map of the same joint, taken since, holds it
                state = without
                continue
            best, its = ranked[0]
            if best == effect or its.gain < mine.gain + 1.0:
                best, its = effect, mine
            keep = not judge(bench, without, best, its, tested).why
            taken = (*active, activate(bench, without, best, its)) if keep else active
            state = solve_state(bench, taken, without.solution.sigma, without.weight)
        if [a.effect for a in state.active] == before:
            break
    return state


def _twins(bench: Bench, library: Sequence[Effect], state: State, k: int) -> tuple[Effect, ...]:
    """Candidates that would do about as well in the place of one of the effects."""
    mine = state.active[k]
    active = [a for a in state.active if a is not mine]
    without = solve_state(bench, active, state.solution.sigma, state.weight)
    ranked = rank(bench, library, without)
    own = next((s for e, s in ranked if e == mine.effect), None)
    if own is None:
        return ()
    name = (mine.effect.kind, mine.effect.where, mine.effect.with_, mine.effect.by)
    twins: dict[tuple[object, ...], Effect] = {}
    for effect, found in ranked[:RANKED]:
        other = (effect.kind, effect.where, effect.with_, effect.by)
        if found.gain > own.gain - CLOSE and other != name:
            twins.setdefault(other, effect)
    return tuple(twins.values())
