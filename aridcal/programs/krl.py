"""KRL of KUKA: E6POS, POS and FRAME, E6AXIS and AXIS, in moves, under names, and in the data list of inline forms."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from aridcal.programs.axes import DEGREE, MILLIMETRE, Axes
from aridcal.programs.frames import KnownFrames, unknown
from aridcal.programs.notations import KUKA, inverse
from aridcal.programs.targets import NUMBER, Branch, Number, Target, blanked, closing, line_of, number, split_arguments
from aridcal.programs.uses import Frame, Use, known, one_use

COMMENTS = r'"[^"\n]*"|;[^\n]*'

POSE = ("X", "Y", "Z", "A", "B", "C")

FIELD = re.compile(rf"(\w+)\s+({NUMBER.pattern})\s*\Z")

NAMED = re.compile(
    r"(?im)^[ \t]*(?:(?:DECL|GLOBAL)[ \t]+)*(?:(?:E6POS|POS|FRAME|E6AXIS|AXIS)[ \t]+)?([$\w]+(?:\[\d+\])?)[ \t]*=[ \t]*(?=\{)"
)
"""An aggregate under a name."""

EVENT = re.compile(
    r"(?im)^[ \t]*(?:(?P<move>S?PTP|S?LIN|S?CIRC)(?P<step>_REL)?[ \t]+"
    r"|\$(?P<set>BASE|TOOL)[ \t]*=[ \t]*(?P<value>[^\r\n]+)"
    r"|BAS[ \t]*\([ \t]*#(?P<bas>BASE|TOOL)[ \t]*,[ \t]*(?P<number>\d+)[ \t]*\)"
    r"|\$IPO_MODE[ \t]*=[ \t]*#(?P<ipo>\w+))"
)
"""A move, or what sets the frames of those after it."""

FORM = re.compile(
    r"(?im)^[ \t]*DECL[ \t]+FDAT[ \t]+F(\w+)[ \t]*=[ \t]*\{TOOL_NO[ \t]+(\d+)[ \t]*,[ \t]*BASE_NO[ \t]+(\d+)"
    r"[ \t]*,[ \t]*IPO_FRAME[ \t]+#(\w+)"
)
"""What an inline form says of its point: point, tool, base, and who holds the tool. XP1 has the data FP1."""

NULL = ("$nullframe", "$world", "$robroot")
"""The robot's own base, or its flange."""

OUTSIDE = "the tool stands outside (#TCP)"


@dataclass(frozen=True)
class _Literal:
    """An aggregate {X 1, Y 2, ...} of plain numbers: where it stands, and its fields by their names in capitals."""

    start: int
    end: int
    fields: dict[str, Number]

    @property
    def pose(self) -> np.ndarray | None:
        """The transform that it is, if it has all six numbers."""
        if not set(POSE) <= set(self.fields):
            return None
        return KUKA.pose(np.array([self.fields[name].value for name in POSE]))


@dataclass(frozen=True)
class _Frames:
    """Frames that the program states, and those that the user does.

    Attributes:
        points: Aggregates by name.
        stated: By ``--frames``.
    """

    points: dict[str, _Literal]
    stated: KnownFrames

    def frame(self, said: str, kind: str) -> Frame:
        """The value of an expression: names and aggregates, multiplied by colons."""
        product = np.eye(4)
        for part in re.split(r":(?![^{]*\})", said.strip()):
            factor = self._factor(part.strip(), kind)
            if isinstance(factor, str):
                return factor
            product = product @ factor
        return product

    def numbered(self, n: str, kind: str) -> Frame:
        """Number n of the controller's bases or tools."""
        return np.eye(4) if int(n) == 0 else self.frame(f"{kind}_DATA[{n}]", kind)

    def _factor(self, said: str, kind: str) -> Frame:
        name = re.sub(r"\s", "", said).lower()
        if name in NULL:
            return np.eye(4)
        literal = _literal(said, 0) if said.startswith("{") else self.points.get(name)
        if literal is not None and literal.pose is not None:
            return literal.pose
        stated = self.stated.bases if kind == "BASE" else self.stated.tools
        index = re.fullmatch(r"\w+_data\[(\d+)\]", name)
        for key in (name, *(index.groups() if index else ())):
            if key in stated:
                return stated[key]
        return unknown(kind.lower(), said)


def read(text: str, axes: Axes, frames: KnownFrames) -> list[Target]:
    """Targets of a .src or a .dat: in the order of the moves, those that no move of the file names at the end.

    Args:
        text: The program, or its data list.
        axes: Of the robot: A1 to A6 are its joints in their order, E1 and so on its rails.
        frames: ``bases`` and ``tools`` by number, as in BASE_DATA and TOOL_DATA, or by name; ``default`` where none is set.
    """
    plain = blanked(text, COMMENTS)
    points = {m.group(1).lower(): a for m in NAMED.finditer(plain) if (a := _literal(plain, m.end()))}
    found: list[Target] = []
    uses: dict[int, tuple[str, _Literal, list[Use]]] = {}
    for line, name, literal, use in (*_moves(plain, _Frames(points, frames)), *_forms(plain, _Frames(points, frames))):
        if isinstance(literal, str):
            found.append(Target(line, name, "pose", (), literal))
        else:
            uses.setdefault(literal.start, (name, literal, []))[2].append(use)
    for name, literal in points.items():
        if not name.startswith("$") and "_data[" not in name:
            uses.setdefault(literal.start, (name.upper(), literal, []))
    for name, literal, own in uses.values():
        found.append(_target(line_of(text, literal.start), name, literal, one_use(own), axes))
    return found


