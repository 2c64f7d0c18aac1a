"""Weighted least squares on the extended model: robust start, flags, identifiable subset, covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.elimination import Groups
from aridcal.engine.fit.flags import coarsest, limits, outlier_rows, robust_sigma
from aridcal.engine.fit.identifiable import Subset, identifiable
from aridcal.engine.fit.normal_equations import CombinedEquations, Prior, condition, inverse, solve
from aridcal.engine.fit.problem import Problem
from aridcal.engine.fit.residual import Linearisation, linearise, problem_with_things, triangle
from aridcal.engine.instruments.channels import spread
from aridcal.engine.model.model import Model, ModelRows
from aridcal.engine.numerics import FLOOR, MOST_ITERATIONS, RANK, RIDGE, ROUNDS
from aridcal.engine.rows.dataset import with_sigma
from aridcal.system.errors import NotIdentifiable

COARSE_NOISE_SHARE = 0.1
"""Work: Of the coarsest channel's noise: until a fit has settled none that is estimated counts as finer. Turns may fit long
before places do, those of exact data to the last digit; weighed by that alone they would hold the rest back."""

LAST_STEP_SHARE = 0.03
"""Work: A step that moves no combination of coefficients by more than this share of its sigma is the last."""

SETTLED_ROBUST_SHARE = 1.0
"""Work: The same for a robust fit, whose flags are all that is wanted of it."""

SKIPPED_STEP_SHARE = 1e-3
"""Work: The same for a step that is not even taken where rows are many: it would be another look at all of them."""

NOISE_CHANGE_AT_END = 1e-9
"""Work: Relative change of the noise that ends its estimation: no figure may tell where it was begun, and only sums are asked
again."""

ROUGH_ROWS = 300
"""Work: Rows of a robust fit, or four times the coefficients if that is more: flags need no more."""

FIRST_FITTED_ROWS = 20_000
"""Work: Rows that are fitted first, where there are twice as many: what they leave to do for all of them is one step."""

NUMBERS_PER_ROW = 3
"""Work: That a row measures, as these counts of rows take it: a position. Where it is one length, three times the rows are
taken."""

FEWEST_ROWS_OF_A_FRAME = 10
"""Work: Rows of each frame in any choice of rows: enough to find the frame."""

LEAST_FREEDOM = 0.5
"""Work: Degrees of freedom below which the noise of a channel cannot be estimated, and stays as it was."""

FIRST_DAMPING, MOST_DAMPING = 1e-4, 1e8
"""Work: Levenberg's damping of balanced equations: the first that changes anything, and the last that lets anything move."""

NEAR, SHORTEST = 1.0, 1e-3
"""Work: Sigmas of a whole step from which it is cut rather than damped, and the least share of it that is tried: where a
constant is barely identifiable the way to the optimum is narrow and bent, and damping would bar just that way."""

SQUARES_SLACK = 0.5
"""Work: Squares, in sigmas, by which the sum may grow where readings are what was observed: it is not what is minimised there,
but nearly (see :meth:`aridcal.engine.model.predictions.Observations.agreeing`)."""

VANISHED_GRADIENT = 1e-2
"""Work: Sigmas of a coefficient: a gradient that asks for less has vanished."""

PLENTY_OF_NUMBERS = 8.0
"""Numbers measured for each coefficient from which nothing is believed of it: its freedom costs an
eighth of the squares at most."""

USUAL, BELIEVED = 1e-3, 2.0
"""[m] and [rad]: a millimetre and a milliradian are what constants of industrial arms are usually off by; that counts as much
as two coefficients of a group that are known."""

OTHER_CONFIGURATIONS = 200
"""Work: Configurations not measured, at the least, that say which constants other rows would tell: several numbers for each."""

NUMBERS_THAT_TELL_NOISE = 8
"""Numbers beyond the coefficients below which rows do not tell their noise: from eight on it is known to a quarter."""

