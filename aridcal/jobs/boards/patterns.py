"""What is printed for a camera: ChArUco boards, chessboards, circle grids, cubes of tags, Doty's squares.

A flat board's frame has its origin at the board's centre, x right, y up, z out of the paper, as that of the calibration
square; a cube's is at its centre, with z out of its first face. Lengths are in [m].

Labels of marks: ``c0``, ``c1``, ... for inner corners and circles, row by row from the upper left; ``tag7_1`` ... ``tag7_4``
for the corners of tag 7, clockwise from its own upper left corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from aridcal.jobs.boards.sheet import MM, Sheet
from aridcal.jobs.head1992.charuco import Board
from aridcal.jobs.head1992.square import (
    SQUARE_SIDE,
    UNIT_CORNERS,
    fiducial_corners,
    index_corners,
    paper_corners,
    strip_placements,
)
from aridcal.system.errors import CampaignError, nearest

# Corners of a marker in OpenCV's order: clockwise from the upper left, as those of UNIT.
CORNERS = 4

# Diameter of a circle of a grid, in distances between a circle and its nearest neighbours.
CIRCLE = 0.55

# Width of a cube's glue tabs, in sides of the cube.
TAB = 0.2

# Smallest boards that show a plane.
FEWEST_SQUARES, FEWEST_CIRCLES = 3, 3


@dataclass(frozen=True)
class Marks:
    """Named places of a board.

    Attributes:
        names: Labels.
        places: In the board's frame, shape (M, 3), [m].
    """

    names: tuple[str, ...]
    places: np.ndarray

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class Chessboard:
    """A chessboard of so many squares, the upper left one black; sides in [m]."""

    squares_x: int
    squares_y: int
    square: float


@dataclass(frozen=True)
class Circles:
    """An asymmetric grid of circles as OpenCV has it: every other row is shifted by ``half``.

    Attributes:
        columns: Circles in a row.
        rows: Rows.
        half: Half the distance of two circles in a row, and the distance of two rows, [m].
    """

    columns: int
    rows: int
    half: float


@dataclass(frozen=True)
class Tags:
    """Tags of one dictionary, wherever they are."""

    dictionary: str


@dataclass(frozen=True)
class Cube:
    """A cube with a tag on each face.

    Attributes:
        side: Of the cube, [m].
        tag: Side of a tag's black square, [m].
        dictionary: Of the tags.
        first: Number of the first face's tag; the others follow.
    """

    side: float
    tag: float
    dictionary: str
    first: int


AnyBoard = Board | Chessboard | Circles | Tags
"""Boards that can be looked for in an image."""

# x and y of each face of a cube in the cube's frame, and its place in the net, in sides: front, right, back, left, upper, lower.
FACES = (
    ((1, 0, 0), (0, 1, 0), (0, 0)),
    ((0, 0, -1), (0, 1, 0), (1, 0)),
    ((-1, 0, 0), (0, 1, 0), (2, 0)),
    ((0, 0, 1), (0, 1, 0), (-1, 0)),
    ((1, 0, 0), (0, 0, -1), (0, 1)),
    ((1, 0, 0), (0, 0, 1), (0, -1)),
)

# Sides of the faces in the net that get a tab: face, and direction from its middle.
_TABS = ((2, (1, 0)), (4, (-1, 0)), (4, (1, 0)), (4, (0, 1)), (5, (-1, 0)), (5, (1, 0)), (5, (0, -1)))


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """A dictionary of OpenCV by its name, ``DICT_APRILTAG_36h11`` for instance.

    Raises:
        CampaignError: there is none of that name.
    """
    known = dictionaries()
    if name not in known:
        raise CampaignError(f"dictionary: unknown {name!r}{nearest(name, known)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def dictionaries() -> list[str]:
    """Names of OpenCV's dictionaries, each once."""
    names: dict[int, str] = {}
    for name in dir(cv2.aruco):  # capitals come first, the usual spelling 36h11 after 36H11
        if name.startswith("DICT_"):
            names[getattr(cv2.aruco, name)] = name
    return sorted(names.values())


def tag_names(number: int) -> list[str]:
    """Labels of a tag's corners, clockwise from its upper left one."""
    return [f"tag{number}_{k + 1}" for k in range(CORNERS)]


