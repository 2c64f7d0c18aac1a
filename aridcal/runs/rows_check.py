"""The check of a calibration by new rows, as Python users have it."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from aridcal.files.tables import AnyTable
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.maintain.answers import check_lines
from aridcal.jobs.maintain.checking import check
from aridcal.jobs.maintain.new_rows import read_new_rows
from aridcal.jobs.maintain.repair import changes
from aridcal.system.progress import PrintedAnswer


@dataclass(frozen=True, repr=False, eq=False)
class Check(PrintedAnswer):
    """What new rows say of a calibration, for Python.

    Attributes:
        good: True as long as nothing moved; with a tolerance as long as the error may be within it.
        p_value: Probability of rows as odd as these from a calibration that is still right.
        moved: What moved, by how much, [m] and [rad]; no rows where nothing did.
        lines: The whole answer in words.
    """

    good: bool
    p_value: float
    moved: pd.DataFrame
    lines: tuple[str, ...]


def check_rows(saved: SavedModel, table: AnyTable, tolerance: float | None = None) -> Check:
    """Check by new rows whether a calibration is still good.

    Args:
        saved: The calibration.
        table: See :func:`aridcal.jobs.maintain.new_rows.read_new_rows`.
        tolerance: Largest RMS position error that is still good, [m].

    Raises:
        AridcalError: the rows need mending, or nothing can be said of a tolerance.
    """
    new_rows = read_new_rows(saved, table)
    checked = check(saved, new_rows.rows, tolerance, new_rows.frames)
    moved = changes(checked)
    columns = ["moved", "name", "unit", "value", "std", "probability"]
    rows = [
        (c.cause.where, name, unit, value, std, c.cause.probability)
        for c in moved
        for name, unit, value, std in zip(c.names, c.units, c.value.tolist(), c.std.tolist(), strict=True)
    ]
    lines = tuple(check_lines(checked, moved, saved.measurements))
    return Check(checked.good, checked.first.p_value, pd.DataFrame(rows, columns=columns), lines)
