"""From which side joints came to their readings, by the order of the rows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.repeats import tolerances


def approach(reading: np.ndarray, still: float, side: float = 0.0, last: float = math.nan) -> np.ndarray:
    """The side from which a joint comes to each reading of a trajectory: -1 or 1; 0 until it first moves.

    Args:
        reading: Shape (N,), [rad] or [m]; rows of NaN are passed over.
        still: A joint that moves by less keeps its side, [rad] or [m].
        side: From which it came to the row before the first; 0 where nobody knows.
        last: Its reading in the row before the first; NaN where there is none.
    """
    rows = np.flatnonzero(~np.isnan(reading))
    step = np.diff(reading[rows], prepend=last)
    moves = np.abs(step) > still
    sides, latest = np.zeros(len(reading)), np.full(len(reading), -1)
    sides[rows[moves]] = np.sign(step[moves])
    latest[rows[moves]] = rows[moves]
    latest = np.maximum.accumulate(latest)
    return np.where(latest < 0, side, sides[latest])


def with_directions(rows: Dataset) -> Dataset:
    """The rows with a column ``JOINT_direction`` derived for every joint that has none.

    The rows of each file are taken in the order of ``time``, or as they stand where that is missing. A joint that comes
    back within what counts as the same configuration keeps its side. Where rows are in no order, or others were measured
    in between, the column is chance, and no effect will depend on it.
    """
    directions: dict[str, np.ndarray] = {}
    time = rows.covariates.get("time")
    for name, still, reading in zip(rows.names, tolerances(rows.kinds).tolist(), rows.readings.T, strict=True):
        column = f"{name}_direction"
        if column in rows.covariates:
            continue
        directions[column] = np.zeros(len(rows), dtype=np.int8)  # a million rows of six joints: 6 MB instead of 48
        for file in np.unique(rows.origin.file):
            of_file = np.flatnonzero(rows.origin.file == file)
            timed = time is not None and np.isfinite(time[of_file]).all()
            of_file = of_file[
                np.argsort(time[of_file] if time is not None and timed else rows.origin.line[of_file], kind="stable")
            ]
            directions[column][of_file] = approach(reading[of_file], still)
    return replace(rows, covariates=rows.covariates | directions).with_origin(derived=tuple(directions))
