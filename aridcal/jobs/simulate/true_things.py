"""The things that a simulated arm is measured with, as they are: given by a scenario, known to its campaign, or drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import Field

from aridcal.engine.instruments.camera import INTRINSICS
from aridcal.engine.instruments.joined import GRASP
from aridcal.engine.instruments.setup import WORLD
from aridcal.files.instrument_settings import Label, LengthSettings, Placement
from aridcal.files.things import InstrumentDeclarations
from aridcal.files.yaml_file import Number, Positive, Section, Vector3

Count = Annotated[int, Field(ge=1, le=100_000)]

FACING = np.diag([1.0, -1.0, -1.0])
"""Rotation of a camera in a board's frame, x right, y up, z out of the paper, where it looks straight at the board."""

RANGE_OF_TIP, RANGE_OF_WORLD = 0.4, 0.9
"""[m] from a camera on the tip, and from one beside the arm, to the board before it that is drawn."""

MARKER_BOX = np.array([0.4, 0.3, 0.1])
"""[m] sides of the box that markers which lie about are drawn in; a third of that around a link."""

ANCHOR_DISTANCES = (1.2, 1.8)
"""How far from the middle of the workspace anchors are drawn, in its RMS radius."""

DIRECTIONS_TRIED = 500
"""In which a point is sought at a known distance from another: the one that leads nearest to where the arm reaches is taken."""

WIRE_OFFSETS = (0.0, 0.1)
"""[m] of a wire that does not begin at its anchor, as drawn."""

SCALE_SIGMA = 1e-3
"""1-sigma of a drawn scale that is to be identified."""


Around = Callable[[str], np.ndarray]
"""Places, shape (M, 3), [m], among which things are drawn, by what carries these: in its frame."""


class TrueAnchor(Section):
    """An anchor as it is; what is absent is as the campaign states it, or drawn."""

    xyz: Vector3 | None = None
    offset: Number | None = None
    scale: Positive | None = None


class TruePlane(Section):
    """A plane as it is."""

    normal: Vector3
    offset: Number


class TrueCamera(Placement):
    """A camera as it is; what is absent is as the campaign states it, and the place of one beside the arm is drawn."""

    fx: Positive | None = None
    fy: Positive | None = None
    cx: Number | None = None
    cy: Number | None = None
    distortion: tuple[Number, Number, Number, Number, Number] | None = None


class TrueThings(Section):
    """All things as they are: so many that are drawn, or each by its name."""

    points: Count | dict[Label, Vector3] = 4
    anchors: Count | dict[Label, TrueAnchor] = 3
    planes: Count | dict[Label, TruePlane] = 3
    cameras: dict[str, TrueCamera] = Field(default_factory=dict)
    board: Placement | None = None
    markers: Count | dict[Label, Vector3] = 12
    grasps: Count = 6
    """Of each block of two links that hold one body: the poses in which they take it."""
    gauge: float = Field(default=0.0, ge=0, le=1.0)
    """[m] Travel to either side of a gauge that reads the height over a plane; 0: the target touches it."""


@dataclass(frozen=True)
class RealThings:
    """Things of one role as they are.

    Attributes:
        names: Their labels.
        states: Shape (L, P).
    """

    names: tuple[str, ...]
    states: np.ndarray


def _labels(stated: int | Mapping[str, object], names: Sequence[str], word: str) -> tuple[str, ...]:
    """Labels of the things that are given or known; if there are none, of those that are drawn."""
    if isinstance(stated, Mapping):
        return tuple(dict.fromkeys((*names, *stated)))
    return tuple(names) or tuple(f"{word}_{k + 1}" for k in range(stated))


