"""Simulate a campaign with a known truth: from a scenario to measurements of an imperfect robot, and its true parameters.

docs/simulate.md lists what `truth.effects` of a scenario may hold. With --live the campaign has no table yet: arm and tracker
measure the poses that `aridcal guide --json` asks for on standard input, and append a row for each:
`aridcal guide DIR/campaign.yaml --json | aridcal simulate scenario.yaml -o DIR --live`.

Example:
    aridcal simulate identification/arid/scenario.yaml -o /tmp/arid
    aridcal simulate identification/arid/scenario.yaml -o /tmp/cell --live
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.simulate.live import asked, live_arm
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.system.progress import Screen, console_progress
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.append import append
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.whole_files import atomic_folder, claimed

TABLE = "measurements.csv"
"""Of a simulated campaign of one block."""


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("simulate", __doc__)
    arguments.add_argument("scenario", type=path_argument, help="scenario.yaml: the keys of a campaign, and `truth`")
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, metavar="DIR", help="folder of the campaign"
    )
    arguments.add_argument(
        "--live",
        action="store_true",
        help="measure pose by pose what `aridcal guide --json` on standard input asks for",
    )
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    path, out = arguments.scenario, arguments.out
    console, aside = screens(arguments)
    check_apart([out / "campaign.yaml"], [path])
    scenario = load_settings(path, Scenario)
    if arguments.live:
        _live(scenario, out, console)
        return
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


def _live(scenario: Scenario, out: Path, console: Screen) -> None:
    """Write a campaign without a table, unless it is there; then measure what is asked for."""
    arm = live_arm(scenario)
    if not (out / "campaign.yaml").exists():
        with claimed(out, "folder"), atomic_folder(out) as folder:
            write_campaign(arm.simulation, folder, out)
            (folder / TABLE).unlink()
    if sys.stdin.isatty():
        again = f"aridcal simulate {scenario.path} -o {out} --live"
        console.say(f"{out}: nothing was measured yet", f"next: aridcal guide {out / 'campaign.yaml'} --json | {again}")
        return
    for line in sys.stdin:
        rows = asked(arm, line)
        if rows is not None:
            table = out / TABLE
            append(table, rows.to_csv(index=False, header=not table.exists(), lineterminator="\n"))
            console.say(f"{table}: row {len(arm.poses)}")


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
