"""Expressions and statements of KRL, as the reader of a file gives them to what carries them out."""

from __future__ import annotations

from collections.abc import Iterator, KeysView, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from aridcal.jobs.apply.programs.notations import KUKA
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, Number, Numbers
from aridcal.jobs.apply.programs.uses import Frame

POSE = ("x", "y", "z", "a", "b", "c")

AXES = tuple(f"a{k}" for k in range(1, 7))

EXTERNAL = tuple(f"e{k}" for k in range(1, 7))

_OF_AXES = frozenset((*AXES, *EXTERNAL))

_OF_POSES = frozenset((*POSE, "s", "t", *EXTERNAL))


@dataclass(frozen=True, slots=True)
class Text:
    """A text in quotes."""


@dataclass(frozen=True, slots=True)
class Bits:
    """A number in binary or hexadecimal digits.

    Attributes:
        written: As it stands there, in quotes.
    """

    written: Number


@dataclass(frozen=True, slots=True)
class Word:
    """A value of an enumeration.

    Attributes:
        name: With its ``#``, in small letters.
    """

    name: str


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable, an element of it, or a part of it.

    Attributes:
        start: Its place in the text.
        shown: As messages name it.
        key: Name of the variable in the whole project.
        shared: Whether routines of other files reach it.
        index: Of an element: plain numbers; None where it has none.
        worked_out: Whether the index is worked out by the program, so that it may be any element.
        path: Names of the part.
        inside: Expressions of indices.
    """

    start: int
    shown: str
    key: str
    shared: bool
    index: tuple[float, ...] | None = None
    worked_out: bool = False
    path: tuple[str, ...] = ()
    inside: tuple[Expression, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether it is all of a variable or of one known element."""
        return not self.path and not self.worked_out

    @property
    def element(self) -> tuple[str, tuple[float, ...] | None]:
        """The variable and the index: what a value is kept under."""
        return self.key, self.index


class Fields(Mapping[str, Number]):
    """Fields of an aggregate that are all plain numbers, packed: a long program has a hundred thousand of a few forms.

    Args:
        names: In small letters, in the order of the text.
        numbers: What stands there.
    """

    __slots__ = ("_places", "names", "numbers")

    def __init__(self, names: tuple[str, ...], numbers: Numbers) -> None:
        self.names, self._places = _form(names)
        self.numbers = numbers

    def __getitem__(self, name: str) -> Number:
        return self.numbers[self._places[name]]

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def keys(self) -> KeysView[str]:
        """Their names."""
        return self._places.keys()

    @property
    def why(self) -> str:
        """Why these are not the numbers of a target; empty if they are."""
        strange, lacking = _unlike_a_target(self.names)
        if max(map(abs, map(float, self.numbers.texts))) <= LARGEST_IN_PROGRAM:
            return strange or lacking
        name = next(
            name
            for name, number in zip(self.names, self.numbers, strict=True)
            if abs(number.value) > LARGEST_IN_PROGRAM
        )
        return strange or f"has {name.upper()} beyond a million"


@lru_cache(maxsize=256)
def _form(names: tuple[str, ...]) -> tuple[tuple[str, ...], dict[str, int]]:
    """Names of fields, and the place of each among them, the same objects for all aggregates of one form."""
    return names, {name: k for k, name in enumerate(names)}


@lru_cache(maxsize=256)
def _unlike_a_target(names: tuple[str, ...]) -> tuple[str, str]:
    """Which field no target has, and which a target's pose lacks; empty where all is well."""
    jointed = _says_axes(frozenset(names))
    strange = next((name for name in names if name not in (_OF_AXES if jointed else _OF_POSES)), "")
    lacking = "" if jointed else " ".join(name for name in POSE if name not in names)
    return (
        f"has a field {strange.upper()}, which no target has" if strange else "",
        f"does not state {lacking.upper()}: these stay as they are" if lacking else "",
    )


@lru_cache(maxsize=256)
def _says_axes(names: frozenset[str]) -> bool:
    return bool(names) and (not names.isdisjoint(AXES) or names <= _OF_AXES)


