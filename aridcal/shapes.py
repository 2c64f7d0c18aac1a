"""What a robot looks like: the shapes of its URDF, meshes thinned, or a stick figure where there are none."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.robot import Robot

TRIANGLES = 120_000
"""Meshes are thinned to about so many triangles in all: the page stays within a few megabytes."""

GREY = (0.72, 0.74, 0.77)


@dataclass(frozen=True, eq=False)
class Shape:
    """A thing to draw, rigidly attached to a joint of the tree.

    Attributes:
        joint: Id in ``robot.tree``; 0 does not move.
        placement: From the shape's frame to the joint's, shape (4, 4).
        kind: ``box`` (edges), ``cylinder`` (radius, length; along z), ``sphere`` (radius) or ``mesh``.
        size: As the kind has it, [m].
        colour: Red, green, blue from 0 to 1.
        vertices: Of a mesh, shape (V, 3), [m].
        faces: Of a mesh, shape (F, 3).
    """

    joint: int
    placement: np.ndarray
    kind: str
    size: tuple[float, ...]
    colour: tuple[float, float, float]
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), int))

    def corners(self) -> np.ndarray:
        """Corners of its bounding box in the joint's frame, shape (8, 3)."""
        if self.kind == "mesh":
            low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        else:
            x = self.size
            half = {"box": x, "cylinder": (2 * x[0], 2 * x[0], x[-1]), "sphere": (2 * x[0],) * 3}[self.kind]
            high = np.array(half) / 2
            low = -high
        box = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(8, 3)
        return box @ self.placement[:3, :3].T + self.placement[:3, 3]


