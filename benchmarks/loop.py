"""The loop closed: from residual to effect on a real robot, on few rows, on many rows, and on a column that bends.

Example:
    python benchmarks/loop.py                       # all tables
    python benchmarks/loop.py curve column          # some of them

- ``real``: UR10 series B (public laser-tracker data), nothing declared, ten splits by seed, through ``identify``.
- ``curve``: the same with 30, 100, 300 and 1,000 rows to learn from, three draws each, tested on all the others.
- ``column``: an arm on a lifting column that bends under it, the more the further it is out, and a joint whose play
  switches with the sign of its load; positions only, 450 rows at five heights, frames unknown, sigma declared twice too
  large. Final error over that of an oracle that knows the true form, on 2,000 configurations never measured.
- ``large``: 12,000 simulated rows of a UR10 with maps on six joints, through the command: time and memory.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import yaml
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.search.loop import calibrated_arm, fit_constants
from aridcal.files.campaign import Campaign
from aridcal.jobs.calibrate.outcome import errors
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.system.progress import SILENT

TOP = Path(__file__).resolve().parent.parent
UR10 = TOP / "identification" / "ur10-laser-tracker" / "campaign-b.yaml"
ROWS = (30, 100, 300, 1000)
SIGMA = 1e-4


def real(console: Console) -> None:
    """Ten splits of the real robot's rows."""
    keys = _ur10(console)
    if keys is None:
        return
    table = _table("UR10 series B, nothing declared: RMS on rows never used", "seed")
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        campaign = Path(folder) / "campaign.yaml"
        campaign.write_text(yaml.safe_dump(keys))
        for seed in range(10):
            figures.append(_row(table, str(seed), campaign, seed))
    mean = np.mean(figures, axis=0)
    table.add_section()
    table.add_row("mean", "", *(f"{v:.3f}" for v in mean))
    console.print(table)


def curve(console: Console) -> None:
    """How the error falls with the rows that there are to learn from."""
    keys = _ur10(console)
    if keys is None:
        return
    table = _table("UR10 series B, nothing declared: RMS on rows never used", "rows to learn from")
    whole = pd.read_csv(keys["measurements"]["file"])
    with tempfile.TemporaryDirectory() as folder:
        keys["measurements"]["file"] = str(Path(folder) / "rows.csv")
        campaign = Path(folder) / "campaign.yaml"
        campaign.write_text(yaml.safe_dump(keys))
        for n in ROWS:
            for seed in range(3):
                chosen = np.random.default_rng(seed).permutation(len(whole))[:n]
                split = np.where(np.isin(np.arange(len(whole)), chosen), "train", "test")
                whole.assign(split=split).to_csv(keys["measurements"]["file"], index=False)
                _row(table, str(n), campaign, seed)
            table.add_section()
    console.print(table)


def column(console: Console) -> None:
    """A column that bends, and an oracle."""
    table = Table(
        title="column that bends, 450 rows: RMS error of the target in mm, without noise", title_justify="left"
    )
    for head in ("seed", "geometric", "final", "oracle", "final / oracle", "found"):
        table.add_column(head)
    for seed in range(4):
        robot, campaign, rows, truth, theta = _column(seed)
        geometry = fit_constants(campaign.question, robot, rows, ())
        arm = calibrated_arm(campaign.question, robot, rows, (), geometry, SILENT)
        found, diagnosed = arm.geometry.geometric, arm.diagnosed
        own = [c for c in truth.coefficients if not c.basis.constant]
        model = found.model.with_coefficients((*found.model.coefficients, *own))
        start = np.concatenate([found.theta, np.zeros(len(own))])
        oracle = fit(problem(model, rows.select(rows.train)), start)
        test = rows.select(rows.test)
        target = truth.poses(theta, truth.rows(test.readings))[1]
        e = [_off(f, test, target) for f in (found, diagnosed.fit, oracle)]
        names = "; ".join(dict.fromkeys(a.effect.label for a in diagnosed.stepwise.state.active))
        table.add_row(str(seed), *(f"{v:.3f}" for v in e), f"{e[1] / e[2]:.2f}", names)
    console.print(table)


