"""Poses of the real target by the whole calibrated model, written as the campaign's own tables are."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.labels import LABEL_COLUMN, label_in
from aridcal.engine.corrections.regional_kind import far_from_nodes, labels_of, without_label
from aridcal.engine.inverse.one_pose import InverseKinematics
from aridcal.engine.model.model import Model
from aridcal.engine.rows.remarks import Remark
from aridcal.engine.trust.coverage import CLOCK_COLUMN, EXPANSION, Coverage, beyond_heat, recorded_elsewhere
from aridcal.engine.trust.rival_predictions import covariance_between
from aridcal.engine.trust.unobservable import observable_rows
from aridcal.engine.trust.workspace import spread_out, target_covariance, worst_direction
from aridcal.files.counting import counting
from aridcal.files.measurement_settings import TARGET, MeasurementSettings
from aridcal.files.orientations import QUATERNION, column_of, orientation_columns, swap_direction
from aridcal.files.quantities import POSITION_COLUMNS, STD
from aridcal.files.query import Query, QueryRows, load_query
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import MeasurementError
from aridcal.system.reading.dates import times_of_day

if TYPE_CHECKING:
    import pandas as pd

    from aridcal.files.tables import AnyTable, Table
    from aridcal.jobs.apply.stretches import TableStretch


def read_query(saved: SavedModel, table: AnyTable, poses: bool = False) -> Query:
    """Read joint readings, or wanted poses, in the columns and units of the calibration's own campaign.

    Args:
        saved: The model.
        table: The rows.
        poses: Wanted poses; the joints, if there are any, are where to start.

    Raises:
        MeasurementError: the table cannot be read, lacks columns, or has no usable row.
    """
    query = _query(saved, table, poses)
    if not query.usable.any():
        raise nothing_usable(query.refused, poses)
    return query


def nothing_usable(refused: Sequence[Remark], poses: bool) -> MeasurementError:
    """The error for a table without a usable row."""
    return MeasurementError(
        f"no row can be {'commanded' if poses else 'predicted'}. First: {refused[0]}; mend the table"
    )


def read_queries(saved: SavedModel, table: AnyTable, poses: bool = False) -> Iterator[tuple[Query, TableStretch]]:
    """Read a query a stretch at a time: a table of any length takes little memory, and a long one is checked by stretches.

    Args:
        saved: The model.
        table: The rows.
        poses: As for :func:`read_query`.

    Yields:
        The rows of a stretch, and the stretch.

    Raises:
        MeasurementError: as :func:`read_query`.
    """
    from aridcal.jobs.apply.stretches import stretches  # slow to load: only where there are tables

    first: list[Remark] = []
    usable = False
    settings = saved.measurements
    names = POSITION_COLUMNS if poses else saved.final.model.robot.readings
    needed = [settings.columns.get(name, name) for name in names]
    for stretch in stretches(table, saved.limits.table, settings.table.dialect, needed):
        query = _query(saved, stretch.table, poses)
        usable |= bool(query.usable.any())
        first = first or list(query.refused[:1])
        if stretch.last and not usable:
            raise nothing_usable(first, poses)
        yield query, stretch
    if not usable:  # nothing but blank lines after the last row
        raise nothing_usable(first, poses)


def _query(saved: SavedModel, table: AnyTable | Table, poses: bool) -> Query:
    from aridcal.files.tables import Table, path_of  # as above

    robot = saved.final.model.robot
    query = load_query(
        table,
        robot.readings,
        robot.limits,
        robot.kinds,
        saved.measurements,
        poses=poses,
        per_station=per_station(saved.final.model),
        label=saved.frames_by,
        needs=needed_of(saved) - set(directions(saved) if poses else ()),
        of_labels=labels_of(c.basis for c in saved.final.model.coefficients),
        stated=robot.stated.names,
        limit=saved.limits.table,
    )
    query = _as_nights_count(saved, query)
    if poses:
        return query
    if isinstance(table, Table):
        return _sides_unknown(saved, query, table.files[0].name)
    return _sides_unknown(saved, query, path_of(table).name)


def _as_nights_count(saved: SavedModel, query: Query) -> Query:
    """A query whose times of day count on after midnight where those of the calibration do."""
    ranges = saved.seen
    if CLOCK_COLUMN not in query.covariates or CLOCK_COLUMN not in ranges:
        return query
    return replace(
        query,
        covariates=query.covariates
        | {CLOCK_COLUMN: times_of_day(query.covariates[CLOCK_COLUMN], *ranges[CLOCK_COLUMN])},
    )


def _sides_unknown(saved: SavedModel, query: Query, file: str) -> Query:
    """A query with 0, the middle, for each side of approach that the calibration derived from the order of its rows.

    Rows of a query need not be in the order in which a robot takes them, so that their order says nothing.
    """
    absent = [name for name in saved.record.get("derived_columns", ()) if name not in query.covariates]
    why = "is not given: the middle between the two sides of approach is predicted"
    notices = tuple(Remark(file, None, name, "", why) for name in absent)
    zeros = dict.fromkeys(absent, np.zeros(len(query.line)))
    return replace(query, covariates=query.covariates | zeros, notices=query.notices + notices)


def at_any_station(saved: SavedModel) -> InverseKinematics:
    """Inverse kinematics at the first station; all need the same covariates."""
    return saved.inverse_kinematics(*saved.final.model.first_labels)


def needed_of(saved: SavedModel) -> set[str]:
    """Columns that rows must have beside the joints; columns that only rivals depend on may be missing."""
    return set(at_any_station(saved).model.needs) - saved.assumed.keys()


def directions(saved: SavedModel) -> tuple[str, ...]:
    """Approach directions that the effects depend on, ``joint_2_direction`` for instance."""
    names = {f"{name}_direction" for name in saved.final.model.robot.names}
    return tuple(name for name in at_any_station(saved).model.needs if name in names)


def per_station(model: Model) -> bool:
    """True where there is a frame for each station or target, so that rows must name theirs."""
    return len(model.world_base) > 1 or len(model.tip_target) > 1


def predict(saved: SavedModel, query: Query) -> pd.DataFrame:
    """Fill in the target's pose for each row of a query.

    Args:
        saved: The model.
        query: N rows, read with the calibration's own `measurements` settings.

    Returns:
        The query's table with the pose, its standard deviations and `extrapolates`, N rows; a pose that cannot be told is left
        empty. Columns, units and the writing of orientations are the campaign's; columns of another orientation are left out.

    Raises:
        CovariateNotFound: an effect depends on a column that is not there.
        MeasurementError: a row's station is none of those that were calibrated.
    """
    usable = query.usable
    covariates = {name: values[usable] for name, values in query.covariates.items()}
    labels = query.labels(usable)
    R, p = saved.expected.poses(query.readings[usable], saved.completed(covariates, int(usable.sum())), *labels)
    R[np.isnan(p).any(axis=1)] = np.nan

    std = std_of(saved, query)
    total_std = np.hypot(std, np.sqrt(np.maximum(np.einsum("nii->ni", between_rivals(saved, query)), 0.0)))

    settings, joints = saved.measurements, saved.final.model.robot.readings
    filled = pose_columns(R, p, settings, joints) | std_columns(total_std[usable], settings, joints)
    stale = _pose_names(settings, joints) - set(filled)
    table = query.table.drop(columns=list(stale), errors="ignore")
    for name, values in filled.items():
        column = np.full(len(table), np.nan)
        column[usable] = values
        table[name] = column
    table["extrapolates"] = extrapolates(saved, query, std)
    return with_told(saved, query, table)


def with_told(saved: SavedModel, query: Query, table: pd.DataFrame) -> pd.DataFrame:
    """A query's table with a column ``told``, where the calibration has combinations of constants that no reading tells.

    False in rows where these may move the target by more than 10 mm, or turn it by more than 10 mrad.
    """
    if saved.untold:
        final, usable = saved.final, query.usable & np.isfinite(query.readings).all(axis=1)
        covariates = {name: values[usable] for name, values in query.covariates.items()}
        rows = final.model.rows(query.readings[usable], covariates, *query.labels(usable))
        determined = np.zeros(len(usable), dtype=bool)
        determined[usable] = observable_rows(final.model, final.theta, saved.untold, rows, saved.turns)
        table["told"] = determined
    return table


def pose_columns(
    R: np.ndarray, p: np.ndarray, settings: MeasurementSettings, joints: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """Write poses as a campaign's tables have them.

    Args:
        R: Rotations, shape (N, 3, 3), NaN where unknown.
        p: Positions, shape (N, 3), [m].
        settings: Columns, units and orientation, and whether the tables have poses the other way round.
        joints: Names of the joints; where one is called like a quantity, `columns` speaks of the joint.

    Returns:
        Values of each column, shape (N,) each, in the campaign's units; positions alone for `kind: position`.
    """
    units = settings.units
    R, p = swap_direction(R, p, settings.inverted)
    names = [column_of(name, settings, joints) for name in POSITION_COLUMNS]
    columns = dict(zip(names, (p / [units.scale(name, "length") for name in names]).T, strict=True))
    if settings.traits.place_alone:
        return columns
    numbers = orientations(R, settings)
    return columns | dict(zip(orientation_columns(settings, joints), numbers.T, strict=True))


def std_columns(std: np.ndarray, settings: MeasurementSettings, joints: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Write standard deviations as a campaign's tables have them.

    Args:
        std: Of the position [m] and of the rotation vector [rad], world axes, shape (N, 6), NaN where unknown.
        settings: Columns and units.
        joints: As for :func:`pose_columns`.

    Returns:
        Values of each column, shape (N,) each, in the campaign's units; those of positions alone for `kind: position`.
    """
    units, names = settings.units, _std_names(settings, joints)
    scaled = std / [units.scale(name, "length" if k < 3 else "angle") for k, name in enumerate(names)]
    count = 3 if settings.traits.place_alone else 6
    return dict(zip(names[:count], scaled.T, strict=False))


