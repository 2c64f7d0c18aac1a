"""A table as it stands in a file: csv as text cells, parquet with its types, none larger in memory than it may be."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv

from aridcal.system.errors import MeasurementError, shortened
from aridcal.system.reading.regular_files import MEGA, Limit, not_utf8
from aridcal.system.reading.user_names import check_name

# Line of a table's first row: the header is line 1.
FIRST_LINE = 2

# What a header is not made of.
NUMBER_CELL = re.compile(r"[-+]?[\d.]+([eE][-+]?\d+)?")

# Columns that pandas adds to a parquet file for the index of a DataFrame.
PANDAS_INDEX = re.compile(r"__index_level_\d+__")

# Bytes of a cell as a number; as text it also takes what is written in it, which is no more than the file's own size.
BYTES_OF_A_CELL = 8

# Bytes of a line of csv: that of 100,000 columns of 17 digits takes 2 MB.
LONGEST_LINE = 16_000_000

# A column takes some 5 kB beside its cells, and each is a covariate to be looked at.
MOST_COLUMNS = 10_000

# Rows with too few or too many cells that are listed; a file with more is no table of that header.
MOST_BROKEN = 100_000

# Bytes that are checked together, so that a file of many MB is never there twice.
BYTES_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class BrokenRow:
    """A row that does not have as many cells as the header.

    Attributes:
        line: Of the file.
        text: Its beginning.
        why: What is wrong, for messages.
    """

    line: int
    text: str
    why: str


@dataclass(frozen=True)
class FileCells:
    """One file, read.

    Attributes:
        cells: Its columns, n rows.
        line: Line of each row, shape (n,).
        broken: Rows that do not have as many cells as the header; they are not among the n.
        left_out: Columns that are there and were not read.
    """

    cells: pa.Table
    line: np.ndarray
    broken: tuple[BrokenRow, ...] = ()
    left_out: tuple[str, ...] = ()


def whole(cells: pa.Table) -> FileCells:
    """A table in which no row can be broken."""
    return FileCells(cells, np.arange(FIRST_LINE, FIRST_LINE + cells.num_rows))


def check_header(names: list[str], path: Path) -> None:
    """Refuse columns that cannot be told from each other, or not be named in a message.

    Raises:
        MeasurementError: naming the column.
    """
    if not any(names):
        raise MeasurementError(f"{path}: line 1 is empty; it should name the columns")
    if all(NUMBER_CELL.fullmatch(name) for name in names):
        raise MeasurementError(f"{path}: line 1 holds numbers; it should name the columns")
    _check_columns(names, path)


def _check_columns(names: list[str], path: Path) -> None:
    """Refuse too many columns, two of one name, and names that no message can show."""
    if len(names) > MOST_COLUMNS:
        raise MeasurementError(
            f"{path}: has {len(names):,} columns, at most {MOST_COLUMNS:,} are read; split the table"
        )
    earlier = set()
    for name in names:
        check_name(name, f"{path}: a column", MeasurementError)
        if name in earlier:
            raise MeasurementError(f"{path}: the column {name!r} is there twice; rename or delete one")
        earlier.add(name)


def check_size(path: Path, rows: int, columns: int, limit: Limit) -> None:
    """Refuse a table that would not fit into memory, before it is read.

    Raises:
        MeasurementError: with what it would take.
    """
    size = BYTES_OF_A_CELL * rows * columns / MEGA
    if size > limit.megabytes:
        raise MeasurementError(
            f"{path}: {rows:,} rows of {columns:,} columns would take {size:,.0f} MB, at most {limit.megabytes:g} MB are read; "
            f"{limit.remedy}"
        )


def read_parquet(content: bytes, path: Path, limit: Limit, spare: Collection[str] | None) -> FileCells:
    """Read a parquet file: what its footer says decides whether the rest is read at all.

    Args:
        content: Its bytes.
        path: Whence they came, for messages.
        limit: Memory that it may take.
        spare: Columns that may be left out; None: any.

    Raises:
        MeasurementError: it is none, is too large, has no rows, or has lists or structures that may not be left out.
    """
    from pyarrow import parquet  # slow to load, and csv is read without it

    try:
        footer = parquet.read_metadata(pa.BufferReader(content))
        schema = footer.schema.to_arrow_schema()
        names = [name for name in schema.names if not PANDAS_INDEX.fullmatch(name)]
        check_header(names, path)
        # How much these take nothing tells before they are read; and they are no numbers.
        nested = [name for name in names if pa.types.is_nested(schema.field(name).type)]
        for name in nested:
            if spare is not None and name not in spare:
                raise MeasurementError(
                    f"{path}: the column {name!r} holds lists or structures, which are no numbers; delete it, or leave it out: "
                    f"`ignore: [{name}]` under measurements"
                )
        names = [name for name in names if name not in nested]
        check_size(path, footer.num_rows, len(names), limit)
        texts = [name for name in names if _is_text(schema.field(name).type)]
        # Words as they are stored, each once: a word of a megabyte in a million rows takes a few bytes there.
        file = parquet.ParquetFile(pa.BufferReader(content), read_dictionary=texts)
        batches, rows = [], 0
        for batch in file.iter_batches(columns=names):
            rows += batch.num_rows
            check_size(path, rows, len(names), limit)  # the footer may lie
            batches.append(batch)
        cells = pa.Table.from_batches(batches) if batches else schema.empty_table().select(names)
        _check_words(cells, path, limit)
        cells = cells.cast(pa.schema([schema.field(name) for name in names]))
        cells.validate(full=True)  # words that are not UTF-8, above all
    except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as problem:
        reason = shortened((str(problem) or type(problem).__name__).splitlines()[0], 200)
        raise MeasurementError(f"{path}: is not a readable Parquet file: {reason}. Write it anew, or as csv") from None
    if not cells.num_rows:
        raise MeasurementError(f"{path}: has columns but no rows; name the table that was measured")
    return replace(whole(cells), left_out=tuple(nested))


def _check_words(cells: pa.Table, path: Path, limit: Limit) -> None:
    """Refuse words that are stored once and would be in memory in every row."""
    for name, column in zip(cells.column_names, cells.columns, strict=True):
        size = sum(_written_out(chunk) for chunk in column.chunks) / MEGA
        if size > limit.megabytes:
            raise MeasurementError(
                f"{path}: the words of column {name!r} would take {size:,.0f} MB, at most {limit.megabytes:g} MB are read; "
                f"delete the column, or {limit.remedy}"
            )


def _written_out(cells: pa.Array) -> int:
    """Bytes of words that are stored once, in each of their rows."""
    if not pa.types.is_dictionary(cells.type) or not _is_text(cells.type.value_type):
        return 0
    lengths = pc.binary_length(cells.dictionary)
    return int(pc.sum(pc.take(lengths, cells.indices)).as_py() or 0)


def _is_text(kind: pa.DataType) -> bool:
    text = pa.types.is_string(kind) or pa.types.is_large_string(kind)
    return text or pa.types.is_binary(kind) or pa.types.is_large_binary(kind)


NO_ROWS = "has a header but no rows; name the table that was measured"
"""What a message says of a table without a cell."""


def read_csv(content: bytes, path: Path, limit: Limit) -> FileCells:
    """Read csv as text cells; rows with too few or too many cells are broken, blank lines are no rows.

    Args:
        content: UTF-8, comma, one header line.
        path: Whence it came, for messages.
        limit: Memory that its cells may take.

    Raises:
        MeasurementError: it is in another dialect, is too large, has a column twice, no rows, or open quotes.
    """
    text = _plain(content, path)
    header = _header(text, path)
    if not re.search(rb"\n\s*\S", text):
        check_header(header, path)
        raise MeasurementError(f"{path}: {NO_ROWS}")
    return read_below_header(text, header, path, limit)


def read_below_header(text: bytes, header: list[str], path: Path, limit: Limit, separator: str = ",") -> FileCells:
    """Read the rows below the first line as text cells.

    Args:
        text: UTF-8 with line ends as on Unix; its first line is not looked at.
        header: Names of the columns.
        path: Whence it came, for messages.
        limit: Memory that its cells may take.
        separator: Between cells.

    Raises:
        MeasurementError: as :func:`read_csv`.
    """
    _check_columns([name for name in header if name], path)
    check_size(path, text.count(b"\n"), len(header), limit)
    cells, broken, blank = _parse(text, len(header), path, separator)
    line = np.arange(FIRST_LINE, FIRST_LINE + cells.num_rows + len(broken) + len(blank))
    line = np.delete(line, np.array([row.number for row in broken] + blank, dtype=int) - FIRST_LINE)
    if b'"' in text:
        _refuse_line_breaks(cells, line, broken, path)
    empty = [cells[k].null_count == cells.num_rows for k in range(len(header))]
    chosen = [k for k, name in enumerate(header) if name or not empty[k]]
    cells = cells.rename_columns(header).select(chosen)
    check_header(cells.column_names, path)
    if cells.num_rows and cells[0].null_count:
        nothing = np.logical_and.reduce([column.is_null().to_numpy() for column in cells.columns])
        cells, line = cells.filter(~nothing), line[~nothing]
    if not (cells.num_rows or broken):
        raise MeasurementError(f"{path}: {NO_ROWS}")
    if broken and not cells.num_rows:
        row = broken[0]
        raise MeasurementError(
            f"{path}: no row has as many cells as the header, {len(header)}; line {row.number} has "
            f"{row.actual_columns}. Decimal commas, or a separator too many? Write points, separate with commas"
        )
    why = f"cells in a row of {len(header)} columns"
    return FileCells(
        cells, line, tuple(BrokenRow(row.number, shortened(row.text), f"{row.actual_columns} {why}") for row in broken)
    )


def _plain(content: bytes, path: Path) -> bytes:
    """UTF-8 without a byte order mark, lines ended as on Unix."""
    if not content.isascii():
        _check_utf8(content, path)
        content = content.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content


def _check_utf8(content: bytes, path: Path) -> None:
    """Refuse other encodings; decoded as a whole, a file would take up to four times its size."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    for start in range(0, len(content), BYTES_AT_ONCE):
        try:
            decoder.decode(content[start : start + BYTES_AT_ONCE], final=start + BYTES_AT_ONCE >= len(content))
        except UnicodeDecodeError as problem:
            raise not_utf8(content, start + problem.start, path, MeasurementError) from None


