"""The format of `calibration.yaml`: every key, type and length, so that a damaged file is refused by its line."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from aridcal.engine.corrections.basis import ALWAYS, FORMS, Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.labels import is_label
from aridcal.engine.trust.rival_predictions import Rival
from aridcal.engine.trust.workspace import OpenCombination
from aridcal.files.query import FramesBy
from aridcal.files.yaml_file import LARGEST_SETTING, Number, Section, Settings, Vector3, decode, parse_yaml, validated
from aridcal.system.errors import CampaignError, has_controls
from aridcal.system.reading.regular_files import CALIBRATION, read_file

NORM_SLACK = 1e-6
"""Difference from 1 that the norm of a quaternion written with all its digits may have."""

NOT_OURS = "Run `aridcal identify` again: this file was not written by this version, or was changed since"


class RobotPart(Section):
    """The nominal robot, its URDF as text."""

    base: str
    tip: str
    gravity: Literal["world"] | Vector3
    urdf_name: str
    urdf_sha256: str
    urdf_encoding: Literal["utf-8", "latin-1"]
    joints: dict[str, Number] = Field(default_factory=dict)
    """Positions of joints without a column, [rad] or [m]."""
    coupled: dict[str, dict[str, Number]] = Field(default_factory=dict)
    """Factors of joints that follow several others."""
    limbs: tuple[str, ...] = ()
    """Further links to which paths lead from the base."""
    routes: tuple[tuple[str | None, str | None], ...] = ((None, None),)
    """Paths of the rows: from a link, or the world, to a link, or the tip."""
    targets: dict[str, str] = Field(default_factory=dict)
    """Links that carry targets, by the targets' labels."""
    urdf: str
    mjcf: str | None = None
    """The user's own file, where that is MJCF, in the encoding of the URDF."""

    @property
    def content(self) -> bytes:
        """The URDF's own bytes."""
        return self.urdf.encode(self.urdf_encoding)

    @field_validator("urdf_name")
    @classmethod
    def _shown(cls, name: str) -> str:
        if has_controls(name):
            raise ValueError("holds a control character")
        return name

    @model_validator(mode="after")
    def _as_it_was(self) -> RobotPart:
        try:
            same = hashlib.sha256(self.content).hexdigest() == self.urdf_sha256
        except UnicodeEncodeError:
            same = False
        if not same:
            raise ValueError("the URDF in it is not the one that was calibrated: its hash differs")
        return self


class FramePart(Section):
    """One placement, of a station or of all rows."""

    station: str | None
    xyz: Vector3
    quaternion: tuple[Number, Number, Number, Number]

    @field_validator("quaternion")
    @classmethod
    def _unit(cls, quaternion: tuple[float, ...]) -> tuple[float, ...]:
        if not abs(np.linalg.norm(quaternion) - 1) <= NORM_SLACK:
            raise ValueError("should be a quaternion of norm 1")
        return quaternion

    @field_validator("station")
    @classmethod
    def _shown(cls, station: str | None) -> str | None:
        if station is not None and has_controls(station):
            raise ValueError("holds a control character")
        return station


class PayloadPart(Section):
    """One of several payloads."""

    at: Vector3
    on: str
    name: str
    """Name of its covariate."""


class LoadsPart(Section):
    """Gravity and payloads, for the loads on the joints."""

    gravity: Vector3 | tuple[Vector3, ...]
    payload_at: Vector3 = (0.0, 0.0, 0.0)
    payload_on: str = ""
    """The link that carries it; empty for the tip."""
    payloads: tuple[PayloadPart, ...] = ()
    """In place of that one, where there are several."""
    payload: bool = False
    """Whether a payload counts; older files do not have the key: there none counted."""
    targets: tuple[Vector3, ...] = ()
    """Places on the tip by which effects know where the targets are; none where no effect depends on that."""


class BasisPart(Section):
    """A function of covariates."""

    form: str
    of: tuple[str, ...]
    numbers: tuple[float, ...]

    @model_validator(mode="after")
    def _can_be_evaluated(self) -> BasisPart:
        if self.form != "1" and not _works(self.form, self.of, self.numbers):
            raise ValueError(
                f"no function {self.form!r} of {len(self.of)} covariates and these {len(self.numbers)} numbers"
            )
        return self

    @property
    def function(self) -> Basis:
        """The basis; the constant 1 depends on nothing, though files of older versions named a covariate."""
        return ALWAYS if self.form == ALWAYS.form else Basis(self.form, self.of, self.numbers)


