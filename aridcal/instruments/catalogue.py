"""The table of kinds of measurements, one row each: the only list of them."""

from __future__ import annotations

from collections.abc import Mapping

from aridcal.instruments.camera_sonar import CAMERA_SONAR
from aridcal.instruments.distance import DISTANCE
from aridcal.instruments.inclination import INCLINED
from aridcal.instruments.kind import Kind
from aridcal.instruments.pixels import PIXELS
from aridcal.instruments.plane import PLANAR
from aridcal.instruments.point import TOUCHED
from aridcal.instruments.pose import POSE, POSITION

KINDS: Mapping[str, Kind] = {
    kind.name: kind for kind in (POSE, POSITION, TOUCHED, DISTANCE, PLANAR, PIXELS, INCLINED, CAMERA_SONAR)
}
