"""Predict the pose of the real target for each row of joint readings, with the whole calibrated model.

The query has a column for each joint and for each covariate that an effect depends on. Names and units of its columns are
those of the campaign's tables. All columns and rows are kept in their order. The pose is added, or overwritten if present,
in the columns, units and orientation of those tables: `x y z qx qy qz qw` (qw >= 0), or X Y Z A B C in mm and degrees where
the campaign has that. A calibration from positions gives no orientation, since it does not know the target's.
`std_x std_y std_z std_rx std_ry std_rz` are the pose's standard deviations, in the same units, about the world's axes; what
the table had in these columns is replaced, and orientations of another writing are dropped. Where the calibration could not tell
the cause of an effect from others, a step in time from one in a joint's reading for instance, the spread between them is in it.
`extrapolates` is true where a joint or a covariate is outside the calibrated range or in a hole of what was measured, and where
the pose is three times as uncertain as at any calibrated row. A row with an empty joint gets no pose; a word in its place, or a
hole in a covariate that an effect depends on, is an error.
`--of LINK` gives the pose of another link of the URDF, `--in LINK` in the frame of one: of the calibrated robot with its effects.
The table then also needs the joints on the way there; with one that was not calibrated, `extrapolates` is true.
Where the calibration has something that no reading told, `told` is false in rows that it may move by more than 10 mm or 10 mrad.

Example:
    aridcal predict results/calibration.yaml query.csv -o predicted.csv
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.files.query import Query, Remarks
from aridcal.jobs.apply.target_poses import predict, read_queries
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import CampaignError, OutputError
from aridcal.system.progress import SHOWN_REMARKS, Screen, console_progress
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import WRITTEN_ENDINGS, table_file
from aridcal.system.writing.whole_files import atomic_file, claimed


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("predict", __doc__)
    arguments.add_argument("calibration", type=path_argument, help="calibration.yaml of a result folder")
    arguments.add_argument("query", type=path_argument, help="joint readings (and covariates), .csv or .parquet")
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, help="where to write them with their poses, .csv or .parquet"
    )
    arguments.add_argument("--of", metavar="LINK", help="the pose of this link of the URDF in place of the target's")
    arguments.add_argument(
        "--in", metavar="LINK", dest="inside", help="with --of: in this link's frame, not in the world's"
    )
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    if arguments.out.suffix.lower() not in WRITTEN_ENDINGS:
        raise OutputError(f"{arguments.out}: should be a .csv or .parquet file")
    check_apart([arguments.out], [arguments.calibration, arguments.query])
    with claimed(arguments.out, "file"):
        _predict(arguments)


def _predict(arguments: argparse.Namespace) -> None:
    if arguments.inside is not None and arguments.of is None:
        raise CampaignError("--in says in which link's frame; name the link whose pose is wanted: --of LINK")
    calibration = SavedModel.load(arguments.calibration)
    if arguments.of is not None:
        calibration = calibration.of_link(arguments.of, arguments.inside)
    totals = PredictionTotals(calibration.measurements.columns.get("x", "x"))
    _, aside = screens(arguments)
    with atomic_file(arguments.out) as path, table_file(path) as write, console_progress(aside) as progress:
        progress.at("predicting")
        for query, stretch in read_queries(calibration, arguments.query):
            table = predict(calibration, query)
            write(table)
            totals.add(query, table)
            progress.share(stretch.share(len(table)))
    _report(totals, calibration, arguments.out, aside)


@dataclass
class PredictionTotals:
    """What is said of a table once all its stretches are predicted.

    Attributes:
        x: Name of the column that is empty where a row has no pose.
        rows: How many.
        unlike: How many of them are unlike what was measured.
        untold: How many have a pose that no reading told all of.
        bare: How many have no pose.
        remarks: What is odd.
    """

    x: str
    rows: int = 0
    unlike: int = 0
    untold: int = 0
    bare: int = 0
    remarks: Remarks = field(default_factory=lambda: Remarks(SHOWN_REMARKS))

    def add(self, query: Query, table: pd.DataFrame) -> None:
        """Count one more stretch."""
        self.rows += len(table)
        self.unlike += int(table["extrapolates"].sum())
        bare = table[self.x].isna()
        self.untold += int((~table["told"] & ~bare).sum()) if "told" in table else 0
        self.bare += int(bare.sum())
        self.remarks.add(query)


def _report(totals: PredictionTotals, calibration: SavedModel, out: Path, console: Screen) -> None:
    """Print remarks and totals."""
    console.say(*totals.remarks.lines())
    sentence = f"{out}: {totals.rows} rows, {totals.unlike} of them unlike what was measured"
    sentence += f", {totals.untold} where no reading told a part of what moves the target" if totals.untold else ""
    sentence += f", {totals.bare} without a pose because a number is missing" if totals.bare else ""
    console.say(sentence, *calibration.measurements.table.remarks_on(out))


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
