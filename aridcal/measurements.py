"""Measured rows: read, checked, named where they are wrong, converted to SI and split into train and test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from aridcal.campaign import Campaign, MeasurementSettings
from aridcal.errors import MeasurementError
from aridcal.source import POSITION, STD, TURNS, Kind, Source
from aridcal.tables import Remark, read_tables

TEST_SHARE = 0.2
SAME_ANGLE, SAME_LENGTH = 1e-3, 1e-4  # readings this close repeat one configuration, [rad] and [m]
LIMIT_SLACK = 1e-5  # a limit may be printed with few digits, [rad] or [m]
FAR = 100.0  # farther than any arm reaches, [m]
STUCK = 0.02  # a target that stays within this while joints turn is in the wrong unit, [m]


@dataclass(frozen=True)
class Measurements:
    """Usable rows of a campaign in SI, N of them, in the order of the files.

    Attributes:
        names: The reading columns, by the names of their joints.
        files: The files that were read.
        sha256: Hash of their bytes.
        refused: Rows that cannot be used, each named once; they are not among the N.
        notices: What is odd but used: rows outside limits, columns that are ignored.
        file: Index into `files`, shape (N,).
        line: Line of the file, the header being line 1, shape (N,).
        readings: Joint readings or commands, shape (N, columns), [rad] or [m].
        position: Of the target in the world frame, shape (N, 3), [m]; NaN where no pose was asked for.
        quaternion: Of the target in the world frame, unit, qx qy qz qw, shape (N, 4); `None`: not measured.
        std: 1-sigma of the row, position in [m], then rotation vector in [rad], shape (N, 6); ones for a half
            that the files do not have; `None` if they have neither or the campaign ignores it.
        covariates: Every other numeric column, shape (N,), NaN in its holes.
        station: Label of the rows that share a frame, shape (N,).
        test: Rows kept for the test, shape (N,) bool.
        split_given: True if the files say which rows those are.
        covariance: Of the rows' position [m] and rotation vector [rad] in world axes, shape (N, 6, 6), in place of `std`
            where their components err together; `None`: not known.
    """

    names: tuple[str, ...]
    files: tuple[Path, ...]
    sha256: str
    refused: tuple[Remark, ...]
    notices: tuple[Remark, ...]
    file: np.ndarray
    line: np.ndarray
    readings: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray | None
    std: np.ndarray | None
    covariates: dict[str, np.ndarray]
    station: np.ndarray | None
    test: np.ndarray
    split_given: bool = False
    covariance: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.line)

    def select(self, rows: np.ndarray) -> Measurements:
        """The measurements of some rows, chosen by a mask or by indices; remarks on the files stay."""
        per_row = {f.name: getattr(self, f.name) for f in fields(self)}
        chosen = {name: value[rows] for name, value in per_row.items() if isinstance(value, np.ndarray)}
        return replace(self, **chosen, covariates={name: value[rows] for name, value in self.covariates.items()})


@dataclass(frozen=True)
class Query:
    """Every row of a file that asks for poses or for commands; what a row lacks is NaN there.

    Attributes:
        table: All columns as they were written, in the order of the file.
        readings: Shape (N, columns), [rad] or [m].
        position: Shape (N, 3), [m]; `None` unless poses were asked for.
        quaternion: Unit, qx qy qz qw, shape (N, 4); `None` likewise.
        covariates: Every other numeric column, shape (N,).
        station: Labels, shape (N,), or `None`.
        line: Line of the file, shape (N,).
        usable: Rows in which nothing needed is wrong, shape (N,) bool.
        refused: Why the others are not.
        notices: What is odd but used.
    """

    table: pd.DataFrame
    readings: np.ndarray
    position: np.ndarray | None
    quaternion: np.ndarray | None
    covariates: dict[str, np.ndarray]
    station: np.ndarray | None
    line: np.ndarray
    usable: np.ndarray
    refused: tuple[Remark, ...]
    notices: tuple[Remark, ...]


def load_measurements(
    campaign: Campaign,
    readings: Sequence[str],
    limits: np.ndarray,
    kinds: Sequence[Kind],
    seed: int = 0,
    *,
    files: Sequence[Path] | None = None,
    require_pose: bool = True,
) -> Measurements:
    """Read the measurements of a campaign.

    Args:
        campaign: Says which files, columns, units and orientations.
        readings: Joints whose readings are needed.
        limits: Lower and upper limit of each, shape (columns, 2), [rad] or [m], infinite where there is none.
        kinds: Of each joint; limits of a `continuous` one count whole turns.
        seed: For the split into train and test, where the files have no `split`.
        files: Files in place of the campaign's own, in the same format.
        require_pose: False for rows that measure something else than the target; then `position` is NaN.

    Raises:
        CampaignError: `columns` names an unknown quantity.
        MeasurementError: a file cannot be read, lacks columns, is not in the stated units, or has no usable row.
    """
    settings = campaign.measurements
    paths = [Path(file) for file in (settings.files if files is None else files)]
    readme = campaign.path.parent / "README.md"
    missing = next((path for path in paths if not path.exists()), None)
    if missing is not None and files is None and readme.is_file():
        raise MeasurementError(f"{missing}: there is no such file. {readme} may say where to get it")
    table = read_tables(paths)
    source = Source(table, settings, tuple(readings), str(campaign.path))
    q = source.joints(kinds)
    position, quaternion, std = np.full((len(table), 3), np.nan), None, None
    if require_pose:
        position = source.position()
        quaternion = source.quaternion() if settings.kind == "pose" else None
        std = source.std()
    frames = campaign.frames
    station = source.labels("station", needed="station" in (frames.world_base.per, frames.tip_target.per))
    split = source.split()
    covariates = source.covariates()
    _refuse_copies(source, [q, position, quaternion, std, *covariates.values()], station)
    if not source.usable.any():
        raise _nothing_usable(source)
    _check_units(source, q, limits, kinds, position if require_pose else None)
    _note_limits(source, q, limits, kinds)
    if quaternion is not None:
        _note_stale_poses(source, q, kinds, np.hstack([position, quaternion]))
    rows = Measurements(
        names=tuple(readings),
        files=table.files,
        sha256=table.sha256,
        refused=source.refusals(),
        notices=tuple(source.notices),
        file=table.file,
        line=table.line,
        readings=q,
        position=position,
        quaternion=quaternion,
        std=std,
        covariates=covariates,
        station=station,
        test=np.zeros(len(table), dtype=bool) if split is None else split,
        split_given=split is not None,
    ).select(source.usable)
    return rows if split is not None else replace(rows, test=_split(blocks(rows.readings, kinds), seed))


def load_query(
    path: str | Path,
    readings: Sequence[str],
    limits: np.ndarray,
    kinds: Sequence[Kind],
    settings: MeasurementSettings | None = None,
    *,
    poses: bool = False,
    per_station: bool = False,
) -> Query:
    """Read a file of joint readings, or of wanted poses, keeping every row and column.

    Args:
        path: A csv or parquet file.
        readings: Joints of the robot; all needed, unless `poses`: then those present are seeds.
        limits: As for :func:`load_measurements`.
        kinds: As for :func:`load_measurements`.
        settings: Columns, units and orientations; default: those of FORMATS, in SI.
        poses: The pose of the target is needed, its position only if `settings.kind` is `position`.
        per_station: The `station` column is needed.

    Raises:
        MeasurementError: the file cannot be read, lacks columns or has rows that are no rows.
    """
    settings = settings or MeasurementSettings()
    table = read_tables((Path(path),))
    if table.refused:
        raise MeasurementError(f"{path}: {table.refused[0]}; mend the file")
    source = Source(table, settings, tuple(readings), str(path))
    q = source.seeds(kinds) if poses else source.joints(kinds)
    position = source.position() if poses else None
    quaternion = source.quaternion() if poses and settings.kind != "position" else None
    station = source.labels("station", needed=per_station)
    covariates = source.covariates()
    if source.usable.any():
        _check_units(source, q, limits, kinds, position)
        _note_limits(source, q, limits, kinds)
    for values in (q, position, quaternion):
        if values is not None:
            values[~source.usable] = np.nan
    return Query(
        table=table.frame(),
        readings=q,
        position=position,
        quaternion=quaternion,
        covariates=covariates,
        station=station,
        line=table.line,
        usable=source.usable,
        refused=source.refusals(),
        notices=tuple(source.notices),
    )


def blocks(readings: np.ndarray, kinds: Sequence[Kind]) -> np.ndarray:
    """Number the configurations: rows that repeat one have the same label.

    Rows within 1 mrad and 0.1 mm of each other, or joined by a chain of such rows, always share a label; rows more
    than 1.5 times as far apart do only through a chain. On `continuous` joints whole turns do not count.

    Args:
        readings: Shape (N, columns), [rad] or [m].
        kinds: Kind of each column.

    Returns:
        Labels 0, 1, ... in order of appearance, shape (N,).
    """
    turning = np.array([kind == "continuous" for kind in kinds], dtype=bool)
    same = _same(kinds)
    circle = [f(readings[:, turning]) / SAME_ANGLE for f in (np.cos, np.sin)]
    points = np.hstack([readings[:, ~turning] / same[~turning], *circle])
    # Cells of half the distance keep the pairs few however often a configuration is repeated.
    cells, cell = np.unique(np.floor(2 * points), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(2.5, p=np.inf, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    _, label = connected_components(graph, directed=False)
    return pd.factorize(label[cell.reshape(-1)])[0]


def _split(block: np.ndarray, seed: int) -> np.ndarray:
    """Choose whole blocks for the test, in random order, until a fifth of the rows is in; neither part stays empty."""
    sizes = np.bincount(block)
    test = np.zeros(len(block), dtype=bool)
    if len(sizes) < 2:
        return test
    order = np.random.default_rng(seed).permutation(len(sizes))
    room = max(1, round(TEST_SHARE * len(block)))
    chosen = np.zeros(len(sizes), dtype=bool)
    for k in order:
        if sizes[k] <= room:
            chosen[k] = True
            room -= sizes[k]
    if not chosen.any():
        chosen[np.argmin(sizes)] = True
    return chosen[block]


def _nothing_usable(source: Source) -> MeasurementError:
    refused = source.refusals()
    counts = pd.Series([remark.why for remark in refused]).value_counts()
    reasons = "; ".join(f"{count} x {why}" for why, count in counts.head(3).items())
    sigmas = any(remark.column in map(source.column, STD) for remark in refused)
    hint = ". To do without the std_* columns, write `noise: {rows: ignore}`" if sigmas else ""
    return MeasurementError(f"{source.table.title}: no usable row: {reasons}. First: {refused[0]}{hint}")


def _first_alike(rows: pd.DataFrame) -> np.ndarray:
    """For each row the number of the first that equals it, holes included, shape (N,)."""
    first = np.arange(len(rows))
    alike = np.flatnonzero(rows.duplicated(keep=False))
    if len(alike):
        group = rows.iloc[alike].groupby(list(rows.columns), sort=False, dropna=False).ngroup().to_numpy()
        first[alike] = alike[np.unique(group, return_index=True)[1]][group]
    return first


def _refuse_copies(source: Source, columns: Sequence[np.ndarray | None], station: np.ndarray | None) -> None:
    """Of rows that are the same in every column keep the first."""
    rows = np.flatnonzero(source.usable)
    cells = pd.DataFrame(np.column_stack([c[rows] for c in columns if c is not None]))
    if station is not None:
        cells["station"] = station[rows]
    first = rows[_first_alike(cells)]
    table = source.table
    for row, kept in zip(rows[rows != first].tolist(), first[rows != first].tolist(), strict=True):
        file = "" if table.file[row] == table.file[kept] else f" of {table.files[table.file[kept]].name}"
        source.refused.append(table.remark(row, "", f"identical to line {table.line[kept]}{file}"))
        source.usable[row] = False


def _note_stale_poses(source: Source, q: np.ndarray, kinds: Sequence[Kind], pose: np.ndarray) -> None:
    """Name the rows whose pose repeats an earlier one bit for bit although the joints moved."""
    rows = np.flatnonzero(source.usable)
    first = rows[_first_alike(pd.DataFrame(pose[rows]))]
    moved = (np.abs(q[rows] - q[first]) > _same(kinds)).any(axis=1)
    for row, earlier in zip(rows[moved].tolist(), first[moved].tolist(), strict=True):
        why = f"has the pose of line {source.table.line[earlier]} bit for bit, though the joints moved: not read anew?"
        source.notices.append(source.table.remark(row, "", why))


def _same(kinds: Sequence[Kind]) -> np.ndarray:
    return np.where([kind == "prismatic" for kind in kinds], SAME_LENGTH, SAME_ANGLE)


def _note_limits(source: Source, q: np.ndarray, limits: np.ndarray, kinds: Sequence[Kind]) -> None:
    """Name the readings outside their joint's limits."""
    rows = np.flatnonzero(source.usable)
    for k, (joint, kind) in enumerate(zip(source.joint_names, kinds, strict=True)):
        (low, high), reading = limits[k], q[rows, k]
        beyond = np.maximum(low - reading, reading - high)
        if kind == "continuous" and np.isfinite([low, high]).all():
            turn = 2 * np.pi
            beyond = np.minimum(np.mod(reading - low, turn) - (high - low), np.mod(low - reading, turn))
        why = f"outside the limits {low:.6g} .. {high:.6g} of {joint}"
        for row in rows[beyond > LIMIT_SLACK].tolist():
            source.notices.append(source.table.remark(row, source.joint_columns[k], why))


