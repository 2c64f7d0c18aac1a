"""``study.html``: what a study found, with its intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from markupsafe import Markup

from aridcal import __version__
from aridcal.jobs.fleet.run_record import FAILED, Row
from aridcal.jobs.fleet.study_figures import (
    INTERVAL_CONFIDENCE,
    CaseFigures,
    Estimate,
    points,
    recurrent_effects,
    scatters,
)
from aridcal.jobs.fleet.study_records import StudyResult
from aridcal.pages.drawing.figures import COLOURS, banded_curves
from aridcal.pages.drawing.html import Content, figures, table, tag
from aridcal.pages.drawing.page_frame import framed_page, sections
from aridcal.pages.fleet_sections import draw_section
from aridcal.system.errors import shortened
from aridcal.system.wording import number, plural, shown_unit

INTERVAL = f"{100 * INTERVAL_CONFIDENCE:.0f} % interval"

MOST_ERRORS = 10
"""Different reasons of failed runs that are told."""


def study_page(done: StudyResult, title: str, effect: str, halves: bool) -> Markup:
    """The page of a study, self-contained.

    Args:
        done: Its runs.
        title: Of the scenario or the campaign.
        effect: Whose size is varied, or what is sought; empty where nothing is.
        halves: True for halves of a campaign's rows.
    """
    cases = points(done.rows)
    chapters: list[tuple[str, Callable[[], Iterator[Content]]]] = []
    if effect and any(point.finding_share is not None for point in cases):
        chapters.append(("Is it found?", lambda: _power(cases, effect)))
    chapters.append(("How large is the error?", lambda: _error(cases, done.rows)))
    if halves:
        chapters.append(("What is found again?", lambda: _again(done.rows)))
        chapters.append(("Are the constants known as well as stated?", lambda: _constants(done.rows)))
    failed = [row for row in done.rows if row["status"] == FAILED]
    if failed or done.remaining:
        chapters.append(("Not done", lambda: _not_done(failed, done)))
    heading = f"{plural(len(done.rows), 'run')}"
    drawn_once = len({row["run"] for row in done.rows})
    how = "each from half of the fitted rows" if halves else f"{plural(drawn_once, 'machine')} in each case"
    head = [tag("p", f"Study of {title}", class_="about"), tag("h1", heading), tag("p", f"{heading}, {how}.")]
    parts = sections([(name, draw_section("study.html", name, content)) for name, content in chapters])
    return framed_page(f"{heading}: {title}", head, parts, f"aridcal {__version__}; every run is in study.parquet")


def _power(cases: Sequence[CaseFigures], effect: str) -> Iterator[Content]:
    """Shares of runs that find the effect."""
    yield tag(
        "p",
        f"Sought is {effect}. Found means: it is named, or the report says that what is named cannot be told from it. "
        "With size 0 there is none of it, and a run that finds it is wrong.",
    )
    yield figures(_by_rows_or_sizes(cases, "runs that find it [%]", lambda p: _percents(p.finding_share), 100.0))
    lines = [
        [_case(p), plural(p.runs, "run"), *(_share(value) for value in (p.finding_share, p.named, p.others))]
        for p in cases
    ]
    head = ["case", "", "found", "named itself", "something that is not there"]
    yield table(head, lines, f"Shares of runs, with their {INTERVAL} (Wilson)", numbers=1)


def _error(cases: Sequence[CaseFigures], rows: Sequence[Row]) -> Iterator[Content]:
    """Median errors."""
    channel = next((row["channel"] for row in rows if row.get("channel")), "")
    unit = channel.rpartition("_")[2]
    if any(p.true is not None for p in cases):
        yield tag(
            "p",
            "Against the truth: where the final model says that the target is, and where it really was, at held-out rows. The "
            "measured error also has the noise of the rows themselves.",
        )
        pictures = _by_rows_or_sizes(cases, "error against the truth, RMS [mm]", lambda p: _triple(p.true), None)
        yield figures(pictures)
    true = any(p.true is not None for p in cases)
    lines = [
        [_case(p), plural(p.runs, "run"), *([_median(p.true, "mm")] if true else []), _median(p.final, unit)]
        for p in cases
    ]
    head = ["case", "", *(["against the truth"] if true else []), "as measured"]
    yield table(head, lines, f"RMS error of the final model: median of the runs, with its {INTERVAL}", numbers=1)


def _again(rows: Sequence[Row]) -> Iterator[Content]:
    """Effects of the halves."""
    shares = recurrent_effects(rows)
    if not shares:
        yield tag("p", "No half of the rows shows an effect beyond the constants.")
        return
    yield tag(
        "p",
        "Half of the rows show less than all of them: an effect that most halves find does not hang on single rows.",
    )
    lines = [[label, _share(estimate)] for label, estimate in shares]
    yield table(["effect", "of the runs"], lines, f"Effects that were found, with the {INTERVAL} of each share")


def _constants(rows: Sequence[Row]) -> Iterator[Content]:
    """Scatter of the constants over halves of the rows."""
    yield tag(
        "p",
        "Over halves of the rows, drawn without replacement, a constant scatters as much as over new measurements of all rows. "
        "Where that is more than stated, something is left that is not independent noise.",
    )
    lines: list[list[Content]] = []
    for s in scatters(rows):
        unit, times = shown_unit(s.unit)
        stated = times * s.std / np.sqrt(2.0)
        value, low, high = (number(times * v, 2) for v in (s.scatter, s.low, s.high))
        ratio = number(times * s.scatter / stated, 2) if stated > 0 else "–"
        lines.append([s.name, f"{value} ({low} … {high}) {unit}", f"{number(stated, 2)} {unit}", ratio, f"{s.runs:,}"])
    head = ["constant", "scatters by", "stated, for all rows", "ratio", "runs"]
    caption = (
        f"Standard deviation over the runs with its {INTERVAL}, and what the calibrations state: of a half, over √2"
    )
    yield table(head, lines, caption)


def _not_done(failed: Sequence[Row], done: StudyResult) -> Iterator[Content]:
    """Why runs failed, and how many remain."""
    count = Counter(str(row["error"]) for row in failed)
    if count:
        lines = [[f"{times:,}", shortened(why, 500)] for why, times in count.most_common(MOST_ERRORS)]
        yield table(["runs", "why"], lines, "Runs that failed", numbers=2)
    if done.remaining:
        yield tag("p", f"{plural(done.remaining, 'run')} not done, for {done.gone}.")


def _by_rows_or_sizes(
    cases: Sequence[CaseFigures],
    label: str,
    of: Callable[[CaseFigures], tuple[float, float, float]],
    top: float | None,
) -> list[tuple[Content, Markup]]:
    """Curves against the number of rows, one for each size; against sizes, one for each number of rows; what is varied."""
    rows = sorted({p.rows for p in cases if p.rows is not None})
    sizes = sorted({p.size for p in cases if p.size is not None})
    at = {(p.rows, p.size): of(p) for p in cases}
    nothing = (np.nan,) * 3
    pictures: list[tuple[Content, Markup]] = []
    if len(rows) > 1:
        chosen = _spread(sizes or [None])
        curves = {
            "runs" if size is None else f"size {size:g}": np.array([at.get((n, size), nothing) for n in rows])
            for size in chosen
        }
        picture = banded_curves(f"{label}-rows", f"{label} against rows", np.array(rows), curves, ("rows", label), top)
        pictures.append((f"Against the number of rows; bands are {INTERVAL}s", picture))
    if len(sizes) > 1:
        curves = {f"{n:,} rows": np.array([at.get((n, size), nothing) for size in sizes]) for n in _spread(rows)}
        picture = banded_curves(
            f"{label}-size", f"{label} against the size", np.array(sizes), curves, ("size", label), top
        )
        pictures.append(("Against the size of the effect, in what the scenario states", picture))
    return pictures


def _spread(values: Sequence) -> list:
    """As many of the values as there are colours, from the smallest to the largest."""
    if len(values) <= len(COLOURS):
        return list(values)
    return [values[k] for k in np.linspace(0, len(values) - 1, len(COLOURS)).round().astype(int).tolist()]


def _case(point: CaseFigures) -> str:
    """Which case it is."""
    parts = [f"{point.rows:,} rows"] if point.rows is not None else ["half of the rows"]
    parts += [f"size {point.size:g}"] if point.size is not None else []
    return ", ".join(parts)


def _triple(estimate: Estimate | None) -> tuple[float, float, float]:
    return (np.nan,) * 3 if estimate is None else (estimate.value, estimate.low, estimate.high)


def _percents(estimate: Estimate | None) -> tuple[float, float, float]:
    value, low, high = _triple(estimate)
    return 100 * value, 100 * low, 100 * high


def _share(estimate: Estimate | None) -> str:
    if estimate is None:
        return "–"
    return f"{100 * estimate.value:.0f} % ({100 * estimate.low:.0f} … {100 * estimate.high:.0f})"


def _median(estimate: Estimate | None, unit: str) -> str:
    if estimate is None:
        return "–"
    return f"{number(estimate.value)} ({number(estimate.low)} … {number(estimate.high)}) {unit}"
