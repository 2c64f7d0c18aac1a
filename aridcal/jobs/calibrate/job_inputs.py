"""A campaign and its rows: faults in what users give show here, before the code that fits and searches is loaded."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from aridcal.engine.levels import STILL
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.approach import with_directions
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign, load_campaign, nominal_robot
from aridcal.files.read import load_measurements
from aridcal.jobs.head1992.observations import CampaignRows, Detections
from aridcal.system.errors import CampaignError, MeasurementError
from aridcal.system.progress import SILENT, Progress


@dataclass(frozen=True)
class CalibrationJob:
    """A campaign, its robot and its rows.

    Attributes:
        campaign: The campaign; with a measuring head its target is at the camera.
        robot: The nominal chain.
        rows: Its rows, with the sides that joints came from.
        detections: Detections in images; None where there are no images.
        still: Sentences on joints that never move.
        started: Clock when reading began, [s].
        seed: Of the split into train and test.
        cache: Detections of an earlier run on the same images, if there is one.
    """

    campaign: Campaign
    robot: Robot
    rows: Dataset
    detections: Detections | None
    still: tuple[str, ...]
    started: float
    seed: int
    cache: Path | None


def read_job(
    job: Path | Campaign, seed: int = 0, progress: Progress = SILENT, cache: Path | None = None, verified: bool = False
) -> CalibrationJob:
    """Read a campaign, its robot and its rows.

    Args:
        job: The campaign, or the path of its ``campaign.yaml``.
        seed: Of the split into train and test, where the table has none.
        progress: Called with what is being done.
        cache: ``fiducials.csv`` of an earlier run on the same images, if there is one.
        verified: Whether another day's table is to be scored.

    Raises:
        AridcalError: whatever in the input needs mending.
    """
    started = time.perf_counter()
    campaign = job if isinstance(job, Campaign) else load_campaign(job)
    robot = nominal_robot(campaign)
    progress("reading the measurements")
    if verified and campaign.measurements.head is not None:
        raise CampaignError(f"{campaign.path}: --verify needs a table of poses; `kind: camera_sonar` has shots")
    inputs = read_rows(campaign, robot, cache, seed, progress)
    rows = with_directions(inputs.rows)
    still = _check_motion(inputs.campaign, robot, rows)
    return CalibrationJob(inputs.campaign, robot, rows, inputs.detections, still, started, seed, cache)


def redetect_fiducials(job: CalibrationJob, lens: np.ndarray, progress: Progress) -> CalibrationJob:
    """The job with fiducials sought again in its images by another lens, intrinsics of shape (9,)."""
    inputs = read_rows(job.campaign, job.robot, job.cache, job.seed, progress, lens)
    rows = with_directions(inputs.rows)
    return replace(job, rows=rows, detections=inputs.detections, still=_check_motion(inputs.campaign, job.robot, rows))


def read_rows(
    campaign: Campaign,
    robot: Robot,
    cache: Path | None,
    seed: int,
    progress: Progress,
    lens: np.ndarray | None = None,
) -> CampaignRows:
    """Read the measurements of a campaign, from its tables or from the images of its head."""
    if campaign.measurements.head is not None:
        # OpenCV and pandas load slowly, and most campaigns have no images
        from aridcal.jobs.head1992.detections import read_shots

        return read_shots(campaign, robot, cache, seed, progress, lens)
    return CampaignRows(
        campaign, load_measurements(campaign, robot.readings, robot.limits, robot.kinds, seed, robot=robot)
    )


def _check_motion(campaign: Campaign, robot: Robot, rows: Dataset) -> tuple[str, ...]:
    """Refuse rows that can tell nothing whatever the model, and name the joints that never move."""
    if not rows.train.any():
        raise MeasurementError(f"{rows.title}: every row is held out: mark some as `train` in the column `split`")
    frames = campaign.frames
    constant = frames.world_base.identify or frames.tip_target.identify or campaign.parameters.set != "none"
    if not (constant or campaign.effects or campaign.diagnosis.enabled):
        raise CampaignError(
            f"{campaign.path}: nothing is to be identified: both frames have `identify: false`, `parameters` has "
            "`set: none`, and no effect is declared or sought. Change one of them"
        )
    readings = rows.readings[rows.train]  # cells of joints off a row's path may be empty
    high, low = (np.where(np.isnan(readings), end, readings) for end in (-np.inf, np.inf))
    travel = high.max(axis=0) - low.min(axis=0)
    still = [name for name, moved in zip(rows.names, travel, strict=True) if 0.0 <= moved < STILL]
    if len(still) == len(rows.names):
        count = rows.train.sum()
        why = "there is only one row to fit" if count == 1 else f"no joint moves in any of its {count} rows"
        raise MeasurementError(f"{rows.title}: {why}: nothing can be identified. Measure other configurations")
    return tuple(
        f"{robot.place_in_words(name)} never moves: its parameters are confounded with its neighbours'"
        for name in still
    )
