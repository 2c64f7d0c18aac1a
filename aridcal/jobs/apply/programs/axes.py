"""Axes of a program and joints of a robot: which is which, and in which unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aridcal.jobs.apply.programs.text import Number
from aridcal.system.errors import AridcalError

MOST_AXES = 6
"""Axes of an arm in all these languages; what is more is an external axis."""

DEGREE = math.pi / 180.0
MILLIMETRE = 1e-3


@dataclass(frozen=True)
class Axes:
    """A robot's readings as a program counts its axes.

    Attributes:
        kinds: Of the readings.
        arm: Index of the reading of each axis of the arm, at most six.
        external: Likewise of each external axis.
        zeros: What the controller shows, in its units, of each axis of the arm where the reading is zero; empty: zero.
    """

    kinds: tuple[str, ...]
    arm: tuple[int, ...]
    external: tuple[int, ...] = ()
    zeros: tuple[float, ...] = ()

    @cached_property
    def shifts(self) -> tuple[float, ...]:
        """What the controller shows of each axis of the arm where its reading is zero, [rad] or [m]."""
        return tuple(self.unit(k, DEGREE, MILLIMETRE) * self.zero(k) for k in self.arm)

    def unit(self, reading: int, angle: float, length: float) -> float:
        """What a unit of a reading is, [rad] or [m]."""
        return length if self.kinds[reading] == "prismatic" else angle

    def units(self, readings: Sequence[int], angle: float, length: float) -> tuple[tuple[float, int], ...]:
        """What a unit of each is, and its index."""
        return tuple((self.unit(k, angle, length), k) for k in readings)

    def readings(self, numbers: Sequence[Number], units: Sequence[tuple[float, int]]) -> np.ndarray:
        """Readings from numbers, shape (columns,), [rad] or [m]; NaN where there is no number."""
        readings = np.full(len(self.kinds), np.nan)
        for n, (unit, k) in zip(numbers, units, strict=True):
            readings[k] = unit * (n.value - self.zero(k))
        return readings

    def zero(self, reading: int) -> float:
        """What the controller shows of an axis where its reading is zero, in its units."""
        return self.zeros[self.arm.index(reading)] if self.zeros and reading in self.arm else 0.0


def axes_of(kinds: Sequence[str], zeros: Sequence[float] = ()) -> Axes:
    """The axes of a robot: all its readings in their order, or a rail besides as the external axis.

    Args:
        kinds: Of the readings.
        zeros: See :class:`Axes`.

    Raises:
        AridcalError: the robot has more axes than a program can name.
    """
    every = tuple(range(len(kinds)))
    if len(kinds) <= MOST_AXES:
        return Axes(tuple(kinds), every, (), tuple(zeros))
    rails = tuple(k for k in every if kinds[k] == "prismatic")
    arm = tuple(k for k in every if k not in rails)
    if len(arm) > MOST_AXES:
        raise AridcalError(
            f"the robot has {len(arm)} turning joints: programs have {MOST_AXES}; give a table of poses to `aridcal compensate`"
        )
    return Axes(tuple(kinds), arm, rails, tuple(zeros))
