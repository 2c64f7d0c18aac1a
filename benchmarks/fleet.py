"""Fleets: robots made, calibrated on a cluster over TCP, workers killed and the scheduler, too; and how busy workers are.

    python benchmarks/fleet.py make DIR --robots 200                   # campaigns DIR/robots/ROBOT/campaign.yaml
    python benchmarks/fleet.py make DIR --robots 100 --months 12 --drifting 3   # DIR/MONTH/robots/ROBOT: zeros wear
    python benchmarks/fleet.py workers DIR --robots 200                # the same with one worker and with two
    python benchmarks/fleet.py kills DIR --every 20                    # a worker every 20 s, the scheduler once

`workers` gives wall times and their efficiency T1 / (2 T2), of the whole command and from the first robot's begin to the last
one's end. Beside it stands what the computer itself gives: the same work in plain processes without Dask, one and then two at
once. Shares of time that workers are busy and CPU seconds per robot are what a loaded machine still tells. BLAS threads are
those that workers have while they work, though nothing in their environment limits them.

`kills` compares every result with that of an undisturbed fleet, byte by byte: of DIR/on-2, which `workers` leaves, and of as many
plain `identify` as --compare says. It counts how often each robot was computed to its end, and says at the end what is right.

Both write their figures to DIR/workers.json and DIR/kills.json, end after --limit seconds whatever happens, and have exit
status 1 if something is not as it should be: a result that is missing, wrong, or computed twice.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from fleet_cluster import cluster

from aridcal.files.yaml_file import load_settings
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign

TOP = Path(__file__).resolve().parents[1]

ARID = TOP / "identification" / "arid" / "scenario.yaml"

WEAR = 1.0e-4
"""[rad] a month, of a zero that drifts."""


COMPARED = ("calibrated.urdf", "residuals.csv", "calibration.yaml")
"""Files that are the same to the byte whenever they are computed; ``result.json`` is but for its seconds."""


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


def fleet(folder: Path, out: Path, address: str | None, most: int | None = None) -> subprocess.Popen[bytes]:
    """Start the command on a folder's robots."""
    words = ["-m", "aridcal.fleet", *map(str, campaigns(folder, most)), "-o", str(out)]
    return subprocess.Popen([sys.executable, *words, *(["--scheduler", address] if address else [])])


def campaigns(folder: Path, most: int | None) -> list[Path]:
    """Campaigns of a folder's robots, the first so many."""
    return sorted(folder.glob("robots/*/campaign.yaml"))[:most]


def different(robot: str, one: Path, other: Path) -> bool:
    """Whether two fleets have different results of a robot."""
    if any((one / robot / name).read_bytes() != (other / robot / name).read_bytes() for name in COMPARED):
        return True
    a, b = (json.loads((fleet / robot / "result.json").read_text("utf-8")) for fleet in (one, other))
    return bool(a | {"seconds": 0} != b | {"seconds": 0})


