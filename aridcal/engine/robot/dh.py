"""What controllers read beside a URDF: Denavit-Hartenberg tables and ``kinematics.yaml``."""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.doty import align, doty_links, link_transform
from aridcal.engine.robot.splice import origin_texts, rpy_near, without_rounding

# Axes nearer to parallel than this [rad] have a common normal that small errors move by metres.
ILL_CONDITIONED_ANGLE = np.radians(1.0)

# Below this angle [rad] the common normal would lose more digits to rounding than calling the axes parallel does.
PARALLEL_DH_ANGLE = float(np.sqrt(np.finfo(float).eps))

# Parallel axes nearer than this [m] are one axis.
COINCIDENT_LENGTH = 1e-9

# From ``base_link`` of Universal Robots' description to its ``base_link_inertia``, where the first joint is mounted.
HALF_TURN = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))

# How Universal Robots' description names the joints (after a prefix), and its ``kinematics.yaml`` the links.
UR_LINKS = {
    "shoulder_pan_joint": "shoulder",
    "shoulder_lift_joint": "upper_arm",
    "elbow_joint": "forearm",
    "wrist_1_joint": "wrist_1",
    "wrist_2_joint": "wrist_2",
    "wrist_3_joint": "wrist_3",
}


@dataclass(frozen=True)
class DHRow:
    """One joint's row; its position adds to ``theta`` (revolute) or ``d`` (prismatic).

    Attributes:
        joint: As in the URDF.
        kind: ``revolute`` or ``prismatic``.
        theta: Offset about z [rad].
        d: Offset along z [m].
        a: Length along x [m]; of this joint's link (standard) or of the one before (modified).
        alpha: Twist about x [rad]; likewise.
        ill_conditioned: The next axis is within 1 deg of parallel: ``theta`` and ``d`` of this row and the next hang
            on an angle that can hardly be measured, and may be huge.
    """

    joint: str
    kind: str
    theta: float
    d: float
    a: float
    alpha: float
    ill_conditioned: bool


