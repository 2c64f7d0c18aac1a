"""The notebooks, run in this process: what each has to say, and what it leaves behind."""

from __future__ import annotations

import io
import re
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import nbformat
from IPython.core.interactiveshell import InteractiveShell
from repository import ROOT
from traitlets.config import Config

FOLDER = ROOT / "notebooks"

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


def ran(name: str, home: Path) -> dict[str, Any]:
    """Names and values of a notebook that ran from top to bottom and said what it promises.

    Args:
        name: Of the notebook, without its suffix.
        home: Folder for IPython's own files.
    """
    said, notebook = io.StringIO(), nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    plt.switch_backend("agg")
    shell = InteractiveShell(ipython_dir=str(home), config=Config(HistoryManager={"enabled": False}))
    with chdir(FOLDER), redirect_stdout(said):
        for cell in notebook.cells:
            if cell.cell_type == "code":
                shell.run_cell(cell.source).raise_error()
    plt.close("all")
    shown = COLOUR.sub("", said.getvalue()).replace("\r", "")
    assert re.search(SHOWN[name], shown), shown
    return dict(shell.user_ns)
