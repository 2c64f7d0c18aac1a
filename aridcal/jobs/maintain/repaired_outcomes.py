"""A repaired calibration as outcomes, of which the files of a result folder are made.

There are two: the new rows set beside the models, for figures, report and scene; and the repaired model's own predictions where
it was calibrated, to which exports for controllers are fitted. Ten rows tell what moved, but not what a controller makes of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Convergence, Fit, fit_identifiable
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.stages import recentred
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.instruments.setup import Block
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Route
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.rows.row_facts import Labels
from aridcal.engine.search.residual_trends import Order, Traces
from aridcal.engine.trust.uncertainty import precision
from aridcal.files.campaign import Campaign
from aridcal.files.things import InstrumentDeclarations, ThingReferences, instruments_of, with_trackers
from aridcal.jobs.calibrate.outcome import Outcome, Stage
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.calibrate.verdict import Verdict
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.jobs.maintain.checking import CheckResult, new_rows_question, with_unknowns
from aridcal.jobs.maintain.hypotheses import widened
from aridcal.jobs.maintain.likelihoods import covariance_of, likely
from aridcal.jobs.maintain.repair import Repair
from aridcal.jobs.maintain.repair_error import left_out_residuals
from aridcal.jobs.maintain.unknowns import wide_model
from aridcal.system.errors import CampaignError

CONFIGURATIONS_PREDICTED = 400
"""Configurations in which the repaired model predicts itself: sixty numbers for each constant that an export may have."""


@dataclass(frozen=True)
class RepairOutcomes:
    """What the files of a repaired calibration are made of.

    Attributes:
        rows: The new rows against the nominal robot, the calibration ``before``, the repaired geometry and the repaired model.
        model: The repaired model's own predictions, where it was calibrated, against nominal, geometric and final stage.
        left_out: Residuals with what moved fitted to the other rows, shape (N, m); see :func:`left_out_residuals`.
    """

    rows: Outcome
    model: Outcome
    left_out: np.ndarray


def repair_outcomes(saved: SavedModel, checked: CheckResult, repair: Repair) -> RepairOutcomes:
    """Residuals of a repaired calibration at the new rows, and at its own predictions.

    Args:
        saved: The calibration before.
        checked: What the rows said of it.
        repair: What was done.

    Raises:
        CampaignError: the calibration does not hold its campaign.
    """
    if saved.campaign is None:
        raise CampaignError("calibration.yaml holds no campaign; run `aridcal identify` again")
    constants_set = saved.campaign.parameters.set
    solution = likely(checked.question)
    predicted = _predicted(repair.saved)
    nominal = _nominal(repair.saved, predicted)
    sigma = np.array(repair.saved.noise[: len(predicted.channels)])
    arm = SolvedModel(nominal.model, nominal.theta, nominal.covariance)
    of_model = tuple(
        Stage(name, *_fit(problem(solved.model, predicted), solved, sigma, constants_set))
        for name, solved in (("nominal", arm), ("geometric", repair.saved.geometric), ("final", repair.saved.final))
    )
    noise = checked.question.times * checked.noise.sigma
    final = SolvedModel(checked.wide.model, solution.theta, covariance_of(checked.question, solution))
    start = new_rows_question(checked.wide, checked.rows, checked.noise, checked.unknowns.unknown)
    old = SolvedModel(checked.wide.model, with_unknowns(start), checked.wide.covariance)
    of_rows = (
        *(
            _beside(name, solved, checked, constants_set)
            for name, solved in (("nominal", arm), ("geometric", repair.saved.geometric))
        ),
        Stage("before", *_fit(start.problem, _without_zeros(old), noise, constants_set)),
        Stage("final", *_fit(checked.question.problem, _without_zeros(final), noise, constants_set)),
    )
    contradicted = checked.rest.p_value < FALSE_ALARMS
    share = max(0.0, 1.0 - 1.0 / checked.rest.ratio) if contradicted else 0.0
    why = (
        (f"what remains of the new rows is more than their noise (p = {checked.rest.p_value:.2g})",)
        if contradicted
        else ()
    )
    verdict = Verdict("structure_remains" if contradicted else "noise_floor", share, why)
    counting = ~checked.question.dropped
    held_out = checked.rows.test if checked.rows.origin.split_given else np.zeros(len(counting), dtype=bool)
    rows = replace(checked.rows, test=held_out)
    return RepairOutcomes(
        rows=_outcome(saved.campaign, rows, of_rows, ~counting & ~held_out, noise, verdict),
        model=_outcome(
            saved.campaign, predicted, of_model, np.zeros(CONFIGURATIONS_PREDICTED, dtype=bool), sigma, verdict
        ),
        left_out=left_out_residuals(checked, solution.theta),
    )


def _outcome(
    campaign: Campaign,
    rows: Dataset,
    stages: tuple[Stage, ...],
    outlier: np.ndarray,
    noise: np.ndarray,
    verdict: Verdict,
) -> Outcome:
    """Solved stages as an outcome, without any search in their residuals."""
    return Outcome(
        campaign=campaign,
        robot=stages[0].fit.model.robot,
        measurements=rows,
        stages=stages,
        outlier=outlier,
        noise=noise,
        noise_source="declared",
        repeats=None,
        precision=precision(stages[-1].fit, rows),
        verdict=verdict,
        notices=tuple(str(notice) for notice in rows.origin.notices),
        seconds=0.0,
        traces=Traces((), (), 0, Order(False, np.zeros(0), np.zeros(0), 0.0, 0, 0.0, 0.0, 1.0)),
    )


def _predicted(saved: SavedModel) -> Dataset:
    """Exact rows: what a model predicts at configurations in which it was calibrated."""
    model, rng = saved.final.model, np.random.default_rng(0)
    robot = model.robot
    samples = {
        name: rng.choice(saved.ranges[name], CONFIGURATIONS_PREDICTED)
        if name.endswith("_direction")
        else rng.uniform(*saved.ranges[name], CONFIGURATIONS_PREDICTED)
        for name in (*robot.readings, *model.needs)
    }
    at_base, at_tip = (
        sorted({label for label, _ in frames if label is not None}) for frames in (model.world_base, model.tip_target)
    )
    station = rng.choice(at_base or at_tip, CONFIGURATIONS_PREDICTED) if at_base or at_tip else None
    target = rng.choice(at_tip, CONFIGURATIONS_PREDICTED) if saved.frames_by == "both" else None
    readings = np.column_stack([samples[name] for name in robot.readings])
    covariates = {name: samples[name] for name in model.needs}
    R, p = saved.final.poses(readings, covariates, station, target)
    turns = R if saved.turns else None
    rows = dataset(
        robot.readings, robot.kinds, readings, p, turns, sigma=saved.noise, covariates=covariates, station=station
    )
    rows = rows.with_labels(target=target)
    return _on_limbs(rows, saved) if robot.others else rows


def _on_limbs(rows: Dataset, saved: SavedModel) -> Dataset:
    """Rows of poses in the form of a robot of several limbs: a tracker's readings of targets, each on its own link."""
    assert saved.campaign is not None
    model, kind, n = saved.final.model, MEASUREMENT_KINDS[saved.kind], len(rows)
    blocks = (Block("the calibration", kind.name, rows.channels, rows.sigma),)
    refers = with_trackers(rows.labels.refers, blocks, rows.labels.block, rows.names)
    known = InstrumentDeclarations(saved.campaign.instruments, {}, {}, saved.campaign.path.name)
    both = saved.frames_by == "both"
    target = rows.labels.target if both else rows.labels.station
    ends = [None] * n if target is None else [model.target_on.get(label) for label in target.tolist()]
    return replace(
        rows,
        blocks=blocks,
        instruments=instruments_of(known, [ThingReferences(kind, refers)], rows.names, False)[0],
        labels=Labels(
            block=rows.labels.block,
            refers=refers,
            station=rows.labels.station if both else None,
            target=target,
            route=np.array([model.routes.index(Route(None, end)) for end in ends]),
            routes=model.routes,
        ),
    )


