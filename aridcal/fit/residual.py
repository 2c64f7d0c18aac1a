"""A model asked about the rows of a data set: measured minus predicted, its derivatives, and robust measures of size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from aridcal.effects.basis import Basis
from aridcal.effects.effect import Coefficient
from aridcal.fit.elimination import (
    Eliminated,
    Groups,
    Known,
    Projector,
    Sums,
    groups,
    known,
    moved,
    projector,
    reduced,
    solved,
    tied_columns,
)
from aridcal.fit.flags import cauchy
from aridcal.fit.normal_equations import NormalEquations
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.channels import Channels, columns, spread
from aridcal.instruments.pose import residuals
from aridcal.instruments.setup import Instruments
from aridcal.model.measured import Measured, States, located, measured
from aridcal.model.model import Model, Rows
from aridcal.showing import SILENT, Progress

BLOCK = 512
"""Rows differentiated at a time: they stay in the cache, and memory stays flat."""

MANY = 300
"""Coefficients from which those are sought that move none of a block's rows: an ordinary arm has no such ones, and fewer cost
less than the search for them."""

AGREEING = 6
"""Steps in which readings are moved until the measurements agree; each squares what is left."""

LARGEST = 0.1
"""[rad] and [m] of one of these steps: from the nominal robot, farther is no small correction."""

ALONG = 1e-2
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
        starts = range(0, len(self), BLOCK)
        for start in self.progress.through(starts, len(self), "rows", BLOCK):
            yield slice(start, start + BLOCK)

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
        R, p = self.model.poses(theta, self.rows)
        if self.measured is None:
            return residuals(R, p, self.data.position, self.data.rotation)
        states, stretch = located(self.measured, R, p, theta, self.rows, self.states)
        r = self.measured.residual(R, p, theta, self.rows, states)
        return r * stretch[:, None]

    def scaled_residual(self, theta: np.ndarray) -> np.ndarray:
        """The same, divided by the rows' relative sigmas."""
        return scaled(self.residual(theta), self.data.relative)

    def linearised(self, theta: np.ndarray, part: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residuals (n, m) of a stretch of rows, and what each coefficient takes off them, shape (n, m, K)."""
        pieces = self.pieces(theta, part)
        return pieces.r, pieces.J

    def pieces(self, theta: np.ndarray, part: slice = slice(None)) -> Pieces:
        """Scaled residuals of a stretch of rows, and what takes them off."""
        data, rows = self.data, self.rows[part]
        relative = None if data.relative is None else data.relative[part]
        if self.measured is None or self.wide is None:
            R, p, J = self.model.jacobian(theta, rows)
            r = residuals(R, p, data.position[part], None if data.rotation is None else data.rotation[part])
            J = J[:, : r.shape[1]]
            if data.relative is not None and data.rotation is not None:
                # log(exp(r) exp(-w)) = r - (w + r x w / 2 + ...): matters only where a row's axes weigh unequally.
                J[:, 3:] += 0.5 * np.cross(r[:, 3:, None], J[:, 3:], axis=1)
            return Pieces(scaled(r, relative), scaled(J, relative), np.zeros((*r.shape, 0)), rows.positions)
        here, (model, wide) = self.measured[part], self.wide
        R, p = self.model.poses(theta, rows)
        states, _ = located(here, R, p, theta, rows, self.states)
        r = np.nan_to_num(here.residual(R, p, theta, rows, states))
        at = rows.positions if self.agreed is None else self.agreed[part]
        count = len(theta)
        beyond = np.zeros(len(model.coefficients) - count)
        R, p, J = model.jacobian(np.concatenate([theta, beyond]), replace(wide[part], positions=at))
        slopes = here.slopes(R, p, theta, rows, states)
        J = slopes.by_twist @ J
        for c, column in zip(here.moved, slopes.by_moved, strict=True):
            J[:, :, c.index] = column
        B = self.groups.columns(slopes.by_thing, part) if self.groups is not None else np.zeros((*r.shape, 0))
        off = np.linalg.pinv(J[:, :, count:], rcond=ALONG) @ np.nan_to_num(slopes.residual)[:, :, None]
        at = at + np.clip(off[:, :, 0], -LARGEST, LARGEST)
        return Pieces(scaled(r, relative), scaled(J[:, :, :count], relative), scaled(B, relative), at)

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
        channel = self.data.measures[used].argmax(axis=1)
        sizes = self.groups.unknown.sum(axis=1)
        for g in np.unique(self.groups.row[used]):
            own = self.groups.row[used] == g
            count += sizes[g] * np.bincount(channel[own], minlength=len(count)) / own.sum()
        return count

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
        if self.measured is None:
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
    rows = model.rows(data.readings, data.conditions, data.station, data.target)
    seen = measured(model, data)
    if seen is None:
        return Problem(model, data, rows, progress)
    states = {name: t.start for name, t in seen.instruments.things.items()}
    for name, state in model.states.items():
        states[name] = np.vstack([state, states[name][len(state) :]])
    names = model.robot.names
    ones = Basis("ones", (names[0],))
    wide = model.with_coefficients((*model.coefficients, *(Coefficient(name, "axis", ones) for name in names)))
    at = wide.rows(data.readings, data.conditions, data.station, data.target)
    return Problem(model, data, rows, progress, seen, groups(seen), states, (wide, at))


def agreed(question: Problem, theta: np.ndarray) -> Problem:
    """The same question, differentiated where measurements and model agree; see :func:`agreeing`."""
    return question if question.agreed is not None else agreeing(question, theta)


def agreeing(question: Problem, theta: np.ndarray) -> Problem:
    """The same question with its rows differentiated where measurements and model agree: readings moved as little as possible.

    What no measurement of a kind can tell (turns of the base where points are unknown, the scale where no length is known) turns
    or shrinks the residual, and would look as if it explained it; where the residual is zero its columns are zero. These are
    the derivatives of the Gauss-Helmert model (Helmert 1872): readings were observed, and a measurement is a condition on them.
    """
    if question.measured is None:
        return question
    question = replace(question, agreed=question.rows.positions)
    for _ in range(AGREEING):
        at = [question.pieces(theta, block).agreed for block in question.blocks()]
        question = replace(question, agreed=np.concatenate(at))
    return question


def moved_by(question: Problem, theta: np.ndarray, count: int) -> np.ndarray:
    """What the last coefficients alone take off the scaled residuals, things held, shape (N, m, count)."""
    size = sum(channel.size for channel in question.channels)
    J = np.empty((len(question), size, count))
    for block in question.blocks():
        if question.measured is None:
            _, _, twists = question.model.jacobian(theta, question.rows[block])
            relative = None if question.data.relative is None else question.data.relative[block]
            every = scaled(twists[:, :size], relative)
        else:
            every = question.pieces(theta, block).J
        J[block] = every[:, :, every.shape[2] - count :]
    return J


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


@dataclass(frozen=True)
class Linearisation:
    """A problem at one place: residuals, weights and normal equations.

    Attributes:
        residual: Scaled, shape (N, m); NaN where a row does not measure a channel.
        weight: Of each row, shape (N,).
        equations: Their sums, weights included; the unknowns of groups are solved for.
        agreed: Joint positions at which the measurements agree with the model, shape (N, joints), one step nearer.
        groups: Those, solved; None where there are none.
    """

    residual: np.ndarray
    weight: np.ndarray
    equations: NormalEquations
    agreed: np.ndarray
    groups: Eliminated | None = None

    @property
    def squares_known(self) -> float:
        """What stated facts on the things leave, in sigmas."""
        return 0.0 if self.groups is None else self.groups.squares

    def step_of_groups(self, step: np.ndarray) -> np.ndarray:
        """How the groups' unknowns follow a step of the coefficients (K,), shape (G, U)."""
        return np.zeros((0, 0)) if self.groups is None else self.groups.y - self.groups.X @ step


def linearise(question: Problem, theta: np.ndarray, weight: np.ndarray | None, sigma: np.ndarray) -> Linearisation:
    """Accumulate the normal equations, block by block.

    Args:
        question: K coefficients, N rows.
        theta: Values of the coefficients, shape (K,).
        weight: Of each row, shape (N,); None: Cauchy's, at scale ``sigma``.
        sigma: See ``weight``, shape (C,); the channels weigh so in what groups of several are solved for.
    """
    question = agreed(question, theta)
    channels, count = question.channels, len(theta)
    AA, Ar = np.zeros((len(channels), count, count)), np.zeros((len(channels), count))
    sums = _sums(question, count)
    parts, used, nearer = [], [], []
    for block in question.blocks():
        pieces = question.pieces(theta, block)
        r, J, B = pieces.r, pieces.J, pieces.B
        nearer.append(pieces.agreed)
        seen = _with_holes(question, block, r)
        w = cauchy(seen, sigma, channels) if weight is None else weight[block]
        root = np.sqrt(w * question.data.share)[:, None]
        if sums is not None:
            own, wide = root[:, :, None], question.group_of(block)
            sums.add(wide, B * own, J * own, r * root, channels)
        # Frames of other stations move none of these rows.
        some = np.flatnonzero(J.any(axis=(0, 1))) if count > MANY else np.arange(count)
        few = len(some) < count
        J = J[:, :, some] if few else J
        for k, part in enumerate(columns(channels)):
            A = (J[:, part] * root[:, :, None]).reshape(r[:, part].size, len(some))
            if few:
                AA[k][np.ix_(some, some)] += A.T @ A
            else:
                AA[k] += A.T @ A
            Ar[k][some] += A.T @ (r[:, part] * root).ravel()
        parts.append(seen)
        used.append(w)
    residual, weight = np.concatenate(parts), np.concatenate(used)
    counted = weight * question.data.share
    rr = weighted_squares(residual, counted, channels)
    equations = NormalEquations(AA, Ar, rr, _numbers(residual, counted, channels))
    beforehand = question.beforehand()
    if sums is None or question.groups is None or beforehand is None:
        return Linearisation(residual, weight, equations, np.concatenate(nearer))
    found = solved(sums, question.groups, beforehand, sigma)
    equations = reduced(equations, sums, found, beforehand, sigma)
    return Linearisation(residual, weight, equations, np.concatenate(nearer), found)


def _sums(question: Problem, count: int) -> Sums | None:
    """Sums of groups to begin with; None where there are no groups."""
    if question.groups is None:
        return None
    channels, (many, width) = len(question.channels), question.groups.unknown.shape
    return Sums(
        np.zeros((channels, many, width, width)),
        np.zeros((channels, many, width, count)),
        np.zeros((channels, many, width)),
    )


def _with_holes(question: Problem, part: slice, r: np.ndarray) -> np.ndarray:
    """Residuals (n, m) with NaN in channels that a row does not measure."""
    return r if question.measured is None else np.where(question.measured[part].absent, np.nan, r)


def _numbers(residual: np.ndarray, weight: np.ndarray, channels: Channels) -> np.ndarray:
    """Numbers measured in each channel, shape (C,), rows counted by weight."""
    there = np.array([~np.isnan(residual[:, part.start]) for part in columns(channels)])
    return np.array([channel.size * float(weight @ own) for channel, own in zip(channels, there, strict=True)])


def weighted_squares(residual: np.ndarray, weight: np.ndarray, channels: Channels) -> np.ndarray:
    """Sum of squares of each channel, shape (C,), rows counted by weight."""
    return np.array([float(weight @ np.nansum(residual[:, part] ** 2, axis=1)) for part in columns(channels)])


def eliminated(
    question: Problem, theta: np.ndarray, weight: np.ndarray, sigma: np.ndarray
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """Stretches of rows with their scaled residuals (n, m) and columns (n, m, K), less what the things take up.

    Args:
        question: K coefficients.
        theta: Their values.
        weight: Of each row, shape (N,): what things take up is found with these.
        sigma: Noise of each channel, shape (C,).
    """
    question = agreed(question, theta)
    found = linearise(question, theta, weight, sigma).groups if question.groups is not None else None
    for block in question.blocks():
        part = question.pieces(theta, block)
        if found is None:
            yield block, part.r, part.J
        else:
            yield block, *found.rows(question.group_of(block), part.B, part.J, part.r)


def taking_off(question: Problem, theta: np.ndarray, weight: np.ndarray, sigma: np.ndarray) -> Projector | None:
    """What takes the unknowns of things off columns of all rows; None where there are none. See :func:`eliminated`."""
    if question.groups is None:
        return None
    question = agreed(question, theta)
    found = linearise(question, theta, weight, sigma).groups
    assert found is not None
    B = np.concatenate([question.pieces(theta, block).B for block in question.blocks()])
    return projector(B, question.group_of(slice(None)), found, weight, spread(sigma, question.channels))


def triangle(question: Problem, theta: np.ndarray, weight: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Upper triangle R of the whitened Jacobian's QR, shape (<= K, K): all that rank and covariance need."""
    per_number = spread(1.0 / sigma, question.channels)
    R = np.empty((0, len(theta)))
    beforehand = question.beforehand()
    if beforehand is not None:
        found = linearise(question, theta, weight, sigma).groups
        R = R if found is None else tied_columns(found, beforehand)
    for block, r, J in eliminated(question, theta, weight, sigma):
        whitened = J * (np.sqrt(weight[block])[:, None] * per_number)[:, :, None]
        R = np.asarray(np.linalg.qr(np.vstack([R, whitened.reshape(r.size, len(theta))]), mode="r"))
    return R
