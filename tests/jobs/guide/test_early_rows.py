"""Few rows and one of them bad, or a frame that moved among them: what is said, and that all goes on as if it had not been."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aridcal.engine.fit.constants import constants
from aridcal.engine.inverse.reachable import draw_readings, inner_limits
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.files.yaml_file import load_settings
from aridcal.guide import in_words
from aridcal.jobs.guide.accuracy import Beside
from aridcal.jobs.guide.events import Alarm, Event, Known, RowRead
from aridcal.jobs.guide.session import Session, session
from aridcal.jobs.simulate.live import LiveArm, live_arm
from aridcal.jobs.simulate.scenario import Scenario

TOP = Path(__file__).parents[3]
ARMS = {"arid": "flange", "ur10": "tool0"}
ROWS = {"pose": 13, "position": 24}
SIGMA = 5e-5


def arm_and_session(folder: Path, name: str, kind: str) -> tuple[LiveArm, Session]:
    """A machine off by a millimetre and a milliradian in each constant, measured in frames anywhere."""
    noise = {"position": SIGMA} | ({"rotation": 1e-4} if kind == "pose" else {})
    keys = {
        "format": 1,
        "robot": {"urdf": str(TOP / "urdf" / f"{name}.urdf"), "tip": ARMS[name]},
        "measurements": {"file": "measurements.csv", "kind": kind, "noise": noise},
        "frames": {"tip_target": {"xyz": [0.05, 0.03, 0.15]}},
    }
    (folder / "campaign.yaml").write_text(json.dumps(keys))
    campaign = load_campaign(folder / "campaign.yaml")
    robot = nominal_robot(campaign)
    world = {"xyz": [1.2, -0.7, 0.4], "rpy": [0.2, -0.1, 0.9]}
    truth = {
        "parameters": {c.name: {"std": 1e-3} for c in constants(robot, "full")},
        "frames": {"world_base": world, "tip_target": {"xyz": [0.06, 0.02, 0.13], "rpy": [0.3, 0.2, 0.1]}},
        "noise": noise,
        "n": 10,
        "seed": 4,
    }
    (folder / "scenario.yaml").write_text(json.dumps(keys | {"truth": truth}))
    return live_arm(load_settings(folder / "scenario.yaml", Scenario)), session(campaign, robot, None)


def measured(arm: LiveArm, n: int, between: Callable[[int], None] = lambda row: None) -> list[bytes]:
    """Header and rows of random poses; ``between`` is called before each row."""
    robot = arm.simulation.robot
    lines: list[bytes] = []
    for row, readings in enumerate(draw_readings(robot, n, np.random.default_rng(5), inner_limits), start=1):
        between(row)
        lines += arm.measured(readings).to_csv(index=False).encode().splitlines()[0 if not lines else 1 :]
    return lines


def taken(now: Session, lines: list[bytes]) -> list[Event]:
    """What is said to a table that is there all at once."""
    return now.taken(now.table.take(b"".join(line + b"\n" for line in lines)))


def off(line: bytes, joints: int, by: float) -> bytes:
    """A row whose place is off by so much along two axes, [m]."""
    cells = line.decode().split(",")
    for k, sign in ((joints, 1.0), (joints + 1, -1.0)):
        cells[k] = repr(float(cells[k]) + sign * by)
    return ",".join(cells).encode()


@pytest.mark.parametrize(
    ("name", "kind", "place"),
    [("arid", "position", 5), ("ur10", "pose", 7)],
)
def test_a_bad_early_row_is_called_off_by_its_number_and_all_is_as_if_it_had_never_been(
    tmp_path: Path, name: str, kind: str, place: int
) -> None:
    """Beside a session that never saw the row: no word against a row, and what is known is the same."""
    arm, now = arm_and_session(tmp_path, name, kind)
    lines = measured(arm, ROWS[kind])
    spoilt = [*lines[:place], off(lines[place], len(arm.simulation.robot.readings), 4e-3), *lines[place + 1 :]]
    alarms = [event for event in taken(now, spoilt) if isinstance(event, Alarm)]
    assert {alarm.row for alarm in alarms} == {place + 1}  # the header is line 1
    assert f"measure row {place + 1} again" in alarms[-1].do
    assert [k for k, good in now.good.items() if not good] == [place - 1]
    without = session(now.campaign, now.robot, None)
    clean = taken(without, [*lines[:place], *lines[place + 1 :]])
    assert not [event for event in clean if isinstance(event, Alarm)]
    assert now.known().position == pytest.approx(without.known().position, rel=0.2)  # sizes of constants: a round more
    assert now.posterior is not None
    assert without.posterior is not None
    theirs = dict(zip(without.posterior.setup.model.names, without.posterior.setup.theta, strict=True))
    std = np.sqrt(np.diag(without.posterior.covariance))
    apart = now.posterior.setup.theta - [theirs[name] for name in now.posterior.setup.model.names]
    assert np.max(np.abs(apart) / std) < 0.5  # the row alone would move some by more than that


def test_a_row_that_was_good_and_is_called_off_later_is_said_again(tmp_path: Path) -> None:
    arm, now = arm_and_session(tmp_path, "arid", "pose")
    lines = measured(arm, 10)
    lines[2] = off(lines[2], len(arm.simulation.robot.readings), 4e-3)
    verdicts = [event.ok for event in taken(now, lines) if isinstance(event, RowRead) and event.row == 3]
    assert verdicts == [True, False]


@pytest.mark.parametrize("frame", ["tip_target", "world_base"])
def test_a_slip_among_few_positions_is_told_although_no_row_is_off_by_itself(tmp_path: Path, frame: str) -> None:
    """A millimetre where a new position is predicted to a quarter of one: three rows together tell it."""
    arm, now = arm_and_session(tmp_path, "ur10", "position")
    first = 19

    def slip(row: int) -> None:
        if row == first:
            ((label, at),) = getattr(arm.model, frame)
            moved = at.copy()
            moved.translation = at.translation + np.array([0.8e-3, -0.5e-3, 0.6e-3])
            ends = ((label, moved),)
            arm.model = (
                replace(arm.model, tip_target=ends) if frame == "tip_target" else replace(arm.model, world_base=ends)
            )

    alarms = [event for event in taken(now, measured(arm, first + 2, slip)) if isinstance(event, Alarm)]
    assert [alarm.row for alarm in alarms if alarm.what == "slip"] == [first + 1]
    assert frame in now.slips[0][1]
    assert all(now.good.values())


def test_turns_are_null_where_only_a_point_of_the_target_is_measured(tmp_path: Path) -> None:
    arm, now = arm_and_session(tmp_path, "arid", "position")
    known = [event for event in taken(now, measured(arm, 10)) if isinstance(event, Known)][-1]
    assert known.document()["rotation_mrad"] is None
    assert known.document()["position_mm"] > 0.0
    assert "mrad" not in str(in_words(known))
    assert "mrad" in str(in_words(replace(known, rotation=1e-3)))


def test_what_is_beyond_the_model_is_told_by_rows_predicted_well_and_foreseen() -> None:
    """Errors drawn with a known standard deviation beyond: covered, and not lost beside rows predicted poorly."""
    rng = np.random.default_rng(0)
    truth, covered = 4e-5, 0
    for _ in range(40):
        beside, poor = Beside(), rng.normal(0.0, 2e-3, (20, 3))
        for error in poor:
            beside = beside.with_row(error, np.full(3, 4e-6))
        for error in rng.normal(0.0, np.hypot(SIGMA, truth), (30, 3)):
            beside = beside.with_row(error, np.full(3, SIGMA**2))
        covered += bool(np.quantile(beside.drawn(2000, rng), 0.95) > truth)
    assert covered >= 33  # of 40
    short = Beside()
    for error in rng.normal(0.0, SIGMA, (6, 3)):
        short = short.with_row(error, np.full(3, SIGMA**2))
    now, later = (np.quantile(some.drawn(2000, rng), 0.95) for some in (short, short.after(50)))
    assert later < 0.7 * now
