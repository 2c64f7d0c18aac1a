"""What G-code does to the axes: a walk through its blocks with all modes, and the targets that are found on the way."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property, partial

from aridcal.jobs.apply.programs.axes import DEGREE
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.frames import absent
from aridcal.jobs.apply.programs.gcode.blocks import COMMENT, Block
from aridcal.jobs.apply.programs.gcode.flow import Flow
from aridcal.jobs.apply.programs.gcode.modes import MODES, UNDERSTOOD, Control, Modes, Zero
from aridcal.jobs.apply.programs.gcode.record import AT_START, ELSEWHERE, Key, Move, MoveRecord, letters_of
from aridcal.jobs.apply.programs.gcode.table import (
    ARC,
    CALLS,
    CENTRE,
    CHANGE,
    CODES,
    CURVED,
    MILLIMETRE,
    SLIDES,
    START,
    STATED,
    TURNS,
)
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, Number
from aridcal.jobs.apply.programs.uses import HERE
from aridcal.jobs.apply.programs.walk import ProgramState, TooManyWays, Unknown, Walk
from aridcal.system.errors import AridcalError

POINTED = re.compile(r"[XYZABCUVW][ \t]*+[-+]?[0-9]++\.(?![0-9])", re.IGNORECASE)
"""A whole number with its point: ``X20.``"""

POINTLESS = re.compile(r"[XYZABCUVW][ \t]*+[-+]?0*+[1-9][0-9]*+(?![0-9.])", re.IGNORECASE)
"""One without: ``X20``, but for zero."""

MIXED = "whole numbers stand with a decimal point and without: on controllers that need it X20 is 0.020; write all with a point"

NOT_STATED = Unknown("no G0 or G1 stands before it")

AWAY = Unknown("the axes are elsewhere")

IN_MACHINE = "is a place of the machine (G53), at the end of its travel perhaps: it stays"

CHANGES = re.compile(rf"{CHANGE[0]}[ \t]*+0*+{CHANGE[1]}(?![0-9.])", re.IGNORECASE)

Words = list[tuple[str, Number | None]]


def read(project: Project, cell: Cell) -> ProgramReading:
    """Targets of all straight moves, in the order in which the axes go there.

    A block that lacks the word of an axis leaves it where it is, so that only the words that stand there can be corrected; and
    none of them where nobody knows where that axis is, behind a step or a tool change for instance. A target that is left has
    readings all the same where they are known: the axes are there then, as the program says and not as it was corrected.

    Args:
        project: Programs; letters go to the robot's joints in their order, X Y Z to those that slide, A B C to those that turn.
        cell: With ``bases`` named G54 to G59: where the zero of each axis is, in ``xyz``; with ``tools`` named H1 and so on: the
            length that G43 adds to Z, in ``xyz``.

    Raises:
        AridcalError: the robot has axes that G-code has no letters for.
    """
    reader = _Reader(project, cell)
    flow = Flow()
    for file, source in enumerate(project.sources):
        flow.add(source.text, file, source.path.stem)
    walk = Walk(flow.routines, reader)
    try:
        for main in flow.mains:
            walk.enter(main, reader.start(cell.start and main == flow.mains[0]))
        for name in flow.routines:
            if name not in walk.reached:
                state = ProgramState()
                state.forget_all(f"{name} is called by no program of the given files: give that, too")
                for k in range(len(cell.robot.kinds)):
                    state.set("last", k, ELSEWHERE)
                walk.enter(name, state)
    except TooManyWays:
        flow.wild = flow.wild or "the program has more ways than can be followed"
    flow.routines.clear()
    del walk  # a long program's blocks are larger than its targets
    return ProgramReading(reader.record.targets(flow.wild), reader.notes())


@dataclass
class _Now:
    """What is certain before a block.

    Attributes:
        modes: Of the controller.
        at: For each reading the block that has sent it to where it is, or :class:`Unknown`.
        last: For each reading the last block that has stated it, whether it is still there or not.
        trouble: Why it is not known where a straight move would go; empty if it is.
        recording: Whether moves are written down.
    """

    modes: Modes
    at: list[object]
    last: list[object]
    trouble: str
    recording: bool


class _Reader:
    """Carries blocks out; the semantics of the walk."""

    def __init__(self, project: Project, cell: Cell) -> None:
        self._project, self._cell = project, cell
        self._kinds = cell.robot.kinds
        self._zeros = [cell.axes.zero(k) for k in range(len(self._kinds))]
        self._letters = _letters(self._kinds)
        self._line = partial(_line, project)
        self._control = Control(self._letters, cell.frames, self._line)
        self._mixed = [_mixes_points(source.text) for source in project.sources]
        self._stated: set[str] = set()
        self._granted: dict[str, int] = {}
        self._whole = False
        self._machine = ""
        self._made_units: dict[tuple[tuple[int, ...], float], tuple[tuple[float, int], ...]] = {}
        self.record = MoveRecord(project, len(self._kinds))

    @cached_property
    def _puts_in(self) -> bool:
        """Whether the programs have an instruction of its own that puts a tool in."""
        return any(CHANGES.search(COMMENT.sub("", source.text)) for source in self._project.sources)

    def start(self, placed: bool) -> ProgramState:
        """All modes as a reset leaves them.

        Args:
            placed: Whether it is known where the axes are.
        """
        state = ProgramState()
        for mode, value in START.items():
            state.set(mode, None, value)
        state.set("motion", None, NOT_STATED)
        state.set(UNDERSTOOD, None, True)
        for k in range(len(self._kinds)):
            state.set("at", k, AT_START if placed else AWAY)
            state.set("last", k, AT_START)
        return state

    def enter(self, what: object, name: str, state: ProgramState) -> None:
        """Nothing: modes of the caller hold in what it calls."""

    def leave(self, what: object, name: str, state: ProgramState) -> None:
        """Nothing: modes hold on."""

    def absent(self, what: object, name: str, state: ProgramState) -> None:
        """Another program may do anything, unless the user says that it is harmless; the axes are elsewhere in any case."""
        assert isinstance(what, Block)
        if name not in self._cell.frames.harmless:
            state.set(UNDERSTOOD, None, Unknown(self._control.at(what, absent(name))))
        for k in range(len(self._kinds)):
            state.set("at", k, AWAY)

    def step(self, what: object, state: ProgramState) -> None:
        """Carry out blocks one after the other."""
        assert isinstance(what, tuple)
        columns = range(len(self._kinds))
        modes: Modes = {mode: state.get(mode) for mode in MODES}
        now = _Now(
            dict(modes),
            [state.get("at", k) for k in columns],
            [state.get("last", k) for k in columns],
            self._control.lost(modes),
            state.recording,
        )
        at, last = list(now.at), list(now.last)
        for block in what:
            self._block(block, now)
        for mode, value in now.modes.items():
            if value is not modes[mode]:
                state.set(mode, None, value)
        for k in columns:
            if now.at[k] is not at[k]:
                state.set("at", k, now.at[k])
            if now.last[k] is not last[k]:
                state.set("last", k, now.last[k])

    def _block(self, block: Block, now: _Now) -> None:
        """Carry out one block: first its codes, then its axis words."""
        before, length = dict(now.modes) if block.late else now.modes, now.modes["length"]
        self._control.carry_out(block, now.modes, self._stated)
        if block.codes or block.fault or isinstance(now.modes[UNDERSTOOD], Unknown):
            now.trouble = self._control.lost(now.modes)
        rows = [CODES[code] for code in block.codes if code in CODES]
        kinds = [row.words for row in rows]
        words = next((kind for kind in ("away", "home", "data", "machine") if kind in kinds), "place")
        own = [(letter, number) for letter, number in block.axes if letter in self._letters]
        if now.recording and words == "place":
            self._arc_begins(block, own, now.modes, now.last)
        other = isinstance(length, Unknown) or now.modes["length"] != length
        if other and "Z" in self._letters and any(row.mode == "length" for row in rows):
            now.at[self._letters["Z"]] = AWAY  # FANUC's controllers move it by the length at once
        away = words == "away" or len(rows) < len(block.codes) or not CALLS.isdisjoint(block.codes)
        away = away or (words == "home" and not own)
        away = away or (any(letter == "T" for letter, _ in block.others) and not self._puts_in)
        if words in ("place", "machine") and own:
            late = any(
                row.mode and before[row.mode] != now.modes[row.mode] for row in map(CODES.get, block.late) if row
            )
            self._go(block, own, now, _doubt(own, away, late, self._mixed[block.file]), words == "machine")
        if words in ("away", "home"):
            for letter, _ in own:
                now.last[self._letters[letter]] = ELSEWHERE
                now.at[self._letters[letter]] = AWAY
        if away or isinstance(now.modes[UNDERSTOOD], Unknown):
            now.at[:] = [AWAY] * len(now.at)

    def _arc_begins(self, block: Block, own: Words, modes: Modes, last: list[object]) -> None:
        """An arc's centre counts from where it begins, and controllers stop where its ends do not fit: none is to move."""
        motion, letters = modes["motion"], {letter for letter, _ in block.others}
        if motion != ARC and not (isinstance(motion, Unknown) and letters & CENTRE):
            return
        if not own and letters.isdisjoint(CURVED):
            return
        for letter, k in self._letters.items():
            if letter in ("XY" if modes["plane"] == "XY" else "XYZ"):
                self.record.use(last[k], k, f"an arc or a curve begins there ({self._line(block)})")

    def _go(self, block: Block, own: Words, now: _Now, doubt: str, machine: bool) -> None:
        """A block sends axes somewhere, to a place of the work or of the machine."""
        axes = tuple([self._letters[letter] for letter, _ in own])
        motion = now.modes["motion"]
        trouble = self._control.lost_to_machine(now.modes) if machine else now.trouble
        why = doubt or trouble or (motion.why if isinstance(motion, Unknown) else "")
        is_certain = not why
        zero = (Zero() if machine else self._control.zero(now.modes)) if is_certain else None
        if motion == ARC:
            why = why or "is no straight move: arcs are left"
        if machine:
            self._machine = self._machine or ("" if why else self._line(block))
            why = why or IN_MACHINE
        missing = [k for k, place in enumerate(now.at) if k not in axes and isinstance(place, Unknown)]
        if missing:
            why = (
                why
                or f"does not state {letters_of(missing, self._letters)}, and no plain move before says where that is"
            )
        unmoved = tuple([(k, place) for k, place in enumerate(now.at) if k not in axes and isinstance(place, tuple)])
        key: Key = (block.file, block.line)
        for k in axes:
            now.last[k] = key if not isinstance(now.modes["distance"], Unknown) else now.last[k]
        if is_certain:
            for k in axes:
                now.at[k] = key
        else:
            now.at[:] = [AWAY] * len(now.at)
        if not now.recording:
            return
        units: tuple[tuple[float, int], ...] = ()
        readings: tuple[float, ...] = ()
        if zero is not None:
            length = now.modes["unit"]
            assert isinstance(length, float)
            units = self._units(axes, length)
            readings = tuple(
                [
                    self._reading(letter, number, unit, zero.shift)
                    for (letter, number), (unit, _) in zip(own, units, strict=True)
                ]
            )
        base, tool = (zero.base, zero.tool) if zero is not None else (HERE, HERE)
        self.record.add(Move(block, axes, readings, units, unmoved, base, tool, why), self._line(block))
        if not why:
            self._remember(block, own)

    def _units(self, axes: tuple[int, ...], length: float) -> tuple[tuple[float, int], ...]:
        """What a unit of each word is, one tuple for all blocks of the same words: a program has few."""
        if (axes, length) not in self._made_units:
            own = [(length if self._kinds[k] == "prismatic" else DEGREE, k) for k in axes]
            self._made_units[axes, length] = tuple(own)
        return self._made_units[axes, length]

    def _reading(self, letter: str, number: Number | None, unit: float, shift: tuple[float, float, float]) -> float:
        """Where a word sends its axis, [m] or [rad]."""
        assert number is not None
        k = self._letters[letter]
        own = MILLIMETRE if self._kinds[k] == "prismatic" else DEGREE
        return unit * number.value - own * self._zeros[k] + (shift["XYZ".index(letter)] if letter in "XYZ" else 0.0)

    def _remember(self, block: Block, own: Words) -> None:
        """Note what is taken for granted for a target."""
        if len(self._stated) < len(START):
            for mode in STATED.keys() - self._stated:
                self._granted.setdefault(mode, block.line)
        if not self._whole:
            self._whole = any(
                number is not None and "." not in number.text and number.value != 0.0 for _, number in own
            )

    def notes(self) -> tuple[str, ...]:
        """What was taken for granted."""
        joints = ", ".join(f"{letter} {self._cell.robot.readings[k]}" for letter, k in self._letters.items())
        notes = [f"axis words are joints of the robot: {joints}"]
        for mode, line in sorted(self._granted.items()):
            notes.append(f"{STATED[mode]} stands nowhere before line {line}: it is taken for granted")
        if self._machine:
            notes.append(
                f"places of the machine (G53, {self._machine}) count from where the joints are at zero: state --zeros where "
                "the controller shows something else there"
            )
        if self._whole:
            notes.append("numbers without a decimal point are taken as whole units, not as thousandths")
        return tuple(notes)


