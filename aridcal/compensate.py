"""Find joint commands that bring the real target to wanted poses, with the whole calibrated model.

The poses are the columns `x y z qx qy qz qw` of the target in the world (`x y z` if only positions were measured). Each
covariate that an effect depends on needs a column, too. Names, units and orientation are those of the campaign's tables.
If the joints have columns, the search starts there, for example at the controller's own solution; a row without them
starts from the solution of the row before, and goes to another branch if that leaves the calibrated range. A
JOINT_direction that an effect needs and the table lacks follows from the row before.

All columns and rows are kept in their order, and the joints' columns are filled in. `reached` is true if the target gets
to the pose within the measurement noise of the calibration. With fewer than six joints it is true if the target gets as
near as the robot can, weighted by the noise, and within 20 mm and 20 mrad. `position_error` and `rotation_error` are the
errors that remain. `extrapolates` is true if the command is outside the calibrated range, in a hole of what was measured, or
where the model is three times as uncertain as at any calibrated row. Joint limits are kept.

The joints are of the same kind as in the calibration: commands, if commands were recorded. If reported joints were
recorded (`joint_reading: reported` in the campaign), they are what the controller must report when the target is there.

`--of LINK` takes poses of another link of the URDF, in the world: the joints on the way to it move, all others stay where the
table has them. So it is of several targets, each in its row. A joint that stays and has no column stands in the middle of what
was seen, for effects that depend on it. `--in LINK` says that the poses are in the frame of another link, of the other hand for
instance, whose own joints stay.

With --grid the output is a correction table, for controllers that accept no model: for each point of a grid over the
joints, the correction to be added to the nominal solution.

A program in place of the poses (URScript .script; KRL .src, .dat; RAPID .mod; FANUC .ls; INFORM .jbi; G-code .nc of a gantry)
is written again with other numbers for its targets, so that the real arm comes to where the nominal one would; every other byte
stays. Its targets must have been made offline: those that were taught on this robot are right already. A table beside the new
program says for each target what was done; a target that is out of reach, beyond what was measured, or in a frame that only the
controller knows, is named and left. --frames states such frames: `bases` and `tools` by name, or by number in quotes, each with
xyz [m] and rpy [rad].

Example:
    aridcal compensate results/calibration.yaml poses.csv -o joints.csv
    aridcal compensate results/calibration.yaml --grid 5 -o table.csv
    aridcal compensate results weld.src -o corrected/weld.src --frames frames.yaml --at temperature=24.5
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aridcal.command_line import CommandParser, command_parser, for_scripts, run, screens
from aridcal.files.counting import counting
from aridcal.files.query import Query, Remarks
from aridcal.jobs.apply.joint_commands import Trajectory, commanded_columns, compensate, correction_table
from aridcal.jobs.apply.programs.read_project import is_program
from aridcal.jobs.apply.programs.rewrite import Request, correct_programs
from aridcal.jobs.apply.programs.sentences import lines_of
from aridcal.jobs.apply.target_poses import read_queries
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import CampaignError, OutputError, printable
from aridcal.system.progress import SHOWN_REMARKS, Screen, console_progress
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import WRITTEN_ENDINGS, table_file, write_table
from aridcal.system.writing.whole_files import atomic_file, claimed

if TYPE_CHECKING:
    import pandas as pd

    from aridcal.jobs.apply.stretches import TableStretch


def parser() -> CommandParser:
    """The command's arguments."""
    command = command_parser("compensate", __doc__)
    command.add_argument("calibration", type=path_argument, help="a result folder, or the calibration.yaml in it")
    command.add_argument(
        "poses",
        type=path_argument,
        nargs="*",
        help="wanted poses (and covariates, and joints), .csv or .parquet; or a robot program, several, or a folder of them",
    )
    command.add_argument(
        "--grid", type=int, metavar="POINTS", help="write a correction table with this many points along each joint"
    )
    command.add_argument(
        "--of",
        metavar="LINK",
        help="the poses are this link's of the URDF in place of the target's; the limb that a program moves",
    )
    command.add_argument(
        "--in", metavar="LINK", dest="inside", help="with --of: the poses are in this link's frame, not in the world's"
    )
    command.add_argument(
        "-o",
        "--out",
        type=path_argument,
        required=True,
        help="where to write the commands, .csv or .parquet, or the program; of several programs the folder",
    )
    command.add_argument(
        "--frames", type=path_argument, metavar="FILE", help="frames of a program that only its controller has"
    )
    command.add_argument(
        "--at", action="append", default=[], metavar="NAME=VALUE", help="what effects depend on while the program runs"
    )
    command.add_argument(
        "--start", metavar="J1,J2,...", help="joints where the program begins, in its units: how the arm stands then"
    )
    command.add_argument(
        "--zeros",
        metavar="A1,A2,...",
        help="what the controller shows of each axis where the URDF's joint is at zero, in its units (default: the campaign's)",
    )
    for_scripts(command)
    return command


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    command = parser()
    arguments = command.parse_args(_with_lists(sys.argv[1:] if argv is None else argv))
    if bool(arguments.poses) == (arguments.grid is not None):
        command.error("give either the poses or --grid POINTS")
    if arguments.grid is not None and arguments.grid < 2:
        command.error("--grid needs at least 2 points")
    return run(lambda: _main(arguments))