def _header(text: bytes, path: Path) -> list[str]:
    """The names of the columns, surrounding blanks removed."""
    end = text.find(b"\n")
    end = len(text) if end < 0 else end
    if end > LONGEST_LINE:
        raise MeasurementError(
            f"{path}, line 1: has {end / MEGA:,.1f} MB; is a line break missing? End each row with one"
        )
    first = text[:end].decode(errors="replace")
    try:
        cells = next(csv.reader([first]), [])
    except csv.Error as problem:
        raise MeasurementError(f"{path}, line 1: is not a header row: {problem}. It should name the columns") from None
    if len(cells) <= 1 and re.search(r"[;\t]", first):
        raise MeasurementError(
            f"{path}: looks separated by semicolons or tabs; `aridcal init` finds out how it is written, or convert it to commas "
            "and decimal points"
        )
    return [name.strip() for name in cells] or [""]


def _parse(
    text: bytes, columns: int, path: Path, separator: str
) -> tuple[pa.Table, list[pyarrow.csv.InvalidRow], list[int]]:
    """Read the rows below the header as text, those that do not have as many cells, and the lines that are blank."""
    broken: list[pyarrow.csv.InvalidRow] = []
    blank: list[int] = []

    def skip(row: pyarrow.csv.InvalidRow) -> str:
        if row.text.strip():
            broken.append(row)
        else:
            blank.append(row.number)
        return "skip" if len(broken) <= MOST_BROKEN else "error"

    numbers = [str(k) for k in range(columns)]
    # One thread: only then does a broken row know its line.
    reading = pyarrow.csv.ReadOptions(
        use_threads=False, column_names=numbers, skip_rows=1, block_size=min(len(text) + 1, LONGEST_LINE)
    )
    parsing = pyarrow.csv.ParseOptions(delimiter=separator, ignore_empty_lines=False, invalid_row_handler=skip)
    as_text = pyarrow.csv.ConvertOptions(
        column_types=dict.fromkeys(numbers, pa.string()), null_values=[""], strings_can_be_null=True
    )
    try:
        cells = pyarrow.csv.read_csv(pa.BufferReader(text), reading, parsing, as_text)
    except (pa.ArrowException, MemoryError) as problem:
        if len(broken) > MOST_BROKEN:
            raise MeasurementError(
                f"{path}, line {broken[0].number}: has {broken[0].actual_columns} cells in a row of {columns} columns, like "
                f"{MOST_BROKEN:,} rows more; mend the header or the rows"
            ) from None
        if "straddling" in str(problem):
            raise MeasurementError(
                f"{path}: a row has more than {LONGEST_LINE / MEGA:g} MB; is a line break missing? End each row with one"
            ) from None
        reason = shortened((str(problem) or type(problem).__name__).splitlines()[0], 200)
        raise MeasurementError(f"{path}: cannot be read as a table: {reason}. Write it anew") from None
    return cells, broken, blank


def _refuse_line_breaks(cells: pa.Table, line: np.ndarray, broken: list[pyarrow.csv.InvalidRow], path: Path) -> None:
    """A quote left open would swallow rows unseen, and a cell of several lines would shift the count of lines."""
    lines = [row.number for row in broken if "\n" in row.text]
    for column in cells.columns:
        several = pc.match_substring(column, "\n")
        if pc.any(several).as_py():
            lines.append(int(line[several.to_pylist().index(True)]))
    if lines:
        raise MeasurementError(
            f"{path}, line {min(lines)}: a quote is left open, or a cell has several lines; close it, or write one line"
        )
