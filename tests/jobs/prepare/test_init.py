"""`aridcal init`: a table written in somebody's dialect is read back as the SI values from which it was made."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from robots import SHARED_ROBOTS, URDF, random_chain, random_placement, readings
from scipy.spatial.transform import Rotation

import aridcal.init
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.files.campaign import load_campaign
from aridcal.files.read import load_measurements
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.prepare.campaign_text import draft
from aridcal.jobs.prepare.column_names import match_joints, positions, words
from aridcal.jobs.prepare.guesses import leave_open
from aridcal.system.errors import AridcalError, MeasurementError

UR10 = URDF / "ur10.urdf"


def never(question: str, answers: object, why: str) -> int:
    raise AssertionError(f"asked {question!r} ({answers}) though the data tell: {why}")


def measured(robot: Robot, n: int = 40, seed: int = 0, world=None) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Readings, positions and orientations of a target on a robot that is a little wrong, [rad] and [m]."""
    rng = np.random.default_rng(seed)
    q = readings(robot, n, rng, 0.7)
    frames = ((None, world or random_placement(rng)),), ((None, random_placement(rng, 0.2)),)
    off = 1e-3 * rng.standard_normal(q.shape[1])  # joint zeros, so that nothing fits exactly
    model = Model(robot, (), *frames)
    R, p = model.poses(np.zeros(0), model.rows(q + off))
    return q, p, Rotation.from_matrix(R)


def ur10_rows(n: int = 40) -> tuple[Robot, np.ndarray, np.ndarray, Rotation]:
    robot = load_robot(UR10, "tool0")
    return robot, *measured(robot, n)


def named(names: str, values: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(names.split(), values.T, strict=True))


def spelt(robot: Robot, q: np.ndarray, p: np.ndarray, R: Rotation) -> dict[str, dict[str, np.ndarray]]:
    """The same measurements as different people write them."""
    deg = np.degrees
    wxyz = R.as_quat()[:, [3, 0, 1, 2]]
    trap = np.random.default_rng(9).normal(size=(len(q), 6))
    ros = {f"joint_states.position.{name}": q[:, k] for k, name in enumerate(robot.names)}
    return {
        "our own": named(" ".join(robot.names), q) | named("x y z", p) | named("qx qy qz qw", R.as_quat()),
        "KUKA": named("A1 A2 A3 A4 A5 A6", deg(q))
        | named("X Y Z", 1e3 * p)
        | named("A B C", R.as_euler("ZYX", degrees=True)),
        "Fanuc": named("J1 J2 J3 J4 J5 J6", deg(q))
        | named("x y z", 1e3 * p)
        | named("w p r", R.as_euler("xyz", degrees=True)),
        "UR's real-time data": named("target_q_0 target_q_1 target_q_2 target_q_3 target_q_4 target_q_5", trap)
        | named("actual_q_0 actual_q_1 actual_q_2 actual_q_3 actual_q_4 actual_q_5", q)
        | named("actual_qd_0 actual_qd_1 actual_qd_2 actual_qd_3 actual_qd_4 actual_qd_5", trap)
        | named("leica_x leica_y leica_z", p)
        | named("leica_rx leica_ry leica_rz", R.as_rotvec()),
        "ROS": ros
        | named("pose.position.x pose.position.y pose.position.z", p)
        | named("pose.orientation.w pose.orientation.x pose.orientation.y pose.orientation.z", wxyz),
        "numbers only": named("joint1 joint2 joint3 joint4 joint5 joint6", deg(q))
        | named("tx ty tz", 100 * p)
        | named("quat0 quat1 quat2 quat3", wxyz),
        "a spreadsheet": {f"{name} [deg]": deg(q[:, k]) for k, name in enumerate(robot.names)}
        | {f"goal {a}": trap[:, k] for k, a in enumerate("xyz")}
        | {f"Measured {a.upper()} [in]": p[:, k] / 0.0254 for k, a in enumerate("xyz")}
        | {
            name: angle for name, angle in zip(("Roll", "Pitch", "Yaw"), R.as_euler("XYZ", degrees=True).T, strict=True)
        },
    }


