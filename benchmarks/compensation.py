"""How near the real target comes to wanted poses when compensated joints are commanded, and how long a command takes.

Example:
    python benchmarks/compensation.py            # five robots, 1,000 poses each
    python benchmarks/compensation.py --poses 200

Each robot is wrong by a millimetre and a milliradian in every constant, sags in two joints under gravity, has a gear
whose error curve is drawn at random, and backlash. It is measured 400 times with noise, identified with these effects
declared, and then commanded to poses that it can reach, from where its nominal model would go. The true machine tells
where the target is, its backlash on the side from which the commands themselves come. The prediction error is that of
the calibrated model on as many other configurations, without noise: no compensation can be better. A second table has
the true model in place of the identified one: what is left there is the fault of the inversion alone.

Times are those of one call of ``SavedModel.command`` from the nominal solution: CPU time, one thread, the best of five
calls, the median over the poses.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import yaml
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.loads import Surroundings, covariate_table
from aridcal.engine.fit.constants import constants
from aridcal.engine.inverse.one_pose import Command
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.files.query import Query
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.apply.joint_commands import follow
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import (
    Simulation,
    named_constants,
    simulate,
    surroundings,
    write_campaign,
)

TOP = Path(__file__).resolve().parents[1]
PUBLIC = Path(pin.__file__).resolve().parents[4] / "share" / "example-robot-data" / "robots"
ROWS = 400
REPEATS = 5  # of each call that is timed; the best disturbs least
SAG, CURVE, BACKLASH = 3e-4, 3e-4, 1e-4  # RMS sag of a joint, its error curve, half its backlash: [rad]


@dataclass(frozen=True)
class Case:
    """A robot and the joints in which it is at fault."""

    name: str
    urdf: Path
    base: str | None
    tip: str
    sags: tuple[str, str]
    curve: str
    backlash: str


CASES = (
    Case("ARID", TOP / "urdf/arid.urdf", None, "flange", ("joint_2", "joint_3"), "joint_2", "joint_3"),
    Case("UR10", TOP / "urdf/ur10.urdf", "base_link", "tool0", ("shoulder_lift_joint", "elbow_joint"),
         "shoulder_pan_joint", "elbow_joint"),
    Case("Panda", PUBLIC / "panda_description/urdf/panda.urdf", None, "panda_link8", ("panda_joint2", "panda_joint4"),
         "panda_joint1", "panda_joint4"),
    Case("xArm7", PUBLIC / "xarm_description/urdf/xarm7.urdf", None, "link7", ("joint2", "joint4"), "joint1", "joint4"),
    Case("Kinova", PUBLIC / "kinova_description/robots/kinova.urdf", None, "j2s6s200_end_effector",
         ("j2s6s200_joint_2", "j2s6s200_joint_3"), "j2s6s200_joint_1", "j2s6s200_joint_3"),
)  # fmt: skip


def scenario(case: Case, folder: Path) -> Scenario:
    robot = load_robot(case.urdf, case.tip, case.base)
    gravity = [0.0, 9.81, 0.0] if case.name == "ARID" else [0.0, 0.0, -9.81]
    sags = [
        {"kind": "joint_compliance", "where": joint, "coefficients": SAG / _load(robot, joint, np.array(gravity))}
        for joint in case.sags
    ]
    truth: dict[str, Any] = {
        "n": ROWS,
        "seed": 7,
        "parameters": {c.name: {"std": 1e-3} for c in constants(robot, "full")},
        "frames": {
            "world_base": {"xyz": [1.9, -1.1, 0.4], "rpy": [0.01, 0.02, 1.4]},
            "tip_target": {"xyz": [0.02, 0.05, 0.11], "rpy": [0.4, -0.3, -1.6]},
        },
        "noise": {"position": 1e-4, "rotation": 1e-4},
        "effects": [
            *sags,
            {"kind": "joint_map", "where": case.curve, "coefficients": {"std": CURVE}},
            {"kind": "joint_backlash", "where": case.backlash, "by": "direction", "coefficients": -BACKLASH},
        ],
    }
    keys = {
        "format": 1,
        "robot": {"urdf": str(case.urdf), "base": robot.base, "tip": case.tip, "gravity": gravity},
        "measurements": {"kind": "pose", "noise": {"position": 1e-4, "rotation": 1e-4}},
        "effects": [{k: e[k] for k in ("kind", "where", "by") if k in e} for e in truth["effects"]],
        "diagnosis": {"enabled": False},
        "truth": truth,
    }
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(keys))
    return load_settings(path, Scenario)


def true_model(simulation: Simulation) -> SolvedModel:
    """The simulated machine as a model, without uncertainty."""
    causes = simulation.causes
    robot, frames = simulation.robot, simulation.frames
    named = named_constants(robot, simulation.parameters, simulation.scenario.path)
    coefficients = (*named, *(c for cause in causes for c in cause.effect.coefficients))
    theta = np.concatenate([list(simulation.parameters.values()), *(cause.values for cause in causes)])
    around = surroundings(simulation.scenario, frames, simulation.measurements.columns.tolist())
    model = Model(robot, coefficients, ((None, frames["world_base"]),), ((None, frames["tip_target"]),), around)
    return SolvedModel(model, theta, np.zeros((len(theta), len(theta))))


def wanted(case: Case, truth: SolvedModel, poses: int) -> Query:
    """Poses that the true machine can reach, each with the joints from which the nominal one would set out."""
    robot = truth.model.robot
    rng = np.random.default_rng(11)
    turns = np.array(robot.kinds) != "prismatic"
    low, high = np.maximum(robot.limits[:, 0], -np.pi), robot.limits[:, 1]
    high = np.where(turns, np.minimum(high, np.pi), high)
    low, high = low + 0.05 * (high - low), high - 0.05 * (high - low)
    q = rng.uniform(low, high, (poses, len(low)))
    side = {f"{case.backlash}_direction": rng.choice([-1.0, 1.0], poses)}
    R, p = truth.poses(q, side)
    return Query(
        table=pd.DataFrame({"row": np.arange(poses)}),
        readings=q,
        position=p,
        quaternion=Rotation.from_matrix(R).as_quat(),
        covariates={},
        station=None,
        line=np.arange(2, poses + 2),
        usable=np.ones(poses, dtype=bool),
        refused=(),
        notices=(),
    )


def nominal_solutions(calibrated: SavedModel, query: Query) -> Query:
    """What the controller's own inverse kinematics answers: the nominal robot in the identified frames."""
    model = calibrated.final.model
    world, tip = model.frames(calibrated.final.theta)
    bare = SolvedModel(Model(model.robot, (), world, tip), np.zeros(0), np.zeros((0, 0)))
    nominal = replace(calibrated, geometric=bare, final=bare)
    commands, _ = follow(nominal, query)
    return replace(query, readings=np.array([c.readings for c in commands]))


