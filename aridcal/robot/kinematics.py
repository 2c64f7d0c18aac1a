"""Where a nominal robot's joints are, and what gravity does to them: arrays over many configurations at once."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from aridcal.robot.chain import Robot, driven
from aridcal.robot.drive import Drive

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
    """A joint of the tree in N configurations, in the base's frame. In memory rows run fastest.

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
        robot: The chain; its readings drive the tree, and joints that are neither measured nor stated stay at zero.
        readings: Shape (N, columns), [rad] or [m].
    """
    if robot.climbs:
        R, p = root_in_base(robot, readings)
        for k, bearing, axes, origin in root_frames(robot, readings):
            yield Walked(k, R @ bearing, R @ axes, p + (R @ origin[:, :, None])[:, :, 0])
        return
    base = _link_frame(robot, robot.base)
    # What moves the base itself moves nothing in the base's frame.
    yield from _walk(robot, readings, locked_placement(robot, base).inverse(), _joints_upstream(robot.tree, base))


def root_frames(robot: Robot, readings: np.ndarray) -> Iterator[Walked]:
    """The same in the frame of the tree's root, where all joints move that are measured."""
    return _walk(robot, readings, pin.SE3.Identity(), frozenset())


def root_in_base(robot: Robot, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3) and origin (N, 3) of the tree's root in the base's frame; only joints on the path up move it."""
    if robot.climbs:
        R, p = _link_in_root(robot, readings, robot.base)
        back = R.transpose(0, 2, 1)
        return back, -(back @ p[:, :, None])[:, :, 0]
    start = locked_placement(robot, _link_frame(robot, robot.base)).inverse()
    return np.tile(start.rotation, (len(readings), 1, 1)), np.tile(start.translation, (len(readings), 1))


def _link_in_root(robot: Robot, readings: np.ndarray, link: str) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3) and origin (N, 3) of a link in the tree's root."""
    frame = _link_frame(robot, link)
    at = frame.placement
    for step in root_frames(robot, readings):
        if step.joint == frame.parentJoint:
            return step.axes @ at.rotation, step.origin + step.axes @ at.translation
    return np.tile(at.rotation, (len(readings), 1, 1)), np.tile(at.translation, (len(readings), 1))


def _link_frame(robot: Robot, link: str) -> pin.Frame:
    """A link as Pinocchio has it: on which joint, and where."""
    return robot.tree.frames[robot.tree.getFrameId(link, pin.FrameType.BODY)]


def _walk(robot: Robot, readings: np.ndarray, start: pin.SE3, still: Collection[int]) -> Iterator[Walked]:
    r"""Walk the whole tree.

    .. math:: A' = A + \sin q \, A [a] + (1 - \cos q) \, A [a]^2

    turns axes A about a (Rodrigues, as :func:`rotations`).

    Args:
        robot: The chain.
        readings: Shape (N, columns), [rad] or [m].
        start: Where the root is.
        still: Joints that stay at zero although they are measured; those that are stated to stand elsewhere do not.
    """
    model = robot.tree
    n = len(readings)
    column = {name: k for k, name in enumerate(robot.readings)}
    # Each of three axes, or a place, has its numbers in the base here, shape (3, n): all that is done with them is long sums.
    R = {0: np.repeat(start.rotation.T[:, :, None], n, axis=2)}
    p = {0: np.repeat(start.translation[:, None], n, axis=1)}
    for k in range(1, model.njoints):
        name, parent, placement = model.names[k], model.parents[k], model.jointPlacements[k]
        bearing = np.empty((3, 3, n))
        for own, numbers in zip(bearing, placement.rotation.T, strict=True):
            own[:] = along(R[parent], numbers)
        axes, origin = bearing, p[parent] + along(R[parent], placement.translation)
        drive = robot.mimics.get(name, Drive({name: 1.0}))
        known = drive.factors.keys() <= column.keys()
        if known and name in robot.moves and not (k in still and drive.factors):
            axis, kind = robot.moves[name]
            q = driven(drive, readings, column)
            if kind == "prismatic":
                origin = origin + q * along(bearing, axis)
            else:
                about, s, c = pin.skew(axis), np.sin(q), 1.0 - np.cos(q)
                axes = bearing.copy()
                for own, once, twice in zip(axes, about.T, (about @ about).T, strict=True):
                    if once.any():
                        own += s * along(bearing, once) + c * along(bearing, twice)
        R[k], p[k] = axes, origin
        yield Walked(k, bearing.transpose(2, 1, 0), axes.transpose(2, 1, 0), origin.T)


