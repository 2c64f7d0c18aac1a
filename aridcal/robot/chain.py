"""A URDF as a serial chain from base to tip: placements, joint motions, and what gravity does to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.errors import RobotError, nearest

JointKind = Literal["revolute", "prismatic", "continuous"]

MOVING: dict[str, Literal["revolute", "prismatic"]] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
}


@dataclass(frozen=True)
class Joint:
    """A moving joint of the chain.

    Attributes:
        name: As in the URDF.
        kind: Motion about (``revolute``) or along (``prismatic``) the axis.
        axis: Unit vector in the joint frame, shape (3,).
        before: Fixed joints between the previous moving joint (or the base) and this joint's parent link.
        origin: This joint's own ``<origin>``.
        lower: Lower limit of the reading, [rad] or [m]; -inf if there is none.
        upper: Upper limit of the reading.
        continuous: True for a joint that turns without end.
        reading: Column that drives the joint: its own name, or its master's if it mimics one.
        multiplier: Position = multiplier * reading + offset (1 and 0 unless it mimics).
        offset: See ``multiplier``, [rad] or [m].
    """

    name: str
    kind: Literal["revolute", "prismatic"]
    axis: np.ndarray
    before: pin.SE3
    origin: pin.SE3
    lower: float
    upper: float
    continuous: bool
    reading: str
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def placement(self) -> pin.SE3:
        """From the previous moving joint, after its motion, to this joint's frame."""
        return self.before * self.origin


@dataclass(frozen=True)
class Robot:
    """The chain base -> tip of a URDF, and the whole tree as mass.

    ``T_base_tip = prod(joint.placement * motion(q)) * tip_before * tip_origin``.

    Attributes:
        urdf: The file's own bytes.
        path: Where they came from; meshes are found from here.
        base: First link of the chain.
        tip: Last link of the chain.
        joints: Moving joints, base to tip.
        tip_joint: Name of the last fixed joint before the tip; None if a moving joint ends in the tip.
        tip_before: Fixed joints after the last moving joint, up to ``tip_joint``.
        tip_origin: Own ``<origin>`` of ``tip_joint``; identity if there is none.
        moves: Axis and kind of every moving joint of the tree, by name.
        mimics: For every joint that follows another: (master, multiplier, offset), resolved to the last master.
    """

    urdf: bytes
    path: Path
    base: str
    tip: str
    joints: tuple[Joint, ...]
    tip_joint: str | None
    tip_before: pin.SE3
    tip_origin: pin.SE3
    moves: dict[str, tuple[np.ndarray, str]] = field(repr=False)
    mimics: dict[str, tuple[str, float, float]] = field(repr=False)

    @property
    def readings(self) -> tuple[str, ...]:
        """Columns that a measurement needs, each once, in chain order."""
        return tuple(dict.fromkeys(j.reading for j in self.joints))

    @property
    def kinds(self) -> tuple[JointKind, ...]:
        """Kind of each reading column; of columns that drive several joints, that of the first."""
        by_reading: dict[str, JointKind] = {}
        for j in self.joints:
            by_reading.setdefault(j.reading, "continuous" if j.continuous else j.kind)
        return tuple(by_reading[name] for name in self.readings)

    @property
    def limits(self) -> np.ndarray:
        """Lower and upper limit of each reading column, shape (columns, 2), [rad] or [m]; infinite where none is."""
        by_reading: dict[str, tuple[float, float]] = {}
        for j in self.joints:
            by_reading.setdefault(j.reading, (j.lower, j.upper))
        return np.array([by_reading[name] for name in self.readings])

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

    def positions(self, readings: np.ndarray) -> np.ndarray:
        """Joint positions, shape (N, joints), from readings, shape (N, columns): mimics follow their masters."""
        column = {name: k for k, name in enumerate(self.readings)}
        index = [column[j.reading] for j in self.joints]
        multiplier = np.array([j.multiplier for j in self.joints])
        return readings[:, index] * multiplier + np.array([j.offset for j in self.joints])

    @cached_property
    def tree(self) -> pin.Model:
        """The whole URDF as Pinocchio reads it, every mimic joint free."""
        return _tree(self.urdf, self.path)

    @cached_property
    def mass_beyond(self) -> np.ndarray:
        """Mass carried by each joint of the chain, [kg], shape (joints,)."""
        model = self.tree
        return np.array([sum(model.inertias[k].mass for k in model.subtrees[model.getJointId(n)]) for n in self.names])


def load_robot(path: str | Path, tip: str, base: str | None = None) -> Robot:
    """Read the chain base -> tip of a URDF file.

    Args:
        path: URDF file, any encoding that its XML declaration states.
        tip: Link at the end of the chain.
        base: Link at its start; default: the root link.

    Raises:
        RobotError: the file cannot be read, is hostile (DTD, entities), or has no such serial chain.
    """
    path = Path(path)
    try:
        urdf = path.read_bytes()
    except OSError as error:
        raise RobotError(f"{path}: cannot read the URDF: {error.strerror}. Check `robot.urdf`.") from None
    return parse_robot(urdf, tip, base, path)


