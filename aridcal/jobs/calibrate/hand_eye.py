r"""Where cameras are: the answer of a hand-eye calibration, from every row that is no outlier.

The arm is taken as nominal where its constants explain no more of the rows than chance would, by an F-test of the two fits,

.. math:: F = \frac{(S_0 - S_1) / (K_1 - K_0)}{S_1 / (n - K_1)}

Else they are fitted with the camera under a prior whose size the rows tell (:func:`aridcal.engine.fit.least_squares.shrunk`), so
that eight images do as well as they can. Held-out rows judge the calibration, and are fitted here: the answer is no part of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin
from scipy.stats import f as f_distribution

from aridcal.engine.fit.constants import constants, has_world
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import lengths_and_angles
from aridcal.engine.instruments.channels import spread
from aridcal.engine.instruments.pixels import CAMERA, PLACE
from aridcal.engine.instruments.setup import TIP, WORLD
from aridcal.engine.levels import LENIENT
from aridcal.engine.rows.dataset import Dataset
from aridcal.jobs.calibrate.instrument_results import thing_values
from aridcal.jobs.calibrate.outcome import Outcome

Arm = Literal["nominal", "calibrated", "full model"]
"""What was taken for the arm: as its URDF has it; with constants of its own; with constants and effects."""


@dataclass(frozen=True)
class CameraPlace:
    """Where a camera is.

    Attributes:
        name: Of the camera.
        parent: What carries it: a link of the URDF, or ``world`` where that is not the robot's base.
        placement: T_parent_camera; the camera looks along its z, x is to the right of its images, y down.
        std: 1-sigma as a twist in the camera's own axes, shape (6,), [m] and [rad]; 0 of what the campaign states, infinite of
            what no row tells.
    """

    name: str
    parent: str
    placement: pin.SE3
    std: np.ndarray


@dataclass(frozen=True)
class HandEye:
    """Where all cameras are, and what was taken for the arm."""

    arm: Arm
    places: tuple[CameraPlace, ...]


def hand_eye(outcome: Outcome) -> HandEye | None:
    """Where the cameras of an outcome are; None where its rows refer to none."""
    rows = outcome.measurements.select(~outcome.outlier)
    if CAMERA.name not in rows.instruments.things:
        return None
    if outcome.effects:
        return HandEye("full model", places_of(outcome, outcome.stage("final").fit, outcome.measurements.fitted))
    arm, its_fit = _fit_of_all(outcome, rows)
    return HandEye(arm, places_of(outcome, its_fit, rows))


def places_of(outcome: Outcome, its_fit: Fit, rows: Dataset) -> tuple[CameraPlace, ...]:
    """Where a fit of some rows has the cameras that they refer to."""
    values = {(v.name, v.component): v for v in thing_values(its_fit, rows) if v.role == CAMERA.name and v.rows}
    places = []
    for name in dict.fromkeys(name for name, _ in values):
        numbers = [values[name, component] for component in PLACE]
        xyz, rpy = np.array([v.value for v in numbers], dtype=float).reshape(2, 3)
        std = [np.inf if v.status == "redundant" else v.std or 0.0 for v in numbers]
        places.append(
            CameraPlace(name, _parent(outcome, name), pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz), np.array(std))
        )
    return tuple(places)


def _fit_of_all(outcome: Outcome, rows: Dataset) -> tuple[Arm, Fit]:
    """The fit of all rows with the nominal arm, or with constants of its own where these are significant."""
    start = outcome.stage("nominal").fit
    model, theta = start.model.recentred(start.theta)
    weight = np.ones(len(rows))
    nominal = fit(problem(model, rows), theta, weight)
    frames = tuple(start.model.coefficients)
    arm = constants(outcome.robot, outcome.campaign.question.constants)
    if not arm:
        return "nominal", nominal
    candidates = problem(model.with_coefficients((*frames, *arm)), rows)
    order = range(len(frames) + len(arm))
    free = fit_identifiable(candidates, order)
    squares = [float(np.nansum((each.residual / spread(free.sigma, rows.channels)) ** 2)) for each in (nominal, free)]
    further = len(free.theta) - len(nominal.theta)
    if further <= 0 or free.freedom <= 0:
        return "nominal", nominal
    F = (squares[0] - squares[1]) / further / (squares[1] / free.freedom)
    if f_distribution.sf(F, further, free.freedom) > LENIENT:
        return "nominal", nominal
    groups = lengths_and_angles(candidates.model.coefficients, len(frames))
    return "calibrated", fit_identifiable(candidates, order, groups, plenty=np.inf)


def _parent(outcome: Outcome, camera: str) -> str:
    """The link that carries a camera."""
    on = outcome.campaign.instruments.cameras[camera].on
    if on == TIP:
        return outcome.robot.tip
    if on == WORLD:
        return WORLD if has_world(outcome.measurements) else outcome.robot.base
    return on
