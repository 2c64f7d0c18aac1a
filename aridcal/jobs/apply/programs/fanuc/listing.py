"""A listing of a TP program: its sections, instructions and points."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from aridcal.jobs.apply.programs.fanuc.table import HEADERS
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, NONE, NUMBER, Code, Number, Numbers

SECTION = re.compile(r"(?:\A(?:\xef\xbb\xbf)?|(?<=[\r\n]))[ \t]*/(PROG|ATTR|APPL|MN|POS|END)\b")

NAME = re.compile(r"\s*(\S+)")

INSTRUCTION = re.compile(r"\s*+(?:\d++[ \t]*+:|:)?[ \t]*+((?:'[^'\n]*'|[^;])*)")
"""The number of its line, and an instruction, which may be empty."""

REMARKS = ("!", "//", "--")

REMARK = re.compile(r"(?:!|//|--)[^;\n]*(?:\n(?![ \t]*\d+[ \t]*:)[^;\n]*)*;?")
"""A remark, to its semicolon or to the next line with a number. What is remarked out is not carried out."""

NUMBERED = re.compile(r"\n[ \t]*\d+[ \t]*:")
"""The next line with a number: an instruction that comes so far has no end."""

POINT = re.compile(r"\s*P\s*\[\s*(\d+)\s*(?::\s*(?:\"[^\n]*?\"|[^\n\"\]]*))?\s*\]\s*\{([^{}]*)\}\s*;?", re.IGNORECASE)
"""A point of /POS. Its comment may contain brackets of any kind."""

GROUP = re.compile(r"\bGP(\d+)\s*:", re.IGNORECASE)

FRAMES = re.compile(
    r"\s*UF\s*:\s*(\w+)\s*,\s*UT\s*:\s*(\w+)\s*,?\s*(?:CONFIG\s*:\s*'([^'\n]*)'\s*,?)?\s*", re.IGNORECASE
)

CONFIG = re.compile(r"\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*")

FIELD = re.compile(
    rf"\s*(X|Y|Z|W|P|R|[JE]\d)\s*=\s*({NUMBER.pattern}|\*+)\s*(mm|deg)?\s*(?:,\s*|(?=[A-Z])|\Z)", re.IGNORECASE
)

POSE = ("X", "Y", "Z", "W", "P", "R")

UNITS = dict.fromkeys(POSE[:3], "MM") | dict.fromkeys(POSE[3:], "DEG")

POSED = re.compile(
    r"\s*GP1\s*:\s*UF : (\w+), UT : (\w+),\s*CONFIG : '([NF]) ([UD]) ([TB]), (-?\d+), (-?\d+), (-?\d+)',\s*"
    + r"\s*,\s*".join(rf"{name} *= *({NUMBER.pattern})\s*{unit.lower()}" for name, unit in UNITS.items())
    + r"\s*\Z"
)
"""A pose of one group as controllers write it; points in another form are taken apart field by field."""

POSED_UNITS = tuple(UNITS.values())

NESTED = 4
"""Brackets in brackets: the controller takes registers of registers, and no more."""


class Instruction(NamedTuple):
    """One instruction of /MN.

    Attributes:
        start: Where it begins in the text.
        raw: As it stands there.
        closed: Whether it has an end.
    """

    start: int
    raw: str
    closed: bool = True

    @property
    def text(self) -> str:
        """As :func:`plain` writes it; empty where it cannot be told."""
        return plain(self.raw) if self.closed else ""


class Point(NamedTuple):
    """A point of /POS, group 1.

    Attributes:
        number: Of the point.
        start: Where it begins in the text.
        why: Why it cannot be corrected, whatever the program does with it; empty if it can be.
        user: Number of its user frame, or F: the active one.
        tool: Likewise of its tool.
        config: N or F, U or D, T or B of CONFIG and the three turn numbers; none where there is no CONFIG.
        names: Of its numbers: X or J1, for instance.
        numbers: They.
        units: Their units, in capitals.
    """

    number: int
    start: int
    why: str = ""
    user: str = "F"
    tool: str = "F"
    config: Numbers = NONE
    names: tuple[str, ...] = ()
    numbers: Numbers = NONE
    units: tuple[str, ...] = ()

    @property
    def joints(self) -> bool:
        """Whether it states joints."""
        return "J1" in self.names

    def field(self, name: str) -> Number:
        """One of its numbers."""
        return self.numbers[self.names.index(name)]


@dataclass(frozen=True)
class Listing:
    """A TP program.

    Attributes:
        code: Its file.
        name: Of the program, in capitals.
        points: Of /POS, by number.
        span: Where /MN begins and ends.
        why: Why none of its points can be corrected; empty if they can be.
    """

    code: Code
    name: str
    points: Mapping[int, Point]
    span: tuple[int, int] = (0, 0)
    why: str = ""

    def instructions(self) -> Iterator[Instruction]:
        """Those of /MN, remarks left out."""
        text, (place, end) = self.code.text, self.span
        while place < end:
            match = INSTRUCTION.match(text, place, end)
            assert match is not None
            raw, (start, stop) = match.group(1), match.span(1)
            if raw.startswith(REMARKS):
                remark = REMARK.match(text, start, end)
                assert remark is not None
                place = remark.end()
                continue
            if raw and not raw.isspace():
                yield Instruction(start, raw, stop < end and ("\n" not in raw or NUMBERED.search(raw) is None))
            place = stop + 1


def read_listing(code: Code) -> Listing | None:
    """A program; None of a file that holds none."""
    marks = list(SECTION.finditer(code.text))
    ends = [*(mark.start() for mark in marks), len(code.text)][1:]
    sections = [(mark.group(1), mark.end(), end) for mark, end in zip(marks, ends, strict=False)]
    kinds = [kind for kind, _, _ in sections]
    if "PROG" not in kinds:
        return None
    if any(kinds.count(kind) > 1 for kind in ("PROG", "MN", "POS")):
        why = "the file has a section twice: give each program a file of its own"
    elif "MN" not in kinds or kinds.index("MN") < kinds.index("PROG"):
        why = "the file has no section /MN behind /PROG"
    else:
        why = ""
    name = ""
    span = (0, 0)
    points: dict[int, Point] = {}
    for kind, start, end in sections:
        if kind == "PROG":
            match = NAME.match(code.text, start, end)
            name = match.group(1).upper() if match is not None else ""
        elif kind == "APPL":
            why = why or _foreign_header(code, start, end)
        elif kind == "MN":
            span = (start, end)
        elif kind == "POS":
            why = _read_points(code, start, end, points) or why
    return Listing(code, name, points, span, why)


def plain(raw: str) -> str:
    """An instruction in capitals, without names in brackets and text in quotes, a blank only between two words.

    Empty where brackets do not close: a name may hold a bracket, and then nothing of the instruction is certain.
    """
    text = CONTINUED.sub(" ", raw) if "\n" in raw else raw
    text = QUOTED.sub("''", text) if "'" in text else text
    text = LOOSE.sub("", " ".join(text.split())).upper()
    for _ in range(NESTED):
        if "[" not in text:
            break
        text = BRACKET.sub("\1\\1\2", text)
    return "" if "[" in text or "]" in text else text.translate(BRACKETS)


CONTINUED, QUOTED = re.compile(r"\n[ \t]*:"), re.compile(r"'[^'\n]*'")

LOOSE = re.compile(r"(?<![\w.]) | (?![\w.$])")
"""A blank that does not part two words."""

BRACKET = re.compile(r"\[((?:GP\d+(?:,GP\d+)*:)?[^\[\]:]*)(?::[^\[\]]*)?\]")
"""The innermost brackets: groups, the number, and the name, which means nothing."""

BRACKETS = str.maketrans("\1\2", "[]")


def _foreign_header(code: Code, start: int, end: int) -> str:
    """Why a program's application data leave its points uncertain; empty if they do not."""
    for part in re.finditer(r"[^;]+", code.text[start:end]):
        text = re.sub(r"\s*([:=,*])\s*", r"\1", " ".join(part.group().split())).upper()
        if text and _HEADER.fullmatch(text) is None:
            line = code.line(start + part.end() - len(part.group().lstrip()))
            return f"line {line}: {text[:SHOWN]} of /APPL is not understood"
    return ""


