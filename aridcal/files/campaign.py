"""The campaign: one calibration job as `campaign.yaml` describes it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
import pinocchio as pin
from pydantic import (
    BeforeValidator,
    Field,
    PrivateAttr,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, is_of_head
from aridcal.engine.corrections.loads import PAYLOAD, Payload
from aridcal.engine.fit.question import EndFrame, Question
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS as MEASURED
from aridcal.engine.instruments.kinds import labelled
from aridcal.engine.instruments.setup import TIP, WORLD
from aridcal.engine.robot.chain import Robot, load_robot, with_limbs
from aridcal.engine.robot.drive import StatedJoints
from aridcal.engine.robot.kinematics import LEVEL_GRAVITY, bears
from aridcal.engine.robot.splice_mjcf import check_written_back
from aridcal.files.counting import check_joints, check_on_chain
from aridcal.files.instrument_settings import InstrumentSettings, Placement, TargetSettings
from aridcal.files.measurement_settings import MeasurementSettings, Names, listed, one_of
from aridcal.files.purposes import About, DesignSettings, Region, StudySettings, ToleranceSettings, position_alone
from aridcal.files.yaml_file import (
    LARGEST_SETTING,
    AnySection,
    Number,
    RelativePath,
    Section,
    Settings,
    Vector3,
    load_settings,
)
from aridcal.system.errors import CampaignError, nearest, shortened
from aridcal.system.reading.user_names import check_path

if TYPE_CHECKING:
    import pandas as pd

# Kinds of measurements whose rows refer to things under `instruments`.
REFERRING = tuple(kind for kind in MEASURED if labelled(kind))


def _all_kinds(candidates: Any) -> Any:
    """Names of kinds; `all` for those that need not be asked for."""
    usual = [name for name, kind in EFFECT_KINDS.items() if not kind.on_request]
    named = listed(candidates)
    if named is None:
        return None
    names = [name for word in named for name in (usual if word == "all" else [word])]
    return tuple(name for k, name in enumerate(names) if name not in names[:k])


# Name of a row of the table of kinds.
KindName = Annotated[str, one_of(EFFECT_KINDS)]


def _as_xacro(value: Any) -> Any:
    """A value as xacro reads it: YAML's `true` and numbers are no text."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, int | float) else value


class ArmSettings(Section):
    """Which chain of which URDF or xacro file."""

    urdf: RelativePath
    """Nominal model: a URDF, a xacro file (`pip install "aridcal[xacro]"`), or MJCF, which may be called `mjcf`."""
    base: str | None = None
    """Link where the chain starts, any of the tree; default: the URDF's root. Where the base itself tilts, one below
    the joint that tilts it."""
    tip: str
    """Link where the chain ends."""
    packages: dict[str, RelativePath] = Field(default_factory=dict)
    """Folders of ROS packages that the URDF names and that are not found by themselves."""
    arguments: dict[str, Annotated[str, BeforeValidator(_as_xacro)]] = Field(default_factory=dict)
    """Arguments of a xacro file."""
    joints: dict[str, Number] = Field(default_factory=dict)
    """Where joints without a column stand in all rows, rad or m as the URDF counts: `{waist_yaw: 0.0}`. A table that
    has such a column is refused, measurements and queries alike: delete the joint here, or list the column under
    `measurements.ignore`. Their constants are identified like others; what only their motion could tell apart is
    redundant. Words for a posture in robot programs are not understood where joints stand still."""
    coupled: dict[str, dict[str, Number]] = Field(default_factory=dict)
    """Joints without a column that follow several others, as the sum of factor × reading: `{knuckle: {finger: 0.5,
    thumb: -0.5}}`. Refused, as under `joints`, for a joint that is not in the URDF or does not move, has a `<mimic>`,
    stands under both, or follows itself. One that is followed and is on no path needs a column all the same; one that
    follows others itself is replaced by them. The joint's own `<limit>` is not looked at; a zero that is not 0 is a
    constant, and is identified. Robot programs of such an arm are refused."""

    @model_validator(mode="before")
    @classmethod
    def _mjcf_is_a_description(cls, keys: Any) -> Any:
        if not isinstance(keys, dict) or "mjcf" not in keys:
            return keys
        if "urdf" in keys:
            raise ValueError("has `urdf` and `mjcf`: write one")
        return {("urdf" if key == "mjcf" else key): value for key, value in keys.items()}

    @property
    def stated(self) -> StatedJoints:
        """Positions of joints that have no column."""
        return StatedJoints(self.joints, self.coupled)


