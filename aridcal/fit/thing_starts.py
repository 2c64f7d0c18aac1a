"""Where frames and things begin, for rows of any kind: block after block, each knowing what those before it have found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.errors import MeasurementError, NotIdentifiable
from aridcal.fit.frame_starts import Posed, best_start
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.catalogue import KINDS
from aridcal.instruments.descent import Place
from aridcal.instruments.inclination import DOWN
from aridcal.instruments.kind import Kind
from aridcal.instruments.setup import Things
from aridcal.instruments.starts import aligned, starts
from aridcal.model.measured import Measured

MOST_ROWS = 1000
"""Rows of a block that a start is found from: more sharpen it by nothing."""

FEWEST_ROWS = 12
"""Rows of each thing in this choice."""


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


def beginning(
    data: Dataset,
    seen: Measured,
    R: np.ndarray,
    p: np.ndarray,
    tip: np.ndarray,
    hints: Mapping[int, pin.SE3],
    held: Mapping[int, pin.SE3],
    station: np.ndarray,
    world: pin.SE3 | None,
) -> Beginning:
    """Find a start.

    Args:
        data: N rows.
        seen: What they read.
        R: Nominal T_base_tip, shape (N, 3, 3); of rows whose things a link carries, T_link_tip.
        p: Its translation, shape (N, 3), [m].
        tip: Number of each row's target, shape (N,).
        hints: T_tip_target of each target where nothing tells it.
        held: Those that are known.
        station: Number of each row's T_world_base, shape (N,); only rows that measure the target may have several.
        world: T_world_base where it is known.

    Raises:
        NotIdentifiable: the rows of a block cannot tell where its things are.
    """
    stands = (world or pin.SE3.Identity(),) * (int(station.max(initial=0)) + 1)
    found = Beginning(stands, dict(held), {n: t.start for n, t in seen.instruments.things.items()})
    placed = world is not None or not (seen.instruments.world or _of_target(seen))
    posed = np.isin(seen.block, [b for b, block in enumerate(seen.blocks) if KINDS[block.kind].places])
    if posed.any():
        found = _from_poses(data, R, p, tip, np.flatnonzero(posed), hints, found, station, world)
        placed = True
    starts_on_link = np.array([route.start is not None for route in data.labels.routes])
    linked = np.zeros(len(data), dtype=bool) if data.labels.route is None else starts_on_link[data.labels.route]
    order = sorted(range(len(seen.blocks)), key=lambda b: not seen.blocks[b].traits.level)  # it knows the vertical
    for b in order:
        block = seen.blocks[b]
        if KINDS[block.kind].places:
            continue
        kind, own = seen.of_kind(b)
        if block.traits.level and world is None and not posed.any():
            found = replace(found, world_base=(_levelled(seen, own, R, p, hints, tip, held),))
        pairs = np.unique(np.column_stack([tip[own], linked[own]]), axis=0).tolist()
        parts = [(k, own[(tip[own] == k) & (linked[own] == carried)], bool(carried)) for k, carried in pairs]
        for k, rows, carried in sorted(parts, key=lambda part: -len(part[1])):
            rows = _some(rows, seen, kind)
            base = pin.SE3.Identity() if carried else found.world_base[0]
            if not placed and not carried:
                loose = {name: _unknown(t) for name, t in _things(kind, seen, found.states).items()}
                first = _started(kind, rows, loose, seen, base, R, p, hints[k], False)
                there = _placed(kind, first, seen)
                if there is not None:
                    found = replace(found, world_base=(there,), tip_target=found.tip_target | {k: _se3(first.target)})
                    base, placed = there, True
            known = k in found.tip_target
            target = found.tip_target.get(k, hints[k])
            own_things = _things(kind, seen, found.states)
            start = _started(kind, rows, own_things, seen, base, R, p, target, known)
            states = dict(found.states)
            for name, state in start.states.items():
                states[name] = np.where(np.isnan(states[name]), state, states[name])
            found = replace(found, tip_target=found.tip_target | {k: _se3(start.target)}, states=states)
    return replace(
        found,
        tip_target={k: found.tip_target.get(k, hints[k]) for k in hints},
        states=_with_lost(data, seen, found.states),
    )


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


def _levelled(
    seen: Measured,
    own: np.ndarray,
    R: np.ndarray,
    p: np.ndarray,
    hints: Mapping[int, pin.SE3],
    tip: np.ndarray,
    held: Mapping[int, pin.SE3],
) -> pin.SE3:
    """The base turned the shortest way so that the rows of a sensor see gravity downwards."""
    kind = KINDS["inclination"]
    read = seen.observed[own, :3]
    read = read / np.linalg.norm(read, axis=1, keepdims=True)
    number = int(tip[own[0]])
    target, known = held.get(number, hints[number]).homogeneous, number in held
    refers = np.zeros((len(own), 0), dtype=int)
    made = starts(kind, R[own], p[own], read, refers, {}, target, known)
    best, least = DOWN, np.inf
    for start in made:
        felt = np.einsum("nij,jk,nk->ni", R[own], start.target[:3, :3], read)
        down = felt.mean(axis=0) / np.linalg.norm(felt.mean(axis=0))
        spread = float(np.median(np.linalg.norm(felt - down, axis=1)))
        if spread < least:
            best, least = down, spread
    turn = Rotation.align_vectors(DOWN[None], best[None])[0].as_matrix()
    return pin.SE3(turn, np.zeros(3))


def _of_target(seen: Measured) -> bool:
    """True if rows measure the target itself in the world frame."""
    return any(KINDS[block.kind].places for block in seen.blocks)


def _from_poses(
    data: Dataset,
    R: np.ndarray,
    p: np.ndarray,
    tip: np.ndarray,
    rows: np.ndarray,
    hints: Mapping[int, pin.SE3],
    found: Beginning,
    station: np.ndarray,
    world: pin.SE3 | None,
) -> Beginning:
    """Bases and targets from rows that measure these themselves."""
    numbers, own = np.unique(tip[rows], return_inverse=True)
    M = None if data.rotation is None else data.rotation[rows]
    if M is not None and np.isnan(M).any():
        M = None
    targets = {int(k): found.tip_target.get(int(k)) for k in numbers}
    known = tuple(T for T in targets.values() if T is not None)
    best = best_start(
        Posed(R[rows], p[rows], M, data.position[rows], station[rows], own),
        None if world is None else found.world_base,
        known if len(known) == len(targets) else None,
        tuple(hints[k] for k in targets),
    )
    placed = {k: held or T for (k, held), T in zip(targets.items(), best.tip_target, strict=True)}
    return replace(found, world_base=best.world_base, tip_target=found.tip_target | placed)


def _things(kind: Kind, seen: Measured, states: Mapping[str, np.ndarray]) -> dict[str, Things]:
    """Things of a kind's roles where they are; those found before count as known."""
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


