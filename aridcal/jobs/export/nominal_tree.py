"""What effects depend on and nobody measures, as formulas: the weight that each joint bears, and where the target is.

They are those of :mod:`aridcal.engine.corrections.loads` and :mod:`aridcal.engine.corrections.sights`, from the nominal robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import direction
from aridcal.engine.corrections.loads import Payload
from aridcal.engine.robot.chain import Joint, Robot
from aridcal.engine.robot.drive import Drive
from aridcal.engine.robot.kinematics import bears, link_frame
from aridcal.jobs.export.expressions import Formula, cosine, cross, dot, named, sine, total
from aridcal.jobs.export.identifiers import identifier

Vector = list[Formula]


@dataclass(frozen=True)
class _Frame:
    """A joint of the tree in the base's frame.

    Attributes:
        bearing: Its three axes before a revolute joint turns.
        axes: Its three axes after its motion.
        origin: After its motion, [m].
    """

    bearing: list[Vector]
    axes: list[Vector]
    origin: Vector


class NominalTree:
    """The whole tree of a nominal robot in its base's frame, as :func:`aridcal.engine.robot.kinematics.tree_frames` has it.

    Args:
        robot: A chain, or several limbs.
        readings: Each of the robot's columns, [rad] or [m].
    """

    def __init__(self, robot: Robot, readings: Sequence[Formula]) -> None:
        self._robot, self._model = robot, robot.tree
        self._column = {name: readings[k] for k, name in enumerate(robot.readings)}
        base = link_frame(robot, robot.base)
        self._still = set() if robot.climbs else set(self._upstream(base.parentJoint))
        self._frames = [_Frame(axes := self._root(base)[0], axes, self._root(base)[1])]
        for k in range(1, self._model.njoints):
            parent, placement = self._frames[self._model.parents[k]], self._model.jointPlacements[k]
            bearing = [_along(parent.axes, numbers) for numbers in placement.rotation.T]
            origin = _sum(parent.origin, _along(parent.axes, placement.translation))
            axes, origin = self._moved(k, bearing, origin, 1.0)
            name = identifier(self._model.names[k])
            axes = [[named(x, f"{name}_{'xyz'[i]}_{'xyz'[n]}") for n, x in enumerate(a)] for i, a in enumerate(axes)]
            origin = [named(x, f"{name}_at_{'xyz'[n]}", "m") for n, x in enumerate(origin)]
            self._frames.append(_Frame(bearing, axes, origin))

    def load(
        self, joint: Joint, kind: str, gravity: Sequence[float], payloads: Sequence[tuple[Payload, Formula]]
    ) -> Formula:
        """A load on a joint.

        Args:
            joint: The joint.
            kind: ``gravity_torque``, ``payload_torque`` or ``gravity_moment_C`` of a component C.
            gravity: In the base's frame, [m/s^2].
            payloads: That count in it, each with its mass, [kg].
        """
        k = self._model.getJointId(joint.name)
        frame = self._frames[k]
        force: Vector = [0.0] * 3
        moment: Vector = [0.0] * 3
        if kind != "payload_torque":
            mass, first = self._borne[k]
            if joint.climbs:  # all that is not beyond it in the tree, and the other way
                mass, first = mass - self._borne[0][0], _sum(first, [-x for x in self._borne[0][1]])
            force = [mass * g for g in gravity]
            moment = cross(_sum(first, [-mass * x for x in frame.origin]), gravity)
        for payload, of_mass in payloads:
            link = link_frame(self._robot, payload.on or self._robot.tip)
            if bears(self._robot, link.name)[self._robot.names.index(joint.name)]:
                weight = [of_mass * (g * (-1.0 if joint.climbs else 1.0)) for g in gravity]
                lever = _sum(self._point(link, payload.lever), [-x for x in frame.origin])
                force, moment = _sum(force, weight), _sum(moment, cross(lever, weight))
        across = kind.startswith("gravity_moment_")
        about = direction(kind.removeprefix("gravity_moment_"), joint.axis) if across else joint.axis
        return dot(_along(frame.bearing, about), moment if across or joint.kind == "revolute" else force)

    def target(self, place: np.ndarray) -> Vector:
        """Where a place on the tip, shape (3,), is, [m]."""
        return self._point(link_frame(self._robot, self._robot.tip), place)

    @cached_property
    def _borne(self) -> list[tuple[float, Vector]]:
        """Mass and first moment of all beyond each joint, [kg] and [kg m]."""
        model = self._model
        mass, first = [0.0] * model.njoints, [[0.0, 0.0, 0.0] for _ in range(model.njoints)]
        result: list[tuple[float, Vector]] = [(0.0, [])] * model.njoints
        moments: list[Vector] = [list(each) for each in first]
        for k in reversed(range(model.njoints)):
            body, frame = model.inertias[k], self._frames[k]
            if body.mass > 0.0:
                mass[k] += body.mass
                centre = _sum(frame.origin, _along(frame.axes, body.lever))
                moments[k] = _sum(moments[k], [body.mass * x for x in centre])
            name = identifier(model.names[k])
            moments[k] = [named(x, f"{name}_mass_{'xyz'[n]}", "kg m") for n, x in enumerate(moments[k])]
            result[k] = mass[k], moments[k]
            if k:
                mass[model.parents[k]] += mass[k]
                moments[model.parents[k]] = _sum(moments[model.parents[k]], moments[k])
        return result

    def _point(self, link: pin.Frame, place: np.ndarray) -> Vector:
        frame = self._frames[link.parentJoint]
        return _sum(frame.origin, _along(frame.axes, link.placement.act(place)))

    def _upstream(self, k: int) -> list[int]:
        joints = []
        while k:
            joints.append(k)
            k = self._model.parents[k]
        return joints

    def _root(self, base: pin.Frame) -> tuple[list[Vector], Vector]:
        """Axes and origin of the tree's root: up from the base, each joint the other way."""
        onto = base.placement.inverse()
        axes: list[Vector] = [[float(x) for x in column] for column in onto.rotation.T]
        origin: Vector = [float(x) for x in onto.translation]
        for k in self._upstream(base.parentJoint):
            axes, origin = self._moved(k, axes, origin, -1.0)
            back = self._model.jointPlacements[k].inverse()
            origin = _sum(origin, _along(axes, back.translation))
            axes = [_along(axes, numbers) for numbers in back.rotation.T]
        return axes, origin

    def _moved(self, k: int, axes: list[Vector], origin: Vector, sense: float) -> tuple[list[Vector], Vector]:
        """A frame after the motion of a joint of the tree, or before it with the sense -1."""
        name, robot = self._model.names[k], self._robot
        drive = robot.mimics.get(name, Drive({name: 1.0}))
        stays = k in self._still and bool(drive.factors)
        if stays or name not in robot.moves or not drive.factors.keys() <= self._column.keys():
            return axes, origin
        axis, kind = robot.moves[name]
        at = position(drive, self._column) * sense
        if kind == "prismatic":
            return axes, _sum(origin, [at * x for x in _along(axes, axis)])
        if isinstance(at, float):
            return [_along(axes, numbers) for numbers in pin.exp3(axis * at).T], origin
        c, s = named(cosine(at), f"{identifier(name)}_cos"), named(sine(at), f"{identifier(name)}_sin")
        once, twice = pin.skew(axis), pin.skew(axis) @ pin.skew(axis)
        turned = []
        for i in range(3):
            # A' = A + sin q A [a] + (1 - cos q) A [a]^2, the columns of A being its axes
            still, by_sine, by_cosine = np.eye(3)[i] + twice[:, i], once[:, i], -twice[:, i]
            parts = [
                _along(axes, still),
                [s * x for x in _along(axes, by_sine)],
                [c * x for x in _along(axes, by_cosine)],
            ]
            turned.append([total(each) for each in zip(*parts, strict=True)])
        return turned, origin


def position(drive: Drive, columns: dict[str, Formula]) -> Formula:
    """Where a joint stands, [rad] or [m], from the readings of its masters."""
    return total(columns[name] * factor for name, factor in drive.factors.items()) + drive.offset


def _along(axes: Sequence[Vector], numbers: np.ndarray) -> Vector:
    """The vector with these numbers along three axes."""
    return [total(float(x) * axis[k] for x, axis in zip(numbers, axes, strict=True) if x) for k in range(3)]


def _sum(a: Sequence[Formula], b: Sequence[Formula]) -> Vector:
    return [x + y for x, y in zip(a, b, strict=True)]
