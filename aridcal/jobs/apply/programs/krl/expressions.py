"""Expressions of KRL, from the tokens of a line."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from aridcal.jobs.apply.programs.krl.syntax import (
    Aggregate,
    Bits,
    Computation,
    Expression,
    Function,
    Goal,
    Product,
    Text,
    Variable,
    Word,
)
from aridcal.jobs.apply.programs.krl.table import POINTS
from aridcal.jobs.apply.programs.krl.tokens import MalformedStatement, Token, fields
from aridcal.jobs.apply.programs.text import Number

DEEPEST = 40
"""Brackets in brackets of one statement."""

_OPERATORS = frozenset(
    ("+", "-", "*", "/", "==", "<>", "<", ">", "<=", ">=", "and", "or", "exor", "b_and", "b_or", "b_exor")
)

_BEFORE = frozenset(("not", "b_not", "+", "-"))


class Line:
    """The tokens of a statement, read from the left.

    Args:
        line: Its tokens.
        file: Index in the project.
        low: The file's text in small letters.
        text: As it stands.
        resolve: The key of a variable, and whether it is shared.
        routine: The key of a routine.
    """

    def __init__(
        self,
        line: Sequence[Token],
        file: int,
        low: str,
        text: str,
        resolve: Callable[[str], tuple[str, bool]],
        routine: Callable[[str], str],
    ) -> None:
        self._line, self._at = line, 0
        self._file, self._low, self._text = file, low, text
        self._resolve, self._routine = resolve, routine
        self._depth = 0
        self.calls: list[Function] = []

    @property
    def ended(self) -> bool:
        """Whether nothing is left."""
        return self._at >= len(self._line)

    def peek(self, ahead: int = 0) -> str:
        """The text of the next token; empty at the end."""
        at = self._at + ahead
        return self._line[at].text if at < len(self._line) else ""

    @property
    def kind(self) -> str:
        """The kind of the next token; empty at the end."""
        return self._line[self._at].kind if self._at < len(self._line) else ""

    def take(self, text: str = "") -> Token:
        """The next token.

        Args:
            text: What it must be.

        Raises:
            Misread: it is another one.
        """
        if self.ended or (text and self.peek() != text):
            raise MalformedStatement
        self._at += 1
        return self._line[self._at - 1]

    def takes(self, text: str) -> bool:
        """Take the next token if it is this one."""
        if self.peek() != text:
            return False
        self._at += 1
        return True

    def close(self) -> None:
        """Make sure that nothing is left.

        Raises:
            Misread: something is.
        """
        if not self.ended:
            raise MalformedStatement

    def rest(self) -> list[Token]:
        """All that is left, which is taken."""
        rest = list(self._line[self._at :])
        self._at = len(self._line)
        return rest

    def expression(self) -> Expression:
        """An expression."""
        operands = [self._operand()]
        geometric = plain = False
        while (sign := self.peek()) in _OPERATORS or sign == ":":
            geometric, plain = geometric or sign == ":", plain or sign != ":"
            self._at += 1
            operands.append(self._operand())
        if len(operands) == 1:
            return operands[0]
        return Computation(tuple(operands)) if plain else Product(tuple(operands))

    def _operand(self) -> Expression:
        self._depth += 1
        if self._depth > DEEPEST:
            raise MalformedStatement
        operand = self._read_operand()
        self._depth -= 1
        return operand

    def _read_operand(self) -> Expression:
        token = self.take()
        if token.text in _BEFORE:
            if token.text in "+-" and self.kind == "number" and self._line[self._at].start == token.end:
                return self._number(token.start, self.take())
            return Computation((self._operand(),))
        if token.kind == "name":
            return self._named(token)
        if token.kind == "plain":
            return Aggregate((self._file, token.start), token.end, fields(self._low, self._text, token))
        if token.kind == "number":
            return self._number(token.start, token)
        if token.kind == "word":
            return Word("#" + token.text[1:].strip())
        if token.kind == "text":
            return Text()
        if token.kind == "bits":
            return Bits(self._number(token.start, token))
        if token.text == "(":
            inner = self.expression()
            self.take(")")
            return inner
        if token.text == "{":
            return self._aggregate(token)
        raise MalformedStatement

    def _number(self, start: int, token: Token) -> Number:
        return Number(start, self._text[start : token.end])

    def _aggregate(self, bracket: Token) -> Aggregate:
        if self.peek(1) == ":":
            self.take()
            self.take()
        values: dict[str, Expression] = {}
        while self.peek() != "}":
            token = self.take()
            name = token.text
            if token.kind != "name" or name in values:
                raise MalformedStatement
            if self.takes("["):
                while not self.takes("]"):
                    self.take()
            values[name] = self.expression()
            if not self.takes(","):
                break
        end = self.take("}").end
        return Aggregate((self._file, bracket.start), end, values)

    def _named(self, token: Token) -> Expression:
        if self.peek() == "(":
            return self._function(token)
        return self.variable(token)

    def _function(self, token: Token) -> Function:
        self.take("(")
        arguments: list[Expression] = []
        while not self.takes(")"):
            if self.takes(","):  # an argument that is left out
                continue
            arguments.append(self.expression())
            if self.peek() != ")":
                self.take(",")
        function = Function(token.start, token.text, self._routine(token.text), tuple(arguments))
        self.calls.append(function)
        return function

    def variable(self, token: Token) -> Variable:
        """A variable that begins with a name."""
        index: tuple[float, ...] | None = None
        worked_out, path, inside = False, [], []
        end = token.end
        while self.peek() in ("[", ".") and self.peek():
            if self.takes("."):
                part = self.take()
                if part.kind != "name":
                    raise MalformedStatement
                path.append(part.text)
                end = part.end
                continue
            self.take("[")
            entries: list[Expression] = []
            while self.peek() != "]":
                if not self.takes(","):
                    entries.append(self.expression())
            end = self.take("]").end
            inside += entries
            if path or index is not None:
                path.append("[]")
            elif all(isinstance(entry, Number) for entry in entries):
                index = tuple(entry.value for entry in entries if isinstance(entry, Number)) or None
            else:
                index, worked_out = (), True
        key, shared = self._resolve(token.text)
        shown = sys.intern(self._text[token.start : end].upper())
        return Variable(token.start, shown, key, shared, index, worked_out, tuple(path), tuple(inside))

    def goal(self, types: Callable[[str], str]) -> Goal:
        """Where a move goes.

        Args:
            types: The type of a variable by its key; empty if it is not known.
        """
        start = self._line[self._at].start if not self.ended else 0
        whole = self.expression()
        end = self._line[self._at - 1].end
        if not isinstance(whole, Product):
            return Goal(start, end, whole)
        factors = whole.factors
        points = [k for k, f in enumerate(factors) if isinstance(f, Variable) and f.whole and types(f.key) in POINTS]
        at = points[0] if points else 0
        return Goal(start, end, factors[at], factors[:at], factors[at + 1 :])
