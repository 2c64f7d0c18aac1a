"""A solved model one configuration at a time: the target's pose and Jacobian in microseconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from aridcal.effects import FORMS, Surroundings, bearing_components, bearing_direction
from aridcal.errors import CovariateNotFound, nearest
from aridcal.model import Model
from aridcal.robot import Robot


@dataclass(frozen=True)
class _Term:
    """Coefficients that share a form: ``spread @ value(z[of], numbers)`` is what they move, joint by joint."""

    value: Callable[[list[np.ndarray], Any], np.ndarray]  # of effects.FORMS, here for many numbers at once
    of: list[np.ndarray]  # for each argument of the form: index into the covariates, shape (terms,)
    numbers: tuple[np.ndarray, ...]  # each of shape (terms,)
    spread: np.ndarray  # (joints, terms): theta, where the coefficient acts


@dataclass(frozen=True)
class _Curve:
    """Splines of one covariate on evenly spaced knots, summed: a cubic polynomial between each knot and the next."""

    joint: int  # that it moves
    of: int  # index of the covariate
    start: float
    step: float
    pieces: list[list[float]]  # coefficients of 1, u, u^2, u^3 between knots, u from 0 to 1

    def value(self, z: float) -> float:
        """The curve's value; zero beyond its ends."""
        u = (z - self.start) / self.step
        if not 0.0 <= u < len(self.pieces):
            return 0.0 * u  # of what is not a number, no number either
        k = int(u)
        u -= k
        a, b, c, d = self.pieces[k]
        return a + u * (b + u * (c + u * d))


class Machine:
    """What :class:`~aridcal.model.Model` computes for many rows, for one configuration without the cost of arrays.

    Whatever moves alike in all rows is locked in Pinocchio's model, so that only the robot's joints and those of its
    effects are left.

    Args:
        model: Robot, frames and coefficients.
        theta: Coefficients, shape (K,).
        station: Label of the frames to use, where they are per station.

    Attributes:
        needs: Covariates that the effects depend on and that the caller must give, sorted.
        still: The effects' joints when no effect acts, shape (joints,).
    """

    def __init__(self, model: Model, theta: np.ndarray, station: str | None = None) -> None:
        self._model, end, chain, carrier = model.locked(theta, station)
        last = self._model.njoints - 1
        self._target = self._model.addFrame(pin.Frame("target", last, 0, end, pin.FrameType.OP_FRAME))
        self._data = self._model.createData()
        robot, size = model.robot, self._model.nv
        column = {name: k for k, name in enumerate(robot.readings)}
        self._multiplier = np.array([j.multiplier for j in robot.joints])
        self._offset = np.array([j.offset for j in robot.joints])
        self._column = np.array([column[j.reading] for j in robot.joints])
        self._drive = np.zeros((size, len(column)))
        self._drive[chain, self._column] = self._multiplier
        self.still = np.zeros(size)
        self.still[chain] = self._offset

        free = [k for k, c in enumerate(model.coefficients) if carrier[k] >= 0 and c.station in (None, station)]
        for k in free:
            if model.coefficients[k].basis.constant:
                self.still[carrier[k]] += theta[k]
        terms = [k for k in free if not model.coefficients[k].basis.constant]
        names = list(dict.fromkeys(n for k in terms for n in model.coefficients[k].basis.of))
        place = {name: i for i, name in enumerate(names)}
        families: dict[tuple[int, int, float], list[int]] = {}
        for k in terms:
            basis = model.coefficients[k].basis
            if basis.form == "bump":
                families.setdefault((int(carrier[k]), place[basis.of[0]], basis.numbers[1]), []).append(k)
        self._curves = []
        for (joint, of, step), own in families.items():
            centres = np.array([model.coefficients[k].basis.numbers[0] for k in own])
            if _even(centres, step):
                self._curves.append(_curve(joint, of, centres, step, theta[own]))
                terms = [k for k in terms if k not in own]
        self._terms = []
        for form in dict.fromkeys(model.coefficients[k].basis.form for k in terms):
            own = [k for k in terms if model.coefficients[k].basis.form == form]
            bases = [model.coefficients[k].basis for k in own]
            spread = np.zeros((size, len(own)))
            spread[carrier[own], np.arange(len(own))] = theta[own]
            arguments = [np.array([place[b.of[i]] for b in bases]) for i in range(len(bases[0].of))]
            numbers = tuple(np.array([b.numbers for b in bases]).reshape(len(bases), -1).T)
            self._terms.append(_Term(FORMS[form].value, arguments, numbers, spread))

        self._joints = [(place[n], robot.names.index(n)) for n in names if n in robot.names]
        loads = [n for n in names if n not in robot.names and n.rpartition(".")[0] in robot.names]
        gravity = np.atleast_2d(model.around.gravity)
        world = [label for label, _ in model.world_base].index(station) if len(gravity) > 1 else 0
        around = replace(model.around, gravity=gravity[world])
        self._loads = _Loads(robot, around, [(place[n], n) for n in loads]) if loads else None
        measured = [n for n in names if n not in robot.names and n not in loads]
        self._measured = [(place[n], n) for n in measured]
        self._covariates = len(names)
        self.needs = tuple(sorted({*measured, *(("payload",) if self._loads and self._loads.payload else ())}))

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
        positions = readings[self._column] * self._multiplier + self._offset
        for k, joint in self._joints:
            z[k] = positions[joint]
        try:
            for k, name in self._measured:
                z[k] = covariates[name]
            if self._loads:
                self._loads.fill(z, readings, covariates)
        except KeyError as missing:
            name = str(missing.args[0])
            raise CovariateNotFound(
                f"the model depends on {name!r}, which was not given{nearest(name, covariates)}: add it"
            ) from None
        moved = self.still.copy()
        for curve in self._curves:
            moved[curve.joint] += curve.value(float(z[curve.of]))
        for term in self._terms:
            moved += term.spread @ term.value([z[of] for of in term.of], term.numbers)
        return moved

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
        target = pin.updateFramePlacement(self._model, self._data, self._target)
        return target.rotation.copy(), target.translation.copy(), J @ self._drive


