"""Runs of fleets as DuckDB reads them from their Parquet files: the only place for DuckDB.

Every file ``fleet.parquet`` below a folder counts, of one fleet or of many. Each is replaced in one step by whoever writes it
(docs/formats.md, section 8), so that one which is found is whole: no lock is needed, and no index. DuckDB would open it twice, by
its name, and find two files there if it was replaced in between; so each is read at once, and handed over as a table.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet

from aridcal.system.errors import AridcalError, name_list, shortened
from aridcal.system.reading.regular_files import RESULT, read_file
from aridcal.system.reading.user_names import check_path

if TYPE_CHECKING:
    import duckdb

FLEET_FILE = "fleet.parquet"
"""Name of a fleet's table."""

READ_COLUMNS = frozenset(
    {
        "robot",
        "inputs",
        "urdf",
        "time",
        "measured",
        "version",
        "status",
        "error",
        "rows",
        "verdict",
        "stages",
        "constants",
    }
)
"""Those that are read."""

_EMPTY = """
    CREATE TABLE every (
        file INTEGER, place BIGINT, robot VARCHAR, inputs VARCHAR, urdf VARCHAR, time TIMESTAMP, measured TIMESTAMP,
        version VARCHAR, status VARCHAR, error VARCHAR, rows BIGINT, verdict VARCHAR
    );
    CREATE TABLE stage (
        file INTEGER, place BIGINT, stage VARCHAR, channel VARCHAR, rms DOUBLE, p95 DOUBLE, max DOUBLE
    );
    CREATE TABLE constant (
        file INTEGER, place BIGINT, name VARCHAR, value DOUBLE, std DOUBLE, unit VARCHAR
    );
"""
"""Tables of all runs, times in UTC without a zone."""

_FILLED = (
    """
    INSERT INTO every
    SELECT ?, place, robot, inputs, urdf, make_timestamp(epoch_us(time)), make_timestamp(epoch_us(measured)), version, status,
           error, rows, verdict
    FROM fleet
    """,
    """
    INSERT INTO stage
    SELECT ?, place, s.stage, s.channel, s.rms, s.p95, s.max
    FROM (SELECT place, unnest(stages) AS s FROM fleet WHERE status = 'done')
    """,
    """
    INSERT INTO constant
    SELECT ?, place, c.name, c.value, c.std, c.unit
    FROM (SELECT place, unnest(constants) AS c FROM fleet WHERE status = 'done')
    WHERE c.status = 'identified' AND c.std > 0 AND isfinite(c.value) AND isfinite(c.std)
      AND NOT regexp_matches(c.name, '^(world_base|tip_target)[.\\[]')
    """,
)
"""What each file adds, its nested lists as rows: constants of the arm alone, for the frames are set up anew every time."""

_LATEST = """
    CREATE TABLE run AS
    SELECT row_number() OVER (ORDER BY robot, measured, time) AS run, *
    FROM (
        SELECT * FROM every
        QUALIFY row_number() OVER (PARTITION BY robot, inputs ORDER BY status = 'done' DESC, time DESC, file) = 1
    )
"""
"""One row per robot and measurement: of several runs on the same inputs the last that was done."""

_RUNS = "SELECT run, robot, measured, time, version, urdf, status, error, rows, verdict FROM run ORDER BY run"

_ERRORS = """
    SELECT run, stage, channel, rms, p95, max FROM run JOIN stage USING (file, place) ORDER BY run, stage.rowid
"""

_CONSTANTS = """
    SELECT run, name, value, std, unit FROM run JOIN constant USING (file, place) ORDER BY run, constant.rowid
"""


@dataclass(frozen=True)
class Runs:
    """All runs below a folder.

    Attributes:
        files: That were read.
        runs: A row for each robot and measurement: ``run robot measured time version urdf status error rows verdict``.
        errors: ``run stage channel rms p95 max``, in the unit that the channel's name ends in.
        constants: ``run name value std unit`` of what was identified of the arm, [m] and [rad].
    """

    files: tuple[Path, ...]
    runs: pd.DataFrame
    errors: pd.DataFrame
    constants: pd.DataFrame


def read_runs(folder: Path) -> Runs:
    """Read all runs below a folder.

    Raises:
        AridcalError: there are none, one cannot be read, or DuckDB is not installed.
    """
    check_path(folder, AridcalError)
    files = tables_below(folder)
    if not files:
        what = "there is no such folder" if not folder.is_dir() else f"there is no {FLEET_FILE} in it"
        raise AridcalError(f"{folder}: {what}; `aridcal fleet 'robots/*/campaign.yaml' -o {folder}` makes one")
    with _duckdb().connect() as database:
        database.execute(_EMPTY)
        for number, file in enumerate(files):
            database.register("fleet", _table(file))
            for asked in _FILLED:
                database.execute(asked, [number])
            database.unregister("fleet")
        database.execute(_LATEST)
        runs, errors, constants = (_answer(database, asked) for asked in (_RUNS, _ERRORS, _CONSTANTS))
    return Runs(tuple(files), runs, errors, constants)


def tables_below(folder: Path) -> list[Path]:
    """Tables of fleets in a folder and below it, sorted; what is hidden, half written for instance, is none."""
    tables = []
    for here, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if FLEET_FILE in names and (Path(here) / FLEET_FILE).is_file():
            tables.append(Path(here) / FLEET_FILE)
    return tables


def _duckdb() -> Any:
    """DuckDB, an extra that is imported where it is needed."""
    try:
        import duckdb
    except ImportError:
        raise AridcalError('history needs DuckDB: pip install "aridcal[fleet]"') from None
    return duckdb


def _answer(database: duckdb.DuckDBPyConnection, query: str) -> pd.DataFrame:
    """The answer to a query, made from plain rows: versions of DuckDB have different ways to tables."""
    rows = database.execute(query).fetchall()
    return pd.DataFrame(rows, columns=[name for name, *_ in database.description or ()])


def _table(file: Path) -> pa.Table:
    """A fleet's table as one moment had it: read at once, for a file by its name may be another one the next moment."""
    content = read_file(file, AridcalError, RESULT)
    try:
        stored = pyarrow.parquet.ParquetFile(pa.BufferReader(content))
        missing = sorted(READ_COLUMNS - set(stored.schema_arrow.names))
        if missing:
            raise AridcalError(
                f"{file}: is no table of a fleet: it lacks {name_list(missing)}. Run `aridcal fleet` again"
            )
        table = stored.read(sorted(READ_COLUMNS))
    except (pa.ArrowException, OSError) as problem:
        reason = shortened(str(problem), 200)
        raise AridcalError(f"{file}: cannot be read ({reason}). Run `aridcal fleet` again, or delete it") from None
    return table.append_column("place", pa.array(range(len(table)), pa.int64()))
