"""How the tables of a campaign are written: looked at once, and where they do not tell, judged by the robot's motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from aridcal.files.formats import robot_calibration
from aridcal.files.formats.sniffing import as_keys, look
from aridcal.files.tables import AnyTable, check_ending
from aridcal.jobs.prepare.guesses import Chooser, Guess, Proposal, leave_open
from aridcal.jobs.prepare.orientation_columns import CLEAR_RATIO
from aridcal.jobs.prepare.units_and_angles import rounded
from aridcal.system.errors import AridcalError, MeasurementError
from aridcal.system.reading import workbooks
from aridcal.system.reading.dialect import PLAIN, Dialect
from aridcal.system.reading.regular_files import TABLE_LIMIT, read_file
from aridcal.system.reading.user_names import check_path

SAME_FIT_SHARE = 1e-9
"""Two ways that put the targets as near to the robot, to this share, are one: digits in groups or not, metres or mm."""


def dialects_of(tables: Sequence[AnyTable], asker: Chooser) -> tuple[list[Dialect], str]:
    """Dialects in which all of some tables may be, the likeliest first, and the program that wrote them, if they say.

    Raises:
        AridcalError: they are no tables, or are not all written in one way.
    """
    possible: list[Dialect] | None = None
    first, maker = None, ""
    for table in tables:
        path = None if isinstance(table, pd.DataFrame) else Path(table)
        if path is None or path.suffix.lower() == ".parquet":
            continue
        check_path(path, MeasurementError)
        if path.suffix.lower() not in robot_calibration.CALIBRATION_ENDINGS:
            check_ending(path)
        answer = look(read_file(path, MeasurementError, TABLE_LIMIT), path, TABLE_LIMIT, asker.pick)
        maker = maker or answer.maker
        if possible is None:
            possible, first = list(answer.dialects), path
            continue
        comment = tuple(sorted({*possible[0].comment, *answer.dialects[0].comment}))
        of_file = [replace(dialect, comment=comment) for dialect in answer.dialects]
        so_far = [replace(dialect, comment=comment) for dialect in possible]
        possible = [dialect for dialect in so_far if dialect in of_file] or _with_marks(so_far, of_file)
        if not possible:
            raise MeasurementError(
                f"{path}: is not written as {first} is ({_words(of_file[0])}; {_words(so_far[0])}); export both alike, or make "
                "them two blocks of measurements"
            )
    return possible or [PLAIN], maker


def _with_marks(first: Sequence[Dialect], second: Sequence[Dialect]) -> list[Dialect]:
    """The dialects of the one of two files whose numbers have marks, if they differ in nothing else; else none."""
    unmarked = [replace(dialect, decimal=".", thousands="") for dialect in (first[0], second[0])]
    if unmarked[0] != unmarked[1]:
        return []
    marked = [dialects for dialects in (first, second) if dialects[0] != unmarked[0]]
    return list(marked[0]) if len(marked) == 1 else []


def best_dialect(
    dialects: Sequence[Dialect], proposed: Callable[[Dialect, Chooser], Proposal], asker: Chooser
) -> tuple[Dialect, str]:
    """The dialect in which the targets move as the robot does, and why.

    Args:
        dialects: The possible ones.
        proposed: Makes a campaign of a table read in one.
        asker: Asked where several fit alike.

    Raises:
        AridcalError: none can be read, or nobody says which of several is meant.
    """
    if len(dialects) == 1:
        return dialects[0], ""
    alone = Chooser(leave_open, asker.settled)
    misfits: list[tuple[float, Dialect]] = []
    failure: AridcalError | None = None
    for dialect in dialects:
        try:
            fit = proposed(dialect, alone).fit
        except AridcalError as problem:
            failure = failure or problem
        else:
            misfits.append((fit[1] if fit else 0.0, dialect))
    if not misfits:
        raise failure or MeasurementError("no table can be read")
    misfits.sort(key=lambda one: one[0])
    best = misfits[0]
    near = [one for one in misfits if one[0] <= CLEAR_RATIO * best[0]]
    if len(near) == 1:
        comparison = f"; {_numbers(misfits[1][1])} by {rounded(100 * misfits[1][0])} %" if len(misfits) > 1 else ""
        return best[
            1
        ], f"with {_numbers(best[1])} the nominal robot misses the targets by {rounded(100 * best[0])} %{comparison}"
    if all(abs(share - best[0]) <= SAME_FIT_SHARE * max(best[0], SAME_FIT_SHARE) for share, _ in near):
        return best[1], f"{_numbers(best[1])}: read in groups, the same places would be in another unit"
    answers = [f"{_numbers(dialect)}, {rounded(100 * share)} % off" for share, dialect in near]
    k = asker.pick("table.decimal", "how are numbers written", answers, "these fit the nominal robot alike")
    return near[k][1], "as was answered"


def _words(dialect: Dialect, workbook: bool = False) -> str:
    """A dialect in words."""
    if dialect.export:
        return f"samples of {dialect.export}, sensor {dialect.sheet}"
    parted = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "blanks"}[dialect.separator]
    cells = f"{dialect.encoding}, cells parted by {parted}"
    if workbook:
        cells = f"sheet {dialect.sheet}" if dialect.sheet else "a workbook of one sheet"
    header = f"names in line{'s' if len(dialect.header) > 1 else ''} {', '.join(map(str, dialect.header))}"
    header = "names as was answered" if dialect.names else header
    skipped = f", lines that begin with {' or '.join(dialect.comment)} are no rows" if dialect.comment else ""
    return f"{cells}, {_numbers(dialect)}, {header}, rows from line {dialect.begins}{skipped}"


def _numbers(dialect: Dialect) -> str:
    """How numbers are written, in words."""
    sign = {".": "decimal points", ",": "decimal commas"}[dialect.decimal]
    groups = {"": "", ".": "points", ",": "commas", "'": "apostrophes", " ": "blanks"}[dialect.thousands]
    return f"{sign} and thousands with {groups}" if groups else sign


def say_table(dialect: Dialect, tables: Sequence[AnyTable], maker: str, why: str, proposal: Proposal) -> None:
    """Say how the tables are written, unless they are plain csv."""
    keys = as_keys(dialect)
    workbook = any(
        not isinstance(one, pd.DataFrame) and Path(one).suffix.lower() in workbooks.WORKBOOK_ENDINGS for one in tables
    )
    if keys or maker or workbook:
        parts = [f"an export of {maker}"] if maker else []
        parts += [_words(dialect, workbook), *([why] if why else [])]
        proposal.guesses.insert(0, Guess("measurements.table", keys or None, "; ".join(parts)))
