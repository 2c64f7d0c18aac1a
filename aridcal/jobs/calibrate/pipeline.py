"""From a campaign to its outcome: read, fit, search, score. Nothing is written."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from aridcal.engine.fit.constants import asked_constants, station_labels, unused_links
from aridcal.engine.fit.flags import distance, robust_sigma
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.noise import Repeats, declared_notices, repeats
from aridcal.engine.fit.problem import problem, scaled, unscaled
from aridcal.engine.fit.stages import Geometry, recentred, with_things_moved
from aridcal.engine.model.memory import Size, available_memory, check_memory
from aridcal.engine.model.rigid_bodies import targets_of_one_body
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.approach import with_directions
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_together
from aridcal.engine.search.declared import CONFOUNDED, NO_BETTER
from aridcal.engine.search.diagnose import SEARCHED, Diagnosed
from aridcal.engine.search.loop import (
    LEAST_FREEDOM,
    CalibratedArm,
    calibrated_arm,
    fit_constants,
    is_short,
    structured_notices,
)
from aridcal.engine.search.noise_tests import ASKED, STRETCHES, Clue, clues, stretches
from aridcal.engine.search.residual_trends import trace
from aridcal.engine.trust.certainty import certainty
from aridcal.engine.trust.gains import explain
from aridcal.engine.trust.second_look import second_look
from aridcal.engine.trust.uncertainty import FAR, outliers, precision, realigned, with_noise_seen
from aridcal.files.campaign import Campaign
from aridcal.files.quantities import computed
from aridcal.files.read import load_measurements
from aridcal.files.tables import AnyTable
from aridcal.jobs.calibrate.gravity_direction import gravity_direction
from aridcal.jobs.calibrate.groups import LEAST, groups
from aridcal.jobs.calibrate.job_inputs import Job, looked_again, read_job
from aridcal.jobs.calibrate.limb_redundancies import limb_redundancies
from aridcal.jobs.calibrate.measuring_head import lens_found, measuring_head
from aridcal.jobs.calibrate.outcome import Outcome, Stage, Verification
from aridcal.jobs.calibrate.region import region, wanted
from aridcal.jobs.calibrate.verdict import Verdict, decide, row_clues
from aridcal.jobs.head1992.observations import Detections
from aridcal.system.errors import MeasurementError, NotOfThisRobot
from aridcal.system.progress import SILENT, Progress
from aridcal.system.reading.freed import give_back

Judge = Callable[[Campaign, Robot, Dataset, Geometry | None], None]
"""Told what frames and constants leave of the rows, None if nothing can be made of them; may refuse them and say why."""

TELLING = 3
"""Numbers of a row that are not equal twice by chance; a gauge's one, to hundredths of a millimetre, often is."""

SAME = 1e-8
"""Work: By less than that, in [rad] or [m], joints and what was measured differ in a copy, which may have been written anew."""

TRACED = 50_000
"""Work: Rows whose residuals are traced to joints and columns, of more: what those tell by a chance of 1e-300 others need
not."""

ONE_BODY = (
    "{} targets keep their distances exactly: they were made from one pose of one body, and count as one measurement"
)
"""What is said of them: their errors are the same, so that three of them know no more than one."""

NOT_SOUGHT = (
    "effects were not sought: {:.0f} % of the measured numbers are left to judge a model by, and {:.0f} % are needed"
)
"""What is said where rows are too few for a search."""

NO_MEASUREMENT = (
    "{} are what the controller's own model makes of its joints, and no measurement: a calibration to them gives that "
    "model back"
)
"""What is said where the columns of a campaign are those of a controller."""

ONE_PLACE = "the {} rows lie in {} places, and those of one place err alike: they count as {:.0f} independent ones"


@dataclass(frozen=True)
class Judged:
    """A calibrated arm with what may be said of it.

    Attributes:
        stages: nominal, geometric, final.
        outlier: Flagged rows, shape (N,).
        repeats: Rows that repeat a configuration; None where there are none.
        clues: Answers of all questions to the residual.
        verdict: The decision.
    """

    stages: tuple[Stage, ...]
    outlier: np.ndarray
    repeats: Repeats | None
    clues: tuple[Clue, ...]
    verdict: Verdict


