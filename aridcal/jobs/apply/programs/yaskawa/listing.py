"""A job: its head, its positions and its instructions, as they stand in the file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, NONE, NUMBER, Code, Numbers
from aridcal.jobs.apply.programs.yaskawa.table import HEADERS

LINE = re.compile(r"[^\r\n]+")

POSITION = re.compile(r"\s*(C|BC|EC|P|BP|EX)(\d{1,9})\s*=(.*)", re.DOTALL)

PART = re.compile(rf"\s*({NUMBER.pattern})\s*(?:,|\Z)")
"""A number between commas."""

HEADER = re.compile("|".join(HEADERS))

CARTESIAN = ("BASE", "ROBOT", "USER")
"""Coordinates that stand still."""

MARK_OF_UTF8 = "\xef\xbb\xbf"

MOVES = ("MOV", "SMOV")
"""What instructions begin with that may go on in the next line."""

AXES = 6

SHOWN = 40
"""Letters of a text that a message shows."""

REMARK = re.compile(r"\"[^\"]*\"|'.*|//.*", re.DOTALL)
"""Text in quotes, or a remark."""


class Position(NamedTuple):
    """A position of //POS, of the robot: that of a step (C), or a variable (P).

    Attributes:
        name: As it stands there.
        kind: C or P.
        number: Of the position.
        start: Where it begins in the text.
        why: Why it cannot be corrected, whatever the job does with it; empty if it can be.
        frame: BASE, ROBOT or USER; PULSE of pulses of the axes.
        user: Number of its user frame; empty of another frame.
        tool: Number of its tool.
        posture: Of RCONF, without the zeros behind.
        numbers: They.
    """

    name: str
    kind: str
    number: int
    start: int
    why: str = ""
    frame: str = ""
    user: str = ""
    tool: str = ""
    posture: tuple[int, ...] = ()
    numbers: Numbers = NONE

    @property
    def pulses(self) -> bool:
        """Whether it counts pulses of the axes."""
        return self.frame == "PULSE"


class Instruction(NamedTuple):
    """An instruction.

    Attributes:
        start: Where it begins in the text.
        text: As :func:`plain` writes it.
        raw: As it stands there.
    """

    start: int
    text: str
    raw: str


@dataclass
class Job:
    """A job.

    Attributes:
        code: Its file.
        name: In capitals.
        positions: Of the robot, by kind and number.
        instructions: In their order, remarks left out.
        relative: Whether its positions are in the frame that its caller names.
        frame: Of a relative job: what it is taught in, as ``USER 2``.
        groups: Groups of axes that it moves: RB1, ST1.
        why: Why none of its positions can be corrected; empty if they can be.
    """

    code: Code
    name: str = ""
    positions: dict[tuple[str, int], Position] = field(default_factory=dict)
    instructions: list[Instruction] = field(default_factory=list)
    relative: bool = False
    frame: str = ""
    groups: tuple[str, ...] = ()
    why: str = ""

    def wrong(self, start: int, what: str) -> None:
        """The first reason why none of its positions is certain."""
        self.why = self.why or f"line {self.code.line(start)} {what}"


@dataclass
class _Head:
    """What the lines of //POS say of the positions behind them."""

    kind: str = ""
    data: str = ""
    user: str = ""
    tool: str = ""
    posture: tuple[int, ...] | None = None


def read_job(code: Code) -> Job | None:
    """A job; None of a file that holds none."""
    job, head, section = Job(code), _Head(), ""
    for start, line in _lines(code.text):
        if line.removeprefix(MARK_OF_UTF8).startswith("/JOB"):
            if section:
                job.wrong(start, "begins a second job: give each job a file of its own")
            section = "JOB"
        elif section == "INST" and not line.startswith("///"):
            _read_instruction(job, start, line)
        elif line.startswith("///"):
            _read_head(job, head, section, start, line.lstrip("/"))
        elif line.startswith("//") and section:
            word, _, rest = line[2:].partition(" ")
            if word == "NAME":
                job.name = rest.strip().upper()
            elif word in ("POS", "INST", "ARGINFO"):
                section = word
            else:
                job.wrong(start, f"is not understood: {line[:SHOWN]}")
        elif section == "POS" and not line.startswith("'"):
            _read_position(job, head, start, line)
    if not section:
        return None
    _judge(job)
    return job


def plain(raw: str) -> str:
    """An instruction in capitals, without text in quotes and remarks, single blanks between its words."""
    text = REMARK.sub(lambda match: '""' if match.group().startswith('"') else "", raw)
    return " ".join(text.split()).upper()


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines that are not blank, each with its first letter's place."""
    for match in LINE.finditer(text):
        line = match.group().strip()
        if line:
            yield match.start() + len(match.group()) - len(match.group().lstrip()), line


