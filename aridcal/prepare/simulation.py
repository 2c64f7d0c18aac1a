"""A campaign with a known truth, measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.effects.catalogue import is_of_head
from aridcal.effects.effect import FRAME_COMPONENTS, Coefficient
from aridcal.effects.loads import Surroundings
from aridcal.errors import CampaignError, nearest
from aridcal.head.reduction import Head
from aridcal.head.render import Optics
from aridcal.inputs.head_settings import HeadSettings, load_squares, range_columns
from aridcal.inputs.quantities import POSITION, QUATERNION, column_of
from aridcal.inputs.yaml_file import load_settings
from aridcal.model.model import Model
from aridcal.prepare.measuring import Machine, measured, targets
from aridcal.prepare.postures import draw_readings
from aridcal.prepare.scenario import Scenario, Truth, check_scenario
from aridcal.prepare.true_effects import Cause, columns_needed, draw_columns, make_causes, values
from aridcal.prepare.true_things import Real
from aridcal.prepare.viewpoints import draw_views, photographs
from aridcal.robot.chain import Robot, load_robot
from aridcal.robot.doty import doty_links
from aridcal.search.head_effects import directions, stated
from aridcal.showing import SILENT, Progress

AT_ONCE = 20_000
"""Rows that are simulated at once: a second's work between two words of progress."""


