"""The table of kinds: every effect that could be there, for a robot and the columns that were measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from aridcal.campaign import EffectDeclaration
from aridcal.effects import ANGULAR, FRAME_COMPONENTS, Basis, Coefficient, Effect, bearing_components
from aridcal.errors import CampaignError, nearest
from aridcal.robot import Joint, Robot

ORDERS = (1.0, 2.0, 3.0, 4.0)  # periods per turn that a shaft, a bearing or a disk is most likely to have
WOBBLES = (1.0, 2.0)
BENDS = (1.0, 2.0, 3.0, 4.0)  # powers of the travel: tilt, sag, twist
WAVES = (0.5, 1.0, 2.0)  # periods of a wave over the travel seen
POWERS = (0.0, 1.0, 2.0)  # of a rail's travel, for what bends the more the further it is out
MAP_KNOTS, RAIL_KNOTS, UNKNOWN_KNOTS = 72, 16, 9
PAIR_KNOTS = 5
MOVED_ANGLE, MOVED_LENGTH = 1e-2, 1e-3  # less travel than this says nothing about a joint, [rad] and [m]


@dataclass(frozen=True)
class Barred:
    """A candidate that these data cannot test, and why."""

    what: str
    why: str


@dataclass(frozen=True)
class Scene:
    """What candidates are made from.

    Attributes:
        robot: The chain.
        table: Covariates of the training rows (see :func:`aridcal.effects.covariate_table`), shape (N,) each.
        measured: Names of the columns that were measured beside the joints and are complete and not constant.
        stationed: True where a frame is per station: drift and growth of that frame are then a station's own.
    """

    robot: Robot
    table: Mapping[str, np.ndarray]
    measured: tuple[str, ...]

    def moves(self, joint: Joint) -> bool:
        """True if the joint's reading covers enough to say anything about it."""
        return float(np.ptp(self.table[joint.name])) > (MOVED_ANGLE if joint.kind == "revolute" else MOVED_LENGTH)

    def moving(self, kind: str = "") -> Iterator[Joint]:
        """Joints of a kind that moved."""
        return (j for j in self.robot.joints if kind in ("", j.kind) and self.moves(j))

    def anything(self) -> list[str]:
        """All readings and columns that vary."""
        return [j.name for j in self.moving()] + list(self.measured)

    def varies(self, name: str) -> bool:
        """True if a load is there and changes."""
        values = self.table.get(name)
        return values is not None and float(np.ptp(values)) > 1e-3 * max(1.0, float(np.abs(values).max()))

    def named(self, prefix: str) -> tuple[str, ...]:
        """Measured columns that are called so, or so with a suffix."""
        return tuple(n for n in self.measured if n == prefix or n.startswith(f"{prefix}_"))


