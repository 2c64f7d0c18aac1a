"""What the residual's scatter is made of: each instrument's channel, joints' readings, range, the arm's own repeatability.

A joint whose reading scatters moves the predicted target by its column: such noise grows with the lever, ties a row's
numbers together, and looks like no instrument. All rows that were measured while the arm stood still share it. Each cause is
one variance of their covariance (:mod:`aridcal.engine.fit.variance_components`), chosen one after the other by a likelihood-ratio
test. Rows are then weighed with what was found: each with its own covariance, for weights know nothing of other rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np
from scipy.linalg import block_diag

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.scatter import Scatter, conditioned, covariances, told_modes
from aridcal.engine.fit.shared_readings import Stack, representative, stack, standstills, with_things
from aridcal.engine.fit.variance_components import (
    Components,
    asked_for,
    estimate,
    highest,
    instead,
    needed,
    one_more,
    promised,
    roughly_without,
    settled,
    std_of_sigma,
    with_one,
    without,
)
from aridcal.engine.instruments.channels import Channel, columns, spread
from aridcal.engine.levels import FEWEST_ROWS, STRONG, SURELY
from aridcal.engine.numerics import FLOOR, TINY
from aridcal.engine.rows.dataset import Dataset, factors
from aridcal.engine.search.diagnose import SEARCHED
from aridcal.engine.search.exact import GAUGE
from aridcal.engine.search.linear_model import Active
from aridcal.engine.search.noise_hypotheses import Asked, Kind, possible, shaped, stretched, there
from aridcal.engine.search.noise_shapes import SHAPES, Seen, Shape, aimed, nearby, shapes_of
from aridcal.engine.search.noise_tests import neighbours
from aridcal.system.progress import SILENT, Progress

MATTERS = 0.05
"""Share of a channel's variance, at the row where it is largest, from which causes beyond the channels change the weights:
less changes them by less than people know their instrument."""

REPEATABLE = 0.5
"""Share of a joint's scatter that comes back at neighbouring rows from which it is no noise but an error curve, or play: half."""

UNSURE = 1.25
"""Work: Times by which something may be more or less than it takes to say so, and is looked at again at variances that have
settled."""

ASKED = 800
"""Work: Rows that are asked at the most, of more: a sigma of three numbers a row is then known to 1.5 %, and every trial costs
as many as there are."""

CHALLENGERS = 4
"""Work: Rivals of a named cause that are tried at the most, those that the residual asks for most without it."""

NEAR = 0.7
"""Work: Share of the largest score from which a rival is looked at: gains go by its square, and are half as large at least."""

LOOSE = 5.0
"""Work: [nat] by which a rival may be worse, by a bound on the likelihood, to be tried: the bound holds the columns as they
are."""

STEPS = (0.1, 0.03)
"""Work: Shares of its size by which the numbers of a shape are moved to see whether it explains more so: the first is a
fraction of what shapes that are tried are apart, the last what a thousand rows tell of a direction."""

SETTLED = 0.1
"""Work: [nat] that such a move must gain at the least."""

WEAK = 30.0
"""Work: [nat] that a cause seems to gain, its columns held, above which it is not left out on trial: chance gives no 15, and
the same again is left for columns that would fit anew. Judgement."""

IN_WORLD = ("range", "direction", "depth", "bearing")
"""Forms that noise may have in the world's axes."""

