"""What to measure, so that two effects are no longer confounded, is said in terms of what a user can change."""

from __future__ import annotations

import numpy as np
import robots

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.pages.drawing.words import how_to_separate


def effect(kind: str, where: str, of: str, component: str = "axis") -> Effect:
    return Effect(kind, where, (Coefficient(where, component, Basis("linear", (of,), (0.0,))),))


ROBOT = robots.arid()
HARMONIC = effect("joint_harmonic", "joint_3", "joint_3")
COMPLIANCE = effect("joint_compliance", "joint_3", "joint_3.gravity_torque")


def test_a_load_is_changed_while_the_reading_stays() -> None:
    said = how_to_separate(HARMONIC, COMPLIANCE, ROBOT, {})
    assert "the gravity load on joint_3 changes while joint_3 stays the same" in said
    assert "stretch, fold or load the arm" in said
    assert "joint_3 changes while the gravity load on joint_3 stays the same" in how_to_separate(
        COMPLIANCE, HARMONIC, ROBOT, {}
    )


def test_time_and_temperature_that_went_together_are_said_to() -> None:
    drift, thermal = effect("drift", "world_base", "time", "x"), effect("thermal", "world_base", "temperature", "x")
    time = np.linspace(0.0, 1.0, 50)
    said = how_to_separate(drift, thermal, ROBOT, {"time": time, "temperature": 20 + time})
    assert "temperature changes while time stays the same: measure the same configurations cold and warm" in said
    assert "correlated: r = 1.00" in said
    apart = {"time": time, "temperature": np.cos(50 * time)}
    assert "correlated" not in how_to_separate(drift, thermal, ROBOT, apart)


def test_the_joints_between_two_places_are_to_be_turned() -> None:
    a, b = effect("unknown", "joint_2", "joint_1", "yaw"), effect("unknown", "tip_target", "joint_1", "yaw")
    for said in (how_to_separate(a, b, ROBOT, {}), how_to_separate(b, a, ROBOT, {})):
        assert "both depend on joint_1: at the same joint_1, turn joint_3, joint_4 widely" in said


def test_functions_of_one_reading_at_one_place_differ_in_shape_alone() -> None:
    other = effect("joint_gain", "joint_3", "joint_3")
    assert "only their shapes differ" in how_to_separate(HARMONIC, other, ROBOT, {})


def test_backlash_is_told_by_approaching_from_both_sides() -> None:
    backlash = effect("joint_backlash", "joint_2", "joint_2_direction")
    said = how_to_separate(HARMONIC, backlash, ROBOT, {})
    assert "the direction in which joint_2 approached" in said
    assert "from both sides" in said
