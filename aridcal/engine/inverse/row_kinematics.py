"""A solved model one configuration at a time: the target's pose and Jacobian in microseconds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.basis import FORMS, Basis, Columns, Numbers
from aridcal.engine.corrections.effect import direction
from aridcal.engine.corrections.labels import is_label, label_in
from aridcal.engine.corrections.loads import Surroundings, bearing_components, covariate_table, is_load, needs
from aridcal.engine.corrections.sights import TARGET
from aridcal.engine.model.model import LabelledFrames, Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.drive import Drive
from aridcal.system.errors import CovariateNotFound, nearest


@dataclass(frozen=True)
class _Term:
    """Coefficients that share a form: ``spread @ value(z[of], numbers)`` is what they move, joint by joint.

    Attributes:
        value: Of :data:`aridcal.engine.corrections.basis.FORMS`, here for many numbers at once.
        of: For each argument of the form: index into the covariates, shape (terms,).
        numbers: Each of shape (terms,).
        spread: Theta where each coefficient acts, else 0, shape (joints, terms).
    """

    value: Callable[[Columns, Numbers], np.ndarray]
    of: list[np.ndarray]
    numbers: tuple[np.ndarray, ...]
    spread: np.ndarray


@dataclass(frozen=True)
class Curve:
    """Splines of one covariate on evenly spaced knots, summed: a cubic polynomial between each knot and the next.

    Attributes:
        joint: That it moves.
        of: Index of the covariate.
        start: The first knot.
        step: From one knot to the next.
        pieces: Coefficients of 1, u, u^2, u^3 between knots, with u from 0 to 1.
    """

    joint: int
    of: int
    start: float
    step: float
    pieces: list[list[float]]

    def value(self, z: float) -> float:
        """The curve's value; zero beyond its ends."""
        u = (z - self.start) / self.step
        if not 0.0 <= u < len(self.pieces):
            return 0.0 * u  # of what is not a number, no number either
        k = int(u)
        u -= k
        a, b, c, d = self.pieces[k]
        return a + u * (b + u * (c + u * d))


