"""What G-code does to the axes: a walk through its blocks with all modes, and the targets that are found on the way."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.errors import AridcalError
from aridcal.programs.axes import DEGREE
from aridcal.programs.cell import Cell, Reading
from aridcal.programs.frames import absent, unknown
from aridcal.programs.gcode.blocks import Block
from aridcal.programs.gcode.flow import Flow
from aridcal.programs.gcode.table import (
    ARC,
    AXES,
    CALLS,
    CODES,
    CURVED,
    CURVES,
    EXTRUDER,
    FREE,
    INCH,
    MILLIMETRE,
    NOTHING,
    SLIDES,
    START,
    STATED,
    STRAIGHT,
    TURNS,
    Code,
)
from aridcal.programs.project import Project
from aridcal.programs.targets import Place, Target
from aridcal.programs.text import Number
from aridcal.programs.uses import HERE, Frame, Ledger, Use
from aridcal.programs.walk import State, TooLong, Unknown, Walk

POINTED = re.compile(r"[XYZABCUVW][ \t]*+[-+]?[0-9]++\.(?![0-9])", re.IGNORECASE)
"""A whole number with its point: ``X20.``"""

LARGEST = 1e6
"""Of a number in a target: a gantry of a kilometre."""

UPRIGHT = 1e-9
"""Frames that are turned by more do more than shift axes."""

NOT_STATED = Unknown("no G0 or G1 stands before it")

UNDERSTOOD = "understood"
"""Unknown behind a block that may do anything, until the program ends."""

MODES = ("motion", *START, UNDERSTOOD)

Key = tuple[int, int]
"""A block: its file and its line."""

AT_START: Key = (-1, 0)
"""Where axes are as it is stated, before the first block."""

Modes = dict[str, object]


@dataclass(frozen=True)
class _Move:
    """A block that sends axes somewhere.

    Attributes:
        block: As it stands.
        axes: Indices of the readings that it states.
        readings: That it states, shape (columns,), NaN elsewhere; None where they are not known.
        units: As in :class:`Target`.
        held: Block that has stated each other reading.
        why: Why it cannot be corrected; empty if it can be.
    """

    block: Block
    axes: tuple[int, ...]
    readings: np.ndarray | None
    units: tuple[tuple[float, int], ...]
    held: tuple[tuple[int, Key], ...]
    why: str


def read(project: Project, cell: Cell) -> Reading:
    """Targets of all straight moves, in the order in which the axes go there.

    A block that lacks the word of an axis leaves it where it is, so that only the words that stand there can be corrected; and
    none of them where nobody knows where that axis is, behind a step or a tool change for instance.

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
            state = State()
            reader.begin(state, cell.start and main == flow.mains[0])
            walk.enter(main, state)
        for name in flow.routines:
            if name not in walk.reached:
                state = State()
                state.forget_all(f"{name} is called by no program of the given files: give that, too")
                walk.enter(name, state)
    except TooLong:
        flow.wild = flow.wild or "the program has more ways than can be followed"
    return Reading(reader.targets(flow.wild), reader.notes())


