"""What logs hold beside joints, clock and place: temperatures, payloads, forces, labels; one value for each standstill."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from aridcal.files.tables import Table
from aridcal.jobs.prepare.column_names import (
    SCATTER_WORDS,
    angle_triples,
    joint_families,
    matrices,
    named_column,
    positions,
    quaternions,
    words,
)
from aridcal.jobs.prepare.condition_columns import COVARIATES
from aridcal.jobs.prepare.orientation_columns import sensible
from aridcal.system.errors import name_list


@dataclass(frozen=True)
class OtherColumns:
    """Further columns of a log, in the order of its time.

    Attributes:
        title: Of the log.
        time: Of its own clock, shape (N,), [s].
        numbers: Columns of numbers, shape (N,) each, as they were written; NaN where there is none.
        labels: Columns of text, shape (N,) each.
    """

    title: str
    time: np.ndarray
    numbers: Mapping[str, np.ndarray]
    labels: Mapping[str, np.ndarray]


def other_columns(table: Table, seconds: np.ndarray, used: Collection[str], joints: int) -> OtherColumns:
    """Columns of a table that are neither its clock, nor joints, nor any position or orientation.

    Args:
        table: The log.
        seconds: Its time, shape (N,).
        used: Columns that are spoken for.
        joints: How many the robot has.
    """
    names = [name for name in table.names if name and name not in used]
    poses = (*positions(table.names), *angle_triples(table.names), *quaternions(table.names))
    in_families = {name for family in (*poses, *joint_families(names, joints)) for name in family.columns}
    for matrix in matrices(table.names):
        in_families |= {name for way in (*matrix.rotation, *(matrix.position or ())) for name in way}
    clocks = next(spellings for quantity, _, spellings in COVARIATES if quantity == "time")
    clock = named_column(names, *clocks)
    free = [
        name for name in names if name not in in_families and name != clock and not set(words(name)) & SCATTER_WORDS
    ]
    finite = np.flatnonzero(np.isfinite(seconds))
    order = finite[np.argsort(seconds[finite], kind="stable")]
    numbers, labels = {}, {}
    for name in free:
        values, is_text = sensible(table, [name])[:, 0], table.numbers(name)[1]
        if np.isfinite(values).any() and not is_text.any():
            if not _counts(values):
                numbers[name] = values[order]
        elif is_text.any():
            labels[name] = table.texts(name)[order]
    return OtherColumns(table.title, seconds[order], numbers, labels)


def _counts(values: np.ndarray) -> bool:
    """True of a column that counts the samples."""
    steps = np.diff(values)
    return len(steps) > 1 and bool(np.all(steps == steps[0])) and steps[0] != 0


def window_values(
    logs: Mapping[str, tuple[OtherColumns | None, np.ndarray, np.ndarray]], own_columns: Collection[str]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """One value of each further column for each of K windows: the mean of numbers, or the only label.

    Args:
        logs: For ``joints`` and ``tracker``: the columns, and where the windows begin and end by that log's clock, shape (K,).
        own_columns: Columns that the table has by itself.

    Returns:
        The columns, by their names in the table, and what is to be said of them.
    """
    columns: dict[str, np.ndarray] = {}
    notes: list[str] = []
    for which, (log, begin, end) in logs.items():
        if log is None:
            continue
        first, last = np.searchsorted(log.time, begin), np.searchsorted(log.time, end, "right")
        windows = [slice(a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True)]
        columns_of_log: dict[str, np.ndarray] = {name: _means(column, windows) for name, column in log.numbers.items()}
        columns_of_log |= {name: _constants(column, windows) for name, column in log.labels.items()}
        empty = [name for name, column in columns_of_log.items() if _holes(column).all()]
        holes = {name: int(_holes(column).sum()) for name, column in columns_of_log.items() if name not in empty}
        for name in [name for name in columns_of_log if name not in empty]:
            title = name if name not in own_columns and name not in columns else f"{which}_{name}"
            if title in own_columns or title in columns:
                notes.append(
                    f"{log.title}: column {name!r} is not carried over: the table has one of that name, and {title!r}"
                )
                continue
            if title != name:
                notes.append(
                    f"{log.title}: column {name!r} is called {title!r} in the table, which has a {name!r} already"
                )
            columns[title] = columns_of_log[name]
        carried_over = [f"{name} ({count} empty)" if count else name for name, count in holes.items()]
        if carried_over:
            notes.append(f"{log.title}: carried over, the mean at each standstill: {name_list(carried_over)}")
        if empty:
            notes.append(
                f"{log.title}: not carried over, nothing at any standstill or more than one label: {name_list(empty)}"
            )
    return columns, tuple(notes)


def _holes(column: np.ndarray) -> np.ndarray:
    return np.asarray(column == "") if column.dtype.kind == "U" else np.isnan(column)


def _means(values: np.ndarray, windows: list[slice]) -> np.ndarray:
    """Means over windows; NaN where a window has no number."""
    parts = [values[rows][np.isfinite(values[rows])] for rows in windows]
    return np.array([part.mean() if len(part) else np.nan for part in parts])


def _constants(labels: np.ndarray, windows: list[slice]) -> np.ndarray:
    """Labels of windows; empty where a window has none, or several."""
    parts = [set(labels[rows].tolist()) - {""} for rows in windows]
    return np.array([part.pop() if len(part) == 1 else "" for part in parts], dtype=str)
