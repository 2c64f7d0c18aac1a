"""Tables of a user: csv, parquet and DataFrames read whole, every cell traceable to its file, line and column."""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from aridcal.errors import MeasurementError, nearest
from aridcal.inputs.yaml_file import decode, read_bytes

# What a user may give as a table: the path of a csv or parquet file, or the rows themselves.
AnyTable = str | Path | pd.DataFrame

# Stands in messages where a table has no file. Its row k is called line k + 2, as if it were saved as csv.
IN_MEMORY = Path("DataFrame")

# Line of a table's first row: the header is line 1.
FIRST_LINE = 2

# A number with a comma in place of the point.
DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*")

# What a header is not made of.
NUMBER = re.compile(r"[-+]?[\d.]+([eE][-+]?\d+)?")

# Columns that pandas adds to a parquet file for the index of a DataFrame.
PANDAS_INDEX = re.compile(r"__index_level_\d+__")

# Characters of a cell that a message shows.
SHOWN = 60


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
        cell = ", ".join(filter(None, [f"column {self.column!r}" if self.column else "", self.value[:SHOWN]]))
        return f"{where}: {cell}: {self.why}" if cell else f"{where}: {self.why}"


@dataclass(frozen=True)
class Table:
    """One table out of one or more files with the same columns, N rows.

    Attributes:
        files: Where the rows come from.
        names: Columns as the files name them, in the order of the first file.
        cells: For each column its cells, one array per file: text from csv, typed from parquet, null where empty.
        file: Index into `files`, shape (N,).
        line: Line of the file, shape (N,); the header is line 1.
        refused: Rows that do not have as many cells as the header. They are not among the N.
        sha256: Hash of the bytes of all files.
        partial: Columns that were left out because a file lacks them, each with the first such file.
    """

    files: tuple[Path, ...]
    names: tuple[str, ...]
    cells: dict[str, tuple[pa.ChunkedArray, ...]]
    file: np.ndarray
    line: np.ndarray
    refused: tuple[Remark, ...]
    sha256: str
    partial: dict[str, Path] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.line)

    @property
    def title(self) -> str:
        """The files, for messages."""
        more = f" and {len(self.files) - 1} more" if len(self.files) > 1 else ""
        return f"{self.files[0]}{more}"

    def numbers(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Read a column as numbers.

        Returns:
            The values, shape (N,), NaN where there is none; and which cells hold text instead, shape (N,) bool.
        """
        by_file = [_numbers(column) for column in self.cells[name]]
        values = np.concatenate([values for values, _ in by_file])
        is_text = np.concatenate([is_text for _, is_text in by_file])
        return values, is_text

    def matrix(self, names: Iterable[str]) -> np.ndarray:
        """Read several columns as numbers, shape (N, columns), NaN where there is none."""
        return np.column_stack([self.numbers(name)[0] for name in names])

    def texts(self, name: str) -> np.ndarray:
        """Read a column as text, shape (N,), surrounding blanks removed and empty cells as ``""``."""
        by_file = []
        for column in self.cells[name]:
            filled = _trimmed(column).fill_null("")
            by_file.append(filled.to_numpy(zero_copy_only=False))
        return np.concatenate(by_file).astype(str)

    def cell(self, row: int, name: str) -> str:
        """One cell as text; `row` counts the table's rows from 0."""
        if name not in self.cells:
            return ""
        file = self.file[row]
        first_of_file = np.searchsorted(self.file, file)
        value = self.cells[name][file][int(row - first_of_file)].as_py()
        return "" if value is None else str(value)[:SHOWN]

    def remark(self, row: int, column: str, why: str, value: str | None = None) -> Remark:
        """Name a cell of a row (counted from 0) and what is wrong with it."""
        value = self.cell(row, column) if value is None else value
        return Remark(self.files[self.file[row]].name, int(self.line[row]), column, value, why)

    def frame(self) -> pd.DataFrame:
        """All cells, as they were written in csv."""
        columns = {}
        for name in self.names:
            by_file = [column.to_pandas() for column in self.cells[name]]
            columns[name] = np.concatenate(by_file)
        return pd.DataFrame(columns)

    def require(self, columns: Sequence[str], advice: str = "") -> None:
        """Check that columns are there.

        Raises:
            MeasurementError: naming those that are not, and what they may be called instead.
        """
        missing = [name for name in columns if name not in self.cells]
        if not missing:
            return
        spare = [name for name in self.names if name and name not in columns]
        wanted = ", ".join(repr(name) + _close(name, spare) for name in missing)
        there = ", ".join(name or "''" for name in self.names)
        raise MeasurementError(f"{self.title}: no column {wanted}; there are: {there}. {advice}".rstrip())


@dataclass(frozen=True)
class _Part:
    """One file, read.

    Attributes:
        path: Its name, for messages.
        cells: Its columns, n rows.
        line: Line of each row, shape (n,).
        refused: Rows that do not have as many cells as the header; they are not among the n.
        content: Its bytes.
    """

    path: Path
    cells: pa.Table
    line: np.ndarray
    refused: tuple[Remark, ...]
    content: bytes


def read_tables(tables: Sequence[AnyTable], spare: Collection[str] | None = ()) -> Table:
    """Read csv (UTF-8, comma, decimal point, one header line) and parquet files and DataFrames as one table.

    Args:
        tables: In the order of their rows.
        spare: Columns that are left out if some files lack them; None: any.

    Raises:
        MeasurementError: a file is missing, empty, of another kind or in another dialect, has a column twice, or the
            files do not have the same columns.
    """
    parts = [_read(table) for table in tables]
    having = {name: part.path for part in reversed(parts) for name in part.cells.column_names}
    lacking = {name: part.path for part in reversed(parts) for name in having if name not in part.cells.column_names}
    for name in sorted(lacking if spare is not None else ()):
        if name not in (spare or ()):
            raise MeasurementError(
                f"{lacking[name]}: no column {name!r}, which {having[name]} has; files that are read together need the same "
                f"columns. Add it, or leave it out: `ignore: [{name}]` under measurements"
            )
    names = [name for name in parts[0].cells.column_names if name not in lacking]
    counts = [part.cells.num_rows for part in parts]
    everything = b"".join(part.content for part in parts)
    return Table(
        files=tuple(part.path for part in parts),
        names=tuple(names),
        cells={name: tuple(part.cells[name] for part in parts) for name in names},
        file=np.repeat(np.arange(len(parts)), counts),
        line=np.concatenate([part.line for part in parts]),
        refused=tuple(remark for part in parts for remark in part.refused),
        sha256=hashlib.sha256(everything).hexdigest(),
        partial=lacking,
    )


def _read(table: AnyTable) -> _Part:
    if isinstance(table, pd.DataFrame):
        return _read_frame(table)
    path = Path(table)
    readers = {".csv": _read_csv, ".parquet": _read_parquet}
    content = read_bytes(path, MeasurementError)
    if path.suffix.lower() not in readers:
        raise MeasurementError(f"{path}: should be a .csv or .parquet file")
    return readers[path.suffix.lower()](content, path)


def _read_frame(frame: pd.DataFrame) -> _Part:
    """Take the columns of a DataFrame; its index is no column."""
    names = [str(name) for name in frame.columns]
    _check_header(names, IN_MEMORY)
    if frame.empty:
        raise MeasurementError(f"{IN_MEMORY}: has columns but no rows")
    columns = [_arrow(frame.iloc[:, k]) for k in range(len(names))]
    as_csv = frame.to_csv(index=False).encode()
    return _whole(IN_MEMORY, pa.table(columns, names=names), as_csv)


def _arrow(column: pd.Series) -> pa.ChunkedArray:
    """A column with its type, or as text where its cells are of several types."""
    try:
        cells = pa.array(column, from_pandas=True)
    except (pa.ArrowInvalid, pa.ArrowTypeError, pa.ArrowNotImplementedError):
        texts = [None if empty else str(cell) for cell, empty in zip(column, column.isna(), strict=True)]
        cells = pa.array(texts, pa.string())
    return cells if isinstance(cells, pa.ChunkedArray) else pa.chunked_array([cells])


def _read_parquet(content: bytes, path: Path) -> _Part:
    try:
        cells = pa.parquet.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError) as problem:
        raise MeasurementError(f"{path}: is not a readable Parquet file: {str(problem).splitlines()[0]}") from None
    index = [name for name in cells.column_names if PANDAS_INDEX.fullmatch(name)]
    cells = cells.drop_columns(index)
    _check_header(cells.column_names, path)
    if not cells.num_rows:
        raise MeasurementError(f"{path}: has columns but no rows")
    return _whole(path, cells, content)