class _Reader:
    """Carries blocks out; the semantics of the walk."""

    def __init__(self, project: Project, cell: Cell) -> None:
        self._project, self._cell = project, cell
        kinds = cell.robot.kinds
        self._letters = _letters(kinds)
        self._kinds, self._zeros = kinds, [cell.axes.zero(k) for k in range(len(kinds))]
        self._ledger = Ledger()
        self._moves: dict[Key, _Move] = {}
        self._by_name: dict[tuple[str, object], Frame | Unknown] = {}
        self._pointed = [_writes_points(source.text) for source in project.sources]
        self._stated: set[str] = set()
        self._granted: dict[str, int] = {}
        self._whole = False

    def begin(self, state: State, placed: bool) -> None:
        """Set all modes as a reset leaves them.

        Args:
            state: To set.
            placed: Whether it is known where the axes are.
        """
        for mode, value in START.items():
            state.set(mode, None, value)
        state.set("motion", None, NOT_STATED)
        state.set(UNDERSTOOD, None, True)
        for k in range(len(self._kinds)):
            state.set("at", k, AT_START if placed else Unknown("no block before says where the axes are"))

    def enter(self, what: object, name: str, state: State) -> None:
        """Nothing: modes of the caller hold in what it calls."""

    def leave(self, what: object, name: str, state: State) -> None:
        """Nothing: modes hold on."""

    def absent(self, what: object, name: str, state: State) -> None:
        """Another program may do anything, unless the user says that it is harmless; the axes are elsewhere in any case."""
        block = what
        assert isinstance(block, Block)
        if name.lower() not in self._cell.frames.harmless:
            state.set(UNDERSTOOD, None, Unknown(self._at(block, absent(name))))
        for k in range(len(self._kinds)):
            state.forget("at", k, f"{name} brings the axes where it does")

    def step(self, what: object, state: State) -> None:
        """Carry out blocks one after the other."""
        assert isinstance(what, tuple)
        modes: Modes = {mode: state.get(mode) for mode in MODES}
        at: list[object] = [state.get("at", k) for k in range(len(self._kinds))]
        before, stood = dict(modes), list(at)
        for block in what:
            self._block(block, modes, at, state.recording)
        for mode, value in modes.items():
            if value is not before[mode]:
                state.set(mode, None, value)
        for k, place in enumerate(at):
            if place is not stood[k]:
                state.set("at", k, place)

    def _block(self, block: Block, modes: Modes, at: list[object], recording: bool) -> None:
        """Carry out one block: first its codes, then its axis words."""
        before = dict(modes) if block.late else modes
        fault = block.fault or self._codes(block, modes) or self._misfit(block, modes)
        if fault and not isinstance(modes[UNDERSTOOD], Unknown):
            modes[UNDERSTOOD] = Unknown(self._at(block, fault))
        words = next((row.words for code in block.codes if (row := CODES.get(code)) and row.words != "place"), "place")
        away = words == "away" or any(letter == "T" for letter, _ in block.others) or self._calls(block)
        own = [(letter, number) for letter, number in block.axes if letter in self._letters]
        if "length" in modes and "Z" in self._letters and any(CODES[c].mode == "length" for c in block.codes if c in CODES):
            at[self._letters["Z"]] = Unknown("the length of the tool has changed")
        if words == "place" and own:
            late = any(before[CODES[code].mode] != modes[CODES[code].mode] for code in block.late if code in CODES and CODES[code].mode)
            self._go(block, own, modes, at, recording, self._doubt(block, own, away, late))
        if away or isinstance(modes[UNDERSTOOD], Unknown):
            for k in range(len(at)):
                at[k] = Unknown("the axes are elsewhere")

    def _calls(self, block: Block) -> bool:
        return bool(CALLS & set(block.codes)) or any(c not in CODES for c in block.codes)

    def _codes(self, block: Block, modes: Modes) -> str:
        """Set modes by the codes of a block; returns what is not understood."""
        by_mode: dict[str, str] = {}
        codes = block.codes
        if "G80" in codes and not {"G0", "G1"}.isdisjoint(codes):
            codes = tuple(code for code in codes if code != "G80")
        for code in codes:
            if code in CALLS and code != "M98":
                return self._call(block, code)
            row = CODES.get(code)
            if row is None:
                if code.lower() not in self._cell.frames.harmless:
                    return f"{code} is not in the table of codes that are understood; state it as `harmless` in --frames if it is"
                continue
            if not row.mode:
                continue
            if by_mode.setdefault(row.mode, code) != code:
                modes[row.mode] = Unknown(self._at(block, f"{by_mode[row.mode]} and {code} stand in one block"))
                continue
            case = CASES.get(code)
            value = case(self, block, row) if case is not None else self._value(block, code, row)
            if isinstance(value, str) and value == FAULTY:
                return f"{code} is not understood with the words of its block"
            if value is not None:
                modes[row.mode] = value
            self._stated.add(row.mode)
        return ""

    def _value(self, block: Block, code: str, row: Code) -> object:
        """The value that a code gives to its mode."""
        if row.value is None:
            return Unknown(self._at(block, f"{code}: {row.why}") if row.mode not in ("motion", "distance") else row.why)
        return code if row.value == "by name" else row.value

    def _call(self, block: Block, code: str) -> str:
        name = f"o{block.word('P')}"
        if code == "G65" and name in self._cell.frames.harmless:
            return ""
        return absent(f"{code} P{block.word('P')}")

    def _misfit(self, block: Block, modes: Modes) -> str:
        """Which word of a block belongs to none of its codes; empty if each does."""
        if not block.others and not block.axes:
            return ""
        taken = set(FREE)
        data = False
        for code in block.codes:
            row = CODES.get(code)
            if row is not None:
                taken.update(row.takes)
                data = data or row.words != "place"
            else:
                return ""  # the user says that it is harmless, with all its words
        if modes["motion"] != STRAIGHT:
            taken |= CURVED
        if any(letter == EXTRUDER for letter, _ in block.others) and (block.axes or data or "G92" in block.codes or not block.codes or "G1" in block.codes):
            taken.add(EXTRUDER)
        if any(code in CALLS for code in block.codes):
            return ""
        for letter, _ in block.others:
            if letter not in taken:
                return f"{letter} belongs to no code of its block"
        if not data:
            for letter, _ in block.axes:
                if letter not in self._letters:
                    return f"{letter} is no axis of the robot"
        letters = [letter for letter, _ in block.others]
        if len(set(letters)) < len(letters):
            return "a word stands twice in one block"
        return ""

    def _doubt(self, block: Block, own: list[tuple[str, Number | None]], away: bool, late: bool) -> str:
        """What of a block's own words keeps it from being corrected."""
        letters = [letter for letter, _ in own]
        out = sorted({letter for letter, number in own if number is None})
        if out:
            return f"{' '.join(out)} is worked out by the controller"
        if len(set(letters)) < len(letters):
            return "states an axis twice"
        if away:
            return "changes the tool, or calls another program, in the same block"
        if late:
            return "has a code behind its axis words: controllers differ in what it holds for"
        return self._unplain(block, own)

    def _unplain(self, block: Block, own: list[tuple[str, Number | None]]) -> str:
        for _, number in own:
            assert number is not None
            if not abs(number.value) <= LARGEST:
                return f"{number.text} is no length of a gantry"
            if self._pointed[block.file] and "." not in number.text and number.value != 0.0:
                return f"{number.text} has no decimal point, where others have: on some controllers it counts thousandths"
        return ""

    def _go(
        self,
        block: Block,
        own: list[tuple[str, Number | None]],
        modes: Modes,
        at: list[object],
        recording: bool,
        doubt: str,
    ) -> None:
        """A block sends axes somewhere."""
        axes = tuple(self._letters[letter] for letter, _ in own)
        key: Key = (block.file, block.line)
        base = self._offset(modes["work offset"])
        tool = self._length(modes)
        lost = self._lost(modes, base, tool)
        motion = modes["motion"]
        curved = "is no straight move: arcs are left" if motion == ARC else ""
        why = doubt or lost or (motion.why if isinstance(motion, Unknown) else "")
        known = not why
        missing = [k for k in range(len(at)) if k not in axes and isinstance(at[k], Unknown)]
        if known and missing and not curved:
            letters = {k: letter for letter, k in self._letters.items()}
            why = f"does not state {' '.join(letters[k] for k in missing)}, and no plain move before says where that is"
        why = why or curved
        held = tuple((k, place) for k, place in enumerate(at) if k not in axes and isinstance(place, tuple))
        if known:
            for k in axes:
                at[k] = key
        else:
            for k in range(len(at)):
                at[k] = Unknown("the axes are elsewhere")
        if recording:
            self._note(block, own, why)
            self._record(key, block, own, axes, modes, base, tool, known, held, why)

    def _record(
        self,
        key: Key,
        block: Block,
        own: list[tuple[str, Number | None]],
        axes: tuple[int, ...],
        modes: Modes,
        base: Frame | Unknown,
        tool: Frame | Unknown,
        known: bool,
        held: tuple[tuple[int, Key], ...],
        why: str,
    ) -> None:
        """Write a move down."""
        units = readings = None
        if known:
            assert isinstance(modes["unit"], float) and isinstance(base, Frame) and isinstance(tool, Frame)
            unit = modes["unit"]
            units = tuple((unit if self._kinds[k] == "prismatic" else DEGREE, k) for k in axes)
            readings = self._readings(own, units, base, tool)
        if key not in self._moves:
            self._moves[key] = _Move(block, axes, readings, units or (), held, why)
            self._ledger.declare(key, partial(self._target, key))
        use = Use(
            self._line(block),
            base if known else HERE,
            tool if known else HERE,
            why=why,
            mode=f"{units} {held}",
        )
        self._ledger.go(key, use)

    def _readings(
        self,
        own: list[tuple[str, Number | None]],
        units: tuple[tuple[float, int], ...],
        base: Frame,
        tool: Frame,
    ) -> np.ndarray:
        """Where a block sends axes, shape (columns,), [m] or [rad]."""
        readings = np.full(len(self._kinds), np.nan)
        for (letter, number), (unit, k) in zip(own, units, strict=True):
            assert number is not None
            slides = self._kinds[k] == "prismatic"
            readings[k] = unit * number.value - (MILLIMETRE if slides else DEGREE) * self._zeros[k]
            if letter in "XYZ":
                readings[k] += base.T["XYZ".index(letter), 3] + tool.T["XYZ".index(letter), 3]
        return readings

    def _target(self, key: Key, use: Use, beside: tuple[Place, ...]) -> Target:
        """The target of a block."""
        move = self._moves[key]
        numbers = tuple(number for _, number in move.block.axes if number is not None)
        name = " ".join(f"{letter}{number.text if number else ''}" for letter, number in move.block.axes)
        source = self._project.sources[key[0]]
        why = "" if source.ours else f"stands in {source.path.name}, which is not corrected: give it, too"
        digits = 5 if any(unit == INCH for unit, _ in move.units) else 4
        plain = len(numbers) == len(move.block.axes)
        return Target(
            move.block.line, name or move.block.text, "joints", numbers if plain else (), why, move.readings, move.units,
            digits=digits, file=key[0],
        )  # fmt: skip

    def targets(self, wild: str) -> list[Target]:
        """All targets, each left where what it leaves out was not stated by the block that went before it.

        Args:
            wild: Why none can be corrected; empty if some can.
        """
        last: dict[int, Key] = dict.fromkeys(range(len(self._kinds)), AT_START)
        answers = []
        for target in self._ledger.targets():
            key = (target.file, target.line)
            move = self._moves[key]
            why = target.why or wild
            if not why and any(last.get(k) != source for k, source in move.held):
                why = "does not state all axes, and comes here from several places"
            known = move.readings is not None and (not target.why or target.why == move.why)
            for k in move.axes if known else range(len(self._kinds)):
                last[k] = key if known else (-2, 0)
            if why:
                readings, units = (move.readings, move.units) if known else (None, ())
                target = replace(target, why=why, readings=readings, units=units)
            answers.append(target)
        return answers

    def _lost(self, modes: Modes, base: Frame | Unknown, tool: Frame | Unknown) -> str:
        """Why it is not known where a block goes; empty if it is."""
        understood = modes[UNDERSTOOD]
        if isinstance(understood, Unknown):
            return understood.why
        for mode in START:
            value = modes[mode]
            if isinstance(value, Unknown):
                return value.why
        return next((part.why for part in (base, tool) if isinstance(part, Unknown)), "")

    def _offset(self, name: object) -> Frame | Unknown:
        """Where the zeros of axes are in a work offset."""
        if isinstance(name, Unknown):
            return name
        return self._stated_frame("the work offset", name, self._cell.frames.bases)

    def _length(self, modes: Modes) -> Frame | Unknown:
        """What the length of a tool adds to Z."""
        name = modes["length"]
        if name == NOTHING:
            return HERE
        if isinstance(name, Unknown):
            return name
        if modes["plane"] != "XY":
            return Unknown("the length of a tool acts (G43) in another plane than G17: controllers differ in its direction")
        frame = self._stated_frame("the length of tool", name, self._cell.frames.tools)
        if isinstance(frame, Frame) and np.abs(frame.T[:2, 3]).max() > UPRIGHT:
            return Unknown(f"the tool {name} of --frames is no length in z alone")
        return frame

    def _stated_frame(self, kind: str, name: object, frames: Mapping[str, np.ndarray]) -> Frame | Unknown:
        if (kind, name) not in self._by_name:
            T = frames.get(str(name).lower())
            frame: Frame | Unknown = Unknown(unknown(kind, str(name))) if T is None else Frame(T)
            if T is not None and np.abs(T[:3, :3] - np.eye(3)).max() > UPRIGHT:
                frame = Unknown(f"{name} of --frames is turned (rpy): offsets of G-code only shift axes")
            self._by_name[kind, name] = frame
        return self._by_name[kind, name]

    def _at(self, block: Block, why: str) -> str:
        return f"{self._line(block)}: {why}"

    def _line(self, block: Block) -> str:
        if len(self._project.sources) == 1:
            return f"line {block.line}"
        return f"{self._project.sources[block.file].path.name} line {block.line}"

    def _note(self, block: Block, own: list[tuple[str, Number | None]], why: str) -> None:
        """Remember what is taken for granted for a target."""
        if why:
            return
        for mode in STATED.keys() - self._stated:
            self._granted.setdefault(mode, block.line)
        self._whole = self._whole or any("." not in n.text and n.value != 0.0 for _, n in own if n is not None)

    def notes(self) -> tuple[str, ...]:
        """What was taken for granted."""
        joints = ", ".join(f"{letter} {self._cell.robot.readings[k]}" for letter, k in self._letters.items())
        notes = [f"axis words are joints of the robot: {joints}"]
        for mode, line in sorted(self._granted.items()):
            notes.append(f"{STATED[mode]} stands nowhere before line {line}: it is taken for granted")
        if self._whole:
            notes.append("numbers without a decimal point count whole units, not thousandths: no number of the program ends in a point")
        return tuple(notes)


