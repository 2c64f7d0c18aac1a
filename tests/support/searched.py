"""Campaigns that are read, fitted and searched, without the trust in them: three fifths of the time of a whole outcome."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.fit.constants import station_labels
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.question import Question
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.loop import CalibratedArm, calibrated_arm, fit_constants
from aridcal.jobs.calibrate.job_inputs import read_job
from aridcal.jobs.calibrate.outcome import errors
from aridcal.jobs.calibrate.pipeline import JudgedArm, judge_arm
from aridcal.system.progress import SILENT


@dataclass(frozen=True)
class Searched:
    """A calibrated arm, asked as an outcome would be."""

    arm: CalibratedArm

    @property
    def rows(self) -> Dataset:
        return self.arm.rows

    @property
    def fit(self) -> Fit:
        """Of the final model."""
        return self.arm.diagnosed.fit

    @property
    def effects(self) -> tuple[Effect, ...]:
        return tuple(active.effect for active in self.arm.diagnosed.stepwise.state.active)

    @property
    def named(self) -> set[tuple[str, str]]:
        """Kind and place of each effect."""
        return {(effect.kind, effect.where) for effect in self.effects}

    @cached_property
    def judged(self) -> JudgedArm:
        return judge_arm(self.arm)

    @property
    def verdict(self) -> str:
        return self.judged.verdict.word

    def error(self, stage: str) -> float:
        """RMS position error of the held-out rows, without outliers, [mm]."""
        (residual,) = (s.residual for s in self.judged.stages if s.name == stage)
        mask = self.rows.test & ~self.judged.outlier
        return float(errors(residual, mask, self.rows.channels)["position_mm"]["rms"])


def searched(campaign: Path) -> Searched:
    """A campaign from its files up to its calibrated arm."""
    job = read_job(campaign)
    return searched_rows(job.campaign.question, job.robot, job.rows)


def searched_rows(question: Question, robot: Robot, rows: Dataset) -> Searched:
    """Rows up to their calibrated arm."""
    labels = station_labels(question, rows)
    return Searched(calibrated_arm(question, robot, rows, labels, fit_constants(question, robot, rows, labels), SILENT))
