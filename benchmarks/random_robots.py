"""Random robots of six builds, as URDFs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from aridcal.engine.robot.chain import Robot, parse_robot

FAMILIES = ("rail", "six", "seven", "scara", "gantry")
"""Those that `blind.py` draws from; its cases stay what they were while no other is added. There is "column" besides."""

Draw = tuple[float, ...]


def draw_robot(family: str, rng: np.random.Generator) -> tuple[Robot, np.ndarray]:
    """A robot of a family with random lengths and masses, and gravity in its base's frame."""
    joints, gravity = _BUILD[family](rng)
    return parse_robot(_urdf(joints, rng), "tip"), np.array(gravity)


# (kind, origin xyz, axis, lower, upper) of each joint.
Link = tuple[str, tuple[float, float, float], str, float, float]
DOWN = (0.0, 0.0, -9.81)


def _rail(rng: np.random.Generator) -> tuple[list[Link], Draw]:
    """The ARID's build: a horizontal rail and three parallel joints that lift against gravity."""
    a, b = rng.uniform(0.4, 2.0, 2)
    reach = rng.uniform(2.0, 18.0)
    side = float(rng.uniform(0.1, 0.4))
    return [
        ("prismatic", (0, 0, 0), "0 0 1", 0.0, reach),
        ("revolute", (side, 0, 0), "0 0 1", -0.3, rng.uniform(1.5, 2.2)),
        ("revolute", (a, 0, 0), "0 0 1", rng.uniform(0.2, 1.2), 2.6),
        ("revolute", (b, 0, 0), "0 0 1", -2.2, rng.uniform(-0.5, 1.5)),
    ], (0.0, 9.81, 0.0)


def _six(rng: np.random.Generator) -> tuple[list[Link], Draw]:
    """An anthropomorphic arm."""
    a, b = rng.uniform(0.3, 0.9, 2)
    w = rng.uniform(0.08, 0.15, 3)
    most = float(rng.uniform(1.6, 2.8))
    return [
        ("revolute", (0, 0, rng.uniform(0.1, 0.5)), "0 0 1", -most, most),
        ("revolute", (rng.uniform(0, 0.3), w[0], 0), "0 1 0", -1.9, 0.6),
        ("revolute", (0, -w[0], a), "0 1 0", -2.0, 2.0),
        ("revolute", (0, w[1], b), "0 1 0" if rng.random() < 0.5 else "0 0 1", -most, most),
        ("revolute", (0, 0, w[1]), "0 0 1" if rng.random() < 0.5 else "1 0 0", -2.0, 2.0),
        ("revolute", (0, w[2], 0), "0 1 0", -most, most),
    ], DOWN


def _column(rng: np.random.Generator) -> tuple[list[Link], Draw]:
    """An anthropomorphic arm on a vertical column, as on service robots."""
    arm, gravity = _six(rng)
    height, side = rng.uniform(0.35, 0.8), rng.uniform(0.1, 0.25)
    kind, (x, y, z), axis, lower, upper = arm[0]
    return [
        ("prismatic", (0, 0, 0.3), "0 0 1", 0.0, height),
        (kind, (x + side, y, z), axis, lower, upper),
        *arm[1:],
    ], gravity


def _seven(rng: np.random.Generator) -> tuple[list[Link], Draw]:
    """A redundant arm."""
    up = rng.uniform(0.15, 0.4, 7)
    out = rng.uniform(-0.05, 0.05, 7)
    axes = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
    most = rng.uniform(1.5, 2.5, 7)
    return [("revolute", (o, 0, u), x, -m, m) for o, u, x, m in zip(out, up, axes, most, strict=True)], DOWN


def _scara(rng: np.random.Generator) -> tuple[list[Link], Draw]:
    a, b = rng.uniform(0.2, 0.6, 2)
    return [
        ("revolute", (0, 0, rng.uniform(0.2, 0.5)), "0 0 1", -2.3, 2.3),
        ("revolute", (a, 0, 0), "0 0 1", -2.5, 2.5),
        ("prismatic", (b, 0, 0), "0 0 -1", 0.0, rng.uniform(0.15, 0.5)),
        ("revolute", (0, 0, -0.1), "0 0 1", -3.1, 3.1),
    ], DOWN


def _gantry(rng: np.random.Generator) -> tuple[list[Link], Draw]:
    """Three slides and a wrist."""
    x, y, z = rng.uniform(0.8, 3.0), rng.uniform(0.6, 2.0), rng.uniform(0.3, 1.2)
    return [
        ("prismatic", (0, 0, 1.5), "1 0 0", 0.0, x),
        ("prismatic", (0, 0, 0.2), "0 1 0", 0.0, y),
        ("prismatic", (0.15, 0, 0), "0 0 -1", 0.0, z),
        ("revolute", (0, 0, -0.3), "0 0 1", -2.8, 2.8),
        ("revolute", (0, 0.05, -0.12), "0 1 0", -1.8, 1.8),
        ("revolute", (0, 0, -0.1), "1 0 0", -2.8, 2.8),
    ], DOWN


_BUILD: dict[str, Callable[[np.random.Generator], tuple[list[Link], Draw]]] = {
    "rail": _rail, "six": _six, "seven": _seven, "scara": _scara, "gantry": _gantry, "column": _column,
}  # fmt: skip


def _urdf(joints: Sequence[Link], rng: np.random.Generator) -> bytes:
    parts = ['<robot name="random"><link name="base"/>']
    mass = float(np.exp(rng.uniform(np.log(5.0), np.log(60.0))))
    ends = [xyz for _, xyz, *_ in joints[1:]] + [(0.1, 0.0, 0.05)]
    for k, ((kind, xyz, axis, lower, upper), end) in enumerate(zip(joints, ends, strict=True), start=1):
        com = np.array(end) / 2 + rng.normal(0.0, 0.03, 3)
        parts.append(
            f'<link name="link_{k}"><inertial><origin xyz="{com[0]:.4f} {com[1]:.4f} {com[2]:.4f}"/>'
            f'<mass value="{mass:.3f}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint_{k}" type="{kind}"><parent link="{f"link_{k - 1}" if k > 1 else "base"}"/>'
            f'<child link="link_{k}"/><origin xyz="{xyz[0]:.6f} {xyz[1]:.6f} {xyz[2]:.6f}"/><axis xyz="{axis}"/>'
            f'<limit lower="{lower:.6f}" upper="{upper:.6f}" effort="1" velocity="1"/></joint>'
        )
        mass *= float(rng.uniform(0.4, 0.8))
    end = ends[-1]
    parts.append(
        f'<link name="tip"/><joint name="tip_fixed" type="fixed"><parent link="link_{len(joints)}"/><child link="tip"/>'
        f'<origin xyz="{end[0]} {end[1]} {end[2]}"/></joint></robot>'
    )
    return "".join(parts).encode()
