"""Where a simulated arm takes its shots from: readings that bring the camera in front of a calibration square."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.catalogue import declared, is_of_head
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.instruments.camera_sonar import Head
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.jobs.head1992.detections import head_things
from aridcal.jobs.head1992.head_settings import HeadSettings, range_columns
from aridcal.jobs.head1992.render import Optics, photograph
from aridcal.jobs.head1992.shot_rows import head_of
from aridcal.jobs.head1992.square import INCH
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.true_effects import PreparedEffect, values
from aridcal.system.errors import CampaignError
from aridcal.system.progress import Progress

# Wanted of a view: distance of the lens, [m]; lean of the optical axis, [rad]; where the axis meets the square, [m]
# off its middle along x and y. The square then fills a good part of a head's image, and its fiducials stay in it.
RANGE, TILT, ASIDE = (0.20, 0.40), np.radians(10.0), 1.2 * INCH

# [rad], [m] below and above: by so much a view may miss what was wanted of it.
TILT_SLACK, RANGE_SLACK = 0.04, (0.02, 0.05)

# Of the square's own fiducials in view: two of six may be cut off.
FEWEST_FIDUCIALS = 4

# Postures to start from: so many that one is near any view that can be reached.
POSTURES_IN_POOL = 4000

# Rounds in which views that failed are drawn anew; after half of them, of squares that did not fail.
VIEWPOINT_ROUNDS = 40

# Of Gauss-Newton towards a view.
APPROACH_STEPS = 25

# [rad]: the most that a joint turns in one step, as far as the linear model holds.
LARGEST_VIEW_STEP = 0.3

# [m²] of the normal equations: less than any joint that moves the camera, enough for one that does not.
VIEWPOINT_DAMPING = 1e-6

# [m]: a turn of the camera counts as a shift of this times as much, somewhat more than its distance from the
# square.
VIEW_LEVER = 0.5

# Share of each joint's range that is left free at either end.
LIMIT_MARGIN_SHARE = 0.01


def draw_views(
    model: Model, optics: Optics, intrinsics: np.ndarray, n: int, rng: np.random.Generator, place: str
) -> tuple[np.ndarray, np.ndarray]:
    """Draw shots of all squares in turn, as far as the arm can see them.

    For each a view is drawn (``_aims``), the nearest posture of a pool is brought to it (``_approach``), and what misses it, or
    has too little in view, is drawn anew.

    Args:
        model: The nominal arm between its true base and the camera.
        optics: The camera's size and the squares.
        intrinsics: Of the camera, shape (9,).
        n: Number of shots.
        rng: Of everything that is drawn.
        place: What to name if the arm sees no square.

    Returns:
        Readings (n, columns), [rad] or [m], and the index of the square that each shot looks at, (n,).

    Raises:
        CampaignError: The arm cannot look at any square.
    """
    low, high = _inner_limits(model)
    names = list(optics.squares)
    pool = _Pool.drawn(model, low, high, rng)
    readings = np.zeros((n, len(low)))
    looked_at = np.array([names[k % len(names)] for k in range(n)])
    missing = np.arange(n)
    for attempt in range(VIEWPOINT_ROUNDS):
        if attempt > VIEWPOINT_ROUNDS // 2:  # what cannot be reached is left out: another square takes its place
            reached = np.setdiff1d(np.arange(n), missing)
            if len(reached) == 0:
                raise CampaignError(f"{place}: this arm brings the camera in front of none of the squares")
            looked_at[missing] = rng.choice(looked_at[reached], len(missing))
        at, axis = _aims(optics, looked_at[missing], rng)
        q = _approach(model, pool.nearest(at, axis), low, high, at, axis)
        usable = _good_views(model, q, optics, looked_at[missing], intrinsics)
        readings[missing[usable]] = q[usable]
        missing = missing[~usable]
        if len(missing) == 0:
            return readings, looked_at
    raise CampaignError(f"{place}: this arm can hardly bring the camera in front of a square; move the squares")


def _inner_limits(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return the readings that are drawn from and to, each (columns,): inside the limits, and at most half a turn."""
    limits = model.robot.limits
    low = np.clip(limits, -np.pi, None)[:, 0]
    high = np.where(np.isfinite(limits[:, 1]), limits[:, 1], np.pi)
    inner = LIMIT_MARGIN_SHARE * (high - low)
    return low + inner, high - inner


