"""G-code: what is corrected is driven to the end by another reader; what only the controller knows is left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from calibrated import Machine
from made_gcode import ZEROS, calibrated_gantry, drive, gcode
from robot_programs import error

from aridcal.compensate import main as compensate
from aridcal.programs import gcode as ours
from aridcal.programs.axes import axes_of
from aridcal.programs.branches import flange
from aridcal.programs.frames import KnownFrames

SLIDES = axes_of(("prismatic",) * 3)

KNOWN = KnownFrames(bases={"g54": np.eye(4), "g54.1 p3": np.eye(4)})


def miss(m: Machine, wanted: np.ndarray, there: np.ndarray) -> tuple[float, float]:
    """How far the true tip is from a place, and from where the calibrated model says, [m]."""
    return error(flange(m.model.robot, wanted), m, there)


@pytest.mark.parametrize("rotary", [False, True])
def test_only_numbers_change_and_a_controller_of_its_own_brings_the_real_gantry_to_the_places(
    rotary: bool, tmp_path: Path
) -> None:
    m = calibrated_gantry(rotary)
    robot = m.model.robot
    low, high = np.array([m.saved.ranges[name] for name in robot.readings]).T
    calibration, program, out = (tmp_path / name for name in ("calibration.yaml", "a.nc", "b.nc"))
    calibration.write_text(m.saved.dump())
    before, after, model, parts = [], [], [], []
    for seed in range(6):
        made = gcode(np.random.default_rng(seed), low, high, 25)
        program.write_bytes(made.text.encode())
        (tmp_path / "frames.yaml").write_text(made.frames)
        arguments = [str(calibration), str(program), "-o", str(out), "--frames", str(tmp_path / "frames.yaml")]
        assert compensate(arguments) == 0
        text = out.read_bytes().decode()
        assert made.read(text) is not None
        start = np.array(yaml.safe_load(made.frames)["start"]) * ([1e-3] * 3 + [np.pi / 180] * rotary)
        zeros = {**ZEROS, "G57": (0.0, 0.0, 0.0)}
        was, now = ({b.line: b.place for b in drive(t, robot.kinds, zeros, start)} for t in (made.text, text))
        for row in pd.read_csv(tmp_path / "b.nc.corrections.csv").itertuples():
            q, there = was[row.line], now[row.line]
            if row.corrected and isinstance(row.remark, str):
                parts.append(miss(m, q, there)[0] - miss(m, q, q)[0])
            elif row.corrected:
                before.append(miss(m, q, q)[0])
                after.append(miss(m, q, there)[0])
                model.append(miss(m, q, there)[1])
    assert len(after) > 60
    assert np.linalg.norm(after) < 1.2 * np.linalg.norm(model)
    assert np.linalg.norm(after) < 0.05 * np.linalg.norm(before)
    assert parts
    assert max(parts) < 0.0  # nearer than before, each of them


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("G1 X1 Y1 Z1\nG2 X2 Y2 I1\nG1 X3\n", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nG91\nX1\nG90\nY3\n", "does not state X"),
        ("G1 X1 Y1 Z1\nG28 Z0\nX3 Y3\n", "does not state Z"),
        ("G1 X1 Y1 Z1\nG28\nX3 Y3\n", "does not state Z"),
        ("G1 X1 Y1 Z1\nG53 G0 Z0\nX3 Y3\n", "does not state Z"),
        ("G1 X1 Y1 Z1\nM98 P1000\nX3\n", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nM6 T1\nX3\n", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nG92 X0\nX3 Y3 Z3\n", "the zero is changed (G92)"),
        ("G1 X1 Y1 Z1\nG52 X5\nX3 Y3 Z3\n", "the zero is changed (G52)"),
        ("G10 L2 P1 X5\nG1 X3 Y3 Z3\n", "the zero is changed (G10)"),
        ("G54.1 P4 G1 X3 Y3 Z3\n", "the work offset G54.1 P4 is not in"),
        ("G59.1 G1 X3 Y3 Z3\n", "the work offset G59.1 is not in"),
        ("G1 X#101 Y3 Z3\n", "X is worked out by the controller"),
        ("G1 X1 Y[#2+1] Z3\n", "Y is worked out by the controller"),
        ("G1 X1 Y1 Z1\nG33 Z5 K1\n", "is no straight move"),
        ("G1 X1 Y1 Z1\nG73 X5 Y5 Z5 R1 Q1\n", "is no straight move"),
    ],
)
def test_what_only_the_controller_knows_is_left(text: str, why: str) -> None:
    assert why in ours.read(text, SLIDES, KNOWN)[-1].why


@pytest.mark.parametrize(
    "text",
    [
        "G1 X1 Y1 Z1\nG2 X2 Y2 I1\nG1 X3 Y3 Z3\nX5\n",
        "G1 X1 Y1 Z1\nG92 X0\nG92.1\nX5\n",
        "G1 X1 Y1 Z1\nG4 X2\nX5\n",
        "G90 G91.1 G1 X1 Y1 Z1\nX5\n",
        "G54.1 P3 G1 X1 Y1 Z1\nX5\n",
        "g1x1y1z1\nx5e7\n",
    ],
)
def test_what_is_known_again_is_corrected(text: str) -> None:
    last = ours.read(text, SLIDES, KNOWN)[-1]
    assert last.why == ""
    np.testing.assert_allclose(last.readings, [0.005, np.nan, np.nan])
