"""The table of kinds of measurements, one row each: the only list of them."""

from __future__ import annotations

from collections.abc import Mapping

from aridcal.instruments.camera_sonar import CAMERA_SONAR, HEAD
from aridcal.instruments.distance import DISTANCE
from aridcal.instruments.inclination import INCLINED
from aridcal.instruments.joined import JOINED
from aridcal.instruments.kind import Kind, Role
from aridcal.instruments.pixels import PIXELS
from aridcal.instruments.plane import PLANAR
from aridcal.instruments.point import TOUCHED
from aridcal.instruments.pose import POSE, POSITION, TRACKER

KINDS: Mapping[str, Kind] = {
    kind.name: kind for kind in (POSE, POSITION, TOUCHED, DISTANCE, PLANAR, PIXELS, INCLINED, JOINED, CAMERA_SONAR)
}


def labelled(kind: str) -> tuple[Role, ...]:
    """Roles of what the rows of a kind tell apart: none for poses and positions, whose tracker is their block, nor for heads."""
    return tuple(role for role in KINDS[kind].roles if role.name not in (TRACKER.name, HEAD))
