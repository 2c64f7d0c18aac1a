"""Joint commands that bring the real target to wanted poses, through the whole calibrated model.

Example:
    aridcal compensate results/calibration.yaml poses.csv -o joints.csv
    aridcal compensate results/calibration.yaml --grid 5 -o table.csv
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from aridcal.calibration import Calibration
from aridcal.commands import CommandParser, atomic_file, check_writable, command_parser, run
from aridcal.errors import AridcalError, CovariateNotFound, MeasurementError, OutputError
from aridcal.inverse import Arm, Command
from aridcal.measurements import Query, load_query
from aridcal.model import Model
from aridcal.predict import ENDINGS, extrapolates, write_table
from aridcal.quality import joint_kinds, joint_limits

SHOWN_REMARKS = 5
STILL = 1e-6  # a joint that moves by less keeps its side of the backlash, [rad] or [m]
RESTARTS = 30  # starts that are tried for a pose that comes without a seed
GENTLE = 0.02  # [m/rad] what turns the target by less than so much is not corrected by a table: close to a singularity
MOST_POINTS = 1_000_000
CHECKED = 300  # configurations between its points at which a table is checked

EPILOG = """\
The poses are `x y z qx qy qz qw` of the target in the world (`x y z` if only positions were measured), and a column
for each covariate that an effect depends on; columns and units are those of the campaign's own tables. Columns of the
joints, if there are any, are where to start: the controller's own solution, say. A row without them starts where the
row before ended. A JOINT_direction that an effect needs and the table lacks is taken from the row before.

All columns and rows are kept in their order. The joints' columns are filled in; `reached` tells whether the target gets
to the pose within the noise of the measurements behind the calibration (of a robot with fewer than six joints: as near
as it can, weighted by the noise, and within 20 mm and 20 mrad), `position_error` and `rotation_error` how far it is off,
`extrapolates` whether the command is outside what the calibration has seen. Limits are kept.

The joints are what the calibration's own joints were: commands, if those were commanded; where they were reported
(`joint_reading: reported` in the campaign), what the controller must report when the target is there.

