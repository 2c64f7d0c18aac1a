"""Measured minus predicted: residuals in world axes, their weights, and the sums that least squares needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.model import Model, Rows

BLOCK = 512  # rows differentiated at a time: they stay in the cache, and memory stays flat
FLOOR = 1e-12  # [m] or [rad]: below this everything is rounding
# Median and 90th percentile of the norm of three standard normal numbers: they turn norms into a sigma per axis.
MEDIAN_NORM_3, TENTH_NORM_3 = 1.5381722544550522, 2.5002777108094164


@dataclass(frozen=True)
class Observations:
    """Measured target poses.

    Attributes:
        position: Shape (N, 3), [m], world frame.
        rotation: Shape (N, 3, 3); None where only positions were measured.
        relative: How the rows' noise differs from the common sigmas: relative sigmas of the six components in world axes
            with RMS 1, shape (N, 6), or factors L of shape (N, 6, 6) where components err together, so that the noise is
            L times independent noise of the common sigmas; None where all rows are alike.
    """

    position: np.ndarray
    rotation: np.ndarray | None
    relative: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, rows: slice | np.ndarray) -> Observations:
        return Observations(
            self.position[rows],
            None if self.rotation is None else self.rotation[rows],
            None if self.relative is None else self.relative[rows],
        )


@dataclass(frozen=True)
class Sigma:
    """Noise per axis: position [m] and rotation [rad]."""

    position: float
    rotation: float


@dataclass(frozen=True)
class Normal:
    """Sums over the rows for unit sigma: residuals (N, m) and, for positions and rotations apart, J'J and J'r."""

    residual: np.ndarray
    weight: np.ndarray
    hessian_position: np.ndarray
    hessian_rotation: np.ndarray
    gradient_position: np.ndarray
    gradient_rotation: np.ndarray

    def hessian(self, sigma: Sigma) -> np.ndarray:
        """J'WJ, shape (K, K)."""
        return self.hessian_position / sigma.position**2 + self.hessian_rotation / sigma.rotation**2

    def gradient(self, sigma: Sigma) -> np.ndarray:
        """J'Wr, shape (K,): the step is hessian^-1 gradient."""
        return self.gradient_position / sigma.position**2 + self.gradient_rotation / sigma.rotation**2


def residuals(rotation: np.ndarray, position: np.ndarray, measured: Observations) -> np.ndarray:
    """Measured minus predicted in world axes: position [m], then rotation vector [rad]; shape (N, 6) or (N, 3)."""
    r = measured.position - position
    if measured.rotation is None:
        return r
    return np.hstack([r, rotation_vector(measured.rotation @ rotation.transpose(0, 2, 1))])


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Axis times angle of rotations, shape (N, 3, 3) to (N, 3); fast where they turn by less than 90 degrees."""
    vector = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.sqrt(np.einsum("ni,ni->n", vector, vector))
    cosine = 0.5 * (R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2] - 1.0)
    vector *= (np.arctan2(sine, cosine) / np.where(sine > 0.0, sine, 1.0) + (sine == 0.0))[:, None]
    wide = cosine < 0.0
    if wide.any():
        vector[wide] = Rotation.from_matrix(R[wide], assume_valid=True).as_rotvec()
    return vector


def predict_residuals(model: Model, theta: np.ndarray, rows: Rows, measured: Observations) -> np.ndarray:
    """Residuals of a model, shape (N, 6) or (N, 3), [m] and [rad]."""
    return residuals(*model.poses(theta, rows), measured)


def scaled(r: np.ndarray, measured: Observations) -> np.ndarray:
    """Residuals or columns, shape (N, m) or (N, m, K), divided by the rows' relative sigmas."""
    if measured.relative is None:
        return r
    columns = r.reshape(*r.shape[:2], -1)
    if measured.relative.ndim == 3:
        return np.linalg.solve(measured.relative, columns).reshape(r.shape)
    return np.asarray((columns / measured.relative[:, : r.shape[1], None]).reshape(r.shape))


def unscaled(r: np.ndarray, measured: Observations) -> np.ndarray:
    """Scaled residuals, shape (N, m), back in [m] and [rad]."""
    if measured.relative is None:
        return r
    if measured.relative.ndim == 3:
        return np.asarray(np.einsum("nij,nj->ni", measured.relative, r))
    return np.asarray(r * measured.relative[:, : r.shape[1]])


