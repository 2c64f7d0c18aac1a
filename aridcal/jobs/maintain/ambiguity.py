"""Causes that new rows cannot tell apart, and what to measure to tell them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.model.model import ModelRows
from aridcal.engine.robot.kinematics import joint_frames, tip_frames
from aridcal.files.read import ONE_TARGET
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.maintain.hypotheses import Hypothesis
from aridcal.jobs.maintain.likelihoods import NewRowsQuestion, covariance_of, likely
from aridcal.jobs.maintain.new_rows import LEAST_SIGMA
from aridcal.jobs.maintain.unknowns import WideModel
from aridcal.jobs.plan.clearance import clear
from aridcal.jobs.plan.prior_knowledge import bodies

NOT_REFUTED_SQUARES = 4.0
"""Squares by which another cause may fit worse and still not be refuted: two sigma."""

CONFIGURATIONS_TRIED = 300
"""Configurations looked through for one that would tell two causes apart."""

DISTINCT_SIGMAS = 3.0
"""Sigmas by which the predictions of two causes must differ in one new row that tells them apart."""


def alike(
    freed: NewRowsQuestion, named: Hypothesis, question: NewRowsQuestion, suspects: Sequence[Hypothesis]
) -> list[tuple[Hypothesis, NewRowsQuestion]]:
    """Other suspects that, free to move, explain the rows as well as the named cause; the best first."""
    reference = _squares(freed)
    explanations = []
    for suspect in suspects:
        if suspect is not named:
            other = replace(question.with_moved(suspect, suspect.sizes[-1]), times=freed.times)
            squares = _squares(other)
            if squares < reference + NOT_REFUTED_SQUARES:
                explanations.append((squares, suspect, other))
    return [(suspect, other) for _, suspect, other in sorted(explanations, key=lambda entry: entry[0])]


def _squares(question: NewRowsQuestion) -> float:
    """Squares that the most likely coefficients leave, those of what was known beforehand included."""
    place = likely(question)
    return place.squares(question.times) - 2.0 * float(place.beyond[0])


@dataclass(frozen=True)
class DecidingConfiguration:
    """A configuration to measure.

    Attributes:
        suspect: The one that it would tell from the cause, in words.
        readings: Shape (columns,), [rad] or [m].
        joints: Joints that stand farther from the rows than these reach.
    """

    suspect: str
    readings: np.ndarray
    joints: tuple[str, ...]


def deciding_configurations(
    saved: SavedModel,
    unknowns: WideModel,
    question: NewRowsQuestion,
    others: Sequence[tuple[Hypothesis, NewRowsQuestion]],
) -> tuple[DecidingConfiguration, ...]:
    """For each suspect that the rows do not refute, the configuration at which its prediction differs most from the cause's.

    Candidates are configurations in which the robot was calibrated, clear of itself and of the campaign's `keep_out`. The pose
    of the target is compared, measured as well as the calibration's own rows; where no configuration tells, none is returned.

    Args:
        saved: The calibration.
        unknowns: The wide model.
        question: The rows with what was named free to move.
        others: Each with another suspect free to move in its place.
    """
    if not others:
        return ()
    model, theta = question.problem.model, question.theta
    readings = _clear(saved)
    rows = _of_target(saved, unknowns, question, readings)
    _, _, J = model.jacobian(theta, rows)
    sigma = np.repeat(saved.scatter[0], 3)[: 6 if saved.turns else 3]
    J = J[:, : len(sigma)] / (question.times * np.maximum(sigma, LEAST_SIGMA))[:, None]
    named = likely(question)
    known = covariance_of(question, named)
    configurations = []
    for suspect, other in others:
        place = likely(other)
        difference = J @ (named.theta - place.theta)
        covariance = np.eye(J.shape[1]) + J @ (0.5 * (known + covariance_of(other, place))) @ J.transpose(0, 2, 1)
        distance = np.einsum("ni,ni->n", difference, np.linalg.solve(covariance, difference[:, :, None])[:, :, 0])
        best = int(np.argmax(distance))
        if distance[best] > DISTINCT_SIGMAS**2:
            configurations.append(
                DecidingConfiguration(suspect.words, readings[best], _elsewhere(question, readings[best]))
            )
    return tuple(configurations)


def _clear(saved: SavedModel) -> np.ndarray:
    """Readings where the robot was calibrated, in which it touches nothing, shape (n, columns)."""
    robot = saved.final.model.robot
    low, high = np.array([saved.ranges[name] for name in robot.readings]).T
    readings = np.random.default_rng(0).uniform(low, high, (CONFIGURATIONS_TRIED, len(low)))
    boxes = (saved.campaign.design.keep_out or ()) if saved.campaign is not None else ()
    places = tip_frames(robot, readings)[1] if robot.others else joint_frames(robot, readings)[1][:, -1]
    free = clear(robot, boxes, bodies(boxes, robot), readings, places)
    return readings[free] if free.any() else readings


def _of_target(saved: SavedModel, unknowns: WideModel, question: NewRowsQuestion, readings: np.ndarray) -> ModelRows:
    """The calibration's own target in some configurations, as the wide model sees them."""
    model, data = question.problem.model, question.problem.data
    n = len(readings)
    middle = {name: np.full(n, np.mean(saved.ranges[name])) for name in model.needs if name in saved.ranges}
    labels = [label for label, _ in saved.final.model.tip_target]
    label = ONE_TARGET if unknowns.renamed else labels[0]
    target = None if label is None or data.labels.target is None else np.full(n, label)
    station = None if data.labels.station is None else np.repeat(data.labels.station[:1], n)
    return model.rows(readings, middle, station, target)


def _elsewhere(question: NewRowsQuestion, readings: np.ndarray) -> tuple[str, ...]:
    """Joints of a configuration that stand farther from the middle of the rows than the rows' whole width."""
    data = question.problem.data
    middle, width = data.readings.mean(axis=0), np.ptp(data.readings, axis=0)
    far = np.abs(readings - middle) > width
    return tuple(name for name, outside in zip(data.names, far.tolist(), strict=True) if outside)
