"""What a robot looks like: the shapes of its URDF, meshes thinned, or a stick figure where there are none.

The visuals are read here and not by yourdfpy, which gives up the whole robot for one visual that is wrong, knows no
ROS_PACKAGE_PATH, and needs trimesh also where there is no mesh to load.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.robot.chain import Robot

# Meshes are thinned to about so many triangles in all: the page stays within a few megabytes.
TRIANGLES = 120_000

# That a mesh may keep however many there are.
FEWEST_TRIANGLES = 100

# Cells of a thinned mesh's grid along its long side: at first, by which factor fewer each round, and at least.
FINEST, COARSER, COARSEST = 1000.0, 0.7, 16

# Radius of a stick figure's rods as a share of the arm's length; of its balls, in those; [m] of a rod at least.
THICKNESS, BALL, THINNEST = 0.015, 1.6, 1e-3

# Of what has no colour, and of a stick figure's joints.
GREY, ORANGE = (0.72, 0.74, 0.77), (0.93, 0.45, 0.13)


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
        low, high = self._bounds()
        grid = np.meshgrid(*zip(low, high, strict=True))
        box = np.stack(grid, axis=-1).reshape(8, 3)
        return box @ self.placement[:3, :3].T + self.placement[:3, 3]

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest corner of its bounding box in its own frame, each (3,), [m]."""
        if self.kind == "mesh":
            return self.vertices.min(axis=0), self.vertices.max(axis=0)
        if self.kind == "box":
            edges = self.size
        elif self.kind == "cylinder":
            radius, length = self.size
            edges = (2 * radius, 2 * radius, length)
        else:
            edges = (2 * self.size[0],) * 3
        half = np.array(edges) / 2
        return -half, half


def robot_shapes(robot: Robot) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Collect every ``<visual>`` of a URDF that can be drawn, or a stick figure if none can.

    Returns:
        The shapes; then what is not drawn, and why. One visual that is wrong or missing costs no other.
    """
    root = etree.fromstring(robot.urdf, etree.XMLParser(resolve_entities=False, no_network=True))
    colours = {material.get("name"): material.find("color") for material in root.findall("material")}
    shapes: list[Shape] = []
    notices: list[str] = []
    for link in root.findall("link"):
        name = link.get("name", "")
        for visual in link.findall("visual"):
            try:
                shapes += _visual_shapes(visual, name, robot, colours)
            except (_NotDrawable, ValueError) as error:
                notices.append(f"link {name!r} is not drawn: {error}")
    if not shapes:
        notices.append("no link has a shape that can be drawn: the robot is drawn as a stick figure")
    return _thinned(shapes) or _skeleton(robot), tuple(dict.fromkeys(notices))


class _NotDrawable(Exception):
    """A visual has to be left out; the message says why."""


@dataclass(frozen=True, eq=False)
class _Form:
    """One part of a visual: ``kind``, ``size``, ``vertices`` and ``faces`` of its shape, and a mesh file's own colour."""

    kind: str
    size: tuple[float, ...] = ()
    colour: tuple[float, ...] | None = None
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))


def _visual_shapes(
    visual: etree._Element, link: str, robot: Robot, colours: dict[str | None, etree._Element | None]
) -> Iterator[Shape]:
    """Give the shapes of a visual: in a mesh file's own colour, else in its material's, else grey.

    Args:
        visual: The ``<visual>``.
        link: Name of its link.
        robot: Tells where the link is.
        colours: Of the robot's materials, by name.

    Raises:
        _NotDrawable: A part is no shape of URDF, or its mesh is missing or broken.
        ValueError: A number is none.
    """
    frame = robot.tree.frames[robot.tree.getFrameId(link, pin.FrameType.BODY)]
    placement = frame.placement.homogeneous @ _origin(visual.find("origin"))
    material = _material_colour(visual.find("material"), colours)
    for form in _forms(visual, robot.path.parent):
        red, green, blue = form.colour or material or GREY
        colour = (red, green, blue)
        yield Shape(frame.parentJoint, placement, form.kind, form.size, colour, form.vertices, form.faces)


def _material_colour(
    material: etree._Element | None, colours: dict[str | None, etree._Element | None]
) -> tuple[float, ...] | None:
    """Return red, green and blue of a material: its own, or those of the robot's material of that name."""
    if material is None:
        return None
    colour = material.find("color")
    if colour is None:
        colour = colours.get(material.get("name"))
    return None if colour is None else _floats(colour, "rgba", "1 1 1 1")[:3]


def _forms(visual: etree._Element, folder: Path) -> Iterator[_Form]:
    """Give the parts of a visual; a mesh file has one for each of its colours.

    Args:
        visual: The ``<visual>``.
        folder: Of the URDF: names of meshes may be relative to it.
    """
    for element in visual.iterfind("geometry/*"):
        if element.tag == "box":
            yield _Form("box", _lengths(element, "size", 3))
        elif element.tag == "cylinder":
            size = _lengths(element, "radius", 1) + _lengths(element, "length", 1)
            yield _Form("cylinder", size)
        elif element.tag == "sphere":
            yield _Form("sphere", _lengths(element, "radius", 1))
        elif element.tag == "mesh":
            scale = np.array(_floats(element, "scale", "1 1 1"))
            path = find_mesh(element.get("filename", ""), folder)
            for colour, vertices, faces in load_mesh(path):
                yield _Form("mesh", (), colour, vertices * scale, faces)
        elif isinstance(element.tag, str):
            raise _NotDrawable(f"<{element.tag}> is no shape of URDF")


