"""Rows whose noise depends on where the things are that they refer to: a shot's pose is as sure as its camera is sharp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from aridcal.engine.instruments.channels import columns
from aridcal.engine.instruments.kinds import KINDS
from aridcal.engine.rows.dataset import Dataset, RowNoise, of_block, weighed, with_sigma


def with_stated_noise(data: Dataset, states: Mapping[str, np.ndarray]) -> Dataset:
    """The rows weighed by what they state of their own noise; those of kinds that state nothing as they are.

    Args:
        data: N rows of m numbers; their split must be final.
        states: Of the things, (L, P) by role.
    """
    width = columns(data.channels)[-1].stop
    relative = np.tile(np.eye(width), (len(data), 1, 1))
    if data.relative is not None:
        wide = data.relative.ndim == 3
        relative = data.relative.copy() if wide else data.relative[:, :, None] * np.eye(width)
    sigma, found, first, channel = list(data.sigma), False, 0, 0
    for number, block in enumerate(data.blocks):
        kind, own = KINDS[block.kind], np.flatnonzero(data.labels.block == number)
        if kind.noise is not None and block.rows != "ignore" and len(own):
            now = [
                states[role.name][
                    [data.instruments.things[role.name].names.index(t) for t in data.labels.refers[own, k]]
                ]
                for k, role in enumerate(kind.roles)
            ]
            covariance = kind.noise(kind.numbers(data.observed[own]), now)
            count = len(kind.channels)
            noise = RowNoise(covariance=covariance, absolute=block.rows == "absolute")
            stated = replace(block, channels=kind.channels, sigma=block.sigma[:count])
            made = weighed(replace(of_block(data, number, own), blocks=(stated,)), noise)
            some = slice(first, first + covariance.shape[1])
            relative[own, some, some] = made.relative
            sigma[channel : channel + count] = made.sigma
            found = True
        first += sum(c.size for c in block.channels)
        channel += len(block.channels)
    return with_sigma(replace(data, relative=relative), sigma) if found else data
