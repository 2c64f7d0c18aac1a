"""How a table stands in its file where that is not plain csv: what `table` of a campaign says."""

from __future__ import annotations

from dataclasses import dataclass, field

BLANKS = " "
"""The separator of columns that are parted by any number of blanks."""


@dataclass(frozen=True)
class Dates:
    """Columns that hold dates, or times of day.

    Attributes:
        order: Of day, month and year where all three are numbers: ``dmy``, ``mdy`` or ``ymd``.
        columns: Read together, one after the other: a date and a time of day, for instance.
    """

    order: str
    columns: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of the column of seconds that they become."""
        return " ".join(self.columns)


@dataclass(frozen=True)
class Dialect:
    """How to read a table of text or a sheet of a workbook.

    Attributes:
        encoding: Of its characters.
        separator: Between its cells; a blank stands for any number of blanks and tabs.
        decimal: Point or comma.
        thousands: What groups the digits before it; empty: nothing.
        header: Lines whose cells are put together to the names of the columns; none: `names` has them.
        first_row: Line of the first row; 0: below the header.
        comment: Lines that begin with one of these are no rows. A header line may.
        sheet: Of a workbook; empty: the only one.
        names: Of the columns where no line names them.
        lists: Columns whose cells hold several numbers, each with the names of the columns that these become.
        dates: A column of dates or two that become one of seconds.
        export: A program whose files are no tables: ``robot_calibration``.
    """

    encoding: str = "utf-8"
    separator: str = ","
    decimal: str = "."
    thousands: str = ""
    header: tuple[int, ...] = (1,)
    first_row: int = 0
    comment: tuple[str, ...] = ()
    sheet: str = ""
    names: tuple[str, ...] = ()
    lists: dict[str, tuple[str, ...]] = field(default_factory=dict)
    dates: Dates | None = None
    export: str = ""

    @property
    def begins(self) -> int:
        """Line of the first row."""
        return self.first_row or max(self.header, default=0) + 1


PLAIN = Dialect()
"""UTF-8, commas, decimal points, one header line."""
