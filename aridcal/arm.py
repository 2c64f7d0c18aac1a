"""The arm calibrated from measured poses: frames and constants, then effects that nobody declared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from aridcal.campaign import Campaign
from aridcal.diagnosis import Bound, Diagnosed, diagnose, surroundings
from aridcal.geometry import Geometry, declared_noise, fit_geometry, observations, recentred
from aridcal.measurements import Measurements
from aridcal.quality import joint_kinds
from aridcal.robot import Robot
from aridcal.solver import Fit, Noise


@dataclass(frozen=True)
class Arm:
    """A calibrated arm.

    Attributes:
        rows: All rows, those kept for the test too.
        noise: As it was declared.
        geometry: Frames alone, and frames with constants; the latter recentred and knowing gravity.
        bound: The geometric stage and the training rows.
        diagnosed: The final model and how it came about.
    """

    rows: Measurements
    noise: Noise
    geometry: Geometry
    bound: Bound
    diagnosed: Diagnosed


def bind(campaign: Campaign, geometric: Fit, rows: Measurements, stale: np.ndarray) -> Bound:
    """Rows as models see them that are built on the geometric stage."""
    measured = observations(rows, campaign.measurements.noise.rows)
    return Bound(geometric, rows, measured, stale, tuple(joint_kinds(geometric.model.robot)))


def fit_constants(
    campaign: Campaign, robot: Robot, rows: Measurements, labels: tuple[str, ...], stale: np.ndarray
) -> Geometry:
    """Frames and constants from the training rows, the frames at their identified place."""
    train = ~rows.test
    part = rows.select(train)
    found = fit_geometry(campaign, robot, part, labels, declared_noise(campaign, part), stale[train])
    geometric = recentred(found.geometric)
    around = surroundings(campaign, geometric.model)
    return replace(found, geometric=replace(geometric, model=replace(geometric.model, around=around)))


def fit_arm(
    campaign: Campaign, geometry: Geometry, rows: Measurements, stale: np.ndarray, progress: Callable[[str], None]
) -> Arm:
    """Look for what the constants do not explain, on the training rows, and fit all together."""
    train = ~rows.test
    part = rows.select(train)
    noise = declared_noise(campaign, part)
    bound = bind(campaign, geometry.geometric, part, stale[train])
    return Arm(rows, noise, geometry, bound, diagnose(campaign, bound, noise, progress))
