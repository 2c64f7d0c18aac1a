"""Pose of the square in the camera: fiducials and ranges in one weighted least squares on SE(3).

The report's own two steps, the sonars' plane (7-28) and the axes on it (7-33), (7-34), only start it: they take the tilt from
the sonars alone, which the camera knows ten times better. Poses are T_camera_square in OpenCV's camera frame; their
covariance is that of a twist (linear, angular) of the square in its own frame, T_true = T exp(twist).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.stats import chi2

from aridcal.head.camera import REPORT_OPENCV, on_plane, project_jacobian
from aridcal.head.sonar import Measures, Plane, predict_ranges

STANDS_OUT = 5.0  # sigma
MISFIT_P = 1e-4  # a chi-square less likely than this is no noise: the model, the lens or a sonar is wrong
FEW_DOF, FEW_MISFIT_P = 5, 0.1  # with so few, a wrong point cannot stand out: doubt earlier


@dataclass(frozen=True)
class Sonars:
    """The sonars of a head, and what they read.

    Attributes:
        readings: h of each, shape (S,), [m]; S = 0 for a head without sonars.
        positions: In the report's camera frame, shape (S, 3), [m].
        measures: What a reading is.
        std: Standard deviation of a reading, [m].
    """

    readings: np.ndarray
    positions: np.ndarray
    measures: Measures
    std: float


NO_SONARS = Sonars(np.zeros(0), np.zeros((0, 3)), "perpendicular", 1.0)


@dataclass(frozen=True)
class Pose:
    """A measured pose of the square in OpenCV's camera frame.

    Attributes:
        T_camera_square: Shape (4, 4).
        covariance: Of the twist (linear, angular) in the square's frame, shape (6, 6), [m, rad].
        pixel_residuals: Image point minus model, shape (M, 2), [px].
        range_residuals: Reading minus model, shape (S,), [m].
        chi2: Of the image points, after whitening.
        dof: Its degrees of freedom: two per point, less the share of the pose that they determine.
    """

    T_camera_square: np.ndarray
    covariance: np.ndarray
    pixel_residuals: np.ndarray
    range_residuals: np.ndarray
    chi2: float
    dof: float


def kabsch(model: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Find the rigid placement T that brings model points (M, 3) onto seen ones (M, 3) with the least squares, (4, 4)."""
    U, _, Vt = np.linalg.svd((seen - seen.mean(0)).T @ (model - model.mean(0)))
    T = np.eye(4)
    T[:3, :3] = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    T[:3, 3] = seen.mean(0) - T[:3, :3] @ model.mean(0)
    return T


def report_axes(p2: np.ndarray, p3: np.ndarray, p5: np.ndarray, p6: np.ndarray) -> np.ndarray:
    """The square's axes from its perimeter fiducials' places in the camera, as columns, shape (3, 3): (7-33), (7-34).

    Not quite a rotation when the places are noisy, as the report says: z is the product of two axes that are not square.
    """
    x, y = (p5 - p3) / np.linalg.norm(p5 - p3), (p2 - p6) / np.linalg.norm(p2 - p6)
    return np.column_stack([x, y, np.cross(x, y)])


def start_on_plane(points: np.ndarray, pixels: np.ndarray, plane: Plane, intrinsics: np.ndarray) -> np.ndarray:
    """Place the square where its image points (M, 2) meet the sonars' plane: T_camera_square, (4, 4).

    The report's procedure with all fiducials in place of four: the tilt is the sonars', the turn the camera's.
    """
    T = kabsch(points, on_plane(pixels, intrinsics, plane.normal, plane.distance))
    T[:3] = REPORT_OPENCV @ T[:3]
    return T


def fit_pose(
    points: np.ndarray,
    pixels: np.ndarray,
    covariances: np.ndarray,
    sonars: Sonars,
    intrinsics: np.ndarray,
    start: np.ndarray,
) -> Pose:
    """Fit the pose to image points and ranges, each weighted by its own noise.

    Args:
        points: Fiducials' centres in the square's frame, shape (M, 3), [m].
        pixels: Where they are in the image, shape (M, 2).
        covariances: Of the image points, shape (M, 2, 2), [px²].
        sonars: Ranges.
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        start: T_camera_square, shape (4, 4).

    Returns:
        The pose, its covariance that of the stated noise.

    Raises:
        ValueError: The points do not determine a pose, or no pose fits them.
    """
    whiten = np.linalg.inv(np.linalg.cholesky(covariances))
    T = start
    for _ in range(30):
        predicted, J, _ = predict_pixels(T, points, intrinsics)
        predicted_h, J_h = predict_ranges(T, sonars.positions, sonars.measures)
        r, h = pixels - predicted, sonars.readings - predicted_h
        rows = np.concatenate([(whiten @ J).reshape(-1, 6), J_h / sonars.std])
        errors = np.concatenate([np.einsum("mij,mj->mi", whiten, r).ravel(), h / sonars.std])
        information = rows.T @ rows
        scale = 1 / np.sqrt(np.diag(information))
        try:
            twist = scale * np.linalg.solve(information * np.outer(scale, scale), scale * (rows.T @ errors))
        except np.linalg.LinAlgError:
            raise ValueError("the fiducials in view do not determine a pose") from None
        if not np.all(np.isfinite(twist)):
            raise ValueError("the fiducials in view do not determine a pose")
        twist /= max(1.0, 4 * float(np.linalg.norm(twist[3:])), 4 * float(np.linalg.norm(twist[:3]) / T[2, 3]))
        T = T @ pin.exp6(twist).homogeneous
        if T[2, 3] <= 0:
            raise ValueError("the fiducials in view fit no pose in front of the camera")
        if np.linalg.norm(rows @ twist) < 1e-4:  # of one sigma
            break
    else:
        raise ValueError("the fit of the pose does not converge")
    covariance = np.outer(scale, scale) * np.linalg.inv(information * np.outer(scale, scale))
    seen = rows[: 2 * len(points)]
    return Pose(
        T_camera_square=T,
        covariance=covariance,
        pixel_residuals=r,
        range_residuals=h,
        chi2=float(np.sum(np.einsum("mij,mj->mi", whiten, r) ** 2)),
        dof=2 * len(points) - float(np.trace(covariance @ seen.T @ seen)),
    )