DIALECTS = list(spelt(*ur10_rows(2)))


def read_back(out: Path, robot: Robot):
    read = load_measurements(load_campaign(out), robot.readings, robot.limits, robot.kinds)
    return read.select(read.as_read)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_is_read_back_in_si(dialect, tmp_path, monkeypatch):
    robot, q, p, R = ur10_rows()
    pd.DataFrame(spelt(robot, q, p, R)[dialect]).to_csv(tmp_path / "m.csv", index=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert aridcal.init.main(["--urdf", str(UR10), "--measurements", "m.csv"]) == 0
    rows = read_back(tmp_path / "campaign.yaml", robot)
    np.testing.assert_allclose(rows.readings, q, atol=1e-12)
    np.testing.assert_allclose(rows.position, p, atol=1e-12)
    assert (Rotation.from_matrix(rows.rotation) * R.inv()).magnitude().max() < 1e-12


def test_any_dialect_identifies_like_the_table_in_si(tmp_path):
    tables = spelt(*ur10_rows())
    found = []
    for dialect in ("our own", "KUKA"):
        pd.DataFrame(tables[dialect]).to_csv(tmp_path / f"{dialect}.csv", index=False)
        out = tmp_path / f"{dialect}.yaml"
        made = draft(UR10, [tmp_path / f"{dialect}.csv"], out, never)
        out.write_text(made.campaign.text + "diagnosis: {enabled: false}\n")
        found.append({s.name: np.sqrt(np.mean(s.residual[:, :3] ** 2)) for s in identify(out).stages})
    assert found[0]["nominal"] > 1e-4  # [m]: the joints' zeros
    assert found[0]["geometric"] < 0.01 * found[0]["nominal"]
    assert found[1]["nominal"] == pytest.approx(found[0]["nominal"], rel=1e-6)


def test_a_column_that_the_next_table_lacks_is_ignored_and_said_to_be(tmp_path):
    """Two days' tables: the first has a note and a temperature, the second neither, but a counter."""
    robot, q, p, R = ur10_rows()
    whole = pd.DataFrame(spelt(robot, q, p, R)["our own"])
    half = len(whole) // 2
    whole[:half].assign(temperature=20.0 + np.arange(half) % 7, note="day 1").to_csv(tmp_path / "a.csv", index=False)
    whole[half:].assign(shot=np.arange(len(whole) - half)).to_csv(tmp_path / "b.csv", index=False)
    out = tmp_path / "campaign.yaml"
    made = draft(UR10, [tmp_path / "a.csv", tmp_path / "b.csv"], out, never)
    out.write_text(made.campaign.text)
    assert "temperature (not in b.csv as a plain column)" in " ".join(made.campaign.text.replace("#", "").split())
    assert "shot (not in a.csv as a plain column)" in " ".join(made.campaign.text.replace("#", "").split())
    rows = read_back(out, robot)
    assert len(rows) == len(whole) and not rows.origin.refused and rows.covariates == {}
    assert not [note for note in rows.origin.notices if "ignore" in note.why]


def test_a_joint_that_the_next_table_lacks_is_named(tmp_path):
    robot, q, p, R = ur10_rows()
    whole = pd.DataFrame(spelt(robot, q, p, R)["our own"])
    whole.to_csv(tmp_path / "a.csv", index=False)
    whole.drop(columns="elbow_joint").to_csv(tmp_path / "b.csv", index=False)
    with pytest.raises(MeasurementError, match=r"b\.csv: no column 'elbow_joint', which .*a\.csv has"):
        draft(UR10, [tmp_path / "a.csv", tmp_path / "b.csv"], tmp_path / "c.yaml", never)


def test_units_of_a_rail_are_found_too(tmp_path):
    robot = load_robot(URDF / "arid.urdf", "flange")
    q, p, R = measured(robot, 60)
    table = named("axis1 axis2 axis3 axis4", q * [1e3, *[180 / np.pi] * 3])
    table |= named("x y z", 1e3 * p) | named("rx ry rz", R.as_rotvec(degrees=True))
    pd.DataFrame(table).to_csv(tmp_path / "m.csv", index=False)
    made = draft(URDF / "arid.urdf", [tmp_path / "m.csv"], tmp_path / "c.yaml", never)
    np.testing.assert_allclose(made.rows.readings[made.rows.as_read], q, atol=1e-12)
    assert {g.key: g.value for g in made.proposal.guesses}["measurements.units"] == {"length": "mm", "angle": "deg"}


def test_a_gripper_that_was_not_recorded_is_left_out_of_the_chain(tmp_path):
    urdf = SHARED_ROBOTS / "panda_description" / "urdf" / "panda.urdf"
    robot = load_robot(urdf, "panda_link8")
    q, p, _ = measured(robot)
    pd.DataFrame(named(" ".join(robot.names), q) | named("x y z", p)).to_csv(tmp_path / "m.csv", index=False)
    proposal = draft(urdf, [tmp_path / "m.csv"], tmp_path / "c.yaml", leave_open).proposal
    assert proposal.robot.readings == robot.readings
    assert {g.key: g.value for g in proposal.guesses}["measurements.kind"] == "position"


def test_joints_matched_by_order_alone_are_marked_in_the_file(tmp_path):
    _, q, p, _ = ur10_rows()
    pd.DataFrame(named("q1 q2 q3 q4 q5 q6", q) | named("x y z", p)).to_csv(tmp_path / "m.csv", index=False)
    text = draft(UR10, [tmp_path / "m.csv"], tmp_path / "c.yaml", never).campaign.text
    above, _, after = text.partition("    shoulder_pan_joint: q1\n")
    assert "GUESSED: by their ORDER" in above.splitlines()[-1]
    assert "wrist_3_joint: q6" in after


def test_a_moved_tracker_gets_a_frame_for_each_station(tmp_path):
    robot, q, p, _ = ur10_rows(60)
    moved = random_placement(np.random.default_rng(5))
    p[30:] = p[30:] @ moved.rotation.T + moved.translation
    table = named(" ".join(robot.names), q) | named("x y z", p) | {"station": np.repeat(["A", "B"], 30)}
    pd.DataFrame(table).to_csv(tmp_path / "m.csv", index=False)
    proposal = draft(UR10, [tmp_path / "m.csv"], tmp_path / "c.yaml", never).proposal
    values = {g.key: g.value for g in proposal.guesses}
    assert values["frames.world_base"] == {"per": "station"}
    assert "frames.tip_target" not in values


def test_a_split_of_the_users_is_kept_and_a_row_counter_ignored(tmp_path):
    robot, q, p, _ = ur10_rows()
    own = np.where(np.arange(len(q)) % 3 == 0, "test", "train")
    table = named(" ".join(robot.names), q) | named("x y z", p)
    table |= {"subset": own, "no": np.arange(len(q)), "remark": ["fine"] * len(q), "humidity": p[:, 0] ** 2}
    table |= {"laser std x": p[:, 1] ** 2, "measured temp": p[:, 2]}
    pd.DataFrame(table).to_csv(tmp_path / "m.csv", index=False)
    made = draft(UR10, [tmp_path / "m.csv"], tmp_path / "c.yaml", never)
    text, rows = made.campaign.text, made.rows
    assert rows.origin.split_given
    np.testing.assert_array_equal(rows.test[rows.as_read], own == "test")
    assert "ignore: ['no', remark, laser std x]" in text
    assert list(rows.covariates) == ["humidity", "temperature"]


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda t: t.drop(columns="elbow_joint"), "no columns for the joints elbow_joint, though"),
        (lambda t: t.drop(columns="y"), "no columns for the target's position"),
        (lambda t: t[:3], "4 are the least"),
    ],
)
def test_what_no_campaign_can_say_is_refused_with_a_remedy(spoil, why, tmp_path, capsys, monkeypatch):
    robot, q, p, _ = ur10_rows()
    table = pd.DataFrame(named(" ".join(robot.names), q) | named("x y z", p))
    spoil(table).to_csv(tmp_path / "m.csv", index=False)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    out = tmp_path / "campaign.yaml"
    assert aridcal.init.main(["--urdf", str(UR10), "--measurements", str(tmp_path / "m.csv"), "-o", str(out)]) == 2
    assert why in capsys.readouterr().err
    assert not out.exists()


