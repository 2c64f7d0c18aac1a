"""``scene.html``: nominal and calibrated robot, measured targets and magnified error vectors, in one offline page.

The page is meshcat's own viewer, its script inlined, and a short script (``scene.js``) that puts the objects into the
viewer's tree and works the panel. Meshcat's server is not needed to make it: a server process would only hold the same
objects until it is asked to write them down. Each shape is stored once and drawn twice, as the robot and as its ghost.

Everything is drawn in the frame of the robot's base, so that the robot stands still although the measured frame may
differ from station to station; the view is turned upright against gravity.
"""

from __future__ import annotations

import base64
import html
import importlib.util
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree
from scipy.spatial.transform import Rotation

from aridcal.errors import OutputError
from aridcal.robot import Robot, tree_frames

ROWS = 200
"""At most so many rows can be stepped through; all are drawn as targets and vectors."""

TRIANGLES = 120_000
"""Meshes are thinned to about so many triangles in all: the page stays within a few megabytes."""

VIRIDIS = ("#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725")
"""Viridis from 0.2 to 1, evenly: its darkest fifth is left out because the page is dark."""

LADDER = tuple(m * 10**k for k in range(6) for m in (1, 2, 5))
"""Magnifications to choose from."""

GREY = (0.72, 0.74, 0.77)


@dataclass(frozen=True)
class Scene:
    """What there is to see of a calibration.

    Attributes:
        nominal: The robot as its URDF has it; also gives the visuals.
        calibrated: The same chain with the calibrated URDF's constants.
        readings: Joint readings in the order of ``nominal.readings``, shape (N, columns), [rad] or [m].
        T_world_base: Shape (N, 4, 4), or (4, 4) for all rows.
        measured: Target positions in the world frame, shape (N, 3), [m].
        predicted: The same as each stage predicts them; the first stage is "before", the last "after".
        test: Rows never used, shape (N,) bool.
        outlier: Flagged rows, shape (N,) bool.
        line: What each row is called: its line in the file, shape (N,); default: 1 to N.
        gravity: In the base frame, shape (3,); the view is upright against it.
    """

    nominal: Robot
    calibrated: Robot
    readings: np.ndarray
    T_world_base: np.ndarray
    measured: np.ndarray
    predicted: dict[str, np.ndarray]
    test: np.ndarray
    outlier: np.ndarray
    line: np.ndarray | None = None
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))


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


