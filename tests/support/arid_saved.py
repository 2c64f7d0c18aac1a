"""Calibrations of the ARID with two constants and effects, as they are saved."""

from __future__ import annotations

import numpy as np
import pandas as pd
import robots

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.model.model import Model
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel

RNG = np.random.default_rng(7)


def calibration(
    kind: str = "pose",
    effects: tuple[Coefficient, ...] = (),
    stations: tuple[str | None, ...] = (None,),
    text: str = "",
) -> SavedModel:
    """The ARID with two constants, any effects of 1e-3 each, and any frames."""
    rng = np.random.default_rng(1)
    world = tuple((s, robots.random_placement(rng)) for s in stations)
    tip = ((None, robots.random_placement(rng, 0.2)),)
    constants = (Coefficient("joint_2", "pitch"), Coefficient("joint_4", "y"))
    around = Surroundings(np.array([0.0, 9.81, 0.0]), (Payload(tip[0][1].translation),))
    geometric = Model(robots.arid(), constants, world, tip, around)
    final = geometric.with_coefficients(constants + effects)
    theta = np.full(len(final.coefficients), 1e-3)
    count = len(theta)
    ranges = {"joint_1": (1.0, 9.0), "joint_2": (0.1, 1.9), "joint_3": (1.8, 2.5), "joint_4": (-2.0, -0.3)}
    ranges |= {name: (10.0, 30.0) for c in effects for name in c.basis.of if "." not in name}
    return SavedModel(
        SolvedModel(geometric, theta[:2], np.eye(2) * 1e-8),
        SolvedModel(final, theta, np.eye(count) * 1e-8),
        kind,
        (0.0, 9.81, 0.0),
        (1e-4, 1e-4),
        ranges,
        {"campaign": text} if text else {},
    )


def inside(n: int) -> pd.DataFrame:
    """Readings in the ranges seen."""
    low, high = np.array([1.0, 0.1, 1.8, -2.0]), np.array([9.0, 1.9, 2.5, -0.3])
    return pd.DataFrame(RNG.uniform(low, high, (n, 4)), columns=["joint_1", "joint_2", "joint_3", "joint_4"])
