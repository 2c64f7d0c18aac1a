"""What a robot looks like: the shapes of its URDF, meshes thinned, or a stick figure where there are none.

Each visual fails alone: it costs a notice, and neither another visual nor the scene.

The visuals are read here and not by yourdfpy, which gives up the whole robot for one visual that is wrong, says nothing of a
mesh that is missing, knows no ROS_PACKAGE_PATH, and reads meshes within this process, whatever they do to it. Collisions need the
same shapes.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree
from scipy.spatial.transform import Rotation

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.link_shapes import GREY, LinkShape, floats, mesh_files, say_missing, shapes_of
from aridcal.engine.robot.meshes import TRIANGLES, MeshMissing, NotDrawable, read_meshes, weld
from aridcal.pages.drawing.html import one_line, reason
from aridcal.system.errors import shortened

# That a mesh may keep however many there are; all meshes together are thinned to TRIANGLES.
FEWEST_TRIANGLES = 100

# Of a 16-bit number.
VERTEX_STEPS = 32767

# Visuals that are drawn, of which each is drawn twice: a humanoid with every screw has a few hundred.
MOST_SHAPES = 2000

# Triangles that are held at a time before they are thinned: 50 bytes each, and a large mesh may be there many times.
MOST_TRIANGLES = 4_000_000

# [m] from a joint: beyond it single precision, which browsers draw with, leaves no digit of a robot.
FARTHEST_VERTEX = 1e6

# Notices of one robot.
MOST_SHAPE_NOTICES = 12

# Radius of a stick figure's rods as a share of the arm's length; of its balls, in those; [m] of a rod at least.
THICKNESS, BALL, THINNEST = 0.015, 1.6, 1e-3

# Of a stick figure's joints.
ORANGE = (0.93, 0.45, 0.13)


def robot_shapes(robot: Robot) -> tuple[tuple[LinkShape, ...], tuple[str, ...]]:
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
    meshes = read_meshes(mesh_files([visual for _, visual in visuals], robot))
    shapes: list[LinkShape] = []
    triangles = 0
    missing: list[MeshMissing] = []
    for name, visual in visuals:
        try:
            paint = _material_colour(visual.find("material"), colours)
        except NotDrawable as error:
            paint = None
            notices.append(f"link {shortened(name)!r} is drawn in grey: {error}")
        try:
            made = [_sound(shape) for shape in shapes_of(visual, name, robot, paint, meshes)]
            more = sum(len(shape.faces) for shape in made)
            if len(shapes) + len(made) > MOST_SHAPES or triangles + more > MOST_TRIANGLES:
                raise NotDrawable(f"the robot has more than {MOST_SHAPES:,} shapes or {MOST_TRIANGLES:,} triangles")
            shapes += made
            triangles += more
        except MeshMissing as error:
            missing.append(error)
        except Exception as error:  # a bug of ours as well: a picture is not worth losing the results for
            said = str(error) if isinstance(error, NotDrawable) else reason(error)
            notices.append(f"link {shortened(name)!r} is not drawn: {one_line(said)}")
    notices += say_missing(missing, "not drawn")
    if not shapes and missing:
        notices[-1] += ". Until then a stick figure"
    elif not shapes:
        notices.append("no link has a shape that can be drawn: the robot is drawn as a stick figure")
    return _thinned(shapes) or _skeleton(robot), _few(notices)


def _few(notices: list[str]) -> tuple[str, ...]:
    """Each notice once, and of many the first ones."""
    different = list(dict.fromkeys(notices))
    rest = len(different) - MOST_SHAPE_NOTICES
    return tuple(different if rest <= 1 else [*different[:MOST_SHAPE_NOTICES], f"and {rest} more notices of this kind"])


def _sound(shape: LinkShape) -> LinkShape:
    """Give a shape as it can be drawn: it is near the robot, and its mesh's faces are wide enough to be seen.

    Raises:
        NotDrawable: it cannot be drawn.
    """
    if shape.kind == "mesh" and not (np.abs(shape.vertices) <= FARTHEST_VERTEX).all():
        raise NotDrawable(f"its mesh reaches beyond {FARTHEST_VERTEX:g} m")
    if not (np.abs(shape.corners()) <= FARTHEST_VERTEX).all():
        raise NotDrawable(f"it reaches beyond {FARTHEST_VERTEX:g} m")
    if shape.kind == "mesh":
        vertices, faces = weld(shape.vertices, shape.faces, TRIANGLES)
        if not len(faces):
            raise NotDrawable("its mesh is so thin that nothing of it can be seen")
        shape = replace(shape, vertices=vertices, faces=faces)
    return shape


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
    rgba = floats(colour, "rgba", "1 1 1 1")
    if len(rgba) not in (3, 4) or not all(0 <= share <= 1 for share in rgba):
        raise NotDrawable(
            f"`rgba` of <color> should be 4 numbers from 0 to 1, not {shortened(colour.get('rgba', ''))!r}"
        )
    return rgba[:3]


def _thinned(shapes: Sequence[LinkShape]) -> tuple[LinkShape, ...]:
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


def _skeleton(robot: Robot) -> tuple[LinkShape, ...]:
    """Draw a ball at each joint, and a rod to it from the joint before."""
    model = robot.tree
    steps = [placement.translation for placement in model.jointPlacements[1:]]
    lengths = [float(np.linalg.norm(step)) for step in steps]
    radius = max(THICKNESS * sum(lengths), THINNEST)
    along_z = np.array([0.0, 0.0, 1.0])
    shapes = []
    for joint, (step, length) in enumerate(zip(steps, lengths, strict=True), 1):
        shapes.append(LinkShape(joint, np.eye(4), "sphere", (BALL * radius,), ORANGE))
        if length > radius:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = turn(along_z, step), step / 2
            shapes.append(LinkShape(model.parents[joint], T, "cylinder", (radius, length), GREY))
    return tuple(shapes)


def turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the smallest rotation that brings one direction to another, shape (3, 3)."""
    return pin.Quaternion.FromTwoVectors(start, end).toRotationMatrix()


def position_quaternion(T: np.ndarray) -> np.ndarray:
    """Return frames (N, bodies, 4, 4) as places and quaternions x y z w, shape (N, bodies, 7)."""
    R = T[..., :3, :3].reshape(-1, 3, 3)
    quaternion = Rotation.from_matrix(R).as_quat().reshape(*T.shape[:2], 4)
    return np.concatenate([T[..., :3, 3], quaternion], axis=-1)


def stepped(name: str, values: np.ndarray) -> dict[str, Any]:
    """Write small motions (N, 3), [m], as 16-bit steps: there may be many effects, each with a vector for every row."""
    largest = max(float(np.abs(values).max()), 1e-12)
    step = largest / VERTEX_STEPS
    return {"name": name, "step": step, "moved": packed((values / step).round(), np.int16)}


def packed(values: np.ndarray, dtype: type = np.float32) -> str:
    """Write numbers, row by row, as base64 of their little-endian bytes."""
    little_endian = np.dtype(dtype).newbyteorder("<")
    content = np.ascontiguousarray(values, little_endian).tobytes()
    return base64.b64encode(content).decode()
