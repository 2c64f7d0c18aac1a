"""Lines of a growing table as rows of the engine, in the order in which they came; what no row can be is named and left out."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.approach import with_directions
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign
from aridcal.files.read import load_measurements
from aridcal.jobs.guide.growing_table import GrowingTable
from aridcal.system.errors import AridcalError, CampaignError


@dataclass(frozen=True)
class RowsSoFar:
    """All lines that were taken, as far as they are rows.

    Attributes:
        rows: In the order in which they came, N of them; None where there is not one.
        index: Of each among the lines that were taken, shape (N,).
        refused: Why a line is none, by its index.
    """

    rows: Dataset | None
    index: np.ndarray
    refused: dict[int, str]


def no_rows(refused: dict[int, str]) -> RowsSoFar:
    """Nothing that can be used; with why lines are no rows."""
    return RowsSoFar(None, np.zeros(0, dtype=int), refused)


def rows_so_far(campaign: Campaign, robot: Robot, table: GrowingTable, before: RowsSoFar) -> RowsSoFar:
    """Read all lines of a table.

    A line that makes the whole table unreadable, as numbers in another unit do, is found by reading without it.

    Args:
        campaign: Says what the columns mean.
        robot: The nominal chain.
        table: The lines.
        before: What was read of it before: its lines are not tried one by one again.

    Raises:
        CampaignError: the campaign does not fit the table, whatever its rows hold.
    """
    known = [k for k in range(len(table.rows)) if k not in before.refused]
    try:
        return _read(campaign, robot, table, known, dict(before.refused))
    except CampaignError:
        raise
    except AridcalError as error:
        reason = error
    refused = dict(before.refused)
    usable = before.index.tolist()
    for k in known[len([k for k in known if k in set(usable)]) :]:
        try:
            _read(campaign, robot, table, [*usable, k], refused)
        except AridcalError as error:
            refused[k] = str(error)
        else:
            usable.append(k)
    if not usable:
        return no_rows(refused or dict.fromkeys(known, str(reason)))
    return _read(campaign, robot, table, usable, refused)


def _read(campaign: Campaign, robot: Robot, table: GrowingTable, some: list[int], refused: dict[int, str]) -> RowsSoFar:
    """The rows of some lines."""
    if not some:
        return no_rows(refused)
    (path,) = campaign.measurements.files
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(table.text(some))
        try:
            rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds, files=[copy], robot=robot)
        except AridcalError as error:
            raise type(error)(str(error).replace(str(copy), path.name)) from None
    ordered = rows.select(rows.as_read)
    lines = np.array([table.line(k) for k in range(len(table.rows))])
    index = np.array(some)[ordered.origin.line - table.first]
    why = {some[remark.row - table.first]: remark.why for remark in rows.origin.refused if remark.row is not None}
    ordered = replace(ordered, test=np.zeros(len(ordered), dtype=bool)).with_origin(order=lines[index].astype(float))
    return RowsSoFar(with_directions(ordered), index, refused | why)
