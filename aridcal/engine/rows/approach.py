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
        side: From which it came to the row before the first; 0 where that is not known.
        last: Its reading there; NaN where there is none.
    """
    seen = np.flatnonzero(~np.isnan(reading))
    by = np.diff(reading[seen], prepend=last)
    moved = np.abs(by) > still
    sides, at = np.zeros(len(reading)), np.full(len(reading), -1)
    sides[seen[moved]] = np.sign(by[moved])
    at[seen[moved]] = seen[moved]
    at = np.maximum.accumulate(at)
    return np.where(at < 0, side, sides[at])


def with_directions(rows: Dataset) -> Dataset:
    """The rows with a column ``JOINT_direction`` derived for every joint that has none.

    The rows of each file are taken in the order of ``time``, or as they stand where that is missing. A joint that comes
    back within what counts as the same configuration keeps its side. Where rows are in no order, or others were measured
    in between, the column is chance, and no effect will depend on it.
    """
    found: dict[str, np.ndarray] = {}
    time = rows.covariates.get("time")
    for name, still, reading in zip(rows.names, tolerances(rows.kinds).tolist(), rows.readings.T, strict=True):
        column = f"{name}_direction"
        if column in rows.covariates:
            continue
        found[column] = np.zeros(len(rows), dtype=np.int8)  # a million rows of six joints: 6 MB instead of 48
        for file in np.unique(rows.origin.file):
            own = np.flatnonzero(rows.origin.file == file)
            timed = time is not None and np.isfinite(time[own]).all()
            own = own[np.argsort(time[own] if time is not None and timed else rows.origin.line[own], kind="stable")]
            found[column][own] = approach(reading[own], still)
    return replace(rows, covariates=rows.covariates | found).with_origin(derived=tuple(found))
