"""``instruments`` of a campaign: prior knowledge of the things that its measurements refer to (FORMATS section 7)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator, Field, field_validator, model_validator

from aridcal.engine.instruments.setup import TIP, WORLD
from aridcal.files.yaml_file import Number, Positive, RelativePath, Section, Vector3

EXACT_STD = 1e-5
"""[m], [rad]: sigma of a length or a right angle where none is stated: finer than workshops measure them."""

CONTRADICTION_SIGMAS = 3.0
"""Sigmas by which known lengths may contradict each other."""

LEAST_NORMAL = 1e-9
"""Length of a normal below which it points nowhere."""

Side = Annotated[int, Field(ge=1, le=100_000)]
"""Width or height of an image, [px]: the largest sensors have some 15,000."""

Carrier = str
"""Name of what carries a thing: ``tip``, ``world``, or a link of the URDF."""


def _as_label(label: Any) -> Any:
    """Labels are text; YAML reads 7 as a number."""
    return str(label) if type(label) is int else label


Label = Annotated[str, BeforeValidator(_as_label)]


class Placement(Section):
    """A frame, as in URDF: ``xyz`` in [m], ``rpy`` in [rad]."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    """Translation, m."""
    rpy: Vector3 = (0.0, 0.0, 0.0)
    """Rotation as in URDF, rad: Rz(yaw) Ry(pitch) Rx(roll)."""

    @property
    def homogeneous(self) -> np.ndarray:
        """The frame as a matrix, shape (4, 4)."""
        R = pin.rpy.rpyToMatrix(np.array(self.rpy))
        return np.asarray(pin.SE3(R, np.array(self.xyz)).homogeneous)

    @property
    def given(self) -> bool:
        """True where the campaign states the frame, in part at least."""
        return not self.model_fields_set.isdisjoint(("xyz", "rpy"))

    def place(self, is_known: bool) -> list[float]:
        """The translation and then the rotation matrix row by row; NaN where nothing is known."""
        T = self.homogeneous
        return [*T[:3, 3].tolist(), *T[:3, :3].reshape(-1).tolist()] if is_known else 12 * [np.nan]


class LengthSettings(Section):
    """A known distance between two points, two anchors or two markers."""

    between: tuple[Label, Label]
    """Two points, two anchors or two markers."""
    length: Positive
    """m"""
    std: Positive = EXACT_STD
    """1 sigma, m."""


class RightAngleSettings(Section):
    """Two planes that are known to be perpendicular."""

    between: tuple[Label, Label]
    """Two planes; `[table, wall]` alone will do."""
    std: Positive = EXACT_STD
    """1 sigma of the angle, rad."""


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
    """In the world frame or the link's, m."""
    on: Carrier = WORLD
    """`world`, `tip` or a link."""
    offset: Number | None = None
    """m: reading = scale · distance + offset; 0 where it is neither stated nor identified."""
    scale: Positive = 1.0
    """Of the reading."""
    identify: Annotated[tuple[Literal["place", "offset", "scale"], ...], BeforeValidator(_parts_of_anchor)] = (
        "place",
        "offset",
    )
    """`true` (`[place, offset]`), `false`, or a list of `place`, `offset`, `scale`."""

    @model_validator(mode="after")
    def _somewhere(self) -> AnchorSettings:
        if self.xyz is None and "place" not in self.identify:
            raise ValueError("an anchor whose place is not identified needs `xyz`; add it")
        return self

    @property
    def state(self) -> list[float]:
        """Place, offset and scale, NaN where nothing is known."""
        offset = np.nan if "offset" in self.identify else 0.0
        return [*(self.xyz or 3 * [np.nan]), offset if self.offset is None else self.offset, self.scale]

    @property
    def free(self) -> list[bool]:
        """Which of these are identified."""
        return [*3 * ["place" in self.identify], "offset" in self.identify, "scale" in self.identify]


class PlaneSettings(Section):
    """A plane: all x with normal . x = offset."""

    normal: Vector3 | None = None
    """In the world frame or the link's, of any length."""
    on: Carrier = WORLD
    """`world`, `tip` or a link."""
    offset: Number | None = None
    """Along the unit normal, m: all x with normal · x = offset."""
    identify: bool = True
    """`false`: `normal` and `offset` are needed, and exact."""

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

    @property
    def state(self) -> list[float]:
        """Unit normal and offset, NaN where nothing is known."""
        normal = np.full(3, np.nan) if self.normal is None else np.array(self.normal) / np.linalg.norm(self.normal)
        return [*normal.tolist(), np.nan if self.offset is None else self.offset]

    @property
    def free(self) -> list[bool]:
        """Which of two tilts and the offset are identified."""
        return 3 * [self.identify]


