"""Arm and head together: the minimum of all image points and ranges, and what no shot can tell apart."""

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from heads import MODEL, SETTINGS, START, T_TIP_CAMERA, THETA, Shots, calibrated, moved, poses, shots

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.fit.stages import Geometry
from aridcal.engine.instruments.camera import predict_pixels, predict_ranges
from aridcal.engine.instruments.camera_sonar import Head, unpacked
from aridcal.engine.search.loop import CalibratedArm
from aridcal.jobs.calibrate.pipeline import judge_arm


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
    off = "diagnosis: {enabled: false}"
    given, q = shots(20, moved(camera_k1=-0.02, sonar_1_bias=2e-3), more=more + off, noise="absolute")
    arm, _ = calibrated(given)
    fit = arm.diagnosed.fit
    K, steps = len(fit.theta), 1e-3 * fit.std
    H = np.zeros((len(START.phi), K))
    for k in np.flatnonzero(fit.model.at_things):
        c = fit.model.coefficients[k]
        H[list(START.role.moved_by(c.where, c.component)), k] = 1.0
    assert H.sum() == 2

    def at(x: np.ndarray) -> np.ndarray:
        R, p = fit.model.poses(fit.theta + x, fit.model.rows(q, given.rows.conditions))
        T = np.tile(np.eye(4), (len(q), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = R, p
        return misfit(T, given, replace(START, phi=START.phi + H @ (fit.theta + x)))

    J = np.array([(at(s * e) - at(-s * e)) / 2e-3 for s, e in zip(steps, np.eye(K), strict=True)]).T
    asked = np.linalg.lstsq(J, -at(np.zeros(K)), rcond=None)[0]  # of each, in its own sigmas
    assert np.linalg.norm(J @ asked) < 0.2  # of all together
    assert np.sum(at(np.zeros(K)) ** 2) / (len(J) - K) < 1.3


def test_what_the_camera_mounting_shares_with_the_last_link_and_the_base_is_named():
    given, _ = shots(20, START, more="parameters: {set: doty}\ndiagnosis: {enabled: false}")
    redundant = calibrated(given)[1].geometric.redundant
    assert {name for name in redundant if name.startswith("tip_target")} == {"tip_target.x"}  # along the rail
    assert redundant["tip_target.x"] == ("world_base.z",)
    # EQUATIONS 9.2: alpha_4, beta_4, a_4 and the offset of joint 4 are T_rx, T_ry, T_x and T_rz; the camera's z is F4's x.
    assert redundant["joint_4.alpha"] == ("tip_target.yaw",)
    assert redundant["joint_4.a"] == ("tip_target.z",)
    assert redundant["flange_fixed.pitch"][0] == "tip_target.pitch"
    assert redundant["flange_fixed.yaw"][0] == "tip_target.roll"


@cache
def sound() -> tuple[CalibratedArm, Geometry, np.ndarray]:
    """Shots of a head that is as declared, the geometry of its arm, and the readings."""
    given, q = shots(40, START, more="diagnosis: {enabled: false}")
    return *calibrated(given), q


def test_a_mounting_that_is_off_is_found_where_it_shows():
    fit = sound()[1].geometric
    found = fit.model.tip_target[0][1]
    off = pin.log6(T_TIP_CAMERA.actInv(found)).vector
    std = np.array([dict(zip(fit.model.names, fit.std, strict=True)).get(f"tip_target.{c}", 0.0)
                    for c in ("x", "y", "z", "roll", "pitch", "yaw")])  # fmt: skip
    # Its roll and y go with joint 4's offset, its x with the base's height: those stay as head.yaml has them or share it.
    known = np.array([2, 4, 5])
    assert np.all(np.abs(off[known]) < 5 * std[known] + 1e-6)
    hint = pin.SE3(SETTINGS.tip_camera.homogeneous)
    assert np.linalg.norm(pin.log6(hint.actInv(T_TIP_CAMERA)).linear) > 1e-3


def test_poses_of_the_camera_are_right_within_a_few_sigma_where_the_head_is_sound():
    arm, _, q = sound()
    fit = arm.diagnosed.fit
    off = (poses(fit.model, fit.theta, q) - poses(MODEL, THETA, q))[:, :3, 3]
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 3e-5


def test_an_arm_that_does_not_repeat_weighs_on_the_poses_and_not_on_what_shots_say_by_themselves():
    given, q = shots(40, START, more="diagnosis: {enabled: false}")
    off = 2e-4 * np.random.default_rng(4).standard_normal(q.shape)
    rows = replace(given.rows, readings=given.rows.readings + off)
    found = [arm.causes for arm in (sound()[0], calibrated(replace(given, rows=rows))[0])]
    assert None not in found
    still, shaken = found
    assert not still.further and shaken.further
    assert shaken.total[0] > 3 * still.total[0]
    within = [causes.channels[2] for causes in found]
    assert within[0].value == pytest.approx(1.0, abs=0.1) and within[1].value == pytest.approx(
        within[0].value, rel=2e-2
    )


def test_what_an_arm_lacks_and_nobody_seeks_is_structure_in_shots_as_it_is_in_poses():
    """Some shots have fewer image points than a trace has numbers; the questions to the residual must not fall silent for it."""
    bends = Coefficient("joint_3", "axis", Basis("linear", ("joint_3.gravity_torque",), (0.0,)))
    around = Surroundings(np.array([0.0, 9.81, 0.0]), (Payload(T_TIP_CAMERA.translation),))
    model = replace(MODEL.with_coefficients((*MODEL.coefficients, bends)), around=around)
    assert judge_arm(sound()[0]).verdict.word == "noise_floor"
    given, _ = shots(60, START, more="diagnosis: {enabled: false}", model=model, theta=np.append(THETA, 2e-6))
    said = judge_arm(calibrated(given)[0])
    count = unpacked(given.rows.observed, 4).count
    assert count.min() < 6 + 13 <= count.max()
    assert said.verdict.word == "structure_remains"
    assert all(np.isfinite(clue.share) for clue in said.clues)