def _std_names(settings: MeasurementSettings, joints: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(column_of(name, settings, joints) for name in STD)


def _pose_names(settings: MeasurementSettings, joints: tuple[str, ...]) -> set[str]:
    """Columns of an orientation or of standard deviations: they belong to another pose, unless they are written anew."""
    plain = {*QUATERNION, *STD} - {*joints, *settings.columns.values()}
    mapped = {*(column_of(name, settings, joints) for name in QUATERNION), *_std_names(settings, joints)}
    return plain | mapped | set(orientation_columns(settings, joints))


def orientations(R: np.ndarray, settings: MeasurementSettings) -> np.ndarray:
    """Write rotations in the campaign's way and unit; NaN where R is.

    Args:
        R: Shape (N, 3, 3).
        settings: The way and the units.

    Returns:
        Euler angles or rotation vectors, shape (N, 3), matrices row by row, shape (N, 9), or unit quaternions qx qy qz qw
        with qw >= 0, shape (N, 4).
        Where Euler angles are not unique, the last one is 0.
    """
    spec = settings.orientation
    radians = [settings.units.scale(name, "angle") for name in spec.angles or ()]
    finite = ~np.isnan(R).any(axis=(1, 2))
    rotation = Rotation.from_matrix(R[finite], assume_valid=True)
    if spec.euler:
        with warnings.catch_warnings():  # scipy's remark on angles that are not unique
            warnings.simplefilter("ignore", UserWarning)
            numbers = rotation.as_euler(spec.euler) / radians  # type: ignore[call-overload]
    elif spec.rotvec:
        numbers = rotation.as_rotvec() / radians
    elif spec.matrix:
        numbers = rotation.as_matrix().reshape(-1, 9)
    else:
        numbers = rotation.as_quat(canonical=True)
    columns = np.full((len(R), numbers.shape[1]), np.nan)
    columns[finite] = numbers
    return columns


def std_of(saved: SavedModel, query: QueryRows) -> np.ndarray:
    """Standard deviations of the target's pose, shape (N, 6); NaN where unknown.

    They are those of :meth:`SolvedModel.std` together with the growth by heat outside the measured temperatures
    (:func:`growth`).

    Args:
        saved: The model.
        query: N rows; rows that lack a needed number have none.
    """
    usable = query.usable & np.isfinite(query.readings).all(axis=1)
    covariates = {name: values[usable] for name, values in query.covariates.items()}
    std = np.full((len(usable), 6), np.nan)
    std[usable] = saved.final.std(query.readings[usable], covariates, *query.labels(usable))
    std[:, :3] = np.hypot(std[:, :3], growth(saved, query)[:, None])
    return std


def between_rivals(saved: SavedModel, query: QueryRows, tool: np.ndarray | None = None) -> np.ndarray:
    """Covariance of the target's pose between the causes that the rows could not tell apart, shape (N, 6, 6); NaN where unknown.

    See :func:`aridcal.engine.trust.rival_predictions.covariance_between`. No row extrapolates because of it: where rivals
    differ, rows may well be like the fitted ones.

    Args:
        saved: The model.
        query: N rows.
        tool: A point that moves with the target, in its axes, shape (3,), [m].
    """
    if not saved.rivals:
        return np.zeros((len(query.line), 6, 6))
    usable = query.usable & np.isfinite(query.readings).all(axis=1)
    covariates = {name: values[usable] for name, values in query.covariates.items()}
    final, ranges = saved.final, saved.seen
    covariance, labels = np.full((len(usable), 6, 6), np.nan), query.labels(usable)
    covariance[usable] = covariance_between(
        final.model, final.theta, saved.rivals, query.readings[usable], covariates, labels, ranges, tool
    )
    return covariance


def growth(saved: SavedModel, query: QueryRows) -> np.ndarray:
    """1-sigma per axis of the arm's growth by heat outside the measured temperatures, shape (N,), [m].

    It goes with the arm's length, along an unknown direction: each axis has a third of the square.
    """
    if not query.covariates:
        return np.zeros(len(query.line))
    return EXPANSION * saved.span / np.sqrt(3.0) * beyond_heat(query.covariates, saved.seen)


def extrapolates(saved: SavedModel, query: QueryRows, std: np.ndarray) -> np.ndarray:
    """Rows that are unlike the fitted ones, shape (N,) bool.

    See :meth:`aridcal.engine.trust.coverage.Coverage.beyond` and :func:`aridcal.engine.trust.coverage.recorded_elsewhere`.
    Further rows are those far from all nodes of a field in space, and those with another label than the effects by label have.

    Args:
        saved: The model.
        query: N rows.
        std: See :func:`std_of`.
    """
    readings = dict(zip(saved.final.model.robot.readings, query.readings.T, strict=True))
    coverage = Coverage(saved.ranges, saved.holes, saved.largest_std)
    unlike = coverage.beyond(query.covariates | readings, std)
    unlike |= recorded_elsewhere(query.covariates | readings, saved.recorded)
    unlike |= not readings.keys() <= saved.ranges.keys()  # joints on the way to a link that were not calibrated
    unlike |= without_label((c.basis for c in saved.final.model.coefficients), query.covariates, len(unlike))
    usable = query.usable & np.isfinite(query.readings).all(axis=1)
    unlike[usable] |= _far(saved, query, usable)
    return unlike


def evenly(saved: SavedModel) -> pd.DataFrame:
    """Configurations evenly over the measured ranges of the joints, as a table in the campaign's own columns and units.

    Covariates are in the middle of their ranges, and the station is the first one.
    """
    model, settings = saved.final.model, saved.measurements
    robot = model.robot
    low, high = np.array([saved.ranges[name] for name in robot.readings]).T
    names = [settings.columns.get(name, name) for name in robot.readings]
    cells = counting(settings, robot.readings, robot.kinds).cells(spread_out(low, high))
    import pandas as pd  # slow to load: only where somebody wants a DataFrame

    table = pd.DataFrame(dict(zip(names, cells.T, strict=True)))
    for name in model.needs:
        table[settings.columns.get(name, name)] = settings.sense(name) * float(np.mean(saved.ranges[name]))
    if per_station(model):
        named = zip(
            (TARGET,) if saved.frames_by == TARGET else (LABEL_COLUMN, TARGET), model.first_labels, strict=False
        )
        for name, label in named:
            if label is not None:
                table[column_of(name, settings, robot.readings)] = label
    of_labels = labels_of(c.basis for c in model.coefficients)
    if of_labels and column_of(LABEL_COLUMN, settings, robot.readings) not in table:
        table[column_of(LABEL_COLUMN, settings, robot.readings)] = label_in(of_labels[0])
    return table


def uncertainty(saved: SavedModel, query: Query, tool: Sequence[float]) -> pd.DataFrame:
    """How well a point on the target is known in each row of a query.

    Args:
        saved: The model.
        query: N rows.
        tool: The point, in the target's axes, [m].

    Returns:
        The query's table with ``sigma_mm``, 1-sigma of the place in its worst direction, that direction in world axes
        ``worst_x`` to ``worst_z``, ``rms_mm`` of all three axes together, ``rotation_mrad`` about the worst axis (of poses), and
        ``extrapolates``; NaN where a row cannot be predicted.

    Raises:
        AridcalError: a column is missing, or the point turns with a target whose rotation was never measured.
    """
    if any(tool) and not saved.turns:
        raise MeasurementError(
            "`tool`: only the target's position was measured, and nothing is known of a point beside it: measure poses, or put "
            "the target where the tool works"
        )
    usable = query.usable
    covariates = {name: values[usable] for name, values in query.covariates.items()}
    final = saved.final
    rows = final.model.rows(query.readings[usable], covariates, *query.labels(usable))
    covariance = target_covariance(final.model, final.theta, final.covariance, rows, np.asarray(tool, dtype=float))
    covariance[:, :3, :3] += growth(saved, query)[usable, None, None] ** 2 * np.eye(3)
    covariance += between_rivals(saved, query, np.asarray(tool, dtype=float))[usable]
    sigma, direction = worst_direction(covariance[:, :3, :3])
    columns = {
        "sigma_mm": 1e3 * sigma,
        **dict(zip(("worst_x", "worst_y", "worst_z"), direction.T, strict=True)),
        "rms_mm": 1e3 * np.sqrt(np.maximum(np.einsum("nii->n", covariance[:, :3, :3]), 0.0)),
    }
    if saved.turns:
        columns["rotation_mrad"] = 1e3 * worst_direction(covariance[:, 3:, 3:])[0]
    table = query.table.copy()
    for name, values in columns.items():
        table[name] = np.full(len(table), np.nan)
        table.loc[usable, name] = values
    table["extrapolates"] = extrapolates(saved, query, std_of(saved, query))
    return with_told(saved, query, table)


def _far(saved: SavedModel, query: QueryRows, usable: np.ndarray) -> np.ndarray:
    """True for usable rows whose target is far from all nodes of a field in space, shape (usable rows,)."""
    model, readings = saved.final.model, query.readings[usable]
    bases = [c.basis for c in model.coefficients if c.basis.form == "ball"]
    if not bases:
        return np.zeros(len(readings), dtype=bool)
    covariates = {name: values[usable] for name, values in query.covariates.items()}
    rows = model.rows(readings, covariates, *query.labels(usable))
    return far_from_nodes(bases, model.target_places(rows, readings))
