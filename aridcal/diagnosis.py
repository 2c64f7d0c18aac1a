"""From residual to effect: what the model lacks, added and refitted, and what is left when nothing more has a name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from aridcal.bench import Active, Bench, State, activate, solve_state
from aridcal.campaign import Campaign
from aridcal.catalogue import Barred, Scene, barred_joints, candidates, declared, pair, usable_columns
from aridcal.effects import Basis, Coefficient, Effect, Surroundings, covariate_table, evaluate
from aridcal.evidence import Kernel
from aridcal.identifiable import identifiable
from aridcal.measurements import Measurements, blocks
from aridcal.model import Model
from aridcal.residual import Observations, linearise, predict_residuals, scaled, triangle
from aridcal.scan import pairs
from aridcal.scoring import admitted
from aridcal.search import Found, is_small, rank, search, twins
from aridcal.solver import Data, Fit, Noise, Prior, fit, flag, thin
from aridcal.source import Kind

FOLDS = 5
RUNS = 24  # stretches of time into which the rows are cut
GAUGE = 0.05  # [m] and [rad]: constants are held at the geometric stage this loosely, where nothing else decides
ROUNDS = 3
SEARCHED = 2000  # rows at the most that are searched
MOST_LARGE = 4
RIVALS = 5
LARGE = 100.0  # nats in favour of an effect that is worth comparing on the exact model
UNNAMED = 6  # effects without a name that are added at the most


@dataclass(frozen=True)
class Bound:
    """What is needed to rebuild a model for other effects: constants, their start, rows and measured poses."""

    geometric: Fit
    train: Measurements
    measured: Observations
    suspect: np.ndarray
    kinds: tuple[Kind, ...]

    def data(self, model: Model) -> Data:
        """The training rows as a model sees them."""
        rows = model.rows(self.train.readings, self.train.covariates, self.train.station)
        return Data(rows, self.measured, self.suspect)


@dataclass(frozen=True)
class Diagnosed:
    """The final model and how it came about.

    Attributes:
        fit: Constants and effects, fitted together on the exact model.
        linearised_at: Where the model was linearised for the last search.
        bench: That linearised model; of some of the training rows, if there are thousands.
        scene: The same rows' covariates.
        found: The search's result.
        confounded: For each active effect, the candidates that these data cannot tell from it.
        declared: Effects that the campaign states.
        barred: Candidates that could not be tested, and why.
    """

    fit: Fit
    linearised_at: Fit
    bench: Bench
    scene: Scene
    found: Found
    confounded: tuple[tuple[Effect, ...], ...]
    declared: tuple[Effect, ...]
    barred: tuple[Barred, ...]


def surroundings(campaign: Campaign, model: Model) -> Surroundings:
    """Gravity in the base frame and the payload's place, from the campaign and the geometric stage's frames."""
    gravity = campaign.robot.gravity
    lever = model.tip_target[0][1].translation
    if gravity == "world":
        vectors = [frame.rotation.T @ np.array([0.0, 0.0, -9.81]) for _, frame in model.world_base]
        return Surroundings(np.array(vectors) if len(vectors) > 1 else vectors[0], lever)
    return Surroundings(np.array(gravity, dtype=float), lever)


def diagnose(
    campaign: Campaign, bound: Bound, noise: Noise, progress: Callable[[str], None] = lambda _: None
) -> Diagnosed:
    """Find the effects that the geometric model lacks, and fit all together.

    Args:
        campaign: Which effects are declared, and which kinds may be sought.
        bound: The geometric stage and its rows.
        noise: Declared noise.
        progress: Called with what is being done.
    """
    every, bound = bound, _thinned(bound)
    geometric = bound.geometric
    scene, barred = look(bound)
    kinds = campaign.diagnosis.candidates if campaign.diagnosis.enabled else ()
    named = candidates(scene, tuple(k for k in kinds if k != "unknown"))
    unnamed = candidates(scene, ("unknown",)) if "unknown" in kinds else []
    stated = [declared(scene, d, str(campaign.path)) for d in campaign.effects]
    taken = {(e.kind, e.where, e.with_, e.by) for e in stated}
    named = [e for e in named if (e.kind, e.where, e.with_, e.by) not in taken]
    current = at = geometric
    library = [*named, *unnamed, *stated]
    bench = linear_bench(bound, current, (), library, scene)
    named = [e for e in named if bench.moves(e)]
    if named:
        progress(f"testing {len(named)} effects that have a name")
    state = solve_state(bench, (), current.sigma, current.weight)
    for effect in stated:
        state = solve_state(bench, (*state.active, admitted(bench, state, effect)), state.solution.sigma, state.weight)
    if is_small(bench, named):
        current, at, bench, state = _large_first(bound, bench, named, library, state, current, noise, scene)
    small = is_small(bench, named)
    fitted = _shapes(replace(state, active=()))
    for _ in range(ROUNDS if small else 1):
        found = search(bench, named, state)
        same = [a.effect for a in found.state.active] == [a.effect for a in state.active]
        state = found.state
        if not small or not state.active or (same and at is current and current is not geometric):
            break
        progress(f"fitting {len(state.active)} effects: {', '.join(a.effect.label for a in state.active[:4])}")
        current = at = refit(bound, state, current, noise)
        fitted = _shapes(state)
        bench = linear_bench(bound, at, state.active, library, scene)
        state = solve_state(bench, state.active, state.solution.sigma, state.weight)
    if unnamed:
        progress(f"testing {len(unnamed)} functions, then pairs, for what has no name")
        found = _unnamed(bench, unnamed, found, scene)
        if len(found.state.active) > len(state.active):  # what only imitated it is not missed any more
            found = replace(search(bench, named, found.state, 0), rejected=found.rejected, tested=found.tested)
        state = found.state
    if _shapes(state) != fitted:
        progress(f"fitting {len(state.active)} effects: {', '.join(a.effect.label for a in state.active[:4])}")
        current = refit(bound, state, current, noise)
    if len(every.train) > len(bound.train):
        progress(f"fitting all {len(every.train)} rows")
        current = _widened(every, state, current, noise)
    return Diagnosed(current, at, bench, scene, found, twins(bench, named, state), tuple(stated), tuple(barred))


def _thinned(bound: Bound) -> Bound:
    """Enough rows to search with: an effect that matters shows in these, and every trial costs as many as there are."""
    some = thin(bound.data(bound.geometric.model).rows, SEARCHED)
    if len(some) == len(bound.train):
        return bound
    chosen = np.zeros(len(bound.train), dtype=bool)
    chosen[some] = True
    g = bound.geometric
    geometric = replace(g, weight=g.weight[some], residual=g.residual[some])
    return replace(bound, geometric=geometric, train=bound.train.select(chosen), measured=bound.measured[some],
                   suspect=bound.suspect[some])  # fmt: skip


def _widened(bound: Bound, state: State, current: Fit, noise: Noise) -> Fit:
    """What was found on some of the rows, fitted to all of them."""
    if not state.active:
        return bound.geometric
    data = bound.data(current.model)
    residual = scaled(predict_residuals(current.model, current.theta, data.rows, data.measured), data.measured)
    constants = tuple(c for c in current.model.coefficients if c.basis.constant)
    return _refit(bound, constants, replace(state, weight=flag(residual, bound.suspect)), current, noise)


def _unnamed(bench: Bench, unnamed: Sequence[Effect], named: Found, scene: Scene) -> Found:
    """Smooth functions of one covariate, and then of two, for what no kind of effect explains."""
    more = search(bench, unnamed, named.state, UNNAMED)
    rejected, tested = named.rejected + more.rejected[:1], named.tested + more.tested
    for k in range(UNNAMED // 2):
        before = more.state
        places, looked = pairs(bench, before, scene.anything())
        library = [pair(scene, *place) for place in places]
        more = search(bench.prepare(library), library, before, 1, looked)
        tested += looked if k == 0 else 0
        if len(more.state.active) == len(before.active):
            break
    return Found(more.state, rejected, tested)


def _shapes(state: State) -> list[tuple[Effect, float, Kernel]]:
    """The effects of a state, smooth ones with their shape."""
    return [(a.effect, a.score.tau, a.score.kernel) for a in state.active]


def _large_first(
    bound: Bound,
    bench: Bench,
    named: Sequence[Effect],
    library: Sequence[Effect],
    state: State,
    current: Fit,
    noise: Noise,
    scene: Scene,
) -> tuple[Fit, Fit, Bench, State]:
    """Take effects so large that they bend the constants: rivals are compared on the exact model, not the linear one."""
    at = current
    for _ in range(MOST_LARGE):
        ranked = rank(bench, named, state)
        top = ranked[0][1].gain if ranked else 0.0
        rivals = {
            (e.kind, e.where, e.motion): (e, s) for e, s in reversed(ranked[:RIVALS]) if s.gain > max(LARGE, top / 2)
        }
        best: tuple[float, Fit, State] | None = None
        for effect, found in reversed(rivals.values()):
            trial = solve_state(
                bench, (*state.active, activate(bench, state, effect, found)), state.solution.sigma, state.weight
            )
            fitted = refit(bound, trial, current, noise)
            worth = -0.5 * found.freedom * (1.0 + np.log(max(2.0 * found.gain / max(found.freedom, 1), 1.0)))
            worth -= float(trial.sums.count @ np.log([fitted.estimated.position, fitted.estimated.rotation]))
            if best is None or worth > best[0]:
                best = worth, fitted, trial
        if best is None:
            break
        current = at = best[1]
        bench = linear_bench(bound, at, best[2].active, library, scene)
        state = solve_state(bench, best[2].active, current.sigma, best[2].weight)
    return current, at, bench, state


def look(bound: Bound) -> tuple[Scene, list[Barred]]:
    """What candidates can be made from, and what cannot be tested."""
    usable, barred = usable_columns(bound.train.covariates)
    scene = rows_of(bound, usable)
    return scene, barred + barred_joints(scene)


def rows_of(bound: Bound, measured: Sequence[str]) -> Scene:
    """Covariates of some rows: readings, loads and the measured columns named."""
    model, rows = bound.geometric.model, bound.train
    world = model.rows(rows.readings, None, rows.station).world
    columns = {name: rows.covariates[name] for name in measured}
    table = covariate_table(model.robot, rows.readings, columns, model.around, world, {".gravity_", ".payload_"})
    return Scene(model.robot, table, tuple(measured))


def linear_bench(
    bound: Bound, current: Fit, active: Sequence[Active], library: Sequence[Effect], scene: Scene
) -> Bench:
    """Linearise the current model, and the places where the library's effects act."""
    effects = list(dict.fromkeys([*library, *(a.effect for a in active)]))
    slots = tuple(dict.fromkeys((c.where, c.component) for e in effects for c in e.coefficients))
    bases = tuple(dict.fromkeys(c.basis for e in effects for c in e.coefficients))
    ones = Basis("ones", (scene.robot.names[0],))
    places = tuple(Coefficient(where, component, ones) for where, component in slots)
    model = current.model.with_coefficients((*current.model.coefficients, *places))
    theta = np.concatenate([current.theta, np.zeros(len(places))])
    data = bound.data(model)
    r, J = linearise(model, theta, data.rows, data.measured)
    constant = np.array([c.basis.constant for c in current.model.coefficients], dtype=bool)
    K = len(constant)
    known = dict(zip(bound.geometric.model.names, bound.geometric.theta, strict=True))
    start = np.array([known.get(name, 0.0) for name in current.model.names])
    r = r + J[:, :, :K] @ (current.theta - start)
    phi = np.column_stack([evaluate(b, scene.table) for b in bases]) if bases else np.zeros((len(r), 0))
    run, fold = _folds(bound)
    A, G = (np.ascontiguousarray(J[:, :, k]) for k in (np.flatnonzero(constant), slice(K, None)))
    gauge = np.eye(A.shape[2]) / GAUGE**2
    return Bench(A, gauge, G, slots, phi, bases, r, bound.suspect, run, fold, scene.robot.names, scene.table)