class RobotSettings(ArmSettings):
    """The robot of a campaign, and where down is."""

    tip: str = ""
    """Link where the default path ends. Left out: the link of the first of `targets`, else of `cameras`, that is on
    one, else the second of `links` of the first `joined` block."""
    gravity: Literal["world"] | Vector3 = LEVEL_GRAVITY
    """In the base frame, m/s²; `world`: along -z of the levelled world frame, turned by the identified `world_base`
    (each station's). Joints on the path that tilt the arm need nothing."""
    controller_zeros: dict[str, Number] = Field(default_factory=dict)
    """For robot programs: what the controller shows where the URDF's joint is at 0, rad or m."""

    @field_validator("gravity", mode="before")
    @classmethod
    def _vector_or_world(cls, gravity: Any) -> Any:
        listed = isinstance(gravity, list | tuple) and len(gravity) == 3
        if gravity != "world" and not (
            listed and all(type(g) in (int, float) and abs(g) <= LARGEST_SETTING for g in gravity)
        ):
            raise ValueError("should be `world` or [x, y, z] in m/s²")
        return gravity


def _if_listed(value: Any, validate: ValidatorFunctionWrapHandler) -> Any:
    """The blocks of a list; none where there is one block alone."""
    return validate(value) if isinstance(value, list | tuple) else ()


def _first_listed(value: Any, validate: ValidatorFunctionWrapHandler, about: ValidationInfo) -> Any:
    """The one block, or the first of those that were listed; one that is wrong is complained of as one of the list."""
    if isinstance(value, list | tuple):
        return (*about.data.get("listed", ()), MeasurementSettings())[0]
    return validate(value)


class FrameSettings(Placement):
    """An unknown or a known frame; of an unknown one, `xyz` and `rpy` are a hint, which may be far off."""

    identify: bool = True
    """`false`: `xyz` and `rpy` are exact."""
    per: Literal["station"] | None = None
    """`station`: one frame for each value of that column. `world_base` per station is for trackers: rows of positions
    and poses need the column, rows from link to link do not, queries name `station` and `target`; rows that refer to
    things in the world are refused beside it: label what stands elsewhere at each station. `tip_target` per station is
    refused where there are targets: a target that was moved gets a new label."""

    @model_validator(mode="after")
    def _known_frames_are_one(self) -> FrameSettings:
        if self.per and not self.identify:
            raise ValueError("`per: station` makes sense only with `identify: true`")
        return self


def frame_values(settings: FrameSettings | TargetSettings) -> EndFrame:
    """A frame as a campaign states it."""
    by_station = isinstance(settings, FrameSettings) and settings.per is not None
    return EndFrame(pin.SE3(settings.homogeneous), settings.identify, by_station)


class Frames(Section):
    """T_world_base and T_tip_target, both found from the rows in closed form."""

    world_base: FrameSettings = FrameSettings()
    """Where the robot stands in the instrument's frame."""
    tip_target: FrameSettings = FrameSettings()
    """Where the measured target is on the tip; refused for `camera_sonar` and for `pixels` alone. Of `kind: position`
    its rotation stays at the hint."""


class ParameterSettings(Section):
    """Which constants are identified."""

    set: Literal["full", "doty", "angles", "none"] = "full"
    """All of each joint's origin; Doty's link parameters; his angles beta and alpha alone; frames only."""


def _kinds_with(key: str) -> str:
    """Names of the kinds that a key of a declaration belongs to, in words."""
    return " or ".join(kind.name for kind in EFFECT_KINDS.values() if kind.key == key)


class Moment(Section):
    """When something happened once: the first measurement after it, by its line in the file or by its time."""

    row: int | None = Field(default=None, ge=2)
    """First row after it, by its line in the file; of several files, counted on through them."""
    time: float | None = None
    """Or by its `time`, s."""

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

    kind: KindName
    """One of the kinds of effects."""
    where: str
    """A joint, `world_base`, `tip_target`, or what the kind acts at."""
    with_: str | None = Field(default=None, alias="with")
    """The other joint of a `joint_coupling`."""
    by: str | None = None
    """`direction` or `load` of a `joint_backlash`; over what a `regional` effect varies: a joint, a column, `place`."""
    order: Annotated[tuple[Annotated[float, Field(gt=0, le=1e6)], ...], BeforeValidator(listed)] | None = None
    """Periods in one turn of the joint."""
    motion: Names | None = None
    """Motions at `where`, if not the usual ones of the kind."""
    covariates: Names | None = None
    """Columns or loads on which it depends, if not the usual ones."""
    at: Moment | None = None
    """When a `shift` happened; without it the row is sought."""

    @model_validator(mode="after")
    def _fits_the_kind(self) -> EffectDeclaration:
        key, words = EFFECT_KINDS[self.kind].key, EFFECT_KINDS[self.kind].bys
        if (self.with_ is not None) != (key == "with"):
            raise ValueError(f"`with: JOINT` belongs to a {_kinds_with('with')}, which needs it; write it there alone")
        if self.by is not None and key != "by":
            raise ValueError(f"`by` belongs to a {_kinds_with('by')} only; delete it")
        if self.by is not None and words and self.by not in words:
            raise ValueError(f"by: {self.by!r} should be {' or '.join(words)}")
        if key == "by" and not words and self.by is None:
            raise ValueError(f"a {self.kind} effect needs `by`: a joint, a column, or `place` for the target's own")
        if self.at is not None and key != "at":
            raise ValueError(f"`at` belongs to a {_kinds_with('at')} only; delete it")
        return self


