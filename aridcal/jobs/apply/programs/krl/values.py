"""Values of expressions in a state: frames, numbers, and structures."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

from aridcal.jobs.apply.programs.frames import unknown_frame
from aridcal.jobs.apply.programs.krl import table
from aridcal.jobs.apply.programs.krl.project_facts import ProjectFacts
from aridcal.jobs.apply.programs.krl.syntax import Aggregate, Expression, Function, Product, Variable, Word
from aridcal.jobs.apply.programs.notations import inverse
from aridcal.jobs.apply.programs.text import Number
from aridcal.jobs.apply.programs.uses import HERE, Frame, product
from aridcal.jobs.apply.programs.walk import NEVER_SET, ProgramState, Unknown

Element = tuple[str, tuple[float, ...] | None]

WORKED = Unknown("it is worked out by the program")


class Values:
    """What expressions are.

    Args:
        said: By the project's files.
        constants: Values of variables that nothing writes.
    """

    def __init__(self, facts: ProjectFacts, constants: Mapping[Element, object]) -> None:
        self._constants = constants
        self.foot = foot(facts)
        on = {v.key for _, v, value in facts.values if v.key.endswith("_on") and not _false(value)}
        assigned_keys = {mention.variable.key for mention in facts.writes.values()}
        self._shifted = sorted(table.CORRECTIONS & (assigned_keys | on))

    def value(self, expression: Expression, state: ProgramState) -> object:
        """What an expression is: an :class:`Aggregate`, a Frame, a Number, a Word, or Unknown."""
        if isinstance(expression, Aggregate | Number | Word):
            return expression
        if isinstance(expression, Product):
            return self.frame(expression, state)
        if isinstance(expression, Function):
            return self._function(expression, state)
        if not isinstance(expression, Variable):
            return WORKED
        if expression.worked_out:
            return Unknown(f"{expression.shown} is one of several, which the program works out")
        value = self._variable(expression, state)
        if not expression.path:
            return value
        return Parts(value, expression.shown)(expression.path[0]) if len(expression.path) == 1 else WORKED

    def _variable(self, variable: Variable, state: ProgramState) -> object:
        key = variable.key
        if key in table.FRAMES_OF_ALL:
            return HERE
        if key == "$robroot":
            return self.foot
        if key in ("$base", "$tool"):
            return state.get("frame", key)
        if key.startswith("$"):
            return Unknown(f"{variable.shown} is only known to the controller")
        value = self._get(variable.element, variable.shared, state)
        if value is NEVER_SET:
            return Unknown(f"{variable.shown} is in no given file")
        return value

    def _function(self, call: Function, state: ProgramState) -> object:
        """Functions of inline forms."""
        if call.routine != call.name or not call.arguments:
            return Unknown(f"{call.name.upper()} works it out")
        first = call.arguments[0]
        if call.name in ("stool", "sbase", "k_offs"):
            kind = "tool" if call.name == "stool" else "base"
            return self._numbered(kind, self.value(first, state), state)
        if call.name == "stool2":
            return self._numbered("tool", Parts(self.value(first, state), "STOOL2")("tool_no"), state)
        if call.name in ("ek", "eb", "lk"):
            return Unknown("$BASE moves with an external axis")
        return Unknown(f"{call.name.upper()} works it out")

    def frame(self, expression: Expression, state: ProgramState) -> Frame | Unknown:
        """The frame that an expression is."""
        if isinstance(expression, Product):
            return product(*(self.frame(factor, state) for factor in expression.factors))
        shown = expression.shown if isinstance(expression, Variable) else "a frame"
        return self._as_frame(self.value(expression, state), shown)

    def _as_frame(self, value: object, shown: str) -> Frame | Unknown:
        if isinstance(value, Frame | Unknown):
            return value
        if isinstance(value, Aggregate) and value.frame is not None:
            return value.frame
        return Unknown(f"{shown} is no frame of six plain numbers")

    def _numbered(self, kind: str, number: object, state: ProgramState) -> Frame | Unknown:
        """Tool or base of a number, as BAS and the functions of inline forms have it."""
        if not isinstance(number, Number):
            return Unknown(
                number.why if isinstance(number, Unknown) and number.why else f"the number of the {kind} is worked out"
            )
        n = number.value
        if self._shifted:
            return Unknown(f"{self._shifted[0].upper()} shifts numbered tools and bases")
        if n <= 0.0:
            return HERE
        if kind == "base":
            moving = Parts(self._get(("machine_frame_dat", (n,)), True, state), "")("mach_def_index")
            if isinstance(moving, Number) and moving.value > 0.0:
                return Unknown(f"BASE_DATA[{n:g}] belongs to an external axis or another robot")
        name = f"{kind.upper()}_DATA[{n:g}]"
        value = self._get((f"{kind}_data", (n,)), True, state)
        if value is NEVER_SET:
            return Unknown(unknown_frame(kind, f"{n:g}"))
        return self._as_frame(value, name)

    def _get(self, element: Element, shared: bool, state: ProgramState) -> object:
        if element in self._constants:
            return self._constants[element]
        return state.get(*member_of(element, shared))

    def _put(self, element: Element, shared: bool, value: object, state: ProgramState) -> None:
        state.set(*member_of(element, shared), value)

    def _forget(self, variable: Variable, why: str, state: ProgramState) -> None:
        if variable.key in ("$base", "$tool"):
            state.forget("frame", variable.key, why)
        elif variable.worked_out:
            state.forget_family(member_of((variable.key, ()), variable.shared)[0], why)
        else:
            state.forget(*member_of(variable.element, variable.shared), why)


@dataclass(frozen=True)
class Parts:
    """Parts of a structure.

    Attributes:
        value: The structure, or Unknown.
        shown: Its name.
    """

    value: object
    shown: str

    def __call__(self, name: str) -> object:
        """One of them."""
        if isinstance(self.value, Aggregate):
            part = self.value.fields.get(name, Unknown(f"{self.shown} has no {name.upper()}"))
            return part if isinstance(part, Number | Word | Unknown) else Unknown(f"{name.upper()} is worked out")
        if isinstance(self.value, Unknown):
            return Unknown(f"{self.shown} is not certain: {self.value.why}" if self.shown else self.value.why)
        return Unknown(f"{self.shown} is no structure")


def inverse_of(frame: object) -> object:
    """The inverse of a frame that may be unknown."""
    return Frame(inverse(frame.T)) if isinstance(frame, Frame) and frame is not HERE else frame


def foot(facts: ProjectFacts) -> Frame | Unknown:
    """Where the foot of the robot is in the world of the controller, by $ROBROOT of its machine data."""
    given = [value for _, variable, value in facts.values if variable.key == "$robroot"]
    if not given:
        return HERE
    value = given[0]
    if len(given) > 1 or not isinstance(value, Aggregate) or value.frame is None:
        return Unknown("$ROBROOT is given twice, or is no frame of six plain numbers")
    return value.frame


def member_of(element: Element, shared: bool) -> tuple[str, Hashable]:
    """Family and member of the state for an element of a variable."""
    key, index = element
    scope = "shared" if shared else "own"
    return (scope, key) if index is None else (f"{scope}:{key}", index)


def _false(value: Expression) -> bool:
    return isinstance(value, Variable) and value.key == "false"
