"""Two logs of one simulated motion, with a clock each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import tip_frames


@dataclass(frozen=True)
class Made:
    """Logs and their truth: joints' time = tracker's time + offset + drift (tracker's time - start)."""

    joints: pd.DataFrame
    tracker: pd.DataFrame
    q: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    arrived: np.ndarray
    left: np.ndarray
    offset: float
    drift: float
    start: float

    def joints_clock(self, tracker: np.ndarray) -> np.ndarray:
        """What the joints' clock shows."""
        return tracker + self.offset + self.drift * (tracker - self.start)


def motion(stops: np.ndarray, stay: np.ndarray, move: np.ndarray, before: float, t: np.ndarray) -> np.ndarray:
    """Readings over time: from stop to stop by fifth powers, at rest before the first and after the last."""
    begin = before + np.cumsum(np.r_[0.0, stay[:-1] + move])
    leave = begin + stay
    k = np.clip(np.searchsorted(begin, t, "right") - 1, 0, len(stops) - 1)
    after = np.clip(k + 1, 0, len(stops) - 1)
    u = np.clip((t - leave[k]) / np.r_[move, 1.0][k], 0.0, 1.0)
    s = u**3 * (10 - 15 * u + 6 * u**2)
    return stops[k] + s[:, None] * (stops[after] - stops[k])


def made(
    robot: Robot,
    n: int = 150,
    seed: int = 0,
    offset: float = 3.7,
    drift: float = 4e-5,
    rates: tuple[float, float] = (50.0, 10.0),
    noise: tuple[float, float] = (5e-5, 1e-4),
    wrong: float = 0.0,
    stops: np.ndarray | None = None,
    stay: np.ndarray | None = None,
    move: np.ndarray | None = None,
    ends: tuple[float, float] = (3.0, 4.0),
    encoder: float = 1e-6,
) -> Made:
    """Simulate; `wrong` is the RMS by which the real target is elsewhere than the nominal one, smoothly over the joints."""
    rng = np.random.default_rng(seed)
    limits = np.clip(robot.limits, -1.5, 1.5)
    stops = rng.uniform(limits[:, 0], limits[:, 1], (n, len(limits))) if stops is None else stops
    n = len(stops)
    stay = rng.uniform(2.0, 4.0, n) if stay is None else stay
    if move is None:  # the fastest joint at up to 1 rad/s: 15/8 of the mean speed
        move = 0.5 + 1.875 * np.abs(np.diff(stops, axis=0)).max(axis=1)
    lasts = ends[0] + stay.sum() + move.sum() + ends[1]
    t_joints = np.arange(0.0, lasts, 1 / rates[0])
    true = np.arange(0.0, lasts, 1 / rates[1]) + 0.3 / rates[1]
    true = true[true < lasts]
    joints = motion(stops, stay, move, ends[0], t_joints) + encoder * rng.normal(size=(len(t_joints), len(limits)))
    world = Rotation.from_euler("xyz", [0.1, -0.2, 2.0])
    lever, shift = np.array([0.03, -0.05, 0.12]), np.array([2.0, 0.5, 0.8])
    phase = rng.uniform(0, 2 * np.pi, (3, len(limits)))

    def pose(q: np.ndarray) -> tuple[np.ndarray, Rotation]:
        R, p = tip_frames(robot, q)
        fault = wrong / np.sqrt(3) * np.sqrt(2 / len(limits)) * np.sin(q[:, None, :] + phase).sum(axis=2)
        turn = world * Rotation.from_matrix(R) * Rotation.from_rotvec([0.3, 0.2, -0.4])
        return world.apply(p + R @ lever + fault) + shift, turn

    place, turn = pose(motion(stops, stay, move, ends[0], true))
    place = place + noise[0] * rng.normal(size=place.shape)
    turn = Rotation.from_rotvec(noise[1] * rng.normal(size=place.shape)) * turn
    start = float(true[0] - offset)
    clock = start + (true - true[0]) / (1.0 + drift)
    table = pd.DataFrame(joints, columns=list(robot.readings))
    table.insert(0, "time", t_joints)
    tracker = pd.DataFrame(
        np.column_stack([clock, place, turn.as_quat()]), columns=["time", *"xyz", "qx", "qy", "qz", "qw"]
    )
    exact, rotation = pose(stops)
    arrived = ends[0] + np.cumsum(np.r_[0.0, stay[:-1] + move])
    return Made(table, tracker, stops, exact, rotation.as_matrix(), arrived, arrived + stay, offset, drift, start)
