"""FID on rendered images: what is found, how exactly, and what is refused."""

from dataclasses import replace

import cv2
import numpy as np
import pinocchio as pin
import pytest

from aridcal.engine.instruments.camera import DOTY_OPENCV, predict_pixels
from aridcal.engine.instruments.camera_sonar import predict_ranges
from aridcal.jobs.head1992.fiducials import Fiducials, find_fiducials
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.head1992.render import Glare, ImageAppearance, Patch, render
from aridcal.jobs.head1992.square import INCH, layout, strip_placements
from aridcal.jobs.head1992.square_pose import Sonars, measure_pose

cv2.setNumThreads(1)
INTRINSICS = np.array([700.0, 700.0, 255.5, 255.5, 0, 0, 0, 0, 0])
CORNERS = 2 * INCH * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
STRIP = dict(enumerate(strip_placements(5)))
AROUND, ALONE = layout(STRIP, 2), layout({2: STRIP[2]}, 2)


def pose(x_in=0.0, y_in=0.0, z=0.25, tilt=(0.0, 0.0), turn=0.0) -> np.ndarray:
    """Square's centre (x, y) inches off the axis in the square's frame."""
    T = np.eye(4)
    T[:3, :3] = DOTY_OPENCV @ pin.exp3(np.array([*tilt, 0.0])) @ pin.exp3(np.array([0, 0, turn]))
    T[:3, 3] = [0, 0, z] - T[:3, :3] @ (INCH * np.array([x_in, y_in, 0]))
    return T


PLAIN = ImageAppearance()


def look(T, scene=PLAIN, seed=0, squares=STRIP, intrinsics=INTRINSICS, size=512) -> tuple[np.ndarray, Sonars]:
    rng = np.random.default_rng(seed)
    seen = {k: T @ np.linalg.inv(STRIP[2]) @ S for k, S in squares.items()}
    return render(seen, intrinsics, size, size, scene, rng), heard(T, rng)


def heard(T: np.ndarray, rng: np.random.Generator) -> Sonars:
    """What the sonars of a camera at T say."""
    h, _ = predict_ranges(T, CORNERS, "perpendicular")
    return Sonars(h + 2.5e-4 * rng.normal(size=4), CORNERS, "perpendicular", 2.5e-4)


def covered(T, fiducials, size=0.016, reflectance=0.5) -> tuple[Patch, ...]:
    """Cover fiducials of the own square."""
    at = predict_pixels(T, ALONE.centres[[k - 1 for k in fiducials]], INTRINSICS)[0]
    half = 700 / T[2, 3] * size / 2
    return tuple(Patch(p + half * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]), reflectance) for p in at)


def errors(found: Fiducials, T: np.ndarray, intrinsics=INTRINSICS) -> np.ndarray:
    return found.pixels - predict_pixels(T, found.layout.centres, intrinsics)[0]


def own(found: Fiducials) -> set[int]:
    return {int(f) for s, f in zip(found.layout.square, found.layout.fiducial, strict=True) if s == 2}


VIEWS = [
    pose(),
    pose(1.0, -1.2, 0.3, (0.15, -0.1), 0.4),
    pose(-0.5, 0.8, 0.45, (-0.1, 0.17), np.pi),
    pose(0.3, 0.3, 0.2, (0.05, 0.2), -2.0),
    pose(0, 1.5, 0.4, (0.2, 0), np.pi / 2),
]


@pytest.mark.parametrize("blur", [0.3, 1.5])
def test_centres_are_true_to_hundredths_of_a_pixel_and_their_covariance_is_honest(blur):
    scores, worst = [], 0.0
    for k, T in enumerate(VIEWS):
        image, sonars = look(T, ImageAppearance(blur=blur), seed=k)
        found = find_fiducials(image, AROUND, INTRINSICS, sonars)
        off = errors(found, T)
        worst = max(worst, np.sqrt(np.mean(off**2)))
        scores += list(np.einsum("mi,mi->m", off, np.linalg.solve(found.covariances, off[..., None])[..., 0]))
    assert worst < 0.03
    assert 0.7 < np.mean(scores) / 2 < 1.3


