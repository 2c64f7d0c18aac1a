"""Pose of the square in the camera: fiducials and ranges in one weighted least squares on SE(3).

Doty's own two steps, the sonars' plane (7-28) and the axes on it (7-33), (7-34), only start it: they take the tilt from
the sonars alone, which the camera knows ten times better. Poses are T_camera_square in OpenCV's camera frame; their
covariance is that of a twist (linear, angular) of the square in its own frame, T_true = T exp(twist).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.special import chdtrc, chdtri

from aridcal.engine.instruments.camera import DOTY_OPENCV, on_plane, predict_pixels
from aridcal.engine.instruments.camera_sonar import Measures, predict_ranges
from aridcal.jobs.head1992.sonar import Plane

# Sigma beyond which an image point is a gross error: noise does that once in 300,000 points.
OUTLIER_SIGMAS = 5.0

# A chi-square less likely than this is no noise: the model, the lens or a sonar is wrong.
MISFIT_P = 1e-4

# With so few degrees of freedom a wrong point cannot stand out from the others: doubt earlier.
FEW_DOF, FEW_MISFIT_P = 5, 0.1

# Of Gauss-Newton; from the sonars' start it takes three or four.
MAX_STEPS = 30

# Sigma: a step that moves no residual by more, in the norm of all of them, ends the fit.
LAST_POSE_STEP = 1e-4

# A step turns by at most 1/4 rad and shifts by at most 1/4 of the distance: as far as the linear model is of use.
STEP_DIVISOR = 4.0

# Places off one line that determine a pose.
FEWEST_POINTS = 3

# Share of the pose's own uncertainty taken off a residual's covariance; all of it would leave a point that alone
# determines something with none.
LARGEST_NORMAL_COSINE = 0.999


@dataclass(frozen=True)
class Sonars:
    """The sonars of a head, and what they read.

    Attributes:
        readings: h of each, shape (S,), [m]; S = 0 for a head without sonars.
        positions: In Doty's camera frame, shape (S, 3), [m].
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


