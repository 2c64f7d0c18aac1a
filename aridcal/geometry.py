"""The frames and the constants of a robot: the nominal and the geometric stage of a calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.campaign import Campaign, FrameSettings
from aridcal.doty import doty_links
from aridcal.effects import FRAME_COMPONENTS, LINK_COMPONENTS, Coefficient
from aridcal.errors import MeasurementError, NotIdentifiable
from aridcal.measurements import Measurements
from aridcal.model import Frames, Model
from aridcal.report1992 import start as closed_form
from aridcal.residual import Observations, predict_residuals, residuals, robust_sigma, unscaled
from aridcal.robot import Robot
from aridcal.solver import Data, Fit, Noise, fit, fit_identifiable, minimise, thin
from aridcal.start import FrameStart, start_frames

START_ROWS = 1000  # more rows sharpen a start by nothing
RESTART_ROWS = 150
# What no robot leaves after calibration: the measurements are of something else.
STRANGE_SHARE, STRANGE_LENGTH, STRANGE_ANGLE = 0.05, 5e-3, 0.2  # of the targets' spread; per axis [m]; [rad]
RESTART_ANGLE, RESTART_LENGTH = 0.05, 0.02  # how far from the answer another start is put, [rad] and [m]


@dataclass(frozen=True)
class Geometry:
    """Two fits of the same rows: frames alone, and frames with the identifiable constants."""

    nominal: Fit
    geometric: Fit


def observations(measurements: Measurements, rows: str) -> Observations:
    """Measured poses with the rows' relative sigmas, unless ``noise.rows`` says to ignore them."""
    relative = None
    if measurements.covariance is not None and rows != "ignore":
        relative = _factors(measurements.covariance)
    elif measurements.std is not None and rows != "ignore":
        relative = measurements.std / np.repeat(_typical(measurements.std), 3)
    rotation = None
    if measurements.quaternion is not None:
        rotation = Rotation.from_quat(measurements.quaternion).as_matrix()
    return Observations(measurements.position, rotation, relative)


def declared_noise(campaign: Campaign, train: Measurements) -> Noise:
    """What the campaign states of the noise; with ``rows: absolute``, what the rows themselves state."""
    noise = campaign.measurements.noise
    std = train.std if train.covariance is None else _std(train.covariance)
    if noise.rows == "absolute" and std is not None:
        position, rotation = _typical(std)
        return Noise(float(position), float(rotation) if train.quaternion is not None else None)
    return Noise(noise.position, noise.rotation)


def _typical(std: np.ndarray) -> np.ndarray:
    """RMS of the rows' sigmas, shape (2,): position [m], rotation [rad]."""
    return np.sqrt([np.mean(std[:, :3] ** 2), np.mean(std[:, 3:] ** 2)])


def _std(covariance: np.ndarray) -> np.ndarray:
    """Sigmas of rows, shape (N, 6), from their covariances, shape (N, 6, 6)."""
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


def _factors(covariance: np.ndarray) -> np.ndarray:
    """Factors of the rows' covariances, shape (N, 6, 6): each row's noise is L times noise of the typical sigmas.

    The first three of the independent noises are those of the position that the rotation does not explain, so that sigmas
    of positions and rotations can still be estimated apart.
    """
    typical = _typical(_std(covariance))
    turn = np.linalg.cholesky(covariance[:, 3:, 3:])
    lever = np.linalg.solve(covariance[:, 3:, 3:], covariance[:, 3:, :3]).transpose(0, 2, 1)
    alone = covariance[:, :3, :3] - lever @ covariance[:, 3:, :3]
    L = np.zeros_like(covariance)
    L[:, :3, :3] = np.linalg.cholesky(alone) / typical[0]
    L[:, :3, 3:] = lever @ turn / typical[1]
    L[:, 3:, 3:] = turn / typical[1]
    return L


def frame_coefficients(campaign: Campaign, labels: tuple[str, ...]) -> tuple[Coefficient, ...]:
    """Unknowns of the frames that are to be identified: world_base first."""
    found = []
    for where, settings in (("world_base", campaign.frames.world_base), ("tip_target", campaign.frames.tip_target)):
        if settings.identify:
            stations: tuple[str | None, ...] = labels if settings.per == "station" else (None,)
            found += [Coefficient(where, c, station=s) for s in stations for c in FRAME_COMPONENTS]
    return tuple(found)


