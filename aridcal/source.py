"""A table of a user as quantities in SI: which column holds what, and which rows cannot be used."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.campaign import MeasurementSettings
from aridcal.errors import CampaignError, MeasurementError, nearest
from aridcal.tables import DECIMAL_COMMA, Remark, Table

Kind = Literal["revolute", "prismatic", "continuous"]

POSITION = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
STD = ("std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz")
LABELS = ("station", "split")
POSE_OR_LABEL = (*POSITION, *QUATERNION, *STD, *LABELS)
QUANTITIES = (*POSE_OR_LABEL, "time", "temperature", "payload")

QUATERNION_SLACK = 1e-3  # how far from 1 the norm of a measured quaternion may be
ABSURD = 1e9  # no reading and no place is that large, [rad] or [m]
UNUSABLE = 1e30  # a covariate that large is a hole
TURNS = 4 * np.pi  # more than an angle of a pose or a joint with limits turns, [rad]


@dataclass
class Source:
    """A table while it is read: which rows are still usable, and what was said about the others.

    Attributes:
        table: The cells.
        settings: Which column holds which quantity, in which unit.
        joint_names: Joints whose readings are columns of the table.
        origin: The file that the settings come from, for messages.
        usable: Rows in which nothing needed was wrong so far, shape (N,) bool.
        refused: Why the others are not.
        notices: What is odd but used.
        used: Columns that are taken.
    """

    table: Table
    settings: MeasurementSettings
    joint_names: tuple[str, ...]
    origin: str
    usable: np.ndarray = field(init=False)
    refused: list[Remark] = field(init=False)
    notices: list[Remark] = field(init=False, default_factory=list)
    used: set[str] = field(init=False, default_factory=set)

    def __post_init__(self) -> None:
        self.usable = np.ones(len(self.table), dtype=bool)
        self.refused = list(self.table.refused)
        directions = [f"{joint}_direction" for joint in self.joint_names]
        known = (*self.joint_names, *QUANTITIES, *directions)
        for name in self.settings.columns:
            if name not in known and not name.startswith("temperature_"):
                raise CampaignError(
                    f"{self.origin}: measurements.columns.{name}: is no joint of the chain and no quantity"
                    f"{nearest(name, known)}"
                )
        for joint in self.joint_names:
            taken = joint in (*QUANTITIES, *directions) or joint.startswith("temperature_")
            if taken and self.settings.columns.get(joint, joint) == joint:
                raise CampaignError(
                    f"{self.origin}: the joint {joint!r} is named like another column; "
                    f"write under measurements which column it is: `columns: {{{joint}: COLUMN}}`"
                )

    @property
    def joint_columns(self) -> list[str]:
        """Column of each joint."""
        return [self.settings.columns.get(joint, joint) for joint in self.joint_names]

    def column(self, quantity: str) -> str:
        """Column that holds a quantity; where a joint has its name, `columns` speaks of the joint."""
        return quantity if quantity in self.joint_names else self.settings.columns.get(quantity, quantity)

    def refuse(self, bad: np.ndarray, column: str, why: str) -> None:
        """Refuse those of the rows that are still usable."""
        rows = np.flatnonzero(bad & self.usable)
        self.refused += [self.table.remark(row, column, why) for row in rows.tolist()]
        self.usable[rows] = False

    def refusals(self) -> tuple[Remark, ...]:
        """All refusals in the order of the files."""
        rank = {path.name: k for k, path in enumerate(self.table.files)}
        return tuple(sorted(self.refused, key=lambda remark: (rank[remark.file], remark.row or 0)))

    def note(self, column: str, why: str) -> None:
        """Say something about a column, or about the whole table."""
        self.notices.append(Remark(self.table.files[0].name, None, column, "", why))

    def joints(self, kinds: Sequence[Kind]) -> np.ndarray:
        """All readings, shape (N, columns), [rad] or [m]."""
        advice = "Name them as in the URDF, or under measurements.columns; `aridcal init` tells which are which"
        self.table.require(self.joint_columns, advice)
        return self._needed(self.joint_columns, self._scales(kinds))

    def seeds(self, kinds: Sequence[Kind]) -> np.ndarray:
        """Readings where there are some, NaN elsewhere; nothing is refused."""
        values = np.full((len(self.table), len(self.joint_names)), np.nan)
        for k, (name, scale) in enumerate(zip(self.joint_columns, self._scales(kinds), strict=True)):
            if name in self.table.cells:
                self._take([name])
                numbers = self.table.numbers(name)[0] * scale
                values[:, k] = np.where(np.abs(numbers) <= ABSURD, numbers, np.nan)
        return values

    def position(self) -> np.ndarray:
        """Measured positions, shape (N, 3), [m]."""
        columns = [self.column(name) for name in POSITION]
        self.table.require(columns, "Name them x y z, or under measurements.columns")
        return self._needed(columns, self.settings.units.metres)

    def quaternion(self) -> np.ndarray:
        """Measured orientations as unit quaternions, shape (N, 4); rows that have none are refused."""
        spec = self.settings.orientation
        angles = spec.columns or spec.rotvec
        columns = list(angles or [self.column(name) for name in QUATERNION])
        advice = "Say under measurements how orientations are given (`orientation`), or `kind: position`"
        self.table.require(columns, advice)
        if angles:
            return self._from_angles(columns)
        quaternion = self._needed(columns, 1.0)
        norm = np.linalg.norm(np.where(self.usable[:, None], quaternion, (0, 0, 0, 1)), axis=1)
        for row in np.flatnonzero(np.abs(norm - 1) > QUATERNION_SLACK).tolist():
            why = "the norm of the quaternion is not 1"
            self.refused.append(self.table.remark(row, " ".join(columns), why, f"{norm[row]:.6g}"))
            self.usable[row] = False
        return np.where(self.usable[:, None], quaternion, (0, 0, 0, 1)) / np.where(self.usable, norm, 1)[:, None]

    def _from_angles(self, columns: list[str]) -> np.ndarray:
        angles = self._needed(columns, self.settings.units.radians)
        angles = np.where(self.usable[:, None], angles, 0)
        if self.usable.any() and np.mean(np.abs(angles[self.usable]).max(axis=1) > TURNS) > 0.5:
            raise self.wrong_unit(columns, "angle", float(np.abs(angles).max()))
        euler = self.settings.orientation.euler
        turn = Rotation.from_euler(euler, angles) if euler else Rotation.from_rotvec(angles)
        return turn.as_quat()

    def std(self) -> np.ndarray | None:
        """1-sigma of the rows, shape (N, 6), ones for the half that is not given; `None` if neither is wanted."""
        noise, units = self.settings.noise, self.settings.units
        if noise.rows == "ignore":
            return None
        wanted = [(STD[:3], units.metres), (STD[3:], units.radians)][: 1 if self.settings.kind == "position" else 2]
        std = np.ones((len(self.table), 6))
        given = 0
        for k, (names, scale) in enumerate(wanted):
            columns = [self.column(name) for name in names]
            if any(self._has(name) for name in columns):
                self.table.require(columns, "Give all three, or write `noise: {rows: ignore}`")
                std[:, 3 * k : 3 * k + 3] = values = self._needed(columns, scale)
                for value, name in zip(values.T, columns, strict=True):
                    self.refuse(value <= 0, name, "a sigma must be positive")
                given += 1
        if noise.rows == "absolute" and given < len(wanted):
            raise MeasurementError(f"{self.table.title}: `noise: {{rows: absolute}}` needs the std_* columns")
        return std if given else None

    def labels(self, quantity: str, needed: bool = False) -> np.ndarray | None:
        """A column of words, shape (N,); `None` if there is none."""
        name = self.column(quantity)
        if needed:
            self.table.require([name], f"`per: {quantity}` needs it")
        elif not self._has(name):
            return None
        self._take([name])
        words = self.table.texts(name)
        if needed:
            self.refuse(words == "", name, "empty")
        return words

    def split(self) -> np.ndarray | None:
        """Rows that the file itself keeps for the test, shape (N,) bool; `None` if it does not say."""
        words = self.labels("split")
        if words is None:
            return None
        self.refuse((words != "train") & (words != "test"), self.column("split"), "neither train nor test")
        return words == "test"

    def covariates(self) -> dict[str, np.ndarray]:
        """Every numeric column that is nothing else, shape (N,), NaN in its holes. To be called last."""
        mapped = {name: quantity for quantity, name in self.settings.columns.items()}
        found = {}
        for name in self.table.names:
            if not name or name in self.used or name in self.settings.ignore:
                continue
            if name not in mapped and name in self.settings.columns:
                self.note(name, f"is not used: {name} is in the column {self.settings.columns[name]!r}")
            elif (quantity := mapped.get(name, name)) not in POSE_OR_LABEL:
                values = self._covariate(name, quantity)
                if values is not None:
                    found[quantity] = values
        for name in self.settings.ignore:
            if name not in self.table.cells:
                self.note(name, "is to be ignored, but there is no such column")
        return found

    def _covariate(self, name: str, quantity: str) -> np.ndarray | None:
        numbers, text = self.table.numbers(name)
        holes = ~(np.abs(numbers) < UNUSABLE)
        if quantity.removesuffix("_direction") in self.joint_names:
            holes |= ~np.isin(numbers, (-1, 0, 1))
        if holes.all() or text.sum() > np.sum(~holes):
            self.note(name, "is not numeric: no effect can depend on it")
            return None
        if holes.any():
            odd = np.flatnonzero(holes & (self.table.texts(name) != ""))
            if len(odd):
                why = "is taken for a hole" + (f", like {len(odd) - 1} more in this column" if len(odd) > 1 else "")
                self.notices.append(self.table.remark(int(odd[0]), name, why))
        return np.where(holes, np.nan, numbers)

    def wrong_unit(self, columns: Sequence[str], unit: Literal["angle", "length"], largest: float) -> MeasurementError:
        """The error for columns that cannot be in the stated unit; `largest` in [rad] or [m]."""
        units = self.settings.units
        stated, one = (units.angle, units.radians) if unit == "angle" else (units.length, units.metres)
        remedy = "in degrees, write `units: {angle: deg}`" if unit == "angle" else "in mm, write `units: {length: mm}`"
        names = ", ".join(repr(name) for name in columns)
        return MeasurementError(
            f"{self.table.title}: column {names} cannot be in {stated}: values up to {largest / one:.6g}. "
            f"If they are {remedy} under measurements"
        )

    def _needed(self, columns: Sequence[str], scale: Sequence[float] | float) -> np.ndarray:
        """Columns in SI, shape (N, columns); rows with a cell that is no sensible number are refused."""
        self._take(columns)
        scales = np.broadcast_to(scale, len(columns))
        values = np.empty((len(self.table), len(columns)))
        for k, name in enumerate(columns):
            numbers, text = self.table.numbers(name)
            if text.any():
                words = self.table.texts(name)[text]
                if sum(bool(DECIMAL_COMMA.fullmatch(word)) for word in words.tolist()) > len(text) / 2:
                    raise MeasurementError(f"{self.table.title}: column {name!r} has decimal commas; write points")
                self.refuse(text, name, "not a number")
            finite = np.isfinite(numbers)
            if not finite.all():
                self.refuse(~finite & (self.table.texts(name) == ""), name, "empty")
                self.refuse(~finite, name, "not finite")
            values[:, k] = numbers * scales[k]
            self.refuse(np.abs(values[:, k]) > ABSURD, name, "too large to be true")
        return values

    def _take(self, columns: Collection[str]) -> None:
        for name in columns:
            if name in self.used:
                raise CampaignError(f"{self.origin}: the column {name!r} would be two quantities; see measurements")
            self.used.add(name)

    def _has(self, name: str) -> bool:
        return name in self.table.cells and name not in self.settings.ignore

    def _scales(self, kinds: Sequence[Kind]) -> list[float]:
        units = self.settings.units
        return [units.metres if kind == "prismatic" else units.radians for kind in kinds]
