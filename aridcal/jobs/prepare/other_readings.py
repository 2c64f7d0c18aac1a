"""Tables that were not read as they were written: which other reading would fit the robot, before effects are sought.

A wrong order of quaternions, a joint with the other sign or a rail in the other unit leave errors that no effect
explains, and a search for effects takes a minute to find that out. Where frames and constants leave more than a robot
usually does, every other reading that a slip could hide is tried on some rows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from aridcal.engine.fit.constants import station_labels
from aridcal.engine.fit.flags import robust_sigma
from aridcal.engine.fit.problem import unscaled
from aridcal.engine.fit.stages import Geometry, fit_geometry, nominal_sigma
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign
from aridcal.files.measurement_settings import ANGLES, JointColumn, MeasurementSettings
from aridcal.files.orientations import QUATERNION, column_of
from aridcal.files.quantities import POSITION_COLUMNS, STD
from aridcal.files.read import load_measurements
from aridcal.files.tables import Table, read_tables
from aridcal.jobs.prepare.units_and_angles import TRIED_LENGTHS, rounded
from aridcal.system.errors import AridcalError, NotOfThisRobot

# Rows on which readings are tried, and that judge a proposal; more make no clearer verdict.
SAMPLE_ROWS = 150
# What frames and constants, or frames alone, leave of most robots: a share of the targets' spread, and rad, per axis.
# More costs a second to look for other readings; it is no reason to refuse.
USUAL, USUAL_NOMINAL = 0.005, 0.05
# Another reading is taken for what was meant if it leaves so many times less.
CLEARLY_LESS = 5.0
# Readings that fit the nominal robot best, whose constants are fitted too.
READINGS_FITTED = 4
# Another zero, or that and another sign, is believed where it leaves so many times less than what is more usual: axes that meet
# and frames make one look like the other (half a turn before the last axis is its other sign).
DOUBT_OF_RARER = 1.2
# Units whose letters would not be read as one.
UNITS_IN_WORDS = {"in": "inches", "deg": "degrees", "rad": "radians"}
# Orders in which Euler angles may turn, fixed or with the body.
EULER_SEQUENCES = tuple(
    word
    for letters in itertools.product("xyz", repeat=3)
    if letters[0] != letters[1] != letters[2]
    for word in ("".join(letters), "".join(letters).upper())
)


TURNED_BACK: dict[str, Literal["pose", "orientation"] | None] = {
    "T_world_target": None,
    "orientations of the world in the target": "orientation",
    "T_target_world": "pose",
}
"""What tables may hold of the target, and the key that says so."""


@dataclass(frozen=True)
class OtherReading:
    """Another way to read a table.

    Attributes:
        what: In words.
        remedy: What to write, or to change in the file.
        settings: The campaign's, as they would be.
        table: The rows, as they would be.
        doubt: Factor on what this reading leaves: above 1 for slips that are rarer.
    """

    what: str
    remedy: str
    settings: MeasurementSettings
    table: Table
    doubt: float = 1.0


@dataclass(frozen=True)
class ReadingResidual:
    """What frames, or frames and constants, leave of a reading, per axis.

    Attributes:
        sigma: Robust sigma of the position and perhaps of the rotation, shape (1,) or (2,), [m] and [rad].
        spread: RMS distance of the targets from their centre, [m].
    """

    sigma: np.ndarray
    spread: float

    @property
    def share(self) -> float:
        """Both as one number: the position's as a share of the spread, so that no unit flatters, plus the rotation's."""
        return float(self.sigma[0] / max(self.spread, 1e-9) + self.sigma[1:].sum())

    def __str__(self) -> str:
        said = [rounded(value) for value in 1e3 * self.sigma]
        return " and ".join(f"{value} {unit}" for value, unit in zip(said, ("mm", "mrad"), strict=False))


@dataclass(frozen=True)
class Better:
    """Another reading that fits far better than the campaign's.

    Attributes:
        other: The reading.
        whose: The robot that judges: ``nominal`` or ``calibrated``.
        before: What the campaign's own reading leaves of it.
        after: What the other one does.
    """

    other: OtherReading
    whose: str
    before: ReadingResidual
    after: ReadingResidual


def refuse_misread(campaign: Campaign, robot: Robot, rows: Dataset, geometry: Geometry | None) -> None:
    """Refuse a table that another reading fits far better, and say which; see :func:`better_reading`.

    Raises:
        NotOfThisRobot: naming the reading that fits, and the remedy.
    """
    better = better_reading(campaign, robot, rows, geometry)
    if better is not None:
        raise NotOfThisRobot(
            f"{rows.title}: read as the campaign says, these measurements are {better.before} per axis off the {better.whose} "
            f"robot. Read as {better.other.what} they would be {better.after} off. {better.other.remedy}"
        )


def better_reading(campaign: Campaign, robot: Robot, rows: Dataset, geometry: Geometry | None) -> Better | None:
    """Another reading of a table that fits far better; None where there is none.

    Args:
        campaign: As it is.
        robot: The nominal chain.
        rows: The measurements as the campaign reads them; only training rows are looked at.
        geometry: The fit of frames and constants; None: it failed, or was not tried.
    """
    if not rows.direct:  # of these kinds no other readings are known
        return None
    train = rows.fitted
    labels = station_labels(campaign.question, rows)
    if geometry is not None:
        remainders = [
            ReadingResidual(robust_sigma(unscaled(better.residual, train.relative), train.channels), _spread(train))
            for better in (geometry.nominal, geometry.geometric)
        ]
        if remainders[0].share < USUAL_NOMINAL and remainders[1].share < USUAL:
            return None
    table = _sample(campaign, train)
    campaign_fit = _fit_of_campaign(campaign, robot, campaign.measurements, table, labels)
    if campaign_fit is None:
        return None
    tries = []
    for other in _other_ways(campaign.measurements, robot, table):
        nominal = _nominal(campaign, robot, other.settings, other.table, labels)
        if nominal is not None:
            tries.append((nominal, other))
    tries.sort(key=lambda pair: pair[0].share * pair[1].doubt)
    better = []
    for nominal, other in tries[:READINGS_FITTED]:
        geometric = _geometric(campaign, robot, other.settings, other.table, labels)
        if geometric is not None and _far_less((nominal, geometric), campaign_fit):
            better.append((geometric.share * nominal.share * other.doubt, nominal, geometric, other))
    if not better:
        return None
    _, nominal, geometric, other = min(better, key=lambda entry: entry[0])
    before = campaign_fit[1]
    if before is None or before.share < CLEARLY_LESS * geometric.share:
        return Better(other, "nominal", campaign_fit[0], nominal)
    return Better(other, "calibrated", before, geometric)


def _far_less(
    fit: tuple[ReadingResidual, ReadingResidual], campaign_fit: tuple[ReadingResidual, ReadingResidual | None]
) -> bool:
    """True if a reading leaves far less than the campaign's own in one stage, and not much more in the other.

    Constants alone are no judge: they may stretch an arm to another unit of length, or turn an axis round.
    """
    nominal, geometric = (each.share for each in fit)
    before = campaign_fit[0].share, (campaign_fit[1] or campaign_fit[0]).share
    by_constants = CLEARLY_LESS * geometric < before[1] and nominal < before[0]
    by_frames = CLEARLY_LESS * nominal < before[0] and geometric < 2 * before[1]
    return by_constants or by_frames


def _sample(campaign: Campaign, train: Dataset) -> Table:
    """Some training rows as they stand in the tables."""
    settings = campaign.measurements
    joints = [settings.columns.get(name, name) for name in train.names] if campaign.has_other_tables else None
    table = read_tables(campaign.tables, settings.ignore, campaign.limits.table, settings.table.dialect, joints)
    number = {place: k for k, place in enumerate(zip(table.file.tolist(), table.line.tolist(), strict=True))}
    rows = np.array(
        [number[place] for place in zip(train.origin.file.tolist(), train.origin.line.tolist(), strict=True)]
    )
    chosen = np.random.default_rng(0).permutation(rows)[:SAMPLE_ROWS]
    frame = table.frame().iloc[np.sort(chosen)].reset_index(drop=True)
    split = campaign.measurements.columns.get("split", "split")
    return read_tables([frame.assign(**{split: "train"})])


def _rows(campaign: Campaign, robot: Robot, settings: MeasurementSettings, table: Table) -> tuple[Campaign, Dataset]:
    """The sample as other settings read it."""
    changed = campaign.model_copy(update={"measurements": settings})
    return changed, load_measurements(
        changed, robot.readings, robot.limits, robot.kinds, robot=robot, table=table, fitted=False
    )  # fmt: skip


def _nominal(
    campaign: Campaign, robot: Robot, settings: MeasurementSettings, table: Table, labels: tuple[str, ...]
) -> ReadingResidual | None:
    """What frames alone leave of a reading; None: it cannot be read so."""
    try:
        changed, rows = _rows(campaign, robot, settings, table)
        return ReadingResidual(nominal_sigma(changed.question, robot, rows, labels), _spread(rows))
    except (AridcalError, ValueError, np.linalg.LinAlgError):
        return None


def _geometric(
    campaign: Campaign, robot: Robot, settings: MeasurementSettings, table: Table, labels: tuple[str, ...]
) -> ReadingResidual | None:
    """What frames and constants leave of a reading; None: it cannot be read so."""
    try:
        changed, rows = _rows(campaign, robot, settings, table)
        fit = fit_geometry(changed.question, robot, rows, labels).geometric
        return ReadingResidual(robust_sigma(unscaled(fit.residual, rows.relative), rows.channels), _spread(rows))
    except (AridcalError, ValueError, np.linalg.LinAlgError):
        return None


def _fit_of_campaign(
    campaign: Campaign, robot: Robot, settings: MeasurementSettings, table: Table, labels: tuple[str, ...]
) -> tuple[ReadingResidual, ReadingResidual | None] | None:
    """Both stages of the campaign's own reading, the second None where constants cannot be fitted; None: neither can."""
    nominal = _nominal(campaign, robot, settings, table, labels)
    return None if nominal is None else (nominal, _geometric(campaign, robot, settings, table, labels))


