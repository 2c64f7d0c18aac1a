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
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree
from scipy.spatial.transform import Rotation

from aridcal.errors import OutputError
from aridcal.robot import Robot, tree_frames
from aridcal.shapes import Shape, robot_shapes, turn

ROWS = 200
"""At most so many rows can be stepped through; all are drawn as targets and vectors."""

VIRIDIS = ("#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725")
"""Viridis from 0.2 to 1, evenly: its darkest fifth is left out because the page is dark."""

LADDER = tuple(m * 10**k for k in range(6) for m in (1, 2, 5))
"""Magnifications to choose from."""


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
        moved: How each effect moves the last stage's prediction in the world frame, beyond what frames and constants could
            take up, by its name, shape (N, 3) each, [m].
        places: Targets all over the joint range in the base frame, shape (M, 3), [m].
        sigma: How well the model knows them: 1-sigma in the worst direction, shape (M,), [m].
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
    moved: dict[str, np.ndarray] = field(default_factory=dict)
    places: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    sigma: np.ndarray = field(default_factory=lambda: np.zeros(0))


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
    counts = scene.test + 2 * scene.outlier + 4 * scored
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
        "flags": _pack(counts, np.uint8),
        "stages": [
            {"name": k, "rms": 1e3 * float(np.sqrt(np.mean(distance[k][scored] ** 2))), "error": _pack(e)}
            for k, e in errors.items()
        ],
        "effects": [_stepped(k, np.einsum("nij,nj->ni", R_base_world, v)) for k, v in scene.moved.items()],
        "places": _pack(scene.places),
        "sigma": _pack(1e3 * scene.sigma),
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
    T = np.tile(
        data.oMf[model.getFrameId(robot.base, pin.FrameType.BODY)].inverse().homogeneous,
        (len(readings), model.njoints, 1, 1),
    )
    for k, _, turned, at in tree_frames(robot, readings):
        T[:, k, :3, :3], T[:, k, :3, 3] = turned, at
    return T


def _upright(gravity: np.ndarray) -> np.ndarray:
    """R_view_base: the view's z is up."""
    return turn(-gravity, np.array([0.0, 0.0, 1.0])) if np.linalg.norm(gravity) > 1e-9 else np.eye(3)


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


def _stepped(name: str, values: np.ndarray) -> dict[str, Any]:
    """Small motions [m] as 16-bit steps: there may be many effects, each with a vector for every row."""
    step = max(float(np.abs(values).max()), 1e-12) / 32767
    return {"name": name, "step": step, "moved": _pack((values / step).round(), np.int16)}


def _pack(values: np.ndarray, dtype: type = np.float32) -> str:
    return base64.b64encode(np.ascontiguousarray(values, np.dtype(dtype).newbyteorder("<")).tobytes()).decode()


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
