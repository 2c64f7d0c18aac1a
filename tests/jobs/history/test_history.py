"""`aridcal history`: false alarms as stated, drifts and jumps dated, seasons no alarm, tables of fleets read whole."""

from __future__ import annotations

import datetime
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet
import pytest
from scipy.stats import norm

import aridcal
from aridcal.__main__ import main
from aridcal.jobs.history.store import read_runs, tables_below
from aridcal.jobs.history.trend import YEAR, Cycle, Series, dated, evidence, with_cycle
from aridcal.jobs.history.wear import history
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.pages.history_page import MONTH, date
from aridcal.runs.fleet_history import FleetHistory
from aridcal.system.errors import AridcalError
from aridcal.system.writing.whole_files import atomic_folder

FIRST = datetime.datetime(2026, 1, 5)

CONSTANTS = ("joint_2.pitch", "joint_3.pitch", "joint_3.z", "joint_4.x", "joint_5.roll")


def days(n: int = 12, rng: np.random.Generator | None = None) -> np.ndarray:
    """Once a month, a few days earlier or later."""
    return MONTH * np.arange(n) + (0.0 if rng is None else rng.uniform(-4.0, 4.0, n))


def noise(rng: np.random.Generator, n: int = 12) -> Series:
    """Nothing but noise of unit sigma, which differs from run to run."""
    std = rng.uniform(0.8, 1.25, n)
    return Series(days(n, rng), std * rng.normal(size=n), std)


def cycle(day: np.ndarray, phase: float) -> np.ndarray:
    """A hall's temperature: a tenth of it has half the period."""
    angle = 2 * np.pi * (day / YEAR - phase)
    return 0.9 * np.cos(angle) + 0.1 * np.cos(2 * angle + 1.0)


# -- alarms


def test_p_values_are_not_smaller_than_stated_with_a_yearly_cycle_and_without() -> None:
    rng = np.random.default_rng(1)
    plain = np.array([evidence(noise(rng)).p_value for _ in range(1000)])
    cycling = []
    for _ in range(1000):
        series = noise(rng)
        wave = rng.uniform(0.0, 10.0) * np.cos(2 * np.pi * (series.day / YEAR - rng.uniform()))
        cycling.append(evidence(replace(series, value=series.value + wave)).p_value)
    for level in (0.2, 0.05, 0.01):
        most = 1000 * level + 3 * np.sqrt(1000 * level)
        assert np.sum(plain < level) <= most
        assert np.sum(np.array(cycling) < level) <= most
    assert np.sum(plain < 0.2) > 50  # nor so much larger that nothing would ever be found


def test_who_looks_every_month_has_no_more_false_alarms_than_stated() -> None:
    rng = np.random.default_rng(2)
    level, alarmed, count = 0.2, 0, 250
    for _ in range(count):
        series = noise(rng)
        looks = [Series(series.day[:n], series.value[:n], series.std[:n]) for n in range(2, 13)]
        alarmed += any(12 * evidence(look).p_value < level for look in looks)
    assert alarmed <= count * level + 3 * np.sqrt(count * level)


def test_the_p_value_is_that_of_the_estimate_in_a_fit_with_all_columns_at_once() -> None:
    """By a second road: no cycle, so that nothing is allowed for its shape, and a jump that is larger than all else."""
    rng = np.random.default_rng(3)
    series = noise(rng)
    jump = (np.arange(12) >= 5).astype(float)
    always = with_cycle(series.day)
    A = np.column_stack([always, jump]) / series.std[:, None]
    left = series.value - always @ np.linalg.lstsq(A, series.value / series.std, rcond=None)[0][:3]
    series = replace(series, value=left + 15.0 * jump)
    found = evidence(series)
    column = (np.arange(12) >= 5).astype(float)
    A = np.column_stack([with_cycle(series.day), column]) / series.std[:, None]
    covariance = np.linalg.inv(A.T @ A)
    z = (covariance @ (A.T @ (series.value / series.std)))[-1] / np.sqrt(covariance[-1, -1])
    assert found.p_value == pytest.approx(2 * found.shapes * norm.sf(abs(z)), rel=0.05)


