"""Camera, frames and the pose of the square: EQUATIONS sections 4, 6 and 7."""

import cv2
import numpy as np
import pinocchio as pin
import pytest

from aridcal.engine.instruments.camera import DOTY_OPENCV, on_plane, predict_pixels, project, project_jacobian, rays
from aridcal.engine.instruments.camera_sonar import predict_ranges
from aridcal.jobs.head1992.sonar import doty_plane, fit_plane
from aridcal.jobs.head1992.square import FIDUCIAL_CENTRES, FIDUCIAL_SIZES, INCH
from aridcal.jobs.head1992.square_pose import (
    NO_SONARS,
    Sonars,
    doty_axes,
    fit_pose,
    kabsch,
    measure_pose,
    robust_pose,
    start_on_plane,
)

cv2.setNumThreads(1)
STRAIGHT = np.array([700.0, 700.0, 255.5, 255.5, 0, 0, 0, 0, 0])
BENT = np.array([702.0, 697.0, 250.0, 260.0, -0.2, 0.08, 0.001, -0.002, 0.05])
POINTS = np.column_stack([FIDUCIAL_CENTRES, np.zeros(6)])
GAMMA = 2 * INCH
CORNERS = GAMMA * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])


def poses(n: int, seed: int = 0, tilt: float = 0.2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    made = np.tile(np.eye(4), (n, 1, 1))
    for T in made:
        T[:3, :3] = (
            DOTY_OPENCV @ pin.exp3(np.r_[rng.uniform(-tilt, tilt, 2), 0]) @ pin.exp3(np.r_[0, 0, rng.uniform(-3, 3)])
        )
        T[:3, 3] = [*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.18, 0.45)]
    return made


def sonars(T: np.ndarray, noise: np.ndarray | float = 0.0) -> Sonars:
    h, _ = predict_ranges(T, CORNERS, "perpendicular")
    return Sonars(h + noise, CORNERS, "perpendicular", 2.5e-4)


@pytest.mark.parametrize("intrinsics", [STRAIGHT, BENT])
def test_projection_is_opencvs(intrinsics):
    points = np.random.default_rng(0).uniform([-0.1, -0.1, 0.2], [0.1, 0.1, 0.5], (50, 3))
    fx, fy, cx, cy = intrinsics[:4]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, intrinsics[4:])[0][:, 0]
    assert np.allclose(project(points, intrinsics), expected, atol=1e-9)
    assert np.allclose(rays(expected, intrinsics), points[:, :2] / points[:, 2:], atol=1e-12)


def test_projection_jacobians_match_finite_differences():
    points = np.random.default_rng(1).uniform([-0.1, -0.1, 0.2], [0.1, 0.1, 0.5], (20, 3))
    pixels, by_point, by_intrinsics = project_jacobian(points, BENT)
    assert np.allclose(pixels, project(points, BENT))
    for k in range(3):
        d = 1e-6 * np.eye(3)[k]
        assert np.allclose(
            by_point[..., k], (project(points + d, BENT) - project(points - d, BENT)) / 2e-6, rtol=1e-6, atol=1e-4
        )
    for k in range(9):
        d = 1e-5 * np.eye(9)[k]
        numeric = (project(points, BENT + d) - project(points, BENT - d)) / 2e-5
        assert np.allclose(by_intrinsics[..., k], numeric, rtol=1e-6, atol=1e-5)


def test_pixel_jacobian_by_the_squares_twist_matches_finite_differences_for_many_poses_at_once():
    T = poses(7)
    pixels, by_twist, by_intrinsics = predict_pixels(T, POINTS, BENT)
    assert pixels.shape == (7, 6, 2) and by_twist.shape == (7, 6, 2, 6) and by_intrinsics.shape == (7, 6, 2, 9)
    for k in range(6):
        step = pin.exp6(1e-6 * np.eye(6)[k]).homogeneous
        numeric = (
            predict_pixels(T @ step, POINTS, BENT)[0] - predict_pixels(T @ np.linalg.inv(step), POINTS, BENT)[0]
        ) / 2e-6
        assert np.allclose(by_twist[..., k], numeric, rtol=1e-6, atol=1e-4)


