"""The geometric fit beside the public tools for it: figaroh, robotkinecal and pybotics on the same rows, in one run.

Example:
    python benchmarks/peers.py                     # series B, simulated 1,000 and 12,000 rows, and the exponent
    python benchmarks/peers.py --data 1000         # some of them
    python benchmarks/peers.py --tools robotkinecal figaroh --no-exponent

Each tool is installed into an environment of its own below ``build/peers``, in the versions of ``PINNED``, on the first run
(network needed). Every fit is a process of its own with one thread. What tools are asked, and how, stands in
``peer_tools.py``: a UR10's constants, with base and tip frame unknown, from poses; effects are not looked for.

CPU seconds are those of the process: ``fit`` is all between rows in memory and constants, ``choice`` the part of it in which
figaroh chooses its parameters; aridcal's ``fit`` holds that choice, the start, the outliers and the restarts. ``whole`` is
everything from the start of the interpreter to predicted held-out rows. aridcal's are the median of three processes, others
are run once. Errors are RMS over the held-out rows, the same for all. Series B goes without its four readings that its README
calls gross outliers: only two of the tools look for any.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
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
from accuracy import BAD_ROWS, campaign_of, measure, truth_of, ur10
from peer_tools import TOOLS
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation
from speed import ONE_THREAD, SERIES_B, TOP, load

from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.dh import modified_dh
from aridcal.engine.rows.dataset import Dataset

PINNED = {
    "robotkinecal": ("robotkinecal==0.1.0", "roboticstoolbox-python==1.4.4", "spatialmath-python==1.1.18",
                     "numpy==1.26.4", "scipy==1.17.1"),
    "figaroh": ("figaroh==1.0.2", "pin==4.1.0", "ndcurves==2.3.0", "numpy==2.4.6", "scipy==1.17.1", "pandas==3.1.1"),
    "pybotics": ("pybotics==3.1.2", "numpy==1.26.4", "scipy==1.17.1"),
}  # fmt: skip
HAND_EYE = {
    "opencv": ("opencv-python-headless==4.12.0.88", "numpy==2.2.6")
}  # of hand_eye.py: version 5 has no such methods
ENVIRONMENTS = TOP / "build" / "peers"
NOISE, WRONG = 1e-4, 1e-3  # per axis; standard deviation of every constant, [m] and [rad]
HELD = 1000  # rows of a simulation that no tool is shown
SIMULATED_FRAMES = (
    pin.SE3(pin.rpy.rpyToMatrix(0.01, 0.02, 1.4), np.array([2.9, -1.1, -1.2])),
    pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.3, -1.6), np.array([0.02, 0.05, 0.11])),
)
SERIES_B_FRAMES = (  # as the data's README has them: to a millimetre and a milliradian
    pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.003, -2.792), np.array([0.508, -3.568, -1.225])),
    pin.SE3(pin.rpy.rpyToMatrix(0.001, -0.002, -1.571), np.array([0.0, 0.0, 0.093])),
)
SIZES = (1000, 10_000, 100_000, 1_000_000)
REPEATS = 3  # fits of ours of which the median counts: they take less than what else goes on in the machine


@dataclass(frozen=True)
class Rows:
    """Poses of a UR10, some of them held out, and frames near the true ones.

    Attributes:
        name: For the tables.
        robot: The nominal chain.
        data: All rows.
        frames: T_world_base and T_tip_target that tools without a start of their own are given.
    """

    name: str
    robot: Robot
    data: Dataset
    frames: tuple[pin.SE3, pin.SE3]


def series_b() -> Rows:
    """The real robot's rows without the documented outliers, split as ``identify`` splits them."""
    loaded = load(SERIES_B)
    sequence = loaded.rows.origin.line - 2
    return Rows("UR10 series B", loaded.robot, loaded.rows.select(~np.isin(sequence, BAD_ROWS)), SERIES_B_FRAMES)


