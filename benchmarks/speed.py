"""How long the solver takes and how much memory it needs: against rows, against coefficients, against SciPy.

Example:
    python benchmarks/speed.py            # all tables
    python benchmarks/speed.py --quick    # without the largest case, the scaling and SciPy's own derivatives
    python benchmarks/speed.py --start    # only how long commands take to start, and a report to draw

Every case runs in a process of its own with one thread, is loaded through ``aridcal``'s own reader, and is solved by
``fit_geometry`` as ``identify`` does it: frames unknown, no noise declared, outliers looked for, everything that cannot
be told apart found and named, the answer checked from other starts. Times are CPU seconds of the process: the first
solve, which a user waits for, and the best of several, which disturbs least; memory is the peak over what the process
held once its modules were imported, the table and its reading included.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from aridcal.engine.fit import stages
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import spread
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.engine.rows.dataset import Dataset, with_sigma
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.read import load_measurements
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign

ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
TOP = Path(__file__).resolve().parents[1]
SERIES_B = TOP / "identification" / "ur10-laser-tracker" / "campaign-b.yaml"
DEMO = TOP / "identification" / "arid-undeclared" / "campaign.yaml"
STARTS = 5
STAGES = {"start": "_start", "fit": "fit_identifiable", "restarts": "with_restarts"}


@dataclass(frozen=True)
class Loaded:
    """A campaign with its robot and rows."""

    campaign: Campaign
    robot: Robot
    rows: Dataset

    def solve(self) -> stages.Geometry:
        """Frames, then frames and constants, from all rows."""
        return stages.fit_geometry(self.campaign.question, self.robot, self.rows, ())


def load(path: Path) -> Loaded:
    campaign = load_campaign(path)
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, campaign.robot.base)
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds, 0)
    return Loaded(campaign, robot, rows)


def make_campaign(folder: Path, n: int, parameters: str = "full") -> Path:
    """Simulate a UR10 whose 42 constants are all off by a millimetre or a milliradian; returns its campaign."""
    urdf = TOP / "urdf" / "ur10.urdf"
    wrong = {c.name: {"std": 1e-3} for c in constants(load_robot(urdf, "tool0"), "full")}
    frames = {
        "world_base": {"xyz": [2.9, -1.1, -1.2], "rpy": [0.01, 0.02, 1.4]},
        "tip_target": {"xyz": [0.02, 0.05, 0.11], "rpy": [0.4, -0.3, -1.6]},
    }
    truth = {"parameters": wrong, "frames": frames, "noise": {"position": 1e-4, "rotation": 1e-4}, "n": n}
    settings = {
        "format": 1,
        "robot": {"urdf": str(urdf), "base": "base_link", "tip": "tool0"},
        "measurements": {"kind": "pose"},
        "parameters": {"set": parameters},
        "truth": truth,
    }
    scenario = folder / "scenario.yaml"
    scenario.write_text(yaml.safe_dump(settings))
    write_campaign(simulate(load_settings(scenario, Scenario)), folder, folder)
    return folder / "campaign.yaml"


def time_stages(taken: dict[str, list[float]]) -> None:
    """Let the stages of ``fit_geometry`` note their CPU time, call by call."""
    for stage, name in STAGES.items():
        inner = getattr(stages, name)

        def timed(*given: Any, inner: Callable[..., Any] = inner, stage: str = stage) -> Any:
            began = time.process_time()
            result = inner(*given)
            taken.setdefault(stage, []).append(time.process_time() - began)
            return result

        setattr(stages, name, timed)


def measure(path: Path, repeats: int) -> dict[str, float]:
    """Load and solve a campaign; figures of the best solve, of the first, and the peak of memory, [s] and [MB]."""
    before = _held_mb()
    began = time.process_time()
    loaded = load(path)
    loading = time.process_time() - began
    taken: dict[str, list[float]] = {}
    time_stages(taken)
    solves = []
    for _ in range(repeats):
        taken.clear()
        began = time.process_time()
        found = loaded.solve()
        total = time.process_time() - began
        nominal, geometric = taken["fit"]
        solves.append((total, taken["start"][0], nominal, geometric + taken["restarts"][0]))
    best = min(solves)
    return {
        "rows": len(loaded.rows),
        "candidates": len(found.geometric.candidates),
        "identified": len(found.geometric.theta),
        "loading": loading,
        "start": best[1],
        "nominal": best[2],
        "geometric": best[3],
        "total": best[0],
        "first": solves[0][0],
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before,
    }


def compare(path: Path, numerical: bool) -> dict[str, float]:
    """The final least squares alone, from the same start and for the same coefficients: here, and by SciPy."""
    loaded = load(path)
    found = loaded.solve().geometric
    asked = problem(found.model, with_sigma(loaded.rows, found.sigma.tolist()))
    scale = spread(found.sigma, asked.channels)

    def r(theta: np.ndarray) -> np.ndarray:
        return (asked.scaled_residual(theta) / scale).ravel()

    def J(theta: np.ndarray) -> np.ndarray:
        columns = asked.linearised(theta)[1]
        return np.asarray(-(columns / scale[:, None]).reshape(-1, len(theta)))

    start = np.zeros(len(found.theta))
    ours = _best(lambda: stages.fit(asked, start), 3)
    analytic = _best(lambda: least_squares(r, start, jac=J, x_scale="jac", method="trf"), 3)
    times = {"ours": ours, "scipy": analytic}
    if numerical:
        times["numerical"] = _best(lambda: least_squares(r, start, x_scale="jac", method="trf"), 1)
    return times


def _best(job: Callable[[], Any], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        began = time.process_time()
        job()
        times.append(time.process_time() - began)
    return min(times)


def _held_mb() -> float:
    """Resident memory now, [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def in_a_process(*arguments: str) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, str(Path(__file__)), *arguments], check=True, capture_output=True, text=True,
        env=os.environ | ONE_THREAD,
    )  # fmt: skip
    return dict(json.loads(done.stdout))


