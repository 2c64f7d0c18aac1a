"""Rows between any two links: a tracker on two arms, a camera on the head, a bar from hand to hand. The data are Pinocchio's."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import tree_robot
import two_arms
import yaml
from two_arms import readings

import aridcal
import aridcal.compensate
from aridcal.engine.corrections.catalogue import candidates
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.fit.constants import urdf_of
from aridcal.engine.robot.chain import parse_robot, with_limbs
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.files.read import load_measurements
from aridcal.system.errors import AridcalError, CampaignError

LIMIT = 1.3
"""Held-out errors of a tenth of some 150 rows scatter by less."""

XYZ = ["x", "y", "z"]
SOUGHT = {"candidates": ["joint_compliance", "payload_compliance", "joint_gain"]}
"""What masses might be taken for; searches of all kinds in clean arms of several limbs are in test_cells."""


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[two_arms.Machine, aridcal.Calibration, Path]:
    """Calibrated with a tracker, a camera and a bar, and read back from its file."""
    folder, robot = tmp_path_factory.mktemp("both"), two_arms.machine()
    path = two_arms.write(folder, robot, ("tracker", "camera", "ballbar"), readings(robot, 110), diagnosis=SOUGHT)
    found = aridcal.calibrate(path)
    errors = found.errors.loc["final"].loc["test"]
    assert errors["position_rms_mm"] < LIMIT * np.sqrt(3.0) * 1e3 * two_arms.SIGMA
    assert errors["distance_rms_mm"] < LIMIT * 1e3 * two_arms.SIGMA
    assert found.result["verdict"] == "noise_floor" and found.effects.empty
    (folder / "calibration.yaml").write_text(found.model.dump(), encoding="utf-8")
    return robot, found, folder


def test_targets_on_either_hand_are_where_the_real_robot_has_them(
    both: tuple[two_arms.Machine, aridcal.Calibration, Path],
) -> None:
    robot, found, folder = both
    q = readings(robot, 50, 9)
    loaded = aridcal.load(folder / "calibration.yaml")
    told = {}
    for side, own in (("left", two_arms.LEFT), ("right", two_arms.RIGHT)):
        table = robot.table(q, target=np.full(len(q), side))
        told[side] = loaded.predict(table)[XYZ].to_numpy(float)
        np.testing.assert_allclose(told[side], found.predict(table)[XYZ].to_numpy(float), rtol=0, atol=1e-12)
        in_torso = np.array([T.act(own) for T in robot.seen(q, "torso", f"{side}_hand")])
        # distances between places need no frame: the tracker's world is where it is
        apart = np.linalg.norm(told[side][1:] - told[side][:-1], axis=1)
        np.testing.assert_allclose(apart, np.linalg.norm(in_torso[1:] - in_torso[:-1], axis=1), rtol=0, atol=5e-4)
    between = np.linalg.norm(told["left"] - told["right"], axis=1)
    left, right = (np.array([T.act(own) for T in robot.seen(q, "torso", f"{side}_hand")])
                   for side, own in (("left", two_arms.LEFT), ("right", two_arms.RIGHT)))  # fmt: skip
    np.testing.assert_allclose(between, np.linalg.norm(left - right, axis=1), rtol=0, atol=5e-4)


def test_the_calibrated_urdf_is_that_of_both_arms(both: tuple[two_arms.Machine, aridcal.Calibration, Path]) -> None:
    robot, found, _ = both
    q, geometric = readings(robot, 20, 5), found.model.geometric
    told = found.predict(robot.table(q), of="left_hand", within="right_hand")[XYZ].to_numpy(float)
    model = pin.buildModelFromXML(urdf_of(geometric.model, geometric.theta).decode())
    expected = [T.translation for T in two_arms.Machine(model).seen(q, "right_hand", "left_hand")]
    np.testing.assert_allclose(told, expected, rtol=0, atol=1e-9)


def test_a_command_moves_the_limb_that_carries_the_target_and_holds_the_others(
    both: tuple[two_arms.Machine, aridcal.Calibration, Path],
) -> None:
    robot, found, _ = both
    q = readings(robot, 8, 3) * 0.7
    near = q + np.random.default_rng(1).normal(0, 0.02, q.shape)
    pose = ["x", "y", "z", "qx", "qy", "qz", "qw"]
    for side in ("left", "right"):
        label = np.full(len(q), side)
        wanted = found.predict(robot.table(q, target=label))[pose].assign(target=label)
        told = found.compensate(wanted, seed=robot.table(near))
        own = [name.startswith(side) for name in robot.joints]
        reached = found.predict(told[robot.joints].assign(target=label))[XYZ].to_numpy(float)
        np.testing.assert_allclose(reached, wanted[XYZ].to_numpy(float), rtol=0, atol=1e-6)
        assert np.abs(told[robot.joints].to_numpy(float) - near)[:, own].max() > 0.01
        others = [not moves for moves in own]
        np.testing.assert_allclose(told[robot.joints].to_numpy(float)[:, others], near[:, others], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("of", "within"), [("left_hand", "right_hand"), ("right_4", "camera"), ("torso", "left_hand")])
def test_a_command_brings_a_link_to_a_pose_in_the_frame_of_another(
    of: str, within: str, both: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path
) -> None:
    """Second road: `predict` of the same two links; only the joints that carry the first one moved, if there are any."""
    robot, found, folder = both
    q = readings(robot, 6, 3) * 0.7
    near = q + np.random.default_rng(1).normal(0, 0.02, q.shape)
    pose = ["x", "y", "z", "qx", "qy", "qz", "qw"]
    own = np.array([name.startswith("left" if of == "torso" else of.partition("_")[0]) for name in robot.joints])
    reachable = np.where(own, q, near)  # what stays is where the seed has it
    wanted = found.predict(robot.table(reachable), of=of, within=within)[pose]
    told = found.compensate(wanted, seed=robot.table(near), of=of, within=within)
    assert told["reached"].all()
    commanded = told[robot.joints].to_numpy(float)
    again = found.predict(told[robot.joints], of=of, within=within)[pose]
    np.testing.assert_allclose(again[XYZ].to_numpy(float), wanted[XYZ].to_numpy(float), rtol=0, atol=1e-6)
    turned = np.abs(np.sum(again[pose[3:]].to_numpy(float) * wanted[pose[3:]].to_numpy(float), axis=1))
    np.testing.assert_allclose(turned, 1.0, rtol=0, atol=1e-10)
    np.testing.assert_allclose(commanded[:, ~own], near[:, ~own], rtol=0, atol=1e-12)
    assert np.abs(commanded - near)[:, own].max() > 0.01
    robot.table(near).assign(**wanted).to_csv(tmp_path / "poses.csv", index=False)
    asked = [str(folder / "calibration.yaml"), str(tmp_path / "poses.csv"), "-o", str(tmp_path / "joints.csv")]
    assert aridcal.compensate.main([*asked, "--of", of, "--in", within]) == 0
    written = pd.read_csv(tmp_path / "joints.csv")[robot.joints].to_numpy(float)
    np.testing.assert_allclose(written, commanded, rtol=0, atol=1e-9)


def test_poses_in_a_links_frame_need_a_link_that_is_to_be_there(
    both: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, found, folder = both
    poses = found.predict(robot.table(readings(robot, 2)), of="left_hand")
    with pytest.raises(CampaignError, match="of=LINK"):
        found.compensate(poses, within="right_hand")
    poses.to_csv(tmp_path / "poses.csv", index=False)
    asked = [str(folder / "calibration.yaml"), str(tmp_path / "poses.csv"), "-o", str(tmp_path / "out.csv")]
    assert aridcal.compensate.main([*asked, "--in", "right_hand"]) == 2
    assert "--of LINK" in " ".join(capsys.readouterr().err.split())


def test_commands_of_the_tips_link_are_those_of_the_target_where_a_robot_has_one_limb(tmp_path: Path) -> None:
    """With the target at the tip's origin, and the world frame that of the base, `of` changes nothing."""
    robot = two_arms.machine()
    q, frames = readings(robot, 40), {name: {"identify": False} for name in ("world_base", "tip_target")}
    path = two_arms.write(tmp_path, robot, ("tracker",), q, frames=frames, diagnosis={"enabled": False})
    rows = [[*T.translation, *pin.Quaternion(T.rotation).coeffs()] for T in robot.seen(q, "torso", "left_hand")]
    pose = ["x", "y", "z", "qx", "qy", "qz", "qw"]
    robot.table(q, **dict(zip(pose, np.array(rows).T, strict=True))).to_csv(tmp_path / "tracker.csv", index=False)
    document = yaml.safe_load(path.read_text())
    del document["instruments"]
    path.write_text(yaml.safe_dump(document))
    found = aridcal.calibrate(path)
    assert len(found.model.final.model.robot.limbs) == 1
    arm = [f"left_j{k}" for k in range(1, 7)]
    start = robot.table(q[:10] + 0.02)[arm]
    wanted = found.predict(robot.table(q[:10])[arm])[pose]
    plain, of = (found.compensate(wanted, seed=start, of=link) for link in (None, "left_hand"))
    np.testing.assert_allclose(of[arm].to_numpy(float), plain[arm].to_numpy(float), rtol=0, atol=1e-9)
    assert of.columns.tolist() == plain.columns.tolist() and plain["reached"].all()