SIZE_CHANGE_AT_END = 0.02
"""Work: Relative change of a group's size that ends its estimation: what depends on it changes by less than a hundredth of a
sigma."""

FIRST_NOISE = 1e-4
"""[m] and [rad]: noise of a good instrument, where nothing is known of it yet."""


@dataclass(frozen=True)
class Convergence:
    """Figures of how well a minimum is reached.

    Attributes:
        steps: Gauss-Newton steps taken.
        gradient: Largest gradient, as the step it asks for in sigmas of the coefficient.
        condition: Of the Jacobian, each column scaled to length 1.
        restarts: Other starts that were tried; each must lead to the same minimum.
        agreed: How many of them led there.
    """

    steps: int
    gradient: float
    condition: float
    restarts: int = 0
    agreed: int = 0

    @property
    def converged(self) -> bool:
        """True if the gradient vanished; ``agreed`` says whether other starts lead to the same minimum."""
        return self.gradient < VANISHED_GRADIENT


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
        candidates: All coefficients that were to be fitted.
        redundant: For each candidate that was dropped, the names of the coefficients that it is confounded with.
        convergence: How well the minimum is reached.
        spent: Degrees of freedom used up: K, or less where priors shrink.
        numbers: Numbers measured in the rows in use.
        believed: Precision of a prior at zero, used where rows are few, shape (K, K): all zero without one.
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
        """Inverse of the covariance, shape (K, K), of rows and priors; 0 for combinations that move nothing."""
        scale = np.where(self.std > 0.0, self.std, 1.0)
        relative = self.covariance / np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(relative, rcond=RANK, hermitian=True) / np.outer(scale, scale))

    @property
    def outliers(self) -> np.ndarray:
        """Rows of weight 0, shape (N,) bool."""
        return np.asarray(self.weight < 0.5)

    @property
    def freedom(self) -> float:
        """Degrees of freedom left: numbers measured minus those used up."""
        return self.numbers - self.spent


@dataclass(frozen=True)
class Minimum:
    """Where a minimisation ended.

    Attributes:
        theta: Coefficients, shape (K,).
        at: The problem linearised there.
        sigma: Noise of each channel, shape (C,).
        steps: Steps taken.
        gradient: As in :class:`Convergence`.
        question: The problem, its things at the minimum.
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
        weight: Of each row, shape (N,); None: Cauchy's, its scale estimated anew at each step, and the last decimals
            left to a later call with fixed weights.
        prior: Of the coefficients, from elsewhere than these rows.
    """
    channels, declared = problem.channels, problem.data.declared
    robust, abreast, even = weight is None, True, np.ones(len(channels))
    settled = SETTLED_ROBUST_SHARE if robust else LAST_STEP_SHARE
    at_once = linearise(problem, theta, weight, even) if not robust and problem.measured.direct else None
    scale = robust_sigma(at_once.residual if at_once else problem.scaled_residual(theta), channels)

    def noise_at(equations: CombinedEquations, sigma: np.ndarray) -> np.ndarray:
        estimate = scale if robust else _noise_of_residuals(equations, sigma)
        return declared(
            np.maximum(estimate, COARSE_NOISE_SHARE * coarsest(estimate, channels)) if abreast else estimate
        )

    def steady(equations: CombinedEquations, sigma: np.ndarray) -> np.ndarray:
        for _ in range(ROUNDS):
            before_sigma, sigma = sigma, noise_at(equations, sigma)
            if np.all(np.abs(sigma - before_sigma) <= NOISE_CHANGE_AT_END * before_sigma):
                break
        return sigma

    # Until rows are weighed channels count beside one another by their robust scale, then by their noise.
    current = at_once or linearise(problem, theta, weight, scale if robust else declared(scale))
    equations = CombinedEquations(current.equations, prior)
    sigma = noise_at(equations, declared(scale))
    damping, share, steps = 0.0, 1.0, 0
    while steps < MOST_ITERATIONS and damping < MOST_DAMPING:
        g = equations.pull(sigma, theta)
        combined = solve(equations.information(sigma), g, damping)
        step, length = equations.of_coefficients(combined[:, None])[:, 0], float(np.sqrt(max(combined @ g, 0.0)))
        last = length < settled and damping == 0.0
        last |= bool(np.all(np.abs(step) < RIDGE * (1.0 + np.abs(theta))))
        step = step if last else share * step
        if last and abreast and not robust:
            abreast, sigma = False, steady(equations, sigma)  # the last step is taken in the noise that stays
            continue
        if last and length < SKIPPED_STEP_SHARE and _has_many(problem):
            step = np.zeros(len(theta))
            ahead, trial = problem, current
        else:
            ahead = problem.stepped(current.step_of_groups(step), current.agreed)
            trial = linearise(ahead, theta + step, weight, scale if robust else sigma)
        before = current.squares(current.weight, sigma, channels) + equations.squares(theta)
        after = trial.squares(current.weight, sigma, channels) + equations.squares(theta + step)
        steps += 1
        if after <= before + (0.0 if problem.measured.direct else SQUARES_SLACK) or last:
            equations = equations if trial is current else CombinedEquations(trial.equations, prior)
            problem, theta, current = ahead, theta + step, trial
            damping = 0.0 if damping < FIRST_DAMPING else damping / 10
            scale = robust_sigma(current.residual, channels) if robust else scale
            sigma, share = noise_at(equations, sigma), min(1.0, 2.0 * share)
        elif length < NEAR and share > SHORTEST:
            share /= 4.0
        else:
            damping, share = max(10 * damping, FIRST_DAMPING), 1.0
        if last:
            break
    sigma = sigma if robust else steady(equations, sigma)
    g = equations.pull(sigma, theta)
    square = float(solve(equations.information(sigma), g) @ g)
    return Minimum(theta, current, sigma, steps, float(np.sqrt(max(square, 0.0))), problem)


