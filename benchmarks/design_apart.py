"""How often the search names the right one of two effects that look alike, before and after configurations were chosen to tell.

    python benchmarks/design_apart.py           # some minutes

An arm was measured in a cell: 50 poses within 0.35 rad of one posture, noise 0.1 mm and 0.1 mrad. It has one of two effects
that these rows can hardly tell apart. Both are stated with --apart, and 10 configurations are chosen. An effect is named if it is
among those that the search accepts, the other one is not, and it does not say that they are confounded. All rows are split as
always: a fifth of them, also of the new ones, are held out.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from aridcal.engine.inverse.reachable import limits_of
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.plan.configurations import Candidates, rows_like, targets_of
from aridcal.jobs.plan.pose_design import PlanRequest, design
from aridcal.jobs.plan.prior_knowledge import PlanSetup, beforehand
from aridcal.jobs.plan.usual_effects import with_pair

TOP = Path(__file__).resolve().parents[1]
NOISE = 1e-4
OLD, NEW, WIDE = 50, 10, 0.35
TIMES = 6.0
"""RMS of what the effect does to the target in the rows at hand, over three axes, in units of the noise of one."""

POSTURE = (0.3, -1.2, 1.4, -0.6, 1.1, 0.4)
PAIRS = (
    ("shoulder_lift_joint.joint_gain", "shoulder_lift_joint.joint_compliance"),
    ("elbow_joint.joint_gain", "elbow_joint.joint_compliance"),
    ("shoulder_lift_joint.joint_compliance", "elbow_joint.joint_compliance"),
    ("wrist_1_joint.joint_gain", "wrist_1_joint.joint_compliance"),
)


def campaign(folder: Path) -> Campaign:
    """With a table that may not be there yet."""
    path = folder / "campaign.yaml"
    path.write_text(
        f"format: 1\nrobot: {{urdf: {TOP / 'urdf' / 'ur10.urdf'}, tip: tool0}}\n"
        "measurements: {file: rows.csv, kind: pose, noise: {position: 1.0e-4, rotation: 1.0e-4}}\n"
        "frames: {tip_target: {xyz: [0.05, 0.03, 0.15]}}\n"
    )
    return load_campaign(path)


def truth(folder: Path, name: str, readings: np.ndarray) -> tuple[PlanSetup, np.ndarray]:
    """The arm with one effect of the right size, and its coefficients."""
    made = campaign(folder)
    known = beforehand(made, load_robot(made.robot.urdf, made.robot.tip))
    n = len(readings)
    every = Candidates(readings, np.ones_like(readings), np.zeros(n, int), np.zeros(n, int), np.arange(n))
    known, ((number,),) = with_pair(known, (name,), every)
    theta = np.zeros(len(known.theta))
    theta[number] = 1e-3
    pattern = np.zeros(n, dtype=int)
    plain = targets_of(known, readings, pattern)[1]
    made_rows = rows_like(known, readings, pattern)
    off = known.model.poses(theta, known.model.rows(readings, made_rows.conditions))[1] - plain
    theta[number] *= TIMES * NOISE / np.sqrt(np.mean(np.sum(off**2, axis=1)))
    return known, theta


def measured(
    known: PlanSetup, theta: np.ndarray, robot: Robot, readings: np.ndarray, rng: np.random.Generator
) -> pd.DataFrame:
    """Rows of a table."""
    made = rows_like(known, readings, np.zeros(len(readings), dtype=int))
    R, p = known.model.poses(theta, known.model.rows(readings, made.conditions))
    p = p + NOISE * rng.standard_normal(p.shape)
    q = Rotation.from_matrix(Rotation.from_rotvec(NOISE * rng.standard_normal(p.shape)).as_matrix() @ R).as_quat()
    table = pd.DataFrame(readings, columns=list(robot.readings))
    return table.assign(**dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), np.hstack([p, q]).T, strict=True)))


def named(made: Campaign, table: pd.DataFrame, true: str, other: str) -> tuple[bool, str]:
    """Whether the true effect is named, and what is found."""
    found = identify(made.with_tables([table])).effects
    titles = {f"{f.effect.where}.{f.effect.kind}": f for f in found}
    alike = {f"{e.where}.{e.kind}" for f in found for e in f.confounded_with}
    return true in titles and other not in titles and other not in alike, ", ".join(titles) + (
        " ?" + ",".join(sorted(alike)) if alike else ""
    )


def main(seeds: int) -> None:
    """Every pair, either of both true."""
    before, after = [], []
    for seed in range(seeds):
        for pair in PAIRS:
            for true, other in (pair, pair[::-1]):
                rng = np.random.default_rng(seed)
                with tempfile.TemporaryDirectory() as name:
                    folder = Path(name)
                    made = campaign(folder)
                    robot = load_robot(made.robot.urdf, made.robot.tip)
                    readings = np.clip(POSTURE + rng.uniform(-WIDE, WIDE, (OLD, 6)), *limits_of(robot))
                    known, theta = truth(folder, true, readings)
                    old = measured(known, theta, robot, readings, rng)
                    first, words = named(made, old, true, other)
                    old.to_csv(folder / "rows.csv", index=False)
                    started = time.process_time()
                    plan = design(beforehand(made, robot), PlanRequest(NEW, apart=pair, seed=seed))
                    seconds = time.process_time() - started
                    new = measured(known, theta, robot, plan.readings, rng)
                    second, more = named(made, pd.concat([old, new], ignore_index=True), true, other)
                before.append(first)
                after.append(second)
                print(
                    f"{true}, not {other.rpartition('.')[2]}: {first} [{words}] -> {second} [{more}], {seconds:.1f} s",
                    flush=True,
                )
    print(f"named by {OLD} rows: {sum(before)} of {len(before)}; with {NEW} more: {sum(after)} of {len(after)}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2)
