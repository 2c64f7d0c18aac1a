"""Simulated robots of several limbs: what was written is what the true URDF shows, by Pinocchio."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import two_arms
import yaml
from scipy.spatial.transform import Rotation

from aridcal.engine.instruments.camera import project
from aridcal.engine.robot.chain import parse_robot
from aridcal.engine.robot.splice import origin_texts, splice_origins
from aridcal.simulate import main

N = 30
WORLD = {"xyz": [1.0, -0.5, 0.3], "rpy": [0.1, -0.2, 2.0]}
FINGER, LEFT, BALL = [0.05, 0.02, 0.01], [0.02, -0.01, 0.03], [0.02, 0.01, 0.1]
EYE = two_arms.LENS | {"distortion": [-0.1, 0.02, 1e-3, -2e-3, 0.0]}
CONSTANTS = {f"{joint}.{c}": {"std": 1e-3} for joint in ("left_j2", "left_j4", "right_j1", "right_j5")
             for c in ("x", "y", "roll", "yaw")}  # fmt: skip
OF_HEAD = {"pan.x": 1e-3, "nod.roll": -2e-3, "nod.z": 1e-3}
BLOCKS = [
    {"kind": "pose", "name": "tracker"},
    {"kind": "point", "target": "finger"},
    {"kind": "distance", "name": "bar", "target": "finger"},
    {"kind": "pixels", "camera": "eye"},
]


def scenario(folder: Path, blocks: list[dict] | dict, known: dict | None = None, **truth: object) -> Path:
    """Two arms and a head, measured with everything at once."""
    (folder / "two_arms.urdf").write_bytes(two_arms.urdf())
    for side in ("left", "right"):
        marks = [f"{side}_{k},{0.03 * (k % 3 - 1)},{0.03 * (k // 3 - 1)},0.02" for k in range(9)]
        (folder / f"{side}.csv").write_text("\n".join(["marker,x,y,z", *marks]) + "\n")
    things = {
        "targets": {"left": {"on": "left_hand", "xyz": LEFT}, "right": {"on": "right_hand"},
                    "finger": {"on": "left_hand", "xyz": FINGER}},
        "points": {"on": "right_hand"},
        "anchors": {"ball": {"on": "right_hand", "xyz": BALL, "offset": 0.0, "identify": ["place"]}},
        "cameras": {"eye": EYE | {"on": "camera"}},
        "markers": [{"file": "left.csv", "on": "left_hand"}, {"file": "right.csv", "on": "right_hand"}],
    }  # fmt: skip
    kinds = {block["kind"] for block in (blocks if isinstance(blocks, list) else [blocks])}
    needed = {"point": ("points",), "distance": ("anchors",), "pixels": ("cameras", "markers")}
    wanted = {"targets", *(key for kind in kinds for key in needed.get(kind, ()))}
    keys = {
        "format": 1,
        "robot": {"urdf": "two_arms.urdf", "base": "torso", "tip": "left_hand"},
        "measurements": blocks,
        "instruments": {key: value for key, value in things.items() if key in wanted} | (known or {}),
        "truth": {"n": N, "seed": 3, "frames": {"world_base": WORLD}, "parameters": CONSTANTS} | truth,
    }
    (folder / "scenario.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(keys))))
    return folder / "scenario.yaml"


def made(folder: Path, *arguments: object, **truth: object) -> tuple[two_arms.Machine, dict, list[pd.DataFrame]]:
    """The true robot as Pinocchio has it, the truth as its file has it, and the tables."""
    out = folder / "out"
    assert main([str(scenario(folder, *arguments, **truth)), "-o", str(out)]) == 0
    told = json.loads((out / "truth.json").read_text())
    files = sorted(out.glob("measurements*.csv"))
    return (
        two_arms.Machine(pin.buildModelFromXML(true_urdf(told["parameters"]).decode())),
        told,
        [*map(pd.read_csv, files)],
    )


def true_urdf(parameters: dict[str, float]) -> bytes:
    """The nominal URDF, each origin moved by its own constants."""
    off = {joint: np.zeros(6) for joint in (name.partition(".")[0] for name in parameters)}
    for name, value in parameters.items():
        joint, _, component = name.partition(".")
        off[joint][("x", "y", "z", "roll", "pitch", "yaw").index(component)] = value
    nominal = [
        joint
        for tip in ("left_hand", "right_hand", "head")
        for joint in parse_robot(two_arms.urdf(), tip, "torso").joints
    ]
    origins = {
        joint.name: joint.origin * pin.SE3(pin.rpy.rpyToMatrix(off[joint.name][3:]), off[joint.name][:3])
        for joint in nominal
        if joint.name in off
    }
    return splice_origins(two_arms.urdf(), origin_texts(two_arms.urdf(), origins))


def readings(robot: two_arms.Machine, table: pd.DataFrame) -> np.ndarray:
    """Of all joints: those on no path, 0."""
    return table.reindex(columns=robot.joints, fill_value=0.0).to_numpy()


def frame(place: dict) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(place["rpy"])), np.array(place["xyz"]))


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[two_arms.Machine, dict, list[pd.DataFrame]]]:
    """Tables of all kinds, without noise."""
    folder = tmp_path_factory.mktemp("exact")
    return folder, made(folder, BLOCKS, parameters=CONSTANTS | OF_HEAD)


Exact = tuple[Path, tuple[two_arms.Machine, dict, list[pd.DataFrame]]]


def test_without_noise_tables_of_all_kinds_are_those_of_the_true_robot(exact: Exact) -> None:
    folder, (robot, truth, (tracker, touch, bar, corners)) = exact
    things = truth["instruments"]

    q = readings(robot, tracker)
    assert set(tracker["target"]) == {"left", "right"}  # `finger` is what other blocks measure
    for side, own in (("left", LEFT), ("right", [0, 0, 0])):
        rows = np.flatnonzero(tracker["target"] == side)
        poses = [
            frame(WORLD) * T * pin.SE3(np.eye(3), np.array(own)) for T in robot.seen(q[rows], "torso", f"{side}_hand")
        ]
        np.testing.assert_allclose(
            tracker[["x", "y", "z"]].to_numpy()[rows], [T.translation for T in poses], atol=1e-12
        )
        told = Rotation.from_quat(tracker[["qx", "qy", "qz", "qw"]].to_numpy()[rows])
        off = told.inv() * Rotation.from_matrix([T.rotation for T in poses])
        np.testing.assert_allclose(off.magnitude(), 0.0, atol=1e-9)

    at = np.array([things["point"][name]["xyz"] for name in touch["point"]])
    met = np.array([T.act(np.array(FINGER)) for T in robot.seen(readings(robot, touch), "right_hand", "left_hand")])
    np.testing.assert_allclose(met, at, atol=1e-9)
    assert set(touch["point"]) == {f"point_{k}" for k in range(1, 5)}
    assert np.linalg.norm(at, axis=1).max() < 0.15  # they are on the hand

    places = np.array([T.act(np.array(FINGER)) for T in robot.seen(readings(robot, bar), "right_hand", "left_hand")])
    np.testing.assert_allclose(bar["distance"], np.linalg.norm(places - BALL, axis=1), atol=1e-12)

    lens = np.array([*(EYE[key] for key in ("fx", "fy", "cx", "cy")), *EYE["distortion"]])
    assert set(corners["marker"].str.partition("_")[0]) == {"left", "right"}
    for side in ("left", "right"):
        own = corners[corners["marker"].str.startswith(side)]
        marks = pd.read_csv(folder / f"{side}.csv").set_index("marker").loc[own["marker"]].to_numpy()
        T = robot.seen(readings(robot, own), "camera", f"{side}_hand")
        seen = np.array([each.act(mark) for each, mark in zip(T, marks, strict=True)])
        np.testing.assert_allclose(own[["u", "v"]].to_numpy(), project(seen, lens), atol=1e-8)
        assert (seen[:, 2] > 0.1).all()
    assert corners[["u", "v"]].min().min() > 0 and corners["u"].max() < 639 and corners["v"].max() < 479


def test_postures_are_inside_the_limits_and_differ(exact: Exact) -> None:
    robot, _, tables = exact[1]
    for table in tables:
        q = readings(robot, table)
        assert np.abs(q).max() <= 1.5
        assert (q.std(axis=0) > 0.2).all()


@pytest.mark.parametrize(("kind", "channel"), [("point", "position"), ("distance", "distance")])
def test_noise_between_two_hands_is_as_large_as_it_was_asked_for(kind: str, channel: str, tmp_path: Path) -> None:
    robot, truth, (table,) = made(tmp_path, {"kind": kind, "target": "finger"}, n=300, noise={channel: 1e-3})
    met = np.array([T.act(np.array(FINGER)) for T in robot.seen(readings(robot, table), "right_hand", "left_hand")])
    if kind == "point":
        off = met - [truth["instruments"]["point"][name]["xyz"] for name in table["point"]]
    else:
        off = np.linalg.norm(met - BALL, axis=1) - table["distance"]
    assert abs(np.sqrt(np.mean(off**2)) / 1e-3 - 1.0) < 4.0 / np.sqrt(2 * off.size)


def test_effects_of_both_arms_act_and_the_hands_still_meet(tmp_path: Path) -> None:
    yields = 2e-4
    effects = [{"kind": "joint_compliance", "where": "left_j2", "coefficients": yields},
               {"kind": "joint_harmonic", "where": "right_j3", "order": 1, "coefficients": [2e-3, 1e-3]}]  # fmt: skip
    robot, truth, (table,) = made(tmp_path, {"kind": "point", "target": "finger"}, effects=effects, n=60)
    q, nominal = readings(robot, table), pin.buildModelFromXML(two_arms.urdf().decode())
    data, shoulder = nominal.createData(), robot.joints.index("left_j2")
    bent = q.copy()
    bent[:, shoulder] -= yields * np.array([pin.computeGeneralizedGravity(nominal, data, row)[shoulder] for row in q])
    third = robot.joints.index("right_j3")
    bent[:, third] += 2e-3 * np.sin(q[:, third]) + 1e-3 * np.cos(q[:, third])
    at = np.array([truth["instruments"]["point"][name]["xyz"] for name in table["point"]])
    met, stiff = (
        np.array([T.act(np.array(FINGER)) for T in robot.seen(rows, "right_hand", "left_hand")]) for rows in (bent, q)
    )
    np.testing.assert_allclose(met, at, atol=1e-9)
    assert np.linalg.norm(stiff - at, axis=1).max() > 1e-3


JOINED = {"kind": "joined", "links": ["left_hand", "right_hand"], "name": "bar"}
SHOULDERS = {
    side: {"kind": "joint_compliance", "where": f"{side}_j2", "coefficients": 1e-4} for side in ("left", "right")
}


def held(truth: dict, grasp: str) -> pin.SE3:
    """The second hand in the first, as the file of the truth has it."""
    return frame(truth["instruments"]["grasp"][grasp])


def test_both_hands_hold_the_body_as_it_was_grasped(tmp_path: Path) -> None:
    """Second road: Pinocchio's poses of the true robot, one shoulder of which gives way."""
    blocks = [JOINED, JOINED | {"name": "head", "links": ["camera", "right_hand"]}]
    robot, truth, tables = made(tmp_path, blocks, {}, n=24, effects=[SHOULDERS["left"]], parameters=CONSTANTS | OF_HEAD)
    nominal, shoulder = pin.buildModelFromXML(two_arms.urdf().decode()), robot.joints.index("left_j2")
    data = nominal.createData()
    for table, (first, second) in zip(tables, (JOINED["links"], ("camera", "right_hand")), strict=True):
        q = readings(robot, table)
        bent = q.copy()
        bent[:, shoulder] -= 1e-4 * np.array([pin.computeGeneralizedGravity(nominal, data, row)[shoulder] for row in q])
        for T, grasp in zip(robot.seen(bent, first, second), table["grasp"], strict=True):
            np.testing.assert_allclose(pin.log6(held(truth, grasp).actInv(T)).vector, 0.0, rtol=0, atol=2e-8)
        assert np.abs(q).max() <= 1.5 and table["grasp"].nunique() == 6
        assert (table["grasp"] != table["grasp"].shift()).sum() == 6  # one after the other
        moved = q[:, [name.startswith("right") for name in robot.joints]]
        assert all(np.ptp(moved[table["grasp"] == grasp], axis=0).max() > 0.3 for grasp in set(table["grasp"]))
    assert set(tables[0]["grasp"]).isdisjoint(tables[1]["grasp"])


