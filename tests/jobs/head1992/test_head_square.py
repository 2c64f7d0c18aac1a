"""The calibration square, the strip, and how they are printed and rendered (Doty 1992, sections 5.1, 5.2 and 7.4)."""

import numpy as np
import pytest
from shapely.geometry import Polygon, box

from aridcal.jobs.head1992.render import ImageAppearance, coverage, image_outlines, light_map
from aridcal.jobs.head1992.square import (
    FIDUCIAL_CENTRES,
    FIDUCIAL_SIZES,
    INCH,
    SQUARE_SIDE,
    fiducial_corners,
    index_corners,
    layout,
    paper_corners,
    strip_placements,
)

INTRINSICS = np.array([700.0, 700.0, 255.5, 255.5, 0, 0, 0, 0, 0])


def facing(z: float) -> np.ndarray:
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = z
    return T


def test_square_has_the_reports_dimensions():
    areas = [Polygon(c).area for c in fiducial_corners()]
    assert np.allclose(areas, np.array([1, 1, 1, 2, 1, 1]) / 16 * INCH**2)
    assert np.isclose(areas[3], 80.6e-6, rtol=1e-3) and np.isclose(areas[0], 40.3e-6, rtol=1e-3)
    p = dict(enumerate(FIDUCIAL_CENTRES, 1))
    assert np.allclose(p[5] - p[3], [0.0889, 0]) and np.allclose(p[2] - p[6], [0, 0.0889])
    assert np.isclose(np.linalg.norm(p[2] - p[4]), 0.04445)
    assert p[1][0] < 0 < p[1][1]  # corner marker in quadrant two
    assert FIDUCIAL_SIZES[3, 1] == 2 * FIDUCIAL_SIZES[3, 0]  # the long side runs along y
    outer = Polygon(paper_corners()).exterior.distance(Polygon(fiducial_corners()[4]))
    assert np.isclose(outer, 0.003175)


def test_strip_of_28_squares_is_112_inches_and_neighbours_are_half_an_inch_apart():
    T = strip_placements()
    assert np.isclose(28 * SQUARE_SIDE, 2.8448) and np.allclose(T[27, :3, 3], [0, 27 * SQUARE_SIDE, 0])
    around = layout(dict(enumerate(T)), square=5)
    p6 = around.centres[(around.square == 6) & (around.fiducial == 6)][0]
    p2 = around.centres[(around.square == 5) & (around.fiducial == 2)][0]
    assert np.isclose(np.linalg.norm(p6 - p2), 0.0127)
    centre = around.centres[(around.square == 6) & (around.fiducial == 4)][0]
    assert np.allclose(centre, [0, 4 * INCH, 0])
    assert np.all(around.square[:6] == 5)


def test_layout_follows_a_square_that_is_tilted_and_shifted():
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    T[:3, 3] = [0.1, 0.05, 0.02]
    around = layout({3: np.eye(4), 7: T}, square=3)
    corners = around.corners[around.square == 7]
    flat = np.concatenate([fiducial_corners(), np.zeros((6, 4, 1))], axis=2)
    assert np.allclose(corners, flat @ T[:3, :3].T + T[:3, 3])


def test_printed_index_keeps_clear_of_the_fiducials_however_the_square_is_turned():
    marks = [Polygon(c) for c in fiducial_corners()]
    for index in (0, 8, 27, 128):
        bars = [Polygon(c) for c in index_corners(index)]
        for quarter in range(4):
            R = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), quarter)
            turned = [Polygon(np.array(m.exterior.coords) @ R.T) for m in marks]
            assert min(b.distance(m) for b in bars for m in turned) > 0.004
        assert all(Polygon(paper_corners()).contains(b) for b in bars)


def test_different_indexes_print_differently():
    assert len({index_corners(k).round(6).tobytes() for k in range(30)}) == 30


def test_coverage_is_the_exact_area_of_the_polygon_in_each_pixel():
    rng = np.random.default_rng(0)
    for corners in (3, 4, 7):
        angles = 2 * np.pi * (np.arange(corners) + rng.uniform(0, 0.7, corners)) / corners
        polygon = np.array([5, 4]) + rng.uniform(3, 8, (corners, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
        exact = [
            [Polygon(polygon).intersection(box(u - 0.5, v - 0.5, u + 0.5, v + 0.5)).area for u in range(10)]
            for v in range(9)
        ]
        assert np.allclose(coverage(polygon[None], 10, 9), exact, atol=1e-12)


def test_coverage_of_a_polygon_on_pixel_borders_is_zero_or_one():
    square = np.array([[1.5, 1.5], [4.5, 1.5], [4.5, 3.5], [1.5, 3.5]])
    expected = np.zeros((6, 8))
    expected[2:4, 2:5] = 1
    assert np.array_equal(coverage(square[None], 8, 6), expected)


@pytest.mark.parametrize("blur", [0.0, 0.6, 1.5])
def test_rendered_edges_are_true_to_a_hundredth_of_a_pixel(blur):
    # The light that a mark takes away is that of its area, and its centroid that of the mark: both to sub-pixel accuracy.
    for shift in (0.0, 0.137, 0.5, 0.781):
        T = facing(0.25)
        T[0, 3] += shift / 700 * 0.25
        image = light_map({}, INTRINSICS, 512, 512, ImageAppearance(surroundings=0.8, blur=blur))
        with_marks = light_map({0: T}, INTRINSICS, 512, 512, ImageAppearance(surroundings=0.8, paper=0.8, blur=blur))
        part = (slice(215, 296), slice(215, 296))  # the centre fiducial
        dark = (image - with_marks)[part] / (255 * (0.8 - 0.12))
        corners = image_outlines(T, fiducial_corners()[3:4], INTRINSICS)[0]
        assert np.isclose(dark.sum(), Polygon(corners).area, rtol=2e-4)
        u = np.arange(215, 296)
        centre = [np.sum(dark * u) / dark.sum(), np.sum(dark * u[:, None]) / dark.sum()]
        assert np.allclose(centre, np.array(Polygon(corners).centroid.coords[0]), atol=0.003)
        light_lost = dark[40, :41].sum()  # of the left edge alone, up to the middle of the mark
        assert np.isclose(255.5 - light_lost, corners[:, 0].min(), atol=0.002)


def test_supersampled_blur_is_a_gaussian_of_the_stated_width():
    T = facing(0.25)
    scene = ImageAppearance(surroundings=0.8, paper=0.8, blur=1.2)
    row = light_map({0: T}, INTRINSICS, 512, 512, scene)[256] / 255
    dark = (0.8 - row[215:256]) / (0.8 - 0.12)
    edge = np.diff(dark)
    u = np.arange(215, 255) + 0.5
    mean = np.sum(u * edge) / edge.sum()
    assert np.isclose(
        np.sum((u - mean) ** 2 * edge) / edge.sum(), 1.2**2 + 2 / 12, rtol=0.005
    )  # the pixel's box, twice