def true_points(
    things: TrueThings, declarations: InstrumentDeclarations, around: Around, rng: np.random.Generator
) -> RealThings:
    """Points: as given, as the campaign's table has them but for its sigma, or drawn where the arm reaches, or on their link.

    Args:
        things: What the scenario says.
        declarations: What the campaign knows.
        around: Where they may be.
        rng: Draws the others.
    """
    given_points = things.points if isinstance(things.points, dict) else {}
    lengths = [each for each in declarations.settings.lengths if not declarations.markers]
    at_ends = [name for each in lengths for name in each.between] if not given_points else []
    names = list(_labels(things.points, (*declarations.points,), "point"))
    if not isinstance(things.points, dict) and not declarations.points:
        names = list(dict.fromkeys((*at_ends, *names)))[: max(len(dict.fromkeys(at_ends)), things.points)]
    points: dict[str, np.ndarray] = {}
    for name in names:
        if name in given_points:
            points[name] = np.array(given_points[name])
        elif name in declarations.points:
            std = declarations.points[name].std
            points[name] = declarations.points[name].xyz + (std * rng.standard_normal(3) if np.isfinite(std) else 0.0)
        else:
            points[name] = _apart(name, lengths, points, around(declarations.carrier("point", name)), rng)
    return RealThings(tuple(points), np.array([*points.values()]).reshape(-1, 3))


