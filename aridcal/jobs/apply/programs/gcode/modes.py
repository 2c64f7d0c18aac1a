"""What the codes of a block do to the modes of a controller."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from aridcal.jobs.apply.programs.frames import KnownFrames, absent, unknown_frame
from aridcal.jobs.apply.programs.gcode.blocks import Block
from aridcal.jobs.apply.programs.gcode.table import (
    ADDED_OFFSETS,
    CALLS,
    CHANGE,
    CODES,
    CURVED,
    CURVES,
    CYCLES,
    EXTRUDER,
    FREE,
    MACHINE_WIDE,
    NOTHING,
    START,
    STRAIGHT,
    Code,
)
from aridcal.jobs.apply.programs.uses import HERE, Frame
from aridcal.jobs.apply.programs.walk import Unknown

UNDERSTOOD = "understood"
"""Unknown behind a block that may do anything, until the program ends."""

MODES = ("motion", *START, UNDERSTOOD)

Modes = dict[str, object]

WITH_OFFSET = re.compile(r"(?!00)[0-9]{2}(?!00)[0-9]{2}")
"""The number of a tool and that of its offset, on lathes: ``T0101``."""

UPRIGHT = 1e-9
"""[m] and of a rotation's matrix: frames that differ by more do not only shift one axis."""


@dataclass(frozen=True)
class Zero:
    """Where the numbers of a block count from.

    Attributes:
        base: The work offset.
        tool: What the length of a tool adds.
        shift: Of X, Y and Z by both, [m].
        why: Why it is not known; empty if it is.
    """

    base: Frame = HERE
    tool: Frame = HERE
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    why: str = ""


@dataclass(frozen=True)
class Control:
    """A controller, as far as its codes set modes.

    Attributes:
        letters: Axes of the robot, with the index of the reading of each.
        frames: Of ``--frames``.
        line: How messages name a block's line.
    """

    letters: Mapping[str, int]
    frames: KnownFrames
    line: Callable[[Block], str]
    _zeros: dict[tuple[object, object, object], Zero] = field(default_factory=dict)

    def at(self, block: Block, why: str) -> str:
        """A reason with its line."""
        return f"{self.line(block)}: {why}"

    def carry_out(self, block: Block, modes: Modes, stated: set[str]) -> None:
        """Set modes by a block.

        Args:
            block: Of the program.
            modes: To set.
            stated: Modes that the program has stated so far, to add to.
        """
        fault = block.fault or (self._codes(block, modes, stated) if block.codes else "") or self._misfit(block, modes)
        if fault and not isinstance(modes[UNDERSTOOD], Unknown):
            modes[UNDERSTOOD] = Unknown(self.at(block, fault))

    def lost(self, modes: Modes) -> str:
        """Why it is not known where a block goes; empty if it is."""
        for mode in (UNDERSTOOD, *START):
            value = modes[mode]
            if isinstance(value, Unknown):
                return value.why
        return self.zero(modes).why

    def lost_to_machine(self, modes: Modes) -> str:
        """Why it is not known where a block goes that counts from the machine's zero; empty if it is."""
        values = [modes[mode] for mode in (UNDERSTOOD, *MACHINE_WIDE)]
        return next((value.why for value in values if isinstance(value, Unknown)), "")

    def zero(self, modes: Modes) -> Zero:
        """Where numbers count from, in modes that are all known."""
        key = (modes["work offset"], modes["length"], modes["plane"])
        if key not in self._zeros:
            self._zeros[key] = self._zero(*key)
        return self._zeros[key]

    def _zero(self, offset: object, length: object, plane: object) -> Zero:
        base = self._stated("the work offset", offset, self.frames.bases)
        tool = HERE if length == NOTHING else self._stated("the length of tool", length, self.frames.tools)
        why = next((part.why for part in (base, tool) if isinstance(part, Unknown)), "")
        if length != NOTHING and plane != "XY":
            why = (
                why or "the length of a tool acts (G43) in another plane than G17: controllers differ in its direction"
            )
        if isinstance(base, Unknown) or isinstance(tool, Unknown) or why:
            return Zero(why=why)
        if np.abs(tool.T[:2, 3]).max() > UPRIGHT:
            return Zero(why=f"the tool {length} of --frames is no length in z alone")
        x, y, z = (base.T[:3, 3] + tool.T[:3, 3]).tolist()
        return Zero(base, tool, (x, y, z))

    def _stated(self, kind: str, name: object, frames: Mapping[str, np.ndarray]) -> Frame | Unknown:
        T = frames.get(str(name).lower())
        if T is None:
            return Unknown(unknown_frame(kind, str(name)))
        if np.abs(T[:3, :3] - np.eye(3)).max() > UPRIGHT:
            return Unknown(f"{name} of --frames is turned (rpy): offsets of G-code only shift axes")
        return Frame(T)

    def _codes(self, block: Block, modes: Modes, stated: set[str]) -> str:
        """Set modes by the codes of a block; returns what is not understood."""
        by_mode: dict[str, str] = {}
        for code in _without_end_of_cycles(block.codes):
            row = CODES.get(code)
            if code == "G65" and f"o{block.word('P')}" in self.frames.harmless:
                continue
            if code in CALLS and code != "M98":
                return absent(f"{code} P{block.word('P')}")
            if row is None and code.lower() not in self.frames.harmless:
                return f"{code} is not in the table of codes that are understood; state it as `harmless` in --frames if it is"
            if row is None or not row.mode:
                continue
            if by_mode.setdefault(row.mode, code) != code:
                modes[row.mode] = Unknown(self.at(block, f"{by_mode[row.mode]} and {code} stand in one block"))
                continue
            value = CASES.get(code, _plain)(self, block, code, row)
            if value is FAULTY:
                return f"{code} is not understood with the words of its block"
            if value is not AS_BEFORE:
                modes[row.mode] = value
            stated.add(row.mode)
        return ""

    def _misfit(self, block: Block, modes: Modes) -> str:
        """Which word of a block belongs to none of its codes; empty if each does."""
        rows = [CODES.get(code) for code in block.codes]
        if None in rows:  # the user says that it is harmless, with all its words
            return ""
        letters = [letter for letter, _ in block.others]
        data = any(row.words != "place" for row in rows if row is not None)
        for letter in letters:
            if letter in FREE or any(letter in row.takes for row in rows if row is not None):
                continue
            if letter in CURVED and modes["motion"] != STRAIGHT:
                continue
            if letter != EXTRUDER:
                return f"{letter} belongs to no code of its block"
        for letter, _ in block.axes:
            if not data and letter not in self.letters:
                return f"{letter} is no axis of the robot"
        if "T" in letters and WITH_OFFSET.fullmatch(block.word("T")) and CHANGE not in block.codes:
            return f"T{block.word('T')} may put an offset in, as lathes have it"
        return "a word stands twice in one block" if len(set(letters)) < len(letters) else ""