With --grid the output is a table for controllers that take no model: at each point of a grid over the joints, what is
to be added to the nominal solution.
"""


def compensate(calibration: Calibration, query: Query) -> pd.DataFrame:
    """Fill in the joint commands for each row of wanted poses.

    Args:
        calibration: The model.
        query: N rows, read with the calibration's own `measurements` settings and ``poses=True``.

    Returns:
        The query's table with the joints, ``reached``, ``position_error``, ``rotation_error`` and ``extrapolates``, N
        rows; a row that lacks a number has no command.

    Raises:
        CovariateNotFound: an effect depends on a column that is not there.
        MeasurementError: a row's station is none of those that were calibrated.
    """
    settings, robot = calibration.measurements, calibration.final.model.robot
    units = settings.units
    found, covariates = follow(calibration, query)
    readings = np.array([c.readings for c in found])
    table = query.table.copy()
    for k, (name, kind) in enumerate(zip(robot.readings, joint_kinds(robot), strict=True)):
        table[settings.columns.get(name, name)] = readings[:, k] / (
            units.metres if kind == "prismatic" else units.radians
        )
    for name in directions(calibration):
        table[settings.columns.get(name, name)] = covariates[name]
    table["reached"] = [c.reached for c in found]
    table["position_error"] = [c.position_error / units.metres for c in found]
    if calibration.kind == "pose":
        table["rotation_error"] = [c.rotation_error / units.radians for c in found]
    table["extrapolates"] = extrapolates(calibration, replace(query, readings=readings, covariates=covariates))
    return table


def follow(calibration: Calibration, query: Query) -> tuple[list[Command], dict[str, np.ndarray]]:
    """Command the rows one after the other.

    Returns:
        N commands, NaN where a row lacks a number, and the covariates, missing approach directions filled in: the side
        from which each joint comes to its place without backlash; 0 as long as it has not moved.
    """
    model, n = calibration.final.model, len(query.line)
    sides = {name: query.covariates.get(name, np.full(n, np.nan)) for name in directions(calibration)}
    guessed = {name: np.where(np.isnan(side), 0.0, side) for name, side in sides.items()}
    commands = _walk(calibration, query, query.covariates | guessed)
    if not any(np.isnan(side).any() for side in sides.values()):
        return commands, query.covariates | guessed
    readings = np.array([c.readings for c in commands])
    for name, side in sides.items():
        column = model.robot.readings.index(model.robot.joint(name.removesuffix("_direction")).reading)
        guessed[name] = np.where(np.isnan(side), approach(readings[:, column]), side)
    again = _walk(calibration, replace(query, readings=readings), query.covariates | guessed)
    return again, query.covariates | guessed


def directions(calibration: Calibration) -> tuple[str, ...]:
    """Approach directions that the effects depend on, ``joint_2_direction`` for instance."""
    known = {f"{name}_direction" for name in calibration.final.model.robot.names}
    return tuple(name for name in _arm(calibration).machine.needs if name in known)


def approach(reading: np.ndarray) -> np.ndarray:
    """The side from which a joint comes to each reading of a trajectory: -1 or 1; 0 until it first moves.

    Args:
        reading: Shape (N,), [rad] or [m]; rows of NaN are passed over.
    """
    sides, side, last = np.zeros(len(reading)), 0.0, math.nan
    for k, value in enumerate(reading.tolist()):
        if abs(value - last) > STILL:
            side = math.copysign(1.0, value - last)
        sides[k] = side
        last = last if math.isnan(value) else value
    return sides


def _walk(calibration: Calibration, query: Query, covariates: Mapping[str, np.ndarray]) -> list[Command]:
    model = calibration.final.model
    columns = len(model.robot.readings)
    seen = np.array([calibration.ranges.get(name, (0.0, 0.0)) for name in model.robot.readings])
    needs = _arm(calibration).machine.needs
    missing = [name for name in needs if name not in covariates]
    if missing:
        raise CovariateNotFound(f"the model depends on {missing[0]!r}, which the poses do not have: add that column")
    usable = query.usable & ~np.isnan([covariates[name] for name in needs]).any(axis=0)
    assert query.position is not None
    R = np.zeros((len(usable), 3, 3))
    if query.quaternion is not None and usable.any():
        R[usable] = Rotation.from_quat(query.quaternion[usable]).as_matrix()
    nothing = Command(np.full(columns, np.nan), math.nan, math.nan, False)
    found, last = [], seen.mean(axis=1)
    rng = np.random.default_rng(0)
    for k in range(len(usable)):
        if not usable[k]:
            found.append(nothing)
            continue
        arm = calibration.arm(None if query.station is None or not _per_station(model) else str(query.station[k]))
        given = {name: float(covariates[name][k]) for name in needs}
        seed = query.readings[k]
        seeded = not np.isnan(seed).any()
        best = arm.command(R[k], query.position[k], seed if seeded else np.where(np.isnan(seed), last, seed), given)
        if not (best.reached or seeded):
            starts = (rng.uniform(seen[:, 0], seen[:, 1]) for _ in range(RESTARTS))
            others = (arm.command(R[k], query.position[k], start, given) for start in starts)
            best = next((c for c in others if c.reached), best)
        last = best.readings
        found.append(best)
    return found


@dataclass(frozen=True)
class CorrectionTable:
    """What to add to the nominal solution, over a grid of the joints.

    Attributes:
        axes: Points of each reading, [rad] or [m].
        delta: Correction at each point, shape (points of axis 1, ..., columns), [rad] or [m].
        before: RMS distance of the target from where the nominal model has it, between the points, [m].
        after: The same with the table's correction, interpolated linearly.
    """

    axes: tuple[np.ndarray, ...]
    delta: np.ndarray
    before: float
    after: float


def correction_table(calibration: Calibration, points: int) -> CorrectionTable:
    """Tabulate the corrections of a controller that knows the nominal robot alone.

    They bring the real target to where the nominal robot, with the base and the target where the calibration found
    them, would have it. Covariates stand in the middle of their ranges, backlash in the middle of its play. Near a
    singularity the corrections stay small and leave an error.

    Args:
        calibration: The model.
        points: Of the grid, along each joint, over the range that the calibration has seen.

    Raises:
        AridcalError: the grid would have more than a million points, or frames are per station.
    """
    model = calibration.final.model
    if _per_station(model):
        raise AridcalError("a correction table holds for one place: this calibration has frames per station")
    seen = np.array([calibration.ranges[name] for name in model.robot.readings])
    axes = tuple(np.linspace(low, high, points if high > low else 1) for low, high in seen)
    if math.prod(len(axis) for axis in axes) > MOST_POINTS:
        raise AridcalError(f"--grid {points}: would have more than {MOST_POINTS:,} points; take fewer")
    world, tip = model.frames(calibration.final.theta)
    nominal = Model(model.robot, (), world, tip)
    arm = calibration.arm()
    middle = {name: float(np.mean(calibration.ranges[name])) for name in arm.machine.needs}
    middle |= dict.fromkeys(directions(calibration), 0.0)

    grid = np.array(list(product(*axes)))
    R, p = nominal.poses(np.zeros(0), nominal.rows(grid))
    delta = np.array([_gentle(arm, *wanted, middle) for wanted in zip(R, p, grid, strict=True)])
    delta = delta.reshape(*(len(axis) for axis in axes), -1)
    between = np.random.default_rng(0).uniform(seen[:, 0], seen[:, 1], (CHECKED, len(seen)))
    moving = [k for k, axis in enumerate(axes) if len(axis) > 1]
    inner = delta[tuple(slice(None) if k in moving else 0 for k in range(len(axes)))]
    corrected = between + RegularGridInterpolator([axes[k] for k in moving], inner)(between[:, moving])
    _, wanted = nominal.poses(np.zeros(0), nominal.rows(between))

    def off(readings: np.ndarray) -> float:
        machine = arm.machine
        at = np.array([machine.pose(q, machine.effects(q, middle))[1] for q in readings])
        return float(np.sqrt(np.mean(np.sum((at - wanted) ** 2, axis=1))))

    return CorrectionTable(axes, delta, off(between), off(corrected))


def _gentle(arm: Arm, R: np.ndarray, p: np.ndarray, q: np.ndarray, covariates: Mapping[str, float]) -> np.ndarray:
    """Correction that brings the target near a pose without large moves, shape (columns,)."""
    delta = np.zeros(len(q))
    for _ in range(4):
        e, J = arm.error(R, p, q + delta, covariates)
        H = J.T @ J + GENTLE**2 * np.eye(len(q))
        delta = np.linalg.solve(H, J.T @ (e + J @ delta))
    return delta


def _per_station(model: Model) -> bool:
    return len(model.world_base) > 1 or len(model.tip_target) > 1


def _arm(calibration: Calibration) -> Arm:
    """The arm at the first station; all need the same."""
    model = calibration.final.model
    labels = [label for label, _ in (*model.world_base, *model.tip_target) if label is not None]
    return calibration.arm(labels[0] if labels else None)


def parser() -> CommandParser:
    """The command's arguments."""
    command = command_parser("compensate", __doc__, EPILOG)
    command.add_argument("calibration", type=Path, help="calibration.yaml of a result folder")
    command.add_argument(
        "poses", type=Path, nargs="?", help="wanted poses (and covariates, and joints), .csv or .parquet"
    )
    command.add_argument(
        "--grid", type=int, metavar="POINTS", help="a correction table: so many points along each joint"
    )
    command.add_argument("-o", "--out", type=Path, required=True, help="where to write the commands, .csv or .parquet")
    return command


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    command = parser()
    arguments = command.parse_args(argv)
    if (arguments.poses is None) == (arguments.grid is None):
        command.error("give either the poses or --grid POINTS")
    if arguments.grid is not None and arguments.grid < 2:
        command.error("--grid: 2 points at least")
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> None:
    if arguments.out.suffix.lower() not in ENDINGS:
        raise OutputError(f"{arguments.out}: should be a .csv or .parquet file")
    check_writable(arguments.out)
    calibration = Calibration.load(arguments.calibration)
    if arguments.grid is not None:
        _tabulate(calibration, arguments.grid, arguments.out)
        return
    model = calibration.final.model
    query = load_query(
        arguments.poses,
        model.robot.readings,
        joint_limits(model.robot),
        joint_kinds(model.robot),
        calibration.measurements,
        poses=True,
        per_station=_per_station(model),
    )
    if not query.usable.any():
        raise MeasurementError(f"no row can be commanded. First: {query.refused[0]}")
    table = compensate(calibration, query)
    with atomic_file(arguments.out) as path:
        write_table(table, path)
    _report(table, calibration, query, arguments.out)


