"""The tests with the lowest and with the newest versions of what aridcal needs, on every Python that it supports.

Each cell is a virtual environment of its own in a temporary folder. `lowest` are the floors of `dependencies` in
pyproject.toml, as wheels; whatever they need in turn, and the tools of the tests, are the newest that go with them. `newest` is
what pip would give today. The lock file plays no part. First `aridcal doctor` runs with what a user gets, then the tests with
what they need besides.

Example:
    python scripts/matrix.py                        # all six cells, with the quick tests
    python scripts/matrix.py 3.11-lowest            # one of them
    python scripts/matrix.py --whole 3.11-lowest    # all tests
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

PYTHONS = ("3.11", "3.12", "3.13")

CELLS = tuple(f"{python}-{versions}" for python in PYTHONS for versions in ("lowest", "newest"))

QUICK = (
    "jobs/calibrate/test_calibration",
    "files/test_campaign",
    "doors/test_command_line",
    "doors/test_completion",
    "files/test_dataset",
    "system/test_files",
    "jobs/head1992/test_head_pose",
    "jobs/head1992/test_head_square",
    "jobs/boards/test_boards_sheet",
    "engine/fit/test_least_squares",
    "engine/model/test_model",
    "jobs/apply/test_predict",
    "engine/robot/test_robot",
    "engine/robot/test_splice",
    "engine/robot/test_urdf_files",
)
"""Test files that call every dependency but those of the pictures, which the doctor's calibration draws."""


def interpreter(version: str) -> str | None:
    """A Python of this version on the machine, on the path or pyenv's; None if there is none."""
    there = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for python in (shutil.which(f"python{version}"), *map(str, there)):
        # A shim of pyenv may be on the path though its version is not selected: then it only complains.
        if python and subprocess.run([python, "--version"], capture_output=True, check=False).returncode == 0:
            return python
    return None


def call(*command: str) -> None:
    """Run a command; what it says is shown only if it fails."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command[1:4])} fails:\n{done.stdout}{done.stderr}")


def install(python: str, versions: str, folder: Path) -> Path:
    """Make the environment of one cell, with a sound aridcal in it, and return its Python."""
    uv = (sys.executable, "-m", "uv")
    call(*uv, "venv", "--python", python, str(folder / "env"))
    environment = folder / "env" / "bin" / "python"
    floors = folder / "floors.txt"
    floors.touch()
    if versions == "lowest":
        lowest = ("--resolution", "lowest-direct", "--only-binary", ":all:", "--python", str(environment))
        call(*uv, "pip", "compile", "pyproject.toml", *lowest, "--output-file", str(floors))
    add = (*uv, "pip", "install", "--python", str(environment), "--constraint", str(floors), "--editable")
    call(*add, ".")
    call(str(environment), "-m", "aridcal", "doctor")
    call(*add, ".[dev]")
    return environment


def run(cell: str, whole: bool) -> tuple[bool, str]:
    """Whether a cell's tests pass, and what they say of themselves."""
    version, versions = cell.split("-")
    python = interpreter(version)
    if python is None:
        return False, f"no Python {version} on this machine"
    with tempfile.TemporaryDirectory(prefix="aridcal-matrix-") as name:
        folder = Path(name)
        try:
            environment = install(python, versions, folder)
        except RuntimeError as error:
            return False, str(error)
        files = [] if whole else [f"tests/{file}.py" for file in QUICK]
        path = f"{environment.parent}{os.pathsep}{os.environ['PATH']}"
        env = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT), "VIRTUAL_ENV": str(folder / "env")}
        # Warnings of old versions about new ones are no fault of ours; those that the tests refuse stay refused.
        command = [str(environment), "-m", "pytest", "--disable-warnings", "-p", "no:cacheprovider", *files]
        done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines() or done.stderr.strip().splitlines()
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    summary = next((line for line in reversed(lines) if " passed" in line or " failed" in line), lines[-1])
    return done.returncode == 0, "\n".join([summary, *failed])


def main() -> int:
    """Run the cells that are asked for, one after the other; 0 if all pass."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cells", nargs="*", metavar="CELL", help=f"of {', '.join(CELLS)}; default: all")
    parser.add_argument("--whole", action="store_true", help="all tests, not only the quick ones")
    asked = parser.parse_args()
    unknown = sorted(set(asked.cells) - set(CELLS))
    if unknown:
        parser.error(f"there is no cell {unknown[0]!r}: choose from {', '.join(CELLS)}")
    sound = True
    for cell in asked.cells or CELLS:
        started = time.monotonic()
        passed, said = run(cell, asked.whole)
        sound &= passed
        print(f"{cell:12} {'passed' if passed else 'FAILED':6} {time.monotonic() - started:5.0f} s  {said}", flush=True)
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