_HEADER = re.compile("|".join(HEADERS))

SHOWN = 40
"""Letters of a text that a message shows."""


def _read_points(code: Code, start: int, end: int, points: dict[int, Point]) -> str:
    """Read /POS; returns why none of its points is certain."""
    place = start
    while (match := POINT.match(code.text, place, end)) is not None:
        point = _point(code.text, match)
        twice = points.get(point.number)
        if twice is not None:
            lines = f"lines {code.line(twice.start)} and {code.line(point.start)}"
            return f"P[{point.number}] stands twice, {lines}"
        points[point.number] = point
        place = match.end()
    rest = code.text[place:end]
    if rest.strip():
        return f"line {code.line(place + len(rest) - len(rest.lstrip()))} of /POS is not understood"
    return ""


def _point(text: str, match: re.Match[str]) -> Point:
    start, (begin, end) = match.start(1), match.span(2)
    index = int(match.group(1)[-INDEX_DIGITS:])
    usual = POSED.match(text, begin, end)
    if usual is not None:
        return _usual_point(index, start, usual)
    groups = list(GROUP.finditer(text, begin, end))
    spans = {int(g.group(1)[-INDEX_DIGITS:]): g.end() for g in groups}
    if len(spans) != len(groups) or text[begin : groups[0].start() if groups else end].strip():
        return Point(index, start, "is not understood")
    if 1 not in spans:
        return Point(index, start, "has no group GP1")
    stop = min((g.start() for g in groups if g.start() > spans[1]), default=end)
    head = FRAMES.match(text, spans[1], stop)
    if head is None:
        return Point(index, start, "is not understood: UF and UT are missing")
    stated = CONFIG.fullmatch(text, *head.span(3)) if head.group(3) is not None else None
    names, numbers, units, rest = _fields(text, head.end(), stop)
    if rest:
        return Point(index, start, f"is not understood: {rest[:SHOWN]}")
    why = _fault(names, numbers, units)
    if head.group(3) is not None and stated is None:
        why = why or f"its CONFIG '{head.group(3)[:SHOWN].strip()}' is none of an arm of six axes"
    words = NONE if stated is None else Numbers.packed(stated.regs[1:], stated.groups())
    user, tool = _index(head.group(1).upper()), _index(head.group(2).upper())
    return Point(index, start, why, user, tool, words, names, Numbers(numbers), units)