def fit(
    problem: Problem, theta: np.ndarray | None = None, weight: np.ndarray | None = None, prior: Prior | None = None
) -> Fit:
    """Fit the given coefficients, all of them: robustly on some of the rows, then on all with the outliers flagged.

    Args:
        problem: K identifiable coefficients, N rows.
        theta: Start; default: zero.
        weight: Weights to use instead of looking for outliers, shape (N,).
        prior: Of the coefficients, from elsewhere than these rows.
    """
    model, data = problem.model, problem.data
    theta = np.zeros(len(model.coefficients)) if theta is None else theta
    steps, limit = 0, limits(data)
    searching = weight is None
    if weight is None:
        some = _rows_for_rough_fit(problem)
        rough = minimise(problem.select(some), theta, None, prior)
        theta, steps = rough.theta, rough.steps
        problem = problem_with_things(problem.with_states(rough.question.states), theta)
        weight = np.where(outlier_rows(problem.scaled_residual(theta), problem.channels, limit), 0.0, 1.0)
    if _has_many(problem):
        some = thin(problem.rows, FIRST_FITTED_ROWS)
        theta = minimise(problem.select(some), theta, weight[some], prior).theta
    for _ in range(ROUNDS):
        minimum = minimise(problem, theta, weight, prior)
        problem, theta, steps = minimum.question, minimum.theta, steps + minimum.steps
        new_weight = (
            np.where(outlier_rows(minimum.at.residual, problem.channels, limit), 0.0, 1.0) if searching else weight
        )
        if np.array_equal(new_weight, weight):
            break
        weight = new_weight
    equations, sigma = minimum.at.equations, minimum.sigma
    combined = CombinedEquations(equations, prior)
    inner = inverse(combined.information(sigma), ridge=0.0)
    H = equations.information(sigma) + (0.0 if prior is None else prior.precision)
    return Fit(
        model=replace(model, instruments=problem.instruments, states=problem.states) if problem.states else model,
        theta=theta,
        covariance=combined.covariance(inner),
        sigma=sigma,
        estimated=_noise_of_residuals(combined, sigma),
        weight=minimum.at.weight,
        residual=minimum.at.residual,
        candidates=model.coefficients,
        redundant={},
        convergence=Convergence(steps, minimum.gradient, condition(H)),
        spent=float(combined.equations.spent(inner, sigma).sum()),
        numbers=float(equations.count.sum()),
        believed=np.zeros((len(theta), len(theta))),
    )