def _started(
    kind: Kind,
    rows: np.ndarray,
    things: Mapping[str, Things],
    seen: Measured,
    base: pin.SE3,
    R: np.ndarray,
    p: np.ndarray,
    target: pin.SE3,
    known: bool,
) -> Place:
    """The best start from some rows of one block, whose arm stands on a base."""
    turned = base.rotation @ R[rows]
    places = p[rows] @ base.rotation.T + base.translation
    observed = kind.numbers(seen.observed[rows])
    refers = seen.refers[rows, : len(kind.roles)]
    made = starts(kind, turned, places, observed, refers, things, target.homogeneous, known)
    if not made:
        block = seen.blocks[int(seen.block[rows[0]])]
        raise NotIdentifiable([[block.name]])
    return made[0]


def _placed(kind: Kind, start: Place, seen: Measured) -> pin.SE3 | None:
    """T_world_base from things that were found in the base frame and are known in the world's; None where these are too few."""
    for role in kind.roles:
        things = seen.instruments.things[role.name]
        exact = ~things.free.any(axis=1) | np.isfinite(things.std).any(axis=1)
        given = np.where(exact[:, None], things.start, np.nan)
        T = aligned(role, start.states[role.name], given)
        if T is not None:
            return _se3(T)
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


def _se3(T: np.ndarray) -> pin.SE3:
    return pin.SE3(T[:3, :3], T[:3, 3])
