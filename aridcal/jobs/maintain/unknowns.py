"""Unknowns of new rows, which the calibration does not hold: instruments around the arm, and new frames.

Each is a number more of the wide model, of which nothing is known beforehand: its prior is as wide as a metre or a radian about
where it begins, and that is found from the rows themselves with the calibrated arm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import ANGULAR, FRAME_COMPONENTS, Coefficient
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.thing_starts import NominalRows, start_values
from aridcal.engine.instruments.setup import TIP
from aridcal.engine.model.model import ONE_FRAME, Model
from aridcal.engine.model.predictions import observations_of, rows_of_data
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Frames as FrameChoice
from aridcal.files.campaign import frame_values
from aridcal.files.read import ONE_TARGET
from aridcal.jobs.calibrate.saved_model import SolvedModel
from aridcal.jobs.maintain.realignment import frame_start
from aridcal.system.errors import CampaignError

SIGMA_OF_UNKNOWNS = 1.0
"""Times what counts as a metre or a radian: the sigma of what is unknown. No start is off by that, so that it holds nothing."""

Place = tuple[str, str | None]
"""``world_base`` or ``tip_target``, and the label of the frame there."""


@dataclass(frozen=True)
class WideModel:
    """A calibrated model beside new rows.

    Attributes:
        before: The model as calibrated.
        solved: The model with a coefficient for everything that may have moved and everything unknown, K of them.
        unknown: Coefficients of which only these rows tell, shape (K,) bool.
        new: Frames of which only these rows tell.
        renamed: True where the only target of the calibration is called ``ONE_TARGET`` here, for there are others.
    """

    before: SolvedModel
    solved: SolvedModel
    unknown: np.ndarray
    new: frozenset[Place] = frozenset()
    renamed: bool = False

    @property
    def anew(self) -> tuple[Place, ...]:
        """Frames of the calibration that are fitted anew, as the calibration labels them."""
        own = [(where, None if self.renamed and label == ONE_TARGET else label) for where, label in self.new]
        frames = {"world_base": self.before.model.world_base, "tip_target": self.before.model.tip_target}
        known = {(where, label) for where in frames for label, _ in frames[where]}
        return tuple(sorted(known & set(own), key=str))

    def of_calibration(self, c: Coefficient) -> Coefficient:
        """A coefficient under the calibration's own label."""
        mine = self.renamed and c.where == "tip_target" and c.station == ONE_TARGET
        return replace(c, station=None) if mine else c


def wide_model(solved: SolvedModel, rows: Dataset, frames: FrameChoice | None = None) -> WideModel:
    """The wide model of new rows.

    Args:
        solved: See :func:`aridcal.jobs.maintain.hypotheses.widened`.
        rows: N rows.
        frames: Of their own campaign: those that it names are not as calibrated.

    Raises:
        CampaignError: a frame is named of which the calibration has several.
        MeasurementError: the rows cannot tell where something is that nobody knows.
    """
    model, theta = solved.model.recentred(solved.theta)
    labels = [label for label, _ in model.tip_target]
    model = _with_targets(model, rows)
    renamed = labels == [None] and rows.labels.target is not None
    new: set[Place] = {("tip_target", label) for label, _ in model.tip_target if label not in (*labels, None, TIP)}
    new -= {("tip_target", ONE_TARGET)} if renamed else set()
    fixed: set[Place] = {("tip_target", TIP)}
    for where in ("world_base", "tip_target"):
        if frames is not None and where in frames.model_fields_set:
            model, place, free = _as_declared(model, where, frames, rows)
            new, fixed = (new | {place}, fixed) if free else (new, fixed | {place})
    frame_of = [(c.where, c.station) if c.basis.constant else None for c in model.coefficients]
    fitted = np.array(
        [place in new and _observed(c, rows) for place, c in zip(frame_of, model.coefficients, strict=True)]
    )
    forgotten = fitted | np.array([place in fixed for place in frame_of])
    count, missing = len(solved.theta), len(model.coefficients) - len(solved.theta)
    covariance = np.zeros((count + missing, count + missing))
    covariance[:count, :count] = solved.covariance
    theta = np.concatenate([theta, np.zeros(missing)])
    covariance[forgotten], covariance[:, forgotten] = 0.0, 0.0
    covariance[fitted, fitted] = SIGMA_OF_UNKNOWNS**2
    if rows.direct:
        question = problem(model, rows)
        for where, label in sorted(new, key=str):
            theta = frame_start(question, theta, where, label)
        model, theta = model.recentred(theta)
        return WideModel(solved, SolvedModel(model, theta, covariance), fitted, frozenset(new))
    model, theta, covariance, of_things = _with_things(_with_starts(model, theta, rows, new), theta, covariance, rows)
    unknown = np.concatenate([fitted, of_things])
    return WideModel(solved, SolvedModel(model, theta, covariance), unknown, frozenset(new), renamed)


