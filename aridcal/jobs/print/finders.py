"""Marks of printed boards in an image: which are seen, and where to a fraction of a pixel.

What is found is checked before it counts: the marks must lie in the image as on the declared board, neither mirrored nor
blurred. Otherwise the image is refused, with the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from aridcal.jobs.head1992.charuco import MIN_CORNERS, Board
from aridcal.jobs.head1992.matching import NotMeasured, spans_plane
from aridcal.jobs.print.patterns import (
    CIRCLE,
    AnyBoard,
    Chessboard,
    Circles,
    Tags,
    dictionary_of,
    flat_places,
    modules,
    tag_names,
)
from aridcal.jobs.print.planes import BentPlane, bent_plane, centre_of_area, homography, local, mapped
from aridcal.jobs.print.profiles import CONTRAST, blurs, profiles, refined_quad, side_lines

# Markers of a board lie within so many sides of a square of where the others tell: lenses bend by less, a wrong size by more.
MISPLACED = 0.5

# Blur, in sides of a module, a square or radii of a circle, beyond which edges of one reach the next.
BLURRED_MODULE, BLURRED_TAG, BLURRED_SQUARE, BLURRED_CIRCLE = 0.25, 0.15, 0.1, 0.25

# [px] of a module, below which the sides of a tag cannot be seen apart from its bits.
SMALLEST_MODULE = 3.0

# Markers of a board that tell how it lies.
FEWEST_MARKERS = 2

# Markers that are found in the mirrored image only: fewer may be chance.
FEWEST_MIRRORED = 3

MIRRORED = "the markers are mirrored: switch off the mirror image of the camera's program, or print the board anew"

# Radius around a circle's centre within which its light is weighed, in its radii, and share of its contrast that is noise.
AROUND, DARK_ENOUGH = 1.6, 0.05

# Corners of a circle's outline, [rad]: so many that the centre of its area is exact to 1e-4 px.
ROUND = np.linspace(0, 2 * np.pi, 64, endpoint=False)

# Half the window in which a corner of a chessboard is sought, in sides of a square: a ChArUco board's markers begin near it.
WINDOW, WINDOW_BESIDE_MARKERS = 0.3, 0.85

# Squares of white around a mark that are looked at for its blur, as a share of their distance.
BESIDE = 0.3

# How OpenCV looks for a grid of circles: by neighbours, then by clusters.
WAYS = cv2.CALIB_CB_ASYMMETRIC_GRID, cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING

# Area of a blob, [px], and as a share of the image.
SMALLEST_BLOB, LARGEST_BLOB = 20, 0.05


@dataclass(frozen=True)
class Found:
    """Marks in an image.

    Attributes:
        names: Their labels.
        pixels: Where, shape (M, 2), [px]; the middle of the first pixel is (0, 0).
        places: In the board's frame, or in that of each tag, shape (M, 3), [m].
        group: Marks of one number lie on one plane whose places are known together: all of a board, four of a tag; shape (M,).
    """

    names: tuple[str, ...]
    pixels: np.ndarray
    places: np.ndarray
    group: np.ndarray


def find(image: np.ndarray, board: AnyBoard) -> Found:
    """Find the marks of a board.

    Args:
        image: Grey levels, uint8, shape (height, width).
        board: What to look for.

    Raises:
        NotMeasured: it is not there, or not as it should be; the message says why.
    """
    if isinstance(board, Tags):
        return _find_tags(image, board)
    if isinstance(board, Board):
        return _find_charuco(image, board)
    return _find_grid(image, board)


def detected(image: np.ndarray, dictionary: str) -> tuple[np.ndarray, np.ndarray]:
    """All markers of a dictionary in an image: their numbers (M,) and their corners, clockwise, (M, 4, 2), [px]."""
    detector = cv2.aruco.ArucoDetector(dictionary_of(dictionary))
    quads, numbers, _ = detector.detectMarkers(image)
    if numbers is None or not len(numbers):
        return np.zeros(0, int), np.zeros((0, 4, 2))
    return np.asarray(numbers).ravel(), np.array(quads, dtype=float).reshape(-1, 4, 2)


def _seen(image: np.ndarray, dictionary: str) -> tuple[np.ndarray, np.ndarray]:
    """Markers in an image that is not mirrored.

    Raises:
        NotMeasured: there are none, or more in the mirrored image.
    """
    numbers, quads = detected(image, dictionary)
    if len(numbers) < FEWEST_MIRRORED:
        mirrored, _ = detected(np.ascontiguousarray(image[:, ::-1]), dictionary)
        if len(mirrored) >= max(FEWEST_MIRRORED, 2 * len(numbers)) or (len(mirrored) and not len(numbers)):
            raise NotMeasured(MIRRORED)
    if not len(numbers):
        raise NotMeasured(f"no marker of {dictionary} is seen")
    return numbers, quads


def _find_tags(image: np.ndarray, board: Tags) -> Found:
    numbers, quads = _seen(image, board.dictionary)
    labels, times = np.unique(numbers, return_counts=True)
    if np.any(times > 1):
        twice = labels[times > 1][0]
        raise NotMeasured(f"tag {twice} is seen twice: cover one, or print each number once")
    n = modules(board.dictionary)
    names: list[str] = []
    pixels, why = [], ""
    for number, quad in sorted(zip(numbers.tolist(), quads, strict=True), key=lambda pair: pair[0]):
        module = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min() / n
        if module < SMALLEST_MODULE:
            why = f"tag {number} is too small: {module:.1f} px for each of its modules, {SMALLEST_MODULE:g} are needed"
            continue
        refined = refined_quad(image, quad, n)
        if refined is None or np.abs(refined[0] - quad).max() > module:
            why = f"the sides of tag {number} are not clear: is white left around it?"
        elif refined[1] > BLURRED_TAG * module:
            why = f"tag {number} is blurred, by {refined[1]:.1f} px"
        else:
            names += tag_names(number)
            pixels.append(refined[0])
    if not pixels:
        raise NotMeasured(why)
    flat = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])
    return Found(
        tuple(names), np.concatenate(pixels), np.tile(flat, (len(pixels), 1)), np.repeat(np.arange(len(pixels)), 4)
    )


def _find_charuco(image: np.ndarray, board: Board) -> Found:
    numbers, quads = _seen(image, board.dictionary)
    drawn = board.opencv()
    count = len(drawn.getIds())
    if np.all(numbers >= count):
        raise NotMeasured(
            f"the markers {numbers.min()} to {numbers.max()} are none of this board's, which has 0 to {count - 1}"
        )
    side = np.median(np.linalg.norm(np.roll(quads, -1, axis=1) - quads, axis=2))
    if np.sum(numbers < count) < FEWEST_MARKERS:
        raise NotMeasured(f"only {np.sum(numbers < count)} markers of the board are seen: {FEWEST_MARKERS} are needed")
    off = misplaced(numbers, quads, board)
    if off > MISPLACED:
        raise NotMeasured(
            f"the markers do not lie as on a board of {board.squares_x}x{board.squares_y} squares, by {off:.1f} squares: "
            "check `--size`"
        )
    corners, labels, _, _ = cv2.aruco.CharucoDetector(drawn).detectBoard(image)
    if labels is None or len(labels) < MIN_CORNERS:
        seen = 0 if labels is None else len(labels)
        raise NotMeasured(f"only {seen} corners of the board are seen: {MIN_CORNERS} are needed")
    labels, pixels = np.asarray(labels).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2)
    places = flat_places(board)[labels]
    free = WINDOW_BESIDE_MARKERS * (board.square / board.marker - 1) / 2  # of a marker's side, as it is seen
    pixels = _refined(image, pixels, free * float(side))
    if not spans_plane(places):
        raise NotMeasured("the corners that are seen lie on one line")
    n = modules(board.dictionary)
    starts, ends = (np.concatenate(lines) for lines in zip(*(side_lines(quad, n) for quad in quads), strict=True))
    _refuse_blur(image, starts.reshape(-1, 2), ends.reshape(-1, 2), BLURRED_MODULE * float(side) / n)
    return Found(tuple(f"c{k}" for k in labels), pixels, places, np.zeros(len(labels), int))


def misplaced(numbers: np.ndarray, quads: np.ndarray, board: Board) -> float:
    """How far markers lie from where the others and the board put them, RMS in sides of a square; infinite of too few.

    Args:
        numbers: Of the markers, shape (M,).
        quads: Their corners, shape (M, 4, 2), [px].
        board: That they should be of.
    """
    drawn = board.opencv()
    own = numbers < len(drawn.getIds())
    if own.sum() < FEWEST_MARKERS:
        return np.inf
    corners = np.asarray(drawn.getObjPoints(), dtype=float)[numbers[own], :, :2] / board.square
    # From pixels to squares, so that a fit that maps all to one place is a bad one.
    _, off = homography(quads[own].reshape(-1, 2), corners.reshape(-1, 2))
    return off


def _find_grid(image: np.ndarray, board: Chessboard | Circles) -> Found:
    """The inner corners of a chessboard, or the circles of a grid: all of them, or the image is refused."""
    places = flat_places(board)
    if isinstance(board, Chessboard):
        rows, columns = board.squares_y - 1, board.squares_x - 1
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        seen, pixels = cv2.findChessboardCornersSB(image, (columns, rows), flags=flags)
        what = f"no chessboard of {board.squares_x}x{board.squares_y} squares"
    else:
        rows, columns = board.rows, board.columns
        seen, pixels = find_circles(image, (columns, rows))
        what = f"no grid of {columns}x{rows} circles"
    if not seen or pixels is None or len(pixels) != len(places):
        raise NotMeasured(f"{what} is seen whole")
    grid = np.asarray(pixels, dtype=float).reshape(rows, columns, 2)
    pixels = _turned(image, grid, board)
    if isinstance(board, Circles):
        pixels = _circle_centres(image, pixels, board)
    else:
        seen_grid = pixels.reshape(rows, columns, 2)
        _refuse_blurred_board(image, seen_grid)
        sides = [np.linalg.norm(np.diff(seen_grid, axis=axis), axis=2).min() for axis in (0, 1)]
        pixels = _refined(image, pixels, WINDOW * float(min(sides)))
    return Found(tuple(f"c{k}" for k in range(len(places))), pixels, places, np.zeros(len(places), int))


def _refined(image: np.ndarray, pixels: np.ndarray, window: float) -> np.ndarray:
    """Where the edges around each corner meet (OpenCV's cornerSubPix), within half a window [px] to each side."""
    half = max(2, int(window))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    start = pixels.astype(np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(image, start, (half, half), (-1, -1), stop)
    return np.asarray(refined, dtype=float).reshape(-1, 2)


def find_circles(
    image: np.ndarray, size: tuple[int, int], ways: Sequence[int] = WAYS
) -> tuple[bool, np.ndarray | None]:
    """OpenCV's asymmetric grid of dark circles, found in one of some ways."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea, parameters.maxArea = SMALLEST_BLOB, LARGEST_BLOB * image.size
    parameters.minDistBetweenBlobs = 2
    detector = cv2.SimpleBlobDetector.create(parameters)
    for way in ways:
        seen, pixels = cv2.findCirclesGrid(image, size, flags=way, blobDetector=detector)
        if seen:
            return True, pixels
    return False, None


def _turned(image: np.ndarray, grid: np.ndarray, board: Chessboard | Circles) -> np.ndarray:
    """Name the marks as they are printed: OpenCV may begin at any corner.

    Four ways to begin keep rows and columns. Two of them are mirrored. Of the other two one fits: a grid's rows alternate, and a
    chessboard's upper left square is black.

    Args:
        image: Grey levels.
        grid: Marks as OpenCV names them, shape (rows, columns, 2), [px].
        board: That they are of.

    Returns:
        The marks in the order of the board's, shape (M, 2).
    """
    places = flat_places(board)[:, :2]
    ways = []
    for turned in (grid, grid[::-1, ::-1], grid[::-1], grid[:, ::-1]):
        pixels = turned.reshape(-1, 2)
        H, off = homography(places, pixels)
        if H is None or np.linalg.det(local(H, np.zeros(2))) > 0:  # y up to v down turns the sense round
            continue
        wrong = 0.0
        if isinstance(board, Chessboard):
            steps = board.square * np.array([[-0.5, 0.5], [0.5, 0.5]])
            black, white = mapped(H, places[0] + steps)
            wrong = _grey(image, black) - _grey(image, white)
        ways.append((wrong if isinstance(board, Chessboard) else off, pixels))
    if not ways:
        raise NotMeasured("the marks do not lie as on the board")
    return min(ways, key=lambda way: way[0])[1]


def _circle_centres(image: np.ndarray, pixels: np.ndarray, board: Circles) -> np.ndarray:
    """Images of the circles' centres: the centre of light of each, less what perspective and lens shift it by.

    The centre of the image's area is not the image of the circle's centre: perspective makes the part larger that is nearer,
    and a lens that bends lines changes sizes across the circle, too.

    Raises:
        NotMeasured: circles are blurred.
    """
    places = flat_places(board)[:, :2]
    radius = CIRCLE * np.sqrt(2) * board.half / 2
    height, width = image.shape
    plane = bent_plane(places, pixels, (width, height))
    around = radius * np.column_stack([np.cos(ROUND), np.sin(ROUND)])
    rims = np.array([plane.pixels(place + around) for place in places])
    shifts = centre_of_area(rims) - plane.pixels(places)
    sizes = np.linalg.norm(rims - pixels[:, None], axis=2).mean(axis=1)
    light = [
        _centre_of_light(image, plane, place, pixel, radius, int(np.ceil(3 * AROUND * size)))
        for place, pixel, size in zip(places, pixels, sizes, strict=True)
    ]
    directions = 2 * radius * np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    ends = np.concatenate([plane.pixels(places + direction) for direction in directions])
    starts = np.tile(plane.pixels(places), (len(directions), 1))
    size = float(np.median(np.linalg.norm(ends - starts, axis=1))) / 2
    _refuse_blur(image, starts, ends, BLURRED_CIRCLE * size)
    return np.array(light) - shifts


def _centre_of_light(
    image: np.ndarray, plane: BentPlane, place: np.ndarray, pixel: np.ndarray, radius: float, reach: int
) -> np.ndarray:
    """Centre of what is dark of a disc on a plane, [px].

    Args:
        image: Grey levels.
        plane: As it is seen.
        place: Of the disc's centre on it.
        pixel: Near which it is seen.
        radius: Of the disc.
        reach: Half the side of the window that holds all around it, [px].

    Raises:
        NotMeasured: the disc is too small, or ink and paper look alike.
    """
    height, width = image.shape
    u, v = np.round(pixel).astype(int)
    left, right = max(u - reach, 0), min(u + reach + 1, width)
    upper, lower = max(v - reach, 0), min(v + reach + 1, height)
    uv = np.stack(np.meshgrid(np.arange(left, right), np.arange(upper, lower)), axis=-1).reshape(-1, 2).astype(float)
    away = np.linalg.norm(plane.places(uv) - place, axis=1) / radius
    near, rim, inside = away < AROUND, (away > 0.9 * AROUND) & (away < 1.15 * AROUND), away < 0.5
    grey = image[upper:lower, left:right].ravel().astype(float)
    if rim.sum() < 8 or not inside.any():
        raise NotMeasured("the circles are too small")
    paper, ink = np.median(grey[rim]), np.median(grey[inside])
    if paper - ink < CONTRAST:
        raise NotMeasured("the circles are too faint: light the board better")
    share = np.clip((paper - grey) / (paper - ink), 0, 1)
    weight = np.where(near & (share > DARK_ENOUGH), share, 0.0)
    return np.asarray(weight @ uv / weight.sum())


def _refuse_blurred_board(image: np.ndarray, grid: np.ndarray) -> None:
    """Look across the edges between neighbouring corners, shape (rows, columns, 2), [px]."""
    starts, ends = [], []
    for lines in (grid, np.swapaxes(grid, 0, 1)):
        middles = (lines[:, 1:] + lines[:, :-1]) / 2
        along = lines[:, 1:] - lines[:, :-1]
        across = BESIDE * np.stack([along[..., 1], -along[..., 0]], axis=-1)
        starts.append((middles - across).reshape(-1, 2))
        ends.append((middles + across).reshape(-1, 2))
    first, last = np.concatenate(starts), np.concatenate(ends)
    square = float(np.median(np.linalg.norm(last - first, axis=1))) / (2 * BESIDE)
    _refuse_blur(image, first, last, BLURRED_SQUARE * square)


def _refuse_blur(image: np.ndarray, starts: np.ndarray, ends: np.ndarray, most: float) -> None:
    """Refuse an image of which one edge in ten is blurred too much: by motion those across it are.

    Args:
        image: Grey levels.
        starts: Of lines across edges, shape (n, 2), [px].
        ends: Likewise.
        most: Blur that is accepted, [px].
    """
    blur = blurs(profiles(image, starts, ends), np.linalg.norm(ends - starts, axis=1))
    blur = blur[np.isfinite(blur)]
    worst = float(np.percentile(blur, 90)) if len(blur) else np.inf
    if worst > most:
        raise NotMeasured(f"the image is blurred, by {worst:.1f} px: hold the arm still, focus, or light it better")


def _grey(image: np.ndarray, place: np.ndarray) -> float:
    """Grey level at a place, 127 beyond the image."""
    u, v = np.round(place).astype(int)
    inside = 0 <= v < image.shape[0] and 0 <= u < image.shape[1]
    return float(image[v, u]) if inside else 127.0