def kills(folder: Path, every: float, compare: int, robots: int | None, limit: float) -> int:
    """A fleet while a worker is killed every so often, and the scheduler once, half-way; returns the exit status."""
    out = folder / "fleet"
    shutil.rmtree(out, ignore_errors=True)
    asked = [path.parent.name for path in campaigns(folder, robots)]
    with cluster(folder, 2) as made:
        made.ready()
        command = fleet(folder, out, made.address, robots)
        began = last = time.monotonic()
        scheduler = False
        while command.poll() is None and time.monotonic() - began < limit:
            time.sleep(0.5)
            made.tend()
            done = sum(line["what"] == "written" for line in made.noted())
            if done and time.monotonic() - last > every:
                made.kill_worker()
                last = time.monotonic()
            if not scheduler and done >= len(asked) // 2:
                made.scheduler.send_signal(signal.SIGKILL)
                made.scheduler.wait()
                scheduler = True
        seconds = time.monotonic() - began
        stopped = command.poll() is None
        if stopped:
            command.kill()
        command.wait()
        noted, dead = made.noted(), made.killed
    written, begun = (
        Counter(line["robot"] for line in noted if line["what"] == what) for what in ("written", "begins")
    )
    there = [robot for robot in asked if all((out / robot / f).is_file() for f in (*COMPARED, "result.json"))]
    beside = {}
    undisturbed = folder / "on-2"
    both = [robot for robot in there if (undisturbed / robot / "result.json").is_file()]
    beside["undisturbed fleet"] = (len(both), [robot for robot in both if different(robot, out, undisturbed)])
    chosen = there[:: max(len(there) // compare, 1)][:compare] if compare else []
    plain = identified(folder, chosen)
    beside["plain identify"] = (len(chosen), [robot for robot in chosen if different(robot, out, plain)])
    found = {
        "load": os.getloadavg(),
        "seconds": round(seconds, 1),
        "stopped": stopped,
        "exit status": command.returncode,
        "workers killed": dead,
        "scheduler killed": scheduler,
        "robots asked": len(asked),
        "missing": sorted(set(asked) - set(there)),
        "computed to the end twice": [robot for robot, times in written.items() if times > 1],
        "written, and killed before it was noted": sorted(set(there) - set(written)),
        "begun more than once": sum(times > 1 for times in begun.values()),
        "begun at most": max(begun.values(), default=0),
        "compared with": {what: {"robots": n, "different": wrong} for what, (n, wrong) in beside.items()},
    }
    bad = (
        stopped
        or command.returncode
        or found["missing"]
        or found["computed to the end twice"]
        or not scheduler
        or not dead
    )
    return told(found, folder / "kills.json", bool(bad or any(wrong for _, wrong in beside.values())))


def identified(folder: Path, robots: Sequence[str]) -> Path:
    """Some robots calibrated by the command, one process each; returns the folder of the results."""
    plain = folder / "plain"
    shutil.rmtree(plain, ignore_errors=True)
    for robot in robots:
        words = [
            "-m",
            "aridcal",
            "identify",
            str(folder / "robots" / robot / "campaign.yaml"),
            "-o",
            str(plain / robot),
        ]
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return plain


def told(found: dict[str, Any], path: Path, bad: bool) -> int:
    """Print figures, keep them, and say whether all is as it should be."""
    found |= {"as it should be": not bad}
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print("\n".join(f"{what}: {value}" for what, value in found.items()), flush=True)
    return int(bad)


def busy(folder: Path, robots: int | None, control: int, limit: float) -> int:
    """A fleet on one worker and on two, and what the computer gives without Dask; returns the exit status."""
    walls: dict[int, tuple[float, float]] = {}
    found: dict[str, Any] = {"robots": len(campaigns(folder, robots)), "load at first": os.getloadavg()}
    wrong: list[str] = []
    for workers in (1, 2):
        out = folder / f"on-{workers}"
        shutil.rmtree(out, ignore_errors=True)
        with cluster(folder, workers) as made:
            made.ready()
            began = time.time()
            command = fleet(folder, out, made.address, robots)
            stop = threading.Timer(limit, command.kill)
            stop.start()
            _, status, used = os.wait4(command.pid, 0)
            stop.cancel()
            ended = time.time()
            scheduler = made.scheduler_cpu()
            noted = made.noted()
        figures = _figures(noted, workers)
        found[f"{workers} worker{'s' * (workers > 1)}"] = figures | {
            "whole command [s]": round(ended - began, 2),
            "until the first begin [s]": round(
                min(line["time"] for line in noted if line["what"] == "begins") - began, 2
            ),
            "after the last end [s]": round(ended - max(line["time"] for line in noted if line["what"] == "ends"), 2),
            "CPU of the command [s]": round(used.ru_utime + used.ru_stime, 2),
            "CPU of the scheduler [s]": round(scheduler, 2),
        }
        walls[workers] = ended - began, figures["first begin to last end [s]"]
        wrong += [f"exit status {status} with {workers}"] if status else []
        wrong += ["BLAS threads"] if figures["BLAS threads"] != 1 else []
    found["efficiency, whole command"] = round(walls[1][0] / (2 * walls[2][0]), 4)
    found["efficiency, first begin to last end"] = round(walls[1][1] / (2 * walls[2][1]), 4)
    found["load at last"] = os.getloadavg()
    if control:
        found["efficiency of the computer, two plain processes"] = round(plain_efficiency(folder, control), 4)
    names = [path.parent.name for path in campaigns(folder, robots)]
    wrong += [name for name in names if different(name, folder / "on-1", folder / "on-2")] if not wrong else []
    found["wrong"] = wrong
    return told(found, folder / "workers.json", bool(wrong))


PLAIN = """
import sys, time
from pathlib import Path
from aridcal.jobs.fleet.work import Task, calibrated, inputs_at
from aridcal.runs.result_folder import write_folder
out = Path(sys.argv[1])
given = map(Path, sys.argv[2:])
tasks = [Task(c.parent.name, str(c), str(out / c.parent.name), inputs_at(c)[0].key, write_folder) for c in given]
calibrated(tasks.pop(0))  # what is loaded when it is needed
print("ready", flush=True); sys.stdin.readline()
started = time.monotonic()
for task in tasks:
    assert calibrated(task)["status"] == "done"
print(time.monotonic() - started)
"""
"""Robots calibrated one after another, without Dask."""


def plain_efficiency(folder: Path, robots: int) -> float:
    """Wall time of one process that calibrates some robots, over that of two at once with as many each."""
    walls = []
    chosen = [str(path.absolute()) for path in campaigns(folder, robots + 1)]
    for processes in (1, 2):
        shutil.rmtree(folder / "control", ignore_errors=True)
        running = []
        for k in range(processes):
            out = folder / "control" / str(k)
            out.mkdir(parents=True)
            words = [sys.executable, "-c", PLAIN, str(out), *chosen]
            running.append(subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        for process in running:
            assert process.stdout is not None
            process.stdout.readline()
        for process in running:
            assert process.stdin is not None
            process.stdin.write("\n")
            process.stdin.flush()
        walls.append(np.mean([float(process.communicate()[0]) for process in running]))
    return float(walls[0] / walls[1])


def _figures(noted: list[dict[str, Any]], workers: int) -> dict[str, Any]:
    """Busy time and CPU of workers between the first robot's begin and the last one's end."""
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
    ends = {pid: max(b for _, b in own) for pid, own in _spans(noted).items()}
    turns = [later[0] - earlier[1] for own in _spans(noted).values() for earlier, later in itertools.pairwise(own)]
    return {
        "first begin to last end [s]": round(last - first, 2),
        "busy": round(share, 4),
        "alone at the end [s]": round(last - min(ends.values()), 2),
        "between two robots, median [ms]": round(1e3 * float(np.median(turns))),
        "between two robots, in all [s]": round(sum(turns), 2),
        "CPU per robot, mean [s]": round(float(np.mean(cpu)), 3),
        "CPU per robot, largest [s]": round(max(cpu), 3),
        "CPU over wall time while busy": round(sum(cpu) / sum(b - a for a, b in spans), 3),
        "BLAS threads": max(line["threads"] for line in noted if line["what"] == "writes"),
    }


def _spans(noted: list[dict[str, Any]]) -> dict[int, list[list[float]]]:
    """Begin and end of every robot, by worker."""
    own: dict[int, list[list[float]]] = {}
    for line in noted:
        if line["what"] == "begins":
            own.setdefault(line["pid"], []).append([line["time"]])
        elif line["what"] == "ends":
            own[line["pid"]][-1].append(line["time"])
    return own


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=("make", "kills", "workers"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", type=int, help="the first so many (default: all; of `make` 200)")
    parser.add_argument("--months", type=int, default=0)
    parser.add_argument("--drifting", type=int, default=0)
    parser.add_argument("--rows", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=float, default=20.0)
    parser.add_argument("--compare", type=int, default=10)
    parser.add_argument("--control", type=int, default=16, help="robots of each plain process; 0: none")
    parser.add_argument("--limit", type=float, default=900.0, help="of each fleet [s]")
    asked = parser.parse_args()
    if asked.job == "make":
        make(asked.folder, asked.robots or 200, asked.months, asked.drifting, asked.rows, asked.seed)
        return 0
    if asked.job == "kills":
        return kills(asked.folder, asked.every, asked.compare, asked.robots, asked.limit)
    return busy(asked.folder, asked.robots, asked.control, asked.limit)


if __name__ == "__main__":
    sys.exit(main())
