"""`aridcal recalibrate`: what moved is fitted, the rest is kept, and the folder says where it comes from."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from pathlib import Path

import calibrated
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
import yaml
from calibrated import NOISE, Machine, by_instruments, jump, machine
from simulated_instruments import EYE

import aridcal
from aridcal.__main__ import main
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import urdf_of
from aridcal.engine.fit.problem import problem
from aridcal.engine.robot.chain import parse_robot
from aridcal.files.measurement_settings import Units
from aridcal.jobs.calibrate.folder import write_results
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.maintain.answers import check_lines
from aridcal.jobs.maintain.checking import check
from aridcal.jobs.maintain.likelihoods import likely
from aridcal.jobs.maintain.new_rows import read_new_rows
from aridcal.jobs.maintain.repair import changes, repair_calibration
from aridcal.jobs.maintain.repair_error import left_out_residuals
from aridcal.system.errors import MeasurementError

NAMES = robots.ur10().readings


def error(m: Machine, saved: SavedModel, offset: np.ndarray | float = 0.0) -> float:
    """RMS position error of a calibration where nothing was measured, [m]."""
    q = robots.readings(m.model.robot, 200, np.random.default_rng(0), 0.6)
    _, real = m.model.poses(m.theta, m.model.rows(q + offset))
    _, told = saved.final.poses(q)
    return float(np.sqrt(np.mean(np.sum((told - real) ** 2, axis=1))))


def test_ten_rows_after_a_jump_make_a_calibration_as_good_as_before_and_its_uncertainty_is_that_stated():
    ratios, pulls = [], []
    for seed, kind in enumerate(["pose", "position"] * 2):
        m = machine(300 + seed, kind)
        for joint in range(1, 5):
            rows = m.measured(m.configurations(10), jump(joint, 5e-4))
            mended = repair_calibration(m.saved, check(m.saved, rows))
            assert [c.cause.where for c in mended.changes] == [NAMES[joint]]
            pulls.append((mended.changes[0].value[0] - 5e-4) / mended.changes[0].std[0])
            ratios.append(error(m, mended.saved, jump(joint, 5e-4)) / error(m, m.saved))
            assert error(m, m.saved, jump(joint, 5e-4)) > 2 * error(m, m.saved)
    assert np.sqrt(np.mean(np.square(ratios))) < 1.15
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.4


@pytest.mark.parametrize(
    ("kind", "joint", "size"),
    [
        ("position", 1, -2.9), ("pose", 2, 3.1), ("position", 5, 2 * np.pi / 100),
        ("pose", 3, 2 * np.pi + 1.7),
    ],
)  # fmt: skip
def test_a_motor_put_in_anywhere_is_recovered(kind, joint, size):
    """Also beyond what small steps lead back from, by a turn of the motor behind a gear of 100, and by more than a whole turn."""
    m = machine(1, kind)
    mended = repair_calibration(m.saved, check(m.saved, m.measured(m.configurations(10), jump(joint, size))))
    assert mended.changes[0].cause.where == NAMES[joint]
    assert np.angle(np.exp(1j * (mended.changes[0].value[0] - size))) == pytest.approx(0.0, abs=3e-4)
    assert error(m, mended.saved, jump(joint, size)) < 1.5 * error(m, m.saved)


def test_an_encoder_that_jumped_by_a_whole_turn_moves_nothing():
    m = machine(1)
    assert check(m.saved, m.measured(m.configurations(8), jump(3, 2 * np.pi))).good


def test_a_motor_put_in_anywhere_takes_its_gear_error_with_it():
    """The wave is of the axis, and its phase is another on the new readings: both are named, and both are mended."""
    wave = [Coefficient("elbow_joint", "axis", Basis(form, ("elbow_joint",), (2.0,))) for form in ("sin", "cos")]
    m = machine(5, effects=((wave[0], 8e-4), (wave[1], 3e-4)))
    found = check(m.saved, m.measured(m.configurations(20), jump(2, 1.2)))
    assert [(c.kind, c.where) for c in found.causes] == [("zero", "elbow_joint"), ("effect", "elbow_joint")]
    mended = repair_calibration(m.saved, found).saved
    assert error(m, mended, jump(2, 1.2)) < 1.5 * error(m, m.saved)
    assert any("set the controller's zero" in line for line in check_lines(found, changes(found), Units()))


def test_what_did_not_move_is_kept():
    """Every other coefficient stays within what was known of it, and none is less well known than before."""
    m = machine(2)
    before = m.saved.final
    after = repair_calibration(m.saved, check(m.saved, m.measured(m.configurations(10), jump(2, 2e-3)))).saved.final
    index = {name: k for k, name in enumerate(after.model.names)}
    kept = [index[name] for name in before.model.names]
    assert len(after.theta) == len(before.theta) + 1  # the zero of the elbow
    std = np.sqrt(np.diag(before.covariance))
    others = [not c.where.startswith(("world_base", "tip_target")) for c in before.model.coefficients]
    assert np.all((np.abs(after.theta[kept] - before.theta) < 3 * std)[others])
    assert np.all(np.sqrt(np.diag(after.covariance))[kept] < 1.001 * std)
    assert np.linalg.eigvalsh(after.covariance).min() > -1e-18


@pytest.mark.parametrize("joint", [4])
def test_the_urdf_has_the_zero_in_it(joint):
    """Pinocchio on the URDF alone, and the model, are one robot."""
    m = machine(3)
    mended = repair_calibration(m.saved, check(m.saved, m.measured(m.configurations(10), jump(joint, 0.3)))).saved
    urdf = urdf_of(mended.geometric.model, mended.geometric.theta)
    tree = pin.buildModelFromXML(urdf.decode())
    data = tree.createData()
    tip = tree.getFrameId("tool0")
    base, tool = (frames[0][1] for frames in mended.geometric.model.frames(mended.geometric.theta))
    q = m.configurations(20)
    _, told = mended.geometric.poses(q)
    for row, place in zip(q, told, strict=True):
        pin.framesForwardKinematics(tree, data, row)
        np.testing.assert_allclose((base * data.oMf[tip] * tool).translation, place, atol=1e-9)
    assert parse_robot(urdf, "tool0").readings == NAMES


@pytest.mark.parametrize(
    ("what", "said"), [("clean", "nothing moved"), ("row", "nothing to repair"), ("another robot", "identify")]
)
def test_what_cannot_be_repaired_is_refused_with_the_remedy(what, said):
    m = machine(4)
    rows = m.measured(m.configurations(12))
    if what == "row":
        rows.position[5] += 3e-3
    if what == "another robot":
        other = machine(4)
        rng = np.random.default_rng(0)
        theta = other.theta + 3e-3 * rng.normal(size=len(other.theta))
        q = m.configurations(12)
        rows = calibrated.measured(m.model, theta, q, q, NOISE, rng, "pose")
    with pytest.raises(MeasurementError, match=said):
        repair_calibration(m.saved, check(m.saved, rows))


def test_rows_left_out_are_predicted_as_if_they_had_never_been_there():
    """By a second road: the repair made again without each row, and that row predicted."""
    m = machine(6)
    rows = m.measured(m.configurations(8), jump(3, 2e-3))
    found = check(m.saved, rows)
    left = left_out_residuals(found, likely(found.question).theta)
    assert [c.where for c in found.causes] == ["wrist_1_joint"]
    for k in range(8):
        some = check(m.saved, rows.select(np.arange(8) != k))
        assert [c.where for c in some.causes] == ["wrist_1_joint"]
        without = repair_calibration(m.saved, some).saved.final
        alone = problem(without.model, rows.select(np.arange(8) == k)).residual(without.theta)[0]
        np.testing.assert_allclose(left[k], alone, atol=0.02 * NOISE)


def test_a_repair_that_would_be_a_guess_is_refused_and_what_would_tell_is_said(tmp_path):
    m = machine(7)
    new = read_new_rows(m.saved, by_instruments(m, tmp_path, ["inclination"], jump(2, 2e-3), n=12))
    found = check(m.saved, new.rows, frames=new.frames)
    with pytest.raises(MeasurementError, match="measure what would tell"):
        repair_calibration(m.saved, found)


# -- the command


@pytest.mark.parametrize("kind", ["distance", "pixels"])
def test_rows_of_another_instrument_write_a_whole_folder(kind, results, tmp_path, capsys):
    instruments = {"cameras": {"eye": EYE}} if kind == "pixels" else None
    path = by_instruments(machine(7), tmp_path, [kind], jump(2, 2e-3), instruments, n=8 if kind == "pixels" else 20)
    out = tmp_path / "repaired"
    assert main(["recalibrate", str(results), str(path), "-o", str(out)]) == 0
    assert "moved: the zero of elbow_joint" in capsys.readouterr().out
    assert "is not drawn" not in (out / "report.html").read_text()
    found = json.loads((out / "result.json").read_text())
    assert set(found["instruments"]) == {
        "cameras" if kind == "pixels" else "anchors" if kind == "distance" else "points"
    } | ({"boards", "markers"} if kind == "pixels" else set())
    (key,) = {"point": ["position_mm"], "distance": ["distance_mm"], "pixels": ["pixel_px"]}[kind]
    before, after = (found["error"][stage]["new_rows"][key]["rms"] for stage in ("before", "after"))
    assert after < 0.5 * before
    assert main(["check", str(out), str(path)]) == 0
    assert SavedModel.load(out).final.model.instruments.things == {}


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """A result folder of machine 7 with a declared effect, as `identify` writes it but for the report."""
    folder = tmp_path_factory.mktemp("results")
    m = machine(7)
    truth = robots.Truth(m.model, m.theta, m.measured(m.configurations(80)))
    effects = [{"kind": "joint_harmonic", "where": "elbow_joint", "order": 2}]
    outcome = identify(robots.write_campaign(folder, truth, effects=effects))
    (folder / "results").mkdir()
    write_results(outcome, folder / "results")
    return folder / "results"


def new_rows(path: Path, offset: np.ndarray | float, seed: int = 7) -> Path:
    m = machine(seed)
    return calibrated.table(m.measured(m.configurations(10), offset), path)


@pytest.fixture(scope="module")
def repaired(results, tmp_path_factory) -> tuple[Path, Path]:
    """New rows after the elbow's zero moved by 1 mrad, and the folder that is made with them."""
    folder = tmp_path_factory.mktemp("repaired")
    csv = new_rows(folder / "new.csv", jump(2, 1e-3))
    old, said = (results / "calibration.yaml").read_bytes(), io.StringIO()
    with contextlib.redirect_stdout(said):
        assert main(["recalibrate", str(results), str(csv), "-o", str(folder / "repaired")]) == 0
    assert "moved: the zero of elbow_joint, by +1.0" in said.getvalue()
    assert (results / "calibration.yaml").read_bytes() == old
    return csv, folder / "repaired"


