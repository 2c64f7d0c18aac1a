"""What a calibration has seen of a quantity: its range, and the holes in it."""

from __future__ import annotations

import numpy as np

SAME = 2e-3
"""Share of its range by which values of a quantity may differ and still be one: noise of a reading that is set to levels."""

NEIGHBOURS = 10
"""Steps on either side with which a step from one value to the next is compared: enough for their mean to within a quarter,
and few enough that rows may thin out towards the ends of a range."""

FEWEST = 8
"""Steps on both sides together without which nothing is called a hole: a few levels of a payload have none."""

WIDE = 8.0
"""Mean neighbouring steps that make a hole: of 50 rows drawn evenly one held-out row in 400 falls into such a step, so that six
joints together flag 2 % of them without a reason."""

EDGE = 0.5
"""Mean neighbouring steps beside the last value before a hole that still count as seen."""

SPREAD = 3.0
"""Times the largest standard deviation of a prediction at the fitted rows, beyond which a prediction extrapolates. Between rows
that surround it no function that they fix is that uncertain."""

CHANNELS = (slice(0, 3), slice(3, 6))
"""Position and rotation in the six numbers of a pose."""

Ranges = tuple[tuple[float, float], ...]


def holes(values: np.ndarray) -> Ranges:
    """Where nothing was seen inside a range: steps between neighbouring values far wider than those around them.

    The steps around are the measure, not a width in radians: it then fits any quantity, dense or sparse rows, and rows that
    thin out towards the ends.

    Args:
        values: Of one quantity, shape (N,).

    Returns:
        Lowest and highest value of each hole, its edges left out, in rising order.
    """
    values = np.sort(values)
    apart = np.flatnonzero(np.diff(values) > SAME * (values[-1] - values[0]))
    low, high = values[apart], values[apart + 1]
    steps = high - low
    found = []
    for k, step in enumerate(steps):
        around = np.concatenate([steps[max(k - NEIGHBOURS, 0) : k], steps[k + 1 : k + 1 + NEIGHBOURS]])
        if len(around) >= FEWEST and step > WIDE * (usual := float(around.mean())):
            found.append((float(low[k] + EDGE * usual), float(high[k] - EDGE * usual)))
    return tuple(found)


def largest(std: np.ndarray) -> tuple[float, float]:
    """Largest standard deviation of position and rotation, all three axes together, of poses known to (N, 6)."""
    position, rotation = (float(np.linalg.norm(std[:, axes], axis=1).max()) for axes in CHANNELS)
    return position, rotation


def inside(values: np.ndarray, ranges: Ranges) -> np.ndarray:
    """True where a value, shape (N,), lies strictly inside one of some ranges."""
    within = [(values > low) & (values < high) for low, high in ranges]
    return np.any(within, axis=0) if within else np.zeros(len(values), dtype=bool)