class ArmCameraSettings(Placement):
    """A camera on the tip or beside the arm, after OpenCV's model; ``xyz`` and ``rpy`` are T_tip_camera or T_world_camera."""

    fx: Positive | None = None
    """Focal length along u, px; may be absent if `f` is identified."""
    fy: Positive | None = None
    """Along v, px."""
    cx: Number | None = None
    """Principal point, px, the middle of the first pixel at 0; may be absent if `c` is identified."""
    cy: Number | None = None
    """Along v, px."""
    width: Side
    """Of the images, px."""
    height: Side
    """Of the images, px."""
    distortion: tuple[Number, Number, Number, Number, Number] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 of OpenCV."""
    on: Carrier = TIP
    """`tip`: it moves, markers stand; `world`: it stands, markers are on the tip; or a link."""
    identify: tuple[Literal["place", "f", "c", "distortion"], ...] = ("place",)
    """List of `place`, `f` (fx fy), `c` (cx cy), `distortion`."""

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

    @property
    def state(self) -> list[float]:
        """Place, intrinsics, and 1 for a camera on the tip or on a link: the path then leads from what it sees to the camera."""
        is_known = self.given or "place" not in self.identify
        return [*self.place(is_known), *self.intrinsics.tolist(), float(self.on != WORLD)]

    @property
    def free(self) -> list[bool]:
        """Which components of the place and which intrinsics are identified."""
        parts = (("place", 6), ("f", 2), ("c", 2), ("distortion", 5))
        return [part in self.identify for part, count in parts for _ in range(count)]


class MarkerSettings(Placement):
    """Markers of a board; ``xyz`` and ``rpy`` are its place, T_world_board or T_tip_board."""

    file: RelativePath | None = None
    """Table `marker,x,y,z[,std]` in the board's frame, m: one board. Without it each marker is an unknown point."""
    on: Carrier | None = None
    """`world`, `tip` or a link; default: where the camera is not."""
    identify: bool = True
    """`false`: `xyz rpy`, the board's place on its carrier, is exact."""

    @model_validator(mode="after")
    def _of_a_board(self) -> MarkerSettings:
        if self.file is None and (self.given or not self.identify):
            raise ValueError("a place belongs to a board: add its `file`, or delete `xyz`, `rpy` and `identify`")
        return self


class TargetSettings(Placement):
    """A target with a name: where it is on what carries it; a hint if it is identified."""

    on: Carrier = TIP
    """`tip` or a link."""
    identify: bool = True
    """`false`: its place is exact."""


class PointSettings(Section):
    """Known points, and what carries them."""

    file: RelativePath | None = None
    """Table `point,x,y,z[,std][,on]`, m, of those whose coordinates are known, exactly where `std` is empty."""
    on: Carrier = WORLD
    """Carrier of the points for which the table names none."""


def _as_points(value: Any) -> Any:
    """Let a file stand for {file: it}."""
    return value if value is None or isinstance(value, dict | PointSettings) else {"file": value}


def _as_boards(value: Any) -> Any:
    """Let one board stand for a list of one."""
    return value if isinstance(value, list | tuple) else (value,)


