"""Campaigns of other kinds than poses, and of several limbs: a simulated robot among the things that it is measured with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise

import numpy as np
import pandas as pd
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.corrections.sights import Sights, sights_from
from aridcal.engine.instruments.channels import columns as parts_of
from aridcal.engine.instruments.inclination import DOWN
from aridcal.engine.instruments.joined import GRASP
from aridcal.engine.instruments.kind import MeasurementKind
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS, labelled
from aridcal.engine.instruments.pose import TRACKER, tracker_positions
from aridcal.engine.instruments.setup import TIP, WORLD
from aridcal.engine.inverse.reachable import Miss, Pose, draw_readings, limits_of, readings_for_poses, settled
from aridcal.engine.model.model import Model, ModelRows
from aridcal.engine.robot.chain import Robot, Route
from aridcal.files.instrument_settings import TargetSettings
from aridcal.files.measurement_settings import SHOT, TARGET, MeasurementSettings
from aridcal.files.orientations import POSITION_COLUMNS, QUATERNION
from aridcal.files.read import ONE_TARGET, default_target
from aridcal.files.routes import routes_of
from aridcal.files.things import InstrumentDeclarations, instrument_declarations
from aridcal.jobs.simulate.camera_postures import Sight, Tips, draw_images, sight
from aridcal.jobs.simulate.scenario import Scenario, TrueFrame, columns_of
from aridcal.jobs.simulate.true_effects import Machine, PreparedEffect, draw_columns, make_causes
from aridcal.jobs.simulate.true_things import (
    MARKER_BOX,
    Around,
    RealThings,
    true_anchors,
    true_grasps,
    true_planes,
    true_points,
)
from aridcal.system.errors import CampaignError
from aridcal.system.reading.table_files import FIRST_LINE

REACHED, WELL = 1000, (0.25, 0.75)
"""Postures drawn to see where the arm reaches, and quantiles of their distance from the base between which places are reached in
many ways, and by every target."""

GRASP_RANGE_SHARE = 0.4
"""Share of each joint's range, about its middle, in which two links take a body."""

PASSES, NEWTON = 5, 4
"""How often effects and the readings that they change are found in turn, and Newton's steps of each."""


