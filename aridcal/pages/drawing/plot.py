"""Axes, points and lines of a figure, written as SVG straight from arrays.

A figure has some thousand numbers and a dozen words. Matplotlib makes an object of each tick and measures each word, which took
longer than the calibration; here an array becomes one path. Lengths are in the units of a figure's `viewBox`, 1/72 inch where it
stands at its natural size; y goes down, as in SVG.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from aridcal.system.errors import printable_lines

INK, GREY, EDGE, GRID = "#333b44", "#5f6b76", "#aab2ba", "#e6e9ec"

LETTER_SIZE = 10.0
"""Size of all letters: 11 px on a phone, where a figure is as wide as the page, and 12 to 15 px on a desk."""

LINE_HEIGHT = 14.0
"""From one line of letters to the next."""

TICK_STEPS = (1.0, 2.0, 5.0, 10.0)
"""Ticks are these times a power of ten apart: read without counting."""

NARROW, BROAD = "fijlrtI.,:;|!'()[] ", "mwMW%@—"
LETTER, THIN, THICK = 0.62, 0.36, 0.95
"""Widths of letters in their sizes, those of wide sans-serif fonts: the reader's own font is not known here."""

PLAIN_TICKS = (1e-4, 1e6)
"""Ticks between these are written out, others with an exponent."""


@dataclass(frozen=True)
class Scale:
    """Values from one end of an axis to the other.

    Attributes:
        low: Value at the left or lower end.
        high: Value at the other.
        log: Whether equal lengths are equal ratios; both ends are positive then.
    """

    low: float
    high: float
    log: bool = False

    def share(self, values: np.ndarray) -> np.ndarray:
        """Where values lie: 0 at the low end, 1 at the high one."""
        if self.log:
            return np.asarray(np.log(values / self.low) / math.log(self.high / self.low))
        return np.asarray((values - self.low) / (self.high - self.low))

    def ticks(self, most: int) -> tuple[np.ndarray, list[str]]:
        """At most so many round values, and how they are written."""
        if self.log:
            return _log_ticks(self.low, self.high, most)
        step = round_up((self.high - self.low) / most)
        # a tick at the very end is one, in spite of rounding
        first, last = math.ceil(self.low / step - 1e-6), math.floor(self.high / step + 1e-6)
        at = step * np.arange(first, last + 1)
        return at, tick_texts(at, step)


def scale(values: np.ndarray, room: float = 0.0) -> Scale:
    """The ends of some values, so much further apart as a share of their distance; of one value, around it."""
    low, high = float(np.min(values)), float(np.max(values))
    more = room * (high - low)
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        more = 0.5 * max(abs(low), 1e-9)
    return Scale(low - more, high + more)


