"""Where frames and things begin, for rows of any kind: block after block, each using the places from those before it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.frame_starts import PoseRows, best_start
from aridcal.engine.instruments.descent import DescentPoint
from aridcal.engine.instruments.inclination import DOWN
from aridcal.engine.instruments.kind import MeasurementKind
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.instruments.setup import Things
from aridcal.engine.instruments.starts import aligned, starts
from aridcal.engine.model.predictions import Observations
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.errors import MeasurementError, NotIdentifiable

MOST_THING_ROWS = 1000
"""Work: Rows of a block that a start is found from: more sharpen it by nothing."""

FEWEST_ROWS_OF_A_THING = 12
"""Work: Rows of each thing in this choice."""


@dataclass(frozen=True)
class StartValues:
    """Where everything starts.

    Attributes:
        world_base: One frame for all rows, or for each station.
        tip_target: T_tip_target of each target, by its number.
        states: Of the L things of each role, shape (L, P) by role; NaN where a place is not known.
    """

    world_base: tuple[pin.SE3, ...]
    tip_target: dict[int, pin.SE3]
    states: dict[str, np.ndarray]


@dataclass(frozen=True)
class NominalRows:
    """Rows with the nominal arm's poses, and the known frames.

    Attributes:
        data: N rows.
        predictions: What the rows read, beside the bare robot.
        R: Nominal T_base_tip, shape (N, 3, 3); of rows whose things a link carries, T_link_tip.
        p: Its translation, shape (N, 3), [m].
        tip: Number of each row's target, shape (N,).
        hints: T_tip_target of each target where no row determines it.
        known_targets: T_tip_target of the targets that are known.
        station: Number of each row's T_world_base, shape (N,); only rows that measure the target may have several.
        world: T_world_base; None where it is not known.
    """

    data: Dataset
    predictions: Observations
    R: np.ndarray
    p: np.ndarray
    tip: np.ndarray
    hints: Mapping[int, pin.SE3]
    known_targets: Mapping[int, pin.SE3]
    station: np.ndarray
    world: pin.SE3 | None

    def start(
        self,
        some: np.ndarray,
        kind: MeasurementKind,
        things: Mapping[str, Things],
        base: pin.SE3,
        target: pin.SE3,
        target_known: bool,
    ) -> DescentPoint:
        """The best start from some rows of one block, the arm standing on a base; ``target_known`` if the target's place is."""
        turned = base.rotation @ self.R[some]
        places = self.p[some] @ base.rotation.T + base.translation
        observed = kind.numbers(self.predictions.observed[some])
        refers = self.predictions.refers[some, : len(kind.roles)]
        candidates = starts(kind, turned, places, observed, refers, things, target.homogeneous, target_known)
        if not candidates:
            raise NotIdentifiable([[self.predictions.blocks[int(self.predictions.block[some[0]])].name]])
        return candidates[0]


def start_values(rows: NominalRows) -> StartValues:
    """Find a start.

    Raises:
        NotIdentifiable: the rows of a block cannot tell where its things are.
    """
    predictions, hints = rows.predictions, rows.hints
    stands = (rows.world or pin.SE3.Identity(),) * (int(rows.station.max(initial=0)) + 1)
    at = StartValues(stands, dict(rows.known_targets), {n: t.start for n, t in predictions.instruments.things.items()})
    posed = np.flatnonzero(
        np.isin(predictions.block, [b for b, block in enumerate(predictions.blocks) if block.traits.places])
    )
    if len(posed):
        at = _from_poses(rows, posed, at)
    of_target = any(block.traits.places for block in predictions.blocks)
    world_known = rows.world is not None or len(posed) > 0 or not (predictions.instruments.world or of_target)
    starts_on_link = np.array([route.start is not None for route in rows.data.labels.routes])
    linked = (
        np.zeros(len(rows.tip), dtype=bool)
        if rows.data.labels.route is None
        else starts_on_link[rows.data.labels.route]
    )
    # Blocks that know the vertical come first.
    order = sorted(range(len(predictions.blocks)), key=lambda b: not predictions.blocks[b].traits.level)
    for b in order:
        kind, of_block = predictions.of_kind(b)
        if kind.places:
            continue
        if kind.level and rows.world is None and not len(posed):
            at = replace(at, world_base=(_level_base(rows, of_block),))
        limbs = np.column_stack([rows.tip[of_block], linked[of_block]])
        parts = [
            (k, of_block[(limbs == (k, on_link)).all(axis=1)], on_link)
            for k, on_link in np.unique(limbs, axis=0).tolist()
        ]
        for k, some, on_link in sorted(parts, key=lambda part: -len(part[1])):
            some = _enough_rows(some, predictions, kind)
            base = pin.SE3.Identity() if on_link else at.world_base[0]
            if not world_known and not on_link:
                loose = {name: _with_unknown_places(t) for name, t in _things(kind, predictions, at.states).items()}
                first = rows.start(some, kind, loose, base, hints[k], False)
                there = _base_from_things(kind, first, predictions)
                if there is not None:
                    at = replace(at, world_base=(there,), tip_target=at.tip_target | {k: pin.SE3(first.target)})
                    base, world_known = there, True
            target, target_known = at.tip_target.get(k, hints[k]), k in at.tip_target
            start = rows.start(some, kind, _things(kind, predictions, at.states), base, target, target_known)
            states = dict(at.states)
            for name, state in start.states.items():
                states[name] = np.where(np.isnan(states[name]), state, states[name])
            at = replace(at, tip_target=at.tip_target | {k: pin.SE3(start.target)}, states=states)
    tip_target = {k: at.tip_target.get(k, hints[k]) for k in hints}
    return replace(at, tip_target=tip_target, states=_with_missing_states(rows.data, predictions, at.states))


