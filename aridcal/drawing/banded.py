"""Curves with bands about them, as SVG."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from aridcal.drawing.figures import AFTER, BEFORE, GREY
from aridcal.drawing.html import tag
from aridcal.wording import number

COLOURS = (AFTER, BEFORE, "#009E73", "#CC79A7", GREY)
"""Okabe and Ito's, which everybody can tell apart; of more curves the first ones are drawn."""

WIDTH, HEIGHT = 310.0, 200.0
"""Of the picture, in units of its letters' ninth."""

LEFT, RIGHT, TOP, BOTTOM = 44.0, 302.0, 22.0, 164.0
"""Where the axes end."""

TICKS = 5
"""On an axis, about."""


def banded(
    alt: str, at: np.ndarray, values: Mapping[str, np.ndarray], labels: tuple[str, str], top: float | None
) -> Markup:
    """Some curves over one axis, each with the interval of its points.

    Args:
        alt: What the figure shows, for those who cannot see it.
        at: Shape (B,), B > 1.
        values: By name, shape (B, 3): value, lower and upper end of the interval; NaN where there is none.
        labels: Of the two axes, with their units.
        top: Of the vertical axis; None: what the values need.
    """
    highest = max((float(np.nanmax(v)) for v in values.values() if np.isfinite(v).any()), default=0.0)
    ends = (float(at.min()), float(at.max())), (0.0, top or 1.05 * highest or 1.0)
    x = LEFT + (RIGHT - LEFT) * (at - ends[0][0]) / (ends[0][1] - ends[0][0])
    parts = [*_axes(ends, labels)]
    place = LEFT
    for (name, v), colour in zip(values.items(), COLOURS, strict=False):
        y = BOTTOM - (BOTTOM - TOP) * np.clip(v, *ends[1]) / ends[1][1]
        there = np.isfinite(y).all(axis=1)
        around = [*zip(x[there], y[there, 1], strict=True), *zip(x[there][::-1], y[there, 2][::-1], strict=True)]
        parts.append(tag("polygon", points=_points(around), fill=colour, fill_opacity="0.18"))
        middle = [*zip(x[there], y[there, 0], strict=True)]
        parts.append(tag("polyline", points=_points(middle), fill="none", stroke=colour, stroke_width="1.8"))
        parts += [tag("circle", cx=f"{u:.1f}", cy=f"{w:.1f}", r="2.2", fill=colour) for u, w in middle]
        parts.append(tag("path", d=f"M{place:.0f} 9h12", stroke=colour, stroke_width="2.5"))
        parts.append(_text(place + 15.0, 12.0, name, "start"))
        place += 27.0 + 5.2 * len(name)
    size = {"viewBox": f"0 0 {WIDTH:.0f} {HEIGHT:.0f}", "aria-label": alt}
    return tag("svg", parts, class_="plot", role="img", font_size="10", **size)


def _axes(ends: tuple[tuple[float, float], tuple[float, float]], labels: tuple[str, str]) -> list[Markup]:
    """Lines with their numbers, and the names of both axes."""
    parts = []
    for value in _ticks(*ends[0]):
        u = LEFT + (RIGHT - LEFT) * (value - ends[0][0]) / (ends[0][1] - ends[0][0])
        parts.append(tag("path", d=f"M{u:.1f} {TOP}V{BOTTOM}", stroke="#e6e9ec"))
        parts.append(_text(u, BOTTOM + 12.0, _said(value), "middle"))
    for value in _ticks(*ends[1]):
        w = BOTTOM - (BOTTOM - TOP) * value / ends[1][1]
        parts.append(tag("path", d=f"M{LEFT} {w:.1f}H{RIGHT}", stroke="#e6e9ec"))
        parts.append(_text(LEFT - 4.0, w + 3.0, _said(value), "end"))
    parts.append(tag("path", d=f"M{LEFT} {TOP}V{BOTTOM}H{RIGHT}", fill="none", stroke="#aab2ba"))
    parts.append(_text((LEFT + RIGHT) / 2, HEIGHT - 10.0, labels[0], "middle"))
    middle = (TOP + BOTTOM) / 2
    parts.append(_text(10.0, middle, labels[1], "middle", f"rotate(-90 10 {middle:.1f})"))
    return parts


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between two ends."""
    rough = (high - low) / TICKS
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= rough))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [k * step for k in range(first, last + 1)]


def _said(value: float) -> str:
    """A number on an axis, without zeros that say nothing."""
    text = number(value, 4)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def _text(x: float, y: float, said: str, anchor: str, transform: str | None = None) -> Markup:
    return tag("text", said, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, fill="#333b44", transform=transform)


def _points(pairs: list[tuple[float, float]]) -> str:
    return " ".join(f"{u:.1f},{w:.1f}" for u, w in pairs)
