"""``fleet.parquet``: every run of every robot."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet

from aridcal.jobs.fleet.run_record import DONE, RUN_SCHEMA, Row, plain, typed
from aridcal.system.errors import OutputError
from aridcal.system.writing.whole_files import atomic_file

FLEET_TABLE = "fleet.parquet"


def read_rows(folder: Path) -> list[Row]:
    """Rows of a fleet's table, the oldest run first; none if there is no table yet.

    Args:
        folder: The fleet's.

    Raises:
        OutputError: what is there is no such table, and would be lost if it were written anew.
    """
    path = folder / FLEET_TABLE
    if not path.exists():
        return []
    try:
        table = pa.parquet.read_table(path)
        if set(RUN_SCHEMA.names) - set(table.column_names):
            raise ValueError("it lacks columns")
        return [plain(row) for row in table.select(RUN_SCHEMA.names).cast(RUN_SCHEMA).to_pylist()]
    except (OSError, ValueError, pa.ArrowException) as problem:
        raise OutputError(
            f"{path}: is no table of this fleet ({str(problem).splitlines()[0]}); move it away, or choose another folder"
        ) from None


def merged(rows: Iterable[Row], new: Iterable[Row]) -> list[Row]:
    """Rows with others added: one of the same robot and key takes the place of the one that was there.

    A failure takes no other place than a failure's: what was computed once stays so.
    """
    found = {(row["robot"], row["key"]): row for row in rows}
    for row in new:
        place = row["robot"], row["key"]
        if row["status"] == DONE or found.get(place, row)["status"] != DONE:
            found[place] = row
    return sorted(found.values(), key=lambda row: (typed(row)["time"], row["robot"]))


def write_rows(rows: Iterable[Row], folder: Path) -> None:
    """Write a fleet's table in one step."""
    table = pa.Table.from_pylist([typed(row) for row in rows], RUN_SCHEMA)
    with atomic_file(folder / FLEET_TABLE) as path:
        pa.parquet.write_table(table, path, compression="snappy")


def latest(rows: Iterable[Row]) -> dict[str, Row]:
    """The last run of each robot."""
    return {row["robot"]: row for row in rows}
