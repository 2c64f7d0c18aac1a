"""``report.html`` of a repair: what moved, the new rows before and after, what is handed on, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from aridcal.engine.instruments.channels import Channel, norms
from aridcal.jobs.calibrate.controllers import ControllerExports
from aridcal.jobs.calibrate.outcome import errors
from aridcal.jobs.maintain.checking import CheckResult
from aridcal.jobs.maintain.repair import Repair, RepairChange
from aridcal.jobs.maintain.repaired_outcomes import RepairOutcomes
from aridcal.pages.drawing.html import Content, attempt, bullets, collect_notices, table, tag
from aridcal.pages.drawing.page_frame import Section, card, empty_page, framed_page
from aridcal.pages.report.identified_section import identified
from aridcal.pages.report.limits_section import use
from aridcal.pages.report.page import draw_section, foot
from aridcal.system.wording import number, plural, plus_minus, shown_unit

MOST_LISTED_ROWS = 40
"""New rows that the page lists; of more the worst."""


def write_repair_report(
    repair: RepairOutcomes,
    checked: CheckResult,
    mended: Repair,
    lineage: dict[str, Any],
    lines: list[str],
    handover: ControllerExports,
    path: Path,
) -> tuple[str, ...]:
    """Write the page of a repair.

    Args:
        repair: The repaired calibration as outcomes.
        checked: What the new rows said.
        mended: What was done.
        lineage: Where the calibration comes from.
        lines: What was found, in words.
        handover: What controllers are given.
        path: The HTML file.

    Returns:
        Notices: what could not be drawn, and why.
    """
    with collect_notices() as notices:
        text = attempt(
            "report.html",
            lambda: _page(repair, checked, mended, lineage, lines, handover),
            lambda notice: empty_page("Repair report", notice),
        )
    path.write_bytes(text.encode("utf-8", "replace"))
    return tuple(notices)


def _page(
    repair: RepairOutcomes,
    checked: CheckResult,
    mended: Repair,
    lineage: dict[str, Any],
    lines: list[str],
    handover: ControllerExports,
) -> Markup:
    """The whole page; each of its sections fails alone."""
    chapters = [
        ("moved", "1. What moved?", _moved(mended, lines)),
        ("rows", "2. Do the new rows fit now?", _rows(repair)),
        ("parameters", "3. What is the calibration now?", identified(repair.model)),
        ("use", "4. How to use the result", _use(repair, handover)),
        ("lineage", "5. Where does it come from?", _lineage(lineage)),
    ]
    m = repair.rows.measurements
    head = draw_section("Summary", _summary(repair, checked, mended))
    parts = [Section(title, draw_section(title, content), key) for key, title, content in chapters]
    return framed_page(f"Repair of {repair.rows.robot.tree.name}", head, parts, foot(m))


def _summary(repair: RepairOutcomes, checked: CheckResult, mended: Repair) -> Iterator[Content]:
    """The first screen: how far off before, how far now, and what moved."""
    m, robot = repair.rows.measurements, repair.rows.robot
    names = ", ".join(path.name for path in m.origin.files)
    yield tag("h1", f"Repair of {robot.tree.name}")
    yield tag("p", f"{names} · {plural(len(m), 'new row')} · {robot.path.name}, {robot.from_to}", class_="about")
    channels = [k for k, channel in enumerate(m.channels) if m.measures[:, k].any() and not channel.inner]
    yield tag("div", [_card(repair, k) for k in channels], class_="cards")
    moved = [change.cause.words for change in mended.changes]
    fitted = [f"{words}: fitted to the new rows; all else is kept as well as it was known." for words in moved]
    rest = "agrees with the noise" if repair.rows.verdict.word == "noise_floor" else "is more than the noise"
    trust = [
        f"What remains {rest} ({checked.rest.words}).",
        "“Left out” is the error of rows that what moved was not fitted to: the figure to expect of the next row.",
        "What moved was named with all of the rows: a few more, in other attitudes, are a test that is free of that.",
    ]
    yield tag(
        "div",
        tag("div", tag("h2", "What changed"), bullets(fitted)),
        tag("div", tag("h2", "Can I trust it?"), bullets(trust)),
        class_="answers",
    )


def _card(repair: RepairOutcomes, k: int) -> Markup:
    """Before, after and left out of one channel in large figures."""
    m = repair.rows.measurements
    channel, noise = m.channels[k], float(repair.rows.noise[k])
    every = ~repair.rows.outlier
    before, after, left = (
        errors(residual, every, m.channels)[channel.key]["rms"]
        for residual in (repair.rows.stage("before").residual, repair.rows.stage("final").residual, repair.left_out)
    )
    unit = channel.shown
    per_axis = f" per number; {channel.size} numbers a row" if channel.size > 1 else ""
    out = "cannot be said" if np.isnan(left) else f"{number(left)} {unit}"
    of_noise = f"The noise is {number(channel.scale * noise)} {unit}{per_axis}."
    said = f"before → after the repair, on the new rows. Left out: {out}. {of_noise}"
    return card(channel.noun, unit, ("before the repair", before), ("after the repair", after), said)


def _moved(mended: Repair, lines: list[str]) -> Iterator[Content]:
    """What moved, by how much, and what the rows cannot tell it from."""
    yield bullets([line.strip() for line in lines])
    yield table(
        ["coefficient", "change", "probability of the cause"],
        [line for change in mended.changes for line in _changes(change)],
        "Fitted to the new rows",
        numbers=1,
    )


def _changes(change: RepairChange) -> Iterator[list[Content]]:
    """A line for each coefficient of what moved."""
    for name, unit, value, std in zip(change.names, change.units, change.value, change.std, strict=True):
        shown, scale = shown_unit(unit)
        sure = "stated" if change.cause.kind == "new" else f"{100 * min(change.cause.probability, 0.999):.1f} %"
        yield [tag("code", name), f"{plus_minus(scale * value, scale * std)} {shown}", sure]


def _rows(repair: RepairOutcomes) -> Iterator[Content]:
    """Errors of each new row: before, after, and left out."""
    m, last = repair.rows.measurements, repair.rows.stage("final").residual
    columns = [
        norms(residual, m.channels) for residual in (repair.rows.stage("before").residual, last, repair.left_out)
    ]
    channels = [k for k in range(len(m.channels)) if m.measures[:, k].any()]
    order = (
        m.as_read
        if len(m) <= MOST_LISTED_ROWS
        else np.argsort(-np.nan_to_num(columns[1][channels[0]]))[:MOST_LISTED_ROWS]
    )
    lines: list[list[Content]] = []
    for row in order.tolist():
        own = [k for k in channels if m.measures[row, k]]
        part = "odd, not used" if repair.rows.outlier[row] else "held out" if m.test[row] else "used"
        cells = [", ".join(_shown(c[k][row], m.channels[k]) for k in own) for c in columns]
        lines.append([f"{m.origin.files[m.origin.file[row]].name}, row {m.origin.line[row]}", part, *cells])
    which = "" if len(m) <= MOST_LISTED_ROWS else f"; the {MOST_LISTED_ROWS} worst of {len(m)}"
    yield table(["new row", "part", "before", "after", "left out"], lines, f"Error of each new row{which}", numbers=2)


def _use(repair: RepairOutcomes, handover: ControllerExports) -> Iterator[Content]:
    """Which file is for what, and what each export loses."""
    yield tag(
        "p",
        "Errors here are distances from the repaired model, where it was calibrated: what each export loses of it. What the "
        "model itself is off by stands in section 2. Where there is a ",
        tag("code", "model.urdf"),
        ", it is valid only together with the effects in calibration.yaml.",
    )
    yield from use(repair.model, handover)


def _shown(value: float, channel: Channel) -> str:
    return "–" if np.isnan(value) else f"{number(channel.scale * float(value))} {channel.shown}"


def _lineage(lineage: dict[str, Any]) -> Iterator[Content]:
    """The calibrations before this one, the last first."""
    lines: list[list[Content]] = []
    at: dict[str, Any] | None = lineage
    while at is not None:
        rows, moved = at["rows"], [*at.get("moved", ()), *at.get("fitted_anew", ())]
        what = f"{len(rows['used'])} rows of {', '.join(rows['files'])}"
        lines.append([tag("code", at["from"]), at["sha256"][:16], what, ", ".join(moved)])
        at = at.get("before")
    yield table(
        ["calibration before", "sha256", "repaired with", "fitted"], lines, "Lineage, the last repair first", numbers=4
    )
