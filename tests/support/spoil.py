"""Sound files of every sort, and ways to spoil them."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import arid_saved
import cv2
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import robots
import yaml

Spoil = Callable[[Path], object]

# ---------------------------------------------------------------- sound files


def write_sound_files(folder: Path) -> None:
    """Everything that the commands read, small and right: a campaign, a calibration, a head, a scenario."""
    rng = np.random.default_rng(0)
    truth = robots.simulate(
        robots.arid(), 30, rng, 1e-3, 1e-4, world=robots.random_placement(rng), tip=robots.random_placement(rng, 0.2)
    )
    robots.write_campaign(folder, truth)
    saved = arid_saved.calibration(text=(folder / "campaign.yaml").read_text())
    (folder / "calibration.yaml").write_text(saved.dump(), encoding="utf-8")
    table = robots.table(truth)
    table[list(truth.model.robot.readings)].to_csv(folder / "query.csv", index=False)
    table.to_csv(folder / "poses.csv", index=False)
    robot = {"urdf": "robot.urdf", "tip": "flange"}
    scenario = {"format": 1, "robot": robot, "truth": {"n": 20, "noise": {"position": 1e-4, "rotation": 1e-4}}}
    write(folder / "scenario.yaml", scenario)
    write(
        folder / "head.yaml",
        {
            "format": 1,
            "camera": {"fx": 80.0, "fy": 80.0, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48},
            "sonars": {"positions": [[-0.05, -0.05, 0], [0.05, -0.05, 0], [0.05, 0.05, 0]], "std": 2.5e-4},
            "tip_camera": {"xyz": [0, 0, 0.1]},
            "squares": "squares.csv",
            "shots": "shots.csv",
        },
    )
    (folder / "squares.csv").write_text("index,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,1,0,0,0,0,0,1\n")
    joints = ",".join(truth.model.robot.readings)
    (folder / "shots.csv").write_text(f"{joints},image,square,h1,h2,h3\n1,1,1,1,0.png,0,0.3,0.3,0.3\n")
    cv2.imwrite(str(folder / "0.png"), np.full((48, 64), 200, np.uint8))
    shooting = {"format": 1, "robot": robot, "measurements": {"kind": "camera_sonar", "head": "head.yaml"}}
    write(folder / "shooting.yaml", shooting)


def write(path: Path, keys: Any) -> None:
    path.write_text(yaml.dump(keys, Dumper=yaml.CSafeDumper, sort_keys=False), encoding="utf-8")


# ---------------------------------------------------------------- ways to spoil them


def together(*spoils: Spoil) -> Spoil:
    return lambda folder: [spoil(folder) for spoil in spoils]


def put(name: str, content: bytes | str) -> Spoil:
    data = content.encode() if isinstance(content, str) else content
    return lambda folder: (folder / name).write_bytes(data)


def edit(name: str, old: str, new: str) -> Spoil:
    """Replace the first match of a pattern, which must be there."""

    def spoil(folder: Path) -> None:
        text, count = re.subn(old, lambda _: new, (folder / name).read_text("utf-8"), count=1, flags=re.DOTALL)
        assert count, f"{old} is not in {name}"
        (folder / name).write_text(text, encoding="utf-8")

    return spoil


def key(name: str, place: str, value: Any) -> Spoil:
    """Set a key of a YAML file, ``frames.world_base.xyz.0`` for instance; its sections are made."""

    def spoil(folder: Path) -> None:
        keys = yaml.load((folder / name).read_text("utf-8"), Loader=yaml.CSafeLoader)
        *sections, last = place.split(".")
        inner = keys
        for part in sections:
            inner = inner[int(part)] if isinstance(inner, list) else inner.setdefault(part, {})
        inner[int(last) if isinstance(inner, list) else last] = value
        write(folder / name, keys)

    return spoil


def without(name: str, place: str) -> Spoil:
    """Delete a key of a YAML file."""

    def spoil(folder: Path) -> None:
        keys = yaml.load((folder / name).read_text("utf-8"), Loader=yaml.CSafeLoader)
        inner = keys
        *sections, last = place.split(".")
        for part in sections:
            inner = inner[int(part)] if isinstance(inner, list) else inner[part]
        del inner[int(last) if isinstance(inner, list) else last]
        write(folder / name, keys)

    return spoil


def cell(name: str, column: str, value: object, every: bool = True) -> Spoil:
    """Put a value into every row of a column of a table, or into the first."""

    def spoil(folder: Path) -> None:
        table = pd.read_csv(folder / name, dtype=object)
        table.loc[slice(None) if every else 0, column] = value
        table.to_csv(folder / name, index=False)

    return spoil


def as_parquet(table: pa.Table, **options: Any) -> Spoil:
    """A parquet file in place of the measurements."""

    def spoil(folder: Path) -> None:
        pq.write_table(table, folder / "m.parquet", **options)
        key("campaign.yaml", "measurements.file", "m.parquet")(folder)

    return spoil


def instead(name: str, make: Callable[[Path], object]) -> Spoil:
    """Something else than a file under a file's name."""

    def spoil(folder: Path) -> None:
        (folder / name).unlink()
        make(folder / name)

    return spoil


def a_socket(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # a socket's name is at most a hundred letters long
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(here)


def nothing(folder: Path) -> None:
    """The arguments alone are wrong."""
