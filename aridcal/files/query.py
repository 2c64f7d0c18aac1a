"""Rows that ask for poses or commands."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from aridcal.engine.corrections.labels import LABEL_COLUMN, label_columns
from aridcal.engine.robot.chain import JointKind
from aridcal.engine.rows.remarks import Remark
from aridcal.files.checks import check_units, note_limits
from aridcal.files.measurement_settings import TARGET, MeasurementSettings
from aridcal.files.quantities import POSITION_COLUMNS, TableSource
from aridcal.system.errors import MeasurementError
from aridcal.system.reading.regular_files import TABLE_LIMIT, Limit

if TYPE_CHECKING:
    import pandas as pd

    from aridcal.files.tables import AnyTable, Table


FramesBy = Literal["station", "target", "both"]
"""Columns that say which of several frames a row has."""


@dataclass(frozen=True)
class QueryRows:
    """Rows that ask for poses or for commands; numbers that a row lacks are NaN.

    Attributes:
        readings: Shape (N, columns), [rad] or [m].
        position: Shape (N, 3), [m]; `None` unless poses were asked for.
        quaternion: Unit, qx qy qz qw, shape (N, 4); `None` likewise.
        covariates: Every other numeric column, shape (N,).
        station: Labels of their frames, shape (N,), or `None`: of their stations, or of their targets where these alone differ.
        line: Line of the file, shape (N,).
        usable: Rows without a fault in the cells that are needed, shape (N,) bool.
        refused: Remarks on the other rows.
        notices: Remarks on cells that are odd but used.
        target: Labels of their targets, shape (N,), where stations and targets differ.
    """

    readings: np.ndarray
    position: np.ndarray | None
    quaternion: np.ndarray | None
    covariates: dict[str, np.ndarray]
    station: np.ndarray | None
    line: np.ndarray
    usable: np.ndarray
    refused: tuple[Remark, ...]
    notices: tuple[Remark, ...]
    target: np.ndarray | None = field(default=None, kw_only=True)

    def labels(self, rows: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Labels of the frames of some rows at the base and at the target, as a model takes them."""
        station, target = (None if of is None else of[rows] for of in (self.station, self.target))
        return station, target


@dataclass(frozen=True)
class Query(QueryRows):
    """Every row of a file that asks for poses or for commands.

    Attributes:
        table: All columns as they were given, in their order; cells of a csv file are text.
    """

    table: pd.DataFrame


@dataclass
class Remarks:
    """Remarks on the stretches of a table: all are counted, the first few kept.

    Attributes:
        most: Remarks that are shown.
        refused: The first remarks on unusable rows.
        notices: The first remarks on cells that are odd but used.
        count: Number of all remarks.
    """

    most: int
    refused: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    count: int = 0

    def add(self, query: Query) -> None:
        """Take in one more stretch; what concerns a whole column is said once."""
        new = [str(n) for n in query.notices if n.row is not None or str(n) not in self.notices]
        self.count += len(query.refused) + len(new)
        self.refused += [str(r) for r in query.refused[: self.most - len(self.refused)]]
        self.notices += new[: self.most - len(self.notices)]

    def lines(self) -> list[str]:
        """The remarks that are shown, first those on unusable rows, and the number of all others."""
        shown = [*self.refused, *self.notices][: self.most]
        more = self.count - len(shown)
        return [*shown, f"and {more} more remarks"] if more else shown


