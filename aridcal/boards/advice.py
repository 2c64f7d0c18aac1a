"""What might be in images in which the declared board is not found: another dictionary, another size, another kind of board."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from aridcal.boards.finders import MISPLACED, detected, find_circles, misplaced
from aridcal.boards.patterns import dictionaries, dictionary_of
from aridcal.head.charuco import Board

# Images that are looked at, and markers of a dictionary that are no chance.
LOOKED_AT, NO_CHANCE = 3, 2

# Squares of a ChArUco board that are tried, and columns and rows of grids of circles.
SQUARES, COLUMNS, ROWS = range(3, 17), range(3, 7), range(5, 15, 2)

# Markers from which the size of a ChArUco board can be told.
ENOUGH_MARKERS = 4


def advice(images: Sequence[np.ndarray]) -> str:
    """Say which board is in the images, as options of the command; nothing if none is recognised.

    Args:
        images: Grey levels, some of those in which the declared board was not found.
    """
    for image in images[:LOOKED_AT]:
        found = _markers(image) or _chessboard(image) or _circles(image)
        if found:
            return found
    return ""


def _markers(image: np.ndarray) -> str:
    """The smallest dictionary that has most of the markers, and whether they are those of a ChArUco board."""
    best: tuple[int, int, str] | None = None
    for name in dictionaries():
        numbers, _ = detected(image, name)
        rank = len(np.unique(numbers)), -len(dictionary_of(name).bytesList), name
        if rank[0] >= NO_CHANCE and (best is None or rank[:2] > best[:2]):
            best = rank
    if best is None:
        return ""
    name = best[2]
    numbers, quads = detected(image, name)
    tags = f"{best[0]} markers of {name} are there"
    size = charuco_size(numbers, quads, name)
    if size is not None:
        return f"{tags}, as on a ChArUco board: try `--board charuco --size {size[0]}x{size[1]} --dictionary {name}`"
    kind = "apriltag" if "APRILTAG" in name else "aruco"
    return f"{tags}: try `--board {kind} --dictionary {name}`, or `--board charuco` with the size of your board"


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
    return size if off < MISPLACED else None


def _chessboard(image: np.ndarray) -> str:
    """OpenCV grows a board from 3 x 3 corners as far as it goes."""
    seen, _, meta = cv2.findChessboardCornersSBWithMeta(
        image, (3, 3), cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not seen:
        return ""
    rows, columns = meta.shape[:2]
    return f"a chessboard is there: try `--board chessboard --size {columns + 1}x{rows + 1}`"


def _circles(image: np.ndarray) -> str:
    sizes = sorted(((c, r) for c in COLUMNS for r in ROWS), key=lambda size: -size[0] * size[1])
    for size in sizes:
        if find_circles(image, size)[0]:
            return f"a grid of circles is there: try `--board circles --size {size[0]}x{size[1]}`"
    return ""