def test_a_body_gives_way_by_the_noise(tmp_path: Path) -> None:
    robot, truth, (table,) = made(tmp_path, JOINED, {}, n=200, noise={"position": 1e-3, "rotation": 2e-3})
    T = robot.seen(readings(robot, table), *JOINED["links"])
    off = [held(truth, grasp).actInv(each) for grasp, each in zip(table["grasp"], T, strict=True)]
    for values, sigma in (([o.translation for o in off], 1e-3), ([pin.log3(o.rotation) for o in off], 2e-3)):
        assert abs(np.sqrt(np.mean(np.square(values))) / sigma - 1.0) < 4.0 / np.sqrt(2 * 3 * len(off))


@pytest.mark.parametrize("sides", [("left",), ("right", "left")])
def test_payloads_bend_the_arms_that_carry_them(sides: tuple[str, ...], tmp_path: Path) -> None:
    """Second road: Pinocchio's inverse dynamics of the nominal robot with the masses that the table has."""
    payload = [{"column": f"w_{side}", "on": f"{side}_hand"} for side in sides]
    keys = {"payload": payload if len(sides) > 1 else payload[0]}
    path = scenario(tmp_path, {"kind": "pose"}, {}, effects=[*SHOULDERS.values()])
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | keys))
    assert main([str(path), "-o", str(tmp_path / "out")]) == 0
    table = pd.read_csv(tmp_path / "out" / "measurements.csv")
    assert yaml.safe_load((tmp_path / "out" / "campaign.yaml").read_text())["payload"] == payload
    told = json.loads((tmp_path / "out" / "truth.json").read_text())
    robot = two_arms.Machine(pin.buildModelFromXML(true_urdf(told["parameters"]).decode()))
    q, nominal = readings(robot, table), pin.buildModelFromXML(two_arms.urdf().decode())
    bent = q.copy()
    for k, row in enumerate(q):
        heavy = nominal.copy()
        for side in sides:
            hand = nominal.frames[nominal.getFrameId(f"{side}_hand")]
            mass = pin.Inertia(float(table[f"w_{side}"][k]), hand.placement.translation, np.zeros((3, 3)))
            heavy.inertias[hand.parentJoint] += mass
        pulled = pin.computeGeneralizedGravity(heavy, heavy.createData(), row)
        for joint in ("left_j2", "right_j2"):
            bent[k, robot.joints.index(joint)] -= 1e-4 * pulled[robot.joints.index(joint)]
    for side, own in (("left", LEFT), ("right", [0, 0, 0])):
        rows = np.flatnonzero(table["target"] == side)
        seen = robot.seen(bent[rows], "torso", f"{side}_hand")
        places = [frame(WORLD).act(T.act(np.array(own))) for T in seen]
        np.testing.assert_allclose(table[["x", "y", "z"]].to_numpy()[rows], places, rtol=0, atol=1e-9)
    assert all(set(table[f"w_{side}"]) == {0.0, 1.0, 2.5, 5.0} for side in sides)
