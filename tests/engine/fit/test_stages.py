"""Frames and constants of a whole job: which are asked for, and that the answer does not hang on the start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import robots

from aridcal.engine.corrections.effect import LINK_COMPONENTS
from aridcal.engine.fit.constants import constants, frame_coefficients, unused_links
from aridcal.engine.fit.least_squares import Convergence
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.question import Question
from aridcal.engine.fit.stages import Geometry, fit_geometry, recentred
from aridcal.engine.rows.dataset import RowNoise, dataset, weighed
from aridcal.jobs.calibrate.doty_answer import closed_form_starts
from aridcal.system.errors import AridcalError, MeasurementError

ALL = ("x", "y", "z", "roll", "pitch", "yaw")


def solve(truth: robots.Truth, station: np.ndarray | None = None, **keys: object) -> Geometry:
    """Both stages of a campaign with the given keys."""
    kind = "pose" if truth.measured.rotation is not None else "position"
    labels = tuple(sorted(set(station.tolist()))) if station is not None else ()
    rows = robots.measurements(truth, station)
    return fit_geometry(robots.campaign(kind, **keys).question, truth.model.robot, rows, labels)


def rms(truth: robots.Truth, found: Geometry, station: np.ndarray | None = None) -> tuple[float, float]:
    """Position RMS of both stages on the rows, [m]."""
    values = []
    for fit in (found.nominal, found.geometric):
        r = problem(fit.model, robots.measurements(truth, station)).residual(fit.theta)
        values.append(float(np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1)))))
    return values[0], values[1]


def example(n: int = 120, kind: str = "pose", noise: float = 1e-5, robot=robots.arid, seed: int = 0) -> robots.Truth:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)
    world, tip = robots.random_placement(rng, 5.0), robots.random_placement(rng, 0.3)
    return robots.simulate(robot(), n, rng, 2e-3, noise, world=world, tip=tip, kind=kind)


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize("robot", [robots.arid, robots.ur10])
def test_constants_bring_the_error_down_to_the_noise(robot, kind: str) -> None:  # type: ignore[no-untyped-def]
    truth = example(kind=kind, robot=robot)
    found = solve(truth)
    before, after = rms(truth, found)
    assert before > 1e-3
    assert after < 1.2 * np.sqrt(3) * 1e-5
    assert found.geometric.sigma[0] == pytest.approx(1e-5, rel=0.15)
    proof = found.geometric.convergence
    assert proof.converged
    assert proof.restarts == proof.agreed >= 2


def test_the_answer_does_not_hang_on_where_tracker_and_target_are() -> None:
    base = example(kind="pose")
    rng = np.random.default_rng(1)
    predicted, kept = [], []
    for _ in range(4):
        world, tip = robots.random_placement(rng, 5.0), robots.random_placement(rng, 0.3)
        found = solve(robots.moved(base, world, tip)).geometric
        q = robots.readings(base.model.robot, 30, np.random.default_rng(2))
        _, p = found.model.poses(found.theta, found.model.rows(q))
        R, _ = found.model.poses(found.theta, found.model.rows(q))
        predicted.append((p - R @ tip.inverse().rotation @ tip.translation - world.translation) @ world.rotation)
        kept.append(set(found.model.names))
    for p in predicted[1:]:
        np.testing.assert_allclose(p, predicted[0], atol=3e-5)
    assert all(len(names) == 20 for names in kept)


def test_a_hint_however_far_off_changes_nothing() -> None:
    truth = example()
    plain = solve(truth).geometric
    hinted = solve(truth, frames={
        "world_base": {"xyz": [100.0, -50.0, 3.0], "rpy": [1.0, 2.0, 3.0]},
        "tip_target": {"xyz": [3.0, 3.0, 3.0], "rpy": [-3.0, 0.5, 1.0]},
    }).geometric  # fmt: skip
    q = truth.model.rows(truth.readings)
    for a, b in zip(plain.model.poses(plain.theta, q), hinted.model.poses(hinted.theta, q), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)


def test_known_frames_are_left_alone() -> None:
    truth = example()
    world, tip = (f[0][1] for f in (truth.model.world_base, truth.model.tip_target))
    given = {
        name: {"xyz": T.translation.tolist(), "rpy": pin.rpy.matrixToRpy(T.rotation).tolist(), "identify": False}
        for name, T in (("world_base", world), ("tip_target", tip))
    }
    found = solve(truth, frames=given)
    assert not any(c.where in given for c in found.geometric.model.coefficients)
    assert found.nominal.theta.shape == (0,)
    assert rms(truth, found)[1] < 1.2 * np.sqrt(3) * 1e-5
    for frames, T in zip(found.geometric.model.frames(found.geometric.theta), (world, tip), strict=True):
        assert (frames[0][1].inverse() * T).isIdentity(1e-9)
    one = solve(truth, frames={"world_base": given["world_base"]})
    assert {c.where for c in one.nominal.model.coefficients} == {"tip_target"}


@pytest.mark.parametrize("which", ["full", "doty"])
def test_sets_that_can_hold_the_truth_reach_the_noise(which: str) -> None:
    rng = np.random.default_rng(3)
    truth = robots.simulate(robots.arid(), 100, rng, 2e-3, 1e-5, "doty", robots.random_placement(rng))
    assert rms(truth, solve(truth, parameters={"set": which}))[1] < 1.2 * np.sqrt(3) * 1e-5


def test_the_reports_angles_alone_cannot_mend_lengths() -> None:
    """`angles` holds beta and alpha only: what lengths and offsets do is left, and `none` leaves all."""
    truth = example()
    angles = solve(truth, parameters={"set": "angles"})
    links = [c.name for c in angles.geometric.candidates if c.where not in ("world_base", "tip_target")]
    assert links == [f"joint_{k}.{c}" for k in (1, 2, 3) for c in ("beta", "alpha")] + [
        "joint_4.alpha", "flange_fixed.pitch",
    ]  # fmt: skip
    none = solve(truth, parameters={"set": "none"})
    full = solve(truth)
    assert none.geometric.model.coefficients == none.nominal.model.coefficients
    before, after = rms(truth, none)
    assert after == pytest.approx(before, rel=1e-4)  # steps end at a thousandth of a sigma
    assert rms(truth, full)[1] < rms(truth, angles)[1] < rms(truth, none)[1]


def test_doty_has_the_reports_numbers_per_joint() -> None:
    """Four per revolute joint, five with the rail's d; theta and beta give way where a is zero, and it is said."""
    robot = robots.arid()
    found = constants(robot, "doty")
    assert [c.name for c in found if c.where == "joint_1"] == [f"joint_1.{c}" for c in LINK_COMPONENTS]
    assert [c.name for c in found if c.where == "joint_2"] == [f"joint_2.{c}" for c in LINK_COMPONENTS[1:]]
    assert [c.name for c in found][-4:] == ["joint_4.a", "joint_4.alpha", "flange_fixed.yaw", "flange_fixed.pitch"]
    (said,) = unused_links(robot, "doty")
    assert "joint_4" in said
    assert "flange_fixed.yaw" in said
    assert unused_links(robot, "full") == []


