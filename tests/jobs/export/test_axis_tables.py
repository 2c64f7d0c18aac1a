"""Compensation tables of controllers: a machine that follows them goes where it is sent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from exported import saved_from, written

from aridcal import export
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.model.model import Model
from aridcal.jobs.calibrate.saved_model import SavedModel

TURNING, SLIDING = "joint_2", "joint_1"


@pytest.fixture(scope="module")
def wavy() -> SavedModel:
    """A rail and a joint with waves, one of them with backlash, and an effect that no table can hold."""
    robot = robots.random_robot(3, "PRR")
    coefficients = (
        Coefficient(TURNING, "axis", Basis("sin", (TURNING,), (3.0,))),
        Coefficient(TURNING, "axis", Basis("linear", (f"{TURNING}_direction",), (0.0,))),
        Coefficient(SLIDING, "axis", Basis("cos", (SLIDING,), (6.0,))),
        Coefficient("joint_3", "axis", Basis("linear", ("joint_3.gravity_torque",), (0.0,))),
    )
    saved = saved_from(Model(robot, coefficients), np.array([1e-3, 2e-4, 5e-4, 0.0]))
    return replace(saved, ranges=saved.ranges | {TURNING: (-1.01, 1.02), SLIDING: (-0.3, 0.3)})


def followed(table: np.ndarray, wanted: np.ndarray, way: int) -> np.ndarray:
    """Where LinuxCNC sends the motor for places that it is sent to: by as much the other way as the axis would be off."""
    return wanted + np.interp(wanted, table[:, 0], table[:, 0] - table[:, way])


@pytest.mark.parametrize("sense", [1, -1])
def test_an_axis_that_follows_its_table_stands_where_the_nominal_arm_would(
    wavy: SavedModel, tmp_path: Path, sense: int, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written(wavy, tmp_path / "r")
    assert export.main([str(folder), "--table", "1deg, 5mm", "-o", str(tmp_path / "t")]) == 0
    said = capsys.readouterr().out
    turning = np.loadtxt(tmp_path / "t" / f"{TURNING}.comp") * np.pi / 180.0
    sliding = np.loadtxt(tmp_path / "t" / f"{SLIDING}.comp") * 1e-3
    rng, model = np.random.default_rng(0), wavy.final.model
    wanted = rng.uniform([-0.3, -1.0, -0.5], [0.3, 1.0, 0.5], (50, 3))
    way = 1 if sense > 0 else 2
    sent = np.column_stack([followed(sliding, wanted[:, 0], way), followed(turning, wanted[:, 1], way), wanted[:, 2]])
    bare = Model(model.robot, ())
    meant = bare.poses(np.zeros(0), bare.rows(wanted))[1]
    columns = {f"{TURNING}_direction": np.full(50, float(sense))}
    off = np.linalg.norm(wavy.final.poses(sent, columns)[1] - meant, axis=1)
    without = np.linalg.norm(wavy.final.poses(wanted, columns)[1] - meant, axis=1)
    assert off.max() < 0.02 * without.max()
    between = 1e-3 * 3.0**2 * np.radians(1.0) ** 2 / 8  # a wave's second derivative, times the square of a step
    assert f"off by {1e3 * between:.2g} mrad at most" in said
    assert len(turning) == 118 and turning[0, 0] == pytest.approx(np.radians(-58)) and len(sliding) == 121


def test_all_controllers_are_told_the_same_in_their_own_files(wavy: SavedModel, tmp_path: Path) -> None:
    folder = written(wavy, tmp_path / "r")
    command = [str(folder), "--table", "2deg,10mm", "-o", str(tmp_path / "t")]
    assert export.main(command) == 0
    for name in ("own.comp", f"{TURNING}_eec.ini"):
        (tmp_path / "t" / name).write_text("mine")
    assert export.main(command) == 0  # its own files are written anew, and others stay
    assert (tmp_path / "t" / "own.comp").read_text() == "mine"
    for joint, number, scale in ((TURNING, 2, 180 / np.pi), (SLIDING, 1, 1e3)):
        table = pd.read_csv(tmp_path / "t" / "tables.csv").query("joint == @joint")
        rising, falling, at = (table[name].to_numpy() * scale for name in ("rising", "falling", "reading"))
        comp = np.loadtxt(tmp_path / "t" / f"{joint}.comp")
        np.testing.assert_allclose(comp, np.column_stack([at, at + rising, at + falling]), atol=1e-6)
        text = (tmp_path / "t" / f"{joint}_eec.ini").read_text("utf-8")
        values = {line.partition("=")[0]: line.partition("=")[2] for line in text.splitlines() if line.startswith("$")}
        assert float(values[f"$AA_ENC_COMP_MIN[0,AX{number}]"]) == pytest.approx(at[0])
        assert float(values[f"$AA_ENC_COMP_STEP[0,AX{number}]"]) == pytest.approx(at[1] - at[0])
        mean = [float(values[f"$AA_ENC_COMP[0,{k},AX{number}]"]) for k in range(len(at))]
        np.testing.assert_allclose(mean, (rising + falling) / 2, atol=1e-6)
        com = pd.read_csv(tmp_path / "t" / f"{joint}_com.csv")
        np.testing.assert_allclose(com.to_numpy(), np.column_stack([at, falling, rising]), atol=1e-6)


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        ("1deg", "no step for joint_1 (5mm)"),
        ("1deg,2deg", "two steps of one kind"),
        ("1", "should be a number with its unit"),
        ("200deg,5mm", "is too large"),
        ("0.0000001deg,5mm", "is too small"),
    ],
)
def test_a_grid_that_makes_no_table_is_refused(
    grid: str, words: str, wavy: SavedModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written(wavy, tmp_path / "r")
    assert export.main([str(folder), "--table", grid, "-o", str(tmp_path / "t")]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "t").exists()


def test_a_calibration_without_curves_has_no_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = robots.arid()
    folder = written(saved_from(Model(robot, (Coefficient("joint_2", "axis"),)), np.array([1e-3])), tmp_path / "r")
    assert export.main([str(folder), "--table", "1deg", "-o", str(tmp_path / "t")]) == 2
    assert "no joint has an error curve of its own" in capsys.readouterr().err
