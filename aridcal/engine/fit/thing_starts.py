"""Where frames and things begin, for rows of any kind: block after block, each knowing what those before it have found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.frame_starts import Posed, best_start
from aridcal.engine.instruments.descent import Place
from aridcal.engine.instruments.inclination import DOWN
from aridcal.engine.instruments.kind import Kind
from aridcal.engine.instruments.kinds import KINDS
from aridcal.engine.instruments.setup import Things
from aridcal.engine.instruments.starts import aligned, starts
from aridcal.engine.model.predictions import Measured
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.errors import MeasurementError, NotIdentifiable

MOST_ROWS = 1000
"""Work: Rows of a block that a start is found from: more sharpen it by nothing."""

FEWEST_ROWS = 12
"""Work: Rows of each thing in this choice."""


@dataclass(frozen=True)
class Beginning:
    """Where everything starts.

    Attributes:
        world_base: One frame for all rows, or for each station.
        tip_target: T_tip_target of each target, by its number.
        states: Of all things, (L, P) by role; NaN where nothing is known.
    """

    world_base: tuple[pin.SE3, ...]
    tip_target: dict[int, pin.SE3]
    states: dict[str, np.ndarray]


@dataclass(frozen=True)
class NominalRows:
    """Rows as the nominal arm has them, and what is known of their frames.

    Attributes:
        data: N rows.
        seen: What they read.
        R: Nominal T_base_tip, shape (N, 3, 3); of rows whose things a link carries, T_link_tip.
        p: Its translation, shape (N, 3), [m].
        tip: Number of each row's target, shape (N,).
        hints: T_tip_target of each target where nothing tells it.
        held: Those that are known.
        station: Number of each row's T_world_base, shape (N,); only rows that measure the target may have several.
        world: T_world_base where it is known.
    """

    data: Dataset
    seen: Measured
    R: np.ndarray
    p: np.ndarray
    tip: np.ndarray
    hints: Mapping[int, pin.SE3]
    held: Mapping[int, pin.SE3]
    station: np.ndarray
    world: pin.SE3 | None

    def start(
        self, own: np.ndarray, kind: Kind, things: Mapping[str, Things], base: pin.SE3, target: pin.SE3, known: bool
    ) -> Place:
        """The best start from some rows of one block, whose arm stands on a base; ``known`` if the target is."""
        turned = base.rotation @ self.R[own]
        places = self.p[own] @ base.rotation.T + base.translation
        observed = kind.numbers(self.seen.observed[own])
        refers = self.seen.refers[own, : len(kind.roles)]
        made = starts(kind, turned, places, observed, refers, things, target.homogeneous, known)
        if not made:
            raise NotIdentifiable([[self.seen.blocks[int(self.seen.block[own[0]])].name]])
        return made[0]


def beginning(rows: NominalRows) -> Beginning:
    """Find a start.

    Raises:
        NotIdentifiable: the rows of a block cannot tell where its things are.
    """
    seen, hints = rows.seen, rows.hints
    stands = (rows.world or pin.SE3.Identity(),) * (int(rows.station.max(initial=0)) + 1)
    at = Beginning(stands, dict(rows.held), {n: t.start for n, t in seen.instruments.things.items()})
    posed = np.flatnonzero(np.isin(seen.block, [b for b, block in enumerate(seen.blocks) if block.traits.places]))
    if len(posed):
        at = _from_poses(rows, posed, at)
    of_target = any(block.traits.places for block in seen.blocks)
    placed = rows.world is not None or len(posed) > 0 or not (seen.instruments.world or of_target)
    starts_on_link = np.array([route.start is not None for route in rows.data.labels.routes])
    linked = (
        np.zeros(len(rows.tip), dtype=bool)
        if rows.data.labels.route is None
        else starts_on_link[rows.data.labels.route]
    )
    order = sorted(range(len(seen.blocks)), key=lambda b: not seen.blocks[b].traits.level)  # it knows the vertical
    for b in order:
        kind, of_block = seen.of_kind(b)
        if kind.places:
            continue
        if kind.level and rows.world is None and not len(posed):
            at = replace(at, world_base=(_levelled(rows, of_block),))
        limbs = np.column_stack([rows.tip[of_block], linked[of_block]])
        parts = [
            (k, of_block[(limbs == (k, on_link)).all(axis=1)], on_link)
            for k, on_link in np.unique(limbs, axis=0).tolist()
        ]
        for k, own, on_link in sorted(parts, key=lambda part: -len(part[1])):
            own = _some(own, seen, kind)
            base = pin.SE3.Identity() if on_link else at.world_base[0]
            if not placed and not on_link:
                loose = {name: _unknown(t) for name, t in _things(kind, seen, at.states).items()}
                first = rows.start(own, kind, loose, base, hints[k], False)
                there = _placed(kind, first, seen)
                if there is not None:
                    at = replace(at, world_base=(there,), tip_target=at.tip_target | {k: pin.SE3(first.target)})
                    base, placed = there, True
            target, known = at.tip_target.get(k, hints[k]), k in at.tip_target
            start = rows.start(own, kind, _things(kind, seen, at.states), base, target, known)
            states = dict(at.states)
            for name, state in start.states.items():
                states[name] = np.where(np.isnan(states[name]), state, states[name])
            at = replace(at, tip_target=at.tip_target | {k: pin.SE3(start.target)}, states=states)
    tip_target = {k: at.tip_target.get(k, hints[k]) for k in hints}
    return replace(at, tip_target=tip_target, states=_with_lost(rows.data, seen, at.states))


def _with_lost(data: Dataset, seen: Measured, states: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """States with things that their few rows cannot tell put among the others: what they cannot tell, they cannot spoil.

    Raises:
        MeasurementError: most things of a role are such; naming the first.
    """
    found = dict(states)
    for b, block in enumerate(seen.blocks):
        kind, own = seen.of_kind(b)
        for k, role in enumerate(kind.roles if seen.instruments.things else ()):
            state = found[role.name].copy()
            numbers, rows = np.unique(seen.refers[own, k], return_counts=True)
            lost = ~np.isfinite(state[numbers]).all(axis=1)
            if 2 * lost.sum() > len(numbers):
                name, count = seen.instruments.things[role.name].names[int(numbers[lost][0])], int(rows[lost][0])
                raise MeasurementError(
                    f"{data.title}: {role.name} {name!r} of {block.name}: its fitted rows, {count}, cannot tell where it is. "
                    "Measure more of it, in other postures, or state its place under `instruments`"
                )
            if lost.any():
                state[numbers[lost]] = np.median(state[numbers[~lost]], axis=0)
            found[role.name] = state
    return found


def _levelled(rows: NominalRows, own: np.ndarray) -> pin.SE3:
    """The base turned the shortest way so that the rows of a sensor see gravity downwards."""
    R, read, number = rows.R[own], rows.seen.observed[own, :3], int(rows.tip[own[0]])
    read = read / np.linalg.norm(read, axis=1, keepdims=True)
    target, known = rows.held.get(number, rows.hints[number]).homogeneous, number in rows.held
    refers = np.zeros((len(own), 0), dtype=int)
    best, least = DOWN, np.inf
    for start in starts(KINDS["inclination"], R, rows.p[own], read, refers, {}, target, known):
        felt = np.einsum("nij,jk,nk->ni", R, start.target[:3, :3], read)
        down = felt.mean(axis=0) / np.linalg.norm(felt.mean(axis=0))
        spread = float(np.median(np.linalg.norm(felt - down, axis=1)))
        if spread < least:
            best, least = down, spread
    turn = Rotation.align_vectors(DOWN[None], best[None])[0].as_matrix()
    return pin.SE3(turn, np.zeros(3))


def _from_poses(rows: NominalRows, own: np.ndarray, at: Beginning) -> Beginning:
    """Bases and targets from rows that measure these themselves."""
    numbers, tip = np.unique(rows.tip[own], return_inverse=True)
    M = None if rows.data.rotation is None else rows.data.rotation[own]
    if M is not None and np.isnan(M).any():
        M = None
    targets = {k: at.tip_target.get(k) for k in numbers.tolist()}
    known = tuple(T for T in targets.values() if T is not None)
    best = best_start(
        Posed(rows.R[own], rows.p[own], M, rows.data.position[own], rows.station[own], tip),
        None if rows.world is None else at.world_base,
        known if len(known) == len(targets) else None,
        tuple(rows.hints[k] for k in targets),
    )
    placed = {k: held or T for (k, held), T in zip(targets.items(), best.tip_target, strict=True)}
    return replace(at, world_base=best.world_base, tip_target=at.tip_target | placed)


def _things(kind: Kind, seen: Measured, states: Mapping[str, np.ndarray]) -> dict[str, Things]:
    """Things of a kind's roles where they are; those that have a place by now count as known."""
    made = {}
    for role in kind.roles:
        things = seen.instruments.things[role.name]
        here = np.isfinite(states[role.name]).all(axis=1) & np.isnan(things.start).any(axis=1)
        made[role.name] = replace(things, start=states[role.name], free=things.free & ~here[:, None])
    return made


