"""Constants by station: each label deviates by itself, by what its rows say; nothing varies where nothing does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
import yaml
from scipy.spatial.transform import Rotation

from aridcal.calibration import Calibration
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.labels import MOST_LABELS, label_columns
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import parse_robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.loop import CalibratedArm, calibrated_arm, fit_constants
from aridcal.jobs.apply.joint_commands import compensate
from aridcal.jobs.apply.target_poses import evenly, predict, read_query
from aridcal.jobs.calibrate.controllers import controller_exports, write_controllers
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.maintain.checking import check
from aridcal.jobs.maintain.new_rows import read_new_rows
from aridcal.pages.report.effects_section import effects_in_the_model
from aridcal.system.errors import CampaignError, MeasurementError
from aridcal.system.progress import SILENT

NOISE = 1e-4
LABELS = ("hall A", "hall B", "[3]", "lathe", "Ofen")
ZERO = {"kind": "regional", "where": "joint_3", "motion": ["axis"], "by": "station"}
JOINTS = tuple(f"joint_{k}" for k in range(1, 5))
FRAMES = tuple(
    ((None, robots.random_placement(np.random.default_rng(seed), size)),) for seed, size in ((1, 2.0), (2, 0.2))
)


def rows_of(
    label: np.ndarray, off: np.ndarray, seed: int = 0, where: str = "joint_3", component: str = "axis"
) -> Dataset:
    """Rows of an ARID of which one constant is off by so much, row by row."""
    rng, robot = np.random.default_rng(seed), robots.arid()
    q = robots.readings(robot, len(label), rng)
    model = Model(robot, (Coefficient(where, component, Basis("linear", ("off",), (0.0,))),), *FRAMES)
    R, p = model.poses(np.ones(1), model.rows(q, {"off": off}))
    R = Rotation.from_rotvec(NOISE * rng.standard_normal(p.shape)).as_matrix() @ R
    made = robots.measured(robot, q, p + NOISE * rng.standard_normal(p.shape), R)
    return robots.declared(made, NOISE, NOISE).with_labels(station=label)


def calibrated(rows: Dataset, per: str = "", **sections: object) -> CalibratedArm:
    """As `identify` does it."""
    frames = {} if not per else {"frames": {per: {"per": "station"}}}
    asked = robots.campaign("pose", parameters={"set": "doty"}, **(frames | sections))
    labels = tuple(sorted(set(rows.labels.station.tolist()))) if per and rows.labels.station is not None else ()
    return calibrated_arm(
        asked.question, robots.arid(), rows, labels, fit_constants(asked.question, robots.arid(), rows, labels), SILENT
    )


def labelled(seed: int, n: int, labels: int) -> np.ndarray:
    return np.array([f"s{k}" for k in np.random.default_rng([seed, 9]).integers(0, labels, n)])


SEARCHED = {"diagnosis": {"candidates": ("regional",)}}
QUIET = {"diagnosis": {"enabled": False}}


@pytest.fixture(scope="module")
def halls(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path, np.ndarray]:
    """Five labels, in a column that the campaign calls otherwise; the third joint's zero differs; what nobody declares."""
    folder = tmp_path_factory.mktemp("halls")
    rng = np.random.default_rng(5)
    number = rng.integers(0, len(LABELS), 160)
    zeros = np.array([1.2e-3, -0.8e-3, 0.3e-3, -1.1e-3, 0.4e-3])
    rows = rows_of(np.array(LABELS)[number], zeros[number])
    assert rows.rotation is not None
    table = pd.DataFrame(rows.readings, columns=list(JOINTS))
    table[["x", "y", "z"]] = rows.position
    table[["qx", "qy", "qz", "qw"]] = Rotation.from_matrix(rows.rotation).as_quat()
    table["square"] = rows.labels.station
    table.to_csv(folder / "rows.csv", index=False)
    keys = {
        "format": 1,
        "robot": {"urdf": str(robots.URDF / "arid.urdf"), "tip": "flange", "gravity": [0.0, 9.81, 0.0]},
        "measurements": {
            "file": "rows.csv", "noise": {"position": NOISE, "rotation": NOISE}, "columns": {"station": "square"}
        },
        "parameters": {"set": "doty"},
        "diagnosis": {"candidates": ["regional"]},
    }  # fmt: skip
    (folder / "campaign.yaml").write_text(yaml.safe_dump(keys))
    outcome = identify(folder / "campaign.yaml")
    (folder / "calibration.yaml").write_text(calibration(outcome).dump(), "utf-8")
    write_controllers(outcome, controller_exports(outcome), folder)
    return outcome, folder, zeros


