"""Make a campaign whose truth is known: a scenario in; measurements of an imperfect robot and their truth out.

What a scenario's `truth.effects` may hold is told in docs/simulate.md.

Example:
    aridcal simulate identification/arid/scenario.yaml -o /tmp/arid
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import pinocchio as pin
import yaml
from pydantic import BeforeValidator, Field
from rich.console import Console
from scipy.spatial.transform import Rotation

from aridcal.campaign import EFFECT_KINDS, HEAD_KINDS, Job
from aridcal.causes import Cause, Parameter, TrueEffect, columns_needed, draw_columns, given, make_causes, values
from aridcal.commands import CommandParser, atomic_folder, check_writable, command_parser, run
from aridcal.doty import doty_links
from aridcal.effects import FRAME_COMPONENTS, Coefficient, Surroundings
from aridcal.errors import CampaignError, OutputError, nearest
from aridcal.head.photograph import Optics
from aridcal.head.reduction import Head
from aridcal.head.settings import HeadSettings
from aridcal.head.shots import load_squares, range_columns
from aridcal.instrument import directions, stated
from aridcal.model import Model
from aridcal.robot import Robot, load_robot
from aridcal.settings import Section, Vector3, load_settings
from aridcal.shooting import draw_views, photographs


class TrueFrame(Section):
    """A frame as it is; [m] and [rad]."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)


class TrueFrames(Section):
    """T_world_base and T_tip_target as they are; what is absent is as the campaign's own `frames` have it."""

    world_base: TrueFrame | None = None
    tip_target: TrueFrame | None = None
    tip_camera: TrueFrame | None = None
    """In place of ``tip_target`` for `kind: camera_sonar`; what is absent is as head.yaml has it."""


class TrueNoise(Section):
    """1-sigma of the measurements per axis, whatever the campaign declares."""

    position: float = Field(default=0.0, ge=0)
    """[m]"""
    rotation: float = Field(default=0.0, ge=0)
    """[rad]"""


class Outliers(Section):
    """Rows that are grossly wrong."""

    share: float = Field(ge=0, le=1)
    size: float = Field(gt=0)
    """How far off, in sigmas of the noise, in a random direction; position and rotation alike."""


class Truth(Section):
    """What the simulated machine and its measurements are really like."""

    parameters: dict[str, Annotated[Parameter, BeforeValidator(given)]] = Field(default_factory=dict)
    frames: TrueFrames = TrueFrames()
    effects: tuple[TrueEffect, ...] = ()
    covariates: tuple[str, ...] = ()
    """Columns to write beside those that the effects depend on."""
    noise: TrueNoise = TrueNoise()
    outliers: Outliers | None = None
    n: int = Field(ge=1, le=10_000_000)
    seed: int = Field(default=0, ge=0)


class Scenario(Job):
    """A campaign's keys and the truth behind it."""

    truth: Truth


@dataclass(frozen=True)
class Simulation:
    """A simulated campaign.

    Attributes:
        scenario: What was asked for.
        robot: The nominal chain.
        measurements: The table, as it is written.
        parameters: True value of each constant that the scenario names, drawn or given; [m] or [rad].
        frames: True T_world_base and T_tip_target.
        causes: True effects, drawn or given.
        outliers: Which rows are grossly wrong, shape (N,) bool.
        images: For `kind: camera_sonar`: JPEG files by their names.
    """

    scenario: Scenario
    robot: Robot
    measurements: pd.DataFrame
    parameters: dict[str, float]
    frames: dict[str, pin.SE3]
    causes: tuple[Cause, ...]
    outliers: np.ndarray
    images: Mapping[str, bytes] = field(default_factory=dict)