class DiagnosisSettings(Section):
    """Whether to look for effects that nobody declared, and for which."""

    enabled: bool = True
    """`false`: only declared effects are fitted."""
    candidates: Annotated[tuple[KindName, ...], BeforeValidator(_all_kinds)] = Field(
        default_factory=lambda: _all_kinds("all")
    )
    """`all`, or a list of kinds; `[all, regional, residual_field]` for those two as well."""


class PayloadSettings(Section):
    """A mass that hangs at the origin of a link."""

    column: str = "payload"
    """Column of the tables, kg; refused if none has it."""
    on: str
    """Link at whose origin it hangs, in place of the default path's target."""


Payloads = Annotated[tuple[PayloadSettings, ...], BeforeValidator(listed)]


def _with(section: AnySection, key: str, value: object) -> AnySection:
    """A section with another value of one key; keys that the user did not write still count as unwritten."""
    other = section.model_copy(update={key: value})
    other.model_fields_set.intersection_update(section.model_fields_set)
    return other


class JobSettings(Settings):
    """The keys that a campaign and a scenario have in common."""

    robot: RobotSettings
    listed: Annotated[Annotated[tuple[MeasurementSettings, ...], Field(min_length=1)], WrapValidator(_if_listed)] = (
        Field(default=(), alias="measurements")
    )
    """All blocks where the campaign has a list of them."""
    measurements: Annotated[MeasurementSettings, WrapValidator(_first_listed)] = MeasurementSettings()
    """One block, or a list of blocks of several kinds."""
    instruments: InstrumentSettings = InstrumentSettings()
    """What is known beforehand of the things that rows refer to. What is identified need not be there; if so it is a
    hint."""
    payload: Payloads = ()
    """Payloads and their links, one or a list. Every joint that bears the link has its torque; of several, effects
    call them `payload_LINK`, and `JOINT.payload_torque` is of all. Without this key a column `payload` hangs on the
    tip at the target; of several targets, where the first of them is on its link."""
    frames: Frames = Frames()
    parameters: ParameterSettings = ParameterSettings()
    effects: tuple[EffectDeclaration, ...] = ()
    """Effects that you declare: `[{kind: joint_compliance, where: joint_3}]`."""
    diagnosis: DiagnosisSettings = DiagnosisSettings()
    study: StudySettings | None = None
    """For `aridcal study` alone."""

    @property
    def blocks(self) -> tuple[MeasurementSettings, ...]:
        """All blocks of measurements; one is the rule."""
        return (self.measurements, *self.listed[1:])

    @property
    def links(self) -> dict[str, str]:
        """Links of the URDF between which rows are, beside the robot's base and tip, and the key that names each."""
        named = {link: f"instruments.{key}" for link, key in self.instruments.links.items()}
        for number, block in enumerate(self.blocks):
            named |= dict.fromkeys(block.links or (), f"{self.place(number)}.links")
        return {link: key for link, key in named.items() if link not in (TIP, WORLD)}

    @property
    def carriers(self) -> tuple[str, ...]:
        """Links that carry what is measured: those of targets, then of cameras, then the second of two joined links."""
        joined = [block.links[1] for block in self.blocks if block.links is not None]
        targets = [target.on for target in self.instruments.targets.values()]
        cameras = [camera.on for camera in self.instruments.cameras.values()]
        return tuple(link for link in [*targets, *cameras, *joined] if link not in (TIP, WORLD))

    def place(self, number: int) -> str:
        """Name of a block in messages."""
        return f"measurements[{number}]" if self.listed else "measurements"

    @model_validator(mode="after")
    def _tip_is_known(self) -> Self:
        """Where `robot.tip` is left out, the default path ends at the first link that carries what is measured."""
        if "tip" in self.robot.model_fields_set:
            return self
        if not self.carriers:
            raise ValueError(
                "robot.tip is missing: name the link that is calibrated, or give every target its link under "
                "instruments.targets (on: LINK)"
            )
        return self.model_copy(update={"robot": _with(self.robot, "tip", self.carriers[0])})

    @model_validator(mode="after")
    def _head_only_with_camera_sonar(self) -> JobSettings:
        if self.measurements.traits.of_head and len(self.blocks) == 1:
            if "tip_target" in self.frames.model_fields_set:
                raise ValueError("frames.tip_target: `kind: camera_sonar` has its target at the tip; delete this key")
            return self
        for number, block in enumerate(self.blocks):
            if block.traits.of_head:
                raise ValueError(
                    f"{self.place(number)}.kind: camera_sonar is not read beside other blocks; `aridcal measure` makes "
                    "a table of poses from its images: name that here, with `kind: pose`"
                )
            if block.head is not None:
                raise ValueError(
                    f"{self.place(number)}.head: belongs to `kind: camera_sonar`; delete it, or write that kind"
                )
        pixels = any(block.traits.images for block in self.blocks)
        for number, effect in enumerate(self.effects):
            of_camera = EFFECT_KINDS[effect.kind].of_head == "camera"
            if is_of_head(effect.kind) and not (pixels and of_camera):
                of = "`kind: camera_sonar`" + (" or `kind: pixels`" if of_camera else "")
                raise ValueError(f"effects[{number}].kind: {effect.kind} needs {of}")
        return self

    @property
    def masses(self) -> tuple[str, ...]:
        """Covariate of each of the payloads; of several by their links."""
        return (PAYLOAD,) if len(self.payload) == 1 else tuple(f"{PAYLOAD}_{each.on}" for each in self.payload)

    @property
    def question(self) -> Question:
        """The question to its rows: frames, constants, effects."""
        gravity, targets = self.robot.gravity, self.instruments.targets
        return Question(
            world_base=frame_values(self.frames.world_base),
            tip_target=frame_values(self.frames.tip_target),
            targets={label: frame_values(target) for label, target in targets.items()},
            target_on=self.instruments.targets_on(self.robot.tip),
            constants=self.parameters.set,
            gravity=None if gravity == "world" else np.array(gravity, dtype=float),
            payloads=tuple(
                Payload(np.zeros(3), each.on, name) for name, each in zip(self.masses, self.payload, strict=True)
            ),
            effects=self.effects,
            sought=self.diagnosis.candidates if self.diagnosis.enabled else (),
            source=self.path,
        )

    def payload_key(self, number: int) -> str:
        """Name of a payload in messages."""
        return f"payload[{number}]" if len(self.payload) > 1 else "payload"

    @model_validator(mode="after")
    def _payloads_have_columns(self) -> Self:
        """Let the blocks read payloads from the columns that the payloads name."""
        if not self.payload:
            return self
        links, columns = ([getattr(each, key) for each in self.payload] for key in ("on", "column"))
        for what, key in ((links, "on"), (columns, "column")):
            for number, name in enumerate(what):
                if name in what[:number]:
                    raise ValueError(f"payload[{number}].{key}: two payloads have {name!r} here; name another for each")
        named = dict(zip(self.masses, columns, strict=True))
        for number, block in enumerate(self.blocks):
            for k, (mass, column) in enumerate(named.items()):
                of_block = block.columns.get(mass, column)
                if of_block != column:
                    raise ValueError(
                        f"{self.place(number)}.columns.{mass}: is {of_block!r} here and {column!r} under "
                        f"{self.payload_key(k)}.column; delete it here"
                    )
        blocks = tuple(_with(block, "columns", block.columns | named) for block in self.blocks)
        return self.model_copy(update={"measurements": blocks[0], "listed": blocks if self.listed else ()})

    @model_validator(mode="after")
    def _blocks_can_be_told_apart(self) -> JobSettings:
        titles = [block.title for block in self.blocks]
        for number, title in enumerate(titles):
            if title in titles[:number]:
                raise ValueError(
                    f"{self.place(number)}.name: two blocks are called {title!r}; give each a `name` of its own"
                )
        return self

    @model_validator(mode="after")
    def _instruments_are_used(self) -> JobSettings:
        kinds = {block.kind for block in self.blocks}
        if self.instruments.model_fields_set - {"targets"} and kinds.isdisjoint(REFERRING):
            raise ValueError(
                "instruments: no block's rows refer to such things; delete this key, or add a block of "
                f"`kind: {' or '.join(REFERRING)}`"
            )
        if all(block.traits.images for block in self.blocks) and "tip_target" in self.frames.model_fields_set:
            raise ValueError(
                "frames.tip_target: `kind: pixels` has no target beside its cameras and markers; delete this key, and "
                "say under `instruments` where they are"
            )
        if any(block.traits.images for block in self.blocks) and not self.instruments.cameras:
            raise ValueError(
                "instruments.cameras: `kind: pixels` needs a camera; add it: "
                "{eye: {width: 640, height: 480, fx: …, fy: …, cx: …, cy: …}}"
            )
        for number, block in enumerate(self.blocks):
            if block.camera is not None and block.camera not in self.instruments.cameras:
                raise ValueError(
                    f"{self.place(number)}.camera: there is no camera {block.camera!r} under instruments.cameras"
                    f"{nearest(block.camera, self.instruments.cameras)}; add it there"
                )
        return self


