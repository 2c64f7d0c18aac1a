"""Joint commands that bring the real target to wanted poses, through the whole calibrated model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.regional_kind import labels_of
from aridcal.engine.inverse.one_pose import Command, InverseKinematics
from aridcal.engine.rows.approach import approach
from aridcal.files.counting import counting
from aridcal.files.query import Query
from aridcal.jobs.apply.target_poses import (
    at_any_station,
    directions,
    extrapolates,
    needed_of,
    per_station,
    std_of,
    with_told,
)
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import AridcalError, CovariateNotFound
from aridcal.system.progress import SILENT, Progress

if TYPE_CHECKING:
    import pandas as pd

LEAST_BACKLASH_MOTION = 1e-6
"""A joint that moves by less keeps its side of the backlash, [rad] or [m]."""
RESTARTS = 30
"""Starts for a pose without a seed, or with one that leads nowhere, until one ends inside the measured ranges."""
TURN = 2.0 * math.pi
"""Once round, [rad]."""
SINGULARITY_DAMPING = 0.02
"""[m/rad]: a table does not correct along directions that move the target by less: there a singularity is near."""
DAMPED_STEPS = 4
"""Newton's steps to a table's corrections; they are a thousandth of the joints' range, so that two would do."""
MOST_POINTS = 1_000_000
"""Points of a table at the most: no controller could hold more."""
CHECK_POINTS = 300
"""Configurations between its points at which a table is checked."""


RowCounter = Callable[[int], None]
"""Gets the number of rows that are done."""


def ignore_count(rows: int) -> None:
    """Ignore the number of rows that are done."""


def compensate(
    saved: SavedModel, query: Query, trajectory: Trajectory | None = None, report: RowCounter = ignore_count
) -> pd.DataFrame:
    """Fill in the joint commands for each row of wanted poses.

    Args:
        saved: The model.
        query: N rows, read with the calibration's own `measurements` settings and ``poses=True``.
        trajectory: The walk through the rows before these, where these are a stretch of a longer table.
        report: Called with the number of rows that are done.

    Returns:
        The query's table with the joints, ``reached``, ``position_error``, ``rotation_error`` and ``extrapolates``, N
        rows; a row that lacks a number has no command. Joints of other limbs stay where the table, or the row before, has
        them: at first in the middle of their ranges. Joints that no command moves get no column.

    Raises:
        CovariateNotFound: an effect depends on a column that is not there.
        MeasurementError: a row's station is none of those that were calibrated.
    """
    settings, robot = saved.measurements, saved.final.model.robot
    units = settings.units
    commands, covariates = (trajectory or Trajectory(saved)).follow(query, report)
    readings = np.array([command.readings for command in commands])
    table = query.table.copy()
    cells = counting(settings, robot.readings, robot.kinds).cells(readings)
    names = [settings.columns.get(name, name) for name in robot.readings]
    for k in np.flatnonzero(commanded_columns(saved) | np.isin(names, table.columns)):
        table[names[k]] = cells[:, k]
    for name in directions(saved):
        table[settings.columns.get(name, name)] = settings.sense(name) * covariates[name]
    table["reached"] = [command.reached for command in commands]
    table["position_error"] = [command.position_error / units.metres for command in commands]
    if saved.turns:
        table["rotation_error"] = [command.rotation_error / units.radians for command in commands]
    commanded = replace(query, readings=readings, covariates=covariates)
    table["extrapolates"] = extrapolates(saved, commanded, std_of(saved, commanded))
    return with_told(saved, commanded, table)


def commanded_columns(saved: SavedModel) -> np.ndarray:
    """Columns of readings that commands set, for any of the targets, shape (columns,) bool."""
    model = saved.final.model
    if len(model.routes) == 1:
        return at_any_station(saved).model.moves
    base, _ = model.first_labels
    ends = [(base, label) if saved.frames_by == "both" else (label, None) for label, _ in model.tip_target]
    return np.any([saved.inverse_kinematics(*end).model.moves for end in ends], axis=0)


