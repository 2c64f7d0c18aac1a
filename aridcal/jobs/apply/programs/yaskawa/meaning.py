"""What a job does to frames, tools, shifts and position variables, and what its moves go to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.frames import absent, unknown_frame
from aridcal.jobs.apply.programs.targets import PoseReference, Target
from aridcal.jobs.apply.programs.text import NONE, Code
from aridcal.jobs.apply.programs.uses import ANY, Frame, Ledger, Use, line_name
from aridcal.jobs.apply.programs.walk import NEVER_SET, ProgramState, Unknown
from aridcal.jobs.apply.programs.yaskawa.flow import Action, Flow
from aridcal.jobs.apply.programs.yaskawa.listing import SHOWN, Job, Position
from aridcal.jobs.apply.programs.yaskawa.points import Targets
from aridcal.system.errors import printable

STANCE = "it is not known where the arm comes from, and RCONF is not read: state --start S,L,U,R,B,T"

AS_STATED = "as stated"
"""The arm stands as --start or a position in pulses says: so far no RCONF has been met."""


@dataclass(frozen=True)
class Shift:
    """A shift that is on.

    Attributes:
        line: Of the instruction that has begun it, for messages.
    """

    line: str = field(compare=False)


@dataclass(frozen=True)
class StatedFrames:
    """Frames that are stated for a project.

    Attributes:
        robot: T_base_robot of the robot's coordinates, which are those of the base where nothing moves it.
        frames: T_base_frame of user frames by number, or why it is not known.
        tools: T_tip_tool likewise.
    """

    robot: Frame
    frames: Mapping[int, Frame | Unknown]
    tools: Mapping[int, Frame | Unknown]


class Meaning:
    """Semantics of jobs.

    Attributes:
        ledger: What moves go to.
        assumed: What moves have needed that no file says, by the names of
        :func:`aridcal.jobs.apply.programs.yaskawa.project.read`'s notes.

    Args:
        jobs: Of the project.
        flows: Of each.
        codes: All files of the project.
        ours: Whether each job is corrected.
        spoken: Indices of those whose positions are named in the answer.
        walked: Indices of those that are walked.
        given: Frames.
        cell: The robot.
    """

    def __init__(
        self,
        jobs: Sequence[Job],
        flows: Sequence[Flow],
        codes: tuple[Code, ...],
        ours: Mapping[int, bool],
        spoken: frozenset[int],
        walked: frozenset[int],
        stated: StatedFrames,
        cell: Cell,
    ) -> None:
        self.ledger: Ledger[tuple[Code, Position]] = Ledger()
        self.assumed: set[str] = set()
        self._jobs, self._codes, self._given, self._cell = jobs, codes, stated, cell
        self._targets, self._spoken = Targets(cell), spoken
        self._left: set[tuple[int, int]] = set()
        self._misread: set[tuple[int, int]] = set()
        self._variables: dict[int, list[tuple[int, Position]]] = {}
        for k, job in enumerate(jobs):
            for (kind, number), position in job.positions.items():
                if kind == "P":
                    self._variables.setdefault(number, []).append((k, position))
        for k in sorted(spoken):
            self._declare(k, flows[k], ours[k])
        self._spoil_used(flows)
        self._spoil_variables(flows, walked)

    # positions

    def _declare(self, k: int, flow: Flow, ours: bool) -> None:
        """Name the positions of a job, and leave those that cannot be corrected whatever is done with them."""
        job = self._jobs[k]
        foreign = "" if ours else f"stands in {job.code.name}, which is not corrected: give it, too"
        for position in job.positions.values():
            self.ledger.declare(self._key(k, position), (job.code, position))
            why = foreign or job.why or flow.why or position.why or self._targets.beyond(position)
            if why:
                self._misread.add(self._key(k, position))
                self._spoil(k, position, why)

    def _spoil_used(self, flows: Sequence[Flow]) -> None:
        """Leave positions that any given job uses otherwise than to go there."""
        for k, flow in enumerate(flows):
            for use in flow.uses:
                why = f"{self.line(k, use.start)} uses it otherwise than to go there"
                if use.kind == "C":
                    own = [(k, p) for (kind, n), p in self._jobs[k].positions.items() if kind == "C"]
                    positions = [(k, p) for k, p in own if use.number in (ANY, p.number)]
                elif use.number == ANY:
                    positions = [entry for entries in self._variables.values() for entry in entries]
                else:
                    positions = self._variables.get(use.number, [])
                for owner, position in positions:
                    self._spoil(owner, position, why)

    def _spoil_variables(self, flows: Sequence[Flow], walked: frozenset[int]) -> None:
        """Leave variables that several jobs state, or that jobs name which have nothing to do with those that are corrected."""
        for number, entries in self._variables.items():
            names = " and ".join(self._jobs[k].code.name for k, _ in entries[:2])
            elsewhere = next((k for k, flow in enumerate(flows) if k not in walked and number in flow.variables), None)
            for k, position in entries:
                if len(entries) > 1:
                    self._spoil(k, position, f"is stated in {names}: the one that was loaded last holds")
                elif elsewhere is not None:
                    self._spoil(
                        k, position, f"{self._jobs[elsewhere].code.name} uses it, too: give that job with this one"
                    )

    def _spoil(self, k: int, position: Position, why: str) -> None:
        if k in self._spoken:
            self.ledger.spoil(self._key(k, position), why)
            self._left.add(self._key(k, position))

    def _key(self, k: int, position: Position) -> tuple[int, int]:
        return self._jobs[k].code.file, position.start

    def targets(self) -> list[Target]:
        """All targets, when the walk is over."""
        return self.ledger.targets(self._target)

    def _target(self, what: tuple[Code, Position], use: Use, beside: tuple[PoseReference, ...]) -> Target:
        return self._targets.target(*what, use, beside)

    # the state

    def begin(self, state: ProgramState, frame_texts: Mapping[str, Mapping[int, str]]) -> None:
        """The state in which a job is started; ``frame_texts``: frames and tools that some given job sets, and where."""
        for family, stated in (("frame", self._given.frames), ("tool", self._given.tools)):
            if ANY in frame_texts[family]:
                state.forget_family(family, frame_texts[family][ANY])
                continue
            for number, value in stated.items():
                state.set(family, number, value)
            for number, why in frame_texts[family].items():
                state.forget(family, number, why)
        state.set("positions", None, True)
        state.set("shift", None, None)
        state.set("called frame", None, "")
        if self._cell.start:
            state.set("stance", None, AS_STATED)
        else:
            state.forget("stance", None, STANCE)

    def line(self, k: int, start: int) -> str:
        """How messages name the line of an instruction."""
        return line_name(self._codes, self._jobs[k].code, start)

    def step(self, what: object, state: ProgramState) -> None:
        """Carry out an instruction."""
        assert isinstance(what, Action)
        line = self.line(what.job, what.start)
        if what.does == "move":
            self._go(what, state)
        elif what.does == "shift on":
            if state.get("shift") is None:
                state.set("shift", None, Shift(line))
            else:
                state.forget("shift", None, f"{line} shifts what may be shifted already")
        elif what.does == "shift off":
            if isinstance(state.get("shift"), Shift):
                state.set("shift", None, None)
        elif what.does in ("frame", "tool"):
            if what.what.isdecimal():
                state.forget(what.does, int(what.what), f"{line} sets it")
            else:
                state.forget_family(what.does, f"{line} sets one whose number is worked out")
        elif what.does == "task":
            state.forget_all(f"{line} starts a job beside this one, which may change frames and positions")
        else:
            name = " ".join(what.raw.split()).lower()
            if name not in self._cell.frames.harmless:
                state.forget_all(
                    f"{line} is not understood, and may change frames and positions: {printable(name[:SHOWN])}"
                )

    def enter(self, what: object, name: str, state: ProgramState) -> None:
        """The frame that a caller names for a relative job."""
        state.set("called frame", None, what.what if isinstance(what, Action) else "")

    def leave(self, what: object, name: str, state: ProgramState) -> None:
        """It is that of the job alone."""
        state.drop("called frame", None)

    def absent(self, what: object, name: str, state: ProgramState) -> None:
        """A job is called that no file has."""
        if name.lower() not in self._cell.frames.harmless:
            state.forget_all(absent(name))

    # moves

    def _go(self, what: Action, state: ProgramState) -> None:
        position = self._position(what)
        if state.recording:
            if position is not None and position[0] in self._spoken:
                self.ledger.go(self._key(*position), self._use(what, *position, state))
            elif what.job in self._spoken:
                self._leave(what)
        self._stand(what, position, state)

    def _stand(self, what: Action, position: tuple[int, Position] | None, state: ProgramState) -> None:
        """How the arm stands behind a move."""
        stance = state.get("stance")
        if position is None or what.why or self._key(*position) in self._misread:
            if what.joint or stance == AS_STATED:
                state.forget("stance", None, STANCE)
        elif position[1].pulses:
            state.set("stance", None, AS_STATED)
        elif stance == AS_STATED:
            state.set("stance", None, position[1].posture)
        elif stance != position[1].posture and not isinstance(stance, Unknown):
            state.forget("stance", None, self._other_posture(what))

    def _position(self, what: Action) -> tuple[int, Position] | None:
        """The job and the position that a move names; None of what no given job states, or several do."""
        kind, index = what.what[:1], what.what[1:]
        if not index.isdecimal():
            return None
        if kind == "C":
            own = self._jobs[what.job].positions.get(("C", int(index)))
            return None if own is None else (what.job, own)
        entries = self._variables.get(int(index), []) if kind == "P" else []
        own_entry = next((entry for entry in entries if entry[0] == what.job), None)
        return own_entry or (entries[0] if entries else None)

    def _leave(self, what: Action) -> None:
        """Name a move that goes to no position of a given job."""
        line = self.line(what.job, what.start)
        code = self._jobs[what.job].code
        why = what.why and f"{line}: {what.why}"
        why = why or f"{line} goes to what no given job states as a number, or to what another job states"
        name = what.what or " ".join(what.raw.split())[:SHOWN]
        self.ledger.leave(Target(code.line(what.start), printable(name), "pose", NONE, why, file=code.file))

    def _other_posture(self, what: Action) -> str:
        line = self.line(what.job, what.start)
        return f"RCONF is another one from {line} on, and it is not read: state --start S,L,U,R,B,T of that part alone"

    def _use(self, what: Action, k: int, position: Position, state: ProgramState) -> Use:
        line = self.line(what.job, what.start)
        positions, shift = state.get("positions"), state.get("shift")
        why = positions.why if isinstance(positions, Unknown) else ""
        why = why or (f"{line}: {what.why}" if what.why else "")
        if isinstance(shift, Unknown):
            why = why or f"a shift may be on: {shift.why}"
        elif isinstance(shift, Shift):
            why = why or f"{shift.line} shifts it (SFTON)"
        settled = self._key(k, position) not in self._left and not why
        if settled:
            self.assumed |= {"unshifted", *(["variables"] if position.kind == "P" else [])}
        if position.pulses or position.why:
            return Use(line, why=why)
        base, tool = self._base(what, k, position, state), self._tool(position, state)
        stance = state.get("stance")
        if isinstance(stance, Unknown):
            strange = stance.why
        elif stance in (AS_STATED, position.posture):
            strange = ""
        else:
            strange = self._other_posture(what)
        if settled and not strange:
            self.assumed.add("posture")
        return Use(line, base, tool, False, why, None, strange)

    def _base(self, what: Action, k: int, position: Position, state: ProgramState) -> object:
        job, frame = self._jobs[k], state.get("called frame")
        if isinstance(frame, Unknown):
            return frame
        if frame:
            return self._called(job, position, str(frame), state)
        if position.kind == "C" and job.relative:
            self.assumed.add("relative")
            own = f"USER {position.user}" if position.frame == "USER" else position.frame
            if job.frame != own:
                return Unknown(f"is in {own}, but its relative job in {job.frame or 'no stated frame'}")
        if position.frame != "USER":
            self.assumed |= {"robot", *(["base"] if position.frame == "BASE" else [])}
            return self._given.robot
        return self._numbered("frame", "user frame", position.user, state)

    def _called(self, job: Job, position: Position, callee: str, state: ProgramState) -> object:
        """The frame of a position whose job is called with one."""
        if not job.relative or position.frame != "USER" or position.kind != "C":
            return Unknown(
                f"is no position of a relative job in a user frame, but gone to by one called with UF#({callee})"
            )
        if not callee.isdecimal():
            return Unknown(f"its job is called with a user frame whose number is worked out, UF#({callee})")
        return self._numbered("frame", "user frame", str(int(callee)), state)

    def _tool(self, position: Position, state: ProgramState) -> object:
        return self._numbered("tool", "tool", position.tool, state)

    def _numbered(self, family: str, kind: str, number: str, state: ProgramState) -> object:
        value = state.get(family, int(number))
        return Unknown(unknown_frame(kind, number)) if value is NEVER_SET else value