def _with_missing_states(
    data: Dataset, predictions: Observations, states: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """States with things that their rows cannot place put at the median of the others: these rows do not notice.

    Raises:
        MeasurementError: most things of a role cannot be placed; it names the first of them.
    """
    states_of_roles = dict(states)
    for b, block in enumerate(predictions.blocks):
        kind, some = predictions.of_kind(b)
        for k, role in enumerate(kind.roles if predictions.instruments.things else ()):
            state = states_of_roles[role.name].copy()
            numbers, rows = np.unique(predictions.refers[some, k], return_counts=True)
            lost = ~np.isfinite(state[numbers]).all(axis=1)
            if 2 * lost.sum() > len(numbers):
                name, count = predictions.instruments.things[role.name].names[int(numbers[lost][0])], int(rows[lost][0])
                raise MeasurementError(
                    f"{data.title}: {role.name} {name!r} of {block.name}: its fitted rows, {count}, cannot tell where it is. "
                    "Measure more of it, in other postures, or state its place under `instruments`"
                )
            if lost.any():
                state[numbers[lost]] = np.median(state[numbers[~lost]], axis=0)
            states_of_roles[role.name] = state
    return states_of_roles


def _level_base(rows: NominalRows, some: np.ndarray) -> pin.SE3:
    """T_world_base, turned the shortest way so that the rows of an inclination sensor read gravity downwards."""
    R, read, number = rows.R[some], rows.predictions.observed[some, :3], int(rows.tip[some[0]])
    read = read / np.linalg.norm(read, axis=1, keepdims=True)
    target, target_known = rows.known_targets.get(number, rows.hints[number]).homogeneous, number in rows.known_targets
    refers = np.zeros((len(some), 0), dtype=int)
    best, least = DOWN, np.inf
    for start in starts(MEASUREMENT_KINDS["inclination"], R, rows.p[some], read, refers, {}, target, target_known):
        felt = np.einsum("nij,jk,nk->ni", R, start.target[:3, :3], read)
        down = felt.mean(axis=0) / np.linalg.norm(felt.mean(axis=0))
        spread = float(np.median(np.linalg.norm(felt - down, axis=1)))
        if spread < least:
            best, least = down, spread
    turn = Rotation.align_vectors(DOWN[None], best[None])[0].as_matrix()
    return pin.SE3(turn, np.zeros(3))


def _from_poses(rows: NominalRows, some: np.ndarray, at: StartValues) -> StartValues:
    """Bases and targets from rows that measure poses or positions of targets."""
    numbers, tip = np.unique(rows.tip[some], return_inverse=True)
    M = None if rows.data.rotation is None else rows.data.rotation[some]
    if M is not None and np.isnan(M).any():
        M = None
    targets = {k: at.tip_target.get(k) for k in numbers.tolist()}
    known_targets = tuple(T for T in targets.values() if T is not None)
    best = best_start(
        PoseRows(rows.R[some], rows.p[some], M, rows.data.position[some], rows.station[some], tip),
        None if rows.world is None else at.world_base,
        known_targets if len(known_targets) == len(targets) else None,
        tuple(rows.hints[k] for k in targets),
    )
    starts_of_targets = {k: known or T for (k, known), T in zip(targets.items(), best.tip_target, strict=True)}
    return replace(at, world_base=best.world_base, tip_target=at.tip_target | starts_of_targets)


def _things(kind: MeasurementKind, predictions: Observations, states: Mapping[str, np.ndarray]) -> dict[str, Things]:
    """Things of a kind's roles at their states; things that have a place by now count as known."""
    things_of_roles = {}
    for role in kind.roles:
        things = predictions.instruments.things[role.name]
        here = np.isfinite(states[role.name]).all(axis=1) & np.isnan(things.start).any(axis=1)
        things_of_roles[role.name] = replace(things, start=states[role.name], free=things.free & ~here[:, None])
    return things_of_roles


def _with_unknown_places(things: Things) -> Things:
    """The things with all places unknown, for rows in another frame than the world's."""
    if not things.role.many:
        return things
    free = np.tile([name in things.role.identified for name in things.role.components], (len(things), 1))
    return replace(things, start=np.full(things.start.shape, np.nan), free=free)


def _base_from_things(kind: MeasurementKind, start: DescentPoint, predictions: Observations) -> pin.SE3 | None:
    """T_world_base from things placed in the base frame by a start and in the world's by the campaign; None if too few."""
    for role in kind.roles:
        things = predictions.instruments.things[role.name]
        exact = ~things.free.any(axis=1) | np.isfinite(things.std).any(axis=1)
        known_places = np.where(exact[:, None], things.start, np.nan)
        T = aligned(role, start.states[role.name], known_places)
        if T is not None:
            return pin.SE3(T)
    return None


def _enough_rows(rows: np.ndarray, predictions: Observations, kind: MeasurementKind) -> np.ndarray:
    """Row numbers of a choice from a block, each thing with its share."""
    if len(rows) <= MOST_THING_ROWS or not kind.roles:
        return rows[:: max(1, len(rows) // MOST_THING_ROWS)]
    label = predictions.refers[rows, len(kind.roles) - 1]
    rng = np.random.default_rng(0)
    share = max(FEWEST_ROWS_OF_A_THING, MOST_THING_ROWS // len(np.unique(label)))
    order = rng.permutation(len(rows))
    ranked = np.argsort(label[order], kind="stable")
    sizes = np.bincount(label)[np.unique(label)]
    within = np.concatenate([np.arange(size) for size in sizes])
    return np.sort(rows[order[ranked[within < share]]])
