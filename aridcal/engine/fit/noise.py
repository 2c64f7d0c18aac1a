"""Noise from repeats, correlation of rows of one place, and contradictions between declared noise and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.engine.instruments.channels import TARGET_POSITION, columns
from aridcal.engine.levels import CERTAINLY, SURELY
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.repeats import by_appearance, first_alike
from aridcal.engine.rows.split import held_back_groups

WORTH_SAYING = 0.2
"""Logarithm of the ratio of seen to declared noise that is worth a word: people state their noise to about 20 %."""


@dataclass(frozen=True)
class RepeatScatter:
    """Rows that repeat a configuration (ISO 9283's attained poses).

    Attributes:
        groups: Number of configurations that were measured more than once.
        rows: Rows in them.
        sigma: Scatter within them in each channel, per axis, shape (C,); NaN where a channel has no repeats.
        freedom: Numbers behind each of these, less one for each centre, shape (C,).
        repeatability: RP: mean distance to the group's centre plus three standard deviations, over all groups whose positions
            were measured, [m]; NaN where there are none.
    """

    groups: int
    rows: int
    sigma: np.ndarray
    freedom: np.ndarray
    repeatability: float


def repeats(rows: Dataset, residual: np.ndarray) -> RepeatScatter | None:
    """Scatter of rows that repeat a configuration; None where none does.

    Residuals, not raw poses, are compared: readings of repeats differ a little, and the model predicts the difference. Repeats
    of other kinds are of one block and refer to the same things: several marks in one image are no repeats.

    Args:
        rows: N rows.
        residual: Of each, shape (N, m), in the channels' units; NaN in channels that a row does not measure.
    """
    first = ~copies(rows)
    rows, residual = rows.select(first), residual if first.all() else residual[first]
    label = places(rows)
    size = np.bincount(label)
    repeated = size[label] > 1
    groups = int((size > 1).sum())
    if groups == 0:
        return None
    total = np.zeros((len(size), residual.shape[1]))
    np.add.at(total, label, residual)
    centre = total[label] / size[label, None]
    off = (residual - centre)[repeated]
    # The centre is estimated from the same rows: distances come out too short by this factor.
    n = size[label[repeated]]
    sigma, freedom, distances = [], [], [np.empty(0)]
    of_targets = [block.traits.tracked for block in rows.blocks for _ in block.channels]
    parts = zip(rows.channels, columns(rows.channels), rows.measures[repeated].T, of_targets, strict=True)
    for channel, part, there, of_target in parts:
        few = there.sum() - len(np.unique(label[repeated][there]))
        freedom.append(float(channel.size * few))
        sigma.append(float(np.sqrt(np.sum(off[there][:, part] ** 2) / freedom[-1])) if few else np.nan)
        if of_target and channel.axes == TARGET_POSITION.axes:
            distances.append(np.linalg.norm(off[there][:, part], axis=1) * np.sqrt(n[there] / (n[there] - 1.0)))
    distance = np.concatenate(distances)
    spread = float(distance.mean() + 3.0 * distance.std(ddof=1)) if len(distance) else np.nan
    return RepeatScatter(groups, int(repeated.sum()), np.array(sigma), np.array(freedom), spread)


def copies(rows: Dataset) -> np.ndarray:
    """True of rows whose pose is that of an earlier row at the same configuration, bit for bit, shape (N,).

    They are copies, whatever else the rows say, and tell nothing of the noise. A length that is read twice alike was rounded.
    """
    turned = np.zeros((len(rows), 0)) if rows.rotation is None else rows.rotation.reshape(len(rows), 9)
    unseen = np.where(np.isnan(rows.position[:, 0]), np.arange(len(rows)), -1)
    # Columns one after the other: where no configuration is repeated no other column is compared.
    columns = (
        column
        for part in (rows.repeats.configuration, rows.position, turned, unseen)
        for column in np.atleast_2d(part.T)
    )
    return np.asarray(first_alike(columns) != np.arange(len(rows)))


def places(rows: Dataset) -> np.ndarray:
    """Number of each row's configuration at its station: rows with the same one are repeats, shape (N,)."""
    if rows.labels.station is None:
        return by_appearance(rows.repeats.configuration)
    station = np.unique(rows.labels.station, return_inverse=True)[1]
    return np.unique(np.column_stack([rows.repeats.configuration, station]), axis=0, return_inverse=True)[1].reshape(-1)


def declared_notices(rows: Dataset, estimated: np.ndarray, numbers: float) -> Sequence[str]:
    """Sentences on declared noise that the residuals contradict.

    Args:
        rows: What was measured, and the noise declared.
        estimated: Noise that the residuals show, shape (C,).
        numbers: Degrees of freedom behind it.
    """
    notices = []
    for channel, ratio in zip(rows.channels, noise_ratio(rows, estimated, numbers).tolist(), strict=True):
        if ratio != 1.0:
            small = "an error remains, or the declared noise is too small"
            meaning = small if ratio > 1 else "the declared noise is too large"
            notices.append(f"the residual is {ratio:.2g} times the declared {channel.name} noise: {meaning}")
    return notices


def noise_ratio(rows: Dataset, estimated: np.ndarray, numbers: float) -> np.ndarray:
    """Ratio of the residuals' noise to the declared, shape (C,); 1 for channels where chance explains the difference.

    Arguments as for :func:`declared_notices`.
    """
    chance = CERTAINLY / np.sqrt(2.0 * max(numbers, 1.0))
    ratio = estimated / rows.declared(estimated)
    return np.where(np.abs(np.log(ratio)) > max(WORTH_SAYING, chance), ratio, 1.0)


def _of_one_place(rows: Dataset) -> np.ndarray:
    """Number of each row's place and thing together, shape (N,): marks of one image are different things."""
    return by_appearance(first_alike([held_back_groups(rows), rows.labels.block, *rows.labels.refers.T]))


def independent_share(rows: Dataset, residual: np.ndarray) -> float:
    r"""How many independent rows a row counts for, as rows of one place err alike: 1 where they do not, or no place has two.

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
    place = _of_one_place(rows)
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
    if float(alike.sum()) < SURELY * chance:
        return 1.0
    correlation = min(float(alike.sum() / np.sum((count - 1) * square)), 1.0)
    return float(np.sum(count / (1.0 + (count - 1) * correlation)) / len(rows))


def covariance_of_rows(J: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    r""":math:`J \Sigma J^T` of each row, shape (N, m, m).

    Args:
        J: Columns of K coefficients, shape (N, m, K).
        covariance: Theirs, shape (K, K).
    """
    flat = J.reshape(J.shape[0] * J.shape[1], J.shape[2])
    # One product of large matrices: many of six rows each cost three times as much.
    return np.asarray((flat @ covariance).reshape(J.shape) @ J.transpose(0, 2, 1))
