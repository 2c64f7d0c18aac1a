"""The text of RAPID modules as data, routines and statements: the form alone, without what they mean.

A module is read by its reserved words; a statement ends at its semicolon. What is not formed as RAPID stops the reading of the
file, for whatever stands there may be anything.
"""

from __future__ import annotations

import re
import sys
from array import array
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

from aridcal.jobs.apply.programs.text import Code
from aridcal.jobs.apply.programs.walk import DEEPEST, Body, Choice, Jump, Leave, Mark, Node, Repeat, Step

LETTER = r"[A-Za-z_\x80-\xff]"
NAME = rf"{LETTER}[\w\x80-\xff]*"

REMARK = re.compile(r'"[^"\n]*"|![^\n]*')
HEADER = re.compile(r"(?:\xef\xbb\xbf)?\s*(?:%%%[^%]*%%%)?")
"""What may stand before the first module: a mark of UTF-8, and lines of S4 controllers."""

WORD = re.compile(rf"\s*({NAME})")
SPACE = re.compile(r"\s*")
PATH = re.compile(rf"({NAME})((?:\s*\{{[^{{}};]*\}}|\s*\.\s*{NAME})*)\s*(:=|:(?!=))?")
"""A name with its indices and components, and what follows a label or the left side of an assignment."""

DATA = re.compile(rf"\s*(CONST|VAR|PERS)\s+({NAME})\s+({NAME})\s*(\{{[^{{}};]*\}})?\s*(:=)?", re.IGNORECASE)
ROUTINE = re.compile(rf"\s*(PROC|TRAP|FUNC\s+{NAME})\s+({NAME})\s*", re.IGNORECASE)
PARAMETER = re.compile(rf"(\\?)\s*(?:(VAR|PERS|INOUT)\s+)?({NAME})\s+({NAME})\s*(\{{[^{{}}]*\}})?", re.IGNORECASE)
RECORD = re.compile(rf"\s*RECORD\s+({NAME})((?:\s+{NAME}\s+{NAME}\s*;)*)\s*ENDRECORD\b", re.IGNORECASE)
ALIAS = re.compile(rf"\s*ALIAS\s+({NAME})\s+({NAME})\s*;", re.IGNORECASE)
MODULE = re.compile(r"\s*MODULE\s+([\w\x80-\xff]+)\s*(?:\(([^()]*)\))?", re.IGNORECASE)
LOOP = re.compile(rf"\s*({NAME})\s+FROM\b(.*?)\bTO\b(.*)", re.IGNORECASE | re.DOTALL)
THEN = re.compile(r"\bTHEN\b|;", re.IGNORECASE)
DO = re.compile(r"\bDO\b|;", re.IGNORECASE)
CASES = re.compile(r"\b(?:CASE|DEFAULT|ENDTEST)\b|;", re.IGNORECASE)
COLON = re.compile(r":(?!=)|;")
PLACEHOLDER = re.compile(r"\s*<[A-Z]{3}>")
RESERVED = frozenset(
    (
        *(
            "backward",
            "case",
            "connect",
            "const",
            "default",
            "do",
            "else",
            "elseif",
            "endfor",
            "endfunc",
            "endif",
            "endmodule",
        ),
        *(
            "endproc",
            "endrecord",
            "endtest",
            "endtrap",
            "endwhile",
            "error",
            "for",
            "from",
            "func",
            "goto",
            "if",
            "inout",
        ),
        *(
            "local",
            "module",
            "pers",
            "proc",
            "raise",
            "record",
            "retry",
            "return",
            "step",
            "task",
            "test",
            "then",
            "to",
            "trap",
        ),
        *("trynext", "undo", "var", "while"),
    )
)
"""Words that stand in no statement of one kind: one of them there means that a semicolon is missing."""

WORDS = re.compile(NAME)

OPERAND = re.compile(
    rf'\s*(?:(?:NOT\b|[-+])\s*)*(?:"[^"]*"(?:"[^"]*")*|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|({NAME}))', re.IGNORECASE
)
OPERATOR = re.compile(r"\s*(?:<>|<=|>=|[-+*/=<>]|(?:AND|OR|XOR|DIV|MOD)\b)", re.IGNORECASE)
BEHIND = re.compile(rf"\s*(?:([({{])|\.\s*{NAME})")


class MalformedStatement(Exception):
    """A text is not formed as RAPID; the place of it, and what is wrong."""

    def __init__(self, place: int, why: str) -> None:
        super().__init__(why)
        self.place = place


