"""Tables of a user: csv and parquet read whole, every cell traceable to its file, line and column."""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from aridcal.errors import MeasurementError, nearest
from aridcal.settings import decode, read_bytes

DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*")
SHOWN = 60
"""Characters of a cell that a message shows."""


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
    """

    files: tuple[Path, ...]
    names: tuple[str, ...]
    cells: dict[str, tuple[pa.ChunkedArray, ...]]
    file: np.ndarray
    line: np.ndarray
    refused: tuple[Remark, ...]
    sha256: str

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
        values, texts = zip(*[_numbers(chunk) for chunk in self.cells[name]], strict=True)
        return np.concatenate(values), np.concatenate(texts)

    def texts(self, name: str) -> np.ndarray:
        """Read a column as text, shape (N,), surrounding blanks removed and empty cells as ``""``."""
        chunks = [_trimmed(chunk).fill_null("").to_numpy(zero_copy_only=False) for chunk in self.cells[name]]
        return np.concatenate(chunks).astype(str)

    def cell(self, row: int, name: str) -> str:
        """One cell as text; `row` counts the table's rows from 0."""
        if name not in self.cells:
            return ""
        file = self.file[row]
        value = self.cells[name][file][int(row - np.searchsorted(self.file, file))].as_py()
        return "" if value is None else str(value)[:SHOWN]

    def remark(self, row: int, column: str, why: str, value: str | None = None) -> Remark:
        """Name a cell of a row (counted from 0) and what is wrong with it."""
        value = self.cell(row, column) if value is None else value
        return Remark(self.files[self.file[row]].name, int(self.line[row]), column, value, why)

    def frame(self) -> pd.DataFrame:
        """All cells, as they were written in csv."""
        return pd.DataFrame({name: np.concatenate([c.to_pandas() for c in self.cells[name]]) for name in self.names})

    def require(self, columns: Sequence[str], advice: str = "") -> None:
        """Check that columns are there.

        Raises:
            MeasurementError: naming those that are not, and what they may be called instead.
        """
        missing = [name for name in columns if name not in self.cells]
        if missing:
            spare = [name for name in self.names if name and name not in columns]
            hints = [repr(name) + (nearest(name, spare) if _close(name, spare) else "") for name in missing]
            there = ", ".join(name or "''" for name in self.names)
            raise MeasurementError(f"{self.title}: no column {', '.join(hints)}; there are: {there}. {advice}".rstrip())


def read_tables(paths: Sequence[Path]) -> Table:
    """Read csv (UTF-8, comma, decimal point, one header line) and parquet files as one table.

    Raises:
        MeasurementError: a file is missing, empty, of another kind or in another dialect, has a column twice, or the
            files do not have the same columns.
    """
    contents = [read_bytes(path, MeasurementError) for path in paths]
    parts = [_read(content, path) for content, path in zip(contents, paths, strict=True)]
    names = parts[0][0].column_names
    for path, (part, _, _) in zip(paths[1:], parts[1:], strict=True):
        for name in set(names) ^ set(part.column_names):
            lacking, having = (paths[0], path) if name not in names else (path, paths[0])
            raise MeasurementError(f"{lacking}: no column {name!r}, which {having} has; files read together must agree")
    counts = [part.num_rows for part, _, _ in parts]
    return Table(
        files=tuple(paths),
        names=tuple(names),
        cells={name: tuple(part[name] for part, _, _ in parts) for name in names},
        file=np.repeat(np.arange(len(parts)), counts),
        line=np.concatenate([line for _, line, _ in parts]),
        refused=tuple(remark for _, _, refused in parts for remark in refused),
        sha256=hashlib.sha256(b"".join(contents)).hexdigest(),
    )


def _read(content: bytes, path: Path) -> tuple[pa.Table, np.ndarray, list[Remark]]:
    readers = {".csv": _read_csv, ".parquet": _read_parquet}
    if path.suffix.lower() not in readers:
        raise MeasurementError(f"{path}: should be a .csv or .parquet file")
    return readers[path.suffix.lower()](content, path)


def _read_parquet(content: bytes, path: Path) -> tuple[pa.Table, np.ndarray, list[Remark]]:
    try:
        table = pa.parquet.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError) as problem:
        raise MeasurementError(f"{path}: is not a readable Parquet file: {str(problem).splitlines()[0]}") from None
    index = [name for name in table.column_names if re.fullmatch(r"__index_level_\d+__", name)]
    table = table.drop_columns(index)
    _check_header(table.column_names, path)
    if not table.num_rows:
        raise MeasurementError(f"{path}: has columns but no rows")
    return table, np.arange(2, table.num_rows + 2), []