def test_the_folder_says_where_it_comes_from_and_can_be_used_at_once(results, repaired, tmp_path):
    csv, out = repaired
    old = (results / "calibration.yaml").read_bytes()
    every = {p.name for p in results.iterdir()} | {
        "report.html",
        "scene.html",
        "kinematics.yaml",
        "dh.yaml",
        "frames.yaml",
    }
    assert every <= {p.name for p in out.iterdir()}

    found = json.loads((out / "result.json").read_text())
    lineage = found["lineage"]
    assert lineage == yaml.safe_load((out / "calibration.yaml").read_text())["lineage"]
    assert lineage["from"] == str(results / "calibration.yaml")
    assert lineage["sha256"] == hashlib.sha256(old).hexdigest()
    assert lineage["rows"]["used"] == list(range(2, 12)) and lineage["rows"]["left_out"] == []
    assert lineage["moved"] == ["elbow_joint"] and lineage["before"] is None
    (moved,) = found["moved"]
    (change,) = moved["changes"]
    assert change["value"] == pytest.approx(1e-3, abs=5 * change["std"]) and change["unit"] == "rad"
    before, after, left = (found["error"][s]["new_rows"]["position_mm"]["rms"] for s in ("before", "after", "left_out"))
    assert after < left < 0.15 < before
    assert found["error"]["final"]["train"]["position_mm"]["rms"] == after
    assert found["error"]["before"]["test"]["position_mm"]["rms"] is None
    rows = pd.read_csv(out / "residuals.csv")
    for name, value in (("before", before), ("final", after), ("left_out", left)):
        squares = rows[[f"{name}_{axis}" for axis in "xyz"]].pow(2).sum(axis=1)
        assert 1e3 * np.sqrt(squares.mean()) == pytest.approx(value, rel=1e-6)

    old_result = json.loads((results / "result.json").read_text())
    (effect,), (was,) = found["effects"], old_result["effects"]
    assert (effect["kind"], effect["where"]) == (was["kind"], was["where"])
    own = {c["name"]: c for c in effect["coefficients"]}
    model = SavedModel.load(out).final
    for c in was["coefficients"]:
        k = model.model.names.index(c["name"])
        assert own[c["name"]]["value"] == model.theta[k] == pytest.approx(c["value"], abs=4 * c["std"])
    status = {p["name"]: p for p in found["parameters"]}
    assert status["elbow_joint.axis"]["value"] == pytest.approx(1e-3, abs=1e-4)
    assert status["elbow_joint.axis"]["unit"] == "rad" and status["elbow_joint.axis"]["std"] < 1e-4
    redundant = [p for p in old_result["parameters"] if p["status"] == "redundant"]
    assert redundant and all(status[p["name"]] == p for p in redundant)
    page = (out / "report.html").read_text()
    assert "is not drawn" not in page and "the zero of elbow_joint" in page and lineage["sha256"][:16] in page
    loaded = aridcal.load(out)
    assert loaded.errors.loc[("final", "train"), "position_rms_mm"] == pytest.approx(after)
    assert "noise_floor" in repr(loaded)

    assert main(["check", str(out), str(csv)]) == 0
    assert main(["check", str(results), str(csv)]) == 3
    told, back = tmp_path / "told.csv", tmp_path / "back.csv"
    assert main(["predict", str(out / "calibration.yaml"), str(csv), "-o", str(told)]) == 0
    asked, answer = pd.read_csv(csv), pd.read_csv(told)
    assert np.abs(answer[["x", "y", "z"]] - asked[["x", "y", "z"]]).to_numpy().max() < 5 * NOISE
    assert main(["compensate", str(out / "calibration.yaml"), str(told), "-o", str(back)]) == 0
    np.testing.assert_allclose(pd.read_csv(back)[list(NAMES)], asked[list(NAMES)], atol=1e-6)


