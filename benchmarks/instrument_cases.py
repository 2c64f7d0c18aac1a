"""Simulated campaigns of every kind of measurement, read back as a user's would be, and what is true of them."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from random_robots import draw_robot
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.instruments.channels import spread
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.read import load_measurements
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import Simulation, simulate, write_campaign
from aridcal.jobs.simulate.true_things import documents

TOP = Path(__file__).resolve().parents[1]
EYE = {"fx": 700, "fy": 700, "cx": 320, "cy": 240, "width": 640, "height": 480}
NOISE = {"position": 1e-4, "rotation": 1e-4, "distance": 1e-4, "pixel": 0.2, "inclination": 3e-4}
CHANNELS = {
    "pose": ("position", "rotation"), "position": ("position",), "point": ("position",), "distance": ("distance",),
    "plane": ("distance",), "pixels": ("pixel",), "inclination": ("inclination",),
}  # fmt: skip
OFF = 1e-3
"""1-sigma of all true constants, [m] and [rad]."""

GRID = [(0.04 * (k % 6 - 2.5), 0.04 * (k // 6 - 1.5)) for k in range(24)]
BOARD = "marker,x,y,z\n" + "".join(f"{k},{x:.3f},{y:.3f},0\n" for k, (x, y) in enumerate(GRID))

# Name here: kind, and what the campaign knows of the instruments.
WAYS: dict[str, tuple[str, dict[str, Any]]] = {
    "pose": ("pose", {}),
    "position": ("position", {}),
    "point": ("point", {}),
    "point and length": ("point", {"lengths": [{"between": ["a", "b"], "length": 0.3, "std": 1e-5}]}),
    "distance": ("distance", {}),
    "plane": ("plane", {}),
    "eye in hand": ("pixels", {"cameras": {"eye": EYE}}),
    "eye in hand, board": ("pixels", {"cameras": {"eye": EYE}, "markers": {"file": "markers.csv"}}),
    "eye to hand": ("pixels", {"cameras": {"eye": EYE | {"on": "world"}}}),
    "eye to hand, board": ("pixels", {"cameras": {"eye": EYE | {"on": "world"}}, "markers": {"file": "markers.csv"}}),
    "inclination": ("inclination", {}),
}
ARMS = ("six", "seven", "arid")
ROWS, IMAGES, QUERIES = 120, 30, 100


@dataclass(frozen=True)
class Made:
    """One campaign.

    Attributes:
        simulation: The machine, and what it was measured with.
        campaign: As a user has it.
        robot: The nominal chain.
        rows: As read, train and test.
        sigma: True noise of each channel, shape (C,).
        keys: Of the scenario.
    """

    simulation: Simulation
    campaign: Campaign
    robot: Robot
    rows: Dataset
    sigma: np.ndarray
    keys: dict[str, Any]

    @property
    def train(self) -> Dataset:
        """Training rows."""
        return self.rows.select(self.rows.train)


def arm(family: str, seed: int) -> tuple[Robot, np.ndarray]:
    """A robot of a family, and gravity in its base's frame."""
    if family == "arid":
        return load_robot(TOP / "urdf" / "arid.urdf", "flange"), np.array([0.0, 9.81, 0.0])
    return draw_robot(family, np.random.default_rng([seed, 11]))