def load_query(
    query: AnyTable | Table,
    readings: Sequence[str],
    limits: np.ndarray,
    kinds: Sequence[JointKind],
    settings: MeasurementSettings | None = None,
    *,
    poses: bool = False,
    per_station: bool = False,
    label: FramesBy = "station",
    needs: Collection[str] = (),
    of_labels: Collection[str] = (),
    stated: Collection[str] = (),
    limit: Limit = TABLE_LIMIT,
) -> Query:
    """Read a table of joint readings, or of wanted poses, keeping every row and column.

    Args:
        query: A csv or parquet file, a DataFrame, or a stretch of one of these.
        readings: Joints of the robot; all needed, unless `poses`: then those present are seeds.
        limits: As for :func:`load_measurements`.
        kinds: As for :func:`load_measurements`.
        settings: Columns, units and orientations; default: those of FORMATS, in SI.
        poses: The pose of the target is needed, its position only if `settings.kind` is `position`.
        per_station: The columns that say which frames a row has are needed.
        label: Which columns these are.
        needs: Covariates that every row needs, where they have a column.
        of_labels: Covariates of stations (see :mod:`aridcal.engine.corrections.labels`); their column is then needed, its
            cells may be empty.
        stated: Joints whose position the campaign states: they may have no column.
        limit: How large the table may be.

    Raises:
        MeasurementError: the file cannot be read, lacks columns or has rows that are no rows; a joint or a pose is text; a
            covariate that is needed has a hole; its poses have two orientations that contradict each other, even where
            they are not asked for.
    """
    from aridcal.files.tables import Table, read_tables  # slow to load: only where there are tables

    settings = settings or MeasurementSettings()
    dialect = settings.table.dialect
    needed = [settings.columns.get(name, name) for name in (POSITION_COLUMNS if poses else readings)]
    table = query if isinstance(query, Table) else read_tables([query], (), limit, dialect, needed)
    if table.refused:
        raise MeasurementError(f"{table.title}: {table.refused[0]}; mend the file")
    source = TableSource(table, settings, tuple(readings), kinds, limits, table.title, stated)
    q = source.seeds() if poses else source.joints()
    position, quaternion = None, None
    if poses and not settings.traits.place_alone:
        position, quaternion = source.pose()
    elif poses:
        position = source.position()
    if not settings.traits.place_alone:
        source.refuse_second_orientation()
    if per_station and label != LABEL_COLUMN:
        table.require([source.column(TARGET)], "this calibration has several targets: name one in each row")
    first = TARGET if label == TARGET else LABEL_COLUMN
    station = source.labels(first, needed=first if per_station else "")
    target = source.labels(TARGET, needed=TARGET) if label == "both" else None
    of_stations = station
    if of_labels:
        why = "this calibration has constants by station: name each row's, or leave its cell empty for the one model of all"
        source.table.require([source.column(LABEL_COLUMN)], why)
        of_stations = station if first == LABEL_COLUMN else source.labels(LABEL_COLUMN)
    covariates = source.covariates() | label_columns(of_labels, of_stations)
    _refuse_text(source, poses)
    _refuse_holes(source, covariates, needs)
    if source.usable.any():
        check_units(source, q, position)
        note_limits(source, q)
    for values in (q, position, quaternion):
        if values is not None:
            values[~source.usable] = np.nan
    return Query(
        table=table.frame() if isinstance(query, str | Path | Table) else query.copy(),
        readings=q,
        position=position,
        quaternion=quaternion,
        covariates=covariates,
        station=station,
        line=table.line,
        usable=source.usable,
        refused=source.refusals(),
        notices=tuple(source.notices),
        target=target,
    )


def seeded(poses: AnyTable, seed: AnyTable, settings: MeasurementSettings, readings: Sequence[str]) -> pd.DataFrame:
    """Wanted poses with the joints of other rows, as many as there are poses.

    Raises:
        MeasurementError: the seeds lack a joint, or are not as many.
    """
    from aridcal.files.tables import read_tables  # as above

    joints = [settings.columns.get(name, name) for name in readings]
    places = [settings.columns.get(name, name) for name in POSITION_COLUMNS]
    dialect = settings.table.dialect
    start = read_tables([seed], dialect=dialect, needed=joints)
    start.require(joints, "`seed` has a column for each joint")
    import pandas as pd  # slow to load: only where somebody has DataFrames

    rows = start.frame()
    table = poses if isinstance(poses, pd.DataFrame) else read_tables([poses], dialect=dialect, needed=places).frame()
    if len(rows) != len(table):
        raise MeasurementError(f"{start.title}: {len(rows)} rows of seeds for {len(table)} poses: give one for each")
    return table.assign(**{joint: rows[joint].to_numpy() for joint in joints})


def _refuse_text(source: TableSource, poses: bool) -> None:
    """Refuse a table with words among its joints or poses: an empty cell asks for nothing, a word is a slip."""
    pose_columns = [source.column(name) for name in POSITION_COLUMNS] if poses else []
    pose_columns += source.orientation_columns if poses and not source.settings.traits.place_alone else []
    for name in (*source.joint_columns, *pose_columns):
        if name in source.table.cells:
            _, is_text = source.table.numbers(name)
            _refuse(source, is_text, name, "not a number", "write one, or leave the cell empty")


def _refuse_holes(source: TableSource, covariates: dict[str, np.ndarray], needs: Collection[str]) -> None:
    """Refuse a table in which a covariate that an effect depends on is not known in every usable row."""
    for name in needs:
        if name in covariates:
            holes = np.isnan(covariates[name]) & source.usable
            advice = "the calibration has an effect that depends on it: give its value in every row"
            _refuse(source, holes, source.column(name), "missing", advice)


def _refuse(source: TableSource, bad: np.ndarray, column: str, why: str, advice: str) -> None:
    """Refuse the table for some of its rows (N,), naming the first."""
    rows = np.flatnonzero(bad)
    if len(rows):
        more = f", like {len(rows) - 1} more in this column" if len(rows) > 1 else ""
        raise MeasurementError(f"{source.table.remark(int(rows[0]), column, why)}{more}; {advice}")
