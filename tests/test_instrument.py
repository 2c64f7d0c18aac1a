"""Faults of the measuring head: found, named and sized, or left alone."""

import numpy as np
import pytest
from heads import ARID, MODEL, START, T_TIP_CAMERA, THETA, moved, poses, shots

from aridcal.arm_and_head import ArmAndHead, fit_arm_and_head
from aridcal.effects import Basis, Coefficient, Surroundings
from aridcal.errors import CampaignError
from aridcal.instrument import candidates, directions, stated, unit

QUIET = "diagnosis: {candidates: [lens_distortion, focal_length, principal_point, sonar_bias, sonar_scale]}"
SONARS = tuple(f"sonar_{k}" for k in (1, 2, 3, 4))


def calibrated(n: int, head=START, seed: int = 0, more: str = QUIET, **model) -> tuple[ArmAndHead, np.ndarray]:
    given, q = shots(n, head, seed, more, **model)
    return fit_arm_and_head(given, given.rows, ARID, (), lambda _: None), q


@pytest.mark.parametrize(
    ("fault", "kind", "where", "component", "size"),
    [
        ({"camera_k1": -0.02}, "lens_distortion", "camera", "k1", -0.02),
        ({"camera_fx": 3.0, "camera_fy": 3.0}, "focal_length", "camera", "f", 3.0),
        ({"camera_cx": 4.0}, "principal_point", "camera", "cx", 4.0),
        ({"sonar_3_bias": 2e-3}, "sonar_bias", "sonar_3", "bias", 2e-3),
        ({f"{s}_bias": -1e-3 for s in SONARS}, "sonar_bias", "sonars", "bias", -1e-3),
        ({f"{s}_scale": 0.01 for s in SONARS}, "sonar_scale", "sonars", "scale", 0.01),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_a_fault_that_nobody_declared_is_named_and_sized(fault, kind, where, component, size):
    both, _ = calibrated(40, moved(**fault))
    assert [(e.kind, e.where) for e in both.choice.effects] == [(kind, where)]
    k = [c.component for c in both.choice.coefficients].index(component)
    std = np.sqrt(both.choice.covariance[k, k])
    assert abs(both.choice.values[k] - size) < 5 * std and std < 0.1 * abs(size)
    assert both.choice.p_values[0] < 1e-6 and not both.choice.declared[0]
    assert both.before.scatter > 1.5 and both.after.scatter == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("seed", range(2))
def test_a_sound_head_is_left_alone(seed):
    both, _ = calibrated(30, seed=seed)
    assert both.choice.effects == () and np.array_equal(both.head.phi, START.phi)


def test_what_the_arm_lacks_is_not_blamed_on_the_head():
    bends = Coefficient("joint_3", "axis", Basis("linear", ("joint_3.gravity_torque",), (0.0,)))
    around = Surroundings(np.array([0.0, 9.81, 0.0]), T_TIP_CAMERA.translation)
    model = MODEL.with_coefficients((*MODEL.coefficients, bends))
    model = type(model)(model.robot, model.coefficients, model.world_base, model.tip_target, around)
    both, _ = calibrated(40, model=model, theta=np.append(THETA, 2e-6))
    left = both.arm.diagnosed.fit.residual
    assert (
        np.sqrt(np.mean(left[:, :3] ** 2)) > 1e-4
    )  # a hundred times what the shots leave open: no effect may be taken
    assert both.choice.effects == ()


def test_two_faults_at_once_are_told_apart():
    both, _ = calibrated(60, moved(camera_k1=-0.02, sonar_2_bias=2e-3))
    assert {(e.kind, e.where) for e in both.choice.effects} == {
        ("lens_distortion", "camera"),
        ("sonar_bias", "sonar_2"),
    }


def test_a_declared_effect_is_fitted_without_any_search():
    off = "effects: [{kind: sonar_bias, where: sonar_1}]\ndiagnosis: {enabled: false}"
    both, _ = calibrated(40, moved(sonar_1_bias=1e-3), more=off)
    assert both.choice.declared == (True,) and both.choice.values == pytest.approx([1e-3], abs=2e-4)
    assert both.choice.tested == 0
    quiet, _ = calibrated(40, moved(sonar_1_bias=1e-3), more="diagnosis: {enabled: false}")
    assert quiet.choice.effects == ()


def test_declared_effects_that_are_one_are_named_as_redundant():
    declared = ", ".join(f"{{kind: sonar_bias, where: {s}}}" for s in (*SONARS, "sonars"))
    both, _ = calibrated(30, more=f"effects: [{declared}]\ndiagnosis: {{enabled: false}}")
    assert both.choice.redundant == {"sonars.bias": tuple(f"{s}.bias" for s in SONARS)}
    assert len(both.choice.values) == 4 and np.all(np.isfinite(both.choice.covariance))


def test_focal_length_and_sonar_scale_look_alike_within_shots_and_the_arm_tells_them_apart():
    both, _ = calibrated(40, moved(**{f"{s}_scale": 0.01 for s in SONARS}))
    M = both.equations.information
    H = directions(START, [Coefficient("sonars", "scale"), Coefficient("camera", "f")])
    alike = [abs(H[:, 0] @ m @ H[:, 1]) / np.sqrt((H[:, 0] @ m @ H[:, 0]) * (H[:, 1] @ m @ H[:, 1])) for m in M]
    assert alike[1] > 0.95 and alike[0] < 0.5


def test_the_arm_is_better_for_it_and_says_how_well_it_is_known():
    ratios = []
    for seed in range(2):
        both, q = calibrated(40, moved(camera_k1=-0.02), seed=10 + seed)
        true = poses(MODEL, THETA, q)[:, :3, 3]
        off = {}
        for name, fit in (("declared", both.declared.geometric), ("identified", both.arm.diagnosed.fit)):
            off[name] = poses(fit.model, fit.theta, q)[:, :3, 3] - true
        assert np.mean(off["identified"] ** 2) < 1e-2 * np.mean(off["declared"] ** 2)
        fit = both.arm.diagnosed.fit
        _, _, J = fit.model.jacobian(fit.theta, fit.model.rows(q))
        wide = J[:, :3] @ both.equations.response @ both.choice.directions
        covariance = J[:, :3] @ fit.covariance @ J[:, :3].transpose(0, 2, 1)
        covariance += wide @ both.choice.covariance @ wide.transpose(0, 2, 1)
        ratios.append(np.mean(off["identified"] ** 2) / np.mean(np.einsum("nii->ni", covariance)))
    assert 0.3 < np.mean(ratios) < 2.5  # few combinations of coefficients carry most of it


def test_every_candidate_moves_numbers_of_the_head_and_has_a_unit():
    known = candidates(START, ("lens_distortion", "focal_length", "principal_point", "sonar_bias", "sonar_scale"))
    assert len(known) == 4 + 2 + 1 + 5 + 5
    for e in known:
        H = directions(START, e.coefficients)
        assert np.linalg.matrix_rank(H) == len(e.coefficients) and set(np.unique(H)) <= {0.0, 1.0}
        assert {unit(c) for c in e.coefficients} <= {"px", "m", "1"}


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ("{kind: sonar_bias, where: sonar_5}", "sonar_bias has no place 'sonar_5'.*sonar_4"),
        ("{kind: lens_distortion, where: sonars}", "lens_distortion has no place 'sonars'.*camera"),
        ("{kind: lens_distortion, where: camera, motion: k4}", "has no 'k4'.*k"),
    ],
)
def test_an_effect_that_the_head_cannot_have_is_refused_by_name(declared, message):
    given, _ = shots(1, START, more=f"effects: [{declared}]")
    with pytest.raises(CampaignError, match=message):
        stated(START, given.campaign.effects, "campaign.yaml")
