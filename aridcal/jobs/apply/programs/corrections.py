"""What becomes of each target of a program: in columns, for a long program has a hundred thousand of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any, overload

import numpy as np

from aridcal.jobs.apply.programs.proof import TextChange
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.text import NUL
from aridcal.system.errors import printable

TABLE_DIGITS = 6
"""Of millimetres and milliradians in the side table: a nanometre, which nobody reads past."""

WRITTEN_DIGITS = 12
"""Of such a number altogether: a kilometre in nanometres, and no digit that is rounding of the last one."""


@dataclass(frozen=True, slots=True)
class Correction:
    """What becomes of one target.

    Attributes:
        target: As it stands in the program.
        why: Why it is left as it is; empty where it is corrected.
        remark: What is to be known of a correction.
        texts: New numbers, as they are written; none where it is left.
        words: New words of its posture, as they are written; none where the program has none, or it is left.
        moved: By how much the place that the controller is told is moved, [m] and [rad].
        before: How far the real tip would be from its place as the program is, [m] and [rad].
        after: How far it will be, rounding included, [m] and [rad].
        positions: Positions of the arm that agree with the program, where it is not known which it takes.
        doubt: How much the correction would differ with another of them, [m].
        beside: What remains at the worst of the other places where the same numbers are used, [m].
    """

    target: Target
    why: str = ""
    remark: str = ""
    texts: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    moved: tuple[float, float] = (np.nan, np.nan)
    before: tuple[float, float] = (np.nan, np.nan)
    after: tuple[float, float] = (np.nan, np.nan)
    positions: int = 1
    doubt: float = 0.0
    beside: float = 0.0


@dataclass(frozen=True, eq=False)
class Corrections(Sequence[Correction]):
    """Corrections of n targets; the columns are those of :class:`Correction`.

    Attributes:
        targets: As they stand in the program.
        why: Why each is left.
        remark: What is to be known of each.
        texts: Its new numbers, joined by :data:`NUL`; empty where it is left.
        words: Its new words, likewise.
        moved: Shape (n, 2), [m] and [rad].
        before: Likewise.
        after: Likewise.
        positions: Shape (n,).
        doubt: Shape (n,), [m].
        beside: Shape (n,), [m].
    """

    targets: Sequence[Target]
    why: list[str]
    remark: list[str]
    texts: list[str]
    words: list[str]
    moved: np.ndarray
    before: np.ndarray
    after: np.ndarray
    positions: np.ndarray
    doubt: np.ndarray
    beside: np.ndarray

    def __len__(self) -> int:
        return len(self.targets)

    @overload
    def __getitem__(self, k: int) -> Correction: ...

    @overload
    def __getitem__(self, k: slice) -> Sequence[Correction]: ...

    def __getitem__(self, k: int | slice) -> Correction | Sequence[Correction]:
        if isinstance(k, slice):
            return [self[row] for row in range(*k.indices(len(self)))]
        texts, words = (tuple(own[k].split(NUL)) if own[k] else () for own in (self.texts, self.words))
        (moved, turned), (before, before_turned), (after, after_turned) = (
            own[k].tolist() for own in (self.moved, self.before, self.after)
        )
        return Correction(
            self.targets[k], self.why[k], self.remark[k], texts, words, (moved, turned), (before, before_turned),
            (after, after_turned), int(self.positions[k]), float(self.doubt[k]), float(self.beside[k]),
        )  # fmt: skip

    @property
    def left(self) -> np.ndarray:
        """Which are left as they are, shape (n,) bool."""
        return np.array([bool(why) for why in self.why], dtype=bool)

    def files(self) -> set[int]:
        """Files of the project in which a number changes."""
        rows = zip(self.targets, self.why, self.texts, self.words, strict=True)
        return {target.file for target, why, texts, words in rows if not why and _differs(target, texts, words)}

    def named(self, targets: Sequence[Target]) -> Corrections:
        """The same of targets of which only names and places are kept: their numbers stand in the new text."""
        empty = [""] * len(self.why)
        return replace(self, targets=targets, texts=empty, words=empty)

    def changes(self) -> Iterator[TextChange]:
        """Numbers of targets that change, those of the posture among them, and what stands there now."""
        for target, why, texts, words in zip(self.targets, self.why, self.texts, self.words, strict=True):
            if not why:
                yield from _changes(target, texts, words)


def _differs(target: Target, texts: str, words: str) -> bool:
    """Whether new numbers or words differ from those of a target."""
    stated = target.branch.words
    return texts != target.numbers.joined or (stated is not None and bool(words) and words != stated.numbers.joined)


def _changes(target: Target, texts: str, words: str) -> Iterator[TextChange]:
    stated = target.branch.words
    if texts != target.numbers.joined:
        yield TextChange(target.file, target.numbers, texts)
    if stated is not None and words and words != stated.numbers.joined:
        yield TextChange(target.file, stated.numbers, words)


def no_corrections(targets: Sequence[Target]) -> Corrections:
    """Targets of which none is corrected, each with its own reason, if any: to be filled in."""
    n = len(targets)
    shift, before, after = (np.full((n, 2), np.nan) for _ in range(3))
    why, remark, texts, words = [target.why for target in targets], [""] * n, [""] * n, [""] * n
    one, none = np.ones(n, dtype=int), np.zeros(n)
    return Corrections(targets, why, remark, texts, words, shift, before, after, one, none, none.copy())


def joined_corrections(parts: Sequence[Corrections]) -> Corrections:
    """The corrections of some parts of a program, one after the other."""

    def column(name: str) -> Any:
        columns = [getattr(part, name) for part in parts]
        return np.concatenate(columns) if isinstance(columns[0], np.ndarray) else list(chain.from_iterable(columns))

    return Corrections(**{own.name: column(own.name) for own in fields(Corrections)})


def as_table(corrections: Corrections) -> dict[str, np.ndarray]:
    """The corrections of each move, columns with one row a target; millimetres and milliradians."""
    left = corrections.left
    moved, after = (
        np.where(left[:, None], 0.0, corrections.moved),
        np.where(left[:, None], corrections.before, corrections.after),
    )
    columns: dict[str, Any] = {
        "line": np.array([target.line for target in corrections.targets], dtype=int),
        "target": [printable(target.name) for target in corrections.targets],
        "written_as": [target.form for target in corrections.targets],
        "corrected": ~left,
        "remark": [
            printable(why or _remark(*remark))
            for why, *remark in zip(corrections.why, corrections.remark, corrections.beside, strict=True)
        ],
    }
    names = (
        ("moved_mm", "turned_mrad"),
        ("error_before_mm", "error_before_mrad"),
        ("error_after_mm", "error_after_mrad"),
    )
    for pair, values in zip(names, (moved, corrections.before, after), strict=True):
        columns |= dict(zip(pair, np.round(1e3 * values.T, TABLE_DIGITS), strict=True))
    columns["arm_positions"] = corrections.positions
    columns["other_position_mm"] = np.round(1e3 * corrections.doubt, TABLE_DIGITS)
    return {
        name: np.asarray(column, dtype=object if isinstance(column, list) else None) for name, column in columns.items()
    }


def _remark(remark: str, beside: float) -> str:
    return f"{remark}: {1e3 * beside:.{TABLE_DIGITS}f} mm remain there at most" if beside else remark
