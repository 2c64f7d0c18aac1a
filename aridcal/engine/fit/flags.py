"""Robust sigmas, rows that are outliers, and whether outliers lie together: errors of one place are structure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import betainc, gammaincinv

from aridcal.engine.instruments.channels import Channels, norms
from aridcal.engine.model.model import UNIT_SIZES
from aridcal.engine.numerics import FLOOR
from aridcal.engine.rows.dataset import Dataset

QUANTILES = (0.5, 0.9)
"""Of the rows' norms that tell a sigma. A tenth of the rows may be wild; more than that is a part of the robot's life that
the model lacks (one of two sides of a backlash, say) and must not be flagged away."""

CAUCHY = 4.0
"""Work: Sigmas at which a row's weight has fallen to a half: one clean row of three numbers in a thousand is as far."""

OUTLIER = 6.0
"""Sigmas per axis, in any channel, beyond which a row is flagged: 1 clean pose in 7 million."""

SUSPECT_LIMIT = 3.0
"""The same for rows that share a measurement although the joints moved between them: that alone makes them doubtful."""

ENDS = 150
"""Work: Flagged rows at which a window may begin or end: 11,000 windows of each coordinate are enough to see a cluster."""

OF_SPACE = ("m", "rad", "px")
"""Units whose noise can be set beside each other."""

MEASURED_COORDINATE = "what is measured"
"""Name of the coordinate in which rows of the same things lie together."""


@dataclass(frozen=True)
class Cluster:
    """Flagged rows that lie together in one coordinate, more than chance would have it.

    Attributes:
        coordinate: A joint, a measured column, ``x y z`` of the target, ``station``, or ``row`` for the order of rows.
        low: The smallest value among them.
        high: The largest.
        rows: The flagged rows between them, shape (N,) bool.
        p_value: Chance of any such cluster, all windows of all coordinates counted.
    """

    coordinate: str
    low: float
    high: float
    rows: np.ndarray
    p_value: float


def robust_sigma(r: np.ndarray, channels: Channels) -> np.ndarray:
    """Sigma of each channel from the norms of scaled residuals, by two :data:`QUANTILES`: the larger counts.

    Args:
        r: Shape (N, m).
        channels: C of them.

    Returns:
        Shape (C,).
    """
    sigmas = []
    for channel, length in zip(channels, norms(r, channels), strict=True):
        length = length[~np.isnan(length)]
        if not len(length):
            sigmas.append(FLOOR)
            continue
        ratios = [q / usual for q, usual in zip(_quantiles(length), usual_norms(channel.size), strict=True)]
        sigmas.append(max(*ratios, FLOOR))
    return np.array(sigmas)


def _quantiles(values: np.ndarray) -> list[float]:
    """Quantiles at :data:`QUANTILES`, linear between neighbours, as NumPy's, whose function takes 0.1 ms even for few values."""
    places = [q * (len(values) - 1) for q in QUANTILES]
    lower = [int(place) for place in places]
    ordered = np.partition(values, [k for low in lower for k in (low, min(low + 1, len(values) - 1))])
    quantiles = []
    for place, low in zip(places, lower, strict=True):
        a, b = float(ordered[low]), float(ordered[min(low + 1, len(values) - 1)])
        quantiles.append(a + (b - a) * (place - low))
    return quantiles


@cache
def usual_norms(size: int) -> tuple[float, ...]:
    """Quantiles of the norm of so many standard normal numbers, at :data:`QUANTILES` (chi distribution)."""
    return tuple(float(np.sqrt(2.0 * gammaincinv(0.5 * size, q))) for q in QUANTILES)


def distance(r: np.ndarray, sigma: np.ndarray, channels: Channels) -> np.ndarray:
    """How many sigmas per axis a row is off in its worst channel, shape (N,), from scaled residuals (N, m)."""
    return np.asarray(np.fmax.reduce(norms(r, channels) / sigma[:, None], axis=0))


def cauchy(r: np.ndarray, sigma: np.ndarray, channels: Channels) -> np.ndarray:
    """Weights that let go of far rows gradually (Cauchy's loss on the row's distance), shape (N,)."""
    return 1.0 / (1.0 + (distance(r, sigma, channels) / CAUCHY) ** 2)


