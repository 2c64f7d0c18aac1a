"""Where instruments and targets are at the geometric stage: what the instruments' own faults depend on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from aridcal.engine.corrections.sights import Sights, sights_from
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.model.model import Model
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset


def sights_of(model: Model, train: Dataset) -> Sights:
    """Places of targets and things, on which the faults of instruments depend.

    Args:
        model: The geometric stage's, its frames and things where they were identified.
        train: The rows that it was fitted to.
    """
    targets = np.array([frame.translation for _, frame in model.tip_target])
    things = {}
    for role, every in model.instruments.things.items():
        states = model.states.get(role, every.start)
        things[role] = {n: state for n, state in zip(every.names, states, strict=True) if np.isfinite(state).all()}
    with_targets = replace(model, around=replace(model.around, sights=Sights(targets)))
    rows = rows_of_data(model, train)
    places = partial(with_targets.target_places, rows, train.readings)
    linked = {name for every in model.instruments.things.values() for name in every.linked}
    return sights_from(model.world_base[0][1], targets, things, places, labels_of(train, "plane"), linked)


def references(rows: Dataset) -> Iterator[tuple[str, str, np.ndarray]]:
    """Role and name of each thing, and the rows that refer to it, shape (N,) bool."""
    roles = dict.fromkeys(role.name for block in rows.blocks for role in MEASUREMENT_KINDS[block.kind].roles)
    for role in roles:
        label = labels_of(rows, role)
        for name in np.unique(label[label != ""]).tolist():
            yield role, name, label == name


def labels_of(rows: Dataset, role: str) -> np.ndarray:
    """Name of the thing of a role to which each row refers, empty for none, shape (N,)."""
    names = np.full(len(rows), "", dtype=rows.labels.refers.dtype)
    for number, block in enumerate(rows.blocks):
        for k, each in enumerate(MEASUREMENT_KINDS[block.kind].roles):
            if each.name == role:
                some = rows.labels.block == number
                names[some] = rows.labels.refers[some, k]
    return names