def simulated(n: int, held: int = HELD) -> Rows:
    """``n`` rows to fit and some held out, of a robot whose constants are all wrong."""
    robot, rng = ur10(), np.random.default_rng([n, 14])
    truth = truth_of(robot, "full", SIMULATED_FRAMES)
    theta = WRONG * rng.standard_normal(len(truth.coefficients))
    error = NOISE * rng.standard_normal((n + held, 6))
    data = measure(truth, theta, draw_readings(robot, n + held, rng), error)
    return Rows(f"simulated {n:,}", robot, replace(data, test=np.arange(n + held) >= n), SIMULATED_FRAMES)


def write(rows: Rows, folder: Path) -> None:
    """Write the same rows in the layout of every tool."""
    data, robot = rows.data, rows.robot
    assert data.rotation is not None
    fit, held = data.train, data.test
    table = modified_dh(robot)
    mdh = np.array([[row.alpha, row.a, row.theta, row.d] for row in table.rows])
    np.savez(
        folder / "rows.npz",
        readings=data.readings[fit], position=data.position[fit], rotation=data.rotation[fit],
        held_readings=data.readings[held], world_base=rows.frames[0].homogeneous,
        mdh=mdh, mdh_mask=told_apart(mdh), mdh_world=(rows.frames[0] * table.base).homogeneous,
        mdh_tool=(table.tool * rows.frames[1]).homogeneous,
    )  # fmt: skip
    (folder / "robot.urdf").write_bytes(robot.urdf)
    (folder / "along_z.urdf").write_text(along_z(robot, rows.frames[1]))
    _write_ours(rows, folder)
    rpy = np.array([pin.rpy.matrixToRpy(R) for R in data.rotation[fit]])
    columns = ["x1", "y1", "z1", "phix1", "phiy1", "phiz1", *robot.readings]
    pd.DataFrame(np.hstack([data.position[fit], rpy, data.readings[fit]]), columns=columns).to_csv(
        folder / "figaroh.csv", index=False
    )
    task = {
        "enabled": True,
        "type": "kinematic_calibration",
        "parameters": {"calibration_level": "full_params", "outlier_threshold": 0.02},
        "kinematics": {"base_frame": "universe", "tool_frame": robot.tip},
        "measurements": {"markers": [{"name": "target", "measurable_dof": [True] * 6}]},
        "data": {"source_file": str(folder / "figaroh.csv"), "number_of_samples": int(fit.sum())},
    }
    settings = {"schema_version": "2.0", "robot": {"name": "ur10"}, "tasks": {"calibration": task}}
    (folder / "figaroh.yaml").write_text(yaml.safe_dump(settings))


def _write_ours(rows: Rows, folder: Path) -> None:
    data, robot = rows.data, rows.robot
    assert data.rotation is not None
    columns = [*robot.readings, "x", "y", "z", "qx", "qy", "qz", "qw"]
    quaternions = Rotation.from_matrix(data.rotation).as_quat()
    made = pd.DataFrame(np.hstack([data.readings, data.position, quaternions]), columns=columns)
    made["split"] = np.where(data.test, "test", "train")
    made.to_csv(folder / "measurements.csv", index=False)
    campaign = {
        "format": 1,
        "robot": {"urdf": "robot.urdf", "base": robot.base, "tip": robot.tip},
        "measurements": {"file": "measurements.csv", "kind": "pose"},
    }
    (folder / "campaign.yaml").write_text(yaml.safe_dump(campaign))


def told_apart(mdh: np.ndarray) -> np.ndarray:
    """Which constants of a modified table rows of positions can tell apart, beside base and place of the target.

    The first row is a part of the base; of offsets along parallel axes one can be told; the last turn and offset move the target
    along what its own place already has.

    Args:
        mdh: Columns alpha, a, theta, d, shape (R, 4).

    Returns:
        True where a constant is identified, shape (R, 4).
    """
    mask = np.ones(mdh.shape, dtype=bool)
    mask[0] = False
    parallel = np.abs(np.sin(mdh[:, 0])) < 1e-3
    mask[:-1, 3] &= ~parallel[1:]
    mask[-1, 2:] = False
    return mask


