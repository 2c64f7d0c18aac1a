"""Everything that a calibration results in: stages, and their errors on fitted and held-out rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.noise import RepeatScatter
from aridcal.engine.instruments.channels import Channels, norms
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.noise_causes import NoiseCauses
from aridcal.engine.search.residual_trends import Traces
from aridcal.engine.trust.certainty import Certainty
from aridcal.engine.trust.gains import Diagnosis, NamedEffect
from aridcal.engine.trust.iso9283 import Iso9283, iso_9283
from aridcal.engine.trust.second_look import SecondLook
from aridcal.engine.trust.target_uncertainty import TargetView, target_view
from aridcal.engine.trust.uncertainty import Precision
from aridcal.files.campaign import Campaign
from aridcal.jobs.calibrate.instrument_results import ThingValue, thing_values
from aridcal.jobs.calibrate.measuring_head import MeasuringHead
from aridcal.jobs.calibrate.verdict import Verdict
from aridcal.system.wording import enumeration

STATISTICS = ("rms", "mean", "median", "p95", "max")


@dataclass(frozen=True)
class Stage:
    """One model and its residual.

    Attributes:
        name: ``nominal``, ``geometric`` or ``final``.
        fit: The solved model.
        residual: Measured minus predicted for every row, shape (N, m), in the channels' units; NaN in those that a row does
            not measure.
    """

    name: str
    fit: Fit
    residual: np.ndarray


@dataclass(frozen=True)
class Verification:
    """Another day's data, scored with the models that were identified.

    Attributes:
        file: Where it came from.
        measurements: Its rows.
        residuals: Measured minus predicted of each stage, shape (N, m).
        outlier: Rows that are off by more than 10 robust scales even with the frames fitted anew, shape (N,) bool.
        realigned: Residual of the final stage after fitting the two frames anew: remounting target or tracker has no part in it.
        copied: Number of rows of the table that the campaign has itself: they are left out.
    """

    file: str
    measurements: Dataset
    residuals: dict[str, np.ndarray]
    outlier: np.ndarray
    realigned: np.ndarray | None
    copied: int = 0

    @property
    def left_out(self) -> str:
        """The notice on rows that were left out; empty if none were."""
        if not self.copied:
            return ""
        return (
            f"{self.copied} of the {self.copied + len(self.measurements)} rows of {self.file} are the campaign's own, with the "
            "same joints and the same measurements: they say nothing of another day and are left out"
        )


@dataclass(frozen=True)
class Outcome:
    """The result of one campaign.

    Attributes:
        campaign: The job.
        robot: The nominal chain.
        measurements: All usable rows.
        stages: nominal, geometric, final.
        outlier: Flagged rows, shape (N,): one set for all stages.
        noise: Noise of each channel per axis, shape (C,).
        noise_source: ``declared`` or ``estimated``.
        repeats: Rows that repeat a configuration; None where there are none.
        precision: Uncertainty of the target.
        verdict: The decision on what remains.
        notices: Sentences that the user should read.
        seconds: Wall time.
        verification: Another day's data, if it was given.
        diagnosis: The search for undeclared effects.
        traces: On what the residual depends.
        head: The measuring head, for ``kind: camera_sonar``.
        certainty: How well the target is known over the workspace, and what a region keeps within; None for a repair.
        causes: What the scatter of the rows is made of; None where that was not asked.
        second_look: What parts of its rows say of the calibration; None where that was not asked.
    """

    campaign: Campaign
    robot: Robot
    measurements: Dataset
    stages: tuple[Stage, ...]
    outlier: np.ndarray
    noise: np.ndarray
    noise_source: str
    repeats: RepeatScatter | None
    precision: Precision
    verdict: Verdict
    notices: tuple[str, ...]
    seconds: float
    traces: Traces
    verification: Verification | None = None
    diagnosis: Diagnosis | None = None
    head: MeasuringHead | None = None
    certainty: Certainty | None = None
    causes: NoiseCauses | None = None
    second_look: SecondLook | None = None

    @property
    def scatter(self) -> np.ndarray:
        """Scatter of each channel per axis, shape (C,): the instrument's noise together with all causes beyond it."""
        beyond = self.causes.beyond if self.causes is not None else np.zeros(len(self.noise))
        return np.hypot(self.noise, beyond)

    @property
    def channels(self) -> Channels:
        """Channels of the rows."""
        return self.measurements.channels

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """Accepted and declared effects."""
        return () if self.diagnosis is None else self.diagnosis.effects

    @cached_property
    def at_target(self) -> TargetView:
        """The rows as seen from the target of the final model."""
        return target_view(self.stages[-1].fit, self.measurements)

    @cached_property
    def things(self) -> tuple[ThingValue, ...]:
        """Identified numbers of the things that the rows refer to."""
        m = self.measurements
        return thing_values(self.stages[-1].fit, m.fitted)

    @cached_property
    def iso(self) -> Iso9283 | None:
        """Figures by the definitions of ISO 9283; None where no pose of one target was attained twice."""
        first, last = (
            (stage.fit.model.frames(stage.fit.theta)[0], stage.residual) for stage in (self.stages[0], self.stages[-1])
        )
        return iso_9283(self.measurements, self.outlier, first, last)

    def stage(self, name: str) -> Stage:
        """The first or last stage of that name."""
        return next(s for s in self.stages if s.name == name)

    def parts(self) -> dict[str, np.ndarray]:
        """Masks of the rows that are scored: ``train`` and ``test`` without outliers, ``test_all`` with them."""
        test = self.measurements.test
        return {"train": ~test & ~self.outlier, "test": test & ~self.outlier, "test_all": test}


def errors(residual: np.ndarray, mask: np.ndarray, channels: Channels) -> dict[str, dict[str, float]]:
    """Error statistics of some rows.

    Args:
        residual: Shape (N, m), [m] and [rad].
        mask: Rows to count, shape (N,).
        channels: Channels of the residual.

    Returns:
        For each channel's key, ``position_mm`` for instance, rms, mean, median, p95 and max of the norm of its residual over
        the rows that measure it; nan where no row counts.
    """
    lengths = norms(residual[mask], channels)
    return {c.key: statistics(c.scale * length[~np.isnan(length)]) for c, length in zip(channels, lengths, strict=True)}


def leading(rows: Dataset) -> tuple[int, ...]:
    """Channels whose errors judge a calibration: the first of each block; of poses the position."""
    first = np.cumsum([0, *(len(block.channels) for block in rows.blocks)])
    return tuple(first[:-1].tolist())


def rms_in_words(residual: np.ndarray, mask: np.ndarray, rows: Dataset) -> str:
    """RMS errors of some rows in words: ``0.123 mm``, of several instruments ``0.123 mm and 0.301 px``.

    Args:
        residual: Of the rows that ``mask`` chooses from, shape (N, m).
        mask: Shape (N,).
        rows: All N rows, for their channels.
    """
    figures = errors(residual, mask, rows.channels)
    channels = [rows.channels[k] for k in leading(rows)]
    measured = [c for c in channels if not np.isnan(figures[c.key]["rms"])] or channels[:1]
    return enumeration([f"{figures[c.key]['rms']:.3f} {c.shown}" for c in measured])


def statistics(values: np.ndarray) -> dict[str, float]:
    """rms, mean, median, p95 and max of absolute values, shape (N,)."""
    if len(values) == 0:
        return dict.fromkeys(STATISTICS, float("nan"))
    return {
        "rms": float(np.sqrt(np.mean(values**2))),
        "mean": float(np.mean(values)),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "max": float(np.max(values)),
    }
