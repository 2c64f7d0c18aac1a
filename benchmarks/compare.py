"""Pairs of calibrations compared: how often robots that did not change are said to have, simulated and real.

Example:
    PYTHONPATH=.:tests/support nice python benchmarks/compare.py clean --pairs 60
    PYTHONPATH=.:tests/support nice python benchmarks/compare.py search --pairs 12
    PYTHONPATH=.:tests/support nice python benchmarks/compare.py real

- ``clean``: a simulated UR10, 75 poses or positions each time, tracker and target set up anew, `identify` without a search.
- ``search``: the same with an error curve and a sagging joint, 150 poses, and the search for effects in both calibrations, which
  need not find the same ones, or call them alike.
- ``real``: disjoint draws of 240 of the 1,495 poses of identification/ur10-laser-tracker (series B), and of halves of the 182
  rows
  of identification/panda-sockets, without a search: what the constants alone leave is no noise. Then the first and the last 240
  rows.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.history.comparison import compare, lines
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign

TOP = Path(__file__).resolve().parents[1]

EFFECTS = [
    {"kind": "joint_harmonic", "where": "elbow_joint", "order": [1], "coefficients": [3e-4, 1e-4]},
    {"kind": "joint_compliance", "where": "shoulder_lift_joint", "coefficients": 3e-6},
]


def simulated(folder: Path, seed: int, kind: str, n: int, search: bool) -> SavedModel:
    """One calibration of the same robot, from other rows and another place."""
    rng = np.random.default_rng([17, seed])
    noise = {"position": 5e-5, **({"rotation": 5e-5} if kind == "pose" else {})}
    base = {"xyz": rng.uniform(-2.0, 2.0, 3).tolist(), "rpy": rng.uniform(-1.0, 1.0, 3).tolist()}
    own = {
        "elbow_joint.pitch": 1e-3,
        "shoulder_lift_joint.z": -5e-4,
        "wrist_1_joint.x": 4e-4,
        "wrist_2_joint.yaw": 2e-3,
    }
    keys = {
        "format": 1,
        "robot": {"urdf": str(TOP / "urdf" / "ur10.urdf"), "tip": "tool0"},
        "measurements": {"kind": kind, "noise": noise},
        "diagnosis": {"enabled": search},
        "truth": {
            "n": n, "seed": seed, "noise": dict(noise), "parameters": own, "effects": EFFECTS if search else [],
            "frames": {"world_base": base, "tip_target": {"xyz": rng.uniform(-0.1, 0.1, 3).tolist()}},
        },
    }  # fmt: skip
    (folder / "scenario.yaml").write_text(yaml.safe_dump(keys))
    write_campaign(simulate(load_settings(folder / "scenario.yaml", Scenario)), folder, folder)
    return calibration(identify(folder / "campaign.yaml"))


def drawn(folder: Path, source: Path, rows: pd.DataFrame) -> SavedModel:
    """A calibration from some rows of a real campaign, without a search."""
    keys: dict[str, Any] = yaml.safe_load(source.read_text())
    urdf = (source.parent / keys["robot"]["urdf"]).resolve()
    keys["robot"]["urdf"] = str(urdf)
    keys["measurements"]["file"] = "rows.csv"
    keys["diagnosis"] = {"enabled": False}
    rows.to_csv(folder / "rows.csv", index=False)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(keys))
    return calibration(identify(folder / "campaign.yaml"))


def tell(p_values: list[float], what: str) -> None:
    """How p-values of pairs that did not change are spread."""
    p = np.sort(p_values)
    shares = ", ".join(f"{np.mean(p < level):.1%} below {level:g}" for level in (0.5, 0.1, FALSE_ALARMS))
    print(f"{what}: {len(p)} pairs, {shares}; the smallest {p[0]:.2g}", flush=True)


def pairs_of(folder: Path, count: int, kind: str, n: int, search: bool) -> Iterator[float]:
    """P-values of simulated pairs."""
    for k in range(count):
        a, b = (simulated(folder, 2 * k + side, kind, n, search) for side in (0, 1))
        found = compare(a, b)
        if found.changed:
            print("\n  ".join(["said to have changed:", *lines(found)]))
        yield found.difference.p_value


def real(folder: Path) -> None:
    """Rows of one robot on one day, drawn apart."""
    for name, path, size in (
        ("UR10, 240 poses", TOP / "identification" / "ur10-laser-tracker" / "campaign-b.yaml", 240),
        ("Panda, 91 touches", TOP / "identification" / "panda-sockets" / "campaign.yaml", 91),
    ):
        rows = pd.read_csv((path.parent / yaml.safe_load(path.read_text())["measurements"]["file"]).resolve())
        p_values = []
        for seed in range(4):
            order = np.random.default_rng(seed).permutation(len(rows))
            parts = [order[k * size : (k + 1) * size] for k in range(len(rows) // size)]
            saved = [drawn(folder, path, rows.iloc[np.sort(part)]) for part in parts[:4]]
            p_values += [compare(a, b).difference.p_value for a, b in zip(saved[::2], saved[1::2], strict=False)]
        tell(p_values, name)
        if "point" not in rows:  # each socket of the Panda was touched once, all its rows together
            ends = [drawn(folder, path, part) for part in (rows.head(size), rows.tail(size))]
            print("\n  ".join([f"{name}, the first rows and the last:", *lines(compare(*ends))]), flush=True)


def main() -> None:
    """Run one of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("clean", "search", "real"))
    parser.add_argument("--pairs", type=int, default=20)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if arguments.what == "real":
            real(folder)
        elif arguments.what == "search":
            tell(list(pairs_of(folder, arguments.pairs, "pose", 150, True)), "with a search, 150 poses")
        else:
            for kind in ("pose", "position"):
                tell(list(pairs_of(folder, arguments.pairs, kind, 75, False)), f"75 {kind}s")


if __name__ == "__main__":
    main()
