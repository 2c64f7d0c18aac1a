"""Every candidate scored at once against the model as it is, and the best of them tried on rows held back.

The tests that a candidate must pass, one after the other, are those of docs/how-the-search-works.md: evidence corrected for
the number of candidates, squared error on rows held back, and a test that stands up to rows that err together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import f as f_distribution
from scipy.stats import wilcoxon

from aridcal.effects.catalogue import KINDS
from aridcal.effects.effect import Effect
from aridcal.effects.regional_kind import is_field, spread_out
from aridcal.effects.sights import is_sight
from aridcal.fit.normal_equations import accumulate
from aridcal.instruments.channels import columns
from aridcal.search.change_points import walk_instead
from aridcal.search.evidence import SMOOTH_PRICE, Score, coefficients, price, score, shaped, smooth_tail, solve, tail
from aridcal.search.linear_model import Active, LinearModel, State, activate, with_candidate
from aridcal.showing import SILENT, Progress

ALPHA = 3e-4
"""Chance that a clean campaign shows any effect at all, by these tests alone: one in three thousand."""

LEAST = 1e-2
"""Share of the squared error, on rows held back, that an effect must take away to matter: 0.5 % of the error."""

ROBUST = 1e-3
"""Chance of one candidate when rows may err together; it has stood out among all candidates before this is asked."""

DOUBT = 0.05
"""The same for a smooth function on rows held back, and for a step beside a slow change, beside their evidence: a second
opinion, so the usual 5 %."""

CHUNK = 128
"""Columns that are scored at once: their Gram matrix stays in the cache."""

PARTS = 5
"""Parts into which stretches of time are put to hold them back, as many as folds."""

REGIONS = 10
"""Regions that are held back whole, one after the other: nine tenths of the rows stay to fit with."""

SHAPINGS = 4
"""Times that shape and noise of a smooth function are found in turn, at the most."""

SHAPED = 0.02
"""Change of the logarithm of the noise that ends this."""


@dataclass(frozen=True)
class Judgement:
    """How a candidate fared: accepted, or why not.

    Attributes:
        effect: The candidate.
        score: Its evidence.
        p_value: Corrected for the number of candidates.
        gain_held_back: Share of the squared error that it takes off rows held back.
        why: Why it was refused; empty if it was accepted.
    """

    effect: Effect
    score: Score
    p_value: float
    gain_held_back: float
    why: str


def score_all(model: LinearModel, effects: Sequence[Effect], state: State, progress: Progress = SILENT) -> list[Score]:
    """Score candidates against a solved state, each alone: what they add, their columns projected off the model's."""
    A = state.whitened(state.design)
    r = state.whitened(state.flat(state.residual))
    left, count = float(r @ r), float(state.equations.count.sum())
    G, phi = _slots_whitened(model, state), model.phi[state.used]
    found: list[Score] = []
    for group in _chunks(effects):
        progress.part(len(found), len(effects), "candidates")
        C = _candidate_columns(model, state, group, G, phi)
        CA, Cr, CC = C.T @ A, C.T @ r, C.T @ C
        projected = CC - CA @ state.solution.inverse @ CA.T
        ends = np.cumsum([0, *(len(e.coefficients) for e in group)])
        for effect, low, high in zip(group, ends[:-1], ends[1:], strict=True):
            own = slice(low, high)
            shape = effect.shape if effect.smooth else None
            found.append(score(projected[own, own], Cr[own], np.diag(CC)[own], left, count, shape))
    return found


def _slots_whitened(model: LinearModel, state: State) -> list[np.ndarray]:
    """Columns of all slots in the rows in use, in sigmas, one array (n, size, S) for each channel."""
    used = model.G[state.used]
    parts = zip(columns(model.channels), state.present.T, state.solution.sigma, strict=True)
    return [(used[:, part] if own.all() else used[own][:, part]) / sigma for part, own, sigma in parts]


