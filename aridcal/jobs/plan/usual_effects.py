"""Effects that may be there: those that a campaign declares, two to be told apart, and those usual for its kind of robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from pydantic import ValidationError

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, candidates, declared
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.covariate_table import covariates_and_exclusions
from aridcal.files.campaign import EffectDeclaration
from aridcal.jobs.plan.configurations import Candidates
from aridcal.jobs.plan.prior_knowledge import PlanSetup
from aridcal.system.errors import CampaignError, nearest

USUAL_MOTIONS = {
    "joint_harmonic": 5.0e-4,
    "joint_compliance": 5.0e-4,
    "joint_backlash": 2.0e-4,
    "rail_straightness": 1.0e-4,
    "rail_angular": 1.0e-4,
}
"""RMS motion, [rad] or [m], that is expected of each kind before anything was measured: what gears, bearings and rails of
industrial robots have after their maker's own calibration, to a factor of three."""

RAIL_KINDS = {"rail_straightness", "rail_angular"}
"""Those of a joint that slides; the others are of a joint that turns."""

HARMONIC_ORDERS = (1.0, 2.0)
"""Periods in a turn of the harmonics that eccentric gears and encoders make."""


def with_stated_effects(setup: PlanSetup, pool: Candidates) -> PlanSetup:
    """The setup with the effects that the campaign declares; with measured rows they are in it already.

    Effects that depend on more than the joints (time, temperature) cannot be planned for, and become notices.
    """
    notices = []
    for declaration in () if len(setup.rows) else setup.campaign.effects:
        try:
            effect = _declared(setup, declaration, str(setup.campaign.path), pool)
        except CampaignError as error:
            notices.append(f"not planned for: {error}")
            continue
        setup = setup.with_coefficients(tuple(c for c in effect if c not in setup.model.coefficients))
    return replace(setup, notices=(*setup.notices, *notices))


def with_pair(
    setup: PlanSetup, names: Sequence[str], pool: Candidates
) -> tuple[PlanSetup, tuple[tuple[int, ...], ...]]:
    """The setup with effects that are to be told apart, and the indices of each one's coefficients."""
    parts = []
    for name in names:
        effect = _effect(setup, name, pool)
        setup = setup.with_coefficients(tuple(c for c in effect if c not in setup.model.coefficients))
        parts.append(tuple(setup.model.coefficients.index(c) for c in effect))
    return setup, tuple(parts)


def both_sides(setup: PlanSetup) -> np.ndarray:
    """Joints that should come to their readings from both sides, as something may depend on that, shape (columns,) bool."""
    covariates = {name for c in setup.model.coefficients for name in c.basis.of}
    return np.array([f"{name}_direction" in covariates for name in setup.robot.readings])


def with_usual_effects(setup: PlanSetup, pool: Candidates) -> PlanSetup:
    """The setup with the effects usual for its kind of robot as suspects, each with a prior of its usual size.

    Suspects are of the kinds that the campaign would look for (`diagnosis`).

    Args:
        setup: Without any.
        pool: What could be measured: an effect that these cannot show is no suspect.
    """
    diagnosis = setup.campaign.diagnosis
    if not diagnosis.enabled:
        return setup
    rows = pool.rows(setup)
    observed = observed_rows(setup, rows)
    planned: dict[str, None] = {}
    for kind, coefficients in _usual(observed, set(diagnosis.candidates), str(setup.campaign.path)):
        added = tuple(c for c in coefficients if c not in setup.model.coefficients)
        wide = setup.model.with_coefficients(added)
        phi = rows_of_data(wide, rows).phi
        size = np.sqrt(np.mean(phi**2, axis=0))
        setup = setup.with_coefficients(added, USUAL_MOTIONS[kind] / np.where(size > 0.0, size, 1.0))
        planned[kind] = None
    notice = (
        f"nothing was measured yet: planned for effects that such arms usually have beside constants ({', '.join(planned)}); "
        "`effects` of the campaign says which yours may have, `diagnosis: {enabled: false}` that it has none"
    )
    return replace(setup, notices=(*setup.notices, notice)) if planned else setup


def _usual(observed: ObservedRows, kinds: set[str], place: str) -> Iterator[tuple[str, tuple[Coefficient, ...]]]:
    """Kind and coefficients of each suspect."""
    for joint in observed.robot.joints:
        if not joint.drive.factors:
            continue
        if joint.kind == "prismatic":
            for kind in sorted(RAIL_KINDS & kinds):
                yield kind, _bends(observed, joint.name, kind)
            continue
        for declaration in _of_gear(joint.name):
            if declaration.kind in kinds:
                try:
                    yield declaration.kind, declared(observed, declaration, place).coefficients
                except CampaignError:  # these rows cannot show it: a load that never changes, for instance
                    continue


def _of_gear(name: str) -> Iterator[EffectDeclaration]:
    """Effects of a joint with a gear."""
    yield EffectDeclaration(kind="joint_harmonic", where=name, order=HARMONIC_ORDERS)
    yield EffectDeclaration(kind="joint_compliance", where=name)
    yield EffectDeclaration(kind="joint_backlash", where=name, by="direction")


def _bends(observed: ObservedRows, name: str, kind: str) -> tuple[Coefficient, ...]:
    """Coefficients of a rail's polynomials in all their motions: few, where its whole curve would have a hundred."""
    of_rail = (c for effect in candidates(observed, (kind,)) if effect.where == name for c in effect.coefficients)
    return tuple(dict.fromkeys(c for c in of_rail if c.basis.form == "power"))


def _effect(setup: PlanSetup, name: str, pool: Candidates) -> tuple[Coefficient, ...]:
    """Coefficients of an effect called ``WHERE.KIND``: as the campaign declares it, or as the kind has it.

    Raises:
        CampaignError: there is no such effect.
    """
    where, _, kind = name.rpartition(".")
    if not where or kind not in EFFECT_KINDS:
        raise CampaignError(
            f"--apart {name}: should be WHERE.KIND, joint_2.joint_gain for instance{nearest(kind, EFFECT_KINDS)}"
        )
    stated = [d for d in setup.campaign.effects if (d.where, d.kind) == (where, kind)]
    try:
        declaration = stated[0] if stated else EffectDeclaration(kind=kind, where=where)
    except ValidationError as error:
        reason = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise CampaignError(f"--apart {name}: {reason}; declare it under `effects` of {setup.campaign.path}") from None
    return _declared(setup, declaration, f"--apart {name}", pool)


def _declared(
    setup: PlanSetup, declaration: EffectDeclaration, place: str, pool: Candidates
) -> tuple[Coefficient, ...]:
    """Coefficients of a declared effect, made from the pool's configurations."""
    return declared(observed_rows(setup, pool.rows(setup)), declaration, place).coefficients


def observed_rows(setup: PlanSetup, rows: Dataset) -> ObservedRows:
    """Covariates of some rows, from which effects can be made."""
    return covariates_and_exclusions(setup.model.with_coefficients(()), rows)[0]
