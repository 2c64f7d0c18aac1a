"""Which effects the residual asks for: every candidate scored at once, winners refitted, losers tried again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import f as f_distribution

from aridcal.catalogue import turns
from aridcal.effects import Basis, Effect, evaluate
from aridcal.evidence import (
    SMOOTH_PRICE,
    Score,
    Solution,
    Sums,
    extended,
    kernel_root,
    score,
    shaped,
    smooth_precision,
    solve,
    sums,
    tail,
)
from aridcal.residual import Sigma
from aridcal.solver import flag

ALPHA = 1e-3  # chance that a clean campaign shows any effect at all, by these tests alone
LEAST = 1e-2  # share of the squared error, on rows held back, that an effect must take away to matter
ROBUST = 1e-3  # the same chance for one candidate when residuals of neighbouring rows may be alike
CLOSE = 3.0  # nats by which another candidate may be worse and still not be told from the one named
RANKED = 12  # candidates that are looked at closely
REFINED = 6
JUDGED = 4
PLAIN = 100.0  # nats in an effect's favour beyond which it needs no further trial
FAINT = 0.02  # a mode that the data could move by less than this share of its prior is left out
MOST = 14
FOLDS = 5
SCANNED = 800  # orders of a joint's error that are looked through, a quarter period over its range apart
MAPPED = 30.0  # highest order that a joint_map resolves
LOUD = 30.0  # chi-square of a harmonic that is worth a closer look
CHUNK = 128
SHAPINGS = 4  # times that shape and noise of a smooth function are found in turn, at the most


@dataclass(frozen=True)
class Bench:
    """A linearised model and everything that could be added to it.

    Attributes:
        A: Columns of the constants, shape (N, m, K), in units of the rows' relative sigmas.
        G: Columns of the places where effects may act, shape (N, m, S).
        slots: (where, component) of each, S of them.
        phi: Values of the bases, shape (N, B).
        bases: The bases, B of them.
        r: Residual of the model without effects, shape (N, m).
        suspect: Rows that repeat another's measurement although the joints moved.
        run: Number of the row's stretch of time, shape (N,).
        fold: Number of the row's fold for cross-validation, shape (N,).
        own: Names of the joints: covariates that are under the user's control.
        table: Covariates of the rows, shape (N,) each.
    """

    A: np.ndarray
    G: np.ndarray
    slots: tuple[tuple[str, str], ...]
    phi: np.ndarray
    bases: tuple[Basis, ...]
    r: np.ndarray
    suspect: np.ndarray
    run: np.ndarray
    fold: np.ndarray
    own: tuple[str, ...]
    table: Mapping[str, np.ndarray]

    @cached_property
    def _slot(self) -> dict[tuple[str, str], int]:
        return {slot: k for k, slot in enumerate(self.slots)}

    @cached_property
    def _basis(self) -> dict[Basis, int]:
        return {basis: k for k, basis in enumerate(self.bases)}

    def indices(self, effect: Effect) -> tuple[list[int], list[int]]:
        """Place and basis of each of an effect's coefficients."""
        slots = [self._slot[c.where, c.component] for c in effect.coefficients]
        return slots, [self._basis[c.basis] for c in effect.coefficients]

    def prepared(self, effect: Effect) -> bool:
        """True if all its bases are among ``bases``."""
        return all(c.basis in self._basis for c in effect.coefficients)

    def moves(self, effect: Effect) -> bool:
        """True if each of its motions is seen at all: a turn of the target is not, where only positions are measured."""
        return all(bool(np.any(self.G[:, :, self._slot[c.where, c.component]])) for c in effect.coefficients)

    def columns(self, effect: Effect) -> np.ndarray:
        """Columns of an effect, shape (N, m, d)."""
        slots = [self._slot[c.where, c.component] for c in effect.coefficients]
        if self.prepared(effect):
            phi = self.phi[:, self.indices(effect)[1]]
        else:
            phi = np.column_stack([evaluate(c.basis, self.table) for c in effect.coefficients])
        return np.asarray(self.G[:, :, slots] * phi[:, None, :])