@dataclass(frozen=True)
class DHTable:
    """A chain as Denavit and Hartenberg (standard) or Craig (modified) write it.

    ``T_base_tip = base * prod(row) * tool``, where a row is ``Rz(theta) Tz(d) Tx(a) Rx(alpha)`` if standard and
    ``Tx(a) Rx(alpha) Rz(theta) Tz(d)`` if modified.

    Attributes:
        modified: Whether rows are Craig's.
        base: From the chain's base to the first row: its z is the first joint's axis.
        rows: One per moving joint, base to tip.
        tool: From the last row to the tip.
    """

    modified: bool
    base: pin.SE3
    rows: tuple[DHRow, ...]
    tool: pin.SE3

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before trusting the table: one sentence for each ill-conditioned pair of axes."""
        return tuple(
            f"WARNING: the axes of {row.joint} and {after.joint} are nearly parallel: theta and d of these two rows hang "
            f"on an angle that can hardly be measured (d = {row.d:.6g} m). The product is right; copy both rows or none. "
            "kinematics.yaml and doty.yaml have no such rows."
            for row, after in zip(self.rows, self.rows[1:], strict=False)
            if row.ill_conditioned
        )

    def poses(self, positions: np.ndarray) -> np.ndarray:
        """Multiply the table out: T_base_tip, shape (N, 4, 4), for joint positions, shape (N, joints), [rad] or [m]."""
        T = np.broadcast_to(self.base.homogeneous, (len(positions), 4, 4))
        for row, q in zip(self.rows, positions.T, strict=True):
            theta, d = (row.theta + q, row.d) if row.kind == "revolute" else (row.theta, row.d + q)
            if self.modified:
                T = T @ link_transform(0.0, 0.0, row.a, row.alpha) @ link_transform(theta, 0.0, 0.0, 0.0, d)
            else:
                T = T @ link_transform(theta, 0.0, row.a, row.alpha, d)
        return T @ self.tool.homogeneous

    def dump(self) -> str:
        """Write the table as YAML, SI, with its product in words."""
        row = "Tx(a) Rx(alpha) Rz(theta) Tz(d)" if self.modified else "Rz(theta) Tz(d) Tx(a) Rx(alpha)"
        document = {
            "convention": "modified (Craig)" if self.modified else "standard (Denavit-Hartenberg)",
            "product": f"T_base_tip = base * prod({row}) * tool; the joint's position adds to theta (prismatic: to d)",
            "base": xyz_rpy(self.base),
            "rows": [vars(r) for r in self.rows],
            "tool": xyz_rpy(self.tool),
        }
        return yaml.safe_dump(document, sort_keys=False, width=200)


def standard_dh(robot: Robot) -> DHTable:
    """Describe a chain by standard Denavit-Hartenberg parameters.

    Args:
        robot: The chain, nominal or calibrated.

    Returns:
        The table. Of the two directions of a common normal the one with the smaller theta is taken, so ``a`` may be
        negative, as in manufacturers' tables. Between parallel axes d is 0. The last row reaches the tip's height along
        the last axis. Its poses are the chain's to rounding, times the size of ``d`` where a row is ill-conditioned:
        30 nm at worst, for axes 1e-8 rad from parallel.
    """
    base, rows, tool = _rows(robot, _base(robot))
    return DHTable(False, base, rows, tool)


def modified_dh(robot: Robot) -> DHTable:
    """Describe a chain by modified (Craig) Denavit-Hartenberg parameters; see :func:`standard_dh`.

    The factors are the standard ones, cut before ``Tx(a) Rx(alpha)`` instead of after: row i has a and alpha of the
    link before joint i (0 for the first).
    """
    base, rows, tool = _rows(robot, _base(robot))
    return DHTable(True, base, _modified(rows), tool)


def doty_yaml(robot: Robot) -> str:
    """Write Doty's link parameters (equations 3-1 to 3-4) as YAML, SI, with their product in words."""
    links = doty_links(robot)
    rows = [
        {"joint": k.joint, "kind": "prismatic" if k.prismatic else "revolute", "theta": k.theta, "beta": k.beta, "a": k.a,
         "alpha": k.alpha, "singular": k.singular, "before": xyz_rpy(k.before), "after": xyz_rpy(k.after)}
        for k in links
    ]  # fmt: skip
    document = {
        "convention": "Doty (1992): Rz(theta) Ry(beta) Tx(a) Rx(alpha)",
        "product": "T_base_tip = base * prod(motion(q) * before * Rz(theta) Ry(beta) Tx(a) Rx(alpha) * after); motion: "
        "about or along `axis` of the joint",
        "base": xyz_rpy(robot.onward[0]),
        "axes": {j.name: j.along.tolist() for j in robot.joints},
        "rows": rows,
    }
    return yaml.safe_dump(document, sort_keys=False, width=200)


def kinematics_yaml(nominal: Robot, calibrated: Robot) -> str:
    """Write ``kinematics.yaml``: x y z [m] and roll pitch yaw [rad] of each joint's origin, as descriptions read them.

    For a robot with Universal Robots' joint names: the layout of ``ur_description``, whose frames have z on the joints'
    axes, whatever axes the URDF has. They are the modified DH frames of the nominal robot, carried along by the
    calibration, so nearly parallel axes move nothing by metres. They start at that description's ``base_link``, wherever
    the chain does: that link, or ``base_link_inertia``, has to be rigid with the chain's base. A comment states where the
    tip is from that description's ``tool0``. For every other robot: the layout of ``franka_description``, with each
    joint's own ``<origin>`` and that of the tip's fixed joint; a comment says so where the names are Universal Robots'.

    Args:
        nominal: The chain before calibration.
        calibrated: The same chain after it.
    """
    stems = [next((stem for stem in UR_LINKS if name.endswith(stem)), "") for name in nominal.names]
    why = ""
    if stems == list(UR_LINKS):
        start = _ur_base(nominal)
        if start is not None:
            return _ur_kinematics(*(_from(robot, start) for robot in (nominal, calibrated)))
        why = (
            f"# Each joint's own <origin>, not the layout of ur_description: no link base_link or base_link_inertia is "
            f"rigid with {nominal.base}, where the chain starts.\n"
        )
    origins = {j.name: j.origin for j in calibrated.joints}
    if calibrated.tip_joint is not None:
        origins[calibrated.tip_joint] = calibrated.tip_origin
    # Franka's own file leaves out the prefix of its joints' names.
    short = {name: match.group() if (match := re.search(r"joint\d+$", name)) else name for name in origins}
    if len(set(short.values())) < len(short):
        short = {name: name for name in origins}
    written = origin_texts(nominal.urdf, origins)
    entries = {short[name]: {"kinematic": _by_component(np.concatenate(vectors))} for name, vectors in written.items()}
    return why + yaml.safe_dump(entries, sort_keys=False)


