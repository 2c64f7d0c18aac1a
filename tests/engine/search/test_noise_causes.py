"""What makes residuals scatter: named where it was planted, sized, used as weights, and not taken for what comes back."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots
from rich.console import Console
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.problem import problem
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset, RowNoise, weighed
from aridcal.engine.search.loop import CalibratedArm, calibrated_arm, fit_arm, fit_constants, structured_notices
from aridcal.engine.search.noise_causes import NoiseCause, NoiseCauses
from aridcal.identify import summary
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.pages.drawing.words import causes_in_words
from aridcal.system.progress import SILENT

UR10 = robots.ur10()
ROWS = 200
FRAMES_ALONE = {"parameters": {"set": "none"}, "diagnosis": {"enabled": False}}
GEOMETRY_ALONE = {"diagnosis": {"enabled": False}}


def rows(seed: int, noise: float = 1e-4, robot: Robot = UR10, size: float = 0.0, n: int = ROWS) -> robots.Truth:
    """Poses of a robot with frames anywhere, a fifth of them held out."""
    rng = np.random.default_rng(seed)
    placed = robots.random_placement(rng), robots.random_placement(rng, 0.1)
    truth = robots.simulate(robot, n, rng, size, noise, world=placed[0], tip=placed[1])
    return replace(truth, measured=replace(truth.measured, test=np.arange(n) % 5 == 0))


def misread(data: Dataset, joint: int, size: float, seed: int = 0) -> Dataset:
    """The same rows with one joint's readings off at random."""
    off = np.zeros_like(data.readings)
    off[:, joint] = size * np.random.default_rng(1000 + seed).standard_normal(len(data))
    return replace(data, readings=data.readings + off)


def calibrated(data: Dataset, robot: Robot = UR10, **sections: object) -> CalibratedArm:
    settings = robots.campaign("pose" if data.rotation is not None else "position", **(sections or FRAMES_ALONE))
    geometry = fit_constants(settings.question, robot, data, ())
    return calibrated_arm(settings.question, robot, data, (), geometry, SILENT)


def causes(data: Dataset, robot: Robot = UR10) -> NoiseCauses:
    found = calibrated(data, robot).causes
    assert found is not None
    return found


def the_only(found: NoiseCauses) -> NoiseCause:
    (only,) = found.further
    return only


@pytest.mark.parametrize(("joint", "noise"), [(0, 1e-4), (2, 1e-4), (3, 1e-4), (5, 1e-4), (0, 5e-5)])
def test_a_joint_that_is_misread_is_named_and_sized_and_so_is_the_instrument(joint: int, noise: float) -> None:
    sound = rows(joint, noise).measured
    data = misread(sound, joint, 2e-4, joint)
    found = causes(data)
    only = the_only(found)
    drawn = float(np.std((data.readings - sound.readings)[~data.test, joint]))
    assert (only.kind, only.name, only.unit) == ("joint", UR10.readings[joint], "rad")
    assert only.value == pytest.approx(drawn, rel=0.15)
    assert abs(only.value - 2e-4) < 4 * only.std
    assert [c.value for c in found.channels] == pytest.approx([noise, noise], rel=0.15)
    assert [c.unit for c in found.channels] == ["m", "rad"]
    np.testing.assert_allclose(sum(c.share for c in found.causes), 1.0)


def test_positions_alone_tell_it_too() -> None:
    data = robots.positions_alone(misread(rows(1).measured, 1, 4e-4))
    only = the_only(causes(data))
    assert (only.name, only.value) == (UR10.readings[1], pytest.approx(4e-4, rel=0.2))


def test_a_rail_is_misread_in_metres() -> None:
    robot = robots.arid()
    only = the_only(causes(misread(rows(0, robot=robot).measured, 0, 4e-4), robot))
    assert (only.kind, only.name, only.unit) == ("joint", robot.readings[0], "m")
    assert only.value == pytest.approx(4e-4, rel=0.15)


def test_two_joints_are_told_apart() -> None:
    found = causes(misread(misread(rows(2).measured, 1, 3e-4), 4, 3e-4, 1))
    assert {c.name for c in found.further} == {UR10.readings[1], UR10.readings[4]}
    assert [c.value for c in found.further] == pytest.approx([3e-4, 3e-4], rel=0.2)


@pytest.mark.parametrize("seed", range(3))
def test_clean_rows_name_nothing_and_keep_their_weights(seed: int) -> None:
    data = rows(seed).measured
    arm = calibrated(data)
    assert arm.causes is not None
    assert (arm.causes.further, arm.causes.structured, arm.causes.relative, arm.rows.relative) == ((), (), None, None)
    assert arm.causes.beyond.tolist() == [0.0, 0.0]
    assert arm.causes.total == pytest.approx([1e-4, 1e-4], rel=0.1)


