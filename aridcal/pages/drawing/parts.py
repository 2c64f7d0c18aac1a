"""A second look in words: halves of the rows, rows left out, combinations of constants."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.engine.trust.combinations import Combination, Pair
from aridcal.engine.trust.halves import Halves
from aridcal.jobs.calibrate.joint_zeros import JointZero, zero_of
from aridcal.system.wording import number, plus_minus

LEAST_RATIO_OF_EQUALS = 0.7
"""Ratio of two shares from which they are a sum or a difference in words: sin 45 degrees over 1."""

OF_TIME = {
    "low and high": "early and late rows",
    "the middle and the ends": "rows in the middle of the measurement and at its ends",
    "alternate quarters": "alternate quarters of the measurement",
    "alternate quarters from an eighth on": "alternate quarters of the measurement, from an eighth on",
    "alternate eighths": "alternate eighths of the measurement",
}
"""Divisions in the order of the rows."""


def division_in_words(of: str, how: str) -> str:
    """Which halves were compared: ``low and high joint_3``, ``early and late rows``."""
    if of == "row":
        return OF_TIME[how]
    return f"{how} {of}" if how == "low and high" else f"{how} of {of}"


def p_of_halves(halves: Halves) -> str:
    """Their p-value: ``p = 0.43``, ``p = 3.2e-12``."""
    return f"p = {number(halves.p_value, 2)}"


def constant_in_words(name: str, robot: Robot) -> str:
    """A constant as engineers call it: ``joint_2's zero``, where it is along or about the joint's own axis; else its name."""
    zero = zero_of(name, robot)
    return f"{zero[0]}'s zero" if zero else name


def zero_in_words(zero: JointZero) -> str:
    """How far a joint's zero is off, with one standard deviation, an angle in degrees as well."""
    return size_in_words({"value": zero.value, "std": zero.std, "unit": zero.unit})


def size_in_words(p: dict[str, Any]) -> str:
    """A constant with its uncertainty, an angle in degrees as well: ``3.70 ± 0.02 mrad = 0.212°``.

    Args:
        p: As :func:`aridcal.jobs.calibrate.folder.parameters` has it, identified.
    """
    said = plus_minus(1e3 * p["value"], 1e3 * p["std"])
    return f"{said} mrad = {number(math.degrees(p['value']))}°" if p["unit"] == "rad" else f"{said} mm"


def combination_in_words(of: Combination, robot: Robot) -> str:
    """``the sum of joint_2's zero and joint_3's zero``, ``joint_3.y alone``, ``joint_2.y + 0.6 joint_3.y − 0.4 joint_4.x``."""
    names = [constant_in_words(name, robot) for name, _ in of.parts]
    shares = np.array([share for _, share in of.parts]) / of.parts[0][1]
    if len(names) == 1:
        return f"{names[0]} alone"
    if len(names) == 2 and abs(shares[1]) > LEAST_RATIO_OF_EQUALS:
        return f"the {'sum' if shares[1] > 0 else 'difference'} of {names[0]} and {names[1]}"
    rest = [
        f"{'+' if s > 0 else '−'} {number(abs(float(s)), 2)} {n}" for n, s in zip(names[1:], shares[1:], strict=True)
    ]
    return " ".join([names[0], *rest])


def pair_in_words(of: Pair, robot: Robot) -> str:
    """A sentence on a sum and a difference that are known unequally well."""
    first, second = constant_in_words(of.first, robot), constant_in_words(of.second, robot)
    unit = "mrad" if of.unit == "rad" else "mm"
    better = of.of_sum < of.of_difference
    smaller, larger = sorted((1e3 * of.of_sum, 1e3 * of.of_difference))
    which, rest = ("sum", "difference") if better else ("difference", "sum")
    return (
        f"The {which} of {first} and {second} is known {number(of.ratio, 2)} times better than their {rest}: "
        f"± {number(smaller, 2)} {unit} against ± {number(larger, 2)} {unit}."
    )
