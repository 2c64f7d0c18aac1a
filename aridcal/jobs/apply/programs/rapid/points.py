"""Robtargets and jointtargets of RAPID as targets of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aridcal.jobs.apply.programs.axes import DEGREE, MILLIMETRE
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.notations import ABB
from aridcal.jobs.apply.programs.postures import rapid_words
from aridcal.jobs.apply.programs.project import SourceFile
from aridcal.jobs.apply.programs.rapid.values import NOT_USED, Literal
from aridcal.jobs.apply.programs.targets import Branch, PoseReference, Target
from aridcal.jobs.apply.programs.text import NONE, Numbers
from aridcal.jobs.apply.programs.uses import Use


@dataclass(frozen=True)
class Targets:
    """Points as targets.

    Attributes:
        cell: The robot.
        sources: Files of the project.
    """

    cell: Cell
    sources: tuple[SourceFile, ...]

    @cached_property
    def _free(self) -> np.ndarray:
        """Readings of which none is held."""
        return np.full(len(self.cell.axes.kinds), np.nan)

    def rails(self, own: Literal) -> list[tuple[float, int]]:
        """External axes that a point states: their readings [rad] or [m], with the index of each."""
        axes = self.cell.axes
        if not axes.external:
            return []
        return [
            (axes.unit(k, DEGREE, MILLIMETRE) * n.value, k)
            for n, k in zip(own.external, axes.external, strict=False)
            if n.value < NOT_USED
        ]

    def target(self, own: Literal, use: Use, beside: tuple[PoseReference, ...]) -> Target:
        """The target of a point that a program uses.

        Args:
            own: It.
            use: How moves go there.
            beside: See :class:`aridcal.jobs.apply.programs.targets.Target`.
        """
        code, line = own.code, own.code.line(own.start)
        if own.why:
            return Target(line, own.name, own.form, NONE, own.why, file=code.file)
        if not self.sources[code.file].ours:
            why = f"stands in {code.name}, which is not corrected: give it, too"
            return Target(line, own.name, own.form, own.numbers, why, file=code.file)
        axes = self.cell.axes
        if own.form == "joints":
            numbers = own.numbers[: len(axes.arm)]
            rails = [(n, k) for n, k in zip(own.external, axes.external, strict=False) if n.value < NOT_USED]
            units = axes.units([*axes.arm, *(k for _, k in rails)], DEGREE, MILLIMETRE)
            stated = (*numbers, *(n for n, _ in rails))
            readings = axes.readings(stated, units)
            return Target(line, own.name, "joints", Numbers(stated), "", readings, units, digits=5, file=code.file)
        fixed = self._free
        for value, k in self.rails(own):
            fixed = fixed.copy()
            fixed[k] = value
        words = rapid_words(own.configuration, self.cell) if use.mode == "on" else None
        unknown = "" if words is not None else use.unknown
        branch = Branch(words, None, fixed, nearest=use.mode != "on", unknown=unknown)
        return Target(line, own.name, "pose", own.numbers, "", None, (), ABB, use.place, beside, branch, file=code.file)
