"""Cells of several limbs, by Pinocchio: a positioner beside an arm, an arm on a platform that moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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

SIGMA = 1e-4
"""[m] and [rad] per axis."""

FINGER = np.array([0.05, 0.02, 0.01])
ARM = (
    ("0 0 1", "0 0 0.3"),
    ("0 1 0", "0 0.02 0"),
    ("0 1 0", "0.35 0 0.02"),
    ("1 0 0", "0.05 0.01 0"),
    ("0 1 0", "0.3 0 0.02"),
    ("1 0 0", "0.05 0.01 0"),
)


@dataclass(frozen=True)
class Moves:
    """A joint of a limb: how it moves, about or along what, where it is on the one before."""

    kind: str
    axis: str
    xyz: str
    rpy: str = "0 0 0"


def arm(at: str) -> list[Moves]:
    """Six joints that stand somewhere."""
    return [Moves("revolute", axis, at if k == 0 else xyz) for k, (axis, xyz) in enumerate(ARM)]


def urdf(root: str, limbs: Sequence[tuple[str, str, Sequence[Moves], str]]) -> bytes:
    """Limbs, each of a name, the link that it hangs from, joints ``NAME_j1`` on, and the link at its end."""
    parts = ['<?xml version="1.0"?>', f'<robot name="cell"><link name="{root}"/>']
    for name, parent, joints, end in limbs:
        for k, joint in enumerate([*joints, Moves("fixed", "", "0.1 0 0")], 1):
            last = k > len(joints)
            link = end if last else f"{name}_{k}"
            limit = f'<axis xyz="{joint.axis}"/><limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>'
            parts.append(
                f'<link name="{link}"><inertial><mass value="2"/><origin xyz="0.1 0 0.02"/><inertia ixx="0.01" iyy="0.01" '
                f'izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="{name}_{"mount" if last else f"j{k}"}" '
                f'type="{joint.kind}"><parent link="{parent}"/><child link="{link}"/><origin xyz="{joint.xyz}" '
                f'rpy="{joint.rpy}"/>{"" if last else limit}</joint>'
            )
            parent = link
    return "\n".join([*parts, "</robot>"]).encode()


def as_built(text: bytes, root: str, ends: Sequence[str], seed: int = 0) -> two_arms.Machine:
    """The same with origins of all joints that move off by 1 mm and 1 mrad, as Pinocchio has it."""
    rng, origins = np.random.default_rng(seed), {}
    for end in ends:
        for joint in parse_robot(text, end, root).joints:
            off = pin.SE3(Rotation.from_rotvec(rng.normal(0, 1e-3, 3)).as_matrix(), rng.normal(0, 1e-3, 3))
            origins.setdefault(joint.name, joint.origin * off)
    made = splice_origins(text, origin_texts(text, origins))
    return two_arms.Machine(pin.buildModelFromXML(made.decode()), shoulders=())


def met(
    machine: two_arms.Machine, q: np.ndarray, off: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Readings near those given at which something (of readings and numbers of rows) is zero, and which rows got there."""
    q, rows = q.copy(), np.arange(len(q))
    left = rows  # those not there yet
    for _ in range(15):
        now = off(q[left], left)
        away = np.linalg.norm(now, axis=1) > 1e-10
        left, now = left[away], now[away]
        if not len(left):
            break
        J = np.stack([(off(q[left] + step, left) - now) / 1e-6 for step in 1e-6 * np.eye(q.shape[1])], axis=2)
        q[left] = np.clip(q[left] - np.einsum("njm,nm->nj", np.linalg.pinv(J, rcond=1e-3), now), -1.4, 1.4)
    return q, np.linalg.norm(off(q, rows), axis=1) < 1e-9


def write(folder: Path, text: bytes, robot: dict[str, Any], tables: dict[str, pd.DataFrame], **keys: Any) -> Path:
    """A campaign; a block's file is called as its table."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cell.urdf").write_bytes(text)
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    document = {"format": 1, "robot": {"urdf": "cell.urdf"} | robot} | keys
    (folder / "campaign.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    return folder / "campaign.yaml"


def tracked(places: Sequence[pin.SE3], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Poses as a tracker reads them."""
    world = pin.SE3(Rotation.from_rotvec([0.3, -0.2, 2.0]).as_matrix(), np.array([2.0, -1.0, 0.5]))
    rows = []
    for place in places:
        T = world * place
        R = Rotation.from_rotvec(rng.normal(0, SIGMA, 3)) * Rotation.from_matrix(T.rotation)
        rows.append([*T.translation + rng.normal(0, SIGMA, 3), *R.as_quat()])
    return dict(zip(["x", "y", "z", "qx", "qy", "qz", "qw"], np.array(rows).T, strict=True))
