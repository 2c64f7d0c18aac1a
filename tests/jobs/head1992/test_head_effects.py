"""Faults of the measuring head: found, named and sized, or left alone."""

from functools import cache

import numpy as np
import pytest
from heads import ARID, MODEL, START, T_TIP_CAMERA, THETA, calibrated, moved, poses, shots

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.catalogue import candidates, declared
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import Geometry
from aridcal.engine.search.declared_effects import CONFOUNDED_SENTENCE
from aridcal.engine.search.loop import CalibratedArm
from aridcal.engine.trust.gains import explain
from aridcal.jobs.head1992.detections import head_things
from aridcal.system.errors import CampaignError

KINDS_OF_HEAD = ("lens_distortion", "focal_length", "principal_point", "sonar_bias", "sonar_scale")
QUIET = f"diagnosis: {{candidates: [{', '.join(KINDS_OF_HEAD)}]}}"
SHOTS = {"scale of all": 40}
"""That tell a fault, where 30 do not."""
SONARS = tuple(f"sonar_{k}" for k in (1, 2, 3, 4))


@cache
def found(n: int, more: str = QUIET, seed: int = 0, **faults: float) -> tuple[CalibratedArm, Geometry]:
    """Shots of a head with some faults, and what is made of them; each made once."""
    return calibrated(shots(n, moved(**faults), seed, more)[0])


def named(arm: CalibratedArm) -> set[tuple[str, str]]:
    return {(a.effect.kind, a.effect.where) for a in arm.diagnosed.stepwise.state.active}


def values(arm: CalibratedArm) -> dict[str, tuple[float, float]]:
    """Values and standard deviations by name."""
    fit = arm.diagnosed.fit
    return {n: (t, s) for n, t, s in zip(fit.model.names, fit.theta.tolist(), fit.std.tolist(), strict=True)}


def within(arm: CalibratedArm, geometry: Geometry) -> tuple[float, float]:
    """RMS of what shots say beyond their poses, in sigmas: with the head as declared, and as found."""
    parts = []
    for fit in (geometry.geometric, arm.diagnosed.fit):
        parts.append(float(np.sqrt(np.nanmean(problem(fit.model, arm.rows).residual(fit.theta)[:, 6:] ** 2))))
    return parts[0], parts[1]


