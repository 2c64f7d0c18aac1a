"""RAPID of ABB: robtarget and jointtarget, declared or in a move, with tooldata and wobjdata."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from aridcal.programs.axes import DEGREE, MILLIMETRE, Axes
from aridcal.programs.frames import KnownFrames, unknown
from aridcal.programs.notations import ABB
from aridcal.programs.targets import NUMBER, Branch, Number, Target, blanked, closing, line_of, number, split_arguments
from aridcal.programs.uses import Frame, Use, known, one_use

COMMENTS = r'"[^"\n]*"|![^\n]*'

DECLARED = re.compile(
    r"(?i)\b(?:CONST|PERS|VAR)\s+(robtarget|jointtarget|tooldata|wobjdata)\s+(\w+)(\s*\{[^}]*\})?\s*:=\s*(?=\[)"
)

MOVE = re.compile(r"(?im)^[ \t]*(Move(?:J|L|C|AbsJ)\w*|Trigg(?:J|L|C)|Search(?:L|C))\b(?P<rest>[^;]*);")

DISPLACED = re.compile(r"(?i)\b(?:PDispOn|PDispSet|EOffsOn|EOffsSet)\b")

ROUND = 90.0 * DEGREE
"""A quadrant of an axis in confdata."""

NOT_USED = 8.9e9
"""External axes that there are not read 9E9."""

Nested = Number | list["Nested"] | None
"""Brackets as lists; None stands for what is no number."""


@dataclass(frozen=True)
class _Literal:
    """A value in brackets: where it begins, and its parts."""

    start: int
    parts: list[Nested]

    def numbers(self, *path: int) -> tuple[Number, ...] | None:
        """The plain numbers of a part; None if it is not made of them."""
        part: Nested = self.parts
        for k in path:
            if not isinstance(part, list) or k >= len(part):
                return None
            part = part[k]
        if not isinstance(part, list) or not all(isinstance(n, Number) for n in part):
            return None
        return tuple(n for n in part if isinstance(n, Number))

    def pose(self, *path: int) -> Frame:
        """The frame [[x, y, z], [q1, q2, q3, q4]] of a part, or why it is none."""
        place, turn = self.numbers(*path, 0), self.numbers(*path, 1)
        if place is None or turn is None or len(place) != 3 or len(turn) != 4:
            return "a frame is no plain numbers"
        values = np.array([n.value for n in (*place, *turn)])
        return ABB.pose(values) if np.linalg.norm(values[3:]) > 0.5 else "a frame has no unit quaternion"


def read(text: str, axes: Axes, frames: KnownFrames) -> list[Target]:
    """Targets of a module: in the order of the moves, those that no move of the file names at the end.

    Args:
        text: The module.
        axes: Of the robot: rax_1 to rax_6 are its joints in their order, eax_a and so on its rails.
        frames: ``bases`` (work objects) and ``tools`` by name, for those that the module does not declare.
    """
    plain = blanked(text, COMMENTS)
    declared: dict[str, tuple[str, list[_Literal]]] = {}
    for m in DECLARED.finditer(plain):
        value = _literal(plain, m.end())
        values = _elements(value) if m.group(3) else [value]
        declared[m.group(2).lower()] = m.group(1).lower(), values
    displaced = DISPLACED.search(plain) is not None
    found: list[Target] = []
    uses: dict[int, tuple[str, str, _Literal, list[Use]]] = {}
    for line, name, kind, values, use in _moves(plain, declared, frames):
        if not values:
            found.append(Target(line, name, "pose", (), "is not in this file, or no plain numbers"))
        for literal in values:
            own = Use("a displacement acts (PDisp, EOffs)", "") if displaced and kind == "robtarget" else use
            uses.setdefault(literal.start, (name, kind, literal, []))[3].append(own)
    for name, (kind, values) in declared.items():
        if kind in ("robtarget", "jointtarget"):
            for literal in values:
                uses.setdefault(literal.start, (name, kind, literal, []))
    for name, kind, literal, every in uses.values():
        found.append(_target(line_of(text, literal.start), name, kind, literal, one_use(every), axes))
    return found


def _moves(
    plain: str, declared: dict[str, tuple[str, list[_Literal]]], frames: KnownFrames
) -> Iterator[tuple[int, str, str, list[_Literal], Use]]:
    """Line, name, kind, values and use of each target of a move."""
    for move in MOVE.finditer(plain):
        spans = split_arguments(plain, *move.span("rest"))
        said = [plain[slice(*span)] for span in spans]
        object_ = re.search(r"(?i)\\WObj\s*:=\s*(\w+)", move.group("rest"))
        tool = _tool(re.split(r"[\s\\]", said[-1], maxsplit=1)[0], declared, frames)
        use = Use(_object(object_.group(1) if object_ else "wobj0", declared, frames), tool)
        count = 2 if move.group(1).lower()[4:5] == "c" or move.group(1).lower() in ("triggc", "searchc") else 1
        points = [span for span in spans[:-1] if _is_point(plain[slice(*span)], declared)][:count]
        for start, stop in points or spans[:1]:
            name = " ".join(plain[start:stop].split())
            while step := re.match(r"(?i)(?:Offs|RelTool)\s*\(", plain[start:stop]):
                start, stop = split_arguments(plain, start + step.end(), stop - 1)[0]
            line = line_of(plain, move.start(1))
            if plain[start] == "[":
                literal = _literal(plain, start)
                kind = "robtarget" if literal.numbers(0) and len(literal.numbers(0) or ()) == 3 else "jointtarget"
                yield line, name, kind, [literal], use
            else:
                kind, values = declared.get(re.split(r"\W", plain[start:stop], maxsplit=1)[0].lower(), ("", []))
                yield line, name, kind, values, use


def _is_point(said: str, declared: dict[str, tuple[str, list[_Literal]]]) -> bool:
    if re.match(r"\[|(?i:Offs|RelTool)\s*\(", said):
        return True
    kind, _ = declared.get(re.split(r"\W", said, maxsplit=1)[0].lower(), ("", []))
    return kind in ("robtarget", "jointtarget")


def _tool(name: str, declared: dict[str, tuple[str, list[_Literal]]], frames: KnownFrames) -> Frame:
    kind, values = declared.get(name.lower(), ("", []))
    if kind == "tooldata":
        return values[0].pose(1)
    if name.lower() == "tool0":
        return np.eye(4)
    return frames.tools.get(name.lower(), unknown("the tool", name or "of this move"))


def _object(name: str, declared: dict[str, tuple[str, list[_Literal]]], frames: KnownFrames) -> Frame:
    kind, values = declared.get(name.lower(), ("", []))
    if kind == "wobjdata":
        user, own = values[0].pose(3), values[0].pose(4)
        if isinstance(user, str) or isinstance(own, str):
            return f"the work object {name}: a frame is no plain numbers"
        return np.asarray(user @ own)
    if name.lower() == "wobj0":
        return np.eye(4)
    return frames.bases.get(name.lower(), unknown("the work object", name))


def _literal(plain: str, start: int) -> _Literal:
    found, _ = _nested(plain, start, 0)
    return _Literal(start, found)


def _elements(array: _Literal) -> list[_Literal]:
    """The elements of an array of one dimension."""
    return [_Literal(_first(part), part) for part in array.parts if isinstance(part, list)]


def _first(part: list[Nested]) -> int:
    """The place of the first number in a part: its name for what is used where."""
    for inner in part:
        if isinstance(inner, Number):
            return inner.start
        if isinstance(inner, list) and (place := _first(inner)) >= 0:
            return place
    return -1


DEEPEST = 10
"""Brackets in brackets; a robtarget in an array of three dimensions has five."""


def _nested(plain: str, start: int, depth: int) -> tuple[list[Nested], int]:
    end = closing(plain, start)
    parts: list[Nested] = []
    for span in split_arguments(plain, start + 1, end) if end > 0 and depth < DEEPEST else ():
        if plain[slice(*span)].startswith("["):
            parts.append(_nested(plain, span[0], depth + 1)[0])
        else:
            found = NUMBER.fullmatch(plain, *span)
            parts.append(number(found) if found else None)
    return parts, end


def _target(line: int, name: str, kind: str, literal: _Literal, use: Use, axes: Axes) -> Target:
    external = literal.numbers(1 if kind == "jointtarget" else 3) or ()
    rails = [(n, own) for n, own in zip(external, axes.external, strict=False) if n.value < NOT_USED]
    if kind == "jointtarget":
        own = (literal.numbers(0) or ())[: len(axes.arm)]
        if len(own) != len(axes.arm):
            return Target(line, name, "joints", (), "is no plain numbers")
        units = axes.units([*axes.arm, *(k for _, k in rails)], DEGREE, MILLIMETRE)
        numbers = (*own, *(n for n, _ in rails))
        return Target(line, name, "joints", numbers, "", axes.readings(numbers, units), units, digits=5)
    pose = literal.pose()
    if isinstance(pose, str):
        return Target(line, name, "pose", (), "is no plain numbers")
    numbers = (*(literal.numbers(0) or ()), *(literal.numbers(1) or ()))
    held = np.full(len(axes.kinds), np.nan)
    for n, k in rails:
        held[k] = axes.unit(k, DEGREE, MILLIMETRE) * n.value
    branch = Branch(_quadrants(literal.numbers(2), axes), None, held, settled=len(axes.arm) == 6)
    return Target(line, name, "pose", numbers, use.why, None, (), ABB, known(use.base), known(use.tool), branch)


def _quadrants(data: tuple[Number, ...] | None, axes: Axes) -> Callable[[np.ndarray], bool]:
    """What confdata says of an arm of six axes: the quarters of a turn in which axes 1, 4 and 6 are."""
    if data is None or len(data) < 3 or len(axes.arm) != 6:
        return lambda q: True
    pairs = [(axes.arm[axis], n.value) for axis, n in zip((0, 3, 5), data[:3], strict=True)]
    return lambda q: all(math.floor(q[own] / ROUND) == quarter for own, quarter in pairs)
