"""The camera: OpenCV's projection model with its Jacobians, and the report's camera frame.

OpenCV's camera frame has x right, y down and z forward; the report's has x right, y up and z towards the camera's back. In
the report's frame the image plane stands behind the lens, at z = +f (7-25).
"""

from __future__ import annotations

import numpy as np

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
REPORT_OPENCV = np.diag([1.0, -1.0, -1.0])  # turns one camera frame into the other, either way


def distort(xy: np.ndarray, intrinsics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Apply the lens distortion (Brown and Conrady, as in OpenCV) to normalised image points.

    Args:
        xy: Points x/z, y/z, shape (..., 2).
        intrinsics: In the order of ``INTRINSICS``, shape (9,), [px] for the first four.

    Returns:
        Distorted points (..., 2), their derivatives by xy (..., 2, 2) and by k1, k2, p1, p2, k3 (..., 2, 5).
    """
    k1, k2, p1, p2, k3 = intrinsics[4:]
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # d radial / d r2
    bent = np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1
    )
    cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    by_xy = np.empty((*r2.shape, 2, 2))
    by_xy[..., 0, 0] = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    by_xy[..., 0, 1] = by_xy[..., 1, 0] = cross
    by_xy[..., 1, 1] = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    by_k = np.empty((*r2.shape, 2, 5))
    for column, power in ((0, r2), (1, r2**2), (4, r2**3)):
        by_k[..., column] = xy * power[..., None]
    by_k[..., 0, 2] = by_k[..., 1, 3] = 2 * x * y
    by_k[..., 0, 3] = r2 + 2 * x * x
    by_k[..., 1, 2] = r2 + 2 * y * y
    return bent, by_xy, by_k


def project(points: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Project points of OpenCV's camera frame, shape (..., 3), [m], to pixels, shape (..., 2)."""
    return intrinsics[2:4] + intrinsics[:2] * distort(points[..., :2] / points[..., 2:], intrinsics)[0]


def project_jacobian(points: np.ndarray, intrinsics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points, with derivatives.

    Args:
        points: In OpenCV's camera frame, shape (..., 3), [m].
        intrinsics: In the order of ``INTRINSICS``, shape (9,).

    Returns:
        Pixels (..., 2), their derivatives by the point (..., 2, 3) [px/m] and by the intrinsics (..., 2, 9).
    """
    z = points[..., 2]
    xy = points[..., :2] / z[..., None]
    bent, by_xy, by_k = distort(xy, intrinsics)
    f = intrinsics[:2]
    by_point = np.empty((*z.shape, 2, 3))
    by_point[..., :2] = f[:, None] * by_xy / z[..., None, None]
    by_point[..., 2] = -np.einsum("...ij,...j->...i", by_point[..., :2], xy)
    by_intrinsics = np.zeros((*z.shape, 2, len(INTRINSICS)))
    by_intrinsics[..., [0, 1], [0, 1]] = bent
    by_intrinsics[..., [0, 1], [2, 3]] = 1
    by_intrinsics[..., 4:] = f[:, None] * by_k
    return intrinsics[2:4] + f * bent, by_point, by_intrinsics


def rays(pixels: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Return the undistorted x/z, y/z of pixels, shape (..., 2), by Newton's method on the distortion."""
    bent = (pixels - intrinsics[2:4]) / intrinsics[:2]
    xy = bent.copy()
    if not np.any(intrinsics[4:]):
        return xy
    for _ in range(20):
        value, slope, _ = distort(xy, intrinsics)
        step = np.linalg.solve(slope, (bent - value)[..., None])[..., 0]
        xy += step
        if np.all(np.abs(step) < 1e-13):
            break
    return xy


def on_plane(pixels: np.ndarray, intrinsics: np.ndarray, normal: np.ndarray, distance: float) -> np.ndarray:
    """Put image points back on the plane they were seen on: (7-28), (7-29).

    Args:
        pixels: Shape (..., 2).
        intrinsics: In the order of ``INTRINSICS``, shape (9,).
        normal: Of the plane, towards the camera, in the REPORT's camera frame, shape (3,).
        distance: xi of n.p + xi = 0, from the lens to the plane, [m].

    Returns:
        Points in the report's camera frame, shape (..., 3), [m].

    The report's (x', y', f) is -(x, y, 1) f of OpenCV, mirrored: with w = (-(u - cx), v - cy, f_px), p = -w / (v . w).
    """
    xy = rays(pixels, intrinsics)
    w = np.concatenate([-xy[..., :1], xy[..., 1:], np.ones_like(xy[..., :1])], axis=-1)
    return -w / (w @ (normal / distance))[..., None]
