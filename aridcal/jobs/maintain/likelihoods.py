r"""How well new rows agree with a calibration, and with each thing that may have moved since.

With r the residuals in sigmas, J their columns and :math:`\Sigma` the calibration's own covariance, the calibration as it is
predicts :math:`r \sim N(0, S_0)`, :math:`S_0 = I + J \Sigma J^T`; after a change of a suspect
(:mod:`aridcal.jobs.maintain.hypotheses`)

.. math:: r \sim N(0, k^2 I + J \Sigma J^T + s^2 B B^T), \qquad B = J D_h

with k times the noise that was known. Evidence of a suspect is the mean of this density over its sizes s and over k: a
suspect of six directions pays for all six (MacKay 2003, Information Theory, chapter 28). Changes may be large: J is taken
where the suspect, free to move, has its most likely value, and r becomes :math:`r + J (\theta - \theta_0)` (Laplace's method).

To :math:`J \Sigma J^T` comes what the model leaves that neighbouring rows share (:mod:`aridcal.engine.trust.wander`): of several
processes their mean, and for an alarm the mean of the chances with each. Noise with tails (:mod:`aridcal.engine.fit.tails`)
is normal noise whose variance differs from row to row; r, J and all that follows are in units of each row's own, found with
the most likely coefficients. Squares then have the mean that they have without tails, and a smaller variance: chances are at
most as stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import fdtrc, logsumexp

from aridcal.engine.fit.problem import Problem
from aridcal.engine.fit.tails import log_density, weights
from aridcal.engine.trust.wander import WanderProcesses, zero_of
from aridcal.jobs.maintain.hypotheses import Hypothesis
from aridcal.jobs.maintain.realignment import frame_start

NOISE_FACTORS = (1.0, 1.3, 1.7, 2.2, 3.0, 4.0, 6.0, 10.0)
"""Times the known noise that new rows may scatter by: another day, another operator, ten times a broken instrument."""

PRIOR_OF_KNOWN_NOISE = 0.9
"""Probability beforehand that the noise is as known; the rest is shared alike."""

_OTHERS = len(NOISE_FACTORS) - 1
LOG_WEIGHTS = np.log(np.r_[PRIOR_OF_KNOWN_NOISE, np.full(_OTHERS, (1.0 - PRIOR_OF_KNOWN_NOISE) / _OTHERS)])
"""Logarithms of the prior probabilities of :data:`NOISE_FACTORS`."""

MOST_MODE_STEPS = 30
"""Gauss-Newton steps at the most; a zero that is off by a radian takes seven."""

GROSS_RATIO = 1e4
"""Mean square, in sigmas, of rows so far off that a joint's zero is sought all around: a tracker's then are 5 mm off, which a
turn of 5 mrad does. Steps lead from there to where it is from half a radian, so that nothing is sought too late."""

ANGLES_ALL_AROUND = tuple((np.pi / 12.0 * np.arange(-11, 13)).tolist())
"""[rad] all around, in steps from which Gauss and Newton's lead on: the farthest place between two is 0.13 rad off."""

WEIGHT_CHANGE_AT_END = 0.01
"""Relative change of a row's weight that is its last: that of squares is then far below a sigma."""

STEP_AT_END = 1e-3
"""Sigmas of any number measured by which the last step moves its prediction."""

LEAST_SINGULAR_SHARE = 1e-6
"""Share of the largest singular value of a suspect's columns below which the rows do not see a direction."""


