"""A URDF as a tree of links: read as the hostile text that it may be, checked once, every look-up by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.engine.robot.drive import NO_STATEMENTS, Drive, Loop, StatedJoints, resolved
from aridcal.system.errors import RobotError, nearest, shortened
from aridcal.system.reading.user_names import check_name

MOVING: dict[str, Literal["revolute", "prismatic"]] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
}

MAX_DEPTH = 200
"""Joints in a row: Pinocchio and its parser call themselves for each. 4,000 use up 8 MB of stack, 250 a thread's 512 kB."""

MAX_MOVING = 150
"""Moving joints: Pinocchio's workspace holds second derivatives, 48 n³ bytes: 0.2 GB of 150, 8 GB of 500."""

MAX_LINKS = 10_000
"""Pinocchio compares the name of each link with all others: 0.7 s of 10,000."""

LARGEST_IN_URDF = 1e9
"""No length, angle, mass or inertia is larger; its square and products still are numbers."""


OTHER_FORMATS = {
    "sdf": "SDF, Gazebo's format, which aridcal does not read. Name the URDF that the model was made from; if there is none, "
    "`sdf2urdf` of sdformat_tools makes one: compare its poses with Gazebo's before you use it",
}
"""Top elements of other descriptions of robots, what they are, and the way out."""


@dataclass(frozen=True)
class UrdfTree:
    """The links of a URDF, one tree, and the joints between them.

    Attributes:
        urdf: The file's own bytes.
        path: Where they came from.
        links: Names, in the order of the file; a dict, whose look-ups are quick.
        joints: Elements by their names, in the order of the file.
        parent_of: The parent of each link but the root, and the joint between them.
        origins: Own ``<origin>`` of each joint.
        moves: Unit axis and kind of each moving joint.
        mimics: What moves every joint that follows others or stands still, resolved to the last masters.
    """

    urdf: bytes
    path: Path
    links: Mapping[str, None]
    joints: Mapping[str, etree._Element]
    parent_of: Mapping[str, tuple[str, etree._Element]]
    origins: Mapping[str, pin.SE3]
    moves: Mapping[str, tuple[np.ndarray, Literal["revolute", "prismatic"]]]
    mimics: Mapping[str, Drive]


def read_tree(urdf: bytes, path: Path, stated: StatedJoints = NO_STATEMENTS) -> UrdfTree:
    """Read and check the tree of a URDF.

    Args:
        urdf: XML in any encoding that its declaration states.
        path: Whence it came, for messages.
        stated: What the user says of joints that have no column.

    Raises:
        RobotError: it is no URDF, is hostile (DTD, entities), is no tree, or deeper or larger than what can be computed;
            or it has no such joints as are stated.
    """
    root = parse_xml(urdf, path)
    links = _link_names(root, path)
    joints = _joint_elements(root, path)
    for inertial in root.iterfind("link/inertial"):
        for element in inertial.iter("mass", "inertia"):
            for key in element.keys():  # noqa: SIM118
                numbers(element, str(key), "", 1, path)
        for origin in inertial.iter("origin"):
            placement_of(origin, path)
    for origin in (*root.iterfind("joint/origin"), *root.iterfind("link/inertial/origin")):
        if origin.get("quat_xyzw") is not None:  # Pinocchio and yourdfpy pass over it, and see no rotation at all
            raise RobotError(
                f"{path}: line {origin.sourceline}: <origin> has quat_xyzw, which few parsers read: write the rotation as rpy"
            )
    parent_of = _parents(joints, links, path)
    origins = {name: _origin(element, path) for name, element in joints.items()}
    kinds = {name: element.get("type", "") for name, element in joints.items()}
    moves = {name: (_axis(joints[name], path), MOVING[kind]) for name, kind in kinds.items() if kind in MOVING}
    mimics = _mimics(joints, path)
    stated.check(joints, moves, mimics, str(path))
    return UrdfTree(
        urdf, path, links, joints, parent_of, origins, moves, _followed(mimics | stated.drives, stated, path)
    )


