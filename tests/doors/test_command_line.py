"""Every command: exit status, messages, help."""

from __future__ import annotations

import argparse
import importlib
import itertools
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import pytest

import aridcal
from aridcal.__main__ import COMMANDS
from aridcal.__main__ import main as aridcal_main
from aridcal.command_line import command, command_parser, run, screens
from aridcal.system.errors import AridcalError
from aridcal.system.interrupt import is_command
from aridcal.system.progress import Screen


def raising(error: BaseException):
    def body() -> None:
        raise error

    return body


# -- exit status and messages


def test_work_done_exits_with_0_and_says_nothing(capsys):
    done = []
    assert run(lambda: done.append(1)) == 0
    assert done == [1]
    assert capsys.readouterr() == ("", "")


def test_bad_input_exits_with_2_and_its_own_words_on_stderr(capsys):
    message = "/a/very/long/path" + "/x" * 100 + "/m.csv, row 17: tip_target[A] [red] is empty\nfill it in"
    assert run(raising(AridcalError(message))) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == f"error: {message}\n"


def test_a_bug_exits_with_1_and_shows_where(capsys):
    assert run(raising(ZeroDivisionError("by zero"))) == 1
    err = capsys.readouterr().err
    assert "ZeroDivisionError" in err
    assert Path(__file__).name in err
    assert "this is a bug" in err


def test_ctrl_c_exits_with_130_without_traceback(capsys):
    assert run(raising(KeyboardInterrupt())) == 130
    err = capsys.readouterr().err
    assert err.startswith("interrupted")
    assert "Traceback" not in err


def test_usage_errors_of_argparse_pass_through():
    with pytest.raises(SystemExit) as stop:
        run(raising(SystemExit(2)))
    assert stop.value.code == 2


def test_sigterm_unwinds_as_ctrl_c_exits_with_143_and_the_handler_is_put_back():
    before = signal.getsignal(signal.SIGTERM)

    def body() -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    assert run(body) == 143
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_what_cannot_be_printed_for_want_of_room_is_said_without_traceback():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "aridcal", "doctor"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 2
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr


def started(*words: str, redirected: str = "", stdout: int | None = None) -> subprocess.CompletedProcess[str]:
    """A command as a shell starts it."""
    line = ["sh", "-c", f'exec "$0" "$@" {redirected}', sys.executable, "-m", "aridcal", *words]
    return subprocess.run(line, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)


@pytest.fixture
def unread() -> Iterator[int]:
    """The end of a pipe that nobody reads: every byte written to it fails, as after `| head`, however fast that is."""
    reading, writing = os.pipe()
    os.close(reading)
    yield writing
    os.close(writing)


@pytest.mark.parametrize("words", [["--help"], ["doctor", "--help"]], ids=" ".join)
def test_what_nobody_reads_costs_a_command_neither_its_status_nor_a_word(words: list[str], unread: int) -> None:
    done = started(*words, stdout=unread)
    assert (done.returncode, done.stderr) == (0, "")


CLOSED = ["<&- >&-", "<&- >&- 2>&-"]


@pytest.mark.parametrize(
    ("words", "redirected"),
    [
        *itertools.product([["--version"], ["doctor", "--help"]], CLOSED),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_closed_streams_are_as_if_they_led_nowhere(words: list[str], redirected: str) -> None:
    done = started(*words, redirected=redirected)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_file_does_not_take_the_place_of_a_closed_stream(tmp_path: Path) -> None:
    """Files get the lowest number that is free: what is printed, or what a library writes by number, would go into them."""
    (tmp_path / "aridcal").write_text(
        "import os, sys\nimport aridcal\nwith open(sys.argv[1], 'w') as file:\n    os.write(1, b'out')\n    os.write(2, b'err')\n"
        "    print('more')\n    assert file.fileno() > 2 and sys.stdin.read() == ''\n"
    )
    line = f"exec {sys.executable} {tmp_path / 'aridcal'} {tmp_path / 'kept'} <&- >&- 2>&-"
    root = str(Path(aridcal.__file__).parents[1])
    done = subprocess.run(["sh", "-c", line], check=False, env=os.environ | {"PYTHONPATH": root})
    assert done.returncode == 0 and (tmp_path / "kept").read_text() == ""


@pytest.fixture
def into_nothing(unread: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[TextIO]:
    """Standard output led there."""
    with os.fdopen(os.dup(unread), "w") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        yield stream


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_may_go_unread(command: str, into_nothing: TextIO) -> None:
    with pytest.raises(SystemExit) as stop:
        aridcal_main([command, "--help"])
    assert stop.value.code == 0
    into_nothing.flush()  # what Python does at its end


@pytest.mark.parametrize("status", [0, 3])
def test_the_work_goes_on_and_its_status_counts_though_nobody_reads(status: int, into_nothing: TextIO) -> None:
    done = []

    def body() -> int:
        words, _ = screens(argparse.Namespace(quiet=False))
        for line in range(3):
            words.print(line)
            done.append(line)
        return status

    assert run(body) == status
    assert done == [0, 1, 2]
    assert run(lambda: print("headline") or status) == status  # type: ignore[func-returns-value]


STOPPER = """
import os, signal, sys

class Stopper:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["STOP_AT"]:
            os.kill(os.getpid(), getattr(signal, os.environ["STOP_BY"]))

sys.meta_path.insert(0, Stopper())
"""
"""A `sitecustomize` that sends a signal when a module is about to be imported."""


@pytest.mark.parametrize(
    ("start", "stop_at"),
    [
        *itertools.product(
            ["package"], ["aridcal.command_line", "rich", "threadpoolctl", "numpy", "pinocchio", "pydantic"]
        ),
        *itertools.product(["module", "script"], ["aridcal.command_line", "pydantic"]),
    ],
)
def test_a_signal_while_libraries_load_ends_with_130_or_143_and_one_line(start, stop_at, tmp_path):
    by, status = ("SIGTERM", 143) if stop_at in ("rich", "pinocchio") else ("SIGINT", 130)
    (tmp_path / "sitecustomize.py").write_text(STOPPER)
    (tmp_path / "aridcal").write_text("import sys\nfrom aridcal.__main__ import main\nsys.exit(main())\n")
    how = {"module": ["-m", "aridcal.identify"], "package": ["-m", "aridcal", "identify"]}
    how["script"] = [str(tmp_path / "aridcal"), "identify"]
    root = str(Path(aridcal.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, *how[start], "nowhere.yaml"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), root]), "STOP_AT": stop_at, "STOP_BY": by},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (status, "", "interrupted: nothing was left half written\n")


def test_the_library_leaves_ctrl_c_to_its_user():
    """A program that imports aridcal, from a script, a prompt or a test runner, gets KeyboardInterrupt as ever."""
    code = "import aridcal, signal, sys; sys.exit(signal.getsignal(signal.SIGINT) is not signal.default_int_handler)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert not is_command(["/usr/bin/pytest", "aridcal"], ["python", "/usr/bin/pytest", "aridcal"])
    assert not is_command(["-m"], ["python", "-m", "pytest"])
    assert not is_command([], [])
    assert is_command(["-m"], ["python", "-X", "dev", "-maridcal.view", "results"])


def test_a_command_in_the_background_that_ignores_ctrl_c_goes_on_ignoring_it():
    code = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); import sys; sys.argv[0] = 'aridcal'; import aridcal"
    code += "; sys.exit(signal.getsignal(signal.SIGINT) is not signal.SIG_IGN)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_command_gives_its_work_its_arguments_and_takes_its_status(capsys):
    def parser():
        arguments = command_parser("toy", "A toy.\n\nExample:\n    aridcal toy x")
        arguments.add_argument("name")
        return arguments

    def work(arguments):
        if arguments.name == "bad":
            raise AridcalError("no such toy")
        Screen().say(f"[red]{arguments.name}[/red] {'long ' * 60}end", "second")
        return 3

    main = command(parser, work)
    assert main(["ball"]) == 3
    assert capsys.readouterr().out == f"[red]ball[/red] {'long ' * 60}end\nsecond\n"
    assert main(["bad"]) == 2
    assert "no such toy" in capsys.readouterr().err