def round_up(value: float) -> float:
    """The next of :data:`TICK_STEPS` times a power of ten that is not smaller."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * next(step for step in TICK_STEPS if step * (1 + 1e-9) >= value / power)


def tick_texts(at: np.ndarray, step: float) -> list[str]:
    """Ticks in words: with as many decimals as their step needs, all with an exponent where one would be too long."""
    largest = float(np.abs(at).max(initial=0.0))
    last = math.floor(math.log10(step) + 1e-9)  # place of the digit in which ticks differ
    if step >= PLAIN_TICKS[0] and largest < PLAIN_TICKS[1]:
        return [f"{value + 0.0:,.{max(-last, 0)}f}".replace("-", "−") for value in at]
    digits = max(math.floor(math.log10(largest) + 1e-9) - last, 0) if largest else 0
    return [f"{value:.{digits}e}".replace("-", "−") if value else "0" for value in at]


def _log_ticks(low: float, high: float, most: int) -> tuple[np.ndarray, list[str]]:
    """Ticks at 1, 2 and 5 times powers of ten, or of the powers alone, or equally far apart where that is not a decade."""
    powers = 10.0 ** np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in (np.array(TICK_STEPS[:-1]), np.ones(1)):
        at = np.outer(powers, steps).ravel()
        at = at[(at >= low * (1 - 1e-9)) & (at <= high * (1 + 1e-9))]
        if 2 < len(at) <= most:
            return at, [f"{value:.3g}" for value in at]
    if len(at) > most:
        at = at[:: math.ceil(len(at) / most)]
        return at, [f"{value:.3g}" for value in at]
    return Scale(low, high).ticks(most)


@dataclass(frozen=True)
class Area:
    """Where in a figure values are drawn.

    Attributes:
        left: Its left edge.
        top: Its upper edge.
        width: To the right.
        height: Downwards.
        x: Of the horizontal axis.
        y: Of the vertical one.
    """

    left: float
    top: float
    width: float
    height: float
    x: Scale
    y: Scale

    @property
    def bottom(self) -> float:
        """Its lower edge."""
        return self.top + self.height

    @property
    def right(self) -> float:
        """Its right edge."""
        return self.left + self.width

    def across(self, values: np.ndarray) -> np.ndarray:
        """Horizontal places of values."""
        return self.left + self.width * self.x.share(np.asarray(values, dtype=float))

    def down(self, values: np.ndarray) -> np.ndarray:
        """Vertical places of values."""
        return self.bottom - self.height * self.y.share(np.asarray(values, dtype=float))


def text_width(text: str) -> float:
    """About how wide text is."""
    return LETTER_SIZE * sum(THIN if c in NARROW else THICK if c in BROAD else LETTER for c in text)


def text(x: float, y: float, said: str, anchor: str = "start", color: str = GREY, turned: bool = False) -> str:
    """Words at their baseline; ``turned`` ones read upwards."""
    place = f'transform="translate({x:.1f} {y:.1f}) rotate(-90)"' if turned else f'x="{x:.1f}" y="{y:.1f}"'
    return f'<text {place} text-anchor="{anchor}" fill="{color}">{escape(printable_lines(said), quote=False)}</text>'


def titled(words: str, drawn: str) -> str:
    """Elements that say what they are where a pointer rests on them."""
    return f"<g><title>{escape(printable_lines(words))}</title>{drawn}</g>"


def path(d: str, **look: str | float) -> str:
    """A path; ``stroke_width`` stands for ``stroke-width``, and nothing is filled unless ``fill`` says so."""
    pairs = "".join(f' {name.replace("_", "-")}="{value}"' for name, value in ({"fill": "none"} | look).items())
    return f'<path d="{d}"{pairs}/>' if d else ""


def along(u: np.ndarray, v: np.ndarray) -> str:
    """A line from place to place, as a path's data; it breaks where a place is not finite."""
    there = np.isfinite(u) & np.isfinite(v)
    begins = np.flatnonzero(there & ~np.r_[False, there[:-1]])
    ends = np.flatnonzero(there & ~np.r_[there[1:], False]) + 1
    places = np.column_stack([u, v])
    parts = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        parts.append(("M%.1f %.1f" + "L%.1f %.1f" * (end - begin - 1)) % tuple(places[begin:end].ravel().tolist()))
    return "".join(parts)


def line(area: Area, x: np.ndarray, y: np.ndarray, color: str, width: float = 1.8) -> str:
    """A line from value to value."""
    d = along(area.across(x), area.down(y))
    return path(d, stroke=color, stroke_width=width, stroke_linejoin="round")


def level(area: Area, y: float, color: str = GREY) -> str:
    """A horizontal line through the whole area."""
    return line(area, np.array([area.x.low, area.x.high]), np.array([y, y]), color, 0.8)


def band(area: Area, x: np.ndarray, low: np.ndarray, high: np.ndarray, color: str, opacity: float) -> str:
    """What lies between two lines."""
    d = along(area.across(np.r_[x, x[::-1]]), area.down(np.r_[low, high[::-1]]))
    return path(f"{d}Z" if d else "", fill=color, fill_opacity=opacity)


def bars(area: Area, x: np.ndarray, low: np.ndarray, high: np.ndarray, color: str, width: float = 1.0) -> str:
    """An upright line at each value."""
    places = np.column_stack([area.across(x), area.down(low), area.down(high)])
    places = places[np.isfinite(places).all(axis=1)]
    return path("M%.1f %.1fV%.1f" * len(places) % tuple(places.ravel().tolist()), stroke=color, stroke_width=width)


def stairs(area: Area, edges: np.ndarray, heights: np.ndarray, foot: float, color: str, fill: float, rim: float) -> str:
    """Counts between edges as steps above a foot.

    Args:
        area: Where.
        edges: Of B steps, shape (B + 1,).
        heights: Of their tops, shape (B,).
        foot: Height of what they stand on.
        color: Of steps and rim.
        fill: Opacity of the steps.
        rim: Width of the line around them; 0 for none.
    """
    x = np.repeat(edges, 2)
    y = np.r_[foot, np.repeat(heights, 2), foot]
    d = along(area.across(x), area.down(y))
    return path(d, fill=color, fill_opacity=fill) + (path(d, stroke=color, stroke_width=rim) if rim else "")


