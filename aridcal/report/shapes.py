"""What a robot looks like: the shapes of its URDF, meshes thinned, or a stick figure where there are none.

Each visual fails alone: it costs a notice, and neither another visual nor the scene.

The visuals are read here and not by yourdfpy, which gives up the whole robot for one visual that is wrong, knows no
ROS_PACKAGE_PATH, and needs trimesh also where there is no mesh to load.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.errors import shortened
from aridcal.reading.names import why
from aridcal.report.html import one_line, reason
from aridcal.robot.chain import Robot
from aridcal.robot.meshes import TRIANGLES, NotDrawable, Part, read_meshes, weld

# That a mesh may keep however many there are; all meshes together are thinned to TRIANGLES.
FEWEST_TRIANGLES = 100

# Visuals that are drawn, of which each is drawn twice: a humanoid with every screw has a few hundred.
MOST_SHAPES = 2000

# Triangles that are held at a time before they are thinned: 50 bytes each, and a large mesh may be there many times.
MOST_TRIANGLES = 4_000_000

# [m] from a joint: beyond it single precision, which browsers draw with, leaves no digit of a robot.
FARTHEST = 1e6

# Notices of one robot.
MOST_NOTICES = 12

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
    root = etree.fromstring(robot.urdf, etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True))
    colours = {material.get("name"): material.find("color") for material in root.findall("material")}
    visuals = [(link.get("name", ""), visual) for link in root.findall("link") for visual in link.findall("visual")]
    notices = []
    if len(visuals) > MOST_SHAPES:
        notices.append(f"of {len(visuals):,} visuals only the first {MOST_SHAPES:,} are drawn")
        visuals = visuals[:MOST_SHAPES]
    meshes = read_meshes(_mesh_files([visual for _, visual in visuals], robot.path.parent))
    shapes: list[Shape] = []
    triangles = 0
    for name, visual in visuals:
        try:
            paint = _material_colour(visual.find("material"), colours)
        except NotDrawable as error:
            paint = None
            notices.append(f"link {shortened(name)!r} is drawn in grey: {error}")
        try:
            made = [_sound(shape) for shape in _visual_shapes(visual, name, robot, paint, meshes)]
            more = sum(len(shape.faces) for shape in made)
            if len(shapes) + len(made) > MOST_SHAPES or triangles + more > MOST_TRIANGLES:
                raise NotDrawable(f"the robot has more than {MOST_SHAPES:,} shapes or {MOST_TRIANGLES:,} triangles")
            shapes += made
            triangles += more
        except Exception as error:  # a bug of ours as well: a picture is not worth losing the results for
            said = str(error) if isinstance(error, NotDrawable) else reason(error)
            notices.append(f"link {shortened(name)!r} is not drawn: {one_line(said)}")
    if not shapes:
        notices.append("no link has a shape that can be drawn: the robot is drawn as a stick figure")
    return _thinned(shapes) or _skeleton(robot), _few(notices)


def _few(notices: list[str]) -> tuple[str, ...]:
    """Each notice once, and of many the first ones."""
    different = list(dict.fromkeys(notices))
    rest = len(different) - MOST_NOTICES
    return tuple(different if rest <= 1 else [*different[:MOST_NOTICES], f"and {rest} more notices of this kind"])


def _sound(shape: Shape) -> Shape:
    """Give a shape as it can be drawn: it is near the robot, and its mesh's faces are wide enough to be seen.

    Raises:
        NotDrawable: it cannot be drawn.
    """
    if shape.kind == "mesh" and not (np.abs(shape.vertices) <= FARTHEST).all():
        raise NotDrawable(f"its mesh reaches beyond {FARTHEST:g} m")
    if not (np.abs(shape.corners()) <= FARTHEST).all():
        raise NotDrawable(f"it reaches beyond {FARTHEST:g} m")
    if shape.kind == "mesh":
        vertices, faces = weld(shape.vertices, shape.faces, TRIANGLES)
        if not len(faces):
            raise NotDrawable("its mesh is so thin that nothing of it can be seen")
        shape = replace(shape, vertices=vertices, faces=faces)
    return shape


@dataclass(frozen=True, eq=False)
class _Form:
    """One part of a visual: ``kind``, ``size``, ``vertices`` and ``faces`` of its shape, and a mesh file's own colour."""

    kind: str
    size: tuple[float, ...] = ()
    colour: tuple[float, ...] | None = None
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))


Meshes = Mapping[Path, "list[Part] | NotDrawable"]