def test_a_season_that_is_no_sine_is_no_alarm_however_large() -> None:
    for size in (5.0, 20.0, 100.0):
        for phase in np.arange(0.0, 1.0, 0.125):
            rng = np.random.default_rng(4)
            series = noise(rng)
            series = replace(series, value=series.value + size * cycle(series.day, phase))
            assert 2000 * 12 * evidence(series).p_value > FALSE_ALARMS


def test_a_few_runs_cannot_tell_a_drift_from_the_season() -> None:
    series = Series(days(4), np.array([0.0, 10.0, 20.0, 30.0]), np.ones(4))
    assert evidence(series).p_value == 1.0
    assert evidence(series).p_any < 1e-6


# -- dates


@pytest.mark.parametrize(("kind", "begins", "size"), [("drift", 3.5, 4.0), ("drift", 7.2, 5.0), ("jump", 5.5, 12.0)])
def test_a_change_is_found_and_dated_and_its_interval_holds_the_truth(kind: str, begins: float, size: float) -> None:
    rng = np.random.default_rng(5)
    off, held, called = [], [], []
    for _ in range(40):
        series = noise(rng)
        late = series.day - begins * MONTH
        more = np.maximum(late, 0.0) / MONTH if kind == "drift" else (late > 0.0).astype(float)
        series = replace(series, value=series.value + size * more)
        assert evidence(series).p_value < 1e-6
        change = dated(series, Cycle((0.0, 0.0), (0.2, 0.2)))
        off.append(abs(change.began / MONTH - begins))
        held.append(change.low <= begins * MONTH <= change.high)
        called.append(change.kind == kind)
        if change.kind == kind:
            per = MONTH if kind == "drift" else 1.0
            assert abs(per * change.size - size) < 5 * per * change.std + 0.2 * size
    assert np.quantile(off, 0.9) < 1.0
    assert np.mean(held) >= 0.85
    assert np.mean(called) >= 0.9


def test_one_odd_run_is_called_so() -> None:
    rng = np.random.default_rng(6)
    series = noise(rng)
    value = series.value.copy()
    value[6] += 20.0
    change = dated(replace(series, value=value))
    assert change.kind == "odd run"
    assert change.began == series.day[6]
    assert change.so_far == 0.0


# -- fleets


def row(robot: str, day: float, constants: dict[str, tuple[float, float]], **other: Any) -> dict[str, Any]:
    """One run, as a fleet's table has it."""
    when = FIRST + datetime.timedelta(days=day)
    own = [{"name": n, "value": v, "std": s, "unit": "rad", "status": "identified"} for n, (v, s) in constants.items()]
    base = {"name": "world_base.x", "value": day, "std": 1e-6, "unit": "m", "status": "identified"}
    dropped = {"name": "joint_1.yaw", "value": 0.0, "std": None, "unit": "rad", "status": "redundant"}
    stages = [
        {"stage": stage, "channel": "position_mm", "rms": rms, "p95": 2 * rms, "max": 3 * rms}
        for stage, rms in (("nominal", 2.0), ("geometric", 0.1), ("final", 0.1))
    ]
    return {
        "robot": robot, "campaign": robot, "key": f"{robot}{day}", "inputs": f"{robot}{day}", "urdf": "a", "time": when,
        "measured": when, "version": "1", "status": "done", "error": None, "rows": 60, "verdict": "noise_floor",
        "seconds": 1.0, "stages": stages, "effects": [], "constants": [base, *own, dropped], "notices": [],
    } | other  # fmt: skip


def listed(texts: tuple[str, ...], numbers: tuple[str, ...]) -> pa.DataType:
    """A list of structs."""
    return pa.list_(pa.struct([*((name, pa.string()) for name in texts), *((name, pa.float64()) for name in numbers)]))


SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("robot", "campaign", "key", "inputs", "urdf")),
        ("time", pa.timestamp("ms", "UTC")),
        ("measured", pa.timestamp("ms", "UTC")),
        *((name, pa.string()) for name in ("version", "status", "error")),
        ("rows", pa.int64()),
        ("verdict", pa.string()),
        ("seconds", pa.float64()),
        ("stages", listed(("stage", "channel"), ("rms", "p95", "max"))),
        ("effects", listed(("name",), ("value",))),
        ("constants", listed(("name", "unit", "status"), ("value", "std"))),
        ("notices", pa.list_(pa.string())),
    ]
)


