"""Every notebook runs from top to bottom, and says at its end what it set out to show."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest

from notebooks import FOLDER, SHOWN, ran

ELSEWHERE = {"2-calibrate-the-arid", "7-two-arms"}
"""Run by tests that go on with what they leave: `test_head_detections.py`, `test_tree_examples.py`."""


@pytest.mark.parametrize("name", [name for name in SHOWN if name not in ELSEWHERE])
def test_notebook_runs_and_shows_what_it_promises(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    if name[0] in "46":
        request.getfixturevalue("shared_data")  # skips, with the reason, where it is absent
    ran(name, tmp_path)


def test_notebooks_are_kept_without_outputs() -> None:
    notebooks = {path.stem: nbformat.read(path, as_version=4) for path in FOLDER.glob("*.ipynb")}
    assert set(notebooks) == set(SHOWN)
    for name, notebook in notebooks.items():
        cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
        assert all(not cell.outputs and cell.execution_count is None for cell in cells), name