def robust_pose(
    points: np.ndarray,
    pixels: np.ndarray,
    covariances: np.ndarray,
    sonars: Sonars,
    intrinsics: np.ndarray,
    start: np.ndarray,
) -> tuple[Pose, np.ndarray]:
    """Fit the pose as ``fit_pose`` does, without the image points that stand out from the others.

    Returns:
        The pose, and which points were used, shape (M,).

    A point stands out by its own noise *and* by the misfit of the others: a lens that is not quite as declared moves all of
    them a little, and is no reason to drop any.
    """
    used = np.ones(len(points), dtype=bool)
    T = start
    while True:
        pose = fit_pose(points[used], pixels[used], covariances[used], sonars, intrinsics, T)
        T = pose.T_camera_square
        _, J, _ = predict_pixels(T, points[used], intrinsics)
        spread = covariances[used] - 0.999 * J @ pose.covariance @ np.swapaxes(J, 1, 2)
        distance2 = np.einsum(
            "mi,mi->m", pose.pixel_residuals, np.linalg.solve(spread, pose.pixel_residuals[..., None])[..., 0]
        )
        worst = int(np.argmax(distance2))
        # Without that point chi2 falls by its distance2: what remains is the misfit of the others.
        common = max(1.0, (pose.chi2 - float(distance2[worst])) / max(pose.dof - 2, 1.0))
        if np.count_nonzero(used) <= 3 or distance2[worst] < STANDS_OUT**2 * common:
            return pose, used
        used[np.flatnonzero(used)[worst]] = False


def measure_pose(
    points: np.ndarray,
    pixels: np.ndarray,
    covariances: np.ndarray,
    sonars: Sonars,
    intrinsics: np.ndarray,
    start: np.ndarray,
) -> Pose:
    """Measure the pose as ``robust_pose`` does, with a covariance that owns up to a misfit.

    Where the image points do not fit together by more than their noise, the covariance grows by their chi-square. Where camera
    and sonars contradict each other (a lens, a sonar or their mounting is not as declared, and one shot can not tell which)
    what they differ by is itself taken for an error of one sigma.
    """
    pose, _ = robust_pose(points, pixels, covariances, sonars, intrinsics, start)
    covariance = pose.covariance
    unlikely = MISFIT_P if pose.dof > FEW_DOF else FEW_MISFIT_P
    if pose.dof > 0 and chi2.sf(pose.chi2, pose.dof) < unlikely:
        covariance = covariance * max(1.0, pose.chi2 / pose.dof)  # dof may be next to nothing
    r = pose.range_residuals / sonars.std
    if r @ r > chi2.isf(MISFIT_P, max(len(r), 1)):
        _, J = predict_ranges(pose.T_camera_square, sonars.positions, sonars.measures)
        off = np.zeros(6)
        off[2:5] = np.linalg.lstsq(J[:, 2:5], pose.range_residuals, rcond=None)[0]
        covariance = covariance + np.outer(off, off)
    return replace(pose, covariance=covariance)


def predict_pixels(
    T_camera_square: np.ndarray, points: np.ndarray, intrinsics: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predict the image points of the square's points, with derivatives.

    Args:
        T_camera_square: Shape (..., 4, 4).
        points: In the square's frame, shape (..., M, 3), [m].
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).

    Returns:
        Pixels (..., M, 2), their derivatives by the twist (linear, angular) of the square in its own frame
        (..., M, 2, 6) and by the intrinsics (..., M, 2, 9).
    """
    R = T_camera_square[..., :3, :3]
    seen = points @ np.swapaxes(R, -1, -2) + T_camera_square[..., None, :3, 3]
    pixels, by_point, by_intrinsics = project_jacobian(seen, intrinsics)
    by_twist = np.empty((*pixels.shape, 6))
    by_twist[..., :3] = by_point @ R[..., None, :, :]
    for k in range(3):  # omega x P
        i, j = (k + 1) % 3, (k + 2) % 3
        by_twist[..., 3 + k] = points[..., i, None] * by_twist[..., j] - points[..., j, None] * by_twist[..., i]
    return pixels, by_twist, by_intrinsics
