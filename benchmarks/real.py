"""Every real data set that we may use, split ten times by places: errors on rows never used, verdict, CPU seconds.

    python benchmarks/real.py                         # all, of shared/data
    python benchmarks/real.py --only wam --splits 3
    python benchmarks/real.py --save before.json      # to compare later: --beside before.json

A place is all rows whose joints lie within 20 mrad or mm of another row of it: no held-out row has a twin among the fitted
ones; a fifth of the places is held out. Balls in sockets are held out by the place of the part, one after the other. Rows that
the data set's authors held out are one more split. Each run is `aridcal identify` in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from rich.console import Console
from rich.table import Table
from scipy.cluster.hierarchy import fcluster, linkage

from aridcal.files.campaign import load_campaign, nominal_robot

HERE = Path(__file__).resolve().parents[1]
DATA = HERE.parent / "shared" / "data"

PLACE = 0.02
"""[rad] or [m] between neighbouring rows of one place, largest joint: hands and cams that return to a place do so within it."""

HELD_OUT = 0.2
"""Share of the places."""


@dataclass(frozen=True)
class Robot:
    """A data set.

    Attributes:
        name: Short.
        campaign: Its file.
        by: Column whose label names the part's place, up to a number or a slash; empty: places by joints.
        authors: Whether its own column `split` is one more split.
    """

    name: str
    campaign: Path
    by: str = ""
    authors: bool = False


STAGES = {
    "nominal": ("nominal", "test_all"),
    "geometric": ("geometric", "test_all"),
    "final": ("final", "test_all"),
    "not flagged": ("final", "test"),
}
"""What is shown: a stage, and whether held-out rows that are flagged as bad count."""

ROBOTS = (
    Robot("UR10 B", HERE / "identification/ur10-laser-tracker/campaign-b.yaml"),
    Robot("UR10 D", HERE / "identification/ur10-laser-tracker/campaign-d.yaml"),
    Robot("WAM", DATA / "wam-laser-tracker/campaign.yaml", authors=True),
    Robot("Panda in sockets", HERE / "identification/panda-sockets/campaign.yaml", by="point"),
    Robot("xArm6 in sockets", DATA / "xarm6-sockets/campaign.yaml", by="point"),
)


@dataclass(frozen=True)
class Split:
    """A choice of held-out rows.

    Attributes:
        name: Of the choice.
        test: True of rows that are held out, shape (n,).
    """

    name: str
    test: np.ndarray


def splits_of(robot: Robot, rows: pd.DataFrame, joints: list[str], count: int) -> Iterator[Split]:
    """The splits of a data set."""
    if robot.authors:
        yield Split("authors", (rows["split"] == "test").to_numpy())
    if robot.by:
        places = rows[robot.by].str.extract(r"^(.*?)[/0-9]", expand=False)
        for place in sorted(places.unique()):
            yield Split(f"place {place}", (places == place).to_numpy())
        return
    tree = linkage(rows[joints].to_numpy(float), "single", "chebyshev")
    place = fcluster(tree, PLACE, "distance")
    for number in range(count):
        rng = np.random.default_rng(number)
        chosen = rng.permutation(np.unique(place))[: round(HELD_OUT * len(np.unique(place)))]
        yield Split(f"split {number}", np.isin(place, chosen))


def identify(robot: Robot, split: Split, folder: Path) -> dict[str, object]:
    """Errors of a calibration on the rows that a split holds out."""
    settings = yaml.safe_load(robot.campaign.read_text("utf-8"))
    table = (robot.campaign.parent / settings["measurements"]["file"]).resolve()
    rows = pd.read_csv(table, dtype=str)
    rows["split"] = np.where(split.test, "test", "train")
    rows.to_csv(folder / "rows.csv", index=False)
    settings["measurements"]["file"] = str(folder / "rows.csv")
    settings["robot"]["urdf"] = str((robot.campaign.parent / settings["robot"]["urdf"]).resolve())
    (folder / "campaign.yaml").write_text(yaml.safe_dump(settings))
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    command = [sys.executable, "-m", "aridcal.identify", str(folder / "campaign.yaml"), "--quiet"]
    subprocess.run(command, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    result = json.loads((folder / "results" / "result.json").read_text("utf-8"))
    errors = {
        f"{name} {channel}": result["error"][stage][rows][channel]["rms"]
        for name, (stage, rows) in STAGES.items()
        for channel in ("position_mm", "rotation_mrad")
        if channel in result["error"][stage][rows]
    }
    mean = result["error"]["final"]["test_all"]["position_mm"]["mean"]
    return {
        "split": split.name, **errors, "final mean": mean, "effects": len(result["effects"]),
        "verdict": result["verdict"], "seconds": seconds,
    }  # fmt: skip


def joints_of(robot: Robot) -> list[str]:
    """Columns of the joints: those numbers of the table that the campaign's robot names."""
    return list(nominal_robot(load_campaign(robot.campaign)).readings)