def robust_sigma(r: np.ndarray) -> Sigma:
    """Sigma per axis from norms of scaled residuals, by the median and by the 90th percentile: the larger counts.

    A tenth of the rows may be wild. More than that are no outliers but a part of the robot's life that the model lacks
    (one of two sides of a backlash, say): they must not be flagged away.
    """
    values = []
    for part in (r[:, :3], r[:, 3:]):
        if part.size:
            middle, tenth = np.quantile(np.linalg.norm(part, axis=1), [0.5, 0.9])
            values.append(max(float(middle) / MEDIAN_NORM_3, float(tenth) / TENTH_NORM_3, FLOOR))
    return Sigma(values[0], values[1] if len(values) > 1 else 1.0)


def distance(r: np.ndarray, sigma: Sigma) -> np.ndarray:
    """How many sigmas per axis a row is off, position or rotation, whichever is more; shape (N,)."""
    d = np.linalg.norm(r[:, :3], axis=1) / sigma.position
    if r.shape[1] == 6:
        d = np.maximum(d, np.linalg.norm(r[:, 3:], axis=1) / sigma.rotation)
    return d


def cauchy(r: np.ndarray, sigma: Sigma) -> np.ndarray:
    """Weights that let go of far rows gradually (Cauchy's loss on the row's distance), shape (N,)."""
    return 1.0 / (1.0 + (distance(r, sigma) / 4.0) ** 2)


def normal(
    model: Model, theta: np.ndarray, rows: Rows, measured: Observations, weight: np.ndarray | None, sigma: Sigma
) -> Normal:
    """Accumulate the normal equations.

    Args:
        model: K coefficients.
        theta: Their values, shape (K,).
        rows: N configurations.
        measured: N measured poses.
        weight: Of each row, shape (N,); None: Cauchy's, at scale ``sigma``.
        sigma: See ``weight``.
    """
    count = len(theta)
    H = [np.zeros((count, count)), np.zeros((count, count))]
    g = [np.zeros(count), np.zeros(count)]
    parts, used = [], []
    for start in range(0, len(rows), BLOCK):
        block = slice(start, start + BLOCK)
        r, J = linearise(model, theta, rows[block], measured[block])
        w = cauchy(r, sigma) if weight is None else weight[block]
        root = np.sqrt(w)[:, None]
        for k in range(r.shape[1] // 3):
            part = slice(3 * k, 3 * k + 3)
            A = (J[:, part] * root[:, :, None]).reshape(3 * len(r), count)
            H[k] += A.T @ A
            g[k] += A.T @ (r[:, part] * root).ravel()
        parts.append(r)
        used.append(w)
    return Normal(np.concatenate(parts), np.concatenate(used), H[0], H[1], g[0], g[1])


def linearise(model: Model, theta: np.ndarray, rows: Rows, measured: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Scaled residuals (N, m) and what each coefficient takes off them, shape (N, m, K)."""
    R, p, J = model.jacobian(theta, rows)
    r = residuals(R, p, measured)
    J = J[:, : r.shape[1]]
    if measured.relative is not None:
        if r.shape[1] == 6:
            # log(exp(r) exp(-w)) = r - (w + r x w / 2 + ...): matters only where a row's axes weigh unequally.
            J[:, 3:] += 0.5 * np.cross(r[:, 3:, None], J[:, 3:], axis=1)
        r, J = scaled(r, measured), scaled(J, measured)
    return r, J


def triangle(
    model: Model, theta: np.ndarray, rows: Rows, measured: Observations, weight: np.ndarray, sigma: Sigma
) -> np.ndarray:
    """Upper triangle R of the whitened Jacobian's QR, shape (<= K, K): all that rank and covariance need."""
    R = np.empty((0, len(theta)))
    for start in range(0, len(rows), BLOCK):
        block = slice(start, start + BLOCK)
        r, J = linearise(model, theta, rows[block], measured[block])
        scale = np.repeat([1.0 / sigma.position, 1.0 / sigma.rotation], 3)[: r.shape[1]]
        J = J * (np.sqrt(weight[block])[:, None] * scale)[:, :, None]
        R = np.asarray(np.linalg.qr(np.vstack([R, J.reshape(r.size, len(theta))]), mode="r"))
    return R
