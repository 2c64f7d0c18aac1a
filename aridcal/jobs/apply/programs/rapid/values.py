"""Data of RAPID: points, frames and numbers, as they stand in the text and as a program sets them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal as OneOf

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.jobs.apply.programs.notations import ABB, MILLI, inverse, pose
from aridcal.jobs.apply.programs.rapid.grammar import DataDeclaration, fold
from aridcal.jobs.apply.programs.rapid.table import FRAME_TYPES
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, NONE, NUMBER, Code, Numbers
from aridcal.jobs.apply.programs.uses import HERE, Frame
from aridcal.jobs.apply.programs.walk import Unknown

UNIT = 0.02
"""By which the length of a quaternion may differ from one: controllers take two digits, and refuse what is further off."""

NOT_USED = 8.9e9
"""External axes that there are not read 9E9."""


@dataclass(frozen=True)
class _Absent:
    """An optional parameter that the caller does not give."""


ABSENT = _Absent()


@dataclass(eq=False, slots=True)
class Datum:
    """Data of a program.

    Attributes:
        declared: As it stands in the text.
        code: The file.
        address: Of its value in a state.
        type: With aliases resolved.
        changed: What may change it, as messages say it; empty where nothing does.
        leaves: Numbers and words of a record that statements change one by one, each by its place, counted from 1; empty where
            it may be changed as a whole.
        whole: Whether it may be.
        owner: The routine that it belongs to; empty of a module's data.
        parameter: Whether the caller says what it is.
        value: That its declaration says; None until that is worked out.
    """

    declared: DataDeclaration
    code: Code
    address: tuple[str, str]
    type: str
    changed: str = ""
    leaves: frozenset[tuple[int, ...]] = frozenset()
    whole: bool = False
    owner: str = ""
    parameter: bool = False
    value: object = None

    def leaf(self, place: tuple[int, ...]) -> tuple[str, str]:
        """The address of a part in a state."""
        return self.address[0], f"{self.address[1]}.{'.'.join(map(str, place))}"

    @property
    def addresses(self) -> list[tuple[str, str]]:
        """All of its addresses."""
        return [self.address] if self.whole or not self.leaves else [self.leaf(place) for place in sorted(self.leaves)]

    @property
    def holds_points(self) -> bool:
        """Whether its values are targets."""
        return self.type in ("robtarget", "jointtarget")


@dataclass(frozen=True)
class Alias:
    """The value of a parameter that stands for data of the caller."""

    datum: Datum


@dataclass(eq=False, slots=True)
class Literal:
    """A robtarget or a jointtarget that stands in the text.

    Attributes:
        code: The file.
        start: Its first bracket.
        end: Behind its last one.
        name: What the program calls it.
        form: Of its numbers.
        why: Why it has no plain meaning; empty if it has.
        numbers: Of place and rotation, or of the arm's axes.
        configuration: Of confdata.
        key: Its file and its place there.
    """

    code: Code
    start: int
    end: int
    name: str
    form: OneOf["joints", "pose"]
    why: str = ""
    numbers: Numbers = NONE
    configuration: Numbers = NONE
    key: tuple[int, int] = field(init=False)

    def __post_init__(self) -> None:
        self.key = self.code.file, self.start

    @property
    def external(self) -> Numbers:
        """Of external axes."""
        match = FORMS[self.form].fullmatch(self.code.plain, self.start, self.end)
        assert match is not None
        return Numbers.packed(match.regs[-6:], match.groups()[-6:])


@dataclass(frozen=True, slots=True)
class Point:
    """A place of the text's numbers, or a constant way off from it.

    Attributes:
        literal: The numbers.
        before: A displacement in the frame of the point; None for none.
        after: A displacement in the frame of the tool that is there; None for none.
    """

    literal: Literal
    before: Frame | None = None
    after: Frame | None = None


COMMA = r"\s*,\s*"


def _brackets(*counts: int) -> re.Pattern[str]:
    """Lists of so many numbers each, in one list."""
    parts = [rf"\[\s*{COMMA.join([f'({NUMBER.pattern})'] * count)}\s*\]" for count in counts]
    return re.compile(rf"\[\s*{COMMA.join(parts)}\s*\]")


FORMS = {"pose": _brackets(3, 4, 4, 6), "joints": _brackets(6, 6)}


def literal(code: Code, start: int, end: int, name: str, form: OneOf["joints", "pose"]) -> Literal:
    """The target that stands between two places."""
    match = FORMS[form].fullmatch(code.plain, start, end)
    if match is None:
        return Literal(code, start, end, name, form, "is no plain numbers")
    spans, texts = match.regs[1:], match.groups()
    numbers = [float(text) for text in texts[:7]]
    if max(map(abs, numbers[:6])) > LARGEST_IN_PROGRAM:
        return Literal(code, start, end, name, form, "has numbers that no arm has")
    if form == "pose" and abs(math.hypot(*numbers[3:7]) - 1.0) > UNIT:
        return Literal(code, start, end, name, form, "has no unit quaternion")
    if form == "joints":
        return Literal(code, start, end, name, form, "", Numbers.packed(spans[:6], texts[:6]))
    configuration = Numbers.packed(spans[7:11], texts[7:11])
    return Literal(code, start, end, name, form, "", Numbers.packed(spans[:7], texts[:7]), configuration)


def leaves(kind: str, place: tuple[int, ...] = ()) -> Iterator[tuple[int, ...]]:
    """Places of all numbers and words of a type's records."""
    if kind not in FRAME_TYPES:
        yield place
    for k, (_, inner) in enumerate(FRAME_TYPES.get(kind, ()), 1):
        yield from leaves(inner, (*place, k))


