"""Repeat a simulation, or a calibration from halves of its rows, many times: how large errors are, and what is found how often.

The file is a scenario, as `aridcal simulate` reads it, with a block `study`: `runs` machines are drawn for each of `rows` and
each of `sizes` of an effect, simulated, calibrated, and set beside the truth. Or it is a campaign with a block `study`: each run
calibrates from a random half of the configurations that are fitted, which scatters as much as a bootstrap of all of them.

The work is done by processes of this computer, or by a Dask cluster that sees the same files. What DIR/study.parquet has already
of the same study is not done again.

Exit status: 0 all runs are done, 2 bad use, 3 runs failed or remain.

Example:
    aridcal study scenario.yaml -o study
    aridcal study scenario.yaml -o study --scheduler tcp://10.0.0.1:8786
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from aridcal.command_line import (
    DONE,
    NOT_GOOD,
    CommandParser,
    command,
    command_parser,
    for_clusters,
    for_scripts,
    screens,
)
from aridcal.jobs.fleet.run_record import FAILED
from aridcal.jobs.fleet.study_records import STUDY_TABLE
from aridcal.jobs.fleet.trials import load_study
from aridcal.runs.study_run import STUDY_PAGE, repeated, summary
from aridcal.system.progress import console_progress
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart

if TYPE_CHECKING:
    pass


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("study", __doc__)
    arguments.add_argument("study", type=path_argument, help="scenario.yaml or campaign.yaml, with a block `study`")
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, metavar="DIR", help="folder of table and page"
    )
    for_clusters(arguments)
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> int:
    out: Path = arguments.out
    check_apart([out / STUDY_TABLE, out / STUDY_PAGE], [arguments.study])
    job = load_study(arguments.study)
    console, aside = screens(arguments)
    with console_progress(aside) as progress:
        results = repeated(job, out, arguments.scheduler, progress)
    console.say(*summary(results), f"table: {out / STUDY_TABLE}", f"page: {out / STUDY_PAGE}")
    return NOT_GOOD if results.remaining or any(row["status"] == FAILED for row in results.rows) else DONE


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
