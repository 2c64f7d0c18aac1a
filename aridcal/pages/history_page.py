"""Fleets over time in words, as tables, and as a page."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from markupsafe import Markup

from aridcal import __version__
from aridcal.jobs.history.comparison import p_in_words
from aridcal.jobs.history.trend import FEWEST_RUNS
from aridcal.jobs.history.wear import DAY_ZERO, ConstantHistory, History, RobotHistory
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.pages.drawing.html import Content, bullets, figures, table, tag
from aridcal.pages.drawing.page_frame import framed_page, sections
from aridcal.pages.drawing.timelines import TimeStretch, sparkline, timeline
from aridcal.pages.report.page import draw_section
from aridcal.system.wording import enumeration, number, plural, plus_minus, shown_unit

MONTH = 365.25 / 12
"""Mean length of a month, [d]."""

MOST_PICTURED = 24
"""Alarms that the page draws."""

MOST_PICTURED_CYCLES = 6
"""Constants that may go with the season that it draws."""

MOST_LISTED_ROBOTS = 200
"""Robots that the page lists."""

MOST_CYCLES = 4
"""Constants that are named for a yearly cycle."""

MUCH_SCATTER = 1.2
"""Times its sigma that a constant must scatter by to be named for it."""


def date(day: float) -> str:
    """A day since 1970 as a date."""
    return (DAY_ZERO + pd.Timedelta(days=day)).strftime("%Y-%m-%d")


def change_in_words(w: ConstantHistory) -> str:
    """What changed, since when, by how much."""
    c = w.change
    assert c is not None
    unit, scale = shown_unit(w.unit)
    interval = f"{date(c.low)} to {date(c.high)}"
    sign = "+" if c.size > 0 else ""
    if c.kind == "drift":
        since = (
            f"before {date(c.high)}, perhaps before the first run"
            if c.before_first
            else f"{date(c.began)} ({interval})"
        )
        rate = plus_minus(scale * MONTH * c.size, scale * MONTH * c.std)
        return f"{w.name} drifts since {since} by {sign}{rate} {unit} a month, {number(scale * c.so_far)} {unit} so far"
    size = f"{sign}{plus_minus(scale * c.size, scale * c.std)} {unit}"
    if c.kind == "jump":
        return f"{w.name} jumped between {interval.replace(' to ', ' and ')} by {size}"
    return f"{w.name} was odd on {date(c.began)} alone, by {size}: that run, not the robot"


def robot_lines(robot: RobotHistory) -> list[str]:
    """What is to be said of one robot."""
    said = [f"{change_in_words(w)} ({p_in_words(w.p_value)} among all)" for w in robot.alarms]
    return [*said, *robot.notices]


def remarks(history: History) -> list[str]:
    """What is to be said of each robot, the worst first."""
    return [f"{robot.name}: {line}" for robot in history.robots for line in robot_lines(robot)]


def lines(history: History) -> list[str]:
    """The answer in words."""
    return [*remarks(history), *about(history)]


def about(history: History) -> list[str]:
    """What was looked at, and what alarms are worth."""
    alarmed = [robot for robot in history.robots if robot.alarms]
    runs = sum(len(robot.runs) for robot in history.robots)
    said = [
        f"{plural(len(history.robots), 'robot')}, {plural(runs, 'run')}: {len(alarmed) or 'no'} "
        f"{'robot' if len(alarmed) == 1 else 'robots'} with an alarm",
        f"of seasons in which nothing changes at most {FALSE_ALARMS:.0%} have an alarm anywhere among the {history.series:,} "
        "constants that were looked at, month by month; a yearly cycle is no alarm",
    ]
    cycling: dict[str, list[str]] = {}
    for robot in history.robots:
        for w in robot.cycles:
            cycling.setdefault(w.name, []).append(robot.name)
    for name, robots in sorted(cycling.items(), key=lambda pair: -len(pair[1]))[:MOST_CYCLES]:
        said.append(f"{name} of {_some(robots)} moved as a yearly cycle does: season or drift, more months will tell")
    if len(cycling) > MOST_CYCLES:
        said.append(f"and {len(cycling) - MOST_CYCLES} other constants did so")
    few = [robot.name for robot in history.robots if robot.watched and len(robot.watched[0].series.day) < FEWEST_RUNS]
    none = [robot.name for robot in history.robots if not robot.watched]
    if few:
        said.append(f"{_some(few)}: fewer than {FEWEST_RUNS} runs, of which none can tell a drift from the season")
    if none:
        said.append(f"{_some(none)}: fewer than two runs that can be compared")
    wide = {name: value for name, value in history.scatter.items() if value > MUCH_SCATTER}
    if wide:
        worst = max(wide, key=lambda name: wide[name])
        said.append(
            f"{plural(len(wide), 'constant')} of the fleet scatter by more than their sigma, {worst} most, "
            f"{number(wide[worst], 2)} times: alarms allow for it"
        )
    return said


def _some(names: list[str]) -> str:
    """Names, of many the first."""
    return enumeration(names if len(names) <= 4 else [*names[:3], f"{len(names) - 3} more"])


def robot_table(history: History) -> pd.DataFrame:
    """A row for each robot, the worst first."""
    rows = []
    for robot in history.robots:
        channel, final = robot.error("final")
        _, nominal = robot.error("nominal")
        rows.append(
            {
                "robot": robot.name,
                "runs": len(robot.runs),
                "first": robot.runs["measured"].min(),
                "last": robot.runs["measured"].max(),
                "channel": channel,
                "nominal_rms": nominal[-1] if len(nominal) else np.nan,
                "final_rms": final[-1] if len(final) else np.nan,
                "alarms": len(robot.alarms),
                "p_value": min((w.p_value for w in robot.watched), default=1.0),
            }
        )
    return pd.DataFrame(rows)


def alarm_table(history: History) -> pd.DataFrame:
    """A row for each alarm: sizes in [m] and [rad], of a drift for a month."""
    rows = []
    for w in (w for robot in history.robots for w in robot.alarms):
        c = w.change
        assert c is not None
        per = MONTH if c.kind == "drift" else 1.0
        rows.append(
            {
                "robot": w.robot,
                "name": w.name,
                "kind": c.kind,
                "began": DAY_ZERO + pd.Timedelta(days=c.began),
                "earliest": DAY_ZERO + pd.Timedelta(days=c.low),
                "latest": DAY_ZERO + pd.Timedelta(days=c.high),
                "before_first": c.before_first,
                "size": per * c.size,
                "std": per * c.std,
                "so_far": c.so_far,
                "unit": w.unit,
                "p_value": w.p_value,
            }
        )
    columns = ["robot", "name", "kind", "began", "earliest", "latest", "before_first", "size", "std", "so_far", "unit"]
    return pd.DataFrame(rows, columns=[*columns, "p_value"])


def constant_table(history: History) -> pd.DataFrame:
    """Every constant of every robot in every run that is compared, [m] and [rad]; ``std`` with the fleet's scatter."""
    parts = [
        pd.DataFrame(
            {
                "robot": w.robot,
                "name": w.name,
                "measured": DAY_ZERO + pd.to_timedelta(w.series.day, unit="D"),
                "value": w.series.value,
                "std": w.series.std,
                "unit": w.unit,
            }
        )
        for robot in history.robots
        for w in robot.watched
    ]
    columns = ["robot", "name", "measured", "value", "std", "unit"]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def error_table(history: History) -> pd.DataFrame:
    """Every robot's errors on held-out rows, run by run, in the unit that the channel's name ends in."""
    columns = ["robot", "measured", "stage", "channel", "rms", "p95", "max"]
    parts = [robot.errors.assign(robot=robot.name) for robot in history.robots]
    return pd.concat(parts, ignore_index=True)[columns]


