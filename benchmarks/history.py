"""A season of a hundred robots with wear, from real fits: which drifts are named, their dates, and false alarms.

Example:
    PYTHONPATH=.:tests/support nice python benchmarks/history.py season -o /tmp/season
    PYTHONPATH=.:tests/support nice python benchmarks/history.py alarms --seasons 2000
    PYTHONPATH=.:tests/support nice python benchmarks/history.py dates --seasons 200

- ``season``: 100 robots (UR10, own constants), measured once a month with a tracker that is set up anew each time, 60 poses of
  50 um
  and 50 urad, `identify` without a search. All robots have a yearly cycle of 30 um in the length of the upper arm and of 20
  urad in the zero of the wrist, of about the same phase, not quite a sine. Three drift: see :data:`WEAR`. Then `history` of
  what was written.
- ``alarms``: fleets of 100 robots of 20 constants in which nothing changes, normal noise, every third constant with a yearly
  cycle:
  how many have an alarm anywhere, and how many single series would at larger levels.
- ``dates``: one drift of a known size in such a fleet: error of the date, and how often its interval holds it.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import yaml

from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.history.store import read_runs
from aridcal.jobs.history.trend import Cycle, Series, dated, evidence
from aridcal.jobs.history.wear import LOOKS_PER_SEASON, History, history
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.system.writing.whole_files import atomic_folder

TOP = Path(__file__).resolve().parents[1]

ROBOTS, MONTHS, ROWS, NOISE = 100, 12, 75, 5e-5
"""Of the 75 rows 60 are fitted, the rest is held out. Noise in [m] and [rad]."""

FIRST = datetime.datetime(2026, 1, 5)

ZEROS = ("shoulder_lift_joint.pitch", "elbow_joint.pitch", "wrist_1_joint.pitch", "wrist_2_joint.yaw")
"""Components that are the zeros of joints of a UR10; those of its first and last are not told from base and tool."""

LINKS = ("shoulder_lift_joint.y", "elbow_joint.z", "wrist_1_joint.x", "wrist_2_joint.z", "wrist_3_joint.x")

WEAR = {
    "r017": ("elbow_joint.pitch", 3.5, 6e-5),
    "r042": ("shoulder_lift_joint.pitch", 5.0, 1e-4),
    "r081": ("wrist_2_joint.yaw", 7.2, 1.5e-4),
}
"""Robot, zero, month from which it drifts, [rad] a month: 0.5 to 0.7 mrad at the end of the year."""


def day_of(month: float) -> float:
    """Days since the first run."""
    return 30.44 * month


def cycle_of(day: float, phase: float) -> float:
    """Of a hall's temperature, from -1 to 1: a tenth of it has half the period."""
    angle = 2 * np.pi * (day / 365.25 - phase)
    return float(0.9 * np.cos(angle) + 0.1 * np.cos(2 * angle + 1.0))


def table_of(rows: list[dict[str, Any]], folder: Path) -> None:
    """Write a run's `fleet.parquet` as docs/formats.md has it."""
    with atomic_folder(folder, {"fleet.parquet"}) as stage:
        pyarrow.parquet.write_table(pa.Table.from_pylist(rows), stage / "fleet.parquet")


def row_of(robot: str, when: datetime.datetime, found: dict[str, Any]) -> dict[str, Any]:
    """One robot's row, from its `result.json`."""
    inputs = hashlib.sha256(f"{robot} {when}".encode()).hexdigest()
    stages = [
        {"stage": stage, "channel": channel, "rms": numbers["rms"], "p95": numbers["p95"], "max": numbers["max"]}
        for stage, parts in found["error"].items()
        for channel, numbers in parts["test"].items()
    ]
    constants = [{key: p[key] for key in ("name", "value", "std", "unit", "status")} for p in found["parameters"]]
    return {
        "robot": robot, "campaign": f"{robot}/campaign.yaml", "key": inputs, "inputs": inputs, "urdf": "ur10", "time": when,
        "measured": when, "version": found["version"], "status": "done", "error": None, "rows": found["n"]["used"],
        "verdict": found["verdict"], "seconds": found["seconds"], "stages": stages, "effects": [], "constants": constants,
        "notices": found["notices"],
    }  # fmt: skip


