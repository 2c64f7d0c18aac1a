"""Shots: images and ranges read and checked, one at a time, and measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.errors import MeasurementError
from aridcal.head.charuco import Board, find_charuco
from aridcal.head.fiducials import Fiducials, find_fiducials
from aridcal.head.matching import NotMeasured
from aridcal.head.pose import NO_SONARS, Pose, Sonars, measure_pose
from aridcal.head.settings import HeadSettings
from aridcal.head.sonar import fit_plane
from aridcal.head.square import layout
from aridcal.tables import Table, read_tables

POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
NEAREST, FARTHEST = 0.02, 5.0  # [m] of a sonar's range that is not absurd
STEEPEST = 0.7  # cosine of the tilt at which the sonars must be wrong
QUATERNION_SLACK = 1e-3


@dataclass(frozen=True)
class Sighting:
    """What one shot says.

    Attributes:
        fiducials: Found in its image.
        pose: Of the square in the camera.
    """

    fiducials: Fiducials
    pose: Pose


def load_squares(path: Path) -> dict[int, np.ndarray]:
    """Read ``squares.csv``: T_world_square, (4, 4), of each square by its index.

    Raises:
        MeasurementError: A cell is missing or no number, a quaternion is not of unit length, an index appears twice.
    """
    table = read_tables([path])
    names = ("index", *POSE_COLUMNS)
    table.require(names)
    if table.refused:
        raise MeasurementError(str(table.refused[0]))
    columns = np.column_stack([table.numbers(name)[0] for name in names])
    squares: dict[int, np.ndarray] = {}
    for row, values in enumerate(columns):
        for name, value in zip(names, values, strict=True):
            if not np.isfinite(value):
                raise MeasurementError(str(table.remark(row, name, "should be a number")))
        if values[0] != round(values[0]) or values[0] < 0:
            raise MeasurementError(str(table.remark(row, "index", "should be a whole number, 0 or more")))
        if abs(np.linalg.norm(values[4:]) - 1) > QUATERNION_SLACK:
            raise MeasurementError(str(table.remark(row, "qw", "the quaternion is not of unit length", "")))
        if int(values[0]) in squares:
            raise MeasurementError(str(table.remark(row, "index", "appears twice")))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_quat(values[4:]).as_matrix(), values[1:4]
        squares[int(values[0])] = T
    return squares


def load_shots(path: Path, settings: HeadSettings) -> Table:
    """Read ``shots.csv`` and check its columns; what is wrong with a single row shows when it is measured."""
    table = read_tables([path])
    table.require(["image", *range_columns(settings)])
    return table


def range_columns(settings: HeadSettings) -> list[str]:
    """Return h1, h2, ..."""
    return [f"h{k + 1}" for k in range(len(settings.sonars.positions))] if settings.sonars else []


def read_image(name: str, folder: Path, settings: HeadSettings) -> np.ndarray:
    """Read a shot's image as grey levels, uint8.

    Raises:
        NotMeasured: No such image in the folder, not readable, not an image, or not of the camera's size.
    """
    if not name:
        raise NotMeasured("no image is named")
    path = folder / name
    try:
        if not path.resolve().is_relative_to(folder.resolve()):
            raise NotMeasured("the image lies outside the folder of the shots")
        if not path.is_file():
            raise NotMeasured("there is no such image")
        content = np.fromfile(path, np.uint8)
    except (OSError, ValueError) as error:  # a name that no file can have, or no permission
        raise NotMeasured(f"the image cannot be read: {getattr(error, 'strerror', None) or error}") from None
    try:
        image = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    except cv2.error:  # says to be larger than OpenCV reads
        image = None
    if image is None:
        raise NotMeasured("the file is empty or no image")
    camera = settings.camera
    if image.shape != (camera.height, camera.width):
        raise NotMeasured(
            f"the image is {image.shape[1]} x {image.shape[0]} pixels, the camera {camera.width} x {camera.height}"
        )
    return image


def read_ranges(h: np.ndarray, settings: HeadSettings) -> Sonars:
    """Check the ranges of a shot, shape (S,), [m].

    Raises:
        NotMeasured: One is missing, negative or absurd, or together they show no plane in front of the camera.
    """
    if settings.sonars is None:
        return NO_SONARS
    sonars = Sonars(h, np.array(settings.sonars.positions), settings.sonars.measures, settings.sonars.std)
    for k, value in enumerate(h):
        if not np.isfinite(value):
            raise NotMeasured(f"h{k + 1}: the range is missing or no number")
        if not NEAREST <= value <= FARTHEST:
            raise NotMeasured(f"h{k + 1}: a range of {value:g} m can not be right; ranges are in metres")
    try:
        plane = fit_plane(h, sonars.positions, sonars.measures)
    except ValueError as error:
        raise NotMeasured(f"sonars: {error}") from None
    if plane.normal[2] < STEEPEST or plane.distance < NEAREST:
        raise NotMeasured("sonars: the plane they show is too steep to be seen: a range must be wrong")
    return sonars


def sight(
    image: np.ndarray, sonars: Sonars, square: int, squares: dict[int, np.ndarray], head: HeadSettings
) -> Sighting:
    """Measure the pose of a square in the camera.

    Args:
        image: Grey levels, uint8.
        sonars: Ranges.
        square: Index of the square nearest the optical axis.
        squares: T_world_square of each, (4, 4).
        head: Camera and target.

    Raises:
        NotMeasured: No usable square is seen.
    """
    intrinsics = head.camera.intrinsics
    try:
        if head.target == "charuco":
            found = find_charuco(image, board(head), square, intrinsics)
        else:
            found = find_fiducials(image, layout(squares, square), intrinsics, sonars)
        pose = measure_pose(
            found.layout.centres, found.pixels, found.covariances, sonars, intrinsics, found.T_camera_square
        )
    except ValueError as error:
        raise NotMeasured(str(error)) from None
    return Sighting(found, pose)


def board(head: HeadSettings) -> Board:
    """Return the ChArUco board of the settings."""
    return Board(
        head.squares_x or 0, head.squares_y or 0, head.square or 0.0, head.marker or 0.0, head.dictionary or ""
    )


def picture(image: np.ndarray, found: Fiducials | None, own: int | None, width: int) -> bytes:
    """Draw the found fiducials on an image, those of the square itself in green, and return a small JPEG."""
    factor = width / image.shape[1]
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    if found is not None:
        labels = zip(found.layout.square, found.layout.fiducial, found.pixels, strict=True)
        for square, fiducial, (u, v) in labels:
            at = round(factor * (u + 0.5)), round(factor * (v + 0.5))
            colour = (60, 160, 0) if square == own else (200, 90, 0)
            cv2.drawMarker(small, at, colour, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
            cv2.putText(small, str(fiducial), (at[0] + 5, at[1] - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.33, colour, 1)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1])
