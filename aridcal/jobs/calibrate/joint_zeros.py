"""The zeros of joints among the constants: what those who adjust an arm know them as."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.corrections.effect import FRAME_COMPONENTS
from aridcal.engine.fit.constants import is_zero
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.robot.chain import Joint, Robot

ON_AXIS = 0.99
"""Component of a joint's unit axis along an axis of its frame from which the two are one."""


@dataclass(frozen=True)
class JointZero:
    """How far a joint stands beyond its reading, the same in all rows.

    Attributes:
        joint: Its name.
        names: Names of the constants that make it up: a repair adds one to the first.
        unit: ``rad`` or ``m``.
        value: Sum of these constants, each with the sign by which it moves the joint.
        std: 1-sigma of that sum.
    """

    joint: str
    names: tuple[str, ...]
    unit: str
    value: float
    std: float


def joint_zeros(fit: Fit, robot: Robot) -> list[JointZero]:
    """The joint zeros that a fit has identified, base first."""
    directions: dict[str, np.ndarray] = {}
    for k, c in enumerate(fit.model.coefficients):
        zero = zero_of(c.name, robot) if c.basis.constant or is_zero(c, robot) else None
        if zero is not None:
            directions.setdefault(zero[0], np.zeros(len(fit.theta)))[k] = zero[1]
    kinds = {joint.name: joint.kind for joint in robot.joints}
    return [
        JointZero(
            joint=joint,
            names=tuple(fit.model.names[k] for k in np.flatnonzero(directions[joint])),
            unit="m" if kinds[joint] == "prismatic" else "rad",
            value=float(directions[joint] @ fit.theta),
            std=float(np.sqrt(directions[joint] @ fit.covariance @ directions[joint])),
        )
        for joint in kinds
        if joint in directions
    ]


def zero_of(name: str, robot: Robot) -> tuple[str, int] | None:
    """The joint whose zero a constant is, and its sign: 1 if the joint stands beyond its reading by it, -1 if before it.

    Args:
        name: Of the constant: ``joint_2.yaw``.
        robot: The chain.

    Returns:
        None for a constant that is no joint's zero.
    """
    where, _, component = name.rpartition(".")
    joint = next((j for j in robot.joints if j.name == where), None)
    sign = _sign(joint, component) if joint is not None else 0
    return (where, sign) if sign else None


def _sign(joint: Joint, component: str) -> int:
    """1 or -1 if a component moves the joint as its own reading does, or against it; 0 if it does not."""
    if component not in FRAME_COMPONENTS:
        return int(component in ("axis", "d" if joint.kind == "prismatic" else "theta"))
    k = FRAME_COMPONENTS.index(component)
    along = float(joint.axis[k % 3])
    return int(np.sign(along)) if (k >= 3) != (joint.kind == "prismatic") and abs(along) > ON_AXIS else 0
