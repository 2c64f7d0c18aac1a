"""The extended Pinocchio model: every correction component is one more joint of the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from aridcal.doty import Link, doty_links, segments
from aridcal.effects import (
    FRAME_COMPONENTS,
    LINK_COMPONENTS,
    Coefficient,
    Surroundings,
    covariate_table,
    evaluate,
)
from aridcal.errors import MeasurementError
from aridcal.robot import Joint, Robot, transverse

# C(x, y, z, roll, pitch, yaw) = Tx Ty Tz Rz(yaw) Ry(pitch) Rx(roll): exactly URDF's xyz and rpy.
ORDER = ("x", "y", "z", "yaw", "pitch", "roll")
ONE_FRAME = ((None, pin.SE3.Identity()),)

# The report's link parameters as motions of frame components.
LINK_AXES = {"d": "z", "theta": "yaw", "beta": "pitch", "a": "x", "alpha": "roll"}

# Pinocchio is twice as fast on joints along a frame axis.
ALIGNED = {
    False: (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
    True: (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
}

Frames = tuple[tuple[str | None, pin.SE3], ...]
# Unit vector in the frame; whether the motion turns about it or slides along it.
Motion = tuple[np.ndarray, bool]
# Where; group: "c" constant, "v" effect, "d" Doty link, "q" the robot's own motion; component.
Slot = tuple[str, str, str]


@dataclass(frozen=True)
class Rows:
    """Measured configurations as a model sees them.

    Attributes:
        positions: Joint positions, shape (N, joints), [rad] or [m].
        phi: Bases of the coefficients that vary, shape (N, varying).
        world: Index of each row's ``world_base`` frame, shape (N,).
        tip: Index of each row's ``tip_target`` frame, shape (N,).
    """

    positions: np.ndarray
    phi: np.ndarray
    world: np.ndarray
    tip: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, rows: slice | np.ndarray) -> Rows:
        return Rows(self.positions[rows], self.phi[rows], self.world[rows], self.tip[rows])


@dataclass(frozen=True)
class Model:
    """Robot + frames + coefficients: target poses and their Jacobian.

    Attributes:
        robot: The nominal chain.
        coefficients: The unknowns, K of them; theta is their value.
        world_base: Start of T_world_base, for all rows (label None) or for each station.
        tip_target: Start of T_tip_target, likewise.
        around: Gravity and the payload's place, for the loads that effects depend on.
    """

    robot: Robot
    coefficients: tuple[Coefficient, ...]
    world_base: Frames = ONE_FRAME
    tip_target: Frames = ONE_FRAME
    around: Surroundings = field(default_factory=Surroundings)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(c.name for c in self.coefficients)

    def with_coefficients(self, coefficients: Sequence[Coefficient]) -> Model:
        """The same robot and frames with other unknowns."""
        return replace(self, coefficients=tuple(coefficients))

    def rows(
        self,
        readings: np.ndarray,
        covariates: Mapping[str, np.ndarray] | None = None,
        station: np.ndarray | None = None,
    ) -> Rows:
        """Prepare measured configurations.

        Args:
            readings: Shape (N, columns) in the order of ``robot.readings``, [rad] or [m].
            covariates: Columns that the bases depend on, each of shape (N,).
            station: Label of each row; needed where a frame is per station.

        Raises:
            CovariateNotFound: an effect depends on a column that was not measured.
            MeasurementError: a row's station is none of those that the model knows.
        """
        n = len(readings)
        world, tip = (_frame_index(f, station, n) for f in (self.world_base, self.tip_target))
        wanted = {name for c in self.coefficients for name in c.basis.of}
        table = covariate_table(self.robot, readings, covariates or {}, self.around, world, wanted) if wanted else {}
        phi = np.empty((n, len(self._varying)))
        for column, k in enumerate(self._varying):
            c = self.coefficients[k]
            phi[:, column] = 1.0 if c.basis.constant else evaluate(c.basis, table)
            if c.station is not None:
                phi[:, column] *= _labels(station, n) == c.station
        return Rows(self.robot.positions(readings), phi, world, tip)

    def poses(self, theta: np.ndarray, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
        """Target poses T_world_target: rotations (N, 3, 3) and positions (N, 3) in [m]."""
        R, p = np.empty((len(rows), 3, 3)), np.empty((len(rows), 3))
        q = self._configurations(theta, rows)
        data = self._data
        for index, model, end in self._variants(rows):
            last = data.oMi[model.njoints - 1]
            rotation, translation = last.rotation, last.translation
            for i in index:
                pin.forwardKinematics(model, data, q[i])
                R[i], p[i] = rotation, translation
            p[index] += R[index] @ end.translation
            R[index] = R[index] @ end.rotation
        return R, p

    def jacobian(self, theta: np.ndarray, rows: Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r"""Differentiate the target pose with respect to the coefficients.

        .. math:: J_k = J_{joint(k)} \, \varphi_k(z)

        Args:
            theta: Coefficients, shape (K,), each in [component unit / basis unit].
            rows: N measured configurations.

        Returns:
            The poses, as :meth:`poses`, and the twists of the target at its own origin in world axes, shape (N, 6, K):
            linear [m], then angular [rad], per unit of each coefficient.
        """
        n = len(rows)
        R, p = np.empty((n, 3, 3)), np.empty((n, 3))
        wide = np.empty((n, 6, self._pinocchio(0, 0)[0].nv))
        q = self._configurations(theta, rows)
        data = self._data
        for index, model, end in self._variants(rows):
            last = data.oMi[model.njoints - 1]
            rotation, translation, columns = last.rotation, last.translation, data.J
            for i in index:
                pin.computeJointJacobians(model, data, q[i])
                wide[i], R[i], p[i] = columns, rotation, translation
            p[index] += R[index] @ end.translation
            R[index] = R[index] @ end.rotation
        J = wide[:, :, self._column]
        # Pinocchio's columns are velocities of the point at the world's origin: move them to the target.
        x, y, z = p[:, 0, None], p[:, 1, None], p[:, 2, None]
        J[:, 0] += J[:, 4] * z - J[:, 5] * y
        J[:, 1] += J[:, 5] * x - J[:, 3] * z
        J[:, 2] += J[:, 3] * y - J[:, 4] * x
        if len(self._varying):
            J[:, :, self._varying] *= rows.phi[:, None, :]
        return R, p, J

    def origins(self, theta: np.ndarray) -> dict[str, pin.SE3]:
        """Own ``<origin>`` of every joint that the constants move: nominal placement times corrections."""
        value = self._constant_values(theta)
        found: dict[str, pin.SE3] = {}
        here = pin.SE3.Identity()
        befores = {j.name: j.before for j in self.robot.joints} | {str(self.robot.tip_joint): self.robot.tip_before}
        for placement, slot, motion in self._chain:
            here = here * placement
            if slot is None:  # the end of a joint's own origin
                name = str(motion)
                if name in befores:
                    found[name] = befores[name].inverse() * here
                here = pin.SE3.Identity()
            elif slot in value:
                assert not isinstance(motion, str)
                here = here * _transform(motion, value[slot])
        moved = {c.where for c in self.coefficients if c.basis.constant and c.component in FRAME_COMPONENTS}
        links = {c.where for c in self.coefficients if c.component in LINK_COMPONENTS}
        moved |= {str(link.next_origin) for link in self._links if link.joint in links}
        return {name: origin for name, origin in found.items() if name in moved}

    def frames(self, theta: np.ndarray) -> tuple[Frames, Frames]:
        """T_world_base and T_tip_target with the constants applied."""
        result = []
        for where, frames in (("world_base", self.world_base), ("tip_target", self.tip_target)):
            moved = []
            for label, placement in frames:
                value = {
                    c.component: theta[k]
                    for k, c in enumerate(self.coefficients)
                    if c.where == where and c.basis.constant and c.station == label
                }
                for component in ORDER:
                    if component in value:
                        placement = placement * _transform(_motion(component), value[component])
                moved.append((label, placement))
            result.append(tuple(moved))
        return result[0], result[1]

    def recentred(self, theta: np.ndarray) -> tuple[Model, np.ndarray]:
        """The same model with the frames' constants moved into their start: those coefficients become zero."""
        world, tip = self.frames(theta)
        frame = [c.where in ("world_base", "tip_target") and c.basis.constant for c in self.coefficients]
        return replace(self, world_base=world, tip_target=tip), np.where(frame, 0.0, theta)

    def calibrated(self, theta: np.ndarray) -> pin.Model:
        """The calibrated robot alone: constants locked at their values, effects at zero, frames left out."""
        model = replace(self, world_base=ONE_FRAME, tip_target=ONE_FRAME)
        moving = {(name, "q", "") for name in self.robot.names}
        value = {s: v for s, v in self._constant_values(theta).items() if s[0] not in ("world_base", "tip_target")}
        return model._locked(value, moving, 0, 0)

    def locked(
        self, theta: np.ndarray, station: str | None = None
    ) -> tuple[pin.Model, pin.SE3, np.ndarray, np.ndarray]:
        """The robot and its effects alone: whatever moves alike in all rows is locked where theta has it.

        Args:
            theta: Coefficients, shape (K,).
            station: Label of the frames to use, where they are per station.

        Returns:
            The model; the target on its last joint; which of its joints each joint of the robot is, shape (joints,);
            and which one carries each coefficient, shape (K,), -1 where that is locked. A joint that carries a constant
            beside an effect starts at zero: its constant is still to be added.

        Raises:
            MeasurementError: the station is none of those that the model knows.
        """
        label = None if station is None else np.array([station])
        world, tip = (int(_frame_index(f, label, 1)[0]) for f in (self.world_base, self.tip_target))
        own = [(name, "q", "") for name in self.robot.names]
        moving = {*own, *(self._slots[k] for k in self._varying)}
        model = self._locked(self._constant_values(theta), moving, world, tip)
        extended, end = self._pinocchio(world, tip)
        last = model.frames[model.getFrameId(extended.names[-1])]
        index = {name: k for k, name in enumerate(list(model.names)[1:])}
        carriers = [index[_joint_name(slot)] if slot in moving else -1 for slot in self._slots]
        return (
            model,
            last.placement * end,
            np.array([index[_joint_name(s)] for s in own]),
            np.array(carriers, dtype=int),
        )

    def _locked(self, value: Mapping[Slot, float], moving: set[Slot], world: int, tip: int) -> pin.Model:
        extended, _ = self._pinocchio(world, tip)
        q = pin.neutral(extended)
        for slot, k in self._index.items():
            q[k] = value.get(slot, 0.0)
        names = {_joint_name(slot) for slot in moving}
        lock = [k for k in range(1, extended.njoints) if extended.names[k] not in names]
        return pin.buildReducedModel(extended, lock, q)

    @cached_property
    def _links(self) -> tuple[Link, ...]:
        return doty_links(self.robot) if any(c.component in LINK_COMPONENTS for c in self.coefficients) else ()

    @cached_property
    def _slots(self) -> tuple[Slot, ...]:
        """The extra joint that carries each coefficient."""
        return tuple(_slot(c) for c in self.coefficients)

    @cached_property
    def _varying(self) -> np.ndarray:
        """Coefficients that do not act alike on every row."""
        return np.array(
            [k for k, c in enumerate(self.coefficients) if not c.basis.constant or c.station is not None], dtype=int
        )

    @cached_property
    def _chain(self) -> list[tuple[pin.SE3, Slot | None, Motion | str]]:
        """Base to tip: (fixed placement, slot, joint model), with (placement, None, name) where an origin ends."""
        robot, needed = self.robot, set(self._slots)
        linked = {slot[0] for slot in needed if slot[1] == "d"}
        out: list[tuple[pin.SE3, Slot | None, Motion | str]] = []
        pending = pin.SE3.Identity()

        def put(slot: Slot, motion: Motion) -> None:
            nonlocal pending
            out.append((pending, slot, motion))
            pending = pin.SE3.Identity()

        def components(where: str, group: str, joint: Joint | None) -> None:
            wanted = [slot for slot in needed if slot[:2] == (where, group)]
            for slot in sorted(wanted, key=lambda s: _rank(s[2], joint)):
                put(slot, _motion(slot[2], joint))

        def end_of_origin(name: str) -> None:
            nonlocal pending
            out.append((pending, None, name))
            pending = pin.SE3.Identity()

        placement = robot.joints[0].placement
        for i, joint in enumerate(robot.joints):
            pending = pending * placement
            components(joint.name, "c", joint)
            end_of_origin(joint.name)
            if joint.kind == "revolute":
                components(joint.name, "v", joint)
            put((joint.name, "q", ""), _motion("axis", joint))
            if joint.kind == "prismatic":
                components(joint.name, "v", joint)
            last = i + 1 == len(robot.joints)
            placement = robot.tip_before * robot.tip_origin if last else robot.joints[i + 1].placement
            if joint.name in linked:
                parts, placement = segments(self._links[i])
                for component, before in parts:
                    pending = pending * before
                    if (joint.name, "d", component) in needed:
                        put((joint.name, "d", component), _motion(LINK_AXES[component]))
        pending = pending * placement
        if robot.tip_joint:
            components(robot.tip_joint, "c", None)
        end_of_origin(robot.tip_joint or "")
        return out

    @cached_property
    def _index(self) -> dict[Slot, int]:
        """Velocity index of every extra joint and of the robot's own joints."""
        slots = [slot for slot in self._frame_slots("world_base")]
        slots += [slot for _, slot, _ in self._chain if slot is not None]
        slots += [slot for slot in self._frame_slots("tip_target")]
        return {slot: k for k, slot in enumerate(slots)}

    @cached_property
    def _column(self) -> np.ndarray:
        return np.array([self._index[slot] for slot in self._slots], dtype=int)

    def _frame_slots(self, where: str) -> list[Slot]:
        return [(where, "c", c) for c in ORDER if (where, "c", c) in set(self._slots)]

    @cached_property
    def _bodies(self) -> dict[str, pin.Inertia]:
        """Inertia carried by each joint of the chain: fixed links and locked side branches included."""
        tree = self.robot.tree.copy()
        for frame in tree.frames:  # Pinocchio looks for frames by name, and a link may have that of a joint
            if frame.type != pin.FrameType.JOINT:
                frame.name = f"{frame.name} {frame.type}"
        lock = [k for k in range(1, tree.njoints) if tree.names[k] not in self.robot.names]
        reduced = pin.buildReducedModel(tree, lock, pin.neutral(tree))
        return {name: reduced.inertias[reduced.getJointId(name)] for name in self.robot.names}

    @cached_property
    def _built(self) -> dict[tuple[int, int], tuple[pin.Model, pin.SE3]]:
        return {}

    def _pinocchio(self, world: int, tip: int) -> tuple[pin.Model, pin.SE3]:
        """The extended model for one pair of frames, and the target's placement on its last joint."""
        if (world, tip) not in self._built:
            model, parent = pin.Model(), 0
            pending = self.world_base[world][1]

            def add(slot: Slot, motion: Motion | str) -> None:
                nonlocal parent, pending
                assert not isinstance(motion, str)
                parent = model.addJoint(parent, _joint_model(motion), pending, _joint_name(slot))
                model.addJointFrame(parent)
                pending = pin.SE3.Identity()

            for slot in self._frame_slots("world_base"):
                add(slot, _motion(slot[2]))
            body = ""
            for placement, inner, motion in self._chain:
                if body and not (inner and inner[:2] == (body, "v")):  # a carriage's own motions carry its body
                    model.appendBodyToJoint(parent, self._bodies[body], pin.SE3.Identity())
                    body = ""
                pending = pending * placement
                if inner is not None:
                    add(inner, motion)
                    body = inner[0] if inner[1] == "q" else body
            pending = pending * self.tip_target[tip][1]
            for slot in self._frame_slots("tip_target"):
                add(slot, _motion(slot[2]))
            self._built[world, tip] = model, pending
        return self._built[world, tip]

    @cached_property
    def _data(self) -> pin.Data:
        """Pinocchio's workspace; frames differ in their placement alone, so one serves all of them.

        It grows with the cube of the joints: made anew for each block of rows, it would cost more than the rows.
        """
        return self._pinocchio(0, 0)[0].createData()

    def _variants(self, rows: Rows) -> list[tuple[np.ndarray, pin.Model, pin.SE3]]:
        """Rows that share their frames: (row numbers, extended model, target on its last joint)."""
        pair = rows.world * len(self.tip_target) + rows.tip
        return [
            (np.flatnonzero(pair == k), *self._pinocchio(*divmod(int(k), len(self.tip_target))))
            for k in np.unique(pair)
        ]

    def _configurations(self, theta: np.ndarray, rows: Rows) -> np.ndarray:
        """Positions of all joints of the extended model, shape (N, nv)."""
        q = np.zeros((len(rows), len(self._index)))
        q[:, [self._index[name, "q", ""] for name in self.robot.names]] = rows.positions
        varying = np.zeros(len(theta), dtype=bool)
        varying[self._varying] = True
        for k in np.flatnonzero(~varying):
            q[:, self._column[k]] += theta[k]
        for column, k in enumerate(self._varying):
            q[:, self._column[k]] += theta[k] * rows.phi[:, column]
        return q

    def _constant_values(self, theta: np.ndarray) -> dict[Slot, float]:
        return {
            slot: float(theta[k])
            for k, (slot, c) in enumerate(zip(self._slots, self.coefficients, strict=True))
            if c.basis.constant
        }


