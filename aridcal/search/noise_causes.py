"""What the residual's scatter is made of: each instrument's channel, the readings of each joint, range and line of sight.

A joint whose reading scatters moves the predicted target by its column: such noise grows with the lever, ties a row's
numbers together, and looks like no instrument. Each cause is one variance of the rows' covariance
(:mod:`aridcal.fit.variance_components`), chosen one after the other by a likelihood-ratio test. Rows are then weighed with
what was found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial import cKDTree

from aridcal.effects.basis import Basis
from aridcal.effects.effect import Coefficient
from aridcal.fit.flags import FLOOR
from aridcal.fit.least_squares import Fit, thin
from aridcal.fit.problem import Problem, problem, scaled
from aridcal.fit.residual import eliminated, moved_by
from aridcal.fit.variance_components import Components, Scatter, estimate, one_more
from aridcal.inputs.dataset import Dataset, factors
from aridcal.instruments.channels import TARGET_POSITION, TARGET_ROTATION, columns, spread
from aridcal.search.diagnose import SEARCHED
from aridcal.search.exact import GAUGE
from aridcal.search.linear_model import Active
from aridcal.search.noise_tests import NEIGHBOURS
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

REACH = 3
"""Rows after each that count as its neighbours, in each order: a bump of few rows makes few pairs."""

Kind = Literal["channel", "joint", "range", "sight"]


@dataclass(frozen=True)
class NoiseCause:
    """One cause of scatter.

    Attributes:
        kind: An instrument's ``channel``; the reading of a ``joint``; ``range``: position noise per metre from the origin of
            the world frame; ``sight``: rotation noise about the line from there to the target.
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
    """

    causes: tuple[NoiseCause, ...]
    total: np.ndarray
    structured: tuple[tuple[Kind, str], ...]
    relative: np.ndarray | None

    @property
    def channels(self) -> tuple[NoiseCause, ...]:
        """The instrument's."""
        return tuple(c for c in self.causes if c.kind == "channel")

    @property
    def further(self) -> tuple[NoiseCause, ...]:
        """Those beyond the instrument's channels, the largest share of the first channel's variance first."""
        return tuple(sorted((c for c in self.causes if c.kind != "channel"), key=lambda c: -float(c.share[0])))

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
        root: What it adds to a row's scaled residual per unit of itself, shape (N, m, d) or (1, m, d): d independent numbers.
        block: Covariance of each row per unit of its variance, shape (N, m, m).
    """

    kind: Kind
    name: str
    unit: str
    root: np.ndarray
    block: np.ndarray


def noise_causes(fit: Fit, active: Sequence[Active], rows: Dataset, progress: Progress = SILENT) -> NoiseCauses | None:
    """Find what the scatter is made of; None if there are too few rows to ask.

    Args:
        fit: The final model, fitted to the training rows.
        active: Its effects.
        rows: All rows, scaled by what the campaign says of their noise. Held-out rows are not asked; they are weighed.
        progress: Told how many causes are found.
    """
    asked = problem(fit.model, rows)
    some = _sound(asked, fit)
    if len(some) < FEWEST or not rows.measures.all():  # of rows of several kinds each has channels of its own
        return None
    possible = _possible(asked, fit.theta)
    scatter = _scatter(asked, fit, active, some, [p.block[some] for p in possible])
    channels = np.array([p.kind == "channel" for p in possible])
    orders = _orders(rows.select(some))
    structured = np.zeros(len(possible), dtype=bool)
    found = estimate(scatter, np.maximum(fit.estimated, FLOOR) ** 2, channels)
    while (more := one_more(scatter, found, channels)) is not None:
        k, found = more
        progress.part(int(found.free.sum()), len(possible), "causes")
        # What comes back stays in the model here, so that no other cause has to take it over, but it is not noise.
        structured[k] = _comes_back(found, k, possible[k].root[some], orders)
    return _told(possible, found, structured, rows, some)


def _sound(asked: Problem, fit: Fit) -> np.ndarray:
    """Numbers of the training rows that are not flagged; of thousands, a reproducible choice."""
    train = np.flatnonzero(asked.data.train)[~fit.outliers]
    return train[thin(asked.rows[train], SEARCHED)]


def _scatter(
    asked: Problem, fit: Fit, active: Sequence[Active], some: np.ndarray, blocks: Sequence[np.ndarray]
) -> Scatter:
    """The final model linearised where it is, at some rows: smooth effects by the modes that the data can tell."""
    part = asked.select(some)
    pieces = [(r, J) for _, r, J in eliminated(part, fit.theta, np.ones(len(some)), fit.sigma)]
    r, J = (np.concatenate(stacked) for stacked in zip(*pieces, strict=True))
    index = {name: k for k, name in enumerate(fit.model.names)}
    constant = [k for k, c in enumerate(fit.model.coefficients) if c.basis.constant]
    A, precision, y = [J[:, :, constant]], [np.eye(len(constant)) / GAUGE**2], r
    for a in active:
        own = [index[c.name] for c in a.effect.coefficients]
        column = J[:, :, own] @ a.modes
        # A prior pulls the modes towards zero: the residual as it was without them.
        y = y + column @ np.linalg.lstsq(a.modes, fit.theta[own], rcond=None)[0]
        A.append(column)
        precision.append(a.precision)
    return Scatter(y, np.concatenate(A, axis=2), block_diag(*precision), np.array(blocks))


def _possible(asked: Problem, theta: np.ndarray) -> list[_Asked]:
    """Every cause that can be asked about, from the model alone: no row's residual is looked at."""
    rows, model = asked.data, asked.model
    m = sum(channel.size for channel in rows.channels)
    ones = Basis("ones", (model.robot.names[0],))
    slots = tuple(Coefficient(j.name, "axis", ones) for j in model.robot.joints)
    more = problem(model.with_coefficients((*model.coefficients, *slots)), rows)
    at = np.concatenate([theta, np.zeros(len(slots))])
    _, p = more.model.poses(at, more.rows)
    J = moved_by(more, at, len(slots))
    found = []
    for channel, part in zip(rows.channels, columns(rows.channels), strict=True):
        found.append(_asked("channel", channel.name, channel.unit, np.eye(m)[None, :, part], len(rows)))
    joints, readings = model.robot.joints, model.robot.readings
    driven = np.array([[j.multiplier * (j.reading == reading) for reading in readings] for j in joints])
    moved = J @ driven
    for k, (reading, kind) in enumerate(zip(readings, model.robot.kinds, strict=True)):
        found.append(_asked("joint", reading, "m" if kind == "prismatic" else "rad", moved[:, :, k, None], len(rows)))
    for what, name, unit, root in _from_the_instrument(rows, p, m):
        found.append(_asked(what, name, unit, scaled(root, rows.relative), len(rows)))
    return found


