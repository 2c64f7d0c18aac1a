"""Figures as inline SVG: small, with units on their axes, in colours that everybody can tell apart."""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, ParamSpec

import numpy as np

from aridcal.drawing.html import Html, attempt, missing, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

P = ParamSpec("P")

BEFORE, AFTER, GREY = "#D55E00", "#0072B2", "#5f6b76"  # the first two are Okabe and Ito's
# Small to large: brightness falls all the way, so that it survives grey print and colour blindness.
LEVELS = ("#c9d3dc", "#8cc3e8", "#3f93c9", "#a3326b", "#3b1f5b")

# Along the longer side of a field.
SQUARES = 36

# At most so many points are drawn in one cloud.
POINTS = 500

# Of a figure, in inches: it is legible on a phone, and three stand side by side on a desk.
WIDTH, WIDE, HEIGHT = 4.3, 8.8, 2.7

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "aridcal",
    "path.simplify": False,
    "text.parse_math": False,
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.edgecolor": "#aab2ba",
    "axes.labelcolor": "#333b44",
    "text.color": "#333b44",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e9ec",
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.major.size": 0.0,
    "ytick.major.size": 0.0,
    "legend.frameon": False,
    "legend.handlelength": 1.2,
    "axes.formatter.useoffset": False,
}


def _figure(draw: Callable[P, Figure]) -> Callable[P, Html]:
    """Turn a function that draws into one that returns SVG, or a line in its place if it fails.

    Its first two arguments are ``key`` and ``alt``.
    """

    @functools.wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Html:
        def svg() -> Html:
            from matplotlib import rc_context

            with rc_context(STYLE):
                figure, text = draw(*args, **kwargs), io.StringIO()
                figure.savefig(text, format="svg")
            return _inline(text.getvalue(), str(args[0]), str(args[1]))

        return attempt(f"report.html: the figure {str(args[0])!r}", svg, missing)

    return drawn


@_figure
def histogram(key: str, alt: str, values: Mapping[str, np.ndarray], label: str) -> Figure:
    """Two distributions on one axis.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        values: Two arrays by name, none negative; what lies far outside is counted in the last bin.
        label: Of the horizontal axis, with its unit.
    """
    figure, axes = _axes()
    top = max(float(np.percentile(v, 99.5)) for v in values.values())
    edges = np.linspace(0.0, max(1.03 * top, 1e-9), 41)
    for (name, v), color, filled in zip(values.items(), (BEFORE, AFTER), (0.15, 0.45), strict=True):
        share = 100.0 * np.histogram(np.minimum(v, edges[-1]), edges)[0] / len(v)
        axes.stairs(share, edges, color=color, fill=True, alpha=filled)
        axes.stairs(share, edges, color=color, linewidth=1.4, label=name)
    axes.set(xlabel=label, ylabel="rows [%]", xlim=(0, edges[-1]))
    axes.set_ylim(bottom=0)
    return _with_legend(figure, axes)


@_figure
def coverage(key: str, alt: str, names: Sequence[str], shares: Sequence[np.ndarray], ranges: Sequence[str]) -> Figure:
    """Where within its limits each joint was measured: one histogram per joint, on a line of its own.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        names: Of the joints, base first.
        shares: Readings of each as a share of the joint's range: 0 at its lower limit, 1 at its upper one.
        ranges: The two limits in words.
    """
    count = len(names)
    figure, axes = _axes(WIDTH, 0.55 + 0.42 * count, left=0.3, top=0.1)
    edges = np.linspace(0.0, 1.0, 37)
    for k, share in enumerate(shares):
        bins = np.histogram(np.clip(share, 0.0, 1.0), edges)[0]
        height = 0.8 * bins / max(bins.max(), 1)
        line = count - 1 - k
        axes.stairs(line + height, 100 * edges, baseline=line, color=AFTER, fill=True, alpha=0.55)
        axes.axhline(line, color="#aab2ba", linewidth=0.8)
    axes.set(xlabel="share of the joint's range [%]", xlim=(0, 100), ylim=(-0.1, count))
    labels = [f"{_short(name)}\n{limits}" for name, limits in zip(names, ranges, strict=True)]
    axes.set_yticks(np.arange(count) + 0.4, labels[::-1], fontsize=8)
    axes.grid(visible=False, axis="y")
    axes.spines.left.set_visible(False)
    return figure