ROUNDS = 2
"""Work: Times that named causes meet their rivals at the most: once is usual."""


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
        shape: What it lies along; None for the others.
        rivals: What explains the scatter as well in its place: the rows do not tell which it is.
    """

    kind: Kind
    name: str
    unit: str
    value: float
    std: float
    share: np.ndarray
    shape: Shape | None = None
    rivals: tuple[NoiseCause, ...] = ()


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


# A cause that explains the scatter as well as another, the maximum with it instead, and its number there.
Tie = tuple[Asked, Components, int]


@dataclass(frozen=True)
class _Inquiry:
    """What is asked, of which rows.

    Attributes:
        causes: All that may be, those with a shape last.
        scatter: Residuals, and the covariances of these causes.
        seen: Where the targets are.
        channels: Those whose noise may have a shape.
        rows: The rows.
        still: How they are stacked.
        orders: Pairs of neighbouring rows, and of neighbouring standstills.
    """

    causes: tuple[Asked, ...]
    scatter: Scatter
    seen: Seen
    channels: tuple[Channel, ...]
    rows: Dataset
    still: Stack
    orders: dict[bool, list[np.ndarray]]

    def of(self, *kinds: str) -> np.ndarray:
        """Which causes are of some kinds, shape (C,) bool."""
        return np.array([cause.kind in kinds for cause in self.causes])

    @cached_property
    def held(self) -> np.ndarray:
        """Which are the channels."""
        return self.of("channel")

    @cached_property
    def price(self) -> np.ndarray:
        """What the numbers of shapes cost, shape (C,), [nat]."""
        return np.array([0.0 if c.shape is None else c.shape.price(len(self.rows)) for c in self.causes])

    def beside(self, some: np.ndarray, kinds: Sequence[str]) -> np.ndarray:
        """Which causes of some kinds act on a channel that one of these kinds acts on among some causes, shape (C,) bool."""
        along, names = self.of(*kinds), np.array([cause.name for cause in self.causes])
        return along & np.isin(names, names[some & along])

    def second(self, found: Components) -> np.ndarray:
        """Which causes lie in the world's axes beside one of their channel, shape (C,) bool: they would be what it misses."""
        return self.beside(found.free, IN_WORLD)

    def rests(self, structured: np.ndarray) -> np.ndarray:
        """Which causes lie along something of a channel of which such a one comes back, shape (C,) bool.

        A frame that turns slowly is off along no single direction: what one leaves of it, another would be named for.
        """
        return self.beside(structured, ("range", "sight", *SHAPES))

    def aimed(self, found: Components) -> _Inquiry:
        """The same with all shapes that are not in the model as what it leaves asks for them."""
        made = self
        for k, some in self.shapes(found).items():
            made = made.with_shape(k, some[0])
        return made

    def shapes(self, found: Components) -> dict[int, list[Shape]]:
        """Shapes that what a maximum leaves may ask for, of each cause that has one and is not in the model."""
        at = [k for k, cause in enumerate(self.causes) if cause.shape is not None]
        if found.free[at].all():
            return {}
        scatter, still = self.scatter, self.still
        pull, kernel = found.pull[: still.count], found.kernel[: still.count]
        left = np.einsum("nij,nj->ni", covariances(scatter, found.at)[: still.count], pull)
        pull, kernel, left = still.of_rows(pull), still.blocks_of_rows(kernel), still.of_rows(left)
        every = aimed(self.seen, self.channels, left, pull, kernel)
        return {k: some for k, some in zip(at, every, strict=True) if not found.free[k]}

    def with_shape(self, k: int, shape: Shape) -> _Inquiry:
        """The same with another shape of a cause."""
        cause = shaped(shape, self.seen)
        blocks = self.scatter.blocks.copy()
        blocks[k, : self.still.count] = cause.stacked(self.still)
        causes = (*self.causes[:k], cause, *self.causes[k + 1 :])
        return replace(self, causes=causes, scatter=replace(self.scatter, blocks=blocks))

    def refined(self, found: Components, k: int) -> tuple[_Inquiry, Components]:
        """A cause that was just named with the likeliest of its shapes and of the numbers near these, and the maximum.

        A shape that is a little off leaves a rest that something else is accused of.
        """
        shape, own = self.causes[k].shape, np.arange(len(self.causes)) == k
        if shape is None:
            return self, found

        def likeliest(shapes: Iterable[Shape]) -> tuple[float, Shape]:
            return max(((self._height_with(found, k, other), other) for other in shapes), key=itemgetter(0))

        height, shape = likeliest([shape, *self.shapes(roughly_without(self.scatter, found, own)).get(k, [])])
        for step in STEPS if shape.free else ():  # else no number of it was taken from the residual
            while (better := likeliest(nearby(shape, step, self.seen)))[0] > height + SETTLED:
                height, shape = better
        again = self.with_shape(k, shape)
        return again, with_one(again.scatter, found, k, float(found.variance[k]))

    def _height_with(self, found: Components, k: int, shape: Shape) -> float:
        """The bound about a maximum where a cause has another shape, what this costs taken off."""
        free = np.flatnonzero(found.free)
        blocks = self.scatter.blocks[free]
        blocks[int(np.searchsorted(free, k)), : self.still.count] = shaped(shape, self.seen).stacked(self.still)
        rows = replace(self.scatter, blocks=blocks)
        return highest(rows, self.scatter, found, free) - shape.price(len(self.rows))

    def comes_back(self, found: Components, k: int) -> tuple[bool, Components]:
        """True if what a cause was off by comes back at neighbours: then it is no noise; and the maximum, settled if need be."""
        share = self._repeated(found, k)
        if 1.0 / UNSURE < share < UNSURE:
            found = settled(self.scatter, found)
            share = self._repeated(found, k)
        return share > 1.0, found

    def _repeated(self, found: Components, k: int) -> float:
        """How much what a cause was off by comes back at neighbouring rows, or at neighbouring standstills if these share it.

        What a row's residual says of it, with its sign, is u = J' P y; J' P J times the cause is in it. Of noise, products of
        two rows have the mean 0; of what comes back, they have theta times the product of both rows' J' P J. More than 1 is as
        much as it takes, in the part and the pairs in which it is most.
        """
        cause, still = self.causes[k], self.still
        pull, kernel = found.pull[: still.count], found.kernel[: still.count]
        if not cause.common:
            pull, kernel = still.of_rows(pull), still.blocks_of_rows(kernel)
        most = 0.0
        for part in cause.parts:
            root = still.vectors(part.root) if cause.common else part.root
            said = np.einsum("nmd,nm->nd", root, pull)
            known = root.transpose(0, 2, 1) @ kernel @ root
            for a, b in (pairs.T for pairs in self.orders[cause.common]):
                product = np.einsum("nd,nd->n", said[a], said[b])
                whole = REPEATABLE * float(found.variance[k] * np.sum(known[a] * known[b]))
                chance = SURELY * float(np.sqrt(product @ product))
                most = max(most, float(product.sum()) / max(whole, chance, TINY))
        return most


