"""The page beside a merged table: what was paired, and how well the clocks are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from markupsafe import Markup

from aridcal import __version__
from aridcal.jobs.merge.log_rows import MergeResult
from aridcal.jobs.merge.standstills import speeds
from aridcal.pages.drawing.figures import AFTER, BEFORE, TICKS, WIDE, drawn_or_missing, label_below, label_beside
from aridcal.pages.drawing.html import Content, bullets, figures, table, tag
from aridcal.pages.drawing.page_frame import framed_page, sections
from aridcal.pages.drawing.plot import (
    EDGE,
    GREY,
    LINE_HEIGHT,
    Area,
    LegendEntry,
    Scale,
    clipped,
    dots,
    frame,
    legend,
    level,
    line,
    path,
    room_for,
    scale,
    text,
    whole,
)
from aridcal.system.wording import number

SPEED_PICTURES = 3
"""Pictures of the speeds: beginning, middle and end, for what is off at one end only is seen in no single picture."""

LONGEST_STRETCH = 40.0
"""Seconds that a picture shows at most: a dozen moves."""

MOST_LINE_POINTS = 1500
"""Most points of a line: a figure is 600 pixels wide."""

HEIGHT, LANE = 210.0, 11.0
"""Height of a figure, and of one lane of standstills in it, in units of its `viewBox`."""

DEVIATION_CAPTION = (
    "Measured minus nominal at each row, base and target fitted: the robot's errors, no error of this table"
)

SPEED_CAPTION = (
    "Speeds of the nominal tip (joints) and of the measured target (tracker), both by the joints' clock. They need not be "
    "equal, for the target is not at the tip: they begin and end together. The bars below are standstills of each log and, "
    "between them, the windows whose samples make a row."
)

LATE = (
    "Each move says by itself how late one clock is; offset and drift are a robust line through all. Points that lie in two "
    "steps are a clock that was set, a bow is a clock that warms up."
)

MOST_LISTED_STANDSTILLS = 40
"""Standstills without a row that the page lists."""


def merge_page(merged: MergeResult, names: tuple[str, str], out: Path) -> Markup:
    """The page, self-contained.

    Args:
        merged: What came of the logs.
        names: Of the joints' and of the tracker's log.
        out: The table.
    """
    middle = merged.tracker.log.time[[0, -1]].mean()
    head = [
        tag("p", f"{names[0]} and {names[1]}", class_="about"),
        tag("h1", f"{len(merged.table)} standstills in {out.name}"),
        bullets(lines(merged)),
    ]
    chapters: list[tuple[str, Content]] = [
        ("What was paired", [tag("p", SPEED_CAPTION), figures(_stretches(merged))]),
        (
            "How well the clocks are known",
            [
                tag("p", LATE),
                figures(
                    [
                        (
                            "What each move says beyond offset and drift",
                            _late("late", "Residual offset of each move", merged),
                        )
                    ]
                ),
            ],
        ),
        ("Rows beside the nominal robot", figures([(DEVIATION_CAPTION, _off("off", DEVIATION_CAPTION, merged))])),
        ("Standstills without a row", _unpaired(merged)),
    ]
    foot = f"aridcal {__version__} · clocks at {number(float(middle), 6)} s of the tracker's"
    return framed_page(f"{names[0]} and {names[1]} merged", head, sections(chapters), foot)


def lines(merged: MergeResult) -> list[str]:
    """What was found, for people."""
    clocks, time = merged.clocks, merged.tracker.log.time
    sigma = 1e3 * float(clocks.std(time[[0, -1]]).max())
    drift, drift_sigma = 1e6 * clocks.drift, 1e6 * float(np.sqrt(clocks.covariance[1, 1]))
    samples, sign = merged.averages.count, "-" if clocks.offset < 0 else "+"
    words = [
        f"joints' clock = tracker's {sign} {abs(clocks.offset):.5f} s at {clocks.middle:.3f} s, drift {drift:.2f} ± "
        f"{drift_sigma:.2g} ppm; known to "
        f"{sigma:.2g} ms (1 sigma) in the whole log, from {len(merged.moves.late)} moves",
        f"{len(merged.table)} rows of {samples.min()} to {samples.max()} samples; scatter of one sample "
        f"{' '.join(number(1e3 * float(v)) for v in merged.averages.usual[:3])} mm in x y z"
        + (
            f", {' '.join(number(1e3 * float(v)) for v in merged.averages.usual[3:])} mrad about them"
            if len(merged.averages.usual) > 3
            else ""
        ),
        f"the nominal robot misses the rows by {1e3 * float(np.median(np.linalg.norm(merged.off, axis=1))):.3g} mm (median)",
    ]
    rho = float(merged.averages.correlation.max())
    if rho > 0.2:
        words.append(f"neighbouring samples are correlated by up to {rho:.2f}: the standard deviations allow for it")
    return [*words, *merged.tracker.words, *merged.notices]


def _stretches(merged: MergeResult) -> list[tuple[Content, Markup]]:
    """Pictures of the speeds."""
    t = merged.clocks.joints(merged.tracker.log.time)
    first, last = max(t[0], merged.joints.time[0]), min(t[-1], merged.joints.time[-1])
    each = min(LONGEST_STRETCH, last - first)
    count = (
        SPEED_PICTURES
        if last - first > SPEED_PICTURES * LONGEST_STRETCH
        else max(1, int(np.ceil((last - first) / LONGEST_STRETCH)))
    )
    begins = np.linspace(first, last - each, count)
    return [
        (
            f"{a:.1f} to {a + each:.1f} s",
            _speeds(f"speeds{k}", "Speeds in both logs over time", merged, float(a), float(a + each)),
        )
        for k, a in enumerate(begins.tolist())
    ]


@drawn_or_missing
def _speeds(key: str, alt: str, merged: MergeResult, begin: float, end: float) -> str:
    """Speeds over a stretch of time, with the standstills of both and the windows of rows in lanes below."""
    si, clocks = merged.tracker, merged.clocks
    t = clocks.joints(si.log.time)
    curves = [
        _thinned(merged.joints.time, merged.tips, begin, end),
        _thinned(t, speeds(si.log, si.position), begin, end),
    ]
    top = max((float(np.nanmax(v)) for _, v in curves if np.isfinite(v).any()), default=1.0)
    entries = [
        LegendEntry("joints (nominal tip)", AFTER, "line"),
        LegendEntry("tracker", BEFORE, "line"),
        LegendEntry("row", GREY, "box"),
    ]
    y = Scale(0.0, 1.05 * max(top, 1e-9))
    left = 2 * LINE_HEIGHT + room_for(y, TICKS[1]) - 8
    head, high = legend(entries, left, WIDE)
    area = Area(left, high + 4, WIDE - left - 8, HEIGHT - high - 42, Scale(begin, end), y)
    parts = [head, frame(area, TICKS), label_beside(area, "speed [m/s]")]
    inside = [line(area, x, v, color, 1.4) for (x, v), color in zip(curves, (AFTER, BEFORE), strict=True)]
    parts.append(clipped(key, area, "".join(inside)))
    tracked = merged.tracked
    foot = area.bottom + 18
    lanes = [
        (merged.still.begin, merged.still.end, AFTER),
        (clocks.joints(merged.pairs.begin), clocks.joints(merged.pairs.end), GREY),
        (clocks.joints(tracked.begin), clocks.joints(tracked.end), BEFORE),
    ]
    for k, (a, b, color) in enumerate(lanes):
        height = foot + k * LANE
        some = (b > begin) & (a < end)
        u, v = area.across(np.clip(a[some], begin, end)), area.across(np.clip(b[some], begin, end))
        d = "".join(f"M{p:.1f} {height:.1f}H{q:.1f}" for p, q in zip(u, v, strict=True))
        parts.append(path(d, stroke=color, stroke_width=6))
    parts.append(text(area.left - 6, foot + LANE + 3, "still", "end"))
    parts.append(text(area.left + area.width / 2, foot + 3 * LANE + 6, "joints' clock [s]", "middle"))
    return whole(alt, WIDE, foot + 3 * LANE + 12, parts, "plot wide")


def _thinned(t: np.ndarray, v: np.ndarray, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """A curve in a stretch of time, of not too many points."""
    rows = np.flatnonzero((t >= begin) & (t <= end))
    rows = rows[:: max(1, len(rows) // MOST_LINE_POINTS)]
    return t[rows], v[rows]


def _points(key: str, alt: str, x: np.ndarray, y: np.ndarray, label: str, zero: bool) -> str:
    """Values over the time of the joints' clock."""
    ends = scale(np.r_[y, -y] if zero else np.r_[y, 0.0], 0.08)
    ends = ends if zero else Scale(0.0, ends.high)
    left = 2 * LINE_HEIGHT + room_for(ends, TICKS[1]) - 8
    area = Area(left, 8.0, WIDE - left - 8, HEIGHT - 60, scale(x, 0.03), ends)
    inside = dots(area, x, y, AFTER, 3.2, 0.8) + (level(area, 0.0, EDGE) if zero else "")
    return whole(
        alt, WIDE, area.bottom + 34,
        [frame(area, TICKS), label_below(area, "joints' clock [s]"), label_beside(area, label), clipped(key, area, inside)],
        "plot wide",
    )  # fmt: skip


@drawn_or_missing
def _late(key: str, alt: str, merged: MergeResult) -> str:
    """What each move says of the clocks beyond offset and drift."""
    return _points(key, alt, merged.clocks.joints(merged.moves.time), 1e3 * merged.moves.late, "late [ms]", True)


@drawn_or_missing
def _off(key: str, alt: str, merged: MergeResult) -> str:
    """Distance from the nominal robot at each row."""
    return _points(
        key, alt, merged.table["time"].to_numpy(), 1e3 * np.linalg.norm(merged.off, axis=1), "distance [mm]", False
    )


def _unpaired(merged: MergeResult) -> Content:
    """A table of what makes no row."""
    if not merged.unpaired:
        return tag("p", "None: every standstill of each log is one of the other.")
    rows = [
        [one.log, f"{one.begin:.3f}", f"{one.end:.3f}", one.why] for one in merged.unpaired[:MOST_LISTED_STANDSTILLS]
    ]
    more = (
        ""
        if len(merged.unpaired) <= MOST_LISTED_STANDSTILLS
        else f"; the first {MOST_LISTED_STANDSTILLS} of {len(merged.unpaired)}"
    )
    return table(["log", "from [s]", "to [s]", "why"], rows, f"By each log's own clock{more}", numbers=4)
