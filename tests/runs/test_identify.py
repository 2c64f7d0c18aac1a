"""The main job, end to end: simulated campaigns, and the public UR10 data with their published figures."""

from __future__ import annotations

import io
import json
import re
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
from scipy.spatial.transform import Rotation
from searched import searched

from aridcal import identify, predict
from aridcal.engine.fit.constants import stage_urdf
from aridcal.engine.fit.least_squares import fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.search.loop import fit_constants
from aridcal.engine.trust.halves import halves as compare_halves
from aridcal.jobs.calibrate import pipeline
from aridcal.jobs.calibrate.job_inputs import read_job
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.runs.result_folder import RESULT_FILES

CONTROLLERS = {"kinematics.yaml", "dh.yaml", "dh_modified.yaml", "doty.yaml", "joint_offsets.yaml", "frames.yaml"}
FILES = {
    "result.json",
    "calibrated.urdf",
    "calibration.yaml",
    "report.html",
    "scene.html",
    "residuals.csv",
    *CONTROLLERS,
}


def written(outcome: Outcome) -> bytes:
    return stage_urdf(outcome.stage("geometric").fit)


def chain_of_calibrated_urdf(urdf: bytes, robot, frames: dict, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def, type-arg]
    """Poses by Pinocchio's own reading of calibrated.urdf, between the frames of result.json."""
    model = pin.buildModelFromXML(urdf.decode())
    data = model.createData()
    ends = [pin.SE3(pin.rpy.rpyToMatrix(np.array(f["rpy"])), np.array(f["xyz"])) for f in
            (frames["world_base"], frames["tip_target"])]  # fmt: skip
    index = [model.joints[model.getJointId(name)].idx_q for name in robot.readings]
    R, p = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    for n, row in enumerate(q):
        whole = pin.neutral(model)
        whole[index] = row
        pin.framesForwardKinematics(model, data, whole)
        base, tip = (data.oMf[model.getFrameId(link)] for link in (robot.base, robot.tip))
        T = ends[0] * (base.inverse() * tip) * ends[1]
        R[n], p[n] = T.rotation, T.translation
    return R, p


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[robots.Truth, Path]:
    """One ARID campaign of 120 rows, three of them wild, identified once by the command itself."""
    folder = tmp_path_factory.mktemp("small")
    rng = np.random.default_rng(0)
    truth = robots.simulate(robots.arid(), 120, rng, 2e-3, 1e-4, world=robots.random_placement(rng),
                            tip=robots.random_placement(rng, 0.2))  # fmt: skip
    rows = robots.table(truth)
    rows["split"] = np.where(np.arange(120) % 5 == 4, "test", "train")
    rows.loc[[10, 20], "x"] += 0.01
    rows.loc[30, ["qx", "qy", "qz", "qw"]] = rows.loc[31, ["qx", "qy", "qz", "qw"]].to_numpy()
    rows.loc[40, "y"] = np.nan
    with redirect_stdout(io.StringIO()) as said:
        assert identify.main([str(robots.write_campaign(folder, truth, rows))]) == 0
    (folder / "stdout.txt").write_text(said.getvalue())
    return truth, folder


def test_every_file_appears(small: tuple[robots.Truth, Path]) -> None:
    results = {f.name for f in (small[1] / "results").iterdir()}
    assert results == FILES
    assert results <= RESULT_FILES


def test_what_is_printed_are_the_errors_that_the_files_state(small: tuple[robots.Truth, Path]) -> None:
    _, folder = small
    said = " ".join(re.findall(r"[^\s│┃]+", (folder / "stdout.txt").read_text()))
    for file in ("joint_offsets.yaml", "kinematics.yaml"):
        comment = (folder / "results" / file).read_text().splitlines()[0]
        stated = re.match(r"# (.+): ([\d.]+) mm RMS", comment)
        assert stated is not None
        printed = re.search(rf"{re.escape(stated[1])} ([\d.]+)", said)
        assert printed is not None
        assert float(printed[1]) == pytest.approx(float(stated[2]), abs=1.1e-3)
    error = json.loads((folder / "results" / "result.json").read_text())["error"]
    for stage in ("nominal", "geometric", "final"):
        position, rotation = (error[stage]["test"][name] for name in ("position_mm", "rotation_mrad"))
        figures = [position["rms"], position["p95"], position["max"], rotation["rms"], rotation["p95"]]
        assert " ".join([stage, *(f"{value:.3f}" for value in figures)]) in said