def _ur_base(robot: Robot) -> pin.SE3 | None:
    """Where ``ur_description``'s ``base_link`` is in the chain's base; None: no such link is rigid with it."""
    if robot.base.endswith("base_link"):
        return pin.SE3.Identity()
    tree = robot.tree
    prefix = robot.names[0].removesuffix(next(iter(UR_LINKS)))
    links = {f.name: f for f in tree.frames if f.type == pin.FrameType.BODY}
    base = links[robot.base]
    for name, turn in ((f"{prefix}base_link", pin.SE3.Identity()), (f"{prefix}base_link_inertia", HALF_TURN)):
        frame = links.get(name)
        if frame is not None and frame.parentJoint == base.parentJoint:
            return base.placement.actInv(frame.placement) * turn
    return None


def _from(robot: Robot, start: pin.SE3) -> Robot:
    """A chain seen from a frame that is rigid with its base."""
    first, *rest = robot.joints
    return replace(robot, joints=(replace(first, before=start.actInv(first.before)), *rest))


def _ur_kinematics(nominal: Robot, calibrated: Robot) -> str:
    # A nominal robot that is itself a factory calibration has nearly parallel axes: frames near them are near enough.
    start, rows, _ = _rows(nominal, _base(nominal) * HALF_TURN, ILL_CONDITIONED_ANGLE)
    joint, frame, before = pin.SE3.Identity(), start, HALF_TURN
    links: dict[str, Any] = {}
    for nominal_joint, onward, calibrated_onward, row, link in zip(
        nominal.joints, nominal.onward[:-1], calibrated.onward[:-1], _modified(rows), UR_LINKS.values(), strict=True
    ):
        joint = joint * onward
        step = link_transform(0.0, 0.0, row.a, row.alpha) @ link_transform(row.theta, 0.0, 0.0, 0.0, row.d)
        frame = frame * pin.SE3(step)
        inside = _onto_axis(joint.actInv(frame), nominal_joint.axis)  # the description's frame in the URDF's
        usual = before.inverse() * onward * inside
        links[link] = _components(before.inverse() * calibrated_onward * inside, usual)
        before = inside
    usual = before.inverse() * nominal.onward[-1]
    to_tip = _components(before.inverse() * calibrated.onward[-1], usual)
    links["hash"] = f"aridcal_{hashlib.sha256(repr(links).encode()).hexdigest()[:16]}"
    return (
        "# For ur_description. The driver warns that the hash is not the controller's: these numbers are measured.\n"
        f"# From that description's tool0 to the calibrated {calibrated.tip}: {json.dumps(to_tip)}\n"
        + yaml.safe_dump({"kinematics": links}, sort_keys=False)
    )


def _base(robot: Robot) -> pin.SE3:
    """Put z on the first joint's axis, at the point nearest to the base's origin: the base itself for most robots."""
    first = robot.onward[0]
    direction = first.rotation @ robot.joints[0].along
    point = first.translation
    return pin.SE3(align(direction).rotation, point - (point @ direction) * direction)


