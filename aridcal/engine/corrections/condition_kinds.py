"""Kinds of effects of conditions that change while measuring: temperature, time, payload."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, MOUNTING_FRAMES, ROW_ORDER, Coefficient, Effect
from aridcal.engine.corrections.effect_kind import EffectKind, ObservedRows, rounded_mean, slope

STANDING = {
    "anchor": ("x", "y", "z", "offset"),
    "plane": ("tilt_1", "tilt_2", "offset"),
    "point": ("x", "y", "z"),
    "camera": FRAME_COMPONENTS,
    "board": FRAME_COMPONENTS,
}
"""What moves of a thing that was knocked. A marker that is off is named by its residual; a tracker that moves moves the base."""

FEWEST_ROWS_OF_A_SIDE = 6
"""Rows at the least on either side of a step: fewer are outliers, not a new state. A step of one thing is sought from
four times as many configurations of it: twice those that tell a step in its midst."""

MOST_STEPPED = 24
"""Work: Things beyond which none is sought: each costs as much as a joint, and among many a step needs as many times the
evidence."""


def _thermal(rows: ObservedRows) -> Iterator[Effect]:
    """Difference T - mean(T) for each motion of each place, of frames several together; of a rail also times its travel."""
    for column in rows.columns("temperature"):
        mean = rounded_mean(rows.table[column])
        for j in rows.robot.joints:
            for component in ("axis", *FRAME_COMPONENTS):
                yield Effect("thermal", j.name, (slope(j.name, component, column, mean),))
            if j.kind == "prismatic" and rows.moves(j):
                growth = Basis("times_power", (column, j.name), (mean, 1.0, 1.0))
                yield Effect("thermal", j.name, (Coefficient(j.name, "axis", growth),))
        for where in MOUNTING_FRAMES:
            yield from _of_a_frame("thermal", where, column, mean)


def _of_a_frame(kind: str, where: str, column: str, mean: float) -> Iterator[Effect]:
    """Each motion of a frame in proportion to a column, and its shift, its turn and both."""
    each = tuple(slope(where, component, column, mean) for component in FRAME_COMPONENTS)
    for coefficient in each:
        yield Effect(kind, where, (coefficient,))
    for coefficients in (each[:3], each[3:], each):
        yield Effect(kind, where, coefficients)


def _drift(rows: ObservedRows) -> Iterator[Effect]:
    """Difference t - mean(t) for each motion of a frame, for its shift, its turn and both, and for each joint's zero."""
    if "time" not in rows.measured:
        return
    mean = rounded_mean(rows.table["time"])
    for where in MOUNTING_FRAMES:
        yield from _of_a_frame("drift", where, "time", mean)
    for j in rows.moving():
        yield Effect("drift", j.name, (slope(j.name, "axis", "time", mean),))


def _shift(rows: ObservedRows) -> Iterator[Effect]:
    """Each frame, each joint's zero and each thing that stands around, half way through the rows: where is for the data to say.

    All motions of a frame that the rows can show: a target that slips turns, too. Of things only while there are few.
    """
    of = "time" if "time" in rows.measured else ROW_ORDER
    values = np.unique(rows.table[of]) if of in rows.table else np.zeros(0)
    if len(values) < 2:
        return
    half = len(values) // 2
    step = Basis("step", (of,), (float(values[half - 1 : half + 1].mean()),))
    frames = {"world_base": FRAME_COMPONENTS, "tip_target": FRAME_COMPONENTS if rows.orientations else ("x", "y", "z")}
    things = [
        (where, STANDING[role])
        for (role, where), n in rows.referred.items()
        if role in STANDING and n >= 4 * FEWEST_ROWS_OF_A_SIDE
    ]
    things = things if len(things) <= MOST_STEPPED else []
    for where, motion in (*frames.items(), *((j.name, ("axis",)) for j in rows.moving()), *things):
        yield Effect("shift", where, tuple(Coefficient(where, component, step) for component in motion))


def _payload_compliance(rows: ObservedRows) -> Iterator[Effect]:
    """The payloads' torque about each axis; each payload itself for each motion of each joint."""
    masses = [name for name in rows.masses if name in rows.measured]
    for j in rows.robot.joints if masses else ():
        torque = f"{j.name}.payload_torque"
        if rows.load_changes(torque):
            yield Effect("payload_compliance", j.name, (slope(j.name, "axis", torque),))
        for component, mass in product(("axis", "t1", "t2", "r1", "r2"), masses):
            yield Effect("payload_compliance", j.name, (slope(j.name, component, mass),))


CONDITION_KINDS = (
    EffectKind(
        "thermal",
        where="a joint, `world_base` or `tip_target`",
        words="it grows or shifts with temperature",
        bases=("linear", "times_power"),
        example="{kind: thermal, where: rail, motion: axis, covariates: [temperature, rail]}",
        doc="thermal",
        testable=_thermal,
        columns=lambda d: d.covariates or ("temperature",),
    ),
    EffectKind(
        "drift",
        where="`world_base`, `tip_target` or a joint",
        words="a frame or a zero that moved while these rows were measured",
        bases=("linear",),
        example="{kind: drift, where: world_base, motion: [x, y, z]}",
        doc="drift",
        testable=_drift,
        columns=lambda _: ("time",),
    ),
    EffectKind(
        "shift",
        where="`world_base`, `tip_target`, a joint, or a thing that rows refer to",
        words="it moved once, between two rows",
        bases=("step",),
        example="{kind: shift, where: world_base, at: {row: 118}}",
        doc="shift",
        testable=_shift,
        key="at",
        columns=lambda d: ("time",) if d.at is not None and d.at.time is not None else (),
    ),
    EffectKind(
        "payload_compliance",
        where="a joint",
        words="it yields under the payload",
        bases=("linear",),
        example="{kind: payload_compliance, where: joint_2, motion: axis, covariates: payload}",
        doc="payload_compliance",
        testable=_payload_compliance,
        columns=lambda _: ("payload",),
    ),
)
"""In the order in which they are tried."""
