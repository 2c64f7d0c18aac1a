r"""Where cameras are: the answer of a hand-eye calibration, from every row that is no outlier.

The arm is taken as nominal where its constants explain no more of the rows than chance would, by an F-test of the two fits,

.. math:: F = \frac{(S_0 - S_1) / (K_1 - K_0)}{S_1 / (n - K_1)}

Else they are fitted with the camera under a prior whose size the rows tell (:func:`aridcal.engine.fit.least_squares.shrunk`), so
that eight images do as well as they can. Rows that are held out to judge the calibration are used here, too: they judge the
model, and the camera's place is no part of that judgement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pinocchio as pin
from scipy.special import fdtrc

from aridcal.engine.fit.constants import constants, has_world
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.residual import linearise
from aridcal.engine.fit.stages import lengths_and_angles
from aridcal.engine.instruments.channels import spread
from aridcal.engine.instruments.pixels import BOARD, CAMERA, PLACE_COMPONENTS, R9, T
from aridcal.engine.instruments.setup import TIP, WORLD
from aridcal.engine.levels import LENIENT
from aridcal.engine.rows.dataset import Dataset
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.system.wording import number

Arm = Literal["nominal", "calibrated", "full model"]
"""What was taken for the arm: as its URDF has it; with constants of its own; with constants and effects."""

MOST_IMAGES = 60
"""Work: Images of which more like them are tried, spread evenly over all."""

MOST_MORE = 4
"""Times the images that there are, beyond which no more are proposed: three times as many like all of them halve any sigma."""

SIDEWAYS = np.radians(25.0)
"""[rad]: tilt of a board from which people say that it is seen from the side."""


@dataclass(frozen=True)
class MoreViews:
    """Views that would halve the sigmas of a camera's place.

    Attributes:
        count: How many.
        tilt: The usual angle between their line of sight and the board's normal, [rad]; None without a board.
    """

    count: int
    tilt: float | None


@dataclass(frozen=True)
class CameraPlace:
    """Where a camera is.

    Attributes:
        name: Of the camera.
        parent: What carries it: a link of the URDF, or ``world`` where that is not the robot's base.
        in_hand: True if it moves with the arm.
        placement: T_parent_camera; the camera looks along its z, x is to the right of its images, y down.
        std: 1-sigma as a twist in the camera's own axes, shape (6,), [m] and [rad]; 0 of what the campaign states, infinite of
            what no row tells.
        more: Views that would halve it; None where none would, or nobody can say.
    """

    name: str
    parent: str
    in_hand: bool
    placement: pin.SE3
    std: np.ndarray
    more: MoreViews | None = None

    @property
    def in_words(self) -> str:
        """How well the place is known, and what would help: ``place known to 0.3 mm, 0.4 mrad (1 sigma); ...``."""
        lost = [name for name, std in zip(PLACE_COMPONENTS, self.std, strict=True) if np.isinf(std)]
        if lost:
            return f"its {', '.join(lost)} no row tells: view the board turned about other axes, and from other sides"
        if not self.std.any():
            return "place as the campaign states it"
        position, rotation = (number(1e3 * float(np.linalg.norm(part)), 2) for part in self.std.reshape(2, 3))
        known = f"place known to {position} mm, {rotation} mrad (1 sigma)"
        if self.more is None:
            return known
        side = ""
        if self.more.tilt is not None:
            from_side = " from the side" if self.more.tilt >= SIDEWAYS else ""
            side = f"{from_side} (the board tilted by {round(float(np.degrees(self.more.tilt)))}°)"
        return f"{known}; {self.more.count} more view{'' if self.more.count == 1 else 's'}{side} would halve it"


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
    arm: Arm = "full model"
    if outcome.effects:
        its_fit, rows = outcome.stage("final").fit, outcome.measurements.fitted
    else:
        arm, its_fit = _fit_of_all(outcome, rows)
    frames = camera_frames(its_fit)
    places = (
        CameraPlace(
            name, *carrier(outcome, name), frames[name], _std(its_fit, name), _more_views(outcome, its_fit, rows, name)
        )
        for name in frames
        if len(_rows_of(rows, name))
    )
    return HandEye(arm, tuple(places))


def camera_frames(its_fit: Fit) -> dict[str, pin.SE3]:
    """Where a fit has its cameras, each in the frame of what carries it."""
    return _frames_of(its_fit, CAMERA.name)


def carrier(outcome: Outcome, camera: str) -> tuple[str, bool]:
    """The link that carries a camera, or ``world``, and whether it moves with the arm."""
    on = outcome.campaign.instruments.cameras[camera].on
    if on == TIP:
        return outcome.robot.tip, True
    if on == WORLD:
        return WORLD if has_world(outcome.measurements) else outcome.robot.base, False
    return on, True


def _frames_of(its_fit: Fit, role: str) -> dict[str, pin.SE3]:
    """Where a fit has the things of a role that have a place."""
    things = its_fit.model.instruments.things.get(role)
    if things is None:
        return {}
    change = np.zeros((len(things), len(things.role.components)))
    for c, value in zip(its_fit.model.coefficients, its_fit.theta, strict=True):
        if c.where in things.places and c.basis.always:
            change[things.places[c.where], things.role.moved_by(c.where, c.component)] += value
    states = things.role.moved(its_fit.model.states.get(role, things.start), change)
    return {
        name: pin.SE3(state[R9].reshape(3, 3), state[T])
        for name, state in zip(things.names, states, strict=True)
        if np.isfinite(state[: R9.stop]).all()
    }


def _rows_of(rows: Dataset, camera: str) -> np.ndarray:
    """Row numbers of a camera's marks."""
    of_cameras = np.array([block.traits.roles[:1] == (CAMERA,) for block in rows.blocks])
    return np.flatnonzero(of_cameras[rows.labels.block] & (rows.labels.refers[:, 0] == camera))