def parse_xml(urdf: bytes, path: Path) -> etree._Element:
    """The ``<robot>`` of a URDF; entities are never resolved, and nothing is fetched.

    Raises:
        RobotError: it is not well-formed, has a DOCTYPE, or is no robot.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, remove_comments=True)
    try:
        root = etree.fromstring(urdf, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        reason = " ".join(str(getattr(error, "msg", None) or error).split())
        raise RobotError(f"{path}: not well-formed XML: {reason}. Mend the URDF, or name another one.") from None
    if root.getroottree().docinfo.doctype:  # type: ignore[union-attr]
        raise RobotError(f"{path}: has a DOCTYPE: DTDs and entities are refused. Remove it from the URDF.")
    if (description := OTHER_FORMATS.get(str(root.tag))) is not None:
        raise RobotError(f"{path}: is {description}")
    if root.tag != "robot":
        raise RobotError(f"{path}: the top element is <{shortened(str(root.tag))}>, not <robot>. Name a URDF")
    if any("xacro" in str(element.tag) for element in root):
        raise RobotError(f"{path}: holds xacro macros: run xacro first")
    check_name(root.get("name", ""), f"{path}: line {root.sourceline}: the robot", RobotError)
    return root


def numbers(
    element: etree._Element, key: str, default: str, count: int, path: Path, most: float = LARGEST_IN_URDF
) -> np.ndarray:
    """Numbers of an attribute, shape (count,).

    Raises:
        RobotError: there are not so many, or one is not finite or larger than ``most``.
    """
    text = element.get(key, default)
    try:
        values = np.array([float(v) for v in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if len(values) != count or not (np.abs(values) <= most).all():
        plural, largest = ("s" if count > 1 else ""), (f", none beyond {most:g}," if most < np.inf else "")
        raise RobotError(
            f"{path}: line {element.sourceline}: <{element.tag} {key}={shortened(text)!r}>: "
            f"{count} finite number{plural}{largest} expected"
        )
    return values


def _joint_elements(root: etree._Element, path: Path) -> dict[str, etree._Element]:
    elements = _by_name(root, "joint", path)
    moving = sum(element.get("type") in MOVING for element in elements.values())
    if moving > MAX_MOVING:
        raise RobotError(
            f"{path}: {moving:,} joints move, at most {MAX_MOVING} can be computed. Make those off the chain `fixed`"
        )
    return elements


def _link_names(root: etree._Element, path: Path) -> dict[str, None]:
    """Names of all links, as the keys of a dict."""
    names = dict.fromkeys(_by_name(root, "link", path))
    if len(names) > MAX_LINKS:
        raise RobotError(
            f"{path}: has {len(names):,} links, at most {MAX_LINKS:,} can be computed. Delete those off the chain"
        )
    return names


def _by_name(root: etree._Element, tag: str, path: Path) -> dict[str, etree._Element]:
    """Elements of a kind by their names, in the order of the file, each there once."""
    elements: dict[str, etree._Element] = {}
    for element in root.findall(tag):
        name, where = element.get("name", ""), f"{path}: line {element.sourceline}"
        if not name:
            raise RobotError(f"{where}: a {tag} has no name: give it one")
        check_name(name, f"{where}: a {tag}", RobotError)
        if name in elements:
            raise RobotError(f"{where}: {tag} {name!r} is there twice: rename or delete one")
        elements[name] = element
    return elements


def _parents(
    joints: Mapping[str, etree._Element], links: Mapping[str, None], path: Path
) -> dict[str, tuple[str, etree._Element]]:
    """The parent of each link and the joint between them; the links are one tree, and none too deep in it.

    Raises:
        RobotError: naming what has two parents, a loop, two roots, or too many joints above it.
    """
    parent_of: dict[str, tuple[str, etree._Element]] = {}
    for name, element in joints.items():
        child, parent = _link(element, "child", links, path), _link(element, "parent", links, path)
        if child in parent_of:
            first, joint = parent_of[child]
            raise RobotError(
                f"{path}: link {child!r} has two parents: {first!r} by joint {joint.get('name')!r} and {parent!r} by joint "
                f"{name!r}: a URDF is a tree; delete one of these joints"
            )
        parent_of[child] = (parent, element)
    depth: dict[str, int] = {}
    for link in links:
        above: dict[str, None] = {}
        while link in parent_of and link not in depth and link not in above:
            above[link] = None
            link = parent_of[link][0]
        if link in above:
            raise _loop(link, parent_of, path)
        start = depth.setdefault(link, 0)
        depth.update((each, start + k) for k, each in enumerate(reversed(above), start=1))
    roots = [link for link in links if link not in parent_of]
    if len(roots) > 1:
        names = ", ".join(map(repr, roots[:10])) + (" …" if len(roots) > 10 else "")
        raise RobotError(f"{path}: the links {names} have no parent: a URDF has one root; join them by fixed joints")
    deepest = max(depth, key=lambda link: depth[link], default="")
    if depth.get(deepest, 0) > MAX_DEPTH:
        raise RobotError(
            f"{path}: link {deepest!r} is {depth[deepest]:,} joints from the root, at most {MAX_DEPTH} can be computed. "
            "Merge links that are rigid with each other"
        )
    return parent_of


def _loop(link: str, parent_of: Mapping[str, tuple[str, etree._Element]], path: Path) -> RobotError:
    """The error for a link that is its own ancestor."""
    loop = [link]
    while (parent := parent_of[loop[-1]][0]) != link:
        loop.append(parent)
    names = ", ".join(repr(parent_of[each][1].get("name")) for each in loop[:10])
    return RobotError(
        f"{path}: the links {', '.join(map(repr, loop[:10]))} form a loop: a URDF is a tree; delete or turn round one of "
        f"the joints {names}"
    )


def _link(element: etree._Element, role: str, links: Mapping[str, None], path: Path) -> str:
    child = element.find(role)
    name = "" if child is None else child.get("link", "")
    if name not in links:
        raise RobotError(
            f"{path}: joint {element.get('name')!r}: its {role} link {shortened(name)!r} is not in the file{nearest(name, links)}"
        )
    return name


def _origin(element: etree._Element, path: Path) -> pin.SE3:
    origin = element.find("origin")
    return pin.SE3.Identity() if origin is None else placement_of(origin, path)


def placement_of(origin: etree._Element, path: Path) -> pin.SE3:
    """What an ``<origin>`` says."""
    rpy = numbers(origin, "rpy", "0 0 0", 3, path)
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), numbers(origin, "xyz", "0 0 0", 3, path))


def _axis(element: etree._Element, path: Path) -> np.ndarray:
    child = element.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if child is None else numbers(child, "xyz", "1 0 0", 3, path)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise RobotError(f"{path}: joint {element.get('name')!r}: its axis is zero: say about or along what it moves")
    return axis / length


def _mimics(joints: Mapping[str, etree._Element], path: Path) -> dict[str, Drive]:
    """The drive that each ``<mimic>`` states, its master not yet resolved."""
    direct: dict[str, Drive] = {}
    for name, element in joints.items():
        mimic = element.find("mimic")
        if mimic is not None:
            master = mimic.get("joint", "")
            if master not in joints:
                raise RobotError(
                    f"{path}: joint {name!r} mimics {shortened(master)!r}, which is not in the file{nearest(master, joints)}"
                )
            multiplier = float(numbers(mimic, "multiplier", "1", 1, path)[0])
            direct[name] = Drive({master: multiplier}, float(numbers(mimic, "offset", "0", 1, path)[0]))
    return direct


def _followed(direct: Mapping[str, Drive], stated: StatedJoints, path: Path) -> dict[str, Drive]:
    """The drives of all joints without a column, with the factors and offsets on the way composed.

    Raises:
        RobotError: a joint follows itself, or numbers beyond all measure come out.
    """
    where = "`<mimic>` or an entry of `robot.coupled`" if stated.coupled else "`<mimic>`"
    try:
        drives = resolved(direct)
    except Loop as loop:
        raise RobotError(
            f"{path}: joint {loop.first!r} mimics itself, by way of {loop.by!r}: delete one {where}"
        ) from None
    for name, drive in drives.items():
        if not all(abs(number) <= LARGEST_IN_URDF for number in (*drive.factors.values(), drive.offset)):
            raise RobotError(
                f"{path}: joint {name!r}: what it mimics multiplies beyond {LARGEST_IN_URDF:g}: check {where}"
            )
    return drives
