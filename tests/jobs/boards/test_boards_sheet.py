"""Sheets to print: true to scale in SVG and PDF, the same geometry in both, and boards that OpenCV knows."""

import re

import cv2
import numpy as np
import pytest
from lxml import etree
from photographs import covered, outlines, printed
from shapely.geometry import Polygon
from shapely.ops import unary_union

from aridcal.jobs.boards.options import ALL_BOARDS, board_of
from aridcal.jobs.boards.patterns import FACES, Chessboard, Cube, drawing, flat_places, marks, square_strip
from aridcal.jobs.boards.sheet import MM, MM_PER_POINT, on_paper, pdf, svg
from aridcal.jobs.head1992.charuco import Board, corner_places
from aridcal.jobs.head1992.square import fiducial_corners, index_corners

BOARDS = {what: board_of(what, options) for what, options in ALL_BOARDS.items()}
SHEETS = {what: on_paper(drawing(board), what) for what, board in BOARDS.items()}
SHEETS["square"] = on_paper(square_strip([7]), "square")


def of_pdf(document: bytes) -> tuple[list[list[np.ndarray]], np.ndarray, np.ndarray]:
    """Filled paths of straight lines, filled paths of curves as (x, y, radius), size of the page; from its middle, [mm]."""
    page = document.decode("latin-1")
    size = np.array([float(x) for x in re.search(r"MediaBox \[(.*?)\]", page)[1].split()])[2:] * MM_PER_POINT
    paths, discs = [], []
    for line in page.splitlines():
        if line.endswith("h f") and " c" in line:
            points = np.array(re.findall(r"([-\d.]+) ([-\d.]+)", line), float) * MM_PER_POINT - size / 2
            on_circle = points[::3]
            centre = (on_circle.min(axis=0) + on_circle.max(axis=0)) / 2
            discs.append([*centre, np.linalg.norm(on_circle - centre, axis=1).mean()])
        elif line.endswith("h f"):
            loops = [re.findall(r"([-\d.]+) ([-\d.]+) [ml]", loop) for loop in line.split(" h")[:-1]]
            paths.append([np.array(loop, float) * MM_PER_POINT - size / 2 for loop in loops])
    return paths, np.array(discs).reshape(-1, 3), size


def painted(loops: list[list[np.ndarray]], discs: np.ndarray, size, resolution: float) -> np.ndarray:
    """A page as grey levels; so many pixels per millimetre."""
    polygons = [(p * [1, -1] + np.array(size) / 2) * resolution - 0.5 for p in outlines(loops, discs)]
    page = covered(polygons, (round(size[0] * resolution), round(size[1] * resolution)))
    return np.round(255 * (1 - page)).astype(np.uint8)


@pytest.mark.parametrize("what", SHEETS)
def test_svg_and_pdf_have_the_same_geometry_to_a_hundredth_of_a_millimetre(what):
    loops, discs, size = printed(svg(SHEETS[what]))
    pdf_loops, pdf_discs, pdf_size = of_pdf(pdf(SHEETS[what]))
    assert np.allclose(size, pdf_size, atol=0.01)
    assert [len(group) for group in loops] == [len(group) for group in pdf_loops]
    for group, other in zip(loops, pdf_loops, strict=True):
        for a, b in zip(group, other, strict=True):
            assert np.allclose(a, b, atol=0.01)
    assert np.allclose(discs, pdf_discs, atol=0.01)


@pytest.mark.parametrize("what", SHEETS)
def test_both_rulers_are_a_hundred_millimetres_long(what):
    """The longest and thinnest bars of the sheet."""
    loops, _, _ = printed(svg(SHEETS[what]))
    extents = np.array([np.ptp(group[0], axis=0) for group in loops if len(group) == 1])
    thin = extents[np.min(extents, axis=1) < 0.3]
    assert np.isclose(sorted(thin[:, 0])[-1], 100, atol=0.01) and np.isclose(sorted(thin[:, 1])[-1], 100, atol=0.01)


