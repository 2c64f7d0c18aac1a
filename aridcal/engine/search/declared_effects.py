"""Effects that the campaign declares: in the model without trial, but for fields and constants by region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, UntestableEffect
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.regional_kind import is_of_labels, widths
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.search.candidates import hinted_candidates
from aridcal.engine.search.change_points import best_steps
from aridcal.engine.search.curves import reshaped
from aridcal.engine.search.evidence import DEPENDENT_SHARE
from aridcal.engine.search.linear_model import ActiveEffect, LinearModel
from aridcal.engine.search.scoring import held_back_errors, held_out_whole, judge, score_of
from aridcal.engine.search.screening import score_all
from aridcal.engine.search.sets import Choices
from aridcal.engine.search.state import State, activate, solve_state

CONFOUNDED_SENTENCE = "it is confounded with what is fitted without it: no row tells them apart"
"""Why a declared effect was left out."""

NOT_BETTER_HELD_BACK = "rows held back are predicted no better with it: the one model of the whole workspace stays"
"""Why a declared deviation from that model was left out."""


MOST_DENTS = 6
"""Work: Places at which targets are off that are found one by one, as many as other effects without a name."""


def add_declared_effects(
    linear: LinearModel, effects: Sequence[Effect], row_unknown: Sequence[bool], geometric: Fit
) -> tuple[State, list[UntestableEffect]]:
    """The model with the declared effects, which need no evidence, and those that are left out.

    Left out are effects that the rows do not tell from the constants and the effects before, single motions of which the same
    is true (:func:`_identifiable`), and constants by region with which held-back rows are predicted no better. A step goes to
    the best row where ``row_unknown`` says that none was declared. Fields without a cause wait for :func:`with_fields`.
    """
    barred: list[UntestableEffect] = []
    state = solve_state(linear, (), geometric.sigma, ~geometric.outliers)
    waiting: list[Effect] = []
    # Curves last: shaped before others are in the model, one may do all that these do, and they would seem confounded with it.
    for effect, anywhere in sorted(zip(effects, row_unknown, strict=True), key=lambda pair: pair[0].smooth):
        if EFFECT_KINDS[effect.kind].on_request:
            waiting += [effect] if EFFECT_KINDS[effect.kind].named else []
            continue
        if anywhere and effect.at is not None:
            effect = next(iter(best_steps(linear, state, [effect])), effect)
        if score_all(linear, [effect], state)[0].freedom == 0:
            barred.append(_barred(effect, CONFOUNDED_SENTENCE))
            continue
        part = _identifiable(state, effect)
        mute = [c.name for c in effect.coefficients if c not in part.coefficients]
        barred += [UntestableEffect(f"{name}, of the declared {effect.label},", CONFOUNDED_SENTENCE) for name in mute]
        state = state.with_active((*state.active, _as_declared(state, part)))
    state, barred_regions = _with_regions(state, waiting)
    return reshaped(state, lambda a: a.declared), [*barred, *barred_regions]


def with_fields(state: State, effects: Sequence[Effect]) -> tuple[State, list[UntestableEffect]]:
    """The model with declared fields of shifts that improve it beside all other effects, and the fields that are left out.

    They come last because a field can imitate any cause.
    """
    fields = [e for e in effects if not EFFECT_KINDS[e.kind].named and EFFECT_KINDS[e.kind].on_request]
    if not fields:
        return state, []
    for _ in range(MOST_DENTS):
        loud = hinted_candidates(state, {fields[0].kind})
        worthwhile = [
            _as_declared(state, e) for e in loud if not judge(state, e, score_of(state, e), Choices.of([e])).why
        ]
        if not worthwhile:
            break
        state = state.with_active((*state.active, *worthwhile))
    dented = any(a.declared and a.effect.kind == fields[0].kind for a in state.active)
    state, barred = _with_regions(state, fields)
    return state, [] if dented else barred


def _with_regions(state: State, waiting: Sequence[Effect]) -> tuple[State, list[UntestableEffect]]:
    """The model with deviations by region that improve it, the best first, one at a time; and those that are left out."""
    rest = list(waiting)
    while rest:
        trials = [(effect, _as_declared(state, each)) for effect in rest for each in widths(effect)]
        worth = [(effect, a) for effect, a in trials if _predicts_better(state, a)]
        if not worth:
            break
        effect, best = max(worth, key=lambda pair: pair[1].score.gain)
        rest.remove(effect)
        state = state.with_active((*state.active, best))
    tied = _confounded_labels(state, rest)
    return state, [_barred(e, CONFOUNDED_SENTENCE if e in tied else NOT_BETTER_HELD_BACK) for e in rest]


def frame_imitations(state: State, candidates: Sequence[Effect]) -> list[UntestableEffect]:
    """Deviations of labels that imitate the model's own columns: mostly frames that each label has to itself."""
    tied = _confounded_labels(state, candidates)
    return [UntestableEffect(f"{e.label}, moving {' '.join(e.motion)},", CONFOUNDED_SENTENCE) for e in tied]


def _confounded_labels(state: State, effects: Sequence[Effect]) -> list[Effect]:
    """Deviations of labels whose columns are sums of the model's own, whatever their prior."""
    of_labels = [e for e in effects if is_of_labels(e)]
    if not of_labels:
        return []
    Q = np.linalg.qr(state.whitened(state.design))[0]
    confounded = []
    for effect in of_labels:
        C = state.whitened(state.flat(state.model.columns(effect)))
        remainder = C - Q @ (Q.T @ C)
        if np.all(np.sum(remainder**2, axis=0) <= DEPENDENT_SHARE * np.sum(C**2, axis=0)):
            confounded.append(effect)
    return confounded


def _predicts_better(state: State, candidate: ActiveEffect) -> bool:
    """True if a candidate has evidence and predicts held-back rows better; constants by region in whole regions, too."""
    if candidate.score.gain <= 0.0 or candidate.score.freedom == 0:
        return False
    without, with_it = held_back_errors(state, candidate, state.fold).sum(axis=(1, 2))
    return bool(with_it < without) and held_out_whole(state, candidate) > 0.0


def _identifiable(state: State, effect: Effect) -> Effect:
    """A declared effect without coefficients whose columns are sums of the model's and of its own before them.

    A revolute joint's ``axis`` is one of its bearing's rotations: of both together the rows determine the sum alone. A prior
    of a smooth effect, or of the effect's size, tells its coefficients apart anyhow.
    """
    if effect.smooth or state.model.prior_of(effect):
        return effect
    identifiable: tuple[Coefficient, ...] = ()
    for coefficient in effect.coefficients:
        more = replace(effect, coefficients=(*identifiable, coefficient))
        if score_all(state.model, [more], state)[0].freedom > len(identifiable):
            identifiable = more.coefficients
    return replace(effect, coefficients=identifiable)


def _as_declared(state: State, effect: Effect) -> ActiveEffect:
    """A declared effect ready for the model, with the shape that suits the data if it is smooth."""
    return replace(activate(state, effect, score_of(state, effect)), declared=True)


def _barred(effect: Effect, why: str) -> UntestableEffect:
    return UntestableEffect(f"{effect.label}, which is declared,", why)
