"""Predictions: the query kept as it was, poses filled in to the last digit, and what cannot be told said so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
from arid_saved import calibration, inside
from scipy.spatial.transform import Rotation

from aridcal import predict
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.robot.kinematics import rotations
from aridcal.files.measurement_settings import MeasurementSettings
from aridcal.jobs.apply.target_poses import orientations
from aridcal.jobs.calibrate.saved_model import SavedModel

QUATERNION = ["qx", "qy", "qz", "qw"]
STD = [f"std_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")]


def run(folder: Path, model: SavedModel, query: pd.DataFrame, out: str = "out.csv") -> tuple[int, Path]:
    (folder / "calibration.yaml").write_text(model.dump(), encoding="utf-8")
    query.to_csv(folder / "query.csv", index=False, float_format="%.17g")
    target = folder / out
    return predict.main([str(folder / "calibration.yaml"), str(folder / "query.csv"), "-o", str(target)]), target


def test_prediction_is_the_product_of_the_frames(tmp_path: Path) -> None:
    """Second road: the URDF's joints multiplied out by hand, with the two constants put in."""
    model, query = calibration(), inside(20)
    status, out = run(tmp_path, model, query)
    assert status == 0
    found = robots.read_csv(out)
    world, tip = (f[0][1] for f in (model.final.model.world_base, model.final.model.tip_target))
    pitch = pin.SE3(pin.utils.rotate("y", 1e-3), np.zeros(3))
    shift = pin.SE3(np.eye(3), np.array([0.0, 1e-3, 0.0]))
    robot = robots.arid()
    for k, q in enumerate(query.to_numpy()):
        T = world
        for j, joint in enumerate(robot.joints):
            T = T * robot.onward[j] * {"joint_2": pitch, "joint_4": shift}.get(joint.name, pin.SE3.Identity())
            if joint.kind == "prismatic":
                T = T * pin.SE3(np.eye(3), q[j] * joint.axis)
            else:
                T = T * pin.SE3(rotations(joint.axis, q[j : j + 1])[0], np.zeros(3))
        T = T * robot.tip_before * robot.tip_origin * tip
        row = found.iloc[k]
        np.testing.assert_allclose(row[["x", "y", "z"]].to_numpy(float), T.translation, atol=1e-13, rtol=0)
        R = Rotation.from_quat(row[["qx", "qy", "qz", "qw"]].to_numpy(float)).as_matrix()
        np.testing.assert_allclose(R, T.rotation, atol=1e-14, rtol=0)


def test_columns_and_rows_are_kept_in_order_and_the_pose_is_overwritten(tmp_path: Path) -> None:
    query = inside(30)
    query.insert(0, "note", [f"shot {k}" for k in range(30)])
    query.insert(2, "z", 99.0)
    query["count"] = np.arange(30)
    status, out = run(tmp_path, calibration(), query)
    assert status == 0
    found = robots.read_csv(out)
    assert list(found)[:7] == ["note", "joint_1", "z", "joint_2", "joint_3", "joint_4", "count"]
    assert list(found)[7:] == ["x", "y", *QUATERNION, *STD, "extrapolates"]
    kept = ["note", "joint_1", "joint_2", "joint_3", "joint_4", "count"]
    pd.testing.assert_frame_equal(found[kept], query[kept], check_exact=True)
    assert (found["z"] != 99.0).all()


def test_written_poses_are_exact(tmp_path: Path) -> None:
    model, query = calibration(), inside(50)
    run(tmp_path, model, query)
    found = robots.read_csv(tmp_path / "out.csv")
    loaded = SavedModel.load(tmp_path / "calibration.yaml")
    _, p = loaded.final.poses(query.to_numpy())
    assert np.array_equal(found[["x", "y", "z"]].to_numpy(), p)
    assert (found["qw"] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(found[["qx", "qy", "qz", "qw"]], axis=1), 1.0, atol=1e-15)


