"""A model asked about the rows of a data set: measured minus predicted, its derivatives, and robust measures of size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.special import gammaincinv

from aridcal.fit.normal_equations import NormalEquations
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.channels import Channels, columns, norms, spread
from aridcal.instruments.pose import residuals
from aridcal.model.model import Model, Rows
from aridcal.showing import SILENT, Progress

BLOCK = 512
"""Rows differentiated at a time: they stay in the cache, and memory stays flat."""

MANY = 300
"""Coefficients from which those are sought that move none of a block's rows: an ordinary arm has no such ones, and fewer cost
less than the search for them."""

FLOOR = 1e-12
"""[m] or [rad]: below this everything is rounding."""

QUANTILES = (0.5, 0.9)
"""Of the rows' norms that tell a sigma. A tenth of the rows may be wild; more than that is a part of the robot's life that
the model lacks (one of two sides of a backlash, say) and must not be flagged away."""

CAUCHY = 4.0
"""Sigmas at which a row's weight has fallen to a half: one clean row of three numbers in a thousand is as far."""


@dataclass(frozen=True)
class Problem:
    """A model asked about the rows of a data set.

    Attributes:
        model: K coefficients.
        data: N rows, m numbers each.
        rows: The same rows as the model sees them.
        progress: Told how far each pass over the rows is.
    """

    model: Model
    data: Dataset
    rows: Rows
    progress: Progress = SILENT

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
        return replace(self, data=self.data.select(some), rows=self.rows[some])

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Measured minus predicted in world axes, shape (N, m), [m] and [rad]."""
        return residuals(*self.model.poses(theta, self.rows), self.data.position, self.data.rotation)

    def scaled_residual(self, theta: np.ndarray) -> np.ndarray:
        """The same, divided by the rows' relative sigmas."""
        return scaled(self.residual(theta), self.data.relative)

    def linearised(self, theta: np.ndarray, part: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residuals (n, m) of a stretch of rows, and what each coefficient takes off them, shape (n, m, K)."""
        data = self.data
        R, p, J = self.model.jacobian(theta, self.rows[part])
        r = residuals(R, p, data.position[part], None if data.rotation is None else data.rotation[part])
        J = J[:, : r.shape[1]]
        if data.relative is None:
            return r, J
        if data.rotation is not None:
            # log(exp(r) exp(-w)) = r - (w + r x w / 2 + ...): matters only where a row's axes weigh unequally.
            J[:, 3:] += 0.5 * np.cross(r[:, 3:, None], J[:, 3:], axis=1)
        return scaled(r, data.relative[part]), scaled(J, data.relative[part])


def problem(model: Model, data: Dataset, progress: Progress = SILENT) -> Problem:
    """Ask a model about a data set.

    Raises:
        CovariateNotFound: an effect depends on a column that was not measured.
        MeasurementError: a row's station is none of those that the model knows.
    """
    return Problem(model, data, model.rows(data.readings, data.conditions, data.station), progress)


def motions(question: Problem, theta: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Target poses, and the target's twists per unit of the last coefficients alone.

    Args:
        question: N rows.
        theta: Values of all coefficients.
        count: How many of them are asked for.

    Returns:
        Rotations (N, 3, 3), positions (N, 3) [m], and twists (N, 6, count).
    """
    n = len(question)
    R, p, J = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 6, count))
    for block in question.blocks():
        R[block], p[block], every = question.model.jacobian(theta, question.rows[block])
        J[block] = every[:, :, every.shape[2] - count :]
    return R, p, J


def scaled(values: np.ndarray, relative: np.ndarray | None) -> np.ndarray:
    """Residuals or columns, shape (N, m) or (N, m, K), divided by the rows' relative sigmas (see :class:`Dataset`)."""
    if relative is None:
        return values
    wide = values.reshape(*values.shape[:2], -1)
    divided = np.linalg.solve(relative, wide) if relative.ndim == 3 else wide / relative[:, :, None]
    return np.asarray(divided.reshape(values.shape))