def truth_of(robot: str, number: int, day: float) -> dict[str, float]:
    """Constants of a robot on a day."""
    rng = np.random.default_rng([7, number])
    own = {name: float(rng.normal(0.0, 1e-3)) for name in (*ZEROS, *LINKS)}
    phase = 0.05 * float(rng.normal()) + 0.55
    size = 1.0 + 0.2 * float(rng.normal())
    own["elbow_joint.z"] += 3e-5 * size * cycle_of(day, phase)
    own["wrist_1_joint.pitch"] += 2e-5 * size * cycle_of(day, phase)
    if robot in WEAR:
        name, begins, rate = WEAR[robot]
        own[name] += rate * max(day - day_of(begins), 0.0) / 30.44
    return own


def frame(rng: np.random.Generator) -> dict[str, list[float]]:
    """A tracker or a target, set up somewhere."""
    return {"xyz": rng.uniform(-2.0, 2.0, 3).tolist(), "rpy": rng.uniform(-1.0, 1.0, 3).tolist()}


def simulated(folder: Path) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """The rows of each month."""
    for month in range(MONTHS):
        rows = []
        for number in range(ROBOTS):
            rng = np.random.default_rng([11, number, month])
            robot = f"r{number:03d}"
            day = day_of(month) + float(rng.uniform(-4.0, 4.0))
            frames = {"world_base": frame(rng), "tip_target": {"xyz": rng.uniform(-0.1, 0.1, 3).tolist()}}
            keys = {
                "format": 1,
                "robot": {"urdf": str(TOP / "urdf" / "ur10.urdf"), "tip": "tool0"},
                "measurements": {"noise": {"position": NOISE, "rotation": NOISE}},
                "diagnosis": {"enabled": False},
                "truth": {
                    "n": ROWS, "seed": 1000 * month + number, "noise": {"position": NOISE, "rotation": NOISE},
                    "parameters": truth_of(robot, number, day), "frames": frames,
                },
            }  # fmt: skip
            (folder / "scenario.yaml").write_text(yaml.safe_dump(keys))
            write_campaign(simulate(load_settings(folder / "scenario.yaml", Scenario)), folder, folder)
            found = result_document(identify(folder / "campaign.yaml"))
            rows.append(row_of(robot, FIRST + datetime.timedelta(days=day), found))
        yield month, rows


def season(out: Path) -> None:
    """Simulate, identify, look."""
    work = out / "work"
    work.mkdir(parents=True, exist_ok=True)
    start = time.process_time()
    for month, rows in simulated(work):
        table_of(rows, out / f"month-{month + 1:02d}")
        print(f"month {month + 1}: {time.process_time() - start:.0f} s CPU", flush=True)
    judge(out)


def judge(out: Path) -> None:
    """Look at a season that was written."""
    start = time.process_time()
    found = history(read_runs(out))
    seconds = time.process_time() - start
    report(found)
    print(f"history: {seconds:.2f} s CPU for {found.series} series")


def report(found: History) -> None:
    """Alarms beside the truth."""
    wrong = 0
    for robot in found.robots:
        for w in robot.alarms:
            change = w.change
            assert change is not None
            began = (change.began - np.datetime64(FIRST).astype("datetime64[s]").astype(float) / 86400) / 30.44
            true = WEAR.get(robot.name)
            right = true is not None and true[0] == w.name
            wrong += not right
            width = (change.high - change.low) / 30.44
            print(
                f"{robot.name} {w.name} {change.kind}: began month {began:.2f} (truth {true[1] if right and true else '-'}), "
                f"interval {width:.2f} months, {1e3 * 30.44 * change.size:+.4f} +- {1e3 * 30.44 * change.std:.4f} mrad a month "
                f"(truth {1e3 * true[2] if right and true else 0:+.4f}), p {w.p_value:.1e}"
            )
    named = {r.name for r in found.robots if r.alarms}
    print(
        f"named {len(named & set(WEAR))} of {len(WEAR)}; {wrong} false alarms in {found.series} series of "
        f"{len(found.robots)} robots"
    )
    print(f"series that may go with the season: {sum(len(r.cycles) for r in found.robots)}")
    print("scatter over sigma:", json.dumps({name: round(value, 2) for name, value in sorted(found.scatter.items())}))