def test_csv_and_parquet_hold_the_same(tmp_path: Path) -> None:
    model, query = calibration(), inside(10)
    _, csv = run(tmp_path, model, query, "a.csv")
    _, parquet = run(tmp_path, model, query, "a.parquet")
    there = pd.read_parquet(parquet)
    assert there["extrapolates"].dtype == bool
    names = ["x", "y", "z", "qx", "qy", "qz", "qw"]
    assert np.array_equal(robots.read_csv(csv)[names], there[names])


def test_rows_outside_the_ranges_seen_are_marked(tmp_path: Path) -> None:
    effect = Coefficient("joint_3", "axis", Basis("linear", ("temperature",), (20.0,)))
    query = inside(4)
    query["temperature"] = [20.0, 30.0, 30.1, 20.0]
    query.loc[3, "joint_2"] = 1.95
    _, out = run(tmp_path, calibration(effects=(effect,)), query)
    assert pd.read_csv(out)["extrapolates"].tolist() == [False, False, True, True]
    assert out.read_text().splitlines()[1].endswith("false")


def test_a_covariate_that_no_effect_needs_does_not_matter(tmp_path: Path) -> None:
    query = inside(3)
    query["temperature"] = [20.0, 900.0, np.nan]
    status, out = run(tmp_path, calibration(), query)
    assert status == 0
    assert not pd.read_csv(out)[["x", "extrapolates"]].isna().any(axis=None)
    assert not pd.read_csv(out)["extrapolates"].any()


def test_a_missing_covariate_is_an_error_that_names_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    effect = Coefficient("joint_3", "axis", Basis("linear", ("temperature",), (20.0,)))
    status, out = run(tmp_path, calibration(effects=(effect,)), inside(3))
    assert status == 2
    assert "'temperature'" in capsys.readouterr().err
    assert not out.exists()


def test_effects_act_with_the_gravity_that_the_calibration_was_made_with(tmp_path: Path) -> None:
    """ARID hangs on a horizontal rail: with gravity along the rail joint 2 would carry no torque at all."""
    sag = Coefficient("joint_2", "axis", Basis("linear", ("joint_2.gravity_torque",), (0.0,)))
    bare, sagging = calibration(), calibration(effects=(sag,))
    query = inside(5)
    _, out = run(tmp_path, sagging, query)
    found = robots.read_csv(out)[["x", "y", "z"]].to_numpy()
    _, straight = bare.final.poses(query.to_numpy())
    _, expected = sagging.final.poses(query.to_numpy())
    np.testing.assert_allclose(found, expected, atol=1e-12, rtol=0)
    assert np.linalg.norm(expected - straight, axis=1).min() > 1e-3


def test_row_that_lacks_a_joint_has_no_pose_and_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    effect = Coefficient("joint_3", "axis", Basis("linear", ("temperature",), (20.0,)))
    query = inside(4)
    query["temperature"] = [20.0, 20.0, np.nan, 20.0]  # of a row that has no pose anyway
    query.loc[2, "joint_1"] = np.nan
    status, out = run(tmp_path, calibration(effects=(effect,)), query)
    assert status == 0
    pose = pd.read_csv(out)[["x", "y", "z", "qx", "qy", "qz", "qw"]].isna().to_numpy()
    assert np.array_equal(pose.all(axis=1), [False, False, True, False])
    assert not pose[[0, 1, 3]].any()
    said = " ".join(capsys.readouterr().err.split())
    assert "line 4: column 'joint_1': empty" in said
    assert "1 without a pose" in said