def test_two_orientations_that_disagree_are_refused(tmp_path):
    """In a proposal and in what is read for it; one that was commanded, and a copy of the other, are none."""
    robot, q, p, R = ur10_rows()
    table = pd.DataFrame(named(" ".join(robot.names), q) | named("x y z", p) | named("qx qy qz qw", R.as_quat()))
    table = table.assign(**named("A B C", R.as_euler("ZYX")))
    draft(UR10, [table], tmp_path / "c.yaml", never)
    spoilt = table.assign(B=table.B + np.where(table.index == 7, 0.02, 0.0))
    with pytest.raises(AridcalError, match=r"line 9: qx qy qz qw and A B C are two orientations, 1\.1. degrees apart"):
        draft(UR10, [spoilt], tmp_path / "c.yaml", never)
    commanded = spoilt.rename(columns={"A": "cmd_A", "B": "cmd_B", "C": "cmd_C"})
    draft(UR10, [commanded], tmp_path / "c.yaml", never)

    keys = {"format": 1, "robot": {"urdf": str(UR10), "tip": "tool0"}}
    keys["measurements"] = {"file": "m.csv", "orientation": {"euler": "ZYX", "columns": ["A", "B", "C"]}}
    (tmp_path / "campaign.yaml").write_text(yaml.safe_dump(keys))
    table.to_csv(tmp_path / "m.csv", index=False)
    read_back(tmp_path / "campaign.yaml", robot)
    spoilt.to_csv(tmp_path / "m.csv", index=False)
    with pytest.raises(AridcalError, match="line 9: A B C and qx qy qz qw are two orientations"):
        read_back(tmp_path / "campaign.yaml", robot)