def test_the_closed_form_of_the_report_is_a_restart_where_the_question_knows_it() -> None:
    """On the ARID with its own parameters; it must agree with the others."""
    rng = np.random.default_rng(4)
    truth = robots.simulate(robots.arid(), 100, rng, 2e-3, 1e-5, "doty", robots.random_placement(rng))
    rows, robot = robots.measurements(truth), truth.model.robot

    def proof(constants: str, question: Question) -> Convergence:
        return fit_geometry(replace(question, constants=constants), robot, rows, ()).geometric.convergence

    asked = robots.campaign("pose").question
    without, knowing = (replace(asked, starts=starts) for starts in (asked.starts, closed_form_starts))
    doty, full, none = proof("doty", knowing), proof("full", knowing), proof("doty", without)
    assert (doty.restarts, full.restarts, none.restarts) == (3, 2, 2)
    assert doty.agreed == 3


def test_each_station_gets_its_own_frame() -> None:
    rng = np.random.default_rng(5)
    base = robots.simulate(robots.ur10(), 150, rng, 1e-3, 1e-5, tip=robots.random_placement(rng, 0.2))
    station = np.array(["a", "b", "c"])[np.arange(150) % 3]
    worlds = {s: robots.random_placement(rng) for s in "abc"}
    assert base.measured.rotation is not None
    R = np.array([worlds[s].rotation @ m for s, m in zip(station, base.measured.rotation, strict=True)])
    p = np.array([worlds[s].act(m) for s, m in zip(station, base.measured.position, strict=True)])
    truth = replace(base, measured=robots.placed(base.measured, position=p, rotation=R))
    frames = {"world_base": {"per": "station"}}
    found = solve(truth, station=station, frames=frames)
    assert rms(truth, found, station)[1] < 1.3 * np.sqrt(3) * 1e-5
    for label, T in recentred(found.geometric).model.world_base:
        assert np.linalg.norm(pin.log6(worlds[str(label)].inverse() * T).vector) < 0.02
    with pytest.raises(MeasurementError, match="`station` column"):
        solve(truth, frames=frames)


