"""Where everything unknown begins: the target on the tip and the things around the arm, from any attitude, without a guess.

The arm is nominal and the world is its base frame. A start's worth is the residual that a few steps of least squares leave.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from aridcal.engine.instruments.descent import DescentPoint, StartView, descend, descent_point, spread, thing_states
from aridcal.engine.instruments.distance import LEAST_SINGULAR
from aridcal.engine.instruments.inclination import DOWN
from aridcal.engine.instruments.kind import MeasurementKind, Role
from aridcal.engine.instruments.pixels import ON_TIP, T, rotation_of
from aridcal.engine.instruments.pose import nearest_rotation
from aridcal.engine.instruments.setup import Things
from aridcal.engine.instruments.sighting import sighted

MOST_STARTS = 3
"""Starts that are handed on at the most: a fit of each tells which is right."""

COMPARED_THINGS_AND_ROWS = (20, 400)
"""Things, and rows of them, on which targets are compared."""

COMPARISON_STEPS = 20
"""Steps of the comparison."""

DESCENT_STEPS = 60
"""Steps of least squares from each start: an ordinary one takes ten."""

REACH, FAR = 0.2, 0.5
"""[m]: how far from the hint targets are sought, along each axis at once: to corners of cubes. From outside the true one is found
more often than from inside."""

LEAST_TRANSLATION_SHARE = 1e-3
"""[m/m]: a target translation that moves the rows by a smaller share is left at its hint."""

SAME_COST = 1.01
"""Costs that differ by less are one: the earlier start comes first, and the hint is the first of all."""

ROUNDING_COST = 1e-24
"""Mean square of a residual that is rounding."""

MOST_START_ROWS = 5000
"""Rows that a start looks at, spread evenly over all: what more of them say is left to the fit."""

GRAVITY_DIRECTIONS = np.array([v for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)]) - 1.0
GRAVITY_DIRECTIONS = GRAVITY_DIRECTIONS / np.linalg.norm(GRAVITY_DIRECTIONS, axis=1, keepdims=True)
"""Directions of gravity, 35 to 55 degrees apart, from which it is sought where the base may stand anyhow."""


def starts(
    kind: MeasurementKind,
    R: np.ndarray,
    p: np.ndarray,
    observed: np.ndarray,
    refers: np.ndarray,
    things: Mapping[str, Things],
    target: np.ndarray,
    target_known: bool,
) -> list[DescentPoint]:
    """Where a fit may begin, the best first; states are NaN for things that rows do not refer to, or cannot tell.

    Args:
        kind: Of the rows.
        R: Nominal rotations of the tip in the base frame, shape (n, 3, 3).
        p: Its positions, shape (n, 3), [m].
        observed: What was read, shape (n, W).
        refers: Numbers of the things of each role, shape (n, roles).
        things: By role; what their components hold that is not free stays as it is.
        target: T_tip_target, or a hint of it, shape (4, 4).
        target_known: True if it stays as it is.
    """
    beforehand = {role.name: things[role.name].start for role in kind.roles}
    if not len(p):
        return [DescentPoint(target, beforehand)]
    if kind.name == "inclination" and not target_known:
        return _levelled(kind, R, p, observed, target)
    if not kind.roles:
        return [DescentPoint(target, {})]
    free = {role.name: things[role.name].free for role in kind.roles}
    view = StartView(kind, R, p, observed, refers, free, moves=not (target_known or kind.bare))
    some = view.select(spread(len(p), MOST_START_ROWS))
    places = (
        sighted(some, target, beforehand, DESCENT_STEPS)
        if kind.name == "pixels"
        else _by_target(some, target, beforehand)
    )
    return [replace(place, states=_filled(view, place, beforehand)) for place in _ranked(places)]


def _ranked(places: list[DescentPoint]) -> list[DescentPoint]:
    """The best places, each once; those with equal costs in their order."""
    least = min(place.cost for place in places)
    order = sorted(places, key=lambda place: 0.0 if place.cost <= SAME_COST * least + ROUNDING_COST else place.cost)
    distinct: list[DescentPoint] = []
    for place in order:
        if not any(_same(place, other) for other in distinct):
            distinct.append(place)
    return distinct[:MOST_STARTS]


def _same(one: DescentPoint, other: DescentPoint) -> bool:
    """True of two places that a fit would not tell apart: within a micrometre and a microradian."""
    pairs = [(one.target, other.target)] + [(one.states[name], other.states[name]) for name in one.states]
    return all(np.allclose(a, b, atol=1e-6, equal_nan=True) for a, b in pairs)


def _filled(view: StartView, place: DescentPoint, beforehand: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """States in which also those things of the last role are located whose rows were not among the compared ones."""
    role = view.kind.roles[-1]
    lacking = ~np.isfinite(place.states[role.name]).all(axis=1)
    if not lacking[view.refers[:, -1]].any():
        return place.states
    return thing_states(view, place.target, place.states, np.flatnonzero(lacking), beforehand[role.name])


def _by_target(view: StartView, target: np.ndarray, beforehand: dict[str, np.ndarray]) -> list[DescentPoint]:
    """Places for target translations, of which the things follow by their own rows; hints first.

    All are compared after a few steps on some of the rows, the best taken further on all.
    """
    levers = [target[:3, 3]]
    if view.moves:
        levers += LINEAR_LEVERS[view.kind.name](view, target[:3, 3], beforehand[view.kind.roles[-1].name])
        levers += [] if view.kind.name == "point" else [target[:3, 3] + step for step in _steps()]
    few = _few(view)
    trials = [_from_lever(few, target, lever, beforehand) for lever in levers]
    if view.complete(beforehand).all():
        trials.insert(0, descent_point(few, target, beforehand))
    compared = _ranked([descend(few, place, COMPARISON_STEPS) for place in trials])
    places = []
    for place in compared:
        start = place if len(few) == len(view) else _from_lever(view, target, place.target[:3, 3], beforehand)
        places.append(descend(view, start, DESCENT_STEPS))
    return places


def _steps() -> np.ndarray:
    """Steps to targets that are tried, shape (16, 3), [m]: corners of a cube for ordinary tools, and of one for long ones."""
    corners = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T
    return np.vstack([REACH * corners, FAR * corners])


def _few(view: StartView) -> StartView:
    """Some of the rows, of the things that have the most."""
    things, rows = COMPARED_THINGS_AND_ROWS
    thing = view.refers[:, -1]
    most = np.argsort(-np.bincount(thing), kind="stable")[:things]
    some = np.flatnonzero(np.isin(thing, most))
    return view.select(some[spread(len(some), rows)])


def _from_lever(
    view: StartView, target: np.ndarray, lever: np.ndarray, beforehand: dict[str, np.ndarray]
) -> DescentPoint:
    """The place that a target translation gives, shape (3,)."""
    name = view.kind.roles[-1].name
    labels = np.unique(view.refers[:, -1])
    unknown = labels[~np.isfinite(beforehand[name][labels]).all(axis=1) | view.free[name][labels].any(axis=1)]
    new = target.copy()
    new[:3, 3] = lever
    return descent_point(view, new, thing_states(view, new, beforehand, unknown, beforehand[name]))


def _touched_levers(view: StartView, hint: np.ndarray, beforehand: np.ndarray) -> list[np.ndarray]:
    """Translations t for which p + R t falls on one place for each point: linear; on the point itself where it is known."""
    point = view.refers[:, -1]
    A, b = view.R.copy(), -(view.p + view.R @ hint)
    fixed = (np.isfinite(beforehand).all(axis=1) & ~view.free[view.kind.roles[-1].name].any(axis=1))[point]
    b[fixed] += beforehand[point[fixed]]
    both = np.concatenate([A.reshape(-1, 9), b], axis=1)
    total = np.zeros((len(beforehand), 12))
    np.add.at(total, point, both)
    mean = total[point] / np.bincount(point)[point, None]
    A[~fixed] -= mean[~fixed, :9].reshape(-1, 3, 3)
    b[~fixed] -= mean[~fixed, 9:]
    U, moves, Vt = np.linalg.svd(A.reshape(-1, 3), full_matrices=False)
    along = U.T @ b.ravel()
    clear = moves > LEAST_TRANSLATION_SHARE * np.sqrt(len(view))
    return [hint + Vt.T @ (np.where(clear, along, 0.0) / np.where(clear, moves, 1.0))]


def _ranged_levers(view: StartView, hint: np.ndarray, beforehand: np.ndarray) -> list[np.ndarray]:
    r"""Translations from squared readings, which are linear in t, a, a t', the offset o and one constant, for each anchor.

    .. math:: |p|^2 - \rho^2 = 2 p \cdot a - 2 p \cdot R t + 2 R : (a t^T) - 2 \rho o - c
    """
    levers = []
    for label in np.unique(view.refers[:, -1]):
        rows = view.refers[:, -1] == label
        R, p, reading = view.R[rows], view.p[rows], view.observed[rows, 0]
        scale = beforehand[label, 4] if np.isfinite(beforehand[label, 4]) else 1.0
        ranges = reading / scale
        turned = np.einsum("nji,nj->ni", R, p)
        A = np.column_stack([-2 * turned, 2 * p, 2 * R.reshape(-1, 9), -2 * ranges, -np.ones(len(p))])
        levers += _first_three(A, np.sum(p**2, axis=1) - ranges**2)
    return levers


def _planar_levers(view: StartView, hint: np.ndarray, beforehand: np.ndarray) -> list[np.ndarray]:
    r"""Translations from n.p + R : (n t') - d - s reading = 0, linear and homogeneous in n, n t', d and s, for each plane."""
    levers = []
    for label in np.unique(view.refers[:, -1]):
        rows = view.refers[:, -1] == label
        R, p = view.R[rows], view.p[rows]
        A = np.column_stack([p, R.reshape(-1, 9), -np.ones(len(p))])
        A = np.column_stack([A, -view.observed[rows]]) if view.observed[rows].any() else A
        if len(A) < A.shape[1]:
            continue
        size = np.linalg.norm(A, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        null = np.linalg.svd(A / size)[2][-1] / size
        length = np.linalg.norm(null[:3])
        if length > LEAST_TRANSLATION_SHARE * np.linalg.norm(null):
            levers.append(null[3:12].reshape(3, 3).T @ null[:3] / length**2)
    return levers


def _first_three(A: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    """The first three unknowns of linear equations; none where the equations are fewer than the unknowns."""
    if len(A) < A.shape[1]:
        return []
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    return [(np.linalg.lstsq(A / size, b, rcond=1e-9)[0] / size)[:3]]


Levers = Callable[[StartView, np.ndarray, np.ndarray], list[np.ndarray]]

LINEAR_LEVERS: dict[str, Levers] = {"point": _touched_levers, "distance": _ranged_levers, "plane": _planar_levers}
"""Target translations that follow from linear equations, from the rows, a hint and the states that are known."""


def _levelled(
    kind: MeasurementKind, R: np.ndarray, p: np.ndarray, observed: np.ndarray, target: np.ndarray
) -> list[DescentPoint]:
    """Starts whose rotation carries the measured directions to gravity's in the tip (Kabsch): gravity down, or sought as well.

    What nothing turns (a tip that gravity always meets from one side) stays as the hint has it.
    """
    directions = observed / np.linalg.norm(observed, axis=1, keepdims=True)

    def turned(gravity: np.ndarray) -> np.ndarray:
        """The target's frame where gravity is known in the base frame."""
        frame = target.copy()
        in_tip = np.einsum("nji,j->ni", R, gravity)
        frame[:3, :3] = nearest_rotation(in_tip.T @ directions + 1e-6 * target[:3, :3])
        return frame

    best, least = turned(DOWN), np.inf
    for gravity in GRAVITY_DIRECTIONS:
        for _ in range(DESCENT_STEPS):
            frame = turned(gravity)
            felt = np.einsum("nij,nj->ni", R @ frame[:3, :3], directions)
            gravity = felt.mean(axis=0) / np.linalg.norm(felt.mean(axis=0))
        spread = float(np.mean(np.sum((felt - gravity) ** 2, axis=1)))
        if spread < least:
            best, least = frame, spread
    return [DescentPoint(turned(DOWN), {}), DescentPoint(best, {})]


def aligned(role: Role, base_states: np.ndarray, world_states: np.ndarray) -> np.ndarray | None:
    """T_world_base, shape (4, 4), that carries things from where they are in the base frame to where they are in the world.

    Points, anchors and markers need three that are not on a line, planes three whose normals are not across one line; planes
    are taken with the sides that their normals show. A board, or a camera that stands in the world, is enough alone.

    Args:
        role: Of the things.
        base_states: Their states in the base frame, shape (L, P); things with a NaN are left out.
        world_states: In the world, shape (L, P); likewise.

    Returns:
        None where these things do not determine it.
    """
    size = {"plane": 4, "board": 12, "camera": 12}.get(role.name, 3)
    both = np.isfinite(base_states[:, :size]).all(axis=1) & np.isfinite(world_states[:, :size]).all(axis=1)
    in_base, in_world = base_states[both], world_states[both]
    if role.name == "camera":
        off_arm = in_base[:, ON_TIP] < 0.5
        in_base, in_world = in_base[off_arm], in_world[off_arm]
    if role.name in ("board", "camera"):
        return _by_frames(in_base, in_world)
    return _by_planes(in_base, in_world) if role.name == "plane" else _by_points(in_base[:, :3], in_world[:, :3])


def _by_frames(in_base: np.ndarray, in_world: np.ndarray) -> np.ndarray | None:
    """T_world_base from frames: the mean of their rotations, and of their origins' remaining shifts."""
    if not len(in_base):
        return None
    turned = rotation_of(in_world) @ np.swapaxes(rotation_of(in_base), 1, 2)
    R = nearest_rotation(turned.sum(axis=0))
    return pin.SE3(R, (in_world[:, T] - in_base[:, T] @ R.T).mean(axis=0)).homogeneous


def _by_points(in_base: np.ndarray, in_world: np.ndarray) -> np.ndarray | None:
    """T_world_base from points (Kabsch)."""
    if len(in_base) < 3:
        return None
    middle, centre = in_base.mean(axis=0), in_world.mean(axis=0)
    H = (in_world - centre).T @ (in_base - middle)
    sizes = np.linalg.svd(in_world - centre, compute_uv=False)
    if sizes[1] <= LEAST_SINGULAR * sizes[0] or not H.any():
        return None
    R = nearest_rotation(H)
    return pin.SE3(R, centre - R @ middle).homogeneous


def _by_planes(in_base: np.ndarray, in_world: np.ndarray) -> np.ndarray | None:
    """T_world_base from planes: normals turn by R, and offsets grow by what the base's place is along the normal."""
    if len(in_base) < 3 or np.linalg.svd(in_world[:, :3], compute_uv=False)[2] <= LEAST_SINGULAR:
        return None
    R = nearest_rotation(in_world[:, :3].T @ in_base[:, :3])
    p = np.linalg.lstsq(in_world[:, :3], in_world[:, 3] - in_base[:, 3], rcond=None)[0]
    return pin.SE3(R, p).homogeneous
