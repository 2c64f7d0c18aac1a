r"""Offset and drift of two clocks from the moves between standstills.

Frames come from the standstills alone (closed form). What the target misses at the two standstills that a move joins, e_0 and
e_1, is the nominal model's fault, and is taken off along the way: with s from 0 to 1 the share of the way that is done,

.. math:: m_i - x(t'_i) - (1 - s_i) e_0 - s_i e_1 = \dot x(t'_i) \, \delta + \text{noise}

gives each move a \delta of its own by least squares, and a robust line through these gives offset and drift: Gauss and Newton's
method, for the next round begins with the better clocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from aridcal.engine.fit.frame_starts import PoseRows, start_frames
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.jobs.merge.clocks import Clocks
from aridcal.jobs.merge.log import Log
from aridcal.jobs.merge.pairs import Pairs, window_samples
from aridcal.system.errors import MeasurementError

MOST_SAMPLES_PER_MOVE = 60
"""Samples of a move that are used at most: more tell no more, since what the model misses is common to neighbours."""

LONGEST_MOVE = 60.0
"""Moves between standstills further apart are left out, [s]: something else went on there."""

ALIGNMENT_TUKEY = 4.685
"""Tukey's biweight with this has 95 % efficiency for Gaussian noise."""

LEAST_SLOPE = 0.3
"""Mean slope of the biweight's psi at least: for Gaussian noise it is 0.8, with half of the moves wild 0.4."""

LARGEST_CLOCK_STEP = 0.5
"""A round moves clocks by no more, [s]: what is linear about a move ends there."""

WILD_RATIO = 4.0
"""Times the usual distance from the nominal robot beyond which a standstill does not count for the frames: a wrong pair, or a
target that was moved, would draw them to itself and so hide."""

MOST_TRIMS = 10
"""Rounds of this at most."""

LEAST_SPEED_SHARE = 0.05
"""Share of the usual sum of squared speeds below which a move tells nothing: it is a fifth as fast."""

FEWEST_MOVES = 3
"""Moves without which offset, drift and scatter are not told."""

JUMP_SIGMAS = 6.0
"""Sigmas by which the moves after a time are late, compared with those before, if a clock jumped."""

LEAST_JUMP = 0.02
"""Jumps that are smaller are within what is dropped at both ends of a standstill, [s]."""


@dataclass(frozen=True)
class TrackerAlignment:
    """The robot and its target as the tracker sees them, nominal: x = R_w (p + R l) + t_w."""

    turn: np.ndarray
    shift: np.ndarray
    lever: np.ndarray

    def target(self, robot: Robot, q: np.ndarray) -> np.ndarray:
        """Where the target is for readings of shape (N, columns), shape (N, 3), [m]."""
        R, p = tip_frames(robot, q)
        return np.asarray((p + R @ self.lever) @ self.turn.T + self.shift)


@dataclass(frozen=True)
class Moves:
    """What each of K moves says of the clocks.

    Attributes:
        time: Of its middle, by the tracker's clock, shape (K,), [s].
        late: By how much the joints' clock is behind at it, after the fit, shape (K,), [s].
        weight: In the fit, from 0 to 1.
    """

    time: np.ndarray
    late: np.ndarray
    weight: np.ndarray


def align_frames(robot: Robot, q: np.ndarray, m: np.ndarray) -> tuple[TrackerAlignment, np.ndarray]:
    """Frames that bring the nominal robot's targets to the measured ones.

    Args:
        robot: The chain.
        q: Readings at K standstills, shape (K, columns), [rad] or [m].
        m: Measured there, shape (K, 3), [m].

    Returns:
        The frames, of the standstills that are near, and measured minus nominal at all, shape (K, 3).
    """
    nearby = np.ones(len(m), dtype=bool)
    for _ in range(MOST_TRIMS):
        frames = _best_frames(robot, q[nearby], m[nearby])
        residual = m - frames.target(robot, q)
        size = np.linalg.norm(residual, axis=1)
        near = size <= WILD_RATIO * np.median(size)
        if np.array_equal(near, nearby):
            break
        nearby = near
    return frames, residual


