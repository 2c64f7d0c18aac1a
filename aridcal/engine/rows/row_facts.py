"""What a data set holds beside the measured numbers: where rows come from, what they refer to, and which repeat others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from aridcal.engine.robot.chain import Route
from aridcal.engine.rows.remarks import Remark

ROLES = 3
"""Things that a row may refer to: a camera, a board and a marker."""

Facts = TypeVar("Facts", bound=Any)


@dataclass(frozen=True)
class Origin:
    """Where rows come from.

    Attributes:
        file: Index into `files`, shape (N,).
        line: Line of the file, the header being line 1, shape (N,).
        order: The line, counted on through the files; infinite in rows that came after all that was fitted, shape (N,).
        files: The files that were read.
        sha256: Hash of their bytes; of several blocks, of the blocks' hashes.
        refused: Rows that cannot be used, each named once; they are not among the N.
        notices: What is odd but used: rows outside limits, columns that are ignored.
        split_given: True if the files say which rows are held out.
        derived: Covariates that no file holds: the side of approach, from the order of rows.
    """

    file: np.ndarray
    line: np.ndarray
    order: np.ndarray
    files: tuple[Path, ...] = ()
    sha256: str = ""
    refused: tuple[Remark, ...] = ()
    notices: tuple[Remark, ...] = ()
    split_given: bool = False
    derived: tuple[str, ...] = ()


@dataclass(frozen=True)
class Labels:
    """What rows refer to.

    Attributes:
        block: Index into the data set's blocks, shape (N,).
        refers: Labels of the things that the row refers to, in the order of its kind's roles, shape (N, 3); empty where
            it has fewer roles.
        station: Label of the rows that share a frame, shape (N,); None if there is no such column.
        target: Label of the row's frame on the tip, shape (N,); None where there is one for all.
        route: Number of each row's path among ``routes``, shape (N,); None where all take the first.
        routes: The paths through the robot's tree that rows take.
    """

    block: np.ndarray
    refers: np.ndarray
    station: np.ndarray | None = None
    target: np.ndarray | None = None
    route: np.ndarray | None = None
    routes: tuple[Route, ...] = (Route(),)


@dataclass(frozen=True)
class Repeats:
    """Which rows repeat others.

    Attributes:
        configuration: Number of the row's configuration: rows that repeat one share it, shape (N,).
        stale: Rows whose measurement repeats an earlier one bit for bit although the joints moved, shape (N,) bool.
        doubtful: The stale rows and those that they repeat: only the order of rows says that the later one is stale.
        share: Of a measurement that each row counts for: 1, or less where several rows are one measurement of one body.
    """

    configuration: np.ndarray
    stale: np.ndarray
    doubtful: np.ndarray
    share: float = 1.0


def no_labels(rows: int) -> Labels:
    """Labels of rows of one block that refer to nothing; held in memory once, for those of a million rows would count."""
    return Labels(np.broadcast_to(0, rows), np.broadcast_to("", (rows, ROLES)))


def selected(facts: Facts, rows: np.ndarray | slice) -> Facts:
    """The facts of some rows, chosen by a mask or by indices: arrays are cut, all else stays."""
    values = {f.name: getattr(facts, f.name) for f in fields(facts)}
    return replace(facts, **{name: _cut(v, rows) for name, v in values.items() if isinstance(v, np.ndarray)})


def _cut(values: np.ndarray, rows: np.ndarray | slice) -> np.ndarray:
    """Some rows of an array; rows that share one place in memory go on sharing it."""
    if len(values) and values.strides[0] == 0 and not isinstance(rows, slice):
        count = np.count_nonzero(rows) if np.asarray(rows).dtype == bool else len(rows)
        return np.broadcast_to(values[0], (int(count), *values.shape[1:]))
    return np.asarray(values[rows])


def labels_together(labels: Sequence[np.ndarray | None], counts: Sequence[int]) -> np.ndarray | None:
    """Labels of the rows of several parts, shape (N,), empty where a part has none; None where no part has any."""
    if all(words is None for words in labels):
        return None
    return np.concatenate(
        [np.full(n, "", dtype=str) if words is None else words for words, n in zip(labels, counts, strict=True)]
    )


def origins_together(parts: Sequence[Origin], sha256: str) -> Origin:
    """Where the rows of several parts come from, one part after the other, their order counted on."""
    files = np.cumsum([0, *(len(part.files) for part in parts)])
    last = np.cumsum([0.0, *(part.order[np.isfinite(part.order)].max(initial=0.0) for part in parts)])
    return Origin(
        file=np.concatenate([part.file + before for part, before in zip(parts, files, strict=False)]),
        line=np.concatenate([part.line for part in parts]),
        order=np.concatenate([part.order + before for part, before in zip(parts, last, strict=False)]),
        files=tuple(path for part in parts for path in part.files),
        sha256=sha256,
        refused=tuple(remark for part in parts for remark in part.refused),
        notices=tuple(remark for part in parts for remark in part.notices),
        split_given=all(part.split_given for part in parts),
    )
