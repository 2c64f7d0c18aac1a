"""Is a calibration still good, and if not, what moved: a joint's zero, the tool, the base, one effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp
from scipy.stats import ncx2, norm

from aridcal.fit.problem import problem
from aridcal.inputs.dataset import Dataset
from aridcal.model.model import Rows
from aridcal.result.saved_model import SavedModel, SolvedModel
from aridcal.upkeep.evidence import TIMES, Alarm, Question, alarm, covariance_of, evidence, likely
from aridcal.upkeep.new_rows import Noise, known_noise
from aridcal.upkeep.suspects import Suspect, suspects, widened

FALSE_ALARMS = 0.01
"""Share of checks that may call a good calibration bad."""

MOST_CAUSES = 4
"""Things that may have moved together: the instrument, the tool and a joint after a crash, and one gross row."""

GROSS = tuple((10.0 ** np.arange(1.0, 4.1, 0.5)).tolist())
"""Sigmas by which one row may be off by itself: a slip of the target or of the table."""

FREE = 10.0
"""Times its most likely size that a change may have once it is accepted: it is then measured, not guessed."""

ALIKE = 4.0
"""Squares by which another cause may fit worse and still not be refuted: two sigma."""

TRIED = 300
"""Configurations looked through for one that would tell two causes apart."""

TELLS = 3.0
"""Sigmas by which the predictions of two causes must differ in one new row that tells them apart."""


@dataclass(frozen=True)
class Cause:
    """Something that moved, or that is odd with the rows.

    Attributes:
        kind: ``zero``, ``frame``, ``effect``, ``row`` or ``noise``.
        where: The joint, the frame, or the line of the file.
        words: What it is called.
        probability: Of this cause, given that there is one more.
        suspect: What moved; None for rows and noise.
        size: Of its prior once it was accepted.
        alike: Others that these rows do not refute, in words, the best first.
        told_from: The first of these that a configuration was found for, which would tell; empty where there is none.
        telling: Readings of that configuration, shape (columns,).
    """

    kind: str
    where: str
    words: str
    probability: float
    suspect: Suspect | None = None
    size: float = 0.0
    alike: tuple[str, ...] = ()
    told_from: str = ""
    telling: np.ndarray | None = None


@dataclass(frozen=True)
class Bounds:
    """The model's own position error at the rows, noise taken off, RMS of all three axes together, [m].

    Attributes:
        estimate: Most likely.
        low: Lowest that the rows allow at :data:`FALSE_ALARMS`.
        high: Highest.
    """

    estimate: float
    low: float
    high: float


@dataclass(frozen=True)
class Checked:
    """What new rows say of a calibration.

    Attributes:
        rows: The rows.
        wide: The final model with every constant that may have moved.
        noise: That the rows were expected to have.
        residual: Measured minus predicted, shape (N, m), [m] and [rad].
        first: Whether they contradict it.
        causes: What explains that, the most telling first; none without an alarm.
        rest: Whether anything is left once these are allowed for.
        question: The rows with these allowed for.
        error: The model's own error.
        tolerance: [m], if one was given.
    """

    rows: Dataset
    wide: SolvedModel
    noise: Noise
    residual: np.ndarray
    first: Alarm
    causes: tuple[Cause, ...]
    rest: Alarm
    question: Question
    error: Bounds
    tolerance: float | None

    @property
    def moved(self) -> tuple[Cause, ...]:
        """Causes that are of the robot or its frames."""
        return tuple(cause for cause in self.causes if cause.suspect is not None)

    @property
    def contradicted(self) -> bool:
        """True where the rows contradict the calibration."""
        return self.first.p_value < FALSE_ALARMS

    @property
    def good(self) -> bool:
        """True where nothing has moved; with a tolerance where the error may be within it."""
        return not self.contradicted if self.tolerance is None else self.error.low <= self.tolerance


def asked(wide: SolvedModel, rows: Dataset, noise: Noise) -> Question:
    """New rows as a question to a wide model."""
    return Question(
        problem=problem(wide.model, rows),
        theta=wide.theta,
        covariance=wide.covariance,
        sigma=noise.of_numbers(rows.channels),
        freedom=noise.freedom_of(rows.channels),
        times=1.0,
        dropped=np.zeros(len(rows), dtype=bool),
        begin=wide.theta,
    )


def check(saved: SavedModel, rows: Dataset, tolerance: float | None = None) -> Checked:
    """Set new rows beside a calibration, and name what moved.

    Args:
        saved: The calibration.
        rows: See :func:`aridcal.upkeep.new_rows.read_new_rows`.
        tolerance: Largest RMS position error that is still good, [m].

    Raises:
        CovariateNotFound: an effect depends on a column that was not measured.
        MeasurementError: a row's station is none of those that were calibrated.
    """
    wide, noise = widened(saved.final), known_noise(saved, rows)
    every = suspects(wide, rows)
    start = question = asked(wide, rows, noise)
    first = rest = alarm(question, every)
    causes: list[Cause] = []
    left = list(every)
    while rest.p_value < FALSE_ALARMS and len(causes) < MOST_CAUSES:
        cause, question = _next(saved, question, left, rows)
        causes.append(cause)
        left = [s for s in left if s is not cause.suspect]
        rest = alarm(question, left)
    residual = start.problem.residual(wide.theta)
    error = bounds(residual[:, :3], float(noise.sigma[0]))
    return Checked(rows, wide, noise, residual, first, tuple(causes), rest, question, error, tolerance)


def _next(saved: SavedModel, question: Question, left: Sequence[Suspect], rows: Dataset) -> tuple[Cause, Question]:
    """The most probable of all that could explain the rows, and the rows with it allowed for."""
    found = []
    for suspect in left:
        free = question.with_moved(suspect, suspect.sizes[-1])
        place = likely(free)
        B = place.J @ suspect.directions
        before = replace(place, known=place.J @ question.covariance @ place.J.T)
        seen = evidence(before, question.times, B, suspect.sizes)
        size = min(FREE * suspect.sizes[seen.best], suspect.sizes[-1])
        # Noise that looks larger may be what else has moved: it stays as known until it is itself the best explanation.
        freed = question.with_moved(suspect, size)
        found.append((seen.total, Cause(suspect.kind, suspect.where, suspect.words, 0.0, suspect, size), freed))
    here = likely(question)
    still = evidence(here, question.times, np.zeros((len(here.r), 0)), (1.0,))
    worse = int(np.argmax(still.density[0, 1:])) + 1
    times = TIMES[worse] * question.times
    words = f"the scatter of the rows, {times:g} times what was expected (instrument, target or reading, no part of the arm)"
    scattered = float(logsumexp(still.density[0, 1:]) - np.log(len(TIMES) - 1))
    found.append((scattered, Cause("noise", "rows", words, 0.0), replace(question, times=times)))
    numbers, count = len(question.sigma), int((~question.dropped).sum())
    for place_, row in enumerate(np.flatnonzero(~question.dropped).tolist()):
        own = np.zeros((len(here.r), numbers))
        own[place_ * numbers : (place_ + 1) * numbers] = np.eye(numbers)
        seen = evidence(here, question.times, own, GROSS)
        dropped = question.dropped.copy()
        dropped[row] = True
        line = str(rows.line[row])
        off = Cause("row", line, f"row {line} alone, which is off by itself", 0.0)
        found.append((seen.total - float(np.log(count)), off, replace(question, dropped=dropped)))
    logs = np.array([value for value, _, _ in found])
    best = int(np.argmax(logs))
    _, cause, freed = found[best]
    cause = replace(cause, probability=float(np.exp(logs[best] - logsumexp(logs))))
    if cause.suspect is None:
        return cause, freed
    alike = _alike(freed, cause.suspect, question, left)
    cause = replace(cause, alike=tuple(s.words for s, _ in alike))
    for suspect, other in alike:
        telling = _telling(saved, freed, other)
        if telling is not None:
            return replace(cause, told_from=suspect.words, telling=telling), freed
    return cause, freed


def _alike(
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
    z = solve_triangular(place.root(question.times), place.r, lower=True)
    return float(z @ z)


def _telling(saved: SavedModel, question: Question, other: Question) -> np.ndarray | None:
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


def bounds(residual: np.ndarray, sigma: float) -> Bounds:
    r"""The model's own RMS error from residuals that hold noise as well.

    Sums of squares in sigmas are :math:`\chi'^2_n(\lambda)`, with :math:`\lambda / N` the model's mean squared error: those
    values of it are kept at which what was seen is no rarer than :data:`FALSE_ALARMS`.

    Args:
        residual: Of the position, shape (N, 3), [m].
        sigma: Noise per axis, [m].
    """
    squares, count = float(np.sum(residual**2)) / sigma**2, residual.size
    scale = sigma / np.sqrt(len(residual))
    estimate = scale * np.sqrt(max(squares - count, 0.0))
    if squares > PLAIN * count:
        far = scale * float(norm.isf(FALSE_ALARMS))
        return Bounds(float(estimate), float(estimate - far), float(estimate + far))
    low, high = (_noncentrality(squares, count, share) for share in (1.0 - FALSE_ALARMS, FALSE_ALARMS))
    return Bounds(float(estimate), float(scale * np.sqrt(low)), float(scale * np.sqrt(high)))


PLAIN = 1e4
"""Times the noise's own squares beyond which the root of the sum is normal, of sigma 1, to a ten-thousandth of that."""


def _noncentrality(squares: float, count: int, share: float) -> float:
    """The noncentrality at which a share of sums of squares is below what was seen; 0 where even none makes that too few."""
    low, high = 0.0, 4.0 * (squares + count) + 100.0
    if ncx2.cdf(squares, count, low) <= share:
        return 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if ncx2.cdf(squares, count, middle) > share:
            low = middle
        else:
            high = middle
    return high


HALVINGS = 60
"""Of the interval that holds a noncentrality: to the last digits of a float."""
