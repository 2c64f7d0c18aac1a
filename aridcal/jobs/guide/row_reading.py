"""Lines of a growing table as measurements, in the order in which they came; what no row can be is named and left out.

A measurement is a row; of images it is a shot, all rows of one image.
"""

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
        rows: The first row of each measurement, in the order in which they came, N of them; None where there is not one.
        index: Of each among the lines that were taken, shape (N,).
        refused: Why a line is none, by its index.
        every: All rows, M of them; the same as ``rows`` where each is a measurement of its own.
        of: Measurement that each of these belongs to, in ascending order, shape (M,).
        lines: Index of each of these among the lines, shape (M,).
    """

    rows: Dataset | None
    index: np.ndarray
    refused: dict[int, str]
    every: Dataset | None
    of: np.ndarray
    lines: np.ndarray

    def some(self, numbers: np.ndarray) -> tuple[Dataset, np.ndarray]:
        """All rows of some measurements, and the place among these that each belongs to."""
        assert self.every is not None
        if self.every is self.rows:
            return self.every.select(numbers), np.arange(len(numbers))
        members = [np.flatnonzero(self.of == number) for number in numbers.tolist()]
        place = np.repeat(np.arange(len(members)), [len(part) for part in members])
        return self.every.select(np.concatenate(members)), place

    def shift(self, number: int) -> float:
        """How far a measurement is from the one before, [m]; of two images as far as most marks moved, [px]; else NaN."""
        assert self.rows is not None and self.every is not None
        if not number or self.rows.blocks[0].traits.touches:
            return np.nan
        if not self.rows.blocks[0].traits.images:
            return float(np.linalg.norm(self.rows.position[number] - self.rows.position[number - 1]))
        before, now = (np.flatnonzero(self.of == k) for k in (number - 1, number))
        marks = self.every.labels.refers
        pairs = [(i, j) for i in before for j in now if np.array_equal(marks[i], marks[j])]
        moves = [np.linalg.norm(self.every.observed[i, :2] - self.every.observed[j, :2]) for i, j in pairs]
        return float(np.median(moves)) if moves else np.nan

    def lines_of(self, number: int) -> list[int]:
        """Indices of the lines of a measurement."""
        return [int(k) for k in self.lines[self.of == number]]


def no_rows(refused: dict[int, str]) -> RowsSoFar:
    """Nothing that can be used; with why lines are no rows."""
    none = np.zeros(0, dtype=int)
    return RowsSoFar(None, none, refused, None, none, none)


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
    usable = before.lines.tolist()
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
    ordered = with_directions(ordered)
    if not campaign.measurements.traits.images:
        return RowsSoFar(ordered, index, refused | why, ordered, np.arange(len(index)), index)
    of = _shots(ordered)
    first = np.unique(of, return_index=True)[1]
    return RowsSoFar(ordered.select(first), index[first], refused | why, ordered, of, index)


def _shots(rows: Dataset) -> np.ndarray:
    """Number of the image that each row is of, shape (M,): another camera, other joints or a marker again begin a new one."""
    refers, of = rows.labels.refers, np.zeros(len(rows), dtype=int)
    seen: set[str] = set()
    number = -1
    for k in range(len(rows)):
        marker = str(refers[k, -1])
        goes_on = k > 0 and refers[k, 0] == refers[k - 1, 0] and np.array_equal(rows.readings[k], rows.readings[k - 1])
        if not goes_on or marker in seen:
            number, seen = number + 1, set()
        seen.add(marker)
        of[k] = number
    return of
