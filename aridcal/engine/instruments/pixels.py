"""A marker's pixels in the image of a camera on the arm or beside it: printed boards, tags, lights."""

from __future__ import annotations

import numpy as np

from aridcal.engine.instruments.camera import INTRINSICS, distort, matrices, project, project_jacobian, rays
from aridcal.engine.instruments.channels import PIXEL
from aridcal.engine.instruments.kind import MeasurementKind, ResidualDerivatives, Role, States, added

PLACE_COMPONENTS = ("x", "y", "z", "roll", "pitch", "yaw")
PLACE_UNITS = ("m", "m", "m", "rad", "rad", "rad")

# Parts of a camera's state; a board's is its first twelve numbers.
T, R9, LENS, ON_TIP = slice(0, 3), slice(3, 12), slice(12, 21), 21

LEAST_DEPTH = 1e-6
"""[m]: what is nearer to the image plane than this is not in front of the camera."""

UNSEEN_RESIDUAL = 1e4
"""[px]: residual of what the model puts behind the camera, and which cannot be seen there: further off than any image is wide,
wherever it moves, so that no step of a fit crosses the lens."""

NEAREST, FARTHEST = 0.1, 3.0
"""[m] from the camera: markers nearer or farther are not sharp."""

LEAST_COSINE = 0.35
"""Cosine of the angle between a board's normal and the ray to the camera below which its print is not read: 70 degrees."""

BORDER = 5.0
"""[px] along the edges in which no marker is read: noise must not push it out."""

LEAST_PARALLAX = 1e-3
"""[rad]: rays from which a marker's place is told meet at larger angles than this, some pixels."""

MOST_LENS_MISFIT = 1e-6
"""Undistorted points whose distorted ones are further than this from what was seen: the lens model does not reach there."""


def rotation_of(state: np.ndarray) -> np.ndarray:
    """Rotations of cameras or boards, shape (n, 3, 3), in their states."""
    return state[:, R9].reshape(-1, 3, 3)


