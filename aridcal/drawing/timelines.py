"""Values over time as inline SVG written directly: a page shows hundreds of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from aridcal.drawing.figures import AFTER, BEFORE, GREY
from aridcal.drawing.html import tag
from aridcal.wording import number

WIDTH, HEIGHT = 340.0, 180.0
LEFT, RIGHT, TOP, BOTTOM = 64.0, 12.0, 10.0, 26.0
"""Of a figure and of its margins, in units of the SVG: as wide as the other figures of a report."""

SPARK_WIDTH, SPARK_HEIGHT = 120.0, 24.0
"""Of a line in a cell of a table."""

MOST_TICKS = 5
"""Months that are named below a figure."""


@dataclass(frozen=True)
class Band:
    """A stretch of time that is marked.

    Attributes:
        low: Its first day since 1970.
        high: Its last.
        words: What it is.
    """

    low: float
    high: float
    words: str


def sparkline(values: np.ndarray, alt: str) -> Markup:
    """A line through values (n,), their last one a dot; NaN are left out."""
    there = np.flatnonzero(np.isfinite(values))
    if not len(there):
        return tag("span", "–")
    low, high = float(values[there].min()), float(values[there].max())
    x = 4.0 + (SPARK_WIDTH - 8.0) * there / max(len(values) - 1, 1)
    y = SPARK_HEIGHT - 4.0 - (SPARK_HEIGHT - 8.0) * (values[there] - low) / ((high - low) or 1.0)
    return tag(
        "svg",
        tag("polyline", points=_points(x, y), fill="none", stroke=AFTER, stroke_width="1.5"),
        tag("circle", cx=f"{x[-1]:.1f}", cy=f"{y[-1]:.1f}", r="2.5", fill=AFTER),
        viewBox=f"0 0 {SPARK_WIDTH:g} {SPARK_HEIGHT:g}",
        width=f"{SPARK_WIDTH:g}",
        height=f"{SPARK_HEIGHT:g}",
        role="img",
        aria_label=alt,
    )


def timeline(
    day: np.ndarray,
    value: np.ndarray,
    std: np.ndarray,
    label: str,
    alt: str,
    bands: Sequence[Band] = (),
) -> Markup:
    """Values with bars of two sigma over time.

    Args:
        day: Days since 1970, shape (n,).
        value: Shape (n,).
        std: Shape (n,).
        label: Of the values, with their unit.
        alt: What the figure shows, for those who cannot see it.
        bands: Stretches of time that are marked.
    """
    first, last = float(day.min()), float(day.max())
    low, high = float((value - 2 * std).min()), float((value + 2 * std).max())
    room = 0.05 * (high - low) or 1.0
    low, high, span = low - room, high + room, max(last - first, 1.0)

    def across(days: np.ndarray) -> np.ndarray:
        return LEFT + (WIDTH - LEFT - RIGHT) * (0.02 + 0.96 * (days - first) / span)

    def up(values: np.ndarray) -> np.ndarray:
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (values - low) / (high - low)

    parts: list[Markup] = []
    for band in bands:
        a, b = across(np.array([max(band.low, first), min(band.high, last)]))
        parts.append(
            tag(
                "rect",
                tag("title", band.words),
                x=f"{a:.1f}",
                y=f"{TOP:g}",
                width=f"{max(b - a, 2.0):.1f}",
                height=f"{HEIGHT - TOP - BOTTOM:g}",
                fill=BEFORE,
                opacity="0.22",
            )
        )
    for tick in _ticks(low, high):
        height = float(up(np.array([tick]))[0])
        parts.append(_line(LEFT, height, WIDTH - RIGHT, height, "#e6e9ec"))
        parts.append(_text(LEFT - 5.0, height + 3.0, number(tick, 3), "end"))
    for at, words in _months(first, last):
        parts.append(_text(float(across(np.array([at]))[0]), HEIGHT - 9.0, words, "middle"))
    x, y, bar = across(day), up(value), up(value - 2 * std)
    bars = [_line(a, b, a, 2 * c - b, AFTER) for a, b, c in zip(x, bar, y, strict=True)]
    dots = [tag("circle", cx=f"{a:.1f}", cy=f"{b:.1f}", r="3", fill=AFTER) for a, b in zip(x, y, strict=True)]
    line = tag("polyline", points=_points(x, y), fill="none", stroke=AFTER, stroke_width="1", opacity="0.5")
    middle = (HEIGHT - BOTTOM + TOP) / 2
    side = tag(
        "text",
        label,
        x="0",
        y="0",
        transform=f"translate(12 {middle:g}) rotate(-90)",
        text_anchor="middle",
        font_size="11",
        fill="#333b44",
    )
    view = f"0 0 {WIDTH:g} {HEIGHT:g}"
    return tag("svg", parts, line, bars, dots, side, class_="plot", viewBox=view, role="img", aria_label=alt)


def _points(x: np.ndarray, y: np.ndarray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


def _line(x1: float, y1: float, x2: float, y2: float, color: str) -> Markup:
    return tag("line", x1=f"{x1:.1f}", y1=f"{y1:.1f}", x2=f"{x2:.1f}", y2=f"{y2:.1f}", stroke=color, stroke_width="1.2")


def _text(x: float, y: float, words: str, anchor: str) -> Markup:
    return tag("text", words, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, font_size="10", fill=GREY)


def _ticks(low: float, high: float) -> list[float]:
    """Round values from low to high, five at the most."""
    raw = (high - low) / 4.0
    unit = 10.0 ** np.floor(np.log10(raw))
    step = unit * next(s for s in (1.0, 2.0, 5.0, 10.0) if s * unit >= raw)
    count = np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    return [float(step * k) for k in count]


def _months(first: float, last: float) -> list[tuple[float, str]]:
    """Beginnings of months inside a stretch, with their names; the ends where there are none."""
    start, end = (np.datetime64(round(day * 86400), "s").astype("datetime64[M]") for day in (first, last))
    months = np.arange(start, end + np.timedelta64(1, "M"))
    days = months.astype("datetime64[s]").astype(float) / 86400.0
    inside = [(float(d), str(m)) for d, m in zip(days, months, strict=True) if first <= d <= last]
    if not inside:
        return [(day, str(np.datetime64(round(day), "D"))) for day in dict.fromkeys((first, last))]
    return inside[:: -(-len(inside) // MOST_TICKS)]
