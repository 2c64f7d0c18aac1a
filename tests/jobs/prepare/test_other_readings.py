"""Tables that were not read as they were written: the right remedy is named before effects are sought, and only then."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import robots
import yaml
from misread import XYZ, Q, Spoil, machine, rotation
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import station_labels
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.loop import fit_constants
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.read import load_measurements
from aridcal.jobs.prepare.other_readings import refuse_misread
from aridcal.system.errors import NotOfThisRobot

ABC = ["A", "B", "C"]
FIRST = {"orientation": {"euler": "ZYX", "columns": ABC}}


def read(folder: Path, truth: robots.Truth, table: pd.DataFrame, **sections: Any) -> tuple[Campaign, Dataset]:
    """A campaign and its rows."""
    measurements = {"file": "measurements.csv", "kind": "pose"} | sections.pop("measurements", {})
    campaign = load_campaign(robots.write_campaign(folder, truth, table, measurements=measurements, **sections))
    robot = truth.model.robot
    return campaign, load_measurements(campaign, robot.readings, robot.limits, robot.kinds)


def judge(folder: Path, truth: robots.Truth, table: pd.DataFrame, **sections: Any) -> None:
    """What `identify` does before it looks for effects."""
    robot = truth.model.robot
    campaign, rows = read(folder, truth, table, **sections)
    try:
        geometry = fit_constants(campaign.question, robot, rows, station_labels(campaign.question, rows))
    except NotOfThisRobot:
        refuse_misread(campaign, robot, rows, None)
        raise
    refuse_misread(campaign, robot, rows, geometry)


def in_letters(word: str) -> Spoil:
    """Orientations as A B C in place of a quaternion."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        angles = rotation(table).as_euler(word)  # type: ignore[call-overload]
        return table.drop(columns=Q).assign(**dict(zip(ABC, angles.T, strict=True)))

    return change


def scaled(factor: float, *columns: str) -> Spoil:
    return lambda table: table.assign(**{name: factor * table[name] for name in columns})


def three() -> Robot:
    """Three revolute joints with axes anywhere: the fewest among which a slip can hide."""
    return robots.random_robot(3, "RRR")


ROBOTS: dict[str, Callable[[], Robot]] = {"arid": robots.arid, "three": three}

