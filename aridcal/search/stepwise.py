"""Which effects the residual asks for: the best added, all tried again, until nothing more is worth it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.effects.catalogue import KINDS
from aridcal.effects.effect import Effect
from aridcal.fit.least_squares import OUTLIER
from aridcal.search.change_points import SIDE, best_steps, opened
from aridcal.search.evidence import NOTHING, Score
from aridcal.search.hints import harmonics
from aridcal.search.linear_model import LinearModel, State, activate, solve_state
from aridcal.search.scoring import ALPHA, Judgement, judge, refine, score_all

CLOSE = 3.0
"""[nat] by which another candidate may be worse and still be confounded with the one named: odds of 20 to 1."""

RANKED = 12
"""Candidates among which those confounded with an effect are sought."""

REFINED = 6
"""Candidates whose score is found again with the noise of each channel apart: the best may change places."""

PROMISING = 0.4
"""Share of the best score below which a candidate is not scored again: it would not overtake."""

JUDGED = 4
"""Candidates that are tried on rows held back, the best first, before a step gives up."""

MOST = 14
"""Effects that are added at the most: two for each joint of a seven-joint arm."""

BETTER = 1.0
"""[nat] by which another candidate must do better to take an effect's place: without it, near twins change for ever."""

PASSES = 4
"""Times that effects are added and tidied in turn, where that is cheap."""

SMALL = 1e6
"""Numbers measured times candidates, below which every choice is tried again after each step in little time."""

MAPPED = 30.0
"""Highest order that a joint_map resolves: 72 knots over a turn, two for each half period."""


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


def search(model: LinearModel, library: Sequence[Effect], start: State, most: int = MOST, tested: int = 0) -> Found:
    """Add effects one at a time, test again what was taken and what was not, until nothing more is worth it.

    Args:
        model: The linearised model.
        library: All candidates.
        start: Effects to begin with; see :func:`solve_state`.
        most: Effects to add at the most.
        tested: Candidates of which the library holds the most promising ones, if it does.
    """
    tested = max(tested, len(library))
    state, most = start, most + len(start.active)
    rejected: tuple[Judgement, ...] = ()
    small = is_small(model, library)
    for _ in range(PASSES if small else 1):
        state, rejected = _forward(model, library, state, most, small, tested)
        tidied = _tidy(model, library, state, 2 if small else 1, tested)
        same = [a.effect for a in tidied.active] == [a.effect for a in state.active]
        state = tidied
        if same:
            break
    return Found(state, rejected, tested)


def lifted(model: LinearModel, library: Sequence[Effect], state: State) -> State:
    """The model with a step that explains rows which were flagged: a tenth of them that moved alike look like outliers.

    Each place's best step over all rows, flags or not, is solved for; the one that leaves least is taken if it clears
    enough flags and passes the gates on the rows that it has cleared.

    Args:
        model: The linearised model.
        library: All candidates.
        state: The model as it is.
    """
    sound, flags = ~model.stale, int(np.sum(~state.used & ~model.stale))
    jumps = [e for e in library if e.at is not None]
    if flags < SIDE or not jumps:
        return state
    far = OUTLIER**2 * model.r.shape[1]

    def misfit(trial: State) -> float:
        squares = np.sum((trial.residual / state.sigma) ** 2, axis=1)
        return float(np.sum(np.minimum(squares[sound], far)))

    trials = []
    for effect in best_steps(model, opened(model, state), jumps):
        active = (*state.active, activate(model, state, effect, NOTHING))
        trials.append(solve_state(model, active, state.solution.sigma, sound))
    if not trials:
        return state
    best = min(trials, key=misfit)
    if int(np.sum(~best.used & sound)) > flags - SIDE or misfit(best) >= misfit(state):
        return state
    effect = best.active[-1].effect
    without = solve_state(model, state.active, best.solution.sigma, best.used, flag=False)
    found = refine(model, without, effect, score_all(model, [effect], without)[0])
    if judge(model, without, effect, found, len(library)).why:
        return state
    active = (*state.active, activate(model, without, effect, found))
    return solve_state(model, active, best.solution.sigma, best.used)


def is_small(model: LinearModel, library: Sequence[Effect]) -> bool:
    """True where every choice can be tried again after each step in little time."""
    return model.r.size * len(library) < SMALL and all(KINDS[e.kind].named for e in library)


def twins(model: LinearModel, library: Sequence[Effect], state: State) -> tuple[tuple[Effect, ...], ...]:
    """For each effect, the candidates that would do about as well in its place."""
    small = is_small(model, library)
    return tuple(
        _twins(model, library, state, k) if small or not a.effect.smooth else () for k, a in enumerate(state.active)
    )


