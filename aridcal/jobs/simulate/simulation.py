"""A campaign with a known truth, measured and written."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import yaml
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.catalogue import is_of_head
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.corrections.sights import Sights
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.doty import links_down
from aridcal.engine.robot.kinematics import LEVEL_GRAVITY
from aridcal.files.campaign import DiagnosisSettings, nominal_robot
from aridcal.files.orientations import QUATERNION, column_of
from aridcal.files.quantities import POSITION_COLUMNS
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.head1992.head_settings import HeadSettings, load_squares
from aridcal.jobs.head1992.render import Optics
from aridcal.jobs.simulate.measurements import simulate_measurements, targets
from aridcal.jobs.simulate.scenario import Scenario, Truth, check_scenario, columns_of
from aridcal.jobs.simulate.true_effects import Machine, PreparedEffect, draw_columns, make_causes
from aridcal.jobs.simulate.true_things import RealThings, documents
from aridcal.jobs.simulate.viewpoints import draw_views, photographed, true_head
from aridcal.system.errors import CampaignError, MeasurementError, nearest
from aridcal.system.progress import SILENT, Progress
from aridcal.system.reading.regular_files import read_file
from aridcal.system.reading.table_files import FIRST_LINE

SIMULATED_AT_ONCE = 20_000
"""Rows that are simulated, and written, at once: a second's work between two words of progress."""


@dataclass(frozen=True)
class Simulation:
    """A simulated campaign.

    Attributes:
        scenario: The machine and how it was measured.
        robot: The nominal chain, or several limbs.
        tables: Of each block, as they are written.
        parameters: True value of each constant that the scenario names, drawn or given; [m] or [rad].
        frames: True T_world_base and T_tip_target, or that of each of several targets.
        causes: True effects, drawn or given.
        outliers: Which rows are grossly wrong, shape (N,) bool, those of one block after those of another.
        images: For `kind: camera_sonar`: JPEG files by their names.
        real: Things that the rows refer to, by role.
        model: The machine with its effects, of a tracker without faults; None of other kinds.
        theta: Its true coefficients.
        columns: Of the table beside joints and measurements, what effects depend on.
    """

    scenario: Scenario
    robot: Robot
    tables: tuple[pd.DataFrame, ...]
    parameters: dict[str, float]
    frames: dict[str, pin.SE3]
    causes: tuple[PreparedEffect, ...]
    outliers: np.ndarray
    images: Mapping[str, bytes] = field(default_factory=dict)
    real: Mapping[str, RealThings] = field(default_factory=dict)
    model: Model | None = None
    theta: np.ndarray = field(default_factory=lambda: np.zeros(0))
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def measurements(self) -> pd.DataFrame:
        """The only table, or the first."""
        return self.tables[0]


def simulate(scenario: Scenario, progress: Progress = SILENT) -> Simulation:
    """Measure the machine that a scenario describes.

    The seed fixes everything; constants, configurations, noise, outliers, effects and each column are drawn apart, so
    that more rows, another noise or another effect leave the rest as it is.

    Args:
        scenario: The machine, and how it is measured.
        progress: Told how far the work is.

    Raises:
        AridcalError: the scenario asks for what cannot be simulated.
    """
    check_scenario(scenario)
    truth = scenario.truth
    robot = nominal_robot(scenario)
    constants, configurations, noise, outliers, chance, of_things = _streams(truth.seed)
    coefficients = named_constants(robot, truth.parameters, scenario.path)
    theta = np.array([p.value + p.std * constants.standard_normal() for p in truth.parameters.values()])
    if scenario.refers:
        return _among_things(
            scenario, robot, coefficients, theta, (configurations, noise, outliers, chance, of_things), progress
        )
    head = load_settings(scenario.measurements.head, HeadSettings) if scenario.measurements.head else None
    optics = (
        Optics(head.camera.width, head.camera.height, load_squares(head.squares, head.limits.table)) if head else None
    )
    frames = true_frames(scenario, head)
    world, tip = ((None, frames["world_base"]),), ((None, frames["tip_target"]),)

    if head is None or optics is None:
        readings = draw_readings(robot, truth.n, configurations)
    else:
        nominal = Model(robot, (), world, tip)
        intrinsics, place = head.camera.intrinsics, str(scenario.path)
        readings, _ = draw_views(nominal, optics, intrinsics, truth.n, configurations, place)

    of_arm = [e for e in truth.effects if not is_of_head(e.kind)]
    columns = draw_columns(columns_of(scenario, robot, of_arm), robot, readings, truth.seed)
    around = surroundings(scenario, frames, columns)
    causes, depends = make_causes(of_arm, robot, readings, columns, around, chance, f"{scenario.path}: truth")

    of_effects = tuple(c for cause in causes for c in cause.effect.coefficients)
    model = Model(robot, coefficients + of_effects, world, tip, around)
    theta_true = np.concatenate([theta, *(cause.values for cause in causes)])
    progress.at("moving the robot")
    R, p = _true_poses(model, theta_true, readings, depends, progress)

    images: dict[str, bytes] = {}
    if head is None or optics is None:
        position, rotation, outlier_rows = with_noise(truth, R, p, noise, outliers)
        table = table_of(scenario, robot, readings, columns, position, rotation)
    else:
        real_head, of_head = true_head(scenario, robot, head, chance)
        causes = [*causes, *of_head]
        outlier_rows = np.zeros(truth.n, dtype=bool)
        progress.at("taking the shots")
        shots, images = photographed(head, optics, real_head, R, p, noise, progress)
        joints = dict(zip(robot.readings, readings.T, strict=True))
        table = pd.DataFrame(joints | columns).assign(**shots)
    return Simulation(
        scenario=scenario,
        robot=robot,
        tables=(table,),
        parameters=dict(zip(truth.parameters, theta.tolist(), strict=True)),
        frames=frames,
        causes=tuple(causes),
        outliers=outlier_rows,
        images=images,
        model=model if head is None else None,
        theta=theta_true,
        columns=columns,
    )


