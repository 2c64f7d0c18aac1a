"""A page that shows what planned configurations cover."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from aridcal import __version__
from aridcal.engine.robot.chain import Robot
from aridcal.jobs.calibrate.key_figures import joint_range
from aridcal.jobs.plan.discrimination import duel_lines
from aridcal.jobs.plan.plan_coverage import Sigma
from aridcal.jobs.plan.pose_design import Plan
from aridcal.pages.drawing.fields import color_steps, field
from aridcal.pages.drawing.figures import coverage, falling
from aridcal.pages.drawing.html import Content, bullets, figures, fold, table, tag
from aridcal.pages.drawing.page_frame import framed_page, sections
from aridcal.system.wording import number, plural, range_in_words, reading_in_words

VIEWS = {"from above": (0, 1), "from the side": (0, 2)}
"""Two planes in which targets are shown: numbers of their axes."""

INDICES = (
    ("O1", "size of all singular values together, per row"),
    ("O2", "smallest over largest: 1 over the condition number"),
    ("O3", "smallest: what the least known combination shows"),
    ("O4", "smallest squared over largest: noise amplification index"),
    ("O5", "harmonic mean of all, over their number"),
)
"""Observability indices as Sun and Hollerbach (2008) number them."""

LEAST_TIMES_USUAL_LOSS = 2.0
"""A configuration that matters to a suspect so many times as much as the mean one is named for it."""

MOST_NAMED_SUSPECTS = 3
"""Suspects named for one configuration, those first to which it matters most."""


def plan_page(plan: Plan, robot: Robot, title: str) -> Markup:
    """The page of a plan, self-contained.

    Args:
        plan: What was chosen.
        robot: The chain.
        title: What the plan is for.
    """
    n = len(plan.readings)
    heading = f"{plural(n, 'configuration')} to measure"
    chapters = [
        ("How many?", _how_many(plan)),
        ("Where?", _where(plan, robot)),
        ("What do they tell?", _telling(plan)),
        ("One by one", _one_by_one(plan, robot)),
    ]
    head = [tag("p", title, class_="about"), tag("h1", heading), *_summary(plan)]
    parts = sections([(name, list(content)) for name, content in chapters])
    return framed_page(f"{heading}: {title}", head, parts, f"aridcal {__version__}")


def _summary(plan: Plan) -> Iterator[Content]:
    """The plan's figure beside chance's, and what was assumed."""
    at = plan.at_n
    if plan.duels:
        yield tag("p", "They are to tell two effects apart, and each from whatever else could stand in its place:")
        yield bullets(duel_lines(plan.duels))
    elif np.isnan(at.rms):
        yield tag("p", "So few rows do not tell where the target is: some of the unknowns stay as they were assumed.")
    else:
        chance = (
            f", with as many random ones {_mm(plan.random)} (median of 100 draws)" if np.isfinite(plan.random) else ""
        )
        yield tag(
            "p",
            f"With them the target is known over the region to {_mm(at.rms)} RMS over three axes{chance}; in the worst direction "
            f"at the worst place to {_mm(at.worst)}. That is what the noise leaves, if the model has all that the arm does: a "
            "prediction, not a promise.",
        )
    if plan.measured:
        yield tag("p", f"They add to {plural(plan.measured, 'row')} measured before.")
    if plan.notices:
        yield bullets(plan.notices)


def _how_many(plan: Plan) -> Iterator[Content]:
    """Sigma against the number of configurations."""
    against = plan.coverage.against
    at = np.array([s.n for s in against])
    n = len(plan.readings)
    what = "what the two effects do to the target" if plan.duels else "the target"
    lines = {
        "three axes": 1e3 * np.array([s.rms for s in against]),
        "worst direction": 1e3 * np.array([s.worst for s in against]),
    }
    if not np.isnan(plan.at_n.rms):
        labels = ("new configurations", "σ [mm]")
        picture = falling("sigma", "Sigma of the target against the number of configurations", at, lines, labels)
        yield figures([(f"Uncertainty of {what} over the region, the best configurations first", picture)])
    rows = [[_count(s.n, n), _mm(s.rms), _mm(s.worst)] for s in plan.sigma]
    yield table(
        ["new configurations", "three axes, RMS", "worst direction, worst place"], rows, "Predicted σ of the target"
    )
    more = plan.sigma[-1]
    if more.n > n and not np.isnan(plan.at_n.rms):
        yield tag("p", worth(plan.at_n, more, plan.measured))


def _count(count: int, planned: int) -> str:
    """A number of configurations; the plan's own is marked."""
    return f"{count} (this plan)" if count == planned else str(count)


