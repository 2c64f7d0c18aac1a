"""The measuring head's part in an outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aridcal.effects.effect import Coefficient
from aridcal.effects.head_kinds import unit
from aridcal.fit.closed_form import closed_form
from aridcal.fit.least_squares import Fit
from aridcal.fit.normal_equations import without
from aridcal.fit.problem import problem
from aridcal.head.detections import Shots
from aridcal.inputs.dataset import Dataset
from aridcal.result.outcome import Outcome
from aridcal.search.arm_and_head import ArmAndHead, HeadNumber, MeasuringHead
from aridcal.search.gains import FLOOR_P, NamedEffect, refitted, whitened_information
from aridcal.search.head_effects import system

DOUBTFUL = 1.3
"""Times the stated noise, or that part of it, that is worth a word: stated noise is good to about 30 %."""

ENOUGH = 20
"""Shots that tell a sonar's noise to 16 %."""


def with_head(outcome: Outcome, both: ArmAndHead, shots: Shots) -> Outcome:
    """Add to an arm's outcome what was found of the head.

    The figures of the nominal and the geometric stage become those of poses measured with the head as declared; the
    constants of the geometric stage, and so ``calibrated.urdf``, stay those of poses measured with the head as identified.
    """
    stages = list(outcome.stages)
    for k, found in enumerate((both.declared.nominal, both.declared.geometric)):
        stages[k] = replace(stages[k], residual=problem(found.model, both.declared_rows).residual(found.theta))
    stages[1:] = [replace(s, fit=_widened(s.fit, both)) for s in stages[1:]]
    diagnosis = outcome.diagnosis
    assert diagnosis is not None
    effects = sorted((*_named(outcome, both), *diagnosis.effects), key=lambda e: -float(np.sum(e.before[:, :3] ** 2)))
    effects = [replace(e, reached=_reached(outcome, both, effects[: k + 1])) for k, e in enumerate(effects)]
    diagnosis = replace(diagnosis, effects=tuple(effects), tested=diagnosis.tested + both.choice.tested)
    spread = both.before.scatter, both.after.scatter
    ranges = np.array([np.sqrt(np.mean(r.range_residuals**2, axis=0)) for r in (both.before, both.after)])
    numbers, coefficients = _numbers(both)
    mount = stages[-1].fit.model.tip_target[0][1].homogeneous
    fiducials = {str(name): shots.fiducials[name].to_numpy() for name in shots.fiducials}
    notices = ["tip_target is the camera's mounting on the tip, T_tip_camera; head.yaml gives only its starting value"]
    if spread[1] > DOUBTFUL:
        notices.append(
            f"within single shots, image points and ranges scatter by {spread[1]:.1f} times their stated noise: the camera, "
            "the sonars or their std are not as head.yaml says, in a way that no effect of the head describes"
        )
    for k, seen in enumerate(ranges[1]):
        ratio = float(seen) / both.start.std
        if len(both.after.misfit) >= ENOUGH and abs(np.log(ratio)) > np.log(DOUBTFUL):
            notices.append(
                f"sonar_{k + 1} scatters by {1e3 * seen:.2g} mm, not the stated {1e3 * both.start.std:.2g} mm"
            )
    for name, why in both.choice.redundant.items():
        notices.append(f"{name} is confounded with {', '.join(why)} and keeps its value from head.yaml")
    return replace(
        outcome,
        stages=tuple(stages),
        diagnosis=diagnosis,
        head=MeasuringHead(
            numbers,
            coefficients,
            spread,
            ranges,
            fiducials,
            np.array([shots.mount, mount]),
            closed_form(both.arm.geometry.geometric, outcome.measurements, outcome.parts()["train"]),
        ),
        notices=(*notices, *outcome.notices),
    )


def _widened(arm: Fit, both: ArmAndHead) -> Fit:
    """A fit whose covariance covers that of the head."""
    train = both.arm.rows.train
    rows, still = both.arm.rows.select(train), np.zeros(len(both.head.phi))
    response = system(arm, rows, both.after[train], still).response
    J = response @ both.choice.directions
    return replace(arm, covariance=arm.covariance + J @ both.choice.covariance @ J.T)