def check_board(board: AnyBoard | Cube) -> None:
    """Refuse sizes that make no board, and boards whose marks cannot be told apart.

    Raises:
        CampaignError: naming the number that is wrong, and the remedy.
    """
    if isinstance(board, Board):
        if min(board.squares_x, board.squares_y) < FEWEST_SQUARES:
            raise CampaignError(f"--size: a ChArUco board has at least {FEWEST_SQUARES}x{FEWEST_SQUARES} squares")
        board.opencv()
    elif isinstance(board, Chessboard):
        if min(board.squares_x, board.squares_y) < FEWEST_SQUARES + 1:
            raise CampaignError(f"--size: a chessboard has at least {FEWEST_SQUARES + 1} squares each way")
        if (board.squares_x + board.squares_y) % 2 == 0:
            raise CampaignError(
                f"--size: a chessboard of {board.squares_x}x{board.squares_y} squares looks the same upside down, so that its "
                "corners cannot be told apart; take one number even and one odd, or a ChArUco board"
            )
    elif isinstance(board, Circles):
        if min(board.columns, board.rows) < FEWEST_CIRCLES or board.rows % 2 == 0:
            raise CampaignError(
                f"--size: a grid of {board.columns}x{board.rows} circles is too small or looks the same upside down: take three "
                "columns or more, and an odd number of rows"
            )
    elif isinstance(board, Cube):
        count = len(dictionary_of(board.dictionary).bytesList)
        if not 0 <= board.first <= count - len(FACES):
            raise CampaignError(
                f"--first: {board.dictionary} has the tags 0 to {count - 1}; six follow from {board.first}"
            )
        module = board.tag / modules(board.dictionary)
        if board.tag + 2 * module > board.side * (1 + 1e-9):
            raise CampaignError(
                f"--marker: a tag of {MM * board.tag:g} mm needs {MM * module:g} mm of white around it, which a side of "
                f"{MM * board.side:g} mm does not have: make it smaller"
            )
    else:
        dictionary_of(board.dictionary)


def marks(board: Board | Chessboard | Circles | Cube) -> Marks:
    """Labels and places of all marks that a camera can measure on a board."""
    if isinstance(board, Cube):
        flat = board.tag * UNIT_CORNERS
        names: list[str] = []
        corners = []
        for k, (x, y, _) in enumerate(FACES):
            names += tag_names(board.first + k)
            middle = board.side / 2 * np.cross(x, y)
            corners.append(middle + flat @ np.array([x, y], dtype=float))
        return Marks(tuple(names), np.concatenate(corners))
    places = flat_places(board)
    return Marks(tuple(f"c{k}" for k in range(len(places))), places)


def flat_places(board: Board | Chessboard | Circles) -> np.ndarray:
    """Places of the marks of a flat board, row by row from the upper left, shape (M, 3), [m]."""
    if isinstance(board, Board | Chessboard):
        i, j = np.meshgrid(np.arange(1, board.squares_x), np.arange(1, board.squares_y))
        x, y = i * board.square, -j * board.square
    else:
        i, j = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
        x, y = (2 * i + j % 2) * board.half, -j * board.half
    places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return places - (places.min(axis=0) + places.max(axis=0)) / 2


def modules(dictionary: str) -> int:
    """Modules along a marker's side: its bits and the black border."""
    return int(dictionary_of(dictionary).markerSize) + 2


def marker_ink(dictionary: str, number: int, side: float) -> list[np.ndarray]:
    """The black of a marker around its middle, as loops of shape (K, 2): outlines turn left, the edges of holes right.

    Its bitmap is OpenCV's own, one pixel for a module. Loops, since rectangles side by side would show seams.
    """
    n = modules(dictionary)
    bits = cv2.aruco.generateImageMarker(dictionary_of(dictionary), number, n) == 0
    black = np.pad(bits[::-1].T, 1)  # [x, y] with y up, and white around
    return [side * ((loop - 1) / n - 0.5) for loop in _outlines(black)]