def _with_targets(model: Model, rows: Dataset) -> Model:
    """The model with a frame on the tip, and its constants, for each target of the rows."""
    if rows.labels.target is None:
        return model
    frames = dict(model.tip_target)
    coefficients = list(model.coefficients)
    if None in frames:
        frames[ONE_TARGET] = frames.pop(None)
        on_tip = [c.where == "tip_target" and c.basis.constant for c in coefficients]
        coefficients = [replace(c, station=ONE_TARGET) if m else c for c, m in zip(coefficients, on_tip, strict=True)]
    for label in sorted(set(rows.labels.target.tolist()) - set(frames)):
        frames[label] = pin.SE3.Identity()
        if label != TIP:
            coefficients += [Coefficient("tip_target", component, station=label) for component in FRAME_COMPONENTS]
    return replace(model, coefficients=tuple(coefficients), tip_target=tuple(frames.items()))


def _as_declared(model: Model, where: str, frames: FrameChoice, rows: Dataset) -> tuple[Model, Place, bool]:
    """The model with a frame where the rows' own campaign has it, the frame's place, and whether it is fitted."""
    settings = getattr(frames, where)
    places = dict(getattr(model, where))
    label = next(iter(places)) if len(places) == 1 else ONE_TARGET if where == "tip_target" else ""
    if label not in places:
        raise CampaignError(
            f"{rows.title}: frames.{where}: the calibration has several ({', '.join(map(str, places))}), and each is as it was; "
            "delete the key"
        )
    if not settings.identify or {"xyz", "rpy"} & settings.model_fields_set:
        places[label] = frame_values(settings).at
    renewed = tuple(places.items())
    changed = replace(model, world_base=renewed) if where == "world_base" else replace(model, tip_target=renewed)
    return changed, (where, label), settings.identify


def _observed(c: Coefficient, rows: Dataset) -> bool:
    """False for turns of a target that is a point: they stay as they are."""
    return c.where == "world_base" or c.component not in ANGULAR or rows.sees_turns


def _with_starts(model: Model, theta: np.ndarray, rows: Dataset, new: set[Place]) -> Model:
    """The model with new frames and things where the rows have them."""
    things = Model(model.robot, (), instruments=rows.instruments, routes=model.routes)
    readings = observations_of(things, rows)
    anywhere = ("world_base", None) in new
    arm = replace(model, tip_target=ONE_FRAME, world_base=ONE_FRAME if anywhere else model.world_base)
    arm, theta_arm = _without_target(arm, theta, anywhere)
    arm_rows = rows_of_data(arm, rows.with_labels(target=None))
    R, p = arm.poses(theta_arm, arm_rows)
    names = [label for label, _ in model.tip_target]
    number = (
        np.zeros(len(rows), dtype=int)
        if rows.labels.target is None
        else np.array([names.index(t) for t in rows.labels.target])
    )
    known_frames = {k: frame for k, (label, frame) in enumerate(model.tip_target) if ("tip_target", label) not in new}
    hints = {k: frame for k, (_, frame) in enumerate(model.tip_target)}
    one_world = np.zeros(
        len(rows), dtype=int
    )  # the base stands in one place for all new rows, or is in R and p already
    world = None if anywhere else pin.SE3.Identity()
    starts = start_values(NominalRows(rows, readings, R, p, number, hints, known_frames, one_world, world))
    return replace(
        model,
        world_base=((None, starts.world_base[0]),) if anywhere else model.world_base,
        tip_target=tuple((label, known_frames.get(k, starts.tip_target[k])) for k, label in enumerate(names)),
        instruments=rows.instruments,
        states=starts.states,
    )


def _without_target(model: Model, theta: np.ndarray, anywhere: bool) -> tuple[Model, np.ndarray]:
    """The arm up to its tip without the target, and without the base where that may be anywhere, with its coefficients."""
    removed = {"tip_target", *(("world_base",) if anywhere else ())}
    indices = [k for k, c in enumerate(model.coefficients) if c.where not in removed]
    return model.with_coefficients([model.coefficients[k] for k in indices]), theta[indices]


def _with_things(
    model: Model, theta: np.ndarray, covariance: np.ndarray, rows: Dataset
) -> tuple[Model, np.ndarray, np.ndarray, np.ndarray]:
    """The model with U coefficients of the things, theta, covariance, and which are unknown altogether, shape (U,) bool."""
    unknown_things = [
        (Coefficient(things.names[k], things.role.components[c]), float(things.std[k, c]))
        for things in rows.instruments.things.values()
        for k, c in np.argwhere(things.free).tolist()
    ]
    model = model.with_coefficients((*model.coefficients, *(c for c, _ in unknown_things)))
    std = np.array([s for _, s in unknown_things])
    sizes = np.where(np.isfinite(std), std, SIGMA_OF_UNKNOWNS * model.sizes[len(theta) :])
    wide = np.zeros((len(theta) + len(unknown_things),) * 2)
    wide[: len(theta), : len(theta)] = covariance
    wide[range(len(theta), len(wide)), range(len(theta), len(wide))] = sizes**2
    return model, np.concatenate([theta, np.zeros(len(unknown_things))]), wide, ~np.isfinite(std)
