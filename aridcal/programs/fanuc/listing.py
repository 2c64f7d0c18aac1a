"""A listing of a TP program: its sections, instructions and points."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from aridcal.programs.fanuc.table import HEADERS
from aridcal.programs.text import NUMBER, Code, Number, number

SECTION = re.compile(r"(?:\A(?:\xef\xbb\xbf)?|(?<=[\r\n]))[ \t]*/(PROG|ATTR|APPL|MN|POS|END)\b")

NAME = re.compile(r"\s*(\S+)")

HEAD = re.compile(r"\s*(?:\d+[ \t]*:|:)?[ \t]*")
"""What stands before an instruction: its line's number."""

REMARK = re.compile(r"(?:!|//|--)[^;\n]*(?:\n(?![ \t]*\d+[ \t]*:)[^;\n]*)*+;?")
"""A remark, to its semicolon or to the next line with a number. What is remarked out is not carried out."""

NUMBERED = re.compile(r"\n[ \t]*\d+[ \t]*:")
"""The next line with a number: an instruction that comes so far has no end."""

BODY = re.compile(r"(?:'[^'\n]*'|[^;])*+")

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

LARGEST = 1e6
"""[mm] or [deg]: no arm is asked for more; such a number is a fault of the program."""

NESTED = 4
"""Brackets in brackets: the controller takes registers of registers, and no more."""


@dataclass(frozen=True)
class Instruction:
    """One instruction of /MN.

    Attributes:
        start: Where it begins in the text.
        text: As :func:`plain` writes it; empty where it cannot be told.
        raw: As it stands there, for messages.
    """

    start: int
    text: str
    raw: str


@dataclass(frozen=True)
class Point:
    """A point of /POS, group 1.

    Attributes:
        number: Of the point.
        start: Where it begins in the text.
        why: Why it cannot be corrected, whatever the program does with it; empty if it can be.
        user: Number of its user frame, or F: the active one.
        tool: Likewise of its tool.
        letters: N or F, U or D, T or B of CONFIG; none where there is no CONFIG.
        turns: The three turn numbers.
        fields: Numbers by name.
        units: Their units, in capitals.
    """

    number: int
    start: int
    why: str = ""
    user: str = "F"
    tool: str = "F"
    letters: tuple[Number, ...] = ()
    turns: tuple[Number, ...] = ()
    fields: Mapping[str, Number] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def joints(self) -> bool:
        """Whether it states joints."""
        return "J1" in self.fields


@dataclass(frozen=True)
class Listing:
    """A TP program.

    Attributes:
        code: Its file.
        name: Of the program, in capitals.
        instructions: Of /MN, remarks left out.
        points: Of /POS, by number.
        why: Why none of its points can be corrected; empty if they can be.
    """

    code: Code
    name: str
    instructions: tuple[Instruction, ...]
    points: Mapping[int, Point]
    why: str = ""


def read_listing(code: Code) -> Listing | None:
    """A program; None of a file that holds none."""
    marks = list(SECTION.finditer(code.text))
    ends = [*(mark.start() for mark in marks[1:]), len(code.text)]
    sections = [(mark.group(1), mark.end(), end) for mark, end in zip(marks, ends, strict=True)]
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
    instructions: tuple[Instruction, ...] = ()
    points: dict[int, Point] = {}
    for kind, start, end in sections:
        if kind == "PROG":
            match = NAME.match(code.text, start, end)
            name = match.group(1).upper() if match is not None else ""
        elif kind == "APPL":
            why = why or _foreign_header(code, start, end)
        elif kind == "MN":
            instructions += tuple(_instructions(code.text, start, end))
        elif kind == "POS":
            why = _read_points(code, start, end, points) or why
    return Listing(code, name, instructions, points, why)


def plain(raw: str) -> str:
    """An instruction in capitals, without names in brackets and text in quotes, a blank only between two words.

    Empty where brackets do not close: a name may hold a bracket, and then nothing of the instruction is certain.
    """
    text = re.sub(r"\n[ \t]*:", " ", raw)
    text = re.sub(r"'[^'\n]*'", "''", text)
    text = re.sub(r"(?<![\w.]) | (?![\w.$])", "", " ".join(text.split())).upper()
    for _ in range(NESTED):
        text, count = re.subn(r"\[((?:GP\d+(?:,GP\d+)*:)?[^\[\]:]*)(?::[^\[\]]*)?\]", "\1\\1\2", text)
        if not count:
            break
    return "" if "[" in text or "]" in text else text.translate(BRACKETS)


BRACKETS = str.maketrans("\1\2", "[]")


def _instructions(text: str, start: int, end: int) -> Iterator[Instruction]:
    place = start
    while place < end:
        head = HEAD.match(text, place, end)
        place = head.end() if head is not None else place
        remark = REMARK.match(text, place, end)
        if remark is not None:
            place = remark.end()
            continue
        body = BODY.match(text, place, end)
        assert body is not None  # it may be empty
        raw, stop = body.group(), body.end()
        if raw.strip():
            closed = stop < end and NUMBERED.search(raw) is None
            yield Instruction(place, plain(raw) if closed else "", " ".join(raw.split()))
        place = stop + 1


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
    fields: dict[str, Number] = {}
    units: dict[str, str] = {}
    place = head.end()
    while place < stop and (entry := FIELD.match(text, place, stop)) is not None:
        name = entry.group(1).upper()
        if name in fields or entry.group(3) is None:
            return Point(index, start, f"is not understood: {name}")
        fields[name], units[name] = number(entry, 2), entry.group(3).upper()
        place = entry.end()
    if text[place:stop].strip():
        return Point(index, start, f"is not understood: {' '.join(text[place:stop].split())[:SHOWN]}")
    return _checked(index, start, head, fields, units)


INDEX_DIGITS = 9
"""Digits of a number in brackets that are looked at: controllers count to thousands."""


def _checked(index: int, start: int, head: re.Match[str], fields: dict[str, Number], units: dict[str, str]) -> Point:
    """A point whose parts have been told apart."""
    user, tool = head.group(1).upper(), head.group(2).upper()
    letters: tuple[Number, ...] = ()
    turns: tuple[Number, ...] = ()
    why = ""
    if any("*" in n.text for n in fields.values()):
        why = "is not taught"
    elif any(not abs(n.value) <= LARGEST for n in fields.values()):
        why = "has a number that no arm can reach"
    elif "J1" not in fields and not set(POSE) <= set(fields):
        why = "has neither X Y Z W P R nor J1, J2, ..."
    elif "J1" in fields and set(POSE) & set(fields):
        why = "has joints and a pose"
    elif any(units[name] != unit for name, unit in UNITS.items() if name in units):
        why = "has a number in an unexpected unit"
    elif head.group(3) is not None:
        config = CONFIG.fullmatch(head.string, *head.span(3))
        if config is None:
            why = f"its CONFIG '{head.group(3)[:SHOWN].strip()}' is none of an arm of six axes"
        else:
            letters = tuple(number(config, k) for k in (1, 2, 3))
            turns = tuple(number(config, k) for k in (4, 5, 6))
    return Point(index, start, why, _index(user), _index(tool), letters, turns, fields, units)


def _index(text: str) -> str:
    """The number of a frame without leading zeros, or the word that stands for one."""
    return str(int(text[-INDEX_DIGITS:])) if text.isdecimal() else text
