"""Covariates computed once from the nominal model: gravity's and payloads' pull on the joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from aridcal.engine.corrections.basis import FORMS, Basis
from aridcal.engine.corrections.effect import direction
from aridcal.engine.corrections.sights import Sights, is_sight
from aridcal.engine.robot.chain import Joint, Robot
from aridcal.engine.robot.kinematics import (
    LEVEL_GRAVITY,
    JointFrames,
    bears,
    borne_by,
    chain_part,
    gravity_loads,
    link_axes,
    tree_frames,
)

LOAD_MARKS = (".gravity_", ".payload_")
"""What the names of loads hold, and no other covariate's."""


def is_load(name: str) -> bool:
    """True for a covariate that is computed from masses, ``joint_2.gravity_torque`` for instance."""
    return any(part in name for part in LOAD_MARKS)


PAYLOAD = "payload"
"""Covariate of the only payload; each of several is called after its link, ``payload_left_hand``."""


@dataclass(frozen=True)
class Payload:
    """A mass that hangs at a link, otherwise in each row.

    Attributes:
        lever: Its place on the link: on the tip that of T_tip_target as the calibration has it, shape (3,), [m].
        on: The link; empty for the tip.
        name: Of the covariate, in kg.
    """

    lever: np.ndarray = field(default_factory=lambda: np.zeros(3))
    on: str = ""
    name: str = PAYLOAD


@dataclass(frozen=True)
class Surroundings:
    """What the loads on the joints need beside the readings.

    Attributes:
        gravity: In the base frame, [m/s^2], shape (3,), or (worlds, 3) where each station has its own base.
        payloads: What hangs at links.
        loaded: True where the rows have all payloads: they hang there and count in every gravity load. False of rows
            without, whose loads are those of the links alone.
        sights: Where the instruments' things and the targets are.
    """

    gravity: np.ndarray = field(default_factory=lambda: np.array(LEVEL_GRAVITY))
    payloads: tuple[Payload, ...] = (Payload(),)
    loaded: bool = False
    sights: Sights = field(default_factory=Sights)

    @property
    def masses(self) -> tuple[str, ...]:
        """Covariates of the payloads."""
        return tuple(payload.name for payload in self.payloads)


def needs(robot: Robot, bases: Iterable[Basis], around: Surroundings) -> tuple[str, ...]:
    """Columns beside the joints that some bases cannot do without, sorted; payloads' where one of their loads holds them."""
    names = {name for basis in bases for name in basis.of if FORMS[basis.form].absent is None} - set(robot.names)
    names = {name for name in names if not is_sight(name)}
    loads = {name for name in names if is_load(name)}
    with_masses = any(around.loaded or ".payload_" in name for name in loads)
    return tuple(sorted((names - loads) | (set(around.masses) if with_masses else set())))


def covariate_table(
    robot: Robot,
    readings: np.ndarray,
    columns: Mapping[str, np.ndarray],
    around: Surroundings,
    world: np.ndarray,
    names: set[str],
) -> dict[str, np.ndarray]:
    """Everything that a basis may depend on, computed once from the nominal model.

    Args:
        robot: The nominal chain.
        readings: Shape (N, columns), [rad] or [m].
        columns: Columns of the table, shape (N,) each.
        around: Gravity and the payloads' places.
        world: Index of each row's world_base frame, shape (N,).
        names: Names that are needed; loads are computed only if one of them is.

    Returns:
        The joints' positions by name; the measured columns; ``JOINT.gravity_torque`` (force, if prismatic) and
        ``JOINT.gravity_moment_C`` for the components C in which a joint does not move, both with the payloads where they
        count; ``JOINT.payload_torque`` of all together. What would need a payload that is not among the columns is left out.
    """
    positions = dict(zip(robot.names, robot.positions(readings).T, strict=True))
    table = dict(columns) | positions
    if not any(is_load(name) for name in names):
        return table
    per_row = np.atleast_2d(around.gravity)[world if np.ndim(around.gravity) == 2 else 0]
    gravity = np.broadcast_to(per_row, (len(readings), 3))
    walked = tuple(tree_frames(robot, readings))
    pull: np.ndarray | float = 0.0
    if all(name in columns for name in around.masses):
        pulls = [_pull(robot, walked, each, columns[each.name][:, None] * gravity) for each in around.payloads]
        hung = sum(pulls[1:], start=pulls[0])
        table |= {f"{joint.name}.payload_torque": _driving(joint, hung[:, j]) for j, joint in enumerate(robot.joints)}
        pull = hung
    elif around.loaded:
        return table
    loads = gravity_loads(robot, walked, gravity) + (pull if around.loaded else 0.0)
    for j, joint in enumerate(robot.joints):
        table[f"{joint.name}.gravity_torque"] = _driving(joint, loads[:, j])
        for component in bearing_components(joint.kind):
            about = direction(component, joint.axis)
            table[f"{joint.name}.gravity_moment_{component}"] = loads[:, j, 3:] @ about
    return table


def _driving(joint: Joint, load: np.ndarray) -> np.ndarray:
    """Force along a prismatic joint's axis, or moment about a revolute one's, of loads of shape (N, 6)."""
    part = load[:, 3:] if joint.kind == "revolute" else load[:, :3]
    return np.asarray(part @ joint.axis)


def _pull(robot: Robot, walked: Sequence[JointFrames], payload: Payload, weight: np.ndarray) -> np.ndarray:
    """Force and moment of a payload of some weight, shape (N, 3) [N], on each joint, as :func:`gravity_loads` has it.

    On the way up it pushes the joint's parent link, so its child link the other way. Joints of other limbs do not bear it.
    """
    link = payload.on or robot.tip
    R, origin = link_axes(robot, walked, link)
    place, bearing = origin + R @ payload.lever, bears(robot, link)
    chain = chain_part(robot, walked)
    senses = [
        float(on_path) * (-1.0 if joint.climbs else 1.0) for on_path, joint in zip(bearing, robot.joints, strict=True)
    ]
    pulls = [np.cross(place - step.origin, weight) for step in chain]
    return borne_by(chain, [(sense * weight, sense * pull) for sense, pull in zip(senses, pulls, strict=True)])


def bearing_components(kind: str) -> tuple[str, ...]:
    """The rotations that a joint does not drive."""
    return ("r1", "r2") if kind == "revolute" else ("roll", "pitch", "yaw")