def _nominal(saved: SavedModel, predicted: Dataset) -> Fit:
    """The nominal robot with its frames where these suit the repaired model best."""
    model = saved.final.model
    frames = _frame_coefficients(model)
    nominal_model = model.with_coefficients(frames)
    return recentred(fit_identifiable(problem(nominal_model, predicted), range(len(frames))))


def _frame_coefficients(model: Model) -> tuple[Coefficient, ...]:
    """Constants of all frames of a model."""
    frames = (("world_base", model.world_base), ("tip_target", model.tip_target))
    return tuple(
        Coefficient(where, component, station=label)
        for where, placements in frames
        for label, _ in placements
        for component in FRAME_COMPONENTS
    )


def _beside(name: str, solved: SolvedModel, checked: CheckResult, constants_set: str) -> Stage:
    """A stage with the residuals of the new rows, their unknowns fitted to them."""
    wide = wide_model(widened(solved), checked.rows)
    question = new_rows_question(wide.solved, checked.rows, checked.noise, wide.unknown)
    theta = with_unknowns(question)
    arm = _without_zeros(SolvedModel(wide.solved.model, theta, wide.solved.covariance))
    return Stage(name, *_fit(question.problem, arm, checked.noise.sigma, constants_set))


def _without_zeros(solved: SolvedModel) -> SolvedModel:
    """A solved model without coefficients that are 0 and have no variance."""
    keep = np.flatnonzero((solved.theta != 0.0) | (np.diag(solved.covariance) > 0.0))
    coefficients = [solved.model.coefficients[k] for k in keep]
    return SolvedModel(
        solved.model.with_coefficients(coefficients), solved.theta[keep], solved.covariance[np.ix_(keep, keep)]
    )


def _fit(rows_problem: Problem, solved: SolvedModel, sigma: np.ndarray, constants_set: str) -> tuple[Fit, np.ndarray]:
    """A solved model as a fit of some rows, with the set of constants that was asked for, and its residuals there, (N, m)."""
    rows = rows_problem.data
    residual = problem(solved.model, rows).residual(solved.theta)
    model = solved.model
    candidates = (*constants(model.robot, constants_set), *_frame_coefficients(model), *model.coefficients)
    fit = Fit(
        model=solved.model,
        theta=solved.theta,
        covariance=solved.covariance,
        sigma=sigma,
        estimated=sigma,
        weight=np.ones(len(rows)),
        residual=residual,
        candidates=tuple(dict.fromkeys(candidates)),
        redundant={},
        convergence=Convergence(steps=0, gradient=0.0, condition=float("nan")),
        spent=float(len(solved.theta)),
        numbers=float((rows.measures * [channel.size for channel in rows.channels]).sum()),
        believed=np.zeros((len(solved.theta), len(solved.theta))),
    )
    return recentred(fit), residual
