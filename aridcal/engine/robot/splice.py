"""New joint origins spliced into a URDF's own bytes; everything else stays as the user wrote it."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from aridcal.engine.robot.start_tags import codec_of, with_attribute
from aridcal.system.errors import RobotError, nearest

# Numbers of an origin that differ by less are the same, [m] or [rad]: some products of matrices round by that much.
ROTATION_ROUNDING = 1e-14
# A cosine of the pitch below this is rounding alone: roll and yaw turn about one axis, and only their sum is known.
LEAST_PITCH_COSINE = 1e-13

_LINE_START = re.compile(r"(\r\n|\n|\r)[ \t]*\Z")


def splice_origins(urdf: bytes, origins: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> bytes:
    """Replace the ``<origin>`` of the named joints in a URDF's bytes.

    Only the values of ``xyz`` and ``rpy`` change. A missing attribute is added, a missing ``<origin>`` inserted as the
    joint's first child; a vector that already reads as wanted keeps its text. Numbers are the shortest that read back
    as the same float64.

    Args:
        urdf: The file, in any encoding that expat reads (UTF-8, UTF-16, one-byte encodings), with or without BOM.
        origins: (xyz [m], rpy [rad]), each of shape (3,), by joint name.

    Returns:
        The new file, in the same encoding.

    Raises:
        RobotError: the file is not well-formed, is hostile (DTD, entities) or has no such joint.
    """
    before = _Scan(urdf, origins)
    edits = [edit for name, vectors in origins.items() for edit in _edits(before, name, vectors)]
    pieces, end = [], 0
    for start, stop, new in sorted(edits):
        pieces += [urdf[end:start], new.encode(before.codec)]
        end = stop
    result = b"".join([*pieces, urdf[end:]])

    after = _Scan(result, origins)
    for name, vectors in origins.items():
        for key, vector in zip(("xyz", "rpy"), vectors, strict=True):
            if not _reads_as(after.joints[name].origin, key, vector):
                raise RobotError(f"joint {name!r}: its new {key} {vector} does not read back from the URDF")
    if after.rest != before.rest:
        raise RobotError("splicing the new origins into the URDF would change more than the origins")
    return result


def origin_texts(urdf: bytes, placements: Mapping[str, pin.SE3]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Write placements as a URDF's author did: angles near those in the file, and nothing changed by rounding alone.

    Args:
        urdf: The file's bytes.
        placements: New origins by joint name.

    Returns:
        (xyz [m], rpy [rad]), each of shape (3,), by joint name.

    Raises:
        RobotError: as for :func:`splice_origins`.
    """
    joints = _Scan(urdf, placements).joints
    vectors = {}
    for name, placement in placements.items():
        attributes = joints[name].origin if name in joints else {}
        xyz, rpy = (_vector(attributes.get(key, "")) for key in ("xyz", "rpy"))
        vectors[name] = without_rounding(placement.translation, xyz), rpy_near(placement.rotation, rpy)
    return vectors


def rpy_near(rotation: np.ndarray, near: np.ndarray) -> np.ndarray:
    r"""The roll, pitch and yaw of a rotation that are nearest to others, shape (3,), [rad].

    Every rotation R = Rz(y) Ry(p) Rx(r) has two, (r, p, y) and (r + pi, pi - p, y + pi), and whole turns of each. From
    one roll follow

    .. math:: y = atan2(s_r R_{13} - c_r R_{12}, c_r R_{22} - s_r R_{23}), \quad
              p = atan2(-R_{31}, c_y R_{11} + s_y R_{21})

    Args:
        rotation: Shape (3, 3).
        near: Roll, pitch and yaw, shape (3,), [rad].
    """
    R = rotation
    if np.hypot(R[2, 1], R[2, 2]) > LEAST_PITCH_COSINE:
        rolls = [np.arctan2(R[2, 1], R[2, 2])]
        rolls.append(rolls[0] + np.pi)
    else:  # share what is left of the turn between roll and yaw alike
        side = 1.0 if R[2, 0] < 0 else -1.0
        turn = _yaw(R, near[0]) - near[2]
        rolls = [near[0] - side * (turn - 2 * np.pi * np.round(turn / (2 * np.pi))) / 2]
    candidates = []
    for r in rolls:
        y = _yaw(R, r)
        p = np.arctan2(-R[2, 0], np.cos(y) * R[0, 0] + np.sin(y) * R[1, 0])
        angles = np.array([r, p, y])
        candidates.append(angles - 2 * np.pi * np.round((angles - near) / (2 * np.pi)))
    best = min(candidates, key=lambda angles: float(np.abs(angles - near).sum()))
    return without_rounding(best, near)


def _yaw(R: np.ndarray, roll: float) -> float:
    """The yaw of a rotation that goes with a roll, [rad]."""
    s, c = np.sin(roll), np.cos(roll)
    return float(np.arctan2(s * R[0, 2] - c * R[0, 1], c * R[1, 1] - s * R[1, 2]))