def test_sigmas_are_honest_in_large_and_quiet_images_too():
    """Where the pixels' noise is next to nothing, what the edge model is said to be wrong by is most of a sigma."""
    size = 768
    intrinsics = np.array([1050.0, 1050.0, (size - 1) / 2, (size - 1) / 2, 0, 0, 0, 0, 0])
    of_centres = []
    for k, T in enumerate(VIEWS[1:4]):
        image, sonars = look(T, ImageAppearance(noise=0.1), seed=21 + k, intrinsics=intrinsics, size=size)
        found = find_fiducials(image, AROUND, intrinsics, sonars)
        off = errors(found, T, intrinsics)
        of_centres += list(np.einsum("mi,mi->m", off, np.linalg.solve(found.covariances, off[..., None])[..., 0]))
    assert 0.5 < np.mean(of_centres) / 2 < 1.4  # of some forty centres: sigma 0.15


def test_pose_is_true_to_microns_and_its_covariance_is_honest():
    scores = []
    for seed in range(2):  # 60 numbers: sigma of the mean 0.18
        for k, T in enumerate(VIEWS):
            image, sonars = look(T, seed=10 * seed + k)
            found = find_fiducials(image, ALONE, INTRINSICS, sonars)
            p = measure_pose(
                found.layout.centres, found.pixels, found.covariances, sonars, INTRINSICS, found.T_camera_square
            )
            e = pin.log6(pin.SE3(np.linalg.inv(p.T_camera_square) @ T)).vector
            scores.append(e @ np.linalg.solve(p.covariance, e))
            assert np.linalg.norm(e[:2]) < 10e-6 * T[2, 3] / 0.15 and abs(e[5]) < 0.3e-3
    assert 0.6 < np.mean(scores) / 6 < 1.4


def test_neighbours_are_told_apart_and_used():
    T = pose(0.2, 1.3, 0.4)
    image, sonars = look(T)
    found = find_fiducials(image, AROUND, INTRINSICS, sonars)
    assert own(found) == {1, 2, 3, 4, 5, 6} and {1, 2, 3} <= set(found.layout.square)
    assert np.max(np.abs(errors(found, T))) < 0.05
    assert set(find_fiducials(image, ALONE, INTRINSICS, sonars).layout.square) == {2}


def test_a_tilted_neighbour_is_used_at_its_own_place():
    squares = dict(STRIP)
    squares[3] = STRIP[3] @ pin.exp6(np.array([0, 0, -0.004, 0.08, 0, 0])).homogeneous
    T = pose(0, 0.8, 0.35, (0.1, 0.05))
    image, sonars = look(T, squares=squares)
    found = find_fiducials(image, layout(squares, 2), INTRINSICS, sonars)
    assert 3 in found.layout.square and np.max(np.abs(errors(found, T))) < 0.05


def test_a_bent_lens_is_no_obstacle():
    bent = INTRINSICS + [0, 0, 0, 0, -0.25, 0.1, 0.001, -0.001, 0]
    for k, T in enumerate(VIEWS[1:3]):
        image, sonars = look(T, seed=k, intrinsics=bent)
        found = find_fiducials(image, AROUND, bent, sonars)
        assert np.sqrt(np.mean(errors(found, T, bent) ** 2)) < 0.02


def test_an_undeclared_bend_of_the_lens_drops_no_fiducials():
    bent = INTRINSICS + [0, 0, 0, 0, -0.02, 0, 0, 0, 0]
    T = VIEWS[1]
    image, sonars = look(T, intrinsics=bent)
    straight = find_fiducials(look(T)[0], AROUND, INTRINSICS, sonars)
    found = find_fiducials(image, AROUND, INTRINSICS, sonars)
    assert len(found.pixels) >= len(straight.pixels) - 1
    assert np.sqrt(np.mean(errors(found, T, bent) ** 2)) < 0.02  # where they are seen, not where they should be


@pytest.mark.parametrize("turn", [np.pi / 2, np.pi])
def test_the_corner_marker_tells_upside_down(turn):
    T = pose(0.3, -0.2, 0.3, turn=turn)
    image, sonars = look(T)
    assert np.max(np.abs(errors(find_fiducials(image, ALONE, INTRINSICS, sonars), T))) < 0.1


def test_white_on_black_is_measured_too():
    image, sonars = look(VIEWS[1], ImageAppearance(paper=0.1, ink=0.8))
    assert np.max(np.abs(errors(find_fiducials(image, AROUND, INTRINSICS, sonars), VIEWS[1]))) < 0.05


