"""Files of KRL as routines that can be walked."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aridcal.jobs.apply.programs.krl import table
from aridcal.jobs.apply.programs.krl.expressions import Line
from aridcal.jobs.apply.programs.krl.motions import MOVES, Motions
from aridcal.jobs.apply.programs.krl.names import File, Names
from aridcal.jobs.apply.programs.krl.project_facts import ProjectFacts
from aridcal.jobs.apply.programs.krl.syntax import Aggregate, Assignment, Computation, Expression, Function, Variable
from aridcal.jobs.apply.programs.krl.tokens import GIVEN, MalformedStatement, Token, fields
from aridcal.jobs.apply.programs.walk import DEEPEST, Choice, Jump, Leave, Mark, Node, Repeat, Step

_BODIES = {
    "if": "endif",
    "switch": "endswitch",
    "for": "endfor",
    "while": "endwhile",
    "loop": "endloop",
    "repeat": "until",
}

_COPY = re.compile(r"[ \t]*+([a-z_$][\w$]*+)[ \t]*+=[ \t]*+([a-z_][\w$]*+)[ \t\r]*+", re.ASCII)
"""``PDAT_ACT=PPDAT1``: half of the lines of inline forms."""

_ENDS = frozenset((*_BODIES.values(), "endspline", "else", "case", "default"))


class MalformedProgram(Exception):
    """A file is no program: blocks do not close, for instance."""


@dataclass
class _Block:
    """A statement that is open.

    Attributes:
        word: That began it.
        bodies: Those that are done, and the one being read.
        again: What is carried out before each turn of a loop.
        last: Whether one of the ways is taken for certain.
        settings: What holds in a spline.
    """

    word: str
    bodies: list[list[Node]]
    again: list[Node] = field(default_factory=list)
    last: bool = False
    settings: tuple[Assignment, ...] = ()


class Reader(Motions):
    """Reads one file; see :class:`Notes`."""

    def __init__(self, file: File, names: Names, facts: ProjectFacts) -> None:
        super().__init__(file, names, facts)
        self._blocks: list[_Block] = []
        self._labels: set[str] = set()
        self._gotos: list[tuple[str, int]] = []
        self._started = False
        self._place = 0
        self._forms: dict[str, Mapping[str, Expression]] = {}

    def data(self) -> None:
        """Read a data list."""
        public = self._file.module.startswith("$")
        for start, end in self._lines():
            given = GIVEN.fullmatch(self._low, start, end)
            try:
                if given is not None:
                    self._given(given, public)
                    continue
                line = self._line(start, end)
                word = line.peek()
                if word in ("defdat", "enddat") or word in table.DECLARATIONS or not word:
                    if word == "import":
                        self._imported(line)
                    continue
                if line.peek(1) in ("=", "[", ".") and word not in ("decl", "global", "const"):
                    to = line.variable(line.take())
                    self._initial(to, line)
                else:
                    self._declaration(line, self._file.module, public)
            except MalformedStatement:
                self._unclear(start, end)

    def _given(self, match: re.Match[str], public: bool) -> None:
        """A variable that is declared with plain values."""
        name, start = match.group("name"), match.start("name")
        self._names.declare(self._file.module, name, match.group("kind"), public or match.group("shared") is not None)
        to = self._variable(name, start)
        place, end = match.span("plain")
        values = self._fields(Token("plain", match.group("plain"), place, end), match.group("kind"))
        value = Aggregate((self._file.index, place), end, values)
        self._said.values.append((self._file, to, value))
        self._gives(to, value)

    def _fields(self, token: Token, kind: str) -> Mapping[str, Expression]:
        """Fields of an aggregate; those of inline forms, which are alike line by line, are kept once."""
        if kind not in table.FORMS:
            return fields(self._low, self._text, token)
        text = self._text[token.start : token.end]
        values = self._forms.get(text)
        if values is None:
            values = self._forms[text] = fields(self._low, self._text, token)
        return values

    def _initial(self, to: Variable, line: Line) -> None:
        line.take("=")
        value = line.expression()
        line.close()
        self._said.values.append((self._file, to, value))
        self._gives(to, value)

    def program(self) -> None:
        """Read a program.

        Raises:
            Broken: its blocks do not close.
        """
        heads = {match.start(): match for match in self._file.heads()}
        alone = not heads
        if alone:
            self._begin(self._file.module, ())
        inside = alone
        for start, end in self._lines():
            match = heads.get(start)
            if match is not None:
                if inside:
                    self._end(start)
                name = match.group("name")
                head = self._head(match)
                self._begin(name, head)
                inside = True
                continue
            words = self._low[start:end].split(None, 1)
            if not words or (words[0].startswith("&") and not self._started):
                continue
            self._started = True
            if words[0] in ("end", "endfct") and not words[1:]:
                if inside:
                    self._end(start)
                inside = False
                continue
            if not inside:
                raise MalformedProgram(start, "stands outside of DEF and END")
            self._statement(start, end)
        if inside:
            self._end(len(self._text))

    def _head(self, match: re.Match[str]) -> Sequence[tuple[str, bool]]:
        key = f"{self._file.index}/{match.group('name')}"
        if key in self._said.bodies:
            raise MalformedProgram(match.start(), "is the second routine of this name")
        head = self._names.routine(self._file, match.group("name"))
        return head.parameters if head is not None and head.key == key else ()

    def _begin(self, name: str, parameters: Sequence[tuple[str, bool]]) -> None:
        self._routine = name
        self._blocks = [_Block("def", [[]])]
        self._labels, self._gotos = set(), []
        scope = f"{self._file.module}/{name}"
        branches = []
        for parameter, by_value in parameters:
            self._names.declare(scope, parameter, "", False)
            branches.append((self._variable(parameter, 0), by_value))
        self._said.parameters[f"{self._file.index}/{name}"] = branches

    def _end(self, place: int) -> None:
        if len(self._blocks) != 1:
            raise MalformedProgram(place, f"ends the routine before the end of {self._blocks[-1].word.upper()}")
        for label, start in self._gotos:
            if label not in self._labels:
                raise MalformedProgram(start, "jumps to a label that is not there")
        self._said.bodies[f"{self._file.index}/{self._routine}"] = self._blocks[0].bodies[0]

    @property
    def _body(self) -> list[Node]:
        if not self._blocks[-1].bodies:
            raise MalformedProgram(self._place, "stands before the first CASE")
        return self._blocks[-1].bodies[-1]

    def _statement(self, start: int, end: int) -> None:
        self._place = start
        copy = _COPY.fullmatch(self._low, start, end)
        if copy is not None:
            to, value = (self._variable(copy.group(k), copy.start(k)) for k in (1, 2))
            assignment = Assignment(to, value)
            self._written(assignment)
            self._body.append(Step(assignment))
            return
        try:
            line = self._line(start, end)
            if not line.ended:
                self._read(line, start, end)
        except MalformedStatement:
            self._body.append(Step(self._unclear(start, end)))

    def _read(self, line: Line, start: int, end: int) -> None:
        word, kind, following = line.peek(), line.kind, line.peek(1)
        if kind != "name":
            raise MalformedStatement
        if following == "=" or (following in ("[", ".") and word not in MOVES):
            self._assigned(line)
        elif (
            following == "("
            and word not in MOVES
            and word not in ("if", "while", "until", "switch", "wait", "return", "case")
        ):
            call = line.expression()
            line.close()
            if not isinstance(call, Function):
                raise MalformedStatement
            self._mentions(call, "passes it on")
            self._called(line)
        elif word in ("spline", "ptp_spline"):
            self._spline(line, start)
        elif word in MOVES:
            move = self._moved(line, [setting for block in self._blocks for setting in block.settings])
            self._called(line)
            self._body.append(Step(move))
        elif word in _BODIES or word in _ENDS:
            self._block(line, start)
        elif following == ":" and not line.peek(2):
            self._labels.add(word)
            self._body.append(Mark(word))
        else:
            self._plain(line, word)

    def _plain(self, line: Line, word: str) -> None:
        """A statement of one line that is neither a move nor a part of a block."""
        first = line.take()
        if word == "wait":
            if not (line.takes("for") or line.takes("sec")):
                raise MalformedStatement
            self._mentions(line.expression(), "computes with it")
            line.close()
            self._called(line)
        elif word in table.HARMLESS:
            self._said_in(line.rest())
        elif word == "goto":
            label = line.take()
            line.close()
            self._gotos.append((label.text, first.start))
            self._body.append(Jump(label.text))
        elif word == "return":
            if not line.ended:
                self._mentions(line.expression(), "hands it back")
            line.close()
            self._called(line)
            self._body.append(Leave("routine"))
        elif word == "exit":
            line.close()
            self._body.append(Leave("loop"))
        elif word == "resume":
            self._said.resumes = (self._file, first.start)
            self._body.append(Leave("routine"))
        elif word in ("interrupt", "trigger") or (word == "global" and line.peek() == "interrupt"):
            if word == "global":
                line.take()
            self._thread(line, first, word)
        elif word in table.DECLARATIONS:
            if word == "import":
                self._imported(line)
            line.rest()
        else:
            self._local(first, line)

    def _local(self, first: Token, line: Line) -> None:
        """A declaration in a routine."""
        rest = [first, *line.rest()]
        again = Line(rest, self._file.index, self._low, self._text, self._resolved, self._routine_key)
        given = self._declaration(again, f"{self._file.module}/{self._routine}", False)
        self._called(again)
        for assignment in given:
            self._gives(assignment.to, assignment.value)
            self._body.append(Step(assignment))

    def _assigned(self, line: Line) -> None:
        to = line.variable(line.take())
        line.take("=")
        value = line.expression()
        line.close()
        self._called(line)
        self._written(Assignment(to, value))
        self._body.append(Step(Assignment(to, value)))

    def _called(self, line: Line) -> None:
        """Put the calls of a statement before it."""
        self._body.extend(self._calls(line))

    def _calls(self, line: Line) -> list[Node]:
        nodes: list[Node] = []
        for call in line.calls:
            nodes += self._call(call)
        return nodes

    def _open(self, block: _Block, place: int) -> None:
        if len(self._blocks) >= DEEPEST:
            raise MalformedProgram(place, f"has more than {DEEPEST} blocks in each other")
        self._blocks.append(block)

    def _block(self, line: Line, place: int) -> None:
        token = line.take()
        word = token.text
        if word in ("if", "switch", "for", "while", "repeat", "loop"):
            self._opened(line, word, place)
        elif word in ("else", "case", "default"):
            self._way(line, word, place)
        else:
            self._closed(line, word, place)

    def _spline(self, line: Line, place: int) -> None:
        line.take()
        settings = self._settings(line)
        line.close()
        self._called(line)
        self._open(_Block("spline", [[]], settings=settings), place)

    def _opened(self, line: Line, word: str, place: int) -> None:
        again: list[Node] = []
        if word in ("if", "switch", "while"):
            self._mentions(line.expression(), "computes with it")
            if word == "if":
                line.take("then")
            again = self._calls(line)
            self._body.extend(again)
        elif word == "for":
            counter = line.variable(line.take())
            line.take("=")
            self._mentions(line.expression(), "computes with it")
            line.take("to")
            self._mentions(line.expression(), "computes with it")
            if line.takes("step"):
                self._mentions(line.expression(), "computes with it")
            self._body.extend(self._calls(line))
            step = Assignment(counter, Computation(()))
            self._written(step)
            self._body.append(Step(step))
            again = [Step(step)]
        line.close()
        self._open(_Block(word, [] if word == "switch" else [[]], again), place)

    def _way(self, line: Line, word: str, place: int) -> None:
        block = self._blocks[-1]
        if block.word != ("if" if word == "else" else "switch") or block.last:
            raise MalformedProgram(place, f"has {word.upper()} where none can be")
        if word == "case":
            while not line.ended:
                self._mentions(line.expression(), "computes with it")
                if not line.takes(","):
                    break
        line.close()
        if line.calls:
            raise MalformedStatement
        block.last = word != "case"
        block.bodies.append([])

    def _closed(self, line: Line, word: str, place: int) -> None:
        block = self._blocks[-1]
        if word != _BODIES.get(block.word, "endspline" if block.word == "spline" else ""):
            raise MalformedProgram(place, f"has {word.upper()} where none can be")
        self._blocks.pop()
        if word == "until":
            self._mentions(line.expression(), "computes with it")
            block.bodies[0] += self._calls(line)
        if word == "endspline":
            while line.peek() in table.APPROXIMATIONS:
                line.take()
            self._settings(line)
        line.close()
        if block.word in ("if", "switch"):
            ways = block.bodies if block.last else [*block.bodies, []]
            self._body.append(Choice(tuple(ways)))
        elif block.word == "spline":
            self._body.extend(block.bodies[0])
        else:
            self._body.append(Repeat([*block.bodies[0], *block.again], once=block.word in ("repeat", "loop")))