def deviations(outcome: Outcome) -> np.ndarray:
    """What each label deviates by, [rad]."""
    fit = outcome.stage("final").fit
    names = [f"joint_3.axis:station[{label}]" for label in LABELS]
    return np.array([fit.theta[fit.model.names.index(name)] for name in names])


def test_what_differs_from_station_to_station_is_found_and_is_right(halls: tuple[Outcome, Path, np.ndarray]) -> None:
    outcome, _, zeros = halls
    (found,) = outcome.effects
    assert (found.effect.kind, found.effect.where, found.effect.by) == ("regional", "joint_3", "station")
    assert found.effect.covariates == ("station",)
    assert outcome.verdict.word == "noise_floor"
    said = deviations(outcome)
    np.testing.assert_allclose(said - said.mean(), zeros - zeros.mean(), atol=5e-5)
    assert abs(said.mean()) < 1e-6  # what all have in common is the one model's
    page = "".join(str(part) for part in effects_in_the_model(outcome))
    assert "Ofen" in page
    assert "fitted rows" in page


def test_predictions_follow_the_label_and_one_never_seen_has_the_one_model(
    halls: tuple[Outcome, Path, np.ndarray],
) -> None:
    outcome, folder, _ = halls
    saved, fit, m = SavedModel.load(folder / "calibration.yaml"), outcome.stage("final").fit, outcome.measurements
    table = pd.DataFrame(m.readings[:40], columns=list(JOINTS)).assign(square=m.labels.station[:40])
    made = predict(saved, read_query(saved, table))
    expected = fit.model.poses(fit.theta, fit.model.rows(m.readings[:40], None, m.labels.station[:40]))[1]
    np.testing.assert_allclose(made[["x", "y", "z"]], expected, atol=1e-12)
    assert not made["extrapolates"].any()
    one = fit.model.with_coefficients([c for c in fit.model.coefficients if c.basis.constant])
    theta = np.array([v for v, c in zip(fit.theta, fit.model.coefficients, strict=True) if c.basis.constant])
    for unseen in ("hall C", ""):
        other = predict(saved, read_query(saved, table.assign(square=unseen)))
        np.testing.assert_allclose(other[["x", "y", "z"]], one.poses(theta, one.rows(m.readings[:40]))[1], atol=1e-12)
        assert other["extrapolates"].all()
    with pytest.raises(MeasurementError, match=r"square.*constants by station.*leave its cell empty"):
        read_query(saved, table.drop(columns="square"))
    assert set(evenly(saved)["square"]) == {sorted(LABELS)[0]}


def test_commands_bring_the_target_to_where_the_model_of_that_label_has_it(
    halls: tuple[Outcome, Path, np.ndarray],
) -> None:
    outcome, folder, _ = halls
    saved, m = SavedModel.load(folder / "calibration.yaml"), outcome.measurements
    middle = m.readings.mean(axis=0)  # off the ends of what was seen, where rounding would decide
    table = pd.DataFrame(middle + 0.95 * (m.readings[:12] - middle), columns=list(JOINTS))
    table["square"] = [*LABELS, "hall C", "", *LABELS]
    wanted = predict(saved, read_query(saved, table))
    seeds = wanted.drop(columns=[c for c in wanted if c.startswith("std_") or c == "extrapolates"])
    seeds[list(JOINTS)] += 0.01
    found = compensate(saved, read_query(saved, seeds, poses=True))
    np.testing.assert_allclose(found[list(JOINTS)], table[list(JOINTS)], atol=1e-6)
    assert found["reached"].all()
    assert found["extrapolates"].tolist() == [False] * 5 + [True] * 2 + [False] * 5
    model, theta = saved.final.model, saved.final.theta
    for k, label in enumerate(table["square"]):  # second road: the whole model for one row
        one = OneRowModel(model, theta, label)
        place = one.pose(table[list(JOINTS)].to_numpy()[k], one.effects(table[list(JOINTS)].to_numpy()[k], {}))[1]
        np.testing.assert_allclose(place, wanted.loc[k, ["x", "y", "z"]].to_numpy(float), atol=1e-12)