def test_uneven_light_glare_dirt_and_wrong_pixels_do_not_matter():
    T = VIEWS[1]
    rng = np.random.default_rng(3)
    spots = zip(rng.uniform(20, 490, (40, 2)), rng.random(40), strict=True)
    dirt = [Patch(c + 4 * np.array([[-1, 1], [1, 1], [1, -1]]), grey) for c, grey in spots]
    scene = ImageAppearance(light=(0.3, -0.25), glares=[Glare(200, 300, 80, 0.3)], patches=dirt, wrong_pixels=0.003)
    image, sonars = look(T, scene)
    found = find_fiducials(image, AROUND, INTRINSICS, sonars)
    p = measure_pose(found.layout.centres, found.pixels, found.covariances, sonars, INTRINSICS, found.T_camera_square)
    e = pin.log6(pin.SE3(np.linalg.inv(p.T_camera_square) @ T)).vector
    assert np.all(np.abs(e) < 5 * np.sqrt(np.diag(p.covariance)))


def test_light_that_changes_across_the_image_moves_no_fiducial():
    """Contrast changes with the light, by most where the fiducials are white on black, as here."""
    scores = []
    for k, T in enumerate(VIEWS):
        image, sonars = look(T, ImageAppearance(paper=0.06, ink=0.85, light=(0.25, -0.2), blur=1.5), seed=k)
        found = find_fiducials(image, AROUND, INTRINSICS, sonars)
        common = np.linalg.inv(found.covariances).sum(axis=0)  # of a shift of all of them
        shift = np.linalg.solve(common, np.einsum("mij,mj->i", np.linalg.inv(found.covariances), errors(found, T)))
        scores.append(shift @ common @ shift)
    assert np.mean(scores) / 2 < 2.5  # chi-square of 10: less likely than 1 in 150


def test_paper_brighter_than_the_camera_can_show_biases_nothing():
    scores = []
    for k, T in enumerate(VIEWS[:3]):
        image, sonars = look(T, ImageAppearance(paper=0.9, light=(0.3, -0.25), blur=1.3, noise=1.0), seed=k)
        assert np.mean(image == 255) > 0.02
        found = find_fiducials(image, AROUND, INTRINSICS, sonars)
        off = errors(found, T)
        scores += list(np.einsum("mi,mi->m", off, np.linalg.solve(found.covariances, off[..., None])[..., 0]))
    assert np.mean(scores) / 2 < 1.3


@pytest.mark.parametrize("hidden", [(4,), (3, 4, 6)])
def test_covered_fiducials_are_left_out(hidden):
    T = pose(0.2, -0.3, 0.3, (0.1, 0.1), 0.5)
    image, sonars = look(T, ImageAppearance(patches=covered(T, hidden)))
    found = find_fiducials(image, ALONE, INTRINSICS, sonars)
    assert own(found) == {1, 2, 3, 4, 5, 6} - set(hidden)
    assert np.max(np.abs(errors(found, T))) < 0.05


def test_partial_view_of_the_reports_figure_5_5_is_enough():
    # p3, p4, p6 of one square and p1, p2 of the next.
    T = pose(-1.1, -1.3, 0.16)
    image, sonars = look(T)
    found = find_fiducials(image, AROUND, INTRINSICS, sonars)
    assert {3, 4, 6} <= own(found) and np.max(np.abs(errors(found, T))) < 0.1


def test_without_the_corner_marker_bare_paper_where_it_would_be_upside_down_decides():
    T = pose(0.1, 0.1, 0.3)
    image, sonars = look(T, ImageAppearance(patches=covered(T, [1])), squares={2: STRIP[2]})
    found = find_fiducials(image, ALONE, INTRINSICS, sonars)
    assert own(found) == {2, 3, 4, 5, 6} and np.max(np.abs(errors(found, T))) < 0.1


def test_a_neighbours_centre_leads_to_the_own_square_and_not_to_one_turned_by_a_right_angle():
    # Own centre hidden; the four perimeter fiducials of the square beside fit a square turned by 90 degrees about it.
    T = pose(1.292, -1.354, 0.3628, (0.188, -0.045), -1.524)
    image, sonars = look(T, ImageAppearance(patches=covered(T, [4])))
    found = find_fiducials(image, AROUND, INTRINSICS, sonars)
    assert own(found) == {1, 2, 3, 5, 6} and np.max(np.abs(errors(found, T))) < 0.1