def _even(centres: np.ndarray, step: float) -> bool:
    """True if the centres stand a whole number of steps apart."""
    apart = (centres - centres.min()) / step
    return bool(np.abs(apart - np.round(apart)).max() < 1e-6)


def _curve(joint: int, of: int, centres: np.ndarray, step: float, theta: np.ndarray) -> _Curve:
    start = float(centres.min()) - 2.0 * step
    count = round(float(np.ptp(centres)) / step) + 4
    u = np.arange(4) / 3.0  # four points give a cubic
    z = start + step * (np.arange(count)[:, None] + u)
    values = FORMS["bump"].value([z[:, :, None]], (centres, step)) @ theta  # type: ignore[arg-type]
    pieces = np.linalg.solve(np.vander(u, increasing=True), values.T).T
    return _Curve(joint, of, start, step, pieces.tolist())


class _Loads:
    """Gravity's and the payload's pull on the nominal joints: :func:`aridcal.effects.covariate_table` for one row.

    Pinocchio's recursion gives the wrench that holds up everything beyond a joint; its opposite is the load.
    """

    def __init__(self, robot: Robot, around: Surroundings, wanted: list[tuple[int, str]]) -> None:
        self._tree = tree = robot.tree.copy()
        self._data = tree.createData()
        base = tree.getFrameId(robot.base, pin.FrameType.BODY)
        self._q = pin.neutral(tree)
        pin.framesForwardKinematics(tree, self._data, self._q)
        root_base = self._data.oMf[base].rotation
        self._gravity = root_base @ around.gravity
        tree.gravity.linear = self._gravity
        column = {name: k for k, name in enumerate(robot.readings)}
        upstream = set(tree.supports[tree.frames[base].parentJoint])
        self._driven = []
        for k in range(1, tree.njoints):
            master, multiplier, offset = robot.mimics.get(tree.names[k], (tree.names[k], 1.0, 0.0))
            if master in column and k not in upstream:
                self._driven.append((tree.idx_qs[k], tree.nqs[k] == 2, column[master], multiplier, offset))
        self._last = tree.getJointId(robot.joints[-1].name)
        end = robot.tip_before * robot.tip_origin
        self._lever = end.act(around.lever)
        self._along: list[tuple[int, int]] = []
        self._across: list[tuple[int, int, np.ndarray, np.ndarray]] = []
        self._payload: list[tuple[int, int]] = []
        for place, name in wanted:
            joint, kind = name.rsplit(".", 1)
            k = tree.getJointId(joint)
            if kind == "gravity_torque":
                self._along.append((place, tree.idx_vs[k]))
            elif kind == "payload_torque":
                self._payload.append((place, tree.idx_vs[k]))
            else:
                component = kind.removeprefix("gravity_moment_")
                assert component in bearing_components(robot.joint(joint).kind)
                direction = bearing_direction(component, robot.joint(joint).axis)
                self._across.append((place, k, tree.jointPlacements[k].rotation @ direction, direction))
        self.payload = bool(self._payload)

    def fill(self, z: np.ndarray, readings: np.ndarray, covariates: Mapping[str, float]) -> None:
        """Write the loads into the covariates z."""
        q = self._q
        for k, turns_freely, column, multiplier, offset in self._driven:
            angle = multiplier * readings[column] + offset
            if turns_freely:
                q[k], q[k + 1] = np.cos(angle), np.sin(angle)
            else:
                q[k] = angle
        data = self._data
        if self._along or self._across:
            g = pin.computeGeneralizedGravity(self._tree, data, q)
            for place, k in self._along:
                z[place] = -g[k]
            for place, joint, direction, _ in self._across:
                z[place] = -direction @ (data.liMi[joint].rotation @ data.f[joint].angular)
        if self._payload:
            pin.computeJointJacobians(self._tree, data, q)
            last = data.oMi[self._last]
            push = covariates["payload"] * self._gravity
            turn = np.cross(last.act(self._lever), push)
            for place, k in self._payload:
                z[place] = data.J[:3, k] @ push + data.J[3:, k] @ turn
