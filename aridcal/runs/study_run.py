"""A simulation, or a calibration from halves of its rows, repeated many times."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aridcal.files.campaign import Campaign
from aridcal.jobs.fleet.cluster import dask_engine
from aridcal.jobs.fleet.local_engine import run_tasks
from aridcal.jobs.fleet.run_record import FAILED
from aridcal.jobs.fleet.study_records import STUDY_TABLE, StudyResult, earlier_runs, studied
from aridcal.jobs.fleet.trials import search_in_words, trials
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.pages.study_page import study_page
from aridcal.system.errors import shortened
from aridcal.system.progress import PrintedAnswer, Progress
from aridcal.system.wording import plural
from aridcal.system.writing.whole_files import atomic_file, claimed

if TYPE_CHECKING:
    import pandas as pd


STUDY_PAGE = "study.html"


@dataclass(frozen=True, repr=False, eq=False)
class StudyRun(PrintedAnswer):
    """What a study found, for Python.

    Attributes:
        folder: Of ``study.parquet`` and ``study.html``.
        cases: A row for each case: shares of runs and median errors, each with its interval (``found_low``, ``found_high``).
        runs: Every run.
        effects: Of a campaign: those that runs found, and in what share of them. Of a scenario none; see ``cases``.
        constants: Of a campaign: how far each scatters over the runs, and what these state, [m] and [rad]. Of a scenario
            none, for each run has a machine of its own.
        remaining: Runs that were not done, for the engine went away.
        lines: The whole answer in words.
    """

    folder: Path
    cases: pd.DataFrame
    runs: pd.DataFrame
    effects: pd.DataFrame
    constants: pd.DataFrame
    remaining: int
    lines: tuple[str, ...]


def study_run(results: StudyResult, out: Path) -> StudyRun:
    """What a study found, for Python."""
    from aridcal.pages.fleet_tables import case_table, recurrent_table, run_table, scatter_table

    halves = [row for row in results.rows if row["rows"] is None]
    return StudyRun(
        folder=out,
        cases=case_table(results),
        runs=run_table(results),
        effects=recurrent_table(halves),
        constants=scatter_table(halves),
        remaining=results.remaining,
        lines=tuple(summary(results)),
    )


def repeated(job: Scenario | Campaign, out: Path, scheduler: str | None, progress: Progress) -> StudyResult:
    """Do the runs of a study that are not there yet, and write table and page.

    Args:
        job: As it was read.
        out: The study's folder.
        scheduler: Address of a Dask cluster; None: processes of this computer.
        progress: Told how far it is.

    Raises:
        AridcalError: the folder cannot be used, or the engine not be had.
    """
    with claimed(out, "folder", (STUDY_TABLE, STUDY_PAGE)):
        out.mkdir(exist_ok=True)
        all_trials = trials(job)
        known_rows = earlier_runs(out, all_trials)
        needed = len(known_rows) < len(all_trials)
        with dask_engine(scheduler, progress) if needed else nullcontext(run_tasks) as engine:
            results = studied(all_trials, known_rows, out, engine, progress)
        progress("drawing the page")
        title = job.path.absolute().parent.name + "/" + job.path.name
        with atomic_file(out / STUDY_PAGE) as path:
            page = study_page(results, title, search_in_words(job), isinstance(job, Campaign))
            path.write_bytes(page.encode("utf-8", "replace"))
    return results


def summary(results: StudyResult) -> list[str]:
    """What became of the study, in lines."""
    failed = [row for row in results.rows if row["status"] == FAILED]
    known_part = f", {results.kept:,} of them known already" if results.kept else ""
    lines = [
        f"{len(results.rows) - len(failed):,} of {plural(len(results.rows) + results.remaining, 'run')} done{known_part}"
    ]
    if failed:
        lines.append(f"{plural(len(failed), 'run')} failed, the first for: {shortened(str(failed[0]['error']), 400)}")
    if results.remaining:
        lines.append(
            f"{plural(results.remaining, 'run')} remain, for {results.gone}; start the same command again: what is done stays"
        )
    return lines
