"""Causes of the residual's scatter: each instrument's channel, joints' readings, range, the arm's own repeatability.

A joint whose reading scatters moves the predicted target by its column: such noise grows with the lever, ties a row's
numbers together, and looks like no instrument. All rows that were measured while the arm stood still share it. Each cause is
one variance of their covariance (:mod:`aridcal.engine.fit.variance_components`), chosen one after the other by a likelihood-ratio
test. Rows are then weighed by these causes, each row with its own covariance, for weights know nothing of other rows.
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
from aridcal.engine.fit.scatter import Scatter, covariances, determined_modes, scatter_near
from aridcal.engine.fit.shared_readings import Stack, representative, stack, standstills, with_things
from aridcal.engine.fit.variance_components import (
    Components,
    add_component,
    drop_components,
    estimate,
    gain_is_real,
    highest,
    promised,
    replace_components,
    roughly_without,
    score_tests,
    settled,
    std_of_sigma,
    with_one,
)
from aridcal.engine.instruments.channels import Channel, columns, spread
from aridcal.engine.levels import FEWEST_NOISE_ROWS, STRONG, SURELY
from aridcal.engine.numerics import FLOOR, TINY
from aridcal.engine.rows.dataset import Dataset, factors
from aridcal.engine.search.diagnose import MOST_SEARCHED_ROWS
from aridcal.engine.search.exact import GAUGE
from aridcal.engine.search.linear_model import ActiveEffect
from aridcal.engine.search.noise_hypotheses import (
    HypothesisKind,
    NoiseHypothesis,
    measured_mask,
    possible,
    shaped,
    stretched,
)
from aridcal.engine.search.noise_shapes import SHAPES, NoiseShape, TargetPoses, aimed, nearby, shapes_of
from aridcal.engine.search.noise_tests import neighbours
from aridcal.system.progress import SILENT, Progress

LEAST_CAUSE_SHARE = 0.05
"""Share of a channel's variance, at the row where it is largest, from which causes beyond the channels change the weights:
less changes them by less than people know their instrument."""

REPEATABLE_SHARE = 0.5
"""Share of a joint's scatter that comes back at neighbouring rows from which it is no noise but an error curve, or play: half."""

UNSURE_FACTOR = 1.25
"""Work: Times by which something may be more or less than it takes to say so, and is looked at again at variances that have
settled."""

MOST_ROWS_OF_CAUSES = 800
"""Work: Rows that are asked at the most, of more: a sigma of three numbers a row is then known to 1.5 %, and every trial costs
as many as there are."""

CHALLENGERS = 4
"""Work: Rivals of a named cause that are tried at the most, those that the residual asks for most without it."""

NEAR_SCORE_SHARE = 0.7
"""Work: Share of the largest score from which a rival is looked at: gains go by its square, and are half as large at least."""

RIVAL_MARGIN = 5.0
"""Work: [nat] by which a rival may be worse, by a bound on the likelihood, to be tried: the bound holds the columns as they
are."""

SHAPE_STEPS = (0.1, 0.03)
"""Work: Shares of its size by which the numbers of a shape are moved to see whether it explains more so: the first is a
fraction of what shapes that are tried are apart, the last what a thousand rows tell of a direction."""

LEAST_MOVE_GAIN = 0.1
"""Work: [nat] that such a move must gain at the least."""

WEAK = 30.0
"""Work: [nat] that a cause seems to gain, its columns held, above which it is not left out on trial: chance gives no 15, and
the same again is left for columns that would fit anew. Judgement."""

IN_WORLD = ("range", "direction", "depth", "bearing")
"""Forms that noise may have in the world's axes."""

RIVAL_ROUNDS = 2
"""Work: Times that named causes meet their rivals at the most: once is usual."""


