"""The way through a TP program: its instructions as the nodes that are walked."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from aridcal.jobs.apply.programs.fanuc.actions import Action, Fields, Options, Place, robot_group, short
from aridcal.jobs.apply.programs.fanuc.listing import SHOWN, Instruction, Listing, plain
from aridcal.jobs.apply.programs.fanuc.table import CHANGES, HARMLESS, INDEX, MODES, MOVE, OPTIONS, PLACE, Option
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


@dataclass
class Flow:
    """What a listing does, and what else uses its points.

    Attributes:
        body: Its nodes.
        calls: Names of programs that it calls.
        tasks: Names of programs that run beside it: started, on conditions, at times before or after a move.
        uses: Of points, by number, or -1 for all of them: where something else than a move to it uses it, and in what way.
        writes: ``frame`` and ``tool`` with the number that it sets, or -1 for any.
        why: Why its way cannot be followed; empty if it can.
    """

    body: Body = ()
    calls: list[str] = field(default_factory=list)
    tasks: list[str] = field(default_factory=list)
    uses: list[tuple[int, int, str]] = field(default_factory=list)
    writes: list[tuple[str, int, int]] = field(default_factory=list)
    why: str = ""


LOOPS = 4
"""Loops in loops that are walked as such: each takes three walks of what it contains. Deeper ones are written out with
jumps, which are all settled together."""

HARMLESS_RE = re.compile("|".join(f"(?:{row})" for row in HARMLESS))

CHANGES_RE = tuple((does, re.compile(row)) for does, row in CHANGES)

MODES_RE = tuple((name, re.compile(on), re.compile(off)) for name, on, off in MODES)

OPTIONS_RE = tuple((option, re.compile(option.pattern)) for option in OPTIONS)

POINT = re.compile(rf"(?<![A-Z_$])P\[({INDEX})\]")

LABEL = re.compile(r"LBL\[(\d+)\]")

JUMP = re.compile(rf"JMP,? ?LBL\[({INDEX})\]")

CALL = re.compile(r"CALL (\w+)(?:\(.*\))?")

TASK = re.compile(r"(?:RUN (\w+)(?:\(.*\))?|(?:ERROR|RESUME|MAINT)_PROG(?:\[\d+\])?=(\w+)|MONITOR (?!END\b)(\w+))")

NO_TASK = re.compile(r"MONITOR END (\w+)")

USUAL_MOVE = re.compile(r"([JL]) ?P\[(\d{1,9})(?::[^\[\]:\n'\"]*)?\](.*)", re.DOTALL)
"""A move as controllers write it, apart from what stands behind its point."""

BLOCK = re.compile(r"IF\(.*\)THEN|FOR\b.+|WHILE\b.+")

WAIT = re.compile(rf"WAIT\b.+?,? ?TIMEOUT,? ?LBL\[({INDEX})\]")

VISION = re.compile(rf"VISION GET_OFFSET\b[^,]*?,?(JMP,? ?LBL\[{INDEX}\])")


@dataclass
class _Block:
    """An instruction that contains others, while it is read.

    Attributes:
        kind: ``IF`` or ``LOOP``; empty of the program itself.
        start: Where it begins.
        ways: Nodes of its branches.
        marks: Whether a jump can come into it.
    """

    kind: str
    start: int
    ways: list[list[Node]] = field(default_factory=lambda: [[]])
    marks: bool = False

    @property
    def nodes(self) -> list[Node]:
        return self.ways[-1]


class _Reader:
    """Instructions of one listing to nodes.

    Args:
        program: Its index.
        listing: It.
    """

    def __init__(self, program: int, listing: Listing) -> None:
        self._program, self._listing = program, listing
        self.flow = Flow()
        self._blocks = [_Block("", 0)]
        self._choice: list[Body] = []  # branches of a SELECT that is not yet complete
        self._otherwise = False
        self._plain_moves: dict[tuple[str, str], Options | None] = {}
        self._plain_actions: dict[str, tuple[Action, ...] | None] = {}

    def read(self) -> Flow:
        for instruction in self._listing.instructions():
            self._instruction(instruction)
        self._end_select()
        if len(self._blocks) > 1:
            self._wrong(self._blocks[-1].start, "has no end")
        self.flow.body = self._blocks[0].nodes
        if self.flow.why:
            self.flow.body = [Step(Action("unknown", self._program, 0, raw=self.flow.why))]
        return self.flow

    def _wrong(self, start: int, what: str) -> None:
        line = self._listing.code.line(start)
        self.flow.why = self.flow.why or f"the block of line {line} {what}"

    def _instruction(self, instruction: Instruction) -> None:
        alone = instruction.closed and not self._choice
        if not (alone and (self._is_plain_move(instruction) or self._is_plain_action(instruction))):
            self._other_instruction(instruction)

    def _other_instruction(self, instruction: Instruction) -> None:
        text, start = instruction.text, instruction.start
        if self._branch_of_select(text, instruction):
            return
        self._end_select()
        move = MOVE.fullmatch(text)
        if move is not None:
            self._blocks[-1].nodes.extend(self._move(move, instruction))
            return
        label = LABEL.fullmatch(text)
        if BLOCK.fullmatch(text) is not None:
            if len(self._blocks) > DEEPEST:
                raise TooManyWays
            self._blocks.append(_Block("IF" if text.startswith("IF") else "LOOP", start))
            if sum(block.kind == "LOOP" for block in self._blocks) > LOOPS:
                self._come_into()
            self._note_points(text, start)
        elif text == "ELSE":
            if self._blocks[-1].kind != "IF" or len(self._blocks[-1].ways) > 1:
                self._wrong(start, "has no IF")
            self._blocks[-1].ways.append([])
        elif text in ("ENDIF", "ENDFOR", "ENDWHILE"):
            self._close("IF" if text == "ENDIF" else "LOOP", start)
        elif label is not None:
            self._come_into()
            self._blocks[-1].nodes.append(Mark(label.group(1)))
        else:
            self._blocks[-1].nodes.extend(self._nodes(text, instruction))

    def _is_plain_move(self, instruction: Instruction) -> bool:
        """Read a move that differs from others by its point alone, of which a long program has many; True where it is one.

        What stands behind the point is read once, with the first of these points.
        """
        match = USUAL_MOVE.fullmatch(instruction.raw)
        if match is None:
            return False
        how, point, rest = match.groups()
        if (how, rest) not in self._plain_moves:
            self._plain_moves[how, rest] = self._plain_move(f"{how} P[1]{rest}")
        move = self._plain_moves[how, rest]
        if move is None:
            return False
        places = (Place("P", point),)
        self._blocks[-1].nodes.append(Step(Action("move", self._program, instruction.start, (), how, places, move)))
        return True

    def _plain_move(self, raw: str) -> Options | None:
        """Options of a move to P[1]; None where it does anything else than to go there."""
        move = MOVE.fullmatch(plain(raw))
        if move is None:
            return None
        alone = _Reader(self._program, self._listing)
        step, *others = alone._move(move, Instruction(0, raw))
        if others or alone.flow != Flow() or not isinstance(step, Step) or not isinstance(step.what, Action):
            return None
        return step.what.options if step.what.places == (Place("P", "1"),) else None

    def _is_plain_action(self, instruction: Instruction) -> bool:
        """Read an instruction whose text says all that it does, and is read once; True where it is one.

        Not those that begin, end, call or lead to other lines, and those that the flow counts by their places.
        """
        raw = instruction.raw
        if raw not in self._plain_actions:
            self._plain_actions[raw] = self._plain_action(raw)
        actions = self._plain_actions[raw]
        for action in actions or ():
            self._blocks[-1].nodes.append(Step(action.at(instruction.start)))
        return actions is not None

    def _plain_action(self, raw: str) -> tuple[Action, ...] | None:
        """What an instruction does wherever it stands; None where that is not all."""
        alone = _Reader(self._program, self._listing)
        alone._other_instruction(Instruction(0, raw))
        if alone.flow != Flow() or len(alone._blocks) > 1 or alone._choice:
            return None
        steps = [node.what if isinstance(node, Step) else None for node in alone._blocks[0].nodes]
        actions = tuple(what for what in steps if isinstance(what, Action))
        return actions if len(actions) == len(steps) else None

    def _come_into(self) -> None:
        """Write all open blocks out with jumps."""
        for block in self._blocks:
            block.marks = True

    def _close(self, kind: str, start: int) -> None:
        if self._blocks[-1].kind != kind:
            self._wrong(start, "ends what did not begin")
            return
        block = self._blocks.pop()
        nodes = self._blocks[-1].nodes
        if block.marks:  # what jumps can come into is written out with jumps
            nodes.extend(_flat_loop(block) if kind == "LOOP" else _flat_choice(block))
        elif kind == "LOOP":
            nodes.append(Repeat(block.nodes))
        else:
            nodes.append(Choice((*block.ways, *([[]] if len(block.ways) == 1 else []))))

    def _branch_of_select(self, text: str, instruction: Instruction) -> bool:
        """Whether an instruction is a branch of a SELECT."""
        is_open = bool(self._choice)
        if text.startswith("SELECT ") or (is_open and text.startswith(("=", "ELSE,"))):
            if text.startswith("SELECT "):
                self._end_select()
            self._choice.append(self._conditional(text, instruction))
            self._otherwise = text.startswith("ELSE,")
            return True
        return False

    def _end_select(self) -> None:
        if self._choice:
            ways = [*self._choice, *([] if self._otherwise else [[]])]
            self._blocks[-1].nodes.append(Choice(tuple(ways)))
        self._choice, self._otherwise = [], False

    def _nodes(self, text: str, instruction: Instruction) -> list[Node]:
        """Nodes of an instruction that contains no other lines."""
        start = instruction.start
        if text.startswith(("IF ", "IF(", "WHEN ", "WHEN(")):
            return [Choice((self._conditional(text, instruction), []))]
        move = MOVE.fullmatch(text)
        if move is not None:  # on a condition, as the newest controllers take it
            return self._move(move, instruction)
        self._note_points(text, start)
        jump, call, task = JUMP.fullmatch(text), CALL.fullmatch(text), TASK.fullmatch(text)
        wait, vision = WAIT.fullmatch(text), VISION.fullmatch(text)
        if jump is not None:
            return [_jump(jump.group(1))]
        if wait is not None:
            return [Choice(([_jump(wait.group(1))], []))]
        if vision is not None:
            return [Choice((self._nodes(vision.group(1), instruction), []))]
        if call is not None:
            return [self._call(call.group(1), start)]
        if task is not None:
            self.flow.tasks.append(next(name for name in task.groups() if name is not None))
            return []
        if text in ("END", "[END]", "ABORT"):
            return [Leave("program" if text == "ABORT" else "routine")]
        if NO_TASK.fullmatch(text) is not None or (text and HARMLESS_RE.fullmatch(text) is not None):
            return []
        change = self._change(text, instruction)
        return [Step(change)] if change is not None else []

    def _conditional(self, text: str, instruction: Instruction) -> list[Node]:
        """What an instruction does where its condition holds."""
        condition, action = _split(text)
        self._note_points(condition, instruction.start)
        if action.startswith(("IF", "WHEN", "SELECT")):  # the controller takes none of these here
            return [Step(Action("unknown", self._program, instruction.start, raw=instruction.raw))]
        return self._nodes(action, instruction)

    def _call(self, name: str, start: int) -> Node:
        self.flow.calls.append(name)
        return Call(name, Action("call", self._program, start))

    def _change(self, text: str, instruction: Instruction) -> Action | None:
        """What an instruction changes; None if nothing of this arm."""
        start = instruction.start
        for does, pattern in CHANGES_RE:
            match = pattern.fullmatch(text)
            if match is not None:
                fields = _fields(match)
                if does in ("frame", "tool"):
                    index = robot_group(match.group("index"))
                    if index is None:
                        return None
                    self.flow.writes.append((does, int(index) if short(index) else ANY, start))
                return Action(does, self._program, start, fields)
        for name, on, off in MODES_RE:
            for does, pattern in (("mode", on), ("no mode", off)):
                if pattern.fullmatch(text) is not None:
                    return Action(does, self._program, start, (("name", name),))
        return Action("unknown", self._program, start, raw=instruction.raw)

    def _move(self, move: re.Match[str], instruction: Instruction) -> list[Node]:
        start = instruction.start
        places = tuple(Place(p.group("kind"), p.group("index")) for p in PLACE.finditer(move.group("places")))
        for place in places:
            if place.kind == "P" and place.point is None:
                self.flow.uses.append((ANY, start, f"goes to P[{place.index}], which may be this one"))
        if "P[" in move.group("options"):
            self._note_points(move.group("options"), start)
        options: list[tuple[Option, Fields]] = []
        behind: list[Node] = []
        text, at = move.group("options"), 0
        while at < len(text):
            option, match = _option(text, at)
            if match is None:
                options.append((Option("left", "", f"{text[at:].strip()[:SHOWN]} is not understood"), ()))
                behind.append(Step(Action("unknown", self._program, start, raw=instruction.raw)))
                break
            at = match.end()
            options.append((option, _fields(match)))
            if option.does == "skip":
                if match.group("register") is not None:
                    index = (("index", match.group("register")), ("value", "LPOS"))
                    behind.append(Step(Action("register", self._program, start, index)))
                behind.append(Choice(([_jump(match.group("label"))], [])))
            elif option.does == "call":
                self.flow.tasks.append(match.group("name"))
                behind.append(Choice(([self._call(match.group("name"), start)], [])))
        action = Action("move", self._program, start, (), move.group("how"), places, tuple(options))
        return [Step(action), *behind]

    def _note_points(self, text: str, start: int) -> None:
        """Points that an instruction uses otherwise than to go there."""
        for match in POINT.finditer(text):
            index = match.group(1).split(",")[0]
            point = int(index) if short(index) else ANY
            is_assigned = match.start() == 0 and text[match.end() : match.end() + 1] == "="
            self.flow.uses.append(
                (point, start, "sets it anew" if is_assigned else "takes its numbers for something else")
            )


def read_flow(program: int, listing: Listing) -> Flow:
    """What a listing does.

    Raises:
        TooLong: blocks are nested too deep.
    """
    return _Reader(program, listing).read()


def _fields(match: re.Match[str]) -> Fields:
    return tuple((name, value) for name, value in match.groupdict().items() if value is not None)


def _jump(index: str) -> Jump:
    """A jump to a label, to any of them where its number is worked out."""
    return Jump(index if index.isdecimal() else "")


def _split(text: str) -> tuple[str, str]:
    """A condition and what is done on it: at the first comma outside of brackets."""
    depth = 0
    for match in re.finditer(r"[(\[\])]|,", text):
        if match.group() == "," and depth == 0:
            return text[: match.start()], text[match.end() :]
        depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(match.group(), 0)
    return text, ""


def _option(text: str, at: int) -> tuple[Option, re.Match[str] | None]:
    if text[at] == " ":
        at += 1
    for option, pattern in OPTIONS_RE:
        match = pattern.match(text, at)
        if match is not None:
            return option, match
    return OPTIONS[0], None


def _flat_choice(block: _Block) -> Sequence[Node]:
    end = f"end {block.start}"
    nodes: list[Node] = []
    for k, way in enumerate(block.ways):
        last = k + 1 == len(block.ways)
        other = f"else {block.start} {k}"
        if last and k > 0:
            nodes += way
        else:
            nodes += [Choice(([Jump(other)], [])), *way, Jump(end), Mark(other)]
    return [*nodes, Mark(end)]


def _flat_loop(block: _Block) -> Sequence[Node]:
    head, end = f"head {block.start}", f"end {block.start}"
    return [Mark(head), Choice(([Jump(end)], [])), *block.nodes, Jump(head), Mark(end)]
