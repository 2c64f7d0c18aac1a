"""The loop of a calibration: constants, effects, causes of scatter as weights, and again until the weights stay."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.corrections.loads import PAYLOAD, Payload, Surroundings, is_load
from aridcal.engine.fit.least_squares import PLENTY_OF_NUMBERS, Fit
from aridcal.engine.fit.noise import independent_share
from aridcal.engine.fit.normal_equations import accumulate, solve
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.question import Question
from aridcal.engine.fit.residual import reduced_stretches
from aridcal.engine.fit.stages import Geometry, fit_geometry, recentred, with_things_moved
from aridcal.engine.instruments.channels import columns, spread
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.levels import JUDGING_FOLDS, PLAINLY, SEVERAL
from aridcal.engine.model.declared_noise import with_declared_noise
from aridcal.engine.model.model import Model
from aridcal.engine.model.placements import sights_of
from aridcal.engine.model.rigid_bodies import targets_of_one_body
from aridcal.engine.numerics import RIDGE
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import LEVEL_GRAVITY
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups
from aridcal.engine.search.diagnose import SearchResult, diagnose, model_with_rivals
from aridcal.engine.search.noise_causes import NoiseCauses, noise_causes
from aridcal.engine.search.noise_tests import rms_of_channels
from aridcal.system.progress import SILENT, Progress

CLEARER_WEIGHT_RATIO = 1.2
"""Work: Times as much or as little as before that a row must count for, once effects are found, for another search: evidence
does."""

MOST_SCATTER_ROUNDS = 3
"""Work: Times that this is asked, as effects that imitate what a place errs by leave less of it; mostly once."""

TARGET_SHIFT_OF_CONSTANTS = 1e-4
"""Work: [m] by which the target of the final model may be elsewhere than that of the geometric stage, where the payload was
hung: 0.1 mm of some 100 mm change a load by a thousandth."""

KEPT_NOMINAL_SENTENCE = (
    "the nominal robot is kept: fitted to these {} configurations, constants and effects do not predict held-back ones better. "
    "Measure more configurations, or identify fewer parameters"
)
"""What is said where neither constants nor effects are worth their freedom."""


LEAST_NUMBERS_LEFT = 0.67
"""Share h of the numbers measured that must be left after fitting. At new configurations the model's own variance is about
(1 - h) / h of the noise's: with less it is off by more than 0.7 sigma, and nobody may say what it lacks, or that only noise is
left."""

TOO_FEW_NUMBERS = (
    "{:.0f} rows on the average were measured at one reading and share its error; each is weighed by itself, so that standard "
    "deviations are too small where readings are most of what scatters. More postures tell more than more marks"
)


@dataclass(frozen=True)
class CalibratedArm:
    """A calibrated arm.

    Attributes:
        rows: All rows, the held-out ones too.
        geometry: Frames alone, and frames with constants; the latter recentred and knowing gravity.
        diagnosed: The final model and the search that led to it.
        causes: Causes of the scatter of its residual; None where there are too few rows.
    """

    rows: Dataset
    geometry: Geometry
    diagnosed: SearchResult
    causes: NoiseCauses | None = None


def calibrated_arm(
    question: Question, robot: Robot, rows: Dataset, labels: tuple[str, ...], geometry: Geometry, progress: Progress
) -> CalibratedArm:
    """Fit and search; estimate the causes of scatter; if these are more than the instrument, fit again with them as weights.

    So no effect imitates the scatter of a joint's reading, and rows that this scatter does not touch count in full. Only joints
    and distances make weights: on a real robot with a tracker, directions and levers estimated from the same rows made the
    error on held-out rows 4 % larger. The final model's residual is tested for all causes, to name them.
    """
    bodies = targets_of_one_body(rows, float(geometry.geometric.estimated[0]))
    if bodies > 1:
        rows = rows.with_repeats(share=1.0 / bodies)
        geometry = fit_constants(question, robot, rows, labels, progress)

    def fitted(data: Dataset, geometry: Geometry, before: SearchResult | None = None) -> CalibratedArm:
        arm = fit_arm(question, geometry, data, progress, before)
        progress("asking what the scatter is made of")
        return replace(arm, causes=_causes(arm, rows, progress, shapes=False))

    def weighed_anew(data: Dataset) -> Geometry:
        anew = fit_constants(question, robot, data, labels, progress)
        return _with_surroundings(anew, geometry.geometric.model.around)

    arm = fitted(rows, geometry)
    for _ in range(MOST_SCATTER_ROUNDS if bodies == 1 else 0):
        share = _share_of_row(rows, arm.diagnosed.fit)
        if rows.repeats.share / CLEARER_WEIGHT_RATIO < share < rows.repeats.share * CLEARER_WEIGHT_RATIO:
            break
        progress("weighing rows of one place by how alike they err, and looking again")
        rows = rows.with_repeats(share=share)
        geometry = weighed_anew(rows)
        arm = fitted(rows, geometry, arm.diagnosed)
    if (elsewhere := _with_payload_at_target(arm)) is not None:
        progress("the target is elsewhere than the geometry had it: the payload hangs there, fitting again")
        geometry = elsewhere
        arm = fitted(rows, geometry, arm.diagnosed)
    moved = with_things_moved(arm.geometry.geometric, arm.diagnosed.fit)
    if moved is not None and any(MEASUREMENT_KINDS[block.kind].noise for block in rows.blocks):
        progress("weighing the rows by what the instruments, as found, leave open, and fitting again")
        rows = with_declared_noise(rows, moved.states)
        geometry = weighed_anew(rows)
        arm = fitted(rows, geometry, arm.diagnosed)
    if arm.causes is not None and arm.causes.relative is not None:
        progress("weighing the rows by what makes them scatter, and fitting again")
        weighed = replace(rows, relative=arm.causes.relative)
        arm = fitted(weighed, weighed_anew(weighed), arm.diagnosed)
    if arm.diagnosed.stepwise.state.active and not is_better(
        arm.diagnosed.fit, arm.geometry.geometric, arm.rows.fitted
    ):
        progress("constants alone predict held-back rows as well: leaving the effects out")
        arm = fit_arm(question.without_search(), arm.geometry, arm.rows, progress)
        arm = replace(arm, causes=_causes(arm, rows, progress))
    if is_better(arm.diagnosed.fit, arm.geometry.nominal, arm.rows.fitted):
        return replace(
            arm, diagnosed=model_with_rivals(arm.diagnosed, progress), causes=_causes_with_names(arm, rows, progress)
        )
    return _keep_nominal(question, arm, progress)


def _causes(arm: CalibratedArm, rows: Dataset, progress: Progress, shapes: bool = True) -> NoiseCauses | None:
    """Causes of the scatter of a fitted arm; see :func:`noise_causes`."""
    return noise_causes(arm.diagnosed.fit, arm.diagnosed.stepwise.state.active, rows, progress, shapes)


def _causes_with_names(arm: CalibratedArm, rows: Dataset, progress: Progress) -> NoiseCauses | None:
    """Causes of scatter among all kinds; with the figures of the weights where both name the same causes."""
    every, weighed = _causes(arm, rows, progress), arm.causes
    if every is None or weighed is None:
        return weighed
    names, before = ([(c.kind, c.name) for c in part.causes] for part in (every, weighed))
    if names != before or every.structured != weighed.structured:
        return every
    pairs = zip(weighed.causes, every.causes, strict=True)
    return replace(weighed, causes=tuple(replace(cause, rivals=other.rivals) for cause, other in pairs))


def _share_of_row(rows: Dataset, fit: Fit) -> float:
    """Independent rows that each row counts for, as rows of one place err alike in a fit of the training rows."""
    in_use = rows.fitted.select(~fit.outliers)
    residual = fit.residual[~fit.outliers]
    return independent_share(in_use, residual / spread(rms_of_channels(residual, in_use), in_use.channels))


def _with_payload_at_target(arm: CalibratedArm) -> Geometry | None:
    """The geometry with the payload at the final model's target; None where that changes no load of an effect."""
    fit, before = arm.diagnosed.fit, arm.geometry.geometric.model.around
    loads = any(is_load(name) for a in arm.diagnosed.stepwise.state.active for name in a.effect.covariates)
    lever = fit.model.frames(fit.theta)[1][0][1].translation
    (payload, *others) = before.payloads
    if (
        others
        or payload.on
        or not (before.loaded and loads and np.linalg.norm(lever - payload.lever) > TARGET_SHIFT_OF_CONSTANTS)
    ):
        return None
    return _with_surroundings(arm.geometry, replace(before, payloads=(replace(payload, lever=lever),)))