def _without_end_of_cycles(codes: tuple[str, ...]) -> tuple[str, ...]:
    """G80 beside G0 or G1 only says that no cycle goes on."""
    if "G80" in codes and not {"G0", "G1"}.isdisjoint(codes):
        return tuple(code for code in codes if code != "G80")
    return codes


FAULTY, AS_BEFORE = object(), object()
"""In place of a value: the words of the block do not fit its code; the mode stays."""


def _plain(control: Control, block: Block, code: str, row: Code) -> object:
    """The value that the table has."""
    if row.value is None:
        why = row.why if row.mode in ("motion", "distance") else control.at(block, f"{code}: {row.why}")
        return Unknown(why)
    return code if row.value == "by name" else row.value


def _tool_length(control: Control, block: Block, code: str, row: Code) -> object:
    """G43 H1: the length of that number."""
    number = block.word("H")
    return f"H{number.lstrip('0') or '0'}" if number.isdigit() else _plain(control, block, code, row)


def _numbered_offset(control: Control, block: Block, code: str, row: Code) -> object:
    """G54.1 P3."""
    number = block.word("P")
    if not number.isdigit():
        return Unknown(control.at(block, "which work offset is meant is worked out"))
    return f"{code} P{number.lstrip('0') or '0'}"


def _added_offset(control: Control, block: Block, code: str, row: Code) -> object:
    """G58 with axis words and no move beside shifts the zero on Siemens, and goes there on FANUC."""
    return FAULTY if block.axes and {"G0", "G1"}.isdisjoint(block.codes) else _plain(control, block, code, row)


def _cycle(control: Control, block: Block, code: str, row: Code) -> object:
    """A cycle without axis words is none."""
    return _plain(control, block, code, row) if block.axes else FAULTY


def _offsets(control: Control, block: Block, code: str, row: Code) -> object:
    """G10 alone draws a printer's material back."""
    return _plain(control, block, code, row) if block.axes or block.others else AS_BEFORE


def _progress(control: Control, block: Block, code: str, row: Code) -> object:
    """M73 P50 tells a printer how far it is."""
    return AS_BEFORE if block.word("P") else FAULTY


def _local_zero(control: Control, block: Block, code: str, row: Code) -> object:
    """G52 with zeros for all axes ends it."""
    zeros = {letter for letter, number in block.axes if number is not None and number.value == 0.0}
    if zeros >= control.letters.keys() and len(block.axes) == len(zeros):
        return NOTHING
    return _plain(control, block, code, row)


def _zero_here(control: Control, block: Block, code: str, row: Code) -> object:
    """G92 E0 counts a printer's material from here on, and touches no axis."""
    if not block.axes and [letter for letter, _ in block.others if letter not in FREE] == [EXTRUDER]:
        return AS_BEFORE
    return _plain(control, block, code, row)


def _curve(control: Control, block: Block, code: str, row: Code) -> object:
    """G5 P10000, G5.1 Q1: FANUC's fast machining."""
    return _plain(control, block, code, row) if block.axes else AS_BEFORE


def _diameter(control: Control, block: Block, code: str, row: Code) -> object:
    """G7 with axis words is FANUC's hypothetical axis."""
    return FAULTY if block.axes else _plain(control, block, code, row)


def _not_scaled(control: Control, block: Block, code: str, row: Code) -> object:
    """G50 with axis words sets a lathe's zero."""
    return FAULTY if block.axes else row.value


def _not_mirrored(control: Control, block: Block, code: str, row: Code) -> object:
    """G50.1 ends it for the axes that it names."""
    return row.value if {letter for letter, _ in block.axes} >= control.letters.keys() else AS_BEFORE


CASES: Mapping[str, Callable[[Control, Block, str, Code], object]] = {
    "G43": _tool_length,
    "G54.1": _numbered_offset,
    "G52": _local_zero,
    "G92": _zero_here,
    "G10": _offsets,
    "M73": _progress,
    **dict.fromkeys(ADDED_OFFSETS, _added_offset),
    **dict.fromkeys(CYCLES, _cycle),
    **dict.fromkeys(CURVES, _curve),
    "G7": _diameter,
    "G50": _not_scaled,
    "G50.1": _not_mirrored,
    "G100": _not_mirrored,
}
"""Codes whose value depends on the words of their block."""
