"""The arm and the measuring head calibrated together: each in turn, until neither moves the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.arm import Arm, fit_arm, fit_constants
from aridcal.campaign import HEAD_KINDS, Campaign
from aridcal.closed_form import closed_form
from aridcal.effects import Coefficient
from aridcal.explain import refitted
from aridcal.geometry import Geometry, declared_noise, observations
from aridcal.head.reduction import Head, Reduced, reduce_shots
from aridcal.instrument import Choice, System, candidates, choose, stated, system, unit
from aridcal.measurements import Measurements
from aridcal.outcome import HeadNumber, MeasuringHead, NamedEffect, Outcome
from aridcal.residual import predict_residuals
from aridcal.robot import Robot
from aridcal.sighted import Shots, posed
from aridcal.solver import Data, Fit, fit

STEPS, ROUNDS = 6, 3
DOUBTFUL = 1.3  # times the stated noise
ENOUGH = 20  # shots that tell a sonar's noise
SETTLED = 0.1  # a step of the head that is smaller than this, in its own sigmas, is the last


@dataclass(frozen=True)
class ArmAndHead:
    """What came of both.

    Attributes:
        campaign: The arm's job: the head's effects are not in it.
        arm: Calibrated from the poses that the head, as identified, measures.
        declared: Frames and constants from the poses that the head, as declared, measures, and those rows.
        declared_rows: Those rows.
        start: The head as declared.
        head: The head as identified.
        choice: Its effects.
        equations: The last normal equations of the head's numbers.
        before: The shots reduced with the head as declared.
        after: With the head as identified.
    """

    campaign: Campaign
    arm: Arm
    declared: Geometry
    declared_rows: Measurements
    start: Head
    head: Head
    choice: Choice
    equations: System
    before: Reduced
    after: Reduced


def fit_arm_and_head(
    shots: Shots, rows: Measurements, robot: Robot, labels: tuple[str, ...], progress: Callable[[str], None]
) -> ArmAndHead:
    """Calibrate the arm and the head.

    Args:
        shots: What was seen.
        rows: Its rows, with their final split.
        robot: The nominal chain.
        labels: All stations, where a frame is per station.
        progress: Called with what is being done.
    """
    asked = shots.campaign
    campaign = asked.model_copy(update={"effects": tuple(e for e in asked.effects if e.kind not in HEAD_KINDS)})
    declared = stated(shots.head, [e for e in asked.effects if e.kind in HEAD_KINDS], str(asked.path))
    names = {(e.kind, e.where) for e in declared}
    sought = asked.diagnosis.candidates if asked.diagnosis.enabled else ()
    library = [e for e in candidates(shots.head, sought) if (e.kind, e.where) not in names]
    train, stale = ~rows.test, np.zeros(len(rows), dtype=bool)
    start = head = shots.head
    before = reduced = reduce_shots(shots.seen, start)
    first_rows = rows = posed(rows, before)
    progress(f"fitting frames and constants to {train.sum()} shots")
    first = geometry = fit_constants(campaign, robot, rows, labels, stale)

    def look(arm: Fit) -> tuple[System, Choice, float]:
        """Ask arm and shots about the head; how far it must move, in sigmas of what it is free to do."""
        moved = head.phi - start.phi
        data = _data(campaign, arm, rows.select(train), stale[train])
        equations = system(arm, data, reduced[train], moved)
        choice = choose(equations, start, declared, library)
        step = choice.step - moved
        return equations, choice, float(np.sqrt(step @ equations.information[0] @ step))

    arm, current = None, geometry.geometric
    for _ in range(ROUNDS):
        for _ in range(STEPS):
            equations, choice, step = look(current)
            if step < SETTLED:
                break
            progress(f"fitting the head: {', '.join(e.label for e in choice.effects)}")
            head = replace(start, phi=start.phi + choice.step)
            reduced = reduce_shots(shots.seen, head)
            rows = posed(rows, reduced)
            if arm is not None:  # what the search found goes with the head as it was: it is searched anew below
                break
            data = _data(campaign, current, rows.select(train), stale[train])
            current = fit(current.model, data, declared_noise(campaign, rows.select(train)), current.theta)
        if arm is not None and step < SETTLED:
            break
        if not np.array_equal(head.phi, start.phi):
            geometry = fit_constants(campaign, robot, rows, labels, stale)
        arm = fit_arm(campaign, geometry, rows, stale, progress)
        current = arm.diagnosed.fit
    assert arm is not None
    choice = replace(choice, values=np.linalg.lstsq(choice.directions, head.phi - start.phi, rcond=None)[0])
    return ArmAndHead(campaign, arm, first, first_rows, start, head, choice, equations, before, reduced)


def _data(campaign: Campaign, arm: Fit, rows: Measurements, stale: np.ndarray) -> Data:
    measured = observations(rows, campaign.measurements.noise.rows)
    return Data(arm.model.rows(rows.readings, rows.covariates, rows.station), measured, stale)


def with_head(outcome: Outcome, both: ArmAndHead, shots: Shots) -> Outcome:
    """Add to an arm's outcome what was found of the head.

    The figures of the nominal and the geometric stage become those of poses measured with the head as declared; the
    constants of the geometric stage, and so ``calibrated.urdf``, stay those of poses measured with the head as identified.
    """
    stages = list(outcome.stages)
    measured = observations(both.declared_rows, both.campaign.measurements.noise.rows)
    for k, found in enumerate((both.declared.nominal, both.declared.geometric)):
        rows = found.model.rows(outcome.measurements.readings, None, outcome.measurements.station)
        stages[k] = replace(stages[k], residual=predict_residuals(found.model, found.theta, rows, measured))
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
    notices = [
        "tip_target is the camera's mounting on the tip, T_tip_camera; that of head.yaml is only where it started"
    ]
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
        notices.append(f"{name} cannot be told from {', '.join(why)}: it stays as head.yaml has it")
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
    rows = both.arm.bound.train
    data = _data(both.campaign, arm, rows, np.zeros(len(rows), dtype=bool))
    response = system(arm, data, both.after[~both.arm.rows.test], np.zeros(len(both.head.phi))).response
    J = response @ both.choice.directions
    return replace(arm, covariance=arm.covariance + J @ both.choice.covariance @ J.T)


def _named(outcome: Outcome, both: ArmAndHead) -> list[NamedEffect]:
    """The head's effects and their gains: each taken out in turn, arm and head refitted to first order without it."""
    final, rows, choice = outcome.stage("final"), outcome.measurements, both.choice
    test = rows.test & ~outcome.outlier
    model = final.fit.model
    _, _, J = model.jacobian(final.fit.theta, model.rows(rows.readings, rows.covariates, rows.station))
    M = choice.directions.T @ both.equations.information[0] @ choice.directions
    found = []
    for k, e in enumerate(choice.effects):
        own = choice.of(e)
        moved = np.where(own, -choice.values, 0.0)
        moved[~own] = -np.linalg.lstsq(M[np.ix_(~own, ~own)], M[np.ix_(~own, own)] @ moved[own], rcond=None)[0]
        step = choice.directions @ moved
        before = final.residual + both.after.sensitivity @ step - J @ (both.equations.response @ step)
        found.append(
            NamedEffect(
                effect=e, declared=choice.declared[k], p_value=max(choice.p_values[k], 1e-300), before=before[test],
                after=final.residual[test], reached=final.residual, confounded_with=choice.confounded[k],
            )
        )  # fmt: skip
    return found


