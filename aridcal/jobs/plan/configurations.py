"""Configurations that could be measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.inclination import DOWN
from aridcal.engine.instruments.pixels import ends_of_sight, faces, in_image
from aridcal.engine.inverse.reachable import Miss, brought, draw_readings, off_the_limits
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.robot.chain import Route
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.engine.rows.dataset import Dataset
from aridcal.jobs.plan.beforehand import Beforehand
from aridcal.jobs.plan.clearance import clear, unobstructed
from aridcal.jobs.plan.mounting import stands_above
from aridcal.system.errors import CampaignError

ROUNDS = 40
"""Times that configurations are drawn: fewer than one in forty inside what is allowed is hardly a workspace."""

AT_ONCE = 3000
"""Configurations that are drawn at a time, where only some of them can be measured."""

FEWEST = 4
"""Markers that an image must show, or all if there are fewer: a pose needs three, and one more to check."""


STUB = 0.03
"""[m] of a line of sight at the target that nothing obstructs: the target's own mount stands there."""


@dataclass(frozen=True)
class Offers:
    """What may be measured in a configuration: one choice of pattern rows, measured together, for each.

    Attributes:
        patterns: Numbers of the pattern rows of each.
        titles: Labels of each that its row has, by the name of their column.
    """

    patterns: tuple[np.ndarray, ...]
    titles: tuple[dict[str, str], ...]


@dataclass(frozen=True)
class Candidates:
    """Configurations that could be measured, C of them.

    Attributes:
        readings: Shape (C, columns), [rad] or [m].
        sides: From which each joint comes to its reading, -1 or 1, shape (C, columns).
        offer: Number of what is measured in each, shape (C,).
        pattern: Pattern of each of their rows, N rows in all, shape (N,).
        of: Candidate that each row belongs to, in ascending order, shape (N,).
    """

    readings: np.ndarray
    sides: np.ndarray
    offer: np.ndarray
    pattern: np.ndarray
    of: np.ndarray

    def some(self, numbers: Sequence[int] | np.ndarray) -> Candidates:
        """Some of them, one after the other; any of them more than once."""
        n = np.asarray(numbers, dtype=int)
        first, end = (np.searchsorted(self.of, n, side) for side in ("left", "right"))
        rows = np.concatenate([np.arange(a, b) for a, b in zip(first.tolist(), end.tolist(), strict=True)])
        of = np.repeat(np.arange(len(n)), end - first)
        return Candidates(self.readings[n], self.sides[n], self.offer[n], self.pattern[rows], of)

    @property
    def first(self) -> np.ndarray:
        """Pattern of each one's first row, shape (C,)."""
        return np.asarray(self.pattern[np.searchsorted(self.of, np.arange(len(self.readings)))])

    def rows(self, known: Beforehand) -> Dataset:
        """Their rows as a data set; what they would read is of no account."""
        made = rows_like(known, self.readings[self.of], self.pattern)
        names = tuple(f"{name}_direction" for name in made.names)
        covariates = made.covariates | dict(zip(names, self.sides[self.of].T, strict=True))
        return replace(made, covariates=covariates).with_origin(derived=names)


def offers(known: Beforehand) -> Offers:
    """What one configuration may measure: a target, a touch of a point, all markers in one image."""
    rows = known.patterns
    n, kind = len(rows), known.campaign.measurements.traits
    if kind.images:
        cameras = rows.labels.refers[:, 0]
        names = np.unique(cameras)
        return Offers(
            tuple(np.flatnonzero(cameras == name) for name in names), tuple({"camera": str(name)} for name in names)
        )
    target = rows.labels.target
    several = target is not None and (kind.tracked or len(np.unique(target)) > 1)
    titles: list[dict[str, str]] = []
    for k in range(n):
        own = {"target": str(target[k])} if several and target is not None else {}
        if rows.labels.refers[k, 0] and not kind.tracked:
            own |= {kind.roles[0].name: str(rows.labels.refers[k, 0])}
        own |= {} if rows.labels.station is None else {"station": str(rows.labels.station[k])}
        titles.append(own)
    return Offers(tuple(np.array([k]) for k in range(n)), tuple(titles))


def rows_like(known: Beforehand, readings: np.ndarray, pattern: np.ndarray) -> Dataset:
    """Rows of other readings.

    Args:
        known: Has the patterns.
        readings: Shape (N, columns), [rad] or [m].
        pattern: Number of each row's pattern, shape (N,).
    """
    made = replace(known.patterns.select(pattern), readings=readings)
    kind = known.campaign.measurements.traits
    if made.direct or not (kind.tracked or kind.level):
        return made
    # turns are compared with what was seen
    R, p = known.model.poses(known.theta, rows_of_data(known.model, made, readings))
    seen = np.swapaxes(R, 1, 2) @ DOWN if kind.level else np.hstack([p, R.reshape(-1, 9)])
    return replace(made, observed=_as_wide(seen, made.observed.shape[1]))


def _as_wide(values: np.ndarray, width: int) -> np.ndarray:
    """Columns cut off, or filled up with zeros, to so many."""
    wide = np.zeros((len(values), width))
    wide[:, : values.shape[1]] = values[:, :width]
    return wide