def dots(area: Area, x: np.ndarray, y: np.ndarray, color: str, size: float = 2.6, opacity: float = 0.6) -> str:
    """Points as strokes without length but with round ends: one short path in place of an element for each."""
    places = np.column_stack([area.across(x), area.down(y)])
    places = places[np.isfinite(places).all(axis=1)]
    d = "M%.1f %.1fh0" * len(places) % tuple(places.ravel().tolist())
    look = {"stroke_opacity": opacity} if opacity < 1.0 else {}
    return path(d, stroke=color, stroke_width=size, stroke_linecap="round", **look)


def rings(area: Area, x: np.ndarray, y: np.ndarray, color: str, radius: float = 2.5) -> str:
    """Points as circles."""
    places = np.column_stack([area.across(x) - radius, area.down(y)])
    d = f"M%.1f %.1fa{radius} {radius} 0 1 0 {2 * radius} 0a{radius} {radius} 0 1 0 {-2 * radius} 0"
    return path(d * len(places) % tuple(places.ravel().tolist()), stroke=color, stroke_width=1.0)


def clipped(key: str, area: Area, drawn: str) -> str:
    """What is drawn, as far as it lies in the area.

    Args:
        key: Unique in the page.
        area: Where.
        drawn: Elements.
    """
    name = escape(key)
    box = f'<rect x="{area.left:.1f}" y="{area.top:.1f}" width="{area.width:.1f}" height="{area.height:.1f}"/>'
    return f'<clipPath id="{name}">{box}</clipPath><g clip-path="url(#{name})">{drawn}</g>'


def room_for(y: Scale, most: int) -> float:
    """How wide the ticks of a vertical axis are."""
    return max((text_width(said) for said in y.ticks(most)[1]), default=0.0)


def frame(area: Area, most: tuple[int, int], numbers: bool = True) -> str:
    """Grid, ticks and the two edges of an area.

    Args:
        area: What they are of.
        most: Ticks along x and y at most.
        numbers: Whether the vertical axis has numbers: of areas side by side the first one's count for all.
    """
    (x, below), (y, beside) = area.x.ticks(most[0]), area.y.ticks(most[1])
    u, v = area.across(x).tolist(), area.down(y).tolist()
    across = "".join(f"M{at:.1f} {area.top:.1f}V{area.bottom:.1f}" for at in u)
    down = "".join(f"M{area.left:.1f} {at:.1f}H{area.right:.1f}" for at in v)
    edges = f"M{area.left:.1f} {area.top:.1f}V{area.bottom:.1f}H{area.right:.1f}"
    made = [path(across + down, stroke=GRID, stroke_width=0.8), path(edges, stroke=EDGE, stroke_width=0.8)]
    made += [text(at, area.bottom + 12, said, "middle") for at, said in zip(u, below, strict=True)]
    if numbers:
        made += [text(area.left - 4, at + 3.5, said, "end") for at, said in zip(v, beside, strict=True)]
    return "".join(made)


@dataclass(frozen=True)
class LegendEntry:
    """An entry of a legend.

    Attributes:
        name: What it is.
        color: Of its sign.
        sign: `dot`, `ring`, `line` or `box`.
    """

    name: str
    color: str
    sign: str = "dot"


def legend(entries: Sequence[LegendEntry], left: float, right: float) -> tuple[str, float]:
    """Entries from the top on, as many in a line as there is room for; and how high they are."""
    made, x, y = [], left, LINE_HEIGHT - 4
    for entry in entries:
        length = 14 + text_width(entry.name)
        if x > left and x + length > right:
            x, y = left, y + LINE_HEIGHT
        made.append(_sign(entry, x, y - 3.5) + text(x + 14, y, entry.name, color=INK))
        x += length + 12
    return "".join(made), y + 4 if entries else 0.0


def _sign(entry: LegendEntry, x: float, y: float) -> str:
    if entry.sign == "line":
        return path(f"M{x:.1f} {y:.1f}h11", stroke=entry.color, stroke_width=2)
    if entry.sign == "box":
        return path(f"M{x:.1f} {y - 4:.1f}h11v8h-11Z", fill=entry.color, fill_opacity=0.35, stroke=entry.color)
    filled = f'fill="{entry.color}"' if entry.sign == "dot" else f'fill="none" stroke="{entry.color}"'
    return f'<circle cx="{x + 5.5:.1f}" cy="{y:.1f}" r="2.6" {filled}/>'


def whole(alt: str, width: float, height: float, parts: Sequence[str], kind: str = "plot") -> str:
    """A figure of its parts.

    Args:
        alt: What it shows, for those who cannot see it.
        width: Of its `viewBox`.
        height: Of that.
        parts: Elements.
        kind: Its class.
    """
    head = f'<svg class="{kind}" viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(alt)}"'
    return f'{head} font-size="{LETTER_SIZE:g}">{"".join(parts)}</svg>'