@dataclass(frozen=True)
class BlockRows:
    """Rows of one block, n of them.

    Attributes:
        kind: Of the measurements.
        readings: Shape (n, columns), [rad] or [m].
        shot: Number of each row's configuration among those of the block, shape (n,): an image has many rows.
        refers: Numbers of the things that rows refer to, by the kind's roles, shape (n, roles).
        target: Label of each row's target, shape (n,).
        stroke: What a gauge is to read, shape (n,), [m]; 0 where the target touches.
        routes: The paths that they take.
        route: Number of each row's path, shape (n,); None where all take one.
        changes: Differences of the things from their states at each row, (n, u) by role; None: none.
    """

    kind: MeasurementKind
    readings: np.ndarray
    shot: np.ndarray
    refers: np.ndarray
    target: np.ndarray
    stroke: np.ndarray
    routes: tuple[Route, ...] = (Route(),)
    route: np.ndarray | None = None
    changes: tuple[np.ndarray, ...] | None = None

    def states(self, real: Mapping[str, RealThings]) -> list[np.ndarray]:
        """States of the things that the rows refer to, with their faults, (n, P) by role."""
        roles = self.kind.roles
        states = [real[role.name].states[self.refers[:, k]] for k, role in enumerate(roles)]
        if self.changes is None:
            return states
        return [role.moved(*each) for role, *each in zip(roles, states, self.changes, strict=True)]

    def along(
        self,
        declarations: InstrumentDeclarations,
        real: Mapping[str, RealThings],
        tip: str,
        links: tuple[str, str] | None = None,
    ) -> BlockRows:
        """The rows with the paths that they take.

        Args:
            declarations: What carries the things.
            real: Their names.
            tip: The robot's.
            links: That hold one body.
        """
        refers = [self.labels(role.name, real) for role in self.kind.roles]
        labels = np.column_stack(refers) if refers else np.zeros((len(self.shot), 0), dtype=str)
        routes_of_rows = routes_of(declarations, self.kind.name, labels, self.target, tip, links)
        routes = tuple(dict.fromkeys(routes_of_rows))
        number = {route: k for k, route in enumerate(routes)}
        return replace(
            self, routes=routes, route=np.array([number[r] for r in routes_of_rows]) if len(routes) > 1 else None
        )

    def chains(self, model: Model) -> Model:
        """A model of the robot along the paths of these rows."""
        return replace(model, routes=self.routes)

    def seen_by(
        self,
        chains: Model,
        readings: np.ndarray,
        columns: Mapping[str, np.ndarray] | None = None,
        some: slice | np.ndarray = slice(None),
    ) -> ModelRows:
        """Some of these rows as a model of their paths sees them.

        Args:
            chains: The model.
            readings: Of the rows, shape (n, columns).
            columns: What effects depend on, each of shape (n,).
            some: Which rows these are.
        """
        route = None if self.route is None else self.route[some]
        return chains.rows(readings, columns, target=self.target[some], route=route)

    def labels(self, role: str, real: Mapping[str, RealThings]) -> np.ndarray:
        """Names of the things of a role that the rows refer to, empty where they have no such role, shape (n,)."""
        roles = [each.name for each in self.kind.roles]
        if role not in roles:
            return np.full(len(self.shot), "")
        return np.array(real[role].names)[self.refers[:, roles.index(role)]]

    def faulty(self, real: Mapping[str, RealThings], faults: Model, values: np.ndarray, phi: np.ndarray) -> BlockRows:
        """The rows measured with things that have faults.

        Args:
            real: The things as they are.
            faults: Whose coefficients move things.
            values: Of those, shape (K,).
            phi: Their bases, shape (n, K).
        """
        changes = []
        for role in self.kind.roles:
            label = self.labels(role.name, real)
            change = np.zeros((len(label), len(role.components)))
            for c, value, basis in zip(faults.coefficients, values, phi.T, strict=True):
                if c.component in role.components:
                    change[:, role.components.index(c.component)] += value * basis * (label == c.where)
            changes.append(change)
        return replace(self, changes=tuple(changes))

    def miss(self, real: Mapping[str, RealThings], noise: np.ndarray) -> Miss | None:
        """How far the targets are from where they must be; None where they may be anywhere.

        Args:
            real: The things as they are.
            noise: Of the rows' residuals, shape (n, m), [m] and [rad].
        """
        if self.kind.joins:
            (grasp,) = self.states(real)
            return lambda R, p, rows: self.kind.residual(R, p, np.zeros((len(p), 0)), [grasp[rows]]) - noise[rows]
        if self.kind.touches:
            (place,) = self.states(real)
            return lambda R, p, rows: p + noise[rows] - place[rows]
        if self.kind.gauges:
            (plane,) = self.states(real)
            height = plane[:, 3:] - noise + self.stroke[:, None]
            return lambda R, p, rows: np.sum(plane[rows, :3] * p, axis=1, keepdims=True) - height[rows]
        return None


@dataclass(frozen=True)
class SimulatedMeasurements:
    """Measurements of a machine.

    Attributes:
        tables: Of each block, as they are written.
        causes: True effects.
        outliers: Rows that are grossly wrong, of each block.
        real: The things as they are, by role.
    """

    tables: tuple[pd.DataFrame, ...]
    causes: tuple[PreparedEffect, ...]
    outliers: tuple[np.ndarray, ...]
    real: dict[str, RealThings]


def targets(scenario: Scenario, tip: pin.SE3) -> dict[str, pin.SE3]:
    """True T_tip_target by label, as the reader of the campaign calls them."""
    true_frames = scenario.truth.frames.targets
    frames: dict[str, TargetSettings | TrueFrame] = {**scenario.instruments.targets, **true_frames}
    placements = {name: pin.SE3(pin.rpy.rpyToMatrix(*each.rpy), np.array(each.xyz)) for name, each in frames.items()}
    names = [label for block in scenario.blocks for label in _labels_of_block(scenario, block)]
    return {name: placements.get(name, pin.SE3.Identity() if name == TIP else tip) for name in dict.fromkeys(names)}


def _labels_of_block(scenario: Scenario, block: MeasurementSettings) -> list[str]:
    """Labels of the targets that a block's rows measure: the one that it names, or all that no block names."""
    if block.traits.bare or (block.traits.level and block.target is None):
        return [default_target(block.traits, block.title)]
    if block.target is not None:
        return [block.target]
    of_other_blocks = [other.title for other in scenario.blocks if other.traits.level]
    of_other_blocks += [other.target for other in scenario.blocks if other.target is not None]
    stated = dict.fromkeys((*scenario.instruments.targets, *scenario.truth.frames.targets))
    return [name for name in stated if name not in of_other_blocks] or [ONE_TARGET]