@dataclass(frozen=True)
class NewRowsQuestion:
    """New rows asked about a calibration.

    Attributes:
        problem: The rows and the wide model, K coefficients; n numbers in all.
        theta: Coefficients of the calibration, shape (K,).
        covariance: Of these, with what was accepted as moved, shape (K, K).
        sigma: Of each number of a row, shape (m,).
        freedom: Degrees of freedom behind these.
        times: The noise that is accepted, in units of the known.
        dropped: Rows that count no more, shape (N,) bool.
        begin: Where to look for the most likely coefficients, shape (K,).
        unknown: Coefficients of which only these rows tell, shape (K,) bool.
        tails: Degrees of freedom of each channel's noise, infinite where it is normal, shape (C,).
        wandering: What the model may leave that neighbouring rows share; None: nothing.
    """

    problem: Problem
    theta: np.ndarray
    covariance: np.ndarray
    sigma: np.ndarray
    freedom: float
    times: float
    dropped: np.ndarray
    begin: np.ndarray
    unknown: np.ndarray
    tails: np.ndarray
    wandering: WanderProcesses | None = None

    @property
    def counted(self) -> np.ndarray:
        """Numbers that count: measured, and of rows that were not dropped, shape (N, m) bool."""
        data = self.problem.data
        sizes = [channel.size for channel in data.channels]
        return np.repeat(data.measures, sizes, axis=1) & ~self.dropped[:, None]

    @property
    def rows(self) -> np.ndarray:
        """Row of each number that counts, shape (n,)."""
        return np.nonzero(self.counted)[0]

    def at(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n,) and columns (n, K) of the rows that count, in sigmas."""
        counted = self.counted
        # A base around unknown points seems to explain what it only turns: columns are taken where rows and model agree.
        pieces = self.problem.agreeing(theta).pieces(theta)
        r = pieces.r / self.sigma
        J = pieces.J / self.sigma[:, None]
        return r[counted], J[counted]

    @cached_property
    def of_channels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Channels of rows: of each number that counts its channel of a row, shape (n,); of each of these, size and tails."""
        data = self.problem.data
        sizes = np.array([channel.size for channel in data.channels])
        channel_of_number = np.arange(len(data) * len(sizes)).reshape(len(data), -1).repeat(sizes, axis=1)[self.counted]
        channels, which = np.unique(channel_of_number, return_inverse=True)
        return which, sizes[channels % len(sizes)], self.tails[channels % len(sizes)]

    def shared(self, J: np.ndarray) -> np.ndarray:
        """Covariance of what the model leaves that neighbouring rows share, shape (n, n), columns J being (n, K)."""
        covariance = np.zeros((len(J), len(J)))
        if self.wandering is None or not self.wandering.processes:
            return covariance
        model, row = self.problem.model, self.rows
        for joint, variance in zip(model.robot.joints, self.wandering.variance, strict=True):
            Z = J[:, model.coefficients.index(zero_of(joint))]
            covariance += Z[:, None] * variance[np.ix_(row, row)] * Z
        return covariance

    def with_moved(self, suspect: Hypothesis, size: float) -> NewRowsQuestion:
        """The question with a suspect free to change, by a prior of this size."""
        D, begin = suspect.directions, self.begin
        covariance = self.covariance + size**2 * D @ D.T
        if suspect.kind == "frame":
            first = self.problem.model.coefficients[suspect.touched[0]]
            begin = frame_start(self.problem, begin, first.where, first.station)
        if suspect.kind == "zero" and suspect.turns and self.gross:
            begin = self._turned_all_around(int(suspect.touched[0]))
        return replace(self, covariance=covariance, begin=begin)

    @cached_property
    def gross(self) -> bool:
        """True where the rows are so far off that a step along a straight line may lead nowhere."""
        r, _ = self.at(self.begin)
        return float(np.mean(r**2)) > GROSS_RATIO

    def _turned_all_around(self, k: int) -> np.ndarray:
        """Coefficients (K,) with a joint's zero at the angle, of some all around, that leaves the smallest squares."""
        least, best = np.inf, self.begin
        for angle in ANGLES_ALL_AROUND:
            theta = self.begin.copy()
            theta[k] += angle
            r, J = self.at(theta)
            r = r + J @ (theta - self.theta)
            r = r - J[:, k] * (theta - self.theta)[k]
            covariance = J @ self.covariance @ J.T + self.shared(J)
            squares = float(r @ np.linalg.solve(self.times**2 * np.eye(len(r)) + covariance, r))
            if squares < least:
                least, best = squares, theta
        return best


@dataclass(frozen=True)
class PosteriorMode:
    """The most likely coefficients.

    Attributes:
        theta: Shape (K,).
        r: Residuals of the rows about the calibration, to first order about ``theta``, in each row's own sigmas, shape (n,).
        J: Columns there, shape (n, K).
        known_covariance: Covariance of r that is not noise, J Sigma J' and what follows, shape (n, n).
        shared: Of what the model leaves that neighbouring rows share, shape (n, n).
        root: Inverse of each row's own sigma in that of its channel, shape (n,); 1 without tails.
        beyond: Logarithm of what tails make of the density of normal noise, for each of :data:`NOISE_FACTORS`.
    """

    theta: np.ndarray
    r: np.ndarray
    J: np.ndarray
    known_covariance: np.ndarray
    shared: np.ndarray
    root: np.ndarray
    beyond: np.ndarray

    @cached_property
    def spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances (n,) of r without noise, and their axes in columns (n, n): the same for every noise."""
        variances, axes = np.linalg.eigh(self.known_covariance)
        return np.maximum(variances, 0.0), axes

    def whitened(self, values: np.ndarray, times: float) -> np.ndarray:
        """Values (n,) or (n, d) along the axes of r's covariance, in sigmas there, with ``times`` the known noise."""
        variances, axes = self.spectrum
        return scaled_to(axes.T @ values, np.sqrt(times**2 + variances))

    def squares(self, times: float) -> float:
        """Sum of squares of the whitened r."""
        return float(np.sum(self.whitened(self.r, times) ** 2))