def _unknown(things: Things) -> Things:
    """The same things with nothing known of where they are, for rows in another frame than the world's."""
    if not things.role.many:
        return things
    free = np.tile([name in things.role.identified for name in things.role.components], (len(things), 1))
    return replace(things, start=np.full(things.start.shape, np.nan), free=free)


def _placed(kind: Kind, start: Place, seen: Measured) -> pin.SE3 | None:
    """T_world_base from things that were found in the base frame and are known in the world's; None where these are too few."""
    for role in kind.roles:
        things = seen.instruments.things[role.name]
        exact = ~things.free.any(axis=1) | np.isfinite(things.std).any(axis=1)
        given = np.where(exact[:, None], things.start, np.nan)
        T = aligned(role, start.states[role.name], given)
        if T is not None:
            return pin.SE3(T)
    return None


def _some(rows: np.ndarray, seen: Measured, kind: Kind) -> np.ndarray:
    """Enough rows of a block, of each thing its share."""
    if len(rows) <= MOST_ROWS or not kind.roles:
        return rows[:: max(1, len(rows) // MOST_ROWS)]
    label = seen.refers[rows, len(kind.roles) - 1]
    rng = np.random.default_rng(0)
    share = max(FEWEST_ROWS, MOST_ROWS // len(np.unique(label)))
    order = rng.permutation(len(rows))
    ranked = np.argsort(label[order], kind="stable")
    sizes = np.bincount(label)[np.unique(label)]
    within = np.concatenate([np.arange(size) for size in sizes])
    return np.sort(rows[order[ranked[within < share]]])
