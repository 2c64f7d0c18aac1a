"""Rivals: causes that the rows cannot tell from the named ones, how likely each is, and the model with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.corrections.basis import Basis, evaluate
from aridcal.engine.corrections.effect import ROW_ORDER, Coefficient, Effect
from aridcal.engine.corrections.labels import is_label
from aridcal.engine.corrections.loads import is_load
from aridcal.engine.corrections.regional_kind import is_of_labels
from aridcal.engine.corrections.sights import is_sight
from aridcal.engine.levels import STRONG
from aridcal.engine.search.evidence import Score
from aridcal.engine.search.linear_model import ActiveEffect
from aridcal.engine.search.ranking import is_small, rank, substitutes
from aridcal.engine.search.screening import score_without
from aridcal.engine.search.state import State, activate, noise_with, without_effect
from aridcal.system.progress import SILENT, Progress

RANKED_CANDIDATES = 12
"""Work: Candidates among which those confounded with an effect are sought."""

SIMILAR = 0.7
"""Correlation over the rows from which the same motion over another covariate is a rival: below it half of what the one explains
is left, which is more than the 3 nats of a tie of all that passes the gates."""


@dataclass(frozen=True)
class RivalModel:
    """One rival of an effect, and the model with it in the effect's place.

    Attributes:
        effect: The rival.
        instead_of: The effect that is named.
        weight: Its probability; those of the effect and all its rivals sum to 1.
        change: Difference of every coefficient from the model's, all solved anew; the effect's own become zero.
    """

    effect: Effect
    instead_of: Effect
    weight: float
    change: tuple[tuple[Coefficient, float], ...]


def twins(
    state: State, library: Sequence[Effect], progress: Progress = SILENT
) -> tuple[tuple[tuple[Effect, Score], ...], ...]:
    """For each effect: itself and the candidates of about as much evidence in its place; empty for effects not compared."""
    small = is_small(state.model, library)
    effects = [a.effect for a in state.active if small or not a.effect.smooth or is_of_labels(a.effect)]
    lasting = list(dict.fromkeys([*(e for e in library if e.at is None), *effects]))
    rough = score_without(state.model, lasting, state, effects, progress)
    return tuple(
        _twins(state, library, a, rough[a.effect], progress) if a.effect in rough else () for a in state.active
    )


def _twins(
    state: State,
    library: Sequence[Effect],
    named: ActiveEffect,
    rough: Mapping[Effect, Score],
    progress: Progress,
) -> tuple[tuple[Effect, Score], ...]:
    """An effect and the candidates of about as much evidence in its place, with their scores.

    Args:
        state: The model with the effect.
        library: Candidates.
        named: The effect.
        rough: Rough scores of candidates without it.
        progress: Called with the number of candidates scored.
    """
    without = without_effect(state, named.effect)
    rivals = substitutes(state, library, named.effect)
    also = [named.effect, *mirrored(state.model.table, named.effect)]
    ranked = rank(without, rivals, also=also, progress=progress, scores=rough)
    score = next((s for e, s in ranked if e == named.effect), None)
    if score is None:
        return ()
    name = (named.effect.kind, named.effect.where, named.effect.with_, named.effect.by)
    twins: dict[tuple[object, ...], tuple[Effect, Score]] = {}
    for rival, score_of_rival in ranked[:RANKED_CANDIDATES]:
        other = (rival.kind, rival.where, rival.with_, rival.by)
        if score_of_rival.gain > score.gain - STRONG and other != name:
            twins.setdefault(other, (rival, score_of_rival))
    return (named.effect, score), *twins.values()


def mirrored(table: Mapping[str, np.ndarray], effect: Effect) -> list[Effect]:
    """A step or slope again over each column that correlates with its covariate in these rows, a joint's reading perhaps."""
    first = effect.coefficients[0].basis
    if effect.smooth or first.form not in ("step", "linear") or len({c.basis for c in effect.coefficients}) > 1:
        return []
    reading = table[first.of[0]]
    values = evaluate(first, table)
    mirrors = []
    for name, column in table.items():
        if name in first.of or is_load(name) or is_sight(name) or is_label(name) or np.ptp(column) == 0.0:
            continue
        if name == ROW_ORDER and (first.form == "linear" or "time" in table):
            continue  # rows to come have no such order, and it correlates with the time
        basis = _basis_over(name, column, values, first.form)
        if abs(np.corrcoef(evaluate(basis, table), values)[0, 1]) > SIMILAR and not np.array_equal(column, reading):
            coefficients = tuple(replace(c, basis=basis) for c in effect.coefficients)
            mirrors.append(Effect(_kind_over(effect, name, first.form), effect.where, coefficients))
    return mirrors


