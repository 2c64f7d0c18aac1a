"""``instruments`` of a campaign: what is known beforehand of the things that its measurements refer to (FORMATS section 7)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator, Field, PositiveInt, field_validator, model_validator

from aridcal.inputs.yaml_file import Number, Positive, RelativePath, Section, Vector3

EXACT = 1e-5
"""[m], [rad] Sigma of a length or a right angle where none is stated: finer than workshops measure them."""

LEAST_NORMAL = 1e-9
"""Length of a normal below which it points nowhere."""

Carrier = Literal["tip", "world"]
"""What a camera or a board is fixed to."""


def _as_label(label: Any) -> Any:
    """Labels are text; YAML reads 7 as a number."""
    return str(label) if type(label) is int else label


Label = Annotated[str, BeforeValidator(_as_label)]


class Placement(Section):
    """A frame, as in URDF: ``xyz`` in [m], ``rpy`` in [rad]."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @property
    def homogeneous(self) -> np.ndarray:
        """The same as a matrix, shape (4, 4)."""
        R = pin.rpy.rpyToMatrix(np.array(self.rpy))
        return np.asarray(pin.SE3(R, np.array(self.xyz)).homogeneous)

    @property
    def given(self) -> bool:
        """True where the campaign says anything of it."""
        return not self.model_fields_set.isdisjoint(("xyz", "rpy"))


class LengthSettings(Section):
    """A known distance between two points, two anchors or two markers."""

    between: tuple[Label, Label]
    length: Positive
    """[m]"""
    std: Positive = EXACT
    """1-sigma, [m]."""


class RightAngleSettings(Section):
    """Two planes that are known to be perpendicular."""

    between: tuple[Label, Label]
    std: Positive = EXACT
    """1-sigma of the angle, [rad]."""


def _pair(value: Any) -> Any:
    """Let [a, b] stand for {between: [a, b]}."""
    return {"between": value} if isinstance(value, list | tuple) else value


def _parts_of_anchor(identify: Any) -> Any:
    """Let true stand for what is unknown of an anchor as a rule, and false for nothing."""
    if isinstance(identify, bool):
        return ("place", "offset") if identify else ()
    return identify


class AnchorSettings(Section):
    """Where a wire, a ballbar or a distance sensor is fixed: reading = scale * distance + offset."""

    xyz: Vector3 | None = None
    """In the world frame, [m]; a hint if it is identified."""
    offset: Number | None = None
    """[m]; 0 where it is neither stated nor identified."""
    scale: Positive = 1.0
    identify: Annotated[tuple[Literal["place", "offset", "scale"], ...], BeforeValidator(_parts_of_anchor)] = (
        "place",
        "offset",
    )

    @model_validator(mode="after")
    def _somewhere(self) -> AnchorSettings:
        if self.xyz is None and "place" not in self.identify:
            raise ValueError("an anchor whose place is not identified needs `xyz`; add it")
        return self


class PlaneSettings(Section):
    """A plane: all x with normal . x = offset."""

    normal: Vector3 | None = None
    """In the world frame, of any length; a hint if it is identified."""
    offset: Number | None = None
    """Along the unit normal, [m]."""
    identify: bool = True

    @field_validator("normal")
    @classmethod
    def _points_somewhere(cls, normal: Vector3 | None) -> Vector3 | None:
        if normal is not None and np.linalg.norm(normal) < LEAST_NORMAL:
            raise ValueError("a normal of length 0 points nowhere; write [0, 0, 1] for a level plane")
        return normal

    @model_validator(mode="after")
    def _known(self) -> PlaneSettings:
        if not self.identify and (self.normal is None or self.offset is None):
            raise ValueError("a plane that is not identified needs `normal` and `offset`; add them")
        return self


class ArmCameraSettings(Placement):
    """A camera on the tip or beside the arm, after OpenCV's model; ``xyz`` and ``rpy`` are T_tip_camera or T_world_camera."""

    fx: Positive | None = None
    fy: Positive | None = None
    """Focal lengths, [px]."""
    cx: Number | None = None
    cy: Number | None = None
    """Principal point, [px]; the middle of the first pixel is 0."""
    width: PositiveInt
    height: PositiveInt
    """Of the images, [px]."""
    distortion: tuple[Number, Number, Number, Number, Number] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3."""
    on: Carrier = "tip"
    identify: tuple[Literal["place", "f", "c", "distortion"], ...] = ("place",)

    @model_validator(mode="after")
    def _complete(self) -> ArmCameraSettings:
        for part, names in (("f", ("fx", "fy")), ("c", ("cx", "cy"))):
            missing = [name for name in names if getattr(self, name) is None]
            if missing and part not in self.identify:
                raise ValueError(f"add `{missing[0]}`, or let it be found: `identify: [place, {part}]`")
        return self

    @property
    def intrinsics(self) -> np.ndarray:
        """In the order of ``camera.INTRINSICS``, shape (9,); what is not stated is that of an ordinary webcam, to start from.

        Such a camera sees some 53 degrees across: its focal length is the width of the image; its axis meets the middle.
        """
        fx = self.fx or self.fy or float(self.width)
        cx = (self.width - 1) / 2 if self.cx is None else self.cx
        cy = (self.height - 1) / 2 if self.cy is None else self.cy
        return np.array([fx, self.fy or fx, cx, cy, *self.distortion])


class MarkerSettings(Placement):
    """Markers of a board; ``xyz`` and ``rpy`` are its place, T_world_board or T_tip_board."""

    file: RelativePath | None = None
    """Table of their places in the board's frame: marker, x, y, z; without it each marker is an unknown point."""
    on: Carrier | None = None
    """`None`: where the camera is not."""
    identify: bool = True

    @model_validator(mode="after")
    def _of_a_board(self) -> MarkerSettings:
        if self.file is None and (self.given or not self.identify):
            raise ValueError("a place belongs to a board: add its `file`, or delete `xyz`, `rpy` and `identify`")
        return self


class InstrumentSettings(Section):
    """All that is known beforehand."""

    points: RelativePath | None = None
    """Table of points whose coordinates in the world frame are known: point, x, y, z, std."""
    lengths: tuple[LengthSettings, ...] = ()
    anchors: dict[str, AnchorSettings] = Field(default_factory=dict)
    planes: dict[str, PlaneSettings] = Field(default_factory=dict)
    perpendicular: tuple[Annotated[RightAngleSettings, BeforeValidator(_pair)], ...] = ()
    cameras: dict[str, ArmCameraSettings] = Field(default_factory=dict)
    markers: MarkerSettings = MarkerSettings()
