"""How much memory long work takes, how long it takes, and how long it is silent.

Example:
    python benchmarks/endurance.py memory
    python benchmarks/endurance.py memory "60 joints" "predict 1,000,000 rows"

Every case is made with a seed, by this file in a child process, and every command runs as a child of its own, as a user
starts it. Told are the peak of its resident memory (``ru_maxrss``), its time, and the longest time between two lines that
it writes to stderr, its start and its end counted as lines.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

TOP = Path(__file__).resolve().parents[1]
UR10 = TOP / "urdf" / "ur10.urdf"
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(TOP), "COLUMNS": "200"}
FRAMES = {
    "world_base": {"xyz": [2.9, -1.1, -1.2], "rpy": [0.01, 0.02, 1.4]},
    "tip_target": {"xyz": [0.02, 0.05, 0.11], "rpy": [0.4, -0.3, -1.6]},
}
GIGA, MEGA = 1e9, 1e6


@dataclass(frozen=True)
class Case:
    """Something that takes long.

    Attributes:
        name: In the table.
        make: Writes its files into a folder.
        command: The command's arguments; ``calibration`` in them stands for a calibration of the UR10.
        most: Bytes that it may take.
        status: Exit status that it should have.
    """

    name: str
    make: Callable[[Path], None]
    command: tuple[str, ...]
    most: float
    status: int = 0


@dataclass(frozen=True)
class Run:
    """How a command fared.

    Attributes:
        status: Its exit status.
        peak: Of its resident memory, in bytes.
        seconds: It took.
        silence: Longest time between two lines, in seconds.
    """

    status: int
    peak: float
    seconds: float
    silence: float


def simulated(folder: Path, n: int, urdf: Path = UR10, tip: str = "tool0") -> None:
    """A campaign whose constants are all off by a millimetre or a milliradian."""
    from aridcal.engine.fit.constants import (
        constants,  # the parent stays small: a child's peak begins with its parent's
    )
    from aridcal.engine.robot.chain import load_robot
    from aridcal.files.yaml_file import load_settings
    from aridcal.jobs.simulate.scenario import Scenario
    from aridcal.jobs.simulate.simulation import simulate, write_campaign

    wrong = {c.name: {"std": 1e-3} for c in constants(load_robot(urdf, tip), "full")}
    settings = {
        "format": 1,
        "robot": {"urdf": str(urdf), "base": "base_link", "tip": tip},
        "measurements": {"kind": "pose"},
        "truth": {"parameters": wrong, "frames": FRAMES, "noise": {"position": 1e-4, "rotation": 1e-4}, "n": n},
    }
    scenario = folder / "scenario.yaml"
    scenario.write_text(yaml.safe_dump(settings))
    write_campaign(simulate(load_settings(scenario, Scenario)), folder, folder)


def unsought(folder: Path, n: int) -> None:
    """The same, and no effect is to be looked for: frames and constants alone."""
    simulated(folder, n)
    with (folder / "campaign.yaml").open("a") as campaign:
        campaign.write("diagnosis: {enabled: false}\n")


def to_simulate(folder: Path, n: int) -> None:
    """A scenario of so many rows."""
    simulated(folder, 10)
    scenario = folder / "scenario.yaml"
    scenario.write_text(scenario.read_text().replace("n: 10\n", f"n: {n}\n"))


def long_arm(folder: Path, joints: int, n: int) -> None:
    """A snake of so many revolute joints about z and y in turn, 50 mm apart."""
    links = ['<link name="base_link"/>']
    for k in range(1, joints + 1):
        inertia = '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
        links.append(
            f'<link name="l{k}"><inertial><origin xyz="0 0 0.025"/><mass value="0.2"/>{inertia}</inertial></link>'
            f'<joint name="j{k}" type="revolute"><parent link="{f"l{k - 1}" if k > 1 else "base_link"}"/>'
            f'<child link="l{k}"/><origin xyz="0.01 0 0.05"/><axis xyz="{"0 0 1" if k % 2 else "0 1 0"}"/>'
            '<limit lower="-0.6" upper="0.6" effort="1" velocity="1"/></joint>'
        )
    end = (
        f'<link name="tip"/><joint name="end" type="fixed"><parent link="l{joints}"/><child link="tip"/>'
        '<origin xyz="0 0 0.1"/></joint>'
    )
    urdf = folder / "arm.urdf"
    urdf.write_text(f'<robot name="snake">{"".join(links)}{end}</robot>')
    simulated(folder, n, urdf, "tip")


def stationed(folder: Path, n: int, stations: int) -> None:
    """The UR10 measured from so many places, one after the other."""
    simulated(folder, n)
    rng = np.random.default_rng(1)
    table = pd.read_csv(folder / "measurements.csv")
    at = np.arange(n) * stations // n
    turn, shift = Rotation.from_rotvec(rng.normal(0, 0.02, (stations, 3))), rng.normal(0, 0.1, (stations, 3))
    table[["x", "y", "z"]] = turn[at].apply(np.array(table[["x", "y", "z"]])) + shift[at]
    quaternion = ["qx", "qy", "qz", "qw"]
    table[quaternion] = (turn[at] * Rotation.from_quat(np.array(table[quaternion]))).as_quat()
    table.assign(station=[f"s{k}" for k in at]).to_csv(folder / "measurements.csv", index=False)
    campaign = folder / "campaign.yaml"
    campaign.write_text(campaign.read_text() + "frames: {world_base: {per: station}}\n")


def asked(folder: Path, n: int, parquet: bool = False, poses: bool = False) -> None:
    """A calibration of the UR10, and a table of joints, or of poses with the joints to start from."""
    simulated(folder, max(n, 300) if poses else 300)
    joints = [str(name) for name in pd.read_csv(folder / "measurements.csv", nrows=1) if str(name).endswith("_joint")]
    if poses:
        table = pd.read_csv(folder / "measurements.csv")
        table[:n].to_csv(folder / "query.csv", index=False)
        table[:300].to_csv(folder / "measurements.csv", index=False)
    else:
        drawn = np.random.default_rng(0).uniform(-1.5, 1.5, (n, len(joints)))
        query = pd.DataFrame(drawn, columns=joints)
        query.to_parquet(folder / "query.parquet") if parquet else query.to_csv(folder / "query.csv", index=False)
    identify = [sys.executable, "-m", "aridcal", "identify", str(folder / "campaign.yaml")]
    subprocess.run(identify, env=ENVIRONMENT, check=True, capture_output=True)


IDENTIFY = ("identify", "campaign.yaml", "-o", "results")
PREDICT = ("predict", "results/calibration.yaml", "query.csv", "-o", "predicted.csv")
CASES = (
    Case("60 joints, 500 rows", lambda f: long_arm(f, 60, 500), IDENTIFY, 2 * GIGA),
    Case("100,000 rows", lambda f: simulated(f, 100_000), IDENTIFY, 2 * GIGA),
    Case("1,000,000 rows, nothing sought", lambda f: unsought(f, 1_000_000), IDENTIFY, GIGA),
    Case("100 stations, 4,000 rows", lambda f: stationed(f, 4_000, 100), IDENTIFY, 2 * GIGA),
    Case("5,000 stations, 100,000 rows: refused", lambda f: stationed(f, 100_000, 5_000), IDENTIFY, 2 * GIGA, 2),
    Case("predict 1,000,000 rows", lambda f: asked(f, 1_000_000), PREDICT, 400 * MEGA),
    Case(
        "predict 1,000,000 rows of parquet",
        lambda f: asked(f, 1_000_000, parquet=True),
        ("predict", "results/calibration.yaml", "query.parquet", "-o", "predicted.parquet"),
        400 * MEGA,
    ),
    Case(
        "compensate 100,000 poses",
        lambda f: asked(f, 100_000, poses=True),
        ("compensate", "results/calibration.yaml", "query.csv", "-o", "joints.csv"),
        400 * MEGA,
    ),
    Case(
        "simulate 1,000,000 rows",
        lambda f: to_simulate(f, 1_000_000),
        ("simulate", "scenario.yaml", "-o", "made"),
        2 * GIGA,
    ),
)


def watched(command: Sequence[str], folder: Path) -> Run:
    """Run a command and watch what it writes to stderr."""
    began = last = time.monotonic()
    silence = 0.0
    child = subprocess.Popen(
        [sys.executable, "-m", "aridcal", *command],
        cwd=folder,
        env=ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    assert child.stderr is not None
    with child.stderr as lines:
        for _ in lines:
            now = time.monotonic()
            silence, last = max(silence, now - last), now
    _, status, used = os.wait4(child.pid, 0)
    now = time.monotonic()
    return Run(os.waitstatus_to_exitcode(status), 1024.0 * used.ru_maxrss, now - began, max(silence, now - last))


def memory(arguments: argparse.Namespace) -> int:
    """Print what each case takes; status 1 if one takes too much, or ends otherwise than it should."""
    table = Table("case", "peak, MB", "at most", "time, s", "longest silence, s", "status")
    good = True
    for case in CASES:
        if arguments.cases and not any(wanted in case.name for wanted in arguments.cases):
            continue
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            make = [sys.executable, __file__, "make", case.name, name]
            subprocess.run(make, env=ENVIRONMENT, check=True)
            run = watched(case.command, folder)
        good &= run.peak <= case.most and run.status == case.status
        table.add_row(
            case.name,
            f"{run.peak / MEGA:.0f}",
            f"{case.most / MEGA:.0f}",
            f"{run.seconds:.0f}",
            f"{run.silence:.1f}",
            str(run.status),
        )
        Console(stderr=True).print(f"{case.name}: {run}", soft_wrap=True)
    Console().print(table)
    return 0 if good else 1


def make(arguments: argparse.Namespace) -> int:
    """Write the files of one case; called by ``memory``, so that its own memory stays small."""
    next(case for case in CASES if case.name == arguments.case).make(arguments.folder)
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    asked_for = commands.add_parser("memory", help="peak memory, time and longest silence of long work")
    asked_for.add_argument("cases", nargs="*", help="parts of the names of cases; default: all")
    asked_for.set_defaults(run=memory)
    made = commands.add_parser("make", help="write the files of one case")
    made.add_argument("case")
    made.add_argument("folder", type=Path)
    made.set_defaults(run=make)
    arguments = parser.parse_args()
    return int(arguments.run(arguments))


if __name__ == "__main__":
    sys.exit(main())