def _spread(rows: Dataset) -> float:
    """RMS distance of the targets from their centre, [m]."""
    centred = rows.position - rows.position.mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(centred**2, axis=1))))


def _other_ways(settings: MeasurementSettings, robot: Robot, table: Table) -> Iterator[OtherReading]:
    """Every other reading that differs from the campaign's by one slip."""
    if settings.traits.oriented:
        yield from _orientations(settings, robot, table)
    yield from _units(settings, robot, table)
    yield from _joints(settings, robot, table)


def _orientations(settings: MeasurementSettings, robot: Robot, table: Table) -> Iterator[OtherReading]:
    """Other orders of quaternions, other writings of angles, and poses the other way round."""
    angles = settings.orientation.angles
    if angles is None and settings.orientation.matrix is None:
        columns = [column_of(name, settings, robot.readings) for name in QUATERNION]
        for what, order in (("scalar-first quaternions", (1, 2, 3, 0)), ("scalar-last quaternions", (3, 0, 1, 2))):
            mapped = dict(zip(QUATERNION, (columns[k] for k in order), strict=True))
            yield OtherReading(what, _write(f"columns: {_braces(mapped)}"), _with(settings, columns=mapped), table)
    if angles is not None:
        names = list(angles)
        for word in EULER_SEQUENCES:
            if word != settings.orientation.euler:
                spec = {"euler": word, "columns": tuple(names), "rotvec": None}
                key = f"orientation: {{euler: {word}, columns: [{', '.join(names)}]}}"
                yield OtherReading(f"Euler angles {word}", _write(key), _oriented(settings, spec), table)
        if settings.orientation.rotvec is None:
            spec = {"euler": None, "columns": None, "rotvec": tuple(names)}
            key = f"orientation: {{rotvec: [{', '.join(names)}]}}"
            yield OtherReading("rotation vectors", _write(key), _oriented(settings, spec), table)
    std_columns = {column_of(name, settings, robot.readings) for name in STD} & set(table.names)
    for what, inverted in TURNED_BACK.items():
        if inverted != settings.inverted:
            noise = settings.noise.model_copy(
                update={"rows": "ignore"}
            )  # those of rows are not known the other way round
            changed = settings.model_copy(update={"inverted": inverted, "noise": noise})
            remedy = _write(f"inverted: {inverted}") if inverted else "Delete `inverted` under measurements"
            if inverted == "pose" and robot.climbs:
                remedy += ", or exchange `robot.base` and `robot.tip`"
            if inverted and settings.noise.rows != "ignore" and std_columns:
                remedy += " and `noise: {rows: ignore}`"
            yield OtherReading(what, remedy, changed, table)