def simulate(scenario: Scenario) -> Simulation:
    """Measure the machine that a scenario describes.

    The seed fixes everything; constants, configurations, noise, outliers, effects and each column are drawn apart, so
    that more rows, another noise or another effect leave the rest as it is.

    Raises:
        AridcalError: the scenario asks for what cannot be simulated.
    """
    _check(scenario)
    truth = scenario.truth
    robot = load_robot(scenario.robot.urdf, scenario.robot.tip, scenario.robot.base)
    constants, configurations, noise, outliers, chance = (
        np.random.default_rng(s) for s in np.random.SeedSequence(truth.seed).spawn(5)
    )
    coefficients = named_constants(robot, truth.parameters, scenario.path)
    theta = np.array([p.value + p.std * constants.standard_normal() for p in truth.parameters.values()])
    head = load_settings(scenario.measurements.head, HeadSettings) if scenario.measurements.head else None
    frames = true_frames(scenario, head)
    if head is None:
        readings = draw_readings(robot, truth.n, configurations)
    else:
        optics = Optics(head.camera.width, head.camera.height, load_squares(head.squares))
        nominal = Model(robot, (), ((None, frames["world_base"]),), ((None, frames["tip_target"]),))
        place = str(scenario.path)
        readings, square = draw_views(nominal, optics, head.camera.intrinsics, truth.n, configurations, place)

    around = surroundings(scenario, frames)
    of_arm = [e for e in truth.effects if e.kind not in HEAD_KINDS]
    names = dict.fromkeys((*truth.covariates, *columns_needed(of_arm, robot)))
    columns = draw_columns(tuple(names), robot, readings, truth.seed)
    causes, depends = make_causes(of_arm, robot, readings, columns, around, chance, f"{scenario.path}: truth")
    coefficients += tuple(c for cause in causes for c in cause.effect.coefficients)
    true = np.concatenate([theta, *(cause.values for cause in causes)])
    model = Model(robot, coefficients, ((None, frames["world_base"]),), ((None, frames["tip_target"]),), around)
    R, p = model.poses(true, model.rows(readings, depends))
    parameters = dict(zip(truth.parameters, theta.tolist(), strict=True))
    if head is not None:
        T = np.broadcast_to(np.eye(4), (truth.n, 4, 4)).copy()
        T[:, :3, :3], T[:, :3, 3] = R, p
        real, of_head = true_head(scenario, head, chance)
        # The arm is not quite where it was sent: another square may be nearest the optical axis.
        square = np.array([optics.nearest(pose) for pose in T])
        taken, h = photographs(T, square, optics, real, noise)
        images = {f"images/{k + 1:03d}.jpg": image for k, image in enumerate(taken)}
        table = pd.DataFrame(dict(zip(robot.readings, readings.T, strict=True)) | columns)
        table = table.assign(image=list(images), square=square, **dict(zip(range_columns(head), h.T, strict=True)))
        nothing = np.zeros(truth.n, dtype=bool)
        return Simulation(scenario, robot, table, parameters, frames, (*causes, *of_head), nothing, images)
    wrong = np.zeros(truth.n, dtype=bool)
    error = noise.standard_normal((truth.n, 6))
    if truth.outliers is not None:
        wrong[outliers.permutation(truth.n)[: round(truth.outliers.share * truth.n)]] = True
        direction = outliers.standard_normal((truth.n, 2, 3))
        direction /= np.linalg.norm(direction, axis=2, keepdims=True)
        error[wrong] += truth.outliers.size * direction[wrong].reshape(-1, 6)
    position = p + truth.noise.position * error[:, :3]
    rotation = Rotation.from_rotvec(truth.noise.rotation * error[:, 3:]) * Rotation.from_matrix(R, assume_valid=True)
    return Simulation(
        scenario=scenario,
        robot=robot,
        measurements=_table(scenario, robot, readings, columns, position, rotation),
        parameters=parameters,
        frames=frames,
        causes=tuple(causes),
        outliers=wrong,
    )


def named_constants(robot: Robot, names: Iterable[str], path: Path) -> tuple[Coefficient, ...]:
    """Constants by their names, ``joint_2.pitch`` or ``joint_1.beta`` for instance.

    Args:
        robot: The chain.
        names: A joint of the chain or the tip's fixed joint, a dot, and ``x y z roll pitch yaw`` or, of a moving
            joint's link, ``d theta beta a alpha``.
        path: The file to name if one of them does not exist.

    Raises:
        CampaignError: naming the constant and the nearest one that exists.
    """
    joints = [*robot.names, *([robot.tip_joint] if robot.tip_joint else [])]
    known = [Coefficient(j, c) for j in joints for c in FRAME_COMPONENTS]
    known += [Coefficient(link.joint, c) for link in doty_links(robot) for c in link.components]
    by_name = {c.name: c for c in known}
    for name in names:
        if name not in by_name:
            raise CampaignError(f"{path}: truth.parameters.{name}: there is no such constant{nearest(name, by_name)}")
    return tuple(by_name[name] for name in names)


