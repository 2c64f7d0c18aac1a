"""What changed between two calibrations, as Python users have it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.history.comparison import compare, constants, lines
from aridcal.system.progress import PrintedAnswer


@dataclass(frozen=True, repr=False, eq=False)
class Changes(PrintedAnswer):
    """What changed between two calibrations, for Python.

    Attributes:
        changed: Whether more differs than the uncertainty explains.
        p_value: Chance that two calibrations of a robot that did not change differ as much.
        causes: What changed, a row for each coefficient, [m] and [rad].
        constants: Every coefficient that both have, by itself, [m] and [rad].
        lines: The whole answer in words.
    """

    changed: bool
    p_value: float
    causes: pd.DataFrame
    constants: pd.DataFrame
    lines: tuple[str, ...]


def changes(a: str | Path | SavedModel, b: str | Path | SavedModel) -> Changes:
    """Compare two calibrations of one robot.

    Args:
        a: The first: a result folder, its ``calibration.yaml``, or what was read of it.
        b: The second.

    Raises:
        AridcalError: one is not there, or they are not of one arm.
    """
    first, second = (saved if isinstance(saved, SavedModel) else SavedModel.load(saved) for saved in (a, b))
    comparison = compare(first, second)
    columns = ["what", "name", "unit", "before", "change", "std", "p_value"]
    rows = [
        (c.words, name, unit, before, float(value), float(std), c.p_value)
        for c in comparison.causes.changes
        for name, unit, before, value, std in zip(c.names, c.units, c.before, c.value, c.std, strict=True)
    ]
    coefficients = pd.DataFrame(
        constants(comparison), columns=["name", "unit", "before", "after", "change", "std", "p_value"]
    )
    return Changes(
        comparison.changed,
        comparison.difference.p_value,
        pd.DataFrame(rows, columns=columns),
        coefficients,
        tuple([*lines(comparison), *(f"note: {notice}" for notice in comparison.notices)]),
    )
