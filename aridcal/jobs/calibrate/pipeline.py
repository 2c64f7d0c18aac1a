"""From a campaign to its outcome: read, fit, search, score. Nothing is written."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from aridcal.engine.fit.constants import constants_of_question, station_labels, unused_links
from aridcal.engine.fit.flags import distance, robust_sigma
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.noise import RepeatScatter, declared_notices, repeats
from aridcal.engine.fit.problem import problem, scaled, unscaled
from aridcal.engine.fit.stages import Geometry, recentred, with_things_moved
from aridcal.engine.model.memory import Size, available_memory, check_memory
from aridcal.engine.model.rigid_bodies import targets_of_one_body
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.approach import with_directions
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups
from aridcal.engine.search.declared_effects import CONFOUNDED_SENTENCE, NOT_BETTER_HELD_BACK
from aridcal.engine.search.diagnose import MOST_SEARCHED_ROWS, SearchResult
from aridcal.engine.search.loop import (
    LEAST_NUMBERS_LEFT,
    CalibratedArm,
    calibrated_arm,
    fit_constants,
    is_short,
    structured_notices,
)
from aridcal.engine.search.noise_tests import MOST_TESTED_ROWS, TESTED_STRETCHES, Clue, clues, stretches
from aridcal.engine.search.residual_trends import trace
from aridcal.engine.trust.certainty import certainty
from aridcal.engine.trust.gains import explain
from aridcal.engine.trust.second_look import second_look
from aridcal.engine.trust.uncertainty import (
    GROSS_OUTLIER_SCALES,
    outliers,
    precision,
    realigned,
    with_contradicted_noise,
)
from aridcal.files.campaign import Campaign
from aridcal.files.quantities import computed
from aridcal.files.read import load_measurements
from aridcal.files.tables import AnyTable
from aridcal.jobs.calibrate.doty_answer import closed_form_starts
from aridcal.jobs.calibrate.gravity_direction import gravity_direction
from aridcal.jobs.calibrate.groups import LEAST_SHARE, groups
from aridcal.jobs.calibrate.job_inputs import CalibrationJob, read_job, redetect_fiducials
from aridcal.jobs.calibrate.limb_redundancies import limb_redundancies
from aridcal.jobs.calibrate.measuring_head import identified_lens, measuring_head
from aridcal.jobs.calibrate.outcome import Outcome, Stage, Verification
from aridcal.jobs.calibrate.tolerance_region import region, requirement
from aridcal.jobs.calibrate.verdict import Verdict, decide, row_clues
from aridcal.jobs.head1992.observations import Detections
from aridcal.system.errors import MeasurementError, NotOfThisRobot
from aridcal.system.progress import SILENT, Progress
from aridcal.system.reading.memory_release import give_back_of

Judge = Callable[[Campaign, Robot, Dataset, Geometry | None], None]
"""Gets the rows and the fit of frames and constants, None if there is none; may refuse the rows and say why."""

LEAST_NUMBERS = 3
"""Numbers of a row that are not equal twice by chance; a gauge's one, to hundredths of a millimetre, often is."""

COPY_TOLERANCE = 1e-8
"""Work: [rad] or [m]: joints and measurement of a copy differ by less; it may have been written with other digits."""

TRACED_ROWS = 50_000
"""Work: Rows at the most whose residuals are traced to joints and columns: these tell it by a chance of 1e-300."""

ONE_BODY = (
    "{} targets keep their distances exactly: they were made from one pose of one body, and count as one measurement"
)
"""Notice on such targets: their errors are the same, so that three of them know no more than one."""

NOT_SOUGHT = (
    "effects were not sought: {:.0f} % of the measured numbers are left to judge a model by, and {:.0f} % are needed"
)
"""Notice where rows are too few for a search."""

NO_MEASUREMENT = (
    "{} are what the controller's own model makes of its joints, and no measurement: a calibration to them gives that "
    "model back"
)
"""Notice where the columns of a campaign are those of a controller."""

ONE_PLACE = "the {} rows lie in {} places, and those of one place err alike: they count as {:.0f} independent ones"


