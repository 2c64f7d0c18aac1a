"""Units and the writing of orientations in a table, judged by what the nominal robot makes of them.

A header may lie, and says little. Every way to read the columns that their names allow is tried. For each, the unknown
frames are fitted in closed form to the nominal model

    T_world_target = T_world_base(station) * T_base_tip(q) * T_tip_target(station)

and what counts is the median distance of the measured targets from it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.frame_starts import PoseRows, start_frames
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.files.measurement_settings import ANGLES, LENGTHS
from aridcal.files.orientations import MATRIX_SLACK, QUATERNION
from aridcal.files.quantities import TWO_TURNS
from aridcal.jobs.prepare.column_names import Family, MatrixColumns

# Units of length that tables of robots are in; the others are to be stated.
TRIED_LENGTHS = ("m", "mm", "cm", "in")
# Times that the targets' cloud may be larger or smaller than the tips': a target far out on a tool does not more.
MOST_SIZE_RATIO = 6.0
# Units whose clouds differ by no more than this factor from the best are tried too.
SIMILAR_SIZE_RATIO = 1.5
# Keeps clouds that are one point from dividing by zero, [m].
LEAST_READING_SPREAD = 1e-9
# Euler angles whose columns name their axes.
AXIS_SEQUENCES = ("xyz", "XYZ", "XZY", "YXZ", "YZX", "ZXY")
# Euler angles in columns such as A B C. Fixed xyz is turning ZYX with the columns reversed.
PLAIN_SEQUENCES = ("ZYX", "xyz", "XYZ", "ZYZ", "ZXZ", "zyx", "XZY", "YXZ", "YZX", "ZXY", "XYX", "XZX", "YXY", "YZY")
# Share of rows whose matrices are rotations, if they are meant to be.
LEAST_ROTATION_SHARE = 0.8
# Ways that the next is compared with.
WAYS_COMPARED = 4
# Rotations that are closer in every row are the same, [rad]: rounding of what was computed, not of what was written.
SAME_ROTATION = 1e-9


def rounded(value: float) -> str:
    """A size to be read: three digits, and whole where it is large."""
    return f"{value:.3g}" if value < 100 else f"{value:,.0f}"


@dataclass(frozen=True)
class Sample:
    """Some rows as they stand in the table.

    Attributes:
        q: Joint columns, shape (N, columns), in the table's units.
        turning: Which of them turn, shape (columns,) bool; the others slide.
        position: Shape (N, 3), in the table's unit.
        station: Number of each row's station, shape (N,).
    """

    q: np.ndarray
    turning: np.ndarray
    position: np.ndarray
    station: np.ndarray


@dataclass(frozen=True)
class TableReading:
    """One way to read joints and positions.

    Attributes:
        angle: Unit of the joints that turn.
        length: Unit of the positions.
        travel: Unit of the joints that slide.
        per: The frame that each station has to itself; None: all share both.
        metres: Median distance of the targets from where the nominal robot has them, [m].
        share: This distance as a share of the targets' spread.
        world: Rotation of each row's T_world_base, shape (N, 3, 3).
        tip: Rotation of each row's T_base_tip, shape (N, 3, 3).
    """

    angle: str
    length: str
    travel: str
    per: str | None
    metres: float
    share: float
    world: np.ndarray
    tip: np.ndarray


@dataclass(frozen=True)
class Writing:
    """One way in which orientations may be written.

    Attributes:
        misfit: Median angle from the nominal robot's orientations, [rad].
        what: In words.
        keys: Keys of a campaign that say so; None: the default.
        rotation: Of each row.
        angle: Unit of the angles; None: there are none.
    """

    misfit: float
    what: str
    keys: dict[str, Any]
    rotation: Rotation
    angle: str | None = None


def readings(sample: Sample, robot: Robot) -> list[TableReading]:
    """Every way to read joints and positions that is not off by a power of ten, the best fit first."""
    frames = (None, "world_base", "tip_target") if sample.station.any() else (None,)
    units = _combinations(sample)
    sizes = [_size_ratio(sample, robot, *one) for one in units]
    allowed = max(MOST_SIZE_RATIO, SIMILAR_SIZE_RATIO * min(sizes))
    possible = [one for one, size in zip(units, sizes, strict=True) if size < allowed]
    ways = [_read(sample, robot, *one, per) for per in frames for one in possible]
    return sorted(ways, key=lambda reading: reading.share)


def fit_with_one_slip(sample: Sample, robot: Robot, ways: Sequence[TableReading]) -> TableReading:
    """The best fit of some ways to read the columns, if one joint counts backwards or from another quarter of a turn.

    Args:
        sample: Rows to judge by.
        robot: The chain.
        ways: What else is known of each way: its units and frames.
    """
    slips = []
    for way, (k, turns) in itertools.product(ways, enumerate(sample.turning.tolist())):
        quarter = 0.5 * np.pi / ANGLES[way.angle]
        for sign, quarters in itertools.product((1, -1), (0, 1, -1, 2) if turns else (0,)):
            if (sign, quarters) != (1, 0):
                q = sample.q.copy()
                q[:, k] = sign * q[:, k] + quarters * quarter
                slips.append(_read(replace(sample, q=q), robot, way.angle, way.length, way.travel, way.per))
    return min(slips, key=lambda reading: reading.share)


def _combinations(sample: Sample) -> list[tuple[str, str, str]]:
    """Units of angle, length and travel to try; what the robot does not have is not varied."""
    angles = tuple(ANGLES) if sample.turning.any() else ("rad",)
    units = []
    for angle, length in itertools.product(angles, TRIED_LENGTHS):
        travels = (length,) if sample.turning.all() else TRIED_LENGTHS
        units += [(angle, length, travel) for travel in travels]
    return units


def _size_ratio(sample: Sample, robot: Robot, angle: str, length: str, travel: str) -> float:
    """How many times larger or smaller the measured cloud is than the cloud of the nominal robot's tips, at least 1."""
    _, tips = tip_frames(robot, _si_readings(sample, angle, travel))
    measured = _spread(sample.position) * LENGTHS[length]
    ratio = (measured + LEAST_READING_SPREAD) / (_spread(tips) + LEAST_READING_SPREAD)
    return max(ratio, 1 / ratio)