def unscaled(r: np.ndarray, relative: np.ndarray | None) -> np.ndarray:
    """Scaled residuals, shape (N, m), back in [m] and [rad]."""
    if relative is None:
        return r
    return np.asarray(np.einsum("nij,nj->ni", relative, r) if relative.ndim == 3 else r * relative)


def robust_sigma(r: np.ndarray, channels: Channels) -> np.ndarray:
    """Sigma of each channel from the norms of scaled residuals, by two :data:`QUANTILES`: the larger counts.

    Args:
        r: Shape (N, m).
        channels: C of them.

    Returns:
        Shape (C,).
    """
    found = []
    for channel, length in zip(channels, norms(r, channels), strict=True):
        seen = np.quantile(length, QUANTILES)
        ratios = [float(q) / usual for q, usual in zip(seen, usual_norms(channel.size), strict=True)]
        found.append(max(*ratios, FLOOR))
    return np.array(found)


@cache
def usual_norms(size: int) -> tuple[float, ...]:
    """Quantiles of the norm of so many standard normal numbers, at :data:`QUANTILES` (chi distribution)."""
    return tuple(float(np.sqrt(2.0 * gammaincinv(0.5 * size, q))) for q in QUANTILES)


def distance(r: np.ndarray, sigma: np.ndarray, channels: Channels) -> np.ndarray:
    """How many sigmas per axis a row is off in its worst channel, shape (N,), from scaled residuals (N, m)."""
    return np.asarray((norms(r, channels) / sigma[:, None]).max(axis=0))


def cauchy(r: np.ndarray, sigma: np.ndarray, channels: Channels) -> np.ndarray:
    """Weights that let go of far rows gradually (Cauchy's loss on the row's distance), shape (N,)."""
    return 1.0 / (1.0 + (distance(r, sigma, channels) / CAUCHY) ** 2)


@dataclass(frozen=True)
class Linearisation:
    """A problem at one place: residuals, weights and normal equations.

    Attributes:
        residual: Scaled, shape (N, m).
        weight: Of each row, shape (N,).
        equations: Their sums, weights included.
    """

    residual: np.ndarray
    weight: np.ndarray
    equations: NormalEquations


def linearise(question: Problem, theta: np.ndarray, weight: np.ndarray | None, sigma: np.ndarray) -> Linearisation:
    """Accumulate the normal equations, block by block.

    Args:
        question: K coefficients, N rows.
        theta: Values of the coefficients, shape (K,).
        weight: Of each row, shape (N,); None: Cauchy's, at scale ``sigma``.
        sigma: See ``weight``, shape (C,).
    """
    channels, count = question.channels, len(theta)
    AA, Ar = np.zeros((len(channels), count, count)), np.zeros((len(channels), count))
    parts, used = [], []
    for block in question.blocks():
        r, J = question.linearised(theta, block)
        w = cauchy(r, sigma, channels) if weight is None else weight[block]
        root = np.sqrt(w * question.data.share)[:, None]
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
        parts.append(r)
        used.append(w)
    residual, weight = np.concatenate(parts), np.concatenate(used)
    counted = weight * question.data.share
    rr = weighted_squares(residual, counted, channels)
    numbers = np.array([channel.size * float(counted.sum()) for channel in channels])
    return Linearisation(residual, weight, NormalEquations(AA, Ar, rr, numbers))


def weighted_squares(residual: np.ndarray, weight: np.ndarray, channels: Channels) -> np.ndarray:
    """Sum of squares of each channel, shape (C,), rows counted by weight."""
    return np.array([float(weight @ np.sum(residual[:, part] ** 2, axis=1)) for part in columns(channels)])


def triangle(question: Problem, theta: np.ndarray, weight: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Upper triangle R of the whitened Jacobian's QR, shape (<= K, K): all that rank and covariance need."""
    per_number = spread(1.0 / sigma, question.channels)
    R = np.empty((0, len(theta)))
    for block in question.blocks():
        r, J = question.linearised(theta, block)
        whitened = J * (np.sqrt(weight[block])[:, None] * per_number)[:, :, None]
        R = np.asarray(np.linalg.qr(np.vstack([R, whitened.reshape(r.size, len(theta))]), mode="r"))
    return R
