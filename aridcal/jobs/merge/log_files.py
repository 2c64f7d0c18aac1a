"""Logs from tables: which columns are the clock, the joints and the tracked place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.files.measurement_settings import ANGLES, LENGTHS, TIMES
from aridcal.files.quantities import TWO_TURNS
from aridcal.files.tables import AnyTable, Table, path_of, read_tables
from aridcal.jobs.merge.log import Log, in_order
from aridcal.jobs.merge.other_columns import OtherColumns, other_columns
from aridcal.jobs.prepare.column_names import match_joints, named_column, positions, unit
from aridcal.jobs.prepare.condition_columns import COVARIATES, EPOCH
from aridcal.jobs.prepare.guesses import Chooser
from aridcal.jobs.prepare.orientation_columns import sensible
from aridcal.jobs.prepare.table_formats import dialects_of
from aridcal.system.errors import MeasurementError, name_list

LOG_RATES = (0.5, 2000.0)
"""Lowest and highest rate of a log, samples a second: slower ones miss whole moves, faster ones no instrument writes."""

EPOCH_BEGINS = 1e8
"""Seconds since 1970 are more, a time since a program began is less: three years."""


@dataclass(frozen=True)
class TrackerLog:
    """What a tracker measured over time.

    Attributes:
        log: As it is written.
        places: Columns that may be the measured place, the likeliest first.
        others: Its further columns; None: it has none.
    """

    log: Log
    places: tuple[tuple[str, ...], ...]
    others: OtherColumns | None = None


@dataclass(frozen=True)
class JointLog:
    """Readings of the joints over time.

    Attributes:
        log: Its columns are the robot's readings, in their order.
        units: Combinations of units in which the readings may be, each with one unit for each column.
        others: Its further columns; None: it has none.
    """

    log: Log
    units: tuple[tuple[str, ...], ...]
    others: OtherColumns | None = None

    def readings(self, units: tuple[str, ...]) -> np.ndarray:
        """Readings in SI, shape (N, columns)."""
        return np.asarray(self.log.values * [{**ANGLES, **LENGTHS}[word] for word in units])


def read_table(source: AnyTable, asker: Chooser, which: str) -> tuple[Table, str | None]:
    """A log's table, and the column that its dates became, if it has any.

    Raises:
        AridcalError: it is no table, or may be read in two ways.
    """
    dialects, _ = dialects_of([source], asker)
    words = [f"decimal {'point' if one.decimal == '.' else 'comma'}, thousands {one.thousands!r}" for one in dialects]
    k = (
        asker.pick(f"{which}.decimal", f"{path_of(source)}: how are numbers written", words, "more than one may be")
        if len(dialects) > 1
        else 0
    )
    table = read_tables([source], None, dialect=dialects[k])
    dates = dialects[k].dates
    return table, dates.name if dates is not None else None


def joint_log(source: AnyTable, robot: Robot, asker: Chooser) -> JointLog:
    """The joints' log of a table.

    Raises:
        AridcalError: a joint or the clock has no column, or the clock was set back.
    """
    table, dates = read_table(source, asker, "joints")
    clock, seconds = _clock(table, dates, asker, "joints")
    names = [name for name in table.names if name and name != clock]
    match = match_joints(robot.readings, names)
    if match is None:
        lacking = [joint for joint in robot.readings if joint not in names]
        raise MeasurementError(
            f"{table.title}: no columns for the joints {', '.join(lacking)}. Its columns are {name_list(names)}. Name the "
            f"joints' "
            "columns as in the URDF, or number them q1, q2, … along the chain"
        )
    columns = [match[0][joint] for joint in robot.readings]
    values = sensible(table, columns)
    log = _complete(Log(table.title, seconds, robot.readings, values), table)
    notes = (
        (f"{table.title}: joints by their ORDER along the chain: {', '.join(columns)}",) if match[1] == "order" else ()
    )
    others = other_columns(table, seconds, {*columns, clock}, len(columns))
    return JointLog(
        Log(log.title, log.time, log.columns, log.values, (*notes, *log.notes)), _units(log, columns, robot), others
    )


def tracker_log(source: AnyTable, robot: Robot, asker: Chooser) -> TrackerLog:
    """The tracker's log of a table.

    Raises:
        AridcalError: there are none, or no clock, or it was set back.
    """
    table, dates = read_table(source, asker, "tracker")
    clock, seconds = _clock(table, dates, asker, "tracker")
    names = tuple(name for name in table.names if name and name != clock and name not in robot.readings)
    places = [family.columns for family in positions(names) if np.isfinite(sensible(table, family.columns)).any()]
    if not places:
        raise MeasurementError(
            f"{table.title}: no columns for the target's position; call them x, y and z. Its columns are {name_list(names)}"
        )
    columns = tuple(name for name in names if np.isfinite(table.numbers(name)[0]).any())
    log = Log(table.title, seconds, columns, sensible(table, columns))
    others = other_columns(table, seconds, {*robot.readings, clock}, len(robot.readings))
    return TrackerLog(_complete(log, table, places[0]), tuple(places), others)


def _complete(log: Log, table: Table, required: tuple[str, ...] | None = None) -> Log:
    """The samples that have a time and all required columns, in order."""
    holes = ~np.isfinite(log.of(required or log.columns)).all(axis=1)
    timeless = ~np.isfinite(log.time)
    complete = ~(holes | timeless)
    log = log.keep(complete, "without a time or a number: left out")
    return in_order(log, table.line[complete])


def _units(log: Log, columns: list[str], robot: Robot) -> tuple[tuple[str, ...], ...]:
    """Units in which the readings may be: as the header says, else all that the sizes allow."""
    turning = np.array([kind != "prismatic" for kind in robot.kinds])
    units = [unit(column) for column in columns]
    if all(word in (ANGLES if turns else LENGTHS) for word, turns in zip(units, turning, strict=True)):
        return (tuple(str(word) for word in units),)
    angles = ("rad", "deg")
    if turning.any() and float(np.abs(log.values[:, turning]).max()) > TWO_TURNS:
        angles = ("deg",)  # type: ignore[assignment]
    lengths = ("m",) if turning.all() else ("m", "mm")
    return tuple(
        tuple(angle if turns else length for turns in turning.tolist())
        for angle in (angles if turning.any() else ("rad",))
        for length in lengths
    )


def _clock(table: Table, dates: str | None, asker: Chooser, which: str) -> tuple[str, np.ndarray]:
    """The clock's column, and its times, shape (N,), [s].

    Raises:
        AridcalError: there is none, or its unit cannot be told.
    """
    if dates is not None and dates in table.cells:
        return dates, table.numbers(dates)[0]
    spellings = next(words for quantity, _, words in COVARIATES if quantity == "time")
    column = named_column(table.names, *spellings)
    if column is None:
        raise MeasurementError(
            f"{table.title}: no column for the time of each sample; call it `time`. Its columns are {name_list(table.names)}"
        )
    values = table.numbers(column)[0]
    by_name = unit(column)
    if by_name in TIMES:
        return column, values * TIMES[str(by_name)]
    steps = np.diff(values[np.isfinite(values)])
    rising = steps[steps > 0]
    if not len(rising):
        raise MeasurementError(
            f"{table.title}: the numbers of column {column!r} do not rise; it should hold the time of each sample "
            "(of a DataFrame in "
            "numbers, not as dates)"
        )
    period, largest = float(np.median(rising)), float(np.nanmax(np.abs(values)))
    possible = [
        word for word in ("s", "ms", "us", "ns") if LOG_RATES[0] <= 1.0 / (period * TIMES[word]) <= LOG_RATES[1]
    ]
    epoch = next((word for word, most in EPOCH.items() if largest < most), "ns")
    if largest * TIMES[epoch] > EPOCH_BEGINS and epoch in possible:
        possible = [epoch]
    if not possible:
        raise MeasurementError(
            f"{table.title}: column {column!r} rises by {period:.3g} from sample to sample: in no unit a log of "
            f"{LOG_RATES[0]:g} to {LOG_RATES[1]:g} samples a second. Give each sample its own time, and its unit in the "
            "header: `time_ms`"
        )
    k = 0
    if len(possible) > 1:
        answers = [f"{word} ({1.0 / (period * TIMES[word]):.3g} samples a second)" for word in possible]
        k = asker.pick(f"{which}.time", f"{table.title}: in which unit is {column}", answers, "its name does not say")
    return column, values * TIMES[possible[k]]