def test_perimeter_fiducials_alone_do_not_tell_how_the_square_is_turned():
    T = pose(0, 0, 0.3)
    image, sonars = look(T, ImageAppearance(patches=covered(T, [1, 4])), squares={2: STRIP[2]})
    assert "turn of the square is ambiguous" in refusal(image, sonars)


def test_area_of_a_fiducials_image_is_that_of_equations_section_4():
    # f^2 xi A / Z^3: -21 to +25 % across the square at 10 degrees and 4 in.
    z = 4 * INCH
    lens = np.array([512.0, 512, 255.5, 255.5, 0, 0, 0, 0, 0])
    share = []
    for tilt in ((np.radians(10), 0), (0, np.radians(10))):
        T = pose(z=z, tilt=tilt)
        tiny = ALONE.centres[:, None] + 0.01 * (ALONE.corners - ALONE.centres[:, None])
        corners, _, _ = predict_pixels(T, tiny, lens)
        a, b = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
        area = 1e4 * 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        depth = (ALONE.centres @ T[:3, :3].T + T[:3, 3])[:, 2]
        xi = -T[:3, 2] @ T[:3, 3]
        assert np.allclose(area, 512**2 * xi * np.prod(ALONE.sizes, axis=1) / depth**3, rtol=1e-3)
        share.append(area / (512**2 * np.prod(ALONE.sizes, axis=1) / z**2) - 1)
    assert np.isclose(np.min(share), -0.21, atol=0.01) and np.isclose(np.max(share), 0.25, atol=0.01)


def refusal(image, sonars, marks=ALONE) -> str:
    with pytest.raises(NotMeasured) as caught:
        find_fiducials(image, marks, INTRINSICS, sonars)
    return str(caught.value)


def test_a_square_that_may_be_upside_down_is_refused():
    T = pose(0, 0, 0.3)
    both = np.array([[-1.75, 1.75, 0], [1.75, -1.75, 0]]) * INCH
    at = predict_pixels(T, both, INTRINSICS)[0]
    hide = [Patch(p + 25 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]), 0.4) for p in at]
    image, sonars = look(T, ImageAppearance(patches=hide), squares={2: STRIP[2]})
    assert "upside down" in refusal(image, sonars)


@pytest.mark.parametrize("left", [(3,), (2, 4), (2, 4, 6), (3, 4, 5)])
def test_too_few_fiducials_or_all_on_one_line_are_refused(left):
    T = pose(0, 0, 0.3)
    hide = covered(T, {1, 2, 3, 4, 5, 6} - set(left), reflectance=0.8)
    image, sonars = look(T, ImageAppearance(patches=hide), squares={2: STRIP[2]})
    assert "square" in refusal(image, sonars)


def test_two_squares_equally_near_the_axis_are_refused():
    image, sonars = look(pose(0, 2.0, 0.3))
    refusal(image, sonars, AROUND)


def test_the_square_beside_is_not_taken_for_one_that_is_alone_in_the_table():
    T = pose(0, 1.7, 0.3)
    image, sonars = look(T)
    assert np.max(np.abs(errors(find_fiducials(image, ALONE, INTRINSICS, sonars), T))) < 0.1


@pytest.mark.parametrize("kind", ["black", "noise", "chessboard"])
def test_an_image_without_a_square_is_refused(kind):
    rng = np.random.default_rng(5)
    side = int(0.25 * INCH * 700 / 0.25)
    board = np.kron(np.indices((30, 30)).sum(axis=0) % 2, np.ones((side, side)))[:512, :512]
    image = {
        "black": np.zeros((512, 512)),
        "noise": rng.integers(0, 256, (512, 512)),
        "chessboard": 30 + 170 * board,
    }[kind].astype(np.uint8)
    assert refusal(image, heard(pose(), rng), AROUND)


def test_what_is_measured_does_not_depend_on_what_the_sonars_get_wrong_by_some_per_cent():
    T = VIEWS[1]
    image, sonars = look(T)
    off = replace(sonars, readings=sonars.readings * 1.03 + [0.004, 0, 0, -0.003])
    pixels = [find_fiducials(image, AROUND, INTRINSICS, s).pixels for s in (sonars, off)]
    assert pixels[0].shape == pixels[1].shape and np.max(np.abs(pixels[0] - pixels[1])) < 0.01