def constants(robot: Robot, which: str) -> tuple[Coefficient, ...]:
    """Candidate constants of a parameter set, the ones to keep before others first (FORMATS section 4)."""
    if which == "none":
        return ()
    if which == "full":
        found = []
        for joint in robot.joints:
            along = {c: abs(float(joint.axis[k % 3])) for k, c in enumerate(FRAME_COMPONENTS)}
            ordered = sorted(FRAME_COMPONENTS, key=lambda c: -round(along[c], 9))
            found += [Coefficient(joint.name, c) for c in ordered]
        if robot.tip_joint:
            found += [Coefficient(robot.tip_joint, c) for c in FRAME_COMPONENTS]
        return tuple(found)
    found = []
    for joint, link in zip(robot.joints, doty_links(robot), strict=True):
        if link.next_origin is None:
            continue  # nothing in the URDF could hold it: it is the target's frame
        own = ["d"] if joint.kind == "prismatic" else []
        own += ["a", "alpha"] if link.singular else ["theta", "beta", "a", "alpha"]
        beyond = ["yaw", "pitch"] if link.singular else []
        if which == "angles":
            own, beyond = [c for c in own if c in ("beta", "alpha")], [c for c in beyond if c == "pitch"]
        found += [Coefficient(joint.name, c) for c in own]
        found += [Coefficient(link.next_origin, c) for c in beyond]
    return tuple(found)


def unused_links(robot: Robot, which: str) -> list[str]:
    """Sentences on where the report's link model is singular or has no place in the URDF."""
    if which not in ("doty", "angles"):
        return []
    said = []
    for link in doty_links(robot):
        if link.next_origin is None:
            said.append(f"{link.joint} ends in the tip link itself: its link parameters are those of tip_target")
        elif link.singular:
            said.append(
                f"{link.joint} and the next axis meet (a < 1 mm), where theta and beta are undefined: "
                f"{link.next_origin}.yaw and .pitch take their place"
            )
    return said


def fit_geometry(
    campaign: Campaign, robot: Robot, train: Measurements, labels: tuple[str, ...], noise: Noise, suspect: np.ndarray
) -> Geometry:
    """Fit the frames alone, then the frames and the identifiable constants.

    Args:
        campaign: Which frames and which set of constants.
        robot: The nominal chain.
        train: Rows to fit.
        labels: All stations, where a frame is per station.
        noise: Declared noise.
        suspect: Rows that repeat another's measurement although the joints moved.

    Raises:
        NotIdentifiable: nothing can be identified from these rows.
    """
    measured = observations(train, campaign.measurements.noise.rows)
    frames = frame_coefficients(campaign, labels)
    starts = _starts(campaign, robot, train, labels, measured)
    model = Model(robot, frames, *_placements(starts[0], campaign, labels))
    data = Data(model.rows(train.readings, None, train.station), measured, suspect)
    order = tuple(range(len(frames)))
    try:
        nominal = fit_identifiable(model, data, noise, order) if frames else fit(model, data, noise)
    except NotIdentifiable:
        _refuse_strangers(predict_residuals(model, np.zeros(len(frames)), data.rows, measured), measured, train)
        raise
    centred, _ = nominal.model.recentred(nominal.theta)

    candidates = frames + constants(robot, campaign.parameters.set)
    model = centred.with_coefficients(candidates)
    data = replace(data, rows=model.rows(train.readings, None, train.station))
    geometric = fit_identifiable(model, data, noise, range(len(candidates))) if candidates else nominal
    _refuse_strangers(unscaled(geometric.residual, measured), measured, train)
    if not candidates:
        return Geometry(nominal, nominal)
    return Geometry(nominal, _with_restarts(geometric, data, noise, train))


def _refuse_strangers(residual: np.ndarray, measured: Observations, train: Measurements) -> None:
    """Refuse measurements that cannot be of this robot: a result would look like one and be none."""
    sigma = robust_sigma(residual)
    centre = measured.position - measured.position.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum(centre**2, axis=1))))
    turned = measured.rotation is not None and sigma.rotation > STRANGE_ANGLE
    if sigma.position > max(STRANGE_SHARE * spread, STRANGE_LENGTH):
        left = f"{1e3 * sigma.position:.0f} mm per axis of the {1e3 * spread:.0f} mm by which the targets spread"
        advice = "every joint's column, unit, sign and order of rows, and the unit of the positions"
    elif turned:
        left = f"{1e3 * sigma.rotation:.0f} mrad per axis"
        advice = "the order qx qy qz qw, `orientation` and its unit"
    else:
        return
    raise MeasurementError(
        f"{train.files[0]}: these measurements are not of this robot: {left} cannot be explained. Check {advice}; "
        "that the URDF is the right one; and whether tracker or target were moved in between (then `per: station`)"
    )


def recentred(fit: Fit) -> Fit:
    """The same fit with its frames at their identified place: their coefficients' std is a twist in their own axes."""
    model, theta = fit.model.recentred(fit.theta)
    return replace(fit, model=model, theta=theta)