class Campaign(JobSettings):
    """A calibration job: a robot, its measurements, and what may be identified from them."""

    design: DesignSettings = DesignSettings()
    """For `aridcal design` alone."""
    about: About | None = None
    """For the certificate, which is written where this is there: text on one line, 120 characters (500 of the last
    three), without control characters and those that turn the direction of writing."""
    region: Region = Region()
    """Where the target is to be known. Without `file` and `joints`: what was measured of the box of all ranges seen (for `aridcal
    design`, before any row: of what the limits allow)."""
    tolerance: Annotated[ToleranceSettings, BeforeValidator(position_alone)] | None = None
    """How far the target may be off in 95 % of the region: `0.2mm`, or both keys below; `--tolerance` goes before it."""

    _tables: tuple[str | Path | pd.DataFrame, ...] = PrivateAttr(default=())

    @property
    def tables(self) -> tuple[str | Path | pd.DataFrame, ...]:
        """The tables of measurements: those given by :meth:`with_tables`, else the files of all blocks."""
        return self._tables or tuple(file for block in self.blocks for file in block.files)

    @property
    def has_other_tables(self) -> bool:
        """True where the tables are not the campaign's own files."""
        return bool(self._tables)

    def with_tolerance(self, position: float) -> Campaign:
        """The same campaign with another tolerance of the position, [m]."""
        tolerance = self.tolerance or ToleranceSettings.model_construct(position=position)
        return self.model_copy(update={"tolerance": tolerance.model_copy(update={"position": position})})

    def with_tables(self, tables: Sequence[str | Path | pd.DataFrame]) -> Campaign:
        """The same campaign with other measurements, of the same columns and units."""
        other = self.model_copy()
        other._tables = tuple(tables)
        return other

    @model_validator(mode="after")
    def _measurements_are_named(self) -> Campaign:
        for number, block in enumerate(self.blocks):
            if block.traits.of_head:
                if block.head is None or block.files:
                    raise ValueError(
                        f"{self.place(number)}: `kind: camera_sonar` has `head: head.yaml` and no `file`; delete `file`, "
                        "or name the head"
                    )
            elif not block.files:
                raise ValueError(f"{self.place(number)}.file: name the table of measurements, or a list of them")
        return self


