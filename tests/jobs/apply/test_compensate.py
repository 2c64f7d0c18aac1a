"""`aridcal compensate`: commands that bring the target to wanted poses, row by row and as a table of corrections."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
import robots
from scipy.spatial.transform import Rotation
from ur10_saved import BACKLASH, HEAT, POSE, calibration, predicted, readings, wanted

from aridcal import compensate, predict
from aridcal.calibration import Calibration
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.model.model import Model
from aridcal.engine.rows.approach import approach
from aridcal.files.query import load_query
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import MeasurementError

SAG = Coefficient("shoulder_lift_joint", "axis", Basis("linear", ("shoulder_lift_joint.gravity_torque",), (0.0,)))


def run(folder: Path, model: SavedModel, poses: pd.DataFrame, out: str = "joints.csv") -> tuple[int, Path]:
    (folder / "calibration.yaml").write_text(model.dump(), encoding="utf-8")
    poses.to_csv(folder / "poses.csv", index=False, float_format="%.17g")
    status = compensate.main([str(folder), str(folder / "poses.csv"), "-o", str(folder / out)])
    return status, folder / out


def test_predicting_the_commands_gives_the_wanted_poses(tmp_path: Path) -> None:
    model = calibration(effects={SAG: 1e-5, BACKLASH: -2e-4, HEAT: 1e-5})
    q = readings(40).assign(temperature=np.linspace(10, 30, 40), elbow_joint_direction=1.0)
    poses = wanted(tmp_path, model, q)[[*POSE, "temperature"]]
    seeds = readings(40) + 0.01
    status, out = run(tmp_path, model, pd.concat([poses, seeds], axis=1).assign(note="kept"))
    assert status == 0
    found = robots.read_csv(out)
    assert found["reached"].all() and (found["note"] == "kept").all()
    back = predicted(tmp_path, out)
    np.testing.assert_allclose(back[POSE], poses[POSE], rtol=0, atol=1e-6)
    assert found["position_error"].max() < 1e-6 and found["rotation_error"].max() < 1e-6
    assert found["elbow_joint_direction"].iloc[0] == 0.0
    moved = np.sign(np.diff(found["elbow_joint"]))
    assert np.array_equal(found["elbow_joint_direction"].iloc[1:], moved)


def test_backlash_is_taken_from_the_side_that_the_trajectory_comes_from(tmp_path: Path) -> None:
    """To and fro over the same poses: the commands differ by the whole play, small steps and halts included."""
    play = 2e-4
    model = calibration(effects={BACKLASH: -play})
    q = readings(1).loc[[0] * 9].reset_index(drop=True)
    q["elbow_joint"] = 0.7 + np.array([0, 1e-4, 1e-4, 2e-4, 0.1, 2e-4, 1e-4, 1e-4, 0])
    poses = wanted(tmp_path, calibration(), q)[POSE]
    status, out = run(tmp_path, model, pd.concat([poses, q], axis=1))
    assert status == 0
    found = robots.read_csv(out)
    side = np.array([0, 1, 1, 1, 1, -1, -1, -1, -1.0])
    assert np.array_equal(found["elbow_joint_direction"], side)
    np.testing.assert_allclose(found["elbow_joint"] - q["elbow_joint"], play * side, rtol=0, atol=1e-6)


def test_a_direction_that_the_table_states_is_taken(tmp_path: Path) -> None:
    model = calibration(effects={BACKLASH: -2e-4})
    q = readings(3)
    poses = wanted(tmp_path, calibration(), q)[POSE]
    status, out = run(tmp_path, model, pd.concat([poses, q], axis=1).assign(elbow_joint_direction=[-1, np.nan, 1]))
    assert status == 0
    found = robots.read_csv(out)
    own = np.sign(q["elbow_joint"][1] - q["elbow_joint"][0])
    np.testing.assert_allclose(found["elbow_joint_direction"], [-1, own, 1])
    np.testing.assert_allclose(found["elbow_joint"] - q["elbow_joint"], 2e-4 * np.array([-1, own, 1]), atol=1e-6)


def test_without_joints_in_the_table_a_solution_is_searched_for(tmp_path: Path) -> None:
    model = calibration(effects={SAG: 1e-5})
    poses = wanted(tmp_path, model, readings(8))[POSE]
    status, out = run(tmp_path, model, poses)
    assert status == 0
    found = robots.read_csv(out)
    assert found["reached"].all()
    assert list(found)[: len(POSE)] == POSE and set(model.final.model.robot.readings) < set(found)
    np.testing.assert_allclose(predicted(tmp_path, out)[POSE], poses, rtol=0, atol=1e-6)


def test_a_seed_that_leads_nowhere_puts_no_pose_out_of_reach(tmp_path: Path) -> None:
    """Starts from anywhere, some of which end in a fold: without a seed all poses are reached."""
    model = calibration()
    poses = wanted(tmp_path, model, readings(40))[POSE]
    anywhere = np.random.default_rng(5).uniform(-1.2, 1.2, (40, 6))
    R = Rotation.from_quat(poses[POSE[3:]]).as_matrix()
    search = model.inverse_kinematics()
    lost = [not search.command(*each, {}).reached for each in zip(R, poses[POSE[:3]].to_numpy(), anywhere, strict=True)]
    assert any(lost)
    _, out = run(tmp_path, model, poses.assign(**dict(zip(model.final.model.robot.readings, anywhere.T, strict=True))))
    assert robots.read_csv(out)["reached"].all()
    np.testing.assert_allclose(predicted(tmp_path, out)[POSE], poses, rtol=0, atol=1e-6)


def test_poses_out_of_reach_are_said_to_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = calibration()
    poses = wanted(tmp_path, model, readings(4))[POSE]
    poses.loc[2, "x"] += 3.0
    capsys.readouterr()
    status, out = run(tmp_path, model, poses)
    assert status == 0
    found = robots.read_csv(out)
    assert found["reached"].tolist() == [True, True, False, True]
    assert found["position_error"][2] > 0.5
    said = " ".join(capsys.readouterr().err.split())
    assert "line 4: cannot be reached" in said and "3 reached, 1 out of reach" in said


def test_a_row_that_lacks_a_number_has_no_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = calibration(effects={HEAT: 1e-5})
    poses = wanted(tmp_path, model, readings(3).assign(temperature=20.0))[[*POSE, "temperature"]]
    poses.loc[2, "x"] = np.nan
    status, out = run(tmp_path, model, poses)
    assert status == 0
    found = pd.read_csv(out)
    assert found["elbow_joint"].isna().tolist() == [False, False, True]
    assert found["reached"].tolist() == [True, True, False]
    assert "1 without a command" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("column", "cell", "says"),
    [
        ("temperature", "", "line 3: column 'temperature': missing"),
        ("y", "left", "line 3: column 'y', left: not a number"),
        ("qz", "?", "line 3: column 'qz', ?: not a number"),
        ("elbow_joint", "up", "line 3: column 'elbow_joint', up: not a number"),
    ],
)
def test_cells_that_no_command_can_be_made_from_are_named(
    column: str, cell: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A word among the starting joints used to be passed over."""
    model = calibration(effects={HEAT: 1e-5})
    q = readings(3).assign(temperature=20.0)
    poses = wanted(tmp_path, model, q)[[*POSE, "temperature", "elbow_joint"]].astype(object)
    poses.loc[1, column] = cell
    status, out = run(tmp_path, model, poses)
    assert (status, out.exists()) == (2, False)
    assert says in " ".join(capsys.readouterr().err.split())


