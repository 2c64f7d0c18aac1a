"""Where a nominal robot's joints are, and what gravity does to them: arrays over many configurations at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from aridcal.robot.chain import Robot

# An axis whose other two components are smaller is one of its frame's own: the rounding of a written URDF.
ON_AN_AXIS = 1e-9


STEEP = 0.8
"""Cosine of the angle to a plane's normal beyond which an axis is too steep to give a direction along it: few planes are near."""


def transverse(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across an axis (FORMATS section 4), or across each of several.

    The frame's own axes in x y z order if the axis is one of them; else e1 = the frame axis least aligned with it,
    made orthogonal, and e2 = axis x e1.

    Args:
        axis: Unit vectors, shape (..., 3).

    Returns:
        e1 and e2, shape (..., 3) each.
    """
    lengths, own = np.abs(axis), np.eye(3)
    least = own[lengths.argmin(axis=-1)]
    e1 = least - (least * axis).sum(axis=-1, keepdims=True) * axis
    e1 = e1 / np.sqrt((e1 * e1).sum(axis=-1, keepdims=True))
    e2 = np.cross(axis, e1)
    largest = lengths.argmax(axis=-1)
    aligned = np.sort(lengths, axis=-1)[..., 1, None] < ON_AN_AXIS
    before, after = own[np.array([1, 0, 0])[largest]], own[np.array([2, 2, 1])[largest]]
    return np.where(aligned, before, e1), np.where(aligned, after, e2)


def along_plane(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors along a plane with normal n, or along each of several: x laid into it (y, where x is steep), and n x that.

    Unlike those of :func:`transverse` they do not jump where a normal tilts that is an axis of the frame, as those of tables and
    walls are.

    Args:
        normal: Unit vectors, shape (..., 3).

    Returns:
        e1 and e2, shape (..., 3) each.
    """
    near = np.eye(3)[np.where(np.abs(normal[..., 0]) > STEEP, 1, 0)]
    e1 = near - (near * normal).sum(axis=-1, keepdims=True) * normal
    e1 = e1 / np.sqrt((e1 * e1).sum(axis=-1, keepdims=True))
    return e1, np.cross(normal, e1)


def rotations(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    r"""Rotation matrices about a fixed axis (Rodrigues).

    .. math:: R = 1 + \sin\alpha \, [a] + (1 - \cos\alpha) \, [a]^2

    Args:
        axis: Unit vector, shape (3,).
        angle: Shape (N,), [rad].

    Returns:
        Shape (N, 3, 3).
    """
    x = pin.skew(axis)
    s = np.sin(angle)[:, None, None]
    c = np.cos(angle)[:, None, None]
    return np.eye(3) + s * x + (1.0 - c) * (x @ x)


class Walked(NamedTuple):
    """A joint of the tree in N configurations, in the base's frame.

    Attributes:
        joint: Its id in ``robot.tree``.
        bearing: Its axes before a revolute joint turns, shape (N, 3, 3).
        axes: Its axes after its motion, shape (N, 3, 3).
        origin: After its motion, shape (N, 3), [m].
    """

    joint: int
    bearing: np.ndarray
    axes: np.ndarray
    origin: np.ndarray


def tree_frames(robot: Robot, readings: np.ndarray) -> Iterator[Walked]:
    """Walk the whole tree for N rows at once, nominal placements, parents first.

    Args:
        robot: The chain; its readings drive the tree, and joints that are not measured stay at zero.
        readings: Shape (N, columns), [rad] or [m].
    """
    model = robot.tree
    n = len(readings)
    column = {name: k for k, name in enumerate(robot.readings)}
    base = model.frames[model.getFrameId(robot.base, pin.FrameType.BODY)]
    upstream = _joints_upstream(model, base)  # what moves the base itself moves nothing in the base's frame
    start = locked_placement(model, base).inverse()
    R = {0: np.broadcast_to(start.rotation, (n, 3, 3))}
    p = {0: np.broadcast_to(start.translation, (n, 3))}
    for k in range(1, model.njoints):
        name, parent, placement = model.names[k], model.parents[k], model.jointPlacements[k]
        bearing = R[parent] @ placement.rotation
        axes, origin = bearing, p[parent] + R[parent] @ placement.translation
        master, multiplier, offset = robot.mimics.get(name, (name, 1.0, 0.0))
        if master in column and name in robot.moves and k not in upstream:
            axis, kind = robot.moves[name]
            q = multiplier * readings[:, column[master]] + offset
            if kind == "prismatic":
                origin = origin + q[:, None] * (bearing @ axis)
            else:
                axes = bearing @ rotations(axis, q)
        R[k], p[k] = axes, origin
        yield Walked(k, bearing, axes, origin)


def gravity_loads(robot: Robot, readings: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    r"""Gravity's pull on everything beyond each joint of the chain, from the nominal masses.

    .. math:: f = \sum_b m_b g, \quad \tau = \sum_b m_b (c_b - o) \times g

    over the bodies b beyond the joint, with their centres of mass c and the joint's origin o.

    Args:
        robot: The chain.
        readings: Shape (N, columns), [rad] or [m].
        gravity: In the base frame, [m/s^2], shape (3,) or (N, 3).

    Returns:
        Force [N] then moment [N m] at each joint's frame, in its axes before a revolute joint turns, shape
        (N, joints, 6).
    """
    model = robot.tree
    n = len(readings)
    gravity = np.broadcast_to(gravity, (n, 3))
    walked = {step.joint: step for step in tree_frames(robot, readings)}
    centre = {k: step.origin + step.axes @ model.inertias[k].lever for k, step in walked.items()}
    loads = np.zeros((n, len(robot.names), 6))
    for j, name in enumerate(robot.names):
        k = model.getJointId(name)
        bearing, origin = walked[k].bearing, walked[k].origin
        mass, moment = 0.0, np.zeros((n, 3))
        for body in model.subtrees[k]:
            own_mass = model.inertias[body].mass
            if own_mass > 0.0:
                mass += own_mass
                moment += own_mass * np.cross(centre[body] - origin, gravity)
        loads[:, j, :3] = np.einsum("nji,nj->ni", bearing, mass * gravity)
        loads[:, j, 3:] = np.einsum("nji,nj->ni", bearing, moment)
    return loads


def joint_frames(robot: Robot, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, joints, 3, 3) and origins (N, joints, 3) of the chain's joint frames in the base frame, nominal.

    Axes are those before a revolute joint turns; origins are those after a prismatic joint's travel.
    """
    walked = {step.joint: step for step in tree_frames(robot, readings)}
    chain = [walked[robot.tree.getJointId(name)] for name in robot.names]
    axes = np.stack([step.bearing for step in chain], axis=1)
    origins = np.stack([step.origin for step in chain], axis=1)
    return axes, origins


def tip_frames(robot: Robot, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3) and origins (N, 3) of the tip link in the base frame, nominal."""
    last = robot.tree.getJointId(robot.joints[-1].name)
    end = robot.tip_before * robot.tip_origin
    for step in tree_frames(robot, readings):
        if step.joint == last:
            return step.axes @ end.rotation, step.origin + step.axes @ end.translation
    raise AssertionError("the chain's last joint is in its own tree")


def _joints_upstream(model: pin.Model, frame: pin.Frame) -> set[int]:
    """Joints between the tree's root and a frame."""
    found, k = set(), frame.parentJoint
    while k > 0:
        found.add(k)
        k = model.parents[k]
    return found


def locked_placement(model: pin.Model, frame: pin.Frame) -> pin.SE3:
    """Placement of a frame in the tree's root when no joint upstream moves."""
    placement, k = frame.placement, frame.parentJoint
    while k > 0:
        placement, k = model.jointPlacements[k] * placement, model.parents[k]
    return placement


def carried_bodies(robot: Robot) -> dict[str, pin.Inertia]:
    """Inertia carried by each joint of the chain: fixed links and locked side branches included."""
    tree = robot.tree.copy()
    for frame in tree.frames:  # Pinocchio looks for frames by name, and a link may have that of a joint
        if frame.type != pin.FrameType.JOINT:
            frame.name = f"{frame.name} {frame.type}"
    lock = [k for k in range(1, tree.njoints) if tree.names[k] not in robot.names]
    reduced = pin.buildReducedModel(tree, lock, pin.neutral(tree))
    return {name: reduced.inertias[reduced.getJointId(name)] for name in robot.names}