def true_frames(scenario: Scenario, head: HeadSettings | None = None) -> dict[str, pin.SE3]:
    """T_world_base and T_tip_target of the simulated machine; with a measuring head, its camera is the target."""
    truth, given = scenario.truth.frames, scenario.frames
    base = truth.world_base or given.world_base
    target = truth.tip_target or given.tip_target if head is None else truth.tip_camera or head.tip_camera
    pairs = (("world_base", base), ("tip_target", target))
    return {name: pin.SE3(pin.rpy.rpyToMatrix(*frame.rpy), np.array(frame.xyz)) for name, frame in pairs}


def true_head(scenario: Scenario, settings: HeadSettings, rng: np.random.Generator) -> tuple[Head, list[Cause]]:
    """The measuring head as it really is, and its effects."""
    head, place = Head.of(settings), f"{scenario.path}: truth"
    phi, causes = head.phi, []
    wanted = [e for e in scenario.truth.effects if e.kind in HEAD_KINDS]
    for e, effect in zip(wanted, stated(head, wanted, place), strict=True):
        causes.append(Cause(effect, values(e, effect, rng, place), {}))
        phi = phi + directions(head, effect.coefficients) @ causes[-1].values
    return replace(head, phi=phi), causes


def surroundings(scenario: Scenario, frames: Mapping[str, pin.SE3]) -> Surroundings:
    """Gravity in the base's frame, and the payload's place."""
    gravity = scenario.robot.gravity
    vector = frames["world_base"].rotation.T @ [0.0, 0.0, -9.81] if gravity == "world" else np.array(gravity)
    return Surroundings(vector, frames["tip_target"].translation)