def test_figures_tell_what_was_done(small: tuple[robots.Truth, Path]) -> None:
    result = json.loads((small[1] / "results" / "result.json").read_text())
    n = result["n"]
    assert (n["rows"], n["used"], n["outliers"]) == (120, 119, 3)
    assert (n["train"], n["test"]) == (96 - 3 - 1, 24)
    assert [(r["row"], r["column"]) for r in n["refused"]] == [(42, "y")]
    assert sorted(r["row"] for r in n["outlier_rows"]) == [12, 22, 32]
    test = {stage: e["test"]["position_mm"]["rms"] for stage, e in result["error"].items()}
    assert test["nominal"] > 1.0
    assert test["geometric"] < 1.25 * np.sqrt(3) * 0.1
    assert result["noise"]["source"] == "estimated"
    assert result["noise"]["position_mm"] == pytest.approx(0.1, rel=0.15)
    status = [p["status"] for p in result["parameters"]]
    assert status.count("identified") == 20
    assert all(p["redundant_with"] for p in result["parameters"] if p["status"] == "redundant")
    assert result["convergence"]["geometric"]["converged"]


def test_frames_and_parameters_agree_with_the_truth_within_their_sigmas(small: tuple[robots.Truth, Path]) -> None:
    """What can be compared: predictions anywhere in the range, against the machine as it is."""
    truth, folder = small
    model = SavedModel.load(folder / "results" / "calibration.yaml")
    q = robots.readings(truth.model.robot, 200, np.random.default_rng(1))
    _, p = model.final.poses(q)
    _, exact = truth.model.poses(truth.theta, truth.model.rows(q))
    assert np.sqrt(np.mean(np.sum((p - exact) ** 2, axis=1))) < 3e-4


def test_calibrated_urdf_and_frames_predict_what_the_model_predicts(small: tuple[robots.Truth, Path]) -> None:
    truth, folder = small
    results = folder / "results"
    q = robots.readings(truth.model.robot, 50, np.random.default_rng(2))
    frames = json.loads((results / "result.json").read_text())["frames"]
    R, p = chain_of_calibrated_urdf((results / "calibrated.urdf").read_bytes(), truth.model.robot, frames, q)
    pd.DataFrame(q, columns=truth.model.robot.readings).to_csv(folder / "q.csv", index=False, float_format="%.17g")
    assert predict.main([str(results / "calibration.yaml"), str(folder / "q.csv"), "-o", str(folder / "p.csv")]) == 0
    found = robots.read_csv(folder / "p.csv")
    np.testing.assert_allclose(found[["x", "y", "z"]], p, atol=1e-9, rtol=0)
    turned = Rotation.from_quat(found[["qx", "qy", "qz", "qw"]].to_numpy()).as_matrix()
    np.testing.assert_allclose(turned, R, atol=1e-9, rtol=0)


def test_residuals_are_measured_minus_predicted_row_by_row(small: tuple[robots.Truth, Path]) -> None:
    _, folder = small
    table = pd.read_csv(folder / "results" / "residuals.csv")
    rows = pd.read_csv(folder / "measurements.csv")
    model = SavedModel.load(folder / "results" / "calibration.yaml").final
    used = rows.loc[table["row"] - 2].reset_index(drop=True)
    _, p = model.poses(used[list(model.model.robot.readings)].to_numpy())
    np.testing.assert_allclose(table[["final_x", "final_y", "final_z"]], used[["x", "y", "z"]] - p, atol=2e-9)
    assert set(table.loc[table["weight"] == 0, "row"]) == {12, 22, 32}
    assert (table["split"] == used["split"]).all()


