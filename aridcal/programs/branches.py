"""How the controller stands at a pose: its own inverse kinematics, with the nominal arm, and which of its answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from aridcal.model.inverse import InverseKinematics
from aridcal.model.model import Model
from aridcal.model.one_row import OneRowModel
from aridcal.programs.targets import Branch
from aridcal.robot.chain import Robot
from aridcal.robot.kinematics import tip_frames

EXACT = (1e-7, 1e-7)
"""What counts as reached of the nominal arm, [m] and [rad]: far below what any arm repeats."""

STARTS = 60
"""Drawn over the joints' ranges: of the eight positions of a six-axis arm each is missed by all with less than one in a thousand,
where each takes a twentieth of the starts."""

AROUND, KICK = 6, 0.3
"""Starts close by, and how far they are, [rad] or [m]: with an elbow nearly straight a search may end on its other side, which is
further away, and one from there on the nearer."""

SAME = 1e-4
"""Readings that differ by less are the same position of the arm, [rad] or [m]."""

WIDE = np.pi
"""Joints without limits are started within half a turn, [rad] or [m]."""


def controller(robot: Robot, held: np.ndarray | None = None) -> InverseKinematics:
    """Inverse kinematics of the nominal arm, from base to tip.

    Args:
        robot: The chain.
        held: Readings that stay, shape (columns,), NaN where they do not.
    """
    low, high = robot.limits.T
    turning = np.array([kind != "prismatic" for kind in robot.kinds])
    nominal = InverseKinematics(OneRowModel(Model(robot, ()), np.zeros(0)), low, high, turning, True, EXACT)
    return holding(nominal, held)


def holding(inverse: InverseKinematics, held: np.ndarray | None) -> InverseKinematics:
    """The same with readings that stay."""
    if held is None or not np.isfinite(held).any():
        return inverse
    stays = np.isfinite(held)
    return replace(inverse, low=np.where(stays, held, inverse.low), high=np.where(stays, held, inverse.high))


def flange(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """T_base_tip of the nominal arm, shape (4, 4)."""
    R, p = tip_frames(robot, readings[None])
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = R[0], p[0]
    return found


def positions_of_arm(
    nominal: InverseKinematics, wanted: np.ndarray, branch: Branch, before: np.ndarray
) -> list[np.ndarray]:
    """The arm's positions at a pose that agree with what the program says, the nearest to a start first.

    Args:
        nominal: The controller's inverse kinematics.
        wanted: T_base_tip, shape (4, 4).
        branch: What the program says of the arm's position.
        before: Readings of the target before, shape (columns,).
    """
    near = before if branch.near is None else np.where(np.isfinite(branch.near), branch.near, before)
    own = holding(nominal, branch.held)
    found: list[np.ndarray] = []
    for tried, start in enumerate(_starts(own, near)):
        command = own.command(wanted[:3, :3], wanted[:3, 3], start, {})
        if command.reached:
            for q in _turned(command.readings, own, near, branch.fits):
                if not any(np.abs(q - other).max() < SAME for other in found):
                    found.append(q)
        if found and branch.settled and tried >= AROUND:  # the nearest that fits is the one
            break
    return sorted(found, key=lambda q: float(np.sum((q - near) ** 2)))


def _starts(own: InverseKinematics, near: np.ndarray) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(0)
    low, high = np.maximum(own.low, near - WIDE), np.minimum(own.high, near + WIDE)
    yield near
    for kick in KICK * rng.standard_normal((AROUND, len(near))):
        yield near + kick
    for _ in range(STARTS):
        yield rng.uniform(low, np.maximum(low, high))


def _turned(
    q: np.ndarray, own: InverseKinematics, near: np.ndarray, fits: Callable[[np.ndarray], bool]
) -> Iterator[np.ndarray]:
    """The same position with joints turned by whole turns: each as near as may be, or the one way in which it fits."""
    turns = np.where(own.turning, np.round((near - q) / (2.0 * np.pi)), 0.0)
    nearest = q + 2.0 * np.pi * turns
    middle = q - np.where(own.turning, 2.0 * np.pi * np.round(q / (2.0 * np.pi)), 0.0)
    for trial in (nearest, middle, q):
        if (trial >= own.low - SAME).all() and (trial <= own.high + SAME).all() and fits(trial):
            yield trial
            return