def write_scene(scene: Scene, path: Path) -> tuple[str, ...]:
    """Write the page.

    Args:
        scene: At least one row and one stage.
        path: The HTML file.

    Returns:
        Notices: what could not be drawn, and why.

    Raises:
        OutputError: the file cannot be written.
    """
    shapes, notices = robot_shapes(scene.nominal)
    content = scene_content(scene, shapes)
    try:
        path.write_text(_page(content), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot write the scene: {error.strerror}") from None
    return notices


def scene_content(scene: Scene, shapes: tuple[Shape, ...]) -> dict[str, Any]:
    """All that the page's script needs, as plain data; arrays as base64 of little-endian float32 (or as stated)."""
    n = len(scene.measured)
    R_base_world = np.broadcast_to(scene.T_world_base, (n, 4, 4))[:, :3, :3].transpose(0, 2, 1)
    origin = np.broadcast_to(scene.T_world_base, (n, 4, 4))[:, :3, 3]
    measured = np.einsum("nij,nj->ni", R_base_world, scene.measured - origin)
    errors = {k: np.einsum("nij,nj->ni", R_base_world, p - scene.measured) for k, p in scene.predicted.items()}
    rows = np.unique(np.linspace(0, n - 1, min(n, ROWS)).round().astype(int))
    joints = sorted({s.joint for s in shapes})
    poses = [body_poses(robot, scene.readings[rows])[:, joints] for robot in (scene.nominal, scene.calibrated)]

    corners = [s.corners() @ T[:3, :3].T + T[:3, 3] for s in shapes for T in [poses[1][0, joints.index(s.joint)]]]
    R_view_base = _upright(scene.gravity)
    seen = np.vstack([measured[rows], *corners]) @ R_view_base.T
    extent = float(np.linalg.norm(np.ptp(seen, axis=0)))
    distance = {k: np.linalg.norm(e, axis=1) for k, e in errors.items()}
    factor = _magnification([d[~scene.outlier] for d in distance.values()], extent)
    unused = scene.test & ~scene.outlier
    scored = unused if unused.any() else ~scene.outlier
    geometries, visuals = _deduplicated(shapes, joints)
    return {
        "title": etree.fromstring(scene.nominal.urdf).get("name", "robot"),
        "geometries": geometries,
        "visuals": visuals,
        "bodies": len(joints),
        "corrected": [bool(np.ptp(poses, axis=0)[:, body].max() > 1e-12) for body in range(len(joints))],
        "poses": [_pack(_position_quaternion(T)) for T in poses],
        "rows": rows.tolist(),
        "line": (np.arange(1, n + 1) if scene.line is None else scene.line).tolist(),
        "readings": [
            {"name": j, "unit": unit, "values": (scale * scene.readings[rows, k]).round(4).tolist()}
            for k, (j, unit, scale) in enumerate(_reading_units(scene.nominal))
        ],
        "measured": _pack(measured),
        "flags": _pack(scene.test + 2 * scene.outlier, np.uint8),
        "stages": [
            {"name": k, "rms": 1e3 * float(np.sqrt(np.mean(distance[k][scored] ** 2))), "error": _pack(e)}
            for k, e in errors.items()
        ],
        "scored": "test rows" if unused.any() else "all rows",
        "colours": VIRIDIS,
        "range": _colour_range([d[~scene.outlier] for d in distance.values()]),
        "factors": LADDER,
        "factor": factor,
        "ghost": min(_ghost_magnification(*poses), factor),
        "upright": np.block([[R_view_base, np.zeros((3, 1))], [0.0, 0.0, 0.0, 1.0]]).T.ravel().tolist(),
        "seen": _pack(seen),
    }


def body_poses(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Frame of every joint of the tree in the base's frame, shape (N, joints, 4, 4); what is above the base is at rest."""
    model = robot.tree
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    T = np.tile(data.oMf[model.getFrameId(robot.base)].inverse().homogeneous, (len(readings), model.njoints, 1, 1))
    for k, _, turned, at in tree_frames(robot, readings):
        T[:, k, :3, :3], T[:, k, :3, 3] = turned, at
    return T


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
            T[:3, :3], T[:3, 3] = _turn(np.array([0.0, 0.0, 1.0]), step), step / 2
            shapes.append(Shape(model.parents[k], T, "cylinder", (radius, lengths[k - 1]), GREY))
    return tuple(shapes)


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotation that brings one direction to another, shape (3, 3)."""
    return pin.Quaternion.FromTwoVectors(start, end).toRotationMatrix()


def _upright(gravity: np.ndarray) -> np.ndarray:
    """R_view_base: the view's z is up."""
    return _turn(-gravity, np.array([0.0, 0.0, 1.0])) if np.linalg.norm(gravity) > 1e-9 else np.eye(3)


def _colour_range(distances: list[np.ndarray]) -> list[float]:
    """Ends of the (logarithmic) colour scale in [mm], the same for every stage."""
    high = 1e3 * max(float(np.percentile(d, 98)) for d in distances)
    low = 1e3 * float(np.percentile(distances[-1], 5))
    high = max(high, 1e-6)
    return [float(np.clip(low, 1e-3 * high, high / 3)), high]


def _magnification(distances: list[np.ndarray], extent: float) -> int:
    """The rung at which before is not too large and after not too small to be seen, on a scene of that size [m]."""
    before, after = (max(float(np.percentile(d, 90)), 1e-9) for d in (distances[0], distances[-1]))
    wanted = extent * min(0.04 / np.sqrt(before * after), 0.15 / before)
    return min(LADDER, key=lambda rung: abs(np.log(rung / wanted)))


def _ghost_magnification(nominal: np.ndarray, calibrated: np.ndarray) -> int:
    """The rung at which the ghost stands clear of the robot and its links do not fall apart, from (N, bodies, 4, 4)."""
    span = np.linalg.norm(np.ptp(calibrated[..., :3, 3], axis=1), axis=1).max()
    moved = np.linalg.norm(nominal[..., :3, 3] - calibrated[..., :3, 3], axis=-1)
    turned = np.arccos(
        np.clip((np.einsum("nbij,nbij->nb", nominal[..., :3, :3], calibrated[..., :3, :3]) - 1) / 2, -1, 1)
    )
    apart = max(float(np.percentile((moved / max(span, 1e-6) + turned / 4).max(axis=1), 90)), 1e-9)
    return min(LADDER, key=lambda rung: abs(np.log(rung * apart / 0.12)))


def _reading_units(robot: Robot) -> Iterator[tuple[str, str, float]]:
    for name in robot.readings:
        revolute = robot.moves[name][1] == "revolute"
        yield name, "°" if revolute else "mm", 180 / np.pi if revolute else 1e3


def _deduplicated(shapes: tuple[Shape, ...], joints: list[int]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Each geometry once, and where each is drawn in which colour."""
    numbers: dict[str, int] = {}
    visuals = []
    for shape in shapes:
        geometry: dict[str, Any] = {"kind": shape.kind, "size": shape.size}
        if shape.kind == "mesh":
            wide = np.uint32 if len(shape.vertices) > 65535 else np.uint16
            geometry |= {
                "vertices": _pack(shape.vertices),
                "faces": _pack(shape.faces, wide),
                "wide": wide is np.uint32,
            }
        number = numbers.setdefault(json.dumps(geometry), len(numbers))
        matrix = shape.placement.T.ravel().round(7).tolist()
        visuals.append(
            {"geometry": number, "body": joints.index(shape.joint), "matrix": matrix, "colour": shape.colour}
        )
    return [json.loads(g) for g in numbers], visuals


def _position_quaternion(T: np.ndarray) -> np.ndarray:
    """Shape (N, bodies, 7) from (N, bodies, 4, 4)."""
    quaternion = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat()
    return np.concatenate([T[..., :3, 3], quaternion.reshape(*T.shape[:2], 4)], axis=-1)


def _pack(values: np.ndarray, dtype: type = np.float32) -> str:
    return base64.b64encode(np.ascontiguousarray(values, np.dtype(dtype).newbyteorder("<")).tobytes()).decode()


def _floats(element: etree._Element, key: str, default: str) -> tuple[float, ...]:
    return tuple(float(v) for v in element.get(key, default).split())


def _origin(element: etree._Element | None) -> np.ndarray:
    if element is None:
        return np.eye(4)
    rotation = pin.rpy.rpyToMatrix(np.array(_floats(element, "rpy", "0 0 0")))
    return pin.SE3(rotation, np.array(_floats(element, "xyz", "0 0 0"))).homogeneous


def _page(content: dict[str, Any]) -> str:
    """The whole page: everything inlined, nothing fetched."""
    here = Path(__file__).parent
    found = importlib.util.find_spec("meshcat")
    assert found is not None
    assert found.origin is not None
    bundle = Path(found.origin).parent / "viewer" / "dist"
    data = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return "\n".join([
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{html.escape(content['title'])}: calibration scene</title>",
        f"<style>{(here / 'scene.css').read_text('utf-8')}</style></head><body>",
        '<div id="meshcat-pane"></div>',
        f'<script type="application/json" id="scene">{data}</script>',
        f"<script>{(bundle / 'main.min.js.LICENSE.txt').read_text('utf-8')}</script>",
        f"<script>{(bundle / 'main.min.js').read_text('utf-8')}</script>",
        f"<script>{(here / 'scene.js').read_text('utf-8')}</script>",
        "</body></html>",
    ])  # fmt: skip
