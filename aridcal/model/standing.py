"""Where instruments and targets are at the geometric stage: what the instruments' own faults depend on."""

from __future__ import annotations

import numpy as np

from aridcal.effects.sights import Sights, sights_from
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.catalogue import KINDS
from aridcal.model.model import Model


def sights_of(model: Model, train: Dataset) -> Sights:
    """Where the things of some rows are.

    Args:
        model: The geometric stage's, its frames and things where they were identified.
        train: The rows that it was fitted to.
    """
    targets = np.array([frame.translation for _, frame in model.tip_target])
    things = {}
    for role, every in model.instruments.things.items():
        states = model.states.get(role, every.start)
        things[role] = {n: state for n, state in zip(every.names, states, strict=True) if np.isfinite(state).all()}
    tip = model.rows(train.readings, train.conditions, train.station, train.target).tip
    return sights_from(model.robot, model.world_base[0][1], targets, things, train.readings, tip, planes_of(train))


def planes_of(rows: Dataset) -> np.ndarray:
    """Name of the plane over which each row measures, empty for none, shape (N,)."""
    if not rows.blocks:
        return np.full(len(rows), "")
    of_planes = np.array([any(role.name == "plane" for role in KINDS[block.kind].roles) for block in rows.blocks])
    return np.where(of_planes[rows.block], rows.refers[:, 0], "")
