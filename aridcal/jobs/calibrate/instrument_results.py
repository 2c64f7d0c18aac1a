r"""Identified numbers of the things that measurements refer to, and how well the scale is known.

Things that are coefficients of the model have its uncertainty. Those that are solved for beside it (see
:mod:`aridcal.engine.fit.elimination`) follow the coefficients, :math:`\lambda = y - X \theta`, so that their covariance is

.. math:: \Sigma_\lambda = H^{-1} + X \Sigma X^T
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin

from aridcal.engine.fit.elimination import Elimination, Groups
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.residual import linearise
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.instruments.pixels import PLACE_COMPONENTS, R9, T
from aridcal.engine.instruments.pose import TRACKER
from aridcal.engine.instruments.setup import Things
from aridcal.engine.model.predictions import Observations
from aridcal.engine.robot.kinematics import along_plane
from aridcal.engine.rows.dataset import Dataset

Status = Literal["identified", "fixed", "redundant"]

LEAST_PART = 1e-6
"""Share of a direction that no row tells, from which a component is a part of it: less is rounding."""

NORMAL = ("nx", "ny", "nz")
"""Components of a plane in reports; its own are tilts about arbitrary axes."""


@dataclass(frozen=True)
class ThingValue:
    """A number of one thing.

    Attributes:
        role: Role of the thing: ``point``, ``camera`` and so on.
        name: Its label.
        component: Name of the number.
        unit: Unit of the number.
        value: As identified, or as known beforehand; None where nothing is known.
        std: 1-sigma; None unless it was identified. That of a camera's or board's place is a twist in its own axes.
        status: ``identified``; ``fixed``, as the campaign states it; or ``redundant``: no row tells it apart.
        redundant_with: Numbers that it is confounded with.
        rows: Number of fitted rows that refer to the thing.
    """

    role: str
    name: str
    component: str
    unit: str
    value: float | None
    std: float | None
    status: Status
    redundant_with: tuple[str, ...]
    rows: int


def thing_values(fit: Fit, train: Dataset) -> tuple[ThingValue, ...]:
    """All numbers of all things.

    Args:
        fit: A stage.
        train: The rows that it was fitted to.
    """
    fit_problem = problem(fit.model, train)
    measured = fit_problem.measured
    solved = _solved(fit_problem, fit)
    values: list[ThingValue] = []
    for role, things in measured.instruments.things.items():
        if things.role == TRACKER or things.role.places:
            continue  # nothing of a tracker is unknown, a fault is an effect; a head has a chapter of its own
        rows, thing = references(measured, role)
        count = np.bincount(thing[fit.weight[rows] > 0.0], minlength=len(things))
        states = fit_problem.states[role]
        for k, name in enumerate(things.names):
            result = (
                _by_coefficients(fit, things, name) if solved is None or not things.role.many else solved.of(role, k)
            )
            values += _values(things, name, states[k], result, int(count[k]))
    return tuple(values)


def references(measured: Observations, role: str) -> tuple[np.ndarray, np.ndarray]:
    """Rows that refer to things of a role, and the number of the thing, shape (n,) each."""
    rows, thing = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
    for b, block in enumerate(measured.blocks):
        names = [each.name for each in MEASUREMENT_KINDS[block.kind].roles]
        if role in names:
            of_block = np.flatnonzero(measured.block == b)
            rows.append(of_block)
            thing.append(measured.refers[of_block, names.index(role)])
    return np.concatenate(rows), np.concatenate(thing)


@dataclass(frozen=True)
class _ThingResult:
    """The u components of one thing: change (u,), covariance (u, u), status, and the confounded partners of each."""

    change: np.ndarray
    covariance: np.ndarray
    status: tuple[Status, ...]
    partners: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class _Solved:
    """Groups solved for, with the covariance (K, K) of the coefficients that they follow and the names of their unknowns."""

    groups: Groups
    things: Elimination
    covariance: np.ndarray
    members: list[list[str]]

    def of(self, role: str, k: int) -> _ThingResult:
        """The components of one thing."""
        slots, group = self.groups.slot[role][k], int(self.groups.group[role][k])
        u = len(slots)
        free = slots >= 0
        covariance = np.zeros((u, u))
        status: list[Status] = ["fixed"] * u
        partners: list[tuple[str, ...]] = [()] * u
        if free.any():
            free_slots, X = slots[free], self.things.X[group]
            inverse = self.things.inverse[group][np.ix_(free_slots, free_slots)]
            covariance[np.ix_(free, free)] = inverse + X[free_slots] @ self.covariance @ X[free_slots].T
            directions = self._untold_directions(group)
            for component in np.flatnonzero(free).tolist():
                lost = np.abs(directions[slots[component]]) > LEAST_PART
                partner = (np.abs(directions[:, lost]) > LEAST_PART).any(axis=1)
                partner[slots[component]] = False
                status[component] = "redundant" if lost.any() else "identified"
                partners[component] = tuple(self.members[group][j] for j in np.flatnonzero(partner))
        return _ThingResult(np.zeros(u), covariance, tuple(status), tuple(partners))

    def _untold_directions(self, group: int) -> np.ndarray:
        """Directions of a group's unknowns that no row tells, shape (U, n)."""
        unknowns = np.flatnonzero(self.groups.unknown[group])
        count = len(unknowns) - int(self.things.rank[group])
        directions = np.zeros((len(self.groups.unknown[group]), count))
        if count:
            inverse = self.things.inverse[group][np.ix_(unknowns, unknowns)]
            size = np.sqrt(np.diag(inverse))
            scale = 1.0 / np.where(size > 0.0, size, 1.0)
            vectors = np.linalg.eigh(inverse * scale[:, None] * scale)[1]
            directions[unknowns] = vectors[:, :count]
        return directions