def _with_lists(argv: Sequence[str]) -> list[str]:
    """The arguments, lists of numbers tied to their option: what begins with a minus would be taken for another option."""
    tied: list[str] = []
    for argument in argv:
        if tied and tied[-1] in ("--start", "--zeros"):
            tied[-1] += f"={argument}"
        else:
            tied.append(argument)
    return tied


def _main(arguments: argparse.Namespace) -> None:
    if arguments.inside is not None and arguments.of is None:
        raise CampaignError("--in says in which link's frame; name the link that is to be there: --of LINK")
    if arguments.poses and any(is_program(path) for path in arguments.poses):
        if arguments.inside is not None:
            raise OutputError("--in is for tables of poses: a program's own frames say where its targets are")
        _correct_programs(arguments)
        return
    if len(arguments.poses) > 1:
        raise OutputError("several files are for robot programs: give one table of poses")
    if arguments.frames or arguments.at or arguments.start or arguments.zeros:
        raise OutputError("--frames, --at, --start and --zeros are for robot programs: a table has its own columns")
    if arguments.out.suffix.lower() not in WRITTEN_ENDINGS:
        raise OutputError(f"{arguments.out}: should be a .csv or .parquet file")
    check_apart([arguments.out], [arguments.calibration, *arguments.poses])
    with claimed(arguments.out, "file"):
        _compensate(arguments)


def _compensate(arguments: argparse.Namespace) -> None:
    _, aside = screens(arguments)
    calibration = SavedModel.load(arguments.calibration)
    if arguments.of is not None:
        calibration = calibration.of_link(arguments.of, arguments.inside)
    if arguments.grid is not None:
        _tabulate(calibration, arguments.grid, arguments.out, aside)
        return
    totals, trajectory = CommandTotals(calibration), Trajectory(calibration)
    with atomic_file(arguments.out) as path, table_file(path) as write, console_progress(aside) as progress:
        progress.at("finding the commands")
        for query, stretch in read_queries(calibration, arguments.poses[0], poses=True):

            def told(rows: int, stretch: TableStretch = stretch) -> None:
                progress.share(stretch.share(rows))

            table = compensate(calibration, query, trajectory, told)
            write(table)
            totals.add(query, table)
    _report(totals, calibration, arguments.out, aside)


def _correct_programs(arguments: argparse.Namespace) -> None:
    _, aside = screens(arguments)
    request = Request(
        arguments.calibration, tuple(arguments.poses), arguments.out, arguments.frames, _values(arguments.at),
        _joints(arguments.start), arguments.zeros, arguments.of,
    )  # fmt: skip
    with console_progress(aside) as progress:
        answer = correct_programs(request, progress)
    aside.say(*map(printable, lines_of(answer)))


