"""What statements of KRL do to tools, bases, points and postures."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aridcal.programs.axes import DEGREE, MILLIMETRE, Axes
from aridcal.programs.cell import Cell
from aridcal.programs.frames import absent, unknown
from aridcal.programs.krl import table
from aridcal.programs.krl.grammar import Said
from aridcal.programs.krl.names import File, Names
from aridcal.programs.krl.syntax import (
    AXES,
    EXTERNAL,
    LARGEST,
    POSE,
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
    Word,
)
from aridcal.programs.notations import KUKA, inverse
from aridcal.programs.postures import krl_words
from aridcal.programs.targets import Branch, Place, Target
from aridcal.programs.text import Code, Number
from aridcal.programs.uses import HERE, Frame, Ledger, Use, line_name, product
from aridcal.programs.walk import NEVER_SET, State, Unknown

Element = tuple[str, tuple[float, ...] | None]

OUTSIDE = "the tool stands outside ($IPO_MODE is #TCP)"

WORKED = Unknown("it is worked out by the program")

NO_MODE = Unknown("$IPO_MODE is not certain")

BEGINNING = "no axes are stated before, so that it is not known how the arm stands"

STEP = "is a step from the place before"

MOST_USES = 40
"""Ways in which one point is used that are compared with each other: people use two or three."""

LONGEST = 60
"""Letters of a target's name."""


@dataclass
class Points:
    """Aggregates of the text that moves go to.

    Attributes:
        files: Of the project.
        cell: The robot.
        spoilt: Why the numbers at a place must stay.
        ledger: Where moves are written down.
    """

    files: tuple[File, ...]
    cell: Cell
    spoilt: dict[tuple[int, int], str]
    ledger: Ledger

    def __post_init__(self) -> None:
        self._jumps: set[tuple[int, int]] = set()
        self._declared: set[tuple[int, int]] = set()
        self._uses: dict[tuple[int, int], list[Use]] = {}

    @cached_property
    def _columns(self) -> dict[str, int]:
        """The reading of each axis that the robot has."""
        axes = self.cell.axes
        arm = dict(zip(AXES, axes.arm, strict=False))
        return arm | dict(zip(EXTERNAL, axes.external, strict=False))

    @cached_property
    def _axes(self) -> Axes:
        return self.cell.axes

    @cached_property
    def _free(self) -> np.ndarray:
        """Readings of which none is held."""
        return np.full(len(self._axes.kinds), np.nan)

    @cached_property
    def codes(self) -> tuple[Code, ...]:
        """The texts."""
        return tuple(file.code for file in self.files)

    def line(self, file: int, place: int) -> str:
        """How messages name a line."""
        return line_name(self.codes, self.codes[file], place)

    def declare(self, name: str, value: Aggregate) -> None:
        """A point stands in the text."""
        assert value.place is not None
        if value.place in self._declared:
            return
        self._declared.add(value.place)
        self.ledger.declare(value.place, lambda use, beside: self._target(name, value, use, beside))
        if value.place in self.spoilt:
            self.ledger.spoil(value.place, self.spoilt[value.place])

    def go(self, name: str, value: Aggregate, use: Use, stated: bool) -> None:
        """A move goes to a point; of ``stated`` ones its S and T say the posture."""
        assert value.place is not None
        self.declare(name, value)
        if stated:
            self._jumps.add(value.place)
        uses = self._uses.setdefault(value.place, [])
        if len(uses) == MOST_USES:
            self.ledger.spoil(value.place, f"is used in more than {MOST_USES} ways, which are not compared")
        elif not any(
            use.same(other) and use.trouble == other.trouble and use.unknown == other.unknown for other in uses
        ):
            uses.append(use)
            self.ledger.go(value.place, use)

    def vague(self, goal: Goal, file: int, why: str) -> None:
        """A move goes to a place that no plain numbers say."""
        code = self.codes[file]
        shown = _shown(code.text[goal.start : goal.end])
        self.ledger.leave(Target(code.line(goal.start), shown, "pose", (), why, file=file))

    def _target(self, name: str, value: Aggregate, use: Use, beside: tuple[Place, ...]) -> Target:
        assert value.place is not None
        file, start = value.place
        line = self.codes[file].line(start)
        why = value.why
        if not why and not self.files[file].ours:
            why = f"stands in {self.files[file].code.name}, which is not corrected: give it, too"
        axes, own = self._axes, self._columns
        stated = {k: v for k, v in value.fields.items() if isinstance(v, Number)}
        if value.jointed:
            columns = [axis for axis in own if axis in stated]
            numbers = tuple(stated[axis] for axis in columns)
            units = axes.units([own[axis] for axis in columns], DEGREE, MILLIMETRE)
            readings = axes.readings(numbers, units)
            why = why or ("" if numbers else "states no axis that this robot has")
            return Target(line, name, "joints", numbers, why, readings, units, digits=5, file=file)
        numbers = tuple(stated[part] for part in POSE if part in stated)
        held = self._free.copy() if axes.external else self._free
        for axis, column in zip(EXTERNAL, axes.external, strict=False):
            if axis in stated:
                held[column] = axes.unit(column, DEGREE, MILLIMETRE) * stated[axis].value
        words = None if why else krl_words(stated.get("s"), stated.get("t"), self.cell)
        if use.mode == "shifted":  # S and T of what is shifted are not those of the place
            words = None
        branch = Branch(words, None, held, nearest=words is None or value.place not in self._jumps, unknown=use.unknown)
        return Target(
            line,
            name,
            "pose",
            numbers,
            why,
            notation=KUKA,
            place=use.place,
            beside=beside,
            branch=branch,
            file=file,
        )


