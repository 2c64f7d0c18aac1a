"""What the residual's scatter is made of: each instrument's channel, joints' readings, range, the arm's own repeatability.

A joint whose reading scatters moves the predicted target by its column: such noise grows with the lever, ties a row's
numbers together, and looks like no instrument. All rows that were measured while the arm stood still share it. Each cause is
one variance of their covariance (:mod:`aridcal.fit.variance_components`), chosen one after the other by a likelihood-ratio
test. Rows are then weighed with what was found: each with its own covariance, for weights know nothing of other rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from scipy.linalg import block_diag

from aridcal.effects.basis import Basis
from aridcal.effects.effect import Coefficient
from aridcal.fit.flags import FLOOR
from aridcal.fit.least_squares import Fit
from aridcal.fit.normal_equations import TINY
from aridcal.fit.problem import Problem, agreed, problem, scaled
from aridcal.fit.residual import moved_by
from aridcal.fit.scatter import Scatter, conditioned, told_modes
from aridcal.fit.standstills import Stack, representative, stack, standstills, with_things
from aridcal.fit.variance_components import Components, estimate, instead, one_more, settled, std_of_sigma
from aridcal.inputs.dataset import Dataset, factors
from aridcal.inputs.measurement_settings import OF_TARGETS
from aridcal.instruments.channels import TARGET_POSITION, TARGET_ROTATION, columns, spread
from aridcal.instruments.distance import DISTANCE
from aridcal.search.diagnose import SEARCHED
from aridcal.search.exact import GAUGE
from aridcal.search.linear_model import Active
from aridcal.search.noise_tests import neighbours
from aridcal.showing import SILENT, Progress

MATTERS = 0.05
"""Share of a channel's variance, at the row where it is largest, from which causes beyond the channels change the weights:
less changes them by less than people know their instrument."""

FEWEST = 40
"""Rows at the least that causes are asked of: with fewer, variances are known to no better than 20 %."""

REPEATABLE = 0.5
"""Share of a joint's scatter that comes back at neighbouring rows from which it is no noise but an error curve, or play: half."""

ALIKE = 3.0
"""Standard deviations of chance that it takes to say so. With a dozen orders asked about, 1 of 60 true noises is refused."""

UNSURE = 1.25
"""Times by which something may be more or less than it takes to say so, and is looked at again at variances that have settled."""

ALL_ALIKE = "all revolute joints"
"""Name of the cause that readings of all of them scatter alike: rounded to the same digit, or of the same encoder."""

Kind = Literal["channel", "joint", "joints", "range", "sight", "length", "repeatability"]


@dataclass(frozen=True)
class NoiseCause:
    """One cause of scatter.

    Attributes:
        kind: An instrument's ``channel``; the reading of a ``joint`` (or of all ``joints`` alike, which is told as that of each);
            ``range``: position noise per metre from the origin of
            the world frame; ``sight``: rotation noise about the line from there to the target; ``length``: noise of a
            distance per metre read; ``repeatability``: what is the same in every row, where rows state their noise.
        name: Of the channel or of the joint's reading; else the channel that it acts on.
        unit: Of value and std.
        value: 1-sigma (per axis).
        std: Of the value.
        share: Of the variance of each channel over the training rows, shape (C,).
    """

    kind: Kind
    name: str
    unit: str
    value: float
    std: float
    share: np.ndarray


@dataclass(frozen=True)
class NoiseCauses:
    """What the scatter of the training rows is made of.

    Attributes:
        causes: The channels first, then what was found beyond them.
        total: What all of them make of each channel, RMS per axis over the training rows, shape (C,).
        structured: Joints, and channels as range or line of sight concern them, that seem to scatter but whose errors come
            back at neighbouring rows: no noise.
        relative: Factors of all N rows' noise (see :class:`Dataset`), shape (N, m, m); None where the rows' own will do, as
            nothing beyond the channels matters.
        shared: Rows that share the error of a reading, on the average; 1 where no reading scatters.
    """

    causes: tuple[NoiseCause, ...]
    total: np.ndarray
    structured: tuple[tuple[Kind, str], ...]
    relative: np.ndarray | None
    shared: float

    @property
    def channels(self) -> tuple[NoiseCause, ...]:
        """The instrument's."""
        return tuple(c for c in self.causes if c.kind == "channel")

    @property
    def further(self) -> tuple[NoiseCause, ...]:
        """Those beyond the instrument's channels, the largest share of the first channel's variance first, then of the next."""
        return tuple(sorted((c for c in self.causes if c.kind != "channel"), key=lambda c: tuple(-c.share)))

    @property
    def beyond(self) -> np.ndarray:
        """What those make of each channel, RMS per axis over the training rows, shape (C,)."""
        return self.total * np.sqrt(sum((c.share for c in self.further), np.zeros(len(self.total))))


