"""Is a calibration still good, and if not, what moved: a joint's zero, the tool, the base, one effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import spread
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.coverage import EXPANSION, RECORDED_MARGIN, beyond_heat
from aridcal.engine.trust.wander import WanderProcesses, wandering
from aridcal.files.campaign import Frames
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.maintain.ambiguity import DecidingConfiguration, alike, deciding_configurations
from aridcal.jobs.maintain.bounds import FALSE_ALARMS, Bounds, error_of
from aridcal.jobs.maintain.hypotheses import Hypothesis, suspects, widened
from aridcal.jobs.maintain.likelihoods import (
    NOISE_FACTORS,
    Alarm,
    NewRowsQuestion,
    alarm,
    evidence,
    likely,
    rank_of_unknowns,
)
from aridcal.jobs.maintain.new_rows import NewRowNoise, freedom_of, new_row_noise
from aridcal.jobs.maintain.unknowns import WideModel, wide_model
from aridcal.system.errors import MeasurementError

MOST_CAUSES = 4
"""Things that may have moved together: the instrument, the tool and a joint after a crash, and one gross row."""

GROSS_SIGMAS = tuple((10.0 ** np.arange(1.0, 4.1, 0.5)).tolist())
"""Sigmas by which one row may be off by itself: a slip of the target or of the table."""

ACCEPTED_SIZE_FACTOR = 10.0
"""Times its most likely size that a change may have once it is accepted: it is then measured, not guessed."""


@dataclass(frozen=True)
class Cause:
    """Something that moved, or that is odd with the rows.

    Attributes:
        kind: ``zero``, ``frame``, ``effect``, ``row`` or ``noise``.
        where: The joint, the frame, or the line of the file.
        words: What it is called.
        probability: Of this cause, given that there is one more.
        suspect: What moved; None for rows and noise.
        size: Of the suspect's prior once it was accepted, [m], [rad] or a ratio.
        alike: Other suspects that these rows do not refute, in words, the best first.
        telling: Configurations that would tell the suspect from some of these.
    """

    kind: str
    where: str
    words: str
    probability: float
    suspect: Hypothesis | None = None
    size: float = 0.0
    alike: tuple[str, ...] = ()
    telling: tuple[DecidingConfiguration, ...] = ()


@dataclass(frozen=True)
class Heat:
    """Temperatures of rows that the calibration did not see.

    Attributes:
        column: Where they are recorded.
        rows: Lowest and highest of the rows.
        calibrated_range: Lowest and highest of the calibration's own rows.
        excess: From these to the farthest new row, [K].
        growth: Of an arm of this length over that difference, [m].
    """

    column: str
    rows: tuple[float, float]
    calibrated_range: tuple[float, float]
    excess: float
    growth: float


@dataclass(frozen=True)
class CheckResult:
    """What new rows say of a calibration.

    Attributes:
        rows: The rows.
        wide: The final model with every constant that may have moved, and with all that only these rows tell.
        noise: Expected of the rows.
        residual: Measured minus predicted, shape (N, m), in the channels' units, what only these rows tell fitted; NaN in
            channels that a row does not measure.
        first: The test of the rows against the calibration as it is.
        causes: What explains an alarm, the most telling first; none without one.
        rest: The test once these causes are allowed for.
        question: The rows with these causes allowed for.
        error: The model's own error; None where no lengths were measured.
        tolerance: [m], if one was given.
        unknowns: What of the wide model only these rows tell.
        unseen: Suspects that these rows cannot show, whatever moved.
        heat: Temperatures that the calibration did not see, if any.
    """

    rows: Dataset
    wide: SolvedModel
    noise: NewRowNoise
    residual: np.ndarray
    first: Alarm
    causes: tuple[Cause, ...]
    rest: Alarm
    question: NewRowsQuestion
    error: Bounds | None
    tolerance: float | None
    unknowns: WideModel
    unseen: tuple[Hypothesis, ...] = ()
    heat: Heat | None = None

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
        if self.tolerance is None or self.error is None:
            return not self.contradicted
        return self.error.low <= self.tolerance


def new_rows_question(
    wide: SolvedModel,
    rows: Dataset,
    noise: NewRowNoise,
    unknown: np.ndarray | None = None,
    wandering: WanderProcesses | None = None,
) -> NewRowsQuestion:
    """New rows as a question to a wide model; those that are held out do not count.

    Args:
        wide: K coefficients.
        rows: N rows.
        noise: Of their channels.
        unknown: Coefficients of which only these rows tell, shape (K,) bool; default: none.
        wandering: What the model may leave that neighbouring rows share; None: nothing.
    """
    scale, tails = noise.core
    held_out = rows.test if rows.origin.split_given else np.zeros(len(rows), dtype=bool)
    numbers = np.array([channel.size for channel in rows.channels])
    return NewRowsQuestion(
        problem=problem(wide.model, rows),
        theta=wide.theta,
        covariance=wide.covariance,
        sigma=spread(scale, rows.channels),
        freedom=freedom_of(noise, rows.measures[~held_out].sum(axis=0) * numbers),
        times=1.0,
        dropped=held_out,
        begin=wide.theta,
        unknown=np.zeros(len(wide.theta), dtype=bool) if unknown is None else unknown,
        tails=tails,
        wandering=wandering,
    )


def check(
    saved: SavedModel, rows: Dataset, tolerance: float | None = None, frames: Frames | None = None
) -> CheckResult:
    """Compare new rows with a calibration, and name what moved.

    Args:
        saved: The calibration.
        rows: See :func:`aridcal.jobs.maintain.new_rows.read_new_rows`.
        tolerance: Largest RMS position error that is still good, [m].
        frames: Of a campaign of the rows' own, where they have one: frames that it names are not as calibrated.

    Raises:
        CovariateNotFound: an effect depends on a column that was not measured.
        CampaignError: nothing is known of the noise, or a frame is named of which there are several.
        MeasurementError: a row's station is none of those that were calibrated, nothing can be said of a tolerance, or rows
            cannot tell where something is that nobody knows.
    """
    noise = new_row_noise(saved, rows, new_instrument=frames is not None)
    rows = replace(rows, covariates=saved.completed(rows.covariates, len(rows)))
    unknowns = wide_model(widened(saved.doubted), rows, frames)
    wide = unknowns.solved
    shared = wandering(saved.wanders, wide.model.robot, rows.readings, saved.ranges) if saved.wanders else None
    start = question = new_rows_question(wide, rows, noise, unknowns.unknown, shared)
    visible, unseen = visible_hypotheses(start, suspects(wide, rows, unknowns.new))
    first = rest = alarm(question, visible)
    causes: list[Cause] = []
    remaining = list(visible)
    while rest.p_value < FALSE_ALARMS and len(causes) < MOST_CAUSES:
        cause, question = _next(saved, unknowns, question, remaining, rows)
        causes.append(cause)
        remaining = [s for s in remaining if s is not cause.suspect]
        rest = alarm(question, remaining)
    residual = start.problem.residual(with_unknowns(start))
    taken = rank_of_unknowns(start.at(wide.theta)[1][:, unknowns.unknown])
    error = error_of(rows, residual, noise.sigma, ~start.dropped, taken)
    if tolerance is not None and error is None:
        raise MeasurementError(
            f"{rows.title}: a tolerance is of lengths, and these rows measure none; check without --tolerance, or measure "
            "positions, points, distances or planes"
        )
    return CheckResult(
        rows,
        wide,
        noise,
        residual,
        first,
        tuple(causes),
        rest,
        question,
        error,
        tolerance,
        unknowns,
        unseen,
        _heat(saved, rows),
    )


def _heat(saved: SavedModel, rows: Dataset) -> Heat | None:
    """The temperature column farthest outside the calibration's range, if by more than a share of that range."""
    outside = []
    for name, (low, high) in saved.seen.items():
        values = rows.covariates.get(name, np.zeros(0))
        beyond = float(np.nanmax(beyond_heat({name: values}, {name: (low, high)}), initial=0.0))
        if beyond > RECORDED_MARGIN * (high - low):
            ends = float(np.nanmin(values)), float(np.nanmax(values))
            outside.append(Heat(name, ends, (low, high), beyond, EXPANSION * beyond * saved.span))
    return max(outside, key=lambda heat: heat.excess, default=None)


