"""Runs of fleets as DuckDB reads them from their Parquet files: the only place for DuckDB.

Every file ``fleet.parquet`` below a folder counts, of one fleet or of many. Each is replaced in one step by whoever writes it
(docs/formats.md, section 8), so that one which is found is whole: no lock is needed, and no index.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from aridcal.errors import AridcalError, listed, shortened
from aridcal.reading.names import check_path

if TYPE_CHECKING:
    import duckdb

FILE = "fleet.parquet"
"""Name of a fleet's table."""

COLUMNS = frozenset(
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

_LATEST = """
    CREATE TEMP TABLE run AS
    SELECT row_number() OVER (ORDER BY robot, measured, time) AS run, *
    FROM (
        SELECT robot, inputs, urdf, time, measured, version, status, error, rows, verdict, stages, constants
        FROM read_parquet(?, union_by_name = true)
        QUALIFY row_number() OVER (PARTITION BY robot, inputs ORDER BY status = 'done' DESC, time DESC) = 1
    )
"""
"""One row per robot and measurement: of several runs on the same inputs the last that was done."""

_RUNS = "SELECT run, robot, measured, time, version, urdf, status, error, rows, verdict FROM run ORDER BY run"

_ERRORS = """
    SELECT run, s.stage AS stage, s.channel AS channel, s.rms AS rms, s.p95 AS p95, s.max AS max
    FROM (SELECT run, unnest(stages) AS s FROM run WHERE status = 'done') ORDER BY run
"""

_CONSTANTS = """
    SELECT run, c.name AS name, c.value AS value, c.std AS std, c.unit AS unit
    FROM (SELECT run, unnest(constants) AS c FROM run WHERE status = 'done')
    WHERE c.status = 'identified' AND c.std > 0 AND isfinite(c.value) AND isfinite(c.std)
      AND NOT regexp_matches(c.name, '^(world_base|tip_target)[.\\[]')
    ORDER BY run
"""
"""Constants of the arm: the frames are set up anew for every measurement."""


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
        what = "there is no such folder" if not folder.is_dir() else f"there is no {FILE} in it"
        raise AridcalError(f"{folder}: {what}; `aridcal fleet 'robots/*/campaign.yaml' -o {folder}` makes one")
    connect = _duckdb()
    with connect() as database:
        for file in files:
            _check(database, file)
        try:
            database.execute(_LATEST, [[_plain(file) for file in files]])
            runs, errors, constants = (database.execute(asked).df() for asked in (_RUNS, _ERRORS, _CONSTANTS))
        except Exception as problem:
            raise _unreadable(", ".join(map(str, files)), problem) from None
    return Runs(tuple(files), runs, errors, constants)


def tables_below(folder: Path) -> list[Path]:
    """Tables of fleets in a folder and below it, sorted; what is hidden, half written for instance, is none."""
    found = []
    for here, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if FILE in names and (Path(here) / FILE).is_file():
            found.append(Path(here) / FILE)
    return found


def _duckdb() -> Any:
    """DuckDB's own way to a database in memory."""
    try:
        import duckdb
    except ImportError:
        raise AridcalError('history needs DuckDB: pip install "aridcal[fleet]"') from None
    return duckdb.connect


def _check(database: duckdb.DuckDBPyConnection, file: Path) -> None:
    """Make sure that a file is a fleet's table."""
    try:
        described = database.execute("DESCRIBE SELECT * FROM read_parquet(?)", [_plain(file)]).fetchall()
    except Exception as problem:
        raise _unreadable(str(file), problem) from None
    missing = sorted(COLUMNS - {name for name, *_ in described})
    if missing:
        raise AridcalError(f"{file}: is no table of a fleet: it lacks {listed(missing)}. Run `aridcal fleet` again")


def _unreadable(what: str, problem: Exception) -> AridcalError:
    """What to say of a table that DuckDB gives up on: its errors have no other class in common than Exception."""
    return AridcalError(
        f"{what}: cannot be read ({shortened(str(problem), 200)}). Run `aridcal fleet` again, or delete it"
    )


def _plain(file: Path) -> str:
    """A path in which DuckDB sees no pattern."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in str(file))
