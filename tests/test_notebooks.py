"""Every notebook runs from top to bottom, and says at its end what it set out to show."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pytest
from IPython.core.interactiveshell import InteractiveShell
from traitlets.config import Config

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

SHOWN = {
    "1-the-report-of-1992": r"rank of the printed 8 × 8 matrix: 8\nrank of the right one: +4\n 2 poses: confounded: joint_1",
    "2-calibrate-the-arid": r"on 1,000 poses that nobody measured: 0\.0\d\d mm RMS(.|\n)*found: sonar_2\.bias = 3\.\d\d ±",
    "3-the-undeclared-effect": r"verdict: noise_floor(.|\n)*found: joint_compliance at joint_3",
    "4-a-real-ur10": r"nominal +1\.[01]\d\d(.|\n)*final +0\.1[0-3]\d(.|\n)*flagged: \[532, 854, 855, 1063\]",
    "6-a-ball-and-two-sockets": r"nominal +[89]\.\d{3}(.|\n)*final +0\.[45]\d\d mm RMS at the place that was held out",
    "7-two-arms": r"effects: joint_compliance at left_joint_2(.|\n)*final +0\.05\d mm RMS of the bar(.|\n)*mm at most",
    "5-your-own-robot": r"euler: ZYX(.|\n)*GUESSED: by their ORDER(.|\n)*measured minus predicted: 0\.1\d\d mm RMS",
}
COLOUR = re.compile(r"\x1b\[[\d;]*m")


@pytest.fixture
def shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[InteractiveShell]:
    """What a kernel is around, in this process: cells, and values shown as text and as HTML."""
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    monkeypatch.chdir(FOLDER)
    plt.switch_backend("agg")
    yield InteractiveShell(config=Config(HistoryManager={"enabled": False}))
    plt.close("all")


@pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_shows_what_it_promises(path, request, shell, capsys):
    if path.stem[0] in "46":
        request.getfixturevalue("shared_data")  # skips, with the reason, where it is absent
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "code":
            shell.run_cell(cell.source).raise_error()
    said = COLOUR.sub("", capsys.readouterr().out).replace("\r", "")
    assert re.search(SHOWN[path.stem], said), said


def test_notebooks_are_kept_without_outputs():
    assert {path.stem for path in NOTEBOOKS} == set(SHOWN)
    for path in NOTEBOOKS:
        cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
        assert all(not cell.outputs and cell.execution_count is None for cell in cells), path