def _units(settings: MeasurementSettings, robot: Robot, table: Table) -> Iterator[OtherReading]:
    """Other units of all lengths, of all angles, and of the positions alone where joints slide."""
    for unit in TRIED_LENGTHS:
        if unit != settings.units.length:
            units = settings.units.model_copy(update={"length": unit})
            changed = settings.model_copy(update={"units": units})
            yield OtherReading(
                f"lengths in {UNITS_IN_WORDS.get(unit, unit)}", _write(f"units: {{length: {unit}}}"), changed, table
            )
            if "prismatic" in robot.kinds:
                place = [column_of(name, settings, robot.readings) for name in POSITION_COLUMNS]
                yield _columns_in(
                    f"positions in {UNITS_IN_WORDS.get(unit, unit)}", dict.fromkeys(place, unit), settings, table
                )
    unit = _other_angle(settings)
    changed = settings.model_copy(update={"units": settings.units.model_copy(update={"angle": unit})})
    yield OtherReading(f"angles in {UNITS_IN_WORDS[unit]}", _write(f"units: {{angle: {unit}}}"), changed, table)


def _joints(settings: MeasurementSettings, robot: Robot, table: Table) -> Iterator[OtherReading]:
    """One joint with the other sign, another zero or in another unit, and two exchanged."""
    columns = {name: settings.columns.get(name, name) for name in robot.readings}
    for (joint, column), kind in zip(columns.items(), robot.kinds, strict=True):
        yield _with_count(f"{joint} with the other sign", joint, -1, 0, settings, table)
        if kind != "prismatic":
            yield from _zeros(settings, joint, table)
        default, units = (
            (settings.units.length, TRIED_LENGTHS) if kind == "prismatic" else (settings.units.angle, ANGLES)
        )
        current = settings.units.columns.get(column, default)
        for other in units:
            if other != current:
                yield _columns_in(f"{joint} in {UNITS_IN_WORDS.get(other, other)}", {column: other}, settings, table)
    for one, two in itertools.combinations(columns, 2):
        mapped = {one: columns[two], two: columns[one]}
        remedy = _write(f"columns: {_braces(mapped)}")
        yield OtherReading(f"{one} and {two} exchanged", remedy, _with(settings, columns=mapped), table)