def _usual_point(index: int, start: int, match: re.Match[str]) -> Point:
    """A point in the form of :data:`POSED`."""
    spans, texts = match.regs, match.groups()
    words, numbers = Numbers.packed(spans[3:9], texts[2:8]), Numbers.packed(spans[9:], texts[8:])
    return Point(
        index, start, _beyond(texts[8:]), _index(texts[0]), _index(texts[1]), words, POSE, numbers, POSED_UNITS
    )


def _fields(text: str, start: int, end: int) -> tuple[tuple[str, ...], tuple[Number, ...], tuple[str, ...], str]:
    """Names, numbers and units of a point's fields, and what stands there that is none."""
    names: list[str] = []
    numbers: list[Number] = []
    units: list[str] = []
    while start < end and (entry := FIELD.match(text, start, end)) is not None:
        names.append(entry.group(1).upper())
        numbers.append(Number(entry.start(2), entry.group(2)))
        units.append((entry.group(3) or "").upper())
        start = entry.end()
    return _same(tuple(names)), tuple(numbers), _same(tuple(units)), " ".join(text[start:end].split())


INDEX_DIGITS = 9
"""Digits of a number in brackets that are looked at: controllers count to thousands."""


def _fault(names: Sequence[str], numbers: Sequence[Number], units: Sequence[str]) -> str:
    """Why the numbers of a point are no place; empty if they are one."""
    if any("*" in n.text for n in numbers):
        return "is not taught"
    beyond = _beyond([n.text for n in numbers])
    if beyond:
        return beyond
    if not all(units) or len(set(names)) < len(names):
        return "is not understood: it has a number twice, or without a unit"
    posed = [name for name in POSE if name in names]
    if "J1" in names and posed:
        return "has joints and a pose"
    if "J1" not in names and len(posed) < len(POSE):
        return "has neither X Y Z W P R nor J1, J2, ..."
    if any(UNITS.get(name, unit) != unit for name, unit in zip(names, units, strict=True)):
        return "has a number in an unexpected unit"
    return ""


def _beyond(texts: Sequence[str]) -> str:
    """Why a number is none of a place; empty if all are."""
    return (
        "has a number that no arm can reach"
        if max(map(abs, map(float, texts)), default=0.0) > LARGEST_IN_PROGRAM
        else ""
    )


@lru_cache(maxsize=64)
def _same(words: tuple[str, ...]) -> tuple[str, ...]:
    """The words, one tuple for all points that have the same."""
    return words


def _index(text: str) -> str:
    """The number of a frame without leading zeros, or the word that stands for one."""
    return str(int(text[-INDEX_DIGITS:])) if text.isdecimal() else text
