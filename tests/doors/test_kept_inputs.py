"""No command replaces a file that it reads, by whatever name its output is given."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from repository import ROOT

from aridcal.__main__ import COMMANDS, main
from aridcal.system.errors import OutputError
from aridcal.system.writing.separate_paths import check_apart


def itself(file: Path, alias: Path) -> Path:
    return file


def spelt(file: Path, alias: Path) -> Path:
    return file.parent / ".." / file.parent.name / "." / file.name


def relative(file: Path, alias: Path) -> Path:
    return Path(os.path.relpath(file))


def linked(file: Path, alias: Path) -> Path:
    alias.symlink_to(file)
    return alias


def linked_twice(file: Path, alias: Path) -> Path:
    between = alias.with_name("between")
    between.symlink_to(file)
    alias.symlink_to(between.name)
    return alias


def by_a_second_name(file: Path, alias: Path) -> Path:
    os.link(file, alias)
    return alias


def in_a_linked_folder(file: Path, alias: Path) -> Path:
    folder = alias.with_name("folder")
    folder.symlink_to(file.parent)
    return folder / file.name


Naming = Callable[[Path, Path], Path]
LINKS: list[Naming] = [linked, linked_twice, by_a_second_name]
NAMINGS: list[Naming] = [itself, spelt, relative, in_a_linked_folder, *LINKS]


def refused(words: list[str | Path], file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command ends with 2, says why, and the file is what it was, with nothing beside it."""
    before = file.read_bytes()
    listing = sorted(file.parent.iterdir())
    assert main([str(word) for word in words]) == 2
    said = capsys.readouterr().err
    assert "which is read: this would overwrite it; write to another file" in said and file.name in said
    assert file.read_bytes() == before and sorted(file.parent.iterdir()) == listing


FILES: dict[str, tuple[str, list[str]]] = {
    "predict of a table": ("q.csv", ["predict", "c.yaml", "{file}", "-o", "{out}"]),
    "predict of a calibration": ("c.csv", ["predict", "{file}", "q.csv", "-o", "{out}"]),
    "compensate of a table": ("p.parquet", ["compensate", "c.yaml", "{file}", "-o", "{out}"]),
    "compensate of a calibration": ("c.csv", ["compensate", "{file}", "--grid", "3", "-o", "{out}"]),
    "compensate of a program": ("p.script", ["compensate", "c.yaml", "{file}", "-o", "{out}"]),
    "merge of joints": ("j.csv", ["merge", "{file}", "t.csv", "--urdf", "r.urdf", "--tip", "t", "-o", "{out}"]),
    "merge of a tracker": ("t.csv", ["merge", "j.csv", "{file}", "--urdf", "r.urdf", "--tip", "t", "-o", "{out}"]),
    "measure": ("head.csv", ["measure", "{file}", "-o", "{out}"]),
    "detect of joints": ("j.csv", ["detect", ".", "--joints", "{file}", "-o", "{out}"]),
    "detect of a camera": ("camera.csv", ["detect", ".", "--intrinsics", "{file}", "-o", "{out}"]),
    "check of rows": ("rows.csv", ["check", "results", "{file}", "--poses", "{out}"]),
    "export to NumPy": ("c.py", ["export", "{file}", "--numpy", "{out}"]),
    "export to MuJoCo": ("c.xml", ["export", "{file}", "--mjcf", "{out}"]),
    "check of a calibration": ("c.csv", ["check", "{file}", "rows.csv", "--poses", "{out}"]),
}