@dataclass(frozen=True)
class JudgedArm:
    """A calibrated arm with what may be said of it.

    Attributes:
        stages: nominal, geometric, final.
        outlier: Flagged rows, shape (N,).
        repeats: Rows that repeat a configuration; None where there are none.
        clues: Answers of all tests of the residual.
        verdict: The decision.
    """

    stages: tuple[Stage, ...]
    outlier: np.ndarray
    repeats: RepeatScatter | None
    clues: tuple[Clue, ...]
    verdict: Verdict


def identify(
    job: Path | Campaign | CalibrationJob,
    seed: int = 0,
    verify: AnyTable | None = None,
    progress: Progress = SILENT,
    cache: Path | None = None,
    judge: Judge = lambda *_: None,
    choose: Callable[[Dataset], Dataset] = lambda rows: rows,
) -> Outcome:
    """Run a campaign up to its outcome.

    Args:
        job: The campaign, the path of its ``campaign.yaml``, or the job that was read from it already.
        seed: Of the split into train and test, where the table has none.
        verify: Another day's table, to be scored.
        progress: Called with what is being done.
        cache: ``fiducials.csv`` of an earlier run on the same images, if there is one.
        judge: Called with the rows and their first fit before effects are sought.
        choose: From all rows of the job to the rows to calibrate from.

    Raises:
        AridcalError: whatever in the input needs mending.
    """
    if not isinstance(job, CalibrationJob):
        job = read_job(job, seed, progress, cache, verify is not None)
    # read before the work is done, so that a table of the campaign's own rows is refused at once
    verification_rows = None if verify is None else read_verification(job.campaign, job.robot, job.rows, verify)
    arm, where = _calibrated(job, choose, judge, progress)
    lens = (
        None if job.detections is None else identified_lens(arm.geometry.geometric, arm.diagnosed.fit, job.detections)
    )
    if lens is not None:
        progress("looking for the fiducials again, with the lens that was found")
        job = redetect_fiducials(job, lens, progress)
        arm, where = _calibrated(job, choose, judge, progress)
    outcome = _outcome(job.campaign, job.robot, arm, where, job.still, job.detections, progress)
    if verification_rows is not None:
        progress("scoring another day's measurements")
        outcome = replace(outcome, verification=_scored(outcome, *verification_rows))
    return replace(outcome, seconds=time.perf_counter() - job.started)


def _calibrated(
    job: CalibrationJob, choose: Callable[[Dataset], Dataset], judge: Judge, progress: Progress
) -> tuple[CalibratedArm, np.ndarray | None]:
    """The calibrated arm of a job, and the readings of the region that its campaign names; see :func:`identify`."""
    campaign, robot, rows = job.campaign, job.robot, choose(job.rows)
    question = replace(campaign.question, starts=closed_form_starts)
    labels = station_labels(question, rows)
    check_memory(_size(campaign, robot, rows), str(campaign.path), available_memory())
    progress(f"fitting frames and constants to {rows.train.sum()} rows")
    try:
        geometry = fit_constants(question, robot, rows, labels, progress)
    except NotOfThisRobot:
        judge(campaign, robot, rows, None)
        raise
    judge(campaign, robot, rows, geometry)
    where = region(campaign, geometry.geometric, rows.fitted)
    give_back_of(len(rows))
    return calibrated_arm(question, robot, rows, labels, geometry, progress), where