# -- the console script


def test_commands_are_the_modules_that_have_a_main():
    package = Path(aridcal.__file__).parent
    ends = re.compile(r"^(def main|main = command)\(", re.MULTILINE)
    found = {p.stem for p in package.glob("*.py") if ends.search(p.read_text("utf-8"))}
    assert set(COMMANDS) == found - {"__main__"}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as stop:
        aridcal_main([command, "--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert out.startswith(f"usage: aridcal {command}")
    example = out.partition("\nexample:\n")[2].splitlines()
    assert example
    assert all(line.startswith(f"    aridcal {command}") for line in example if line)


@pytest.mark.parametrize("command", COMMANDS)
def test_o_and_out_mean_the_same(command):
    """A command that writes knows both names of the place to write to."""
    parser = importlib.import_module(f"aridcal.{command}").parser()
    named = [action.option_strings for action in parser._actions if {"-o", "--out"} & set(action.option_strings)]
    assert all(options == ["-o", "--out"] for options in named)
    assert len(named) == (
        command
        in {
            "export",
            "guide",
            "identify",
            "init",
            "measure",
            "merge",
            "simulate",
            "predict",
            "compensate",
            "design",
            "recalibrate",
            "compare",
            "history",
            "print",
            "detect",
            "fleet",
            "study",
        }
    )


def test_a_slip_in_the_arguments_is_answered_with_where_to_look(capsys):
    with pytest.raises(SystemExit) as stop:
        aridcal_main(["identify"])
    assert stop.value.code == 2
    assert "`aridcal identify --help` has an example" in capsys.readouterr().err


def test_arguments_and_exit_status_pass_through(monkeypatch):
    command = next(iter(COMMANDS))
    seen = []
    module = importlib.import_module(f"aridcal.{command}")
    monkeypatch.setattr(module, "main", lambda argv: seen.append(argv) or 7)
    assert aridcal_main([command, "a.yaml", "--out", "b"]) == 7
    assert seen == [["a.yaml", "--out", "b"]]


def test_unknown_command_exits_with_2_and_names_the_nearest(capsys):
    assert aridcal_main(["simulat"]) == 2
    err = capsys.readouterr().err
    assert "'simulat'" in err
    assert "did you mean 'simulate'?" in err


def test_no_command_exits_with_2_and_lists_all(capsys):
    assert aridcal_main([]) == 2
    err = capsys.readouterr().err
    assert all(command in err for command in COMMANDS)


def test_help_lists_all_commands_with_their_job(capsys):
    assert aridcal_main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(command in out and job in out for command, job in COMMANDS.items())


def test_version_is_told(capsys):
    assert aridcal_main(["--version"]) == 0
    assert capsys.readouterr().out == f"aridcal {aridcal.__version__}\n"


def test_help_is_quick_because_no_command_is_imported():
    code = "import sys, aridcal.__main__ as m; m.main(['--help']); sys.exit('pinocchio' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, check=False).returncode == 0


def test_a_pipe_gets_a_long_line_in_one_piece(capsys: pytest.CaptureFixture[str]) -> None:
    words = " ".join(["found"] * 60)
    screens(argparse.Namespace(quiet=False))[0].print(words)
    assert capsys.readouterr().out == words + "\n"