def pushed(data: Dataset, arm: CalibratedArm, joint: int) -> np.ndarray:
    """How a joint's reading moves the target, by finite differences of the model, shape (N, 6)."""
    fit, step, ends = arm.diagnosed.fit, 1e-6, []
    for sign in (1, -1):
        q = data.readings.copy()
        q[:, joint] += sign * step
        ends.append(fit.model.poses(fit.theta, fit.model.rows(q)))
    (R, p), (R2, p2) = ends
    turned = Rotation.from_matrix(R @ R2.transpose(0, 2, 1)).as_rotvec()
    return np.hstack([p - p2, turned]) / (2 * step)


@pytest.mark.parametrize("with_std", [False, True])
def test_the_rows_factors_make_the_covariance_of_all_causes_together(with_std: bool) -> None:
    """Written out with finite differences; where rows have sigmas of their own, the channels keep them."""
    rng = np.random.default_rng(1)
    data, std = rows(4, 0.0).measured, np.exp(0.3 * with_std * rng.standard_normal((ROWS, 6)))
    off = 1e-4 * std * rng.standard_normal((ROWS, 6))
    assert data.rotation is not None
    turned = Rotation.from_rotvec(off[:, 3:]).as_matrix() @ data.rotation
    data = weighed(
        misread(robots.placed(data, position=data.position + off[:, :3], rotation=turned), 1, 3e-4), RowNoise(std)
    )
    assert data.relative is not None
    std = data.relative
    arm = calibrated(data)
    found = arm.causes
    assert found is not None and arm.rows.relative is not None
    channel = np.repeat([c.value for c in found.channels], 3)
    J = pushed(data, arm, 1)
    wanted = (std * channel)[:, :, None] ** 2 * np.eye(6) + the_only(found).value ** 2 * J[:, :, None] * J[:, None, :]
    L = found.relative * channel
    np.testing.assert_allclose(L @ L.transpose(0, 2, 1), wanted, rtol=1e-5, atol=1e-6 * wanted.max())


def test_held_out_rows_take_no_part() -> None:
    data = misread(rows(5).measured, 2, 3e-4)
    wrong = robots.placed(data, position=data.position + np.where(data.test, 5e-3, 0.0)[:, None])
    first, second = calibrated(data), calibrated(wrong)
    assert np.array_equal(first.rows.relative, second.rows.relative)
    assert first.causes is not None and second.causes is not None
    assert [c.value for c in first.causes.causes] == [c.value for c in second.causes.causes]


@cache
def weighed_by_causes(seed: int) -> tuple[robots.Truth, Dataset, CalibratedArm]:
    """An arm of which one joint is misread, seen by an instrument that is far better."""
    truth = rows(seed, 2e-5, size=5e-4)
    data = misread(truth.measured, 0, 5e-4, seed)
    return truth, data, calibrated(data, **GEOMETRY_ALONE)


def test_rows_that_scatter_less_count_more() -> None:
    """With the covariance as weights the constants predict unseen poses better: the reason for all this."""
    settings, ratios = robots.campaign(**GEOMETRY_ALONE), []
    for seed in range(3):
        truth, data, arm = weighed_by_causes(seed)
        plain = fit_arm(settings.question, fit_constants(settings.question, UR10, data, ()), data, SILENT)
        unseen = robots.readings(UR10, 300, np.random.default_rng(99))
        p = truth.model.poses(truth.theta, truth.model.rows(unseen))[1]
        off = []
        for found in (plain.diagnosed.fit, arm.diagnosed.fit):
            p2 = found.model.poses(found.theta, found.model.rows(unseen))[1]
            off.append(np.sqrt(np.mean((p - p2) ** 2)))
        ratios.append(off[1] / off[0])
    assert np.median(ratios) < 0.8


def test_an_error_curve_is_no_noise() -> None:
    """A bump of 2 mrad that no effect may explain: said to come back, not named, and no weights made of it."""
    data = rows(6).measured
    q = data.readings.copy()
    q[:, 2] += 1e-3 * np.exp(-0.5 * (q[:, 2] / 0.5) ** 2)
    arm = calibrated(replace(data, readings=q))
    assert arm.causes is not None
    assert ("joint", UR10.readings[2]) in arm.causes.structured
    assert UR10.readings[2] not in {c.name for c in arm.causes.further}
    assert any(UR10.readings[2] in notice for notice in structured_notices(arm.causes))


