"""New joint origins spliced into a MJCF's own bytes: `pos` and orientation of bodies and sites; everything else stays."""

from __future__ import annotations

from collections.abc import Mapping
from xml.parsers import expat

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.mjcf import TURNS, Owner, compiled
from aridcal.engine.robot.read_back import COMPARED_CONFIGURATIONS, READ_BACK_TOLERANCE, link_places
from aridcal.engine.robot.splice import ROTATION_ROUNDING, without_rounding
from aridcal.engine.robot.start_tags import codec_of, with_attribute
from aridcal.engine.robot.tree import read_tree
from aridcal.system.errors import RobotError


def check_written_back(robot: Robot) -> None:
    """Make sure that a MJCF can hold the calibrated origins of a chain.

    Raises:
        RobotError: naming the joint that cannot be calibrated, and why.
    """
    if robot.mjcf is None:
        return
    source = compiled(robot.mjcf, robot.path)
    ends = {limb.tip_joint for limb in robot.limbs if limb.tip_joint}
    for name in (*robot.names, *sorted(ends)):
        if name not in source.owners:
            raise RobotError(
                f"{robot.path}: {name!r}: the `pos` of its body cannot hold its correction: give each joint a body of its own, "
                "and where the last joint has a `pos`, name a site or a body beyond it as `robot.tip`"
            )
    joints = read_tree(robot.urdf, robot.path).joints
    on_chain = {*robot.names, *(fixed.name for limb in robot.limbs for gap in limb.fixed for fixed in gap)}
    links = [child.get("link", "") for name in on_chain for child in joints[name].iterfind("child")]
    kinds = [("joint", name) for name in robot.names] + [(kind, link) for link in links for kind in ("body", "site")]
    for kind, name in kinds:
        if (kind, name) in source.bound:
            raise RobotError(
                f"{robot.path}: {source.bound[kind, name]} ties {name!r} to others, and what is tied does not move by its own "
                'reading alone: switch it off (active="false"), or name the URDF of this robot'
            )


def splice_mjcf(robot: Robot, origins: Mapping[str, pin.SE3]) -> bytes:
    """Write new joint origins into the MJCF that a robot was read from.

    Only `pos` and the orientation of their bodies and sites change; an orientation that is written otherwise becomes `quat`.

    Args:
        robot: Of a MJCF.
        origins: New origins by joint.

    Raises:
        RobotError: no element holds a joint's origin, or the file does not read back as meant.
    """
    if robot.mjcf is None:
        raise RobotError(f"{robot.path}: was not read from a MJCF")
    mjcf, owners = robot.mjcf, compiled(robot.mjcf, robot.path).owners
    nominal = read_tree(robot.urdf, robot.path).origins
    starts, codec = _starts(mjcf), codec_of(mjcf)
    root = etree.fromstring(mjcf, etree.XMLParser(resolve_entities=False, no_network=True))
    elements = [element for element in root.iter() if isinstance(element.tag, str)]
    edits = []
    for name, origin in origins.items():
        if name not in owners:
            raise RobotError(f"{robot.path}: no body holds the origin of {name!r} alone")
        owner = owners[name]
        element, start = elements[owner.element], starts[owner.element]
        edits.append((start, _tag(mjcf[start:].decode(codec), element, owner, nominal[name], origin)))
    pieces, end = [], 0
    for start, (old, new) in sorted(edits):
        pieces += [mjcf[end:start], new.encode(codec)]
        end = start + len(old.encode(codec))
    result = b"".join([*pieces, mjcf[end:]])
    _read_back(robot, result, origins)
    return result


def _starts(mjcf: bytes) -> list[int]:
    """First byte of every element, in the order of the file."""
    starts: list[int] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda *_: starts.append(parser.CurrentByteIndex)
    parser.Parse(mjcf, True)
    return starts


def _tag(text: str, element: etree._Element, owner: Owner, old: pin.SE3, new: pin.SE3) -> tuple[str, str]:
    """The start tag of an element as it is, and as it is to be."""
    tag = text = _start_tag(text)
    before, after = old * owner.beyond.inverse(), new * owner.beyond.inverse()
    stated = np.array([float(value) for value in element.get("pos", "0 0 0").split()])
    place = without_rounding(after.translation, stated)
    if not np.array_equal(place, stated):
        tag = with_attribute(tag, "pos", "pos", _text(place))
    if np.abs(after.rotation - before.rotation).max() > ROTATION_ROUNDING:
        key = next((key for key in TURNS if element.get(key) is not None), "quat")
        x, y, z, w = pin.Quaternion(after.rotation).coeffs().tolist()
        sign = -1.0 if w < 0.0 else 1.0
        tag = with_attribute(tag, key, "quat", _text(sign * np.array([w, x, y, z])))
    return text, tag


def _start_tag(text: str) -> str:
    """A start tag at the beginning of a text, up to its end; in quotes `>` ends none."""
    quote = ""
    for k, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter == ">":
            return text[: k + 1]
    return text


def _read_back(robot: Robot, result: bytes, origins: Mapping[str, pin.SE3]) -> None:
    """Read the new file, and compare each link with where the origins have it.

    Raises:
        RobotError: naming the link that stands elsewhere.
    """
    tree, new = read_tree(robot.urdf, robot.path), read_tree(compiled(result, robot.path).urdf, robot.path)
    rng = np.random.default_rng(0)
    positions = {name: rng.uniform(-1.0, 1.0, COMPARED_CONFIGURATIONS) for name in tree.moves}
    here, there = link_places(tree, positions, origins), link_places(new, positions, {})
    # of an anchor that is far from its body, only the difference is near: it rounds as the far one does
    size = max(
        1.0, *(float(np.abs(origin.translation).max()) for each in (tree, new) for origin in each.origins.values())
    )
    for link, T in here.items():
        off = float(np.abs(there[link] - T).max()) if link in there else np.inf
        if not off <= READ_BACK_TOLERANCE * max(size, float(np.abs(T[:, :3, 3]).max())):
            raise RobotError(
                f"{robot.path}: calibrated.xml would have {link!r} elsewhere, by {off:.2g}: nothing was written. This is a fault "
                "of aridcal: please report it with the MJCF"
            )


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0
