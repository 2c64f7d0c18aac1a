"""Every notebook runs from top to bottom, and says at its end what it set out to show."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

SHOWN = {
    "1-the-report-of-1992": r"rank of the printed 8 × 8 matrix: 8\nrank of the right one: +4\n 2 poses: confounded: joint_1",
    "2-calibrate-the-arid": r"on 1,000 poses that nobody measured: 0\.0\d\d mm RMS(.|\n)*found: sonar_2\.bias = 3\.\d\d ±",
    "3-the-undeclared-effect": r"verdict: noise_floor(.|\n)*found: joint_compliance at joint_3",
    "4-a-real-ur10": r"nominal +1\.[01]\d\d(.|\n)*final +0\.(0[5-9]|1[0-2])\d(.|\n)*flagged: \[532, 854, 855, (1062, )?1063\]",
    "6-a-ball-and-two-sockets": r"nominal +[89]\.\d{3}(.|\n)*final +0\.[45]\d\d mm RMS at the place that was held out",
    "7-two-arms": r"effects: joint_compliance at left_joint_2(.|\n)*final +0\.05\d mm RMS of the bar(.|\n)*mm at most",
    "5-your-own-robot": r"euler: ZYX(.|\n)*GUESSED: by their ORDER(.|\n)*measured minus predicted: 0\.1\d\d mm RMS",
}
COLOUR = re.compile(r"\x1b\[[\d;]*m")


def said(notebook: nbformat.NotebookNode) -> str:
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return COLOUR.sub("", "".join(output.get("text", "") for output in outputs)).replace("\r", "")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_shows_what_it_promises(path, request, tmp_path, monkeypatch):
    if path.stem[0] in "46":
        request.getfixturevalue("shared_data")  # skips, with the reason, where it is absent
    for variable in ("JUPYTER_RUNTIME_DIR", "IPYTHONDIR", "TMPDIR"):
        monkeypatch.setenv(variable, str(tmp_path))
    monkeypatch.setenv(
        "OMP_NUM_THREADS", "1"
    )  # as the Makefile has it: threads of tests that run side by side only wait
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(FOLDER)}}
    ).execute()
    assert re.search(SHOWN[path.stem], said(notebook)), said(notebook)


def test_notebooks_are_kept_without_outputs():
    assert {path.stem for path in NOTEBOOKS} == set(SHOWN)
    for path in NOTEBOOKS:
        cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
        assert all(not cell.outputs and cell.execution_count is None for cell in cells), path
