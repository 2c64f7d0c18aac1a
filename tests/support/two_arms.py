"""A torso with two arms of six joints and a head with a camera: what rows of every kind between its links read, by Pinocchio."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import two_arms
import yaml
from scipy.spatial.transform import Rotation

from aridcal.engine.robot.chain import parse_robot
from aridcal.engine.robot.splice import origin_texts, splice_origins

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
STEPS = ("0 {y} 0.3", "0 0.02 0", "0.3 0 0.02", "0.05 0.01 0", "0.3 0 0.02", "0.05 0.01 0")
SIGMA, PIXEL = 1e-4, 0.2
LENS = {"fx": 700.0, "fy": 700.0, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}


def urdf() -> bytes:
    """The nominal robot."""
    parts = ['<?xml version="1.0"?>', '<robot name="two_arms"><link name="torso"/>']

    def hung(name: str, joint: str, parent: str, xyz: str, kind: str, axis: str = "", rpy: str = "0 0 0") -> None:
        moves = f'<axis xyz="{axis}"/><limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>' if axis else ""
        parts.append(
            f'<link name="{name}"><inertial><mass value="2"/><origin xyz="0.1 0 0.02"/><inertia ixx="0.01" iyy="0.01" '
            f'izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="{joint}" type="{kind}">'
            f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{xyz}" rpy="{rpy}"/>{moves}</joint>'
        )

    for side, y in (("left", 0.2), ("right", -0.2)):
        parent = "torso"
        for k, (axis, xyz) in enumerate(zip(AXES, STEPS, strict=True), 1):
            hung(f"{side}_{k}", f"{side}_j{k}", parent, xyz.format(y=y), "revolute", axis)
            parent = f"{side}_{k}"
        hung(f"{side}_hand", f"{side}_mount", parent, "0.1 0 0", "fixed")
    hung("neck", "pan", "torso", "0.05 0 0.6", "revolute", "0 0 1")
    hung("head", "nod", "neck", "0.02 0 0.1", "revolute", "0 1 0")
    hung("camera", "camera_mount", "head", "0.08 0 0.05", "fixed", rpy="-1.9 0 -1.57")
    return "\n".join([*parts, "</robot>"]).encode()


def real(seed: int) -> bytes:
    """The same robot as it was built: origins of all joints that move off by 1 mm and 1 mrad."""
    rng = np.random.default_rng(seed)
    origins = {}
    for tip in ("left_hand", "right_hand", "head"):
        for joint in parse_robot(urdf(), tip, "torso").joints:
            off = pin.SE3(Rotation.from_rotvec(rng.normal(0, 1e-3, 3)).as_matrix(), rng.normal(0, 1e-3, 3))
            origins[joint.name] = joint.origin * off
    return splice_origins(urdf(), origin_texts(urdf(), origins))


@dataclass(frozen=True)
class Machine:
    """The real robot, whose links are asked where they are.

    Attributes:
        model: Its own.
        yields: By how much shoulders give way, [rad/(N m)].
        slipped: A joint, and by how much its zero has moved, [rad].
        carried: Mass that hangs at a hand in each row, [kg].
        shoulders: Joints that give way.
    """

    model: pin.Model
    yields: float = 0.0
    slipped: tuple[str, float] | None = None
    carried: Mapping[str, np.ndarray] = field(default_factory=dict)
    shoulders: tuple[str, ...] = ("left_j2",)

    @property
    def joints(self) -> list[str]:
        """Names of its joints."""
        return [name for name in self.model.names if name != "universe"]

    def seen(self, q: np.ndarray, start: str, end: str) -> list[pin.SE3]:
        """From one link to another in some rows, (N, joints)."""
        data, found, heavy = self.model.createData(), [], self.model.copy()
        shoulders = [self.joints.index(name) for name in self.shoulders]
        for k, row in enumerate(q):
            for link, masses in self.carried.items():
                hand = self.model.frames[self.model.getFrameId(link)]
                mass = pin.Inertia(float(masses[k]), hand.placement.translation, np.zeros((3, 3)))
                heavy.inertias[hand.parentJoint] = self.model.inertias[hand.parentJoint] + mass
            bent = row.copy()
            if self.slipped is not None:
                bent[self.joints.index(self.slipped[0])] += self.slipped[1]
            bent[shoulders] -= self.yields * pin.computeGeneralizedGravity(heavy, data, row)[shoulders]
            pin.framesForwardKinematics(self.model, data, bent)
            one, other = (data.oMf[self.model.getFrameId(link)] for link in (start, end))
            found.append(one.actInv(other))
        return found

    def table(self, q: np.ndarray, **columns: np.ndarray) -> pd.DataFrame:
        """Readings and what else was read."""
        return pd.DataFrame(dict(zip(self.joints, q.T, strict=True)) | columns)


def machine(seed: int = 0, yields: float = 0.0) -> Machine:
    """The real robot."""
    return Machine(pin.buildModelFromXML(real(seed).decode()), yields)


LEFT, RIGHT = np.array([0.05, 0.02, 0.01]), np.array([0.04, -0.02, 0.03])
BALL = np.array([0.02, 0.01, 0.1])


def tracker(
    robot: Machine, q: np.ndarray, rng: np.random.Generator
) -> tuple[pd.DataFrame, dict[str, Any], dict[str, Any]]:
    """A tracker sees targets on both hands, in turn; joints of the other arm are not recorded."""
    world = pin.SE3(Rotation.from_rotvec([0.3, -0.2, 2.0]).as_matrix(), np.array([2.0, -1.0, 0.5]))
    side = np.where(np.arange(len(q)) % 2, "left", "right")
    rows = []
    for k, (left, right) in enumerate(
        zip(robot.seen(q, "torso", "left_hand"), robot.seen(q, "torso", "right_hand"), strict=True)
    ):
        T = world * (left if side[k] == "left" else right)
        R = Rotation.from_rotvec(rng.normal(0, SIGMA, 3)) * Rotation.from_matrix(T.rotation)
        place = T.act(LEFT if side[k] == "left" else RIGHT) + rng.normal(0, SIGMA, 3)
        rows.append([*place, *R.as_quat()])
    table = robot.table(
        q, target=side, **dict(zip(["x", "y", "z", "qx", "qy", "qz", "qw"], np.array(rows).T, strict=True))
    )
    for name in robot.joints:
        if name.startswith(("left", "right")):
            table[name] = table[name].where(side == name.partition("_")[0])
    block = {"kind": "pose", "noise": {"position": SIGMA, "rotation": SIGMA}}
    return table, block, {"targets": {"left": {"on": "left_hand"}, "right": {"on": "right_hand"}}}


def ballbar(
    robot: Machine, q: np.ndarray, rng: np.random.Generator
) -> tuple[pd.DataFrame, dict[str, Any], dict[str, Any]]:
    """A bar from a ball on the right hand to a finger of the left one."""
    reached = np.array([T.act(LEFT) for T in robot.seen(q, "right_hand", "left_hand")])
    length = np.linalg.norm(reached - BALL, axis=1) + rng.normal(0, SIGMA, len(q))
    block = {"kind": "distance", "target": "finger", "noise": {"distance": SIGMA}}
    things = {"anchors": {"ball": {"on": "right_hand", "xyz": BALL.tolist(), "offset": 0.0, "identify": ["place"]}}}
    return (
        robot.table(q, distance=length),
        block,
        things | {"targets": {"finger": {"on": "left_hand", "xyz": LEFT.tolist()}}},
    )


def camera(
    robot: Machine, q: np.ndarray, rng: np.random.Generator
) -> tuple[pd.DataFrame, dict[str, Any], dict[str, Any]]:
    """The camera on the head sees four markers on either hand, wherever they come into its image."""
    rows = []
    for side, own in (("left", LEFT), ("right", RIGHT)):
        marks = own + np.array([[0, 0, 0], [0.04, 0, 0], [0, 0.04, 0], [0, 0, 0.04]])
        for k, T in enumerate(robot.seen(q, "camera", f"{side}_hand")):
            for name, mark in enumerate(marks):
                x, y, z = T.act(mark)
                u, v = LENS["fx"] * x / z + LENS["cx"], LENS["fy"] * y / z + LENS["cy"]
                if z > 0.1 and 5 < u < 634 and 5 < v < 474:
                    u, v = np.array([u, v]) + rng.normal(0, PIXEL, 2)
                    rows.append(
                        {
                            **dict(zip(robot.joints, q[k], strict=True)),
                            "marker": f"{side}_{name}",
                            "u": u,
                            "v": v,
                            "shot": k,
                        }
                    )
    block = {"kind": "pixels", "camera": "eye", "noise": {"pixel": PIXEL}}
    things = {
        "cameras": {"eye": {**LENS, "on": "camera"}},
        "markers": [{"file": "left.csv", "on": "left_hand"}, {"file": "right.csv", "on": "right_hand"}],
    }
    return pd.DataFrame(rows), block, things


GRASPS = 8


def grasps(robot: Machine, n: int, rng: np.random.Generator, sigma: float = SIGMA) -> tuple[np.ndarray, np.ndarray]:
    """Postures (n, joints) in which both hands hold a body, taken anew every so often, and the label of each grasp."""
    model, data = robot.model, robot.model.createData()
    left, right = (model.getFrameId(f"{side}_hand") for side in ("left", "right"))
    own = [model.joints[model.getJointId(name)].idx_v for name in robot.joints if name.startswith("right")]
    found: list[np.ndarray] = []
    label: list[str] = []
    for grasp in range(GRASPS):
        home, count = rng.uniform(-0.8, 0.8, model.nq), 0
        (held,) = robot.seen(home[None], "left_hand", "right_hand")
        while count < n // GRASPS:
            q = home + np.clip(rng.normal(0, 0.5, model.nq), -1, 1)
            slack = pin.SE3(Rotation.from_rotvec(rng.normal(0, sigma, 3)).as_matrix(), rng.normal(0, sigma, 3))
            for _ in range(12):
                pin.framesForwardKinematics(model, data, q)
                off = pin.log6(data.oMf[right].actInv(data.oMf[left] * held * slack)).vector
                if np.abs(off).max() < 1e-12:
                    break
                J = pin.computeFrameJacobian(model, data, q, right)[:, own]
                q[own] += np.clip(np.linalg.lstsq(J, off, rcond=1e-6)[0], -0.3, 0.3)
            if np.abs(off).max() < 1e-10 and np.abs(q).max() < 1.5:
                found.append(q)
                label.append(f"grasp {grasp}")
                count += 1
    q = np.array(found)
    if robot.slipped is not None:
        q[:, robot.joints.index(robot.slipped[0])] -= robot.slipped[1]  # what is read there
    return q, np.array(label)


def joined(
    robot: Machine, q: np.ndarray, rng: np.random.Generator
) -> tuple[pd.DataFrame, dict[str, Any], dict[str, Any]]:
    """Both hands hold a body that gives way by the noise."""
    q, label = grasps(robot, len(q), rng)
    block = {"kind": "joined", "links": ["left_hand", "right_hand"], "noise": {"position": SIGMA, "rotation": SIGMA}}
    return robot.table(q, grasp=label), block, {}


WAYS = {"tracker": tracker, "ballbar": ballbar, "camera": camera, "joined": joined}


def write(folder: Path, robot: Machine, ways: tuple[str, ...], q: np.ndarray, seed: int = 1, **more: Any) -> Path:
    """A campaign of some ways to measure, one block each."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "two_arms.urdf").write_bytes(urdf())
    for side, own in (("left", LEFT), ("right", RIGHT)):
        marks = own + np.array([[0, 0, 0], [0.04, 0, 0], [0, 0.04, 0], [0, 0, 0.04]])
        table = pd.DataFrame(marks, columns=["x", "y", "z"])
        table.insert(0, "marker", [f"{side}_{k}" for k in range(4)])
        table.to_csv(folder / f"{side}.csv", index=False)
    blocks: list[dict[str, Any]] = []
    things: dict[str, Any] = {}
    for way in ways:
        table, block, named = WAYS[way](robot, q, rng)
        table.to_csv(folder / f"{way}.csv", index=False)
        blocks.append(block | {"file": f"{way}.csv"})
        for key, value in named.items():
            things[key] = {**things.get(key, {}), **value} if isinstance(value, dict) else value
    document = {
        "format": 1,
        "robot": {"urdf": "two_arms.urdf", "base": "torso", "tip": "left_hand"},
        "measurements": blocks if len(blocks) > 1 else blocks[0],
        "instruments": things,
    } | more
    (folder / "campaign.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    return folder / "campaign.yaml"


def readings(robot: two_arms.Machine, n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.1, 1.1, (n, len(robot.joints)))
