"""``head.yaml``: the camera, the sonars, the squares and the shots (FORMATS section 5)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from aridcal.head.sonar import Measures
from aridcal.settings import RelativePath, Section, Settings, Vector3

CHARUCO_KEYS = ("squares_x", "squares_y", "square", "marker", "dictionary")


class CameraSettings(Section):
    """A camera after OpenCV's model: z forward, y down; lengths in pixels."""

    fx: PositiveFloat
    fy: PositiveFloat
    cx: float
    cy: float
    width: PositiveInt
    height: PositiveInt
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3."""

    @property
    def intrinsics(self) -> np.ndarray:
        """In the order of ``camera.INTRINSICS``, shape (9,)."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion])


class SonarSettings(Section):
    """Sonars, three or more, and what they measure."""

    positions: Annotated[tuple[Vector3, ...], Field(min_length=3)]
    """In the report's camera frame, [m], in the order h1, h2, ..."""
    measures: Measures = "perpendicular"
    std: PositiveFloat
    """Of a reading, [m]."""

    @model_validator(mode="after")
    def _off_one_line(self) -> SonarSettings:
        across = np.array(self.positions)[:, :2]
        if np.linalg.svd(across - across.mean(axis=0), compute_uv=False)[1] < 1e-3:
            raise ValueError("the sonars sit on one line: they can not see a plane's tilt about it")
        return self


class Placement(Section):
    """A frame, as in URDF: ``xyz`` in [m], ``rpy`` in [rad]."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @property
    def homogeneous(self) -> np.ndarray:
        """The same as a matrix, shape (4, 4)."""
        return np.asarray(pin.SE3(pin.rpy.rpyToMatrix(np.array(self.rpy)), np.array(self.xyz)).homogeneous)


class ArmSettings(Section):
    """The nominal arm that tells which square is in view."""

    urdf: RelativePath
    base: str | None = None
    tip: str


class HeadSettings(Settings):
    """The whole of ``head.yaml``."""

    camera: CameraSettings
    sonars: SonarSettings | None = None
    tip_camera: Placement
    """T_tip_camera, OpenCV's camera frame."""
    target: Annotated[str, Field(pattern="^(arid_square|charuco)$")] = "arid_square"
    squares_x: PositiveInt | None = None
    squares_y: PositiveInt | None = None
    square: PositiveFloat | None = None
    """Side of a chessboard square, [m]."""
    marker: PositiveFloat | None = None
    """Side of a marker, [m]."""
    dictionary: str | None = None
    """OpenCV's name for it: DICT_4X4_50, ..."""
    squares: RelativePath
    shots: RelativePath
    robot: ArmSettings | None = None
    world_base: Placement = Placement()

    @model_validator(mode="after")
    def _what_the_target_needs(self) -> HeadSettings:
        given = [key for key in CHARUCO_KEYS if getattr(self, key) is not None]
        if self.target == "arid_square":
            if given:
                raise ValueError(f"`{given[0]}` belongs to `target: charuco`")
            if self.sonars is None:
                raise ValueError("`sonars` is missing: they tell how large the square's fiducials are in the image")
        elif len(given) < len(CHARUCO_KEYS):
            missing = ", ".join(key for key in CHARUCO_KEYS if key not in given)
            raise ValueError(f"`target: charuco` also needs: {missing}")
        return self