def measure(robot: Robot, count: int) -> list[dict[str, object]]:
    """A row for each split."""
    settings = yaml.safe_load(robot.campaign.read_text("utf-8"))
    rows = pd.read_csv(robot.campaign.parent / settings["measurements"]["file"])
    measured = []
    for split in splits_of(robot, rows, joints_of(robot), count):
        with tempfile.TemporaryDirectory() as folder:
            measured.append(identify(robot, split, Path(folder)))
            print(robot.name, measured[-1], file=sys.stderr, flush=True)
    return measured


def as_table(measured: dict[str, list[dict[str, object]]], beside: dict[str, list[dict[str, object]]]) -> Table:
    """Means over the splits, authors' own apart; with an earlier run's errors in brackets."""
    table = Table("robot", "splits", *(f"{c}, mm (mrad)" for c in STAGES), "mean, mm", "effects", "verdicts", "CPU, s")
    for name, rows in measured.items():
        for authors in (False, True):
            own = [row for row in rows if (row["split"] == "authors") == authors]
            if not own:
                continue
            old = [row for row in beside.get(name, []) if (row["split"] == "authors") == authors]
            cells = [_errors(own, c) + (f" [{_errors(old, c)}]" if old else "") for c in STAGES]
            verdicts = {str(row["verdict"]) for row in own}
            counts = ", ".join(f"{v} {sum(row['verdict'] == v for row in own)}" for v in sorted(verdicts))
            table.add_row(
                name, "authors'" if authors else str(len(own)), *cells, f"{_mean(own, 'final mean'):.4f}",
                f"{_mean(own, 'effects'):.1f}", counts, f"{_mean(own, 'seconds'):.1f}",
            )  # fmt: skip
    return table


def _errors(rows: list[dict[str, object]], stage: str) -> str:
    position = f"{_mean(rows, f'{stage} position_mm'):.4f}"
    turned = f"{stage} rotation_mrad"
    return f"{position} ({_mean(rows, turned):.4f})" if turned in rows[0] else position


def _mean(rows: list[dict[str, object]], column: str) -> float:
    return float(np.mean([float(str(row[column])) for row in rows]))


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("--only", default="", help="part of a robot's name")
    command.add_argument("--splits", type=int, default=10)
    command.add_argument("--save", type=Path, help="where to write all figures, .json")
    command.add_argument("--beside", type=Path, help="figures of an earlier run")
    arguments = command.parse_args()
    chosen = [robot for robot in ROBOTS if arguments.only.lower() in robot.name.lower()]
    measured = {robot.name: measure(robot, arguments.splits) for robot in chosen}
    if arguments.save is not None:
        arguments.save.write_text(json.dumps(measured, indent=1))
    beside = json.loads(arguments.beside.read_text()) if arguments.beside is not None else {}
    Console(width=170).print(as_table(measured, beside))


if __name__ == "__main__":
    main()
