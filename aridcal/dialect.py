"""The dialect of a table: units and the writing of orientations, judged by what the nominal robot makes of them.

A header may lie, and says little. Every way to read the columns that their names allow is tried: the unknown frames are
fitted in closed form, and what counts is how far the targets are then from where the nominal robot has them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.campaign import ANGLES, LENGTHS
from aridcal.columns import Family
from aridcal.residual import Observations
from aridcal.robot import Robot, tip_frames
from aridcal.source import QUATERNION, TURNS
from aridcal.start import start_frames

TRIED_LENGTHS = ("m", "mm", "cm", "in")
MOST_APART = 6.0  # times: a target far out on a tool makes its cloud larger than the tip's, but not by more


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
class Reading:
    """One way to read joints and positions.

    Attributes:
        angle: Unit of the joints that turn.
        length: Unit of the positions.
        travel: Unit of the joints that slide.
        per: The frame that each station has to itself; None: all share both.
        metres: Median distance of the targets from where the nominal robot has them, [m].
        share: The same as a share of the targets' spread.
        world: Rotation of each row's T_world_base, shape (N, 3, 3).
        tip: Rotation of T_base_tip, likewise.
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
        keys: What a campaign says of it; None: the default.
        angle: Unit of its angles; None: it has none.
    """

    misfit: float
    what: str
    keys: dict[str, Any]
    angle: str | None = None


def readings(sample: Sample, robot: Robot) -> list[Reading]:
    """Every way to read joints and positions that is not off by a power of ten, the best fit first."""
    stations = (None, "world_base", "tip_target") if sample.station.any() else (None,)
    angles = tuple(ANGLES) if sample.turning.any() else ("rad",)
    units = [
        (angle, length, travel)
        for angle, length in itertools.product(angles, TRIED_LENGTHS)
        for travel in ((length,) if sample.turning.all() else TRIED_LENGTHS)
    ]
    sizes = np.array([_size(sample, robot, *one) for one in units])
    possible = [one for one, size in zip(units, sizes, strict=True) if size < max(MOST_APART, 1.5 * sizes.min())]
    tried = [_read(sample, robot, *one, per) for per in stations for one in possible]
    return sorted(tried, key=lambda reading: reading.share)


def _size(sample: Sample, robot: Robot, angle: str, length: str, travel: str) -> float:
    """How many times larger or smaller the measured cloud is than the cloud of the nominal robot's tips, at least 1."""
    _, p = tip_frames(robot, _scaled(sample, angle, travel))
    ratio = (_spread(sample.position) * LENGTHS[length] + 1e-9) / (_spread(p) + 1e-9)
    return max(ratio, 1 / ratio)


def _scaled(sample: Sample, angle: str, travel: str) -> np.ndarray:
    return np.asarray(sample.q * np.where(sample.turning, ANGLES[angle], LENGTHS[travel]))


def _spread(points: np.ndarray) -> float:
    """RMS distance from their centre."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def quaternion_writings(family: Family, values: np.ndarray, reading: Reading) -> list[Writing]:
    """Scalar last, or first as well where the columns are only numbered; values of shape (N, 4), best fit first."""
    orders = {"quaternion x y z w": (0, 1, 2, 3)}
    if family.numbers:
        orders["quaternion w x y z"] = (1, 2, 3, 0)
    found = []
    for what, order in orders.items():
        columns = dict(zip(QUATERNION, (family.columns[k] for k in order), strict=True))
        keys = {f"measurements.columns.{quantity}": column for quantity, column in columns.items()}
        same = all(quantity == column for quantity, column in columns.items())
        misfit = _misfit(Rotation.from_quat(_whole(values)[:, order]), values, reading)
        found.append(Writing(misfit, what, {"measurements.orientation": None} if same else keys))
    return sorted(found, key=lambda writing: writing.misfit)


def angle_writings(family: Family, values: np.ndarray, reading: Reading) -> list[Writing]:
    """As a rotation vector and as Euler angles, in both units; values of shape (N, 3), best fit first."""
    found = []
    for unit, one in ANGLES.items():
        if unit == "rad" and np.nanmax(np.abs(values)) > TURNS:
            continue
        angles = _whole(values) * one
        misfit = _misfit(Rotation.from_rotvec(angles), values, reading)
        keys = {"measurements.orientation": {"rotvec": list(family.columns)}}
        found.append(Writing(misfit, f"a rotation vector in {unit}", keys, unit))
        for sequence, order in _sequences(family):
            columns = [family.columns[k] for k in order]
            misfit = _misfit(Rotation.from_euler(sequence, angles[:, order]), values, reading)
            axes = "turning" if sequence.isupper() else "fixed"
            what = f"Euler angles {sequence} ({axes} axes, {' '.join(columns)}) in {unit}"
            found.append(
                Writing(misfit, what, {"measurements.orientation": {"euler": sequence, "columns": columns}}, unit)
            )
    return sorted(found, key=lambda writing: writing.misfit)


def _sequences(family: Family) -> Iterator[tuple[str, list[int]]]:
    """Sequences of axes, and the columns in their order. Fixed xyz is turning ZYX with the columns reversed."""
    if family.columns[0].lower().endswith(("x", "roll")):  # each column names its axis
        for sequence in ("xyz", "XYZ", "XZY", "YXZ", "YZX", "ZXY"):
            yield sequence, ["xyz".index(letter) for letter in sequence.lower()]
    else:
        for sequence in ("ZYX", "xyz", "XYZ", "ZYZ", "ZXZ"):
            yield sequence, [0, 1, 2]


def _read(sample: Sample, robot: Robot, angle: str, length: str, travel: str, per: str | None) -> Reading:
    """Fit the unknown frames for one way to read the columns."""
    R, p = tip_frames(robot, _scaled(sample, angle, travel))
    m = sample.position * LENGTHS[length]
    one = np.zeros(len(m), dtype=int)
    world, tip = (sample.station if per == where else one for where in ("world_base", "tip_target"))
    hints = (pin.SE3.Identity(),) * (int(tip.max()) + 1)
    found = []
    for start in start_frames(R, p, Observations(m, None), world, tip, None, None, hints):
        turn = np.array([frame.rotation for frame in start.world_base])[world]
        shift = np.array([frame.translation for frame in start.world_base])[world]
        lever = np.array([frame.translation for frame in start.tip_target])[tip]
        target = np.einsum("nij,nj->ni", turn, p + np.einsum("nij,nj->ni", R, lever)) + shift
        found.append((float(np.median(np.linalg.norm(m - target, axis=1))), turn))
    metres, turn = min(found, key=lambda f: f[0])
    return Reading(angle, length, travel, per, metres, metres / max(_spread(m), 1e-9), turn, R)


def _misfit(measured: Rotation, values: np.ndarray, reading: Reading) -> float:
    """Median angle between measured orientations and the nominal robot's, the target's own being free, [rad]."""
    seen = np.einsum("nji,njk->nik", reading.world @ reading.tip, measured.as_matrix())
    own = Rotation.from_matrix(seen).mean()
    off = np.atleast_1d((own.inv() * Rotation.from_matrix(seen)).magnitude())
    return float(np.median(off[np.isfinite(values).all(axis=1)]))


def _whole(values: np.ndarray) -> np.ndarray:
    """Values with a whole row in place of each that has holes; such rows do not count."""
    whole = np.isfinite(values).all(axis=1)
    return np.where(whole[:, None], values, values[np.argmax(whole)])
