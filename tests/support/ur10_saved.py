"""Calibrations of a UR10 with constants that are off and effects, as they are saved, and poses that it takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import robots

from aridcal import predict
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.fit.constants import constants
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel

POSE = ["x", "y", "z", "qx", "qy", "qz", "qw"]

BACKLASH = Coefficient("elbow_joint", "axis", Basis("linear", ("elbow_joint_direction",), (0.0,)))

HEAT = Coefficient("wrist_1_joint", "axis", Basis("linear", ("temperature",), (20.0,)))


def calibration(
    robot: Robot | None = None,
    effects: dict[Coefficient, float] | None = None,
    text: str = "",
    stations: tuple[str | None, ...] = (None,),
    kind: str = "pose",
) -> SavedModel:
    """A robot whose constants are all off by a millimetre and a milliradian, with some effects."""
    rng = np.random.default_rng(2)
    robot, effects = robot or robots.ur10(), effects or {}
    wrong = constants(robot, "full")
    world = tuple((label, robots.random_placement(rng)) for label in stations)
    tip = ((None, robots.random_placement(rng, 0.2)),)
    geometric = Model(
        robot, wrong, world, tip, Surroundings(np.array([0.0, 0.0, -9.81]), (Payload(tip[0][1].translation),))
    )
    theta = rng.normal(0.0, 1e-3, len(wrong))
    final = geometric.with_coefficients((*wrong, *effects))
    values = np.concatenate([theta, list(effects.values())])
    ranges = {name: (-1.2, 1.2) for name in robot.readings}
    ranges |= {name: (10.0, 30.0) for c in effects for name in c.basis.of if name == "temperature"}
    return SavedModel(
        SolvedModel(geometric, theta, np.eye(len(theta))), SolvedModel(final, values, np.eye(len(values))), kind,
        (0.0, 0.0, -9.81), (1e-5, 1e-5), ranges, {"campaign": text} if text else {},
    )  # fmt: skip


def readings(n: int, seed: int = 3) -> pd.DataFrame:
    """Away from the stretched elbow and the singular wrist."""
    rng = np.random.default_rng(seed)
    low, high = [-1, -1, 0.3, -1, 0.4, -1], [1, 0, 1.2, 1, 1.1, 1]
    return pd.DataFrame(rng.uniform(low, high, (n, 6)), columns=list(robots.ur10().readings))


def predicted(folder: Path, query: Path) -> pd.DataFrame:
    """What the other command says of some joints."""
    assert predict.main([str(folder / "calibration.yaml"), str(query), "-o", str(folder / "back.csv")]) == 0
    return robots.read_csv(folder / "back.csv")


def wanted(folder: Path, model: SavedModel, q: pd.DataFrame) -> pd.DataFrame:
    """Poses that the machine takes at some joints."""
    (folder / "calibration.yaml").write_text(model.dump(), encoding="utf-8")
    q.to_csv(folder / "q.csv", index=False, float_format="%.17g")
    return predicted(folder, folder / "q.csv").drop(columns="extrapolates")
