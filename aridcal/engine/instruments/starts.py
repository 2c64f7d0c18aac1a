"""Where everything unknown begins: the target on the tip and the things around the arm, from any attitude, without a guess.

The arm is nominal and the world is its base frame. A start's worth is the residual that a few steps of least squares leave.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from aridcal.engine.instruments.descent import Place, View, descend, located, placed, spread
from aridcal.engine.instruments.distance import PLAIN
from aridcal.engine.instruments.inclination import DOWN
from aridcal.engine.instruments.kind import Kind, Role
from aridcal.engine.instruments.pixels import ON_TIP, T, rotation_of
from aridcal.engine.instruments.pose import nearest_rotation
from aridcal.engine.instruments.setup import Things
from aridcal.engine.instruments.sighting import sighted

BEST = 3
"""Starts that are handed on: a fit of each tells which is right."""

LOOKED_AT = (20, 400)
"""Things, and rows of them, on which targets are compared."""

FEW = 20
"""Steps of the comparison."""

STEPS = 60
"""Of least squares from each: an ordinary start takes ten."""

REACH, FAR = 0.2, 0.5
"""[m]: how far from the hint targets are sought, along each axis at once: to corners of cubes. From outside the true one is found
more often than from inside."""

FREE = 1e-3
"""[m/m]: a target translation that moves the rows by a smaller share is left at its hint."""

ALIKE = 1.01
"""Costs that differ by less are one: the earlier start comes first, and the hint is the first of all."""

ROUNDING = 1e-24
"""Mean square of a residual that is rounding."""

MOST = 5000
"""Rows that a start looks at, spread evenly over all: what more of them say is left to the fit."""

DIRECTIONS = np.array([v for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)]) - 1.0
DIRECTIONS = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
"""Of gravity, 35 to 55 degrees apart, from which it is sought where the base may stand anyhow."""


def starts(
    kind: Kind,
    R: np.ndarray,
    p: np.ndarray,
    observed: np.ndarray,
    refers: np.ndarray,
    things: Mapping[str, Things],
    target: np.ndarray,
    target_known: bool,
) -> list[Place]:
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
    known = {role.name: things[role.name].start for role in kind.roles}
    if not len(p):
        return [Place(target, known)]
    if kind.name == "inclination" and not target_known:
        return _levelled(kind, R, p, observed, target)
    if not kind.roles:
        return [Place(target, {})]
    free = {role.name: things[role.name].free for role in kind.roles}
    view = View(kind, R, p, observed, refers, free, moves=not (target_known or kind.bare))
    some = view.select(spread(len(p), MOST))
    found = sighted(some, target, known, STEPS) if kind.name == "pixels" else _by_target(some, target, known)
    return [replace(place, states=_filled(view, place, known)) for place in _ranked(found)]


def _ranked(places: list[Place]) -> list[Place]:
    """The best, those with equal costs in their order, each once."""
    least = min(place.cost for place in places)
    order = sorted(places, key=lambda place: 0.0 if place.cost <= ALIKE * least + ROUNDING else place.cost)
    kept: list[Place] = []
    for place in order:
        if not any(_same(place, other) for other in kept):
            kept.append(place)
    return kept[:BEST]


def _same(one: Place, other: Place) -> bool:
    """True of two places that a fit would not tell apart: within a micrometre and a microradian."""
    pairs = [(one.target, other.target)] + [(one.states[name], other.states[name]) for name in one.states]
    return all(np.allclose(a, b, atol=1e-6, equal_nan=True) for a, b in pairs)


def _filled(view: View, place: Place, known: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """States with those things of the last role that only rows refer to which were not looked at, or that were left out."""
    role = view.kind.roles[-1]
    lacking = ~np.isfinite(place.states[role.name]).all(axis=1)
    if not lacking[view.refers[:, -1]].any():
        return place.states
    return located(view, place.target, place.states, np.flatnonzero(lacking), known[role.name])


def _by_target(view: View, target: np.ndarray, known: dict[str, np.ndarray]) -> list[Place]:
    """Places for target translations, of which the things follow by their own rows; hints first.

    All are compared after a few steps on some of the rows, the best taken further on all.
    """
    levers = [target[:3, 3]]
    if view.moves:
        levers += LINEAR[view.kind.name](view, target[:3, 3], known[view.kind.roles[-1].name])
        levers += [] if view.kind.name == "point" else [target[:3, 3] + step for step in _steps()]
    few = _few(view)
    tried = [_from_lever(few, target, lever, known) for lever in levers]
    if view.complete(known).all():
        tried.insert(0, placed(few, target, known))
    compared = _ranked([descend(few, place, FEW) for place in tried])
    found = []
    for place in compared:
        whole = place if len(few) == len(view) else _from_lever(view, target, place.target[:3, 3], known)
        found.append(descend(view, whole, STEPS))
    return found


def _steps() -> np.ndarray:
    """Steps to targets that are tried, shape (16, 3), [m]: corners of a cube for ordinary tools, and of one for long ones."""
    corners = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T
    return np.vstack([REACH * corners, FAR * corners])


def _few(view: View) -> View:
    """Some of the rows, of the things that have the most."""
    things, rows = LOOKED_AT
    own = view.refers[:, -1]
    most = np.argsort(-np.bincount(own), kind="stable")[:things]
    some = np.flatnonzero(np.isin(own, most))
    return view.select(some[spread(len(some), rows)])


def _from_lever(view: View, target: np.ndarray, lever: np.ndarray, known: dict[str, np.ndarray]) -> Place:
    """The place that a target translation gives, shape (3,)."""
    name = view.kind.roles[-1].name
    labels = np.unique(view.refers[:, -1])
    unknown = labels[~np.isfinite(known[name][labels]).all(axis=1) | view.free[name][labels].any(axis=1)]
    moved = target.copy()
    moved[:3, 3] = lever
    return placed(view, moved, located(view, moved, known, unknown, known[name]))


def _touched_levers(view: View, hint: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    """Translations t for which p + R t falls on one place for each point: linear; on the point itself where it is known."""
    own = view.refers[:, -1]
    A, b = view.R.copy(), -(view.p + view.R @ hint)
    held = (np.isfinite(known).all(axis=1) & ~view.free[view.kind.roles[-1].name].any(axis=1))[own]
    b[held] += known[own[held]]
    both = np.concatenate([A.reshape(-1, 9), b], axis=1)
    total = np.zeros((len(known), 12))
    np.add.at(total, own, both)
    mean = total[own] / np.bincount(own)[own, None]
    A[~held] -= mean[~held, :9].reshape(-1, 3, 3)
    b[~held] -= mean[~held, 9:]
    U, moves, Vt = np.linalg.svd(A.reshape(-1, 3), full_matrices=False)
    along = U.T @ b.ravel()
    clear = moves > FREE * np.sqrt(len(view))
    return [hint + Vt.T @ (np.where(clear, along, 0.0) / np.where(clear, moves, 1.0))]


def _ranged_levers(view: View, hint: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    r"""Translations from squared readings, which are linear in t, a, a t', the offset o and one constant, for each anchor.

    .. math:: |p|^2 - \rho^2 = 2 p \cdot a - 2 p \cdot R t + 2 R : (a t^T) - 2 \rho o - c
    """
    found = []
    for label in np.unique(view.refers[:, -1]):
        rows = view.refers[:, -1] == label
        R, p, reading = view.R[rows], view.p[rows], view.observed[rows, 0]
        scale = known[label, 4] if np.isfinite(known[label, 4]) else 1.0
        ranges = reading / scale
        turned = np.einsum("nji,nj->ni", R, p)
        A = np.column_stack([-2 * turned, 2 * p, 2 * R.reshape(-1, 9), -2 * ranges, -np.ones(len(p))])
        found += _whole(A, np.sum(p**2, axis=1) - ranges**2)
    return found


def _planar_levers(view: View, hint: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    r"""Translations from n.p + R : (n t') - d - s reading = 0, linear and homogeneous in n, n t', d and s, for each plane."""
    found = []
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
        if length > FREE * np.linalg.norm(null):
            found.append(null[3:12].reshape(3, 3).T @ null[:3] / length**2)
    return found


def _whole(A: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    """The first three unknowns of equations that are enough for all of them."""
    if len(A) < A.shape[1]:
        return []
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    return [(np.linalg.lstsq(A / size, b, rcond=1e-9)[0] / size)[:3]]


Levers = Callable[[View, np.ndarray, np.ndarray], list[np.ndarray]]

LINEAR: dict[str, Levers] = {"point": _touched_levers, "distance": _ranged_levers, "plane": _planar_levers}
"""Target translations that follow from linear equations, from the rows, a hint and the states that are known."""


def _levelled(kind: Kind, R: np.ndarray, p: np.ndarray, observed: np.ndarray, target: np.ndarray) -> list[Place]:
    """Rotations that carry the directions that were read to gravity's in the tip (Kabsch): gravity down, or from the rows too.

    What nothing turns (a tip that gravity always meets from one side) stays as the hint has it.
    """
    read = observed / np.linalg.norm(observed, axis=1, keepdims=True)

    def turned(gravity: np.ndarray) -> np.ndarray:
        """The target's frame where gravity is known in the base frame."""
        made = target.copy()
        in_tip = np.einsum("nji,j->ni", R, gravity)
        made[:3, :3] = nearest_rotation(in_tip.T @ read + 1e-6 * target[:3, :3])
        return made

    best, least = turned(DOWN), np.inf
    for gravity in DIRECTIONS:
        for _ in range(STEPS):
            made = turned(gravity)
            felt = np.einsum("nij,nj->ni", R @ made[:3, :3], read)
            gravity = felt.mean(axis=0) / np.linalg.norm(felt.mean(axis=0))
        spread = float(np.mean(np.sum((felt - gravity) ** 2, axis=1)))
        if spread < least:
            best, least = made, spread
    return [Place(turned(DOWN), {}), Place(best, {})]


def aligned(role: Role, located: np.ndarray, known: np.ndarray) -> np.ndarray | None:
    """T_world_base, shape (4, 4), that carries things from where they are in the base frame to where they are in the world.

    Points, anchors and markers need three that are not on a line, planes three whose normals are not across one line; planes
    are taken with the sides that their normals show. A board, or a camera that stands in the world, is enough alone.

    Args:
        role: Of the things.
        located: Their states in the base frame, shape (L, P); things with a NaN are left out.
        known: In the world, shape (L, P); likewise.

    Returns:
        None where these things do not determine it.
    """
    size = {"plane": 4, "board": 12, "camera": 12}.get(role.name, 3)
    both = np.isfinite(located[:, :size]).all(axis=1) & np.isfinite(known[:, :size]).all(axis=1)
    here, there = located[both], known[both]
    if role.name == "camera":
        standing = here[:, ON_TIP] < 0.5
        here, there = here[standing], there[standing]
    if role.name in ("board", "camera"):
        return _by_frames(here, there)
    return _by_planes(here, there) if role.name == "plane" else _by_points(here[:, :3], there[:, :3])


def _by_frames(here: np.ndarray, there: np.ndarray) -> np.ndarray | None:
    """From frames: the mean of their rotations, and of what is left of their origins."""
    if not len(here):
        return None
    turned = rotation_of(there) @ np.swapaxes(rotation_of(here), 1, 2)
    R = nearest_rotation(turned.sum(axis=0))
    return pin.SE3(R, (there[:, T] - here[:, T] @ R.T).mean(axis=0)).homogeneous


def _by_points(here: np.ndarray, there: np.ndarray) -> np.ndarray | None:
    """From points (Kabsch)."""
    if len(here) < 3:
        return None
    middle, shown = here.mean(axis=0), there.mean(axis=0)
    H = (there - shown).T @ (here - middle)
    sizes = np.linalg.svd(there - shown, compute_uv=False)
    if sizes[1] <= PLAIN * sizes[0] or not H.any():
        return None
    R = nearest_rotation(H)
    return pin.SE3(R, shown - R @ middle).homogeneous


def _by_planes(here: np.ndarray, there: np.ndarray) -> np.ndarray | None:
    """From planes: normals turn by R, and offsets grow by what the base's place is along the normal."""
    if len(here) < 3 or np.linalg.svd(there[:, :3], compute_uv=False)[2] <= PLAIN:
        return None
    R = nearest_rotation(there[:, :3].T @ here[:, :3])
    p = np.linalg.lstsq(there[:, :3], there[:, 3] - here[:, 3], rcond=None)[0]
    return pin.SE3(R, p).homogeneous
