"""Configurations that could be measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.inclination import DOWN
from aridcal.engine.instruments.pixels import ends_of_sight, faces, in_image
from aridcal.engine.inverse.reachable import Miss, draw_readings, inner_limits, readings_for_poses, settled
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.robot.chain import Route
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.engine.rows.dataset import Dataset
from aridcal.jobs.plan.clearance import clear, clear_lines
from aridcal.jobs.plan.mounting import keeps_above
from aridcal.jobs.plan.prior_knowledge import PlanSetup
from aridcal.system.errors import CampaignError

DRAWING_ROUNDS = 40
"""Times that configurations are drawn: fewer than one in forty inside what is allowed is hardly a workspace."""

CANDIDATES_AT_ONCE, FEWEST_AT_ONCE, OFTEN_SHOWN = 3000, 1000, 10
"""Work: Configurations that are drawn at a time, where only some of them can be measured; at the least; for each one wanted."""

FEWEST_MARKERS_SHOWN = 4
"""Markers that an image must show, or all if there are fewer: a pose needs three, and one more to check."""


SETTLING_STEPS = 2
"""Of Newton's method, from where constants alone bring the target: effects move it by less than a millimetre, of which one step
leaves a micrometre."""

FREE_SIGHT_END = 0.03
"""[m] of a line of sight at the target that nothing obstructs: the target's own mount stands there."""


@dataclass(frozen=True)
class Offers:
    """What may be measured in a configuration: one choice of pattern rows, measured together, for each.

    Attributes:
        patterns: Indices of the pattern rows of each choice.
        titles: Labels in each choice's row, by the name of their column.
    """

    patterns: tuple[np.ndarray, ...]
    titles: tuple[dict[str, str], ...]


@dataclass(frozen=True)
class Candidates:
    """Configurations that could be measured, C of them.

    Attributes:
        readings: Shape (C, columns), [rad] or [m].
        sides: From which each joint comes to its reading, -1 or 1, shape (C, columns).
        offer: Index of what is measured in each, see :class:`Offers`, shape (C,).
        pattern: Pattern of each of their rows, N rows in all, shape (N,).
        of: Candidate that each row belongs to, in ascending order, shape (N,).
    """

    readings: np.ndarray
    sides: np.ndarray
    offer: np.ndarray
    pattern: np.ndarray
    of: np.ndarray

    def some(self, numbers: Sequence[int] | np.ndarray) -> Candidates:
        """The candidates of these indices, in this order; an index may come more than once."""
        indices = np.asarray(numbers, dtype=int)
        first, end = (np.searchsorted(self.of, indices, side) for side in ("left", "right"))
        rows = np.concatenate([np.arange(a, b) for a, b in zip(first.tolist(), end.tolist(), strict=True)])
        of = np.repeat(np.arange(len(indices)), end - first)
        return Candidates(self.readings[indices], self.sides[indices], self.offer[indices], self.pattern[rows], of)

    def and_more(self, more: Candidates) -> Candidates:
        """These candidates, and others of the same setup after them."""
        return Candidates(
            np.concatenate([self.readings, more.readings]),
            np.concatenate([self.sides, more.sides]),
            np.concatenate([self.offer, more.offer]),
            np.concatenate([self.pattern, more.pattern]),
            np.concatenate([self.of, more.of + len(self.readings)]),
        )

    @property
    def first(self) -> np.ndarray:
        """Pattern of each candidate's first row, shape (C,)."""
        return np.asarray(self.pattern[np.searchsorted(self.of, np.arange(len(self.readings)))])

    def rows(self, setup: PlanSetup) -> Dataset:
        """The candidates' rows as a data set, without readings of the instrument, which nothing asks for."""
        made = rows_like(setup, self.readings[self.of], self.pattern)
        names = tuple(f"{name}_direction" for name in made.names)
        covariates = made.covariates | dict(zip(names, self.sides[self.of].T, strict=True))
        return replace(made, covariates=covariates).with_origin(derived=names)


def offers(setup: PlanSetup) -> Offers:
    """What one configuration may measure: a target, a touch of a point, all markers in one image."""
    rows = setup.patterns
    n, kind = len(rows), setup.campaign.measurements.traits
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
        title = {"target": str(target[k])} if several and target is not None else {}
        if rows.labels.refers[k, 0] and not kind.tracked:
            title |= {kind.roles[0].name: str(rows.labels.refers[k, 0])}
        title |= {} if rows.labels.station is None else {"station": str(rows.labels.station[k])}
        titles.append(title)
    return Offers(tuple(np.array([k]) for k in range(n)), tuple(titles))