def _zeros(settings: MeasurementSettings, joint: str, table: Table) -> Iterator[OtherReading]:
    """A joint that counts from another quarter of a turn, or that way and backwards, as controllers and URDFs often differ."""
    for sign, how in ((1, ""), (-1, " and the other sign")):
        for turns in (1, -1, 2):
            what = f"{joint} with another zero ({90 * turns:+d} degrees){how}"
            yield _with_count(
                what, joint, sign, turns, settings, table, DOUBT_OF_RARER if sign > 0 else DOUBT_OF_RARER**2
            )


def _with_count(
    what: str, joint: str, sign: int, turns: int, settings: MeasurementSettings, table: Table, doubt: float = 1.0
) -> OtherReading:
    """A joint whose reading is ``sign`` times the campaign's plus ``turns`` quarters of a turn."""
    before = settings.joints.get(joint, JointColumn())
    new_sign = sign * before.sign
    zero = before.zero
    if turns:
        degrees = 180.0 - (180.0 - math.degrees(before.shown_at_zero) + 90.0 * turns * new_sign) % 360.0
        zero = f"{degrees:.9g}deg" if degrees else None
    counts = JointColumn.model_construct(sign=new_sign, zero=zero)
    keys = {**({"zero": zero} if zero else {}), **({"sign": str(new_sign)} if new_sign < 0 or not zero else {})}
    changed = settings.model_copy(update={"joints": {**settings.joints, joint: counts}})
    return OtherReading(what, _write(f"joints: {{{joint}: {_braces(keys)}}}"), changed, table, doubt)


def _columns_in(what: str, units: dict[str, str], settings: MeasurementSettings, table: Table) -> OtherReading:
    """Single columns in another unit."""
    units_changed = settings.units.model_copy(update={"columns": {**settings.units.columns, **units}})
    return OtherReading(
        what,
        _write(f"units: {{columns: {_braces(units)}}}"),
        settings.model_copy(update={"units": units_changed}),
        table,
    )


def _other_angle(settings: MeasurementSettings) -> str:
    """The other unit of angle."""
    return next(unit for unit in ANGLES if unit != settings.units.angle)


def _with(settings: MeasurementSettings, columns: dict[str, str]) -> MeasurementSettings:
    return settings.model_copy(update={"columns": settings.columns | columns})


def _oriented(settings: MeasurementSettings, spec: dict[str, Any]) -> MeasurementSettings:
    return settings.model_copy(update={"orientation": settings.orientation.model_copy(update=spec)})


def _write(text: str) -> str:
    return f"Write under measurements `{text}`"


def _braces(mapping: dict[str, str]) -> str:
    return "{" + ", ".join(f"{key}: {value}" for key, value in mapping.items()) + "}"
