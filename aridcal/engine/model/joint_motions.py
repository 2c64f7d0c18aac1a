"""One component of a correction as a motion, and as the Pinocchio joint that carries it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import ANGULAR, direction
from aridcal.engine.robot.chain import Joint

# Joints that slide (False) or turn (True) along or about x, y, z: Pinocchio is twice as fast on these.
ALIGNED = {
    False: (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
    True: (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
}

# A direction whose other two components are smaller is one of its frame's own axes.
ON_AN_AXIS = 1e-9

# Unit vector in the frame; whether the motion turns about it or slides along it.
Motion = tuple[np.ndarray, bool]


def motion(component: str, joint: Joint | None = None) -> Motion:
    """The motion of a component: of a frame, or of a joint's own axis and across it."""
    if component == "axis":
        assert joint is not None
        return joint.axis, joint.kind == "revolute"
    return direction(component, None if joint is None else joint.axis), component in ANGULAR


def joint_model(motion: Motion) -> pin.JointModel:
    """The Pinocchio joint that moves so."""
    vector, turns = motion
    for k, aligned in enumerate(ALIGNED[turns]):
        if np.array_equal(vector, np.eye(3)[k]):
            return aligned()
    return pin.JointModelRevoluteUnaligned(vector) if turns else pin.JointModelPrismaticUnaligned(vector)


def rank(component: str, joint: Joint | None) -> tuple[bool, int]:
    """Place of a component inside C = Tx Ty Tz Rz Ry Rx, to sort by.

    e1, e2 and the axis of a joint count as x, y, z where none is an axis of its frame.
    """
    vector, turns = motion(component, joint)
    size = [abs(value) for value in vector.tolist()]
    place = size.index(max(size))
    if max(size[:place] + size[place + 1 :]) > ON_AN_AXIS:
        place = {"1": 0, "2": 1}.get(component[-1], 2)
    return turns, -place if turns else place


def transform(motion: Motion, value: float) -> pin.SE3:
    """A motion by a value, [m] or [rad]."""
    vector, turns = motion
    if turns:
        return pin.SE3(pin.exp3(vector * value), np.zeros(3))
    return pin.SE3(np.eye(3), vector * value)