def _candidate_columns(
    model: LinearModel, state: State, group: Sequence[Effect], G: Sequence[np.ndarray], phi: np.ndarray
) -> np.ndarray:
    """Columns of some candidates side by side, in sigmas, all channels under one another."""
    if model.off is None and all(model.prepared(e) for e in group):
        pairs = [model.indices(e) for e in group]
        slots, bases = [k for pair in pairs for k in pair[0]], [k for pair in pairs for k in pair[1]]
        values = phi[:, None, bases]
        pieces = [
            part[:, :, slots] * (values if own.all() else values[own])
            for part, own in zip(G, state.present.T, strict=True)
        ]
        return np.vstack([piece.reshape(-1, len(slots)) for piece in pieces])
    pairs = [model.indices(e) for e in group if model.prepared(e)]
    if len(pairs) < len(group):
        every = np.concatenate([model.columns(e) for e in group], axis=2)
    else:
        slots, bases = [k for pair in pairs for k in pair[0]], [k for pair in pairs for k in pair[1]]
        every = model.seen(model.G[:, :, slots] * model.phi[:, None, bases])
    return state.whitened(state.flat(every))


def _chunks(effects: Sequence[Effect]) -> list[list[Effect]]:
    """Candidates in groups of about :data:`CHUNK` columns."""
    groups: list[list[Effect]] = []
    size = CHUNK
    for effect in effects:
        if size + len(effect.coefficients) > CHUNK:
            groups.append([])
            size = 0
        groups[-1].append(effect)
        size += len(effect.coefficients)
    return groups


def refine(model: LinearModel, state: State, effect: Effect, rough: Score) -> Score:
    """The same score with the noise of each channel estimated apart, with the candidate in."""
    if effect.smooth:
        return _reshaped(model, state, effect, rough)
    if rough.freedom == 0:  # declared, though the model can do all that it does
        return rough
    equations, precision = with_candidate(model, state, activate(model, state, effect, rough))
    after = solve(equations, precision, state.solution.sigma)
    twice = 2.0 * (after.likelihood - state.solution.likelihood)
    return replace(rough, gain=price(twice, rough.freedom), p_value=tail(twice, rough.freedom))


def _reshaped(model: LinearModel, state: State, effect: Effect, rough: Score) -> Score:
    """Shape and noise of a smooth function in turn, until they agree: what it hides makes the noise look large."""
    added = state.flat(model.columns(effect))
    total = state.equations.extended(state.design, added, state.right)
    found = rough
    for _ in range(SHAPINGS):
        candidate = activate(model, state, effect, found)
        precision = block_diag(state.precision, candidate.precision)
        solution = solve(total.combined(candidate.modes), precision, state.solution.sigma)
        if found.sigma is not None and abs(np.log(found.sigma[0] / solution.sigma[0])) < SHAPED:
            break
        found = shaped(total, state.precision, effect.shape, solution.sigma)
    # The volume of what its modes may still be counts against it: the marginal likelihood's determinant.
    own = solution.inverse[len(state.precision) :, len(state.precision) :]
    twice = 2.0 * (solution.likelihood - state.solution.likelihood) + float(np.linalg.slogdet(own)[1])
    return replace(found, gain=0.5 * twice - SMOOTH_PRICE, p_value=smooth_tail(twice))


