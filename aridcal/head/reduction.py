"""A shot reduced to what it says: a pose, how the head's own numbers move that pose, and what it tells of them by itself.

A shot has more image points and ranges than a pose has coordinates. With B their derivatives by the pose's twist t and D those
by the head's numbers phi, all divided by the noise, and y what is measured less what is predicted, y = B t + D dphi + noise
falls into two parts that share no noise: the pose C B'(y - D dphi), C = (B'B)^-1, and what is left of y off the columns of B,
which knows nothing of the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np

from aridcal.head.matching import NotMeasured
from aridcal.head.pose import NO_SONARS, Pose, Sonars, fit_pose, start_on_plane
from aridcal.head.sonar import fit_plane, predict_ranges
from aridcal.inputs.head_settings import HeadSettings, Measures
from aridcal.instruments.camera import INTRINSICS, predict_pixels, rays

# Times the usual misfit beyond which a shot is trusted less: noise alone does not do that.
WILD = 4.0

POSE_COORDINATES = 6


@dataclass(frozen=True)
class Head:
    """The camera and the sonars of a head, by their numbers.

    Attributes:
        phi: ``INTRINSICS``, then what each sonar adds [m], then by which share it reads too much, shape (9 + 2 S,).
        positions: Sensors in Doty's camera frame, shape (S, 3), [m].
        measures: What a reading is.
        std: Of a reading, [m].
    """

    phi: np.ndarray
    positions: np.ndarray
    measures: Measures
    std: float

    @classmethod
    def of(cls, settings: HeadSettings) -> Head:
        """The head as its settings have it: no sonar adds or stretches anything."""
        intrinsics = settings.camera.intrinsics
        sonars = settings.sonars
        if sonars is None:
            return cls(intrinsics, NO_SONARS.positions, NO_SONARS.measures, NO_SONARS.std)
        positions = np.array(sonars.positions)
        right = np.zeros(2 * len(positions))
        return cls(np.concatenate([intrinsics, right]), positions, sonars.measures, sonars.std)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers: ``camera.fx`` ... ``sonar_1.bias`` ... ``sonar_1.scale`` ..."""
        count = range(1, len(self.positions) + 1)
        sonars = [f"sonar_{k}.{what}" for what in ("bias", "scale") for k in count]
        return (*(f"camera.{name}" for name in INTRINSICS), *sonars)

    @property
    def intrinsics(self) -> np.ndarray:
        """Of the camera, shape (9,)."""
        return self.phi[: len(INTRINSICS)]

    @property
    def bias(self) -> np.ndarray:
        """What each sonar adds, shape (S,), [m]."""
        return self.phi[len(INTRINSICS) :][: len(self.positions)]

    @property
    def scale(self) -> np.ndarray:
        """By which share each sonar reads too much, shape (S,)."""
        return self.phi[len(INTRINSICS) + len(self.positions) :]


@dataclass(frozen=True)
class Seen:
    """What was found in one shot.

    Attributes:
        points: Fiducials in the frame of the square, shape (M, 3), [m].
        pixels: Their images, shape (M, 2).
        covariances: Of those, shape (M, 2, 2), [px²].
        ranges: As the sonars read them, shape (S,), [m].
        T_world_square: Shape (4, 4).
        T_camera_square: Where a fit of the pose may start, shape (4, 4).
    """

    points: np.ndarray
    pixels: np.ndarray
    covariances: np.ndarray
    ranges: np.ndarray
    T_world_square: np.ndarray
    T_camera_square: np.ndarray


@dataclass(frozen=True)
class Reduced:
    """N shots as poses, and what they say of the head.

    Attributes:
        T_world_camera: Shape (N, 4, 4).
        covariance: Of position [m] and rotation vector [rad] in world axes, at phi, shape (N, 6, 6).
        sensitivity: Twist (linear, angular) of the camera in world axes per unit of each of the head's numbers, (N, 6, H).
        information: Of the numbers, from each shot by itself, shape (N, H, H).
        pull: Gradient that goes with it, shape (N, H): ``information`` times the step that one shot asks for.
        misfit: Chi-square of what a shot has beyond its pose, shape (N,).
        freedom: Its degrees of freedom, shape (N,).
        range_residuals: What each sonar reads beyond the pose, shape (N, S), [m].
    """

    T_world_camera: np.ndarray
    covariance: np.ndarray
    sensitivity: np.ndarray
    information: np.ndarray
    pull: np.ndarray
    misfit: np.ndarray
    freedom: np.ndarray
    range_residuals: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> Reduced:
        return Reduced(*(getattr(self, f.name)[rows] for f in fields(self)))

    @property
    def trust(self) -> np.ndarray:
        """Weights of shots that fit together far worse than most do (a wild range, a wrong fiducial); else 1. Shape (N,)."""
        share = self.misfit / np.maximum(self.freedom, 1.0)
        usual = max(float(np.median(share)), 1.0)
        return np.asarray(np.minimum(1.0, WILD**2 * usual / np.maximum(share, 1e-300)))

    @property
    def scatter(self) -> float:
        """How many times their noise image points and ranges miss each other by within shots, RMS."""
        misfit, freedom = self.trust @ self.misfit, self.trust @ self.freedom
        return float(np.sqrt(misfit / max(freedom, 1.0)))