FAULTY = "faulty"
"""In place of a value: the words of the block do not fit its code."""


def _tool_length(reader: _Reader, block: Block, row: Code) -> object:
    """G43 H1: the length of that number."""
    number = block.word("H")
    return f"H{number.lstrip('0') or '0'}" if number.isdigit() else Unknown(reader._at(block, row.why))


def _numbered_offset(reader: _Reader, block: Block, row: Code) -> object:
    number = block.word("P")
    return f"G54.1 P{number.lstrip('0') or '0'}" if number.isdigit() else Unknown(reader._at(block, "which work offset is meant is worked out"))


def _local_zero(reader: _Reader, block: Block, row: Code) -> object:
    """G52 with zeros for all axes ends it."""
    zeros = {letter for letter, number in block.axes if number is not None and number.value == 0.0}
    if zeros >= reader._letters.keys() and len(block.axes) == len(zeros):
        return NOTHING
    return Unknown(reader._at(block, f"G52: {row.why}"))


def _zero(reader: _Reader, block: Block, row: Code) -> object:
    """G92 E0 counts a printer's material from here on, and touches no axis."""
    if not block.axes and [letter for letter, _ in block.others if letter not in FREE] == [EXTRUDER]:
        return None
    return Unknown(reader._at(block, f"G92: {row.why}"))