def _works(form: str, of: Sequence[str], numbers: Sequence[float]) -> bool:
    """True of a basis that has finite values where it is centred, and beside that."""
    if form not in FORMS or (form == "label" and not (len(of) == 1 and is_label(of[0]))):
        return False
    places = np.array([*numbers[:1], 0.5])
    try:
        with np.errstate(all="ignore"):
            values = FORMS[form].value([places] * len(of), numbers)
        FORMS[form].name.format(of=of, n=numbers)
    except (IndexError, ArithmeticError):
        return False
    return bool(np.isfinite(values).all())


class CoefficientPart(Section):
    """One coefficient; its name and its standard deviation are for readers."""

    name: str
    where: str
    component: str
    basis: BasisPart
    station: str | None
    value: Number
    std: Annotated[float, Field(ge=0, allow_inf_nan=True)]


class CovariancePart(Section):
    """The lower triangle of a covariance, row by row."""

    layout: str
    data: str


class SolvedPart(Section):
    """A model with its coefficients."""

    world_base: Annotated[tuple[FramePart, ...], Field(min_length=1)]
    tip_target: Annotated[tuple[FramePart, ...], Field(min_length=1)]
    loads: LoadsPart
    coefficients: tuple[CoefficientPart, ...]
    covariance: CovariancePart

    @model_validator(mode="after")
    def _matches(self) -> SolvedPart:
        unpacked(self.covariance.data, len(self.coefficients))
        worlds = len(self.loads.gravity) if isinstance(self.loads.gravity[0], tuple) else 1
        if worlds not in (1, len(self.world_base)):
            raise ValueError(f"loads.gravity: {worlds} vectors for {len(self.world_base)} stations")
        if len(self.loads.targets) not in (0, len(self.tip_target)):
            raise ValueError(f"loads.targets: {len(self.loads.targets)} places for {len(self.tip_target)} frames")
        return self


class NoisePart(Section):
    """Noise per axis, [m] and [rad]."""

    position: Annotated[float, Field(ge=0, le=LARGEST_SETTING)]
    rotation: Annotated[float, Field(ge=0, le=LARGEST_SETTING)]


class LargestPart(Section):
    """Largest standard deviation of predictions at the fitted rows, [m] and [rad]; infinite where it is not known."""

    position: Annotated[float, Field(ge=0, allow_inf_nan=True)] = np.inf
    rotation: Annotated[float, Field(ge=0, allow_inf_nan=True)] = np.inf


class UnobservablePart(Section):
    """One constant of a combination that no reading tells, and how far it may be off together with the others."""

    where: str
    component: str
    station: str | None = None
    value: Number


class ChangePart(Section):
    """One coefficient, and by how much it differs with a rival."""

    where: str
    component: str
    basis: BasisPart
    station: str | None
    value: Number


class RivalPart(Section):
    """A cause that the rows could not tell from the one named; its words are for readers."""

    effect: str
    instead_of: str
    weight: Annotated[float, Field(ge=0, le=1)]
    change: tuple[ChangePart, ...]


Pair = tuple[float, float]

Ranges = tuple[Pair, ...]


class CalibrationDocument(Settings):
    """The keys of `calibration.yaml` that a model is made of."""

    aridcal: str
    kind: Literal["pose", "position"]
    robot: RobotPart
    noise: NoisePart
    ranges: dict[str, Pair]
    recorded: dict[str, Pair] = Field(default_factory=dict)
    holes: dict[str, tuple[Pair, ...]] = Field(default_factory=dict)
    largest_std: LargestPart = LargestPart()
    geometric: SolvedPart
    final: SolvedPart
    untold: tuple[tuple[UnobservablePart, ...], ...] = ()
    rivals: tuple[RivalPart, ...] = ()


SUM_SLACK = 1e-9
"""Excess over 1 that a sum of probabilities may have by rounding."""


class TailsPart(Section):
    """Student's t: its degrees of freedom, and its scale per axis."""

    freedom: Annotated[float, Field(gt=0, le=LARGEST_SETTING)]
    sigma: Annotated[float, Field(gt=0, le=LARGEST_SETTING)]


class ScatterPart(Section):
    """Scatter of the fitted rows about the model: sigma per axis, and the degrees of freedom behind it."""

    sigma: Annotated[float, Field(gt=0, le=LARGEST_SETTING)]
    freedom: Annotated[float, Field(gt=0, allow_inf_nan=True)]
    tails: TailsPart | None = None


class WanderPart(Section):
    """A process that the zeros of joints may follow from place to place."""

    over: Literal["own", "all"]
    length: Annotated[float, Field(gt=0, le=LARGEST_SETTING)]
    turning: Annotated[float, Field(ge=0, le=LARGEST_SETTING)]
    sliding: Annotated[float, Field(ge=0, le=LARGEST_SETTING)]
    probability: Annotated[float, Field(gt=0, le=1.0 + SUM_SLACK)]


