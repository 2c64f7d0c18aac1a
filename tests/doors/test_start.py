"""How a command starts: what is not needed yet, or at all, is not loaded. Modules are counted, not seconds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from repository import ROOT
from scipy.stats import binom

from aridcal.engine.fit.flags import cluster, coordinates
from aridcal.engine.rows.repeats import by_appearance, earlier_occurrences, first_alike
from aridcal.identify import main
from aridcal.jobs.calibrate.folder import residual_table, write_results
from aridcal.jobs.calibrate.pipeline import identify

SLOW = {"cv2", "matplotlib", "meshcat", "pandas", "scipy", "trimesh"}
"""What takes a tenth of a second or more to load, and what draws."""


def loaded(code: str, *arguments: str) -> set[str]:
    """Modules that are there after some code has run in a process of its own."""
    report = f"import json, sys\n{code}\nsys.stderr.write('\\n' + json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", report, *arguments], check=True, capture_output=True, text=True, cwd=ROOT
    )
    return set(json.loads(done.stderr.splitlines()[-1]))


def test_a_program_is_corrected_without_the_libraries_that_tables_need() -> None:
    there = loaded("import aridcal.compensate")
    assert "aridcal.jobs.apply.programs.correct" in there
    assert not there & {"pandas", "pyarrow", "openpyxl"}


def test_the_list_of_commands_needs_no_arrays() -> None:
    assert not loaded("from aridcal.__main__ import main; main(['--help'])") & {*SLOW, "numpy", "pinocchio", "pydantic"}


def test_a_folder_of_any_letters_is_found_in_the_c_locale(tmp_path: Path) -> None:
    """Python reads names in UTF-8 there by itself (PEP 540), unless it is told not to."""
    folder = tmp_path / "Süd"
    folder.mkdir()
    (folder / "campaign.yaml").write_text("format: 1\n")
    ascii_alone = {
        **{k: v for k, v in os.environ.items() if k != "PYTHONUTF8"},
        "LC_ALL": "C",
        "PYTHONCOERCECLOCALE": "0",
    }
    done = subprocess.run(
        [sys.executable, "-m", "aridcal", "identify", str(folder / "campaign.yaml")],
        capture_output=True,
        cwd=ROOT,
        env=ascii_alone,
    )
    said = done.stderr.decode()
    assert done.returncode == 2 and "Süd" in said and "robot" in said  # read, and lacks the robot


def test_a_name_that_is_not_utf8_is_called_so(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main([os.fsdecode(b"S\xfcd/campaign.yaml")])
    assert "is not UTF-8, as this session reads names: rename it" in capsys.readouterr().err


def test_a_slip_in_a_table_is_told_before_what_fits_is_loaded(tmp_path: Path) -> None:
    truth = robots.simulate(robots.ur10(), 30, np.random.default_rng(1), noise=1e-4)
    rows = robots.table(truth).rename(columns={"elbow_joint": "elbow"})
    path = robots.write_campaign(tmp_path, truth, rows)
    there = loaded("import aridcal.identify; assert aridcal.identify.main(sys.argv[1:]) == 2", str(path))
    assert "aridcal.files.read" in there  # it is what reads
    assert not there & SLOW
    late = ("aridcal.engine.search", "aridcal.engine.trust", "aridcal.pages.report")
    assert not {name for name in there if name.startswith(late)}


def test_a_whole_calibration_needs_neither_scipy_stats_nor_pandas_nor_matplotlib(tmp_path: Path) -> None:
    """Of targets that the table names, too."""
    truth = robots.simulate(robots.arid(), 60, np.random.default_rng(1), noise=1e-4)
    rows = robots.table(truth).assign(target=np.where(np.arange(60) % 2, "left", "right"))
    ends = {side: {"on": truth.model.robot.tip} for side in ("left", "right")}
    path = robots.write_campaign(tmp_path, truth, rows, instruments={"targets": ends})
    there = loaded("import aridcal.identify; assert aridcal.identify.main(sys.argv[1:]) == 0", str(path))
    assert (tmp_path / "results" / "report.html").stat().st_size > 100_000
    assert {"aridcal.pages.report.page", "scipy.linalg"} <= there
    assert not there & {"cv2", "matplotlib", "pandas", "scipy.interpolate", "scipy.stats"}


@pytest.mark.parametrize("module", ["aridcal", "aridcal.command_line"])
def test_what_every_command_loads_is_little(module: str) -> None:
    assert not loaded(f"import {module}") & {*SLOW, "numpy"}


# ---- what stands in the place of a library does what it did ----------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_rows_that_are_alike_are_those_that_pandas_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole = rng.integers(0, 3, (200, 2)).astype(float)
    whole[rng.random((200, 2)) < 0.2] = np.nan
    columns = [*whole.T, rng.choice(["a", "b", ""], 200), np.where(rng.random(200) < 0.5, 0.0, -0.0)]
    frame = pd.DataFrame(dict(enumerate(columns)))
    group = frame.groupby(list(frame.columns), sort=False, dropna=False).ngroup().to_numpy()
    first = first_alike(columns)
    np.testing.assert_array_equal(first, [np.flatnonzero(group == own)[0] for own in group])
    np.testing.assert_array_equal(by_appearance(first), pd.factorize(first)[0])


def test_of_no_rows_none_are_alike() -> None:
    assert len(first_alike([np.zeros(0)])) == len(by_appearance(np.zeros(0))) == 0


def test_rows_that_were_seen_before_are_counted_as_pandas_counts() -> None:
    labels = np.random.default_rng(0).integers(0, 40, 300)
    mixed = pd.Series(labels).sample(frac=1.0, random_state=0)
    order = np.random.RandomState(0).permutation(300)
    np.testing.assert_array_equal(order, mixed.index)
    np.testing.assert_array_equal(earlier_occurrences(labels[order]), mixed.groupby(mixed).cumcount())
    assert len(earlier_occurrences(labels[:0])) == 0


def test_residuals_are_written_as_pandas_would(tmp_path: Path) -> None:
    truth = robots.simulate(robots.arid(), 40, np.random.default_rng(1), noise=1e-4)
    rows = robots.table(truth).assign(station=np.where(np.arange(40) % 2, 'a, "b"', ""))
    path = robots.write_campaign(tmp_path, truth, rows, measurements={"file": "b, c.csv"})
    (tmp_path / "measurements.csv").rename(tmp_path / "b, c.csv")
    outcome = identify(path)
    holes = outcome.stages[0].residual.copy()
    holes[3, 2] = np.nan
    outcome = replace(outcome, stages=(replace(outcome.stages[0], residual=holes), *outcome.stages[1:]))
    write_results(outcome, tmp_path)
    table = residual_table(outcome)
    assert (tmp_path / "residuals.csv").read_text() == table.to_csv(
        index=False, float_format="%.9g", lineterminator="\n"
    )
    assert table.index.tolist() == outcome.measurements.as_read.tolist()


def test_the_chance_of_a_cluster_is_the_binomial_one() -> None:
    rng = np.random.default_rng(0)
    data = robots.measured(robots.ur10(), rng.uniform(-3, 3, (250, 6)), rng.normal(size=(250, 3)))
    flags = np.zeros(250, dtype=bool)
    flags[np.argsort(data.readings[:, 2])[40:47]] = flags[[3, 99]] = True
    found = cluster(flags, data)
    assert found is not None
    values, f = coordinates(data)[found.coordinate], int(flags.sum())
    inside = int(((values >= found.low) & (values <= found.high)).sum())
    chance = binom.sf(found.rows.sum() - 2, f - 1, (inside - 1) / 249)
    assert found.p_value == pytest.approx(min(1.0, chance * f * (f - 1) * len(coordinates(data))), rel=1e-9)