@dataclass(frozen=True)
class _Asked:
    """A cause that may be there.

    Attributes:
        kind: As of a :class:`NoiseCause`.
        name: Likewise.
        unit: Likewise.
        root: What it adds to a row's scaled residual per unit of itself, shape (N, m, d): d independent numbers.
    """

    kind: Kind
    name: str
    unit: str
    root: np.ndarray

    @property
    def common(self) -> bool:
        """True if all rows of a standstill share it."""
        return self.kind in ("joint", "joints")

    @property
    def blocks(self) -> np.ndarray:
        """Covariance of each row per unit of its variance, shape (N, m, m)."""
        return np.asarray(self.root @ self.root.transpose(0, 2, 1))

    @property
    def parts(self) -> tuple[_Asked, ...]:
        """What of it may come back by itself: each joint."""
        if self.kind != "joints":
            return (self,)
        return tuple(replace(self, root=self.root[:, :, k : k + 1]) for k in range(self.root.shape[2]))

    def stacked(self, still: Stack) -> np.ndarray:
        """The same of standstills, shape (S, M, M)."""
        if not self.common:
            return still.matrices(self.blocks)
        root = still.vectors(self.root)
        return np.asarray(root @ root.transpose(0, 2, 1))


def noise_causes(fit: Fit, active: Sequence[Active], rows: Dataset, progress: Progress = SILENT) -> NoiseCauses | None:
    """Find what the scatter is made of; None if there are too few rows to ask.

    Args:
        fit: The final model, fitted to the training rows.
        active: Its effects.
        rows: All rows, scaled by what the campaign says of their noise. Held-out rows are not asked; they are weighed.
        progress: Told how many causes are found.
    """
    asked = problem(fit.model, rows)
    train = np.flatnonzero(rows.train)[~fit.outliers]
    some = train[representative(asked.select(train), SEARCHED)]
    if len(some) < FEWEST:
        return None
    part = asked.select(some)
    possible = _possible(part, fit.theta)
    still = stack(standstills(part.data), _there(part.data))
    channels = np.array([p.kind == "channel" for p in possible])
    start = np.pad(np.maximum(fit.estimated, FLOOR) ** 2, (0, int((~channels).sum())))
    scatter = conditioned(_scatter(part, fit, active, possible, still), start)
    first = np.unique(still.number, return_index=True)[1]
    orders = {False: neighbours(part.data), True: neighbours(part.data.select(first))}
    structured = np.zeros(len(possible), dtype=bool)
    single, alike = (np.array([p.kind == kind for p in possible]) for kind in ("joint", "joints"))
    found = estimate(scatter, start[channels], channels)
    while (more := one_more(scatter, found, channels)) is not None:
        k, found = more
        progress.part(int(found.free.sum()), len(possible), "causes")
        if (found.free & single).sum() > 1 and (alike & ~found.free).any():
            # One number in place of several, if it says as much.
            fewer = instead(scatter, found, single, int(np.argmax(alike)), channels)
            k, found = (k, found) if fewer is None else (int(np.argmax(alike)), fewer)
        # What comes back stays in the model here, so that no other cause has to take it over, but it is not noise.
        said = partial(_comes_back, k=k, cause=possible[k], still=still, orders=orders[possible[k].common])
        if 1.0 / UNSURE < said(found) < UNSURE:
            found = settled(scatter, found, channels)
        structured[k] = said(found) > 1.0
        structured &= found.free
    found = settled(scatter, found, channels)
    return _told(possible, found, structured, part, asked, fit.theta, len(part) / still.count)


def _there(rows: Dataset) -> np.ndarray:
    """Which numbers each row measures, shape (N, m) bool."""
    return np.repeat(rows.measures, [channel.size for channel in rows.channels], axis=1)


