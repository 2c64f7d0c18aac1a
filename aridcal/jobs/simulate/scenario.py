"""What a scenario says: a campaign's keys and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import BeforeValidator, Field

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, is_of_head
from aridcal.engine.corrections.labels import LABEL_COLUMN
from aridcal.engine.corrections.loads import PAYLOAD
from aridcal.engine.robot.chain import Robot
from aridcal.files.campaign import JobSettings
from aridcal.files.yaml_file import Section, Vector3
from aridcal.jobs.simulate.true_effects import Parameter, TrueEffect, columns_needed, number_as_value
from aridcal.jobs.simulate.true_things import TrueThings
from aridcal.system.errors import CampaignError


class TrueFrame(Section):
    """A frame as it is; [m] and [rad]."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)


class TrueFrames(Section):
    """T_world_base and T_tip_target as they are; what is absent is as the campaign's own `frames` have it."""

    world_base: TrueFrame | None = None
    tip_target: TrueFrame | None = None
    tip_camera: TrueFrame | None = None
    """In place of ``tip_target`` for `kind: camera_sonar`; what is absent is as head.yaml has it."""
    targets: dict[str, TrueFrame] = Field(default_factory=dict)
    """T_tip_target of each of several targets, which rows measure in turn; by the name of its block, that of an inclinometer."""


class TrueNoise(Section):
    """1-sigma of the measurements per axis, whatever the campaign declares."""

    position: float = Field(default=0.0, ge=0, le=1e3)
    """[m]"""
    rotation: float = Field(default=0.0, ge=0, le=1e3)
    """[rad]"""
    distance: float = Field(default=0.0, ge=0, le=1e3)
    """[m]"""
    pixel: float = Field(default=0.0, ge=0, le=1e3)
    """[px]"""
    inclination: float = Field(default=0.0, ge=0, le=1e3)
    """[rad]"""


class Outliers(Section):
    """Rows that are grossly wrong."""

    share: float = Field(ge=0, le=1)
    size: float = Field(gt=0, le=1e9)
    """How far off, in sigmas of the noise, in a random direction; all channels alike."""


class Truth(Section):
    """What the simulated machine and its measurements are really like."""

    parameters: dict[str, Annotated[Parameter, BeforeValidator(number_as_value)]] = Field(default_factory=dict)
    frames: TrueFrames = TrueFrames()
    effects: tuple[TrueEffect, ...] = ()
    covariates: tuple[str, ...] = ()
    """Columns to write beside those that the effects depend on."""
    noise: TrueNoise = TrueNoise()
    outliers: Outliers | None = None
    instruments: TrueThings = TrueThings()
    n: int = Field(ge=1, le=10_000_000)
    """Rows of each block, or images."""
    seed: int = Field(default=0, ge=0)


class Scenario(JobSettings):
    """A campaign's keys and the truth behind it."""

    truth: Truth

    @property
    def refers(self) -> bool:
        """True where rows refer to things, or to one of several targets: not where they are poses of the only one."""
        plain = len(self.blocks) == 1 and self.measurements.traits.places
        named = self.truth.frames.targets or self.instruments.targets or self.instruments.links
        return not plain or bool(named)


def columns_of(scenario: Scenario, robot: Robot, effects: Sequence[TrueEffect]) -> tuple[str, ...]:
    """Columns beside the joints, each once: those that are asked for, those of some effects, and the payloads'.

    Args:
        scenario: Its truth, and the payloads that its campaign names.
        robot: The chain.
        effects: Of the arm.
    """
    names = dict.fromkeys((*scenario.truth.covariates, *columns_needed(effects, robot)))
    if scenario.payload:
        names = {name: None for name in names if name != PAYLOAD} | dict.fromkeys(scenario.masses)
    return tuple(names)


def _any_has(scenario: Scenario, key: str) -> bool:
    """True if any block of measurements sets a key."""
    return any(key in block.model_fields_set for block in scenario.blocks)


def check_scenario(scenario: Scenario) -> None:
    """Refuse keys that a campaign may have but a simulation cannot follow."""
    measurements, truth = scenario.measurements, scenario.truth
    refusals = {
        "truth.frames.targets": (
            measurements.traits.of_head and bool(truth.frames.targets),
            "`kind: camera_sonar` has its target at the tip; delete this key",
        ),
        "truth.instruments": (
            truth.instruments != TrueThings() and not scenario.refers,
            "no row refers to such things; delete this key",
        ),
        "truth.instruments.cameras": (
            not set(truth.instruments.cameras) <= set(scenario.instruments.cameras),
            "these are cameras under `instruments`; name the same",
        ),
        "measurements.head": (
            measurements.traits.of_head and measurements.head is None,
            "`kind: camera_sonar` needs it: `head: head.yaml`",
        ),
        "truth.noise": (
            measurements.head is not None and (truth.noise != TrueNoise() or truth.outliers is not None),
            "with `kind: camera_sonar` the noise is that of images and sonars; delete this key and `outliers`",
        ),
        "truth.effects": (
            measurements.head is None
            and any(is_of_head(e.kind) and e.where not in scenario.instruments.cameras for e in truth.effects),
            f"{', '.join(filter(is_of_head, EFFECT_KINDS))} need `kind: camera_sonar`, or a camera under `instruments`",
        ),
        "truth.effects: by": (
            any(e.by == LABEL_COLUMN for e in truth.effects),
            "stations are not simulated; name a joint, a column or `place`",
        ),
        "measurements.units": (_any_has(scenario, "units"), "the table is written in SI; delete this key"),
        "measurements.joints": (_any_has(scenario, "joints"), "the table counts as the URDF does; delete this key"),
        "measurements.inverted": (
            _any_has(scenario, "inverted"),
            "the table has the target in the world; delete this key",
        ),
        "measurements.table": (_any_has(scenario, "table"), "the table is written as csv; delete this key"),
        "measurements.orientation": (
            _any_has(scenario, "orientation"),
            "the table is written with quaternions; delete this key",
        ),
        "frames": (
            scenario.question.by_station,
            "stations are not simulated; delete `per: station`",
        ),
    }
    for key, (applies, why) in refusals.items():
        if applies:
            raise CampaignError(f"{scenario.path}: {key}: {why}")
    if truth.outliers is not None and truth.noise == TrueNoise():
        raise CampaignError(
            f"{scenario.path}: truth.outliers.size is in sigmas: `truth.noise` must say how much that is"
        )
