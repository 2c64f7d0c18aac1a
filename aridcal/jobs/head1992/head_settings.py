"""``head.yaml``: the camera, the sonars, the squares and the shots, and the tables that it names (FORMATS section 5)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveInt, model_validator

from aridcal.engine.instruments.camera_sonar import Measures
from aridcal.engine.instruments.pose import turned
from aridcal.files.campaign import ArmSettings
from aridcal.files.instrument_settings import Placement
from aridcal.files.orientations import QUATERNION
from aridcal.files.quantities import POSITION_COLUMNS, QUATERNION_SLACK
from aridcal.files.tables import Table, read_tables
from aridcal.files.yaml_file import LARGEST_SETTING, Number, Positive, RelativePath, Section, Settings, Vector3
from aridcal.system.errors import MeasurementError
from aridcal.system.reading.regular_files import MEGA, TABLE_LIMIT, Limit

CHARUCO_KEYS = ("squares_x", "squares_y", "square", "marker", "dictionary")
POSE_COLUMNS = (*POSITION_COLUMNS, *QUATERNION)

# [m] Second singular value of the sonars' layout below which they sit on one line: a millimetre shows no tilt.
LEAST_SONAR_SPREAD = 1e-3


class CameraSettings(Section):
    """A camera after OpenCV's model (:mod:`aridcal.engine.instruments.camera`): z forward, y down; lengths in pixels."""

    fx: Positive
    fy: Positive
    """Focal lengths, [px]."""
    cx: Number
    cy: Number
    """Principal point, [px]; the middle of the first pixel is 0."""
    width: PositiveInt
    height: PositiveInt
    """Of the images, [px]."""
    distortion: tuple[Number, Number, Number, Number, Number] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3."""

    @property
    def intrinsics(self) -> np.ndarray:
        """In the order of ``camera.INTRINSICS``, shape (9,)."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion])


class SonarSettings(Section):
    """Sonars, three or more, and what they measure."""

    positions: Annotated[tuple[Vector3, ...], Field(min_length=3)]
    """In Doty's camera frame, [m], in the order h1, h2, ..."""
    measures: Measures = "perpendicular"
    std: Positive
    """Of a reading, [m]."""

    @model_validator(mode="after")
    def _off_one_line(self) -> SonarSettings:
        across = np.array(self.positions)[:, :2]
        extents = np.linalg.svd(across - across.mean(axis=0), compute_uv=False)
        if extents[1] < LEAST_SONAR_SPREAD:
            raise ValueError("the sonars sit on one line: they cannot see a plane's tilt about it; check `positions`")
        return self


class HeadSettings(Settings):
    """The whole of ``head.yaml``."""

    camera: CameraSettings
    sonars: SonarSettings | None = None
    tip_camera: Placement
    """T_tip_camera, OpenCV's camera frame."""
    target: Annotated[str, Field(pattern="^(arid_square|charuco)$")] = "arid_square"
    squares_x: PositiveInt | None = None
    squares_y: PositiveInt | None = None
    square: Positive | None = None
    """Side of a chessboard square, [m]."""
    marker: Positive | None = None
    """Side of a marker, [m]."""
    dictionary: str | None = None
    """OpenCV's name for it: DICT_4X4_50, ..."""
    squares: RelativePath
    """Table of T_world_square, see ``load_squares``."""
    shots: RelativePath
    """Table of images and ranges, see ``load_shots``."""
    robot: ArmSettings | None = None
    """The nominal arm that tells which square is in view, for shots without a column ``square``."""
    world_base: Placement = Placement()
    """T_world_base of that arm."""

    @model_validator(mode="after")
    def _not_too_many_pixels(self) -> HeadSettings:
        pixels, most = self.camera.width * self.camera.height / MEGA, self.limits.image_megapixels
        if pixels > most:
            raise ValueError(
                f"camera: {self.camera.width} x {self.camera.height} are {pixels:,.0f} megapixels, at most {most:g} are "
                "decoded; raise `limits: {image_megapixels: …}` if they are meant to be"
            )
        return self

    @model_validator(mode="after")
    def _what_the_target_needs(self) -> HeadSettings:
        charuco_keys = [key for key in CHARUCO_KEYS if getattr(self, key) is not None]
        if self.target == "arid_square":
            if charuco_keys:
                raise ValueError(f"`{charuco_keys[0]}` belongs to `target: charuco`")
            if self.sonars is None:
                raise ValueError("add `sonars`: they tell how large the square's fiducials are in the image")
        elif len(charuco_keys) < len(CHARUCO_KEYS):
            missing = ", ".join(key for key in CHARUCO_KEYS if key not in charuco_keys)
            raise ValueError(f"`target: charuco` also needs: {missing}")
        return self


def load_squares(path: Path, limit: Limit = TABLE_LIMIT) -> dict[int, np.ndarray]:
    """Read ``squares.csv``: T_world_square, (4, 4), of each square by its index.

    Raises:
        MeasurementError: A cell is missing or no number, a quaternion is not of unit length, an index appears twice.
    """
    table = read_tables([path], limit=limit)
    names = ("index", *POSE_COLUMNS)
    table.require(names)
    if table.refused:
        raise MeasurementError(str(table.refused[0]))
    numbers = table.matrix(names)
    squares: dict[int, np.ndarray] = {}
    for row, (number, *_) in enumerate(numbers):
        _check_square(table, row, names, numbers[row])
        if int(number) in squares:
            raise MeasurementError(str(table.remark(row, "index", "appears twice: number the squares anew")))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = turned(numbers[row : row + 1, 4:]).as_matrix()[0], numbers[row, 1:4]
        squares[int(number)] = T
    return squares


def _check_square(table: Table, row: int, names: tuple[str, ...], numbers: np.ndarray) -> None:
    """Refuse a row of ``squares.csv`` that is no pose of a square."""
    for name, value in zip(names, numbers, strict=True):
        if not np.abs(value) <= LARGEST_SETTING:
            raise MeasurementError(str(table.remark(row, name, f"should be a number, not beyond {LARGEST_SETTING:g}")))
    index, length = numbers[0], np.linalg.norm(numbers[4:])
    if index != round(index) or index < 0:
        raise MeasurementError(str(table.remark(row, "index", "should be a whole number, 0 or more")))
    if abs(length - 1) > QUATERNION_SLACK:
        raise MeasurementError(
            str(table.remark(row, "qw", "the quaternion is not of unit length: write x y z w of norm 1", ""))
        )


def load_shots(path: Path, settings: HeadSettings) -> Table:
    """Read ``shots.csv`` and check its columns; what is wrong with a single row shows when it is measured.

    Raises:
        MeasurementError: The table cannot be read, or a column is missing.
    """
    table = read_tables([path], limit=settings.limits.table)
    table.require(["image", *range_columns(settings)])
    return table


def range_columns(settings: HeadSettings) -> list[str]:
    """Name the columns of the ranges: h1, h2, ..., one for each sonar."""
    if settings.sonars is None:
        return []
    return [f"h{k + 1}" for k in range(len(settings.sonars.positions))]
