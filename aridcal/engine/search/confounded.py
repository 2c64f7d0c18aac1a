"""Causes that the rows cannot tell from those named: which they are, how likely each is, and what the model would be with it."""

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
from aridcal.engine.search.linear_model import Active
from aridcal.engine.search.ranking import in_place_of, is_small, rank
from aridcal.engine.search.screening import score_without
from aridcal.engine.search.state import State, activate, noise_with, without_effect
from aridcal.system.progress import SILENT, Progress

RANKED = 12
"""Work: Candidates among which those confounded with an effect are sought."""

SIMILAR = 0.7
"""Correlation over the rows from which the same motion over another covariate is a rival: below it half of what the one explains
is left, which is more than the 3 nats of a tie of all that passes the gates."""


@dataclass(frozen=True)
class Tied:
    """One rival of an effect, put in its place.

    Attributes:
        effect: The rival.
        instead_of: The effect that is named.
        weight: How likely it is, of the effect and all its rivals; these sum to 1.
        change: By how much every coefficient differs from the model's own, all others solved anew: those of the effect are gone.
    """

    effect: Effect
    instead_of: Effect
    weight: float
    change: tuple[tuple[Coefficient, float], ...]


def twins(
    state: State, library: Sequence[Effect], progress: Progress = SILENT
) -> tuple[tuple[tuple[Effect, Score], ...], ...]:
    """Each effect, and the candidates that would do about as well in its place; nothing where none are sought."""
    small = is_small(state.model, library)
    asked = [a.effect for a in state.active if small or not a.effect.smooth or is_of_labels(a.effect)]
    lasting = list(dict.fromkeys([*(e for e in library if e.at is None), *asked]))
    rough = score_without(state.model, lasting, state, asked, progress)
    return tuple(
        _twins(state, library, a, rough[a.effect], progress) if a.effect in rough else () for a in state.active
    )


def _twins(
    state: State,
    library: Sequence[Effect],
    mine: Active,
    rough: Mapping[Effect, Score],
    progress: Progress,
) -> tuple[tuple[Effect, Score], ...]:
    """One of the effects, and candidates that would do about as well in its place.

    Args:
        library: Candidates.
        state: The model with it.
        mine: The effect.
        rough: Scores of candidates without it.
        progress: Told how many are scored.
    """
    without = without_effect(state, mine.effect)
    rivals = in_place_of(state, library, mine.effect)
    also = [mine.effect, *mirrored(state.model.table, mine.effect)]
    ranked = rank(without, rivals, also=also, progress=progress, known=rough)
    own = next((s for e, s in ranked if e == mine.effect), None)
    if own is None:
        return ()
    name = (mine.effect.kind, mine.effect.where, mine.effect.with_, mine.effect.by)
    twins: dict[tuple[object, ...], tuple[Effect, Score]] = {}
    for effect, found in ranked[:RANKED]:
        other = (effect.kind, effect.where, effect.with_, effect.by)
        if found.gain > own.gain - STRONG and other != name:
            twins.setdefault(other, (effect, found))
    return (mine.effect, own), *twins.values()


def mirrored(table: Mapping[str, np.ndarray], mine: Effect) -> list[Effect]:
    """The same step or slope over each other column that goes with its covariate in these rows, a joint's reading perhaps."""
    first = mine.coefficients[0].basis
    if mine.smooth or first.form not in ("step", "linear") or len({c.basis for c in mine.coefficients}) > 1:
        return []
    own = table[first.of[0]]
    values = evaluate(first, table)
    found = []
    for name, column in table.items():
        if name in first.of or is_load(name) or is_sight(name) or is_label(name) or np.ptp(column) == 0.0:
            continue
        if name == ROW_ORDER and (first.form == "linear" or "time" in table):
            continue  # the order of rows to come says nothing, and goes with the time
        basis = _over(name, column, values, first.form)
        if abs(np.corrcoef(evaluate(basis, table), values)[0, 1]) > SIMILAR and not np.array_equal(column, own):
            moved = tuple(replace(c, basis=basis) for c in mine.coefficients)
            found.append(Effect(_kind(mine, name, first.form), mine.where, moved))
    return found


def _over(name: str, column: np.ndarray, values: np.ndarray, form: str) -> Basis:
    """A slope over a column, or the step in it that goes best with other values (N,)."""
    if form == "linear":
        return Basis(form, (name,), (round(float(column.mean()), 9),))
    order = np.argsort(column, kind="stable")
    n, total = np.arange(1, len(column)), np.cumsum(values[order] - values.mean())[:-1]
    ordered = column[order]
    there = ordered[1:] > ordered[:-1]
    size = np.where(there, total**2 / (n * (len(column) - n)), -1.0)
    k = int(np.argmax(size))
    return Basis(form, (name,), (float(0.5 * (ordered[k] + ordered[k + 1])),))


def _kind(mine: Effect, name: str, form: str) -> str:
    """What kind of effect goes with a column."""
    if name in ("time", ROW_ORDER):
        return "shift" if form == "step" else "drift"
    if name.startswith("temperature"):
        return "thermal" if form == "linear" else "unknown"
    if name == mine.where and mine.motion == ("axis",):
        return "joint_gain" if form == "linear" else "joint_map"
    return "unknown"


def tied(
    state: State, constants: Sequence[Coefficient], twins: Sequence[Sequence[tuple[Effect, Score]]]
) -> tuple[Tied, ...]:
    r"""Weights of the rivals of each effect, and the model with each of them.

    A cause is what an effect depends on. Causes are equally likely beforehand, and places of one cause, too: that a library lists
    twenty places for one and six for another says nothing. With the evidence g of each, in nat,

    .. math:: w_k \propto e^{\max_{f} g} \, e^{g_k} \Big/ \sum_{j \in f} e^{g_j}

    for rival k of the cause f (Hoeting et al. 1999, doi:10.1214/ss/1009212519; those far behind are left out: Occam's window).

    Args:
        state: The model as it is.
        constants: Its K constants.
        twins: For each effect itself, first, and its rivals; nothing where none were asked for.
    """
    return tuple(
        one
        for a, own in zip(state.active, twins, strict=True)
        if len(own) > 1 and not a.stated and not a.effect.smooth
        for one in _tied(state, constants, a, own)
    )


def _tied(
    state: State, constants: Sequence[Coefficient], mine: Active, twins: Sequence[tuple[Effect, Score]]
) -> Iterator[Tied]:
    """The rivals of one effect."""
    without, before = without_effect(state, mine.effect), state.coefficients(constants)
    for (effect, found), weight in zip(twins[1:], weights(twins)[1:], strict=True):
        rival = activate(without, effect, found)
        with_it = without.with_active((*without.active, rival), noise_with(without, found), fixed=True)
        after = with_it.coefficients(constants)
        change = {c: after.get(c, 0.0) - before.get(c, 0.0) for c in (before | after)}
        yield Tied(effect, mine.effect, weight, tuple((c, value) for c, value in change.items() if value != 0.0))


def weights(twins: Sequence[tuple[Effect, Score]]) -> list[float]:
    """How likely each of some effects is, see :func:`tied`; they sum to 1."""
    gains = np.array([found.gain for _, found in twins])
    causes = [frozenset(effect.covariates) for effect, _ in twins]
    each = np.exp(gains - gains.max())
    found = np.empty(len(each))
    for cause in set(causes):
        own = np.array([other == cause for other in causes])
        found[own] = each[own].max() * each[own] / each[own].sum()
    return list((found / found.sum()).tolist())
