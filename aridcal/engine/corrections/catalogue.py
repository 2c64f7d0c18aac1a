"""The table of kinds, and the effects that it gives: those that some rows can test, and those that a campaign declares."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.camera_sonar_kinds import CAMERA_SONAR_KINDS
from aridcal.engine.corrections.condition_kinds import CONDITION_KINDS
from aridcal.engine.corrections.effect import ROW_ORDER, Effect
from aridcal.engine.corrections.effect_kind import Declaration, EffectKind, ObservedRows
from aridcal.engine.corrections.instrument_kinds import INSTRUMENT_KINDS
from aridcal.engine.corrections.joint_kinds import JOINT_KINDS
from aridcal.engine.corrections.labels import LABEL_COLUMN, MOST_LABELS
from aridcal.engine.corrections.regional_kind import REGIONAL, RESIDUAL_FIELD
from aridcal.engine.corrections.unknown_kind import UNKNOWN
from aridcal.system.errors import CampaignError, nearest

_ROWS = (*JOINT_KINDS, *CONDITION_KINDS, *INSTRUMENT_KINDS, *CAMERA_SONAR_KINDS, REGIONAL, RESIDUAL_FIELD, UNKNOWN)

EFFECT_KINDS: dict[str, EffectKind] = {kind.name: kind for kind in _ROWS}
"""Every kind of effect, in the order in which they are tried: the only list of them."""

CONSTANT_COLUMN = 1e-9
"""Work: A column that changes by a smaller share of its largest value (of 1, if that is less) is constant."""


@dataclass(frozen=True)
class UntestableEffect:
    """A candidate that these data cannot test, and why."""

    what: str
    why: str


def is_of_head(kind: str) -> bool:
    """True for a kind of the measuring head."""
    return EFFECT_KINDS[kind].of_head != ""


def usable_columns(columns: Mapping[str, np.ndarray]) -> tuple[tuple[str, ...], list[UntestableEffect]]:
    """Measured columns that effects may depend on, and why the others may not."""
    good, barred = [], []
    for name, values in columns.items():
        empty = int(np.isnan(values).sum())
        if empty:
            barred.append(UntestableEffect(f"effects of {name}", f"the column has {empty} empty cells"))
        elif np.ptp(values) <= CONSTANT_COLUMN * max(1.0, float(np.abs(values).max())):
            barred.append(UntestableEffect(f"effects of {name}", "the column is constant"))
        else:
            good.append(name)
    return tuple(good), barred


def barred_joints(rows: ObservedRows) -> list[UntestableEffect]:
    """Joints whose own effects cannot be tested."""
    still = [j.name for j in rows.robot.joints if not rows.moves(j)]
    barred = [UntestableEffect(f"effects of {name}'s reading", "the joint never moves") for name in still]
    loads = [values for name, values in rows.table.items() if ".gravity_" in name]
    if not loads:
        why = f"the column {' or '.join(rows.masses)} has empty cells"
        barred.append(UntestableEffect("compliance and load-side backlash", why))
    elif not (np.any(loads) or any(rows.robot.mass_beyond > 0)):
        barred.append(UntestableEffect("compliance and load-side backlash", "the URDF has no masses beyond any joint"))
    return barred


def candidates(rows: ObservedRows, kinds: Iterable[str]) -> list[Effect]:
    """All effects of some kinds that these rows can test."""
    return [effect for kind in kinds for effect in EFFECT_KINDS[kind].testable(rows)]


def declared(rows: ObservedRows, declaration: Declaration, place: str) -> Effect:
    """The effect that a campaign states.

    Args:
        rows: What it may depend on.
        declaration: What is stated.
        place: The file, for the message.

    Raises:
        CampaignError: there is no such effect on this robot or with these columns.
    """
    d, kind = declaration, EFFECT_KINDS[declaration.kind]
    places = (*rows.robot.names, "world_base", "tip_target", *(name for _, name in rows.stated_components))
    if d.where not in places:
        raise CampaignError(
            f"{place}: effects: no place {d.where!r}{nearest(d.where, places)}; {d.kind} acts at {kind.where}"
        )
    if kind.of_head and d.where in {name for _, name in rows.stated_components}:
        return _at_thing(rows, d, place)
    if kind.of_order and d.order:
        effects = [effect for order in d.order for effect in kind.of_order(d, order)]
    elif kind.of_declaration:
        effects = list(kind.of_declaration(rows, d))
    else:
        fitting = [effect for effect in _with_motions(candidates(rows, (d.kind,)), d) if _agrees(effect, d)]
        curves = [effect for effect in fitting if effect.smooth]  # they hold what the others can
        effects = curves or fitting
        effects = effects[:1] if kind.exclusive else effects
    if not effects and d.by == LABEL_COLUMN and len(rows.labels) < 2:
        raise CampaignError(
            f"{place}: effects: {d.kind} at {d.where} by {LABEL_COLUMN} needs a column `{LABEL_COLUMN}` with 2 to "
            f"{MOST_LABELS} different "
            "labels; name it under measurements.columns"
        )
    if not effects:
        raise CampaignError(
            f"{place}: effects: {d.kind} at {d.where} cannot be fitted: this robot or these columns have nothing that "
            "it could depend on; check its keys"
        )
    effect = merged(effects)
    return effect if d.at is None else _at_moment(rows, effect, d, place)


def _at_thing(rows: ObservedRows, d: Declaration, place: str) -> Effect:
    """The effect that a campaign states of an instrument: with the components that it names, or else the first that may be.

    Raises:
        CampaignError: it has no such effect, or no such component.
    """
    every = candidates(rows, (d.kind,))
    at_place = [effect for effect in every if effect.where == d.where]
    if not at_place:
        places = sorted({effect.where for effect in every})
        raise CampaignError(f"{place}: effects: {d.kind} has no place {d.where!r}{nearest(d.where, places)}")
    if d.motion is None:
        return at_place[0]
    by_component = {c.component: c for effect in at_place for c in effect.coefficients}
    for component in d.motion:
        if component not in by_component:
            raise CampaignError(
                f"{place}: effects: {d.kind} at {d.where} has no {component!r}{nearest(component, by_component)}"
            )
    return replace(at_place[0], coefficients=tuple(by_component[component] for component in d.motion))


def _at_moment(rows: ObservedRows, effect: Effect, d: Declaration, place: str) -> Effect:
    """An effect whose step is at the row or time that a declaration gives.

    Raises:
        CampaignError: there is no such column, or all rows are on one side of it.
    """
    of, key = ("time", "time") if d.at.row is None else (ROW_ORDER, "row")
    if of != ROW_ORDER and of not in rows.measured:
        raise CampaignError(
            f"{place}: effects: {d.kind} at {d.where}: at.time: no complete column `time`; say the row: `at: {{row: LINE}}`"
        )
    before = int(np.sum(rows.table[of] < d.at.number))
    if before in (0, len(rows.table[of])):
        low, high = (f"{v:.12g}" for v in (rows.table[of].min(), rows.table[of].max()))
        raise CampaignError(
            f"{place}: effects: {d.kind} at {d.where}: at.{key}: no fitted row is {'after' if before else 'before'} it: "
            f"their {of} is from {low} to {high}"
        )
    basis = Basis("step", (of,), (d.at.number,))
    return replace(effect, coefficients=tuple(replace(c, basis=basis) for c in effect.coefficients))


def _with_motions(effects: Sequence[Effect], d: Declaration) -> list[Effect]:
    """Effects with the motions alone that a declaration names, where one effect has all motions, as a step does."""
    if d.motion is None:
        return list(effects)
    named = [(e, tuple(c for c in e.coefficients if e.at is None or c.component in d.motion)) for e in effects]
    return [replace(e, coefficients=coefficients) for e, coefficients in named if coefficients]


def _agrees(effect: Effect, d: Declaration) -> bool:
    """True if an effect agrees with all that a declaration says."""
    return (
        effect.where == d.where
        and (d.with_ is None or effect.with_ == d.with_)
        and (d.by is None or effect.by == d.by)
        and (d.motion is None or set(effect.motion) <= set(d.motion))
        and (d.covariates is None or set(effect.covariates) <= set(d.covariates))
    )


def merged(effects: Sequence[Effect]) -> Effect:
    """Effects of one kind and place as one, each coefficient once."""
    coefficients = tuple(dict.fromkeys(c for e in effects for c in e.coefficients))
    order = tuple(dict.fromkeys(k for e in effects for k in e.order))
    return replace(effects[0], coefficients=coefficients, order=order)


def kinds_table() -> str:
    """The table of kinds as Markdown, as ``docs/effects.md`` shows it."""
    head = "| kind | acts at | what it is | functions | declared by |\n|---|---|---|---|---|\n"
    rows = [
        (f"[`{k.name}`](#{k.doc})", k.where, k.words, ", ".join(f"`{form}`" for form in k.bases), f"`{k.example}`")
        for k in EFFECT_KINDS.values()
    ]
    return head + "".join(f"| {' | '.join(row)} |\n" for row in rows)


if __name__ == "__main__":
    print(kinds_table(), end="")