def _scatter(part: Problem, fit: Fit, active: Sequence[Active], possible: Sequence[_Asked], still: Stack) -> Scatter:
    """The final model linearised where it is, at some rows, by standstills: smooth effects by the modes that the data tell."""
    here = agreed(part, fit.theta)
    pieces = [here.pieces(fit.theta, block) for block in here.blocks()]
    y, J, B = map(_together, ([p.r for p in pieces], [p.J for p in pieces], [p.B for p in pieces]))
    index = {name: k for k, name in enumerate(fit.model.names)}
    constant = [k for k, c in enumerate(fit.model.coefficients) if c.basis.constant]
    wide, (n, m), used = J.reshape(-1, J.shape[2]), y.shape, len(constant)
    A = np.empty((n * m, used + sum(a.modes.shape[1] for a in active)))
    A[:, :used], precision = wide[:, constant], [np.diag((GAUGE * fit.model.sizes[constant]) ** -2.0)]
    for a in active:
        own = [index[c.name] for c in a.effect.coefficients]
        side_by_side = own == list(range(own[0], own[0] + len(own)))
        part_of_J = wide[:, own[0] : own[0] + len(own)] if side_by_side else wide[:, own]
        column, known = np.matmul(part_of_J, a.modes, out=A[:, used : used + a.modes.shape[1]]), a.precision
        # A prior pulls the modes towards zero.
        y = y + (column @ np.linalg.lstsq(a.modes, fit.theta[own], rcond=None)[0]).reshape(n, m)
        if a.effect.smooth:
            told = told_modes(column.reshape(n, m, -1), spread(fit.sigma, part.channels))
            if told.shape[1] < len(told):
                A[:, used : used + told.shape[1]], known = column @ told, told.T @ known @ told
        used += len(known)
        precision.append(known)
    A = A[:, :used].reshape(n, m, -1)
    blocks = np.array([p.stacked(still) for p in possible])
    made = Scatter(still.vectors(y), still.vectors(A), block_diag(*precision), blocks)
    return with_things(made, part, B, still)


