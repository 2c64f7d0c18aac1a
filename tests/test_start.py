"""How a command starts: what is not needed yet, or at all, is not loaded. Modules are counted, not seconds."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import robots

SLOW = {"cv2", "matplotlib", "meshcat", "pandas", "scipy", "trimesh"}
"""What takes a tenth of a second or more to load, and what draws."""

HOME = Path(__file__).resolve().parents[1]


def loaded(code: str, *arguments: str) -> set[str]:
    """Modules that are there after some code has run in a process of its own."""
    report = f"import json, sys\n{code}\nsys.stderr.write('\\n' + json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", report, *arguments], check=True, capture_output=True, text=True, cwd=HOME
    )
    return set(json.loads(done.stderr.splitlines()[-1]))


def test_what_loads_slowly_is_seen_by_this_test() -> None:
    assert loaded("import scipy.stats, pandas") >= {"scipy.stats", "pandas", "numpy"}


def test_identify_is_ready_to_read_its_table_with_no_slow_library() -> None:
    there = loaded("import aridcal.identify")
    assert "aridcal.inputs.read" in there  # it is what reads
    assert not there & SLOW
    assert not {name for name in there if name.startswith(("aridcal.search", "aridcal.trust", "aridcal.report"))}


def test_the_list_of_commands_needs_no_arrays() -> None:
    assert not loaded("from aridcal.__main__ import main; main(['--help'])") & {*SLOW, "numpy", "pinocchio", "pydantic"}


def test_a_slip_in_a_table_is_told_before_what_fits_is_loaded(tmp_path: Path) -> None:
    truth = robots.simulate(robots.ur10(), 30, np.random.default_rng(1), noise=1e-4)
    rows = robots.table(truth).rename(columns={"elbow_joint": "elbow"})
    path = robots.write_campaign(tmp_path, truth, rows)
    there = loaded("import aridcal.identify; assert aridcal.identify.main(sys.argv[1:]) == 2", str(path))
    assert "aridcal.inputs.read" in there
    assert not there & SLOW


def test_a_whole_calibration_needs_neither_scipy_stats_nor_pandas_nor_matplotlib(tmp_path: Path) -> None:
    truth = robots.simulate(robots.ur10(), 60, np.random.default_rng(1), noise=1e-4)
    path = robots.write_campaign(tmp_path, truth)
    there = loaded("import aridcal.identify; assert aridcal.identify.main(sys.argv[1:]) == 0", str(path))
    assert (tmp_path / "results" / "report.html").stat().st_size > 100_000
    assert {"aridcal.report.page", "scipy.linalg"} <= there
    assert not there & {"cv2", "matplotlib", "pandas", "scipy.interpolate", "scipy.stats"}


@pytest.mark.parametrize("module", ["aridcal", "aridcal.command_line"])
def test_what_every_command_loads_is_little(module: str) -> None:
    assert not loaded(f"import {module}") & {*SLOW, "numpy"}