def scaled_to(values: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Values (n,) or (n, d) divided by sigmas (n,)."""
    return np.asarray((values.T / sigma).T)


def likely(question: NewRowsQuestion, theta: np.ndarray | None = None) -> PosteriorMode:
    r"""The most likely coefficients, by Gauss-Newton steps in the space of the rows.

    .. math:: \theta = \theta_0 + \Sigma J^T (k^2 I + J \Sigma J^T)^{-1} (r + J (\theta - \theta_0))

    Known coefficients, whose covariance is zero, stay exactly as they are (Bell and Cathey 1993: the iterated Kalman update).

    Args:
        question: The rows.
        theta: Where to begin, shape (K,); default: at the calibration, or at what was accepted as moved.
    """
    start, P = question.theta, question.covariance
    theta = question.begin if theta is None else theta
    which, size, tails = question.of_channels
    has_tails = bool(np.isfinite(tails).any())
    weight = np.ones(len(size))
    for _ in range(MOST_MODE_STEPS):
        r, J = question.at(theta)
        root = np.sqrt(weight)[which]
        r, J = root * (r + J @ (theta - start)), root[:, None] * J
        PJ, shared = P @ J.T, question.shared(J)
        covariance = J @ PJ + shared
        S = question.times**2 * np.eye(len(r)) + covariance
        pull = np.linalg.solve(S, r)
        step = start + PJ @ pull - theta
        squares = np.bincount(which, (question.times * pull / root) ** 2, len(size))
        converged = bool(np.abs(J @ step).max(initial=0.0) < STEP_AT_END)
        if has_tails:
            noise_share = 1.0 - question.times**2 * np.diag(np.linalg.inv(S))  # share of the noise that is not told
            expected = squares + np.bincount(which, noise_share / root**2, len(size))
            before, weight = weight, weights(expected, size, tails)
            converged = converged and bool(np.abs(np.log(weight / before)).max(initial=0.0) < WEIGHT_CHANGE_AT_END)
        theta = theta + step
        if converged:
            break
    beyond = _beyond(squares, root[np.unique(which, return_index=True)[1]] ** 2, size, tails)
    return PosteriorMode(theta, r, J, 0.5 * (covariance + covariance.T), shared, root, beyond)


def _beyond(squares: np.ndarray, weight: np.ndarray, size: np.ndarray, tails: np.ndarray) -> np.ndarray:
    r"""Logarithm of t's density at the noise of the rows, over that of normal noise in which they have weights.

    Of each row :math:`\log t(d^2 / k^2) + (m / 2) \log 2\pi + w d^2 / 2 k^2`, with k times the noise: densities of r in units of
    each row's own noise are made comparable by this, whatever the weights.

    Args:
        squares: Of the noise of each row and channel, in sigmas.
        weight: Theirs.
        size: Numbers of each.
        tails: Degrees of freedom of each.
    """
    d = squares / np.array(NOISE_FACTORS)[:, None] ** 2
    each = log_density(d, size, tails) + 0.5 * size * np.log(2.0 * np.pi) + 0.5 * weight * d
    return np.asarray(np.where(np.isfinite(tails), each, 0.0).sum(axis=1))


def covariance_of(question: NewRowsQuestion, place: PosteriorMode) -> np.ndarray:
    """Covariance of the most likely coefficients, shape (K, K); Joseph's form, which rounding cannot make negative."""
    P = question.covariance
    S = question.times**2 * np.eye(len(place.r)) + place.known_covariance
    gain = np.linalg.solve(S, place.J @ P).T
    left = np.eye(len(P)) - gain @ place.J
    return np.asarray(left @ P @ left.T + gain @ (question.times**2 * np.eye(len(S)) + place.shared) @ gain.T)


SMALLEST_PROBABILITY = 1e-300
"""Probability below which floats have none."""


@dataclass(frozen=True)
class Alarm:
    """Whether new rows contradict a calibration.

    Attributes:
        p_value: Probability of rows as odd as these from a calibration that is still right.
        squares: Of the residual in its expected scatter: a mean square of 1 is as expected.
        numbers: How many they are of.
    """

    p_value: float
    squares: float
    numbers: int

    @property
    def words(self) -> str:
        """The probability, as text."""
        return f"p = {self.p_value:.2g}" if self.p_value > SMALLEST_PROBABILITY else f"p < {SMALLEST_PROBABILITY:g}"

    @property
    def ratio(self) -> float:
        """Mean square in units of what was expected."""
        return self.squares / self.numbers


def alarm(question: NewRowsQuestion, suspects: Sequence[Hypothesis]) -> Alarm:
    r"""Test the residual as a whole, and along what each suspect would do to it.

    The whole: :math:`r^T S_0^{-1} r \sim \chi^2_n`. Along a suspect: the squares that its d directions take up,
    :math:`\chi^2_d`; F where the noise was estimated. The smallest probability counts, times the number of questions asked
    (Bonferroni): half of it for the whole, half for all m suspects together. What the model may leave that rows share is known
    with its probabilities alone, and so the chance is the mean over these (Box 1980, doi:10.2307/2982063).

    Args:
        question: The rows.
        suspects: What the rows may show beside the residual as a whole.
    """
    of_mean = _alarm(question, suspects)
    if question.wandering is None or not question.wandering.processes:
        return of_mean
    per_process = [
        (probability, _alarm(replace(question, wandering=process), suspects).p_value)
        for probability, process in question.wandering.one_by_one()
    ]
    return replace(of_mean, p_value=float(sum(p * value for p, value in per_process) / sum(p for p, _ in per_process)))


def _alarm(question: NewRowsQuestion, suspects: Sequence[Hypothesis]) -> Alarm:
    """The test with the mean covariance of what rows share."""
    place = likely(question)
    z = place.whitened(place.r, question.times)
    squares, numbers = float(z @ z), max(len(z) - rank_of_unknowns(place.J[:, question.unknown]), 1)
    smallest = tail(squares, numbers, question.freedom)
    for suspect in suspects:
        squares_along, count = _squares_along(place.whitened(place.J @ suspect.directions, question.times), z)
        if count:
            smallest = min(smallest, len(suspects) * tail(squares_along, count, question.freedom))
    return Alarm(min(1.0, 2.0 * smallest), squares, numbers)


def rank_of_unknowns(columns: np.ndarray) -> int:
    """Rank of the columns of unknowns, shape (n, u): so many numbers they fit whatever was measured."""
    sizes = np.linalg.norm(columns, axis=0)
    shaped = columns[:, sizes > 0.0] / sizes[sizes > 0.0]
    return (
        int(np.linalg.matrix_rank(shaped, tol=LEAST_SINGULAR_SHARE * max(1.0, np.sqrt(shaped.shape[1]))))
        if shaped.size
        else 0
    )


def tail(squares: float, count: int, freedom: float) -> float:
    """Probability of a larger sum of ``count`` squares, whose scale was estimated with some degrees of freedom."""
    return float(fdtrc(count, freedom, squares / count))


def _squares_along(B: np.ndarray, z: np.ndarray) -> tuple[float, int]:
    """Squares of z (n,) that columns B (n, d) take up, and how many independent ones there are."""
    U, w, _ = np.linalg.svd(B, full_matrices=False)
    observed = w > LEAST_SINGULAR_SHARE * max(float(w.max(initial=0.0)), 1e-300)
    return float(np.sum((U[:, observed].T @ z) ** 2)), int(observed.sum())


@dataclass(frozen=True)
class LogDensities:
    """Logarithms of the density of the rows for each size s and each noise k.

    Attributes:
        density: Shape (sizes, k).
    """

    density: np.ndarray

    @property
    def total(self) -> float:
        """Over all sizes and noises, each with its weight."""
        return float(logsumexp(self.density + LOG_WEIGHTS) - np.log(len(self.density)))

    @property
    def best(self) -> int:
        """Number of the size that is most likely."""
        return int(np.argmax(logsumexp(self.density + LOG_WEIGHTS, axis=1)))


def evidence(place: PosteriorMode, times: float, B: np.ndarray, sizes: tuple[float, ...]) -> LogDensities:
    """Density of the rows after a change along columns B, for each of its sizes and each noise.

    Args:
        place: The rows without that change, about where it is most likely.
        times: The noise that is accepted, in units of the known.
        B: Columns of the change, shape (n, d); none: nothing changed.
        sizes: Of the change; one, whatever it is, where there are no columns.
    """
    density = np.empty((len(sizes), len(NOISE_FACTORS)))
    variances, axes = place.spectrum
    r, B = axes.T @ place.r, axes.T @ B
    for number, times_noise in enumerate(NOISE_FACTORS):  # of the noise that is accepted
        sigma = np.sqrt((times_noise * times) ** 2 + variances)
        z = scaled_to(r, sigma)
        U, w, _ = np.linalg.svd(scaled_to(B, sigma), full_matrices=False)
        along = (U.T @ z) ** 2
        constant = -0.5 * len(z) * np.log(2.0 * np.pi) - float(np.sum(np.log(sigma)))
        for k, size in enumerate(sizes):
            grown = (size * w) ** 2
            squares = float(z @ z) - float(np.sum(along * grown / (1.0 + grown)))
            density[k, number] = constant - 0.5 * squares - 0.5 * float(np.sum(np.log1p(grown))) + place.beyond[number]
    return LogDensities(density)
