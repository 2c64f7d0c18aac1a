"""Causes that new rows cannot tell apart, and what to measure to tell them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aridcal.model.model import Rows
from aridcal.result.saved_model import SavedModel
from aridcal.upkeep.evidence import Question, covariance_of, likely
from aridcal.upkeep.suspects import Suspect

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
    return likely(question).squares(question.times)


def telling(saved: SavedModel, question: Question, other: Question) -> np.ndarray | None:
    """Readings (columns,) at which two explanations differ most, of some within what was calibrated; None if too little."""
    model = question.problem.model
    robot = model.robot
    rng = np.random.default_rng(0)
    low, high = np.array([saved.ranges[name] for name in robot.readings]).T
    readings = rng.uniform(low, high, (TRIED, len(low)))
    middle = {name: np.full(TRIED, np.mean(saved.ranges[name])) for name in model.needs if name in saved.ranges}
    given: Rows = question.problem.rows
    rows = replace(
        model.rows(readings, middle, *_labels(question)),
        world=np.full(TRIED, given.world[0]),
        tip=np.full(TRIED, given.tip[0]),
    )
    _, _, J = model.jacobian(question.theta, rows)
    J = J[:, : len(question.sigma)] / (question.times * question.sigma)[:, None]
    places = likely(question), likely(other)
    apart = J @ (places[0].theta - places[1].theta)
    covariance = 0.5 * (covariance_of(question, places[0]) + covariance_of(other, places[1]))
    sure = np.eye(J.shape[1]) + J @ covariance @ J.transpose(0, 2, 1)
    distance = np.einsum("ni,ni->n", apart, np.linalg.solve(sure, apart[:, :, None])[:, :, 0])
    best = int(np.argmax(distance))
    return readings[best] if distance[best] > TELLS**2 else None


def _labels(question: Question) -> tuple[np.ndarray | None]:
    """Station of each configuration tried: that of the first row."""
    station = question.problem.data.station
    return (None if station is None else np.repeat(station[:1], TRIED),)
