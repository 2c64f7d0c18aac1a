"""A solved model's constants as a URDF."""

from __future__ import annotations

from aridcal.fit.least_squares import Fit
from aridcal.robot.splice import splice_origins, written_origins


def stage_urdf(fit: Fit) -> bytes:
    """The user's URDF with a fit's constants folded into the joints' own origins."""
    urdf = fit.model.robot.urdf
    return splice_origins(urdf, written_origins(urdf, fit.model.origins(fit.theta)))
