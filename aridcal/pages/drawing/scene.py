"""``scene.html``: nominal and calibrated robot, measured targets and magnified error vectors, in one offline page.

The page is meshcat's own viewer, its script inlined, and a short script (``scene.js``) that puts the objects into the
viewer's tree and works the panel. Meshcat's server is not needed to make it; ``aridcal view`` runs it to keep the page up to
date. Each shape is stored once and drawn twice, as the robot and as its ghost.

Everything is drawn in the frame of the robot's base, so that the robot stands still although the measured frame may
differ from station to station; the view is turned upright against gravity.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from aridcal.engine.fit.constants import stage_urdf
from aridcal.engine.robot.chain import Robot, chain_in_urdf
from aridcal.engine.robot.kinematics import LEVEL_GRAVITY, start_frames, tree_frames
from aridcal.engine.robot.link_shapes import LinkShape
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.drawn_rows import drawn_rows
from aridcal.pages.drawing.html import attempt, collect_notices, note
from aridcal.pages.drawing.page_frame import asset, empty_page, filled
from aridcal.pages.drawing.robot_shapes import packed, position_quaternion, robot_shapes, stepped, turn

ASSETS = Path(__file__).parent / "assets"

# At most so many of them can be stepped through.
MOST_SCENE_ROWS = 200

# Viridis from 0.2 to 1, evenly: its darkest fifth is left out because the page is dark.
VIRIDIS = ("#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725")

# Limbs are told apart by these; those beyond them keep the URDF's colours.
LIMB_COLOURS = ("#4f9cf0", "#f08c4f", "#7ccf6b", "#d27bd6")

# Magnifications to choose from.
LADDER = tuple(m * 10**k for k in range(6) for m in (1, 2, 5))

# Percentiles of the errors: the needles' length is set by large ones, the colours reach from the best to nearly the
# worst.
PERCENTILE_OF_NEEDLES, WORST_PERCENTILE, BEST_PERCENTILE = 90, 98, 5

# Ratios of the colour scale's ends, at least and at most.
NARROWEST, WIDEST = 3.0, 1000.0

# Of the scene's size: length of a needle half-way between before and after, and of one before calibration at most.
NEEDLES, LONGEST_NEEDLE = 0.04, 0.15

# Of the robot's size: how far the ghost stands from it. Nearer it cannot be seen; further its links fall apart.
GHOST = 0.12

# A link that is turned by so much counts as one that is moved by the robot's size.
RADIANS_PER_SPAN = 4.0


# [m] and without unit: a link whose frame moves less stands where it did.
LEAST_SCENE_MOTION = 1e-12

# Bits of a row's flags, as ``scene.js`` reads them.
TEST, OUTLIER, SCORED = 1, 2, 4


@dataclass(frozen=True)
class Scene:
    """What there is to see of a calibration.

    Attributes:
        nominal: The robot as its URDF has it; also gives the visuals.
        calibrated: The same chain with the calibrated URDF's constants.
        readings: Joint readings in the order of ``nominal.readings``, shape (N, columns), [rad] or [m].
        T_world_base: Shape (N, 4, 4), or (4, 4) for all rows. The world of rows whose path starts at a link is that link's frame.
        measured: Target positions in the world frame, shape (N, 3), [m].
        predicted: The same as each stage predicts them; the first stage is "before", the last "after".
        test: Held-out rows, shape (N,) bool.
        outlier: Flagged rows, shape (N,) bool.
        line: What each row is called: its line in the file, shape (N,); default: 1 to N.
        gravity: In the base frame, shape (3,); the view is upright against it.
        moved: How each effect moves the last stage's prediction in the world frame, beyond what frames and constants could
            take up, by its name, shape (N, 3) each, [m].
        places: Targets all over the joint range in the base frame, shape (M, 3), [m].
        sigma: How well the model knows them: 1-sigma in the worst direction, shape (M,), [m].
        rms_mm: Of each stage's errors over all rows, where only some are here; default: over those that are.
        left_out: Which rows are here, in words, where not all are.
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
    gravity: np.ndarray = field(default_factory=lambda: np.array(LEVEL_GRAVITY))
    moved: dict[str, np.ndarray] = field(default_factory=dict)
    places: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    sigma: np.ndarray = field(default_factory=lambda: np.zeros(0))
    rms_mm: dict[str, float] = field(default_factory=dict)
    left_out: str = ""


def write_scene(outcome: Outcome, path: Path) -> tuple[str, ...]:
    """Write the page of a calibration; what cannot be drawn of it is missing, and the rest stands.

    Args:
        outcome: What was found.
        path: The HTML file.

    Returns:
        Notices: what could not be drawn, and why.
    """
    with collect_notices() as notices:
        text = attempt(
            "scene.html", lambda: scene_page(scene(outcome)), lambda notice: empty_page("Calibration scene", notice)
        )
    path.write_bytes(text.encode("utf-8", "replace"))
    return tuple(notices)


