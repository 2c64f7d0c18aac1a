"""Arm and head together: the minimum of all image points and ranges, and what no shot can tell apart."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from heads import ARID, MODEL, START, T_TIP_CAMERA, THETA, moved, poses, shots

from aridcal.head.detections import Shots
from aridcal.head.reduction import Head
from aridcal.head.sonar import predict_ranges
from aridcal.inputs.measurement_settings import Noise as NoiseSettings
from aridcal.instruments.camera import predict_pixels
from aridcal.search.arm_and_head import ArmAndHead, fit_arm_and_head
from aridcal.showing import SILENT


def calibrated(given: Shots) -> ArmAndHead:
    return fit_arm_and_head(given, ARID, (), SILENT)


def misfit(T: np.ndarray, given: Shots, head: Head) -> np.ndarray:
    """All image points and ranges less what cameras at T would see, in sigmas."""
    parts = []
    for pose, s in zip(T, given.seen, strict=True):
        seen = np.linalg.inv(pose) @ s.T_world_square
        pixels, _, _ = predict_pixels(seen, s.points, head.intrinsics)
        h, _ = predict_ranges(seen, head.positions, head.measures)
        sigma = np.sqrt(np.diagonal(s.covariances, axis1=1, axis2=2))
        parts += [((s.pixels - pixels) / sigma).ravel(), (s.ranges - (1 + head.scale) * h - head.bias) / head.std]
    return np.concatenate(parts)


def test_no_step_of_arm_and_head_makes_image_points_and_ranges_fit_better():
    more = "effects: [{kind: lens_distortion, where: camera, motion: k1}, {kind: sonar_bias, where: sonar_1}]\n"
    given, q = shots(20, moved(camera_k1=-0.02, sonar_1_bias=2e-3), more=more + "diagnosis: {enabled: false}")
    absolute = given.campaign.measurements.model_copy(update={"noise": NoiseSettings(rows="absolute")})
    given = replace(given, campaign=given.campaign.model_copy(update={"measurements": absolute}))
    both = calibrated(given)
    fit, H = both.arm.diagnosed.fit, both.choice.directions
    K, steps = len(fit.theta), np.concatenate([1e-3 * fit.std, 1e-3 * np.sqrt(np.diag(both.choice.covariance))])

    def at(x: np.ndarray) -> np.ndarray:
        T = poses(fit.model, fit.theta + x[:K], q)
        return misfit(T, given, replace(both.head, phi=both.head.phi + H @ x[K:]))

    J = np.array([(at(s * e) - at(-s * e)) / 2e-3 for s, e in zip(steps, np.eye(len(steps)), strict=True)]).T
    asked = np.linalg.lstsq(J, -at(np.zeros(len(steps))), rcond=None)[0]  # of each, in its own sigmas
    assert np.linalg.norm(J @ asked) < 0.2  # of all together
    assert np.sum(at(np.zeros(len(steps))) ** 2) / (len(J) - len(steps)) < 1.3


def test_what_the_camera_mounting_shares_with_the_last_link_and_the_base_is_named():
    given, _ = shots(20, START, more="parameters: {set: doty}\ndiagnosis: {enabled: false}")
    redundant = calibrated(given).arm.geometry.geometric.redundant
    assert {name for name in redundant if name.startswith("tip_target")} == {"tip_target.x"}  # along the rail
    assert redundant["tip_target.x"] == ("world_base.z",)
    # EQUATIONS 9.2: alpha_4, beta_4, a_4 and the offset of joint 4 are T_rx, T_ry, T_x and T_rz; the camera's z is F4's x.
    assert redundant["joint_4.alpha"] == ("tip_target.yaw",)
    assert redundant["joint_4.a"] == ("tip_target.z",)
    assert redundant["flange_fixed.pitch"][0] == "tip_target.pitch"
    assert redundant["flange_fixed.yaw"][0] == "tip_target.roll"


def test_a_mounting_that_is_off_is_found_where_it_shows():
    given, _ = shots(30, START, more="diagnosis: {enabled: false}")
    both = calibrated(given)
    fit = both.arm.geometry.geometric
    found = fit.model.tip_target[0][1]
    off = pin.log6(T_TIP_CAMERA.actInv(found)).vector
    std = np.array([dict(zip(fit.model.names, fit.std, strict=True)).get(f"tip_target.{c}", 0.0)
                    for c in ("x", "y", "z", "roll", "pitch", "yaw")])  # fmt: skip
    # Its roll and y go with joint 4's offset, its x with the base's height: those stay as head.yaml has them or share it.
    known = np.array([2, 4, 5])
    assert np.all(np.abs(off[known]) < 5 * std[known] + 1e-6)
    hint = pin.SE3(given.mount)
    assert np.linalg.norm(pin.log6(hint.actInv(T_TIP_CAMERA)).linear) > 1e-3


def test_poses_of_the_camera_are_right_within_a_few_sigma_where_the_head_is_sound():
    given, q = shots(30, START, more="diagnosis: {enabled: false}")
    both = calibrated(given)
    fit = both.arm.diagnosed.fit
    off = (poses(fit.model, fit.theta, q) - poses(MODEL, THETA, q))[:, :3, 3]
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 3e-5
    assert both.declared.geometric.theta.shape == fit.theta.shape and np.array_equal(both.head.phi, START.phi)