def _among_things(
    scenario: Scenario,
    robot: Robot,
    constants: tuple[Coefficient, ...],
    theta: np.ndarray,
    streams: tuple[np.random.Generator, ...],
    progress: Progress,
) -> Simulation:
    """The machine measured with what stands around it; see :func:`simulate`."""
    truth = scenario.truth
    frames = true_frames(scenario)
    machine = Machine(robot, constants, theta, frames["world_base"], targets(scenario, frames["tip_target"]))
    names = columns_of(scenario, robot, truth.effects)
    progress.at("moving the robot")
    result = simulate_measurements(scenario, machine, surroundings(scenario, frames, names), streams)
    tips = {"tip_target": frames["tip_target"]} if len(machine.tips) == 1 else dict(machine.tips)
    return Simulation(
        scenario=scenario,
        robot=robot,
        tables=result.tables,
        parameters=dict(zip(truth.parameters, theta.tolist(), strict=True)),
        frames={"world_base": frames["world_base"], **tips},
        causes=result.causes,
        outliers=np.concatenate(result.outliers),
        real=result.real,
    )


def _true_poses(
    model: Model, theta: np.ndarray, readings: np.ndarray, depends: Mapping[str, np.ndarray], progress: Progress
) -> tuple[np.ndarray, np.ndarray]:
    """True rotations, shape (n, 3, 3), and positions, shape (n, 3), [m], a stretch of rows at a time."""
    R, p = np.empty((len(readings), 3, 3)), np.empty((len(readings), 3))
    for first in progress.through(range(0, len(readings), SIMULATED_AT_ONCE), len(readings), "rows", SIMULATED_AT_ONCE):
        part = slice(first, first + SIMULATED_AT_ONCE)
        R[part], p[part] = model.poses(theta, model.rows(readings[part], {k: v[part] for k, v in depends.items()}))
    return R, p