def turns(angles: np.ndarray) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll), as URDF's rpy: shape (n, 3), [rad], to (n, 3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles).T, np.sin(angles).T
    return matrices(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _place_moved(state: np.ndarray, change: np.ndarray) -> np.ndarray:
    """T C(x, y, z, roll, pitch, yaw): in its own axes, as the frames of the arm; other numbers of the state stay."""
    R, new = rotation_of(state), state.copy()
    new[:, T] += _times(R, change[:, :3])
    new[:, R9] = (R @ turns(change[:, 3:6])).reshape(-1, 9)
    return new


def _place_slope(state: np.ndarray, change: np.ndarray) -> np.ndarray:
    """C' for the translations; for the angles the axes about which they turn, as the moved frame sees them."""
    C = turns(change[:, 3:6])
    slope = np.zeros((len(state), 6, 6))
    slope[:, :3, :3] = np.swapaxes(C, 1, 2)
    (cr, cp, _), (sr, sp, _) = np.cos(change[:, 3:6]).T, np.sin(change[:, 3:6]).T
    slope[:, 3, 3] = 1.0
    slope[:, 4, 4], slope[:, 5, 4] = cr, -sr  # Rx' y
    slope[:, 3, 5], slope[:, 4, 5], slope[:, 5, 5] = -sp, sr * cp, cr * cp  # Rx' Ry' z
    return slope


def _camera_moved(state: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The place as a frame, intrinsics by addition."""
    new = _place_moved(state, change)
    new[:, LENS] += change[:, 6:]
    return new


def _camera_slope(state: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The slope of the place; intrinsics follow as they are."""
    slope = np.zeros((len(state), 15, 15))
    slope[:, :6, :6] = _place_slope(state, change)
    slope[:, 6:, 6:] = np.eye(9)
    return slope


CAMERA = Role(
    name="camera",
    components=(*PLACE_COMPONENTS, *INTRINSICS),
    units=(*PLACE_UNITS, "px", "px", "px", "px", "1", "1", "1", "1", "1"),
    size=22,
    moved=_camera_moved,
    slope=_camera_slope,
    identified=PLACE_COMPONENTS,
    many=False,
)
BOARD = Role("board", PLACE_COMPONENTS, PLACE_UNITS, 12, _place_moved, _place_slope, PLACE_COMPONENTS, many=False)
MARKER = Role("marker", ("x", "y", "z"), ("m", "m", "m"), 3, added, None, ("x", "y", "z"), many=True)


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Products row by row, (n, 3, 3) and (n, 3) to (n, 3)."""
    return np.einsum("nij,nj->ni", matrices, vectors)


def in_camera(R: np.ndarray, p: np.ndarray, states: States) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where the camera has the marker, and how that follows the marker's place on what carries the board.

    With the marker at Y on the board's carrier, the camera's carrier has it at R' (Y - p) if that is the tip, and at p + R Y
    if it is the world.

    Returns:
        X in the camera (n, 3), [m]; dX / dY (n, 3, 3); Y (n, 3), [m]; True where the camera is on the tip (n,).
    """
    camera, board, marker = states
    on_tip = camera[:, ON_TIP] > 0.5
    Y = board[:, T] + _times(rotation_of(board), marker)
    carried = np.where(on_tip[:, None, None], np.swapaxes(R, 1, 2), R)
    Z = np.where(on_tip[:, None], _times(carried, Y - p), _times(carried, Y) + p)
    back = np.swapaxes(rotation_of(camera), 1, 2)
    return _times(back, Z - camera[:, T]), back @ carried, Y, on_tip


def ends_of_sight(R: np.ndarray, p: np.ndarray, states: States) -> tuple[np.ndarray, np.ndarray]:
    """Where cameras and markers are in the world, (n, 3) each, [m].

    Args:
        R: Of the tip, shape (n, 3, 3).
        p: Likewise, shape (n, 3), [m].
        states: Of cameras, boards and markers.
    """
    camera, board, marker = states
    on_tip = (camera[:, ON_TIP] > 0.5)[:, None]
    eye, Y = camera[:, T], board[:, T] + _times(rotation_of(board), marker)
    return np.where(on_tip, p + _times(R, eye), eye), np.where(on_tip, Y, p + _times(R, Y))


def _in_front(X: np.ndarray, near: float = LEAST_DEPTH, far: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    """Which points lie in front of the camera, between two distances, (n,); and all points, others put on the axis instead."""
    front = (X[:, 2] > near) & (X[:, 2] < far)
    return front, np.where(front[:, None], X, [0.0, 0.0, 1.0])


def _residual(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """Measured minus predicted pixels."""
    X, _, _, _ = in_camera(R, p, states)
    front, points = _in_front(X)
    return np.where(front[:, None], observed - project(points, states[0][:, LENS]), UNSEEN_RESIDUAL)


def _derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    """The residual with its derivatives; a row behind the camera has none."""
    camera, board, marker = states
    X, carried, Y, on_tip = in_camera(R, p, states)
    front, points = _in_front(X)
    pixels, by_X, by_lens = project_jacobian(points, camera[:, LENS])
    by_X, by_lens = by_X * front[:, None, None], by_lens * front[:, None, None]
    by_Y = by_X @ carried
    by_marker = by_Y @ rotation_of(board)
    # a body twist (v, w) of the camera moves X by -v - w x X; one of the board moves the marker by v + w x m
    by_camera = np.concatenate([-by_X, np.cross(by_X, X[:, None]), by_lens], axis=2)
    by_board = np.concatenate([by_marker, np.cross(marker[:, None], by_marker)], axis=2)
    return ResidualDerivatives(
        np.where(front[:, None], observed - pixels, UNSEEN_RESIDUAL),
        _by_twist(R, p, by_Y, by_X, states, Y, on_tip),
        (by_camera, by_board, by_marker),
    )


def _by_twist(
    R: np.ndarray, p: np.ndarray, by_Y: np.ndarray, by_X: np.ndarray, states: States, Y: np.ndarray, on_tip: np.ndarray
) -> np.ndarray:
    """Derivatives by a twist (v, w) of the tip in world axes, shape (n, 2, 6).

    What the tip carries moves by v + w x RY in the world; what stands in the world moves by -(v + w x (Y - p)) for the tip.
    """
    in_world = by_X @ np.swapaxes(rotation_of(states[0]), 1, 2)
    tip = on_tip[:, None, None]
    linear = np.where(tip, -by_Y, in_world)
    lever = np.where(tip[:, :, 0], Y - p, _times(R, Y))
    return np.concatenate([linear, np.cross(lever[:, None], linear)], axis=2)


def in_image(R: np.ndarray, p: np.ndarray, states: States, size: np.ndarray) -> np.ndarray:
    """Which markers would be read from poses of the tip: sharp, and inside the image, shape (n,) bool.

    Args:
        R: Shape (n, 3, 3).
        p: Shape (n, 3), [m].
        states: Of cameras, boards and markers, (n, P) each.
        size: Width and height of the images, shape (2,), [px].
    """
    X, _, _, _ = in_camera(R, p, states)
    front, X = _in_front(X, NEAREST, FARTHEST)
    lens, plain = states[0][:, LENS], states[0][:, LENS].copy()
    plain[:, 4:] = 0.0
    pixel, unbent = project(X, lens), project(X, plain)
    inside = ((pixel > BORDER) & (pixel < size - 1 - BORDER)).all(axis=1)
    # beyond its border a lens model may fold the world back into the image
    inside &= (np.abs(unbent - size / 2) < 0.75 * size).all(axis=1)
    return np.asarray(front & inside)


def faces(R: np.ndarray, p: np.ndarray, camera: np.ndarray, board: np.ndarray) -> np.ndarray:
    """True of poses of the tip in which the camera is before the board's printed side, shape (n,).

    Args:
        R: Shape (n, 3, 3).
        p: Shape (n, 3), [m].
        camera: States, shape (n, P).
        board: States, shape (n, P).
    """
    on_axis = np.array([[0.0, 0.0, 1.0]])
    ends = [in_camera(R, p, (camera, board, np.repeat(at, len(p), axis=0)))[0] for at in (0 * on_axis, on_axis)]
    normal = ends[1] - ends[0]
    return np.asarray(-np.sum(normal * ends[0], axis=1) > LEAST_COSINE * np.linalg.norm(ends[0], axis=1))


def normalised(pixels: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Undistorted x, y of pixels, (n, 2) by lenses (n, 9); NaN where the lens model does not reach."""
    with np.errstate(all="ignore"):
        xy = rays(pixels, intrinsics)
        bent = distort(xy, intrinsics)[0]
        off = np.abs(bent - (pixels - intrinsics[:, 2:4]) / intrinsics[:, :2])
    return np.where((off < MOST_LENS_MISFIT).all(axis=1, keepdims=True), xy, np.nan)


def across_rays(xy: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """How far off its ray a matrix's product is: rows 1 - x row 3 and 2 - y row 3, (n, 2) and (n, 3, k) to (n, 2, k)."""
    return np.asarray(matrices[:, :2] - xy[:, :, None] * matrices[:, 2:])


def _located(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """Linear triangulation in the board's frame (Hartley and Zisserman 2004, section 12.2), each row then weighed by its depth.

    NaN for fewer than two rays, for rays that are nearly parallel, and where they meet behind the camera.
    """
    camera, board, _ = states
    unknown = np.full(3, np.nan)
    if len(p) < 2:
        return unknown
    xy = normalised(observed, camera[:, LENS])
    some = np.isfinite(xy).all(axis=1)
    if some.sum() < 2:
        return unknown
    at_origin = (camera[some], board[some], np.zeros((int(some.sum()), 3)))
    b, carried, _, _ = in_camera(R[some], p[some], at_origin)
    A = across_rays(xy[some], carried @ rotation_of(board[some]))
    right = -across_rays(xy[some], b[:, :, None])[:, :, 0]
    if not (np.isfinite(A).all() and np.isfinite(right).all()):
        return unknown
    weight = np.ones(len(A))
    for _ in range(2):
        U, singular, Vt = np.linalg.svd((A * weight[:, None, None]).reshape(-1, 3), full_matrices=False)
        if singular[-1] < LEAST_PARALLAX * singular[0]:
            return unknown
        place = Vt.T @ ((U.T @ (right * weight[:, None]).ravel()) / singular)
        depth = b[:, 2] + (carried @ rotation_of(board[some]))[:, 2] @ place
        if not (depth > LEAST_DEPTH).all():
            return unknown
        weight = depth.min() / depth
    return place


PIXELS = MeasurementKind(
    name="pixels",
    words="a marker's place in an image",
    channels=(PIXEL,),
    read=("u", "v"),
    roles=(CAMERA, BOARD, MARKER),
    residual=_residual,
    derivatives=_derivatives,
    located=_located,
    bare=True,
    turns=True,
    images=True,
)
