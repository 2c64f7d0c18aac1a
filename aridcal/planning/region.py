"""The region in which the target is to be known: readings at places of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from aridcal.model.reaching import draw_readings
from aridcal.planning.beforehand import Beforehand
from aridcal.planning.candidates import allowed, reaching
from aridcal.trust.region import region_of_table

PLACES = 300
"""Of the region: their mean is then known to a few per cent, and every choice is compared on the same ones."""


def region_readings(known: Beforehand, path: Path | None, rng: np.random.Generator) -> np.ndarray:
    """Readings of the region of a table, or of the joints' whole ranges, shape (R, columns)."""
    if path is not None:
        return region(known, path, rng)
    readings = draw_readings(known.robot, PLACES, rng)
    inside = readings[allowed(known, readings, np.zeros(len(readings), dtype=int))]
    return inside if len(inside) else readings


def region(known: Beforehand, path: Path, rng: np.random.Generator) -> np.ndarray:
    """Readings of a table of joints, or of readings that bring the target to a table's places, shape (R, columns).

    Raises:
        MeasurementError: the table has neither, or a row of it cannot be used.
    """

    def reach(places: np.ndarray) -> np.ndarray:
        def miss(R: np.ndarray, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return p - places[rows]

        return reaching(known, 0, miss, len(places), rng, f"take places out of {path} that it cannot reach")

    return region_of_table(known.campaign, known.robot, path, reach)
