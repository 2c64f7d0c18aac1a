r"""MJCF, MuJoCo's format, as a tree of links and joints: bodies are links, sites are links that hang from them rigidly.

What MuJoCo makes of a body with a joint: with B its `pos` and orientation in its parent, A the joint's anchor `pos`, M its
motion and r its `ref`, the body stands at

.. math:: B \\, A \\, M(q - r) \\, A^{-1}

so the joint's own origin is :math:`B A M(-r)`, and the body hangs from it by :math:`A^{-1}`. Whatever is not understood and could
move a body is refused by its name; shapes, actuators and sensors move none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.engine.robot.splice import rpy_near
from aridcal.engine.robot.tree import numbers
from aridcal.system.errors import RobotError, shortened
from aridcal.system.wording import plural

WORLD = "world"
"""MuJoCo's name for its root."""

TURNS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
"""Attributes of an orientation, of which an element may have one."""

AXES = {"x": np.array([1.0, 0.0, 0.0]), "y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}

PASSED = frozenset({"geom", "camera", "light", "plugin"})
"""Of a body: moves nothing."""

SECTIONS = frozenset(
    [
        "actuator",
        "asset",
        "contact",
        "custom",
        "deformable",
        "extension",
        "keyframe",
        "option",
        "sensor",
        "size",
        "statistic",
        "tendon",
        "visual",
    ]
)
"""Of the file: move no body by themselves."""

FAR = 1e3
"""[m]: a limit for what slides and has none, since a URDF must state one; no robot reaches it."""

INCLUDED = (
    "what it brings may move joints: name the file of the arm itself, or let MuJoCo save all as one (mj_saveLastXML)"
)
"""What is said of `<include>`."""

LEAST_AXIS = 1e-9
"""Length of an axis below which it has no direction, as in URDFs."""


@dataclass(frozen=True)
class Owner:
    """Which element of the MJCF holds a joint's origin.

    Attributes:
        element: Its number among all elements of the file, in the order of the text.
        tag: ``body`` or ``site``.
        beyond: From the element's own frame to the joint's origin.
    """

    element: int
    tag: str
    beyond: pin.SE3


@dataclass(frozen=True)
class Compiled:
    """A MJCF as URDF.

    Attributes:
        urdf: The links and joints.
        owners: By joint, what holds its origin; joints that no element holds alone are absent.
        bound: By ``joint``, ``body`` or ``site`` and its name, the ``<equality>`` that ties it to others.
        remarks: What the URDF does not hold, in words.
    """

    urdf: bytes
    owners: Mapping[str, Owner]
    bound: Mapping[tuple[str, str], str]
    remarks: tuple[str, ...]


def is_mjcf(content: bytes) -> bool:
    """Tell whether a description's top element is ``<mujoco>``."""
    if b"<mujoco" not in content.replace(b"\0", b""):
        return False
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, recover=True)
    try:
        root = etree.fromstring(content, parser)
    except (etree.XMLSyntaxError, ValueError):
        return False  # whoever reads it as XML says what is wrong
    return root is not None and root.tag == "mujoco"


def as_urdf(content: bytes, path: Path) -> bytes:
    """A description as URDF: what a MJCF says, or the bytes themselves."""
    return compiled(content, path).urdf if is_mjcf(content) else content


def compiled(mjcf: bytes, path: Path) -> Compiled:
    """Read a MJCF as a URDF.

    Args:
        mjcf: The file's bytes.
        path: Whence it came, for messages.

    Raises:
        RobotError: it is not well-formed, is hostile, or holds what is not understood.
    """
    return _Reader(mjcf, path).compiled()


@dataclass
class _Settings:
    """What ``<compiler>`` says of angles."""

    degrees: bool = True
    sequence: str = "xyz"
    automatic: bool = True