def along_z(robot: Robot, tip_target: pin.SE3) -> str:
    """Write the chain with all axes along z and the target as its last link: robotkinecal takes every axis for a z axis."""
    lines = [f'<robot name="{robot.tip}"><link name="link_0"/>']
    turn = pin.SE3.Identity()
    for k, (joint, onward, column) in enumerate(zip(robot.joints, robot.onward, robot.columns, strict=False), 1):
        onto = pin.SE3(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), joint.along).matrix(), np.zeros(3))
        origin = _origin(turn.inverse() * onward * onto)
        lines.append(
            f'<link name="link_{k}"/><joint name="{joint.name}" type="revolute"><parent link="link_{k - 1}"/>'
            f'<child link="link_{k}"/>{origin}<axis xyz="0 0 1"/>'
            f'<limit lower="{column.lower}" upper="{column.upper}" effort="1" velocity="1"/></joint>'
        )
        turn = onto
    last = _origin(turn.inverse() * robot.onward[-1] * tip_target)
    lines.append(
        f'<link name="target"/><joint name="mounting" type="fixed"><parent link="link_{len(robot.joints)}"/>'
        f'<child link="target"/>{last}</joint></robot>'
    )
    return "\n".join(lines)


def _origin(T: pin.SE3) -> str:
    xyz, rpy = (" ".join(f"{v:.17g}" for v in part) for part in (T.translation, pin.rpy.matrixToRpy(T.rotation)))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def environment(tool: str) -> Path:
    """Return the interpreter of a tool's own environment, which is made if it is not there."""
    if tool == "aridcal":
        return Path(sys.executable)
    home = ENVIRONMENTS / tool
    required = (PINNED | HAND_EYE)[tool]
    wanted = "\n".join(required)
    if not (home / "made").is_file() or (home / "made").read_text() != wanted:
        uv = shutil.which("uv", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")
        assert uv is not None, "uv is not installed: it is in the developers' environment (make test)"
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        subprocess.run([uv, "venv", "--quiet", "--clear", "--python", version, str(home)], check=True)
        subprocess.run([uv, "pip", "install", "--quiet", "--python", str(home), *required], check=True)
        (home / "made").write_text(wanted)
    return home / "bin" / "python"


def run(tool: str, folder: Path, limit: int) -> dict[str, Any]:
    """Let a tool fit the rows of a folder: its own account, and CPU seconds of the whole process; ``failed`` says why not."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    python = environment(tool)
    if tool == "aridcal":
        clean["PYTHONPATH"] = str(TOP)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [str(python), str(TOP / "benchmarks" / "peer_tools.py"), tool, str(folder)],
        capture_output=True, text=True, check=False, env=clean | ONE_THREAD | {"MPLBACKEND": "Agg"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5)),
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    whole = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        return {"whole": whole, "failed": f"stopped at {limit} s of CPU" if whole > limit - 1 else last}
    return json.loads((folder / f"{tool}.json").read_text()) | {"whole": whole}


def errors(rows: Rows, folder: Path, tool: str) -> tuple[float, float]:
    """RMS on the held-out rows, [mm] and [mrad]; NaN where a tool knows no rotation."""
    answer, held = np.load(folder / f"{tool}.npz"), rows.data.test
    assert rows.data.rotation is not None
    apart = np.linalg.norm(answer["position"] - rows.data.position[held], axis=1)
    if not len(answer["rotation"]):
        return 1e3 * float(np.sqrt(np.mean(apart**2))), float("nan")
    turned = np.swapaxes(answer["rotation"], 1, 2) @ rows.data.rotation[held]
    angle = Rotation.from_matrix(turned).magnitude()
    return 1e3 * float(np.sqrt(np.mean(apart**2))), 1e3 * float(np.sqrt(np.mean(angle**2)))


def fit_seconds(told: dict[str, Any]) -> float:
    """CPU seconds between rows in memory and constants."""
    return float(told["seconds"]["solve"] + told["seconds"].get("choice", 0.0))


def compare(rows: Rows, tools: list[str], limit: int, console: Console) -> None:
    """Print one table: every tool on these rows."""
    counts = f"{rows.data.train.sum():,} rows fitted, {rows.data.test.sum():,} held out"
    table = Table(title=f"{rows.name}: {counts}; CPU seconds, and how often ours", title_justify="left")
    heads = ("unknowns", "imports", "read", "choice", "fit", "whole", "fit / ours", "whole / ours", "mm", "mrad")
    table.add_column("tool")
    for head in heads:
        table.add_column(head, justify="right")
    notes = []
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        write(rows, folder)
        several = sorted(
            (run("aridcal", folder, limit) for _ in range(REPEATS)), key=lambda one: one["seconds"]["solve"]
        )
        ours = several[REPEATS // 2]
        for tool in tools:
            console.print(f"{rows.name}: {tool} ...", style="dim")
            told = ours if tool == "aridcal" else run(tool, folder, limit)
            if "failed" in told:
                at_least = told["whole"] / ours["whole"]
                table.add_row(tool, *[""] * 4, "", f"> {told['whole']:.0f}", "", f"> {at_least:.0f}", "failed", "")
                notes.append(f"{tool}: {told['failed']}")
                continue
            seconds, (mm, mrad) = told["seconds"], errors(rows, folder, tool)
            steps = [f"{seconds[step]:.2f}" if step in seconds else "" for step in ("imports", "read", "choice")]
            fitted, whole = fit_seconds(told), told["whole"]
            ratios = [f"{fitted / fit_seconds(ours):.1f}", f"{whole / ours['whole']:.1f}"]
            unknowns = str(told["unknowns"])
            ends = [f"{mm:.4f}", "" if np.isnan(mrad) else f"{mrad:.4f}"]
            table.add_row(tool, unknowns, *steps, f"{fitted:.3f}", f"{whole:.2f}", *ratios, *ends)
            notes.append(f"{tool}: {told['said']}")
    console.print(table, *notes, sep="\n")


def exponent(console: Console) -> None:
    """Print what the fit costs against the number of rows, all in this process and in memory."""
    taken = []
    table = Table(title="aridcal against the number of rows: poses in memory, 54 unknowns", title_justify="left")
    for head in ("rows", "CPU s", "µs per row", "exponent since the row above"):
        table.add_column(head, justify="right")
    for n in SIZES:
        rows = simulated(n, 0)
        campaign = campaign_of(rows.robot, "full")
        solves = []
        for _ in range(REPEATS if n < SIZES[-1] else 1):
            began = time.process_time()
            fit_geometry(campaign.question, rows.robot, rows.data, ())
            solves.append(time.process_time() - began)
        taken.append(float(np.median(solves)))
        step = f"{np.log10(taken[-1] / taken[-2]):.3f}" if len(taken) > 1 else ""
        table.add_row(f"{n:,}", f"{taken[-1]:.3f}", f"{1e6 * taken[-1] / n:.1f}", step)
    console.print(table)
    whole = np.log(taken[-1] / taken[0]) / np.log(SIZES[-1] / SIZES[0])
    steepest = np.max(np.diff(np.log10(taken)))
    console.print(f"Exponent from {SIZES[0]:,} to {SIZES[-1]:,} rows: {whole:.3f}; steepest decade {steepest:.3f}")


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="*", default=["series-b", "1000", "12000"], help="series-b, or numbers of rows")
    parser.add_argument("--tools", nargs="*", default=list(PINNED), choices=list(PINNED), help="beside aridcal")
    parser.add_argument("--limit", type=int, default=600, help="CPU seconds after which a tool is stopped")
    parser.add_argument("--no-exponent", action="store_true", help="leave out the cost against the number of rows")
    arguments = parser.parse_args()
    console = Console(width=150)
    for data in arguments.data:
        rows = series_b() if data == "series-b" else simulated(int(data))
        compare(rows, ["aridcal", *arguments.tools], arguments.limit, console)
    if not arguments.no_exponent:
        exponent(console)
    return 0


if __name__ == "__main__":
    assert list(TOOLS)[1:] == list(PINNED)
    sys.exit(main())
