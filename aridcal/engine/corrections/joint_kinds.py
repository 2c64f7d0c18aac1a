"""Kinds of effects of a joint, its bearing or its rail, by its own reading, by another's or by gravity's load."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import (
    Declaration,
    EffectKind,
    ObservedRows,
    bumps,
    rounded_mean,
    slope,
    turns,
)
from aridcal.engine.corrections.loads import bearing_components
from aridcal.engine.levels import SLIGHT
from aridcal.engine.robot.chain import Joint

ORDERS = (1.0, 2.0, 3.0, 4.0)
"""Periods per turn that a shaft, a bearing or a disk is most likely to have."""

WOBBLES = (1.0, 2.0)
"""Periods per turn of an axis: once where it is out of square, twice where its race is oval."""

BENDS = (1.0, 2.0, 3.0, 4.0)
"""Powers of the travel in which a rail bends: tilt, sag, twist."""

WAVES = (0.5, 1.0, 2.0)
"""Periods of a wave over the travel seen."""

RAIL_POWERS = (1.0, 2.0)
"""Of a rail's travel, for what bends the more the further it is out."""

MAP_KNOTS = 72
"""Of a joint's error curve: over a full turn, waves of up to 30 periods."""

RAIL_KNOTS = 16
"""Of a rail: bends as short as an eighth of its travel."""

ACROSS = ("r1", "r2", "t1", "t2")
"""Motions of an axis: it tilts or it runs out."""


def _joint_gain(rows: ObservedRows) -> Iterator[Effect]:
    """Difference q - mean(q), about the joint's own axis."""
    for j in rows.moving():
        gain = slope(j.name, "axis", j.name, rounded_mean(rows.table[j.name]))
        yield Effect("joint_gain", j.name, (gain,))


def _joint_harmonic(rows: ObservedRows) -> Iterator[Effect]:
    """sin(k q) and cos(k q) for each likely order k, and for the first two together."""
    for j in rows.moving("revolute"):
        for order in ORDERS:
            yield Effect("joint_harmonic", j.name, turns(j.name, "axis", j.name, order), order=(order,))
        first, second = ORDERS[:2]
        both = turns(j.name, "axis", j.name, first) + turns(j.name, "axis", j.name, second)
        yield Effect("joint_harmonic", j.name, both, order=(first, second))


def _harmonic_of_order(d: Declaration, order: float) -> Iterator[Effect]:
    """sin(k q) and cos(k q) for one order k, that of a gear for instance."""
    yield Effect(d.kind, d.where, turns(d.where, "axis", d.where, order), (order,))


def _joint_map(rows: ObservedRows) -> Iterator[Effect]:
    """A smooth function of q, about the joint's own axis."""
    for j in rows.moving():
        curve = bumps(j.name, "axis", j.name, rows.table[j.name], MAP_KNOTS)
        yield Effect("joint_map", j.name, curve, smooth=True)


def _joint_backlash(rows: ObservedRows) -> Iterator[Effect]:
    """The side of approach, -1 or 1, or the sign of gravity's torque where it takes either."""
    for j in rows.robot.joints:
        direction, load = f"{j.name}_direction", f"{j.name}.gravity_torque"
        if direction in rows.table:
            yield Effect("joint_backlash", j.name, (slope(j.name, "axis", direction),), by="direction")
        if load in rows.table and np.ptp(np.sign(rows.table[load])) > 0:
            flank = Coefficient(j.name, "axis", Basis("sign", (load,)))
            yield Effect("joint_backlash", j.name, (flank,), by="load")


def _joint_compliance(rows: ObservedRows) -> Iterator[Effect]:
    """Gravity's torque (force, if prismatic), about the joint's own axis."""
    for j in rows.robot.joints:
        load = f"{j.name}.gravity_torque"
        if rows.load_changes(load):
            yield Effect("joint_compliance", j.name, (slope(j.name, "axis", load),))


def _bearing_compliance(rows: ObservedRows) -> Iterator[Effect]:
    """Each rotation that a joint does not drive under its own moment; a rail's also times powers of its travel."""
    for j in rows.robot.joints:
        travels = j.kind == "prismatic" and rows.moves(j)
        together: list[Coefficient] = []
        for component in bearing_components(j.kind):
            load = f"{j.name}.gravity_moment_{component}"
            if load not in rows.table or not np.any(np.abs(rows.table[load]) > SLIGHT):
                continue
            tilts = [slope(j.name, component, load)]
            if travels:
                tilts += _tilts_with_travel(rows, j, component, load)
            yield Effect("bearing_compliance", j.name, (tilts[0],))
            if travels:
                yield Effect("bearing_compliance", j.name, tuple(tilts))
            together += tilts
        if len(together) > 1:
            yield Effect("bearing_compliance", j.name, tuple(together))


def _tilts_with_travel(rows: ObservedRows, rail: Joint, component: str, load: str) -> list[Coefficient]:
    """A load times powers of a rail's travel, as a share of its largest."""
    largest = float(np.abs(rows.table[rail.name]).max())
    bases = [Basis("times_power", (load, rail.name), (0.0, largest, power)) for power in RAIL_POWERS]
    return [Coefficient(rail.name, component, basis) for basis in bases]


def _axis_wobble(rows: ObservedRows) -> Iterator[Effect]:
    """sin(k q) and cos(k q) of tilt and of runout: each direction by itself, both, and all four."""
    for j in rows.moving("revolute"):
        for order in WOBBLES:
            wave = {c: turns(j.name, c, j.name, order) for c in ACROSS}
            for a, b in (("r1", "r2"), ("t1", "t2")):
                for coefficients in (wave[a], wave[b], wave[a] + wave[b]):
                    yield Effect("axis_wobble", j.name, coefficients, order=(order,))
            every = wave["r1"] + wave["r2"] + wave["t1"] + wave["t2"]
            yield Effect("axis_wobble", j.name, every, order=(order,))


