"""One shot of the measuring head, from its row of ``shots.csv`` to a measured pose of the tip.

Image and ranges are read and checked, the square in view is identified and measured in the camera (``sight``), and its place
in the world gives the tip (``measure_shot``). A shot that cannot be measured says why and spoils no other.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from aridcal.engine.instruments.camera import square_motion
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.files.tables import Table
from aridcal.files.yaml_file import LARGEST_SETTING, load_settings
from aridcal.jobs.head1992.charuco import Board, find_charuco
from aridcal.jobs.head1992.fiducials import Fiducials, find_fiducials
from aridcal.jobs.head1992.head_settings import HeadSettings, load_shots, load_squares, range_columns
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.head1992.sonar import fit_plane
from aridcal.jobs.head1992.square import layout
from aridcal.jobs.head1992.square_pose import NO_SONARS, Pose, Sonars, measure_pose
from aridcal.system.errors import AridcalError, MeasurementError
from aridcal.system.reading.images import image_size, read_image_file

# [m] of a range that can be right: an ultrasonic sensor's, with room to spare; others are in another unit.
NEAREST, FARTHEST = 0.02, 5.0

# Cosine of the tilt, 45 degrees, at which the sonars must be wrong: from so steep a plane the echo goes elsewhere.
STEEPEST = 0.7

# Share of the next square's distance within which the nearest must be, seen from the nominal arm, to be taken for it.
CLEAR_LEAD_SHARE = 0.5

# [m] A turn of the camera counts as a shift of this times as much: about its distance from the square.
LEVER = 0.25

# Shots: fewer are measured sooner than processes are started.
PARALLEL_FROM = 200

# [px] Width of a shot's picture on the contact sheet, and the quality of its JPEG.
THUMBNAIL, THUMBNAIL_QUALITY = 256, 80

# Green and blue, in OpenCV's order: fiducials of the square itself, and of its neighbours.
OWN_COLOUR, OTHER_COLOUR = (60, 160, 0), (200, 90, 0)


@dataclass(frozen=True)
class Shot:
    """One row of ``shots.csv``, ready to be measured.

    Attributes:
        line: Of the file.
        image: Name of its image.
        ranges: h1, h2, ..., shape (S,), [m].
        square: Index of the square nearest the optical axis; a text if the file has something else there; None if not given.
        T_world_camera: From the nominal arm, shape (4, 4); None if the square is given.
    """

    line: int
    image: str
    ranges: np.ndarray
    square: int | str | None
    T_world_camera: np.ndarray | None


@dataclass(frozen=True)
class Sighting:
    """Fiducials and pose of one image.

    Attributes:
        fiducials: In the image.
        pose: Of the square in the camera.
    """

    fiducials: Fiducials
    pose: Pose


@dataclass(frozen=True)
class ShotResult:
    """The result of a shot: a pose, or the reason why there is none.

    Attributes:
        shot: The shot.
        square: Index of the square in the image.
        T_world_tip: Shape (4, 4); None if the shot was refused.
        std: Position [m] and rotation vector [rad] in world axes, shape (6,).
        range_residuals: Readings of the sonars minus the pose's ranges, shape (S,), [m].
        fiducials: In the image; None if there are none.
        why: Why the shot was refused; empty if it was not.
        thumbnail: The image with the fiducials drawn on it, JPEG.
    """

    shot: Shot
    square: int | None = None
    T_world_tip: np.ndarray | None = None
    std: np.ndarray | None = None
    range_residuals: np.ndarray | None = None
    fiducials: Fiducials | None = None
    why: str = ""
    thumbnail: bytes = b""


def load(path: Path) -> tuple[HeadSettings, dict[int, np.ndarray], Table, list[Shot]]:
    """Read ``head.yaml`` and the tables that it names.

    Returns:
        The settings; T_world_square of each square, (4, 4), by its index; the table of shots; its rows as shots.

    Raises:
        AridcalError: A file, key, column or row of ``squares.csv`` is wrong; rows of ``shots.csv`` are not looked at.
    """
    head = load_settings(path, HeadSettings)
    squares = load_squares(head.squares, head.limits.table)
    table = load_shots(head.shots, head)
    return head, squares, table, shots_of(table, head, path)


def shots_of(table: Table, head: HeadSettings, path: Path) -> list[Shot]:
    """The rows of a table of shots, ready to be measured; ``path`` names the head's file in messages."""
    n = len(table)
    ranges = [table.numbers(name)[0] for name in range_columns(head)]
    h = np.column_stack(ranges) if ranges else np.zeros((n, 0))
    indices: list[int | str | None] = [None] * n
    cameras: list[np.ndarray | None] = [None] * n
    if "square" in table.names:
        indices = _given_squares(table)
    else:
        if head.robot is None:
            raise MeasurementError(f"{head.shots}: no column 'square'; add it, or name the `robot` in {path}")
        arm = head.robot
        robot = load_robot(arm.urdf, arm.tip, arm.base, head.limits.urdf, arm.packages, arm.arguments, arm.stated)
        cameras = list(_nominal_cameras(robot, table, head))
    images = table.texts("image")
    columns = zip(table.line, images, h, indices, cameras, strict=True)
    return [Shot(int(line), str(image), shot_ranges, square, T) for line, image, shot_ranges, square, T in columns]