@dataclass(frozen=True)
class Active:
    """An effect that is in the model; a smooth one by the modes that its data can tell, each with unit prior.

    Attributes:
        effect: The effect.
        score: Its evidence, and its shape if it is smooth.
        modes: Coefficients of each mode, shape (d, modes); None for the coefficients themselves.
    """

    effect: Effect
    score: Score
    modes: np.ndarray | None = None

    @property
    def precision(self) -> np.ndarray:
        """Prior precision of what is solved for."""
        if self.modes is None:
            return np.zeros((len(self.effect.coefficients),) * 2)
        return np.eye(self.modes.shape[1])

    @property
    def coefficient_precision(self) -> np.ndarray:
        """Prior precision of its coefficients, shape (d, d)."""
        d = len(self.effect.coefficients)
        return (
            smooth_precision(self.effect.shape, self.score.tau, self.score.kernel)
            if self.effect.smooth
            else np.zeros((d, d))
        )

    def columns(self, bench: Bench) -> np.ndarray:
        """Its columns, shape (N, m, d or modes)."""
        columns = bench.columns(self.effect)
        return columns if self.modes is None else columns @ self.modes


@dataclass(frozen=True)
class State:
    """A solved set of effects."""

    active: tuple[Active, ...]
    design: tuple[np.ndarray, ...]  # rows in use times root weight, positions and rotations apart, (3n, P) each
    right: tuple[np.ndarray, ...]
    precision: np.ndarray
    sums: Sums
    solution: Solution
    residual: np.ndarray
    weight: np.ndarray
    fold: np.ndarray

    @cached_property
    def folds(self) -> list[tuple[np.ndarray, Sums]]:
        """Rows of the flattened design in each fold, and their sums."""
        found = []
        for k in np.unique(self.fold):
            own = np.flatnonzero(np.repeat(self.fold == k, 3))
            found.append((own, sums([a[own] for a in self.design], [b[own] for b in self.right])))
        return found

    def flat(self, columns: np.ndarray) -> list[np.ndarray]:
        """Columns (N, m, d) brought to the design's shape."""
        used = self.weight > 0.5
        return [
            columns[used, 3 * k : 3 * k + 3].reshape(3 * used.sum(), columns.shape[2])
            for k in range(self.residual.shape[1] // 3)
        ]


@dataclass(frozen=True)
class Verdict:
    """How a candidate fared: accepted, or why not."""

    effect: Effect
    score: Score
    p_value: float
    gain_held_back: float
    why: str


@dataclass(frozen=True)
class Found:
    """The effects found.

    Attributes:
        state: The final set.
        rejected: The best of those that were not taken, and why.
        tested: Number of candidates.
    """

    state: State
    rejected: tuple[Verdict, ...]
    tested: int


def search(bench: Bench, library: Sequence[Effect], start: State, most: int = MOST) -> Found:
    """Add effects one at a time, test again what was taken and what was not, until nothing more is worth it.

    Args:
        bench: The linearised model.
        library: All candidates.
        start: Effects to begin with; see :func:`solve_state`.
        most: Effects to add at the most.
    """
    state, most = start, most + len(start.active)
    rejected: tuple[Verdict, ...] = ()
    small = is_small(bench, library)
    for _ in range(4 if small else 1):
        state, rejected = _forward(bench, library, state, most, small)
        tidied = _tidy(bench, library, state, 2 if small else 1)
        same = [a.effect for a in tidied.active] == [a.effect for a in state.active]
        state = tidied
        if same:
            break
    return Found(state, rejected, len(library))


def is_small(bench: Bench, library: Sequence[Effect]) -> bool:
    """True where every choice can be tried again after each step in little time."""
    return bench.r.size * len(library) < 1e6 and not any(e.kind == "unknown" for e in library)


def twins(bench: Bench, library: Sequence[Effect], state: State) -> tuple[tuple[Effect, ...], ...]:
    """For each effect, the candidates that would do about as well in its place."""
    small = is_small(bench, library)
    return tuple(
        _twins(bench, library, state, k) if small or not a.effect.smooth else () for k, a in enumerate(state.active)
    )


def solve_state(bench: Bench, active: Sequence[Active], sigma: Sigma, weight: np.ndarray) -> State:
    """Solve a set of effects, noise and outlier flags with it."""
    design = np.concatenate([bench.A, *(a.columns(bench) for a in active)], axis=2)
    K = bench.A.shape[2]
    precision = block_diag(np.zeros((K, K)), *(a.precision for a in active))
    flags = weight
    for _ in range(6):
        weight = flags
        used = weight > 0.5
        parts = range(bench.r.shape[1] // 3)
        A = tuple(design[used, 3 * k : 3 * k + 3].reshape(3 * used.sum(), design.shape[2]) for k in parts)
        b = tuple(bench.r[used, 3 * k : 3 * k + 3].ravel() for k in parts)
        gram = sums(A, b)
        solution = solve(gram, precision, sigma)
        residual = bench.r - design @ solution.beta
        sigma = solution.sigma
        flags = flag(residual, bench.suspect)
        if np.array_equal(flags, weight):
            break
    return State(tuple(active), A, b, precision, gram, solution, residual, weight, bench.fold[used])


def activate(bench: Bench, state: State, effect: Effect, found: Score) -> Active:
    """Make a candidate ready to be solved for."""
    if not effect.smooth:
        return Active(effect, found)
    root, noise = kernel_root(effect.shape, found.kernel), found.sigma or state.solution.sigma
    sigma = np.repeat([noise.position, noise.rotation], 3)[: bench.r.shape[1]]
    C = bench.columns(effect) / sigma[:, None]
    U, s, _ = np.linalg.svd(root * found.tau, full_matrices=False)
    seen = s**2 * float(np.einsum("nmd,nmd->", C, C)) / C.shape[2]
    return Active(effect, found, (U * s)[:, seen > FAINT])


def admitted(bench: Bench, state: State, effect: Effect) -> Active:
    """An effect that is taken without trial, with the shape that suits the data if it is smooth."""
    return activate(bench, state, effect, _refine(bench, state, effect, _scores(bench, [effect], state)[0]))


def rank(bench: Bench, library: Sequence[Effect], state: State, scan: bool = False) -> list[tuple[Effect, Score]]:
    """Score every candidate that is not in the model; the best first, the first few with their noise apart."""
    taken = {a.effect for a in state.active}
    kinds = {e.kind for e in library}
    mapped = {e.where for e in taken if e.kind == "joint_map"}
    scanned = _scanned(bench, state) if scan and "joint_harmonic" in kinds else []
    free = [e for e in (*library, *scanned) if e not in taken and not (e.where in mapped and _in_a_map(e))]
    scores = _scores(bench, free, state)
    order = sorted(range(len(free)), key=lambda k: -scores[k].gain)
    enough = 0.4 * scores[order[0]].gain if order else 0.0
    head = [free[k] for k in order if scores[k].gain > max(enough, 0.0)][:REFINED]
    rough = dict(zip(free, scores, strict=True))
    refined = sorted(((e, _refine(bench, state, e, rough[e])) for e in head), key=lambda pair: -pair[1].gain)
    return refined + [(free[k], scores[k]) for k in order if free[k] not in head]


def _in_a_map(effect: Effect) -> bool:
    """True for functions of a joint's own reading that a joint_map of the same joint holds already."""
    return effect.kind == "joint_gain" or (effect.kind == "joint_harmonic" and max(effect.order) < MAPPED)


def _forward(
    bench: Bench, library: Sequence[Effect], state: State, most: int, small: bool
) -> tuple[State, tuple[Verdict, ...]]:
    rejected: tuple[Verdict, ...] = ()
    seen = {frozenset(a.effect for a in state.active)}
    while len(state.active) < most:
        ranked = rank(bench, library, state, scan=True)
        verdicts = []
        chosen = None
        for effect, found in ranked[:JUDGED]:
            verdict = _judge(bench, state, effect, found, len(library))
            if not verdict.why:
                chosen = activate(bench, state, effect, found)
                break
            verdicts.append(verdict)
            if verdict.p_value > ALPHA:
                break
        rejected = tuple(verdicts)
        if chosen is None:
            break
        state = solve_state(bench, (*state.active, chosen), state.solution.sigma, state.weight)
        if small and len(state.active) > 1:
            state = _tidy(bench, library, state, 1)
        if frozenset(a.effect for a in state.active) in seen:
            break  # what is added is taken out again: this goes round in circles
        seen.add(frozenset(a.effect for a in state.active))
    return state, rejected


def _tidy(bench: Bench, library: Sequence[Effect], state: State, rounds: int) -> State:
    """Take each effect out in turn: drop it if it is not missed, exchange it if another does better in its place."""
    kinds = {e.kind for e in library}
    # Harmonics of an order of their own are no part of the library, but are tried again like all else.
    library = list(dict.fromkeys([*library, *(a.effect for a in state.active if a.effect.kind in kinds)]))
    known = set(library)
    for _ in range(rounds):
        before = [a.effect for a in state.active]
        for effect in before:
            active = [a for a in state.active if a.effect != effect]
            if len(active) == len(state.active) or effect not in known:
                continue
            without = solve_state(bench, active, state.solution.sigma, state.weight)
            ranked = rank(bench, library, without)
            mine = next(s for e, s in ranked if e == effect)
            best, its = ranked[0]
            if best == effect or its.gain < mine.gain + 1.0:
                best, its = effect, mine
            keep = its.gain > PLAIN or not _judge(bench, without, best, its, len(library)).why
            taken = (*active, activate(bench, without, best, its)) if keep else active
            state = solve_state(bench, taken, without.solution.sigma, without.weight)
        if [a.effect for a in state.active] == before:
            break
    return state


def _judge(bench: Bench, state: State, effect: Effect, found: Score, tested: int) -> Verdict:
    """Accept a candidate, or say why not."""
    p_value = min(1.0, found.p_value * tested)

    def verdict(held_back: float, why: str) -> Verdict:
        return Verdict(effect, found, p_value, held_back, why)

    if found.gain <= 0.0 or p_value > ALPHA:
        return verdict(0.0, f"chance would do as well (p = {p_value:.2g} among {tested} candidates)")
    held_back = _held_back(bench, state, activate(bench, state, effect, found))
    same = any((a.effect.kind, a.effect.where) == (effect.kind, effect.where) for a in state.active)
    if held_back < (0.0 if same else LEAST):
        return verdict(
            held_back, f"takes only {100 * max(held_back, 0.0):.2g} % off the squared error of rows held back"
        )
    if not set(_sources(effect)) <= set(bench.own):
        robust = _robust(bench, state, effect)
        if robust > ROBUST:
            return verdict(held_back, f"seen in too few stretches of time to be believed (p = {robust:.2g})")
    return verdict(held_back, "")


def _sources(effect: Effect) -> list[str]:
    return [name.split(".")[0] if ".gravity_" in name else name for name in effect.covariates]


def _scores(bench: Bench, effects: Sequence[Effect], state: State) -> list[Score]:
    used = state.weight > 0.5
    scale = (1.0 / state.solution.sigma.position, 1.0 / state.solution.sigma.rotation)
    A = np.vstack([a * f for a, f in zip(state.design, scale, strict=False)])
    r = np.concatenate([f * b.ravel() for b, f in zip(_parts(state.residual[used]), scale, strict=False)])
    left, count = float(r @ r), float(state.sums.count.sum())
    G, phi = [g * f for g, f in zip(_parts(bench.G[used]), scale, strict=False)], bench.phi[used]
    found: list[Score] = []
    for group in _chunks(effects):
        ends = np.cumsum([0, *(len(e.coefficients) for e in group)])
        if all(bench.prepared(e) for e in group):
            pairs = [bench.indices(e) for e in group]
            slots, bases = [k for pair in pairs for k in pair[0]], [k for pair in pairs for k in pair[1]]
            C = np.vstack([(g[:, :, slots] * phi[:, None, bases]).reshape(-1, len(slots)) for g in G])
        else:
            some = np.concatenate([bench.columns(e)[used] for e in group], axis=2)
            C = np.vstack([(c * f).reshape(-1, some.shape[2]) for c, f in zip(_parts(some), scale, strict=False)])
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


def _scanned(bench: Bench, state: State) -> list[Effect]:
    """Harmonics of any order that the residual hints at: a periodogram over each joint's reading."""
    sigma = np.repeat([state.solution.sigma.position, state.solution.sigma.rotation], 3)[: bench.r.shape[1]]
    used = state.weight > 0.5
    found = []
    for name in bench.own:
        q = bench.table[name][used]
        if (name, "axis") not in bench.slots or np.ptp(q) < 1e-3:
            continue
        place = bench.G[used][:, :, bench.slots.index((name, "axis"))] / sigma
        weight, pull = np.sum(place**2, axis=1), np.sum(place * state.residual[used] / sigma, axis=1)
        pull = pull - weight * pull.sum() / max(weight.sum(), 1e-300)
        orders = np.arange(1, SCANNED + 1) * np.pi / (2 * np.ptp(q))

        def power(
            k: np.ndarray, q: np.ndarray = q, pull: np.ndarray = pull, w: float = float(weight.sum())
        ) -> np.ndarray:
            return np.asarray(2.0 * np.abs(np.exp(1j * np.outer(k, q)) @ pull) ** 2 / w)

        seen = power(orders)
        peaks = np.flatnonzero((seen > np.roll(seen, 1)) & (seen > np.roll(seen, -1)) & (seen > LOUD))
        for peak in peaks[np.argsort(-seen[peaks])][:2]:
            fine = orders[peak] + np.linspace(-1, 1, 81) * (orders[1] - orders[0])
            order = float(fine[np.argmax(power(fine))])
            whole = round(order)
            order = float(whole) if abs(order - whole) < 0.05 else round(order, 3)
            found.append(Effect("joint_harmonic", name, turns(name, "axis", name, order), (order,)))
    return found


def _parts(values: np.ndarray) -> list[np.ndarray]:
    """Positions and rotations of an array (N, m, ...)."""
    return [values[:, 3 * k : 3 * k + 3] for k in range(values.shape[1] // 3)]


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


def _refine(bench: Bench, state: State, effect: Effect, rough: Score) -> Score:
    """The same score with the noise of positions and rotations estimated apart, with the candidate in."""
    if effect.smooth:
        return _reshaped(bench, state, effect, rough)
    candidate = activate(bench, state, effect, rough)
    with_it, precision = _with(bench, state, candidate)
    twice = 2.0 * (solve(with_it, precision, state.solution.sigma).likelihood - state.solution.likelihood)
    d = rough.freedom
    gain = 0.5 * (twice - d * (1.0 + np.log(max(twice / d, 1.0))))
    return replace(rough, gain=gain, p_value=tail(twice, d))


def _reshaped(bench: Bench, state: State, effect: Effect, rough: Score) -> Score:
    """Shape and noise of a smooth function in turn, until they agree: what it hides makes the noise look large."""
    total = extended(state.sums, state.design, state.flat(bench.columns(effect)), state.right)
    K, found = len(state.precision), rough
    for _ in range(SHAPINGS):
        candidate = activate(bench, state, effect, found)
        modes = block_diag(np.eye(K), candidate.modes)
        solution = solve(total.combined(modes), block_diag(state.precision, candidate.precision), state.solution.sigma)
        if found.sigma is not None and abs(np.log(found.sigma.position / solution.sigma.position)) < 0.02:
            break
        found = shaped(total, state.precision, effect.shape, solution.sigma)
    twice = 2.0 * (solution.likelihood - state.solution.likelihood)
    twice += float(np.linalg.slogdet(solution.inverse[K:, K:])[1])
    return replace(found, gain=0.5 * twice - SMOOTH_PRICE, p_value=float(np.exp(-max(0.5 * twice, 0.0))))


def _with(bench: Bench, state: State, candidate: Active) -> tuple[Sums, np.ndarray]:
    """Sums of the model with a candidate added, and the prior precision of all its coefficients."""
    C = state.flat(candidate.columns(bench))
    return extended(state.sums, state.design, C, state.right), block_diag(state.precision, candidate.precision)


def _held_back(bench: Bench, state: State, candidate: Active) -> float:
    """Share of the squared error that a candidate takes away on rows held back, fold by fold."""
    total, precision = _with(bench, state, candidate)
    sigma = solve(total, precision, state.solution.sigma).sigma
    C = state.flat(candidate.columns(bench))
    variance = np.array([sigma.position, sigma.rotation]) ** 2
    loss = np.zeros(2)
    for own, known in state.folds:
        held = extended(
            known, [a[own] for a in state.design], [c[own] for c in C], [b[own] for b in state.right]
        )  # fmt: skip
        rest = total.minus(held)
        for i, width in enumerate((len(state.precision), len(precision))):
            keep = np.arange(width)
            beta = solve(rest.part(keep), precision[:width, :width], sigma, fixed=True).beta
            part = held.part(keep)
            square = part.rr - 2 * part.Ar @ beta + np.einsum("i,kij,j->k", beta, part.AA, beta)
            loss[i] += float(np.sum(square / variance))
    return float(1.0 - loss[1] / loss[0])


def _robust(bench: Bench, state: State, effect: Effect) -> float:
    """p-value of a candidate when rows of one stretch of time may err together (cluster-robust score test)."""
    used = state.weight > 0.5
    scale = (1.0 / state.solution.sigma.position, 1.0 / state.solution.sigma.rotation)
    A = np.vstack([a * f for a, f in zip(state.design, scale, strict=False)])
    C = np.vstack([c * f for c, f in zip(state.flat(bench.columns(effect)), scale, strict=False)])
    C = C - A @ (state.solution.inverse @ (A.T @ C))
    C = C[:, np.linalg.norm(C, axis=0) > 1e-9]
    r = np.concatenate([f * b.ravel() for b, f in zip(_parts(state.residual[used]), scale, strict=False)])
    after = r - C @ np.linalg.lstsq(C, r, rcond=None)[0]
    run = np.tile(np.repeat(bench.run[used], 3), len(state.design))
    runs, d = int(bench.run.max()) + 1, C.shape[1]
    if runs <= d + 2:
        return 1.0
    clusters = np.zeros((runs, d))
    np.add.at(clusters, run, C * after[:, None])
    s = C.T @ r
    spread = clusters.T @ clusters * runs / (runs - 1)
    statistic = float(s @ np.linalg.pinv(spread, hermitian=True) @ s) / d * (runs - d) / runs
    return float(f_distribution.sf(statistic, d, runs - d))


def _twins(bench: Bench, library: Sequence[Effect], state: State, k: int) -> tuple[Effect, ...]:
    """Candidates that would do about as well in the place of one of the effects."""
    mine = state.active[k]
    active = [a for a in state.active if a is not mine]
    without = solve_state(bench, active, state.solution.sigma, state.weight)
    ranked = rank(bench, library, without)
    own = next((s for e, s in ranked if e == mine.effect), None)
    if own is None:
        return ()
    name = (mine.effect.kind, mine.effect.where, mine.effect.with_, mine.effect.by)
    twins: dict[tuple[object, ...], Effect] = {}
    for effect, found in ranked[:RANKED]:
        other = (effect.kind, effect.where, effect.with_, effect.by)
        if found.gain > own.gain - CLOSE and other != name:
            twins.setdefault(other, effect)
    return tuple(twins.values())