def along(axes: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """A vector with these numbers, shape (3,), along axes, shape (3, 3, n): (3, n).

    Number by number: a product of matrices rounds a row otherwise beside other rows, and most numbers are zero.
    """
    parts = [axis * number for axis, number in zip(axes, numbers.tolist(), strict=True) if number]
    return np.asarray(sum(parts[1:], parts[0]) if parts else np.zeros(axes.shape[1:]))


def gravity_loads(robot: Robot, walked: Sequence[Walked], gravity: np.ndarray) -> np.ndarray:
    r"""Gravity's pull on everything beyond each joint of the chain, from the nominal masses.

    .. math:: f = \sum_b m_b g, \quad \tau = \sum_b m_b (c_b - o) \times g

    over the bodies b beyond the joint, with their centres of mass c and the joint's origin o.

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
        k, own = step.joint, model.inertias[step.joint]
        if own.mass > 0.0:
            mass[k] += own.mass
            moment[k] += own.mass * (step.origin.T + along(step.axes.T, own.lever))
        mass[model.parents[k]] += mass[k]
        moment[model.parents[k]] += moment[k]
    chain = of_chain(robot, walked)
    of = [(mass[step.joint], moment[step.joint].T - mass[step.joint] * step.origin) for step in chain]
    return borne_by(chain, [(held * gravity, np.cross(lever, gravity)) for held, lever in of])


def borne_by(joints: Sequence[Walked], wrenches: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Force [N] and moment [N m] of each of some joints, (3,) or (N, 3), in its axes before it turns, shape (N, joints, 6)."""
    loads = np.empty((len(joints), 6, len(joints[0].origin)))
    for load, joint, parts in zip(loads, joints, wrenches, strict=True):
        for own, part in zip((load[:3], load[3:]), parts, strict=True):
            np.sum(joint.bearing.T * np.atleast_2d(part).T, axis=1, out=own)
    return loads.transpose(2, 0, 1)


def joint_frames(robot: Robot, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, joints, 3, 3) and origins (N, joints, 3) of the chain's joint frames in the base frame, nominal.

    Axes are those before a revolute joint turns; origins are those after a prismatic joint's travel.
    """
    chain = of_chain(robot, tuple(tree_frames(robot, readings)))
    axes = np.stack([step.bearing for step in chain], axis=1)
    origins = np.stack([step.origin for step in chain], axis=1)
    return axes, origins


def of_chain(robot: Robot, walked: Sequence[Walked]) -> list[Walked]:
    """The chain's own joints, of the whole tree."""
    at = {step.joint: step for step in walked}
    return [at[robot.tree.getJointId(name)] for name in robot.names]


def tip_frames(robot: Robot, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3) and origins (N, 3) of the tip link in the base frame, nominal."""
    if robot.climbs:
        R, p = root_in_base(robot, readings)
        axes, origin = _link_in_root(robot, readings, robot.tip)
        return R @ axes, p + (R @ origin[:, :, None])[:, :, 0]
    last = robot.tree.getJointId(robot.joints[-1].name)
    for step in tree_frames(robot, readings):
        if step.joint == last:
            return _tip_on(robot, step)
    raise AssertionError("the chain's last joint is in its own tree")


def _tip_on(robot: Robot, last: Walked) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3) and origins (N, 3) of the tip link, from where the chain's last joint is."""
    end, axes = robot.onward[-1], last.axes.T
    turned = np.array([along(axes, numbers) for numbers in end.rotation.T])
    return turned.T, last.origin + along(axes, end.translation).T


def _joints_upstream(model: pin.Model, frame: pin.Frame) -> set[int]:
    """Joints between the tree's root and a frame."""
    found, k = set(), frame.parentJoint
    while k > 0:
        found.add(k)
        k = model.parents[k]
    return found


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
    """What a joint does, from its origin."""
    return pin.SE3(np.eye(3), q * axis) if kind == "prismatic" else pin.SE3(pin.exp3(q * axis), np.zeros(3))


def configuration(model: pin.Model, places: Mapping[str, float]) -> np.ndarray:
    """Pinocchio's configuration with some joints where they are said to be, [rad] or [m], and all others at zero."""
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
