"""Coefficients of every kind of effect, for tests of what has to know them all."""

from __future__ import annotations

import numpy as np

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, candidates
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.loads import Surroundings, covariate_table
from aridcal.engine.robot.chain import Robot


def every_effect(
    robot: Robot, q: np.ndarray, columns: dict[str, np.ndarray], around: Surroundings
) -> tuple[Coefficient, ...]:
    """All coefficients of the table of kinds."""
    wanted = {f"{name}.{load}" for name in robot.names for load in ("gravity_torque", "payload_torque")}
    table = covariate_table(robot, q, columns, around, np.zeros(len(q), dtype=int), wanted)
    effects = candidates(ObservedRows(robot, table, tuple(columns)), EFFECT_KINDS)
    return tuple(dict.fromkeys(c for e in effects for c in e.coefficients))