class Statement(NamedTuple):
    """A statement, as it stands.

    Attributes:
        kind: ``call``, ``assign``, ``late`` (the name of the procedure is worked out), ``connect``, or ``read`` (an expression).
        start: Its first letter.
        end: Behind its last one.
        name: Of the routine that is called, in small letters; the name of the data that is assigned to.
        body: Where its arguments, or the expression of an assignment, begin.
        loops: Names of the loops that it stands in.
    """

    kind: str
    start: int
    end: int
    name: str = ""
    body: int = 0
    loops: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class DataDeclaration:
    """Data, or a parameter.

    Attributes:
        storage: ``const``, ``var``, ``pers``; of a parameter ``in``, ``var``, ``pers``, ``inout`` or ``switch``.
        type: In small letters.
        name: As it is written.
        place: Where its name stands.
        array: Whether it has elements.
        value: Where its value begins and ends; None where none stands there.
        local: Whether other modules do not see it.
        optional: Of a parameter.
    """

    storage: str
    type: str
    name: str
    place: int
    array: bool = False
    value: tuple[int, int] | None = None
    local: bool = False
    optional: bool = False


@dataclass
class Routine:
    """A procedure, a function or a trap.

    Attributes:
        name: As it is written.
        kind: ``proc``, ``func`` or ``trap``.
        local: Whether other modules do not see it.
        place: Where its name stands.
        parameters: In their order.
        data: Its own.
        body: What it does.
        handlers: Bodies behind ERROR, UNDO and BACKWARD.
        goes_on: Whether an error may end it, or what it calls, and the program goes on.
    """

    name: str
    kind: str
    local: bool
    place: int
    parameters: list[DataDeclaration] = field(default_factory=list)
    data: list[DataDeclaration] = field(default_factory=list)
    body: list[Node] = field(default_factory=list)
    handlers: list[list[Node]] = field(default_factory=list)
    goes_on: bool = False


@dataclass
class Module:
    """A module.

    Attributes:
        code: The file that it stands in.
        name: As it is written.
        data: Of the module.
        routines: Likewise.
        records: Components of its own types, in small letters.
        aliases: Its other names of types.
    """

    code: Code
    name: str
    data: list[DataDeclaration] = field(default_factory=list)
    routines: list[Routine] = field(default_factory=list)
    records: dict[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)


def fold(name: str) -> str:
    """A name for comparison: RAPID does not tell capital letters from small ones. One string wherever a name stands."""
    if not name.isascii():
        with suppress(UnicodeError):  # not UTF-8, or folded already
            name = name.encode("latin-1").decode("utf-8")
    return sys.intern(name.lower())


def blanked(text: str) -> str:
    """The text with comments, and what stands in strings, as blanks; the quotes stay."""

    def blank(match: re.Match[str]) -> str:
        length = match.end() - match.start()
        return f'"{" " * (length - 2)}"' if match.group()[0] == '"' else " " * length

    return REMARK.sub(blank, text)


def modules(code: Code) -> list[Module]:
    """The modules of a file.

    Raises:
        NotUnderstood: where the text is not formed as RAPID.
    """
    return _Reader(code).file()


class _Block:
    """An open statement of several lines: what it is, the body that is being read, and its bodies so far."""

    def __init__(self, word: str, place: int, loops: tuple[str, ...] = (), once: bool = False) -> None:
        self.word, self.place, self.loops, self.once = word, place, loops, once
        self.body: list[Node] = []
        self.ways: list[list[Node]] = []
        self.all = False


