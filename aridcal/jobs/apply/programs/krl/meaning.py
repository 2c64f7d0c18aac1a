"""What statements of KRL do to tools, bases, points and postures."""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace

from aridcal.jobs.apply.programs.axes import MILLIMETRE
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.frames import absent
from aridcal.jobs.apply.programs.krl import table
from aridcal.jobs.apply.programs.krl.names import Names
from aridcal.jobs.apply.programs.krl.points import Points, shown_text
from aridcal.jobs.apply.programs.krl.project_facts import ProjectFacts
from aridcal.jobs.apply.programs.krl.syntax import (
    AXES,
    EXTERNAL,
    Aggregate,
    Assignment,
    ControllerCall,
    Expression,
    Function,
    Goal,
    Move,
    Product,
    UnclearStatement,
    Variable,
    Word,
)
from aridcal.jobs.apply.programs.krl.values import WORKED, Element, Parts, Values, inverse_of
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, NONE, Number
from aridcal.jobs.apply.programs.uses import HERE, Frame, Use, product
from aridcal.jobs.apply.programs.walk import ProgramState, Unknown

OUTSIDE = "the tool stands outside ($IPO_MODE is #TCP)"

NO_MODE = Unknown("$IPO_MODE is not certain")

BEGINNING = "no axes are stated before, so that it is not known how the arm stands"

STEP = "is a step from the place before"

_TOLD_OUTSIDE = re.compile(r"(?<![\w$])e[1-6][ \t]++[+-]?[0.]*+[1-9]")
"""A place of an external axis that is not zero."""