def test_a_frame_that_turns_slowly_is_no_noise_that_grows_with_range() -> None:
    """The tracker turns by 0.1 mrad and back while the rows are measured: far targets are off by more, and so again."""
    data = rows(8, 2e-5).measured
    turn = 1e-4 * np.sin(np.linspace(0.0, 12.0, ROWS))[:, None] * [0.0, 0.0, 1.0]
    found = causes(robots.placed(data, position=data.position + np.cross(turn, data.position)))
    assert [name for _, name in found.structured] == ["position"]
    assert found.further == ()
    assert any("comes back at neighbouring rows: it is no noise" in notice for notice in structured_notices(found))


def hostile(kind: str, seed: int) -> Dataset:
    """Rows of which something is wrong that is no scatter of a reading."""
    rng, data = np.random.default_rng(seed), rows(seed).measured
    late = (np.arange(ROWS) > ROWS // 2)[:, None]
    rotation, p, q = data.rotation, data.position, data.readings.copy()
    assert rotation is not None
    if kind == "zero jumps":
        q[late[:, 0], 2] += 4e-4
    moved = {
        "target slips": 3e-4 * late * rotation[:, :, 0],
        "base wanders": np.cumsum(2e-5 * rng.standard_normal((ROWS, 3)), axis=0),
        "positions rounded": np.round(p, 3) - p,
        "long tails": 1e-4 * rng.standard_t(3, (ROWS, 3)),
        "outliers": 5e-3 * (rng.random((ROWS, 1)) < 0.05) * rng.standard_normal((ROWS, 3)),
    }
    return robots.placed(data, position=p + moved.get(kind, 0.0), readings=q)


@pytest.mark.parametrize(
    "kind", ["zero jumps", "target slips", "base wanders", "positions rounded", "long tails", "outliers"]
)
def test_what_is_wrong_otherwise_is_not_taken_for_scatter(kind: str) -> None:
    assert causes(hostile(kind, 1)).further == ()


def test_outliers_do_not_hide_a_joint_that_is_misread() -> None:
    only = the_only(causes(misread(hostile("outliers", 3), 1, 2e-4, 3)))
    assert (only.name, only.value) == (UR10.readings[1], pytest.approx(2e-4, rel=0.2))


def far(seed: int) -> Dataset:
    """Rows seen from an instrument at the world's origin, near the robot, with little noise."""
    return rows(seed, 2e-5).measured


def test_noise_that_grows_with_range_is_recognised() -> None:
    data = far(1)
    away = np.linalg.norm(data.position, axis=1, keepdims=True)
    rng = np.random.default_rng(7)
    only = the_only(causes(robots.placed(data, position=data.position + 5e-5 * away * rng.standard_normal((ROWS, 3)))))
    assert (only.kind, only.name, only.unit) == ("range", "position", "m/m")
    assert only.value == pytest.approx(5e-5, rel=0.15)


def test_rotation_noise_about_the_line_of_sight_is_recognised() -> None:
    data = far(2)
    sight = data.position / np.linalg.norm(data.position, axis=1, keepdims=True)
    about = Rotation.from_rotvec(2e-4 * sight * np.random.default_rng(7).standard_normal((ROWS, 1))).as_matrix()
    assert data.rotation is not None
    only = the_only(causes(robots.placed(data, rotation=about @ data.rotation)))
    assert (only.kind, only.name, only.unit) == ("sight", "rotation", "rad")
    assert only.value == pytest.approx(2e-4, rel=0.15)


def test_few_rows_are_not_asked() -> None:
    assert calibrated(misread(rows(0, n=30).measured, 1, 1e-3)).causes is None


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """A campaign of which joint 2's readings scatter by 0.3 mrad."""
    truth = rows(3)
    truth = replace(truth, measured=misread(truth.measured, 1, 3e-4))
    return identify(robots.write_campaign(tmp_path_factory.mktemp("shaken"), truth))


def test_results_list_what_the_scatter_is_made_of(shaken: Outcome) -> None:
    noise = result_document(shaken)["noise"]
    assert set(noise) == {"position_mm", "rotation_mrad", "source", "channels", "joint_readings"}
    reading = noise["joint_readings"].pop(UR10.readings[1])
    assert noise["joint_readings"] == {}
    assert (reading["value"], reading["unit"]) == (pytest.approx(3e-4, rel=0.15), "rad")
    assert 0.0 < reading["std"] < 3e-5
    assert noise["position_mm"] == pytest.approx(0.1, rel=0.1)
    assert noise["position_mm"] == pytest.approx(1e3 * noise["channels"]["position"]["value"], rel=0.03)


def test_screen_and_report_say_that_most_of_what_scatters_is_a_reading(shaken: Outcome) -> None:
    said = causes_in_words(shaken)
    assert f"Most of what scatters is the reading of {UR10.readings[1]} (0." in said
    assert "were the joints read before standstill?" in said
    console = Console(record=True, width=400)
    summary(shaken, console)
    assert said in console.export_text()


def test_the_noise_that_is_said_is_the_error_that_is_left(shaken: Outcome) -> None:
    """The instrument makes 0.1 mm per axis, the rows scatter by more: all causes together must make the error."""
    last = shaken.stage("final").residual[shaken.measurements.train]
    left = np.sqrt([np.mean(last[:, :3] ** 2), np.mean(last[:, 3:] ** 2)])
    assert shaken.scatter[0] > 1.5 * shaken.noise[0]
    np.testing.assert_allclose(shaken.scatter, left, rtol=0.08)
    assert shaken.verdict.word == "noise_floor"


def test_std_of_the_constants_cover_the_truth_where_a_joint_is_misread() -> None:
    """The z of the target's predicted position, by the covariance that goes with the weights."""
    z = []
    for seed in range(3):
        truth, _, arm = weighed_by_causes(seed)
        fit = arm.diagnosed.fit
        unseen = robots.readings(UR10, 60, np.random.default_rng(98))
        _, p = truth.model.poses(truth.theta, truth.model.rows(unseen))
        _, p2, J = fit.model.jacobian(fit.theta, fit.model.rows(unseen))
        variance = np.einsum("nik,kl,nil->ni", J[:, :3], fit.covariance, J[:, :3])
        z.append((p - p2) / np.sqrt(variance))
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.3)


