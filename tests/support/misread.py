"""Tables that were not read as they were written, of a robot whose constants are off."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import robots
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.constants import constants
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot

Q = ["qx", "qy", "qz", "qw"]

XYZ = ["x", "y", "z"]

Spoil = Callable[[pd.DataFrame], pd.DataFrame]


def machine(robot: Robot, share: float = 1.0, n: int = 120, size: float = 2e-3, seed: int = 0) -> robots.Truth:
    """A robot whose constants are off by 2 mm and 2 mrad, moving over a share of its range about a bent posture."""
    rng = np.random.default_rng(seed)
    coefficients = constants(robot, "full")
    frames = (((None, robots.random_placement(rng)),), ((None, robots.random_placement(rng, 0.2)),))
    model = Model(robot, coefficients, *frames)
    theta = rng.normal(0.0, size, len(coefficients))
    q = robots.readings(robot, n, rng, share) + (min(0.3, share) if share < 1 else 0.0)
    R, p = model.poses(theta, model.rows(q))
    p = p + rng.normal(0, 1e-4, p.shape)
    R = Rotation.from_rotvec(rng.normal(0, 1e-4, p.shape)).as_matrix() @ R
    return robots.Truth(model, theta, robots.measured(robot, q, p, R))


def rotation(table: pd.DataFrame) -> Rotation:
    return Rotation.from_quat(table[Q])


def inverted(places: bool) -> Spoil:
    def change(table: pd.DataFrame) -> pd.DataFrame:
        back = rotation(table).inv()
        table = table.assign(**dict(zip(Q, back.as_quat().T, strict=True)))
        return (
            table.assign(**dict(zip(XYZ, -back.apply(table[XYZ].to_numpy(copy=True)).T, strict=True)))
            if places
            else table
        )

    return change


def counted(sign: float, zero: float, column: str) -> Spoil:
    return lambda table: table.assign(**{column: sign * table[column] + zero})
