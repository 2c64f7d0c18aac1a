"""What makes measurements of other kinds scatter, and rows that state their noise: named and sized, or nothing is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gauges
import numpy as np
import pytest
import robots
from rich.console import Console
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.noise import repeats
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import LENGTH, TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.rows.dataset import Dataset, RowNoise, factors, weighed
from aridcal.engine.search.loop import CalibratedArm, calibrated_arm, fit_arm, fit_constants, structured_notices
from aridcal.engine.search.noise_causes import NoiseCauses, noise_causes
from aridcal.identify import summary
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.key_figures import verification_agreement
from aridcal.jobs.calibrate.outcome import Outcome, Verification, errors
from aridcal.pages.drawing.html import join
from aridcal.pages.drawing.words import causes_in_words
from aridcal.pages.report.data_section import data as data_section
from aridcal.system.progress import SILENT

ROUNDED = np.radians(0.1)
READING = ROUNDED / np.sqrt(12.0)
"""1-sigma of what is rounded: it lies anywhere in its step."""

BLOCKS: dict[str, Callable[[gauges.Arm], gauges.Measured]] = {
    "distance": lambda arm: gauges.distances(arm, 3, 100),
    "point": lambda arm: gauges.points(arm, 4, 20),
    "plane": lambda arm: gauges.heights(arm, 100),
    "pixels": lambda arm: gauges.pixels(arm, 30),
}
FRAMES_ALONE = {"parameters": {"set": "none"}, "diagnosis": {"enabled": False}}


def rounded(data: Dataset) -> Dataset:
    """The same rows with all joints as a table with one decimal of a degree has them."""
    return replace(data, readings=np.round(data.readings / ROUNDED) * ROUNDED)


def calibrated(folder: Path, arm: gauges.Arm, data: Dataset) -> CalibratedArm:
    job = gauges.campaign(folder, arm, data)
    return calibrated_arm(job.question, arm.robot, data, (), fit_constants(job.question, arm.robot, data, ()), SILENT)


def causes(folder: Path, arm: gauges.Arm, data: Dataset) -> NoiseCauses:
    found = calibrated(folder, arm, data).causes
    assert found is not None
    return found


# ---------------------------------------------------------------- other kinds


@pytest.mark.parametrize("kind", list(BLOCKS))
@pytest.mark.parametrize("seed", [1])
def test_clean_measurements_name_nothing(tmp_path: Path, kind: str, seed: int) -> None:
    arm = gauges.arm(seed)
    found = calibrated(tmp_path, arm, data := gauges.rows(arm, BLOCKS[kind](arm)))
    assert found.causes is not None
    assert (found.causes.further, found.causes.structured, found.rows.relative) == ((), (), None)
    assert found.causes.total == pytest.approx([gauges.NOISE[data.channels[0].name]], rel=0.15)


@pytest.mark.parametrize("kind", [kind for kind in BLOCKS if kind != "distance"])  # `coarse` is of distances
@pytest.mark.parametrize("seed", [1])
def test_rounded_joints_are_named_with_the_size_of_their_rounding(tmp_path: Path, kind: str, seed: int) -> None:
    arm = gauges.arm(seed)
    found = calibrated(tmp_path, arm, rounded(gauges.rows(arm, BLOCKS[kind](arm))))
    assert found.causes is not None
    assert {c.name for c in found.causes.further} == set(arm.robot.readings)
    for cause in found.causes.further:
        assert (cause.kind, cause.unit) == ("joint", "rad")
        assert cause.value == pytest.approx(READING, rel=0.2)
        assert abs(cause.value - READING) < 4 * cause.std
    assert found.rows.relative is not None
    np.testing.assert_allclose(sum(c.share for c in found.causes.causes), 1.0)


def test_rows_are_weighed_by_what_rounded_joints_do_to_them(tmp_path: Path) -> None:
    """By the second road: the covariance of each row from differences of its own residual by the readings."""
    arm = gauges.arm(1)
    data = rounded(gauges.rows(arm, gauges.distances(arm, 3, 100), gauges.levels(arm, 60)))
    job = gauges.campaign(tmp_path, arm, data)
    made = fit_arm(job.question, fit_constants(job.question, arm.robot, data, ()), data, SILENT).diagnosed
    found = noise_causes(made.fit, made.stepwise.state.active, data)
    assert found is not None and found.relative is not None
    fit, step = made.fit, 1e-6
    asked = problem(fit.model, data)
    moved = []
    for k in range(6):
        off = step * (np.arange(6) == k)
        ends = [replace(data, readings=data.readings + sign * off) for sign in (1, -1)]
        r = [problem(fit.model, end).with_states(asked.states).residual(fit.theta) for end in ends]
        moved.append((r[0] - r[1]) / (2 * step))
    J = np.nan_to_num(np.stack(moved, axis=2))
    named = {c.name: c.value for c in found.further}
    assert set(named) == set(data.names)
    reading = np.array([named[name] for name in data.names])
    sigma = np.repeat([c.value for c in found.channels], [1, 2])
    there = np.repeat(data.measures, [1, 2], axis=1)
    wanted = np.einsum("nik,k,njk->nij", J, reading**2, J) + sigma**2 * np.eye(3)
    L = found.relative * sigma
    np.testing.assert_allclose(L @ L.transpose(0, 2, 1), wanted, rtol=1e-5, atol=1e-6 * wanted.max())
    np.testing.assert_allclose(found.relative.diagonal(axis1=1, axis2=2)[~there], 1.0)


def test_one_joint_that_is_misread_is_not_all_of_them(tmp_path: Path) -> None:
    arm = gauges.arm(2)
    data = gauges.rows(arm, gauges.distances(arm, 3, 100))
    off = 5e-4 * np.random.default_rng(5).normal(size=len(data))
    data = replace(data, readings=data.readings + off[:, None] * (np.arange(6) == 1))
    (only,) = causes(tmp_path, arm, data).further
    assert (only.name, only.value) == (arm.robot.readings[1], pytest.approx(5e-4, rel=0.2))


def test_a_reading_that_all_marks_of_an_image_share_is_not_averaged_away(tmp_path: Path) -> None:
    """Were every mark taken for a witness of its own, the std of the reading would be that of 20 times as many images."""
    arm = gauges.arm(1)
    data = gauges.rows(arm, gauges.pixels(arm, 60))
    _, image = np.unique(data.readings, axis=0, return_inverse=True)
    drawn = 6e-4 * np.random.default_rng(5).normal(size=60)
    data = replace(data, readings=data.readings + drawn[image.reshape(-1), None] * (np.arange(6) == 0))
    found = causes(tmp_path, arm, data)
    (only,) = found.further
    assert (only.name, only.value) == (arm.robot.readings[0], pytest.approx(6e-4, rel=0.2))
    (notice,) = structured_notices(found)
    assert "share its error" in notice and "standard deviations are too small" in notice
    # 60 numbers, of which the constants take some: a sigma is known to 1 / sqrt(2 * 60) at the best.
    assert only.std > 0.8 * only.value / np.sqrt(2.0 * 60)


def test_two_instruments_of_very_different_noise_are_not_confused(tmp_path: Path) -> None:
    """A good wire and one that is thirty times worse, and sockets beside them: each has its own, and no joint has any."""
    arm = gauges.arm(4)
    good, bad = gauges.distances(arm, 2, 60), gauges.distances(arm, 2, 60)
    names = {"w0": "v0", "w1": "v1"}
    bad = replace(
        bad,
        refers=np.vectorize(names.get)(bad.refers),
        states={"anchor": {names[k]: v for k, v in bad.states["anchor"].items()}},
        observed=bad.observed + 1.5e-3 * arm.rng.normal(size=bad.observed.shape),
    )
    data = gauges.rows(arm, good, bad, gauges.points(arm))
    anchors = gauges.rows(arm, replace(good, states={"anchor": good.states["anchor"] | bad.states["anchor"]}))
    things = data.instruments.things | {"anchor": anchors.instruments.things["anchor"]}
    data = replace(data, instruments=replace(data.instruments, things=things))
    found = causes(tmp_path, arm, data)
    assert found.further == ()
    wanted = [5e-5, np.hypot(1.5e-3, 5e-5), 1e-4]
    assert [c.value for c in found.channels] == pytest.approx(wanted, rel=0.2)
    assert all(abs(c.value - w) < 4 * c.std for c, w in zip(found.channels, wanted, strict=True))


def test_a_wire_whose_noise_grows_with_its_length_is_recognised(tmp_path: Path) -> None:
    arm = gauges.arm(5)
    wire = gauges.distances(arm, 3, 150)
    wire = replace(wire, observed=wire.observed * (1.0 + 3e-4 * arm.rng.normal(size=wire.observed.shape)))
    (only,) = causes(tmp_path, arm, gauges.rows(arm, wire)).further
    assert (only.kind, only.name, only.unit) == ("length", "distance", "m/m")
    assert only.value == pytest.approx(3e-4, rel=0.2)


def test_a_tracker_beside_other_instruments_is_still_asked_about_range(tmp_path: Path) -> None:
    arm = gauges.arm(6)
    seen = gauges.positions(arm, 150)
    away = np.linalg.norm(seen.observed, axis=1, keepdims=True)
    seen = replace(seen, observed=seen.observed + 5e-4 * away * arm.rng.normal(size=seen.observed.shape))
    found = causes(tmp_path, arm, gauges.rows(arm, seen, gauges.distances(arm, rows=30)))
    (only,) = found.further
    assert (only.kind, only.name) == ("range", "position")
    assert only.value == pytest.approx(5e-4, rel=0.2)


def test_exact_measurements_have_no_cause(tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(gauges, "NOISE", dict.fromkeys(gauges.NOISE, 0.0))
        arm = gauges.arm(7)
        found = causes(tmp_path, arm, gauges.rows(arm, gauges.distances(arm), gauges.points(arm)))
    assert found.further == () and found.total.max() < 1e-8


# ---------------------------------------------------------------- rows that state their noise


def stated(seed: int, own: float, turn: float, correlated: bool) -> Dataset:
    """Poses that state their covariance, which differs tenfold, of an arm that repeats by ``own`` [m] and ``turn`` [rad]."""
    rng = np.random.default_rng(seed)
    placed = robots.random_placement(rng), robots.random_placement(rng, 0.1)
    n = 300
    data = robots.simulate(robots.ur10(), n, rng, 0.0, 0.0, world=placed[0], tip=placed[1]).measured
    std = 1e-4 * 10.0 ** rng.uniform(-0.5, 0.5, (n, 1)) * np.ones((1, 6))
    covariance = std[:, :, None] * np.eye(6) * std[:, None, :]
    if correlated:
        mixed = np.eye(6) + 0.4 * rng.normal(size=(n, 6, 6)) / np.sqrt(6)
        covariance = mixed @ covariance @ mixed.transpose(0, 2, 1)
    off = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(size=(n, 6)))
    off += np.repeat([own, turn], 3) * rng.normal(size=(n, 6))
    assert data.rotation is not None
    turned = Rotation.from_rotvec(off[:, 3:]).as_matrix() @ data.rotation
    data = robots.placed(data, position=data.position + off[:, :3], rotation=turned, test=np.arange(n) % 5 == 0)
    return weighed(data, RowNoise(None, covariance) if correlated else RowNoise(std))


def of_poses(data: Dataset) -> CalibratedArm:
    settings, robot = robots.campaign("pose", **FRAMES_ALONE), robots.ur10()
    return calibrated_arm(settings.question, robot, data, (), fit_constants(settings.question, robot, data, ()), SILENT)


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("seed", [1])
def test_what_the_arm_repeats_by_is_found_beside_stated_noise(seed: int, correlated: bool) -> None:
    made = of_poses(data := stated(seed, 1.5e-4, 1e-4, correlated))
    assert made.causes is not None and made.rows.relative is not None and data.relative is not None
    found = {c.name: c for c in made.causes.further}
    assert {c.kind for c in found.values()} == {"repeatability"}
    assert found["position"].value == pytest.approx(1.5e-4, rel=0.2)
    assert found["rotation"].value == pytest.approx(1e-4, rel=0.2)
    # Rows are weighed by both together, written out.
    sigma = np.repeat([c.value for c in made.causes.channels], 3)
    own = np.repeat([found["position"].value, found["rotation"].value], 3)
    told = data.relative if correlated else data.relative[:, :, None] * np.eye(6)
    wanted = (told * sigma**2) @ told.transpose(0, 2, 1) + own**2 * np.eye(6)
    L = made.rows.relative * sigma
    np.testing.assert_allclose(L @ L.transpose(0, 2, 1), wanted, rtol=1e-6, atol=1e-6 * wanted.max())


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("seed", [1, 2])
def test_rows_that_state_all_of_their_noise_name_nothing(seed: int, correlated: bool) -> None:
    made = of_poses(stated(seed, 0.0, 0.0, correlated))
    assert made.causes is not None and made.causes.further == ()


def test_rows_that_state_their_noise_in_one_block_are_asked_about_that_alone(tmp_path: Path) -> None:
    """A tracker states its rows' noise beside a wire that does not; the arm under the tracker repeats by 0.3 mm more."""
    arm = gauges.arm(8)
    seen, n = gauges.positions(arm, 120), 240
    std = 1e-4 * 10.0 ** arm.rng.uniform(-0.5, 0.7, (n, 1)) * np.ones((1, 3))
    off = std * arm.rng.normal(size=(n, 3)) + 3e-4 * arm.rng.normal(size=(n, 3))
    data = gauges.rows(arm, replace(seen, observed=seen.observed + off), gauges.distances(arm, 3, 60))
    relative = np.ones((len(data), 4))
    relative[:n, :3] = std / np.sqrt(np.mean(std[data.train[:n]] ** 2))
    (only,) = causes(tmp_path, arm, replace(data, relative=relative)).further
    assert (only.kind, only.name, only.unit) == ("repeatability", "position", "m")
    assert only.value == pytest.approx(np.hypot(3e-4, gauges.NOISE["position"]), rel=0.2)