def _with_surroundings(geometry: Geometry, around: Surroundings) -> Geometry:
    """The geometry with other surroundings."""
    geometric = geometry.geometric
    return replace(geometry, geometric=replace(geometric, model=replace(geometric.model, around=around)))


def _keep_nominal(question: Question, arm: CalibratedArm, progress: Progress) -> CalibratedArm:
    """The nominal robot with its frames and the declared effects alone, in place of a calibrated arm."""
    rows, geometry, fit = arm.rows, arm.geometry, arm.diagnosed.fit
    progress("the nominal robot predicts held-back rows as well: keeping it")
    frames = recentred(geometry.nominal)
    frames = replace(frames, model=replace(frames.model, around=geometry.geometric.model.around))
    reason = KEPT_NOMINAL_SENTENCE.format(len(np.unique(rows.repeats.configuration[rows.train])))
    free = 1.0 - fit.spent / fit.numbers
    arm = fit_arm(question.without_search(), Geometry(geometry.nominal, frames, reason, free), rows, progress)
    return replace(arm, diagnosed=model_with_rivals(arm.diagnosed, progress), causes=_causes(arm, rows, progress))


def fit_constants(
    question: Question, robot: Robot, rows: Dataset, labels: tuple[str, ...], progress: Progress = SILENT
) -> Geometry:
    """Frames and constants from the training rows, the frames at their identified place."""
    geometry = fit_geometry(question, robot, rows.fitted, labels, progress)
    geometric = recentred(geometry.geometric)
    around = surroundings(question, geometric.model, bool(question.payloads) or PAYLOAD in rows.covariates)
    around = replace(around, sights=sights_of(geometric.model, rows.fitted))
    return _with_surroundings(replace(geometry, geometric=geometric), around)