def test_what_is_weighed_is_still_measured_in_metres(shaken: Outcome, tmp_path: Path) -> None:
    """Residuals of results are not those divided by the weights."""
    stage = shaken.stage("final")
    again = problem(stage.fit.model, replace(shaken.measurements, relative=None)).residual(stage.fit.theta)
    np.testing.assert_array_equal(again, stage.residual)


# ---------------------------------------------------------------- whom to accuse


def on_a_lever(seed: int, lever: np.ndarray, kind: str, n: int = ROWS) -> Dataset:
    """A body of markers whose rotation is read 0.5 mrad off, with the target off it."""
    data, rng = rows(seed, 2e-5, n=n).measured, np.random.default_rng(200 + seed)
    assert data.rotation is not None
    turn = 5e-4 * rng.standard_normal((n, 3))
    rotation = Rotation.from_rotvec(turn).as_matrix() @ data.rotation
    made = robots.placed(data, position=data.position + np.cross(turn, data.rotation @ lever), rotation=rotation)
    return made if kind == "pose" else robots.positions_alone(made)


@pytest.mark.parametrize("seed", range(2))
def test_a_body_of_markers_on_a_lever_is_named_with_its_lever_and_no_joint_is(seed: int) -> None:
    lever = 0.2 * np.array([0.6, 0.0, 0.8])
    only = the_only(causes(on_a_lever(seed, lever, "pose")))
    assert (only.kind, only.unit, only.rivals) == ("lever", "rad", ())
    assert only.value == pytest.approx(5e-4, rel=0.15)
    assert only.shape is not None and only.shape.vector is not None
    # Of w x l, 600 numbers with 0.02 mm of even noise each tell l to some hundredths of a millimetre by 0.5 mrad.
    np.testing.assert_allclose(only.shape.vector, lever, atol=0.01)


@pytest.mark.parametrize("seed", range(2))
def test_of_positions_alone_a_lever_is_named_by_the_axis_along_which_it_does_not_move(seed: int) -> None:
    lever = 0.2 * np.array([0.6, 0.0, 0.8])
    data = on_a_lever(seed, lever, "position")
    arm = calibrated(data)
    assert arm.causes is not None
    only = the_only(arm.causes)
    assert (only.kind, only.unit) == ("own_axis", "m")
    assert only.shape is not None and only.shape.vector is not None and only.shape.across
    assert only.value == pytest.approx(5e-4 * 0.2, rel=0.15)
    # Positions do not tell how the target is turned on the flange, so that its axis is compared in the world.
    fit, true = arm.diagnosed.fit, rows(seed, 2e-5).measured.rotation
    R, _ = fit.model.poses(fit.theta, fit.model.rows(data.readings))
    assert true is not None
    along = np.einsum("ni,ni->n", R @ only.shape.vector, true @ lever / 0.2)
    assert np.abs(along).min() > np.cos(0.15)


