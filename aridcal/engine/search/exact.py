"""The exact model: constants and effects fitted together, and linearised for the search where that ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.linalg import block_diag

from aridcal.engine.corrections.basis import evaluated
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import Observed
from aridcal.engine.corrections.place_scatter import is_scatter, place_columns
from aridcal.engine.fit.flags import flagged
from aridcal.engine.fit.identifiable import apart, identifiable
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.residual import taking_off, triangle
from aridcal.engine.levels import FOLDS
from aridcal.engine.model.model import Model
from aridcal.engine.model.predictions import readings_at
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_together, repeated
from aridcal.engine.search.covariate_table import look
from aridcal.engine.search.evidence import charge
from aridcal.engine.search.linear_model import Active, LinearModel
from aridcal.engine.search.state import State
from aridcal.system.progress import SILENT, Progress

RUNS = 24
"""Stretches of time into which the rows are cut: enough for a test that takes each of them as one."""

FEWEST_PLACES = 3
"""Things, or groups that ties join, from which whole ones are held back: of two, one alone does not tell the constants."""

GAUGE = 0.05
"""[m] and [rad]: constants are held at the geometric stage this loosely, where nothing else decides."""


@dataclass(frozen=True)
class Start:
    """Where a search begins.

    Attributes:
        geometric: The geometric stage.
        train: The rows that it was fitted to.
        limit: Sigmas beyond which each of them is flagged, shape (N,).
        progress: Told how far each pass over the rows is.
    """

    geometric: Fit
    train: Dataset
    limit: np.ndarray
    progress: Progress = SILENT


def refit(start: Start, state: State, current: Fit) -> Fit:
    """Fit constants and effects together on the exact model, the constants gauged to the geometric stage.

    Constants that the geometric stage could not identify, its residual being large, are taken in when they can be now.
    """
    solved = _as_solved(start, current, state)
    state = replace(state, active=tuple(a for a in state.active if not is_scatter(a.effect)))
    refitted = refit_constants(start, state, current, solved=solved)
    more = _regained(start, refitted)
    return refit_constants(start, state, refitted, more) if more else refitted


def _as_solved(start: Start, current: Fit, state: State) -> dict[str, float]:
    """Values of the coefficients as the linearised model has them, by name; nothing where its constants are others."""
    constants = _constants(current)
    if state.model.A.shape[2] != len(constants):
        return {}
    before = dict(zip(start.geometric.model.names, start.geometric.theta.tolist(), strict=True))
    values = {c.name: value for c, value in state.coefficients(constants).items()}
    return values | {c.name: before.get(c.name, 0.0) + values[c.name] for c in constants}


def _constants(fit: Fit) -> tuple[Coefficient, ...]:
    return tuple(c for c in fit.model.coefficients if c.basis.constant)


def refit_constants(
    start: Start,
    state: State,
    current: Fit,
    more: tuple[Coefficient, ...] = (),
    solved: Mapping[str, float] = MappingProxyType({}),
) -> Fit:
    """Fit the constants of a fit with the effects of a state; see :func:`refit`.

    Args:
        start: Where the search began.
        state: The effects, and the rows in use.
        current: A fit to begin from.
        more: Further constants.
        solved: Values to begin from instead, by the names of coefficients.
    """
    constants = (*_constants(current), *more)
    geometric = start.geometric
    effects = tuple(c for a in state.active for c in a.effect.coefficients)
    model = geometric.model.with_coefficients(constants + effects)
    known = dict(zip(current.model.names, current.theta.tolist(), strict=True)) | dict(solved)
    theta = np.array([known.get(name, 0.0) for name in model.names])
    asked = problem(model, start.train, start.progress)
    weight = np.where(state.used, 1.0, 0.0)
    found = fit(asked, theta, weight, _prior(geometric, constants, state))
    redundant = {name: why for name, why in geometric.redundant.items() if name not in model.names}
    return replace(found, candidates=geometric.candidates, redundant=redundant)


def flagged_again(start: Start, state: State, current: Fit) -> Fit:
    """The fit with the rows flagged that it leaves far off; the same fit if those are the ones it was made without."""
    used = ~flagged(current.residual, start.train.channels, start.limit)
    if np.array_equal(used, ~current.outliers) or not state.active:
        return current
    return refit_constants(start, replace(state, used=used), current)


def worth(fit: Fit, state: State) -> float:
    r"""Log-likelihood of an exact fit with its noise profiled out, less the price of its effects, [nat].

    .. math:: -\sum_c n_c \log \hat\sigma_c - \tfrac12 \sum_e d_e (1 + \log \max(2 g_e / d_e, 1))

    for effects e of d degrees of freedom and evidence g; see :func:`aridcal.engine.search.evidence.charge`.
    """
    value = -float(state.equations.count @ np.log(fit.estimated))
    for active in state.active:
        value -= 0.5 * charge(2.0 * active.score.gain, active.score.freedom)
    return value


def _prior(geometric: Fit, constants: tuple[Coefficient, ...], state: State) -> Prior:
    """Constants loosely at the geometric stage, smooth effects after their kernels, the rest free."""
    before = dict(zip(geometric.model.names, geometric.theta, strict=True))
    count = len(constants)
    parts = [_gauge(geometric, constants), *(a.coefficient_precision for a in state.active)]
    precision = block_diag(*parts)
    mean = np.zeros(len(precision))
    # Of few rows these are near zero, not near the geometric stage.
    believed = _believed(geometric, constants).any(axis=1)
    mean[:count] = np.where(believed, 0.0, [before.get(c.name, 0.0) for c in constants])
    return Prior(mean, precision, (np.eye(count), *(a.root for a in state.active)))


def _gauge(geometric: Fit, constants: tuple[Coefficient, ...]) -> np.ndarray:
    """Precision with which constants are held at the geometric stage, shape (count, count)."""
    believed = _believed(geometric, constants)
    loose = (GAUGE * geometric.model.with_coefficients(constants).sizes) ** -2.0
    return believed + np.diag(np.where(believed.any(axis=1), 0.0, loose))


def _believed(geometric: Fit, constants: tuple[Coefficient, ...]) -> np.ndarray:
    """Precision with which the geometric stage believed constants to be zero, (count, count); zero where nothing is believed."""
    number = {name: k for k, name in enumerate(geometric.model.names)}
    there = [k for k, c in enumerate(constants) if c.name in number]
    own = [number[constants[k].name] for k in there]
    precision = np.zeros((len(constants), len(constants)))
    precision[np.ix_(there, there)] = geometric.believed[np.ix_(own, own)]
    return precision


def _regained(start: Start, found: Fit) -> tuple[Coefficient, ...]:
    """Constants that were given up in the geometric stage and are identifiable now."""
    dropped = tuple(c for c in found.candidates if c.name in found.redundant)
    if not dropped or start.geometric.believed.any():  # what few rows do not tell is there already
        return ()
    model = found.model.with_coefficients(found.model.coefficients + dropped)
    theta = np.concatenate([found.theta, np.zeros(len(dropped))])
    asked = problem(model, start.train, start.progress)
    constant = np.flatnonzero([c.basis.constant for c in model.coefficients])
    R = triangle(asked, theta, found.weight, found.sigma, constant) * model.sizes[constant]
    if not apart(R, len(constant) - len(dropped)).any():  # sums of the other constants, whatever the effects are
        return ()
    R = triangle(asked, theta, found.weight, found.sigma) * model.sizes
    kept = identifiable(R, range(len(theta))).kept
    return tuple(c for k, c in enumerate(model.coefficients) if k >= len(found.theta) and k in kept)


def linear_model(
    start: Start, current: Fit, active: Sequence[Active], library: Sequence[Effect], observed: Observed
) -> LinearModel:
    """Linearise the current model, and the slots where the library's effects act.

    Args:
        start: The geometric stage, about which the constants are gauged, and the rows.
        current: The model as it is.
        active: Effects that are in it. If the scatter of places is among them, rows of a place are held back together;
            else those of a configuration: where rows of a place err independently, each tells of the others' place.
        library: Effects that may be added.
        observed: Covariates of the rows.
    """
    effects = list(dict.fromkeys([*library, *(a.effect for a in active)]))
    slots = tuple(dict.fromkeys(slot for e in effects for slot in e.slots))
    # Most are shared, and slow to be compared.
    own_bases = {id(c.basis): c.basis for e in effects for c in e.coefficients}
    bases = tuple(dict.fromkeys(own_bases.values()))
    own = current.model.coefficients
    model = current.model.with_motions(slots)
    theta = np.concatenate([current.theta, np.zeros(len(slots))])
    asked = problem(model, start.train).agreeing(theta)
    r, J = asked.linearised(theta)
    off = taking_off(asked, theta, current.weight, current.sigma)
    constant = np.flatnonzero([c.basis.constant for c in own])
    A = J[:, :, : len(own)]
    if off is not None:
        r, A = off(r[:, :, None])[:, :, 0], off(A)
    # The residual as it was at the geometric stage, to first order: what is solved for are distances from there.
    known = dict(zip(start.geometric.model.names, start.geometric.theta, strict=True))
    geometric = np.array([known.get(name, 0.0) for name in current.model.names])
    r = r + A @ (current.theta - geometric)
    if start.train.repeats.share != 1.0:
        r, A, J = (np.sqrt(start.train.repeats.share) * values for values in (r, A, J))
    table = _table(start, asked, observed)
    together = (held_together if any(is_scatter(a.effect) for a in active) else repeated)(start.train)
    run, fold = _folds(start.train, together)
    of_places = place_columns(held_together(start.train)) if any(is_scatter(e) for e in effects) else {}
    return LinearModel(
        channels=start.train.channels,
        A=np.ascontiguousarray(A[:, :, constant]),
        gauge=_gauge(start.geometric, tuple(own[k] for k in constant)),
        G=np.ascontiguousarray(J[:, :, len(own) :]),
        slots=slots,
        phi=np.asfortranarray(evaluated(bases, {**table, **of_places}) if bases else np.zeros((len(r), 0))),
        bases=bases,
        r=r,
        limit=start.limit,
        run=run,
        fold=fold,
        configuration=together,
        thing=_places(asked),
        off=off,
        present=start.train.measures,
        taken=asked.taken(current.weight),
        share=start.train.repeats.share,
        own=observed.robot.names,
        table=table,
    )


def few_places(model: Model, train: Dataset) -> bool:
    """True where rows measure places that are unknown, too few of them to hold any back."""
    asked = problem(model, train)
    return asked.groups is not None and bool((asked.groups.row >= 0).all()) and _places(asked) is None


def _places(asked: Problem) -> np.ndarray | None:
    """Number of the group of things that each row measures, shape (N,); None where there are too few groups."""
    if asked.groups is None or (asked.groups.row < 0).any():
        return None
    different, number = np.unique(asked.groups.row, return_inverse=True)
    return np.asarray(number) if len(different) >= FEWEST_PLACES else None


def _table(start: Start, asked: Problem, observed: Observed) -> Mapping[str, np.ndarray]:
    """What bases depend on, shape (N,) each, where the rows are differentiated: as read, or where they agree with the model.

    A motion that turns back with a joint's angle is no motion at all; asked at one angle and undone at another, it would be one
    of the size of what the readings were moved by, which is the noise of the very row.
    """
    seen = asked.measured
    if seen.wide is None or seen.agreed is None:
        return observed.table
    agreed = replace(start.train, readings=readings_at(seen, start.train, seen.agreed.positions))
    return look(start.geometric.model, agreed)[0].table


def _folds(train: Dataset, together: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stretches of time, and folds of what is held back together, one number each for every row, shape (N,)."""
    n = len(train)
    run = np.empty(n, dtype=int)
    run[train.sequence] = np.arange(n) * min(RUNS, n) // n
    number = np.random.default_rng(0).permutation(int(together.max()) + 1)
    return run, number[together] % FOLDS