def _solved(fit_problem: Problem, fit: Fit) -> _Solved | None:
    """The groups of a fit, solved once more where it ended; None where there are none."""
    if fit_problem.groups is None:
        return None
    groups = linearise(fit_problem, fit.theta, fit.weight, fit.sigma).groups
    assert groups is not None
    return _Solved(fit_problem.groups, groups, fit.covariance, _members(fit_problem.measured, fit_problem.groups))


def _members(measured: Observations, groups: Groups) -> list[list[str]]:
    """Names of the unknowns of each group, in their order."""
    names = [[""] * groups.unknown.shape[1] for _ in range(len(groups.unknown))]
    for role, slots in groups.slot.items():
        things = measured.instruments.things[role]
        for k, component in np.argwhere(slots >= 0).tolist():
            part = f"{things.names[k]}.{things.role.components[component]}"
            names[groups.group[role][k]][slots[k, component]] = part
    return names


def _by_coefficients(fit: Fit, things: Things, name: str) -> _ThingResult:
    """The components of a thing that are coefficients of the model itself."""
    u = len(things.role.components)
    change, covariance = np.zeros(u), np.zeros((u, u))
    number = {each: k for k, each in enumerate(fit.model.names)}
    candidates = {c.name for c in fit.candidates}
    status: list[Status] = []
    partners: list[tuple[str, ...]] = []
    index = []
    for component in things.role.components:
        coefficient = f"{name}.{component}"
        index.append(number.get(coefficient, -1))
        status.append("identified" if coefficient in number else "redundant" if coefficient in candidates else "fixed")
        partners.append(tuple(fit.redundant.get(coefficient, ())))
    fitted = np.flatnonzero(np.array(index) >= 0)
    at = np.array(index)[fitted]
    change[fitted] = fit.theta[at]
    covariance[np.ix_(fitted, fitted)] = fit.covariance[np.ix_(at, at)]
    return _ThingResult(change, covariance, tuple(status), tuple(partners))


