"""The arm and the measuring head calibrated together: each in turn, until neither moves the other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.effects.catalogue import is_of_head
from aridcal.fit.closed_form import ClosedForm
from aridcal.fit.least_squares import Fit, fit
from aridcal.fit.problem import problem
from aridcal.fit.stages import Geometry
from aridcal.head.detections import Shots, posed
from aridcal.head.reduction import Head, Reduced, reduce_shots
from aridcal.inputs.campaign import Campaign
from aridcal.inputs.dataset import Dataset
from aridcal.robot.chain import Robot
from aridcal.search.arm import CalibratedArm, fit_arm, fit_constants
from aridcal.search.head_effects import Choice, System, candidates, choose, stated, system
from aridcal.showing import Progress

STEPS = 6
"""Times that the head is moved and the arm's constants follow, before effects of the arm are sought."""

ROUNDS = 3
"""Times that arm and head are searched in turn; two are usual."""

SETTLED = 0.1
"""A step of the head that is smaller than this, in its own sigmas, is the last."""


@dataclass(frozen=True)
class ArmAndHead:
    """What came of both.

    Attributes:
        campaign: The arm's job: the head's effects are not in it.
        arm: Calibrated from the poses that the head, as identified, measures.
        declared: Frames and constants from the poses that the head, as declared, measures.
        declared_rows: Those poses.
        start: The head as declared.
        head: The head as identified.
        choice: Its effects.
        equations: The last normal equations of the head's numbers.
        before: The shots reduced with the head as declared.
        after: With the head as identified.
    """

    campaign: Campaign
    arm: CalibratedArm
    declared: Geometry
    declared_rows: Dataset
    start: Head
    head: Head
    choice: Choice
    equations: System
    before: Reduced
    after: Reduced


@dataclass(frozen=True)
class HeadNumber:
    """One number of the measuring head.

    Attributes:
        name: ``camera.k1``, ``sonar_2.bias`` for instance.
        unit: ``px``, ``m`` or ``1``.
        declared: As head.yaml has it.
        value: As identified.
        std: 1-sigma; None if it was not identified.
        status: ``identified``, ``fixed`` or ``redundant``.
        redundant_with: Names of those that it is confounded with.
    """

    name: str
    unit: str
    declared: float
    value: float
    std: float | None
    status: str
    redundant_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class MeasuringHead:
    """What was found of the measuring head.

    Attributes:
        numbers: All of them.
        coefficients: Those of its effects: change from what was declared.
        misfit: RMS of what shots have beyond their poses, in sigmas: with the head as declared and as identified.
        ranges: RMS of what each sonar reads beyond the poses, likewise, shape (2, S), [m].
        fiducials: Columns of the cache of what was found in the images.
        mount: T_tip_camera as declared and as identified, shape (2, 4, 4).
        closed_form: The report's own answer on the same poses; None for an arm that is not the ARID's like.
    """

    numbers: tuple[HeadNumber, ...]
    coefficients: tuple[HeadNumber, ...]
    misfit: tuple[float, float]
    ranges: np.ndarray
    fiducials: dict[str, np.ndarray]
    mount: np.ndarray
    closed_form: ClosedForm | None = None


def fit_arm_and_head(shots: Shots, robot: Robot, labels: tuple[str, ...], progress: Progress) -> ArmAndHead:
    """Calibrate the arm and the head.

    Args:
        shots: What was seen.
        robot: The nominal chain.
        labels: All stations, where a frame is per station.
        progress: Called with what is being done.
    """
    asked = shots.campaign
    campaign = asked.model_copy(update={"effects": tuple(e for e in asked.effects if not is_of_head(e.kind))})
    declared = stated(shots.head, [e for e in asked.effects if is_of_head(e.kind)], str(asked.path))
    names = {(e.kind, e.where) for e in declared}
    sought = asked.diagnosis.candidates if asked.diagnosis.enabled else ()
    library = [e for e in candidates(shots.head, sought) if (e.kind, e.where) not in names]
    start = head = shots.head
    before = reduced = reduce_shots(shots.seen, start)
    noise = campaign.measurements.noise.rows
    first_rows = rows = posed(shots.rows, before, noise)
    train = rows.train
    progress(f"fitting frames and constants to {train.sum()} shots")
    first = geometry = fit_constants(campaign, robot, rows, labels, progress)

    def look(arm: Fit) -> tuple[System, Choice, float]:
        """Ask arm and shots about the head; how far it must move, in sigmas of what it is free to do."""
        moved = head.phi - start.phi
        equations = system(arm, rows.select(train), reduced[train], moved)
        choice = choose(equations, start, declared, library)
        step = choice.step - moved
        return equations, choice, float(np.sqrt(step @ equations.information @ step))

    arm, current = None, geometry.geometric
    for _ in range(ROUNDS):
        for _ in range(STEPS):
            equations, choice, step = look(current)
            if step < SETTLED:
                break
            progress(f"fitting the head: {', '.join(e.label for e in choice.effects)}")
            head = replace(start, phi=start.phi + choice.step)
            reduced = reduce_shots(shots.seen, head)
            rows = posed(rows, reduced, noise)
            if arm is not None:  # what the search found goes with the head as it was: it is searched anew below
                break
            current = fit(problem(current.model, rows.select(train)), current.theta)
        if arm is not None and step < SETTLED:
            break
        if not np.array_equal(head.phi, start.phi):
            geometry = fit_constants(campaign, robot, rows, labels, progress)
        arm = fit_arm(campaign, geometry, rows, progress)
        current = arm.diagnosed.fit
    assert arm is not None
    values = np.linalg.lstsq(choice.directions, head.phi - start.phi, rcond=None)[0]
    return ArmAndHead(
        campaign=campaign,
        arm=arm,
        declared=first,
        declared_rows=first_rows,
        start=start,
        head=head,
        choice=replace(choice, values=values),
        equations=equations,
        before=before,
        after=reduced,
    )
