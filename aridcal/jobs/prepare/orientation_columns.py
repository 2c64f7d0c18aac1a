"""Which columns of a table are the measured orientation, and how it is written: judged by the nominal robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.files.orientations import QUATERNION
from aridcal.files.quantities import SAME_ORIENTATION, STD
from aridcal.files.tables import Table
from aridcal.files.yaml_file import LARGEST_SETTING
from aridcal.jobs.prepare.column_names import (
    COMMANDED_WORDS,
    MEASURED_WORDS,
    ORIENTATION_WORDS,
    Family,
    angle_triples,
    matrices,
    quaternions,
)
from aridcal.jobs.prepare.guesses import Chooser, Proposal
from aridcal.jobs.prepare.units_and_angles import (
    TableReading,
    Writing,
    angle_writings,
    different,
    matrix_writings,
    quaternion_writings,
    rounded,
)
from aridcal.system.errors import MeasurementError

# A way to read the table that fits so many times better than the next needs no question.
CLEAR_RATIO = 3.0
# No nominal robot misses orientations by so much, [rad].
STRANGE_ANGLE = 0.2
# How far from 1 the norms of a quaternion's columns may be.
UNIT_SLACK = 0.05
# Some programs write four zeros where they know no orientation.
LEAST_NORM = 0.5
# Answers that a question offers.
MOST_ANSWERS = 4


@dataclass(frozen=True)
class _Columns:
    """Columns that may be an orientation, and every way to read them, the best first."""

    columns: tuple[str, ...]
    about: frozenset[str]
    ways: list[Writing]

    @property
    def says(self) -> tuple[bool, bool]:
        """Whether the names are of something commanded, and of something measured."""
        return bool(self.about & COMMANDED_WORDS), bool(self.about & MEASURED_WORDS)


def say_orientation(
    table: Table,
    used: set[str],
    place: Family,
    rows: np.ndarray,
    reading: TableReading,
    asker: Chooser,
    proposal: Proposal,
) -> set[str]:
    """Say which columns are the orientation, and how it is written: as the nominal robot agrees with it.

    Args:
        table: N rows.
        used: Columns that are spoken for.
        place: Columns of the position: what shares their words is of the same target.
        rows: Those to judge by.
        reading: The way to read joints and positions.
        asker: Asked where two ways fit alike.
        proposal: Told what was found.

    Returns:
        The columns of the orientation; none where there are only positions.

    Raises:
        MeasurementError: there are two orientations that disagree.
        AridcalError: two ways fit alike, and nobody says which is meant.
    """
    candidates = sorted(
        _candidates(table, used, place, rows, reading), key=lambda one: (*_order(one), _unlike(one, place))
    )
    if not candidates:
        proposal.say("measurements.kind", "position", "no columns of an orientation", sure=False)
        return set()
    best_columns = candidates[0]
    ways = different(best_columns.ways)
    best = ways[0]
    if len(ways) > 1 and ways[1].misfit <= CLEAR_RATIO * best.misfit:
        near = [way for way in ways if way.misfit <= CLEAR_RATIO * best.misfit][:MOST_ANSWERS]
        answers = [f"{way.what}, {rounded(1e3 * way.misfit)} mrad off" for way in near]
        why = f"in {' '.join(best_columns.columns)} these fit the nominal robot alike"
        best = near[asker.pick("orientation", "how are orientations written", answers, why)]
    _refuse_second(table, rows, best_columns, best, candidates[1:])
    why = f"{best.what} misses the nominal robot's orientations by {rounded(1e3 * best.misfit)} mrad"
    for other in [way for way in ways if way is not best][:1]:
        why += f"; {other.what} by {rounded(1e3 * other.misfit)}"
    plausible = best.misfit <= STRANGE_ANGLE
    if not plausible:
        why += ". That is MUCH: check their order, and that they turn the target into the world and not back"
    proposal.say("measurements.kind", "pose", "positions and orientations")
    for key, value in best.keys.items():
        proposal.say(key, value, why, sure=plausible)
    if best.angle not in (None, reading.angle):
        std = [name for name in STD[3:] if name in table.cells]
        proposal.add_units(
            dict.fromkeys((*best_columns.columns, *std), best.angle or ""), "orientations in another unit than joints"
        )
    return set(best_columns.columns)


def _order(one: _Columns) -> tuple[bool, bool]:
    """Sort key: measured columns first, then those that say nothing, commanded ones last."""
    commanded, measured = one.says
    return commanded, not measured


def _unlike(one: _Columns, place: Family) -> int:
    """Number of words that the names of an orientation and of a position do not share."""
    return len((one.about - ORIENTATION_WORDS) ^ (place.about - {"position", "pos", "translation", "t", "p"}))


def _refuse_second(table: Table, rows: np.ndarray, first: _Columns, best: Writing, others: Sequence[_Columns]) -> None:
    """Refuse a second orientation whose names do not say `commanded` and which differs from the first.

    Args:
        table: N rows.
        rows: Those to judge by.
        first: The first one's columns.
        best: How it is written.
        others: Further columns that may be orientations.

    Raises:
        MeasurementError: naming a row and both.
    """
    for other in others:
        if set(other.columns) & set(first.columns) or other.says != first.says or other.ways[0].misfit > STRANGE_ANGLE:
            continue
        whole = np.isfinite(table.matrix((*first.columns, *other.columns))[rows]).all(axis=1)
        angles = [np.where(whole, (way.rotation * best.rotation.inv()).magnitude(), 0.0) for way in other.ways]
        nearest = min(angles, key=np.max)
        worst = int(np.argmax(nearest))
        if nearest[worst] > SAME_ORIENTATION:
            raise MeasurementError(
                f"{table.title}, line {table.line[rows[worst]]}: {' '.join(first.columns)} and {' '.join(other.columns)} "
                f"are two orientations, {np.degrees(nearest[worst]):.3g} degrees apart. Delete the one that was not "
                "measured, or call its columns commanded"
            )


def _candidates(table: Table, used: set[str], place: Family, rows: np.ndarray, reading: TableReading) -> list[_Columns]:
    """Columns that may be an orientation, those of four numbers first."""
    free = [name for name in table.names if name and name not in used]
    candidates, in_matrices = [], set()
    for matrix in matrices(name for name in table.names if name in free or name in place.columns):
        names = sorted({name for way in matrix.rotation for name in way}, key=table.names.index)
        if not set(names) <= set(free):
            continue
        values = dict(zip(names, sensible(table, names)[rows].T, strict=True))
        if all(np.isfinite(column).any() for column in values.values()):
            ways = matrix_writings(matrix, values, reading)
            if ways:
                in_matrices |= set(names)
                candidates.append(_Columns(matrix.rotation[0], matrix.about, ways))
    free = [name for name in free if name not in in_matrices]
    for family in (*quaternions(free), *angle_triples(free)):
        values_of = sensible(table, family.columns)[rows]
        is_quaternion = set(family.columns) == set(QUATERNION) and np.isfinite(table.matrix(family.columns)).any()
        norm = np.linalg.norm(values_of, axis=1)
        if len(family.columns) == 4 and np.isfinite(norm).any() and abs(float(np.nanmedian(norm)) - 1) <= UNIT_SLACK:
            values_of[norm < LEAST_NORM] = np.nan
            candidates.append(_Columns(family.columns, family.about, quaternion_writings(family, values_of, reading)))
        elif len(family.columns) == 3 and np.isfinite(norm).any():
            candidates.append(_Columns(family.columns, family.about, angle_writings(family, values_of, reading)))
        elif is_quaternion:
            raise MeasurementError(
                f"{table.title}: {' '.join(family.columns)} hold no quaternions of norm 1: mend them, or delete these columns if "
                "no orientation was measured"
            )
    return candidates


def sensible(table: Table, columns: Sequence[str]) -> np.ndarray:
    """Columns as numbers, shape (N, columns); NaN where there is none, or one so large that it stands for a hole."""
    values = table.matrix(columns)
    return np.where(np.abs(values) <= LARGEST_SETTING, values, np.nan)
