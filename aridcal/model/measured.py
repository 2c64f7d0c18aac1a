"""Rows of several kinds as their instruments see them: residuals, and how they change with the target and with each thing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from aridcal.errors import MeasurementError
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.catalogue import KINDS
from aridcal.instruments.channels import columns
from aridcal.instruments.kind import Kind
from aridcal.instruments.setup import Block, Instruments, Things
from aridcal.model.model import Model, Rows

States = Mapping[str, np.ndarray]
"""Where things are, (L, P) by role."""


@dataclass(frozen=True)
class Moved:
    """A coefficient that moves a thing.

    Attributes:
        index: Of the coefficient in the model.
        varying: Of its basis among those that are no constants; None for a constant.
        role: Of the thing.
        thing: Its number.
        components: Numbers of the components that it moves alike.
    """

    index: int
    varying: int | None
    role: str
    thing: int
    components: tuple[int, ...]


@dataclass(frozen=True)
class Slopes:
    """How n rows of m numbers change.

    Attributes:
        residual: Measured minus predicted, shape (n, m); NaN where a row does not measure a channel.
        by_twist: Change of the prediction by a twist of the target, shape (n, m, 6); 0 where nothing is measured.
        by_moved: By each coefficient that moves a thing, shape (n, m) each.
        by_thing: By each component of the row's own thing of the role of which there may be many, shape (n, m, u).
    """

    residual: np.ndarray
    by_twist: np.ndarray
    by_moved: tuple[np.ndarray, ...]
    by_thing: np.ndarray


@dataclass(frozen=True)
class Measured:
    """What rows read, and of which things: N rows of m numbers.

    Attributes:
        blocks: Of the data set.
        parts: Columns of each block's numbers in a row's residual.
        block: Number of each row's block, shape (N,).
        observed: What was read, shape (N, W).
        refers: Number of the things that each row refers to, in the order of its kind's roles, shape (N, 3); -1 for none.
        instruments: All things, as they are known beforehand.
        moved: Coefficients of the model that move things.
        width: Numbers m of a row.
    """

    blocks: tuple[Block, ...]
    parts: tuple[slice, ...]
    block: np.ndarray
    observed: np.ndarray
    refers: np.ndarray
    instruments: Instruments
    moved: tuple[Moved, ...]
    width: int

    def __len__(self) -> int:
        return len(self.block)

    def __getitem__(self, rows: slice | np.ndarray) -> Measured:
        chosen = self.block[rows], self.observed[rows], self.refers[rows]
        return replace(self, block=chosen[0], observed=chosen[1], refers=chosen[2])

    @property
    def absent(self) -> np.ndarray:
        """Numbers that a row does not measure, shape (N, m) bool."""
        found = np.ones((len(self), self.width), dtype=bool)
        for b, part in enumerate(self.parts):
            kind, own = self.of_kind(b)
            missing = kind.missing(self.observed[own], part.stop - part.start) if kind.missing else False
            found[own, part] = missing
        return found

    @property
    def conditions(self) -> np.ndarray:
        """Rows that say that a condition holds, shape (N,) bool."""
        of_block = np.array([KINDS[block.kind].condition for block in self.blocks], dtype=bool)
        return np.asarray(of_block[self.block])

    def of_kind(self, number: int) -> tuple[Kind, np.ndarray]:
        """The kind of a block, and the numbers of its rows."""
        return KINDS[self.blocks[number].kind], np.flatnonzero(self.block == number)

    def many(self) -> tuple[np.ndarray, np.ndarray]:
        """Of each row: number of the role of which there may be many (-1: none), as in :attr:`roles`, and of the thing."""
        role, thing = np.full(len(self), -1), np.full(len(self), -1)
        for b in range(len(self.blocks)):
            kind, own = self.of_kind(b)
            for k, each in enumerate(kind.roles):
                if each.many:
                    role[own], thing[own] = self.roles.index(each.name), self.refers[own, k]
        return role, thing

    @property
    def roles(self) -> tuple[str, ...]:
        """Names of the roles of the things."""
        return tuple(self.instruments.things)

    def residual(self, R: np.ndarray, p: np.ndarray, theta: np.ndarray, rows: Rows, states: States) -> np.ndarray:
        """Measured minus predicted, shape (N, m), NaN in channels that a row does not measure.

        Args:
            R: Predicted rotations of the target, shape (N, 3, 3).
            p: Its positions, shape (N, 3), [m].
            theta: Values of the model's coefficients.
            rows: The rows as the model sees them: bases of what changes from row to row.
            states: Where the things are.
        """
        r = np.full((len(self), self.width), np.nan)
        for b, part in enumerate(self.parts):
            kind, own = self.of_kind(b)
            if len(own):
                observed = kind.numbers(self.observed[own])
                r[own, part] = kind.residual(R[own], p[own], observed, self._states(kind, own, theta, rows, states)[0])
        return r

    def slopes(self, R: np.ndarray, p: np.ndarray, theta: np.ndarray, rows: Rows, states: States) -> Slopes:
        """The same with its derivatives; see :meth:`residual`."""
        n, m = len(self), self.width
        widest = max((len(t.role.components) for t in self.instruments.things.values() if t.role.many), default=0)
        r, twist = np.full((n, m), np.nan), np.zeros((n, m, 6))
        by_thing = np.zeros((n, m, widest))
        by_moved = tuple(np.zeros((n, m)) for _ in self.moved)
        for b, part in enumerate(self.parts):
            kind, own = self.of_kind(b)
            if not len(own):
                continue
            now, changes = self._states(kind, own, theta, rows, states)
            seen = kind.derivatives(R[own], p[own], kind.numbers(self.observed[own]), now)
            r[own, part], twist[own, part] = seen.residual, seen.by_twist
            for k, (role, change) in enumerate(zip(kind.roles, changes, strict=True)):
                by_state = seen.by_state[k]
                thing = self.refers[own, k]
                if role.slope is not None:
                    by_state = by_state @ role.slope(states[role.name][thing], change)
                if role.many:
                    by_thing[own, part, : by_state.shape[2]] = by_state
                for number, c in enumerate(self.moved):
                    if c.role == role.name:
                        hit = thing == c.thing
                        value = by_state[hit][:, :, c.components].sum(axis=2)
                        if c.varying is not None:
                            value = value * rows.phi[own[hit], c.varying][:, None]
                        by_moved[number][own[hit], part] = value
        return Slopes(r, twist, by_moved, by_thing)

    def _states(
        self, kind: Kind, own: np.ndarray, theta: np.ndarray, rows: Rows, states: States
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """State and change of the things of some rows, for each role of their kind: (n, P) and (n, u)."""
        now, changes = [], []
        for k, role in enumerate(kind.roles):
            thing = self.refers[own, k]
            start = states[role.name][thing]
            role = self.instruments.things[role.name].role  # a head has components of its own
            change = np.zeros((len(own), len(role.components)))
            moved = [c for c in self.moved if c.role == role.name]
            for c in moved:
                hit = thing == c.thing
                step = theta[c.index] if c.varying is None else theta[c.index] * rows.phi[own[hit], c.varying]
                change[np.ix_(hit, c.components)] += np.reshape(step, (-1, 1))
            now.append(role.moved(start, change) if moved else start)
            changes.append(change)
        return now, changes


def rows_of_data(model: Model, data: Dataset, readings: np.ndarray | None = None) -> Rows:
    """The rows of a data set as a model sees them; with other readings of their joints, shape (N, columns), if these are given.

    Raises:
        CovariateNotFound: an effect depends on a column that was not measured.
        MeasurementError: a row's station or target is none of those that the model knows, or the model has not its path.
    """
    unknown = [route for route in data.routes if route not in model.routes]
    if unknown:
        start, end = (link or "the default" for link in unknown[0])
        raise MeasurementError(f"{data.title}: no row of the calibration was measured from {start} to {end}")
    number = np.array([model.routes.index(route) for route in data.routes])
    route = None if len(model.routes) == 1 else number[np.zeros(len(data), int) if data.route is None else data.route]
    at = data.readings if readings is None else readings
    return model.rows(at, data.conditions, data.station, data.target, route)


def measured(model: Model, data: Dataset) -> Measured | None:
    """What the rows of a data set read, for a model; None where all that they measure is the target's own pose.

    Things that the model does not know are added to those that it knows.
    """
    if not data.blocks:
        return None
    instruments, number = joined(model.instruments, data.instruments)
    refers = np.full(data.refers.shape, -1)
    for b, block in enumerate(data.blocks):
        own = np.flatnonzero(data.block == b)
        for k, role in enumerate(KINDS[block.kind].roles):
            labels, which = np.unique(data.refers[own, k], return_inverse=True)
            refers[own, k] = np.array([number[role.name][str(label)] for label in labels], dtype=int)[which]
    ends = np.cumsum([0, *(sum(c.size for c in block.channels) for block in data.blocks)]).tolist()
    return Measured(
        blocks=data.blocks,
        parts=tuple(slice(low, high) for low, high in pairwise(ends)),
        block=data.block,
        observed=data.observed,
        refers=refers,
        instruments=instruments,
        moved=_moved(model),
        width=columns(data.channels)[-1].stop,
    )


def joined(known: Instruments, more: Instruments) -> tuple[Instruments, dict[str, dict[str, int]]]:
    """The things of both, those known first, and the number of each by role and name."""
    things = dict(known.things)
    for role, new in more.things.items():
        old = known.things.get(role)
        if old is None:
            things[role] = new
        else:
            there = frozenset(old.names)
            things[role] = _with(old, new, [k for k, name in enumerate(new.names) if name not in there])
    number = {role: {name: k for k, name in enumerate(t.names)} for role, t in things.items()}
    return replace(known, things=things, ties=known.ties or more.ties), number


def _with(old: Things, new: Things, added: Sequence[int]) -> Things:
    """Things with some of others behind them."""
    if not added:
        return old
    return Things(
        role=old.role,
        names=(*old.names, *(new.names[k] for k in added)),
        start=np.vstack([old.start, new.start[added]]),
        free=np.vstack([old.free, new.free[added]]),
        std=np.vstack([old.std, new.std[added]]),
    )


def _moved(model: Model) -> tuple[Moved, ...]:
    """The model's coefficients that move things."""
    place = {name: (role, k) for role, things in model.instruments.things.items() for name, k in things.places.items()}
    varying = np.cumsum([not c.basis.constant for c in model.coefficients]) - 1
    found = []
    for k in np.flatnonzero(model.at_things).tolist():
        c = model.coefficients[k]
        role, thing = place[c.where]
        components = model.instruments.things[role].role.moved_by(c.where, c.component)
        found.append(Moved(k, None if c.basis.constant else int(varying[k]), role, thing, components))
    return tuple(found)


