"""A solved model's constants as a URDF."""

from __future__ import annotations

import pinocchio as pin

from aridcal.fit.least_squares import Fit
from aridcal.robot.splice import splice_origins


def stage_urdf(fit: Fit) -> bytes:
    """The user's URDF with a fit's constants folded into the joints' own origins."""
    robot = fit.model.robot
    origins = {
        name: (placement.translation, pin.rpy.matrixToRpy(placement.rotation))
        for name, placement in fit.model.origins(fit.theta).items()
    }
    return splice_origins(robot.urdf, origins)
