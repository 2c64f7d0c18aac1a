"""Formulas of readings and conditions as graphs, which printers write in any language and which differentiate themselves.

A formula is a plain number as long as nothing in it varies, and a :class:`Term` otherwise: what is zero in all rows costs
nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from typing import Literal, NamedTuple

Operation = Literal[
    "reading", "condition", "+", "-", "*", "/", "sin", "cos", "sign", "power", "before", "curve", "pairs", "balls"
]

MOST_FACTORS = 4
"""A whole power up to that is written as a product, as those of bent rails are."""


class Table(NamedTuple):
    """Numbers of a sum of many alike terms, or of the pieces of a curve.

    Attributes:
        name: A C identifier.
        rows: Of equal length: of a curve the coefficients 1, u, u^2, u^3 of each piece; of pairs and balls the numbers of
            the basis and what it is multiplied with.
        start: Of a curve: where its first piece begins.
        step: Of a curve: the length of a piece.
    """

    name: str
    rows: tuple[tuple[float, ...], ...]
    start: float = 0.0
    step: float = 1.0


@dataclass(frozen=True, eq=False)
class Term:
    """A number that varies with the readings or the conditions.

    Attributes:
        operation: What is done with the arguments. ``before`` is -1 where the first is smaller than the second, else 0.
        of: The arguments.
        index: Of a reading or a condition its number; of a function with a table, which of its derivatives: 0 the
            function itself, k that by argument k.
        table: Of functions with one.
        name: What the number is, a C identifier; empty for what is part of a formula.
        comment: Its unit, or more.
    """

    operation: Operation
    of: tuple[Formula, ...] = ()
    index: int = 0
    table: Table | None = None
    name: str = field(default="", kw_only=True)
    comment: str = field(default="", kw_only=True)

    def __add__(self, other: Formula) -> Formula:
        return self if _is(other, 0.0) else Term("+", (self, other))

    def __radd__(self, other: float) -> Formula:
        return self if other == 0.0 else Term("+", (other, self))

    def __sub__(self, other: Formula) -> Formula:
        return self if _is(other, 0.0) else Term("-", (self, other))

    def __rsub__(self, other: float) -> Formula:
        return -self if other == 0.0 else Term("-", (other, self))

    def __neg__(self) -> Term:
        return Term("-", (self,))

    def __mul__(self, other: Formula) -> Formula:
        if not isinstance(other, Term):
            return self._times(other)
        return Term("*", (self, other))

    def __rmul__(self, other: float) -> Formula:
        return self._times(other)

    def _times(self, factor: float) -> Formula:
        if factor == 0.0:
            return 0.0
        if factor == 1.0:
            return self
        return -self if factor == -1.0 else Term("*", (factor, self))

    def __truediv__(self, other: float) -> Formula:
        return self if other == 1.0 else Term("/", (self, other))


Formula = Term | float


def _is(formula: Formula, number: float) -> bool:
    return not isinstance(formula, Term) and formula == number


def named(formula: Formula, name: str, comment: str = "") -> Formula:
    """A formula under a name of its own; a plain number stays one."""
    if not isinstance(formula, Term) or formula.operation in ("reading", "condition") or formula.name:
        return formula
    return Term(formula.operation, formula.of, formula.index, formula.table, name=name, comment=comment)


def sine(of: Formula) -> Formula:
    """The sine of what varies."""
    assert isinstance(of, Term)
    return Term("sin", (of,))


def cosine(of: Formula) -> Formula:
    """The cosine of what varies."""
    assert isinstance(of, Term)
    return Term("cos", (of,))


def power(of: Formula, exponent: float) -> Formula:
    """A power; a whole one that is small as a product."""
    assert isinstance(of, Term)
    if exponent == 0.0:
        return 1.0
    if exponent == int(exponent) and 1 <= exponent <= MOST_FACTORS:
        product: Formula = of
        for _ in range(int(exponent) - 1):
            product = product * of
        return product
    return Term("power", (of, exponent))


def dot(a: Sequence[Formula], b: Sequence[Formula]) -> Formula:
    """Scalar product."""
    return total(x * y for x, y in zip(a, b, strict=True))


def cross(a: Sequence[Formula], b: Sequence[Formula]) -> list[Formula]:
    """Vector product of two vectors of three numbers."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def total(parts: Iterable[Formula]) -> Formula:
    """A sum; 0 of nothing."""
    result: Formula = 0.0
    for part in parts:
        result = result + part
    return result


Gradient = Mapping[int, Formula]
"""Derivatives by readings, by their numbers; zero by all others."""


class Derivatives:
    """Derivatives of formulas by the readings, each worked out once.

    Args:
        held: Terms that count as if they did not change.
    """

    def __init__(self, held: Iterable[Formula] = ()) -> None:
        self._held = {id(term): term for term in held}
        self._of: dict[int, tuple[Term, Gradient]] = {}

    def of(self, formula: Formula) -> Gradient:
        """The derivatives of a formula."""
        if not isinstance(formula, Term):
            return {}
        for term in walk([formula], self._held):
            if id(term) not in self._of:
                self._of[id(term)] = term, self._gradient(term)
        return self._of[id(formula)][1]

    def _gradient(self, term: Term) -> Gradient:
        if id(term) in self._held:
            return {}
        if term.operation == "reading":
            return {term.index: 1.0}
        outer = [_by_argument(term, k) for k in range(len(term.of))]
        sums: dict[int, Formula] = {}
        for slope, argument in zip(outer, term.of, strict=True):
            if isinstance(argument, Term) and not _is(slope, 0.0):
                for column, inner in self._of[id(argument)][1].items():
                    sums[column] = sums.get(column, 0.0) + slope * inner
        return {column: value for column, value in sums.items() if not _is(value, 0.0)}


