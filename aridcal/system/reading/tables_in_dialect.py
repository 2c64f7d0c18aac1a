"""Tables that are no plain csv, read by the keys that say how they are written; nothing is guessed here."""

from __future__ import annotations

import codecs
import csv
import itertools
import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from aridcal.system.errors import MeasurementError, nearest, shortened
from aridcal.system.reading import workbooks
from aridcal.system.reading.dates import NIGHTS, has_date, seconds, unrolled
from aridcal.system.reading.dialect import BLANKS, Dates, Dialect
from aridcal.system.reading.numerals import as_numbers, numbers_in_list, pattern
from aridcal.system.reading.regular_files import Limit, not_utf8
from aridcal.system.reading.table_files import LONGEST_LINE, MOST_COLUMNS, FileCells, read_below_header

LINE_END = re.compile(r"\r\n|\r|\n")

MOST_NUMBERS = 0.5
"""Share of numbers among the cells of a line of units or words between the header and the first row; with more it is a row."""

FILLED = re.compile(r"^.*\S.*$", re.MULTILINE)
"""A line that is not blank."""

BLANK_SEPARATED_CELL = re.compile(r'"(?:[^"]|"")*"|[^\s"]+')
"""A cell between blanks; one in quotes may hold some."""


def read_in_dialect(content: bytes, path: Path, limit: Limit, dialect: Dialect, partial: bool = False) -> FileCells:
    """Read a table of text, or a sheet of a workbook, in a dialect.

    Args:
        content: Of the file.
        path: Whence it came, for messages.
        limit: Memory that its cells may take.
        dialect: How it is written.
        partial: Whether columns of dates and of lists that the dialect names need not be there.

    Returns:
        Its cells as text, numbers with points; columns of dates as numbers, [s]. Lines are those of the file.

    Raises:
        MeasurementError: it is written otherwise, is too large, or has no rows.
    """
    separator = dialect.separator
    if path.suffix.lower() in workbooks.WORKBOOK_ENDINGS:
        content, separator = workbooks.as_csv(content, path, limit, dialect.sheet, dialect.decimal), ","
        text = content.decode()
    else:
        text = decoded(content, path, dialect.encoding)
    if "\r" in text:
        text = LINE_END.sub("\n", text)
    begins = dialect.begins
    lines, body = (
        text.split("\n", begins - 1),
        "",
    )  # the rows stay one text: as lines they would take several times as much
    if len(lines) == begins:
        body = lines.pop()
    del text
    names = header_names(lines, dialect, separator, path)
    _check_between(lines, dialect, separator, path)
    body = _rows(body, dialect.comment, separator)
    first = FILLED.search(body)
    parted = "\t" if separator == BLANKS else separator
    names = _as_wide(names, split_line(first[0] if first else "", parted))
    above = max(begins - 1, 1)  # the reader begins below one line
    table = read_below_header(b"\n" * above + body.encode(), names, path, limit, parted)
    shift = above - begins + 1
    broken = tuple(replace(row, line=row.line - shift) for row in table.broken)
    table = replace(table, line=table.line - shift, broken=broken)
    if partial:
        dialect = _of_columns(dialect, table.cells.column_names)
    return replace(table, cells=_converted(table, dialect, path))


def _of_columns(dialect: Dialect, names: Collection[str]) -> Dialect:
    """A dialect without the dates and lists of columns that are not there."""
    dates = dialect.dates if dialect.dates and not set(dialect.dates.columns).isdisjoint(names) else None
    return replace(dialect, dates=dates, lists={name: parts for name, parts in dialect.lists.items() if name in names})


def decoded(content: bytes, path: Path, encoding: str) -> str:
    """A file's text without the mark of its byte order.

    Raises:
        MeasurementError: it is in another encoding.
    """
    if codecs.lookup(encoding).name == "utf-8":
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError as problem:
            raise not_utf8(content, problem.start, path, MeasurementError) from None
    try:
        text = content.decode(encoding)
    except (UnicodeError, LookupError) as problem:
        raise MeasurementError(
            f"{path}: is no text in {encoding}: {shortened(str(problem), 120)}; set `table.encoding`, or save it as UTF-8"
        ) from None
    text = text.removeprefix("\ufeff")
    try:
        text.encode()
    except UnicodeEncodeError:
        raise MeasurementError(f"{path}: is no text in {encoding}; set `table.encoding`, or save it as UTF-8") from None
    return text