def refit(bound: Bound, state: State, current: Fit, noise: Noise) -> Fit:
    """Fit constants and effects together on the exact model, the constants gauged to the geometric stage.

    Constants that the geometric stage could not tell apart, its residual being large, are taken in when they can be now.
    """
    constants = tuple(c for c in current.model.coefficients if c.basis.constant)
    found = _refit(bound, constants, state, current, noise)
    more = _regained(bound, found)
    return _refit(bound, constants + more, state, found, noise) if more else found


def _refit(bound: Bound, constants: tuple[Coefficient, ...], state: State, current: Fit, noise: Noise) -> Fit:
    geometric = bound.geometric
    model = geometric.model.with_coefficients(constants + tuple(c for a in state.active for c in a.effect.coefficients))
    known = dict(zip(current.model.names, current.theta, strict=True))
    theta = np.array([known.get(name, 0.0) for name in model.names])
    precision = np.zeros((len(theta), len(theta)))
    mean = np.zeros(len(theta))
    before = dict(zip(geometric.model.names, geometric.theta, strict=True))
    at = len(constants)
    precision[:at, :at] = np.eye(at) / GAUGE**2
    mean[:at] = [before.get(name, 0.0) for name in model.names[:at]]
    basis = block_diag(np.eye(at), *(a.root for a in state.active))
    for a in state.active:
        d = len(a.effect.coefficients)
        precision[at : at + d, at : at + d] = a.coefficient_precision
        at += d
    found = fit(model, bound.data(model), noise, theta, state.weight, Prior(mean, precision, basis))
    redundant = {name: why for name, why in geometric.redundant.items() if name not in model.names}
    return replace(found, candidates=geometric.candidates, redundant=redundant)