def fit_arm(
    question: Question, geometry: Geometry, rows: Dataset, progress: Progress, before: SearchResult | None = None
) -> CalibratedArm:
    """Search effects beside the constants, on the training rows, and fit all together.

    Args:
        question: Which effects are declared, and which kinds may be added.
        geometry: Fitted to the training rows.
        rows: All rows.
        progress: Called with the work in hand.
        before: An earlier search, on other weights.
    """
    fit = geometry.geometric
    narrowed = question.without_search() if is_short(fit) else question
    return CalibratedArm(rows, geometry, diagnose(narrowed, fit, rows.fitted, progress, before))


def surroundings(question: Question, model: Model, loaded: bool) -> Surroundings:
    """Gravity in the base frame and the payloads' places, from the question and the geometric stage's frames.

    Args:
        question: Says where gravity pulls.
        model: The geometric stage's, its frames where they were identified.
        loaded: True where the rows have payloads.
    """
    payloads = question.payloads or (Payload(model.tip_target[0][1].translation),)
    if question.gravity is not None:
        return Surroundings(question.gravity, payloads, loaded)
    vectors = [frame.rotation.T @ np.array(LEVEL_GRAVITY) for _, frame in model.world_base]
    return Surroundings(np.array(vectors) if len(vectors) > 1 else vectors[0], payloads, loaded)


def is_short(fit: Fit) -> bool:
    """True if so few degrees of freedom are left after a fit that no effect can be searched."""
    return fit.freedom <= LEAST_NUMBERS_LEFT * fit.numbers


