"""What is wrong or odd about a row or a cell of a table."""

from __future__ import annotations

from dataclasses import dataclass

from aridcal.system.errors import SHOWN_LENGTH, printable


@dataclass(frozen=True)
class Remark:
    """Something wrong or odd about a row or a cell; `row` is the line of the file, `None` if all of it is meant."""

    file: str
    row: int | None
    column: str
    value: str
    why: str

    def __str__(self) -> str:
        where = self.file if self.row is None else f"{self.file}, line {self.row}"
        cell = ", ".join(
            filter(None, [f"column {self.column!r}" if self.column else "", printable(self.value[:SHOWN_LENGTH])])
        )
        return f"{where}: {cell}: {self.why}" if cell else f"{where}: {self.why}"
