"""The kind that stands in where no cause is known: any motion as a smooth function of any one or two covariates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import ANGULAR, FRAME_COMPONENTS, Coefficient, Effect
from aridcal.engine.corrections.effect_kind import EffectKind, ObservedRows, knots_over
from aridcal.engine.robot.chain import Joint

KNOTS = 9
"""Of a smooth function of one covariate: few, since hundreds of such functions are tried."""

PAIR_KNOTS = 5
"""Along each of two covariates: (5 + 2)^2 coefficients."""

ALONG = 0.99
"""Cosine of the angle (8 deg) within which a frame's axis counts as the joint's own."""


def _unknown(rows: ObservedRows) -> Iterator[Effect]:
    """Any motion of any joint or of the target, each as a smooth function of any column, or any reading on the joint's limb."""
    # The same bases for all motions: a thousand effects are made of them, and compared.
    curves = {name: knots_over(name, rows.table[name], KNOTS) for name in rows.varying()}
    for j in rows.robot.joints:
        near = {name: bases for name, bases in curves.items() if rows.robot.on_one_limb(j.name, name)}
        for component in FRAME_COMPONENTS:
            for name, bases in near.items():
                if not (name == j.name and _drives(j, component)):  # that is a joint_map
                    yield _curve(j.name, component, bases)
    for component in FRAME_COMPONENTS:
        for bases in curves.values():
            yield _curve("tip_target", component, bases)


def _curve(where: str, component: str, bases: Iterable[Basis]) -> Effect:
    return Effect("unknown", where, tuple(Coefficient(where, component, basis) for basis in bases), smooth=True)


def _drives(joint: Joint, component: str) -> bool:
    """True for the motion of a frame that the joint itself makes."""
    along = abs(joint.axis[FRAME_COMPONENTS.index(component) % 3])
    return along > ALONG and (component in ANGULAR) == (joint.kind == "revolute")


def pair(rows: ObservedRows, where: str, component: str, of: tuple[str, str]) -> Effect:
    """A motion as a smooth function of two covariates at once: products of B-splines on a grid of knots."""
    low = [float(rows.table[name].min()) for name in of]
    step = [float(np.ptp(rows.table[name])) / (PAIR_KNOTS - 1) for name in of]
    along = [[low[k] + i * step[k] for i in range(-1, PAIR_KNOTS + 1)] for k in (0, 1)]
    bases = [Basis("bump2", of, (u, step[0], v, step[1])) for u, v in product(*along)]
    coefficients = tuple(Coefficient(where, component, basis) for basis in bases)
    return Effect("unknown", where, coefficients, smooth=True, grid=(PAIR_KNOTS + 2,) * 2)


UNKNOWN = EffectKind(
    "unknown",
    where="a joint or `tip_target`",
    words="something repeatable that no kind of effect explains",
    bases=("bump", "bump2"),
    example="{kind: unknown, where: joint_2, motion: yaw, covariates: joint_4}",
    doc="unknown",
    testable=_unknown,
    columns=lambda d: d.covariates or (),
    curve=("axis", "t1", "t2", "r1", "r2", *FRAME_COMPONENTS),
    named=False,
)