@dataclass(frozen=True)
class NoiseCause:
    """One cause of scatter.

    Attributes:
        kind: An instrument's ``channel``; the reading of a ``joint`` (or of all ``joints`` alike, listed as that of each);
            ``range``: position noise per metre from the origin of
            the world frame; ``sight``: rotation noise about the line from there to the target; ``length``: noise of a
            distance per metre read; ``repeatability``: a part of the same size in every row, where rows state their noise.
        name: Of the channel or of the joint's reading; else the channel that it acts on.
        unit: Of value and std.
        value: 1-sigma (per axis).
        std: Of the value.
        share: Of the variance of each channel over the training rows, shape (C,).
        shape: Direction, point or lever of the noise; None for kinds without one.
        rivals: Causes that explain the scatter as well in its place: the rows do not tell them apart.
    """

    kind: HypothesisKind
    name: str
    unit: str
    value: float
    std: float
    share: np.ndarray
    shape: NoiseShape | None = None
    rivals: tuple[NoiseCause, ...] = ()


@dataclass(frozen=True)
class NoiseCauses:
    """The causes of the training rows' scatter.

    Attributes:
        causes: The channels first, then the causes beyond them.
        total: Noise of all causes together in each channel, RMS per axis over the training rows, shape (C,).
        structured: Joints, and channels as range or line of sight concern them, that seem to scatter but whose errors come
            back at neighbouring rows: no noise.
        relative: Factors of all N rows' noise (see :class:`Dataset`), shape (N, m, m); None where the rows' own will do, as
            nothing beyond the channels matters.
        shared: Rows that share the error of a reading, on the average; 1 where no reading scatters.
    """

    causes: tuple[NoiseCause, ...]
    total: np.ndarray
    structured: tuple[tuple[HypothesisKind, str], ...]
    relative: np.ndarray | None
    shared: float

    @property
    def channels(self) -> tuple[NoiseCause, ...]:
        """The causes that are the instrument's channels."""
        return tuple(c for c in self.causes if c.kind == "channel")

    @property
    def further(self) -> tuple[NoiseCause, ...]:
        """Causes beyond the instrument's channels, sorted by their share of the first channel's variance, then of the next."""
        return tuple(sorted((c for c in self.causes if c.kind != "channel"), key=lambda c: tuple(-c.share)))

    @property
    def beyond(self) -> np.ndarray:
        """Noise of the causes beyond the channels, RMS per axis over the training rows, shape (C,)."""
        return self.total * np.sqrt(sum((c.share for c in self.further), np.zeros(len(self.total))))


# A cause that explains the scatter as well as another, the maximum with it instead, and its number there.
Tie = tuple[NoiseHypothesis, Components, int]