def _together(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays one behind the other; one alone as it is, for such arrays are large."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _possible(question: Problem, theta: np.ndarray) -> list[_Asked]:
    """Every cause that can be asked about, from the model alone: no row's residual is looked at."""
    rows, model = question.data, question.model
    ones = Basis("ones", (model.robot.names[0],))
    slots = tuple(Coefficient(j.name, "axis", ones) for j in model.robot.joints)
    at = np.concatenate([theta, np.zeros(len(slots))])
    more = problem(model.with_coefficients((*model.coefficients, *slots)), rows).settled(at)
    J = moved_by(more, at, len(slots))
    own = _there(rows)[:, :, None] * np.eye(J.shape[1])
    parts = list(zip(rows.channels, columns(rows.channels), strict=True))
    found = [_Asked("channel", channel.name, channel.unit, own[:, :, part]) for channel, part in parts]
    joints, readings = model.robot.joints, model.robot.readings
    driven = np.array([[j.multiplier * (j.reading == reading) for reading in readings] for j in joints])
    moved = J @ driven
    for k, (reading, kind) in enumerate(zip(readings, model.robot.kinds, strict=True)):
        found.append(_Asked("joint", reading, "m" if kind == "prismatic" else "rad", moved[:, :, k, None]))
    turning = np.array([kind != "prismatic" for kind in model.robot.kinds])
    if turning.sum() > 1:
        found.append(_Asked("joints", ALL_ALIKE, "rad", moved[:, :, turning]))
    for what, name, unit, root in _of_instruments(rows, more.model.poses(at, more.rows)[1], own):
        found.append(_Asked(what, name, unit, scaled(root, rows.relative)))
    return found


def _of_instruments(rows: Dataset, p: np.ndarray, own: np.ndarray) -> Iterator[tuple[Kind, str, str, np.ndarray]]:
    """What instruments would add: kind, channel, unit, and root of the covariance, shape (N, m, d).

    Args:
        rows: N rows.
        p: Where the model has the target, shape (N, 3), [m].
        own: Unit vectors of the numbers that each row measures, shape (N, m, m).
    """
    away = np.linalg.norm(p, axis=1)
    kinds = [None] * len(rows.channels) if not rows.blocks else [b.kind for b in rows.blocks for _ in b.channels]
    for kind, channel, part in zip(kinds, rows.channels, columns(rows.channels), strict=True):
        # Poses and positions are measured from the origin of the world frame, if from anywhere; other kinds are not.
        if kind in (None, *OF_TARGETS) and channel.axes == TARGET_POSITION.axes:
            yield "range", channel.name, "m/m", away[:, None, None] * own[:, :, part]
        if kind in (None, *OF_TARGETS) and channel.axes == TARGET_ROTATION.axes:
            sight = p / np.maximum(away, FLOOR)[:, None]
            yield "sight", channel.name, "rad", own[:, :, part] @ sight[:, :, None]
        if kind == DISTANCE.name:
            yield "length", channel.name, "m/m", np.abs(np.nan_to_num(rows.observed[:, :1, None])) * own[:, :, part]
        if rows.relative is not None and not np.allclose(scaled(own[:, :, part], rows.relative), own[:, :, part]):
            yield "repeatability", channel.name, channel.unit, own[:, :, part]


def _comes_back(found: Components, k: int, cause: _Asked, still: Stack, orders: Sequence[np.ndarray]) -> float:
    """How much what a cause was off by comes back at neighbouring rows, or at neighbouring standstills if these share it.

    What a row's residual says of it, with its sign, is u = J' P y; J' P J times the cause is in it. Of noise, products of
    two rows have the mean 0; of what comes back, they have theta times the product of both rows' J' P J. More than 1 is as
    much as it takes, in the part and the pairs in which it is most.

    Args:
        found: The maximum with this component.
        k: Which.
        cause: The same, its J of the rows.
        still: How the rows are stacked.
        orders: Pairs of rows or of standstills, shape (pairs, 2) each.
    """
    pull, kernel = found.pull[: still.count], found.kernel[: still.count]
    if not cause.common:
        pull, kernel = still.of_rows(pull), still.blocks_of_rows(kernel)
    most = 0.0
    for part in cause.parts:
        root = still.vectors(part.root) if cause.common else part.root
        said = np.einsum("nmd,nm->nd", root, pull)
        known = root.transpose(0, 2, 1) @ kernel @ root
        for a, b in (pairs.T for pairs in orders):
            product = np.einsum("nd,nd->n", said[a], said[b])
            whole = REPEATABLE * float(found.variance[k] * np.sum(known[a] * known[b]))
            chance = ALIKE * float(np.sqrt(product @ product))
            most = max(most, float(product.sum()) / max(whole, chance, TINY))
    return most


def _told(
    possible: Sequence[_Asked],
    found: Components,
    structured: np.ndarray,
    part: Problem,
    asked: Problem,
    theta: np.ndarray,
    together: float,
) -> NoiseCauses:
    """The causes in words and figures, and the factors that they give to all rows."""
    channel = np.array([p.kind == "channel" for p in possible])
    noise = (found.variance > 0.0) & ~structured
    relative = _weights(found.variance, noise, channel, asked, theta) if (noise & ~channel).any() else None
    if relative is None:
        noise &= channel
    each = _of_each_joint(possible)
    variance = each @ np.where(noise, found.variance, 0.0)
    std = std_of_sigma(variance, each @ np.where(np.outer(noise, noise), found.covariance, 0.0) @ each.T)
    chosen = np.flatnonzero(variance > 0.0).tolist()
    made = np.array([_spreads(variance[k] * possible[k].blocks, part.data) for k in chosen])
    total = made.sum(axis=0)
    causes = tuple(
        NoiseCause(
            p.kind, p.name, p.unit, float(np.sqrt(variance[k])), float(std[k]), own / np.maximum(total, FLOOR**2)
        )
        for k, own in zip(chosen, made, strict=True)
        for p in [possible[k]]
    )
    return NoiseCauses(
        causes=causes,
        total=np.sqrt(total),
        structured=tuple((p.kind, p.name) for p, back in zip(possible, structured, strict=True) if back),
        relative=relative,
        shared=together if any(c.kind == "joint" for c in causes) else 1.0,
    )


def _of_each_joint(possible: Sequence[_Asked]) -> np.ndarray:
    """Which components each cause is told with, shape (C, C): what all joints have alike each of them has, beside its own."""
    kinds, units = np.array([p.kind for p in possible]), np.array([p.unit for p in possible])
    each = np.eye(len(possible))
    each[kinds == "joints"] = 0.0
    each += np.outer((kinds == "joint") & (units == "rad"), kinds == "joints")
    return each


def stretched(relative: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Columns of shape (N, m, d) times the rows' relative sigmas or factors (see :class:`Dataset`)."""
    return np.asarray(relative @ values if relative.ndim == 3 else relative[:, :, None] * values)


def _spreads(covariance: np.ndarray, rows: Dataset) -> np.ndarray:
    """Mean variance of each channel per axis, unscaled, shape (C,), from scaled covariances of rows, (n, m, m)."""
    if rows.relative is not None:
        covariance = stretched(rows.relative, stretched(rows.relative, covariance).transpose(0, 2, 1))
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    parts = zip(columns(rows.channels), rows.measures.T, strict=True)
    return np.array([variance[own][:, part].mean() if own.any() else 0.0 for part, own in parts])


def _weights(
    variance: np.ndarray, noise: np.ndarray, channel: np.ndarray, asked: Problem, theta: np.ndarray
) -> np.ndarray | None:
    """Factors of all rows, shape (N, m, m); None if the causes beyond the channels change too little."""
    rows, possible = asked.data, _possible(asked, theta)
    V = np.sum([variance[k] * p.blocks for k, p in enumerate(possible) if noise[k]], axis=0)
    sigma = np.sqrt(variance[channel])
    there, usual = _there(rows), spread(sigma**2, rows.channels)
    V += np.where(there, 0.0, usual)[:, :, None] * np.eye(V.shape[1])  # what is not measured stays as it is
    if float(1.0 - (usual / np.diagonal(V, axis1=1, axis2=2))[there].min()) < MATTERS:
        return None
    inner = factors(V, sigma, rows.channels)
    return inner if rows.relative is None else stretched(rows.relative, inner)
