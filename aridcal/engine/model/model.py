"""Robot, frames and coefficients as a model of the target: its poses, and how they change with the coefficients."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.basis import ALWAYS, evaluate
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, LINK_COMPONENTS, Coefficient
from aridcal.engine.corrections.labels import label_columns
from aridcal.engine.corrections.loads import Surroundings, covariate_table, is_load, needs
from aridcal.engine.corrections.sights import is_sight, sight_table, target_places
from aridcal.engine.instruments.setup import Instruments
from aridcal.engine.model.extended import COMPONENT_ORDER, ExtendedModel, Slot, robot_slot
from aridcal.engine.model.joint_motions import motion, transform
from aridcal.engine.model.local import LocalColumns, local
from aridcal.engine.model.many_rows import blocks
from aridcal.engine.robot.chain import Robot, Route
from aridcal.engine.robot.doty import doty_links, links_down
from aridcal.system.errors import CovariateNotFound, MeasurementError, RobotError

UNIT_SIZES = {"m": 1.0, "rad": 1.0, "px": 500.0, "1": 10.0, "1/m": 1.0}
"""Size in each unit that counts as much as a metre or a radian: half a usual focal length [px]; lens terms reach 10."""

ONE_FRAME = ((None, pin.SE3.Identity()),)

LabelledFrames = tuple[tuple[str | None, pin.SE3], ...]

_Derived = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Poses of rows: rotations (n, 3, 3) and positions (n, 3), [m]; and twists of the target, (n, 6, k)."""


@dataclass(frozen=True)
class ModelRows:
    """Measured configurations as a model sees them.

    Attributes:
        positions: Joint positions, shape (N, joints), [rad] or [m].
        phi: Bases of the coefficients that are no constants, shape (N, varying). In memory rows run fastest, as in twists.
        world: Index of each row's ``world_base`` frame, shape (N,).
        tip: Index of each row's ``tip_target`` frame, shape (N,).
        route: Index of the path that each row takes, shape (N,); None where all take one.
    """

    positions: np.ndarray
    phi: np.ndarray
    world: np.ndarray
    tip: np.ndarray
    route: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, rows: slice | np.ndarray) -> ModelRows:
        route = None if self.route is None else self.route[rows]
        return ModelRows(self.positions[rows], self.phi.T[:, rows].T, self.world[rows], self.tip[rows], route)


@dataclass(frozen=True)
class LockedModel:
    """A robot with its effects, and nothing else that moves.

    Attributes:
        model: Pinocchio's.
        target: The target on its last joint.
        own: Coordinate of each joint of the path in ``model``, shape (j,).
        joints: Number of each of those joints among the robot's, shape (j,).
        carrier: Coordinate that carries each coefficient, shape (K,); -1 where it is locked. A joint that carries a
            constant beside an effect starts at zero: its constant is still to be added.
    """

    model: pin.Model
    target: pin.SE3
    own: np.ndarray
    joints: np.ndarray
    carrier: np.ndarray


@dataclass(frozen=True)
class _Arm:
    """The chain of one path, as a model of its own.

    Attributes:
        model: Of that chain, with the coefficients that move it.
        coefficients: Which of the whole model's coefficients those are, shape (k,).
        based: Which of the whole model's bases belong to them, shape (varying,) bool.
        joints: Which of the robot's joints are on it, shape (j,).
        columns: Which of the robot's columns drive them, shape (c,).
        in_world: True if the path starts in the world.
    """

    model: Model
    coefficients: np.ndarray
    based: np.ndarray
    joints: np.ndarray
    columns: np.ndarray
    in_world: bool

    def rows(self, rows: ModelRows, some: np.ndarray | slice = slice(None)) -> ModelRows:
        """Some of the whole model's rows as the chain's model sees them."""
        world = rows.world[some] if self.in_world else np.zeros_like(rows.world[some])
        phi = rows.phi.T[self.based][:, some].T
        return ModelRows(rows.positions[some][:, self.joints], phi, world, rows.tip[some])