@dataclass(frozen=True)
class _Inquiry:
    """Rows and the causes that may scatter them.

    Attributes:
        causes: All possible causes, those with a shape last.
        scatter: Residuals, and the covariances of these causes.
        targets: Poses of the targets.
        channels: Channels whose noise may have a shape.
        rows: The rows.
        still: How they are stacked.
        orders: Pairs of neighbouring rows, and of neighbouring standstills.
    """

    causes: tuple[NoiseHypothesis, ...]
    scatter: Scatter
    targets: TargetPoses
    channels: tuple[Channel, ...]
    rows: Dataset
    still: Stack
    orders: dict[bool, list[np.ndarray]]

    def of(self, *kinds: str) -> np.ndarray:
        """Which causes are of some kinds, shape (C,) bool."""
        return np.array([cause.kind in kinds for cause in self.causes])

    @cached_property
    def is_channel(self) -> np.ndarray:
        """Which causes are the channels, shape (C,) bool."""
        return self.of("channel")

    @cached_property
    def price(self) -> np.ndarray:
        """Price of the numbers of each cause's shape, shape (C,), [nat]."""
        return np.array([0.0 if c.shape is None else c.shape.price(len(self.rows)) for c in self.causes])

    def beside(self, some: np.ndarray, kinds: Sequence[str]) -> np.ndarray:
        """Causes of some kinds on a channel on which one of ``some`` is of these kinds, too, shape (C,) bool."""
        along, names = self.of(*kinds), np.array([cause.name for cause in self.causes])
        return along & np.isin(names, names[some & along])

    def second(self, maximum: Components) -> np.ndarray:
        """Causes in the world's axes beside one in the model on their channel, (C,) bool: they would explain its misfit alone."""
        return self.beside(maximum.free, IN_WORLD)

    def rests(self, structured: np.ndarray) -> np.ndarray:
        """Causes with a direction on a channel where one of these repeats at neighbouring rows, shape (C,) bool.

        A frame that turns slowly is off along no single direction: another cause would be named for the rest of it.
        """
        return self.beside(structured, ("range", "sight", *SHAPES))

    def aimed(self, maximum: Components) -> _Inquiry:
        """The inquiry with the shapes that are not in the model fitted to its residual."""
        inquiry = self
        for k, some in self.shapes(maximum).items():
            inquiry = inquiry.with_shape(k, some[0])
        return inquiry

    def shapes(self, maximum: Components) -> dict[int, list[NoiseShape]]:
        """Shapes fitted to the residual at a maximum, by the cause, for causes with a shape that are not in the model."""
        at = [k for k, cause in enumerate(self.causes) if cause.shape is not None]
        if maximum.free[at].all():
            return {}
        scatter, still = self.scatter, self.still
        pull, kernel = maximum.pull[: still.count], maximum.kernel[: still.count]
        residual = np.einsum("nij,nj->ni", covariances(scatter, maximum.at)[: still.count], pull)
        pull, kernel, residual = still.of_rows(pull), still.blocks_of_rows(kernel), still.of_rows(residual)
        every = aimed(self.targets, self.channels, residual, pull, kernel)
        return {k: some for k, some in zip(at, every, strict=True) if not maximum.free[k]}

    def with_shape(self, k: int, shape: NoiseShape) -> _Inquiry:
        """The inquiry with another shape of cause k."""
        cause = shaped(shape, self.targets)
        blocks = self.scatter.blocks.copy()
        blocks[k, : self.still.count] = cause.stacked(self.still)
        causes = (*self.causes[:k], cause, *self.causes[k + 1 :])
        return replace(self, causes=causes, scatter=replace(self.scatter, blocks=blocks))

    def refined(self, maximum: Components, k: int) -> tuple[_Inquiry, Components]:
        """The inquiry with the likeliest shape of a cause that was just named, and the maximum with it.

        A shape that is a little off leaves a rest for which another cause would be named.
        """
        shape, this = self.causes[k].shape, np.arange(len(self.causes)) == k
        if shape is None:
            return self, maximum

        def likeliest(shapes: Iterable[NoiseShape]) -> tuple[float, NoiseShape]:
            return max(((self._height_with(maximum, k, other), other) for other in shapes), key=itemgetter(0))

        height, shape = likeliest([shape, *self.shapes(roughly_without(self.scatter, maximum, this)).get(k, [])])
        for step in SHAPE_STEPS if shape.free else ():  # else no number of the shape was fitted to the residual
            while (better := likeliest(nearby(shape, step, self.targets)))[0] > height + LEAST_MOVE_GAIN:
                height, shape = better
        reshaped = self.with_shape(k, shape)
        return reshaped, with_one(reshaped.scatter, maximum, k, float(maximum.variance[k]))

    def _height_with(self, maximum: Components, k: int, shape: NoiseShape) -> float:
        """The bound about a maximum where cause k has another shape, less the price of that shape."""
        free = np.flatnonzero(maximum.free)
        blocks = self.scatter.blocks[free]
        blocks[int(np.searchsorted(free, k)), : self.still.count] = shaped(shape, self.targets).stacked(self.still)
        rows = replace(self.scatter, blocks=blocks)
        return highest(rows, self.scatter, maximum, free) - shape.price(len(self.rows))

    def comes_back(self, maximum: Components, k: int) -> tuple[bool, Components]:
        """True if errors of cause k repeat at neighbouring rows, so that it is no noise; and the maximum, settled if need be."""
        share = self._share_repeated(maximum, k)
        if 1.0 / UNSURE_FACTOR < share < UNSURE_FACTOR:
            maximum = settled(self.scatter, maximum)
            share = self._share_repeated(maximum, k)
        return share > 1.0, maximum

    def _share_repeated(self, maximum: Components, k: int) -> float:
        """How much errors of cause k repeat at neighbouring rows, or standstills if these share them; above 1: it is no noise.

        The score of a row's error, with its sign, is u = J' P y, which holds J' P J times the error. Products of two rows'
        scores have the mean 0 if errors are independent, and theta times the product of both J' P J if they repeat. The part
        and the pairs that repeat most count.
        """
        cause, still = self.causes[k], self.still
        pull, kernel = maximum.pull[: still.count], maximum.kernel[: still.count]
        if not cause.common:
            pull, kernel = still.of_rows(pull), still.blocks_of_rows(kernel)
        most = 0.0
        for part in cause.parts:
            root = still.vectors(part.root) if cause.common else part.root
            score = np.einsum("nmd,nm->nd", root, pull)
            information = root.transpose(0, 2, 1) @ kernel @ root
            for a, b in (pairs.T for pairs in self.orders[cause.common]):
                product = np.einsum("nd,nd->n", score[a], score[b])
                whole = REPEATABLE_SHARE * float(maximum.variance[k] * np.sum(information[a] * information[b]))
                chance = SURELY * float(np.sqrt(product @ product))
                most = max(most, float(product.sum()) / max(whole, chance, TINY))
        return most