def _whole(path: Path, cells: pa.Table, content: bytes) -> _Part:
    """A table in which no row can be broken."""
    line = np.arange(FIRST_LINE, FIRST_LINE + cells.num_rows)
    return _Part(path, cells, line, (), content)


def _read_csv(content: bytes, path: Path) -> _Part:
    """Read csv as text cells; rows with too few or too many cells are refused, blank lines are no rows."""
    text = _plain(content, path)
    header = _header(text, path)
    if not re.search(rb"\n\s*\S", text):
        _check_header(header, path)
        raise MeasurementError(f"{path}: has a header but no rows")
    cells, broken = _parse_csv(text, len(header), path)
    line = np.arange(FIRST_LINE, FIRST_LINE + cells.num_rows + len(broken))
    line = np.delete(line, [row.number - FIRST_LINE for row in broken])
    if b'"' in text:
        _refuse_line_breaks(cells, line, broken, path)
    empty = [cells[k].null_count == cells.num_rows for k in range(len(header))]
    kept = [k for k, name in enumerate(header) if name or not empty[k]]
    cells = cells.rename_columns(header).select(kept)
    _check_header(cells.column_names, path)
    if cells.num_rows and cells[0].null_count:
        blank = np.logical_and.reduce([column.is_null().to_numpy() for column in cells.columns])
        cells, line = cells.filter(~blank), line[~blank]
    broken = [row for row in broken if row.text.strip()]
    if broken and not cells.num_rows:
        row = broken[0]
        raise MeasurementError(
            f"{path}: no row has as many cells as the header, {len(header)}; line {row.number} has "
            f"{row.actual_columns}. Decimal commas, or a separator too many? Write points, separate with commas"
        )
    refused = []
    for row in broken:
        why = f"{row.actual_columns} cells in a row of {len(header)} columns"
        refused.append(Remark(path.name, row.number, "", row.text[:SHOWN], why))
    return _Part(path, cells, line, tuple(refused), content)