@pytest.mark.parametrize("what", ["charuco", "chessboard", "circles", "cube"])
def test_all_fits_a_sheet_of_a4_inside_of_what_printers_reach(what):
    loops, discs, size = printed(svg(SHEETS[what]))
    assert sorted(size) == [210, 297]
    points = np.concatenate([loop for group in loops for loop in group] + [discs[:, :2]])
    assert np.all(np.abs(points) < np.array(size) / 2 - 5)
    for x, y, text in SHEETS[
        what
    ].texts:  # Helvetica's letters are up to 0.21 of their height below the line, 0.6 wide on average
        assert x > 4.2 and y - 0.21 * 3 > 4.2 and x + 0.6 * 3 * len(text) < size[0] - 4.2 and y + 3 < size[1] - 4.2, (
            text
        )


def test_opencv_finds_the_charuco_board_on_the_painted_page_where_the_markers_table_says():
    board = BOARDS["charuco"]
    loops, discs, size = of_pdf(pdf(SHEETS["charuco"]))
    page = painted(loops, discs, size, 4)
    corners, labels, _, numbers = cv2.aruco.CharucoDetector(board.opencv()).detectBoard(page)
    assert len(labels) == 24 and len(numbers) == 17
    # Some versions of OpenCV leave a board that is seen straight on half a pixel off, for want of this step.
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    corners = cv2.cornerSubPix(page, corners, (8, 8), (-1, -1), stop)
    places = marks(board).places[labels.ravel()] * MM
    expected = (places[:, :2] * [1, -1] + np.array(size) / 2) * 4 - 0.5
    assert np.abs(corners.reshape(-1, 2) - expected).max() < 0.2  # 0.05 mm: a pixel is 0.25 mm


def test_places_of_a_charuco_boards_corners_are_those_of_the_measuring_head():
    board = BOARDS["charuco"]
    assert np.allclose(flat_places(board), corner_places(board), atol=1e-7)  # OpenCV has single precision


def test_opencv_finds_the_chessboard_on_the_painted_page():
    loops, discs, size = of_pdf(pdf(SHEETS["chessboard"]))
    seen, corners = cv2.findChessboardCornersSB(painted(loops, discs, size, 4), (7, 4), flags=cv2.CALIB_CB_ACCURACY)
    assert seen
    expected = (flat_places(BOARDS["chessboard"])[:, :2] * MM * [1, -1] + np.array(size) / 2) * 4 - 0.5
    corners = corners.reshape(-1, 2)  # OpenCV may begin at either end
    assert min(np.abs(corners - expected).max(), np.abs(corners[::-1] - expected).max()) < 0.2