@pytest.mark.parametrize("naming", NAMINGS)
@pytest.mark.parametrize(("name", "words"), FILES.values(), ids=FILES)
def test_a_table_that_is_read_is_not_written(
    name: str, words: list[str], naming: Naming, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "in" / name
    (tmp_path / "out").mkdir()
    file.parent.mkdir()
    file.write_text("what was measured")
    out = naming(file, tmp_path / "out" / f"other{file.suffix}")
    refused([word.format(file=file, out=out) for word in words], file, capsys)


BESIDE: dict[str, tuple[str, list[str]]] = {
    "the page of merge": (
        "m.html",
        ["merge", "{file}", "t.csv", "--urdf", "r.urdf", "--tip", "t", "-o", "{folder}/m.csv"],
    ),
    "the corrections of compensate": (
        "p.script.corrections.csv",
        ["compensate", "{file}", "in.script", "-o", "{folder}/p.script"],
    ),
    "the refused shots of measure": ("refused.csv", ["measure", "{file}", "-o", "{folder}/poses.csv"]),
    "the refused images of detect": (
        "refused.csv",
        ["detect", ".", "--joints", "{file}", "-o", "{folder}/corners.csv"],
    ),
    "compare": ("compare.json", ["compare", "{file}", "results", "-o", "{folder}"]),
    "history": ("history.csv", ["history", "{tree}", "-o", "{folder}"]),
    "fleet": ("fleet.html", ["fleet", "{file}", "-o", "{folder}"]),
    "study": ("study.parquet", ["study", "{file}", "-o", "{folder}"]),
    "simulate": ("campaign.yaml", ["simulate", "{file}", "-o", "{folder}"]),
    "export as C": ("out.c", ["export", "{file}", "--c", "{folder}"]),
    "export to ROS 2": ("calibrated.urdf", ["export", "{file}", "--ros2", "{folder}"]),
    "export of draws": ("frames.csv", ["export", "{file}", "--randomize", "2", "-o", "{folder}"]),
    "export of tables": ("tables.csv", ["export", "{file}", "--table", "1deg", "-o", "{folder}"]),
    "recalibrate of rows": ("residuals.csv", ["recalibrate", "results", "{file}", "-o", "{folder}"]),
    "recalibrate of a calibration": ("calibration.yaml", ["recalibrate", "{file}", "rows.csv", "-o", "{folder}"]),
}


@pytest.mark.parametrize("naming", LINKS)
@pytest.mark.parametrize(("name", "words"), BESIDE.values(), ids=BESIDE)
def test_what_is_written_beside_or_into_a_folder_replaces_nothing_that_is_read(
    name: str, words: list[str], naming: Naming, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "tree" / "in" / "fleet.parquet"
    file.parent.mkdir(parents=True)
    file.write_text("what was measured")
    (tmp_path / "out").mkdir()
    naming(file, tmp_path / "out" / name)
    refused([word.format(file=file, tree=tmp_path / "tree", folder=tmp_path / "out") for word in words], file, capsys)


@pytest.mark.parametrize("naming", NAMINGS)
@pytest.mark.parametrize(("key", "name"), [("urdf", "calibrated.urdf"), ("file", "residuals.csv"), ("", "report.html")])
def test_identify_guide_and_design_replace_nothing_that_the_campaign_names(
    key: str, name: str, naming: Naming, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(ROOT / "urdf" / "arid.urdf", tmp_path / "r.urdf")
    (tmp_path / "m.csv").write_text("joint_1\n")
    keys = {
        "format": 1,
        "robot": {"urdf": "r.urdf", "base": "base_link", "tip": "flange"},
        "measurements": {"file": "m.csv", "kind": "pose"},
    }
    campaign = tmp_path / "campaign.yaml"
    campaign.write_text(yaml.safe_dump(keys))
    file = {"urdf": tmp_path / "r.urdf", "file": tmp_path / "m.csv", "": campaign}[key]
    for folder in ("out", "plan"):
        (tmp_path / folder).mkdir()
    os.link(file, tmp_path / "out" / name)  # a link is refused in any case
    refused(["identify", campaign, "-o", tmp_path / "out"], file, capsys)
    refused(["guide", campaign, "--no-page", "-o", tmp_path / "out"], file, capsys)
    plan = naming(file, tmp_path / "plan" / "plan.csv")
    if plan.suffix == ".csv":  # no other ending is written
        refused(["design", campaign, "-n", "5", "-o", plan], file, capsys)


def test_simulate_replaces_no_robot_that_its_scenario_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(ROOT / "urdf" / "arid.urdf", tmp_path / "r.urdf")
    keys = {
        "format": 1,
        "robot": {"urdf": "r.urdf", "base": "base_link", "tip": "flange"},
        "measurements": {"kind": "pose", "noise": {"position": 1e-4, "rotation": 1e-4}},
        "truth": {"n": 5, "seed": 1, "noise": {"position": 1e-4, "rotation": 1e-4}},
    }
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(keys))
    (tmp_path / "out").mkdir()
    os.link(tmp_path / "r.urdf", tmp_path / "out" / "r.urdf")
    refused(["simulate", tmp_path / "scenario.yaml", "-o", tmp_path / "out"], tmp_path / "r.urdf", capsys)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["r.urdf"]


@pytest.mark.parametrize("naming", NAMINGS)
def test_init_replaces_nothing_at_all(naming: Naming, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    file = tmp_path / "in" / "m.csv"
    file.write_text("what was measured")
    out = naming(file, tmp_path / "other")
    assert main(["init", "--urdf", "r.urdf", "--measurements", str(file), "-o", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err and file.read_text() == "what was measured"


def test_every_command_that_writes_is_tried_here() -> None:
    tried = {words[0] for _, words in (*FILES.values(), *BESIDE.values())} | {"identify", "guide", "design", "init"}
    assert tried == set(COMMANDS) - {"print", "view", "doctor", "completion"}  # which read no file, or write none


def test_files_that_are_not_there_yet_are_the_same_by_their_path(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "missing")
    with pytest.raises(OutputError, match=r"link: is .*missing, which is read"):
        check_apart([tmp_path / "link"], [tmp_path / "missing"])
    check_apart([tmp_path / "link"], [tmp_path / "other", None, tmp_path])
    check_apart([], [tmp_path])
