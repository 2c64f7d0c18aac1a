"""Tables of a user: csv, parquet and DataFrames read whole, every cell traceable to its file, line and column."""

from __future__ import annotations

import codecs
import csv
import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, Union

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from aridcal.engine.rows.remarks import Remark
from aridcal.files.formats import robot_calibration
from aridcal.system.errors import SHOWN_LENGTH, MeasurementError, name_list, nearest
from aridcal.system.reading import workbooks
from aridcal.system.reading.dialect import PLAIN, Dialect
from aridcal.system.reading.numerals import NO_NUMBER
from aridcal.system.reading.regular_files import TABLE_LIMIT, Limit, read_file
from aridcal.system.reading.table_files import FileCells, check_header, read_csv, read_parquet, whole
from aridcal.system.reading.tables_in_dialect import read_in_dialect
from aridcal.system.reading.user_names import check_path

if TYPE_CHECKING:
    import pandas as pd

# What a user may give as a table: the path of a csv or parquet file, or the rows themselves. A name in quotes has no `|`.
AnyTable: TypeAlias = Union[str, Path, "pd.DataFrame"]

# Stands in messages where a table has no file. Its row k is called line k + 2, as if it were saved as csv.
IN_MEMORY = Path("DataFrame")

# A number with a comma in place of the point.
DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*")

# A number as programs write it.
PLAIN_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)

TABLE_ENDINGS = (".csv", ".parquet")

# Endings of files that are read as a campaign says (`table`), or as plain csv or a workbook of one sheet.
OTHER_ENDINGS = (".txt", ".tsv", ".tab", ".dat", ".asc", ".log", ".prn", *workbooks.WORKBOOK_ENDINGS)

# Characters of a cell as text: no path of a file has more than 4,096, and every cell of a column takes as much as its longest.
LONGEST_TEXT = 5_000

# Columns that are not there which a message names.
SHOWN_MISSING = 12


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
        partial: Columns that were left out because a file lacks them or holds lists in them, each with the first such file.
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
        values, is_text = zip(*map(_numbers, self.cells[name]), strict=True)
        return np.concatenate(values), np.concatenate(is_text)

    def written_otherwise(self, name: str, is_text: np.ndarray) -> str:
        """Why most cells of a column hold no numbers though they look like some, with the remedy; empty if they do not.

        Args:
            name: The column.
            is_text: Which cells hold text, shape (N,) bool.
        """
        words = self.texts(name)[is_text].tolist()
        if sum(1 for word in words if DECIMAL_COMMA.fullmatch(word)) > len(is_text) / 2:
            return "has decimal commas; write points, or let `aridcal init` find out how the table is written"
        marked = [word[1:] for word in words if word.startswith(NO_NUMBER)]
        if len(marked) > len(is_text) / 2:
            return f"has numbers that `table` does not describe, {marked[0]!r}; mend it, or let `aridcal init` find out how"
        return ""

    def matrix(self, names: Iterable[str]) -> np.ndarray:
        """Read several columns as numbers, shape (N, columns), NaN where there is none."""
        return np.column_stack([self.numbers(name)[0] for name in names])

    def texts(self, name: str) -> np.ndarray:
        """Read a column as text, shape (N,), surrounding blanks removed, empty cells as ``""``, long ones cut."""
        # As a list: Arrow's own arrays and fillings load pandas, which takes a while.
        by_file = [
            pc.utf8_slice_codeunits(_trimmed(column), 0, LONGEST_TEXT).to_pylist() for column in self.cells[name]
        ]
        return np.array([word or "" for words in by_file for word in words], dtype=str)

    def cell(self, row: int, name: str) -> str:
        """One cell as text; `row` counts the table's rows from 0."""
        if name not in self.cells:
            return ""
        file = self.file[row]
        first_of_file = np.searchsorted(self.file, file)
        value = self.cells[name][file][int(row - first_of_file)].as_py()
        return "" if value is None else str(value)[:SHOWN_LENGTH]

    def remark(self, row: int, column: str, why: str, value: str | None = None) -> Remark:
        """Name a cell of a row (counted from 0) and what is wrong with it."""
        value = self.cell(row, column) if value is None else value
        return Remark(self.files[self.file[row]].name, int(self.line[row]), column, value, why)

    def frame(self) -> pd.DataFrame:
        """All cells, as they were written in csv."""
        import pandas as pd  # slow to load: only where somebody wants a DataFrame

        by_name = {name: [column.to_pandas() for column in self.cells[name]] for name in self.names}
        return pd.DataFrame({name: np.concatenate(by_file) for name, by_file in by_name.items()})

    def require(self, columns: Sequence[str], advice: str = "") -> None:
        """Check that columns are there.

        Raises:
            MeasurementError: naming those that are not, and what they may be called instead.
        """
        missing = [name for name in columns if name not in self.cells]
        if not missing:
            return
        spare = [name for name in self.names if name and name not in columns]
        names_and_hints = ", ".join(repr(name) + _close(name, spare) for name in missing[:SHOWN_MISSING])
        names_and_hints += f" and {len(missing) - SHOWN_MISSING} more" if len(missing) > SHOWN_MISSING else ""
        present = name_list([name or "''" for name in self.names])
        raise MeasurementError(f"{self.title}: no column {names_and_hints}; there are: {present}. {advice}".rstrip())