def noise_causes(
    fit: Fit, active: Sequence[ActiveEffect], rows: Dataset, progress: Progress = SILENT, shapes: bool = True
) -> NoiseCauses | None:
    """The causes of the scatter; None if there are too few rows to tell.

    Args:
        fit: The final model, fitted to the training rows.
        active: Its effects.
        rows: All rows, scaled by what the campaign says of their noise. Held-out rows are only weighed.
        progress: Called with the number of causes in the model.
        shapes: Whether noise along directions, lines of sight, axes of the target and levers is possible, too.
    """
    question = problem(fit.model, rows)
    train = np.flatnonzero(rows.train)[~fit.outliers]
    some = representative(question, train, MOST_ROWS_OF_CAUSES if shapes else MOST_SEARCHED_ROWS)
    if len(some) < FEWEST_NOISE_ROWS:
        return None
    part = question.select(some)
    inquiry = _inquiry(part, fit, active, shapes)
    is_channel = inquiry.is_channel
    maximum = estimate(inquiry.scatter, np.maximum(fit.estimated, FLOOR) ** 2, is_channel)
    structured = np.zeros(len(is_channel), dtype=bool)
    for _ in range(RIVAL_ROUNDS):
        inquiry, maximum, structured = _add_causes(inquiry, maximum, structured, progress)
        inquiry, maximum, ties = _try_rivals(inquiry, maximum, structured | inquiry.rests(structured))
        if ties is not None:
            break
        structured &= maximum.free
    maximum = settled(inquiry.scatter, maximum)
    return _result(inquiry, maximum, structured, ties or {}, question, fit.theta)


def _inquiry(part: Problem, fit: Fit, active: Sequence[ActiveEffect], shapes: bool) -> _Inquiry:
    """The inquiry on some rows, no cause beyond the channels in the model."""
    causes, targets = possible(part, fit.theta)
    channels = tuple(channel for channel in part.channels if shapes and channel.name in targets.axes)
    nothing = np.zeros((*causes[0].root.shape[:2], 1))
    for channel in channels:
        # Shapes are fitted as soon as there is a maximum.
        causes += [
            NoiseHypothesis(shape.kind, channel.name, shape.unit, nothing, shape)
            for shape in shapes_of(targets, channel)
        ]
    still = stack(standstills(part.data), measured_mask(part.data))
    start = np.zeros(len(causes))
    start[: len(part.channels)] = np.maximum(fit.estimated, FLOOR) ** 2
    scatter = scatter_near(_scatter(part, fit, active, causes, still), start)
    first = np.unique(still.number, return_index=True)[1]
    near = neighbours(part.data)
    orders = {False: near, True: near if len(first) == len(part.data) else neighbours(part.data.select(first))}
    return _Inquiry(tuple(causes), scatter, targets, channels, part.data, still, orders)


