"""From residual to effect: what the model lacks, added and refitted, and what is left when nothing more has a name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from aridcal.effects.basis import Basis, evaluate
from aridcal.effects.catalogue import KINDS, Barred, barred_joints, candidates, declared, usable_columns
from aridcal.effects.effect import Coefficient, Effect
from aridcal.effects.kinds import Observed
from aridcal.effects.loads import covariate_table
from aridcal.effects.smooth import Kernel
from aridcal.effects.unknown_kind import pair
from aridcal.fit.identifiable import identifiable
from aridcal.fit.least_squares import Fit, Prior, fit, flagged, thin
from aridcal.fit.residual import problem, triangle
from aridcal.inputs.campaign import Campaign
from aridcal.inputs.dataset import Dataset
from aridcal.search.hints import pairs
from aridcal.search.linear_model import Active, LinearModel, State, activate, solve_state
from aridcal.search.scoring import admitted
from aridcal.search.stepwise import Found, is_small, rank, search, twins

FOLDS = 5
"""Parts that are held back in turn: as usual, and four fifths of the rows are enough to tell an effect."""

RUNS = 24
"""Stretches of time into which the rows are cut: enough for a test that takes each of them as one."""

GAUGE = 0.05
"""[m] and [rad]: constants are held at the geometric stage this loosely, where nothing else decides."""

ROUNDS = 3
"""Times that the model is linearised anew and searched, where that is cheap; two are usual."""

SEARCHED = 2000
"""Rows at the most that are searched: an effect that matters shows in these, and every trial costs as many as there are."""

MOST_LARGE = 4
"""Effects at the most that are chosen on the exact model."""

RIVALS = 5
"""Candidates that are compared there for each of them."""

LARGE = 100.0
"""[nat] in favour of an effect that is worth comparing on the exact model: it bends the constants."""

RIVAL_SHARE = 0.5
"""Share of the best evidence on the linear model that a rival must have: less cannot win on the exact one."""

PAIRED = 3
"""Functions of two covariates that are added at the most: each costs as much as all functions of one."""

UNNAMED = 6
"""Effects without a name that are added at the most: what is left then has no simple form."""


@dataclass(frozen=True)
class Diagnosed:
    """The final model and how it came about.

    Attributes:
        fit: Constants and effects, fitted together on the exact model.
        linearised_at: Where the model was linearised for the last search.
        linear: That linearised model; of some of the training rows, if there are thousands.
        observed: The same rows' covariates.
        found: The search's result.
        confounded: For each active effect, the candidates that are confounded with it in these data.
        declared: Effects that the campaign states.
        barred: Candidates that could not be tested, and why.
    """

    fit: Fit
    linearised_at: Fit
    linear: LinearModel
    observed: Observed
    found: Found
    confounded: tuple[tuple[Effect, ...], ...]
    declared: tuple[Effect, ...]
    barred: tuple[Barred, ...]


def diagnose(
    campaign: Campaign, geometric: Fit, train: Dataset, progress: Callable[[str], None] = lambda _: None
) -> Diagnosed:
    """Find the effects that the geometric model lacks, and fit all together.

    Args:
        campaign: Which effects are declared, and which kinds may be sought.
        geometric: The geometric stage.
        train: The rows that it was fitted to.
        progress: Called with what is being done.
    """
    start = _thinned(geometric, train)
    observed, barred = look(start)
    kinds = campaign.diagnosis.candidates if campaign.diagnosis.enabled else ()
    stated = [declared(observed, d, str(campaign.path)) for d in campaign.effects]
    taken = {_identity(e) for e in stated}
    named = [e for e in candidates(observed, tuple(k for k in kinds if KINDS[k].named)) if _identity(e) not in taken]
    unnamed = candidates(observed, tuple(k for k in kinds if not KINDS[k].named))
    library = [*named, *unnamed, *stated]
    place = Place(start.geometric, linear_model(start, start.geometric, (), library, observed))
    named = [e for e in named if place.linear.moves(e)]
    if named:
        progress(f"testing {len(named)} known effects")
    state = _with_declared(place, stated, start.geometric)
    if is_small(place.linear, named):
        place, state = _large_first(start, place, named, library, state, observed)
    place, current, found, fitted = _searched(start, place, named, library, state, observed, progress)
    state = found.state
    if unnamed:
        progress(f"testing {len(unnamed)} functions of unknown cause, then pairs")
        more = _unnamed(place.linear, unnamed, found, observed)
        if len(more.state.active) > len(state.active):  # what only imitated it is not missed any more
            again = search(place.linear, named, more.state, 0)
            more = replace(again, rejected=more.rejected, tested=more.tested)
        found, state = more, more.state
    if _shapes(state) != fitted:
        progress(_fitting(state))
        current = refit(start, state, current)
    if len(train) > len(start.train):
        progress(f"fitting all {len(train)} rows")
        current = _widened(Start(geometric, train), state, current)
    confounded = twins(place.linear, named, state)
    return Diagnosed(current, place.at, place.linear, observed, found, confounded, tuple(stated), tuple(barred))


@dataclass(frozen=True)
class Start:
    """Where a search begins: the geometric stage and the rows that it was fitted to."""

    geometric: Fit
    train: Dataset


@dataclass(frozen=True)
class Place:
    """Where the exact model was linearised, and what that gave."""

    at: Fit
    linear: LinearModel


def _identity(effect: Effect) -> tuple[object, ...]:
    """What makes two effects the same for a user."""
    return effect.kind, effect.where, effect.with_, effect.by


def _fitting(state: State) -> str:
    """Words for a refit."""
    count = len(state.active)
    return f"fitting {count} effect{'' if count == 1 else 's'}: {', '.join(a.effect.label for a in state.active[:4])}"


def _with_declared(place: Place, stated: Sequence[Effect], geometric: Fit) -> State:
    """The model with the declared effects, which need no evidence."""
    linear = place.linear
    state = solve_state(linear, (), geometric.sigma, ~geometric.outliers)
    for effect in stated:
        active = (*state.active, admitted(linear, state, effect))
        state = solve_state(linear, active, state.solution.sigma, state.used)
    return state


def _searched(
    start: Start,
    place: Place,
    named: Sequence[Effect],
    library: Sequence[Effect],
    state: State,
    observed: Observed,
    progress: Callable[[str], None],
) -> tuple[Place, Fit, Found, list[tuple[Effect, float, Kernel]]]:
    """Search, refit on the exact model and search again about that, until the same effects are found.

    Returns:
        Where the model was linearised last, the last refit, what was found, and the shapes that were fitted.
    """
    current = place.at
    small = is_small(place.linear, named)
    fitted = _shapes(replace(state, active=()))
    for _ in range(ROUNDS if small else 1):
        found = search(place.linear, named, state)
        same = [a.effect for a in found.state.active] == [a.effect for a in state.active]
        state = found.state
        settled = same and place.at is current and current is not start.geometric
        if not small or not state.active or settled:
            break
        progress(_fitting(state))
        current = refit(start, state, current)
        fitted = _shapes(state)
        place = Place(current, linear_model(start, current, state.active, library, observed))
        state = solve_state(place.linear, state.active, state.solution.sigma, state.used)
        found = replace(found, state=state)
    return place, current, found, fitted


def _thinned(geometric: Fit, train: Dataset) -> Start:
    """Enough rows to search with."""
    rows = geometric.model.rows(train.readings, train.covariates, train.station)
    some = thin(rows, SEARCHED)
    if len(some) == len(train):
        return Start(geometric, train)
    fewer = replace(geometric, weight=geometric.weight[some], residual=geometric.residual[some])
    return Start(fewer, train.select(some))


def _widened(every: Start, state: State, current: Fit) -> Fit:
    """What was found on some of the rows, fitted to all of them."""
    if not state.active:
        return every.geometric
    asked = problem(current.model, every.train)
    used = ~flagged(asked.scaled_residual(current.theta), every.train.channels, every.train.stale)
    constants = tuple(c for c in current.model.coefficients if c.basis.constant)
    return _refit(every, constants, replace(state, used=used), current)


def _unnamed(model: LinearModel, unnamed: Sequence[Effect], named: Found, observed: Observed) -> Found:
    """Smooth functions of one covariate, and then of two, for what no kind of effect explains."""
    more = search(model, unnamed, named.state, UNNAMED)
    rejected, tested = named.rejected + more.rejected[:1], named.tested + more.tested
    for k in range(PAIRED):
        before = more.state
        places, looked = pairs(model, before, observed.varying())
        library = [pair(observed, *place) for place in places]
        more = search(model.prepare(library), library, before, 1, looked)
        tested += looked if k == 0 else 0
        if len(more.state.active) == len(before.active):
            break
    return Found(more.state, rejected, tested)


def _shapes(state: State) -> list[tuple[Effect, float, Kernel]]:
    """The effects of a state, smooth ones with their shape."""
    return [(a.effect, a.score.tau, a.score.kernel) for a in state.active]


def _large_first(
    start: Start, place: Place, named: Sequence[Effect], library: Sequence[Effect], state: State, observed: Observed
) -> tuple[Place, State]:
    """Take effects so large that they bend the constants: rivals are compared on the exact model, not the linear one."""
    for _ in range(MOST_LARGE):
        best = _best_rival(start, place, named, state)
        if best is None:
            break
        fitted, trial = best
        place = Place(fitted, linear_model(start, fitted, trial.active, library, observed))
        state = solve_state(place.linear, trial.active, fitted.sigma, trial.used)
    return place, state


def _best_rival(start: Start, place: Place, named: Sequence[Effect], state: State) -> tuple[Fit, State] | None:
    """The large effect that explains most on the exact model, refitted with it; None if there is no large effect."""
    linear = place.linear
    ranked = rank(linear, named, state)
    top = ranked[0][1].gain if ranked else 0.0
    large = [(e, s) for e, s in ranked[:RIVALS] if s.gain > max(LARGE, RIVAL_SHARE * top)]
    rivals = {(e.kind, e.where, e.motion): (e, s) for e, s in reversed(large)}
    best: tuple[float, Fit, State] | None = None
    for effect, found in reversed(rivals.values()):
        active = (*state.active, activate(linear, state, effect, found))
        trial = solve_state(linear, active, state.solution.sigma, state.used)
        fitted = refit(start, trial, place.at)
        each = 2.0 * found.gain / max(found.freedom, 1)
        worth = -0.5 * found.freedom * (1.0 + np.log(max(each, 1.0)))
        worth -= float(trial.equations.count @ np.log(fitted.estimated))
        if best is None or worth > best[0]:
            best = worth, fitted, trial
    return None if best is None else best[1:]


def look(start: Start) -> tuple[Observed, list[Barred]]:
    """What candidates can be made from, and what cannot be tested."""
    model, rows = start.geometric.model, start.train
    derived = {name: rows.covariates[name] for name in rows.derived}
    usable, barred = usable_columns({name: v for name, v in rows.covariates.items() if name not in derived})
    world = model.rows(rows.readings, None, rows.station).world
    measured = {name: rows.covariates[name] for name in usable}
    table = covariate_table(model.robot, rows.readings, measured, model.around, world, {".gravity_", ".payload_"})
    # A derived side of approach is for backlash alone: nothing else is asked whether it depends on it.
    table |= {name: derived[name] for name in usable_columns(derived)[0]}
    observed = Observed(model.robot, table, tuple(usable))
    return observed, barred + barred_joints(observed)


def linear_model(
    start: Start, current: Fit, active: Sequence[Active], library: Sequence[Effect], observed: Observed
) -> LinearModel:
    """Linearise the current model, and the slots where the library's effects act.

    Args:
        start: The geometric stage, about which the constants are gauged, and the rows.
        current: The model as it is.
        active: Effects that are in it.
        library: Effects that may be added.
        observed: Covariates of the rows.
    """
    effects = list(dict.fromkeys([*library, *(a.effect for a in active)]))
    slots = tuple(dict.fromkeys((c.where, c.component) for e in effects for c in e.coefficients))
    bases = tuple(dict.fromkeys(c.basis for e in effects for c in e.coefficients))
    ones = Basis("ones", (observed.robot.names[0],))
    own = current.model.coefficients
    model = current.model.with_coefficients((*own, *(Coefficient(*slot, ones) for slot in slots)))
    theta = np.concatenate([current.theta, np.zeros(len(slots))])
    r, J = problem(model, start.train).linearised(theta)
    # The residual as it was at the geometric stage, to first order: what is solved for are distances from there.
    known = dict(zip(start.geometric.model.names, start.geometric.theta, strict=True))
    geometric = np.array([known.get(name, 0.0) for name in current.model.names])
    r = r + J[:, :, : len(own)] @ (current.theta - geometric)
    constant = np.flatnonzero([c.basis.constant for c in own])
    run, fold = _folds(start.train)
    return LinearModel(
        channels=start.train.channels,
        A=np.ascontiguousarray(J[:, :, constant]),
        gauge=np.eye(len(constant)) / GAUGE**2,
        G=np.ascontiguousarray(J[:, :, len(own) :]),
        slots=slots,
        phi=np.column_stack([evaluate(b, observed.table) for b in bases]) if bases else np.zeros((len(r), 0)),
        bases=bases,
        r=r,
        stale=start.train.stale,
        run=run,
        fold=fold,
        own=observed.robot.names,
        table=observed.table,
    )


def refit(start: Start, state: State, current: Fit) -> Fit:
    """Fit constants and effects together on the exact model, the constants gauged to the geometric stage.

    Constants that the geometric stage could not identify, its residual being large, are taken in when they can be now.
    """
    constants = tuple(c for c in current.model.coefficients if c.basis.constant)
    found = _refit(start, constants, state, current)
    more = _regained(start, found)
    return _refit(start, constants + more, state, found) if more else found


def _refit(start: Start, constants: tuple[Coefficient, ...], state: State, current: Fit) -> Fit:
    """Fit given constants and the effects of a state; see :func:`refit`."""
    geometric = start.geometric
    effects = tuple(c for a in state.active for c in a.effect.coefficients)
    model = geometric.model.with_coefficients(constants + effects)
    known = dict(zip(current.model.names, current.theta, strict=True))
    theta = np.array([known.get(name, 0.0) for name in model.names])
    asked = problem(model, start.train)
    weight = np.where(state.used, 1.0, 0.0)
    found = fit(asked, theta, weight, _prior(geometric, constants, state))
    redundant = {name: why for name, why in geometric.redundant.items() if name not in model.names}
    return replace(found, candidates=geometric.candidates, redundant=redundant)


def _prior(geometric: Fit, constants: tuple[Coefficient, ...], state: State) -> Prior:
    """Constants loosely at the geometric stage, smooth effects after their kernels, the rest free."""
    before = dict(zip(geometric.model.names, geometric.theta, strict=True))
    count = len(constants)
    parts = [np.eye(count) / GAUGE**2, *(a.coefficient_precision for a in state.active)]
    precision = block_diag(*parts)
    mean = np.zeros(len(precision))
    mean[:count] = [before.get(c.name, 0.0) for c in constants]
    return Prior(mean, precision, block_diag(np.eye(count), *(a.root for a in state.active)))


def _regained(start: Start, found: Fit) -> tuple[Coefficient, ...]:
    """Constants that were given up in the geometric stage and are identifiable now."""
    dropped = tuple(c for c in found.candidates if c.name in found.redundant)
    if not dropped:
        return ()
    model = found.model.with_coefficients(found.model.coefficients + dropped)
    theta = np.concatenate([found.theta, np.zeros(len(dropped))])
    R = triangle(problem(model, start.train), theta, found.weight, found.sigma)
    kept = identifiable(R, range(len(theta))).kept
    return tuple(c for k, c in enumerate(model.coefficients) if k >= len(found.theta) and k in kept)


def _folds(train: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Stretches of time, and folds that keep repeats together, one number each for every row, shape (N,)."""
    n = len(train)
    time = train.covariates.get("time")
    order = np.argsort(time, kind="stable") if time is not None and not np.isnan(time).any() else np.arange(n)
    run = np.empty(n, dtype=int)
    run[order] = np.arange(n) * min(RUNS, n) // n
    number = np.random.default_rng(0).permutation(int(train.configuration.max()) + 1)
    return run, number[train.configuration] % FOLDS
