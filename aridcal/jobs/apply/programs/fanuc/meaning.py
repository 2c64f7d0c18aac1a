"""What a TP program does to frames, tools, position registers and points, and what its moves go to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.fanuc.actions import Action, Place, robot_group, short
from aridcal.jobs.apply.programs.fanuc.flow import Flow
from aridcal.jobs.apply.programs.fanuc.listing import SHOWN, Listing, Point
from aridcal.jobs.apply.programs.fanuc.points import Targets
from aridcal.jobs.apply.programs.fanuc.registers import PLAIN, REGISTER, Register, number_of, sum_of
from aridcal.jobs.apply.programs.frames import absent, unknown_frame
from aridcal.jobs.apply.programs.postures import fanuc_words
from aridcal.jobs.apply.programs.targets import PoseReference, Target, Words
from aridcal.jobs.apply.programs.text import NONE, Code
from aridcal.jobs.apply.programs.uses import ANY, HERE, Frame, Ledger, Use, line_name
from aridcal.jobs.apply.programs.walk import NEVER_SET, ProgramState, Unknown
from aridcal.system.errors import printable

STANCE = "it is not known where the arm comes from, and CONFIG does not say how it stands: state --start J1,J2,..."


@dataclass(frozen=True)
class ActiveFrame:
    """The number of a frame or tool that an instruction has made the active one.

    Attributes:
        number: It.
        by: The instruction.
    """

    number: str
    by: Action = field(compare=False)


@dataclass(frozen=True)
class Mode:
    """What keeps the arm from going where the points are.

    Attributes:
        name: What it is.
        line: Of the instruction that has begun it, for messages.
    """

    name: str
    line: str = field(compare=False)


@dataclass(frozen=True)
class StatedFrames:
    """Frames that are stated for a project.

    Attributes:
        world: T_base_world of user frame 0.
        frames: T_base_frame by number, or why it is not known.
        tools: T_tip_tool likewise.
    """

    world: Frame
    frames: Mapping[int, Frame | Unknown]
    tools: Mapping[int, Frame | Unknown]


class Meaning:
    """Semantics of TP programs.

    Attributes:
        ledger: What moves go to.
        assumed: What moves have needed that no file says: ``world``, ``flange``, ``joints``.

    Args:
        listings: Of the project.
        flows: Of each.
        codes: All files of the project.
        ours: Indices of listings that are corrected.
        spoken: Indices of those whose points are named in the answer.
        given: Frames.
        cell: The robot.
    """

    def __init__(
        self,
        listings: Sequence[Listing],
        flows: Sequence[Flow],
        codes: tuple[Code, ...],
        ours: Mapping[int, bool],
        spoken: frozenset[int],
        stated: StatedFrames,
        cell: Cell,
    ) -> None:
        self.ledger: Ledger[tuple[Code, Point]] = Ledger()
        self.assumed: set[str] = set()
        self._listings, self._codes, self._given, self._cell = listings, codes, stated, cell
        self._targets = Targets(cell.axes, cell.anatomy is not None and not cell.frames.j3_from_link_2)
        self._misread: set[tuple[int, int]] = set()
        self._words: dict[tuple[int, int], Words | None] = {}
        self._spoken = spoken
        for program in sorted(spoken):
            self._declare(program, flows[program], ours[program])

    # points

    def _declare(self, program: int, flow: Flow, ours: bool) -> None:
        """Name the points of a listing, and spoil those that it uses for anything else than moves."""
        listing = self._listings[program]
        foreign = "" if ours else f"stands in {listing.code.name}, which is not corrected: give it, too"
        why = foreign or listing.why or flow.why
        for point in listing.points.values():
            key = self._key(program, point)
            self._words[key] = fanuc_words(point.config, self._cell)
            self.ledger.declare(key, (listing.code, point))
            reason = why or point.why or self._targets.beyond(point)
            if reason:
                self.ledger.spoil(key, reason)
                self._misread.add(key)
        every = next((use for use in flow.uses if use[0] == ANY), None)
        for number, start, use in flow.uses:
            if number in listing.points:
                self._spoil(program, listing.points[number], start, use)
        if every is not None:
            for point in listing.points.values():
                self._spoil(program, point, *every[1:])

    def targets(self) -> list[Target]:
        """All targets, when the walk is over."""
        return self.ledger.targets(self._target)

    def _target(self, what: tuple[Code, Point], use: Use, beside: tuple[PoseReference, ...]) -> Target:
        code, point = what
        return self._targets.target(code, point, self._words[code.file, point.start], use, beside)

    def _spoil(self, program: int, point: Point, start: int, use: str) -> None:
        self.ledger.spoil(self._key(program, point), f"{self.line(program, start)} {use}")

    def _key(self, program: int, point: Point) -> tuple[int, int]:
        return self._listings[program].code.file, point.start

    # the state

    def begin(self, state: ProgramState, frame_texts: Mapping[str, Mapping[int, str]]) -> None:
        """The state in which a program is started; ``frame_texts``: frames and tools that some given program sets, and where."""
        for family, stated in (("frame", self._given.frames), ("tool", self._given.tools)):
            if -1 in frame_texts[family]:
                state.forget_family(family, frame_texts[family][-1])
                continue
            for number, value in stated.items():
                state.set(family, number, value)
            for number, why in frame_texts[family].items():
                state.forget(family, number, why)
        state.set("points", None, True)
        state.set("modes", None, ())
        if self._cell.start:
            state.set("stance", None, True)
        else:
            state.forget("stance", None, STANCE)

    def line(self, program: int, start: int) -> str:
        """How messages name the line of an instruction."""
        return line_name(self._codes, self._listings[program].code, start)

    def step(self, what: object, state: ProgramState) -> None:
        """Carry out an instruction."""
        assert isinstance(what, Action)
        if what.does == "move":
            for place in what.places:
                self._go(what, place, state)
            return
        if what.does in ("frame number", "tool number"):
            self._number(what, state)
            return
        line = self.line(what.program, what.start)
        if what.does in ("frame", "tool"):
            self._frame(what, state, line)
        elif what.does == "register":
            self._register(what, state, line)
        elif what.does in ("offset", "tool offset"):
            match = REGISTER.fullmatch(what.field("value"))
            if match is None:
                state.forget(what.does, None, f"{line} sets {what.field('value')[:SHOWN]} for it")
            else:
                n = int(match.group(1))
                state.set(what.does, None, (n, state.get("register", n)))
        elif what.does in ("mode", "no mode"):
            modes = state.get("modes")
            if isinstance(modes, tuple):
                others = tuple(mode for mode in modes if mode.name != what.field("name"))
                state.set(
                    "modes", None, others if what.does == "no mode" else (*others, Mode(what.field("name"), line))
                )
            state.forget_family("register", f"{line} may set it")  # searches write what they find
        elif what.does == "unknown":
            name = " ".join(what.raw.split()).lower()
            if name not in self._cell.frames.harmless:
                state.forget_all(
                    f"{line} is not understood, and may change frames and points: {printable(name[:SHOWN])}"
                )

    def enter(self, what: object, name: str, state: ProgramState) -> None:
        """Offsets of a caller may not hold in what it calls."""
        for offset in ("offset", "tool offset"):
            state.forget(offset, None, f"the program that calls {name} sets it, or none")

    def leave(self, what: object, name: str, state: ProgramState) -> None:
        """Nor those of what it calls in the caller."""
        for offset in ("offset", "tool offset"):
            state.forget(offset, None, f"{name} may set it")

    def absent(self, what: object, name: str, state: ProgramState) -> None:
        """A program is called that no file has."""
        if name.lower() not in self._cell.frames.harmless:
            state.forget_all(absent(name))

    def _number(self, what: Action, state: ProgramState) -> None:
        groups = what.field("groups")
        if groups and "GP1" not in groups:
            return
        number = _plain_number(what.field("value"))
        if number is not None:
            state.set(what.does, None, ActiveFrame(number, what))
        else:
            line = self.line(what.program, what.start)
            state.forget(what.does, None, f"{line} takes it from {what.field('value')[:SHOWN]}")

    def _frame(self, what: Action, state: ProgramState, line: str) -> None:
        index, source = robot_group(what.field("index")) or "", REGISTER.fullmatch(what.field("value"))
        if not short(index):
            state.forget_family(what.does, f"{line} sets a user {what.does} whose number is worked out")
            return
        register = state.get("register", int(source.group(1))) if source is not None else None
        value = register.frame if isinstance(register, Register) else None
        if value is None:
            state.forget(what.does, int(index), f"{line} sets the user {what.does} to {what.field('value')[:SHOWN]}")
        else:
            state.set(
                what.does, int(index), self._given.world @ value if what.does == "frame" else self._flange @ value
            )

    @property
    def _flange(self) -> Frame:
        flange = self._given.tools.get(0, HERE)
        return flange if isinstance(flange, Frame) else HERE

    def _register(self, what: Action, state: ProgramState, line: str) -> None:
        index = robot_group(what.field("index"))
        if index is None:
            return
        number, _, element = index.partition(",")
        if not short(number):
            state.forget_family("register", f"{line} sets a register whose number is worked out")
            return
        before = state.get("register", int(number))
        if not element:
            value = sum_of(what.field("value"), state)
        elif not isinstance(before, Register):
            value = None
        elif element in "123456" and len(element) == 1:
            numbers = list(before.numbers)
            numbers[int(element) - 1] = number_of(what.field("value"), state)
            value = Register(tuple(numbers))
        else:
            value = before if element.isdecimal() else Register()
        if value is None:
            state.forget("register", int(number), f"{line} sets it to what is not certain")
        else:
            state.set("register", int(number), value)

    # moves

    def _go(self, what: Action, place: Place, state: ProgramState) -> None:
        listing = self._listings[what.program]
        point = listing.points.get(place.point) if place.point is not None else None
        if point is None:
            if what.how == "J":
                state.forget("stance", None, STANCE)
            if state.recording and what.program in self._spoken:
                self._leave(what, place, listing)
            return
        key = self._key(what.program, point)
        if state.recording and key in self._words:
            self.ledger.go(key, self._use(what, point, state))
        if key in self._misread:
            if what.how == "J":
                state.forget("stance", None, STANCE)
        elif point.joints or self._words.get(key) is not None:
            state.set("stance", None, True)

    def _leave(self, what: Action, place: Place, listing: Listing) -> None:
        line = self.line(what.program, what.start)
        reasons = {
            "P": f"{line} goes to a point that /POS does not have",
            "PAL_": f"{line} works out a place of a pallet",
        }
        why = reasons.get(
            place.kind[:4] if place.kind != "P" else "P", f"{line} goes to what a position register holds"
        )
        name = f"{place.kind}[{place.index[:SHOWN]}]"
        self.ledger.leave(Target(listing.code.line(what.start), name, "pose", NONE, why, file=listing.code.file))

    def _use(self, what: Action, point: Point, state: ProgramState) -> Use:
        line = self.line(what.program, what.start)
        points = state.get("points")
        why = points.why if isinstance(points, Unknown) else ""
        modes = state.get("modes")
        if isinstance(modes, Unknown):
            why = why or modes.why
        elif isinstance(modes, tuple) and modes:
            why = why or f"{modes[0].name} from {modes[0].line} on"
        why = why or next((f"{line}: {option.why}" for option, _ in what.options if option.does == "left"), "")
        if point.joints:
            if self._key(what.program, point) not in self._misread and not self._cell.frames.j3_from_link_2:
                self.assumed.add("joints")
            why = why or self._shifted_joints(what, state, line)
            return Use(line, why=why)
        base = self._base(point, state, line)
        tool = self._tool(point, state, line)
        aside = False
        for option, _ in what.options:
            if option.does not in ("offset", "tool offset"):
                continue
            shift = self._shift(what, option.does, state)
            if shift is None:
                why = why or f"{line} shifts it by a way that is not certain"
                continue
            way = Frame(_translation(shift if option.does == "offset" else -shift))
            aside = aside or bool(np.any(shift != 0.0))
            if option.does == "offset":
                base = base @ way if isinstance(base, Frame) else base
            else:
                tool = tool @ way if isinstance(tool, Frame) else tool
        stance = state.get("stance")
        settled = self._words.get(self._key(what.program, point)) is not None
        strange = stance.why if isinstance(stance, Unknown) and not settled else ""
        return Use(line, base, tool, aside, why, None, strange)

    def _shifted_joints(self, what: Action, state: ProgramState, line: str) -> str:
        for option, _ in what.options:
            if option.does in ("offset", "tool offset"):
                shift = self._shift(what, option.does, state)
                if shift is None or np.any(shift != 0.0):
                    return f"{line} shifts joints by a way"
        return ""

    def _shift(self, what: Action, does: str, state: ProgramState) -> np.ndarray | None:
        """The way by which a move goes aside, [m]; None where it is not certain."""
        index = next(dict(fields).get("register") for option, fields in what.options if option.does == does)
        if index is None:
            condition = state.get(does)
            if not isinstance(condition, tuple):
                return None
            register = condition[1] if condition[1] == state.get("register", condition[0]) else None
        else:
            register = state.get("register", int(index)) if short(index) else None
        return register.shift if isinstance(register, Register) else None

    def _base(self, point: Point, state: ProgramState, line: str) -> object:
        number = self._agreed("frame number", "user frame", point.user, state, line)
        if isinstance(number, Unknown):
            return number
        if number == "0":
            self.assumed.add("world")
            return self._given.world
        value = state.get("frame", int(number))
        return Unknown(unknown_frame("user frame", number)) if value is NEVER_SET else value

    def _tool(self, point: Point, state: ProgramState, line: str) -> object:
        number = self._agreed("tool number", "user tool", point.tool, state, line)
        if isinstance(number, Unknown):
            return number
        if number == "0":
            self.assumed.add("flange")
            return self._flange
        value = state.get("tool", int(number))
        return Unknown(unknown_frame("user tool", number)) if value is NEVER_SET else value

    def _agreed(self, family: str, kind: str, own: str, state: ProgramState, line: str) -> str | Unknown:
        """The number of a point's frame or tool, which must be the active one: else the controller stops there.

        Where no instruction has set one the point's own number is believed, as programs are taught with the active one.
        """
        active = state.get(family)
        if own == "F":
            if isinstance(active, ActiveFrame):
                return active.number
            assert isinstance(active, Unknown)
            return Unknown(f"its {kind} is the active one of {line}, and {active.why}")
        if not own.isdecimal():
            return Unknown(f"its {kind} {own} is no number")
        if isinstance(active, ActiveFrame) and active.number != own:
            before = self.line(active.by.program, active.by.start)
            return Unknown(f"is in {kind} {own}, but {before} has set {active.number}: the controller stops at {line}")
        if isinstance(active, Unknown) and active is not NEVER_SET:
            return Unknown(f"is in {kind} {own}, and of the active one at {line} it is not certain: {active.why}")
        return own


@lru_cache(maxsize=64)
def _plain_number(value: str) -> str | None:
    """The number of a frame or a tool without zeros in front; None where it is worked out."""
    match = PLAIN.fullmatch(value)
    return match.group(1)[-9:].lstrip("0") or "0" if match is not None and match.group(1).isdecimal() else None


def _translation(shift: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = shift
    return T
