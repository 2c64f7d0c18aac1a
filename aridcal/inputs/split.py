"""Held-out rows: drawn by configuration, never those that a frame cannot do without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aridcal.errors import MeasurementError
from aridcal.inputs.dataset import Dataset
from aridcal.inputs.tables import Remark

TEST_SHARE = 0.2
"""Share of the rows that is held out: a fifth, as is usual; errors of 60 rows are known to 6 %."""


def draw_split(block: np.ndarray, seed: int) -> np.ndarray:
    """Choose whole blocks for the test, in random order, until a fifth of the rows is in; neither part stays empty."""
    sizes = np.bincount(block)
    test = np.zeros(len(block), dtype=bool)
    if len(sizes) < 2:
        return test
    order = np.random.default_rng(seed).permutation(len(sizes))
    room = max(1, round(TEST_SHARE * len(block)))
    chosen = np.zeros(len(sizes), dtype=bool)
    for k in order:
        if sizes[k] <= room:
            chosen[k] = True
            room -= sizes[k]
    if not chosen.any():
        chosen[np.argmin(sizes)] = True
    return chosen[block]


def with_training_rows(data: Dataset, per_station: bool) -> Dataset:
    """The same rows with training rows at every station that has a frame of its own.

    Args:
        data: N rows with their split.
        per_station: True if a frame is one for each station.

    Returns:
        The rows; a station that the draw left without training rows has none held out, which is noted.

    Raises:
        MeasurementError: the table's own split leaves a station without training rows.
    """
    if data.station is None or not per_station:
        return data
    lone = sorted({str(s) for s in data.station} - {str(s) for s in data.station[data.train]})
    if not lone:
        return data
    if data.split_given:
        raise MeasurementError(f"station {lone[0]!r} has only `test` rows: its frame cannot be identified")
    why = f"all rows of station {', '.join(lone)} are needed for its frame: none of them is held out"
    note = Remark(data.files[0].name, None, "station", "", why)
    test = data.test & ~np.isin(data.station.astype(str), lone)
    return replace(data, test=test, notices=(note, *data.notices))
