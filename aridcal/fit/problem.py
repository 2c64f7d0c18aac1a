"""A model asked about the rows of a data set: measured minus predicted, and its derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from aridcal.fit.elimination import (
    Groups,
    Known,
    groups,
    known,
    moved,
)
from aridcal.fit.noise import carried
from aridcal.fit.normal_equations import TINY
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.channels import Channels
from aridcal.instruments.pose import residuals
from aridcal.instruments.setup import Instruments
from aridcal.model.many_rows import starts, stretches
from aridcal.model.measured import Measured, Slopes, States, located, measured, rows_of_data
from aridcal.model.model import Model, Rows
from aridcal.showing import SILENT, Progress

BLOCK = 2048
"""Rows differentiated at a time: they stay in the cache, and memory stays flat."""

AGREEING = 6
"""Steps in which readings are moved until the measurements agree; each squares what is left."""

LARGEST = 0.1
"""[rad] and [m] from a reading to where its measurement agrees: farther is no small correction."""

ENOUGH = 1e-4
"""[rad] and [m] of a step after which rows agree to its square: no column is then off by more than rounding shows."""

ALONG = 1e-4
"""Share of a row's largest lever below which no reading is moved along a direction: near a singularity it would go far."""


@dataclass(frozen=True)
class Pieces:
    """A stretch of n rows of m numbers.

    Attributes:
        r: Scaled residuals, shape (n, m); 0 where a row does not measure a channel.
        J: Columns of the coefficients, things held, shape (n, m, K).
        B: Columns of the unknowns of the rows' groups, shape (n, m, U); U = 0 where there are none.
        agreed: Joint positions nearer to where the measurements agree with the model, shape (n, joints).
    """

    r: np.ndarray
    J: np.ndarray
    B: np.ndarray
    agreed: np.ndarray


