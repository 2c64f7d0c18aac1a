"""Boards and bodies to print at true scale: SVG or PDF for a printer of paper, STL for one of bodies.

charuco, chessboard, circles: flat boards. cube: six tags to cut out, fold and glue. square, strip: the calibration squares of
the measuring head. holder: two sockets for a ball. cup: carries the ball on the flange. Beside a board or cube, markers.csv
has the places of its marks, as a campaign's `instruments: markers` takes it. Print at 100 % and measure both rulers.

Example:
    aridcal print charuco -o print/board.pdf
    aridcal print charuco --size 11x8 --square 30mm --marker 22mm --dictionary DICT_4X4_100 -o print/board.svg
    aridcal print cube -o print/cube.pdf
    aridcal print holder --ball 20mm --apart 50mm -o print/holder.stl
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import pandas as pd

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.jobs.boards.bodies import cup, holder, seat_rise, stl
from aridcal.jobs.boards.options import ALL_BOARDS, Defaults, add_board_options, board_of, chosen, length, option_text
from aridcal.jobs.boards.patterns import Marks, Tags, drawing, marks, square_strip
from aridcal.jobs.boards.sheet import MM, Sheet, on_paper, pdf, svg
from aridcal.jobs.head1992.square import STRIP_SQUARES
from aridcal.system.errors import CampaignError, OutputError
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.whole_files import atomic_file, atomic_table

MARKERS = "markers.csv"
"""Written beside a board: the places of its marks."""

SQUARE_SHEETS: Defaults = {"square": {"first": 0}, "strip": {}}

BODIES: Defaults = {
    "holder": {"ball": 0.02, "apart": 0.05, "bolt": 0.0055},
    "cup": {"ball": 0.02, "bolts": 4, "circle": 0.05, "bolt": 0.0066},
}

ALL: Defaults = {**ALL_BOARDS, **SQUARE_SHEETS, **BODIES}

# Index of a square: its bars have room for three digits.
MOST_SQUARES = 1000


def markers_table(marks: Marks) -> pd.DataFrame:
    """Marks as rows of ``markers.csv``: marker, x, y, z in the board's frame, [m]."""
    table = pd.DataFrame(marks.places.round(9) + 0.0, columns=["x", "y", "z"])
    table.insert(0, "marker", marks.names)
    return table


def sheet_of(what: str, options: dict[str, Any]) -> tuple[Sheet, Marks | None]:
    """What is drawn, without a margin, and its marks where a campaign can use them."""
    if what in SQUARE_SHEETS:
        first = options.get("first", 0)
        if not 0 <= first < MOST_SQUARES:
            raise CampaignError(f"--first: {first}; squares have the numbers 0 to {MOST_SQUARES - 1}")
        return square_strip(range(first, first + 1) if what == "square" else range(STRIP_SQUARES)), None
    board = board_of(what, options)
    assert not isinstance(board, Tags)
    return drawing(board), marks(board)


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("print", __doc__)
    arguments.add_argument("what", choices=list(ALL), help="what to print")
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, help="file to write: .svg or .pdf, .stl of a holder or cup"
    )
    add_board_options(arguments)
    arguments.add_argument("--first", type=int, help="number of the cube's first tag, or of the square (default: 0)")
    bodies = arguments.add_argument_group("the ball")
    bodies.add_argument("--ball", type=length, help="its diameter (default: 20mm)")
    bodies.add_argument("--apart", type=length, help="distance of the holder's sockets (default: 50mm)")
    bodies.add_argument("--bolt", type=length, help="diameter of the bores for bolts (default: 5.5mm, of a cup 6.6mm)")
    bodies.add_argument("--bolts", type=int, help="bolts of the flange (default: 4)")
    bodies.add_argument("--circle", type=length, help="diameter of the flange's bolt circle (default: 50mm)")
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    what, out = arguments.what, arguments.out
    options = chosen(arguments, what, ALL)
    endings = [".stl"] if what in BODIES else [".svg", ".pdf"]
    if out.suffix.lower() not in endings:
        raise OutputError(f"{out}: {what} is written as {' or '.join(endings)}: end the name in that")
    said = _print_body(what, options, out) if what in BODIES else _print_sheet(what, options, out)
    screens(arguments)[0].say("\n".join(said))


def _print_body(what: str, options: dict[str, Any], out: Path) -> list[str]:
    content = stl(holder(**options) if what == "holder" else cup(**options))
    with atomic_file(out) as path:
        path.write_bytes(content)
    rise = MM * seat_rise(options["ball"])
    remarks = [
        f"{out}: {what} for a ball of {MM * options['ball']:g} mm, whose centre is {rise:.2f} mm above the seat's mouth"
    ]
    if what == "holder":
        remarks.append(
            f"in the campaign: instruments: {{lengths: [{{between: [a0, a1], length: {options['apart']:g}, std: 1.0e-4}}]}}"
        )
    return remarks


def _print_sheet(what: str, options: dict[str, Any], out: Path) -> list[str]:
    plain, marks_found = sheet_of(what, options)
    sheet = on_paper(plain, f"aridcal print {what} {option_text(options)}".strip())
    content = svg(sheet).encode() if out.suffix.lower() == ".svg" else pdf(sheet)
    width, height = sheet.size
    remarks = [f"{out}: {width:g} x {height:g} mm; print it at 100 %, then measure both rulers"]
    if marks_found is None:
        with atomic_file(out) as path:
            path.write_bytes(content)
        return remarks
    with atomic_table(out, [MARKERS]) as folder:
        (folder / out.name).write_bytes(content)
        markers_table(marks_found).to_csv(folder / MARKERS, index=False)
    return [*remarks, f"{out.parent / MARKERS}: places of its {len(marks_found)} marks"]


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
