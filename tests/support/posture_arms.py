"""Arms of three makers by their published lengths, and all their positions at a pose in closed form.

The closed form is that of Brandstötter, Angerer and Hofbaur (Proceedings of the Austrian Robotics Workshop 2014), of which the
code under test has nothing: its angles are zero where the arm is upright and straight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aridcal.engine.robot.chain import Robot, parse_robot


@dataclass(frozen=True)
class Arm:
    """An arm.

    Attributes:
        lengths: a1, a2, c1, c2, c3, c4 of the closed form, [m].
        signs: Of its controller's axes against those of the closed form.
        level: The upper arm is level where the controller shows zero; else it is upright. The forearm is level either way.
    """

    lengths: tuple[float, float, float, float, float, float]
    signs: tuple[int, ...]
    level: bool

    @property
    def offsets(self) -> np.ndarray:
        """What the controller shows where the closed form has zero, [rad]."""
        at = [0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0] if self.level else [0.0, 0.0, -np.pi / 2, 0.0, 0.0, 0.0]
        return np.array(self.signs) * at

    def robot(
        self, limits: Sequence[tuple[float, float]] | None = None, mount: str = "", upright: bool | None = None
    ) -> Robot:
        """Its URDF, frames along those of the base where its readings are zero.

        Args:
            limits: Of the readings, degrees.
            mount: Attributes of a fixed joint below, as ``rpy="3.14159 0 0"``.
            upright: Whether the URDF's upper arm is upright at its zero; default: as the controller's.
        """
        a1, a2, c1, c2, c3, c4 = self.lengths
        upright = not self.level if upright is None else upright
        elbow = (0.0, 0.0, c2) if upright else (c2, 0.0, 0.0)
        places = [(0.0, 0.0, c1), (a1, 0.0, 0.0), elbow, (0.0, 0.0, -a2), (c3, 0.0, 0.0), (c4, 0.0, 0.0)]
        axes = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
        parts = ['<robot name="arm"><link name="world"/><joint name="mount" type="fixed"><parent link="world"/>']
        parts.append(f'<child link="l0"/><origin {mount}/></joint><link name="l0"/>')
        for k, (place, axis, sign) in enumerate(zip(places, axes, self.signs, strict=True)):
            low, high = np.radians((limits or [(-350.0, 350.0)] * 6)[k])
            parts.append(
                f'<joint name="j{k + 1}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
                f'<origin xyz="{place[0]} {place[1]} {place[2]}"/><axis xyz="{" ".join(str(sign * v) for v in axis)}"/>'
                f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint><link name="l{k + 1}"/>'
            )
        return parse_robot("".join([*parts, "</robot>"]).encode(), "l6", "world", Path("arm.urdf"))

    def positions(self, T: np.ndarray) -> dict[tuple[bool, bool, bool], np.ndarray]:
        """What the controller shows in all positions at a pose of the flange, [rad], by the sides that they are on.

        A key says: behind axis 1, behind the lower arm, axis 5 of the closed form negative.
        """
        a1, a2, c1, c2, c3, c4 = self.lengths
        R = np.column_stack([-T[:3, 2], T[:3, 1], T[:3, 0]])  # its flange looks along z
        c = T[:3, 3] - c4 * R[:, 2]
        n, h = np.hypot(c[0], c[1]) - a1, c[2] - c1
        k, bend = np.hypot(a2, c3), np.arctan2(a2, c3)
        every = {}
        for behind in (False, True):
            s = np.hypot(n + 2 * a1 * behind, h)
            shoulder = (s * s + c2 * c2 - k * k) / (2 * s * c2)
            elbow = (s * s - c2 * c2 - k * k) / (2 * c2 * k)
            if abs(shoulder) > 1 or abs(elbow) > 1:
                continue
            t1 = np.arctan2(c[1], c[0]) - np.pi * behind
            for below in (False, True):
                sign = -1 if below else 1
                to_wrist = -np.arctan2(n + 2 * a1, h) if behind else np.arctan2(n, h)
                t2, t3 = -sign * np.arccos(shoulder) + to_wrist, sign * np.arccos(elbow) - bend
                s1, q1, s23, q23 = np.sin(t1), np.cos(t1), np.sin(t2 + t3), np.cos(t2 + t3)
                across, along = np.array([-s1, q1, 0.0]), np.array([q23 * q1, q23 * s1, -s23])
                out = np.array([s23 * q1, s23 * s1, q23])
                m = out @ R[:, 2]
                t4, t5 = np.arctan2(across @ R[:, 2], along @ R[:, 2]), np.arctan2(np.sqrt(1 - m * m), m)
                t6 = np.arctan2(out @ R[:, 1], -out @ R[:, 0])
                for flipped in (False, True):
                    wrist = (t4 + np.pi, -t5, t6 - np.pi) if flipped else (t4, t5, t6)
                    q = np.array(self.signs) * [t1, t2, t3, *wrist] + self.offsets
                    every[behind, below, flipped] = np.angle(np.exp(1j * q))
        return every


KUKA = Arm((0.025, -0.035, 0.4, 0.455, 0.42, 0.08), (-1, 1, 1, -1, 1, -1), level=True)
"""KR 6 R900: lengths of its data sheet; axes 1, 4 and 6 turn clockwise."""

ABB = Arm((0.175, -0.175, 0.495, 1.095, 1.2305, 0.085), (1, 1, 1, 1, 1, 1), level=False)
"""IRB 4600-20/2.50."""

FANUC = Arm((0.312, -0.225, 0.67, 1.075, 1.28, 0.27), (1, 1, -1, -1, -1, -1), level=False)
"""R-2000iB/165F with its flange 270 mm before the wrist."""
