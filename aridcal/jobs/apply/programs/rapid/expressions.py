"""Expressions of RAPID, prepared once and worked out wherever the walk comes to them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal as OneOf

import numpy as np

from aridcal.jobs.apply.programs.frames import KnownFrames, unknown_frame
from aridcal.jobs.apply.programs.rapid.grammar import NAME, fold
from aridcal.jobs.apply.programs.rapid.names import (
    BARE,
    CALLED,
    WORDS_BEFORE_BRACKETS,
    BoundRoutine,
    Names,
    Option,
    arguments,
)
from aridcal.jobs.apply.programs.rapid.values import (
    ABSENT,
    Alias,
    Datum,
    Literal,
    Point,
    as_pose,
    backwards,
    component,
    literal,
    object_frame,
    offs,
    points_of,
    reltool,
    tool_frame,
    transform,
)
from aridcal.jobs.apply.programs.text import NUMBER
from aridcal.jobs.apply.programs.uses import HERE, Frame
from aridcal.jobs.apply.programs.walk import NEVER_SET, ProgramState, Unknown

Value = Callable[[ProgramState], object]
"""What an expression is worth in a state."""

DEEPEST = 12
"""Brackets in brackets, and operators of one expression. A record of RAPID has five."""

LONGEST = 400
"""Letters of an expression that is worked out; points and frames have some hundred."""

STEP = re.compile(rf"\s*\{{([^{{}};]*)\}}|\s*\.\s*({NAME})")
SIGN = re.compile(r"[-+*/(\[{]")
WORD = re.compile(rf"(?<![.\\\w\x80-\xff])({NAME})((?:\s*\{{[^{{}};]*\}})*)")
STRING = re.compile(r'"[^"]*"')
NAME_INSIDE = re.compile(r"[A-DF-Za-df-z_\x80-\xff]|[Ee](?![-+\d])")
INNER = re.compile(r"\[\s*\[\s*[^\[\s]")

Arithmetic = Callable[[float, float], float]

OPERATORS: dict[str, Arithmetic] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b if b else float("inf"),
}


@dataclass(frozen=True, slots=True)
class Constant:
    """An expression whose value never changes."""

    value: object

    def __call__(self, state: ProgramState) -> object:
        """The value."""
        return self.value


@dataclass
class Expressions:
    """Expressions of a project.

    Attributes:
        names: What its names mean.
        frames: Of the user.
        declare: What is done with each target that stands in the text.
    """

    names: Names
    frames: KnownFrames
    declare: Callable[[Literal], None]
    _frames: dict[tuple[str, str, tuple[str, ...], str], Value] = field(default_factory=dict)
    _kept: dict[tuple[str, tuple[object, ...]], Frame | Unknown] = field(default_factory=dict)

    def value(self, datum: Datum, state: ProgramState) -> object:
        """What data is worth in a state."""
        for _ in range(DEEPEST):
            if self.steady(datum):
                return self.declared(datum)
            if datum.leaves and not datum.whole:
                return self._of_leaves(datum, state)
            value = state.get("data", datum.address)
            if not isinstance(value, Alias):
                return Unknown(datum.changed or "it is what the caller says") if value is NEVER_SET else value
            datum = value.datum
        return Unknown("it stands for data of too many routines")

    def _of_leaves(self, datum: Datum, state: ProgramState) -> object:
        """The declared value with the parts that statements change."""
        value = self.declared(datum)
        for place in datum.leaves:
            now = state.get("data", datum.leaf(place))
            value = with_part(value, place, Unknown(datum.changed) if now is NEVER_SET else now)
        return value

    def steady(self, datum: Datum) -> bool:
        """Whether the declared value is that of all times."""
        return not datum.changed and datum.declared.storage in ("const", "var", "pers") and not datum.parameter

    def declared(self, datum: Datum) -> object:
        """The value that the text declares."""
        if datum.value is None:
            datum.value = Unknown("its value is worked out from itself")
            datum.value = self._declared(datum)
        return datum.value

    def _declared(self, datum: Datum) -> object:
        if datum.declared.value is None:
            return Unknown("it has no value in the given files")
        start, end = datum.code.trimmed(*datum.declared.value)
        if datum.holds_points:
            return self._points(datum, start, end, datum.declared.name, DEEPEST)
        return self.compile(self.names.home(datum), start, end)(ProgramState())

    def _points(self, datum: Datum, start: int, end: int, name: str, deep: int) -> object:
        """A point, or the elements of an array."""
        code = datum.code
        if datum.declared.array and deep and INNER.match(code.plain, start, end) is None:
            if not code.plain.startswith("[", start) or code.closing(start) != end - 1:
                return Unknown("it is no plain numbers")
            parts = code.arguments(start + 1, end - 1)
            return tuple(self._points(datum, *part, f"{name}{{{k}}}", deep - 1) for k, part in enumerate(parts, 1))
        return self.point(code.file, datum, start, end, name)

    def point(self, file: int, datum: Datum, start: int, end: int, name: str) -> object:
        """The target that stands somewhere."""
        form: OneOf["joints", "pose"] = "pose" if datum.type == "robtarget" else "joints"
        return self._literal(literal(datum.code, start, end, name, form))

    def _literal(self, own: Literal) -> Point:
        self.declare(own)
        return Point(own)

    def destination(
        self, bound: BoundRoutine, start: int, end: int, form: OneOf["joints", "pose"], loops: tuple[str, ...]
    ) -> Value:
        """Where a move goes, or a target that is assigned or passed on: brackets there are a target of their own."""
        start, end = bound.code.trimmed(start, end)
        if bound.code.plain.startswith("[", start):
            return Constant(self._literal(literal(bound.code, start, end, _shown(bound.code.plain[start:end]), form)))
        return self.compile(bound, start, end, loops)

    def tool(self, bound: BoundRoutine, span: tuple[int, int] | None, loops: tuple[str, ...]) -> Value:
        """T_tip_tool of a tooldata; of `tool0` where none is given."""
        if span is None:
            return Constant(self._zero("tool0", self.frames.tools))
        return self._frame(bound, span, loops, "tool0", "the tool", tool_frame)

    def work_object(self, bound: BoundRoutine, option: Option | None, loops: tuple[str, ...]) -> Value:
        """T_base_object of a wobjdata; of `wobj0` where none is given."""
        if option is None:
            return Constant(self._zero("wobj0", self.frames.bases))
        given = self._frame(bound, option.span, loops, "wobj0", "the work object", object_frame)
        if option.sign != "?":
            return given
        present = self.compile(bound, *option.span, loops)
        return lambda state: HERE if present(state) is ABSENT else given(state)

    @staticmethod
    def _zero(name: str, stated: Mapping[str, np.ndarray]) -> Frame:
        """A frame that is nothing but where the user states something else."""
        return Frame(stated[name]) if name in stated else HERE

    def _frame(
        self,
        bound: BoundRoutine,
        span: tuple[int, int],
        loops: tuple[str, ...],
        zero: str,
        kind: str,
        convert: Callable[[str, object], Frame | Unknown],
    ) -> Value:
        """A frame by what stands there: most moves of a routine have the same."""
        key = (f"{id(bound)}", bound.code.plain[slice(*span)], loops, zero)
        if not key[1].isidentifier():
            return self._new_frame(bound, span, loops, zero, kind, convert)
        if key not in self._frames:
            self._frames[key] = self._new_frame(bound, span, loops, zero, kind, convert)
        return self._frames[key]

    def _new_frame(
        self,
        bound: BoundRoutine,
        span: tuple[int, int],
        loops: tuple[str, ...],
        zero: str,
        kind: str,
        convert: Callable[[str, object], Frame | Unknown],
    ) -> Value:
        text = bound.code.plain[slice(*span)]
        name = fold(text)
        datum = None if name in loops else bound.scope.datum(name)
        if re.fullmatch(NAME, text) and name not in loops and (datum is None or self._elsewhere(datum)):
            stated = (self.frames.tools if zero == "tool0" else self.frames.bases).get(name)
            if stated is not None:
                return Constant(Frame(stated))
            return Constant(HERE if name == zero else Unknown(unknown_frame(kind, text)))
        value = self.compile(bound, *span, loops)
        if isinstance(value, Constant):
            return value if isinstance(value.value, Frame) else Constant(convert(text, value.value))
        cache = self._kept

        def frame(state: ProgramState) -> object:
            now = value(state)
            if not isinstance(now, tuple):
                return now if isinstance(now, Frame) else convert(text, now)
            try:
                if (text, now) not in cache:
                    cache[text, now] = convert(text, now)
            except TypeError:  # a frame stands in it where numbers belong: such a value has no hash
                return convert(text, now)
            return cache[text, now]

        return frame

    def _elsewhere(self, datum: Datum) -> bool:
        """Whether data is named here, but has its value in no given file."""
        return self.steady(datum) and datum.declared.value is None

    def compile(
        self, bound: BoundRoutine, start: int, end: int, loops: tuple[str, ...] = (), deep: int = DEEPEST
    ) -> Value:
        """An expression, worked out as far as it is plain."""
        code = bound.code
        start, end = code.trimmed(start, end)
        text = code.plain[start : min(end, start + LONGEST + 1)]
        if deep == 0 or not text or len(text) > LONGEST:
            return Constant(Unknown(f"{self.names.line(code, start)} works it out"))
        match = BARE.fullmatch(text)
        if match is not None and text.lower() not in ("true", "false"):
            return self._read(bound, fold(match.group(1)), start + match.end(1), end, loops, deep)
        if match is not None:
            return Constant(text.lower() == "true")
        if NUMBER.fullmatch(text):
            return Constant(float(text))
        if STRING.fullmatch(text):
            return Constant(code.text[start + 1 : end - 1])
        if text[0] in "[(" and code.closing(start) == end - 1:
            if text[0] == "(":
                return self.compile(bound, start + 1, end - 1, loops, deep - 1)
            parts = [self.compile(bound, *span, loops, deep - 1) for span in code.arguments(start + 1, end - 1)]
            return _together(parts, lambda values: values)
        call = CALLED.match(code.plain, start, end)
        if call is not None and code.closing(call.end() - 1) == end - 1:
            return self._function(bound, fold(call.group(1)), call.end(), end - 1, loops, deep)
        return self._arithmetic(bound, start, end, loops, deep)

    def _read(self, bound: BoundRoutine, name: str, place: int, end: int, loops: tuple[str, ...], deep: int) -> Value:
        datum = bound.scope.datum(name)
        if name in loops:
            return Constant(Unknown(f"{name} changes with every turn of the loop"))
        if datum is None:
            return Constant(self._of_controller(name))
        indices: list[Value] = []
        kind, array = datum.type, True
        for step in STEP.finditer(bound.code.plain, place, end):
            if step.group(2):
                part = component(kind, f".{step.group(2)}")
                if part is None:
                    return Constant(
                        Unknown(f"{self.names.line(bound.code, place)} takes a part of {datum.declared.name}")
                    )
                kind = part[1]
                indices.append(Constant(float(part[0][0])))
            elif not array:
                return Constant(Unknown(f"{self.names.line(bound.code, place)} takes a part of {datum.declared.name}"))
            else:
                spans = bound.code.arguments(step.start(1), step.end(1))
                indices += [self.compile(bound, *span, loops, deep - 1) for span in spans]
            array = False
        if self.steady(datum) and all(isinstance(index, Constant) for index in indices):
            return Constant(part_of(self.declared(datum), [index(ProgramState()) for index in indices]))
        if not indices:
            return lambda state: self.value(datum, state)
        return lambda state: part_of(self.value(datum, state), [index(state) for index in indices])

    def _of_controller(self, name: str) -> object:
        """The value of data that no given file declares."""
        if name in ("tool0", "wobj0"):
            return HERE
        stated = [frames[name] for frames in (self.frames.tools, self.frames.bases) if name in frames]
        return Frame(stated[0]) if len(stated) == 1 else Unknown(f"{name} is in no given file")

    def _function(
        self, bound: BoundRoutine, name: str, start: int, end: int, loops: tuple[str, ...], deep: int
    ) -> Value:
        line = f"{self.names.line(bound.code, start)} works it out"
        if self.names.routine(bound.module, name) is not None:
            return Constant(Unknown(line))
        given = arguments(bound.code, start, end)
        parts = [self.compile(bound, *span, loops, deep - 1) for span in given.required]
        if name == "offs" and len(parts) == 4 and not given.options:
            return _together(parts, lambda values: offs(values[0], values[1:]) or Unknown(line))
        if name == "reltool" and len(parts) == 4 and {option.name for option in given.options} <= {"rx", "ry", "rz"}:
            turns = [given.option(axis) for axis in ("rx", "ry", "rz")]
            parts += [self.compile(bound, *turn.span, loops, deep - 1) if turn else Constant(0.0) for turn in turns]
            return _together(parts, lambda values: reltool(values[0], values[1:4], values[4:]) or Unknown(line))
        if name == "poseinv" and len(parts) == 1:
            return _together(parts, lambda values: _pose(line, lambda a: backwards(a), *values))
        if name == "posemult" and len(parts) == 2:
            return _together(parts, lambda values: _pose(line, lambda a, b: a @ b, *values))
        return Constant(Unknown(line))

    def _arithmetic(self, bound: BoundRoutine, start: int, end: int, loops: tuple[str, ...], deep: int) -> Value:
        code = bound.code
        line = f"{self.names.line(code, start)} works it out"
        place, cut = start, -1
        for sign in SIGN.finditer(code.plain, start, end):
            if sign.start() < place:
                continue
            letter = sign.group()
            if letter in "([{":
                place = max(code.closing(sign.start()), sign.start())
            elif code.plain[start : sign.start()].rstrip()[-1:] not in ("", "+", "-", "*", "/", "e", "E"):
                if cut < 0 or letter in "+-" or code.plain[cut] in "*/":
                    cut = sign.start()
            elif cut < 0 and letter in "+-" and not code.plain[start : sign.start()].strip():
                cut = sign.start()
        if cut < 0:
            return Constant(Unknown(line))
        right = self.compile(bound, cut + 1, end, loops, deep - 1)
        left = self.compile(bound, start, cut, loops, deep - 1) if code.plain[start:cut].strip() else Constant(0.0)
        work = OPERATORS[code.plain[cut]]
        return _together([left, right], lambda values: _number(line, work, *values))

    def mentioned(self, bound: BoundRoutine, start: int, end: int, loops: tuple[str, ...] = ()) -> list[Value]:
        """All data of an expression that may hold targets, each whole or the element that a plain index says."""
        values: list[Value] = []
        text = bound.code.plain[start:end]
        if text.isidentifier() or INNER.match(text):  # most arguments: no target's name, or a target's own numbers
            datum = bound.scope.datum(fold(text)) if text.isidentifier() else None
            if (datum is None and NAME_INSIDE.search(text) is None) or (datum is not None and not datum.holds_points):
                return values
        for match in WORD.finditer(bound.code.plain, start, end):
            name = fold(match.group(1))
            if name in WORDS_BEFORE_BRACKETS or name in loops:
                continue
            datum = bound.scope.datum(name)
            if datum is not None and datum.holds_points:
                whole = self._read(bound, name, match.end(1), match.end(1), loops, DEEPEST)
                part = self._read(bound, name, match.end(1), match.end(), loops, DEEPEST) if match.group(2) else whole
                values.append(_part_or_whole(part, whole))
            if match.group(2) and "," not in match.group(2):
                values += (
                    self.mentioned(bound, match.start(2) + 1, match.end(), loops) if _has_name(match.group(2)) else []
                )
        return values


def _has_name(text: str) -> bool:
    return re.search(NAME, text) is not None


def _part_or_whole(part: Value, whole: Value) -> Value:
    def value(state: ProgramState) -> object:
        own = part(state)
        return own if points_of(own) else whole(state)

    return value


def _together(parts: list[Value], work: Callable[[tuple[object, ...]], object]) -> Value:
    """What is worked out of several values: once, if they never change."""
    if all(isinstance(part, Constant) for part in parts):
        return Constant(work(tuple(part(ProgramState()) for part in parts)))
    return lambda state: work(tuple(part(state) for part in parts))


def part_of(value: object, indices: Sequence[object]) -> object:
    """A part of a value, counted from 1."""
    for index in indices:
        if isinstance(value, Unknown):
            return value
        if isinstance(index, Unknown):
            return index
        if not (isinstance(value, tuple) and type(index) is float and index in range(1, len(value) + 1)):
            return Unknown("it has no such part")
        value = value[int(index) - 1]
    return value


def with_part(value: object, place: tuple[int, ...], new: object) -> object:
    """A value with another part, counted from 1."""
    if not place:
        return new
    if isinstance(value, Unknown):
        return value
    if not (isinstance(value, tuple) and 1 <= place[0] <= len(value)):
        return Unknown("it has no such part")
    return (*value[: place[0] - 1], with_part(value[place[0] - 1], place[1:], new), *value[place[0] :])


def _pose(why: str, work: Callable[..., Frame], *values: object) -> object:
    frames = [transform(value) for value in values]
    if any(frame is None for frame in frames):
        return next((value for value in values if isinstance(value, Unknown)), Unknown(why))
    return as_pose(work(*frames))


def _number(why: str, work: Arithmetic, *values: object) -> object:
    plain = [value for value in values if isinstance(value, float)]
    if len(plain) < len(values):
        return next((value for value in values if isinstance(value, Unknown)), Unknown(why))
    return work(*plain)


def _shown(text: str) -> str:
    """How a target of a move is named: by its first numbers."""
    return " ".join(text.split("]")[0].split()) + "],…]" if "]" in text else " ".join(text.split())[:40]
