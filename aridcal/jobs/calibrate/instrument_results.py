r"""What was found of the things that measurements refer to, and how well the scale is known.

Things that are coefficients of the model have its uncertainty. Those that are solved for beside it (see
:mod:`aridcal.engine.fit.elimination`) follow the coefficients, :math:`\lambda = y - X \theta`, so that their covariance is

.. math:: \Sigma_\lambda = H^{-1} + X \Sigma X^T
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin

from aridcal.engine.fit.elimination import Eliminated, Groups
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.residual import linearise
from aridcal.engine.instruments.kinds import KINDS
from aridcal.engine.instruments.pixels import PLACE, R9, T
from aridcal.engine.instruments.pose import TRACKER
from aridcal.engine.instruments.setup import Things
from aridcal.engine.model.predictions import Measured
from aridcal.engine.robot.kinematics import along_plane
from aridcal.engine.rows.dataset import Dataset

Status = Literal["identified", "fixed", "redundant"]

FELT = 1e-6
"""Share of a direction that no row tells, from which a component is a part of it: less is rounding."""

NORMAL = ("nx", "ny", "nz")
"""Of a plane, as it is written down; its components are tilts about axes that nobody chose."""


@dataclass(frozen=True)
class ThingValue:
    """A number of one thing.

    Attributes:
        role: What the thing is.
        name: Its label.
        component: Which number.
        unit: Of it.
        value: Where it was found, or what is known of it; None where nothing is.
        std: 1-sigma; None unless it was identified. That of a camera's or board's place is a twist in its own axes.
        status: ``identified``; ``fixed``, as the campaign states it; or ``redundant``: no row tells it apart.
        redundant_with: What it is confounded with.
        rows: Fitted rows that refer to the thing.
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
    asked = problem(fit.model, train)
    seen = asked.measured
    solved = _solved(asked, fit)
    values: list[ThingValue] = []
    for role, things in seen.instruments.things.items():
        if things.role == TRACKER or things.role.places:
            continue  # nothing of a tracker is unknown, a fault is an effect; a head has a chapter of its own
        rows, thing = references(seen, role)
        count = np.bincount(thing[fit.weight[rows] > 0.0], minlength=len(things))
        states = asked.states[role]
        for k, name in enumerate(things.names):
            own = _by_coefficients(fit, things, name) if solved is None or not things.role.many else solved.of(role, k)
            values += _written(things, name, states[k], own, int(count[k]))
    return tuple(values)


def references(seen: Measured, role: str) -> tuple[np.ndarray, np.ndarray]:
    """Rows that refer to things of a role, and the number of the thing, shape (n,) each."""
    rows, thing = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
    for b, block in enumerate(seen.blocks):
        names = [each.name for each in KINDS[block.kind].roles]
        if role in names:
            own = np.flatnonzero(seen.block == b)
            rows.append(own)
            thing.append(seen.refers[own, names.index(role)])
    return np.concatenate(rows), np.concatenate(thing)


@dataclass(frozen=True)
class _Known:
    """Of the components of one thing: change, covariance (u, u), status, and partners of each."""

    change: np.ndarray
    covariance: np.ndarray
    status: tuple[Status, ...]
    partners: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class _Solved:
    """Groups solved for, with the covariance (K, K) of the coefficients that they follow and the names of their unknowns."""

    groups: Groups
    found: Eliminated
    covariance: np.ndarray
    members: list[list[str]]

    def of(self, role: str, k: int) -> _Known:
        """What is known of one thing."""
        slots, group = self.groups.slot[role][k], int(self.groups.group[role][k])
        u = len(slots)
        free = slots >= 0
        covariance = np.zeros((u, u))
        status: list[Status] = ["fixed"] * u
        partners: list[tuple[str, ...]] = [()] * u
        if free.any():
            own, X = slots[free], self.found.X[group]
            inverse = self.found.inverse[group][np.ix_(own, own)]
            covariance[np.ix_(free, free)] = inverse + X[own] @ self.covariance @ X[own].T
            lost = self._lost(group)
            for component in np.flatnonzero(free).tolist():
                mine = np.abs(lost[slots[component]]) > FELT
                others = (np.abs(lost[:, mine]) > FELT).any(axis=1)
                others[slots[component]] = False
                status[component] = "redundant" if mine.any() else "identified"
                partners[component] = tuple(self.members[group][j] for j in np.flatnonzero(others))
        return _Known(np.zeros(u), covariance, tuple(status), tuple(partners))

    def _lost(self, group: int) -> np.ndarray:
        """Directions of a group's unknowns that no row tells, shape (U, n)."""
        own = np.flatnonzero(self.groups.unknown[group])
        count = len(own) - int(self.found.rank[group])
        made = np.zeros((len(self.groups.unknown[group]), count))
        if count:
            inverse = self.found.inverse[group][np.ix_(own, own)]
            size = np.sqrt(np.diag(inverse))
            scale = 1.0 / np.where(size > 0.0, size, 1.0)
            vectors = np.linalg.eigh(inverse * scale[:, None] * scale)[1]
            made[own] = vectors[:, :count]
        return made


def _solved(asked: Problem, fit: Fit) -> _Solved | None:
    """The groups of a fit, solved once more where it ended; None where there are none."""
    if asked.groups is None:
        return None
    found = linearise(asked, fit.theta, fit.weight, fit.sigma).groups
    assert found is not None
    return _Solved(asked.groups, found, fit.covariance, _members(asked.measured, asked.groups))