def reduce_shots(shots: Sequence[Seen], head: Head) -> Reduced:
    """Reduce shots, the head being as given.

    Raises:
        NotMeasured: A shot fits no pose; cannot happen with shots that were measured once, unless the head is absurd.
    """
    parts = [_reduce(shot, head) for shot in shots]
    return Reduced(*(np.array(column) for column in zip(*parts, strict=True)))


def _reduce(shot: Seen, head: Head) -> tuple[np.ndarray, ...]:
    """Reduce one shot to the fields of ``Reduced``.

    With C = (B'B)^-1 and P = I - B C B', which takes all off that a pose explains: the square's twist moves by -C B'D per unit
    of each number, the information is D'P D, the pull D'P y, and the misfit y'P y with len(y) - 6 degrees of freedom.
    """
    pose = _pose(shot, head)
    T, C = pose.T_camera_square, pose.covariance
    B, D = _derivatives(shot, head, T)
    whitened = np.einsum("mij,mj->mi", _whitening(shot), pose.pixel_residuals)
    y = np.concatenate([whitened.ravel(), pose.range_residuals / head.std])
    BD, By = B.T @ D, B.T @ y
    twist_by_phi = -C @ BD
    information = D.T @ D + BD.T @ twist_by_phi
    pull = D.T @ y + twist_by_phi.T @ By
    misfit = y @ y - By @ C @ By
    T_square_camera = np.linalg.inv(T)
    J = carried(shot.T_world_square[:3, :3], T_square_camera[:3, 3])
    return (
        shot.T_world_square @ T_square_camera,
        J @ C @ J.T,
        J @ twist_by_phi,
        information,
        pull,
        misfit,
        np.array(float(len(y) - POSE_COORDINATES)),
        pose.range_residuals,
    )


def _pose(shot: Seen, head: Head) -> Pose:
    """Fit the pose of a shot, its ranges (1 + scale) h + bias undone."""
    ranges = (shot.ranges - head.bias) / (1.0 + head.scale)
    sonars = Sonars(ranges, head.positions, head.measures, head.std)
    try:
        return fit_pose(shot.points, shot.pixels, shot.covariances, sonars, head.intrinsics, shot.T_camera_square)
    except ValueError as error:
        raise NotMeasured(str(error)) from None


def _whitening(shot: Seen) -> np.ndarray:
    """Return what divides each image point by its noise, shape (M, 2, 2)."""
    return np.linalg.inv(np.linalg.cholesky(shot.covariances))


def _derivatives(shot: Seen, head: Head, T_camera_square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate what is predicted by the square's twist and by the head's numbers, divided by the noise.

    Returns:
        B, shape (2 M + S, 6), and D, shape (2 M + S, 9 + 2 S): image points first, then ranges.
    """
    whiten = _whitening(shot)
    _, by_twist, by_intrinsics = predict_pixels(T_camera_square, shot.points, head.intrinsics)
    h, h_by_twist = predict_ranges(T_camera_square, head.positions, head.measures)
    B = np.concatenate([(whiten @ by_twist).reshape(-1, 6), h_by_twist / head.std])
    cameras, sonars = len(INTRINSICS), len(h)
    of_pixels = (whiten @ by_intrinsics).reshape(-1, cameras)
    # A reading is (1 + scale) h + bias; divided by 1 + scale, as the pose's fit has it, to keep its noise as stated.
    stretch = 1.0 + head.scale
    by_bias = np.diag(1.0 / stretch) / head.std
    by_scale = np.diag(h / stretch) / head.std
    D = np.zeros((len(B), len(head.phi)))
    D[: len(B) - sonars, :cameras] = of_pixels
    D[len(B) - sonars :, cameras:] = np.concatenate([by_bias, by_scale], axis=1)
    return B, D


def start_anywhere(points: np.ndarray, pixels: np.ndarray, sonars: Sonars, intrinsics: np.ndarray) -> np.ndarray:
    """Find T_camera_square, (4, 4), from image points (M, 2) alone or, better with few of them, with the sonars' plane."""
    if len(sonars.readings):
        plane = fit_plane(sonars.readings, sonars.positions, sonars.measures)
        return start_on_plane(points, pixels, plane, intrinsics)
    normalised = rays(pixels, intrinsics)
    _, turn, shift = cv2.solvePnP(points, normalised, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    T = np.eye(4)
    T[:3, :3], _ = cv2.Rodrigues(turn)
    T[:3, 3] = shift.ravel()
    return T


def carried(R_world_square: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Motion in world axes of what sits at p in the square's frame, shape (6, 6), when the square is seen to move.

    T_camera_square exp(v, w) moves all that is fixed to the camera by exp(-v, -w), seen from the square: its place p by
    -v - w x p = -v + [p]x w, its attitude by -w.

    Args:
        R_world_square: Shape (3, 3).
        p: Place of the camera, or of what it is mounted on, in the square's frame, shape (3,), [m].
    """
    x, y, z = p
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    J = np.zeros((6, 6))
    J[:3, :3] = -R_world_square
    J[3:, 3:] = -R_world_square
    J[:3, 3:] = R_world_square @ cross
    return J
