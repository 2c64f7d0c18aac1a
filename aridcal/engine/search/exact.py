"""The exact model: constants and effects fitted together, and linearised at the fit for the search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.linalg import block_diag

from aridcal.engine.corrections.basis import values_of_bases
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.place_scatter import is_scatter, place_columns
from aridcal.engine.fit.flags import outlier_rows
from aridcal.engine.fit.identifiable import apart, identifiable
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.residual import thing_projector, triangle
from aridcal.engine.levels import CHOOSING_FOLDS
from aridcal.engine.model.model import Model
from aridcal.engine.model.predictions import readings_at
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups, repeated
from aridcal.engine.search.covariate_table import covariates_and_exclusions
from aridcal.engine.search.evidence import charge
from aridcal.engine.search.linear_model import ActiveEffect, LinearModel
from aridcal.engine.search.state import State
from aridcal.system.progress import SILENT, Progress

RUNS = 24
"""Stretches of time into which the rows are cut: enough for a test that takes each of them as one."""

FEWEST_HELD_BACK_THINGS = 3
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
        progress: Called with the rows done in each pass over them.
    """

    geometric: Fit
    train: Dataset
    limit: np.ndarray
    progress: Progress = SILENT


def refit(start: Start, state: State, current: Fit) -> Fit:
    """Fit constants and effects together on the exact model, the constants gauged to the geometric stage.

    Constants that the geometric stage could not identify, its residual being large, are taken in when they can be now.
    """
    solved = _solved_values(start, current, state)
    state = replace(state, active=tuple(a for a in state.active if not is_scatter(a.effect)))
    refitted = refit_constants(start, state, current, solved=solved)
    more = _constants_regained(start, refitted)
    return refit_constants(start, state, refitted, more) if more else refitted


def _solved_values(start: Start, current: Fit, state: State) -> dict[str, float]:
    """Values of the coefficients in the linearised model, by name; empty where its constants are others."""
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
    values = dict(zip(current.model.names, current.theta.tolist(), strict=True)) | dict(solved)
    theta = np.array([values.get(name, 0.0) for name in model.names])
    question = problem(model, start.train, start.progress)
    weight = np.where(state.used, 1.0, 0.0)
    refitted = fit(question, theta, weight, _prior(geometric, constants, state))
    redundant = {name: why for name, why in geometric.redundant.items() if name not in model.names}
    return replace(refitted, candidates=geometric.candidates, redundant=redundant)


def reflag_rows(start: Start, state: State, current: Fit) -> Fit:
    """The fit with rows flagged by its own residuals; the same fit if it was made with these flags."""
    in_use = ~outlier_rows(current.residual, start.train.channels, start.limit)
    if np.array_equal(in_use, ~current.outliers) or not state.active:
        return current
    return refit_constants(start, replace(state, used=in_use), current)


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
    # Constants with a prior, where rows are few, are near zero, not near the geometric stage.
    believed = _believed_precision(geometric, constants).any(axis=1)
    mean[:count] = np.where(believed, 0.0, [before.get(c.name, 0.0) for c in constants])
    return Prior(mean, precision, (np.eye(count), *(a.root for a in state.active)))


def _gauge(geometric: Fit, constants: tuple[Coefficient, ...]) -> np.ndarray:
    """Precision with which constants are held at the geometric stage, shape (count, count)."""
    believed = _believed_precision(geometric, constants)
    loose = (GAUGE * geometric.model.with_coefficients(constants).sizes) ** -2.0
    return believed + np.diag(np.where(believed.any(axis=1), 0.0, loose))


def _believed_precision(geometric: Fit, constants: tuple[Coefficient, ...]) -> np.ndarray:
    """Prior precision of the geometric stage's constants about zero, shape (count, count); zero without a prior."""
    number = {name: k for k, name in enumerate(geometric.model.names)}
    there = [k for k, c in enumerate(constants) if c.name in number]
    indices = [number[constants[k].name] for k in there]
    precision = np.zeros((len(constants), len(constants)))
    precision[np.ix_(there, there)] = geometric.believed[np.ix_(indices, indices)]
    return precision


def _constants_regained(start: Start, refitted: Fit) -> tuple[Coefficient, ...]:
    """Constants that the geometric stage dropped and that are identifiable beside the effects."""
    dropped = tuple(c for c in refitted.candidates if c.name in refitted.redundant)
    if not dropped or start.geometric.believed.any():  # with a prior all constants are in the fit already
        return ()
    model = refitted.model.with_coefficients(refitted.model.coefficients + dropped)
    theta = np.concatenate([refitted.theta, np.zeros(len(dropped))])
    question = problem(model, start.train, start.progress)
    constant = np.flatnonzero([c.basis.constant for c in model.coefficients])
    R = triangle(question, theta, refitted.weight, refitted.sigma, constant) * model.sizes[constant]
    if not apart(R, len(constant) - len(dropped)).any():  # sums of the other constants, whatever the effects are
        return ()
    R = triangle(question, theta, refitted.weight, refitted.sigma) * model.sizes
    identifiable_now = identifiable(R, range(len(theta))).independent
    return tuple(c for k, c in enumerate(model.coefficients) if k >= len(refitted.theta) and k in identifiable_now)