def test_a_direction_that_is_not_stated_is_no_hole(tmp_path: Path) -> None:
    model = calibration(effects={BACKLASH: -2e-4})
    poses = wanted(tmp_path, calibration(), readings(3))[POSE]
    assert run(tmp_path, model, poses.assign(elbow_joint_direction=[1, np.nan, np.nan]))[0] == 0


def test_without_joints_in_the_table_the_ranges_seen_are_kept_to(tmp_path: Path) -> None:
    """The first solution found lies on any of eight branches: the calibration knows one."""
    model = calibration(effects={SAG: 1e-5})
    poses = wanted(tmp_path, model, readings(40))[POSE]
    status, out = run(tmp_path, model, poses)
    assert status == 0
    found = robots.read_csv(out)
    assert found["reached"].all()
    assert not found["extrapolates"].any()
    joints = found[list(model.final.model.robot.readings)].to_numpy()
    assert np.abs(joints).max() <= 1.2
    np.testing.assert_allclose(predicted(tmp_path, out)[POSE], poses, rtol=0, atol=1e-6)


def test_a_pose_that_is_reached_only_outside_the_ranges_seen_is_still_reached(tmp_path: Path) -> None:
    model = calibration()
    q = readings(3)
    q["shoulder_pan_joint"] = 2.5
    poses = wanted(tmp_path, model, q)[POSE]
    _, out = run(tmp_path, model, poses)
    found = robots.read_csv(out)
    assert found["reached"].all()
    assert found["extrapolates"].all()
    np.testing.assert_allclose(predicted(tmp_path, out)[POSE], poses, rtol=0, atol=1e-6)


