"""Workbooks (.xlsx) as csv: values as they were stored, dates as ISO writes them, nothing computed."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections import Counter
from collections.abc import Iterator
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import IO, Any

from aridcal.system.errors import MeasurementError, name_list, nearest, printable, shortened
from aridcal.system.reading.regular_files import MEGA, Limit
from aridcal.system.reading.table_files import MOST_COLUMNS

WORKBOOK_ENDINGS = (".xlsx", ".xlsm")

DECLARED = re.compile(rb"<\s*!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)
"""What no workbook has, and what makes a few bytes of XML gigabytes."""

ENCODING = re.compile(rb"<\?xml[^>]*?encoding\s*=\s*[\"']([^\"']*)", re.IGNORECASE)
ENCODINGS = frozenset({b"utf-8", b"utf-16", b"us-ascii", b"ascii"})
"""Encodings of the parts of workbooks (ECMA-376 part 2): in others, angle brackets and declarations hide."""

XML_ELEMENT = re.compile(rb"<([^\s<>/?!][^\s<>/]*)")
"""An element's beginning and its name."""

CELL_ELEMENTS = frozenset({b"row", b"c", b"v", b"f", b"is", b"t", b"si", b"r", b"rPr", b"rPh", b"phoneticPr"})
"""Elements that grow with the number of cells; they are read one after the other."""

ELEMENTS_OF_A_CELL = 6
"""Elements of a cell at most: itself, its value, a shared text with its parts."""

MOST_OTHERS = 200_000
"""Elements of other kinds in what is read: formats, styles, merged cells, names. Each becomes an object, in 50 µs and 1 kB; a
workbook of many years has some thousand."""

WHOLE_MB = 20
"""[MB] of a part that is read whole: the list of sheets, styles, a theme."""

READINGS_OF_A_SHEET = 2
"""Times that a sheet is read: for its size, and for its cells."""

MOST_SHEETS = 1000
"""More are no measurements: each is looked into."""

UNPACKED = 4.0
"""Times the limit that a workbook may take unpacked: a cell of XML is some 30 bytes, of which 8 are its number."""

MOST_EMPTY = 20_000
"""Empty rows, one after the other: those before a row with an absurd number are made up while a sheet is read."""