def identify_seconds(path: Path, out: Path) -> tuple[float, float]:
    """Wall and CPU time of ``aridcal identify`` from the command to the finished report, threads as the user has them."""
    free = {name: value for name, value in os.environ.items() if name not in ONE_THREAD}
    return _cpu([sys.executable, "-m", "aridcal.identify", str(path), "--out", str(out)], free)


def _cpu(command: list[str], env: Mapping[str, str]) -> tuple[float, float]:
    """Wall and CPU time of a process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env=env, cwd=TOP)
    wall = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def start_table(top: Path) -> Table:
    """CPU seconds of processes of their own, the best of some, beside one that imports NumPy: a busy computer slows down all."""
    outcome = top / "outcome.pickle"
    pickled = f"import pickle; outcome = pickle.load(open({str(outcome)!r}, 'rb'))"
    outcome.write_bytes(pickle.dumps(identify(DEMO)))
    drawing = (
        "from aridcal.pages.report.page import page; from aridcal.jobs.calibrate.controllers import controller_exports"
        "; made = controller_exports(outcome)"
    )
    jobs = {
        "python -c 'import numpy'": "import numpy",
        "aridcal --help": "from aridcal.__main__ import main; main(['--help'])",
        "identify, ready to read its table": "import aridcal.identify",
        "an outcome, its exports worked out": f"{pickled}; {drawing}",
        "the same, and the report drawn": f"{pickled}; {drawing}; page(outcome, made)",
    }
    table = Table(title="Start and end", title_justify="left")
    for head in ("process", "CPU seconds", "times import numpy"):
        table.add_column(head, justify="left" if head == "process" else "right")
    seconds: dict[str, float] = {}
    for _ in range(STARTS):  # in turn, so that all meet the same load
        for name, code in jobs.items():
            seconds[name] = min(
                seconds.get(name, np.inf), _cpu([sys.executable, "-c", code], os.environ | ONE_THREAD)[1]
            )
    for name, taken in seconds.items():
        table.add_row(name, f"{taken:.3f}", f"{taken / seconds[next(iter(jobs))]:.1f}")
    return table


def add_row(table: Table, label: str, m: dict[str, float]) -> None:
    times = [f"{m[k]:.3f}" for k in ("loading", "start", "nominal", "geometric", "total", "first")]
    counts = [f"{m['rows']:,.0f}", f"{m['candidates']:.0f}", f"{m['identified']:.0f}"]
    table.add_row(label, *counts, *times, f"{1e6 * m['total'] / m['rows']:.1f}", f"{m['memory']:.0f}")


def stage_table(title: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("data")
    for head in ("rows", "unknowns", "identified", "loading", "start", "nominal", "geometric", "solved", "first time",
                 "µs per row", "MB"):  # fmt: skip
        table.add_column(head, justify="right")
    return table


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="leave out what takes long")
    parser.add_argument("--start", action="store_true", help="only start and end")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--against", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--repeats", type=int, default=5, help="solves of which the best counts")
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(arguments.one, arguments.repeats)))
        return 0
    if arguments.against:
        print(json.dumps(compare(arguments.against, not arguments.quick)))
        return 0

    console = Console(width=140)
    with tempfile.TemporaryDirectory() as temporary:
        console.print(start_table(Path(temporary)))
        if arguments.start:
            return 0
        _tables(Path(temporary), console, arguments.quick, arguments.repeats)
    return 0


def _tables(top: Path, console: Console, quick: bool, repeats: int) -> None:
    def made(name: str, n: int, parameters: str = "full") -> Path:
        folder = top / name
        folder.mkdir()
        return make_campaign(folder, n, parameters)

    def measured(path: Path, times: int = repeats) -> dict[str, float]:
        return in_a_process("--one", str(path), "--repeats", str(times))

    table = stage_table("CPU seconds by stage")
    series_b = (TOP.parent / "shared" / "data").is_dir()
    small = SERIES_B if series_b else made("small", 1495)
    add_row(table, "UR10 series B" if series_b else "UR10, simulated", measured(small))
    large = made("large", 12_000)
    add_row(table, "UR10, simulated", measured(large, 3))
    console.print(table)

    table = stage_table("Against the number of coefficients: 3,000 rows, four parameter sets")
    for which in ("none", "angles", "doty", "full"):
        add_row(table, f"set: {which}", measured(made(which, 3000, which)))
    console.print(table)

    if not quick:
        table = stage_table("Against the number of rows: set full")
        for n in (1000, 3000, 10_000, 30_000, 100_000, 1_000_000):
            add_row(table, "UR10, simulated", measured(made(f"rows_{n}", n), 3 if n < 50_000 else 1))
        console.print(table)

    table = Table(title="The last least squares alone, same model and start: CPU time, ours = 1", title_justify="left")
    for head in ("data", "ours, outliers looked for", "SciPy, our derivatives", "SciPy, its own derivatives"):
        table.add_column(head, justify="right" if head != "data" else "left")
    times = in_a_process("--against", str(small), *(["--quick"] if quick else []))
    ratios = [f"{times[k] / times['ours']:.1f}" if k in times else "" for k in ("scipy", "numerical")]
    table.add_row(small.parent.name, f"{times['ours']:.3f} s", *ratios)
    console.print(table)

    runs = [identify_seconds(DEMO, top / f"out_{k}") for k in range(3)]
    wall, cpu = min(runs)
    console.print(f"aridcal identify {DEMO.relative_to(TOP)}: {wall:.1f} s wall, {cpu:.1f} s CPU, report and all")


if __name__ == "__main__":
    sys.exit(main())