def _read_instruction(job: Job, start: int, line: str) -> None:
    """Take a line of //INST; behind a move one that begins with + goes on with it."""
    text = plain(line)
    if not text:
        return
    if text.startswith("+") and job.instructions and job.instructions[-1].text.startswith(MOVES):
        before = job.instructions.pop()
        job.instructions.append(Instruction(before.start, f"{before.text} {text}", f"{before.raw} {line}"))
    else:
        job.instructions.append(Instruction(start, text, line))


def _read_head(job: Job, head: _Head, section: str, start: int, line: str) -> None:
    """Take a line that begins with three slashes or more."""
    word, _, rest = line.partition(" ")
    rest = rest.strip()
    if section == "POS" and word in ("NPOS", "RECTAN", "PULSE", "POSTYPE", "USER", "TOOL", "RCONF"):
        if word in ("RECTAN", "PULSE"):
            head.data = word
        elif word == "POSTYPE":
            head.kind = rest
        elif word == "USER":
            head.user = _index(rest)
        elif word == "TOOL":
            head.tool = _index(rest)
        elif word == "RCONF":
            head.posture = _posture(rest)
    elif word.startswith("GROUP"):
        job.groups += tuple(group.strip() for group in rest.split(",") if group.strip())
    elif word == "FRAME":
        job.frame = " ".join(rest.split())
    elif word == "ATTR":
        job.relative = "RJ" in [attribute.strip() for attribute in rest.split(",")]
    elif section != "ARGINFO" and HEADER.fullmatch(line.strip()) is None:
        job.wrong(start, f"is not understood: ///{line[:SHOWN]}")


def _read_position(job: Job, head: _Head, start: int, line: str) -> None:
    match = POSITION.fullmatch(line)
    if match is None:
        job.wrong(start, f"of //POS is not understood: {line[:SHOWN]}")
        return
    kind, number = match.group(1), int(match.group(2))
    if kind not in ("C", "P"):
        return
    name = f"{kind}{match.group(2)}"
    if (kind, number) in job.positions:
        twice = job.code.line(job.positions[kind, number].start)
        job.wrong(start, f"states {name} again, which stands in line {twice}")
        return
    spans, texts = _numbers(line, match.start(3), start)
    frame = "PULSE" if head.data == "PULSE" else head.kind
    why = _fault(head, texts)
    user = head.user if frame == "USER" else ""
    numbers = NONE if why else Numbers.packed(spans, texts)
    job.positions[kind, number] = Position(
        name, kind, number, start, why, frame, user, head.tool, head.posture or (), numbers
    )


def _numbers(line: str, at: int, start: int) -> tuple[list[tuple[int, int]], list[str]]:
    """Places and texts of the numbers of a position; none where anything else stands there."""
    spans: list[tuple[int, int]] = []
    texts: list[str] = []
    while at < len(line):
        part = PART.match(line, at)
        if part is None:
            return [], []
        spans.append((start + part.start(1), start + part.end(1)))
        texts.append(part.group(1))
        at = part.end()
    return spans, texts


def _fault(head: _Head, texts: Sequence[str]) -> str:
    """Why the numbers of a position are no place; empty if they are one."""
    if not head.kind or not head.data:
        return "is in no stated coordinates: ///POSTYPE, and ///RECTAN or ///PULSE, stand before none of it"
    if (head.data == "PULSE") != (head.kind == "PULSE"):
        return f"is in POSTYPE {head.kind[:SHOWN]}, but its section is ///{head.data}"
    if not texts:
        return "is not understood"
    if len(texts) != AXES:
        return f"has {len(texts)} numbers: those of an arm of six axes have six"
    if max(map(abs, map(float, texts))) > LARGEST_IN_PROGRAM:
        return "has a number that no arm can reach"
    if head.data == "PULSE":
        return ""
    if head.kind not in CARTESIAN:
        return f"is in coordinates that move (POSTYPE {head.kind[:SHOWN]})"
    if head.posture is None:
        return "has no ///RCONF before it that is understood"
    if not head.tool:
        return "has no ///TOOL before it"
    return "has no ///USER before it" if head.kind == "USER" and not head.user else ""


def _judge(job: Job) -> None:
    """Find out of the whole job whether its positions are those of robot 1 alone."""
    arms = [group for group in job.groups if group.startswith("RB")]
    others = [group for group in job.groups if not group.startswith(("RB", "ST"))]
    if job.why:
        return
    if others:
        job.why = f"its job moves {others[0][:SHOWN]} too, and where a base or a tool moves the positions go with it"
    elif arms != ["RB1"]:
        job.why = f"its job is of {' and '.join(arms)[:SHOWN] or 'no robot'}: jobs of RB1 alone are corrected"


def _index(text: str) -> str:
    """A number without zeros in front; empty where it is none."""
    return str(int(text)) if text.isdecimal() and len(text) < 10 else ""


def _posture(text: str) -> tuple[int, ...] | None:
    """The numbers of RCONF without the zeros behind; None where they are none."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and len(part) < 10 for part in parts):
        return None
    values = [int(part) for part in parts]
    while values and values[-1] == 0:
        values.pop()
    return tuple(values)