def split_line(line: str, separator: str) -> list[str]:
    """The cells of a line, surrounding blanks removed; none of a blank line."""
    if not line.strip():
        return []
    if separator == BLANKS:
        cells = [cell.strip('"') for cell in BLANK_SEPARATED_CELL.findall(line)]
    else:
        try:
            cells = next(csv.reader([line.replace("\0", " ")], delimiter=separator), [])
        except csv.Error:
            return [line]
    return [cell.strip() for cell in cells]


def header_names(lines: Sequence[str], dialect: Dialect, separator: str, path: Path) -> list[str]:
    """Names of the columns: the cells of the header's lines, one below the other, with blanks between.

    A cell of an upper line that is empty has what stands left of it, as merged cells have, unless that line repeats its cells:
    then it is written in full. Repeated names get numbers.

    Raises:
        MeasurementError: there is no such line.
    """
    if not dialect.header:
        return list(dialect.names)
    if max(dialect.header) > len(lines) or max(map(len, (lines[k - 1] for k in dialect.header))) > LONGEST_LINE:
        raise MeasurementError(
            f"{path}: has no header in line {max(dialect.header)}; set `table.header`, which counts lines from 1"
        )
    rows = [split_line(strip_comment(lines[k - 1], dialect.comment), separator) for k in sorted(dialect.header)]
    if not any(cell for row in rows for cell in row):
        raise MeasurementError(
            f"{path}: line {max(dialect.header)} is empty; it should name the columns, or set `table.header`"
        )
    return joined_header(rows)


def joined_header(rows: Sequence[Sequence[str]]) -> list[str]:
    """Several lines of a header as one name a column, each of them another."""
    width = max((len(row) for row in rows), default=0)
    columns: list[list[str]] = [[] for _ in range(width)]
    for number, row in enumerate(rows):
        last = ""
        merged = (
            number < len(rows) - 1 and not is_units(row) and not any(a and a == b for a, b in itertools.pairwise(row))
        )
        for k in range(width):
            cell = row[k] if k < len(row) else ""
            if merged:
                last = cell or last
                cell = last if any(k < len(below) and below[k] for below in rows[number + 1 :]) else cell
            if cell and cell not in columns[k]:
                columns[k].append(cell)
    names: list[str] = []
    for parts in columns:
        name = " ".join(parts)
        again = sum(1 for earlier in names if name and (earlier == name or earlier.startswith(f"{name} #")))
        names.append(f"{name} #{again + 1}" if again else name)
    return names


UNIT_CELL = re.compile(
    r"[\[(]?\s*(?:rad|radians?|deg|degrees?|°|m|cm|mm|um|µm|in|inch|ft|s|sec|seconds?|ms|us|ns|°c|c|kg|n|nm|hz|-|1|%|v|a)\s*[\])]?",
    re.IGNORECASE,
)
"""What stands in a line of units."""


def is_units(row: Sequence[str]) -> bool:
    """True of a line of units."""
    filled = [cell for cell in row if cell]
    return (
        bool(filled) and all(UNIT_CELL.fullmatch(cell) for cell in filled) and not all(c in ("-", "1") for c in filled)
    )


def strip_comment(line: str, comment: Collection[str]) -> str:
    """A line without the mark of a comment at its beginning."""
    bare = line.lstrip()
    for mark in sorted(comment, key=len, reverse=True):
        if mark and bare.startswith(mark) and not mark[0].isalnum():
            return bare[len(mark) :]
    return line


def _rows(text: str, comment: Collection[str], separator: str) -> str:
    """Lines of a table; comments are blank, and cells between blanks are parted by tabs."""
    if comment:
        marks = "|".join(re.escape(mark) for mark in comment)
        text = re.sub(rf"^[^\S\n]*(?:{marks})[^\n]*", "", text, flags=re.MULTILINE)
    if separator == BLANKS:
        return "\n".join("\t".join(BLANK_SEPARATED_CELL.findall(line)) for line in text.split("\n"))
    return text