def with_unknowns(question: NewRowsQuestion) -> np.ndarray:
    """Coefficients (K,) of the calibration as it is, with what only the new rows tell fitted to them."""
    if not question.unknown.any():
        return question.theta
    free = np.where(question.unknown, np.diag(question.covariance), 0.0)
    return likely(replace(question, covariance=np.diag(free))).theta


def visible_hypotheses(
    question: NewRowsQuestion, suspects_asked: Sequence[Hypothesis]
) -> tuple[tuple[Hypothesis, ...], tuple[Hypothesis, ...]]:
    """Suspects that rows can show, and those that unknowns hide: the base, say, where the points around it are unknown."""
    if not question.unknown.any():
        return tuple(suspects_asked), ()
    _, J = question.at(question.theta)
    U = J[:, question.unknown]
    before = rank_of_unknowns(U)
    visible = [rank_of_unknowns(np.hstack([U, J @ suspect.directions])) > before for suspect in suspects_asked]
    return (
        tuple(s for s, seen in zip(suspects_asked, visible, strict=True) if seen),
        tuple(s for s, seen in zip(suspects_asked, visible, strict=True) if not seen),
    )


def _next(
    saved: SavedModel,
    unknowns: WideModel,
    question: NewRowsQuestion,
    suspects_left: Sequence[Hypothesis],
    rows: Dataset,
) -> tuple[Cause, NewRowsQuestion]:
    """The most probable cause of what the rows show, and the question with this cause allowed for."""
    explanations = []
    for suspect in suspects_left:
        free = question.with_moved(suspect, suspect.sizes[-1])
        place = likely(free)
        B = place.J @ suspect.directions
        before = replace(place, known_covariance=place.J @ question.covariance @ place.J.T + place.shared)
        support = evidence(before, question.times, B, suspect.sizes)
        size = min(ACCEPTED_SIZE_FACTOR * suspect.sizes[support.best], suspect.sizes[-1])
        # Another moved part looks like larger noise: the noise stays as known until it is itself the best explanation.
        freed = question.with_moved(suspect, size)
        explanations.append(
            (support.total, Cause(suspect.kind, suspect.where, suspect.words, 0.0, suspect, size), freed)
        )
    likeliest, row_of = likely(question), question.rows
    as_noise = evidence(likeliest, question.times, np.zeros((len(likeliest.r), 0)), (1.0,))
    noisier = int(np.argmax(as_noise.density[0, 1:])) + 1
    factor = NOISE_FACTORS[noisier] * question.times
    words = f"the scatter of the rows, {factor:g} times what was expected (instrument, target or reading, no part of the arm)"
    scattered = float(logsumexp(as_noise.density[0, 1:]) - np.log(len(NOISE_FACTORS) - 1))
    explanations.append((scattered, Cause("noise", "rows", words, 0.0), replace(question, times=factor)))
    rows_counting = np.unique(row_of).tolist()
    for row in rows_counting:
        support = evidence(likeliest, question.times, np.diag(likeliest.root)[:, row_of == row], GROSS_SIGMAS)
        dropped = question.dropped.copy()
        dropped[row] = True
        line = str(rows.origin.line[row])
        gross = Cause("row", line, f"row {line} alone, which is off by itself", 0.0)
        explanations.append(
            (support.total - float(np.log(len(rows_counting))), gross, replace(question, dropped=dropped))
        )
    log_evidence = np.array([value for value, _, _ in explanations])
    best = int(np.argmax(log_evidence))
    _, cause, freed = explanations[best]
    cause = replace(cause, probability=float(np.exp(log_evidence[best] - logsumexp(log_evidence))))
    if cause.suspect is None:
        return cause, freed
    others = alike(freed, cause.suspect, question, suspects_left)
    configurations = deciding_configurations(saved, unknowns, freed, others)
    return replace(cause, alike=tuple(s.words for s, _ in others), telling=configurations), freed