def _values(arguments: Sequence[str]) -> dict[str, float]:
    """NAME=VALUE of each --at."""
    values = {}
    for text in arguments:
        name, _, value = text.partition("=")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            raise OutputError(f"--at {text}: should be NAME=NUMBER, as in --at temperature=24.5") from None
    return values


def _joints(text: str | None) -> tuple[float, ...] | None:
    """Numbers of --start; None where it is not given."""
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise OutputError(
            f"--start {text}: should be numbers with commas between, in the units of the program"
        ) from None


@dataclass
class CommandTotals:
    """What is said of a table once all its stretches have their commands.

    Attributes:
        calibration: The model.
        rows: How many.
        reached: How many of their poses are reached.
        missed: How many are out of reach.
        bare: How many have no command.
        unlike: How many are unlike what was measured.
        far: Sentences on the first of those out of reach.
        remarks: What is odd.
    """

    calibration: SavedModel
    rows: int = 0
    reached: int = 0
    missed: int = 0
    bare: int = 0
    unlike: int = 0
    far: list[str] = field(default_factory=list)
    remarks: Remarks = field(default_factory=lambda: Remarks(SHOWN_REMARKS))

    def add(self, query: Query, table: pd.DataFrame) -> None:
        """Count one more stretch."""
        commanded = table["position_error"].notna().to_numpy()
        missed = np.flatnonzero(commanded & ~table["reached"].to_numpy(bool))
        for k in missed[: SHOWN_REMARKS - len(self.far)]:
            off = 1e3 * float(table["position_error"].iloc[k]) * self.calibration.measurements.units.metres
            self.far.append(
                f"line {query.line[k]}: cannot be reached within the joint limits: {off:.3f} mm off at best"
            )
        self.rows += len(table)
        self.reached += int(table["reached"].sum())
        self.missed += len(missed)
        self.bare += int((~commanded).sum())
        self.unlike += int(table["extrapolates"].sum())
        self.remarks.add(query)


def _tabulate(calibration: SavedModel, points: int, out: Path, console: Screen) -> None:
    import pandas as pd  # slow to load, and robot programs do without

    robot, settings = calibration.final.model.robot, calibration.measurements
    with console_progress(console) as progress:
        progress.at("making the table")
        found = correction_table(calibration, points, progress)
    names = [settings.columns.get(name, name) for name in robot.readings]
    own = counting(settings, robot.readings, robot.kinds)
    cells, deltas = own.cells(np.array(list(product(*found.axes)))), own.steps(found.delta.reshape(-1, len(names)))
    table = pd.DataFrame(np.hstack([cells, deltas]), columns=[*names, *(f"delta_{name}" for name in names)])
    held = [name for name, moves in zip(names, commanded_columns(calibration), strict=True) if not moves]
    table = table.drop(columns=[*held, *(f"delta_{name}" for name in held)])
    with atomic_file(out) as path:
        write_table(table, path)
    console.say(
        f"{out}: {len(cells)} points; RMS error of the target between them {1e3 * found.after:.3f} mm, "
        f"without the table {1e3 * found.before:.3f} mm"
    )


def _report(totals: CommandTotals, calibration: SavedModel, out: Path, console: Screen) -> None:
    """Print remarks, poses out of reach and totals."""
    lines = [*totals.remarks.lines(), *totals.far]
    if calibration.measurements.joint_reading == "reported":
        lines.append(
            "these are joints to be reported by the controller, as in the calibration: to get the commands, add to each "
            "the difference between commanded and reported joint"
        )
    remarks = calibration.measurements.table.remarks_on(out)
    sentence = f"{out}: {totals.rows} rows, {totals.reached} reached"
    sentence += f", {totals.missed} out of reach" if totals.missed else ""
    sentence += f", {totals.bare} without a command because a number is missing" if totals.bare else ""
    console.say(*lines, f"{sentence}; {totals.unlike} of them unlike what was measured", *remarks)


if __name__ == "__main__":
    sys.exit(main())