def follow(saved: SavedModel, query: Query) -> tuple[list[Command], dict[str, np.ndarray]]:
    """Command the rows of a whole table one after the other; see :meth:`Trajectory.follow`."""
    return Trajectory(saved).follow(query)


class Trajectory:
    """Rows commanded one after the other, stretch after stretch: each starts where the one before ended.

    Args:
        saved: The model.
    """

    def __init__(self, saved: SavedModel) -> None:
        self._saved = saved
        self._walks = _Walk(saved), _Walk(saved)
        self._sides = {name: (0.0, math.nan) for name in directions(saved)}

    def follow(self, query: Query, report: RowCounter = ignore_count) -> tuple[list[Command], dict[str, np.ndarray]]:
        """Command the rows of one more stretch.

        Returns:
            N commands, NaN where a row lacks a number, and the covariates, missing approach directions filled in: the side
            from which each joint comes to its place without backlash; 0 as long as it has not moved.
        """
        unknown = np.full(len(query.line), np.nan)
        sides = {name: query.covariates.get(name, unknown) for name in self._sides}
        guessed = {name: np.where(np.isnan(side), 0.0, side) for name, side in sides.items()}
        covariates = query.covariates | guessed
        first, second = self._walks
        commands = first.commands(query, covariates, report)
        readings = np.array([command.readings for command in commands])
        derived = {name: self._approach(name, readings) for name in sides}
        if not any(np.isnan(side).any() for side in sides.values()):
            return commands, covariates
        covariates |= {name: np.where(np.isnan(side), derived[name], side) for name, side in sides.items()}
        return second.commands(replace(query, readings=readings), covariates, report), covariates

    def _approach(self, name: str, readings: np.ndarray) -> np.ndarray:
        """The side from which a joint comes to its place, shape (N,)."""
        robot = self._saved.final.model.robot
        positions = robot.positions(readings)[:, robot.names.index(name.removesuffix("_direction"))]
        side, last = self._sides[name]
        sides = approach(positions, LEAST_BACKLASH_MOTION, side, last)
        finite = positions[~np.isnan(positions)]
        self._sides[name] = float(sides[-1]), float(finite[-1]) if len(finite) else last
        return sides


class _Walk:
    """One command for each row, each starting from its seed or where the row before ended.

    Rows without a seed may change to another branch to stay inside the measured ranges, and rows whose seed leads nowhere to
    reach the pose at all.
    """

    def __init__(self, saved: SavedModel) -> None:
        model = saved.final.model
        self._saved, self._stations = saved, per_station(model)
        self._needs, self._needed = at_any_station(saved).model.needs, needed_of(saved)
        self._labels = labels_of(c.basis for c in model.coefficients)
        self._ranges = np.array([saved.ranges.get(name, (0.0, 0.0)) for name in model.robot.readings])
        self._last, self._rng = self._ranges.mean(axis=1), np.random.default_rng(0)

    def commands(self, query: Query, covariates: Mapping[str, np.ndarray], report: RowCounter) -> list[Command]:
        """Command the rows of one more stretch."""
        missing = sorted(self._needed - covariates.keys())
        if missing:
            raise CovariateNotFound(
                f"the model depends on {missing[0]!r}, which the poses do not have: add that column"
            )
        covariates = self._saved.completed(covariates, len(query.line))
        usable = query.usable & ~np.isnan([covariates[name] for name in self._needs]).any(axis=0)
        assert query.position is not None
        R = np.zeros((len(usable), 3, 3))
        if query.quaternion is not None and usable.any():
            R[usable] = Rotation.from_quat(query.quaternion[usable]).as_matrix()
        nothing = Command(np.full(len(self._ranges), np.nan), math.nan, math.nan, False)
        commands = []
        for k in range(len(usable)):
            report(k)
            if not usable[k]:
                commands.append(nothing)
                continue
            labels = (None if of is None or not self._stations else str(of[k]) for of in (query.station, query.target))
            inverse = self._saved.inverse_kinematics(*labels)
            values = {name: float(covariates[name][k]) for name in (*self._needs, *self._labels)}
            seed_cells = query.readings[k]
            seed = np.where(np.isnan(seed_cells), self._last, seed_cells)
            best = inverse.command(R[k], query.position[k], seed, values)
            if np.isnan(seed_cells[inverse.model.moves]).any() or not best.reached:
                best = _inside_ranges(inverse, R[k], query.position[k], values, self._ranges, self._rng, best)
            self._last = best.readings
            commands.append(best)
        return commands


