"""LS of FANUC: the points of /POS, as poses in a user frame with a user tool, or as joints."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np

from aridcal.programs.axes import DEGREE, MILLIMETRE, Axes
from aridcal.programs.frames import KnownFrames, unknown
from aridcal.programs.notations import FANUC
from aridcal.programs.targets import NUMBER, Branch, Target, line_of, number
from aridcal.programs.uses import Frame, Use, known

POINT = re.compile(r"(?m)^[ \t]*P\[\s*(\d+)[^\]]*\]\s*\{(?P<body>[^}]*)\}")

SECTION = re.compile(r"(?m)^/POS\b")

VALUE = re.compile(rf"\b(X|Y|Z|W|P|R|J\d|E\d)\s*=\s*({NUMBER.pattern})\s*(mm|deg)\b")

GROUP = re.compile(r"GP1\s*:(?P<own>.*?)(?=GP\d\s*:|\Z)", re.DOTALL)

FRAMES = re.compile(r"UF\s*:\s*(\w+)\s*,\s*UT\s*:\s*(\w+)")

TURNS = re.compile(r"CONFIG\s*:\s*'[^']*?(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")

LETTERS = re.compile(r"CONFIG\s*:\s*'\s*([NF])\s*([UD])\s*([TB])\s*,")

POSE = ("X", "Y", "Z", "W", "P", "R")


def read(text: str, axes: Axes, frames: KnownFrames) -> list[Target]:
    """Points of the program, in the order in which they stand.

    Args:
        text: A program in LS.
        axes: Of the robot: J1 and so on are its joints in their order, E1 and so on its rails.
        frames: ``bases`` (user frames) and ``tools`` (user tools) by number; user frame 0 is the robot's base.
    """
    begin = SECTION.search(text)
    if begin is None:
        return []
    return [_target(text, point, axes, frames) for point in POINT.finditer(text, begin.end())]


def _target(text: str, point: re.Match[str], axes: Axes, frames: KnownFrames) -> Target:
    line, name = line_of(text, point.start(1)), f"P[{point.group(1)}]"
    group = GROUP.search(text, *point.span("body"))
    if group is None:
        return Target(line, name, "pose", (), "has no group GP1")
    own = {m.group(1): number(m, 2) for m in VALUE.finditer(text, *group.span("own"))}
    joints = {f"J{k + 1}": k_own for k, k_own in enumerate(axes.arm)} | {
        f"E{k + 1}": k_own for k, k_own in enumerate(axes.external)
    }
    if "J1" in own:
        named = [axis for axis in joints if axis in own]
        units = axes.units([joints[axis] for axis in named], DEGREE, MILLIMETRE)
        numbers = tuple(own[axis] for axis in named)
        return Target(line, name, "joints", numbers, "", axes.readings(numbers, units), units, digits=3)
    if not set(POSE) <= set(own):
        return Target(line, name, "pose", (), "is not taught, or no plain numbers")
    stated = FRAMES.search(group.group("own"))
    user, tool = (stated.group(1), stated.group(2)) if stated else ("F", "F")
    use = Use(_user(user, frames), frames.tools.get(tool.lower(), unknown("user tool", tool)))
    held = np.full(len(axes.kinds), np.nan)
    for axis, k in joints.items():
        if axis in own:
            held[k] = axes.unit(k, DEGREE, MILLIMETRE) * own[axis].value
    turns = TURNS.search(group.group("own"))
    letters = LETTERS.search(text, *group.span("own"))
    branch = Branch(_turned(turns, axes), None, held, letters="".join(letters.groups()) if letters else "")
    numbers = tuple(own[part] for part in POSE)
    return Target(line, name, "pose", numbers, use.why, None, (), FANUC, known(use.base), known(use.tool), branch)


def _user(name: str, frames: KnownFrames) -> Frame:
    if name == "0":
        return np.eye(4)
    return frames.bases.get(name.lower(), unknown("user frame", name))


def _turned(stated: re.Match[str] | None, axes: Axes) -> Callable[[np.ndarray], bool]:
    """What CONFIG says of an arm of six axes: by how many whole turns axes 1, 4 and 6 are away from their middle."""
    if stated is None or len(axes.arm) != 6:
        return lambda q: True
    pairs = [(axes.arm[axis], int(n)) for axis, n in zip((0, 3, 5), stated.groups(), strict=True)]
    return lambda q: all(round(q[own] / math.tau) == turns for own, turns in pairs)