def _add_causes(
    inquiry: _Inquiry, maximum: Components, structured: np.ndarray, progress: Progress
) -> tuple[_Inquiry, Components, np.ndarray]:
    """Causes added one after the other, as long as chance does not explain the next."""
    single, alike, is_channel = inquiry.of("joint"), inquiry.of("joints"), inquiry.is_channel
    inquiry = inquiry.aimed(maximum)
    while True:
        # A cause that would only explain another's misfit is not for any price.
        price = np.where(inquiry.second(maximum), np.inf, inquiry.price)
        more = add_component(inquiry.scatter, maximum, is_channel, price)
        if more is None:
            return inquiry, maximum, structured
        k, maximum = more
        progress.part(int(maximum.free.sum()), len(is_channel), "causes")
        if (maximum.free & single).sum() > 1 and (alike & ~maximum.free).any():
            # One variance in place of several, if it explains as much.
            fewer = replace_components(inquiry.scatter, maximum, single, int(np.argmax(alike)))
            k, maximum = (k, maximum) if fewer is None else (int(np.argmax(alike)), fewer)
        inquiry, maximum = inquiry.refined(maximum, k)
        # An error that repeats stays in the model, so that no other cause has to explain it, but it is no noise.
        structured[k], maximum = inquiry.comes_back(maximum, k)
        structured &= maximum.free
        inquiry = inquiry.aimed(maximum)


def _try_rivals(
    inquiry: _Inquiry, maximum: Components, structured: np.ndarray
) -> tuple[_Inquiry, Components, dict[int, list[Tie]] | None]:
    """Compare each named cause with its rivals, and all named joints together with theirs.

    Returns:
        The inquiry, the maximum, and by cause the rivals that are as good. Where a cause is not needed, or a rival explains
        more: the maximum without that cause, or with that rival, and None.
    """
    is_channel, price, scatter = inquiry.is_channel, inquiry.price, inquiry.scatter
    candidates = maximum.free & ~is_channel & ~structured & (maximum.variance > 0.0)
    sets = [np.arange(len(is_channel)) == k for k in np.flatnonzero(candidates)]
    joints = candidates & inquiry.of("joint", "joints")
    if joints.sum() > 1:
        sets.insert(0, joints)
    ties: dict[int, list[Tie]] = {int(k): [] for k in np.flatnonzero(candidates)}
    for members in sets:
        cost = float(price[members].sum())
        without_set = roughly_without(scatter, maximum, members)
        if maximum.log_likelihood - without_set.log_likelihood - cost < WEAK:
            without_set = drop_components(scatter, maximum, members)
            if not gain_is_real(maximum, without_set, cost, is_channel):
                return inquiry, without_set, None
        worth = maximum.log_likelihood - cost
        inquiry_without = inquiry.aimed(without_set)
        trials = [
            (k, with_one(inquiry_without.scatter, without_set, k, variance))
            for k, variance in _likely_rivals(inquiry_without, without_set, members, worth)
        ]
        gains = [more.log_likelihood - inquiry_without.price[k] - worth for k, more in trials]
        if gains and max(gains) > 0.0:
            k, more = trials[int(np.argmax(gains))]
            return inquiry_without, more, None
        for (k, more), gain in zip(trials, gains, strict=True):
            # A shape may well coincide with a joint's motion: for being reported as a rival it pays no price.
            if gain + inquiry_without.price[k] > -STRONG:
                for k_named in np.flatnonzero(members):
                    ties[int(k_named)].append((inquiry_without.causes[k], more, k))
    return inquiry, maximum, ties


