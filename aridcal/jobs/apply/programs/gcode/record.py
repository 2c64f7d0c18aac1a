"""The moves of a program as they are found on the way, and the targets that come of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aridcal.jobs.apply.programs.gcode.blocks import Block
from aridcal.jobs.apply.programs.gcode.table import INCH
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.targets import PoseReference, Target
from aridcal.jobs.apply.programs.text import Numbers
from aridcal.jobs.apply.programs.uses import Frame, Ledger, Use

Key = tuple[int, int]
"""A block: its file and its line."""

AT_START: Key = (-1, 0)
"""In place of a block: where the axes are as it is stated, before the first one."""

ELSEWHERE: Key = (-2, 0)
"""Likewise, where nobody knows."""

MET = "the program comes here in several ways, in other units or with other axes left where they are"


@dataclass(frozen=True, slots=True)
class Move:
    """A block that sends axes somewhere.

    Attributes:
        block: As it stands.
        axes: Indices of the readings that it states.
        readings: The readings that it states, [m] or [rad]; empty where they are not known.
        units: As in :class:`Target`.
        held: Each other reading whose place is known, with the block that has stated it.
        base: Its work offset.
        tool: What the length of a tool adds.
        why: Why it cannot be corrected; empty if it can be.
    """

    block: Block
    axes: tuple[int, ...]
    readings: tuple[float, ...]
    units: tuple[tuple[float, int], ...]
    held: tuple[tuple[int, Key], ...]
    base: Frame
    tool: Frame
    why: str

    @property
    def key(self) -> Key:
        """Its place in the project."""
        return self.block.file, self.block.line

    def same(self, other: Move) -> bool:
        """Whether two ways through a block mean the same, for a controller and for us."""
        return (self.readings, self.units, self.held, self.why) == (other.readings, other.units, other.held, other.why)


@dataclass
class MoveRecord:
    """All moves of a project.

    Attributes:
        project: Whose blocks they are.
        columns: Readings of the robot.
    """

    project: Project
    columns: int
    _ledger: Ledger[Move] = field(default_factory=Ledger)
    _moves: dict[Key, Move] = field(default_factory=dict)
    _met: set[Key] = field(default_factory=set)
    _axes_used: dict[int, str] = field(default_factory=dict)

    def add(self, move: Move, line: str) -> None:
        """A move is made.

        Args:
            move: On one of the ways that lead to its block.
            line: How messages name it.
        """
        first = self._moves.setdefault(move.key, move)
        if first is move:
            self._ledger.declare(move.key, move)
        elif not first.same(move):
            self._met.add(move.key)
        self._ledger.go(move.key, Use(line, move.base, move.tool, why=move.why))

    def use(self, key: object, axis: int, why: str) -> None:
        """Something counts from the place that a block has sent an axis to, so that it must stay.

        Args:
            key: The block; anything else where it may be one of several.
            axis: Index of the reading.
            why: For the user.
        """
        if not isinstance(key, tuple):
            self._axes_used.setdefault(axis, why)
        elif key in self._moves and not self._moves[key].why:
            self._ledger.spoil(key, why)

    def targets(self, wild: str) -> list[Target]:
        """All targets, each left where what it leaves out was not stated by the block that went before it.

        Args:
            wild: Why none can be corrected; empty if some can.
        """
        last: dict[int, Key] = dict.fromkeys(range(self.columns), AT_START)
        return [self._settled(target, wild, last) for target in self._ledger.targets(self._target)]

    def _settled(self, target: Target, wild: str, last: dict[int, Key]) -> Target:
        move = self._moves.pop((target.file, target.line))
        user = next((self._axes_used[k] for k in move.axes if k in self._axes_used), "")
        stale = any(last[k] != source for k, source in move.held)
        why = target.why or wild or user or (MET if stale or move.key in self._met else "")
        is_certain = bool(move.readings) and move.key not in self._met
        for k in move.axes if is_certain else range(self.columns):
            last[k] = move.key if is_certain else ELSEWHERE
        if not why:
            return target
        if not is_certain:
            return replace(target, why=why, readings=None, units=())
        return replace(target, why=why, readings=self._readings(move), units=move.units)

    def _target(self, move: Move, use: Use, beside: Sequence[PoseReference]) -> Target:
        """The target of a block."""
        words = move.block.axes
        numbers = tuple(number for _, number in words if number is not None)
        source = self.project.sources[move.block.file]
        return Target(
            move.block.line,
            " ".join(f"{letter}{number.text if number is not None else ''}" for letter, number in words),
            "joints",
            Numbers(numbers if len(numbers) == len(words) else ()),
            "" if source.ours else f"stands in {source.path.name}, which is not corrected: give it, too",
            self._readings(move),
            move.units,
            digits=5 if any(unit == INCH for unit, _ in move.units) else 4,
            file=move.block.file,
        )

    def _readings(self, move: Move) -> np.ndarray:
        readings = np.full(self.columns, np.nan)
        if move.readings:
            readings[list(move.axes)] = move.readings
        return readings


def letters_of(axes: Sequence[int], letters: Mapping[str, int]) -> str:
    """Axes by their letters."""
    return " ".join(letter for letter, k in letters.items() if k in axes)
