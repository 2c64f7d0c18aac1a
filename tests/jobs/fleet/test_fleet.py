"""Fleets: each robot computed once, whatever dies; failures apart; a table and a page that say what is so."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import Context
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest
import yaml
from deadly_work import slow_or_deadly
from repository import ROOT

import aridcal
from aridcal.files.campaign import load_campaign
from aridcal.files.yaml_file import load_settings
from aridcal.fleet import main
from aridcal.jobs.fleet import work
from aridcal.jobs.fleet.cluster import dask_engine
from aridcal.jobs.fleet.keys import files_of, inputs_of
from aridcal.jobs.fleet.local_engine import EngineGone, WorkFailure, run_tasks
from aridcal.jobs.fleet.members import members
from aridcal.jobs.fleet.run_record import RUN_SCHEMA, row_of_folder
from aridcal.jobs.fleet.run_table import merged, read_rows
from aridcal.jobs.fleet.runs import FleetPlan, FleetResults, computed, plan_runs
from aridcal.jobs.fleet.work import Task, calibrated
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.pages.fleet_page import fleet_page
from aridcal.runs.result_folder import write_folder
from aridcal.system.errors import AridcalError, CampaignError, OutputError
from aridcal.system.progress import SILENT, Progress, duration
from aridcal.system.writing.whole_files import claimed


def made(folder: Path, seed: int, n: int = 40, beta: float = 2e-3) -> Path:
    """A robot that is calibrated within a second: position alone, no search."""
    text = {
        "format": 1,
        "robot": {"urdf": str(ROOT / "urdf" / "arid.urdf"), "tip": "flange"},
        "measurements": {"kind": "pose", "noise": {"position": 1e-4, "rotation": 1e-4}},
        "parameters": {"set": "angles"},
        "diagnosis": {"enabled": False},
        "truth": {
            "n": n,
            "seed": seed,
            "parameters": {"joint_2.beta": beta},
            "noise": {"position": 1e-4, "rotation": 1e-4},
        },
    }
    folder.mkdir(parents=True)
    path = folder.with_suffix(".yaml")  # elsewhere, so that the robot comes along
    path.write_text(yaml.safe_dump(text))
    write_campaign(simulate(load_settings(path, Scenario)), folder, folder)
    path.unlink()
    return folder / "campaign.yaml"


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three robots and their fleet, computed once in this process."""
    home = tmp_path_factory.mktemp("plant")
    for k in range(3):
        made(home / "robots" / f"arm-{k}", seed=k)
    run_here(home)
    return home


@pytest.fixture
def plant(three: Path, tmp_path: Path) -> Path:
    """A copy of them that a test may spoil."""
    shutil.copytree(three, tmp_path / "plant")
    return tmp_path / "plant"


def plan(home: Path, pattern: str = "robots/*/campaign.yaml") -> FleetPlan:
    return plan_runs(members([str(home / pattern)], home / "fleet"), home / "fleet", write_folder, SILENT)


def run_here(home: Path, engine: Any = run_tasks) -> FleetResults:
    (home / "fleet").mkdir(exist_ok=True)
    return computed(plan(home), engine, SILENT)


def never(work: Callable[[Any], Any], tasks: Mapping[str, Any]) -> Iterator[Any]:
    """An engine that must not be asked for anything."""
    assert not tasks
    yield from ()


def test_each_robot_has_its_result_folder_and_its_row(three: Path) -> None:
    rows = read_rows(three / "fleet")
    assert sorted(row["robot"] for row in rows) == ["arm-0", "arm-1", "arm-2"]
    for row in rows:
        folder = three / "fleet" / row["robot"]
        found = json.loads((folder / "result.json").read_text())
        assert json.loads((folder / "fleet.json").read_text()) == row
        assert (row["status"], row["error"], row["verdict"], row["rows"]) == ("done", None, found["verdict"], 40)
        for stage in row["stages"]:
            assert stage["rms"] == found["error"][stage["stage"]]["test"][stage["channel"]]["rms"]
        assert {(s["stage"], s["channel"]) for s in row["stages"]} == {
            (stage, channel) for stage in found["error"] for channel in found["error"][stage]["test"]
        }
        kept = ("name", "value", "std", "unit", "status")
        assert [{key: c[key] for key in kept} for c in row["constants"]] == [
            {key: p[key] for key in kept} for p in found["parameters"]
        ]


