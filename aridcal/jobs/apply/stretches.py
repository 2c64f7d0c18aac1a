"""A long table a stretch at a time, so that its length costs no memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from aridcal.engine.rows.remarks import Remark
from aridcal.files.tables import AnyTable, Table, is_number, read_tables
from aridcal.system.errors import MeasurementError
from aridcal.system.reading.dialect import PLAIN, Dialect
from aridcal.system.reading.regular_files import MEGA, TABLE_LIMIT, Limit
from aridcal.system.reading.table_files import FIRST_LINE, PANDAS_INDEX, check_header, check_size, read_csv

STRETCH_BYTES = 2_000_000
"""Bytes of csv that are read together: some 18,000 rows of six joints, which take fifty times as much while they are
predicted. A shorter file is one stretch: whatever is asked of a table as a whole is asked of it."""

NUMBER_BYTES = 18
"""Bytes of a number in csv, by which a stretch of parquet has as many rows."""


@dataclass(frozen=True)
class TableStretch:
    """Some rows of a table, and their place in it.

    Attributes:
        table: The rows; their lines are those of the whole file.
        before: Bytes of csv, or rows of another table, before the stretch.
        done: Bytes or rows up to its end.
        total: Bytes or rows of the whole table.
    """

    table: Table
    before: int
    done: int
    total: int

    @property
    def last(self) -> bool:
        """True for the last stretch."""
        return self.done == self.total

    def share(self, rows: int) -> float:
        """How much of the whole table is done after so many of its rows, 0 to 1."""
        return (self.before + (self.done - self.before) * rows / len(self.table)) / self.total


def stretches(
    table: AnyTable, limit: Limit = TABLE_LIMIT, dialect: Dialect = PLAIN, needed: Sequence[str] = ()
) -> Iterator[TableStretch]:
    """Read a table a stretch at a time; a short one, a DataFrame, or one that is no plain csv, as a whole.

    Args:
        table: The table.
        limit: Its largest size.
        dialect: How it is written, if it is not plain csv.
        needed: Columns by which a file is known to be plain csv all the same.

    Raises:
        MeasurementError: as :func:`read_tables`.
    """
    path = Path(table) if isinstance(table, str | Path) else None
    parts: Iterator[TableStretch] = iter(())
    whole_file = dialect != PLAIN and path is not None and path.suffix.lower() != ".parquet"
    if (
        path is not None
        and not whole_file
        and path.is_file()
        and STRETCH_BYTES < path.stat().st_size <= limit.megabytes * MEGA
    ):
        sorts = {".csv": _of_csv, ".parquet": _of_parquet}
        parts = sorts[path.suffix.lower()](path, limit) if path.suffix.lower() in sorts else parts
    names = None
    for stretch in parts:
        names = names or stretch.table.names
        if stretch.table.names != names:  # a column without a name is left out where it is empty
            line = int(stretch.table.line[0])
            raise MeasurementError(f"{path}: from line {line} on, a column has cells and no name: name it in line 1")
        yield stretch
    if names is None:
        whole = read_tables([table], (), limit, dialect, needed)
        yield TableStretch(whole, 0, len(whole), len(whole))


def _of_csv(path: Path, limit: Limit) -> Iterator[TableStretch]:
    """Stretches of whole lines, each read below the header."""
    total, before = path.stat().st_size, 0
    with path.open("rb") as file:
        header = file.readline()
        done = len(header)
        while block := file.read(STRETCH_BYTES):
            block += file.readline()
            first, done = done, done + len(block)
            if not block.isspace():
                yield TableStretch(_table_of_csv(header + block, path, before, limit), first, done, total)
            before += block.count(b"\n") + block.count(b"\r") - block.count(b"\r\n")


def _table_of_csv(content: bytes, path: Path, before: int, limit: Limit) -> Table:
    """Lines of a csv file below its header, after so many others."""
    try:
        file_cells = read_csv(content, path, limit)
    except MeasurementError:
        if (
            before
        ):  # the lines in this message are counted from the stretch's beginning: the whole file tells the right ones
            whole = read_tables([path], limit=limit)
            if whole.refused:
                raise MeasurementError(f"{path}: {whole.refused[0]}; mend the file") from None
        raise
    refused = [Remark(path.name, row.line + before, "", row.text, row.why) for row in file_cells.broken]
    return _table(path, file_cells.cells, file_cells.line + before, refused)


def _of_parquet(path: Path, limit: Limit) -> Iterator[TableStretch]:
    """Stretches of rows; none of a file that is no parquet, or has words, which may be far larger in memory than in the file."""
    try:
        file = pa.parquet.ParquetFile(path)
    except (pa.ArrowException, OSError):
        return
    with file:
        total, done = file.metadata.num_rows, 0
        names = [name for name in file.schema_arrow.names if not PANDAS_INDEX.fullmatch(name)]
        if not all(is_number(file.schema_arrow.field(name).type) for name in names):
            return
        check_header(names, path)
        check_size(path, total, len(names), limit)
        for batch in file.iter_batches(max(STRETCH_BYTES // (NUMBER_BYTES * max(len(names), 1)), 1), columns=names):
            first, done = done, done + len(batch)
            if len(batch):
                line = np.arange(first, done) + FIRST_LINE
                yield TableStretch(_table(path, pa.Table.from_batches([batch]), line, ()), first, done, total)


def _table(path: Path, cells: pa.Table, line: np.ndarray, refused: Sequence[Remark]) -> Table:
    """Some rows of one file."""
    return Table(
        files=(path,),
        names=tuple(cells.column_names),
        cells={name: (cells[name],) for name in cells.column_names},
        file=np.zeros(len(line), dtype=int),
        line=line,
        refused=tuple(refused),
        sha256="",
    )
