"""Several targets of one rigid body: made from one measured pose, they are one measurement."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from aridcal.engine.rows.dataset import Dataset

MOST_SCATTER = 0.01
"""Share of the residual below which the distances between targets are constant: each measured by itself, they would vary by
1.4 times the noise. What is left is the rounding of files."""

LEAST_CONFIGURATIONS = 4
"""Configurations at the least in which two targets must keep their distance."""


def targets_of_one_body(data: Dataset, sigma: float) -> int:
    """How many targets were made from one pose of one rigid body, by their distances; 1 if they were measured apart.

    Args:
        data: N rows, each with the label of its target as ``station``.
        sigma: Position residual of the geometry per axis, [m].
    """
    if data.labels.station is None:
        return 1
    position = {
        label: dict(zip(data.repeats.configuration[rows].tolist(), data.position[rows], strict=True))
        for label in np.unique(data.labels.station)
        for rows in [data.labels.station == label]
    }
    together = 1
    for a, b in combinations(position, 2):
        both = position[a].keys() & position[b].keys()
        if len(both) >= LEAST_CONFIGURATIONS:
            distances = [float(np.linalg.norm(position[a][k] - position[b][k])) for k in both]
            together += bool(np.std(distances) < MOST_SCATTER * sigma)
    # Of n targets of one body all n (n - 1) / 2 pairs are rigid.
    return round(0.5 + float(np.sqrt(0.25 + 2.0 * (together - 1))))
