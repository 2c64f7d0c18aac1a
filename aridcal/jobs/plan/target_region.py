"""The region in which the target is to be known: readings at places of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from aridcal.engine.inverse.reachable import draw_readings, limits_of
from aridcal.jobs.calibrate.tolerance_region import corners, region_of_table
from aridcal.jobs.plan.configurations import allowed, reaching
from aridcal.jobs.plan.prior_knowledge import PlanSetup

REGION_PLACES = 300
"""Of the region: their mean is then known to a few per cent, and every choice is compared on the same ones."""


def region_readings(setup: PlanSetup, path: Path | None, rng: np.random.Generator) -> np.ndarray:
    """Readings of the region of a table, else of the campaign's own, else of the joints' whole ranges, shape (R, columns)."""
    settings = setup.campaign.region
    if path is not None:
        return region(setup, path, rng)
    if settings.file is not None:
        return region(setup, settings.file, rng, settings.tool)
    if settings.joints:
        readings_so_far = setup.rows.readings
        ends = (
            (np.nanmin(readings_so_far, axis=0), np.nanmax(readings_so_far, axis=0))
            if len(readings_so_far)
            else limits_of(setup.robot)
        )
        low, high = corners(setup.campaign, setup.robot, *ends)
        readings = rng.uniform(low, high, (REGION_PLACES, len(low)))
    else:
        readings = draw_readings(setup.robot, REGION_PLACES, rng)
    inside = readings[allowed(setup, readings, np.zeros(len(readings), dtype=int))]
    return inside if len(inside) else readings


def region(
    setup: PlanSetup, path: Path, rng: np.random.Generator, tool: Sequence[float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Readings of a table of joints, or of readings that bring the target to a table's places, shape (R, columns).

    Args:
        setup: What can be measured.
        path: The table.
        rng: Draws where to start from.
        tool: The point that is brought there, in the target's axes, [m].

    Raises:
        MeasurementError: the table has neither, or a row of it cannot be used.
    """

    def reach(places: np.ndarray) -> np.ndarray:
        def miss(R: np.ndarray, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return p + R @ np.asarray(tool) - places[rows]

        return reaching(setup, 0, miss, len(places), rng, f"take places out of {path} that it cannot reach")

    return region_of_table(setup.campaign, setup.robot, path, reach)
