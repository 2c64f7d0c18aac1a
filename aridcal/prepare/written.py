"""A simulated campaign written: its tables, its robot, what it knows beforehand, and its truth."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from aridcal.effects.catalogue import KINDS
from aridcal.errors import MeasurementError
from aridcal.inputs.head_settings import HeadSettings
from aridcal.inputs.yaml_file import load_settings
from aridcal.instruments.camera import INTRINSICS
from aridcal.prepare.simulation import Simulation
from aridcal.prepare.true_things import Real
from aridcal.reading.files import read_file
from aridcal.reading.table_files import FIRST_LINE
from aridcal.showing import SILENT, Progress

AT_ONCE = 20_000
"""Rows that are written at once: less than a second's work between two words of progress."""


def write_campaign(simulation: Simulation, folder: Path, home: Path, progress: Progress = SILENT) -> None:
    """Write the campaign, its measurements, its robot and its truth.

    Args:
        simulation: What to write.
        folder: Where to write it now.
        home: Where it will be; paths in the campaign are relative to that.
        progress: Told how far the work is.
    """
    progress.at("writing the measurements")
    scenario, robot = simulation.scenario, simulation.robot
    keys = scenario.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude={"truth"})
    beside = scenario.path.parent.resolve() == home.resolve()  # the scenario's own paths hold here as well
    if beside:
        keys["robot"]["urdf"] = Path(os.path.relpath(robot.path, home)).as_posix()
    else:
        keys["robot"]["urdf"] = robot.path.name
        (folder / robot.path.name).write_bytes(robot.urdf)
    known, named = scenario.instruments, keys.get("instruments", {})
    for path, part, key in ((known.points, named, "points"), (known.markers.file, named.get("markers", {}), "file")):
        if path is not None:
            part[key] = Path(os.path.relpath(path, home)).as_posix() if beside else path.name
            if not beside:
                (folder / path.name).write_bytes(read_file(path, MeasurementError, scenario.limits.table))
    blocks = [block.model_dump(mode="json", by_alias=True, exclude_unset=True) for block in scenario.blocks]
    for number, (block, table) in enumerate(zip(blocks, simulation.tables, strict=True), start=1):
        block.pop("file", None)
        if scenario.measurements.head is None:
            name = f"measurements_{number}.csv" if scenario.listed else "measurements.csv"
            blocks[number - 1] = {"file": name} | block
            with (folder / name).open("w", encoding="utf-8", newline="") as file:
                for first in progress.through(range(0, len(table), AT_ONCE), len(table), "rows", AT_ONCE):
                    table.iloc[first : first + AT_ONCE].to_csv(file, index=False, header=first == 0)
        else:
            block["head"] = _write_shots(simulation, scenario.measurements.head, folder, home)
    keys["measurements"] = blocks if scenario.listed else blocks[0]
    if keys.get("diagnosis", {}).get("candidates") == list(KINDS):
        keys["diagnosis"]["candidates"] = "all"
    text = yaml.safe_dump(keys, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    first_line = f"# Made by `aridcal simulate {scenario.path.name}`; the truth is in truth.json.\n"
    (folder / "campaign.yaml").write_text(first_line + text, encoding="utf-8")
    truth = json.dumps(truth_document(simulation), indent=2, allow_nan=False)
    (folder / "truth.json").write_text(truth + "\n", encoding="utf-8")


def _write_shots(simulation: Simulation, path: Path, folder: Path, home: Path) -> str:
    """Write shots and images, and the head's own files unless they are there; returns the name of ``head.yaml``."""
    settings = load_settings(path, HeadSettings)
    if path.parent.resolve() != home.resolve():
        keys = settings.model_dump(mode="json", exclude_unset=True, exclude={"robot", "world_base"})
        keys |= {"squares": "squares.csv", "shots": "shots.csv"}
        (folder / path.name).write_text(yaml.safe_dump(keys, sort_keys=False, default_flow_style=None, width=120))
        (folder / "squares.csv").write_bytes(read_file(settings.squares, MeasurementError, settings.limits.table))
        simulation.measurements.to_csv(folder / "shots.csv", index=False)
    else:
        simulation.measurements.to_csv(folder / settings.shots.name, index=False)
    (folder / "images").mkdir()
    for name, image in simulation.images.items():
        (folder / name).write_bytes(image)
    return path.name


def truth_document(simulation: Simulation) -> dict[str, Any]:
    """`truth.json` as plain data: SI, rows as lines of ``measurements.csv``."""
    truth = simulation.scenario.truth
    frames = {}
    for where, frame in simulation.frames.items():
        name = "tip_camera" if simulation.images and where == "tip_target" else where
        rpy = pin.rpy.matrixToRpy(frame.rotation)
        frames[name] = {"xyz": frame.translation.tolist(), "rpy": rpy.tolist()}
    stated = truth.outliers.model_dump() if truth.outliers else {"share": 0.0}
    ends = np.cumsum([len(table) for table in simulation.tables])[:-1]
    wrong = [(np.flatnonzero(part) + FIRST_LINE).tolist() for part in np.split(simulation.outliers, ends)]
    listed = wrong if simulation.scenario.listed else wrong[0]
    things = {"instruments": _things(simulation.real)} if simulation.real else {}
    return {
        "format": 1,
        "n": truth.n,
        "seed": truth.seed,
        "parameters": simulation.parameters,
        "frames": frames,
        "effects": [cause.document() for cause in simulation.causes],
        **things,
        "noise": truth.noise.model_dump(
            exclude=set() if simulation.scenario.refers else {"distance", "pixel", "inclination"}
        ),
        "outliers": {**stated, "rows": listed},
    }


def _things(real: Mapping[str, Real]) -> dict[str, Any]:
    """What rows refer to, by role and name."""
    found: dict[str, Any] = {}
    for role, things in real.items():
        found[role] = {
            name: _thing(role, state.tolist()) for name, state in zip(things.names, things.states, strict=True)
        }
    return found


def _thing(role: str, state: list[float]) -> dict[str, Any]:
    """One of them, in the words of a campaign."""
    if role == "plane":
        return {"normal": state[:3], "offset": state[3]}
    place: dict[str, Any] = {"xyz": state[:3]}
    if role == "anchor":
        return place | {"offset": state[3], "scale": state[4]}
    if role in ("camera", "board"):
        place["rpy"] = pin.rpy.matrixToRpy(np.array(state[3:12]).reshape(3, 3)).tolist()
    if role == "camera":
        place |= dict(zip(INTRINSICS[:4], state[12:16], strict=True)) | {"distortion": state[16:21]}
    return place
