"""G-code of a gantry: G0 and G1, absolute, in millimetres or inches, with work offsets; axis words are joints."""

from __future__ import annotations

import re

import numpy as np

from aridcal.programs.axes import DEGREE, Axes
from aridcal.programs.frames import KnownFrames, unknown
from aridcal.programs.targets import Number, Target, blanked

COMMENTS = r"\([^)\n]*\)|;[^\n]*|\"[^\"\n]*\""

WORD = re.compile(r"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
"""A letter and its number: G-code has no exponents, E behind a number is the next word."""

WORKED_OUT = re.compile(r"([A-Za-z])\s*[-+]?\s*[#\[=]")
"""A letter whose number the controller works out."""

INCH, MILLIMETRE = 0.0254, 1e-3

SLIDES, TURNS = "XYZUVW", "ABC"
"""Letters of sliding and of turning axes, in the order of the robot's joints."""

OFFSETS = re.compile(r"G5[4-9](\.\d+)?")

MOTIONS = re.compile(r"G(0|1|2|3|5(\.\d)?|6\.\d|3[1234](\.\d)?|38\.\d|7[346]|8\d)")
"""What a block without a code of its own does as well."""

SHIFTS = {"G92": ("G92.1", "G92.2"), "G52": (), "G10": (), "G68": ("G69",), "G51": ("G50",), "G16": ("G15",)}
"""What moves, turns or scales the zero, and what ends that; where nothing does, it holds to the end of the program."""

NO_TARGET = {"G4", "G10", "G28", "G30", "G52", "G53", "G92"}
"""Blocks whose axis words are no target."""

STAYS = {"G4", "G10", "G52", "G92"}
"""Those of them that move no axis."""

HOME = {"G28", "G30"}

CALLS = {"M6", "M98", "G65", "G66"}
"""A change of the tool or another program: the axes are elsewhere thereafter."""


def read(text: str, axes: Axes, frames: KnownFrames) -> list[Target]:
    """Targets of all straight moves, in the order of the text.

    A block that lacks the word of an axis leaves it where the block before sent it, so that only the words that stand there can
    be corrected; and none of them where what was left before, an arc or a step for instance, brought that axis somewhere else.

    Args:
        text: The program.
        axes: Of the robot: letters go to its joints in their order, X Y Z to those that slide, A B C to those that turn.
        frames: ``bases`` named G54 to G59: where the zero of each axis is, in ``xyz``.
    """
    letters = _letters(axes)
    motion, absolute, unit, offset, shift = "", True, MILLIMETRE, "G54", ""
    tool_length = False
    lost: set[str] = set()  # axes that are not where the targets read so far have sent them
    found, place = [], 0
    for line, row in enumerate(blanked(text, COMMENTS).split("\n"), start=1):
        words = [(w.group(1).upper(), Number(place + w.start(2), w.group(2))) for w in WORD.finditer(row)]
        place += len(row) + 1
        codes = {f"{letter}{_code(n.text)}" for letter, n in words if letter in "GM"}
        motion = next((c for c in sorted(codes) if MOTIONS.fullmatch(c)), motion)
        absolute = "G90" in codes or (absolute and "G91" not in codes)
        unit = INCH if "G20" in codes else MILLIMETRE if "G21" in codes else unit
        offset = next((_offset(c, words) for c in sorted(codes) if OFFSETS.fullmatch(c)), offset)
        shift = "" if shift and codes & set(SHIFTS[shift]) else shift
        shift = shift or next((c for c in SHIFTS if c in codes), "")
        tool_length = bool(codes & {"G43", "G43.1", "G43.4", "G44"}) or (tool_length and "G49" not in codes)
        own = [(letter, n) for letter, n in words if letter in letters]
        unread = {w.upper() for w in WORKED_OUT.findall(row)} & set(letters)
        named = {letter for letter, _ in own} | unread
        if codes & CALLS or (codes & HOME and not named):
            lost |= set(letters)
        if codes & NO_TARGET:
            lost |= set() if codes & STAYS else named
            continue
        if not named:
            continue
        name = " ".join(f"{letter}{n.text}" for letter, n in own) or row.strip()
        why = ""
        if unread:
            why = f"{' '.join(sorted(unread))} is worked out by the controller"
        elif motion not in ("G0", "G1"):
            why = "is no straight move: arcs and cycles are left"
        elif not absolute:
            why = "is a step from the place before (G91)"
        elif tool_length:
            why = "a length of a tool acts (G43) that only the controller knows"
        elif shift:
            why = f"the zero is changed ({shift}), by what only the controller knows"
        elif offset.lower() not in frames.bases:
            why = unknown("the work offset", offset)
        elif lost - named:
            why = f"does not state {' '.join(sorted(lost - named))}, which a move that is left, or no target, brought where it is"
        if why:
            lost |= named | (set(SLIDES[:3]) & set(letters) if motion not in ("G0", "G1") else set())
            found.append(Target(line, name, "joints", (), why))
            continue
        lost.clear()
        units = tuple((DEGREE if axes.kinds[letters[w]] != "prismatic" else unit, letters[w]) for w, _ in own)
        numbers = tuple(n for _, n in own)
        readings = axes.readings(numbers, units) + _zeros(frames.bases[offset.lower()], letters, len(axes.kinds))
        digits = 5 if unit == INCH else 4
        found.append(Target(line, name, "joints", numbers, "", readings, units, digits=digits))
    return found


def _offset(code: str, words: list[tuple[str, Number]]) -> str:
    """The name of a work offset; of the further ones of FANUC with their number: ``G54.1 P3``."""
    numbers = [f" P{_code(n.text)}" for letter, n in words if letter == "P"]
    return code + (numbers[0] if code == "G54.1" and numbers else "")


def _code(text: str) -> str:
    """A code without leading zeros: 01 is 1."""
    return f"{float(text):g}"


def _letters(axes: Axes) -> dict[str, int]:
    slides, turns = iter(SLIDES), iter(TURNS)
    return {next(slides if kind == "prismatic" else turns): k for k, kind in enumerate(axes.kinds)}


def _zeros(frame: np.ndarray, letters: dict[str, int], columns: int) -> np.ndarray:
    """Where the zero of each axis is, shape (columns,), [m]."""
    found = np.zeros(columns)
    for letter, value in zip("XYZ", frame[:3, 3], strict=True):
        if letter in letters:
            found[letters[letter]] = value
    return found