LOCATING = 10
"""Steps in which a thing is found from its own rows at the most; three are usual."""

FOUND = 1e-10
"""Change of its components that ends this: rounding."""


def located(
    seen: Measured, R: np.ndarray, p: np.ndarray, theta: np.ndarray, rows: Rows, states: States
) -> tuple[States, np.ndarray]:
    """Solve for the things whose place nobody knows, each from its own rows, all else held.

    Returns:
        The states with these, and by what each row's residual is to be stretched, shape (N,), so that its squares count as
        those of things that were known: sqrt(n / (n - u)) for n numbers and u unknowns; NaN where n is no more than u.
    """
    stretch = np.ones(len(seen))
    role, thing = seen.many()
    found = dict(states)
    for number, name in enumerate(seen.roles):
        lost = np.atleast_1d(np.isnan(states[name]).any(axis=1))
        here = np.flatnonzero(role == number)
        asked = np.unique(thing[here])
        asked = asked[lost[asked]]
        if len(asked):
            found[name] = states[name].copy()
        for k in asked.tolist():
            own = here[thing[here] == k]
            part = seen[own]
            free = seen.instruments.things[name].free[k]
            found[name][k], rank = _one(part, R[own], p[own], theta, rows[own], found, name, k, free)
            count = float((~part.absent).sum())
            stretch[own] = np.sqrt(count / (count - rank)) if count > rank else np.nan
    return found, stretch


