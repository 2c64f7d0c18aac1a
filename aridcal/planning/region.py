"""The region in which the target is to be known: readings at places of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from aridcal.errors import MeasurementError
from aridcal.inputs.quantities import POSITION, column_of
from aridcal.inputs.query import load_query
from aridcal.inputs.tables import read_tables
from aridcal.model.reaching import draw_readings
from aridcal.planning.beforehand import Beforehand
from aridcal.planning.candidates import allowed, reaching

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
    robot, settings = known.robot, known.campaign.measurements
    limit = known.campaign.limits.table
    names = set(read_tables([path], limit=limit).names)
    joints = [settings.columns.get(name, name) for name in robot.readings]
    spots = [column_of(name, settings, robot.readings) for name in POSITION]
    if not (set(joints) <= names or set(spots) <= names):
        raise MeasurementError(
            f"{path}: should have the columns of all joints ({', '.join(joints)}) or of the target's places ({', '.join(spots)})"
        )
    by_joints = set(joints) <= names
    plain = settings.model_copy(update={"kind": "position"})
    query = load_query(path, robot.readings, robot.limits, robot.kinds, plain, poses=not by_joints, limit=limit)
    if query.refused:
        raise MeasurementError(f"{query.refused[0]}; mend the row, or delete it")
    if by_joints:
        return query.readings
    position = query.position
    assert position is not None

    def miss(R: np.ndarray, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return p - position[rows]

    return reaching(known, 0, miss, len(position), rng, f"take places out of {path} that it cannot reach")