TWO = {"camera_k1": -0.02, "sonar_2_bias": 2e-3}
FAULTS = {
    "two at once": (TWO, [("lens_distortion", "camera", "k1", -0.02), ("sonar_bias", "sonar_2", "bias", 2e-3)]),
    "focal length": ({"camera_fx": 3.0, "camera_fy": 3.0}, [("focal_length", "camera", "f", 3.0)]),
    "principal point": ({"camera_cx": 4.0}, [("principal_point", "camera", "cx", 4.0)]),
    "biases of all": ({f"{s}_bias": -1e-3 for s in SONARS}, [("sonar_bias", "sonars", "bias", -1e-3)]),
    "scale of all": ({f"{s}_scale": 0.01 for s in SONARS}, [("sonar_scale", "sonars", "scale", 0.01)]),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_that_nobody_declared_are_named_and_sized(name):
    fault, expected = FAULTS[name]
    arm, geometry = found(SHOTS.get(name, 30), **fault)
    assert named(arm) == {(kind, where) for kind, where, _, _ in expected}
    for _, where, component, size in expected:
        value, std = values(arm)[f"{where}.{component}"]
        assert abs(value - size) < 5 * std and std < 0.1 * abs(size)
    effects = explain(arm.diagnosed, arm.rows, arm.rows.train, ()).effects
    assert len(effects) == len(expected)
    assert all(effect.p_value < 1e-6 and not effect.declared for effect in effects)
    before, after = within(arm, geometry)
    assert before > 1.5 and after == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("seed", range(2))
def test_a_sound_head_is_left_alone(seed):
    arm, _ = found(30, seed=seed)
    assert named(arm) == set()


def test_what_the_arm_lacks_is_not_blamed_on_the_head():
    bends = Coefficient("joint_3", "axis", Basis("linear", ("joint_3.gravity_torque",), (0.0,)))
    around = Surroundings(np.array([0.0, 9.81, 0.0]), (Payload(T_TIP_CAMERA.translation),))
    model = MODEL.with_coefficients((*MODEL.coefficients, bends))
    model = type(model)(model.robot, model.coefficients, model.world_base, model.tip_target, around)
    arm, _ = calibrated(shots(40, START, 0, QUIET, model, np.append(THETA, 2e-6))[0])
    left = problem(arm.diagnosed.fit.model, arm.rows).residual(arm.diagnosed.fit.theta)
    # a hundred times what the shots leave open: no effect may be taken
    assert np.sqrt(np.mean(left[:, :3] ** 2)) > 1e-4
    assert named(arm) == set()


def test_a_declared_effect_is_fitted_without_any_search():
    off = "effects: [{kind: sonar_bias, where: sonar_1}]\ndiagnosis: {enabled: false}"
    arm, _ = found(25, off, sonar_1_bias=1e-3)
    assert values(arm)["sonar_1.bias"][0] == pytest.approx(1e-3, abs=2e-4)
    quiet, _ = found(15, "diagnosis: {enabled: false}", sonar_1_bias=1e-3)
    assert named(quiet) == set()


def test_of_declared_effects_that_are_one_the_last_is_left_out_and_named():
    declared = ", ".join(f"{{kind: sonar_bias, where: {s}}}" for s in (*SONARS, "sonars"))
    arm, _ = found(20, f"effects: [{declared}]\ndiagnosis: {{enabled: false}}")
    known = values(arm)
    assert [s for s in (*SONARS, "sonars") if f"{s}.bias" not in known] == ["sonars"]
    assert all(known[f"{s}.bias"][1] < 1e-3 for s in SONARS)
    (lost,) = [b for b in arm.diagnosed.barred if b.why == CONFOUNDED_SENTENCE]
    assert lost.what.startswith("sonar_bias at sonars")


def test_focal_length_and_sonar_scale_look_alike_within_shots_and_the_arm_tells_them_apart():
    arm, _ = found(SHOTS["scale of all"], **FAULTS["scale of all"][0])
    fit = arm.diagnosed.fit
    both = [Coefficient("sonars", "scale"), Coefficient("camera", "f")]
    model = fit.model.with_coefficients([*(c for c in fit.model.coefficients if c.where != "sonars"), *both])
    _, J = problem(model, arm.rows).linearised(np.zeros(len(model.coefficients)))
    J = J / fit.sigma.repeat([3, 3, J.shape[1] - 6])[:, None]
    A, own = J[:, :, :-2].reshape(-1, J.shape[2] - 2), J[:, :, -2:].reshape(-1, 2)
    left = (J[:, 6:, -2:].reshape(-1, 2), own - A @ np.linalg.lstsq(A, own, rcond=None)[0])
    alike = [abs(v[:, 0] @ v[:, 1]) / np.linalg.norm(v[:, 0]) / np.linalg.norm(v[:, 1]) for v in left]
    assert alike[0] > 0.95 and alike[1] < 0.5


def test_the_arm_is_better_for_it_and_says_how_well_it_is_known():
    """Errors of the target at all rows, in each independent direction of their covariance: squares of one sigma."""
    _, q = shots(30, moved(**TWO), 0, QUIET)
    arm, geometry = found(30, **TWO)
    true = poses(MODEL, THETA, q)[:, :3, 3]
    off = {}
    for name, fit in (("declared", geometry.geometric), ("identified", arm.diagnosed.fit)):
        off[name] = poses(fit.model, fit.theta, q)[:, :3, 3] - true
    assert np.mean(off["identified"] ** 2) < 1e-2 * np.mean(off["declared"] ** 2)
    fit = arm.diagnosed.fit
    J = problem(fit.model, arm.rows).model.jacobian(fit.theta, problem(fit.model, arm.rows).rows)[2]
    own = J[:, :3] @ np.linalg.cholesky(fit.covariance)
    U, sigma, _ = np.linalg.svd(own.reshape(off["identified"].size, -1), False)
    known = sigma > 1e-3 * sigma[0]
    squares = (U.T[known] @ off["identified"].ravel() / sigma[known]) ** 2
    assert len(squares) > 15
    assert np.mean(squares) == pytest.approx(1.0, abs=0.8)  # of 16 or more: sigma 0.35 at the most


def test_every_candidate_moves_numbers_of_the_head_and_has_a_unit():
    things = head_things(START)
    known = candidates(ObservedRows(ARID, {}, (), stated_components=things.held), KINDS_OF_HEAD)
    assert len(known) == 4 + 2 + 1 + 5 + 5
    for e in known:
        moving = [START.role.moved_by(c.where, c.component) for c in e.coefficients]
        assert len(set(moving)) == len(e.coefficients) and all(moving)
        assert {things.unit(c.where, c.component) for c in e.coefficients} <= {"px", "m", "1"}


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("{kind: sonar_bias, where: sonar_5}", "no place 'sonar_5'.*sonar_4"),
        ("{kind: lens_distortion, where: sonars}", "lens_distortion has no place 'sonars'.*camera"),
        ("{kind: lens_distortion, where: camera, motion: k4}", "has no 'k4'.*k"),
    ],
)
def test_an_effect_that_the_head_cannot_have_is_refused_by_name(asked, message):
    given, _ = shots(1, START, more=f"effects: [{asked}]")
    rows = ObservedRows(ARID, {}, (), stated_components=head_things(START).held)
    with pytest.raises(CampaignError, match=message):
        declared(rows, given.campaign.effects[0], "campaign.yaml")