def _shown(text: str) -> str:
    """A target as it stands in the text, in one line."""
    shown = " ".join(text.split())
    return shown if len(shown) <= LONGEST else shown[: LONGEST - 1] + "…"


class Meaning:
    """What statements do, for the walk.

    Args:
        said: By the project's files.
        names: Of the project.
        points: Where moves are written down.
        constants: Values of variables that nothing writes.
        begin: Values of others when the program begins.
    """

    def __init__(
        self,
        said: Said,
        names: Names,
        points: Points,
        constants: Mapping[Element, object],
        begin: Mapping[Element, object],
    ) -> None:
        self._said, self._names, self._points = said, names, points
        self._constants, self._begin = constants, begin
        self._stated = points.cell.frames
        written = {mention.variable.key for mention in said.writes}
        self.arrays = sorted(
            {m.variable.key for m in said.writes if m.variable.index is not None and m.variable.shared}
            | {key for key, index in begin if index and ":" not in key}
        )
        self._shifted = sorted(table.CORRECTIONS & written)
        self._ignoring = any("#ignore" in code.plain for code in points.codes)
        self._oddities = sorted(said.odd | {key for key in written if _odd(key, points.cell)})
        self.foot = foot(said)

    # the beginning

    def start(self) -> State:
        """The state in which a program begins."""
        state = State()
        frames = self._stated
        for family, stated in (("$base", frames.bases), ("$tool", frames.tools)):
            if "default" in stated:
                stated_frame = Frame(stated["default"])
                state.set("frame", family, product(self.foot, stated_frame) if family == "$base" else stated_frame)
            else:
                state.forget(
                    "frame", family, f"{family.upper()} is not set before: state it, or call BAS, or give the caller"
                )
        state.set("mode", "ipo", "#base")
        state.set("mode", "ori", "")
        for name in self._oddities:
            state.set("odd", name, "")
        if self._points.cell.start:
            state.set("stance", None, True)
        else:
            state.forget("stance", None, BEGINNING)
        for element, value in self._begin.items():
            self._put(element, ":" not in element[0], value, state)
        return state

    def at_any_time(self, why: str) -> State:
        """The state in which an interrupt begins."""
        state = self.start()
        for family in ("frame", "mode", "stance", "odd"):
            state.forget_family(family, why)
        return state

    # statements

    def step(self, what: object, state: State) -> None:
        """Carry out a statement."""
        if isinstance(what, Move):
            self._move(what, state)
        elif isinstance(what, Assignment):
            self._assign(what, state)
        elif isinstance(what, Carried):
            self._carry(what, state)
        elif isinstance(what, Unclear):
            state.forget_all(what.why)

    def enter(self, what: object, name: str, state: State) -> None:
        """Hand over what a routine gets by value."""
        parameters = self._said.parameters.get(name, [])
        given = what.arguments if isinstance(what, Function) else ()
        for k, (parameter, by_value) in enumerate(parameters):
            value = self.value(given[k], state) if k < len(given) and by_value else WORKED
            if isinstance(value, Unknown) or (isinstance(value, Aggregate) and value.point):
                value = Unknown(f"{parameter.shown} is handed over by the caller")
            self._put(parameter.element, False, value, state)

    def leave(self, what: object, name: str, state: State) -> None:
        """Forget what a routine may have given back."""
        if isinstance(what, Function):
            self._given_back(what, state)
        if self._said.resumes is not None and what is not None:
            file, place = self._said.resumes
            state.forget_all(f"RESUME in {self._points.line(file.index, place)} may have broken off what was called")

    def absent(self, what: object, name: str, state: State) -> None:
        """A routine that is in no given file: it reaches all but variables of other modules."""
        assert isinstance(what, Function)
        self._given_back(what, state)
        if name in self._stated.harmless:
            return
        why = f"{name.upper()} is in several files" if name in self._names.twice else absent(name.upper())
        self._reached(why, state)

    def _reached(self, why: str, state: State) -> None:
        for family in ("frame", "mode", "stance", "shared"):
            state.forget_family(family, why)
        for array in self.arrays:
            state.forget_family(f"shared:{array}", why)

    def _given_back(self, call: Function, state: State) -> None:
        head = dict(enumerate(self._said.parameters.get(call.routine, [])))
        for k, argument in enumerate(call.arguments):
            if isinstance(argument, Variable) and not (k in head and head[k][1]):
                self._forget(argument, f"{argument.shown} was passed on", state)

    def _carry(self, what: Carried, state: State) -> None:
        """BAS, and routines by which a sensor moves the arm."""
        name, arguments = what.call.name, what.call.arguments
        if name in table.ODD:
            state.forget("odd", name, f"{what.line}: {table.ODD[name]}")
            return
        command = arguments[0].name if arguments and isinstance(arguments[0], Word) else ""
        number = arguments[1] if len(arguments) > 1 else None
        if command in table.BAS_HARMLESS:
            return
        if command == "#initmov":
            state.set("frame", "$base", HERE)
            state.forget(
                "frame",
                "$tool",
                "$TOOL after BAS(#INITMOV,0) is what bas.src of the controller says: set it in the program",
            )
            state.set("mode", "ipo", "#base")
        elif command in ("#base", "#tool") and number is not None:
            state.set("frame", f"${command[1:]}", self._numbered(command[1:], self.value(number, state), state))
        elif command in table.BAS_FRAMES:
            self._form(state)
        else:
            for family in ("frame", "mode"):
                state.forget_family(family, f"{what.line} calls BAS with a command that is not known")

    def _form(self, state: State) -> None:
        """What BAS does with FDAT_ACT."""
        form = self._get(("fdat_act", None), True, state)
        part = self._parts(form, "FDAT_ACT")
        state.set("frame", "$tool", self._numbered("tool", part("tool_no"), state))
        state.set("frame", "$base", self._numbered("base", part("base_no"), state))
        mode = part("ipo_frame")
        state.set("mode", "ipo", mode.name if isinstance(mode, Word) else mode)

    def _parts(self, value: object, shown: str) -> _Parts:
        return _Parts(value, shown)

    def _assign(self, assignment: Assignment, state: State) -> None:
        to = assignment.to
        if to.key in ("$base", "$tool"):
            state.set("frame", to.key, self._new_frame(assignment, state))
        elif to.key == "$ipo_mode":
            state.set("mode", "ipo", self._mode(assignment.value, state))
        elif to.key == "$ori_type":
            state.set("mode", "ori", self._mode(assignment.value, state))
        elif to.key.startswith("$"):
            if _odd(to.key, self._points.cell):
                state.forget("odd", to.key, f"{to.shown} is set, and this reader does not know what it does")
        elif to.path or to.worked_out:
            self._write_part(assignment, state)
        else:
            self._put(to.element, to.shared, self._stored(assignment.value, state), state)

    def _stored(self, expression: Expression, state: State) -> object:
        """The value that a variable gets."""
        if isinstance(expression, Product):
            return self.frame(expression, state)
        value = self.value(expression, state)
        if isinstance(value, Aggregate) and value.point and not isinstance(expression, Aggregate):
            return replace(value, place=None)  # a copy: its numbers stand elsewhere
        return value

    def _write_part(self, assignment: Assignment, state: State) -> None:
        to = assignment.to
        before = WORKED if to.worked_out else self._get(to.element, to.shared, state)
        value = self.value(assignment.value, state)
        if isinstance(before, Aggregate) and len(to.path) == 1 and isinstance(value, Number | Word):
            self._put(
                to.element, to.shared, replace(before, place=None, fields={**before.fields, to.path[0]: value}), state
            )
        else:
            self._forget(to, f"a part of {to.key.upper().split(':')[-1]} is worked out", state)

    def _new_frame(self, assignment: Assignment, state: State) -> object:
        to = assignment.to
        if not to.path and to.index is None and not to.worked_out:
            return self.frame(assignment.value, state)
        before = state.get("frame", to.key)
        value = self.value(assignment.value, state)
        part = to.path[0] if len(to.path) == 1 else ""
        if (
            isinstance(before, Frame)
            and isinstance(value, Number)
            and abs(value.value) <= LARGEST
            and part in ("x", "y", "z")
        ):
            T = before.T.copy()
            T["xyz".index(part), 3] = MILLIMETRE * value.value
            return Frame(T)
        return before if isinstance(before, Unknown) else Unknown(f"a part of {to.key.upper()} is worked out")

    def _mode(self, expression: Expression, state: State) -> object:
        value = self.value(expression, state)
        if isinstance(expression, Function) and expression.name in ("sipo_mode", "sori_typ") and expression.arguments:
            value = self.value(expression.arguments[0], state)
            if expression.name == "sori_typ":
                value = self._parts(value, "")("ori_typ")
        return value.name if isinstance(value, Word) else value if isinstance(value, Unknown) else NO_MODE

    # moves

    def _move(self, move: Move, state: State) -> None:
        if move.word in table.RELATIVE:
            if state.recording:
                self._points.ledger.leave(self._left(move, STEP))
            if move.word.removesuffix("_rel") in table.JOINTED:
                state.forget("stance", None, f"{self._line(move)} goes a step from where the arm was")
            return
        base, tool = state.get("frame", "$base"), state.get("frame", "$tool")
        ipo = state.get("mode", "ipo")
        ori = state.get("mode", "ori") if self._ignoring else ""
        odd: list[object] = [state.get("odd", name) for name in self._oddities]
        for setting in move.settings:
            key = setting.to.key
            if key == "$base":
                base = self._new_frame(setting, state)
            elif key == "$tool":
                tool = self._new_frame(setting, state)
            elif key == "$ipo_mode":
                ipo = self._mode(setting.value, state)
            elif key == "$ori_type" and self._ignoring:
                ori = self._mode(setting.value, state)
            elif _odd(key, self._points.cell):
                odd.append(Unknown(f"{key.upper()} is set, and this reader does not know what it does"))
        for order, goal in enumerate(move.targets):
            last = order == len(move.targets) - 1
            self._go(move, goal, last, _Conditions(base, tool, ipo, ori, odd), state)

    def _go(self, move: Move, goal: Goal, last: bool, conditions: _Conditions, state: State) -> None:
        if isinstance(goal.point, Variable) and goal.point.key in table.HELD and not (goal.before or goal.behind):
            return
        value = self.value(goal.point, state)
        if not isinstance(value, Aggregate) or value.place is None or not value.point:
            why = value.why if isinstance(value, Unknown) and value.why else f"{_shown_of(goal)} is worked out"
            if isinstance(value, Aggregate):
                why = f"{_shown_of(goal)} is a copy of numbers that stand elsewhere"
            self._points.vague(goal, move.file, why) if state.recording else None
            self._unread(move, state)
            return
        shown = (
            goal.point.shown
            if isinstance(goal.point, Variable)
            else _shown(self._points.codes[move.file].text[goal.start : goal.end])
        )
        use, stated = self._use(move, goal, value, conditions, state)
        if state.recording:
            self._points.go(shown, value, use, stated)
        if last:
            self._stance(move, value, use, stated, state)

    def _use(self, move: Move, goal: Goal, value: Aggregate, conditions: _Conditions, state: State) -> tuple[Use, bool]:
        """How the move comes to its point, and whether the point's S and T say how the arm stands there."""
        line = self._line(move)
        shift = bool(goal.before or goal.behind)
        if value.jointed:
            return Use(line, why="has frames beside axes" if shift else move.why or conditions.odd_why), False
        why = move.why or conditions.why
        base = self._as_frame(conditions.base, "$BASE")
        if shift or self.foot is not HERE:
            base = product(inverse_of(self.foot), base, *self._frames(goal.before, state))
        tool = self._as_frame(conditions.tool, "$TOOL")
        for frame in self._frames(goal.behind[::-1], state):
            tool = product(tool, inverse_of(frame))
        stated = value.states_posture and not goal.behind
        stance = state.get("stance")
        comes = stance.why if isinstance(stance, Unknown) and not stated else ""
        return Use(line, base, tool, shift, why, None, comes, "shifted" if goal.behind else ""), stated

    def _frames(self, factors: tuple[Expression, ...], state: State) -> list[object]:
        return [self.frame(factor, state) for factor in factors]

    def _stance(self, move: Move, value: Aggregate, use: Use, stated: bool, state: State) -> None:
        """Note whether it is known how the arm stands behind a move."""
        read = not value.why and not use.trouble and value.place not in self._points.spoilt
        if not read:
            self._unread(move, state)
        elif stated or (value.jointed and value.fields.keys() >= set(AXES[: len(self._points.cell.axes.arm)])):
            state.set("stance", None, True)

    def _unread(self, move: Move, state: State) -> None:
        if move.word in table.JOINTED:
            state.forget(
                "stance", None, f"{self._line(move)} goes to a place that is not known, and how the arm stands there"
            )

    def _left(self, move: Move, why: str) -> Target:
        code = self._points.codes[move.file]
        end = code.text.find("\n", move.start)
        shown = _shown(code.plain[move.start : end if end >= 0 else len(code.text)].upper())
        return Target(code.line(move.start), shown, "pose", (), why, file=move.file)

    def _line(self, move: Move) -> str:
        return self._points.line(move.file, move.start)

    # values

    def value(self, expression: Expression, state: State) -> object:
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
        return self._parts(value, expression.shown)(expression.path[0]) if len(expression.path) == 1 else WORKED

    def _variable(self, variable: Variable, state: State) -> object:
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

    def _function(self, call: Function, state: State) -> object:
        """Functions of inline forms."""
        if call.routine != call.name or not call.arguments:
            return Unknown(f"{call.name.upper()} works it out")
        first = call.arguments[0]
        if call.name in ("stool", "sbase", "k_offs"):
            kind = "tool" if call.name == "stool" else "base"
            return self._numbered(kind, self.value(first, state), state)
        if call.name == "stool2":
            return self._numbered("tool", self._parts(self.value(first, state), "STOOL2")("tool_no"), state)
        if call.name in ("ek", "eb", "lk"):
            return Unknown("$BASE moves with an external axis")
        return Unknown(f"{call.name.upper()} works it out")

    def frame(self, expression: Expression, state: State) -> Frame | Unknown:
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

    def _numbered(self, kind: str, number: object, state: State) -> Frame | Unknown:
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
            moving = self._parts(self._get(("machine_frame_dat", (n,)), True, state), "")("mach_def_index")
            if isinstance(moving, Number) and moving.value > 0.0:
                return Unknown(f"BASE_DATA[{n:g}] belongs to an external axis or another robot")
        name = f"{kind.upper()}_DATA[{n:g}]"
        value = self._get((f"{kind}_data", (n,)), True, state)
        if value is NEVER_SET:
            return Unknown(unknown(kind, f"{n:g}"))
        return self._as_frame(value, name)

    # variables in a state

    def _get(self, element: Element, shared: bool, state: State) -> object:
        if element in self._constants:
            return self._constants[element]
        return state.get(*_member(element, shared))

    def _put(self, element: Element, shared: bool, value: object, state: State) -> None:
        state.set(*_member(element, shared), value)

    def _forget(self, variable: Variable, why: str, state: State) -> None:
        if variable.key in ("$base", "$tool"):
            state.forget("frame", variable.key, why)
        elif variable.worked_out:
            state.forget_family(_member((variable.key, ()), variable.shared)[0], why)
        else:
            state.forget(*_member(variable.element, variable.shared), why)

    def written_by(self, what: Assignment | Function) -> list[tuple[str, Hashable]]:
        """Keys of the state that an assignment, or a routine of no given file, writes at any time."""
        state = State()
        if isinstance(what, Assignment):
            self._assign(what, state)
        else:
            self.absent(what, what.name, state)
        return state.own_keys()


