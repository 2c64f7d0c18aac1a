"""Fleets: robots made, calibrated on a cluster over TCP, workers killed and the scheduler, too; and how busy workers are.

    python benchmarks/fleet.py make DIR --robots 200                   # campaigns DIR/robots/ROBOT/campaign.yaml
    python benchmarks/fleet.py make DIR --robots 100 --months 12 --drifting 3   # DIR/MONTH/robots/ROBOT: zeros wear
    python benchmarks/fleet.py kills DIR --every 20                    # a worker every 20 s, the scheduler once
    python benchmarks/fleet.py workers DIR --robots 40                 # the same with one worker and with two

`kills` compares every result with that of a fleet computed in one process (of as many robots as --compare says) and counts how
often each robot was computed to its end. `workers` gives the share of time that workers are busy, and CPU seconds per robot:
what a loaded machine still tells of parallel efficiency, beside wall time, which only a quiet one does.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from aridcal.inputs.yaml_file import load_settings
from aridcal.prepare.scenario import Scenario
from aridcal.prepare.simulation import simulate, write_campaign

TOP = Path(__file__).resolve().parents[1]

ARID = TOP / "identification" / "arid" / "scenario.yaml"

WEAR = 1.0e-4
"""[rad] a month, of a zero that drifts."""

PRELOAD = """
import json, os, time
import aridcal.plant.work as work
import aridcal.result_folder as results
def log(**what):
    line = json.dumps({"pid": os.getpid(), "time": time.time(), "cpu": time.process_time()} | what) + "\\n"
    file = os.open(os.environ["FLEET_LOG"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(file, line.encode()); os.close(file)
def logged(task):
    log(what="begins", robot=task.robot)
    row = work.calibrated_itself(task)
    log(what="ends", robot=task.robot)
    return row
def written(outcome, folder, **rest):
    done = work.write_itself(outcome, folder, **rest)
    log(what="written", robot=folder.name)
    return done
if not hasattr(work, "calibrated_itself"):  # Dask may load this twice
    work.calibrated_itself, work.write_itself = work.calibrated, results.write_folder
    work.calibrated, results.write_folder = logged, written
"""
"""Of a worker: it notes what it does, and nothing else changes."""


def make(folder: Path, robots: int, months: int, drifting: int, rows: int, seed: int) -> None:
    """Write the campaigns of a fleet; with months, those of each month, of which the zeros of some robots wear."""
    base = yaml.safe_load(ARID.read_text("utf-8"))
    base["robot"]["urdf"] = str((ARID.parent / base["robot"]["urdf"]).resolve())
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"r{k:03d}" for k in range(robots)]
    worn = np.random.default_rng(seed).permutation(robots)[:drifting].tolist()
    for k, name in enumerate(names):
        rng = np.random.default_rng([seed, k])
        constants = {key: 2e-3 * float(rng.standard_normal()) for key in base["truth"]["parameters"]}
        effect = {"kind": "joint_map", "where": "joint_3", "coefficients": {"std": 3e-4 * float(rng.uniform(0, 1))}}
        for month in range(max(months, 1)):
            true = dict(constants)
            if k in worn:
                true["joint_3.theta"] += WEAR * max(month - months // 4, 0)
            truth = base["truth"] | {
                "parameters": true,
                "n": rows,
                "seed": int(rng.integers(2**31)),
                "effects": [effect],
            }
            if months:
                del truth["effects"]
            place = folder / (f"{month + 1:02d}" if months else "") / "robots" / name
            place.mkdir(parents=True, exist_ok=True)
            path = folder / "scenario.yaml"
            path.write_text(yaml.safe_dump(base | {"truth": truth}), encoding="utf-8")
            write_campaign(simulate(load_settings(path, Scenario)), place, place)
            if months:
                day = datetime.date(2026, 1, 15) + datetime.timedelta(days=30 * month)
                with (place / "campaign.yaml").open("a", encoding="utf-8") as file:
                    file.write(f'about: {{date: "{day.isoformat()}"}}\n')
    (folder / "worn.json").write_text(json.dumps([names[k] for k in worn]), encoding="utf-8")


class Cluster:
    """A scheduler and workers as processes of their own; what dies is started again, as systemd would do it."""

    def __init__(self, folder: Path, workers: int) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.folder, self.address = folder, f"tcp://127.0.0.1:{self.port}"
        self.log = folder / "log.jsonl"
        self.log.unlink(missing_ok=True)
        (folder / "preload.py").write_text(PRELOAD, encoding="utf-8")
        self.scheduler = self._scheduler()
        self.workers = [self._worker() for _ in range(workers)]
        self.killed = 0

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        env = os.environ | {"FLEET_LOG": str(self.log), "OMP_NUM_THREADS": "1"}
        with (self.folder / "cluster.txt").open("ab") as out:
            return subprocess.Popen(
                [sys.executable, "-m", "distributed.cli." + words[0], *words[1:]], env=env, stdout=out, stderr=out
            )

    def _scheduler(self) -> subprocess.Popen[bytes]:
        return self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard")

    def _worker(self) -> subprocess.Popen[bytes]:
        preload = str(self.folder / "preload.py")
        rest = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60", "--preload", preload)
        return self._start("dask_worker", self.address, *rest)

    def tend(self) -> None:
        """Start again what has ended."""
        if self.scheduler.poll() is not None:
            self.scheduler = self._scheduler()
        self.workers = [w if w.poll() is None else self._worker() for w in self.workers]

    def kill_worker(self) -> None:
        """Kill one, the oldest."""
        self.workers[0].send_signal(signal.SIGKILL)
        self.workers[0].wait()
        self.workers.append(self.workers.pop(0))
        self.killed += 1

    def stop(self) -> None:
        """End all of it."""
        for process in (*self.workers, self.scheduler):
            process.kill()
        for process in (*self.workers, self.scheduler):
            process.wait()

    def noted(self) -> list[dict[str, Any]]:
        """What workers noted."""
        lines = self.log.read_text("utf-8").splitlines() if self.log.exists() else []
        return [json.loads(line) for line in lines]


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    """A cluster, until the block ends."""
    made = Cluster(folder, workers)
    try:
        yield made
    finally:
        made.stop()


def fleet(folder: Path, out: Path, address: str | None, most: int | None = None) -> subprocess.Popen[bytes]:
    """Start the command on a folder's robots."""
    names = sorted(str(path) for path in folder.glob("robots/*/campaign.yaml"))[:most]
    words = ["-m", "aridcal.fleet", *names, "-o", str(out), *(["--scheduler", address] if address else [])]
    return subprocess.Popen([sys.executable, *words])


def kills(folder: Path, every: float, compare: int, robots: int | None) -> None:
    """A fleet while a worker is killed every so often, and the scheduler once, half-way."""
    out = folder / "fleet"
    shutil.rmtree(out, ignore_errors=True)
    with cluster(folder, 2) as made:
        command = fleet(folder, out, made.address, robots)
        asked = len(list(folder.glob("robots/*/campaign.yaml"))[:robots])
        last, scheduler = time.monotonic(), False
        while command.poll() is None:
            time.sleep(0.5)
            made.tend()
            written = sum(line["what"] == "written" for line in made.noted())
            if written and time.monotonic() - last > every:
                made.kill_worker()
                last = time.monotonic()
            if not scheduler and written >= asked // 2:
                made.scheduler.send_signal(signal.SIGKILL)
                made.scheduler.wait()
                scheduler = True
        noted, dead = made.noted(), made.killed
    times = Counter(line["robot"] for line in noted if line["what"] == "written")
    begun = Counter(line["robot"] for line in noted if line["what"] == "begins")
    print(f"exit status {command.returncode}; workers killed: {dead}; scheduler killed: {scheduler}")
    print(f"robots asked {asked}, written {len(times)}, written twice {sum(n > 1 for n in times.values())}")
    print(f"begun more than once {sum(n > 1 for n in begun.values())}, at most {max(begun.values())} times")
    plain = folder / "plain"
    shutil.rmtree(plain, ignore_errors=True)
    chosen = [*times][:: max(len(times) // compare, 1)][:compare]
    code = "import sys; from pathlib import Path; from aridcal.identify import main; sys.exit(main(sys.argv[1:]))"
    wrong = []
    for name in chosen:
        campaign = folder / "robots" / name / "campaign.yaml"
        words = [sys.executable, "-c", code, str(campaign), "-o", str(plain / name)]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        files = ("calibrated.urdf", "residuals.csv")
        wrong += [name] if any((plain / name / f).read_bytes() != (out / name / f).read_bytes() for f in files) else []
    print(f"compared with one process: {len(chosen)} robots, different: {wrong or 'none'}")


def busy(folder: Path, robots: int) -> None:
    """A fleet on one worker and on two."""
    walls = []
    for workers in (1, 2):
        out = folder / f"on-{workers}"
        shutil.rmtree(out, ignore_errors=True)
        with cluster(folder, workers) as made:
            time.sleep(20)  # until workers have loaded what they need
            fleet(folder, out, made.address, robots).wait()
            noted = made.noted()
        walls.append(_report(noted, workers))
    print(f"efficiency by wall time: {walls[0] / (2 * walls[1]):.3f} (tells something on a quiet machine alone)")


def _report(noted: list[dict[str, Any]], workers: int) -> float:
    """Busy time and CPU of workers between the first robot's begin and the last one's; returns the wall time, [s]."""
    begun: dict[int, dict[str, Any]] = {}
    spans, cpu = [], []
    for line in noted:
        if line["what"] == "begins":
            begun[line["pid"]] = line
        elif line["what"] == "ends":
            spans.append((begun[line["pid"]]["time"], line["time"]))
            cpu.append(line["cpu"] - begun[line["pid"]]["cpu"])
    first, last = min(a for a, _ in spans), max(b for _, b in spans)
    # The end, when one worker has nothing left to do, is counted: of 200 robots it is half a robot.
    share = sum(b - a for a, b in spans) / (workers * (last - first))
    rest = np.median([later[0] - earlier[1] for earlier, later in _turns(noted)])
    print(
        f"{workers} worker{'s' * (workers > 1)}: {len(spans)} robots in {last - first:.1f} s, busy {100 * share:.2f} %, "
        f"between two robots {1e3 * rest:.0f} ms, CPU per robot {np.mean(cpu):.3f} s (median {np.median(cpu):.3f})"
    )
    return last - first


def _turns(noted: list[dict[str, Any]]) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Pairs of robots that followed each other on one worker, as (begin, end)."""
    own: dict[int, list[list[float]]] = {}
    for line in noted:
        if line["what"] == "begins":
            own.setdefault(line["pid"], []).append([line["time"]])
        elif line["what"] == "ends":
            own[line["pid"]][-1].append(line["time"])
    whole = [[(a, b) for a, b in spans] for spans in own.values()]
    return [pair for spans in whole for pair in itertools.pairwise(spans)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=("make", "kills", "workers"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", type=int)
    parser.add_argument("--months", type=int, default=0)
    parser.add_argument("--drifting", type=int, default=0)
    parser.add_argument("--rows", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=float, default=20.0)
    parser.add_argument("--compare", type=int, default=10)
    asked = parser.parse_args()
    if asked.job == "make":
        make(asked.folder, asked.robots or 200, asked.months, asked.drifting, asked.rows, asked.seed)
    elif asked.job == "kills":
        kills(asked.folder, asked.every, asked.compare, asked.robots)
    else:
        busy(asked.folder, asked.robots or 40)


if __name__ == "__main__":
    main()