def identify(
    job: Path | Campaign | Job,
    seed: int = 0,
    verify: AnyTable | None = None,
    progress: Progress = SILENT,
    cache: Path | None = None,
    judge: Judge = lambda *_: None,
    choose: Callable[[Dataset], Dataset] = lambda rows: rows,
) -> Outcome:
    """Run a campaign up to its outcome.

    Args:
        job: The campaign, the path of its ``campaign.yaml``, or what was read of it already.
        seed: Of the split into train and test, where the table has none.
        verify: Another day's table, to be scored.
        progress: Called with what is being done.
        cache: ``fiducials.csv`` of an earlier run on the same images, if there is one.
        judge: Asked about a table of poses before effects are sought.
        choose: Gives the rows to calibrate from, of those that were read.

    Raises:
        AridcalError: whatever in the input needs mending.
    """
    if not isinstance(job, Job):
        job = read_job(job, seed, progress, cache, verify is not None)
    # read before the work is done: a table that is no other day's is told of at once
    other = None if verify is None else other_day(job.campaign, job.robot, job.rows, verify)
    arm, where = _calibrated(job, choose, judge, progress)
    lens = None if job.detections is None else lens_found(arm.geometry.geometric, arm.diagnosed.fit, job.detections)
    if lens is not None:
        progress("looking for the fiducials again, with the lens that was found")
        job = looked_again(job, lens, progress)
        arm, where = _calibrated(job, choose, judge, progress)
    outcome = _outcome(job.campaign, job.robot, arm, where, job.still, job.detections, progress)
    if other is not None:
        progress("scoring another day's measurements")
        outcome = replace(outcome, verification=_scored(outcome, *other))
    return replace(outcome, seconds=time.perf_counter() - job.started)


def _calibrated(
    job: Job, choose: Callable[[Dataset], Dataset], judge: Judge, progress: Progress
) -> tuple[CalibratedArm, np.ndarray | None]:
    """The calibrated arm of a job, and the readings of the region that its campaign names; see :func:`identify`."""
    campaign, robot, rows = job.campaign, job.robot, choose(job.rows)
    question = campaign.question
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
    give_back()
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
    """Score every stage of a calibrated arm, and ask what remains."""
    progress("scoring")
    give_back()  # what the fits took: here and below the most memory is wanted
    rows, diagnosed = arm.rows, arm.diagnosed
    train = rows.fitted
    known = judged(arm, progress)
    stages, outlier, final = known.stages, known.outlier, known.stages[-1].fit
    kept = rows.select(~outlier)
    traced = np.flatnonzero(~outlier)[stretches(kept.sequence, TRACED)]
    progress("fitting halves of the rows apart")
    again = second_look(stages[1].fit, diagnosed.fit, train, progress)
    asked = asked_constants(campaign.question, robot, rows)
    progress("working out how well the target is known")
    give_back()
    certain = certainty(wanted(campaign), final, rows, asked, where, outlier, stages[-1].residual, known.repeats)
    stages = with_instruments_found(stages, train)
    head = None if detections is None else measuring_head(final, stages[1].fit, rows, rows.train & ~outlier, detections)
    known_to = precision(final, train)
    give_back()
    return Outcome(
        campaign=campaign,
        robot=robot,
        measurements=rows,
        stages=stages,
        outlier=outlier,
        noise=final.sigma,
        noise_source="declared" if all(rows.sigma) else "estimated",
        repeats=known.repeats,
        precision=known_to,
        second_look=again,
        certainty=certain,
        verdict=known.verdict,
        causes=arm.causes,
        notices=(
            *(head.notices if head is not None else ()),
            *(NO_MEASUREMENT.format(", ".join(own)) for block in campaign.blocks if (own := computed(block))),
            *still,
            *([arm.geometry.kept] if arm.geometry.kept else []),
            *_shared(rows, final),
            *structured_notices(arm.causes),
            *_derived_notices(rows, diagnosed),
            *(f"{b.what} is left out: {b.why}" for b in diagnosed.barred if b.why in (CONFOUNDED, NO_BETTER)),
            *_searched(train, len(kept), campaign, arm.geometry.geometric),
            *declared_notices(rows, final.estimated, final.freedom),
            *unused_links(robot, campaign.parameters.set),
            *limb_redundancies(arm.geometry.geometric),
            *(str(n) for n in rows.origin.notices),
        ),
        seconds=0.0,
        traces=trace(final, rows.select(traced), stages[1].residual[traced], stages[2].residual[traced], progress),
        diagnosis=explain(diagnosed, rows, rows.test & ~outlier, known.clues),
        head=head,
    )


def _shared(rows: Dataset, final: Fit) -> Iterator[str]:
    """Sentences on rows that count for less than one, as they are not independent."""
    bodies = targets_of_one_body(rows, float(final.estimated[0]))
    if bodies > 1:
        yield ONE_BODY.format(bodies)
    elif rows.repeats.share < 1.0:
        place = held_together(rows)
        yield ONE_PLACE.format(len(rows), place.max() + 1, rows.repeats.share * len(rows))


