"""Weighted least squares on the extended model: robust start, flags, identifiable subset, covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.elimination import Groups
from aridcal.engine.fit.flags import coarsest, flagged, limits, robust_sigma
from aridcal.engine.fit.identifiable import Subset, identifiable
from aridcal.engine.fit.normal_equations import Combined, Prior, condition, inverse, solve
from aridcal.engine.fit.problem import Problem
from aridcal.engine.fit.residual import Linearisation, linearise, things_again, triangle
from aridcal.engine.instruments.channels import spread
from aridcal.engine.model.model import Model, Rows
from aridcal.engine.numerics import FLOOR, RANK, RIDGE, ROUNDS, STEPS
from aridcal.engine.rows.dataset import with_sigma
from aridcal.system.errors import NotIdentifiable

ABREAST = 0.1
"""Work: Of the coarsest channel's noise: until a fit has settled none that is estimated counts as finer. Turns may fit long
before places do, those of exact data to the last digit; weighed by that alone they would hold the rest back."""

SETTLED = 0.03
"""Work: A step that moves no combination of coefficients by more than this share of its sigma is the last."""

ROUGH = 1.0
"""Work: The same for a robust fit, whose flags are all that is wanted of it."""

UNNOTICED = 1e-3
"""Work: The same for a step that is not even taken where rows are many: it would be another look at all of them."""

STEADY = 1e-9
"""Work: Relative change of the noise that ends its estimation: no figure may tell where it was begun, and only sums are asked
again."""

ROUGH_ROWS = 300
"""Work: Rows of a robust fit, or four times the coefficients if that is more: flags need no more."""

AHEAD = 20_000
"""Work: Rows that are fitted first, where there are twice as many: what they leave to do for all of them is one step."""

NUMBERS = 3
"""Work: That a row measures, as these counts of rows take it: a position. Where it is one length, three times the rows are
taken."""

FEWEST = 10
"""Work: Rows of each frame in any choice of rows: enough to find the frame."""

LEAST_FREEDOM = 0.5
"""Work: Degrees of freedom below which the noise of a channel cannot be estimated, and stays as it was."""

FIRST_DAMPING, MOST_DAMPING = 1e-4, 1e8
"""Work: Levenberg's damping of balanced equations: the first that changes anything, and the last that lets anything move."""

NEAR, SHORTEST = 1.0, 1e-3
"""Work: Sigmas of a whole step from which it is cut rather than damped, and the least share of it that is tried: where a
constant is barely identifiable the way to the optimum is narrow and bent, and damping would bar just that way."""

SLACK = 0.5
"""Work: Squares, in sigmas, by which the sum may grow where readings are what was observed: it is not what is minimised there,
but nearly (see :meth:`aridcal.engine.model.predictions.Measured.agreeing`)."""

VANISHED = 1e-2
"""Work: Sigmas of a coefficient: a gradient that asks for less has vanished."""

PLENTY = 8.0
"""Numbers measured for each coefficient from which nothing is believed of it: its freedom costs an
eighth of the squares at most."""

USUAL, BELIEVED = 1e-3, 2.0
"""[m] and [rad]: a millimetre and a milliradian are what constants of industrial arms are usually off by; that counts as much
as two coefficients of a group that are known."""

OTHER = 200
"""Work: Configurations not measured, at the least, that say which constants other rows would tell: several numbers for each."""

TELLING = 8
"""Numbers beyond the coefficients below which rows do not tell their noise: from eight on it is known to a quarter."""

CLOSE = 0.02
"""Work: Relative change of a group's size that ends its estimation: what depends on it changes by less than a hundredth of a
sigma."""

UNKNOWN_NOISE = 1e-4
"""[m] and [rad]: noise of a good instrument, where nothing is known of it yet."""


@dataclass(frozen=True)
class Convergence:
    """Proof that a minimum was found.

    Attributes:
        steps: Gauss-Newton steps taken.
        gradient: Largest gradient, as the step it asks for in sigmas of the coefficient.
        condition: Of the Jacobian, each column scaled to length 1.
        restarts: Other starts that were tried; each must lead to the same minimum.
        agreed: How many of them did.
    """

    steps: int
    gradient: float
    condition: float
    restarts: int = 0
    agreed: int = 0

    @property
    def converged(self) -> bool:
        """True if the gradient vanished. Whether other starts lead to the same minimum is told by ``agreed``."""
        return self.gradient < VANISHED


