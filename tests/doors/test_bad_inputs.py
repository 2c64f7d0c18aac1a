"""Some hundred bad inputs: each ends with status 2 and a message that names the culprit and the remedy, and writes nothing."""

from __future__ import annotations

import importlib
import re
import resource
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.sax.saxutils import escape

import bad_inputs
import numpy as np
import pandas as pd
import pytest
import spoil
import yaml

import aridcal

REMEDY = re.compile(
    r"\b(add|call|change|check|choose|close|convert|delete|end each|exchange|fill in|fix|give|join|leave|make|map|measure|mend|"
    r"merge|move|name|number|open|own|put|raise|remove|rename|run|save|say|split|take|turn|use|wait|write)\b|`aridcal \w|"
    r"\b(should|expected|at most|at least|needs?|has an example)\b|\(did you mean|\(known: |there are: ",
    re.IGNORECASE,
)
"""Words of a remedy: what to do, what there is, or what is allowed."""

MOST_MEMORY = 400_000
"""[kB] By which a refusal may raise the memory of this process; what it refuses would take more."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    spoil.write_sound_files(folder)
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


# ---------------------------------------------------------------- from Python


def frame(**columns: object) -> pd.DataFrame:
    """The measurements with other columns."""
    return pd.read_csv("measurements.csv").assign(**columns)


def figures(content: str) -> pd.DataFrame:
    """Errors of a loaded calibration with another ``result.json``."""
    Path("result.json").write_text(content)
    return aridcal.load("calibration.yaml").errors


FACE: dict[str, tuple[Callable[[], object], str]] = {
    "a URDF that is not there": (lambda: aridcal.propose("no.urdf", frame()), r"no\.urdf: there is no such file; check"),
    "a URDF with NUL": (lambda: aridcal.propose("a\0b.urdf", frame()), r"a\\x00b\.urdf.*embedded null"),
    "a URDF of 5,000 letters": (lambda: aridcal.propose(bad_inputs.LONG, frame()), "a+….*name too long"),
    "a table of 5,000 letters": (lambda: aridcal.propose("robot.urdf", f"{bad_inputs.LONG}.csv"), "cannot be the name of a file"),
    "a table with a line break": (lambda: aridcal.propose("robot.urdf", "a\nb.csv"), r"a\\nb\.csv: the name of this file"),
    "an empty table": (lambda: aridcal.propose("robot.urdf", frame()[:0]), "DataFrame: has columns but no rows; give"),
    "a table of nothing": (lambda: aridcal.propose("robot.urdf", pd.DataFrame()), "DataFrame: line 1 is empty"),
    "a column with a line break": (lambda: aridcal.propose("robot.urdf", frame(**{"a\nb": 1})), r"'a\\nb' holds a control"),
    "a column of 5,000 letters": (lambda: aridcal.propose("robot.urdf", frame(**{bad_inputs.LONG: 1})), "'a+…' has 5,000"),
    "a position of 1e308": (lambda: aridcal.propose("robot.urdf", frame(x=1e308)), "'x' has numbers in 0 of 30 rows"),
    "quaternions of zeros": (
        lambda: aridcal.propose("robot.urdf", frame(qx=0, qy=0, qz=0, qw=0)), "qx qy qz qw hold no quaternions of norm 1",
    ),
    "objects for joints": (lambda: aridcal.propose("robot.urdf", frame(joint_2=[object()] * 30)), "'joint_2' has numbers in 0"),
    "a campaign that is not there": (lambda: aridcal.calibrate("no.yaml"), r"no\.yaml: there is no such file"),
    "a campaign of 5,000 letters": (lambda: aridcal.calibrate(bad_inputs.LONG), "a+…: cannot be the name of a file"),
    "a campaign with NUL": (lambda: aridcal.calibrate("a\0b"), r"a\\x00b: the name of this file holds a control"),
    "a table for a campaign": (lambda: aridcal.calibrate("measurements.csv"), r"measurements\.csv: is no campaign"),
    "a device for a campaign": (lambda: aridcal.calibrate("/dev/zero"), "/dev/zero: is a device; only regular files"),
    "a device for a calibration": (lambda: aridcal.load("/dev/zero"), "/dev/zero: is a device; only regular files"),
    "a calibration that is not there": (lambda: aridcal.load("no"), "no: there is no such file; `aridcal identify"),
    "a calibration of 5,000 letters": (lambda: aridcal.load(bad_inputs.LONG), "cannot be the name of a file"),
    "a query without a joint": (lambda: aridcal.load("calibration.yaml").predict(frame()[["joint_1"]]), "no column 'joint_2'"),
    "a query of nan": (lambda: aridcal.load("calibration.yaml").predict(frame(joint_2=np.nan)), "no row can be predicted.*mend"),
    "poses of 1e308": (lambda: aridcal.load("calibration.yaml").compensate(frame(x=1e308)), "no row can be commanded.*mend"),
    "seeds of another length": (
        lambda: aridcal.load("calibration.yaml").compensate(frame(), seed=frame()[:3]), "3 rows of seeds for 30 poses: give",
    ),
    "a seed that is a device": (lambda: aridcal.load("calibration.yaml").compensate(frame(), seed="/dev/zero"), "/dev/zero"),
    "figures that are none": (lambda: figures("{"), r"result\.json: cannot be read.*Run identify again"),
    "figures of nothing": (lambda: figures("{}"), r"result\.json is damaged \(KeyError.*Run identify again"),
    "figures that are a list": (lambda: figures("[1, 2]"), r"result\.json.*Run identify again"),
    "figures of another shape": (lambda: figures('{"error": {"nominal": [1]}}'), r"result\.json is damaged.*Run identify again"),
    "figures 100,000 deep": (lambda: figures(100_000 * "["), r"result\.json: cannot be read.*Run identify again"),
    "figures of 5,000 digits": (lambda: figures('{"error": ' + 5000 * "9" + "}"), r"result\.json.*Run identify again"),
    "a report that is not there": (lambda: aridcal.load("calibration.yaml").report(), r"report\.html: there is no such file"),
    "a campaign to be saved": (lambda: aridcal.load("calibration.yaml").save("out"), "`save` needs the measurements"),
}  # fmt: skip


@pytest.mark.parametrize("name", FACE)
def test_python_gets_the_same_refusals(name: str, folder: Path) -> None:
    act, says = FACE[name]
    with pytest.raises(aridcal.AridcalError, match=says):
        act()
    assert not (folder / "out").exists()


# ---------------------------------------------------------------- names that are right


NAMES = ["a[/]b", "[bold red]x", "yes: 1 #", "Gelenk 'ä' \"1\""]


@pytest.fixture
def renamed(folder: Path) -> Path:
    """The same robot with joints whose names mean something to rich, to YAML or to XML."""
    urdf, table = (folder / "robot.urdf").read_text("utf-8"), pd.read_csv(folder / "measurements.csv")
    for number, name in enumerate(NAMES, 1):
        urdf = urdf.replace(f'"joint_{number}"', f'"{escape(name, {chr(34): "&quot;"})}"')
    table.columns = [*NAMES, *table.columns[4:]]
    (folder / "robot.urdf").write_text(urdf, encoding="utf-8")
    table.to_csv(folder / "measurements.csv", index=False)
    table[NAMES].to_csv(folder / "query.csv", index=False)
    return folder


def test_names_that_mean_something_elsewhere_are_printed_and_written_verbatim(
    renamed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*bad_inputs.INIT) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in NAMES[:2]), said
    campaign = yaml.safe_load(Path("new.yaml").read_text("utf-8"))
    Path("new.yaml").write_text(
        yaml.safe_dump(campaign | {"diagnosis": {"enabled": False}}, allow_unicode=True), encoding="utf-8"
    )
    assert run("identify", "new.yaml", "-o", "out") == 0
    for name in ("kinematics.yaml", "joint_offsets.yaml", "dh.yaml", "doty.yaml"):
        text = (renamed / "out" / name).read_text("utf-8")
        words = {str(word) for word in everything_in(yaml.safe_load(text))}
        assert set(NAMES[:3]) & words, f"{name}: {text}"
    assert run("predict", "out/calibration.yaml", "query.csv", "-o", "poses.csv") == 0
    assert list(pd.read_csv("poses.csv").columns[:4]) == NAMES


def everything_in(value: object) -> Iterator[object]:
    """Keys and values of a document, however deep."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield key
            yield from everything_in(item)
    elif isinstance(value, list):
        for item in value:
            yield from everything_in(item)
    else:
        yield value
