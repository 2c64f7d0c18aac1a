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

from aridcal.head.camera import INTRINSICS, rays
from aridcal.head.matching import NotMeasured
from aridcal.head.pose import Sonars, fit_pose, predict_pixels, start_on_plane
from aridcal.head.settings import HeadSettings
from aridcal.head.sonar import Measures, fit_plane, predict_ranges

WILD = 4.0  # times the usual misfit, beyond which a shot is trusted less


@dataclass(frozen=True)
class Head:
    """The camera and the sonars of a head, by their numbers.

    Attributes:
        phi: ``INTRINSICS``, then what each sonar adds [m], then by which share it reads too much, shape (9 + 2 S,).
        positions: Sensors in the report's camera frame, shape (S, 3), [m].
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
        s = settings.sonars
        positions = np.array(s.positions) if s else np.zeros((0, 3))
        phi = np.concatenate([settings.camera.intrinsics, np.zeros(2 * len(positions))])
        return cls(phi, positions, s.measures if s else "perpendicular", s.std if s else 1.0)

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
        return np.asarray(np.minimum(1.0, WILD**2 * max(float(np.median(share)), 1.0) / np.maximum(share, 1e-300)))

    @property
    def scatter(self) -> float:
        """How many times their noise image points and ranges miss each other by within shots, RMS."""
        return float(np.sqrt(self.trust @ self.misfit / max(self.trust @ self.freedom, 1.0)))


def reduce_shots(shots: Sequence[Seen], head: Head) -> Reduced:
    """Reduce shots, the head being as given.

    Raises:
        NotMeasured: A shot fits no pose; cannot happen with shots that were measured once, unless the head is absurd.
    """
    parts = [_reduce(shot, head) for shot in shots]
    return Reduced(*(np.array(column) for column in zip(*parts, strict=True)))


def _reduce(shot: Seen, head: Head) -> tuple[np.ndarray, ...]:
    stretch = 1.0 + head.scale
    sonars = Sonars((shot.ranges - head.bias) / stretch, head.positions, head.measures, head.std)
    try:
        pose = fit_pose(shot.points, shot.pixels, shot.covariances, sonars, head.intrinsics, shot.T_camera_square)
    except ValueError as error:
        raise NotMeasured(str(error)) from None
    T = pose.T_camera_square
    whiten = np.linalg.inv(np.linalg.cholesky(shot.covariances))
    _, by_twist, by_intrinsics = predict_pixels(T, shot.points, head.intrinsics)
    h, h_by_twist = predict_ranges(T, head.positions, head.measures)
    S, C = len(h), len(INTRINSICS)
    B = np.concatenate([(whiten @ by_twist).reshape(-1, 6), h_by_twist / head.std])
    D = np.zeros((len(B), len(head.phi)))
    D[: len(B) - S, :C] = (whiten @ by_intrinsics).reshape(-1, C)
    # A reading is (1 + scale) h + bias; divided by 1 + scale, as the pose's fit has it, to keep its noise as stated.
    D[len(B) - S :, C : C + S] = np.diag(1.0 / stretch) / head.std
    D[len(B) - S :, C + S :] = np.diag(h / stretch) / head.std
    y = np.concatenate([np.einsum("mij,mj->mi", whiten, pose.pixel_residuals).ravel(), pose.range_residuals / head.std])
    BD, By = B.T @ D, B.T @ y
    step = -pose.covariance @ BD  # of the square's twist, per unit of each number
    T_square_camera = np.linalg.inv(T)
    J = carried(shot.T_world_square[:3, :3], T_square_camera[:3, 3])
    return (
        shot.T_world_square @ T_square_camera,
        J @ pose.covariance @ J.T,
        J @ step,
        D.T @ D + BD.T @ step,
        D.T @ y + step.T @ By,
        y @ y - By @ pose.covariance @ By,
        np.array(float(len(y) - 6)),
        pose.range_residuals,
    )


def start_anywhere(points: np.ndarray, pixels: np.ndarray, sonars: Sonars, intrinsics: np.ndarray) -> np.ndarray:
    """Find T_camera_square, (4, 4), from image points (M, 2) alone or, better with few of them, with the sonars' plane."""
    if len(sonars.readings):
        return start_on_plane(points, pixels, fit_plane(sonars.readings, sonars.positions, sonars.measures), intrinsics)
    _, turn, shift = cv2.solvePnP(points, rays(pixels, intrinsics), np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return T


def carried(R_world_square: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Motion in world axes of what sits at p in the square's frame, shape (6, 6), when the square is seen to move.

    Args:
        R_world_square: Shape (3, 3).
        p: Place of the camera, or of what it is mounted on, in the square's frame, shape (3,), [m].

    T_camera_square exp(twist) moves all that is fixed to the camera by exp(-twist), seen from the square.
    """
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = -R_world_square
    J[:3, 3:] = R_world_square @ np.array([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
    return J