def _moves(plain: str, frames: _Frames) -> Iterator[tuple[int, str, _Literal | str, Use]]:
    """Line, name, aggregate and use of each target of a move; a text in place of the aggregate says why there is none."""
    stated = frames.stated
    base: Frame = stated.bases.get("default", unknown("the base", "default"))
    tool: Frame = stated.tools.get("default", unknown("the tool", "default"))
    outside = False
    for event in EVENT.finditer(plain):
        what = (event.group("set") or event.group("bas") or "").upper()
        if what:
            value = event.group("value")
            frame = frames.frame(value, what) if value else frames.numbered(event.group("number"), what)
            base, tool = (frame, tool) if what == "BASE" else (base, frame)
        elif event.group("ipo"):
            outside = event.group("ipo").upper() == "TCP"
        else:
            use = Use(OUTSIDE, OUTSIDE) if outside else Use(base, tool)
            end = plain.find("\n", event.end())
            spans = split_arguments(plain, event.end(), end if end >= 0 else len(plain))
            for start, stop in spans[: 2 if "CIRC" in event.group("move").upper() else 1]:
                line = line_of(plain, start)
                if event.group("step"):
                    yield line, plain[start:stop], "is a step from the place before", use
                else:
                    yield line, *_of_move(plain, start, stop, frames, use)


def _of_move(plain: str, start: int, stop: int, frames: _Frames, use: Use) -> tuple[str, _Literal | str, Use]:
    """A target of a move: its name, its aggregate, and its use, which a shift behind a colon is part of."""
    here = _literal(plain, start) if plain[start] == "{" else None
    name = plain[start : here.end] if here else re.split(r"[\s:]", plain[start:stop], maxsplit=1)[0]
    literal = here or frames.points.get(name.lower())
    shown = " ".join(name.split()).upper()
    if literal is None:
        return shown, "is not in this file, or no plain numbers", use
    shift = re.match(r"\s*:\s*(\{[^}]*\}|[$\w]+(?:\[\d+\])?)", plain[start + len(name) : stop])
    if shift is None:
        return shown, literal, use
    if plain[start + len(name) + shift.end() : stop].lstrip().startswith(":"):
        return shown, "has several shifts", use
    moved = frames.frame(shift.group(1), "BASE")  # P:S with a tool T is P with T behind the inverse of S
    tool = moved if isinstance(moved, str) else use.tool if isinstance(use.tool, str) else use.tool @ inverse(moved)
    return shown, literal, Use(use.base, tool)


def _forms(plain: str, frames: _Frames) -> Iterator[tuple[int, str, _Literal, Use]]:
    """Points of inline forms, with the base and the tool that their data name."""
    for form in FORM.finditer(plain):
        name, tool, base, ipo = form.groups()
        literal = frames.points.get(f"x{name.lower()}") or frames.points.get(name.lower())
        if literal is not None:
            inside = Use(frames.numbered(base, "BASE"), frames.numbered(tool, "TOOL"))
            use = Use(OUTSIDE, OUTSIDE) if ipo.upper() == "TCP" else inside
            yield line_of(plain, literal.start), f"X{name.upper()}", literal, use


def _literal(plain: str, start: int) -> _Literal | None:
    """The aggregate that begins at a place; None where its fields are no plain numbers."""
    end = closing(plain, start)
    if end < 0:
        return None
    fields = {}
    for span in split_arguments(plain, start + 1, end):
        field = FIELD.match(plain[: span[1]], span[0])
        if field is not None:
            fields[field.group(1).upper()] = number(field, 2)
        elif not re.match(r"\w+\s+[#\w{\[]", plain[slice(*span)]):  # an enumeration, a truth value, a text
            return None
    return _Literal(start, end + 1, fields)


def _target(line: int, name: str, literal: _Literal, use: Use, axes: Axes) -> Target:
    fields = literal.fields
    joints = {f"A{k + 1}": own for k, own in enumerate(axes.arm)} | {
        f"E{k + 1}": own for k, own in enumerate(axes.external)
    }
    if "A1" in fields:
        own = [axis for axis in joints if axis in fields]
        units = axes.units([joints[axis] for axis in own], DEGREE, MILLIMETRE)
        numbers = tuple(fields[axis] for axis in own)
        return Target(line, name, "joints", numbers, "", axes.readings(numbers, units), units, digits=5)
    if literal.pose is None:
        return Target(line, name, "pose", (), f"lacks some of {' '.join(POSE)}")
    numbers = tuple(fields[part] for part in POSE)
    held = np.full(len(axes.kinds), np.nan)
    for k, own_axis in enumerate(axes.external):
        if f"E{k + 1}" in fields:
            held[own_axis] = axes.unit(own_axis, DEGREE, MILLIMETRE) * fields[f"E{k + 1}"].value
    branch = Branch(_signs(fields, axes), None, held, settled="T" in fields)
    return Target(line, name, "pose", numbers, use.why, None, (), KUKA, known(use.base), known(use.tool), branch)


def _signs(fields: dict[str, Number], axes: Axes) -> Callable[[np.ndarray], bool]:
    """What T says: its bits, the lowest first, are set where axes are negative."""
    if "T" not in fields:
        return lambda q: True
    bits = int(fields["T"].value)
    return lambda q: all((q[own] < 0.0) == bool(bits >> k & 1) for k, own in enumerate(axes.arm))