def simulate_measurements(
    scenario: Scenario, machine: Machine, around: Surroundings, streams: Sequence[np.random.Generator]
) -> SimulatedMeasurements:
    """Measure a machine with all blocks of a scenario.

    Args:
        scenario: What is measured.
        machine: The machine without its effects.
        around: Gravity and the payload's place.
        streams: Generators of configurations, noise, outliers, effects and things.

    Raises:
        CampaignError: the arm does not reach what it is to be measured with.
    """
    configurations, noise, outliers, chance, of_things = streams
    truth, robot = scenario.truth, machine.robot
    streams_of_blocks = configurations.spawn(len(scenario.blocks) + 1)
    known, things = instrument_declarations(scenario), truth.instruments
    roles = ("point", "anchor", "plane", "camera", "link", GRASP.name)
    of_role = dict(zip(roles, of_things.spawn(len(roles)), strict=True))
    around_things = _around_things(scenario, machine, streams_of_blocks[-1], of_role["link"])
    draw_things = {
        "point": lambda rng: true_points(things, known, around_things, rng),
        "anchor": lambda rng: true_anchors(things, known, around_things, rng),
        "plane": lambda rng: true_planes(things, known, around_things, rng),
        GRASP.name: lambda rng: _grasps(scenario, machine, rng),
    }
    trackers = tuple(block.title for block in scenario.blocks if block.traits.tracked)
    faultless = {TRACKER.name: RealThings(trackers, np.zeros((len(trackers), TRACKER.size)))}
    real: dict[str, RealThings] = {}
    for role in dict.fromkeys(role.name for block in scenario.blocks for role in block.traits.roles):
        real |= {role: draw_things[role](of_role[role])} if role in draw_things else {}
    images: Sight | None = None
    if any(block.traits.images for block in scenario.blocks):
        rng = of_role["camera"]
        images = sight(things, known, _tips(known, machine), lambda n: draw_readings(robot, n, rng), rng)
        real |= images.real
    things_of_rows = real | faultless
    rows = [
        _first_rows(scenario, number, machine, known, things_of_rows, images, streams_of_blocks[number])
        for number in range(len(scenario.blocks))
    ]
    errors, wrong = zip(*[_errors(scenario, each, noise, outliers) for each in rows], strict=True)
    rows, causes, model, true, columns = _with_effects(
        scenario, machine, known, rows, things_of_rows, errors, around, chance
    )
    tables = []
    for number, (block, each) in enumerate(zip(scenario.blocks, rows, strict=True)):
        chains = each.chains(model)
        R, p = chains.poses(true, each.seen_by(chains, each.readings, columns[number]))
        values = _read(each, R, p, things_of_rows, errors[number])
        tables.append(_table(scenario, number, block, robot, each, things_of_rows, values, columns[number]))
    return SimulatedMeasurements(tuple(tables), tuple(causes), tuple(wrong), real)


def _around_things(
    scenario: Scenario, machine: Machine, configurations: np.random.Generator, of_links: np.random.Generator
) -> Around:
    """Places among which things are drawn: in the world where the robot reaches, on a link around its frame."""
    label = next((name for name in machine.tips if name != TIP), TIP)
    target = scenario.instruments.targets.get(label)
    end = None if target is None or target.on in (TIP, machine.robot.tip) else target.on
    _, reached = machine.along(Route(None, end), label)(draw_readings(machine.robot, REACHED, configurations))
    distance = np.linalg.norm(reached - machine.world.translation, axis=1)
    reached = reached[(distance >= np.quantile(distance, WELL[0])) & (distance <= np.quantile(distance, WELL[1]))]
    near = of_links.uniform(-0.5, 0.5, (REACHED, 3)) * MARKER_BOX / 3
    return lambda carrier: reached if carrier == WORLD else near