def _read_csv(content: bytes, path: Path) -> tuple[pa.Table, np.ndarray, list[Remark]]:
    if not content.isascii():
        decode(content, path, MeasurementError)
        content = content.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    first = io.BytesIO(content).readline().decode().strip("\n")
    try:
        header = [name.strip() for name in next(csv.reader([first]), [])] or [""]
    except csv.Error as problem:
        raise MeasurementError(f"{path}, line 1: is no header row: {problem}") from None
    if len(header) <= 1 and re.search(r"[;\t]", first):
        raise MeasurementError(
            f"{path}: looks separated by semicolons or tabs; convert it to commas and decimal points"
        )
    if not re.search(rb"\n\s*\S", content):
        _check_header(header, path)
        raise MeasurementError(f"{path}: has a header but no rows")
    broken: list[pyarrow.csv.InvalidRow] = []

    def skip(row: pyarrow.csv.InvalidRow) -> str:
        broken.append(row)
        return "skip"

    positions = [str(k) for k in range(len(header))]
    try:
        table = pyarrow.csv.read_csv(
            pa.BufferReader(content),
            # one thread: only then does a broken row know its line
            read_options=pyarrow.csv.ReadOptions(use_threads=False, column_names=positions, skip_rows=1),
            parse_options=pyarrow.csv.ParseOptions(ignore_empty_lines=False, invalid_row_handler=skip),
            convert_options=pyarrow.csv.ConvertOptions(
                column_types=dict.fromkeys(positions, pa.string()), null_values=[""], strings_can_be_null=True
            ),
        )
    except pa.ArrowException as problem:
        raise MeasurementError(f"{path}: cannot be read as a table: {str(problem).splitlines()[0]}") from None
    line = np.arange(2, table.num_rows + len(broken) + 2)
    line = np.delete(line, [row.number - 2 for row in broken])
    if b'"' in content:
        _refuse_line_breaks(table, line, broken, path)
    unused = [k for k, name in enumerate(header) if not name and table[k].null_count == table.num_rows]
    table = table.rename_columns(header).select([k for k in range(len(header)) if k not in unused])
    _check_header(table.column_names, path)
    if table.num_rows and table[0].null_count:
        blank = np.logical_and.reduce([column.is_null().to_numpy() for column in table.columns])
        table, line = table.filter(~blank), line[~blank]
    broken = [row for row in broken if row.text.strip()]
    if broken and not table.num_rows:
        row = broken[0]
        raise MeasurementError(
            f"{path}: no row has as many cells as the header, {len(header)}; line {row.number} has "
            f"{row.actual_columns}. Decimal commas, or a separator too many? Write points, separate with commas"
        )
    why = f"cells in a row of {len(header)} columns"
    refused = [Remark(path.name, row.number, "", row.text[:SHOWN], f"{row.actual_columns} {why}") for row in broken]
    return table, line, refused


def _refuse_line_breaks(table: pa.Table, line: np.ndarray, broken: list[pyarrow.csv.InvalidRow], path: Path) -> None:
    """A quote left open would swallow rows unseen, and a cell of several lines would shift the count of lines."""
    rows = [row.number for row in broken if "\n" in row.text]
    for column in table.columns:
        found = pc.index(pc.match_substring(column, "\n"), True).as_py()
        rows += [int(line[found])] if found >= 0 else []
    if rows:
        raise MeasurementError(f"{path}, line {min(rows)}: a quote is left open, or a cell has several lines")


def _check_header(names: list[str], path: Path) -> None:
    if not any(names):
        raise MeasurementError(f"{path}: line 1 is empty; it should name the columns")
    for number, name in enumerate(names):
        if name in names[:number]:
            raise MeasurementError(f"{path}: the column {name!r} is there twice; rename or delete one")
    if all(re.fullmatch(r"[-+]?[\d.]+([eE][-+]?\d+)?", name) for name in names):
        raise MeasurementError(f"{path}: line 1 holds numbers; it should name the columns")


def _numbers(column: pa.ChunkedArray) -> tuple[np.ndarray, np.ndarray]:
    none = np.zeros(len(column), dtype=bool)
    if _is_numeric(column.type):
        return pc.cast(column, pa.float64(), safe=False).to_numpy().astype(float), none
    text = _trimmed(column)
    try:
        return pc.cast(text, pa.float64()).to_numpy().astype(float), none
    except pa.ArrowInvalid:
        cells = text.to_pandas()
        values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)
        spelt = cells.str.fullmatch("[-+]?nan", case=False).fillna(False).to_numpy(dtype=bool)
        return values, np.isnan(values) & cells.notna().to_numpy() & ~spelt


def _trimmed(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Text of a column without surrounding blanks, null where nothing is left."""
    try:
        text = pc.utf8_trim_whitespace(pc.cast(column, pa.string()))
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # lists and the like
        text = pa.chunked_array([pa.array([str(value) for value in column.to_pylist()], pa.string())])
    return pc.if_else(pc.equal(text, ""), pa.scalar(None, pa.string()), text)


def _is_numeric(kind: pa.DataType) -> bool:
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    return number or pa.types.is_boolean(kind) or pa.types.is_null(kind)


def _close(name: str, names: Sequence[str]) -> bool:
    return "did you mean" in nearest(name, names)
