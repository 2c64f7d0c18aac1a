"""``report.html``: what a calibration found, on one page that needs nothing else."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from markupsafe import Markup

from aridcal import __version__
from aridcal.engine.rows.dataset import Dataset
from aridcal.jobs.calibrate.controllers import ControllerExports
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.html import Content, attempt, collect_notices, join, missing
from aridcal.pages.drawing.page_frame import Section, empty_page, framed_page
from aridcal.pages.report.data_section import data, enough
from aridcal.pages.report.dependence import drives
from aridcal.pages.report.first_screen import summary
from aridcal.pages.report.fit_section import fits, verification
from aridcal.pages.report.head_section import measuring_head
from aridcal.pages.report.identified_section import identifiable, identified
from aridcal.pages.report.instruments_section import instruments
from aridcal.pages.report.iso_section import iso
from aridcal.pages.report.limits_section import limits, use
from aridcal.system.progress import SILENT, Progress
from aridcal.system.reading.memory_release import give_back
from aridcal.system.wording import plural

# Anchor, title and content.
Chapter = tuple[str, str, Iterable[Content]]


def write_report(
    outcome: Outcome, handover: ControllerExports, path: Path, progress: Progress = SILENT
) -> tuple[str, ...]:
    """Write the report of a calibration; what cannot be drawn of it is missing, and the rest stands.

    Args:
        outcome: What was found.
        handover: What controllers can be given of it.
        path: The HTML file. It links to those files of a result that are beside it already.
        progress: Told how many pictures are drawn.

    Returns:
        Notices: what could not be drawn, and why.
    """
    beside = {file.name for file in path.parent.iterdir()}
    with collect_notices() as notices:
        text = attempt(
            "report.html",
            lambda: page(outcome, handover, progress, beside),
            lambda notice: empty_page("Calibration report", notice),
        )
    path.write_bytes(text.encode("utf-8", "replace"))  # names of files may hold what UTF-8 has not
    return tuple(notices)


def page(
    outcome: Outcome, handover: ControllerExports, progress: Progress = SILENT, beside: Collection[str] = frozenset()
) -> Markup:
    """The report as one self-contained HTML page; each of its sections fails alone.

    Args:
        outcome: What was found.
        handover: What controllers can be given of it.
        progress: Told how many sections are drawn.
        beside: Names of files that stand beside the page, which it links to.
    """
    chapters = _chapters(outcome, handover, progress, beside)
    head = draw_section("Summary", summary(outcome, beside))
    parts = []
    for key, title, content in progress.over(chapters, "sections"):
        give_back()  # what the section before it made of all rows
        parts.append(Section(title, draw_section(title, content), key))
    return framed_page(f"Calibration of {outcome.robot.tree.name}", head, parts, foot(outcome.measurements))


def foot(m: Dataset) -> str:
    """The last line of a page on one table of measurements: what made it, from which rows."""
    return f"aridcal {__version__}, {plural(len(m), 'row')} with sha256 {m.origin.sha256[:16]}"


def draw_section(title: str, content: Iterable[Content]) -> list[Content]:
    """A section's content up to where it fails, and then a line that says so."""
    parts: list[Content] = []

    def draw() -> None:
        for part in content:
            parts.append(join(part))

    attempt(f"report.html: the rest of section {title!r}", draw, lambda notice: parts.append(missing(notice)))
    return parts


def _chapters(
    outcome: Outcome, handover: ControllerExports, progress: Progress, beside: Collection[str]
) -> list[Chapter]:
    """The six questions, then what was identified and which file is for what."""
    chapters: list[Chapter] = [
        ("data", "1. Is the data sound?", data(outcome)),
        ("separable", "2. Which parameters are identifiable?", identifiable(outcome)),
        ("enough", "3. Is there enough data, in the right places?", enough(outcome)),
        ("fits", "4. Does the model fit?", fits(outcome)),
        ("depends", "5. What drives the remaining error?", drives(outcome, progress)),
        ("remains", "6. Where does the calibration hold?", limits(outcome)),
    ]
    chapters.append(("iso", "ISO 9283", iso(outcome)))
    if outcome.verification is not None:
        chapters.append(("verification", "Verification on another day's data", verification(outcome)))
    if not outcome.measurements.direct and (outcome.head is None or outcome.things):  # a head has a chapter of its own
        chapters.append(("instruments", "Instruments", instruments(outcome)))
    chapters.append(("parameters", "What was identified", identified(outcome)))
    if outcome.head is not None:
        chapters.append(("head", "The measuring head", measuring_head(outcome)))
    chapters.append(("use", "How to use the result", use(outcome, handover, beside)))
    return chapters
