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

With --grid the output is a correction table, for controllers that accept no model: for each point of a grid over the
joints, the correction to be added to the nominal solution.

Example:
    aridcal compensate results/calibration.yaml poses.csv -o joints.csv
    aridcal compensate results/calibration.yaml --grid 5 -o table.csv
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from aridcal.command_line import CommandParser, command_parser, run
from aridcal.errors import OutputError
from aridcal.files import atomic_file, check_home, check_writable
from aridcal.inputs.query import Query
from aridcal.reading.names import path_argument
from aridcal.result.compensate import compensate, correction_table
from aridcal.result.predict import ENDINGS, read_query, write_table
from aridcal.result.saved_model import SavedModel

SHOWN_REMARKS = 5


def parser() -> CommandParser:
    """The command's arguments."""
    command = command_parser("compensate", __doc__)
    command.add_argument("calibration", type=path_argument, help="calibration.yaml of a result folder")
    command.add_argument(
        "poses", type=path_argument, nargs="?", help="wanted poses (and covariates, and joints), .csv or .parquet"
    )
    command.add_argument(
        "--grid", type=int, metavar="POINTS", help="write a correction table with this many points along each joint"
    )
    command.add_argument(
        "-o", "--out", type=path_argument, required=True, help="where to write the commands, .csv or .parquet"
    )
    return command


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    command = parser()
    arguments = command.parse_args(argv)
    if (arguments.poses is None) == (arguments.grid is None):
        command.error("give either the poses or --grid POINTS")
    if arguments.grid is not None and arguments.grid < 2:
        command.error("--grid needs at least 2 points")
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> None:
    if arguments.out.suffix.lower() not in ENDINGS:
        raise OutputError(f"{arguments.out}: should be a .csv or .parquet file")
    check_home(arguments.out)
    check_writable(arguments.out, "file")
    calibration = SavedModel.load(arguments.calibration)
    if arguments.grid is not None:
        _tabulate(calibration, arguments.grid, arguments.out)
        return
    query = read_query(calibration, arguments.poses, poses=True)
    table = compensate(calibration, query)
    with atomic_file(arguments.out) as path:
        write_table(table, path)
    _report(table, calibration, query, arguments.out)


def _tabulate(calibration: SavedModel, points: int, out: Path) -> None:
    robot, settings = calibration.final.model.robot, calibration.measurements
    found = correction_table(calibration, points)
    units = [settings.units.metres if k == "prismatic" else settings.units.radians for k in robot.kinds]
    names = [settings.columns.get(name, name) for name in robot.readings]
    values = np.hstack([np.array(list(product(*found.axes))), found.delta.reshape(-1, len(names))])
    columns = [*names, *(f"delta_{name}" for name in names)]
    with atomic_file(out) as path:
        write_table(pd.DataFrame(values / [*units, *units], columns=columns), path)
    Console(stderr=True).print(
        f"{out}: {len(values)} points; RMS error of the target between them {1e3 * found.after:.3f} mm, "
        f"without the table {1e3 * found.before:.3f} mm",
        markup=False, highlight=False, soft_wrap=True,
    )  # fmt: skip


def _report(table: pd.DataFrame, calibration: SavedModel, query: Query, out: Path) -> None:
    """Print remarks, poses out of reach and totals."""
    console = Console(stderr=True)

    def say(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    for remark in (*query.refused, *query.notices)[:SHOWN_REMARKS]:
        say(str(remark))
    more = len(query.refused) + len(query.notices) - SHOWN_REMARKS
    if more > 0:
        say(f"and {more} more remarks")
    commanded = table["position_error"].notna().to_numpy()
    missed = np.flatnonzero(commanded & ~table["reached"].to_numpy(bool))
    for k in missed[:SHOWN_REMARKS]:
        off = 1e3 * float(table["position_error"].iloc[k]) * calibration.measurements.units.metres
        say(f"line {query.line[k]}: cannot be reached within the joint limits: {off:.3f} mm off at best")
    if calibration.measurements.joint_reading == "reported":
        say(
            "these are joints to be reported by the controller, as in the calibration: to get the commands, add to each "
            "the difference between commanded and reported joint"
        )
    said = f"{out}: {len(table)} rows, {int(table['reached'].sum())} reached"
    said += f", {len(missed)} out of reach" if len(missed) else ""
    said += f", {int((~commanded).sum())} without a command because a number is missing" if not commanded.all() else ""
    say(f"{said}; {int(table['extrapolates'].sum())} of them unlike what was measured")


if __name__ == "__main__":
    sys.exit(main())
