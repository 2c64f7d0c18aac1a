"""A calibration mended with a few rows: what moved is fitted, all else is kept as well as it was known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import ANGULAR, FRAME_COMPONENTS, Coefficient
from aridcal.engine.model.model import Model
from aridcal.files.read import ONE_TARGET
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.maintain.checking import Cause, CheckResult
from aridcal.jobs.maintain.hypotheses import Hypothesis, widened
from aridcal.jobs.maintain.likelihoods import covariance_of, likely
from aridcal.jobs.maintain.unknowns import Place, WideModel
from aridcal.system.errors import MeasurementError, name_list


@dataclass(frozen=True)
class RepairChange:
    """By how much something moved.

    Attributes:
        cause: What moved.
        names: Its d coefficients.
        units: Of each coefficient: m or rad; of an effect's that of the motion, per unit of its basis.
        value: New minus old, shape (d,).
        std: Its standard deviation, shape (d,).
    """

    cause: Cause
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class Repair:
    """A calibration after a repair.

    Attributes:
        saved: The calibration as it is now.
        changes: What moved.
        residual: Of the new rows with it, shape (N, m), [m] and [rad].
    """

    saved: SavedModel
    changes: tuple[RepairChange, ...]
    residual: np.ndarray


def changes(checked: CheckResult) -> tuple[RepairChange, ...]:
    """Size of each move: of new frames first, then of the causes."""
    solution = likely(checked.question)
    moved = solution.theta - checked.wide.theta
    std = np.sqrt(np.maximum(np.diag(covariance_of(checked.question, solution)), 0.0))
    model = checked.wide.model
    moves = []
    for cause in checked.moved:
        assert cause.suspect is not None
        indices = cause.suspect.touched
        names = tuple(model.names[k] for k in indices)
        units = tuple(unit_of(model, int(k)) for k in indices)
        moves.append(RepairChange(cause, names, units, moved[indices], std[indices]))
    return (*_anew(checked, solution.theta, std), *moves)


def _anew(checked: CheckResult, theta: np.ndarray, std: np.ndarray) -> Iterator[RepairChange]:
    """Changes of frames that the rows' own campaign calls new, along and about the axes of the old frame."""
    unknowns = checked.unknowns
    model = unknowns.solved.model
    coefficients = [unknowns.of_calibration(c) for c in model.coefficients]
    frames_after = _frames_now(unknowns, theta)
    frames_before = _frames_now(replace(unknowns, solved=unknowns.before, renamed=False), unknowns.before.theta)
    for where, label in unknowns.anew:
        step = frames_before[where, label].inverse() * frames_after[where, label]
        value = np.concatenate([step.translation, pin.log3(step.rotation)])
        indices = [
            next(k for k, c in enumerate(coefficients) if c == Coefficient(where, component, station=label))
            for component in FRAME_COMPONENTS
        ]
        words = "the base (or the instrument)" if where == "world_base" else "the tool (or the target on it)"
        name = where if label is None else f"{where}[{label}]"
        fitted = [i for i, k in enumerate(indices) if unknowns.unknown[k]]
        yield RepairChange(
            Cause("new", name, words, 1.0),
            tuple(model.names[indices[i]] for i in fitted),
            tuple("rad" if FRAME_COMPONENTS[i] in ANGULAR else "m" for i in fitted),
            value[fitted],
            std[[indices[i] for i in fitted]],
        )


def _frames_now(unknowns: WideModel, theta: np.ndarray) -> dict[Place, pin.SE3]:
    """All frames of the wide model, as the calibration labels them."""
    world, tip = unknowns.solved.model.frames(theta)
    renamed = [(None if unknowns.renamed and label == ONE_TARGET else label, frame) for label, frame in tip]
    placements = (("world_base", world), ("tip_target", renamed))
    return {(where, label): frame for where, frames in placements for label, frame in frames}


def unit_of(model: Model, k: int) -> str:
    """Unit of the motion that a coefficient makes: along, or about."""
    c = model.coefficients[k]
    if c.component == "axis":
        return "m" if model.robot.joint(c.where).kind == "prismatic" else "rad"
    return "m" if c.component in ("x", "y", "z", "t1", "t2", "a", "d") else "rad"


