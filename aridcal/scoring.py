"""Every candidate scored at once against the model as it is, and the best of them tried on rows held back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import f as f_distribution
from scipy.stats import wilcoxon

from aridcal.bench import Active, Bench, State, activate, apart, with_candidate
from aridcal.catalogue import ORDERS
from aridcal.effects import Effect
from aridcal.evidence import SMOOTH_PRICE, Score, coefficients, extended, score, shaped, solve, sums, tail
from aridcal.scan import SCANNED

ALPHA = 3e-4  # chance that a clean campaign shows any effect at all, by these tests alone
LEAST = 1e-2  # share of the squared error, on rows held back, that an effect must take away to matter
ROBUST = 1e-3  # the same chance for one candidate when residuals of neighbouring rows may be alike
DOUBT = 0.05  # the same for a smooth function on rows held back, beside its evidence
CHUNK = 128
PARTS = 5  # into which stretches of time are put to hold them back
SHAPINGS = 4  # times that shape and noise of a smooth function are found in turn, at the most


@dataclass(frozen=True)
class Verdict:
    """How a candidate fared: accepted, or why not."""

    effect: Effect
    score: Score
    p_value: float
    gain_held_back: float
    why: str


def score_all(bench: Bench, effects: Sequence[Effect], state: State) -> list[Score]:
    """Score candidates against a solved state, each alone: what they add, their columns projected off the model's."""
    used = state.weight > 0.5
    scale = (1.0 / state.solution.sigma.position, 1.0 / state.solution.sigma.rotation)
    A = np.vstack([a * f for a, f in zip(state.design, scale, strict=False)])
    r = np.concatenate([f * b.ravel() for b, f in zip(apart(state.residual[used]), scale, strict=False)])
    left, count = float(r @ r), float(state.sums.count.sum())
    G, phi = [g * f for g, f in zip(apart(bench.G[used]), scale, strict=False)], bench.phi[used]
    found: list[Score] = []
    for group in _chunks(effects):
        ends = np.cumsum([0, *(len(e.coefficients) for e in group)])
        if all(bench.prepared(e) for e in group):
            pairs = [bench.indices(e) for e in group]
            slots, bases = [k for pair in pairs for k in pair[0]], [k for pair in pairs for k in pair[1]]
            C = np.vstack([(g[:, :, slots] * phi[:, None, bases]).reshape(-1, len(slots)) for g in G])
        else:
            some = np.concatenate([bench.columns(e)[used] for e in group], axis=2)
            C = np.vstack([(c * f).reshape(-1, some.shape[2]) for c, f in zip(apart(some), scale, strict=False)])
        CA, Cr, CC = C.T @ A, C.T @ r, C.T @ C
        projected = CC - CA @ state.solution.inverse @ CA.T
        for effect, low, high in zip(group, ends[:-1], ends[1:], strict=True):
            own = slice(low, high)
            found.append(
                score(
                    projected[own, own], Cr[own], np.diag(CC)[own], left, count, effect.shape if effect.smooth else None
                )
            )
    return found


def _chunks(effects: Sequence[Effect]) -> list[list[Effect]]:
    groups: list[list[Effect]] = []
    size = CHUNK
    for effect in effects:
        if size + len(effect.coefficients) > CHUNK:
            groups.append([])
            size = 0
        groups[-1].append(effect)
        size += len(effect.coefficients)
    return groups


def refine(bench: Bench, state: State, effect: Effect, rough: Score) -> Score:
    """The same score with the noise of positions and rotations estimated apart, with the candidate in."""
    if effect.smooth:
        return _reshaped(bench, state, effect, rough)
    candidate = activate(bench, state, effect, rough)
    with_it, precision = with_candidate(bench, state, candidate)
    twice = 2.0 * (solve(with_it, precision, state.solution.sigma).likelihood - state.solution.likelihood)
    d = rough.freedom
    if d == 0:  # declared, though the model can do all that it does
        return rough
    gain = 0.5 * (twice - d * (1.0 + np.log(max(twice / d, 1.0))))
    return replace(rough, gain=gain, p_value=tail(twice, d))


def _reshaped(bench: Bench, state: State, effect: Effect, rough: Score) -> Score:
    """Shape and noise of a smooth function in turn, until they agree: what it hides makes the noise look large."""
    total = extended(state.sums, state.design, state.flat(bench.columns(effect)), state.right)
    found = rough
    for _ in range(SHAPINGS):
        candidate = activate(bench, state, effect, found)
        precision = block_diag(state.precision, candidate.precision)
        solution = solve(total.combined(candidate.modes), precision, state.solution.sigma)
        if found.sigma is not None and abs(np.log(found.sigma.position / solution.sigma.position)) < 0.02:
            break
        found = shaped(total, state.precision, effect.shape, solution.sigma)
    twice = 2.0 * (solution.likelihood - state.solution.likelihood)
    twice += float(np.linalg.slogdet(solution.inverse[len(state.precision) :, len(state.precision) :])[1])
    return replace(found, gain=0.5 * twice - SMOOTH_PRICE, p_value=float(np.exp(-max(0.5 * twice, 0.0))))


def admitted(bench: Bench, state: State, effect: Effect) -> Active:
    """An effect that is taken without trial, with the shape that suits the data if it is smooth."""
    return activate(bench, state, effect, refine(bench, state, effect, score_all(bench, [effect], state)[0]))