@pytest.mark.parametrize(("seed", "origin"), [(0, True), (1, False)])
def test_depth_noise_of_a_camera_is_named_with_the_camera_s_place_and_no_joint_is(seed: int, origin: bool) -> None:
    data, rng = rows(seed, 2e-5).measured, np.random.default_rng(300 + seed)
    middle = data.position.mean(axis=0)
    point = np.zeros(3) if origin else middle + 2.0 * rng.standard_normal(3) / np.sqrt(3.0)
    away = data.position - point
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    only = the_only(
        causes(robots.placed(data, position=data.position + 6e-5 * distance * away * rng.standard_normal((ROWS, 1))))
    )
    assert (only.kind, only.unit) == ("depth", "m")
    shape = only.shape
    assert shape is not None and shape.point is not None
    drawn = 6e-5 * np.sqrt(np.mean(distance[data.train] ** 4))
    made = only.value * np.sqrt(np.mean((np.linalg.norm(data.position - shape.point, axis=1) / shape.typical) ** 4))
    assert made == pytest.approx(drawn, rel=0.2)
    seen = (data.position - shape.point) / np.linalg.norm(data.position - shape.point, axis=1, keepdims=True)
    assert np.median(np.abs(np.sum(seen * away / distance, axis=1))) > np.cos(0.1)


def about_the_flange(joint: bool, seed: int) -> Dataset:
    """Rotation noise about the axis of joint 6, on which the target stands: the reading's, or the target's own."""
    rng = np.random.default_rng(seed)
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    data = robots.simulate(UR10, ROWS, rng, 0.0, 1e-4, world=robots.random_placement(rng), tip=tip).measured
    turn = 4e-4 * rng.standard_normal(ROWS)
    assert data.rotation is not None
    if joint:
        return replace(data, readings=data.readings + turn[:, None] * (np.arange(6) == 5))
    about = Rotation.from_rotvec(data.rotation[:, :, 2] * turn[:, None]).as_matrix()
    return robots.placed(data, rotation=about @ data.rotation)


@pytest.mark.parametrize("joint", [True, False])
def test_a_joint_and_an_axis_of_the_target_that_no_row_tells_apart_are_a_tie(joint: bool) -> None:
    """The same covariance of every row, whichever it is: accused alone, the joint would be so without proof."""
    only = the_only(causes(about_the_flange(joint, 1)))
    every = [only, *only.rivals]
    assert {c.kind for c in every} == {"joint", "own_axis"}
    for cause in every:
        assert cause.value == pytest.approx(4e-4, rel=0.2)
    (own,) = [c.shape for c in every if c.shape is not None]
    assert own.vector is not None and abs(own.vector[2]) > np.cos(0.1)


def test_ties_are_said_in_words_and_stand_in_the_result(tmp_path: Path) -> None:
    data = about_the_flange(True, 2)
    truth = replace(rows(0), measured=data)
    outcome = identify(robots.write_campaign(tmp_path, truth))
    assert "these rows do not tell which" in causes_in_words(outcome)
    (reading,) = result_document(outcome)["noise"]["joint_readings"].values()
    assert [(rival["cause"], rival["name"], rival["unit"]) for rival in reading["or"]] == [
        ("in_target_axes", "rotation", "rad")
    ]
    assert np.linalg.norm(reading["or"][0]["axis"]) == pytest.approx(1.0)


def test_rows_are_weighed_with_a_noise_on_a_lever_as_sampling_says() -> None:
    """The covariance of a row from 40,000 draws of the noise as named, moved and turned one by one."""
    found = causes(on_a_lever(1, np.array([0.1, 0.0, 0.15]), "pose"))
    only = the_only(found)
    assert found.relative is not None and only.shape is not None and only.shape.vector is not None
    rotation = on_a_lever(1, np.zeros(3), "pose").rotation
    assert rotation is not None
    rng, sigma = np.random.default_rng(0), np.repeat([c.value for c in found.channels], 3)
    turn = only.value * rng.standard_normal((40_000, 3))
    for k in (0, 100):
        drawn = np.hstack([np.cross(turn, rotation[k] @ only.shape.vector), turn])
        L = found.relative[k] * sigma
        made, size = L @ L.T - np.diag(sigma**2), drawn.std(axis=0)
        # Of 40,000 draws a correlation is known to 0.005; attitudes are read 0.5 mrad off.
        np.testing.assert_allclose(made / np.outer(size, size), np.cov(drawn.T) / np.outer(size, size), atol=0.03)
