"""Sonars and plane: EQUATIONS section 5, the exact relation, Doty's own, and the difference."""

import numpy as np
import pinocchio as pin
import pytest

from aridcal.engine.instruments.camera import DOTY_OPENCV
from aridcal.engine.instruments.camera_sonar import predict_ranges
from aridcal.jobs.head1992.sonar import doty_plane, fit_plane, ranges

INCH = 0.0254
GAMMA = 2 * INCH
CORNERS = GAMMA * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
PLUS = np.sqrt(2) * GAMMA * np.array([[0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]])


def tilted(n_x: float, n_y: float) -> np.ndarray:
    return np.array([n_x, n_y, np.sqrt(1 - n_x**2 - n_y**2)])


def random_planes(n: int) -> list[tuple[np.ndarray, float]]:
    rng = np.random.default_rng(1)
    return [(tilted(*rng.uniform(-0.25, 0.25, 2)), rng.uniform(0.15, 0.5)) for _ in range(n)]


def square_pose(normal: np.ndarray, distance: float, rng: np.random.Generator) -> np.ndarray:
    """A square somewhere on the plane, in OpenCV's camera frame."""
    z = DOTY_OPENCV @ normal
    x = np.cross(rng.normal(size=3), z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = -distance * z + T[:3, :2] @ rng.uniform(-0.05, 0.05, 2)
    return T


@pytest.mark.parametrize("measures", ["perpendicular", "along_axis"])
@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_exact_relation_recovers_every_plane_to_rounding(measures, offset):
    layouts = [
        CORNERS,
        PLUS,
        CORNERS + [0.01, -0.02, 0],
        CORNERS + np.array([[0, 0, 0.01], [0, 0, 0], [0, 0, 0.02], [0, 0, 0]]),
    ]
    for layout in layouts:
        positions = layout + [0, 0, offset]
        for normal, distance in random_planes(30):
            plane = fit_plane(ranges(normal, distance, positions, measures), positions, measures)
            assert np.allclose(plane.normal, normal, atol=1e-13)
            assert np.isclose(plane.distance, distance, atol=1e-13)
            assert np.allclose(plane.residual, 0, atol=1e-13)


def test_readings_are_what_the_definitions_say():
    normal, distance = tilted(0.12, -0.07), 0.25
    for s, h in zip(CORNERS, ranges(normal, distance, CORNERS, "perpendicular"), strict=True):
        foot = s - h * normal  # of the perpendicular
        below = s - [0, 0, h / normal[2]]  # the point below the sensor along z
        assert np.isclose(normal @ foot + distance, 0) and np.isclose(normal @ below + distance, 0)
    for s, h in zip(CORNERS, ranges(normal, distance, CORNERS, "along_axis"), strict=True):
        assert np.isclose(normal @ (s - [0, 0, h]) + distance, 0)


def test_closed_form_of_the_square_layout_is_the_least_squares_solution():
    h = np.array([0.24, 0.251, 0.256, 0.243])  # fits no plane
    plane = fit_plane(h, CORNERS, "perpendicular")
    assert np.isclose(plane.normal[0], (-h[0] + h[1] + h[2] - h[3]) / (4 * GAMMA))
    assert np.isclose(plane.normal[1], (-h[0] - h[1] + h[2] + h[3]) / (4 * GAMMA))
    assert np.isclose(plane.distance, h.mean())
    r = (h[0] - h[1] + h[2] - h[3]) / 4
    assert np.allclose(plane.residual, r * np.array([1, -1, 1, -1]))


def test_sonars_off_the_lens_plane_shift_the_distance_by_their_height_over_the_tilt():
    normal, distance, z_s = tilted(0.1, 0.05), 0.3, 0.04
    positions = CORNERS + [0, 0, z_s]
    h = ranges(normal, distance, positions, "perpendicular")
    intercept = np.linalg.lstsq(np.column_stack([positions[:, :2], np.ones(4)]), h, rcond=None)[0][2]
    assert np.isclose(intercept - normal[2] * z_s, distance)


def test_a_biased_sonar_passes_for_tilt_and_range():
    normal, distance, b = tilted(0.05, -0.03), 0.25, 0.002
    h = ranges(normal, distance, CORNERS, "perpendicular") + [b, 0, 0, 0]
    plane = fit_plane(h, CORNERS, "perpendicular")
    assert np.allclose(np.abs(plane.normal[:2] - normal[:2]), b / (4 * GAMMA))
    assert np.isclose(plane.distance - distance, b / 4) and np.allclose(np.abs(plane.residual), b / 4)


def test_noise_of_the_plane_is_that_of_equations_section_5():
    rng = np.random.default_rng(2)
    normal, distance, sigma = tilted(0.05, -0.03), 0.25, 0.01 * INCH
    clean = ranges(normal, distance, CORNERS, "perpendicular")
    planes = [fit_plane(clean + sigma * rng.normal(size=4), CORNERS, "perpendicular") for _ in range(4000)]
    slopes = np.std([p.normal[:2] for p in planes], axis=0)
    assert np.allclose(slopes, sigma / (2 * GAMMA), rtol=0.05) and np.allclose(slopes, 2.5e-3, rtol=0.05)
    assert np.isclose(np.std([p.distance for p in planes]), sigma / 2, rtol=0.05)


def test_corner_layout_can_not_see_a_curved_surface_and_a_plus_layout_can():
    R, h0 = 60 * INCH, 10 * INCH
    for side in (1, -1):  # convex towards the camera, concave: centre of curvature behind or in front
        corners = np.full(4, side * (np.hypot(GAMMA, R + side * h0) - R))
        plus = np.array([side * (np.hypot(y, R + side * h0) - R) for y in PLUS[:, 1]])
        plane = fit_plane(corners, CORNERS, "perpendicular")
        assert np.allclose(plane.residual, 0, atol=1e-15)
        assert np.isclose(plane.distance - h0, side * GAMMA**2 / (2 * (R + side * h0)), rtol=2e-3)
        if side == 1:
            assert np.isclose((plane.distance - h0) / INCH, 0.029, atol=5e-4)
        # Sensors on the axis of the cylinder see no change, the other two twice that of the corners: a residual.
        assert np.isclose(np.ptp(plus), 2 * abs(plane.distance - h0), rtol=2e-3)
        assert np.allclose(np.abs(fit_plane(plus, PLUS, "perpendicular").residual), np.ptp(plus) / 2, rtol=1e-6)


# Erratum: (7-2)..(7-5) are exact only for a tilt about x. Table of EQUATIONS section 5: (n_x, n_y) times sin(tilt); error of the
# normal in degrees and of the axial range in inches, then the same with d = 2 gamma put in (7-1).
DOTY_TABLE = [
    (1, 1, 1, 0.0002, -0.0015, 0.0003, -0.0023),
    (2, 1, 1, 0.0017, -0.0061, 0.0026, -0.0091),
    (5, 1, 1, 0.027, -0.038, 0.040, -0.057),
    (10, 1, 1, 0.214, -0.157, 0.317, -0.232),
    (1, 1, 0, 0.0002, -0.0015, None, None),
    (2, 1, 0, 0.0012, -0.0061, None, None),
    (5, 1, 0, 0.019, -0.038, None, None),
    (10, 1, 0, 0.149, -0.152, None, None),
    (1, 0, 1, 0, 0, None, None),
    (2, 0, 1, 0, 0, None, None),
    (5, 0, 1, 0, 0, None, None),
    (10, 0, 1, 0, 0, None, None),
]


@pytest.mark.parametrize(("tilt", "k_x", "k_y", "angle", "length", "angle_2g", "length_2g"), DOTY_TABLE)
def test_erratum_the_reports_plane_is_wrong_by_the_tabulated_amount(tilt, k_x, k_y, angle, length, angle_2g, length_2g):
    s = np.sin(np.radians(tilt))
    normal = tilted(k_x * s, k_y * s)
    h = ranges(normal, 10 * INCH * normal[2], CORNERS, "perpendicular")

    def error(plane_normal, plane_distance):
        turn = np.degrees(np.arctan2(np.linalg.norm(np.cross(plane_normal, normal)), plane_normal @ normal))
        return turn, plane_distance / plane_normal[2] / INCH - 10

    half = 0.5 * 10 ** -(4 if tilt < 5 else 3)
    assert np.allclose(error(*doty_plane(h, GAMMA)[:2]), (angle, length), atol=1.01 * half)
    exact = error(*fit_plane(h, CORNERS, "perpendicular")[:2])
    assert exact[0] < 1e-6 and abs(exact[1]) < 1e-12
    if angle_2g is not None:  # d = 2 gamma in (7-1): the sines are too small by sqrt 2
        ca, cb = (np.sqrt(1 - ((a - b) / (2 * np.sqrt(2) * GAMMA)) ** 2) for a, b in ((h[3], h[0]), (h[2], h[1])))
        e = h / [ca, cb, cb, ca]
        v = np.array([e[1] - e[0], e[2] - e[1], 2 * GAMMA]) / (GAMMA * (e[0] + e[2]))
        assert np.allclose(error(v / np.linalg.norm(v), 1 / np.linalg.norm(v)), (angle_2g, length_2g), atol=1.01 * half)


def test_erratum_the_two_angles_of_the_report_measure_the_same_tilt():
    for normal, distance in random_planes(20):
        h = ranges(normal, distance, CORNERS, "perpendicular")
        assert np.isclose(h[3] - h[0], h[2] - h[1])  # (7-1) and (7-5): alpha_c = beta_c
        assert np.isclose((h[3] - h[0]) / (2 * GAMMA), normal[1])  # with the true spacing, about x
        assert np.isclose((h[1] - h[0]) / (2 * GAMMA), normal[0])  # the tilt about y is in the readings all the same


def test_erratum_the_spacing_is_given_three_ways_and_7_1_must_be_written_differently_for_each():
    normal = tilted(0, 0.12)  # about x
    sine = normal[1]
    h = ranges(normal, 0.25, CORNERS, "perpendicular")
    adjacent, to_axis = 2 * GAMMA, np.sqrt(2) * GAMMA
    assert np.isclose((h[3] - h[0]) / adjacent, sine)  # d between adjacent sensors
    assert np.isclose((h[3] - h[0]) / (to_axis * np.sqrt(2)), sine)  # d from sensor to axis: (7-1) as printed
    assert np.isclose((h[3] - h[0]) * np.sqrt(2) / (2 * to_axis), sine)  # d between opposite sensors
    assert not np.isclose((h[3] - h[0]) / (adjacent * np.sqrt(2)), sine, rtol=0.2)  # printed (7-1), d = 2 gamma
    # Erratum: the "+" of section 4 is another layout: the same readings there would be another plane.
    assert not np.allclose(fit_plane(h, PLUS, "perpendicular").normal, normal, atol=0.01)


def test_plane_through_points_7_6_to_7_24():
    rng = np.random.default_rng(3)
    g = GAMMA
    for normal, distance in random_planes(10):
        h = ranges(normal, distance, CORNERS, "along_axis")  # heights below the sensors: the h' of Doty (1992), exactly
        p = CORNERS - np.outer(h, [0, 0, 1])
        v = normal / distance
        assert np.allclose(p @ v, -1)  # (7-6), (7-7)
        assert np.allclose(np.linalg.solve(p[:3], -np.ones(3)), v)  # (7-8)..(7-10)
        # (7-11)..(7-13); erratum: four points need four ones on the right side
        assert np.allclose(np.linalg.inv(p.T @ p) @ p.T @ -np.ones(4), v)
        eta = np.cross(p[1] - p[0], p[2] - p[0])  # (7-14), (7-15)
        xi = -p[0] @ eta  # (7-16)
        assert np.allclose(eta / xi, v)
        assert np.allclose(eta, [2 * g * (h[1] - h[0]), 2 * g * (h[2] - h[1]), 4 * g * g])  # (7-17), (7-18)
        rows = np.array([p[0], p[1] - p[0], p[2] - p[0]])
        short = np.array([p[0], p[1] - p[0], [0, 0, -h[0] - h[2]]])
        assert np.isclose(-np.linalg.det(rows), xi) and np.isclose(np.linalg.det(rows), np.linalg.det(short))  # (7-19)
        assert np.isclose(xi, 2 * g * g * (h[0] + h[2]))  # (7-20)
        v1 = np.array([h[1] - h[0], h[2] - h[1], 2 * g]) / (g * (h[0] + h[2]))  # (7-21)
        v2 = np.array([h[1] - h[0], h[3] - h[0], 2 * g]) / (g * (h[1] + h[3]))  # (7-22), (7-23)
        assert np.allclose(v1, v) and np.allclose(v2, v)
        off = h + 0.001 * rng.normal(size=4)
        v1 = np.array([off[1] - off[0], off[2] - off[1], 2 * g]) / (g * (off[0] + off[2]))
        v2 = np.array([off[1] - off[0], off[3] - off[0], 2 * g]) / (g * (off[1] + off[3]))
        assert not np.allclose(v1, v2)  # (7-24): equal only if h1 + h3 = h2 + h4
        off[3] = off[0] + off[2] - off[1]  # and then whatever the readings
        v1 = np.array([off[1] - off[0], off[2] - off[1], 2 * g]) / (g * (off[0] + off[2]))
        v2 = np.array([off[1] - off[0], off[3] - off[0], 2 * g]) / (g * (off[1] + off[3]))
        assert np.allclose(v1, v2)


def test_7_24_holds_just_when_the_sonars_agree_on_a_plane():
    for normal, distance in random_planes(10):
        h = ranges(normal, distance, CORNERS, "perpendicular")
        for fault in (0.0, 0.003):
            read = h + [fault, 0, 0, 0]
            ca, cb = (np.sqrt(1 - ((read[a] - read[b]) / (2 * GAMMA)) ** 2) for a, b in ((3, 0), (2, 1)))
            e = read / [ca, cb, cb, ca]
            r = (read[0] - read[1] + read[2] - read[3]) / 4
            assert np.isclose(e[0] + e[2], e[1] + e[3], atol=1e-12) == np.isclose(r, 0, atol=1e-12) == (fault == 0)
            assert np.isclose(ca, cb, atol=1e-12) == (fault == 0)


def test_erratum_7_11_minimises_no_distances_and_needs_four_ones():
    p = CORNERS - np.outer([0.21, 0.25, 0.26, 0.24], [0, 0, 1])  # on no plane
    v = np.linalg.inv(p.T @ p) @ p.T @ -np.ones(4)  # (7-11)..(7-13)
    with pytest.raises(ValueError, match="size"):
        np.linalg.inv(p.T @ p) @ p.T @ -np.ones(3)  # as printed
    algebraic = np.linalg.norm(1 + p @ v)
    normal = np.linalg.svd(p - p.mean(axis=0))[2][2]  # the plane with the least squares of distances
    distances = (p - p.mean(axis=0)) @ normal
    w = -normal / (p.mean(axis=0) @ normal)
    assert algebraic < np.linalg.norm(1 + p @ w) and not np.allclose(v, w, rtol=1e-3)
    assert np.linalg.norm(distances) < np.linalg.norm((1 + p @ v) / np.linalg.norm(v))


def test_erratum_points_off_one_line_are_not_enough_when_the_plane_meets_the_lens():
    A = np.array([[1.0, 0, -1], [0, 1, -1], [2, 2, -4]])  # not on one line, plane x + y + z = 0
    assert np.linalg.norm(np.cross(A[1] - A[0], A[2] - A[0])) > 0.1 and abs(np.linalg.det(A)) < 1e-12


@pytest.mark.parametrize("measures", ["perpendicular", "along_axis"])
def test_predicted_ranges_agree_with_the_plane_and_with_finite_differences(measures):
    rng = np.random.default_rng(4)
    positions = CORNERS + 0.01 * rng.normal(size=(4, 3))
    for normal, distance in random_planes(10):
        T = square_pose(normal, distance, rng)
        h, J = predict_ranges(T, positions, measures)
        assert np.allclose(h, ranges(normal, distance, positions, measures))
        step = 1e-6
        for k in range(6):
            moved = [
                predict_ranges(T @ pin.exp6(s * step * np.eye(6)[k]).homogeneous, positions, measures)[0]
                for s in (1, -1)
            ]
            assert np.allclose(J[:, k], (moved[0] - moved[1]) / (2 * step), atol=1e-9)
    many = np.array([square_pose(n, d, rng) for n, d in random_planes(5)])
    h, J = predict_ranges(many, positions, measures)
    assert h.shape == (5, 4) and J.shape == (5, 4, 6)
    assert np.allclose(h[3], predict_ranges(many[3], positions, measures)[0])


def test_readings_that_no_plane_allows_are_refused():
    with pytest.raises(ValueError, match="any plane"):
        fit_plane(np.array([0.1, 0.5, 0.5, 0.1]), CORNERS, "perpendicular")
    with pytest.raises(ValueError, match="one line"):
        fit_plane(np.full(3, 0.2), np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]]), "perpendicular")