def _one(
    part: Measured,
    R: np.ndarray,
    p: np.ndarray,
    theta: np.ndarray,
    rows: Rows,
    states: States,
    name: str,
    k: int,
    free: np.ndarray,
) -> tuple[np.ndarray, int]:
    """State (P,) of one thing from its rows alone, and how many of its components these tell."""
    kind, first = part.of_kind(int(part.block[0]))
    now = [states[role.name][part.refers[first, j]] for j, role in enumerate(kind.roles)]
    start = kind.located(R[first], p[first], kind.numbers(part.observed[first]), now) if kind.located else None
    if start is None or not np.isfinite(start).all():
        return states[name][k], int(free.sum())
    role = part.instruments.things[name].role
    trial = dict(states)
    rank = int(free.sum())
    for _ in range(LOCATING):
        trial[name] = states[name].copy()
        trial[name][k] = start
        slopes = part.slopes(R, p, theta, rows, trial)
        there = ~np.isnan(slopes.residual)
        B, r = slopes.by_thing[there][:, : len(free)][:, free], slopes.residual[there]
        step, _, rank, _ = np.linalg.lstsq(B, r, rcond=1e-10)
        change = np.zeros((1, len(free)))
        change[0, free] = step
        start = role.moved(start[None], change)[0]
        if np.all(np.abs(step) < FOUND):
            break
    return start, int(rank)