ROTATED = dict(zip(Q, ["qy", "qz", "qw", "qx"], strict=True))
WRONG: dict[str, tuple[str, float, Spoil, dict[str, Any], str, dict[str, Any]]] = {
    "scalar first, small turns": ("arid", 0.1, lambda t: t.rename(columns=ROTATED), {}, "scalar-first quaternions",
                                  {"columns": {"qx": "qy", "qy": "qz", "qz": "qw", "qw": "qx"}}),
    "turning axes called fixed": ("arid", 0.3, in_letters("XYZ"),
                                  {"orientation": {"euler": "xyz", "columns": ABC}}, "Euler angles XYZ",
                                  {"orientation": {"euler": "XYZ", "columns": ABC}}),
    "rotation vectors called angles": (
        "arid", 0.3,
        lambda t: t.drop(columns=Q).assign(**dict(zip(ABC, rotation(t).as_rotvec().T, strict=True))),
        FIRST, "rotation vectors", {"orientation": {"rotvec": ABC}},
    ),
    "all angles in degrees": ("three", 0.1, scaled(180 / np.pi, *three().readings), {}, "angles in degrees",
                              {"units": {"angle": "deg"}}),
    "a sign that axes absorb": ("three", 0.3, scaled(-1.0, "joint_2"), {}, "joint_2 with the other sign",
                                 {"joints": {"joint_2": {"sign": -1}}}),
    "inches, which constants absorb": ("three", 0.3, scaled(1 / 0.0254, *XYZ), {}, "lengths in inches",
                                       {"units": {"length": "in"}}),
    "a rail in inches": ("arid", 0.3, scaled(1 / 0.0254, "joint_1"), {}, "joint_1 in inches",
                         {"units": {"columns": {"joint_1": "in"}}}),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_table_read_wrongly_is_refused_with_the_reading_that_fits(name: str, tmp_path: Path) -> None:
    which, share, spoil, said, what, keys = WRONG[name]
    truth = machine(ROBOTS[which](), share, 30)
    table = spoil(robots.table(truth))
    with pytest.raises(NotOfThisRobot, match=re.escape(f"Read as {what} they would be ")) as caught:
        judge(tmp_path, truth, table, measurements=said)
    remedy = str(caught.value)
    assert str(tmp_path / "measurements.csv") in remedy
    # The remedy, followed to the letter, is one: rows are as they were measured.
    written = yaml.safe_load(remedy.partition("`")[2].removesuffix("`"))
    assert written == keys
    _, rows = read(tmp_path, truth, table, measurements=said | written)
    line = rows.origin.line - 2
    np.testing.assert_allclose(rows.readings, truth.readings[line], atol=1e-9)
    np.testing.assert_allclose(rows.position, truth.measured.position[line], atol=1e-9)
    np.testing.assert_allclose(rows.rotation, truth.measured.rotation[line], atol=1e-7)


def backlash_and_gears(truth: robots.Truth) -> pd.DataFrame:
    """The machine's poses when every joint is out by 20 mrad of play and 10 mrad of gear error besides."""
    robot, rng = truth.model.robot, np.random.default_rng(3)
    effects = [Coefficient(j, "axis", Basis("sin", (j,), (3.0,))) for j in robot.names]
    model = truth.model.with_coefficients((*truth.model.coefficients, *effects))
    q = truth.readings + 0.01 * rng.choice([-1, 1], truth.readings.shape)
    R, p = model.poses(np.concatenate([truth.theta, np.full(len(effects), 0.01)]), model.rows(q))
    rows = robots.measured(robot, truth.readings, p, R)
    return robots.table(robots.Truth(truth.model, truth.theta, rows))


def at_two_places(truth: robots.Truth) -> pd.DataFrame:
    """The tracker was moved by 40 mm and 2 degrees half way, and nobody wrote it down."""
    table = robots.table(truth)
    half = slice(len(table) // 2, None)
    turn = Rotation.from_rotvec([0.0, 0.02, 0.03])
    table.loc[table.index[half], Q] = (turn * rotation(table[half])).as_quat()
    table.loc[table.index[half], XYZ] = turn.apply(table[XYZ][half].to_numpy(copy=True)) + [0.04, 0.0, -0.02]
    return table


def zeros_off(truth: robots.Truth) -> pd.DataFrame:
    """Encoders that were mounted anyhow."""
    off = np.random.default_rng(4).uniform(-0.25, 0.25, truth.readings.shape[1])
    return robots.table(truth).assign(**dict(zip(truth.model.robot.readings, (truth.readings + off).T, strict=True)))


TRUE: dict[str, tuple[str, float, Callable[[robots.Truth], pd.DataFrame], dict[str, Any]]] = {
    "zeros off by 14 degrees": ("arid", 2e-3, zeros_off, {}),
    "play and gears": ("three", 2e-3, backlash_and_gears, {}),
    "moved without a word": ("three", 2e-3, at_two_places, {}),
    "moved between stations": (
        "three", 2e-3, lambda t: at_two_places(t).assign(station=["a"] * 60 + ["b"] * 60),
        {"frames": {"world_base": {"per": "station"}}},
    ),
    "only the frames are sought": ("three", 5e-3, robots.table, {"parameters": {"set": "none"}}),
}  # fmt: skip


@pytest.mark.parametrize("name", TRUE)
def test_a_robot_with_large_errors_of_its_own_is_not_refused(name: str, tmp_path: Path) -> None:
    which, size, table, sections = TRUE[name]
    truth = machine(ROBOTS[which](), size=size, seed=5)
    judge(tmp_path, truth, table(truth), **sections)
