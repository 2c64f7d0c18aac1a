"""Figures as inline SVG: small, with units on their axes, in colours that everybody can tell apart."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ParamSpec

import numpy as np
from markupsafe import Markup

from aridcal.pages.drawing.html import attempt, missing
from aridcal.pages.drawing.plot import (
    EDGE,
    GREY,
    INK,
    LINE_HEIGHT,
    Area,
    LegendEntry,
    Scale,
    band,
    bars,
    clipped,
    dots,
    frame,
    legend,
    level,
    line,
    path,
    room_for,
    scale,
    stairs,
    text,
    text_width,
    whole,
)

P = ParamSpec("P")

BEFORE, AFTER = "#D55E00", "#0072B2"  # Okabe and Ito's

COLOURS = (AFTER, BEFORE, "#009E73", "#CC79A7", GREY)
"""Colours of several curves in one figure, in their order; of more curves the first ones are drawn."""

# At most so many points are drawn in one cloud.
MOST_CLOUD_POINTS = 500

# Of a figure, in 1/72 inch: it is legible on a phone, and three stand side by side on a desk.
WIDTH, WIDE, HEIGHT = 310.0, 634.0, 195.0

TICKS = (6, 6)
"""Most ticks along x and y."""

EDGES = (34.0, 8.0)
"""Room below an area, for ticks and their label, and at its right."""


def drawn_or_missing(draw: Callable[P, str]) -> Callable[P, Markup]:
    """Turn a function that draws into one that returns a line in its place if it fails.

    Its first two arguments are ``key`` and ``alt``.
    """

    @functools.wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Markup:
        return attempt(f"report.html: the figure {str(args[0])!r}", lambda: Markup(draw(*args, **kwargs)), missing)

    return drawn


@drawn_or_missing
def histogram(key: str, alt: str, values: Mapping[str, np.ndarray], label: str) -> str:
    """Two distributions on one axis.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        values: Two arrays by name, none negative; what lies far outside is counted in the last bin.
        label: Of the horizontal axis, with its unit.
    """
    top = max(float(np.percentile(v, 99.5)) for v in values.values())
    edges = np.linspace(0.0, max(1.03 * top, 1e-9), 41)
    shares = [100.0 * np.histogram(np.minimum(v, edges[-1]), edges)[0] / len(v) for v in values.values()]
    y = Scale(0.0, 1.05 * max(float(share.max()) for share in shares))
    colors = (BEFORE, AFTER)
    names = [LegendEntry(name, color, "box") for name, color in zip(values, colors, strict=False)]
    area, made = axes((label, "rows [%]"), Scale(0.0, float(edges[-1])), y, names)
    for share, color, filled in zip(shares, colors, (0.15, 0.45), strict=False):
        made.append(stairs(area, edges, share, 0.0, color, filled, 1.4))
    return whole(alt, WIDTH, HEIGHT, made)


@drawn_or_missing
def coverage(key: str, alt: str, names: Sequence[str], shares: Sequence[np.ndarray], ranges: Sequence[str]) -> str:
    """Where within its limits each joint was measured: one histogram per joint, on a line of its own.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        names: Of the joints, base first.
        shares: Readings of each as a share of the joint's range: 0 at its lower limit, 1 at its upper one.
        ranges: The two limits in words.
    """
    count, each = len(names), 30.0
    left = min(6 + max((text_width(said) for said in (*map(_short, names), *ranges)), default=0.0), 0.45 * WIDTH)
    area = Area(left, 6.0, WIDTH - left - EDGES[1], each * count, Scale(0.0, 100.0), Scale(0.0, max(count, 1)))
    across = area.x.ticks(TICKS[0])
    grid = "".join(f"M{u:.1f} {area.top:.1f}V{area.bottom:.1f}" for u in area.across(across[0]))
    made = [path(grid, stroke=EDGE, stroke_width=0.4), label_below(area, "share of the joint's range [%]")]
    made += [
        text(float(u), area.bottom + 12, said, "middle")
        for u, said in zip(area.across(across[0]), across[1], strict=True)
    ]
    edges = np.linspace(0.0, 1.0, 37)
    for k, (name, share, limits) in enumerate(zip(names, shares, ranges, strict=True)):
        bins = np.histogram(np.clip(share, 0.0, 1.0), edges)[0]
        foot = float(count - 1 - k)
        made.append(stairs(area, 100 * edges, foot + 0.8 * bins / max(bins.max(), 1), foot, AFTER, 0.55, 0.0))
        made.append(level(area, foot, EDGE))
        middle = area.top + each * (k + 0.5) - 2
        made.append(text(left - 6, middle, _short(name), "end", INK) + text(left - 6, middle + 12, limits, "end"))
    return whole(alt, WIDTH, area.bottom + EDGES[0], made)


@dataclass(frozen=True)
class Trend:
    """What a cloud of points follows: means of slices with their noise, and a smooth curve; shapes (B,) and (G,)."""

    centre: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    at: np.ndarray
    smooth: np.ndarray


@drawn_or_missing
def panels(
    key: str,
    alt: str,
    x: np.ndarray,
    values: Mapping[str, np.ndarray],
    labels: tuple[str, str],
    trends: Mapping[str, Trend] | None = None,
) -> str:
    """Clouds of points about zero side by side, on one scale; the last is the present one.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        x: Shape (N,).
        values: One or two arrays by name, shape (N,) each; the wildest points are cut off where there are trends.
        labels: Of the two axes, with their units.
        trends: Of each cloud, by the same names.
    """
    top = 1.05 * (max(_reach(v, trends[name] if trends else None) for name, v in values.items()) or 1.0)
    whole_area, _ = axes(labels, scale(x, 0.03), Scale(-top, top), (), above=LINE_HEIGHT + 4)
    gap, count = 10.0, len(values)
    each = (whole_area.width - gap * (count - 1)) / count
    made = [label_below(whole_area, labels[0]), label_beside(whole_area, labels[1])]
    some = _some(len(x))
    for k, (name, v) in enumerate(values.items()):
        left = whole_area.left + k * (each + gap)
        area = Area(left, whole_area.top, each, whole_area.height, whole_area.x, whole_area.y)
        color = AFTER if k == count - 1 else BEFORE
        made.append(frame(area, (TICKS[0] if count == 1 else 4, TICKS[1]), numbers=k == 0))
        inside = [
            dots(area, x[some], v[some], GREY if trends else color, opacity=0.35 if trends else 0.6),
            level(area, 0.0),
        ]
        if trends:
            t = trends[name]
            inside.append(bars(area, t.centre, t.mean - 2 * t.std, t.mean + 2 * t.std, color))
            inside.append(
                dots(area, t.centre, t.mean, color, size=4.0, opacity=1.0) + line(area, t.at, t.smooth, color)
            )
        made.append(clipped(f"{key}-{k}", area, "".join(inside)))
        made.append(text(left, whole_area.top - 5, name, color=color))
    return whole(alt, WIDTH, HEIGHT, made)


def _reach(values: np.ndarray, trend: Trend | None) -> float:
    """How far from zero a panel shows."""
    if trend is None:
        return float(np.abs(values).max())
    return max(float(np.percentile(np.abs(values), 98)), float((np.abs(trend.mean) + 2 * trend.std).max()))


@drawn_or_missing
def correlogram(key: str, alt: str, lags: np.ndarray, correlation: np.ndarray, bound: float, label: str) -> str:
    """Correlation of residuals some rows apart, and what 95 % of it stays within if all is noise.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        lags: Rows apart, shape (L,).
        correlation: Shape (L,).
        bound: Half width of the band.
        label: Of the horizontal axis.
    """
    top = 1.15 * max(float(np.abs(correlation).max()), 2.0 * bound)
    names = (LegendEntry("95 % of noise", GREY, "box"), LegendEntry("residuals", AFTER))
    lags = lags.astype(float)
    area, made = axes((label, "correlation [1]"), scale(lags, 0.05), Scale(-top, top), names)
    ends = np.array([area.x.low, area.x.high])
    made += [
        band(area, ends, np.full(2, -bound), np.full(2, bound), GREY, 0.18),
        bars(area, lags, np.zeros(len(lags)), correlation, AFTER, 2.0),
        dots(area, lags, correlation, AFTER, size=4.5, opacity=1.0),
        level(area, 0.0),
    ]
    return whole(alt, WIDTH, HEIGHT, made)


@drawn_or_missing
def falling(
    key: str, alt: str, at: np.ndarray, values: Mapping[str, np.ndarray], labels: tuple[str, str], joined: bool = True
) -> str:
    """Values that fall over some powers of ten, against how many of something there are.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        at: Shape (B,).
        values: By name, shape (B,) each; NaN where there is none, and names with nothing else are left out.
        labels: Of the two axes, with their units.
        joined: Whether lines join them; not where each stands for a thing of its own.
    """
    there = {name: v for name, v in values.items() if np.isfinite(v).any()}
    every = np.concatenate(list(there.values()))
    low, high = float(np.nanmin(every)), float(np.nanmax(every))
    room = max((high / low) ** 0.05, 1.001)
    colors = (AFTER, BEFORE, GREY)
    names = [LegendEntry(name, color, "line" if joined else "dot") for name, color in zip(there, colors, strict=False)]
    x = Scale(0.0, 1.05 * max(float(at.max()), 1.0))
    area, made = axes(labels, x, Scale(low / room, high * room, log=True), names)
    for v, color in zip(there.values(), colors, strict=False):
        own = dots(area, at, v, color, size=4.0, opacity=1.0)
        made.append(line(area, at, v, color) + own if joined else own)
    return whole(alt, WIDTH, HEIGHT, made)


@drawn_or_missing
def curve(
    key: str,
    alt: str,
    at: np.ndarray,
    value: np.ndarray,
    std: np.ndarray,
    rows: tuple[np.ndarray, np.ndarray],
    labels: tuple[str, str],
    winding: bool = False,
) -> str:
    """A function with its band of two standard deviations, and the rows behind it.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        at: Where the function was evaluated, shape (G,).
        value: The function there, shape (G,).
        std: Its standard deviation, shape (G,).
        rows: Where each row stands and what it asks for, shape (N,) each; the wildest are cut off.
        labels: Of the two axes, with their units.
        winding: For a curve that winds a lot: twice as wide as other figures.
    """
    cut = [*np.percentile(value - 2 * std, [3, 97]), *np.percentile(value + 2 * std, [3, 97]), value.min(), value.max()]
    cut += [*np.percentile(rows[1], [1, 99])] if len(rows[1]) else []
    names = (LegendEntry("rows", GREY), LegendEntry("identified, ± 2σ", AFTER, "line"))
    width = WIDE if winding else WIDTH
    x = scale(np.concatenate([at, rows[0]]), 0.03)
    area, made = axes(labels, x, scale(np.array(cut), 0.06), names, width)
    some = _some(len(rows[0]))
    inside = [
        band(area, at, value - 2 * std, value + 2 * std, AFTER, 0.25),
        dots(area, rows[0][some], rows[1][some], GREY, opacity=0.3),
        line(area, at, value, AFTER, 2.0),
    ]
    made.append(clipped(key, area, "".join(inside)))
    return whole(alt, width, HEIGHT, made, "plot wide" if winding else "plot")


@drawn_or_missing
def banded_curves(
    key: str,
    alt: str,
    at: np.ndarray,
    values: Mapping[str, np.ndarray],
    labels: tuple[str, str],
    top: float | None,
) -> str:
    """Some curves over one axis, each with the interval of its points.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        at: Shape (B,), B > 1.
        values: By name, shape (B, 3): value, lower and upper end of the interval; NaN where there is none.
        labels: Of the two axes, with their units.
        top: Of the vertical axis; None: what the values need.
    """
    highest = max((float(np.nanmax(v)) for v in values.values() if np.isfinite(v).any()), default=0.0)
    names = [LegendEntry(name, color, "line") for name, color in zip(values, COLOURS, strict=False)]
    area, made = axes(labels, scale(at.astype(float)), Scale(0.0, top or 1.05 * highest or 1.0), names)
    for v, color in zip(values.values(), COLOURS, strict=False):
        there = np.isfinite(v).all(axis=1)
        x, (value, low, high) = at[there], np.clip(v[there], area.y.low, area.y.high).T
        made += [band(area, x, low, high, color, 0.18), line(area, x, value, color)]
        made.append(dots(area, x, value, color, size=4.4, opacity=1.0))
    return whole(alt, WIDTH, HEIGHT, made)


def axes(
    labels: tuple[str, str],
    x: Scale,
    y: Scale,
    names: Sequence[LegendEntry] = (),
    width: float = WIDTH,
    above: float | None = None,
) -> tuple[Area, list[str]]:
    """The area of a figure, and all that stands around it: legend, grid, ticks and labels.

    Args:
        labels: Of the two axes.
        x: The horizontal one.
        y: The vertical one.
        names: Of the legend.
        width: Of the figure.
        above: Room above the area; None for what the legend needs.
    """
    left = 2 * LINE_HEIGHT + room_for(y, TICKS[1]) - 8
    entries, high = legend(names, left, width)
    top = above if above is not None else high + 4
    area = Area(left, top, width - left - EDGES[1], HEIGHT - top - EDGES[0], x, y)
    return area, [entries, frame(area, TICKS), label_below(area, labels[0]), label_beside(area, labels[1])]


def label_below(area: Area, label: str) -> str:
    """The label of a horizontal axis."""
    return text(area.left + area.width / 2, area.bottom + 27, label, "middle", INK)


def label_beside(area: Area, label: str) -> str:
    """The label of a vertical axis."""
    return text(LINE_HEIGHT - 4, area.top + area.height / 2, label, "middle", INK, turned=True)


def cloud_caption(count: int) -> str:
    """For the caption of a cloud: how many of its points are drawn; empty where all are."""
    return f" ({MOST_CLOUD_POINTS:,} of {count:,} rows drawn)" if count > MOST_CLOUD_POINTS else ""


def _some(count: int) -> np.ndarray:
    """Which points of a cloud are drawn: of more than :data:`MOST_CLOUD_POINTS` a reproducible choice."""
    if count <= MOST_CLOUD_POINTS:
        return np.arange(count)
    return np.random.default_rng(0).choice(count, MOST_CLOUD_POINTS, replace=False)


def _short(name: str, most: int = 20) -> str:
    return name if len(name) <= most else f"{name[: most - 1]}…"
