"""What the statements of RAPID do: routines for the walk, and targets with all their uses."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import NamedTuple

from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.frames import absent
from aridcal.jobs.apply.programs.project import SourceFile
from aridcal.jobs.apply.programs.rapid.expressions import STEP, Constant, Expressions, Value, part_of, with_part
from aridcal.jobs.apply.programs.rapid.grammar import Statement, fold
from aridcal.jobs.apply.programs.rapid.names import (
    BARE,
    INSTRUCTIONS,
    Arguments,
    BoundRoutine,
    Names,
    arguments,
    calls,
    late,
    matched,
    quoted_name,
)
from aridcal.jobs.apply.programs.rapid.points import Targets
from aridcal.jobs.apply.programs.rapid.table import (
    DEFAULTS,
    FUNCTIONS,
    IN_THE_WAY,
    MODES,
    MOVES,
    PLAIN_OPTIONS,
    UNSTEADY,
    WHY,
    WILD,
    WRITING,
    WRITING_FUNCTIONS,
    Move,
)
from aridcal.jobs.apply.programs.rapid.values import (
    ABSENT,
    NOT_USED,
    Alias,
    Datum,
    Literal,
    Point,
    backwards,
    component,
    points_of,
    transform,
)
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.text import NONE
from aridcal.jobs.apply.programs.uses import HERE, Frame, Ledger, Use, product
from aridcal.jobs.apply.programs.walk import (
    DIFFERS,
    EVERYTHING,
    Body,
    Call,
    Choice,
    Jump,
    Leave,
    Mark,
    Node,
    ProgramState,
    Repeat,
    Step,
    Unknown,
)

STANCE = ("stance", None)
"""Whether it is known where the arm comes from."""

OUTSIDE = ("outside", None)
"""Where external axes stand that the URDF does not have: why that matters; empty where they are at zero."""

START = "it is not known where the arm comes from: no joint target comes before; state where it starts with --start"

GUARDED = "!"
"""Ends the key of a routine from which an error may come back to a caller that goes on."""

FIRST = re.compile(r"\s*(\[\s*\[[^][]*\]\s*(?:,\s*\[[^][]*\]\s*)*\]|[A-Za-z_]\w*)\s*,(.*)", re.DOTALL)
"""Arguments of a move that goes to its first one, and all that stands behind it."""

Work = Callable[[ProgramState], None]


NOWHERE = (0, 0)
"""The span of what nobody needs to show."""


class _Prepared(NamedTuple):
    """A move, ready to be carried out, where it starts in the text."""

    start: int
    bound: BoundRoutine
    move: Move
    points: tuple[tuple[Value, tuple[int, int], Sequence[Value]], ...]
    tool: Value
    base: Value
    why: str
    offset: bool


@dataclass(frozen=True)
class _PassedArguments:
    """A call with what it gives: each parameter with its value, and what that mentions."""

    line: str
    parameters: tuple[tuple[Datum, Value | Datum], ...]
    mentioned: tuple[Value, ...]
    name: str


@dataclass
class Meaning:
    """The statements of a project.

    Attributes:
        names: What its names mean.
        cell: That it is read for.
        sources: Its files.
        ledger: Where uses are written down.
        bodies: Routines for the walk, by key.
    """

    names: Names
    cell: Cell
    sources: tuple[SourceFile, ...]
    ledger: Ledger[Literal] = field(default_factory=Ledger)
    bodies: dict[str, Body] = field(default_factory=dict)
    _literals: list[Literal] = field(default_factory=list)
    _usual: dict[tuple[str, str, str], _Prepared] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._calm = not self.names.stepped and not self.names.unknown_calls
        self.points = Targets(self.cell, self.sources)
        self.expressions = Expressions(self.names, self.cell.frames, self._declare)
        for datum in self.names.data:
            self._initial(datum)
        fragile = any(bound.routine.goes_on for bound in self.names.routines.values())
        for bound in self.names.routines.values():
            for guarded in (False, True) if fragile else (False,):
                self.bodies[bound.key + GUARDED * guarded] = self._routine(bound, guarded)
            if bound.routine.handlers:
                nodes = [Choice(tuple(tuple(self._body(bound, h, False)) for h in bound.routine.handlers))]
                self.bodies[f"{bound.key} handlers"] = nodes
            bound.routine.body.clear()  # a long program has no room for both
        self._told_outside = any(self._outside(own) for own in self._literals)

    # ---- what stands in the text

    def end(self) -> None:
        """Let go of all that was made of the text: parts of it hold each other, so that it would stay in memory."""
        vars(self).clear()

    def _declare(self, own: Literal) -> None:
        self._literals.append(own)
        if self.sources[own.code.file].ours:
            self.ledger.declare(own.key, own)

    def _initial(self, datum: Datum) -> None:
        """Targets that stand behind a declaration; what changes it, or is worked out from others there."""
        value = self.expressions.declared(datum)
        if datum.changed:
            self._spoil_all(points_of(value), datum.changed)
        if datum.declared.value is not None:
            start, end = datum.declared.value
            home = self.names.home(datum)
            why = f"{self.names.line(datum.code, datum.declared.place)} sets {datum.declared.name} from it"
            for mentioned in self.expressions.mentioned(home, *datum.code.trimmed(start, end)):
                self._spoil_all(points_of(mentioned(ProgramState())), why)

    def _spoil_all(self, literals: Iterable[Literal], why: str) -> None:
        for own in literals:
            self.ledger.declare(own.key, own)
            self.ledger.spoil(own.key, why)

    def leave_all(self, why: str) -> None:
        """Leave every target of the given files."""
        self._spoil_all(self._literals, why)

    # ---- routines for the walk

    def _routine(self, bound: BoundRoutine, guarded: bool) -> list[Node]:
        body = self._body(bound, bound.routine.body, guarded or bound.routine.goes_on)
        if not bound.routine.handlers:
            return body
        handlers = [
            (Step(self.anywhere), *self._body(bound, handler, False, ends=True), Leave("program"))
            for handler in bound.routine.handlers
        ]
        return [Choice(((), *handlers)), *body]

    def _body(self, bound: BoundRoutine, body: Body, guarded: bool, ends: bool = False) -> list[Node]:
        """A body with its statements prepared.

        Args:
            bound: The routine.
            body: Its statements.
            guarded: An error may leave the routine between any two of them.
            ends: What leaves the routine ends the walk.
        """
        nodes: list[Node] = []
        for node in body:
            if isinstance(node, Step):
                assert isinstance(node.what, Statement)
                nodes += self._statement(bound, node.what, guarded)
            elif isinstance(node, Choice):
                nodes.append(Choice(tuple(tuple(self._body(bound, way, guarded, ends)) for way in node.ways)))
            elif isinstance(node, Repeat):
                nodes.append(Repeat(tuple(self._body(bound, node.body, guarded, ends)), node.once))
            elif isinstance(node, Leave) and ends:
                nodes.append(Leave("program"))
            else:
                assert isinstance(node, Mark | Jump | Leave)
                nodes.append(node)
        return nodes

    def _statement(self, bound: BoundRoutine, statement: Statement, guarded: bool) -> list[Node]:
        nodes: list[Node] = []
        for name, start, end in calls(bound.code, statement.body, statement.end):
            nodes += self._function(bound, statement, name, arguments(bound.code, start, end), guarded)
        if statement.kind == "read":
            nodes += self._reading(bound, statement, [(statement.start, statement.end)])
        elif statement.kind == "assign":
            nodes += self._assignment(bound, statement)
        elif statement.kind in ("call", "late"):
            nodes += self._call(bound, statement, guarded)
        elif statement.kind == "connect" and self.names.missing_trap(bound, statement):
            nodes.append(Step(partial(self._at_any_time, absent(statement.name))))
        if guarded and any(isinstance(node, Step) for node in nodes) and not self._only_moves(statement):
            nodes.append(Choice(((Leave("routine"),), ())))
        return nodes

    def _only_moves(self, statement: Statement) -> bool:
        return statement.kind == "read" or (statement.kind == "call" and statement.name in MOVES)

    def _call(self, bound: BoundRoutine, statement: Statement, guarded: bool) -> list[Node]:
        if self._usual and statement.kind == "call" and statement.name in MOVES:
            like = self._usual_move(bound, statement)
            if like is not None:
                return like
        given = self.names.arguments(bound, statement)
        if statement.kind == "late":
            return self._late(bound, statement, given, guarded)
        name = statement.name
        key = self.names.routine(bound.module, name)
        if key is not None or (name not in INSTRUCTIONS):
            return [self._to_routine(bound, statement, name, key, given, guarded)]
        if name in MOVES:
            return self._move(bound, statement, MOVES[name], given, guarded)
        nodes = self._reading(bound, statement, given.spans)
        if name in WRITING:
            nodes += self._writing(bound, given.spans, f"{self._line(bound, statement)} may change it")
        if name in MODES:
            nodes.append(self._mode(bound, statement, given))
        if name in WILD:
            nodes.append(
                Step(partial(self._forget_all, f"{self._line(bound, statement)} may change all data and modes"))
            )
        if name in UNSTEADY:
            nodes.append(Step(partial(self._unsteady, f"{self._line(bound, statement)} moves the arm")))
        return nodes

    def _late(self, bound: BoundRoutine, statement: Statement, arguments: Arguments, guarded: bool) -> list[Node]:
        prefix, _, whole = late(bound.code, statement)
        if whole and prefix:
            key = self.names.routine(bound.module, prefix)
            return [self._to_routine(bound, statement, prefix, key, arguments, guarded)]
        keys = self.names.begin_with(bound.module, prefix) if prefix else []
        if not keys:
            return [self._to_routine(bound, statement, "", None, arguments, guarded)]
        return [Choice(tuple((self._to_routine(bound, statement, prefix, key, arguments, guarded),) for key in keys))]

    def _to_routine(
        self, bound: BoundRoutine, statement: Statement, name: str, key: str | None, arguments: Arguments, guarded: bool
    ) -> Node:
        callee = self.names.routines.get(key) if key is not None else None
        line = self._line(bound, statement)
        if callee is None:
            mentioned = [value for span in arguments.spans for value in self._mentioned(bound, statement, span)]
            return Call("?" + name, _PassedArguments(line, (), tuple(mentioned), name))
        parameters: list[tuple[Datum, Value | Datum]] = []
        mentioned = []
        for parameter, span in matched(callee, arguments):
            if span is None:
                parameters.append((parameter, Constant(ABSENT)))
            else:
                parameters.append((parameter, self._argument(bound, statement, parameter, span)))
                mentioned += self._mentioned(bound, statement, span)
        if len(arguments.required) != sum(not p.declared.optional for p in callee.parameters):
            return Call("?" + name, _PassedArguments(line, (), tuple(mentioned), name))
        return Call(
            callee.key + GUARDED * (guarded or bound.routine.goes_on),
            _PassedArguments(line, tuple(parameters), tuple(mentioned), name),
        )

    def _argument(
        self, bound: BoundRoutine, statement: Statement, parameter: Datum, span: tuple[int, int]
    ) -> Value | Datum:
        if parameter.declared.storage in ("var", "pers", "inout"):
            match = BARE.fullmatch(bound.code.plain, *span)
            name = fold(match.group(1)) if match else ""
            datum = bound.scope.datum(name) if match and name not in statement.loops else None
            if datum is not None and not self.expressions.steady(datum):
                why = f"{self._line(bound, statement)} passes on a part of it"
                return datum if match and not match.group(2) else Constant(Unknown(why))
        if parameter.holds_points and not parameter.declared.array:
            return self._destination(bound, statement, span, parameter.type == "robtarget")
        return self.expressions.compile(bound, *span, statement.loops)

    def _destination(self, bound: BoundRoutine, statement: Statement, span: tuple[int, int], pose: bool) -> Value:
        return self.expressions.destination(bound, *span, "pose" if pose else "joints", statement.loops)

    def _function(
        self, bound: BoundRoutine, statement: Statement, name: str, arguments: Arguments, guarded: bool
    ) -> list[Node]:
        key = self.names.routine(bound.module, name)
        if key is None and name in FUNCTIONS:
            if name not in WRITING_FUNCTIONS:
                return []
            return self._writing(bound, arguments.spans, f"{self._line(bound, statement)} may change it")
        return [self._to_routine(bound, statement, name, key, arguments, guarded)]

    # ---- statements

    def _line(self, bound: BoundRoutine, statement: Statement) -> str:
        return self.names.line(bound.code, statement.start)

    def _mentioned(self, bound: BoundRoutine, statement: Statement, span: tuple[int, int]) -> list[Value]:
        return self.expressions.mentioned(bound, *span, statement.loops)

    def _reading(self, bound: BoundRoutine, statement: Statement, spans: Iterable[tuple[int, int]]) -> list[Node]:
        mentioned = [value for span in spans for value in self._mentioned(bound, statement, span)]
        why = f"{self._line(bound, statement)} computes with it"
        return [Step(partial(self._spoil, mentioned, why))] if mentioned else []

    def _spoil(self, mentioned: Iterable[Value], why: str, state: ProgramState) -> None:
        if state.recording:
            for value in mentioned:
                self._spoil_all(points_of(value(state)), why)

    def _writing(self, bound: BoundRoutine, spans: Iterable[tuple[int, int]], why: str) -> list[Node]:
        nodes: list[Node] = []
        for span in spans:
            match = BARE.fullmatch(bound.code.plain, *span)
            datum = bound.scope.datum(fold(match.group(1))) if match else None
            if datum is not None and not self.expressions.steady(datum):
                if datum.holds_points:
                    nodes.append(Step(partial(self._spoil, [partial(self.expressions.value, datum)], why)))
                nodes.append(Step(partial(self._set, datum, (), Constant(Unknown(why)))))
        return nodes

    def _assignment(self, bound: BoundRoutine, statement: Statement) -> list[Node]:
        code, name = bound.code, statement.name
        datum = None if name in statement.loops else bound.scope.datum(name)
        line = self._line(bound, statement)
        mentioned = self._mentioned(bound, statement, (statement.body, statement.end))
        nodes: list[Node] = []
        if mentioned:
            nodes.append(Step(partial(self._spoil, mentioned, f"{line} sets {name} from it")))
        if datum is None:
            return nodes
        path = code.plain[statement.start : statement.body].rstrip().removesuffix(":=")
        place = self._place(bound, statement, datum, path)
        span = code.trimmed(statement.body, statement.end)
        if datum.holds_points and place != ():
            before = partial(self.expressions.value, datum)
            nodes.append(Step(partial(self._spoil, [before], f"{line} sets a part of it")))
        if datum.holds_points and not (datum.declared.array and place == ()):
            plain = code.plain.startswith("[", span[0])
            value = (
                self._destination(bound, statement, span, datum.type == "robtarget")
                if plain
                else Constant(Unknown(f"{line} works it out"))
            )
            if place != () and not datum.declared.array:
                value = Constant(Unknown(f"{line} sets a part of it"))
        elif datum.holds_points:
            value = Constant(Unknown(f"{line} sets it"))
        else:
            value = self.expressions.compile(bound, *span, statement.loops)
        return [*nodes, Step(partial(self._set, datum, place, value))]

    def _place(self, bound: BoundRoutine, statement: Statement, datum: Datum, path: str) -> tuple[int, ...] | None:
        """Which part of data is assigned to, counted from 1; None where that is worked out."""
        match = BARE.match(path)
        step = STEP.match(path, match.end(1)) if match is not None else None
        if step is None:
            return ()
        if "{" not in path:
            part = component(datum.type, path)
            return part[0] if part is not None else None
        if step.group(2) or path[step.end() :].strip():
            return None
        begin = statement.start + step.start(1)
        spans = bound.code.arguments(begin, begin + len(step.group(1)))
        values = [self.expressions.compile(bound, *span, statement.loops) for span in spans]
        numbers = [value(ProgramState()) for value in values if isinstance(value, Constant)]
        whole = tuple(int(n) for n in numbers if isinstance(n, float) and n.is_integer())
        return whole if len(whole) == len(spans) else None

    def _set(self, datum: Datum, place: tuple[int, ...] | None, value: Value, state: ProgramState) -> None:
        """Give data, or a part of it, a value; also what a parameter stands for."""
        new = value(state)
        while isinstance(below := state.get("data", datum.address), Alias) and below.datum is not datum:
            datum = below.datum
        if datum.leaves and not datum.whole and place is not None:
            for leaf in datum.leaves:
                if leaf[: len(place)] == place:
                    state.set("data", datum.leaf(leaf), part_of(new, [float(k) for k in leaf[len(place) :]]))
            return
        if place is None:
            new = Unknown(datum.changed or "a statement changes a part of it")
        elif place:
            new = with_part(self.expressions.value(datum, state), place, new)
        state.set("data", datum.address, new)

    def _mode(self, bound: BoundRoutine, statement: Statement, arguments: Arguments) -> Node:
        mode, how = MODES[statement.name]
        word = bound.code.text[statement.start : statement.start + len(statement.name)]
        line = f"{self._line(bound, statement)} ({word}) {WHY[mode]}"
        value: Value = Constant(Unknown(line))
        if how == "default":
            value = Constant(DEFAULTS[mode])
        elif how == "switch":
            words = {option.name for option in arguments.options if not option.sign}
            plain = words & {"on", "off", "wrist"}
            if len(arguments.options) == 1 and plain:
                (word,) = plain
                value = Constant("off" if word == "wrist" else word)
        elif how == "argument" and len(arguments.required) == 1 and not arguments.options:
            frame = self.expressions.compile(bound, *arguments.required[0], statement.loops)

            def value(state: ProgramState) -> object:
                return transform(frame(state)) or Unknown(line)

        return Step(partial(self._set_mode, mode, value))

    def _set_mode(self, mode: str, value: Value, state: ProgramState) -> None:
        state.set("mode", mode, value(state))

    def _forget_all(self, why: str, state: ProgramState) -> None:
        state.forget_all(why)

    def _at_any_time(self, why: str, state: ProgramState) -> None:
        state.volatile([EVERYTHING], why)

    def _unsteady(self, why: str, state: ProgramState) -> None:
        state.forget(*STANCE, why)

    # ---- moves

    def _move(
        self, bound: BoundRoutine, statement: Statement, move: Move, arguments: Arguments, guarded: bool
    ) -> list[Node]:
        required, loops = arguments.required, statement.loops
        line = self._line(bound, statement)
        why = move.why and f"{line}: {move.why}"
        for option in arguments.options:
            if option.name not in PLAIN_OPTIONS or (option.sign == "?" and option.name != "wobj"):
                why = why or f"{line}: what \\{option.name} does to the place is not known"
        spans = [required[k] if k < len(required) else None for k in move.points]
        pose = move.way in "LJ"
        points = tuple(self._goal(bound, statement, span, pose) for span in spans if span is not None)
        count = move.tool if move.tool is None or move.tool >= 0 else len(required) - 1
        tool = required[count] if count is not None and max(move.points) < count < len(required) else None
        if pose and (tool is None or None in spans):
            why = why or f"{line} has other arguments than this move has"
        reading = [span for k, span in enumerate(required) if k not in move.points and k not in move.written]
        prepared = _Prepared(
            statement.start,
            bound,
            move,
            points,
            self.expressions.tool(bound, tool, loops) if pose else Constant(HERE),
            self.expressions.work_object(bound, arguments.option("wobj"), loops) if pose else Constant(HERE),
            why,
            arguments.option("noeoffs") is None,
        )
        nodes = self._reading(bound, statement, reading)
        if not nodes and not loops and not why:
            self._remember(prepared, statement)
        nodes.append(Step(prepared))
        nodes += self._writing(bound, [required[k] for k in move.written if k < len(required)], f"{line} may change it")
        if move.routine is not None and move.routine < len(required):
            name = quoted_name(bound.code, required[move.routine])
            key = self.names.routine(bound.module, name)
            nodes.append(self._to_routine(bound, statement, name, key, Arguments(), guarded))
        return nodes

    def _remember(self, prepared: _Prepared, statement: Statement) -> None:
        """Keep what a plain move says behind the place that it goes to: a long program says it a hundred thousand times."""
        bound, move = prepared.bound, prepared.move
        match = FIRST.match(bound.code.plain, statement.body, statement.end)
        frames = all(
            isinstance(own, Constant) and isinstance(own.value, Frame) for own in (prepared.tool, prepared.base)
        )
        if match is not None and frames and move.points == (0,) and not move.written and move.routine is None:
            self._usual[bound.key, statement.name, match.group(2)] = prepared

    def _usual_move(self, bound: BoundRoutine, statement: Statement) -> list[Node] | None:
        """The node of a move that says the same behind its first argument as one before; None where none did."""
        match = FIRST.match(bound.code.plain, statement.body, statement.end)
        like = self._usual.get((bound.key, statement.name, match.group(2))) if match is not None else None
        if match is None or like is None or statement.loops:
            return None
        goal = self._goal(bound, statement, bound.code.trimmed(*match.span(1)), like.move.way in "LJ")
        prepared = _Prepared(statement.start, bound, like.move, (goal,), like.tool, like.base, "", like.offset)
        return [Step(prepared)]

    def _goal(
        self, bound: BoundRoutine, statement: Statement, span: tuple[int, int], pose: bool
    ) -> tuple[Value, tuple[int, int], Sequence[Value]]:
        """Where a move goes; of a place that is no plain point where that stands, and targets that it is worked out from."""
        value = self._destination(bound, statement, span, pose)
        if isinstance(value, Constant) and isinstance(value.value, Point) and not value.value.literal.why:
            return value, NOWHERE, ()
        return value, span, self._mentioned(bound, statement, span)

    def _go(self, prepared: _Prepared, state: ProgramState) -> None:
        way = prepared.move.way
        for value, span, mentioned in prepared.points:
            goal = value(state)
            if self._told_outside:
                self._send_outside(prepared, goal, state)
            if (
                isinstance(goal, Point)
                and not goal.literal.why
                and goal.literal.form == ("pose" if way in "LJ" else "joints")
            ):
                if state.recording:
                    self._use(prepared, goal, state)
            elif state.recording:
                self._vague(prepared, goal, span)
                self._spoil(mentioned, self._why_spoilt(prepared), state)
            self._stand(prepared, goal, state)

    def _send_outside(self, prepared: _Prepared, goal: object, state: ProgramState) -> None:
        """Note where a move sends external axes that the robot of the calibration does not have."""
        line = self.names.line(prepared.bound.code, prepared.start)
        if not isinstance(goal, Point) or goal.literal.why:
            state.forget(*OUTSIDE, f"{line} moves them to a place that is worked out")
            return
        axis_values = self._outside(goal.literal)
        if axis_values:
            axis = "abcdef"[next(iter(axis_values))]
            any_moves = any(axis_values.values())
            why = f"{line} tells external axis eax_{axis} a place, and the URDF does not have that axis"
            state.set(*OUTSIDE, why if any_moves else "")

    def _outside(self, own: Literal) -> Mapping[int, float]:
        """Places of external axes that the robot of the calibration does not have, by their index, zeros last."""
        if own.why:
            return {}
        first = own.code.plain.rfind("[", own.start, own.end) + 1
        return external_axes(own.code.plain[first : own.end], len(self.cell.axes.external))

    def _why_spoilt(self, prepared: _Prepared) -> str:
        return f"{self.names.line(prepared.bound.code, prepared.start)} works out another place from it"

    def _vague(self, prepared: _Prepared, goal: object, span: tuple[int, int]) -> None:
        """A move to a place that no plain numbers say."""
        code = prepared.bound.code
        if isinstance(goal, Point):  # brackets that are no plain numbers, or of another form
            own = goal.literal
            self.ledger.declare(own.key, own)
            self.ledger.spoil(own.key, own.why or "it is no target of this move")
            return
        if not self.sources[code.file].ours:
            return
        why = goal.why if isinstance(goal, Unknown) else "it is no target by itself"
        form = "pose" if prepared.move.way in "LJ" else "joints"
        line = code.line(prepared.start)
        name = " ".join(code.text[slice(*span)].split())
        self.ledger.leave(Target(line, name, "pose" if form == "pose" else "joints", NONE, why, file=code.file))

    def _use(self, prepared: _Prepared, goal: Point, state: ProgramState) -> None:
        own = goal.literal
        if not self.sources[own.code.file].ours and not self.sources[prepared.bound.code.file].ours:
            return
        self.ledger.declare(own.key, own)
        line = self.names.line(prepared.bound.code, prepared.start)
        if prepared.move.way == "E":
            self.ledger.spoil(own.key, f"{line} moves the external axes alone")
            return
        why = prepared.why or self._in_the_way(prepared, own, state)
        if own.form == "joints":
            self.ledger.go(own.key, Use(line, why=why))
            return
        mode, trouble = self._mode_of(prepared, own, state)
        stands = state.get(*OUTSIDE) if self._told_outside else ""
        why = why or (f"external axes are not certain: {stands.why}" if isinstance(stands, Unknown) else str(stands))
        displacement = None if self._calm else state.get("mode", "displacement")
        if isinstance(displacement, Unknown):
            displacement = Unknown(_said("displacement", displacement))
        base = prepared.base(state)
        if displacement is not None or goal.before is not None:
            base = product(base, displacement or HERE, goal.before or HERE)
        tool = prepared.tool(state)
        if goal.after is not None:
            tool = product(tool, backwards(goal.after))
        aside = goal.before is not None or goal.after is not None
        stance = state.get(*STANCE)
        unknown = stance.why if isinstance(stance, Unknown) else ""
        self.ledger.go(own.key, Use(line, base, tool, aside, why or trouble, unknown=unknown, mode=mode))

    def _in_the_way(self, prepared: _Prepared, own: Literal, state: ProgramState) -> str:
        """Why a mode leaves the target as it is; empty where none does."""
        if self._calm:
            return ""
        for mode in IN_THE_WAY:
            if mode == "offset" and own.form == "joints" and not prepared.offset:
                continue
            value = state.get("mode", mode)
            if isinstance(value, Unknown):
                return _said(mode, value)
        if self.points.rails(own) and isinstance(units := state.get("mode", "units"), Unknown):
            return _said("units", units)
        wrist = state.get("mode", "wrist")
        if prepared.move.way == "L" and isinstance(wrist, Unknown):
            return _said("wrist", wrist)
        return ""

    def _mode_of(self, prepared: _Prepared, own: Literal, state: ProgramState) -> tuple[str, str]:
        """Whether confdata decides of the arm's configuration, and why that is not known."""
        if own.form != "pose":
            return "", ""
        value = "on" if self._calm else state.get("mode", "conf" + prepared.move.way.lower())
        if isinstance(value, Unknown):
            return "", _said("confl", value)
        return str(value), ""

    def _stand(self, prepared: _Prepared, goal: object, state: ProgramState) -> None:
        """Where the arm stands behind a move."""
        way = prepared.move.way
        if way == "E":
            return
        plain = isinstance(goal, Point) and not goal.literal.why
        if plain and isinstance(goal, Point) and (way == "A" or self._decided(prepared, goal.literal, state)):
            if isinstance(state.get(*STANCE), Unknown):
                state.set(*STANCE, True)
        elif not plain and way in "AJ":
            line = self.names.line(prepared.bound.code, prepared.start)
            state.forget(
                *STANCE, f"it is not known where the arm comes from: {line} moves to a place that is worked out"
            )

    def _decided(self, prepared: _Prepared, own: Literal, state: ProgramState) -> bool:
        return self._mode_of(prepared, own, state) == ("on", "")

    # ---- the walk's questions

    def step(self, what: object, state: ProgramState) -> None:
        """Carry out a statement."""
        if isinstance(what, _Prepared):  # most are: a long program has no room for a callable of each
            self._go(what, state)
            return
        assert callable(what)
        what(state)

    def enter(self, what: object, name: str, state: ProgramState) -> None:
        """Set parameters and own data."""
        bound = self.names.routines.get(name.removesuffix(GUARDED).removesuffix(" handlers"))
        if bound is None:
            return
        if isinstance(what, _PassedArguments):
            self._pass(what, state)
        for datum in bound.data:
            if not self.expressions.steady(datum):
                self._set(datum, (), Constant(self.expressions.declared(datum)), state)

    def _pass(self, arguments: _PassedArguments, state: ProgramState) -> None:
        for parameter, value in arguments.parameters:
            if isinstance(value, Datum):
                state.set("data", parameter.address, Alias(value))
            else:
                state.set("data", parameter.address, value(state))
        kept = [
            point
            for parameter, _ in arguments.parameters
            for point in points_of(self.expressions.value(parameter, state))
        ]
        if state.recording:
            for mentioned in arguments.mentioned:
                for own in points_of(mentioned(state)):
                    if own not in kept:
                        self._spoil_all([own], f"{arguments.line} works out another place from it")

    def leave(self, what: object, name: str, state: ProgramState) -> None:
        """Drop parameters and own data."""
        bound = self.names.routines.get(name.removesuffix(GUARDED).removesuffix(" handlers"))
        for datum in (*bound.parameters, *bound.data) if bound is not None else ():
            for address in datum.addresses:
                state.drop("data", address)

    def absent(self, what: object, name: str, state: ProgramState) -> None:
        """A routine that is in no given file changes what it may."""
        assert isinstance(what, _PassedArguments)
        shown = what.name or "a routine whose name is worked out"
        self._spoil(what.mentioned, f"{what.line} passes it on to {shown}, which is in no given file", state)
        if what.name not in self.cell.frames.harmless or name == "?":
            state.forget_all(absent(shown))

    # ---- the beginning

    def begin(self, state: ProgramState) -> None:
        """A program's start."""
        self._lose_data(state)
        for mode, value in DEFAULTS.items():
            state.set("mode", mode, value)
        state.set(*OUTSIDE, "")
        if self.cell.start:
            state.set(*STANCE, True)
        else:
            state.forget(*STANCE, START)

    def end_cycle(self, state: ProgramState) -> None:
        """Main begins anew: what no given file changes is as the controller has it (what is not given is told of by a note)."""
        for mode in DEFAULTS.keys() - self.names.stepped:
            state.set("mode", mode, DEFAULTS[mode])

    def anywhere(self, state: ProgramState) -> None:
        """Any place of the program: of an error handler, for instance."""
        for mode in DEFAULTS if self.names.unknown_calls else sorted(self.names.stepped):
            state.forget("mode", mode, self.names.unknown_calls or "it is changed elsewhere in the program")
        state.forget(*STANCE, "it is not known where the arm comes from")
        state.forget(*OUTSIDE, "they may have been moved before")
        self._lose_data(state)

    def _lose_data(self, state: ProgramState) -> None:
        """Data that anything changes keeps its value when the program begins anew."""
        for datum in self.names.data:
            if not self.expressions.steady(datum):
                for address in datum.addresses:
                    state.forget("data", address, datum.changed)


@lru_cache(maxsize=64)
def external_axes(text: str, own: int) -> Mapping[int, float]:
    """Places of external axes in a target's last brackets, but for those of the robot's own, by their index, zeros last."""
    texts = text.rstrip("] \t\r\n").split(",")
    places = [(k, float(place)) for k, place in enumerate(texts) if k >= own]
    return dict(sorted(((k, v) for k, v in places if v < NOT_USED), key=lambda item: item[1] == 0.0))


def _said(mode: str, unknown: Unknown) -> str:
    """Why a mode is not certain, for a reader who does not know which mode is meant."""
    return f"something {WHY[mode]}, and {unknown.why}" if unknown.why == DIFFERS else unknown.why
