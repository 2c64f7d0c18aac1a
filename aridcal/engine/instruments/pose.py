"""The target's pose or position in the world, as a tracker, a measuring arm or a camera system gives it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.instruments.kind import MeasurementKind, ResidualDerivatives, Role, States, added, points_twist

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

ANGLE_SERIES_BELOW = 1e-2
"""[rad]: below this a quotient that tends to 0/0 is taken from its series, whose next term is 2e-13."""


def residuals(
    rotation: np.ndarray, position: np.ndarray, measured_position: np.ndarray, measured_rotation: np.ndarray | None
) -> np.ndarray:
    """Measured minus predicted in world axes.

    Args:
        rotation: Predicted, shape (N, 3, 3).
        position: Predicted, shape (N, 3), [m].
        measured_position: Shape (N, 3), [m].
        measured_rotation: Shape (N, 3, 3), or None.

    Returns:
        Position [m], then rotation vector [rad], shape (N, 6); positions alone, shape (N, 3), where no rotation was
        measured.
    """
    r = measured_position - position
    if measured_rotation is None:
        return r
    return np.hstack([r, rotation_vector(measured_rotation @ rotation.transpose(0, 2, 1))])


def turned(values: np.ndarray, euler: str | None = None) -> Rotation:
    """Rotations of quaternions (N, 4), of Euler angles in an order of axes, or of rotation vectors, shape (N, 3), [rad]."""
    from scipy.spatial.transform import Rotation  # slow to load, and a campaign is read without it

    if values.shape[1] == 4:
        return Rotation.from_quat(values)
    return Rotation.from_euler(euler, values) if euler else Rotation.from_rotvec(values)


def rotation_vector(R: np.ndarray) -> np.ndarray:
    r"""Axis times angle of rotations, shape (N, 3, 3) to (N, 3); fast where they turn by less than 90 degrees.

    .. math:: \theta a = \frac{\theta}{\sin\theta} \cdot \frac{1}{2} (R - R^T)^\vee, \qquad \cos\theta = (\mathrm{tr} R - 1) / 2
    """
    vector = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.sqrt(np.einsum("ni,ni->n", vector, vector))
    cosine = 0.5 * (R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    per_sine = angle / np.where(sine > 0.0, sine, 1.0) + (sine == 0.0)
    vector *= per_sine[:, None]
    wide = cosine < 0.0
    if wide.any():
        from scipy.spatial.transform import Rotation  # as above

        vector[wide] = Rotation.from_matrix(R[wide], assume_valid=True).as_rotvec()
    return vector


def turned_back(vector: np.ndarray) -> np.ndarray:
    r"""How the vector of a rotation changes as another turns in front of it: log(exp(r) exp(w)) = r + J w, to first order.

    .. math:: J = 1 + \tfrac12 [r] + \left( \frac{1}{\theta^2} - \frac{1 + \cos\theta}{2 \theta \sin\theta} \right) [r]^2

    (the inverse of SO(3)'s right Jacobian; Chirikjian 2011, Stochastic Models, Information Theory, and Lie Groups, 10.86).

    Args:
        vector: r, shape (n, 3), [rad], shorter than pi.

    Returns:
        Shape (n, 3, 3).
    """
    angle = np.linalg.norm(vector, axis=1)
    square = angle**2
    safe = np.where(angle < ANGLE_SERIES_BELOW, 1.0, angle)
    # (1 + cos) / sin is 1 / tan(angle / 2), also where both vanish
    exact = (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    factor = np.where(angle < ANGLE_SERIES_BELOW, 1.0 / 12.0 + square / 720.0, exact)
    x = skew(vector)
    return np.eye(3) + 0.5 * x + factor[:, None, None] * (x @ x)


def nearest_rotation(H: np.ndarray) -> np.ndarray:
    """Rotations R that maximise tr(R' H), shape (..., 3, 3) (Kabsch 1976; Umeyama 1991)."""
    U, _, Vt = np.linalg.svd(H)
    sign = np.ones((*H.shape[:-2], 1, 3))
    sign[..., 0, 2] = np.linalg.det(U @ Vt)
    return np.asarray((U * sign) @ Vt)


def skew(vectors: np.ndarray) -> np.ndarray:
    """Matrices that multiply like cross products, shape (n, 3) to (n, 3, 3)."""
    matrices = np.zeros((len(vectors), 3, 3))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        matrices[:, j, i] = vectors[:, k]
        matrices[:, i, j] = -vectors[:, k]
    return matrices


TRACKER = Role(
    name="tracker",
    components=("scale", "square"),
    units=("1", "1/m"),
    size=2,
    moved=added,
    slope=None,
    identified=(),
    many=False,
)
"""What measures positions from the world's origin: one for each block, named after it, without faults as far as is known."""


def tracker_positions(p: np.ndarray, tracker: np.ndarray) -> np.ndarray:
    """Positions that a tracker shows for places p: p (1 + s + k |p|), its scale off by s, its ranges by k |p|^2; (n, 3)."""
    away = np.linalg.norm(p, axis=1)
    return np.asarray(p * (1.0 + tracker[:, 0] + tracker[:, 1] * away)[:, None])


def _shown_derivatives(p: np.ndarray, tracker: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How what a tracker shows changes with the place, shape (n, 3, 3), and with the tracker, (n, 3, 2)."""
    away = np.linalg.norm(p, axis=1)
    stretch = 1.0 + tracker[:, 0] + tracker[:, 1] * away
    along = p[:, :, None] * p[:, None, :] / np.where(away > 0.0, away, 1.0)[:, None, None]
    by_place = stretch[:, None, None] * np.eye(3) + tracker[:, 1, None, None] * along
    return by_place, np.stack([p, away[:, None] * p], axis=2)


def _position(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """Measured minus predicted position, [m]."""
    (tracker,) = states
    return residuals(R, tracker_positions(p, tracker), observed, None)


def _position_derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    """The residual of positions with its derivatives."""
    by_place, by_tracker = _shown_derivatives(p, states[0])
    return ResidualDerivatives(_position(R, p, observed, states), points_twist(by_place), (by_tracker,))


def _pose(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """Measured minus predicted position [m] and rotation vector [rad]."""
    (tracker,) = states
    return residuals(R, tracker_positions(p, tracker), observed[:, :3], observed[:, 3:].reshape(-1, 3, 3))


def _pose_derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    """The residual of poses with its derivatives."""
    residual = _pose(R, p, observed, states)
    by_place, by_tracker = _shown_derivatives(p, states[0])
    by_twist = np.zeros((len(p), 6, 6))
    by_twist[:, :3, :3] = by_place
    by_twist[:, 3:, 3:] = turned_back(residual[:, 3:])
    return ResidualDerivatives(residual, by_twist, (np.concatenate([by_tracker, np.zeros_like(by_tracker)], axis=1),))


def pose_numbers(position: np.ndarray, rotation: np.ndarray | None) -> np.ndarray:
    """Numbers of rows of positions (N, 3), and of rotations (N, 3, 3) if there are any: shape (N, 3 or 12)."""
    return position if rotation is None else np.hstack([position, rotation.reshape(-1, 9)])


def _placed(observed: np.ndarray, states: States) -> tuple[np.ndarray, np.ndarray | None]:
    """Positions and rotations as they were read."""
    return observed[:, :3], observed[:, 3:].reshape(-1, 3, 3) if observed.shape[1] > 3 else None


XYZ = ("x", "y", "z")
"""Columns of a position; those of a rotation matrix follow row by row."""

POSITION = MeasurementKind(
    "position",
    "the target's position",
    (TARGET_POSITION,),
    XYZ,
    (TRACKER,),
    _position,
    _position_derivatives,
    None,
    placed=_placed,
)

POSE = MeasurementKind(
    name="pose",
    words="the target's position and orientation",
    channels=(TARGET_POSITION, TARGET_ROTATION),
    read=(*XYZ, "r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"),
    roles=(TRACKER,),
    residual=_pose,
    derivatives=_pose_derivatives,
    located=None,
    turns=True,
    placed=_placed,
)


def kind_of_places(rotation: np.ndarray | None) -> MeasurementKind:
    """The kind of rows that a tracker gives positions of, and rotations (N, 3, 3) if there are any."""
    return POSITION if rotation is None else POSE
