"""Values over a plane, as dots in a few colours, with one colour scale for all figures that are compared."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aridcal.pages.drawing.figures import EDGES, TICKS, WIDTH, drawn_or_missing, label_below, label_beside
from aridcal.pages.drawing.plot import (
    INK,
    LINE_HEIGHT,
    Area,
    LegendEntry,
    Scale,
    dots,
    frame,
    legend,
    path,
    rings,
    room_for,
    round_up,
    scale,
    text,
    tick_texts,
    whole,
)
from aridcal.system.wording import number

# Small to large: brightness falls all the way, so that it survives grey print and colour blindness.
LEVELS = ("#c9d3dc", "#8cc3e8", "#3f93c9", "#a3326b", "#3b1f5b")

MOST_VALUES = 95.0
"""Percentage of the values that lie below the last step of a colour scale, so that a few wild ones do not make all others one
colour."""

# Along the longer side of a field.
SQUARES_A_SIDE = 36

LEAST_HEIGHT, LARGEST_HEIGHT = 0.35, 1.1
"""Least and largest height of a plane's picture, in its widths."""


def color_steps(values: np.ndarray) -> np.ndarray:
    """Ends of the steps of a colour scale: equal round ones from zero on, the last up to the largest value.

    Noise, which is about as large everywhere, then has about one colour. Steps of equally many values would show it in all.

    Args:
        values: All that the scale is for, not negative: figures that are compared have one scale.

    Returns:
        As many as there are colours, and one more.
    """
    step = round_up(max(float(np.percentile(values, MOST_VALUES)), 1e-12) / len(LEVELS))
    steps = step * np.arange(len(LEVELS) + 1)
    steps[-1] = max(steps[-1], float(values.max()))
    return steps


@drawn_or_missing
def field(
    key: str,
    alt: str,
    points: np.ndarray,
    values: np.ndarray,
    labels: tuple[str, str],
    unit: str,
    steps: np.ndarray,
    hollow: np.ndarray | None = None,
    marks: Mapping[str, np.ndarray] | None = None,
) -> str:
    """RMS of a value over a plane: one dot for the rows of each small square, coloured by a scale that figures share.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        points: Shape (N, 2).
        values: Shape (N,), not negative.
        labels: Of the two axes, with their units.
        unit: Of the values.
        steps: Of the colours, from :func:`color_steps`.
        hollow: Of the rows, shape (N,) bool; a dot for which most of them are gets a hole.
        marks: Other points of the plane by their name, shape (M, 2), as rings above the dots.
    """
    side = max(float(np.ptp(points, axis=0).max()) / SQUARES_A_SIDE, 1e-9)
    # Each square by one number, column by column: pairs would have to be sorted, which of a million rows takes a second.
    across, up = (np.floor(points / side) - np.floor(points.min(axis=0) / side)).astype(int).T
    square = across * (int(up.max()) + 1) + up
    square = (np.cumsum(np.bincount(square) > 0) - 1)[square]
    count = np.bincount(square)
    x, y = (np.bincount(square, column) / count for column in points.T)
    rms = np.sqrt(np.bincount(square, values**2) / count)
    step = np.searchsorted(steps[1:-1], rms, side="right")
    area, made, height = _plane(
        np.concatenate([points, *(marks or {}).values()]), labels, unit, steps, tuple(marks or {})
    )
    for k, color in enumerate(LEVELS):
        made.append(dots(area, x[step == k], y[step == k], color, size=5.0, opacity=1.0))
    if hollow is not None:
        open_ = np.bincount(square, hollow) > 0.5 * count
        made.append(dots(area, x[open_], y[open_], "white", size=2.2, opacity=1.0))
    made += [rings(area, at[:, 0], at[:, 1], INK) for at in (marks or {}).values()]
    return whole(alt, WIDTH, height, made)


def _plane(
    points: np.ndarray, labels: tuple[str, str], unit: str, steps: np.ndarray, marks: tuple[str, ...]
) -> tuple[Area, list[str], float]:
    """An area of equal scale in both directions below a colour scale; what stands around it, and the figure's height."""
    (x, y), spans = (scale(points[:, k], 0.05) for k in (0, 1)), np.maximum(1.1 * np.ptp(points, axis=0), 1e-9)
    names, high = legend([LegendEntry(name, INK, "ring") for name in marks], 0.0, WIDTH)
    top = high + 2 * LINE_HEIGHT + 6
    left = 2 * LINE_HEIGHT + room_for(y, TICKS[1]) - 8
    width = WIDTH - left - EDGES[1]
    height = width * float(np.clip(spans[1] / spans[0], LEAST_HEIGHT, LARGEST_HEIGHT))
    unit_length = max(spans[0] / width, spans[1] / height)  # of values, for one of length
    middle = [0.5 * (end.low + end.high) for end in (x, y)]
    half = [0.5 * unit_length * length for length in (width, height)]
    area = Area(left, top, width, height, *(Scale(m - h, m + h) for m, h in zip(middle, half, strict=True)))
    made = [names, _color_scale(left, high, width, unit, steps), frame(area, TICKS), label_below(area, labels[0])]
    return area, [*made, label_beside(area, labels[1])], area.bottom + EDGES[0]


def _color_scale(left: float, top: float, width: float, unit: str, steps: np.ndarray) -> str:
    """Boxes of the colours, and between them where each begins."""
    each = (width - 30) / len(LEVELS)
    made = []
    for k, color in enumerate(LEVELS):
        made.append(path(f"M{left + k * each:.1f} {top + 4:.1f}h{each:.1f}v8h-{each:.1f}Z", fill=color))
    said = [*tick_texts(steps[:-1], float(steps[1])), number(float(steps[-1]), 2)]
    for k, value in enumerate(said):
        made.append(text(left + k * each, top + 23, value, "start" if k == 0 else "middle"))
    return "".join([*made, text(left + width, top + 12, unit, "end", INK)])
