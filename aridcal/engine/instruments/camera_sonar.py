r"""A shot of a measuring head: image points of a square and ranges to it, as a pose of the camera and what they say beyond it.

A shot has more image points and ranges than a pose has coordinates. With B their derivatives by the square's twist t and D
those by the head's numbers :math:`\varphi`, all divided by the noise, and y what is measured less what is predicted,

.. math:: y = B\,t + D\,d\varphi + noise

falls into two parts that share no noise: the pose :math:`C B^T (y - D\,d\varphi)`, :math:`C = (B^T B)^{-1}`, and what is
left of y off the columns of B, which knows nothing of the arm. Of that as much is kept as tells of the numbers: with

.. math:: [B\; D] = [Q\; U] \begin{pmatrix} R_{11} & R_{12} \\ 0 & R_{22} \end{pmatrix}

for the head as declared, the trace :math:`z = U^T y` has noise of one, and the derivative
:math:`-U^T (1 - B C B^T) D` by the numbers (variable projection; Golub and Pereyra 1973). A row measures the pose and the
trace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.engine.instruments.camera import INTRINSICS, Measures, predict_pixels, predict_ranges, square_motion
from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION, Channel
from aridcal.engine.instruments.kind import MeasurementKind, ResidualDerivatives, Role, States
from aridcal.engine.instruments.pose import residuals, turned_back

CAMERA, SONAR, ALL_SONARS = "camera", "sonar", "sonars"
"""Places of corrections of a head: its camera, and what all its sonars have alike; single ones are ``sonar_1`` and so on."""

FAULTS_OF_A_SONAR = ("bias", "scale")
"""What may be wrong with a sonar: what it adds [m], and the share by which it reads too much."""

POSE_SIZE = 6
"""Coordinates of a pose."""

LOWER = [0, 1, 1], [0, 0, 1]
"""Rows and columns of the lower triangle of a 2 x 2 matrix."""

POSE_STEPS, ROUNDING_STEP = 20, 1e-12
"""Gauss-Newton steps of a shot's pose at the most, four are usual; and [m] and [rad] of one that is rounding."""

STEP_FRACTION = 4.0
"""A step turns by at most 1/4 rad and shifts by at most 1/4 of the distance: as far as the linear model is of use."""


@dataclass(frozen=True)
class Head:
    """The camera and the sonars of a head, by their numbers.

    Attributes:
        phi: ``INTRINSICS``, then what each sonar adds [m], then by which share it reads too much, shape (9 + 2 S,).
        positions: Sensors in Doty's camera frame, shape (S, 3), [m].
        measures: What a reading is.
        std: Of a reading, [m].
    """

    phi: np.ndarray
    positions: np.ndarray
    measures: Measures
    std: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers: ``camera.fx`` ... ``sonar_1.bias`` ... ``sonar_1.scale`` ..."""
        count = range(1, len(self.positions) + 1)
        sonars = [f"{SONAR}_{k}.{what}" for what in FAULTS_OF_A_SONAR for k in count]
        return (*(f"{CAMERA}.{name}" for name in INTRINSICS), *sonars)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the numbers."""
        lens = ["px" if name[0] in "fc" else "1" for name in INTRINSICS]
        return (*lens, *(len(self.positions) * ["m"]), *(len(self.positions) * ["1"]))

    @property
    def intrinsics(self) -> np.ndarray:
        """Numbers of the camera, shape (9,)."""
        return self.phi[: len(INTRINSICS)]

    @property
    def bias(self) -> np.ndarray:
        """What each sonar adds, shape (S,), [m]."""
        return self.phi[len(INTRINSICS) :][: len(self.positions)]

    @property
    def scale(self) -> np.ndarray:
        """By which share each sonar reads too much, shape (S,)."""
        return self.phi[len(INTRINSICS) + len(self.positions) :]

    @property
    def state(self) -> np.ndarray:
        """All of it as the state of a thing: ``phi`` first, shape (11 + 5 S,)."""
        along = float(self.measures == "along_axis")
        return np.concatenate([self.phi, self.positions.ravel(), [along, self.std]])

    @classmethod
    def of_state(cls, state: np.ndarray) -> Head:
        """The head that has a state, shape (11 + 5 S,)."""
        count = (len(state) - len(INTRINSICS) - 2) // 5
        phi, positions = np.split(state[:-2], [len(INTRINSICS) + 2 * count])
        return cls(phi, positions.reshape(-1, 3), "along_axis" if state[-2] else "perpendicular", float(state[-1]))

    @property
    def role(self) -> Role:
        """What rows refer to: the head's numbers, by the places where corrections of them act."""
        places: dict[str, tuple[str, ...]] = {name: (name,) for name in self.names}
        places[f"{CAMERA}.f"] = (f"{CAMERA}.fx", f"{CAMERA}.fy")
        if len(self.positions):
            every = range(1, len(self.positions) + 1)
            places |= {
                f"{ALL_SONARS}.{what}": tuple(f"{SONAR}_{k}.{what}" for k in every) for what in FAULTS_OF_A_SONAR
            }
        return Role(HEAD, self.names, self.units, len(self.state), _moved, None, (), many=False, places=places)