@dataclass(frozen=True)
class Problem:
    """A model asked about the rows of a data set.

    Attributes:
        model: K coefficients.
        data: N rows, m numbers each.
        rows: The same rows as the model sees them.
        progress: Told how far each pass over the rows is.
        measured: What they read and of which things; None where all that they measure is the target's own pose.
        groups: Unknowns of things that are solved for beside the coefficients; None where there are none.
        states: Where the things are.
        wide: The model with each joint's own motion behind its coefficients, and the rows as that sees them; None where
            ``measured`` is.
        agreed: Joint positions at which the measurements agree with the model, shape (N, joints): there the rows are
            differentiated. None: at the readings themselves.
    """

    model: Model
    data: Dataset
    rows: Rows
    progress: Progress = SILENT
    measured: Measured | None = None
    groups: Groups | None = None
    states: States = field(default_factory=dict)
    wide: tuple[Model, Rows] | None = None
    agreed: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.data)

    @property
    def channels(self) -> Channels:
        """What each row measures."""
        return self.data.channels

    def blocks(self) -> Iterator[slice]:
        """Stretches of rows that are differentiated at a time; their passing is told."""
        begins = starts(len(self), BLOCK)
        for start in self.progress.through(begins, len(self), "rows", BLOCK):
            yield slice(start, len(self) if start == begins[-1] else start + BLOCK)

    def select(self, some: np.ndarray) -> Problem:
        """The same question about some of the rows."""
        return replace(
            self,
            data=self.data.select(some),
            rows=self.rows[some],
            measured=None if self.measured is None else self.measured[some],
            groups=None if self.groups is None else self.groups.select(some),
            wide=None if self.wide is None else (self.wide[0], self.wide[1][some]),
            agreed=None if self.agreed is None else self.agreed[some],
        )

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Measured minus predicted, shape (N, m); NaN in channels that a row does not measure.

        Things that the model does not know are solved for from these rows alone, and the freedom that this takes is given back.
        """
        if self.measured is None:
            return self._of_target(theta)
        R, p = self.model.poses(theta, self.rows)
        states, stretch = located(self.measured, R, p, theta, self.rows, self.states)
        r = self.measured.residual(R, p, theta, self.rows, states)
        return r * stretch[:, None]

    def _of_target(self, theta: np.ndarray) -> np.ndarray:
        """Residuals of the target's own pose, shape (N, m), in stretches, so that their axes are never there at once."""
        position, rotation = self.data.position, self.data.rotation
        left = np.empty((len(self), sum(channel.size for channel in self.channels)))
        for part in stretches(slice(None), len(self)):
            R, p = self.model.poses(theta, self.rows[part])
            left[part] = residuals(R, p, position[part], None if rotation is None else rotation[part])
        return left

    def scaled_residual(self, theta: np.ndarray) -> np.ndarray:
        """The same, divided by the rows' relative sigmas."""
        return scaled(self.residual(theta), self.data.relative)

    def linearised(self, theta: np.ndarray, part: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residuals (n, m) of a stretch of rows, and what each coefficient takes off them, shape (n, m, K)."""
        pieces = self.pieces(theta, part)
        return pieces.r, pieces.J

    def pieces(self, theta: np.ndarray, part: slice = slice(None)) -> Pieces:
        """Scaled residuals of a stretch of rows, and what takes them off."""
        if self.measured is None or self.wide is None:
            r, twists = self.of_joints(theta, part)
            rows = self.rows[part]
            J = self.model.of_coefficients(twists, rows)
            return Pieces(r, J, np.zeros((*r.shape, 0)), rows.positions)
        rows, relative = self.rows[part], None if self.data.relative is None else self.data.relative[part]
        here, at = self.measured[part], rows.positions
        if here.conditions.any():
            R, p = self.model.poses(theta, rows)
            states, _ = located(here, R, p, theta, rows, self.states)
            r = np.nan_to_num(here.residual(R, p, theta, rows, states))
            slopes, J, at = self._where_they_agree(theta, part, states)
        else:
            R, p, J = _each_once(lambda some: self.model.jacobian(theta, some), rows)
            states, _ = located(here, R, p, theta, rows, self.states)
            slopes = here.slopes(R, p, theta, rows, states)
            r, J = np.nan_to_num(slopes.residual), slopes.by_twist @ J
        for c, column in zip(here.moved, slopes.by_moved, strict=True):
            J[:, :, c.index] = column
        B = self.groups.columns(slopes.by_thing, part) if self.groups is not None else np.zeros((*r.shape, 0))
        return Pieces(scaled(r, relative), scaled(J, relative), scaled(B, relative), at)

    def of_joints(self, theta: np.ndarray, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residuals (n, m) of the target's own pose in a stretch, and what joints take off them, (n, m, joints)."""
        data, rows = self.data, self.rows[part]
        relative = None if data.relative is None else data.relative[part]
        R, p, twists = self.model.motions(theta, rows)
        r = residuals(R, p, data.position[part], None if data.rotation is None else data.rotation[part])
        twists = twists[:, : r.shape[1]]
        if data.relative is not None and data.rotation is not None:
            # log(exp(r) exp(-w)) = r - (w + r x w / 2 + ...): matters only where a row's axes weigh unequally.
            twists[:, 3:] += 0.5 * np.cross(r[:, 3:, None], twists[:, 3:], axis=1)
        return scaled(r, relative), scaled(twists, relative)

    def carried(self, theta: np.ndarray, covariance: np.ndarray, part: slice) -> np.ndarray:
        """What a covariance of the coefficients, (K, K), makes of the scaled residuals of a stretch of rows, (n, m, m)."""
        local = None if self.measured is not None else self.model.local
        if local is None:
            return carried(self.pieces(theta, part).J, covariance)
        return local.carried(self.of_joints(theta, part)[1], self.rows.phi[part], covariance)

    def nearer(self, theta: np.ndarray) -> Problem:
        """The same, differentiated nearer to where measurements and model agree."""
        states = self.settled(theta).states
        at = [self._where_they_agree(theta, block, states)[2] for block in self.blocks()]
        return replace(self, agreed=np.concatenate(at))

    def _where_they_agree(
        self, theta: np.ndarray, part: slice, states: States
    ) -> tuple[Slopes, np.ndarray, np.ndarray]:
        """How a stretch of rows changes there, columns of the coefficients (n, m, K), and positions nearer to it (n, joints)."""
        assert self.measured is not None and self.wide is not None
        (model, wide), rows, count = self.wide, self.rows[part], len(theta)
        at = rows.positions if self.agreed is None else self.agreed[part]
        beyond = np.zeros(len(model.coefficients) - count)
        R, p, J = model.jacobian(np.concatenate([theta, beyond]), replace(wide[part], positions=at))
        slopes = self.measured[part].slopes(R, p, theta, rows, states)
        J = slopes.by_twist @ J
        own, seen = J[:, :, count:], np.nan_to_num(slopes.residual)
        # The shortest way from the readings: what is left here, and what has been gone already.
        asked = seen + np.einsum("nmj,nj->nm", own, at - rows.positions)
        back = own.transpose(0, 2, 1)
        square = own @ back
        # Damped along weak levers: near a singularity, or where a kind asks for more than the joints can give.
        weak = ALONG**2 * np.einsum("nmm->n", square)[:, None, None] * np.eye(square.shape[1])
        off = (back @ np.linalg.solve(square + weak + TINY * np.eye(square.shape[1]), asked[:, :, None]))[:, :, 0]
        off[~self.measured[part].conditions] = 0.0
        return slopes, J[:, :, :count], rows.positions + np.clip(off, -LARGEST, LARGEST)

    @property
    def instruments(self) -> Instruments:
        """All things that model or rows know of."""
        return self.model.instruments if self.measured is None else self.measured.instruments

    def taken(self, weight: np.ndarray) -> np.ndarray:
        """Numbers of each channel that unknown things take up, shape (C,), in rows of some weight, shape (N,)."""
        count = np.zeros(len(self.channels))
        if self.groups is None:
            return count
        used = (weight > 0.0) & (self.groups.row >= 0)
        sizes = self.groups.unknown.sum(axis=1)
        pair = self.groups.row[used] * len(count) + self.data.measures[used].argmax(axis=1)
        rows = np.bincount(pair, minlength=len(sizes) * len(count)).reshape(len(sizes), len(count))
        return np.asarray(sizes @ (rows / np.maximum(rows.sum(axis=1, keepdims=True), 1)))

    def group_of(self, part: slice) -> np.ndarray:
        """Group of each of a stretch of rows, -1 for none."""
        return self.groups.row[part] if self.groups is not None else np.full(len(self.rows[part]), -1)

    def beforehand(self) -> Known | None:
        """What is known of the groups beforehand, about where their things are."""
        if self.groups is None or self.measured is None:
            return None
        return known(self.groups, self.measured.instruments, self.states)

    def settled(self, theta: np.ndarray) -> Problem:
        """The same with the things that the model does not know found from these rows alone."""
        if self.measured is None or not any(np.isnan(state).any() for state in self.states.values()):
            return self
        R, p = self.model.poses(theta, self.rows)
        return replace(self, states=located(self.measured, R, p, theta, self.rows, self.states)[0])

    def stepped(self, step: np.ndarray) -> Problem:
        """The same with the groups' unknowns moved, shape (G, U)."""
        if self.groups is None or self.measured is None:
            return self
        return replace(self, states=moved(self.states, self.groups, self.measured.instruments, step))


def problem(model: Model, data: Dataset, progress: Progress = SILENT) -> Problem:
    """Ask a model about a data set.

    Raises:
        CovariateNotFound: an effect depends on a column that was not measured.
        MeasurementError: a row's station is none of those that the model knows.
    """
    rows = rows_of_data(model, data)
    seen = measured(model, data)
    if seen is None:
        return Problem(model, data, rows, progress)
    states = {name: t.start for name, t in seen.instruments.things.items()}
    for name, state in model.states.items():
        states[name] = np.vstack([state, states[name][len(state) :]])
    wide = model.with_motions(model.own_motions)
    at = rows_of_data(wide, data)
    return Problem(model, data, rows, progress, seen, groups(seen), states, (wide, at))


def _each_once(ask: Callable[[Rows], tuple[np.ndarray, np.ndarray, np.ndarray]], rows: Rows) -> tuple[np.ndarray, ...]:
    """What a model says of rows, one of several that follow one another alike asked for all: the marks in one image."""
    route = np.zeros(len(rows)) if rows.route is None else rows.route  # one image may show marks of several limbs
    told = np.column_stack([rows.positions, rows.phi, rows.world, rows.tip, route])
    new = np.ones(len(rows), dtype=bool)
    new[1:] = np.any(told[1:] != told[:-1], axis=1)
    if new.all():
        return ask(rows)
    number = np.cumsum(new) - 1
    return tuple(said[number] for said in ask(rows[np.flatnonzero(new)]))


def agreed(question: Problem, theta: np.ndarray) -> Problem:
    """The same question, differentiated where measurements and model agree; see :func:`agreeing`."""
    return question if question.agreed is not None else agreeing(question, theta)


def agreeing(question: Problem, theta: np.ndarray) -> Problem:
    """The same question with its rows differentiated where measurements and model agree: readings moved as little as possible.

    What no measurement of a kind can tell (turns of the base where points are unknown, the scale where no length is known) turns
    or shrinks the residual, and would look as if it explained it; where the residual is zero its columns are zero. These are
    the derivatives of the Gauss-Helmert model (Helmert 1872): readings were observed, and a measurement is a condition on them.
    """
    if question.measured is None or not question.measured.conditions.any():
        return replace(question, agreed=question.rows.positions)
    before = question.rows.positions if question.agreed is None else question.agreed
    for _ in range(AGREEING):
        question = question.nearer(theta)
        assert question.agreed is not None
        moved, before = np.abs(question.agreed - before).max(initial=0.0), question.agreed
        if moved < ENOUGH:
            break
    return question


def scaled(values: np.ndarray, relative: np.ndarray | None) -> np.ndarray:
    """Residuals or columns, shape (N, m) or (N, m, K), divided by the rows' relative sigmas (see :class:`Dataset`)."""
    if relative is None or not values.size:
        return values
    wide = values.reshape(*values.shape[:2], -1)
    if relative.ndim == 3:
        divided = np.linalg.solve(relative, np.nan_to_num(wide))
        divided[np.isnan(wide)] = np.nan  # channels that a row does not measure
    else:
        divided = wide / relative[:, :, None]
    return np.asarray(divided.reshape(values.shape))


def unscaled(r: np.ndarray, relative: np.ndarray | None) -> np.ndarray:
    """Scaled residuals, shape (N, m), back in [m] and [rad]."""
    if relative is None:
        return r
    if relative.ndim < 3:
        return np.asarray(r * relative)
    stretched = np.einsum("nij,nj->ni", relative, np.nan_to_num(r))
    return np.where(np.isnan(r), np.nan, stretched)