def repair_calibration(saved: SavedModel, checked: CheckResult) -> Repair:
    """The calibration with what moved fitted to the new rows.

    Args:
        saved: The calibration.
        checked: What new rows say of it.

    Raises:
        MeasurementError: nothing moved, or what moved cannot be told from these rows.
    """
    where = checked.rows.title
    if not checked.contradicted and not checked.unknowns.anew:
        raise MeasurementError(
            f"{where}: nothing moved: these rows go with the calibration as it is ({checked.first.words}); "
            "go on using it"
        )
    if checked.contradicted and not checked.moved:
        words = "; ".join(cause.words for cause in checked.causes)
        raise MeasurementError(
            f"{where}: no part of the robot moved, so that there is nothing to repair. What is odd is {words}; look at the "
            "instrument and measure these rows again"
        )
    if checked.rest.p_value < REFUSAL_P_VALUE:
        raise MeasurementError(
            f"{where}: these rows differ from the calibration by more than a few moved parts explain ("
            f"{checked.rest.words} with {len(checked.causes)} allowed for); measure a whole campaign and run "
            "`aridcal identify`"
        )
    for cause in checked.moved:
        if cause.telling and cause.probability < REPAIR_PROBABILITY:
            raise MeasurementError(
                f"{where}: these rows cannot tell {cause.words} (probability {100 * cause.probability:.0f} %) from "
                f"{name_list(cause.alike)}, and the wrong repair would be wrong elsewhere; measure what would tell, too: "
                "`aridcal check RESULTS ROWS --poses poses.csv` writes it"
            )
    solution = likely(checked.question)
    final = _settled(checked.unknowns, saved.final, solution.theta, covariance_of(checked.question, solution))
    moved = [cause.suspect for cause in checked.moved if cause.suspect is not None]
    std = np.sqrt(np.maximum(np.diag(covariance_of(checked.question, solution)), 0.0))
    geometric = _with_new_frames(
        _geometric(saved.geometric, checked, solution.theta, std, moved), checked.unknowns, final
    )
    residual = checked.question.problem.residual(solution.theta)
    # The repaired calibration is the mean over causes that could not be told apart; its covariance holds their differences.
    return Repair(replace(saved, geometric=geometric, final=final, rivals=()), changes(checked), residual)


REPAIR_PROBABILITY = 0.8
"""Probability below which a part is not repaired that another one is mistaken for: one repair in five would be of the wrong part,
though a row more would have told."""

REFUSAL_P_VALUE = 1e-3
"""Probability of what is left below which a repair is refused: ten times rarer than what raises an alarm, for it was looked for
in the same rows."""


def _settled(unknowns: WideModel, before: SolvedModel, theta: np.ndarray, covariance: np.ndarray) -> SolvedModel:
    """The wide model as a calibration again: no coefficients that are 0 and known, no instruments, frames where they are now.

    Args:
        unknowns: The wide model, K coefficients.
        before: The calibration's own model.
        theta: Coefficients now, shape (K,).
        covariance: Of these, shape (K, K).
    """
    wide = unknowns.solved.model
    labels = {label for label, _ in before.model.tip_target}
    coefficients = [unknowns.of_calibration(c) for c in wide.coefficients]
    foreign = wide.at_things | np.array(
        [c.where == "tip_target" and c.station not in {*labels, None} for c in coefficients]
    )
    keep = np.flatnonzero(((theta != 0.0) | (np.diag(covariance) > 0.0)) & ~foreign)
    world, tip = wide.frames(theta)
    placements = [(None if unknowns.renamed and label == ONE_TARGET else label, frame) for label, frame in tip]
    model = replace(
        before.model,
        coefficients=tuple(coefficients[k] for k in keep),
        world_base=world,
        tip_target=tuple((label, frame) for label, frame in placements if label in labels),
    )
    at_frames = [coefficients[k].basis.constant and coefficients[k].where in ("world_base", "tip_target") for k in keep]
    return SolvedModel(model, np.where(at_frames, 0.0, theta[keep]), covariance[np.ix_(keep, keep)])


def _geometric(
    before: SolvedModel, checked: CheckResult, theta: np.ndarray, std: np.ndarray, moved: Sequence[Hypothesis]
) -> SolvedModel:
    """The geometric stage with the same zeros and frames moved; effects are no part of this stage.

    Args:
        before: The stage as it was.
        checked: Holds the final stage as it was.
        theta: The final stage's coefficients now, shape (K,).
        std: Of these, shape (K,).
        moved: What moved.
    """
    wide = widened(before)
    number = {c: k for k, c in enumerate(wide.model.coefficients)}
    now, covariance = wide.theta.copy(), wide.covariance.copy()
    for suspect in moved:
        if suspect.kind != "effect":
            for k in suspect.touched:
                c = checked.unknowns.of_calibration(checked.wide.model.coefficients[k])
                now[number[c]] += theta[k] - checked.wide.theta[k]
                covariance[number[c], number[c]] = std[k] ** 2
    return _settled(WideModel(wide, wide, np.zeros(len(now), dtype=bool)), before, now, covariance)


def _with_new_frames(geometric: SolvedModel, unknowns: WideModel, final: SolvedModel) -> SolvedModel:
    """The geometric stage with frames that were fitted anew moved as the final stage's were."""
    model = geometric.model
    frames = {"world_base": dict(model.world_base), "tip_target": dict(model.tip_target)}
    before = _frames_now(replace(unknowns, solved=unknowns.before, renamed=False), unknowns.before.theta)
    after = {"world_base": dict(final.model.world_base), "tip_target": dict(final.model.tip_target)}
    for where, label in unknowns.anew:
        frame_before, frame_after, geometric_frame = before[where, label], after[where][label], frames[where][label]
        frames[where][label] = (
            frame_after * frame_before.inverse() * geometric_frame
            if where == "world_base"
            else geometric_frame * frame_before.inverse() * frame_after
        )
    world, tip = (tuple(frames[where].items()) for where in ("world_base", "tip_target"))
    return replace(geometric, model=replace(model, world_base=world, tip_target=tip))