def scenario(
    way: str, family: str, seed: int, n: int, effects: Sequence[Mapping[str, Any]] = (), attitude: bool = False
) -> tuple[dict[str, Any], Robot]:
    """Keys of a scenario, without noise, and its robot.

    Args:
        way: Key of :data:`WAYS`.
        family: Of the robot.
        seed: Fixes everything.
        n: Rows, or images.
        effects: That are true.
        attitude: True for a tool, a world and a camera that are turned anyhow.
    """
    robot, gravity = arm(family, seed)
    rng = np.random.default_rng([seed, 12])
    kind, known = WAYS[way]
    known = json.loads(json.dumps(known))

    def place(reach: float, turn: float) -> dict[str, list[float]]:
        R = Rotation.random(rng=rng) if attitude else Rotation.from_rotvec(rng.uniform(-turn, turn, 3))
        rpy = pin.rpy.matrixToRpy(R.as_matrix())
        return {"xyz": rng.uniform(-reach, reach, 3).tolist(), "rpy": rpy.tolist()}

    frames = {"world_base": place(1.0, 1.0), "tip_target": place(0.15, 0.5)}
    things: dict[str, Any] = {}
    for name, camera in known.get("cameras", {}).items():
        if camera.get("on", "tip") == "tip":
            things["cameras"] = {name: place(0.08, 0.3)}
        elif "markers" in known:
            things["board"] = place(0.08, 0.3)
    return {
        "format": 1,
        "robot": {"urdf": "robot.urdf", "tip": robot.tip, "gravity": gravity.tolist()},
        "measurements": {"kind": kind, "noise": {name: NOISE[name] for name in CHANNELS[kind]}},
        **({"instruments": known} if known else {}),
        "truth": {
            "n": n,
            "seed": seed,
            "parameters": {c.name: {"std": OFF} for c in constants(robot, "full")},
            "frames": frames,
            "instruments": things,
            "effects": list(effects),
            "covariates": ["time", "temperature"],
        },
    }, robot  # fmt: skip


def noisy(keys: Mapping[str, Any]) -> dict[str, Any]:
    """The same scenario with noise."""
    kinds = keys["measurements"] if isinstance(keys["measurements"], list) else [keys["measurements"]]
    noise = {name: NOISE[name] for block in kinds for name in CHANNELS[block["kind"]]}
    return {**keys, "truth": {**keys["truth"], "noise": noise}}


def made(keys: Mapping[str, Any], robot: Robot) -> Made:
    """Simulate a scenario and read its campaign."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "robot.urdf").write_bytes(robot.urdf)
        (folder / "markers.csv").write_text(BOARD)
        text = json.loads(json.dumps(keys))
        if not text["truth"]["instruments"]:
            text["truth"].pop("instruments")
        (folder / "scenario.yaml").write_text(json.dumps(text))
        simulation = simulate(load_settings(folder / "scenario.yaml", Scenario))
        write_campaign(simulation, folder, folder)
        campaign = load_campaign(folder / "campaign.yaml")
        limits = robot.limits
        rows = load_measurements(campaign, robot.readings, limits, robot.kinds)
    sigma = np.array([NOISE[channel.name.split("_")[-1]] for channel in rows.channels])
    return Made(simulation, campaign, simulation.robot, rows, sigma, dict(keys))


def elsewhere(one: Made, n: int) -> Made:
    """The same machine among the same things without noise, where it was never measured."""
    simulation, truth = one.simulation, one.keys["truth"]
    stated = documents(simulation.real)
    things: dict[str, Any] = {}
    for role, key in (("point", "points"), ("anchor", "anchors"), ("plane", "planes"), ("camera", "cameras")):
        if role in stated:
            things[key] = {name: value["xyz"] if role == "point" else value for name, value in stated[role].items()}
    if "marker" in stated and "markers" in one.keys.get("instruments", {}):
        things["board"] = next(iter(stated["board"].values()))
    elif "marker" in stated:
        things["markers"] = {name: value["xyz"] for name, value in stated["marker"].items()}
    effects = [
        {**e, "coefficients": cause.values.tolist()}
        for e, cause in zip(truth["effects"], simulation.causes, strict=True)
    ]
    other = {**truth, "n": n, "seed": truth["seed"] + 500_000, "parameters": simulation.parameters}
    other |= {"instruments": things, "effects": effects, "noise": {}}
    return made({**one.keys, "truth": other}, one.robot)


def rows_of(way: str) -> int:
    """Rows of an ordinary campaign, or images."""
    return IMAGES if WAYS[way][0] == "pixels" else ROWS


def geometric(one: Made) -> Fit:
    """Constants of the training rows."""
    return fit_geometry(one.campaign.question, one.robot, one.train, ()).geometric


def error_of(found: Fit, new: Made) -> float:
    """RMS per number on exact rows that were never measured, in sigma."""
    off = problem(found.model, new.rows).residual(found.theta) / spread(new.sigma, new.rows.channels)
    return float(np.sqrt(np.nanmean(off**2)))