@dataclass(frozen=True)
class Trend:
    """What a cloud of points follows: means of slices with their noise, and a smooth curve; shapes (B,) and (G,)."""

    centre: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    at: np.ndarray
    smooth: np.ndarray


@_figure
def panels(
    key: str,
    alt: str,
    x: np.ndarray,
    values: Mapping[str, np.ndarray],
    labels: tuple[str, str],
    trends: Mapping[str, Trend] | None = None,
) -> Figure:
    """Clouds of points about zero side by side, on one scale; the last is the present one.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        x: Shape (N,).
        values: One or two arrays by name, shape (N,) each; the wildest points are cut off where there are trends.
        labels: Of the two axes, with their units.
        trends: Of each cloud, by the same names.
    """
    figure, axes = _axes()
    low, _, right, _ = axes.get_position().extents
    gap = 0.035
    wide = (right - low - gap * (len(values) - 1)) / len(values)
    top = max(_reach(v, trends[name] if trends else None) for name, v in values.items()) or 1.0
    for k, (name, v) in enumerate(values.items()):
        _, bottom, _, height = axes.get_position().bounds
        panel = figure.add_axes((low + k * (wide + gap), bottom, wide, height), facecolor="none")
        color = AFTER if k == len(values) - 1 else BEFORE
        _dots(panel, x, v, GREY if trends else color, alpha=0.35 if trends else 0.6)
        panel.axhline(0.0, color=GREY, linewidth=0.8)
        if trends:
            t = trends[name]
            panel.vlines(t.centre, t.mean - 2 * t.std, t.mean + 2 * t.std, color=color, linewidth=1.0)
            _dots(panel, t.centre, t.mean, color, size=4.0, alpha=1.0)
            panel.plot(t.at, t.smooth, color=color, linewidth=1.8)
        room = 0.03 * float(np.ptp(x)) or 1.0
        panel.set(xlim=(x.min() - room, x.max() + room), ylim=(-1.05 * top, 1.05 * top))
        panel.locator_params(axis="x", nbins=4 if len(values) > 1 else 6)
        panel.locator_params(axis="y", nbins=6)
        panel.set_title(name, loc="left", fontsize=9, color=color, pad=4)
        if k:
            panel.tick_params(labelleft=False)
        else:
            panel.set_ylabel(labels[1])
    figure.text((low + right) / 2, 0.03, labels[0], ha="center")
    axes.remove()
    return figure


def _reach(values: np.ndarray, trend: Trend | None) -> float:
    """How far from zero a panel shows."""
    if trend is None:
        return float(np.abs(values).max())
    return max(float(np.percentile(np.abs(values), 98)), float((np.abs(trend.mean) + 2 * trend.std).max()))


@_figure
def correlogram(key: str, alt: str, lags: np.ndarray, correlation: np.ndarray, bound: float, label: str) -> Figure:
    """Correlation of residuals some rows apart, and what 95 % of it stays within if all is noise.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        lags: Rows apart, shape (L,).
        correlation: Shape (L,).
        bound: Half width of the band.
        label: Of the horizontal axis.
    """
    figure, axes = _axes()
    axes.axhspan(-bound, bound, color=GREY, alpha=0.18, linewidth=0, label="95 % of noise")
    axes.vlines(lags, 0.0, correlation, color=AFTER, linewidth=2.0)
    _dots(axes, lags.astype(float), correlation, AFTER, label="residuals", size=4.5, alpha=1.0)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    top = 1.15 * max(float(np.abs(correlation).max()), 2.0 * bound)
    axes.set(xlabel=label, ylabel="correlation [1]", ylim=(-top, top))
    return _with_legend(figure, axes)