def test_rows_marked_test_are_scored_and_never_fitted(results, tmp_path, capsys):
    """Whatever they say, the repair is the same; and their error is stated apart."""
    table = pd.read_csv(new_rows(tmp_path / "new.csv", jump(2, 1e-3))).assign(split=["test"] * 3 + ["train"] * 7)
    found = {}
    for name, shift in (("as they are", 0.0), ("elsewhere", 0.01)):
        table.assign(x=table["x"] + shift * (table["split"] == "test")).to_csv(tmp_path / "split.csv", index=False)
        assert main(["recalibrate", str(results), str(tmp_path / "split.csv"), "-o", str(tmp_path / name)]) == 0
        assert "on 3 held-out rows" in capsys.readouterr().out
        found[name] = json.loads((tmp_path / name / "result.json").read_text())
    one, other = found.values()
    assert one["moved"] == other["moved"] and one["parameters"] == other["parameters"]
    errors = [result["error"]["after"]["test"]["position_mm"]["rms"] for result in (one, other)]
    assert errors[0] < 0.2 and errors[1] == pytest.approx(10.0, rel=0.03)
    assert one["lineage"]["rows"]["used"] == list(range(5, 12))


def test_python_checks_and_mends_as_the_commands_do(results, tmp_path, capsys):
    csv = new_rows(tmp_path / "new.csv", jump(2, 1e-3))
    loaded = aridcal.load(results)
    found = loaded.check(pd.read_csv(csv))
    main(["check", str(results), str(csv)])
    assert capsys.readouterr().out == f"{found!r}\n"
    assert not found.good and found.p_value < 1e-9
    assert list(found.moved["moved"]) == ["elbow_joint"]
    assert found.moved["value"][0] == pytest.approx(1e-3, abs=1e-4)
    assert loaded.check(csv, tolerance=5e-3).good
    mended = loaded.recalibrate(csv, tmp_path / "mended")
    again = mended.check(csv)
    assert again.good and len(again.moved) == 0
    assert "fitted" in repr(mended) and (tmp_path / "mended" / "report.html").is_file()
    with pytest.raises(aridcal.AridcalError, match="save it"):
        aridcal.Calibration(loaded.model).recalibrate(csv, tmp_path / "other")