def test_a_missing_covariate_is_an_error_that_names_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = wanted(tmp_path, calibration(), readings(3))[POSE]
    (tmp_path / "joints.csv").write_text("precious")
    status, out = run(tmp_path, calibration(effects={HEAT: 1e-5}), poses)
    assert status == 2
    assert "'temperature'" in capsys.readouterr().err
    assert out.read_text() == "precious"


def test_tables_speak_as_the_campaigns_tables_do(tmp_path: Path) -> None:
    text = (
        "format: 1\nrobot: {urdf: ur10.urdf, tip: tool0}\nmeasurements:\n  file: m.csv\n"
        "  units: {length: mm, angle: deg}\n  columns: {x: X, elbow_joint: A3}\n"
    )
    q = readings(5)
    poses = wanted(tmp_path, calibration(), q)[POSE]
    _, out = run(tmp_path, calibration(), pd.concat([poses, q], axis=1))
    plain = robots.read_csv(out)
    other = poses.assign(**{c: 1e3 * poses[c] for c in "xyz"}).rename(columns={"x": "X"})
    seeds = np.degrees(q).rename(columns={"elbow_joint": "A3"})
    status, out = run(tmp_path, calibration(text=text), pd.concat([other, seeds], axis=1), "other.csv")
    assert status == 0
    found = robots.read_csv(out)
    np.testing.assert_allclose(found["A3"], np.degrees(plain["elbow_joint"]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["position_error"], 1e3 * plain["position_error"], rtol=1e-3, atol=1e-12)
    assert "elbow_joint" not in found


DIALECTS = {
    "quaternions": "{}",
    "quaternions in columns of their own": "{columns: {x: X, qx: q1, qy: q2, qz: q3, qw: q0}, units: {length: in}}",
    "rotation vectors in degrees": "{units: {length: mm, angle: deg}, orientation: {rotvec: [u, v, w]}}",
    "KUKA": "{columns: {x: X, y: Y, z: Z, elbow_joint: A3}, units: {length: mm, angle: deg}, "
    "orientation: {euler: ZYX, columns: [A, B, C]}}",
    "Fanuc": "{units: {length: mm, angle: deg}, orientation: {euler: xyz, columns: [w, p, r]}}",
    **{
        f"Euler {sequence}": f"{{orientation: {{euler: {sequence}, columns: [e1, e2, e3]}}}}"
        for sequence in ("ZYZ", "zyx", "XZY")
    },
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_poses_go_round_in_every_dialect(tmp_path: Path, dialect: str) -> None:
    """Joints to poses, to joints from other starts, to poses: the same to 1e-7 in metres and radians."""
    text = f"format: 1\nrobot: {{urdf: ur10.urdf, tip: tool0}}\nmeasurements: {{file: m.csv, {DIALECTS[dialect][1:]}\n"
    model = calibration(effects={SAG: 1e-5, HEAT: 1e-5}, text=text)
    settings, names = model.measurements, model.final.model.robot.readings
    scale = settings.units.radians
    own = {name: settings.columns.get(name, name) for name in names}
    q = (readings(12) / scale).rename(columns=own).assign(temperature=25.0)
    poses = wanted(tmp_path, model, q)
    assert ("qw" in poses) == (dialect == "quaternions")
    poses[list(own.values())] += 0.02 / scale
    status, out = run(tmp_path, model, poses)
    assert status == 0
    assert robots.read_csv(out)["reached"].all()
    before, after = (
        load_query(table, names, robots.ur10().limits, ["revolute"] * 6, settings, poses=True)
        for table in (poses, predicted(tmp_path, out))
    )
    np.testing.assert_allclose(after.position, before.position, rtol=0, atol=1e-7)
    apart = Rotation.from_quat(after.quaternion) * Rotation.from_quat(before.quaternion).inv()
    assert apart.magnitude().max() < 1e-7


def two_orientations(tmp_path: Path) -> tuple[SavedModel, pd.DataFrame]:
    """A calibration that has angles, and poses that have quaternions too."""
    text = "format: 1\nrobot: {urdf: ur10.urdf, tip: tool0}\nmeasurements: {file: m.csv, orientation: %s}\n"
    model = calibration(text=text % "{euler: ZYX, columns: [A, B, C]}")
    quaternions = wanted(tmp_path, calibration(), readings(4))[POSE]
    angles = wanted(tmp_path, model, readings(4))[["A", "B", "C"]]
    return model, pd.concat([quaternions, angles, readings(4)], axis=1)


@pytest.mark.parametrize("command", [compensate, predict], ids=["compensate", "predict"])
def test_two_orientations_that_disagree_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: ModuleType
) -> None:
    model, both = two_orientations(tmp_path)

    def status(table: pd.DataFrame) -> int:
        (tmp_path / "calibration.yaml").write_text(model.dump(), encoding="utf-8")
        table.to_csv(tmp_path / "t.csv", index=False, float_format="%.17g")
        return int(command.main([str(tmp_path), str(tmp_path / "t.csv"), "-o", str(tmp_path / "o.csv")]))

    assert status(both) == 0
    assert status(both.assign(qw=both["qw"].where(both.index != 2))) == 0  # a hole is no other orientation
    both.loc[2, "B"] += 0.01
    capsys.readouterr()
    assert status(both) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "line 4: A B C and qx qy qz qw are two orientations, 0.5" in said and "degrees apart" in said


def test_the_face_refuses_two_orientations_that_disagree(tmp_path: Path) -> None:
    model, both = two_orientations(tmp_path)
    both.loc[1, "C"] += 0.01
    for use in (Calibration(model).predict, Calibration(model).compensate):
        with pytest.raises(MeasurementError, match=r"line 3: A B C and qx qy qz qw are two orientations"):
            use(both)


@pytest.mark.parametrize("which", ["reported", "commanded"])
def test_joints_that_were_reported_are_to_be_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], which: str
) -> None:
    text = f"format: 1\nrobot: {{urdf: r.urdf, tip: tool0}}\nmeasurements: {{file: m.csv, joint_reading: {which}}}\n"
    poses = wanted(tmp_path, calibration(), readings(2))[POSE]
    assert run(tmp_path, calibration(text=text), poses)[0] == 0
    assert ("joints to be reported" in capsys.readouterr().err) == (which == "reported")