class _Reader:
    def __init__(self, code: Code) -> None:
        self.code, self.plain = code, code.plain
        self.place = 0
        self._ends = array("I", [m.start() for m in re.finditer(";", self.plain)])

    def file(self) -> list[Module]:
        match = HEADER.match(self.plain)
        assert match is not None
        self.place = match.end()
        if (bare := re.search(r"\r(?!\n)", self.code.text)) is not None:
            raise MalformedStatement(bare.start(), "a line ends in a bare carriage return: save it with line feeds")
        self._shallow()
        modules: list[Module] = []
        while (header := MODULE.match(self.plain, self.place)) is not None:
            self.place = header.end()
            module = Module(self.code, header.group(1))
            self._module(module, "endmodule")
            modules.append(module)
        if not modules:
            module = Module(self.code, "")
            self._module(module, "")
            modules.append(module)
        self._space()
        if self.place < len(self.plain):
            raise MalformedStatement(self.place, "text stands behind the module")
        return modules

    def _shallow(self) -> None:
        """Make sure that brackets do not stand in brackets without end."""
        deep = 0
        for match in re.finditer(r"[()]", self.plain):
            deep += 1 if match.group() == "(" else -1
            if deep > DEEPEST:
                raise MalformedStatement(match.start(), f"more than {DEEPEST} brackets stand in each other")

    def _space(self) -> None:
        match = SPACE.match(self.plain, self.place)
        assert match is not None
        self.place = match.end()

    def _module(self, module: Module, end: str) -> None:
        while True:
            self._space()
            if self.place >= len(self.plain):
                if end:
                    raise MalformedStatement(self.place, "the module has no end")
                _once(module.routines)
                return
            if placeholder := PLACEHOLDER.match(self.plain, self.place):
                self.place = placeholder.end()
                continue
            start, (word, local) = self.place, self._scope()
            if word == "endmodule" and end:
                self.place = start + len(word)
                _once(module.routines)
                return
            if word in ("const", "var", "pers"):
                module.data.append(self._declared(local))
            elif word in ("proc", "func", "trap"):
                module.routines.append(self._routine(local))
            elif word == "record" and (record := RECORD.match(self.plain, self.place)):
                parts = [fold(part) for part in re.findall(NAME, record.group(2))]
                module.records[fold(record.group(1))] = tuple(zip(parts[1::2], parts[::2], strict=True))
                self.place = record.end()
            elif word == "alias" and (alias := ALIAS.match(self.plain, self.place)):
                module.aliases[fold(alias.group(2))] = fold(alias.group(1))
                self.place = alias.end()
            else:
                raise MalformedStatement(start, "no declaration of RAPID stands here")

    def _scope(self) -> tuple[str, bool]:
        """The next word behind LOCAL and TASK, and whether LOCAL stands there."""
        local = False
        while True:
            match = WORD.match(self.plain, self.place)
            word = match.group(1).lower() if match else ""
            if match is None or word not in ("local", "task"):
                return word, local
            local = local or word == "local"
            self.place = match.end()

    def _declared(self, local: bool = False) -> DataDeclaration:
        match = DATA.match(self.plain, self.place)
        end = self._semicolon(self.place)
        if match is None or match.end() > end:
            raise MalformedStatement(self.place, "no declaration of RAPID stands here")
        value = (match.end(), end) if match.group(5) else None
        if value is None and self.plain[match.end() : end].strip():
            raise MalformedStatement(match.end(), "no declaration of RAPID stands here")
        if value is not None:
            self._one_statement(*value)
        self.place = end + 1
        return DataDeclaration(
            fold(match.group(1)),
            fold(match.group(2)),
            match.group(3),
            match.start(3),
            match.group(4) is not None,
            value,
            local,
        )

    def _semicolon(self, place: int) -> int:
        k = bisect_left(self._ends, place)
        if k == len(self._ends):
            raise MalformedStatement(place, "the statement has no end")
        return self._ends[k]

    def _one_statement(self, start: int, end: int) -> None:
        if RESERVED.isdisjoint(WORDS.findall(self.plain[start:end].lower())):
            return
        for match in WORDS.finditer(self.plain, start, end):
            if match.group().lower() in RESERVED and self.plain[match.start() - 1] not in "\\.":
                what = f"{match.group()} stands inside of a statement: is a semicolon missing?"
                raise MalformedStatement(match.start(), what)

    def _routine(self, local: bool) -> Routine:
        match = ROUTINE.match(self.plain, self.place)
        if match is None:
            raise MalformedStatement(self.place, "a routine has no name")
        kind = match.group(1)[:4].lower()
        routine = Routine(match.group(2), kind, local, match.start(2))
        self.place = match.end()
        if kind != "trap":
            end = self.code.closing(self.place) if self.plain[self.place : self.place + 1] == "(" else -1
            if end < 0:
                raise MalformedStatement(self.place, "a routine has no parameters in round brackets")
            routine.parameters = self._parameters(self.place + 1, end)
            self.place = end + 1
        while self._scope()[0] in ("const", "var", "pers"):
            routine.data.append(self._declared())
        _once((*routine.parameters, *routine.data))
        _RoutineReader(self, routine).read()
        return routine

    def _parameters(self, start: int, end: int) -> list[DataDeclaration]:
        parameters: list[DataDeclaration] = []
        for first, last in self.code.arguments(start, end):
            place, optional = first, False
            while place < last:
                match = PARAMETER.match(self.plain, place, last)
                if match is None:
                    raise MalformedStatement(place, "no parameter of RAPID stands here")
                kind = fold(match.group(3))
                storage = "switch" if kind == "switch" else (match.group(2) or "in").lower()
                optional = optional or match.group(1) == "\\"
                array = match.group(5) is not None
                parameters.append(
                    DataDeclaration(storage, kind, match.group(4), match.start(4), array, optional=optional)
                )
                place = match.end()
                while place < last and self.plain[place] in " \t\r\n|":  # one of several optional ones
                    place += 1
        return parameters


