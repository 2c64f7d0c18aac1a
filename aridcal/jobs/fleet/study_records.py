"""A study run and kept: what was done before counts, and what is done is not lost."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet

from aridcal.jobs.fleet.local_engine import Engine, EngineGone, WorkFailure
from aridcal.jobs.fleet.run_record import DONE, FAILED, Row
from aridcal.jobs.fleet.runs import SAVE_EVERY
from aridcal.jobs.fleet.trials import Trial, run_trial
from aridcal.system.errors import OutputError
from aridcal.system.progress import Progress
from aridcal.system.writing.whole_files import atomic_file

STUDY_TABLE = "study.parquet"

_CONSTANT = pa.struct([("name", pa.string()), ("value", pa.float64()), ("std", pa.float64()), ("unit", pa.string())])

STUDY_SCHEMA = pa.schema(
    [("key", pa.string()), ("rows", pa.int64()), ("size", pa.float64()), ("run", pa.int64()), ("seed", pa.int64())]
    + [("status", pa.string()), ("error", pa.string()), ("channel", pa.string())]
    + [(name, pa.float64()) for name in ("nominal", "geometric", "final", "true_rms_mm")]
    + [("named", pa.bool_()), ("found", pa.bool_()), ("others", pa.int64()), ("verdict", pa.string())]
    + [("seconds", pa.float64()), ("effects", pa.list_(pa.string())), ("constants", pa.list_(_CONSTANT))]
)


@dataclass(frozen=True)
class StudyResult:
    """What became of a study.

    Attributes:
        rows: Of all its runs that were answered, in the order of the trials.
        kept: How many were known already.
        remaining: How many were not done.
        gone: Why not; empty if all were.
    """

    rows: tuple[Row, ...]
    kept: int
    remaining: int
    gone: str


def earlier_runs(folder: Path, trials: Mapping[str, Trial]) -> dict[str, Row]:
    """Runs of a study that an earlier table has, by their keys.

    Raises:
        OutputError: what stands in the table's place is none.
    """
    path = folder / STUDY_TABLE
    if not path.exists():
        return {}
    try:
        rows = pa.parquet.read_table(path).select(STUDY_SCHEMA.names).cast(STUDY_SCHEMA).to_pylist()
    except (OSError, ValueError, KeyError, pa.ArrowException) as problem:
        why = str(problem).splitlines()[0]
        raise OutputError(f"{path}: is no table of a study ({why}); move it away, or choose another folder") from None
    return {row["key"]: row for row in rows if row["key"] in trials and row["status"] == DONE}


def write_runs(rows: Mapping[str, Row], trials: Mapping[str, Trial], folder: Path) -> tuple[Row, ...]:
    """Write the table in one step; returns its rows, in the order of the trials."""
    ordered = tuple(rows[key] for key in trials if key in rows)
    table = pa.Table.from_pylist([dict.fromkeys(STUDY_SCHEMA.names) | row for row in ordered], STUDY_SCHEMA)
    with atomic_file(folder / STUDY_TABLE) as path:
        pa.parquet.write_table(table, path, compression="snappy")
    return ordered


def studied(
    trials: Mapping[str, Trial], earlier: Mapping[str, Row], folder: Path, engine: Engine, progress: Progress
) -> StudyResult:
    """Do every run that is not known; the table is written every minute and at the end, also if the work is stopped.

    Args:
        trials: All runs.
        earlier: Those that need not be done.
        folder: Of the table, claimed by the caller.
        engine: Does the work.
        progress: Told how far it is.
    """
    rows = dict(earlier)
    waiting = {f"aridcal-{key}-{folder.absolute()}": trial for key, trial in trials.items() if key not in earlier}
    progress(f"{len(waiting):,} runs")
    saved = time.monotonic()
    gone, done = "", 0
    try:
        for name, answer in engine(run_trial, waiting):
            trial = waiting[name]
            if isinstance(answer, WorkFailure):
                case = {"rows": trial.case.rows or None, "size": trial.case.size, "run": trial.run, "seed": trial.seed}
                answer = {"key": trial.key, **case, "status": FAILED, "error": answer.why}
            rows[trial.key] = answer
            done += 1
            progress.part(done, len(waiting), "runs")
            if time.monotonic() - saved > SAVE_EVERY:
                write_runs(rows, trials, folder)
                saved = time.monotonic()
    except EngineGone as problem:
        gone = str(problem)
    finally:
        ordered = write_runs(rows, trials, folder)
    return StudyResult(ordered, len(earlier), len(trials) - len(rows), gone)