def test_each_row_is_commanded_from_its_own_station(tmp_path: Path) -> None:
    model = calibration(stations=("A", "B"))
    q = readings(4).assign(station=["A", "B", "B", "A"])
    poses = wanted(tmp_path, model, q)[[*POSE, "station"]]
    status, out = run(tmp_path, model, pd.concat([poses, readings(4) + 0.01], axis=1))
    assert status == 0
    assert robots.read_csv(out)["reached"].all()
    np.testing.assert_allclose(predicted(tmp_path, out)[POSE], poses[POSE], rtol=0, atol=1e-6)
    assert run(tmp_path, model, poses.drop(columns="station"))[0] == 2


def test_positions_alone_are_wanted_where_positions_alone_were_measured(tmp_path: Path) -> None:
    model = calibration(kind="position")
    q = readings(5)
    poses = wanted(tmp_path, model, q)[["x", "y", "z"]]
    status, out = run(tmp_path, model, pd.concat([poses, q], axis=1))
    assert status == 0
    found = robots.read_csv(out)
    assert found["reached"].all() and "rotation_error" not in found
    np.testing.assert_allclose(predicted(tmp_path, out)[["x", "y", "z"]], poses, rtol=0, atol=1e-6)


def test_a_stream_gets_the_commands_that_the_table_gets(tmp_path: Path) -> None:
    model = calibration(effects={SAG: 1e-5, HEAT: 1e-5})
    q = readings(5).assign(temperature=25.0)
    poses = wanted(tmp_path, model, q)
    _, out = run(tmp_path, model, poses)
    table = robots.read_csv(out)
    loaded = SavedModel.load(tmp_path)
    R, p = model.final.poses(readings(5).to_numpy(), {"temperature": np.full(5, 25.0)})
    for k in range(5):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R[k], p[k]
        found = loaded.command(pose, readings(5).to_numpy()[k], {"temperature": 25.0})
        assert found.reached
        np.testing.assert_allclose(found.readings, table[list(model.final.model.robot.readings)].iloc[k], atol=1e-9)