@dataclass(frozen=True)
class Model:
    """Robot + frames + coefficients: target poses and their Jacobian.

    Where rows take several paths through the robot's tree, "the world" of a row is where its path starts: the world, or a link.

    Attributes:
        robot: The nominal chain, or several limbs.
        coefficients: The unknowns, K of them; theta is their value.
        world_base: Start of T_world_base, for all rows (label None) or for each station.
        tip_target: Start of T_tip_target, likewise; none where poses of links are asked for, which hold no target.
        around: Gravity, the payloads' places and those of instruments, for what effects depend on.
        instruments: The things that measurements refer to. Coefficients at one of them move it, and not the target.
        states: Where those things are, (L, P) by role; those of ``instruments`` where a role is missing.
        routes: The paths that rows take.
        target_on: Links that carry targets, by the targets' labels; all others are on the tip.
    """

    robot: Robot
    coefficients: tuple[Coefficient, ...]
    world_base: LabelledFrames = ONE_FRAME
    tip_target: LabelledFrames = ONE_FRAME
    around: Surroundings = field(default_factory=Surroundings)
    instruments: Instruments = field(default_factory=Instruments)
    states: Mapping[str, np.ndarray] = field(default_factory=dict)
    routes: tuple[Route, ...] = (Route(),)
    target_on: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(c.name for c in self.coefficients)

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns beside the joints that the effects depend on, sorted."""
        return needs(self.robot, (c.basis for c in self.coefficients), self.around)

    def with_coefficients(self, coefficients: Sequence[Coefficient]) -> Model:
        """The same robot and frames with other unknowns."""
        return replace(self, coefficients=tuple(coefficients))

    @property
    def own_motions(self) -> tuple[tuple[str, str], ...]:
        """The motion of each of the robot's joints about or along its axis, as place and component."""
        return tuple((name, "axis") for name in self.robot.names)

    def with_motions(self, motions: Iterable[tuple[str, str]]) -> Model:
        """The same model with constant motions where effects act, behind its other coefficients.

        Their columns of the Jacobian are those of all effects with these motions, before a basis multiplies them.

        Args:
            motions: Place and component of each.
        """
        added = (Coefficient(where, component, ALWAYS) for where, component in motions)
        return self.with_coefficients((*self.coefficients, *added))

    def rows(
        self,
        readings: np.ndarray,
        covariates: Mapping[str, np.ndarray] | None = None,
        station: np.ndarray | None = None,
        target: np.ndarray | None = None,
        route: np.ndarray | None = None,
    ) -> ModelRows:
        """Prepare measured configurations.

        Args:
            readings: Shape (N, columns) in the order of ``robot.readings``, [rad] or [m].
            covariates: Columns that the bases depend on, each of shape (N,).
            station: Label of each row; needed where a frame is per station. Rows from link to link have an empty one, which
                stands for the first.
            target: Label of each row's target, where there are several.
            route: Number of each row's path among ``routes``; default: from the world to what carries the row's target.

        Raises:
            CovariateNotFound: an effect depends on a column that was not measured.
            MeasurementError: a row's station or target is none of those that the model knows.
        """
        n = len(readings)
        at_tip = station if target is None else target
        world = _frame_index(self.world_base, station, n)
        tip = _frame_index(self.tip_target, at_tip, n, "station" if target is None else "target")
        if route is None and len(self.routes) > 1:
            route = np.array(
                [self.routes.index(self._route_to(label)) for label in _labels(at_tip, n).tolist()], dtype=int
            )
        varying = [self.coefficients[k] for k in self._based]
        names = {name for c in varying for name in c.basis.of}
        for mass in self.around.masses:
            if mass in self.needs and mass not in (covariates or {}):
                raise CovariateNotFound(f"the model depends on {mass!r}, which was not measured: add that column")
        columns = label_columns(names, station) | dict(covariates or {})
        table = covariate_table(self.robot, readings, columns, self.around, world, names) if names else {}
        if any(map(is_sight, names)):
            gravity = np.atleast_2d(self.around.gravity)[0]  # instruments measure one base
            table |= self.sight_columns(readings, gravity, tip, route)
        phi = np.empty((len(varying), n)).T
        for k, c in enumerate(varying):
            phi[:, k] = evaluate(c.basis, table)
            if c.station is not None:
                phi[:, k] *= _labels(at_tip if c.where == "tip_target" else station, n) == c.station
        return ModelRows(self.robot.positions(readings), phi, world, tip, route)

    def sight_columns(
        self, readings: np.ndarray, gravity: np.ndarray, tip: np.ndarray, route: np.ndarray | None
    ) -> dict[str, np.ndarray]:
        """Covariates of places, shape (N,) each: where each row's own path starts, of the target at its end."""
        columns: dict[str, np.ndarray] = {}
        for arm, some in self._by_arm(len(readings), route):
            down = gravity if arm.in_world else np.zeros(3)  # nobody says how wires hang that a limb carries
            table = sight_table(arm.model.robot, readings[some][:, arm.columns], self.around.sights, down, tip[some])
            for name, values in table.items():
                columns.setdefault(name, np.zeros(len(readings)))[some] = values
        return columns

    def target_places(self, rows: ModelRows, readings: np.ndarray) -> np.ndarray:
        """Places of the targets of rows, the arm nominal, in the base's frame or that of the link where their paths start.

        Args:
            rows: N of them.
            readings: Theirs, shape (N, columns), [rad] or [m].

        Returns:
            Shape (N, 3), [m].
        """
        places, targets = np.empty((len(rows), 3)), self.around.sights.targets[rows.tip]
        for arm, some in self._by_arm(len(rows), rows.route):
            places[some] = target_places(arm.model.robot, readings[some][:, arm.columns], targets[some])
        return places

    def poses(self, theta: np.ndarray, rows: ModelRows) -> tuple[np.ndarray, np.ndarray]:
        """Target poses T_world_target: rotations (N, 3, 3) and positions (N, 3) in [m]."""
        R, p = np.empty((len(rows), 3, 3)), np.empty((len(rows), 3))
        if self.divided:
            for arm, some in self._by_arm(len(rows), rows.route):
                R[some], p[some] = arm.model.poses(theta[arm.coefficients], arm.rows(rows, some))
            return R, p
        for index, world, tip in self._variants(rows):
            for block in blocks(len(rows) if isinstance(index, slice) else len(index)):
                part = block if isinstance(index, slice) else index[block]
                R[part], p[part] = self._extended.poses(self._configurations(theta, rows[part]), world, tip)
        return R, p

    def jacobian(self, theta: np.ndarray, rows: ModelRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r"""Differentiate the target pose with respect to the coefficients.

        .. math:: J_k = J_{joint(k)} \, \varphi_k(z)

        Args:
            theta: Coefficients, shape (K,), each in [component unit / basis unit].
            rows: N measured configurations.

        Returns:
            The poses, as :meth:`poses`, and the twists of the target at its own origin in world axes, shape (N, 6, K):
            linear [m], then angular [rad], per unit of each coefficient.
        """
        if self.divided:
            return self._of_arms(
                rows,
                len(theta),
                lambda arm, of_arm: (arm.coefficients, arm.model.jacobian(theta[arm.coefficients], of_arm)),
            )
        R, p, twists = self.motions(theta, rows)
        return R, p, np.ascontiguousarray(self.of_coefficients(twists, rows))

    def motions(self, theta: np.ndarray, rows: ModelRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The poses, and the twists of the target that the extended model's joints cause, (N, 6, joints), rows fastest."""
        n, q, variants = len(rows), self._configurations(theta, rows), self._variants(rows)
        if len(variants) == 1:
            return self._extended.jacobian(q, *variants[0][1:])
        R, p = np.empty((n, 3, 3)), np.empty((n, 3))
        twists = np.empty((q.shape[1], 6, n)).transpose(2, 1, 0)
        for index, world, tip in variants:
            R[index], p[index], twists[index] = self._extended.jacobian(q[index], world, tip)
        return R, p, twists

    def by_readings(self, theta: np.ndarray, rows: ModelRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The poses, and the twists of the target that readings cause while effects stay as they are, (N, 6, columns)."""
        if self.divided:
            count = len(self.robot.readings)
            return self._of_arms(
                rows, count, lambda arm, of_arm: (arm.columns, arm.model.by_readings(theta[arm.coefficients], of_arm))
            )
        R, p, twists = self.motions(theta, rows)
        return R, p, twists[:, :, self._extended.own] @ self.robot.factors

    def _of_arms(
        self, rows: ModelRows, count: int, differentiate: Callable[[_Arm, ModelRows], tuple[np.ndarray, _Derived]]
    ) -> _Derived:
        """Poses and ``count`` columns of twists of all rows, from those of each chain's rows.

        Args:
            rows: N of them.
            count: Columns of the whole model.
            differentiate: Of a chain and its rows: which of the columns are its own, and its poses and twists.
        """
        R, p, J = np.empty((len(rows), 3, 3)), np.empty((len(rows), 3)), np.zeros((len(rows), 6, count))
        for arm, some in self._by_arm(len(rows), rows.route):
            columns, (R[some], p[some], twists) = differentiate(arm, arm.rows(rows, some))
            whole_rows = np.zeros((len(twists), 6, count))  # whole rows at a time: it is twice as fast
            whole_rows[:, :, columns] = twists
            J[some] = whole_rows
        return R, p, J

    def of_coefficients(self, twists: np.ndarray, rows: ModelRows, first: int = 0) -> np.ndarray:
        """Columns of the coefficients from ``first`` on, (N, m, K), from those of the joints that carry them, (N, m, joints)."""
        J = twists.T[self._extended.carrier[first:]].T  # rows stay what runs fastest in memory
        which = self._based[self._based >= first] - first
        if len(which):
            # Constants stand before all others as a rule: then no part is copied.
            based = slice(which[0], which[-1] + 1) if which[-1] + 1 - which[0] == len(which) else which
            J[:, :, based] *= rows.phi[:, None, -len(which) :]
        for (constants, frames), at in self._stationed(rows):
            included = constants >= first
            J[:, :, constants[included] - first] *= frames[included] == at[:, None, None]
        return J

    def origins(self, theta: np.ndarray) -> dict[str, pin.SE3]:
        """Own ``<origin>`` of every joint that the constants move: nominal placement times corrections."""
        if self.divided:
            limbs = [self._arm_of(Route(None, limb.tip)) for limb in reversed(self.robot.limbs)]
            return {name: T for arm in limbs for name, T in arm.model.origins(theta[arm.coefficients]).items()}
        value = self._constant_values(theta)
        origins: dict[str, pin.SE3] = {}
        here = pin.SE3.Identity()  # from the last origin's end
        for step in self._extended.chain:
            here = here * step.placement
            if step.slot is None:
                placement = step.before.inverse() * here
                origins[step.origin] = placement.inverse() if step.climbs else placement
                here = pin.SE3.Identity()
            elif step.slot in value and step.motion is not None:
                here = here * transform(step.motion, value[step.slot])
        joints = {c.where for c in self.coefficients if c.basis.constant and c.component in FRAME_COMPONENTS}
        corrected = {c.where for c in self.coefficients if c.component in LINK_COMPONENTS}
        joints |= {str(link.next_origin) for link in self._extended.links if link.joint in corrected}
        return {name: origin for name, origin in origins.items() if name in joints}

    @property
    def first_labels(self) -> tuple[str | None, str | None]:
        """Labels of one row's station and target: the first of each, None where frames have none, or both have the same."""
        stations, targets = ([label for label, _ in frames] for frames in (self.world_base, self.tip_target))
        base, tip = (next(iter(labels), None) for labels in (stations, targets))
        return (base or tip, None) if base is None or stations == targets else (base, tip)

    def frames(self, theta: np.ndarray) -> tuple[LabelledFrames, LabelledFrames]:
        """T_world_base and T_tip_target with the constants applied."""
        world = [(label, self._frame("world_base", label, start, theta)) for label, start in self.world_base]
        tip = [(label, self._frame("tip_target", label, start, theta)) for label, start in self.tip_target]
        return tuple(world), tuple(tip)

    def _frame(self, where: str, label: str | None, start: pin.SE3, theta: np.ndarray) -> pin.SE3:
        """One frame with its constants applied, in the order of C."""
        constants = [
            (c, x) for c, x in zip(self.coefficients, theta, strict=True) if c.where == where and c.station == label
        ]
        value = {c.component: x for c, x in constants if c.basis.constant}
        for component in COMPONENT_ORDER:
            if component in value:
                start = start * transform(motion(component), value[component])
        return start

    def recentred(self, theta: np.ndarray) -> tuple[Model, np.ndarray]:
        """The same model with the frames' constants moved into their start: those coefficients become zero."""
        world, tip = self.frames(theta)
        frame = [c.where in ("world_base", "tip_target") and c.basis.constant for c in self.coefficients]
        return replace(self, world_base=world, tip_target=tip), np.where(frame, 0.0, theta)

    def locked(self, theta: np.ndarray, station: str | None = None, target: str | None = None) -> LockedModel:
        """The first path's chain and its effects alone: whatever moves alike in all rows is locked where theta has it.

        Args:
            theta: Coefficients, shape (K,).
            station: Label of the frames to use, where they are per station.
            target: That of the target, where it is not the same.

        Raises:
            MeasurementError: the station is none of those that the model knows.
        """
        if self.divided:
            arm = self._arm_of(self._route_to(target or station or ""))
            locked = arm.model.locked(theta[arm.coefficients], station, target)
            carrier = np.full(len(theta), -1)
            carrier[arm.coefficients] = locked.carrier
            return replace(locked, carrier=carrier, joints=arm.joints)
        at_base, at_tip = (None if label is None else np.array([label]) for label in (station, target or station))
        world, tip = (int(_frame_index(*end, 1)[0]) for end in ((self.world_base, at_base), (self.tip_target, at_tip)))
        slots = self._extended.slots
        robot_slots = [robot_slot(name) for name in self.robot.names]
        moving = {*robot_slots, *(slots[k] for k in self._varying)}
        model, target = self._extended.locked(self._constant_values(theta), moving, world, tip)
        index = {name: k for k, name in enumerate(list(model.names)[1:])}
        carrier_of = [index[slot.name] if slot in moving else -1 for slot in slots]
        return LockedModel(
            model=model,
            target=target,
            own=np.array([index[slot.name] for slot in robot_slots]),
            joints=np.arange(len(robot_slots)),
            carrier=np.array(carrier_of, dtype=int),
        )

    @cached_property
    def at_things(self) -> np.ndarray:
        """Coefficients that move an instrument's things, shape (K,) bool."""
        names = self.instruments.names
        return np.array([c.where in names for c in self.coefficients], dtype=bool)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Size of each coefficient, in its unit, that counts as much as a metre or a radian elsewhere, shape (K,)."""
        size = np.ones(len(self.coefficients))
        for k in np.flatnonzero(self.at_things):
            c = self.coefficients[k]
            size[k] = UNIT_SIZES[self.instruments.unit(c.where, c.component)]
        return size

    @cached_property
    def divided(self) -> bool:
        """True if rows take several paths, or coefficients move no target: then chains are models of their own."""
        return bool(self.at_things.any()) or self.routes != (Route(),) or bool(self.robot.others)

    @cached_property
    def _arms(self) -> tuple[_Arm, ...]:
        """The chain of each path."""
        return tuple(map(self._arm_of, self.routes))

    def limb(self, link: str) -> tuple[Model, np.ndarray]:
        """The chain from the base to a link as a model of its own, and the numbers of its coefficients in this one.

        Its targets are those on that link; the link itself where there is none.

        Raises:
            RobotError: one of its joints gives way under a load that other limbs change.
        """
        arm = self._arm_of(Route(None, None if link == self.robot.tip else link))
        on_link = [
            k for k, (label, _) in enumerate(self.tip_target) if self.target_on.get(label or "", self.robot.tip) == link
        ]
        labels = [self.tip_target[k][0] for k in on_link]
        keep = [c.where != "tip_target" or c.station in labels for c in arm.model.coefficients]
        coefficients = tuple(c for c, keeps in zip(arm.model.coefficients, keep, strict=True) if keeps)
        shared = {name for name in arm.model.robot.names if len(self.robot.limbs_of(name)) > 1}
        for c in coefficients:
            if c.where in shared and any(map(is_load, c.basis.of)):
                raise RobotError(
                    f"{c.name}: what {c.where} bears depends on where the other limbs are, and nothing says that"
                )
        sights = self.around.sights
        placed = len(sights.targets) == len(self.tip_target) and bool(on_link)
        targets = sights.targets[on_link] if placed else np.zeros((max(1, len(on_link)), 3))
        around = replace(self.around, sights=replace(sights, targets=targets))
        frames = tuple(self.tip_target[k] for k in on_link) or ONE_FRAME
        return Model(arm.model.robot, coefficients, arm.model.world_base, frames, around), arm.coefficients[keep]

    def _arm_of(self, route: Route) -> _Arm:
        """The chain of a path."""
        robot = self.robot
        chain = robot.between(*route) if robot.others or route != Route() else robot
        places = {*chain.names, *(each.name for gap in chain.fixed for each in gap)}
        places |= ({"world_base"} if route.start is None else set()) | ({"tip_target"} if self.tip_target else set())
        coefficients = np.flatnonzero(
            [c.where in places and self._corrects(c, chain, places) for c in self.coefficients]
        )
        base = self.world_base if route.start is None else ONE_FRAME
        target = self.tip_target or ONE_FRAME
        model = Model(chain, tuple(self.coefficients[k] for k in coefficients), base, target, self.around)
        return _Arm(
            model=model,
            coefficients=coefficients,
            based=np.isin(self._based, coefficients),
            joints=np.array([robot.names.index(name) for name in chain.names], dtype=int),
            columns=np.array(robot.columns_of(chain), dtype=int),
            in_world=route.start is None,
        )

    def _route_to(self, label: str) -> Route:
        """The path from the world to a target, by the target's label; of one path alone, that."""
        return self.routes[0] if len(self.routes) == 1 else Route(None, self.target_on.get(label))

    def _corrects(self, c: Coefficient, chain: Robot, places: Collection[str]) -> bool:
        """True if a coefficient at a joint of a path moves the path's end: a link's parameters act where the next origin is.

        Raises:
            RobotError: the path leaves that link elsewhere than the chain base -> tip, of which the parameters are.
        """
        main = self.robot.main
        if c.component not in LINK_COMPONENTS or chain is main:
            return True
        link = next(each for each in doty_links(main) if each.joint == c.where)
        if link.next_origin not in places:
            return False
        if link not in links_down(chain):
            raise RobotError(
                f"{c.name}: the report's link parameters are those of the chain from {main.base!r} to {main.tip!r}, and this "
                f"path leaves the link elsewhere. Calibrate with `parameters: {{set: full}}`"
            )
        return True

    def _by_arm(self, n: int, route: np.ndarray | None) -> list[tuple[_Arm, slice | np.ndarray]]:
        """The chains, and which of n rows take each."""
        if route is None or len(self.routes) == 1:
            return [(self._arms[0], slice(0, n))]
        pairs = [(arm, np.flatnonzero(route == k)) for k, arm in enumerate(self._arms)]
        return [(arm, some) for arm, some in pairs if len(some)]

    def chains(self, rows: ModelRows) -> list[tuple[slice | np.ndarray, Model, np.ndarray, ModelRows]]:
        """For each path its rows' numbers, its chain's model, the numbers of that model's coefficients, its rows as it sees them.

        Empty where the model is one chain.
        """
        every = self._by_arm(len(rows), rows.route) if self.divided else []
        return [(some, arm.model, arm.coefficients, arm.rows(rows, some)) for arm, some in every]

    @cached_property
    def _extended(self) -> ExtendedModel:
        world, tip = (tuple(placement for _, placement in frames) for frames in (self.world_base, self.tip_target))
        return ExtendedModel(self.robot, self.coefficients, world, tip)

    @cached_property
    def local(self) -> LocalColumns | None:
        """Which coefficients act in few rows; None where a column for each of them is quicker."""
        return None if self.divided else local(self.coefficients, self._extended.carrier)

    @cached_property
    def _varying(self) -> np.ndarray:
        """Coefficients that do not act alike on every row."""
        return np.flatnonzero([not c.basis.constant or c.station is not None for c in self.coefficients])

    @cached_property
    def _based(self) -> np.ndarray:
        """Coefficients that are no constants."""
        return np.flatnonzero([not c.basis.constant for c in self.coefficients])

    def _variants(self, rows: ModelRows) -> list[tuple[slice | np.ndarray, int, int]]:
        """Groups of rows that share their frames: row numbers, and the indices of the frames at the base and at the target."""
        tips = len(self.tip_target)
        if len(self.world_base) == tips == 1:
            return [(slice(None), 0, 0)]
        pair = rows.world * tips + rows.tip
        order = np.argsort(pair, kind="stable")
        ends = np.flatnonzero(np.diff(pair[order])) + 1
        return [(index, *divmod(int(pair[index[0]]), tips)) for index in np.split(order, ends) if len(index)]

    def _configurations(self, theta: np.ndarray, rows: ModelRows) -> np.ndarray:
        """Positions of all joints of the extended model, shape (N, nv): theta_k phi_k(z), summed where joints are shared."""
        carrier = self._extended.carrier
        q = np.zeros((len(rows), len(self._extended.index)))
        q[:, self._extended.own] = rows.positions
        alike = np.delete(np.arange(len(theta)), self._varying)
        q += np.bincount(carrier[alike], theta[alike], q.shape[1])
        if len(self._based):
            carriers, which = np.unique(carrier[self._based], return_inverse=True)
            spread = np.zeros((len(self._based), len(carriers)))
            spread[np.arange(len(self._based)), which] = theta[self._based]
            q[:, carriers] += rows.phi @ spread
        for (constants, frames), at in self._stationed(rows):
            present = np.isin(frames, at)
            for k, frame in zip(constants[present], frames[present], strict=True):
                q[:, carrier[k]] += theta[k] * (at == frame)
        return q

    def _stationed(self, rows: ModelRows) -> list[tuple[tuple[np.ndarray, np.ndarray], np.ndarray]]:
        """Constants of single stations, as :attr:`_of_frames`, and the rows' frames, (n,), at each end where there are any."""
        return [
            (constants, at)
            for constants, at in zip(self._of_frames, (rows.world, rows.tip), strict=True)
            if len(constants[0])
        ]

    @cached_property
    def _of_frames(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Constants of one station each, at the base and at the target: their numbers and those of their frames, (S,) each."""
        ends = []
        for where, frames in (("world_base", self.world_base), ("tip_target", self.tip_target)):
            number = {label: k for k, (label, _) in enumerate(frames)}
            constants = np.setdiff1d(self._varying, self._based).tolist()
            numbers = [k for k in constants if self.coefficients[k].where == where]
            ends.append(
                (np.array(numbers, int), np.array([number[self.coefficients[k].station] for k in numbers], int))
            )
        return ends

    def _constant_values(self, theta: np.ndarray) -> dict[Slot, float]:
        pairs = zip(self._extended.slots, self.coefficients, strict=True)
        return {slot: float(theta[k]) for k, (slot, c) in enumerate(pairs) if c.basis.constant}


def _labels(station: np.ndarray | None, n: int) -> np.ndarray:
    return np.full(n, "") if station is None else station


def _frame_index(frames: LabelledFrames, label: np.ndarray | None, n: int, per: str = "station") -> np.ndarray:
    labels = [name for name, _ in frames]
    if labels in ([], [None]):
        return np.zeros(n, dtype=int)
    if label is None:
        raise MeasurementError(f"a frame is per {per}: the table needs a `{per}` column")
    number = {name: k for k, name in enumerate(labels)}
    number.setdefault("", 0)
    unknown = sorted({str(s) for s in label} - set(map(str, number)))
    if unknown:
        raise MeasurementError(
            f"{per} {unknown[0]!r} was not in the calibration (known: {', '.join(map(str, labels))})"
        )
    return np.array([number[s] for s in label], dtype=int)
