"""`check` and `recalibrate` with rows of other instruments than the calibration's, of which nobody knows where they stand."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
import yaml
from calibrated import NOISE, Machine, by_instruments, jump, machine
from test_simulate_instruments import BOARD, EYE

from aridcal.errors import AridcalError
from aridcal.upkeep.bounds import FALSE_ALARMS
from aridcal.upkeep.checking import Checked, check
from aridcal.upkeep.new_rows import read_new_rows
from aridcal.upkeep.repair import changes, repaired

NAMES = robots.ur10().readings
ON_TIP = {"cameras": {"eye": EYE | {"xyz": [0.05, 0.0, 0.02], "rpy": [0.1, -0.1, 1.0]}}}


@cache
def ur10() -> Machine:
    return machine(3)


def asked(folder: Path, kinds: list[str], offset: np.ndarray | float = 0.0, **more: object) -> Checked:
    new = read_new_rows(ur10().saved, by_instruments(ur10(), folder, kinds, offset, **more))
    return check(ur10().saved, new.rows, frames=new.frames)


CASES: dict[str, tuple[list[str], object]] = {
    "point": (["point"], None),
    "distance": (["distance"], None),
    "plane": (["plane"], None),
    "camera": (["pixels"], ON_TIP),
    "camera beside": (["pixels"], {"cameras": {"eye": EYE | {"on": "world"}}}),
    "two": (["distance", "inclination"], None),
}


@pytest.mark.parametrize("name", CASES)
def test_a_zero_that_jumped_is_named_whatever_measures_it(name: str, tmp_path: Path) -> None:
    kinds, instruments = CASES[name]
    n = 8 if "pixels" in kinds else 20
    good = asked(tmp_path, kinds, instruments=instruments, n=n)
    assert good.good
    assert {s.where for s in good.unseen} >= ({"shoulder_pan_joint"} if kinds != ["distance", "inclination"] else set())
    found = asked(tmp_path, kinds, jump(2, 2e-3), instruments=instruments, n=n)
    assert [(c.kind, c.where) for c in found.causes] == [("zero", "elbow_joint")]
    (change,) = changes(found)
    assert change.value[0] == pytest.approx(2e-3, abs=4 * change.std[0])
    assert change.std[0] < 3e-4
    assert found.rest.p_value > FALSE_ALARMS


def test_three_parallel_axes_look_alike_to_a_level_and_a_pose_is_named_that_tells(tmp_path: Path) -> None:
    (cause,) = asked(tmp_path, ["inclination"], jump(1, 2e-3)).causes
    words = [cause.words, *cause.alike]
    assert {f"the zero of {name}" for name in NAMES[1:4]} <= set(words)
    assert cause.telling
    low, high = np.array([ur10().saved.ranges[name] for name in NAMES]).T
    assert all(np.all((low <= told.readings) & (told.readings <= high)) for told in cause.telling)


@pytest.mark.parametrize("kind", ["point", "distance", "plane", "pixels"])
def test_what_nobody_knew_takes_up_as_many_numbers_as_it_has(kind: str, tmp_path: Path) -> None:
    """The squares that are left are as many as are counted: else alarms would be too few or too many."""
    things = ON_TIP if kind == "pixels" else None
    new = read_new_rows(
        ur10().saved, by_instruments(ur10(), tmp_path, [kind], n=40 if things else 150, instruments=things)
    )
    rng, squares, numbers, alarms = np.random.default_rng(0), 0.0, 0, 0
    for _ in range(30):
        rows = new.rows.select(rng.choice(len(new.rows), 30, replace=False))
        found = check(ur10().saved, rows, frames=new.frames).first
        squares, numbers, alarms = (
            squares + found.squares,
            numbers + found.numbers,
            alarms + (found.p_value < FALSE_ALARMS),
        )
    assert squares / numbers == pytest.approx(1.0, abs=4 * np.sqrt(2 / numbers) + 0.02)
    assert alarms <= 3