@_figure
def field(
    key: str,
    alt: str,
    points: np.ndarray,
    values: np.ndarray,
    labels: tuple[str, str],
    unit: str,
    hollow: np.ndarray | None = None,
    marks: Mapping[str, np.ndarray] | None = None,
) -> Figure:
    """RMS of a value over a plane: one dot for the rows of each small square, in five steps of equally many dots.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        points: Shape (N, 2).
        values: Shape (N,), not negative.
        labels: Of the two axes, with their units.
        unit: Of the values.
        hollow: Of the rows, shape (N,) bool; a dot for which most of them are gets a hole.
        marks: Other points of the plane by their name, shape (M, 2), as rings above the dots.
    """
    figure, axes = _axes(HEIGHT + 1.6, HEIGHT + 1.6, left=0.14, top=0.42)
    side = max(float(np.ptp(points, axis=0).max()) / SQUARES, 1e-9)
    _, square = np.unique(np.floor(points / side), axis=0, return_inverse=True)
    square = square.reshape(-1)
    count = np.bincount(square)
    x, y = (np.bincount(square, column) / count for column in points.T)
    rms = np.sqrt(np.bincount(square, values**2) / count)
    steps = np.quantile(rms, np.linspace(0, 1, len(LEVELS) + 1))
    level = np.searchsorted(steps[1:-1], rms, side="right")
    for k, color in enumerate(LEVELS):
        name = f"{number(steps[k], 2)}–{number(steps[k + 1], 2)} {unit}"
        _dots(axes, x[level == k], y[level == k], color, label=name, size=5.0, alpha=1.0)
    if hollow is not None:
        open_ = np.bincount(square, hollow) > 0.5 * count
        _dots(axes, x[open_], y[open_], "white", size=2.2, alpha=1.0)
    for name, at in (marks or {}).items():
        axes.plot(*at.T, color="#1d242b", marker="o", markerfacecolor="none", linestyle="", markersize=5, label=name)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.set_aspect("equal", adjustable="datalim")
    return _with_legend(figure, axes, columns=3)


@_figure
def falling(key: str, alt: str, at: np.ndarray, values: Mapping[str, np.ndarray], labels: tuple[str, str]) -> Figure:
    """Values that fall over some powers of ten, against how many of something there are.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        at: Shape (B,).
        values: By name, shape (B,) each; NaN where there is none, and names with nothing else are left out.
        labels: Of the two axes, with their units.
    """
    from matplotlib.ticker import LogLocator

    figure, axes = _axes()
    for (name, v), color in zip(values.items(), (AFTER, BEFORE, GREY), strict=False):
        if np.isfinite(v).any():
            axes.plot(at, v, color=color, linewidth=1.8, marker="o", markersize=3.5, label=name)
    axes.set(xlabel=labels[0], ylabel=labels[1], yscale="log", xlim=(0, None))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(
        lambda value, _: f"{value:.3g}"
    )  # ticks of less than a decade differ in the third digit
    axes.yaxis.set_minor_formatter(lambda value, _: "")
    return _with_legend(figure, axes, columns=3)