def noise_causes(
    fit: Fit, active: Sequence[Active], rows: Dataset, progress: Progress = SILENT, shapes: bool = True
) -> NoiseCauses | None:
    """Find what the scatter is made of; None if there are too few rows to ask.

    Args:
        fit: The final model, fitted to the training rows.
        active: Its effects.
        rows: All rows, scaled by what the campaign says of their noise. Held-out rows are not asked; they are weighed.
        progress: Told how many causes are found.
        shapes: Whether noise along directions, lines of sight, axes of the target and levers is asked about, too.
    """
    asked = problem(fit.model, rows)
    train = np.flatnonzero(rows.train)[~fit.outliers]
    some = representative(asked, train, ASKED if shapes else SEARCHED)
    if len(some) < FEWEST_ROWS:
        return None
    part = asked.select(some)
    inquiry = _inquiry(part, fit, active, shapes)
    held = inquiry.held
    found = estimate(inquiry.scatter, np.maximum(fit.estimated, FLOOR) ** 2, held)
    structured = np.zeros(len(held), dtype=bool)
    for _ in range(ROUNDS):
        inquiry, found, structured = _named(inquiry, found, structured, progress)
        inquiry, found, ties = _challenged(inquiry, found, structured | inquiry.rests(structured))
        if ties is not None:
            break
        structured &= found.free
    found = settled(inquiry.scatter, found)
    return _told(inquiry, found, structured, ties or {}, asked, fit.theta)


def _inquiry(part: Problem, fit: Fit, active: Sequence[Active], shapes: bool) -> _Inquiry:
    """What is asked of some rows."""
    causes, seen = possible(part, fit.theta)
    channels = tuple(channel for channel in part.channels if shapes and channel.name in seen.own)
    nothing = np.zeros((*causes[0].root.shape[:2], 1))
    for channel in channels:
        # Aimed as soon as there is a fit that says where.
        causes += [Asked(shape.kind, channel.name, shape.unit, nothing, shape) for shape in shapes_of(seen, channel)]
    still = stack(standstills(part.data), there(part.data))
    start = np.zeros(len(causes))
    start[: len(part.channels)] = np.maximum(fit.estimated, FLOOR) ** 2
    scatter = conditioned(_scatter(part, fit, active, causes, still), start)
    first = np.unique(still.number, return_index=True)[1]
    near = neighbours(part.data)
    orders = {False: near, True: near if len(first) == len(part.data) else neighbours(part.data.select(first))}
    return _Inquiry(tuple(causes), scatter, seen, channels, part.data, still, orders)