def _regained(bound: Bound, found: Fit) -> tuple[Coefficient, ...]:
    """Constants that were given up in the geometric stage and can be told apart from all else now."""
    dropped = tuple(c for c in found.candidates if c.name in found.redundant)
    if not dropped:
        return ()
    model = found.model.with_coefficients(found.model.coefficients + dropped)
    theta = np.concatenate([found.theta, np.zeros(len(dropped))])
    data = bound.data(model)
    R = triangle(model, theta, data.rows, data.measured, found.weight, found.sigma)
    kept = identifiable(R, range(len(theta))).kept
    return tuple(c for k, c in enumerate(model.coefficients) if k >= len(found.theta) and k in kept)


def _folds(bound: Bound) -> tuple[np.ndarray, np.ndarray]:
    """Stretches of time, and folds that keep repeats, stations and stretches together where they can."""
    n = len(bound.train)
    time = bound.train.covariates.get("time")
    order = np.argsort(time, kind="stable") if time is not None and not np.isnan(time).any() else np.arange(n)
    run = np.empty(n, dtype=int)
    run[order] = np.arange(n) * min(RUNS, n) // n
    block = blocks(bound.train.readings, bound.kinds)
    number = np.random.default_rng(0).permutation(int(block.max()) + 1)
    return run, number[block] % FOLDS