def fit_identifiable(
    problem: Problem, order: Sequence[int], groups: Sequence[Sequence[int]] = (), plenty: float = PLENTY_OF_NUMBERS
) -> Fit:
    """Fit the identifiable coefficients of a model; the others stay nominal and are named as redundant.

    Args:
        problem: All candidates, N rows.
        order: The candidates' indices, those to be kept before others first.
        groups: Candidates of one prior size, where rows are few; see :func:`shrunk`.
        plenty: Numbers measured for each coefficient from which rows are not few.

    Raises:
        NotIdentifiable: nothing at all can be identified.
    """
    model = problem.model
    theta = np.zeros(len(model.coefficients))
    sigma = problem.data.declared(np.full(len(problem.channels), FIRST_NOISE))
    some = _rows_for_rough_fit(problem)
    share = np.full(len(some), len(problem) / len(some))
    sizes = model.sizes
    subset = identifiable(triangle(problem.select(some), theta, share, sigma) * sizes, order)
    for _ in range(ROUNDS):
        kept = sorted(subset.independent)
        if not kept:
            raise NotIdentifiable([model.names])
        narrowed = _of_fewer_coefficients(problem, kept)
        result = fit(narrowed, theta[kept])
        problem = problem.with_states(result.model.states)
        theta = np.zeros(len(model.coefficients))
        theta[kept] = result.theta
        R = triangle(problem, theta, result.weight, result.sigma) * sizes
        # Kept columns stay ahead: near the solution a symmetry of the nominal robot is broken a little, and columns
        # that this makes barely separable must not push out well-determined ones.
        subset = identifiable(R, order, kept)
        if sorted(subset.independent) == kept:
            break
    if any(groups) and result.numbers < plenty * len(kept):
        result, subset = _fit_few_rows(problem, order, groups, replace(result, theta=theta), subset)
    redundant = {model.names[k]: tuple(model.names[j] for j in partners) for k, partners in subset.redundant.items()}
    convergence = replace(result.convergence, condition=subset.condition)
    return replace(result, candidates=model.coefficients, redundant=redundant, convergence=convergence)


def _fit_few_rows(
    problem: Problem, order: Sequence[int], groups: Sequence[Sequence[int]], free: Fit, free_subset: Subset
) -> tuple[Fit, Subset]:
    """The fit of rows so few that the constants need a prior, and the subset of constants that it has.

    Constants that only other configurations would determine are in it, too: their prior is then part of the covariance.

    Args:
        problem: All candidates, N rows.
        order: As for :func:`fit_identifiable`.
        groups: Likewise.
        free: A fit without a prior, with values of all candidates: zero for those that are not in ``free_subset``.
        free_subset: The coefficients of that fit.
    """
    model, kept = problem.model, sorted(free_subset.independent)
    constants = [k for group in groups for k in group]
    theta = free.theta.copy()
    theta[constants] = 0.0
    R = triangle(problem, theta, free.weight, free.sigma)
    if problem.measured.direct:
        R = np.asarray(np.linalg.qr(np.vstack([R, _columns_elsewhere(problem, theta, free.sigma)]), mode="r"))
    # Frames have no prior: those that these rows do not determine stay out.
    subset = identifiable(R * model.sizes, [k for k in order if k in {*kept, *constants}], kept)
    every = sorted(subset.independent)
    begin = replace(free, theta=theta[every])
    redundant = {k: why for k, why in free_subset.redundant.items() if k not in every} | subset.redundant
    return shrunk(_of_fewer_coefficients(problem, every), begin, _motions_of_groups(R, every, groups)), replace(
        subset, redundant=redundant
    )


