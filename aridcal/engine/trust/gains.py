"""The search in figures: each effect's gain on held-out rows, its curve, and whether the rest is noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.corrections.basis import evaluate
from aridcal.engine.corrections.catalogue import UntestableEffect, merged
from aridcal.engine.corrections.effect import ANGULAR, ROW_ORDER, Coefficient, Effect
from aridcal.engine.corrections.regional_kind import is_local
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.normal_equations import conditional
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.residual import problem_with_things
from aridcal.engine.instruments.channels import Channels, columns
from aridcal.engine.levels import CHOOSING_FOLDS, FAINT_LEVER_SHARE
from aridcal.engine.numerics import TINY
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.diagnose import SearchResult
from aridcal.engine.search.noise_tests import Clue
from aridcal.engine.search.rival_models import RivalModel
from aridcal.engine.search.scoring import held_back_errors

CURVE_GRID = 160
"""Drawn: Points of a curve, at least: it is drawn without corners."""

PER_PERIOD = 16
"""Drawn: Points at the least in each period of a harmonic, for the same reason."""


@dataclass(frozen=True)
class Curve:
    """An effect's motion over its covariate, with the rows behind it.

    Attributes:
        component: Component of the motion.
        unit: ``m`` or ``rad``.
        covariate: The covariate.
        at: Values of the covariate, shape (G,).
        value: The identified motion there, shape (G,).
        std: Its standard deviation, shape (G,).
        row_values: Values of the covariate at the rows, shape (N,).
        pulled: Motion that each row asks for by itself: its residual pulled back to this place, shape (N,).
    """

    component: str
    unit: str
    covariate: str
    at: np.ndarray
    value: np.ndarray
    std: np.ndarray
    row_values: np.ndarray
    pulled: np.ndarray


@dataclass(frozen=True)
class NamedEffect:
    """An effect that was accepted or declared.

    Attributes:
        effect: The effect, with all its coefficients.
        declared: True if the campaign named it.
        p_value: After correction for the number of candidates, not below 1e-300.
        before: Residuals of the test rows of the final model without it, the rest refitted, shape (T, m).
        after: Residuals of the test rows of the final model, shape (T, m).
        reached: Residuals of all rows of the model with this effect and those listed before it, refitted, shape (N, m).
        confounded_with: Effects that are confounded with it in these data.
        curves: Its motions over its covariates.
        adds: What it adds to the target's predicted position beyond what frames and constants could take up, shape
            (N, 3), [m]; None for an effect of the measuring head.
    """

    effect: Effect
    declared: bool
    p_value: float
    before: np.ndarray
    after: np.ndarray
    reached: np.ndarray
    confounded_with: tuple[Effect, ...]
    curves: tuple[Curve, ...] = ()
    adds: np.ndarray | None = None


@dataclass(frozen=True)
class RejectedEffect:
    """A candidate that was examined closely and not accepted."""

    effect: Effect
    p_value: float
    gain: float
    why: str


@dataclass(frozen=True)
class Diagnosis:
    """Results of the search for undeclared effects.

    Attributes:
        effects: Accepted and declared effects, the largest gain first.
        rejected: The best candidates among those that were not accepted.
        barred: Effects that could not be tested, and why.
        tested: Number of candidates.
        clues: Whether what remains is noise.
        over_time: Position error of the fitted rows with whole stretches of time held back in turn, RMS [m]; None where
            no effect depends on time.
        tied: The model with what the rows cannot tell from its effects.
    """

    effects: tuple[NamedEffect, ...]
    rejected: tuple[RejectedEffect, ...]
    barred: tuple[UntestableEffect, ...]
    tested: int
    clues: tuple[Clue, ...]
    over_time: float | None = None
    tied: tuple[RivalModel, ...] = ()


def explain(diagnosed: SearchResult, every: Dataset, scored: np.ndarray, clues: Sequence[Clue]) -> Diagnosis:
    """Gather the results of the search.

    Args:
        diagnosed: The search and the final model.
        every: All N rows.
        scored: Held-out rows without outliers, shape (N,) bool.
        clues: Whether what remains is noise.
    """
    search = diagnosed.stepwise
    active = search.state.active
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, a in enumerate(active):
        groups.setdefault(a.effect.identity, []).append(k)
    return Diagnosis(
        effects=_named(diagnosed, every, scored, groups) if groups else (),
        rejected=tuple(RejectedEffect(j.effect, j.p_value, j.score.gain, j.why) for j in search.rejected),
        barred=diagnosed.barred,
        tested=search.tested,
        clues=tuple(clues),
        over_time=_over_time(diagnosed),
        tied=diagnosed.tied,
    )


def _named(
    diagnosed: SearchResult, every: Dataset, scored: np.ndarray, groups: Mapping[tuple[object, ...], Sequence[int]]
) -> tuple[NamedEffect, ...]:
    """Each effect, the largest first, with the residuals of all rows with it and without it.

    Args:
        diagnosed: The search and the final model.
        every: All N rows.
        scored: Held-out rows without outliers, shape (N,) bool.
        groups: Numbers of the active parts of each effect, by its identity.
    """
    search, fit = diagnosed.stepwise, diagnosed.fit
    active = search.state.active
    declared = {e.identity for e in diagnosed.declared}
    fit_problem = problem(fit.model, every)
    final, places = fit_problem.residual(fit.theta), fit.model.poses(fit.theta, fit_problem.rows)[1]
    effects = []
    for who, members in groups.items():
        parts = [active[k] for k in members]
        effect = merged([a.effect for a in parts])
        others = [a.effect for k, a in enumerate(active) if k not in members]
        twins = {e.identity: e for k in members for e in diagnosed.confounded[k] if e.identity not in groups}
        p_value = min(a.score.p_value for a in parts) * max(search.tested, 1)
        named = NamedEffect(
            effect=effect,
            declared=who in declared,
            p_value=max(min(1.0, p_value), TINY),
            before=_with_effects(fit_problem, fit, others)[scored],
            after=final[scored],
            reached=final,
            confounded_with=tuple(twins.values()),
            curves=tuple(_curves(effect, diagnosed)),
            adds=places - _without(fit_problem, fit, effect),
        )
        effects.append(named)
    effects.sort(key=lambda e: -_rms(e.before, every.channels))
    for k in range(len(effects) - 1):
        first = [e.effect for e in effects[: k + 1]]
        effects[k] = replace(effects[k], reached=_with_effects(fit_problem, fit, first))
    return tuple(effects)


def _over_time(diagnosed: SearchResult) -> float | None:
    """Position error with whole stretches of time held back, on the linear model; None where no effect depends on time."""
    linear, state = diagnosed.linear, diagnosed.stepwise.state
    of_time = [a for a in state.active if {ROW_ORDER, "time"} & set(a.effect.covariates)]
    if not of_time:
        return None
    other_effects = [a for a in state.active if a is not of_time[-1]]
    without_it = state.with_active(other_effects, fixed=True)
    squares = held_back_errors(without_it, of_time[-1], linear.run[state.used] % CHOOSING_FOLDS)
    return float(state.solution.sigma[0] * np.sqrt(squares[1, 0].mean() / linear.share))


def refit_coefficients(fit: Fit, zeroed: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Coefficients of a model of which some are taken to be zero, and others fitted anew to the same rows.

    Args:
        fit: The whole model, solved.
        zeroed: Coefficients that become zero, shape (K,).
        free: Coefficients that are fitted anew, shape (K,); the rest stay.

    Returns:
        Shape (K,), see :func:`aridcal.engine.fit.normal_equations.conditional`. It is one Gauss-Newton step: constants that
        move by milliradians are exact to microradians, and the error that they leave is right to second order in that, since it
        is at its minimum.
    """
    return conditional(fit.covariance, fit.theta, zeroed, ~(zeroed | free))


