"""Tables of errors as Python and notebooks show them."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from aridcal.pages.drawing.html import tag

HEADLINE = ("rms", "p95", "max")
"""Statistics of an error that a calibration shows of itself; of all quantities but the first only one."""

ERROR_FORMAT = "{:.3f}".format
"""How errors are shown, to 1 µm and 1 µrad."""


@dataclass(frozen=True, repr=False, eq=False)
class Verified:
    """Another day's measurements, scored with models that have never seen them.

    Attributes:
        file: Where they came from.
        rows: How many.
        outliers: How many of them were left out: grossly off even with the frames fitted anew.
        errors: Of each model, and of the last with both frames fitted anew (``realigned``), [mm] and [mrad].
    """

    file: str
    rows: int
    outliers: int
    errors: pd.DataFrame

    def __repr__(self) -> str:
        return f"{self._title}\n{headline(self.errors).to_string(float_format=ERROR_FORMAT)}"

    def _repr_html_(self) -> str:
        return f"{tag('p', self._title)}{headline(self.errors).to_html(float_format=ERROR_FORMAT, border=0)}"

    @property
    def _title(self) -> str:
        left_out = f", {self.outliers} gross outliers left out" if self.outliers else ""
        return f"{self.file}: {self.rows} rows of another day{left_out}"


def headline(table: pd.DataFrame) -> pd.DataFrame:
    """The columns of a table of errors that fit on a screen."""
    names = [str(name) for name in table if "_rms_" in str(name)]
    first, *others = names
    return table[[*(first.replace("_rms_", f"_{each}_") for each in HEADLINE), *others]].rename_axis(None)
