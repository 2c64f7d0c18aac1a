"""A fit solved again from other places: an answer that depends on its start is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aridcal.fit.closed_form import closed_form_starts
from aridcal.fit.least_squares import Fit, minimise, thin
from aridcal.fit.residual import problem
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.channels import spread
from aridcal.showing import SILENT, Progress

ROWS = 150
"""Rows of a restart, or four times the coefficients if that is more: where a minimum lies shows in these."""

AROUND = 2
"""Starts that are drawn around the answer."""

REACH_ANGLE, REACH_LENGTH = 0.05, 0.02
"""How far from the answer those are, [rad] and [m]: ten times what robots are usually wrong by."""

SAME = 0.01
"""Share of sigma by which residuals of one minimum may differ."""

LENGTHS = frozenset({"x", "y", "z", "a", "d"})
"""Components in [m]."""


def with_restarts(found: Fit, train: Dataset, progress: Progress = SILENT) -> Fit:
    """Solve again on some of the rows from other places, and note how many lead to the same minimum."""
    some = thin(found.model.rows(train.readings, None, train.station), max(ROWS, 4 * len(found.theta)))
    part = problem(found.model, train.select(some), progress)
    weight = found.weight[some]
    reference = minimise(part, found.theta, weight)
    is_length = np.array([c.component in LENGTHS for c in found.model.coefficients])
    reach = np.where(is_length, REACH_LENGTH, REACH_ANGLE)
    rng = np.random.default_rng(0)
    others = [found.theta + reach * rng.uniform(-1, 1, len(reach)) for _ in range(AROUND)]
    others += closed_form_starts(found, part.data)
    tolerance = SAME * spread(reference.sigma, train.channels)
    agreed = 0
    for theta in progress.over(others, "other starts"):
        other = minimise(part, theta, weight)
        off = np.abs(other.at.residual - reference.at.residual)[weight > 0.5]
        agreed += bool(np.all(off <= tolerance))
    return replace(found, convergence=replace(found.convergence, restarts=len(others), agreed=agreed))