def _with_restarts(found: Fit, data: Data, noise: Noise, train: Measurements) -> Fit:
    """Solve again from other places, on some of the rows: a fit that depends on its start is not an answer."""
    some = thin(data.rows, max(RESTART_ROWS, 4 * len(found.theta)))
    rows = found.model.rows(train.readings[some], None, None if train.station is None else train.station[some])
    part = Data(rows, data.measured[some], data.suspect[some])
    weight = found.weight[some]
    reference = minimise(found.model, part, found.theta, noise, weight)
    length = np.array([c.component in ("x", "y", "z", "a", "d") for c in found.model.coefficients])
    reach = np.where(length, RESTART_LENGTH, RESTART_ANGLE)
    rng = np.random.default_rng(0)
    others = [found.theta + reach * rng.uniform(-1, 1, len(reach)) for _ in range(2)]
    others += _report_starts(found, part, train.readings[some])
    tolerance = 0.01 * np.repeat([reference.sigma.position, reference.sigma.rotation], 3)
    agreed = 0
    for theta in others:
        other = minimise(found.model, part, theta, noise, weight)
        apart = np.abs(other.sums.residual - reference.sums.residual)[weight > 0.5]
        agreed += bool(np.all(apart <= tolerance[: apart.shape[1]]))
    return replace(found, convergence=replace(found.convergence, restarts=len(others), agreed=agreed))


def _report_starts(found: Fit, data: Data, readings: np.ndarray) -> list[np.ndarray]:
    """The report's closed form (its section 3, corrected), for an arm of the ARID's build and its own parameters."""
    robot = found.model.robot
    wanted = [(k, c) for k, c in enumerate(found.model.coefficients) if c.component in LINK_COMPONENTS]
    if not wanted or data.measured.rotation is None or not is_arid(robot):
        return []
    world, tip = found.model.world_base[0][1].inverse(), found.model.tip_target[0][1].inverse()
    poses = np.broadcast_to(np.eye(4), (len(data), 4, 4)).copy()
    poses[:, :3, :3], poses[:, :3, 3] = data.measured.rotation, data.measured.position
    poses = world.homogeneous @ poses @ tip.homogeneous
    try:
        links = closed_form(poses, robot.positions(readings))
    except NotIdentifiable:
        return []
    theta = found.theta.copy()
    for k, c in wanted:
        joint, column = robot.names.index(c.where), LINK_COMPONENTS.index(c.component)
        nominal = doty_links(robot)[joint]
        theta[k] = links[joint, column] - (0.0 if c.component == "d" else getattr(nominal, c.component))
    return [theta]


def is_arid(robot: Robot) -> bool:
    """A rail and three revolute joints, all parallel, frames as in the report."""
    kinds = [joint.kind for joint in robot.joints] == ["prismatic", "revolute", "revolute", "revolute"]
    return kinds and all(
        np.allclose(joint.axis, [0, 0, 1]) and np.allclose(joint.placement.rotation, np.eye(3))
        for joint in robot.joints
    )


def _starts(
    campaign: Campaign, robot: Robot, train: Measurements, labels: tuple[str, ...], measured: Observations
) -> list[FrameStart]:
    """Closed-form starts of the frames, the best first."""
    bare = Model(robot, ())
    rows = bare.rows(train.readings)
    number = {label: k for k, label in enumerate(labels)}
    station = np.array([number[s] for s in train.station], dtype=int) if train.station is not None and labels else None

    def which(settings: FrameSettings) -> tuple[np.ndarray, int]:
        if settings.per != "station":
            return np.zeros(len(rows), dtype=int), 1
        if station is None:
            raise MeasurementError("a frame is per station: the table needs a `station` column")
        return station, len(labels)

    world, worlds = which(campaign.frames.world_base)
    tip, tips = which(campaign.frames.tip_target)
    hints = [
        (_placement(f),) * n for f, n in ((campaign.frames.world_base, worlds), (campaign.frames.tip_target, tips))
    ]
    known = [
        hint if not f.identify else None
        for f, hint in ((campaign.frames.world_base, hints[0]), (campaign.frames.tip_target, hints[1]))
    ]
    some = thin(replace(rows, world=world, tip=tip), START_ROWS)
    R, p = bare.poses(np.zeros(0), rows[some])
    measured, world, tip = measured[some], world[some], tip[some]
    starts = start_frames(R, p, measured, world, tip, known[0], known[1], hints[1])

    def misfit(start: FrameStart) -> float:
        X = np.array([f.homogeneous for f in start.world_base])[world]
        Y = np.array([f.homogeneous for f in start.tip_target])[tip]
        T = np.broadcast_to(np.eye(4), (len(p), 4, 4)).copy()
        T[:, :3, :3], T[:, :3, 3] = R, p
        T = X @ T @ Y
        sigma = robust_sigma(residuals(T[:, :3, :3], T[:, :3, 3], measured))
        return sigma.position + (0.1 * sigma.rotation if measured.rotation is not None else 0.0)

    return sorted(starts, key=misfit)


def _placements(start: FrameStart, campaign: Campaign, labels: tuple[str, ...]) -> tuple[Frames, Frames]:
    made = []
    for settings, placements in (
        (campaign.frames.world_base, start.world_base),
        (campaign.frames.tip_target, start.tip_target),
    ):
        names: tuple[str | None, ...] = labels if settings.per == "station" else (None,)
        made.append(tuple(zip(names, placements, strict=True)))
    return made[0], made[1]


def _placement(settings: FrameSettings) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(settings.rpy)), np.array(settings.xyz))