def limits(data: Dataset, exempt: np.ndarray | None = None) -> np.ndarray:
    """Sigmas beyond which each row is flagged, shape (N,).

    Args:
        data: N rows.
        exempt: Rows that are never flagged, however large their residual, shape (N,) bool.
    """
    usual = np.where(data.repeats.doubtful, SUSPECT_LIMIT, OUTLIER)
    return usual if exempt is None else np.where(exempt, np.inf, usual)


def outlier_rows(r: np.ndarray, channels: Channels, limit: np.ndarray) -> np.ndarray:
    """Outliers: rows further off than the bulk of the rows can explain, shape (N,) bool.

    Args:
        r: Scaled residuals, shape (N, m).
        channels: Their channels.
        limit: Sigmas beyond which each row is an outlier, shape (N,); see :func:`limits`.
    """
    return np.asarray(distance(r, robust_sigma(r, channels), channels) > limit)


def cluster(flags: np.ndarray, data: Dataset) -> Cluster | None:
    r"""The window of one coordinate that holds more of the flagged rows than chance would, if there are two or more.

    Of N rows f are flagged. From one of them, n rows reach to another and hold k of them. If flags fell anywhere, each of
    the f - 1 others would lie within those n - 1 rows with chance :math:`(n - 1) / (N - 1)`, so that k - 1 or more do with

    .. math:: p = P(\mathrm{Bin}(f - 1, \tfrac{n - 1}{N - 1}) \ge k - 1)

    which is multiplied by f (f - 1), the choices of that row and of k, and by the number of coordinates (Bonferroni): a scan
    statistic (Naus 1965, doi:10.1080/01621459.1965.10480810).

    Args:
        flags: Shape (N,) bool.
        data: N rows.
    """
    if flags.sum() < 2:
        return None
    places = coordinates(data)
    clusters = [_window(name, values, flags, len(places)) for name, values in places.items()]
    return min(clusters, key=lambda c: c.p_value)


def coordinates(data: Dataset) -> dict[str, np.ndarray]:
    """Values of every coordinate in which rows may lie together, shape (N,) each, by the name of the coordinate."""
    values_of = {"row": np.argsort(data.sequence).astype(float)}  # the place of each in the order of measurement
    values_of |= dict(zip(data.names, data.readings.T, strict=True))
    if not np.isnan(data.position).any():
        values_of |= dict(zip("xyz", data.position.T, strict=True))
    if not data.direct:
        things = np.unique(
            np.column_stack([data.labels.block.astype(str), data.labels.refers]), axis=0, return_inverse=True
        )[1]
        values_of[MEASURED_COORDINATE] = things.reshape(-1).astype(float)
    values_of |= {name: values for name, values in data.covariates.items() if not np.isnan(values).any()}
    if data.labels.station is not None:
        values_of["station"] = np.unique(data.labels.station, return_inverse=True)[1].astype(float)
    return {name: values for name, values in values_of.items() if np.ptp(values) > 0}


def _window(name: str, values: np.ndarray, flags: np.ndarray, coordinates: int) -> Cluster:
    """The window of one coordinate that is least likely by chance."""
    ordered, flagged_values = np.sort(values), np.sort(values[flags])
    f = len(flagged_values)
    ends = np.unique(flagged_values[np.linspace(0, f - 1, min(f, ENDS)).round().astype(int)])
    low, high = (ends[k] for k in np.triu_indices(len(ends)))
    inside = np.searchsorted(ordered, high, side="right") - np.searchsorted(ordered, low)
    hits = np.searchsorted(flagged_values, high, side="right") - np.searchsorted(flagged_values, low)
    # of f - 1 other flags at least hits - 1 in the window: the binomial tail (DLMF 8.17.5), 1 where no other need be there
    least = np.maximum(hits - 1, 1)
    tail = betainc(least, f - least, (inside - 1) / (len(ordered) - 1))
    chance = np.where(hits > 1, tail, 1.0)
    best = int(np.argmin(chance))
    a, b = float(low[best]), float(high[best])
    rows = flags & (values >= a) & (values <= b)
    windows = f * (f - 1)
    return Cluster(name, a, b, rows, float(min(1.0, chance[best] * windows * coordinates)))


def coarsest(sigma: np.ndarray, channels: Channels) -> np.ndarray:
    """Noise of the coarsest channel in the unit of each channel, shape (C,); 0 for channels in sigmas."""
    size = np.array([UNIT_SIZES[channel.unit] if channel.unit in OF_SPACE else 0.0 for channel in channels])
    there = size > 0.0
    return size * float(np.max(sigma[there] / size[there], initial=0.0))