def component(kind: str, path: str) -> tuple[tuple[int, ...], str] | None:
    """The place and the type of a part of a record, ``.uframe.trans.z``; None where it has no such part."""
    place: tuple[int, ...] = ()
    for name in path.replace(" ", "").split(".")[1:]:
        names = [own for own, _ in FRAME_TYPES.get(kind, ())]
        if fold(name) not in names:
            return None
        k = names.index(fold(name))
        place, kind = (*place, k + 1), FRAME_TYPES[kind][k][1]
    return place, kind


def doubt(value: object) -> Unknown | None:
    """What is not certain of a value; None where all of it is."""
    if isinstance(value, Unknown):
        return value
    return next((own for part in value if (own := doubt(part))), None) if isinstance(value, tuple) else None


def transform(value: object) -> Frame | None:
    """The frame of a pose ((x, y, z), (q1, q2, q3, q4)); None where it is none."""
    if not (isinstance(value, tuple) and len(value) == 2 and all(isinstance(part, tuple) for part in value)):
        return None
    place, turn = value
    if (
        len(place) != 3
        or len(turn) != 4
        or not all(type(n) is float and abs(n) <= LARGEST_IN_PROGRAM for n in (*place, *turn))
    ):
        return None
    if abs(math.hypot(*turn) - 1.0) > UNIT:
        return None
    return Frame(ABB.pose(np.array([*place, *turn])))


def as_pose(frame: Frame) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The value of a frame as RAPID keeps it."""
    numbers = ABB.numbers(frame.T, np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])).tolist()
    return tuple(numbers[:3]), tuple(numbers[3:])


def tool_frame(name: str, value: object) -> Frame | Unknown:
    """T_tip_tool of a tooldata."""
    if (unsure := doubt(value)) is not None:
        return Unknown(f"the tool {name}: {unsure.why}")
    if not (isinstance(value, tuple) and len(value) == 3):
        return Unknown(f"the tool {name} is no plain numbers")
    if value[0] is not True:
        return Unknown(f"the tool {name} is not held by the robot")
    return transform(value[1]) or Unknown(f"the tool {name} is no plain numbers")


def object_frame(name: str, value: object) -> Frame | Unknown:
    """T_base_object of a wobjdata."""
    if (unsure := doubt(value)) is not None:
        return Unknown(f"the work object {name}: {unsure.why}")
    if not (isinstance(value, tuple) and len(value) == 5):
        return Unknown(f"the work object {name} is no plain numbers")
    if value[0] is not False:
        return Unknown(f"the work object {name} is held by the robot")
    if value[1] is not True:
        return Unknown(f"the user frame of the work object {name} is moved by a mechanical unit")
    user, own = transform(value[3]), transform(value[4])
    if user is None or own is None:
        return Unknown(f"the work object {name} is no plain numbers")
    return user @ own


def offs(point: object, numbers: tuple[object, ...]) -> object:
    """`Offs`: a place some way off in the frame of the point."""
    way = _plain(numbers)
    if not isinstance(point, Point) or point.literal.form != "pose" or way is None or len(way) != 3:
        return None
    if not any(way):
        return point
    step = Frame(pose(MILLI * np.array(way), Rotation.identity()))
    return Point(point.literal, step @ (point.before or HERE), point.after)


def reltool(point: object, numbers: tuple[object, ...], turns: tuple[object, ...]) -> object:
    """`RelTool`: a place some way off in the frame of the tool; turned about x, then the new y, then the newest z."""
    way, angles = _plain(numbers), _plain(turns)
    if not isinstance(point, Point) or point.literal.form != "pose" or way is None or angles is None or len(way) != 3:
        return None
    if not any(way) and not any(angles):
        return point
    step = Frame(pose(MILLI * np.array(way), Rotation.from_euler("XYZ", angles, degrees=True)))
    return Point(point.literal, point.before, (point.after or HERE) @ step)


def _plain(values: tuple[object, ...]) -> tuple[float, ...] | None:
    plain = tuple(value for value in values if type(value) is float and abs(value) <= LARGEST_IN_PROGRAM)
    return plain if len(plain) == len(values) else None


def backwards(frame: Frame) -> Frame:
    """The inverse of a frame."""
    return Frame(inverse(frame.T))


def points_of(value: object) -> list[Literal]:
    """All literals that a value is made of."""
    if isinstance(value, Point):
        return [value.literal]
    if isinstance(value, tuple):
        return [literal for part in value for literal in points_of(part)]
    return []


@dataclass
class Scope:
    """Names that a routine sees, its own before those of its module before those of all."""

    levels: tuple[dict[str, Datum], ...] = field(default_factory=tuple)

    def datum(self, name: str) -> Datum | None:
        """The data of a name, in small letters."""
        for level in self.levels:
            if name in level:
                return level[name]
        return None
