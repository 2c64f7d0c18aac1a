r"""Means of standstills, and how well they are known.

Samples of an instrument are not independent: filters, vibration, samples that are repeated. With the correlation \rho of
neighbours, n samples are worth n (1 - \rho) / (1 + \rho); it is estimated from all standstills together. The scatter of ten
samples is itself known to a quarter only, and weights that are as uncertain do harm: each standstill's variance is shrunk to
the usual one, as far as the variances of all standstills say that they are one (Smyth 2004, Linear models and empirical Bayes
methods, section 6.2: the prior's degrees of freedom from the variance of log s²).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import digamma, polygamma

from aridcal.engine.instruments.pose import rotation_vector

MOST_CORRELATED = 0.98
"""Above this a standstill's samples are one: they are worth a hundredth of their number."""

SPIKE_SIGMAS = 8.0
"""Sigmas, by the median, beyond which a sample at standstill is of something else: a reflection, another target."""

LEAST_WORTH = 1.0
"""Independent samples that a mean rests on at least: itself."""

FREEDOM_OF_EQUAL = 1e6
"""Degrees of freedom that stand for a variance that is the same in all standstills."""


@dataclass(frozen=True)
class Averages:
    """Means of K standstills.

    Attributes:
        position: Shape (K, 3), [m].
        quaternion: x y z w, shape (K, 4); None where no orientation was measured.
        std: Of the means, position [m] then rotation [rad] about world axes, shape (K, 3 or 6).
        count: Samples of each, shape (K,).
        correlation: Of neighbouring samples, for each column of std.
        usual: Usual scatter of a single sample, for each column of std.
    """

    position: np.ndarray
    quaternion: np.ndarray | None
    std: np.ndarray
    count: np.ndarray
    correlation: np.ndarray
    usual: np.ndarray


def without_spikes(windows: list[slice], position: np.ndarray, step: np.ndarray) -> tuple[list[np.ndarray], int]:
    """Indices of the samples in windows without spikes, and the number of spikes.

    Args:
        windows: Samples of each of K standstills.
        position: Shape (N, 3), [m].
        step: To which the instrument rounds it, shape (3,), [m].
    """
    middle = [np.median(position[rows], axis=0) for rows in windows]
    distances = [np.abs(position[rows] - centre) for rows, centre in zip(windows, middle, strict=True)]
    scatter = 1.4826 * np.array([np.median(distance, axis=0) for distance in distances])
    limit = SPIKE_SIGMAS * np.maximum(np.maximum(scatter, np.median(scatter, axis=0)), step)
    near_centre = [np.all(distance <= largest, axis=1) for distance, largest in zip(distances, limit, strict=True)]
    samples = [np.arange(rows.start, rows.stop)[near] for rows, near in zip(windows, near_centre, strict=True)]
    return samples, int(sum(np.count_nonzero(~near) for near in near_centre))


def averages(
    windows: list[np.ndarray], position: np.ndarray, quaternion: np.ndarray | None, step: np.ndarray | None = None
) -> Averages:
    """Average samples over windows.

    Args:
        windows: Indices of the samples of each of K standstills; three at least.
        position: Shape (N, 3), [m].
        quaternion: x y z w, norm 1, shape (N, 4), or None.
        step: To which the instrument rounds, for each column of std. Where that is more than its noise, no number of samples
            makes a mean better than step / sqrt(12).
    """
    place = np.array([position[rows].mean(axis=0) for rows in windows])
    residuals = [position[rows] - mean for rows, mean in zip(windows, place, strict=True)]
    rotations = None
    if quaternion is not None:
        rotations = np.array([mean_rotation(quaternion[rows]) for rows in windows])
        angles = [_turns(quaternion[rows], mean) for rows, mean in zip(windows, rotations, strict=True)]
        residuals = [np.hstack(pair) for pair in zip(residuals, angles, strict=True)]
    count = np.array([len(residual) for residual in residuals])
    rho = _correlation(residuals, count)
    worth = np.maximum(count[:, None] * (1 - rho) / (1 + rho), LEAST_WORTH)
    freedom = np.maximum(worth - 1.0, 0.5)
    # a window's variance, as if its samples were as many as they are worth
    variance = np.array([(residual**2).mean(axis=0) for residual in residuals]) * worth / freedom
    shrunk, usual = _shrunk(variance, freedom)
    variance_of_means = shrunk / worth
    if step is not None:
        variance_of_means += np.where(usual < step**2, step**2 / 12, 0.0)
    return Averages(place, rotations, np.sqrt(variance_of_means), count, rho, np.sqrt(usual))


