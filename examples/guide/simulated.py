"""Lead a simulated UR10 with a tracker until its target is known to half a millimetre: no hardware is needed.

    python examples/guide/simulated.py /tmp/cell

The arm stands for `my_robot` of the other files: give it joints, and it says what the tracker measured.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import aridcal
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.simulate.live import LiveArm, live_arm
from aridcal.jobs.simulate.scenario import Scenario

SCENARIO = """
format: 1
robot: {{urdf: {urdf}, tip: tool0}}
measurements: {{file: measurements.csv, kind: pose, noise: {{position: 5.0e-5, rotation: 1.0e-4}}}}
frames: {{tip_target: {{xyz: [0.05, 0.03, 0.15]}}}}
"""
TRUTH = """
truth:
  n: 100
  seed: 1
  noise: {position: 5.0e-5, rotation: 1.0e-4}
  frames: {world_base: {xyz: [2.0, 0.3, -0.5], rpy: [0.02, -0.01, 2.0]}}
  parameters: {shoulder_lift_joint.yaw: {std: 2.0e-3}, elbow_joint.x: {std: 1.0e-3}, wrist_1_joint.pitch: {std: 2.0e-3}}
"""


def cell(folder: Path) -> LiveArm:
    """A campaign without a table, and the arm."""
    folder.mkdir(parents=True, exist_ok=True)
    urdf = Path(__file__).resolve().parents[2] / "urdf" / "ur10.urdf"
    (folder / "campaign.yaml").write_text(SCENARIO.format(urdf=urdf))
    (folder / "scenario.yaml").write_text(SCENARIO.format(urdf=urdf) + TRUTH)
    return live_arm(load_settings(folder / "scenario.yaml", Scenario))


def main(folder: Path, tolerance: str = "0.5mm") -> aridcal.Guided:
    """Measure until it is enough."""
    arm = cell(folder)
    guided = aridcal.guide(folder / "campaign.yaml", tolerance)
    for pose in guided:
        (row,) = arm.measured(np.array([*pose.joints.values()])).to_dict("records")
        for alarm in pose.record(row):
            print(alarm.words, "Do:", alarm.do)
        if guided.known:
            print(f"{guided.known.rows} rows: within {1e3 * guided.known.position:.3g} mm")
    return guided


if __name__ == "__main__":
    ended = main(Path(sys.argv[1]))
    if ended.stop:
        print(ended.stop.words)
