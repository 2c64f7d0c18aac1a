"""An arm of six axes whose foot can be given."""

from __future__ import annotations

from pathlib import Path

from aridcal.engine.robot.chain import Robot, parse_robot

JOINTS = [
    ((0, 0, 0.67), "0 0 1"), ((0.312, 0, 0), "0 1 0"), ((0, 0, 1.075), "0 -1 0"),
    ((0, 0, 0.225), "-1 0 0"), ((1.28, 0, 0), "0 -1 0"), ((0.27, 0, 0), "-1 0 0"),
]  # fmt: skip
"""An arm with the lengths of an R-2000iB/165F."""


def robot(below: str = "") -> Robot:
    """An arm of six axes; ``below``: joints and links of its foot, from ``base_link``."""
    parts = [f'<robot name="f"><link name="l0"/>{below}']
    for k, (xyz, axis) in enumerate(JOINTS):
        place = " ".join(f"{v:g}" for v in xyz)
        parts.append(
            f'<joint name="j{k + 1}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="{place}"/>'
            f'<axis xyz="{axis}"/><limit lower="-6.2" upper="6.2" effort="1" velocity="1"/></joint><link name="l{k + 1}"/>'
        )
    return parse_robot("".join([*parts, "</robot>"]).encode(), "l6", "l0", Path("f.urdf"))
