"""What a table holds beside joints and poses: covariates, sigmas, and rows that repeat a configuration."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from aridcal.engine.rows.repeats import blocks
from aridcal.files.measurement_settings import ANGLES, LENGTHS, TIMES
from aridcal.files.quantities import STD
from aridcal.files.tables import Table
from aridcal.jobs.prepare.column_names import (
    SCATTER_WORDS,
    angle_triples,
    named_column,
    numbered,
    positions,
    quaternions,
    unit,
    words,
)
from aridcal.jobs.prepare.guesses import Proposal
from aridcal.jobs.prepare.units_and_angles import TableReading

# Quantities known by their names: what they are called in a campaign, their unit, and spellings.
COVARIATES = (
    ("time", "s", ("time", "timestamp", "stamp", "t")),
    ("temperature", "°C", ("temperature", "temp")),
    ("payload", "kg", ("payload", "load")),
)

# Largest numbers of clocks that count from 1970, in units that programs write; what is larger counts nanoseconds.
EPOCH = {"s": 1e11, "ms": 1e14, "us": 1e17}

SAMPLES_COLUMN = "n"
"""The column in which `aridcal merge` counts the samples behind a row."""

POSE_NOISE = "{position: …, rotation: …}, 1 sigma per axis, m and rad"
"""How the noise of poses and positions is stated."""


def say_covariates(
    table: Table,
    used: set[str],
    proposal: Proposal,
    clock: str | None = None,
    noise: str = POSE_NOISE,
    spare: Collection[str] = (),
) -> None:
    """Say what the remaining columns are: sigmas of the rows, covariates, and others.

    Args:
        table: The measurements.
        used: Columns that are spoken for.
        proposal: Told what was found.
        clock: Column of seconds that was made of dates.
        noise: How a campaign of this kind states its noise.
        spare: Columns of joints that no row's path has.
    """
    std = [name for name in STD if name in table.cells]
    why = f"not known: it is estimated. If you know it, write {noise}"
    if std:
        why = f"{' '.join(std)} weigh the rows; if they flatter the instrument, write {{rows: ignore}}"
    proposal.say("measurements.noise", None, why)
    free = [name for name in table.names if name and name not in used and name not in STD]
    for quantity, si_unit, spellings in COVARIATES:
        column = named_column(free, *spellings)
        if quantity == "time" and clock in free:
            free.remove(clock)
            proposal.say_columns({quantity: clock}, "dates, in seconds")
        elif column and _varies(table, column, quantity):
            free.remove(column)
            time_unit = _unit_of_time(table, column) if quantity == "time" else si_unit
            proposal.say_columns({quantity: column}, f"by its name, taken for {time_unit}")
            if time_unit != si_unit:
                proposal.add_units({column: time_unit}, f"{column} in {time_unit}")
    families = (*positions(free), *angle_triples(free), *quaternions(free), *numbered(free))
    in_families = {name for family in families for name in family.columns}
    reasons = {name: _no_covariate(table, name, in_families) for name in free}
    reasons |= dict.fromkeys(spare, "a joint of another limb")
    reasons |= {name: f"not in {path.name} as a plain column" for name, path in table.partial.items()}
    ignored = [name for name in reasons if reasons[name]]
    if ignored:
        why = ", ".join(f"{name} ({reasons[name]})" for name in ignored)
        proposal.say("measurements.ignore", ignored, f"no covariates: {why}", sure=False)
    covariates = ", ".join(name for name in free if not reasons[name])
    if covariates:
        proposal.say(
            "covariates", None, f"effects may depend on {covariates}; name under `ignore` what is none", sure=False
        )


def _varies(table: Table, column: str, quantity: str) -> bool:
    """True of a column with numbers; a clock that stands still is none."""
    numbers, _ = table.numbers(column)
    finite = numbers[np.isfinite(numbers)]
    return len(finite) > 0 and (quantity != "time" or float(np.ptp(finite)) > 0)


def _unit_of_time(table: Table, column: str) -> str:
    """The unit that a clock counts: by its name, or by how large the seconds since 1970 are in it."""
    by_name = unit(column) or ""
    if by_name in TIMES:
        return by_name
    largest = float(np.nanmax(np.abs(table.numbers(column)[0])))
    return next((name for name, most in EPOCH.items() if largest < most), "ns")


def _no_covariate(table: Table, name: str, in_families: Collection[str]) -> str:
    """Why no effect can sensibly depend on a column; empty if one can.

    Args:
        table: The measurements.
        name: The column.
        in_families: Columns that belong together with others.
    """
    if name.endswith("_direction"):
        return ""
    if set(words(name)) & SCATTER_WORDS:
        return "how well something was measured"
    if name == SAMPLES_COLUMN:
        return "how many samples a row is the mean of"
    numbers, _ = table.numbers(name)
    values = numbers[np.isfinite(numbers)]
    if not len(values):
        return "no numbers"
    if len(values) > 2 and np.all(np.diff(values) == 1):
        return "counts the rows"
    if np.ptp(values) == 0:
        return "never changes"
    return "of another pose or chain" if name in in_families else ""


def say_repeats(q: np.ndarray, reading: TableReading, proposal: Proposal) -> None:
    """Say how many rows repeat a configuration.

    Args:
        q: Readings, shape (N, columns), in the table's units; NaN where there is none.
        reading: Says which units.
        proposal: Told what was found.
    """
    kinds = proposal.robot.kinds
    scale = [LENGTHS[reading.length] if kind == "prismatic" else ANGLES[reading.angle] for kind in kinds]
    whole = np.isfinite(q).all(axis=1)
    sizes = np.bincount(blocks((q * scale)[whole], kinds))
    repeated = sizes[sizes > 1]
    why = "no configuration is repeated: that would tell the noise by itself"
    if len(repeated):
        why = f"{repeated.sum()} rows repeat {len(repeated)} configurations: they tell the noise by itself"
    proposal.say("repeats", None, why)
