"""One candidate at a time: its evidence with the noise estimated beside it, and the tests that it must pass.

The tests that a candidate must pass, one after the other, are those of docs/how-the-search-works.md: evidence corrected for
the number of candidates, squared error on rows held back, and a test that stands up to rows that err together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag
from scipy.special import fdtrc, ndtr

from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.labels import LABEL_COLUMN
from aridcal.engine.corrections.regional_kind import is_local, spread_out
from aridcal.engine.corrections.sights import is_sight
from aridcal.engine.fit.normal_equations import (
    NormalEquations,
    accumulate,
    added,
    conditional,
    inverse,
    last_log_determinant,
    nested_solutions,
)
from aridcal.engine.levels import CHOOSING_FOLDS, DOUBT, JUDGING_FOLDS, LENIENT, PRICE, RARE
from aridcal.engine.numerics import ROUNDS, TINY
from aridcal.engine.search.change_points import walk_instead
from aridcal.engine.search.evidence import Score, price, shaped, smooth_tail, solve, tail, with_noise
from aridcal.engine.search.linear_model import ActiveEffect, LinearModel
from aridcal.engine.search.screening import score_all
from aridcal.engine.search.sets import Choices
from aridcal.engine.search.state import State, activate, by_fold, with_candidate, with_columns

ALPHA = 3e-4
"""Chance that a clean campaign shows any effect at all, by these tests alone: one in three thousand."""

LEAST_ERROR_SHARE = 1e-2
"""Share of the squared error, on rows held back, that an effect must take away to matter: 0.5 % of the error."""

EXACT_RANK_LOSSES = 50
"""Work: Losses up to which chance of their signed ranks is counted out; more are normal to a tenth of the chance, as SciPy has
it."""

SHAPE_CHANGE_AT_END = 0.02
"""Work: Change of the logarithm of the noise that ends this, and below which what it leaves free of a prior is not found
anew."""


@dataclass(frozen=True)
class Judgement:
    """The judgement of a candidate: accepted, or why not.

    Attributes:
        effect: The candidate.
        score: Its evidence.
        p_value: Corrected for the number of candidates.
        gain_held_back: Share of the squared error of held-back rows that it takes away.
        why: Why it was refused; empty if it was accepted.
    """

    effect: Effect
    score: Score
    p_value: float
    gain_held_back: float
    why: str


def refine(state: State, effect: Effect, rough: Score) -> Score:
    """A rough score refined: the noise of each channel estimated for itself, with the candidate in the model."""
    question = "refined", effect, rough.gain, rough.tau, rough.kernel
    return state.model.answers.once(state, question, lambda: _refined(state, effect, rough))


def score_of(state: State, effect: Effect) -> Score:
    """Score of one candidate, the noise of each channel estimated with it in the model."""
    return refine(state, effect, score_all(state.model, [effect], state)[0])


def _refined(state: State, effect: Effect, rough: Score) -> Score:
    if effect.smooth:
        return _refined_smooth(state, effect, rough)
    if rough.freedom == 0:  # declared, though its columns are sums of the model's
        return rough
    candidate = activate(state, effect, rough)
    equations, precision = with_candidate(state, candidate)
    sigma, likelihood = _noise_with(state, equations, precision)
    twice = 2.0 * (likelihood - state.solution.likelihood)
    return replace(rough, gain=price(twice, rough.freedom), p_value=tail(twice, rough.freedom), sigma=sigma)


def _noise_with(state: State, equations: NormalEquations, precision: np.ndarray) -> tuple[np.ndarray, float]:
    """Noise of each channel with a candidate's columns in the model, shape (C,), and the log-likelihood."""
    before = state.solution
    beta, spent = added(equations, precision, before.inverse, before.spent, before.sigma)
    sigma, likelihood = with_noise(equations, precision, before.sigma, beta, spent)
    if np.all(np.abs(np.log(sigma / before.sigma)) < SHAPE_CHANGE_AT_END):
        return sigma, likelihood
    after = solve(equations, precision, sigma)  # degrees of freedom beside priors depend on the noise
    return after.sigma, after.likelihood


def _refined_smooth(state: State, effect: Effect, rough: Score) -> Score:
    """Score of a smooth function, shape and noise estimated in turn: without it, what it explains passes for noise."""
    total, score = with_columns(state, effect), rough
    for _ in range(ROUNDS):
        candidate = activate(state, effect, score)
        equations, precision = total.combined(candidate.modes), block_diag(state.precision, candidate.precision)
        sigma, likelihood = _noise_with(state, equations, precision)
        if score.sigma is not None and abs(np.log(score.sigma[0] / sigma[0])) < SHAPE_CHANGE_AT_END:
            break
        score = shaped(total, state.precision, effect.shape, sigma)
    # The determinant of the marginal likelihood: the volume that its modes may still fill counts against it.
    volume = -last_log_determinant(equations.information(sigma) + precision, len(state.precision))
    twice = 2.0 * (likelihood - state.solution.likelihood) + volume
    return replace(score, gain=0.5 * twice - 2.0 * PRICE, p_value=smooth_tail(twice))


