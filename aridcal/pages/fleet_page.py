"""``fleet.html``: a fleet on one page, worst first."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from aridcal import __version__
from aridcal.jobs.calibrate.verdict import VERDICTS
from aridcal.jobs.fleet.drifts import Drift, drifting
from aridcal.jobs.fleet.outliers import FEWEST_ROBOTS, OutlyingFigure, makes, outlying_robots
from aridcal.jobs.fleet.row_figures import are_done, channels_of, error_of
from aridcal.jobs.fleet.run_record import Row
from aridcal.jobs.fleet.runs import FleetResults
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.pages.drawing.figures import falling
from aridcal.pages.drawing.html import Content, bullets, figures, table, tag
from aridcal.pages.drawing.page_frame import framed_page, sections
from aridcal.pages.fleet_sections import draw_section
from aridcal.system.errors import shortened
from aridcal.system.wording import fixed, number, plural, plus_minus, shown_unit

MOST_NOTICES, MOST_WITHIN, MOST_NAMED = 30, 10, 3
"""Notices that are listed; constants shown that moved no more than chance has them move; robots named for one effect."""


def fleet_page(ran: FleetResults, title: str) -> Markup:
    """The page of a fleet, self-contained but for its links to each robot's report.

    Args:
        ran: What became of it.
        title: Of the fleet.
    """
    rows = list(ran.now.values())
    done = are_done(rows)
    chapters: list[tuple[str, Callable[[], Iterator[Content]]]] = [
        ("Before and after", lambda: _errors(done)),
        ("Robots that stand out", lambda: _standing_out(rows)),
        ("Constants that drift", lambda: _drifting(ran)),
        ("Effects across the fleet", lambda: _effects(done)),
        ("Every robot", lambda: _every_robot(done)),
        ("What the calibrations say of themselves", lambda: _notices(done)),
    ]
    if ran.failed or ran.remaining:
        chapters.insert(0, ("Not calibrated", lambda: _not_done(ran)))
    heading = f"{len(done):,} of {plural(len({*ran.now, *ran.remaining}), 'robot')} calibrated"
    head = [
        tag("p", f"Fleet {title}", class_="about"),
        tag("h1", heading),
        draw_section("fleet.html", "Summary", lambda: _summary(done)),
    ]
    parts = sections([(name, draw_section("fleet.html", name, content)) for name, content in chapters])
    foot = f"aridcal {__version__}; every figure is in fleet.parquet"
    return framed_page(f"{heading}: {title}", head, parts, foot)


def _summary(done: Sequence[Row]) -> Iterator[Content]:
    """The median robot before and after, and how many deserve a look."""
    for channel in _leading(done):
        own = [row for row in done if _first(row) == channel]
        before, after = ([error_of(row, stage, channel) for row in own] for stage in ("nominal", "final"))
        worst = max(own, key=lambda row: _rank(row, channel))
        yield tag(
            "p",
            f"Half of {plural(len(own), 'robot')} are better than {_said(float(np.nanmedian(before)), channel)} RMS as designed"
            f", and than {_said(float(np.nanmedian(after)), channel)} as calibrated, on held-out rows. The worst, ",
            _link(worst),
            f", is left with {_said(error_of(worst, 'final', channel), channel)}.",
        )
    verdicts = Counter(row["verdict"] for row in done)
    if verdicts:
        said = [f"{_verdict(word)} {count:,}" for word, count in verdicts.most_common()]
        yield tag("p", f"Verdicts: {', '.join(said)}.")


def _not_done(ran: FleetResults) -> Iterator[Content]:
    """Robots that failed, with why; and those that remain."""
    if ran.failed:
        lines = [[_name(name), shortened(why, 1000)] for name, why in ran.failed.items()]
        yield table(["robot", "why"], lines, "Robots that failed; the others are not touched by it", numbers=2)
    if ran.remaining:
        yield tag("p", f"Not computed, for {ran.gone}: {', '.join(ran.remaining)}.")


def _errors(done: Sequence[Row]) -> Iterator[Content]:
    """Errors of all robots, one picture for each channel that judges."""
    if not done:
        yield tag("p", "No robot was calibrated.")
    pictures: list[tuple[Content, Markup]] = []
    for channel in _leading(done):
        own = _worst_first(done, channel)
        unit = _unit(channel)
        picture = falling(
            f"errors-{channel}",
            f"RMS error of every robot before and after, {unit}",
            np.arange(1, len(own) + 1),
            {stage: np.array([error_of(row, stage, channel) for row in own]) for stage in ("final", "nominal")},
            ("robot, worst first", f"RMS on held-out rows [{unit}]"),
            joined=False,
        )
        pictures.append((f"{plural(len(own), 'robot')}: as designed, and with constants and effects", picture))
    yield figures(pictures)


def _every_robot(done: Sequence[Row]) -> Iterator[Content]:
    """Every robot's errors, worst first, one table for each channel that judges."""
    for channel in _leading(done):
        own = _worst_first(done, channel)
        others = [name for name in channels_of(own) if name != channel]
        lines: list[list[Content]] = []
        for row in own:
            of_stages = [error_of(row, stage, channel) for stage in ("final", "nominal", "geometric")]
            further = [error_of(row, "final", channel, figure) for figure in ("p95", "max")]
            further += [error_of(row, "final", other) for other in others]
            verdict = _verdict(row["verdict"])
            lines.append(
                [_link(row), *map(number, [*of_stages, *further]), f"{row['rows']:,}", row["measured"][:10], verdict]
            )
        head = ["robot", "final", "nominal", "geometric", "final, p95", "final, largest"]
        head += [f"final, {_unit(other)}" for other in others]
        caption = (
            f"RMS errors on held-out rows, {_unit(channel)} where nothing else is said; the largest final one first"
        )
        yield table([*head, "rows", "measured", "verdict"], lines, caption)


