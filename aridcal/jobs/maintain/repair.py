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
from aridcal.jobs.maintain.checking import Cause, Checked
from aridcal.jobs.maintain.hypotheses import Suspect, widened
from aridcal.jobs.maintain.likelihoods import covariance_of, likely
from aridcal.jobs.maintain.unknowns import Place, Wide
from aridcal.system.errors import MeasurementError, listed


@dataclass(frozen=True)
class Change:
    """By how much something moved.

    Attributes:
        cause: What.
        names: Of its coefficients, d of them.
        units: Of each: m or rad; of an effect's that of the motion, per unit of its basis.
        value: New minus old, shape (d,).
        std: Its standard deviation, shape (d,).
    """

    cause: Cause
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class Repaired:
    """A calibration after a repair.

    Attributes:
        saved: The calibration as it is now.
        changes: What moved.
        residual: Of the new rows with it, shape (N, m), [m] and [rad].
    """

    saved: SavedModel
    changes: tuple[Change, ...]
    residual: np.ndarray


def changes(checked: Checked) -> tuple[Change, ...]:
    """By how much each of what moved did so."""
    found = likely(checked.question)
    moved = found.theta - checked.wide.theta
    std = np.sqrt(np.maximum(np.diag(covariance_of(checked.question, found)), 0.0))
    model = checked.wide.model
    said = []
    for cause in checked.moved:
        assert cause.suspect is not None
        own = cause.suspect.touched
        names = tuple(model.names[k] for k in own)
        units = tuple(unit_of(model, int(k)) for k in own)
        said.append(Change(cause, names, units, moved[own], std[own]))
    return (*_anew(checked, found.theta, std), *said)


def _anew(checked: Checked, theta: np.ndarray, std: np.ndarray) -> Iterator[Change]:
    """Frames that the rows' own campaign calls new: from where they were, along and about their own axes."""
    unknowns = checked.unknowns
    model = unknowns.solved.model
    own = [unknowns.of_calibration(c) for c in model.coefficients]
    now = _frames_now(unknowns, theta)
    before = _frames_now(replace(unknowns, solved=unknowns.before, renamed=False), unknowns.before.theta)
    for where, label in unknowns.anew:
        step = before[where, label].inverse() * now[where, label]
        value = np.concatenate([step.translation, pin.log3(step.rotation)])
        place = [
            next(k for k, c in enumerate(own) if c == Coefficient(where, component, station=label))
            for component in FRAME_COMPONENTS
        ]
        words = "the base (or the instrument)" if where == "world_base" else "the tool (or the target on it)"
        name = where if label is None else f"{where}[{label}]"
        kept = [i for i, k in enumerate(place) if unknowns.unknown[k]]
        yield Change(
            Cause("new", name, words, 1.0),
            tuple(model.names[place[i]] for i in kept),
            tuple("rad" if FRAME_COMPONENTS[i] in ANGULAR else "m" for i in kept),
            value[kept],
            std[[place[i] for i in kept]],
        )


def _frames_now(unknowns: Wide, theta: np.ndarray) -> dict[Place, pin.SE3]:
    """All frames of the wide model, as the calibration labels them."""
    world, tip = unknowns.solved.model.frames(theta)
    renamed = [(None if unknowns.renamed and label == ONE_TARGET else label, frame) for label, frame in tip]
    named = (("world_base", world), ("tip_target", renamed))
    return {(where, label): frame for where, frames in named for label, frame in frames}


def unit_of(model: Model, k: int) -> str:
    """Unit of the motion that a coefficient makes: along, or about."""
    c = model.coefficients[k]
    if c.component == "axis":
        return "m" if model.robot.joint(c.where).kind == "prismatic" else "rad"
    return "m" if c.component in ("x", "y", "z", "t1", "t2", "a", "d") else "rad"