def _apart(
    name: str,
    lengths: Sequence[LengthSettings],
    points: Mapping[str, np.ndarray],
    reachable: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """A place that the arm reaches, at the known length from a point that is there already, if there is one."""
    for each in lengths:
        other = next((end for end in each.between if end != name and end in points), None)
        if name in each.between and other is not None:
            way = rng.standard_normal((DIRECTIONS_TRIED, 3))
            way *= (each.length + each.std * rng.standard_normal()) / np.linalg.norm(way, axis=1, keepdims=True)
            distance = np.linalg.norm(points[other] + way[:, None] - reachable, axis=2).min(axis=1)
            return np.asarray(points[other] + way[np.argmin(distance)])
    return np.asarray(reachable[int(rng.integers(len(reachable)))])


def true_anchors(
    things: TrueThings, declarations: InstrumentDeclarations, around: Around, rng: np.random.Generator
) -> RealThings:
    """Anchors around the workspace; see :func:`true_points`."""
    given_anchors = things.anchors if isinstance(things.anchors, dict) else {}
    names = _labels(things.anchors, (*declarations.settings.anchors,), "anchor")
    states = []
    for name in names:
        reachable = around(declarations.carrier("anchor", name))
        middle = reachable.mean(axis=0)
        radius = float(np.sqrt(np.mean(np.sum((reachable - middle) ** 2, axis=1))))
        direction = rng.standard_normal(3)
        xyz = middle + radius * rng.uniform(*ANCHOR_DISTANCES) * direction / np.linalg.norm(direction)
        offset, scale = rng.uniform(*WIRE_OFFSETS), 1.0 + SCALE_SIGMA * rng.standard_normal()
        stated, true = declarations.settings.anchors.get(name), given_anchors.get(name, TrueAnchor())
        if stated is None or "scale" not in stated.identify:
            scale = 1.0 if stated is None else stated.scale
        if stated is not None:
            xyz = xyz if stated.xyz is None else np.array(stated.xyz)
            if stated.offset is not None or "offset" not in stated.identify:
                offset = stated.offset or 0.0
        states.append(
            [
                *(xyz if true.xyz is None else true.xyz),
                offset if true.offset is None else true.offset,
                scale if true.scale is None else true.scale,
            ]
        )
    return RealThings(names, np.array(states, dtype=float))


def true_planes(
    things: TrueThings, declarations: InstrumentDeclarations, around: Around, rng: np.random.Generator
) -> RealThings:
    """Planes through the workspace, those that are known to be perpendicular so; see :func:`true_points`."""
    given_planes = things.planes if isinstance(things.planes, dict) else {}
    pairs = [pair.between for pair in declarations.settings.perpendicular]
    declared = (*declarations.settings.planes, *(name for pair in pairs for name in pair))
    planes: dict[str, np.ndarray] = {}
    for name in _labels(things.planes, tuple(dict.fromkeys(declared)), "plane"):
        reachable = around(declarations.carrier("plane", name))
        normal, through = rng.standard_normal(3), reachable[int(rng.integers(len(reachable)))]
        stated, true = declarations.settings.planes.get(name), given_planes.get(name)
        others = [planes[end][:3] for pair in pairs if name in pair for end in pair if end in planes]
        if others:
            U, size, _ = np.linalg.svd(np.array(others).T)
            across = U[:, int((size > 1e-9).sum()) :]
            normal = across @ (across.T @ normal)
        if stated is not None and stated.normal is not None:
            normal = np.array(stated.normal)
        if true is not None:
            normal = np.array(true.normal)
        normal = normal / np.linalg.norm(normal)
        offset = float(normal @ through)
        if stated is not None and stated.offset is not None:
            offset = stated.offset
        planes[name] = np.array([*normal, offset if true is None else true.offset])
    return RealThings(tuple(planes), np.array([*planes.values()]))


def true_grasps(name: str, count: int, draw_poses: Callable[[int], tuple[np.ndarray, np.ndarray]]) -> RealThings:
    """Poses of a link in the frame of another, where these hold one body.

    Args:
        name: What their labels begin with.
        count: How many.
        draw_poses: Gives so many poses that the two can have: (n, 3, 3) and (n, 3), [m].
    """
    R, p = draw_poses(count)
    return RealThings(tuple(f"{name}_{k + 1}" for k in range(count)), np.hstack([p, R.reshape(-1, 9)]))


@dataclass(frozen=True)
class RealCamera:
    """A camera as it is.

    Attributes:
        place: In the frame of what carries it, the tip's link or the world, shape (4, 4), [m].
        lens: Its intrinsics and distortion, shape (9,), [px] and [1].
        on_tip: Whether the arm carries it.
        given: Whether scenario or campaign say where it is; if not, ``place`` is the origin.
    """

    place: np.ndarray
    lens: np.ndarray
    on_tip: bool
    given: bool

    @property
    def state(self) -> np.ndarray:
        """Its state, as instruments have it, shape (22,)."""
        return np.r_[state_of_place(self.place), self.lens, float(self.on_tip)]


def state_of_place(place: np.ndarray) -> np.ndarray:
    """A place, shape (4, 4), as a state: shape (12,)."""
    return np.r_[place[:3, 3], place[:3, :3].ravel()]


def real_camera(declarations: InstrumentDeclarations, name: str, true: TrueCamera) -> RealCamera:
    """A camera as the scenario says, and where it does not, as the campaign states it."""
    stated = declarations.settings.cameras[name]
    lens = stated.intrinsics
    for k, value in enumerate((true.fx, true.fy, true.cx, true.cy)):
        lens[k] = lens[k] if value is None else value
    if true.distortion is not None:
        lens[4:] = true.distortion
    numbers = np.array((true if true.given else stated).place(is_known=True))
    place = np.eye(4)
    place[:3, 3], place[:3, :3] = numbers[:3], numbers[3:].reshape(3, 3)
    return RealCamera(place, lens, stated.on != WORLD, true.given or stated.given)


def documents(real: Mapping[str, RealThings]) -> dict[str, Any]:
    """Things that rows refer to as plain data, by role and name."""
    document: dict[str, Any] = {}
    for role, things in real.items():
        document[role] = {
            name: _thing(role, state.tolist()) for name, state in zip(things.names, things.states, strict=True)
        }
    return document


def _thing(role: str, state: list[float]) -> dict[str, Any]:
    """One thing, in the keys of a campaign."""
    if role == "plane":
        return {"normal": state[:3], "offset": state[3]}
    place: dict[str, Any] = {"xyz": state[:3]}
    if role == "anchor":
        return place | {"offset": state[3], "scale": state[4]}
    if role in ("camera", "board", GRASP.name):
        place["rpy"] = pin.rpy.matrixToRpy(np.array(state[3:12]).reshape(3, 3)).tolist()
    if role == "camera":
        place |= dict(zip(INTRINSICS[:4], state[12:16], strict=True)) | {"distortion": state[16:21]}
    return place