def _worst_first(done: Sequence[Row], channel: str) -> list[Row]:
    """Robots that a channel judges."""
    return sorted((row for row in done if _first(row) == channel), key=lambda row: -_rank(row, channel))


def _standing_out(rows: Sequence[Row]) -> Iterator[Content]:
    """Robots that are far from the others of their make."""
    outliers, compared = outlying_robots(rows)
    if not compared:
        yield tag("p", f"Robots are set beside each other from {FEWEST_ROBOTS} of one make (one URDF) on.")
        return
    chance = f"{100 * FALSE_ALARMS:.0f} %"
    yield tag(
        "p",
        f"Errors and constants of each robot were set beside the same of all robots of its make, {plural(compared, 'number')} "
        f"in all. Where all are alike but for normal scatter, any robot is named here in {chance} of fleets.",
    )
    alone = len(are_done(rows)) - sum(map(len, makes(rows)))
    if alone:
        yield tag(
            "p",
            f"{plural(alone, 'robot')} of makes (URDFs) with fewer than {FEWEST_ROBOTS} robots {_were(alone)} not compared.",
        )
    if not outliers:
        yield tag("p", "No robot stands out.")
        return
    lines = [
        [_name(out.robot), out.what, *_values(out), _times(out.times), number(out.threshold, 2)] for out in outliers
    ]
    head = ["robot", "number", "of this robot", "usual", "× scatter", "told from"]
    caption = (
        "How many robust standard deviations a robot is from the median of its make, and from how many on it is told"
    )
    yield table(head, lines, caption, numbers=2)


def _were(count: int) -> str:
    return "was" if count == 1 else "were"


def _values(out: OutlyingFigure) -> tuple[str, str]:
    """A number of a robot, and the usual one, with their unit."""
    if not out.unit:
        channel = out.what.partition(" ")[2]
        return _said(out.value, channel), _said(out.usual, channel)
    unit, times = shown_unit(out.unit)
    return f"{number(times * out.value)} {unit}", f"{plus_minus(times * out.usual, times * out.scatter)} {unit}"


def _times(times: float) -> str:
    return "no other scatters" if math.isinf(times) else number(times, 2)


def _drifting(ran: FleetResults) -> Iterator[Content]:
    """Constants between each robot's first and last run."""
    current = set(ran.now)
    drifts, robots = drifting([row for row in ran.rows if row["robot"] in current])
    if not robots:
        yield tag(
            "p", "No robot was measured twice yet. Once some are, their first and their last runs are compared here."
        )
        return
    beyond = [drift for drift in drifts if drift.significant]
    yield tag(
        "p",
        f"Of {plural(robots, 'robot')} measured more than once the last run was set beside the first that told the same "
        f"constants, {plural(len(drifts), 'constant')} in all: {len(beyond):,} moved by more than the noise has them move. Of "
        f"fleets in which nothing moves, at most {100 * FALSE_ALARMS:.0f} % have any constant said to move; the standard "
        "deviations know of noise alone, and an effect that a model lacks moves constants, too. ",
        tag("code", "aridcal history"),
        " follows every run, and says when a drift began.",
    )
    shown = [*beyond, *[drift for drift in drifts if not drift.significant][:MOST_WITHIN]]
    if shown:
        head = ["robot", "constant", "", "first", "last", "change", "days", "σ of the change"]
        yield table(
            head, [_drift(drift) for drift in shown], "Constants that moved most against their uncertainty", numbers=3
        )


