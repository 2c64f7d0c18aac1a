"""Marks of printed boards in an image: which are seen, and where to a fraction of a pixel.

What is found is checked before it counts: the marks must lie in the image as on the declared board, neither mirrored nor
blurred. Otherwise the image is refused, with the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from aridcal.jobs.boards.bent_planes import BentPlane, bent_plane, centre_of_area, homography, local, mapped
from aridcal.jobs.boards.patterns import (
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
from aridcal.jobs.boards.profiles import LEAST_EDGE_CONTRAST, blurs, profiles, refined_quad, side_lines
from aridcal.jobs.head1992.charuco import MIN_CORNERS, Board
from aridcal.jobs.head1992.matching import NotMeasured, spans_plane

# Markers of a board lie within so many sides of a square of where the others tell: lenses bend by less, a wrong size by more.
MOST_MISPLACED = 0.5

# Blur, in sides of a module, a square or radii of a circle, beyond which edges of one reach the next.
BLURRED_MODULE, BLURRED_TAG, BLURRED_SQUARE, BLURRED_CIRCLE = 0.25, 0.15, 0.1, 0.25

# [px] of a module, below which the sides of a tag cannot be seen apart from its bits.
SMALLEST_MODULE = 3.0

# Fewest markers of a board that fix its pose.
FEWEST_FOUND_MARKERS = 2

# Fewest markers in the mirrored image alone that say the image is mirrored: less may be chance.
FEWEST_MIRRORED = 3

MIRRORED = "the markers are mirrored: switch off the mirror image of the camera's program, or print the board anew"

# Radius around a circle's centre within which its light is weighed, in its radii, and share of its contrast that is noise.
AROUND, DARK_ENOUGH = 1.6, 0.05

# Corners of a circle's outline, [rad]: so many that the centre of its area is exact to 1e-4 px.
CIRCLE_ANGLES = np.linspace(0, 2 * np.pi, 64, endpoint=False)

# Half the window in which a corner of a chessboard is sought, in sides of a square: a ChArUco board's markers begin near it.
WINDOW, WINDOW_BESIDE_MARKERS = 0.3, 0.85

# Distance from an edge to either side at which its blur is looked for, as a share of the distance of two corners.
BLUR_SEARCH_SHARE = 0.3

# How OpenCV looks for a grid of circles: by neighbours, then by clusters.
GRID_FLAGS = cv2.CALIB_CB_ASYMMETRIC_GRID, cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING

# Area of a blob, [px], and as a share of the image.
SMALLEST_BLOB, LARGEST_BLOB = 20, 0.05


@dataclass(frozen=True)
class ImageMarks:
    """Marks in an image.

    Attributes:
        names: Their labels.
        pixels: Of the marks, shape (M, 2), [px]; the middle of the first pixel is (0, 0).
        places: In the board's frame, or in that of each tag, shape (M, 3), [m].
        group: Number of the plane that a mark lies on, shape (M,): one for all of a board, one for the four of a tag.
    """

    names: tuple[str, ...]
    pixels: np.ndarray
    places: np.ndarray
    group: np.ndarray


def find(image: np.ndarray, board: AnyBoard) -> ImageMarks:
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


def detect_markers(image: np.ndarray, dictionary: str) -> tuple[np.ndarray, np.ndarray]:
    """All markers of a dictionary in an image: their numbers (M,) and their corners, clockwise, (M, 4, 2), [px]."""
    detector = cv2.aruco.ArucoDetector(dictionary_of(dictionary))
    quads, numbers, _ = detector.detectMarkers(image)
    if numbers is None or not len(numbers):
        return np.zeros(0, int), np.zeros((0, 4, 2))
    return np.asarray(numbers).ravel(), np.array(quads, dtype=float).reshape(-1, 4, 2)


def _markers(image: np.ndarray, dictionary: str) -> tuple[np.ndarray, np.ndarray]:
    """Markers in an image that is not mirrored.

    Raises:
        NotMeasured: there are none, or more in the mirrored image.
    """
    numbers, quads = detect_markers(image, dictionary)
    if len(numbers) < FEWEST_MIRRORED:
        mirrored, _ = detect_markers(np.ascontiguousarray(image[:, ::-1]), dictionary)
        if len(mirrored) >= max(FEWEST_MIRRORED, 2 * len(numbers)) or (len(mirrored) and not len(numbers)):
            raise NotMeasured(MIRRORED)
    if not len(numbers):
        raise NotMeasured(f"no marker of {dictionary} is seen")
    return numbers, quads


def _find_tags(image: np.ndarray, board: Tags) -> ImageMarks:
    numbers, quads = _markers(image, board.dictionary)
    labels, times = np.unique(numbers, return_counts=True)
    if np.any(times > 1):
        repeated = labels[times > 1][0]
        raise NotMeasured(f"tag {repeated} is seen twice: cover one, or print each number once")
    n = modules(board.dictionary)
    names: list[str] = []
    pixels, reason = [], ""
    for number, quad in sorted(zip(numbers.tolist(), quads, strict=True), key=lambda pair: pair[0]):
        module = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min() / n
        if module < SMALLEST_MODULE:
            reason = (
                f"tag {number} is too small: {module:.1f} px for each of its modules, {SMALLEST_MODULE:g} are needed"
            )
            continue
        refined = refined_quad(image, quad, n)
        if refined is None or np.abs(refined[0] - quad).max() > module:
            reason = f"the sides of tag {number} are not clear: is white left around it?"
        elif refined[1] > BLURRED_TAG * module:
            reason = f"tag {number} is blurred, by {refined[1]:.1f} px"
        else:
            names += tag_names(number)
            pixels.append(refined[0])
    if not pixels:
        raise NotMeasured(reason)
    flat = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])
    return ImageMarks(
        tuple(names), np.concatenate(pixels), np.tile(flat, (len(pixels), 1)), np.repeat(np.arange(len(pixels)), 4)
    )


def _find_charuco(image: np.ndarray, board: Board) -> ImageMarks:
    numbers, quads = _markers(image, board.dictionary)
    charuco = board.opencv()
    count = len(charuco.getIds())
    if np.all(numbers >= count):
        raise NotMeasured(
            f"the markers {numbers.min()} to {numbers.max()} are none of this board's, which has 0 to {count - 1}"
        )
    side = np.median(np.linalg.norm(np.roll(quads, -1, axis=1) - quads, axis=2))
    if np.sum(numbers < count) < FEWEST_FOUND_MARKERS:
        raise NotMeasured(
            f"only {np.sum(numbers < count)} markers of the board are seen: {FEWEST_FOUND_MARKERS} are needed"
        )
    off = misplaced(numbers, quads, board)
    if off > MOST_MISPLACED:
        raise NotMeasured(
            f"the markers do not lie as on a board of {board.squares_x}x{board.squares_y} squares, by {off:.1f} squares: "
            "check `--size`"
        )
    corners, labels, _, _ = cv2.aruco.CharucoDetector(charuco).detectBoard(image)
    if labels is None or len(labels) < MIN_CORNERS:
        count_seen = 0 if labels is None else len(labels)
        raise NotMeasured(f"only {count_seen} corners of the board are seen: {MIN_CORNERS} are needed")
    labels, pixels = np.asarray(labels).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2)
    places = flat_places(board)[labels]
    clearance = WINDOW_BESIDE_MARKERS * (board.square / board.marker - 1) / 2  # of a marker's side, as it is seen
    pixels = _refined_corners(image, pixels, clearance * float(side))
    if not spans_plane(places):
        raise NotMeasured("the corners that are seen lie on one line")
    n = modules(board.dictionary)
    starts, ends = (np.concatenate(lines) for lines in zip(*(side_lines(quad, n) for quad in quads), strict=True))
    _refuse_blur(image, starts.reshape(-1, 2), ends.reshape(-1, 2), BLURRED_MODULE * float(side) / n)
    return ImageMarks(tuple(f"c{k}" for k in labels), pixels, places, np.zeros(len(labels), int))


def misplaced(numbers: np.ndarray, quads: np.ndarray, board: Board) -> float:
    """Distance of markers from where the others and the board put them, RMS in sides of a square; infinite of too few.

    Args:
        numbers: Of the markers, shape (M,).
        quads: Their corners, shape (M, 4, 2), [px].
        board: The board that they should be of.
    """
    charuco = board.opencv()
    of_board = numbers < len(charuco.getIds())
    if of_board.sum() < FEWEST_FOUND_MARKERS:
        return np.inf
    corners = np.asarray(charuco.getObjPoints(), dtype=float)[numbers[of_board], :, :2] / board.square
    # From pixels to squares, so that a fit that maps all to one place is a bad one.
    _, misfit = homography(quads[of_board].reshape(-1, 2), corners.reshape(-1, 2))
    return misfit


def _find_grid(image: np.ndarray, board: Chessboard | Circles) -> ImageMarks:
    """The inner corners of a chessboard, or the circles of a grid: all of them, or the image is refused."""
    places = flat_places(board)
    if isinstance(board, Chessboard):
        rows, columns = board.squares_y - 1, board.squares_x - 1
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        success, pixels = cv2.findChessboardCornersSB(image, (columns, rows), flags=flags)
        absent = f"no chessboard of {board.squares_x}x{board.squares_y} squares"
    else:
        rows, columns = board.rows, board.columns
        success, pixels = find_circles(image, (columns, rows))
        absent = f"no grid of {columns}x{rows} circles"
    if not success or pixels is None or len(pixels) != len(places):
        raise NotMeasured(f"{absent} is seen whole")
    grid = np.asarray(pixels, dtype=float).reshape(rows, columns, 2)
    pixels = _in_board_order(image, grid, board)
    if isinstance(board, Circles):
        pixels = _circle_centres(image, pixels, board)
    else:
        seen_grid = pixels.reshape(rows, columns, 2)
        _refuse_blurred_board(image, seen_grid)
        sides = [np.linalg.norm(np.diff(seen_grid, axis=axis), axis=2).min() for axis in (0, 1)]
        pixels = _refined_corners(image, pixels, WINDOW * float(min(sides)))
    return ImageMarks(tuple(f"c{k}" for k in range(len(places))), pixels, places, np.zeros(len(places), int))


def _refined_corners(image: np.ndarray, pixels: np.ndarray, window: float) -> np.ndarray:
    """Where the edges around each corner meet (OpenCV's cornerSubPix), within half a window [px] to each side."""
    half = max(2, int(window))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    start = pixels.astype(np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(image, start, (half, half), (-1, -1), stop)
    return np.asarray(refined, dtype=float).reshape(-1, 2)


def find_circles(
    image: np.ndarray, size: tuple[int, int], strategies: Sequence[int] = GRID_FLAGS
) -> tuple[bool, np.ndarray | None]:
    """OpenCV's asymmetric grid of dark circles, by the first of some flags that finds one."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea, parameters.maxArea = SMALLEST_BLOB, LARGEST_BLOB * image.size
    parameters.minDistBetweenBlobs = 2
    detector = cv2.SimpleBlobDetector.create(parameters)
    for way in strategies:
        success, pixels = cv2.findCirclesGrid(image, size, flags=way, blobDetector=detector)
        if success:
            return True, pixels
    return False, None


def _in_board_order(image: np.ndarray, grid: np.ndarray, board: Chessboard | Circles) -> np.ndarray:
    """Marks in the order in which they are printed: OpenCV may begin at any corner.

    Four ways to begin keep rows and columns. Two of them are mirrored. Of the other two one fits: a grid's rows alternate, and a
    chessboard's upper left square is black.

    Args:
        image: Grey levels.
        grid: Marks as OpenCV names them, shape (rows, columns, 2), [px].
        board: Whose marks they are.

    Returns:
        The marks in the order of the board's, shape (M, 2).
    """
    places = flat_places(board)[:, :2]
    ways = []
    for ordered in (grid, grid[::-1, ::-1], grid[::-1], grid[:, ::-1]):
        pixels = ordered.reshape(-1, 2)
        H, misfit = homography(places, pixels)
        if H is None or np.linalg.det(local(H, np.zeros(2))) > 0:  # y up to v down turns the sense round
            continue
        contrast = 0.0
        if isinstance(board, Chessboard):
            steps = board.square * np.array([[-0.5, 0.5], [0.5, 0.5]])
            black, white = mapped(H, places[0] + steps)
            contrast = _grey(image, black) - _grey(image, white)
        ways.append((contrast if isinstance(board, Chessboard) else misfit, pixels))
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
    around = radius * np.column_stack([np.cos(CIRCLE_ANGLES), np.sin(CIRCLE_ANGLES)])
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
    """Centre of a dark disc's light on a plane, [px].

    Args:
        image: Grey levels.
        plane: As the camera sees it.
        place: Of the disc's centre on the plane.
        pixel: Near the image of this centre.
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
    distance = np.linalg.norm(plane.places(uv) - place, axis=1) / radius
    near, rim, inside = distance < AROUND, (distance > 0.9 * AROUND) & (distance < 1.15 * AROUND), distance < 0.5
    grey = image[upper:lower, left:right].ravel().astype(float)
    if rim.sum() < 8 or not inside.any():
        raise NotMeasured("the circles are too small")
    paper, ink = np.median(grey[rim]), np.median(grey[inside])
    if paper - ink < LEAST_EDGE_CONTRAST:
        raise NotMeasured("the circles are too faint: light the board better")
    share = np.clip((paper - grey) / (paper - ink), 0, 1)
    weight = np.where(near & (share > DARK_ENOUGH), share, 0.0)
    return np.asarray(weight @ uv / weight.sum())


def _refuse_blurred_board(image: np.ndarray, grid: np.ndarray) -> None:
    """Refuse an image in which the edges between neighbouring corners, shape (rows, columns, 2), [px], are blurred."""
    starts, ends = [], []
    for lines in (grid, np.swapaxes(grid, 0, 1)):
        middles = (lines[:, 1:] + lines[:, :-1]) / 2
        along = lines[:, 1:] - lines[:, :-1]
        across = BLUR_SEARCH_SHARE * np.stack([along[..., 1], -along[..., 0]], axis=-1)
        starts.append((middles - across).reshape(-1, 2))
        ends.append((middles + across).reshape(-1, 2))
    first, last = np.concatenate(starts), np.concatenate(ends)
    square = float(np.median(np.linalg.norm(last - first, axis=1))) / (2 * BLUR_SEARCH_SHARE)
    _refuse_blur(image, first, last, BLURRED_SQUARE * square)


def _refuse_blur(image: np.ndarray, starts: np.ndarray, ends: np.ndarray, most: float) -> None:
    """Refuse an image of which one edge in ten is blurred too much: motion blurs the edges across it.

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
