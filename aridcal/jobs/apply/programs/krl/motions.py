"""Moves of KRL, and what interrupts and triggers carry out beside them."""

from __future__ import annotations

from collections.abc import Sequence

from aridcal.jobs.apply.programs.krl import table
from aridcal.jobs.apply.programs.krl.expressions import Line
from aridcal.jobs.apply.programs.krl.project_facts import Mention, Notes, Thread
from aridcal.jobs.apply.programs.krl.syntax import Assignment, Function, Goal, Move, Variable
from aridcal.jobs.apply.programs.krl.tokens import MalformedStatement, Token

MOVES = table.LINEAR | table.JOINTED | table.RELATIVE | table.ASYNCHRONOUS


class Motions(Notes):
    """Reads moves, and statements that carry others out at any time."""

    def _moved(self, line: Line, around: Sequence[Assignment]) -> Move:
        """Read a move; settings of the spline around it hold where it has none of its own."""
        token = line.take()
        word = token.text
        goals: list[Goal] = []
        why = ""
        if word in table.RELATIVE or word in table.ASYNCHRONOUS:
            if not line.ended:
                self._steps(line)
        else:
            goals = [line.goal(self._type)]
            if word in table.CIRCULAR:
                line.take(",")
                goals.append(line.goal(self._type))
                if line.takes(","):
                    line.take("ca")
                    self._mentions(line.expression(), "computes with it")
                    why = "goes on by an angle (CA): the point is not its end"
        while line.peek() in table.APPROXIMATIONS:
            line.take()
        settings = self._settings(line)
        while line.peek() in table.APPROXIMATIONS:
            line.take()
        line.close()
        for goal in goals:
            self._goes(goal)
        return Move(token.start, self._file.index, word, tuple(goals), why, (*around, *settings))

    def _steps(self, line: Line) -> None:
        """The numbers of a relative move, and what they are relative to."""
        while True:
            self._mentions(line.expression(), "steps by it")
            if line.kind == "word":
                line.take()
            if not line.takes(","):
                return
            if line.takes("ca"):
                continue

    def _type(self, key: str) -> str:
        return self._names.types.get(key, "")

    def _settings(self, line: Line) -> tuple[Assignment, ...]:
        if not line.takes("with"):
            return ()
        settings: list[Assignment] = []
        while not settings or line.takes(","):
            to = line.variable(line.take())
            line.take("=")
            value = line.expression()
            if to.key not in ("$base", "$tool", "$ipo_mode", *table.OUTSIDE) and to.key not in table.SYSTEM_VARIABLES:
                raise MalformedStatement
            self._mentions(value, "uses it as a frame")
            settings.append(Assignment(to, value))
        return tuple(settings)

    def _goes(self, goal: Goal) -> None:
        point = goal.point
        if isinstance(point, Variable):
            for inside in point.inside:
                self._mentions(inside, "computes with it")
            if point.worked_out or point.path:
                does = "indexes it" if point.worked_out else "computes with it"
                self._said.reads.append(Mention(point, self._file, does))
        else:
            self._mentions(point, "computes with it")
        for frame in (*goal.before, *goal.behind):
            self._mentions(frame, "shifts by it")

    def _thread(self, line: Line, first: Token, word: str) -> None:
        rest = line.rest()
        if word != "trigger" and (not rest or rest[0].text != "decl"):
            if rest and rest[0].text in ("on", "off", "enable", "disable", "delay"):
                return
            raise MalformedStatement
        at = next((k for k, token in enumerate(rest) if token.text == "do" and token.kind == "name"), -1)
        if at < 0:
            raise MalformedStatement
        self._said_in(rest[:at])
        remainder = Line(rest[at + 1 :], self._file.index, self._low, self._text, self._resolved, self._routine_key)
        if remainder.peek(1) == "(":
            call = remainder.expression()
            if not isinstance(call, Function):
                raise MalformedStatement
            what: Function | Assignment = call
            if self._call(call) and call.routine == call.name and call.name not in table.PACKAGES:
                self._said.missing.add(call.name)
        else:
            to = remainder.variable(remainder.take())
            remainder.take("=")
            what = Assignment(to, remainder.expression())
            self._written(what)
            if remainder.calls:
                raise MalformedStatement
        if not remainder.ended:
            remainder.take("prio")
            remainder.take("=")
            remainder.expression()
        remainder.close()
        self._said.threads.append(Thread(what, self._file, first.start))