def _drift(drift: Drift) -> list[Content]:
    unit, times = shown_unit(drift.unit)
    (x1, s1), (x2, s2) = drift.first, drift.last
    values = [plus_minus(times * x, times * s) for x, s in ((x1, s1), (x2, s2), (x2 - x1, math.hypot(s1, s2)))]
    verdict: Content = tag("strong", "moved") if drift.significant else "within chance"
    return [
        _name(drift.robot),
        drift.name,
        verdict,
        *(f"{value} {unit}" for value in values),
        fixed(drift.days, 0),
        number(drift.times, 2),
    ]


def _effects(done: Sequence[Row]) -> Iterator[Content]:
    """Effects by how many robots have them."""
    robots_of: dict[str, dict[str, list[Row]]] = {}
    for row in done:
        for coefficient in row["effects"]:
            robots_of.setdefault(coefficient["effect"], {}).setdefault(row["robot"], []).append(coefficient)
    if not robots_of:
        yield tag("p", "No robot has an effect beyond its constants.")
        return
    lines: list[list[Content]] = []
    for label, robots in sorted(robots_of.items(), key=lambda pair: (-len(pair[1]), pair[0])):
        gains = [own[0]["after"] / own[0]["before"] for own in robots.values() if own[0]["before"] and own[0]["after"]]
        gain = f"{100 * (1 - float(np.median(gains))):.0f} %" if gains else "–"
        declared = sum(own[0]["declared"] for own in robots.values())
        named = [*robots][:MOST_NAMED]
        more = f" and {len(robots) - len(named):,} more" if len(robots) > len(named) else ""
        lines.append(
            [label, f"{len(robots):,}", f"{declared:,}", _size([*robots.values()]), gain, ", ".join(named) + more]
        )
    head = ["effect", "robots", "declared", "largest coefficient, median", "takes off, median", "on"]
    caption = "Effects of the final models, those of most robots first; what each takes off the error of held-out rows"
    yield table(head, lines, caption, numbers=1)


def _size(robots: Sequence[Sequence[Row]]) -> str:
    """Median over robots of the largest coefficient."""
    largest = [max(own, key=lambda c: abs(c["value"] or 0.0)) for own in robots]
    unit, times = shown_unit(largest[0]["unit"])
    return f"{number(times * float(np.median([abs(c['value'] or 0.0) for c in largest])), 2)} {unit}"


def _notices(done: Sequence[Row]) -> Iterator[Content]:
    """Notices of all reports, each once, with how many have it."""
    count = Counter(notice for row in done for notice in set(row["notices"]))
    if not count:
        yield tag("p", "No notices.")
        return
    lines = [f"{notice} ({plural(times, 'robot')})" for notice, times in count.most_common()]
    yield bullets(lines, MOST_NOTICES, "notices of single robots, in their reports")


def _leading(rows: Sequence[Row]) -> list[str]:
    """Channels that judge some robot: the first of each."""
    return list(dict.fromkeys(_first(row) for row in rows if row["stages"]))


def _first(row: Row) -> str:
    """The channel that judges a robot."""
    return str(row["stages"][0]["channel"]) if row["stages"] else ""


def _rank(row: Row, channel: str) -> float:
    """What robots are ordered by: the final error; those without any are last."""
    error = error_of(row, "final", channel)
    return -math.inf if math.isnan(error) else error


def _unit(channel: str) -> str:
    return channel.rpartition("_")[2]


def _said(value: float, channel: str) -> str:
    return f"{number(value)} {_unit(channel)}"


def _name(robot: str) -> Markup:
    """A robot's name on one line."""
    return tag("span", robot, style="white-space: nowrap")


def _link(row: Row) -> Markup:
    """A robot's name, which leads to its report."""
    return tag("a", _name(row["robot"]), href=f"{quote(row['robot'])}/report.html")


def _verdict(word: str) -> str:
    """A verdict in a cell; one that a later version wrote as it is."""
    return VERDICTS[word].cell if word in VERDICTS else str(word)
