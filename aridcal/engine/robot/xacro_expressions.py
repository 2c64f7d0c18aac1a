"""Expressions of xacro files: Python of which only what is listed here is evaluated.

xacro hands its expressions to Python, which reaches everything from anything: from a generator its frame, from a function its
code. So nothing is evaluated because nothing speaks against it. Syntax is checked before; every attribute is looked up by
:func:`attribute`, which knows by the value's type what it may be asked for; names are those of the file and of :data:`FUNCTIONS`.
"""

from __future__ import annotations

import ast
import builtins
import math
import re
import string
from collections.abc import Mapping, MutableMapping
from typing import Any

from aridcal.system.errors import shortened

SYNTAX: tuple[type[ast.AST], ...] = (
    ast.Expression, ast.Constant, ast.Name, ast.Attribute, ast.Subscript, ast.Slice, ast.Load, ast.Store,
    ast.Tuple, ast.List, ast.Dict, ast.Set, ast.Starred,
    ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.unaryop, ast.operator, ast.boolop, ast.cmpop,
    ast.Call, ast.keyword, ast.Lambda, ast.arguments, ast.arg,
    ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp, ast.comprehension,
    ast.JoinedStr, ast.FormattedValue,
)  # fmt: skip
"""Kinds of nodes that an expression may have."""

LITERALS = (str, int, float, complex, type(None))
"""Types of what may be written out (bool is an int)."""

FUNCTIONS: Mapping[str, Any] = {
    name: getattr(builtins, name)
    for name in (
        "abs", "all", "any", "bool", "complex", "dict", "divmod", "enumerate", "filter", "float", "frozenset", "hash", "int",
        "isinstance", "issubclass", "len", "list", "map", "max", "min", "ord", "range", "repr", "reversed", "round", "set",
        "slice", "sorted", "str", "sum", "tuple", "zip",
    )
}  # fmt: skip
"""Python's own that may be called. Not ``type`` and ``vars``, which xacro has too: they lead to classes and their tables."""

OF_XACRO = frozenset(
    {"abs_filename", "arg", "dotify", "error", "fatal", "load_yaml", "message", "print_location", "tokenize", "warning"}
)
"""xacro's own functions: YAML, arguments, messages."""

OF_MATH = frozenset(name for name in vars(math) if not name.startswith("_"))

NAMESPACES: Mapping[str, frozenset[str]] = {"python": frozenset(FUNCTIONS), "xacro": OF_XACRO, "math": OF_MATH}
"""By which name, and what of it."""

NAMES = frozenset({"True", "False", *FUNCTIONS, *OF_XACRO, *OF_MATH, *NAMESPACES})
"""What an expression may name beside what its file defines."""

OF_SETS = ("difference", "intersection", "isdisjoint", "issubset", "issuperset", "symmetric_difference", "union")

OF_TEXTS = """capitalize casefold center count endswith expandtabs find format index isalnum isalpha isascii isdecimal isdigit
    isidentifier islower isnumeric isspace istitle isupper join ljust lower lstrip partition removeprefix removesuffix replace
    rfind rindex rjust rpartition rsplit rstrip split splitlines startswith strip swapcase title upper zfill"""

METHODS: Mapping[type, frozenset[str]] = {
    str: frozenset(OF_TEXTS.split()),
    dict: frozenset({"copy", "get", "items", "keys", "pop", "setdefault", "update", "values"}),
    list: frozenset({"append", "copy", "count", "extend", "index", "insert", "pop", "remove", "reverse", "sort"}),
    tuple: frozenset({"count", "index"}),
    set: frozenset({"add", "copy", *OF_SETS}),
    frozenset: frozenset(OF_SETS),
}
"""Attributes that values may be asked for, by their type."""

LOOK_UP = "__attribute__"
"""The name under which :func:`attribute` is called: one that no expression may write."""


class _Formatter(string.Formatter):
    """Fills in a text's fields, but for those that ask for an attribute or an entry of a value."""

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> Any:
        """The value of a field by its number or name."""
        if not re.fullmatch(r"\w*", field_name):
            raise ValueError(
                f"a text's field {shortened(field_name)!r} asks for a part of a value, which is not evaluated"
            )
        return super().get_field(field_name, args, kwargs)


def evaluate(expression: str, symbols: dict[str, Any], local: Mapping[str, Any] | None = None) -> Any:
    """Evaluate an expression of a xacro file.

    Args:
        expression: As it is written.
        symbols: What the file defines, by name.
        local: Looked at before these.

    Raises:
        ValueError: it has what is not evaluated.
    """
    tree = _checked(expression)
    code = compile(ast.fix_missing_locations(_Attributes().visit(tree)), "<expression>", "eval")
    dict.__setitem__(
        symbols, "__builtins__", {**FUNCTIONS, LOOK_UP: attribute}
    )  # past what xacro does with a new symbol
    return eval(code, symbols, local)


def _checked(expression: str) -> ast.Expression:
    """An expression's tree, of listed syntax alone and without names that begin with two underscores."""
    tree = ast.parse(expression.strip(), mode="eval")
    for node in ast.walk(tree):
        good = isinstance(node, SYNTAX) and not (
            isinstance(node, ast.Constant) and not isinstance(node.value, LITERALS)
        )
        name = next((getattr(node, key) or "" for key in ("id", "attr", "arg") if hasattr(node, key)), "")
        if not good or name.startswith("__"):
            offender = repr(name) if good else f"{type(node).__name__} of Python"
            raise ValueError(f"the expression {shortened(expression)!r} uses {offender}, which is not evaluated")
    return tree


class _Attributes(ast.NodeTransformer):
    """Has every attribute looked up by a function."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        """``a.b`` becomes ``look_up(a, 'b')``."""
        value = self.visit(node.value)
        return ast.Call(ast.Name(LOOK_UP, ast.Load()), [value, ast.Constant(node.attr)], [])


def attribute(value: Any, name: str) -> Any:
    """Look an attribute up: a method that is listed, or an entry of YAML or of a namespace that may be written with a dot.

    Raises:
        ValueError: values of this type are not asked for it.
    """
    kind = value if isinstance(value, type) else type(value)
    methods = next((METHODS[base] for base in kind.__mro__ if base in METHODS), frozenset())
    if name == "format" and isinstance(value, str):
        return lambda *args, **named: _Formatter().vformat(value, args, named)
    if name in methods and name != "format":
        return getattr(value, name)
    if isinstance(value, dict) and (dotted := getattr(kind, "__getattr__", None)) is not None:
        return dotted(value, name)
    raise ValueError(f"the expression asks a value of type {kind.__name__} for {name!r}, which is not evaluated")


BUILTINS = {**FUNCTIONS, LOOK_UP: attribute}
"""In the place of Python's own."""


def forget_others(symbols: MutableMapping[str, Any]) -> None:
    """Take from the symbols that xacro hands to every file those that are not listed.

    Args:
        symbols: By name; namespaces among them are mappings themselves.
    """
    for name in [name for name in symbols if name not in NAMES]:
        del symbols[name]
    for space, names in NAMESPACES.items():
        inside = symbols.get(space, {})
        for name in [name for name in inside if name not in names]:
            dict.pop(inside, name)
