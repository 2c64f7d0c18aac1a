"""The sonars and the plane they see (Doty 1992, sections 6, 7.1 and 7.2), exactly.

All in Doty's camera frame: the camera looks along -z, the plane is n.p + xi = 0 with n towards the camera and xi > 0.
A sensor at s that measures the perpendicular distance reads h = n.s + xi; one that measures along the camera's axis reads
h = (n.s + xi) / n_z. Doty's own form (7-2)..(7-5) is exact for a tilt about x alone; ``doty_plane`` keeps it for
comparison.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aridcal.engine.instruments.camera_sonar import Measures

# [m] Singular value of the sensors' layout below which they sit on one line: a micrometre.
ON_ONE_LINE = 1e-6

# Rounds for sensors off the plane z = 0; each gains a factor of about tilt² z / baseline, so that a few are enough.
TILT_STEPS = 50

# Change of n_z that is rounding.
TILT_TOLERANCE = 1e-15


# Standard errors of a sonar's mean residual that are worth a word: noise does that once in 16,000 times.
DISAGREEMENT_SIGMAS = 4.0

# Whose scatter says something.
FEWEST_SHOTS = 3


class Plane(NamedTuple):
    """A plane n.p + xi = 0 in Doty's camera frame.

    Attributes:
        normal: Unit vector towards the camera, shape (3,).
        distance: xi, from the lens to the plane, [m].
        residual: What the sensors disagree by: reading minus model, shape (S,), [m].
    """

    normal: np.ndarray
    distance: float
    residual: np.ndarray


def ranges(normal: np.ndarray, distance: float, positions: np.ndarray, measures: Measures) -> np.ndarray:
    """Predict the readings of sensors, shape (S,), [m], from a plane and the sensors' positions, shape (S, 3)."""
    h = positions @ normal + distance
    return h / normal[2] if measures == "along_axis" else h


def fit_plane(h: np.ndarray, positions: np.ndarray, measures: Measures) -> Plane:
    """Find the plane that the readings show, by least squares, for any layout of three or more sensors off one line.

    For the square layout its slopes are (7-1) made right: n_x = (-h1 + h2 + h3 - h4) / (4 gamma),
    n_y = (-h1 - h2 + h3 + h4) / (4 gamma), xi = mean(h), and the residual is (h1 - h2 + h3 - h4) / 4 times (1, -1, 1, -1).

    Args:
        h: Readings, shape (S,), [m].
        positions: Sensors in Doty's camera frame, shape (S, 3), [m].
        measures: What a reading is.

    Raises:
        ValueError: The readings differ by more than any plane allows, or the sensors are on one line.
    """
    x_y_1 = np.column_stack([positions[:, :2], np.ones(len(h))])
    if np.linalg.matrix_rank(x_y_1, tol=ON_ONE_LINE) < 3:
        raise ValueError("the sonars sit on one line: no plane can be found")
    z = positions[:, 2]
    fit = _fit_along_axis if measures == "along_axis" else _fit_perpendicular
    normal, distance = fit(x_y_1, z, h)
    residual = h - ranges(normal, distance, positions, measures)
    return Plane(normal, distance, residual)


def _fit_along_axis(x_y_1: np.ndarray, z: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit normal and distance to readings along the camera's axis.

    The plane passes through (x, y, z - h). Divided by n_z, n.p + xi = 0 is linear in the slopes:
    (n_x / n_z) x + (n_y / n_z) y + xi / n_z = h - z.
    """
    slope_x, slope_y, intercept = np.linalg.lstsq(x_y_1, h - z, rcond=None)[0]
    n_z = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)
    normal = n_z * np.array([slope_x, slope_y, 1.0])
    return normal, float(n_z * intercept)


def _fit_perpendicular(x_y_1: np.ndarray, z: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit normal and distance to perpendicular distances.

    n_x x + n_y y + xi = h - n_z z is linear for sensors in the plane z = 0; for others n_z is put in and found again from
    n_z² = 1 - n_x² - n_y² until it stays.
    """
    n_z = 1.0
    for _ in range(TILT_STEPS):
        n_x, n_y, distance = np.linalg.lstsq(x_y_1, h - n_z * z, rcond=None)[0]
        if n_x**2 + n_y**2 >= 1:
            raise ValueError("the readings differ by more than any plane allows")
        last = n_z
        n_z = np.sqrt(1 - n_x**2 - n_y**2)
        if abs(n_z - last) < TILT_TOLERANCE:
            break
    return np.array([n_x, n_y, n_z]), float(distance)


def contradictions(residuals: np.ndarray, std: float) -> dict[int, float]:
    """Find the sonars that contradict the camera throughout: a fault of the head, which no single shot can show.

    A sonar does if the mean of its residuals is more than ``DISAGREES`` standard errors, scatter / sqrt(N), from zero.

    Args:
        residuals: Readings minus what the poses predict, of N shots, shape (N, S), [m].
        std: Of a reading, [m]; the scatter is taken to be no less.

    Returns:
        Mean residual by the sonar's index, [m].
    """
    n = len(residuals)
    if n < FEWEST_SHOTS or residuals.shape[1] == 0:
        return {}
    mean = residuals.mean(axis=0)
    scatter = np.maximum(residuals.std(axis=0, ddof=1), std)
    faulty = np.abs(mean) > DISAGREEMENT_SIGMAS * (scatter / np.sqrt(n))
    return {int(k): float(mean[k]) for k in np.flatnonzero(faulty)}


def doty_plane(h: np.ndarray, gamma: float) -> Plane:
    """Doty's approximate plane, (7-1)..(7-5) and (7-21), for the square layout: for comparison only.

    Its error grows with the square of the tilt about y, which no angle of Doty (1992) measures. The sines of (7-1) are divided
    by the true spacing 2 gamma; Doty's three spacings contradict each other.

    Args:
        h: Readings h1..h4, shape (4,), [m].
        gamma: Half the distance between adjacent sensors, [m].
    """
    h1, h2, h3, h4 = h
    spacing = 2 * gamma
    cos_alpha = np.sqrt(1 - ((h4 - h1) / spacing) ** 2)  # (7-1)
    cos_beta = np.sqrt(1 - ((h3 - h2) / spacing) ** 2)  # (7-5)
    e1, e2, e3, _ = h / np.array([cos_alpha, cos_beta, cos_beta, cos_alpha])  # (7-2)..(7-4)
    v = np.array([e2 - e1, e3 - e2, spacing]) / (gamma * (e1 + e3))  # (7-21)
    length = np.linalg.norm(v)
    normal, distance = v / length, float(1 / length)
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    positions = gamma * corners
    return Plane(normal, distance, h - ranges(normal, distance, positions, "perpendicular"))