def test_a_second_repair_keeps_the_lineage_of_the_first(repaired, tmp_path):
    once, twice = repaired[1], tmp_path / "twice"
    second = new_rows(tmp_path / "second.csv", jump(2, 1e-3) + jump(4, -2e-3))
    assert main(["recalibrate", str(once / "calibration.yaml"), str(second), "-o", str(twice)]) == 0
    lineage = json.loads((twice / "result.json").read_text())["lineage"]
    assert lineage["moved"] == ["wrist_2_joint"]
    assert lineage["before"]["moved"] == ["elbow_joint"]
    assert main(["check", str(twice), str(second)]) == 0


def test_nothing_is_written_where_nothing_moved_or_over_what_is_repaired(results, tmp_path, capsys):
    clean = new_rows(tmp_path / "clean.csv", 0.0)
    bad = new_rows(tmp_path / "bad.csv", jump(3, 1e-3))
    assert main(["recalibrate", str(results), str(clean), "-o", str(tmp_path / "out")]) == 2
    assert "nothing moved" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    before = {p.name: p.read_bytes() for p in results.iterdir()}
    assert main(["recalibrate", str(results), str(bad), "-o", str(results)]) == 2
    assert "name another" in capsys.readouterr().err
    assert {p.name: p.read_bytes() for p in results.iterdir()} == before
