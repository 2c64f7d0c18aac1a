"""What was found in one shot, and where its pose may start: see :mod:`aridcal.engine.instruments.camera_sonar`."""

from __future__ import annotations

import cv2
import numpy as np

from aridcal.engine.instruments.camera import rays
from aridcal.engine.instruments.camera_sonar import Head, HeadShot
from aridcal.jobs.head1992.head_settings import HeadSettings
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.head1992.sonar import fit_plane
from aridcal.jobs.head1992.square_pose import NO_SONARS, Sonars, fit_pose, start_on_plane


def head_of(settings: HeadSettings) -> Head:
    """The head as its settings have it: no sonar adds or stretches anything."""
    intrinsics, sonars = settings.camera.intrinsics, settings.sonars
    if sonars is None:
        return Head(intrinsics, NO_SONARS.positions, NO_SONARS.measures, NO_SONARS.std)
    positions = np.array(sonars.positions)
    right = np.zeros(2 * len(positions))
    return Head(np.concatenate([intrinsics, right]), positions, sonars.measures, sonars.std)


def check_pose(shot: HeadShot, head: Head) -> None:
    """Try that a shot fits a pose.

    Raises:
        NotMeasured: It does not.
    """
    sonars = Sonars(shot.ranges, head.positions, head.measures, head.std)
    try:
        fit_pose(shot.points, shot.pixels, shot.covariances, sonars, head.intrinsics, shot.T_camera_square)
    except ValueError as error:
        raise NotMeasured(str(error)) from None


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
