"""Arms for data sets that deceive: written as URDFs, or read from the project's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from plain_arm import Arm, read_arm
from scipy.spatial.transform import Rotation

TOP = Path(__file__).resolve().parents[1]
DOWN = (0.0, 0.0, -9.81)
MOST = 2.6
"""[rad]: no joint turns further to either side, as in a cell."""


def _links(rows: Sequence[tuple[str, tuple[float, ...], tuple[float, ...], str, float, float]], mass: float) -> str:
    """A URDF of joints (type, xyz, rpy, axis, lower, upper); masses fall towards the tip."""
    text = ['<robot name="plain"><link name="base"/>']
    for k, (kind, xyz, rpy, axis, low, high) in enumerate(rows, start=1):
        after = rows[k][1] if k < len(rows) else (0.0, 0.0, 0.08)
        centre = " ".join(f"{0.5 * v + 0.01:.6f}" for v in after)
        text.append(
            f'<link name="link_{k}"><inertial><origin xyz="{centre}"/><mass value="{mass:.4f}"/>'
            f'<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
            f'<joint name="joint_{k}" type="{kind}"><parent link="{f"link_{k - 1}" if k > 1 else "base"}"/>'
            f'<child link="link_{k}"/><origin xyz="{" ".join(f"{v:.9f}" for v in xyz)}" '
            f'rpy="{" ".join(f"{v:.9f}" for v in rpy)}"/><axis xyz="{axis}"/>'
            f'<limit lower="{low:.6f}" upper="{high:.6f}" effort="1" velocity="1"/></joint>'
        )
        mass *= 0.7
    text.append(
        f'<link name="tip"/><joint name="tip_fixed" type="fixed"><parent link="link_{len(rows)}"/>'
        '<child link="tip"/><origin xyz="0 0 0.08"/></joint></robot>'
    )
    return "".join(text)


def _six(rng: np.random.Generator, a: tuple[float, ...], d: tuple[float, ...], alpha: tuple[float, ...]) -> Arm:
    """Six joints from a Denavit-Hartenberg table, alpha in quarter turns."""
    xyz, rpy = (0.0, 0.0, d[0]), (0.0, 0.0, 0.0)
    rows = []
    for k in range(6):
        most = float(rng.uniform(1.6, MOST))
        rows.append(("revolute", xyz, rpy, "0 0 1", -most, most))
        xyz, rpy = (a[k], 0.0, 0.0), (alpha[k] * np.pi / 2, 0.0, 0.0)
        if k < 5:  # d of the next link lies along its own axis
            turn = Rotation.from_euler("x", rpy[0]).apply([0.0, 0.0, d[k + 1]])
            xyz = (float(xyz[0] + turn[0]), float(turn[1]), float(turn[2]))
    return read_arm(_links(rows, float(rng.uniform(5.0, 30.0))), "tip", DOWN)


def _random_six(rng: np.random.Generator) -> Arm:
    a = (rng.uniform(0, 0.3), rng.uniform(0.4, 0.9), rng.uniform(0.02, 0.15), 0.0, 0.0, 0.0)
    d = (rng.uniform(0.2, 0.5), rng.uniform(-0.1, 0.1), 0.0, rng.uniform(0.4, 0.9), 0.0, rng.uniform(0.05, 0.15))
    return _six(rng, a, d, (-1, 0, -1, 1, -1, 0))


def _like_ur(rng: np.random.Generator) -> Arm:
    a = (0.0, rng.uniform(0.3, 0.7), rng.uniform(0.3, 0.6), 0.0, 0.0, 0.0)
    d = (rng.uniform(0.1, 0.2), 0.0, 0.0, *rng.uniform(0.08, 0.16, 3))
    return _six(rng, a, d, (1, 0, 0, 1, -1, 0))


def _metre(rng: np.random.Generator) -> Arm:
    """An arm with a reach of one metre."""
    return _six(rng, (0.0, 0.42, 0.05, 0.0, 0.0, 0.0), (0.3, 0.05, 0.0, 0.42, 0.0, 0.08), (-1, 0, -1, 1, -1, 0))


def _scara(rng: np.random.Generator) -> Arm:
    a, b = rng.uniform(0.2, 0.6, 2)
    return read_arm(_links([
        ("revolute", (0, 0, 0.3), (0, 0, 0), "0 0 1", -2.3, 2.3),
        ("revolute", (a, 0, 0), (0, 0, 0), "0 0 1", -2.5, 2.5),
        ("prismatic", (b, 0, 0), (np.pi, 0, 0), "0 0 1", 0.0, float(rng.uniform(0.15, 0.5))),
        ("revolute", (0, 0, 0.1), (0, 0, 0), "0 0 1", -2.6, 2.6),
    ], 12.0), "tip", DOWN)  # fmt: skip


def _ur10(_: np.random.Generator) -> Arm:
    return read_arm((TOP / "urdf" / "ur10.urdf").read_text("utf-8"), "tool0", DOWN, 2.4)


def _arid(_: np.random.Generator) -> Arm:
    return read_arm((TOP / "urdf" / "arid.urdf").read_text("utf-8"), "flange", (0.0, 9.81, 0.0))


ARMS: dict[str, Callable[[np.random.Generator], Arm]] = {
    "six": _random_six, "ur10": _ur10, "scara": _scara, "arid": _arid, "metre": _metre, "ur-like": _like_ur,
}  # fmt: skip
HEAVY = ("six", "ur10", "metre", "ur-like")
"""Arms that gravity loads and that a payload of ten kilograms bends."""