def scene_page(scene: Scene) -> str:
    """The page of a scene; visuals of the robot that cannot be drawn are noted.

    See :func:`aridcal.pages.drawing.html.collect_notices`.

    Args:
        scene: At least one row and one stage.
    """
    shapes, notices = robot_shapes(scene.nominal)
    for notice in notices:
        note(f"scene.html: {notice}")
    notices = (*notices, *([scene.left_out] if scene.left_out else ()))
    script = asset("scene.js")
    which = hashlib.sha256(script.encode()).hexdigest()[:12]  # the script that understands this content
    return _page(scene_content(scene, shapes) | {"notices": notices, "script": which}, script)


def scene_content(scene: Scene, shapes: tuple[LinkShape, ...]) -> dict[str, Any]:
    """Collect all that the page's script needs, as plain data; arrays as base64 of little-endian float32 (or as stated).

    Args:
        scene: At least one row and one stage.
        shapes: Of the robot.
    """
    n = len(scene.measured)
    rows = np.unique(np.linspace(0, n - 1, min(n, MOST_SCENE_ROWS)).round().astype(int))
    joints = sorted({shape.joint for shape in shapes})
    robots = (scene.nominal, scene.calibrated)
    nominal, calibrated = (body_poses(robot, scene.readings[rows])[:, joints] for robot in robots)
    geometries, visuals = _deduplicated(shapes, joints)

    measured, errors, moved = _in_base(scene)
    usual = [np.linalg.norm(e, axis=1)[~scene.outlier] for e in errors.values()]
    held_out = scene.test & ~scene.outlier
    scored = held_out if held_out.any() else ~scene.outlier
    flags = TEST * scene.test + OUTLIER * scene.outlier + SCORED * scored

    R_view_base = _upright(scene.gravity)
    seen = np.vstack([measured[rows], *_corners(shapes, joints, calibrated[0])]) @ R_view_base.T
    extent = float(np.linalg.norm(np.ptp(seen, axis=0)))
    factor = _magnification(usual[0], usual[-1], extent)
    return {
        "title": scene.nominal.tree.name,
        "geometries": geometries,
        "visuals": visuals,
        "bodies": len(joints),
        "limbs": [
            {"name": name, "colour": colour}
            for name, colour in zip(limb_names(scene.nominal), LIMB_COLOURS, strict=False)
        ],
        "limb": [limb_of(scene.nominal, scene.nominal.tree.names[joint]) for joint in joints],
        "corrected": [bool(moves > LEAST_SCENE_MOTION) for moves in np.abs(nominal - calibrated).max(axis=(0, 2, 3))],
        "poses": [packed(position_quaternion(T)) for T in (nominal, calibrated)],
        "rows": rows.tolist(),
        "line": (np.arange(1, n + 1) if scene.line is None else scene.line).tolist(),
        "readings": _readings(scene.nominal, scene.readings[rows]),
        "measured": packed(measured),
        "flags": packed(flags, np.uint8),
        "stages": [
            {"name": name, "rms": scene.rms_mm.get(name, _rms_mm(e[scored])), "error": packed(e)}
            for name, e in errors.items()
        ],
        "effects": [stepped(name, motion) for name, motion in moved.items()],
        "places": packed(scene.places),
        "sigma": packed(1e3 * scene.sigma),
        "scored": "held-out rows" if held_out.any() else "all rows",
        "colours": VIRIDIS,
        "range": _colour_range(usual),
        "factors": LADDER,
        "factor": factor,
        "ghost": min(_ghost_magnification(nominal, calibrated), factor),
        "upright": _homogeneous(R_view_base).T.ravel().tolist(),  # column by column, as three.js has it
        "seen": packed(seen),
    }


def _in_base(scene: Scene) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Turn measured places, the stages' errors and the effects' motions into the base's frame, each (N, 3), [m]."""
    n = len(scene.measured)
    T_world_base = np.broadcast_to(scene.T_world_base, (n, 4, 4))
    R_base_world = T_world_base[:, :3, :3].transpose(0, 2, 1)
    origin = T_world_base[:, :3, 3]

    def turned(vectors: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("nij,nj->ni", R_base_world, vectors))

    errors = {name: turned(p - scene.measured) for name, p in scene.predicted.items()}
    moved = {name: turned(motion) for name, motion in scene.moved.items()}
    return turned(scene.measured - origin), errors, moved


