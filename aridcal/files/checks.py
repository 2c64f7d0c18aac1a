"""Checks of a table: are the data in the stated units, inside the limits, renewed at each row?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from aridcal.engine.rows.repeats import first_alike, tolerances
from aridcal.files.instrument_settings import ArmCameraSettings
from aridcal.files.measurement_settings import BEYOND_REACH
from aridcal.files.quantities import POSITION_COLUMNS, STD, TWO_TURNS, TableSource
from aridcal.files.yaml_file import FINEST
from aridcal.system.errors import MeasurementError

# A limit may be printed with few digits, [rad] or [m].
LIMIT_SLACK = 1e-5

# A wire, ballbar or gauge of an arm is shorter than this, [m].
LONGEST_DISTANCE = 50.0

# From the middle of the first pixel, which is 0, to the edge of the image, [px].
HALF_PIXEL = 0.5

# A target that stays within this while joints turn is in the wrong unit, [m].
LEAST_SPAN = 0.02

# A joint that covers this turns, [rad]; two that do move a target by more than any tool is short.
LEAST_TURN = 0.5

# Once round, [rad].
LARGEST_TURN_RAD = 2 * np.pi

# Share of the rows that must be impossible before all are refused: fewer are bad rows, not a wrong unit.
IMPOSSIBLE_SHARE = 0.5


def nothing_usable(source: TableSource) -> MeasurementError:
    """The error for a table of which every row is refused: the commonest reasons, and the first."""
    refused = source.refusals()
    counts = Counter(remark.why for remark in refused)
    reasons = "; ".join(f"{count} x {why}" for why, count in counts.most_common(3))
    of_sigma = {source.column(name) for name in STD}
    sigmas = any(remark.column in of_sigma for remark in refused)
    hint = "; to do without the std_* columns, write `noise: {rows: ignore}`" if sigmas else ""
    return MeasurementError(
        f"{source.table.title}: no usable row: {reasons}. First: {refused[0]}. Mend these cells{hint}"
    )


def refuse_copies(
    source: TableSource, columns: Sequence[np.ndarray | None], labels: Sequence[np.ndarray | None], sequence: np.ndarray
) -> None:
    """Keep the first of rows that are equal in every compared column: no instrument measures the same bits twice.

    Args:
        source: The table; only its usable rows are looked at.
        columns: Numbers to compare, shape (N,) or (N, numbers) each.
        labels: Words to compare, shape (N,) each.
        sequence: Numbers of the rows as they were measured, shape (N,).
    """
    rows = sequence[source.usable[sequence]]
    compared = (cells for cells in (*columns, *labels) if cells is not None)
    first = rows[first_alike(column[rows] for cells in compared for column in np.atleast_2d(cells.T))]
    copies = rows != first
    for row, original in zip(rows[copies].tolist(), first[copies].tolist(), strict=True):
        source.refused.append(source.table.remark(row, "", f"identical to {_line(source, original, row)}"))
        source.usable[row] = False


def _line(source: TableSource, row: int, remarked: int) -> str:
    """The line of a row, for a remark on another row: with its file, if that is another one."""
    table = source.table
    file = "" if table.file[remarked] == table.file[row] else f" of {table.files[table.file[row]].name}"
    return f"line {table.line[row]}{file}"


def stale_rows(
    source: TableSource, q: np.ndarray, measured: np.ndarray, sequence: np.ndarray, noted: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Rows that share a measurement bit for bit although the joints moved between them: one of them was not measured.

    Args:
        source: The table; only its usable rows are looked at.
        q: Readings, shape (N, columns), [rad] or [m].
        measured: Measured numbers, shape (N, numbers).
        sequence: Numbers of the rows as they were measured, shape (N,).
        noted: True if these rows are named among the notices.

    Returns:
        Rows that repeat an earlier one in this way, and these together with that earlier one; shape (N,) bool each.
    """
    rows = sequence[source.usable[sequence]]
    first = rows[first_alike(column[rows] for column in measured.T)]
    moved = (np.abs(q[rows] - q[first]) > tolerances(source.kinds)).any(axis=1)
    stale, shared = np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
    stale[rows], shared[rows] = moved, np.isin(first, first[moved])
    for row, earlier in sorted(zip(rows[moved].tolist(), first[moved].tolist(), strict=True)) if noted else ():
        line = _line(source, earlier, row)
        why = f"repeats the pose of {line} exactly although the joints moved: a stale measurement?"
        source.notices.append(source.table.remark(row, "", why))
    return stale, shared


def note_limits(source: TableSource, q: np.ndarray) -> None:
    """Name the readings outside their joint's limits; they are of shape (N, columns), [rad] or [m]."""
    rows = np.flatnonzero(source.usable)
    for k, (joint, kind) in enumerate(zip(source.joint_names, source.kinds, strict=True)):
        (low, high), reading = source.limits[k], q[rows, k]
        above, below = reading - high, low - reading
        beyond = np.maximum(below, above)
        if kind == "continuous" and np.isfinite([low, high]).all():
            past_low = np.mod(-below, LARGEST_TURN_RAD)
            beyond = np.minimum(past_low - (high - low), np.mod(below, LARGEST_TURN_RAD))
        why = f"outside the limits {low:.6g} .. {high:.6g} of {joint}"
        for row in rows[beyond > LIMIT_SLACK].tolist():
            source.notices.append(source.table.remark(row, source.joint_columns[k], why))