@dataclass(frozen=True)
class Fit:
    """A solved model.

    Attributes:
        model: The coefficients that were kept, frames at their start.
        theta: Their values, shape (K,).
        covariance: Shape (K, K).
        sigma: Noise of each channel per axis that weighed the rows, shape (C,).
        estimated: Noise that the residuals show, degrees of freedom taken into account, shape (C,).
        weight: Of each row, shape (N,): 0 for outliers.
        residual: Measured minus predicted, scaled by the rows' relative sigmas, shape (N, m).
        candidates: All coefficients that were asked for.
        redundant: For each that was dropped: the names of those it is confounded with.
        convergence: How well the minimum was found.
        spent: Degrees of freedom used up: K, or less where priors shrink.
        numbers: Numbers measured in the rows in use.
        believed: Precision with which coefficients were believed to be zero, where rows are few, shape (K, K): all zero where
            nothing was believed.
    """

    model: Model
    theta: np.ndarray
    covariance: np.ndarray
    sigma: np.ndarray
    estimated: np.ndarray
    weight: np.ndarray
    residual: np.ndarray
    candidates: tuple[Coefficient, ...]
    redundant: dict[str, tuple[str, ...]]
    convergence: Convergence
    spent: float
    numbers: float
    believed: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of each coefficient, shape (K,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @cached_property
    def information(self) -> np.ndarray:
        """Inverse of the covariance, shape (K, K): of rows and priors; of combinations that move nothing there is none."""
        scale = np.where(self.std > 0.0, self.std, 1.0)
        relative = self.covariance / np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(relative, rcond=RANK, hermitian=True) / np.outer(scale, scale))

    @property
    def outliers(self) -> np.ndarray:
        """Rows that were given no weight, shape (N,)."""
        return np.asarray(self.weight < 0.5)

    @property
    def freedom(self) -> float:
        """Degrees of freedom left: numbers measured minus those used up."""
        return self.numbers - self.spent


@dataclass(frozen=True)
class Minimum:
    """Where a minimisation ended.

    Attributes:
        theta: Shape (K,).
        at: The problem there.
        sigma: Noise of each channel, shape (C,).
        steps: Steps taken.
        gradient: As in :class:`Convergence`.
        question: The problem, its things where they were found.
    """

    theta: np.ndarray
    at: Linearisation
    sigma: np.ndarray
    steps: int
    gradient: float
    question: Problem


def minimise(problem: Problem, theta: np.ndarray, weight: np.ndarray | None, prior: Prior | None = None) -> Minimum:
    """Levenberg-Marquardt from theta, noise that is not declared estimated on the way.

    Args:
        problem: K coefficients, N rows.
        theta: Start, shape (K,).
        weight: Of each row, shape (N,); None: Cauchy's, its scale found anew at each step, and the last decimals
            left to a later call with fixed weights.
        prior: Beliefs that are not measured here.
    """
    channels, declared = problem.channels, problem.data.declared
    robust, abreast, even = weight is None, True, np.ones(len(channels))
    settled = ROUGH if robust else SETTLED
    at_once = linearise(problem, theta, weight, even) if not robust and problem.measured.direct else None
    scale = robust_sigma(at_once.residual if at_once else problem.scaled_residual(theta), channels)

    def noise_at(told: Combined, sigma: np.ndarray) -> np.ndarray:
        estimate = scale if robust else _estimate(told, sigma)
        return declared(np.maximum(estimate, ABREAST * coarsest(estimate, channels)) if abreast else estimate)

    def steady(told: Combined, sigma: np.ndarray) -> np.ndarray:
        for _ in range(ROUNDS):
            held, sigma = sigma, noise_at(told, sigma)
            if np.all(np.abs(sigma - held) <= STEADY * held):
                break
        return sigma

    # Until rows are weighed channels count beside one another by their robust scale, then by their noise.
    here = at_once or linearise(problem, theta, weight, scale if robust else declared(scale))
    told = Combined(here.equations, prior)
    sigma = noise_at(told, declared(scale))
    damping, share, taken = 0.0, 1.0, 0
    while taken < STEPS and damping < MOST_DAMPING:
        g = told.pull(sigma, theta)
        combined = solve(told.information(sigma), g, damping)
        step, length = told.of_coefficients(combined[:, None])[:, 0], float(np.sqrt(max(combined @ g, 0.0)))
        last = length < settled and damping == 0.0
        last |= bool(np.all(np.abs(step) < RIDGE * (1.0 + np.abs(theta))))
        step = step if last else share * step
        if last and abreast and not robust:
            abreast, sigma = False, steady(told, sigma)  # the last step is taken in the noise that stays
            continue
        if last and length < UNNOTICED and _has_many(problem):
            step = np.zeros(len(theta))
            there, trial = problem, here
        else:
            there = problem.stepped(here.step_of_groups(step), here.agreed)
            trial = linearise(there, theta + step, weight, scale if robust else sigma)
        before = here.squares(here.weight, sigma, channels) + told.squares(theta)
        after = trial.squares(here.weight, sigma, channels) + told.squares(theta + step)
        taken += 1
        if after <= before + (0.0 if problem.measured.direct else SLACK) or last:
            told = told if trial is here else Combined(trial.equations, prior)
            problem, theta, here, damping = there, theta + step, trial, 0.0 if damping < FIRST_DAMPING else damping / 10
            scale = robust_sigma(here.residual, channels) if robust else scale
            sigma, share = noise_at(told, sigma), min(1.0, 2.0 * share)
        elif length < NEAR and share > SHORTEST:
            share /= 4.0
        else:
            damping, share = max(10 * damping, FIRST_DAMPING), 1.0
        if last:
            break
    sigma = sigma if robust else steady(told, sigma)
    g = told.pull(sigma, theta)
    asked = float(solve(told.information(sigma), g) @ g)
    return Minimum(theta, here, sigma, taken, float(np.sqrt(max(asked, 0.0))), problem)


