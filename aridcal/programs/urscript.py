"""URScript: movej, movel, movep, movec and servoj to poses p[...] or joints [...], in nested frames and under names."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from aridcal.programs.axes import Axes
from aridcal.programs.frames import KnownFrames, unknown
from aridcal.programs.notations import UR, inverse
from aridcal.programs.targets import NUMBER, Branch, Number, Target, blanked, closing, line_of, number, split_arguments

COMMENTS = r'"[^"\n]*"|#[^\n]*'

MOVES = re.compile(r"\b(?P<move>movej|movel|movep|movec|servoj)\s*\(|\b(?P<tcp>set_tcp)\s*\(")

ASSIGNED = re.compile(r"(?<![\w.])(?:global\s+|local\s+)?(\w+)\s*=(?!=)\s*")

CALL = re.compile(r"(\w+)\s*\(")

LIST = re.compile(r"(p?)\s*\[")

DEFAULT = "default"
"""The tool of a program that sets none, in a file of frames."""

POSE = 6
"""Numbers of a pose."""

DEEPEST = 20
"""Names that stand for names, and frames in frames; a program that goes deeper goes round in circles."""


class NotPlain(Exception):
    """An expression that only the controller can work out; says why."""


@dataclass(frozen=True)
class _Found:
    """A target in its frames.

    Attributes:
        form: ``joints`` or ``pose``.
        numbers: Of the list.
        name: As it stands.
        base: Product of the frames before it, shape (4, 4).
        near: Joints that inverse kinematics is to start from.
    """

    form: str
    numbers: tuple[Number, ...]
    name: str
    base: np.ndarray
    near: np.ndarray | None = None


@dataclass(frozen=True)
class _Program:
    text: str
    assigned: dict[str, list[tuple[int, int]]]

    def target(self, start: int, end: int, depth: int = 0) -> _Found:
        """What an argument of a move stands for."""
        said = self.text[start:end]
        if depth > DEEPEST:
            raise NotPlain(f"{said}: stands for itself")
        if LIST.match(said):
            pose, numbers = self._list(start, end)
            return _Found("pose" if pose else "joints", numbers, said, np.eye(4))
        if called := CALL.match(said):
            arguments = split_arguments(self.text, start + called.end(), end - 1)
            if called.group(1) == "pose_trans" and len(arguments) == 2:
                inner = self.target(*arguments[1], depth + 1)
                if inner.form == "joints":
                    raise NotPlain("joints have no frame")
                return replace(inner, base=self.frame(*arguments[0], depth + 1) @ inner.base)
            if called.group(1) == "get_inverse_kin":
                inner = self.target(*arguments[0], depth + 1)
                near = self.joints(*arguments[1]) if len(arguments) > 1 else None
                return replace(inner, near=near)
            raise NotPlain(f"{called.group(1)}(...) is worked out by the controller only")
        if re.fullmatch(r"\w+", said):
            return replace(self.target(*self._named(said), depth + 1), name=said)
        raise NotPlain(f"{' '.join(said.split())[:40]}: is worked out by the controller only")

    def frame(self, start: int, end: int, depth: int = 0) -> np.ndarray:
        """A frame that is stated in numbers."""
        said = self.text[start:end]
        called = CALL.match(said)
        if called and called.group(1) == "pose_inv":
            return inverse(self.frame(start + called.end(), end - 1, depth + 1))
        found = self.target(start, end, depth)
        if found.form == "joints":
            raise NotPlain(f"{found.name}: is no pose")
        if len(found.numbers) != POSE:
            raise NotPlain(f"{found.name}: has {len(found.numbers)} numbers, a pose six")
        return np.asarray(found.base @ UR.pose(np.array([n.value for n in found.numbers])))

    def joints(self, start: int, end: int) -> np.ndarray | None:
        """Joints that are stated in numbers, [rad]; None if they are not."""
        try:
            found = self.target(start, end)
        except NotPlain:
            return None
        return np.array([n.value for n in found.numbers]) if found.form == "joints" else None

    def _named(self, name: str) -> tuple[int, int]:
        places = self.assigned.get(name, [])
        if len(places) != 1:
            raise NotPlain(f"{name} is assigned {len(places) or 'no'} times" if places else f"{name} is not assigned")
        return places[0]

    def _list(self, start: int, end: int) -> tuple[bool, tuple[Number, ...]]:
        opened = LIST.match(self.text, start)
        assert opened is not None
        if closing(self.text, opened.end() - 1) != end - 1:
            raise NotPlain(f"{self.text[start:end]}: is worked out by the controller only")
        numbers = []
        for span in split_arguments(self.text, opened.end(), end - 1):
            found = NUMBER.fullmatch(self.text, *span)
            if found is None:
                raise NotPlain(f"{self.text[slice(*span)] or 'nothing'} in {self.text[start:end]} is no plain number")
            numbers.append(number(found))
        return bool(opened.group(1)), tuple(numbers)


def read(text: str, axes: Axes, frames: KnownFrames) -> list[Target]:
    """Targets of all moves, in the order of the text.

    Args:
        text: The program.
        axes: Of the robot.
        frames: For the tool of a program that sets none, ``default``, and for where the controller has its base, if the URDF's
            is elsewhere, ``default`` too: that of ROS is turned by half a turn.
    """
    plain = blanked(text, COMMENTS)
    program = _Program(plain, _assignments(plain))
    tool: np.ndarray | str = frames.tools.get(DEFAULT, unknown("the tool", DEFAULT))
    base = frames.bases.get(DEFAULT, np.eye(4))
    found = []
    for call in MOVES.finditer(plain):
        end = closing(plain, call.end() - 1)
        arguments = split_arguments(plain, call.end(), end) if end > 0 else []
        if call.group("tcp"):
            tool = _tool(program, arguments[0]) if arguments else "the tool: set_tcp(...) does not end"
            continue
        for start, stop in arguments[: 2 if call.group("move") == "movec" else 1]:
            line = line_of(text, call.start())
            try:
                found.append(_target(line, program.target(start, stop), base, tool, axes))
            except NotPlain as why:
                name = " ".join(plain[start:stop].split())
                found.append(Target(line, name, "pose", (), str(why)))
    return found


def _assignments(text: str) -> dict[str, list[tuple[int, int]]]:
    """Where each name is given a value: the value's place, to the end of its line or of its brackets."""
    found: dict[str, list[tuple[int, int]]] = {}
    for place in ASSIGNED.finditer(text):
        before = text[: place.start()].rstrip(" \t")
        if before and before[-1] in "(,[":  # a keyword argument
            continue
        start = place.end()
        bracket = re.compile(r"\w*\s*[\[(]").match(text, start)
        if bracket:
            stop = closing(text, bracket.end() - 1) + 1
        else:
            stop = text.find("\n", start)
            stop = len(text) if stop < 0 else stop
        found.setdefault(place.group(1), []).append((start, start + len(text[start:stop].rstrip())))
    return found


def _tool(program: _Program, argument: tuple[int, int]) -> np.ndarray | str:
    try:
        return program.frame(*argument)
    except NotPlain as why:
        return f"the tool: {why}"


def _target(line: int, found: _Found, base: np.ndarray, tool: np.ndarray | str, axes: Axes) -> Target:
    if found.form == "joints":
        units = axes.units(axes.arm, 1.0, 1.0)
        if len(found.numbers) != len(units):
            return Target(line, found.name, "joints", (), f"has {len(found.numbers)} joints, the robot {len(units)}")
        readings = axes.readings(found.numbers, units)
        return Target(line, found.name, "joints", found.numbers, "", readings, units, digits=6)
    if len(found.numbers) != POSE:
        return Target(line, found.name, "pose", (), f"has {len(found.numbers)} numbers, a pose six")
    why = tool if isinstance(tool, str) else ""
    own = None if isinstance(tool, str) else tool
    near = found.near if found.near is not None and len(found.near) == len(axes.kinds) else None
    branch = Branch(near=near, settled=True)
    return Target(line, found.name, "pose", found.numbers, why, None, (), UR, base @ found.base, own, branch)
