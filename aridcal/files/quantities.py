"""A table of a user as quantities in SI: which column holds what, and which rows cannot be used."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from aridcal.engine.corrections.effect import ROW_ORDER
from aridcal.engine.instruments import pose
from aridcal.engine.robot.chain import JointKind
from aridcal.engine.rows.remarks import Remark
from aridcal.files.counting import counting
from aridcal.files.measurement_settings import MeasurementSettings
from aridcal.files.orientations import (
    IDENTITY,
    MATRIX_SLACK,
    POSITION_COLUMNS,
    QUATERNION,
    QUATERNION_SLACK,
    column_of,
    normalised,
    orientation_columns,
    quaternions_of_matrices,
    swap_direction,
    turned,
)  # fmt: skip
from aridcal.files.yaml_file import FINEST, LARGEST_SETTING
from aridcal.system.errors import CampaignError, MeasurementError, has_controls, nearest
from aridcal.system.reading.user_names import LONGEST_NAME

if TYPE_CHECKING:
    from aridcal.files.tables import Table

STD = ("std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz")
POSE_OR_LABEL = (*POSITION_COLUMNS, *QUATERNION, *STD, "station", "split")
QUANTITIES = (*POSE_OR_LABEL, "time", "temperature", "payload")

# Words in names of columns that a controller computes from its own joints: ``actual_TCP_pose`` of UR's real-time data.
COMPUTED = frozenset(("actual", "tcp", "pose"))

# Factors of a quaternion's numbers that give the inverse rotation.
CONJUGATE = (-1.0, -1.0, -1.0, 1.0)

# Two columns of one orientation that are farther apart disagree, [rad]; rounding to three decimals is allowed.
SAME_ORIENTATION = 1e-3
# A covariate that large is a hole: some programs write 1e308 for an unknown value.
LEAST_HOLE = 1e30
# Why a joint may not have a column.
STATED_JOINT = "`robot.joints` or `robot.coupled` says where this joint is in all rows"
# More than an angle of a pose, or a joint with limits, turns, [rad].
TWO_TURNS = 4 * np.pi


def computed(settings: MeasurementSettings) -> tuple[str, ...]:
    """Columns of the measured position whose names say that a controller has worked them out from its joints."""
    names = [settings.columns.get(name, name) for name in POSITION_COLUMNS]
    return tuple(name for name in names if set(re.findall("[a-z]+", name.lower())) >= COMPUTED)


@dataclass
class TableSource:
    """A table while it is read: which rows are still usable, and the remarks on the others.

    Attributes:
        table: The cells.
        settings: Which column holds which quantity, in which unit.
        joint_names: Joints whose readings are columns of the table.
        kinds: Kind of each joint: prismatic ones are in units of length; limits of a ``continuous`` one count whole turns.
        limits: Lower and upper limit of each joint, shape (columns, 2), [rad] or [m].
        origin: The file that the settings come from, for messages.
        stated: Joints with a position in `robot.joints` or `robot.coupled`: they have no column.
        usable: Rows without a fault so far in the cells that are needed, shape (N,) bool.
        refused: Remarks on the other rows.
        notices: Remarks on cells that are odd but used.
        used: Columns that hold a quantity already.
    """

    table: Table
    settings: MeasurementSettings
    joint_names: tuple[str, ...]
    kinds: Sequence[JointKind]
    limits: np.ndarray
    origin: str
    stated: Collection[str] = ()
    usable: np.ndarray = field(init=False)
    refused: list[Remark] = field(init=False)
    notices: list[Remark] = field(init=False, default_factory=list)
    used: set[str] = field(init=False, default_factory=set)

    def __post_init__(self) -> None:
        self.usable = np.ones(len(self.table), dtype=bool)
        self.refused = list(self.table.refused)
        directions = [f"{joint}_direction" for joint in self.joint_names]
        quantities = (*QUANTITIES, *self.settings.own_columns, *directions)
        names = (*self.joint_names, *quantities)
        for name in self.settings.columns:
            if name in self.stated:
                raise CampaignError(
                    f"{self.origin}: measurements.columns.{name}: {STATED_JOINT}. Delete it here or there"
                )
            if name not in names and not name.startswith(("temperature_", "payload_")):
                raise CampaignError(
                    f"{self.origin}: measurements.columns.{name}: is neither a joint of the chain nor a quantity"
                    f"{nearest(name, names)}"
                )
        for joint in self.joint_names:
            like_a_quantity = joint in quantities or joint.startswith("temperature_")
            if like_a_quantity and self.settings.columns.get(joint, joint) == joint:
                raise CampaignError(
                    f"{self.origin}: the joint {joint!r} has the name of a quantity; "
                    f"say under measurements which column is the joint: `columns: {{{joint}: COLUMN}}`"
                )

    @property
    def joint_columns(self) -> list[str]:
        """Column of each joint."""
        return [self.settings.columns.get(joint, joint) for joint in self.joint_names]

    def column(self, quantity: str) -> str:
        """Column that holds a quantity."""
        return column_of(quantity, self.settings, self.joint_names)

    def refuse(self, bad: np.ndarray, column: str, why: str, value: np.ndarray | None = None) -> None:
        """Refuse rows that are still usable.

        Args:
            bad: Rows with the fault, shape (N,) bool.
            column: Column of the fault.
            why: The fault, for messages.
            value: Number that several cells of a row amount to, shape (N,), to be shown in place of one cell.
        """
        rows = np.flatnonzero(bad & self.usable)
        shown = len(rows) * [None] if value is None else [f"{of_row:.6g}" for of_row in value[rows].tolist()]
        cells = zip(rows.tolist(), shown, strict=True)
        self.refused += [self.table.remark(row, column, why, cell) for row, cell in cells]
        self.usable[rows] = False

    def refusals(self) -> tuple[Remark, ...]:
        """All refusals in the order of the files."""
        rank = {path.name: k for k, path in enumerate(self.table.files)}
        return tuple(sorted(self.refused, key=lambda remark: (rank[remark.file], remark.row or 0)))

    def note(self, column: str, why: str) -> None:
        """Add a remark on a column, or on the whole table."""
        self.notices.append(Remark(self.table.files[0].name, None, column, "", why))

    def joints(self, needed: np.ndarray | None = None) -> np.ndarray:
        """All readings, shape (N, columns), [rad] or [m]; rows that lack one that they need are refused.

        Args:
            needed: Which joints a row needs, shape (N, columns) bool: the others are 0 where a cell is empty; None: all.

        Raises:
            MeasurementError: a joint that is needed has no column.
        """
        needed = np.ones((1, len(self.joint_names)), dtype=bool) if needed is None else needed
        columns = [self.joint_columns[k] for k in np.flatnonzero(needed.any(axis=0)).tolist()]
        advice = "Name them as in the URDF, or map them under measurements.columns; `aridcal init` finds which is which"
        self.table.require(columns, advice)
        if needed.all():
            scales = counting(self.settings, self.joint_names, self.kinds)
            return scales.of_shown(self.needed(columns, scales.unit))
        q = self.seeds()
        for k, name in enumerate(self.joint_columns):
            self.refuse(needed[:, k] & np.isnan(q[:, k]), name, "not a number, and the joint is on the row's path")
        return np.where(np.isnan(q), 0.0, q)

    def seeds(self) -> np.ndarray:
        """Readings to start from, shape (N, columns), [rad] or [m], NaN where a cell is empty; no row is refused."""
        values = np.full((len(self.table), len(self.joint_names)), np.nan)
        scales = counting(self.settings, self.joint_names, self.kinds)
        for k, name in enumerate(self.joint_columns):
            if name in self.table.cells:
                self._take([name])
                numbers, _ = self.table.numbers(name)
                shown = numbers * scales.unit[k]
                values[:, k] = np.where(np.abs(shown) <= LARGEST_SETTING, shown, np.nan)
        return scales.of_shown(values)

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured poses of the target in the world: positions, shape (N, 3), [m], and unit quaternions, shape (N, 4).

        Raises:
            MeasurementError: as :meth:`position` and :meth:`quaternion`.
        """
        position, quaternion = self.position(), self.quaternion()
        if self.settings.inverted is None:
            return position, quaternion
        with np.errstate(invalid="ignore"):  # of cells that are refused
            _, p = swap_direction(pose.turned(quaternion).as_matrix(), position, self.settings.inverted)
        return p, quaternion * CONJUGATE

    def position(self) -> np.ndarray:
        """Positions as the columns have them, shape (N, 3), [m]; rows that lack one are refused.

        Raises:
            MeasurementError: there are no such columns.
        """
        columns = [self.column(name) for name in POSITION_COLUMNS]
        self.table.require(columns, "Name them x y z, or map them under measurements.columns")
        return self.needed(columns, [self.settings.units.scale(name, "length") for name in columns])

    @property
    def orientation_columns(self) -> list[str]:
        """Columns of the campaign's orientations: see :func:`orientations.orientation_columns`."""
        return list(orientation_columns(self.settings, self.joint_names))

    def quaternion(self) -> np.ndarray:
        """Orientations as the columns have them, as unit quaternions, shape (N, 4); rows that have none are refused.

        Raises:
            MeasurementError: there are no such columns, or their angles are in another unit.
        """
        columns = self.orientation_columns
        advice = "Say under measurements how orientations are given (`orientation`), or `kind: position`"
        self.table.require(columns, advice)
        if self.settings.orientation.angles:
            return self._from_angles(columns)
        cells = self.needed(columns, 1.0)
        if self.settings.orientation.matrix:
            quaternion, off = quaternions_of_matrices(cells, self.usable)
            self.refuse(off > MATRIX_SLACK, f"{columns[0]} … {columns[-1]}", "the matrix is no rotation", off)
        else:
            quaternion, norm = normalised(cells, self.usable)
            off = np.abs(norm - 1)
            self.refuse(off > QUATERNION_SLACK, " ".join(columns), "the norm of the quaternion is not 1", norm)
        return np.where(self.usable[:, None], quaternion, IDENTITY)

    def _from_angles(self, columns: list[str]) -> np.ndarray:
        """Columns of Euler angles or of a rotation vector as unit quaternions, shape (N, 4)."""
        angles = self.needed(columns, self._angle_scales(columns))
        angles = np.where(self.usable[:, None], angles, 0)
        largest = np.abs(angles[self.usable]).max(axis=1, initial=0)
        if len(largest) and np.mean(largest > TWO_TURNS) > 0.5:
            raise self.wrong_unit(columns, "angle", float(np.abs(angles).max()))
        return np.asarray(turned(angles, self.settings).as_quat())

    def refuse_second_orientation(self) -> None:
        """Refuse a table of Euler angles, rotation vectors or matrices whose quaternions are other orientations.

        Raises:
            MeasurementError: the two differ by more than rounding in some row.
        """
        first, second = self.orientation_columns, [self.column(name) for name in QUATERNION]
        if first == second or not all(self.has(name) for name in (*first, *second)):
            return
        scales = self._angle_scales(first) if self.settings.orientation.angles else 1.0
        angles, quaternions = self.table.matrix(first) * scales, self.table.matrix(second)
        whole = np.isfinite(angles).all(axis=1) & (np.linalg.norm(quaternions, axis=1) > 0.5)  # neither holes nor zeros
        rows = np.flatnonzero(self.usable & whole)
        if not len(rows):
            return
        difference = turned(angles[rows], self.settings) * pose.turned(quaternions[rows]).inv()
        apart = np.atleast_1d(difference.magnitude())
        worst = int(np.argmax(apart))
        if apart[worst] > SAME_ORIENTATION:
            raise MeasurementError(
                f"{self.table.title}, line {self.table.line[rows[worst]]}: {' '.join(first)} and {' '.join(second)} are "
                f"two orientations, {np.degrees(apart[worst]):.3g} degrees apart. Delete one of them; the campaign's own "
                f"is {' '.join(first)}"
            )

    def std(self) -> np.ndarray | None:
        """1-sigma of the rows, shape (N, 6): position in [m], then rotation vector in [rad].

        Returns:
            Ones for the half without columns; `None` if neither half has columns, or the campaign ignores them.

        Raises:
            MeasurementError: one or two of three columns are there, or none though the campaign relies on them.
        """
        noise, units = self.settings.noise, self.settings.units
        if noise.rows == "ignore":
            return None
        halves: list[tuple[slice, Literal["length", "angle"]]] = [(slice(0, 3), "length"), (slice(3, 6), "angle")]
        halves = halves[:1] if self.settings.traits.place_alone else halves
        std = np.ones((len(self.table), 6))
        count = 0
        for half, of in halves:
            columns = [self.column(name) for name in STD[half]]
            if any(self.has(name) for name in columns):
                if self.settings.inverted == "pose" or (self.settings.inverted and of == "angle"):
                    raise CampaignError(
                        f"{self.origin}: measurements.inverted: the columns {' '.join(columns)} are then those of the other way "
                        "round, which are not read; write `noise: {rows: ignore}`"
                    )
                self.table.require(columns, "Give all three, or write `noise: {rows: ignore}`")
                std[:, half] = self.needed(columns, [units.scale(name, of) for name in columns])
                for sigma, name in zip(std[:, half].T, columns, strict=True):
                    self.refuse(sigma <= 0, name, "a sigma must be positive")
                    self.refuse(sigma < FINEST, name, "a sigma that small is none")
                count += 1
        if noise.rows == "absolute" and count < len(halves):
            raise MeasurementError(f"{self.table.title}: `noise: {{rows: absolute}}` needs the std_* columns")
        return std if count else None

    def labels(self, quantity: str, needed: str = "", filled: bool = False) -> np.ndarray | None:
        """A column of words, shape (N,); `None` if there is none.

        Args:
            quantity: ``station``, ``split``, ``target``, or a role of things that rows of the kind refer to.
            needed: The setting that needs it, ``station`` or a kind; then rows without a word are refused.
            filled: True if rows without a word are refused wherever there is such a column.

        Raises:
            MeasurementError: it is needed, but not there.
        """
        name = self.column(quantity)
        if needed:
            self.table.require([name], f"`{'per' if quantity == 'station' else 'kind'}: {needed}` needs it")
        elif not self.has(name):
            return None
        self._take([name])
        words = self.table.texts(name)
        unsafe = np.array([has_controls(word) or len(word) > LONGEST_NAME for word in words.tolist()], dtype=bool)
        self.refuse(unsafe, name, "a label with control characters, or too long")
        if needed or filled:
            self.refuse(words == "", name, "empty")
        return words

    def split(self) -> np.ndarray | None:
        """Rows that the file itself keeps for the test, shape (N,) bool; `None` if it does not say."""
        words = self.labels("split")
        if words is None:
            return None
        neither = (words != "train") & (words != "test")
        self.refuse(neither, self.column("split"), "neither train nor test")
        return words == "test"

    def covariates(self) -> dict[str, np.ndarray]:
        """Every numeric column that holds no other quantity, by its quantity, shape (N,), NaN in its holes.

        To be called last: columns that other methods have read are no covariates.

        Raises:
            MeasurementError: a column is of a joint whose position the campaign states.
        """
        quantities = {column: quantity for quantity, column in self.settings.columns.items()}
        covariates = {}
        for name in self.table.names:
            if not name or name in self.used or name in self.settings.ignore:
                continue
            quantity = quantities.get(name, name)
            if quantity in self.stated:
                raise MeasurementError(
                    f"{self.table.title}: column {name!r}: {STATED_JOINT}. Delete the joint there to use the column, or list the "
                    "column under `measurements.ignore`"
                )
            if quantity == ROW_ORDER:
                self.note(name, "is not used: that is what the order of the rows is called; rename the column")
            elif name not in quantities and name in self.settings.columns:
                self.note(name, f"is not used: {name} is in the column {self.settings.columns[name]!r}")
            elif quantity not in (*POSE_OR_LABEL, *self.settings.own_columns):
                values = self._covariate(name, quantity)
                if values is not None:
                    in_seconds = quantity == "time" and name in self.settings.units.columns
                    covariates[quantity] = values * self.settings.units.scale(name, "time") if in_seconds else values
        return covariates

    def note_unknown_ignored(self) -> None:
        """Name the columns under `ignore` that no file has: slips, perhaps."""
        for name in self.settings.ignore:
            if name not in self.table.cells and name not in self.table.partial:
                self.note(name, "is listed under `ignore`, but there is no such column")

    def _covariate(self, name: str, quantity: str) -> np.ndarray | None:
        """A covariate's values, NaN in its holes, shape (N,); `None` for a column of words."""
        numbers, is_text = self.table.numbers(name)
        holes = ~(np.abs(numbers) < LEAST_HOLE)
        if quantity.removesuffix("_direction") in self.joint_names:
            holes |= ~np.isin(numbers, (-1, 0, 1))
        filled = np.sum(~holes)
        if filled == 0 or is_text.sum() > filled:
            self.note(name, "is not numeric: no effect can depend on it")
            return None
        if holes.any():
            self._note_holes(name, holes)
        return np.where(holes, np.nan, self.settings.sense(quantity) * numbers)

    def _note_holes(self, name: str, holes: np.ndarray) -> None:
        """Name the first cell of a covariate that holds something but counts as empty."""
        odd = np.flatnonzero(holes & (self.table.texts(name) != ""))
        if not len(odd):
            return
        more = f", like {len(odd) - 1} more in this column" if len(odd) > 1 else ""
        self.notices.append(self.table.remark(int(odd[0]), name, f"is read as missing{more}"))

    def wrong_unit(self, columns: Sequence[str], unit: Literal["angle", "length"], largest: float) -> MeasurementError:
        """The error for columns that cannot be in the stated unit; `largest` in [rad] or [m]."""
        units = self.settings.units
        unit_name, unit_size = (units.angle, units.radians) if unit == "angle" else (units.length, units.metres)
        usual = "in degrees, write `units: {angle: deg}`" if unit == "angle" else "in mm, write `units: {length: mm}`"
        remedy = usual if unit_name not in ("deg", "mm") else "in another unit, name that in `units`"
        names = ", ".join(repr(name) for name in columns)
        return MeasurementError(
            f"{self.table.title}: column {names} cannot be in {unit_name}: values up to {largest / unit_size:.6g}. "
            f"If they are {remedy} under measurements"
        )

    def needed(self, columns: Sequence[str], scale: Sequence[float] | np.ndarray | float) -> np.ndarray:
        """Columns in SI, shape (N, columns); rows with a cell that is no sensible number are refused.

        Args:
            columns: Their names.
            scale: SI units in one of the table's, of each column or of all.
        """
        self._take(columns)
        scales = np.broadcast_to(scale, len(columns))
        values = np.empty((len(self.table), len(columns)))
        for k, name in enumerate(columns):
            with np.errstate(over="ignore", invalid="ignore"):  # of cells that are refused
                values[:, k] = self._finite(name) * scales[k]
            too_large = np.abs(values[:, k]) > LARGEST_SETTING
            self.refuse(too_large, name, "implausibly large")
        return values

    def _finite(self, name: str) -> np.ndarray:
        """A column's numbers, shape (N,); rows without one are refused."""
        numbers, is_text = self.table.numbers(name)
        if is_text.any() and (why := self.table.written_otherwise(name, is_text)):
            raise MeasurementError(f"{self.table.title}: column {name!r} {why}")
        self.refuse(is_text, name, "not a number")
        missing = ~np.isfinite(numbers)
        if missing.any():
            empty = self.table.texts(name) == ""
            self.refuse(missing & empty, name, "empty")
            self.refuse(missing, name, "not finite")
        return numbers

    def _take(self, columns: Collection[str]) -> None:
        for name in columns:
            if name in self.used:
                raise CampaignError(
                    f"{self.origin}: the column {name!r} would be two quantities; map it to one under measurements.columns"
                )
            self.used.add(name)

    def has(self, name: str) -> bool:
        """True of a column that is there and not ignored."""
        return name in self.table.cells and name not in self.settings.ignore

    def _angle_scales(self, columns: Sequence[str]) -> list[float]:
        """Radians in one of the unit of each column."""
        return [self.settings.units.scale(name, "angle") for name in columns]