def fit(
    problem: Problem, theta: np.ndarray | None = None, weight: np.ndarray | None = None, prior: Prior | None = None
) -> Fit:
    """Fit the given coefficients, all of them: robustly on some of the rows, then on all with the outliers flagged.

    Args:
        problem: K identifiable coefficients, N rows.
        theta: Start; default: zero.
        weight: Weights to use instead of looking for outliers, shape (N,).
        prior: Beliefs that are not measured here.
    """
    model, data = problem.model, problem.data
    theta = np.zeros(len(model.coefficients)) if theta is None else theta
    steps, limit = 0, limits(data)
    searching = weight is None
    if weight is None:
        some = _enough(problem)
        rough = minimise(problem.select(some), theta, None, prior)
        theta, steps = rough.theta, rough.steps
        problem = things_again(problem.with_states(rough.question.states), theta)
        weight = np.where(flagged(problem.scaled_residual(theta), problem.channels, limit), 0.0, 1.0)
    if _has_many(problem):
        some = thin(problem.rows, AHEAD)
        theta = minimise(problem.select(some), theta, weight[some], prior).theta
    for _ in range(ROUNDS):
        found = minimise(problem, theta, weight, prior)
        problem, theta, steps = found.question, found.theta, steps + found.steps
        again = np.where(flagged(found.at.residual, problem.channels, limit), 0.0, 1.0) if searching else weight
        if np.array_equal(again, weight):
            break
        weight = again
    equations, sigma = found.at.equations, found.sigma
    told = Combined(equations, prior)
    inner = inverse(told.information(sigma), ridge=0.0)
    H = equations.information(sigma) + (0.0 if prior is None else prior.precision)
    return Fit(
        model=replace(model, instruments=problem.instruments, states=problem.states) if problem.states else model,
        theta=theta,
        covariance=told.covariance(inner),
        sigma=sigma,
        estimated=_estimate(told, sigma),
        weight=found.at.weight,
        residual=found.at.residual,
        candidates=model.coefficients,
        redundant={},
        convergence=Convergence(steps, found.gradient, condition(H)),
        spent=float(told.equations.spent(inner, sigma).sum()),
        numbers=float(equations.count.sum()),
        believed=np.zeros((len(theta), len(theta))),
    )


def fit_identifiable(problem: Problem, order: Sequence[int], groups: Sequence[Sequence[int]] = ()) -> Fit:
    """Fit the identifiable ones of a model's coefficients; the others stay nominal and are named.

    Args:
        problem: All candidates, N rows.
        order: The candidates' indices, the ones to keep before others first.
        groups: Candidates that are believed to be alike in size, where rows are few; see :func:`shrunk`.

    Raises:
        NotIdentifiable: nothing at all can be identified.
    """
    model = problem.model
    theta = np.zeros(len(model.coefficients))
    sigma = problem.data.declared(np.full(len(problem.channels), UNKNOWN_NOISE))
    some = _enough(problem)
    share = np.full(len(some), len(problem) / len(some))
    sizes = model.sizes
    subset = identifiable(triangle(problem.select(some), theta, share, sigma) * sizes, order)
    for _ in range(ROUNDS):
        kept = sorted(subset.kept)
        if not kept:
            raise NotIdentifiable([model.names])
        narrowed = _narrowed(problem, kept)
        result = fit(narrowed, theta[kept])
        problem = problem.with_states(result.model.states)
        theta = np.zeros(len(model.coefficients))
        theta[kept] = result.theta
        R = triangle(problem, theta, result.weight, result.sigma) * sizes
        # What was kept stays ahead: near the solution a symmetry of the nominal robot is broken a little, and what
        # that makes barely separable must not push out what is well known.
        subset = identifiable(R, order, kept)
        if sorted(subset.kept) == kept:
            break
    if groups and result.numbers < PLENTY * len(kept):
        result, subset = _of_few(problem, order, groups, replace(result, theta=theta), subset)
    redundant = {model.names[k]: tuple(model.names[j] for j in partners) for k, partners in subset.redundant.items()}
    convergence = replace(result.convergence, condition=subset.condition)
    return replace(result, candidates=model.coefficients, redundant=redundant, convergence=convergence)


