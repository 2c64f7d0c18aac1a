"""G-code of a gantry: G0 and G1, absolute, in millimetres or inches, with work offsets; axis words are joints."""

from __future__ import annotations

import re

import numpy as np

from aridcal.programs.axes import DEGREE, Axes
from aridcal.programs.frames import KnownFrames, unknown
from aridcal.programs.targets import NUMBER, Number, Target, blanked

COMMENTS = r"\([^)\n]*\)|;[^\n]*|\"[^\"\n]*\""

WORD = re.compile(rf"([A-Za-z])\s*({NUMBER.pattern})")

INCH, MILLIMETRE = 0.0254, 1e-3

SLIDES, TURNS = "XYZUVW", "ABC"
"""Letters of sliding and of turning axes, in the order of the robot's joints."""

OFFSETS = {f"G{n}" for n in (54, 55, 56, 57, 58, 59)}

CURVES = {"G2", "G3", "G02", "G03"}
"""Arcs."""


def read(text: str, axes: Axes, frames: KnownFrames) -> list[Target]:
    """Targets of all straight moves, in the order of the text.

    A block that lacks the word of an axis leaves it where the block before sent it, so that only the words that stand there can
    be corrected.

    Args:
        text: The program.
        axes: Of the robot: letters go to its joints in their order, X Y Z to those that slide, A B C to those that turn.
        frames: ``bases`` named G54 to G59: where the zero of each axis is, in ``xyz``.
    """
    letters = _letters(axes)
    motion, absolute, unit, offset = "", True, MILLIMETRE, "G54"
    tool_length = False
    found, place = [], 0
    for line, row in enumerate(blanked(text, COMMENTS).split("\n"), start=1):
        words = [(w.group(1).upper(), Number(place + w.start(2), w.group(2))) for w in WORD.finditer(row)]
        place += len(row) + 1
        codes = {f"G{_code(n.text)}" for letter, n in words if letter == "G"}
        if codes & {"G0", "G1"} or codes & CURVES or any(c.startswith("G8") for c in codes):
            motion = next((c for c in ("G0", "G1") if c in codes), "other")
        absolute = "G90" in codes or (absolute and "G91" not in codes)
        unit = INCH if "G20" in codes else MILLIMETRE if "G21" in codes else unit
        offset = next(iter(codes & OFFSETS), offset)
        tool_length = "G43" in codes or (tool_length and "G49" not in codes)
        own = [(letter, n) for letter, n in words if letter in letters]
        if not own or codes & {"G4", "G10", "G28", "G30", "G92", "G53"}:
            continue
        name = " ".join(f"{letter}{n.text}" for letter, n in own)
        why = ""
        if motion not in ("G0", "G1"):
            why = "is no straight move: arcs and cycles are left"
        elif not absolute:
            why = "is a step from the place before (G91)"
        elif tool_length:
            why = "a length of a tool acts (G43) that only the controller knows"
        elif offset.lower() not in frames.bases:
            why = unknown("the work offset", offset)
        if why:
            found.append(Target(line, name, "joints", (), why))
            continue
        units = tuple((DEGREE if axes.kinds[letters[w]] != "prismatic" else unit, letters[w]) for w, _ in own)
        numbers = tuple(n for _, n in own)
        readings = axes.readings(numbers, units) + _zeros(frames.bases[offset.lower()], letters, len(axes.kinds))
        digits = 5 if unit == INCH else 4
        found.append(Target(line, name, "joints", numbers, "", readings, units, digits=digits))
    return found


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