def test_another_day_is_scored_with_the_models_as_they_are(small: tuple[robots.Truth, Path], tmp_path: Path) -> None:
    truth, folder = small
    rng = np.random.default_rng(3)
    q = robots.readings(truth.model.robot, 40, rng)
    R, p = truth.model.poses(truth.theta, truth.model.rows(q))
    p = p + 1e-4 * rng.normal(size=p.shape)
    other = replace(truth, measured=robots.measured(truth.model.robot, q, p, R))
    robots.table(other).to_csv(tmp_path / "other.csv", index=False, float_format="%.17g")
    outcome = pipeline.identify(folder / "campaign.yaml", verify=tmp_path / "other.csv")
    assert outcome.verification is not None
    final = outcome.verification.residuals["final"]
    assert final.shape == (40, 6)
    assert np.sqrt(np.mean(final[:, :3] ** 2)) < 1.5e-4
    assert np.sqrt(np.mean(outcome.verification.residuals["nominal"][:, :3] ** 2)) > 5e-4


def test_another_day_has_a_verdict_of_its_own(
    small: tuple[robots.Truth, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Second road to each verdict: a tripod that moved, and an elbow that did."""
    truth, folder = small
    rng = np.random.default_rng(4)
    q = robots.readings(truth.model.robot, 40, rng)
    bent = q + np.eye(q.shape[1])[2] * 2e-3
    for name, readings, shift in (("remounted", q, np.array([0.0, 5e-3, 0.0])), ("changed", bent, np.zeros(3))):
        R, p = truth.model.poses(truth.theta, truth.model.rows(readings))
        day = replace(
            truth, measured=robots.measured(truth.model.robot, q, p + shift + 1e-4 * rng.normal(size=p.shape), R)
        )
        robots.table(day).to_csv(tmp_path / f"{name}.csv", index=False, float_format="%.17g")
        words = [str(folder / "campaign.yaml"), "-o", str(tmp_path / "out"), "--verify", str(tmp_path / f"{name}.csv")]
        assert identify.main(words) == 3
        assert f"verdict on {name}.csv: {name}" in capsys.readouterr().out


def test_the_campaigns_own_rows_are_no_other_day(
    small: tuple[robots.Truth, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All of them, or a table with a few among others, written anew with fewer digits, in another order.

    A second run with such a table writes the same figures as the first one did without.
    """
    truth, folder = small
    own = pd.read_csv(folder / "measurements.csv")
    shuffled = own.sample(30, random_state=1)
    shuffled.to_csv(tmp_path / "copy.csv", index=False, float_format="%.12g")
    again = tmp_path / "again"
    assert identify.main([str(folder / "campaign.yaml"), "-o", str(again), "--verify", str(tmp_path / "copy.csv")]) == 2
    assert "all 30 rows are the campaign's own" in capsys.readouterr().err
    assert not again.exists()
    rng = np.random.default_rng(3)
    q = robots.readings(truth.model.robot, 40, rng)
    R, p = truth.model.poses(truth.theta, truth.model.rows(q))
    p = p + 1e-4 * rng.normal(size=p.shape)
    new = robots.table(replace(truth, measured=robots.measured(truth.model.robot, q, p, R)))
    repeated = own.head(5).assign(x=own["x"].head(5) + 2e-5)  # the same joints, measured anew
    new.to_csv(tmp_path / "new.csv", index=False, float_format="%.17g")
    parts = pd.concat([new, shuffled.head(7), repeated])[new.columns]  # `split` is of the campaign alone
    parts.to_csv(tmp_path / "mixed.csv", index=False, float_format="%.17g")
    assert (
        identify.main([str(folder / "campaign.yaml"), "-o", str(again), "--verify", str(tmp_path / "mixed.csv")]) == 0
    )
    said = capsys.readouterr().out
    assert "note: 7 of the 52 rows of mixed.csv are the campaign's own" in said
    assert "(mixed.csv, 45 of 45, 7 of the campaign's own left out)" in said
    assert "7 of the 52 rows" in (again / "report.html").read_text()
    found = json.loads((again / "result.json").read_text())["verification"]
    assert (found["rows"], found["own_rows_left_out"]) == (45, 7)
    for name in ("calibrated.urdf", "calibration.yaml", "residuals.csv"):
        assert (again / name).read_bytes() == (folder / "results" / name).read_bytes()
    plain = pd.concat([new, repeated])  # the figure is that of the other rows alone
    _, p = SavedModel.load(again).final.poses(plain[list(truth.model.robot.readings)].to_numpy())
    final = np.sqrt(np.mean(np.sum((plain[["x", "y", "z"]].to_numpy() - p) ** 2, axis=1)))
    assert found["error"]["final"]["position_mm"]["rms"] == pytest.approx(1e3 * final, rel=1e-6)


def test_positions_alone_are_enough(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    truth = robots.simulate(robots.ur10(), 150, rng, 1e-3, 5e-5, world=robots.random_placement(rng),
                            tip=robots.random_placement(rng, 0.2), kind="position")  # fmt: skip
    found = searched(robots.write_campaign(tmp_path, truth))
    assert len(found.arm.geometry.geometric.theta) == 4 * 6 + 3
    assert found.error("geometric") < 1.3 * np.sqrt(3) * 5e-2


def test_a_station_without_training_rows_lends_them_from_the_test(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    truth = robots.simulate(robots.arid(), 60, rng, 1e-3, 1e-5)
    rows = robots.table(truth)
    rows["station"] = np.where(np.arange(60) < 57, "near", "far")
    frames = {"world_base": {"per": "station"}}
    found = searched(robots.write_campaign(tmp_path, truth, rows, frames=frames))
    labels = [label for label, _ in found.fit.model.world_base]
    assert labels == ["far", "near"]
    assert (found.rows.train & (found.rows.labels.station == "far")).any()


def ur10_campaign(folder: Path, series: Path) -> Path:
    (folder / "ur10.urdf").write_bytes((robots.URDF / "ur10.urdf").read_bytes())
    path = folder / "campaign.yaml"
    path.write_text(
        "format: 1\nrobot: {urdf: ur10.urdf, base: base_link, tip: tool0}\n"
        f"measurements: {{file: {series}, noise: {{rows: ignore}}, ignore: [sequence]}}\n"
        "diagnosis: {enabled: false}\n"
    )
    return path


BAD_ROWS = {532, 854, 855, 1063}
"""Known from the data's README: two stale readings, two gross outliers."""


def test_ur10_series_b_reaches_the_published_accuracy(shared_data: Path, tmp_path: Path) -> None:
    """Public tools reach 0.417 to 0.521 mm on one split; asked for: 0.445 mm and 0.91 mrad."""
    outcome = pipeline.identify(ur10_campaign(tmp_path, shared_data / "ur10-laser-tracker" / "series_b.csv"))
    test = outcome.parts()["test"]
    geometric, bare = outcome.stage("geometric"), outcome.stage("nominal")
    position = np.sqrt(np.mean(np.sum(geometric.residual[test, :3] ** 2, axis=1)))
    assert position <= 0.445e-3
    assert np.sqrt(np.mean(np.sum(geometric.residual[test, 3:] ** 2, axis=1))) <= 0.91e-3
    assert np.sqrt(np.mean(np.sum(bare.residual[test, :3] ** 2, axis=1))) == pytest.approx(1.08e-3, rel=0.05)
    sequence = outcome.measurements.origin.line - 2
    # On test rows only what is off by ten robust scales counts: none of the four is.
    assert set(sequence[outcome.outlier]) == BAD_ROWS & set(sequence[~outcome.measurements.test])
    assert len(geometric.fit.theta) == 30
    assert geometric.fit.convergence.converged
    assert geometric.fit.convergence.agreed == geometric.fit.convergence.restarts
    # Its own rows say that geometry is not all, and how well rows that were not fitted are predicted.
    looked = outcome.second_look
    assert looked is not None and looked.folds is not None
    halves = looked.halves["final"]
    assert halves is not None and halves.p_value < 1e-50 and halves.measured > 1.5 * halves.expected
    assert looked.folds.mean[0] == pytest.approx(position, rel=0.06)
    assert_shuffled_residuals_agree(outcome)
    model = geometric.fit.model
    rows = outcome.measurements.readings[:100]
    frames = {
        name: {"xyz": T.translation, "rpy": pin.rpy.matrixToRpy(T.rotation)}
        for name, ((_, T),) in zip(("world_base", "tip_target"), model.frames(geometric.fit.theta), strict=True)
    }
    R, p = chain_of_calibrated_urdf(written(outcome), outcome.robot, frames, rows)
    for a, b in zip(model.poses(geometric.fit.theta, model.rows(rows)), (R, p), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9, rtol=0)


def assert_shuffled_residuals_agree(outcome: Outcome) -> None:
    """Attack: the same residuals dealt out to other rows are no structure, however far from normal they are."""
    train, found = outcome.measurements.select(outcome.measurements.train), outcome.stage("geometric").fit
    rows = train.select(~found.outliers)
    left = np.random.default_rng(0).permutation(found.residual[~found.outliers])
    R, p = found.model.poses(found.theta, problem(found.model, rows).rows)
    dealt = robots.placed(rows, position=p + left[:, :3], rotation=Rotation.from_rotvec(left[:, 3:]).as_matrix() @ R)
    again = fit(problem(found.model, dealt), found.theta, np.ones(len(rows)))
    halves = compare_halves(again, dealt)
    assert halves is not None and halves.p_value > 0.01


def test_ur10_series_d_names_its_degenerate_target_translation(shared_data: Path, tmp_path: Path) -> None:
    """The tool never turns: tip_target's translation goes with world_base's. It is named and nothing runs away."""
    job = read_job(ur10_campaign(tmp_path, shared_data / "ur10-laser-tracker" / "series_d.csv"))
    geometry = fit_constants(job.campaign.question, job.robot, job.rows, ())
    for made in (geometry.nominal, geometry.geometric):
        lost = {name: set(partners) for name, partners in made.redundant.items() if name.startswith("tip_target.")}
        assert {"tip_target.x", "tip_target.y", "tip_target.z"} & set(lost)
        for name, partners in lost.items():
            assert any(p.startswith("world_base.") for p in partners), (name, partners)
        for frames in made.model.frames(made.theta):
            assert np.linalg.norm(frames[0][1].translation) < 10.0
        assert np.linalg.norm(made.model.frames(made.theta)[1][0][1].translation) < 1.0
        assert made.std.max() < 0.02
    held_out = job.rows.select(job.rows.test)
    rms = []
    for made in (geometry.nominal, geometry.geometric):
        left = problem(made.model, held_out).residual(made.theta)[:, :3]
        rms.append(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    assert rms[1] < rms[0]


@pytest.mark.parametrize("of_controller", [True, False])
def test_what_a_controller_worked_out_is_called_no_measurement(of_controller: bool, tmp_path: Path) -> None:
    """A log of a UR has its own model's poses beside the joints: `init` says so, and so does what was made of them by hand."""
    truth = robots.simulate(robots.arid(), 30, np.random.default_rng(2), kind="position")
    names = [f"{'actual' if of_controller else 'tracker'}_TCP_pose_{k}" for k in range(3)]
    columns = dict(zip("xyz", names, strict=True))
    block = {"file": "measurements.csv", "kind": "position", "columns": columns}
    path = robots.write_campaign(tmp_path, truth, robots.table(truth).rename(columns=columns), measurements=block)
    said = [notice for notice in pipeline.identify(path).notices if "no measurement" in notice]
    assert len(said) == of_controller
    assert all(name in notice for notice in said for name in names)