def _curve(reader: _Reader, block: Block, row: Code) -> object:
    """G5 P10000, G5.1 Q1: FANUC's fast machining."""
    return Unknown(row.why) if block.axes else None


def _diameter(reader: _Reader, block: Block, row: Code) -> object:
    """G7 with axis words is FANUC's hypothetical axis."""
    return FAULTY if block.axes else Unknown(reader._at(block, f"G7: {row.why}"))


def _not_scaled(reader: _Reader, block: Block, row: Code) -> object:
    """G50 with axis words sets a lathe's zero."""
    return FAULTY if block.axes else NOTHING


def _not_mirrored(reader: _Reader, block: Block, row: Code) -> object:
    """G50.1 ends it for the axes that it names."""
    return NOTHING if {letter for letter, _ in block.axes} >= reader._letters.keys() else None


CASES: Mapping[str, Callable[[_Reader, Block, Code], object]] = {
    "G43": _tool_length,
    "G54.1": _numbered_offset,
    "G52": _local_zero,
    "G92": _zero,
    **dict.fromkeys(CURVES, _curve),
    "G7": _diameter,
    "G50": _not_scaled,
    "G50.1": _not_mirrored,
    "G100": _not_mirrored,
}
"""Codes whose value depends on the words of their block; None leaves the mode as it is."""


def _letters(kinds: tuple[str, ...]) -> dict[str, int]:
    """The index of the reading of each axis letter."""
    slides = [k for k, kind in enumerate(kinds) if kind == "prismatic"]
    turns = [k for k, kind in enumerate(kinds) if kind != "prismatic"]
    if len(slides) > len(SLIDES) or len(turns) > len(TURNS):
        raise AridcalError(
            f"the robot has {len(slides)} sliding and {len(turns)} turning joints: G-code has {len(SLIDES)} and {len(TURNS)} letters "
            "for them; give a table of poses to `aridcal compensate`"
        )
    return {**dict(zip(SLIDES, slides, strict=False)), **dict(zip(TURNS, turns, strict=False))}


def _writes_points(text: str) -> bool:
    """Whether whole numbers have a point behind them, as FANUC's and Haas's programs have."""
    return POINTED.search(text) is not None
