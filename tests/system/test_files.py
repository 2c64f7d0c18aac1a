"""Files that appear whole or not at all, whatever stops the work."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_kills import acting

from aridcal.command_line import run
from aridcal.system.errors import AridcalError, OutputError
from aridcal.system.writing.table_writer import csv_lines
from aridcal.system.writing.whole_files import atomic_file, atomic_folder, check_writable, claimed_table

not_root = pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")


def contents(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_new_folder_appears_only_when_all_is_written(tmp_path):
    target = tmp_path / "deep" / "results"
    with atomic_folder(target) as folder:
        (folder / "a.txt").write_text("a")
        assert not target.exists()
    assert contents(tmp_path) == {"deep/results/a.txt": "a"}


def test_new_folder_has_the_permissions_of_any_other(tmp_path):
    (tmp_path / "plain").mkdir()
    with atomic_folder(tmp_path / "results"):
        pass
    assert (tmp_path / "results").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("error", [ValueError("bug"), KeyboardInterrupt(), AridcalError("bad")])
def test_earlier_result_survives_a_failure_and_nothing_is_left_behind(tmp_path, error):
    target = tmp_path / "results"
    target.mkdir()
    (target / "a.txt").write_text("old")
    with pytest.raises(type(error)), atomic_folder(target, replaces={"a.txt"}) as folder:
        (folder / "a.txt").write_text("new")
        raise error
    assert contents(tmp_path) == {"results/a.txt": "old"}
    assert [p.name for p in target.iterdir()] == ["a.txt"]


def test_failed_first_run_leaves_no_trace(tmp_path):
    with pytest.raises(ValueError), atomic_folder(tmp_path / "deep" / "results") as folder:
        (folder / "a.txt").write_text("new")
        raise ValueError
    assert list(tmp_path.iterdir()) == []


def test_stale_files_of_an_earlier_result_go_and_the_users_own_stay(tmp_path):
    target = tmp_path / "results"
    (target / "notes").mkdir(parents=True)
    for name in ("result.json", "model.urdf", "mine.txt", "notes/today.txt"):
        (target / name).write_text("old")
    with atomic_folder(target, replaces={"result.json", "model.urdf", "report.html"}) as folder:
        (folder / "result.json").write_text("new")
    assert contents(target) == {"result.json": "new", "mine.txt": "old", "notes/today.txt": "old"}


def test_a_link_to_a_folder_stays_a_link(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "results").symlink_to("elsewhere")
    with atomic_folder(tmp_path / "results") as folder:
        (folder / "a.txt").write_text("a")
    assert (tmp_path / "results").is_symlink()
    assert contents(tmp_path / "elsewhere") == {"a.txt": "a"}


def test_full_disk_while_writing_is_an_output_error_and_a_missing_file_is_a_bug(tmp_path):
    with pytest.raises(OutputError, match="No space"), atomic_folder(tmp_path / "results"):
        raise OSError(28, "No space left on device")
    with pytest.raises(FileNotFoundError), atomic_folder(tmp_path / "results"):
        (tmp_path / "nowhere.css").read_text()


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    target = tmp_path / "predicted.csv"
    with atomic_file(target) as path:
        path.write_text("first")
        assert not target.exists()
    with pytest.raises(ValueError), atomic_file(target) as path:
        path.write_text("half")
        raise ValueError
    assert contents(tmp_path) == {"predicted.csv": "first"}
    with atomic_file(target) as path:
        path.write_text("second")
    assert contents(tmp_path) == {"predicted.csv": "second"}


def test_what_cannot_be_written_is_said_before_any_work(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    for path, kind, why in [
        (tmp_path / "file", "folder", "is a file"),
        (tmp_path / "folder", "file", "is a folder"),
        (tmp_path / "file" / "results", "folder", "is a file"),
        (tmp_path / "file" / "deep" / "out.csv", "file", "is a file"),
        (Path("/proc/results"), "folder", "cannot be written"),
    ]:
        with pytest.raises(OutputError, match=why) as complaint:
            check_writable(path, kind)
        assert str(path) in str(complaint.value)
    check_writable(tmp_path / "new" / "results")
    check_writable(tmp_path / "folder", "folder")
    check_writable(tmp_path / "file", "file")
    check_writable(tmp_path / "file")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


@not_root
def test_a_folder_without_permission_is_named(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(OutputError, match="Permission denied"):
        check_writable(tmp_path / "locked")


SLOW_WRITER = """
import sys
from pathlib import Path
from aridcal.command_line import run
from aridcal.system.writing.whole_files import atomic_folder

def body():
    with atomic_folder(Path(sys.argv[1])) as folder:
        (folder / "a.txt").write_text("new")
        print("half way", flush=True)
        sys.stdin.read()  # for ever

sys.exit(run(body))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_process_stopped_half_way_leaves_the_earlier_result_alone(tmp_path, number):
    (tmp_path / "a.txt").write_text("old")
    with subprocess.Popen(
        [sys.executable, "-c", SLOW_WRITER, str(tmp_path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "half way\n"
        process.send_signal(number)
        assert process.stderr is not None
        err = process.stderr.read()
    assert process.returncode == 128 + number
    assert err.startswith("interrupted")
    assert contents(tmp_path) == {"a.txt": "old"}
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_before_any_operation_leaves_old_or_new_and_nothing_else(tmp_path, number):
    for at in range(100):
        home = tmp_path / str(at)
        (home / "results").mkdir(parents=True)
        (home / "results" / "a.txt").write_text("old")
        with acting(at, lambda _: os.kill(os.getpid(), number)) as done:
            status = run(lambda home=home: write(home / "results"))
        assert contents(home) in ({"results/a.txt": "new"}, {"results/a.txt": "old"}), at
        assert [p.name for p in home.iterdir()] == ["results"], at
        if len(done) <= at:
            break
        assert status == 128 + number
    assert 8 < at < 99 and status == 0


def write(target: Path) -> None:
    with atomic_folder(target) as folder:
        (folder / "a.txt").write_text("new")


@pytest.mark.parametrize("name", ["corners.txt", "corners", "refused.csv"])
def test_a_table_is_a_csv_file_and_none_of_those_beside_it(name, tmp_path):
    with (
        pytest.raises(OutputError, match=f"{name}: .*refused.csv"),
        claimed_table(tmp_path / "new" / name, ["refused.csv"]),
    ):
        pytest.fail("the work has begun")
    assert list(tmp_path.iterdir()) == []
    with claimed_table(tmp_path / "new" / "corners.csv", ["refused.csv"]):
        pass


def test_lines_of_numbers_and_words_are_the_bytes_that_pandas_writes() -> None:
    rng = np.random.default_rng(0)
    size = 10.0 ** rng.integers(-14, 12, (500, 3))
    table = pd.DataFrame(size * rng.standard_normal((500, 3)), columns=["x", "y, z", "w"])
    table.loc[::7, "x"] = np.nan
    table.loc[3:5, "w"] = [np.inf, -np.inf, -0.0]
    names = ["plain", "with, comma", 'with "quotes"', "two\nlines", ""]
    table = table.assign(name=[names[k % 5] for k in range(500)], number=range(500), whole=1.0)
    columns = {name: column.to_numpy() for name, column in table.items()}
    assert csv_lines(columns, 9) == table.to_csv(index=False, header=False, float_format="%.9g")
    assert csv_lines({name: column[:0] for name, column in columns.items()}, 9) == ""