def _members(seen: Measured, groups: Groups) -> list[list[str]]:
    """Names of the unknowns of each group, in their order."""
    names = [[""] * groups.unknown.shape[1] for _ in range(len(groups.unknown))]
    for role, slots in groups.slot.items():
        things = seen.instruments.things[role]
        for k, component in np.argwhere(slots >= 0).tolist():
            part = f"{things.names[k]}.{things.role.components[component]}"
            names[groups.group[role][k]][slots[k, component]] = part
    return names


def _by_coefficients(fit: Fit, things: Things, name: str) -> _Known:
    """What the model's own coefficients say of a thing."""
    u = len(things.role.components)
    change, covariance = np.zeros(u), np.zeros((u, u))
    number = {each: k for k, each in enumerate(fit.model.names)}
    asked = {c.name for c in fit.candidates}
    status: list[Status] = []
    partners: list[tuple[str, ...]] = []
    index = []
    for component in things.role.components:
        coefficient = f"{name}.{component}"
        index.append(number.get(coefficient, -1))
        status.append("identified" if coefficient in number else "redundant" if coefficient in asked else "fixed")
        partners.append(tuple(fit.redundant.get(coefficient, ())))
    own = np.flatnonzero(np.array(index) >= 0)
    at = np.array(index)[own]
    change[own] = fit.theta[at]
    covariance[np.ix_(own, own)] = fit.covariance[np.ix_(at, at)]
    return _Known(change, covariance, tuple(status), tuple(partners))


def _written(things: Things, name: str, state: np.ndarray, known: _Known, rows: int) -> list[ThingValue]:
    """The numbers of one thing as people read them."""
    role = things.role
    now = role.moved(state[None], known.change[None])[0]
    std = np.sqrt(np.maximum(np.diag(known.covariance), 0.0))
    components, units, values = role.components, role.units, now
    status, partners = known.status, known.partners
    if role.name == "plane":
        e1, e2 = along_plane(now[None, :3])
        turned = np.stack([np.cross(e1, now[:3])[0], np.cross(e2, now[:3])[0]], axis=1)
        spread = np.sqrt(np.maximum(np.einsum("iu,uv,iv->i", turned, known.covariance[:2, :2], turned), 0.0))
        components, units, std = (*NORMAL, "offset"), ("1", "1", "1", "m"), np.append(spread, std[2])
        tilts: Status = next((s for s in ("redundant", "identified") if s in status[:2]), "fixed")
        status = (tilts, tilts, tilts, status[2])
        partners = (partners[0], partners[0], partners[0], partners[2])
    elif components[:6] == PLACE:
        rpy = pin.rpy.matrixToRpy(now[R9].reshape(3, 3)) if np.isfinite(now[R9]).all() else np.full(3, np.nan)
        values = np.concatenate([now[T], rpy, now[R9.stop : R9.stop + len(components) - 6]])
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


def known_scale(rows: Dataset) -> float | None:
    """How well lengths that are known beforehand tell the scale of what was measured, [m/m].

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
    """How well the rows themselves then know the scale, [m/m], where it comes from known lengths between points or markers.

    Args:
        fit: A stage.
        train: The rows that it was fitted to.
    """
    beforehand = known_scale(train)
    if beforehand is None or beforehand == 0.0 or np.isinf(beforehand):
        return beforehand
    asked = problem(fit.model, train)
    solved = _solved(asked, fit)
    if solved is None:
        return beforehand
    # A change of scale moves each point by its distance from their middle: its least-squares estimate from theirs.
    weight = np.zeros(solved.groups.unknown.shape)
    squares = 0.0
    for role in ("point", "marker"):
        if role in solved.groups.slot:
            there = np.isfinite(asked.states[role]).all(axis=1) & (solved.groups.slot[role] >= 0).all(axis=1)
            own = asked.states[role][there]
            centred = own - own.mean(axis=0)
            weight[solved.groups.group[role][there][:, None], solved.groups.slot[role][there]] = centred
            squares += float(np.sum(centred**2))
    if squares == 0.0:
        return beforehand
    follows = np.einsum("gu,guk->k", weight, solved.found.X)
    own_part = np.einsum("gu,guv,gv->", weight, solved.found.inverse, weight)
    return float(np.sqrt(own_part + follows @ solved.covariance @ follows) / squares)


def _gauged(rows: Dataset) -> bool:
    """True if rows of planes read a gauge: lengths."""
    planes = [b for b, block in enumerate(rows.blocks) if block.traits.gauges]
    return bool(np.any(rows.observed[np.isin(rows.labels.block, planes), :1]))


def _of_places(things: Things) -> float:
    """Squared known lengths over their variance, of places that are known beforehand."""
    known = np.isfinite(things.start).all(axis=1) & (~things.free | np.isfinite(things.std)).all(axis=1)
    if known.sum() < 2:
        return 0.0
    variance = np.where(things.free, np.where(np.isfinite(things.std), things.std, 0.0) ** 2, 0.0)[known]
    centred = things.start[known] - things.start[known].mean(axis=0)
    if not np.any(centred):
        return 0.0
    exact = not np.all(variance > 0.0)
    return np.inf if exact else float(np.sum(centred**2 / variance))
