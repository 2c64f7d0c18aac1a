"""Workbooks (.xlsx) as csv: values as they were stored, dates as ISO writes them, nothing computed."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections.abc import Iterator
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import openpyxl

from aridcal.errors import MeasurementError, listed, nearest, printable, shortened
from aridcal.reading.files import MEGA, Limit
from aridcal.reading.table_files import MOST_COLUMNS

ENDINGS = (".xlsx", ".xlsm")

DECLARED = re.compile(rb"<\s*!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)
"""What no workbook has, and what makes a few bytes of XML gigabytes."""

UNPACKED = 4.0
"""Times the limit that a workbook may take unpacked: a cell of XML is some 30 bytes, of which 8 are its number."""

MOST_EMPTY = 20_000
"""Empty rows, one after the other: those before a row with an absurd number are made up while a sheet is read."""

HELD = 64
"""Bytes of a cell while the sheet is turned into text."""


def sheets(content: bytes, path: Path, limit: Limit) -> tuple[str, ...]:
    """Names of a workbook's sheets of cells.

    Raises:
        MeasurementError: it is none, or unpacks to more than may be read.
    """
    return tuple(sheet.title for sheet in _opened(content, path, limit).worksheets)


def as_csv(content: bytes, path: Path, limit: Limit, sheet: str, decimal: str) -> bytes:
    """A sheet as csv in UTF-8, a line for each of its rows.

    Args:
        content: Of the workbook.
        path: Whence it came, for messages.
        limit: Memory that its cells may take.
        sheet: Which one; empty: the only one.
        decimal: What numbers are written with: as those in cells of text are.

    Raises:
        MeasurementError: it cannot be read, there is no such sheet, or several and none is named.
    """
    book = _opened(content, path, limit)
    names = [one.title for one in book.worksheets]
    if sheet and sheet not in names:
        raise MeasurementError(f"{path}: has no sheet {shortened(sheet)!r}{nearest(sheet, names)}; see `table.sheet`")
    if not sheet and len(names) != 1:
        raise MeasurementError(
            f"{path}: has the sheets {listed(names)}; say which under measurements: `table: {{sheet: …}}`"
        )
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    try:
        rows = [[_text(cell, decimal) for cell in row] for row in _rows(book[sheet or names[0]], path, limit)]
        width = max(map(len, rows), default=0)
        writer.writerows(row + [""] * (width - len(row)) if row else [] for row in rows)
    except MeasurementError:
        raise
    except Exception as problem:  # openpyxl raises whatever a broken part makes it
        raise _unreadable(path, problem) from None
    return out.getvalue().encode("utf-8", "replace")


def _opened(content: bytes, path: Path, limit: Limit) -> Any:
    """A workbook whose parts are within limits and declare nothing."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as parts:
            size = sum(part.file_size for part in parts.infolist())
            if size > UNPACKED * limit.megabytes * MEGA:
                raise MeasurementError(
                    f"{path}: unpacks to {size / MEGA:,.0f} MB, at most {UNPACKED * limit.megabytes:g} MB are read; "
                    f"{limit.remedy}"
                )
            for part in parts.infolist():
                if part.filename.lower().endswith((".xml", ".rels")) and _declares(parts, part):
                    raise MeasurementError(
                        f"{path}: declares entities in its XML, which no workbook needs; save it anew"
                    )
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True, keep_links=False)
    except MeasurementError:
        raise
    except Exception as problem:  # openpyxl raises whatever a broken part makes it
        raise _unreadable(path, problem) from None
    if not book.worksheets:
        raise MeasurementError(f"{path}: has no sheet of cells; name the table that was measured")
    return book


def _declares(parts: zipfile.ZipFile, part: zipfile.ZipInfo) -> bool:
    """True of XML with a declaration of types or entities, which stand at its beginning."""
    with parts.open(part) as file:
        begin = file.read(4096).replace(b"\0", b"")
    return DECLARED.search(begin) is not None


def _rows(sheet: Any, path: Path, limit: Limit) -> Iterator[tuple[Any, ...]]:
    """Rows of a sheet without the empty cells at their ends, none for what a file merely says of its size."""
    sheet.reset_dimensions()
    cells = empty = 0
    for row in sheet.iter_rows(values_only=True):
        filled = max((k + 1 for k, cell in enumerate(row) if cell is not None), default=0)
        empty = 0 if filled else empty + 1
        if empty > MOST_EMPTY:
            raise MeasurementError(f"{path}: has {MOST_EMPTY:,} empty rows between others; delete them")
        if filled > MOST_COLUMNS:
            raise MeasurementError(
                f"{path}: has {filled:,} columns, at most {MOST_COLUMNS:,} are read; split the table"
            )
        cells += len(row)
        if HELD * cells > limit.megabytes * MEGA:
            raise MeasurementError(f"{path}: has more cells than {limit.megabytes:g} MB hold; {limit.remedy}")
        yield row[:filled]


def _text(cell: Any, decimal: str) -> str:
    """A cell as text, on one line."""
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return str(int(cell))
    if isinstance(cell, int | float):
        return repr(cell).replace(".", decimal)
    if isinstance(cell, datetime | date | time):
        return cell.isoformat(" ") if isinstance(cell, datetime) else cell.isoformat()
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds()).replace(".", decimal)
    return " ".join(str(cell).split())


def _unreadable(path: Path, problem: Exception) -> MeasurementError:
    said = shortened(printable((str(problem) or type(problem).__name__).splitlines()[0]), 200)
    return MeasurementError(f"{path}: is no readable workbook: {said}. Save it anew as .xlsx, or as csv")