def _named(outcome: Outcome, both: ArmAndHead) -> list[NamedEffect]:
    """The head's effects and their gains: each taken out in turn, arm and head refitted to first order without it."""
    final, rows, choice = outcome.stage("final"), outcome.measurements, both.choice
    scored = rows.test & ~outcome.outlier
    M = choice.directions.T @ both.equations.information @ choice.directions
    found = []
    for k, e in enumerate(choice.effects):
        own = choice.of(e)
        step = choice.directions @ (without(M, choice.values, own, ~own) - choice.values)
        moved = _moved_residual(final.fit, rows, both, final.fit.theta, step, both.equations.response @ step)
        found.append(
            NamedEffect(
                effect=e,
                declared=choice.declared[k],
                p_value=max(choice.p_values[k], FLOOR_P),
                before=(final.residual + moved)[scored],
                after=final.residual[scored],
                reached=final.residual,
                confounded_with=choice.confounded[k],
            )
        )
    return found


def _moved_residual(
    fit: Fit, rows: Dataset, both: ArmAndHead, theta: np.ndarray, step: np.ndarray, answer: np.ndarray
) -> np.ndarray:
    """What a step of the head's numbers and the arm's answer to it add to the residual, to first order, shape (N, m).

    Args:
        fit: The arm.
        rows: N shots.
        both: Holds how the head's numbers move the measured poses.
        theta: Where the arm is differentiated, shape (K,).
        step: Of the head's numbers, shape (H,).
        answer: Of the arm's coefficients, shape (K,).
    """
    model = fit.model
    _, _, J = model.jacobian(theta, model.rows(rows.readings, rows.conditions, rows.station))
    return np.asarray(both.after.sensitivity @ step - J @ answer)


def _reached(outcome: Outcome, both: ArmAndHead, first: Sequence[NamedEffect]) -> np.ndarray:
    """What the constants leave of all rows with the first few effects, of the arm or the head, all refitted to first order."""
    fit, choice, rows = outcome.stage("final").fit, both.choice, outcome.measurements
    names = {c.name for e in first for c in e.effect.coefficients}
    keep = np.array([c.basis.constant or c.name in names for c in fit.model.coefficients], dtype=bool)
    theta = refitted(fit, ~keep, keep)
    absent = np.array([c.name not in names for c in choice.coefficients], dtype=bool)
    step = choice.directions @ np.where(absent, -choice.values, 0.0)
    # The arm's answer to that step when some of its effects are not there to give it.
    scale, information = whitened_information(fit)
    pull = information @ (both.equations.response @ step / scale)
    answer = np.zeros(len(theta))
    answer[keep] = scale[keep] * np.linalg.solve(information[np.ix_(keep, keep)], pull[keep])
    return problem(fit.model, rows).residual(theta) + _moved_residual(fit, rows, both, theta, step, answer)


def _numbers(both: ArmAndHead) -> tuple[tuple[HeadNumber, ...], tuple[HeadNumber, ...]]:
    """All numbers of the head, and the coefficients of its effects."""
    choice, H = both.choice, both.choice.directions
    std = np.sqrt(np.maximum(np.diag(H @ choice.covariance @ H.T), 0.0))
    every = [Coefficient(where, what) for where, what in (name.split(".") for name in both.start.names)]
    numbers = tuple(
        HeadNumber(
            c.name, unit(c), float(both.start.phi[k]), float(both.head.phi[k]), float(std[k]) if H[k].any() else None,
            "identified" if H[k].any() else "redundant" if c.name in choice.redundant else "fixed",
            choice.redundant.get(c.name, ()),
        )
        for k, c in enumerate(every)
    )  # fmt: skip
    spread = np.sqrt(np.maximum(np.diag(choice.covariance), 0.0))
    coefficients = tuple(
        HeadNumber(c.name, unit(c), 0.0, float(value), float(sigma), "identified")
        for c, value, sigma in zip(choice.coefficients, choice.values, spread, strict=True)
    )
    return numbers, coefficients