@pytest.mark.parametrize("cell", ["", "warm", "1e308"])
def test_a_hole_in_a_covariate_that_an_effect_needs_is_an_error(
    cell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    effect = Coefficient("joint_3", "axis", Basis("linear", ("temperature",), (20.0,)))
    query = inside(4)
    query["temperature"] = ["20", cell, "21", cell]
    status, out = run(tmp_path, calibration(effects=(effect,)), query)
    assert (status, out.exists()) == (2, False)
    said = " ".join(capsys.readouterr().err.split())
    assert "line 3: column 'temperature'" in said
    assert "missing, like 1 more in this column; the calibration has an effect that depends on it" in said


def test_a_word_in_a_joint_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    query = inside(4).astype(object)
    query.loc[1, "joint_3"] = "home"
    status, out = run(tmp_path, calibration(), query)
    assert (status, out.exists()) == (2, False)
    said = " ".join(capsys.readouterr().err.split())
    assert "line 3: column 'joint_3', home: not a number; write one, or leave the cell empty" in said


def test_a_query_without_a_usable_row_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    query = inside(2)
    query["joint_1"] = np.nan
    status, out = run(tmp_path, calibration(), query)
    assert (status, out.exists()) == (2, False)
    assert "line 2" in capsys.readouterr().err


def test_positions_only_leave_no_orientation(tmp_path: Path) -> None:
    query = inside(3)
    query["qw"] = 1.0
    status, out = run(tmp_path, calibration("position"), query)
    assert status == 0
    assert list(pd.read_csv(out)) == [
        "joint_1",
        "joint_2",
        "joint_3",
        "joint_4",
        "x",
        "y",
        "z",
        *STD[:3],
        "extrapolates",
    ]


def test_each_row_is_seen_from_its_own_station(tmp_path: Path) -> None:
    model = calibration(stations=("A", "B"))
    query = pd.concat([inside(1)] * 2, ignore_index=True).assign(station=["A", "B"])
    status, out = run(tmp_path, model, query)
    assert status == 0
    found = robots.read_csv(out)[["x", "y", "z"]].to_numpy()
    a, b = (frame for _, frame in model.final.model.world_base)
    np.testing.assert_allclose((b * a.inverse()).act(found[0]), found[1], atol=1e-12)


@pytest.mark.parametrize(("stations", "culprit"), [(None, "'station'"), (["A", "Z"], "'Z'")])
def test_station_must_be_given_and_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], stations: list[str] | None, culprit: str
) -> None:
    query = inside(2) if stations is None else inside(2).assign(station=stations)
    status, out = run(tmp_path, calibration(stations=("A", "B")), query)
    assert (status, out.exists()) == (2, False)
    assert culprit in capsys.readouterr().err


def test_tables_speak_as_the_campaigns_tables_do(tmp_path: Path) -> None:
    """Its columns and units: a prediction can be read back as measurements of the same campaign."""
    text = (
        "format: 1\nrobot: {urdf: arid.urdf, tip: flange}\nmeasurements:\n  file: m.csv\n"
        "  units: {length: mm, angle: deg}\n  columns: {x: X, joint_2: A2}\n"
    )
    query = inside(6)
    _, out = run(tmp_path, calibration(), query)
    plain = robots.read_csv(out)
    other = pd.DataFrame({
        "joint_1": 1e3 * query["joint_1"],
        "A2": np.degrees(query["joint_2"]),
        "joint_3": np.degrees(query["joint_3"]),
        "joint_4": np.degrees(query["joint_4"]),
    })  # fmt: skip
    status, out = run(tmp_path, calibration(text=text), other, "other.csv")
    assert status == 0
    found = robots.read_csv(out)
    np.testing.assert_allclose(found[["X", "y", "z"]], 1e3 * plain[["x", "y", "z"]], atol=1e-9)
    np.testing.assert_allclose(found["qw"], plain["qw"], atol=1e-12)
    assert "x" not in found


