"""Some hundred bad inputs: each ends with status 2 and a message that names the culprit and the remedy, and writes nothing."""

from __future__ import annotations

import importlib
import re
import resource
import shutil
from collections.abc import Iterator
from pathlib import Path

import bad_inputs
import pytest

REMEDY = re.compile(
    r"add|change|check|choose|close|convert|correct|delete|do without|done|end each|exchange|expected|fewer|fix|give|has an example|"
    r"leave|lower|make|map|measure|mend|merge|move|name|needs?|only|open|number|own|put|raise|remove|rename|run|save|say|should|shows?|"
    r"spaces|split|take|turn|use|wait|wants|write|\(did you mean|\(known: |is refused|must|missing|unknown|at most|at least|"
    r"there is no|are the least|there are: |first: |cannot|not a number|is there twice|not finite|decimal",
    re.IGNORECASE,
)
"""Words of a remedy: what to do, what there is, or what is allowed."""

MOST_MEMORY = 400_000
"""[kB] By which a refusal may raise the memory of this process; what it refuses would take more."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    bad_inputs.write_sound_files(folder)
    return folder


@pytest.fixture
def folder(sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(sound, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(command: str, *arguments: str) -> int:
    try:
        return int(importlib.import_module(f"aridcal.{command}").main(list(arguments)))
    except SystemExit as stop:  # argparse's own way out
        return int(stop.code or 0)


def everything(folder: Path) -> Iterator[tuple[str, object]]:
    """Every entry of a folder with what tells that it was not touched."""
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        yield str(path.relative_to(folder)), (status.st_mode, status.st_size, status.st_mtime_ns, status.st_ino)


@pytest.mark.parametrize("name", bad_inputs.CASES)
def test_a_bad_input_is_refused_by_name(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = bad_inputs.CASES[name]
    case.spoil(folder)
    before, memory = list(everything(folder)), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    status = run(*case.command)
    said = capsys.readouterr().err
    assert status == 2, said
    assert "Traceback" not in said
    assert re.search(case.says, said), said
    assert REMEDY.search(said), said
    assert len(said) < 5000, "a message that nobody reads"
    assert list(everything(folder)) == before, "nothing may be written, changed or left behind"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < MOST_MEMORY
