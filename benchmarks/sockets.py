"""A real Panda in printed sockets: what is left at places and rows held out, and which of several explanations matters there.

Example:
    python benchmarks/sockets.py                    # all tables
    python benchmarks/sockets.py rivals             # one of them

- ``search``: nothing declared; each of the three places held out, and eight draws of a fifth of the rows.
- ``rivals``: explanations of joint 2 that the fitted rows hardly tell apart, each declared by itself and nothing sought; rows
  weighed by what makes them scatter, and all alike.
- ``floor``: the same with every row fitted: what each place is left with at best.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from rich.console import Console
from rich.table import Table

from aridcal.engine.fit.constants import station_labels
from aridcal.engine.fit.problem import problem
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.rows.approach import with_directions
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.loop import calibrated_arm, fit_arm, fit_constants
from aridcal.files.campaign import load_campaign
from aridcal.files.read import load_measurements
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.system.progress import SILENT

CAMPAIGN = Path(__file__).resolve().parent.parent / "identification" / "panda-sockets" / "campaign.yaml"
PLACES = ("right", "front", "back-high")
DRAWS = range(8)
JOINT = "panda_joint2"
RIVALS: dict[str, list[dict[str, object]]] = {
    "geometry alone": [],
    "joint_gain": [{"kind": "joint_gain", "where": JOINT}],
    "joint_harmonic (1)": [{"kind": "joint_harmonic", "where": JOINT, "order": [1]}],
    "joint_harmonic (1,2)": [{"kind": "joint_harmonic", "where": JOINT, "order": [1, 2]}],
    "joint_map": [{"kind": "joint_map", "where": JOINT}],
}


def search(console: Console, folder: Path) -> None:
    """What the search leaves on held-out rows."""
    table = Table(title="nothing declared: distance on rows held out, mm", title_justify="left")
    for head in ("held out", "geometry, RMS", "final, RMS", "geometry, mean", "final, mean", "found"):
        table.add_column(head)
    draws = []
    for name, seed in [(place, 0) for place in PLACES] + [("", seed) for seed in DRAWS]:
        outcome = identify(_campaign(folder, name), seed=seed)
        test = outcome.measurements.test
        left = [_distance(stage.residual[test]) for stage in outcome.stages[1:]]
        figures = [*(_rms(d) for d in left), *(float(d.mean()) for d in left)]
        if not name:
            draws.append(figures)
        found = ", ".join(e.effect.label for e in outcome.diagnosis.effects) if outcome.diagnosis else ""
        table.add_row(name or f"draw {seed}", *(f"{v:.3f}" for v in figures), found)
    table.add_row("mean of the draws", *(f"{v:.3f}" for v in np.mean(draws, axis=0)), "")
    console.print(table)


def rivals(console: Console, folder: Path) -> None:
    """Explanations of one joint, weighed and alike."""
    table = Table(title="each declared by itself: RMS at a place held out, mm: weighed / alike", title_justify="left")
    for head in ("declared", *PLACES):
        table.add_column(head)
    for name, effects in RIVALS.items():
        figures = []
        for place in PLACES:
            rows, *residuals = _declared(_campaign(folder, place, effects))
            figures.append(" / ".join(f"{_rms(_distance(r[rows.test])):.3f}" for r in residuals))
        table.add_row(name, *figures)
    console.print(table)


def floor(console: Console, folder: Path) -> None:
    """The same explanations where every row is fitted."""
    table = Table(title="every row fitted: RMS at each place, mm: weighed / alike", title_justify="left")
    for head in ("declared", *PLACES):
        table.add_column(head)
    for name, effects in RIVALS.items():
        rows, *residuals = _declared(_campaign(folder, "none", effects))
        of = np.array([label.split("/")[0] for label in rows.labels.refers[:, 0]])
        figures = (" / ".join(f"{_rms(_distance(r[of == place])):.3f}" for r in residuals) for place in PLACES)
        table.add_row(name, *figures)
    console.print(table)


def _campaign(folder: Path, held_out: str, effects: list[dict[str, object]] | None = None) -> Path:
    """The campaign with a place held out; with its split drawn, where that is empty; with effects declared and none sought."""
    keys = yaml.safe_load(CAMPAIGN.read_text("utf-8"))
    keys["robot"]["urdf"] = str((CAMPAIGN.parent / keys["robot"]["urdf"]).resolve())
    rows = pd.read_csv(CAMPAIGN.parent / keys["measurements"]["file"], dtype=str)
    if held_out:
        rows["split"] = np.where(rows["point"].str.startswith(f"{held_out}/"), "test", "train")
    rows.to_csv(folder / "sockets.csv", index=False)
    keys["measurements"]["file"] = "sockets.csv"
    if effects is not None:
        keys |= {"effects": effects, "diagnosis": {"enabled": False}}
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(keys), "utf-8")
    return path


def _declared(path: Path) -> tuple[Dataset, np.ndarray, np.ndarray]:
    """The rows, and what a campaign's model leaves of them: weighed by what makes them scatter, and all alike."""
    campaign = load_campaign(path)
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, campaign.robot.base, campaign.limits.urdf)
    rows = with_directions(load_measurements(campaign, robot.readings, robot.limits, robot.kinds, 0))
    labels = station_labels(campaign.question, rows)
    geometry = fit_constants(campaign.question, robot, rows, labels)
    arms = (
        calibrated_arm(campaign.question, robot, rows, labels, geometry, SILENT),
        fit_arm(campaign.question, geometry, rows, SILENT),
    )
    fits = [arm.diagnosed.fit for arm in arms]
    weighed, alike = (problem(fit.model, rows).residual(fit.theta) for fit in fits)
    return rows, weighed, alike


def _distance(residual: np.ndarray) -> np.ndarray:
    """Of each row, [mm]."""
    return 1e3 * np.linalg.norm(residual, axis=1)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


TABLES = {table.__name__: table for table in (search, rivals, floor)}


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"{', '.join(TABLES)}; default: all")
    asked = parser.parse_args().tables or list(TABLES)
    with tempfile.TemporaryDirectory() as folder:
        for name in asked:
            TABLES[name](Console(width=160), Path(folder))


if __name__ == "__main__":
    main()