def parse_robot(urdf: bytes, tip: str, base: str | None = None, path: Path = Path("robot.urdf")) -> Robot:
    """Read the chain base -> tip from a URDF's bytes; see :func:`load_robot`."""
    tree = _parse_xml(urdf, path)
    links = _link_names(tree, path)
    elements = _joint_elements(tree, path)
    for inertial in tree.iterfind("link/inertial"):
        for element in inertial.iter("mass", "inertia"):
            for key in element.keys():  # noqa: SIM118
                _numbers(element, str(key), "", 1, path)
    for origin in (*tree.iterfind("joint/origin"), *tree.iterfind("link/inertial/origin")):
        if origin.get("quat_xyzw") is not None:  # Pinocchio and yourdfpy pass over it, and see no rotation at all
            raise RobotError(
                f"{path}: line {origin.sourceline}: <origin> has quat_xyzw, which few parsers read: write the rotation as rpy"
            )
    parent_of = _parents(elements, links, path)
    if tip not in links:
        raise RobotError(f"{path}: no link {tip!r}{nearest(tip, links)}. Check `robot.tip`.")
    if base is not None and base not in links:
        raise RobotError(f"{path}: no link {base!r}{nearest(base, links)}. Check `robot.base`.")

    chain: list[etree._Element] = []
    link = tip
    while link != base and link in parent_of:
        link, element = parent_of[link]
        chain.insert(0, element)
    if base is not None and link != base:
        raise RobotError(f"{path}: link {tip!r} does not descend from {base!r}: check `robot.base` and `robot.tip`")

    mimics = _mimics(elements, path)
    joints: list[Joint] = []
    before, name, origin = pin.SE3.Identity(), None, pin.SE3.Identity()
    for element in chain:
        kind, own = element.get("type", ""), _origin(element, path)
        if kind in MOVING:
            joints.append(_joint(element, own, before * origin, elements, mimics, path))
            before, name, origin = pin.SE3.Identity(), None, pin.SE3.Identity()
        elif kind == "fixed":
            before, name, origin = before * origin, element.get("name"), own
        else:
            raise RobotError(
                f"{path}: joint {element.get('name')!r} on the chain is {kind!r}: only serial chains of "
                "revolute, continuous, prismatic and fixed joints can be calibrated"
            )
    if not joints:
        raise RobotError(f"{path}: no joint moves between {base or link!r} and {tip!r}: nothing to calibrate")
    moves: dict[str, tuple[np.ndarray, str]] = {
        n: (_axis(e, path), MOVING[e.get("type", "")]) for n, e in elements.items() if e.get("type") in MOVING
    }
    return Robot(urdf, path, link, tip, tuple(joints), name, before, origin, moves, mimics)


def links(urdf: bytes, path: Path = Path("robot.urdf")) -> tuple[str, ...]:
    """All links of a URDF, in the order of the file."""
    return tuple(link.get("name", "") for link in _parse_xml(urdf, path).findall("link"))


def _tree(urdf: bytes, path: Path) -> pin.Model:
    root = _parse_xml(urdf, path)
    for part in (*root.findall("link/visual"), *root.findall("link/collision"), *root.findall("material")):
        part.getparent().remove(part)  # type: ignore[union-attr]  # looks: Pinocchio would only complain of wrong ones
    text = etree.tostring(root, encoding="unicode")
    try:
        return pin.buildModelFromXML(text)
    except (ValueError, RuntimeError, IndexError) as error:
        raise RobotError(f"{path}: Pinocchio cannot read this URDF: {error}") from None


