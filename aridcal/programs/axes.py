"""Axes of a program and joints of a robot: which is which, and in which unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.errors import AridcalError
from aridcal.programs.targets import Number

MOST = 6
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
    """

    kinds: tuple[str, ...]
    arm: tuple[int, ...]
    external: tuple[int, ...] = ()

    def unit(self, reading: int, angle: float, length: float) -> float:
        """What a unit of a reading is, [rad] or [m]."""
        return length if self.kinds[reading] == "prismatic" else angle

    def units(self, readings: Sequence[int], angle: float, length: float) -> tuple[tuple[float, int], ...]:
        """What a unit of each is, and its index."""
        return tuple((self.unit(k, angle, length), k) for k in readings)

    def readings(self, numbers: Sequence[Number], units: Sequence[tuple[float, int]]) -> np.ndarray:
        """Readings from numbers, shape (columns,), [rad] or [m]; NaN where there is no number."""
        found = np.full(len(self.kinds), np.nan)
        for n, (unit, k) in zip(numbers, units, strict=True):
            found[k] = unit * n.value
        return found


def axes_of(kinds: Sequence[str]) -> Axes:
    """The axes of a robot: all its readings in their order, or a rail besides as the external axis.

    Args:
        kinds: Of the readings.

    Raises:
        AridcalError: the robot has more axes than a program can name.
    """
    every = tuple(range(len(kinds)))
    if len(kinds) <= MOST:
        return Axes(tuple(kinds), every)
    rails = tuple(k for k in every if kinds[k] == "prismatic")
    arm = tuple(k for k in every if k not in rails)
    if len(arm) > MOST:
        raise AridcalError(
            f"the robot has {len(arm)} turning joints: programs have {MOST}; give a table of poses to `aridcal compensate`"
        )
    return Axes(tuple(kinds), arm, rails)