def _from_the_instrument(rows: Dataset, p: np.ndarray, m: int) -> Iterator[tuple[Kind, str, str, np.ndarray]]:
    """What an instrument at the world's origin would add: kind, channel, unit, and root of the covariance, (N, m, d)."""
    if rows.blocks:
        return  # what measures does not stand at the origin
    away = np.linalg.norm(p, axis=1)
    for channel, part in zip(rows.channels, columns(rows.channels), strict=True):
        if channel == TARGET_POSITION:
            yield "range", channel.name, "m/m", away[:, None, None] * np.eye(m)[None, :, part]
        if channel == TARGET_ROTATION:
            root = np.zeros((len(p), m, 1))
            root[:, part, 0] = p / np.maximum(away, FLOOR)[:, None]
            yield "sight", channel.name, "rad", root


def _asked(kind: Kind, name: str, unit: str, root: np.ndarray, n: int) -> _Asked:
    """A cause from its root."""
    block = root @ root.transpose(0, 2, 1)
    return _Asked(kind, name, unit, root, np.broadcast_to(block, (n, *block.shape[1:])))


def _orders(rows: Dataset) -> list[np.ndarray]:
    """Pairs of neighbouring rows, shape (pairs, 2) each, in several orders.

    In time (as they stand, where there is no time), along every reading, and in all readings at once, where repeats are
    nearest.
    """
    found = [_successors(rows.sequence)]
    deviation = rows.readings.std(axis=0)
    moves = deviation > FLOOR
    found += [_successors(np.argsort(q, kind="stable")) for q in rows.readings.T[moves]]
    points = rows.readings[:, moves] / deviation[moves]
    near = np.asarray(cKDTree(points).query(points, k=NEIGHBOURS + 1)[1])[:, 1:]
    pairs = np.column_stack([np.repeat(np.arange(len(rows)), NEIGHBOURS), near.ravel()])
    return [*found, np.unique(np.sort(pairs, axis=1), axis=0)]


