"""Purposes of a calibration in `campaign.yaml`: poses to measure, a region and a tolerance, a certificate."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from aridcal.files.measurement_settings import LENGTHS, SMALL_ANGLES, listed, with_unit
from aridcal.files.yaml_file import Number, RelativePath, Section, Vector3
from aridcal.system.errors import has_controls


class Box(Section):
    """A box in the robot's base frame, [m]."""

    min: Vector3
    """Lowest corner, m."""
    max: Vector3
    """Highest corner, m."""

    @model_validator(mode="after")
    def _has_an_inside(self) -> Box:
        if not all(low < high for low, high in zip(self.min, self.max, strict=True)):
            raise ValueError("each number of `min` should be below that of `max`")
        return self


class SightSettings(Section):
    """An instrument that must see the target: a tracker, a camera beside the arm."""

    at: Vector3
    """Place of the instrument in the robot's base frame, m."""
    axis: Vector3 | None = None
    """Where the target opens to, in its frame; default: it is seen from anywhere."""
    within: Annotated[float, Field(gt=0.0, le=3.15)] | None = None
    """Angle from there to the instrument that the target still takes, rad."""

    @model_validator(mode="after")
    def _opens_somewhere(self) -> SightSettings:
        if (self.axis is None) != (self.within is None):
            raise ValueError(
                "`axis` and `within` go together: where the target opens to, and how far from there it is seen"
            )
        if self.axis is not None and not any(self.axis):
            raise ValueError("an `axis` of length 0 points nowhere; write [0, 0, 1] for the target's z")
        return self


class DesignSettings(Section):
    """Constraints of planned configurations beside the joints' limits."""

    keep_out: tuple[Box, ...] | None = None
    """Boxes in the base frame that neither the arm nor its target may enter; default: the plane that the arm is
    mounted on."""
    sight: SightSettings | None = None
    """Instrument that must see the target past the arm and the boxes."""


TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f\u061c")
"""Characters that change the direction of writing: a serial number would be read backwards."""


def _worded(most: int) -> BeforeValidator:
    """Text on one line: blanks are one blank; no characters that steer, and no more than so many."""

    def check(value: Any) -> str:
        if not isinstance(value, str):
            raise ValueError(
                "should be text: put it in quotes, since YAML reads it otherwise (00123 as 83, no as false)"
            )
        text = " ".join(value.split())
        if not text:
            raise ValueError("is empty; write what it says or delete the key")
        if has_controls(text) or not TURNING.isdisjoint(text):
            raise ValueError("holds a control character; delete it")
        if len(text) > most:
            raise ValueError(f"has {len(text):,} characters, and the certificate has room for {most}: shorten it")
        return text

    return BeforeValidator(check)


OneLine = Annotated[str, _worded(120)]

Paragraph = Annotated[str, _worded(500)]


class About(Section):
    """Text of the certificate beside its figures, as the user states it."""

    robot: OneLine | None = None
    """Maker and type; default: the URDF's name."""
    serial_number: OneLine | None = None
    """In quotes: YAML reads `00123` as 83."""
    instrument: OneLine | None = None
    """Maker and type."""
    instrument_serial: OneLine | None = None
    """Its serial number, in quotes."""
    who: OneLine | None = None
    """Who measured."""
    organisation: OneLine | None = None
    """For whom."""
    certificate_number: OneLine | None = None
    """In quotes."""
    date: OneLine | None = None
    """Date of the measurement; default: that of the files."""
    environment: Paragraph | None = None
    """Temperature, humidity, time of warming up."""
    method: Paragraph | None = None
    """How it was measured."""
    notes: Paragraph | None = None
    """Anything else."""


class Region(Section):
    """The region where the target is to be known: configurations, or places of the target; and the point on it."""

    file: RelativePath | None = None
    """Rows of joints, or of places `x y z` of the target in the world, in the columns and units of the measurements."""
    joints: dict[str, tuple[Number, Number]] = Field(default_factory=dict)
    """Or a box of readings, `{joint_1: [0, 2]}`, in the units of the measurements; other joints keep the range seen."""
    tool: Vector3 = (0.0, 0.0, 0.0)
    """A point that moves with the target, in its axes, m: all is then said of it, and `file` has its places."""

    @model_validator(mode="after")
    def _is_one(self) -> Region:
        if self.file is not None and self.joints:
            raise ValueError("`file` and `joints` both say where; delete one of them")
        for name, (low, high) in self.joints.items():
            if not low < high:
                raise ValueError(f"joints.{name}: the first number should be below the second")
        return self


class StudySettings(Section):
    """The repetitions of `aridcal study`."""

    runs: int = Field(default=100, ge=2, le=100_000)
    """Runs of each case."""
    seed: int = Field(default=0, ge=0)
    """Fixes all draws."""
    rows: Annotated[tuple[Annotated[int, Field(ge=4, le=1_000_000)], ...], BeforeValidator(listed)] = ()
    """Numbers of rows; of a scenario default: its `truth.n`."""
    sizes: Annotated[tuple[Annotated[float, Field(ge=0, le=1e6)], ...], BeforeValidator(listed)] = ()
    """Sizes of an effect, in units of that in `truth.effects`: 0 is none of it, 1 as stated."""
    effect: str | None = None
    """Which of `truth.effects`, as WHERE.KIND; default: the only one."""


def position_alone(value: Any) -> Any:
    """Let a length stand for the tolerance of the position."""
    return value if isinstance(value, dict) else {"position": value}


class ToleranceSettings(Section):
    """How far the target may be off in 95 % of the region."""

    position: Annotated[float, BeforeValidator(lambda text: with_unit(text, LENGTHS, "0.2mm"))]
    """With its unit: `m cm mm um in ft`."""
    rotation: Annotated[float, BeforeValidator(lambda text: with_unit(text, SMALL_ANGLES, "0.5mrad"))] | None = None
    """With its unit: `rad deg mrad`."""