def test_opencv_finds_the_circles_on_the_painted_page():
    loops, discs, size = of_pdf(pdf(SHEETS["circles"]))
    page = painted(loops, discs, size, 3)
    seen, centres = cv2.findCirclesGrid(page, (4, 11), flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
    assert seen
    expected = (flat_places(BOARDS["circles"])[:, :2] * MM * [1, -1] + np.array(size) / 2) * 3 - 0.5
    assert np.linalg.norm(centres.reshape(-1, 1, 2) - expected, axis=2).min(axis=1).max() < 0.3


def test_opencv_finds_the_six_tags_of_the_net_in_its_own_size():
    loops, discs, size = of_pdf(pdf(SHEETS["cube"]))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    quads, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(painted(loops, discs, size, 4))
    assert sorted(numbers.ravel()) == [0, 1, 2, 3, 4, 5]
    sides = np.linalg.norm(np.diff(np.array(quads)[:, 0], axis=1, append=np.array(quads)[:, 0, :1]), axis=2)
    assert np.allclose(sides, 40 * 4, atol=2)


def folded(cube: Cube) -> np.ndarray:
    """Second road: corners of the tags after folding the net by right angles, face upon face, shape (6, 4, 3)."""
    half = cube.tag / 2
    flat = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    s = cube.side / 2

    def about(axis: int, sign: int) -> np.ndarray:
        return cv2.Rodrigues(sign * np.pi / 2 * np.eye(3)[axis])[0]

    def hung(direction: np.ndarray, turn: np.ndarray, points: np.ndarray) -> np.ndarray:
        """A face that lies beside another, hinged on their common edge."""
        return (points + s * direction) @ turn.T + s * direction

    right, up = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    beside = hung(right, about(1, 1), flat)
    back = hung(right, about(1, 1), hung(right, about(1, 1), flat))
    left, upper, lower = hung(-right, about(1, -1), flat), hung(up, about(0, -1), flat), hung(-up, about(0, 1), flat)
    return np.array([flat, beside, back, left, upper, lower]) + [0, 0, s]


def test_places_of_the_cubes_tags_are_those_after_folding():
    cube = BOARDS["cube"]
    assert np.allclose(marks(cube).places.reshape(6, 4, 3), folded(cube), atol=1e-12)
    assert len(FACES) == 6 and marks(cube).names[4:8] == ("tag1_1", "tag1_2", "tag1_3", "tag1_4")


def test_the_net_has_seven_tabs_five_folds_between_faces_and_seven_free_edges():
    sheet = drawing(BOARDS["cube"])
    assert sorted(len(cut) for cut in sheet.cuts) == [2] * 7 + [4] * 7
    middles = {tuple(np.round(fold.mean(axis=0), 6)) for fold in sheet.folds}
    assert len(middles) == 12  # the cube's edges: five in the net, seven glued
    assert len(sheet.folds) == 12  # dashes over dashes are no dashes


def test_a_markers_ink_is_opencvs_bitmap():
    board = Board(5, 4, 0.04, 0.032, "DICT_6X6_250")  # 20 pixels a module
    loops, _, _ = printed(svg(drawing(board)))
    expected = board.opencv().generateImage((1000, 800), marginSize=0, borderBits=1)
    own = painted(loops, np.zeros((0, 3)), (200, 160), 5)
    assert np.mean(np.abs(own.astype(int) - expected) > 128) < 0.004  # edges only


def test_square_is_printed_from_the_polygons_that_the_simulator_renders():
    loops, _, _ = printed(svg(square_strip([7])))
    expected = np.concatenate([fiducial_corners(), index_corners(7)]) * MM
    drawn = [Polygon(group[0]) for group in loops]
    assert np.isclose(
        unary_union(drawn).symmetric_difference(unary_union([Polygon(c) for c in expected])).area, 0, atol=1e-2
    )


def test_strip_is_2844_8_mm_long_and_its_first_square_is_the_lowest():
    sheet = square_strip(range(28))
    assert np.allclose(sheet.size, [101.6, 2844.8])
    lowest = [group for group in sheet.ink if group[0][:, 1].mean() < 101.6]
    assert np.allclose(np.concatenate(lowest), np.concatenate(square_strip([0]).ink))


def test_pdf_is_read_by_its_own_cross_reference_table():
    document = pdf(SHEETS["charuco"])
    start = int(re.search(rb"startxref\n(\d+)", document)[1])
    assert document[start:].startswith(b"xref")
    for number, offset in enumerate(re.findall(rb"(\d{10}) 00000 n", document), 1):
        assert document[int(offset) :].startswith(b"%d 0 obj" % number)
    length = int(re.search(rb"/Length (\d+)", document)[1])
    stream = document.index(b"stream\n") + 7
    assert document[stream + length :].startswith(b"\nendstream")


def test_svg_is_well_formed_and_says_what_it_is():
    root = etree.fromstring(svg(on_paper(drawing(Chessboard(6, 5, 0.02)), "a title (1)")).encode())
    assert "a title (1)" in [text.text for text in root.findall(".//{*}text")]
    assert b"(a title \\(1\\))" in pdf(on_paper(drawing(Chessboard(6, 5, 0.02)), "a title (1)"))
