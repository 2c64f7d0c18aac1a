"""Causes that the rows cannot tell from those named: how likely each is, and what the model would be with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.effects.basis import Basis, evaluate
from aridcal.effects.effect import ROW_ORDER, Coefficient, Effect
from aridcal.effects.labels import is_label
from aridcal.effects.loads import is_load
from aridcal.effects.sights import is_sight
from aridcal.search.evidence import Score
from aridcal.search.linear_model import Active
from aridcal.search.state import State, activate, noise_with, without_effect

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
    without, before = without_effect(state, mine.effect), _coefficients(state, constants)
    for (effect, found), weight in zip(twins[1:], weights(twins)[1:], strict=True):
        rival = activate(without, effect, found)
        with_it = without.with_active((*without.active, rival), noise_with(without, found), fixed=True)
        after = _coefficients(with_it, constants)
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


def _coefficients(state: State, constants: Sequence[Coefficient]) -> dict[Coefficient, float]:
    """A solution by its coefficients."""
    first, *others = state.places
    found = dict(zip(constants, state.solution.beta[first].tolist(), strict=True))
    for a, own in zip(state.active, others, strict=True):
        values = (a.modes @ state.solution.beta[own]).tolist()
        found |= dict(zip(a.effect.coefficients, values, strict=True))
    return found