@dataclass(frozen=True)
class _Conditions:
    """What holds where a move stands."""

    base: object
    tool: object
    ipo: object
    ori: object
    odd: list[object]

    @property
    def why(self) -> str:
        """Why no pose of the move is certain; empty if it is."""
        for value in (self.ipo, self.ori):
            if isinstance(value, Unknown):
                return value.why
        if self.ipo == "#tcp":
            return OUTSIDE
        return "$ORI_TYPE is #IGNORE: its orientation is not come to" if self.ori == "#ignore" else self.odd_why

    @property
    def odd_why(self) -> str:
        """Why no target at all is certain; empty if it is."""
        return next((value.why for value in self.odd if isinstance(value, Unknown)), "")


@dataclass(frozen=True)
class _Parts:
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


def foot(said: Said) -> Frame | Unknown:
    """Where the foot of the robot is in the world of the controller, by $ROBROOT of its machine data."""
    given = [value for _, variable, value in said.values if variable.key == "$robroot"]
    if not given:
        return HERE
    value = given[0]
    if len(given) > 1 or not isinstance(value, Aggregate) or value.frame is None:
        return Unknown("$ROBROOT is given twice, or is no frame of six plain numbers")
    return value.frame


def _shown_of(goal: Goal) -> str:
    return goal.point.shown if isinstance(goal.point, Variable) else "the place"


def _member(element: Element, shared: bool) -> tuple[str, Hashable]:
    """Family and member of the state for an element of a variable."""
    key, index = element
    scope = "shared" if shared else "own"
    return (scope, key) if index is None else (f"{scope}:{key}", index)


def _odd(key: str, cell: Cell) -> bool:
    """Whether a variable of the controller may change what targets mean."""
    if not key.startswith("$") or key in ("$base", "$tool", "$ipo_mode"):
        return False
    return key not in table.SYSTEM_VARIABLES and not (key in table.OUTSIDE and not cell.axes.external)