def linear_model(
    start: Start, current: Fit, active: Sequence[ActiveEffect], library: Sequence[Effect], observed: ObservedRows
) -> LinearModel:
    """Linearise the current model, and the slots where the library's effects act.

    Args:
        start: The geometric stage, about which the constants are gauged, and the rows.
        current: The model, fitted.
        active: Its effects. With the scatter of places among them, rows of a place are held back together; else rows of a
            configuration, as each row of a place then tells about the others'.
        library: Candidates.
        observed: Covariates of the rows.
    """
    effects = list(dict.fromkeys([*library, *(a.effect for a in active)]))
    slots = tuple(dict.fromkeys(slot for e in effects for slot in e.slots))
    # Most bases are shared objects, and slow to be compared.
    own_bases = {id(c.basis): c.basis for e in effects for c in e.coefficients}
    bases = tuple(dict.fromkeys(own_bases.values()))
    coefficients = current.model.coefficients
    model = current.model.with_motions(slots)
    theta = np.concatenate([current.theta, np.zeros(len(slots))])
    question = problem(model, start.train).agreeing(theta)
    r, J = question.linearised(theta)
    off = thing_projector(question, theta, current.weight, current.sigma)
    constant = np.flatnonzero([c.basis.constant for c in coefficients])
    A = J[:, :, : len(coefficients)]
    if off is not None:
        r, A = off(r[:, :, None])[:, :, 0], off(A)
    # The residual at the geometric stage, to first order: the unknowns are differences from there.
    values_of_geometric = dict(zip(start.geometric.model.names, start.geometric.theta, strict=True))
    geometric = np.array([values_of_geometric.get(name, 0.0) for name in current.model.names])
    r = r + A @ (current.theta - geometric)
    if start.train.repeats.share != 1.0:
        r, A, J = (np.sqrt(start.train.repeats.share) * values for values in (r, A, J))
    table = _table(start, question, observed)
    together = (held_back_groups if any(is_scatter(a.effect) for a in active) else repeated)(start.train)
    run, fold = _folds(start.train, together)
    of_places = place_columns(held_back_groups(start.train)) if any(is_scatter(e) for e in effects) else {}
    return LinearModel(
        channels=start.train.channels,
        A=np.ascontiguousarray(A[:, :, constant]),
        gauge=_gauge(start.geometric, tuple(coefficients[k] for k in constant)),
        G=np.ascontiguousarray(J[:, :, len(coefficients) :]),
        slots=slots,
        phi=np.asfortranarray(values_of_bases(bases, {**table, **of_places}) if bases else np.zeros((len(r), 0))),
        bases=bases,
        r=r,
        limit=start.limit,
        run=run,
        fold=fold,
        configuration=together,
        thing=_places(question),
        off=off,
        present=start.train.measures,
        taken_up=question.taken(current.weight),
        share=start.train.repeats.share,
        joints=observed.robot.names,
        table=table,
    )


def few_places(model: Model, train: Dataset) -> bool:
    """True where rows measure unknown places, too few to hold one back."""
    question = problem(model, train)
    return question.groups is not None and bool((question.groups.row >= 0).all()) and _places(question) is None


def _places(question: Problem) -> np.ndarray | None:
    """Number of the group of things that each row measures, shape (N,); None where there are too few groups."""
    if question.groups is None or (question.groups.row < 0).any():
        return None
    different, number = np.unique(question.groups.row, return_inverse=True)
    return np.asarray(number) if len(different) >= FEWEST_HELD_BACK_THINGS else None


def _table(start: Start, question: Problem, observed: ObservedRows) -> Mapping[str, np.ndarray]:
    """Covariates of bases, shape (N,) each, at the readings of the derivatives: as read, or agreeing with the model.

    A motion that a turn of a joint undoes moves nothing; with its basis at one angle and its column at another it would seem to
    move the target by the difference of the angles, which is the noise of that very row.
    """
    predictions = question.measured
    if predictions.wide is None or predictions.agreed is None:
        return observed.table
    rows_agreeing = replace(start.train, readings=readings_at(predictions, start.train, predictions.agreed.positions))
    return covariates_and_exclusions(start.geometric.model, rows_agreeing)[0].table


def _folds(train: Dataset, together: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stretch of time and fold of each row, shape (N,) each; rows of one number in ``together`` have one fold."""
    n = len(train)
    run = np.empty(n, dtype=int)
    run[train.sequence] = np.arange(n) * min(RUNS, n) // n
    number = np.random.default_rng(0).permutation(int(together.max()) + 1)
    return run, number[together] % CHOOSING_FOLDS