def rows_like(setup: PlanSetup, readings: np.ndarray, pattern: np.ndarray) -> Dataset:
    """Rows of other readings.

    Args:
        setup: Has the patterns.
        readings: Shape (N, columns), [rad] or [m].
        pattern: Number of each row's pattern, shape (N,).
    """
    made = replace(setup.patterns.select(pattern), readings=readings)
    kind = setup.campaign.measurements.traits
    if made.direct or not (kind.tracked or kind.level):
        return made
    # turns are compared with what was seen
    R, p = setup.model.poses(setup.theta, rows_of_data(setup.model, made, readings))
    observed = np.swapaxes(R, 1, 2) @ DOWN if kind.level else np.hstack([p, R.reshape(-1, 9)])
    return replace(made, observed=_as_wide(observed, made.observed.shape[1]))


def _as_wide(values: np.ndarray, width: int) -> np.ndarray:
    """Values cut off, or filled up with zeros, to a width in columns."""
    wide = np.zeros((len(values), width))
    wide[:, : values.shape[1]] = values[:, :width]
    return wide


def targets_of(setup: PlanSetup, readings: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the targets in the world, (n, 3, 3) and (n, 3), [m]; see :func:`rows_like`."""
    made = setup.patterns.select(pattern)
    return setup.model.poses(setup.theta, rows_of_data(setup.model, made, readings))


def in_base(setup: PlanSetup, readings: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the targets in the robot's base, (n, 3, 3) and (n, 3), [m]; see :func:`rows_like`."""
    pattern_rows = setup.patterns.select(pattern)
    rows = rows_of_data(setup.model, pattern_rows, readings)
    R, p = setup.model.poses(setup.theta, rows)
    frames = setup.model.frames(setup.theta)[0]
    base = [frames[k][1] for k in rows.world.tolist()]
    turn = np.array([frame.rotation for frame in base]).reshape(-1, 3, 3)
    offset = p - np.array([frame.translation for frame in base]).reshape(-1, 3)
    poses = np.swapaxes(turn, 1, 2) @ R, np.einsum("nji,nj->ni", turn, offset)
    for indices, route in _by_route(setup, pattern):
        if route.start is not None:  # such rows are of what the target is to a link
            limb = setup.robot.between(None, route.start)
            axes, origin = tip_frames(limb, readings[indices][:, setup.robot.columns_of(limb)])
            poses[0][indices], poses[1][indices] = axes @ R[indices], origin + np.einsum("nij,nj->ni", axes, p[indices])
    return poses


def ends(setup: PlanSetup) -> list[int]:
    """Indices of the patterns whose targets a plan is judged by: the first of each path."""
    route = setup.patterns.labels.route
    return [0] if route is None else sorted(np.unique(route, return_index=True)[1].tolist())


def _by_route(setup: PlanSetup, pattern: np.ndarray) -> Iterator[tuple[np.ndarray | slice, Route]]:
    """Indices of the rows on each path, with the path; see :func:`rows_like`."""
    routes, route = setup.patterns.labels.routes, setup.patterns.labels.route
    if route is None:
        yield slice(None), routes[0]
        return
    for k in np.unique(route[pattern]).tolist():
        yield np.flatnonzero(route[pattern] == k), routes[k]


def allowed(setup: PlanSetup, readings: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """True of configurations in which the arm keeps clear, shape (n,); see :func:`rows_like`."""
    targets = in_base(setup, readings, pattern)[1]
    free = np.empty(len(readings), dtype=bool)
    for indices, route in _by_route(setup, pattern):
        free[indices] = clear(setup.robot, setup.boxes, setup.bodies, readings[indices], targets[indices], route.end)
    return free & keeps_above(setup.robot, setup.side, readings, targets) if setup.side else free


def in_sight(setup: PlanSetup, readings: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """True of configurations in which the instrument sees the target, shape (n,); see :func:`rows_like`."""
    sight = setup.campaign.design.sight
    if sight is None or not len(readings):
        return np.ones(len(readings), dtype=bool)
    R, p = in_base(setup, readings, pattern)
    to_instrument = np.array(sight.at) - p
    length = np.linalg.norm(to_instrument, axis=1)
    visible = length > FREE_SIGHT_END
    if sight.axis is not None and sight.within is not None:
        axis = R @ (np.array(sight.axis) / np.linalg.norm(sight.axis))
        visible &= np.sum(axis * to_instrument, axis=1) >= np.cos(sight.within) * length
    ends = p[visible] + to_instrument[visible] * (FREE_SIGHT_END / length[visible])[:, None]
    starts = np.broadcast_to(np.array(sight.at), ends.shape)
    boxes = setup.boxes
    visible[visible] = clear_lines(setup.robot, boxes, setup.bodies, readings[visible], starts, ends)
    return visible


def draw_candidates(setup: PlanSetup, count: int, least: int, rng: np.random.Generator) -> Candidates:
    """Measurable configurations, drawn from the joints' ranges, as many of each offer.

    Args:
        setup: What can be measured.
        count: How many, if there are so many.
        least: How many at least; 0: offers of which none can be measured are left out, as long as others can.
        rng: Draws them.

    Raises:
        CampaignError: hardly any can.
    """
    choices = offers(setup)
    per_offer, fewest = (-(-number // len(choices.patterns)) for number in (count, least))
    parts, problem = [], None
    for patterns in choices.patterns:
        try:
            parts.append(_of_offer(setup, patterns, per_offer, max(fewest, 1), rng))
        except CampaignError as error:
            if least:
                raise
            problem = error
            parts.append(_none(setup))
    if problem is not None and not any(len(part.readings) for part in parts):
        raise problem
    readings = np.concatenate([part.readings for part in parts])
    starts = np.cumsum([0, *(len(part.readings) for part in parts)])[:-1]
    return Candidates(
        readings=readings,
        sides=rng.choice([-1.0, 1.0], readings.shape),
        offer=np.repeat(np.arange(len(parts)), [len(part.readings) for part in parts]),
        pattern=np.concatenate([part.pattern for part in parts]),
        of=np.concatenate([part.of + start for part, start in zip(parts, starts.tolist(), strict=True)]),
    )


def _none(setup: PlanSetup) -> Candidates:
    """No configuration."""
    readings, numbers = np.zeros((0, len(setup.robot.readings))), np.zeros(0, dtype=int)
    return Candidates(readings, readings, numbers, numbers, numbers)


def _of_offer(setup: PlanSetup, patterns: np.ndarray, count: int, least: int, rng: np.random.Generator) -> Candidates:
    """Measurable configurations of one offer."""
    readings_found: list[np.ndarray] = []
    patterns_shown: list[np.ndarray] = []
    at_once = min(CANDIDATES_AT_ONCE, max(FEWEST_AT_ONCE, OFTEN_SHOWN * count))
    measurable, batch = 0, max(count, at_once) if len(patterns) > 1 else count
    for _ in range(DRAWING_ROUNDS):
        readings = _draw_readings(setup, int(patterns[0]), batch, rng)
        shown = _patterns_shown(setup, readings, patterns)
        usable = _shows_enough(setup, shown, patterns)
        for condition in (allowed, in_sight):
            usable[usable] = condition(setup, readings[usable], np.full(int(usable.sum()), patterns[0]))
        readings_found.append(readings[usable])
        patterns_shown.append(shown[usable])
        measurable += int(usable.sum())
        if measurable >= count:
            break
    if measurable < least:
        raise CampaignError(
            f"{setup.campaign.path}: of {DRAWING_ROUNDS * batch:,} configurations only {measurable} can be measured inside the "
            "joints' limits: check `design.keep_out` and `design.sight`, and what `instruments` says of cameras and markers"
        )
    count = min(count, measurable)
    of, column = np.nonzero(np.concatenate(patterns_shown)[:count])
    readings = np.concatenate(readings_found)[:count]
    return Candidates(readings, np.ones_like(readings), np.zeros(count, dtype=int), patterns[column], of)


def _draw_readings(setup: PlanSetup, pattern: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Readings that bring the target where a measurement of one pattern needs it, shape (count, columns)."""
    rows = setup.patterns
    kind = setup.campaign.measurements.traits
    if not (kind.touches or kind.gauges or kind.joins):
        return draw_readings(setup.robot, count, rng, inner_limits)
    role_name = kind.roles[0].name
    things = setup.model.instruments.things[role_name]
    number = things.names.index(str(rows.labels.refers[pattern, 0]))
    state: np.ndarray = setup.model.states.get(role_name, things.start)[number]

    def miss(R: np.ndarray, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
        if kind.joins:
            return kind.residual(R, p, np.zeros((len(p), 0)), [np.tile(state, (len(p), 1))])
        return p - state if kind.touches else p @ state[:3, None] - state[3]

    advice = f"move {role_name} {rows.labels.refers[pattern, 0]} nearer to the arm, or say better where it is"
    return reaching(setup, pattern, miss, count, rng, advice)


def reaching(
    setup: PlanSetup, pattern: int, miss: Miss, count: int, rng: np.random.Generator, advice: str
) -> np.ndarray:
    """Readings that bring the target of a pattern where ``miss`` is zero, shape (count, columns)."""

    def pose(readings: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return targets_of(setup, readings, np.full(len(readings), pattern))

    # Without effects at first: their bases, loads of gravity above all, cost ten times what the arm's places do.
    constant = np.array([c.basis.constant for c in setup.model.coefficients], dtype=bool)
    kept = np.flatnonzero(constant)
    model = setup.model.with_coefficients(tuple(setup.model.coefficients[k] for k in kept.tolist()))
    quick = replace(setup, model=model, theta=setup.theta[kept], prior=setup.prior[kept])

    def roughly(readings: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return targets_of(quick, readings, np.full(len(readings), pattern))

    readings = readings_for_poses(setup.robot, roughly, miss, count, rng, str(setup.campaign.path), advice)
    return settled(pose, miss, readings, SETTLING_STEPS) if np.any(setup.theta[~constant]) else readings


def _patterns_shown(setup: PlanSetup, readings: np.ndarray, patterns: np.ndarray) -> np.ndarray:
    """Patterns of an offer that each configuration measures, shape (n, patterns) bool."""
    n, m = len(readings), len(patterns)
    if not setup.campaign.measurements.traits.images or n == 0:
        return np.ones((n, m), dtype=bool)
    question = problem(setup.model, rows_like(setup, np.repeat(readings[:1], m, axis=0), patterns))
    refers = question.measured.refers
    states = [
        np.tile(question.states[role.name][refers[:, k]], (n, 1))
        for k, role in enumerate(setup.campaign.measurements.traits.roles)
    ]
    turns, places = np.empty((n, m, 3, 3)), np.empty((n, m, 3))
    for indices, _ in _by_route(setup, patterns):  # markers of one path see the camera alike
        target_poses = targets_of(setup, readings, np.full(n, patterns[indices][0]))
        turns[:, indices], places[:, indices] = (part[:, None] for part in target_poses)
    R, p = turns.reshape(-1, 3, 3), places.reshape(-1, 3)
    camera = setup.campaign.instruments.cameras[str(setup.patterns.labels.refers[patterns[0], 0])]
    size = np.array([camera.width, camera.height], dtype=float)
    shown = in_image(R, p, states, size)
    if setup.campaign.instruments.boards:
        shown &= faces(R, p, states[0], states[1])
    too_few = ~_shows_enough(setup, shown.reshape(n, m), patterns)
    indices = np.flatnonzero(shown & ~np.repeat(too_few, m))
    if len(indices):
        sights = ends_of_sight(R[indices], p[indices], [state[indices] for state in states])
        rows = np.repeat(readings, m, axis=0)[indices]
        starts, ends = (_to_base(setup, np.tile(patterns, n)[indices], rows, at) for at in sights)
        short = FREE_SIGHT_END / np.maximum(np.linalg.norm(ends - starts, axis=1), 2 * FREE_SIGHT_END)[:, None]
        starts, ends = starts + short * (ends - starts), ends + short * (starts - ends)
        boxes = setup.boxes
        shown[indices] = clear_lines(setup.robot, boxes, setup.bodies, rows, starts, ends)
    return shown.reshape(n, m)


def _shows_enough(setup: PlanSetup, shown: np.ndarray, patterns: np.ndarray) -> np.ndarray:
    """True of images that show enough of what one link carries, shape (n,), from which markers each shows, (n, patterns)."""
    enough = np.zeros(len(shown), dtype=bool)
    for indices, _ in _by_route(setup, patterns):
        enough |= shown[:, indices].sum(axis=1) >= min(FEWEST_MARKERS_SHOWN, len(patterns[indices]))
    return enough


def _to_base(setup: PlanSetup, pattern: np.ndarray, readings: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points given where paths start, in the world or a link, in the base's axes, shape (n, 3), [m]; see :func:`rows_like`."""
    world = rows_of_data(setup.model, setup.patterns.select(pattern[:1])).world[0]
    frame = setup.model.frames(setup.theta)[0][world][1]
    places = np.asarray((points - frame.translation) @ frame.rotation)
    for indices, route in _by_route(setup, pattern):
        if route.start is not None:
            limb = setup.robot.between(None, route.start)
            axes, origin = tip_frames(limb, readings[indices][:, setup.robot.columns_of(limb)])
            places[indices] = origin + np.einsum("nij,nj->ni", axes, points[indices])
    return places
