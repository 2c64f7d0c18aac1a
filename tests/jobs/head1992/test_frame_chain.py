"""The chain of frames from the Orbiter to a calibration square and back (Doty 1992, sections 3.1, 5.3, 8), in all conventions."""

import cv2
import numpy as np
import pinocchio as pin
import pytest
from heads import ARID, OPTICS, START

from aridcal.engine.instruments.camera import DOTY_OPENCV, on_plane
from aridcal.engine.instruments.camera_sonar import HeadShot, packed, reduced, unpacked
from aridcal.engine.model.model import Model
from aridcal.jobs.head1992.doty1992 import ORBITER_TO_BASE, pose
from aridcal.jobs.head1992.sonar import fit_plane, ranges
from aridcal.jobs.head1992.square import FIDUCIAL_CENTRES
from aridcal.jobs.head1992.square_pose import doty_axes

K = np.array([[700.0, 0, 255.5], [0, 700.0, 255.5], [0, 0, 1]])
POINTS = np.column_stack([FIDUCIAL_CENTRES, np.zeros(6)])
FLIP = pin.SE3(DOTY_OPENCV, np.zeros(3))  # Doty's camera frame <-> OpenCV's
ORB_M_0 = pin.SE3(ORBITER_TO_BASE.T, np.array([1.5, -0.2, 0.7]))
LINKS = np.array(  # d theta beta a alpha
    [
        [0.002, 1e-3, 4e-3, 0.3, 1e-3],
        [0, 2e-3, -3e-3, 1.981, 2e-3],
        [0, -1e-3, 2e-3, 1.979, -3e-3],
        [0, 0, 1e-3, 0, 4e-3],
    ]
)
Q = np.array([5.0, 0.5, 2.2, -0.8])
M4_CAM_CV = pin.SE3(pin.rpy.rpyToMatrix(0.01, np.pi / 2 - 0.02, 0.03), np.array([0.1, 0.002, -0.001]))


def se3(T: np.ndarray) -> pin.SE3:
    return pin.SE3(T[:3, :3], T[:3, 3])


T_0_4 = se3(pose(LINKS, Q[None])[0])
CAM_M_CAL_CV = pin.SE3(DOTY_OPENCV @ pin.rpy.rpyToMatrix(0.08, -0.11, 0.4), np.array([0.01, -0.02, 0.3]))
ORB_M_CAL = ORB_M_0 * T_0_4 * M4_CAM_CV * CAM_M_CAL_CV


def shot(T: pin.SE3) -> tuple[np.ndarray, np.ndarray]:
    """Pixels by OpenCV and ranges by Doty's own plane, of a square at T in OpenCV's camera frame."""
    turn = cv2.Rodrigues(T.rotation)[0]
    pixels = cv2.projectPoints(POINTS, turn, T.translation, K, np.zeros(5))[0][:, 0]
    n = DOTY_OPENCV @ T.rotation[:, 2]
    return pixels, ranges(n, float(-n @ (DOTY_OPENCV @ T.translation)), START.positions, "perpendicular")


def assert_same(a: pin.SE3, b: pin.SE3, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(a.homogeneous, b.homogeneous, atol=atol)


def test_the_squares_pose_in_the_orbiter_is_the_same_through_either_camera_frame():
    through_report = ORB_M_0 * T_0_4 * (M4_CAM_CV * FLIP) * (FLIP * CAM_M_CAL_CV)  # (7-35b)
    assert_same(through_report, ORB_M_CAL)
    in_base = ORB_M_0.inverse() * ORB_M_CAL  # (5.3): 0_M_cal
    assert_same(in_base, T_0_4 * M4_CAM_CV * CAM_M_CAL_CV)
    np.testing.assert_allclose(in_base.rotation, ORBITER_TO_BASE @ ORB_M_CAL.rotation, atol=1e-12)


def test_the_end_frame_comes_back_from_an_image_and_ranges_by_the_reports_own_steps():
    pixels, h = shot(CAM_M_CAL_CV)
    plane = fit_plane(h, START.positions, "perpendicular")
    places = on_plane(pixels, START.intrinsics, plane.normal, plane.distance)  # (7-28), (7-29), Doty's frame
    axes = doty_axes(*(places[k] for k in (1, 2, 4, 5)))  # (7-33), (7-34)
    cam_M_cal = pin.SE3(axes, places[3])  # (7-35a)
    assert_same(cam_M_cal, FLIP * CAM_M_CAL_CV)
    found = ORB_M_0.inverse() * ORB_M_CAL * cam_M_cal.inverse() * (M4_CAM_CV * FLIP).inverse()  # (7-35c)
    assert_same(found, T_0_4)


def test_the_end_frame_comes_back_from_the_least_squares_on_fiducials_and_ranges():
    pixels, h = shot(CAM_M_CAL_CV)
    near = CAM_M_CAL_CV * pin.exp6(np.array([3e-3, -2e-3, 4e-3, 0.03, 0.02, -0.05]))
    seen = HeadShot(POINTS, pixels, np.tile(1e-4 * np.eye(2), (6, 1, 1)), h, ORB_M_CAL.homogeneous, near.homogeneous)
    found = reduced(unpacked(packed([seen], START), 4), START)
    camera = pin.SE3(found.rotation[0], found.position[0])
    assert_same(ORB_M_0.inverse() * camera * M4_CAM_CV.inverse(), T_0_4, 1e-8)


def test_the_axes_of_section_5_3_turn_the_end_frame_away():
    cam_M_cal = FLIP * CAM_M_CAL_CV
    exchanged = pin.SE3(cam_M_cal.rotation @ np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]]), cam_M_cal.translation)
    wrong = ORB_M_0.inverse() * ORB_M_CAL * exchanged.inverse() * (M4_CAM_CV * FLIP).inverse()
    assert np.linalg.norm(pin.log3(wrong.rotation.T @ T_0_4.rotation)) == pytest.approx(np.pi)


def test_the_nominal_urdf_is_the_reports_chain():
    nominal = np.array([[0, 0, 0, 0.3, 0], [0, 0, 0, 1.98, 0], [0, 0, 0, 1.98, 0], [0, 0, 0, 0, 0.0]])
    model = Model(ARID, ())
    R, p = model.poses(np.zeros(0), model.rows(Q[None]))
    assert_same(pin.SE3(R[0], p[0]), se3(pose(nominal, Q[None])[0]))


def test_squares_of_the_shipped_strip_face_the_arm_and_follow_each_other_along_their_y():
    squares = np.array([OPTICS.squares[k] for k in range(28)])
    in_base = np.array([ORBITER_TO_BASE @ T[:3, :3] for T in squares])
    np.testing.assert_allclose(in_base[:, :, 0], np.tile(in_base[0, :, 0], (28, 1)), atol=1e-8)
    np.testing.assert_allclose(np.abs(in_base[0, :, 0]), [0, 0, 1], atol=1e-8)  # x along the rail
    steps = np.diff(squares[:, :3, 3], axis=0)
    assert np.all(np.einsum("ni,ni->n", steps, squares[:-1, :3, 1]) > 0.999 * np.linalg.norm(steps, axis=1))
    hub = ORBITER_TO_BASE.T @ [0.3, 0.0, 2.0]  # joint 2 of the nominal arm
    assert np.all(np.einsum("ni,ni->n", hub - squares[:, :3, 3], squares[:, :3, 2]) > 0.5)