def _given_squares(table: Table) -> list[int | str | None]:
    """Read the column ``square``: whole numbers as such, anything else as its text."""
    numbers, _ = table.numbers("square")
    texts = table.texts("square")
    return [
        int(n) if abs(n) < LARGEST_SETTING and n == np.rint(n) else str(t) for n, t in zip(numbers, texts, strict=True)
    ]


def _nominal_cameras(robot: Robot, table: Table, head: HeadSettings) -> Iterator[np.ndarray]:
    """Give T_world_camera, (4, 4), of each row as the nominal arm has it: T_world_base T_base_tip(q) T_tip_camera."""
    table.require(robot.readings, "They tell which square is seen, as there is no column 'square'.")
    q = np.column_stack([table.numbers(name)[0] for name in robot.readings])
    model = Model(robot, ())
    R, p = model.poses(np.zeros(0), model.rows(np.nan_to_num(q)))
    for turn, place in zip(R, p, strict=True):
        T_base_tip = np.eye(4)
        T_base_tip[:3, :3], T_base_tip[:3, 3] = turn, place
        yield head.world_base.homogeneous @ T_base_tip @ head.tip_camera.homogeneous


def image_content(name: str, settings: HeadSettings) -> bytes:
    """Read the file of a shot's image.

    Raises:
        NotMeasured: No such image in the folder of the shots, or one that cannot be read.
    """
    try:
        return read_image_file(name, settings.shots.parent, settings.limits.image)
    except AridcalError as problem:
        raise NotMeasured(str(problem)) from None


def read_image(name: str, settings: HeadSettings) -> np.ndarray:
    """Read a shot's image as grey levels, uint8; its header decides whether it is decoded at all.

    Raises:
        NotMeasured: No such image in the folder of the shots, not readable, not an image, or not of the camera's size.
    """
    content = image_content(name, settings)
    camera = settings.camera
    size = image_size(content)
    if size is None:
        raise NotMeasured(
            "the file is no image of a known kind, or damaged: save it as PNG, JPEG, TIFF, BMP, PGM or WebP"
        )
    if sorted(size) != sorted((camera.width, camera.height)):  # turned round by what a JPEG says of its camera, perhaps
        raise _other_size(*size, settings)
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        image = None
    if image is None:
        raise NotMeasured("the image cannot be decoded: is the file complete? Save it anew")
    height, width = image.shape
    if (height, width) != (camera.height, camera.width):
        raise _other_size(width, height, settings)
    return image


def _other_size(width: int, height: int, settings: HeadSettings) -> NotMeasured:
    camera = settings.camera
    return NotMeasured(
        f"the image is {width} x {height} pixels, the camera {camera.width} x {camera.height}: check `camera`"
    )


