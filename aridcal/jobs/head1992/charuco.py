"""A ChArUco board in place of the calibration squares, found by OpenCV.

Its frame is like that of the square: origin at the board's centre, x right, y up, z out of the paper towards the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from aridcal.engine.instruments.camera import rays
from aridcal.jobs.head1992.fiducials import Fiducials
from aridcal.jobs.head1992.matching import NotMeasured, spans_plane
from aridcal.jobs.head1992.square import FiducialLayout
from aridcal.jobs.head1992.square_pose import NO_SONARS, fit_pose
from aridcal.system.errors import CampaignError, nearest

# Corners to measure a pose from: six numbers, and as many again that tell how well they fit.
MIN_CORNERS = 6

# [px] of a corner, before the residuals tell.
FIRST_STD = 0.1


@dataclass(frozen=True)
class Board:
    """A ChArUco board: chessboard squares and markers, sides in [m]."""

    squares_x: int
    squares_y: int
    square: float
    marker: float
    dictionary: str

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """Return OpenCV's own board.

        Raises:
            CampaignError: The dictionary is unknown or too small, or the sizes make no board.
        """
        known = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
        if self.dictionary not in known:
            raise CampaignError(f"`dictionary`: unknown {self.dictionary!r}{nearest(self.dictionary, known)}")
        words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        if self.squares_x * self.squares_y // 2 > len(words.bytesList):
            raise CampaignError(
                f"`squares_x` and `squares_y`: {self.dictionary} has {len(words.bytesList)} markers, too few for "
                f"{self.squares_x} x {self.squares_y} squares; check both numbers"
            )
        try:
            return cv2.aruco.CharucoBoard((self.squares_x, self.squares_y), self.square, self.marker, words)
        except (cv2.error, SystemError):  # SystemError: how OpenCV's constructors fail where they are strict
            raise CampaignError("`marker` must be smaller than `square`, and the board larger than 1 x 1") from None


def corner_places(board: Board) -> np.ndarray:
    """Return the places of the board's inner corners in its frame, numbered as OpenCV does, shape (N, 3), [m]."""
    # OpenCV puts the board's origin at its upper left corner, with y down.
    corners = np.asarray(board.opencv().getChessboardCorners(), dtype=float)
    middle = np.array([board.squares_x, board.squares_y, 0]) * board.square / 2
    return (corners - middle) * [1, -1, 1]


def find_charuco(image: np.ndarray, board: Board, index: int, intrinsics: np.ndarray) -> Fiducials:
    """Find a board's inner corners.

    OpenCV finds them, and its solver for plane targets (IPPE, Collins and Bartoli, IJCV 2014) starts the fit of the pose.

    Args:
        image: Grey levels, uint8, shape (height, width).
        board: What to look for.
        index: The board's index in the table of squares.
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).

    Returns:
        The corners, numbered as OpenCV does; their noise is what their residuals show.

    Raises:
        NotMeasured: Too few corners are seen.
    """
    detector = cv2.aruco.CharucoDetector(board.opencv())
    corners, ids, _, _ = detector.detectBoard(image)
    if ids is None or len(ids) < MIN_CORNERS:
        count_seen = 0 if ids is None else len(ids)
        raise NotMeasured(f"only {count_seen} corners of the board are seen: {MIN_CORNERS} are needed")
    ids, pixels = ids.ravel(), corners.reshape(-1, 2).astype(float)
    points = corner_places(board)[ids]
    if not spans_plane(points):
        raise NotMeasured("the corners that are seen lie on one line")
    normalised = rays(pixels, intrinsics)
    success, turn, shift = cv2.solvePnP(points, normalised, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not success:
        raise NotMeasured("the board's corners fit no pose")
    T = np.eye(4)
    T[:3, :3], _ = cv2.Rodrigues(turn)
    T[:3, 3] = shift.ravel()
    covariances = np.tile(FIRST_STD**2 * np.eye(2), (len(ids), 1, 1))
    pose = fit_pose(points, pixels, covariances, NO_SONARS, intrinsics, T)
    x_and_y = np.eye(3)[:2]
    layout = FiducialLayout(
        square=np.full(len(ids), index),
        fiducial=ids,
        centres=points,
        axes=np.tile(x_and_y, (len(ids), 1, 1)),
        sizes=np.zeros((len(ids), 2)),
    )
    return Fiducials(layout, pixels, covariances * pose.chi2 / pose.dof, pose.T_camera_square)
