"""LinuxCNC's own interpreter, `rs274`: where it sends the axes, block by block.

Debian has it in `linuxcnc-uspace`. It knows nothing of ours, and prints canonical moves with the N word of their block.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

INCH, MILLIMETRE = 0.0254, 1e-3

MACHINE = 25.4
"""[mm]: without a file of settings its tables are in inches."""

FIRST_OFFSET = 5221
"""Number of the variable that has G54's X; those of G55 stand 20 behind."""

PLANES = {"CANON_PLANE_XY": "XYZ", "CANON_PLANE_XZ": "ZXY", "CANON_PLANE_YZ": "YZX"}
"""Axes of arcs, the third along them."""

CALL = re.compile(r"\s*\d+\s+N(\S+)\s+([A-Z_0-9]+)\((.*)\)")


@dataclass(frozen=True)
class Canonical:
    """A move of the machine.

    Attributes:
        block: Its N word.
        call: What it is: ``STRAIGHT_FEED``, ``ARC_FEED``, ...
        numbers: As they are printed, apart from those of ``place``.
        place: Of X, Y and Z in machine coordinates at its end, [m]; NaN where it does not move.
        centre: Of an arc, likewise; NaN along the arc's axis, and of other moves.
    """

    block: int
    call: str
    numbers: tuple[str, ...]
    place: np.ndarray
    centre: np.ndarray


def run(
    program: Path, offsets: Sequence[Sequence[float]], lengths: Mapping[int, float], skip: bool = False
) -> list[Canonical]:
    """All canonical calls of a program.

    Args:
        program: A file.
        offsets: X, Y and Z of G54, G55, ..., [mm].
        lengths: Of tools by their number, [mm].
        skip: Whether blocks with ``/`` are left out.
    """
    variables, tools = program.with_suffix(".var"), program.with_suffix(".tbl")
    values = dict.fromkeys(range(FIRST_OFFSET, FIRST_OFFSET + 9 * 20), 0.0)
    for k, xyz in enumerate(offsets):
        values.update({FIRST_OFFSET + 20 * k + j: value / MACHINE for j, value in enumerate(xyz)})
    required = (5161, 5181, 5201, 5211, 5212, 5213, 5220, *range(5214, 5220), *range(5162, 5170), *range(5182, 5190))
    values.update({number: values.get(number, float(number == 5220)) for number in required})
    variables.write_text("".join(f"{number} {value:.9f}\n" for number, value in sorted(values.items())))
    tools.write_text("".join(f"T{n} P{n} Z{length / MACHINE:.9f} D1.0\n" for n, length in lengths.items()))
    command = ["rs274", *(["-b"] if skip else []), "-g", "-v", str(variables), "-t", str(tools), str(program)]
    own = {**os.environ, "HOME": str(program.parent)}  # its tools are kept there, one file for all runs
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=program.parent, env=own)
    return list(_calls(done.stdout))


def _calls(text: str) -> Iterator[Canonical]:
    unit, plane = MILLIMETRE, "XYZ"
    work, zero, tool = np.zeros(3), np.zeros(3), np.zeros(3)
    for line in text.splitlines():
        match = CALL.match(line)
        if match is None:
            continue
        block, call = match.group(1), match.group(2)
        numbers = tuple(re.findall(r"[-+]?\d+\.?\d*", match.group(3)))
        values = np.array([float(n) for n in numbers])
        place, centre = np.full(3, np.nan), np.full(3, np.nan)
        if call == "USE_LENGTH_UNITS":
            unit = INCH if "INCHES" in match.group(3) else MILLIMETRE
        elif call == "SET_G5X_OFFSET":
            work = unit * values[1:4]
        elif call == "SET_G92_OFFSET":
            zero = unit * values[:3]
        elif call == "USE_TOOL_LENGTH_OFFSET":
            tool = unit * values[:3]
        elif call in ("STRAIGHT_FEED", "STRAIGHT_TRAVERSE", "STRAIGHT_PROBE"):
            place = unit * values[:3] + work + zero + tool
            numbers = ()
        elif call == "SELECT_PLANE":
            plane = PLANES[match.group(3)]
        elif call == "ARC_FEED":  # the ends in its plane, the centre, turns, and the end along the third axis
            order = ["XYZ".index(letter) for letter in plane]
            place[order] = unit * values[[0, 1, 5]]
            place += work + zero + tool
            centre[order[:2]] = unit * values[[2, 3]]
            centre += work + zero + tool
            numbers = (numbers[4], *numbers[6:])
        yield Canonical(int(block) if block.isdigit() else -1, call, numbers, place, centre)