def _named(
    inquiry: _Inquiry, found: Components, structured: np.ndarray, progress: Progress
) -> tuple[_Inquiry, Components, np.ndarray]:
    """Causes one after the other, as long as more than chance asks for one."""
    single, alike, held = inquiry.of("joint"), inquiry.of("joints"), inquiry.held
    inquiry = inquiry.aimed(found)
    while True:
        # No price is enough for what would only be named for what another misses.
        price = np.where(inquiry.second(found), np.inf, inquiry.price)
        more = one_more(inquiry.scatter, found, held, price)
        if more is None:
            return inquiry, found, structured
        k, found = more
        progress.part(int(found.free.sum()), len(held), "causes")
        if (found.free & single).sum() > 1 and (alike & ~found.free).any():
            # One number in place of several, if it says as much.
            fewer = instead(inquiry.scatter, found, single, int(np.argmax(alike)))
            k, found = (k, found) if fewer is None else (int(np.argmax(alike)), fewer)
        inquiry, found = inquiry.refined(found, k)
        # What comes back stays in the model here, so that no other cause has to take it over, but it is not noise.
        structured[k], found = inquiry.comes_back(found, k)
        structured &= found.free
        inquiry = inquiry.aimed(found)


def _challenged(
    inquiry: _Inquiry, found: Components, structured: np.ndarray
) -> tuple[_Inquiry, Components, dict[int, list[Tie]] | None]:
    """Let each named cause meet its rivals, and joints that are accused together those of all of them.

    Returns:
        What is asked, the maximum, and the rivals that are as good, by cause. Where a cause is not needed, or a rival explains
        more, it is the maximum without that cause, or with that rival, and None.
    """
    held, price, scatter = inquiry.held, inquiry.price, inquiry.scatter
    accused = found.free & ~held & ~structured & (found.variance > 0.0)
    sets = [np.arange(len(held)) == k for k in np.flatnonzero(accused)]
    joints = accused & inquiry.of("joint", "joints")
    if joints.sum() > 1:
        sets.insert(0, joints)
    ties: dict[int, list[Tie]] = {int(k): [] for k in np.flatnonzero(accused)}
    for own in sets:
        cost = float(price[own].sum())
        base = roughly_without(scatter, found, own)
        if found.log_likelihood - base.log_likelihood - cost < WEAK:
            base = without(scatter, found, own)
            if not needed(found, base, cost, held):
                return inquiry, base, None
        worth = found.log_likelihood - cost
        again = inquiry.aimed(base)
        tried = [(k, with_one(again.scatter, base, k, variance)) for k, variance in _likeliest(again, base, own, worth)]
        gains = [more.log_likelihood - again.price[k] - worth for k, more in tried]
        if gains and max(gains) > 0.0:
            k, more = tried[int(np.argmax(gains))]
            return again, more, None
        for (k, more), gain in zip(tried, gains, strict=True):
            # A shape may well coincide with a joint's motion, so that its price is none to those who must be told of it.
            if gain + again.price[k] > -STRONG:
                for mine in np.flatnonzero(own):
                    ties[int(mine)].append((again.causes[k], more, k))
    return inquiry, found, ties


def _likeliest(inquiry: _Inquiry, base: Components, own: np.ndarray, worth: float) -> list[tuple[int, float]]:
    """Rivals of a set of named causes, shape (C,) bool, that may be as good, and the variances at which they begin.

    What is asked is aimed at the maximum without the set; ``worth`` is the log-likelihood with it, what it costs taken off.
    """
    asked = asked_for(inquiry.scatter, base)
    least = max(worth - base.log_likelihood - LOOSE, 0.0)
    enough = ~own & ~inquiry.second(base) & (asked.normal > max(NEAR * asked.normal.max(), 0.0))
    most = [int(k) for k in np.argsort(-asked.normal) if enough[k]][:CHALLENGERS]
    if not most:
        return []
    gains = promised(inquiry.scatter, base, [np.arange(len(own)) == k for k in most], asked.variance)
    return [(k, float(asked.variance[k])) for k, gain in zip(most, gains, strict=True) if gain > least]


def _scatter(part: Problem, fit: Fit, active: Sequence[Active], causes: Sequence[Asked], still: Stack) -> Scatter:
    """The final model linearised where it is, at some rows, by standstills: smooth effects by the modes that the data tell."""
    here = part.agreeing(fit.theta)
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
    blocks = np.array([cause.stacked(still) for cause in causes])
    made = Scatter(still.vectors(y), still.vectors(A), block_diag(*precision), blocks)
    return with_things(made, part, B, still)


