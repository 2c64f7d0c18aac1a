"""The sonars and the plane they see (report, sections 6, 7.1 and 7.2), exactly.

All in the REPORT's camera frame: the camera looks along -z, the plane is n.p + xi = 0 with n towards the camera and xi > 0.
A sensor at s that measures the perpendicular distance reads h = n.s + xi; one that measures along the camera's axis reads
h = (n.s + xi) / n_z. The report's own form (7-2)..(7-5) is exact for a tilt about x alone; ``report_plane`` keeps it for
comparison.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from aridcal.head.camera import REPORT_OPENCV

Measures = Literal["perpendicular", "along_axis"]


class Plane(NamedTuple):
    """A plane n.p + xi = 0 in the report's camera frame.

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

    Args:
        h: Readings, shape (S,), [m].
        positions: Sensors in the report's camera frame, shape (S, 3), [m].
        measures: What a reading is.

    Returns:
        The plane. For the square layout its slopes are (7-1) made right: n_x = (-h1 + h2 + h3 - h4) / (4 gamma),
        n_y = (-h1 - h2 + h3 + h4) / (4 gamma), xi = mean(h), and the residual is (h1 - h2 + h3 - h4) / 4 times (1, -1, 1, -1).

    Raises:
        ValueError: The readings differ by more than any plane allows, or the sensors are on one line.
    """
    A = np.column_stack([positions[:, :2], np.ones(len(h))])
    if np.linalg.matrix_rank(A, tol=1e-6) < 3:
        raise ValueError("the sonars sit on one line: no plane can be found")
    z = positions[:, 2]
    if measures == "along_axis":  # the plane passes through (x, y, z - h): divide n.p + xi = 0 by n_z
        slope_x, slope_y, intercept = np.linalg.lstsq(A, h - z, rcond=None)[0]
        n_z = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)
        normal, distance = n_z * np.array([slope_x, slope_y, 1.0]), n_z * intercept
    else:
        n_z = 1.0
        for _ in range(50):  # n_z is needed only for sensors off the plane z = 0; it converges like tilt^2 z / baseline
            n_x, n_y, distance = np.linalg.lstsq(A, h - n_z * z, rcond=None)[0]
            if n_x**2 + n_y**2 >= 1:
                raise ValueError("the readings differ by more than any plane allows")
            last, n_z = n_z, np.sqrt(1 - n_x**2 - n_y**2)
            if abs(n_z - last) < 1e-15:
                break
        normal = np.array([n_x, n_y, n_z])
    return Plane(normal, float(distance), h - ranges(normal, float(distance), positions, measures))


def predict_ranges(
    T_camera_square: np.ndarray, positions: np.ndarray, measures: Measures
) -> tuple[np.ndarray, np.ndarray]:
    """Predict the readings from poses of the square in OpenCV's camera frame, with derivatives.

    Args:
        T_camera_square: Shape (..., 4, 4).
        positions: Sensors in the report's camera frame, shape (S, 3), [m].
        measures: What a reading is.

    Returns:
        Readings (..., S), [m], and their derivatives (..., S, 6) by a twist (linear, angular) of the square in its own
        frame, T exp(twist).
    """
    R, t = T_camera_square[..., :3, :3], T_camera_square[..., :3, 3]
    s = positions @ REPORT_OPENCV
    arm = s - t[..., None, :]  # from the square's origin to each sensor
    n = R[..., 2]
    h = np.einsum("...si,...i->...s", arm, n)
    J = np.zeros((*h.shape, 6))
    J[..., 2] = -1.0  # the square comes closer along its own z
    J[..., 3] = -np.einsum("...si,...i->...s", arm, R[..., 1])  # n turns by omega: dn = R (omega x z)
    J[..., 4] = np.einsum("...si,...i->...s", arm, R[..., 0])
    if measures == "along_axis":
        n_z = -n[..., 2, None]  # the component towards the camera's back
        J[..., 3] += h / n_z * -R[..., 2, 1, None]
        J[..., 4] += h / n_z * R[..., 2, 0, None]
        h, J = h / n_z, J / n_z[..., None]
    return h, J


def report_plane(h: np.ndarray, gamma: float) -> Plane:
    """The report's approximate plane, (7-1)..(7-5) and (7-21), for the square layout: for comparison only.

    Args:
        h: Readings h1..h4, shape (4,), [m].
        gamma: Half the distance between adjacent sensors, [m].

    Returns:
        The plane, with the sines of (7-1) divided by the true spacing 2 gamma (the report's three spacings contradict each
        other). Its error grows with the square of the tilt about y, which no angle of the report measures.
    """
    cos_alpha = np.sqrt(1 - ((h[3] - h[0]) / (2 * gamma)) ** 2)
    cos_beta = np.sqrt(1 - ((h[2] - h[1]) / (2 * gamma)) ** 2)
    e = h / np.array([cos_alpha, cos_beta, cos_beta, cos_alpha])
    v = np.array([e[1] - e[0], e[2] - e[1], 2 * gamma]) / (gamma * (e[0] + e[2]))
    normal, distance = v / np.linalg.norm(v), float(1 / np.linalg.norm(v))
    positions = gamma * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return Plane(normal, distance, h - ranges(normal, distance, positions, "perpendicular"))