def worth(now: Sigma, more: Sigma, measured: int) -> str:
    """What more configurations would gain, in words; beside the same ones again, where no rows measured before count, too."""
    gain, twice = (100 * (1.0 - share) for share in (more.rms / now.rms, (now.n / more.n) ** 0.5))
    again = "" if measured else f"; measuring these again so many times, {twice:.0f} %"
    return f"{more.n - now.n} more of them would take {gain:.0f} % off{again}."


def _where(plan: Plan, robot: Robot) -> Iterator[Content]:
    """Targets in two views, and ranges of the joints."""
    region = plan.coverage
    sigma = 1e3 * region.worst
    colors = color_steps(sigma)
    drawn: list[tuple[Content, Markup]] = []
    for name, axes in VIEWS.items():
        labels = tuple(f"{'xyz'[axis]} [m]" for axis in axes)
        rings = {"planned": region.targets[:, axes]}
        text = f"Planned targets and the region's sigma, seen {name}"
        picture = field(
            name.replace(" ", "-"), text, region.places[:, axes], sigma, (labels[0], labels[1]), "mm", colors, marks=rings
        )  # fmt: skip
        drawn.append((f"Seen {name}: dots are places of the region with their σ in the worst direction", picture))
    ranges = [joint_range(*j) for j in zip(robot.readings, robot.kinds, robot.limits, plan.readings.T, strict=True)]
    limits = [range_in_words(j.limits, j.kind) for j in ranges]
    text = "Histogram of each joint's planned readings between its limits"
    shares = coverage("joints", text, [j.name for j in ranges], [j.share for j in ranges], limits)
    drawn.append(("Planned readings of each joint between its limits", shares))
    yield figures(drawn)
    rows = [
        [j.name, range_in_words(j.limits, j.kind), range_in_words(j.range, j.kind), f"{100 * j.measured:.0f} %"]
        for j in ranges
    ]
    head = ["joint", "limits", "planned", "share covered, of a turn at most"]
    yield fold("Planned range of each joint", table(head, rows, "Ranges of the joints"))


def _telling(plan: Plan) -> Iterator[Content]:
    """Observability indices, and how much each suspect hangs on single configurations."""
    rows = [[name, words, number(value)] for (name, words), value in zip(INDICES, plan.indices, strict=True)]
    caption = (
        "Observability indices of frames and constants, in σ per m and rad (Sun and Hollerbach 2008); larger is better"
    )
    shown = table(["index", "what it is", "value"], rows, caption, numbers=2)
    yield fold(f"Observability indices: O1 {number(plan.indices[0])}", shown)
    coverage = plan.coverage
    if not coverage.suspects:
        yield tag(
            "p", "No effect beyond constants was planned for: declare some under ", tag("code", "effects"), " first."
        )
        return
    lines: list[list[Content]] = []
    for name, loss in zip(coverage.suspects, coverage.loss.T, strict=True):
        best = np.argsort(-loss, kind="stable")[:MOST_NAMED_SUSPECTS]
        words = ", ".join(f"{k + 1} ({_percent(loss[k])})" for k in best.tolist())
        lines.append([name, words])
    caption = (
        "Effects that may be there, and the configurations that tell each from all else: by how much its variance grows without "
        "them"
    )
    yield table(["suspect", "told most of by"], lines, caption, numbers=2)


def _one_by_one(plan: Plan, robot: Robot) -> Iterator[Content]:
    """Every configuration: its joints, from where it is come to, and what it is there for."""
    titles = plan.titles if any(plan.titles) else None
    head = [
        "",
        *robot.readings,
        *(["measures"] if titles else []),
        *(["by way of"] if plan.directions else []),
        "tells most of",
    ]
    coverage, lines = plan.coverage, []
    usual = coverage.loss.mean(axis=0)
    for k, reading in enumerate(plan.readings):
        joints = [reading_in_words(v, kind) for v, kind in zip(reading.tolist(), robot.kinds, strict=True)]
        loss = coverage.loss[k]
        telling = [
            i
            for i in np.argsort(-loss, kind="stable")[:MOST_NAMED_SUSPECTS]
            if loss[i] > LEAST_TIMES_USUAL_LOSS * usual[i]
        ]
        words = ", ".join(f"{coverage.suspects[i]} ({_percent(loss[i])})" for i in telling)
        way = ["a point before it" if plan.by_way[k] else "straight"] if plan.directions else []
        lines.append([str(k + 1), *joints, *([titles[k]] if titles else []), *way, words or "the geometry"])
    yield table(head, lines, "In the order of the visits", numbers=len(head))
    yield tag(
        "p", "The ways between configurations were not looked at: run programs slowly, with a hand on the stop button."
    )


def _mm(metres: float) -> str:
    return "not known" if np.isnan(metres) else f"{number(1e3 * metres)} mm"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share < 10 else f"×{1 + share:.0f}"