@dataclass(frozen=True)
class _Pool:
    """Postures all over the joint range, and where they have the camera.

    Attributes:
        q: Readings, shape (P, columns).
        places: Of the camera, shape (P, 3), [m].
        axes: Directions of its optical axis, shape (P, 3).
    """

    q: np.ndarray
    places: np.ndarray
    axes: np.ndarray

    @classmethod
    def drawn(cls, model: Model, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> _Pool:
        """Draw postures evenly between limits, (columns,)."""
        q = rng.uniform(low, high, (POSTURES_IN_POOL, len(low)))
        R, p = model.poses(np.zeros(0), model.rows(q))
        return cls(q, p, R[:, :, 2])

    def nearest(self, at: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Return the posture nearest each wanted place (N, 3) and direction (N, 3), shape (N, columns)."""
        off = np.sum((self.places[None] - at[:, None]) ** 2, axis=2)
        off += VIEW_LEVER**2 * np.sum((self.axes[None] - axis[:, None]) ** 2, axis=2)
        return self.q[np.argmin(off, axis=1)]


def _good_views(model: Model, q: np.ndarray, optics: Optics, visible: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Tell which postures (N, columns) look at their square (N,) from near enough to what is wanted of a view, (N,)."""
    R, p = model.poses(np.zeros(0), model.rows(q))
    usable = []
    for turn, at, index in zip(R, p, visible, strict=True):
        T_world_square = optics.squares[int(index)]
        normal, middle = T_world_square[:3, 2], T_world_square[:3, 3]
        tilt = np.arccos(np.clip(-turn[:, 2] @ normal, -1, 1))
        distance = normal @ (at - middle)
        in_range = RANGE[0] - RANGE_SLACK[0] < distance < RANGE[1] + RANGE_SLACK[1]
        T_world_camera = np.eye(4)
        T_world_camera[:3, :3], T_world_camera[:3, 3] = turn, at
        upright = bool(tilt < TILT + TILT_SLACK) and bool(in_range)
        usable.append(upright and optics.in_view(T_world_camera, int(index), intrinsics) >= FEWEST_FIDUCIALS)
    return np.array(usable)


def _aims(optics: Optics, visible: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw wanted places of the camera (N, 3), [m], and directions of its optical axis (N, 3), for squares (N,).

    The axis leans from the square's normal by up to ``TILT``, evenly over the cone, and meets it within ``ASIDE``.
    """
    n = len(visible)
    T = np.array([optics.squares[int(k)] for k in visible])
    R, middle = T[:, :3, :3], T[:, :3, 3]
    by = TILT * np.sqrt(rng.random(n))
    towards = np.exp(2j * np.pi * rng.random(n))
    lean = by * towards
    turns = [pin.exp3(np.array([v.real, v.imag, 0.0])) for v in lean]
    axis = np.stack([turn @ [0.0, 0.0, -1.0] for turn in turns])
    aimed = np.column_stack([rng.uniform(-ASIDE, ASIDE, (n, 2)), np.zeros(n)])
    distance = rng.uniform(*RANGE, n)
    at = aimed - distance[:, None] * axis
    return np.einsum("nij,nj->ni", R, at) + middle, np.einsum("nij,nj->ni", R, axis)


def _approach(
    model: Model, q: np.ndarray, low: np.ndarray, high: np.ndarray, at: np.ndarray, axis: np.ndarray
) -> np.ndarray:
    """Bring the camera near wanted places and directions, whatever its turn about its axis: damped Gauss-Newton.

    The error is e = (at - p, LEVER z x axis), z the camera's own axis; of the rotation's Jacobian what turns about z is left
    out, A = (J_v, LEVER (I - z z') J_w); a step is (A'A + DAMPING I)^-1 A'e.

    Args:
        model: The nominal arm.
        q: Readings to start from, shape (N, columns).
        low: Limits, shape (columns,).
        high: Likewise.
        at: Wanted places, shape (N, 3), [m].
        axis: Wanted directions of the optical axis, shape (N, 3).

    Returns:
        Readings, shape (N, columns).
    """
    robot = model.robot
    moving = model.with_coefficients(()).with_motions(model.own_motions)
    turning = np.array([kind != "prismatic" for kind in robot.kinds])
    still = np.zeros(len(robot.joints))
    for _ in range(APPROACH_STEPS):
        R, p, by_joints = moving.jacobian(still, moving.rows(q))
        J = by_joints @ robot.factors
        z = R[:, :, 2]
        across = np.eye(3) - z[:, :, None] * z[:, None, :]
        e = np.concatenate([at - p, VIEW_LEVER * np.cross(z, axis)], axis=1)
        A = np.concatenate([J[:, :3], VIEW_LEVER * across @ J[:, 3:]], axis=1)
        At = A.transpose(0, 2, 1)
        H = At @ A + VIEWPOINT_DAMPING * np.eye(A.shape[2])
        step = np.linalg.solve(H, At @ e[:, :, None])[:, :, 0]
        step = np.where(turning, np.clip(step, -LARGEST_VIEW_STEP, LARGEST_VIEW_STEP), step)
        q = np.clip(q + step, low, high)
    return q


def photographs(
    T_world_camera: np.ndarray,
    square: np.ndarray,
    optics: Optics,
    head: Head,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[bytes], np.ndarray]:
    """Take one shot from each place of the camera, shape (N, 4, 4): images as JPEG, and ranges (N, S), [m]."""
    places = progress.through(zip(T_world_camera, square, strict=True), len(square), "shots")
    shots = [photograph(T, int(k), optics, head, rng) for T, k in places]
    images, ranges = zip(*shots, strict=True)
    return list(images), np.array(ranges)


def photographed(
    settings: HeadSettings,
    optics: Optics,
    real: Head,
    R: np.ndarray,
    p: np.ndarray,
    noise: np.random.Generator,
    progress: Progress,
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Shots of the measuring head: columns of ``shots.csv`` beside joints and covariates, and the images by name.

    Args:
        settings: The head as its makers state it.
        optics: The camera and the squares that it looks at.
        real: The head as it is.
        R: True rotations of the camera, shape (n, 3, 3).
        p: True positions, shape (n, 3), [m].
        noise: Draws the noise of images and sonars.
        progress: Told how many shots are taken.
    """
    T = np.broadcast_to(np.eye(4), (len(R), 4, 4)).copy()
    T[:, :3, :3], T[:, :3, 3] = R, p
    # The arm is not quite where it was sent: another square may be nearest the optical axis.
    square = np.array([optics.nearest(pose) for pose in T])
    photographs_taken, ranges = photographs(T, square, optics, real, noise, progress)
    images = {f"images/{k + 1:03d}.jpg": image for k, image in enumerate(photographs_taken)}
    columns = dict(zip(range_columns(settings), ranges.T, strict=True))
    return {"image": list(images), "square": square, **columns}, images


def true_head(
    scenario: Scenario, robot: Robot, settings: HeadSettings, rng: np.random.Generator
) -> tuple[Head, list[PreparedEffect]]:
    """The measuring head as it really is, and its effects.

    Args:
        scenario: Says which effects.
        robot: Of whose joints none may be called like a part of the head.
        settings: The head as its makers state it.
        rng: Draws the coefficients that are not given.
    """
    head, place = head_of(settings), f"{scenario.path}: truth"
    phi, causes = head.phi.copy(), []
    observed = ObservedRows(robot, {}, (), stated_components=head_things(head).held)
    for e in scenario.truth.effects:
        if is_of_head(e.kind):
            effect = declared(observed, e, place)
            theta = values(e, effect, rng, place)
            causes.append(PreparedEffect(effect, theta, {}))
            for c, value in zip(effect.coefficients, theta.tolist(), strict=True):
                phi[list(head.role.moved_by(c.where, c.component))] += value
    return replace(head, phi=phi), causes
