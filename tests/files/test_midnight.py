"""Times of day that pass midnight: unrolled where nothing else can be meant, asked about otherwise, never sorted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots

import aridcal
from aridcal.files.campaign import load_campaign
from aridcal.jobs.calibrate.job_inputs import read_job
from aridcal.system.errors import MeasurementError
from aridcal.system.reading.dates import DAY, times_of_day, unrolled

EVENING = 23 * 3600.0


def clock(seconds: np.ndarray) -> list[str]:
    """As a person's table has them."""
    return [f"{int(s) // 3600 % 24:02d}:{int(s) // 60 % 60:02d}:{int(s) % 60:02d}" for s in seconds]


def knocked(n: int = 120, after: float = 0.8) -> tuple[robots.Truth, np.ndarray, np.ndarray]:
    """Rows from 23:00 on, one a minute; the base is knocked by 2 mm an hour and more after midnight, [s] from midnight on."""
    truth = robots.simulate(robots.ur10(), n, np.random.default_rng(3), noise=1e-4)
    time = EVENING + 60.0 * np.arange(n)
    late = np.arange(n) >= after * n
    shift = np.where(late[:, None], [2e-3, 0.0, 0.0], 0.0)
    return replace(truth, measured=robots.placed(truth.measured, position=truth.measured.position + shift)), time, late


STEPS = {"diagnosis": {"candidates": ["shift"]}}
"""Of all that is searched for, only what steps."""


@pytest.mark.parametrize("written", ["clock", "seconds"])
def test_a_knock_after_midnight_is_found_where_it_was_and_queries_at_night_are_of_the_machine_then(
    written: str, tmp_path: Path
) -> None:
    """Second road: the same rows with dates. Sorted by the time of day, the knock would stand in the middle of two pieces."""
    truth, time, late = knocked()
    when = {"clock": clock(time), "seconds": time % DAY}[written]
    columns: dict[str, object] = {"time": "when"}
    block = {"file": "measurements.csv", "kind": "pose", "columns": columns}
    if written == "clock":
        block["table"] = {"dates": {"order": "ymd", "columns": ["when"]}}
    rows = robots.table(truth).assign(when=when)
    cal = aridcal.calibrate(robots.write_campaign(tmp_path, truth, rows, measurements=block, **STEPS))
    found = cal.outcome
    assert found is not None
    steps = [c.basis for e in found.effects for c in e.effect.coefficients if c.basis.form == "step"]
    assert steps
    of = found.measurements.conditions[steps[0].of[0]]
    in_rows = found.measurements.as_read
    before = (of < steps[0].numbers[0])[in_rows]
    assert np.mean(before == ~late) > 0.95
    assert any("passes midnight" in str(notice) for notice in found.measurements.origin.notices)

    asked = pd.DataFrame(dict(zip(truth.model.robot.readings, truth.readings[-20:].T, strict=True)))
    at_night = cal.predict(asked.assign(when=when[-20:]))
    off = at_night[["x", "y", "z"]].to_numpy() - truth.measured.position[-20:]
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 5e-4
    assert at_night["extrapolates"].mean() < 0.5


def test_times_are_unrolled_once_and_else_left_or_asked_about() -> None:
    night = np.array([EVENING, EVENING + 1800, np.nan, 120.0, 3600.0])
    for of_day in (False, True):
        found = unrolled(night, of_day)
        assert found is not None
        np.testing.assert_array_equal(found, night + [0, 0, 0, DAY, DAY])
    days = np.tile(np.arange(9 * 3600.0, 17 * 3600.0, 600.0), 2)
    assert unrolled(days, of_day=True) is None  # two days' work: sorted, they would stand between one another
    assert unrolled(days, of_day=False) is days  # two logs that count from their start, perhaps
    nights = np.tile([EVENING, EVENING + 60, 60.0], 3)
    assert unrolled(nights, of_day=True) is None and unrolled(nights, of_day=False) is None
    assert unrolled(night + 1.7e9, of_day=False) is not None  # dates step back as they like
    np.testing.assert_array_equal(unrolled(night + 1.7e9, of_day=False), night + 1.7e9)
    mixed = np.random.default_rng(0).permutation(np.arange(0.0, 36000.0, 60.0))
    swapped = np.array([0.0, 120.0, 60.0, 180.0, 240.0, 300.0])
    assert unrolled(swapped, of_day=True) is swapped
    assert unrolled(mixed, of_day=True) is mixed  # in no order at all, within one working day


def test_a_table_of_two_days_without_dates_is_asked_about(tmp_path: Path) -> None:
    truth, _, _ = knocked(40)
    when = clock(np.tile(9 * 3600.0 + 600.0 * np.arange(20), 2))
    block = {"file": "measurements.csv", "kind": "pose", "columns": {"time": "when"}}
    block["table"] = {"dates": {"order": "ymd", "columns": ["when"]}}
    path = robots.write_campaign(tmp_path, truth, robots.table(truth).assign(when=when), measurements=block)
    with pytest.raises(MeasurementError, match=r"column 'when' steps back .* add the date"):
        read_job(load_campaign(path), 0)


def test_times_of_a_query_count_as_the_calibrations_do() -> None:
    asked = np.array([EVENING + 60, 60.0, 7200.0, np.nan, 12 * 3600.0])
    np.testing.assert_array_equal(times_of_day(asked, EVENING, DAY + 3600.0), asked + [0, DAY, 0, 0, 0])
    np.testing.assert_array_equal(times_of_day(asked, 0.0, 80000.0), asked)


def test_wanted_poses_need_no_time_that_no_effect_uses(tmp_path: Path) -> None:
    """Nor readings a list in which the campaign's own tables have something else."""
    truth, time, _ = knocked(40)
    rows = robots.table(truth).assign(when=clock(time))
    block = {"file": "measurements.csv", "kind": "pose", "columns": {"time": "when"}}
    block["table"] = {"separator": ";", "dates": {"order": "ymd", "columns": ["when"]}}
    path = robots.write_campaign(tmp_path, truth, rows, measurements=block)
    rows.to_csv(tmp_path / "measurements.csv", index=False, sep=";", float_format="%.17g")
    cal = aridcal.calibrate(path)
    wanted = rows[["x", "y", "z", "qx", "qy", "qz", "qw"]]
    wanted.to_csv(tmp_path / "wanted.csv", index=False, sep=";", float_format="%.17g")
    assert cal.compensate(tmp_path / "wanted.csv")["reached"].all()