def _successors(order: np.ndarray) -> np.ndarray:
    """Pairs of rows that are at most :data:`REACH` apart in an order of shape (N,)."""
    return np.concatenate([np.column_stack([order[:-k], order[k:]]) for k in range(1, REACH + 1)])


def _comes_back(found: Components, k: int, root: np.ndarray, orders: Sequence[np.ndarray]) -> bool:
    """True if what a cause was off by comes back at neighbouring rows.

    What a row's residual says of it, with its sign, is u = J' P y; J' P J times the cause is in it. Of noise, products of
    two rows have the mean 0; of what comes back, they have theta times the product of both rows' J' P J.

    Args:
        found: The maximum with this component.
        k: Which.
        root: Its J, shape (n, m, d).
        orders: Pairs of rows, shape (pairs, 2) each.
    """
    said = np.einsum("nmd,nm->nd", root, found.pull)
    known = root.transpose(0, 2, 1) @ found.kernel @ root
    for a, b in (pairs.T for pairs in orders):
        product = np.einsum("nd,nd->n", said[a], said[b])
        whole = float(found.variance[k] * np.sum(known[a] * known[b]))
        enough = float(product.sum()) > ALIKE * float(np.sqrt(product @ product))
        if enough and float(product.sum()) > REPEATABLE * whole:
            return True
    return False


def _told(
    possible: Sequence[_Asked], found: Components, structured: np.ndarray, rows: Dataset, some: np.ndarray
) -> NoiseCauses:
    """The causes in words and figures, and the factors that they give to all rows."""
    channel = np.array([p.kind == "channel" for p in possible])
    noise = (found.variance > 0.0) & ~structured
    relative = _weights(possible, found.variance, noise, rows)
    if relative is None:
        noise &= channel
    chosen = [k for k in range(len(possible)) if noise[k]]
    made = np.array([_spreads(found.variance[k] * possible[k].block[some], rows, some) for k in chosen])
    total = made.sum(axis=0)
    sigma, std = found.sigma, found.sigma_std
    causes = tuple(
        NoiseCause(p.kind, p.name, p.unit, float(sigma[k]), float(std[k]), own / total)
        for k, own in zip(chosen, made, strict=True)
        for p in [possible[k]]
    )
    return NoiseCauses(
        causes=causes,
        total=np.sqrt(total),
        structured=tuple((p.kind, p.name) for p, back in zip(possible, structured, strict=True) if back),
        relative=relative,
    )


def structured_notices(causes: NoiseCauses | None) -> list[str]:
    """Sentences on what seems to scatter and does not."""
    looks = {
        "joint": "the residual looks as if {} were misread at random, but its errors come back at neighbouring rows: an error "
        "curve or play that the model lacks, and no noise",
        "range": "the {} error grows with the distance from the origin of the world frame, but comes back at neighbouring "
        "rows: it is no noise",
        "sight": "the {} error is about the line of sight, but comes back at neighbouring rows: it is no noise",
    }
    return [looks[kind].format(name) for kind, name in (causes.structured if causes is not None else ())]


def stretched(relative: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Columns of shape (N, m, d) times the rows' relative sigmas or factors (see :class:`Dataset`)."""
    return np.asarray(relative @ values if relative.ndim == 3 else relative[:, :, None] * values)


def _spreads(covariance: np.ndarray, rows: Dataset, some: np.ndarray) -> np.ndarray:
    """Mean variance of each channel per axis, unscaled, shape (C,), from scaled covariances of some rows, (n, m, m)."""
    own = None if rows.relative is None else rows.relative[some]
    if own is not None:
        covariance = stretched(own, stretched(own, covariance).transpose(0, 2, 1))
    variance = np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0)
    return np.array([variance[part].mean() for part in columns(rows.channels)])


def _weights(possible: Sequence[_Asked], variance: np.ndarray, noise: np.ndarray, rows: Dataset) -> np.ndarray | None:
    """Factors of all rows, shape (N, m, m); None if the causes beyond the channels change too little."""
    channel = np.array([p.kind == "channel" for p in possible])
    if not (noise & ~channel).any():
        return None
    V = np.sum([variance[k] * p.block for k, p in enumerate(possible) if noise[k]], axis=0)
    sigma = np.sqrt(variance[channel])
    own = spread(sigma**2, rows.channels) / np.diagonal(V, axis1=1, axis2=2)
    if float(1.0 - own.min()) < MATTERS:
        return None
    inner = factors(V, sigma)
    return inner if rows.relative is None else stretched(rows.relative, inner)
