"""Mend a calibration with 5 to 20 new rows after something changed: a motor, the tool, the place of the base.

What moved is found as `aridcal check` does. Only that is fitted; everything else, effects included, is kept as well as it was
known. Written are calibration.yaml, calibrated.urdf, model.urdf where there are effects, and result.json with what moved and
with the lineage: the file of the calibration before, its hash, and the rows that were used.

Nothing is written where nothing moved, where the rows alone are odd, or where a few moved parts do not explain them: then exit
status 2, and what to do.

Example:
    aridcal recalibrate results new.csv -o repaired
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from aridcal.command_line import CommandParser, command_parser, run
from aridcal.errors import CampaignError, OutputError
from aridcal.reading.files import CALIBRATION, read_file
from aridcal.reading.names import path_argument
from aridcal.result.saved_model import SavedModel
from aridcal.result_folder import RESULT_FILES, RESULT_FOLDERS
from aridcal.upkeep.answers import check_lines
from aridcal.upkeep.checking import Checked, check
from aridcal.upkeep.new_rows import read_new_rows
from aridcal.upkeep.repair import Repaired, document, lineage, repaired, urdf_of
from aridcal.writing.files import atomic_folder, claimed


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("recalibrate", __doc__)
    arguments.add_argument("results", type=path_argument, help="result folder, or its calibration.yaml")
    arguments.add_argument("rows", type=path_argument, help="measurements after the change, .csv or .parquet")
    arguments.add_argument("-o", "--out", type=path_argument, required=True, help="folder for the repaired calibration")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> None:
    before = arguments.results / "calibration.yaml" if arguments.results.is_dir() else arguments.results
    if arguments.out.resolve() == before.resolve().parent:
        raise OutputError(f"{arguments.out}: holds the calibration that is to be repaired, which is kept; name another")
    with claimed(arguments.out, "folder", RESULT_FILES, RESULT_FOLDERS):
        _recalibrate(arguments, before)


def _recalibrate(arguments: argparse.Namespace, before: Path) -> None:
    saved = SavedModel.load(arguments.results)
    content = read_file(before, CampaignError, CALIBRATION)
    checked = check(saved, read_new_rows(saved, arguments.rows))
    mended = repaired(saved, checked)
    _write(arguments.out, mended, checked, lineage(saved, before, content, checked))
    console = Console()
    for line in check_lines(checked, mended.changes, saved.measurements.units):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    console.print(f"repaired: {arguments.out}", soft_wrap=True, markup=False, highlight=False)


def _write(out: Path, mended: Repaired, checked: Checked, parents: dict[str, object]) -> None:
    """Write the folder's files."""
    saved = replace(mended.saved, record=mended.saved.record | {"lineage": parents})
    with atomic_folder(out, RESULT_FILES | RESULT_FOLDERS) as stage:
        (stage / "calibration.yaml").write_text(saved.dump(), encoding="utf-8")
        (stage / "calibrated.urdf").write_bytes(urdf_of(saved.geometric))
        if any(c.basis.form not in ("1", "ones") for c in saved.final.model.coefficients):
            (stage / "model.urdf").write_bytes(urdf_of(saved.final))
        found = document(checked, mended, parents)
        (stage / "result.json").write_text(json.dumps(found, indent=2, allow_nan=False) + "\n")


if __name__ == "__main__":
    sys.exit(main())
