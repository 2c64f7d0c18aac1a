"""Planned moves, to be written in a language of programs: exact stops, and points on the way that are passed through."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from aridcal import __version__
from aridcal.system.errors import printable, shortened

ARM_AXES = 6
"""Axes of an arm in KRL and RAPID, and as many external ones; joints of a UR."""


@dataclass(frozen=True)
class Stop:
    """One place of a program.

    Attributes:
        readings: Of the joints, shape (columns,), [rad] or [m].
        number: Of the configuration that is measured here, from 1; 0 for a point on the way.
        label: What is measured there.
    """

    readings: np.ndarray
    number: int
    label: str

    @property
    def remark(self) -> str:
        """What is measured, for a comment."""
        return f"configuration {self.number}{f', {plain_word(self.label)}' if self.label else ''}"


@dataclass(frozen=True)
class Moves:
    """What a program does.

    Attributes:
        title: Of the campaign, for a comment.
        names: Of the joints' readings.
        kinds: Of the joints.
        stops: In their order.
        settle: What it waits at each configuration, [s].
        more: Further notes for whoever runs it, a line each.
    """

    title: str
    names: tuple[str, ...]
    kinds: tuple[str, ...]
    stops: tuple[Stop, ...]
    settle: float
    more: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What whoever runs it should know, for comments."""
        count = sum(stop.number > 0 for stop in self.stops)
        return (
            f"{count} configurations to measure, planned by aridcal {__version__} for {plain_word(self.title)}",
            f"joints in this order: {', '.join(plain_word(name) for name in self.names)}",
            f"stops {self.settle:g} s at each configuration; points on the way only decide from which side joints come",
            *self.more,
            "the ways between were NOT looked at: run it slowly, with a hand on the stop button",
        )

    def axes(self) -> list[str]:
        """Axes of a controller for each joint: revolute ones are the arm's, prismatic ones are external."""
        arm, outside = (iter([f"{letter}{k}" for k in range(1, ARM_AXES + 1)]) for letter in ("A", "E"))
        return [next(outside) if kind == "prismatic" else next(arm) for kind in self.kinds]

    def shown(self, stop: Stop) -> list[float]:
        """Readings in degrees and millimetres."""
        return [
            1e3 * value if kind == "prismatic" else math.degrees(value)
            for kind, value in zip(self.kinds, stop.readings.tolist(), strict=True)
        ]


def plain_word(text: str) -> str:
    """A name that stays inside a comment of one line, in letters that every controller reads."""
    return shortened(printable(text)).encode("ascii", "replace").decode()