def large(console: Console) -> None:
    """Many rows and many candidates, through the command as a user runs it."""
    joints = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    maps = [{"kind": "joint_map", "where": f"{j}_joint", "coefficients": {"std": 3e-4}} for j in joints]
    sag = {"kind": "joint_compliance", "where": "elbow_joint", "coefficients": 1e-5}
    noise = {"position": 5e-5, "rotation": 5e-5}
    scenario = {
        "format": 1,
        "robot": {"urdf": str(TOP / "urdf" / "ur10.urdf"), "base": "base_link", "tip": "tool0"},
        "measurements": {"noise": dict(noise)},
        "truth": {"n": 12000, "noise": noise, "covariates": ["time", "temperature", "payload"], "effects": [*maps, sag]},
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.yaml"
        path.write_text(yaml.safe_dump(scenario))
        aridcal = [sys.executable, "-m", "aridcal"]
        subprocess.run([*aridcal, "simulate", str(path), "-o", f"{folder}/made"], check=True, stdout=subprocess.DEVNULL)
        started = time.perf_counter()
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [*aridcal, "identify", f"{folder}/made/campaign.yaml"], check=True, capture_output=True, text=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    console.print(f"12,000 rows, maps on six joints: {time.perf_counter() - started:.1f} s wall (<= 60), "
                  f"{after.ru_utime - before.ru_utime:.1f} s CPU, {after.ru_maxrss / 2**20:.2f} GB (<= 2)")  # fmt: skip
    console.print(done.stdout, markup=False)


def _ur10(console: Console) -> dict[str, dict[str, str]] | None:
    """The shipped campaign with absolute paths; None if the data are not there."""
    if not (TOP.parent / "shared" / "data").is_dir():
        console.print("the public data are not beside this repository: see identification/ur10-laser-tracker")
        return None
    keys: dict[str, dict[str, str]] = yaml.safe_load(UR10.read_text())
    keys["robot"]["urdf"] = str((UR10.parent / keys["robot"]["urdf"]).resolve())
    keys["measurements"]["file"] = str((UR10.parent / keys["measurements"]["file"]).resolve())
    return keys


def _table(title: str, first: str) -> Table:
    table = Table(title=title, title_justify="left")
    for head in (first, "test rows", "geometric, mm", "final, mm", "geometric, mrad", "final, mrad", "effects",
                 "verdict", "s"):  # fmt: skip
        table.add_column(head, justify="right")
    return table


def _row(table: Table, first: str, campaign: Path, seed: int) -> list[float]:
    started = time.perf_counter()
    found = identify(campaign, seed)
    test = found.parts()["test"]
    e = [errors(found.stage(name).residual, test, found.channels) for name in ("geometric", "final")]
    row = [e[k][unit]["rms"] for unit in ("position_mm", "rotation_mrad") for k in (0, 1)]
    cells = [*(f"{v:.3f}" for v in row), str(len(found.effects)), found.verdict.word]
    table.add_row(first, str(test.sum()), *cells, f"{time.perf_counter() - started:.0f}")
    return row


def _off(found: Fit, rows: Dataset, target: np.ndarray) -> float:
    position = found.model.poses(found.theta, found.model.rows(rows.readings))[1]
    return 1e3 * float(np.sqrt(np.mean(np.sum((position - target) ** 2, axis=1))))


def _column(seed: int) -> tuple[Robot, Campaign, Dataset, Model, np.ndarray]:
    """A lift with a seven-joint arm on it, and what a tracker saw of its target."""
    rng = np.random.default_rng(seed)
    robot = parse_robot(_urdf().encode(), "tip")
    limits = robot.limits
    n, unseen = 450, 2000
    q = rng.uniform(limits[:, 0], limits[:, 1], (n + unseen, len(limits)))
    q[:, 0] = rng.choice(np.linspace(0.02, 0.38, 5), n + unseen)
    bend = []
    for c in ("roll", "pitch"):
        load = f"lift.gravity_moment_{c}"
        bend += [Coefficient("lift", c, Basis("linear", (load,), (0.0,)))]
        bend += [Coefficient("lift", c, Basis("times_power", (load, "lift"), (0.0, 0.38, k))) for k in (1.0, 2.0)]
    play = Coefficient("upper_roll", "axis", Basis("sign", ("upper_roll.gravity_torque",)))
    geometry = constants(robot, "full")
    frames = [pin.SE3(Rotation.random(rng=rng).as_matrix(), rng.uniform(-3, 3, 3)),
              pin.SE3(np.eye(3), np.array([0.02, 0.01, 0.03]))]  # fmt: skip
    around = Surroundings(np.array([0.0, 0.0, -9.81]), frames[1].translation)
    truth = Model(robot, (*geometry, *bend, play), ((None, frames[0]),), ((None, frames[1]),), around)
    softer = np.tile([7e-6, 9e-6, 18e-6], 2)  # rad per N m: five times as soft when out as when in
    theta = np.concatenate([1e-3 * rng.standard_normal(len(geometry)), softer, [8e-4]])
    position = truth.poses(theta, truth.rows(q))[1] + SIGMA * rng.standard_normal((len(q), 3))
    test = np.arange(len(q)) >= n
    rows = dataset(robot.readings, robot.kinds, q, position, sigma=(2 * SIGMA,), test=test)
    campaign = Campaign.model_validate({
        "format": 1,
        "robot": {"urdf": Path("column.urdf"), "tip": "tip"},
        "measurements": {"file": (Path("rows.csv"),), "kind": "position", "noise": {"position": 2 * SIGMA}},
    })  # fmt: skip
    return robot, campaign, rows, truth, theta


# Name, kind, place, axis, limits, mass [kg] and where it is.
JOINTS = (
    ("lift", "prismatic", "0 0 0.5", "0 0 1", 0.0, 0.4, 20.0, "0.05 0 0.3"),
    ("pan", "revolute", "0.1 0 0.6", "0 0 1", -1.6, 1.6, 4.0, "0.08 0 0"),
    ("shoulder", "revolute", "0.117 0 0.06", "0 1 0", -1.2, 1.5, 3.0, "0.1 0 0"),
    ("upper_roll", "revolute", "0.219 0 0", "1 0 0", -3.0, 3.0, 2.3, "0.1 0 0"),
    ("elbow", "revolute", "0.133 0 0", "0 1 0", -2.2, 2.2, 2.1, "0.1 0 0"),
    ("fore_roll", "revolute", "0.197 0 0", "1 0 0", -3.0, 3.0, 1.6, "0.08 0 0"),
    ("wrist", "revolute", "0.1245 0 0", "0 1 0", -2.1, 2.1, 1.7, "0.08 0 0"),
    ("wrist_roll", "revolute", "0.1385 0 0", "1 0 0", -3.0, 3.0, 0.5, "0.05 0 0"),
)


def _urdf() -> str:
    parts, parent = ['<robot name="column"><link name="base"/>'], "base"
    for name, kind, xyz, axis, lower, upper, mass, com in JOINTS:
        parts.append(
            f'<link name="{name}_link"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
            f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/></joint>'
        )
        parent = f"{name}_link"
    end = (
        f'<joint name="end" type="fixed"><parent link="{parent}"/><child link="tip"/><origin xyz="0.166 0 0"/></joint>'
    )
    return "".join(parts) + f'<link name="tip"/>{end}</robot>'


TABLES: dict[str, Callable[[Console], None]] = {"real": real, "curve": curve, "column": column, "large": large}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"{', '.join(TABLES)} (default: all)")
    wanted = parser.parse_args().tables or list(TABLES)
    console = Console(width=180)
    for name in wanted:
        if name not in TABLES:
            parser.error(f"no table {name!r}: {', '.join(TABLES)}")
        TABLES[name](console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