def read_ranges(h: np.ndarray, settings: HeadSettings) -> Sonars:
    """Check the ranges of a shot, shape (S,), [m].

    Raises:
        NotMeasured: One is missing, negative or absurd, or together they show no plane in front of the camera.
    """
    if settings.sonars is None:
        return NO_SONARS
    sonars = Sonars(h, np.array(settings.sonars.positions), settings.sonars.measures, settings.sonars.std)
    for name, value in zip(range_columns(settings), h, strict=True):
        if not np.isfinite(value):
            raise NotMeasured(f"{name}: the range is missing or no number")
        if not NEAREST <= value <= FARTHEST:
            raise NotMeasured(f"{name}: a range of {value:g} m cannot be right; give metres")
    try:
        plane = fit_plane(h, sonars.positions, sonars.measures)
    except ValueError as error:
        raise NotMeasured(f"sonars: {error}") from None
    if plane.normal[2] < STEEPEST or plane.distance < NEAREST:
        raise NotMeasured("sonars: the plane they show is too steep to be seen: a range must be wrong")
    return sonars


def sight(
    image: np.ndarray, sonars: Sonars, square: int, squares: Mapping[int, np.ndarray], head: HeadSettings
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
            fiducials = find_charuco(image, board(head), square, intrinsics)
        else:
            fiducials = find_fiducials(image, layout(squares, square), intrinsics, sonars)
        points, start = fiducials.layout.centres, fiducials.T_camera_square
        pose = measure_pose(points, fiducials.pixels, fiducials.covariances, sonars, intrinsics, start)
    except ValueError as error:
        raise NotMeasured(str(error)) from None
    return Sighting(fiducials, pose)


def board(head: HeadSettings) -> Board:
    """Return the ChArUco board of the settings."""
    numbers = (head.squares_x or 0, head.squares_y or 0, head.square or 0.0, head.marker or 0.0)
    return Board(*numbers, head.dictionary or "")


def tip_pose(sighting: Sighting, T_world_square: np.ndarray, T_tip_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn a sighting into the pose of the tip: T_world_square · T_camera_square⁻¹ · T_tip_camera⁻¹ (7-35c).

    Args:
        sighting: Pose of the square in the camera, with its covariance.
        T_world_square: Shape (4, 4).
        T_tip_camera: Shape (4, 4).

    Returns:
        T_world_tip, shape (4, 4), and its covariance, position and rotation vector in world axes, shape (6, 6).
    """
    T_square_tip = np.linalg.inv(T_tip_camera @ sighting.pose.T_camera_square)
    J = square_motion(T_world_square[None, :3, :3], T_square_tip[None, :3, 3])[0]
    return T_world_square @ T_square_tip, J @ sighting.pose.covariance @ J.T


def measure_shot(shot: Shot, head: HeadSettings, squares: Mapping[int, np.ndarray]) -> ShotResult:
    """Measure one shot, or say why it cannot be."""
    image = None
    try:
        image = read_image(shot.image, head)
        sonars = read_ranges(shot.ranges, head)
        square, sighting = _identified(shot, image, sonars, head, squares)
    except NotMeasured as refusal:
        thumbnail = b"" if image is None else picture(image, None, None, THUMBNAIL)
        return ShotResult(shot, why=str(refusal), thumbnail=thumbnail)
    T_world_tip, covariance = tip_pose(sighting, squares[square], head.tip_camera.homogeneous)
    return ShotResult(
        shot,
        square=square,
        T_world_tip=T_world_tip,
        std=np.sqrt(np.diag(covariance)),
        range_residuals=sighting.pose.range_residuals,
        fiducials=sighting.fiducials,
        thumbnail=picture(image, sighting.fiducials, square, THUMBNAIL),
    )


def _identified(
    shot: Shot, image: np.ndarray, sonars: Sonars, head: HeadSettings, squares: Mapping[int, np.ndarray]
) -> tuple[int, Sighting]:
    """Find out which square is seen, and measure it.

    Without a given square the nominal arm proposes the one nearest its camera's optical axis; the pose measured then tells
    better, and a square that it puts nearer is measured instead.
    """
    square = _square(shot, squares)
    sighting = sight(image, sonars, square, squares, head)
    if shot.T_world_camera is None:
        return square, sighting
    nearest = _square_seen(sighting, shot.T_world_camera, squares)
    if nearest != square:
        square, sighting = nearest, sight(image, sonars, nearest, squares, head)
        if _square_seen(sighting, shot.T_world_camera, squares) != square:
            raise NotMeasured("which square is seen is ambiguous, by the nominal arm too: give `square`")
    return square, sighting


def _square(shot: Shot, squares: Mapping[int, np.ndarray]) -> int:
    """Return the square that the shot names, or the one nearest the optical axis of the nominal arm's camera."""
    if shot.T_world_camera is None:
        if not isinstance(shot.square, int):
            raise NotMeasured(f"square: {shot.square!r} should be the index of a square")
        if shot.square not in squares:
            raise NotMeasured(f"square: there is no square {shot.square} in the table of squares: check both")
        return shot.square
    T_camera_world = np.linalg.inv(shot.T_world_camera)
    middles = {index: (T_camera_world @ T)[:3, 3] for index, T in squares.items()}
    off_axis = {index: float(np.hypot(x, y)) for index, (x, y, z) in middles.items() if z > 0}
    if not off_axis:
        raise NotMeasured("the nominal arm's camera looks away from all squares: give `square`, or check `tip_camera`")
    return min(off_axis, key=lambda index: off_axis[index])


def _square_seen(sighting: Sighting, T_world_camera: np.ndarray, squares: Mapping[int, np.ndarray]) -> int:
    """Return the square that would put the camera nearest to where the nominal arm has it."""
    T_camera_world = np.linalg.inv(T_world_camera)
    T_square_camera = np.linalg.inv(sighting.pose.T_camera_square)
    off = {}
    for index, T_world_square in squares.items():
        T = T_camera_world @ T_world_square @ T_square_camera
        cosine = (np.trace(T[:3, :3]) - 1) / 2
        turn = np.arccos(np.clip(cosine, -1, 1))
        off[index] = float(np.linalg.norm(T[:3, 3]) + LEVER * turn)
    best, *others = sorted(off, key=lambda index: off[index])
    if others and off[best] > CLEAR_LEAD_SHARE * off[others[0]]:
        raise NotMeasured(f"which square is seen is ambiguous, {best} or {others[0]}: give `square`")
    return best


def picture(image: np.ndarray, fiducials: Fiducials | None, own: int | None, width: int) -> bytes:
    """Draw the found fiducials on an image, those of the square itself in green, and return a small JPEG."""
    factor = width / image.shape[1]
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    if fiducials is not None:
        labels = zip(fiducials.layout.square, fiducials.layout.fiducial, fiducials.pixels, strict=True)
        for square, fiducial, (u, v) in labels:
            x, y = round(factor * (u + 0.5)), round(factor * (v + 0.5))
            colour = OWN_COLOUR if square == own else OTHER_COLOUR
            cv2.drawMarker(small, (x, y), colour, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
            cv2.putText(small, str(fiducial), (x + 5, y - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.33, colour, 1)
    _, content = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, THUMBNAIL_QUALITY])
    return bytes(content)


def measure_shots(shots: Sequence[Shot], head: HeadSettings, squares: Mapping[int, np.ndarray]) -> Iterator[ShotResult]:
    """Measure shots one after the other, over all processors if there are many."""
    with _mapping(len(shots)) as apply:
        yield from apply(partial(measure_shot, head=head, squares=squares), list(shots))


@contextmanager
def _mapping(n: int) -> Iterator[Callable[[Callable[[Shot], ShotResult], list[Shot]], Iterator[ShotResult]]]:
    """Give ``map``, over all processors if there is enough to do."""
    if n < PARALLEL_FROM:
        yield map
        return
    with ProcessPoolExecutor(os.cpu_count(), mp_context=multiprocessing.get_context("spawn")) as pool:
        yield partial(pool.map, chunksize=4)