def write(rows: list[dict[str, Any]], folder: Path) -> None:
    with atomic_folder(folder, {"fleet.parquet"}) as stage:
        pa.parquet.write_table(pa.Table.from_pylist(rows, SCHEMA), stage / "fleet.parquet")


def fleet(seed: int = 0, robots: int = 12, scatter: float = 1.0, wear: dict[str, float] | None = None) -> list[dict]:
    """A year of some robots; ``wear`` is the drift a month of the third joint's zero from month 5 on, by robot, in sigmas."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(robots):
        robot = f"r{number:02d}"
        true = rng.normal(0.0, 1e-3, len(CONSTANTS))
        for day in days(12, rng):
            season = 3e-5 * float(cycle(np.array([day]), 0.3)[0])
            late = max(day / MONTH - 5.0, 0.0) * (wear or {}).get(robot, 0.0) * 1e-5
            value = true + 1e-5 * scatter * rng.normal(size=len(CONSTANTS)) + season * (np.arange(len(CONSTANTS)) == 2)
            value[1] += late
            rows.append(row(robot, day, {n: (float(v), 1e-5) for n, v in zip(CONSTANTS, value, strict=True)}))
    return rows


@pytest.fixture(scope="module")
def worn(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FleetHistory]:
    """A fleet of which one robot wears, and what its history says."""
    folder = tmp_path_factory.mktemp("worn")
    write(fleet(wear={"r07": 6.0}), folder)
    return folder, aridcal.history(folder)


def test_the_robot_that_wears_is_named_first_with_its_zero_and_the_month(worn: tuple[Path, FleetHistory]) -> None:
    found = history(read_runs(worn[0]))
    assert found.robots[0].name == "r07"
    assert [(w.robot, w.name) for robot in found.robots for w in robot.alarms] == [("r07", "joint_3.pitch")]
    change = found.robots[0].alarms[0].change
    assert change is not None
    assert change.kind == "drift"
    truth = pd.Timestamp(FIRST).timestamp() / 86400 + 5 * MONTH
    assert change.low <= truth <= change.high
    assert abs(change.began - truth) < MONTH
    assert found.series == 12 * len(CONSTANTS)  # the base is no constant of the arm, and what is redundant is none


def test_a_season_that_all_share_is_no_alarm_and_is_said_to_be_perhaps_one(tmp_path: Path) -> None:
    write(fleet(), tmp_path)
    found = history(read_runs(tmp_path))
    assert not any(robot.alarms for robot in found.robots)
    assert {w.name for robot in found.robots for w in robot.cycles} <= {"joint_3.z"}


def test_more_scatter_than_sigma_says_is_no_alarm(tmp_path: Path) -> None:
    write(fleet(seed=1, scatter=3.0), tmp_path)
    found = history(read_runs(tmp_path))
    assert not any(robot.alarms for robot in found.robots)
    assert all(2.0 < value < 4.0 for value in found.scatter.values())


def test_runs_in_another_gauge_are_left_out_and_named(tmp_path: Path) -> None:
    """Two months told one constant less: what it stood for went to the others, which is no change of the robot."""
    rows = fleet(robots=1)
    for each in rows[4:6]:
        each["constants"] = [{**c, "value": c["value"] + 1e-3} for c in each["constants"] if c["name"] != "joint_4.x"]
    rows[8]["urdf"] = "b"
    write(rows, tmp_path)
    (robot,) = history(read_runs(tmp_path)).robots
    assert robot.alarms == ()
    assert all(len(w.series.day) == 9 for w in robot.watched)
    assert robot.notices[0].startswith("3 of 12 runs told other constants")


def test_of_two_runs_on_one_measurement_the_last_counts_and_failed_ones_are_counted(tmp_path: Path) -> None:
    rows = fleet(robots=2)
    later = rows[3] | {"key": "other", "time": FIRST + datetime.timedelta(days=900), "version": "2", "rows": 61}
    failed = rows[5] | {
        "key": "again",
        "time": FIRST + datetime.timedelta(days=901),
        "status": "failed",
        "constants": [],
    }
    new = row("r01", 400.0, {}, status="failed", error="the table is empty", stages=[])
    write(rows, tmp_path / "one")
    write([later, failed, new], tmp_path / "two" / "deep")
    found = read_runs(tmp_path)
    assert len(found.files) == 2
    assert len(found.runs) == 25
    assert found.runs.loc[found.runs["version"] == "2", "rows"].tolist() == [61]
    robots = {robot.name: robot for robot in history(found).robots}
    assert robots["r00"].notices == ()
    assert robots["r01"].notices == ("1 of 13 runs failed: the table is empty",)
    # by a second road, without DuckDB: the numbers are those of the file
    mine = found.constants[found.constants["run"] == 1].set_index("name")["value"]
    assert mine.to_dict() == {c["name"]: c["value"] for c in rows[0]["constants"][1:-1]}


# -- files


def test_a_reader_never_sees_half_of_a_table_that_is_being_replaced(tmp_path: Path) -> None:
    small, large = fleet(robots=1), fleet(robots=3)
    write(small, tmp_path)
    stop = threading.Event()

    def replaced() -> None:
        k = 0
        while not stop.is_set():
            write((small, large)[k % 2], tmp_path)
            write(small, tmp_path / f"run-{k % 3}")
            k += 1

    writer = threading.Thread(target=replaced)
    writer.start()
    try:
        seen = {len(read_runs(tmp_path).runs) for _ in range(10)}
    finally:
        stop.set()
        writer.join()
    assert seen <= {12, 36}


def test_what_is_half_written_is_hidden_and_what_is_no_table_is_named(tmp_path: Path, capsys) -> None:
    write(fleet(robots=1), tmp_path / "a[1]*")
    (tmp_path / ".half").mkdir()
    (tmp_path / ".half" / "fleet.parquet").write_bytes(b"PAR1")
    assert [path.parent.name for path in tables_below(tmp_path)] == ["a[1]*"]
    assert len(read_runs(tmp_path).runs) == 12
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "fleet.parquet").write_bytes(b"PAR1")
    assert main(["history", str(tmp_path)]) == 2
    assert "b/fleet.parquet: cannot be read" in capsys.readouterr().err
    pa.parquet.write_table(pa.table({"robot": ["a"]}), tmp_path / "b" / "fleet.parquet")
    with pytest.raises(AridcalError, match=r"b/fleet.parquet: is no table of a fleet: it lacks constants, error"):
        read_runs(tmp_path)


def test_nothing_there_no_such_robot_and_no_duckdb_are_said(tmp_path: Path, monkeypatch, capsys) -> None:
    assert main(["history", str(tmp_path)]) == 2
    assert "there is no fleet.parquet in it" in capsys.readouterr().err
    write(fleet(robots=2), tmp_path)
    assert main(["history", str(tmp_path), "r2"]) == 2
    assert "no robot of this name was calibrated" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "duckdb", None)
    assert main(["history", str(tmp_path)]) == 2
    assert 'pip install "aridcal[fleet]"' in capsys.readouterr().err


def test_the_command_writes_a_page_and_a_table_and_says_alarms_by_its_status(
    worn: tuple[Path, FleetHistory], tmp_path: Path, capsys
) -> None:
    folder, found = worn
    assert main(["history", str(folder), "-o", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().out
    assert "r07: joint_3.pitch drifts since 2026-0" in said
    assert main(["history", str(folder), "r01"]) == 0
    page = (tmp_path / "out" / "history.html").read_text()
    assert "1 of 12 robots changed" in page
    assert 'aria-label="joint_3.pitch of r07 over time' in page
    table = pd.read_csv(tmp_path / "out" / "history.csv")
    assert len(table) == 12 * 12 * len(CONSTANTS)
    assert found.alarms["robot"].tolist() == ["r07"]
    assert found.alarms["size"].tolist()[0] == pytest.approx(6e-5, rel=0.2)
    assert found.robots["robot"].tolist()[0] == "r07"
    assert len(found.errors) == 12 * 12 * 3
    assert date(0.0) == "1970-01-01"
    assert repr(found).startswith("r07: ")
