"""A simulated arm with a tracker that measures one pose at a time, wherever it is sent."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from aridcal.engine.model.model import Model
from aridcal.engine.rows.approach import approach
from aridcal.engine.rows.repeats import tolerances
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import Simulation, simulate, table_of, with_noise
from aridcal.jobs.simulate.true_effects import ROW_PERIOD
from aridcal.system.errors import CampaignError, MeasurementError, shortened


@dataclass
class LiveArm:
    """An arm that stands somewhere; it is changed by :meth:`measured`.

    Attributes:
        simulation: The machine, as rows drawn beforehand made it.
        model: The same, with its effects.
        noise: Draws the noise.
        poses: Readings so far, (columns,) each.
    """

    simulation: Simulation
    model: Model
    noise: np.random.Generator
    poses: list[np.ndarray] = field(default_factory=list)

    def measured(self, readings: np.ndarray) -> pd.DataFrame:
        """Go to readings, shape (columns,), [rad] or [m], and measure: one row of the campaign's table."""
        scenario, robot = self.simulation.scenario, self.simulation.robot
        number = len(self.poses)
        self.poses.append(np.asarray(readings, dtype=float))
        way = np.array(self.poses[-2:])
        columns = {name: values[[number % len(values)]] for name, values in self.simulation.columns.items()}
        for j, (name, still) in enumerate(zip(robot.readings, tolerances(robot.kinds).tolist(), strict=True)):
            if f"{name}_direction" in columns:
                columns[f"{name}_direction"] = approach(way[:, j], still, side=1.0)[-1:]
        if "time" in columns:
            columns["time"] = np.array([ROW_PERIOD * number])
        R, p = self.model.poses(self.simulation.theta, self.model.rows(way[-1:], columns))
        position, rotation, _ = with_noise(scenario.truth, R, p, self.noise, self.noise)
        return table_of(scenario, robot, way[-1:], columns, position, rotation)


def live_arm(scenario: Scenario) -> LiveArm:
    """The machine of a scenario, ready to measure.

    Raises:
        AridcalError: the scenario asks for what cannot be simulated, or not pose by pose.
    """
    kind = scenario.measurements.traits
    by_row = [effect.kind for effect in scenario.truth.effects if effect.form is not None or effect.kind == "shift"]
    if scenario.refers or not kind.tracked or scenario.truth.outliers is not None or by_row:
        raise CampaignError(
            f"{scenario.path}: measured live are `kind: pose` and `kind: position` of one target, without `outliers`, "
            "`shift` and effects with a `form`; simulate all others as a whole"
        )
    simulation = simulate(scenario)
    assert simulation.model is not None
    return LiveArm(simulation, simulation.model, np.random.default_rng([scenario.truth.seed, 1]))


def asked(arm: LiveArm, line: str) -> pd.DataFrame | None:
    """Measure what a line of `aridcal guide --json` asks for; None where it asks for nothing.

    Raises:
        MeasurementError: it is no such line, or its joints are not this arm's.
    """
    try:
        event = json.loads(line)
        if event["event"] != "next":
            return None
        settings, robot = arm.simulation.scenario.measurements, arm.simulation.robot
        names = [settings.columns.get(name, name) for name in robot.readings]
        readings = np.array([float(event["joints"][name]) for name in names])
    except (ValueError, TypeError, KeyError):
        raise MeasurementError(
            f"standard input: {shortened(line.strip())!r} is no event of this arm; "
            "pipe `aridcal guide DIR/campaign.yaml --json` here"
        ) from None
    return arm.measured(readings)  # a scenario's table is in SI