def draw_readings(robot: Robot, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draw readings, uniform inside their limits, shape (n, columns), [rad] or [m]; +-pi where there is no limit."""
    limits = {joint.reading: (joint.lower, joint.upper) for joint in robot.joints}
    low, high = np.array([limits[reading] for reading in robot.readings]).T
    low = np.where(np.isfinite(low), low, -math.pi)
    high = np.where(np.isfinite(high), high, math.pi)
    return np.asarray(rng.uniform(low, high, (n, len(low))))


def write_campaign(simulation: Simulation, folder: Path, home: Path) -> None:
    """Write the campaign, its measurements, its robot and its truth.

    Args:
        simulation: What to write.
        folder: Where to write it now.
        home: Where it will be; paths in the campaign are relative to that.
    """
    scenario, robot = simulation.scenario, simulation.robot
    keys = scenario.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude={"truth"})
    if scenario.path.parent.resolve() == home.resolve():  # the scenario's own path to the robot holds here as well
        keys["robot"]["urdf"] = Path(os.path.relpath(robot.path, home)).as_posix()
    else:
        keys["robot"]["urdf"] = robot.path.name
        (folder / robot.path.name).write_bytes(robot.urdf)
    keys.setdefault("measurements", {}).pop("file", None)
    if scenario.measurements.head is None:
        keys["measurements"] = {"file": "measurements.csv"} | keys["measurements"]
        simulation.measurements.to_csv(folder / "measurements.csv", index=False)
    else:
        keys["measurements"]["head"] = _write_shots(simulation, scenario.measurements.head, folder, home)
    if keys.get("diagnosis", {}).get("candidates") == list(EFFECT_KINDS):
        keys["diagnosis"]["candidates"] = "all"
    text = yaml.safe_dump(keys, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    made = f"# Made by `aridcal simulate {scenario.path.name}`; the truth is in truth.json.\n"
    (folder / "campaign.yaml").write_text(made + text, encoding="utf-8")
    truth = json.dumps(truth_document(simulation), indent=2, allow_nan=False)
    (folder / "truth.json").write_text(truth + "\n", encoding="utf-8")


def _write_shots(simulation: Simulation, path: Path, folder: Path, home: Path) -> str:
    """Write shots and images, and the head's own files unless they are there; returns the name of ``head.yaml``."""
    settings = load_settings(path, HeadSettings)
    if path.parent.resolve() != home.resolve():
        keys = settings.model_dump(mode="json", exclude_unset=True, exclude={"robot", "world_base"})
        keys |= {"squares": "squares.csv", "shots": "shots.csv"}
        (folder / path.name).write_text(yaml.safe_dump(keys, sort_keys=False, default_flow_style=None, width=120))
        (folder / "squares.csv").write_bytes(settings.squares.read_bytes())
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
    return {
        "format": 1,
        "n": truth.n,
        "seed": truth.seed,
        "parameters": simulation.parameters,
        "frames": {
            "tip_camera" if simulation.images and where == "tip_target" else where: {
                "xyz": frame.translation.tolist(),
                "rpy": pin.rpy.matrixToRpy(frame.rotation).tolist(),
            }
            for where, frame in simulation.frames.items()
        },
        "effects": [cause.document() for cause in simulation.causes],
        "noise": truth.noise.model_dump(),
        "outliers": {
            **(truth.outliers.model_dump() if truth.outliers else {"share": 0.0}),
            "rows": (np.flatnonzero(simulation.outliers) + 2).tolist(),
        },
    }


def _check(scenario: Scenario) -> None:
    """Refuse what a campaign may ask for but a simulation cannot give."""
    measurements, truth = scenario.measurements, scenario.truth
    refused = {
        "measurements.head": (
            measurements.kind == "camera_sonar" and measurements.head is None,
            "`kind: camera_sonar` needs it: `head: head.yaml`",
        ),
        "truth.noise": (
            measurements.head is not None and (truth.noise != TrueNoise() or truth.outliers is not None),
            "with `kind: camera_sonar` the noise is that of images and sonars; delete this key and `outliers`",
        ),
        "truth.effects": (
            measurements.head is None and any(e.kind in HEAD_KINDS for e in truth.effects),
            f"{', '.join(HEAD_KINDS)} need `kind: camera_sonar`",
        ),
        "measurements.units": ("units" in measurements.model_fields_set, "the table is written in SI; delete this key"),
        "measurements.orientation": (
            "orientation" in measurements.model_fields_set,
            "the table is written with quaternions; delete this key",
        ),
        "frames": (
            "station" in (scenario.frames.world_base.per, scenario.frames.tip_target.per),
            "stations are not simulated; delete `per: station`",
        ),
    }
    for key, (asked, why) in refused.items():
        if asked:
            raise CampaignError(f"{scenario.path}: {key}: {why}")
    if truth.outliers is not None and truth.noise == TrueNoise():
        raise CampaignError(
            f"{scenario.path}: truth.outliers.size is in sigmas: `truth.noise` must say how much that is"
        )


def _table(
    scenario: Scenario,
    robot: Robot,
    readings: np.ndarray,
    covariates: Mapping[str, np.ndarray],
    position: np.ndarray,
    rotation: Rotation,
) -> pd.DataFrame:
    """The table of measurements, columns named as the campaign names them."""
    values = dict(zip(robot.readings, readings.T, strict=True))
    measured = dict(zip("xyz", position.T, strict=True))
    if scenario.measurements.kind == "pose":
        measured |= dict(zip(("qx", "qy", "qz", "qw"), rotation.as_quat(canonical=True).T, strict=True))
    measured |= covariates
    renamed = scenario.measurements.columns
    columns = [renamed.get(name, name) for name in values]
    # Where a joint has a quantity's name, `columns` speaks of the joint.
    columns += [name if name in values else renamed.get(name, name) for name in measured]
    twice = sorted({c for c in columns if columns.count(c) > 1})
    if twice:
        raise CampaignError(f"{scenario.path}: two columns would be called {twice[0]!r}: add `measurements.columns`")
    return pd.DataFrame(dict(zip(columns, (*values.values(), *measured.values()), strict=True)))


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("simulate", __doc__)
    arguments.add_argument("scenario", type=Path, help="scenario.yaml: a campaign's keys and `truth`")
    arguments.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder of the campaign")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments.scenario, arguments.out))


def _main(path: Path, out: Path) -> None:
    check_writable(out, "folder")
    if (out / "campaign.yaml").resolve() == path.resolve():
        raise OutputError(f"{path}: the campaign would overwrite its scenario; rename it or choose another folder")
    simulation = simulate(load_settings(path, Scenario))
    with atomic_folder(out) as folder:
        write_campaign(simulation, folder, out)
    rows, wrong = len(simulation.outliers), int(simulation.outliers.sum())
    console = Console()
    console.print(f"{out}: {rows} rows, {wrong} of them outliers; the truth is in truth.json", soft_wrap=True)
    console.print(f"next: aridcal identify {out / 'campaign.yaml'}", soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
