"""Noise of rows that depends on where the things are that they refer to: a shot's pose is as sure as its camera is sharp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from aridcal.engine.instruments.channels import columns
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.rows.dataset import Dataset, RowNoise, block_data, weighed, with_sigma


def with_declared_noise(data: Dataset, states: Mapping[str, np.ndarray]) -> Dataset:
    """The rows weighed by the noise that they declare themselves; rows of kinds that declare none stay as they are.

    Args:
        data: N rows of m numbers; their split must be final.
        states: Of the things, (L, P) by role.
    """
    width = columns(data.channels)[-1].stop
    relative = np.tile(np.eye(width), (len(data), 1, 1))
    if data.relative is not None:
        wide = data.relative.ndim == 3
        relative = data.relative.copy() if wide else data.relative[:, :, None] * np.eye(width)
    sigma, changed, first, channel = list(data.sigma), False, 0, 0
    for number, block in enumerate(data.blocks):
        kind, rows = MEASUREMENT_KINDS[block.kind], np.flatnonzero(data.labels.block == number)
        if kind.noise is not None and block.rows != "ignore" and len(rows):
            things = [
                states[role.name][
                    [data.instruments.things[role.name].names.index(t) for t in data.labels.refers[rows, k]]
                ]
                for k, role in enumerate(kind.roles)
            ]
            covariance = kind.noise(kind.numbers(data.observed[rows]), things)
            count = len(kind.channels)
            noise = RowNoise(covariance=covariance, absolute=block.rows == "absolute")
            reduced = replace(block, channels=kind.channels, sigma=block.sigma[:count])
            part = weighed(replace(block_data(data, number, rows), blocks=(reduced,)), noise)
            some = slice(first, first + covariance.shape[1])
            relative[rows, some, some] = part.relative
            sigma[channel : channel + count] = part.sigma
            changed = True
        first += sum(c.size for c in block.channels)
        channel += len(block.channels)
    return with_sigma(replace(data, relative=relative), sigma) if changed else data
