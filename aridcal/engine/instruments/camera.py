"""The camera: OpenCV's projection model with its Jacobians, Doty's camera frame, and the sonars that sit around the lens.

OpenCV's camera frame has x right, y down and z forward; Doty's has x right, y up and z towards the camera's back. In
Doty's frame the image plane stands behind the lens, at z = +f (7-25).

A point (X, Y, Z) of OpenCV's frame has the normalised image point (x, y) = (X, Y) / Z. The lens bends it to (x'', y''), see
:func:`distort`, and its pixel is u = fx x'' + cx, v = fy y'' + cy (OpenCV, "Camera Calibration and 3D Reconstruction").
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from aridcal.engine.instruments.pose import skew

Measures = Literal["perpendicular", "along_axis"]
"""What a sonar reads: the distance of its sensor from the plane, or along the camera's axis."""

# OpenCV's numbers of a camera, in this order everywhere: the first four in [px], the others without unit.
INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")

# Turns one camera frame into the other, either way.
DOTY_OPENCV = np.diag([1.0, -1.0, -1.0])

# Steps to undo a distortion; real lenses take about five.
NEWTON_STEPS = 20

# Last step of a normalised image point: 1e-10 px, no more than rounding.
NEWTON_TOLERANCE = 1e-13


def distort(xy: np.ndarray, intrinsics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Apply the lens distortion (Brown and Conrady, as in OpenCV) to normalised image points.

    With r² = x² + y² and R = 1 + k1 r² + k2 r⁴ + k3 r⁶::

        x'' = x R + 2 p1 x y + p2 (r² + 2 x²)
        y'' = y R + p1 (r² + 2 y²) + 2 p2 x y

    and with R' = dR / d(r²) = k1 + 2 k2 r² + 3 k3 r⁴ the derivative by the point is symmetric::

        dx''/dx = R + 2 x² R' + 2 p1 y + 6 p2 x        dx''/dy = dy''/dx = 2 x y R' + 2 p1 x + 2 p2 y
        dy''/dy = R + 2 y² R' + 6 p1 y + 2 p2 x

    Args:
        xy: Points x, y, shape (..., 2).
        intrinsics: In the order of ``INTRINSICS``, shape (9,), or of each point (..., 9).

    Returns:
        Distorted points (..., 2), their derivatives by xy (..., 2, 2) and by k1, k2, p1, p2, k3 (..., 2, 5).
    """
    k1, k2, p1, p2, k3 = np.moveaxis(intrinsics[..., 4:], -1, 0)
    x, y = xy[..., 0], xy[..., 1]
    xx, yy, both = x * x, y * y, x * y
    r2 = xx + yy
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    wide, high = r2 + 2 * xx, r2 + 2 * yy
    bent_x = x * radial + 2 * p1 * both + p2 * wide
    bent_y = y * radial + p1 * high + 2 * p2 * both

    slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    x_by_x = radial + 2 * xx * slope + 2 * p1 * y + 6 * p2 * x
    y_by_y = radial + 2 * yy * slope + 6 * p1 * y + 2 * p2 * x
    mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    by_xy = matrices([[x_by_x, mixed], [mixed, y_by_y]])
    by_k = matrices([[x * r2, x * r2**2, 2 * both, wide, x * r2**3], [y * r2, y * r2**2, high, 2 * both, y * r2**3]])
    return np.stack([bent_x, bent_y], -1), by_xy, by_k


def matrices(rows: list[list[np.ndarray]]) -> np.ndarray:
    """Matrices, shape (..., m, k), from m rows of k arrays of their elements."""
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def project(points: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Project points of OpenCV's camera frame, shape (..., 3), [m], to pixels, shape (..., 2)."""
    bent, _, _ = distort(points[..., :2] / points[..., 2:], intrinsics)
    return intrinsics[..., 2:4] + intrinsics[..., :2] * bent


def project_jacobian(points: np.ndarray, intrinsics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points, with derivatives.

    With f = (fx, fy) and D = d(x'', y'') / d(x, y), the pixel's derivative by (X, Y) is f D / Z, and by Z it is
    -f D (x, y) / Z.

    Args:
        points: In OpenCV's camera frame, shape (..., 3), [m].
        intrinsics: In the order of ``INTRINSICS``, shape (9,), or of each point (..., 9).

    Returns:
        Pixels (..., 2), their derivatives by the point (..., 2, 3) [px/m] and by the intrinsics (..., 2, 9).
    """
    focal, middle = intrinsics[..., :2], intrinsics[..., 2:4]
    z = points[..., 2]
    xy = points[..., :2] / z[..., None]
    bent, by_xy, by_k = distort(xy, intrinsics)
    across = focal[..., None] * by_xy / z[..., None, None]
    along = -np.einsum("...ij,...j->...i", across, xy)
    by_point = np.concatenate([across, along[..., None]], axis=-1)

    unit = np.eye(2)  # fx and cx move u alone, fy and cy move v alone
    by_focal = unit * bent[..., None]
    by_middle = np.broadcast_to(unit, by_focal.shape)
    by_intrinsics = np.concatenate([by_focal, by_middle, focal[..., None] * by_k], axis=-1)
    return middle + focal * bent, by_point, by_intrinsics


def rays(pixels: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Return the undistorted x, y of pixels, shape (..., 2), by Newton's method on the distortion."""
    focal, middle = intrinsics[..., :2], intrinsics[..., 2:4]
    bent = (pixels - middle) / focal
    xy = bent.copy()
    if not np.any(intrinsics[..., 4:]):
        return xy
    for _ in range(NEWTON_STEPS):
        value, slope, _ = distort(xy, intrinsics)
        missing = (bent - value)[..., None]
        step = np.linalg.solve(slope, missing)[..., 0]
        xy += step
        if np.all(np.abs(step) < NEWTON_TOLERANCE):
            break
    return xy


def on_plane(pixels: np.ndarray, intrinsics: np.ndarray, normal: np.ndarray, distance: float) -> np.ndarray:
    """Put image points back on the plane they were seen on: (7-28), (7-29).

    Doty's (x', y', f) is -(x, y, 1) f of OpenCV, mirrored: with w = (-(u - cx), v - cy, f_px) and v = n / xi,
    p = -w / (v . w). Here w is divided by f, which leaves p as it is.

    Args:
        pixels: Shape (..., 2).
        intrinsics: In the order of ``INTRINSICS``, shape (9,).
        normal: Of the plane, towards the camera, in Doty's camera frame, shape (3,).
        distance: xi of n.p + xi = 0, from the lens to the plane, [m].

    Returns:
        Points in Doty's camera frame, shape (..., 3), [m].
    """
    x, y = np.moveaxis(rays(pixels, intrinsics), -1, 0)
    w = np.stack([-x, y, np.ones_like(x)], axis=-1)
    return -w / (w @ (normal / distance))[..., None]


def predict_pixels(
    T_camera_square: np.ndarray, points: np.ndarray, intrinsics: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predict the image points of the square's points, with derivatives.

    A twist (v, w) of the square in its own frame, T exp(twist), moves its point P by R (v + w x P) in the camera.

    Args:
        T_camera_square: Shape (..., 4, 4).
        points: In the square's frame, shape (..., M, 3), [m].
        intrinsics: In the order of ``INTRINSICS``, shape (9,).

    Returns:
        Pixels (..., M, 2), their derivatives by the twist (linear, angular) of the square in its own frame
        (..., M, 2, 6) and by the intrinsics (..., M, 2, 9).
    """
    R = T_camera_square[..., :3, :3]
    t = T_camera_square[..., None, :3, 3]
    in_camera = points @ np.swapaxes(R, -1, -2) + t
    pixels, by_point, by_intrinsics = project_jacobian(in_camera, intrinsics)
    linear = by_point @ R[..., None, :, :]
    by_twist = np.concatenate([linear, np.cross(points[..., None, :], linear)], axis=-1)  # (w x P) . l = w . (P x l)
    return pixels, by_twist, by_intrinsics


def predict_ranges(
    T_camera_square: np.ndarray, positions: np.ndarray, measures: Measures
) -> tuple[np.ndarray, np.ndarray]:
    """Predict the readings from poses of the square in OpenCV's camera frame, with derivatives.

    With the square's axes x, y, n and origin t in the camera, h = n.(s - t). A twist (v, w) of the square in its own frame,
    T exp(twist), changes it by dh = -v_z - w_x y.(s - t) + w_y x.(s - t). Along the axis, h is divided by n_z > 0, which
    changes with w as n does.

    Args:
        T_camera_square: Shape (..., 4, 4), or their upper three rows.
        positions: Sensors in Doty's camera frame, shape (S, 3), [m].
        measures: What a reading is.

    Returns:
        Readings (..., S), [m], and their derivatives (..., S, 6) by a twist (linear, angular) of the square in its own
        frame.
    """
    R = T_camera_square[..., :3, :3]
    t = T_camera_square[..., :3, 3]
    x, y, n = R[..., 0], R[..., 1], R[..., 2]
    arm = positions @ DOTY_OPENCV - t[..., None, :]  # from the square's origin to each sensor, s - t
    h = np.einsum("...si,...i->...s", arm, n)
    J = np.zeros((*h.shape, 6))
    J[..., 2] = -1.0
    J[..., 3] = -np.einsum("...si,...i->...s", arm, y)
    J[..., 4] = np.einsum("...si,...i->...s", arm, x)
    if measures == "along_axis":
        n_z = -n[..., 2, None]  # towards the camera's back: Doty's z
        share = h / n_z
        J[..., 3] += share * -y[..., 2, None]
        J[..., 4] += share * x[..., 2, None]
        return share, J / n_z[..., None]
    return h, J


def square_motion(R_world_square: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Motion in world axes of what sits at p in the square's frame, shape (n, 6, 6), when the square is seen to move.

    T_camera_square exp(v, w) moves all that is fixed to the camera by exp(-v, -w), seen from the square: its place p by
    -v - w x p = -v + [p]x w, its attitude by -w.

    Args:
        R_world_square: Shape (n, 3, 3).
        p: Place of the camera, or of what it is mounted on, in the square's frame, shape (n, 3), [m].
    """
    J = np.zeros((len(p), 6, 6))
    J[:, :3, :3] = J[:, 3:, 3:] = -R_world_square
    J[:, :3, 3:] = R_world_square @ skew(p)
    return J