def check_units(source: TableSource, q: np.ndarray, position: np.ndarray | None) -> None:
    """Refuse data that cannot be in the stated units, and mention what may not be.

    Args:
        source: The table; only its usable rows are looked at.
        q: Readings, shape (N, columns), [rad] or [m].
        position: Of the target, shape (N, 3), [m], if it was measured.

    Raises:
        MeasurementError: most rows are where no robot can be.
    """
    q = np.nan_to_num(q[source.usable])
    turning = np.array([kind != "prismatic" for kind in source.kinds], dtype=bool)
    endless = np.array([kind == "continuous" for kind in source.kinds], dtype=bool)
    _refuse_impossible(source, q, np.where(endless[:, None], [-np.inf, np.inf], source.limits), turning)
    _note_odd_angles(source, np.abs(q[:, turning]))
    if position is not None:
        _check_positions(source, position[source.usable], np.ptp(q[:, turning], axis=0))


def _refuse_impossible(source: TableSource, q: np.ndarray, limits: np.ndarray, turning: np.ndarray) -> None:
    """Refuse readings of which most are outside their limits and further than any joint moves."""
    limited = np.isfinite(limits).all(axis=1)
    outside = limited & ((q < limits[:, 0]) | (q > limits[:, 1]))
    impossible = outside & (np.abs(q) > np.where(turning, TWO_TURNS, BEYOND_REACH))
    if impossible.any(axis=1).mean() <= IMPOSSIBLE_SHARE:
        return
    bad = impossible.any(axis=0)
    angles = bool(turning[bad].any())  # wrong angles before wrong lengths
    worst = np.flatnonzero(bad & (turning == angles))
    largest = float(np.abs(q[:, worst]).max())
    raise source.wrong_unit([source.joint_columns[k] for k in worst], "angle" if angles else "length", largest)


def _note_odd_angles(source: TableSource, turns: np.ndarray) -> None:
    """Mention angles that may be in the other unit, from absolute readings of shape (N, turning joints), [rad]."""
    if turns.size and np.median(turns.max(axis=1)) > TWO_TURNS:
        source.note("", "most rows have a joint beyond two turns: are the angles in degrees (`units: {angle: deg}`)?")
    if turns.any() and source.settings.units.angle == "deg" and turns.max() < np.radians(LARGEST_TURN_RAD):
        source.note("", "no joint turns beyond 6.3 degrees: are the angles in radians (`units: {angle: rad}`)?")


def _check_positions(source: TableSource, position: np.ndarray, travel: np.ndarray) -> None:
    """Refuse positions (N, 3), [m], that no arm reaches, or that stay in place though joints turn by ``travel`` [rad]."""
    units = source.settings.units
    if np.median(np.linalg.norm(position, axis=1)) > BEYOND_REACH:
        columns = [source.column(name) for name in POSITION_COLUMNS]
        error = source.wrong_unit(columns, "length", float(np.abs(position).max()))
        raise MeasurementError(f"{error}; if they are right, move the origin of the world near the robot")
    span = float(np.linalg.norm(np.ptp(position, axis=0)))
    if units.length != "m" and span < LEAST_SPAN and np.sum(travel > LEAST_TURN) >= 2:
        raise MeasurementError(
            f"{source.table.title}: with `units: {{length: {units.length}}}` all positions lie within "
            f"{1000 * span:.3g} mm though the joints turn; are they in metres (`units: {{length: m}}`)?"
        )


def refuse_impossible_readings(
    source: TableSource, observed: np.ndarray, cameras: Mapping[str, ArmCameraSettings], camera: np.ndarray | None
) -> None:
    """Refuse rows with numbers that no such instrument can have read.

    Args:
        source: The table.
        observed: Readings of the instrument, shape (N, W), as the kind of the table has them.
        cameras: Cameras of the campaign, by label.
        camera: Label of each row's camera, shape (N,); None for other kinds than pixels.
    """
    kind = source.settings.traits
    if kind.ranges:
        source.refuse(observed[:, 0] <= 0, source.column("distance"), "a distance must be positive")
    elif kind.level:
        nothing = np.abs(observed).max(axis=1) < FINEST
        source.refuse(nothing, " ".join(map(source.column, ("gx", "gy", "gz"))), "gravity of length 0 has no direction")
    elif kind.images and camera is not None:
        for name, settings in cameras.items():
            size = np.array([settings.width, settings.height])
            outside = (observed < -HALF_PIXEL) | (observed > size - HALF_PIXEL)
            for k, axis in enumerate(("u", "v")):
                why = f"outside the image of {settings.width} x {settings.height} pixels of the camera {name}"
                source.refuse(outside[:, k] & (camera == name), source.column(axis), why)


def check_distances(source: TableSource, observed: np.ndarray) -> None:
    """Refuse distances that cannot be in the stated unit.

    Args:
        source: The table; only its usable rows are looked at.
        observed: Readings of the instrument, shape (N, W).

    Raises:
        MeasurementError: no wire, ballbar or gauge of an arm is that long.
    """
    settings = source.settings
    if (settings.traits.ranges or settings.traits.gauges) and observed.shape[1]:
        distances = np.abs(observed[source.usable, 0])
        if np.median(distances) > LONGEST_DISTANCE:
            raise source.wrong_unit([source.column(settings.traits.read[0])], "length", float(distances.max()))