def judge(state: State, effect: Effect, score: Score, choices: Choices) -> Judgement:
    """Accept a candidate, or say why not.

    Args:
        state: The model without it.
        effect: The candidate.
        score: Its evidence.
        choices: Candidates among which it is the best; where several of its family are in the model, it counts as the best
            of the others of that family alone.
    """
    siblings = choices.siblings(state.active, effect)
    chance, tested = (LENIENT, siblings) if siblings else (ALPHA, choices.count)
    tested += effect.looked if effect.hinted else 0
    model = state.model
    if effect.at is not None:  # it is the best of all rows at all places: both frames, each joint and each thing
        places = {*model.joints, "world_base", "tip_target", *(where for where, _ in model.slots)}
        tested += len(state.fold) * len(places)
    p_value = min(1.0, score.p_value * tested)

    def judgement(gain: float, why: str) -> Judgement:
        return Judgement(effect, score, p_value, gain, why)

    if score.gain <= 0.0 or p_value > chance:
        return judgement(0.0, f"not significant (p = {p_value:.2g}, corrected for {tested} candidates)")
    candidate = activate(state, effect, score)
    loss = held_back_folds(state, candidate).sum(axis=1)
    share = float(1.0 - loss[1].sum() / loss[0].sum())
    cause = (effect.kind, effect.where, effect.at)
    is_active = any((a.effect.kind, a.effect.where, a.effect.at) == cause for a in state.active)
    if share < (0.0 if is_active or siblings else LEAST_ERROR_SHARE):
        percent = 100 * max(share, 0.0)
        return judgement(share, f"reduces the cross-validated squared error by only {percent:.2g} %")
    if model.thing is not None and _is_at_several_things(model, effect):
        whole = held_back_errors(state, candidate, model.thing[state.used]).sum(axis=(1, 2))
        if whole[1] > whole[0]:
            return judgement(share, "does not hold at places that were held back whole")
    if held_out_whole(state, candidate) <= 0.0:
        return judgement(share, "does not hold in regions that were held back whole")
    configuration = np.unique(model.configuration[state.used], return_inverse=True)[1]
    if effect.smooth and not effect.hinted and not is_local(effect):
        robust, least = _p_value_of_losses(np.array([np.bincount(configuration, each) for each in loss])), DOUBT
    else:
        along = _best_function(state, candidate) if effect.smooth else np.eye(len(effect.coefficients))
        robust, least = (
            effect.looked * _p_value_of_clusters(state, effect, along, configuration),
            DOUBT if siblings else RARE,
        )
    if robust > least:
        return judgement(share, f"the gain is not consistent across rows (p = {robust:.2g})")
    if not set(sources(effect)) <= set(model.joints):
        robust = _p_value_over_time(state, candidate)
        if robust > RARE:
            return judgement(share, f"seen in too few separate periods of time (p = {robust:.2g})")
    if effect.at is not None:
        robust = walk_instead(model, state, candidate)
        if robust > DOUBT:
            return judgement(share, f"looks like a slow change, not like a step (p = {robust:.2g})")
    return judgement(share, "")


def held_out_whole(state: State, candidate: ActiveEffect) -> float:
    """Share of the squared error that a constant by region takes off regions held back whole; 1 of all else.

    A constant along a rail is said to hold between the rows that were measured, and must show that; a field in space, or what
    single labels deviate by, says nothing but where its rows are.
    """
    effect = candidate.effect
    if not EFFECT_KINDS[effect.kind].on_request or is_local(effect):
        return 1.0
    places = np.column_stack([state.model.table[name][state.used] for name in effect.covariates])
    middles, _ = spread_out(places, JUDGING_FOLDS)
    part = np.argmin(np.linalg.norm(places[:, None] - middles, axis=2), axis=1)
    without, with_it = held_back_errors(state, candidate, part).sum(axis=(1, 2))
    return float(1.0 - with_it / without)


def _is_at_several_things(model: LinearModel, effect: Effect) -> bool:
    """False for an effect that moves rows of one place alone, or a step: what happened there, or is wrong with that place."""
    assert model.thing is not None
    there = np.any(model.columns(effect), axis=(1, 2))
    return effect.at is None and len(np.unique(model.thing[there])) > 1