def _std(its_fit: Fit, camera: str) -> np.ndarray:
    """1-sigma of a camera's place, see :class:`CameraPlace`."""
    fitted = dict(zip(its_fit.model.names, its_fit.std, strict=True))
    candidates = {c.name for c in its_fit.candidates}
    names = (f"{camera}.{component}" for component in PLACE_COMPONENTS)
    return np.array([fitted.get(name, np.inf if name in candidates else 0.0) for name in names])


def _fit_of_all(outcome: Outcome, rows: Dataset) -> tuple[Arm, Fit]:
    """The fit of all rows with the nominal arm, or with constants of its own where these are significant."""
    start = outcome.stage("nominal").fit
    model, theta = start.model.recentred(start.theta)
    nominal = replace(fit(problem(model, rows), theta, np.ones(len(rows))), candidates=start.candidates)
    frames = start.model.coefficients
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
    if fdtrc(further, free.freedom, F) > LENIENT:
        return "nominal", nominal
    groups = lengths_and_angles(candidates.model.coefficients, len(frames))
    return "calibrated", fit_identifiable(candidates, order, groups, plenty=np.inf)


def _more_views(outcome: Outcome, its_fit: Fit, rows: Dataset, camera: str) -> MoreViews | None:
    """Views like some that there are, chosen one after the other, each the one that tells most, until sigmas are halved."""
    its_problem = problem(its_fit.model, rows)
    index = [k for k, name in enumerate(its_fit.model.names) if name in {f"{camera}.{c}" for c in PLACE_COMPONENTS}]
    if its_problem.groups is not None or not index or len(rows) != len(its_fit.weight):
        return None
    of_camera = _rows_of(rows, camera)
    image = np.unique(rows.readings[of_camera], axis=0, return_inverse=True)[1].reshape(-1)
    count = int(image.max()) + 1
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_IMAGES)).astype(int))
    images = [of_camera[image == k] for k in chosen]
    told = np.array([_information(its_problem, its_fit, some) for some in images])
    scale = np.where(its_fit.std > 0.0, its_fit.std, 1.0)
    H, told = (each * np.outer(scale, scale) for each in (its_fit.information, told))
    linear = np.array(
        [
            PLACE_COMPONENTS.index(its_fit.model.names[k].rpartition(".")[2]) < PLACE_COMPONENTS.index("roll")
            for k in index
        ]
    )

    def variances(information: np.ndarray) -> np.ndarray:
        own = np.diagonal(np.linalg.inv(information), axis1=-2, axis2=-1)[..., index] * scale[index] ** 2
        return np.stack([own[..., part].sum(axis=-1) for part in (linear, ~linear) if part.any()], axis=-1)

    before = variances(H)
    taken: list[int] = []
    while len(taken) < MOST_MORE * count:
        left = variances(H + told) / before
        best = int(np.argmin(left.max(axis=-1)))
        H = H + told[best]
        taken.append(best)
        if left[best].max() <= 0.25:
            tilts = _tilts(outcome, its_fit, rows, images, camera)
            return MoreViews(len(taken), None if tilts is None else float(np.median(tilts[taken])))
    return None


def _information(its_problem: Problem, its_fit: Fit, some: np.ndarray) -> np.ndarray:
    """What some rows tell of the coefficients, shape (K, K)."""
    part = linearise(its_problem.select(some), its_fit.theta, its_fit.weight[some], its_fit.sigma)
    return part.equations.information(its_fit.sigma)


def _tilts(outcome: Outcome, its_fit: Fit, rows: Dataset, images: list[np.ndarray], camera: str) -> np.ndarray | None:
    """Angle between the camera's axis and the board's normal in each image, shape (images,), [rad]; None without a board."""
    first = np.array([some[0] for some in images])
    boards, eye = _frames_of(its_fit, BOARD.name), camera_frames(its_fit)[camera]
    names = rows.labels.refers[first, 1]
    if not set(names.tolist()) <= set(boards):
        return None
    R, _ = its_fit.model.poses(its_fit.theta, problem(its_fit.model, rows.select(first)).rows)
    # The path leads to what carries the camera, or, where that is the world, to what carries the board.
    R = R if carrier(outcome, camera)[1] else np.swapaxes(R, 1, 2)
    normals = np.array([boards[name].rotation[:, 2] for name in names])
    cosine = np.einsum("ni,nij,j->n", normals, R, eye.rotation[:, 2])
    return np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
