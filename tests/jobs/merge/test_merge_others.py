"""`aridcal merge` carries what else the logs hold, averaged at each standstill."""

from __future__ import annotations

from pathlib import Path

import made_logs
import numpy as np
import pandas as pd
import pytest
import robots
from made_logs import Made

import aridcal
from aridcal.jobs.merge.log_rows import MergeResult
from aridcal.jobs.prepare.guesses import leave_open
from aridcal.runs.log_merge import join_logs

UR10 = robots.URDF / "ur10.urdf"
ROBOT = robots.ur10()


@pytest.fixture(scope="module")
def plain() -> Made:
    return made_logs.made(ROBOT, n=12, seed=3, offset=3.7)


@pytest.fixture(scope="module")
def logs(plain: Made) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Both logs with all that controllers and trackers write beside joints and places."""
    joints, tracker = plain.joints.copy(), plain.tracker.copy()
    late = joints["time"].to_numpy()
    stop = np.maximum(np.searchsorted(plain.arrived - 0.01, late) - 1, 0)
    joints["temperature"] = 20.0 + 0.01 * late
    joints["force_x"], joints["force_y"], joints["force_z"] = late, -late, 2.0 * late
    joints["payload"] = np.where(np.arange(len(late)) % 3 == 0, 5.0, np.nan)
    joints["tool"] = np.where(stop < 6, "gripper", "brush")
    joints["mode"] = np.where(np.arange(len(late)) % 2 == 0, "even", "odd")
    joints["sample"] = np.arange(len(late))
    joints["x"], joints["y"], joints["z"] = 1.0, 2.0, 3.0 * late
    joints["std_force"] = 0.1
    joints["n"] = stop
    tracker["temperature"] = 30.0 + 0.02 * tracker["time"]
    tracker["tcp_x"], tracker["tcp_y"], tracker["tcp_z"] = 0.1, 0.2, tracker["time"]
    return joints, tracker


@pytest.fixture(scope="module")
def found(logs: tuple[pd.DataFrame, pd.DataFrame]) -> MergeResult:
    return join_logs(*logs, UR10, "tool0", leave_open, {})


def test_what_else_is_in_the_logs_changes_nothing_of_the_poses(plain: Made, found: MergeResult) -> None:
    bare = join_logs(plain.joints, plain.tracker, UR10, "tool0", leave_open, {}).table
    pd.testing.assert_frame_equal(found.table[bare.columns], bare)
    assert set(found.table) - set(bare) == {
        "temperature", "force_x", "force_y", "force_z", "payload", "tool", "joints_n", "tracker_temperature",
    }  # fmt: skip


def test_means_are_those_of_the_samples_in_each_window(
    plain: Made, found: MergeResult, logs: tuple[pd.DataFrame, pd.DataFrame]
) -> None:
    """By loops over the samples: what is linear in time has its value in the window's middle, by either clock."""
    table, (joints, tracker) = found.table, logs
    for k in range(len(table)):
        for log, name, title in (
            (joints, "temperature", "temperature"),
            (tracker, "temperature", "tracker_temperature"),
        ):
            begin, end = found.pairs.begin[k : k + 1], found.pairs.end[k : k + 1]
            if log is joints:
                begin, end = found.clocks.joints(begin), found.clocks.joints(end)
            samples = [v for t, v in zip(log["time"], log[name], strict=True) if begin[0] <= t <= end[0]]
            assert table[title][k] == pytest.approx(sum(samples) / len(samples), abs=1e-12)
    np.testing.assert_allclose(table["temperature"], 20.0 + 0.01 * table["time"], atol=1e-3)
    np.testing.assert_allclose(table["force_z"], 2.0 * table["time"], atol=0.2)
    np.testing.assert_allclose(table["payload"], 5.0)  # where it has any number
    assert table["tool"].tolist() == ["gripper"] * 6 + ["brush"] * 6
    assert table["joints_n"].tolist() == list(range(12))


def test_clashes_and_what_is_lost_are_said(found: MergeResult) -> None:
    said = "\n".join(found.notices)
    assert "column 'n' is called 'joints_n' in the table, which has a 'n' already" in said
    assert "column 'temperature' is called 'tracker_temperature'" in said
    assert "more than one label: mode" in said
    assert "carried over, the mean at each standstill: " in said


def test_a_table_with_them_is_a_campaign_with_covariates(
    found: MergeResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found.table.to_csv(tmp_path / "rows.csv", index=False)
    campaign = aridcal.propose(UR10, tmp_path / "rows.csv")
    said = capsys.readouterr().out
    assert "temperature" in said
    assert not campaign.measurements.ignore or "temperature" not in campaign.measurements.ignore