def test_the_table_has_the_columns_that_the_formats_promise(three: Path) -> None:
    text = (ROOT / "docs" / "formats.md").read_text("utf-8").split("## 8. A fleet's folder")[1]
    table = pyarrow.parquet.read_table(three / "fleet" / "fleet.parquet")
    assert table.schema.names == RUN_SCHEMA.names
    for field in RUN_SCHEMA:
        assert f"| `{field.name}` |" in text
        if str(field.type).startswith("list<item: struct"):
            line = next(line for line in text.splitlines() if line.startswith(f"| `{field.name}` |"))
            assert [name for name in (f.name for f in field.type.value_type) if f"`{name}`" not in line] == []


def test_duckdb_reads_it_as_the_formats_say(three: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    text = (ROOT / "docs" / "formats.md").read_text("utf-8")
    query = text.split("```sql\n")[1].split("```")[0].replace("DIR", str(three / "fleet"))
    names = {row[2] for row in duckdb.sql(query).fetchall()}
    assert "joint_2.beta" in names


def test_nothing_is_computed_twice(plant: Path) -> None:
    before = read_rows(plant / "fleet")
    ran = run_here(plant, never)
    assert sorted(ran.kept) == ["arm-0", "arm-1", "arm-2"]
    assert read_rows(plant / "fleet") == before


def test_another_input_is_another_run_and_earlier_rows_stay(plant: Path) -> None:
    keys = set()
    for changed in ("measurements.csv", "campaign.yaml", "arid.urdf"):
        with (plant / "robots" / "arm-1" / changed).open("a") as file:
            file.write("\n")
        asked = plan(plant)
        assert [task.robot for task in asked.tasks.values()] == ["arm-1"]
        keys |= {task.key for task in asked.tasks.values()}
    assert len(keys) == 3
    ran = computed(asked, run_tasks, SILENT)
    assert [row["robot"] for row in ran.rows].count("arm-1") == 2
    assert len({row["key"] for row in ran.rows}) == 4


def test_another_version_computes_everything_again(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aridcal.jobs.fleet.keys.__version__", "99.0")
    asked = plan(plant)
    assert len(asked.tasks) == 3
    assert {i.inputs for i in asked.inputs.values()} == {row["inputs"] for row in asked.rows}


def test_the_key_does_not_depend_on_where_a_plant_lies(plant: Path, three: Path) -> None:
    a, b = (inputs_of(load_campaign(home / "robots" / "arm-0" / "campaign.yaml")) for home in (plant, three))
    assert a == b


def test_every_file_that_a_campaign_may_name_counts(tmp_path: Path) -> None:
    path = tmp_path / "campaign.yaml"
    text = """format: 1
robot: {urdf: r.urdf, tip: t}
measurements:
  - {kind: point, file: [a.csv, b.parquet]}
  - {kind: pixels, file: c.csv}
instruments:
  points: p.csv
  cameras: {eye: {width: 640, height: 480, fx: 700, fy: 700, cx: 320, cy: 240}}
  markers: {file: m.csv}
region: {file: g.csv}
"""
    path.write_text(text)
    campaign = load_campaign(path)
    named = {file.name for _, file in files_of(campaign)}
    assert named == {"r.urdf", "a.csv", "b.parquet", "c.csv", "p.csv", "m.csv", "g.csv"}
    keys = {inputs_of(campaign).key}
    for name in sorted(named):
        (tmp_path / name).write_text("anything")
        keys.add(inputs_of(campaign).key)
    assert len(keys) == 8


def test_a_robot_that_fails_is_named_with_its_reason_and_costs_no_other(plant: Path) -> None:
    (plant / "robots" / "arm-0" / "campaign.yaml").write_text("format: 1\nnonsense: 1\n")
    table = plant / "robots" / "arm-2" / "measurements.csv"
    table.write_text(table.read_text().replace("x", "xx", 1))
    (plant / "robots" / "arm-1" / "campaign.yaml").open("a").write("# again\n")
    before = (plant / "fleet" / "arm-2" / "result.json").read_bytes()
    ran = run_here(plant)
    assert sorted(ran.failed) == ["arm-0", "arm-2"]
    assert "nonsense" in ran.failed["arm-0"]
    assert "no column 'x'" in ran.failed["arm-2"]
    assert (plant / "fleet" / "arm-2" / "result.json").read_bytes() == before
    status = {(row["robot"], row["status"]) for row in read_rows(plant / "fleet")[-3:]}
    assert status == {("arm-0", "failed"), ("arm-1", "done"), ("arm-2", "failed")}
    page = fleet_page(ran, "plant")
    assert "1 of 3 robots calibrated" in page
    assert "nonsense" in page


def test_a_failure_does_not_take_the_place_of_a_result() -> None:
    done = {
        "robot": "a",
        "key": "k",
        "status": "done",
        "time": "2026-01-01T00:00:00+00:00",
        "measured": "2026-01-01T00:00:00+00:00",
    }
    failed = done | {"status": "failed", "time": "2026-01-02T00:00:00+00:00"}
    assert merged([done], [failed]) == [done]
    assert merged([failed], [done]) == [done]
    assert merged([failed], [failed | {"error": "later"}]) == [failed | {"error": "later"}]


def test_a_killed_fleet_leaves_rows_in_its_folders_which_the_next_one_takes_up(plant: Path) -> None:
    before = read_rows(plant / "fleet")
    (plant / "fleet" / "fleet.parquet").unlink()
    ran = run_here(plant, never)
    assert list(ran.rows) == before


@pytest.mark.parametrize("spoilt", ["{", "[]", '{"robot": 3}', ""])
def test_a_row_that_cannot_be_read_is_no_row(plant: Path, spoilt: str) -> None:
    (plant / "fleet" / "arm-0" / "fleet.json").write_text(spoilt)
    assert row_of_folder(plant / "fleet" / "arm-0") is None
    assert [task.robot for task in plan(plant).tasks.values()] == ["arm-0"]


def test_a_result_without_its_figures_is_computed_again(plant: Path) -> None:
    (plant / "fleet" / "arm-0" / "result.json").unlink()
    assert [task.robot for task in plan(plant).tasks.values()] == ["arm-0"]


def test_what_stands_in_the_place_of_the_table_is_not_overwritten(plant: Path) -> None:
    table = plant / "fleet" / "fleet.parquet"
    table.write_text("my notes")
    with pytest.raises(OutputError, match="no table of this fleet"):
        plan(plant)
    assert table.read_text() == "my notes"


def task_of(plant: Path, robot: str, key: str | None = None) -> Task:
    campaign = plant / "robots" / robot / "campaign.yaml"
    out = plant / "fleet" / robot
    return Task(robot, str(campaign), str(out), key or inputs_of(load_campaign(campaign)).key, write_folder)


def test_a_worker_takes_the_result_of_one_that_died_after_writing(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "identify", lambda *_, **__: pytest.fail("computed twice"))
    row = calibrated(task_of(plant, "arm-0"))
    assert row == row_of_folder(plant / "fleet" / "arm-0")


def test_a_worker_waits_for_one_that_was_thought_dead_and_takes_its_result(
    plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = plant / "fleet" / "arm-0"
    kept = (out / "fleet.json").read_text()
    (out / "fleet.json").unlink()
    code = (
        "import sys, time; from pathlib import Path; from aridcal.system.writing.whole_files import claimed\n"
        "out = Path(sys.argv[1])\n"
        "with claimed(out, 'folder'):\n"
        "    print('held', flush=True); sys.stdin.readline(); (out / 'fleet.json').write_text(sys.argv[2])\n"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", code, str(out), kept], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdin is not None and other.stdout is not None
    assert other.stdout.readline() == "held\n"
    waits = []

    def look_again(seconds: float) -> None:
        if not waits:
            other.stdin.write("\n")
            other.stdin.flush()
        waits.append(seconds)
        other.wait()

    monkeypatch.setattr(work.time, "sleep", look_again)
    monkeypatch.setattr(work, "identify", lambda *_, **__: pytest.fail("computed twice"))
    assert calibrated(task_of(plant, "arm-0"))["status"] == "done"
    assert waits


def test_files_that_change_under_the_work_make_the_robot_fail(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = task_of(plant, "arm-0")
    (plant / "fleet" / "arm-0" / "fleet.json").unlink()
    before = (plant / "fleet" / "arm-0" / "result.json").read_bytes()
    found = work.identify

    def disturbed(*args: Any, **more: Any) -> Any:
        outcome = found(*args, **more)
        (plant / "robots" / "arm-0" / "measurements.csv").open("a").write("\n")
        return outcome

    monkeypatch.setattr(work, "identify", disturbed)
    row = calibrated(task)
    assert row["status"] == "failed"
    assert "not those that the fleet was started with" in row["error"]
    assert row["key"] == task.key
    assert (plant / "fleet" / "arm-0" / "result.json").read_bytes() == before


@pytest.mark.parametrize(("number", "tries"), [(5, 2), (116, 2), (2, 1), (13, 1)])
def test_a_disk_that_fails_is_tried_once_more_and_a_file_that_is_not_there_is_not(
    plant: Path, monkeypatch: pytest.MonkeyPatch, number: int, tries: int
) -> None:
    calls = []

    def fails(*_: Any, **__: Any) -> Any:
        calls.append(1)
        raise AridcalError("measurements.csv: cannot be read") from OSError(number, os.strerror(number))

    monkeypatch.setattr(work, "identify", fails)
    monkeypatch.setattr(work.time, "sleep", lambda _: None)
    row = calibrated(task_of(plant, "arm-0", "another key"))
    assert row["status"] == "failed"
    monkeypatch.setattr(work, "_check", lambda *_: None)
    row = calibrated(task_of(plant, "arm-0", "another key"))
    assert (row["status"], row["error"], len(calls)) == ("failed", "measurements.csv: cannot be read", tries)


def test_a_bug_at_one_robot_is_that_robots_alone(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(2):
        (plant / "robots" / f"arm-{k}" / "campaign.yaml").open("a").write("# again\n")
    found = work.identify
    monkeypatch.setattr(
        work, "identify", lambda campaign, **more: 1 / 0 if "arm-0" in str(campaign.path) else found(campaign, **more)
    )
    ran = run_here(plant)
    assert ran.failed == {"arm-0": "ZeroDivisionError: division by zero"}
    assert [(row["robot"], row["status"]) for row in ran.rows[-2:]] == [("arm-0", "failed"), ("arm-1", "done")]


def test_an_engine_that_goes_leaves_what_is_done_and_names_what_remains(plant: Path) -> None:
    for k in range(3):
        (plant / "robots" / f"arm-{k}" / "campaign.yaml").open("a").write("# again\n")

    def leaves(work: Callable[[Any], Any], tasks: Mapping[str, Any]) -> Iterator[Any]:
        name = next(iter(tasks))
        yield name, work(tasks[name])
        raise EngineGone("the scheduler is gone")

    ran = run_here(plant, leaves)
    assert (ran.remaining, ran.gone) == (("arm-1", "arm-2"), "the scheduler is gone")
    assert len(read_rows(plant / "fleet")) == 4
    assert [task.robot for task in plan(plant).tasks.values()] == ["arm-1", "arm-2"]


# -- which robots


def test_robots_are_called_as_their_folders(tmp_path: Path) -> None:
    for name in ("b/arm [2]", "a/arm-1"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "campaign.yaml").touch()
    found = members([str(tmp_path / "*/*/campaign.yaml")], tmp_path / "out")
    assert [m.name for m in found] == ["arm [2]", "arm-1"]
    assert members([str(tmp_path / "b/arm [2]/campaign.yaml")], tmp_path / "out") == found[:1]


def test_two_robots_of_one_name_are_refused_and_one_named_twice_is_one(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name / "arm").mkdir(parents=True)
        (tmp_path / name / "arm" / "campaign.yaml").touch()
    once = str(tmp_path / "a" / "arm" / "campaign.yaml")
    assert len(members([once, f"{tmp_path}/a/../a/arm/campaign.yaml"], tmp_path / "out")) == 1
    with pytest.raises(CampaignError, match=r"two robots would be called 'arm': .*a/arm.*b/arm.*rename one"):
        members([str(tmp_path / "*/arm/campaign.yaml")], tmp_path / "out")


@pytest.mark.parametrize(("pattern", "out", "said"), [
    ("nowhere/*.yaml", "out", "no campaign fits"),
    ("r/arm/campaign.yaml", "r", "would stand among its inputs"),
    ("r/fleet.html/campaign.yaml", "out", "cannot be called 'fleet.html'"),
    ("r/.hidden/campaign.yaml", "out", "cannot be called '.hidden'"),
])  # fmt: skip
def test_what_cannot_be_a_fleet_is_refused(tmp_path: Path, pattern: str, out: str, said: str) -> None:
    for name in ("arm", "fleet.html", ".hidden"):
        (tmp_path / "r" / name).mkdir(parents=True)
        (tmp_path / "r" / name / "campaign.yaml").touch()
    with pytest.raises(CampaignError, match=said):
        members([str(tmp_path / pattern)], tmp_path / out)


# -- the command


def test_two_fleets_in_one_folder_are_refused(plant: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [str(plant / "robots/*/campaign.yaml"), "-o", str(plant / "fleet")]
    with claimed(plant / "fleet", "folder"):
        assert Context().run(main, words) == 2  # as another thread would: it does not hold the claim
    assert "is being written by this very process, in another thread" in capsys.readouterr().err


def test_history_reads_what_the_fleet_wrote_month_by_month(tmp_path: Path) -> None:
    pytest.importorskip("duckdb")

    def noted(outcome: Any, folder: Path, *, beside: Mapping[str, str]) -> None:
        """A result folder as far as a fleet looks into it."""
        folder.mkdir(exist_ok=True)
        for name, text in {"result.json": "", "calibration.yaml": "", **beside}.items():
            (folder / name).write_text(text)

    (tmp_path / "fleet").mkdir()
    for month in range(3):
        for k in (1,) if month == 1 else (0, 1):
            path = made(tmp_path / str(month) / f"arm-{k}", seed=10 * month + k, beta=2e-3 + 1e-3 * month * k)
            path.open("a").write(f'about: {{date: "2026-0{month + 1}-15"}}\n')
        pattern = members([str(tmp_path / str(month) / "*" / "campaign.yaml")], tmp_path / "fleet")
        ran = computed(plan_runs(pattern, tmp_path / "fleet", noted, SILENT), run_tasks, SILENT)
    found = aridcal.history(tmp_path)
    assert dict(zip(found.robots["robot"], found.robots["runs"], strict=True)) == {"arm-0": 2, "arm-1": 3}
    wears = found.constants.query("robot == 'arm-1' and name == 'joint_2.beta'")
    assert [f"{day:%Y-%m-%d}" for day in wears["measured"]] == ["2026-01-15", "2026-02-15", "2026-03-15"]
    assert wears["value"].tolist() == pytest.approx([2e-3, 3e-3, 4e-3], abs=5 * float(wears["std"].max()))
    table = pyarrow.parquet.read_table(tmp_path / "fleet" / "fleet.parquet")
    assert len(found.constants) == sum(
        c["status"] == "identified" and not c["name"].startswith(("world_base", "tip_target"))
        for row in table.to_pylist()
        for c in row["constants"]
    )
    page = fleet_page(ran, "plant")
    assert "<strong>moved</strong>" in page.split("<h2>Constants that drift")[1].split("joint_2.beta")[1]


def test_python_has_what_the_command_writes(plant: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of an arm that fails, too; and a file named once or twice is one robot."""
    (plant / "robots" / "arm-1" / "campaign.yaml").write_text("format: 1\nnonsense: 1\n")
    said: list[str] = []
    patterns = [plant / "robots" / "arm-0" / "campaign.yaml", f"{plant}/robots/*/campaign.yaml"]
    run = aridcal.fleet(patterns, plant / "fleet", progress=said.append)
    assert main([f"{plant}/robots/*/campaign.yaml", "-o", str(plant / "fleet")]) == 3
    written = capsys.readouterr().out
    assert said[-1] == "drawing the page"
    assert "\n".join(run.lines) == repr(run) and repr(run) in written
    rows = {row["robot"]: row for row in read_rows(plant / "fleet")}
    assert list(run.failed) == ["arm-1"] and "nonsense" in run.failed["arm-1"]
    robots = run.robots.set_index("robot")
    assert robots.index[-1] == "arm-1" and robots.loc["arm-1", "status"] == "failed"
    assert robots["final_position_mm"][:2].is_monotonic_decreasing
    for robot in ("arm-0", "arm-2"):
        rms = {f"{s['stage']}_{s['channel']}": s["rms"] for s in rows[robot]["stages"]}
        assert robots.loc[robot, list(rms)].to_dict() == rms
        own = run.constants.query("robot == @robot").drop(columns="robot")
        assert own["value"].tolist() == [c["value"] for c in rows[robot]["constants"]]
        assert list(own) == [*rows[robot]["constants"][0]]
    assert len(run.effects) == len(run.standing_out) == len(run.drifts) == 0
    assert "std" in run.effects and "times" in run.standing_out and "beyond" in run.drifts


def test_a_script_without_a_guard_is_not_run_again_in_each_worker(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import multiprocessing\nfrom aridcal.jobs.fleet.cluster import _main_unseen\nprint('here', flush=True)\n"
        "with _main_unseen():\n"
        "    worker = multiprocessing.get_context('spawn').Process(target=print, args=('works',))\n"
        "    worker.start()\n    worker.join()\nprint(__file__ is not None, __spec__, worker.exitcode)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n") == ["here", "works", "True None 0", ""]


@contextmanager
def on_one_core() -> Iterator[None]:
    """A fleet starts a worker for each core, and one is enough."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def test_workers_of_this_computer_leave_the_c_library_its_own_ways_with_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_", raising=False)
    with on_one_core(), dask_engine(None, SILENT) as engine:
        answers = dict(engine(os.getenv, {"trims": "MALLOC_TRIM_THRESHOLD_", "threads": "OMP_NUM_THREADS"}))
    assert answers == {"trims": None, "threads": "1"}


def test_a_fleet_that_is_done_needs_no_cluster_and_says_so(plant: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = plant / "fleet"
    words = [str(plant / "robots/*/campaign.yaml"), "-o", str(out), "--scheduler", "tcp://127.0.0.1:9"]
    assert main(words) == 0
    assert "3 of 3 robots done, 3 of them known already" in capsys.readouterr().out
    assert "3 of 3 robots calibrated" in (out / "fleet.html").read_text()
    (plant / "robots" / "arm-1" / "campaign.yaml").write_text("format: 1\n")
    assert main(words) == 3
    told = capsys.readouterr().out
    assert "2 of 3 robots done" in told
    assert "\n  arm-1: " in told


@pytest.mark.parametrize(
    ("address", "said"), [("nonsense", "no address of a scheduler"), ("tcp://127.0.0.1:9", "no scheduler answers")]
)
def test_a_scheduler_that_is_none_is_bad_use(address: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aridcal.jobs.fleet.cluster.ANSWER", 0.1)
    with pytest.raises(AridcalError, match=said), dask_engine(address, SILENT):
        pass


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(AridcalError, match=r'pip install "aridcal\[fleet\]"'), dask_engine(None, SILENT):
        pass


def test_progress_says_how_many_are_done_how_many_failed_and_how_long_it_takes(plant: Path) -> None:
    said: list[str] = []
    ticks = iter(range(0, 100000, 10))
    (plant / "robots" / "arm-0" / "measurements.csv").write_text("x\n1\n")
    (plant / "robots" / "arm-1" / "campaign.yaml").open("a").write("# again\n")
    computed(plan(plant), run_tasks, Progress(said.append, clock=lambda: float(next(ticks))))
    assert any(line.startswith("arm-0 failed: ") for line in said)
    assert any(
        "1 of 2 robots, 1 failed, " in line and line.endswith(" left") and line.count("left") == 1 for line in said
    )
    assert [duration(s) for s in (1.2, 89, 600, 12000)] == ["1 s", "89 s", "10 min", "3 h 20 min"]


# -- real processes


def test_a_fleet_that_is_stopped_leaves_nothing_half_written_and_goes_on(plant: Path) -> None:
    """Ctrl-C at a terminal reaches the workers, too. A robot that was done is kept, and the next start computes the others."""
    for k in (1, 2):
        (plant / "robots" / f"arm-{k}" / "campaign.yaml").open("a").write("# again\n")
    out = plant / "fleet"
    words = [sys.executable, "-m", "aridcal.fleet", str(plant / "robots/*/campaign.yaml"), "-o", str(out)]
    before = (out / "arm-1" / "fleet.json").stat().st_ino
    with claimed(out / "arm-2", "folder"):  # its worker waits: the command cannot be done before it is stopped
        with on_one_core():
            command = subprocess.Popen(
                words, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
        assert command.stdout is not None
        while (out / "arm-1" / "fleet.json").stat().st_ino == before:
            assert command.poll() is None
            time.sleep(0.02)
        os.killpg(command.pid, signal.SIGINT)
        said = command.stdout.read()
    assert command.wait() == 130
    assert said.endswith("interrupted: nothing was left half written\n")
    assert "Traceback" not in said
    assert sorted(path.name for path in out.iterdir()) == ["arm-0", "arm-1", "arm-2", "fleet.parquet"]
    assert [task.robot for task in plan(plant).tasks.values()] == ["arm-2"]
    assert run_here(plant).failed == {}
    assert plan(plant).tasks == {}


SCHEDULER = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--no-dashboard"]
WORKER = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]


@dataclass(frozen=True)
class Tended:
    """A cluster that somebody keeps alive.

    Attributes:
        address: Of its scheduler.
        scheduler: The process that is the scheduler now.
        end: Ends it for good.
    """

    address: str
    scheduler: Callable[[], subprocess.Popen[bytes]]
    end: Callable[[], None]


def announced(file: Path, scheduler: subprocess.Popen[bytes]) -> str:
    """The address of a scheduler, once it listens and has written all of its file."""
    while True:
        with suppress(OSError, ValueError):  # not there, or half of it
            return str(json.loads(file.read_text())["address"])
        assert scheduler.poll() is None
        time.sleep(0.05)


@pytest.fixture
def tended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Tended]:
    """A scheduler over TCP and a worker, as processes of their own; both are kept alive."""
    monkeypatch.setattr("aridcal.jobs.fleet.cluster.ANSWER", 120.0)  # however busy the machine is
    env = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "support")))}
    quiet: dict[str, Any] = {"env": env, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    file = tmp_path / "head.json"
    first = subprocess.Popen([*SCHEDULER, "--port", "0", "--scheduler-file", str(file)], **quiet)
    address = announced(file, first)
    head = [*SCHEDULER, "--port", address.rpartition(":")[2]]
    hand = [*WORKER, address, "--local-directory", str(tmp_path)]
    running = {"head": first, "hand": subprocess.Popen(hand, **quiet)}
    over = threading.Event()

    def tend() -> None:
        while not over.wait(0.1):
            for name, words in (("head", head), ("hand", hand)):
                if name == "head" and running[name].poll() is not None:
                    running["hand"].kill()  # it would end by itself, in its own time
                if running[name].poll() is not None and not over.is_set():
                    running[name] = subprocess.Popen(words, **quiet)

    tending = threading.Thread(target=tend)
    tending.start()

    def end() -> None:
        over.set()
        tending.join()
        for process in running.values():
            process.kill()
            process.wait()

    yield Tended(address, lambda: running["head"], end)
    end()


def test_a_worker_and_the_scheduler_die_and_every_task_is_answered_once_and_one_that_stays_away_is_gone(
    tmp_path: Path, tended: Tended
) -> None:
    """Over TCP, on processes of their own: what dies is started again by somebody, as systemd would, until nobody does.

    The scheduler dies while a task is being worked on: between two tasks nobody need notice.
    """
    marks = tmp_path / "marks"
    marks.mkdir()
    names = ["one", "dies-at-first", "raises", "holds-at-first", "three"]
    tasks = {f"task-{name}": (str(marks), name) for name in names}
    said: list[str] = []
    answers: dict[str, Any] = {}
    over = threading.Event()

    def kill_the_scheduler() -> None:
        held = marks / "holds-at-first"
        while not (held.exists() and held.read_text() == "x"):
            if over.wait(0.05):
                return
        tended.scheduler().kill()

    killing = threading.Thread(target=kill_the_scheduler)
    killing.start()
    try:
        with dask_engine(tended.address, Progress(said.append)) as engine:
            for name, answer in engine(slow_or_deadly, tasks):
                assert name not in answers
                answers[name] = answer
    finally:
        over.set()
        killing.join()
    assert answers == {
        f"task-{name}": WorkFailure("ValueError: on purpose") if name == "raises" else name.upper() for name in names
    }
    assert (marks / "dies-at-first").read_text() == (marks / "holds-at-first").read_text() == "xx"
    assert any("connection to the scheduler broke" in line for line in said)

    with dask_engine(tended.address, SILENT, patience=2.0) as engine:
        tended.end()
        with pytest.raises(EngineGone, match="did not come back"):
            list(engine(str.upper, {"a": "a"}))