CONSTANTS = 20
"""Of a robot of the simulated fleets: a UR10 has 18."""


def quiet(rng: np.random.Generator, cycling: bool) -> Series:
    """A constant that does not change, in sigmas; with a cycle of some sigmas where it has one."""
    day = day_of(1.0) * np.arange(MONTHS) + rng.uniform(-4.0, 4.0, MONTHS)
    std = rng.uniform(0.8, 1.25, MONTHS)
    phase, size = rng.uniform(), 5.0 * rng.uniform() * cycling
    wave = np.array([cycle_of(d, phase) for d in day]) if cycling else 0.0
    return Series(day, size * wave + std * rng.normal(size=MONTHS), std)


def alarms(seasons: int) -> None:
    """Fleets in which nothing changes: the p-values of single series, and how many seasons have an alarm."""
    rng = np.random.default_rng(5)
    count, levels = ROBOTS * CONSTANTS, (0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4)
    p = np.array([[evidence(quiet(rng, k % 3 == 0)).p_value for k in range(count)] for _ in range(seasons)])
    print("share of p-values below a level, of steady series and of those with a yearly cycle:")
    for level in levels:
        below = (p < level).mean(axis=0)
        cycling = np.arange(count) % 3 == 0
        print(f"  {level:g}: {below[~cycling].mean():.2g}, {below[cycling].mean():.2g}")
    fleet = p.min(axis=1) * count * LOOKS_PER_SEASON
    print(f"seasons with an alarm anywhere: {np.sum(fleet < FALSE_ALARMS)} of {seasons}, stated {FALSE_ALARMS:.0%}")


def dates(seasons: int) -> None:
    """Errors of dates, in months, of drifts and jumps of several sizes, with the cycle known of a fleet and without one."""
    rng = np.random.default_rng(6)
    for cycle in (Cycle((0.0, 0.0), (0.2, 0.2)), None):
        print("cycle known from other robots" if cycle else "one robot alone", "(months)")
        for kind, begins, size in (
            ("drift", 3.5, 2.0), ("drift", 3.5, 5.0), ("drift", 7.2, 5.0), ("drift", 9.5, 5.0),
            ("jump", 5.5, 8.0), ("jump", 8.5, 15.0)
        ):  # fmt: skip
            error, held, right, alarmed = [], [], [], []
            for _ in range(seasons):
                plain = quiet(rng, False)
                late = plain.day - day_of(begins)
                series = replace(
                    plain,
                    value=plain.value + size * (np.maximum(late, 0.0) / day_of(1.0) if kind == "drift" else late > 0),
                )
                found = dated(series, cycle)
                error.append(abs(found.began - day_of(begins)) / day_of(1.0))
                held.append(found.low <= day_of(begins) <= found.high)
                right.append(found.kind == kind)
                alarmed.append(evidence(series).p_value * ROBOTS * CONSTANTS * LOOKS_PER_SEASON < FALSE_ALARMS)
            print(
                f"  {kind} of {size:g} sigma{' a month' if kind == 'drift' else ''} from month {begins}: alarm in "
                f"{np.mean(alarmed):.0%}, date off by {np.median(error):.2f} (median), {np.quantile(error, 0.95):.2f} (95 %), in "
                f"its interval {np.mean(held):.0%}, called so {np.mean(right):.0%}"
            )


def main() -> None:
    """Run one of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("season", "judge", "alarms", "dates"))
    parser.add_argument("-o", "--out", type=Path, default=Path("/tmp/season"))
    parser.add_argument("--seasons", type=int, default=200)
    arguments = parser.parse_args()
    if arguments.what in ("season", "judge"):
        (season if arguments.what == "season" else judge)(arguments.out)
    elif arguments.what == "alarms":
        alarms(arguments.seasons)
    else:
        dates(arguments.seasons)


if __name__ == "__main__":
    main()