def _check_between(lines: Sequence[str], dialect: Dialect, separator: str, path: Path) -> None:
    """Refuse a table of which rows would be left out as lines of units."""
    number = re.compile(pattern(dialect))
    for k in range(max(dialect.header, default=0) + 1, min(dialect.begins, len(lines) + 1)):
        cells = [cell for cell in split_line(_rows(lines[k - 1], dialect.comment, ""), separator) if cell]
        if sum(bool(number.match(cell)) for cell in cells) > max(MOST_NUMBERS * len(cells), 2):
            raise MeasurementError(
                f"{path}, line {k}: holds numbers, but `table.first_row` is {dialect.begins}: a row would be left out. Set it "
                "to the line of the first row"
            )


def _as_wide(names: list[str], row: Sequence[str]) -> list[str]:
    """Names for as many columns as a row has, where only empty ones lack or are too many; names are none of blanks."""
    while len(names) > len(row) > 0 and not names[-1]:
        names = names[:-1]
    if len(row) > len(names) and not any(row[len(names) :]):
        names = names + [""] * (len(row) - len(names))
    return [name or (f"column {k + 1}" if k < len(row) and row[k] else "") for k, name in enumerate(names)]


def _converted(table: FileCells, dialect: Dialect, path: Path) -> pa.Table:
    """Cells whose numbers have points, lists taken apart and dates in seconds."""
    cells = table.cells
    for name in (*dialect.lists, *(dialect.dates.columns if dialect.dates else ())):
        if name not in cells.column_names:
            where = "lists" if name in dialect.lists else "dates"
            raise MeasurementError(
                f"{path}: no column {name!r}, which `table.{where}` names{nearest(name, cells.column_names)}"
            )
    names: list[str] = []
    columns: list[pa.ChunkedArray] = []
    for name in cells.column_names:
        if name in dialect.lists:
            parts = dialect.lists[name]
            names += parts
            columns += _taken_apart(cells[name], len(parts), dialect)
        elif dialect.dates and name in dialect.dates.columns:
            if name == dialect.dates.columns[-1]:
                names.append(dialect.dates.name)
                columns.append(_in_seconds(cells, table.line, dialect.dates, path))
        else:
            names.append(name)
            columns.append(as_numbers(cells[name], dialect))
    for k, name in enumerate(names):
        if name in names[:k]:
            raise MeasurementError(f"{path}: the column {name!r} is there twice; rename one, or set `table.lists`")
    if len(names) > MOST_COLUMNS:
        raise MeasurementError(
            f"{path}: has {len(names):,} columns, at most {MOST_COLUMNS:,} are read; split the table"
        )
    return pa.table(columns, names=names)


def _taken_apart(column: pa.ChunkedArray, count: int, dialect: Dialect) -> list[pa.ChunkedArray]:
    """Columns of the numbers in cells of lists; empty where a cell has another count of them."""
    lists = [numbers_in_list(cell or "", dialect) for cell in column.to_pylist()]
    nothing = [None] * count
    rows = [row if len(row) == count else nothing for row in lists]
    return [pa.chunked_array([pa.array([row[k] for row in rows], pa.string())]) for k in range(count)]


def _in_seconds(cells: pa.Table, lines: np.ndarray, dates: Dates, path: Path) -> pa.ChunkedArray:
    """Columns of dates as one of seconds; null where a cell is empty.

    Raises:
        MeasurementError: a cell is no date of that order, or times of day without a date pass several nights.
    """
    parts = [cells[name].to_pylist() for name in dates.columns]
    values: list[float | None] = []
    dated = False
    for k, row in enumerate(zip(*parts, strict=True)):
        text = " ".join(cell.strip() for cell in row if cell and cell.strip())
        value = seconds(text, dates.order) if text else None
        if text == dates.name:  # the header again, in the middle of a log
            text = ""
        if text and value is None:
            raise MeasurementError(
                f"{path}, line {lines[k]}: column {dates.name!r}, {shortened(text)}: is no date or time in the order "
                f"{dates.order}; mend the cell, or set `table.dates`"
            )
        dated = dated or (not dated and bool(text) and has_date(text))
        values.append(value)
    if dated:
        return pa.chunked_array([pa.array(values, pa.float64())])
    clock = unrolled(np.array(values, dtype=float), of_day=True)
    if clock is None:
        raise MeasurementError(f"{path}: column {dates.name!r} {NIGHTS}")
    return pa.chunked_array([pa.array(clock, from_pandas=True)])