class OneRowModel:
    """What :class:`~aridcal.engine.model.model.Model` computes for many rows, for one configuration without the cost of arrays.

    Whatever moves alike in all rows is locked in Pinocchio's model, so that only the robot's joints and those of its
    effects are left.

    Args:
        model: Robot, frames and coefficients.
        theta: Coefficients, shape (K,).
        station: Label of the frames to use, where they are per station.
        target: That of the target, where it is not the same.

    Attributes:
        needs: Covariates that the effects depend on and that the caller must give, sorted.
        still: The effects' joints when no effect acts, shape (joints,).
        moves: Columns that drive the joints of the target's path, shape (columns,) bool; all others hold still.
    """

    def __init__(self, model: Model, theta: np.ndarray, station: str | None = None, target: str | None = None) -> None:
        robot, locked = model.robot, model.locked(theta, station, target)
        self._model = locked.model
        last = self._model.njoints - 1
        frame = pin.Frame("target", last, 0, locked.target, pin.FrameType.OP_FRAME)
        self._target = self._model.addFrame(frame)
        self._data = self._model.createData()
        self._size = self._model.nv
        self._carrier = locked.carrier

        self._factors, self._offsets = robot.factors, robot.offsets
        self._drive = np.zeros((self._size, len(robot.readings)))
        self._drive[locked.own] = self._factors[locked.joints]
        self.moves: np.ndarray = np.any(self._drive != 0.0, axis=0)
        self.still = np.zeros(self._size)
        self.still[locked.own] = self._offsets[locked.joints]

        at_tip = target or station
        acting = [c.station in (None, at_tip if c.where == "tip_target" else station) for c in model.coefficients]
        free = [k for k, c in enumerate(model.coefficients) if locked.carrier[k] >= 0 and acting[k]]
        bases = {k: model.coefficients[k].basis for k in free}
        for k in free:
            if bases[k].always:
                self.still[locked.carrier[k]] += theta[k]
                del bases[k]
        names = list(dict.fromkeys(name for basis in bases.values() for name in basis.of))
        place = {name: i for i, name in enumerate(names)}
        self._absent = _absent(bases.values())
        self._absent |= {name: float(label_in(name) == station) for name in names if is_label(name)}
        self._curves = self._take_curves(bases, theta, place)
        self._terms = self._all_terms(bases, theta, place)

        loads = [n for n in names if n not in robot.names and is_load(n)]
        places = [n for n in names if n in TARGET]
        columns = [n for n in names if n not in robot.names and n not in (*loads, *places)]
        self._joints = [(place[n], robot.names.index(n)) for n in names if n in robot.names]
        self._columns = [(place[n], n) for n in columns]
        gravity = _at(station, model.world_base, np.atleast_2d(model.around.gravity))
        around = replace(model.around, gravity=gravity)
        of_loads = _LoadsOfArrays if robot.climbs else _Loads
        self._loads = of_loads(robot, around, [(place[n], n) for n in loads]) if loads else None
        where = [(place[n], TARGET.index(n)) for n in places]
        on_tip = _at(at_tip, model.tip_target, model.around.sights.targets) if places else None
        self._place = None if on_tip is None else _Place(robot, on_tip, where)
        self._covariates = len(names)
        self.needs = needs(robot, (model.coefficients[k].basis for k in free), around)

    def _take_curves(self, bases: dict[int, Basis], theta: np.ndarray, place: Mapping[str, int]) -> list[Curve]:
        """Sum the splines that stand on the same evenly spaced knots, and take them out of the bases."""
        families: dict[tuple[int, int, float], list[int]] = {}
        for k, basis in bases.items():
            if basis.form == "bump":
                _, step = basis.numbers
                families.setdefault((int(self._carrier[k]), place[basis.of[0]], step), []).append(k)
        curves = []
        for (joint, of, step), members in families.items():
            centres = np.array([bases[k].numbers[0] for k in members])
            if evenly_spaced(centres, step):
                curves.append(curve_of(joint, of, centres, step, theta[members]))
                for k in members:
                    del bases[k]
        return curves

    def _all_terms(self, bases: Mapping[int, Basis], theta: np.ndarray, place: Mapping[str, int]) -> list[_Term]:
        """Gather bases by their form."""
        terms = []
        for form in dict.fromkeys(basis.form for basis in bases.values()):
            members = [k for k, basis in bases.items() if basis.form == form]
            count = len(members)
            spread = np.zeros((self._size, count))
            spread[self._carrier[members], np.arange(count)] = theta[members]
            covariates = np.array([[place[name] for name in bases[k].of] for k in members])
            numbers = np.array([bases[k].numbers for k in members]).reshape(count, -1)
            terms.append(_Term(FORMS[form].value, list(covariates.T), tuple(numbers.T), spread))
        return terms

    def effects(self, readings: np.ndarray, covariates: Mapping[str, float]) -> np.ndarray:
        """Where the effects stand in one configuration.

        Args:
            readings: Shape (columns,), in the order of ``robot.readings``, [rad] or [m].
            covariates: Value of each of :attr:`needs`.

        Returns:
            Shape (joints,), to be given to :meth:`pose` and :meth:`jacobian`.

        Raises:
            CovariateNotFound: one of :attr:`needs` is missing.
        """
        if not self._covariates:
            return self.still
        z = np.empty(self._covariates)
        positions = self._factors @ readings + self._offsets
        for k, joint in self._joints:
            z[k] = positions[joint]
        try:
            for k, name in self._columns:
                z[k] = covariates[name] if name not in self._absent else covariates.get(name, self._absent[name])
            if self._loads:
                self._loads.fill(z, readings, covariates)
        except KeyError as missing:
            name = str(missing.args[0])
            raise CovariateNotFound(
                f"the model depends on {name!r}, which was not given{nearest(name, covariates)}: add it"
            ) from None
        if self._place:
            self._place.fill(z, readings)
        coordinates = self.still.copy()
        for curve in self._curves:
            coordinates[curve.joint] += curve.value(float(z[curve.of]))
        for term in self._terms:
            coordinates += term.spread @ term.value([z[of] for of in term.of], term.numbers)
        return coordinates

    def pose(self, readings: np.ndarray, effects: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """T_world_target: rotation (3, 3) and position (3,) in [m]."""
        pin.framesForwardKinematics(self._model, self._data, effects + self._drive @ readings)
        target = self._data.oMf[self._target]
        return target.rotation.copy(), target.translation.copy()

    def jacobian(self, readings: np.ndarray, effects: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The pose, and how it changes with the readings while the effects stay where they are.

        Returns:
            Rotation (3, 3), position (3,) [m], and the target's twists at its own origin in world axes, shape
            (6, columns): linear, then angular.
        """
        q = effects + self._drive @ readings
        J = pin.computeFrameJacobian(self._model, self._data, q, self._target, pin.LOCAL_WORLD_ALIGNED)
        J = J.reshape(6, -1)  # of one joint it comes as a vector
        target = pin.updateFramePlacement(self._model, self._data, self._target)
        return target.rotation.copy(), target.translation.copy(), J @ self._drive


def _absent(bases: Iterable[Basis]) -> dict[str, float]:
    """Covariates that need not be given, and what each counts as then: those on which no other form depends."""
    absent = {(name, FORMS[basis.form].absent) for basis in bases for name in basis.of}
    needed = {name for name, value in absent if value is None}
    return {name: value for name, value in absent if value is not None and name not in needed}


def evenly_spaced(centres: np.ndarray, step: float) -> bool:
    """True if the centres stand a whole number of steps apart, to the digits that files keep of them."""
    steps = (centres - centres.min()) / step
    return bool(np.abs(steps - np.round(steps)).max() < 1e-6)


def curve_of(joint: int, of: int, centres: np.ndarray, step: float, theta: np.ndarray) -> Curve:
    """The sum of B-splines as cubic pieces, from two knots before the first centre to two behind the last."""
    start = float(centres.min()) - 2.0 * step
    count = round(float(np.ptp(centres)) / step) + 4
    u = np.arange(4) / 3.0  # four points give a cubic
    z = start + step * (np.arange(count)[:, None] + u)
    values = FORMS["bump"].value([z[:, :, None]], (centres, step)) @ theta
    powers = np.vander(u, increasing=True)
    pieces = np.linalg.solve(powers, values.T).T
    return Curve(joint, of, start, step, pieces.tolist())


def _at(label: str | None, frames: LabelledFrames, values: np.ndarray) -> np.ndarray:
    """The value of the frame with a label, from those of all frames, or from the one for all."""
    return np.asarray(values[[name for name, _ in frames].index(label) if len(values) > 1 else 0])


class _Driven(NamedTuple):
    """How readings set a joint of the tree.

    Attributes:
        place: Of its first coordinate in Pinocchio's configuration.
        as_unit_vector: True where Pinocchio has cosine and sine, as of joints that turn without end.
        factors: Columns of the readings, and what each counts.
        offset: What is added.
    """

    place: int
    as_unit_vector: bool
    factors: tuple[tuple[int, float], ...]
    offset: float


class _Hung(NamedTuple):
    """A payload on Pinocchio's tree.

    Attributes:
        name: Of the covariate.
        joint: The last one that bears it.
        lever: From there, shape (3,), [m].
        bearing: All that do.
    """

    name: str
    joint: int
    lever: np.ndarray
    bearing: set[int]


class _Tree:
    """Pinocchio's tree of the nominal robot, which readings set."""

    def __init__(self, robot: Robot) -> None:
        self._tree = robot.tree.copy()
        self._data = self._tree.createData()
        self._q = pin.neutral(self._tree)
        self._driven = list(_driven(robot))

    def put(self, readings: np.ndarray) -> None:
        """Set the joints that readings drive."""
        q = self._q
        for k, as_unit_vector, factors, offset in self._driven:
            angle = sum(factor * readings[column] for column, factor in factors) + offset
            if as_unit_vector:
                q[k], q[k + 1] = np.cos(angle), np.sin(angle)
            else:
                q[k] = angle


class _Loads(_Tree):
    """Loads on the nominal joints, as :func:`~aridcal.engine.corrections.loads.covariate_table` has it.

    There are two roads to the loads because one row must not cost more than its pose: Pinocchio's recursion takes 4 us
    for it, the arrays of ``covariate_table`` over 1 ms (for thousands of rows both take 3 us a row). Each checks the other
    in ``tests/engine/inverse/test_one_row.py``.

    Pinocchio's recursion gives the wrench that holds up everything beyond a joint; its opposite is the load.

    Args:
        robot: The nominal chain.
        around: Gravity in the base frame, shape (3,), and the payloads' places.
        wanted: For each load: where it goes among the covariates, and its name.
    """

    def __init__(self, robot: Robot, around: Surroundings, slots: list[tuple[int, str]]) -> None:
        super().__init__(robot)
        tree = self._tree
        pin.framesForwardKinematics(tree, self._data, self._q)
        self._gravity = self._data.oMf[_link(robot, robot.base)].rotation @ around.gravity
        tree.gravity.linear = self._gravity
        self._hung = []
        for payload in around.payloads:
            link = tree.frames[_link(robot, payload.on or robot.tip)]
            bearing = set(tree.supports[link.parentJoint])
            self._hung.append(_Hung(payload.name, link.parentJoint, link.placement.act(payload.lever), bearing))
        self._along: list[tuple[int, int]] = []
        self._across: list[tuple[int, int, np.ndarray]] = []
        self._payload: list[tuple[int, int, int]] = []
        for place, name in slots:
            joint, kind = name.rsplit(".", 1)
            k = tree.getJointId(joint)
            if kind == "gravity_torque":
                self._along.append((place, tree.idx_vs[k]))
            elif kind == "payload_torque":
                self._payload.append((place, k, tree.idx_vs[k]))
            else:
                component = kind.removeprefix("gravity_moment_")
                assert component in bearing_components(robot.joint(joint).kind)
                about = direction(component, robot.joint(joint).axis)
                self._across.append((place, k, tree.jointPlacements[k].rotation @ about))
        self._bare = {each.joint: tree.inertias[each.joint].copy() for each in self._hung} if around.loaded else {}

    def fill(self, z: np.ndarray, readings: np.ndarray, covariates: Mapping[str, float]) -> None:
        """Write the loads into the covariates z."""
        self.put(readings)
        data, q = self._data, self._q
        if self._along or self._across:
            for joint, bare in self._bare.items():
                self._tree.inertias[joint] = bare
            for each in self._hung if self._bare else ():
                self._tree.inertias[each.joint] += pin.Inertia(covariates[each.name], each.lever, np.zeros((3, 3)))
            holding = pin.computeGeneralizedGravity(self._tree, data, q)
            for place, k in self._along:
                z[place] = -holding[k]
            for place, joint, about in self._across:
                moment = data.liMi[joint].rotation @ data.f[joint].angular
                z[place] = -about @ moment
        if self._payload:
            pin.computeJointJacobians(self._tree, data, q)
            pulls = []
            for each in self._hung:
                push = covariates[each.name] * self._gravity
                pulls.append((each.bearing, push, np.cross(data.oMi[each.joint].act(each.lever), push)))
            for place, joint, k in self._payload:
                borne = [
                    data.J[:3, k] @ push + data.J[3:, k] @ turn for bearing, push, turn in pulls if joint in bearing
                ]
                z[place] = sum(borne)


class _LoadsOfArrays:
    """Loads where joints move the base, whose gravity Pinocchio's recursion, which starts at the root, does not know."""

    def __init__(self, robot: Robot, around: Surroundings, slots: list[tuple[int, str]]) -> None:
        self._robot, self._around, self._slots = robot, around, slots

    def fill(self, z: np.ndarray, readings: np.ndarray, covariates: Mapping[str, float]) -> None:
        """Write the loads into the covariates z."""
        columns = {name: np.array([covariates[name]]) for name in self._around.masses if name in covariates}
        names = {name for _, name in self._slots}
        world = np.zeros(1, dtype=int)
        table = covariate_table(self._robot, readings[None], columns, self._around, world, names)
        for place, name in self._slots:
            z[place] = table[name][0]


class _Place(_Tree):
    """Where the target is, the arm nominal: :func:`aridcal.engine.corrections.sights.target_places` for one row, as of loads.

    Args:
        robot: The nominal chain.
        target: Place on the tip, shape (3,), [m].
        wanted: For each coordinate that is asked for: where it goes among the covariates, and its number.
    """

    def __init__(self, robot: Robot, target: np.ndarray, slots: list[tuple[int, int]]) -> None:
        super().__init__(robot)
        self._base, self._tip = _link(robot, robot.base), _link(robot, robot.tip)
        self._target, self._slots = target, slots

    def fill(self, z: np.ndarray, readings: np.ndarray) -> None:
        """Write the coordinates into the covariates z."""
        self.put(readings)
        tree, data = self._tree, self._data
        pin.forwardKinematics(tree, data, self._q)
        base, tip = (pin.updateFramePlacement(tree, data, frame) for frame in (self._base, self._tip))
        place = base.actInv(tip.act(self._target))
        for k, number in self._slots:
            z[k] = place[number]


def _link(robot: Robot, name: str) -> int:
    """Number of a link's frame in the tree."""
    return int(robot.tree.getFrameId(name, pin.FrameType.BODY))


def _driven(robot: Robot) -> Iterator[_Driven]:
    """The joints of the tree that readings set; what moves a base from which no path climbs stays."""
    tree = robot.tree
    column = {name: k for k, name in enumerate(robot.readings)}
    still = set() if robot.climbs else set(tree.supports[tree.frames[_link(robot, robot.base)].parentJoint])
    for k in range(1, tree.njoints):
        drive = robot.mimics.get(tree.names[k], Drive({tree.names[k]: 1.0}))
        if drive.factors.keys() <= column.keys() and k not in still:
            factors = tuple((column[name], factor) for name, factor in drive.factors.items())
            yield _Driven(tree.idx_qs[k], tree.nqs[k] == 2, factors, drive.offset)
