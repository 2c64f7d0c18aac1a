"""Rows of several kinds as their instruments see them: residuals, and how they change with the target and with each thing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from aridcal.engine.instruments.channels import columns
from aridcal.engine.instruments.kind import MeasurementKind
from aridcal.engine.instruments.setup import Block, Instruments, Things
from aridcal.engine.model.many_rows import blocks
from aridcal.engine.model.model import Model, ModelRows
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.errors import MeasurementError

ThingStates = Mapping[str, np.ndarray]
"""Where things are, (L, P) by role."""

AGREEMENT_STEPS = 6
"""Steps in which readings are moved until the measurements agree; each squares what is left."""

LARGEST_CORRECTION = 0.1
"""[rad] and [m] from a reading to where its measurement agrees: farther is no small correction."""

AGREEMENT_TOLERANCE = 1e-4
"""[rad] and [m] of a step after which rows agree to its square: no column is then off by more than rounding shows."""

LEAST_LEVER = 1e-4
"""Share of a row's largest lever below which no reading is moved along a direction: near a singularity it would go far."""

DIVISION_GUARD = 1e-300
"""Added to a square that may be zero, where no joint moves a row, and by which is divided."""


@dataclass(frozen=True)
class ThingMotion:
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
class RowLinearisation:
    """Residuals of n rows of m numbers at some values of a model's K coefficients, and how they change.

    Attributes:
        residual: Measured minus predicted, shape (n, m); NaN where a row does not measure a channel.
        by_coefficient: What each coefficient takes off it, things held, shape (n, m, K).
        by_thing: What each component of the row's own thing of the role of which there may be many does, shape (n, m, u).
        agreed: Joint positions nearer to where measurements and model agree, shape (n, joints).
    """

    residual: np.ndarray
    by_coefficient: np.ndarray
    by_thing: np.ndarray
    agreed: np.ndarray


