"""Points of a program as targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aridcal.jobs.apply.programs.axes import DEGREE, MILLIMETRE, Axes
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.krl.names import File
from aridcal.jobs.apply.programs.krl.syntax import AXES, EXTERNAL, POSE, Aggregate, Bits, Expression, Fields, Goal
from aridcal.jobs.apply.programs.notations import KUKA
from aridcal.jobs.apply.programs.postures import krl_words
from aridcal.jobs.apply.programs.targets import Branch, PoseReference, Target
from aridcal.jobs.apply.programs.text import NONE, Code, Number, Numbers
from aridcal.jobs.apply.programs.uses import Ledger, Use, line_name

MOST_USES = 40
"""Ways in which one point is used that are compared with each other: people use two or three."""

LONGEST = 60
"""Letters of a target's name."""


@dataclass
class Points:
    """Aggregates of the text that moves go to.

    Attributes:
        files: Of the project.
        cell: The robot.
        spoilt: Why the numbers at a place must stay.
        ledger: Where moves are written down.
    """

    files: tuple[File, ...]
    cell: Cell
    spoilt: dict[tuple[int, int], str]
    ledger: Ledger[tuple[str, Aggregate]]

    def __post_init__(self) -> None:
        self._jumps: set[tuple[int, int]] = set()
        self._declared: set[tuple[int, int]] = set()
        self._uses: dict[tuple[int, int], list[Use]] = {}

    @cached_property
    def _columns(self) -> dict[str, int]:
        """The reading of each axis that the robot has."""
        axes = self.cell.axes
        arm = dict(zip(AXES, axes.arm, strict=False))
        return arm | dict(zip(EXTERNAL, axes.external, strict=False))

    @cached_property
    def _axes(self) -> Axes:
        return self.cell.axes

    @cached_property
    def _free(self) -> np.ndarray:
        """Readings of which none is held."""
        return np.full(len(self._axes.kinds), np.nan)

    @cached_property
    def codes(self) -> tuple[Code, ...]:
        """The texts."""
        return tuple(file.code for file in self.files)

    def line(self, file: int, place: int) -> str:
        """How messages name a line."""
        return line_name(self.codes, self.codes[file], place)

    def declare(self, name: str, value: Aggregate) -> None:
        """A point stands in the text."""
        assert value.place is not None
        if value.place in self._declared:
            return
        self._declared.add(value.place)
        self.ledger.declare(value.place, (name, value))
        if value.place in self.spoilt:
            self.ledger.spoil(value.place, self.spoilt[value.place])

    def go(self, name: str, value: Aggregate, use: Use, jump: bool) -> None:
        """A move goes to a point, with a jump of all axes or along a path."""
        assert value.place is not None
        self.declare(name, value)
        if jump:
            self._jumps.add(value.place)
        uses = self._uses.setdefault(value.place, [])
        if len(uses) == MOST_USES:
            self.ledger.spoil(value.place, f"is used in more than {MOST_USES} ways, which are not compared")
        elif not any(
            use.same(other) and use.trouble == other.trouble and use.unknown == other.unknown for other in uses
        ):
            uses.append(use)
            self.ledger.go(value.place, use)

    def vague(self, goal: Goal, file: int, why: str) -> None:
        """A move goes to a place that no plain numbers say."""
        code = self.codes[file]
        shown = shown_text(code.text[goal.start : goal.end])
        self.ledger.leave(Target(code.line(goal.start), shown, "pose", NONE, why, file=file))

    def targets(self) -> list[Target]:
        """All targets, when the walk is over."""
        return self.ledger.targets(self._target)

    def _target(self, what: tuple[str, Aggregate], use: Use, beside: tuple[PoseReference, ...]) -> Target:
        name, value = what
        assert value.place is not None
        file, start = value.place
        line = self.codes[file].line(start)
        why = value.why
        if not why and not self.files[file].ours:
            why = f"stands in {self.files[file].code.name}, which is not corrected: give it, too"
        axes, own = self._axes, self._columns
        stated, numbers = _numbers(value.fields)
        if value.jointed:
            columns = [axis for axis in own if axis in stated]
            turned = tuple(stated[axis] for axis in columns)
            units = axes.units([own[axis] for axis in columns], DEGREE, MILLIMETRE)
            readings = axes.readings(turned, units)
            why = why or ("" if turned else "states no axis that this robot has")
            return Target(line, name, "joints", Numbers(turned), why, readings, units, digits=5, file=file)
        fixed = self._free.copy() if axes.external else self._free
        for axis, column in zip(EXTERNAL, axes.external, strict=False):
            if axis in stated:
                fixed[column] = axes.unit(column, DEGREE, MILLIMETRE) * stated[axis].value
        words = None
        if not why and value.place in self._jumps and use.mode != "shifted":  # else S and T are not asked for
            words = krl_words(stated.get("s"), stated.get("t"), self.cell)
        branch = Branch(words, None, fixed, nearest=words is None or not value.states_posture, unknown=use.unknown)
        return Target(
            line,
            name,
            "pose",
            numbers,
            why,
            notation=KUKA,
            place=use.place,
            beside=beside,
            branch=branch,
            file=file,
        )


def _numbers(fields: Mapping[str, Expression]) -> tuple[Mapping[str, Number], Numbers]:
    """Fields that are numbers by name, and those of a pose in their order."""
    if isinstance(fields, Fields) and fields.names == POSE:  # of most lines of a long program
        return fields, fields.numbers
    every = zip(fields.names, fields.numbers, strict=True) if isinstance(fields, Fields) else fields.items()
    stated = {name: value for name, value in every if isinstance(value, Number)}
    posture = {name: value.written for name in ("s", "t") if isinstance(value := fields.get(name), Bits)}
    return stated | posture, Numbers(stated[part] for part in POSE if part in stated)


def shown_text(text: str) -> str:
    """A target as it stands in the text, in one line."""
    shown = " ".join(text.split())
    return shown if len(shown) <= LONGEST else shown[: LONGEST - 1] + "…"