def _corners(shapes: tuple[LinkShape, ...], joints: list[int], T_base_body: np.ndarray) -> list[np.ndarray]:
    """Return the corners of the shapes' boxes in the base's frame, (8, 3) each, the bodies standing at (bodies, 4, 4)."""
    corners = []
    for shape in shapes:
        T = T_base_body[joints.index(shape.joint)]
        corners.append(shape.corners() @ T[:3, :3].T + T[:3, 3])
    return corners


def _rms_mm(errors: np.ndarray) -> float:
    """Return the root mean square length of errors (N, 3), [m], in [mm]."""
    lengths = np.linalg.norm(errors, axis=1)
    return 1e3 * float(np.sqrt(np.mean(lengths**2)))


def body_poses(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Return the frame of every joint of the tree in the base's frame, shape (N, joints, 4, 4).

    Args:
        robot: The chain and the tree around it.
        readings: Shape (N, columns), [rad] or [m]; what is above the base stays at rest unless the path climbs through it.
    """
    T = np.tile(np.eye(4), (len(readings), robot.tree.njoints, 1, 1))
    for k, _, turned, at in tree_frames(robot, readings):
        T[:, k, :3, :3], T[:, k, :3, 3] = turned, at
    return T


def _upright(gravity: np.ndarray) -> np.ndarray:
    """R_view_base: the view's z is up."""
    up = np.array([0.0, 0.0, 1.0])
    return turn(-gravity, up) if np.linalg.norm(gravity) > 1e-9 else np.eye(3)


def _homogeneous(R: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) as a placement (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = R
    return T


def _colour_range(distances: list[np.ndarray]) -> list[float]:
    """Ends of the (logarithmic) colour scale in [mm], the same for every stage, from the stages' errors, (N,) each, [m]."""
    high = 1e3 * max(float(np.percentile(d, WORST_PERCENTILE)) for d in distances)
    low = 1e3 * float(np.percentile(distances[-1], BEST_PERCENTILE))
    high = max(high, 1e-6)
    return [float(np.clip(low, high / WIDEST, high / NARROWEST)), high]


def _magnification(before: np.ndarray, after: np.ndarray, extent: float) -> int:
    """Choose how many times errors (N,), [m], are magnified on a scene of that size, [m].

    Before should not be too large and after not too small to be seen: their geometric mean gets the length ``NEEDLES``, unless
    that makes those before longer than ``LONGEST_NEEDLE``.
    """
    large_before, large_after = (max(float(np.percentile(d, PERCENTILE_OF_NEEDLES)), 1e-9) for d in (before, after))
    middle = np.sqrt(large_before * large_after)
    wanted = extent * min(NEEDLES / middle, LONGEST_NEEDLE / large_before)
    return _nearest_rung(wanted)


def _ghost_magnification(nominal: np.ndarray, calibrated: np.ndarray) -> int:
    """Choose how many times the ghost's deviation is magnified: it stands clear of the robot and its links hold together.

    Args:
        nominal: Frames of the bodies, shape (N, bodies, 4, 4).
        calibrated: Likewise.
    """
    places = calibrated[..., :3, 3]
    span = np.linalg.norm(np.ptp(places, axis=1), axis=1).max()
    moved = np.linalg.norm(nominal[..., :3, 3] - places, axis=-1)
    trace = np.einsum("nbij,nbij->nb", nominal[..., :3, :3], calibrated[..., :3, :3])
    turned = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    apart = moved / max(span, 1e-6) + turned / RADIANS_PER_SPAN
    large = max(float(np.percentile(apart.max(axis=1), PERCENTILE_OF_NEEDLES)), 1e-9)
    return _nearest_rung(GHOST / large)


def _nearest_rung(wanted: float) -> int:
    """Return the magnification of ``LADDER`` whose ratio to the wanted one is nearest to one."""
    return min(LADDER, key=lambda rung: abs(np.log(rung / wanted)))


def _readings(robot: Robot, readings: np.ndarray) -> list[dict[str, Any]]:
    """Write joint readings, shape (rows, columns), as they are shown: in degrees or millimetres."""
    shown = []
    for name, values in zip(robot.readings, readings.T, strict=True):
        revolute = robot.moves[name][1] == "revolute"
        unit, scale = ("°", 180 / np.pi) if revolute else ("mm", 1e3)
        limb = limb_of(robot, name)
        shown.append({"name": name, "unit": unit, "values": (scale * values).round(4).tolist(), "limb": limb})
    return shown


def limb_names(robot: Robot) -> tuple[str, ...]:
    """Links at the ends of the limbs; none of a robot of one limb."""
    return tuple(limb.tip for limb in robot.limbs) if robot.others else ()


def limb_of(robot: Robot, joint: str) -> int:
    """Number of the limb that a joint or one above it is of alone; -1 where none is."""
    tree, names = robot.tree, limb_names(robot)
    k = tree.getJointId(joint) if names and tree.existJointName(joint) else 0
    while k:
        if own := robot.limbs_of(tree.names[k]):
            return names.index(own[0]) if len(own) == 1 else -1
        k = tree.parents[k]
    return -1


def _deduplicated(
    shapes: tuple[LinkShape, ...], joints: list[int]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Each geometry once, and where each is drawn in which colour."""
    numbers: dict[str, int] = {}
    visuals = []
    for shape in shapes:
        number = numbers.setdefault(json.dumps(_geometry(shape)), len(numbers))
        visuals.append({
            "geometry": number,
            "body": joints.index(shape.joint),
            "matrix": shape.placement.T.ravel().round(7).tolist(),
            "colour": shape.colour,
        })  # fmt: skip
    return [json.loads(g) for g in numbers], visuals


def _geometry(shape: LinkShape) -> dict[str, Any]:
    """Write a shape's form; faces as 16-bit numbers where these are enough."""
    geometry: dict[str, Any] = {"kind": shape.kind, "size": shape.size}
    if shape.kind != "mesh":
        return geometry
    wide = len(shape.vertices) > np.iinfo(np.uint16).max
    faces = packed(shape.faces, np.uint32 if wide else np.uint16)
    return geometry | {"vertices": packed(shape.vertices), "faces": faces, "wide": wide}


def _page(content: dict[str, Any], script: str) -> str:
    """The whole page: everything inlined, nothing fetched."""
    package = importlib.util.find_spec("meshcat")
    assert package is not None
    assert package.origin is not None
    bundle = Path(package.origin).parent / "viewer" / "dist"
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    data = text.replace("<", "\\u003c")  # no name of a user's can end the script
    return filled(
        "scene.html",
        title=content["title"],
        style=Markup(asset("scene.css")),
        data=Markup(data),
        licence=Markup((bundle / "main.min.js.LICENSE.txt").read_text("utf-8")),
        meshcat=Markup((bundle / "main.min.js").read_text("utf-8")),
        script=Markup(script),
    )


def scene(outcome: Outcome) -> Scene:
    """Collect what the picture shows: nominal and calibrated robot, measured targets, and every stage's prediction."""
    fit, m, robot = outcome.stage("final").fit, outcome.measurements, outcome.robot
    as_read = m.as_read  # they are stepped through as they stand in the files
    some, left_out = drawn_rows(outcome.outlier[as_read])
    rows = as_read[some]
    station, target = (None if labels is None else labels[rows] for labels in (m.labels.station, m.labels.target))
    conditions = {name: values[rows] for name, values in m.conditions.items()}
    world = fit.model.rows(m.readings[rows], conditions, station, target).world
    bases = np.array([frame.homogeneous for _, frame in fit.model.world_base])
    calibrated = chain_in_urdf(robot, stage_urdf(outcome.stage("geometric").fit))
    # Where a path starts at a link, that link's frame is the world of its rows.
    route = None if m.labels.route is None else m.labels.route[rows]
    R, p, linked = start_frames(calibrated, m.readings[rows], m.labels.routes, route)
    T_world_base, back = bases[world], R[linked].transpose(0, 2, 1)
    T_world_base[linked, :3, :3] = back
    T_world_base[linked, :3, 3] = -np.einsum("nij,nj->ni", back, p[linked])
    measured = m.position[rows]
    shifts = {stage.name: stage.residual[:, :3] for stage in outcome.stages}
    if not m.direct:
        # What other instruments say of the target's place: the shortest way from the final model's to what fits the reading.
        shifts = {stage.name: np.nan_to_num(outcome.at_target.shift(stage.residual)) for stage in outcome.stages}
        measured = (outcome.at_target.places + shifts["final"])[rows]
    parts = outcome.parts()
    scored = parts["test"] if parts["test"].any() else ~outcome.outlier
    reach = (
        None if outcome.certainty is None else outcome.certainty.anywhere.select(outcome.certainty.anywhere.observable)
    )
    return Scene(
        nominal=robot,
        calibrated=calibrated,
        readings=m.readings[rows],
        T_world_base=T_world_base,
        measured=measured,
        predicted={name: measured - shift[rows] for name, shift in shifts.items()},
        test=m.test[rows],
        outlier=outcome.outlier[rows],
        line=m.origin.line[rows],
        gravity=np.atleast_2d(fit.model.around.gravity)[0],
        moved={e.effect.label: e.adds[rows] for e in outcome.effects if e.adds is not None},
        places=np.zeros((0, 3)) if reach is None else reach.places,
        sigma=np.zeros(0) if reach is None else reach.sigma,
        rms_mm={name: _rms_mm(shift[scored]) for name, shift in shifts.items()},
        left_out=left_out,
    )