def _outcome(
    campaign: Campaign,
    robot: Robot,
    arm: CalibratedArm,
    where: np.ndarray | None,
    still: tuple[str, ...],
    detections: Detections | None,
    progress: Progress,
) -> Outcome:
    """Score every stage of a calibrated arm, and examine what remains."""
    progress("scoring")
    rows, diagnosed = arm.rows, arm.diagnosed
    give_back_of(len(rows))  # what the fits took: here and below the most memory is wanted
    train = rows.fitted
    judgement = judge_arm(arm, progress)
    stages, outlier, final = judgement.stages, judgement.outlier, judgement.stages[-1].fit
    inliers = rows.select(~outlier)
    traced = np.flatnonzero(~outlier)[stretches(inliers.sequence, TRACED_ROWS)]
    progress("fitting halves of the rows apart")
    look = second_look(stages[1].fit, diagnosed.fit, train, progress)
    constants = constants_of_question(campaign.question, robot, rows)
    progress("working out how well the target is known")
    give_back_of(len(rows))
    certain = certainty(
        requirement(campaign), final, rows, constants, where, outlier, stages[-1].residual, judgement.repeats
    )
    stages = refit_with_final_instruments(stages, train)
    head = None if detections is None else measuring_head(final, stages[1].fit, rows, rows.train & ~outlier, detections)
    known_to = precision(final, train)
    give_back_of(len(rows))
    return Outcome(
        campaign=campaign,
        robot=robot,
        measurements=rows,
        stages=stages,
        outlier=outlier,
        noise=final.sigma,
        noise_source="declared" if all(rows.sigma) else "estimated",
        repeats=judgement.repeats,
        precision=known_to,
        second_look=look,
        certainty=certain,
        verdict=judgement.verdict,
        causes=arm.causes,
        notices=(
            *(head.notices if head is not None else ()),
            *(NO_MEASUREMENT.format(", ".join(own)) for block in campaign.blocks if (own := computed(block))),
            *still,
            *([arm.geometry.kept] if arm.geometry.kept else []),
            *_shared(rows, final),
            *structured_notices(arm.causes),
            *_derived_notices(rows, diagnosed),
            *(
                f"{b.what} is left out: {b.why}"
                for b in diagnosed.barred
                if b.why in (CONFOUNDED_SENTENCE, NOT_BETTER_HELD_BACK)
            ),
            *_searched(train, len(inliers), campaign, arm.geometry.geometric),
            *declared_notices(rows, final.estimated, final.freedom),
            *unused_links(robot, campaign.parameters.set),
            *limb_redundancies(arm.geometry.geometric),
            *(str(n) for n in rows.origin.notices),
        ),
        seconds=0.0,
        traces=trace(final, rows.select(traced), stages[1].residual[traced], stages[2].residual[traced], progress),
        diagnosis=explain(diagnosed, rows, rows.test & ~outlier, judgement.clues),
        head=head,
    )


def _shared(rows: Dataset, final: Fit) -> Iterator[str]:
    """Sentences on rows that count for less than one each, since they are not independent."""
    bodies = targets_of_one_body(rows, float(final.estimated[0]))
    if bodies > 1:
        yield ONE_BODY.format(bodies)
    elif rows.repeats.share < 1.0:
        place = held_back_groups(rows)
        yield ONE_PLACE.format(len(rows), place.max() + 1, rows.repeats.share * len(rows))


def _searched(train: Dataset, inliers: int, campaign: Campaign, geometric: Fit) -> Iterator[str]:
    """Sentences on questions put to a part of many rows only, and on a search for which there are too few rows."""
    sought = campaign.diagnosis.enabled and bool(campaign.diagnosis.candidates)
    if sought and is_short(geometric):
        yield NOT_SOUGHT.format(100.0 * _freedom(geometric), 100.0 * LEAST_NUMBERS_LEFT)
    elif sought and len(train) > MOST_SEARCHED_ROWS:
        factor = np.sqrt(len(train) / MOST_SEARCHED_ROWS)
        yield (
            f"effects were sought in {MOST_SEARCHED_ROWS:,} of the {len(train):,} fitted rows, and then fitted to all: to be "
            f"seen, one "
            f"must be {factor:.1f} times as large as in a search of all rows"
        )
    if inliers > MOST_TESTED_ROWS:
        tested_rows = f"{MOST_TESTED_ROWS:,} of {inliers:,} rows, in {TESTED_STRETCHES} stretches on end"
        yield f"whether what remains is noise was asked of {tested_rows}"


def refit_with_final_instruments(stages: tuple[Stage, ...], train: Dataset) -> tuple[Stage, ...]:
    """The stages, the geometric constants refitted with the instruments of the final stage: they go into the URDF.

    The residual of the geometric stage stays that with the instruments as declared.
    """
    nominal, geometric, final = stages
    model = with_things_moved(geometric.fit, final.fit)
    if model is None:
        return stages
    refit = recentred(fit(problem(model, train), geometric.fit.theta))
    geometric_fit = replace(refit, candidates=geometric.fit.candidates, redundant=geometric.fit.redundant)
    return nominal, replace(geometric, fit=geometric_fit), final