def _best_function(state: State, candidate: ActiveEffect) -> np.ndarray:
    """Coefficients of the function that fits best for a smooth candidate, shape (d, 1): few rows determine a narrow map."""
    total, precision = with_candidate(state, candidate)
    beta = solve(total, precision, state.solution.sigma).beta[len(state.precision) :]
    return candidate.modes @ beta[:, None]


def sources(effect: Effect) -> list[str]:
    """Covariates of an effect, loads by the joint that bears them; without places of the target and labels."""
    named = (name for name in effect.covariates if not is_sight(name) and name != LABEL_COLUMN)
    return [name.split(".")[0] if ".gravity_" in name else name for name in named]


def _p_value_over_time(state: State, candidate: ActiveEffect) -> float:
    """p-value of an effect on a column that the user does not control, when rows of one stretch of time may err together."""
    run = np.unique(state.model.run[state.used], return_inverse=True)[1]
    if not candidate.effect.smooth:
        return _p_value_of_clusters(state, candidate.effect, np.eye(len(candidate.effect.coefficients)), run)
    # It may have more freedom than there are stretches: whole stretches are held back instead.
    loss = held_back_errors(state, candidate, run % CHOOSING_FOLDS).sum(axis=1)
    return _p_value_of_losses(np.array([np.bincount(run, each) for each in loss]))


def _p_value_of_losses(loss: np.ndarray) -> float:
    """p-value, by Wilcoxon's signed ranks, that a candidate makes losses (2, n), without and with it, no smaller."""
    return signed_ranks(loss[0] - loss[1])


def signed_ranks(values: np.ndarray) -> float:
    r"""p-value of Wilcoxon's signed ranks that values, shape (n,), are no larger than zero.

    Of few values all :math:`2^{n'}` ways to give signs to the ranks are counted. Of many, with R the sum of the ranks of positive
    values among the n' that are not zero, and t the sizes of ties,

    .. math:: z = \frac{R - n' (n' + 1) / 4}{\sqrt{n' (n' + 1) (2 n' + 1) / 24 - \sum (t^3 - t) / 48}}

    is normal (Wilcoxon 1945; ties: Pratt and Gibbons, Concepts of Nonparametric Theory, Springer 1981).
    """
    few = len(values) <= EXACT_RANK_LOSSES
    values = values[values != 0.0]
    _, number, ties = np.unique(np.abs(values), return_inverse=True, return_counts=True)
    rank = (np.cumsum(ties) - 0.5 * (ties - 1))[number]
    if few:
        twice = np.rint(2.0 * rank).astype(int)  # a tie has half ranks
        ways = np.ones(1)  # of each sum of the ranks so far
        for rank_twice in twice.tolist():
            ways = np.pad(ways, (0, rank_twice)) + np.pad(ways, (rank_twice, 0))
        return float(ways[twice[values > 0.0].sum() :].sum() / ways.sum())
    n = float(len(values))
    spread = n * (n + 1.0) * (2.0 * n + 1.0) / 24.0 - float(np.sum(ties**3.0 - ties)) / 48.0
    above = float(rank[values > 0.0].sum()) - 0.25 * n * (n + 1.0)
    return float(ndtr(-above / np.sqrt(max(spread, TINY))))


def held_back_errors(state: State, candidate: ActiveEffect, part: np.ndarray) -> np.ndarray:
    """Squared error in sigmas of each row in use when the rows of its part are held back, without and with a candidate.

    Args:
        state: The model without it.
        candidate: The effect added.
        part: Number of the part of each row in use, shape (n,).

    Returns:
        Shape (2, C, n), channel by channel.
    """
    total, precision = with_candidate(state, candidate)
    sigma = _noise_with(state, total, precision)[0]
    more = state.flat(candidate.columns(state.model))
    design = [np.hstack([a, c]) for a, c in zip(state.design, more, strict=True)]
    everything = np.ones(len(precision), dtype=bool)
    masks = [np.arange(len(precision)) < len(state.precision), everything]
    return held_back_squares(state, design, total, precision, sigma, part, masks)


def held_back_folds(state: State, candidate: ActiveEffect) -> np.ndarray:
    r"""As :func:`held_back_errors` with the folds as parts, from sums that are there already, shape (2, C, n).

    One factorisation serves both: with the candidate's columns last, its leading block is that of the model without them.
    """
    products, layout = state.model.products, state.model.products.layout
    P, sizes = len(state.precision), [channel.size for channel in state.channels]
    precision = block_diag(state.precision, candidate.precision)
    sigma = candidate.score.sigma
    if sigma is None:
        sigma = _noise_with(state, *with_candidate(state, candidate))[0]
    H, g = by_fold(state, candidate, sigma)
    rest, pull = H.sum(axis=0) + precision - H, g.sum(axis=0) - g
    squares = np.zeros((2, len(sizes), len(layout.order)))
    for k, (low, high) in enumerate(pairwise(layout.starts.tolist())):
        beta = nested_solutions(rest[k], pull[k], P)
        fitted = state.fitted_by_place(beta, low, high, candidate)
        for c, (r, values, size) in enumerate(zip(products.r, fitted, sizes, strict=True)):
            error = (r[low * size : high * size, None] - values) / sigma[c]
            squares[:, c, low:high] = np.sum(error.reshape(high - low, size, 2) ** 2, axis=1).T
    by_row = np.empty_like(squares)
    by_row[:, :, layout.order] = squares
    return np.where(state.present.T, by_row[:, :, state.used], 0.0)


