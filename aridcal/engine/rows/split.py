"""Held-out rows: drawn by configuration, never those that a frame cannot do without."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.remarks import Remark
from aridcal.engine.rows.repeats import blocks, places
from aridcal.system.errors import MeasurementError, name_list

TEST_SHARE = 0.2
"""Share of the rows that is held out: a fifth, as is usual; errors of 60 rows are known to 6 %."""


FEW_ROWS = 12
"""Rows of a thing below which one of them is not held out without the others: of twelve, one knows the others to 4 %."""


def held_back_groups(data: Dataset) -> np.ndarray:
    """Numbers of the groups of rows that are held back together, shape (N,): those of a place, or all of a thing that has few.

    A row of an unknown thing that has few rows, held back alone, would say nothing new: the thing's other rows know it. Marks of
    a board are known.
    """
    return _with_things(data, places(data.readings, data.kinds))


def repeated(data: Dataset) -> np.ndarray:
    """Numbers of configurations, shape (N,), where rows of a place err independently; of a thing with few rows all are one."""
    return _with_things(data, blocks(data.readings, data.kinds))


def _with_things(data: Dataset, of_arm: np.ndarray) -> np.ndarray:
    """The numbers of the arm's places or configurations, shape (N,), with all rows of a thing that has few under one number."""
    if data.direct:
        return of_arm
    labels = np.column_stack([data.labels.block.astype(str), _unknown(data)])
    thing = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)
    few = np.bincount(thing)[thing] < FEW_ROWS
    return np.asarray(np.unique(np.where(few, thing + of_arm.max() + 1, of_arm), return_inverse=True)[1])


def _unknown(data: Dataset) -> np.ndarray:
    """Labels of what the rows refer to and have to tell, shape (N, roles); empty for what is known beforehand."""
    labels = data.labels.refers.copy()
    for number, block in enumerate(data.blocks):
        rows = data.labels.block == number
        for k, role in enumerate(block.traits.roles):
            things = data.instruments.things.get(role.name)
            if things is not None and not things.free.all():
                known = [name for name, free in zip(things.names, things.free, strict=True) if not free.any()]
                labels[rows & np.isin(labels[:, k], known), k] = ""
    return labels


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


def with_training_rows(data: Dataset, per_station: bool, drawn: np.ndarray) -> Dataset:
    """A data set that has training rows of everything its rows refer to, and of every station that has a frame of its own.

    Args:
        data: N rows with their split.
        per_station: True if a frame is one for each station.
        drawn: Rows whose split was drawn; where a table says `test`, that stays, shape (N,) bool.

    Returns:
        The rows; of a label that the draw left without training rows none are held out, which is noted.

    Raises:
        MeasurementError: a table's own split leaves a station without training rows.
    """
    test, notes = data.test.copy(), []
    for name, labels in _labels(data, per_station):
        lone = sorted(set(labels[test].tolist()) - set(labels[~test].tolist()) - {""})
        if not lone:
            continue
        alone = np.isin(labels, lone)
        if name == "station" and (of_table := alone & ~drawn).any():
            first = labels[of_table][0]
            raise MeasurementError(f"station {str(first)!r} has only `test` rows: its frame cannot be identified")
        needed = alone & drawn
        if needed.any():
            test &= ~needed
            to_what = "for its frame" if name == "station" else "to find it"
            which = name_list(sorted(set(labels[needed].tolist())))
            why = f"all rows of {name} {which} are needed {to_what}: none of them is held out"
            notes.append(Remark(data.origin.files[0].name, None, name, "", why))
    return replace(data, test=test).with_origin(notices=(*notes, *data.origin.notices))


def _labels(data: Dataset, per_station: bool) -> Iterator[tuple[str, np.ndarray]]:
    """Labels of the rows' stations, of what they refer to in each role, and of their targets; shape (N,), empty where none."""
    if per_station and data.labels.station is not None:
        yield "station", data.labels.station
    of_role: dict[str, np.ndarray] = {}
    for number, block in enumerate(data.blocks):
        rows = data.labels.block == number
        for k, role in enumerate(() if block.traits.tracked else block.traits.roles):  # a tracker has no label yet
            labels = of_role.setdefault(role.name, np.zeros(len(data), dtype=data.labels.refers.dtype))
            labels[rows] = data.labels.refers[rows, k]
    yield from of_role.items()
    if data.labels.target is not None:
        yield "target", data.labels.target
