"""The report on the measurements: are they sound, are there enough, and in the right places?"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS, labelled
from aridcal.engine.rows.dataset import Dataset
from aridcal.jobs.calibrate.instrument_results import known_scale_sigma
from aridcal.jobs.calibrate.key_figures import QUESTIONABLE_OUTLIERS, JointRange, joint_ranges, row_errors
from aridcal.jobs.calibrate.outcome import Outcome, statistics
from aridcal.pages.drawing.figures import coverage, histogram
from aridcal.pages.drawing.html import Content, bullets, figures, fold, table, tag
from aridcal.pages.drawing.words import per_number, sigmas_in_words
from aridcal.system.wording import number, plural, range_in_words

# Lines of a list of rows.
MOST_LINES = 25

NOTICES_IN_SIGHT = 3


def data(outcome: Outcome) -> Iterator[Content]:
    """Question 1: is the data sound?"""
    m = outcome.measurements
    flagged = int(outcome.outlier.sum())
    if flagged > QUESTIONABLE_OUTLIERS * len(m):
        share = 100 * flagged / len(m)
        yield tag(
            "p",
            f"{share:.0f} % of the rows are outliers. More than {100 * QUESTIONABLE_OUTLIERS:.0f} % points to a fault in the "
            "measurement itself: check for a loose target, a late trigger, mixed-up files or a joint in the wrong unit.",
            class_="look",
        )
    yield _repeats(outcome)
    first, more = outcome.notices[:NOTICES_IN_SIGHT], outcome.notices[NOTICES_IN_SIGHT:]
    if first:
        yield bullets(first)
    if more:
        yield fold(f"{plural(len(more), 'more notice')}", bullets(more, MOST_LINES, "more; result.json lists them all"))
    yield _row_counts(outcome)
    if flagged:
        yield fold(f"{plural(flagged, 'outlier')}", _outliers(outcome))
    if m.origin.refused:
        remarks = [str(remark) for remark in m.origin.refused]
        title = f"{plural(len(remarks), 'refused row')}"
        yield fold(title, bullets(remarks, MOST_LINES, "more; result.json lists them all"))


def _row_counts(outcome: Outcome) -> Markup:
    """How many rows there are, and what became of them."""
    m, parts = outcome.measurements, outcome.parts()
    refused = len(m.origin.refused)
    split = "as the table says" if m.origin.split_given else "split by configuration, the same in every run"
    counts = {
        "read": len(m) + refused,
        "refused: unusable": refused,
        "outliers: neither fitted nor scored": outcome.outlier.sum(),
        "stale: the measurement did not change although the joints moved": outcome.measurements.repeats.stale.sum(),
        "fitted": parts["train"].sum(),
        f"held out, to judge the result ({split})": parts["test"].sum(),
    }
    files = ", ".join(path.name for path in m.origin.files)
    lines = [[what, f"{count:,}"] for what, count in counts.items()]
    title = f"{len(m) + refused:,} rows read, {counts['fitted']:,} fitted, {parts['test'].sum():,} held out"
    shown = table(["rows", "number"], lines, f"Rows of {files}")
    return fold(title, shown, _blocks(outcome) if len(m.blocks) > 1 else "")


def _blocks(outcome: Outcome) -> Markup:
    """The rows of each instrument, and the noise that it has."""
    m, parts = outcome.measurements, outcome.parts()
    lines = []
    first = 0
    for b, block in enumerate(m.blocks):
        own = m.labels.block == b
        last = first + len(block.channels)
        counts = [own, own & parts["train"], own & parts["test"], own & outcome.outlier]
        noise = sigmas_in_words(outcome.noise[first:last], block.channels)
        lines.append([block.name, MEASUREMENT_KINDS[block.kind].words, *(f"{mask.sum():,}" for mask in counts), noise])
        first = last
    head = ["block", "measures", "rows", "fitted", "held out", "outliers", "noise of each number"]
    return table(head, lines, "Rows of each block", numbers=2)


def _repeats(outcome: Outcome) -> Content:
    """Scatter of configurations that were measured more than once."""
    repeats, several = outcome.repeats, not outcome.measurements.direct
    if repeats is None:
        nothing = (
            "Nothing was measured twice at one configuration" if several else "No configuration was measured twice"
        )
        images = any(block.traits.images for block in outcome.measurements.blocks)
        marks = " (several marks in one image repeat nothing: a second image there would)" if images else ""
        return tag(
            "p",
            f"{nothing}{marks}, so the noise cannot be told from the error of the model. Repeat a few poses next time.",
        )
    repeatability = (
        ""
        if math.isnan(repeats.repeatability)
        else f" Over all of them, the mean distance to the centre plus three standard deviations is "
        f"{number(1e3 * repeats.repeatability)} mm{'' if several else ' (RP of each pose: section ISO 9283)'}."
    )
    what = "measurement was repeated" if repeats.groups == 1 else "measurements were repeated"
    repeated = (
        f"{repeats.groups:,} {what} at the same configuration, of the same thing"
        if several
        else (f"{plural(repeats.groups, 'configuration')} measured more than once")
    )
    return tag(
        "p",
        f"{repeated} ({plural(repeats.rows, 'row')}). "
        f"Repeats scatter by {sigmas_in_words(repeats.sigma, outcome.channels)} (1σ {per_number(outcome)}).{repeatability}",
    )


def _outliers(outcome: Outcome) -> list[Content]:
    """The flagged rows by file and line."""
    as_read = outcome.measurements.as_read
    rows = as_read[outcome.outlier[as_read]]
    why = ["stale" if outcome.measurements.repeats.doubtful[k] else "gross outlier" for k in rows]
    shown = row_table(outcome, rows[:MOST_LINES], "why", why[:MOST_LINES], "Outliers and their error after calibration")
    rest = len(rows) - MOST_LINES
    return [shown, tag("p", tag("em", f"and {rest:,} more; residuals.csv flags them all")) if rest > 0 else ""]


def row_table(outcome: Outcome, rows: np.ndarray, head: str, words: list[str], caption: str) -> Markup:
    """Some rows with the error that the final model leaves.

    Args:
        outcome: What was found.
        rows: Their numbers, shape (n,).
        head: Title of a column with a word on each.
        words: What stands in it, n of them.
        caption: What the table shows.
    """
    m = outcome.measurements
    row_error = row_errors(outcome.stages[-1].residual[rows], outcome.channels)
    lines = []
    for i, (k, word) in enumerate(zip(rows, words, strict=True)):
        part = "held out" if m.test[k] else "fitted"
        lines.append([row_place(m, int(k)), part, word, *(number(error[i]) for error in row_error)])
    titles = [channel.title for channel in outcome.channels]
    return table(["row", "part", head, *titles], lines, caption, numbers=3)


def row_place(m: Dataset, k: int) -> str:
    """Where a row stands, and what it refers to."""
    return f"{m.origin.files[m.origin.file[k]].name}, line {m.origin.line[k]}{_of_things(m, k)}"


def _of_things(m: Dataset, k: int) -> str:
    """What a row refers to, in brackets."""
    roles = labelled(m.blocks[m.labels.block[k]].kind)
    labels = [str(label) for label in m.labels.refers[k, : len(roles)] if label]
    return f" ({', '.join(labels)})" if labels else ""


def enough(outcome: Outcome) -> Iterator[Content]:
    """Question 3: is there enough data, in the right places?"""
    precision, joints = outcome.precision, joint_ranges(outcome)
    placed = known_scale_sigma(outcome.measurements) is not None
    certainty = outcome.certainty
    sigma = {"at the fitted rows": 1e3 * precision.position}
    if certainty is not None and certainty.anywhere.observable.any():
        sigma["over the whole joint range"] = 1e3 * certainty.anywhere.sigma[certainty.anywhere.observable]
    placed = placed and (certainty is None or bool(certainty.anywhere.observable.any()))
    yield _pictures(joints, sigma if placed else {})
    named = {f"{name} [mm]": values for name, values in sigma.items() if placed}
    if outcome.measurements.sees_turns:
        named["rotation, at the fitted rows [mrad]"] = 1e3 * precision.rotation
    yield tag("p", "The noise of these measurements causes this uncertainty. Errors that the model lacks come on top.")
    if named:
        (what, unit), values = next((name[:-1].split(" ["), values) for name, values in named.items())
        median = f"median {number(float(np.median(values)))} {unit}"
        yield fold(f"1σ of the target {what}: {median}", _uncertainty_table(named))
    yield fold("Measured range of each joint", _joint_table(joints))


def _uncertainty_table(named: dict[str, np.ndarray]) -> Markup:
    """Statistics of the target's 1 sigma, by where it is and its unit."""
    scores = {name: statistics(values) for name, values in named.items()}
    lines = [
        [name, *(number(statistic[key]) for key in ("median", "p95", "max"))] for name, statistic in scores.items()
    ]
    caption = "1σ of the calibrated target in its worst direction"
    return table(["", "median", "95 % below", "max"], lines, caption)


def _pictures(joints: list[JointRange], sigma: dict[str, np.ndarray]) -> Markup:
    """Readings between their limits, and the uncertainty of the target [mm] where anything measured its place."""
    limits = [range_in_words(j.limits, j.kind) for j in joints]
    names, shares = [j.name for j in joints], [j.share for j in joints]
    where = coverage("coverage", "Histogram of each joint's readings between its limits", names, shares, limits)
    drawn: list[tuple[Content, Markup]] = [("Readings of each joint between its limits", where)]
    if sigma:
        label = "1σ of the target, worst direction [mm]"
        picture = histogram("precision", f"Histogram of the {label}", sigma, label)
        drawn.append(("Uncertainty of the calibrated target, propagated from the measurement noise", picture))
    return figures(drawn)


def _joint_table(joints: list[JointRange]) -> Markup:
    """Limits and measured range of every joint."""
    lines: list[list[Content]] = []
    for j in joints:
        limits, measured = range_in_words(j.limits, j.kind), range_in_words(j.range, j.kind)
        lines.append([tag("code", j.name), limits, measured, f"{100 * j.measured:.0f} %"])
    head = ["joint", "limits", "measured", "share of the range, or of one turn"]
    return table(head, lines, "Joint ranges of the fitted rows")