def judge(model: LinearModel, state: State, effect: Effect, found: Score, tested: int) -> Judgement:
    """Accept a candidate, or say why not.

    Args:
        model: The linearised model.
        state: The model without it.
        effect: The candidate.
        found: Its evidence.
        tested: Number of candidates among which it stood out.
    """
    tested += effect.looked if effect.hinted else 0
    if effect.at is not None:  # the best of all rows at all places: both frames, each joint and each thing
        places = {*model.own, "world_base", "tip_target", *(where for where, _ in model.slots)}
        tested += len(state.fold) * len(places)
    p_value = min(1.0, found.p_value * tested)

    def judgement(gain: float, why: str) -> Judgement:
        return Judgement(effect, found, p_value, gain, why)

    if found.gain <= 0.0 or p_value > ALPHA:
        return judgement(0.0, f"not significant (p = {p_value:.2g}, corrected for {tested} candidates)")
    candidate = activate(model, state, effect, found)
    loss = held_back(model, state, candidate, state.fold).sum(axis=1)
    share = float(1.0 - loss[1].sum() / loss[0].sum())
    who = (effect.kind, effect.where, effect.at)
    known = any((a.effect.kind, a.effect.where, a.effect.at) == who for a in state.active)
    if share < (0.0 if known else LEAST):
        percent = 100 * max(share, 0.0)
        return judgement(share, f"reduces the cross-validated squared error by only {percent:.2g} %")
    if model.thing is not None and _at_several(model, effect):
        whole = held_back(model, state, candidate, model.thing[state.used]).sum(axis=(1, 2))
        if whole[1] > whole[0]:
            return judgement(share, "does not hold at places that were held back whole")
    if held_out_whole(model, state, candidate) <= 0.0:
        return judgement(share, "does not hold in regions that were held back whole")
    configuration = np.unique(model.configuration[state.used], return_inverse=True)[1]
    if effect.smooth and not effect.hinted and not is_field(effect):
        robust, least = _ranked(np.array([np.bincount(configuration, each) for each in loss])), DOUBT
    else:
        moved = _fitted(model, state, candidate) if effect.smooth else model.columns(effect)
        robust, least = effect.looked * _robust(model, state, moved, configuration), ROBUST
    if robust > least:
        return judgement(share, f"the gain is not consistent across rows (p = {robust:.2g})")
    if not set(_sources(effect)) <= set(model.own):
        robust = _over_time(model, state, candidate)
        if robust > ROBUST:
            return judgement(share, f"seen in too few separate periods of time (p = {robust:.2g})")
    if effect.at is not None:
        robust = walk_instead(model, state, candidate)
        if robust > DOUBT:
            return judgement(share, f"looks like a slow change, not like a step (p = {robust:.2g})")
    return judgement(share, "")


def held_out_whole(model: LinearModel, state: State, candidate: Active) -> float:
    """Share of the squared error that a constant by region takes off regions held back whole; 1 of all else.

    A constant along a rail is said to hold between the rows that were measured, and must show that; a field in space says
    nothing but where its rows are.
    """
    effect = candidate.effect
    if not KINDS[effect.kind].asked or is_field(effect):
        return 1.0
    places = np.column_stack([model.table[name][state.used] for name in effect.covariates])
    middles, _ = spread_out(places, REGIONS)
    part = np.argmin(np.linalg.norm(places[:, None] - middles, axis=2), axis=1)
    without, with_it = held_back(model, state, candidate, part).sum(axis=(1, 2))
    return float(1.0 - with_it / without)


def _at_several(model: LinearModel, effect: Effect) -> bool:
    """False for what is seen at one place alone: what happened while that was measured, and what is wrong with it."""
    assert model.thing is not None
    there = np.any(model.columns(effect), axis=(1, 2))
    return effect.at is None and len(np.unique(model.thing[there])) > 1


def _fitted(model: LinearModel, state: State, candidate: Active) -> np.ndarray:
    """A smooth candidate as the one column that fits best, shape (N, m, 1): of a narrow map few rows know anything."""
    total, precision = with_candidate(model, state, candidate)
    beta = solve(total, precision, state.solution.sigma).beta[len(state.precision) :]
    return candidate.columns(model) @ beta[:, None]


def _sources(effect: Effect) -> list[str]:
    """What an effect depends on, loads counted as the joints that make them; places of the target, too, are the user's."""
    named = (name for name in effect.covariates if not is_sight(name))
    return [name.split(".")[0] if ".gravity_" in name else name for name in named]


def _over_time(model: LinearModel, state: State, candidate: Active) -> float:
    """p-value of what depends on a column that the user does not control, when rows of one stretch may err together."""
    run = np.unique(model.run[state.used], return_inverse=True)[1]
    if not candidate.effect.smooth:
        return _robust(model, state, model.columns(candidate.effect), run)
    # It may have more freedom than there are stretches: whole stretches are held back instead.
    loss = held_back(model, state, candidate, run % PARTS).sum(axis=1)
    return _ranked(np.array([np.bincount(run, each) for each in loss]))


def _ranked(loss: np.ndarray) -> float:
    """p-value, by Wilcoxon's signed ranks, of losses (2, n) that a candidate makes no smaller."""
    return float(wilcoxon(loss[0] - loss[1], alternative="greater").pvalue)