def test_each_label_s_urdf_alone_predicts_its_rows(halls: tuple[Outcome, Path, np.ndarray]) -> None:
    """Second road: files alone, read back by Pinocchio."""
    outcome, folder, _ = halls
    index = yaml.safe_load((folder / "regions" / "index.yaml").read_text("utf-8"))["regions"]
    assert [entry["label"] for entry in index.values()] == [*sorted(LABELS), ""]
    frames = yaml.safe_load((folder / "frames.yaml").read_text("utf-8"))["URDF by region"]
    world, tip = (
        pin.SE3(pin.rpy.rpyToMatrix(np.array(frames[f]["rpy"])), np.array(frames[f]["xyz"]))
        for f in ("world_base", "tip_target")
    )
    m, final = outcome.measurements, outcome.stage("final")
    assert m.labels.station is not None
    for entry in index.values():
        robot = parse_robot((folder / "regions" / entry["urdf"]).read_bytes(), "flange")
        R, p = tip_frames(robot, m.readings)
        predicted = (p + R @ tip.translation) @ world.rotation.T + world.translation
        whole = final.fit.model.poses(
            final.fit.theta, final.fit.model.rows(m.readings, None, np.full(len(m), entry["label"]))
        )[1]
        apart = np.linalg.norm(predicted - whole, axis=1)
        assert np.sqrt(np.mean(apart**2)) < 0.2 * NOISE  # at all postures, also those of other labels
        assert entry["rows"]["all"] == (m.labels.station == entry["label"]).sum()
    assert index["region_06"]["rows"] == {"all": 0, "held_out": 0}
    saved = SavedModel.load(folder / "calibration.yaml")
    regions = Calibration(saved, outcome).regions
    assert list(regions["label"]) == [*sorted(LABELS), ""]
    pd.testing.assert_frame_equal(regions, Calibration(saved, folder=folder).regions)


def test_a_check_takes_rows_of_known_labels_alone(halls: tuple[Outcome, Path, np.ndarray]) -> None:
    """A deviation that nobody knows would look like a change: the five labels differ by up to 2 mrad."""
    _, folder, _ = halls
    saved = SavedModel.load(folder / "calibration.yaml")
    table = pd.read_csv(folder / "rows.csv").iloc[:20]
    new = read_new_rows(saved, table)
    assert not check(saved, new.rows).causes
    for other in ("hall C", np.nan):
        with pytest.raises(MeasurementError, match=r"is none of those by which the calibration's constants vary"):
            read_new_rows(saved, table.assign(square=table["square"].where(table.index != 3, other)))
    with pytest.raises(MeasurementError, match=r"take rows of these"):
        read_new_rows(saved, table.drop(columns="square"))


def test_labels_that_mean_nothing_cost_nothing() -> None:
    """Clean campaigns of eight labels: nothing is found; what is declared is left out, or next to nothing."""
    taken = 0
    for seed in range(4):
        rows = rows_of(labelled(seed, 100, 8), np.zeros(100), seed)
        found, stated = (calibrated(rows, **asked).diagnosed for asked in (SEARCHED, QUIET | {"effects": [ZERO]}))
        assert not found.stepwise.state.active
        if stated.stepwise.state.active:
            taken += 1
            own = [k for k, c in enumerate(stated.fit.model.coefficients) if c.basis.form == "label"]
            assert np.ptp(stated.fit.theta[own]) < 5e-5  # half the noise
        else:
            said = [b.what for b in stated.barred if "declared" in b.what]
            assert said == ["regional at joint_3 (station), which is declared,"]
    assert taken <= 1


@pytest.mark.parametrize("size", [1.5e-4, 1e-3])
def test_a_label_of_three_rows_is_believed_as_far_as_they_go(size: float) -> None:
    """Second road: the normal equations of a random effect, its size given: the estimate is that of its rows, shrunk."""
    label = labelled(3, 120, 6)
    label[np.flatnonzero(label == "s0")[3:]] = "s1"
    zeros = size * np.array([1.0, -1.0, 0.7, -0.7, 1.0, -1.0])
    rows = rows_of(label, zeros[np.array([int(word[1:]) for word in label])], 3)
    arm = calibrated(rows, effects=[ZERO], **QUIET)
    (active,) = arm.diagnosed.stepwise.state.active
    fit = arm.diagnosed.fit
    own = [k for k, c in enumerate(fit.model.coefficients) if c.basis.form == "label"]
    assert [fit.model.coefficients[k].basis.of[0] for k in own] == [f"station[s{k}]" for k in range(6)]
    said = fit.theta[own]
    assert 0.4 * size < active.score.tau < 2.0 * size
    apart = np.eye(6) - 1.0 / 6.0
    std = np.sqrt(np.diag(apart @ fit.covariance[np.ix_(own, own)] @ apart))
    assert std[0] > 1.7 * std[1:].max()  # its uncertainty says how few they are
    assert (np.abs(apart @ (said - zeros)) < 3.5 * std).all()
    # one row of normal equations at the optimum: what the rows of a label pull is what its prior holds
    J = fit.model.jacobian(fit.theta, fit.model.rows(rows.readings, None, rows.labels.station))[2]
    left = np.concatenate([fit.residual[:, :3], fit.residual[:, 3:]], axis=1) / NOISE
    mine = label == "s0"
    pulled = float(np.sum(J[mine][:, :, own[0]] / NOISE * left[mine]))
    assert pulled == pytest.approx(said[0] / active.score.tau**2, rel=0.02)


