"""Where a nominal robot's joints are, and what gravity does to them: arrays over many configurations at once."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from aridcal.engine.robot.chain import Robot, Route, driven
from aridcal.engine.robot.drive import Drive

# An axis whose other two components are smaller is one of its frame's own: the rounding of a written URDF.
ON_AN_AXIS = 1e-9


LEVEL_GRAVITY = (0.0, 0.0, -9.81)
"""[m/s^2], in a base that stands level."""

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
    lengths, frame = np.abs(axis), np.eye(3)
    least = frame[lengths.argmin(axis=-1)]
    e1 = least - (least * axis).sum(axis=-1, keepdims=True) * axis
    e1 = e1 / np.sqrt((e1 * e1).sum(axis=-1, keepdims=True))
    e2 = np.cross(axis, e1)
    largest = lengths.argmax(axis=-1)
    aligned = np.sort(lengths, axis=-1)[..., 1, None] < ON_AN_AXIS
    before, after = frame[np.array([1, 0, 0])[largest]], frame[np.array([2, 2, 1])[largest]]
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


class JointFrames(NamedTuple):
    """A joint of the tree in N configurations, in the base's frame. In memory rows run fastest.

    Attributes:
        joint: Its id in ``robot.tree``; 0 for the root, which no joint moves in the tree.
        bearing: Its axes before a revolute joint turns, shape (N, 3, 3).
        axes: Its axes after its motion, shape (N, 3, 3).
        origin: After its motion, shape (N, 3), [m].
    """

    joint: int
    bearing: np.ndarray
    axes: np.ndarray
    origin: np.ndarray


def tree_frames(robot: Robot, readings: np.ndarray) -> Iterator[JointFrames]:
    """Walk the whole tree for N rows at once, nominal placements, the root's own frame first and parents before their children.

    Args:
        robot: The chain; its readings drive the tree, and joints that are neither measured nor stated stay at zero.
        readings: Shape (N, columns), [rad] or [m].
    """
    base = link_frame(robot, robot.base)
    # What moves the base itself moves nothing in the base's frame, unless the path climbs there.
    still = frozenset() if robot.climbs else _joints_upstream(robot.tree, base)
    return _walk(robot, readings, _root_in_base(robot, readings, base, still), still)


def _root_in_base(
    robot: Robot, readings: np.ndarray, base: pin.Frame, still: Collection[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3, N) and origin (3, N) of the tree's root in the base's frame: up from the base, each joint the other way."""
    model, n = robot.tree, len(readings)
    onto = base.placement.inverse()
    R = np.repeat(onto.rotation.T[:, :, None], n, axis=2)
    p = np.repeat(onto.translation[:, None], n, axis=1)
    k = base.parentJoint
    while k:
        q, back = _position(robot, readings, k, still), model.jointPlacements[k].inverse()
        if q is not None:
            R, p = _after_motion(R, p, *robot.moves[model.names[k]], -q)
        p = p + along(R, back.translation)
        R = np.array([along(R, numbers) for numbers in back.rotation.T])
        k = model.parents[k]
    return R, p


def _position(robot: Robot, readings: np.ndarray, k: int, still: Collection[int]) -> np.ndarray | float | None:
    """Positions of a joint of the tree, shape (N,), or the one of all rows; None of one that stays at zero."""
    joint, column = robot.tree.names[k], {name: number for number, name in enumerate(robot.readings)}
    drive = robot.mimics.get(joint, Drive({joint: 1.0}))
    has_readings = drive.factors.keys() <= column.keys()
    if not has_readings or joint not in robot.moves or (k in still and drive.factors):
        return None
    return driven(drive, readings, column)