@dataclass(frozen=True)
class Aggregate:
    """A structure {X 1, Y 2, ...}.

    Attributes:
        place: Its file and its place in the text; None once a part of it was written.
        end: Of the text, behind its bracket.
        fields: By name in small letters: a :class:`Number`, or another expression.
    """

    place: tuple[int, int] | None
    end: int
    fields: Mapping[str, Expression]

    @property
    def jointed(self) -> bool:
        """Whether it says axes."""
        return _says_axes(frozenset(self.fields.keys()))

    @property
    def point(self) -> bool:
        """Whether a move could go there."""
        return not self.fields.keys().isdisjoint((*POSE, *AXES)) and "m" not in self.fields

    @property
    def why(self) -> str:
        """Why its numbers are not those of a target; empty if they are."""
        fields = self.fields
        if isinstance(fields, Fields):
            return fields.why
        strange, lacking = _unlike_a_target(tuple(fields))
        for name, value in fields.items():
            if isinstance(value, Bits) and name in ("s", "t") and " " not in value.written.text:
                continue
            if isinstance(value, Bits):
                return strange or f"has {name.upper()} in bits: write it as a decimal number"
            if not isinstance(value, Number):
                return strange or f"has {name.upper()} that is no plain number"
            if not abs(value.value) <= LARGEST_IN_PROGRAM:
                return strange or f"has {name.upper()} beyond a million"
        return strange or lacking

    @cached_property
    def frame(self) -> Frame | None:
        """The transform of six plain numbers; None if it is none."""
        values = [v.value for name in POSE if isinstance(v := self.fields.get(name), Number)]
        if len(values) < len(POSE) or not all(abs(v) <= LARGEST_IN_PROGRAM for v in values):
            return None
        return Frame(KUKA.pose(np.array(values)))

    @property
    def states_posture(self) -> bool:
        """Whether S and T stand there."""
        return "s" in self.fields and "t" in self.fields

    def __hash__(self) -> int:
        return hash((self.place, self.end))


@dataclass(frozen=True, slots=True)
class Function:
    """A call with its arguments.

    Attributes:
        start: Its place in the text.
        name: In small letters.
        routine: Its key among the project's routines; the name where no file has it.
        arguments: Expressions.
    """

    start: int
    name: str
    routine: str
    arguments: tuple[Expression, ...] = ()


@dataclass(frozen=True, slots=True)
class Product:
    """Frames behind each other, by the geometric operator.

    Attributes:
        factors: From the left.
    """

    factors: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Computation:
    """Anything else that is worked out.

    Attributes:
        parts: What it is worked out from.
    """

    parts: tuple[Expression, ...]


Expression = Number | Text | Bits | Word | Variable | Aggregate | Function | Product | Computation


def variables(expression: Expression) -> Iterator[Variable]:
    """All variables that an expression reads."""
    if isinstance(expression, Variable):
        yield expression
        for part in expression.inside:
            yield from variables(part)
    for part in parts(expression):
        yield from variables(part)


def parts(expression: Expression) -> tuple[Expression, ...]:
    """What an expression is made of."""
    if isinstance(expression, Aggregate):
        if isinstance(expression.fields, Fields):
            return ()
        return tuple(value for value in expression.fields.values() if not isinstance(value, Number | Word | Text))
    if isinstance(expression, Function):
        return expression.arguments
    if isinstance(expression, Product):
        return expression.factors
    return expression.parts if isinstance(expression, Computation) else ()


@dataclass(frozen=True, slots=True)
class Assignment:
    """``to = value``."""

    to: Variable
    value: Expression


@dataclass(frozen=True, slots=True)
class Goal:
    """Where a move goes: a point, with frames before and behind it.

    Attributes:
        start: Its place in the text.
        end: Behind it.
        point: The point.
        before: Frames that the point is in.
        behind: Frames by which the tool is shifted at the point.
    """

    start: int
    end: int
    point: Expression
    before: tuple[Expression, ...] = ()
    behind: tuple[Expression, ...] = ()


@dataclass(frozen=True, slots=True)
class Move:
    """A move.

    Attributes:
        start: Its place in the text.
        file: Index in the project.
        word: PTP, LIN, ... in small letters.
        targets: One, or the auxiliary point and the end of a circle; none of a step.
        why: Why its targets are not the places that the arm comes to; empty if they are.
        settings: What holds for this move alone.
    """

    start: int
    file: int
    word: str
    targets: tuple[Goal, ...]
    why: str = ""
    settings: tuple[Assignment, ...] = ()


@dataclass(frozen=True, slots=True)
class UnclearStatement:
    """A statement that the tables do not have.

    Attributes:
        why: For the user.
    """

    why: str


@dataclass(frozen=True, slots=True)
class ControllerCall:
    """A statement of the tables that calls a routine of the controller."""

    call: Function
    line: str


Statement = Assignment | Move | UnclearStatement | ControllerCall
