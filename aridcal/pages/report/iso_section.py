"""The report on ISO 9283: how well poses are attained that were measured more than once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from aridcal.engine.trust.iso9283 import (
    ASKED_CYCLES,
    ASKED_HOURS,
    ASKED_POSES,
    ENOUGH_CYCLES,
    ISO_ROTATIONS,
    MEANINGS,
    OF_FIT,
    OF_PAIRS,
    STANDARD,
    Iso9283,
    applies,
)
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.html import Content, fold, table, tag
from aridcal.system.wording import number, plural

MOST_POSES = 30
"""Poses that the table lists."""


def iso(outcome: Outcome) -> Iterator[Content]:
    """Accuracy and repeatability by the standard's definitions, before and after."""
    figures = outcome.iso
    if figures is None:
        yield tag("p", _why_not(outcome))
        return
    yield tag("p", cycles_in_words(figures))
    yield fold("Worst figures, before and after", _summary(figures), tag("p", _definitions(figures)))
    yield fold(
        "Figures of each pose", _poses(figures, outcome), tag("p", tag("em", _left_out(figures, len(figures.cycles))))
    )


def _why_not(outcome: Outcome) -> str:
    """Why there are no figures."""
    if not applies(outcome.measurements):
        return (
            f"{STANDARD} does not apply to these measurements: its figures are of attained poses or positions of one target, and "
            "here rows are of another kind, or of several targets."
        )
    return (
        f"No pose was attained twice, so there are no figures of {STANDARD}. The "
        f"standard asks for {ASKED_CYCLES} cycles of {ASKED_POSES} poses: repeat some, each time after a move to the others."
    )


def cycles_in_words(figures: Iso9283) -> str:
    """How many cycles of how many poses, and whether that is what the standard asks for."""
    counts = figures.counts
    few, many = int(counts.min()), int(counts.max())
    cycles = plural(few, "cycle") if few == many else f"{few} to {plural(many, 'cycle')}"
    poses = f"{plural(len(counts), 'pose')}, {cycles} of each."
    standard = f"{ASKED_CYCLES} cycles of {ASKED_POSES} poses"
    if not figures.enough:
        small = (
            f" Of fewer than {ENOUGH_CYCLES} cycles RP comes out too small on average, of 3 by a quarter; of two it is not told."
            if few < ENOUGH_CYCLES
            else ""
        )
        return f"{poses} {STANDARD} asks for {standard}: these are figures by its definitions, not tests to it.{small}"
    return (
        f"{poses} That is as many as {STANDARD} asks for ({standard}). Whether its other conditions were kept (the cube and its "
        "plane, load, speed, warm-up) the rows do not tell: these are figures by its definitions."
    )


def lines(figures: Iso9283) -> list[tuple[str, str, str, str, str]]:
    """Each characteristic that the rows tell: symbol, meaning with the clause, which poses the worst is of, before, after."""
    rows = []
    for symbol, (meaning, clause) in MEANINGS.items():
        of = _which(figures, symbol)
        before, after = _worst(figures, symbol)
        if not np.isnan(after):
            rows.append((symbol, f"{meaning} ({clause})", of, f"{number(before)} mm", f"{number(after)} mm"))
        turns = [_worst(figures, f"{symbol}_{axis}") for axis in ISO_ROTATIONS if f"{symbol}_{axis}" in figures.final]
        if turns and not np.isnan(turns).any():
            first, last = (", ".join(number(turn[k]) for turn in turns) for k in (0, 1))
            about = f"{symbol} {', '.join(ISO_ROTATIONS)}"
            rows.append((about, f"orientation {meaning} ({clause})", of, f"{first} mrad", f"{last} mrad"))
    return rows


def _which(figures: Iso9283, symbol: str) -> str:
    """The poses or pairs that the worst figure is of: ``1 held-out pose``, ``15 pairs, fitted``."""
    mask = figures.judged(symbol) & ~np.isnan(figures.final[symbol])
    what = "pair" if symbol in OF_PAIRS else "pose"
    if symbol not in OF_FIT:
        return plural(int(mask.sum()), what)
    new = figures.held_out[figures.pairs].all(axis=1) if symbol in OF_PAIRS else figures.held_out
    return plural(int(mask.sum()), f"held-out {what}") if new.any() else f"{plural(int(mask.sum()), what)}, fitted"


def _worst(figures: Iso9283, symbol: str) -> tuple[float, float]:
    """Before and after, [mm] or [mrad]."""
    return 1e3 * figures.worst(figures.nominal, symbol), 1e3 * figures.worst(figures.final, symbol)


def _summary(figures: Iso9283) -> Markup:
    """The worst of each characteristic, before and after."""
    head = ["symbol", "characteristic (clause)", "worst of", "nominal", "final"]
    return table(head, lines(figures), f"Figures of {STANDARD}", numbers=3)


def _definitions(figures: Iso9283) -> str:
    """What is commanded and attained, and what is special about drift."""
    hours = figures.hours[~np.isnan(figures.hours)]
    lasted = (
        f" Drift is between the first and the last cycles of a pose (at most {ENOUGH_CYCLES} each), over "
        f"{number(float(hours.max()), 2)} h; the standard asks for {ASKED_HOURS:g} h."
        if not np.isnan(figures.final["dAP"]).all()
        else ""
    )
    return (
        "The commanded pose is the one that the model predicts: nominal is the robot as it obeys the nominal URDF, with only the "
        "unknown frames fitted, final is the calibrated one. AP is the distance of the mean attained position from it, RP the "
        "mean distance of the attained positions from their own mean plus three standard deviations, a b c are turns about x, y "
        "and z of the base. Repeatability is the robot's and the instrument's together; calibration leaves it as it is, unless "
        "effects explain part of it. Accuracies of poses that were fitted are too optimistic after calibration."
        f"{lasted}"
    )


def _poses(iso9283: Iso9283, outcome: Outcome) -> Markup:
    """Each pose with its figures."""
    m = outcome.measurements
    rows = []
    for k, group in enumerate(iso9283.cycles[:MOST_POSES]):
        first = group[0]
        axes = ", ".join(number(1e3 * float(iso9283.final[f"AP_{axis}"][k]), 2) for axis in "xyz")
        figures = (iso9283.nominal["AP"], iso9283.final["AP"], iso9283.nominal["RP"], iso9283.final["RP"])
        rows.append([
            f"{m.origin.files[m.origin.file[first]].name}, line {m.origin.line[first]}",
            "held out" if iso9283.held_out[k] else "fitted",
            f"{len(group):,}",
            *(number(1e3 * float(values[k])) for values in figures),
            axes,
        ])  # fmt: skip
    head = ["first cycle", "rows", "cycles", "AP nominal", "AP final", "RP nominal", "RP final", "AP x, y, z final"]
    return table(head, rows, "Pose by pose [mm]", numbers=2)


def _left_out(figures: Iso9283, poses: int) -> str:
    """What the table and the figures leave out."""
    said = []
    if poses > MOST_POSES:
        said.append(f"{poses - MOST_POSES:,} more poses are in result.json.")
    if len(figures.pairs):
        pairs = plural(len(figures.pairs), "pair")
        said.append(f"{' and '.join(OF_PAIRS)} are of the {pairs} of poses at one station; result.json has each.")
    if figures.copies:
        said.append(
            f"{plural(figures.copies, 'row')} with the same measurement bit for bit as another cycle: no cycles."
        )
    if figures.flagged:
        said.append(f"{plural(figures.flagged, 'row')} flagged as outliers: left out.")
    return " ".join(said)