def nominal_robot(job: JobSettings) -> Robot:
    """Read the robot that a campaign or a scenario names.

    Raises:
        RobotError: its description cannot be read, or has no such chain.
        CampaignError: `controller_zeros` or the `joints` of a block name a joint that is not on it.
    """
    named = job.robot
    robot = load_robot(
        named.urdf, named.tip, named.base, job.limits.urdf, named.packages, named.arguments, named.stated
    )
    for link, key in job.links.items():
        _check_link(link, robot, f"{job.path}: {key}", "tip, world or a link")
    if job.links:
        robot = with_limbs(robot, tuple(job.links))
    check_written_back(robot)
    for number, payload in enumerate(job.payload):
        key = f"{job.path}: {job.payload_key(number)}.on"
        _check_link(payload.on, robot, key, "a link")
        if not bears(robot, payload.on).any():
            raise CampaignError(
                f"{key}: no joint that rows measure bears {payload.on!r}; write the link that carries it"
            )
    check_on_chain(named.controller_zeros, "robot.controller_zeros", robot.readings)
    for number, block in enumerate(job.blocks):
        check_joints(block, f"{job.path}: {job.place(number)}", robot.readings, robot.kinds)
    return robot


def _check_link(link: str, robot: Robot, key: str, possible: str) -> None:
    """Make sure that a key names a link of the URDF."""
    names = {frame.name for frame in robot.tree.frames}
    if link not in names:
        raise CampaignError(
            f"{key}: no link {shortened(link)!r} in {robot.path.name}{nearest(link, names)}; write {possible} of the URDF"
        )


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
