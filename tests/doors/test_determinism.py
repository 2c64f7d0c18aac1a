"""The same measurements give the same bytes, wherever, on however many threads, and in whatever order of rows."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from repository import ROOT

import aridcal
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.read import load_measurements
from aridcal.files.tables import AnyTable
from aridcal.jobs.calibrate.folder import residual_table, result_document
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify

UNDECLARED, PLAIN = (ROOT / "identification" / name / "campaign.yaml" for name in ("arid-undeclared", "arid"))
PLACES = {"file", "line", "order"}
"""Of a data set: what is said of where a row stands."""

BY_ORDER = {"stale"}
"""What the order of rows says where there is no time: which of two rows with one measurement came later."""


def attacked(campaign: Path) -> pd.DataFrame:
    """Of a shipped table 150 rows, with everything that could depend on the order: a stale row, repeats, a copy, a hole, ties."""
    table = robots.read_csv(campaign.parent / "measurements.csv")[:150]
    pose = list("xyz") + ["qx", "qy", "qz", "qw"]
    joints = [name for name in table if name.startswith("joint")]
    table.loc[40, pose] = table.loc[39, pose]  # stale
    table.loc[70:79, joints] = table.loc[60:69, joints].to_numpy()  # repeats
    table.loc[90, "x"] += 0.05  # a gross error
    table.loc[100, "y"] = np.nan
    if "time" in table:
        table.loc[111, "time"] = table.loc[110, "time"]
        table.loc[120, "temperature"] = np.nan
    return pd.concat([table, table.iloc[[20]]], ignore_index=True)


def permuted(table: pd.DataFrame, seed: int) -> pd.DataFrame:
    return table.iloc[np.random.default_rng(seed).permutation(len(table))].reset_index(drop=True)


def arrays(rows: Dataset) -> dict[str, np.ndarray]:
    """All that a data set says of each row, by its name."""
    facts = (rows, rows.labels, rows.repeats, rows.origin)
    every = {f.name: getattr(of, f.name) for of in facts for f in fields(of)}
    return {name: value for name, value in every.items() if isinstance(value, np.ndarray)}


def read(campaign: Path, table: AnyTable) -> Dataset:
    job = load_campaign(campaign)
    robot = load_robot(job.robot.urdf, job.robot.tip, job.robot.base)
    return load_measurements(job, robot.readings, robot.limits, robot.kinds, 5, files=[table])


def calibrated(campaign: Path, table: pd.DataFrame) -> Outcome:
    job: Campaign = load_campaign(campaign)
    return identify(job.with_tables([table]))


def without_places(outcome: Outcome) -> str:
    """``result.json`` less the seconds and the rows' numbers, lists of rows sorted."""
    document = result_document(outcome) | {"seconds": 0}
    for rows in (document["n"]["refused"], document["n"]["outlier_rows"], document["influence"]["rows"]):
        for row in rows:
            row["row"] = 0
        rows.sort(key=json.dumps)
    text = re.sub(r"\b(lines?|rows?) \d+( and \d+)?", "row", json.dumps(document, indent=1))
    head, notices = text.split('"notices"')
    return head + "\n".join(sorted(notices.split("\n")))


def residuals_of(outcome: Outcome, table: pd.DataFrame) -> pd.DataFrame:
    """What each row leaves, by what it measured, from ``residuals.csv``."""
    found = residual_table(outcome)
    assert np.all(np.diff(found["row"]) > 0)  # as they stand in the file
    measured = table.loc[found["row"] - 2, ["joint_1", "joint_2", "x"]].reset_index(drop=True)
    found = pd.concat([measured, found.drop(columns=["file", "row", "stale"]).reset_index(drop=True)], axis=1)
    return found.sort_values(["joint_1", "joint_2", "x"], ignore_index=True)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("campaign", [UNDECLARED, PLAIN], ids=["timed", "untimed"])
def test_permuted_rows_are_read_as_the_same_data_to_the_last_bit(campaign: Path, seed: int) -> None:
    """All that is fitted, drawn and judged starts from these arrays."""
    table = attacked(campaign).assign(station="")
    table["station"] = np.where(table["x"] > 0, "b", "a")
    here, there = read(campaign, table), read(campaign, permuted(table, seed))
    assert (
        len(here) == len(table) - 2
        and here.test.any()
        and here.repeats.doubtful.sum() == 2
        and here.repeats.stale.sum() == 1
    )
    assert not np.array_equal(here.origin.line, there.origin.line)
    one, other = arrays(here), arrays(there)
    assert {"readings", "block", "station", "configuration", "stale", *PLACES} <= one.keys() == other.keys()
    for name in one.keys() - PLACES - (BY_ORDER if "time" not in table else set()):
        a, b = one[name], other[name]
        assert a.tobytes() == b.tobytes() if a.dtype != object else np.array_equal(a, b), name
    assert here.covariates.keys() == there.covariates.keys()
    for name, values in here.covariates.items():
        np.testing.assert_array_equal(values, there.covariates[name])
    if "time" in table:
        np.testing.assert_array_equal(here.sequence, there.sequence)