def history_page(history: History, title: str) -> Markup:
    """The page, self-contained.

    Args:
        history: The fleet over time.
        title: What the fleet is called: its folder.
    """
    alarmed = [robot for robot in history.robots if robot.alarms]
    one = history.robots[0].name if len(history.robots) == 1 else None
    heading = f"{one} over time" if one else f"{len(alarmed) or 'No'} of {plural(len(history.robots), 'robot')} changed"
    chapters = [
        ("What changed?", _alarms(history)),
        ("Every robot, the worst first", _robots(history)),
        ("How sure is this?", _about(history)),
    ]
    head = [tag("p", title, class_="about"), tag("h1", heading)]
    parts = sections([(name, draw_section(name, content)) for name, content in chapters])
    return framed_page(f"{title}: {heading}", head, parts, f"aridcal {__version__}")


def _alarms(history: History) -> Iterator[Content]:
    """Alarms with their pictures, then what may be the season."""
    of = history.robots
    if not any(robot.alarms or robot.cycles for robot in of):
        yield tag("p", "Nothing beyond what the uncertainty explains.")
    said = [[tag("b", robot.name), f": {line}"] for robot in of for line in robot_lines(robot)]
    if said:
        yield bullets(said, 60, "more remarks")
    alarms = [w for robot in of for w in robot.alarms]
    cycles = [w for robot in of for w in robot.cycles]
    shown = alarms[:MOST_PICTURED] + cycles[:MOST_PICTURED_CYCLES]
    if shown:
        yield figures([(_caption(w), _picture(w)) for w in shown])
    if len(shown) < len(alarms) + len(cycles):
        rest = len(alarms) + len(cycles) - len(shown)
        yield tag("p", f"{rest} more are not drawn; history.csv has the values of all.")