def _columns_elsewhere(problem: Problem, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Columns of all candidates at other combinations of the rows' joint readings, shape (numbers, candidates)."""
    data, rng = problem.data, np.random.default_rng(0)
    some = np.resize(np.arange(len(data)), max(OTHER_CONFIGURATIONS, len(data)))
    readings = np.column_stack([rng.permutation(column[some]) for column in data.readings.T])
    labels = (None if of is None else of[some] for of in (data.labels.station, data.labels.target))
    _, _, J = problem.model.jacobian(theta, problem.model.rows(readings, None, *labels))
    numbers = sum(channel.size for channel in problem.channels)
    return np.asarray((J[:, :numbers] / spread(sigma, problem.channels)[:, None]).reshape(-1, len(theta)))


def _motions_of_groups(R: np.ndarray, columns: Sequence[int], groups: Sequence[Sequence[int]]) -> list[np.ndarray]:
    r"""For each group of candidates how the fitted coefficients move with it: T of :math:`J = J_{kept} T`, shape (K, n_g) each.

    Args:
        R: Triangle of the columns of all candidates, shape (all, all).
        columns: Candidates that are fitted.
        groups: Candidates of each group; a coefficient of no group has no prior.
    """
    T = np.linalg.lstsq(R[:, columns], R, rcond=None)[0]
    free = [k for k, candidate in enumerate(columns) if not any(candidate in group for group in groups)]
    T[free] = 0.0
    return [T[:, list(group)] for group in groups if len(group)]


def shrunk(problem: Problem, free: Fit, groups: Sequence[np.ndarray]) -> Fit:
    r"""A fit with a prior of one size for the constants of a group, the size being estimated from the rows.

    Of all constants :math:`\varphi`, the redundant ones among them, those of group g are :math:`N(0, \tau_g^2)`. The coefficients
    that are fitted stand for sums of them, :math:`\theta = T \varphi`, with the prior :math:`N(0, C)`,

    .. math:: C = \sum_g \tau_g^2 T_g T_g^T

    The sizes follow by restricted maximum likelihood (Harville 1977; the EM step of Laird and Ware 1982),

    .. math:: \tau_g^2 = \frac{\nu \tau_0^2 + \sum_{k \in g} (E \varphi_k^2)}{\nu + n_g}

    where :math:`\tau_0` = :data:`USUAL` counts as :math:`\nu` = :data:`BELIEVED` constants. Constants that rows do not determine
    stay near zero; where rows tell much, the fit is the free one. Where there are hardly more numbers than coefficients, the
    noise is taken to be no finer than :data:`FIRST_NOISE`: a close fit would pass for a fine instrument.

    Args:
        problem: K identifiable coefficients, N rows.
        free: A fit of them without a prior, to begin from; its weights stay.
        groups: :math:`T_g` of each group, shape (K, n_g): zero for the coefficients without a prior.
    """
    believed = np.flatnonzero(np.any(np.concatenate(groups, axis=1), axis=1))
    parts = [T[believed] for T in groups]
    sizes = np.full(len(groups), USUAL)
    fitted, theta = free, free.theta.copy()
    theta[believed] = 0.0
    precision = np.zeros((len(theta), len(theta)))
    noise_known = free.numbers - len(theta) >= NUMBERS_THAT_TELL_NOISE
    finest = problem.data.declared(np.full(len(problem.channels), FIRST_NOISE))
    for _ in range(ROUNDS):
        C = sum((size**2 * T @ T.T for size, T in zip(sizes, parts, strict=True)), np.zeros(2 * (len(believed),)))
        precision[np.ix_(believed, believed)] = inverse(C, ridge=RIDGE)
        prior = Prior(np.zeros(len(theta)), precision.copy())
        question = problem.with_states(fitted.model.states)
        fitted = fit(question, theta, free.weight, prior)
        if not noise_known and np.any(fitted.sigma < finest):
            sigma = np.maximum(fitted.sigma, finest).tolist()
            fitted = fit(replace(question, data=with_sigma(question.data, sigma)), theta, free.weight, prior)
        theta, before = fitted.theta, sizes.copy()
        second = np.outer(theta[believed], theta[believed]) + fitted.covariance[np.ix_(believed, believed)]
        for g, T in enumerate(parts):
            # Regression of the constants on the coefficients.
            gain = before[g] ** 2 * T.T @ precision[np.ix_(believed, believed)]
            size_of_means = float(np.trace(gain @ second @ gain.T))
            size_of_doubts = before[g] ** 2 * (T.shape[1] - float(np.trace(gain @ T)))
            sizes[g] = np.sqrt((BELIEVED * USUAL**2 + size_of_means + size_of_doubts) / (BELIEVED + T.shape[1]))
        if np.all(np.abs(sizes / before - 1.0) < SIZE_CHANGE_AT_END):
            break
    return replace(fitted, believed=precision)


def _has_many(problem: Problem) -> bool:
    """Whether rows are so many that a fit of some leaves next to nothing to do for all."""
    return len(problem) > 2 * FIRST_FITTED_ROWS and problem.measured.direct


def _rows_for_rough_fit(problem: Problem) -> np.ndarray:
    """Row numbers of a choice large enough for a robust fit of all coefficients, whatever a row measures."""
    numbers = sum(channel.size for channel in problem.channels) / len(problem.channels)
    most = max(ROUGH_ROWS, 4 * len(problem.model.coefficients))
    return thin(problem.rows, round(most * max(1.0, NUMBERS_PER_ROW / numbers)), problem.groups)


def thin(rows: ModelRows, most: int, groups: Groups | None = None) -> np.ndarray:
    """Ascending row numbers: all, or a reproducible random choice of about ``most``, every frame with its share.

    Where things have few rows each, all rows of a thing are chosen or none: one row tells nothing beside the thing's place.
    """
    if len(rows) <= most:
        return np.arange(len(rows))
    rng = np.random.default_rng(0)
    if (
        groups is not None
        and (groups.row >= 0).all()
        and len(rows) < FEWEST_ROWS_OF_A_FRAME * len(np.unique(groups.row))
    ):
        order = rng.permutation(len(groups.unknown))[groups.row]
        return np.flatnonzero(order <= np.partition(order, most)[most])
    pair = rows.world * (rows.tip.max() + 1) + rows.tip
    choices = []
    for k in np.unique(pair):
        rows_of_pair = np.flatnonzero(pair == k)
        share = max(most * len(rows_of_pair) // len(rows), min(len(rows_of_pair), FEWEST_ROWS_OF_A_FRAME))
        choices.append(rng.choice(rows_of_pair, share, replace=False))
    return np.sort(np.concatenate(choices))


def _of_fewer_coefficients(problem: Problem, columns: Sequence[int]) -> Problem:
    """The problem for some of its coefficients alone, with their bases."""
    if len(columns) == len(problem.model.coefficients):
        return problem
    return replace(problem, measured=problem.measured.narrowed(columns))


def _noise_of_residuals(combined: CombinedEquations, sigma: np.ndarray) -> np.ndarray:
    """Noise of each channel from the residuals, shape (C,): the root of squares over the remaining degrees of freedom."""
    equations = combined.equations
    freedom = equations.count - equations.spent(inverse(combined.information(sigma), ridge=0.0), sigma)
    sigma_of_residuals = np.sqrt(equations.rr / np.where(freedom > LEAST_FREEDOM, freedom, 1.0))
    return np.where(freedom > LEAST_FREEDOM, np.maximum(sigma_of_residuals, FLOOR), sigma)
