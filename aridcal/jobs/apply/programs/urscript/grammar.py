"""The text of a URScript as routines of statements; what is no statement of the language is kept as such."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from aridcal.jobs.apply.programs.text import Code, blanked
from aridcal.jobs.apply.programs.urscript.table import MOVES, RULES
from aridcal.jobs.apply.programs.walk import DEEPEST, Body, Call, Choice, Leave, Node, Repeat, Step

_NUMBER = r"(?:\d++\.?+\d*+|\.\d++)(?:[eE][-+]?+\d++)?"

_SPACE = r"[ \t\r\n]*+"

_NAME = r"[A-Za-z_\x80-\xff][\w\x80-\xff]*+"

_GAP = r"[ \t]*+"

_LIST = rf"\[{_SPACE}(?:[-+]?+{_NUMBER}{_SPACE},{_SPACE})*[-+]?+{_NUMBER}{_SPACE}\]"

_GOAL = rf"(?:pose_trans\({_GAP}{_NAME}{_GAP},{_GAP}p{_LIST}{_GAP}\)|p?+{_LIST})"

_ARGUMENT = rf"(?:(?P<keyword>{_NAME}){_GAP}={_GAP})?(?:(?P<word>{_NAME})|(?P<value>{_NUMBER}(?![\w.])))"

_ARGUMENTS = rf"(?:{_GAP},{_GAP}{re.sub('[?]P<[a-z]+>', '?:', _ARGUMENT)})*"

TOKENS = re.compile(
    rf"""
    (?P<blank>[ \t]++|\r(?=\n)|\#[^\n]*+)
  | (?P<line>[\n;])
  | (?P<move>(?:{"|".join(MOVES)})\({_GOAL}{_ARGUMENTS}{_GAP}\))
  | (?P<list>(?:p[ \t]*+)?{_LIST})
  | (?P<pose>p[ \t]*+\[)
  | (?P<name>{_NAME})
  | (?P<number>(?:0[xX][0-9a-fA-F]++|{_NUMBER})(?![\w.]))
  | (?P<text>"[^"\n]*+")
  | (?P<note>\$[ \t]*+\d[^\n]*+)
  | (?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\],:.])
  | (?P<odd>[\w.]++|.)
    """,
    re.VERBOSE | re.ASCII,
)
"""A list of plain numbers is one token, and so is a move to such a list, or to one in a frame that has a name, with names and
numbers behind it: programs of offline systems consist of them. A note is PolyScope's name of a line."""

ARGUMENT = re.compile(_ARGUMENT, re.ASCII)
"""What stands behind the goal of such a move."""

COMMENTS = r'"[^"\n]*+"|#[^\n]*+'

DEFINITION = re.compile(rf"\b(?:def|thread|sec)[ \t]++({_NAME})", re.ASCII)

WORD = re.compile(_NAME, re.ASCII)

BLOCKS = ("def", "thread", "sec", "if", "while")

KEYWORDS = frozenset(BLOCKS) | {
    *("elif", "else", "end", "return", "break", "continue", "halt", "pause", "enter_critical", "exit_critical"),
    *("global", "local", "run", "join", "kill", "and", "or", "xor", "not", "True", "False"),
}

LONGEST_HEX = 18
"""Letters of 64 bits with their `0x`; what is longer is no number of a controller."""

BYTE_ORDER_MARK = "\xef\xbb\xbf"

TOP = ""
"""The name of the routine of all statements outside of functions."""


class MalformedProgram(Exception):
    """The text is no program as a whole: its blocks do not fit each other, or are too deep."""


class _Garbled(Exception):
    """A statement that is none of the language."""


Spot = tuple[int, int]
"""A file, and a place in it."""


class Literal(NamedTuple):
    """A list of plain numbers, of a pose where ``p`` stands before it."""

    file: int
    place: int
    end: int
    pose: bool

    @property
    def key(self) -> tuple[int, int]:
        """Its name for the ledger."""
        return self.file, self.place


class Name(NamedTuple):
    """A variable, in the routine that says it."""

    routine: Routine
    name: str


class Constant(NamedTuple):
    """A number."""

    value: float


class Text(NamedTuple):
    """A string, with its quotes."""

    text: str


class Listing(NamedTuple):
    """A list of anything."""

    pose: bool
    items: tuple[Expression, ...]
    at: Spot