def _line(project: Project, block: Block) -> str:
    """How messages name a block's line: with its file where there are several."""
    line = f"line {block.line}"
    return line if len(project.sources) == 1 else f"{project.sources[block.file].path.name} {line}"


def _doubt(own: Words, away: bool, late: bool, mixed: bool) -> str:
    """What of a block's own words keeps it from being corrected; empty if nothing does.

    Args:
        own: Its axis words.
        away: Whether the axes go elsewhere in the same block.
        late: Whether a code behind an axis word sets a mode.
        mixed: Whether whole numbers of the program stand with and without a point.
    """
    letters = [letter for letter, _ in own]
    if any(number is None for _, number in own):
        return f"{' '.join(letter for letter, number in own if number is None)} is worked out by the controller"
    if len(set(letters)) < len(letters):
        return "states an axis twice"
    if away:
        return "changes the tool, or calls another program, in the same block"
    if late:
        return "has a code behind its axis words: controllers differ in what it holds for"
    for _, number in own:
        assert number is not None
        if not abs(number.value) <= LARGEST_IN_PROGRAM:
            return f"{number.text} is no length of a gantry"
    return MIXED if mixed else ""


def _mixes_points(text: str) -> bool:
    """Whether it is in doubt what a whole number without a point is, where others have one."""
    code = COMMENT.sub("", text) if POINTED.search(text) is not None else ""
    return POINTED.search(code) is not None and POINTLESS.search(code) is not None


def _letters(kinds: tuple[str, ...]) -> dict[str, int]:
    """The index of the reading of each axis letter."""
    slides = [k for k, kind in enumerate(kinds) if kind == "prismatic"]
    turns = [k for k, kind in enumerate(kinds) if kind != "prismatic"]
    if len(slides) > len(SLIDES) or len(turns) > len(TURNS):
        raise AridcalError(
            f"the robot has {len(slides)} sliding and {len(turns)} turning joints: G-code has {len(SLIDES)} and {len(TURNS)} "
            "letters for them; give a table of poses to `aridcal compensate`"
        )
    return {**dict(zip(SLIDES, slides, strict=False)), **dict(zip(TURNS, turns, strict=False))}