@dataclass
class _Reader:
    """One file, read from its top to its end."""

    mjcf: bytes
    path: Path
    owners: dict[str, Owner] = field(default_factory=dict)
    bound: dict[tuple[str, str], str] = field(default_factory=dict)
    names: dict[str, None] = field(default_factory=dict)
    joints: dict[str, None] = field(default_factory=dict)
    weightless: int = 0
    shapes: int = 0

    def compiled(self) -> Compiled:
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
        try:
            root = etree.fromstring(self.mjcf, parser)
        except (etree.XMLSyntaxError, ValueError) as error:
            raise RobotError(f"{self.path}: not well-formed XML: {' '.join(str(error).split())}. Mend it") from None
        if root.getroottree().docinfo.doctype:  # type: ignore[union-attr]
            raise RobotError(f"{self.path}: has a DOCTYPE: DTDs and entities are refused. Remove it")
        if b"\0" in self.mjcf:
            raise RobotError(f"{self.path}: is in UTF-16, which MuJoCo does not read: save it as UTF-8")
        elements = (element for element in root.iter() if isinstance(element.tag, str))
        self._number = {element: k for k, element in enumerate(elements)}
        self._settings = self._compiler(root)
        self._defaults = self._classes(root)
        self._robot = etree.Element("robot", name=root.get("model") or self.path.stem)
        bodies = (body for world in root.iterfind("worldbody") for body in world.iter("body"))
        self._names_of = {body: self._claim(body, "body") for body in bodies}
        etree.SubElement(self._robot, "link", name=WORLD)
        for section in root:
            if section.tag == "worldbody":
                self._children(section, WORLD, "")
            elif section.tag == "equality":
                self._equality(section)
            elif isinstance(section.tag, str) and section.tag not in {"compiler", "default", *SECTIONS}:
                raise self._refused(section, INCLUDED if section.tag == "include" else "")
        etree.indent(self._robot)
        remarks = []
        if self.shapes:
            remarks.append("its shapes are not in the URDFs nor in scene.html; calibrated.xml has them")
        if self.weightless:
            remarks.append(
                f"{plural(self.weightless, 'link')} without <inertial> count as weightless: say their weight where effects "
                "of gravity matter"
            )  # fmt: skip
        return Compiled(etree.tostring(self._robot, encoding="utf-8"), self.owners, self.bound, tuple(remarks))

    def _compiler(self, root: etree._Element) -> _Settings:
        settings = _Settings()
        for element in root.iterfind("compiler"):
            settings.degrees = element.get("angle", "degree" if settings.degrees else "radian") == "degree"
            settings.sequence = element.get("eulerseq", settings.sequence)
            settings.automatic = element.get("autolimits", str(settings.automatic).lower()) == "true"
            if element.get("coordinate", "local") != "local":
                raise self._refused(element, "`coordinate` should be local: let MuJoCo save the file anew")
            if len(settings.sequence) != 3 or settings.sequence.strip("xyzXYZ"):
                raise self._refused(element, "`eulerseq` should be three of x, y, z, X, Y, Z")
        return settings

    def _classes(self, root: etree._Element) -> dict[str, dict[str, dict[str, str]]]:
        """Attributes by class and tag; a class has those of the one around it, too."""
        classes: dict[str, dict[str, dict[str, str]]] = {"main": {}}

        def read(element: etree._Element, around: dict[str, dict[str, str]], first: bool) -> None:
            name = element.get("class", "main" if first else "")
            own = {tag: dict(values) for tag, values in (classes.get(name) or around).items()}
            for child in element:
                if isinstance(child.tag, str) and child.tag != "default":
                    own[str(child.tag)] = {**own.get(str(child.tag), {}), **_attributes(child)}
            classes[name] = own
            if first and name != "main":
                classes["main"] = own
            for child in element.iterfind("default"):
                read(child, own, False)

        for element in root.iterfind("default"):
            read(element, {}, True)
        return classes

    def _with_defaults(self, element: etree._Element, around: str) -> etree._Element:
        """A copy of an element with its class's attributes where it has none of its own."""
        name = element.get("class") or around or "main"
        if name not in self._defaults:
            raise self._refused(element, f"no <default> has the class {shortened(name)!r}")
        own = _attributes(element)
        usual = dict(self._defaults[name].get(str(element.tag), {}))
        if any(key in own for key in TURNS):
            usual = {key: value for key, value in usual.items() if key not in TURNS}
        copy = etree.Element(str(element.tag), {**usual, **own})
        copy.sourceline = element.sourceline
        return copy

    def _children(self, body: etree._Element, link: str, around: str) -> None:
        """What hangs from a body."""
        for child in body:
            if child.tag == "body":
                self._body(child, link, child.get("childclass") or around)
            elif child.tag == "site":
                self._site(child, link, around)
            elif child.tag in PASSED:
                self.shapes += child.tag == "geom"
            elif isinstance(child.tag, str) and (child.tag not in {"joint", "freejoint", "inertial"} or link == WORLD):
                raise self._refused(child, "Let MuJoCo save the file as plain bodies (mj_saveLastXML), and name that")

    def _body(self, body: etree._Element, parent: str, around: str) -> None:
        name = self._names_of[body]
        place, here = self._placement(body), parent
        moving = [self._with_defaults(joint, around) for joint in body if joint.tag in ("joint", "freejoint")]
        for k, joint in enumerate(moving):
            kind = "free" if joint.tag == "freejoint" else joint.get("type", "hinge")
            if kind not in ("hinge", "slide"):
                raise self._refused(
                    joint, f"a {kind} joint: only hinge and slide can be calibrated. Make the body fixed"
                )
            anchor = pin.SE3(np.eye(3), numbers(joint, "pos", "0 0 0", 3, self.path))
            axis, beyond = self._axis(joint), anchor
            ref = float(numbers(joint, "ref", "0", 1, self.path)[0]) * (self._angle if kind == "hinge" else 1.0)
            if ref:
                turn = (
                    pin.SE3(pin.exp3(-ref * axis), np.zeros(3)) if kind == "hinge" else pin.SE3(np.eye(3), -ref * axis)
                )
                beyond = anchor * turn
            last = k == len(moving) - 1 and not anchor.translation.any()
            child = name if last else self._unique(f"{name}_{k + 1}")
            own = self._joint_name(joint, f"{name}_joint_{k + 1}")
            if not last:
                etree.SubElement(self._robot, "link", name=child)
            self._joint(own, kind, here, child, place * beyond, axis, self._limits(joint, kind))
            if k == 0:
                self.owners[own] = Owner(self._number[body], "body", beyond)
            here, place = child, anchor.inverse()
        link = etree.SubElement(self._robot, "link", name=name)
        self._weight(link, body)
        if here != name:
            joint_name = self._joint_name(None, f"{name}_fixed")
            self._joint(joint_name, "fixed", here, name, place)
            if not moving:
                self.owners[joint_name] = Owner(self._number[body], "body", pin.SE3.Identity())
        self._children(body, name, around)

    def _site(self, site: etree._Element, parent: str, around: str) -> None:
        if not site.get("name"):
            return
        name = self._claim(site, "site")
        placement = self._placement(self._with_defaults(site, around))
        etree.SubElement(self._robot, "link", name=name)
        joint = self._joint_name(None, f"{name}_fixed")
        self._joint(joint, "fixed", parent, name, placement)
        self.owners[joint] = Owner(self._number[site], "site", pin.SE3.Identity())

    def _joint(
        self,
        name: str,
        kind: str,
        parent: str,
        child: str,
        origin: pin.SE3,
        axis: np.ndarray | None = None,
        limits: tuple[float, float] | None = None,
    ) -> None:
        of_urdf = {"hinge": "revolute" if limits else "continuous", "slide": "prismatic", "fixed": "fixed"}[kind]
        joint = etree.SubElement(self._robot, "joint", name=name, type=of_urdf)
        rpy = rpy_near(origin.rotation, np.zeros(3))
        etree.SubElement(joint, "origin", xyz=_text(origin.translation), rpy=_text(rpy))
        etree.SubElement(joint, "parent", link=parent)
        etree.SubElement(joint, "child", link=child)
        if axis is None:
            return
        etree.SubElement(joint, "axis", xyz=_text(axis))
        if limits or kind == "slide":
            low, high = limits or (-FAR, FAR)
            etree.SubElement(joint, "limit", lower=repr(low), upper=repr(high), effort="0", velocity="0")

    def _limits(self, joint: etree._Element, kind: str) -> tuple[float, float] | None:
        stated = joint.get("limited", "auto")
        limited = joint.get("range") is not None and self._settings.automatic if stated == "auto" else stated == "true"
        if not limited:
            return None
        low, high = numbers(joint, "range", "0 0", 2, self.path) * (self._angle if kind == "hinge" else 1.0)
        return float(low), float(high)

    def _axis(self, joint: etree._Element) -> np.ndarray:
        axis = numbers(joint, "axis", "0 0 1", 3, self.path)
        length = float(np.linalg.norm(axis))
        if length < LEAST_AXIS:
            raise self._refused(joint, "its axis is zero: say about or along what it moves")
        return axis / length

    def _weight(self, link: etree._Element, body: etree._Element) -> None:
        inertial = body.find("inertial")
        if inertial is None:
            self.weightless += body.find("geom") is not None
            return
        mass = numbers(inertial, "mass", "0", 1, self.path)[0]
        if inertial.get("fullinertia") is not None:
            xx, yy, zz, xy, xz, yz = numbers(inertial, "fullinertia", "", 6, self.path)
        else:
            (xx, yy, zz), xy, xz, yz = numbers(inertial, "diaginertia", "0 0 0", 3, self.path), 0.0, 0.0, 0.0
        place = self._placement(inertial)
        element = etree.SubElement(link, "inertial")
        rpy = rpy_near(place.rotation, np.zeros(3))
        etree.SubElement(element, "origin", xyz=_text(place.translation), rpy=_text(rpy))
        etree.SubElement(element, "mass", value=repr(float(mass)))
        values = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
        etree.SubElement(element, "inertia", {key: repr(float(value)) for key, value in values.items()})

    def _placement(self, element: etree._Element) -> pin.SE3:
        return pin.SE3(self._rotation(element), numbers(element, "pos", "0 0 0", 3, self.path))

    def _rotation(self, element: etree._Element) -> np.ndarray:
        stated = [key for key in TURNS if element.get(key) is not None]
        if len(stated) > 1:
            raise self._refused(element, f"has {' and '.join(stated)}: keep one")
        if not stated:
            return np.eye(3)
        (key,) = stated
        values = numbers(element, key, "", {"quat": 4, "axisangle": 4, "xyaxes": 6}.get(key, 3), self.path)
        if key == "euler":
            R = np.eye(3)
            for letter, angle in zip(self._settings.sequence, values * self._angle, strict=True):
                turn = pin.exp3(AXES[letter.lower()] * angle)
                R = R @ turn if letter.islower() else turn @ R
            return R
        if key == "quat":
            w, x, y, z = self._unit(element, values)
            return pin.Quaternion(w, x, y, z).matrix()
        if key == "axisangle":
            return np.asarray(pin.exp3(self._unit(element, values[:3]) * values[3] * self._angle))
        if key == "zaxis":
            z_axis = self._unit(element, values)
            across = np.cross(AXES["z"], z_axis)
            sine = float(np.linalg.norm(across))
            turn = math.atan2(sine, z_axis[2])
            return np.asarray(pin.exp3((across / sine if sine > LEAST_AXIS else AXES["x"]) * turn))
        x_axis = self._unit(element, values[:3])
        y_axis = self._unit(element, values[3:] - x_axis * (x_axis @ values[3:]))
        return np.column_stack([x_axis, y_axis, np.cross(x_axis, y_axis)])

    def _unit(self, element: etree._Element, vector: np.ndarray) -> np.ndarray:
        length = float(np.linalg.norm(vector))
        if length < LEAST_AXIS:
            raise self._refused(element, "its orientation has no length")
        return vector / length

    @property
    def _angle(self) -> float:
        return math.pi / 180.0 if self._settings.degrees else 1.0

    def _equality(self, section: etree._Element) -> None:
        """Note what ties bodies and joints together: it counts where they are on the chain."""
        for element in section:
            if not isinstance(element.tag, str) or element.get("active") == "false":
                continue
            for key in ("joint1", "joint2", "body1", "body2", "site1", "site2"):
                if name := element.get(key):
                    self.bound[key[:-1], name] = f"line {element.sourceline}: <{element.tag}>"

    def _claim(self, element: etree._Element, tag: str) -> str:
        """The name of a link for a body or a site; a site that is named as a body is called so."""
        name = element.get("name") or f"{tag}_{self._number[element]}"
        if tag == "body" and element.get("name") and name in (WORLD, *self.names):
            raise self._refused(element, f"the name {shortened(name)!r} is there already")
        return self._unique(name if name not in (WORLD, *self.names) else f"{name}_{tag}")

    def _unique(self, name: str) -> str:
        while name in self.names or name == WORLD:
            name += "_"
        self.names[name] = None
        return name

    def _joint_name(self, joint: etree._Element | None, usual: str) -> str:
        stated = None if joint is None else joint.get("name")
        name = stated or usual
        while name in self.joints and stated is None:
            name += "_"
        if joint is not None and name in self.joints:
            raise self._refused(joint, f"the name {shortened(name)!r} is there already")
        self.joints[name] = None
        return name

    def _refused(self, element: etree._Element, why: str) -> RobotError:
        name = element.get("name")
        called = f" {shortened(name)!r}" if name else ""
        return RobotError(
            f"{self.path}: line {element.sourceline}: <{element.tag}>{called} of MJCF: {why or 'is not understood'}"
        )


def _attributes(element: etree._Element) -> dict[str, str]:
    return {str(key): str(value) for key, value in element.attrib.items()}


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0