def _after_motion(
    axes: np.ndarray, origin: np.ndarray, axis: np.ndarray, kind: str, q: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    r"""A frame after a joint's motion, from its axes (3, 3, N) and origin (3, N).

    .. math:: A' = A + \sin q \, A [a] + (1 - \cos q) \, A [a]^2

    turns axes A about a (Rodrigues, as :func:`rotations`).
    """
    if kind == "prismatic":
        return axes, origin + q * along(axes, axis)
    about, s, c = pin.skew(axis), np.sin(q), 1.0 - np.cos(q)
    result = axes.copy()
    for vector, once, twice in zip(result, about.T, (about @ about).T, strict=True):
        if once.any():
            vector += s * along(axes, once) + c * along(axes, twice)
    return result, origin


def link_frame(robot: Robot, link: str) -> pin.Frame:
    """A link as Pinocchio has it: on which joint, and where."""
    return robot.tree.frames[robot.tree.getFrameId(link, pin.FrameType.BODY)]


def _walk(
    robot: Robot, readings: np.ndarray, root: tuple[np.ndarray, np.ndarray], still: Collection[int]
) -> Iterator[JointFrames]:
    """Walk the whole tree from its root.

    Each of three axes, or a place, has its numbers in the base, shape (3, N): all that is done with them is long sums.

    Args:
        robot: The chain.
        readings: Shape (N, columns), [rad] or [m].
        root: Its axes (3, 3, N) and origin (3, N).
        still: Joints that stay at zero although they are measured; those that are stated to stand elsewhere do not.
    """
    model = robot.tree
    R, p = ({0: numbers} for numbers in root)
    yield JointFrames(0, R[0].transpose(2, 1, 0), R[0].transpose(2, 1, 0), p[0].T)
    for k in range(1, model.njoints):
        parent, placement = model.parents[k], model.jointPlacements[k]
        bearing = np.empty_like(R[0])
        for vector, numbers in zip(bearing, placement.rotation.T, strict=True):
            vector[:] = along(R[parent], numbers)
        axes, origin = bearing, p[parent] + along(R[parent], placement.translation)
        q = _position(robot, readings, k, still)
        if q is not None:
            axes, origin = _after_motion(bearing, origin, *robot.moves[model.names[k]], q)
        R[k], p[k] = axes, origin
        yield JointFrames(k, bearing.transpose(2, 1, 0), axes.transpose(2, 1, 0), origin.T)


def along(axes: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """A vector with these numbers, shape (3,), along axes, shape (3, 3, n): (3, n).

    Number by number: a product of matrices rounds a row otherwise beside other rows, and most numbers are zero.
    """
    parts = [axis * number for axis, number in zip(axes, numbers.tolist(), strict=True) if number]
    return np.asarray(sum(parts[1:], parts[0]) if parts else np.zeros(axes.shape[1:]))


def gravity_loads(robot: Robot, walked: Sequence[JointFrames], gravity: np.ndarray) -> np.ndarray:
    r"""Gravity's pull on everything beyond each joint of the chain, from the nominal masses.

    .. math:: f = \sum_b m_b g, \quad \tau = \sum_b m_b (c_b - o) \times g

    over the bodies b beyond the joint, with their centres of mass c and the joint's origin o. The base stands still: a joint on
    the way up bears all that is not beyond it in the URDF's tree, which pushes its parent link, so its child link the other way.

    Args:
        robot: The chain.
        walked: Its tree in N configurations, as :func:`tree_frames` has it.
        gravity: In the base frame, [m/s^2], shape (3,) or (N, 3).

    Returns:
        Force [N] then moment [N m] at each joint's frame, in its axes before a revolute joint turns, shape
        (N, joints, 6).
    """
    model = robot.tree
    mass, moment = np.zeros(model.njoints), np.zeros((model.njoints, *walked[0].origin.T.shape))
    for step in reversed(walked):  # children first; each hands what it bears to its parent
        k, body = step.joint, model.inertias[step.joint]
        if body.mass > 0.0:
            mass[k] += body.mass
            moment[k] += body.mass * (step.origin.T + along(step.axes.T, body.lever))
        if k:
            mass[model.parents[k]] += mass[k]
            moment[model.parents[k]] += moment[k]
    chain = chain_part(robot, walked)
    wrenches = []
    for joint, step in zip(robot.joints, chain, strict=True):
        borne_mass, borne_moment = mass[step.joint], moment[step.joint]
        if joint.climbs:
            borne_mass, borne_moment = borne_mass - mass[0], borne_moment - moment[0]
        wrenches.append((borne_mass * gravity, np.cross(borne_moment.T - borne_mass * step.origin, gravity)))
    return borne_by(chain, wrenches)


def borne_by(joints: Sequence[JointFrames], wrenches: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Force [N] and moment [N m] of each of some joints, (3,) or (N, 3), in its axes before it turns, shape (N, joints, 6)."""
    loads = np.empty((len(joints), 6, len(joints[0].origin)))
    for load, joint, parts in zip(loads, joints, wrenches, strict=True):
        for sums, vectors in zip((load[:3], load[3:]), parts, strict=True):
            np.sum(joint.bearing.T * np.atleast_2d(vectors).T, axis=1, out=sums)
    return loads.transpose(2, 0, 1)


def joint_frames(robot: Robot, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, joints, 3, 3) and origins (N, joints, 3) of the chain's joint frames in the base frame, nominal.

    Axes are those before a revolute joint turns; origins are those after a prismatic joint's travel.
    """
    chain = chain_part(robot, tuple(tree_frames(robot, readings)))
    axes = np.stack([step.bearing for step in chain], axis=1)
    origins = np.stack([step.origin for step in chain], axis=1)
    return axes, origins


def chain_part(robot: Robot, walked: Sequence[JointFrames]) -> list[JointFrames]:
    """The chain's own joints, of the whole tree."""
    at = {step.joint: step for step in walked}
    return [at[robot.tree.getJointId(name)] for name in robot.names]


def tip_frames(robot: Robot, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3) and origins (N, 3) of the tip link in the base frame, nominal."""
    tip = link_frame(robot, robot.tip)
    return next(_on(step, tip) for step in tree_frames(robot, readings) if step.joint == tip.parentJoint)


def start_frames(
    robot: Robot, readings: np.ndarray, routes: Sequence[Route], route: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the links are at which the paths of rows start, nominal placements.

    Args:
        robot: With all limbs.
        readings: Shape (N, columns), [rad] or [m].
        routes: The paths.
        route: Number of each row's, shape (N,); None where all take the first.

    Returns:
        Rotations (N, 3, 3) and places (N, 3), [m], in the base's frame, and which rows start at a link, shape (N,) bool; those of
        the others are the identity.
    """
    n = len(readings)
    R, p, linked = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.zeros(n, dtype=bool)
    of_row = np.zeros(n, dtype=int) if route is None else route
    for number in np.unique(of_row).tolist():
        start, some = routes[number].start, of_row == number
        if start is not None:
            chain = robot.between(None, start)
            R[some], p[some] = tip_frames(chain, readings[some][:, robot.columns_of(chain)])
            linked |= some
    return R, p, linked


def link_axes(robot: Robot, walked: Sequence[JointFrames], link: str) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3) and origins (N, 3) of any link in the base frame, nominal, in a tree that was walked."""
    frame = link_frame(robot, link)
    return _on(next(step for step in walked if step.joint == frame.parentJoint), frame)


def bears(robot: Robot, link: str) -> np.ndarray:
    """Which joints bear what hangs at a link, the base standing still, shape (joints,) bool.

    Those between the tree's root and the link; on the way up from the base, those that are not.
    """
    above = _joints_upstream(robot.tree, link_frame(robot, link))
    return np.array([(robot.tree.getJointId(j.name) in above) != j.climbs for j in robot.joints], dtype=bool)


def carriers(robot: Robot, route: Route) -> np.ndarray:
    """Readings that move the end of a path and not its start, shape (columns,) bool; all on the path if there is none."""
    up, down = (_joints_upstream(robot.tree, link_frame(robot, link or robot.base)) for link in route)
    ids = np.array([robot.tree.getJointId(joint.name) for joint in robot.joints])
    beyond = np.isin(ids, list(down - up))
    return np.any(robot.factors[beyond if beyond.any() else np.isin(ids, list(down ^ up))] != 0.0, axis=0)


def _on(joint: JointFrames, link: pin.Frame) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3) and origins (N, 3) of a link, from where the joint is that moves it."""
    axes = joint.axes.T
    turned = np.array([along(axes, numbers) for numbers in link.placement.rotation.T])
    return turned.T, joint.origin + along(axes, link.placement.translation).T


def _joints_upstream(model: pin.Model, frame: pin.Frame) -> set[int]:
    """Joints between the tree's root and a frame."""
    joints, k = set(), frame.parentJoint
    while k > 0:
        joints.add(k)
        k = model.parents[k]
    return joints


def locked_placement(robot: Robot, frame: pin.Frame) -> pin.SE3:
    """Placement of a frame in the tree's root when no joint upstream moves."""
    model = robot.tree
    placement, k = frame.placement, frame.parentJoint
    while k > 0:
        drive = robot.mimics.get(model.names[k])
        if drive is not None and not drive.factors:
            placement = _motion(*robot.moves[model.names[k]], drive.offset) * placement
        placement, k = model.jointPlacements[k] * placement, model.parents[k]
    return placement


def _motion(axis: np.ndarray, kind: str, q: float) -> pin.SE3:
    """A joint's motion, from its origin."""
    return pin.SE3(np.eye(3), q * axis) if kind == "prismatic" else pin.SE3(pin.exp3(q * axis), np.zeros(3))


def configuration(model: pin.Model, places: Mapping[str, float]) -> np.ndarray:
    """Pinocchio's configuration with some joints at these places, [rad] or [m], and all others at zero."""
    q = pin.neutral(model)
    for name, place in places.items():
        joint = model.joints[model.getJointId(name)]
        # Of joints that turn without end Pinocchio has cosine and sine.
        q[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(place), np.sin(place)] if joint.nq == 2 else place
    return q


def carried_bodies(robot: Robot) -> dict[str, pin.Inertia]:
    """Inertia carried by each joint of the chain: fixed links and locked side branches included."""
    tree = robot.tree.copy()
    still = {name: drive.offset for name, drive in robot.mimics.items() if name in robot.moves and not drive.factors}
    for frame in tree.frames:  # Pinocchio looks for frames by name, and a link may have that of a joint
        if frame.type != pin.FrameType.JOINT:
            frame.name = f"{frame.name} {frame.type}"
    lock = [k for k in range(1, tree.njoints) if tree.names[k] not in robot.names]
    reduced = pin.buildReducedModel(tree, lock, configuration(tree, still))
    return {name: reduced.inertias[reduced.getJointId(name)] for name in robot.names}
