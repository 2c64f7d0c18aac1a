"""Which effects the residual asks for: the best added, all tried again, until nothing more is worth it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.effects.catalogue import KINDS
from aridcal.effects.effect import Effect
from aridcal.effects.regional_kind import is_field, is_local, is_of_labels
from aridcal.instruments.channels import columns
from aridcal.search.change_points import best_steps
from aridcal.search.evidence import Score
from aridcal.search.hints import hinted
from aridcal.search.linear_model import Active, LinearModel
from aridcal.search.scoring import ALPHA, Judgement, held_back_squares, judge, refine, sources
from aridcal.search.screening import score_all, score_without
from aridcal.search.state import State, activate, noise_with, solve_state, without_effect
from aridcal.search.tied import mirrored
from aridcal.showing import SILENT, Progress

CLOSE = 3.0
"""[nat] by which another candidate may be worse and still be confounded with the one named: odds of 20 to 1."""

RANKED = 12
"""Candidates among which those confounded with an effect are sought."""

REFINED = 6
"""Candidates whose score is found again with the noise of each channel apart: the best may change places."""

PROMISING = 0.4
"""Share of the best score below which a candidate is not scored again: it would not overtake."""

HOPELESS = 0.33
"""Share of the evidence that :data:`ALPHA` asks for below which the best rough score is not found again: noise apart
moves so small a score by parts of a nat, where 9 are missing."""

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

ALIKE = 4
"""Decimals of a gain [nat] that put candidates in order: the same motion of two places explains the same, and the first is taken,
whatever rounding says."""

MAPPED = 30.0
"""Highest order that a joint_map resolves: 72 knots over a turn, two for each half period."""

BLOCKS = 10
"""Blocks of configurations, other ones than those by which the effects were chosen."""

SURE_GAIN = 3.0
"""Standard errors of a gain on held-back rows from which an effect stays although one channel gets a little worse."""


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
    model: LinearModel,
    library: Sequence[Effect],
    start: State,
    most: int = MOST,
    tested: int = 0,
    exchange: bool = True,
    progress: Progress = SILENT,
) -> Found:
    """Add effects one at a time, test again what was taken and what was not, until nothing more is worth it.

    Args:
        model: The linearised model.
        library: All candidates.
        start: Effects to begin with; see :func:`solve_state`.
        most: Effects to add at the most.
        tested: Candidates of which the library holds the most promising ones, if it does.
        exchange: Whether effects may be exchanged for others; else they are only added.
        progress: Told how many candidates are scored.
    """
    tested = max(tested, len(library))
    state, most = start, most + len(start.active)
    rejected: tuple[Judgement, ...] = ()
    small = is_small(model, library)
    for _ in range(PASSES if small else 1):
        state, rejected = _forward(model, library, state, most, small, tested, progress)
        if not exchange:
            break
        tidied = _tidy(model, library, state, 2 if small else 1, tested, progress)
        same = [a.effect for a in tidied.active] == [a.effect for a in state.active]
        state = tidied
        if same:
            break
    return Found(state, rejected, tested)


def confirmed(model: LinearModel, state: State, tested: int, progress: Progress = SILENT) -> State:
    """The model without those of its effects that would not pass the gates now, tried one after the other.

    Args:
        model: The linearised model.
        state: Solved with effects that were found on other rows or with other weights.
        tested: Candidates among which they stood out.
        progress: Told how many are tried.
    """
    for effect in progress.over([a.effect for a in state.active if not a.stated], "effects"):
        without = without_effect(model, state, effect)
        found = refine(model, without, effect, score_all(model, [effect], without)[0])
        keep = not judge(model, without, effect, found, tested).why
        state = _with_it(model, without, effect, found) if keep else _with_flags(model, without)
    return state


def _with_it(model: LinearModel, state: State, effect: Effect, found: Score) -> State:
    """The model with a candidate, flags and noise found anew, from the noise that its score was found with."""
    return solve_state(
        model, (*state.active, activate(model, state, effect, found)), noise_with(state, found), state.used
    )


def _with_flags(model: LinearModel, state: State) -> State:
    """The same effects, rows flagged anew."""
    return solve_state(model, state.active, state.solution.sigma, state.used)


def is_small(model: LinearModel, library: Sequence[Effect]) -> bool:
    """True where every choice can be tried again after each step in little time."""
    return model.r.size * len(library) < SMALL and all(KINDS[e.kind].named for e in library)


def twins(
    model: LinearModel, library: Sequence[Effect], state: State, progress: Progress = SILENT
) -> tuple[tuple[tuple[Effect, Score], ...], ...]:
    """Each effect, and the candidates that would do about as well in its place; nothing where none are sought."""
    small = is_small(model, library)
    asked = [a.effect for a in state.active if small or not a.effect.smooth or is_of_labels(a.effect)]
    lasting = list(dict.fromkeys([*(e for e in library if e.at is None), *asked]))
    rough = score_without(model, lasting, state, asked, progress)
    return tuple(
        _twins(model, library, state, a, rough[a.effect], progress) if a.effect in rough else () for a in state.active
    )


def rank(
    model: LinearModel,
    library: Sequence[Effect],
    state: State,
    hints: Collection[str] = (),
    also: Sequence[Effect] = (),
    progress: Progress = SILENT,
    known: Mapping[Effect, Score] | None = None,
) -> list[tuple[Effect, Score]]:
    """Score every candidate that is not in the model; the best first, the first few with their noise apart.

    Args:
        model: The linearised model.
        library: Candidates; a step among them is tried where the residual asks for it most.
        state: The model as it is.
        hints: Kinds of which those that the residual hints at are candidates too.
        also: Further candidates, as they are.
        progress: Told how many are scored.
        known: Rough scores of candidates, where there are some.
    """
    jumps = [e for e in library if e.at is not None]
    library = [*(e for e in library if e.at is None), *best_steps(model, state, jumps), *also]
    taken = {a.effect for a in state.active}
    held = {(kind, e.where) for e in taken if not e.hinted for kind in KINDS[e.kind].holds}
    every = dict.fromkeys([*library, *hinted(model, state, hints)])
    free = [e for e in every if e not in taken and not _is_held(e, held)]
    rough = dict(known or {})
    new = [e for e in free if e not in rough]
    rough.update(zip(new, score_all(model, new, state, progress), strict=True))
    order = sorted(free, key=lambda e: -round(rough[e].gain, ALIKE))
    top = rough[order[0]].gain if order else 0.0
    hopeless = top < HOPELESS * float(np.log(max(len(every), 1) / ALPHA))
    head = [] if hopeless else [e for e in order if rough[e].gain > PROMISING * top][:REFINED]
    close = sorted(((e, refine(model, state, e, rough[e])) for e in head), key=lambda pair: -round(pair[1].gain, ALIKE))
    refined = set(head)
    return close + [(e, rough[e]) for e in order if e not in refined]


def _is_held(effect: Effect, held: set[tuple[str, str]]) -> bool:
    """True for what an effect of the model holds already: a gain or a slow harmonic of a joint that has a map."""
    return (effect.kind, effect.where) in held and max(effect.order, default=0.0) < MAPPED


def _forward(
    model: LinearModel,
    library: Sequence[Effect],
    state: State,
    most: int,
    small: bool,
    tested: int,
    progress: Progress,
) -> tuple[State, tuple[Judgement, ...]]:
    rejected: tuple[Judgement, ...] = ()
    seen = {frozenset(a.effect for a in state.active)}
    kinds = {e.kind for e in library}
    while len(state.active) < most:
        before = state
        state, hints = _with_rows_of_hints(model, state, kinds)
        ranked = rank(model, library, state, also=hints, progress=progress)
        judgements = []
        chosen = None
        for effect, found in ranked[:JUDGED]:
            judgement = judge(model, state, effect, found, tested)
            if not judgement.why:
                chosen = _with_it(model, state, effect, found)
                break
            judgements.append(judgement)
            if judgement.p_value > ALPHA:
                break
        rejected = tuple(judgements)
        if chosen is None:
            state = before
            break
        state = chosen
        if small and len(state.active) > 1:
            state = _tidy(model, library, state, 1, tested, progress)
        if frozenset(a.effect for a in state.active) in seen:
            break  # what is added is taken out again: this goes round in circles
        seen.add(frozenset(a.effect for a in state.active))
    return state, rejected


def _with_rows_of_hints(model: LinearModel, state: State, kinds: Collection[str]) -> tuple[State, list[Effect]]:
    """The same effects solved with the flagged rows that a hint would explain: they are what it was seen by. And the hints."""
    used, hints = state.used.copy(), hinted(model, state, kinds)
    for effect in hints:
        if effect.smooth or is_field(effect):
            used |= np.any(model.columns(effect), axis=(1, 2))
    if np.array_equal(used, state.used):
        return state, hints
    state = solve_state(model, state.active, state.solution.sigma, used, True)
    return state, hinted(model, state, kinds)


def _tidy(
    model: LinearModel, library: Sequence[Effect], state: State, rounds: int, tested: int, progress: Progress
) -> State:
    """Take each effect out in turn: drop it if it is not missed, exchange it if another does better in its place."""
    kinds = {e.kind for e in library}
    # Harmonics of an order of their own, and steps, are no part of the library, but are tried again like all else.
    also = [a.effect for a in state.active if a.effect.kind in kinds]
    known = {*library, *also} - {a.effect for a in state.active if a.stated}
    lasting = list(dict.fromkeys(e for e in (*library, *also) if e.at is None or e in also))
    for _ in range(rounds):
        before = [a.effect for a in state.active]
        rough = score_without(model, lasting, state, known, progress)
        for k, effect in enumerate(before):
            if effect not in known or all(a.effect != effect for a in state.active):
                continue
            without = without_effect(model, state, effect)
            rivals = _in_place_of(model, library, effect)
            ranked = rank(model, rivals, without, {effect.kind}, also, progress, rough[effect])
            mine = next((s for e, s in ranked if e == effect), None)
            if mine is None:  # a map of the same joint, taken since, holds it
                state = without
                continue
            best, its = ranked[0]
            if best == effect or its.gain < mine.gain + BETTER:
                best, its = effect, mine
            keep = not judge(model, without, best, its, tested).why
            state = _with_it(model, without, best, its) if keep else _with_flags(model, without)
            if not keep or best != effect:
                rough = score_without(model, lasting, state, known.intersection(before[k + 1 :]), progress)
        if [a.effect for a in state.active] == before:
            break
    return state


def _in_place_of(model: LinearModel, library: Sequence[Effect], effect: Effect) -> list[Effect]:
    """Candidates that may be what an effect is taken for: of what joints alone decide, no step, where a scan takes long."""
    timed = effect.at is not None or not set(sources(effect)) <= set(model.own)
    return [e for e in library if e.at is None or timed or is_small(model, library)]


def _twins(
    model: LinearModel,
    library: Sequence[Effect],
    state: State,
    mine: Active,
    rough: Mapping[Effect, Score],
    progress: Progress,
) -> tuple[tuple[Effect, Score], ...]:
    """One of the effects, and candidates that would do about as well in its place.

    Args:
        model: The linearised model.
        library: Candidates.
        state: The model with it.
        mine: The effect.
        rough: Scores of candidates without it.
        progress: Told how many are scored.
    """
    without = without_effect(model, state, mine.effect)
    rivals = _in_place_of(model, library, mine.effect)
    also = [mine.effect, *mirrored(model, mine.effect)]
    ranked = rank(model, rivals, without, also=also, progress=progress, known=rough)
    own = next((s for e, s in ranked if e == mine.effect), None)
    if own is None:
        return ()
    name = (mine.effect.kind, mine.effect.where, mine.effect.with_, mine.effect.by)
    twins: dict[tuple[object, ...], tuple[Effect, Score]] = {}
    for effect, found in ranked[:RANKED]:
        other = (effect.kind, effect.where, effect.with_, effect.by)
        if found.gain > own.gain - CLOSE and other != name:
            twins.setdefault(other, (effect, found))
    return (mine.effect, own), *twins.values()


def missed(model: LinearModel, state: State) -> State:
    """The model without the effects that held-back rows do not miss; what the campaign states stays.

    The effects are taken out one at a time, the least missed first, and all others are solved anew. The model is linear
    about its own optimum, where effects that are nearly not missed change nothing to the second order.

    Args:
        model: Linearised at the exact fit.
        state: Solved with all effects.
    """
    asked = {a.effect for a in state.active if not a.stated}
    while asked:
        gains = _held_back_gains(model, state, asked)
        worst = min(gains, key=lambda effect: gains[effect])
        if gains[worst] > 0.0:
            break
        rest = [a for a in state.active if a.effect != worst]
        state = solve_state(model, rest, state.solution.sigma, state.used)
        # What is missed for sure is not asked again: the others stand in for what went, if anything.
        asked = {effect for effect, gain in gains.items() if gain < SURE_GAIN} - {worst}
    return state


def _judging(model: LinearModel, effect: Effect) -> list[int]:
    """Channels that judge an effect: all; of what is local, which has few rows to speak for it, those that it moves."""
    every = list(range(len(model.channels)))
    if not is_local(effect):
        return every
    moved = np.any(model.columns(effect), axis=(0, 2))
    return [k for k, part in enumerate(columns(model.channels)) if moved[part].any()]


def _held_back_gains(model: LinearModel, state: State, asked: Collection[Effect]) -> dict[Effect, float]:
    """By how many standard errors effects lower the squared error of held-back rows; negative where one is not missed."""
    number = np.random.default_rng(1).permutation(int(model.configuration.max()) + 1)
    configuration = model.configuration[state.used]
    block = number[configuration] % BLOCKS
    ends = len(model.gauge) + np.cumsum([0, *(a.modes.shape[1] for a in state.active)])
    everything = np.ones(len(state.precision), dtype=bool)
    without = {}
    for a, low, high in zip(state.active, ends[:-1], ends[1:], strict=True):
        if a.effect in asked:
            without[a.effect] = everything.copy()
            without[a.effect][low:high] = False
    kept = [everything, *without.values()]
    solved = state.equations, state.precision, state.solution.sigma
    whole, *squares = held_back_squares(state, state.design, *solved, block, kept)
    gains = {}
    for effect, left in zip(without, squares, strict=True):
        gain = left - whole
        each = np.bincount(configuration, gain.sum(axis=0))
        error = float(np.sqrt(np.sum(each**2)))
        total = float(each.sum()) / error if error > 0.0 else 0.0
        worse = float(gain.sum(axis=1)[_judging(model, effect)].min())
        gains[effect] = total if worse >= 0.0 or total > SURE_GAIN else min(total, worse)
    return gains
