"""Scenarios whose rows measure something else than poses."""

from __future__ import annotations

import json
from pathlib import Path

import yaml
from repository import ROOT

from aridcal.files.yaml_file import load_settings
from aridcal.jobs.simulate.scenario import Scenario

UR10 = {"urdf": str(ROOT / "urdf" / "ur10.urdf"), "tip": "tool0"}

EYE = {
    "fx": 700,
    "fy": 690,
    "cx": 330,
    "cy": 235,
    "width": 640,
    "height": 480,
    "distortion": [-0.1, 0.02, 1e-3, -2e-3, 0],
}

TRUTH = {
    "n": 24,
    "seed": 4,
    "frames": {
        "world_base": {"xyz": [0.3, -0.2, 0.1], "rpy": [0.1, -0.2, 2.0]},
        "tip_target": {"xyz": [0.04, -0.03, 0.12], "rpy": [0.3, 0.2, 0.1]},
    },
    "parameters": {"elbow_joint.x": 2e-3, "wrist_1_joint.pitch": {"std": 1e-3}, "shoulder_lift_joint.yaw": -1e-3},
}

BOARD = "marker,x,y,z\n" + "".join(f"{i},{0.03 * (i % 5 - 2)},{0.03 * (i // 5 - 1)},0\n" for i in range(15))


def scenario(folder: Path, measurements: object, known: dict, **truth: object) -> Scenario:
    keys = {"format": 1, "robot": UR10, "measurements": measurements, "truth": TRUTH | truth}
    keys |= {"instruments": known} if known else {}
    (folder / "markers.csv").write_text(BOARD)
    (folder / "scenario.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(keys))))
    return load_settings(folder / "scenario.yaml", Scenario)