def _si_readings(sample: Sample, angle: str, travel: str) -> np.ndarray:
    """Joint columns read in some units, shape (N, columns), [rad] and [m]."""
    scale = np.where(sample.turning, ANGLES[angle], LENGTHS[travel])
    return np.asarray(sample.q * scale)


def _spread(points: np.ndarray) -> float:
    """RMS distance of points (N, 3) from their centre."""
    squared = np.sum((points - points.mean(axis=0)) ** 2, axis=1)
    return float(np.sqrt(np.mean(squared)))


def quaternion_writings(family: Family, values: np.ndarray, reading: TableReading) -> list[Writing]:
    """Writings as quaternions, scalar last, or first as well where columns are numbered; values (N, 4), best fit first."""
    orders = {"quaternion x y z w": (0, 1, 2, 3)}
    if family.numbers:
        orders["quaternion w x y z"] = (1, 2, 3, 0)
    writings = []
    for what, order in orders.items():
        columns = tuple(family.columns[k] for k in order)
        keys: dict[str, Any] = {"measurements.orientation": None}
        if columns != QUATERNION:
            keys = {f"measurements.columns.{q}": column for q, column in zip(QUATERNION, columns, strict=True)}
        rotation = Rotation.from_quat(_whole(values)[:, order])
        writings.append(Writing(_misfit(rotation, values, reading), what, keys, rotation))
    return sorted(writings, key=lambda writing: writing.misfit)


def angle_writings(family: Family, values: np.ndarray, reading: TableReading) -> list[Writing]:
    """Writings as rotation vectors and Euler angles, in both units; values (N, 3), best fit first."""
    writings = []
    largest = np.nanmax(np.abs(values))
    for unit, radians in ANGLES.items():
        if unit == "rad" and largest > TWO_TURNS:
            continue
        angles = _whole(values) * radians
        orientation: dict[str, Any] = {"rotvec": list(family.columns)}
        rotation = Rotation.from_rotvec(angles)
        misfit = _misfit(rotation, values, reading)
        what = f"a rotation vector in {unit}"
        writings.append(Writing(misfit, what, {"measurements.orientation": orientation}, rotation, unit))
        for sequence, order in _sequences(family):
            columns = [family.columns[k] for k in order]
            orientation = {"euler": sequence, "columns": columns}
            rotation = Rotation.from_euler(sequence, angles[:, order])
            misfit = _misfit(rotation, values, reading)
            axes = "turning" if sequence.isupper() else "fixed"
            what = f"Euler angles {sequence} ({axes} axes, {' '.join(columns)}) in {unit}"
            writings.append(Writing(misfit, what, {"measurements.orientation": orientation}, rotation, unit))
    return sorted(writings, key=lambda writing: writing.misfit)