def _searched(train: Dataset, kept: int, campaign: Campaign, geometric: Fit) -> Iterator[str]:
    """Sentences on what was asked of some of the rows only, as there are many, or of none, as there are few."""
    sought = campaign.diagnosis.enabled and bool(campaign.diagnosis.candidates)
    if sought and is_short(geometric):
        yield NOT_SOUGHT.format(100.0 * _freedom(geometric), 100.0 * LEAST_FREEDOM)
    elif sought and len(train) > SEARCHED:
        more = np.sqrt(len(train) / SEARCHED)
        yield (
            f"effects were sought in {SEARCHED:,} of the {len(train):,} fitted rows, and then fitted to all: to be seen, one "
            f"must be {more:.1f} times as large as in a search of all rows"
        )
    if kept > ASKED:
        yield f"whether what remains is noise was asked of {ASKED:,} of {kept:,} rows, in {STRETCHES} stretches on end"


def with_instruments_found(stages: tuple[Stage, ...], train: Dataset) -> tuple[Stage, ...]:
    """Stages of which the constants are those of instruments as the last has them: they go into the URDF.

    What the geometric stage leaves of the rows stays what it leaves with the instruments as declared.
    """
    nominal, geometric, final = stages
    found = with_things_moved(geometric.fit, final.fit)
    if found is None:
        return stages
    again = recentred(fit(problem(found, train), geometric.fit.theta))
    kept = replace(again, candidates=geometric.fit.candidates, redundant=geometric.fit.redundant)
    return nominal, replace(geometric, fit=kept), final


def judged(arm: CalibratedArm, progress: Progress = SILENT) -> Judged:
    """Fit every stage with the final model's flags, ask the residuals all questions, and decide what may be said."""
    rows = arm.rows
    stages, outlier = _stages(rows, arm.geometry, arm.diagnosed.fit, progress)
    final, last = stages[-1].fit, stages[-1].residual
    kept, left = rows.select(~outlier), scaled(last, rows.relative)
    white, raw = (r[~outlier] if outlier.any() else r for r in (left, last))
    # Repeats are set beside the residual that they are part of: both divided by what the rows' noise is known to be.
    # Of several targets of one body one is asked: the others err like it, whatever the model.
    one_each = kept, white
    if rows.repeats.share < 1.0:
        first = np.unique(held_together(kept), return_index=True)[1]
        one_each = kept.select(first), white[first]
    asked = clues(*one_each, repeats(kept, white), _freedom(final), final, progress)
    asked += row_clues(rows, final, left, outlier)
    asked += _groups(rows, final, left, outlier)
    effects = [active.effect for active in arm.diagnosed.found.state.active]
    scatter = repeats(kept, raw)
    seen = np.zeros(len(rows.channels)) if scatter is None else scatter.freedom
    known = all(s is not None or f > 0 for s, f in zip(rows.sigma, seen.tolist(), strict=True))
    setting = gravity_direction(arm.geometry.geometric, rows.fitted)
    said = decide(asked, effects, min(_freedom(final), arm.geometry.free), known, setting)
    return Judged(stages, outlier, scatter, tuple(asked), said)


def _groups(rows: Dataset, final: Fit, residual: np.ndarray, outlier: np.ndarray) -> list[Clue]:
    """Whether some rows are shifted by one vector; of rows that are not independent one each.

    A group that stands far out is flagged row by row, and is asked about with the others.
    """
    some = np.ones(len(rows), dtype=bool) if outlier.mean() >= LEAST else ~outlier
    if rows.repeats.share < 1.0:
        some = np.flatnonzero(some)[np.unique(held_together(rows.select(some)), return_index=True)[1]]
    elif some.all():  # of many rows a copy counts
        return groups(rows, residual, final)
    return groups(rows.select(some), residual[some], final)


def _derived_notices(rows: Dataset, diagnosed: Diagnosed) -> tuple[str, ...]:
    """Sentences on effects of a side of approach that no column gave."""
    needed = [name for a in diagnosed.found.state.active for name in a.effect.covariates if name in rows.origin.derived]
    return tuple(
        f"{name} is derived from the order of the rows: predict takes the middle between both sides where a table lacks it"
        for name in dict.fromkeys(needed)
    )


def _freedom(fit: Fit) -> float:
    """Share of the numbers measured that is left after fitting."""
    return float(1.0 - fit.spent / max(fit.numbers, 1.0))


