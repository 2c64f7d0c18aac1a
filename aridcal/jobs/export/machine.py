"""One description of a calibrated robot that any language can write out: a chain of steps, and formulas of where each stands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.basis import FORMS, Basis
from aridcal.engine.corrections.labels import is_label, label_in
from aridcal.engine.corrections.loads import Surroundings, is_load, needs
from aridcal.engine.corrections.sights import TARGET
from aridcal.engine.inverse.one_pose import FINEST_NOISE, MOST_UNAVOIDABLE
from aridcal.engine.inverse.row_kinematics import curve_of, evenly_spaced
from aridcal.engine.model.model import LockedModel
from aridcal.engine.robot.chain import Robot, Route
from aridcal.engine.robot.kinematics import transverse
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.export.expressions import (
    Derivatives,
    Formula,
    Table,
    Term,
    cosine,
    named,
    power,
    sine,
    total,
)
from aridcal.jobs.export.identifiers import different, identifier
from aridcal.jobs.export.nominal_tree import NominalTree, position
from aridcal.system.errors import AridcalError

MOST_JOINTS = 8
"""Readings up to which the slopes of loads are written out: each of n loads has n of them. Eight joints with any axes make 210 kB
of code with them, twelve 410 kB, which compilers take long for."""

Range = tuple[float, float]


class Step(NamedTuple):
    """A joint of the model: a fixed placement, then a motion about or along the new z axis.

    Attributes:
        name: Of a joint of the robot, or of the effect that moves there.
        placement: From the frame of the step before.
        turns: True about the axis, False along it.
    """

    name: str
    placement: pin.SE3
    turns: bool


@dataclass(frozen=True)
class Chain:
    """From the world to the target.

    Attributes:
        steps: In order.
        end: Of the target in the last step's frame.
        at: Where each step stands, [rad] or [m].
    """

    steps: tuple[Step, ...]
    end: pin.SE3
    at: tuple[Formula, ...]


class Quantity(NamedTuple):
    """An input of the model.

    Attributes:
        name: Of the joint, or of the column in the calibration's tables.
        identifier: The same as an identifier.
        unit: ``rad``, ``m`` or, of a column, what is known of it.
        range: Lowest and highest value at the fitted rows; infinite where nobody knows.
        holes: Holes inside it.
    """

    name: str
    identifier: str
    unit: str
    range: Range
    holes: tuple[Range, ...] = ()


@dataclass(frozen=True)
class Machine:
    """A calibrated robot with its effects, for one pair of frames.

    Attributes:
        joints: Its columns of readings.
        conditions: Columns that its effects depend on.
        model: The robot as it is.
        nominal: The robot as its URDF has it, between the frames that were identified.
        slopes: How each step's place changes with a reading: step, reading and derivative; what is not named is zero.
        limits: Lower and upper limit of each reading that moves the target, shape (columns, 2); infinite where none is.
        moves: Readings that move the target, shape (columns,) bool.
        turning: Readings that turn a joint, shape (columns,) bool.
        pose: False where only the target's position was measured, so that its rotation is not known.
        lean: True where fewer readings move the target than a wanted pose, or position, has numbers.
        lever: [m/rad]: an error of 1 rad counts as much as one of so many metres where not both can be had.
        reached: What a pose may be missed by and count as reached, [m] and [rad].
        frames: Labels of the frames at the base and at the target; None where there is one for all.
        assumed: Columns that only doubtful causes depend on, and where they are taken to stand.
        loads_held: True where slopes leave loads as they are, because the arm is long.
        effects: Names of the coefficients that vary, with their values.
    """

    joints: tuple[Quantity, ...]
    conditions: tuple[Quantity, ...]
    model: Chain
    nominal: Chain
    slopes: tuple[tuple[int, int, Formula], ...]
    limits: np.ndarray
    moves: np.ndarray
    turning: np.ndarray
    pose: bool
    lean: bool
    lever: float
    reached: tuple[float, float]
    frames: tuple[str | None, str | None]
    assumed: Mapping[str, float]
    loads_held: bool
    effects: tuple[tuple[str, float], ...]


def machine(saved: SavedModel) -> Machine:
    """Describe a calibration: the model that :meth:`SavedModel.expected` predicts with, at its first station and target.

    Args:
        saved: The calibration.
    """
    solved, frames = saved.expected, saved.expected.model.first_labels
    model, theta, robot = solved.model, solved.theta, solved.model.robot
    locked = model.locked(theta, *frames)
    symbols = _Symbols(saved, locked)
    chain = _chain(locked, symbols.places(theta))
    world, tip = model.frames(theta)
    bare = replace(model, coefficients=(), world_base=world, tip_target=tip)
    bare_locked = bare.locked(np.zeros(0), *frames)
    loads_held = len(robot.readings) > MOST_JOINTS and bool(symbols.loads)
    derivatives = Derivatives(symbols.loads if loads_held else ())
    slopes = [(k, j, slope) for k, each in enumerate(chain.at) for j, slope in sorted(derivatives.of(each).items())]
    inverse = saved.inverse_kinematics(*frames)
    lean = int(inverse.model.moves.sum()) < (6 if inverse.pose else 3)
    limits = [MOST_UNAVOIDABLE if lean else max(sigma, FINEST_NOISE) for sigma in saved.noise]
    return Machine(
        joints=symbols.joints,
        conditions=symbols.conditions,
        model=chain,
        nominal=_chain(bare_locked, [symbols.positions[robot.names[j]] for j in bare_locked.joints]),
        slopes=tuple(slopes),
        limits=np.column_stack([inverse.low, inverse.high]),
        moves=inverse.model.moves,
        turning=inverse.turning,
        pose=inverse.pose,
        lean=lean,
        lever=inverse.lever,
        reached=(limits[0], limits[1]),
        frames=frames,
        assumed=symbols.assumed,
        loads_held=loads_held,
        effects=tuple((model.coefficients[k].name, float(theta[k])) for k in symbols.varying),
    )


def _chain(locked: LockedModel, at: Sequence[Formula]) -> Chain:
    """The joints of a Pinocchio model as steps, each frame turned so that its joint moves about or along z.

    Where one moves as the next does, from the same place, the two are one step: an error about a joint's own axis is added to
    its reading.
    """
    steps: list[Step] = []
    stands: list[Formula] = []
    before = np.eye(3)
    for k in range(1, locked.model.njoints):
        joint, placement = locked.model.joints[k], locked.model.jointPlacements[k]
        kind = joint.shortname().removeprefix("JointModel")
        axis = np.eye(3)["XYZ".index(kind[1])] if len(kind) == 2 else np.array(joint.extract().axis)
        e1, _ = transverse(axis)
        onto = np.column_stack([e1, np.cross(axis, e1), axis])
        name, turns = str(locked.model.names[k]), kind.startswith("R")
        same = bool(steps) and np.array_equal(placement.homogeneous, np.eye(4)) and np.array_equal(onto, before)
        if same and steps[-1].turns == turns:
            own = min(steps[-1].name, name, key=len)  # a robot's own joint has the shorter name
            steps[-1], stands[-1] = steps[-1]._replace(name=own), stands[-1] + at[k - 1]
            continue
        turned = pin.SE3(before.T @ placement.rotation @ onto, before.T @ placement.translation)
        steps.append(Step(name, turned, turns))
        stands.append(at[k - 1])
        before = onto
    end = pin.SE3(before.T @ locked.target.rotation, before.T @ locked.target.translation)
    return Chain(tuple(steps), end, tuple(stands))


class _Symbols:
    """Readings, conditions and all that effects depend on, as formulas."""

    def __init__(self, saved: SavedModel, locked: LockedModel) -> None:
        model = saved.expected.model
        robot, (station, target) = model.robot, model.first_labels
        self._model, self._locked, self._station = model, locked, station
        at_tip = target or station
        acting = [c.station in (None, at_tip if c.where == "tip_target" else station) for c in model.coefficients]
        self._free = [k for k in range(len(acting)) if acting[k] and locked.carrier[k] >= 0]
        self.varying = [k for k in self._free if not model.coefficients[k].basis.always]
        bases = [model.coefficients[k].basis for k in self.varying]
        world = [label for label, _ in model.world_base].index(station) if len(model.world_base) > 1 else 0
        tip = [label for label, _ in model.tip_target].index(at_tip) if len(model.tip_target) > 1 else 0
        gravity = np.atleast_2d(model.around.gravity)
        self._gravity = gravity[world if len(gravity) > 1 else 0].tolist()
        self._on_tip = model.around.sights.targets[tip]
        around = replace(model.around, gravity=np.array(self._gravity))
        self.assumed = saved.assumed

        names = {name for basis in bases for name in basis.of}
        labels = () if station is not None else tuple(sorted(filter(is_label, names)))
        columns = [*(name for name in needs(robot, bases, around) if name not in self.assumed), *labels]
        self.joints = _quantities(
            saved, robot.readings, ["m" if kind == "prismatic" else "rad" for kind in robot.kinds]
        )
        self.conditions = _quantities(saved, columns, [_unit(name, robot) for name in columns])
        self._readings = [Term("reading", index=k) for k in range(len(robot.readings))]
        by_name: dict[str, Formula] = dict(zip(robot.readings, self._readings, strict=True))
        self.positions = {
            j.name: named(
                position(j.drive, by_name), f"{identifier(j.name)}_position", "rad" if j.kind == "revolute" else "m"
            )
            for j in robot.joints
        }
        self._given: dict[str, Formula] = {name: Term("condition", index=k) for k, name in enumerate(columns)}
        self._given |= {name: value for name, value in self.assumed.items()}
        self._around: Surroundings = around
        self.loads: list[Formula] = []
        self._cache: dict[str, Formula] = {}
        self._trees: dict[str, NominalTree] = {}

    def places(self, theta: np.ndarray) -> tuple[Formula, ...]:
        """Where each joint of the locked model stands."""
        locked, robot, coefficients = self._locked, self._model.robot, self._model.coefficients
        parts: list[list[Formula]] = [[] for _ in range(locked.model.nv)]
        for own, joint in zip(locked.own, locked.joints, strict=True):
            parts[own].append(self.positions[robot.names[joint]])
        for k in self._free:
            if coefficients[k].basis.always:
                parts[locked.carrier[k]].append(float(theta[k]))
        groups: dict[tuple[int, str, tuple[str, ...], float], list[int]] = {}
        for k in self.varying:
            basis = coefficients[k].basis
            if basis.form in ("bump", "bump2", "ball"):
                step = basis.numbers[1] if basis.form == "bump" else 0.0
                groups.setdefault((int(locked.carrier[k]), basis.form, basis.of, step), []).append(k)
            else:
                parts[locked.carrier[k]].append(self._basis(basis) * float(theta[k]))
        names: list[str] = []
        grouped: list[tuple[int, str, list[int]]] = []
        for (carrier, form, _, _), members in groups.items():
            first = coefficients[members[0]]
            names.append(f"{first.where}_{first.component}_by_{'_'.join(first.basis.of)}")
            grouped.append((carrier, form, members))
        for name, (carrier, form, members) in zip(different(names), grouped, strict=True):
            parts[carrier].append(self._table(name, form, members, theta))
        return tuple(map(total, parts))

    def _table(self, name: str, form: str, members: Sequence[int], theta: np.ndarray) -> Formula:
        """The sum of many alike bases times their coefficients, as a table of numbers."""
        bases = [self._model.coefficients[k].basis for k in members]
        of, weights = tuple(self._covariate(each) for each in bases[0].of), theta[list(members)]
        if form == "bump":
            centres, step = np.array([basis.numbers[0] for basis in bases]), bases[0].numbers[1]
            families = [np.arange(len(bases))] if evenly_spaced(centres, step) else np.arange(len(bases))[:, None]
            curves = []
            for n, some in enumerate(families):
                curve = curve_of(0, 0, centres[some], step, weights[some])
                rows = tuple(map(tuple, curve.pieces))
                curves.append(Term("curve", of, 0, Table(f"{name}_{n}" if n else name, rows, curve.start, step)))
            return total(curves)
        rows = tuple((*basis.numbers, float(weight)) for basis, weight in zip(bases, weights, strict=True))
        return Term("pairs" if form == "bump2" else "balls", of, 0, Table(name, rows))

    def _basis(self, basis: Basis) -> Formula:
        """The formula of a basis, as :data:`aridcal.engine.corrections.basis.FORMS` has it."""
        z, n = [self._covariate(name) for name in basis.of], basis.numbers
        if not any(isinstance(each, Term) for each in z):
            return float(FORMS[basis.form].value([np.array([each]) for each in z], n)[0])
        match basis.form:
            case "linear":
                return z[0] - n[0]
            case "power":
                return power((z[0] - n[0]) / n[1], n[2])
            case "sin":
                return sine(z[0] * n[0])
            case "cos":
                return cosine(z[0] * n[0])
            case "sign":
                return Term("sign", (z[0],))
            case "times_power":
                grown = z[1] / n[1]
                return (z[0] - n[0]) * (power(grown, n[2]) if isinstance(grown, Term) else grown ** n[2])
            case "step":
                return Term("before", (z[0], n[0]))
            case "label":
                return z[0]
            case _:
                raise AridcalError(
                    f"an effect has the basis {basis.form!r}, which no export knows: use `aridcal predict`"
                )

    def _covariate(self, name: str) -> Formula:
        if name not in self._cache:
            self._cache[name] = self._new_covariate(name)
        return self._cache[name]

    def _new_covariate(self, name: str) -> Formula:
        robot = self._model.robot
        if name in self.positions:
            return self.positions[name]
        if name in TARGET:
            route = self._model.routes[0]
            if len(self._model.routes) > 1:
                label = self._locked_label or ""
                route = Route(None, self._model.target_on.get(label))
            path = robot.between(*route) if robot.others or route != Route() else robot
            place = self._tree(path).target(self._on_tip)[TARGET.index(name)]
            return named(place, identifier(name), "m, the arm nominal")
        if is_load(name):
            joint, kind = robot.joint(name.rsplit(".", 1)[0]), name.rsplit(".", 1)[1]
            hang = kind == "payload_torque" or self._around.loaded
            payloads = [(each, self._given[each.name]) for each in self._around.payloads] if hang else []
            load = self._tree(robot).load(joint, kind, self._gravity, payloads)
            unit = "N" if joint.kind == "prismatic" and kind.endswith("torque") else "N m"
            self.loads.append(named(load, identifier(name), f"{unit}, the arm nominal"))
            return self.loads[-1]
        if is_label(name) and self._station is not None:
            return float(label_in(name) == self._station)
        return self._given.get(name, math.inf)  # a step of what nobody gives has been: the machine is as it is now

    @property
    def _locked_label(self) -> str | None:
        station, target = self._model.first_labels
        return target or station

    def _tree(self, robot: Robot) -> NominalTree:
        """The nominal tree of a chain, seen from its base."""
        key = f"{robot.base} {robot.tip}"
        if key not in self._trees:
            column = {name: self._readings[k] for k, name in enumerate(self._model.robot.readings)}
            self._trees[key] = NominalTree(robot, [column[name] for name in robot.readings])
        return self._trees[key]


def _quantities(saved: SavedModel, names: Sequence[str], units: Sequence[str]) -> tuple[Quantity, ...]:
    everywhere = (-math.inf, math.inf)
    return tuple(
        Quantity(name, plain, unit, saved.ranges.get(name, everywhere), tuple(saved.holes.get(name, ())))
        for name, plain, unit in zip(names, different(names), units, strict=True)
    )


def _unit(name: str, robot: Robot) -> str:
    """What is to be said of a column."""
    if is_label(name):
        return f"1 where {name.partition('[')[0]} is {label_in(name)}, else 0"
    if name.removesuffix("_direction") in robot.names and name.endswith("_direction"):
        return "1: the joint came to its place with its reading rising, -1: falling, 0: nobody knows"
    if name == "time":
        return "as in the calibration's tables, dates and times of day in s"
    if name.startswith("payload"):
        return "kg"
    return "as in the calibration's tables"
