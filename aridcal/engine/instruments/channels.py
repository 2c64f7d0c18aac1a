"""What a row measures, as data: channels, each with a name, a unit and so many numbers a row.

A residual has one column for each number, channel after channel: three of the position [m], then three of the rotation
[rad] for poses. Noise belongs to a channel: one sigma for all its numbers. Nothing beyond this module knows which
channels there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np


@dataclass(frozen=True)
class Channel:
    """One kind of number that is measured.

    Attributes:
        name: ``position``, for instance.
        unit: Of the numbers inside, SI.
        axes: Names of the numbers that a row has of it, in files and figures.
        shown: Unit in which people read it.
        scale: Of those in one of ``unit``.
        noun: What a residual of it is called, ``position error`` for instance.
        inner: True of what rows say by themselves, whatever the arm does: it judges the instrument, not the arm.
    """

    name: str
    unit: str
    axes: tuple[str, ...]
    shown: str
    scale: float
    noun: str
    inner: bool = False

    @property
    def size(self) -> int:
        """Numbers that a row has of it."""
        return len(self.axes)

    @property
    def title(self) -> str:
        """What a residual of it is called, with the unit that is shown."""
        return f"{self.noun} [{self.shown}]"

    @property
    def key(self) -> str:
        """Name with the unit that is shown, ``position_mm``."""
        return f"{self.name}_{self.shown}"


# Of the target, in world axes.
TARGET_POSITION = Channel("position", "m", ("x", "y", "z"), "mm", 1e3, "position error")

# Of the target, as a rotation vector in world axes.
TARGET_ROTATION = Channel("rotation", "rad", ("rx", "ry", "rz"), "mrad", 1e3, "rotation error")

# Of a length that an instrument reads: a wire, a ballbar, a gauge.
LENGTH = Channel("distance", "m", ("l",), "mm", 1e3, "distance error")

# Of a mark in an image.
PIXEL = Channel("pixel", "px", ("u", "v"), "px", 1.0, "pixel error")

# Of the direction of gravity in a sensor's frame, across it.
INCLINATION = Channel("inclination", "rad", ("g1", "g2"), "mrad", 1e3, "inclination error")

Channels = tuple[Channel, ...]


def columns(channels: Sequence[Channel]) -> tuple[slice, ...]:
    """Columns of each channel in a row's residual."""
    ends = accumulate((channel.size for channel in channels), initial=0)
    return tuple(slice(low, high) for low, high in pairwise(ends))


def spread(values: np.ndarray, channels: Sequence[Channel]) -> np.ndarray:
    """One value for each number of a row, shape (m,), from one for each channel, shape (C,)."""
    return np.repeat(values, [channel.size for channel in channels])


def norms(residual: np.ndarray, channels: Sequence[Channel]) -> np.ndarray:
    """Length of each row's residual in each channel, shape (C, N), from residuals of shape (N, m)."""
    return np.array([np.linalg.norm(residual[:, part], axis=1) for part in columns(channels)])


def flat(values: np.ndarray, channels: Channels, present: np.ndarray) -> tuple[np.ndarray, ...]:
    """Columns (n, m, d) or residuals (n, m) by channel, one number under the other: (n size, d) or (n size,) each.

    Args:
        values: Of n rows.
        channels: C of them.
        present: Which rows have numbers of each, shape (n, C) bool: the others are left out.
    """
    _, _, *tail = values.shape
    parts = []
    for channel, part, present_rows in zip(channels, columns(channels), present.T, strict=True):
        rows = values[:, part] if present_rows.all() else values[present_rows][:, part]
        parts.append(rows.reshape(len(rows) * channel.size, *tail))
    return tuple(parts)


def by_row(parts: Sequence[np.ndarray], channels: Channels, present: np.ndarray) -> np.ndarray:
    """The inverse of :func:`flat`: numbers row by row, shape (n, m, d) or (n, m); 0 where a row has none."""
    _, *tail = parts[0].shape
    rows = np.zeros((len(present), sum(channel.size for channel in channels), *tail))
    for values, channel, part, present_rows in zip(parts, channels, columns(channels), present.T, strict=True):
        rows[present_rows, part] = values.reshape(-1, channel.size, *tail)
    return rows
