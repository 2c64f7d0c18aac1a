"""Effects that the campaign states: taken without trial, but for those that say themselves how large they are, if at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aridcal.engine.corrections.catalogue import KINDS, Barred
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.regional_kind import is_of_labels, widths
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.search.candidates import hinted
from aridcal.engine.search.change_points import best_steps
from aridcal.engine.search.curves import reshaped
from aridcal.engine.search.evidence import DEPENDENT
from aridcal.engine.search.linear_model import Active, LinearModel
from aridcal.engine.search.scoring import held_back, held_out_whole, judge, score_of
from aridcal.engine.search.screening import score_all
from aridcal.engine.search.sets import Choices
from aridcal.engine.search.state import State, activate, solve_state

CONFOUNDED = "it is confounded with what is fitted without it: no row tells them apart"
"""Why a declared effect was left out."""

NO_BETTER = "rows held back are predicted no better with it: the one model of the whole workspace stays"
"""Why a declared deviation from that model was left out."""


MOST_DENTS = 6
"""Work: Places at which targets are off that are found one by one, as many as other effects without a name."""


def with_declared(
    linear: LinearModel, stated: Sequence[Effect], sought: Sequence[bool], geometric: Fit
) -> tuple[State, list[Barred]]:
    """The model with the declared effects, which need no evidence; a step for which no row was said is sought.

    Those of which the rows tell nothing beside the constants, and the effects taken before, are left out and named, and so are
    those of their motions of which the rows tell nothing beside the others (:func:`_identifiable`); so are constants by region
    with which rows held back are predicted no better. Fields without a cause wait for :func:`with_fields`.
    """
    lost: list[Barred] = []
    state = solve_state(linear, (), geometric.sigma, ~geometric.outliers)
    waiting: list[Effect] = []
    # Curves last: shaped before others are in the model, one may do all that these do, and they would seem confounded with it.
    for effect, anywhere in sorted(zip(stated, sought, strict=True), key=lambda pair: pair[0].smooth):
        if KINDS[effect.kind].asked:
            waiting += [effect] if KINDS[effect.kind].named else []
            continue
        if anywhere and effect.at is not None:
            effect = next(iter(best_steps(linear, state, [effect])), effect)
        if score_all(linear, [effect], state)[0].freedom == 0:
            lost.append(_left_out(effect, CONFOUNDED))
            continue
        part = _identifiable(state, effect)
        mute = [c.name for c in effect.coefficients if c not in part.coefficients]
        lost += [Barred(f"{name}, of the declared {effect.label},", CONFOUNDED) for name in mute]
        state = state.with_active((*state.active, _admitted(state, part)))
    state, left_out = _with_regions(state, waiting)
    return reshaped(state, lambda a: a.stated), [*lost, *left_out]


def with_fields(state: State, stated: Sequence[Effect]) -> tuple[State, list[Barred]]:
    """The model with the declared fields of shifts that are worth it in what all else leaves: they could hide any cause."""
    fields = [e for e in stated if not KINDS[e.kind].named and KINDS[e.kind].asked]
    if not fields:
        return state, []
    for _ in range(MOST_DENTS):
        loud = hinted(state, {fields[0].kind})
        passed = [_admitted(state, e) for e in loud if not judge(state, e, score_of(state, e), Choices.of([e])).why]
        if not passed:
            break
        state = state.with_active((*state.active, *passed))
    dented = any(a.stated and a.effect.kind == fields[0].kind for a in state.active)
    state, lost = _with_regions(state, fields)
    return state, [] if dented else lost


def _with_regions(state: State, waiting: Sequence[Effect]) -> tuple[State, list[Barred]]:
    """Deviations by region that are worth it, the best first: what one of them hides is seen once that is in the model."""
    left = list(waiting)
    while left:
        tried = [(effect, _admitted(state, each)) for effect in left for each in widths(effect)]
        worth = [(effect, a) for effect, a in tried if _predicts_better(state, a)]
        if not worth:
            break
        effect, best = max(worth, key=lambda pair: pair[1].score.gain)
        left.remove(effect)
        state = state.with_active((*state.active, best))
    tied = _tied(state, left)
    return state, [_left_out(e, CONFOUNDED if e in tied else NO_BETTER) for e in left]


def tied_to_frames(state: State, candidates: Sequence[Effect]) -> list[Barred]:
    """Of deviations of labels those that the model does without: frames that each label has to itself, for the most part."""
    tied = _tied(state, candidates)
    return [Barred(f"{e.label}, moving {' '.join(e.motion)},", CONFOUNDED) for e in tied]


def _tied(state: State, effects: Sequence[Effect]) -> list[Effect]:
    """Deviations of labels of which nothing is left beside the model's own columns, whatever is believed of them beforehand."""
    own = [e for e in effects if is_of_labels(e)]
    if not own:
        return []
    Q = np.linalg.qr(state.whitened(state.design))[0]
    found = []
    for effect in own:
        C = state.whitened(state.flat(state.model.columns(effect)))
        left = C - Q @ (Q.T @ C)
        if np.all(np.sum(left**2, axis=0) <= DEPENDENT * np.sum(C**2, axis=0)):
            found.append(effect)
    return found


def _predicts_better(state: State, candidate: Active) -> bool:
    """True if there is evidence, and rows held back are predicted better, in regions held back whole where it speaks of them."""
    if candidate.score.gain <= 0.0 or candidate.score.freedom == 0:
        return False
    without, with_it = held_back(state, candidate, state.fold).sum(axis=(1, 2))
    return bool(with_it < without) and held_out_whole(state, candidate) > 0.0


def _identifiable(state: State, effect: Effect) -> Effect:
    """A declared effect without those coefficients that are sums of the model's columns and of its own before them.

    A revolute joint's ``axis`` is one of its bearing's rotations: of both together the rows tell the sum alone. What is
    believed beforehand of a smooth effect, or of its size, tells its coefficients apart anyhow.
    """
    if effect.smooth or state.model.prior_of(effect):
        return effect
    kept: tuple[Coefficient, ...] = ()
    for coefficient in effect.coefficients:
        more = replace(effect, coefficients=(*kept, coefficient))
        if score_all(state.model, [more], state)[0].freedom > len(kept):
            kept = more.coefficients
    return replace(effect, coefficients=kept)


def _admitted(state: State, effect: Effect) -> Active:
    """An effect that the campaign states, with the shape that suits the data if it is smooth."""
    return replace(activate(state, effect, score_of(state, effect)), stated=True)


def _left_out(effect: Effect, why: str) -> Barred:
    return Barred(f"{effect.label}, which is declared,", why)