class _RoutineReader:
    """The statements of one routine, up to its end."""

    def __init__(self, reader: _Reader, routine: Routine) -> None:
        self._reader, self._routine = reader, routine
        self._code, self._plain = reader.code, reader.plain
        self._open = [_Block("routine", reader.place)]
        self._end = "end" + routine.kind
        self._target = routine.body

    def read(self) -> None:
        reader = self._reader
        while True:
            match = WORD.match(self._plain, reader.place)
            if match is None:
                self._no_word()
                continue
            word = match.group(1).lower()
            reader.place = match.start(1)
            if word == self._end:
                self._close("routine")
                self._target.extend(self._open[0].body)
                reader.place = match.end()
                return
            if word in ("error", "undo", "backward") and len(self._open) == 1 and self._heads_handler(match.end()):
                self._begin_handler(word, match.end())
                continue
            handler = getattr(self, f"_{word}", None) if word in _STRUCTURE else None
            if handler is not None:
                reader.place = match.end()
                handler(match.start(1))
            else:
                self._statement(match.start(1))

    def _no_word(self) -> None:
        reader = self._reader
        reader._space()
        if placeholder := PLACEHOLDER.match(self._plain, reader.place):
            reader.place = placeholder.end()
        elif self._plain.startswith("%", reader.place):
            start = reader.place
            end = reader._semicolon(start)
            reader._one_statement(start, end)
            self._add(Step(Statement("late", start, end, "", start, self._loops())))
            reader.place = end + 1
        elif self._plain.startswith(";", reader.place):
            reader.place += 1
        else:
            raise MalformedStatement(reader.place, "no statement of RAPID stands here")

    def _heads_handler(self, place: int) -> bool:
        """Whether a word is no name of data, a label or a routine."""
        space = SPACE.match(self._plain, place)
        assert space is not None
        return not self._plain.startswith((":", ";", "{", "."), space.end())

    def _begin_handler(self, word: str, place: int) -> None:
        self._target.extend(self._open[0].body)
        self._target = []
        self._routine.handlers.append(self._target)
        if word == "error":
            self._routine.goes_on = True
            codes = re.compile(r"\s*\(([^()]*)\)").match(self._plain, place)  # ERROR (ERR_A, ERR_B)
            place = codes.end() if codes else place
        self._open = [_Block("routine", place)]
        self._reader.place = place

    def _loops(self) -> tuple[str, ...]:
        return self._open[-1].loops

    def _add(self, *nodes: Node) -> None:
        self._open[-1].body.extend(nodes)

    def _read_expression(self, start: int, end: int) -> None:
        self._reader._one_statement(start, end)
        self._add(Step(Statement("read", start, end, "", start, self._loops())))

    def _begin(self, word: str, place: int, loop: str = "", once: bool = False) -> None:
        if len(self._open) > DEEPEST:
            raise MalformedStatement(place, f"more than {DEEPEST} statements stand in each other")
        loops = (*self._loops(), *([loop] if loop else []))
        self._open.append(_Block(word, place, loops, once))

    def _close(self, word: str) -> _Block:
        block = self._open[-1]
        if block.word != word:
            raise MalformedStatement(
                self._reader.place, f"{block.word.upper()} of line {self._code.line(block.place)} has no end"
            )
        return self._open.pop() if word != "routine" else block

    def _until(self, pattern: re.Pattern[str], missing: str) -> tuple[int, str]:
        match = pattern.search(self._plain, self._reader.place)
        if match is None:
            raise MalformedStatement(self._reader.place, f"{missing} is missing")
        return match.start(), match.group()

    def _if(self, start: int) -> None:
        begin = self._reader.place
        end, word = self._until(THEN, "THEN")
        if word == ";":
            self._one_line(start, begin, end)
            return
        self._read_expression(begin, end)
        self._reader.place = end + len(word)
        self._begin("if", start)

    def _one_line(self, start: int, begin: int, end: int) -> None:
        """`IF condition statement;`: the statement begins where an operand has no operator behind it."""
        place = self._behind_expression(begin, end)
        self._read_expression(begin, place)
        self._begin("one-line if", start)
        self._reader.place = place
        match = WORD.match(self._plain, place)
        word = match.group(1).lower() if match else ""
        if match is not None and word in _SIMPLE:
            self._reader.place = match.end()
            getattr(self, f"_{word}")(match.start(1))
        elif match is not None and word not in _STRUCTURE:
            self._statement(match.start(1))
        elif match is None and self._plain[place:end].strip().startswith("%"):
            self._no_word()
        else:
            raise MalformedStatement(place, "IF has neither THEN nor a statement")
        self._add(Choice((tuple(self._close("one-line if").body), ())))

    def _behind_expression(self, place: int, end: int) -> int:
        while True:
            space = SPACE.match(self._plain, place)
            assert space is not None
            bracket = re.compile(r"(?:(?:NOT\b|[-+])\s*)*\(", re.IGNORECASE).match(self._plain, space.end(), end)
            if bracket is not None:
                place = self._behind_bracket(bracket.end() - 1)
            else:
                operand = OPERAND.match(self._plain, place, end)
                if operand is None:
                    raise MalformedStatement(place, "no expression of RAPID stands here")
                place = operand.end()
            while (part := BEHIND.match(self._plain, place, end)) is not None:
                place = self._behind_bracket(part.start(1)) if part.group(1) else part.end()
            operator = OPERATOR.match(self._plain, place, end)
            if operator is None:
                return place
            place = operator.end()

    def _behind_bracket(self, place: int) -> int:
        end = self._code.closing(place)
        if end < 0:
            raise MalformedStatement(place, "a bracket has no end")
        return end + 1

    def _elseif(self, start: int) -> None:
        block = self._open[-1]
        if block.word != "if" or block.all:
            raise MalformedStatement(start, "ELSEIF has no IF")
        begin = self._reader.place
        end, word = self._until(THEN, "THEN")
        if word == ";":
            raise MalformedStatement(start, "ELSEIF has no THEN")
        self._next_way()
        self._read_expression(begin, end)
        self._reader.place = end + len(word)

    def _next_way(self) -> None:
        block = self._open[-1]
        block.ways.append(block.body)
        block.body = []

    def _else(self, start: int) -> None:
        block = self._open[-1]
        if block.word != "if" or block.all:
            raise MalformedStatement(start, "ELSE has no IF")
        self._next_way()
        block.all = True

    def _endif(self, start: int) -> None:
        self._add_choice(self._close("if"))

    def _add_choice(self, block: _Block) -> None:
        block.ways.append(block.body)
        self._add(Choice((*(tuple(way) for way in block.ways), *(() if block.all else ((),)))))

    def _while(self, start: int) -> None:
        begin = self._reader.place
        end, word = self._until(DO, "DO")
        if word == ";":
            raise MalformedStatement(start, "WHILE has no DO")
        self._begin("while", start, once=self._plain[begin:end].strip().lower() == "true")
        self._read_expression(begin, end)
        self._reader.place = end + len(word)

    def _endwhile(self, start: int) -> None:
        self._add_loop(self._close("while"))

    def _add_loop(self, block: _Block) -> None:
        self._add(Repeat(tuple(block.body), block.once))

    def _for(self, start: int) -> None:
        begin = self._reader.place
        end, word = self._until(DO, "DO")
        match = LOOP.fullmatch(self._plain, begin, end) if word != ";" else None
        if match is None:
            raise MalformedStatement(start, "FOR has no FROM, TO and DO")
        last = re.split(r"(?i)\bSTEP\b", match.group(3))
        self._read_expression(match.start(2), match.end(2))
        self._read_expression(match.start(3), match.start(3) + len(last[0]))
        self._begin("for", start, fold(match.group(1)), _counts(match.group(2), last[0]) and len(last) == 1)
        self._reader.place = end + len(word)

    def _endfor(self, start: int) -> None:
        self._add_loop(self._close("for"))

    def _test(self, start: int) -> None:
        begin = self._reader.place
        end, word = self._until(CASES, "ENDTEST")
        if word == ";":
            raise MalformedStatement(start, "TEST has no CASE")
        self._read_expression(begin, end)
        self._reader.place = end
        self._begin("test", start)

    def _case(self, start: int) -> None:
        begin = self._reader.place
        end, word = self._until(COLON, "the colon of CASE")
        block = self._open[-1]
        if block.word != "test" or word == ";" or block.all:
            raise MalformedStatement(start, "CASE stands in no TEST")
        self._next_way()
        self._read_expression(begin, end)
        self._reader.place = end + 1

    def _default(self, start: int) -> None:
        end, word = self._until(COLON, "the colon of DEFAULT")
        block = self._open[-1]
        if block.word != "test" or word == ";" or block.all or self._plain[self._reader.place : end].strip():
            raise MalformedStatement(start, "DEFAULT stands in no TEST")
        self._next_way()
        block.all = True
        self._reader.place = end + 1

    def _endtest(self, start: int) -> None:
        block = self._close("test")
        if block.ways and block.ways[0]:
            raise MalformedStatement(start, "a statement stands before the first CASE")
        block.ways = block.ways[1:]
        self._add_choice(block)

    def _simple(self, start: int, node: Node) -> None:
        """A statement of control flow, after what it reads."""
        begin = self._reader.place
        end = self._reader._semicolon(begin)
        if self._plain[begin:end].strip():
            self._read_expression(begin, end)
        self._add(node)
        self._reader.place = end + 1

    def _return(self, start: int) -> None:
        self._simple(start, Leave("routine"))

    def _raise(self, start: int) -> None:
        self._simple(start, Leave("routine"))

    def _retry(self, start: int) -> None:
        self._simple(start, Leave("routine"))

    def _trynext(self, start: int) -> None:
        self._simple(start, Leave("routine"))

    def _exit(self, start: int) -> None:
        self._simple(start, Leave("program"))

    def _goto(self, start: int) -> None:
        match = WORD.match(self._plain, self._reader.place)
        end = self._reader._semicolon(self._reader.place)
        if match is None or self._plain[match.end() : end].strip():
            raise MalformedStatement(start, "GOTO has no label")
        self._add(Jump(fold(match.group(1))))
        self._reader.place = end + 1

    def _connect(self, start: int) -> None:
        end = self._reader._semicolon(start)
        words = re.split(r"(?i)\s+WITH\s+", self._plain[self._reader.place : end])
        if len(words) != 2:
            raise MalformedStatement(start, "CONNECT has no WITH")
        self._add(Step(Statement("connect", start, end, fold(words[1].strip()), end, self._loops())))
        self._reader.place = end + 1

    def _statement(self, start: int) -> None:
        match = PATH.match(self._plain, start)
        assert match is not None
        name, sign = fold(match.group(1)), match.group(3)
        if name in RESERVED:
            raise MalformedStatement(start, f"{name.upper()} does not belong here")
        if sign == ":" and not match.group(2):
            self._add(Mark(name))
            self._reader.place = match.end()
            return
        end = self._reader._semicolon(start)
        body = match.end() if sign else match.end(1)
        self._reader._one_statement(body, end)
        if name == "exitcycle":
            self._add(Step(Statement("call", start, end, name, body, self._loops())), Leave("program"))
        else:
            self._add(Step(Statement("assign" if sign == ":=" else "call", start, end, name, body, self._loops())))
        self._reader.place = end + 1


_SIMPLE = frozenset(("return", "raise", "retry", "trynext", "exit", "goto", "connect"))
"""Statements that may stand behind the condition of an IF of one line."""

_STRUCTURE = _SIMPLE | {
    *("if", "elseif", "else", "endif", "while", "endwhile", "for", "endfor", "test", "case", "default", "endtest")
}

WHOLE = re.compile(r"\s*-?\d+\s*")


def _counts(first: str, last: str) -> bool:
    """Whether a loop between plain numbers is carried out once at least."""
    return WHOLE.fullmatch(first) is not None and WHOLE.fullmatch(last) is not None and int(first) <= int(last)


def _once(every: Iterable[DataDeclaration | Routine]) -> None:
    """Make sure that no name is declared twice."""
    names: set[str] = set()
    for own in every:
        if fold(own.name) in names:
            raise MalformedStatement(own.place, f"{own.name} is declared twice")
        names.add(fold(own.name))


def bodies(routine: Routine) -> Sequence[Body]:
    """All that a routine may carry out."""
    return (routine.body, *routine.handlers)