def without_rounding(values: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Nominal numbers, or zero, in place of those that differ from them by rounding alone."""
    values = np.where(np.abs(values) < ROTATION_ROUNDING, 0.0, values)
    return np.where(np.abs(values - nominal) < ROTATION_ROUNDING, nominal, values)


def _vector(text: str) -> np.ndarray:
    """Three numbers of an attribute that has been read before; zeros where it is absent."""
    return np.array([float(v) for v in text.split()]) if text else np.zeros(3)


@dataclass
class _Joint:
    """Byte offsets of a joint's start tag, of its ``<origin>`` and of where one can be inserted; -1: there is none."""

    start: int
    origin: dict[str, str] = field(default_factory=dict)
    origin_start: int = -1
    origin_stop: int = -1
    first_child: int = -1


class _Scan:
    """The robot's joints by name and, in file order, all that may not change with the origins of some of them."""

    def __init__(self, urdf: bytes, names: Collection[str]) -> None:
        self.urdf = urdf
        self.codec = codec_of(urdf)
        self.joints: dict[str, _Joint] = {}
        self.rest: list[tuple[str, object]] = []
        self._names = names
        self._path: list[str] = []
        self._open: tuple[str, _Joint] | None = None  # the joint that the parser is in
        self._parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartDoctypeDeclHandler = self._doctype
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text
        parser.DefaultHandler = self._markup
        try:
            parser.Parse(urdf, True)
        except (expat.ExpatError, ValueError, LookupError) as error:
            raise RobotError(f"the URDF is not well-formed XML: {error}") from None

    def text(self, start: int, stop: int) -> str:
        return self.urdf[start:stop].decode(self.codec)

    def indent(self, joint: _Joint) -> str:
        """Line end and indentation before a joint's first child; empty if it does not start a line."""
        match = _LINE_START.search(self.text(joint.start, joint.first_child))
        return match.group() if match else ""

    def _doctype(self, *_: object) -> None:
        raise RobotError("the URDF has a DOCTYPE: DTDs and entities are refused. Remove it.")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        at, depth = self._parser.CurrentByteIndex, len(self._path)
        self._path.append(tag)
        if depth == 0 and tag != "robot":
            raise RobotError(f"the URDF's top element is <{tag}>, not <robot>")
        if depth == 1 and tag == "joint":
            name = attributes.get("name", "")
            if name in self.joints:
                raise RobotError(f"the URDF has the joint {name!r} twice")
            self._open = name, self.joints.setdefault(name, _Joint(at))
        elif depth == 2 and self._open:
            name, joint = self._open
            if joint.first_child < 0:
                joint.first_child = at
            if tag == "origin" and joint.origin_start < 0:
                joint.origin, joint.origin_start = attributes, at
                if name in self._names:
                    foreign = {key: value for key, value in attributes.items() if key not in ("xyz", "rpy")}
                    self.rest += [("attributes", foreign)] if foreign else []
                    return
        self.rest.append((tag, attributes))

    def _end(self, tag: str) -> None:
        self._path.pop()
        if len(self._path) == 1:
            self._open = None
        elif len(self._path) == 2 and self._open and tag == "origin":
            name, joint = self._open
            if joint.origin_stop < 0:
                joint.origin_stop = self._parser.CurrentByteIndex
                if name in self._names:
                    return
        self.rest.append(("end", tag))

    def _text(self, text: str) -> None:
        if text.strip():
            self.rest.append(("text", text))

    def _markup(self, markup: str) -> None:
        """Comments, processing instructions, the declaration. A comment that starts a line can be a first child."""
        if len(self._path) == 2 and self._open and markup.startswith("<!--") and self._open[1].first_child < 0:
            joint = self._open[1]
            joint.first_child = self._parser.CurrentByteIndex
            if not self.indent(joint):
                joint.first_child = -1
        self.rest.append(("other", markup))


def _edits(scan: _Scan, name: str, vectors: tuple[np.ndarray, np.ndarray]) -> Iterator[tuple[int, int, str]]:
    """Yield (first byte, byte after the last, new text) of what changes for one joint."""
    joint = scan.joints.get(name)
    if joint is None:
        raise RobotError(f"the URDF has no joint {name!r}{nearest(name, scan.joints)}")
    if "quat_xyzw" in joint.origin:
        raise RobotError(f"joint {name!r}: its <origin> has quat_xyzw. Write the rotation as rpy in the URDF.")
    if joint.first_child < 0:
        raise RobotError(f"joint {name!r} has neither a parent nor a child in the URDF")
    new = {
        key: " ".join(repr(float(v) + 0.0) for v in vector)  # no -0.0
        for key, vector in zip(("xyz", "rpy"), vectors, strict=True)
        if not _reads_as(joint.origin, key, vector)
    }
    if not new:
        return
    start, stop, tag = joint.origin_start, joint.origin_stop, scan.text(joint.origin_start, joint.origin_stop)
    if start < 0:
        start = stop = joint.first_child
        tag = "<origin/>" + scan.indent(joint)
    quote = '"' if '"' in scan.text(joint.start, joint.first_child).partition("'")[0] else "'"
    for key, value in new.items():
        tag = with_attribute(tag, key, key, value, quote)
    yield start, stop, tag


def _reads_as(origin: Mapping[str, str], key: str, vector: np.ndarray) -> bool:
    """Whether an origin's attribute (absent: zeros) is three finite numbers, exactly those of a vector."""
    try:
        values = [float(v) for v in origin.get(key, "0 0 0").split()]
    except ValueError:
        return False
    return len(values) == 3 and bool(np.isfinite(values).all()) and np.array_equal(values, vector)
