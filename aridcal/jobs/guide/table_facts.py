"""What is odd about a row by itself, or beside the last ones, whatever the arm is like."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.repeats import tolerances
from aridcal.jobs.guide.events import What

SCALES = {"mm for m": 1e3, "m for mm": 1e-3, "inches for m": 1.0 / 0.0254, "m for inches": 0.0254}
"""By which lengths are off in the commonest of wrong units."""

TURNS = {"degrees for radians": 180.0 / np.pi, "radians for degrees": np.pi / 180.0}
"""The same of angles."""

GROSS = 20.0
"""Times as far from the origin as any before, or as near, from which a place is in another unit, before the arm is known."""


@dataclass(frozen=True)
class Oddity:
    """Something odd.

    Attributes:
        what: Its cause.
        words: In words.
        do: What to do about it.
        bad: True where the row cannot be used.
    """

    what: What
    words: str
    do: str
    bad: bool


def refusal(line: int, why: str) -> Oddity:
    """Of a line that is no row."""
    if "identical" in why:
        return Oddity(
            "stale", f"row {line} is {why}", "wait until the instrument has a new reading, and measure it again", True
        )
    if "unit" in why:
        return Oddity(
            "unit", f"row {line}: {why}", "check the unit in which the driver writes, and measure it again", True
        )
    return Oddity("table", f"row {line}: {why}", "check what the driver wrote, and measure it again", True)


def oddities(rows: Dataset, k: int, lines: np.ndarray, usable: np.ndarray) -> Iterator[Oddity]:
    """What is odd about row k of those read so far.

    Args:
        rows: N of them, in the order in which they came.
        k: Index of the row.
        lines: Of the rows in the table, shape (N,).
        usable: Rows before that were good, shape (N,) bool.
    """
    line = int(lines[k])
    if rows.repeats.stale[k]:
        yield Oddity(
            "stale",
            f"row {line} has the very measurement of an earlier row, although the joints moved",
            "wait until arm and instrument are still, and measure it again",
            True,
        )
    time = rows.covariates.get("time")
    if time is not None and k and time[k] < np.nanmax(time[:k], initial=-np.inf):
        yield Oddity(
            "clock",
            f"the time of row {line} is before that of an earlier row",
            "check the clocks of the computers that write the table: drift is told by this column",
            False,
        )
    target = rows.labels.target
    if target is not None and k >= FEW_LABELS and target[k] not in set(target[:k].tolist()):
        yield Oddity(
            "target",
            f"row {line} is of {target[k]!r}, a target that was not seen before",
            "check its name; if it is new, measure it in three poses at the least",
            False,
        )
    if rows.blocks[0].traits.places and usable[:k].any() and not rows.repeats.stale[k]:
        size = np.linalg.norm(rows.position, axis=1)
        before = size[:k][usable[:k]]
        if size[k] > GROSS * before.max() or size[k] * GROSS < before.min():
            yield Oddity(
                "unit",
                f"row {line} is {size[k]:.4g} m from the origin, those before {before.min():.4g} to {before.max():.4g} m",
                "check the unit in which the instrument writes, and measure it again",
                True,
            )


FEW_LABELS = 4
"""Rows after which a new label is a surprise."""


def in_other_units(rows: Dataset, k: int) -> Iterator[tuple[str, Dataset]]:
    """Row k as it would be in the units that are commonly mistaken, with what was mistaken for what."""
    row = rows.select(np.array([k]))
    for words, factor in SCALES.items():
        observed = row.observed.copy()
        observed[:, :3] /= factor
        yield words, replace(row, observed=observed)
    turning = np.array([kind != "prismatic" for kind in rows.kinds])
    for words, factor in TURNS.items():
        yield words, replace(row, readings=np.where(turning, row.readings / factor, row.readings))


def not_renewed(rows: Dataset, k: int, shift: float, sigma: float) -> str:
    """Why a row that is off is one that was not renewed; empty if it is not: it measures what the last one did, nearly.

    Args:
        rows: In the order in which they came.
        k: Index of the row.
        shift: How far its measurement is from that of the row before, [m] or [px]; NaN where none can be compared.
        sigma: Noise of that along an axis.
    """
    if not k:
        return ""
    moved = np.abs(rows.readings[k] - rows.readings[k - 1]) > tolerances(rows.kinds)
    if moved.any() and shift < STILL * sigma:
        return "its measurement is that of the row before, although the joints moved"
    if not moved.any() and shift > STILL * sigma:
        return "its joints are those of the row before, although the target moved"
    return ""


STILL = 6.0
"""Sigmas by which two measurements of one place differ at the most: each of three axes by less than 4, with both noises."""