def _size(campaign: Campaign, robot: Robot, rows: Dataset) -> Size:
    """How large the calibration will be."""
    question = campaign.question
    return Size(
        coefficients=len(asked_constants(question, robot, rows)),
        stations=len(station_labels(question, rows)),
        rows=len(rows),
        searched=min(int(rows.train.sum()), SEARCHED) if question.sought else 0,
        numbers=sum(channel.size for channel in rows.channels),
        joints=len(robot.joints),
    )


def _stages(rows: Dataset, geometry: Geometry, final: Fit, progress: Progress) -> tuple[tuple[Stage, ...], np.ndarray]:
    """Every stage fitted with the final model's flags, and the flags of all rows."""
    train = rows.fitted
    stages: list[Stage] = []
    for name, found in (("nominal", geometry.nominal), ("geometric", geometry.geometric), ("final", final)):
        if not np.array_equal(found.outliers, final.outliers):
            again = fit(problem(found.model, train, progress), found.theta, final.weight)
            tried = {"restarts": found.convergence.restarts, "agreed": found.convergence.agreed}
            convergence = replace(again.convergence, **tried)
            found = replace(again, candidates=found.candidates, redundant=found.redundant, convergence=convergence)
        found = recentred(with_noise_seen(found, train, progress) if name == "final" else found)
        same = bool(stages) and _alike(stages[-1].fit, found)
        residual = stages[-1].residual if same else problem(found.model, rows).residual(found.theta)
        stages.append(Stage(name, found, residual))
    left = [scaled(stage.residual, rows.relative) for stage in stages]
    return tuple(stages), outliers(rows.train, final.outliers, left, rows.channels)


def _alike(one: Fit, other: Fit) -> bool:
    """True of fits that predict the same: a search that finds nothing leaves the model as it is."""
    here, there = one.model, other.model
    if here.states or there.states or here.around is not there.around:
        return False
    frames = here.world_base == there.world_base and here.tip_target == there.tip_target
    return frames and here.coefficients == there.coefficients and np.array_equal(one.theta, other.theta)


def score(outcome: Outcome, table: AnyTable) -> Verification:
    """Score another day's table with the models as they are, and with the two frames fitted anew.

    Args:
        outcome: The models.
        table: Measurements in the columns and units of the campaign's own.

    Raises:
        AridcalError: the table needs mending, or is the campaign's own.
    """
    return _scored(outcome, *other_day(outcome.campaign, outcome.robot, outcome.measurements, table))


def other_day(campaign: Campaign, robot: Robot, own: Dataset, table: AnyTable) -> tuple[Dataset, int]:
    """Read another day's rows.

    Args:
        campaign: Says how the table is written.
        robot: The nominal chain.
        own: The campaign's own rows, fitted and held out.
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
    copied = _copied(rows, own)
    if copied.all() or rows.origin.sha256 == own.origin.sha256:
        raise MeasurementError(
            f"{rows.title}: all {len(rows)} rows are the campaign's own, with the same joints and the same measurements, "
            "and say nothing of another day. Give --verify what was measured at another time; how well held-out rows are met "
            "is in the report without it"
        )
    return rows.select(~copied), int(copied.sum())


def _copied(rows: Dataset, own: Dataset) -> np.ndarray:
    """Rows that others hold too, joints and measurement, shape (N,)."""
    from scipy.spatial import cKDTree  # slow to load

    width = max(rows.observed.shape[1], own.observed.shape[1])
    nearest, _ = cKDTree(_numbers(own, width)).query(_numbers(rows, width), p=np.inf, distance_upper_bound=SAME)
    tells = np.isfinite(rows.observed).sum(axis=1) >= TELLING
    return np.asarray(np.isfinite(nearest) & tells)


def _numbers(rows: Dataset, width: int) -> np.ndarray:
    """Joints and measurement of each row, ``width`` numbers of another kind than poses among them, shape (N, numbers)."""
    observed = np.full((len(rows), width), np.nan)
    observed[:, : rows.observed.shape[1]] = rows.observed
    return np.nan_to_num(np.hstack([rows.readings, observed]), nan=-1e9)  # a hole is like a hole alone


def _scored(outcome: Outcome, rows: Dataset, copied: int) -> Verification:
    asked = {stage.name: (problem(stage.fit.model, rows), stage.fit) for stage in outcome.stages}
    again = realigned(asked["final"][1], asked["final"][0])
    outlier = distance(again, robust_sigma(again, rows.channels), rows.channels) > FAR
    residuals = {name: question.residual(found.theta) for name, (question, found) in asked.items()}
    return Verification(rows.origin.files[0].name, rows, residuals, outlier, unscaled(again, rows.relative), copied)