def _together(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays one behind the other; one alone as it is, for such arrays are large."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _told(
    inquiry: _Inquiry,
    found: Components,
    structured: np.ndarray,
    ties: dict[int, list[Tie]],
    asked: Problem,
    theta: np.ndarray,
) -> NoiseCauses:
    """The causes in words and figures, and the factors that they give to all rows."""
    causes, channel = inquiry.causes, inquiry.held
    noise = (found.variance > 0.0) & ~structured & ~inquiry.rests(structured)
    relative = _weights(inquiry, found.variance, noise, asked, theta) if (noise & ~channel).any() else None
    if relative is None:
        noise &= channel
    each = _of_each_joint(causes)
    variance = each @ np.where(noise, found.variance, 0.0)
    std = std_of_sigma(variance, each @ np.where(np.outer(noise, noise), found.covariance, 0.0) @ each.T)
    chosen = np.flatnonzero(variance > 0.0).tolist()
    made = np.array([_spreads(variance[k] * causes[k].blocks, inquiry.rows) for k in chosen])
    total = np.maximum(made.sum(axis=0), FLOOR**2)

    def cause(asked: Asked, variance: float, std: float, rivals: tuple[NoiseCause, ...] = ()) -> NoiseCause:
        value, share = float(np.sqrt(variance)), _spreads(variance * asked.blocks, inquiry.rows) / total
        return NoiseCause(asked.kind, asked.name, asked.unit, value, float(std), share, asked.shape, rivals)

    def rivals(k: int) -> tuple[NoiseCause, ...]:
        accused = np.flatnonzero(each[k] * noise > 0.0).tolist()
        tied = [tie for own in accused for tie in ties.get(own, [])]
        return tuple(cause(rival, more.variance[at], more.sigma_std[at]) for rival, more, at in tied)

    return NoiseCauses(
        causes=tuple(cause(causes[k], variance[k], std[k], rivals(k)) for k in chosen),
        total=np.sqrt(made.sum(axis=0)),
        structured=tuple((p.kind, p.name) for p, back in zip(causes, structured, strict=True) if back),
        relative=relative,
        shared=len(inquiry.rows) / inquiry.still.count if any(causes[k].kind == "joint" for k in chosen) else 1.0,
    )


def _of_each_joint(possible: Sequence[Asked]) -> np.ndarray:
    """Which components each cause is told with, shape (C, C): what all joints have alike each of them has, beside its own."""
    kinds, units = np.array([p.kind for p in possible]), np.array([p.unit for p in possible])
    each = np.eye(len(possible))
    each[kinds == "joints"] = 0.0
    each += np.outer((kinds == "joint") & (units == "rad"), kinds == "joints")
    return each


def _spreads(covariance: np.ndarray, rows: Dataset) -> np.ndarray:
    """Mean variance of each channel per axis, unscaled, shape (C,), from scaled covariances of rows, (n, m, m)."""
    if rows.relative is not None:
        covariance = stretched(rows.relative, stretched(rows.relative, covariance).transpose(0, 2, 1))
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    parts = zip(columns(rows.channels), rows.measures.T, strict=True)
    return np.array([variance[own][:, part].mean() if own.any() else 0.0 for part, own in parts])


def _weights(
    inquiry: _Inquiry, variance: np.ndarray, noise: np.ndarray, asked: Problem, theta: np.ndarray
) -> np.ndarray | None:
    """Factors of all rows, shape (N, m, m); None if the causes beyond the channels change too little."""
    rows = asked.data
    causes, seen = possible(asked, theta)
    causes += [shaped(cause.shape, seen) for cause in inquiry.causes if cause.shape is not None]
    V = np.sum([variance[k] * p.blocks for k, p in enumerate(causes) if noise[k]], axis=0)
    sigma = np.sqrt(variance[inquiry.held])
    measured, diagonal = there(rows), np.diagonal(V, axis1=1, axis2=2)
    own = np.broadcast_to(spread(sigma**2, rows.channels), diagonal.shape)
    if float(1.0 - (own[measured] / diagonal[measured]).min()) < MATTERS:
        return None
    typical = rows.declared(sigma)  # a declared noise stays that of all fits, whatever the channel's own part is
    V += np.where(measured, 0.0, spread(typical**2, rows.channels))[:, :, None] * np.eye(V.shape[1])  # stays as it is
    inner = factors(V, typical, rows.channels)
    return inner if rows.relative is None else stretched(rows.relative, inner)
