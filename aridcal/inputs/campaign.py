"""The campaign: one calibration job as `campaign.yaml` describes it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import pandas as pd
from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, field_validator, model_validator

from aridcal.effects.catalogue import KINDS, is_of_head
from aridcal.errors import CampaignError, nearest
from aridcal.inputs.yaml_file import LARGEST, RelativePath, Section, Settings, Vector3, load_settings
from aridcal.reading.names import check_path

# Metres in one of each unit of length.
LENGTHS = MappingProxyType({"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048})

# Radians in one of each unit of angle.
ANGLES = MappingProxyType({"rad": 1.0, "deg": math.pi / 180})


def _one_of(names: Any) -> AfterValidator:
    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"{name!r} is unknown{nearest(name, names)}")
        return name

    return AfterValidator(check)


def _listed(value: Any) -> Any:
    """Let one value stand for a list of one."""
    return value if value is None or isinstance(value, list | tuple) else (value,)


def _all_kinds(candidates: Any) -> Any:
    return tuple(KINDS) if candidates == "all" else _listed(candidates)


# Name of a row of the table of kinds.
EffectKind = Annotated[str, _one_of(KINDS)]

Names = Annotated[tuple[str, ...], BeforeValidator(_listed)]


class RobotSettings(Section):
    """Which chain of which URDF, and where down is."""

    urdf: RelativePath
    base: str | None = None
    """Link where the chain starts; `None`: the URDF's root."""
    tip: str
    gravity: Literal["world"] | Vector3 = (0.0, 0.0, -9.81)
    """In the base frame, m/s²; `world`: along -z of the world frame."""

    @field_validator("gravity", mode="before")
    @classmethod
    def _vector_or_world(cls, gravity: Any) -> Any:
        listed = isinstance(gravity, list | tuple) and len(gravity) == 3
        if gravity != "world" and not (listed and all(type(g) in (int, float) and abs(g) <= LARGEST for g in gravity)):
            raise ValueError("should be `world` or [x, y, z] in m/s²")
        return gravity


class Noise(Section):
    """1-sigma of the measurement per axis; what is absent is estimated."""

    position: float | None = Field(default=None, ge=1e-12, le=1e3)
    """[m]"""
    rotation: float | None = Field(default=None, ge=1e-12, le=1e3)
    """[rad]"""
    rows: Literal["relative", "absolute", "ignore"] = "relative"
    """What the `std_*` columns are taken for."""


class Units(Section):
    """Units of the measurement files."""

    length: Annotated[str, _one_of(LENGTHS)] = "m"
    angle: Annotated[str, _one_of(ANGLES)] = "rad"

    @property
    def metres(self) -> float:
        """Metres in the file's unit of length."""
        return LENGTHS[self.length]

    @property
    def radians(self) -> float:
        """Radians in the file's unit of angle."""
        return ANGLES[self.angle]


class Orientation(Section):
    """How the files hold orientations. Neither `euler` nor `rotvec`: as the quaternion `qx qy qz qw`."""

    euler: str | None = None
    """Axes in scipy's letters: capitals turn with the body."""
    columns: tuple[str, str, str] | None = None
    """Columns of the three Euler angles."""
    rotvec: tuple[str, str, str] | None = None
    """Columns of the rotation vector."""

    @field_validator("euler")
    @classmethod
    def _scipy_letters(cls, euler: str | None) -> str | None:
        if euler is not None:
            one_case = euler in (euler.upper(), euler.lower())
            repeated = any(a == b for a, b in itertools.pairwise(euler))
            if len(euler) != 3 or not one_case or repeated or not set(euler.lower()) <= set("xyz"):
                raise ValueError(
                    f"{euler!r} is no sequence of axes; write XYZ (turning with the body) or xyz (fixed axes)"
                )
        return euler

    @model_validator(mode="after")
    def _complete(self) -> Orientation:
        if self.euler is None and self.rotvec is None and self.columns is None:
            return self
        if (self.euler is None) == (self.rotvec is None) or (self.euler is None) != (self.columns is None):
            raise ValueError("write quaternion, {euler: XYZ, columns: [rx, ry, rz]} or {rotvec: [rx, ry, rz]}")
        return self


class MeasurementSettings(Section):
    """Where the measured rows are and how to read them."""

    files: Annotated[tuple[RelativePath, ...], BeforeValidator(_listed)] = Field(default=(), alias="file")
    head: RelativePath | None = None
    """Settings of the measuring head; for `kind: camera_sonar`."""
    kind: Literal["pose", "position", "camera_sonar"] = "pose"
    joint_reading: Literal["reported", "commanded"] | None = None
    """Whether the joints' columns are what the controller reports or what it was told; `None`: not said."""
    noise: Noise = Noise()
    columns: dict[str, str] = Field(default_factory=dict)
    """Column of a joint or a quantity where the two names differ."""
    units: Units = Units()
    orientation: Orientation = Orientation()
    ignore: Names = ()
    """Columns that are no covariates."""

    @field_validator("orientation", mode="before")
    @classmethod
    def _quaternion_by_name(cls, orientation: Any) -> Any:
        if isinstance(orientation, str):
            if orientation != "quaternion":
                raise ValueError("write quaternion, {euler: XYZ, columns: [rx, ry, rz]} or {rotvec: [rx, ry, rz]}")
            return {}
        return orientation