@pytest.mark.parametrize("per", ["world_base", "tip_target"])
def test_what_the_frame_of_each_station_does_is_said_and_not_guessed(per: str) -> None:
    label = labelled(4, 120, 4)
    off = np.array([0.0, 1e-3, -1e-3, 5e-4])[np.array([int(word[1:]) for word in label])]
    rows = rows_of(label, off, 4, per, "x")
    of_frame = {"kind": "regional", "where": per, "by": "station"}
    apart = calibrated(rows, per, effects=[of_frame], **QUIET).diagnosed
    assert not apart.stepwise.state.active
    (said,) = [b for b in apart.barred if "declared" in b.what]
    assert said.what == f"regional at {per} (station), which is declared,"
    assert said.why.startswith("it is confounded with what is fitted without it")
    searched = calibrated(rows, per, **SEARCHED).diagnosed
    assert not searched.stepwise.state.active
    assert f"regional at {per} (station), moving x y z," in [b.what for b in searched.barred]
    one = calibrated(rows, effects=[of_frame], **QUIET).diagnosed  # one frame for all: it is told
    assert [a.effect.where for a in one.stepwise.state.active] == [per]
    assert not [b for b in one.barred if "declared" in b.what]


def test_a_zero_beside_frames_of_stations_is_found_in_the_joint() -> None:
    label = labelled(6, 150, 4)
    off = 1e-3 * np.array([1.0, -1.0, 0.5, -0.5])[np.array([int(word[1:]) for word in label])]
    found = calibrated(rows_of(label, off, 6), "world_base", **SEARCHED).diagnosed
    assert [(a.effect.where, a.effect.motion) for a in found.stepwise.state.active] == [("joint_3", ("axis",))]
    tied = {b.what for b in found.barred if b.why.startswith("it is confounded")}
    assert "regional at joint_1 (station), moving axis," in tied  # the rail moves as the base does


@pytest.mark.parametrize("caused", [True, False])
def test_a_cause_that_goes_with_the_stations_is_told_from_what_is_of_theirs_alone(caused: bool) -> None:
    """Each station has its own temperature: zeros along it are a thermal effect, and zeros anyhow are none."""
    label = labelled(7, 150, 6)
    number = np.array([int(word[1:]) for word in label])
    warm = np.array([20.0, 21.0, 23.0, 26.0, 30.0, 35.0])
    zeros = 1e-4 * (warm - 26.0) if caused else 1e-3 * np.array([0.6, -1.0, 0.9, -0.6, -0.8, 0.9])
    rows = replace(rows_of(label, zeros[number], 7), covariates={"temperature": warm[number]})
    found = calibrated(rows, diagnosis={"candidates": ("thermal", "regional")}).diagnosed.stepwise
    assert [(a.effect.kind, a.effect.where) for a in found.state.active] == [
        ("thermal" if caused else "regional", "joint_3")
    ]


@pytest.mark.parametrize("of", [["temperature"], ["station[a]", "station[b]"], []])
def test_a_file_whose_label_is_none_is_refused(
    halls: tuple[Outcome, Path, np.ndarray], of: list[str], tmp_path: Path
) -> None:
    keys = yaml.safe_load((halls[1] / "calibration.yaml").read_text("utf-8"))
    part = next(c for c in keys["final"]["coefficients"] if c["basis"]["form"] == "label")
    part["basis"]["of"] = of
    (tmp_path / "calibration.yaml").write_text(yaml.safe_dump(keys), "utf-8")
    with pytest.raises(CampaignError, match=r"no function 'label'"):
        SavedModel.load(tmp_path / "calibration.yaml")


def test_columns_of_labels() -> None:
    station = np.array(["a", "", "b]", "a"])
    made = label_columns(["temperature", "station[a]", "station[b]]", "station[c]"], station)
    assert {name: values.tolist() for name, values in made.items()} == {
        "station[a]": [1.0, 0.0, 0.0, 1.0], "station[b]]": [0.0, 0.0, 1.0, 0.0], "station[c]": [0.0] * 4
    }  # fmt: skip
    assert label_columns(["station[a]"], None) == {}


@pytest.mark.parametrize("labels", [1, MOST_LABELS + 1])
def test_no_labels_or_too_many_of_them_are_refused_with_the_reason(labels: int) -> None:
    label = np.array([f"s{k % labels}" for k in range(3 * labels + 60)])
    rows = rows_of(label, np.zeros(len(label)))
    with pytest.raises(CampaignError, match=rf"needs a column `station` with 2 to {MOST_LABELS} different labels"):
        calibrated(rows, effects=[ZERO], **QUIET)