def test_report_frame_and_opencv_frame_7_25_to_7_29():
    # x' = -(u - cx), y' = +(v - cy) with f in pixels; the image is inverted, z' = f behind the lens.
    rng = np.random.default_rng(2)
    for T in poses(20):
        plane = fit_plane(sonars(T).readings, CORNERS, "perpendicular")
        local = np.array([*rng.uniform(-0.05, 0.05, 2), 0])
        p_cv = T[:3, :3] @ local + T[:3, 3]
        p = DOTY_OPENCV @ p_cv
        u, v = project(p_cv, STRAIGHT)
        image = np.array([-(u - 255.5), v - 255.5])
        assert p[2] < 0 < p_cv[2] and np.allclose(image / 700, p[:2] / p[2])  # (7-25)
        w = plane.normal / plane.distance
        assert np.isclose(w @ p, -1)  # (7-26)
        assert np.isclose(p[2], -(w[0] * p[0] + w[1] * p[1] + 1) / w[2])  # (7-27)
        assert np.allclose(-np.array([*image, 700]) / (w[:2] @ image + w[2] * 700), p)  # (7-28), (7-29)
        assert np.allclose(on_plane(np.array([u, v]), STRAIGHT, plane.normal, plane.distance), p)
        # The other choice is the same camera turned by 180 degrees about z.
        other = np.diag([-1.0, 1, -1]) @ p_cv
        assert np.allclose(other, np.diag([-1.0, -1, 1]) @ p)
        assert np.allclose(np.array([u - 255.5, -(v - 255.5)]) / 700, other[:2] / other[2])


def test_erratum_image_y_decreases_along_the_squares_y():
    T = np.diag([1.0, -1, -1, 1])
    T[2, 3] = 0.25
    p2, p6 = (project(T[:3, :3] @ POINTS[k] + T[:3, 3], STRAIGHT) for k in (1, 5))
    assert p2[1] - 255.5 < p6[1] - 255.5  # y' = v - cy at p2 (top) is below that at p6, for an upright square


def test_reference_reading_exactly_and_as_the_report_has_it():
    h = np.array([9.4, 9.8, 9.6, 9.2]) * INCH
    exact = fit_plane(h, CORNERS, "perpendicular")
    assert np.allclose(exact.normal, [0.10, -0.05, 0.993730], atol=1e-6) and np.isclose(exact.distance, 9.5 * INCH)
    pixel = np.array([150.0, 200.0])  # w = (-150, 200, 1280)
    intrinsics = np.array([1280.0, 1280, 0, 0, 0, 0, 0, 0, 0])
    p = on_plane(pixel, intrinsics, exact.normal, exact.distance) / INCH
    assert np.allclose(p, [1.142766, -1.523688, -9.751600], atol=1e-6)
    report = doty_plane(h, GAMMA)
    p = on_plane(pixel, intrinsics, report.normal, report.distance) / INCH
    assert np.allclose(p, [1.136909, -1.515878, -9.701619], atol=1e-6)
    # (7-30)..(7-32) are the same with the heights of (7-2)..(7-5) written out
    ca, cb = np.sqrt(1 - ((h[3] - h[0]) / (2 * GAMMA)) ** 2), np.sqrt(1 - ((h[2] - h[1]) / (2 * GAMMA)) ** 2)
    e = h / [ca, cb, cb, ca]
    x, y, f = -150.0, 200.0, 1280.0
    long_hand = -GAMMA * (e[0] + e[2]) * np.array([x, y, f]) / ((e[1] - e[0]) * x + (e[2] - e[1]) * y + 2 * GAMMA * f)
    assert np.allclose(long_hand / INCH, p)