def test_sides_of_approach_are_those_of_the_last_move() -> None:
    reading = np.array([0.0, 1.0, 1.0, np.nan, 0.5, 0.5 + 1e-9, 0.6])
    assert approach(reading, 1e-6).tolist() == [0, 1, 1, 1, -1, -1, 1]


def test_a_correction_table_brings_the_target_where_the_nominal_robot_would_be(tmp_path: Path) -> None:
    sag = Coefficient("joint_2", "axis", Basis("linear", ("joint_2.gravity_torque",), (0.0,)))
    model = calibration(robots.arid(), {sag: 1e-6})
    ranges = {"joint_1": (1.0, 9.0), "joint_2": (0.3, 1.8), "joint_3": (1.9, 2.5), "joint_4": (-1.9, -0.4)}
    model = SavedModel(model.geometric, model.final, "pose", model.gravity, (1e-4, 1e-4), ranges, {})
    (tmp_path / "calibration.yaml").write_text(model.dump(), encoding="utf-8")
    status = compensate.main([str(tmp_path), "--grid", "4", "-o", str(tmp_path / "table.csv")])
    assert status == 0
    table = robots.read_csv(tmp_path / "table.csv")
    names = list(robots.arid().readings)
    assert len(table) == 4**4 and list(table) == [*names, *(f"delta_{n}" for n in names)]
    for name in names:
        np.testing.assert_allclose(sorted(set(table[name])), np.linspace(*ranges[name], 4))
    q = table[names].to_numpy()
    world, tip = model.final.model.frames(model.final.theta)
    nominal = Model(robots.arid(), (), world, tip)
    _, p = nominal.poses(np.zeros(0), nominal.rows(q))
    before = np.linalg.norm(model.final.poses(q)[1] - p, axis=1)
    after = np.linalg.norm(model.final.poses(q + table[[f"delta_{n}" for n in names]].to_numpy())[1] - p, axis=1)
    assert np.sqrt(np.mean(after**2)) < 0.4 * np.sqrt(np.mean(before**2))
    coarse, fine = (compensate.correction_table(model, points) for points in (2, 5))
    assert fine.after < coarse.after < fine.before == coarse.before


@pytest.mark.parametrize("arguments", [[], ["poses.csv", "--grid", "3"], ["--grid", "1"]])
def test_either_poses_or_a_grid(tmp_path: Path, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        compensate.main([str(tmp_path), *arguments, "-o", str(tmp_path / "out.csv")])
    assert stop.value.code == 2


def test_a_grid_too_fine_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "calibration.yaml").write_text(calibration().dump(), encoding="utf-8")
    assert compensate.main([str(tmp_path), "--grid", "50", "-o", str(tmp_path / "out.csv")]) == 2
    assert "take fewer" in capsys.readouterr().err
