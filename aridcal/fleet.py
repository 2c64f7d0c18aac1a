"""Calibrate many robots: each campaign a result folder below DIR, with a table and a page on all of them.

A robot is called as the folder of its campaign. The work is done by processes of this computer, one for each core, or by a Dask
cluster: `dask scheduler` and `dask worker ADDRESS --nthreads 1` started wherever the same files are to be seen under the same
paths. What DIR holds already, from the same files and this version, is not computed again: a fleet that was stopped goes on
where it was, and one of which a few robots were measured anew computes these.

A robot that fails is named with its reason and costs no other. DIR/fleet.parquet keeps earlier runs, too.

Exit status: 0 all robots are done, 2 bad use, 3 robots failed or remain.

Example:
    aridcal fleet 'robots/*/campaign.yaml' -o fleet
    aridcal fleet 'robots/*/campaign.yaml' -o fleet --scheduler tcp://10.0.0.1:8786
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
from aridcal.jobs.fleet.members import RESERVED_NAMES_OF_FLEET, members
from aridcal.jobs.fleet.run_table import FLEET_TABLE
from aridcal.runs.fleet_run import FLEET_PAGE, calibrated_fleet, summary
from aridcal.system.progress import console_progress
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart

if TYPE_CHECKING:
    pass


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("fleet", __doc__)
    arguments.add_argument(
        "campaigns",
        nargs="+",
        metavar="CAMPAIGN",
        help="campaigns, or patterns of them in quotes: 'robots/*/campaign.yaml'",
    )
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, metavar="DIR", help="folder of all results"
    )
    for_clusters(arguments)
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> int:
    out: Path = arguments.out
    fleet = members(arguments.campaigns, out)
    check_apart((out / name for name in RESERVED_NAMES_OF_FLEET), (member.campaign for member in fleet))
    console, aside = screens(arguments)
    with console_progress(aside) as progress:
        ran = calibrated_fleet(fleet, out, arguments.scheduler, progress)
    console.say(*summary(ran), f"table: {out / FLEET_TABLE}", f"page: {out / FLEET_PAGE}")
    return NOT_GOOD if ran.failed or ran.remaining else DONE


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
