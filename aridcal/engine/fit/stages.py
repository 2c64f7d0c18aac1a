"""The nominal and the geometric stage of a calibration: frames alone, then frames with the identifiable constants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants, frame_coefficients, frame_labels, has_world, measures_target
from aridcal.engine.fit.flags import robust_sigma
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable, minimise, thin
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import Problem, problem, unscaled
from aridcal.engine.fit.question import EndFrame, Question
from aridcal.engine.fit.thing_starts import MOST_THING_ROWS, NominalRows, start_values
from aridcal.engine.instruments.channels import spread
from aridcal.engine.instruments.setup import TIP
from aridcal.engine.model.model import Model
from aridcal.engine.model.predictions import observations_of, rows_of_data
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.errors import MeasurementError, NotIdentifiable, NotOfThisRobot
from aridcal.system.progress import SILENT, Progress

STRANGE_SHARE, STRANGE_LENGTH, STRANGE_ANGLE = 0.05, 5e-3, 0.2
"""What no robot leaves after calibration, so that the measurements must be of something else: a twentieth of the targets'
spread and 5 mm per axis, or 200 mrad per axis."""

STRANGE_PIXELS = 40.0
"""The same of pixels: at a usual focal length 40 px are 3 degrees."""

RESTART_ROWS = 150
"""Work: Rows of a restart, or four times the coefficients if that is more: where a minimum lies shows in these."""

DRAWN_STARTS = 2
"""Work: Starts that are drawn around the answer."""

REACH_ANGLE, REACH_LENGTH = 0.05, 0.02
"""Work: How far from the answer those are, [rad] and [m]: ten times what robots are usually wrong by."""

SAME_RESIDUAL_SHARE = 0.01
"""Work: Share of sigma by which residuals of one minimum may differ."""

LENGTH_COMPONENTS = frozenset({"x", "y", "z", "a", "d"})
"""Components in [m]."""


@dataclass(frozen=True)
class Geometry:
    """Two fits of the same rows: frames alone, and frames with the identifiable constants.

    Attributes:
        nominal: Frames alone.
        geometric: With the constants; the same as ``nominal`` where nothing predicts held-back rows better than that.
        kept: Why the constants stay nominal, in words; empty if they do not.
        free: Share of the numbers measured that are left after fitting the constants which were given up.
    """

    nominal: Fit
    geometric: Fit
    kept: str = ""
    free: float = 1.0


def fit_geometry(
    question: Question, robot: Robot, train: Dataset, labels: tuple[str, ...], progress: Progress = SILENT
) -> Geometry:
    """Fit the frames alone, then the frames and the identifiable constants.

    Args:
        question: Which frames and which set of constants.
        robot: The nominal chain.
        train: Rows to fit.
        labels: All stations, where a frame is per station.
        progress: Called with the rows done in each pass over them.

    Raises:
        NotIdentifiable: nothing can be identified from these rows.
        NotOfThisRobot: the rows cannot be of this robot.
    """
    frames = frame_coefficients(question, labels, train)
    fit_problem = problem(_start(question, robot, train, labels, frames), train, progress)
    try:
        nominal = fit_identifiable(fit_problem, range(len(frames))) if frames else fit(fit_problem)
    except NotIdentifiable:
        zero = np.zeros(len(frames))
        _refuse_strangers(fit_problem, fit_problem.model, zero, fit_problem.residual(zero))
        raise
    candidates = frames + constants(robot, question.constants)
    geometric = nominal
    if candidates:
        centred, _ = nominal.model.recentred(nominal.theta)
        fit_problem = problem(centred.with_coefficients(candidates), train, progress)
        geometric = fit_identifiable(fit_problem, range(len(candidates)), lengths_and_angles(candidates, len(frames)))
    _refuse_strangers(fit_problem, geometric.model, geometric.theta, unscaled(geometric.residual, train.relative))
    return Geometry(nominal, with_restarts(geometric, train, question.starts, progress) if candidates else nominal)


def lengths_and_angles(candidates: Sequence[Coefficient], frames: int) -> tuple[list[int], list[int]]:
    """Indices of the constants that are lengths, and of those that are angles; the frames before them are neither."""
    constants = range(frames, len(candidates))
    lengths = [k for k in constants if candidates[k].component in LENGTH_COMPONENTS]
    return lengths, [k for k in constants if k not in set(lengths)]


def _start(
    question: Question, robot: Robot, train: Dataset, labels: tuple[str, ...], frames: tuple[Coefficient, ...]
) -> Model:
    """The nominal robot with starts of its frames and of the things that its measurements refer to."""
    bare = Model(robot, (), instruments=train.instruments, routes=train.labels.routes)
    predictions = observations_of(bare, train)
    world, tip = question.world_base, question.tip_target
    names = frame_labels("tip_target", tip, labels, train)
    station, number = (_frame_of_each_row(frame, train, labels) for frame in (world, tip))
    if train.labels.target is not None:
        number = np.searchsorted(np.array(names), train.labels.target.astype(str))
    if predictions.direct:
        some = thin(replace(predictions.rows, world=station, tip=number), MOST_THING_ROWS)
        train, predictions, station, number = train.select(some), predictions[some], station[some], number[some]
    R, p = bare.poses(np.zeros(0), predictions.rows)
    hints = {k: pin.SE3.Identity() if name == TIP else question.target(name).at for k, name in enumerate(names)}
    fixed = not measures_target(train)
    known_targets = {
        k: hint for k, hint in hints.items() if fixed or names[k] == TIP or not question.target(names[k]).unknown
    }
    known_world = None if world.unknown and has_world(train) else world.at
    start = start_values(NominalRows(train, predictions, R, p, number, hints, known_targets, station, known_world))
    return Model(
        robot,
        frames,
        tuple(zip(frame_labels("world_base", world, labels, train), start.world_base, strict=True)),
        tuple((name, start.tip_target[k]) for k, name in enumerate(names)),
        instruments=train.instruments,
        states=start.states,
        routes=train.labels.routes,
        target_on=question.target_on,
    )


def nominal_sigma(question: Question, robot: Robot, rows: Dataset, labels: tuple[str, ...]) -> np.ndarray:
    """Residuals of the nominal robot with frames from closed forms, as a robust sigma: quick, and nearly the fit's.

    Returns:
        Robust sigma of each channel, shape (C,), [m] and [rad] per axis.
    """
    model = _start(question, robot, rows, labels, ())
    some = thin(rows_of_data(model, rows), MOST_THING_ROWS)
    return robust_sigma(observations_of(model, rows.select(some)).residual(np.zeros(0)), rows.channels)


def with_things_moved(geometric: Fit, final: Fit) -> Model | None:
    """The geometric model with things moved by the constant effects on them of the final one; None if it has no such effects."""
    model, instruments = geometric.model, final.model.instruments
    at_things = np.flatnonzero(final.model.at_things).tolist()
    moving = [k for k in at_things if final.model.coefficients[k].basis.form == "ones"]
    if not moving:
        return None
    states = {name: model.states.get(name, things.start).copy() for name, things in instruments.things.items()}
    for role, things in instruments.things.items():
        change = np.zeros((len(things), len(things.role.components)))
        for k in moving:
            c = final.model.coefficients[k]
            if c.where in things.places:
                change[things.places[c.where], things.role.moved_by(c.where, c.component)] += final.theta[k]
        states[role] = things.role.moved(states[role], change)
    return replace(model, states=states)


def recentred(fit: Fit) -> Fit:
    """The same fit with its frames at their identified place: their coefficients' std is a twist in their own axes."""
    model, theta = fit.model.recentred(fit.theta)
    return replace(fit, model=model, theta=theta)


