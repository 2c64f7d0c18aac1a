"""Where the real target is: its pose for each row of joint readings, through the whole calibrated model.

Example:
    aridcal predict results/calibration.yaml query.csv -o predicted.csv
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from scipy.spatial.transform import Rotation

from aridcal.calibration import Calibration
from aridcal.commands import CommandParser, atomic_file, check_writable, command_parser, run
from aridcal.errors import MeasurementError, OutputError
from aridcal.measurements import Query, load_query
from aridcal.quality import joint_kinds, joint_limits
from aridcal.source import POSITION, QUATERNION

ENDINGS = (".csv", ".parquet")
SHOWN_REMARKS = 5

EPILOG = """\
The query has a column for each joint, and for each covariate that an effect depends on; columns and units are those of
the campaign's own tables. All its columns and rows are kept in their order. `x y z qx qy qz qw` (qw >= 0; positions
only: `x y z` alone, for nothing was learnt of the target's orientation) are filled in, or overwritten if present, and
`extrapolates` is true where a joint or a covariate is outside the range that the calibration has seen. A row that
lacks a number comes back without a pose.
"""


def predict(calibration: Calibration, query: Query) -> pd.DataFrame:
    """Fill in the target's pose for each row of a query.

    Args:
        calibration: The model.
        query: N rows, read with the calibration's own `measurements` settings.

    Returns:
        The query's table with the pose and `extrapolates`, N rows; a pose that cannot be told is left empty.

    Raises:
        CovariateNotFound: an effect depends on a column that is not there.
        MeasurementError: a row's station is none of those that were calibrated.
    """
    settings, final = calibration.measurements, calibration.final
    known = query.usable
    covariates = {name: values[known] for name, values in query.covariates.items()}
    R, p = final.poses(query.readings[known], covariates, None if query.station is None else query.station[known])
    R[np.isnan(p).any(axis=1)] = np.nan
    filled = dict(zip(POSITION, (p / settings.units.metres).T, strict=True))
    if calibration.kind == "pose":
        filled |= dict(zip(QUATERNION, quaternions(R).T, strict=True))
    table = query.table.copy()
    for quantity, values in filled.items():
        column = np.full(len(table), np.nan)
        column[known] = values
        table[settings.columns.get(quantity, quantity)] = column
    if calibration.kind == "position":
        table = table.drop(columns=[settings.columns.get(q, q) for q in QUATERNION], errors="ignore")
    table["extrapolates"] = extrapolates(calibration, query)
    return table


def quaternions(R: np.ndarray) -> np.ndarray:
    """Unit quaternions qx qy qz qw with qw >= 0, shape (N, 4), of rotations (N, 3, 3); NaN where R is."""
    known = ~np.isnan(R).any(axis=(1, 2))
    q = np.full((len(R), 4), np.nan)
    q[known] = Rotation.from_matrix(R[known], assume_valid=True).as_quat(canonical=True)
    return q


def extrapolates(calibration: Calibration, query: Query) -> np.ndarray:
    """Rows outside the ranges of joints and covariates that the calibration has seen, shape (N,)."""
    columns = query.covariates | dict(zip(calibration.final.model.robot.readings, query.readings.T, strict=True))
    outside = np.zeros(len(query.line), dtype=bool)
    for name, (low, high) in calibration.ranges.items():
        outside |= (columns[name] < low) | (columns[name] > high)
    return outside


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write csv or parquet, by the name's ending; every float with the digits that give it back exactly."""
    if path.suffix.lower() == ".parquet":
        table.to_parquet(path, index=False)
    else:
        words = {str(name): table[name].map({True: "true", False: "false"}) for name in table.select_dtypes(bool)}
        table.assign(**words).to_csv(path, index=False, float_format="%.17g")


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("predict", __doc__, EPILOG)
    arguments.add_argument("calibration", type=Path, help="calibration.yaml of a result folder")
    arguments.add_argument("query", type=Path, help="joint readings (and covariates), .csv or .parquet")
    arguments.add_argument("-o", "--out", type=Path, required=True, help="where to write them with the poses, likewise")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> None:
    if arguments.out.suffix.lower() not in ENDINGS:
        raise OutputError(f"{arguments.out}: should be a .csv or .parquet file")
    check_writable(arguments.out)
    calibration = Calibration.load(arguments.calibration)
    model = calibration.final.model
    query = load_query(
        arguments.query,
        model.robot.readings,
        joint_limits(model.robot),
        joint_kinds(model.robot),
        calibration.measurements,
        per_station=len(model.world_base) > 1 or len(model.tip_target) > 1,
    )
    if not query.usable.any():
        raise MeasurementError(f"no row can be predicted. First: {query.refused[0]}")
    table = predict(calibration, query)
    with atomic_file(arguments.out) as path:
        write_table(table, path)
    _report(table, calibration.measurements.columns.get("x", "x"), query, arguments.out)


def _report(table: pd.DataFrame, x: str, query: Query, out: Path) -> None:
    """Say on the screen what the table itself does not shout."""
    console = Console(stderr=True)
    for remark in (*query.refused, *query.notices)[:SHOWN_REMARKS]:
        console.print(str(remark), markup=False, highlight=False, soft_wrap=True)
    more = len(query.refused) + len(query.notices) - SHOWN_REMARKS
    if more > 0:
        console.print(f"and {more} more remarks", highlight=False)
    bare = int(table[x].isna().sum())
    said = f"{out}: {len(table)} rows, {int(table['extrapolates'].sum())} of them outside what the calibration has seen"
    said += f", {bare} without a pose because a number is missing" if bare else ""
    console.print(said, markup=False, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
