"""Values over time, as inline SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from aridcal.pages.drawing.figures import AFTER, BEFORE, HEIGHT, WIDTH, axes, drawn_or_missing
from aridcal.pages.drawing.html import tag
from aridcal.pages.drawing.plot import Area, Scale, band, bars, dots, line, scale, titled, whole

TIME_MARGIN = 0.02
"""Share of the time beside the first and the last value."""

SPARK_WIDTH, SPARK_HEIGHT = 120.0, 24.0
"""Width and height of a line in a cell of a table, in units of its `viewBox`."""

MOST_MONTHS = 5
"""Most months that are named below a figure."""

LEAST_MARKED = 2.0
"""How wide a stretch of time is drawn at the least."""


@dataclass(frozen=True)
class TimeStretch:
    """A stretch of time that is marked.

    Attributes:
        low: Its first day since 1970.
        high: Its last.
        words: What it is.
    """

    low: float
    high: float
    words: str


class Days(Scale):
    """Days since 1970; ticks are the beginnings of months, or the days at both ends where there are none."""

    def ticks(self, most: int) -> tuple[np.ndarray, list[str]]:
        """At most so many days, and their names."""
        ends = np.array([self.low, self.high])
        first, last = (ends * 86400).astype("datetime64[s]").astype("datetime64[M]")
        months = np.arange(first, last + 1)
        days = months.astype("datetime64[s]").astype(float) / 86400
        inside = (days >= self.low) & (days <= self.high)
        if not inside.any():
            days = np.unique(np.round(ends + TIME_MARGIN * np.ptp(ends) * np.array([1, -1])))
            return days, [str(day) for day in days.astype(int).astype("datetime64[D]")]
        each = -(-int(inside.sum()) // min(most, MOST_MONTHS))
        return days[inside][::each], [str(month) for month in months[inside][::each]]


def sparkline(values: np.ndarray, alt: str) -> Markup:
    """A line through values (n,), their last one a dot; NaN are left out."""
    there = np.flatnonzero(np.isfinite(values))
    if not len(there):
        return tag("span", "–")
    x, y = Scale(0.0, float(max(len(values) - 1, 1))), scale(values[there])
    area = Area(4.0, 4.0, SPARK_WIDTH - 8.0, SPARK_HEIGHT - 8.0, x, y)
    parts = [line(area, there, values[there], AFTER, 1.5), dots(area, there[-1:], values[there[-1:]], AFTER, 5.0, 1.0)]
    return Markup(whole(alt, SPARK_WIDTH, SPARK_HEIGHT, parts, "spark"))


@drawn_or_missing
def timeline(
    key: str,
    alt: str,
    day: np.ndarray,
    value: np.ndarray,
    std: np.ndarray,
    label: str,
    stretches: Sequence[TimeStretch] = (),
) -> str:
    """Values with bars of two sigma over time.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        day: Days since 1970, shape (n,).
        value: Shape (n,).
        std: Shape (n,).
        label: Of the values, with their unit.
        stretches: Of time, that are marked.
    """
    first, last = float(day.min()), float(day.max())
    room = TIME_MARGIN * max(last - first, 1.0)
    low, high = value - 2 * std, value + 2 * std
    area, made = axes(("time", label), Days(first - room, last + room), scale(np.r_[low, high], 0.05))
    least = LEAST_MARKED * (area.x.high - area.x.low) / area.width
    for marked in stretches:
        begin = max(marked.low, first)
        ends = np.array([begin, max(min(marked.high, last), begin + least)])
        box = band(area, ends, np.full(2, area.y.low), np.full(2, area.y.high), BEFORE, 0.22)
        made.append(titled(marked.words, box))
    made += [line(area, day, value, AFTER, 0.6), bars(area, day, low, high, AFTER, 1.2)]
    made.append(dots(area, day, value, AFTER, 6.0, 1.0))
    return whole(alt, WIDTH, HEIGHT, made)