def kabsch(model: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The rigid placement T (4, 4) that brings model points (M, 3) onto points (M, 3) with the least squares.

    H = sum of points x model', means removed, = U S V'; R = U diag(1, 1, det(U V')) V' (Kabsch, Acta Cryst. A32, 1976).
    """
    model_mean, points_mean = model.mean(0), points.mean(0)
    H = (points - points_mean).T @ (model - model_mean)
    U, _, Vt = np.linalg.svd(H)
    no_mirror = np.diag([1, 1, np.linalg.det(U @ Vt)])
    T = np.eye(4)
    T[:3, :3] = U @ no_mirror @ Vt
    T[:3, 3] = points_mean - T[:3, :3] @ model_mean
    return T


def doty_axes(p2: np.ndarray, p3: np.ndarray, p5: np.ndarray, p6: np.ndarray) -> np.ndarray:
    """The square's axes from its perimeter fiducials' places in the camera, as columns, shape (3, 3): (7-33), (7-34).

    Not quite a rotation when the places are noisy, as Doty (1992) says: z is the product of two axes that are not square.
    """
    right, up = p5 - p3, p2 - p6
    x = right / np.linalg.norm(right)
    y = up / np.linalg.norm(up)
    return np.column_stack([x, y, np.cross(x, y)])


def start_on_plane(points: np.ndarray, pixels: np.ndarray, plane: Plane, intrinsics: np.ndarray) -> np.ndarray:
    """Place the square where its image points (M, 2) meet the sonars' plane: T_camera_square, (4, 4).

    Doty's procedure with all fiducials in place of four: the tilt is the sonars', the turn the camera's.
    """
    places = on_plane(pixels, intrinsics, plane.normal, plane.distance)
    T = kabsch(points, places)
    T[:3] = DOTY_OPENCV @ T[:3]
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

    Gauss-Newton on SE(3): with B the derivatives of what is predicted by the twist t and e what is measured less what is
    predicted, both divided by the noise, a step is t = (B'B)^-1 B'e and T becomes T exp(t). The covariance is (B'B)^-1, that
    of the stated noise: the bound of Cramer and Rao for a linear model with Gaussian noise.

    Args:
        points: Fiducials' centres in the square's frame, shape (M, 3), [m].
        pixels: Where they are in the image, shape (M, 2).
        covariances: Of the image points, shape (M, 2, 2), [px²].
        sonars: Ranges.
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        start: T_camera_square, shape (4, 4).

    Raises:
        ValueError: The points do not determine a pose, or no pose fits them.
    """
    whiten = np.linalg.inv(np.linalg.cholesky(covariances))
    T = start
    for _ in range(MAX_STEPS):
        predicted, J, _ = predict_pixels(T, points, intrinsics)
        predicted_h, J_h = predict_ranges(T, sonars.positions, sonars.measures)
        pixel_residuals = pixels - predicted
        range_residuals = sonars.readings - predicted_h
        whitened = np.einsum("mij,mj->mi", whiten, pixel_residuals)
        B = np.concatenate([(whiten @ J).reshape(-1, 6), J_h / sonars.std])
        e = np.concatenate([whitened.ravel(), range_residuals / sonars.std])
        information = B.T @ B
        twist = _shortened(_scaled_solve(information, B.T @ e), T[2, 3])
        T = T @ pin.exp6(twist).homogeneous
        if T[2, 3] <= 0:
            raise ValueError("the fiducials in view fit no pose in front of the camera")
        if np.linalg.norm(B @ twist) < LAST_POSE_STEP:
            break
    else:
        raise ValueError("the fit of the pose does not converge")
    covariance = _scaled_inverse(information)
    of_pixels = B[: 2 * len(points)]
    taken = np.trace(covariance @ of_pixels.T @ of_pixels)  # of six: what the image points determine of the pose
    return Pose(
        T_camera_square=T,
        covariance=covariance,
        pixel_residuals=pixel_residuals,
        range_residuals=range_residuals,
        chi2=float(np.sum(whitened**2)),
        dof=2 * len(points) - float(taken),
    )


def _scaled_solve(information: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Solve information x = gradient, metres and radians brought to one scale: ones on the diagonal, shape (6,)."""
    scale = 1 / np.sqrt(np.diag(information))
    scaled = information * np.outer(scale, scale)
    try:
        x = scale * np.linalg.solve(scaled, scale * gradient)
    except np.linalg.LinAlgError:
        raise ValueError("the fiducials in view do not determine a pose") from None
    if not np.all(np.isfinite(x)):
        raise ValueError("the fiducials in view do not determine a pose")
    return np.asarray(x)


def _scaled_inverse(information: np.ndarray) -> np.ndarray:
    """Invert the information of a pose, scaled as in ``_scaled_solve``, shape (6, 6)."""
    scale = 1 / np.sqrt(np.diag(information))
    outer = np.outer(scale, scale)
    return np.asarray(outer * np.linalg.inv(information * outer))


def _shortened(twist: np.ndarray, distance: float) -> np.ndarray:
    """Shorten a step that goes further than the linear model reaches, see ``SHORTEN``; distance from the camera in [m]."""
    shift = float(np.linalg.norm(twist[:3]) / distance)
    turn = float(np.linalg.norm(twist[3:]))
    return twist / max(1.0, STEP_DIVISOR * turn, STEP_DIVISOR * shift)


def robust_pose(
    points: np.ndarray,
    pixels: np.ndarray,
    covariances: np.ndarray,
    sonars: Sonars,
    intrinsics: np.ndarray,
    start: np.ndarray,
) -> tuple[Pose, np.ndarray]:
    """Fit the pose as ``fit_pose`` does, without the image points that stand out from the others.

    A point stands out by its own noise *and* by the misfit of the others: a lens that is not quite as declared moves all of
    them a little, and is no reason to drop any.

    Returns:
        The pose, and which points were used, shape (M,).
    """
    counting = np.ones(len(points), dtype=bool)
    T = start
    while True:
        pose = fit_pose(points[counting], pixels[counting], covariances[counting], sonars, intrinsics, T)
        T = pose.T_camera_square
        distance2 = _outlying(pose, points[counting], covariances[counting], intrinsics)
        worst = int(np.argmax(distance2))
        # Without that point chi2 falls by its distance2: what remains is the misfit of the others.
        others = (pose.chi2 - float(distance2[worst])) / max(pose.dof - 2, 1.0)
        limit = OUTLIER_SIGMAS**2 * max(1.0, others)
        if np.count_nonzero(counting) <= FEWEST_POINTS or distance2[worst] < limit:
            return pose, counting
        counting[np.flatnonzero(counting)[worst]] = False


def _outlying(pose: Pose, points: np.ndarray, covariances: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Return the squared distance of each residual r from zero in its own standard deviations, shape (M,).

    r' S^-1 r with S = covariance - J C J': a residual is smaller than its noise by what the pose was drawn to it.
    """
    _, J, _ = predict_pixels(pose.T_camera_square, points, intrinsics)
    r = pose.pixel_residuals
    drawn = LARGEST_NORMAL_COSINE * J @ pose.covariance @ np.swapaxes(J, 1, 2)
    solved = np.linalg.solve(covariances - drawn, r[..., None])[..., 0]
    return np.asarray(np.einsum("mi,mi->m", r, solved))


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
    and sonars contradict each other (a lens, a sonar or their mounting is not as declared, and one shot cannot tell which)
    what they differ by is itself taken for an error of one sigma.
    """
    pose, _ = robust_pose(points, pixels, covariances, sonars, intrinsics, start)
    covariance = pose.covariance
    unlikely = MISFIT_P if pose.dof > FEW_DOF else FEW_MISFIT_P
    if pose.dof > 0 and chdtrc(pose.dof, pose.chi2) < unlikely:
        covariance = covariance * max(1.0, pose.chi2 / pose.dof)  # dof may be next to nothing
    r = pose.range_residuals / sonars.std
    if r @ r > chdtri(max(len(r), 1), MISFIT_P):
        off = _contradiction(pose, sonars)
        covariance = covariance + np.outer(off, off)
    return replace(pose, covariance=covariance)


def _contradiction(pose: Pose, sonars: Sonars) -> np.ndarray:
    """Return the twist, shape (6,), that the ranges ask for beyond the pose: along z and in the two tilts they can see."""
    _, J = predict_ranges(pose.T_camera_square, sonars.positions, sonars.measures)
    seen = slice(2, 5)
    twist = np.zeros(6)
    twist[seen] = np.linalg.lstsq(J[:, seen], pose.range_residuals, rcond=None)[0]
    return twist
