"""Files of KRL as routines that can be walked, and what is said of each variable anywhere in them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from aridcal.programs.krl import table
from aridcal.programs.krl.expressions import Line
from aridcal.programs.krl.names import File, Names
from aridcal.programs.krl.syntax import (
    Aggregate,
    Assignment,
    Carried,
    Expression,
    Function,
    Goal,
    Move,
    Product,
    Unclear,
    Variable,
    Worked,
    variables,
)
from aridcal.programs.krl.tokens import NAME, Misread, Token, tokens
from aridcal.programs.walk import DEEPEST, Call, Choice, Jump, Leave, Mark, Node, Repeat, Step

_LINES = re.compile(r"[^\n]+")

_MOVES = table.LINEAR | table.JOINTED | table.RELATIVE | table.ASYNCHRONOUS

_BODIES = {
    "if": "endif",
    "switch": "endswitch",
    "for": "endfor",
    "while": "endwhile",
    "loop": "endloop",
    "repeat": "until",
}

_BEFORE_BRACKETS = frozenset(("not", "and", "or", "exor", "b_not", "b_and", "b_or", "b_exor", "if", "when", "path", "do"))
"""Words before a bracket that call nothing."""

_ENDS = frozenset((*_BODIES.values(), "endspline", "else", "case", "default"))


class Broken(Exception):
    """A file is no program: blocks do not close, for instance."""


@dataclass(frozen=True)
class Mention:
    """A variable that something else than a move reads, or that is written.

    Attributes:
        variable: It.
        file: Where.
        does: What the statement does with it: ``computes with it``.
    """

    variable: Variable
    file: File
    does: str


@dataclass(frozen=True)
class Thread:
    """What an interrupt or a trigger carries out, at any time.

    Attributes:
        what: A call or an assignment.
        file: Where it is said.
        start: Its place there.
    """

    what: Function | Assignment
    file: File
    start: int


@dataclass
class Said:
    """All that a project's files say.

    Attributes:
        bodies: Of routines, by key.
        parameters: Of routines: variables, and whether each is handed over by value.
        values: Of data lists: variable and value.
        points: Aggregates that variables are given.
        reads: See :class:`Mention`.
        writes: Likewise.
        threads: Interrupts and triggers.
        missing: Routines that are called and are in no file, in small letters.
        packages: Routines of technology packages that are called.
        imported: Names of variables that one module takes from another.
        odd: Routines of :data:`table.ODD` that are called.
        resumes: The statement by which an interrupt breaks routines off, and its file.
        broken: What is wrong with a file, its place, and the file.
    """

    bodies: dict[str, Sequence[Node]] = field(default_factory=dict)
    parameters: dict[str, list[tuple[Variable, bool]]] = field(default_factory=dict)
    values: list[tuple[File, Variable, Expression]] = field(default_factory=list)
    points: list[tuple[File, Variable, Aggregate]] = field(default_factory=list)
    reads: list[Mention] = field(default_factory=list)
    writes: list[Mention] = field(default_factory=list)
    threads: list[Thread] = field(default_factory=list)
    missing: set[str] = field(default_factory=set)
    packages: set[str] = field(default_factory=set)
    imported: set[str] = field(default_factory=set)
    odd: set[str] = field(default_factory=set)
    resumes: tuple[File, int] | None = None
    broken: list[tuple[File, int, str]] = field(default_factory=list)


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


class Reader:
    """Reads one file.

    Args:
        file: The file.
        names: Of the project, which data lists add to.
        said: Of the project, which all is added to.
    """

    def __init__(self, file: File, names: Names, said: Said) -> None:
        self._file, self._names, self._said = file, names, said
        self._low, self._text = file.code.plain, file.code.text
        self._routine = ""
        self._blocks: list[_Block] = []
        self._labels: set[str] = set()
        self._gotos: list[tuple[str, int]] = []
        self._started = False
        self._place = 0

    # data lists

    def data(self) -> None:
        """Read a data list."""
        public = self._file.module.startswith("$")
        for start, end in self._lines():
            try:
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
            except Misread:
                self._unclear(start, end)

    def _initial(self, to: Variable, line: Line) -> None:
        line.take("=")
        value = line.expression()
        line.close()
        self._said.values.append((self._file, to, value))
        self._gives(to, value)

    def _imported(self, line: Line) -> None:
        """A variable of another module: what it holds is not known here."""
        for name in (token.text for token in line.rest() if token.kind == "name"):
            self._said.imported.add(name)
            variable = self._variable(name, 0)
            self._said.writes.append(Mention(variable, self._file, "imports it"))
            self._said.reads.append(Mention(variable, self._file, "imports it"))

    def _declaration(self, line: Line, scope: str, public: bool) -> list[Assignment]:
        """``DECL GLOBAL E6POS P1={...}, P2``."""
        stated = False
        while (word := line.peek()) in ("decl", "global", "const"):
            public, stated = public or word == "global", stated or word == "decl"
            line.take()
        kind = line.take()
        if kind.kind != "name" or not (stated or kind.text in table.TYPES):
            raise Misread
        given: list[Assignment] = []
        while True:
            name = line.take()
            if name.kind != "name":
                raise Misread
            self._names.declare(scope, name.text, kind.text, public)
            to = line.variable(name)
            if line.peek() == "=":
                line.take()
                given.append(Assignment(to, line.expression()))
            if not line.takes(","):
                break
        line.close()
        if self._file.data:
            for assignment in given:
                self._said.values.append((self._file, assignment.to, assignment.value))
                self._gives(assignment.to, assignment.value)
        return given

    # programs

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
                raise Broken(start, "stands outside of DEF and END")
            self._statement(start, end)
        if inside:
            self._end(len(self._text))

    def _head(self, match: re.Match[str]) -> Sequence[tuple[str, bool]]:
        key = f"{self._file.index}/{match.group('name')}"
        if key in self._said.bodies:
            raise Broken(match.start(), "is the second routine of this name")
        head = self._names.routine(self._file, match.group("name"))
        return head.parameters if head is not None and head.key == key else ()

    def _begin(self, name: str, parameters: Sequence[tuple[str, bool]]) -> None:
        self._routine = name
        self._blocks = [_Block("def", [[]])]
        self._labels, self._gotos = set(), []
        scope = f"{self._file.module}/{name}"
        taken = []
        for parameter, by_value in parameters:
            self._names.declare(scope, parameter, "", False)
            taken.append((self._variable(parameter, 0), by_value))
        self._said.parameters[f"{self._file.index}/{name}"] = taken

    def _end(self, place: int) -> None:
        if len(self._blocks) != 1:
            raise Broken(place, f"ends the routine before the end of {self._blocks[-1].word.upper()}")
        for label, start in self._gotos:
            if label not in self._labels:
                raise Broken(start, "jumps to a label that is not there")
        self._said.bodies[f"{self._file.index}/{self._routine}"] = self._blocks[0].bodies[0]

    @property
    def _body(self) -> list[Node]:
        if not self._blocks[-1].bodies:
            raise Broken(self._place, "stands before the first CASE")
        return self._blocks[-1].bodies[-1]

    def _lines(self) -> Iterator[tuple[int, int]]:
        return (match.span() for match in _LINES.finditer(self._low))

    def _line(self, start: int, end: int) -> Line:
        return Line(
            tokens(self._low, start, end), self._file.index, self._low, self._text, self._resolved, self._routine_key
        )

    def _resolved(self, name: str) -> tuple[str, bool]:
        return self._names.resolve(self._file.module, self._routine, name)

    def _routine_key(self, name: str) -> str:
        head = self._names.routine(self._file, name)
        return name if head is None else head.key

    def _variable(self, name: str, start: int) -> Variable:
        key, shared = self._resolved(name)
        return Variable(start, name.upper(), key, shared)

    def _statement(self, start: int, end: int) -> None:
        self._place = start
        try:
            line = self._line(start, end)
            if not line.ended:
                self._read(line, start, end)
        except Misread:
            self._body.append(Step(self._unclear(start, end)))

    def _unclear(self, start: int, end: int) -> Unclear:
        """A statement that is not understood may do anything with what it names."""
        for match in NAME.finditer(self._low, start, end):
            for mentions in (self._said.reads, self._said.writes):
                mentions.append(
                    Mention(self._variable(match.group(), match.start()), self._file, "is not understood, and names it")
                )
        first = NAME.search(self._low, start, end)
        return Unclear(
            f"{self._line_name(start)} is not understood{f' ({first.group().upper()[:24]})' if first else ''}"
        )

    def _line_name(self, place: int) -> str:
        return f"{self._file.code.name} line {self._file.code.line(place)}"

    def _read(self, line: Line, start: int, end: int) -> None:
        word, kind, following = line.peek(), line.kind, line.peek(1)
        if kind != "name":
            raise Misread
        if following == "=" or (following in ("[", ".") and word not in _MOVES):
            self._assigned(line)
        elif (
            following == "("
            and word not in _MOVES
            and word not in ("if", "while", "until", "switch", "wait", "return", "case")
        ):
            call = line.expression()
            line.close()
            if not isinstance(call, Function):
                raise Misread
            self._mentions(call, "passes it on")
            self._called(line)
        elif word in _MOVES or word in ("spline", "ptp_spline"):
            self._move(line)
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
                raise Misread
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

    def _said_in(self, rest: Sequence[Token]) -> None:
        """Note the variables of a part of a statement, whatever its form.

        Raises:
            Misread: it calls a routine, which may do anything.
        """
        for k, token in enumerate(rest):
            if token.kind != "name":
                continue
            opens = k + 1 < len(rest) and rest[k + 1].text == "("
            if opens and token.text not in _BEFORE_BRACKETS and token.text not in table.FUNCTIONS:
                raise Misread
            self._said.reads.append(Mention(self._variable(token.text, token.start), self._file, "computes with it"))

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

    def _written(self, assignment: Assignment) -> None:
        """Note what an assignment of a program writes and reads."""
        to, value = assignment.to, assignment.value
        does = "writes a part of it" if to.path else "writes it"
        self._said.writes.append(Mention(to, self._file, does))
        for inside in to.inside:
            self._mentions(inside, "computes with it")
        if to.path or to.worked_out:
            self._said.reads.append(Mention(to, self._file, does))
        if to.key == "$h_pos":
            return
        self._gives(to, value)
        if not isinstance(value, Aggregate):
            framed = to.key in ("$base", "$tool") or isinstance(value, Product)
            whole = isinstance(value, Variable) and value.whole
            self._mentions(
                value, "uses it as a frame" if framed else "assigns from it" if whole else "computes with it"
            )
        else:
            self._mentions(value, "computes with it")

    def _gives(self, to: Variable, value: Expression) -> None:
        if isinstance(value, Aggregate) and value.point:
            self._said.points.append((self._file, to, value))

    def _mentions(self, expression: Expression, does: str) -> None:
        for variable in variables(expression):
            self._said.reads.append(Mention(variable, self._file, does))

    def _called(self, line: Line) -> None:
        """Put the calls of a statement before it."""
        self._body.extend(self._calls(line))

    def _calls(self, line: Line) -> list[Node]:
        nodes: list[Node] = []
        for call in line.calls:
            nodes += self._call(call)
        return nodes

    def _call(self, call: Function) -> list[Node]:
        name = call.name
        if call.routine != name:
            self._passed(call)
            return [Call(call.routine, call)]
        if name in table.ODD:
            self._said.odd.add(name)
        if name == "bas" or name in table.ODD:
            return [Step(Carried(call, self._line_name(call.start)))]
        if name in table.FUNCTIONS and name not in self._names.twice:
            first = call.arguments[0] if call.arguments else None
            if name == "cwrite" and isinstance(first, Variable) and first.key == "$cmd":
                return [Step(Unclear(f"{self._line_name(call.start)} writes to the command channel"))]
            return []
        if (name in table.WRITING or name in table.PACKAGES) and name not in self._names.twice:
            if name in table.PACKAGES:
                self._said.packages.add(name.upper())
            return [Step(Assignment(variable, Worked(()))) for variable in self._passed(call)]
        self._said.missing.add(name)
        self._passed(call)
        return [Call(name, call)]

    def _passed(self, call: Function) -> list[Variable]:
        """Note that a routine may write what it is given."""
        given = [argument for argument in call.arguments if isinstance(argument, Variable)]
        for argument in call.arguments:
            self._mentions(argument, "passes it on")
        for variable in given:
            self._said.writes.append(Mention(variable, self._file, "passes it on"))
        return given

    # moves

    def _move(self, line: Line) -> None:
        token = line.take()
        word = token.text
        if word in ("spline", "ptp_spline"):
            settings = self._settings(line)
            line.close()
            self._called(line)
            self._open(_Block("spline", [[]], settings=settings), token.start)
            return
        goals: list[Goal] = []
        why = ""
        if word in table.RELATIVE or word in table.ASYNCHRONOUS:
            if not line.ended:
                self._steps(line)
        else:
            goals = [line.goal(self._type)]
            if word in table.CIRCULAR:
                line.take(",")
                goals.append(line.goal(self._type))
                if line.takes(","):
                    line.take("ca")
                    self._mentions(line.expression(), "computes with it")
                    why = "goes on by an angle (CA): the point is not its end"
        while line.peek() in table.APPROXIMATIONS:
            line.take()
        settings = self._settings(line)
        while line.peek() in table.APPROXIMATIONS:
            line.take()
        line.close()
        for goal in goals:
            self._goes(goal)
        self._called(line)
        around = tuple(s for block in self._blocks for s in block.settings)
        self._body.append(Step(Move(token.start, self._file.index, word, tuple(goals), why, (*around, *settings))))

    def _steps(self, line: Line) -> None:
        """The numbers of a relative move, and what they are relative to."""
        while True:
            self._mentions(line.expression(), "steps by it")
            if line.kind == "word":
                line.take()
            if not line.takes(","):
                return
            if line.takes("ca"):
                continue

    def _type(self, key: str) -> str:
        return self._names.types.get(key, "")

    def _settings(self, line: Line) -> tuple[Assignment, ...]:
        if not line.takes("with"):
            return ()
        settings: list[Assignment] = []
        while not settings or line.takes(","):
            to = line.variable(line.take())
            line.take("=")
            value = line.expression()
            if to.key not in ("$base", "$tool", "$ipo_mode", *table.OUTSIDE) and to.key not in table.SYSTEM_VARIABLES:
                raise Misread
            self._mentions(value, "uses it as a frame")
            settings.append(Assignment(to, value))
        return tuple(settings)

    def _goes(self, goal: Goal) -> None:
        point = goal.point
        if isinstance(point, Variable):
            for inside in point.inside:
                self._mentions(inside, "computes with it")
            if point.worked_out or point.path:
                does = "indexes it" if point.worked_out else "computes with it"
                self._said.reads.append(Mention(point, self._file, does))
        elif not isinstance(point, Aggregate):
            self._mentions(point, "computes with it")
        for frame in (*goal.before, *goal.behind):
            self._mentions(frame, "shifts by it")

    # interrupts and triggers

    def _thread(self, line: Line, first: Token, word: str) -> None:
        rest = line.rest()
        if word != "trigger" and (not rest or rest[0].text != "decl"):
            if rest and rest[0].text in ("on", "off", "enable", "disable", "delay"):
                return
            raise Misread
        at = next((k for k, token in enumerate(rest) if token.text == "do" and token.kind == "name"), -1)
        if at < 0:
            raise Misread
        self._said_in(rest[:at])
        done = Line(rest[at + 1 :], self._file.index, self._low, self._text, self._resolved, self._routine_key)
        if done.peek(1) == "(":
            call = done.expression()
            if not isinstance(call, Function):
                raise Misread
            what: Function | Assignment = call
            if self._call(call) and call.routine == call.name:
                self._said.missing.add(call.name)
        else:
            to = done.variable(done.take())
            done.take("=")
            what = Assignment(to, done.expression())
            self._written(what)
            if done.calls:
                raise Misread
        if not done.ended:
            done.take("prio")
            done.take("=")
            done.expression()
        done.close()
        self._said.threads.append(Thread(what, self._file, first.start))

    # blocks

    def _open(self, block: _Block, place: int) -> None:
        if len(self._blocks) >= DEEPEST:
            raise Broken(place, f"has more than {DEEPEST} blocks in each other")
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
            step = Assignment(counter, Worked(()))
            self._written(step)
            self._body.append(Step(step))
            again = [Step(step)]
        line.close()
        self._open(_Block(word, [] if word == "switch" else [[]], again), place)

    def _way(self, line: Line, word: str, place: int) -> None:
        block = self._blocks[-1]
        if block.word != ("if" if word == "else" else "switch") or block.last:
            raise Broken(place, f"has {word.upper()} where none can be")
        if word == "case":
            while not line.ended:
                self._mentions(line.expression(), "computes with it")
                if not line.takes(","):
                    break
        line.close()
        if line.calls:
            raise Misread
        block.last = word != "case"
        block.bodies.append([])

    def _closed(self, line: Line, word: str, place: int) -> None:
        block = self._blocks[-1]
        if word != _BODIES.get(block.word, "endspline" if block.word == "spline" else ""):
            raise Broken(place, f"has {word.upper()} where none can be")
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