def _inside_ranges(
    inverse: InverseKinematics,
    R: np.ndarray,
    p: np.ndarray,
    covariates: Mapping[str, float],
    ranges: np.ndarray,
    rng: np.random.Generator,
    best: Command,
) -> Command:
    """A command that reaches a pose inside the measured ranges; else the best of all that were tried.

    Starts are the first command, joints outside the ranges turned back by whole turns; the middle of the ranges; and
    readings drawn evenly over them.

    Args:
        inverse: The solver.
        R: Wanted rotation, shape (3, 3).
        p: Wanted position, shape (3,), [m].
        covariates: Values of the covariates of the effects.
        ranges: Lowest and highest reading of each joint, shape (columns, 2), [rad] or [m].
        rng: Draws the starts.
        best: The first command, which started from the row before.
    """

    def preferred(command: Command) -> tuple[bool, float, float]:
        """Sorts commands, the best first: those that reach the pose, those that miss it least, the nearest to the ranges."""
        outside = _outside(command.readings[moves], ranges[moves])
        return not command.reached, 0.0 if command.reached else command.miss, outside

    moves = inverse.model.moves
    middle = np.where(moves, ranges.mean(axis=1), best.readings)
    turns = np.where(inverse.turning & moves, np.round((middle - best.readings) / TURN), 0.0)
    starts = (best.readings + TURN * turns, middle)
    for k in range(-len(starts), RESTARTS):
        if best.reached and _outside(best.readings[moves], ranges[moves]) == 0.0:
            return best
        start = starts[k] if k < 0 else np.where(moves, rng.uniform(ranges[:, 0], ranges[:, 1]), best.readings)
        best = min(best, inverse.command(R, p, start, covariates), key=preferred)
    return best


def _outside(readings: np.ndarray, ranges: np.ndarray) -> float:
    """How far readings (columns,) are outside ranges (columns, 2), all joints together, [rad] or [m]; 0 inside."""
    return float(np.maximum(np.maximum(ranges[:, 0] - readings, readings - ranges[:, 1]), 0.0).sum())


@dataclass(frozen=True)
class CorrectionTable:
    """Corrections to add to the nominal solution, over a grid of the joints.

    Attributes:
        axes: Points of each reading, [rad] or [m].
        delta: Correction at each point, shape (points of axis 1, ..., columns), [rad] or [m].
        before: RMS distance of the target from that of the nominal model, between the points, [m].
        after: That distance with the table's correction, interpolated linearly.
    """

    axes: tuple[np.ndarray, ...]
    delta: np.ndarray
    before: float
    after: float