def is_better(larger: Fit, smaller: Fit, data: Dataset) -> bool:
    r"""True if the larger of two models predicts blocks of held-back configurations better.

    Both are linear about their own optimum, so that each block costs one solution. Squares :math:`s` of each channel are
    counted in units of the smaller model's mean. Each configuration gains

    .. math:: (s_1 - s_2) / (s_1 + s_2)

    which lies between -1 and 1: a few of them that one of the models misses by far do not decide.

    Args:
        larger: K coefficients, fitted to the data.
        smaller: Fitted to the same rows.
        data: N rows.
    """
    in_use = ~larger.outliers
    if larger.numbers > PLENTY_OF_NUMBERS * len(larger.theta) or len(larger.theta) == len(smaller.theta):
        return True
    part = data.select(in_use)
    squares = [_held_back_squares(fit, part) for fit in (smaller, larger)]
    unit = np.maximum(squares[0].mean(axis=0), np.finfo(float).tiny)
    errors = np.stack([np.bincount(part.repeats.configuration, (each / unit).sum(axis=1)) for each in squares])
    gain = (errors[0] - errors[1]) / np.maximum(errors.sum(axis=0), np.finfo(float).tiny)
    return float(gain.sum()) > PLAINLY * float(np.sqrt(np.sum((gain - gain.mean()) ** 2)))


def _held_back_squares(fit: Fit, data: Dataset) -> np.ndarray:
    r"""Squared residual of each row in each channel, its block held back, shape (N, C).

    With :math:`\Lambda` the information of the whole fit, priors included, and :math:`H_b, g_b` the sums of one block, the
    solution without it differs by :math:`-(\Lambda - H_b)^{-1} g_b`: at the optimum all pulls together are zero.
    """
    question = problem(fit.model, data)
    pieces = [(r, J) for _, r, J in reduced_stretches(question, fit.theta, np.ones(len(data)), fit.sigma)]
    r, J = (np.concatenate(stacked) for stacked in zip(*pieces, strict=True))
    together = held_back_groups(data)
    number = np.random.default_rng(2).permutation(int(together.max()) + 1)
    block = number[together] % JUDGING_FOLDS
    parts, K = columns(data.channels), J.shape[2]
    residual = r.copy()
    for k in np.unique(block) if K else ():  # where all frames are known nothing was fitted
        in_block = block == k
        sums = accumulate([J[in_block][:, c].reshape(-1, K) for c in parts], [r[in_block][:, c].ravel() for c in parts])
        H, g = data.repeats.share * sums.information(fit.sigma), data.repeats.share * sums.pull(fit.sigma)
        residual[in_block] = r[in_block] + J[in_block] @ solve(fit.information - H, g, ridge=RIDGE)
    return np.stack([np.sum(residual[:, c] ** 2, axis=1) for c in parts], axis=1)


def structured_notices(causes: NoiseCauses | None) -> list[str]:
    """Sentences on structure that looks like scatter, and on errors that rows share and weights cannot hold."""
    misread = (
        "the residual looks as if {} were misread at random, but its errors come back at neighbouring rows: an error "
        "curve or play that the model lacks, and no noise"
    )
    looks = {
        "range": "grows with the distance from the origin of the world frame",
        "sight": "is about the line of sight",
        "direction": "lies along one direction of the world",
        "depth": "lies along lines of sight",
        "bearing": "lies across lines of sight",
        "own_axis": "lies along axes of the target",
        "lever": "is that of the rotation on a lever",
        "length": "grows with the length that is read",
        "repeatability": "is larger than the rows state and the same in all of them",
    }
    if causes is None:
        return []
    notices = [
        misread.format(name)
        if kind in ("joint", "joints")
        else f"the {name} error {looks[kind]}, but comes back at neighbouring rows: it is no noise"
        for kind, name in causes.structured
    ]
    return [*notices, TOO_FEW_NUMBERS.format(causes.shared)] if causes.shared > SEVERAL else notices
