"""Boards on the command line: lengths with their unit, sizes as 7x5, and what holds where nothing is said."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from typing import Any

from aridcal.jobs.boards.patterns import Chessboard, Circles, Cube, Tags, check_board
from aridcal.jobs.boards.sheet import MM
from aridcal.jobs.head1992.charuco import Board
from aridcal.system.errors import CampaignError

Defaults = Mapping[str, Mapping[str, Any]]
"""Of each thing: its options, each with what holds where it is not given."""

BOARDS: Defaults = {
    "charuco": {"size": (7, 5), "square": 0.035, "marker": 0.026, "dictionary": "DICT_5X5_100"},
    "chessboard": {"size": (8, 5), "square": 0.03},
    "circles": {"size": (4, 11), "square": 0.02},
}

CUBE: Defaults = {"cube": {"square": 0.05, "marker": 0.04, "dictionary": "DICT_APRILTAG_36h11", "first": 0}}

ALL_BOARDS: Defaults = {**BOARDS, **CUBE}
"""Whose marks are known places: what a campaign can take as `markers`."""

TAGS: Defaults = {"apriltag": {"dictionary": "DICT_APRILTAG_36h11"}, "aruco": {"dictionary": "DICT_5X5_100"}}

LENGTH_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}

SCALED_DECIMALS = 4
"""Decimals of a marker's side [m] that follows from the square's: tenths of a millimetre, which a ruler shows."""

_LENGTH = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*(mm|cm|m|in)\s*")
_SIZE = re.compile(r"\s*(\d{1,3})\s*[x×]\s*(\d{1,3})\s*")


def length(text: str) -> float:
    """A length with its unit, ``35mm``: the ``type`` of an argument, [m]."""
    parts = _LENGTH.fullmatch(text)
    if not parts or not 0 < float(parts[1]) * LENGTH_UNITS[parts[2]] < MM:
        raise argparse.ArgumentTypeError(f"{text!r} is no length with its unit: write 35mm, 3.5cm or 0.035m")
    return float(parts[1]) * LENGTH_UNITS[parts[2]]


def size(text: str) -> tuple[int, int]:
    """Squares to the right and down, ``7x5``: the ``type`` of an argument."""
    parts = _SIZE.fullmatch(text)
    if not parts:
        raise argparse.ArgumentTypeError(f"{text!r} is no size of a board: write 7x5")
    return int(parts[1]), int(parts[2])


def add_board_options(arguments: argparse.ArgumentParser) -> None:
    """Add the options that describe a board, the same for all commands."""
    board = arguments.add_argument_group("the board")
    board.add_argument("--size", type=size, help="squares to the right and down, 7x5; circles in a row and rows, 4x11")
    board.add_argument(
        "--square", type=length, help="side of a square or of the cube, 35mm; of circles half their distance in a row"
    )
    board.add_argument(
        "--marker",
        type=length,
        help="side of a marker's black square (default: in proportion to the square; 26mm of 35mm)",
    )
    board.add_argument("--dictionary", help="of the markers, one of OpenCV's: DICT_5X5_100, DICT_APRILTAG_36h11, …")


def chosen(arguments: argparse.Namespace, what: str, defaults: Defaults) -> dict[str, Any]:
    """The options of one kind of print, defaults filled in.

    Args:
        arguments: Of the command.
        what: The kind.
        defaults: Of all kinds.

    Raises:
        CampaignError: an option is given that this thing does not have.
    """
    of_thing = defaults[what]
    foreign = sorted({name for options in defaults.values() for name in options} - set(of_thing))
    for name in foreign:
        if getattr(arguments, name) is not None:
            known = ", ".join(f"--{option}" for option in of_thing) or "no options"
            raise CampaignError(f"--{name}: {what} has no such option; it has {known}")
    typed = {name: value for name in of_thing if (value := getattr(arguments, name)) is not None}
    usual = dict(of_thing)
    if {"square", "marker"} <= set(of_thing) and "square" in typed:
        usual["marker"] = round(of_thing["marker"] / of_thing["square"] * typed["square"], SCALED_DECIMALS)
    return usual | typed


def board_of(what: str, options: Mapping[str, Any]) -> Board | Chessboard | Circles | Tags | Cube:
    """The board of some options.

    Raises:
        CampaignError: they make none.
    """
    size_x, size_y = options.get("size", (0, 0))
    board: Board | Chessboard | Circles | Tags | Cube
    if what == "charuco":
        board = Board(size_x, size_y, options["square"], options["marker"], options["dictionary"])
    elif what == "chessboard":
        board = Chessboard(size_x, size_y, options["square"])
    elif what == "circles":
        board = Circles(size_x, size_y, options["square"])
    elif what == "cube":
        board = Cube(options["square"], options["marker"], options["dictionary"], options["first"])
    else:
        board = Tags(options["dictionary"])
    check_board(board)
    return board


def option_text(options: Mapping[str, Any]) -> str:
    """Options as they are typed."""
    return " ".join(f"--{name} {_as_typed(value)}" for name, value in options.items())


def _as_typed(value: Any) -> str:
    if isinstance(value, tuple):
        return "x".join(map(str, value))
    return f"{MM * value:g}mm" if isinstance(value, float) else str(value)