def _refuse_strangers(question: Problem, model: Model, theta: np.ndarray, residual: np.ndarray) -> None:
    """Refuse measurements that cannot be of this robot: any result would be meaningless.

    Args:
        question: N rows.
        model: The geometry.
        theta: Its coefficients.
        residual: Measured minus predicted, shape (N, m), [m] and [rad].

    Raises:
        NotOfThisRobot: residuals are too large; it says what to check.
    """
    train = question.data
    places = np.where(np.isnan(train.position), model.poses(theta, question.rows)[1], train.position)
    centre = places - np.nanmean(places, axis=0)
    extent = float(np.sqrt(np.nanmean(np.nansum(centre**2, axis=1))))
    most = {"m": max(STRANGE_SHARE * extent, STRANGE_LENGTH), "rad": STRANGE_ANGLE, "px": STRANGE_PIXELS}
    sigmas = zip(train.channels, robust_sigma(residual, train.channels).tolist(), strict=True)
    strange = [(channel.unit, sigma) for channel, sigma in sigmas if sigma > most.get(channel.unit, np.inf)]
    if not strange:
        return
    unit, sigma = strange[0]
    columns = "every joint's column, unit, sign and order of rows"
    misfit, advice = {
        "m": (
            f"{1e3 * sigma:.0f} mm per axis of the {1e3 * extent:.0f} mm by which the targets spread",
            f"{columns}, and the unit of the positions",
        ),
        "rad": (f"{1e3 * sigma:.0f} mrad per axis", "the order qx qy qz qw, `orientation` and its unit"),
        "px": (f"{sigma:.0f} px per axis", f"{columns}, which marker is which, and that no image is mirrored"),
    }[unit]
    raise NotOfThisRobot(
        f"{train.title}: these measurements are not of this robot: {misfit} cannot be explained. Check {advice}; "
        "that the URDF is the right one; and whether tracker or target were moved in between (then `per: station`)"
    )


