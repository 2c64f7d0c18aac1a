"""Sums over the rows of a problem: its normal equations, and residuals and columns once things are solved for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from aridcal.engine.fit.elimination import Elimination, Projector, Sums, projector, reduced, solved, tied_columns
from aridcal.engine.fit.flags import cauchy, robust_sigma
from aridcal.engine.fit.normal_equations import NormalEquations
from aridcal.engine.fit.problem import Problem, scaled
from aridcal.engine.instruments.channels import Channels, columns, spread

THING_STEPS = 4
"""Work: Steps that find things anew where the coefficients stay; their rows are nearly linear in them."""

MANY_COEFFICIENTS = 300
"""Work: Coefficients from which those are sought that move none of a block's rows: an ordinary arm has no such ones, and fewer
cost less than the search for them."""

NUMBERS_PER_QR = 1024
"""Work: Numbers of a QR at a time: of 50 columns these take 0.4 MB."""


def scaled_columns(question: Problem, theta: np.ndarray, count: int) -> np.ndarray:
    """Columns of the last coefficients in the scaled residuals, things held, shape (N, m, count)."""
    size = sum(channel.size for channel in question.channels)
    J = np.empty((len(question), size, count))
    for block in question.blocks():
        if question.measured.direct:
            relative = None if question.data.relative is None else question.data.relative[block]
            rows = question.rows[block]
            _, _, twists = question.model.motions(theta, rows)
            every = question.model.of_coefficients(scaled(twists[:, :size], relative), rows, len(theta) - count)
        else:
            every = question.pieces(theta, block).J
        J[block] = every[:, :, every.shape[2] - count :]
    return J


@dataclass(frozen=True)
class Linearisation:
    """A problem at one place: residuals, weights and normal equations.

    Attributes:
        residual: Scaled, shape (N, m); NaN where a row does not measure a channel.
        weight: Of each row, shape (N,).
        equations: Their sums, weights included; the unknowns of groups are solved for.
        agreed: Joint positions one step nearer to those at which measurements and model agree, shape (N, joints).
        groups: The groups of unknown things, solved; None where there are none.
    """

    residual: np.ndarray
    weight: np.ndarray
    equations: NormalEquations
    agreed: np.ndarray
    groups: Elimination | None = None

    def squares(self, weight: np.ndarray, sigma: np.ndarray, channels: Channels) -> float:
        """Sum of squares in sigmas, rows counted by weight, with the squares of the declared facts on the things."""
        rows = float(np.sum(weighted_squares(self.residual, weight, channels) / sigma**2))
        return rows if self.groups is None else rows + self.groups.squares

    def step_of_groups(self, step: np.ndarray) -> np.ndarray:
        """How the groups' unknowns follow a step of the coefficients (K,), shape (G, U)."""
        return np.zeros((0, 0)) if self.groups is None else self.groups.y - self.groups.X @ step