class Operation(NamedTuple):
    """Operands with operators between them; ``not`` and signs have one operand."""

    operators: tuple[str, ...]
    operands: tuple[Expression, ...]
    at: Spot


class Element(NamedTuple):
    """An element of a list, by an index; None for the member of a structure."""

    of: Expression
    which: Expression | None
    at: Spot


class FunctionCall(NamedTuple):
    """A function of the language, of the program, or of neither; keywords are empty where there are none."""

    name: str
    arguments: Arguments
    at: Spot
    routines: Sequence[str]


class Method(NamedTuple):
    """A method of a list, or of a server of remote procedure calls."""

    of: Expression
    arguments: Arguments
    at: Spot


class Run(NamedTuple):
    """A thread is started."""

    called: FunctionCall


Arguments = tuple[tuple[str, "Expression"], ...]
"""What a function is given, with keywords where they stand there."""

Expression = Literal | Name | Constant | Text | Listing | Operation | Element | FunctionCall | Method | Run


class Assign(NamedTuple):
    """A value is given to a name, to an element or to a member."""

    to: Expression
    value: Expression
    scope: str
    at: Spot


class Evaluate(NamedTuple):
    """An expression is worked out: a call, or a condition."""

    value: Expression
    at: Spot


class Return(NamedTuple):
    """A function gives back a value."""

    value: Expression | None
    at: Spot


class NoStatement(NamedTuple):
    """What nobody knows the meaning of."""

    names: tuple[Name, ...]
    literals: tuple[Literal, ...]
    why: str
    at: Spot


@dataclass(eq=False)
class Routine:
    """A function, a thread, or all that stands outside of them.

    Attributes:
        key: Its name among all routines of the project.
        name: In the program.
        kind: ``def``, ``thread``, ``sec``, or ``top``.
        file: Index of its file.
        parent: The routine that it stands in.
        parameters: Their names.
        body: What it does.
        local: Names of parameters, and those that are declared to be local.
        assigned: Names that it sets and declares neither global nor local; where first.
        calls: Keys of all routines that it calls or starts.
    """

    key: str
    name: str
    kind: str
    file: int
    parent: Routine | None
    parameters: tuple[str, ...] = ()
    body: Body = ()
    local: set[str] = field(default_factory=set)
    assigned: dict[str, int] = field(default_factory=dict)
    calls: set[str] = field(default_factory=set)


@dataclass
class File:
    """A file as routines.

    Attributes:
        routines: In the order of the text, all that stands outside of functions first.
        declared: Names that are declared to be global; where first.
        titles: What the program calls a literal, by its place.
    """

    routines: list[Routine]
    declared: dict[str, int]
    titles: dict[int, str]


class Token(NamedTuple):
    """A piece of the text."""

    kind: str
    text: str
    place: int


def code_of(file: int, name: str, text: str) -> Code:
    """A file's text, to be read."""
    if text.startswith(BYTE_ORDER_MARK):
        text = " " * len(BYTE_ORDER_MARK) + text[len(BYTE_ORDER_MARK) :]
    return Code(file, name, text, blanked(text, COMMENTS))


def lines_of(code: Code) -> Iterator[list[Token]]:
    """The tokens of each line, and its end; a line goes on where brackets are open that are closed later."""
    line: list[Token] = []
    inside = -1
    for match in TOKENS.finditer(code.text):
        kind, text, place = match.lastgroup or "", match.group(), match.start()
        if kind == "line" and (place > inside or text == ";"):
            yield [*line, Token(kind, text, place)]
            line.clear()
        elif kind == "pose" or (kind == "sign" and text in "(["):
            inside = max(inside, code.closing(match.end() - 1))
            line.append(Token(kind, text, place))
        elif kind not in ("blank", "line"):
            line.append(Token(kind, text, place))
    yield [*line, Token("line", "", len(code.text))]


def definitions(code: Code) -> Iterator[tuple[str, int]]:
    """Names of all routines of a file, and where they stand."""
    for match in DEFINITION.finditer(code.plain):
        yield match.group(1), match.start(1)


@dataclass
class _Block:
    kind: str
    body: list[Node] = field(default_factory=list)
    ways: list[Body] = field(default_factory=list)
    condition: tuple[Node, ...] = ()