def _tabulate(calibration: Calibration, points: int, out: Path) -> None:
    robot, settings = calibration.final.model.robot, calibration.measurements
    found = correction_table(calibration, points)
    units = [settings.units.metres if k == "prismatic" else settings.units.radians for k in joint_kinds(robot)]
    names = [settings.columns.get(name, name) for name in robot.readings]
    values = np.hstack([np.array(list(product(*found.axes))), found.delta.reshape(-1, len(names))])
    columns = [*names, *(f"delta_{name}" for name in names)]
    with atomic_file(out) as path:
        write_table(pd.DataFrame(values / [*units, *units], columns=columns), path)
    Console(stderr=True).print(
        f"{out}: {len(values)} points; between them the target is off by {1e3 * found.after:.3f} mm RMS, "
        f"without the table by {1e3 * found.before:.3f} mm",
        markup=False, highlight=False, soft_wrap=True,
    )  # fmt: skip


def _report(table: pd.DataFrame, calibration: Calibration, query: Query, out: Path) -> None:
    """Say on the screen what the table itself does not shout."""
    console = Console(stderr=True)

    def say(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    for remark in (*query.refused, *query.notices)[:SHOWN_REMARKS]:
        say(str(remark))
    more = len(query.refused) + len(query.notices) - SHOWN_REMARKS
    if more > 0:
        say(f"and {more} more remarks")
    commanded = table["position_error"].notna().to_numpy()
    missed = np.flatnonzero(commanded & ~table["reached"].to_numpy(bool))
    for k in missed[:SHOWN_REMARKS]:
        off = 1e3 * float(table["position_error"].iloc[k]) * calibration.measurements.units.metres
        say(f"line {query.line[k]}: cannot be reached: {off:.3f} mm off at best, limits kept")
    if calibration.measurements.joint_reading == "reported":
        say("these are joints to be reported, as in the calibration: where a drive sags below its command, add how far")
    said = f"{out}: {len(table)} rows, {int(table['reached'].sum())} reached"
    said += f", {len(missed)} out of reach" if len(missed) else ""
    said += f", {int((~commanded).sum())} without a command because a number is missing" if not commanded.all() else ""
    say(f"{said}; {int(table['extrapolates'].sum())} of them outside what the calibration has seen")


if __name__ == "__main__":
    sys.exit(main())
