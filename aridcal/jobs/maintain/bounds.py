"""How large the model's own error is where new rows were measured, noise taken off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chndtr, chndtrinc, ndtri

from aridcal.engine.instruments.channels import columns
from aridcal.engine.rows.dataset import Dataset

FALSE_ALARMS = 0.01
"""Share of checks that may call a good calibration bad; of pairs of calibrations of one robot, of fleets and of seasons in which
nothing changed that may have an alarm."""


@dataclass(frozen=True)
class Bounds:
    """The model's own error at the rows, noise taken off, RMS over the rows, [m].

    Attributes:
        estimate: Most likely.
        low: Lowest that the rows allow at :data:`FALSE_ALARMS`.
        high: Highest.
        axes: Numbers of a row that it is of: 3 for the position, all axes together; 1 for what was measured along a line.
    """

    estimate: float
    low: float
    high: float
    axes: int = 3


def error_of(rows: Dataset, residual: np.ndarray, sigma: np.ndarray, scored: np.ndarray, taken: int) -> Bounds | None:
    """Bounds of the error in the first channel of lengths that was measured; None where there is none, in images for instance.

    Args:
        rows: N rows of C channels.
        residual: Shape (N, m).
        sigma: Of each channel, shape (C,).
        scored: Rows that count, shape (N,) bool.
        taken: Numbers that the unknowns fit whatever was measured.
    """
    for c, (channel, part) in enumerate(zip(rows.channels, columns(rows.channels), strict=True)):
        counting = scored & rows.measures[:, c]
        if channel.unit == "m" and counting.any() and residual[counting][:, part].size > taken:
            return bounds(residual[counting][:, part], float(sigma[c]), taken)
    return None


def bounds(residual: np.ndarray, sigma: float, taken: int = 0) -> Bounds:
    r"""The model's own RMS error from residuals that hold noise as well.

    Sums of squares in sigmas are :math:`\chi'^2_n(\lambda)`, with :math:`\lambda / N` the model's mean squared error: those
    values of it are kept at which what was seen is no rarer than :data:`FALSE_ALARMS`.

    Args:
        residual: Shape (N, axes), [m].
        sigma: Noise of each number, [m].
        taken: Numbers that the unknowns fit whatever was measured.
    """
    squares, count, axes = float(np.sum(residual**2)) / sigma**2, residual.size - taken, residual.shape[1]
    scale = sigma / np.sqrt(len(residual))
    estimate = scale * np.sqrt(max(squares - count, 0.0))
    if squares > min(NORMAL_FROM_SQUARES * count, LONGEST_SERIES):
        margin = scale * float(-ndtri(FALSE_ALARMS))
        return Bounds(float(estimate), float(estimate - margin), float(estimate + margin), axes)
    low, high = (_noncentrality(squares, count, share) for share in (1.0 - FALSE_ALARMS, FALSE_ALARMS))
    return Bounds(float(estimate), float(scale * np.sqrt(low)), float(scale * np.sqrt(high)), axes)


NORMAL_FROM_SQUARES = 1e4
"""Times the noise's own squares beyond which the root of the sum is normal, of sigma 1, to a ten-thousandth of that."""

LONGEST_SERIES = 1e9
"""Work: squares beyond which the root is taken for normal, too: SciPy's series for the noncentrality ends in NaN beyond 1e10. Of
three million numbers its sigma is then still right to a thousandth."""


def _noncentrality(squares: float, count: int, share: float) -> float:
    """The noncentrality at which a share of sums of squares is below what was seen; 0 where even none makes that too few."""
    return 0.0 if chndtr(squares, count, 0.0) <= share else float(chndtrinc(squares, count, share))