def _caption(w: ConstantHistory) -> Content:
    what = "season or drift" if w.change is None else w.change.kind
    return [tag("b", w.robot), f" · {w.name} · {what}"]


def _picture(w: ConstantHistory) -> Markup:
    unit, scale = shown_unit(w.unit)
    stretches = [] if w.change is None else [TimeStretch(w.change.low, w.change.high, "when it began")]
    series = w.series
    alt = f"{w.name} of {w.robot} over time, with bars of two sigma"
    key = f"{w.robot}-{w.name}"
    return timeline(key, alt, series.day, scale * series.value, scale * series.std, f"{w.name} [{unit}]", stretches)


def _robots(history: History) -> Iterator[Content]:
    """A line for each robot."""
    rows: list[list[Content]] = []
    for robot in history.robots[:MOST_LISTED_ROBOTS]:
        _, final = robot.error("final")
        words = ", ".join(f"{w.name}: {w.change.kind}" for w in robot.alarms if w.change)
        season = f"{_some([w.name for w in robot.cycles])}: perhaps the season" if robot.cycles and not words else ""
        rows.append(
            [
                robot.name,
                words or season or "–",
                str(len(robot.runs)),
                robot.last_day,
                robot.last_error("nominal"),
                robot.last_error("final"),
                sparkline(final, f"RMS error of {robot.name} after calibration, run by run"),
            ]
        )
    more = f"; {MOST_LISTED_ROBOTS} of {len(history.robots)}" if len(history.robots) > MOST_LISTED_ROBOTS else ""
    titles = ["robot", "changed", "runs", "last run", "RMS before", "RMS after", "RMS after, over time"]
    yield table(titles, rows, f"Errors on held-out rows of the last run, before and after calibration{more}", numbers=2)


def _about(history: History) -> Iterator[Content]:
    """What alarms are worth, and how they are made."""
    yield bullets(about(history))
    yield tag(
        "p",
        "Constants are compared in one gauge: a robot's runs that told the same constants, of the same nominal URDF. The zero of "
        "a first or last joint that moved looks like a base or a tool that was set up anew, and these are not counted. Bars are "
        "two sigma; a coloured band holds with 95 % the time at which a change began.",
    )
    yield tag(
        "p",
        f"Read from {plural(len(history.files), 'table')}: ",
        ", ".join(history.files[:6]),
        " …" if len(history.files) > 6 else "",
    )