def held_back(model: LinearModel, state: State, candidate: Active, part: np.ndarray) -> np.ndarray:
    """Squared error in sigmas of each row in use when the rows of its part are held back, without and with a candidate.

    Args:
        model: The linearised model.
        state: The model without it.
        candidate: What is added.
        part: Number of the part of each row in use, shape (n,).

    Returns:
        Shape (2, C, n), channel by channel.
    """
    total, precision = with_candidate(model, state, candidate)
    added = state.flat(candidate.columns(model))
    both = replace(
        state,
        design=tuple(np.hstack([a, c]) for a, c in zip(state.design, added, strict=True)),
        equations=total,
        precision=precision,
        solution=solve(total, precision, state.solution.sigma),
    )
    everything = np.ones(len(precision), dtype=bool)
    return held_back_squares(both, part, [np.arange(len(precision)) < len(state.precision), everything])


def held_back_squares(state: State, part: np.ndarray, kept: Sequence[np.ndarray]) -> np.ndarray:
    """Squared error in sigmas of each row in use when the rows of its part are held back, with some of the columns each time.

    Args:
        state: Solved with all P columns.
        part: Number of the part of each row in use, shape (n,).
        kept: Masks of the columns, shape (P,); L of them.

    Returns:
        Shape (L, C, n), channel by channel.
    """
    sigma, sizes = state.solution.sigma, [channel.size for channel in state.channels]
    squares = np.zeros((len(kept), len(sizes), len(part)))
    for k in np.unique(part):
        held = part == k
        own = [np.flatnonzero(np.repeat(held[there], size)) for there, size in zip(state.present.T, sizes, strict=True)]
        A = [a[rows] for a, rows in zip(state.design, own, strict=True)]
        b = [values[rows] for values, rows in zip(state.right, own, strict=True)]
        rest = state.equations.minus(accumulate(A, b))
        for i, keep in enumerate(kept):
            beta = coefficients(rest.part(keep), state.precision[np.ix_(keep, keep)], sigma)
            for c, (a, values, size) in enumerate(zip(A, b, sizes, strict=True)):
                left = (values - a[:, keep] @ beta) / sigma[c]
                squares[i, c, held & state.present[:, c]] = np.sum(left.reshape(-1, size) ** 2, axis=1)
    return squares


def _robust(model: LinearModel, state: State, moved: np.ndarray, cluster: np.ndarray) -> float:
    r"""p-value of a candidate when the numbers of one cluster of rows may err together: a cluster-robust score test.

    With C its columns off the model's, r the residual and e what it leaves, all in sigmas,

    .. math:: S = \frac{g}{g - 1} \sum_{j} C_j^T e_j e_j^T C_j, \qquad
              F = \frac{r^T C S^+ C^T r}{d} \cdot \frac{g - d}{g} \sim F_{d, g - d}

    for g clusters j and d columns (Cameron and Miller 2015, doi:10.3368/jhr.50.2.317).

    Args:
        model: The linearised model.
        state: The model without it.
        moved: The candidate's columns, shape (N, m, d).
        cluster: Number of the cluster of each row in use, shape (n,).
    """
    A = state.whitened(state.design)
    C = state.whitened(state.flat(moved))
    C = C - A @ (state.solution.inverse @ (A.T @ C))
    C = C[:, np.linalg.norm(C, axis=0) > 1e-9]
    r = state.whitened(state.flat(state.residual))
    after = r - C @ np.linalg.lstsq(C, r, rcond=None)[0]
    clusters, d = int(cluster.max()) + 1, C.shape[1]
    if d == 0 or clusters <= d + 2:
        return 1.0
    there = zip(model.channels, state.present.T, strict=True)
    of_number = np.concatenate([np.repeat(cluster[own], channel.size) for channel, own in there])
    pulls = np.zeros((clusters, d))
    np.add.at(pulls, of_number, C * after[:, None])
    s = C.T @ r
    spread = pulls.T @ pulls * clusters / (clusters - 1)
    statistic = float(s @ np.linalg.pinv(spread, hermitian=True) @ s) / d * (clusters - d) / clusters
    return float(f_distribution.sf(statistic, d, clusters - d))