@dataclass(frozen=True)
class Observations:
    """What rows read, and of which things, beside the model that is to predict it: N rows of m numbers.

    Attributes:
        model: K coefficients.
        rows: The rows as it sees them.
        blocks: Of the data set.
        parts: Columns of each block's numbers in a row's residual.
        block: Number of each row's block, shape (N,).
        observed: What was read, shape (N, W).
        refers: Number of the things that each row refers to, in the order of its kind's roles, shape (N, 3); -1 for none.
        instruments: All things, as they are known beforehand.
        moved: Coefficients of the model that move things.
        width: Numbers m of a row.
        direct: True where rows measure the target's own place and nothing is between: twists of the target are what is left.
        states: Where the things are.
        wide: Where rows say that a condition holds, the model with each joint's own motion behind its coefficients; else None.
        agreed: The rows where the measurements agree with the model, joints and bases: there they are differentiated, both
            alike, for a motion that bases undo would else seem to act by as much as readings were moved. None: at the
            readings themselves.
    """

    model: Model
    rows: ModelRows
    blocks: tuple[Block, ...]
    parts: tuple[slice, ...]
    block: np.ndarray
    observed: np.ndarray
    refers: np.ndarray
    instruments: Instruments
    moved: tuple[ThingMotion, ...]
    width: int
    direct: bool
    states: ThingStates
    wide: Model | None = None
    agreed: ModelRows | None = None

    def __len__(self) -> int:
        return len(self.block)

    def __getitem__(self, some: slice | np.ndarray) -> Observations:
        return replace(
            self,
            rows=self.rows[some],
            block=self.block[some],
            observed=self.observed[some],
            refers=self.refers[some],
            agreed=None if self.agreed is None else self.agreed[some],
        )

    def narrowed(self, numbers: Sequence[int]) -> Observations:
        """The same rows beside a model of some of the coefficients, by their numbers, ascending."""
        every = self.model.coefficients
        varying = [k for k, c in enumerate(every) if not c.basis.constant]
        columns = [varying.index(k) for k in numbers if k in set(varying)]
        model = self.model.with_coefficients([every[k] for k in numbers])

        def narrowed_rows(rows: ModelRows) -> ModelRows:
            return replace(rows, phi=rows.phi.T[columns].T)

        return replace(
            self,
            model=model,
            rows=narrowed_rows(self.rows),
            agreed=None if self.agreed is None else narrowed_rows(self.agreed),
            moved=_thing_coefficients(model),
            wide=None if self.wide is None else model.with_motions(model.own_motions),
        )

    @property
    def absent(self) -> np.ndarray:
        """Numbers that a row does not measure, shape (N, m) bool."""
        absent = np.ones((len(self), self.width), dtype=bool)
        for part, kind, rows in self._by_block():
            missing = kind.missing(self.observed[rows], part.stop - part.start) if kind.missing else False
            absent[rows, part] = missing
        return absent

    @property
    def conditions(self) -> np.ndarray:
        """Rows that say that a condition holds, shape (N,) bool."""
        of_block = np.array([block.traits.condition for block in self.blocks], dtype=bool)
        return np.asarray(of_block[self.block])

    @property
    def lost(self) -> bool:
        """True if nobody knows where some thing is."""
        return any(np.isnan(state).any() for state in self.states.values())

    def of_kind(self, number: int) -> tuple[MeasurementKind, np.ndarray]:
        """The kind of a block, and the numbers of its rows."""
        return self.blocks[number].traits, np.flatnonzero(self.block == number)

    def _by_block(self) -> Iterator[tuple[slice, MeasurementKind, np.ndarray | slice]]:
        """For each block with rows: columns of its numbers, its kind, its rows (of an only block a slice: nothing is copied)."""
        for number, part in enumerate(self.parts):
            kind, rows = self.of_kind(number) if len(self.blocks) > 1 else (self.blocks[0].traits, slice(None))
            if len(self.block[rows]):
                yield part, kind, rows

    def many(self) -> tuple[np.ndarray, np.ndarray]:
        """For each row the number of its role with many things, as in :attr:`roles`, and of its thing; -1: none; (N,) each."""
        role, thing = np.full(len(self), -1), np.full(len(self), -1)
        for _, kind, rows in self._by_block():
            for k, each in enumerate(kind.roles):
                if each.many:
                    role[rows], thing[rows] = self.roles.index(each.name), self.refers[rows, k]
        return role, thing

    @property
    def roles(self) -> tuple[str, ...]:
        """Names of the roles of the things."""
        return tuple(self.instruments.things)

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Measured minus predicted, shape (N, m); NaN in channels that a row does not measure.

        Things that the model does not know are solved for from these rows alone, and the freedom that this takes is given back.
        """
        if self.lost:
            R, p = self.model.poses(theta, self.rows)
            states, stretch = solve_things(self, R, p, theta)
            return replace(self, states=states).left(R, p, theta) * stretch[:, None]
        r = np.empty((len(self), self.width))
        for part in blocks(len(self)):  # so that all rows' axes are never there at once
            some = self[part]
            r[part] = some.left(*self.model.poses(theta, some.rows), theta)
        return r

    def settled(self, theta: np.ndarray) -> Observations:
        """The same rows with the things that the model does not know located from these rows alone."""
        if not self.lost:
            return self
        R, p = self.model.poses(theta, self.rows)
        return replace(self, states=solve_things(self, R, p, theta)[0])

    def of_joints(self, theta: np.ndarray, uneven: bool) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n, m) of rows that are :attr:`direct`, and what the joints of the model take off them, (n, m, joints).

        Args:
            theta: Values of the model's coefficients.
            uneven: True if a row's axes weigh unequally.
        """
        R, p, twists = self.model.motions(theta, self.rows)
        r = self.left(R, p, theta)
        twists = twists[:, : self.width]
        if uneven and self.blocks[0].traits.turns:
            # log(exp(r) exp(-w)) = r - (w + r x w / 2 + ...): matters only where a row's axes weigh unequally.
            twists[:, 3:] += 0.5 * np.cross(r[:, 3:, None], twists[:, 3:], axis=1)
        return r, twists

    def sight(self, theta: np.ndarray) -> RowLinearisation:
        """Residuals and their derivatives by coefficients and things."""
        if self.conditions.any():
            R, p = self.model.poses(theta, self.rows)
            here = replace(self, states=solve_things(self, R, p, theta)[0])
            r = here.left(R, p, theta)
            slopes, J, positions = here.where_they_agree(theta)
        else:
            R, p, J = _distinct_rows_once(lambda some: self.model.jacobian(theta, some), self.rows)
            slopes = replace(self, states=solve_things(self, R, p, theta)[0]).slopes(R, p, theta)
            r, J, positions = slopes.residual, slopes.by_twist @ J, self.rows.positions
        for c, column in zip(self.moved, slopes.by_moved, strict=True):
            J[:, :, c.index] = column
        return RowLinearisation(np.nan_to_num(r), J, slopes.by_thing, positions)

    def agreeing(self, theta: np.ndarray, rows_at: Callable[[np.ndarray], ModelRows]) -> Observations:
        """The same rows, to be differentiated where measurements and model agree: readings moved as little as possible.

        What no measurement of a kind can tell (turns of the base where points are unknown, the scale where no length is known)
        turns or shrinks the residual, and would look as if it explained it; where the residual is zero its columns are zero.
        These are the derivatives of the Gauss-Helmert model (Helmert 1872): readings were observed, and a measurement is a
        condition on them.

        Args:
            theta: Values of the model's coefficients.
            rows_at: The rows at other joint positions, shape (N, joints); see :func:`rows_at`.
        """
        if not self.conditions.any():
            return replace(self, agreed=self.rows)
        here, before = self, (self.agreed or self.rows).positions
        for _ in range(AGREEMENT_STEPS):
            settled = here.settled(theta)
            nearer = np.concatenate([settled[part].where_they_agree(theta)[2] for part in blocks(len(self))])
            step, before = np.abs(nearer - before).max(initial=0.0), nearer
            here = replace(here, agreed=rows_at(nearer))
            if step < AGREEMENT_TOLERANCE:
                break
        return here

    def where_they_agree(self, theta: np.ndarray) -> tuple[Slopes, np.ndarray, np.ndarray]:
        """How rows change where measurements and model agree.

        Returns:
            Their slopes, columns of the coefficients (n, m, K), and positions nearer to where they agree, (n, joints).
        """
        assert self.wide is not None
        readings, at, count = self.rows.positions, self.agreed or self.rows, len(theta)
        beyond = np.zeros(len(self.wide.coefficients) - count)
        always = np.ones((len(beyond), len(self)))
        rows = replace(at, phi=np.vstack([at.phi.T, always]).T)
        R, p, J = self.wide.jacobian(np.concatenate([theta, beyond]), rows)
        slopes = self.slopes(R, p, theta)
        J = slopes.by_twist @ J
        by_joint, r = J[:, :, count:], np.nan_to_num(slopes.residual)
        # The shortest way from the readings: what is left here, and what has been gone already.
        gap = r + np.einsum("nmj,nj->nm", by_joint, at.positions - readings)
        back = by_joint.transpose(0, 2, 1)
        square = by_joint @ back
        # Damped along weak levers: near a singularity, or where a kind asks for more than the joints can give.
        weak = LEAST_LEVER**2 * np.einsum("nmm->n", square)[:, None, None] * np.eye(square.shape[1])
        off = (back @ np.linalg.solve(square + weak + DIVISION_GUARD * np.eye(square.shape[1]), gap[:, :, None]))[
            :, :, 0
        ]
        off[~self.conditions] = 0.0
        return slopes, J[:, :, :count], readings + np.clip(off, -LARGEST_CORRECTION, LARGEST_CORRECTION)

    def left(self, R: np.ndarray, p: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Measured minus predicted, shape (N, m), NaN in channels that a row does not measure.

        Args:
            R: Predicted rotations of the target, shape (N, 3, 3).
            p: Its positions, shape (N, 3), [m].
            theta: Values of the model's coefficients.
        """
        r = np.full((len(self), self.width), np.nan)
        for part, kind, rows in self._by_block():
            states, _ = self._states(kind, rows, theta)
            r[rows, part] = kind.residual(R[rows], p[rows], kind.numbers(self.observed[rows]), states)
        return r

    def slopes(self, R: np.ndarray, p: np.ndarray, theta: np.ndarray) -> Slopes:
        """Residuals, see :meth:`left`, with their derivatives."""
        n, m = len(self), self.width
        widest = max((len(t.role.components) for t in self.instruments.things.values() if t.role.many), default=0)
        r, twist = np.full((n, m), np.nan), np.zeros((n, m, 6))
        by_thing = np.zeros((n, m, widest))
        by_moved = tuple(np.zeros((n, m)) for _ in self.moved)
        for part, kind, rows in self._by_block():
            states, changes = self._states(kind, rows, theta)
            derivatives = kind.derivatives(R[rows], p[rows], kind.numbers(self.observed[rows]), states)
            r[rows, part], twist[rows, part] = derivatives.residual, derivatives.by_twist
            row = np.arange(n)[rows]
            for k, (role, change) in enumerate(zip(kind.roles, changes, strict=True)):
                by_state, thing = derivatives.by_state[k], self.refers[rows, k]
                if role.slope is not None:
                    by_state = by_state @ role.slope(self.states[role.name][thing], change)
                if role.many:
                    by_thing[rows, part, : by_state.shape[2]] = by_state
                for number, c in enumerate(self.moved):
                    if c.role == role.name:
                        hit = thing == c.thing
                        value = by_state[hit][:, :, c.components].sum(axis=2)
                        if c.varying is not None:
                            value = value * self.rows.phi[row[hit], c.varying][:, None]
                        by_moved[number][row[hit], part] = value
        return Slopes(r, twist, by_moved, by_thing)

    def _states(
        self, kind: MeasurementKind, rows: np.ndarray | slice, theta: np.ndarray
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """States (n, P) and changes (n, u) of some rows' things, for each role of their kind; 0 where a role has no faults."""
        states, changes = [], []
        for k, role in enumerate(kind.roles):
            thing = self.refers[rows, k]
            if role.name not in self.instruments.things:
                states.append(np.zeros((len(thing), role.size)))
                changes.append(np.zeros((len(thing), len(role.components))))
                continue
            start = self.states[role.name][thing]
            role = self.instruments.things[role.name].role  # a head has components of its own
            change = np.zeros((len(thing), len(role.components)))
            coefficients = [c for c in self.moved if c.role == role.name]
            for c in coefficients:
                hit = thing == c.thing
                step = theta[c.index] if c.varying is None else theta[c.index] * self.rows.phi[rows][hit, c.varying]
                change[np.ix_(hit, c.components)] += np.reshape(step, (-1, 1))
            states.append(role.moved(start, change) if coefficients else start)
            changes.append(change)
        return states, changes


def _distinct_rows_once(
    differentiate: Callable[[ModelRows], tuple[np.ndarray, np.ndarray, np.ndarray]], rows: ModelRows
) -> tuple[np.ndarray, ...]:
    """A model's answers for rows, computed once for equal rows that follow one another, as the marks in one image do."""
    route = np.zeros(len(rows)) if rows.route is None else rows.route  # one image may show marks of several limbs
    inputs = np.column_stack([rows.positions, rows.phi, rows.world, rows.tip, route])
    new = np.ones(len(rows), dtype=bool)
    new[1:] = np.any(inputs[1:] != inputs[:-1], axis=1)
    if new.all():
        return differentiate(rows)
    number = np.cumsum(new) - 1
    return tuple(result[number] for result in differentiate(rows[np.flatnonzero(new)]))


def rows_of_data(model: Model, data: Dataset, readings: np.ndarray | None = None) -> ModelRows:
    """The rows of a data set as a model sees them; with other readings of their joints, shape (N, columns), if these are given.

    Raises:
        CovariateNotFound: an effect depends on a column that was not measured.
        MeasurementError: a row's station or target is none of those that the model knows, or the model has not its path.
    """
    unknown = [route for route in data.labels.routes if route not in model.routes]
    if unknown:
        start, end = (link or "the default" for link in unknown[0])
        raise MeasurementError(f"{data.title}: no row of the calibration was measured from {start} to {end}")
    number = np.array([model.routes.index(route) for route in data.labels.routes])
    route_number = np.zeros(len(data), int) if data.labels.route is None else data.labels.route
    route = None if len(model.routes) == 1 else number[route_number]
    at = data.readings if readings is None else readings
    return model.rows(at, data.conditions, data.labels.station, data.labels.target, route)


def rows_at(observations: Observations, data: Dataset, positions: np.ndarray) -> ModelRows:
    """The rows of a data set with their joints, and all that depends on them, at other positions, shape (N, joints)."""
    return replace(
        rows_of_data(observations.model, data, readings_at(observations, data, positions)), positions=positions
    )


def readings_at(observations: Observations, data: Dataset, positions: np.ndarray) -> np.ndarray:
    """Readings of the joints, shape (N, columns), had they been at other positions, shape (N, joints)."""
    robot = observations.model.robot
    joints = [robot.names.index(name) for name in robot.readings]
    return np.asarray(data.readings + (positions - observations.rows.positions)[:, joints])


def observations_of(model: Model, data: Dataset) -> Observations:
    """What the rows of a data set read, beside a model; things that the model does not know are added to its own.

    Raises:
        CovariateNotFound: an effect depends on a column that was not measured.
        MeasurementError: see :func:`rows_of_data`.
    """
    instruments, number = merged_instruments(model.instruments, data.instruments)
    none = np.broadcast_to(-1, data.labels.refers.shape)  # of many rows of one tracker a number each would count
    refers = none.copy() if number else none
    for b, block in enumerate(data.blocks):
        rows = np.flatnonzero(data.labels.block == b)
        for k, role in enumerate(block.traits.roles):
            if role.name in number:
                labels, which = np.unique(data.labels.refers[rows, k], return_inverse=True)
                refers[rows, k] = np.array([number[role.name][str(label)] for label in labels], dtype=int)[which]
    ends = np.cumsum([0, *(sum(c.size for c in block.channels) for block in data.blocks)]).tolist()
    states = {name: t.start for name, t in instruments.things.items()}
    for name, state in model.states.items():
        states[name] = np.vstack([state, states[name][len(state) :]])
    conditional = any(block.traits.condition for block in data.blocks)
    return Observations(
        model=model,
        rows=rows_of_data(model, data),
        blocks=data.blocks,
        parts=tuple(slice(low, high) for low, high in pairwise(ends)),
        block=data.labels.block,
        observed=data.observed,
        refers=refers,
        instruments=instruments,
        moved=_thing_coefficients(model),
        width=columns(data.channels)[-1].stop,
        direct=_direct(model, data),
        states=states,
        wide=model.with_motions(model.own_motions) if conditional else None,
    )


def _direct(model: Model, data: Dataset) -> bool:
    """True where a tracker alone gives the place of targets on one chain, and neither data nor model say that it errs."""
    alone = len(data.blocks) == 1 and data.blocks[0].traits.tracked and not model.divided
    return alone and not any(things.free.any() for things in data.instruments.things.values())


def merged_instruments(first: Instruments, more: Instruments) -> tuple[Instruments, dict[str, dict[str, int]]]:
    """The things of both instruments, those of the first before the others, and the number of each by role and name."""
    things = dict(first.things)
    for role, new in more.things.items():
        things[role] = _with(first.things[role], new) if role in first.things else new
    number = {role: {name: k for k, name in enumerate(t.names)} for role, t in things.items()}
    return replace(first, things=things, ties=first.ties or more.ties), number


def _with(old: Things, new: Things) -> Things:
    """The old things, and behind them the new ones of other names."""
    names = frozenset(old.names)
    added = [k for k, name in enumerate(new.names) if name not in names]
    if not added:
        return old
    return Things(
        role=old.role,
        names=(*old.names, *(new.names[k] for k in added)),
        start=np.vstack([old.start, new.start[added]]),
        free=np.vstack([old.free, new.free[added]]),
        std=np.vstack([old.std, new.std[added]]),
        linked=old.linked | new.linked,
    )


def _thing_coefficients(model: Model) -> tuple[ThingMotion, ...]:
    """The model's coefficients that move things."""
    place = {name: (role, k) for role, things in model.instruments.things.items() for name, k in things.places.items()}
    varying = np.cumsum([not c.basis.constant for c in model.coefficients]) - 1
    coefficients = []
    for k in np.flatnonzero(model.at_things).tolist():
        c = model.coefficients[k]
        role, thing = place[c.where]
        components = model.instruments.things[role].role.moved_by(c.where, c.component)
        coefficients.append(ThingMotion(k, None if c.basis.constant else int(varying[k]), role, thing, components))
    return tuple(coefficients)


LOCATION_STEPS = 10
"""Steps at the most in which a thing is located from its own rows; three are usual."""

LOCATION_TOLERANCE = 1e-10
"""Change of a thing's components that ends its location: rounding."""


def solve_things(
    observations: Observations, R: np.ndarray, p: np.ndarray, theta: np.ndarray
) -> tuple[ThingStates, np.ndarray]:
    """Solve for the things whose place nobody knows, each from its own rows, while all else stays.

    Args:
        observations: N rows.
        R: Predicted rotations of the target, shape (N, 3, 3).
        p: Its positions, shape (N, 3), [m].
        theta: Values of the model's coefficients.

    Returns:
        The states with these, and by what each row's residual is to be stretched, shape (N,), so that its squares count as
        those of things that were known: sqrt(n / (n - u)) for n numbers and u unknowns; NaN where n is no more than u.
    """
    stretch = np.ones(len(observations))
    role, thing = observations.many()
    states = dict(observations.states)
    for number, name in enumerate(observations.roles):
        lost = np.atleast_1d(np.isnan(observations.states[name]).any(axis=1))
        of_role = np.flatnonzero(role == number)
        numbers = np.unique(thing[of_role])
        numbers = numbers[lost[numbers]]
        if len(numbers):
            states[name] = observations.states[name].copy()
        for k in numbers.tolist():
            of_thing = of_role[thing[of_role] == k]
            part = replace(observations[of_thing], states=states)
            states[name][k], rank = _located_thing(part, R[of_thing], p[of_thing], theta, name, k)
            count = float((~part.absent).sum())
            stretch[of_thing] = np.sqrt(count / (count - rank)) if count > rank else np.nan
    return states, stretch


def _located_thing(
    part: Observations, R: np.ndarray, p: np.ndarray, theta: np.ndarray, name: str, k: int
) -> tuple[np.ndarray, int]:
    """State (P,) of one thing from its rows alone, and how many of its components these rows determine."""
    number = int(part.block[0])
    kind = part.blocks[number].traits
    first = np.flatnonzero(part.block == number)
    states = [part.states[role.name][part.refers[first, j]] for j, role in enumerate(kind.roles)]
    start = kind.located(R[first], p[first], kind.numbers(part.observed[first]), states) if kind.located else None
    role, free = part.instruments.things[name].role, part.instruments.things[name].free[k]
    rank = int(free.sum())
    if start is None or not np.isfinite(start).all():
        return part.states[name][k], rank
    for _ in range(LOCATION_STEPS):
        state = part.states[name].copy()
        state[k] = start
        slopes = replace(part, states={**part.states, name: state}).slopes(R, p, theta)
        present = ~np.isnan(slopes.residual)
        B, r = slopes.by_thing[present][:, : len(free)][:, free], slopes.residual[present]
        step, _, rank, _ = np.linalg.lstsq(B, r, rcond=1e-10)
        change = np.zeros((1, len(free)))
        change[0, free] = step
        start = role.moved(start[None], change)[0]
        if np.all(np.abs(step) < LOCATION_TOLERANCE):
            break
    return start, int(rank)