def _outlines(black: np.ndarray) -> list[np.ndarray]:
    """Walk around the black cells of a grid [x, y], which has a white rim, black to the left."""
    steps: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for x, y in np.argwhere(black).tolist():
        for dx, dy, start in ((0, -1, (x, y)), (1, 0, (x + 1, y)), (0, 1, (x + 1, y + 1)), (-1, 0, (x, y + 1))):
            if not black[x + dx, y + dy]:
                steps.setdefault(start, []).append((start[0] - dy, start[1] + dx))
    loops = []
    while steps:
        corner = next(iter(steps))
        loop = []
        while corner in steps:
            ends = steps[corner]
            loop.append(corner)
            end = ends.pop()
            if not ends:
                del steps[corner]
            corner = end
        points = np.array(loop, dtype=float)
        turns = np.any(np.roll(points, -1, axis=0) - points != points - np.roll(points, 1, axis=0), axis=1)
        loops.append(points[turns])
    return loops


def drawing(board: Board | Chessboard | Circles | Cube) -> Sheet:
    """The drawing of a board, without a margin."""
    if isinstance(board, Cube):
        return _net(board)
    if isinstance(board, Circles):
        places = flat_places(board)[:, :2]
        radius = CIRCLE * np.sqrt(2) * board.half / 2
        corner = places.min(axis=0) - radius
        discs = np.column_stack([places - corner, np.full(len(places), radius)])
        width, height = MM * (places.max(axis=0) + radius - corner)
        return Sheet((float(width), float(height)), (), MM * discs)
    size = np.array([board.squares_x, board.squares_y]) * board.square
    i, j = np.meshgrid(np.arange(board.squares_x), np.arange(board.squares_y))
    middles = np.column_stack([(i.ravel() + 0.5) * board.square, size[1] - (j.ravel() + 0.5) * board.square])
    black = (i.ravel() + j.ravel()) % 2 == 0
    ink = [[middle + board.square * UNIT_CORNERS[::-1]] for middle in middles[black]]
    if isinstance(board, Board):
        for number, middle in enumerate(middles[~black]):  # OpenCV puts its markers into the white squares, row by row
            ink.append([middle + loop for loop in marker_ink(board.dictionary, number, board.marker)])
    width, height = MM * size
    return Sheet((float(width), float(height)), [[MM * loop for loop in loops] for loops in ink])


def _net(cube: Cube) -> Sheet:
    """A cube unfolded: tags, fold lines, cut lines, and seven tabs for the seven edges to be glued."""
    side, tab = MM * cube.side, MM * cube.side * TAB
    middles = side * (np.array([place for _, _, place in FACES]) + [1.5, 1.5]) + tab * np.array([0, 1])
    ink = []
    for k, middle in enumerate(middles):
        ink.append([middle + loop for loop in marker_ink(cube.dictionary, cube.first + k, MM * cube.tag)])
    folds, cuts = [], []
    for face, middle in enumerate(middles):
        for direction in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            out = np.array(direction, dtype=float)
            along = np.array([-out[1], out[0]])
            ends = middle + side / 2 * out + side / 2 * np.outer([-1, 1], along)
            opposite = any(np.allclose(middle + side * out, other) for other in middles)
            if (face, direction) in _TABS:
                outer = ends + tab * out + tab * np.outer([1, -1], along)
                cuts.append(np.array([ends[0], outer[0], outer[1], ends[1]]))
            elif not opposite:
                cuts.append(ends)
            if (opposite and sum(direction) > 0) or (face, direction) in _TABS:  # once, though two faces have it
                folds.append(ends)
    return Sheet((4 * side + tab, 3 * side + 2 * tab), ink, cuts=cuts, folds=np.array(folds))


def square_strip(indexes: Sequence[int]) -> Sheet:
    """Doty's calibration squares in a strip, the first at its lower end, from the same polygons that the simulator renders.

    Args:
        indexes: Of the squares, from below upwards.
    """
    middles = strip_placements(len(indexes))[:, :2, 3] + SQUARE_SIDE / 2
    paper, ink = [], []
    for index, middle in zip(indexes, middles, strict=True):
        outline = paper_corners() + middle
        paper.append(MM * np.concatenate([outline, outline[:1]]))
        black = np.concatenate([fiducial_corners(), index_corners(index)])[:, ::-1]
        ink += [[MM * (corners + middle)] for corners in black]
    return Sheet((MM * SQUARE_SIDE, MM * SQUARE_SIDE * len(indexes)), ink, cuts=paper)