def _grasps(scenario: Scenario, machine: Machine, rng: np.random.Generator) -> RealThings:
    """Poses in which two links take a body, of all blocks: those of postures off the limits, so that many others reach them."""
    grasps = []
    for number, block in enumerate(scenario.blocks):
        if block.links is not None:
            (route,) = routes_of(
                instrument_declarations(scenario), block.kind, np.full((1, 1), ""), None, machine.robot.tip, block.links
            )

            def draw_poses(count: int, route: Route = route) -> tuple[np.ndarray, np.ndarray]:
                low, high = limits_of(machine.robot)
                middle, half = (low + high) / 2.0, (high - low) / 2.0
                shares = rng.uniform(-GRASP_RANGE_SHARE, GRASP_RANGE_SHARE, (count, len(low)))
                return machine.along(route, TIP)(middle + half * shares)

            grasps.append(true_grasps(_of_grasps(scenario, number), scenario.truth.instruments.grasps, draw_poses))
    names = tuple(name for each in grasps for name in each.names)
    return RealThings(names, np.concatenate([each.states for each in grasps]))


def _of_grasps(scenario: Scenario, number: int) -> str:
    """The word that labels of a block's grasps begin with: another one in each block, as they are of other links."""
    several = sum(block.links is not None for block in scenario.blocks) > 1
    return f"{scenario.blocks[number].title}_{GRASP.name}" if several else GRASP.name


def _tips(declarations: InstrumentDeclarations, machine: Machine) -> Tips:
    """Poses of a camera's carrier in a board's carrier, or of the board's carrier in the world if that carries the camera."""

    @cache
    def between(camera: str, board: str) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        (route,) = routes_of(declarations, "pixels", np.array([[camera, board, ""]]), None, machine.robot.tip)
        return machine.along(route, TIP)

    return lambda readings, camera, board: between(camera, board)(readings)


