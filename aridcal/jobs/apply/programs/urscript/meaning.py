"""What statements of URScript do to tools, modes, points and the arm's posture."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal as Literal_

import numpy as np

from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.frames import absent, unknown_frame
from aridcal.jobs.apply.programs.notations import UR, inverse
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.targets import Branch, PoseReference, Target
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, NONE, NUMBER, Code, Number, Numbers, number
from aridcal.jobs.apply.programs.urscript.grammar import (
    Assign,
    Constant,
    Element,
    Evaluate,
    Expression,
    FunctionCall,
    Listing,
    Literal,
    Method,
    Name,
    NoStatement,
    Operation,
    Return,
    Routine,
    Run,
    Spot,
    Text,
)
from aridcal.jobs.apply.programs.urscript.scopes import LOCAL, SHARED, UNSURE, Scopes
from aridcal.jobs.apply.programs.urscript.table import MODE, RULES, SWITCHED, VIA, Move, Rule, Switch
from aridcal.jobs.apply.programs.uses import HERE, Frame, Ledger, Use, line_name, product
from aridcal.jobs.apply.programs.walk import NEVER_SET, ProgramState, Unknown, Walk
from aridcal.system.errors import AridcalError

DEFAULT = "default"
"""In a file of frames: the controller's base, and the tool of a program that sets none."""

POSE = 6
"""Numbers of a pose."""

TEXT = Unknown("is a text")

Form = Literal_["joints", "pose"]

Variable = tuple[str, Hashable]

THREADED = "it runs beside the program, in a thread"

UNTOLD = "no joint target before says how the arm stands when it comes: state it with --start J1,J2,..."


@dataclass(frozen=True)
class SolvedJoints:
    """How inverse kinematics made joints of a pose.

    Attributes:
        tool: That was meant.
        near: Joints that it starts from, shape (columns,); none: where the arm stands.
        rest: Between which moves it was worked out.
        why: Why nobody knows what it starts from.
    """

    tool: object
    near: tuple[float, ...] | None
    rest: object
    why: str


@dataclass(frozen=True, slots=True)
class Point:
    """A list of plain numbers as a value.

    Attributes:
        literal: The list.
        base: Product of the frames before it.
        frames: Points among these.
        solved: Of joints that were made of a pose.
    """

    literal: Literal
    base: object = HERE
    frames: tuple[Literal, ...] = ()
    solved: SolvedJoints | None = None


@dataclass(frozen=True)
class Vector:
    """A list of numbers that are worked out, and certain."""

    pose: bool
    values: tuple[float, ...]


@dataclass(frozen=True)
class Items:
    """A list of anything."""

    values: tuple[object, ...]


@dataclass(frozen=True)
class ComputedValue:
    """A value that only the controller works out, so that it is no point of the text; all are equal.

    Attributes:
        why: The reason, for the user.
    """

    why: str = field(compare=False)


