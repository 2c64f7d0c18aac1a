"""Simulate a campaign with a known truth: from a scenario to measurements of an imperfect robot, and its true parameters.

docs/simulate.md lists what `truth.effects` of a scenario may hold.

Example:
    aridcal simulate identification/arid/scenario.yaml -o /tmp/arid
"""

from __future__ import annotations

import argparse
import sys

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.system.progress import console_progress
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.whole_files import atomic_folder, claimed


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("simulate", __doc__)
    arguments.add_argument("scenario", type=path_argument, help="scenario.yaml: the keys of a campaign, and `truth`")
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, metavar="DIR", help="folder of the campaign"
    )
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    path, out = arguments.scenario, arguments.out
    console, aside = screens(arguments)
    check_apart([out / "campaign.yaml"], [path])
    scenario = load_settings(path, Scenario)
    with claimed(out, "folder"), console_progress(aside) as progress:
        simulation = simulate(scenario, progress)
        with atomic_folder(out) as folder:
            write_campaign(simulation, folder, out, progress)
            known, head = scenario.instruments, scenario.measurements.head
            inputs = [path, scenario.robot.urdf, *known.tables, head]
            written = [out / file.relative_to(folder) for file in folder.rglob("*")]
            check_apart(written, inputs)
    rows, wrong = len(simulation.outliers), int(simulation.outliers.sum())
    console.print(
        f"{out}: {rows} rows, {wrong} of them outliers; the truth is in truth.json", soft_wrap=True, markup=False
    )
    console.print(f"next: aridcal identify {out / 'campaign.yaml'}", soft_wrap=True, markup=False)


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