def _by_argument(term: Term, k: int) -> Formula:
    """The derivative of a term by its argument k, from 0; 0 where it is flat but for its jumps."""
    match term.operation:
        case "+":
            return 1.0
        case "-":
            return -1.0 if k == 1 or len(term.of) == 1 else 1.0
        case "*":
            return term.of[1 - k]
        case "/":
            divisor = term.of[1]
            assert not isinstance(divisor, Term)
            return 1.0 / divisor if k == 0 else 0.0
        case "sin":
            return Term("cos", term.of)
        case "cos":
            return -Term("sin", term.of)
        case "power":
            exponent = term.of[1]
            assert not isinstance(exponent, Term)
            return exponent * power(term.of[0], exponent - 1.0) if k == 0 else 0.0
        case "curve" | "pairs" | "balls":
            assert term.index == 0
            return Term(term.operation, term.of, k + 1, term.table)
        case _:
            return 0.0


def walk(formulas: Iterable[Formula], ends: Collection[int] = ()) -> Iterator[Term]:
    """All terms of some formulas, each object once, arguments before what is made of them.

    Args:
        formulas: The formulas.
        ends: Ids of terms whose arguments are left out.
    """
    done: set[int] = set()
    for formula in formulas:
        open_terms: list[tuple[Term, bool]] = [(formula, False)] if isinstance(formula, Term) else []
        while open_terms:
            term, ready = open_terms.pop()
            if id(term) in done:
                continue
            if ready:
                done.add(id(term))
                yield term
                continue
            open_terms.append((term, True))
            if id(term) not in ends:
                open_terms += [(each, False) for each in reversed(term.of) if isinstance(each, Term)]


class Statement(NamedTuple):
    """A line of a program: a name gets the value of a formula written out.

    Attributes:
        name: A C identifier.
        text: The formula.
        comment: Its unit, or more.
    """

    name: str
    text: str
    comment: str


Writer = Callable[[Term, Sequence[str]], str]
"""Writes a term, given its arguments as they are written, which stand for themselves beside any operator."""


def statements(
    formulas: Sequence[Formula], write: Writer, number: Callable[[float], str]
) -> tuple[list[Statement], list[str]]:
    """Formulas as lines of a program: what has a name, or is needed twice, gets a line of its own.

    Args:
        formulas: What is wanted.
        write: Writes one term.
        number: Writes a number.

    Returns:
        The lines, and what each formula is then.
    """
    alike: dict[object, Term] = {}
    same: dict[int, Term] = {}
    uses: dict[int, int] = {}
    for term in walk(formulas):  # equal terms become one
        of = tuple(id(same[id(each)]) if isinstance(each, Term) else each for each in term.of)
        first = alike.setdefault((term.operation, of, term.index, term.table and term.table.name), term)
        if first is term:
            for each in term.of:
                if isinstance(each, Term):
                    uses[id(same[id(each)])] = uses.get(id(same[id(each)]), 0) + 1
        same[id(term)] = first
    used: set[str] = set()
    label: dict[int, tuple[str, str]] = {}
    for term in walk(formulas):
        if term.name:
            label.setdefault(id(same[id(term)]), (term.name, term.comment))
    lines: list[Statement] = []
    written: dict[int, str] = {}

    def text(formula: Formula) -> str:
        return written[id(same[id(formula)])] if isinstance(formula, Term) else number(formula)

    for term in walk(formulas):
        if same[id(term)] is not term:
            continue
        content = written_out = write(term, [text(each) for each in term.of])
        leaf = term.operation in ("reading", "condition")
        if id(term) in label or (uses.get(id(term), 0) > 1 and not leaf):
            name, comment = label.get(id(term), ("part", ""))
            content = _unused(name, used)
            lines.append(Statement(content, bare(written_out), comment))
            used.add(content)
        written[id(term)] = content
    return lines, [bare(text(formula)) for formula in formulas]


def infix(term: Term, of: Sequence[str]) -> str:
    """A sum, difference, product or quotient in brackets, which C and Python write alike; inside of it none that say nothing."""
    if len(of) == 1:
        return f"(-{of[0]})"
    operation, (left, right) = term.operation, of
    inner = [each.operation if isinstance(each, Term) else None for each in term.of]
    negated = isinstance(term.of[1], Term) and len(term.of[1].of) == 1
    if operation in "+-" or inner[0] in ("*", "/"):
        left = bare(left)
    if operation in "+-" and inner[1] in ("*", "/"):
        right = bare(right)
    other = {"+": "-", "-": "+"}.get(operation, "")
    if other and inner[1] is None and right.startswith("-"):
        return f"({left} {other} {right[1:]})"
    if other and right.startswith("(-") and bare(right) != right and negated:
        return f"({left} {other} {right[2:-1]})"
    return f"({left} {operation} {right})"


def bare(text: str) -> str:
    """A formula without the brackets around all of it."""
    depth = 0
    for k, sign in enumerate(text):
        depth += {"(": 1, ")": -1}.get(sign, 0)
        if depth == 0:
            return text[1:-1] if k and k == len(text) - 1 and text[0] == "(" else text
    return text


def _unused(name: str, used: Collection[str]) -> str:
    """A name, with a number behind it if it is used already."""
    return next(each for each in chain([name], (f"{name}_{k}" for k in count(2))) if each not in used)