class InstrumentSettings(Section):
    """Prior knowledge of all things."""

    targets: dict[str, TargetSettings] = Field(default_factory=dict)
    """Targets that the column `target` names, each with its own `tip_target`. If any block has targets or a frame on
    the tip, the others do: rows without the column are of `target`, pixels and joined links of `tip` (the link's
    frame), inclinations of one called after the block."""
    points: Annotated[PointSettings, BeforeValidator(_as_points)] = PointSettings()
    """Known points: a file alone, or both keys. Others are unknown."""
    lengths: tuple[LengthSettings, ...] = ()
    """Known distances: they give the scale. Refused where they contradict each other or known coordinates by more than
    3 sigmas."""
    anchors: dict[str, AnchorSettings] = Field(default_factory=dict)
    """Fixed ends of wires, ballbars, distance sensors."""
    planes: dict[str, PlaneSettings] = Field(default_factory=dict)
    """Planes that are touched."""
    perpendicular: tuple[Annotated[RightAngleSettings, BeforeValidator(_pair)], ...] = ()
    """Pairs of planes at right angles."""
    cameras: dict[str, ArmCameraSettings] = Field(default_factory=dict)
    """After OpenCV's model; required for `pixels`. `xyz rpy` is its place on what carries it. What is identified of a
    lens may be absent, and starts as in an ordinary webcam."""
    markers: Annotated[tuple[MarkerSettings, ...], BeforeValidator(_as_boards), Field(min_length=1)] = (
        MarkerSettings(),
    )
    """One board, or a list of boards, each on a carrier of its own: `[{file: left.csv, on: left_hand}, {file:
    right.csv, on: right_hand}]`; a marker is on one of them."""

    @property
    def declared(self) -> dict[str, Mapping[str, AnchorSettings | PlaneSettings | ArmCameraSettings]]:
        """Anchors, planes and cameras by their names, by their role."""
        return {"anchor": self.anchors, "plane": self.planes, "camera": self.cameras}

    @property
    def sides(self) -> dict[str, Carrier]:
        """Carrier of the markers without a table that each camera looks at: not its own, unless the campaign says so."""
        sides = [board.on for board in self.markers if board.on is not None and board.file is None]
        usual = {name: TIP if camera.on == WORLD else WORLD for name, camera in self.cameras.items()}
        return {name: sides[0] if sides else side for name, side in usual.items()}

    @property
    def boards(self) -> dict[Carrier, MarkerSettings]:
        """Boards with a table of their markers' places, by carrier."""
        usual = next(iter(self.sides.values()), WORLD)
        return {board.on or usual: board for board in self.markers if board.file is not None}

    def looked_at(self, camera: str) -> tuple[Carrier, ...]:
        """Carriers of the markers that a camera looks at: those of boards beside its own carrier, else that of single markers."""
        carrier_of_camera = self.cameras[camera].on
        return tuple(carrier for carrier in self.boards if carrier != carrier_of_camera) or (self.sides[camera],)

    def targets_on(self, tip: str) -> dict[str, str]:
        """Links other than the robot's tip that carry targets, by the targets' labels."""
        return {name: target.on for name, target in self.targets.items() if target.on not in (TIP, tip)}

    @property
    def tables(self) -> tuple[Path, ...]:
        """Files under `instruments`."""
        named = (self.points.file, *(board.file for board in self.markers))
        return tuple(path for path in named if path is not None)

    @property
    def links(self) -> dict[str, str]:
        """Links of the URDF under `instruments`, and the key that names each."""
        things: Mapping[str, Mapping[str, Any]] = {"target": self.targets, **self.declared}
        named = {thing.on: f"{role}s.{name}.on" for role, of in things.items() for name, thing in of.items()}
        named |= {board.on: f"markers[{k}].on" for k, board in enumerate(self.markers) if board.on is not None}
        named[self.points.on] = "points.on"
        return {link: key for link, key in named.items() if link not in (TIP, WORLD)}

    @model_validator(mode="after")
    def _board_moves_in_the_images(self) -> InstrumentSettings:
        carriers = {camera.on for camera in self.cameras.values()}
        for board in self.markers:
            if board.on is not None and carriers == {board.on}:
                what = f"the {board.on}" if board.on in (TIP, WORLD) else f"{board.on}"
                raise ValueError(
                    f"markers.on: the cameras are on {what}, too: no marker moves in their images; write another"
                )
            if board.on is None and board.file is not None and len(set(self.sides.values())) > 1:
                raise ValueError("markers.on: there are cameras on the tip and in the world; say where this board is")
        if len(self.boards) < sum(board.file is not None for board in self.markers):
            raise ValueError("markers: two tables are of one carrier; put their markers in one table, in one frame")
        return self

    @model_validator(mode="after")
    def _relations_are_possible(self) -> InstrumentSettings:
        for key in ("lengths", "perpendicular"):
            for number, relation in enumerate(getattr(self, key)):
                if len(set(relation.between)) == 1:
                    raise ValueError(f"{key}[{number}].between: {relation.between[0]!r} twice; name two")
        lengths: dict[frozenset[str], LengthSettings] = {}
        for number, one in enumerate(self.lengths):
            other = lengths.setdefault(frozenset(one.between), one)
            if abs(one.length - other.length) > CONTRADICTION_SIGMAS * np.hypot(one.std, other.std):
                raise ValueError(
                    f"lengths[{number}]: {' and '.join(one.between)} are {one.length:g} m apart here and {other.length:g} m "
                    "elsewhere; delete one, or state the `std` of both"
                )
        _refuse_impossible_triangles(lengths)
        return self


def _refuse_impossible_triangles(lengths: dict[frozenset[str], LengthSettings]) -> None:
    """Refuse three lengths of which one is longer than the other two together, by more than their sigmas."""
    joined: dict[str, dict[str, LengthSettings]] = {}
    for pair, one in lengths.items():
        a, b = pair
        joined.setdefault(a, {})[b] = joined.setdefault(b, {})[a] = one
    for pair, one in lengths.items():
        a, b = pair
        for c in joined[a].keys() & joined[b].keys():
            first, second = joined[a][c], joined[b][c]
            slack = CONTRADICTION_SIGMAS * float(np.sqrt(one.std**2 + first.std**2 + second.std**2))
            if one.length > first.length + second.length + slack:
                raise ValueError(
                    f"lengths: {' and '.join(sorted(pair))} cannot be {one.length:g} m apart: by way of {c} it is "
                    f"{first.length:g} + {second.length:g} m; check these three"
                )
