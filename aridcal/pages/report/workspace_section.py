"""The report on how well the target is known over the workspace, and what a region keeps within."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from aridcal.engine.trust.certainty import Certainty
from aridcal.engine.trust.workspace import Workspace
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.fields import color_steps, field
from aridcal.pages.drawing.html import Content, figures, fold, table, tag
from aridcal.system.wording import number


def workspace(outcome: Outcome) -> Iterator[Content]:
    """Pictures of slices, a table of the whole range and of the region, and what is kept within."""
    certainty = outcome.certainty
    if certainty is None:
        return
    lines = [_line("the joints' whole range", certainty.anywhere), _line(certainty.title, certainty.region)]
    if not any(part.observable.any() for part in (certainty.anywhere, certainty.region)):
        yield tag("p", "No reading tells where the target is: a part of what moves it is seen by no instrument.")
        return
    head = [
        "1σ of the position in its worst direction, mm",
        "median",
        "95 % below",
        "worst",
        "where, base frame [m]",
        "measured",
    ]
    said = tag(
        "p",
        "Each dot is a configuration within the joints' limits that brings the target near the plane. A dot with a hole was not "
        "measured: it is outside the measured ranges, or its prediction is three times as uncertain as at any fitted row. What "
        "the model lacks there, nobody knows.",
    )
    shown = table(head, lines, "Uncertainty of the target over the workspace")
    sure = certainty.anywhere.sigma[certainty.anywhere.observable]
    median = f": median {number(1e3 * float(np.median(sure)))} mm" if len(sure) else ""
    yield fold(f"1σ of the target over the workspace{median}", shown, figures(_slices(certainty)), said)
    parts = list(_parts_of_bounds(certainty))
    if parts:
        yield fold(f"What the errors in {certainty.title} consist of", parts)


def _parts_of_bounds(certainty: Certainty) -> Iterator[Markup]:
    """What each bound of the first screen consists of: the calibration's uncertainty, and what held-out rows leave beyond."""
    for part in certainty.tolerances:
        if not part.rows or np.isnan(part.calibration):
            continue
        unit = "mrad" if part.of == "rotation" else "mm"
        sure, rest = (f"{number(1e3 * size)} {unit}" for size in (part.calibration, part.excess))
        yield tag(
            "p",
            f"{part.of.capitalize()}: the calibration's own uncertainty is {sure} RMS. {part.judges.capitalize()} leave "
            f"{rest} RMS beyond it and the instrument's declared noise: what the model lacks, and what the arm does not repeat.",
            *(f" Note: {remark}." for remark in part.remarks),
        )


def _line(title: str, part: Workspace) -> list[Content]:
    """Statistics of the configurations where the target is known."""
    sigma = 1e3 * part.sigma[part.observable]
    if not len(sigma):
        return [title, "not known", "", "", "", ""]
    worst = int(np.argmax(np.where(part.observable, part.sigma, -1.0)))
    where = ", ".join(f"{value:.2f}" for value in part.places[worst])
    shown = (np.median(sigma), np.percentile(sigma, 95), sigma.max())
    return [title, *(number(float(value)) for value in shown), where, f"{100 * part.measured.mean():.0f} %"]


def _slices(certainty: Certainty) -> list[tuple[Content, Markup]]:
    """A picture of each slice."""
    drawn: list[tuple[Content, Markup]] = []
    parts = [
        (cut, cut.workspace.select(cut.workspace.observable))
        for cut in certainty.slices
        if cut.workspace.observable.any()
    ]
    if not parts:
        return drawn
    colors = color_steps(1e3 * np.concatenate([part.sigma for _, part in parts]))
    for cut, part in parts:
        first, second = ("xyz"[axis] for axis in cut.axes)
        across = "xyz"[3 - sum(cut.axes)]
        what = f"1σ of the target, worst direction, {first}–{second} plane at {across} = {cut.at:.2f} m"
        labels = (f"base {first} [m]", f"base {second} [m]")
        plot = field(
            f"slice-{first}{second}",
            what,
            part.places[:, cut.axes],
            1e3 * part.sigma,
            labels,
            "mm",
            colors,
            ~part.measured,
        )
        drawn.append((what, plot))
    return drawn