def held_back_squares(
    state: State,
    design: Sequence[np.ndarray],
    equations: NormalEquations,
    precision: np.ndarray,
    sigma: np.ndarray,
    part: np.ndarray,
    masks: Sequence[np.ndarray],
) -> np.ndarray:
    """Squared error in sigmas of each row in use when the rows of its part are held back, with some of the columns each time.

    Args:
        state: Its n rows in use count.
        design: P columns of these rows, one array for each channel, shape (n size, P).
        equations: Of these columns.
        precision: Of the prior of all coefficients, shape (P, P).
        sigma: Noise of each channel, shape (C,).
        part: Number of the part of each row in use, shape (n,).
        masks: L choices of columns, shape (P,) bool each.

    Returns:
        Shape (L, C, n), channel by channel.
    """
    sizes = [channel.size for channel in state.channels]
    squares = np.zeros((len(masks), len(sizes), len(part)))
    whole, pull = equations.information(sigma) + precision, equations.pull(sigma)
    for k in np.unique(part):
        in_part = part == k
        numbers = [
            np.flatnonzero(np.repeat(in_part[there], size)) for there, size in zip(state.present.T, sizes, strict=True)
        ]
        A = [a[rows] for a, rows in zip(design, numbers, strict=True)]
        b = [values[rows] for values, rows in zip(state.right, numbers, strict=True)]
        sums_of_part = accumulate(A, b)
        covariance = inverse(whole - sums_of_part.information(sigma))
        solution = covariance @ (pull - sums_of_part.pull(sigma))
        beta = np.stack([conditional(covariance, solution, ~keep) for keep in masks], axis=1)
        for c, (a, values, size) in enumerate(zip(A, b, sizes, strict=True)):
            error = (values[:, None] - a @ beta) / sigma[c]
            squares[:, c, in_part & state.present[:, c]] = np.sum(error.reshape(-1, size, len(masks)) ** 2, axis=1).T
    return squares


def _p_value_of_clusters(state: State, effect: Effect, along: np.ndarray, cluster: np.ndarray) -> float:
    r"""p-value of a candidate when the numbers of one cluster of rows may err together: a cluster-robust score test.

    With C its columns projected off the model's, r the residual and e that after C, all in sigmas,

    .. math:: S = \frac{g}{g - 1} \sum_{j} C_j^T e_j e_j^T C_j, \qquad
              F = \frac{r^T C S^+ C^T r}{d} \cdot \frac{g - d}{g} \sim F_{d, g - d}

    for g clusters j and d columns (Cameron and Miller 2015, doi:10.3368/jhr.50.2.317).

    Args:
        state: The model without it.
        effect: The candidate.
        along: Combinations of its coefficients that are tested, shape (coefficients, d).
        cluster: Number of the cluster of each row in use, shape (n,).
    """
    products, sigma = state.model.products, state.solution.sigma
    chunk, where = products.chunk_of(effect)
    AC = np.tensordot(sigma**-2.0, state.in_use(chunk, where)[0], 1) @ along
    fitted = state.fitted_by_place(state.solution.inverse @ AC, 0, len(products.layout.order))
    columns_of = [x @ along - values for x, values in zip(products.flat([effect]), fitted, strict=True)]
    C = state.whitened(state.flat(products.layout.by_row(columns_of)))
    C = C[:, np.linalg.norm(C, axis=0) > 1e-9]
    r = state.whitened(state.flat(state.residual))
    after = r - C @ np.linalg.lstsq(C, r, rcond=None)[0]
    clusters, d = int(cluster.max()) + 1, C.shape[1]
    if d == 0 or clusters <= d + 2:
        return 1.0
    there = zip(state.channels, state.present.T, strict=True)
    of_number = np.concatenate([np.repeat(cluster[present], channel.size) for channel, present in there])
    pulls = np.zeros((clusters, d))
    np.add.at(pulls, of_number, C * after[:, None])
    s = C.T @ r
    spread = pulls.T @ pulls * clusters / (clusters - 1)
    statistic = float(s @ np.linalg.pinv(spread, hermitian=True) @ s) / d * (clusters - d) / clusters
    return float(fdtrc(d, clusters - d, statistic))