@pytest.mark.parametrize("channels", [(TARGET_POSITION, TARGET_ROTATION, LENGTH), (LENGTH, TARGET_POSITION), (LENGTH,)])
def test_factors_of_any_channels_make_the_covariance_and_leave_each_its_own(channels: tuple) -> None:
    rng, sizes = np.random.default_rng(3), [c.size for c in channels]
    m, typical = sum(sizes), np.array([0.1, 2.0, 0.03])[: len(channels)]
    root = rng.normal(size=(20, m, m))
    covariance = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(m)
    L = factors(covariance, typical, channels)
    made = L * np.repeat(typical, sizes)
    np.testing.assert_allclose(made @ made.transpose(0, 2, 1), covariance, rtol=1e-10, atol=1e-12)
    for k, start in enumerate(np.cumsum([0, *sizes[:-1]])):  # no channel's noise enters those after it
        assert not L[:, start + sizes[k] :, start : start + sizes[k]].any()


# ---------------------------------------------------------------- repeats


def again(of: gauges.Measured, arm: gauges.Arm, times: int, rows: int) -> tuple[gauges.Measured, np.ndarray]:
    """The first rows measured several times more, and the number of each row's configuration."""
    first = np.tile(np.arange(rows), times)
    noise = gauges.NOISE["pixel" if of.kind == "pixels" else "distance"]
    more = of.observed[first] + np.sqrt(2.0) * noise * arm.rng.normal(size=(len(first), of.observed.shape[1]))
    made = replace(
        of,
        q=np.vstack([of.q, of.q[first]]),
        observed=np.vstack([of.observed, more]),
        refers=np.vstack([of.refers, of.refers[first]]),
    )
    return made, np.concatenate([np.arange(len(of.q)), first])


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Wires and marks of which some were measured again: distances scatter by their noise, and marks by theirs."""
    arm = gauges.arm(9)
    wires, first = again(gauges.distances(arm, 2, 60), arm, 3, 30)
    marks = gauges.pixels(arm, 8)
    data = gauges.rows(arm, wires, marks)
    data = data.with_repeats(configuration=np.concatenate([first, len(first) + np.arange(len(marks.q))]))
    test = np.isin(data.repeats.configuration, np.random.default_rng(0).choice(len(data), len(data) // 5))
    return gauges.outcome(tmp_path_factory.mktemp("repeated"), arm, replace(data, test=test))


def test_repeats_scatter_in_the_unit_of_their_channel_and_others_have_none(repeated: Outcome) -> None:
    found = repeated.repeats
    assert found is not None
    assert found.groups == 30 and 110 <= found.rows <= 120
    # One row of the usual noise and three of sqrt(3) times that: their mean square is 2.5 of it.
    assert found.sigma[0] == pytest.approx(np.sqrt(2.5) * gauges.NOISE["distance"], rel=0.2)
    assert np.isnan(found.sigma[1]) and found.freedom[1] == 0.0
    assert np.isnan(found.repeatability)


def test_the_report_tells_repeats_of_wires_and_no_repeatability_of_poses(repeated: Outcome) -> None:
    shown = join(list(data_section(repeated)))
    assert "30 measurements were repeated at the same configuration, of the same thing" in shown
    assert "Repeats scatter by 0.0" in shown and "px" not in shown.split("Repeats scatter by")[1].split("(1σ")[0]
    assert "ISO 9283" not in shown and "Nothing was measured twice" not in shown


def test_marks_of_one_image_are_no_repeats_and_a_second_image_is(tmp_path: Path) -> None:
    arm = gauges.arm(9)
    one = gauges.rows(arm, gauges.pixels(arm, 20))
    assert repeats(one, np.zeros((len(one), 2))) is None
    image = np.unique(one.readings, axis=0, return_inverse=True)[1].reshape(-1)
    two, first = again(gauges.pixels(arm, 20), arm, 1, 40)
    data = gauges.rows(arm, two).with_repeats(configuration=first)
    found = repeats(data, 0.3 * np.random.default_rng(0).normal(size=(len(data), 2)))
    assert found is not None and image.max() == 19
    assert (found.groups, found.rows) == (40, 80)
    assert found.sigma == pytest.approx([0.3], rel=0.25) and np.isnan(found.repeatability)


def test_several_reflectors_have_a_repeatability_in_millimetres() -> None:
    arm = gauges.arm(9)
    data = gauges.rows(arm, gauges.positions(arm, 60), gauges.distances(arm))
    number = np.arange(len(data))
    number[60:120] = number[
        :60
    ]  # the far reflector's rows would repeat the near one's: another target is another thing
    data = data.with_repeats(configuration=np.concatenate([np.arange(120) // 2, number[120:]]))
    r = np.full((len(data), 4), np.nan)
    r[:120, :3], r[120:, 3] = 1e-4 * np.random.default_rng(0).normal(size=(120, 3)), 0.0
    found = repeats(data, r)
    assert found is not None and found.groups == 60
    assert found.sigma[0] == pytest.approx(1e-4, rel=0.2) and np.isnan(found.sigma[1])
    # The mean distance of three numbers of that scatter, and three times its standard deviation: 1.596 + 3 * 0.673 sigma.
    assert found.repeatability == pytest.approx((1.596 + 3 * 0.673) * 1e-4, rel=0.15)


# ---------------------------------------------------------------- what is said


@pytest.fixture(scope="module")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """A draw-wire campaign whose joints have one decimal of a degree."""
    arm = gauges.arm(1)
    data = rounded(gauges.rows(arm, gauges.distances(arm, 3, 100)))
    return gauges.outcome(tmp_path_factory.mktemp("coarse"), arm, data)


def test_screen_report_and_results_say_that_the_joints_are_coarse_and_not_the_wire(coarse: Outcome) -> None:
    said = causes_in_words(coarse)
    assert "Most of what scatters are the readings of the joints" in said and "mrad each" in said
    assert "rounded in the table" in said
    console = Console(record=True, width=600)
    summary(coarse, console)
    assert said in console.export_text()
    noise = result_document(coarse)["noise"]
    assert set(noise["joint_readings"]) == set(coarse.robot.readings)
    for reading in noise["joint_readings"].values():
        assert reading["value"] == pytest.approx(READING, rel=0.2) and reading["unit"] == "rad"
    assert set(noise["channels"]) == {"distance"}
    last = coarse.stage("final").residual[coarse.measurements.train]
    assert coarse.scatter == pytest.approx(np.sqrt(np.mean(last**2, axis=0)), rel=0.1)
    assert coarse.measurements.relative is not None and coarse.causes is not None
    assert sum(c.share for c in coarse.causes.causes) == pytest.approx(1.0)
    assert coarse.noise[0] < 0.5 * coarse.scatter[0]
    assert coarse.verdict.word == "noise_floor"


def test_another_days_wire_is_set_beside_this_days_wire_alone(tmp_path: Path) -> None:
    """A table of one instrument of two is scored with the whole model: nothing is said of the other."""
    arm = gauges.arm(3)
    every = gauges.rows(arm, gauges.points(arm, 2), gauges.distances(arm))
    outcome = gauges.outcome(tmp_path, arm, every)
    day = outcome.measurements.select(outcome.measurements.labels.block == 1)
    residual = {s.name: s.residual[outcome.measurements.labels.block == 1] for s in outcome.stages}
    found = Verification("later.csv", day, residual, np.zeros(len(day), dtype=bool), None)
    holds = verification_agreement(replace(outcome, verification=found))
    mask = outcome.parts()["test"]
    own = errors(outcome.stages[-1].residual, mask, outcome.channels)["distance_mm"]["rms"]
    assert holds is not None and holds[0]
    assert f"mm RMS, {own:.3f} on the" in holds[1]