def targets_of(known: Beforehand, readings: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the targets in the world, (n, 3, 3) and (n, 3), [m]; see :func:`rows_like`."""
    made = known.patterns.select(pattern)
    return known.model.poses(known.theta, rows_of_data(known.model, made, readings))


def in_base(known: Beforehand, readings: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the targets in the robot's base, (n, 3, 3) and (n, 3), [m]; see :func:`rows_like`."""
    made = known.patterns.select(pattern)
    rows = rows_of_data(known.model, made, readings)
    R, p = known.model.poses(known.theta, rows)
    base = [known.model.frames(known.theta)[0][k][1] for k in rows.world.tolist()]
    turn = np.array([frame.rotation for frame in base]).reshape(-1, 3, 3)
    off = p - np.array([frame.translation for frame in base]).reshape(-1, 3)
    found = np.swapaxes(turn, 1, 2) @ R, np.einsum("nji,nj->ni", turn, off)
    for some, route in _by_route(known, pattern):
        if route.start is not None:  # such rows are of what the target is to a link
            limb = known.robot.between(None, route.start)
            axes, origin = tip_frames(limb, readings[some][:, known.robot.columns_of(limb)])
            found[0][some], found[1][some] = axes @ R[some], origin + np.einsum("nij,nj->ni", axes, p[some])
    return found


def ends(known: Beforehand) -> list[int]:
    """Patterns of which the targets are to be known: the first of each path."""
    route = known.patterns.labels.route
    return [0] if route is None else sorted(np.unique(route, return_index=True)[1].tolist())


def _by_route(known: Beforehand, pattern: np.ndarray) -> Iterator[tuple[np.ndarray | slice, Route]]:
    """Which of some rows take which path; see :func:`rows_like`."""
    routes, route = known.patterns.labels.routes, known.patterns.labels.route
    if route is None:
        yield slice(None), routes[0]
        return
    for k in np.unique(route[pattern]).tolist():
        yield np.flatnonzero(route[pattern] == k), routes[k]


def allowed(known: Beforehand, readings: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """True of configurations in which the arm keeps clear, shape (n,); see :func:`rows_like`."""
    own = in_base(known, readings, pattern)[1]
    good = np.empty(len(readings), dtype=bool)
    for some, route in _by_route(known, pattern):
        good[some] = clear(known.robot, known.boxes, known.bodies, readings[some], own[some], route.end)
    return good & stands_above(known.robot, known.side, readings, own) if known.side else good


def in_sight(known: Beforehand, readings: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """True of configurations in which the instrument sees the target, shape (n,); see :func:`rows_like`."""
    sight = known.campaign.design.sight
    if sight is None or not len(readings):
        return np.ones(len(readings), dtype=bool)
    R, p = in_base(known, readings, pattern)
    away = np.array(sight.at) - p
    length = np.linalg.norm(away, axis=1)
    good = length > STUB
    if sight.axis is not None and sight.within is not None:
        axis = R @ (np.array(sight.axis) / np.linalg.norm(sight.axis))
        good &= np.sum(axis * away, axis=1) >= np.cos(sight.within) * length
    ends = p[good] + away[good] * (STUB / length[good])[:, None]
    starts = np.broadcast_to(np.array(sight.at), ends.shape)
    boxes = known.boxes
    good[good] = unobstructed(known.robot, boxes, known.bodies, readings[good], starts, ends)
    return good


def draw_candidates(known: Beforehand, count: int, least: int, rng: np.random.Generator) -> Candidates:
    """Configurations drawn from the joints' ranges that can be measured, of each offer as many.

    Args:
        known: What can be measured.
        count: How many, if there are so many.
        least: How many at least.
        rng: Draws them.

    Raises:
        CampaignError: hardly any can.
    """
    choices = offers(known)
    each, fewest = (-(-number // len(choices.patterns)) for number in (count, least))
    parts = [_of_offer(known, own, each, fewest, rng) for own in choices.patterns]
    readings = np.concatenate([part.readings for part in parts])
    starts = np.cumsum([0, *(len(part.readings) for part in parts)])[:-1]
    return Candidates(
        readings=readings,
        sides=rng.choice([-1.0, 1.0], readings.shape),
        offer=np.repeat(np.arange(len(parts)), [len(part.readings) for part in parts]),
        pattern=np.concatenate([part.pattern for part in parts]),
        of=np.concatenate([part.of + start for part, start in zip(parts, starts.tolist(), strict=True)]),
    )


def _of_offer(known: Beforehand, own: np.ndarray, count: int, least: int, rng: np.random.Generator) -> Candidates:
    """Configurations for one choice of what is measured."""
    found: list[np.ndarray] = []
    shown: list[np.ndarray] = []
    many, drawn = 0, max(count, AT_ONCE) if len(own) > 1 else count
    for _ in range(ROUNDS):
        readings = _drawn(known, int(own[0]), drawn, rng)
        seen = _seen(known, readings, own)
        good = _enough(known, seen, own)
        for holds in (allowed, in_sight):
            good[good] = holds(known, readings[good], np.full(int(good.sum()), own[0]))
        found.append(readings[good])
        shown.append(seen[good])
        many += int(good.sum())
        if many >= count:
            break
    if many < least:
        raise CampaignError(
            f"{known.campaign.path}: of {ROUNDS * drawn:,} configurations only {many} can be measured inside the joints' limits: "
            "check `design.keep_out` and `design.sight`, and what `instruments` says of cameras and markers"
        )
    count = min(count, many)
    of, column = np.nonzero(np.concatenate(shown)[:count])
    readings = np.concatenate(found)[:count]
    return Candidates(readings, np.ones_like(readings), np.zeros(count, dtype=int), own[column], of)


def _drawn(known: Beforehand, pattern: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Readings with which the target is where a measurement of one pattern needs it, shape (count, columns)."""
    rows = known.patterns
    kind = known.campaign.measurements.traits
    if not (kind.touches or kind.gauges or kind.joins):
        return draw_readings(known.robot, count, rng, off_the_limits)
    role = kind.roles[0].name
    things = known.model.instruments.things[role]
    number = things.names.index(str(rows.labels.refers[pattern, 0]))
    state: np.ndarray = known.model.states.get(role, things.start)[number]

    def miss(R: np.ndarray, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
        if kind.joins:
            return kind.residual(R, p, np.zeros((len(p), 0)), [np.tile(state, (len(p), 1))])
        return p - state if kind.touches else p @ state[:3, None] - state[3]

    advice = f"move {role} {rows.labels.refers[pattern, 0]} nearer to the arm, or say better where it is"
    return reaching(known, pattern, miss, count, rng, advice)


def reaching(
    known: Beforehand, pattern: int, miss: Miss, count: int, rng: np.random.Generator, advice: str
) -> np.ndarray:
    """Readings that bring the target of a pattern where it is missed by nothing, shape (count, columns)."""

    def pose(readings: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return targets_of(known, readings, np.full(len(readings), pattern))

    return brought(known.robot, pose, miss, count, rng, str(known.campaign.path), advice)


def _seen(known: Beforehand, readings: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Which of an offer's patterns each configuration measures, shape (n, patterns) bool."""
    n, m = len(readings), len(own)
    if not known.campaign.measurements.traits.images or n == 0:
        return np.ones((n, m), dtype=bool)
    asked = problem(known.model, rows_like(known, np.repeat(readings[:1], m, axis=0), own))
    refers = asked.measured.refers
    states = [
        np.tile(asked.states[role.name][refers[:, k]], (n, 1))
        for k, role in enumerate(known.campaign.measurements.traits.roles)
    ]
    turns, places = np.empty((n, m, 3, 3)), np.empty((n, m, 3))
    for some, _ in _by_route(known, own):  # markers of one path see the camera alike
        seen_from = targets_of(known, readings, np.full(n, own[some][0]))
        turns[:, some], places[:, some] = (each[:, None] for each in seen_from)
    R, p = turns.reshape(-1, 3, 3), places.reshape(-1, 3)
    camera = known.campaign.instruments.cameras[str(known.patterns.labels.refers[own[0], 0])]
    size = np.array([camera.width, camera.height], dtype=float)
    seen = in_image(R, p, states, size)
    if known.campaign.instruments.boards:
        seen &= faces(R, p, states[0], states[1])
    few = ~_enough(known, seen.reshape(n, m), own)
    some = np.flatnonzero(seen & ~np.repeat(few, m))
    if len(some):
        at_sight = ends_of_sight(R[some], p[some], [state[some] for state in states])
        rows = np.repeat(readings, m, axis=0)[some]
        starts, ends = (_to_base(known, np.tile(own, n)[some], rows, at) for at in at_sight)
        short = STUB / np.maximum(np.linalg.norm(ends - starts, axis=1), 2 * STUB)[:, None]
        starts, ends = starts + short * (ends - starts), ends + short * (starts - ends)
        boxes = known.boxes
        seen[some] = unobstructed(known.robot, boxes, known.bodies, rows, starts, ends)
    return seen.reshape(n, m)


def _enough(known: Beforehand, seen: np.ndarray, own: np.ndarray) -> np.ndarray:
    """True of images that show enough of what one link carries, shape (n,), from which markers each shows, (n, patterns)."""
    good = np.zeros(len(seen), dtype=bool)
    for some, _ in _by_route(known, own):
        good |= seen[:, some].sum(axis=1) >= min(FEWEST, len(own[some]))
    return good


def _to_base(known: Beforehand, pattern: np.ndarray, readings: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Places where paths start, in the world or on links, as the base has them, shape (n, 3), [m]; see :func:`rows_like`."""
    world = rows_of_data(known.model, known.patterns.select(pattern[:1])).world[0]
    frame = known.model.frames(known.theta)[0][world][1]
    found = np.asarray((at - frame.translation) @ frame.rotation)
    for some, route in _by_route(known, pattern):
        if route.start is not None:
            limb = known.robot.between(None, route.start)
            axes, origin = tip_frames(limb, readings[some][:, known.robot.columns_of(limb)])
            found[some] = origin + np.einsum("nij,nj->ni", axes, at[some])
    return found