def _of_few(
    problem: Problem, order: Sequence[int], groups: Sequence[Sequence[int]], free: Fit, told: Subset
) -> tuple[Fit, Subset]:
    """The fit of rows so few that something must be believed of the constants, and which of these it has.

    It has those, too, that only other configurations would tell: what is believed of them is then part of the covariance.

    Args:
        problem: All candidates, N rows.
        order: As for :func:`fit_identifiable`.
        groups: Likewise.
        free: A free fit of those that these rows tell, with values of all, the others zero.
        told: Which these are.
    """
    model, kept = problem.model, sorted(told.kept)
    constants = [k for group in groups for k in group]
    theta = free.theta.copy()
    theta[constants] = 0.0
    R = triangle(problem, theta, free.weight, free.sigma)
    if problem.measured.direct:
        R = np.asarray(np.linalg.qr(np.vstack([R, _elsewhere(problem, theta, free.sigma)]), mode="r"))
    # Of frames nothing is believed: those that these rows do not tell stay out.
    subset = identifiable(R * model.sizes, [k for k in order if k in {*kept, *constants}], kept)
    every = sorted(subset.kept)
    begin = replace(free, theta=theta[every])
    left = {k: why for k, why in told.redundant.items() if k not in every} | subset.redundant
    return shrunk(_narrowed(problem, every), begin, _stood_for(R, every, groups)), replace(subset, redundant=left)