def path_of(table: AnyTable) -> Path:
    """The file of a table; what messages call one that has none."""
    return Path(table) if isinstance(table, str | Path) else IN_MEMORY


def read_tables(
    tables: Sequence[AnyTable],
    spare: Collection[str] | None = (),
    limit: Limit = TABLE_LIMIT,
    dialect: Dialect = PLAIN,
    needed: Collection[str] | None = None,
) -> Table:
    """Read files of text, workbooks, parquet files and DataFrames as one table.

    Args:
        tables: In the order of their rows.
        spare: Columns that are left out if some files lack them, or hold lists in them; None: any.
        limit: Size of each file, and of its cells in memory.
        dialect: How files of text are written; by default UTF-8, commas, decimal points, one header line.
        needed: Columns of a file that is plain csv in spite of `dialect`: what commands write is; dates and lists that the
            dialect names need not be in such files. None: no file is plain, and all must be there.

    Raises:
        MeasurementError: a file is missing, empty, too large, of another kind or in another dialect, has a column twice, or
            the files do not have the same columns.
    """
    sha256 = hashlib.sha256()
    paths = tuple(map(path_of, tables))
    parts = [_read(table, spare, limit, sha256.update, dialect, needed) for table in tables]
    files = list(zip(paths, parts, strict=True))
    having = {name: path for path, part in reversed(files) for name in part.cells.column_names}
    lacking: dict[str, Path] = {}
    for path, part in reversed(files):
        lacking |= dict.fromkeys((having.keys() | set(part.left_out)) - set(part.cells.column_names), path)
    for name in sorted(lacking if spare is not None else ()):
        if name not in (spare or ()):
            raise MeasurementError(
                f"{lacking[name]}: no column {name!r}, which {having[name]} has; files that are read together need the same "
                f"columns. Add it, or leave it out: `ignore: [{name}]` under measurements"
            )
    names = [name for name in parts[0].cells.column_names if name not in lacking]
    counts = [part.cells.num_rows for part in parts]
    return Table(
        files=paths,
        names=tuple(names),
        cells={name: tuple(part.cells[name] for part in parts) for name in names},
        file=np.repeat(np.arange(len(parts)), counts),
        line=np.concatenate([part.line for part in parts]),
        refused=tuple(
            Remark(path.name, row.line, "", row.text, row.why) for path, part in files for row in part.broken
        ),
        sha256=sha256.hexdigest(),
        partial=lacking,
    )


def _read(
    table: AnyTable,
    spare: Collection[str] | None,
    limit: Limit,
    update: Callable[[bytes], None],
    dialect: Dialect,
    needed: Collection[str] | None,
) -> FileCells:
    """Read one table; its bytes are handed to ``update`` and not kept."""
    if not isinstance(table, str | Path):
        cells = _from_frame(table)
        update(table.to_csv(index=False).encode())
        return cells
    path = Path(table)
    check_path(path, MeasurementError)
    check_ending(path, dialect)
    content = read_file(path, MeasurementError, limit)
    update(content)
    if path.suffix.lower() == ".parquet":
        return read_parquet(content, path, limit, spare)
    return _read_text(content, path, limit, dialect, needed)


def check_ending(path: Path, dialect: Dialect = PLAIN) -> None:
    """Refuse a file whose ending is not that of a table.

    Raises:
        MeasurementError: naming the file.
    """
    endings = (*TABLE_ENDINGS, *OTHER_ENDINGS, *(robot_calibration.CALIBRATION_ENDINGS if dialect.export else ()))
    if path.is_file() and path.suffix.lower() not in endings:
        raise MeasurementError(
            f"{path}: should be a .csv or .parquet file, text ({' '.join(OTHER_ENDINGS[:3])} …) or .xlsx; save it as one of these"
        )


def _read_text(content: bytes, path: Path, limit: Limit, dialect: Dialect, needed: Collection[str] | None) -> FileCells:
    """Read a file of text or a workbook; as plain csv in spite of the dialect only where the dialect fails."""
    if dialect == PLAIN and path.suffix.lower() not in workbooks.WORKBOOK_ENDINGS:
        return read_csv(content, path, limit)
    may_be_plain = needed is not None and path.suffix.lower() == ".csv" and _is_plain(content, needed)
    if may_be_plain and _is_utf8_instead(content, dialect.encoding):
        return read_csv(content, path, limit)
    try:
        if dialect.export:
            return read_csv(robot_calibration.as_csv(content, path, dialect.sheet), path, limit)
        cells = read_in_dialect(content, path, limit, dialect, needed is not None)
    except MeasurementError:
        if may_be_plain:
            return read_csv(content, path, limit)
        raise
    if not may_be_plain:
        return cells
    lacks = not set(needed or ()) <= set(cells.cells.column_names)
    points = dialect.decimal != "." and b"." in content.split(b"\n", 2)[1]
    return read_csv(content, path, limit) if lacks or points else cells