def correction_table(saved: SavedModel, points: int, progress: Progress = SILENT) -> CorrectionTable:
    """Tabulate the corrections of a controller that knows the nominal robot alone.

    They bring the real target to where the nominal robot, with the base and the target where the calibration found
    them, would have it. Covariates, and joints of other limbs, stand in the middle of their ranges, backlash in the middle
    of its play. Near a singularity the corrections stay small and leave an error.

    Args:
        saved: The model.
        points: Of the grid, along each joint, over the measured range.
        progress: Told how many points are done.

    Raises:
        AridcalError: the grid would have more than a million points, or frames are per station.
    """
    model = saved.final.model
    if per_station(model):
        raise AridcalError("a correction table holds for one place: this calibration has frames per station")
    ranged = {*saved.ranges, *directions(saved)}
    unseen = [name for name in (*model.robot.readings, *model.needs) if name not in ranged]
    if unseen:
        raise AridcalError(
            f"the calibration does not say in which range {unseen[0]} was measured: run `aridcal identify` again"
        )
    inverse = saved.inverse_kinematics()
    ranges = np.array([saved.ranges[name] for name in model.robot.readings])
    held = ~inverse.model.moves
    ranges[held] = ranges[held].mean(axis=1, keepdims=True)
    axes = tuple(np.linspace(low, high, points if high > low else 1) for low, high in ranges)
    sizes = [len(axis) for axis in axes]
    if math.prod(sizes) > MOST_POINTS:
        raise AridcalError(f"--grid {points}: would have more than {MOST_POINTS:,} points; take fewer")
    world, tip = saved.expected.model.frames(saved.expected.theta)
    nominal = replace(model, coefficients=(), world_base=world, tip_target=tip)
    middle = {name: float(np.mean(saved.ranges[name])) for name in inverse.model.needs if name in saved.ranges}
    middle |= saved.assumed | dict.fromkeys(directions(saved), 0.0)

    grid = np.array(list(product(*axes)))
    R, p = nominal.poses(np.zeros(0), nominal.rows(grid))
    poses_and_readings = progress.through(zip(R, p, grid, strict=True), len(grid), "points")
    corrections = [_gentle(inverse, *wanted_pose, middle) for wanted_pose in poses_and_readings]
    delta = np.array(corrections).reshape(*sizes, -1)

    between = np.random.default_rng(0).uniform(ranges[:, 0], ranges[:, 1], (CHECK_POINTS, len(ranges)))
    corrected = between + _interpolated(axes, delta, between)
    _, positions = nominal.poses(np.zeros(0), nominal.rows(between))
    before, after = (_rms_distance(inverse, readings, middle, positions) for readings in (between, corrected))
    return CorrectionTable(axes, delta, before, after)


def _interpolated(axes: tuple[np.ndarray, ...], delta: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """A table's corrections between its points, linearly, shape (N, columns); axes of one point do not count.

    Args:
        axes: Points of each reading.
        delta: Correction at each point, shape (points of axis 1, ..., columns).
        readings: Shape (N, columns), inside the table.
    """
    from scipy.interpolate import RegularGridInterpolator  # slow to load, and only tables need it

    moving = [k for k, axis in enumerate(axes) if len(axis) > 1]
    inner = delta[tuple(slice(None) if k in moving else 0 for k in range(len(axes)))]
    table = RegularGridInterpolator([axes[k] for k in moving], inner)
    return np.asarray(table(readings[:, moving]))


def _rms_distance(
    inverse: InverseKinematics, readings: np.ndarray, covariates: Mapping[str, float], positions: np.ndarray
) -> float:
    """RMS distance of the target from wanted positions (N, 3) at some readings (N, columns), [m]."""
    machine = inverse.model
    at = np.array([machine.pose(q, machine.effects(q, covariates))[1] for q in readings])
    squared = np.sum((at - positions) ** 2, axis=1)
    return float(np.sqrt(np.mean(squared)))


def _gentle(
    inverse: InverseKinematics, R: np.ndarray, p: np.ndarray, q: np.ndarray, covariates: Mapping[str, float]
) -> np.ndarray:
    """Correction that brings the target near a pose without large moves, shape (columns,).

    Gauss-Newton on |e(q + delta)|^2 + DAMPING^2 |delta|^2, with the error e and its Jacobian J:
    (J' J + DAMPING^2 I) delta_new = J' (e + J delta).
    """
    delta = np.zeros(len(q))
    for _ in range(DAMPED_STEPS):
        e, J = inverse.error(R, p, q + delta, covariates)
        H = J.T @ J + SINGULARITY_DAMPING**2 * np.eye(len(q))
        delta = np.linalg.solve(H, J.T @ (e + J @ delta))
    return delta