def _with_effects(fit_problem: Problem, fit: Fit, effects: Sequence[Effect]) -> np.ndarray:
    """Residuals of a model with some of its effects only, all else refitted, shape (n, m)."""
    names = {c.name for e in effects for c in e.coefficients}
    keep = np.array([c.basis.constant or c.name in names for c in fit.model.coefficients], dtype=bool)
    theta = refit_coefficients(fit, ~keep, keep)
    train = fit_problem.data.train
    weight = np.zeros(len(train))
    weight[train] = fit.weight
    with_things = problem_with_things(fit_problem, theta, weight)
    # Things that held-out rows alone refer to are solved from these rows, as for the whole model.
    states = {
        name: np.where(np.isnan(state), state, with_things.states[name]) for name, state in fit_problem.states.items()
    }
    return with_things.with_states(states).residual(theta)


def _without(fit_problem: Problem, fit: Fit, effect: Effect) -> np.ndarray:
    """Predicted positions without an effect, frames and constants refitted in its place, shape (N, 3), [m]."""
    names = {c.name for c in effect.coefficients}
    zeroed = np.array([name in names for name in fit.model.names], dtype=bool)
    constant = np.array([c.basis.constant for c in fit.model.coefficients], dtype=bool)
    return fit.model.poses(refit_coefficients(fit, zeroed, constant), fit_problem.rows)[1]