def _visual_shapes(
    visual: etree._Element, link: str, robot: Robot, paint: tuple[float, ...] | None, meshes: Meshes
) -> Iterator[Shape]:
    """Give the shapes of a visual: in a mesh file's own colour, else in its material's, else grey.

    Args:
        visual: The ``<visual>``.
        link: Name of its link.
        robot: Tells where the link is.
        paint: Its material's red, green and blue.
        meshes: What is in the robot's mesh files.

    Raises:
        NotDrawable: A part is no shape of URDF, a number is none, or its mesh is missing or broken.
    """
    frame = robot.tree.frames[robot.tree.getFrameId(link, pin.FrameType.BODY)]
    placement = frame.placement.homogeneous @ _origin(visual.find("origin"))
    forms = list(_forms(visual, robot.path.parent, meshes))
    if not forms:
        raise NotDrawable("<visual> has no shape in its <geometry>")
    for form in forms:
        red, green, blue = form.colour or paint or GREY
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
    if colour is None:
        return None
    rgba = _floats(colour, "rgba", "1 1 1 1")
    if len(rgba) not in (3, 4) or not all(0 <= share <= 1 for share in rgba):
        raise NotDrawable(
            f"`rgba` of <color> should be 4 numbers from 0 to 1, not {shortened(colour.get('rgba', ''))!r}"
        )
    return rgba[:3]


def _forms(visual: etree._Element, folder: Path, meshes: Meshes) -> Iterator[_Form]:
    """Give the parts of a visual; a mesh file has one for each of its colours.

    Args:
        visual: The ``<visual>``.
        folder: Of the URDF: names of meshes may be relative to it.
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
            scale = np.array(_floats(element, "scale", "1 1 1"))
            if len(scale) not in (1, 3):
                raise NotDrawable("`scale` of <mesh> should be 3 numbers")
            found = meshes[find_mesh(element.get("filename", ""), folder)]
            if isinstance(found, NotDrawable):
                raise found
            for colour, vertices, faces in found:
                yield _Form("mesh", (), colour, vertices * scale, faces)
        elif isinstance(element.tag, str):
            raise NotDrawable(f"<{element.tag}> is no shape of URDF")


def _mesh_files(visuals: Sequence[etree._Element], folder: Path) -> list[Path]:
    """List the mesh files of visuals that are there."""
    found = []
    for visual in visuals:
        for element in visual.iterfind("geometry/mesh"):
            with suppress(NotDrawable):  # said where it is drawn
                found.append(find_mesh(element.get("filename", ""), folder))
    return found


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
        raise NotDrawable(f"{shortened(uri)!r} is not a local file")
    try:
        for path in candidates:
            if path.is_file():
                return path
    except (OSError, ValueError) as error:  # a name that no file can have
        raise NotDrawable(f"no mesh {shortened(uri)!r}: {why(error)}") from None
    raise NotDrawable(f"no mesh {shortened(uri)!r}")


def _in_packages(name: str, folder: Path) -> list[Path]:
    """List where ``PACKAGE/inside`` may be: in folders called as the package, and in such folders within others."""
    package, _, inside = name.partition("/")
    above = [folder.resolve(), *folder.resolve().parents]
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    ament = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    named = [place for place in above + ros if place.name == package]
    within = [place / package for place in above + ros + ament]
    return [root / inside for root in named + within]


def _thinned(shapes: Sequence[Shape]) -> tuple[Shape, ...]:
    """Meshes within the page's allowance: the small ones as they are, the large ones down to one common number of faces."""
    most = _allowance([len(shape.faces) for shape in shapes if shape.kind == "mesh"])
    thinned = []
    for shape in shapes:
        if len(shape.faces) > most:
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
    numbers = _floats(element, key, "")
    if len(numbers) != count or min(numbers) <= 0:
        wanted = "a positive number" if count == 1 else f"{count} positive numbers"
        raise NotDrawable(f"`{key}` of <{element.tag}> should be {wanted}, not {shortened(element.get(key, ''))!r}")
    return numbers


def _origin(element: etree._Element | None) -> np.ndarray:
    """Return the placement that an ``<origin>`` says, shape (4, 4); none is no placement at all."""
    if element is None:
        return np.eye(4)
    if element.get("quat_xyzw") is not None:
        raise NotDrawable("<origin> has quat_xyzw, which few parsers read: write the rotation as rpy")
    rpy, xyz = (_floats(element, key, "0 0 0") for key in ("rpy", "xyz"))
    if len(rpy) != 3 or len(xyz) != 3:
        raise NotDrawable("`xyz` and `rpy` of <origin> should be 3 numbers")
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy)), np.array(xyz)).homogeneous