class Parser:
    """Reads one file.

    Args:
        code: The file.
        routines: Keys of the routines that each name may mean here.
        keys: Of the routines of this file, by the places of their names.

    A statement that cannot be read costs its line; blocks that do not fit cost the file.
    """

    def __init__(self, code: Code, routines: Mapping[str, Sequence[str]], keys: Mapping[int, str]) -> None:
        self._code, self._routines, self._keys = code, routines, keys
        self._tokens: list[Token] = []
        self._at = 0
        self._routine = Routine(f"{TOP} {code.file}", TOP, "top", code.file, None)
        self._blocks = [_Block("top")]
        self._pending: list[Node] = []
        self._file = File([self._routine], {}, {})
        self._arguments: dict[tuple[str, str], Arguments] = {}

    def file(self) -> File:
        """All routines of the file.

        Raises:
            Malformed: naming where.
        """
        for line in lines_of(self._code):
            self._tokens, self._at = line, 0
            while (token := self._tokens[self._at]).kind != "line":
                start = self._at
                try:
                    self._statement(token)
                except _Garbled as problem:
                    self._skip(start, str(problem))
                self._pending.clear()
        if len(self._blocks) > 1:
            raise MalformedProgram(f"a `{self._blocks[-1].kind}` has no `end`")
        self._routine.body = tuple(self._blocks[0].body)
        return self._file

    def _spot(self, token: Token) -> Spot:
        return self._code.file, token.place

    def _malformed(self, what: str, token: Token) -> MalformedProgram:
        return MalformedProgram(f"line {self._code.line(token.place)}: {what}")

    def _skip(self, start: int, why: str) -> None:
        """Pass over a line of which nobody knows the meaning; a block that it seems to begin is kept."""
        line = self._tokens[start:-1]
        if line[0].text in ("elif", "else", "end"):
            raise self._malformed(f"{line[0].text} is not read", line[0])
        words = [word for t in line if t.kind in ("name", "move") for word in WORD.findall(t.text)]
        names = tuple(self._name(word) for word in words if word not in KEYWORDS)
        literals = tuple(self._literal(t) for t in line if t.kind == "list")
        self._add(Step(NoStatement(names, literals, why, self._spot(line[0]))))
        if line[0].text in BLOCKS or line[-1].text == ":":
            self._open("?", line[0])
        self._at = len(self._tokens) - 1

    # Blocks

    def _add(self, *nodes: Node) -> None:
        body = self._blocks[-1].body
        body += self._pending
        body += nodes
        self._pending.clear()

    def _open(self, kind: str, token: Token) -> None:
        if len(self._blocks) > DEEPEST:
            raise self._malformed("is nested too deep", token)
        condition = tuple(self._pending)
        self._pending.clear()
        self._blocks.append(_Block(kind, condition=condition))

    def _close(self, token: Token) -> None:
        if len(self._blocks) == 1:
            raise self._malformed("`end` ends nothing", token)
        block = self._blocks.pop()
        body = tuple(block.body)
        if block.kind == "def":
            self._routine.body = body
            assert self._routine.parent is not None
            self._routine = self._routine.parent
        elif block.kind == "while":
            leaves = Choice(((Leave("loop"),), body))
            self._add(Repeat((*block.condition, leaves), once=True))
        elif block.kind == "forever":
            self._add(Repeat(body, once=True))
        elif block.kind == "?":
            self._add(Repeat(body))
        else:  # an `if` without `else` may take no way
            self._add(Choice((*block.ways, body, *(() if block.kind == "else" else ((),)))))

    # Statements

    def _statement(self, token: Token) -> None:
        if token.kind == "note":
            self._at += 1
            return
        if token.kind not in ("name", "move", "list", "pose"):  # p[2] may be an element of a variable p
            raise _Garbled("is no statement of URScript")
        reader = _STATEMENTS.get(token.text, Parser._expression_statement)
        reader(self, token)
        after = self._tokens[self._at]
        if after.kind not in ("line", "name", "move", "note"):
            raise _Garbled(f"{after.text} is not understood there")

    def _definition(self, token: Token) -> None:
        self._at += 1
        name = self._take("name")
        self._expect("(")
        parameters = []
        while self._tokens[self._at].text != ")":
            parameters.append(self._take("name").text)
            if self._tokens[self._at].text == "=":
                self._at += 1
                self._expression(0)
            if self._tokens[self._at].text != ")":
                self._expect(",")
        self._expect(")")
        self._expect(":")
        self._pending.clear()  # what is worked out for a parameter that is not given
        self._open("def", token)
        key = self._keys[name.place]
        kind = "thread" if token.text == "thread" else "def"
        self._routine = Routine(key, name.text, kind, self._code.file, self._routine, tuple(parameters))
        self._routine.local.update(parameters)
        self._file.routines.append(self._routine)

    def _if(self, token: Token) -> None:
        self._condition(token)
        self._add()
        self._open("if", token)

    def _while(self, token: Token) -> None:
        condition = self._condition(token)
        forever = isinstance(condition, Name) and condition.name == "True"
        if forever:
            self._pending.clear()
        self._open("forever" if forever else "while", token)

    def _condition(self, token: Token) -> Expression:
        self._at += 1
        condition = self._expression(0)
        self._expect(":")
        self._pending.append(Step(Evaluate(condition, self._spot(token))))
        return condition

    def _elif(self, token: Token) -> None:
        block = self._blocks[-1]
        if block.kind != "if":
            raise self._malformed("`elif` belongs to no `if`", token)
        self._condition(token)
        block.ways.append(tuple(block.body))
        block.body.clear()
        # Its condition is worked out where those before are false: it may be, or not, before any of the ways.
        self._blocks[-2].body.append(Choice((tuple(self._pending), ())))
        self._pending.clear()

    def _else(self, token: Token) -> None:
        block = self._blocks[-1]
        self._at += 1
        if block.kind != "if" or self._tokens[self._at].text != ":":
            raise self._malformed("`else` belongs to no `if`, or has no colon", token)
        self._at += 1
        block.ways.append(tuple(block.body))
        block.body.clear()
        block.kind = "else"

    def _end(self, token: Token) -> None:
        self._at += 1
        self._close(token)

    def _return(self, token: Token) -> None:
        self._at += 1
        ends = self._tokens[self._at].kind in ("line", "note")
        value = None if ends else self._expression(0)
        self._add(Step(Return(value, self._spot(token))), Leave("routine"))

    def _leave(self, token: Token) -> None:
        self._at += 1
        self._add(Leave("program" if token.text == "halt" else "loop"))

    def _nothing(self, token: Token) -> None:
        self._at += 1

    def _thread_statement(self, token: Token) -> None:
        self._at += 1
        self._add(Step(Evaluate(self._expression(0), self._spot(token))))

    def _scoped(self, token: Token) -> None:
        self._at += 1
        name = self._tokens[self._at]
        if name.kind != "name" or name.text in KEYWORDS:
            raise _Garbled("is no statement of URScript")
        if token.text == "local":
            self._routine.local.add(name.text)
        else:
            self._file.declared.setdefault(name.text, name.place)
        to = self._expression(0)
        if self._tokens[self._at].text == "=":
            self._assign(to, token.text, token)
        elif not isinstance(to, Name):
            raise _Garbled("is no statement of URScript")

    def _expression_statement(self, token: Token) -> None:
        value = self._expression(0)
        if self._tokens[self._at].text == "=":
            self._assign(value, "", token)
        elif isinstance(value, FunctionCall | Method | Run):
            self._add(Step(Evaluate(value, self._spot(token))))
        else:
            raise _Garbled("is no statement of URScript")

    def _assign(self, to: Expression, scope: str, token: Token) -> None:
        self._at += 1
        if not isinstance(to, Name | Element):
            raise _Garbled("gives a value to what can have none")
        value = self._expression(0)
        if isinstance(to, Name):
            if to.name in KEYWORDS:
                raise _Garbled("gives a value to a word of the language")
            if isinstance(value, Literal):
                self._file.titles[value.place] = to.name
        root = _root(to)
        if root is not None and not scope:
            self._routine.assigned.setdefault(root.name, token.place)
        self._add(Step(Assign(to, value, scope, self._spot(token))))

    # Expressions

    def _take(self, kind: str) -> Token:
        token = self._tokens[self._at]
        if token.kind != kind:
            raise _Garbled(f"{token.text.strip() or 'its end'} is not understood there")
        self._at += 1
        return token

    def _expect(self, sign: str) -> None:
        token = self._tokens[self._at]
        if token.text != sign:
            raise _Garbled(f"{sign} is missing")
        self._at += 1

    def _expression(self, depth: int) -> Expression:
        if depth > DEEPEST:
            raise _Garbled("is nested too deep")
        first = self._tokens[self._at]
        operands, operators = [self._operand(depth)], []
        while (token := self._tokens[self._at]).text in _OPERATORS:
            self._at += 1
            operators.append(token.text)
            operands.append(self._sometimes(depth) if token.text in ("and", "or") else self._operand(depth))
        return Operation(tuple(operators), tuple(operands), self._spot(first)) if operators else operands[0]

    def _sometimes(self, depth: int) -> Expression:
        """An operand that is worked out only where that before it does not decide."""
        before, self._pending = self._pending, []
        operand = self._operand(depth)
        self._pending = [*before, Choice((tuple(self._pending), ()))] if self._pending else before
        return operand

    def _operand(self, depth: int) -> Expression:
        first, signs = self._tokens[self._at], []
        while (token := self._tokens[self._at]).text in ("-", "+", "not"):
            signs.append(token.text)
            self._at += 1
        value = self._whole(depth)
        if signs == ["-"] and isinstance(value, Constant):
            return Constant(-value.value)
        return Operation(tuple(signs), (value,), self._spot(first)) if signs else value

    def _whole(self, depth: int) -> Expression:
        """A value with what is taken of it."""
        value = self._simple(depth)
        for _ in range(DEEPEST):
            token = self._tokens[self._at]
            if token.kind == "list" and token.text[0] == "[":  # an index that is a plain number
                self._at += 1
                number = token.text[1:-1].strip()
                index = Constant(float(number)) if "," not in number else Text(number)
                value = Element(value, index, self._spot(token))
            elif token.text == "[" and token.kind == "sign":
                self._at += 1
                items = self._items("]", depth)
                value = Element(value, items[0][1] if len(items) == 1 else Text(""), self._spot(token))
            elif token.text == ".":
                self._at += 1
                self._take("name")
                if self._tokens[self._at].text == "(":
                    self._at += 1
                    value = Method(value, self._items(")", depth), self._spot(token))
                else:
                    value = Element(value, None, self._spot(token))
            else:
                return value
        raise _Garbled("is nested too deep")

    def _simple(self, depth: int) -> Expression:
        token = self._tokens[self._at]
        self._at += 1
        if token.kind == "list":
            return self._list(token)
        if token.kind == "move":
            return self._plain_move(token)
        if token.kind == "name":
            if token.text == "run":
                return self._run(depth)
            name = self._variable(token.text)
            return self._call(token, depth) if self._tokens[self._at].text == "(" else name
        if token.kind == "number":
            return Constant(_number(token.text))
        if token.kind == "text":
            return Text(token.text)
        if token.kind == "pose":
            return self._listing(token, depth)
        if token.text == "[":
            return self._listing(token, depth)
        if token.text == "(":
            value = self._expression(depth + 1)
            self._expect(")")
            return value
        raise _Garbled(f"{token.text.strip() or 'its end'} is not understood there")

    def _list(self, token: Token) -> Expression:
        if token.text[0] == "p" and "," not in token.text:  # an element of a variable p
            number = token.text[token.text.index("[") + 1 : -1].strip()
            return Element(self._name("p"), Constant(float(number)), self._spot(token))
        return self._literal(token)

    def _literal(self, token: Token) -> Literal:
        return Literal(self._code.file, token.place, token.place + len(token.text), token.text[0] == "p")

    def _listing(self, token: Token, depth: int) -> Expression:
        start = self._at
        items = tuple(value for keyword, value in self._items("]", depth))
        if token.kind == "pose" and len(items) == 1:
            return Element(self._name("p"), items[0], self._spot(token))
        end = self._tokens[self._at - 1].place + 1
        if items and self._plain(start):
            return Literal(self._code.file, token.place, end, token.kind == "pose")
        return Listing(token.kind == "pose", items, self._spot(token))

    def _plain(self, start: int) -> bool:
        """Whether the tokens up to here are plain numbers: a comment stands between them, so that they are no single token."""
        inside = self._code.plain[self._tokens[start].place : self._tokens[self._at - 1].place + 1]
        return re.fullmatch(_LIST, f"[{inside}") is not None

    def _plain_move(self, token: Token) -> Expression:
        """A move to a list of plain numbers, or to one in a frame that has a name."""
        text, at = token.text, self._spot(token)
        name = text[: text.index("(")]
        opening, closing = text.index("["), text.index("]") + 1
        pose = text[opening - 1] == "p"
        goal: Expression = Literal(self._code.file, token.place + opening - pose, token.place + closing, pose)
        before, behind = text[len(name) + 1 : opening - pose], text[closing:]
        if before:
            function, frame = before.rstrip(", \t").split("(")
            goal = self._calls(function, (("", self._variable(frame.strip(" \t"))), ("", goal)), at)
        return self._calls(name, (("", goal), *self._plain_arguments(behind)), at)

    def _plain_arguments(self, text: str) -> Arguments:
        """Names and numbers behind a goal; speeds and the like in plain numbers are of no account."""
        key = self._routine.key, text
        if key not in self._arguments:
            self._arguments[key] = tuple(
                (keyword or "", self._variable(name) if name else Constant(float(number)))
                for keyword, name, number in ARGUMENT.findall(text)
                if name or keyword not in ("a", "v", "t", "r")
            )
        return self._arguments[key]

    def _call(self, name: Token, depth: int) -> Expression:
        self._at += 1
        return self._calls(name.text, self._items(")", depth), self._spot(name))

    def _calls(self, name: str, arguments: Arguments, at: Spot) -> Expression:
        routines = self._routines.get(name, ())
        self._routine.calls.update(routines)
        call = FunctionCall(name, arguments, at, routines)
        if len(routines) > 1 or (routines and name in RULES):
            self._pending.append(Step(NoStatement((), (), f"{name} is defined more than once", at)))
        elif routines:
            self._pending.append(Call(routines[0], call))
        elif name not in RULES:
            self._pending.append(Call(name, call))
        return call

    def _run(self, depth: int) -> Expression:
        name = self._take("name")
        self._expect("(")
        arguments = self._items(")", depth)
        routines = self._routines.get(name.text, ())
        self._routine.calls.update(routines)
        return Run(FunctionCall(name.text, arguments, self._spot(name), routines))

    def _items(self, closing: str, depth: int) -> Arguments:
        """What stands between brackets, with keywords where it has them."""
        items = []
        if self._tokens[self._at].text == closing:
            self._at += 1
            return ()
        while True:
            keyword, token = "", self._tokens[self._at]
            if token.kind == "name" and self._tokens[self._at + 1].text == "=":
                keyword = token.text
                self._at += 2
                token = self._tokens[self._at]
            alone = token.kind in ("name", "number", "list") and self._tokens[self._at + 1].text in (",", closing)
            items.append((keyword, self._simple(depth) if alone else self._expression(depth + 1)))
            token = self._tokens[self._at]
            self._at += 1
            if token.text == closing:
                return tuple(items)
            if token.text != ",":
                self._at -= 1
                raise _Garbled(f"{token.text.strip() or 'its end'} is not understood there")

    def _name(self, name: str) -> Name:
        return Name(self._routine, name)

    def _variable(self, name: str) -> Name:
        if name in KEYWORDS and name not in ("True", "False"):
            raise _Garbled(f"{name} is not understood there")
        return self._name(name)


_OPERATORS = frozenset({"+", "-", "*", "/", "%", "==", "!=", "<", ">", "<=", ">=", "and", "or", "xor"})

_STATEMENTS = {
    **dict.fromkeys(("def", "thread", "sec"), Parser._definition),
    "if": Parser._if,
    "while": Parser._while,
    "elif": Parser._elif,
    "else": Parser._else,
    "end": Parser._end,
    "return": Parser._return,
    **dict.fromkeys(("break", "continue", "halt"), Parser._leave),
    **dict.fromkeys(("pause", "enter_critical", "exit_critical"), Parser._nothing),
    **dict.fromkeys(("join", "kill"), Parser._thread_statement),
    **dict.fromkeys(("global", "local"), Parser._scoped),
}


def _number(text: str) -> float:
    """What a number says, with hexadecimal ones."""
    if text[1:2] not in ("x", "X"):
        return float(text)
    return float(int(text, 16)) if len(text) <= LONGEST_HEX else math.inf


def _root(target: Expression) -> Name | None:
    """The variable that an element or a member is of."""
    while isinstance(target, Element):
        target = target.of
    return target if isinstance(target, Name) else None