def _rms(r: np.ndarray, channels: Channels) -> float:
    """RMS error in the first channel that the rows measure; 0 of no rows."""
    part = columns(channels)[0]
    measured = r[~np.isnan(r[:, part.start])][:, part]
    return float(np.sqrt(np.mean(np.sum(measured**2, axis=1)))) if len(measured) else 0.0


def _curves(effect: Effect, diagnosed: SearchResult) -> list[Curve]:
    """The effect's motions, each over the covariate it depends on first."""
    identified = set(diagnosed.fit.model.names)
    curves: list[Curve] = []
    if is_local(effect):  # no line through it says what it is
        return curves
    for component in effect.motion:
        of_covariates = [c for c in effect.coefficients if c.basis.of]
        of_component = [c for c in of_covariates if c.component == component and c.name in identified]
        for name in dict.fromkeys(c.basis.of[0] for c in of_component):
            part = [c for c in of_component if c.basis.of[0] == name]
            curves.append(_curve(effect.where, component, name, part, diagnosed))
    return curves


def _curve(where: str, component: str, name: str, part: Sequence[Coefficient], diagnosed: SearchResult) -> Curve:
    """One motion over one covariate, and what each row asks for: its residual pulled back, plus the model's motion."""
    fit, table, linear, state = diagnosed.fit, diagnosed.observed.table, diagnosed.linear, diagnosed.stepwise.state
    index = [fit.model.names.index(c.name) for c in part]
    theta, covariance = fit.theta[index], fit.covariance[np.ix_(index, index)]
    values = table[name]
    grid = _grid(values, part)
    # A second covariate (a rail's travel, say) is held at its median.
    held = {o: np.full(len(grid), float(np.median(table[o]))) for c in part for o in c.basis.of[1:]}
    phi = np.column_stack([evaluate(c.basis, held | {name: grid}) for c in part])
    variance = np.einsum("gi,ij,gj->g", phi, covariance, phi)

    column = linear.slot_columns(where, component)
    lever = np.sum((column / state.sigma) ** 2, axis=1)
    own_motion = np.sum(column * state.residual / state.sigma**2, axis=1) / np.maximum(lever, TINY)
    motion = np.column_stack([evaluate(c.basis, table) for c in part]) @ theta
    telling = state.used & (lever > FAINT_LEVER_SHARE * np.median(lever))
    joint = next((j for j in diagnosed.observed.robot.joints if j.name == where), None)
    turns = component in ANGULAR or (component == "axis" and joint is not None and joint.kind == "revolute")
    return Curve(
        component=component,
        unit="rad" if turns else "m",
        covariate=name,
        at=grid,
        value=phi @ theta,
        std=np.sqrt(np.maximum(variance, 0.0)),
        row_values=values[telling],
        pulled=(own_motion + motion)[telling],
    )


def _grid(values: np.ndarray, part: Sequence[Coefficient]) -> np.ndarray:
    """Values of a covariate over the range seen, close enough for the highest harmonic."""
    low, high = float(values.min()), float(values.max())
    highest = max((abs(c.basis.numbers[0]) for c in part if c.basis.form in ("sin", "cos")), default=0.0)
    periods = highest * (high - low) / (2 * math.pi)
    return np.linspace(low, high, max(CURVE_GRID, math.ceil(PER_PERIOD * periods)))