def _reached(outcome: Outcome, both: ArmAndHead, first: Sequence[NamedEffect]) -> np.ndarray:
    """What the constants leave of all rows with the first few effects, of the arm or the head, all refitted to first order."""
    fit, choice, rows = outcome.stage("final").fit, both.choice, outcome.measurements
    model = fit.model
    names = {c.name for e in first for c in e.effect.coefficients}
    keep = np.array([c.basis.constant or c.name in names for c in model.coefficients], dtype=bool)
    theta = refitted(fit, ~keep, keep)
    measured = observations(rows, both.campaign.measurements.noise.rows)
    prepared = model.rows(rows.readings, rows.covariates, rows.station)
    absent = np.array([c.name not in names for c in choice.coefficients], dtype=bool)
    step = choice.directions @ np.where(absent, -choice.values, 0.0)
    # The arm's answer to that step when some of its effects are not there to give it.
    scale = fit.std
    H = np.linalg.inv(fit.covariance / np.outer(scale, scale))
    answer = np.zeros(len(theta))
    pull = (H @ (both.equations.response @ step / scale))[keep]
    answer[keep] = scale[keep] * np.linalg.solve(H[np.ix_(keep, keep)], pull)
    _, _, J = model.jacobian(theta, prepared)
    return predict_residuals(model, theta, prepared, measured) + both.after.sensitivity @ step - J @ answer


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