def linearise(question: Problem, theta: np.ndarray, weight: np.ndarray | None, sigma: np.ndarray) -> Linearisation:
    """Accumulate the normal equations, block by block.

    Args:
        question: K coefficients, N rows.
        theta: Values of the coefficients, shape (K,).
        weight: Of each row, shape (N,); None: Cauchy's, at scale ``sigma``.
        sigma: Noise of each channel, shape (C,): the scale of ``weight``, and the weights of channels in groups of several.
    """
    question = question.agreeing(theta)
    channels, count = question.channels, len(theta)
    AA, Ar = np.zeros((len(channels), count, count)), np.zeros((len(channels), count))
    sums = _sums(question, count)
    parts, weights, nearer = [], [], []
    local = question.local
    for block in question.blocks():
        if local is not None:
            r, twists = question.of_joints(theta, block)
            w = cauchy(r, sigma, channels) if weight is None else weight[block]
            root, phi = np.sqrt(w * question.data.repeats.share)[:, None], question.rows.phi[block]
            twists *= root[:, :, None]
            AA += local.information(twists, phi, columns(channels))
            Ar += local.pull(twists, phi, r * root, columns(channels))
            parts.append(r)
            weights.append(w)
            continue
        pieces = question.pieces(theta, block)
        r, J, B = pieces.r, pieces.J, pieces.B
        nearer.append(pieces.agreed)
        numbers = np.where(question.measured[block].absent, np.nan, r)
        w = cauchy(numbers, sigma, channels) if weight is None else weight[block]
        root = np.sqrt(w * question.data.repeats.share)[:, None]
        if sums is not None:
            root_of_rows, group = root[:, :, None], question.group_of(block)
            sums.add(group, B * root_of_rows, J * root_of_rows, r * root, channels)
        for rows, some, X in _by_limb(question, block, J, MANY_COEFFICIENTS):
            for k, part in enumerate(columns(channels)):
                # Number by number: rows run fastest in J, or slowest.
                A = (X[:, part] * root[rows, :, None]).transpose(1, 2, 0)
                AA[k][np.ix_(some, some)] += (A @ A.transpose(0, 2, 1)).sum(axis=0)
                Ar[k][some] += (A @ (r[rows, part] * root[rows]).T[:, :, None])[:, :, 0].sum(axis=0)
        parts.append(numbers)
        weights.append(w)
    residual, weight = np.concatenate(parts), np.concatenate(weights)
    parts.clear()
    counted = weight * question.data.repeats.share
    rr = weighted_squares(residual, counted, channels)
    equations = NormalEquations(AA, Ar, rr, _numbers(residual, counted, channels))
    beforehand, at = question.beforehand(), np.concatenate(nearer) if nearer else question.rows.positions
    if sums is None or question.groups is None or beforehand is None:
        return Linearisation(residual, weight, equations, at)
    elimination = solved(sums, question.groups, beforehand, sigma)
    equations = reduced(equations, sums, elimination, beforehand, sigma)
    return Linearisation(residual, weight, equations, at, elimination)


def _sums(question: Problem, count: int) -> Sums | None:
    """Empty sums of the groups; None where there are no groups."""
    if question.groups is None:
        return None
    channels, (many, width) = len(question.channels), question.groups.unknown.shape
    return Sums(
        np.zeros((channels, many, width, width)),
        np.zeros((channels, many, width, count)),
        np.zeros((channels, many, width)),
    )


def _numbers(residual: np.ndarray, weight: np.ndarray, channels: Channels) -> np.ndarray:
    """Numbers measured in each channel, shape (C,), rows counted by weight."""
    return np.array([float(weight @ (~np.isnan(residual[:, part])).sum(axis=1)) for part in columns(channels)])


def weighted_squares(residual: np.ndarray, weight: np.ndarray, channels: Channels) -> np.ndarray:
    """Sum of squares of each channel, shape (C,), rows counted by weight."""
    squares = residual**2
    squares[np.isnan(squares)] = 0.0
    each = weight @ squares
    return np.array([float(each[part].sum()) for part in columns(channels)])