def test_axes_7_33_return_the_true_frame_and_erratum_section_5_3_exchanges_them():
    R = pin.exp3(np.array([0.1, -0.07, 0.2]))
    p = {k: R @ P + [0.01, -0.005, -0.25] for k, P in enumerate(POINTS, 1)}
    assert np.allclose(doty_axes(p[2], p[3], p[5], p[6]), R)  # (7-34)
    assert np.allclose(p[4], [0.01, -0.005, -0.25])  # (7-35a)
    a, b = p[4] - p[6], p[4] - p[3]
    x, y = a / np.linalg.norm(a), b / np.linalg.norm(b)
    printed = np.column_stack([x, y, np.cross(x, y)])
    assert np.allclose(printed, R @ [[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    assert np.allclose(np.column_stack([y, x, np.cross(y, x)]), R)


def test_axes_of_noisy_points_are_not_a_rotation_and_kabsch_is_better_by_the_stated_factor():
    rng = np.random.default_rng(5)
    R, t = pin.exp3(np.array([0.1, -0.07, 0.2])), np.array([0.01, -0.005, -0.25])
    seen = POINTS @ R.T + t + 1e-4 * rng.normal(size=(3000, 6, 3))
    axes = doty_axes(*(seen[0, k] for k in (1, 2, 4, 5)))
    assert not np.allclose(axes.T @ axes, np.eye(3), atol=1e-6)
    fits = np.array([kabsch(POINTS, s) for s in seen])
    assert np.allclose(np.linalg.det(fits[:, :3, :3]), 1)
    ratio = np.sqrt(np.mean((fits[:, :3, 3] - t) ** 2) / np.mean((seen[:, 3] - t) ** 2))
    assert np.isclose(ratio, 0.41, atol=0.02)
    assert np.allclose(kabsch(POINTS, POINTS @ R.T + t)[:3], np.column_stack([R, t]))


def test_three_places_off_one_line_are_enough_and_three_image_points_are_not():
    for T in poses(10, seed=12):
        three = POINTS[[0, 4, 5]]
        pixels = predict_pixels(T, three, STRAIGHT)[0]
        plane = fit_plane(sonars(T).readings, CORNERS, "perpendicular")
        start = start_on_plane(three, pixels, plane, STRAIGHT)  # places, by the sonars
        assert np.allclose(start, T)
        assert np.allclose(
            fit_pose(three, pixels, np.tile(1e-4 * np.eye(2), (3, 1, 1)), sonars(T), STRAIGHT, start).T_camera_square, T
        )
        K = np.array([[700, 0, 255.5], [0, 700, 255.5], [0, 0, 1]])
        n, turns, shifts = cv2.solveP3P(three, pixels, K, None, cv2.SOLVEPNP_P3P)
        assert 2 <= n <= 4  # all of which show the same image
        for turn, shift in zip(turns, shifts, strict=True):
            assert np.allclose(cv2.projectPoints(three, turn, shift, K, None)[0][:, 0], pixels, atol=1e-2)


def test_tilt_of_the_reports_procedure_is_that_of_the_sonars_alone():
    T = poses(1)[0]
    noise = np.array([3e-4, -1e-4, 2e-4, 4e-4])
    plane = fit_plane(sonars(T, noise).readings, CORNERS, "perpendicular")
    pixels = predict_pixels(T, POINTS, STRAIGHT)[0]
    start = start_on_plane(POINTS, pixels, plane, STRAIGHT)
    assert np.allclose(DOTY_OPENCV @ start[:3, 2], plane.normal)
    exact = fit_plane(sonars(T).readings, CORNERS, "perpendicular")
    assert np.allclose(start_on_plane(POINTS, pixels, exact, STRAIGHT), T)


def centroid(polygon: np.ndarray) -> np.ndarray:
    """Centroid of dense outlines (N, 2)."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
    return ((a + b) * cross[:, None]).sum(axis=0) / (3 * cross.sum())


BIAS_TABLE = {  # Z [in], tilt [deg]: centre about x, about y; the others from, to [px], at f = 128 Z; worst [in]
    (4, 5): (0.232, 0.058, 0.052, 0.065, 0.0018),
    (4, 10): (0.456, 0.114, 0.092, 0.145, 0.0036),
    (10, 5): (0.093, 0.023, 0.022, 0.024, 0.0007),
    (10, 10): (0.182, 0.046, 0.042, 0.050, 0.0014),
    (20, 5): (0.046, 0.012, 0.011, 0.012, 0.0004),
    (20, 10): (0.091, 0.023, 0.022, 0.024, 0.0007),
}
INCH_PER_PIXEL = 4 / 512


def test_quantisation_is_a_fifth_of_a_millimetre():
    assert INCH_PER_PIXEL == 1 / 128 == 0.0078125 and np.isclose(INCH_PER_PIXEL * INCH, 0.198e-3, atol=0.5e-6)
    T = np.diag([1.0, -1, -1, 1])
    T[2, 3] = 10 * INCH
    lens = np.array([1280.0, 1280, 255.5, 255.5, 0, 0, 0, 0, 0])  # 512 px across 4 in at 10 in
    u = predict_pixels(T, np.array([[-2.0, 0, 0], [2, 0, 0]]) * INCH, lens)[0][:, 0]
    assert np.isclose(u[1] - u[0], 512)


@pytest.mark.parametrize(("z", "tilt"), BIAS_TABLE)
def test_centroid_of_an_image_is_not_the_image_of_the_centre(z, tilt):
    corners = FIDUCIAL_SIZES[:, None] / INCH * np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
    f = 128.0 * z
    found = {}
    for axis in (0, 1):
        R = pin.exp3(np.radians(tilt) * np.eye(3)[axis])
        bias = []
        for middle, size, outline in zip(FIDUCIAL_CENTRES / INCH, FIDUCIAL_SIZES / INCH, corners, strict=True):
            world = np.column_stack([middle + outline, np.zeros(4)]) @ R.T + [0, 0, z]
            c = R @ [*middle, 0] + [0, 0, z]
            seen = centroid(f * world[:, :2] / world[:, 2:]) - f * c[:2] / c[2]
            by_s = [f * (R[:2, j] * c[2] - c[:2] * R[2, j]) / c[2] ** 2 for j in (0, 1)]
            closed = -4 * sum(size[j] ** 2 / 12 * R[2, j] / c[2] * by_s[j] for j in (0, 1))
            assert np.allclose(seen, closed, rtol=0.02, atol=1e-3)
            bias.append(np.linalg.norm(seen))
        found[axis] = bias
    others = [b for axis in (0, 1) for k, b in enumerate(found[axis]) if k != 3]
    assert np.allclose((found[0][3], found[1][3], min(others), max(others)), BIAS_TABLE[z, tilt][:4], atol=0.00051)
    assert np.isclose(max(max(b) for b in found.values()) * INCH_PER_PIXEL, BIAS_TABLE[z, tilt][4], atol=0.000051)


def test_exact_pixels_and_ranges_give_the_exact_pose_from_a_poor_start():
    for intrinsics in (STRAIGHT, BENT):
        for T in poses(10, seed=3):
            pixels, covariances = predict_pixels(T, POINTS, intrinsics)[0], np.tile(1e-4 * np.eye(2), (6, 1, 1))
            start = T @ pin.exp6(np.array([0.01, -0.01, 0.02, 0.1, -0.1, 0.2])).homogeneous
            found = fit_pose(POINTS, pixels, covariances, sonars(T), intrinsics, start)
            assert np.allclose(found.T_camera_square, T, atol=1e-9)


def test_four_coplanar_image_points_leave_one_pose_without_any_sonar():
    for T in poses(10, seed=4):
        pixels = predict_pixels(T, POINTS[[0, 2, 4, 5]], STRAIGHT)[0]
        start = np.diag([1.0, -1, -1, 1])
        start[:3, :3] = start[:3, :3] @ pin.exp3(np.array([0, 0, np.arctan2(T[1, 0] * -1, T[0, 0])]))
        start[2, 3] = 0.3
        found = fit_pose(POINTS[[0, 2, 4, 5]], pixels, np.tile(1e-4 * np.eye(2), (4, 1, 1)), NO_SONARS, STRAIGHT, start)
        assert np.allclose(found.T_camera_square, T, atol=1e-7)


def test_covariance_of_the_pose_matches_repeated_fits():
    rng = np.random.default_rng(6)
    T = poses(1, seed=7)[0]
    pixels = predict_pixels(T, POINTS, STRAIGHT)[0]
    L = np.linalg.cholesky(np.array([[4e-4, 1e-4], [1e-4, 9e-4]]))
    covariances = np.tile(L @ L.T, (6, 1, 1))
    errors, scores = [], []
    for _ in range(400):
        s = sonars(T, 2.5e-4 * rng.normal(size=4))
        found = fit_pose(POINTS, pixels + rng.normal(size=(6, 2)) @ L.T, covariances, s, STRAIGHT, T)
        error = pin.log6(pin.SE3(np.linalg.inv(found.T_camera_square) @ T)).vector
        errors.append(error / np.sqrt(np.diag(found.covariance)))
        scores.append(error @ np.linalg.solve(found.covariance, error))
    assert np.isclose(np.mean(scores), 6, rtol=0.1)
    assert np.allclose(np.std(errors, axis=0), 1, atol=0.12)


def test_one_wrong_fiducial_is_left_out_and_a_bent_lens_drops_none():
    rng = np.random.default_rng(8)
    lens = STRAIGHT + [0, 0, 0, 0, -0.02, 0, 0, 0, 0]
    covariances = np.tile(0.005**2 * np.eye(2), (6, 1, 1))
    for T in poses(10, seed=9):
        noisy = predict_pixels(T, POINTS, STRAIGHT)[0] + 0.005 * rng.normal(size=(6, 2))
        noisy[2] += [0.4, -0.3]
        found, used = robust_pose(POINTS, noisy, covariances, sonars(T), STRAIGHT, T)
        assert used.tolist() == [True, True, False, True, True, True]
        assert np.linalg.norm(found.T_camera_square[:2, 3] - T[:2, 3]) < 3e-5
        bent = predict_pixels(T, POINTS, lens)[0] + 0.005 * rng.normal(size=(6, 2))
        assert robust_pose(POINTS, bent, covariances, sonars(T), STRAIGHT, T)[1].sum() >= 5


def test_camera_and_sonars_that_contradict_each_other_own_up_to_it():
    T = poses(1, seed=10)[0]
    pixels, covariances = predict_pixels(T, POINTS, STRAIGHT)[0], np.tile(0.005**2 * np.eye(2), (6, 1, 1))
    honest = measure_pose(POINTS, pixels, covariances, sonars(T), STRAIGHT, T)
    scaled = Sonars(sonars(T).readings * 1.01, CORNERS, "perpendicular", 2.5e-4)
    doubtful = measure_pose(POINTS, pixels, covariances, scaled, STRAIGHT, T)
    off = 0.01 * sonars(T).readings.mean()
    assert np.sqrt(honest.covariance[2, 2]) < 2e-5
    assert np.isclose(np.sqrt(doubtful.covariance[2, 2]), off, rtol=0.3)


def test_frames_of_section_8_chain_and_its_inverse():
    # 0R_orbiter is proper and takes orbiter x to base z, y to -x, z to -y (starboard).
    R = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    assert np.linalg.det(R) == 1 and np.array_equal(R @ np.eye(3), np.column_stack([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
    assert np.array_equal(R.T, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    rng = np.random.default_rng(11)
    orb_M_0, T_04, M_4cam, cam_M_cal = (pin.SE3.Random().homogeneous for _ in range(4))
    orb_M_0[:3, :3], orb_M_0[:3, 3] = R.T, rng.normal(size=3)
    orb_M_cal = orb_M_0 @ T_04 @ M_4cam @ cam_M_cal  # (7-35b)
    inverse = np.linalg.inv
    assert np.allclose(inverse(orb_M_0) @ orb_M_cal @ inverse(cam_M_cal) @ inverse(M_4cam), T_04)  # (7-35c)
    # Either camera frame gives the same chain if the mounting is written in it too.
    D = np.eye(4)
    D[:3, :3] = DOTY_OPENCV
    assert np.allclose(orb_M_0 @ T_04 @ (M_4cam @ D) @ (D @ cam_M_cal), orb_M_cal)
