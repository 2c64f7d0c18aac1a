"""Frames that a controller holds, from its own listings: SYSFRAME.VA, and FRAME.DG, which rounds them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from aridcal.jobs.apply.programs.notations import FANUC
from aridcal.jobs.apply.programs.text import NUMBER

VARIABLE = re.compile(r"\[\*SYSTEM\*\]\$MNU(FRAME|TOOL)[ \t]+Storage[^\n]*POSITION[^\n]*\n([^$]*)")
"""The table of group and number that a listing of system variables has."""

ENTRY = re.compile(
    r"\[\s*1\s*,\s*(\d{1,3})\s*\]\s*=\s*(?:'[^'\n]*'\s*)?Group:\s*1\s+Config:[^\n]*\n\s*"
    + r"\s+".join(rf"{axis}:\s*({NUMBER.pattern})" for axis in "XYZWPR")
)

SECTION = re.compile(r"^[ \t]*(Tool|User) Frame[ \t]*\r?\n((?:[ \t]*[-+\d.].*\n?)*)", re.MULTILINE)
"""A table of FRAME.DG: one frame a line, from number 1 on."""

ROW = re.compile(r"[ \t]*" + r"[ \t]+".join(rf"({NUMBER.pattern})" for _ in range(6)) + r"(?=\s|$)")

KINDS = {"FRAME": "frame", "User": "frame", "TOOL": "tool", "Tool": "tool"}


@dataclass(frozen=True)
class ControllerFrames:
    """Frames of a controller by number, T of shape (4, 4), [m].

    Attributes:
        frames: User frames, in the world frame.
        tools: Tools, on the flange.
    """

    frames: Mapping[int, np.ndarray] = field(default_factory=dict)
    tools: Mapping[int, np.ndarray] = field(default_factory=dict)


def read_frames_of_controller(text: str) -> ControllerFrames:
    """Frames of group 1 in a listing; none in a file of something else."""
    tables: dict[str, dict[int, np.ndarray]] = {"frame": {}, "tool": {}}
    for table in VARIABLE.finditer(text):
        for entry in ENTRY.finditer(table.group(2)):
            tables[KINDS[table.group(1)]][int(entry.group(1))] = _frame(entry.groups()[1:])
    for section in SECTION.finditer(text):
        rows = [ROW.match(line) for line in section.group(2).splitlines()]
        if all(row is not None for row in rows):
            for n, row in enumerate(rows, start=1):
                assert row is not None
                tables[KINDS[section.group(1)]].setdefault(n, _frame(row.groups()))
    return ControllerFrames(tables["frame"], tables["tool"])


def _frame(numbers: tuple[str, ...]) -> np.ndarray:
    return FANUC.pose(np.array([float(n) for n in numbers]))