def test_angles_in_two_units_are_told_apart_by_columns(tmp_path):
    """Joints in rad beside Euler angles in degrees, rails in mm beside positions in m."""
    robot, q, p, R = ur10_rows()
    table = named(" ".join(robot.names), q) | named("x y z", p) | named("rx ry rz", R.as_euler("xyz", degrees=True))
    made = draft(UR10, [pd.DataFrame(table)], tmp_path / "c.yaml", never)
    units = {g.key: g.value for g in made.proposal.guesses}["measurements.units"]
    assert units == {"columns": {"rz": "deg", "ry": "deg", "rx": "deg"}}
    assert (Rotation.from_matrix(made.rows.rotation[made.rows.as_read]) * R.inv()).magnitude().max() < 1e-12

    robot = load_robot(URDF / "arid.urdf", "flange")
    q, p, _ = measured(robot, 60)
    table = named("axis1 axis2 axis3 axis4", q * [1e3, 1, 1, 1]) | named("x y z", p)
    made = draft(URDF / "arid.urdf", [pd.DataFrame(table)], tmp_path / "c.yaml", leave_open)
    np.testing.assert_allclose(made.rows.readings[made.rows.as_read], q, atol=1e-12)
    assert {g.key: g.value for g in made.proposal.guesses}["measurements.units"] == {"columns": {"axis1": "mm"}}


def test_a_campaign_that_is_there_is_never_overwritten(tmp_path, capsys):
    (tmp_path / "campaign.yaml").write_text("mine")
    arguments = ["--urdf", str(UR10), "--measurements", "m.csv", "-o", str(tmp_path / "campaign.yaml")]
    assert aridcal.init.main(arguments) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "campaign.yaml").read_text() == "mine"


