r"""Covariates of places: where the target is, how long a wire is and how it hangs, where on a plate the target touches.

As loads are (:mod:`aridcal.engine.corrections.loads`), they are computed once, from the nominal arm and from where targets
and things are at the geometric stage, never from the coefficients: a millimetre in a metre changes an error of a millimetre
by a micrometre.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import along_plane, tip_frames

LENGTH, SAG = ".wire_length", ".wire_sag"
PLATE_COORDINATES = (".plate_1", ".plate_2")
TARGET = ("target.place_x", "target.place_y", "target.place_z")
"""The target's own place in the base frame, the arm nominal, [m]."""


@dataclass(frozen=True)
class Sights:
    """Where things are that instruments' own faults depend on, in the base frame.

    Attributes:
        targets: Of each frame on the tip, its place in the tip's, shape (frames, 3), [m].
        anchors: Place of each anchor, shape (3,), [m].
        plates: Of each plane the middle of the places that touched it, and two directions along it, shape (3, 3).
    """

    targets: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))
    anchors: Mapping[str, np.ndarray] = field(default_factory=dict)
    plates: Mapping[str, np.ndarray] = field(default_factory=dict)


def is_sight(name: str) -> bool:
    """True for a covariate that is computed from where something is, ``rail.wire_length`` for instance."""
    return name in TARGET or name.endswith((LENGTH, SAG, *PLATE_COORDINATES))


def sights_from(
    base: pin.SE3,
    targets: np.ndarray,
    things: Mapping[str, Mapping[str, np.ndarray]],
    places: Callable[[], np.ndarray],
    plane: np.ndarray,
    linked: Collection[str] = (),
) -> Sights:
    """Where things are, from their places in the world frame, or on the links that carry them.

    Args:
        base: T_world_base.
        targets: Place of each frame on the tip, shape (frames, 3), [m].
        things: States of anchors and planes, by the name of their role and their own.
        places: Gives the rows' places of the target in the base frame, shape (N, 3), [m]; asked only where there are planes.
        plane: Name of the plane over which each row measures, empty for none, shape (N,).
        linked: Names of those that links carry.
    """

    def frame(name: str) -> pin.SE3:
        return pin.SE3.Identity() if name in linked else base

    anchors = {name: frame(name).actInv(state[:3]) for name, state in things.get("anchor", {}).items()}
    planes = things.get("plane", {})
    if not planes:
        return Sights(targets, anchors)
    place = places()
    plates = {
        name: np.vstack([place[plane == name].mean(axis=0), np.array(along_plane(state[:3])) @ frame(name).rotation])
        for name, state in planes.items()
        if np.any(plane == name)
    }
    return Sights(targets, anchors, plates)


def target_places(robot: Robot, readings: np.ndarray, on_tip: np.ndarray) -> np.ndarray:
    """Places in the base frame of targets that are at places on the tip, (N, 3) both, the arm nominal."""
    R, p = tip_frames(robot, readings)
    return np.asarray(p + np.einsum("nij,nj->ni", R, on_tip))


def sight_table(
    robot: Robot, readings: np.ndarray, sights: Sights, gravity: np.ndarray, tip: np.ndarray
) -> dict[str, np.ndarray]:
    r"""Covariates of the target's place, and of all wires and plates.

    A wire of weight w per length under the tension T is longer than the straight line of length L and elevation
    :math:`\epsilon` by

    .. math:: \frac{w^2}{24 T^2} L^3 \cos^2\epsilon

    (Irvine 1981, Cable Structures, 1.2: the parabola's length to second order, the load across the chord being
    :math:`w \cos\epsilon`).

    Args:
        robot: The nominal chain.
        readings: Shape (N, columns), [rad] or [m].
        sights: Where everything is.
        gravity: In the base frame, shape (3,), [m/s^2]; the zero vector where nothing hangs.
        tip: Number of each row's frame on the tip, shape (N,).

    Returns:
        ``target.place_x`` to ``_z`` [m], ``ANCHOR.wire_length`` L [m] and ``ANCHOR.wire_sag``, :math:`L^3 \cos^2\epsilon`
        [m^3]; ``PLANE.plate_1`` and ``_2``, the target's place along the plane from its middle [m]; shape (N,) each.
    """
    place = target_places(robot, readings, sights.targets[tip])
    table = dict(zip(TARGET, place.T, strict=True))
    for name, anchor in sights.anchors.items():
        wire = place - anchor
        square = np.sum(wire**2, axis=1)
        length = np.sqrt(square)
        size = float(np.linalg.norm(gravity))
        upright = (wire @ gravity / size) ** 2 if size else square
        table[name + LENGTH], table[name + SAG] = length, length * (square - upright)
    for name, (middle, *directions) in sights.plates.items():
        for ending, direction in zip(PLATE_COORDINATES, directions, strict=True):
            table[name + ending] = (place - middle) @ direction
    return table
