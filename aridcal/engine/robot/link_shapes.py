"""The shapes that a URDF gives its links: boxes, cylinders, spheres and meshes, to be drawn or to be kept from collisions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.meshes import MeshMissing, MeshPart, NotDrawable
from aridcal.engine.robot.packages import HINT, find_package, package_folders
from aridcal.system.errors import shortened
from aridcal.system.reading.user_names import reason_of

# Of what has no colour.
GREY = (0.72, 0.74, 0.77)


@dataclass(frozen=True, eq=False)
class LinkShape:
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


@dataclass(frozen=True, eq=False)
class _Form:
    """One part of a visual: ``kind``, ``size``, ``vertices`` and ``faces`` of its shape, and a mesh file's own colour."""

    kind: str
    size: tuple[float, ...] = ()
    colour: tuple[float, ...] | None = None
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))


Meshes = Mapping[Path, "list[MeshPart] | NotDrawable"]


def shapes_of(
    visual: etree._Element, link: str, robot: Robot, paint: tuple[float, ...] | None, meshes: Meshes
) -> Iterator[LinkShape]:
    """Give the shapes of a `<visual>` or a `<collision>`: in a mesh file's own colour, else in its material's, else grey.

    Args:
        visual: The element.
        link: Name of its link.
        robot: Tells where the link is.
        paint: Its material's red, green and blue.
        meshes: What is in the robot's mesh files.

    Raises:
        NotDrawable: A part is no shape of URDF, a number is none, or its mesh is missing or broken.
    """
    frame = robot.tree.frames[robot.tree.getFrameId(link, pin.FrameType.BODY)]
    placement = frame.placement.homogeneous @ _origin(visual.find("origin"))
    forms = list(_forms(visual, robot, meshes))
    if not forms:
        raise NotDrawable(f"<{visual.tag}> has no shape in its <geometry>")
    for form in forms:
        red, green, blue = form.colour or paint or GREY
        colour = (red, green, blue)
        yield LinkShape(frame.parentJoint, placement, form.kind, form.size, colour, form.vertices, form.faces)


def _forms(visual: etree._Element, robot: Robot, meshes: Meshes) -> Iterator[_Form]:
    """Give the parts of a visual; a mesh file has one for each of its colours.

    Args:
        visual: The ``<visual>``.
        robot: Tells where its meshes are.
        meshes: What is in the robot's mesh files.
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
            scale = np.array(floats(element, "scale", "1 1 1"))
            if len(scale) not in (1, 3):
                raise NotDrawable("`scale` of <mesh> should be 3 numbers")
            parts = meshes[find_mesh(element.get("filename", ""), robot)]
            if isinstance(parts, NotDrawable):
                raise parts
            for colour, vertices, faces in parts:
                yield _Form("mesh", (), colour, vertices * scale, faces)
        elif isinstance(element.tag, str):
            raise NotDrawable(f"<{element.tag}> is no shape of URDF")


def mesh_files(visuals: Sequence[etree._Element], robot: Robot) -> list[Path]:
    """List the mesh files of visuals that are there."""
    files = []
    for visual in visuals:
        for element in visual.iterfind("geometry/mesh"):
            with suppress(NotDrawable):  # said where it is drawn
                files.append(find_mesh(element.get("filename", ""), robot))
    return files


def find_mesh(uri: str, robot: Robot) -> Path:
    """Find a mesh file that a URDF names; nothing is fetched from elsewhere.

    ``package://NAME/...`` is looked for where packages are (see :func:`package_folders`); any other name is relative to the
    URDF's folder.

    Raises:
        MeshMissing: it is not there.
        NotDrawable: it is no local file.
    """
    scheme, _, inner = uri.rpartition("://")
    folder, (package, _, inside) = robot.path.parent, inner.partition("/")
    if scheme == "package":
        candidates: Iterator[Path] = (place / inside for place in package_folders(package, folder, robot.packages))
    elif scheme in ("", "file"):
        candidates = iter([folder / inner])
    else:
        raise NotDrawable(f"{shortened(uri)!r} is not a local file")
    try:
        for path in candidates:
            if path.is_file():
                return path
    except (OSError, ValueError) as error:  # a name that no file can have
        raise NotDrawable(f"no mesh {shortened(uri)!r}: {reason_of(error)}") from None
    lost = scheme == "package" and find_package(package, folder, robot.packages) is None
    raise MeshMissing(uri, package if lost else "")


def say_missing(missing: Sequence[MeshMissing], what: str) -> list[str]:
    """Say in one line for each package which meshes are not there, and what to do about it.

    Args:
        missing: One for each shape that lacks its mesh.
        what: What is therefore not done with these shapes.
    """
    lines = []
    for package in dict.fromkeys(each.package for each in missing):
        lacking = [each.uri for each in missing if each.package == package]
        more = len(set(lacking)) - 1
        example = repr(shortened(lacking[0])) + (f" and {more} more" if more else "")
        count = f"{len(lacking)} shape{'s' if len(lacking) > 1 else ''}"
        hint = (
            f"package {package}: {HINT.format(name=package)}"
            if package
            else "put it where the URDF looks for it, or leave it so"
        )
        lines.append(f"{what}: {count} without a mesh file ({example}); {hint}")
    return lines


def floats(element: etree._Element, key: str, default: str) -> tuple[float, ...]:
    """Read the numbers of an attribute.

    Raises:
        NotDrawable: one is not a number, or not finite.
    """
    text = element.get(key, default)
    try:
        numbers = tuple(float(v) for v in text.split())
    except ValueError:
        numbers = (np.nan,)
    if not np.isfinite(numbers).all():
        raise NotDrawable(f"`{key}` of <{element.tag}> should be numbers, not {shortened(text)!r}")
    return numbers


def _lengths(element: etree._Element, key: str, count: int) -> tuple[float, ...]:
    """Read so many lengths, [m], of a box, a cylinder or a sphere."""
    numbers = floats(element, key, "")
    if len(numbers) != count or min(numbers) <= 0:
        expected = "a positive number" if count == 1 else f"{count} positive numbers"
        raise NotDrawable(f"`{key}` of <{element.tag}> should be {expected}, not {shortened(element.get(key, ''))!r}")
    return numbers


def _origin(element: etree._Element | None) -> np.ndarray:
    """Return the placement that an ``<origin>`` says, shape (4, 4); none is no placement at all."""
    if element is None:
        return np.eye(4)
    if element.get("quat_xyzw") is not None:
        raise NotDrawable("<origin> has quat_xyzw, which few parsers read: write the rotation as rpy")
    rpy, xyz = (floats(element, key, "0 0 0") for key in ("rpy", "xyz"))
    if len(rpy) != 3 or len(xyz) != 3:
        raise NotDrawable("`xyz` and `rpy` of <origin> should be 3 numbers")
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy)), np.array(xyz)).homogeneous