def test_measurements_of_another_robot_are_called_so(tmp_path):
    (tmp_path / "robot.urdf").write_bytes(random_chain(np.random.default_rng(3), "RRR"))
    robot = load_robot(tmp_path / "robot.urdf", "tip")
    q, p, _ = measured(robot)
    rng = np.random.default_rng(0)
    table = named(" ".join(robot.readings), q[rng.permutation(len(q))]) | named("x y z", p)
    made = draft(tmp_path / "robot.urdf", [pd.DataFrame(table)], tmp_path / "c.yaml", leave_open)
    assert "MUCH" in made.campaign.text
    assert not next(g for g in made.proposal.guesses if g.key == "measurements.units").sure


def test_a_frame_in_memory_is_proposed_and_read_like_the_file_of_it(tmp_path):
    tables = spelt(*ur10_rows())
    frame = pd.DataFrame(tables["KUKA"])
    frame.to_csv(tmp_path / "measurements.csv", index=False)
    in_memory, in_file = (
        draft(UR10, [table], tmp_path / "c.yaml", never) for table in (frame, tmp_path / "measurements.csv")
    )
    assert in_memory.campaign.tables == (frame,) and in_file.campaign.tables == in_file.campaign.measurements.files
    np.testing.assert_array_equal(in_memory.rows.position, in_file.rows.position)
    np.testing.assert_array_equal(in_memory.rows.rotation, in_file.rows.rotation)
    remark = "  # measurements.csv is a DataFrame: `df.to_csv('measurements.csv', index=False)` saves it\n"
    assert in_memory.campaign.text.replace(remark, "") == in_file.campaign.text


def test_a_controllers_own_pose_is_no_measurement(tmp_path):
    """UR's real-time data: where a tracker stands beside it, that is taken; alone, it is said what it is."""
    _, q, p, R = ur10_rows()
    own = np.hstack([p + 1e-3, R.as_rotvec()])
    table = named(" ".join(f"actual_q_{k}" for k in range(6)), q)
    table |= named(" ".join(f"actual_TCP_pose_{k}" for k in range(6)), own)
    both = draft(UR10, [pd.DataFrame(table | named("x y z", p))], tmp_path / "c.yaml", never)
    np.testing.assert_allclose(both.rows.position[both.rows.sequence], p, atol=1e-12)
    alone = draft(UR10, [pd.DataFrame(table)], tmp_path / "c.yaml", never).proposal
    said = next(g for g in alone.guesses if g.key == "measurements.columns.x")
    assert "NO MEASUREMENT" in said.why and not said.sure


def test_answers_on_the_terminal_are_kept(tmp_path):
    urdf = UR10.read_text().replace('"tool0"', '"hand"').replace('"ee_link"', '"foot"')
    (tmp_path / "r.urdf").write_text(urdf)
    robot, q, p, _ = ur10_rows()
    pd.DataFrame(named(" ".join(robot.names), q) | named("x y z", p)).to_csv(tmp_path / "m.csv", index=False)
    asked = []

    def choose(question: str, answers: list[str], why: str) -> int:
        asked.append(question)
        return answers.index("hand")

    text = draft(tmp_path / "r.urdf", [tmp_path / "m.csv"], tmp_path / "c.yaml", choose).campaign.text
    assert asked == ["which link is the tip"]
    assert "  tip: hand\n" in text
    assert "GUESSED" not in text.partition("  tip: ")[0]
    text = draft(tmp_path / "r.urdf", [tmp_path / "m.csv"], tmp_path / "c.yaml", leave_open).campaign.text
    assert "GUESSED: end of the chain" in text.partition("  tip: ")[0]


def test_names_are_taken_apart():
    assert words("Measured X [mm]") == words("measuredX") == words("measured_x_mm") == ("measured", "x")
    assert words("J1_deg") == ("j", "1")
    assert match_joints(["left_joint1", "left_joint2"], ["q2", "q1"]) == (
        {"left_joint1": "q1", "left_joint2": "q2"},
        "number",
    )
    assert match_joints(["a_joint", "b_joint"], ["a [deg]", "time", "b [deg]"]) is None
    assert [f.columns for f in positions(["rx", "ry", "rz", "std_x", "std_y", "std_z", "px", "py", "pz"])] == [
        ("px", "py", "pz")
    ]