def _joint_name(slot: Slot) -> str:
    return slot[0] if slot[1] == "q" else ".".join(slot)


def _slot(c: Coefficient) -> Slot:
    if c.component in LINK_COMPONENTS:
        return c.where, "d", c.component
    frame = c.where in ("world_base", "tip_target")
    return c.where, "c" if c.basis.constant or frame else "v", c.component


def _motion(component: str, joint: Joint | None = None) -> Motion:
    if component in FRAME_COMPONENTS:
        k = FRAME_COMPONENTS.index(component)
        return np.eye(3)[k % 3], k >= 3
    assert joint is not None
    if component == "axis":
        return joint.axis, joint.kind == "revolute"
    return transverse(joint.axis)[int(component[1]) - 1], component[0] == "r"


def _joint_model(motion: Motion) -> pin.JointModel:
    vector, turns = motion
    for k, aligned in enumerate(ALIGNED[turns]):
        if np.array_equal(vector, np.eye(3)[k]):
            return aligned()
    return pin.JointModelRevoluteUnaligned(vector) if turns else pin.JointModelPrismaticUnaligned(vector)


def _rank(component: str, joint: Joint | None) -> tuple[bool, int]:
    """Order inside C: Tx Ty Tz, then Rz Ry Rx; e1, e2 and the axis count as x, y, z where none is a frame axis."""
    vector, turns = _motion(component, joint)
    k = int(np.argmax(np.abs(vector)))
    if np.abs(np.delete(vector, k)).max() > 1e-9:
        k = {"1": 0, "2": 1}.get(component[-1], 2)
    return turns, -k if turns else k


def _transform(motion: Motion, value: float) -> pin.SE3:
    vector, turns = motion
    if turns:
        return pin.SE3(pin.exp3(vector * value), np.zeros(3))
    return pin.SE3(np.eye(3), vector * value)


def _labels(station: np.ndarray | None, n: int) -> np.ndarray:
    return np.full(n, "") if station is None else station


def _frame_index(frames: Frames, station: np.ndarray | None, n: int) -> np.ndarray:
    labels = [label for label, _ in frames]
    if labels == [None]:
        return np.zeros(n, dtype=int)
    if station is None:
        raise MeasurementError("a frame is per station: the table needs a `station` column")
    number = {label: k for k, label in enumerate(labels)}
    unknown = sorted({str(s) for s in station} - set(map(str, labels)))
    if unknown:
        raise MeasurementError(
            f"station {unknown[0]!r} was not in the calibration (known: {', '.join(map(str, labels))})"
        )
    return np.array([number[s] for s in station], dtype=int)
