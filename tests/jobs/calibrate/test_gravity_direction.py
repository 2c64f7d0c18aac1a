"""A campaign that states another gravity than pulls is told so, with the vector to set; one that is right never is."""

from __future__ import annotations

import re

import numpy as np
import pytest
import robots
from tilted import geometric, measured

from aridcal.engine.search.loop import calibrated_arm, fit_constants
from aridcal.jobs.calibrate.gravity_direction import gravity_direction
from aridcal.jobs.calibrate.pipeline import judge_arm
from aridcal.system.progress import SILENT

DOWN = np.array([0.0, 0.0, -1.0])


@pytest.mark.parametrize(
    ("pull", "tool", "gears"),
    [
        ((0.0, 0.866, -0.5), 0.0, 2e-4),
        ((1.0, 0.0, 0.0), 0.0, 0.0),
        ((0.0, -1.0, 0.0), 2.0, 2e-4),
        ((0.0, 0.0, 1.0), 0.0, 0.0),
    ],
)
def test_the_vector_to_set_is_the_one_that_pulls(pull: tuple[float, ...], tool: float, gears: float) -> None:
    rows = measured(3, np.array(pull), 3e-5, gears, tool)
    said = gravity_direction(geometric(rows), rows.fitted)
    vector = np.array([float(x) for x in re.findall(r"-?\d+\.\d+", said.split("gravity: [")[1])])
    assert np.linalg.norm(vector) == pytest.approx(9.81, abs=0.02)
    assert vector @ pull > 9.81 * np.cos(np.radians(10.0))


@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize(("compliance", "gears"), [(0.0, 0.0), (0.0, 3e-4), (3e-5, 0.0), (3e-5, 3e-4)])
def test_a_direction_that_is_right_is_never_doubted(seed: int, compliance: float, gears: float) -> None:
    rows = measured(seed, DOWN, compliance, gears, tool=2.0 * (seed % 2))
    assert gravity_direction(geometric(rows), rows.fitted) == ""


def test_the_setting_is_said_before_all_that_may_follow_from_it() -> None:
    rows = measured(5, np.array([0.0, 0.866, -0.5]), 3e-5)
    asked = robots.campaign("pose", diagnosis={"candidates": ["joint_compliance", "joint_gain"]})
    arm = calibrated_arm(
        asked.question, robots.ur10(), rows, (), fit_constants(asked.question, robots.ur10(), rows, ()), SILENT
    )
    said = judge_arm(arm).verdict
    assert said.word == "structure_remains"
    assert "robot.gravity" in said.reasons[0]
