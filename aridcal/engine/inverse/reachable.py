"""Readings that bring the target where a measurement needs it, from postures drawn at random inside the joints' limits."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.system.errors import CampaignError

Pose = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Readings of some rows, shape (n, columns), and their numbers to rotations (n, 3, 3) and positions (n, 3) of their targets."""

Miss = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Rotations and positions of the targets of some rows, and their numbers, to how far each is from where it must be, (n, k)."""

FREE_SHARE = 0.02
"""Share of each joint's range that is left free at either end: effects move the readings a little further, controllers refuse
what lies beyond a limit and slow down before it, and cables are strained there."""

MOST_STEPS, MOST_ROUNDS = 30, 60
"""Newton steps towards a place, and how often rows that have not come there start anew from other readings."""

TRIED_AT_ONCE = 8
"""Random postures of which the nearest to its place is a row's start."""

LARGEST_STEP = 0.4
"""The most that a joint moves in one step, [rad] or [m], as far as the linear model holds."""

STRETCHED_ARM_DAMPING = 1e-9
"""[m²/rad²]: keeps the step of a stretched arm finite."""

DIFFERENCE = 1e-5
"""[rad] or [m]: for differences."""

ROWS_AT_ONCE = 2048
"""Work: rows whose shifts are looked at together: of seven joints 31,000 poses, some ten MB."""

PLACE_TOLERANCE = 1e-9
"""[m]: nearer than that the arm has come."""


def limits_of(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest readings, shape (columns,) each, [rad] or [m]; +-pi where there is no limit."""
    low, high = robot.limits.T
    return np.where(np.isfinite(low), low, -math.pi), np.where(np.isfinite(high), high, math.pi)


def inner_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest readings, each a share :data:`FREE_SHARE` of its range nearer to the middle; see :func:`limits_of`."""
    low, high = limits_of(robot)
    margin = FREE_SHARE * (high - low)
    return low + margin, high - margin


def draw_readings(
    robot: Robot, n: int, rng: np.random.Generator, ends: Callable[[Robot], tuple[np.ndarray, np.ndarray]] = limits_of
) -> np.ndarray:
    """Draw readings, uniform between ends of their ranges, shape (n, columns), [rad] or [m]."""
    low, high = ends(robot)
    return np.asarray(rng.uniform(low, high, (n, len(low))))


def readings_for_poses(
    robot: Robot, pose: Pose, miss: Miss, n: int, rng: np.random.Generator, place: str, advice: str
) -> np.ndarray:
    """Readings with which every row's target is where it must be, each from a posture drawn at random, shape (n, columns).

    An arm has more joints than a touch has numbers: what is left free stays as it was drawn, so that postures differ.

    Args:
        robot: The chain.
        pose: Of the targets.
        miss: How far they are from where they must be.
        n: Rows.
        rng: Draws the postures.
        place: What to name if the arm does not come there.
        advice: What to do then.

    Raises:
        CampaignError: some rows cannot be reached.
    """
    low, high = inner_limits(robot)
    arrived = np.empty((n, len(low)))
    rows = np.arange(n)
    for _ in range(MOST_ROUNDS):
        readings = _nearest(robot, pose, miss, rows, rng)
        for _ in range(MOST_STEPS):
            step, off = _step(pose, miss, readings, rows)
            close = (off < PLACE_TOLERANCE) & ((readings >= low) & (readings <= high)).all(axis=1)
            arrived[rows[close]] = readings[close]
            rows, readings = rows[~close], np.clip((readings + step)[~close], low, high)
            if not len(rows):
                return arrived
    raise CampaignError(
        f"{place}: {len(rows)} of {n} rows cannot be measured: the arm does not reach the places that they refer to; {advice}"
    )


def _nearest(robot: Robot, pose: Pose, miss: Miss, rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """For each row that one of some random postures which misses least, shape (rows, columns)."""
    drawn = [draw_readings(robot, len(rows), rng) for _ in range(TRIED_AT_ONCE)]
    off = [np.linalg.norm(miss(*pose(readings, rows), rows), axis=1) for readings in drawn]
    return np.asarray(np.array(drawn)[np.argmin(off, axis=0), np.arange(len(rows))])


def settled(pose: Pose, miss: Miss, readings: np.ndarray, steps: int) -> np.ndarray:
    """Readings near others with which all rows' targets are where they must be, to rounding.

    Args:
        pose: Of the targets.
        miss: How far they are from where they must be.
        readings: Shape (n, columns).
        steps: Of Newton's method.
    """
    rows = np.arange(len(readings))
    for _ in range(steps):
        readings = readings + _step(pose, miss, readings, rows)[0]
    return readings


def _step(pose: Pose, miss: Miss, readings: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Newton's shortest step of some rows, shape (n, columns), and how far each still is, shape (n,)."""
    blocks = [slice(begin, begin + ROWS_AT_ONCE) for begin in range(0, max(len(rows), 1), ROWS_AT_ONCE)]
    steps, off = zip(*(_step_of_block(pose, miss, readings[block], rows[block]) for block in blocks), strict=True)
    return np.concatenate(steps), np.concatenate(off)


def _step_of_block(pose: Pose, miss: Miss, readings: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The step of a block of rows, from differences along all readings, which are looked at together."""
    count = readings.shape[1]
    shifts = DIFFERENCE * np.vstack([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    every = np.tile(rows, len(shifts))
    around = (readings + shifts[:, None]).reshape(-1, count)
    off = miss(*pose(around, every), every).reshape(len(shifts), len(rows), -1)
    e = off[0]
    J = ((off[1 : count + 1] - off[count + 1 :]) / (2 * DIFFERENCE)).transpose(1, 2, 0)
    H = J @ J.transpose(0, 2, 1) + STRETCHED_ARM_DAMPING * np.eye(e.shape[1])
    step = -np.einsum("nkj,nk->nj", J, np.linalg.solve(H, e[:, :, None])[:, :, 0])
    longest = np.abs(step).max(axis=1, keepdims=True)
    return step * np.minimum(1.0, LARGEST_STEP / np.maximum(longest, 1e-300)), np.linalg.norm(e, axis=1)
