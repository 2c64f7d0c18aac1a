"""Tell whether a calibration is still good, from 5 to 20 new rows, and if it is not, what moved.

The rows have the columns and units of the campaign's own tables, and poses or positions as those had. They should be measured
in attitudes that differ. The residual is set beside the noise and the calibration's own uncertainty: of calibrations that are
still right 1 % fail. If one fails, it is said what moved, with its probability: the zero of a joint, the tool, the base or the
instrument, one effect, or that rows are odd by themselves; and a configuration to measure, where two causes look alike.

With --tolerance the question is another: a calibration fails only if its RMS position error is above the tolerance, which is
wrong in 1 % of cases, too.

Exit status: 0 still good, 3 no longer good.

Example:
    aridcal check results new.csv
    aridcal check results new.csv --tolerance 0.2mm
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from rich.console import Console

from aridcal.command_line import DONE, NOT_GOOD, CommandParser, command_parser, run
from aridcal.inputs.measurement_settings import length_argument
from aridcal.reading.names import path_argument
from aridcal.result.saved_model import SavedModel
from aridcal.upkeep.answers import check_lines
from aridcal.upkeep.checking import check
from aridcal.upkeep.new_rows import read_new_rows
from aridcal.upkeep.repair import changes


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("check", __doc__)
    arguments.add_argument("results", type=path_argument, help="result folder, or its calibration.yaml")
    arguments.add_argument("rows", type=path_argument, help="new measurements, .csv or .parquet")
    arguments.add_argument(
        "--tolerance",
        type=length_argument,
        metavar="LENGTH",
        help="RMS position error that is still good, 0.2mm for instance",
    )
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> int:
    saved = SavedModel.load(arguments.results)
    new = read_new_rows(saved, arguments.rows)
    checked = check(saved, new.rows, arguments.tolerance, new.frames)
    console = Console()
    for line in check_lines(checked, changes(checked), saved.measurements.units):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    for remark in (*new.rows.refused, *new.rows.notices):
        console.print(f"note: {remark}", markup=False, highlight=False, soft_wrap=True)
    return DONE if checked.good else NOT_GOOD


if __name__ == "__main__":
    sys.exit(main())
