"""What a scenario says: a campaign's keys and the truth."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from aridcal.effects.catalogue import KINDS, is_of_head
from aridcal.errors import CampaignError
from aridcal.inputs.campaign import Job
from aridcal.inputs.measurement_settings import OF_TARGETS
from aridcal.inputs.yaml_file import Section, Vector3
from aridcal.prepare.true_effects import Parameter, TrueEffect, given


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


class TrueNoise(Section):
    """1-sigma of the measurements per axis, whatever the campaign declares."""

    position: float = Field(default=0.0, ge=0, le=1e3)
    """[m]"""
    rotation: float = Field(default=0.0, ge=0, le=1e3)
    """[rad]"""


class Outliers(Section):
    """Rows that are grossly wrong."""

    share: float = Field(ge=0, le=1)
    size: float = Field(gt=0, le=1e9)
    """How far off, in sigmas of the noise, in a random direction; position and rotation alike."""


class Truth(Section):
    """What the simulated machine and its measurements are really like."""

    parameters: dict[str, Annotated[Parameter, BeforeValidator(given)]] = Field(default_factory=dict)
    frames: TrueFrames = TrueFrames()
    effects: tuple[TrueEffect, ...] = ()
    covariates: tuple[str, ...] = ()
    """Columns to write beside those that the effects depend on."""
    noise: TrueNoise = TrueNoise()
    outliers: Outliers | None = None
    n: int = Field(ge=1, le=10_000_000)
    seed: int = Field(default=0, ge=0)


class Scenario(Job):
    """A campaign's keys and the truth behind it."""

    truth: Truth


def check_scenario(scenario: Scenario) -> None:
    """Refuse what a campaign may ask for but a simulation cannot give."""
    measurements, truth = scenario.measurements, scenario.truth
    refused = {
        "measurements": (
            len(scenario.blocks) > 1 or measurements.kind not in (*OF_TARGETS, "camera_sonar"),
            f"one block of {', '.join(OF_TARGETS)} or camera_sonar is simulated; write one of these",
        ),
        "measurements.head": (
            measurements.kind == "camera_sonar" and measurements.head is None,
            "`kind: camera_sonar` needs it: `head: head.yaml`",
        ),
        "truth.noise": (
            measurements.head is not None and (truth.noise != TrueNoise() or truth.outliers is not None),
            "with `kind: camera_sonar` the noise is that of images and sonars; delete this key and `outliers`",
        ),
        "truth.effects": (
            measurements.head is None and any(is_of_head(e.kind) for e in truth.effects),
            f"{', '.join(filter(is_of_head, KINDS))} need `kind: camera_sonar`",
        ),
        "measurements.units": ("units" in measurements.model_fields_set, "the table is written in SI; delete this key"),
        "measurements.orientation": (
            "orientation" in measurements.model_fields_set,
            "the table is written with quaternions; delete this key",
        ),
        "frames": (
            "station" in (scenario.frames.world_base.per, scenario.frames.tip_target.per),
            "stations are not simulated; delete `per: station`",
        ),
    }
    for key, (asked, why) in refused.items():
        if asked:
            raise CampaignError(f"{scenario.path}: {key}: {why}")
    if truth.outliers is not None and truth.noise == TrueNoise():
        raise CampaignError(
            f"{scenario.path}: truth.outliers.size is in sigmas: `truth.noise` must say how much that is"
        )
