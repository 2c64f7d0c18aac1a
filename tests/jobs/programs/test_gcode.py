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
from aridcal.jobs.apply.programs.branches import flange


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
    for seed in range(2):
        made = gcode(np.random.default_rng(seed), low, high, 36)
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
    assert len(after) > 30
    assert np.linalg.norm(after) < 1.2 * np.linalg.norm(model)
    assert np.linalg.norm(after) < 0.05 * np.linalg.norm(before)
    assert parts
    assert max(parts) < 0.0  # nearer than before, each of them
