"""What might be in images in which the declared board is not found: another dictionary, another size, another kind of board."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from aridcal.jobs.boards.finders import GRID_FLAGS, MOST_MISPLACED, detect_markers, find_circles, misplaced
from aridcal.jobs.boards.patterns import dictionaries, dictionary_of
from aridcal.jobs.head1992.charuco import Board

# Images that are enough to look at, and markers of a dictionary that are no chance.
ENOUGH_IMAGES, NO_CHANCE = 3, 2

# Share of the images that must show the same: in some a board is cut off, or too far away.
AGREED_SHARE = 0.4

# [px] along an image: more only takes longer.
SEARCH_WIDTH = 1200

# Squares of a ChArUco board that are tried, and columns and rows of grids of circles.
SQUARES, COLUMNS, ROWS = range(3, 17), range(3, 7), range(5, 15, 2)

# Markers from which the size of a ChArUco board can be told.
ENOUGH_MARKERS = 4


@dataclass(frozen=True)
class RecognisedBoard:
    """A board in an image.

    Attributes:
        what: It is, in words.
        options: With which the command finds it.
        marks: How many of its marks are seen.
    """

    what: str
    options: str
    marks: int


def advice(images: Sequence[np.ndarray]) -> str:
    """Say which board is in the images, as options of the command; nothing if too few of them agree.

    Args:
        images: Grey levels, some of those in which the declared board was not found.
    """
    factors = [min(1.0, SEARCH_WIDTH / max(image.shape)) for image in images]
    images = [
        cv2.resize(image, None, fx=f, fy=f, interpolation=cv2.INTER_AREA)
        for image, f in zip(images, factors, strict=True)
    ]
    agreed = _agreed([_markers(image) for image in images])
    if (
        agreed is None
    ):  # the squares of a chessboard look like some circles, and circles like some squares: more marks win
        both = [_agreed([look(image) for image in images]) for look in (_chessboard, _circles)]
        agreed = max((board for board in both if board is not None), key=lambda board: board.marks, default=None)
    return f"{agreed.what}: try `{agreed.options}`" if agreed else ""


def _agreed(found: Sequence[RecognisedBoard | None]) -> RecognisedBoard | None:
    """What most of the images show; None if they are too few."""
    boards = [board for board in found if board is not None]
    votes = Counter(board.options for board in boards)
    for options, count in votes.most_common(1):
        if count >= AGREED_SHARE * len(found):
            return max((board for board in boards if board.options == options), key=lambda board: board.marks)
    return None


def _markers(image: np.ndarray) -> RecognisedBoard | None:
    """The smallest dictionary that has most of the markers, and whether they are those of a ChArUco board."""
    largest = {_family(name): name for name in sorted(dictionaries(), key=_words)}  # the smaller are its beginning
    found = {family: detect_markers(image, name) for family, name in largest.items()}
    counts = {family: len(np.unique(numbers)) for family, (numbers, _) in found.items()}
    family = max(counts, key=lambda family: counts[family])
    if counts[family] < NO_CHANCE:
        return None
    numbers, quads = found[family]
    enough = [name for name in dictionaries() if _family(name) == family and _words(name) > numbers.max()]
    name = min(enough, key=_words)
    tags = f"{counts[family]} markers of {name} are there"
    size = charuco_size(numbers, quads, name)
    if size is not None:
        options = f"--board charuco --size {size[0]}x{size[1]} --dictionary {name}"
        return RecognisedBoard(f"{tags}, as on a ChArUco board", options, counts[family])
    kind = "apriltag" if "APRILTAG" in name else "aruco"
    return RecognisedBoard(tags, f"--board {kind} --dictionary {name}", counts[family])


def _words(name: str) -> int:
    """How many markers a dictionary has."""
    return len(dictionary_of(name).bytesList)


def _family(name: str) -> str:
    """``DICT_5X5`` of ``DICT_5X5_100``."""
    return re.sub(r"_\d+$", "", name)


def charuco_size(numbers: np.ndarray, quads: np.ndarray, dictionary: str) -> tuple[int, int] | None:
    """Squares of the smallest ChArUco board on which markers would lie as they do; None if there is none.

    Args:
        numbers: Of the markers, shape (M,).
        quads: Their corners, shape (M, 4, 2), [px].
        dictionary: Theirs.
    """
    if len(numbers) < ENOUGH_MARKERS:
        return None
    most = len(dictionary_of(dictionary).bytesList)
    fits = []
    for x in SQUARES:
        y = max(3, -(-2 * (int(numbers.max()) + 1) // x))  # rows that have all these numbers
        if y not in SQUARES or x * y // 2 > most:
            continue
        y += int(x * y // 2 <= numbers.max())
        if x * y // 2 <= most and y in SQUARES:
            fits.append((misplaced(numbers, quads, Board(x, y, 1.0, 0.75, dictionary)), (x, y)))
    off, size = min(fits, default=(np.inf, (0, 0)))
    return size if off < MOST_MISPLACED else None


def _chessboard(image: np.ndarray) -> RecognisedBoard | None:
    """OpenCV grows a board from 3 x 3 corners as far as it goes."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
    seen, _, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags)
    if not seen:
        return None
    low, high = sorted(meta.shape[:2])
    return RecognisedBoard("a chessboard is there", f"--board chessboard --size {high + 1}x{low + 1}", low * high)


def _circles(image: np.ndarray) -> RecognisedBoard | None:
    sizes = sorted(((c, r) for c in COLUMNS for r in ROWS), key=lambda size: -size[0] * size[1])
    for size in sizes:
        if find_circles(image, size, GRID_FLAGS[:1])[0]:
            options = f"--board circles --size {size[0]}x{size[1]}"
            return RecognisedBoard("a grid of circles is there", options, size[0] * size[1])
    return None
