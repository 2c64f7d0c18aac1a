"""``measurements`` of a campaign: what a table holds, in which columns and units."""

from __future__ import annotations

import argparse
import codecs
import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from aridcal.engine.instruments.kind import MeasurementKind
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.files.formats.robot_calibration import FORMAT_NAME
from aridcal.files.yaml_file import FINEST, LARGEST_SETTING, RelativePath, Section
from aridcal.system.errors import CampaignError, nearest, shortened
from aridcal.system.reading.dialect import BLANKS, PLAIN, Dates, Dialect
from aridcal.system.reading.user_names import check_name

# Metres in one of each unit of length.
LENGTHS = MappingProxyType({"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048})

# Channels whose noise rows of poses and positions, and the measuring head, may declare.
OF_POSES = ("position", "rotation")

# Ends the name of the column that says from which side a joint came.
DIRECTION = "_direction"

# Farther than any arm reaches, [m].
BEYOND_REACH = 100.0

# Quantities of a table beside those of its kind: which of several targets was measured, which image was looked at.
TARGET, SHOT = "target", "shot"

# Things whose label every row says itself: there is no usual one.
LABELLED = ("point", "marker", "grasp")

# Radians in one of each unit of angle.
ANGLES = MappingProxyType({"rad": 1.0, "deg": math.pi / 180})

# Seconds in one of each unit of time.
TIMES = MappingProxyType({"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0})

# Radians in one of each unit of a tolerance of angles.
SMALL_ANGLES = MappingProxyType({**ANGLES, "mrad": 1e-3})


AMOUNT = re.compile(r"([-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]+)")
"""A number with its unit."""


def amount(text: object) -> tuple[float, str]:
    """A number and its unit as they are written; NaN and no unit where the text is something else."""
    match = AMOUNT.fullmatch(str(text).strip())
    return (float(match[1]), match[2]) if match else (math.nan, "")


def with_unit(text: object, units: Mapping[str, float], example: str) -> float:
    """A positive number with its unit, in SI.

    Args:
        text: ``0.2mm`` for instance.
        units: SI units in one of each.
        example: For the message.

    Raises:
        ValueError: it is none, or has no unit.
    """
    number, unit = amount(text)
    if unit not in units or not 0.0 < number < LARGEST_SETTING:
        raise ValueError(
            f"should be a number with its unit ({', '.join(units)}), {example} for instance, not {shortened(str(text))!r}"
        )
    return number * units[unit]


def length_argument(text: str) -> float:
    """A length of the command line with its unit, in metres: the ``type`` of an argument of argparse."""
    try:
        return with_unit(text, LENGTHS, "0.2mm")
    except ValueError as problem:
        raise argparse.ArgumentTypeError(str(problem)) from None


def one_of(names: Any) -> AfterValidator:
    """A check that a word is one of some names."""

    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"{name!r} is unknown{nearest(name, names)}")
        return name

    return AfterValidator(check)


def listed(value: Any) -> Any:
    """Let one value stand for a list of one."""
    return value if value is None or isinstance(value, list | tuple) else (value,)


Names = Annotated[tuple[str, ...], BeforeValidator(listed)]


Sigma = Annotated[float, Field(ge=FINEST, le=1e3)]


class NoiseSettings(Section):
    """1 sigma per axis, of the channels that the kind has; what is absent is estimated."""

    position: Sigma | None = None
    """m"""
    rotation: Sigma | None = None
    """rad"""
    distance: Sigma | None = None
    """m"""
    pixel: Sigma | None = None
    """px"""
    inclination: Sigma | None = None
    """rad"""
    rows: Literal["relative", "absolute", "ignore"] = "relative"
    """The `std_*` columns: only their ratios count and a common scale is estimated; as they are; not at all."""


SEPARATORS = {"tab": "\t", "blanks": BLANKS, ",": ",", ";": ";", "|": "|"}

THOUSANDS = {"": "", ".": ".", ",": ",", "'": "'", "blank": " "}

LAST_LINE = 100_000
"""Last line that a header may have."""


def _of_text(encoding: str) -> str:
    try:
        if not codecs.lookup(encoding)._is_text_encoding:
            raise LookupError
    except (LookupError, ValueError):
        raise ValueError(
            f"{encoding!r} is no encoding of text that is known; utf-8, utf-16 or cp1252 for instance"
        ) from None
    return encoding


def _can_be_shown(name: str) -> str:
    check_name(name, "measurements.table", CampaignError)
    return name


Name = Annotated[str, AfterValidator(_can_be_shown)]

LineNumber = Annotated[int, Field(ge=1, le=LAST_LINE)]


class DatesSettings(Section):
    """Columns that hold dates or times of day: they become one of seconds."""

    order: Literal["ymd", "dmy", "mdy"] = "ymd"
    """Order of day, month and year where all three are numbers; never guessed."""
    columns: Annotated[tuple[Name, ...], BeforeValidator(listed), Field(min_length=1, max_length=2)]
    """One column, or two: `[Datum, Uhrzeit]`."""


class TableSettings(Section):
    """How the files are written."""

    sheet: Name = ""
    """Sheet of a workbook with several; sensor of an `export: robot_calibration`."""
    encoding: Annotated[str, AfterValidator(_of_text)] = "utf-8"
    """`utf-16`, `cp1252`, … ; a byte order mark is allowed."""
    separator: Literal["tab", "blanks", ",", ";", "|"] = ","
    """`blanks`: any number of them."""
    decimal: Literal[".", ","] = "."
    """Decimal sign."""
    thousands: Literal["", ".", ",", "'", "blank"] = ""
    """Sign between groups of three digits; only such groups are read so."""
    header: Annotated[tuple[LineNumber, ...], BeforeValidator(listed), Field(min_length=1, max_length=8)] = (1,)
    """Lines whose cells name the columns, put together with blanks: `[3, 4]` for `Tool X`."""
    first_row: LineNumber | None = None
    """Line of the first row; default: below the header."""
    comment: Annotated[tuple[Annotated[str, Field(min_length=1, max_length=60)], ...], BeforeValidator(listed)] = ()
    """Beginnings of lines that are no rows; a header line may begin so."""
    names: tuple[Name, ...] = ()
    """Names of the columns, in place of a header; then `first_row` says where rows begin."""
    lists: dict[Name, Annotated[tuple[Name, ...], Field(min_length=1)]] = Field(default_factory=dict)
    """Columns of cells such as `p[0.1, 0.2, …]`, and names for their numbers: `{pose: [x, y, z, rx, ry, rz]}`."""
    dates: DatesSettings | None = None
    export: Literal["", "robot_calibration"] = ""
    """Samples of ROS's robot_calibration as YAML."""

    @model_validator(mode="after")
    def _consistent(self) -> TableSettings:
        if self.decimal == self.thousands:
            raise ValueError("thousands: is the decimal sign, too; write what is in the file")
        if self.first_row is not None and not self.names and self.first_row <= max(self.header):
            raise ValueError(f"first_row: should be below the header, line {max(self.header)}")
        return self

    @property
    def dialect(self) -> Dialect:
        """For whoever reads the files."""
        header = () if self.names else tuple(sorted(self.header))
        return Dialect(
            encoding=self.encoding,
            separator=SEPARATORS[self.separator],
            decimal=self.decimal,
            thousands=THOUSANDS[self.thousands],
            header=header,
            first_row=self.first_row or 0,
            comment=self.comment,
            sheet=self.sheet,
            names=self.names,
            lists=dict(self.lists),
            dates=Dates(self.dates.order, self.dates.columns) if self.dates else None,
            export=FORMAT_NAME if self.export else "",
        )

    @property
    def is_plain(self) -> bool:
        """True where the files are plain csv."""
        return self.dialect == PLAIN

    def remarks_on(self, *written: Path) -> list[str]:
        """What is said of csv files that are written where the campaign's own tables are written otherwise."""
        tables = [] if self.is_plain else [str(path) for path in written if path.suffix.lower() == ".csv"]
        return [
            f"{path}: plain csv, commas and decimal points; commands read it beside the campaign's own tables"
            for path in tables
        ]


class Units(Section):
    """Units of the measurement files."""

    length: Annotated[str, one_of(LENGTHS)] = "m"
    """`m cm mm um in ft`: positions, distances, prismatic joints; never pixels."""
    angle: Annotated[str, one_of(ANGLES)] = "rad"
    """`rad deg`: joints, Euler angles, rotation vectors, `std_r*`."""
    columns: dict[str, Annotated[str, one_of({**LENGTHS, **ANGLES, **TIMES})]] = Field(default_factory=dict)
    """Of single columns that differ: `{rx: deg, stamp: ms}`; times `s ms us ns min h`."""

    @property
    def metres(self) -> float:
        """Metres in the file's unit of length."""
        return LENGTHS[self.length]

    @property
    def radians(self) -> float:
        """Radians in the file's unit of angle."""
        return ANGLES[self.angle]

    def scale(self, column: str, of: Literal["length", "angle", "time"]) -> float:
        """SI units in one unit of a column.

        Raises:
            CampaignError: the column's own unit is of another quantity.
        """
        usual, units = {
            "length": (self.length, LENGTHS), "angle": (self.angle, ANGLES), "time": ("s", TIMES)
        }[of]  # fmt: skip
        unit = self.columns.get(column, usual)
        if unit not in units:
            raise CampaignError(
                f"measurements.units.columns.{column}: {unit} is no unit of {of}; write one of {', '.join(units)}"
            )
        return units[unit]

    def joint(self, column: str, kind: str) -> float:
        """Radians, or metres of a prismatic joint, in one of the unit of a joint's column."""
        return self.scale(column, "length" if kind == "prismatic" else "angle")


SEQUENCE = re.compile(r"(?!.*(.)\1)([xyz]{3}|[XYZ]{3})")
"""Axes of Euler angles in scipy's letters: three of one case, none twice in a row."""

HOW_WRITTEN = (
    "write quaternion, {euler: XYZ, columns: [rx, ry, rz]}, {rotvec: [rx, ry, rz]} or {matrix: [r11, r12, r13, …]}"
)
"""Ways to write an orientation."""


class Orientation(Section):
    """How the files hold orientations. Neither `euler` nor `rotvec` nor `matrix`: as the quaternion `qx qy qz qw`."""

    euler: str | None = None
    """Axes in scipy's letters: capitals (`XYZ`) turn with the body, small ones (`xyz`) are fixed."""
    columns: tuple[str, str, str] | None = None
    """Columns of the three Euler angles."""
    rotvec: tuple[str, str, str] | None = None
    """Columns of the rotation vector."""
    matrix: tuple[str, str, str, str, str, str, str, str, str] | None = None
    """Columns of the rotation matrix, row by row."""

    @field_validator("euler")
    @classmethod
    def _scipy_letters(cls, euler: str | None) -> str | None:
        if euler is not None and not SEQUENCE.fullmatch(euler):
            raise ValueError(f"{euler!r} is no sequence of axes; write XYZ (turning with the body) or xyz (fixed axes)")
        return euler

    @model_validator(mode="after")
    def _complete(self) -> Orientation:
        ways = sum(way is not None for way in (self.euler, self.rotvec, self.matrix))
        if ways > 1 or (self.euler is None) != (self.columns is None):
            raise ValueError(HOW_WRITTEN)
        return self

    @property
    def angles(self) -> tuple[str, ...] | None:
        """Columns of Euler angles or of a rotation vector; `None` where there are neither."""
        return self.columns or self.rotvec

    @property
    def own(self) -> tuple[str, ...] | None:
        """Columns of angles or of a matrix; `None` where there is a quaternion."""
        return self.angles or self.matrix


class JointColumn(Section):
    """How the column of a joint counts, where not as the URDF does."""

    sign: Literal[1, -1] = 1
    """-1: the column grows where the URDF's joint falls."""
    zero: str | None = None
    """What the column shows where the URDF's joint is at 0, with its unit, `90deg`; the joint is sign × (column -
    zero)."""

    @field_validator("sign", mode="before")
    @classmethod
    def _a_number(cls, sign: object) -> object:
        if isinstance(sign, bool):  # which Python takes for a 1
            raise ValueError("should be 1 or -1")
        return sign

    @field_validator("zero", mode="before")
    @classmethod
    def _has_its_unit(cls, zero: object) -> object:
        number, unit = amount(zero)
        if unit not in {**ANGLES, **LENGTHS} or abs(number) > LARGEST_SETTING:
            raise ValueError(
                f"should be a number with its unit ({', '.join([*ANGLES, *LENGTHS])}), 90deg for instance: what the column shows "
                f"where the URDF's joint is at 0; not {shortened(str(zero))!r}"
            )
        return "".join(str(zero).split())

    @property
    def zero_unit(self) -> str:
        """The unit of `zero`; empty without it."""
        return amount(self.zero)[1]

    @property
    def shown_at_zero(self) -> float:
        """`zero` in [rad] or [m]."""
        number, unit = amount(self.zero or "0rad")
        return number * {**ANGLES, **LENGTHS}[unit]


class MeasurementSettings(Section):
    """Where the measured rows are and how to read them."""

    files: Annotated[tuple[RelativePath, ...], BeforeValidator(listed)] = Field(default=(), alias="file")
    """Table or tables: `.csv`, `.parquet`, `.xlsx`, or text with `table`; required, but for `camera_sonar`."""
    head: RelativePath | None = None
    """`head.yaml` of the measuring head, for `kind: camera_sonar`, in place of `file`."""
    kind: Annotated[str, one_of(tuple(MEASUREMENT_KINDS))] = "pose"
    """Kind of measurement."""
    name: str | None = None
    """Name of the block; default: its kind. Two blocks of one kind need names."""
    camera: str | None = None
    """Camera that took the images, where the table of `pixels` has no column `camera`."""
    target: str | None = None
    """Target that was measured, where the table has no column `target`."""
    joint_reading: Literal["reported", "commanded"] | None = None
    """Kind of the joints' values; `compensate` gives the same kind."""
    links: tuple[str, str] | None = None
    """The two links that hold one body, for `kind: joined`; rows need the joints between them. A body put down and
    taken up again is another grasp; one row of a grasp tells nothing of the arms; their common scale takes a length (a
    ballbar, a tracker)."""
    noise: NoiseSettings = NoiseSettings()
    columns: dict[str, str] = Field(default_factory=dict)
    """Column of a joint or a quantity where the names differ: `{x: "Tool X"}`; needed for a joint called `x`, `time`,
    …"""
    units: Units = Units()
    joints: dict[str, JointColumn] = Field(default_factory=dict)
    """Joints whose columns count backwards or from another zero: `{joint_3: {sign: -1, zero: 90deg}}`. It holds for
    all tables of the campaign and its calibration: queries, commands, regions, corrections, plans and their programs,
    and the sign of `JOINT_direction`. Programs to be corrected count from the same zeros unless `controller_zeros` or
    `--zeros` says otherwise; with `sign: -1` they need `controller_zeros` of that joint. Limits, constants, zeros in
    the report and waypoints are of the URDF's joints."""
    inverted: Literal["pose", "orientation"] | None = None
    """What the tables hold inverted: T_target_world as a whole, or its orientation alone; for `kind: pose`. `predict`
    writes poses so, `compensate` reads them so; `noise` and the `std_*` that `predict` writes are of the target in the
    world. `std_*` of measured rows are refused where they would be of what is inverted: write `noise: {rows:
    ignore}`."""
    table: TableSettings = TableSettings()
    """How the files are written, where they are no plain csv."""
    orientation: Orientation = Orientation()
    """`quaternion`, or one of the keys below."""
    ignore: Names = ()
    """Columns that are no covariates: row numbers, notes; they need not be there."""

    @field_validator("orientation", mode="before")
    @classmethod
    def _quaternion_by_name(cls, orientation: Any) -> Any:
        if isinstance(orientation, str):
            if orientation != "quaternion":
                raise ValueError(HOW_WRITTEN)
            return {}
        return orientation

    @field_validator("name")
    @classmethod
    def _can_be_shown(cls, name: str | None) -> str | None:
        if name is not None:
            if not name.strip():
                raise ValueError("is empty; give the block a name, or delete the key")
            check_name(name, "measurements", CampaignError)
        return name

    @model_validator(mode="after")
    def _what_the_kind_has(self) -> MeasurementSettings:
        of_poses = self.traits.places
        names = OF_POSES if of_poses else tuple(channel.name for channel in self.traits.channels)
        for channel in sorted(self.noise.model_fields_set - {"rows"} - set(names)):
            raise ValueError(
                f"noise.{channel}: `kind: {self.kind}` has no such channel; write noise of {' and '.join(names)}"
            )
        if self.noise.rows != "relative" and not of_poses:
            raise ValueError(f"noise.rows: `kind: {self.kind}` has no std_* columns; delete this key")
        if self.traits.of_head and not self.table.is_plain:
            raise ValueError(
                "table: `kind: camera_sonar` has its tables in head.yaml, which are plain csv; delete this key"
            )
        if self.inverted is not None and not self.traits.oriented:
            raise ValueError("inverted: belongs to `kind: pose`, whose rows have orientations; delete it")
        joined = self.traits.joins
        if joined and (self.links is None or self.links[0] == self.links[1] or "world" in self.links):
            raise ValueError("links: `kind: joined` needs the two links that hold one body: [left_hand, right_hand]")
        if self.links is not None and not joined:
            raise ValueError("links: belongs to `kind: joined`; delete it")
        if joined and self.target is not None:
            raise ValueError("target: `kind: joined` has no target beside its links; delete it")
        if self.camera is not None and not self.traits.images:
            raise ValueError("camera: belongs to `kind: pixels`; delete it")
        return self

    def sense(self, quantity: str) -> int:
        """-1 for the approach direction of a joint whose column counts backwards, else 1."""
        joint = self.joints.get(quantity.removesuffix(DIRECTION)) if quantity.endswith(DIRECTION) else None
        return 1 if joint is None else joint.sign

    @property
    def traits(self) -> MeasurementKind:
        """Its kind's row of the table of kinds."""
        return MEASUREMENT_KINDS[self.kind]

    @property
    def title(self) -> str:
        """Name of the block."""
        return self.name or self.kind

    @property
    def needs(self) -> set[str]:
        """Columns that a table of this block must have beside the joints."""
        names: tuple[str, ...]
        if self.traits.tracked:
            turned = self.orientation.own or ("qx", "qy", "qz", "qw")
            names = ("x", "y", "z", *(turned if self.traits.oriented else ()))
        else:
            kind = self.traits
            labels = [role.name for role in kind.roles if role.name in (*LABELLED, "plane")]
            names = (*(() if kind.gauges else kind.read), *labels)
        return {self.columns.get(name, name) for name in names}

    @property
    def own_columns(self) -> tuple[str, ...]:
        """Quantities of its kind beside joints, poses and covariates."""
        kind = self.traits
        if kind.of_head:
            return ()
        if kind.tracked:
            return (TARGET,)
        labels = [role.name for role in kind.roles if role.name != "board"]  # which board it is, the camera says
        target = () if kind.bare else (TARGET,)
        return (*kind.read, *labels, *((SHOT,) if kind.images else target))