def bumps(where: str, component: str, of: str, values: np.ndarray, knots: int) -> tuple[Coefficient, ...]:
    """A smooth function of a covariate: cubic B-splines over the range seen, one beyond each end, as many as data allow."""
    low, high = float(values.min()), float(values.max())
    different = len(np.unique(np.round(values, 6)))
    count = int(np.clip(different // 2, 4, knots))
    step = (high - low) / (count - 1)
    return tuple(
        Coefficient(where, component, Basis("bump", (of,), (low + k * step, step))) for k in range(-3, count + 3)
    )


def turns(where: str, component: str, of: str, order: float) -> tuple[Coefficient, ...]:
    """Sine and cosine of a joint's reading."""
    return tuple(Coefficient(where, component, Basis(form, (of,), (order,))) for form in ("sin", "cos"))


def _linear(where: str, component: str, of: str, values: np.ndarray) -> Coefficient:
    return Coefficient(where, component, Basis("linear", (of,), (round(float(np.mean(values)), 9),)))


def _joint_gain(s: Scene) -> Iterator[Effect]:
    for j in s.moving():
        yield Effect("joint_gain", j.name, (_linear(j.name, "axis", j.name, s.table[j.name]),))


def _joint_harmonic(s: Scene) -> Iterator[Effect]:
    for j in s.moving("revolute"):
        for k in ORDERS:
            yield Effect("joint_harmonic", j.name, turns(j.name, "axis", j.name, k), order=(k,))
        both = tuple(x for k in ORDERS[:2] for x in turns(j.name, "axis", j.name, k))
        yield Effect("joint_harmonic", j.name, both, order=ORDERS[:2])


def _joint_map(s: Scene) -> Iterator[Effect]:
    for j in s.moving():
        yield Effect("joint_map", j.name, bumps(j.name, "axis", j.name, s.table[j.name], MAP_KNOTS), smooth=True)


def _joint_backlash(s: Scene) -> Iterator[Effect]:
    for j in s.robot.joints:
        column = f"{j.name}_direction"
        if column in s.measured:
            basis = Basis("linear", (column,), (0.0,))
            yield Effect("joint_backlash", j.name, (Coefficient(j.name, "axis", basis),), by="direction")
        load = f"{j.name}.gravity_torque"
        if load in s.table and np.ptp(np.sign(s.table[load])) > 0:
            basis = Basis("sign", (load,))
            yield Effect("joint_backlash", j.name, (Coefficient(j.name, "axis", basis),), by="load")


def _joint_compliance(s: Scene) -> Iterator[Effect]:
    for j in s.robot.joints:
        load = f"{j.name}.gravity_torque"
        if s.varies(load):
            yield Effect("joint_compliance", j.name, (Coefficient(j.name, "axis", Basis("linear", (load,), (0.0,))),))


def _bearing_compliance(s: Scene) -> Iterator[Effect]:
    for j in s.robot.joints:
        travels = j.kind == "prismatic" and s.moves(j)
        scale = float(np.abs(s.table[j.name]).max()) if travels else 1.0
        every: list[Coefficient] = []
        for c in bearing_components(j.kind):
            load = f"{j.name}.gravity_moment_{c}"
            if load not in s.table or not np.any(np.abs(s.table[load]) > 1e-3):
                continue
            powers = [
                Coefficient(j.name, c, Basis("times_power", (load, j.name), (0.0, scale, n)) if n else
                            Basis("linear", (load,), (0.0,)))
                for n in (POWERS if travels else (0.0,))
            ]  # fmt: skip
            yield Effect("bearing_compliance", j.name, (powers[0],))
            if travels:
                yield Effect("bearing_compliance", j.name, tuple(powers))
            every += powers
        if len(every) > 1:
            yield Effect("bearing_compliance", j.name, tuple(every))


def _axis_wobble(s: Scene) -> Iterator[Effect]:
    for j in s.moving("revolute"):
        for k in WOBBLES:
            for pair in (("r1", "r2"), ("t1", "t2")):
                for c in pair:
                    yield Effect("axis_wobble", j.name, turns(j.name, c, j.name, k), order=(k,))
                both = tuple(x for c in pair for x in turns(j.name, c, j.name, k))
                yield Effect("axis_wobble", j.name, both, order=(k,))
            every = tuple(x for c in ("r1", "r2", "t1", "t2") for x in turns(j.name, c, j.name, k))
            yield Effect("axis_wobble", j.name, every, order=(k,))


def _rail(kind: str, components: tuple[str, ...]) -> Callable[[Scene], Iterator[Effect]]:
    def make(s: Scene) -> Iterator[Effect]:
        for j in s.moving("prismatic"):
            travel = s.table[j.name]
            middle, half = float(travel.min() + travel.max()) / 2, float(np.ptp(travel)) / 2
            for c in components:
                yield Effect(kind, j.name, bumps(j.name, c, j.name, travel, RAIL_KNOTS), smooth=True)
                for last in BENDS:
                    bend = tuple(
                        Coefficient(j.name, c, Basis("power", (j.name,), (middle, half, n))) for n in BENDS if n <= last
                    )
                    yield Effect(kind, j.name, bend)
                for k in WAVES:
                    yield Effect(kind, j.name, turns(j.name, c, j.name, k * np.pi / half))

    return make


def _joint_coupling(s: Scene) -> Iterator[Effect]:
    for j in s.robot.joints:
        for other in s.moving():
            if other.name != j.name:
                slope = _linear(j.name, "axis", other.name, s.table[other.name])
                yield Effect("joint_coupling", j.name, (slope,), with_=other.name)


def _thermal(s: Scene) -> Iterator[Effect]:
    for column in s.named("temperature"):
        mean = round(float(np.mean(s.table[column])), 9)
        for j in s.robot.joints:
            for c in ("axis", *FRAME_COMPONENTS):
                yield Effect("thermal", j.name, (Coefficient(j.name, c, Basis("linear", (column,), (mean,))),))
            if j.kind == "prismatic" and s.moves(j):
                growth = Basis("times_power", (column, j.name), (mean, 1.0, 1.0))
                yield Effect("thermal", j.name, (Coefficient(j.name, "axis", growth),))
        for where in ("world_base", "tip_target"):
            for c in FRAME_COMPONENTS:
                yield Effect("thermal", where, (Coefficient(where, c, Basis("linear", (column,), (mean,))),))


def _drift(s: Scene) -> Iterator[Effect]:
    if "time" in s.measured:
        time = s.table["time"]
        for where in ("world_base", "tip_target"):
            for c in FRAME_COMPONENTS:
                yield Effect("drift", where, (_linear(where, c, "time", time),))
            for part in (FRAME_COMPONENTS[:3], FRAME_COMPONENTS[3:], FRAME_COMPONENTS):
                yield Effect("drift", where, tuple(_linear(where, c, "time", time) for c in part))


def _payload_compliance(s: Scene) -> Iterator[Effect]:
    if "payload" not in s.measured:
        return
    for j in s.robot.joints:
        torque = f"{j.name}.payload_torque"
        if s.varies(torque):
            basis = Basis("linear", (torque,), (0.0,))
            yield Effect("payload_compliance", j.name, (Coefficient(j.name, "axis", basis),))
        for c in ("axis", "t1", "t2", "r1", "r2"):
            plain = Basis("linear", ("payload",), (0.0,))
            yield Effect("payload_compliance", j.name, (Coefficient(j.name, c, plain),))


def _unknown(s: Scene) -> Iterator[Effect]:
    """Any motion of any joint as a smooth function of any reading or column: what the other kinds do not name."""
    covariates = s.anything()
    for j in s.robot.joints:
        for c in FRAME_COMPONENTS:
            own = abs(j.axis[FRAME_COMPONENTS.index(c) % 3]) > 0.99 and (c in ANGULAR) == (j.kind == "revolute")
            for name in covariates:
                if not (own and name == j.name):  # that is a joint_map
                    yield Effect("unknown", j.name, bumps(j.name, c, name, s.table[name], UNKNOWN_KNOTS), smooth=True)
    for c in FRAME_COMPONENTS:
        for name in covariates:
            where = "tip_target"
            yield Effect("unknown", where, bumps(where, c, name, s.table[name], UNKNOWN_KNOTS), smooth=True)


def pair(s: Scene, where: str, component: str, of: tuple[str, str]) -> Effect:
    """A motion as a smooth function of two covariates at once."""
    low = [float(s.table[name].min()) for name in of]
    step = [float(np.ptp(s.table[name])) / (PAIR_KNOTS - 1) for name in of]
    centres = product(*([low[k] + i * step[k] for i in range(-1, PAIR_KNOTS + 1)] for k in (0, 1)))
    coefficients = tuple(
        Coefficient(where, component, Basis("bump2", of, (u, step[0], v, step[1]))) for u, v in centres
    )
    return Effect("unknown", where, coefficients, smooth=True, grid=(PAIR_KNOTS + 2,) * 2)


KINDS: dict[str, Callable[[Scene], Iterator[Effect]]] = {
    "joint_gain": _joint_gain,
    "joint_harmonic": _joint_harmonic,
    "joint_map": _joint_map,
    "joint_backlash": _joint_backlash,
    "joint_compliance": _joint_compliance,
    "bearing_compliance": _bearing_compliance,
    "axis_wobble": _axis_wobble,
    "rail_straightness": _rail("rail_straightness", ("t1", "t2")),
    "rail_angular": _rail("rail_angular", ("roll", "pitch", "yaw")),
    "joint_coupling": _joint_coupling,
    "thermal": _thermal,
    "drift": _drift,
    "payload_compliance": _payload_compliance,
    "unknown": _unknown,
}


def usable_columns(measured: Mapping[str, np.ndarray]) -> tuple[tuple[str, ...], list[Barred]]:
    """Measured columns that effects may depend on, and why the others may not."""
    good, barred = [], []
    for name, values in measured.items():
        if np.isnan(values).any():
            barred.append(Barred(f"effects of {name}", f"the column has {int(np.isnan(values).sum())} empty cells"))
        elif np.ptp(values) <= 1e-9 * max(1.0, float(np.abs(values).max())):
            barred.append(Barred(f"effects of {name}", "the column is constant"))
        else:
            good.append(name)
    return tuple(good), barred


def barred_joints(scene: Scene) -> list[Barred]:
    """Joints whose own effects cannot be tested."""
    found = [Barred(f"effects of {j.name}'s reading", "the joint never moves") for j in scene.robot.joints
             if not scene.moves(j)]  # fmt: skip
    if not any(scene.robot.mass_beyond > 0):
        found.append(Barred("compliance and load-side backlash", "the URDF has no masses beyond any joint"))
    return found


def candidates(scene: Scene, kinds: tuple[str, ...]) -> list[Effect]:
    """All effects of some kinds that these data can test."""
    return [effect for kind in kinds if kind in KINDS for effect in KINDS[kind](scene)]


def declared(scene: Scene, declaration: EffectDeclaration, place: str) -> Effect:
    """The effect that a campaign states.

    Raises:
        CampaignError: there is no such effect on this robot or with these columns.
    """
    d = declaration
    known = (*scene.robot.names, "world_base", "tip_target")
    if d.where not in known:
        raise CampaignError(f"{place}: effects: no place {d.where!r}{nearest(d.where, known)}")
    if d.kind == "joint_harmonic" and d.order:
        found = [Effect(d.kind, d.where, turns(d.where, "axis", d.where, k), (k,)) for k in d.order]
    elif d.kind == "axis_wobble" and d.order:
        parts = d.motion or ("r1", "r2", "t1", "t2")
        found = [Effect(d.kind, d.where, turns(d.where, c, d.where, k), (k,)) for k in d.order for c in parts]
    else:
        found = [
            e for e in KINDS[d.kind](scene)
            if e.where == d.where
            and (d.with_ is None or e.with_ == d.with_)
            and (d.by is None or e.by == d.by)
            and (d.motion is None or set(e.motion) <= set(d.motion))
            and (d.covariates is None or set(e.covariates) <= set(d.covariates))
        ]  # fmt: skip
        curves = [e for e in found if e.smooth]  # they hold what the others can
        found = curves or found
        if d.kind == "joint_harmonic":
            found = found[:1]
        if d.kind == "joint_backlash" and d.by is None:
            found = found[:1]
    if not found:
        raise CampaignError(
            f"{place}: effects: {d.kind} at {d.where} cannot be fitted: this robot or these columns have nothing that "
            "it could depend on"
        )
    return merged(found)


def merged(effects: Sequence[Effect]) -> Effect:
    """Effects of one kind and place as one, each coefficient once."""
    coefficients = tuple(dict.fromkeys(c for e in effects for c in e.coefficients))
    order = tuple(dict.fromkeys(k for e in effects for k in e.order))
    return replace(effects[0], coefficients=coefficients, order=order)