@_figure
def curve(
    key: str,
    alt: str,
    at: np.ndarray,
    value: np.ndarray,
    std: np.ndarray,
    rows: tuple[np.ndarray, np.ndarray],
    labels: tuple[str, str],
    wide: bool = False,
) -> Figure:
    """A function with its band of two standard deviations, and the rows behind it.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        at: Where the function was evaluated, shape (G,).
        value: The function there, shape (G,).
        std: Its standard deviation, shape (G,).
        rows: Where each row stands and what it asks for, shape (N,) each; the wildest are cut off.
        labels: Of the two axes, with their units.
        wide: Twice as wide as other figures, for a curve that winds a lot.
    """
    figure, axes = _axes(WIDE) if wide else _axes()
    axes.fill_between(at, value - 2 * std, value + 2 * std, color=AFTER, alpha=0.25, linewidth=0)
    _dots(axes, *rows, GREY, label="rows", alpha=0.3)
    axes.plot(at, value, color=AFTER, linewidth=2.0, label="identified, ± 2σ")
    cut = [*np.percentile(value - 2 * std, [3, 97]), *np.percentile(value + 2 * std, [3, 97]), value.min(), value.max()]
    cut += [*np.percentile(rows[1], [1, 99])] if len(rows[1]) else []
    low, high = min(cut), max(cut)
    room = 0.06 * (high - low) or 1.0
    axes.set(xlabel=labels[0], ylabel=labels[1], ylim=(low - room, high + room))
    return _with_legend(figure, axes)


def _axes(width: float = WIDTH, height: float = HEIGHT, left: float = 0.14, top: float = 0.3) -> tuple[Figure, Axes]:
    """One figure with one pair of axes; ``left`` is a share of the usual width, ``top`` in inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor="none")
    bottom, usual = 0.45, min(WIDTH / width, 1.0)
    left, right = left * usual, 1.0 - 0.03 * usual
    axes = figure.add_axes((left, bottom / height, right - left, 1 - (bottom + top) / height), facecolor="none")
    axes.locator_params(nbins=6)
    return figure, axes


def _with_legend(figure: Figure, axes: Axes, columns: int = 2) -> Figure:
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(-0.02, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        borderpad=0.1,
        columnspacing=0.9,
        handletextpad=0.4,
    )
    return figure


def _dots(
    axes: Axes, x: np.ndarray, y: np.ndarray, color: str, label: str = "", size: float = 2.6, alpha: float = 0.6
) -> None:
    """Points as strokes without length but with round ends: one short path in place of an element per point.

    Of more than :data:`POINTS` a reproducible choice is drawn.
    """
    if len(x) > POINTS:
        some = np.random.default_rng(0).choice(len(x), POINTS, replace=False)
        x, y = x[some], y[some]
    gap = np.full(len(x), np.nan)
    u, v = (np.column_stack([values, values, gap]).ravel() for values in (x, y))
    axes.plot(u, v, color=color, linewidth=size, alpha=alpha, solid_capstyle="round")
    if label:
        axes.plot([], [], color=color, marker="o", linestyle="", markersize=4.5, label=label)


def _short(name: str, most: int = 16) -> str:
    return name if len(name) <= most else f"{name[: most - 1]}…"


def _inline(svg: str, key: str, alt: str) -> Html:
    """Matplotlib's file as an element of a page: ids unique and only where needed, two decimals."""
    svg = svg[svg.index("<svg") :]
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    assert size is not None
    body = svg[svg.index(">") + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", body, flags=re.DOTALL)
    referred = set(re.findall(r'(?:url\(|href=")#([^)"]+)', body))
    body = re.sub(r' id="([^"]+)"', lambda m: f' id="{key}-{m[1]}"' if m[1] in referred else "", body)
    body = re.sub(r'(url\(|href=")#', rf"\1#{key}-", body).replace("xlink:href", "href")
    body = re.sub(r"<[^>]*>", lambda m: re.sub(r"(?<=\d)(\.\d{2})\d+", r"\1", m[0]), body)  # not in what is read
    body = re.sub(r"\s+", " ", body).replace("> <", "><")
    body = re.sub(r"M (\S+ \S+) L \1(?= )", r"M\1h0", body)
    kind = "plot wide" if float(size[1]) > 72 * WIDTH + 1 else "plot"
    head = f'<svg class="{kind}" viewBox="0 0 {size[1]} {size[2]}" role="img" aria-label="{escape(alt)}">'
    return Html(head + body.strip())