class Meaning:
    """The semantics of URScript.

    Args:
        codes: The files.
        project: Of these.
        cell: That they move.
        routines: By their keys.
        scopes: Of their names.
        titles: What the program calls a literal, for each file.
    """

    def __init__(
        self,
        codes: tuple[Code, ...],
        project: Project,
        cell: Cell,
        routines: Mapping[str, Routine],
        scopes: Scopes,
        titles: Sequence[Mapping[int, str]],
    ) -> None:
        self._codes, self._project, self._cell = codes, project, cell
        self._routines, self._scopes, self._titles = routines, scopes, titles
        self._axes = cell.axes
        self._units = self._axes.units(self._axes.arm, 1.0, 1.0)
        self._ledger: Ledger[Literal] = Ledger()
        self._gone: dict[tuple[int, int], Literal] = {}
        self._spent: dict[tuple[int, int], str] = {}
        self._frames: dict[tuple[int, int], set[Literal]] = {}
        self._poses: dict[Literal, object] = {}
        self._products: dict[tuple[int, int], tuple[object, object, object]] = {}
        self._held: dict[Variable, set[tuple[int, int]]] = {}
        self._vague: dict[Variable, str] = {}
        self._at: Spot = (0, 0)
        self.walk: Walk | None = None
        self.poses = False

    def begin(self) -> ProgramState:
        """The state where a program begins."""
        state = ProgramState()
        tool = self._cell.frames.tools.get(DEFAULT)
        state.set("tool", None, Frame(tool) if tool is not None else Unknown(unknown_frame("the tool", DEFAULT)))
        state.set("stance", None, True if self._cell.start else Unknown(UNTOLD))
        state.set("rest", None, 0)
        for mode in SWITCHED:
            state.set("mode", mode, "")
        return state

    def targets(self) -> list[Target]:
        """All targets, when the walk is over."""
        for key, frames in self._frames.items():
            crossed = next((frame for frame in frames if frame.key in self._gone), None)
            if crossed is not None:
                self._ledger.spoil(key, f"its frame {self._title(crossed)} is a target itself")
        for variable, why in self._vague.items():
            for key in self._held.get(variable, ()):
                self._spent.setdefault(key, why)
        for key in self._gone:
            if key in self._spent:
                self._ledger.spoil(key, self._spent[key])
        return self._ledger.targets(self._target)

    # The walk's semantics

    def step(self, what: object, state: ProgramState) -> None:
        """Carry out a statement."""
        assert isinstance(what, Evaluate | Assign | Return | NoStatement)
        self._at = what.at
        if isinstance(what, Evaluate):
            value = self._value(what.value, state)
            if not isinstance(what.value, FunctionCall):
                self._spend(value, f"{self._line(what.at)} tests it")
        elif isinstance(what, Assign):
            self._assign(what, state)
        elif isinstance(what, Return):
            value = TEXT if what.value is None else self._value(what.value, state)
            self._set(("returned", None), value, state)
        else:
            line = self._line(what.at)
            for name in what.names:
                self._spend(self._value(name, state), f"{line} names it, and {what.why}")
            for literal in what.literals:
                self._spent.setdefault(literal.key, f"{line} {what.why}")
            state.forget_all(f"{line}: {what.why}")

    def enter(self, what: object, name: str, state: ProgramState) -> None:
        """Set the parameters of a routine."""
        routine = self._routines[name]
        self._at = what.at if isinstance(what, FunctionCall) else self._at
        arguments = self._bound(what, routine.parameters, state) if isinstance(what, FunctionCall) else {}
        for local in routine.local:
            value = arguments.get(local, Unknown(f"{local} is set by whoever calls {routine.name}"))
            self._set((LOCAL, (name, local)), value, state)
        self._set(("returned", None), Unknown(f"{routine.name} gives nothing back"), state)
        self._part(state)

    def leave(self, what: object, name: str, state: ProgramState) -> None:
        """Hand over what a routine gives back."""
        if isinstance(what, FunctionCall):
            self._at = what.at
            state.set("returned", what.at, self._get(("returned", None), state, what.name))
        self._part(state)

    def absent(self, what: object, name: str, state: ProgramState) -> None:
        """A function that stands nowhere."""
        if not isinstance(what, FunctionCall):  # a thread of which the head is garbled
            state.forget_all(absent(name))
            return
        self._at = what.at
        for _, argument in what.arguments:
            self._spend(self._value(argument, state), f"{self._line(what.at)} passes it on to {name}")
        if name.lower() not in self._cell.frames.harmless:
            state.forget_all(f"{self._line(what.at)}: {absent(name)}")

    def _part(self, state: ProgramState) -> None:
        """Names that several functions set are not certain where one goes over to another."""
        state.forget_family(UNSURE, "it may be local to the function around it")
        if self._scopes.shared:
            state.forget_family(SHARED, "several functions set it: declare it `global` before, or `local`")

    def _bound(self, call: FunctionCall, parameters: tuple[str, ...], state: ProgramState) -> dict[str, object]:
        """The values of a function's arguments, by the names of its parameters."""
        return {name: self._value(value, state) for name, value in _named(call, parameters).items()}

    def _line(self, at: Spot) -> str:
        return line_name(self._codes, self._codes[at[0]], at[1])

    # Points

    def _spend(self, value: object, why: str) -> None:
        """A value is used for something else than a move: its numbers must stay."""
        for key in _keys(value):
            self._spent.setdefault(key, why)

    def _set(self, variable: Variable, value: object, state: ProgramState) -> None:
        """Give a variable a value."""
        self._held.setdefault(variable, set()).update(_keys(value))
        state.set(*variable, ComputedValue(value.why) if isinstance(value, Unknown) else value)

    def _get(self, variable: Variable, state: ProgramState, name: str) -> object:
        """The value of a variable; where it is not certain, all points that it ever holds may be used here."""
        value = state.get(*variable)
        if isinstance(value, Unknown):
            self._vague.setdefault(variable, f"{self._line(self._at)} uses {name}, and {value.why}")
        return Unknown(value.why) if isinstance(value, ComputedValue) else value

    def _numbers(self, literal: Literal) -> tuple[Number, ...]:
        plain = self._codes[literal.file].plain
        return tuple(map(number, NUMBER.finditer(plain, literal.place, literal.end)))

    def _title(self, literal: Literal) -> str:
        text = self._codes[literal.file].text[literal.place : literal.end]
        return self._titles[literal.file].get(literal.place) or " ".join(text.split())

    def _pose(self, literal: Literal) -> object:
        """The frame that a literal is."""
        if literal not in self._poses:
            values = [n.value for n in self._numbers(literal)]
            self._poses[literal] = _frame_of(literal.pose, values)
        return self._poses[literal]

    def _frame(self, value: object, why: str) -> object:
        """A value as a frame."""
        self._spend(value, why)
        if isinstance(value, Point) and value.solved is None:
            return self._product(value.base, self._pose(value.literal))
        if isinstance(value, Vector):
            return _frame_of(value.pose, value.values)
        return value if isinstance(value, Frame | Unknown) else Unknown(f"{why}, and it is no pose")

    # Expressions

    def _value(self, expression: Expression, state: ProgramState) -> object:
        kind = type(expression)
        if kind is Literal:
            return Point(expression)  # type: ignore[arg-type]
        if kind is Constant:
            return expression.value  # type: ignore[union-attr]
        if isinstance(expression, Name):
            return self._variable(expression, state)
        if isinstance(expression, FunctionCall):
            return self._called(expression, state)
        if isinstance(expression, Listing):
            return self._listing(expression, state)
        if isinstance(expression, Operation):
            return self._operation(expression, state)
        if isinstance(expression, Element):
            return self._element(expression, state)
        if isinstance(expression, Method):
            return self._method(expression, state)
        if isinstance(expression, Run):
            return self._run(expression, state)
        return TEXT

    def _variable(self, name: Name, state: ProgramState) -> object:
        value = self._get(self._scopes.key(name.routine, name.name), state, name.name)
        return Unknown(f"{name.name} {value.why}") if value is NEVER_SET else value

    def _listing(self, listing: Listing, state: ProgramState) -> object:
        values = tuple(self._value(item, state) for item in listing.items)
        if all(isinstance(value, float) for value in values):
            return Vector(listing.pose, values)  # type: ignore[arg-type]
        if not listing.pose:
            return Items(values)
        why = f"{self._line(listing.at)} puts it into a pose"
        for value in values:
            self._spend(value, why)
        return next((value for value in values if isinstance(value, Unknown)), Unknown(f"{why}, which takes numbers"))

    def _operation(self, operation: Operation, state: ProgramState) -> object:
        values = [self._value(operand, state) for operand in operation.operands]
        why = f"{self._line(operation.at)} computes with it"
        for value in values:
            self._spend(value, why)
        numbers = [value for value in values if isinstance(value, float)]
        result = _computed(operation.operators, numbers) if len(numbers) == len(values) else None
        if result is not None:
            return result
        return Unknown(f"{self._line(operation.at)} works it out while the program runs")

    def _element(self, element: Element, state: ProgramState) -> object:
        value = self._value(element.of, state)
        index = None if element.which is None else self._value(element.which, state)
        line = self._line(element.at)
        self._spend(value, f"{line} takes a part of it")
        self._spend(index, f"{line} takes a part with it")
        values = self._components(value)
        if isinstance(index, float) and values is not None and index.is_integer() and 0 <= index < len(values):
            return values[int(index)]
        return Unknown(f"{line} takes it out of another value while the program runs")

    def _components(self, value: object) -> tuple[float, ...] | None:
        """The numbers of a list that is certain."""
        if isinstance(value, Vector):
            return value.values
        if isinstance(value, Point) and value.base is HERE and value.solved is None:
            return tuple(n.value for n in self._numbers(value.literal))
        return None

    def _method(self, method: Method, state: ProgramState) -> object:
        line = self._line(method.at)
        self._spend(self._value(method.of, state), f"{line} calls a method of it")
        for _, argument in method.arguments:
            self._spend(self._value(argument, state), f"{line} passes it on")
        self._changed(method.of, f"{line} may change it", state)
        return Unknown(f"{line} works it out while the program runs")

    def _run(self, run: Run, state: ProgramState) -> object:
        call, line = run.called, self._line(run.called.at)
        for _, argument in call.arguments:
            self._spend(self._value(argument, state), f"{line} passes it on to a thread")
        if not call.routines:
            self.absent(call, call.name, state)
        assert self.walk is not None
        for key in call.routines:
            keys = [k for k in self.walk.writes(key, state) if k[0] not in ("returned", LOCAL)]
            state.volatile(keys, f"{line} starts {call.name}, which may change it at any time")
        return TEXT

    # Statements

    def _assign(self, assign: Assign, state: ProgramState) -> None:
        value, line = self._value(assign.value, state), self._line(assign.at)
        if not isinstance(assign.to, Name):
            self._component(assign.to, value, line, state)
            return
        name = assign.to
        family, member = self._scopes.key(name.routine, name.name)
        if assign.scope == "global" and family == LOCAL:
            state.forget(family, member, f"{line} declares it to be global and local")
            return
        if family == UNSURE:
            state.forget_family(LOCAL, f"{line} may set a name of the function around it")
        self._set((family, member), value, state)

    def _component(self, to: Expression, value: object, line: str, state: ProgramState) -> None:
        """An element or a member is given a value."""
        self._spend(value, f"{line} puts it into another value")
        values = None
        if isinstance(to, Element) and isinstance(to.of, Name) and to.which is not None:
            old, index = self._value(to.of, state), self._value(to.which, state)
            self._spend(old, f"{line} writes a part of it")
            values = self._components(old)
            if (
                values is not None
                and isinstance(value, float)
                and isinstance(index, float)
                and index.is_integer()
                and 0 <= index < len(values)
            ):
                k = int(index)
                pose = old.literal.pose if isinstance(old, Point) else isinstance(old, Vector) and old.pose
                changed = Vector(pose, (*values[:k], value, *values[k + 1 :]))
                self._set(self._scopes.key(to.of.routine, to.of.name), changed, state)
                return
        self._changed(to, f"{line} writes a part of it", state)

    def _changed(self, expression: Expression, why: str, state: ProgramState) -> None:
        """The variable that an expression is a part of is not certain any more."""
        while isinstance(expression, Element):
            if expression.which is not None:
                self._spend(self._value(expression.which, state), why)
            expression = expression.of
        if isinstance(expression, Name):
            self._spend(self._value(expression, state), why)
            family, member = self._scopes.key(expression.routine, expression.name)
            if family == UNSURE:
                state.forget_family(LOCAL, why)
            state.forget(family, member, why)

    # Functions

    def _called(self, call: FunctionCall, state: ProgramState) -> object:
        if call.routines:
            returned = state.get("returned", call.at)
            return Unknown(returned.why) if isinstance(returned, ComputedValue) else returned
        rule = RULES.get(call.name)
        if rule is None:  # its arguments are spent by `absent`
            return Unknown(f"{call.name} is in no given file")
        if isinstance(rule, Move):
            return self._move(call, rule, state)
        evaluate = _EVALUATE.get(call.name)
        if evaluate is not None:
            return evaluate(self, call, state)
        line = self._line(call.at)
        for _, argument in call.arguments:
            value = self._value(argument, state)
            if rule is not Rule.LOOKS:
                self._spend(value, f"{line} passes it on to {call.name}")
        if isinstance(rule, Switch):
            self._switch(call, rule, state)
        elif rule is Rule.POSTURE:
            state.set("rest", None, call.at)
            state.forget("stance", None, f"{line}: {call.name} may leave the arm in another posture")
        elif rule is Rule.OPEN:
            state.forget_all(f"{line}: {call.name} carries out what comes from outside")
        return Unknown(f"{line}: {call.name}(...) is worked out while the program runs")

    def _switch(self, call: FunctionCall, switch: Switch, state: ProgramState) -> None:
        line = self._line(call.at)
        state.set(
            "mode",
            switch.mode,
            f"{switch.mode} is active: the arm does not just go to its targets" if switch.on else "",
        )
        state.set("rest", None, call.at)
        if switch.led:
            state.forget("stance", None, f"{line}: {call.name}: the arm is led by hand")

    def _set_tcp(self, call: FunctionCall, state: ProgramState) -> object:
        line = self._line(call.at)
        given = self._bound(call, ("pose", "tcp_name"), state)
        tool = self._frame(given.get("pose", Unknown(f"{line}: set_tcp has no pose")), f"{line} uses it as a tool")
        state.set("tool", None, Unknown(f"the tool of {line}: {tool.why}") if isinstance(tool, Unknown) else tool)
        return TEXT

    def _pose_trans(self, call: FunctionCall, state: ProgramState) -> object:
        line = self._line(call.at)
        given = self._bound(call, ("p_from", "p_from_to"), state)
        if given.keys() != {"p_from", "p_from_to"}:
            return self._waste(list(given.values()), line)
        first, second = given["p_from"], given["p_from_to"]
        base = self._frame(first, f"{line} uses it as a frame")
        if isinstance(second, Point) and second.solved is None and second.literal.pose:
            frames = (*first.frames, first.literal) if isinstance(first, Point) else ()
            return Point(second.literal, self._product(base, second.base), (*frames, *second.frames))
        return product(base, self._frame(second, f"{line} computes with it"))

    def _pose_inv(self, call: FunctionCall, state: ProgramState) -> object:
        line = self._line(call.at)
        values = list(self._bound(call, ("p_from",), state).values())
        if len(values) != 1:
            return self._waste(values, line)
        frame = self._frame(values[0], f"{line} uses it as a frame")
        return Frame(inverse(frame.T)) if isinstance(frame, Frame) else frame

    def _waste(self, values: Sequence[object], line: str) -> Unknown:
        for value in values:
            self._spend(value, f"{line} passes it on")
        return Unknown(f"{line} is not understood")

    def _angle(self, call: FunctionCall, state: ProgramState) -> object:
        line = self._line(call.at)
        values = [self._value(value, state) for _, value in call.arguments]
        if len(values) == 1 and isinstance(values[0], float):
            return math.radians(values[0]) if call.name == "d2r" else math.degrees(values[0])
        return self._waste(values, line)

    def _get_tcp_offset(self, call: FunctionCall, state: ProgramState) -> object:
        return state.get("tool")

    def _get_inverse_kin(self, call: FunctionCall, state: ProgramState) -> object:
        line = self._line(call.at)
        names = ("x", "qnear", "maxPositionError", "maxOrientationError", "tcp")
        given = self._bound(call, names, state)
        value, near, tool = given.pop("x", None), given.pop("qnear", None), state.get("tool")
        spoken = _named(call, names)
        for name, other in given.items():
            if isinstance(other, float):  # how exact it is to be
                continue
            own = self._frame(other, f"{line} uses it as a tool")
            if spoken.get(name) != Text('"active_tcp"'):
                tool = own
        readings, why = self._near(near, spoken.get("qnear"))
        if not isinstance(value, Point) or value.solved is not None or not value.literal.pose:
            if value is not None:
                self._spend(value, f"{line} passes it on to get_inverse_kin")
            return value if isinstance(value, Unknown) else Unknown(f"{line} works out joints while the program runs")
        if isinstance(state.get("rest"), Unknown):
            state.set("rest", None, call.at)
        return replace(value, solved=SolvedJoints(tool, readings, state.get("rest"), why))

    def _near(self, value: object, expression: Expression | None) -> tuple[tuple[float, ...] | None, str]:
        """Readings that inverse kinematics starts from, and why they are not known."""
        if value is None or (isinstance(expression, FunctionCall) and expression.name in _STANDING):
            return None, ""
        numbers: Sequence[float] | None = None
        if isinstance(value, Point) and value.solved is None and not value.literal.pose:
            numbers = [n.value for n in self._numbers(value.literal)]
        if isinstance(value, Vector) and not value.pose:
            numbers = value.values
        if numbers is None or len(numbers) != len(self._units) or not _plain(numbers):
            return None, f"qnear: {value.why}" if isinstance(value, Unknown) else "qnear states no joints"
        readings = [math.nan] * len(self._axes.kinds)
        for n, (unit, k) in zip(numbers, self._units, strict=True):
            readings[k] = unit * (n - self._axes.zero(k))
        return tuple(readings), ""

    # Moves

    def _move(self, call: FunctionCall, move: Move, state: ProgramState) -> object:
        line = self._line(call.at)
        given = self._bound(call, move.parameters, state)
        strange = next((name for name in given if name not in move.parameters), None)
        trouble = "" if strange is None else f"{line}: {call.name} is not known to take {strange or 'so much'}"
        for name, value in given.items():
            if name not in move.goals:
                self._spend(value, f"{line} passes it on to {call.name}")
        trouble = trouble or self._mode(given, state)
        for goal in move.goals:
            value = given.get(goal, Unknown(f"{line}: {call.name} has no goal"))
            why = trouble or self._only_position(goal, value)
            self._go(call, move, value, line, why, state)
        state.set("rest", None, call.at)
        return TEXT

    def _mode(self, arguments: Mapping[str, object], state: ProgramState) -> str:
        """Why the arm does not go just where a move says."""
        for mode in SWITCHED:
            active = state.get("mode", mode)
            if active:
                return active.why if isinstance(active, Unknown) else str(active)
        return (
            ""
            if arguments.get(MODE, 0.0) == 0.0
            else "the circle's mode does not go to the orientation that stands there"
        )

    def _only_position(self, goal: str, value: object) -> str:
        """Why the point on the way of a circle is left: where it states no orientation, nobody knows how the arm stands there."""
        if goal != VIA or not isinstance(value, Point) or value.solved is not None:
            return ""
        rotation = self._numbers(value.literal)[3:]
        return (
            "" if any(n.value != 0.0 for n in rotation) else "only its position is used, and it states no orientation"
        )

    def _go(self, call: FunctionCall, move: Move, value: object, line: str, why: str, state: ProgramState) -> None:
        stance = state.get("stance")
        coming = stance.why if isinstance(stance, Unknown) else ""
        if not isinstance(value, Point):
            if move.by_joints:
                state.forget("stance", None, f"{line} goes to a place that is not known")
            self._spend(value, f"{line} passes it on to {call.name}")
            self._leave(call, value)
            return
        pose = value.literal.pose
        if pose and move.joints_only and value.solved is None:
            why = why or f"{call.name} takes joints, and this is a pose"
        if not pose:
            use = Use(
                line, why=why or ("" if move.by_joints or not coming else f"it stands for its pose, and {coming}")
            )
        elif value.solved is None:
            use = Use(line, self._product(self.base, value.base), state.get("tool"), why=why, unknown=coming)
        else:
            use = self._solved(value, value.solved, line, why, coming, state)
        if move.by_joints and (not pose or use.near is not None):
            state.set("stance", None, True)
        if state.recording:
            key = value.literal.key
            self.poses = self.poses or pose
            self._gone[key] = value.literal
            if value.frames:
                self._frames.setdefault(key, set()).update(value.frames)
            self._ledger.declare(key, value.literal)
            self._ledger.go(key, use)

    def _solved(self, value: Point, joints: SolvedJoints, line: str, why: str, coming: str, state: ProgramState) -> Use:
        if joints.near is not None:
            coming = ""
        elif joints.why:
            coming = joints.why
        elif state.get("rest") != joints.rest:
            coming = f"{line} goes to joints that were worked out before, elsewhere"
        return Use(line, self._product(self.base, value.base), joints.tool, why=why, near=joints.near, unknown=coming)

    def _product(self, first: object, second: object) -> object:
        """The product of two frames; of the same ones it is the same object, so that a long program has few."""
        if first is HERE or second is HERE:
            return second if first is HERE else first
        key = id(first), id(second)
        if key not in self._products:
            self._products[key] = first, second, product(first, second)
        return self._products[key][-1]

    @cached_property
    def base(self) -> Frame:
        """Where the controller counts poses from."""
        robot, stated = self._cell.robot, self._cell.frames.bases.get(DEFAULT)
        T = self._cell.base if stated is None else stated
        if T is None:
            raise AridcalError(
                f"{self._project.sources[0].path}: its poses are counted from the controller's base, and {robot.path} has no "
                "link `base`, fixed to that of the campaign, which says where that is: state it with --frames, in a file with\n"
                "  format: 1\n  bases: {default: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}"
            )
        return Frame(T)

    def _leave(self, call: FunctionCall, value: object) -> None:
        """A goal that no plain numbers say."""
        file, place = call.at
        code = self._codes[file]
        end = code.closing(code.plain.find("(", place)) + 1
        name = " ".join(code.text[place : max(end, place + len(call.name))].split())
        why = value.why if isinstance(value, Unknown) else "is worked out while the program runs"
        self._ledger.leave(Target(code.line(place), name, "pose", NONE, why, file=file))

    def _target(self, literal: Literal, use: Use, beside: tuple[PoseReference, ...]) -> Target:
        code, numbers = self._codes[literal.file], self._numbers(literal)
        line, name = code.line(literal.place), self._title(literal)
        form: Form = "pose" if literal.pose else "joints"
        values = [n.value for n in numbers]
        count = POSE if literal.pose else len(self._units)
        source, why = self._project.sources[literal.file], ""
        if len(values) != count:
            why = f"has {len(values)} numbers, where there should be {count}"
        elif not _plain(values):
            why = "has a number that no robot has"
        elif not source.ours:
            why = f"stands in {source.path}, which is not corrected: give it, too"
        if why:
            return Target(line, name, form, NONE, why, file=literal.file)
        if not literal.pose:
            readings = self._axes.readings(numbers, self._units)
            return Target(line, name, form, Numbers(numbers), "", readings, self._units, file=literal.file)
        near = None if use.near is None else np.array(use.near)
        branch = Branch(near=near, nearest=True, unknown=use.unknown)
        return Target(
            line, name, form, Numbers(numbers), notation=UR, place=None if use.trouble else use.place, beside=beside,
            branch=branch, file=literal.file,
        )  # fmt: skip


