"""Rows at one place that err alike: they count for less than as many rows at places of their own."""

from __future__ import annotations

import numpy as np

from aridcal.inputs.dataset import Dataset
from aridcal.inputs.repeats import by_appearance, first_alike
from aridcal.inputs.split import held_together

SURE = 3.0
"""Standard errors by which rows of one place must err alike before they count for less."""


def _alike(rows: Dataset) -> np.ndarray:
    """Numbers of rows of one place that see the same thing, shape (N,): marks of one image do not."""
    return by_appearance(first_alike([held_together(rows), rows.labels.block, *rows.labels.refers.T]))


def independent_share(rows: Dataset, residual: np.ndarray) -> float:
    r"""Of a row, how much it counts for where rows of one place err alike: 1 where they do not, or no place has two.

    With :math:`\rho` the correlation of the errors of two rows of one place, :math:`m_g` rows of place g tell as much as

    .. math:: \frac{m_g}{1 + (m_g - 1) \rho}

    independent ones (Kish 1965, the design effect). Let :math:`r_i` be the residual of a row in sigmas. Then

    .. math:: \hat\rho = \sum_g \Big[ \Big|\sum_{i \in g} r_i\Big|^2 - \sum_{i \in g} |r_i|^2 \Big]
              \Big/ \sum_g (m_g - 1) \sum_{i \in g} |r_i|^2

    and independent errors would make the numerator scatter by the root of :math:`2 \sum_g \sum_{i \ne j} (r_i \cdot r_j)^2`.

    Args:
        rows: N rows in use.
        residual: Theirs, each channel in units of its own scatter, shape (N, m); NaN in what a row does not measure.
    """
    place = _alike(rows)
    count = np.bincount(place)
    if count.max(initial=0) < 2:
        return 1.0
    r = np.nan_to_num(residual)
    square = np.bincount(place, np.sum(r**2, axis=1))
    total = np.stack([np.bincount(place, column) for column in r.T], axis=1)
    alike = np.sum(total**2, axis=1) - square
    outer = np.stack(
        [np.bincount(place, r[:, a] * r[:, b]) for a in range(r.shape[1]) for b in range(r.shape[1])], axis=1
    )
    fourth = np.bincount(place, np.sum(r**2, axis=1) ** 2)
    chance = float(np.sqrt(max(2.0 * float(np.sum(np.sum(outer**2, axis=1) - fourth)), np.finfo(float).tiny)))
    if float(alike.sum()) < SURE * chance:
        return 1.0
    correlation = min(float(alike.sum() / np.sum((count - 1) * square)), 1.0)
    return float(np.sum(count / (1.0 + (count - 1) * correlation)) / len(rows))
