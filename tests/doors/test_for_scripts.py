"""Commands as scripts call them: --quiet says nothing, --json says one line of JSON that agrees with result.json."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
import ur10_saved
from repository import ROOT

from aridcal.__main__ import COMMANDS
from aridcal.check import main as check
from aridcal.compare import main as compare
from aridcal.identify import main as identify


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    truth = robots.simulate(robots.arid(), 60, np.random.default_rng(0), noise=1e-4)
    return robots.write_campaign(tmp_path_factory.mktemp("scripts"), truth)


def test_quiet_prints_nothing_and_errors_all_the_same(campaign: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert identify([str(campaign), "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert (campaign.parent / "results" / "report.html").is_file()
    assert identify([str(campaign.with_name("nowhere.yaml")), "--quiet"]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert "nowhere.yaml" in err


def test_json_is_one_line_and_says_what_result_json_says(campaign: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert identify([str(campaign), "--json"]) == 0
    out, err = capfd.readouterr()
    said = json.loads(out)
    assert out.count("\n") == 1
    assert "fitting" in err  # progress goes on beside it
    written = json.loads((campaign.parent / "results" / "result.json").read_text())
    assert said["verdict"] == written["verdict"]
    assert said["error"]["final"] == written["error"]["final"]["test"]
    assert said["rows"] == f"{written['n']['test']} held-out rows"
    assert Path(said["report.html"]).is_file()


def test_a_check_as_json_agrees_with_its_exit_status(campaign: Path, capfd: pytest.CaptureFixture[str]) -> None:
    results, rows = campaign.parent / "results", pd.read_csv(campaign.parent / "measurements.csv")[:10]
    for moved, status in ((0.0, 0), (0.01, 3)):
        table = rows.assign(joint_2=rows["joint_2"] + moved)
        table.to_csv(campaign.parent / "new.csv", index=False)
        assert check([str(results), str(campaign.parent / "new.csv"), "--json", "--quiet"]) == status
        said = json.loads(capfd.readouterr().out)
        assert said["good"] == (status == 0)
        assert said["said"]


def test_in_a_pipe_no_line_is_broken(campaign: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert identify([str(campaign)]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert max(map(len, lines)) > 80
    assert any(line.startswith("In 95 % of the range") and line.endswith("with 95 % confidence.") for line in lines)
    results = campaign.parent / "results"
    report = lines.index(f"report: {results / 'report.html'}")
    assert lines[report + 1] == f"next: aridcal compensate {results} program.script -o corrected.script"
    assert "docs/apply/index.md" in lines[report + 2]
    assert (ROOT / "docs" / "apply" / "index.md").is_file()
    assert len(lines) == report + 3


def test_a_quiet_comparison_says_its_answer_by_its_status_alone(
    campaign: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    results = str(campaign.parent / "results")
    assert compare([results, results]) == 0
    assert capfd.readouterr().out
    assert compare([results, results, "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")


PRINTS_ITS_RESULT = ("guide", "view", "completion")
"""What these print is what they are for: the next pose, an address, a script."""


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in PRINTS_ITS_RESULT])
def test_every_command_can_be_quiet(command: str) -> None:
    assert "--quiet" in importlib.import_module(f"aridcal.{command}").parser().format_help()


def test_quiet_commands_write_what_the_others_write_and_say_nothing(
    campaign: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of the commands twice, with --quiet and without: the same files, no word."""
    monkeypatch.chdir(tmp_path)
    saved, table = str(campaign.parent / "results" / "calibration.yaml"), str(campaign.parent / "measurements.csv")
    Path("a.script").write_text("movej([0.1, -1.2, 1.3, -0.4, 0.5, 0.6])\n")
    Path("ur10.yaml").write_text(ur10_saved.calibration().dump(), encoding="utf-8")
    urdf = str(ROOT / "urdf" / "arid.urdf")
    lines = {
        "init": ["--urdf", urdf, "--measurements", table, "-o", "OUT.yaml"],
        "predict": [saved, table, "-o", "OUT.csv"],
        "compensate": ["ur10.yaml", "a.script", "-o", "OUT.script"],
        "print": ["charuco", "-o", "OUT.pdf"],
    }
    for command, arguments in lines.items():
        main = importlib.import_module(f"aridcal.{command}").main
        loud, quiet = ([word.replace("OUT", name) for word in arguments] for name in ("loud", "quiet"))
        assert main(loud) == 0
        assert any(capfd.readouterr())
        assert main([*quiet, "--quiet"]) == 0
        assert capfd.readouterr() == ("", ""), command
        assert (tmp_path / loud[-1]).read_bytes() == (tmp_path / quiet[-1]).read_bytes()
    assert importlib.import_module("aridcal.predict").main([saved, "nowhere.csv", "-o", "x.csv", "--quiet"]) == 2
    assert "nowhere.csv" in capfd.readouterr().err
