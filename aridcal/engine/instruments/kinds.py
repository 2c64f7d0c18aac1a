"""The table of kinds of measurements, one row each: the only list of them."""

from __future__ import annotations

from collections.abc import Mapping

from aridcal.engine.instruments.camera_sonar import CAMERA_SONAR, HEAD
from aridcal.engine.instruments.distance import DISTANCE
from aridcal.engine.instruments.inclination import INCLINED
from aridcal.engine.instruments.joined import JOINED
from aridcal.engine.instruments.kind import MeasurementKind, Role
from aridcal.engine.instruments.pixels import PIXELS
from aridcal.engine.instruments.plane import PLANAR
from aridcal.engine.instruments.point import TOUCHED
from aridcal.engine.instruments.pose import POSE, POSITION, TRACKER

MEASUREMENT_KINDS: Mapping[str, MeasurementKind] = {
    kind.name: kind for kind in (POSE, POSITION, TOUCHED, DISTANCE, PLANAR, PIXELS, INCLINED, JOINED, CAMERA_SONAR)
}


def labelled(kind: str) -> tuple[Role, ...]:
    """Roles of what the rows of a kind tell apart: none for poses and positions, whose tracker is their block, nor for heads."""
    return tuple(role for role in MEASUREMENT_KINDS[kind].roles if role.name not in (TRACKER.name, HEAD))