def rank(
    model: LinearModel, library: Sequence[Effect], state: State, scan: bool = False, also: Sequence[Effect] = ()
) -> list[tuple[Effect, Score]]:
    """Score every candidate that is not in the model; the best first, the first few with their noise apart.

    Args:
        model: The linearised model.
        library: All candidates; a step among them is tried where the residual asks for it most.
        state: The model as it is.
        scan: Look for harmonics of any order, too.
        also: Further candidates, as they are.
    """
    jumps = [e for e in library if e.at is not None]
    library = [*(e for e in library if e.at is None), *best_steps(model, state, jumps), *also]
    library = list(dict.fromkeys(library))
    taken = {a.effect for a in state.active}
    kinds = {e.kind for e in library}
    held = {(kind, e.where) for e in taken for kind in KINDS[e.kind].holds}
    scanned = harmonics(model, state) if scan and "joint_harmonic" in kinds else []
    free = [e for e in (*library, *scanned) if e not in taken and not _is_held(e, held)]
    found = score_all(model, free, state)
    order = sorted(range(len(free)), key=lambda k: -found[k].gain)
    enough = PROMISING * found[order[0]].gain if order else 0.0
    head = [free[k] for k in order if found[k].gain > max(enough, 0.0)][:REFINED]
    rough = dict(zip(free, found, strict=True))
    close = sorted(((e, refine(model, state, e, rough[e])) for e in head), key=lambda pair: -pair[1].gain)
    return close + [(free[k], found[k]) for k in order if free[k] not in head]


def _is_held(effect: Effect, held: set[tuple[str, str]]) -> bool:
    """True for what an effect of the model holds already: a gain or a slow harmonic of a joint that has a map."""
    return (effect.kind, effect.where) in held and max(effect.order, default=0.0) < MAPPED


def _forward(
    model: LinearModel, library: Sequence[Effect], state: State, most: int, small: bool, tested: int
) -> tuple[State, tuple[Judgement, ...]]:
    rejected: tuple[Judgement, ...] = ()
    seen = {frozenset(a.effect for a in state.active)}
    while len(state.active) < most:
        ranked = rank(model, library, state, scan=True)
        judgements = []
        chosen = None
        for effect, found in ranked[:JUDGED]:
            judgement = judge(model, state, effect, found, tested)
            if not judgement.why:
                chosen = activate(model, state, effect, found)
                break
            judgements.append(judgement)
            if judgement.p_value > ALPHA:
                break
        rejected = tuple(judgements)
        if chosen is None:
            break
        state = solve_state(model, (*state.active, chosen), state.solution.sigma, state.used)
        if small and len(state.active) > 1:
            state = _tidy(model, library, state, 1, tested)
        if frozenset(a.effect for a in state.active) in seen:
            break  # what is added is taken out again: this goes round in circles
        seen.add(frozenset(a.effect for a in state.active))
    return state, rejected


def _tidy(model: LinearModel, library: Sequence[Effect], state: State, rounds: int, tested: int) -> State:
    """Take each effect out in turn: drop it if it is not missed, exchange it if another does better in its place."""
    kinds = {e.kind for e in library}
    # Harmonics of an order of their own, and steps, are no part of the library, but are tried again like all else.
    also = [a.effect for a in state.active if a.effect.kind in kinds]
    known = {*library, *also}
    for _ in range(rounds):
        before = [a.effect for a in state.active]
        for effect in before:
            active = [a for a in state.active if a.effect != effect]
            if len(active) == len(state.active) or effect not in known:
                continue
            # Rows that a step explains would be flagged without it, and then nothing would ask for it.
            without = solve_state(model, active, state.solution.sigma, state.used, flag=effect.at is None)
            ranked = rank(model, library, without, also=also)
            mine = next((s for e, s in ranked if e == effect), None)
            if mine is None:  # a map of the same joint, taken since, holds it
                state = without
                continue
            best, its = ranked[0]
            if best == effect or its.gain < mine.gain + BETTER:
                best, its = effect, mine
            keep = not judge(model, without, best, its, tested).why
            taken = (*active, activate(model, without, best, its)) if keep else active
            state = solve_state(model, taken, without.solution.sigma, without.used)
        if [a.effect for a in state.active] == before:
            break
    return state


def _twins(model: LinearModel, library: Sequence[Effect], state: State, k: int) -> tuple[Effect, ...]:
    """Candidates that would do about as well in the place of one of the effects."""
    mine = state.active[k]
    active = [a for a in state.active if a is not mine]
    without = solve_state(model, active, state.solution.sigma, state.used, flag=mine.effect.at is None)
    ranked = rank(model, library, without, also=[mine.effect])
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