def _moved(state: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The state of heads, (n, P), with their numbers changed, (n, H)."""
    wide = np.zeros_like(state)
    wide[:, : change.shape[1]] = change
    return state + wide


HEAD = "head"
"""Name of the role, and of the only thing of it."""


@dataclass(frozen=True)
class HeadShot:
    """What a head read in one shot.

    Attributes:
        points: Fiducials in the frame of the square, shape (M, 3), [m].
        pixels: Their images, shape (M, 2).
        covariances: Of those, shape (M, 2, 2), [px²].
        ranges: As the sonars read them, shape (S,), [m].
        T_world_square: Shape (4, 4).
        T_camera_square: Where a fit of the pose may start, shape (4, 4).
    """

    points: np.ndarray
    pixels: np.ndarray
    covariances: np.ndarray
    ranges: np.ndarray
    T_world_square: np.ndarray
    T_camera_square: np.ndarray


@dataclass(frozen=True)
class Shots:
    """What n shots read, unpacked from rows.

    Attributes:
        T_world_square: Upper three rows, shape (n, 3, 4).
        start: A first T_camera_square, likewise.
        ranges: As the sonars read them, shape (n, S), [m].
        points: On the square, shape (n, M, 3), [m]; where a shot has fewer, its origin.
        pixels: Shape (n, M, 2).
        whiten: What divides them by their noise, shape (n, M, 2, 2); zero where a shot has fewer.
        count: Numbers that each shot has read, shape (n,).
        basis: U, shape (n, S + 2 M, 9 + S): ranges first. Bias and scale of a sonar are one within a shot.
    """

    T_world_square: np.ndarray
    start: np.ndarray
    ranges: np.ndarray
    points: np.ndarray
    pixels: np.ndarray
    whiten: np.ndarray
    count: np.ndarray
    basis: np.ndarray


def _row_type(sonars: int, points: int) -> np.dtype:
    """Fields of a row: S sonars, and up to so many image points. All are floats, so that a row is an array of numbers, too.

    Of an image point ``whiten`` is the lower triangle that divides by its noise; all of it is NaN beyond those that a shot has.
    """
    mark = [("point", float, (3,)), ("pixel", float, (2,)), ("whiten", float, (3,))]
    return np.dtype(
        [
            ("T_world_square", float, (3, 4)),
            ("start", float, (3, 4)),
            ("count", float),
            ("ranges", float, (sonars,)),
            ("marks", mark, (points,)),
            ("basis", float, (sonars + 2 * points, len(INTRINSICS) + sonars)),
        ]
    )


def _width(sonars: int, points: int) -> int:
    """Numbers of a row."""
    return _row_type(sonars, points).itemsize // np.dtype(float).itemsize


def _count_of(observed: np.ndarray) -> np.ndarray:
    """How many numbers each shot has read, shape (n,), from rows of numbers: its place does not depend on sonars and points."""
    fields = _row_type(0, 0).fields
    assert fields is not None
    return np.asarray(observed[:, fields["count"][1] // np.dtype(float).itemsize])


def packed(shots: Sequence[HeadShot], head: Head) -> np.ndarray:
    """What n shots of a head read, as declared, as rows of numbers, shape (n, W): see :func:`unpacked`."""
    sonars, trace = len(head.positions), len(INTRINSICS) + len(head.positions)
    enough = -(-(POSE_SIZE + trace - sonars) // 2)  # for a basis of pose and trace
    rows = np.zeros(len(shots), _row_type(sonars, max(enough, *(len(shot.points) for shot in shots))))
    rows["T_world_square"] = [shot.T_world_square[:3] for shot in shots]
    rows["start"] = [shot.T_camera_square[:3] for shot in shots]
    rows["count"] = [sonars + 2 * len(shot.points) for shot in shots]
    rows["ranges"] = [shot.ranges for shot in shots]
    for marks, shot in zip(rows["marks"], shots, strict=True):
        for name, values in (("point", shot.points), ("pixel", shot.pixels), ("whiten", _whitening(shot.covariances))):
            marks[name] = np.nan
            marks[name][: len(values)] = values
    rows["basis"] = _trace_basis(_shots(rows), head)
    return rows.view(float).reshape(len(rows), -1)


def _whitening(covariances: np.ndarray) -> np.ndarray:
    """What divides image points by their noise, covariances of shape (M, 2, 2), as lower triangles, shape (M, 3)."""
    rows, columns = LOWER
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariances))[:, rows, columns])


def _trace_basis(shots: Shots, head: Head) -> np.ndarray:
    """U of each shot, shape (n, S + 2 M, 9 + S), for the head as declared."""
    _, _, B, D = _at_best(shots, head)
    trace = len(INTRINSICS) + len(head.positions)  # bias and scale of a sonar are one within a shot
    Q, R = np.linalg.qr(np.concatenate([B, D[:, :, :trace]], axis=2))
    sign = np.where(np.diagonal(R, axis1=1, axis2=2) < 0.0, -1.0, 1.0)  # a trace means the same in all shots
    return np.asarray((Q * sign[:, None])[:, :, POSE_SIZE:])


def unpacked(observed: np.ndarray, sonars: int) -> Shots:
    """Rows of numbers as shots: two poses and how many numbers a shot has, ranges, image points, and the basis of its trace."""
    empty, one = (_width(sonars, points) for points in (0, 1))
    points = (observed.shape[1] - empty) // (one - empty)
    return _shots(np.ascontiguousarray(observed).view(_row_type(sonars, points))[:, 0])


def _shots(rows: np.ndarray) -> Shots:
    """Shots from rows by their fields, shape (n,); image points that a shot does not have are zero."""
    marks = rows["marks"]
    there = ~np.isnan(marks["point"][..., :1])
    point, pixel, lower = (np.where(there, marks[name], 0.0) for name in ("point", "pixel", "whiten"))
    whiten = np.zeros((*marks.shape, 2, 2))
    whiten[..., LOWER[0], LOWER[1]] = lower
    return Shots(
        T_world_square=rows["T_world_square"],
        start=rows["start"],
        ranges=rows["ranges"],
        points=point,
        pixels=pixel,
        whiten=whiten,
        count=rows["count"],
        basis=rows["basis"],
    )


@dataclass(frozen=True)
class ShotPoses:
    """n shots as poses, and what they say of the head beyond them.

    Attributes:
        rotation: Of the camera in the world, shape (n, 3, 3).
        position: Shape (n, 3), [m].
        covariance: Of position [m] and rotation vector [rad] in world axes, shape (n, 6, 6).
        sensitivity: Twist (linear, angular) of the camera in world axes per unit of each of the head's numbers, (n, 6, H).
        trace: z, shape (n, 9 + S); 0 beyond what a shot has, as :func:`missing_numbers` says, so that sums over a row have no
            holes.
        slope: What a change of the head's numbers takes off it, shape (n, 9 + S, H).
        misfit: Chi-square of what a shot has beyond its pose, shape (n,).
        freedom: Its degrees of freedom, shape (n,).
        range_residuals: What each sonar reads beyond the pose, shape (n, S), [m].
    """

    rotation: np.ndarray
    position: np.ndarray
    covariance: np.ndarray
    sensitivity: np.ndarray
    trace: np.ndarray
    slope: np.ndarray
    misfit: np.ndarray
    freedom: np.ndarray
    range_residuals: np.ndarray


def reduced(shots: Shots, head: Head) -> ShotPoses:
    """Shots as poses and traces, with the head as it is."""
    T, y, B, D = _at_best(shots, head)
    back, S = B.transpose(0, 2, 1), shots.ranges.shape[1]
    C = _inverse(back @ B)
    twist_by_phi = -C @ (back @ D)
    trace = np.einsum("nij,ni->nj", shots.basis, y)
    freedom = shots.count - POSE_SIZE
    trace[missing_numbers(freedom, trace.shape[1])] = 0.0
    Rc = T[:, :, :3].transpose(0, 2, 1)
    p = -np.einsum("nij,nj->ni", Rc, T[:, :, 3])
    world = shots.T_world_square
    J = square_motion(world[:, :, :3], p)
    return ShotPoses(
        rotation=world[:, :, :3] @ Rc,
        position=np.einsum("nij,nj->ni", world[:, :, :3], p) + world[:, :, 3],
        covariance=J @ C @ J.transpose(0, 2, 1),
        sensitivity=J @ twist_by_phi,
        trace=trace,
        slope=shots.basis.transpose(0, 2, 1) @ (D + B @ twist_by_phi),
        misfit=np.einsum("ni,ni->n", y, y),
        freedom=freedom,
        range_residuals=y[:, :S] * head.std,
    )


def _at_best(shots: Shots, head: Head) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Shots at the poses where their image points and ranges fit best.

    Returns:
        Upper rows of T_camera_square (n, 3, 4), y (n, L), B (n, L, 6) and D (n, L, H) there.
    """
    T = _posed(shots, head)
    y, B, by_pixels, h = _whitened(T, shots, head)
    n, S = shots.ranges.shape
    D = np.zeros((n, y.shape[1], len(head.phi)))
    # A reading is (1 + scale) h + bias; divided by 1 + scale, to keep its noise as stated.
    stretch, sonar = (1.0 + head.scale) * head.std, np.arange(S)
    D[:, sonar, len(INTRINSICS) + sonar] = 1.0 / stretch
    D[:, sonar, len(INTRINSICS) + S + sonar] = h / stretch
    D[:, S:, : len(INTRINSICS)] = by_pixels
    return T, y, B, D


def missing_numbers(freedom: np.ndarray, size: int) -> np.ndarray:
    """Which numbers of a trace shots do not have, shape (n, size), from their freedoms beyond their poses, shape (n,)."""
    return np.asarray(np.arange(size) >= freedom[:, None])


def _missing(observed: np.ndarray, m: int) -> np.ndarray:
    """Which of m numbers a row does not measure, shape (n, m)."""
    missing = np.zeros((len(observed), m), dtype=bool)
    missing[:, POSE_SIZE:] = missing_numbers(_count_of(observed) - POSE_SIZE, m - POSE_SIZE)
    return missing


def _posed(shots: Shots, head: Head) -> np.ndarray:
    """Upper rows of T_camera_square where image points and ranges fit best, shape (n, 3, 4): Gauss-Newton on SE(3)."""
    from scipy.spatial.transform import Rotation  # slow to load, and a campaign is read without it

    T = shots.start.copy()
    for _ in range(POSE_STEPS):
        y, B, _, _ = _whitened(T, shots, head)
        back = B.transpose(0, 2, 1)
        step = np.einsum("nij,nj->ni", _inverse(back @ B), np.einsum("nij,nj->ni", back, y))
        far = np.maximum(np.linalg.norm(step[:, :3], axis=1) / T[:, 2, 3], np.linalg.norm(step[:, 3:], axis=1))
        step /= np.maximum(1.0, STEP_FRACTION * far)[:, None]
        T[:, :, 3] += np.einsum("nij,nj->ni", T[:, :, :3], step[:, :3])
        T[:, :, :3] = T[:, :, :3] @ Rotation.from_rotvec(step[:, 3:]).as_matrix()
        if np.abs(step).max(initial=0.0) < ROUNDING_STEP:
            break
    return T


def _whitened(T: np.ndarray, shots: Shots, head: Head) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Measured minus predicted, over the noise: ranges, with scale and bias undone, then image points.

    Returns:
        y (n, L) with L = S + 2 M; its prediction's derivatives by the square's twist (n, L, 6) and, of the image points, by
        the intrinsics (n, 2 M, 9), likewise over the noise; predicted ranges (n, S), [m].
    """
    n = len(T)
    h, h_by_twist = predict_ranges(T, head.positions, head.measures)
    of_ranges = (shots.ranges - head.bias) / (1.0 + head.scale) - h
    pixels, by_twist, by_lens = predict_pixels(T, shots.points, head.intrinsics)
    of_pixels = np.einsum("nmij,nmj->nmi", shots.whiten, shots.pixels - pixels)
    y = np.concatenate([of_ranges / head.std, of_pixels.reshape(n, -1)], axis=1)
    B = np.concatenate([h_by_twist / head.std, (shots.whiten @ by_twist).reshape(n, -1, POSE_SIZE)], axis=1)
    return y, B, (shots.whiten @ by_lens).reshape(n, -1, len(INTRINSICS)), h


def _inverse(information: np.ndarray) -> np.ndarray:
    """Inverses of informations of poses, metres and radians brought to one scale, shape (n, 6, 6)."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), POSE_RIDGE))
    outer = scale[:, :, None] * scale[:, None, :]
    return np.asarray(outer * np.linalg.inv(information * outer + POSE_RIDGE * np.eye(POSE_SIZE)))


POSE_RIDGE = 1e-14
"""A number that is nothing beside the ones on a scaled diagonal: a pose that a shot does not tell is left where it is."""


def _residual(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> np.ndarray:
    """Measured minus predicted pose of the camera [m, rad], and the trace."""
    reduction = _of_rows(observed, states)
    return np.hstack([residuals(R, p, reduction.position, reduction.rotation), reduction.trace])


def _derivatives(R: np.ndarray, p: np.ndarray, observed: np.ndarray, states: States) -> ResidualDerivatives:
    """The residual with its derivatives; the head's numbers move what is measured, a prediction the other way."""
    reduction = _of_rows(observed, states)
    r = residuals(R, p, reduction.position, reduction.rotation)
    n, count = reduction.trace.shape
    by_twist = np.zeros((n, POSE_SIZE + count, POSE_SIZE))
    by_twist[:, :3, :3] = np.eye(3)
    by_twist[:, 3:POSE_SIZE, 3:] = turned_back(r[:, 3:])
    by_head = np.concatenate([-reduction.sensitivity, reduction.slope], axis=1)
    by_head[:, 3:POSE_SIZE] = turned_back(-r[:, 3:]) @ by_head[:, 3:POSE_SIZE]
    return ResidualDerivatives(np.hstack([r, reduction.trace]), by_twist, (by_head,))


def _noise(observed: np.ndarray, states: States) -> np.ndarray:
    """Covariance of the pose, [m, rad]; it shares nothing with the trace."""
    return _of_rows(observed, states).covariance


def _placed(observed: np.ndarray, states: States) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the camera, the head being as declared."""
    if not len(observed):
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    reduction = _of_rows(observed, states)
    return reduction.position, reduction.rotation


def _of_rows(observed: np.ndarray, states: States) -> ShotPoses:
    """Rows of one head, reduced."""
    head = Head.of_state(states[0][0])
    return reduced(unpacked(observed, len(head.positions)), head)


def channels(head: Head) -> tuple[Channel, ...]:
    """What a row of a head measures: the camera's pose, and beyond it its trace."""
    axes = tuple(f"z{k + 1}" for k in range(len(INTRINSICS) + len(head.positions)))
    return (
        TARGET_POSITION,
        TARGET_ROTATION,
        Channel("within_shot", "1", axes, "sigma", 1.0, "misfit within shots", inner=True),
    )


CAMERA_SONAR = MeasurementKind(
    name="camera_sonar",
    words="image points of squares, and ranges to them",
    channels=(TARGET_POSITION, TARGET_ROTATION),
    read=(),
    roles=(Role(HEAD, (), (), 0, _moved, None, (), many=False),),
    residual=_residual,
    derivatives=_derivatives,
    located=None,
    turns=True,
    placed=_placed,
    missing=_missing,
    noise=_noise,
)
"""A head's numbers and channels depend on its sonars: see :attr:`Head.role` and :func:`channels`."""