@dataclass(frozen=True)
class Simulation:
    """A simulated campaign.

    Attributes:
        scenario: What was asked for.
        robot: The nominal chain.
        tables: Of each block, as they are written.
        parameters: True value of each constant that the scenario names, drawn or given; [m] or [rad].
        frames: True T_world_base and T_tip_target, or that of each of several targets.
        causes: True effects, drawn or given.
        outliers: Which rows are grossly wrong, shape (N,) bool, those of one block after those of another.
        images: For `kind: camera_sonar`: JPEG files by their names.
        real: What the rows refer to, by role.
    """

    scenario: Scenario
    robot: Robot
    tables: tuple[pd.DataFrame, ...]
    parameters: dict[str, float]
    frames: dict[str, pin.SE3]
    causes: tuple[Cause, ...]
    outliers: np.ndarray
    images: Mapping[str, bytes] = field(default_factory=dict)
    real: Mapping[str, Real] = field(default_factory=dict)

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
    robot = load_robot(scenario.robot.urdf, scenario.robot.tip, scenario.robot.base, scenario.limits.urdf)
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
    names = dict.fromkeys((*truth.covariates, *columns_needed(of_arm, robot)))
    columns = draw_columns(tuple(names), robot, readings, truth.seed)
    around = surroundings(scenario, frames, "payload" in columns)
    causes, depends = make_causes(of_arm, robot, readings, columns, around, chance, f"{scenario.path}: truth")

    of_effects = tuple(c for cause in causes for c in cause.effect.coefficients)
    model = Model(robot, coefficients + of_effects, world, tip, around)
    true = np.concatenate([theta, *(cause.values for cause in causes)])
    progress.at("moving the robot")
    R, p = _moved(model, true, readings, depends, progress)

    images: dict[str, bytes] = {}
    if head is None or optics is None:
        position, rotation, wrong = _measured(truth, R, p, noise, outliers)
        table = _table(scenario, robot, readings, columns, position, rotation)
    else:
        real, of_head = true_head(scenario, head, chance)
        causes = [*causes, *of_head]
        wrong = np.zeros(truth.n, dtype=bool)
        progress.at("taking the shots")
        shots, images = _photographed(head, optics, real, R, p, noise, progress)
        joints = dict(zip(robot.readings, readings.T, strict=True))
        table = pd.DataFrame(joints | columns).assign(**shots)
    return Simulation(
        scenario=scenario,
        robot=robot,
        tables=(table,),
        parameters=dict(zip(truth.parameters, theta.tolist(), strict=True)),
        frames=frames,
        causes=tuple(causes),
        outliers=wrong,
        images=images,
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
    names = (*truth.covariates, *columns_needed(truth.effects, robot))
    progress.at("moving the robot")
    found = measured(scenario, machine, surroundings(scenario, frames, "payload" in names), streams)
    tips = {"tip_target": frames["tip_target"]} if len(machine.tips) == 1 else dict(machine.tips)
    return Simulation(
        scenario=scenario,
        robot=robot,
        tables=found.tables,
        parameters=dict(zip(truth.parameters, theta.tolist(), strict=True)),
        frames={"world_base": frames["world_base"], **tips},
        causes=found.causes,
        outliers=np.concatenate(found.outliers),
        real=found.real,
    )


def _moved(
    model: Model, theta: np.ndarray, readings: np.ndarray, depends: Mapping[str, np.ndarray], progress: Progress
) -> tuple[np.ndarray, np.ndarray]:
    """True rotations, shape (n, 3, 3), and positions, shape (n, 3), [m], a stretch of rows at a time."""
    R, p = np.empty((len(readings), 3, 3)), np.empty((len(readings), 3))
    for first in progress.through(range(0, len(readings), AT_ONCE), len(readings), "rows", AT_ONCE):
        part = slice(first, first + AT_ONCE)
        R[part], p[part] = model.poses(theta, model.rows(readings[part], {k: v[part] for k, v in depends.items()}))
    return R, p


def _streams(seed: int) -> list[np.random.Generator]:
    """Generators for constants, configurations, noise, outliers, effects and things: more of one leaves the others alone."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(6)]


def _measured(
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
    wrong = np.zeros(truth.n, dtype=bool)
    in_sigmas = noise.standard_normal((truth.n, 6))
    if truth.outliers is not None:
        count = round(truth.outliers.share * truth.n)
        wrong[outliers.permutation(truth.n)[:count]] = True
        direction = outliers.standard_normal((truth.n, 2, 3))
        direction /= np.linalg.norm(direction, axis=2, keepdims=True)
        in_sigmas[wrong] += truth.outliers.size * direction[wrong].reshape(-1, 6)
    position = p + truth.noise.position * in_sigmas[:, :3]
    turn = Rotation.from_rotvec(truth.noise.rotation * in_sigmas[:, 3:])
    return position, turn * Rotation.from_matrix(R, assume_valid=True), wrong


def _photographed(
    settings: HeadSettings,
    optics: Optics,
    real: Head,
    R: np.ndarray,
    p: np.ndarray,
    noise: np.random.Generator,
    progress: Progress,
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Shots of the measuring head: columns of ``shots.csv`` beside joints and covariates, and the images by name.

    Args:
        settings: The head as its makers state it.
        optics: The camera and the squares that it looks at.
        real: The head as it is.
        R: True rotations of the camera, shape (n, 3, 3).
        p: True positions, shape (n, 3), [m].
        noise: Draws the noise of images and sonars.
        progress: Told how many shots are taken.
    """
    T = np.broadcast_to(np.eye(4), (len(R), 4, 4)).copy()
    T[:, :3, :3], T[:, :3, 3] = R, p
    # The arm is not quite where it was sent: another square may be nearest the optical axis.
    square = np.array([optics.nearest(pose) for pose in T])
    taken, ranges = photographs(T, square, optics, real, noise, progress)
    images = {f"images/{k + 1:03d}.jpg": image for k, image in enumerate(taken)}
    columns = dict(zip(range_columns(settings), ranges.T, strict=True))
    return {"image": list(images), "square": square, **columns}, images


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
    of_origins = [Coefficient(joint, c) for joint in joints for c in FRAME_COMPONENTS]
    of_links = [Coefficient(link.joint, c) for link in doty_links(robot) for c in link.components]
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
    truth, given = scenario.truth.frames, scenario.frames
    base = truth.world_base or given.world_base
    target = (truth.tip_target or given.tip_target) if head is None else (truth.tip_camera or head.tip_camera)
    frames = {}
    for name, frame in (("world_base", base), ("tip_target", target)):
        rotation = pin.rpy.rpyToMatrix(*frame.rpy)
        frames[name] = pin.SE3(rotation, np.array(frame.xyz))
    return frames


def true_head(scenario: Scenario, settings: HeadSettings, rng: np.random.Generator) -> tuple[Head, list[Cause]]:
    """The measuring head as it really is, and its effects.

    Its numbers are phi = phi_stated + sum over the effects of D theta, with the effect's coefficients theta and their
    directions D in the space of the head's numbers.

    Args:
        scenario: Says which effects.
        settings: The head as its makers state it.
        rng: Draws the coefficients that are not given.
    """
    head, place = Head.of(settings), f"{scenario.path}: truth"
    phi, causes = head.phi, []
    wanted = [e for e in scenario.truth.effects if is_of_head(e.kind)]
    for e, effect in zip(wanted, stated(head, wanted, place), strict=True):
        theta = values(e, effect, rng, place)
        causes.append(Cause(effect, theta, {}))
        phi = phi + directions(head, effect.coefficients) @ theta
    return replace(head, phi=phi), causes


def surroundings(scenario: Scenario, frames: Mapping[str, pin.SE3], loaded: bool) -> Surroundings:
    """Gravity in the base's frame, and the payload's place; ``loaded`` where there is one."""
    gravity = scenario.robot.gravity
    R_world_base = frames["world_base"].rotation
    vector = R_world_base.T @ [0.0, 0.0, -9.81] if gravity == "world" else np.array(gravity)
    return Surroundings(vector, frames["tip_target"].translation, loaded)


def _table(
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
    measured = dict(zip(POSITION, position.T, strict=True))
    if settings.kind == "pose":
        measured |= dict(zip(QUATERNION, rotation.as_quat(canonical=True).T, strict=True))
    measured |= covariates
    columns = [settings.columns.get(name, name) for name in joints]
    columns += [column_of(name, settings, joints) for name in measured]
    twice = sorted({name for name in columns if columns.count(name) > 1})
    if twice:
        raise CampaignError(f"{scenario.path}: two columns would be called {twice[0]!r}: add `measurements.columns`")
    values = (*joints.values(), *measured.values())
    return pd.DataFrame(dict(zip(columns, values, strict=True)))