def mean_rotation(quaternion: np.ndarray) -> np.ndarray:
    """The mean of rotations, shape (N, 4) to (4,): the eigenvector of sum q q' with the largest eigenvalue, w >= 0.

    Markley et al. (2007), Averaging quaternions, equations 12 and 13: signs do not matter.
    """
    vectors = np.linalg.eigh(quaternion.T @ quaternion)[1]
    mean = vectors[:, -1]
    return np.asarray(-mean if mean[3] < 0 else mean)


def _turns(quaternion: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Rotation vectors from the mean to each quaternion (N, 4), about world axes, shape (N, 3), [rad]."""
    from scipy.spatial.transform import Rotation  # slow to load

    rotation = Rotation.from_quat(quaternion) * Rotation.from_quat(mean).inv()
    return rotation_vector(rotation.as_matrix())


def _correlation(residuals: list[np.ndarray], count: np.ndarray) -> np.ndarray:
    """Correlation of neighbours, pooled over windows, for each column.

    Samples about their own mean make it smaller by (1 + 3 rho) / n (Kendall 1954), which is put back.
    """
    products = np.sum([(residual[1:] * residual[:-1]).sum(axis=0) for residual in residuals], axis=0)
    squares = np.sum([(residual**2).sum(axis=0) for residual in residuals], axis=0)
    pairs = float(np.sum(count - 1))
    rho = np.where(squares > 0, products / np.where(squares > 0, squares, 1.0), 0.0) * float(count.sum()) / pairs
    n = max(float(len(count) / np.sum(1.0 / count)), 6.0)
    rho = (rho + 1.0 / n) / (1.0 - 3.0 / n)
    return np.asarray(np.clip(rho, 0.0, MOST_CORRELATED))


def _shrunk(variance: np.ndarray, freedom: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variances (K, C) of ``freedom`` degrees of freedom each, shrunk to the usual one of their column, shape (C,)."""
    pooled = (variance * freedom).sum(axis=0) / freedom.sum(axis=0)
    floor = np.maximum(pooled * 1e-12, 1e-300)
    logs = np.log(np.maximum(variance, floor)) - digamma(freedom / 2) + np.log(freedom / 2)
    spread = logs.var(axis=0, ddof=1) if len(logs) > 2 else np.zeros(variance.shape[1])
    excess = spread - polygamma(1, freedom / 2).mean(axis=0)
    prior = np.array([_inverse_trigamma(b) if b > 0 else FREEDOM_OF_EQUAL for b in excess]) * 2.0
    centre = np.where(
        prior < FREEDOM_OF_EQUAL,
        np.exp(logs.mean(axis=0) + digamma(np.minimum(prior, FREEDOM_OF_EQUAL) / 2) - np.log(prior / 2)),
        pooled,
    )
    return (prior * centre + freedom * variance) / (prior + freedom), pooled


def _inverse_trigamma(value: float) -> float:
    """The x at which trigamma is a value, by Newton's method on its inverse (Smyth 2004, appendix)."""
    if value < 1e-6:
        return 1.0 / value
    x = 0.5 + 1.0 / value
    for _ in range(50):
        t = float(polygamma(1, x))
        change = t * (1 - t / value) / float(polygamma(2, x))
        x += change
        if abs(change) < 1e-8 * x:
            break
    return x
