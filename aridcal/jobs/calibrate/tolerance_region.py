"""The configurations of a region where the target is to be known, as a campaign or a table names it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.inverse.reachable import readings_for_poses
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.certainty import Requirement
from aridcal.engine.trust.workspace import WORKSPACE_SAMPLES, spread_out
from aridcal.files.campaign import Campaign
from aridcal.files.counting import counting
from aridcal.files.orientations import column_of
from aridcal.files.quantities import POSITION_COLUMNS
from aridcal.files.query import load_query
from aridcal.files.tables import read_tables
from aridcal.system.errors import CampaignError, MeasurementError, nearest

Reach = Callable[[np.ndarray], np.ndarray]
"""From places of the target in the world, shape (R, 3), [m], to readings that bring it there, shape (R, columns)."""


def region_of_table(campaign: Campaign, robot: Robot, path: Path, reach: Reach) -> np.ndarray:
    """Readings of a table of joints, or of readings that bring the target to a table's places, shape (R, columns).

    Args:
        campaign: Its columns and units are the table's.
        robot: The chain.
        path: The table.
        reach: Finds readings for places.

    Raises:
        MeasurementError: the table has neither, or a row of it cannot be used.
        CampaignError: the arm does not reach a place.
    """
    settings, limit = campaign.measurements, campaign.limits.table
    joints = [settings.columns.get(name, name) for name in robot.readings]
    places = [column_of(name, settings, robot.readings) for name in POSITION_COLUMNS]
    dialect = settings.table.dialect
    names = set(read_tables([path], (), limit, dialect, joints).names)
    if not set(joints) <= names:
        names = set(read_tables([path], (), limit, dialect, places).names)
    if not (set(joints) <= names or set(places) <= names):
        raise MeasurementError(
            f"{path}: should have the columns of all joints ({', '.join(joints)}) or of the target's places ({', '.join(places)})"
        )
    by_joints = set(joints) <= names
    plain = settings.model_copy(update={"kind": "position"})
    query = load_query(
        path, robot.readings, robot.limits, robot.kinds, plain,
        poses=not by_joints, stated=robot.stated.names, limit=limit,
    )  # fmt: skip
    if query.refused:
        raise MeasurementError(f"{query.refused[0]}; mend the row, or delete it")
    if by_joints:
        return query.readings
    assert query.position is not None
    return reach(query.position)


def region(campaign: Campaign, fit: Fit, train: Dataset) -> np.ndarray | None:
    """Configurations of the region that a campaign names, shape (R, columns); None where it names none.

    Args:
        campaign: Names it.
        fit: Frames and constants, at least.
        train: The rows that were fitted.

    Raises:
        AridcalError: what the campaign names needs mending.
    """
    settings, robot = campaign.region, fit.model.robot
    if settings.file is None and not settings.joints:
        return None
    if settings.file is None:
        return spread_out(
            *corners(campaign, robot, np.nanmin(train.readings, axis=0), np.nanmax(train.readings, axis=0))
        )
    path = settings.file

    def reach(places: np.ndarray) -> np.ndarray:
        def pose(readings: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            like = np.full(len(readings), train.as_read[-1])
            covariates = {name: values[like] for name, values in train.conditions.items()}
            station, target = (None if v is None else v[like] for v in (train.labels.station, train.labels.target))
            R, p = fit.model.poses(fit.theta, fit.model.rows(readings, covariates, station, target))
            return R, p + R @ np.array(settings.tool)

        def miss(R: np.ndarray, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return p - places[rows]

        advice = f"take places out of {path} that it cannot reach"
        return readings_for_poses(robot, pose, miss, len(places), np.random.default_rng(0), str(campaign.path), advice)

    readings = region_of_table(campaign, robot, path, reach)
    if len(readings) <= WORKSPACE_SAMPLES:
        return readings
    return readings[np.linspace(0, len(readings) - 1, WORKSPACE_SAMPLES).round().astype(int)]


def requirement(campaign: Campaign) -> Requirement:
    """The point, tolerance and title of the region that a campaign names."""
    settings, tolerance = campaign.region, campaign.tolerance
    title = "the joint ranges named" if settings.file is None else f"the places of {settings.file.name}"
    return Requirement(
        settings.tool, (None, None) if tolerance is None else (tolerance.position, tolerance.rotation), title
    )


def corners(campaign: Campaign, robot: Robot, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest readings of the region that a campaign names by joints, shape (columns,) each.

    Args:
        campaign: Names it.
        robot: The chain.
        low: Lowest readings, for joints that are not named, shape (columns,).
        high: Highest readings, likewise.

    Raises:
        CampaignError: there is no such joint, or it cannot go there.
    """
    low, high = low.copy(), high.copy()
    columns = {campaign.measurements.columns.get(name, name): k for k, name in enumerate(robot.readings)}
    columns |= {name: k for k, name in enumerate(robot.readings)}
    scales = counting(campaign.measurements, robot.readings, robot.kinds)
    limits = scales.cells(robot.limits.T)
    for name, ends in campaign.region.joints.items():
        place = f"{campaign.path}: region.joints.{name}"
        if name not in columns:
            raise CampaignError(f"{place}: there is no such joint{nearest(name, columns)}")
        k = columns[name]
        low[k], high[k] = np.sort(scales.sign[k] * (scales.unit[k] * np.array(ends) - scales.zero[k]))
        if low[k] < robot.limits[k, 0] or high[k] > robot.limits[k, 1]:
            first, last = np.sort(limits[:, k])
            raise CampaignError(
                f"{place}: lies outside the joint's limits, {first:g} to {last:g}: give a range inside them"
            )
    return low, high
