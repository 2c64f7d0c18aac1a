"""What the files of a project say of each variable and routine, noted as they are read."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from aridcal.jobs.apply.programs.krl import table
from aridcal.jobs.apply.programs.krl.expressions import Line
from aridcal.jobs.apply.programs.krl.names import File, Names
from aridcal.jobs.apply.programs.krl.syntax import (
    Aggregate,
    Assignment,
    Computation,
    ControllerCall,
    Expression,
    Function,
    Product,
    UnclearStatement,
    Variable,
    variables,
)
from aridcal.jobs.apply.programs.krl.tokens import NAME, MalformedStatement, Token, tokens
from aridcal.jobs.apply.programs.walk import Call, Node, Step

_LINES = re.compile(r"[^\n]+")

_BEFORE_BRACKETS = frozenset(
    ("not", "and", "or", "exor", "b_not", "b_and", "b_or", "b_exor", "if", "when", "path", "do")
)
"""Words before a bracket that call nothing."""


@dataclass(frozen=True, slots=True)
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
class ProjectFacts:
    """All that a project's files say.

    Attributes:
        bodies: Of routines, by key.
        parameters: Of routines: variables, and whether each is handed over by value.
        values: Of data lists: variable and value.
        points: Aggregates that variables are given.
        reads: See :class:`Mention`.
        writes: The first that writes each variable, and the first that writes one of its elements.
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
    writes: dict[tuple[str, bool], Mention] = field(default_factory=dict)
    threads: list[Thread] = field(default_factory=list)
    missing: set[str] = field(default_factory=set)
    packages: set[str] = field(default_factory=set)
    imported: set[str] = field(default_factory=set)
    odd: set[str] = field(default_factory=set)
    resumes: tuple[File, int] | None = None
    broken: list[tuple[File, int, str]] = field(default_factory=list)

    def wrote(self, mention: Mention) -> None:
        """Note that a variable is written."""
        self.writes.setdefault((mention.variable.key, mention.variable.index is not None), mention)


class Notes:
    """Notes what the statements of one file say.

    Args:
        file: The file.
        names: Of the project, which data lists add to.
        said: Of the project, which all is added to.
    """

    def __init__(self, file: File, names: Names, facts: ProjectFacts) -> None:
        self._file, self._names, self._said = file, names, facts
        self._low, self._text = file.code.plain, file.code.text
        self._routine = ""

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
        return Variable(start, sys.intern(name.upper()), key, shared)

    def _line_name(self, place: int) -> str:
        return f"{self._file.code.name} line {self._file.code.line(place)}"

    def _unclear(self, start: int, end: int) -> UnclearStatement:
        """A statement that is not understood may do anything with what it names."""
        for match in NAME.finditer(self._low, start, end):
            variable = self._variable(match.group(), match.start())
            mention = Mention(variable, self._file, "is not understood, and names it")
            self._said.reads.append(mention)
            self._said.wrote(mention)
        first = NAME.search(self._low, start, end)
        return UnclearStatement(
            f"{self._line_name(start)} is not understood{f' ({first.group().upper()[:24]})' if first else ''}"
        )

    def _imported(self, line: Line) -> None:
        """A variable of another module: what it holds is not known here."""
        for name in (token.text for token in line.rest() if token.kind == "name"):
            self._said.imported.add(name)
            variable = self._variable(name, 0)
            self._said.wrote(Mention(variable, self._file, "imports it"))
            self._said.reads.append(Mention(variable, self._file, "imports it"))

    def _declaration(self, line: Line, scope: str, public: bool) -> list[Assignment]:
        """``DECL GLOBAL E6POS P1={...}, P2``."""
        stated = False
        while (word := line.peek()) in ("decl", "global", "const"):
            public, stated = public or word == "global", stated or word == "decl"
            line.take()
        kind = line.take()
        if kind.kind != "name" or not (stated or kind.text in table.TYPES):
            raise MalformedStatement
        given: list[Assignment] = []
        while True:
            name = line.take()
            if name.kind != "name":
                raise MalformedStatement
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
                raise MalformedStatement
            self._said.reads.append(Mention(self._variable(token.text, token.start), self._file, "computes with it"))

    def _written(self, assignment: Assignment) -> None:
        """Note what an assignment of a program writes and reads."""
        to, value = assignment.to, assignment.value
        does = "writes a part of it" if to.path else "writes it"
        self._said.wrote(Mention(to, self._file, does))
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
            if self._names.types.get(variable.key) not in table.FORMS:  # these hold no points
                self._said.reads.append(Mention(variable, self._file, does))

    def _call(self, call: Function) -> list[Node]:
        name = call.name
        if call.routine != name:
            self._passed(call)
            return [Call(call.routine, call)]
        if name in table.ODD:
            self._said.odd.add(name)
        if name == "bas" or name in table.ODD:
            return [Step(ControllerCall(call, self._line_name(call.start)))]
        if name in table.FUNCTIONS and name not in self._names.twice:
            first = call.arguments[0] if call.arguments else None
            if name == "cwrite" and isinstance(first, Variable) and first.key == "$cmd":
                return [Step(UnclearStatement(f"{self._line_name(call.start)} writes to the command channel"))]
            return []
        if (name in table.WRITING or name in table.PACKAGES) and name not in self._names.twice:
            if name in table.PACKAGES:
                self._said.packages.add(name.upper())
            return [Step(Assignment(variable, Computation(()))) for variable in self._passed(call)]
        self._said.missing.add(name)
        self._passed(call)
        return [Call(name, call)]

    def _passed(self, call: Function) -> list[Variable]:
        """Note that a routine may write what it is given."""
        given = [argument for argument in call.arguments if isinstance(argument, Variable)]
        for argument in call.arguments:
            self._mentions(argument, "passes it on")
        for variable in given:
            self._said.wrote(Mention(variable, self._file, "passes it on"))
        return given