def _wobble_of_order(d: Declaration, order: float) -> Iterator[Effect]:
    """sin(k q) and cos(k q) of the motions stated, or of all four."""
    for component in d.motion or ACROSS:
        yield Effect(d.kind, d.where, turns(d.where, component, d.where, order), (order,))


def _rail(kind: str, components: tuple[str, ...]) -> Callable[[ObservedRows], Iterator[Effect]]:
    """Functions of a rail's travel: a smooth one, polynomials of rising degree, and waves."""

    def of_travel(rows: ObservedRows) -> Iterator[Effect]:
        for j in rows.moving("prismatic"):
            travel = rows.table[j.name]
            centre, half = float(travel.min() + travel.max()) / 2, float(np.ptp(travel)) / 2
            for component in components:
                yield Effect(kind, j.name, bumps(j.name, component, j.name, travel, RAIL_KNOTS), smooth=True)
                bases = [Basis("power", (j.name,), (centre, half, power)) for power in BENDS]
                bends = tuple(Coefficient(j.name, component, basis) for basis in bases)
                for degree in range(1, len(bends) + 1):
                    yield Effect(kind, j.name, bends[:degree])
                for periods in WAVES:
                    yield Effect(kind, j.name, turns(j.name, component, j.name, periods * np.pi / half))

    return of_travel


def _joint_coupling(rows: ObservedRows) -> Iterator[Effect]:
    """Each joint by the reading of each other one that moves, on the same limb."""
    for j in rows.robot.joints:
        for other in rows.moving():
            if other.name != j.name and rows.robot.on_one_limb(j.name, other.name):
                led = slope(j.name, "axis", other.name, rounded_mean(rows.table[other.name]))
                yield Effect("joint_coupling", j.name, (led,), with_=other.name)


JOINT_KINDS = (
    EffectKind(
        "joint_gain",
        where="a joint",
        words="the joint turns by more or less than it reads",
        bases=("linear",),
        example="{kind: joint_gain, where: joint_2}",
        doc="joint_gain",
        testable=_joint_gain,
    ),
    EffectKind(
        "joint_harmonic",
        where="a revolute joint",
        words="an error that comes round with each turn of a shaft or disk",
        bases=("sin", "cos"),
        example="{kind: joint_harmonic, where: joint_2, order: [1, 80.5]}",
        doc="joint_harmonic",
        testable=_joint_harmonic,
        of_order=_harmonic_of_order,
        exclusive=True,
    ),
    EffectKind(
        "joint_map",
        where="a joint",
        words="an error of the joint's own reading, as of an encoder or gear",
        bases=("bump",),
        example="{kind: joint_map, where: joint_2}",
        doc="joint_map",
        testable=_joint_map,
        curve=("axis",),
        holds=frozenset({"joint_gain", "joint_harmonic"}),
    ),
    EffectKind(
        "joint_backlash",
        where="a joint",
        words="play that is taken up on one side or the other",
        bases=("linear", "sign"),
        example="{kind: joint_backlash, where: joint_2, by: load}",
        doc="joint_backlash",
        testable=_joint_backlash,
        key="by",
        bys=("direction", "load"),
        exclusive=True,
        columns=lambda d: (f"{d.where}_direction",) if d.by == "direction" else (),
    ),
    EffectKind(
        "joint_compliance",
        where="a joint",
        words="the joint yields under the weight beyond it",
        bases=("linear",),
        example="{kind: joint_compliance, where: joint_3}",
        doc="joint_compliance",
        testable=_joint_compliance,
    ),
    EffectKind(
        "bearing_compliance",
        where="a joint",
        words="the bearing tilts under the weight beyond it",
        bases=("linear", "times_power"),
        example="{kind: bearing_compliance, where: joint_2, motion: [r1, r2]}",
        doc="bearing_compliance",
        testable=_bearing_compliance,
    ),
    EffectKind(
        "axis_wobble",
        where="a revolute joint",
        words="the axis itself wanders as the joint turns",
        bases=("sin", "cos"),
        example="{kind: axis_wobble, where: joint_1, order: 1, motion: [r1, r2]}",
        doc="axis_wobble",
        testable=_axis_wobble,
        of_order=_wobble_of_order,
    ),
    EffectKind(
        "rail_straightness",
        where="a prismatic joint",
        words="the rail is bent",
        bases=("bump", "power", "sin", "cos"),
        example="{kind: rail_straightness, where: rail, motion: t1}",
        doc="rail_straightness",
        testable=_rail("rail_straightness", ("t1", "t2")),
        curve=("t1", "t2"),
    ),
    EffectKind(
        "rail_angular",
        where="a prismatic joint",
        words="the carriage tilts on its way along the rail",
        bases=("bump", "power", "sin", "cos"),
        example="{kind: rail_angular, where: rail, motion: yaw}",
        doc="rail_angular",
        testable=_rail("rail_angular", ("roll", "pitch", "yaw")),
        curve=("roll", "pitch", "yaw"),
    ),
    EffectKind(
        "joint_coupling",
        where="a joint",
        words="the joint moves along when another one turns",
        bases=("linear",),
        example="{kind: joint_coupling, where: joint_3, with: joint_2}",
        doc="joint_coupling",
        testable=_joint_coupling,
        key="with",
    ),
)
"""In the order in which they are tried."""