def _best_frames(robot: Robot, q: np.ndarray, m: np.ndarray) -> TrackerAlignment:
    """Frames in closed form: of several starts the one that leaves least."""
    R, p = tip_frames(robot, q)
    one_frame = np.zeros(len(m), dtype=int)
    candidates = [
        TrackerAlignment(start.world_base[0].rotation, start.world_base[0].translation, start.tip_target[0].translation)
        for start in start_frames(PoseRows(R, p, None, m, one_frame, one_frame), None, None, (pin.SE3.Identity(),))
    ]
    return min(candidates, key=lambda frames: float(np.median(np.linalg.norm(m - frames.target(robot, q), axis=1))))


def window_means(log: Log, values: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Means over windows of a log's own clock, shape (K, C); between samples where a window has none."""
    return np.array(
        [
            values[rows].mean(axis=0) if rows.stop > rows.start else values[min(rows.start, len(values) - 1)]
            for rows in (window_samples(log.time, a, b) for a, b in zip(begin, end, strict=True))
        ]
    )


def improved(
    clocks: Clocks, robot: Robot, joints: Log, q: np.ndarray, tracker: Log, m: np.ndarray, standstills: Pairs
) -> tuple[Clocks, Moves]:
    """Clocks after one round of alignment, and what the moves say of them.

    Args:
        clocks: So far.
        robot: The chain.
        joints: The joints' log, N samples.
        q: Its readings, shape (N, columns), [rad] or [m].
        tracker: The tracker's log, M samples.
        m: The target's places, shape (M, 3), [m].
        standstills: K standstills of both.

    Raises:
        MeasurementError: too few moves tell anything.
    """
    begin, end = clocks.joints(standstills.begin), clocks.joints(standstills.end)
    frames, residual = align_frames(
        robot, window_means(joints, q, begin, end), window_means(tracker, m, standstills.begin, standstills.end)
    )
    rows, share, move = _samples(tracker, standstills)
    step = max(joints.period, 1e-3)
    joint_time = clocks.joints(tracker.time[rows])
    inside = (joint_time > joints.time[0] + step) & (joint_time < joints.time[-1] - step)
    rows, share, move, joint_time = rows[inside], share[inside], move[inside], joint_time[inside]
    readings = [
        np.column_stack([np.interp(joint_time + d, joints.time, column) for column in q.T]) for d in (-step, 0.0, step)
    ]
    x = [frames.target(robot, one) for one in readings]
    speed = (x[2] - x[0]) / (2 * step)
    share = _way_share(speed, share, move, len(standstills))
    deviation = m[rows] - x[1] - (1 - share)[:, None] * residual[move] - share[:, None] * residual[move + 1]
    numerator = np.bincount(move, np.einsum("ni,ni->n", speed, deviation), minlength=len(standstills))
    denominator = np.bincount(move, np.einsum("ni,ni->n", speed, speed), minlength=len(standstills))
    count = np.bincount(move, minlength=len(standstills))
    telling = (count >= 3) & (denominator > 0)
    if telling.any():
        telling &= denominator > LEAST_SPEED_SHARE * np.median(denominator[telling])
    if np.count_nonzero(telling) < FEWEST_MOVES:
        raise MeasurementError(
            f"{tracker.title}: only {np.count_nonzero(telling)} moves between paired standstills have three samples or more; "
            f"{FEWEST_MOVES} are the least. Log faster, or move more slowly"
        )
    delta = numerator[telling] / denominator[telling]
    time = (0.5 * (standstills.end[:-1] + standstills.begin[1:]))[telling[:-1]]
    line, covariance, weight = _line(time - clocks.middle, delta)
    change = np.clip(line, -LARGEST_CLOCK_STEP, LARGEST_CLOCK_STEP)
    better = Clocks(clocks.offset + change[0], clocks.drift + change[1], clocks.middle, covariance)
    return better, Moves(time, delta - line[0] - line[1] * (time - clocks.middle), weight)


def _samples(tracker: Log, standstills: Pairs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples between standstills, :data:`MOST_SAMPLES_PER_MOVE` a move: indices, share of its time, and index of the move."""
    rows, share, move = [], [], []
    for k in range(len(standstills) - 1):
        between = window_samples(tracker.time, standstills.end[k], standstills.begin[k + 1])
        lasts = standstills.begin[k + 1] - standstills.end[k]
        count = between.stop - between.start
        if count > 0 and lasts < LONGEST_MOVE:
            picked = between.start + np.unique(np.linspace(0, count - 1, min(count, MOST_SAMPLES_PER_MOVE)).astype(int))
            rows.append(picked)
            share.append((tracker.time[picked] - standstills.end[k]) / lasts)
            move.append(np.full(len(picked), k))
    if not rows:
        return np.empty(0, dtype=int), np.empty(0), np.empty(0, dtype=int)
    return np.concatenate(rows), np.concatenate(share), np.concatenate(move)


def _way_share(speed: np.ndarray, share: np.ndarray, move: np.ndarray, count: int) -> np.ndarray:
    """Share of each move's way that lies behind its samples, by the nominal speed at them; shape (N,)."""
    if not len(move):
        return share
    size = np.linalg.norm(speed, axis=1)
    first = np.r_[True, np.diff(move) > 0]
    lasts = np.r_[0.0, np.diff(share)]
    path = np.where(first, 0.0, 0.5 * (size + np.r_[0.0, size[:-1]]) * lasts)
    way = np.cumsum(path)
    start = way[first][np.cumsum(first) - 1]
    path_length = np.bincount(move, path, minlength=count)[move]
    return np.asarray(np.where(path_length > 0, (way - start) / np.where(path_length > 0, path_length, 1.0), share))


def _line(time: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A robust line by Tukey's biweight, from the median on: intercept and slope, their covariance, and the weights."""
    design = np.column_stack([np.ones(len(time)), time])
    line = np.array([np.median(delta), 0.0])
    weight = np.ones(len(time))
    few_moves = np.sqrt(len(time) / max(len(time) - 2, 1))  # two numbers are fitted: what is left is smaller by so much
    for _ in range(30):
        residual = delta - design @ line
        scale = max(1.4826 * few_moves * float(np.median(np.abs(residual))), 1e-9)
        u = np.clip(residual / (ALIGNMENT_TUKEY * scale), -1.0, 1.0)
        weight = (1.0 - u * u) ** 2
        normal = design.T @ (weight[:, None] * design)
        line = np.linalg.solve(normal + np.diag([1e-12, 1e-12]), design.T @ (weight * delta))
    # of an M-estimate (Huber 1981, section 7.6): mean square of psi over the squared mean of its slope
    residual = delta - design @ line
    u = np.clip(residual / (ALIGNMENT_TUKEY * scale), -1.0, 1.0)
    slope = max(float(np.mean((1 - u**2) * (1 - 5 * u**2))), LEAST_SLOPE)
    variance = float(np.sum((weight * residual) ** 2)) / max(len(time) - 2, 1) / slope**2
    return line, variance * np.linalg.inv(design.T @ design), weight


def jump(moves: Moves) -> tuple[float, float] | None:
    """Time and size of a clock's jump, [s]; None where no step is significant.

    A step is fitted beside the line, before each move in turn; the one that leaves least counts, if it is far from zero.
    """
    n = len(moves.late)
    if n < 8:
        return None
    late = np.clip(moves.late, *np.quantile(moves.late, [0.02, 0.98]))
    time = (moves.time - moves.time.mean()) / np.ptp(moves.time)
    best: tuple[float, int, float, float] | None = None
    for k in range(3, n - 2):
        design = np.column_stack([np.ones(n), time, np.arange(n) >= k])
        inverse = np.linalg.inv(design.T @ design)
        solution = inverse @ (design.T @ late)
        residual = late - design @ solution
        if best is None or residual @ residual < best[0]:
            noise = max(1.4826 * float(np.median(np.abs(residual))) * np.sqrt(n / (n - 3)), 1e-9)
            best = float(residual @ residual), k, float(solution[2]), float(noise * np.sqrt(inverse[2, 2]))
    assert best is not None
    _, k, step, sigma = best
    if abs(step) < JUMP_SIGMAS * sigma or abs(step) < LEAST_JUMP:
        return None
    return float(moves.time[k]), step