def test_a_bad_urdf_is_an_error_of_the_robot(tmp_path):
    (tmp_path / "r.urdf").write_text("<robot/>")
    (tmp_path / "m.csv").write_text("a,b\n1,2\n")
    with pytest.raises(AridcalError, match=r"r\.urdf"):
        draft(tmp_path / "r.urdf", [tmp_path / "m.csv"], tmp_path / "c.yaml", never)


@pytest.mark.parametrize("name", ["m.csv", "nowhere.yaml", "."])
def test_what_is_no_campaign_is_answered_with_the_command_that_writes_one(name, tmp_path):
    (tmp_path / "m.csv").write_text("a,b\n1,2\n")
    with pytest.raises(AridcalError, match=r"`aridcal init --urdf"):
        load_campaign(tmp_path / name)


def test_a_table_without_the_joints_columns_is_answered_with_init(tmp_path):
    robot, q, p, _ = ur10_rows()
    pd.DataFrame(named("q1 q2 q3 q4 q5 q6", q) | named("x y z", p)).to_csv(tmp_path / "m.csv", index=False)
    (tmp_path / "c.yaml").write_text(
        f"format: 1\nrobot: {{urdf: {UR10}, tip: tool0}}\nmeasurements: {{file: m.csv, kind: position}}\n"
    )
    with pytest.raises(AridcalError, match="`aridcal init` finds which is which"):
        read_back(tmp_path / "c.yaml", robot)


def test_a_missing_calibration_is_answered_with_the_command_that_writes_one(tmp_path):
    with pytest.raises(AridcalError, match=r"calibration\.yaml: there is no such file; `aridcal identify"):
        SavedModel.load(tmp_path)


def arguments(folder: Path) -> list[str]:
    """Of `aridcal init` for the UR10 and rows.csv of a folder, with nobody to ask."""
    files = ["--measurements", str(folder / "rows.csv"), "-o", str(folder / "campaign.yaml")]
    return ["--urdf", str(UR10), *files, "--quiet"]


def test_a_table_without_a_header_is_asked_about_once(tmp_path, capsys):
    robot, q, p, R = ur10_rows()
    plain = pd.DataFrame(np.hstack([q, p, R.as_quat()]))
    plain.to_csv(tmp_path / "rows.csv", index=False, header=False)
    words = arguments(tmp_path)
    assert aridcal.init.main(words) == 2
    assert "--set table.names=NUMBER" in (asked := capsys.readouterr().err)
    assert "1 = 6 joints, then x y z qx qy qz qw" in asked
    assert aridcal.init.main([*words, "--set", "table.names=1"]) == 0
    campaign = load_campaign(tmp_path / "campaign.yaml")
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds)
    assert len(rows) == len(q)
    np.testing.assert_allclose(rows.position[rows.as_read], p, atol=1e-12)
    np.testing.assert_allclose(rows.readings[rows.as_read], q, atol=1e-12)


def test_joints_in_each_others_columns_are_offered_mended(tmp_path):
    """What counts backwards is offered likewise, and on the command line: `test_counting.py`."""
    robot = load_robot(URDF / "arid.urdf", "flange")
    q, p, R = measured(robot)
    written = q[:, [0, 1, 3, 2]]
    table = named(" ".join(robot.names), written) | named("x y z", p) | named("qx qy qz qw", R.as_quat())
    pd.DataFrame(table).to_csv(tmp_path / "rows.csv", index=False)
    asked = []

    def choose(question: str, answers: list[str], why: str) -> int:
        asked.append((question, answers))
        return 0

    out = tmp_path / "campaign.yaml"
    out.write_text(draft(URDF / "arid.urdf", [tmp_path / "rows.csv"], out, choose).campaign.text)
    ((question, answers),) = asked
    assert question == "how is the table to be read"
    assert answers[0].startswith("joint_3 and joint_4 exchanged: ") and answers[1].startswith("as it stands: ")
    assert "MUCH" not in out.read_text()
    rows = load_measurements(load_campaign(out), robot.readings, robot.limits, robot.kinds, robot=robot)
    np.testing.assert_allclose(rows.readings[rows.as_read], q, atol=1e-12)
