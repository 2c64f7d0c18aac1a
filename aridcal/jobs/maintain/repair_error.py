"""How well a repair predicts rows that it was not fitted to: each new row left out in turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aridcal.jobs.maintain.checking import CheckResult
from aridcal.jobs.maintain.likelihoods import NewRowsQuestion, likely

LEFT_OUT_PARTS = 20
"""Parts of the rows that are left out in turn: single rows up to 20 of them; more parts only take longer."""


def left_out_residuals(checked: CheckResult, theta: np.ndarray) -> np.ndarray:
    """Residuals of the rows with what moved fitted to the others alone, shape (N, m).

    What moved was named with all rows: this is the error of its size, not of its name. NaN for rows that did not count, and for
    those that alone tell of something: of a point that was touched once.

    Args:
        checked: What the rows say.
        theta: Most likely coefficients with all of them, shape (K,).
    """
    question = checked.question
    counting = np.flatnonzero(~question.dropped)
    residual = np.full((len(checked.rows), len(question.sigma)), np.nan)
    for part in np.array_split(counting, min(LEFT_OUT_PARTS, len(counting))):
        dropped = question.dropped.copy()
        dropped[part] = True
        others = replace(question, dropped=dropped)
        if len(part) == len(counting) or _alone(question, others, theta):
            continue
        residual[part] = question.problem.residual(likely(others, theta).theta)[part]
    return residual


def _alone(question: NewRowsQuestion, others: NewRowsQuestion, theta: np.ndarray) -> bool:
    """True where an unknown is measured by the rows that were left out, and by no other."""
    unknown = question.unknown
    pull_all, pull_others = (np.abs(q.at(theta)[1][:, unknown]).max(axis=0, initial=0.0) for q in (question, others))
    return bool(np.any((pull_all > 0.0) & (pull_others == 0.0)))