def robot_shapes(robot: Robot) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Every ``<visual>`` of a URDF that can be drawn, or a stick figure if none can; then what is missing, and why."""
    root = etree.fromstring(robot.urdf, etree.XMLParser(resolve_entities=False, no_network=True))
    named = {m.get("name"): m.find("color") for m in root.findall("material")}
    visuals = [(link.get("name", ""), visual) for link in root.findall("link") for visual in link.findall("visual")]
    shapes: list[Shape] = []
    notices: list[str] = []
    for link, visual in visuals:
        frame = robot.tree.frames[robot.tree.getFrameId(link, pin.FrameType.BODY)]
        placement = frame.placement.homogeneous @ _origin(visual.find("origin"))
        material = visual.find("material")
        colour = None if material is None else material.find("color")
        if colour is None and material is not None:
            colour = named.get(material.get("name"))
        paint = None if colour is None else _floats(colour, "rgba", "1 1 1 1")[:3]
        try:
            for part in _parts(visual, robot.path.parent):
                kind, size, own, vertices, faces = part
                rgb = own or paint or GREY
                shapes.append(
                    Shape(frame.parentJoint, placement, kind, size, (rgb[0], rgb[1], rgb[2]), vertices, faces)
                )
        except (_NotDrawable, ValueError) as error:
            notices.append(f"link {link!r} is not drawn: {error}")
    if not shapes:
        notices.append("no link has a shape that can be drawn: the robot is drawn as a stick figure")
    return _thinned(shapes) or _skeleton(robot), tuple(dict.fromkeys(notices))


class _NotDrawable(Exception):
    """A visual has to be left out; the message says why."""


_Part = tuple[str, tuple[float, ...], tuple[float, ...] | None, np.ndarray, np.ndarray]


def _parts(visual: etree._Element, folder: Path) -> Iterator[_Part]:
    """Kind, size, own colour, vertices, faces of each part of a visual."""
    none = np.zeros((0, 3))
    for element in visual.iterfind("geometry/*"):
        if element.tag == "box":
            yield "box", _floats(element, "size", ""), None, none, none
        elif element.tag == "cylinder":
            size = _floats(element, "radius", "") + _floats(element, "length", "")
            yield "cylinder", size, None, none, none
        elif element.tag == "sphere":
            yield "sphere", _floats(element, "radius", ""), None, none, none
        elif element.tag == "mesh":
            scale = np.array(_floats(element, "scale", "1 1 1"))
            for colour, vertices, faces in load_mesh(find_mesh(element.get("filename", ""), folder)):
                yield "mesh", (), colour, vertices * scale, faces
        elif isinstance(element.tag, str):
            raise _NotDrawable(f"<{element.tag}> is no shape of URDF")


def find_mesh(uri: str, folder: Path) -> Path:
    """Find a mesh file that a URDF names.

    ``package://NAME/...`` is looked for in the folders above the URDF, and in those of ROS_PACKAGE_PATH and
    AMENT_PREFIX_PATH; any other name is relative to the URDF's folder.
    """
    scheme, _, rest = uri.rpartition("://")
    if scheme == "package":
        name, _, inside = rest.partition("/")
        above = [folder.resolve(), *folder.resolve().parents]
        ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
        ament = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
        roots = [a for a in above + ros if a.name == name] + [a / name for a in above + ros + ament]
        candidates = [root / inside for root in roots]
    elif scheme in ("", "file"):
        candidates = [folder / rest]
    else:
        raise _NotDrawable(f"{uri!r} is not a local file")
    for path in candidates:
        if path.is_file():
            return path
    raise _NotDrawable(f"no mesh {uri!r}")


def load_mesh(path: Path) -> list[tuple[tuple[float, ...] | None, np.ndarray, np.ndarray]]:
    """Read a mesh file: per colour (``None``: the file has none) vertices (V, 3) and faces (F, 3)."""
    import trimesh

    try:
        meshes = trimesh.load_scene(path).dump()
    except Exception as error:  # whatever its many readers raise, a picture is not worth losing the results for
        raise _NotDrawable(f"mesh {path.name!r} cannot be read: {error}") from None
    groups: dict[tuple[float, ...] | None, list[Any]] = {}
    for mesh in meshes:
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces) and np.isfinite(mesh.vertices).all():
            groups.setdefault(_mesh_colour(mesh, path), []).append(mesh)
    if not groups:
        raise _NotDrawable(f"mesh {path.name!r} has no faces")
    joined = {colour: trimesh.util.concatenate(same) for colour, same in groups.items()}
    return [(colour, whole.vertices, whole.faces) for colour, whole in joined.items()]


def _mesh_colour(mesh: Any, path: Path) -> tuple[float, ...] | None:
    if path.suffix.lower() == ".stl":
        return None
    rgba = getattr(getattr(mesh.visual, "material", None), "main_color", None)
    if rgba is None:
        rgba = getattr(mesh.visual, "main_color", None)
    return None if rgba is None else tuple((np.asarray(rgba[:3], float) / 255).tolist())


def _thinned(shapes: list[Shape]) -> tuple[Shape, ...]:
    """Meshes within the page's allowance: the small ones whole, the large ones down to one common number of faces."""
    counts = np.sort([len(s.faces) for s in shapes if s.kind == "mesh"])
    most = TRIANGLES
    for k, count in enumerate(counts):
        most = max((TRIANGLES - int(counts[:k].sum())) // (len(counts) - k), 100)
        if count > most:
            break
    thinned = []
    for shape in shapes:
        if shape.kind == "mesh":
            vertices, faces = weld(shape.vertices, shape.faces, most)
            shape = replace(shape, vertices=vertices, faces=faces)
        thinned.append(shape)
    return tuple(thinned)


def weld(vertices: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Snap vertices to a grid, join those that meet and drop faces that vanish.

    The grid starts at a thousandth of the mesh's size and is made coarser until at most ``most`` faces are left
    (or it is down to 16 cells).
    """
    low, cells = vertices.min(axis=0), 1000.0
    cell = max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    while True:
        grid = ((vertices - low) * (cells / cell)).round().astype(np.int64)
        _, first, inverse = np.unique(
            (grid[:, 0] << 40) + (grid[:, 1] << 20) + grid[:, 2], return_index=True, return_inverse=True
        )
        welded = inverse.reshape(-1)[faces]
        a, b, c = welded.T
        welded = welded[(a != b) & (b != c) & (c != a)]
        if len(welded) <= most or cells < 16:
            used, again = np.unique(welded, return_inverse=True)
            return vertices[first[used]], again.reshape(-1, 3)
        cells *= 0.7


def _skeleton(robot: Robot) -> tuple[Shape, ...]:
    """A ball at each joint, a rod to it from the joint before."""
    model = robot.tree
    lengths = [float(np.linalg.norm(p.translation)) for p in model.jointPlacements[1:]]
    radius = max(0.015 * sum(lengths), 1e-3)
    shapes = []
    for k in range(1, model.njoints):
        shapes.append(Shape(k, np.eye(4), "sphere", (1.6 * radius,), (0.93, 0.45, 0.13)))
        if lengths[k - 1] > radius:
            step = model.jointPlacements[k].translation
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = turn(np.array([0.0, 0.0, 1.0]), step), step / 2
            shapes.append(Shape(model.parents[k], T, "cylinder", (radius, lengths[k - 1]), GREY))
    return tuple(shapes)


def turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotation that brings one direction to another, shape (3, 3)."""
    return pin.Quaternion.FromTwoVectors(start, end).toRotationMatrix()


def _floats(element: etree._Element, key: str, default: str) -> tuple[float, ...]:
    return tuple(float(v) for v in element.get(key, default).split())


def _origin(element: etree._Element | None) -> np.ndarray:
    if element is None:
        return np.eye(4)
    rotation = pin.rpy.rpyToMatrix(np.array(_floats(element, "rpy", "0 0 0")))
    return pin.SE3(rotation, np.array(_floats(element, "xyz", "0 0 0"))).homogeneous