@pytest.mark.parametrize("moved", ["", "right_j3"])
def test_a_check_names_the_joint_of_the_limb_that_moved(
    moved: str,
    both: tuple[two_arms.Machine, aridcal.Calibration, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot, found, _ = both
    since = replace(robot, slipped=(moved, 1e-3) if moved else None)
    two_arms.write(tmp_path, since, ("tracker",), readings(robot, 30, 7), seed=5)
    monkeypatch.chdir(tmp_path)  # the campaign's other tables are named from here
    told = found.check(tmp_path / "tracker.csv")
    assert told.good == (not moved)
    named = re.findall(r"the zero of (\w+) \(limb to (\w+)\), by \+([\d.]+) ", " ".join(told.lines))
    assert [(joint, limb) for joint, limb, _ in named] == ([(moved, "right_hand")] if moved else [])
    assert all(abs(float(size) - 1.0) < 0.15 for *_, size in named)


def test_programs_of_several_limbs_are_refused(
    both: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, _, folder = both
    (tmp_path / "p.script").write_text("movej([0,0,0,0,0,0])\n")
    asked = [str(folder / "calibration.yaml"), str(tmp_path / "p.script"), "-o", str(tmp_path / "out.script")]
    assert aridcal.compensate.main(asked) == 2
    assert "the calibration is of several limbs (left_hand, right_hand, camera)" in " ".join(
        capsys.readouterr().err.split()
    )
    assert not (tmp_path / "out.script").exists()


def test_a_payload_on_a_hand_bends_the_arm_that_carries_it(tmp_path: Path) -> None:
    q = readings(two_arms.machine(), 160)
    load = np.random.default_rng(4).choice([0.0, 5.0, 10.0], len(q))
    robot = replace(two_arms.machine(2, yields=1e-4), carried={"left_hand": load})
    keys = {"tip": "right_hand", "base": "torso", "urdf": "two_arms.urdf"}  # the default path is the other arm's
    declared = {"effects": [{"kind": "joint_compliance", "where": "left_j2"}], "diagnosis": {"enabled": False}}
    path = two_arms.write(tmp_path, robot, ("tracker",), q, payload={"column": "load", "on": "left_hand"}, **declared)
    _with(path, {"robot": keys})
    pd.read_csv(tmp_path / "tracker.csv").assign(load=load).to_csv(tmp_path / "tracker.csv", index=False)
    found = aridcal.calibrate(path)
    (effect,) = found.result["effects"]
    assert (effect["kind"], effect["where"]) == ("joint_compliance", "left_j2")
    (value,) = effect["coefficients"]
    assert abs(value["value"] - 1e-4) < 4 * value["std"] < 4e-6
    (tmp_path / "calibration.yaml").write_text(found.model.dump(), encoding="utf-8")
    table = robot.table(q[:20], load=load[:20], target=np.full(20, "left"))
    told, again = (
        each.predict(table)[XYZ].to_numpy(float) for each in (found, aridcal.load(tmp_path / "calibration.yaml"))
    )
    np.testing.assert_allclose(told, again, rtol=0, atol=1e-12)
    with pytest.raises(AridcalError, match="load"):
        found.predict(table.drop(columns=["load"]))
    with pytest.raises(CampaignError, match=r"payload.on: no link 'left_hnd' .*'left_hand'"):
        aridcal.calibrate(_with(path, {"payload": {"column": "load", "on": "left_hnd"}}))
    with pytest.raises(CampaignError, match=r"payload.on: no joint that rows measure bears 'torso'"):
        aridcal.calibrate(_with(path, {"payload": {"column": "load", "on": "torso"}}))


def test_payloads_on_both_hands_bend_the_arms_that_carry_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Round trip, and rows after a change, with a column for each mass."""
    q, rng = readings(two_arms.machine(), 150), np.random.default_rng(4)
    masses = {side: rng.choice([0.0, 5.0, 10.0], len(q)) for side in ("left", "right")}
    robot = two_arms.machine(2, yields=5e-5)
    robot = replace(
        robot, shoulders=("left_j2", "right_j2"), carried={f"{side}_hand": mass for side, mass in masses.items()}
    )
    columns = {f"w_{side}": mass for side, mass in masses.items()}
    payload = [{"column": f"w_{side}", "on": f"{side}_hand"} for side in masses]
    path = two_arms.write(tmp_path, robot, ("tracker",), q, payload=payload, diagnosis=SOUGHT)
    pd.read_csv(tmp_path / "tracker.csv").assign(**columns).to_csv(tmp_path / "tracker.csv", index=False)
    found = aridcal.calibrate(path)
    effects = {(e["kind"], e["where"]): e["coefficients"][0] for e in found.result["effects"]}
    assert set(effects) == {("joint_compliance", "left_j2"), ("joint_compliance", "right_j2")}
    assert all(abs(value["value"] - 5e-5) < 4 * value["std"] < 2e-6 for value in effects.values())
    (tmp_path / "calibration.yaml").write_text(found.model.dump(), encoding="utf-8")
    loaded = aridcal.load(tmp_path / "calibration.yaml")
    for side in masses:
        table = robot.table(q, target=np.full(len(q), side), **columns)
        told, again = (each.predict(table)[XYZ].to_numpy(float) for each in (found, loaded))
        np.testing.assert_allclose(told, again, rtol=0, atol=1e-12)
        lighter = found.predict(table.assign(**{f"w_{side}": 0.0}))[XYZ].to_numpy(float)
        other = found.predict(table.assign(**{f"w_{'right' if side == 'left' else 'left'}": 0.0}))
        np.testing.assert_allclose(told, other[XYZ].to_numpy(float), rtol=0, atol=1e-12)
        assert np.abs(told - lighter).max() > 5e-4
    with pytest.raises(AridcalError, match="payload_left_hand"):
        found.predict(table.drop(columns=["w_left"]))
    monkeypatch.chdir(tmp_path)  # the campaign's markers are named from here
    since = replace(robot, slipped=("right_j3", 1e-3))
    two_arms.write(tmp_path / "since", since, ("tracker",), q[:30], seed=5)
    new = pd.read_csv(tmp_path / "since" / "tracker.csv").assign(**{k: v[:30] for k, v in columns.items()})
    mended = loaded.recalibrate(new, tmp_path / "mended")
    (cause,) = mended.result["moved"]
    assert [(change["name"], abs(change["value"] - 1e-3) < 1.5e-4) for change in cause["changes"]] == [
        ("right_j3.axis", True)
    ]
    table = robot.table(q, target=np.full(len(q), "right"), **columns)
    real = np.array([T.act(two_arms.RIGHT) for T in since.seen(q, "torso", "right_hand")])
    off = []
    for each in (loaded, mended):
        told = each.predict(table)[XYZ].to_numpy(float)
        apart = [np.linalg.norm(np.diff(places, axis=0), axis=1) for places in (told, real)]  # needs no frame
        off.append(np.abs(apart[0] - apart[1]).max())
    assert off[1] < 2e-4 < 5e-4 < off[0], off


PAYLOADS = {
    "the column is not there": ([{"column": "w", "on": "left_hand"}], r"payload.column: the tables have no numeric column 'w'"),
    "one of two columns is not there": (
        [{"column": "qw", "on": "left_hand"}, {"column": "w", "on": "right_hand"}],
        r"payload\[[01]\].column: the tables have no numeric column",
    ),
    "two on one link": ([{"column": "a", "on": "left_hand"}, {"column": "b", "on": "left_hand"}], r"payload\[1\].on: two"),
    "two in one column": ([{"on": "left_hand"}, {"on": "right_hand"}], r"payload\[1\].column: two payloads"),
    "no link": ([{"column": "a", "on": "left_hand"}, {"column": "b", "on": "hand"}], r"payload\[1\].on: no link 'hand'"),
}  # fmt: skip


@pytest.mark.parametrize("name", PAYLOADS)
def test_payloads_that_cannot_be_meant_are_named(name: str, tmp_path: Path) -> None:
    payload, why = PAYLOADS[name]
    path = two_arms.write(tmp_path, two_arms.machine(), ("tracker",), readings(two_arms.machine(), 60), payload=payload)
    with pytest.raises(AridcalError, match=why):
        aridcal.calibrate(path)


def test_a_column_that_payload_names_may_stand_under_columns_too(tmp_path: Path) -> None:
    path = two_arms.write(tmp_path, two_arms.machine(), ("tracker",), readings(two_arms.machine(), 20))
    block = yaml.safe_load(path.read_text())["measurements"]
    for column, fits in (("load", True), ("mass", False)):
        _with(
            path,
            {
                "measurements": block | {"columns": {"payload": column}},
                "payload": {"column": "load", "on": "left_hand"},
            },
        )
        if fits:
            assert load_campaign(path).measurements.columns == {"payload": "load"}
        else:
            with pytest.raises(CampaignError, match=r"columns.payload: is 'mass' here and 'load' under payload.column"):
                load_campaign(path)


def test_a_row_needs_the_joints_of_its_own_path_alone(tmp_path: Path) -> None:
    robot = two_arms.machine()
    path = two_arms.write(tmp_path, robot, ("tracker",), readings(robot, 60), diagnosis={"enabled": False})
    table = pd.read_csv(tmp_path / "tracker.csv")
    assert table["right_j3"].isna().sum() == 30  # of rows that see the left hand
    table.loc[table["target"] == "right", "right_j3"] = table.loc[table["target"] == "right", "right_j3"].where(
        np.arange(30) > 0
    )
    table.to_csv(tmp_path / "tracker.csv", index=False)
    (refused,) = load_measurements_of(path).origin.refused
    assert "right_j3" in str(refused) and "on the row's path" in str(refused)
    table.drop(columns=["right_j3"]).to_csv(tmp_path / "tracker.csv", index=False)
    with pytest.raises(AridcalError, match="right_j3"):
        aridcal.calibrate(path)


SLIPS = {
    "a link that is none": (
        {"targets": {"left": {"on": "left_hnd"}}},
        "instruments.targets.left.on: no link 'left_hnd' .*'left_hand'",
    ),
    "a target on the base": (
        {"targets": {"left": {"on": "torso"}, "right": {"on": "right_hand"}}},
        "no joint moves between 'torso' and 'torso'",
    ),
    "two boards on one link": (
        {"markers": [{"file": "left.csv", "on": "left_hand"}, {"file": "right.csv", "on": "left_hand"}]},
        "two tables are of one carrier",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SLIPS)
def test_what_cannot_be_meant_is_named(name: str, tmp_path: Path) -> None:
    robot = two_arms.machine()
    things, why = SLIPS[name]
    ways = ("camera",) if "markers" in things else ("tracker",)
    path = two_arms.write(tmp_path, robot, ways, readings(robot, 60))
    document = yaml.safe_load(path.read_text())
    document["instruments"] |= things
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(AridcalError, match=why):
        aridcal.calibrate(path)


def test_without_links_a_campaign_has_one_chain_as_before(tmp_path: Path) -> None:
    robot = two_arms.machine()
    path = two_arms.write(tmp_path, robot, ("tracker",), readings(robot, 20))
    document = yaml.safe_load(path.read_text())
    del document["instruments"]
    path.write_text(yaml.safe_dump(document))
    assert nominal_robot(load_campaign(path)).readings == tuple(f"left_j{k}" for k in range(1, 7))
    with pytest.raises(CampaignError, match="unknown"):
        load_campaign(_with(path, {"instruments": {"targets": {"left": {"at": "left_hand"}}}}))


def test_without_a_tip_the_default_path_ends_at_the_first_link_that_is_named(tmp_path: Path) -> None:
    robot, keys = two_arms.machine(), {"urdf": "two_arms.urdf", "base": "torso"}
    path = two_arms.write(tmp_path, robot, ("tracker",), readings(robot, 40), diagnosis={"enabled": False})
    stated = load_campaign(_with(path, {"robot": keys | {"tip": "left_hand"}}))
    absent = load_campaign(_with(path, {"robot": keys}))
    assert absent.robot == stated.robot and absent.instruments == stated.instruments
    told = yaml.safe_load(aridcal.calibrate(path).model.dump())
    assert told["robot"]["tip"] == "left_hand"
    assert "tip" not in yaml.safe_load(told["campaign"])["robot"]  # it keeps the campaign as it was written


def test_a_camera_on_a_link_says_where_the_default_path_ends(tmp_path: Path) -> None:
    robot = two_arms.machine()
    path = two_arms.write(tmp_path, robot, ("camera", "joined"), readings(robot, 16))
    assert load_campaign(_with(path, {"robot": {"urdf": "two_arms.urdf", "base": "torso"}})).robot.tip == "camera"


def test_a_campaign_that_names_no_link_needs_a_tip(tmp_path: Path) -> None:
    robot = two_arms.machine()
    path = two_arms.write(tmp_path, robot, ("tracker",), readings(robot, 20))
    _with(
        path, {"robot": {"urdf": "two_arms.urdf", "base": "torso"}, "instruments": {"targets": {"left": {"on": "tip"}}}}
    )
    why = "robot.tip is missing: name the link that is calibrated, or give every target its link under instruments.targets"
    with pytest.raises(CampaignError, match=re.escape(f"{path}: {why} (on: LINK)")):
        load_campaign(path)


def _with(path: Path, keys: dict[str, object]) -> Path:
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | keys))
    return path


def test_the_benchmarks_robot_has_its_links_where_pinocchio_has_them() -> None:
    robot = tree_robot.built(3, tree_robot.urdf())
    model, count = robot.nominal.copy(), len(robot.joints)
    steps = [pin.SE3(pin.exp3(step[3:]), step[:3]) for step in robot.moved]
    for k in range(count):
        model.jointPlacements[k + 1] = robot.nominal.jointPlacements[k + 1] * steps[k]
    for link, step in zip(robot.ends, steps[count:], strict=True):
        model.frames[model.getFrameId(link)].placement *= step
    q, data, links = readings_of(count), model.createData(), ("left_hand", "right_hand", "camera")
    places = robot.places(q, links)
    for k, row in enumerate(q):
        pin.framesForwardKinematics(model, data, row)
        for link in links:
            expected = data.oMf[model.getFrameId(link)]
            np.testing.assert_allclose(places[link].R[k], expected.rotation, rtol=0, atol=1e-14)
            np.testing.assert_allclose(places[link].p[k], expected.translation, rtol=0, atol=1e-14)


def readings_of(count: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.1, 1.1, (20, count))


def test_couplings_and_curves_without_a_name_stay_within_a_limb() -> None:
    """Against the tree that the URDF has: joints of two limbs depend on one another only where one hangs from the other."""
    robot = with_limbs(parse_robot(two_arms.urdf(), "left_hand", "torso"), ["right_hand", "camera"])
    table = dict(zip(robot.readings, readings(two_arms.machine(), 50).T, strict=True)) | {"humidity": np.arange(50.0)}
    offered = candidates(ObservedRows(robot, table, ("humidity",)), ["joint_coupling", "unknown"])
    tree = pin.buildModelFromXML(two_arms.urdf().decode())
    for effect in offered:
        for name in {*effect.covariates, effect.with_} - {None, "humidity"}:
            if effect.where in robot.names:
                ways = [set(tree.supports[tree.getJointId(joint)]) for joint in (effect.where, name)]
                assert ways[0] <= ways[1] or ways[1] <= ways[0], effect.label
    assert {e.with_ for e in offered if e.kind == "joint_coupling" and e.where == "pan"} == {"nod"}
    assert {e.where for e in offered if "humidity" in e.covariates} == {*robot.names, "tip_target"}


def test_without_a_tip_a_target_that_no_key_names_is_refused(tmp_path: Path) -> None:
    path = two_arms.write(tmp_path, two_arms.machine(), ("tracker",), readings(two_arms.machine(), 40))
    document = yaml.safe_load(path.read_text())
    pd.read_csv(tmp_path / "tracker.csv").fillna(0.1).to_csv(tmp_path / "tracker.csv", index=False)
    del document["instruments"]["targets"]["right"]
    path.write_text(yaml.safe_dump(document))
    load_measurements_of(path)  # on the tip, which is named
    del document["robot"]["tip"]
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(
        AridcalError, match=r"no key says on which link the target 'right' is: add instruments.targets.right"
    ):
        load_measurements_of(path)


def load_measurements_of(path: Path) -> Dataset:
    campaign = load_campaign(path)
    robot = nominal_robot(campaign)
    return load_measurements(campaign, robot.readings, robot.limits, robot.kinds, robot=robot)