def _basis_over(name: str, column: np.ndarray, values: np.ndarray, form: str) -> Basis:
    """The basis of a slope over a column, or of the step in it that correlates best with other values (N,)."""
    if form == "linear":
        return Basis(form, (name,), (round(float(column.mean()), 9),))
    order = np.argsort(column, kind="stable")
    n, total = np.arange(1, len(column)), np.cumsum(values[order] - values.mean())[:-1]
    ordered = column[order]
    there = ordered[1:] > ordered[:-1]
    size = np.where(there, total**2 / (n * (len(column) - n)), -1.0)
    k = int(np.argmax(size))
    return Basis(form, (name,), (float(0.5 * (ordered[k] + ordered[k + 1])),))


def _kind_over(effect: Effect, name: str, form: str) -> str:
    """Kind of an effect when it is over another column."""
    if name in ("time", ROW_ORDER):
        return "shift" if form == "step" else "drift"
    if name.startswith("temperature"):
        return "thermal" if form == "linear" else "unknown"
    if name == effect.where and effect.motion == ("axis",):
        return "joint_gain" if form == "linear" else "joint_map"
    return "unknown"


def rivals_of_effects(
    state: State, constants: Sequence[Coefficient], twins: Sequence[Sequence[tuple[Effect, Score]]]
) -> tuple[RivalModel, ...]:
    r"""Weights of the rivals of each effect, and the model with each of them.

    A cause is what an effect depends on. Causes are equally likely beforehand, and places of one cause, too: that a library lists
    twenty places for one and six for another says nothing. With the evidence g of each, in nat,

    .. math:: w_k \propto e^{\max_{f} g} \, e^{g_k} \Big/ \sum_{j \in f} e^{g_j}

    for rival k of the cause f (Hoeting et al. 1999, doi:10.1214/ss/1009212519; those far behind are left out: Occam's window).

    Args:
        state: The model as it is.
        constants: Its K constants.
        twins: Each effect, first, and its rivals; empty for effects not compared; see :func:`twins`.
    """
    return tuple(
        rival
        for a, rivals in zip(state.active, twins, strict=True)
        if len(rivals) > 1 and not a.declared and not a.effect.smooth
        for rival in _rivals(state, constants, a, rivals)
    )


def _rivals(
    state: State, constants: Sequence[Coefficient], named: ActiveEffect, twins: Sequence[tuple[Effect, Score]]
) -> Iterator[RivalModel]:
    """The rivals of one effect."""
    without, before = without_effect(state, named.effect), state.coefficients(constants)
    for (effect, score), weight in zip(twins[1:], weights(twins)[1:], strict=True):
        rival = activate(without, effect, score)
        with_it = without.with_active((*without.active, rival), noise_with(without, score), fixed=True)
        after = with_it.coefficients(constants)
        change = {c: after.get(c, 0.0) - before.get(c, 0.0) for c in (before | after)}
        yield RivalModel(effect, named.effect, weight, tuple((c, value) for c, value in change.items() if value != 0.0))


def weights(twins: Sequence[tuple[Effect, Score]]) -> list[float]:
    """Probabilities of an effect and its rivals, which sum to 1; see :func:`rivals_of_effects`."""
    gains = np.array([score.gain for _, score in twins])
    causes = [frozenset(effect.covariates) for effect, _ in twins]
    each = np.exp(gains - gains.max())
    likely = np.empty(len(each))
    for cause in set(causes):
        members = np.array([other == cause for other in causes])
        likely[members] = each[members].max() * each[members] / each[members].sum()
    return list((likely / likely.sum()).tolist())
