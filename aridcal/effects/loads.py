"""Covariates computed once from the nominal model: gravity's and the payload's pull on the joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from aridcal.effects.effect import direction
from aridcal.robot.chain import Robot
from aridcal.robot.kinematics import gravity_loads, joint_frames, tip_frames

LOADS = (".gravity_", ".payload_")
"""What the names of loads hold, and no other covariate's."""


def is_load(name: str) -> bool:
    """True for a covariate that is computed from masses, ``joint_2.gravity_torque`` for instance."""
    return any(part in name for part in LOADS)


@dataclass(frozen=True)
class Surroundings:
    """What the loads on the joints need beside the readings.

    Attributes:
        gravity: In the base frame, [m/s^2], shape (3,), or (worlds, 3) where each station has its own base.
        lever: The payload's place, T_tip_target of the geometric stage, shape (3,), [m].
    """

    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    lever: np.ndarray = field(default_factory=lambda: np.zeros(3))


def covariate_table(
    robot: Robot,
    readings: np.ndarray,
    measured: Mapping[str, np.ndarray],
    around: Surroundings,
    world: np.ndarray,
    wanted: set[str],
) -> dict[str, np.ndarray]:
    """Everything that a basis may depend on, computed once from the nominal model.

    Args:
        robot: The nominal chain.
        readings: Shape (N, columns), [rad] or [m].
        measured: Columns of the table, shape (N,) each.
        around: Gravity and the payload's place.
        world: Index of each row's world_base frame, shape (N,).
        wanted: Names that are needed; loads are computed only if one of them is.

    Returns:
        The joints' positions by name; the measured columns; ``JOINT.gravity_torque`` (force, if prismatic) and
        ``JOINT.gravity_moment_C`` for the components C in which a joint does not move; ``JOINT.payload_torque``.
    """
    positions = dict(zip(robot.names, robot.positions(readings).T, strict=True))
    table = dict(measured) | positions
    if not any(is_load(name) for name in wanted):
        return table
    per_row = np.atleast_2d(around.gravity)[world if np.ndim(around.gravity) == 2 else 0]
    gravity = np.broadcast_to(per_row, (len(readings), 3))
    table |= _gravity_columns(robot, readings, gravity)
    if "payload" in measured:
        weight = measured["payload"][:, None] * gravity
        table |= _payload_columns(robot, readings, weight, around.lever)
    return table


def _gravity_columns(robot: Robot, readings: np.ndarray, gravity: np.ndarray) -> dict[str, np.ndarray]:
    """What gravity does to each joint: along or about its axis, and about the directions across it."""
    loads = gravity_loads(robot, readings, gravity)
    columns = {}
    for j, joint in enumerate(robot.joints):
        force, moment = loads[:, j, :3], loads[:, j, 3:]
        columns[f"{joint.name}.gravity_torque"] = (moment if joint.kind == "revolute" else force) @ joint.axis
        for component in bearing_components(joint.kind):
            columns[f"{joint.name}.gravity_moment_{component}"] = moment @ direction(component, joint.axis)
    return columns


def _payload_columns(
    robot: Robot, readings: np.ndarray, weight: np.ndarray, lever: np.ndarray
) -> dict[str, np.ndarray]:
    """What a payload of some weight, shape (N, 3) [N], does to each joint along or about its axis."""
    axes, origins = joint_frames(robot, readings)
    R, tip = tip_frames(robot, readings)
    target = tip + R @ lever
    columns = {}
    for j, joint in enumerate(robot.joints):
        moment = np.cross(target - origins[:, j], weight)
        push = moment if joint.kind == "revolute" else weight
        columns[f"{joint.name}.payload_torque"] = np.einsum("nji,nj,i->n", axes[:, j], push, joint.axis)
    return columns


def bearing_components(kind: str) -> tuple[str, ...]:
    """The rotations that a joint does not drive."""
    return ("r1", "r2") if kind == "revolute" else ("roll", "pitch", "yaw")