def matrix_writings(columns: MatrixColumns, values: dict[str, np.ndarray], reading: TableReading) -> list[Writing]:
    """Writings as a matrix row by row, or by column where cells are counted through; values (N,) each, best fit first."""
    writings = []
    for names in columns.rotation:
        cells = np.column_stack([values[name] for name in names])
        R = _whole(cells).reshape(-1, 3, 3)
        deviation = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        rotations = (deviation < MATRIX_SLACK) & (np.linalg.det(R) > 0)
        if rotations.mean() < LEAST_ROTATION_SHARE:
            continue
        rotation = Rotation.from_matrix(np.where(rotations[:, None, None], R, R[np.argmax(rotations)]))
        cells = np.where(rotations[:, None], cells, np.nan)
        what = f"a rotation matrix ({names[0]} {names[1]} {names[2]} its first row)"
        keys: dict[str, Any] = {"measurements.orientation": {"matrix": list(names)}}
        writings.append(Writing(_misfit(rotation, cells, reading), what, keys, rotation))
    return sorted(writings, key=lambda writing: writing.misfit)


def different(ways: Sequence[Writing]) -> list[Writing]:
    """Writings whose rotations differ from those of every writing before."""
    distinct: list[Writing] = []
    for way in ways:
        if not any(
            np.max((way.rotation * other.rotation.inv()).magnitude()) < SAME_ROTATION
            for other in distinct[:WAYS_COMPARED]
        ):
            distinct.append(way)
    return distinct


def _sequences(family: Family) -> Iterator[tuple[str, list[int]]]:
    """Sequences of axes to try, and the columns in their order."""
    names_its_axis = (
        family.columns[0].lower().split("[")[0].split("(")[0].strip(" _").endswith(("x", "roll", "x deg", "x rad"))
    )
    for sequence in AXIS_SEQUENCES if names_its_axis else PLAIN_SEQUENCES:
        by_axis = ["xyz".index(letter) for letter in sequence.lower()]
        yield sequence, by_axis if names_its_axis else [0, 1, 2]


def _read(sample: Sample, robot: Robot, angle: str, length: str, travel: str, per: str | None) -> TableReading:
    """Fit the unknown frames for one way to read the columns, and see how far the targets then are."""
    R, p = tip_frames(robot, _si_readings(sample, angle, travel))
    m = sample.position * LENGTHS[length]
    one_frame = np.zeros(len(m), dtype=int)
    world, tip = (sample.station if per == where else one_frame for where in ("world_base", "tip_target"))
    hints = (pin.SE3.Identity(),) * (int(tip.max()) + 1)
    starts = []
    for start in start_frames(PoseRows(R, p, None, m, world, tip), None, None, hints):
        turn = np.array([frame.rotation for frame in start.world_base])[world]
        shift = np.array([frame.translation for frame in start.world_base])[world]
        lever = np.array([frame.translation for frame in start.tip_target])[tip]
        in_base = p + np.einsum("nij,nj->ni", R, lever)
        target = np.einsum("nij,nj->ni", turn, in_base) + shift
        distance = np.linalg.norm(m - target, axis=1)
        starts.append((float(np.median(distance)), turn))
    metres, turn = min(starts, key=lambda start: start[0])
    share = metres / max(_spread(m), LEAST_READING_SPREAD)
    return TableReading(angle, length, travel, per, metres, share, turn, R)


def _misfit(measured: Rotation, values: np.ndarray, reading: TableReading) -> float:
    """Median angle between measured orientations and the nominal robot's, the target's own being free, [rad].

    The target's orientation on the tip, R_tip_target = (R_world_base R_base_tip)' R_measured, should be the same in every
    row: what counts is how far it is from its mean.
    """
    nominal = reading.world @ reading.tip
    on_tip = Rotation.from_matrix(np.einsum("nji,njk->nik", nominal, measured.as_matrix()))
    angle = np.atleast_1d((on_tip.mean().inv() * on_tip).magnitude())
    whole = np.isfinite(values).all(axis=1)
    return float(np.median(angle[whole]))


def _whole(values: np.ndarray) -> np.ndarray:
    """Values with each row that has holes replaced by the first whole row; such rows do not count."""
    whole = np.isfinite(values).all(axis=1)
    first = values[np.argmax(whole)]
    return np.where(whole[:, None], values, first)