def _first_rows(
    scenario: Scenario,
    number: int,
    machine: Machine,
    declarations: InstrumentDeclarations,
    real: Mapping[str, RealThings],
    cameras_seen: Sight | None,
    rng: np.random.Generator,
) -> BlockRows:
    """Rows of a block, the machine without its effects."""
    block, truth = scenario.blocks[number], scenario.truth
    place = f"{scenario.path}: {scenario.place(number)}"
    kind, n = MEASUREMENT_KINDS[block.kind], truth.n
    nominal, theta = machine.model()

    def pose(of: BlockRows) -> Pose:
        chains = of.chains(nominal)
        return lambda readings, some: chains.poses(theta, of.seen_by(chains, readings, some=some))

    if cameras_seen is not None and kind.images:
        names = cameras_seen.real["camera"].names
        numbers = [names.index(block.camera)] if block.camera is not None else list(range(len(names)))
        camera = np.array(numbers)[np.arange(n) % len(numbers)]
        draw = partial(draw_readings, machine.robot, rng=rng)
        readings, shown = draw_images(cameras_seen, camera, _tips(declarations, machine), draw, place)
        shot, marker = np.nonzero(shown)
        refers = np.column_stack([camera[shot], cameras_seen.board_of[marker], marker])
        rows = BlockRows(kind, readings[shot], shot, refers, np.full(len(shot), TIP), np.zeros(len(shot)))
        return rows.along(declarations, real, machine.robot.tip)
    labels = _labels_of_block(scenario, block)
    shot = np.arange(n)
    count = len(real[kind.roles[0].name].names) if labelled(kind.name) else 1
    refers = (shot % count)[:, None][:, : len(kind.roles)]
    if kind.tracked:
        refers = np.full((n, 1), real[TRACKER.name].names.index(block.title))
    if kind.joins:  # the body is taken anew after every so many rows
        first = real[GRASP.name].names.index(f"{_of_grasps(scenario, number)}_1")
        refers = (first + shot * truth.instruments.grasps // n)[:, None]
    target = np.array(labels)[shot // count % len(labels)]
    gauge = truth.instruments.gauge if kind.gauges else 0.0
    rows = BlockRows(kind, np.zeros((n, 0)), shot, refers, target, rng.uniform(-gauge, gauge, n))
    rows = rows.along(declarations, real, machine.robot.tip, block.links)
    miss = rows.miss(real, np.zeros((n, 1)))
    if miss is None:
        return replace(rows, readings=draw_readings(machine.robot, n, rng))
    advice = "name other links" if kind.joins else "move those under `truth.instruments`"
    return replace(rows, readings=readings_for_poses(machine.robot, pose(rows), miss, n, rng, place, advice))


def _errors(
    scenario: Scenario, rows: BlockRows, noise: np.random.Generator, outliers: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the numbers that a block reads, shape (n, m), and which rows are grossly wrong, shape (n,) bool."""
    truth, channels = scenario.truth, rows.kind.channels
    n = len(rows.shot)
    wrong = np.zeros(n, dtype=bool)
    in_sigmas = noise.standard_normal((n, sum(channel.size for channel in channels)))
    if truth.outliers is not None:
        wrong[outliers.permutation(n)[: round(truth.outliers.share * n)]] = True
        direction = outliers.standard_normal(in_sigmas.shape)
        for part in parts_of(channels):
            unit = direction[:, part] / np.linalg.norm(direction[:, part], axis=1, keepdims=True)
            in_sigmas[wrong, part] += truth.outliers.size * unit[wrong]
    sigma = np.repeat([getattr(truth.noise, c.name) for c in channels], [c.size for c in channels])
    return in_sigmas * sigma, wrong


def _with_effects(
    scenario: Scenario,
    machine: Machine,
    declarations: InstrumentDeclarations,
    rows: list[BlockRows],
    real: Mapping[str, RealThings],
    errors: Sequence[np.ndarray],
    around: Surroundings,
    chance: np.random.Generator,
) -> tuple[list[BlockRows], list[PreparedEffect], Model, np.ndarray, list[dict[str, np.ndarray]]]:
    """Effects, and readings with which the targets are where they must be although these act.

    Effects depend on the readings, and these on the effects: both are found in turn, which is quick, as effects are small.

    Returns:
        The rows, the effects, the machine with them, its coefficients, and all columns of each block.
    """
    truth, robot = scenario.truth, machine.robot
    names = columns_of(scenario, robot, truth.effects)
    ends = np.cumsum([0, *(len(each.shot) for each in rows)])
    shots = np.cumsum([0, *(int(each.shot.max()) + 1 for each in rows)])
    shot = np.concatenate([each.shot + first for each, first in zip(rows, shots, strict=False)])
    first_of_shot = np.unique(shot, return_index=True)[1]
    lines, last = [], 0
    for each in rows:  # as the reader counts them on through the files
        lines.append(last + FIRST_LINE + np.arange(len(each.shot)))
        last += FIRST_LINE + len(each.shot) - 1
    labels = [*machine.tips]
    tip = np.concatenate([[labels.index(label) for label in each.target] for each in rows]).astype(int)
    targets = np.array([placement.translation for placement in machine.tips.values()])
    states = {
        role: dict(zip(things_of_role.names, things_of_role.states, strict=True))
        for role, things_of_role in real.items()
    }
    components = {
        (role.name, name): role.components for each in rows for role in each.kind.roles for name in states[role.name]
    }
    names_of_things = {name for _, name in components}
    linked = {
        name
        for role, things_of_role in real.items()
        for name in things_of_role.names
        if declarations.linked(role, name)
    }
    plane = np.concatenate([each.labels("plane", real) for each in rows])
    touching = any(each.miss(real, e) is not None for each, e in zip(rows, errors, strict=True))
    for _ in range(PASSES if touching and truth.effects else 1):
        readings = np.concatenate([each.readings for each in rows])
        nominal, _ = machine.faults((), replace(around, sights=Sights(targets)))

        def places(model: Model = nominal, blocks: list[BlockRows] = rows) -> np.ndarray:
            found = []
            for each in blocks:
                chains = each.chains(model)
                found.append(chains.target_places(each.seen_by(chains, each.readings), each.readings))
            return np.concatenate(found)

        sights = sights_from(machine.world, targets, states, places, plane, linked)
        around = replace(around, sights=sights)
        of_shots = draw_columns(names, robot, readings[first_of_shot], truth.seed)
        columns = {name: values[shot] for name, values in of_shots.items()}
        causes, depends = make_causes(
            truth.effects, robot, readings, columns, around, deepcopy(chance), f"{scenario.path}: truth",
            np.concatenate(lines).astype(float), tip, components, _places_seen(replace(nominal, around=around), rows),
        )  # fmt: skip
        model, theta = machine.model([cause for cause in causes if cause.effect.where not in names_of_things], around)
        faults, values = machine.faults([cause for cause in causes if cause.effect.where in names_of_things], around)
        parts = [{name: column[low:high] for name, column in depends.items()} for low, high in pairwise(ends)]
        phis = [
            each.seen_by(each.chains(faults), each.readings, part).phi for each, part in zip(rows, parts, strict=True)
        ]
        rows = [each.faulty(real, faults, values, phi) for each, phi in zip(rows, phis, strict=True)]
        rows = [
            _with_settled_readings(each, model, theta, part, real, e)
            for each, part, e in zip(rows, parts, errors, strict=True)
        ]
    return rows, causes, model, theta, parts


def _places_seen(model: Model, rows: Sequence[BlockRows]) -> dict[str, np.ndarray]:
    """Covariates of places of all rows, each along its own path."""
    gravity, tables = np.atleast_2d(model.around.gravity)[0], []
    for each in rows:
        chains = each.chains(model)
        of_paths = each.seen_by(chains, each.readings)
        tables.append(chains.sight_columns(each.readings, gravity, of_paths.tip, of_paths.route))
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _with_settled_readings(
    rows: BlockRows,
    model: Model,
    true: np.ndarray,
    columns: Mapping[str, np.ndarray],
    real: Mapping[str, RealThings],
    errors: np.ndarray,
) -> BlockRows:
    """The rows with readings that bring their targets where they must be, apart from the errors."""
    miss = rows.miss(real, errors * (rows.stroke == 0.0)[:, None])
    if miss is None:
        return rows

    chains = rows.chains(model)

    def pose(readings: np.ndarray, indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        part = {name: values[indices] for name, values in columns.items()}
        return chains.poses(true, rows.seen_by(chains, readings, part, indices))

    readings = settled(pose, miss, rows.readings, NEWTON)
    return replace(rows, readings=readings)


def _read(
    rows: BlockRows, R: np.ndarray, p: np.ndarray, real: Mapping[str, RealThings], errors: np.ndarray
) -> dict[str, np.ndarray]:
    """Readings of the instrument, shape (n,) each, by the names of the columns."""
    kind = rows.kind
    if kind.tracked:
        values = dict(
            zip(POSITION_COLUMNS, (tracker_positions(p, rows.states(real)[0]) + errors[:, :3]).T, strict=True)
        )
        if kind.oriented:
            turn = Rotation.from_rotvec(errors[:, 3:]) * Rotation.from_matrix(R, assume_valid=True)
            values |= dict(zip(QUATERNION, turn.as_quat(canonical=True).T, strict=True))
        return values
    if kind.level:
        down = np.einsum("nji,j->ni", R, DOWN)
        side = np.cross(down, np.eye(3)[np.argmin(np.abs(down), axis=1)])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        deviation = errors[:, :1] * side + errors[:, 1:] * np.cross(down, side)
        return dict(zip(kind.read, (down + deviation).T, strict=True))
    if kind.joins or (kind.gauges and not rows.stroke.any()):
        return {}
    nothing = np.zeros((len(p), len(kind.read)))
    predicted = nothing if kind.touches else -kind.residual(R, p, nothing, rows.states(real))
    return dict(zip(kind.read, (predicted + errors[:, : len(kind.read)]).T, strict=True))


def _table(
    scenario: Scenario,
    number: int,
    block: MeasurementSettings,
    robot: Robot,
    rows: BlockRows,
    real: Mapping[str, RealThings],
    values_read: Mapping[str, np.ndarray],
    columns: Mapping[str, np.ndarray],
) -> pd.DataFrame:
    """The table of a block, columns named as the campaign names them."""
    values: dict[str, np.ndarray] = dict(zip(robot.readings, rows.readings.T, strict=True))
    for role in labelled(rows.kind.name):
        has_column = role.name != "board" and not (role.name == "camera" and block.camera is not None)
        if has_column:
            values[role.name] = rows.labels(role.name, real)
    if rows.kind.images:
        values[SHOT] = rows.shot + 1
    elif len(_labels_of_block(scenario, block)) > 1:
        values[TARGET] = rows.target
    values |= dict(values_read) | {name: columns[name] for name in columns_of(scenario, robot, scenario.truth.effects)}
    names = [block.columns.get(name, name) for name in values]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise CampaignError(
            f"{scenario.path}: {scenario.place(number)}: two columns would be called {repeated[0]!r}: add `columns` to it"
        )
    return pd.DataFrame(dict(zip(names, values.values(), strict=True)))