def find_mesh(uri: str, folder: Path) -> Path:
    """Find a mesh file that a URDF names; nothing is fetched from elsewhere.

    ``package://NAME/...`` is looked for in the folders above the URDF, and in those of ROS_PACKAGE_PATH and
    AMENT_PREFIX_PATH; any other name is relative to the URDF's folder.
    """
    scheme, _, rest = uri.rpartition("://")
    if scheme == "package":
        candidates = _in_packages(rest, folder)
    elif scheme in ("", "file"):
        candidates = [folder / rest]
    else:
        raise _NotDrawable(f"{uri!r} is not a local file")
    for path in candidates:
        if path.is_file():
            return path
    raise _NotDrawable(f"no mesh {uri!r}")


def _in_packages(name: str, folder: Path) -> list[Path]:
    """List where ``PACKAGE/inside`` may be: in folders called as the package, and in such folders within others."""
    package, _, inside = name.partition("/")
    above = [folder.resolve(), *folder.resolve().parents]
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    ament = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    named = [place for place in above + ros if place.name == package]
    within = [place / package for place in above + ros + ament]
    return [root / inside for root in named + within]


def load_mesh(path: Path) -> list[tuple[tuple[float, ...] | None, np.ndarray, np.ndarray]]:
    """Read a mesh file with trimesh.

    Returns:
        Per colour (``None``: the file has none) vertices (V, 3) and faces (F, 3).

    Raises:
        _NotDrawable: It cannot be read, or has no faces.
    """
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
    """Return a mesh's main colour, red, green and blue from 0 to 1; None for STL, whose colours nobody agrees on."""
    if path.suffix.lower() == ".stl":
        return None
    rgba = getattr(getattr(mesh.visual, "material", None), "main_color", None)
    if rgba is None:
        rgba = getattr(mesh.visual, "main_color", None)
    if rgba is None:
        return None
    rgb = np.asarray(rgba[:3], float) / 255
    return tuple(rgb.tolist())


def _thinned(shapes: list[Shape]) -> tuple[Shape, ...]:
    """Meshes within the page's allowance: the small ones whole, the large ones down to one common number of faces."""
    most = _allowance([len(shape.faces) for shape in shapes if shape.kind == "mesh"])
    thinned = []
    for shape in shapes:
        if shape.kind == "mesh":
            vertices, faces = weld(shape.vertices, shape.faces, most)
            shape = replace(shape, vertices=vertices, faces=faces)
        thinned.append(shape)
    return tuple(thinned)


def _allowance(faces: list[int]) -> int:
    """Return how many faces each mesh may have: what the smaller ones do not need is shared among the larger ones."""
    most = left = TRIANGLES
    for k, count in enumerate(sorted(faces)):
        most = max(left // (len(faces) - k), FEWEST_TRIANGLES)
        if count > most:
            break
        left -= count
    return most


def weld(vertices: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Snap vertices to a grid, join those that meet and drop faces that vanish.

    The grid starts at a thousandth of the mesh's size and is made coarser until at most ``most`` faces are left, or it is down
    to 16 cells (Rossignac and Borrel, "Multi-resolution 3D approximations", 1993).

    Args:
        vertices: Shape (V, 3), [m].
        faces: Indices of vertices, shape (F, 3).
        most: Wanted number of faces.

    Returns:
        Vertices and faces that are left, each joined one standing where its first one stood.
    """
    low, cells = vertices.min(axis=0), FINEST
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    while True:
        x, y, z = ((vertices - low) * (cells / size)).round().astype(np.int64).T
        cell = (x << 40) + (y << 20) + z
        _, first, inverse = np.unique(cell, return_index=True, return_inverse=True)
        welded = inverse.reshape(-1)[faces]
        a, b, c = welded.T
        welded = welded[(a != b) & (b != c) & (c != a)]
        if len(welded) <= most or cells < COARSEST:
            used, again = np.unique(welded, return_inverse=True)
            return vertices[first[used]], again.reshape(-1, 3)
        cells *= COARSER


def _skeleton(robot: Robot) -> tuple[Shape, ...]:
    """Draw a ball at each joint, and a rod to it from the joint before."""
    model = robot.tree
    steps = [placement.translation for placement in model.jointPlacements[1:]]
    lengths = [float(np.linalg.norm(step)) for step in steps]
    radius = max(THICKNESS * sum(lengths), THINNEST)
    along_z = np.array([0.0, 0.0, 1.0])
    shapes = []
    for joint, (step, length) in enumerate(zip(steps, lengths, strict=True), 1):
        shapes.append(Shape(joint, np.eye(4), "sphere", (BALL * radius,), ORANGE))
        if length > radius:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = turn(along_z, step), step / 2
            shapes.append(Shape(model.parents[joint], T, "cylinder", (radius, length), GREY))
    return tuple(shapes)


def turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the smallest rotation that brings one direction to another, shape (3, 3)."""
    return pin.Quaternion.FromTwoVectors(start, end).toRotationMatrix()


def _floats(element: etree._Element, key: str, default: str) -> tuple[float, ...]:
    """Read the numbers of an attribute."""
    return tuple(float(v) for v in element.get(key, default).split())


def _lengths(element: etree._Element, key: str, count: int) -> tuple[float, ...]:
    """Read so many lengths, [m], of a box, a cylinder or a sphere."""
    numbers = _floats(element, key, "")
    if len(numbers) != count:
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise _NotDrawable(f"`{key}` of <{element.tag}> should be {wanted}")
    return numbers


def _origin(element: etree._Element | None) -> np.ndarray:
    """Return the placement that an ``<origin>`` says, shape (4, 4); none is no placement at all."""
    if element is None:
        return np.eye(4)
    rpy = np.array(_floats(element, "rpy", "0 0 0"))
    xyz = np.array(_floats(element, "xyz", "0 0 0"))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz).homogeneous