@pytest.mark.parametrize("sequence", ["ZYX", "xyz", "ZYZ"])
def test_euler_angles_are_written_in_the_campaigns_columns(tmp_path: Path, sequence: str) -> None:
    """Second road: the quaternions of the same calibration without that campaign, turned by scipy."""
    query = inside(20)
    _, out = run(tmp_path, calibration(), query)
    plain = robots.read_csv(out)
    text = (
        "format: 1\nrobot: {urdf: arid.urdf, tip: flange}\nmeasurements:\n  file: m.csv\n  units: {angle: deg}\n"
        f"  orientation: {{euler: {sequence}, columns: [A, B, C]}}\n"
    )
    other = query.assign(B=0.0, qx=0.5, **{name: np.degrees(query[name]) for name in list(query)[1:]})
    status, out = run(tmp_path, calibration(text=text), other, "other.csv")
    assert status == 0
    found = robots.read_csv(out)
    assert sorted({*found} - {*query}) == sorted(["A", "B", "C", *STD, "extrapolates", "x", "y", "z"])
    angles = found[["A", "B", "C"]].to_numpy()
    apart = Rotation.from_euler(sequence, angles, degrees=True) * Rotation.from_quat(plain[QUATERNION]).inv()
    assert apart.magnitude().max() < 1e-12


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_nothing_stale_is_left_beside_a_new_pose(tmp_path: Path, kind: str) -> None:
    """Old standard deviations, and orientations of another writing, are replaced or gone, whatever they are called."""
    text = (
        f"format: 1\nrobot: {{urdf: arid.urdf, tip: flange}}\nmeasurements:\n  file: m.csv\n  kind: {kind}\n"
        "  orientation: {rotvec: [u, v, w]}\n  columns: {std_x: sx, qx: i}\n  units: {length: mm, angle: deg}\n"
    )
    query = in_mm_and_degrees(inside(5))
    old = [*STD, "sx", *QUATERNION, "u", "v", "w", "x"]
    status, out = run(tmp_path, calibration(kind, text=text), query.assign(**dict.fromkeys(old, 99.0), note="kept"))
    assert status == 0
    found = robots.read_csv(out)
    written = {"x", "y", "z", "sx", "std_y", "std_z"}
    written |= {"u", "v", "w", "std_rx", "std_ry", "std_rz"} if kind == "pose" else set()
    assert {*found} == {*query, *written, "note", "extrapolates"}
    assert not (found[sorted(written)] == 99.0).any(axis=None)


def in_mm_and_degrees(query: pd.DataFrame) -> pd.DataFrame:
    return query.assign(joint_1=1e3 * query["joint_1"], **{name: np.degrees(query[name]) for name in list(query)[1:]})


def test_standard_deviations_are_in_the_campaigns_units_and_those_of_the_model(tmp_path: Path) -> None:
    model, query = calibration(), inside(6)
    _, out = run(tmp_path, model, query)
    std = model.final.std(query.to_numpy())
    assert std[:, :3].min() > 1e-6
    np.testing.assert_allclose(robots.read_csv(out)[STD], std, rtol=1e-9, atol=1e-15)
    text = "format: 1\nrobot: {urdf: arid.urdf, tip: flange}\nmeasurements: {file: m.csv, units: {length: mm, angle: deg}}\n"
    _, out = run(tmp_path, calibration(text=text), in_mm_and_degrees(query), "other.csv")
    scaled = np.hstack([1e3 * std[:, :3], np.degrees(std[:, 3:])])
    np.testing.assert_allclose(robots.read_csv(out)[STD], scaled, rtol=1e-9, atol=1e-12)


def test_a_row_without_a_pose_has_no_standard_deviation_and_does_not_extrapolate(tmp_path: Path) -> None:
    query = inside(3)
    query.loc[1, "joint_2"] = np.nan
    _, out = run(tmp_path, calibration(), query)
    found = pd.read_csv(out)
    assert found[STD].isna().all(axis=1).tolist() == [False, True, False]
    assert not found["extrapolates"].any()


def test_a_prediction_several_times_as_uncertain_as_any_fitted_row_extrapolates(tmp_path: Path) -> None:
    model, query = calibration(), inside(40)
    size = np.linalg.norm(model.final.std(query.to_numpy())[:, :3], axis=1)
    edge = float(np.median(size))
    _, out = run(tmp_path, replace(model, largest_std=(edge / 3.0, np.inf)), query)
    assert np.array_equal(pd.read_csv(out)["extrapolates"], size > edge)