def _values(things: Things, name: str, state: np.ndarray, result: _ThingResult, rows: int) -> list[ThingValue]:
    """The numbers of one thing as they are reported: a normal for a plane, rpy for a place."""
    role = things.role
    final = role.moved(state[None], result.change[None])[0]
    std = np.sqrt(np.maximum(np.diag(result.covariance), 0.0))
    components, units, values = role.components, role.units, final
    status, partners = result.status, result.partners
    if role.name == "plane":
        e1, e2 = along_plane(final[None, :3])
        turned = np.stack([np.cross(e1, final[:3])[0], np.cross(e2, final[:3])[0]], axis=1)
        spread = np.sqrt(np.maximum(np.einsum("iu,uv,iv->i", turned, result.covariance[:2, :2], turned), 0.0))
        components, units, std = (*NORMAL, "offset"), ("1", "1", "1", "m"), np.append(spread, std[2])
        tilts: Status = next((s for s in ("redundant", "identified") if s in status[:2]), "fixed")
        status = (tilts, tilts, tilts, status[2])
        partners = (partners[0], partners[0], partners[0], partners[2])
    elif components[:6] == PLACE_COMPONENTS:
        rpy = pin.rpy.matrixToRpy(final[R9].reshape(3, 3)) if np.isfinite(final[R9]).all() else np.full(3, np.nan)
        values = np.concatenate([final[T], rpy, final[R9.stop : R9.stop + len(components) - 6]])
    return [
        ThingValue(
            role=role.name,
            name=name,
            component=component,
            unit=units[k],
            value=float(values[k]) if np.isfinite(values[k]) else None,
            std=float(std[k]) if status[k] == "identified" else None,
            status=status[k],
            redundant_with=partners[k],
            rows=rows,
        )
        for k, component in enumerate(components)
    ]


def known_scale_sigma(rows: Dataset) -> float | None:
    """1-sigma of the scale of the measurements from lengths that are known beforehand, [m/m].

    Returns:
        0 where an instrument measures lengths itself, or sees a board of known size; of points the standard deviation of all
        known lengths over these; infinite where no length is known; None where nothing measured has a length.
    """
    if any(block.traits.ranges or block.traits.places for block in rows.blocks) or _gauged(rows):
        return 0.0
    if all(block.traits.level for block in rows.blocks):
        return None
    weight = sum((tie.value / tie.std) ** 2 for tie in rows.instruments.ties if tie.form == "distance")
    for role in ("point", "marker"):
        if role in rows.instruments.things:
            weight += _of_places(rows.instruments.things[role])
    return float(1.0 / np.sqrt(weight)) if weight else np.inf


def scale_std(fit: Fit, train: Dataset) -> float | None:
    """1-sigma of the scale after the fit, [m/m], where it comes from known lengths between points or markers.

    Args:
        fit: A stage.
        train: The rows that it was fitted to.
    """
    beforehand = known_scale_sigma(train)
    if beforehand is None or beforehand == 0.0 or np.isinf(beforehand):
        return beforehand
    fit_problem = problem(fit.model, train)
    solved = _solved(fit_problem, fit)
    if solved is None:
        return beforehand
    # A change of scale moves each point by its distance from the middle of all: the least-squares estimate from such shifts.
    weight = np.zeros(solved.groups.unknown.shape)
    squares = 0.0
    for role in ("point", "marker"):
        if role in solved.groups.slot:
            mask = np.isfinite(fit_problem.states[role]).all(axis=1) & (solved.groups.slot[role] >= 0).all(axis=1)
            places = fit_problem.states[role][mask]
            centred = places - places.mean(axis=0)
            weight[solved.groups.group[role][mask][:, None], solved.groups.slot[role][mask]] = centred
            squares += float(np.sum(centred**2))
    if squares == 0.0:
        return beforehand
    follows = np.einsum("gu,guk->k", weight, solved.things.X)
    own_part = np.einsum("gu,guv,gv->", weight, solved.things.inverse, weight)
    return float(np.sqrt(own_part + follows @ solved.covariance @ follows) / squares)


def _gauged(rows: Dataset) -> bool:
    """True if rows on planes read a gauge, which measures lengths."""
    planes = [b for b, block in enumerate(rows.blocks) if block.traits.gauges]
    return bool(np.any(rows.observed[np.isin(rows.labels.block, planes), :1]))


def _of_places(things: Things) -> float:
    """Sum of squared lengths over their variance, of places that are known beforehand."""
    placed = np.isfinite(things.start).all(axis=1) & (~things.free | np.isfinite(things.std)).all(axis=1)
    if placed.sum() < 2:
        return 0.0
    variance = np.where(things.free, np.where(np.isfinite(things.std), things.std, 0.0) ** 2, 0.0)[placed]
    centred = things.start[placed] - things.start[placed].mean(axis=0)
    if not np.any(centred):
        return 0.0
    exact = not np.all(variance > 0.0)
    return np.inf if exact else float(np.sum(centred**2 / variance))