_EVALUATE = {
    "set_tcp": Meaning._set_tcp,
    "pose_trans": Meaning._pose_trans,
    "pose_inv": Meaning._pose_inv,
    "get_inverse_kin": Meaning._get_inverse_kin,
    "get_tcp_offset": Meaning._get_tcp_offset,
    "d2r": Meaning._angle,
    "r2d": Meaning._angle,
}

_STANDING = ("get_actual_joint_positions", "get_target_joint_positions")
"""Where the arm stands: inverse kinematics starts there without being told."""


def _named(call: FunctionCall, parameters: tuple[str, ...]) -> dict[str, Expression]:
    """The arguments of a function by the names of its parameters; one too many has none."""
    return {
        keyword or (parameters[k] if k < len(parameters) else ""): value
        for k, (keyword, value) in enumerate(call.arguments)
    }


def _keys(value: object) -> Iterator[tuple[int, int]]:
    """Points in a value."""
    if isinstance(value, Point):
        yield value.literal.key
    elif isinstance(value, Items):
        for item in value.values:
            yield from _keys(item)


def _plain(values: Sequence[float]) -> bool:
    return all(abs(value) <= LARGEST_IN_PROGRAM for value in values)


def _frame_of(pose: bool, values: Sequence[float]) -> object:
    if not pose or len(values) != POSE or not _plain(values):
        return Unknown("is no pose of six plain numbers")
    return Frame(UR.pose(np.array(values)))


def _computed(operators: Sequence[str], values: Sequence[float]) -> float | None:
    """Sums of products and quotients; None for anything else."""
    if len(values) == 1:
        return -values[0] if operators == ("-",) else values[0] if operators == ("+",) else None
    total, factor, sign = 0.0, values[0], 1.0
    for operator, value in zip(operators, values[1:], strict=True):
        if operator == "*":
            factor *= value
        elif operator == "/" and value:
            factor /= value
        elif operator in ("+", "-"):
            total, factor, sign = total + sign * factor, value, 1.0 if operator == "+" else -1.0
        else:
            return None
    return total + sign * factor