def judge(bench: Bench, state: State, effect: Effect, found: Score, tested: int) -> Verdict:
    """Accept a candidate, or say why not."""
    odd = effect.kind == "joint_harmonic" and max(effect.order) not in ORDERS
    orders = SCANNED * len(bench.own) if odd else 1  # among which this one was the loudest
    tested += orders if odd else 0
    p_value = min(1.0, found.p_value * tested)

    def verdict(held_back: float, why: str) -> Verdict:
        return Verdict(effect, found, p_value, held_back, why)

    if found.gain <= 0.0 or p_value > ALPHA:
        return verdict(0.0, f"chance would do as well (p = {p_value:.2g} among {tested} candidates)")
    candidate = activate(bench, state, effect, found)
    loss = _losses(bench, state, candidate, state.fold)
    held_back = float(1.0 - loss[1].sum() / loss[0].sum())
    same = any((a.effect.kind, a.effect.where) == (effect.kind, effect.where) for a in state.active)
    if held_back < (0.0 if same else LEAST):
        return verdict(
            held_back, f"takes only {100 * max(held_back, 0.0):.2g} % off the squared error of rows held back"
        )
    robust = _ranked(loss) if effect.smooth else orders * _robust(bench, state, candidate, np.arange(loss.shape[1]))
    if robust > (DOUBT if effect.smooth else ROBUST):
        return verdict(held_back, f"the rows do not agree about it (p = {robust:.2g})")
    if not set(_sources(effect)) <= set(bench.own):
        run = np.unique(bench.run[state.weight > 0.5], return_inverse=True)[1]
        if effect.smooth:  # which may have more freedom than there are stretches
            loss = _losses(bench, state, candidate, run % PARTS)
            robust = _ranked(np.array([np.bincount(run, each) for each in loss]))
        else:
            robust = _robust(bench, state, candidate, run)
        if robust > ROBUST:
            return verdict(held_back, f"seen in too few stretches of time to be believed (p = {robust:.2g})")
    return verdict(held_back, "")


def _sources(effect: Effect) -> list[str]:
    return [name.split(".")[0] if ".gravity_" in name else name for name in effect.covariates]


def _ranked(loss: np.ndarray) -> float:
    """p-value, by signed ranks, of losses (2, n) that a candidate makes no smaller."""
    return float(wilcoxon(loss[0] - loss[1], alternative="greater").pvalue)


def _losses(bench: Bench, state: State, candidate: Active, part: np.ndarray) -> np.ndarray:
    """Squared error in sigmas of each row in use when the rows of its part are held back, without and with a candidate.

    Args:
        bench: The linearised model.
        state: The model without it.
        candidate: What is added.
        part: Number of the part of each row in use, shape (n,).

    Returns:
        Shape (2, n).
    """
    total, precision = with_candidate(bench, state, candidate)
    sigma = solve(total, precision, state.solution.sigma).sigma
    design = [np.hstack([a, c]) for a, c in zip(state.design, state.flat(candidate.columns(bench)), strict=True)]
    loss = np.zeros((2, len(part)))
    for k in np.unique(part):
        own = np.flatnonzero(np.repeat(part == k, 3))
        rest = total.minus(sums([a[own] for a in design], [b[own] for b in state.right]))
        for i, width in enumerate((len(state.precision), len(precision))):
            beta = coefficients(rest.part(np.arange(width)), precision[:width, :width], sigma)
            for a, b, scale in zip(design, state.right, (sigma.position, sigma.rotation), strict=False):
                left = (b[own] - a[own, :width] @ beta) / scale
                loss[i, part == k] += np.sum(left.reshape(-1, 3) ** 2, axis=1)
    return loss


def _robust(bench: Bench, state: State, candidate: Active, cluster: np.ndarray) -> float:
    """p-value of a candidate when the numbers of one cluster of rows may err together: a cluster-robust score test.

    Args:
        bench: The linearised model.
        state: The model without it.
        candidate: What is added.
        cluster: Number of the cluster of each row in use, shape (n,).
    """
    scale = (1.0 / state.solution.sigma.position, 1.0 / state.solution.sigma.rotation)
    A = np.vstack([a * f for a, f in zip(state.design, scale, strict=False)])
    C = np.vstack([c * f for c, f in zip(state.flat(bench.columns(candidate.effect)), scale, strict=False)])
    C = C - A @ (state.solution.inverse @ (A.T @ C))
    C = C[:, np.linalg.norm(C, axis=0) > 1e-9]
    r = np.concatenate([f * b.ravel() for b, f in zip(apart(state.residual[state.weight > 0.5]), scale, strict=False)])
    after = r - C @ np.linalg.lstsq(C, r, rcond=None)[0]
    n, d = int(cluster.max()) + 1, C.shape[1]
    if n <= d + 2:
        return 1.0
    pulls = np.zeros((n, d))
    np.add.at(pulls, np.tile(np.repeat(cluster, 3), len(state.design)), C * after[:, None])
    s = C.T @ r
    spread = pulls.T @ pulls * n / (n - 1)
    statistic = float(s @ np.linalg.pinv(spread, hermitian=True) @ s) / d * (n - d) / n
    return float(f_distribution.sf(statistic, d, n - d))