BYTES_OF_A_SHEET_CELL = 64
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
    names = [each.title for each in book.worksheets]
    if sheet and sheet not in names:
        raise MeasurementError(f"{path}: has no sheet {shortened(sheet)!r}{nearest(sheet, names)}; see `table.sheet`")
    if not sheet and len(names) != 1:
        raise MeasurementError(
            f"{path}: has the sheets {name_list(names)}; say which under measurements: `table: {{sheet: …}}`"
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
    from openpyxl.reader.excel import ExcelReader  # slow to load, and few tables are workbooks

    try:
        reader = ExcelReader(io.BytesIO(content), read_only=True, data_only=True, keep_links=False)
        size = sum(part.file_size for part in reader.archive.infolist())
        if size > UNPACKED * limit.megabytes * MEGA:
            raise MeasurementError(
                f"{path}: unpacks to {size / MEGA:,.0f} MB, at most {UNPACKED * limit.megabytes:g} MB are read; {limit.remedy}"
            )
        reader.archive.close()
        reader.archive = _Bounded(content, path, limit)
        reader.read()
    except MeasurementError:
        raise
    except Exception as problem:  # openpyxl raises whatever a broken part makes it
        raise _unreadable(path, problem) from None
    if not reader.wb.worksheets:
        raise MeasurementError(f"{path}: has no sheet of cells; name the table that was measured")
    if len(reader.wb.worksheets) > MOST_SHEETS:
        raise MeasurementError(
            f"{path}: has {len(reader.wb.worksheets):,} sheets, at most {MOST_SHEETS:,} are read; save the measured one apart"
        )
    return reader.wb


class _Bounded(zipfile.ZipFile):
    """A workbook's parts, what is read of them bounded as it is unpacked: by its bytes and by the elements in it."""

    def __init__(self, content: bytes, path: Path, limit: Limit) -> None:
        super().__init__(io.BytesIO(content))
        self._path, self._limit = path, limit
        self._of_cells = self._others = self._bytes = 0

    def read(self, name: str | zipfile.ZipInfo, pwd: bytes | None = None) -> bytes:
        """A part as a whole."""
        part = name if isinstance(name, zipfile.ZipInfo) else self.getinfo(name)
        if part.file_size > WHOLE_MB * MEGA:
            raise MeasurementError(
                f"{self._path}: its part {printable(part.filename)} has {part.file_size / MEGA:,.0f} MB, at most {WHOLE_MB} MB "
                "are read; save the sheet that was measured in a new workbook"
            )
        with super().open(part, "r", pwd) as file:
            content = file.read()
        self.begins(content)
        self.weigh(content, whole=True)
        return content

    def open(self, name: str | zipfile.ZipInfo, *_: Any, **__: Any) -> Any:
        """A part to be read on and on: a sheet, or the texts of cells."""
        return _Stream(super().open(name), self)

    def begins(self, content: bytes) -> None:
        """Look at the beginning of a part: XML in an encoding of workbooks."""
        begin = content[:4096].replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n")
        encoding = ENCODING.match(begin)
        if not begin.startswith(b"<") or (encoding is not None and encoding[1].lower() not in ENCODINGS):
            raise MeasurementError(f"{self._path}: has a part that is no XML in UTF-8 or UTF-16; save it anew")

    def weigh(self, content: bytes, whole: bool) -> None:
        """Count what is in a piece of a part.

        Args:
            content: The piece; elements are counted that begin in it.
            whole: Whether the part is held as a whole: then none of its elements is one of a cell.

        Raises:
            MeasurementError: it is too much by now, or declares entities.
        """
        if DECLARED.search(content.replace(b"\0", b"")):
            raise MeasurementError(f"{self._path}: declares entities in its XML, which no workbook needs; save it anew")
        names = Counter(XML_ELEMENT.findall(content))
        every = names.total()
        of_cells = sum(n for name, n in names.items() if name.replace(b"\0", b"").rpartition(b":")[2] in CELL_ELEMENTS)
        self._of_cells += 0 if whole else of_cells
        self._others += every if whole else every - of_cells
        self._bytes += len(content)
        if self._others > MOST_OTHERS:
            raise MeasurementError(
                f"{self._path}: has more than {MOST_OTHERS:,} formats, styles and other things beside cells; save the sheet "
                "that was measured in a new workbook, or as csv"
            )
        most = self._limit.megabytes * MEGA
        if (
            BYTES_OF_A_SHEET_CELL * self._of_cells > READINGS_OF_A_SHEET * ELEMENTS_OF_A_CELL * most
            or self._bytes > READINGS_OF_A_SHEET * UNPACKED * most
        ):
            raise MeasurementError(
                f"{self._path}: has more cells than {self._limit.megabytes:g} MB hold; {self._limit.remedy}"
            )


class _Stream(io.RawIOBase):
    """A part that is weighed while it is read."""

    def __init__(self, file: IO[bytes], archive: _Bounded) -> None:
        self._file, self._archive, self._started, self._rest = file, archive, False, b""

    def read(self, size: int | None = -1) -> bytes:
        """The next bytes; if all are asked for, no more than :data:`WHOLE_MB`."""
        content = self._file.read(int(WHOLE_MB * MEGA) if size is None or size < 0 else size)
        if not self._started:
            self._archive.begins(content)
            self._started = True
        cut = content.rfind(b"<") if content else 0  # its name may go on in the next piece
        piece, rest = (content[:cut], content[cut:]) if cut > 0 else (content, b"")
        self._archive.weigh(self._rest + piece, whole=False)
        self._rest = rest
        return content

    def readable(self) -> bool:
        """True: a part can be read."""
        return True

    def close(self) -> None:
        """Close the part."""
        self._file.close()
        super().close()


def _rows(sheet: Any, path: Path, limit: Limit) -> Iterator[tuple[Any, ...]]:
    """Rows of a sheet without the empty cells at their ends; the size that the file states does not count."""
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
        if BYTES_OF_A_SHEET_CELL * cells > limit.megabytes * MEGA:
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
    reason = shortened(printable((str(problem) or type(problem).__name__).splitlines()[0]), 200)
    return MeasurementError(f"{path}: is no readable workbook: {reason}. Save it anew as .xlsx, or as csv")