def _frame_of_each_row(frame: EndFrame, train: Dataset, labels: tuple[str, ...]) -> np.ndarray:
    """Number of the frame that each row belongs to, shape (N,); 0 for rows without a station, whose path has no such frame."""
    if not frame.by_station:
        return np.zeros(len(train), dtype=int)
    if train.labels.station is None or not labels:
        raise MeasurementError("a frame is per station: the table needs a `station` column")
    number = {label: k for k, label in enumerate(labels)}
    return np.array([number.get(s, 0) for s in train.labels.station.tolist()], dtype=int)


def with_restarts(
    fit: Fit, train: Dataset, starts: Callable[[Fit, Dataset], list[np.ndarray]], progress: Progress = SILENT
) -> Fit:
    """Solve again on some of the rows from other places, ``starts`` among them, and note how many lead to the same minimum."""
    some = thin(rows_of_data(fit.model, train), max(RESTART_ROWS, 4 * len(fit.theta)))
    part = problem(fit.model, train.select(some), progress)
    weight = fit.weight[some]
    prior = Prior(np.zeros(len(fit.theta)), fit.believed) if fit.believed.any() else None
    reference = minimise(part, fit.theta, weight, prior)
    is_length = np.array([c.component in LENGTH_COMPONENTS for c in fit.model.coefficients])
    reach = np.where(is_length, REACH_LENGTH, REACH_ANGLE)
    reach[fit.model.sizes != 1.0] = 0.0  # a lens is not started from elsewhere
    rng = np.random.default_rng(0)
    others = [fit.theta + reach * rng.uniform(-1, 1, len(reach)) for _ in range(DRAWN_STARTS)]
    others += starts(fit, part.data)
    tolerance = SAME_RESIDUAL_SHARE * spread(reference.sigma, train.channels)
    agreed = 0
    for theta in progress.over(others, "other starts"):
        other = minimise(part, theta, weight, prior)
        off = np.abs(other.at.residual - reference.at.residual)[weight > 0.5]
        agreed += not np.any(off > tolerance)  # NaN in what a row does not measure
    return replace(fit, convergence=replace(fit.convergence, restarts=len(others), agreed=agreed))