def _is_plain(content: bytes, needed: Collection[str]) -> bool:
    """True of csv whose first line names all columns that are needed, and whose second line has numbers in them."""
    lines = content.removeprefix(b"\xef\xbb\xbf").split(b"\n", 2)[:2]
    try:
        names, cells = (next(csv.reader([line.decode().strip("\r")]), []) for line in lines)
    except (ValueError, csv.Error):  # not UTF-8, or one line only
        return False
    places = [k for k, name in enumerate(names) if name.strip() in needed]
    complete = {names[k].strip() for k in places} == set(needed)
    return complete and all(
        k < len(cells) and (not cells[k] or PLAIN_NUMBER.fullmatch(cells[k].strip())) for k in places
    )


def _is_utf8_instead(content: bytes, encoding: str) -> bool:
    """True of letters beyond ASCII that are UTF-8, which text in the stated encoding hardly ever is by chance."""
    if content.isascii() or codecs.lookup(encoding).name == "utf-8":
        return False
    try:
        content.decode()
    except UnicodeDecodeError:
        return False
    return True


def _from_frame(frame: pd.DataFrame) -> FileCells:
    """Take the columns of a DataFrame; its index is no column."""
    names = [str(name) for name in frame.columns]
    check_header(names, IN_MEMORY)
    if frame.empty:
        raise MeasurementError(f"{IN_MEMORY}: has columns but no rows; give the measured ones")
    columns = [_arrow(frame.iloc[:, k]) for k in range(len(names))]
    return whole(pa.table(columns, names=names))


def _arrow(column: pd.Series) -> pa.ChunkedArray:
    """A column with its type, or as text where its cells are of several types."""
    try:
        cells = pa.array(column, from_pandas=True)
    except (pa.ArrowInvalid, pa.ArrowTypeError, pa.ArrowNotImplementedError):
        texts = [None if empty else str(cell) for cell, empty in zip(column, column.isna(), strict=True)]
        cells = pa.array(texts, pa.string())
    return cells if isinstance(cells, pa.ChunkedArray) else pa.chunked_array([cells])


def _numbers(column: pa.ChunkedArray) -> tuple[np.ndarray, np.ndarray]:
    """Values of a column, NaN where there is no number, and which cells hold text instead; shape (n,) each."""
    if is_number(column.type):
        return _floats(pc.cast(column, pa.float64(), safe=False)), np.zeros(len(column), dtype=bool)
    text = _trimmed(column)
    try:
        return _floats(pc.cast(text, pa.float64())), np.zeros(len(column), dtype=bool)
    except pa.ArrowInvalid:
        cells = text.to_pandas()
    import pandas as pd  # slow to load: only where a column has words beside numbers

    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)
    spelt_nan = cells.str.fullmatch("[-+]?nan", case=False).fillna(False).to_numpy(dtype=bool)
    filled = cells.notna().to_numpy()
    return values, np.isnan(values) & filled & ~spelt_nan


def _floats(column: pa.ChunkedArray) -> np.ndarray:
    """Numbers of a column, NaN in its holes: from Arrow's own bytes, for its conversions all load pandas, which takes a while."""
    parts = [np.empty(0)]
    for chunk in column.chunks:
        of_chunk = slice(chunk.offset, chunk.offset + len(chunk))
        holes = chunk.is_null().cast(pa.uint8())
        if len(chunk):
            empty = np.frombuffer(holes.buffers()[1], dtype=np.uint8)[holes.offset : holes.offset + len(chunk)]
            parts.append(np.where(empty, np.nan, np.frombuffer(chunk.buffers()[1], dtype=float)[of_chunk]))
    return np.concatenate(parts)


def _trimmed(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Text of a column without surrounding blanks, null where nothing is left."""
    try:
        text = pc.utf8_trim_whitespace(pc.cast(column, pa.string()))
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # lists and the like
        texts = [str(value) for value in column.to_pylist()]
        text = pa.chunked_array([pa.array(texts, pa.string())])
    filled = pc.cast(pc.binary_length(text), pa.bool_())
    return pc.if_else(filled, text, pa.nulls(1, pa.string())[0])


def is_number(kind: pa.DataType) -> bool:
    """True for columns of numbers, which need no reading as text."""
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    return number or pa.types.is_boolean(kind) or pa.types.is_null(kind)


def _close(name: str, names: Sequence[str]) -> str:
    """A hint at the name that was meant; empty where none is close."""
    hint = nearest(name, names)
    return hint if "did you mean" in hint else ""