class CalibrationRecord(Section):
    """Keys beside the model that some command reads."""

    campaign: str = ""
    derived_columns: tuple[str, ...] = ()
    frames_by: FramesBy = "station"
    """Column that says which frames a row has, where there are several."""
    scatter: dict[Literal["position", "rotation"], ScatterPart] = Field(default_factory=dict)
    """Scatter that new rows are compared with; older files have none."""
    scatter_of_kinds: dict[str, dict[str, ScatterPart]] = Field(default_factory=dict)
    """Scatter of other kinds of measurements, by kind and channel."""
    wander: tuple[WanderPart, ...] = ()
    """Processes that joint zeros may follow from place to place; older files have none."""

    @model_validator(mode="after")
    def _sum(self) -> CalibrationRecord:
        if sum(process.probability for process in self.wander) > 1.0 + SUM_SLACK:
            raise ValueError("wander: probabilities of more than 1 in all")
        return self


def read_calibration(path: Path) -> tuple[CalibrationDocument, dict[str, Any]]:
    """Read and check `calibration.yaml`.

    Returns:
        The keys of the model, and all other keys.

    Raises:
        CampaignError: naming the file, the line and the key.
    """
    text = decode(read_file(path, CampaignError, CALIBRATION), path, CampaignError)
    try:
        keys, lines = parse_yaml(text, path)
        if keys.get("format") != 1:
            raise CampaignError(f"{path}: `format: 1` expected on top")
        model_keys = CalibrationDocument.model_fields.keys() - {"limits"}
        record = {key: value for key, value in keys.items() if key not in model_keys}
        checked = {key: value for key, value in record.items() if key in CalibrationRecord.model_fields}
        validated(checked, lines, path, CalibrationRecord)
        of_model = {key: value for key, value in keys.items() if key in model_keys}
        return validated(of_model, lines, path, CalibrationDocument), record
    except CampaignError as problem:
        raise CampaignError(f"{problem}. {NOT_OURS}") from None


def unobservable_document(combinations: Sequence[OpenCombination]) -> list[list[dict[str, Any]]]:
    """Combinations of constants that no reading tells, as plain data."""
    return [
        [{"where": c.where, "component": c.component, "station": c.station, "value": value} for c, value in part]
        for part in combinations
    ]


def unobservable_combinations(document: CalibrationDocument) -> tuple[OpenCombination, ...]:
    """Combinations from what :func:`unobservable_document` wrote."""
    return tuple(
        tuple((Coefficient(e.where, e.component, station=e.station), e.value) for e in part) for part in document.untold
    )


def rivals_document(rivals: Sequence[Rival]) -> list[dict[str, Any]]:
    """Causes that the rows could not tell from the effects, as plain data."""
    return [
        {
            "effect": rival.effect,
            "instead_of": rival.instead_of,
            "weight": rival.weight,
            "change": [
                {
                    "where": c.where,
                    "component": c.component,
                    "basis": {
                        "form": c.basis.form,
                        "of": list(c.basis.of),
                        "numbers": [float(n) for n in c.basis.numbers],
                    },
                    "station": c.station,
                    "value": value,
                }
                for c, value in rival.change
            ],
        }
        for rival in rivals
    ]


def rivals_of(document: CalibrationDocument) -> tuple[Rival, ...]:
    """Causes from what :func:`rivals_document` wrote."""
    return tuple(
        Rival(
            rival.effect,
            rival.instead_of,
            rival.weight,
            tuple(
                (
                    Coefficient(e.where, e.component, e.basis.function, e.station),
                    e.value,
                )
                for e in rival.change
            ),
        )
        for rival in document.rivals
    )


def packed(covariance: np.ndarray) -> str:
    """A covariance (K, K) as text."""
    lower = covariance[np.tril_indices(len(covariance))]
    return base64.b64encode(lower.astype("<f8").tobytes()).decode("ascii")


def unpacked(data: str, count: int) -> np.ndarray:
    """The covariance (count, count) of :func:`packed`.

    Raises:
        ValueError: it is of another size, or not finite.
    """
    size = count * (count + 1) // 2
    try:
        content = base64.b64decode(data, validate=True)
    except (binascii.Error, ValueError):
        raise ValueError("covariance.data: is no base64") from None
    if len(content) != 8 * size:
        raise ValueError(f"covariance.data: has {len(content)} bytes, {count} coefficients need {8 * size}")
    covariance = np.zeros((count, count))
    covariance[np.tril_indices(count)] = np.frombuffer(content, dtype="<f8")
    if not np.isfinite(covariance).all():
        raise ValueError("covariance.data: holds what is no finite number")
    return covariance + np.tril(covariance, -1).T
