"""Control flow of G-code: subprograms, blocks that may be skipped, O-words of LinuxCNC, jumps and loops of FANUC's macros."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

from aridcal.jobs.apply.programs.gcode.blocks import LABEL, Block, Line, block_of, lines_of
from aridcal.jobs.apply.programs.gcode.table import ENDS, RETURNS, VARIABLES, WILD
from aridcal.jobs.apply.programs.walk import DEEPEST, JUMPS, Body, Call, Choice, Jump, Leave, Mark, Node, Repeat, Step

SKIPPED = re.compile(r"[ \t]*+/[0-9]?")
"""Before a block that a switch of the controller leaves out."""

PROGRAM = re.compile(r"[ \t]*+(?:[Oo:][ \t]*+([0-9]+)|[Oo][ \t]*+<([^<>]*+)>)[ \t]*+")

O_WORD = re.compile(
    r"[ \t]*+(?:[Nn][ \t]*+[0-9]++[ \t]*+)?[Oo][ \t]*+(?:([0-9]+)|<([^<>]*+)>)[ \t]*+([A-Za-z]+)(?![ \t]*+[0-9])(.*)"
)

MACRO = re.compile(
    r"[ \t]*+(?:[Nn][ \t]*+[0-9]++)?[ \t]*+"
    r"(?:(IF|WHILE)[ \t]*+(?=\[)|(GOTO)|(DO|END)[ \t]*+(?=[0-9])|(POPEN|PCLOS|DPRNT|BPRNT)(?![A-Za-z]))",
    re.IGNORECASE,
)

GOTO = re.compile(r"GOTO[ \t]*+([0-9]*+)(.*)", re.IGNORECASE)

THEN = re.compile(r"THEN[ \t]*+(?=#)", re.IGNORECASE)

DO = re.compile(r"DO[ \t]*+([0-9]+)[ \t]*+", re.IGNORECASE)

VARIABLE = re.compile(r"[ \t]*+(?:[Nn][ \t]*+[0-9]++[ \t]*+)?#[ \t]*+(?:([0-9]+)|<([^<>]*+)>)[ \t]*+=")

ANOTHER_WORD = re.compile(r"(?<![A-Za-z])[A-Za-z][ \t]*+[-+]?[0-9.]")
"""A letter with a number: what stands behind an assignment is more than a value."""

MATCHLESS = "what begins and what ends here do not match"


@dataclass
class _Open:
    """What has begun and not yet ended.

    Attributes:
        kind: ``routine``, ``sub``, ``if``, ``while``, ``do``, ``repeat`` or ``DO``.
        label: Its number or name.
        body: What stands in it so far.
        ways: Of an ``if``: its bodies that are closed.
        otherwise: Whether one of them is taken in any case.
    """

    kind: str
    label: str
    body: list[Node] = field(default_factory=list)
    ways: list[Body] = field(default_factory=list)
    otherwise: bool = False


@dataclass
class Flow:
    """All that the files of a project say.

    Attributes:
        routines: Bodies by name: ``o1000``, or the name of a file.
        mains: Names of programs that are started by hand, in their order.
        wild: Why nothing is known of the order of the blocks; empty if it is.
    """

    routines: dict[str, Body] = field(default_factory=dict)
    mains: list[str] = field(default_factory=list)
    wild: str = ""

    def add(self, text: str, file: int, stem: str) -> None:
        """Read one more file.

        Args:
            text: Its content.
            file: Its index.
            stem: Its name without the ending: LinuxCNC calls files by it.
        """
        _File(self, text, file, stem).read()


class _File:
    def __init__(self, flow: Flow, text: str, file: int, stem: str) -> None:
        self._flow, self._text, self._file = flow, text, file
        self._name = stem.lower()
        self._open: list[_Open] = [_Open("routine", self._name)]
        self._run: list[Block] = []
        self._begun = self._ended = self._returns = False
        self._labels = {
            m.group(1).lstrip("0") for m in GOTO.finditer(text) if not text[m.start() - 1 : m.start()].isalpha()
        }

        self._marked: set[str] = set()
        self._jumps = 0

    def read(self) -> None:
        """Read all lines."""
        for line in lines_of(self._text):
            if line.code.lstrip(" \t").startswith("%"):
                if self._begun:
                    break
                self._begun = True
                if line.code.strip(" \t")[1:].strip("0123456789 \t"):
                    self._fault(line, "% has a text behind it")
            elif line.code.strip(" \t") or line.fault:
                self._begun = True
                self._line(line)
        self._close_routine()

    def _line(self, line: Line) -> None:
        if not line.fault:
            skipped = SKIPPED.match(line.code)
            if skipped is not None:
                self._skipped(line, skipped.end())
                return
            program = PROGRAM.fullmatch(line.code)
            if program is not None:
                self._program(line, program)
                return
            if self._labels and (label := LABEL.match(line.code)) is not None:
                number = label.group(1).lstrip("0")
                if number in self._marked:
                    self._go_wild(line, f"has the number N{number} once more, to which a jump leads")
                elif number in self._labels:
                    self._marked.add(number)
                    self._put(Mark(number))
            for pattern, reader in ((O_WORD, self._o_word), (MACRO, self._macro), (VARIABLE, self._variable)):
                match = pattern.match(line.code)
                if match is not None:
                    reader(line, match)
                    return
        self._block(line)

    def _skipped(self, line: Line, end: int) -> None:
        """A block that may be left out: one way with it, one without."""
        if SKIPPED.match(line.code, end) is not None:
            self._fault(line, "/ stands twice")
            return
        self._flush()
        self._open.append(_Open("if", "/"))
        self._line(replace(line, code=" " * end + line.code[end:]))
        self._flush()
        if self._open[-1].label != "/":  # a loop or a branch that may have no beginning
            self._go_wild(line, MATCHLESS)
            return
        way = self._open.pop()
        self._put(Choice((way.body, ())))

    def _program(self, line: Line, match: re.Match[str]) -> None:
        """``O1000``: the number of the program, or of the next one in the same file."""
        name = _program_name(match.group(1), match.group(2))
        if self._open[-1].body or self._run:
            if not self._ended:
                self._fault(line, "another program begins here, and the one before has not ended")
            self._close_routine()
        self._open = [_Open("routine", name)]
        self._ended = self._returns = False

    def _block(self, line: Line) -> None:
        block = block_of(line, self._file)
        self._run.append(block)
        ending = ENDS & set(block.codes)
        if not (ending or "M98" in block.codes or RETURNS in block.codes or WILD.keys() & set(block.codes)):
            return
        self._flush()
        for code in WILD.keys() & set(block.codes):
            self._go_wild(line, WILD[code])
        if "M98" in block.codes:
            self._call_by_number(line, block)
        if RETURNS in block.codes:
            if block.word("P"):
                self._go_wild(line, "returns to another line (M99 P)")
            self._put(Leave("routine"))
            self._returns = True
        if ending:
            self._put(Leave("program"))
        self._ended = self._ended or bool(ending) or RETURNS in block.codes

    def _call_by_number(self, line: Line, block: Block) -> None:
        number = block.word("P")
        name = _program_name(number, None) if number.isdigit() else "a program whose number is worked out"
        if "Q" in {letter for letter, _ in block.others}:
            name = f"{name} from another line on (Q)"
        self._put(Repeat((Call(name, block),), once=True) if block.word("L") else Call(name, block))

    def _o_word(self, line: Line, match: re.Match[str]) -> None:
        """``o100 sub``, ``o<name> call [1] [2]``, ``o110 if [...]`` and their like."""
        number, name, word, _ = match.groups()
        label, word = _program_name(number, name), word.lower()
        self._flush()
        top = self._open[-1]
        same = top.label == label
        if word in ("sub", "if", "while", "repeat", "do"):
            if word == "while" and same and top.kind == "do":
                self._open.pop()
                self._put(Repeat(top.body, once=True))
            else:
                self._begin(line, word, label)
        elif word == "call":
            self._put(Call(label, block_of(replace(line, code=""), self._file)))
        elif word == "return":
            self._put(Leave("routine"))
        elif word in ("break", "continue"):
            loops = [own.label for own in self._open if own.kind in ("while", "repeat", "do")]
            if loops[-1:] != [label]:
                self._go_wild(line, MATCHLESS)
            self._put(Leave("loop"))
        elif word in ("elseif", "else") and same and top.kind == "if" and not top.otherwise:
            top.ways.append(top.body)
            top.body, top.otherwise = [], word == "else"
        elif word == "endif" and same and top.kind == "if":
            self._open.pop()
            self._put(Choice((*top.ways, top.body, *(() if top.otherwise else ((),)))))
        elif word in ("endwhile", "endrepeat") and same and top.kind == word[3:]:
            self._open.pop()
            self._put(Repeat(top.body))
        elif word == "endsub" and same and top.kind == "sub":
            self._open.pop()
            self._flow.routines[label] = top.body
        else:
            self._go_wild(line, MATCHLESS)

    def _macro(self, line: Line, match: re.Match[str]) -> None:
        """``IF [...] GOTO 10``, ``IF [...] THEN #1=2``, ``WHILE [...] DO 1``, ``END 1``, ``GOTO 10``, ``DPRNT[...]``."""
        self._flush()
        condition, goto, loop, output = match.groups()
        behind = match.end()
        if output:
            return
        if condition:
            behind = _closed(line.code, behind)
        rest = line.code[behind:].strip(" \t") if behind >= 0 else ""
        if condition and condition.upper() == "IF" and (target := GOTO.fullmatch(rest)) is not None:
            self._put(Choice(((self._jump(line, target),), ())))
        elif condition and condition.upper() == "IF" and (then := THEN.match(rest)) is not None:
            place = line.code.index(rest, behind) + then.end()
            way = replace(line, code=" " * place + line.code[place:])
            assigned = VARIABLE.match(way.code)
            self._open.append(_Open("if", "THEN"))
            self._variable(way, assigned) if assigned is not None else self._block(way)
            self._flush()
            self._put(Choice((self._open.pop().body, ())))
        elif condition and condition.upper() == "WHILE" and (do := DO.fullmatch(rest)) is not None:
            self._begin(line, "DO", do.group(1))
        elif goto and (target := GOTO.fullmatch(line.code[match.start(2) :].strip(" \t"))) is not None:
            self._put(self._jump(line, target))
        elif loop and loop.upper() == "DO" and rest.isdigit():
            self._begin(line, "DO", rest)
        elif loop and rest.isdigit() and (self._open[-1].kind, self._open[-1].label) == ("DO", rest):
            self._put(Repeat(self._open.pop().body))
        else:
            self._go_wild(line, "jumps or repeats in a way that is not understood")

    def _jump(self, line: Line, target: re.Match[str]) -> Jump:
        number, rest = target.groups()
        self._jumps += 1
        if rest.strip(" \t") or not number:
            self._go_wild(line, "jumps to a line that is worked out")
        if self._jumps > JUMPS:
            self._go_wild(line, f"is one more than {JUMPS} jumps")
        return Jump(number.lstrip("0"))

    def _variable(self, line: Line, match: re.Match[str]) -> None:
        """``#100=...``: harmless for variables that are the user's."""
        number, name = match.groups()
        if ANOTHER_WORD.search(line.code, match.end()) is not None:
            self._fault(line, "more than a value stands behind = here")
        elif name is None and not any(low <= int(number[:9]) <= high for low, high in VARIABLES):
            self._fault(line, f"#{number} may be an offset of the controller")

    def _begin(self, line: Line, kind: str, label: str) -> None:
        if len(self._open) > DEEPEST:
            self._go_wild(line, f"more than {DEEPEST} branches and loops are in each other")
        else:
            self._open.append(_Open(kind, label))

    def _fault(self, line: Line, why: str) -> None:
        self._run.append(Block(line.number, self._file, line.code.strip(), fault=why))

    def _go_wild(self, line: Line, why: str) -> None:
        self._flow.wild = self._flow.wild or f"line {line.number} {why}"

    def _put(self, node: Node) -> None:
        self._flush()
        self._open[-1].body.append(node)

    def _flush(self) -> None:
        if self._run:
            self._open[-1].body.append(Step(tuple(self._run)))
            self._run = []

    def _close_routine(self) -> None:
        self._flush()
        if len(self._open) > 1:
            self._flow.wild = self._flow.wild or f"{self._open[-1].kind} {self._open[-1].label} has no end"
        routine = self._open[0]
        if routine.body:
            self._flow.routines.setdefault(routine.label, routine.body)
            if not self._returns and routine.label not in self._flow.mains:
                self._flow.mains.append(routine.label)


def _program_name(number: str | None, name: str | None) -> str:
    return f"o{number.lstrip('0') or '0'}" if number is not None else (name or "").strip().lower()


def _closed(code: str, place: int) -> int:
    """The place behind the bracket that closes the one at a place; -1 if there is none."""
    depth = 0
    for at in range(place, len(code)):
        depth += (code[at] == "[") - (code[at] == "]")
        if depth == 0:
            return at + 1
    return -1