def repaired(saved: SavedModel, checked: Checked) -> Repaired:
    """Fit what moved.

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
    if checked.rest.p_value < REMAINING:
        raise MeasurementError(
            f"{where}: these rows differ from the calibration by more than a few moved parts explain ("
            f"{checked.rest.words} with {len(checked.causes)} allowed for); measure a whole campaign and run "
            "`aridcal identify`"
        )
    for cause in checked.moved:
        if cause.telling and cause.probability < SURE:
            raise MeasurementError(
                f"{where}: these rows cannot tell {cause.words} (probability {100 * cause.probability:.0f} %) from "
                f"{listed(cause.alike)}, and the wrong repair would be wrong elsewhere; measure what would tell, too: "
                "`aridcal check RESULTS ROWS --poses poses.csv` writes it"
            )
    found = likely(checked.question)
    final = _settled(checked.unknowns, saved.final, found.theta, covariance_of(checked.question, found))
    moved = [cause.suspect for cause in checked.moved if cause.suspect is not None]
    std = np.sqrt(np.maximum(np.diag(covariance_of(checked.question, found)), 0.0))
    geometric = _with_new_frames(_geometric(saved.geometric, checked, found.theta, std, moved), checked.unknowns, final)
    residual = checked.question.problem.residual(found.theta)
    # What is repaired is the mean over the causes that could not be told apart: its covariance holds what they differ by.
    return Repaired(replace(saved, geometric=geometric, final=final, rivals=()), changes(checked), residual)


SURE = 0.8
"""Probability below which a part is not repaired that another one is mistaken for: one repair in five would be of the wrong part,
though a row more would have told."""

REMAINING = 1e-3
"""Probability of what is left below which a repair is refused: ten times rarer than what raises an alarm, for it was looked for
in the same rows."""


def _settled(unknowns: Wide, before: SolvedModel, theta: np.ndarray, covariance: np.ndarray) -> SolvedModel:
    """The wide model as a calibration again: without what is 0 and known, without instruments, its frames where they are now.

    Args:
        unknowns: The wide model, K coefficients.
        before: The calibration's own.
        theta: Their values now, shape (K,).
        covariance: Theirs, shape (K, K).
    """
    wide = unknowns.solved.model
    labels = {label for label, _ in before.model.tip_target}
    own = [unknowns.of_calibration(c) for c in wide.coefficients]
    strange = wide.at_things | np.array([c.where == "tip_target" and c.station not in {*labels, None} for c in own])
    keep = np.flatnonzero(((theta != 0.0) | (np.diag(covariance) > 0.0)) & ~strange)
    world, tip = wide.frames(theta)
    named = [(None if unknowns.renamed and label == ONE_TARGET else label, frame) for label, frame in tip]
    model = replace(
        before.model,
        coefficients=tuple(own[k] for k in keep),
        world_base=world,
        tip_target=tuple((label, frame) for label, frame in named if label in labels),
    )
    at_frames = [own[k].basis.constant and own[k].where in ("world_base", "tip_target") for k in keep]
    return SolvedModel(model, np.where(at_frames, 0.0, theta[keep]), covariance[np.ix_(keep, keep)])


def _geometric(
    before: SolvedModel, checked: Checked, theta: np.ndarray, std: np.ndarray, moved: Sequence[Suspect]
) -> SolvedModel:
    """The geometric stage with the same zeros and frames moved; an effect that changed is none of it.

    Args:
        before: The stage as it was.
        checked: Holds the final stage as it was.
        theta: The final stage's coefficients as they are, shape (K,).
        std: Theirs.
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
    return _settled(Wide(wide, wide, np.zeros(len(now), dtype=bool)), before, now, covariance)


def _with_new_frames(geometric: SolvedModel, unknowns: Wide, final: SolvedModel) -> SolvedModel:
    """The geometric stage with frames that were fitted anew moved as the final stage's were."""
    model = geometric.model
    placed = {"world_base": dict(model.world_base), "tip_target": dict(model.tip_target)}
    before = _frames_now(replace(unknowns, solved=unknowns.before, renamed=False), unknowns.before.theta)
    after = {"world_base": dict(final.model.world_base), "tip_target": dict(final.model.tip_target)}
    for where, label in unknowns.anew:
        old, new, own = before[where, label], after[where][label], placed[where][label]
        placed[where][label] = new * old.inverse() * own if where == "world_base" else own * old.inverse() * new
    world, tip = (tuple(placed[where].items()) for where in ("world_base", "tip_target"))
    return replace(geometric, model=replace(model, world_base=world, tip_target=tip))