def test_held_out_configurations_depend_on_the_seed_and_not_on_the_order() -> None:
    table = attacked(PLAIN)
    job = load_campaign(PLAIN)
    robot = load_robot(job.robot.urdf, job.robot.tip, job.robot.base)

    def held_out(rows: pd.DataFrame, seed: int) -> set[float]:
        found = load_measurements(job, robot.readings, robot.limits, robot.kinds, seed, files=[rows])
        return set(found.readings[found.test, 1].tolist())

    first = held_out(table, 0)
    assert first == held_out(permuted(table, 1), 0) == held_out(table.iloc[::-1].reset_index(drop=True), 0)
    assert first != held_out(table, 1)


def folder_of(folder: Path, table: pd.DataFrame) -> Path:
    """The shipped campaign of timed rows, in a folder with another table."""
    folder.mkdir()
    text = UNDECLARED.read_text().replace("../../urdf", str(ROOT / "urdf"))
    (folder / "campaign.yaml").write_text(text)
    table.to_csv(folder / "measurements.csv", index=False)
    return folder


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> aridcal.Calibration:
    """Of timed rows, made by this process."""
    folder = folder_of(tmp_path_factory.mktemp("timed") / "one", attacked(UNDECLARED))
    return aridcal.calibrate(folder / "campaign.yaml")


def test_permuted_rows_with_a_time_give_the_same_result_to_the_last_bit(
    timed: aridcal.Calibration, tmp_path: Path
) -> None:
    """Also the effect that is found, the verdict and its reasons: with a time, the order of rows says nothing."""
    table = attacked(UNDECLARED)
    mixed = permuted(table, 3)
    here, there = timed.outcome, identify(folder_of(tmp_path / "two", mixed) / "campaign.yaml")
    assert here is not None
    assert [e.effect.kind for e in here.effects] == ["joint_compliance"] and here.outlier.any()
    assert without_places(here) == without_places(there)
    pd.testing.assert_frame_equal(residuals_of(here, table), residuals_of(there, mixed), check_exact=True)


def test_permuted_rows_without_a_time_give_the_same_numbers_to_the_last_bit() -> None:
    """What is said of the order itself (the reasons) may differ, and which of two rows was stale."""
    table = attacked(PLAIN)
    table["split"] = np.where(np.arange(len(table)) % 4 == 1, "test", "train")
    mixed = permuted(table, 4)
    here, there = calibrated(PLAIN, table), calibrated(PLAIN, mixed)
    for key in ("error", "noise", "frames", "parameters", "effects", "convergence"):
        assert result_document(here)[key] == result_document(there)[key], key
    pd.testing.assert_frame_equal(residuals_of(here, table), residuals_of(there, mixed), check_exact=True)


def test_commands_compute_on_one_blas_thread_however_many_are_asked_for() -> None:
    """Both libraries are found and held: an old threadpoolctl knows neither of those in today's wheels, and says nothing."""
    code = """
import os, threadpoolctl
from aridcal.command_line import run
def threads():
    import scipy.linalg
    print(sorted(i["num_threads"] for i in threadpoolctl.threadpool_info() if i["user_api"] == "blas"))
if {early}: threads()
run({between})
if {between} is not threads:
    threads()  # loads SciPy's after what was loaded has been looked for
    run(threads)
print(os.environ["OPENBLAS_NUM_THREADS"], os.environ.get("BLIS_NUM_THREADS"))
"""
    env = os.environ | {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2", "PYTHONPATH": str(ROOT)}
    two = min(2, os.cpu_count() or 1)
    at_two = f"[{two}, {two}]"
    before = {(True, "threads"): [at_two], (False, "threads"): [], (False, "dict"): [at_two]}  # SciPy's is loaded late
    for (early, between), first in before.items():
        words = [sys.executable, "-c", code.format(early=early, between=between)]
        said = subprocess.run(words, env=env, check=True, capture_output=True, text=True).stdout
        assert said.splitlines() == [*first, "[1, 1]", "2 None"]


def test_threads_hashes_language_clock_and_folder_change_no_byte(timed: aridcal.Calibration, tmp_path: Path) -> None:
    """This process, and a command on two threads, elsewhere, through a link, in another language, of another hash seed."""
    timed.save(tmp_path / "one")
    folder_of(tmp_path / "two", attacked(UNDECLARED))
    (tmp_path / "link").symlink_to("two")
    counts = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    words = {"PYTHONHASHSEED": "4711", "LC_ALL": "de_DE.UTF-8", "TZ": "Asia/Tokyo", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "aridcal.identify", str(tmp_path / "link" / "campaign.yaml")]
    subprocess.run(command, cwd="/", env=os.environ | counts | words, check=True)
    folders = tmp_path / "one", tmp_path / "two" / "results"
    here, there = (re.sub(rb'"seconds": [0-9.]+', b"", (f / "result.json").read_bytes()) for f in folders)
    assert here == there and len(here) > 1000
    for name in ("calibrated.urdf", "model.urdf", "calibration.yaml", "residuals.csv"):
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()