def _likely_rivals(inquiry: _Inquiry, base: Components, members: np.ndarray, worth: float) -> list[tuple[int, float]]:
    """Rivals of a set of named causes, shape (C,) bool, that may be as good, and the variances at which they begin.

    Shapes of the inquiry are fitted at the maximum without the set; ``worth`` is the log-likelihood with it, less its price.
    """
    demand = score_tests(inquiry.scatter, base)
    least = max(worth - base.log_likelihood - RIVAL_MARGIN, 0.0)
    enough = ~members & ~inquiry.second(base) & (demand.normal > max(NEAR_SCORE_SHARE * demand.normal.max(), 0.0))
    most = [int(k) for k in np.argsort(-demand.normal) if enough[k]][:CHALLENGERS]
    if not most:
        return []
    gains = promised(inquiry.scatter, base, [np.arange(len(members)) == k for k in most], demand.variance)
    return [(k, float(demand.variance[k])) for k, gain in zip(most, gains, strict=True) if gain > least]


def _scatter(
    part: Problem, fit: Fit, active: Sequence[ActiveEffect], causes: Sequence[NoiseHypothesis], still: Stack
) -> Scatter:
    """The final model linearised at some rows, by standstills; smooth effects by the modes that the data determine."""
    here = part.agreeing(fit.theta)
    pieces = [here.pieces(fit.theta, block) for block in here.blocks()]
    y, J, B = map(_concatenated, ([p.r for p in pieces], [p.J for p in pieces], [p.B for p in pieces]))
    index = {name: k for k, name in enumerate(fit.model.names)}
    constant = [k for k, c in enumerate(fit.model.coefficients) if c.basis.constant]
    wide, (n, m), filled = J.reshape(-1, J.shape[2]), y.shape, len(constant)
    A = np.empty((n * m, filled + sum(a.modes.shape[1] for a in active)))
    A[:, :filled], precision = wide[:, constant], [np.diag((GAUGE * fit.model.sizes[constant]) ** -2.0)]
    for a in active:
        numbers = [index[c.name] for c in a.effect.coefficients]
        side_by_side = numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        part_of_J = wide[:, numbers[0] : numbers[0] + len(numbers)] if side_by_side else wide[:, numbers]
        column = np.matmul(part_of_J, a.modes, out=A[:, filled : filled + a.modes.shape[1]])
        precision_of_modes = a.precision
        # A prior pulls the modes towards zero.
        y = y + (column @ np.linalg.lstsq(a.modes, fit.theta[numbers], rcond=None)[0]).reshape(n, m)
        if a.effect.smooth:
            modes = determined_modes(column.reshape(n, m, -1), spread(fit.sigma, part.channels))
            if modes.shape[1] < len(modes):
                A[:, filled : filled + modes.shape[1]] = column @ modes
                precision_of_modes = modes.T @ precision_of_modes @ modes
        filled += len(precision_of_modes)
        precision.append(precision_of_modes)
    A = A[:, :filled].reshape(n, m, -1)
    blocks = np.array([cause.stacked(still) for cause in causes])
    scatter = Scatter(still.vectors(y), still.vectors(A), block_diag(*precision), blocks)
    return with_things(scatter, part, B, still)


