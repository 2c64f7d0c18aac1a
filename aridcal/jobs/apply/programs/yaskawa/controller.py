"""Frames that a controller holds, from its own files: UFRAME.CND and TOOL.CND."""

from __future__ import annotations

import re

import numpy as np

from aridcal.jobs.apply.programs.notations import YASKAWA
from aridcal.jobs.apply.programs.text import NUMBER

SIX = r"[ \t]*,[ \t]*".join(rf"({NUMBER.pattern})" for _ in range(6))

USER = re.compile(rf"^[ \t]*////BUSER[ \t]+{SIX}[ \t]*\r?$", re.MULTILINE)

TOOL = re.compile(rf"\A(?:[^\n]*\n){{1,2}}?[ \t]*{SIX}[ \t]*\r?$", re.MULTILINE)
"""The first numbers of a tool, behind its number and its name."""

OTHER_GROUP = re.compile(r"^[ \t]*///GROUP[ \t]+0*(?!1\b)\d", re.MULTILINE)
"""A user frame that is not robot 1's."""

ENTRY = re.compile(r"^[ \t]*//(UFRAME|TOOL)[ \t]+(\d{1,3})[ \t]*\r?$", re.MULTILINE)


def read_user_frames(text: str) -> dict[int, np.ndarray]:
    """User frames by number, T_base_frame of shape (4, 4), [m]."""
    return _entries(text, "UFRAME", USER)


def read_tools(text: str) -> dict[int, np.ndarray]:
    """Tools by number, T_flange_tool of shape (4, 4), [m]."""
    return _entries(text, "TOOL", TOOL)


def _entries(text: str, kind: str, numbers: re.Pattern[str]) -> dict[int, np.ndarray]:
    entries = list(ENTRY.finditer(text))
    ends = [*(entry.start() for entry in entries), len(text)][1:]
    by_number: dict[int, np.ndarray] = {}
    for entry, end in zip(entries, ends, strict=True):
        own = text[entry.start() : end]
        match = numbers.search(own)
        if entry.group(1) == kind and match is not None and OTHER_GROUP.search(own) is None:
            by_number[int(entry.group(2))] = YASKAWA.pose(np.array([float(n) for n in match.groups()]))
    return by_number