def test_recentring_a_fit_changes_no_prediction() -> None:
    truth = example()
    found = solve(truth).geometric
    same = recentred(found)
    rows = truth.model.rows(truth.readings)
    for a, b in zip(found.model.poses(found.theta, rows), same.model.poses(same.theta, rows), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
    assert not any(v for c, v in zip(same.model.coefficients, same.theta, strict=True) if c.where == "tip_target")


@pytest.mark.parametrize("n", [1, 2, 3])
def test_too_few_rows_end_in_words_or_in_a_fit_but_never_in_a_crash(n: int) -> None:
    truth = example(n)
    try:
        found = solve(truth)
    except AridcalError as error:
        assert "cannot tell" in str(error)
    else:
        assert np.isfinite(found.geometric.theta).all()
        # What is believed of constants counts as numbers measured; nothing is believed of frames.
        believed = found.geometric.believed.any(axis=1)
        assert (~believed).sum() <= 6 * n
        assert np.isfinite(found.geometric.std).all() and found.geometric.std[believed].max(initial=0.0) < 0.1


def test_sigmas_of_the_rows_are_relative_with_rms_1_and_absolute_ones_declare_the_noise() -> None:
    truth = example(50)
    std = np.random.default_rng(0).uniform(1e-5, 1e-4, (50, 6)) * [1, 1, 1, 5, 5, 5]
    rows = robots.declared(truth.measured, 1e-3)
    relative, absolute = (weighed(rows, RowNoise(std=std, absolute=how)) for how in (False, True))
    for weighted in (relative, absolute):
        assert weighted.relative is not None
        for part in (slice(0, 3), slice(3, 6)):
            assert np.mean(weighted.relative[:, part] ** 2) == pytest.approx(1.0)
            ratio = weighted.relative[:, part] / std[:, part]
            np.testing.assert_allclose(ratio, ratio[0, 0])
    assert weighed(relative, RowNoise()).relative is None
    assert weighed(truth.measured, RowNoise(std=std)).sigma == (None, None)
    assert relative.sigma == (1e-3, None)
    for stated, part in zip(absolute.sigma, (std[:, :3], std[:, 3:]), strict=True):
        assert stated == pytest.approx(np.sqrt(np.mean(part**2)))
    np.testing.assert_allclose(absolute.relative * np.repeat(absolute.sigma, 3), std)


def test_frames_to_identify_come_world_first_and_per_station() -> None:
    some = dataset(robots.ur10().readings, robots.ur10().kinds, np.zeros((1, 6)), np.zeros((1, 3)))
    names = [c.name for c in frame_coefficients(robots.campaign().question, (), some)]
    assert names == [f"{w}.{c}" for w in ("world_base", "tip_target") for c in ALL]
    per = robots.campaign(frames={"world_base": {"per": "station"}, "tip_target": {"identify": False}})
    assert [c.name for c in frame_coefficients(per.question, ("a", "b"), some)] == [
        f"world_base[{s}].{c}" for s in "ab" for c in ALL
    ]


@pytest.mark.parametrize("spoil", ["joints", "rows", "positions", "quaternions"])
def test_measurements_of_something_else_are_refused(spoil: str) -> None:
    """Columns exchanged, rows out of step, positions or orientations of nothing: no fit hides that."""
    truth, rng = example(100), np.random.default_rng(1)
    measured, q = truth.measured, truth.readings
    assert measured.rotation is not None
    if spoil == "joints":
        q = q[:, [0, 2, 1, 3]]
    elif spoil == "rows":
        q = np.roll(q, 7, axis=0)
    elif spoil == "positions":
        measured = robots.placed(measured, position=rng.uniform(-2, 2, (100, 3)))
    else:
        wrong = [robots.random_placement(rng).rotation for _ in range(100)]
        measured = robots.placed(measured, rotation=np.array(wrong))
    with pytest.raises(MeasurementError, match=r"m\.csv: these measurements are not of this robot.*Check"):
        solve(replace(truth, measured=replace(measured, readings=q)))


def test_large_errors_of_a_robot_are_no_reason_to_refuse_it() -> None:
    """Joint zeros off by ten degrees, lengths by centimetres: that is what calibration is for."""
    rng = np.random.default_rng(2)
    truth = robots.simulate(robots.ur10(), 100, rng, 0.05, 1e-4, world=robots.random_placement(rng))
    assert rms(truth, solve(truth))[1] < 1.3 * np.sqrt(3) * 1e-4


@pytest.mark.parametrize("how", ["relative", "absolute"])
def test_sigmas_of_the_rows_change_no_unit(how: str) -> None:
    """Residuals are weighed by them, but judged in metres."""
    truth = example(80)
    rows = weighed(truth.measured, RowNoise(std=np.full((80, 6), 1e-5), absolute=how == "absolute"))
    found = fit_geometry(robots.campaign().question, truth.model.robot, rows, ())
    assert rms(truth, found)[1] < 1.2 * np.sqrt(3) * 1e-5