class Meaning(Values):
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
        facts: ProjectFacts,
        names: Names,
        points: Points,
        constants: Mapping[Element, object],
        begin: Mapping[Element, object],
    ) -> None:
        super().__init__(facts, constants)
        self._said, self._names, self._points = facts, names, points
        self._begin = begin
        self._stated = points.cell.frames
        assigned_keys = {mention.variable.key for mention in facts.writes.values()}
        self.arrays = sorted(
            {m.variable.key for m in facts.writes.values() if m.variable.index is not None and m.variable.shared}
            | {key for key, index in begin if index and ":" not in key}
        )
        self._ignoring = any("#ignore" in code.plain for code in points.codes)
        self._outside = EXTERNAL[len(points.cell.axes.external) :]
        self._moved_outside = any(_TOLD_OUTSIDE.search(code.plain) for code in points.codes)
        self._oddities = sorted(facts.odd | {key for key in assigned_keys if _odd(key, points.cell)})

    def start(self) -> ProgramState:
        """The state in which a program begins."""
        state = ProgramState()
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
        state.set("outside", None, "")
        for name in self._oddities:
            state.set("odd", name, "")
        if self._points.cell.start:
            state.set("stance", None, True)
        else:
            state.forget("stance", None, BEGINNING)
        for element, value in self._begin.items():
            self._put(element, ":" not in element[0], value, state)
        return state

    def at_any_time(self, why: str) -> ProgramState:
        """The state in which an interrupt begins."""
        state = self.start()
        for family in ("frame", "mode", "stance", "odd", "outside"):
            state.forget_family(family, why)
        return state

    def step(self, what: object, state: ProgramState) -> None:
        """Carry out a statement."""
        if isinstance(what, Move):
            self._move(what, state)
        elif isinstance(what, Assignment):
            self._assign(what, state)
        elif isinstance(what, ControllerCall):
            self._carry(what, state)
        elif isinstance(what, UnclearStatement):
            state.forget_all(what.why)

    def enter(self, what: object, name: str, state: ProgramState) -> None:
        """Hand over what a routine gets by value."""
        parameters = self._said.parameters.get(name, [])
        given = what.arguments if isinstance(what, Function) else ()
        for k, (parameter, by_value) in enumerate(parameters):
            value = self.value(given[k], state) if k < len(given) and by_value else WORKED
            if isinstance(value, Unknown) or (isinstance(value, Aggregate) and value.point):
                value = Unknown(f"{parameter.shown} is handed over by the caller")
            self._put(parameter.element, False, value, state)

    def leave(self, what: object, name: str, state: ProgramState) -> None:
        """Forget what a routine may have given back."""
        if isinstance(what, Function):
            self._given_back(what, state)
        if self._said.resumes is not None and what is not None:
            file, place = self._said.resumes
            state.forget_all(f"RESUME in {self._points.line(file.index, place)} may have broken off what was called")

    def absent(self, what: object, name: str, state: ProgramState) -> None:
        """A routine that is in no given file: it reaches all but variables of other modules."""
        assert isinstance(what, Function)
        self._given_back(what, state)
        if name in self._stated.harmless or (name in table.PACKAGES and name not in self._names.twice):
            return
        why = f"{name.upper()} is in several files" if name in self._names.twice else absent(name.upper())
        self._reached(why, state)

    def _reached(self, why: str, state: ProgramState) -> None:
        for family in ("frame", "mode", "stance", "outside", "shared"):
            state.forget_family(family, why)
        for array in self.arrays:
            state.forget_family(f"shared:{array}", why)

    def _given_back(self, call: Function, state: ProgramState) -> None:
        head = dict(enumerate(self._said.parameters.get(call.routine, [])))
        for k, argument in enumerate(call.arguments):
            if isinstance(argument, Variable) and not (k in head and head[k][1]):
                self._forget(argument, f"{argument.shown} was passed on", state)

    def _carry(self, what: ControllerCall, state: ProgramState) -> None:
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

    def _form(self, state: ProgramState) -> None:
        """What BAS does with FDAT_ACT."""
        form = self._get(("fdat_act", None), True, state)
        part = Parts(form, "FDAT_ACT")
        state.set("frame", "$tool", self._numbered("tool", part("tool_no"), state))
        state.set("frame", "$base", self._numbered("base", part("base_no"), state))
        mode = part("ipo_frame")
        state.set("mode", "ipo", mode.name if isinstance(mode, Word) else mode)

    def _assign(self, assignment: Assignment, state: ProgramState) -> None:
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

    def _stored(self, expression: Expression, state: ProgramState) -> object:
        """The value that a variable gets."""
        if isinstance(expression, Product):
            return self.frame(expression, state)
        value = self.value(expression, state)
        if isinstance(value, Aggregate) and value.point and not isinstance(expression, Aggregate):
            return replace(value, place=None)  # a copy: its numbers stand elsewhere
        return value

    def _write_part(self, assignment: Assignment, state: ProgramState) -> None:
        to = assignment.to
        before = WORKED if to.worked_out else self._get(to.element, to.shared, state)
        value = self.value(assignment.value, state)
        if isinstance(before, Aggregate) and len(to.path) == 1 and isinstance(value, Number | Word):
            self._put(
                to.element, to.shared, replace(before, place=None, fields={**before.fields, to.path[0]: value}), state
            )
        else:
            self._forget(to, f"a part of {to.key.upper().split(':')[-1]} is worked out", state)

    def _new_frame(self, assignment: Assignment, state: ProgramState) -> object:
        to = assignment.to
        if not to.path and to.index is None and not to.worked_out:
            return self.frame(assignment.value, state)
        before = state.get("frame", to.key)
        value = self.value(assignment.value, state)
        part = to.path[0] if len(to.path) == 1 else ""
        if (
            isinstance(before, Frame)
            and isinstance(value, Number)
            and abs(value.value) <= LARGEST_IN_PROGRAM
            and part in ("x", "y", "z")
        ):
            T = before.T.copy()
            T["xyz".index(part), 3] = MILLIMETRE * value.value
            return Frame(T)
        return before if isinstance(before, Unknown) else Unknown(f"a part of {to.key.upper()} is worked out")

    def _mode(self, expression: Expression, state: ProgramState) -> object:
        value = self.value(expression, state)
        if isinstance(expression, Function) and expression.name in ("sipo_mode", "sori_typ") and expression.arguments:
            value = self.value(expression.arguments[0], state)
            if expression.name == "sori_typ":
                value = Parts(value, "")("ori_typ")
        return value.name if isinstance(value, Word) else value if isinstance(value, Unknown) else NO_MODE

    def _move(self, move: Move, state: ProgramState) -> None:
        if move.word in table.RELATIVE:
            state.forget("outside", None, f"{self._line(move)} goes a step from where they were")
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

    def _go(self, move: Move, goal: Goal, last: bool, conditions: _Conditions, state: ProgramState) -> None:
        if isinstance(goal.point, Variable) and goal.point.key in table.HELD and not (goal.before or goal.behind):
            return
        value = self.value(goal.point, state)
        if not isinstance(value, Aggregate) or value.place is None or not value.point:
            why = value.why if isinstance(value, Unknown) and value.why else f"{_shown_of(goal)} is worked out"
            if isinstance(value, Aggregate):
                why = f"{_shown_of(goal)} is a copy of numbers that stand elsewhere"
            self._points.vague(goal, move.file, why) if state.recording else None
            self._unread(move, state)
            state.forget("outside", None, f"{self._line(move)} goes to a place that is not known")
            return
        shown = (
            goal.point.shown
            if isinstance(goal.point, Variable)
            else shown_text(self._points.codes[move.file].text[goal.start : goal.end])
        )
        self._send_outside(move, value, state)
        use, stated = self._use(move, goal, value, conditions, state)
        if state.recording:
            self._points.go(shown, value, use, move.word in table.JOINTED)
        if last:
            self._stance(move, value, use, stated, state)

    def _use(
        self, move: Move, goal: Goal, value: Aggregate, conditions: _Conditions, state: ProgramState
    ) -> tuple[Use, bool]:
        """How the move comes to its point, and whether the point's S and T say how the arm stands there."""
        line = self._line(move)
        shift = bool(goal.before or goal.behind)
        if value.jointed:
            return Use(line, why="has frames beside axes" if shift else move.why or conditions.odd_why), False
        why = move.why or conditions.why or self._stands_outside(state)
        base = self._as_frame(conditions.base, "$BASE")
        if shift or self.foot is not HERE:
            base = product(inverse_of(self.foot), base, *self._frames(goal.before, state))
        tool = self._as_frame(conditions.tool, "$TOOL")
        for frame in self._frames(goal.behind[::-1], state):
            tool = product(tool, inverse_of(frame))
        stated = move.word in table.JOINTED and value.states_posture and not goal.behind
        stance = state.get("stance")
        comes = stance.why if isinstance(stance, Unknown) and not stated else ""
        return Use(line, base, tool, shift, why, None, comes, "shifted" if goal.behind else ""), stated

    def _send_outside(self, move: Move, value: Aggregate, state: ProgramState) -> None:
        """Note where a move sends external axes that the robot of the calibration does not have."""
        if not self._moved_outside:
            return
        axis_values = [(axis, own.value) for axis in self._outside if isinstance(own := value.fields.get(axis), Number)]
        if axis_values:
            axis = next((axis for axis, place in axis_values if place), "")
            why = f"{self._line(move)} tells external axis {axis.upper()} a place, and the URDF does not have that axis"
            state.set("outside", None, why if axis else "")

    def _stands_outside(self, state: ProgramState) -> str:
        """Why it is not known where such axes have taken the robot, or the work; empty where they are at zero."""
        if not self._moved_outside:
            return ""
        stands = state.get("outside")
        return f"external axes are not certain: {stands.why}" if isinstance(stands, Unknown) else str(stands)

    def _frames(self, factors: tuple[Expression, ...], state: ProgramState) -> list[object]:
        return [self.frame(factor, state) for factor in factors]

    def _stance(self, move: Move, value: Aggregate, use: Use, stated: bool, state: ProgramState) -> None:
        """Note whether it is known how the arm stands behind a move."""
        is_readable = not value.why and not use.trouble and value.place not in self._points.spoilt
        if not is_readable:
            self._unread(move, state)
        elif stated or (value.jointed and value.fields.keys() >= set(AXES[: len(self._points.cell.axes.arm)])):
            state.set("stance", None, True)

    def _unread(self, move: Move, state: ProgramState) -> None:
        if move.word in table.JOINTED:
            state.forget(
                "stance", None, f"{self._line(move)} goes to a place that is not known, and how the arm stands there"
            )

    def _left(self, move: Move, why: str) -> Target:
        code = self._points.codes[move.file]
        end = code.text.find("\n", move.start)
        shown = shown_text(code.plain[move.start : end if end >= 0 else len(code.text)].upper())
        return Target(code.line(move.start), shown, "pose", NONE, why, file=move.file)

    def _line(self, move: Move) -> str:
        return self._points.line(move.file, move.start)

    def written_by(self, what: Assignment | Function) -> list[tuple[str, Hashable]]:
        """Keys of the state that an assignment, or a routine of no given file, writes at any time."""
        state = ProgramState()
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


def _shown_of(goal: Goal) -> str:
    return goal.point.shown if isinstance(goal.point, Variable) else "the place"


def _odd(key: str, cell: Cell) -> bool:
    """Whether a variable of the controller may change what targets mean."""
    if not key.startswith("$") or key in ("$base", "$tool", "$ipo_mode"):
        return False
    return key not in table.SYSTEM_VARIABLES and not (key in table.OUTSIDE and not cell.axes.external)
