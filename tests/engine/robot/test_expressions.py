"""Expressions of xacro files: what descriptions need has Python's own value, and nothing else is evaluated."""

from __future__ import annotations

import math
from typing import Any

import pytest

from aridcal.engine.robot.xacro_expressions import FUNCTIONS, evaluate, forget_others

GIVEN: dict[str, Any] = {
    "a": 2, "name": "arm_", "sizes": [0.1, 0.2, 0.3], "inertia": {"mass": 3.0, "names": ["x", "y"]}, "_y": 1,
    "pi": math.pi, "radians": math.radians, "prop__x": {"x": 0.5},
}  # fmt: skip

GOOD = [
    "pi/2", "-pi", "2 * a ** 3 // 5 % 4", "prop__x['x'] + _y", "radians(180)", "'x' if a > 1 and not a == 3 else 'y'",
    "[v for v in range(3) if v]", "{k: v for k, v in inertia.items()}", "{v for v in sizes}", "sum(v * v for v in sizes)",
    "sizes[1:][0]", "max(*sizes)", "dict(a=1, **inertia)", "len('x' * 3)", "a in sizes or a is None", "(a, [a], {a: a})",
    "inertia.get('mass', 0)", "inertia['names'].index('y')", "list(inertia.keys())", "name + 'link'", "name.upper().strip('_')",
    "name.split('_')[0]", "'_'.join(['a', 'b'])", "'%s_%03d' % (name, a)", "'{}{:03d}'.format(name, a)",
    "'{0}{b}'.format(a, b=1)",
    "f'{name}{a:.2f}{a!r}'", "list(map(str.strip, ['a ', ' b']))", "(lambda x, y=a: x * y)(3)", "sorted(sizes, key=lambda v: -v)",
    "list(zip(sizes, 'abc'))", "str(a).zfill(3)", "'{:>{n}}'.format(a, n=5)", "[*sizes, a]", "round(pi, 2)",
]  # fmt: skip


@pytest.mark.parametrize("expression", GOOD)
def test_what_descriptions_say_has_the_value_that_python_gives_it(expression: str) -> None:
    assert evaluate(f"  {expression}\n", dict(GIVEN)) == eval(expression, dict(GIVEN))


ESCAPES = {
    "a class, in a comprehension": "[x.__class__ for x in [1]]",
    "a class in a text": "f'{a.__class__}'",
    "a class in a text's form": "f'{a:{a.__class__}}'",
    "behind a lambda": "(lambda x: x.__globals__)(len)",
    "a lambda's default": "(lambda x=().__class__: x)()",
    "a slice": "sizes[:().__class__]",
    "a key": "dict(k=().__class__)",
    "a condition": "[1 for x in sizes if x.__class__]",
    "a generator's frame": "(x for x in [1]).gi_frame",
    "a generator's frame, further": "(x for x in [1]).gi_frame.f_back.f_globals",
    "a generator's code": "(x for x in [1]).gi_code",
    "a generator's code, from a list": "[x for x in [(y for y in [1])]][0].gi_code.replace",
    "a coroutine's code": "(lambda: (x for x in []))().cr_code",
    "to wait": "await a",
    "to send": "(x for x in [1]).send",
    "to throw": "(x for x in [1]).throw(a)",
    "a function's parts": "(lambda: 0).func_code",
    "a function's module": "len.__self__",
    "the order of bases": "str.mro()",
    "subclasses": "().__class__.__base__.__subclasses__()",
    "a name with two underscores": "__import__('os')",
    "the table of functions": "__builtins__",
    "our own look-up": "__attribute__(a, 'real')",
    "our own look-up, hidden": "(lambda __attribute__: a.real)(print)",
    "our own look-up, as an element": "[a.real for __attribute__ in [1]]",
    "our own look-up, by a name given": "dict(__attribute__=1)",
    "a name made on the way": "(b := 3)",
    "a field's attribute": "'{0.__class__}'.format(a)",
    "a field's attribute, plain": "'{0.real}'.format(a)",
    "a field's attribute, by its name": "'{x.real}'.format(x=a)",
    "a field's entry": "'{0[0]}'.format(sizes)",
    "a field in a field": "'{:{0.real}}'.format(a)",
    "a text's method, of its class": "str.format('{0.real}', a)",
    "a text's other method": "name.format_map(inertia)",
    "a text as bytes": "name.encode()",
    "bytes": "b'x'",
    "a dots": "...",
    "a number's part": "a.real",
    "a number's method": "a.to_bytes(1, 'big')",
    "a class's method": "dict.fromkeys(sizes)",
    "an entry of a plain table": "inertia.mass",
    "a method's object": "name.upper.real",
}


@pytest.mark.parametrize("expression", ESCAPES.values(), ids=ESCAPES)
def test_expressions_that_reach_for_python_are_refused(expression: str) -> None:
    with pytest.raises(ValueError, match="which is not evaluated"):
        evaluate(expression, dict(GIVEN))


@pytest.mark.parametrize("name", ["type", "vars", "open", "exec", "eval", "compile", "getattr", "setattr", "globals", "object",
                                  "memoryview", "bytes", "input", "breakpoint", "help", "super", "classmethod"])  # fmt: skip
def test_functions_that_are_not_listed_have_no_name(name: str) -> None:
    for expression in (name, f"[{name} for x in [1]]", f"(lambda: {name})()"):
        with pytest.raises(NameError, match=name):
            evaluate(expression, dict(GIVEN))


@pytest.mark.parametrize(
    "statement", ["import os", "a = 1", "del a", "a; a", "def f(): pass", "print(", "lambda: (yield)"]
)
def test_what_is_no_expression_is_refused(statement: str) -> None:
    with pytest.raises((SyntaxError, ValueError)):
        evaluate(statement, dict(GIVEN))


def test_dots_reach_entries_of_what_allows_them_and_nothing_else_of_it() -> None:
    """As xacro's own tables of YAML do."""

    class Dotted(dict[str, Any]):
        secret = 3

        def __getattr__(self, name: str) -> Any:
            return self[name]

    symbols = {"arm": Dotted(mass=2.0, gi_frame=5, hand=Dotted(name="left"))}
    assert evaluate("arm.mass + arm.gi_frame", dict(symbols)) == 7.0
    assert evaluate("arm.hand.name.upper()", dict(symbols)) == "LEFT"
    with pytest.raises(KeyError, match="secret"):
        evaluate("arm.secret", dict(symbols))


def test_of_xacros_own_symbols_the_listed_ones_are_left() -> None:
    xacro = pytest.importorskip("xacro")
    symbols = xacro.create_global_symbols()
    forget_others(symbols)
    assert {"type", "vars"}.isdisjoint(symbols["python"]) and set(symbols["python"]) <= set(FUNCTIONS) | {
        "True",
        "False",
    }
    assert {"load_yaml", "arg", "warning"} <= set(symbols["xacro"]) and symbols["math"]["pi"] == symbols[
        "pi"
    ] == math.pi