def _parse_xml(urdf: bytes, path: Path) -> etree._Element:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, remove_comments=True)
    try:
        root = etree.fromstring(urdf, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        said = getattr(error, "msg", None) or error
        raise RobotError(f"{path}: not well-formed XML: {said}. Mend the URDF, or name another one.") from None
    if root.getroottree().docinfo.doctype:  # type: ignore[union-attr]
        raise RobotError(f"{path}: has a DOCTYPE: DTDs and entities are refused. Remove it from the URDF.")
    if root.tag != "robot":
        raise RobotError(f"{path}: the top element is <{root.tag}>, not <robot>")
    if any("xacro" in str(element.tag) for element in root):
        raise RobotError(f"{path}: holds xacro macros: run xacro first")
    return root


def _joint_elements(tree: etree._Element, path: Path) -> dict[str, etree._Element]:
    elements: dict[str, etree._Element] = {}
    for element in tree.findall("joint"):
        name = element.get("name")
        if not name:
            raise RobotError(f"{path}: line {element.sourceline}: a joint has no name")
        if name in elements:
            raise RobotError(f"{path}: line {element.sourceline}: joint {name!r} is there twice")
        elements[name] = element
    return elements


def _link_names(tree: etree._Element, path: Path) -> list[str]:
    """Names of all links, each there once."""
    names: list[str] = []
    for element in tree.findall("link"):
        name = element.get("name", "")
        if not name:
            raise RobotError(f"{path}: line {element.sourceline}: a link has no name: give it one")
        if name in names:
            raise RobotError(f"{path}: line {element.sourceline}: link {name!r} is there twice: rename or delete one")
        names.append(name)
    return names


def _parents(
    elements: dict[str, etree._Element], links: list[str], path: Path
) -> dict[str, tuple[str, etree._Element]]:
    """The parent of each link and the joint between them; the links are one tree.

    Raises:
        RobotError: naming what has two parents, a loop, or two roots.
    """
    parent_of: dict[str, tuple[str, etree._Element]] = {}
    for name, element in elements.items():
        child, parent = _link(element, "child", links, path), _link(element, "parent", links, path)
        if child in parent_of:
            other, joint = parent_of[child]
            raise RobotError(
                f"{path}: link {child!r} has two parents: {other!r} by joint {joint.get('name')!r} and {parent!r} by joint "
                f"{name!r}: a URDF is a tree; delete one of these joints"
            )
        parent_of[child] = (parent, element)
    for link in links:
        loop = [link]
        while loop[-1] in parent_of and len(loop) <= len(links):
            loop.append(parent_of[loop[-1]][0])
            if loop[-1] == link:
                joints = ", ".join(repr(parent_of[each][1].get("name")) for each in loop[:-1])
                raise RobotError(
                    f"{path}: the links {', '.join(map(repr, loop[:-1]))} form a loop: a URDF is a tree; delete or turn "
                    f"round one of the joints {joints}"
                )
    roots = [link for link in links if link not in parent_of]
    if len(roots) > 1:
        raise RobotError(
            f"{path}: the links {', '.join(map(repr, roots))} have no parent: a URDF has one root; join them by fixed joints"
        )
    return parent_of


def _link(element: etree._Element, role: str, links: list[str], path: Path) -> str:
    found = element.find(role)
    name = "" if found is None else found.get("link", "")
    if name not in links:
        raise RobotError(f"{path}: joint {element.get('name')!r}: its {role} link {name!r} is not in the file")
    return name


def _numbers(element: etree._Element, key: str, default: str, count: int, path: Path) -> np.ndarray:
    text = element.get(key, default)
    try:
        values = np.array([float(v) for v in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if len(values) != count or not np.isfinite(values).all():
        raise RobotError(
            f"{path}: line {element.sourceline}: <{element.tag} {key}={text!r}>: "
            f"{count} finite number{'s' if count > 1 else ''} expected"
        )
    return values


def _origin(element: etree._Element, path: Path) -> pin.SE3:
    origin = element.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    rpy = _numbers(origin, "rpy", "0 0 0", 3, path)
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), _numbers(origin, "xyz", "0 0 0", 3, path))


def _axis(element: etree._Element, path: Path) -> np.ndarray:
    found = element.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if found is None else _numbers(found, "xyz", "1 0 0", 3, path)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise RobotError(f"{path}: joint {element.get('name')!r}: its axis is zero")
    return axis / length


def _mimics(elements: dict[str, etree._Element], path: Path) -> dict[str, tuple[str, float, float]]:
    """Every mimic joint's last master, with the multipliers and offsets on the way composed."""
    direct: dict[str, tuple[str, float, float]] = {}
    for name, element in elements.items():
        mimic = element.find("mimic")
        if mimic is not None:
            master = mimic.get("joint", "")
            if master not in elements:
                raise RobotError(
                    f"{path}: joint {name!r} mimics {master!r}, which is not in the file" + nearest(master, elements)
                )
            multiplier = float(_numbers(mimic, "multiplier", "1", 1, path)[0])
            direct[name] = (master, multiplier, float(_numbers(mimic, "offset", "0", 1, path)[0]))
    resolved = {}
    for name in direct:
        master, multiplier, offset = direct[name]
        seen = {name}
        while master in direct:
            if master in seen:
                raise RobotError(f"{path}: joint {name!r} mimics itself, by way of {master!r}")
            seen.add(master)
            up, m, o = direct[master]
            master, multiplier, offset = up, multiplier * m, offset + multiplier * o
        resolved[name] = (master, multiplier, offset)
    return resolved


def _joint(
    element: etree._Element,
    origin: pin.SE3,
    before: pin.SE3,
    elements: dict[str, etree._Element],
    mimics: dict[str, tuple[str, float, float]],
    path: Path,
) -> Joint:
    name, kind = str(element.get("name")), element.get("type", "")
    master, multiplier, offset = mimics.get(name, (name, 1.0, 0.0))
    driver = elements[master]
    if driver.get("type") not in MOVING:
        raise RobotError(f"{path}: joint {name!r} mimics {master!r}, which does not move")
    lower, upper = -np.inf, np.inf
    limit = driver.find("limit")
    continuous = driver.get("type") == "continuous"
    if limit is not None and not continuous and (limit.get("lower") or limit.get("upper")):
        lower = float(_numbers(limit, "lower", "0", 1, path)[0])
        upper = float(_numbers(limit, "upper", "0", 1, path)[0])
        if lower > upper:
            raise RobotError(f"{path}: joint {master!r}: its lower limit {lower:g} is above its upper limit {upper:g}")
    return Joint(
        name, MOVING[kind], _axis(element, path), before, origin, lower, upper, continuous, master, multiplier, offset
    )