def _check_units(
    source: Source, q: np.ndarray, limits: np.ndarray, kinds: Sequence[Kind], position: np.ndarray | None
) -> None:
    """Refuse data that cannot be in the stated units, and mention what may not be.

    Raises:
        MeasurementError: most rows are where no robot can be.
    """
    units = source.settings.units
    q = np.nan_to_num(q[source.usable])
    turning = np.array([kind != "prismatic" for kind in kinds], dtype=bool)
    limited = np.isfinite(limits).all(axis=1) & np.array([kind != "continuous" for kind in kinds], dtype=bool)
    outside = limited & ((q < limits[:, 0]) | (q > limits[:, 1]))
    impossible = outside & (np.abs(q) > np.where(turning, TURNS, FAR))
    if impossible.any(axis=1).mean() > 0.5:
        kind = turning[impossible.any(axis=0)].any()  # wrong angles before wrong lengths
        worst = np.flatnonzero(impossible.any(axis=0) & (turning == kind))
        largest = float(np.abs(q[:, worst]).max())
        raise source.wrong_unit([source.joint_columns[k] for k in worst], "angle" if kind else "length", largest)
    turns = np.abs(q[:, turning])
    if turns.size and np.median(turns.max(axis=1)) > TURNS:
        source.note("", "most rows have a joint beyond two turns: are the angles in degrees (`units: {angle: deg}`)?")
    if turns.any() and units.angle == "deg" and turns.max() < np.radians(2 * np.pi):
        source.note("", "no joint turns beyond 6.3 degrees: are the angles in radians (`units: {angle: rad}`)?")
    if position is not None:
        position = position[source.usable]
        if np.median(np.linalg.norm(position, axis=1)) > FAR:
            error = source.wrong_unit([source.column(c) for c in POSITION], "length", float(np.abs(position).max()))
            raise MeasurementError(f"{error}; if they are right, move the origin of the world near the robot")
        span = float(np.linalg.norm(np.ptp(position, axis=0)))
        if units.length != "m" and span < STUCK and np.sum(np.ptp(q[:, turning], axis=0) > 0.5) >= 2:
            raise MeasurementError(
                f"{source.table.title}: with `units: {{length: {units.length}}}` all positions lie within "
                f"{1000 * span:.3g} mm though the joints turn; are they in metres (`units: {{length: m}}`)?"
            )
