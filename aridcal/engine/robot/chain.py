"""A URDF as a serial chain from base to tip: placements, joint motions, and what gravity does to it.

The chain is the path between two links of the tree: up from the base to the link that both hang from, and down to the tip. With O
a joint's own ``<origin>`` and M its motion, a step down is :math:`O M(q)`, a step up is its inverse, :math:`M(q)^{-1} O^{-1}`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.engine.robot.drive import NO_STATEMENTS, Drive, StatedJoints
from aridcal.engine.robot.expand import plain_name, read_urdf
from aridcal.engine.robot.mjcf import as_urdf, is_mjcf
from aridcal.engine.robot.tree import LARGEST_IN_URDF, UrdfTree, numbers, parse_xml, read_tree
from aridcal.system.errors import RobotError, nearest, shortened
from aridcal.system.reading.regular_files import URDF, Limit

JointKind = Literal["revolute", "prismatic", "continuous"]


@dataclass(frozen=True)
class Joint:
    """A moving joint of the chain.

    Attributes:
        name: As in the URDF.
        kind: Motion about (``revolute``) or along (``prismatic``) the axis.
        axis: Unit vector in the joint frame, shape (3,).
        before: Fixed joints between the previous moving joint (or the base) and the link at which the path enters this one: its
            parent link, on the way up its child link.
        origin: This joint's own ``<origin>``.
        drive: What moves it: its own column, its masters' if it follows others, or none if it stands still.
        climbs: True on the way up from the base: the path goes from the child link to the parent link.
    """

    name: str
    kind: Literal["revolute", "prismatic"]
    axis: np.ndarray
    before: pin.SE3
    origin: pin.SE3
    drive: Drive
    climbs: bool = False

    @property
    def along(self) -> np.ndarray:
        """Unit vector, in the joint frame, about or along which the tip moves in the base, shape (3,)."""
        return -self.axis if self.climbs else self.axis


@dataclass(frozen=True)
class ReadingColumn:
    """Readings that a measurement needs.

    Attributes:
        name: Joint that they are of, as in the URDF.
        kind: Of that joint; of one whose mimic comes first on the chain, that of the mimic.
        lower: Lower limit, [rad] or [m]; -inf if there is none.
        upper: Upper limit.
    """

    name: str
    kind: JointKind
    lower: float
    upper: float


class FixedJoint(NamedTuple):
    """A joint of the chain that does not move.

    Attributes:
        name: As in the URDF.
        origin: Its own ``<origin>``.
        climbs: True on the way up from the base.
    """

    name: str
    origin: pin.SE3
    climbs: bool


@dataclass(frozen=True)
class Robot:
    """The chain base -> tip of a URDF, and the whole tree as mass.

    ``T_base_tip = prod(onward[k] * motion(q_k)) * onward[-1]``, each motion along ``joint.along``.

    A robot of several limbs has the joints of all of them, each once; what asks for a chain asks one of its ``limbs``, or the
    path :meth:`between` two links.

    Attributes:
        urdf: The file's own bytes.
        path: Where they came from; meshes are found from here.
        base: First link of the chain.
        tip: Last link of the chain.
        joints: Moving joints, base to tip.
        columns: What moves them, each once, in chain order.
        tip_joint: Name of the last fixed joint before the tip; None if a moving joint ends in the tip.
        tip_before: Fixed joints after the last moving joint, up to ``tip_joint``.
        tip_origin: Own ``<origin>`` of ``tip_joint``; identity if there is none.
        moves: Axis and kind of every moving joint of the tree, by name.
        mimics: What moves every joint of the tree that follows others or stands still, resolved to the last masters.
        packages: Where the user says that packages of ROS are, which its meshes are in.
        stated: What the user says of joints that have no column.
        fixed: Fixed joints before each moving joint, and behind the last, shape (joints + 1,).
        others: Chains from the base to further links that rows refer to; none of a robot of one limb.
        mjcf: The file's own bytes where it is MJCF; ``urdf`` is then what was made of it.
    """

    urdf: bytes
    path: Path
    base: str
    tip: str
    joints: tuple[Joint, ...]
    columns: tuple[ReadingColumn, ...]
    tip_joint: str | None
    tip_before: pin.SE3
    tip_origin: pin.SE3
    moves: Mapping[str, tuple[np.ndarray, str]] = field(repr=False)
    mimics: Mapping[str, Drive] = field(repr=False)
    packages: Mapping[str, Path] = field(default_factory=dict, repr=False)
    stated: StatedJoints = NO_STATEMENTS
    fixed: tuple[tuple[FixedJoint, ...], ...] = ()
    others: tuple[Robot, ...] = ()
    mjcf: bytes | None = field(default=None, repr=False)

    @cached_property
    def main(self) -> Robot:
        """The chain base -> tip alone."""
        return self if not self.others else self.between(None, None)

    @property
    def limbs(self) -> tuple[Robot, ...]:
        """Chains from the base: to the tip, and to further links that rows refer to."""
        return (self.main, *self.others)

    def between(self, start: str | None, end: str | None) -> Robot:
        """The path from one link, default the base, to another, default the tip: a chain of its own."""
        pair = start or self.base, end or self.tip
        if pair not in self._paths:
            path = chain(read_tree(self.urdf, self.path, self.stated), pair[1], pair[0], still=True)
            self._paths[pair] = replace(path, packages=self.packages, stated=self.stated, mjcf=self.mjcf)
        return self._paths[pair]

    def columns_of(self, limb: Robot) -> list[int]:
        """Which of the columns drive a chain of this robot, in that chain's order."""
        return [self.readings.index(name) for name in limb.readings]

    def on_one_limb(self, *names: str) -> bool:
        """True unless two of the names are joints of different limbs; names of anything else do not count."""
        if not self.others:
            return True
        limbs = [self._limbs_of[name] for name in names if name in self._limbs_of]
        return not limbs or bool(frozenset.intersection(*limbs))

    @cached_property
    def _limbs_of(self) -> dict[str, frozenset[str]]:
        """Ends of the limbs on which each joint is."""
        return {name: frozenset(self.limbs_of(name)) for name in self.names}

    @cached_property
    def _paths(self) -> dict[tuple[str, str], Robot]:
        return {}

    @property
    def readings(self) -> tuple[str, ...]:
        """Names of the columns that a measurement needs."""
        return tuple(column.name for column in self.columns)

    @cached_property
    def onward(self) -> tuple[pin.SE3, ...]:
        """From the base, or from a moving joint's frame after its motion, to the next one's before it, and to the tip at last.

        Of a robot of several limbs, along the chain base -> tip.
        """
        if self.others:
            return self.main.onward
        steps, here = [], pin.SE3.Identity()
        for joint in self.joints:
            here = here * joint.before
            steps.append(here if joint.climbs else here * joint.origin)
            here = joint.origin.inverse() if joint.climbs else pin.SE3.Identity()
        return (*steps, here * (self.tip_before * self.tip_origin))

    @property
    def climbs(self) -> bool:
        """True if joints move the base itself: it hangs from the path's middle, or from its end."""
        return any(joint.climbs for joint in self.joints)

    @property
    def kinds(self) -> tuple[JointKind, ...]:
        """Kind of each reading column."""
        return tuple(column.kind for column in self.columns)

    @property
    def limits(self) -> np.ndarray:
        """Lower and upper limit of each reading column, shape (columns, 2), [rad] or [m]; infinite where none is."""
        return np.array([(column.lower, column.upper) for column in self.columns])

    def joint(self, name: str) -> Joint:
        """Return the chain's joint of that name."""
        for j in self.joints:
            if j.name == name:
                return j
        raise RobotError(f"{self.path.name}: no moving joint {name!r} on the chain{nearest(name, self.names)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the moving joints, base to tip."""
        return tuple(j.name for j in self.joints)

    @cached_property
    def factors(self) -> np.ndarray:
        """How readings move the joints, shape (joints, columns)."""
        return np.array([[joint.drive.factors.get(name, 0.0) for name in self.readings] for joint in self.joints])

    @property
    def offsets(self) -> np.ndarray:
        """Where the joints are when all readings are zero, shape (joints,), [rad] or [m]."""
        return np.array([joint.drive.offset for joint in self.joints])

    def positions(self, readings: np.ndarray) -> np.ndarray:
        """Joint positions, shape (N, joints), from readings, shape (N, columns): each joint follows its drive."""
        column = {name: k for k, name in enumerate(self.readings)}
        positions = np.empty((len(self.joints), len(readings))).T
        for values, joint in zip(positions.T, self.joints, strict=True):
            values[:] = driven(joint.drive, readings, column)
        return positions

    def limbs_of(self, place: str) -> tuple[str, ...]:
        """Links to which limbs lead that have a joint on their way, a moving or a fixed one."""
        ways = {limb.tip: {*limb.names, *(each.name for gap in limb.fixed for each in gap)} for limb in self.limbs}
        return tuple(tip for tip, names in ways.items() if place in names)

    @property
    def from_to(self) -> str:
        """Where the chain begins and ends, in words: ``torso to left_hand and right_hand``."""
        ends = list(dict.fromkeys(limb.tip for limb in self.limbs))
        return f"{self.base} to {' and '.join(', '.join(ends).rsplit(', ', 1))}"

    def place_in_words(self, place: str) -> str:
        """A joint with the limb that it is of, in words: ``j3 (limb to left_hand)``; of a robot of one limb its name alone."""
        limbs = self.limbs_of(place) if self.others else ()
        if not limbs:
            return place
        return f"{place} (limb to {limbs[0]})" if len(limbs) == 1 else f"{place} (below {' and '.join(limbs)})"

    @cached_property
    def tree(self) -> pin.Model:
        """The whole URDF as Pinocchio reads it, every mimic joint free."""
        return _pinocchio(self.urdf, self.path)

    @cached_property
    def mass_beyond(self) -> np.ndarray:
        """Mass carried by each joint of the chain, [kg], shape (joints,)."""
        model = self.tree
        return np.array([sum(model.inertias[k].mass for k in model.subtrees[model.getJointId(n)]) for n in self.names])


def driven(drive: Drive, readings: np.ndarray, column: Mapping[str, int]) -> np.ndarray | float:
    """Positions of a joint, shape (N,); one number where it follows nothing.

    Args:
        drive: What moves it.
        readings: Shape (N, columns), [rad] or [m].
        column: Where each master's readings are.
    """
    position: np.ndarray | float = 0.0
    for name, factor in drive.factors.items():
        position = position + factor * readings[..., column[name]]
    return position + drive.offset


def load_robot(
    path: str | Path,
    tip: str,
    base: str | None = None,
    limit: Limit = URDF,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
    stated: StatedJoints = NO_STATEMENTS,
) -> Robot:
    """Read the chain base -> tip of a URDF file.

    Args:
        path: URDF file, any encoding that its XML declaration states, or a xacro file, or MJCF.
        tip: Link at the end of the chain.
        base: Link at its start; default: the root link.
        limit: How large the file may be.
        packages: Where packages of ROS are that are not found otherwise.
        arguments: Values of the xacro file's arguments.
        stated: What the user says of joints that have no column.

    Raises:
        RobotError: the file cannot be read, is hostile (DTD, entities), or has no such serial chain or no such joints.
    """
    try:
        urdf = read_urdf(Path(path), limit, packages, arguments)
    except RobotError as error:
        raise RobotError(f"{error}. Check `robot.urdf`.") from None
    return parse_robot(urdf, tip, base, plain_name(Path(path)), packages, stated)


def parse_robot(
    urdf: bytes,
    tip: str,
    base: str | None = None,
    path: Path = Path("robot.urdf"),
    packages: Mapping[str, Path] | None = None,
    stated: StatedJoints = NO_STATEMENTS,
) -> Robot:
    """Read the chain base -> tip from a URDF's bytes, or a MJCF's; see :func:`load_robot`."""
    mjcf = urdf if is_mjcf(urdf) else None
    robot = chain(read_tree(as_urdf(urdf, path), path, stated), tip, base)
    return replace(robot, packages=packages or {}, stated=stated, mjcf=mjcf)


def chain_in_urdf(robot: Robot, urdf: bytes) -> Robot:
    """A robot's chain in another URDF of it, the one with corrected origins."""
    other = parse_robot(urdf, robot.tip, robot.base, robot.path, robot.packages, robot.stated)
    return with_limbs(other, [limb.tip for limb in robot.others]) if robot.others else other


class Route(NamedTuple):
    """Which path rows take: from what carries the instrument to what carries the target.

    Attributes:
        start: A link; None for the world, which is where ``world_base`` has it on the base.
        end: A link; None for the robot's tip.
    """

    start: str | None = None
    end: str | None = None


def with_limbs(robot: Robot, links: Sequence[str]) -> Robot:
    """The same robot with the joints between its base and further links, each once.

    Raises:
        RobotError: a link is not there.
    """
    others = [robot.between(None, link) for link in dict.fromkeys(links) if link not in (robot.tip, robot.base)]
    every = (robot.main, *others)
    joints = {joint.name: joint for limb in reversed(every) for joint in limb.joints}
    order = dict.fromkeys(joint.name for limb in every for joint in limb.joints)
    columns = {column.name: column for limb in every for column in limb.columns}
    return replace(
        robot.main,
        joints=tuple(joints[name] for name in order),
        columns=tuple(columns.values()),
        others=tuple(others),
    )


def check_route(robot: Robot, route: Route) -> None:
    """Make sure that a joint moves between the two ends of a path.

    Raises:
        RobotError: none does.
    """
    if not robot.between(*route).joints:
        raise RobotError(
            f"{robot.path}: no joint moves between {route.start or robot.base!r} and {route.end or robot.tip!r}"
        )


def chain(tree: UrdfTree, tip: str, base: str | None = None, still: bool = False) -> Robot:
    """The path base -> tip through a tree, on which a joint must move unless it may stand still.

    Raises:
        RobotError: a link is not there, or something else than serial joints is on the path.
    """
    path = tree.path
    for link, key in ((tip, "tip"), (base, "base")):
        if link is not None and link not in tree.links:
            raise RobotError(f"{path}: no link {shortened(link)!r}{nearest(link, tree.links)}. Check `robot.{key}`.")

    start = base if base is not None else _root(tree, tip)
    up, down = _ways_to_the_root(tree, start), _ways_to_the_root(tree, tip)
    while up and down and up[-1] is down[-1]:
        del up[-1], down[-1]

    joints: list[Joint] = []
    before, name, origin = pin.SE3.Identity(), None, pin.SE3.Identity()
    fixed: list[list[FixedJoint]] = [[]]
    for element, climbs in (*((e, True) for e in up), *((e, False) for e in reversed(down))):
        kind, joint = element.get("type", ""), str(element.get("name"))
        placement = tree.origins[joint]
        if joint in tree.moves:
            joints.append(_joint(joint, before * origin, tree, climbs))
            before, name, origin = pin.SE3.Identity(), None, pin.SE3.Identity()
            fixed.append([])
        elif kind == "fixed" and climbs:
            before = before * placement.inverse()
            fixed[-1].append(FixedJoint(joint, placement, True))
        elif kind == "fixed":
            before, name, origin = before * origin, joint, placement
            fixed[-1].append(FixedJoint(joint, placement, False))
        else:
            raise RobotError(
                f"{path}: joint {joint!r} on the chain is {shortened(kind)!r}: only serial chains of "
                "revolute, continuous, prismatic and fixed joints can be calibrated. Make it one of these, or choose another "
                "`robot.tip`"
            )
    if not joints and not still:
        raise RobotError(
            f"{path}: no joint moves between {start!r} and {tip!r}: nothing to calibrate; set `robot.tip` to the arm's "
            "other end"
        )
    columns = _columns(joints, tree)
    if not columns and not still:
        raise RobotError(
            f"{path}: all joints between {start!r} and {tip!r} stand still by `robot.joints`: nothing to calibrate. Delete "
            "those there that move"
        )
    return Robot(
        tree.urdf, path, start, tip, tuple(joints), columns, name, before, origin, tree.moves, tree.mimics,
        fixed=tuple(map(tuple, fixed)),
    )  # fmt: skip


def _ways_to_the_root(tree: UrdfTree, link: str) -> list[etree._Element]:
    """The joints between a link and the tree's root, upwards."""
    joints = []
    while link in tree.parent_of:
        link, element = tree.parent_of[link]
        joints.append(element)
    return joints


def _root(tree: UrdfTree, link: str) -> str:
    """The link from which all others hang."""
    while link in tree.parent_of:
        link = tree.parent_of[link][0]
    return link


def _pinocchio(urdf: bytes, path: Path) -> pin.Model:
    root = parse_xml(urdf, path)
    for part in (*root.findall("link/visual"), *root.findall("link/collision"), *root.findall("material")):
        part.getparent().remove(part)  # type: ignore[union-attr]  # looks: Pinocchio would only complain of wrong ones
    text = etree.tostring(root, encoding="unicode")
    try:
        return pin.buildModelFromXML(text)
    except (ValueError, RuntimeError, IndexError) as error:
        raise RobotError(f"{path}: Pinocchio cannot read this URDF: {error}. Mend the URDF") from None


def _joint(name: str, before: pin.SE3, tree: UrdfTree, climbs: bool) -> Joint:
    axis, kind = tree.moves[name]
    drive = tree.mimics.get(name, Drive({name: 1.0}))
    for master in drive.factors:
        if master not in tree.moves:
            raise RobotError(f"{tree.path}: joint {name!r} mimics {master!r}, which does not move: check `<mimic>`")
    return Joint(name, kind, axis, before, tree.origins[name], drive, climbs)


def _columns(joints: Sequence[Joint], tree: UrdfTree) -> tuple[ReadingColumn, ...]:
    """The columns that move joints, each once."""
    columns: dict[str, ReadingColumn] = {}
    for joint in joints:
        mimics_one = len(joint.drive.factors) == 1 and tree.joints[joint.name].find("mimic") is not None
        for name in joint.drive.factors:
            if name not in columns:
                columns[name] = _column(name, joint.kind if mimics_one else tree.moves[name][1], tree)
    return tuple(columns.values())


def _column(name: str, kind: Literal["revolute", "prismatic"], tree: UrdfTree) -> ReadingColumn:
    """Readings of a joint, with its limits."""
    joint, path = tree.joints[name], tree.path
    lower, upper = -np.inf, np.inf
    limit = joint.find("limit")
    continuous = joint.get("type") == "continuous"
    if limit is not None and not continuous and (limit.get("lower") or limit.get("upper")):
        lower = float(numbers(limit, "lower", "0", 1, path, np.finfo(float).max)[0])
        upper = float(numbers(limit, "upper", "0", 1, path, np.finfo(float).max)[0])
        if lower > upper:
            raise RobotError(
                f"{path}: joint {name!r}: its lower limit {lower:g} is above its upper limit {upper:g}: exchange them"
            )
        # Some programs write 1e16, or the largest number that there is, for a joint without limits.
        lower, upper = (lower if lower > -LARGEST_IN_URDF else -np.inf), (upper if upper < LARGEST_IN_URDF else np.inf)
    return ReadingColumn(name, "continuous" if continuous else kind, lower, upper)
