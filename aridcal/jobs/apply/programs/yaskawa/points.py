"""Positions of //POS as targets of a robot."""

from __future__ import annotations

import numpy as np

from aridcal.jobs.apply.programs.axes import DEGREE
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.notations import YASKAWA
from aridcal.jobs.apply.programs.postures import rconf_sides
from aridcal.jobs.apply.programs.targets import Branch, PoseReference, Shared, Target
from aridcal.jobs.apply.programs.text import Code
from aridcal.jobs.apply.programs.uses import Use
from aridcal.jobs.apply.programs.yaskawa.listing import AXES, Position

PULSES = (
    "is in pulses, and no file of a job says how many of them a degree has: export poses, or state `pulses_per_degree` of S L U "
    "R B T in --frames"
)

OTHER_ARM = "is of an arm of six turning axes, and the robot of the calibration is none"


class Targets:
    """Positions as targets.

    Args:
        cell: The robot.
    """

    def __init__(self, cell: Cell) -> None:
        self._cell, self._axes = cell, cell.axes
        turning = all(self._axes.kinds[k] != "prismatic" for k in self._axes.arm)
        self._six = len(self._axes.arm) == AXES and turning and not self._axes.external
        self._pulses = cell.frames.pulses_per_degree

    def beyond(self, position: Position) -> str:
        """Why a position does not fit the robot."""
        if not self._six:
            return OTHER_ARM
        return PULSES if position.pulses and not self._pulses else ""

    def target(self, code: Code, position: Position, use: Use, beside: tuple[PoseReference, ...]) -> Target:
        """The target of a position that a job uses.

        Args:
            code: The job's file.
            position: It.
            use: How moves go there.
            beside: See :class:`aridcal.jobs.apply.programs.targets.Target`.
        """
        line = code.line(position.start)
        if position.pulses:
            return self._turned(line, code, position)
        shown = ",".join(map(str, position.posture)) or "0"
        shared = Shared(f"RCONF {shown}", rconf_sides(self._cell))
        branch = Branch(unknown=use.unknown, shared=shared)
        place = None if position.why else use.place
        return Target(
            line, position.name, "pose", position.numbers, "", None, (), YASKAWA, place, beside, branch, file=code.file
        )

    def _turned(self, line: int, code: Code, position: Position) -> Target:
        """The target of a position in pulses."""
        if position.why or not self._pulses or not self._six:
            return Target(line, position.name, "joints", file=code.file)
        readings = np.full(len(self._axes.kinds), np.nan)
        units = []
        for n, pulses, k in zip(position.numbers, self._pulses, self._axes.arm, strict=True):
            readings[k] = DEGREE * (n.value / pulses - self._axes.zero(k))
            units.append((DEGREE / pulses, k))
        return Target(
            line, position.name, "joints", position.numbers, "", readings, tuple(units), digits=0, file=code.file
        )