class FrameSettings(Section):
    """An unknown or a known frame; of an unknown one, `xyz` and `rpy` are a hint."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)
    identify: bool = True
    per: Literal["station"] | None = None
    """`station`: one frame for each value of that column."""

    @model_validator(mode="after")
    def _known_frames_are_one(self) -> FrameSettings:
        if self.per and not self.identify:
            raise ValueError("`per: station` makes sense only with `identify: true`")
        return self


class Frames(Section):
    """T_world_base and T_tip_target."""

    world_base: FrameSettings = FrameSettings()
    tip_target: FrameSettings = FrameSettings()


class ParameterSettings(Section):
    """Which constants are identified."""

    set: Literal["full", "doty", "angles", "none"] = "full"


def _kinds_with(key: str) -> str:
    """Kinds that a key of a declaration belongs to."""
    return " or ".join(kind.name for kind in KINDS.values() if kind.key == key)


class Moment(Section):
    """When something happened once: the first measurement after it, by its line in the file or by its time."""

    row: int | None = Field(default=None, ge=2)
    """Line of the file; of several files, counted on through them."""
    time: float | None = None
    """[s], as in the column `time`."""

    @property
    def number(self) -> float:
        """Between it and the row before, or the time itself."""
        return self.row - 0.5 if self.row is not None else float(self.time or 0.0)

    @model_validator(mode="after")
    def _one_of_both(self) -> Moment:
        if (self.row is None) == (self.time is None):
            raise ValueError("write {row: LINE} or {time: SECONDS} of the first measurement after it")
        return self


class EffectDeclaration(Section):
    """An effect that the user knows of: what, where, and what the kind needs besides."""

    kind: EffectKind
    where: str
    with_: str | None = Field(default=None, alias="with")
    """The other joint of a `joint_coupling`."""
    by: Literal["direction", "load"] | None = None
    """What a `joint_backlash` switches with."""
    order: Annotated[tuple[Annotated[float, Field(gt=0, le=1e6)], ...], BeforeValidator(_listed)] | None = None
    """Periods in one turn of the joint."""
    motion: Names | None = None
    covariates: Names | None = None
    at: Moment | None = None
    """When a `shift` happened; where it is not said, it is sought."""

    @model_validator(mode="after")
    def _fits_the_kind(self) -> EffectDeclaration:
        key = KINDS[self.kind].key
        if (self.with_ is not None) != (key == "with"):
            raise ValueError(f"`with: JOINT` belongs to a {_kinds_with('with')}, which needs it; write it there alone")
        if self.by is not None and key != "by":
            raise ValueError(f"`by` belongs to a {_kinds_with('by')} only; delete it")
        if self.at is not None and key != "at":
            raise ValueError(f"`at` belongs to a {_kinds_with('at')} only; delete it")
        return self


class DiagnosisSettings(Section):
    """Whether to look for effects that nobody declared, and for which."""

    enabled: bool = True
    candidates: Annotated[tuple[EffectKind, ...], BeforeValidator(_all_kinds)] = Field(
        default_factory=lambda: tuple(KINDS)
    )


class Job(Settings):
    """What a campaign and a scenario have in common."""

    robot: RobotSettings
    measurements: MeasurementSettings = MeasurementSettings()
    frames: Frames = Frames()
    parameters: ParameterSettings = ParameterSettings()
    effects: tuple[EffectDeclaration, ...] = ()
    diagnosis: DiagnosisSettings = DiagnosisSettings()

    @model_validator(mode="after")
    def _head_only_with_camera_sonar(self) -> Job:
        if self.measurements.kind == "camera_sonar":
            if "tip_target" in self.frames.model_fields_set:
                raise ValueError("frames.tip_target: `kind: camera_sonar` has its target at the tip; delete this key")
        else:
            if self.measurements.head is not None:
                raise ValueError("measurements.head: belongs to `kind: camera_sonar`; delete it, or write that kind")
            for number, effect in enumerate(self.effects):
                if is_of_head(effect.kind):
                    raise ValueError(f"effects[{number}].kind: {effect.kind} needs `kind: camera_sonar`")
        return self


class Campaign(Job):
    """A calibration job: a robot, its measurements, and what may be identified from them."""

    _tables: tuple[str | Path | pd.DataFrame, ...] = PrivateAttr(default=())

    @property
    def tables(self) -> tuple[str | Path | pd.DataFrame, ...]:
        """The tables of measurements: those given by :meth:`with_tables`, else the files of the settings."""
        return self._tables or self.measurements.files

    def with_tables(self, tables: Sequence[str | Path | pd.DataFrame]) -> Campaign:
        """The same campaign with other measurements, of the same columns and units."""
        other = self.model_copy()
        other._tables = tuple(tables)
        return other

    @model_validator(mode="after")
    def _measurements_are_named(self) -> Campaign:
        files, head = self.measurements.files, self.measurements.head
        if self.measurements.kind == "camera_sonar":
            if head is None or files:
                raise ValueError(
                    "measurements: `kind: camera_sonar` has `head: head.yaml` and no `file`; delete `file`, or name the head"
                )
        elif not files:
            raise ValueError("measurements.file: name the table of measurements, or a list of them")
        return self


def load_campaign(path: str | Path) -> Campaign:
    """Read a campaign; its paths come back relative to its own folder.

    Raises:
        CampaignError: naming the file, the line, the key and the nearest known one.
    """
    path = Path(path)
    check_path(path, CampaignError)
    if path.is_dir() or not path.exists() or path.suffix.lower() in (".csv", ".parquet", ".urdf"):
        what = "is a folder" if path.is_dir() else "is no campaign" if path.exists() else "there is no such file"
        raise CampaignError(
            f"{path}: {what}. `aridcal init --urdf ROBOT.urdf --measurements TABLE.csv` writes a campaign"
        )
    return load_settings(path, Campaign)