def judge_arm(arm: CalibratedArm, progress: Progress = SILENT) -> JudgedArm:
    """Fit every stage with the final model's flags, put all questions to the residuals, and decide on the verdict."""
    rows = arm.rows
    stages, outlier = _stages(rows, arm.geometry, arm.diagnosed.fit, progress)
    final, last = stages[-1].fit, stages[-1].residual
    inliers, residual = rows.select(~outlier), scaled(last, rows.relative)
    white, raw = (r[~outlier] if outlier.any() else r for r in (residual, last))
    # Repeats are compared with the residuals that they are part of: both are divided by the known noise of the rows.
    # Of several targets of one body one row counts: the others err like it, whatever the model.
    one_each = inliers, white
    if rows.repeats.share < 1.0:
        first = np.unique(held_back_groups(inliers), return_index=True)[1]
        one_each = inliers.select(first), white[first]
    answers = clues(*one_each, repeats(inliers, white), _freedom(final), final, progress)
    answers += row_clues(rows, final, residual, outlier)
    answers += _groups(rows, final, residual, outlier)
    effects = [active.effect for active in arm.diagnosed.stepwise.state.active]
    scatter = repeats(inliers, raw)
    freedom = np.zeros(len(rows.channels)) if scatter is None else scatter.freedom
    noise_known = all(s is not None or f > 0 for s, f in zip(rows.sigma, freedom.tolist(), strict=True))
    setting = gravity_direction(arm.geometry.geometric, rows.fitted)
    verdict = decide(answers, effects, min(_freedom(final), arm.geometry.free), noise_known, setting)
    return JudgedArm(stages, outlier, scatter, tuple(answers), verdict)


def _groups(rows: Dataset, final: Fit, residual: np.ndarray, outlier: np.ndarray) -> list[Clue]:
    """Whether some rows are shifted by one vector; of rows that are not independent one counts.

    A group that stands far out is flagged row by row: if it is large enough, flagged rows are looked at, too.
    """
    some = np.ones(len(rows), dtype=bool) if outlier.mean() >= LEAST_SHARE else ~outlier
    if rows.repeats.share < 1.0:
        some = np.flatnonzero(some)[np.unique(held_back_groups(rows.select(some)), return_index=True)[1]]
    elif some.all():  # of many rows a copy counts
        return groups(rows, residual, final)
    return groups(rows.select(some), residual[some], final)


def _derived_notices(rows: Dataset, diagnosed: SearchResult) -> tuple[str, ...]:
    """Sentences on effects of a side of approach that was derived from the order of the rows."""
    needed = [
        name for a in diagnosed.stepwise.state.active for name in a.effect.covariates if name in rows.origin.derived
    ]
    return tuple(
        f"{name} is derived from the order of the rows: predict takes the middle between both sides where a table lacks it"
        for name in dict.fromkeys(needed)
    )


def _freedom(fit: Fit) -> float:
    """Degrees of freedom of a fit, as a share of the measured numbers."""
    return float(1.0 - fit.spent / max(fit.numbers, 1.0))


def _size(campaign: Campaign, robot: Robot, rows: Dataset) -> Size:
    """Size of a calibration, for the forecast of its memory."""
    question = campaign.question
    return Size(
        coefficients=len(constants_of_question(question, robot, rows)),
        stations=len(station_labels(question, rows)),
        rows=len(rows),
        searched=min(int(rows.train.sum()), MOST_SEARCHED_ROWS) if question.sought else 0,
        numbers=sum(channel.size for channel in rows.channels),
        joints=len(robot.joints),
    )


def _stages(rows: Dataset, geometry: Geometry, final: Fit, progress: Progress) -> tuple[tuple[Stage, ...], np.ndarray]:
    """Every stage fitted with the final model's flags, and the flags of all rows."""
    train = rows.fitted
    stages: list[Stage] = []
    for name, stage_fit in (("nominal", geometry.nominal), ("geometric", geometry.geometric), ("final", final)):
        if not np.array_equal(stage_fit.outliers, final.outliers):
            refit = fit(problem(stage_fit.model, train, progress), stage_fit.theta, final.weight)
            tried = {"restarts": stage_fit.convergence.restarts, "agreed": stage_fit.convergence.agreed}
            convergence = replace(refit.convergence, **tried)
            stage_fit = replace(
                refit, candidates=stage_fit.candidates, redundant=stage_fit.redundant, convergence=convergence
            )
        stage_fit = recentred(with_contradicted_noise(stage_fit, train, progress) if name == "final" else stage_fit)
        same = bool(stages) and _alike(stages[-1].fit, stage_fit)
        residual = stages[-1].residual if same else problem(stage_fit.model, rows).residual(stage_fit.theta)
        stages.append(Stage(name, stage_fit, residual))
    residuals = [scaled(stage.residual, rows.relative) for stage in stages]
    return tuple(stages), outliers(rows.train, final.outliers, residuals, rows.channels)


