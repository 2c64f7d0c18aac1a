"""Where a simulated arm takes its shots from: readings that bring the camera in front of a calibration square."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from aridcal.effects import Basis, Coefficient
from aridcal.errors import CampaignError
from aridcal.head.photograph import Optics, photograph
from aridcal.head.reduction import Head
from aridcal.head.square import INCH
from aridcal.model import Model
from aridcal.quality import joint_limits

RANGE, TILT, ASIDE = (0.20, 0.40), np.radians(10.0), 1.2 * INCH  # [m] from the lens; [rad]; [m] off the square's middle
POOL, STEPS, TRIES = 4000, 25, 40
TURN = 0.3  # [rad]: the most that a joint turns in one step
LEVER = 0.5  # [m]: a turn of the camera counts as a shift of this times as much
FEWEST = 4  # of the square's own fiducials in view


def draw_views(
    model: Model, optics: Optics, intrinsics: np.ndarray, n: int, rng: np.random.Generator, place: str
) -> tuple[np.ndarray, np.ndarray]:
    """Draw shots of all squares in turn, as far as the arm can see them.

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
    robot = model.robot
    limits = joint_limits(robot)
    low, high = np.clip(limits, -np.pi, None)[:, 0], np.where(np.isfinite(limits[:, 1]), limits[:, 1], np.pi)
    inner = 0.01 * (high - low)
    low, high = low + inner, high - inner
    names = list(optics.squares)
    pool = rng.uniform(low, high, (POOL, len(low)))
    R_pool, p_pool = model.poses(np.zeros(0), model.rows(pool))
    readings, seen = np.zeros((n, len(low))), np.array([names[k % len(names)] for k in range(n)])
    todo = np.arange(n)
    for attempt in range(TRIES):
        if attempt > TRIES // 2:  # what cannot be reached is left out: another square takes its place
            done = np.setdiff1d(np.arange(n), todo)
            if len(done) == 0:
                raise CampaignError(f"{place}: this arm brings the camera in front of none of the squares")
            seen[todo] = rng.choice(seen[done], len(todo))
        place_wanted, axis_wanted = _aims(optics, seen[todo], rng)
        near = np.sum((p_pool[None] - place_wanted[:, None]) ** 2, axis=2)
        near += LEVER**2 * np.sum((R_pool[None, :, :, 2] - axis_wanted[:, None]) ** 2, axis=2)
        q = _approach(model, pool[np.argmin(near, axis=1)], low, high, place_wanted, axis_wanted)
        R, p = model.poses(np.zeros(0), model.rows(q))
        good = []
        for k, (turn, at) in enumerate(zip(R, p, strict=True)):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = turn, at
            square = optics.squares[int(seen[todo[k]])]
            tilt = np.arccos(np.clip(-turn[:, 2] @ square[:3, 2], -1, 1))
            distance = square[:3, 2] @ (at - square[:3, 3])
            near_enough = tilt < TILT + 0.04 and RANGE[0] - 0.02 < distance < RANGE[1] + 0.05
            good.append(near_enough and optics.in_view(T, int(seen[todo[k]]), intrinsics) >= FEWEST)
        readings[todo[good]] = q[good]
        todo = todo[~np.array(good)]
        if len(todo) == 0:
            break
    else:
        raise CampaignError(f"{place}: this arm can hardly bring the camera in front of a square; move the squares")
    return readings, seen


def _aims(optics: Optics, seen: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Wanted places of the camera (N, 3), [m], and directions of its optical axis (N, 3)."""
    T = np.array([optics.squares[int(k)] for k in seen])
    n = len(T)
    lean = TILT * np.sqrt(rng.random(n)) * np.exp(2j * np.pi * rng.random(n))
    axis = np.stack([pin.exp3(np.array([v.real, v.imag, 0.0])) @ [0.0, 0.0, -1.0] for v in lean])
    aimed = np.column_stack([rng.uniform(-ASIDE, ASIDE, (n, 2)), np.zeros(n)])
    at = aimed - rng.uniform(*RANGE, n)[:, None] * axis
    return np.einsum("nij,nj->ni", T[:, :3, :3], at) + T[:, :3, 3], np.einsum("nij,nj->ni", T[:, :3, :3], axis)


def _approach(
    model: Model, q: np.ndarray, low: np.ndarray, high: np.ndarray, at: np.ndarray, axis: np.ndarray
) -> np.ndarray:
    """Bring the camera near wanted places and directions, whatever its turn about its axis: damped Gauss-Newton."""
    robot = model.robot
    ones = Basis("ones", (robot.names[0],))
    moving = model.with_coefficients([Coefficient(j.name, "axis", ones) for j in robot.joints])
    columns = [robot.readings.index(j.reading) for j in robot.joints]
    still = np.zeros(len(columns))
    for _ in range(STEPS):
        R, p, J = moving.jacobian(still, moving.rows(q))
        own = R[:, :, 2]
        across = np.eye(3) - own[:, :, None] * own[:, None, :]
        e = np.concatenate([at - p, LEVER * np.cross(own, axis)], axis=1)
        A = np.concatenate([J[:, :3], LEVER * across @ J[:, 3:]], axis=1)
        H = A.transpose(0, 2, 1) @ A + 1e-6 * np.eye(A.shape[2])
        step = np.linalg.solve(H, A.transpose(0, 2, 1) @ e[:, :, None])[:, :, 0]
        turns = np.array([j.kind == "revolute" for j in robot.joints])
        step = np.where(turns, np.clip(step, -TURN, TURN), step)
        for k, column in enumerate(columns):
            q[:, column] += step[:, k]
        q = np.clip(q, low, high)
    return q


def photographs(
    T_world_camera: np.ndarray, square: np.ndarray, optics: Optics, head: Head, rng: np.random.Generator
) -> tuple[list[bytes], np.ndarray]:
    """Take one shot from each place of the camera, shape (N, 4, 4): images as JPEG, and ranges (N, S), [m]."""
    shots = [photograph(T, int(k), optics, head, rng) for T, k in zip(T_world_camera, square, strict=True)]
    return [image for image, _ in shots], np.array([ranges for _, ranges in shots])
