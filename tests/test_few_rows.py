"""Rows that are too few for a controller: that is said first, in red, and no tolerance is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import robots

from aridcal import identify
from aridcal.result.pipeline import identify as identified


def campaign(folder: Path, rows: int) -> Path:
    truth = robots.simulate(robots.ur10(), rows, np.random.default_rng(4), 1e-3, 5e-5, kind="position")
    return robots.write_campaign(folder, truth)


@pytest.mark.parametrize(("rows", "ready"), [(14, False), (20, False), (120, True)])
def test_few_rows_are_not_for_a_controller(
    rows: int, ready: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "300")
    path = campaign(tmp_path, rows)
    status = identify.main([str(path), "--tolerance", "50mm"])
    said = capsys.readouterr().out
    red = "\x1b[1;31mNot for a controller" in said
    page = (tmp_path / "results" / "report.html").read_text("utf-8")
    assert (status, red, 'class="refused"' in page) == ((0, False, False) if ready else (3, True, True))
    assert (
        ("for your controller" in page)
        == ("In your controller" in page)
        == ("next: aridcal compensate" in said)
        == ready
    )
    assert ("nobody can say" in said) == (not ready)


def test_without_a_tolerance_few_rows_are_no_failure_and_still_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert identify.main([str(campaign(tmp_path, 14))]) == 0
    assert capsys.readouterr().out.lstrip().startswith("Not for a controller")


def test_what_is_left_to_judge_by_decides_and_not_the_number_of_rows(tmp_path: Path) -> None:
    """A pose is six numbers, a position three: as many rows of the one are enough where those of the other are not."""
    truth = robots.simulate(robots.ur10(), 25, np.random.default_rng(4), 1e-3, 5e-5)
    assert identified(robots.write_campaign(tmp_path, truth)).verdict.for_controller
    assert not identified(campaign(tmp_path, 25)).verdict.for_controller
