"""Faults of the measuring head: found, named and sized, or left alone."""

from functools import cache

import numpy as np
import pytest
from heads import ARID, MODEL, START, T_TIP_CAMERA, THETA, moved, poses, shots

from aridcal.effects.basis import Basis
from aridcal.effects.effect import Coefficient
from aridcal.effects.head_kinds import unit
from aridcal.effects.loads import Surroundings
from aridcal.errors import CampaignError
from aridcal.head.detections import Shots
from aridcal.search.arm_and_head import ArmAndHead, fit_arm_and_head
from aridcal.search.head_effects import candidates, directions, stated
from aridcal.showing import SILENT

QUIET = "diagnosis: {candidates: [lens_distortion, focal_length, principal_point, sonar_bias, sonar_scale]}"
SONARS = tuple(f"sonar_{k}" for k in (1, 2, 3, 4))


@cache
def calibrated(n: int, more: str = QUIET, seed: int = 0, **faults: float) -> tuple[ArmAndHead, np.ndarray]:
    """Shots of a head with some faults, and what is made of them; each made once."""
    return fitted(*shots(n, moved(**faults), seed, more))


def fitted(given: Shots, q: np.ndarray) -> tuple[ArmAndHead, np.ndarray]:
    return fit_arm_and_head(given, ARID, (), SILENT), q


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
    both, _ = calibrated(40, **fault)
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
    both, _ = fitted(*shots(40, START, 0, QUIET, model, np.append(THETA, 2e-6)))
    left = both.arm.diagnosed.fit.residual
    assert (
        np.sqrt(np.mean(left[:, :3] ** 2)) > 1e-4
    )  # a hundred times what the shots leave open: no effect may be taken
    assert both.choice.effects == ()


def test_two_faults_at_once_are_told_apart():
    both, _ = calibrated(60, camera_k1=-0.02, sonar_2_bias=2e-3)
    assert {(e.kind, e.where) for e in both.choice.effects} == {
        ("lens_distortion", "camera"),
        ("sonar_bias", "sonar_2"),
    }


def test_a_declared_effect_is_fitted_without_any_search():
    off = "effects: [{kind: sonar_bias, where: sonar_1}]\ndiagnosis: {enabled: false}"
    both, _ = calibrated(40, off, sonar_1_bias=1e-3)
    assert both.choice.declared == (True,) and both.choice.values == pytest.approx([1e-3], abs=2e-4)
    assert both.choice.tested == 0
    quiet, _ = calibrated(40, "diagnosis: {enabled: false}", sonar_1_bias=1e-3)
    assert quiet.choice.effects == ()


def test_declared_effects_that_are_one_are_named_as_redundant():
    declared = ", ".join(f"{{kind: sonar_bias, where: {s}}}" for s in (*SONARS, "sonars"))
    both, _ = calibrated(30, f"effects: [{declared}]\ndiagnosis: {{enabled: false}}")
    assert both.choice.redundant == {"sonars.bias": tuple(f"{s}.bias" for s in SONARS)}
    assert len(both.choice.values) == 4 and np.all(np.isfinite(both.choice.covariance))


def test_focal_length_and_sonar_scale_look_alike_within_shots_and_the_arm_tells_them_apart():
    both, _ = calibrated(40, **{f"{s}_scale": 0.01 for s in SONARS})
    M = both.equations.together.AA[0], both.equations.alone.AA[0]
    H = directions(START, [Coefficient("sonars", "scale"), Coefficient("camera", "f")])
    alike = [abs(H[:, 0] @ m @ H[:, 1]) / np.sqrt((H[:, 0] @ m @ H[:, 0]) * (H[:, 1] @ m @ H[:, 1])) for m in M]
    assert alike[1] > 0.95 and alike[0] < 0.5


def test_the_arm_is_better_for_it_and_says_how_well_it_is_known():
    """Errors of the target at all rows, in each independent direction of their covariance: squares of one sigma."""
    squares = []
    for seed in range(2):
        both, q = calibrated(40, seed=seed, camera_k1=-0.02)
        true = poses(MODEL, THETA, q)[:, :3, 3]
        off = {}
        for name, fit in (("declared", both.declared.geometric), ("identified", both.arm.diagnosed.fit)):
            off[name] = poses(fit.model, fit.theta, q)[:, :3, 3] - true
        assert np.mean(off["identified"] ** 2) < 1e-2 * np.mean(off["declared"] ** 2)
        fit = both.arm.diagnosed.fit
        _, _, J = fit.model.jacobian(fit.theta, fit.model.rows(q))
        own = J[:, :3] @ np.linalg.cholesky(fit.covariance)
        heads = J[:, :3] @ both.equations.response @ both.choice.directions @ np.linalg.cholesky(both.choice.covariance)
        U, sigma, _ = np.linalg.svd(np.concatenate([own, heads], axis=2).reshape(off["identified"].size, -1), False)
        known = sigma > 1e-3 * sigma[0]
        squares.extend((U.T @ off["identified"].ravel() / sigma)[known] ** 2)
    assert len(squares) > 30
    assert np.mean(squares) == pytest.approx(1.0, abs=0.6)


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