def error_after(truth: SolvedModel, case: Case, query: Query, commands: list[Command]) -> np.ndarray:
    """Distance of the true target from where it was wanted, shape (N,), [m]: backlash as the commands came."""
    q = np.array([c.readings for c in commands])
    reading = q[:, truth.model.robot.readings.index(case.backlash)]
    side = np.concatenate([[0.0], np.sign(np.diff(reading))])
    _, p = truth.poses(q, {f"{case.backlash}_direction": side})
    assert query.position is not None
    return np.linalg.norm(p - query.position, axis=1)


def prediction_error(truth: SolvedModel, model: SolvedModel, case: Case, query: Query) -> np.ndarray:
    rng = np.random.default_rng(13)
    side = {f"{case.backlash}_direction": rng.choice([-1.0, 1.0], len(query.line))}
    return np.linalg.norm(truth.poses(query.readings, side)[1] - model.poses(query.readings, side)[1], axis=1)


def microseconds(calibrated: SavedModel, query: Query, case: Case) -> float:
    """Median over the poses of a call's best CPU time, [us]."""
    assert query.position is not None and query.quaternion is not None
    poses = np.tile(np.eye(4), (len(query.line), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(query.quaternion).as_matrix()
    poses[:, :3, 3] = query.position
    side = {f"{case.backlash}_direction": 1.0}
    taken = []
    for pose, seed in zip(poses, query.readings, strict=True):
        times = []
        for _ in range(REPEATS):
            began = time.process_time()
            calibrated.command(pose, seed, side)
            times.append(time.process_time() - began)
        taken.append(min(times))
    return 1e6 * float(np.median(taken))


def _load(robot: Robot, joint: str, gravity: np.ndarray) -> float:
    """RMS gravity torque on a joint, [N m]."""
    q = draw_readings(robot, 500, np.random.default_rng(0))
    name = f"{joint}.gravity_torque"
    values = covariate_table(robot, q, {}, Surroundings(gravity), np.zeros(len(q), dtype=int), {name})[name]
    return float(np.sqrt(np.mean(values**2)))


def _rms(e: np.ndarray) -> float:
    return float(np.sqrt(np.mean(e**2)))


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=1000, help="wanted poses for each robot")
    arguments = parser.parse_args()
    table = Table(title=f"Identified model, {arguments.poses:,} wanted poses", title_justify="left")
    for head in ("robot", "nominal, mm RMS", "model predicts, mm RMS", "after commanding, mm RMS", "ratio",
                 "converged", "µs a pose"):  # fmt: skip
        table.add_column(head, justify="left" if head == "robot" else "right")
    exact = Table(title="True model in its place", title_justify="left")
    for head in ("robot", "after commanding, µm max", "converged"):
        exact.add_column(head, justify="left" if head == "robot" else "right")
    for case in CASES:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            simulation = simulate(scenario(case, folder))
            write_campaign(simulation, folder, folder)
            identified = calibration(identify(folder / "campaign.yaml"))
        truth = true_model(simulation)
        query = wanted(case, truth, arguments.poses)
        predicted = prediction_error(truth, identified.final, case, query)
        query = nominal_solutions(identified, query)
        commands, _ = follow(identified, query)
        after = error_after(truth, case, query, commands)
        plain = [replace(c, readings=q) for c, q in zip(commands, query.readings, strict=True)]
        converged = float(np.mean([c.reached for c in commands]))
        figures = [_rms(e) for e in (error_after(truth, case, query, plain), predicted, after)]
        table.add_row(
            case.name, *(f"{1e3 * figure:.3f}" for figure in figures), f"{figures[2] / figures[1]:.2f}",
            f"{100 * converged:.2f} %",
            f"{microseconds(identified, query, case):.0f}",
        )  # fmt: skip
        perfect = replace(identified, geometric=truth, final=truth)
        commands, _ = follow(perfect, query)
        reached = np.array([c.reached for c in commands])
        off = error_after(truth, case, query, commands)
        exact.add_row(case.name, f"{1e6 * off[1:].max():.4f}", f"{100 * reached.mean():.2f} %")
    console = Console(width=140)
    console.print(table)
    console.print(exact)
    return 0


if __name__ == "__main__":
    sys.exit(main())