def _concatenated(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays one behind the other; a single one is not copied, for such arrays are large."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _result(
    inquiry: _Inquiry,
    maximum: Components,
    structured: np.ndarray,
    ties: dict[int, list[Tie]],
    question: Problem,
    theta: np.ndarray,
) -> NoiseCauses:
    """The causes with their figures and rivals, and the factors that they give all rows."""
    causes, channel = inquiry.causes, inquiry.is_channel
    noise = (maximum.variance > 0.0) & ~structured & ~inquiry.rests(structured)
    relative = _weights(inquiry, maximum.variance, noise, question, theta) if (noise & ~channel).any() else None
    if relative is None:
        noise &= channel
    each = _of_each_joint(causes)
    variance = each @ np.where(noise, maximum.variance, 0.0)
    std = std_of_sigma(variance, each @ np.where(np.outer(noise, noise), maximum.covariance, 0.0) @ each.T)
    shown = np.flatnonzero(variance > 0.0).tolist()
    variances = np.array([_variances_of_channels(variance[k] * causes[k].blocks, inquiry.rows) for k in shown])
    total = np.maximum(variances.sum(axis=0), FLOOR**2)

    def cause(of: NoiseHypothesis, variance: float, std: float, rivals: tuple[NoiseCause, ...] = ()) -> NoiseCause:
        value, share = float(np.sqrt(variance)), _variances_of_channels(variance * of.blocks, inquiry.rows) / total
        return NoiseCause(of.kind, of.name, of.unit, value, float(std), share, of.shape, rivals)

    def rivals(k: int) -> tuple[NoiseCause, ...]:
        components = np.flatnonzero(each[k] * noise > 0.0).tolist()
        tied = [tie for component in components for tie in ties.get(component, [])]
        return tuple(cause(rival, more.variance[at], more.sigma_std[at]) for rival, more, at in tied)

    return NoiseCauses(
        causes=tuple(cause(causes[k], variance[k], std[k], rivals(k)) for k in shown),
        total=np.sqrt(variances.sum(axis=0)),
        structured=tuple((p.kind, p.name) for p, back in zip(causes, structured, strict=True) if back),
        relative=relative,
        shared=len(inquiry.rows) / inquiry.still.count if any(causes[k].kind == "joint" for k in shown) else 1.0,
    )


def _of_each_joint(possible: Sequence[NoiseHypothesis]) -> np.ndarray:
    """Components that each cause adds up, shape (C, C): a joint has its own, and that of all joints alike."""
    kinds, units = np.array([p.kind for p in possible]), np.array([p.unit for p in possible])
    each = np.eye(len(possible))
    each[kinds == "joints"] = 0.0
    each += np.outer((kinds == "joint") & (units == "rad"), kinds == "joints")
    return each


def _variances_of_channels(covariance: np.ndarray, rows: Dataset) -> np.ndarray:
    """Mean variance of each channel per axis, unscaled, shape (C,), from scaled covariances of rows, (n, m, m)."""
    if rows.relative is not None:
        covariance = stretched(rows.relative, stretched(rows.relative, covariance).transpose(0, 2, 1))
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    parts = zip(columns(rows.channels), rows.measures.T, strict=True)
    return np.array([variance[present][:, part].mean() if present.any() else 0.0 for part, present in parts])


def _weights(
    inquiry: _Inquiry, variance: np.ndarray, noise: np.ndarray, question: Problem, theta: np.ndarray
) -> np.ndarray | None:
    """Factors of all rows, shape (N, m, m); None if the causes beyond the channels change too little."""
    rows = question.data
    causes, targets = possible(question, theta)
    causes += [shaped(cause.shape, targets) for cause in inquiry.causes if cause.shape is not None]
    V = np.sum([variance[k] * p.blocks for k, p in enumerate(causes) if noise[k]], axis=0)
    sigma = np.sqrt(variance[inquiry.is_channel])
    measured, diagonal = measured_mask(rows), np.diagonal(V, axis1=1, axis2=2)
    of_channels = np.broadcast_to(spread(sigma**2, rows.channels), diagonal.shape)
    if float(1.0 - (of_channels[measured] / diagonal[measured]).min()) < LEAST_CAUSE_SHARE:
        return None
    typical = rows.declared(sigma)  # a declared noise stays that of all fits, whatever the channel's own part is
    V += np.where(measured, 0.0, spread(typical**2, rows.channels))[:, :, None] * np.eye(V.shape[1])  # stays as it is
    inner = factors(V, typical, rows.channels)
    return inner if rows.relative is None else stretched(rows.relative, inner)