def _streams(seed: int) -> list[np.random.Generator]:
    """Generators for constants, configurations, noise, outliers, effects and things: more of one leaves the others alone."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(6)]


def with_noise(
    truth: Truth, R: np.ndarray, p: np.ndarray, noise: np.random.Generator, outliers: np.random.Generator
) -> tuple[np.ndarray, Rotation, np.ndarray]:
    """Poses as an instrument measures them: noise in world axes, some rows off by so many sigmas in a random direction.

    Args:
        truth: Says how large the noise is, and how many rows are how far off.
        R: True rotations, shape (n, 3, 3).
        p: True positions, shape (n, 3), [m].
        noise: Draws the noise.
        outliers: Draws which rows are wrong, and in which direction.

    Returns:
        Positions, shape (n, 3), [m]; rotations exp(noise) R; and which rows are wrong, shape (n,) bool.
    """
    outlier_rows = np.zeros(len(p), dtype=bool)
    in_sigmas = noise.standard_normal((len(p), 6))
    if truth.outliers is not None:
        count = round(truth.outliers.share * truth.n)
        outlier_rows[outliers.permutation(truth.n)[:count]] = True
        direction = outliers.standard_normal((truth.n, 2, 3))
        direction /= np.linalg.norm(direction, axis=2, keepdims=True)
        in_sigmas[outlier_rows] += truth.outliers.size * direction[outlier_rows].reshape(-1, 6)
    position = p + truth.noise.position * in_sigmas[:, :3]
    turn = Rotation.from_rotvec(truth.noise.rotation * in_sigmas[:, 3:])
    return position, turn * Rotation.from_matrix(R, assume_valid=True), outlier_rows


def named_constants(robot: Robot, names: Iterable[str], path: Path) -> tuple[Coefficient, ...]:
    """Constants by their names, ``joint_2.pitch`` or ``joint_1.beta`` for instance.

    Args:
        robot: The chain.
        names: A joint of the robot or a limb's last fixed joint, a dot, and ``x y z roll pitch yaw`` or, of a moving
            joint's link, ``d theta beta a alpha``.
        path: The file to name if one of them does not exist.

    Raises:
        CampaignError: naming the constant and the nearest one that exists.
    """
    joints = [*robot.names, *dict.fromkeys(limb.tip_joint for limb in robot.limbs if limb.tip_joint)]
    of_origins = [Coefficient(joint, c) for joint in joints for c in FRAME_COMPONENTS]
    of_links = [Coefficient(link.joint, c) for link in links_down(robot) for c in link.components]
    by_name = {constant.name: constant for constant in (*of_origins, *of_links)}
    for name in names:
        if name not in by_name:
            raise CampaignError(f"{path}: truth.parameters.{name}: there is no such constant{nearest(name, by_name)}")
    return tuple(by_name[name] for name in names)


def true_frames(scenario: Scenario, head: HeadSettings | None = None) -> dict[str, pin.SE3]:
    """T_world_base and T_tip_target of the simulated machine.

    Args:
        scenario: Its truth, and the campaign's own frames where the truth says nothing.
        head: With a measuring head, the camera is the target.
    """
    truth, stated = scenario.truth.frames, scenario.frames
    base = truth.world_base or stated.world_base
    target = (truth.tip_target or stated.tip_target) if head is None else (truth.tip_camera or head.tip_camera)
    frames = {}
    for name, frame in (("world_base", base), ("tip_target", target)):
        rotation = pin.rpy.rpyToMatrix(*frame.rpy)
        frames[name] = pin.SE3(rotation, np.array(frame.xyz))
    return frames


def surroundings(scenario: Scenario, frames: Mapping[str, pin.SE3], columns: Collection[str]) -> Surroundings:
    """Gravity in the base's frame, and the payloads' places, which count where they have columns."""
    gravity = scenario.robot.gravity
    R_world_base = frames["world_base"].rotation
    vector = R_world_base.T @ LEVEL_GRAVITY if gravity == "world" else np.array(gravity)
    target = frames["tip_target"].translation
    payloads = scenario.question.payloads or (Payload(target),)
    return Surroundings(vector, payloads, payloads[0].name in columns, Sights(target[None]))


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
    keys = scenario.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude={"truth", "study"})
    beside = scenario.path.parent.resolve() == home.resolve()  # the scenario's own paths hold here as well
    if beside:
        keys["robot"]["urdf"] = Path(os.path.relpath(scenario.robot.urdf, home)).as_posix()
    else:
        keys["robot"].pop("arguments", None)  # they are in the URDF that is written
        keys["robot"]["urdf"] = robot.path.name
        (folder / robot.path.name).write_bytes(robot.urdf if robot.mjcf is None else robot.mjcf)
    for name, place in scenario.robot.packages.items():
        keys["robot"]["packages"][name] = Path(os.path.relpath(place, home)).as_posix()
    instruments, entry = scenario.instruments, keys.get("instruments", {})
    if "points" in entry and set(entry["points"]) == {"file"}:
        entry["points"] = entry["points"]["file"]
    if len(entry.get("markers", ())) == 1:
        entry["markers"] = entry["markers"][0]
    boards = entry.get("markers", {})
    parts = [(instruments.points.file, entry if isinstance(entry.get("points"), str) else entry.get("points", {}))]
    files = (board.file for board in instruments.markers)
    parts += zip(files, boards if isinstance(boards, list) else [boards], strict=True)
    for (path, part), key in zip(parts, ["points" if part is entry else "file" for _, part in parts], strict=True):
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
                for first in progress.through(
                    range(0, len(table), SIMULATED_AT_ONCE), len(table), "rows", SIMULATED_AT_ONCE
                ):
                    table.iloc[first : first + SIMULATED_AT_ONCE].to_csv(file, index=False, header=first == 0)
        else:
            block["head"] = _write_shots(simulation, scenario.measurements.head, folder, home)
    keys["measurements"] = blocks if scenario.listed else blocks[0]
    if keys.get("diagnosis", {}).get("candidates") == list(DiagnosisSettings().candidates):
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
    things = {"instruments": documents(simulation.real)} if simulation.real else {}
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


def table_of(
    scenario: Scenario,
    robot: Robot,
    readings: np.ndarray,
    covariates: Mapping[str, np.ndarray],
    position: np.ndarray,
    rotation: Rotation,
) -> pd.DataFrame:
    """The table of measurements, columns named as the campaign names them."""
    settings = scenario.measurements
    joints = dict(zip(robot.readings, readings.T, strict=True))
    quantities = dict(zip(POSITION_COLUMNS, position.T, strict=True))
    if settings.traits.oriented:
        quantities |= dict(zip(QUATERNION, rotation.as_quat(canonical=True).T, strict=True))
    quantities |= covariates
    columns = [settings.columns.get(name, name) for name in joints]
    columns += [column_of(name, settings, joints) for name in quantities]
    repeated = sorted({name for name in columns if columns.count(name) > 1})
    if repeated:
        raise CampaignError(f"{scenario.path}: two columns would be called {repeated[0]!r}: add `measurements.columns`")
    values = (*joints.values(), *quantities.values())
    return pd.DataFrame(dict(zip(columns, values, strict=True)))
