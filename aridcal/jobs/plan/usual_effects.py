"""Effects that may be there: those that a campaign declares, two to be told apart, and those usual for its kind of robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from pydantic import ValidationError

from aridcal.engine.corrections.catalogue import KINDS, candidates, declared
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.effect_kind import Observed
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.covariate_table import look
from aridcal.files.campaign import EffectDeclaration
from aridcal.jobs.plan.beforehand import Beforehand
from aridcal.jobs.plan.configurations import Candidates
from aridcal.system.errors import CampaignError, nearest

USUAL = {
    "joint_harmonic": 5.0e-4,
    "joint_compliance": 5.0e-4,
    "joint_backlash": 2.0e-4,
    "rail_straightness": 1.0e-4,
    "rail_angular": 1.0e-4,
}
"""RMS motion, [rad] or [m], that is expected of each kind before anything was measured: what gears, bearings and rails of
industrial robots have after their maker's own calibration, to a factor of three."""

RAIL = {"rail_straightness", "rail_angular"}
"""Those of a joint that slides; the others are of a joint that turns."""

ORDERS = (1.0, 2.0)
"""Periods in a turn of the harmonics that eccentric gears and encoders make."""


def with_stated_effects(known: Beforehand, offered: Candidates) -> Beforehand:
    """The same with the effects that the campaign declares among what is identified; measured rows have them already.

    What depends on more than the joints (time, temperature) is not there to be planned with, and is named.
    """
    notices = []
    for declaration in () if len(known.rows) else known.campaign.effects:
        try:
            effect = _declared(known, declaration, str(known.campaign.path), offered)
        except CampaignError as error:
            notices.append(f"not planned for: {error}")
            continue
        known = known.with_coefficients(tuple(c for c in effect if c not in known.model.coefficients))
    return replace(known, notices=(*known.notices, *notices))


def with_pair(
    known: Beforehand, names: Sequence[str], offered: Candidates
) -> tuple[Beforehand, tuple[tuple[int, ...], ...]]:
    """The same with effects that are to be told apart among what is identified, and the numbers of each one's coefficients."""
    parts = []
    for name in names:
        effect = _effect(known, name, offered)
        known = known.with_coefficients(tuple(c for c in effect if c not in known.model.coefficients))
        parts.append(tuple(known.model.coefficients.index(c) for c in effect))
    return known, tuple(parts)


def both_sides(known: Beforehand) -> np.ndarray:
    """Joints that should come to their readings from both sides, as something may depend on that, shape (columns,) bool."""
    asked = {name for c in known.model.coefficients for name in c.basis.of}
    return np.array([f"{name}_direction" in asked for name in known.robot.readings])


def with_usual_effects(known: Beforehand, offered: Candidates) -> Beforehand:
    """The same with the effects usual for its kind of robot as suspects, each with a prior of its usual size.

    Suspects are of the kinds that the campaign would look for (`diagnosis`).

    Args:
        known: Without any.
        offered: What could be measured: an effect that these cannot show is no suspect.
    """
    diagnosis = known.campaign.diagnosis
    if not diagnosis.enabled:
        return known
    rows = offered.rows(known)
    observed = observed_by(known, rows)
    taken: dict[str, None] = {}
    for kind, coefficients in _usual(observed, set(diagnosis.candidates), str(known.campaign.path)):
        new = tuple(c for c in coefficients if c not in known.model.coefficients)
        wide = known.model.with_coefficients(new)
        phi = rows_of_data(wide, rows).phi
        size = np.sqrt(np.mean(phi**2, axis=0))
        known = known.with_coefficients(new, USUAL[kind] / np.where(size > 0.0, size, 1.0))
        taken[kind] = None
    notice = (
        f"nothing was measured yet: planned for effects that such arms usually have beside constants ({', '.join(taken)}); "
        "`effects` of the campaign says which yours may have, `diagnosis: {enabled: false}` that it has none"
    )
    return replace(known, notices=(*known.notices, notice)) if taken else known


def _usual(observed: Observed, kinds: set[str], place: str) -> Iterator[tuple[str, tuple[Coefficient, ...]]]:
    """Kind and coefficients of each suspect."""
    for joint in observed.robot.joints:
        if not joint.drive.factors:
            continue
        if joint.kind == "prismatic":
            for kind in sorted(RAIL & kinds):
                yield kind, _bends(observed, joint.name, kind)
            continue
        for declaration in _of_gear(joint.name):
            if declaration.kind in kinds:
                try:
                    yield declaration.kind, declared(observed, declaration, place).coefficients
                except CampaignError:  # these rows cannot show it: a load that never changes, for instance
                    continue


def _of_gear(name: str) -> Iterator[EffectDeclaration]:
    """What a joint with a gear may have."""
    yield EffectDeclaration(kind="joint_harmonic", where=name, order=ORDERS)
    yield EffectDeclaration(kind="joint_compliance", where=name)
    yield EffectDeclaration(kind="joint_backlash", where=name, by="direction")


def _bends(observed: Observed, name: str, kind: str) -> tuple[Coefficient, ...]:
    """The polynomials of a rail in all their motions: few coefficients, where its whole curve would have a hundred."""
    own = (c for effect in candidates(observed, (kind,)) if effect.where == name for c in effect.coefficients)
    return tuple(dict.fromkeys(c for c in own if c.basis.form == "power"))


def _effect(known: Beforehand, name: str, offered: Candidates) -> tuple[Coefficient, ...]:
    """Coefficients of an effect called ``WHERE.KIND``: as the campaign declares it, or as the kind has it.

    Raises:
        CampaignError: there is no such effect.
    """
    where, _, kind = name.rpartition(".")
    if not where or kind not in KINDS:
        raise CampaignError(
            f"--apart {name}: should be WHERE.KIND, joint_2.joint_gain for instance{nearest(kind, KINDS)}"
        )
    stated = [d for d in known.campaign.effects if (d.where, d.kind) == (where, kind)]
    try:
        declaration = stated[0] if stated else EffectDeclaration(kind=kind, where=where)
    except ValidationError as error:
        why = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise CampaignError(f"--apart {name}: {why}; declare it under `effects` of {known.campaign.path}") from None
    return _declared(known, declaration, f"--apart {name}", offered)


def _declared(
    known: Beforehand, declaration: EffectDeclaration, place: str, offered: Candidates
) -> tuple[Coefficient, ...]:
    """Coefficients of an effect, as candidates could show them."""
    return declared(observed_by(known, offered.rows(known)), declaration, place).coefficients


def observed_by(known: Beforehand, rows: Dataset) -> Observed:
    """What effects can be made from, by some rows."""
    return look(known.model.with_coefficients(()), rows)[0]