def _onto_axis(frame: pin.SE3, axis: np.ndarray) -> pin.SE3:
    """Move a frame by the least that puts its z and its origin on an axis through zero."""
    turn = align(frame.rotation.T @ axis).rotation
    return pin.SE3(frame.rotation @ turn, (frame.translation @ axis) * axis)


def _rows(
    robot: Robot, base: pin.SE3, parallel: float = PARALLEL_DH_ANGLE
) -> tuple[pin.SE3, tuple[DHRow, ...], pin.SE3]:
    """Standard rows from a base frame whose z is the first joint's axis, and the tool behind the last one."""
    rows = []
    placement = robot.onward[0]
    frame = base
    for joint, after, onward in zip(robot.joints, robot.joints[1:], robot.onward[1:], strict=False):
        placement = placement * onward
        to_next = frame.actInv(placement)
        direction = to_next.rotation @ after.along
        theta, d, a, alpha = _common_normal(to_next.translation, direction, parallel)
        near = bool(np.hypot(direction[0], direction[1]) < np.sin(ILL_CONDITIONED_ANGLE))
        rows.append(DHRow(joint.name, joint.kind, theta, d, a, alpha, near))
        frame = frame * pin.SE3(link_transform(theta, 0.0, a, alpha, d))
    tool = frame.actInv(placement * robot.onward[-1])
    last = robot.joints[-1]
    height = float(tool.translation[2])
    rows.append(DHRow(last.name, last.kind, 0.0, height, 0.0, 0.0, False))
    return base, tuple(rows), pin.SE3(tool.rotation, tool.translation - np.array([0.0, 0.0, height]))


def _common_normal(
    point: np.ndarray, direction: np.ndarray, parallel_angle: float
) -> tuple[float, float, float, float]:
    """Find theta, d, a, alpha from a frame on one axis (its z) to the next axis, through a point in a direction."""
    parallel = math.hypot(direction[0], direction[1]) < parallel_angle
    if parallel:
        foot = point - point[2] / direction[2] * direction
        theta = math.atan2(foot[1], foot[0]) if math.hypot(foot[0], foot[1]) > COINCIDENT_LENGTH else 0.0
    else:
        theta = math.atan2(direction[0], -direction[1])  # of z x direction
    # The margin keeps right angles, of which there are many, from turning over with a calibration's small changes.
    if not -math.pi / 2 + 0.01 < theta <= math.pi / 2 + 0.01:
        theta -= math.copysign(math.pi, theta)
    x = np.array([math.cos(theta), math.sin(theta), 0.0])
    y = np.array([-x[1], x[0], 0.0])
    if not parallel:
        foot = point - (point @ y) / (direction @ y) * direction
    return theta, float(foot[2]), float(foot @ x), math.atan2(-(direction @ y), direction[2])


def _modified(rows: tuple[DHRow, ...]) -> tuple[DHRow, ...]:
    before = [(0.0, 0.0), *((r.a, r.alpha) for r in rows[:-1])]
    return tuple(
        DHRow(r.joint, r.kind, r.theta, r.d, a, alpha, r.ill_conditioned)
        for r, (a, alpha) in zip(rows, before, strict=True)
    )


def xyz_rpy(T: pin.SE3) -> dict[str, list[float]]:
    """Write a placement as URDF does: ``xyz`` [m] and ``rpy`` [rad]."""
    return {"xyz": T.translation.tolist(), "rpy": pin.rpy.matrixToRpy(T.rotation).tolist()}


def _components(T: pin.SE3, nominal: pin.SE3) -> dict[str, float]:
    """A placement by name, its angles near the nominal one's."""
    xyz = without_rounding(T.translation, without_rounding(nominal.translation, np.zeros(3)))
    usual = rpy_near(nominal.rotation, np.zeros(3))
    return _by_component(np.concatenate([xyz, rpy_near(T.rotation, usual)]))


def _by_component(values: np.ndarray) -> dict[str, float]:
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), (values + 0.0).tolist(), strict=True))