def reduced_stretches(
    question: Problem, theta: np.ndarray, weight: np.ndarray, sigma: np.ndarray
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """Stretches of rows with their scaled residuals (n, m) and columns (n, m, K), less the part that the things take up.

    Args:
        question: K coefficients.
        theta: Their values.
        weight: Of each row, shape (N,): the things are solved for with these.
        sigma: Noise of each channel, shape (C,).
    """
    question, things = _with_things(question, theta, weight, sigma)
    yield from _without_things(question, theta, things)


def _with_things(
    question: Problem, theta: np.ndarray, weight: np.ndarray, sigma: np.ndarray
) -> tuple[Problem, Elimination | None]:
    """The question where measurements and model agree, and its groups solved; arguments as for :func:`reduced_stretches`."""
    question = question.agreeing(theta)
    return question, None if question.groups is None else linearise(question, theta, weight, sigma).groups


def _without_things(
    question: Problem, theta: np.ndarray, things: Elimination | None
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """Stretches as of :func:`reduced_stretches`, for groups that are solved."""
    for block in question.blocks():
        part = question.pieces(theta, block)
        if things is None:
            yield block, part.r, part.J
        else:
            yield block, *things.rows(question.group_of(block), part.B, part.J, part.r)


def thing_projector(question: Problem, theta: np.ndarray, weight: np.ndarray, sigma: np.ndarray) -> Projector | None:
    """The projector that takes the unknowns of things off columns of all rows; None without unknown things."""
    question, things = _with_things(question, theta, weight, sigma)
    if things is None:
        return None
    B = np.concatenate([question.pieces(theta, block).B for block in question.blocks()])
    return projector(B, question.group_of(slice(None)), things, weight, spread(sigma, question.channels))


def triangle(
    question: Problem, theta: np.ndarray, weight: np.ndarray, sigma: np.ndarray, of: np.ndarray | slice = slice(None)
) -> np.ndarray:
    """Upper triangle R of the whitened Jacobian's QR, shape (<= k, k): all that rank and covariance need.

    Args:
        question: K coefficients.
        theta: Their values, shape (K,).
        weight: Of each row, shape (N,).
        sigma: Noise of each channel, shape (C,).
        of: Numbers of the k coefficients whose columns count, all others held.
    """
    question, things = _with_things(question, theta, weight, sigma)
    per_number, beforehand = spread(1.0 / sigma, question.channels), question.beforehand()
    count = len(theta[of])
    R = np.empty((0, count))
    if things is not None and beforehand is not None:
        R = tied_columns(things.X, beforehand)[:, of]
    for block, _, J in _without_things(question, theta, things):
        whitened = J[:, :, of] * (np.sqrt(weight[block])[:, None] * per_number)[:, :, None]
        parts = [R]
        for _, some, X in _by_limb(question, block, whitened):
            flat = X.reshape(X.shape[0] * X.shape[1], len(some))
            for start in range(0, len(flat), NUMBERS_PER_QR):
                triangle_of_part = np.linalg.qr(flat[start : start + NUMBERS_PER_QR], mode="r")
                parts.append(np.zeros((len(triangle_of_part), count)))
                parts[-1][:, some] = triangle_of_part
        R = np.asarray(np.linalg.qr(np.vstack(parts), mode="r"))
    return R


def _by_limb(
    question: Problem, block: slice, J: np.ndarray, many: float = np.inf
) -> Iterator[tuple[slice | np.ndarray, np.ndarray, np.ndarray]]:
    """Rows of a stretch path by path, the numbers of the columns of J that may move them, and these columns, (n, m, k).

    Other limbs move none of these rows. Where all take one path, columns of zeros are left out if J has more than ``many``.
    """
    limbs = question.limbs(block)
    for rows in limbs:
        columns_of_limb, some = J[rows], np.arange(J.shape[2])
        if len(limbs) > 1 or len(some) > many:
            some = np.flatnonzero(columns_of_limb.any(axis=(0, 1)))
        yield rows, some, columns_of_limb[:, :, some] if len(some) < J.shape[2] else columns_of_limb


def problem_with_things(question: Problem, theta: np.ndarray, weight: np.ndarray | None = None) -> Problem:
    """The problem with its things solved for anew at the coefficients theta.

    Args:
        question: N rows.
        theta: Shape (K,).
        weight: Of each row, shape (N,); None: robustly, from all.
    """
    groups = question.groups
    if groups is None:
        return question
    R, p = question.model.poses(theta, question.rows)
    question = question.settled(theta)
    channels, everything = question.channels, slice(None)
    for _ in range(THING_STEPS):
        slopes = question.measured.slopes(R, p, theta)
        r = scaled(slopes.residual, question.data.relative)
        B = scaled(groups.columns(slopes.by_thing, everything), question.data.relative)
        scale = robust_sigma(r, channels)
        root = np.sqrt(cauchy(r, scale, channels) if weight is None else weight)[:, None]
        sums, beforehand = _sums(question, 0), question.beforehand()
        assert sums is not None and beforehand is not None
        empty = np.zeros((*r.shape, 0))
        sums.add(groups.row, B * root[:, :, None], empty, np.nan_to_num(r) * root, channels)
        question = question.stepped(solved(sums, groups, beforehand, scale).y)
    return question