def _alike(one: Fit, other: Fit) -> bool:
    """True if two fits predict the same: a search without result leaves the model as it is."""
    model, other_model = one.model, other.model
    if model.states or other_model.states or model.around is not other_model.around:
        return False
    frames = model.world_base == other_model.world_base and model.tip_target == other_model.tip_target
    return frames and model.coefficients == other_model.coefficients and np.array_equal(one.theta, other.theta)


def score(outcome: Outcome, table: AnyTable) -> Verification:
    """Score another day's table with the models as they are, and with the two frames fitted anew.

    Args:
        outcome: The models.
        table: Measurements in the columns and units of the campaign's own.

    Raises:
        AridcalError: the table needs mending, or is the campaign's own.
    """
    return _scored(outcome, *read_verification(outcome.campaign, outcome.robot, outcome.measurements, table))


def read_verification(campaign: Campaign, robot: Robot, campaign_rows: Dataset, table: AnyTable) -> tuple[Dataset, int]:
    """Read another day's rows.

    Args:
        campaign: Says how the table is written.
        robot: The nominal chain.
        campaign_rows: The campaign's own rows, fitted and held out.
        table: Measurements in the columns and units of the campaign's own.

    Returns:
        The rows that the campaign does not have itself, and how many it has, which are left out.

    Raises:
        AridcalError: the table needs mending, or it has the campaign's own rows alone.
    """
    limits, kinds = robot.limits, robot.kinds
    rows = with_directions(
        load_measurements(campaign, robot.readings, limits, kinds, robot=robot, files=[table], fitted=False)
    )
    copied = _copied(rows, campaign_rows)
    if copied.all() or rows.origin.sha256 == campaign_rows.origin.sha256:
        raise MeasurementError(
            f"{rows.title}: all {len(rows)} rows are the campaign's own, with the same joints and the same measurements, "
            "and say nothing of another day. Give --verify what was measured at another time; how well held-out rows are met "
            "is in the report without it"
        )
    return rows.select(~copied), int(copied.sum())


def _copied(rows: Dataset, campaign_rows: Dataset) -> np.ndarray:
    """Rows whose joints and measurement are in another data set, too, shape (N,) bool."""
    from scipy.spatial import cKDTree  # slow to load

    width = max(rows.observed.shape[1], campaign_rows.observed.shape[1])
    nearest, _ = cKDTree(_numbers(campaign_rows, width)).query(
        _numbers(rows, width), p=np.inf, distance_upper_bound=COPY_TOLERANCE
    )
    tells = np.isfinite(rows.observed).sum(axis=1) >= LEAST_NUMBERS
    return np.asarray(np.isfinite(nearest) & tells)


def _numbers(rows: Dataset, width: int) -> np.ndarray:
    """Joints and measurement of each row, the measurement padded to ``width`` numbers, shape (N, columns + width)."""
    observed = np.full((len(rows), width), np.nan)
    observed[:, : rows.observed.shape[1]] = rows.observed
    return np.nan_to_num(np.hstack([rows.readings, observed]), nan=-1e9)  # a hole is near another hole only


def _scored(outcome: Outcome, rows: Dataset, copied: int) -> Verification:
    stage_problems = {stage.name: (problem(stage.fit.model, rows), stage.fit) for stage in outcome.stages}
    after_realigning = realigned(stage_problems["final"][1], stage_problems["final"][0])
    outlier = (
        distance(after_realigning, robust_sigma(after_realigning, rows.channels), rows.channels) > GROSS_OUTLIER_SCALES
    )
    residuals = {
        name: fit_problem.residual(stage_fit.theta) for name, (fit_problem, stage_fit) in stage_problems.items()
    }
    return Verification(
        rows.origin.files[0].name, rows, residuals, outlier, unscaled(after_realigning, rows.relative), copied
    )
