"""The page of two calibrations compared."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from markupsafe import Markup

from aridcal import __version__
from aridcal.jobs.history.comparison import Comparison, constants, lines, p_in_words, worst
from aridcal.pages.drawing.figures import histogram
from aridcal.pages.drawing.html import Content, bullets, figures, table, tag
from aridcal.pages.drawing.page_frame import framed_page, sections
from aridcal.pages.report.page import draw_section
from aridcal.system.wording import number, plus_minus, reading_in_words, shown_unit

MOST_LISTED_COEFFICIENTS = 40
"""Coefficients that the page lists; `compare.json` has all."""


def compare_page(comparison: Comparison, names: tuple[str, str]) -> Markup:
    """The page, self-contained.

    Args:
        comparison: What changed.
        names: Of the two calibrations, as the user gave them.
    """
    verdict, *others = lines(comparison)
    chapters = [
        ("How far are the poses apart?", _poses(comparison)),
        ("Which constants and effects?", _causes(comparison)),
        ("Every coefficient by itself", _constants(comparison)),
        ("What was compared", _about(comparison, names)),
    ]
    robot = comparison.urdf[0]
    head = [
        tag("p", f"{names[0]} and {names[1]} · {robot}", class_="about"),
        tag("h1", "Changed" if comparison.changed else "Nothing changed beyond the uncertainty"),
        bullets([verdict, *others]),
    ]
    parts = sections([(name, draw_section(name, content)) for name, content in chapters])
    return framed_page(f"{names[0]} and {names[1]} compared", head, parts, f"aridcal {__version__}")


def _poses(comparison: Comparison) -> Iterator[Content]:
    """How far apart the targets are, beside what the uncertainty makes, and where most."""
    d = comparison.difference
    apart = 1e3 * np.linalg.norm(d.apart[:, :3], axis=1)
    usual = 1e3 * np.sqrt(np.sum(d.expected[:, :3] ** 2, axis=1))
    shown = {"apart": apart, "1 sigma by the uncertainty": usual}
    picture = histogram("apart", "How far apart the targets of both calibrations are", shown, "mm")
    yield figures(
        [(f"Targets in {len(apart)} configurations that both know, motions of base and tool taken off", picture)]
    )
    rows = [
        [str(place), *(reading_in_words(float(v), kind) for v, kind in zip(d.readings[k], d.robot.kinds, strict=True))]
        + [f"{number(float(apart[k]))} mm", f"{number(float(usual[k]))} mm"]
        for place, k in enumerate(worst(d).tolist(), start=1)
    ]
    yield table(["", *d.robot.readings, "apart", "1 sigma"], rows, "Where they are farthest apart")


def _causes(comparison: Comparison) -> Iterator[Content]:
    """The causes, by coefficient."""
    rows: list[list[Content]] = []
    for c in comparison.causes.changes:
        for k, name in enumerate(c.names):
            unit, scale = shown_unit(c.units[k])
            rows.append(
                [
                    c.words if k == 0 else "",
                    tag("code", name),
                    number(scale * c.before[k]),
                    plus_minus(scale * float(c.value[k]), scale * float(c.std[k])),
                    unit,
                    p_in_words(c.p_value),
                ]
            )
    if not rows:
        yield tag(
            "p", "None: there is nothing to explain." if not comparison.changed else "None explains it by itself."
        )
        return
    yield table(
        ["what", "coefficient", "before", "change", "unit", "chance of as much if nothing changed"],
        rows,
        "The fewest changes that explain the poses, joint covariance of both; p for all candidates together",
        numbers=2,
    )
    yield tag("p", f"What they leave: {p_in_words(comparison.causes.rest)}.")


def _constants(comparison: Comparison) -> Iterator[Content]:
    """Coefficients that both have."""
    every = constants(comparison)
    yield tag(
        "p",
        "These stand for one another where rows tell them only together: one change may show in several. The causes above "
        "are what remains when that is taken into account.",
    )
    rows = [_coefficient(row) for row in every[:MOST_LISTED_COEFFICIENTS]]
    which = "" if len(every) <= MOST_LISTED_COEFFICIENTS else f"; the {MOST_LISTED_COEFFICIENTS} surest of {len(every)}"
    yield table(["coefficient", "first", "second", "change", "unit", "p"], rows, f"Coefficients of both{which}")


def _coefficient(row: dict[str, Any]) -> list[Content]:
    unit, scale = shown_unit(row["unit"])
    numbers = [number(scale * row[key], 4) for key in ("before", "after")]
    return [
        tag("code", row["name"]),
        *numbers,
        plus_minus(scale * row["change"], scale * row["std"]),
        unit,
        p_in_words(row["p_value"]),
    ]


def _about(comparison: Comparison, names: tuple[str, str]) -> Iterator[Content]:
    """What both are, and what a reader should know."""
    rows: list[list[Content]] = []
    for name, record in zip(names, comparison.records, strict=True):
        data = record.get("data", {})
        files = ", ".join(data.get("files", ()))
        version = record.get("versions", {}).get("aridcal", "")
        rows.append([name, files, version, str(data.get("rows", "")), str(data.get("train", ""))])
    yield table(["calibration", "tables", "aridcal", "rows", "fitted"], rows, "Both calibrations", numbers=3)
    if comparison.notices:
        yield bullets(comparison.notices)