def _plain(content: bytes, path: Path) -> bytes:
    """UTF-8 without a byte order mark, lines ended as on Unix."""
    if not content.isascii():
        decode(content, path, MeasurementError)
        content = content.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content


def _header(text: bytes, path: Path) -> list[str]:
    """The names of the columns, surrounding blanks removed."""
    first = io.BytesIO(text).readline().decode().strip("\n")
    try:
        cells = next(csv.reader([first]), [])
    except csv.Error as problem:
        raise MeasurementError(f"{path}, line 1: is not a header row: {problem}") from None
    if len(cells) <= 1 and re.search(r"[;\t]", first):
        raise MeasurementError(
            f"{path}: looks separated by semicolons or tabs; convert it to commas and decimal points"
        )
    return [name.strip() for name in cells] or [""]


def _parse_csv(text: bytes, columns: int, path: Path) -> tuple[pa.Table, list[pyarrow.csv.InvalidRow]]:
    """Read the rows below the header as text, and those that do not have as many cells."""
    broken: list[pyarrow.csv.InvalidRow] = []

    def skip(row: pyarrow.csv.InvalidRow) -> str:
        broken.append(row)
        return "skip"

    numbers = [str(k) for k in range(columns)]
    # One thread: only then does a broken row know its line.
    reading = pyarrow.csv.ReadOptions(use_threads=False, column_names=numbers, skip_rows=1)
    parsing = pyarrow.csv.ParseOptions(ignore_empty_lines=False, invalid_row_handler=skip)
    as_text = pyarrow.csv.ConvertOptions(
        column_types=dict.fromkeys(numbers, pa.string()), null_values=[""], strings_can_be_null=True
    )
    try:
        cells = pyarrow.csv.read_csv(pa.BufferReader(text), reading, parsing, as_text)
    except pa.ArrowException as problem:
        raise MeasurementError(f"{path}: cannot be read as a table: {str(problem).splitlines()[0]}") from None
    return cells, broken


def _refuse_line_breaks(cells: pa.Table, line: np.ndarray, broken: list[pyarrow.csv.InvalidRow], path: Path) -> None:
    """A quote left open would swallow rows unseen, and a cell of several lines would shift the count of lines."""
    lines = [row.number for row in broken if "\n" in row.text]
    for column in cells.columns:
        several = pc.match_substring(column, "\n")
        found = pc.index(several, True).as_py()
        if found >= 0:
            lines.append(int(line[found]))
    if lines:
        raise MeasurementError(f"{path}, line {min(lines)}: a quote is left open, or a cell has several lines")


def _check_header(names: list[str], path: Path) -> None:
    if not any(names):
        raise MeasurementError(f"{path}: line 1 is empty; it should name the columns")
    for number, name in enumerate(names):
        if name in names[:number]:
            raise MeasurementError(f"{path}: the column {name!r} is there twice; rename or delete one")
    if all(NUMBER.fullmatch(name) for name in names):
        raise MeasurementError(f"{path}: line 1 holds numbers; it should name the columns")


def _numbers(column: pa.ChunkedArray) -> tuple[np.ndarray, np.ndarray]:
    """Values of a column, NaN where there is no number, and which cells hold text instead; shape (n,) each."""
    if _is_numeric(column.type):
        values = pc.cast(column, pa.float64(), safe=False).to_numpy()
        return values.astype(float), np.zeros(len(column), dtype=bool)
    text = _trimmed(column)
    try:
        values = pc.cast(text, pa.float64()).to_numpy()
        return values.astype(float), np.zeros(len(column), dtype=bool)
    except pa.ArrowInvalid:
        cells = text.to_pandas()
    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)
    spelt_nan = cells.str.fullmatch("[-+]?nan", case=False).fillna(False).to_numpy(dtype=bool)
    filled = cells.notna().to_numpy()
    return values, np.isnan(values) & filled & ~spelt_nan


def _trimmed(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Text of a column without surrounding blanks, null where nothing is left."""
    try:
        text = pc.utf8_trim_whitespace(pc.cast(column, pa.string()))
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # lists and the like
        texts = [str(value) for value in column.to_pylist()]
        text = pa.chunked_array([pa.array(texts, pa.string())])
    nothing = pc.equal(text, "")
    return pc.if_else(nothing, pa.scalar(None, pa.string()), text)


def _is_numeric(kind: pa.DataType) -> bool:
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    return number or pa.types.is_boolean(kind) or pa.types.is_null(kind)


def _close(name: str, names: Sequence[str]) -> str:
    """A hint at the name that was meant; empty where none is close."""
    hint = nearest(name, names)
    return hint if "did you mean" in hint else ""