def _elsewhere(problem: Problem, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Columns of all candidates where the joints' readings are combined otherwise than in the rows, (numbers, candidates)."""
    data, rng = problem.data, np.random.default_rng(0)
    some = np.resize(np.arange(len(data)), max(OTHER, len(data)))
    readings = np.column_stack([rng.permutation(column[some]) for column in data.readings.T])
    labels = (None if of is None else of[some] for of in (data.labels.station, data.labels.target))
    _, _, J = problem.model.jacobian(theta, problem.model.rows(readings, None, *labels))
    numbers = sum(channel.size for channel in problem.channels)
    return np.asarray((J[:, :numbers] / spread(sigma, problem.channels)[:, None]).reshape(-1, len(theta)))


def _stood_for(R: np.ndarray, kept: Sequence[int], groups: Sequence[Sequence[int]]) -> list[np.ndarray]:
    r"""For each group of candidates how the fitted coefficients move with it: T of :math:`J = J_{kept} T`, shape (K, n_g) each.

    Args:
        R: Triangle of the columns of all candidates, shape (all, all).
        kept: Those that are fitted.
        groups: Candidates; coefficients of none of them are free.
    """
    T = np.linalg.lstsq(R[:, kept], R, rcond=None)[0]
    free = [k for k, candidate in enumerate(kept) if not any(candidate in group for group in groups)]
    T[free] = 0.0
    return [T[:, list(group)] for group in groups if len(group)]


def shrunk(problem: Problem, free: Fit, groups: Sequence[np.ndarray]) -> Fit:
    r"""A fit in which constants of a group are believed to be alike in size, of a size that the rows tell.

    Of all constants :math:`\varphi`, the redundant ones among them, those of group g are :math:`N(0, \tau_g^2)`. The coefficients
    that are fitted stand for sums of them, :math:`\theta = T \varphi`, and are believed to be :math:`N(0, C)`,

    .. math:: C = \sum_g \tau_g^2 T_g T_g^T

    The sizes follow by restricted maximum likelihood (Harville 1977; the EM step of Laird and Ware 1982),

    .. math:: \tau_g^2 = \frac{\nu \tau_0^2 + \sum_{k \in g} (E \varphi_k^2)}{\nu + n_g}

    where :math:`\tau_0` = :data:`USUAL` counts as :math:`\nu` = :data:`BELIEVED` constants. What rows do not tell stays near
    zero; where they tell much, the fit is the free one. Noise that rows do not tell, as there are hardly more numbers than
    coefficients, is taken to be no finer than :data:`UNKNOWN_NOISE`: else what was fitted passes for noise that is not there.

    Args:
        problem: K identifiable coefficients, N rows.
        free: A free fit of them, to begin from; its weights stay.
        groups: For each group :math:`T_g`, shape (K, n_g): zero for the coefficients of which nothing is believed.
    """
    believed = np.flatnonzero(np.any(np.concatenate(groups, axis=1), axis=1))
    parts = [T[believed] for T in groups]
    sizes = np.full(len(groups), USUAL)
    fitted, theta = free, free.theta.copy()
    theta[believed] = 0.0
    precision = np.zeros((len(theta), len(theta)))
    told = free.numbers - len(theta) >= TELLING
    finest = problem.data.declared(np.full(len(problem.channels), UNKNOWN_NOISE))
    for _ in range(ROUNDS):
        C = sum((size**2 * T @ T.T for size, T in zip(sizes, parts, strict=True)), np.zeros(2 * (len(believed),)))
        precision[np.ix_(believed, believed)] = inverse(C, ridge=RIDGE)
        prior = Prior(np.zeros(len(theta)), precision.copy())
        asked = problem.with_states(fitted.model.states)
        fitted = fit(asked, theta, free.weight, prior)
        if not told and np.any(fitted.sigma < finest):
            sigma = np.maximum(fitted.sigma, finest).tolist()
            fitted = fit(replace(asked, data=with_sigma(asked.data, sigma)), theta, free.weight, prior)
        theta, before = fitted.theta, sizes.copy()
        second = np.outer(theta[believed], theta[believed]) + fitted.covariance[np.ix_(believed, believed)]
        for g, T in enumerate(parts):
            gain = before[g] ** 2 * T.T @ precision[np.ix_(believed, believed)]  # of the constants on what is fitted
            known = float(np.trace(gain @ second @ gain.T))
            left = before[g] ** 2 * (T.shape[1] - float(np.trace(gain @ T)))
            sizes[g] = np.sqrt((BELIEVED * USUAL**2 + known + left) / (BELIEVED + T.shape[1]))
        if np.all(np.abs(sizes / before - 1.0) < CLOSE):
            break
    return replace(fitted, believed=precision)


def _has_many(problem: Problem) -> bool:
    """Whether a fit of some of the rows alone leaves next to nothing to do."""
    return len(problem) > 2 * AHEAD and problem.measured.direct


def _enough(problem: Problem) -> np.ndarray:
    """Row numbers of a choice that is large enough for all coefficients, whatever a row measures."""
    numbers = sum(channel.size for channel in problem.channels) / len(problem.channels)
    most = max(ROUGH_ROWS, 4 * len(problem.model.coefficients))
    return thin(problem.rows, round(most * max(1.0, NUMBERS / numbers)), problem.groups)


def thin(rows: Rows, most: int, groups: Groups | None = None) -> np.ndarray:
    """Row numbers: all, or a reproducible random choice of about ``most`` of them in order, of every frame its share.

    Rows of things that have few are taken together or not at all: one row of a thing tells of nothing else.
    """
    if len(rows) <= most:
        return np.arange(len(rows))
    rng = np.random.default_rng(0)
    if groups is not None and (groups.row >= 0).all() and len(rows) < FEWEST * len(np.unique(groups.row)):
        order = rng.permutation(len(groups.unknown))[groups.row]
        return np.flatnonzero(order <= np.partition(order, most)[most])
    pair = rows.world * (rows.tip.max() + 1) + rows.tip
    chosen = []
    for k in np.unique(pair):
        own = np.flatnonzero(pair == k)
        share = max(most * len(own) // len(rows), min(len(own), FEWEST))
        chosen.append(rng.choice(own, share, replace=False))
    return np.sort(np.concatenate(chosen))


def _narrowed(problem: Problem, kept: Sequence[int]) -> Problem:
    """The same rows for fewer coefficients: their bases follow."""
    if len(kept) == len(problem.model.coefficients):
        return problem
    return replace(problem, measured=problem.measured.narrowed(kept))


def _estimate(told: Combined, sigma: np.ndarray) -> np.ndarray:
    """Noise of each channel from the residuals, shape (C,): sum of squares over the degrees of freedom that it has left."""
    equations = told.equations
    freedom = equations.count - equations.spent(inverse(told.information(sigma), ridge=0.0), sigma)
    left = np.sqrt(equations.rr / np.where(freedom > LEAST_FREEDOM, freedom, 1.0))
    return np.where(freedom > LEAST_FREEDOM, np.maximum(left, FLOOR), sigma)
