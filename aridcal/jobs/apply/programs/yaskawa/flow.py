"""The way through a job: its instructions as the nodes that are walked, and what else uses its positions."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import NamedTuple

from aridcal.jobs.apply.programs.uses import ANY
from aridcal.jobs.apply.programs.walk import (
    DEEPEST,
    Body,
    Call,
    Choice,
    Jump,
    Leave,
    Mark,
    Node,
    Repeat,
    Step,
    TooManyWays,
)
from aridcal.jobs.apply.programs.yaskawa.listing import SHOWN, Instruction, Job
from aridcal.jobs.apply.programs.yaskawa.table import CHANGES, HARMLESS, INDEX, MOVE, OPTIONS, PLACE

HARMLESS_RE = re.compile("|".join(f"(?:{row})" for row in HARMLESS))

CHANGES_RE = tuple((does, re.compile(row)) for does, row in CHANGES)

OPTIONS_RE = tuple((option, re.compile(option.pattern)) for option in OPTIONS)

MOVE_RE, PLACE_RE = re.compile(MOVE), re.compile(PLACE)

STEP_POSITION = re.compile(r"(?<![A-Z])C(\d{1,9})\b")

VARIABLE = re.compile(rf"(?<![A-Z$])(?:ARG)?PX?({INDEX})")
"""A position variable, which may be an argument: PX is all groups of axes of the one with this number."""

CONDITIONAL = re.compile(r"(JUMP|CALL|RET|END|ABORT|PSTART)\b(.*?) (?:IF|IFEXPRESS)\b(.*)")

TO_JOB = re.compile(r"(JUMP|CALL) JOB:(\S+)(.*)")

CALLED_FRAME = re.compile(r"\bUF#\(([^()]*)\)")

OPENS = {"IFTHEN": "IF", "IFTHENEXP": "IF", "WHILE": "WHILE", "WHILEEXP": "WHILE", "FOR": "FOR", "SWITCH": "SWITCH"}

CLOSES = {"ENDIF": "IF", "ENDWHILE": "WHILE", "NEXT": "FOR", "ENDSWITCH": "SWITCH"}

PARTS = {"ELSEIF": "IF", "ELSEIFEXP": "IF", "ELSE": "IF", "CASE": "SWITCH", "DEFAULT": "SWITCH"}

STATIONS, BASES = ("EC", "EX", "LEX"), ("BC", "BP", "LBP")
"""What positions of stations and of bases begin with."""

OTHERS = (*STATIONS, *BASES)

LAST = ("ELSE", "DEFAULT")
"""Parts that are taken where no other is."""


class Action(NamedTuple):
    """What an instruction does to the state.

    Attributes:
        does: ``move``, one of the table's changes, ``call``, or ``unknown``.
        job: Index of the job.
        start: Of the instruction in its text.
        what: The place of a move, as it stands there; the number of a frame or tool; the frame that a call names.
        joint: Whether a move is one of the axes, which may bend the arm another way.
        why: Why the place of a move is left.
        raw: The instruction as it stands there.
    """

    does: str
    job: int
    start: int
    what: str = ""
    joint: bool = False
    why: str = ""
    raw: str = ""


class Use(NamedTuple):
    """Something else than a move that uses positions.

    Attributes:
        kind: C of the job's own, P of variables.
        number: Of the position, :data:`ANY` for all of them.
        start: Of the instruction.
    """

    kind: str
    number: int
    start: int


@dataclass
class Flow:
    """What a job does.

    Attributes:
        body: Its nodes.
        calls: Names of jobs that it calls or goes on with.
        uses: Of positions, other than that a move goes there.
        variables: Position variables that it names in any way.
        writes: ``frame`` and ``tool`` with the number that it sets, or :data:`ANY`, and where.
        why: Why its way cannot be followed; empty if it can.
    """

    body: Body = ()
    calls: list[str] = field(default_factory=list)
    uses: list[Use] = field(default_factory=list)
    variables: set[int] = field(default_factory=set)
    writes: list[tuple[str, int, int]] = field(default_factory=list)
    why: str = ""


@dataclass
class _Block:
    """A structured instruction while it is read.

    Attributes:
        kind: IF, WHILE, FOR or SWITCH; empty of the job itself.
        ways: Nodes of its parts.
        whole: Whether one of its parts is taken in any case.
    """

    kind: str
    ways: list[list[Node]] = field(default_factory=lambda: [[]])
    whole: bool = False

    def node(self) -> Node:
        """It, once it is complete."""
        if self.kind in ("WHILE", "FOR"):
            return Repeat(self.ways[0])
        return Choice((*self.ways, *([] if self.whole else [[]])))


class _Reader:
    """Instructions of one job to nodes.

    Args:
        index: Of the job.
        job: It.
    """

    def __init__(self, index: int, job: Job) -> None:
        self._index, self._job = index, job
        self.flow = Flow()
        self._blocks = [_Block("")]

    def read(self) -> Flow:
        for instruction in self._job.instructions:
            self._instruction(instruction)
        if len(self._blocks) > 1 and not self.flow.why:
            self.flow.why = f"a block of its job ({self._blocks[-1].kind}) has no end"
        self.flow.body = self._blocks[0].ways[0]
        if self.flow.why:
            self.flow.body = [Step(Action("unknown", self._index, 0, raw=self.flow.why))]
        return self.flow

    def _instruction(self, instruction: Instruction) -> None:
        word = instruction.text.partition(" ")[0]
        kind = OPENS.get(word)
        if kind is not None:
            if len(self._blocks) > DEEPEST:
                raise TooManyWays
            self._blocks.append(_Block(kind))
            if kind == "SWITCH":  # what stands before the first CASE is never reached
                self._blocks[-1].ways = []
                if " CASE " in f"{instruction.text} ":
                    self._blocks[-1].ways = [[]]
            self._note(instruction.text, instruction.start)
        elif word in CLOSES or word in PARTS:
            self._part(word, instruction)
        elif not self._blocks[-1].ways:
            self._wrong(instruction.start, "stands before the first CASE")
        else:
            self._blocks[-1].ways[-1].extend(self._nodes(instruction))

    def _wrong(self, start: int, what: str) -> None:
        self.flow.why = self.flow.why or f"line {self._job.code.line(start)} {what}"

    def _part(self, word: str, instruction: Instruction) -> None:
        """A part of a block begins, or a block ends."""
        block = self._blocks[-1]
        if block.kind != (PARTS | CLOSES)[word] or (block.whole and word in PARTS):
            self._wrong(instruction.start, f"ends or parts what did not begin ({word})")
        elif word in CLOSES:
            self._blocks.pop()
            self._blocks[-1].ways[-1].append(block.node())
        else:
            block.ways.append([])
            block.whole = word in LAST
            self._note(instruction.text, instruction.start)

    def _nodes(self, instruction: Instruction) -> list[Node]:
        """Nodes of an instruction that contains no other lines."""
        text, start = instruction.text, instruction.start
        if text.startswith("*") and " " not in text:
            return [Mark(text[1:])]
        move = MOVE_RE.fullmatch(text)
        if move is not None:
            return self._move(move, instruction)
        self._note(text, start)
        conditional = CONDITIONAL.fullmatch(text)
        if conditional is not None:
            word, rest, _ = conditional.groups()
            return [Choice((self._leading(f"{word}{rest}", instruction), []))]
        return self._leading(text, instruction)

    def _leading(self, text: str, instruction: Instruction) -> list[Node]:
        """Nodes of an instruction that may lead elsewhere, its condition left out."""
        start, word = instruction.start, text.partition(" ")[0]
        to_job = TO_JOB.fullmatch(text)
        if to_job is not None:
            how, name, rest = to_job.groups()
            frame = CALLED_FRAME.search(rest)
            self.flow.calls.append(name)
            action = Action("call", self._index, start, frame.group(1).strip() if frame is not None else "")
            return [Call(name, action), *([Leave("routine")] if how == "JUMP" else [])]
        if text.startswith("JUMP *"):
            return [Jump(text.removeprefix("JUMP *").partition(" ")[0])]
        if text.startswith("JUMP LABEL:"):
            return [Jump("")]
        if word in ("JUMP", "CALL"):
            step = Step(Action("unknown", self._index, start, raw=instruction.raw))
            return [step, *([Leave("routine")] if word == "JUMP" else [])]
        if word in ("RET", "END"):
            return [Leave("routine")]
        if text == "ABORT":
            return [Leave("program")]
        if HARMLESS_RE.fullmatch(text) is not None:
            return []
        return [Step(self._change(text, instruction))]

    def _change(self, text: str, instruction: Instruction) -> Action:
        for does, pattern in CHANGES_RE:
            match = pattern.fullmatch(text)
            if match is None:
                continue
            number = match.groupdict().get("index") or ""
            if does in ("frame", "tool"):
                own = int(number) if _short(number) else ANY
                self.flow.writes.append((does, own, instruction.start))
            return Action(does, self._index, instruction.start, number, raw=instruction.raw)
        return Action("unknown", self._index, instruction.start, raw=instruction.raw)

    def _move(self, move: re.Match[str], instruction: Instruction) -> list[Node]:
        start = instruction.start
        places = move.group("places").split()
        own = [place for place in places if not place.startswith(OTHERS)]
        if places and all(place.startswith(STATIONS) for place in places) and not move.group("options").count("+"):
            return []
        why = "another group leads it (SMOV)" if move.group("how").startswith("S") else ""
        if any(place.startswith(BASES) for place in places):
            why = why or "the base of the robot moves with it"
        if len(own) != 1:
            why = why or ("it says no position" if not own else "it says two positions")
        place = own[0] if len(own) == 1 else ""
        if place.startswith("PX"):
            why = why or "a variable of all groups of axes says where (PX)"
        if why or not _short(place.lstrip("CP")):
            self._note(move.group("places"), start)
        self.flow.variables |= {int(n) for n in VARIABLE.findall(place) if _short(n)}
        if "P" in move.group("options") or "+" in move.group("options"):
            self._note(move.group("options"), start)
        behind: list[Node] = []
        text, at = move.group("options"), 1
        while at < len(text):
            option, match = next(((o, m) for o, p in OPTIONS_RE if (m := p.match(text, at)) is not None), (None, None))
            if option is None or match is None:
                why = why or f"{text[at:][:SHOWN]} is not understood"
                behind.append(Step(Action("unknown", self._index, start, raw=instruction.raw)))
                break
            why = why or option.why
            if option.trap:
                behind.append(Choice(([Jump(match.group("label"))], [])))
            at = match.end() + 1
        joint = "J" in move.group("how")
        return [Step(Action("move", self._index, start, place, joint, why, instruction.raw)), *behind]

    def _note(self, text: str, start: int) -> None:
        """Note positions that an instruction names."""
        for match in STEP_POSITION.finditer(text):
            self.flow.uses.append(Use("C", int(match.group(1)), start))
        if "STEP#(" in text:
            self.flow.uses.append(Use("C", ANY, start))
        for match in VARIABLE.finditer(text):
            number = int(match.group(1)) if _short(match.group(1)) and not text.startswith("CLEAR ") else ANY
            self.flow.uses.append(Use("P", number, start))
            self.flow.variables.add(number)


def read_flow(index: int, job: Job) -> Flow:
    """What a job does.

    Raises:
        TooLong: blocks are nested too deep.
    """
    return _Reader(index, job).read()


def _short(index: str) -> bool:
    return index.isdecimal() and len(index) < 10