def test_where_euler_angles_are_not_unique_they_still_say_the_same_rotation() -> None:
    settings = MeasurementSettings.model_validate({"orientation": {"euler": "ZYX", "columns": ("A", "B", "C")}})
    R = Rotation.from_euler("ZYX", [[0.3, np.pi / 2, 0.7]])
    again = Rotation.from_euler("ZYX", orientations(R.as_matrix(), settings))
    assert (again * R.inv()).magnitude().max() < 1e-7


def test_nothing_is_overwritten_by_a_failed_prediction(tmp_path: Path) -> None:
    (tmp_path / "out.csv").write_text("precious")
    status, out = run(tmp_path, calibration(), inside(2).drop(columns="joint_3"))
    assert status == 2
    assert out.read_text() == "precious"


@pytest.mark.parametrize("name", ["out.txt", "query.csv/out.csv"])
def test_a_place_that_cannot_be_written_is_refused_before_any_work(tmp_path: Path, name: str) -> None:
    assert run(tmp_path, calibration(), inside(2), name)[0] == 2


def test_the_folder_of_an_answer_is_made_and_goes_again_where_there_is_none(tmp_path: Path) -> None:
    assert run(tmp_path, calibration(), inside(2), "deep/down/out.csv")[0] == 0
    assert (tmp_path / "deep" / "down" / "out.csv").is_file()
    assert run(tmp_path, calibration(), inside(2).drop(columns="joint_3"), "other/out.csv")[0] == 2
    assert not (tmp_path / "other").exists()


def test_a_rotation_that_is_half_a_turn_has_a_unit_quaternion() -> None:
    R = np.stack([np.diag([1.0, -1.0, -1.0]), np.full((3, 3), np.nan)])
    q = orientations(R, MeasurementSettings())
    assert np.array_equal(q[0], [1.0, 0.0, 0.0, 0.0])
    assert np.isnan(q[1]).all()


def test_the_geometric_stage_predicts_without_the_effects() -> None:
    effect = Coefficient("joint_3", "axis", Basis("linear", ("temperature",), (20.0,)))
    warm = calibration(effects=(effect,))
    q = inside(5).to_numpy()
    cold = {"temperature": np.full(5, 20.0)}
    same = warm.final.poses(q, cold)
    for a, b in zip(warm.geometric.poses(q), same, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-14)
    moved = warm.final.poses(q, {"temperature": np.full(5, 25.0)})
    assert np.abs(moved[1] - same[1]).max() > 1e-4
    assert replace(warm, final=warm.geometric).final.poses(q)[1].shape == (5, 3)


def test_predictions_of_a_table_in_latin_1_can_be_fed_back(tmp_path: Path) -> None:
    """Commands write UTF-8, whatever the campaign's own tables are in."""
    text = (
        "format: 1\nrobot: {urdf: arid.urdf, tip: flange}\nmeasurements:\n  file: m.csv\n"
        "  table: {encoding: latin-1}\n  columns: {temperature: Fühler}\n"
    )
    model = calibration(
        effects=(Coefficient("joint_3", "axis", Basis("linear", ("temperature",), (20.0,))),), text=text
    )
    query = inside(6).assign(Fühler=np.linspace(12.0, 28.0, 6))
    query.to_csv(tmp_path / "own.csv", index=False, float_format="%.17g", encoding="latin-1")
    (tmp_path / "calibration.yaml").write_text(model.dump(), encoding="utf-8")
    for source, out in (("own.csv", "first.csv"), ("first.csv", "second.csv")):
        assert (
            predict.main([str(tmp_path / name) for name in ("calibration.yaml", source)] + ["-o", str(tmp_path / out)])
            == 0
        )
    first, second = (robots.read_csv(tmp_path / name) for name in ("first.csv", "second.csv"))
    pd.testing.assert_frame_equal(first[[*query, "x", "y", "z"]], second[[*query, "x", "y", "z"]])
