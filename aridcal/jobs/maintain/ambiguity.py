"""Causes that new rows cannot tell apart, and what to measure to tell them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.model.model import Rows
from aridcal.engine.robot.kinematics import joint_frames, tip_frames
from aridcal.files.read import ONE_TARGET
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.maintain.hypotheses import Suspect
from aridcal.jobs.maintain.likelihoods import Question, covariance_of, likely
from aridcal.jobs.maintain.new_rows import LEAST
from aridcal.jobs.maintain.unknowns import Wide
from aridcal.jobs.plan.beforehand import bodies
from aridcal.jobs.plan.clearance import clear

ALIKE = 4.0
"""Squares by which another cause may fit worse and still not be refuted: two sigma."""

TRIED = 300
"""Configurations looked through for one that would tell two causes apart."""

TELLS = 3.0
"""Sigmas by which the predictions of two causes must differ in one new row that tells them apart."""


def alike(
    freed: Question, named: Suspect, question: Question, left: Sequence[Suspect]
) -> list[tuple[Suspect, Question]]:
    """Other suspects that, free to move, explain the rows as well as the one that was named; the best first."""
    reference = _squares(freed)
    found = []
    for suspect in left:
        if suspect is not named:
            other = replace(question.with_moved(suspect, suspect.sizes[-1]), times=freed.times)
            squares = _squares(other)
            if squares < reference + ALIKE:
                found.append((squares, suspect, other))
    return [(suspect, other) for _, suspect, other in sorted(found, key=lambda entry: entry[0])]


def _squares(question: Question) -> float:
    """Squares that the most likely coefficients leave, those of what was known beforehand included."""
    place = likely(question)
    return place.squares(question.times) - 2.0 * float(place.beyond[0])


@dataclass(frozen=True)
class Telling:
    """A configuration to measure.

    Attributes:
        suspect: What it would tell apart from what was named, in words.
        readings: Shape (columns,), [rad] or [m].
        joints: Those that stand farther from the rows than these reach.
    """

    suspect: str
    readings: np.ndarray
    joints: tuple[str, ...]


def telling(
    saved: SavedModel, unknowns: Wide, question: Question, others: Sequence[tuple[Suspect, Question]]
) -> tuple[Telling, ...]:
    """For each explanation that the rows do not refute, the configuration at which it differs most from the one named.

    Looked through are some in which the robot was calibrated, clear of itself and of what the campaign keeps it out of. What is
    compared is the pose of the target, measured as well as the calibration's own rows; where no configuration tells, none is
    given.

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
    J = J[:, : len(sigma)] / (question.times * np.maximum(sigma, LEAST))[:, None]
    named = likely(question)
    known = covariance_of(question, named)
    found = []
    for suspect, other in others:
        place = likely(other)
        apart = J @ (named.theta - place.theta)
        sure = np.eye(J.shape[1]) + J @ (0.5 * (known + covariance_of(other, place))) @ J.transpose(0, 2, 1)
        distance = np.einsum("ni,ni->n", apart, np.linalg.solve(sure, apart[:, :, None])[:, :, 0])
        best = int(np.argmax(distance))
        if distance[best] > TELLS**2:
            found.append(Telling(suspect.words, readings[best], _elsewhere(question, readings[best])))
    return tuple(found)


def _clear(saved: SavedModel) -> np.ndarray:
    """Readings where the robot was calibrated, in which it touches nothing, shape (n, columns)."""
    robot = saved.final.model.robot
    low, high = np.array([saved.ranges[name] for name in robot.readings]).T
    readings = np.random.default_rng(0).uniform(low, high, (TRIED, len(low)))
    boxes = (saved.campaign.design.keep_out or ()) if saved.campaign is not None else ()
    places = tip_frames(robot, readings)[1] if robot.others else joint_frames(robot, readings)[1][:, -1]
    good = clear(robot, boxes, bodies(boxes, robot), readings, places)
    return readings[good] if good.any() else readings


def _of_target(saved: SavedModel, unknowns: Wide, question: Question, readings: np.ndarray) -> Rows:
    """The calibration's own target in some configurations, as the wide model sees them."""
    model, data = question.problem.model, question.problem.data
    n = len(readings)
    middle = {name: np.full(n, np.mean(saved.ranges[name])) for name in model.needs if name in saved.ranges}
    known = [label for label, _ in saved.final.model.tip_target]
    label = ONE_TARGET if unknowns.renamed else known[0]
    target = None if label is None or data.labels.target is None else np.full(n, label)
    station = None if data.labels.station is None else np.repeat(data.labels.station[:1], n)
    return model.rows(readings, middle, station, target)


def _elsewhere(question: Question, readings: np.ndarray) -> tuple[str, ...]:
    """Joints of a configuration that stand farther from the middle of the rows than these do from each other."""
    data = question.problem.data
    middle, width = data.readings.mean(axis=0), np.ptp(data.readings, axis=0)
    far = np.abs(readings - middle) > width
    return tuple(name for name, apart in zip(data.names, far.tolist(), strict=True) if apart)
