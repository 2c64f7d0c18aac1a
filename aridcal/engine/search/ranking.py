"""Candidates ranked by their evidence beside a model, and a model with one of them added."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.engine.corrections.effect import Effect
from aridcal.engine.search.candidates import hinted_candidates
from aridcal.engine.search.change_points import best_steps
from aridcal.engine.search.evidence import Score
from aridcal.engine.search.linear_model import LinearModel
from aridcal.engine.search.scoring import ALPHA, refine, sources
from aridcal.engine.search.screening import score_all
from aridcal.engine.search.state import State, activate, noise_with
from aridcal.system.progress import SILENT, Progress

REFINED_CANDIDATES = 6
"""Work: Candidates whose score is found again with the noise of each channel apart: the best may change places."""

PROMISING_SHARE = 0.4
"""Work: Share of the best score below which a candidate is not scored again: it would not overtake."""

HOPELESS_SHARE = 0.33
"""Work: Share of the evidence that :data:`ALPHA` asks for below which the best rough score is not found again: noise apart
moves so small a score by parts of a nat, where 9 are missing."""

SMALL_SEARCH = 1e6
"""Work: Numbers measured times candidates, below which every choice is tried again after each step in little time."""

GAIN_DECIMALS = 4
"""Work: Decimals of a gain [nat] that put candidates in order: the same motion of two places explains the same, and the first
is taken, whatever rounding says."""

HIGHEST_MAP_ORDER = 30.0
"""Highest order that a joint_map resolves: 72 knots over a turn, two for each half period."""


def is_small(model: LinearModel, library: Sequence[Effect]) -> bool:
    """True where every choice can be tried again after each step in little time."""
    return model.r.size * len(library) < SMALL_SEARCH and all(EFFECT_KINDS[e.kind].named for e in library)


def rank(
    state: State,
    library: Sequence[Effect],
    hints: Collection[str] = (),
    also: Sequence[Effect] = (),
    progress: Progress = SILENT,
    scores: Mapping[Effect, Score] | None = None,
) -> list[tuple[Effect, Score]]:
    """Scores of every candidate that is not in the model; the best first, the first few refined.

    Args:
        state: The model as it is.
        library: Candidates; of a step the best row is tried.
        hints: Kinds whose effects are candidates too where the residual hints at them.
        also: Further candidates, steps at their own row.
        progress: Called with the number of candidates scored.
        scores: Rough scores of candidates, as far as they are known.
    """
    jumps = [e for e in library if e.at is not None]
    library = [*(e for e in library if e.at is None), *best_steps(state.model, state, jumps), *also]
    active = set(state.effects)
    covered = {(kind, e.where) for e in active if not e.hinted for kind in EFFECT_KINDS[e.kind].holds}
    every = dict.fromkeys([*library, *hinted_candidates(state, hints)])
    free = [e for e in every if e not in active and not _is_covered(e, covered)]
    rough = dict(scores or {})
    new = [e for e in free if e not in rough]
    rough.update(zip(new, score_all(state.model, new, state, progress), strict=True))
    order = sorted(free, key=lambda e: -round(rough[e].gain, GAIN_DECIMALS))
    top = rough[order[0]].gain if order else 0.0
    hopeless = top < HOPELESS_SHARE * float(np.log(max(len(every), 1) / ALPHA))
    head = [] if hopeless else [e for e in order if rough[e].gain > PROMISING_SHARE * top][:REFINED_CANDIDATES]
    close = sorted(
        ((e, refine(state, e, rough[e])) for e in head), key=lambda pair: -round(pair[1].gain, GAIN_DECIMALS)
    )
    refined = set(head)
    return close + [(e, rough[e]) for e in order if e not in refined]


def _is_covered(effect: Effect, covered: set[tuple[str, str]]) -> bool:
    """True for an effect that one of the model can imitate: a gain or a slow harmonic of a joint that has a map."""
    return (effect.kind, effect.where) in covered and max(effect.order, default=0.0) < HIGHEST_MAP_ORDER


def substitutes(state: State, library: Sequence[Effect], effect: Effect) -> list[Effect]:
    """Candidates for the place of an effect: steps are none of them for one of joints alone, where their scan takes long."""
    timed = effect.at is not None or not set(sources(effect)) <= set(state.model.joints)
    return [e for e in library if e.at is None or timed or is_small(state.model, library)]


def with_effect(state: State, effect: Effect, score: Score) -> State:
    """The model with a candidate, solved from the noise of the candidate's score."""
    return state.with_active((*state.active, activate(state, effect, score)), noise_with(state, score))


def with_flags(state: State) -> State:
    """The model with its rows flagged anew."""
    return state.with_active(state.active)
